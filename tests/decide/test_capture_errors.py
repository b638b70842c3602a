"""What photometric error reports say about a sweep's objective: shares, covariance, and what is refused."""

import numpy as np
import pytest

from data_schemas import DecideError, Interval, ObjectiveError, PhotometricErrorReport
from finray_calib.decide._capture_errors import (
    LEAST_SD_REL,
    NO_CAPTURES,
    UNSTATED_ANGLE_SD_DEG,
    objective_log_error,
)
from finray_calib.decide._capture_errors import capture_errors as errors_of
from tests.command_line.records import sweep as sweep_record

DRAWS = 500


def capture_errors(sweep, reports):
    """Captures of one touch."""
    return errors_of([sweep], reports, [0] * len(reports))


def objective_error(log_ratio, log_exposure=None, source="paints", sd=0.0, rng=None, rig="rig 1"):
    noise = 0.0 if rng is None else sd * rng.standard_normal((DRAWS, 3))
    return ObjectiveError(
        error_rel=Interval(estimate=0.0, low95=-1.0, high95=1.0),
        log_ratio_draws=np.broadcast_to(log_ratio, (DRAWS, 3)) + noise,
        log_exposure_draws=None if log_exposure is None else np.full(DRAWS, float(log_exposure)),
        source=source,
        rig=rig,
    )


def report(captured, angle_deg, error, angle_sd_deg=1.0, findings=(), forced_mismatch=False):
    """Only what a decision reads."""
    return PhotometricErrorReport.model_construct(
        captured=captured,
        label="rendered, level b, llvm_ad_rgb",
        values="encoded values, encoding unknown" if error is None else "linear light",
        light_angle_deg=angle_deg,
        light_angle_uncertainty_deg=angle_sd_deg,
        objective_error=error,
        findings=findings,
        forced_mismatch=forced_mismatch,
    )


def with_channels(shares_at_0, shares_at_120):
    """The hill of the records with shares that change linearly over the angle."""
    plain = sweep_record()
    along = plain.angles_deg / 120
    shares = np.outer(1 - along, shares_at_0) + np.outer(along, shares_at_120)
    channels = 3 * plain.values[..., None] * shares[:, None, :]
    return plain.model_copy(update={"channels": channels})


def test_error_of_a_weighted_sum_is_that_of_its_captured_value():
    simulated, captured, weights = np.array([2.0, 5.0, 1.0]), np.array([1.7, 5.5, 1.1]), np.array([0.2, 1.0, 3.0])
    share = weights * simulated / (weights @ simulated)
    found = objective_log_error(np.log(simulated / captured)[None, :], share)
    assert found == pytest.approx(np.log(weights @ simulated / (weights @ captured)))


def test_shares_are_those_of_the_sweep_at_the_angle_of_the_capture():
    sweep = with_channels([0.2, 0.3, 0.5], [0.6, 0.3, 0.1])
    ratio = np.array([0.3, 0.0, -0.2])
    (found, _) = capture_errors(sweep, [report("a", 30.0, objective_error(ratio))])
    expected = -np.log(np.array([0.3, 0.3, 0.4]) @ np.exp(-ratio))
    assert found.log_error == pytest.approx([expected])
    assert found.scale_of is None
    # a sweep of an older version knows no shares; one beyond the sweep holds the last
    (equal, _) = capture_errors(sweep_record(), [report("a", 30.0, objective_error(ratio))])
    assert equal.log_error == pytest.approx([-np.log(np.exp(-ratio).mean())])
    (beyond, _) = capture_errors(sweep, [report("a", 123.0, objective_error(ratio))])
    assert beyond.log_error == pytest.approx([-np.log(np.array([0.6, 0.3, 0.1]) @ np.exp(-ratio))])


def test_two_angles_with_exposure_and_current_compare_absolute_ratios():
    ratio = np.array([0.1, 0.1, 0.1])
    reports = [report("a", 10.0, objective_error(ratio, 4.0)), report("b", 60.0, objective_error(ratio, 4.3))]
    found, notes = capture_errors(sweep_record(), reports)
    assert found.log_error == pytest.approx([0.1 - 4.0, 0.1 - 4.3])
    assert found.scale_of.tolist() == [0, 0]
    assert notes == ()
    # one angle twice says nothing of the shape: relative to the no-contact images again
    same, notes = capture_errors(sweep_record(), [reports[0], report("c", 10.5, objective_error(ratio, 4.1))])
    assert notes == ()
    assert same.scale_of is None
    assert same.log_error == pytest.approx([0.1, 0.1])


def test_captures_that_cannot_be_compared_with_the_others_are_left_out_and_named():
    ratio = np.zeros(3)
    reports = [
        report("a", 10.0, objective_error(ratio, 4.0)),
        report("no current", 30.0, objective_error(ratio)),
        report("b", 60.0, objective_error(ratio, 4.0)),
        report("other rig", 80.0, objective_error(ratio, 1.0, rig="rig 2")),
    ]
    found, notes = capture_errors(sweep_record(), reports)
    assert found.names == ("a", "b")
    assert [note.split(" is left out")[0] for note in notes] == ["no current", "other rig"]
    second = report("other rig, far", 30.0, objective_error(ratio, 1.0, rig="rig 2"))
    found, _ = capture_errors(sweep_record(), [*reports, second])
    assert found.names == ("a", "b", "other rig", "other rig, far")
    assert found.scale_of.tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize("other", [{"rig": "rig 2"}, {"rig": None}, {"source": "other paints"}])
