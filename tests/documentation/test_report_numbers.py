"""Numbers and sentences of the report: nothing falsely precise, nothing kinder than the records."""

import json
from dataclasses import replace

import numpy as np
import pytest
from example_records import example_decision, example_results

from data_schemas import ErrorAttribution, Interval
from finray_calib.demo import summary
from finray_calib.demo._report import compare_section
from finray_calib.demo._results import all_notes, assumptions, true_loss, trust_limits, truth_statement
from finray_calib.reports import (
    capture_sentence,
    comparison_lines,
    decimals_for,
    decision_table,
    duration,
    error_table,
    fixed,
    interval_text,
    level_a_sentence,
    percent,
    probability,
    signals_table,
    significant,
    simulation_sentence,
)
from finray_calib.reports._decision_page import decision_meaning
from finray_calib.reports._plain_text import WIDTH_COLUMNS, unbroken

RESULTS = example_results()


@pytest.mark.parametrize(
    ("numbers", "unit", "text"),
    [
        ((597.1234, 596.0, 598.3), "nm", "597.1 [596.0, 598.3] nm"),
        ((0.93123, 0.9121, 0.9483), "", "0.931 [0.912, 0.948]"),
        ((1234.5, 1100.2, 1350.9), "px", "1230 [1100, 1350] px"),
        ((0.0, 0.0, 0.0), "", "0"),
        ((1e-9, -2e-4, 2e-4), "", "0.00000 [-0.00020, 0.00020]"),
    ],
)
def test_an_interval_shows_the_digits_it_supports(numbers: tuple[float, float, float], unit: str, text: str) -> None:
    assert interval_text(*numbers, unit) == text


def test_numbers_as_text() -> None:
    assert [fixed(v, 1) for v in (-0.01, np.nan, np.inf, -np.inf)] == ["0.0", "not given", "infinite", "-infinite"]
    assert [significant(v) for v in (0.0, 0.012345, 27756.49, 123456.0, 2e-7, 48.0)] == [
        "0",
        "0.0123",
        "27800",
        "1.23e+05",
        "2.00e-07",
        "48.0",
    ]
    # a number that is rounded to the next power of ten keeps its digits
    assert [significant(v) for v in (9.996, 0.99951, 99960.0)] == ["10.0", "1.00", "100000"]
    assert [fixed(u, decimals_for(u)) for u in (0.0994, 0.0996, 0.996, 9.96, 99.6)] == [
        "0.099",
        "0.10",
        "1.0",
        "10",
        "100",
    ]
    assert [percent(v) for v in (0.02, 0.0142, 0.381, 0.0, 0.0004, 3380.2)] == [
        "2 %",
        "1.4 %",
        "38 %",
        "0 %",
        "below 0.1 %",
        "3380 times",
    ]
    assert [probability(v) for v in (1.0, 0.0, 0.714)] == ["above 0.99", "below 0.01", "0.71"]
    assert [duration(v) for v in (0.94, 44.4, 150.0)] == ["0.9 s", "44 s", "2.5 min"]
    assert decimals_for(0.0) == 3


def test_summary_has_the_promised_keys_in_plain_json() -> None:
    numbers = json.loads(json.dumps(summary(RESULTS), allow_nan=False))
    assert set(numbers["stages"]) == {"capture", "radiometry", "fit", "simulate", "compare", "decide"}
    for colour in ("red", "green"):
        paint = numbers["paints"][colour]
        for key in ("mode_nm", "fwhm_nm", "energy_yield"):
            assert set(paint[key]) == {"estimate", "low95", "high95", "truth"}
        assert len(paint["chi_square_per_band"]) == 8
        assert paint["chi_square"] == pytest.approx(sum(paint["chi_square_per_band"].values()))
    assert numbers["photometric_error"]["headline_skill"]["estimate"] == 0.931
    assert [row["candidate"] for row in numbers["photometric_error"]["regions"][0]["rows"]] == [
        "do nothing",
        "simulation",
        "floor",
    ]
    wanted = {
        "angle_deg": 32.0,
        "p_within_5deg": 0.71,
        "expected_regret": 0.0031,
        "regret_95": 0.0142,
        "verdict": "tie",
    }
    assert {key: numbers["decision"][key] for key in wanted} == wanted


