"""Objectives beside the one that is decided on: what the decided angle loses under them, and what theirs costs."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import AngleObjective, DecideError
from finray_calib.decide._light_angle import AngleDecision, open_angles, simulated_curve
from finray_calib.decide._swept_contacts import DecidedOn

Floats = NDArray[np.float64]
OPTIMUM_DRAWS: Final = 2000
#: Ends of the 90 % interval: a disagreement, or an agreement, is claimed at 95 % probability each.
_LOW, _HIGH = 0.05, 0.95


@dataclass(frozen=True, slots=True)
class OtherOptimum:
    """Hold the optimum of one further objective, and what the decided angle loses under it.

    Attributes
    ----------
    name, unit : str
        Of the objective.
    best_deg : float
        Angle of greatest posterior mean of the utility, among the angles that the constraints allow.
    at_range_end : bool
        Whether that is an end of the sweep or of the allowed angles, so that a better one may lie beyond.
    values : tuple of (float, float)
        The objective itself, in its unit, at that angle and at the decided one.
    loss_rel, loss_low_rel, loss_high_rel : float
        Relative loss of utility at the decided angle: mean, 5 % and 95 % quantile.
    cost_rel : float
        Relative loss, as expected, of what is decided on at this objective's best angle.
    disagrees : bool or None
        True when the loss exceeds the tolerance with 95 % probability, False when it stays within it with 95 %
        probability, None when the sweep is too noisy to say.
    """

    name: str
    unit: str
    best_deg: float
    at_range_end: bool
    values: tuple[float, float]
    loss_rel: float
    loss_low_rel: float
    loss_high_rel: float
    disagrees: bool | None
    cost_rel: float = 0.0

    def __str__(self) -> str:
        """Say it in one sentence."""
        verdict = {True: "disagrees", False: "agrees", None: "cannot tell"}[self.disagrees]
        end = ", the end of what the sweep allows," if self.at_range_end else ""
        best, decided = (f"{value:.3g}" if self.unit == "1" else f"{value:.3g} {self.unit}" for value in self.values)
        return (
            f"{self.name} {verdict}: best at {self.best_deg:.0f} deg{end} with {best}, {decided} at the decided angle; "
            f"loss {self.loss_rel:.1%} ({self.loss_low_rel:.1%} to {self.loss_high_rel:.1%})"
        )


def other_optima(
    on: DecidedOn, decision: AngleDecision, tolerance_rel: float, rng: np.random.Generator
) -> tuple[OtherOptimum, ...]:
    """Return the optimum of each objective that was not decided on, in the order in which they are stored.

    Parameters
    ----------
    on : DecidedOn
        With or without other objectives.
    decision : AngleDecision
    tolerance_rel : float
        Relative loss that does not matter.
    rng : numpy.random.Generator

    Returns
    -------
    tuple of OtherOptimum
        Empty without other objectives.
    """
    allowed = [contact.allowed for contact in on.contacts if contact.allowed is not None]
    everywhere = np.all(allowed, axis=0) if allowed else None
    angles_deg, grid_deg, value = on.contacts[0].angles_deg, decision.grid_deg, decision.mean_rel
    found = []
    for objective in on.others:
        other = other_optimum(angles_deg, objective, decision.best_deg, tolerance_rel, rng, everywhere)
        there, here = (np.interp(angle, grid_deg, value) for angle in (other.best_deg, decision.best_deg))
        found.append(replace(other, cost_rel=max(0.0, float(1.0 - there / here))))
    return tuple(found)


def other_optimum(
    angles_deg: Floats,
    objective: AngleObjective,
    decided_deg: float,
    tolerance_rel: float,
    rng: np.random.Generator,
    allowed: NDArray[np.bool_] | None = None,
) -> OtherOptimum:
    """Return where a further objective has its optimum, and what the decided angle loses under it.

    A random curve is put through the utility u, each repeat relative to its own mean, as in
    :func:`finray_calib.decide.decide_angle`; the loss is (max u - u(decided)) / max u over its joint draws
    on a grid of 1 deg, the maximum taken over allowed angles. For an objective that is better when smaller, u is its
    inverse, and the objective at the decided angle is 1 / (1 - loss) times its optimum.

    Parameters
    ----------
    angles_deg : ndarray, shape (A,)
        At least 4, increasing.
    objective : AngleObjective
        With at least 2 repeats.
    decided_deg : float
        Within the sweep.
    tolerance_rel : float
    rng : numpy.random.Generator
    allowed : ndarray of bool, shape (A,), optional
        Angles that meet the constraints; between two angles both must.

    Raises
    ------
    DecideError
        When there are too few angles or repeats, the decided angle lies outside the sweep, or no angle is allowed.
    """
    _check(angles_deg, objective, decided_deg, allowed)
    utility = objective.utility
    curve = simulated_curve(angles_deg, utility).posterior
    grid, mean = curve.grid_deg, curve.mean[0]
    draws = curve.draws(OPTIMUM_DRAWS, rng)[:, 0]
    open_grid = open_angles(angles_deg, allowed, grid)
    decided = int(np.abs(grid - decided_deg).argmin())
    best = int(np.where(open_grid, mean, -np.inf).argmax())
    top = np.maximum(draws[:, open_grid].max(axis=1), draws[:, decided])
    loss = 1.0 - draws[:, decided] / top
    low, high = np.quantile(loss, [_LOW, _HIGH]).tolist()
    scale = float(utility.mean())
    at_best, at_decided = (_natural(scale * float(mean[k]), objective) for k in (best, decided))
    return OtherOptimum(
        name=objective.name,
        unit=objective.unit,
        best_deg=float(grid[best]),
        at_range_end=best in np.flatnonzero(open_grid)[[0, -1]].tolist(),
        values=(at_best, at_decided),
        loss_rel=float(loss.mean()),
        loss_low_rel=low,
        loss_high_rel=high,
        disagrees=True if low > tolerance_rel else (False if high <= tolerance_rel else None),
    )


def _natural(utility: float, objective: AngleObjective) -> float:
    """Return the objective in its own unit."""
    return utility if objective.larger_is_better else 1.0 / utility


def _check(
    angles_deg: Floats, objective: AngleObjective, decided_deg: float, allowed: NDArray[np.bool_] | None
) -> None:
    """Refuse what allows no statement."""
    count, repeats = objective.values.shape
    if count != len(angles_deg) or count < 4 or repeats < 2:
        raise DecideError(
            f"{objective.name} has {count} angles and {repeats} repeats for {len(angles_deg)} angles of the sweep; at "
            "least 4 angles with 2 repeats are needed. Simulate the sweep again with more of them."
        )
    if not angles_deg[0] <= decided_deg <= angles_deg[-1]:
        raise DecideError(
            f"The decided angle, {decided_deg:g} deg, lies outside the sweep ({angles_deg[0]:g} to {angles_deg[-1]:g} "
            "deg), where nothing is known of the other objectives. Simulate a wider sweep."
        )
    if allowed is not None and not allowed.any():
        raise DecideError(
            "No angle of the sweep meets the constraints (clipping, room for the panel). Move the panel, or allow a "
            "shorter exposure."
        )
