"""The decision rule: closed forms, and the rate at which it errs."""

import numpy as np
import pytest
from scipy.stats import binom, norm

from finray_calib.acceptance import GUARD_FACTOR
from finray_calib.acceptance._conformity import limit_text, overall, unmeasured, verdict_of

DRAWS = 40_000
# A correct rule leaves this interval in one of a million runs of the seed; the seed is fixed.
SURE = 1e-6


def test_the_factor_is_the_one_sided_95_percent_point():
    assert pytest.approx(norm.ppf(0.95), abs=5e-4) == GUARD_FACTOR


@pytest.mark.parametrize(
    ("value", "sd", "low", "high", "verdict"),
    [
        (1.0, 0.0, None, 1.0, "PASS"),
        (1.0 + 1e-12, 0.0, None, 1.0, "FAIL"),
        (0.8, 0.1, None, 1.0, "PASS"),
        (0.9, 0.1, None, 1.0, "UNDECIDED"),
        (1.1, 0.1, None, 1.0, "UNDECIDED"),
        (1.2, 0.1, None, 1.0, "FAIL"),
        (1.2, 0.1, 1.0, None, "PASS"),
        (0.8, 0.1, 1.0, None, "FAIL"),
        (0.0, 0.1, -1.0, 1.0, "PASS"),
        (-0.9, 0.1, -1.0, 1.0, "UNDECIDED"),
        (-1.2, 0.1, -1.0, 1.0, "FAIL"),
        (0.0, 1.0, -1.0, 1.0, "UNDECIDED"),  # limits narrower than the uncertainty
        (0.0, float("inf"), -1.0, 1.0, "UNDECIDED"),
        (5.0, 0.1, None, None, "PASS"),
    ],
)
def test_verdicts(value, sd, low, high, verdict):
    assert verdict_of(value, sd, low, high) == verdict


@pytest.mark.parametrize(("apart_sds", "verdict"), [(0.0, "PASS"), (0.0, "FAIL"), (1.0, "PASS"), (2.5, "PASS")])
def test_the_guard_band_errs_at_its_nominal_rate(apart_sds, verdict):
    limit, sd = 10.0, 0.3
    values = np.random.default_rng(5).normal(limit + apart_sds * sd, sd, DRAWS)
    count = sum(verdict_of(float(value), sd, None, limit) == verdict for value in values)
    expected = norm.cdf(-GUARD_FACTOR - apart_sds)  # 5 % at the limit, less beyond it
    low, high = binom.ppf([SURE / 2, 1 - SURE / 2], DRAWS, expected)
    assert low <= count <= high


def test_the_worst_verdict_is_that_of_the_report():
    results = [unmeasured("wheel", v, "", v, "") for v in ("PASS", "UNDECIDED", "ERROR", "FAIL")]
    assert [overall(tuple(results[:n])) for n in (1, 2, 3, 4)] == ["PASS", "UNDECIDED", "ERROR", "FAIL"]
    assert overall(()) == "UNDECIDED"


def test_limits_in_words():
    assert limit_text(None, 1.0, "s") == "at most 1 s"
    assert limit_text(2.0, None, "e") == "at least 2 e"
    assert limit_text(-1.0, 1.0, "%") == "-1 to 1 %"
    assert limit_text(None, None, "s") == ""