def test_summary_turns_what_is_not_finite_into_null() -> None:
    report = RESULTS.report.model_copy(update={"light_angle_deg": float("nan")})
    numbers = summary(replace(RESULTS, report=report, true_sweeps=()))
    assert numbers["photometric_error"]["light_angle_deg"] is None
    assert numbers["decision"]["true_regret"] is None


def test_every_note_is_listed_once_under_the_stage_that_made_it() -> None:
    note = "48 samples per pixel; render noise 0.6 % of the mean"
    report = RESULTS.report.model_copy(update={"notes": (note, "no repeat"), "withheld": ("PSNR: no scale",)})
    decision = RESULTS.decision.model_copy(update={"notes": ("no repeat", "one angle")})
    green = RESULTS.paints["green"]
    warned = green.calibration.model_copy(update={"warnings": ("two maxima",)})
    paints = {**RESULTS.paints, "green": replace(green, calibration=warned)}
    results = replace(RESULTS, paints=paints, report=report, decision=decision)
    assert all_notes(results) == (
        f"radiometry, both paints: {green.bands.notes[0]}",
        f"fit, red paint: {RESULTS.paints['red'].calibration.warnings[0]}",
        "fit, green paint: two maxima",
        f"simulate: {note}",
        "compare: PSNR: no scale",
        "compare: no repeat",
        "decide: one angle",
    )
    assert "Warning of the green paint's fit: two maxima." in trust_limits(results)
    assert "Withheld: PSNR: no scale." in trust_limits(results)


def test_assumptions_name_what_nobody_measured() -> None:
    listed = assumptions(RESULTS)
    assert listed[0] == "Calibration rig: camera response assumed; lamp spectrum Planck at 2856 K."
    assert "every other number is assumed" in listed[2]
    assert listed[3].startswith("Simulation: 48 samples per pixel")
    bare = RESULTS.press.model_copy(update={"design": None, "notes": ()})
    assert len(assumptions(replace(RESULTS, press=bare))) == 2
    assert listed[1].startswith("Paint emission: log-normal in wavenumber, with a discrepancy of 12 %; from four")
    assert RESULTS.press.design is not None
    unknown = RESULTS.press.model_copy(update={"design": RESULTS.press.design.model_copy(update={"origin": {}})})
    assert "every number is assumed" in assumptions(replace(RESULTS, press=unknown))[2]


def test_lines_break_neither_between_number_and_unit_nor_inside_an_interval() -> None:
    assert unbroken("-0.0 mm, [-0.0, 0.1], -0 % and -0.04") == "0.0\u00a0mm, [0.0,\u00a00.1], 0\u00a0% and -0.04"
    assert unbroken("moved by -0.0. The next by -0.") == "moved by 0.0. The next by 0."
    assert unbroken("run -0.json, version -0.0.1") == "run -0.json, version -0.0.1"
    assert unbroken("allowed +-0 nm (+-0.0 %)") == "allowed +-0\u00a0nm (+-0.0\u00a0%)"
    assert unbroken("--angles=-0.0:90, pad-0.stl, 10-0") == "--angles=-0.0:90, pad-0.stl, 10-0"
    assert unbroken("4.4 % of 597 nm") == "4.4\u00a0% of 597\u00a0nm"
    assert unbroken("0.95 [0.92, 0.97] s") == "0.95 [0.92,\u00a00.97]\u00a0s"
    assert unbroken("4.5 +- 3.1 nats") == "4.5\u00a0\u00b1\u00a03.1 nats"
    assert unbroken("5 months, 3 deg/s") == "5 months, 3 deg/s"


@pytest.mark.parametrize(
    ("verdict", "meaning"),
    [
        ("decided", "stays within 2 % with 95 % probability, and only nearby angles are equally good (25 to 39 deg)"),
        ("tie", "Any of these angles is suitable: 25 to 39 deg"),
        ("undecided", "may lose 0.4 %. With captures the best guess is 32 deg. More angles or more repeats would help"),
        (
            "needs captures",
            "By the renders alone 32 deg loses at most 0.4 %; with the difference between simulation and capture "
            "32 deg is the best guess and may lose 1.4 %",
        ),
    ],
)
def test_each_verdict_says_what_to_do(verdict: str, meaning: str) -> None:
    assert meaning in decision_meaning(example_decision(verdict))