def test_captures_without_a_common_rig_and_paints_share_no_scale(other):
    """A rig that nobody named may be any: exposures of two rigs differ by their lenses, LEDs and gains."""
    ratio = np.full(3, 0.1)
    first = objective_error(ratio, 4.0, **(other if other.get("rig", "") is None else {}))
    reports = [report("a", 10.0, first), report("b", 60.0, objective_error(ratio, 9.0, **other))]
    found, notes = capture_errors(sweep_record(), reports)
    assert found.scale_of is None
    assert found.log_error == pytest.approx([0.1, 0.1])
    (note,) = notes
    assert "known at several angles but were not compared, because the reports do not name one rig" in note


@pytest.mark.parametrize(("angle_deg", "kept"), [(-5.0, True), (-5.5, False), (125.0, True), (126.0, False)])
def test_a_capture_outside_the_sweep_validates_nothing(angle_deg, kept):
    found, notes = capture_errors(sweep_record(), [report("far", angle_deg, objective_error(np.zeros(3)))])
    assert bool(found.names) is kept
    if not kept:
        assert found == NO_CAPTURES
        assert notes == (
            f"far is left out and does not validate the decision, because its light was at {angle_deg:g} deg, outside "
            "the sweep (0 to 120 deg)",
        )


def test_what_the_checks_found_and_other_paints_are_told():
    red, green = "ab" * 32, "cd" * 32
    sweep = sweep_record().model_copy(update={"paints": {"red": red, "green": green}})
    error = objective_error(np.zeros(3), source=f"{red}; camera")
    stands = "no drift of the camera that matters, by the images with contact: 0.1 px"
    reports = [report("a", 30.0, error, 1.0, ("the camera has drifted: 4 px", stands)), report("b", 40.0, error)]
    _, notes = capture_errors(sweep, reports)
    assert notes == (
        "a: the camera has drifted: 4 px",
        f"the reports on a, b do not name the green paint of the sweep (SHA-256 {green}), so their renders may have "
        "another paint",
    )


@pytest.mark.parametrize("emitter", ["paper's emitter", "paper's emitter, inverse square"])
def test_an_error_of_the_papers_emitter_says_nothing_about_the_angle(emitter):
    of_level_a = report("a", 10.0, objective_error(np.zeros(3))).model_copy(
        update={"label": f"rendered, level a ({emitter}), llvm_ad_rgb"}
    )
    with pytest.raises(
        DecideError, match=r"the report on a belongs to a render of level a \('rendered, .*\), whose walls emit "
        r"the same at every angle of the light, so .* a sweep of level b\. Simulate the press with --level b",
    ):  # fmt: skip
        capture_errors(sweep_record(), [of_level_a])


def test_reports_of_one_source_share_their_draws():
    rng = np.random.default_rng(1)
    shared = rng.standard_normal((DRAWS, 3)) * 0.05
    plain = objective_error(np.zeros(3))
    first = plain.model_copy(update={"log_ratio_draws": shared})
    second = plain.model_copy(update={"log_ratio_draws": 2 * shared})
    other = second.model_copy(update={"source": "other paints"})
    reports = [report("a", 10.0, first), report("b", 50.0, second), report("c", 90.0, other)]
    found, _ = capture_errors(sweep_record(), reports)
    draws = [-np.log(np.exp(-factor * shared).mean(axis=1)) for factor in (1, 2)]
    expected = np.cov(draws, ddof=0)
    least = LEAST_SD_REL**2
    assert found.covariance[:2, :2] == pytest.approx(expected + least * np.eye(2), rel=1e-9)
    assert found.covariance[2].tolist() == pytest.approx([0.0, 0.0, expected[1, 1] + least])


def test_an_unstated_uncertainty_of_the_angle_is_assumed_and_named():
    found, notes = capture_errors(sweep_record(), [report("a", 10.0, objective_error(np.zeros(3)), None)])
    assert found.angle_sd_deg.tolist() == [UNSTATED_ANGLE_SD_DEG]
    assert notes == (
        "the standard uncertainty of the light's angle is assumed to be 2 deg for these captures, which state none: a",
    )


def test_no_report_is_no_capture():
    assert capture_errors(sweep_record(), []) == (NO_CAPTURES, ())


def test_what_would_mislead_is_refused():
    good = report("a", 30.0, objective_error(np.zeros(3)))
    with pytest.raises(
        DecideError,
        match=r"two reports are on the capture 'a', which would count twice. Give one report for each capture",
    ):
        capture_errors(sweep_record(), [good, report("b", 30.0, objective_error(np.zeros(3))), good])
    with pytest.raises(
        DecideError,
        match=r"b is relative, so it judges how .* Compare again without --relative, or leave the report out",
    ):
        capture_errors(sweep_record(), [good.model_copy(update={"captured": "b", "relative": True})])
    with pytest.raises(DecideError, match=r"b contains no brightness error, because its values are 'encoded values"):
        capture_errors(sweep_record(), [good, report("b", 30.0, None)])
    unknown = report("b", 30.0, None).model_copy(update={"values": "linear light"})
    with pytest.raises(DecideError, match=r"b contains no brightness error, because the render has no draws .*--paint"):
        capture_errors(sweep_record(), [good, unknown])
    with pytest.raises(
        DecideError, match=r"b does not state the angle of the light, .* write light_angle_deg \(-180 to 180 deg\)"
    ):
        capture_errors(sweep_record(), [good, report("b", None, objective_error(np.zeros(3)))])
    forced = report("b", 40.0, objective_error(np.zeros(3)), 1.0, ("channel order: as BGR",), forced_mismatch=True)
    with pytest.raises(
        DecideError, match=r"b was made despite a mismatch \(channel order: as BGR\), .*; correct the capture"
    ):
        capture_errors(sweep_record(), [good, forced])
