"""Optima of further objectives: known parabolas, constraints, and refusals."""

import numpy as np
import pytest

from data_schemas import AngleObjective, DecideError
from finray_calib.decide._swept_contacts import other_optimum

ANGLES_DEG = np.arange(0.0, 121.0, 10.0)
TOLERANCE_REL = 0.02


def objective(best_deg, larger_is_better, noise=0.001, seed=1):
    """Return an objective whose utility is a parabola, 1 at the best angle and lower by 0.5 at 90 deg from it."""
    utility = 1.0 - 0.5 * ((ANGLES_DEG - best_deg) / 90.0) ** 2
    rng = np.random.default_rng(seed)
    utility = utility[:, None] * (1.0 + noise * rng.standard_normal((ANGLES_DEG.size, 4)))
    values = utility if larger_is_better else 2.0 / utility
    return AngleObjective(name="made up", meaning="", unit="deg", larger_is_better=larger_is_better, values=values)


@pytest.mark.parametrize("larger_is_better", [True, False])
def test_optimum_and_loss_are_those_of_the_parabola(larger_is_better):
    other = other_optimum(ANGLES_DEG, objective(30.0, larger_is_better), 75.0, TOLERANCE_REL, np.random.default_rng(1))
    # noise of 0.1 % moves the top of this parabola by about sqrt(0.001 / 2 / 0.5) * 90 = 3 deg at most
    assert other.best_deg == pytest.approx(30.0, abs=4.0)
    assert other.loss_rel == pytest.approx(0.125, abs=0.005)
    assert other.loss_low_rel <= other.loss_rel <= other.loss_high_rel
    assert other.disagrees is True
    assert other.values[1] == pytest.approx(0.875 if larger_is_better else 2.0 / 0.875, rel=0.005)
    assert "best at" in str(other)
    assert "disagrees" in str(other)


def test_agreement_near_the_top_and_doubt_in_noise():
    rng = np.random.default_rng(2)
    near = other_optimum(ANGLES_DEG, objective(30.0, True), 36.0, TOLERANCE_REL, rng)
    assert near.disagrees is False
    noisy = other_optimum(ANGLES_DEG, objective(30.0, True, noise=0.1), 50.0, TOLERANCE_REL, rng)
    assert noisy.disagrees is None


def test_only_allowed_angles_compete():
    allowed = ANGLES_DEG >= 60.0
    other = other_optimum(ANGLES_DEG, objective(30.0, True), 75.0, TOLERANCE_REL, np.random.default_rng(3), allowed)
    assert other.best_deg == pytest.approx(60.0)
    assert other.at_range_end
    assert "60 deg (the end of the allowed angles) with" in str(other)
    # 1 - 0.5 / 4 at 75 deg over 1 - 0.5 / 9 at 60 deg
    assert other.loss_rel == pytest.approx(1.0 - 0.875 / (1.0 - 0.5 / 9.0), abs=0.005)


@pytest.mark.parametrize(
    ("angles", "decided_deg", "allowed", "said"),
    [
        (ANGLES_DEG[:3], 10.0, None, "at least 4 angles"),
        (ANGLES_DEG, 130.0, None, "outside the sweep"),
        (ANGLES_DEG, 30.0, np.zeros(13, dtype=bool), "No angle of the sweep meets the constraints"),
    ],
)
def test_what_allows_no_statement_is_refused(angles, decided_deg, allowed, said):
    with pytest.raises(DecideError, match=said):
        other_optimum(angles, objective(30.0, True), decided_deg, TOLERANCE_REL, np.random.default_rng(4), allowed)
