"""What sweeps say of each place: brightness of the touch, or expected error of the sensed normal along the pad.

A repeat of a sweep has its own paths and its own draw of both paints. Paths average out over the repeats; the paint of
the real finger is one draw, so that its scatter must be kept. The bands of each repeat are stored beside its colours,
and colours are linear in bands: every draw of the paints can be put on the bands of every repeat, which takes the two
apart exactly. Of the error of the normal this cannot be told, and the whole scatter is kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

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
from finray_calib.decide._light_angle import SweptContact

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
            f"the error of the normal was asked for, and {'reports on captures' if captured else 'weights'}: "
            f"{'reports measure the brightness' if captured else 'weights are of touches, the error is of places'}. "
            "Leave them out, or decide on the brightness (--aim brightness)"
        )
    if aim == "normal" and normal is None:
        raise DecideError(
            "the error of the normal was asked for, and the sweeps do not hold it at places along the pad: simulate "
            "them with --objectives all, or decide on the brightness (--aim brightness)"
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
    if weights is not None and (len(weights) != len(sweeps) or not (np.array(weights) > 0).all()):
        raise DecideError(
            f"{len(weights)} weights ({', '.join(f'{w:g}' for w in weights)}) for {len(sweeps)} sweeps; give one "
            "number above 0 for each sweep, in their order, or none for equal weights"
        )
    for sweep in sweeps:
        if look_like_radians(sweep.angles_deg) and not narrow_sweep:
            raise DecideError(narrow_sweep_text(sweep.angles_deg))
        _require_together(sweeps[0], sweep)
    touches = [sweep.design.indenter.model_dump_json() for sweep in sweeps]
    if len(set(touches)) < len(touches):
        twice = next(sweep for number, sweep in enumerate(sweeps) if touches[number] in touches[:number])
        raise DecideError(
            f"two sweeps are of one touch (position_mm = {twice.design.indenter.position_mm:g} mm): it would count "
            "twice. Give each sweep once, and its weight by --weights"
        )
    return [_contact(sweep, 1.0 if weights is None else weights[k]) for k, sweep in enumerate(sweeps)]


def _require_together(first: LightAngleSweep, sweep: LightAngleSweep) -> None:
    """Refuse a sweep of another finger, paints, objective or angles than the first."""
    parts = set(finger_identity(first.design).differs_in(finger_identity(sweep.design))) - {"indenter"}
    if parts:
        raise DecideError(
            f"the sweeps '{first.name}' and '{sweep.name}' are of two fingers, which differ in "
            f"{', '.join(sorted(parts))}: no one light suits both. Only [indenter] may differ between the sweeps"
        )
    if first.paints != sweep.paints:
        raise DecideError(
            f"the sweeps '{first.name}' and '{sweep.name}' have different paint calibrations; simulate all of them "
            "with the same --paint files"
        )
    if first.objective != sweep.objective:
        raise DecideError(
            f"the sweeps '{first.name}' and '{sweep.name}' have different objectives; decide on each alone"
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