@pytest.mark.parametrize(
    ("low", "high", "meaning"),
    [
        (0.91, 0.95, "explains 93 % of the squared change"),
        (-0.1, 0.95, "is not distinguishable from an unchanged image"),
        (-0.9, -0.1, "worse than leaving the image unchanged"),
    ],
)
def test_the_simulation_is_praised_only_as_far_as_its_interval(low: float, high: float, meaning: str) -> None:
    estimate = 0.93 if high > 0.93 else (low + high) / 2
    skill = Interval(estimate=estimate, low95=low, high95=high)
    report = RESULTS.report.model_copy(update={"headline_skill": skill})
    sentence = simulation_sentence(report)
    assert meaning in sentence
    assert "Doing nothing scores 0, a perfect simulation 1 (the camera's noise is taken out)" in sentence
    assert "a repeated capture scores 0.998, its noise taken out as well" in sentence


def test_noise_is_said_to_be_taken_out_only_where_it_was() -> None:
    """Encoded values keep the camera's noise, whatever the floor tells."""
    encoded = RESULTS.report.model_copy(update={"values": "encoded values, encoding unknown"})
    sentence = simulation_sentence(encoded)
    assert "taken out" not in sentence
    assert "scores 0.998; the noise of encoded values stays in both scores" in sentence


def test_the_console_gives_the_whole_reason_of_what_is_withheld() -> None:
    reason = "relative RMS, " + "gradient and colour error, " * 8 + "are not given: the encoding of it is unknown"
    text = comparison_lines(RESULTS.report.model_copy(update={"withheld": (reason,)}))
    assert f"withheld: {reason}" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= WIDTH_COLUMNS


def test_a_missing_floor_is_said() -> None:
    regions = tuple(region.model_copy(update={"rows": region.rows[:2]}) for region in RESULTS.report.regions)
    report = RESULTS.report.model_copy(update={"regions": regions})
    assert "no repeat was captured" in simulation_sentence(report)


def test_true_loss_of_a_known_curve() -> None:
    sweep = RESULTS.sweep
    values = np.interp(sweep.angles_deg, [0.0, 30.0, 120.0], [0.5, 1.0, 0.1])[:, None] * [1.0, 3.0, 0.2]
    true = sweep.model_copy(update={"values": values})
    best_deg, loss = true_loss([true], 60.0)
    assert best_deg == 30.0
    assert loss == pytest.approx(0.3, rel=1e-12)  # a straight line from 1 at 30 deg to 0.1 at 120 deg
    assert truth_statement(replace(RESULTS, true_sweeps=())) is None
    # at a second place that is three times as bright and alike, the same
    assert true_loss([true, true.model_copy(update={"values": 3 * values})], 60.0) == pytest.approx((best_deg, loss))
    # of two places with opposite slopes no angle is best for both
    back = true.model_copy(update={"values": values[::-1]})
    curve = values.mean(axis=1) / values.mean(axis=1).max()
    both = (curve + curve[::-1]) / 2
    at = np.interp(60.0, sweep.angles_deg, both)
    assert true_loss([true, back], 60.0)[1] == pytest.approx(1 - at / both.max(), abs=1e-9)


def test_tables_name_what_is_not_used() -> None:
    cells = {cell for group in signals_table(RESULTS.paints["red"].fitted).groups for row in group.rows for cell in row}
    assert "weak" in cells
    rows = decision_table(RESULTS.decision).groups[0].rows
    assert rows[0] == ("loss within 2 %, probability", "0.97", "above 0.99")
    assert rows[4] == (
        "angles that lose at most 2 %, with 95 % probability",
        "25 to 39 deg",
        "27 to 37 deg",
    )


