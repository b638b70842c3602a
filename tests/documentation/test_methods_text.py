"""Methods for a paper: every citation has its work, no work stands uncited, and each sentence is that of the record."""

import re

import pytest
from example_records import example_decision, example_results

from finray_calib.reports import comparison_methods, decision_methods, fit_methods, methods_part
from finray_calib.reports._methods import WORKS, check_methods, cited

RESULTS = example_results()
RED = RESULTS.paints["red"].fitted
ALL = {
    "fit": fit_methods(RED),
    "comparison": comparison_methods(RESULTS.report),
    "decision": decision_methods(RESULTS.decision, RESULTS.sweep),
    "check": check_methods(1.645),
}


@pytest.mark.parametrize("name", ALL)
def test_every_citation_has_its_work(name):
    """Found here by years alone, not by the pattern that the module finds them with."""
    text = " ".join(ALL[name])
    years = re.findall(r"\b(?:19|20)\d\d\b(?=[);])", text)
    assert len(cited(text)) == len(set(re.findall(r"[^(;]+, (?:19|20)\d\d(?=[);])", text))) > 0
    assert len(years) >= len(cited(text))
    part = methods_part(ALL[name])
    assert part.is_detail
    assert part.content.parts[0].content.points == cited(text)


def test_a_work_holds_the_year_it_is_cited_by():
    for name, work in WORKS.items():
        assert re.search(r"\b" + name[-4:] + r"\b", work), name
    assert cited("nothing is cited here, 2001") == ()


def test_the_fit_tells_what_its_record_holds():
    text = " ".join(ALL["fit"])
    for told in (
        "under a laser at 450 nm through 8 band-pass filters (centres 405, 450, 500, 532, 560, 600, 630, 660 nm)",
        "averaged over 51200 pixels",
        "15 of 24 ratios",
        "a smooth random departure of 12 % and a correlation length of",
        "importance sampling with Pareto smoothing (Vehtari et al., 2024), with ensemble chains as an independent",
        "the draws met their criteria",
    ):
        assert told in text
    assert "Gilks" not in text


def test_readings_of_a_table_were_not_photographed():
    text = " ".join(fit_methods(type(RED)(RED.bands.model_copy(update={"region_pixels": 1}), RED.fit)))
    assert "was measured by other means under a laser at 450 nm" in text
    assert "The readings were imported from a table; 15 of 24 ratios" in text
    assert "photographed" not in text


def test_draws_that_are_not_trusted_are_not_praised():
    found = RED.fit.diagnostics.model_copy(update={"trusted": False, "chain": None})
    bad = type(RED)(RED.bands, RED.fit.model_copy(update={"diagnostics": found}))
    text = " ".join(fit_methods(bad))
    assert "the draws did NOT meet their criteria" in text
    assert "Foreman-Mackey" not in text
    assert "R-hat" not in text


def test_standards_are_cited_only_where_they_were_used():
    bare = RESULTS.report.model_copy(update={"monte_carlo": None, "validation": ()})
    text = " ".join(comparison_methods(bare))
    assert "JCGM" not in text
    assert "ASME" not in text
    assert "FLIP" not in text
    used = " ".join(cited(" ".join(ALL["comparison"])))
    assert "JCGM 101:2008" in used
    assert "ASME V&V 20-2009" in used


def test_a_decision_without_captures_says_so():
    text = " ".join(decision_methods(example_decision("tie", validated=False), RESULTS.sweep))
    assert "No capture was used; a difference between simulation and finger was assumed (10 % as one standard" in text
    assert "learned from 1 capture (1.8 % as one standard deviation)" in " ".join(ALL["decision"])
    assert "13 angles from 0 to 120 deg" in text
