"""What choosing one angle risks, from joint draws of the objective's curve, and the verdict that follows."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from finray_calib.decide.gaussian_process import PRIOR_LENGTH_DEG, CurvePosterior, Matern52

Verdict = Literal["decided", "tie", "undecided", "model-limited"]

#: Two angles closer than this count as the same choice.
NEARBY_DEG = 5.0
#: Probability with which regret stays below its bound, and with which an equivalent angle is within tolerance.
CONFIDENCE = 0.95
#: A set of equivalent angles wider than this leaves the choice to the mechanical designer.
WIDE_SET_DEG = 10.0


@dataclass(frozen=True, slots=True)
class AngleRisk:
    """Hold what choosing one angle risks.

    Attributes
    ----------
    p_within_5deg : float
        Probability that the true optimum lies within 5 deg of the chosen angle.
    expected_regret_rel, regret_95_rel : float
        Loss of the objective against its true maximum, relative to that maximum: its mean, and the bound it
        stays below with 95 % probability.
    equivalent_deg : tuple of (float, float)
        Intervals of angles whose loss is within the tolerance with 95 % probability; may be empty.
    """

    p_within_5deg: float
    expected_regret_rel: float
    regret_95_rel: float
    equivalent_deg: tuple[tuple[float, float], ...]


def angle_risk(
    curves: NDArray[np.float64], grid_deg: NDArray[np.float64], best: int, tolerance_rel: float
) -> AngleRisk:
    """Return the risk of choosing one grid angle.

    For each drawn curve f the regret is (max f - f(best)) / max f. Valid for curves with a positive maximum.

    Parameters
    ----------
    curves : ndarray, shape (S, G)
        Joint draws of the curve.
    grid_deg : ndarray, shape (G,)
    best : int
        Index of the chosen angle.
    tolerance_rel : float
        Relative loss that does not matter.

    Returns
    -------
    AngleRisk
    """
    loss = 1 - curves / curves.max(axis=1, keepdims=True)
    regret = loss[:, best]
    distance_deg = np.abs(grid_deg[curves.argmax(axis=1)] - grid_deg[best])
    equivalent = (loss <= tolerance_rel).mean(axis=0) >= CONFIDENCE
    return AngleRisk(
        # The grid step need not be a binary fraction, so the limit gets a rounding margin.
        p_within_5deg=float((distance_deg <= NEARBY_DEG + 1e-9).mean()),
        expected_regret_rel=float(regret.mean()),
        regret_95_rel=float(np.quantile(regret, CONFIDENCE)),
        equivalent_deg=_intervals(grid_deg, equivalent),
    )


def discrepancy_covariance(posterior: CurvePosterior, discrepancy_rel: float) -> NDArray[np.float64]:
    """Return the covariance that a relative sim-to-real error adds to the curve.

    C = diag(m) P k P diag(m) with the curve's mean m, a Matern-5/2 k of that amplitude and length 35 deg, and
    P removing the mean over the grid: a scale common to all angles cannot change the ranking.

    Parameters
    ----------
    posterior : CurvePosterior
    discrepancy_rel : float
        Relative error of the objective, one standard deviation.

    Returns
    -------
    ndarray, shape (G, G)
    """
    covariance = Matern52(PRIOR_LENGTH_DEG, discrepancy_rel).covariance(posterior.grid_deg, posterior.grid_deg)
    covariance = covariance - covariance.mean(axis=0)
    covariance = covariance - covariance.mean(axis=1, keepdims=True)
    return np.asarray(covariance * np.outer(posterior.mean, posterior.mean))


def verdict_of(simulation_only: AngleRisk, with_discrepancy: AngleRisk | None, tolerance_rel: float) -> Verdict:
    """Return the first verdict that applies.

    "undecided": regret from render noise alone exceeds the tolerance. "model-limited": regret with the
    sim-to-real error does. "tie": the loss is small over an interval wider than 10 deg. Else "decided".

    Parameters
    ----------
    simulation_only : AngleRisk
    with_discrepancy : AngleRisk or None
        None where no sim-to-real error is known; the rule then looks at the simulation alone.
    tolerance_rel : float

    Returns
    -------
    str
    """
    final = with_discrepancy or simulation_only
    if simulation_only.regret_95_rel > tolerance_rel:
        return "undecided"
    if final.regret_95_rel > tolerance_rel:
        return "model-limited"
    widest_deg = max((high - low for low, high in final.equivalent_deg), default=0.0)
    return "tie" if widest_deg > WIDE_SET_DEG else "decided"


def _intervals(grid_deg: NDArray[np.float64], member: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Return first and last angle of each run of True."""
    edges = np.diff(np.concatenate([[0], member.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return tuple((float(grid_deg[a]), float(grid_deg[b])) for a, b in zip(starts, stops, strict=True))
