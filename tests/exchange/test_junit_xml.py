"""JUnit XML of an acceptance report: the structure that continuous-integration servers read, whatever devices say."""

import re
from pathlib import Path

import pytest
from lxml import etree

from data_schemas import AcceptanceReport, provenance
from finray_calib.acceptance import judge
from finray_calib.exchange import junit_xml
from rigs import simulated_rig
from tests.acceptance.facts import PLAN, handshake, spoilt

ORIGIN = provenance("pytest")
# What Jenkins (the junit-10.xsd of its xUnit plug-in) allows, as far as it is used here; written anew, and stricter.
SCHEMA = Path(__file__).with_name("junit.xsd")
HOSTILE = 'mute \x00\x1b[31m </testcase> & "quoted" \ud800'


def report(**changed: object) -> AcceptanceReport:
    return judge(spoilt(**changed), PLAN, simulated_rig("red", width_px=64, height_px=64))


@pytest.fixture(scope="module")
def schema() -> etree.XMLSchema:
    return etree.XMLSchema(etree.parse(SCHEMA))


SPOILT = {
    "handshakes": (handshake(error=HOSTILE), handshake("lamp", "manual")),
    "errors": {"exposures": "camera: gone", "dark frames": "camera: gone"},
    "light_off": ({"layer": "guard", "still_on": 3, "watched_s": 5.0},),
}


@pytest.mark.parametrize("changed", [{}, SPOILT], ids=["good", "spoilt"])
def test_structure_is_that_of_the_schema(schema, changed):
    root = etree.fromstring(junit_xml(report(**changed), ORIGIN))
    schema.assertValid(root)


def test_one_case_for_each_check_and_counts_that_agree():
    made = report(**SPOILT)
    (suite,) = etree.fromstring(junit_xml(made, ORIGIN)).findall("testsuite")
    cases = suite.findall("testcase")
    assert [case.get("name") for case in cases] == [result.name for result in made.results]
    children = {"PASS": "system-out", "FAIL": "failure", "ERROR": "error", "UNDECIDED": "skipped"}
    assert [[child.tag for child in case] for case in cases] == [[children[r.verdict]] for r in made.results]
    for attribute, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        assert int(suite.get(attribute)) == len(suite.findall(f"testcase/{tag}")) > 0
    assert int(suite.get("tests")) == len(cases)
    names = [(case.get("classname"), case.get("name")) for case in cases]
    assert len(set(names)) == len(names)


def test_messages_say_value_limit_and_reason():
    root = etree.fromstring(junit_xml(report(**SPOILT), ORIGIN))
    assert (
        root.find(".//failure").get("message")
        == "allowed: at most 1 s; the laser was still on after 3 of 3 mishaps; each was watched for 5 s. What to do: "
        "do not use this laser until the protection that should have switched it off is repaired"
    )
    assert root.find(".//skipped").get("message") == "it is switched by hand, so no device can be asked"
    slow = etree.fromstring(junit_xml(report(handshakes=(handshake(durations_s=(3.0,)),)), ORIGIN))
    assert re.match(r"3\.0000 \+- 0\.0050 s; allowed: at most 2 s; ", slow.find(".//failure").get("message"))


def test_whatever_a_device_says_is_valid_xml():
    root = etree.fromstring(junit_xml(report(**SPOILT), ORIGIN))
    assert root.find(".//error").get("message") == 'mute \ufffd\ufffd[31m </testcase> & "quoted" \ufffd'
