"""What choosing one angle risks, from joint draws of the objective's curve, and the verdict that follows."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
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
    p_within_tolerance : float
        Probability that the loss of the chosen angle is within the tolerance. Where the curve is flat this is the
        probability that counts: the optimum may lie anywhere on a plateau.
    """

    p_within_5deg: float
    expected_regret_rel: float
    regret_95_rel: float
    equivalent_deg: tuple[tuple[float, float], ...]
    p_within_tolerance: float


def angle_risk(
    curves: Floats, grid_deg: Floats, best: int, tolerance_rel: float, allowed: NDArray[np.bool_] | None = None
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
    allowed : ndarray of bool, shape (G,), optional
        Angles that may be chosen at all; the optimum and the equivalent angles are among them.

    Returns
    -------
    AngleRisk
    """
    open_ = np.ones(grid_deg.size, dtype=np.bool_) if allowed is None else allowed
    choices = curves[:, open_]
    optimum_deg = grid_deg[open_][choices.argmax(axis=1)]
    highest = choices.max(axis=1)
    regret = 1 - curves[:, best] / highest
    equivalent = (curves >= (1 - tolerance_rel) * highest[:, None]).mean(axis=0) >= CONFIDENCE
    return AngleRisk(
        # The grid step need not be a binary fraction, so the limit gets a rounding margin.
        p_within_5deg=float((np.abs(optimum_deg - grid_deg[best]) <= NEARBY_DEG + 1e-9).mean()),
        expected_regret_rel=float(regret.mean()),
        regret_95_rel=float(np.quantile(regret, CONFIDENCE)),
        equivalent_deg=_intervals(grid_deg, equivalent & open_),
        p_within_tolerance=float((regret <= tolerance_rel).mean()),
    )


def verdict_of(simulation_only: AngleRisk, risk: AngleRisk, tolerance_rel: float, validated: bool) -> Verdict:
    """Return the first verdict that applies.

    "undecided": regret from render noise alone exceeds the tolerance. "model-limited": regret with the
    sim-to-real error does, or no capture has shown that error. "tie": the loss is small over an interval wider than
    10 deg. Else "decided".

    Parameters
    ----------
    simulation_only, risk : AngleRisk
        Without and with the sim-to-real error.
    tolerance_rel : float
    validated : bool
        Whether captures tell of the sim-to-real error. A small loss that rests on its prior decides nothing.

    Returns
    -------
    str
    """
    if simulation_only.regret_95_rel > tolerance_rel:
        return "undecided"
    if risk.regret_95_rel > tolerance_rel or not validated:
        return "model-limited"
    widest_deg = max((high - low for low, high in risk.equivalent_deg), default=0.0)
    return "tie" if widest_deg > WIDE_SET_DEG else "decided"


def _intervals(grid_deg: Floats, member: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Return first and last angle of each run of True."""
    edges = np.diff(np.concatenate([[0], member.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return tuple((float(grid_deg[a]), float(grid_deg[b])) for a, b in zip(starts, stops, strict=True))
