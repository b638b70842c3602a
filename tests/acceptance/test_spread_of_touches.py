"""Standard deviations that a check judges by their upper confidence limit, and touches that give no number."""

import math

import numpy as np
import pytest

from data_schemas import CheckedTouch, PressFacts, TactileCheckPlan
from finray_calib.acceptance import _press_checks as device_checks
from finray_calib.acceptance._conformity import ToleranceInterval, measured

LIMIT_MM = 0.05


def test_a_standard_deviation_at_its_limit_passes_in_five_percent() -> None:
    rng, number = np.random.default_rng(1), 10
    spreads_mm = rng.normal(0.0, LIMIT_MM, (4000, number)).std(axis=1, ddof=1)
    passed = 0
    for s_mm in spreads_mm:
        row = measured(
            "touch", "x", "x", float(s_mm), float(s_mm) / math.sqrt(2.0 * (number - 1)), "mm", "",
            limits=ToleranceInterval(None, LIMIT_MM),
        )  # fmt: skip
        passed += device_checks._by_chi_square(row, number, LIMIT_MM).verdict == "PASS"  # noqa: SLF001
    # standard deviation of the share: 0.0034
    assert abs(passed / 4000 - 0.05) < 0.0135


def test_a_force_that_does_not_grow_gives_no_play_and_no_infinity() -> None:
    touch = CheckedTouch(
        side="base", touch_mm=-6.0, touch_uncertainty_mm=0.01, from_above_n=1.0, from_below_n=1.0, deeper_n=1.0,
        deeper_mm=0.1, noise_n=0.001, relaxed_n=0.0, zero_shift_n=0.0,
    )  # fmt: skip
    assert device_checks.backlash_mm((touch,) * 4) is None
    row = measured("touch", "x", "x", math.nan, math.nan, "mm", "", limits=ToleranceInterval(-0.05, 0.05))
    assert (row.verdict, row.value, row.sd) == ("UNDECIDED", None, None)


def touched(touch_mm: float) -> CheckedTouch:
    return CheckedTouch(
        side="base", touch_mm=touch_mm, touch_uncertainty_mm=0.005, from_above_n=1.0, from_below_n=1.0, deeper_n=1.2,
        deeper_mm=0.1, noise_n=0.001, relaxed_n=0.0, zero_shift_n=0.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("scatter_mm", "apart_mm", "verdict"),
    [(0.0, 0.0, "PASS"), (0.0, 0.02, "PASS"), (0.0, 0.08, "UNDECIDED"), (0.06, 0.0, "UNDECIDED")],
)
def test_touches_that_scatter_do_not_show_that_the_position_survived(
    scatter_mm: float, apart_mm: float, verdict: str
) -> None:
    """Two touches after the stops whose mean is right, at a limit of 0.05 mm."""
    before = tuple(touched(-6.0 + scatter_mm * sign) for sign in (-1, 1, 1, -1, 1, -1))
    facts = PressFacts(touches=before, after_stops=(touched(-6.0 - apart_mm / 2), touched(-6.0 + apart_mm / 2)))
    (row,) = device_checks._after_stops(facts, TactileCheckPlan(check_name="x", position_mm=8.0))  # noqa: SLF001
    assert row.value == pytest.approx(0.0, abs=1e-12)
    assert row.sd >= 0.005 * math.sqrt(2.0)
    assert row.verdict == verdict, row


@pytest.mark.parametrize(
    ("before", "after", "why"),
    [
        (6, 1, "1 after the stops (2 are needed)"),
        (3, 2, "3 before the stops (4 are needed)"),
        (3, 0, "0 after the stops (2 are needed) and 3 before the stops (4 are needed)"),
    ],
)
def test_too_few_touches_are_counted_before_and_after_the_stops(before: int, after: int, why: str) -> None:
    facts = PressFacts(touches=(touched(-6.0),) * before, after_stops=(touched(-6.0),) * after)
    (row,) = device_checks._after_stops(facts, TactileCheckPlan(check_name="x", position_mm=8.0))  # noqa: SLF001
    assert row.verdict == "UNDECIDED"
    assert f"too few touches were made: {why}" in row.model_dump_json()


def test_the_scatter_of_touches_is_that_of_their_difference() -> None:
    """2000 stages that lose nothing: the difference over its uncertainty is beyond 1.645 in no more than 10 %."""
    rng, beyond, plan = np.random.default_rng(2), 0, TactileCheckPlan(check_name="x", position_mm=8.0)
    for _ in range(2000):
        places = rng.normal(-6.0, 0.03, 12)
        tiny = [touched(float(mm)).model_copy(update={"touch_uncertainty_mm": 1e-6}) for mm in places]
        facts = PressFacts(touches=tuple(tiny[:10]), after_stops=tuple(tiny[10:]))
        (row,) = device_checks._after_stops(facts, plan)  # noqa: SLF001
        beyond += abs(row.value) > 1.645 * row.sd
    # without the scatter it is nearly always beyond; standard deviation of the share: 0.007
    assert beyond / 2000 < 0.10 + 3 * 0.007


@pytest.mark.parametrize(("moved_mm", "verdict"), [(0.0, "PASS"), (0.03, "PASS"), (0.08, "FAIL"), (-0.08, "FAIL")])
def test_steps_that_stops_lose_are_found(moved_mm: float, verdict: str) -> None:
    before = (touched(-6.0),) * 10
    facts = PressFacts(touches=before, after_stops=(touched(-6.0 + moved_mm),) * 2)
    (row,) = device_checks._after_stops(facts, TactileCheckPlan(check_name="x", position_mm=8.0))  # noqa: SLF001
    assert row.value == pytest.approx(moved_mm, abs=1e-12)
    assert row.verdict == verdict, row


@pytest.mark.parametrize(
    "lie",
    [
        {"deeper_n": 1.004},  # the stage went deeper and the force did not grow: 5 sd of a difference are 0.007 N
        {"zero_shift_n": 0.3},  # what was felt stayed when the stage had left
        {"from_above_n": 0.004, "deeper_n": 0.2},  # hardly above noise
        {"from_above_n": -1.0, "deeper_n": 1.0, "zero_shift_n": 0.0},
    ],
    ids=["grows not", "stays", "in the noise", "negative"],
)
def test_a_touch_that_is_none_makes_no_witness(lie: dict[str, float]) -> None:
    good = touched(-6.0)
    assert device_checks.unfelt(PressFacts(touches=(good,) * 4)) is None
    facts = PressFacts(touches=(good, good, good.model_copy(update=lie), good))
    assert "do not confirm each other" in device_checks.unfelt(facts)
    assert "do not confirm each other" in device_checks.unfelt(
        PressFacts(touches=(good,) * 4, after_stops=facts.touches)
    )


def test_what_the_pad_relaxes_is_in_the_uncertainty_of_play() -> None:
    """Twice 0.02 N at a stiffness of 2 N/mm: 0.02 mm, beside noise of 0.0004 mm."""
    relaxing = tuple(touched(-6.0).model_copy(update={"relaxed_n": 0.02}) for _ in range(10))
    still = device_checks.backlash_mm((touched(-6.0),) * 10)
    found = device_checks.backlash_mm(relaxing)
    assert still is not None
    assert found is not None
    assert still[1] < 0.001
    assert found[1:] == pytest.approx((0.02, 0.02), rel=0.01)
