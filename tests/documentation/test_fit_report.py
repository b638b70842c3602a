"""The report of one fitted paint: sentences and tables are those of the record, the page says when not to use it."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from example_records import example_results
from html_page import TRUST, Page, assert_stands_alone

from data_schemas import Diagnostics, Estimate, PaintCalibration, PriorSensitivity, PriorShare, Provenance, TiltRatio
from finray_calib.cli._fit import _say_result
from finray_calib.reports import FittedPaint, ReportTable, fit_parts, fit_summary, paint_report, percent, plain
from finray_calib.reports import _fit_statements as said
from finray_calib.reports._fit_page import _fit_limits, _lead, fit_verdict
from finray_calib.reports._fit_statements import (
    absorption_table,
    bands_table,
    chain_table,
    families_table,
    prior_table,
    quantities_table,
    sampling_table,
)
from finray_calib.reports._fitted_paint import curve_agreement, paper_agreement
from finray_calib.reports._plain_text import filter_label

RESULTS = example_results()
RED, GREEN = (RESULTS.paints[colour].fitted for colour in ("red", "green"))
HOSTILE = "<script>alert(1)</script>"
CALM_BANDS = tuple(band.model_copy(update={"explained": True}) for band in RED.fit.bands)
CALM = RED.fit.model_copy(update={"warnings": (), "bands": CALM_BANDS})


def with_fit(paint: FittedPaint, **fields: object) -> FittedPaint:
    """Return the paint with some fields of its calibration replaced."""
    return replace(paint, fit=paint.fit.model_copy(update=fields))


def with_diagnostics(fit: PaintCalibration, **fields: object) -> PaintCalibration:
    """Return the calibration with some fields of its diagnostics replaced."""
    return fit.model_copy(update={"diagnostics": fit.diagnostics.model_copy(update=fields)})


def shifted(diagnostics: Diagnostics, shift_sd: float) -> dict[str, object]:
    """Return the change that lets emcee's means differ from the draws'."""
    assert diagnostics.chain is not None
    means = dict.fromkeys(diagnostics.chain.mean_shift_sd, shift_sd)
    return {"chain": diagnostics.chain.model_copy(update={"mean_shift_sd": means})}


def cells(table: ReportTable) -> dict[str, tuple[str, ...]]:
    """Return the rows of all groups by their heading."""
    return {row[0]: row[1:] for group in table.groups for row in group.rows}


def test_curve_agreement_of_a_known_shift_and_of_the_truth_itself() -> None:
    assert RED.truth is not None
    fit, truth = RED.fit, RED.truth.emission
    perfect = curve_agreement(fit, truth.model_copy(update={"values": fit.emission_per_nm}))
    assert (perfect.error_rel, perfect.coverage_95_rel) == (0.0, 1.0)
    twice = curve_agreement(fit, truth.model_copy(update={"values": 2 * fit.emission_per_nm}))
    assert twice.error_rel == pytest.approx(0.5, rel=1e-12)  # |f - 2f| / |2f|, up to rounding
    assert twice.coverage_95_rel == 0.0
    paper = paper_agreement(fit, truth.model_copy(update={"values": fit.family_emission_per_nm[-1]}))
    assert (paper.error_rel, paper.coverage_95_rel) == (0.0, 1.0)


def test_a_fit_that_misses_the_truth_is_called_too_narrow() -> None:
    assert GREEN.truth is not None
    assert RED.truth is not None
    coverage = curve_agreement(GREEN.fit, GREEN.truth.emission).coverage_95_rel
    assert coverage < said.GOOD_COVERAGE
    told = said.model_statement(GREEN, GREEN.truth)
    assert f"Green paint: the 95 % band covers {percent(coverage)} of the measured curve" in told
    assert "too narrow, as the bands that are not explained show" in told
    paper = paper_agreement(GREEN.fit, GREEN.truth.emission)
    assert f"The paper's curve alone, taken to be exact: {percent(paper.coverage_95_rel)} covered" in told
    assert "exactly such a curve" not in told
    assert "exactly such a curve" in said.model_statement(RED, RED.truth)
    quiet = with_fit(GREEN, bands=CALM_BANDS)
    assert "the bands alone do not reveal it" in said.model_statement(quiet, GREEN.truth)
    assert "describes this paint within its stated uncertainty" in said.model_statement(RED, RED.truth)


@pytest.mark.parametrize("worse", [{"trusted": False}, shifted(RED.fit.diagnostics, 0.4)])
def test_draws_that_cannot_be_trusted_are_not_to_be_used(worse: dict[str, object]) -> None:
    assert RED.truth is not None
    bad = replace(RED, fit=with_diagnostics(CALM, **worse))
    assert "do not use this fit" in said.paint_sentence(bad)
    assert "this fit must not be used" in said.model_statement(bad, RED.truth)
    assert fit_verdict(bad.fit) == "Do not use"


def test_the_verdict_is_care_with_a_warning_or_an_unexplained_band() -> None:
    assert fit_verdict(CALM) == "Fit can be used"
    assert fit_verdict(CALM.model_copy(update={"warnings": ("two maxima",)})) == "Use with care"
    unexplained = (CALM_BANDS[0].model_copy(update={"explained": False}), *CALM_BANDS[1:])
    assert fit_verdict(CALM.model_copy(update={"bands": unexplained})) == "Use with care"


def test_the_sampling_is_told_with_what_is_allowed() -> None:
    diagnostics = RED.fit.diagnostics
    told = said.sampling_statement(diagnostics)
    assert told.startswith(
        "draws by importance sampling, trusted: Pareto k 0.31 (at most 0.7 is allowed), 3120 effective"
    )
    assert "2 maxima of the posterior. emcee, run as an independent check, agrees with them" in told
    assert "differ by at most 0.03 standard deviations" in told
    assert "DISAGREES" in said.sampling_statement(diagnostics.model_copy(update=shifted(diagnostics, -0.4)))
    alone = diagnostics.model_copy(update={"chain": None, "trusted": False, "maxima": (1.0,)})
    assert said.sampling_statement(alone).endswith("one maximum of the posterior.")
    assert "NOT trusted" in said.sampling_statement(alone)
    moved = diagnostics.model_copy(update={"method": "resample-move", "pareto_k": 0.5, "memory": 0.083, "chain": None})
    assert said.sampling_statement(moved) == (
        "draws by resample-move, trusted: importance sampling was uneven (Pareto k 0.50), so its draws were moved "
        "until they no longer depended on where they began (correlation 0.08, at most 0.15 is allowed); "
        "2 maxima of the posterior."
    )
    taken_over = diagnostics.model_copy(update={"method": "emcee", "pareto_k": 1.2})
    assert said.sampling_statement(taken_over).startswith(
        "draws by emcee, after importance sampling failed (Pareto k 1.20): trusted; converged, largest R-hat 1.004"
    )
    without = taken_over.model_copy(update={"chain": None})
    assert said.sampling_statement(without) == "draws by emcee, after importance sampling failed (Pareto k 1.20)."


def test_a_shape_of_weights_that_is_unknown_is_a_dash() -> None:
    unknown = replace(RED, fit=with_diagnostics(RED.fit, pareto_k=None))
    assert "trusted: Pareto k \u2013 (at most 0.7 is allowed)" in said.sampling_statement(unknown.fit.diagnostics)
    assert cells(sampling_table(unknown))["Pareto k of the weights"] == ("\u2013",)
    rough = with_fit(RED, families=tuple(f.model_copy(update={"left_out_pareto_k": None}) for f in RED.fit.families))
    assert cells(families_table(rough))["log-normal in wavenumber (reported)"][-1] == "\u2248 143.5"


def test_the_choice_of_family_is_told_in_words_and_with_its_price() -> None:
    told = said.family_statement(RED)
    assert "log-normal in wavenumber 0.88" in told
    assert "log_normal" not in told
    assert "the 2 families put the mode at 605.6 to 605.6 nm" in told
    assert "unlikely" not in told
    families = tuple(f.model_copy(update={"probability": 0.004}) for f in RED.fit.families)
    assert "unlikely (probability below 0.01)" in said.family_statement(with_fit(RED, families=families))


def test_a_yield_that_cannot_be_is_not_quoted() -> None:
    families = list(RED.fit.families)
    quantities = families[0].quantities
    beyond = quantities["energy_yield"].model_copy(update={"estimate": 4.04, "low95": 3.0, "high95": 5.0})
    families[0] = families[0].model_copy(update={"quantities": {**quantities, "energy_yield": beyond}})
    paint = with_fit(RED, families=tuple(families))
    told = said.family_statement(paint)
    assert "404" not in told
    assert f"{families[0].title}: above 100 %, which no paint emits: the bands contradict this family" in told
    assert "above 100, impossible" in cells(families_table(paint))[families[0].title]
    none = with_fit(RED, families=tuple(f.model_copy(update={"quantities": families[0].quantities}) for f in families))
    told = said.family_statement(none)
    assert " nm and the yield above 100 %, which no paint emits: the bands contradict all families." in told


def test_the_words_on_the_prior_agree_with_the_shares() -> None:
    left = {"mode_nm": 0.01, "stokes_shift_nm": 0.58}
    shares = {name: PriorShare(share=share, shift_sd=0.1) for name, share in left.items()}
    told = said.prior_share_statement(with_fit(RED, prior_shares=shares))
    assert "every quantity" not in told
    assert "the measurement determines the emission: at most" in told
    assert "of the Stokes shift's, 58 % remains" in told


def test_two_maxima_are_told_in_words() -> None:
    assert said.maxima_statement(RED) == ""
    w = RED.fit.wavelength_nm
    one, other = (np.exp(-0.5 * ((w - at) / 12.0) ** 2) for at in (570.0, 650.0))
    paint = with_fit(RED, emission_draws_per_nm=np.array([one + 0.5 * other] * 100))
    assert said.maxima_statement(paint).startswith(
        "Red paint: the spectrum has two maxima (probability 1.00), at 570 nm and at 650 nm"
    )


def test_a_stokes_shift_from_the_prior_is_called_belief() -> None:
    told = said.absorption_statement(RED)
    assert "this comes from the prior and the emission; with one light, the absorption is not measured" in told
    measured = RED.fit.reradiation.model_copy(update={"prior_driven": False, "statement": "three lights fix it"})
    lights = with_fit(RED, reradiation=measured)
    assert said.absorption_statement(lights) == "Red paint: Stokes shift 38 [13, 63] nm. Three lights fix it."
    assert "Stokes shift from the last absorption maximum (measurement and prior)" in cells(absorption_table(lights))
    caption = (
        next(part for part in fit_parts([lights]) if part.title == "Absorption").content.picture_rows[0][0].caption
    )
    assert "narrows at the measured lights" in caption
    assert cells(absorption_table(RED))["excitation lights measured"] == ("450 nm",)


def test_the_largest_shift_by_the_prior_is_named() -> None:
    assert "by 0.21 of its standard deviation, well inside" in said.prior_statement(RED)
    moved = {**RED.fit.prior_sensitivity, "skew": PriorSensitivity(halved=-0.9, doubled=0.3)}
    told = said.prior_statement(with_fit(RED, prior_sensitivity=moved))
    assert "the skew moves most, by 0.90 of its standard deviation, so the prior matters" in told
    assert cells(prior_table(RED))["mode"] == ("-0.12 / +0.21 sd",)


def test_the_paper_stands_beside_the_fit_and_the_truth() -> None:
    rows = cells(quantities_table(GREEN))
    assert [rows[name][-1].split(", ")[-1] for name in ("mode", "FWHM", "energy yield")] == [
        "inside",
        "inside",
        "OUTSIDE",
    ]
    assert rows["mode"][-1] == "519.0 nm, inside"
    assert rows["location (\u03bb\u2080)"][2] == "507.0 [504.1, 509.9] nm"
    alone = quantities_table(FittedPaint(GREEN.bands, GREEN.fit))
    assert alone.columns == ("quantity", "fit", "prior variance remaining (shift)", "the paper's curve alone")
    assert {len(row) for group in alone.groups for row in group.rows} == {4}


def test_the_families_table_marks_what_is_reported_and_what_is_only_indicative() -> None:
    rows = cells(families_table(RED))
    assert rows["log-normal in wavenumber (reported)"][-3:] == ("138.1", "0.88", "143.5")
    assert rows["skew-Cauchy (the paper's)"][-1] == "\u2248 140.2 \u00b1 2.1"  # Pareto k of 0.93
    assert rows["skew-Cauchy (the paper's) alone"][-2:] == ("\u2013", "\u2013")


def test_the_bands_table_marks_what_is_not_used_and_not_explained() -> None:
    rows = cells(bands_table(RED))
    assert "not used" in {row[0] for row in rows.values()}
    assert rows["405 nm"][-1] == "\u2013"  # below the laser nothing is emitted
    used = next(band for band in RED.fit.bands if band.degrees_of_freedom > 0)
    poor = with_fit(RED, bands=tuple(b.model_copy(update={"explained": b is not used}) for b in RED.fit.bands))
    assert cells(bands_table(poor))[f"{used.center_nm:g} nm"][3:5] == ("NO", "0.3 \u00b1 0.9")
    assert said.bands_conclusion(poor).endswith(f"not explained: {used.center_nm:g} nm")


def test_the_chain_is_tabled_only_where_emcee_ran() -> None:
    table = chain_table(RED)
    assert table is not None
    assert cells(table)["filter leak / its nominal value"] == ("1.004", "6350", "8.1", "-0.03")
    alone = replace(RED, fit=with_diagnostics(RED.fit, chain=None))
    assert chain_table(alone) is None
    own = RED.fit.diagnostics.chain.model_copy(update={"mean_shift_sd": {}})
    fallback = replace(RED, fit=with_diagnostics(RED.fit, chain=own, method="emcee"))
    assert cells(chain_table(fallback))["filter leak / its nominal value"][-1] == "\u2013"
    assert said.is_trusted(fallback.fit.diagnostics)
    assert "walkers, steps" in cells(sampling_table(RED))
    assert "walkers, steps" not in cells(sampling_table(alone))


@pytest.fixture(scope="module")
def html() -> str:
    return paint_report(RED.fit, RED.bands)


@pytest.mark.parametrize(("lights_nm", "word"), [((450.0,), "not"), ((450.0, 520.0), "hardly")])
def test_the_terminal_tells_what_several_lights_measured(capsys, lights_nm, word) -> None:
    reradiation = RED.fit.reradiation.model_copy(update={"prior_driven": True, "measured_at_nm": lights_nm})
    _say_result(RED.fit.model_copy(update={"reradiation": reradiation}), Path("red.paint.json"), ())
    assert f"from the prior and the emission: absorption {word} measured)" in capsys.readouterr().out


def test_the_page_is_whole_self_contained_and_begins_with_the_verdict(html: str) -> None:
    page = Page(html)
    assert page.open == []
    assert_stands_alone(html)
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert html.index("Use with care</h2>") < html.index("<img") < html.index(TRUST)
    drawings = [str(image["src"]) for image in page.all("img")]
    assert len(drawings) == 6
    assert all(base64.b64decode(source.split(",")[1]).lstrip().startswith(b"<?xml") for source in drawings)


def test_the_page_shows_what_a_student_needs_to_judge_the_fit(html: str) -> None:
    prose = Page(html).prose.replace("\u00a0", " ")
    for words in (
        "Warning: 3.1 % of the fitted emission lies below the laser line",
        "Stokes shift 38 [13, 63] nm: this comes from the prior and the emission; with one light",
        "camera response R covers only 400 to 780 nm",
        f"centres within {RED.fit.optics.filters[0].center_uncertainty_nm:g} nm",
        "A diffuse paint",
        "The paper's four parameters, in its symbols",
        "Parameter by parameter, by emcee",
        "Fluorescence relative to white",
        "The record was not stored before this page was made",
    ):
        assert words in prose
    assert "the true" not in prose
    assert "Red paint:" not in prose


def test_equal_records_give_equal_pages(html: str) -> None:
    assert paint_report(RED.fit, RED.bands) == html


@pytest.fixture(scope="module")
def other() -> str:
    """Return the page of a stored fit that cannot be trusted, with a hostile name and a tilt test of the paint."""
    tilt = TiltRatio(filter_name="600", tilt_deg=20.0, cosine_factor=1.0, sd=0.01, diffuse=True)
    origin = Provenance(
        created_utc="2026-11-21T20:00:00+00:00",
        command="finray fit red.json",
        package_version="0.1.0",
        git_commit=None,
        python_version="3.11.2",
        input_sha256={"red.json": "ab" * 32},
        seed=1,
    )
    fit = with_diagnostics(CALM, trusted=False).model_copy(update={"provenance": origin, "paint_name": HOSTILE})
    return paint_report(fit, RED.bands.model_copy(update={"tilt_ratios": (tilt,)}))


def test_a_hostile_name_stays_text(other: str) -> None:
    assert HOSTILE not in other
    assert_stands_alone(other)


def test_another_page_has_its_own_verdict_provenance_and_assumptions(other: str) -> None:
    prose = Page(other).prose
    assert prose.startswith("Do not use: ")
    assert "finray fit red.json" in prose
    assert prose.count("\u2717 not good : the draws of the posterior cannot be trusted") == 3
    assert "neither can any number of this page" in prose
    assert "SHA-256 of red.json" in prose
    assert "A diffuse paint" not in prose


def test_the_embedded_json_holds_every_number(html: str) -> None:
    block = re.search(r'<script type="application/json" id="summary">(.*?)</script>', html, re.DOTALL)
    assert block is not None
    numbers = json.loads(block[1])
    assert numbers == plain(fit_summary(FittedPaint(RED.bands, RED.fit)))
    assert "truth" not in numbers["mode_nm"]
    assert set(numbers["families"]) == {"zheng2014", "log_normal_wavenumber"}
    assert numbers["absorption"]["prior_driven"] is True
    assert numbers["paper_curve_alone"]["left_out_bands"] is None


def test_one_estimate_beside_its_truth() -> None:
    narrow = Estimate(estimate=1.0, sd=0.1, low68=0.9, high68=1.1, low95=0.8, high95=1.2)
    assert said.holds(narrow, 1.2)
    assert not said.holds(narrow, 1.21)


def test_lead_and_limits_count_what_the_fit_used() -> None:
    """A filter that mostly leaks is flagged nowhere, so that only the record's own mask leaves it out."""
    first = int(RED.fit.usable.all(axis=1).argmax())
    usable = RED.fit.usable.copy()
    usable[first] = False
    leaked = with_fit(RED, usable=usable, usable_values=RED.fit.usable_values - 3)
    assert f"inferred from {int(usable.sum())} usable signals" in _lead(leaked)
    flagged = int((~RED.bands.usable()).sum())
    told = next(text for text in _fit_limits(leaked) if "are not used" in text)
    assert told.startswith(f"{int((~usable).sum())} of {usable.size} signals are not used: {flagged} are flagged, and ")


def test_a_filter_has_one_label_of_at_most_one_decimal() -> None:
    assert filter_label("450", 450.0, " nm") == "450 nm"
    assert filter_label("470", 468.953, " nm") == "470 (469 nm)"
    assert filter_label("525", 523.0549) == "525 (523.1)"
    named = tuple(b.model_copy(update={"center_nm": b.center_nm + 0.0371, "filter_name": "F"}) for b in RED.fit.bands)
    poor = with_fit(RED, bands=tuple(b.model_copy(update={"explained": False}) for b in named))
    assert re.search(r"not explained: F \(\d+ nm\)", said.bands_conclusion(poor))
    assert re.fullmatch(r"F \(\d+ nm\)", bands_table(poor).groups[0].rows[0][0])
