"""Standard deviations that a check judges by their upper confidence limit, and touches that give no number."""

import math

import numpy as np

from data_schemas import CheckedTouch
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
