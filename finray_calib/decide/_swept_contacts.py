"""What sweeps say of each place, and what the decided angle loses under the objectives that it was not decided on.

Brightness of the touch, or expected error of the sensed normal along the pad. A repeat of a sweep has its own paths
and its own draw of both paints. Paths average out over the repeats; the paint of the real finger is one draw, so that
its scatter must be kept. The bands of each repeat are stored beside its colours, and colours are linear in bands: every
draw of the paints can be put on the bands of every repeat, which takes the two apart exactly. Of the error of the
normal this cannot be told, and the whole scatter is kept.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    AngleObjective,
    DecideError,
    LightAngleSweep,
    finger_identity,
    look_like_radians,
    narrow_sweep_text,
)
from finray_calib.decide._light_angle import AngleDecision, SweptContact, open_angles, simulated_curve

Floats = NDArray[np.float64]
#: What is decided on.
Aim = Literal["brightness", "normal"]


@dataclass(frozen=True, slots=True)
class DecidedOn:
    """Hold what is decided on.

    Attributes
    ----------
    aim : str
        "brightness" of each touch, or error of the sensed "normal" at places along the pad, whose inverse counts.
    objective : str
        What it means.
    contacts : tuple of SweptContact
        One for each touch or place.
    places_mm : tuple of float
        Of the places along the pad; empty for touches.
    others : tuple of AngleObjective
        What else the sweeps tell.
    """

    aim: Aim
    objective: str
    contacts: tuple[SweptContact, ...]
    places_mm: tuple[float, ...]
    others: tuple[AngleObjective, ...]


def decided_on(
    sweeps: Sequence[LightAngleSweep],
    weights: Sequence[float] | None,
    narrow_sweep: bool,
    aim: Aim | None,
    captured: bool,
) -> DecidedOn:
    """Return what is decided on: the error of the normal where the sweeps hold it, else the brightness of each touch.

    Captures tell of the brightness, and weights are of touches: with either the brightness is decided on, unless the
    other is asked for.

    Parameters
    ----------
    sweeps
        Of one finger, paints and objective, over the same angles.
    weights
        How often each touch occurs; None: all alike.
    narrow_sweep
        Whether angles that span less than 4 deg are meant so.
    aim
        What is asked for; None: see above.
    captured
        Whether there are reports on captures.

    Raises
    ------
    DecideError
        The sweeps do not belong together or lack what is asked for, weights do not fit, or angles look like radians.
    """
    touches = swept_contacts(sweeps, weights, narrow_sweep)
    others = next((sweep.other_objectives for sweep in sweeps if sweep.other_objectives), ())
    normal = next((objective for objective in others if objective.place_values is not None), None)
    if aim == "normal" and (captured or weights is not None):
        raise DecideError(
            f"a decision on the error of the normal cannot use {'reports on captures' if captured else 'weights'}, "
            "because "
            f"{'reports measure the brightness' if captured else 'weights apply to touches, but this error to places'}"
            ". Leave them out, or decide on the brightness (--aim brightness)"
        )
    if aim == "normal" and normal is None:
        raise DecideError(
            "the decision on the error of the normal was requested, but the sweeps do not contain this error at places "
            "along the pad; simulate them with --objectives all, or decide on the brightness (--aim brightness)"
        )
    if normal is None or aim == "brightness" or (aim is None and (captured or weights is not None)):
        return DecidedOn("brightness", sweeps[0].objective, tuple(touches), (), others)
    return _normal_along(sweeps, normal, touches, others)


def _normal_along(
    sweeps: Sequence[LightAngleSweep],
    normal: AngleObjective,
    touches: Sequence[SweptContact],
    others: Sequence[AngleObjective],
) -> DecidedOn:
    """Return the inverse error of the normal at each place along the pad, and brightness among the others."""
    allowed = [touch.allowed for touch in touches if touch.allowed is not None]
    everywhere = np.all(allowed, axis=0) if allowed else None
    errors, places = np.asarray(normal.place_values), np.asarray(normal.places_mm)
    contacts = []
    for number in range(len(places)):
        utility = 1.0 / errors[..., number]
        contacts.append(SweptContact(sweeps[0].angles_deg, utility, everywhere, np.log(_relative(utility)).T))
    repeats = min(sweep.values.shape[1] for sweep in sweeps)
    bright = np.mean([s.values[:, :repeats] / s.values.mean(axis=1).max() for s in sweeps], axis=0)
    brightness = AngleObjective(
        name="brightness",
        meaning=f"{sweeps[0].objective.rstrip('.')}; mean over the touches, each relative to its best",
        unit="1",
        larger_is_better=True,
        values=bright,
    )
    return DecidedOn(
        "normal",
        f"{normal.name}: {normal.meaning}",
        tuple(contacts),
        tuple(float(round(place, 1)) for place in places),
        (brightness, *(objective for objective in others if objective is not normal)),
    )


#: Colours that follow from the bands do so but for rounding.
_LARGEST_MISFIT_REL = 1e-6


def swept_contacts(
    sweeps: Sequence[LightAngleSweep], weights: Sequence[float] | None, narrow_sweep: bool = False
) -> list[SweptContact]:
    """Return what sweeps of one finger say, one for each touch.

    Parameters
    ----------
    sweeps
        Of one finger, paints and objective, over the same angles.
    weights
        How often each touch occurs; None: all alike.
    narrow_sweep
        Whether angles that span less than 4 deg are meant so.

    Raises
    ------
    DecideError
        The sweeps do not belong together, the weights do not fit, or angles look like radians.
    """
    if not sweeps:
        raise DecideError("no sweep is given; give one sweep, or one for each touch")
    weights = None if weights is None else _weights(weights, len(sweeps))
    for sweep in sweeps:
        if look_like_radians(sweep.angles_deg) and not narrow_sweep:
            raise DecideError(narrow_sweep_text(sweep.angles_deg))
        _require_together(sweeps[0], sweep)
    touches = [sweep.design.indenter.model_dump_json() for sweep in sweeps]
    if len(set(touches)) < len(touches):
        twice = next(sweep for number, sweep in enumerate(sweeps) if touches[number] in touches[:number])
        raise DecideError(
            f"two sweeps belong to the same touch (position_mm = {twice.design.indenter.position_mm:g} mm), which "
            "would count twice. Give each sweep only once, and its weight by --weights"
        )
    return [_contact(sweep, 1.0 if weights is None else weights[k]) for k, sweep in enumerate(sweeps)]


#: Rounding makes losses of 1e-9 or so, which a weight must not decide on.
_LEAST_WEIGHT_REL = 1e-6


def _weights(weights: Sequence[float], sweeps: int) -> list[float]:
    """Return the weights of so many sweeps as floats."""
    try:
        numbers = [] if isinstance(weights, str | bytes | Mapping | Set) else [float(weight) for weight in weights]
        fit = len(numbers) == sweeps and all(0.0 < number < np.inf for number in numbers)
    except (TypeError, ValueError):
        fit = False
    if not fit:
        words = "one sweep" if sweeps == 1 else f"{sweeps} sweeps"
        raise DecideError(
            f"weights {weights!r} do not fit {words}; give one number above 0 for each sweep, in the order of the "
            "sweeps, or no weights to count all sweeps equally"
        )
    least, greatest = min(numbers), max(numbers)
    if least / greatest < _LEAST_WEIGHT_REL:
        raise DecideError(
            f"the smallest weight, {least:g}, is less than {_LEAST_WEIGHT_REL:g} times the greatest, {greatest:g}; "
            "leave out the sweeps of touches that rarely occur"
        )
    return [number / greatest for number in numbers]  # the sum of large ones may be infinite


def _require_together(first: LightAngleSweep, sweep: LightAngleSweep) -> None:
    """Refuse a sweep of another finger, paints, objective or angles than the first."""
    parts = set(finger_identity(first.design).differs_in(finger_identity(sweep.design))) - {"indenter"}
    if parts:
        raise DecideError(
            f"the sweeps '{first.name}' and '{sweep.name}' belong to different fingers, which differ in "
            f"{', '.join(sorted(parts))}, so one light angle cannot be decided for both fingers. Only [indenter] may "
            "differ between the sweeps"
        )
    if first.paints != sweep.paints:
        raise DecideError(
            f"the sweeps '{first.name}' and '{sweep.name}' have different paint calibrations; simulate all of them "
            "with the same --paint files"
        )
    if first.objective != sweep.objective:
        raise DecideError(
            f"the sweeps '{first.name}' and '{sweep.name}' have different objectives; decide on each sweep alone"
        )
    if first.angles_deg.tolist() != sweep.angles_deg.tolist():
        raise DecideError(
            f"the sweeps '{first.name}' and '{sweep.name}' have different angles "
            f"({first.angles_deg[0]:g} to {first.angles_deg[-1]:g} deg and {sweep.angles_deg[0]:g} to "
            f"{sweep.angles_deg[-1]:g} deg); simulate all of them with the same --angles"
        )


def _contact(sweep: LightAngleSweep, weight: float) -> SweptContact:
    """Return one touch, its paints apart where that can be told."""
    allowed = None if sweep.constraints is None else sweep.constraints.allowed
    crossed = _each_paint_on_each_repeat(sweep)
    if crossed is None:
        # paints and paths cannot be told apart: the whole scatter is kept as if it were of the paints
        table = _relative(sweep.values)
        return SweptContact(sweep.angles_deg, sweep.values, allowed, np.log(np.maximum(table, 1e-6)).T, weight)
    relative = _relative(crossed)
    return SweptContact(sweep.angles_deg, relative.mean(axis=1), allowed, np.log(relative.mean(axis=2)).T, weight)


def _relative(values: Floats) -> Floats:
    """Return values (A, ...) over their means over the angles."""
    return np.asarray(values / values.mean(axis=0))


def _each_paint_on_each_repeat(sweep: LightAngleSweep) -> Floats | None:
    """Return the objective (angle, paint draw, repeat) of each paint draw with the paths of each repeat.

    None where the colours of the sweep do not follow from its bands.
    """
    if sweep.channels is None or sweep.basis.shape[1] != sweep.values.shape[1]:
        return None
    bands = sweep.basis.mean(axis=2)
    matrices = []
    for repeat in range(bands.shape[1]):
        matrix, _, rank, _ = np.linalg.lstsq(bands[:, repeat], sweep.channels[:, repeat], rcond=None)
        misfit = np.abs(bands[:, repeat] @ matrix - sweep.channels[:, repeat]).max()
        if rank < bands.shape[2] or misfit > _LARGEST_MISFIT_REL * np.abs(sweep.channels[:, repeat]).max():
            return None
        matrices.append(matrix)
    values = np.einsum("arb,pbc->apr", bands, np.array(matrices)) / sweep.channels.shape[2]
    return values if (values > 0).all() else None


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
        end = " (the end of the allowed angles)" if self.at_range_end else ""
        best, decided = (f"{value:.3g}" if self.unit == "1" else f"{value:.3g} {self.unit}" for value in self.values)
        return (
            f"{self.name} {verdict}: it is best at {self.best_deg:.0f} deg{end} with {best}; at the decided angle it "
            f"is {decided}; loss {100 * self.loss_rel:.1f} % ({100 * self.loss_low_rel:.1f} % to "
            f"{100 * self.loss_high_rel:.1f} %)"
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
            f"{objective.name} has {count} angles with {repeats} repeats, but it must have as many angles as the sweep "
            f"({len(angles_deg)}), and at least 4 angles with 2 repeats. Simulate the sweep again with more of them."
        )
    if not angles_deg[0] <= decided_deg <= angles_deg[-1]:
        raise DecideError(
            f"The decided angle, {decided_deg:g} deg, lies outside the sweep ({angles_deg[0]:g} to "
            f"{angles_deg[-1]:g} deg), where the other objectives are not known. Simulate a wider sweep."
        )
    if allowed is not None and not allowed.any():
        raise DecideError(
            "No angle of the sweep meets the constraints (clipping, room for the panel). Move the panel, or allow a "
            "shorter exposure."
        )
