"""An acceptance report as JUnit XML, for continuous-integration servers: one test case for each check."""

import re
from collections import Counter
from typing import Final
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from data_schemas import AcceptanceReport, CheckResult, CheckVerdict, Provenance
from finray_calib.acceptance import value_text

_CHILD: Final[dict[CheckVerdict, str]] = {"FAIL": "failure", "ERROR": "error", "UNDECIDED": "skipped"}
_NOT_IN_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 cannot hold, as a garbled answer of a device may."""


def junit_xml(report: AcceptanceReport, origin: Provenance) -> bytes:
    """Return the report as JUnit XML: FAIL is a failure, ERROR an error, UNDECIDED is skipped with its reason.

    Parameters
    ----------
    report
        The report.
    origin
        When and with what it was made.
    """
    found = Counter(result.verdict for result in report.results)
    count = {"tests": len(report.results), "failures": found["FAIL"], "errors": found["ERROR"]}
    counted = {name: str(number) for name, number in count.items()}
    root = Element("testsuites", {"name": "finray check", **counted})
    suite = SubElement(root, "testsuite", {"name": _plain(report.rig.name), **counted})
    suite.set("skipped", str(found["UNDECIDED"]))
    suite.set("timestamp", origin.created_utc)
    properties = SubElement(suite, "properties")
    for name, value in (
        ("check", report.plan.check_name),
        ("verdict", report.verdict),
        ("finray-calib", origin.package_version),
    ):
        SubElement(properties, "property", {"name": name, "value": _plain(value)})
    for result in report.results:
        _add_case(suite, result)
    indent(root)
    return bytes(tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _add_case(suite: Element, result: CheckResult) -> None:
    """Add the test case of one check."""
    group = f"finray.check.{result.section.replace(' ', '_')}"
    case = SubElement(suite, "testcase", {"classname": group, "name": _plain(result.name)})
    words = (result.what, value_text(result), f"allowed: {result.limit}" if result.limit else "", result.evidence)
    if result.verdict == "PASS":
        SubElement(case, "system-out").text = _plain("\n".join(word for word in words if word))
        return
    message = "; ".join(word for word in words[1:] if word)
    child = SubElement(case, _CHILD[result.verdict], {"message": _plain(message)})
    if result.verdict != "UNDECIDED":
        child.set("type", result.verdict)
    child.text = _plain("\n".join(word for word in words if word))


def _plain(text: str) -> str:
    """Return text with what XML cannot hold replaced."""
    return _NOT_IN_XML.sub("\N{REPLACEMENT CHARACTER}", text)