def test_withheld_and_identical_values_are_words() -> None:
    row = RESULTS.report.regions[0].rows[1]
    odd = row.model_copy(update={"relative_rms": None, "psnr_db": None, "skill_per_channel": (0.9, None, 0.8)})
    region = RESULTS.report.regions[0].model_copy(update={"rows": (odd,), "clipped_fraction": 0.02})
    report = RESULTS.report.model_copy(
        update={"regions": (region,), "withheld": ("relative RMS: encoding unknown",), "exposure_factor": None}
    )
    assert error_table(report).groups[0].rows[0][2:5] == ("0.90, none, 0.80", "withheld", "identical")
    assert error_table(report).groups[0].heading.endswith("2 % clipped")
    text = comparison_lines(report)
    for words in ("withheld: relative RMS", "identical", "0.90 - 0.80", "2.0 % clipped", "not fitted (1)"):
        assert words in text


def test_blocks_are_named_where_pixels_were_averaged() -> None:
    report = RESULTS.report.model_copy(update={"block_px": 8})
    assert "4600 blocks of 8 x 8 px" in error_table(report).groups[1].heading
    assert "4600 blocks of 8 x 8 px" in comparison_lines(report)
    assert "4600 pixels" in error_table(RESULTS.report).groups[1].heading


def test_the_lead_of_the_comparison_names_grid_and_unit_of_the_exposure_factor() -> None:
    numbers = {"block_px": 8, "exposure_factor": 27756.49, "exposure_factor_sd": None}
    lead = compare_section(replace(RESULTS, report=RESULTS.report.model_copy(update=numbers))).lead
    assert "over blocks of 8 x 8 px" in lead
    assert "one exposure factor for all channels, 27800 DN per unit of panel radiance" in lead
    lead = compare_section(RESULTS).lead
    assert "pixel by pixel" in lead
    assert "1.0340 \u00b1 0.0020 DN" in lead
    unscaled = RESULTS.report.model_copy(update={"exposure_factor": None})
    assert "without any scaling" in compare_section(replace(RESULTS, report=unscaled)).lead


def test_the_papers_emitter_stands_below_the_simulation() -> None:
    assert RESULTS.report_level_a is not None
    with_it = error_table(RESULTS.report, RESULTS.report_level_a).groups[0].rows
    names = ["do nothing", "simulation", "simulation, paper's emitter", "floor"]
    assert [row[0] for row in with_it] == names
    assert with_it[2][1] == "0.702 [0.682, 0.722]"
    assert [row[0] for row in error_table(RESULTS.report).groups[0].rows] == [names[0], names[1], names[3]]
    sentence = level_a_sentence(RESULTS.report, RESULTS.report_level_a)
    assert "is 0.702 [0.682, 0.722]" in sentence
    assert "(the default) it is 0.931 [0.913, 0.949]" in sentence
    assert summary(RESULTS)["photometric_error_level_a"]["headline_skill"]["estimate"] == 0.702
    assert summary(replace(RESULTS, report_level_a=None))["photometric_error_level_a"] is None


def test_the_summary_holds_numbers_and_no_pictures() -> None:
    causes = ErrorAttribution(
        causes=(), skill_lost=0.07, saturation_skill=0.0, noise_skill=0.0, remainder_skill=0.07,
        maps=np.zeros((3, 48, 64), dtype=np.float32),
    )  # fmt: skip
    numbers = summary(replace(RESULTS, report=RESULTS.report.model_copy(update={"attribution": causes})))
    assert numbers["photometric_error"]["attribution"]["skill_lost"] == 0.07
    assert "maps" not in numbers["photometric_error"]["attribution"]
    assert "error_map" not in numbers["photometric_error"]


def test_terminal_table_fits_80_columns_and_holds_every_row() -> None:
    long_name = RESULTS.report.model_copy(update={"simulated": "s" * 300, "label": "l" * 300})
    lines = comparison_lines(long_name).splitlines()
    assert max(map(len, lines)) <= WIDTH_COLUMNS
    for candidate in ("do nothing", "simulation", "floor"):
        assert sum(line.startswith(candidate) for line in lines) == 2
    assert lines[-1] == "headline: skill 0.931 [0.913, 0.949] over contact and halo"


def test_what_the_capture_changed_is_said_as_on_the_page_of_the_decision() -> None:
    """The error is not the same at other angles: a Gaussian process widens it away from the angle of the capture."""
    said = trust_limits(RESULTS)
    assert capture_sentence(RESULTS.decision) in said
    assert not any("same at other angles" in one for one in said)
