"""The page of an acceptance check: verdict first, every check, self-contained, and safe whatever a device says."""

import json
import re

import pytest
from html_page import Page, assert_stands_alone

from data_schemas import AcceptanceReport, provenance
from finray_calib.acceptance import judge
from finray_calib.reports import check_report
from rigs import simulated_rig
from tests.acceptance.facts import PLAN, handshake, spoilt

HOSTILE = "<script>alert(1)</script>"


def report(**changed: object) -> AcceptanceReport:
    return judge(spoilt(**changed), PLAN, simulated_rig("red", width_px=64, height_px=64))


@pytest.fixture(scope="module")
def spoilt_report() -> AcceptanceReport:
    changed = {"handshakes": (handshake(error=HOSTILE),), "revisits": (), "errors": {"wheel": "stuck"}}
    late = ({"layer": "guard", "earliest_s": (1.2,), "latest_s": (1.3,), "witness": "the camera"},)
    return report(**changed, light_off=late)


def test_every_check_and_the_verdict_stand_on_the_page(spoilt_report):
    html = check_report(spoilt_report)
    page = Page(html)
    assert page.open == []
    assert "Verdict \u2717 not good FAIL" in page.prose
    assert "The rig exceeds its limits." in page.prose
    assert html.index("Verdict") < html.index("<table")
    for result in spoilt_report.results:
        assert result.name in page.prose
    assert "1.250\u00a0\u00b1\u00a00.029\u00a0s" in html
    # what asks for attention comes first, the worst on top
    found = re.findall(r"<li>(FAIL|ERROR|UNDECIDED): ", html)
    assert found == ["FAIL", "ERROR", "ERROR", "UNDECIDED", "UNDECIDED"]


def test_a_good_rig_has_nothing_to_look_at():
    page = Page(check_report(report()))
    assert "Every check passed." in page.prose
    assert "Passed 24 of 24" in page.prose


def test_hostile_words_stay_text(spoilt_report):
    html = check_report(spoilt_report)
    assert HOSTILE not in html
    assert "&lt;script&gt;" in html
    assert_stands_alone(html)


def test_the_page_needs_nothing_from_outside_and_holds_the_record(spoilt_report):
    stored = spoilt_report.model_copy(update={"provenance": provenance("finray check run")})
    html = check_report(stored)
    assert_stands_alone(html)
    assert "Where this report comes from" in html
    block = re.search(r'id="summary">(.*?)</script>', html, re.DOTALL)
    assert block is not None
    assert json.loads(block[1])["results"] == stored.model_dump(mode="json")["results"]


def test_ids_are_unique_and_tables_have_captions(spoilt_report):
    page = Page(check_report(spoilt_report))
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {a["aria-labelledby"] for _, a in page.tags if "aria-labelledby" in a} <= set(ids)
    assert len(page.all("caption")) == len(page.all("table")) > 0
