"""How far a finger may vary before it senses normals too much worse: each number alone, and all together.

Each number is moved until the expected error of the normal has grown by what is allowed, which is evaluated and not
extrapolated. Then all of them vary at once in a box about as large as the narrowest of these limits; an emulator of the
error in this box says how large the box may be, and Sobol' indices say which number is worth holding more tightly. What
is found is evaluated once more with other paths, paint draws and noise.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from data_schemas import (
    FingerDesign,
    FingerTolerances,
    ImpossibleFingerError,
    SimulateError,
    ToleranceRow,
    ToleranceSide,
    VarianceShare,
)
from finray_calib.decide import (
    ChaosEmulator,
    Estimates,
    Limit,
    fit_chaos,
    limit_of_curve,
    limit_together,
    share_within,
    sobol_indices,
)
from sim.experiments._design_sensitivities import changed_design, design_value
from sim.experiments._finger_evaluation import FingerEvaluator
from sim.experiments._paint_choice import PaintDraws, Steps
from sim.optics import Progress, camera_pose
from sim.surface_meshes import mirror_shape

Floats = NDArray[np.float64]
Paints = Mapping[str, PaintDraws]
Calibration = Literal["own", "shared"]

#: Error of the normal (deg) of a finger with its paints; the seed is that of everything random.
Evaluate = Callable[[FingerDesign, Paints, int], float]

ALLOWED_REL: Final = 0.1
RUNS: Final = 128
OBJECTIVE: Final = (
    "expected error of the sensed normal, averaged over contact places, paint draws and camera noise; it is evaluated "
    "at places of the pad that were not used to train the map, and the exposure is adjusted for each finger"
)

_MOUNTED, _PRINTED = "assumed: set by hand", "assumed: as cast or printed"
#: Half-ranges that are assumed where nothing else is given: (half-range, relative to the value, origin).
_USUAL: Final[dict[str, tuple[float, bool, str]]] = {
    "light.angle_deg": (2.0, False, _MOUNTED),
    "light.azimuth_deg": (2.0, False, _MOUNTED),
    "light.position_mm.x": (0.5, False, _MOUNTED),
    "light.position_mm.y": (0.5, False, _MOUNTED),
    "light.position_mm.z": (0.5, False, _MOUNTED),
    "second_light.angle_deg": (2.0, False, _MOUNTED),
    "pad.thickness_mm": (0.2, False, _PRINTED),
    "mirror.radius_mm": (0.1, True, "assumed: sheet bent by hand"),
    "camera.position_mm.x": (0.5, False, _MOUNTED),
    "camera.position_mm.y": (0.5, False, _MOUNTED),
    "camera.position_mm.z": (0.5, False, _MOUNTED),
    "camera.aim_deg": (1.0, False, _MOUNTED),
    "paint.red.yield_rel": (0.1, False, "assumed: from one batch of paint to another"),
    "paint.green.yield_rel": (0.1, False, "assumed: from one batch of paint to another"),
    "paint.red.emission_sd": (float(np.sqrt(3.0)), False, "posterior of the calibration"),
    "paint.green.emission_sd": (float(np.sqrt(3.0)), False, "posterior of the calibration"),
}
_NO_LIGHT: Final = ("mechanics.", "skeleton.", "mesh.", "indenter.")
_UNITS: Final = {"_mm": "mm", "_deg": "deg", "_nm": "nm", "_rel": "1", "_sd": "standard deviations"}
_AXES: Final = {"x": 0, "y": 1, "z": 2}
#: Steps over the given half-range that are tried in turn, until the error has grown too much.
_TRIED: Final = (1.0, 4.0, 8.0, 16.0)
_REFINED: Final = 5  # further steps within the bracket, at most
_NARROW_REL: Final = 0.2  # of its upper end: a bracket so narrow is not searched further
_ASIDE_REL: Final = (
    0.16  # of it: how far beyond an end of the bracket the next step goes where the limit is near that end
)
#: The narrowest number may leave its limit at the ends of the box: there all together exceed what is allowed.
_BOX_OVER_NARROWEST: Final = 1.25
#: A box of which a finger cannot be built is made smaller by this, down to this share of the given half-ranges.
_NARROWER: Final = 0.8
_SMALLEST_BOX: Final = 0.25


@dataclass(frozen=True, slots=True)
class ToleranceInput:
    """A number that varies: dotted path (of a place x, y or z last), value, half-range, unit, origin of the range."""

    field: str
    nominal: float
    half_range: float
    unit: str
    origin: str


def tolerance_inputs(
    design: FingerDesign, paints: Paints, vary: Mapping[str, float] | None = None
) -> tuple[ToleranceInput, ...]:
    """Return the numbers that vary: those that a person mounts, casts or mixes, and those of stated uncertainty.

    Parameters
    ----------
    design, paints
        The finger as drawn.
    vary
        Half-ranges by field, in its unit; 0 leaves a number out. Others stay as they are usual, and numbers of stated
        standard uncertainty vary by sqrt(3) of it, which has that standard deviation if uniform.

    Raises
    ------
    SimulateError
        A field is not known, has no number, or its half-range is negative.
    """
    ranges: dict[str, tuple[float, str]] = {}
    for field, (size, is_relative, origin) in _USUAL.items():
        nominal = _nominal(design, paints, field)
        if nominal is not None:
            ranges[field] = (abs(size * nominal) if is_relative else size, origin)
    for field, uncertainty in design.uncertainty_rel.items():
        nominal = _nominal(design, paints, field)
        if nominal and not field.startswith(_NO_LIGHT):
            ranges[field] = (abs(np.sqrt(3.0) * uncertainty * nominal), "stated in the design: uncertainty_rel")
    for field, size in (vary or {}).items():
        if _nominal(design, paints, field) is None:
            raise SimulateError(
                f"--vary {field}: is not a number of this finger that affects the light. Give the dotted path of a "
                f"number in the design, with the axis last for a position; the usual ones are {', '.join(ranges)}"
            )
        if not (np.isfinite(size) and size >= 0.0):
            raise SimulateError(
                f"--vary {field}={size:g}: a half-range must be 0 or more, and finite (0 leaves the number out)"
            )
        ranges[field] = (size, "given")
    return tuple(
        ToleranceInput(field, float(_nominal(design, paints, field) or 0.0), float(size), _unit(field), origin)
        for field, (size, origin) in ranges.items()
        if size > 0.0
    )


def _unit(field: str) -> str:
    """Return the unit that a field's name ends in, 1 for a plain number."""
    name = field.rsplit(".", 1)[0] if field.rsplit(".", 1)[-1] in _AXES else field
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "1")


def _nominal(design: FingerDesign, paints: Paints, field: str) -> float | None:
    """Return the value of a number as drawn; None where there is none that light depends on."""
    if field.startswith(_NO_LIGHT):
        return None
    if field.startswith("paint."):
        _, colour, what = [*field.split(".", 2), "", ""][:3]
        return {"yield_rel": 1.0, "emission_sd": 0.0}.get(what) if colour in paints else None
    path, axis = _path(field)
    try:
        value: Any = design_value(design, path)
    except AttributeError:
        return None
    if value is None and path in _LAID_OUT:
        value = _LAID_OUT[path](design)
    if axis is not None:
        return float(value[axis]) if isinstance(value, tuple) and 0 <= axis < len(value) else None
    return float(value) if isinstance(value, float) else None


#: Places that a design may leave to the usual lay-out.
_LAID_OUT: Final[dict[str, Callable[[FingerDesign], tuple[float, ...]]]] = {
    "camera.position_mm": lambda design: tuple(camera_pose(design).centre_mm.tolist()),
    "mirror.base_yz_mm": lambda design: _mirror_ends(design)[0],
    "mirror.tip_yz_mm": lambda design: _mirror_ends(design)[1],
}


def _mirror_ends(design: FingerDesign) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return (y, z) of the places where the mirror's line meets base and tip."""
    mirror = mirror_shape(design)
    half = (mirror.half_length_mm - design.mirror.overhang_mm) * mirror.tangent_yz
    return tuple((mirror.apex_yz_mm - half).tolist()), tuple((mirror.apex_yz_mm + half).tolist())


def _path(field: str) -> tuple[str, int | None]:
    """Return the path of a field, and the number of the coordinate where it names one."""
    path, _, last = field.rpartition(".")
    if last not in _AXES:
        return field, None
    return path, _AXES[last] - (1 if path.endswith("_yz_mm") else 0)


def varied_finger(
    design: FingerDesign, paints: Paints, inputs: Sequence[ToleranceInput], steps: Sequence[float] | Floats
) -> tuple[FingerDesign, dict[str, PaintDraws]]:
    """Return a finger whose numbers differ from its design by steps, in half-ranges.

    Raises
    ------
    SimulateError
        The design refuses a value.
    """
    found = dict(paints)
    for one, step in zip(inputs, steps, strict=True):
        value = one.nominal + float(step) * one.half_range
        if one.field.startswith("paint."):
            _, colour, what = one.field.split(".")
            found[colour] = _scaled(found[colour], value) if what == "yield_rel" else _shifted(found[colour], value)
            continue
        path, axis = _path(one.field)
        given: Any = value
        if axis is not None:
            place = design_value(design, path)
            coordinates = list(_LAID_OUT[path](design) if place is None else place)
            coordinates[axis] = value
            given = tuple(coordinates)
        design = changed_design(design, path, given)
    return design, found


def _scaled(paint: PaintDraws, factor: float) -> PaintDraws:
    """Return a batch of another yield."""
    if not factor > 0.0:
        raise ImpossibleFingerError(f"a yield of {factor:g} times the calibrated yield is not possible")
    optics = replace(paint.optics, emission_per_nm=factor * paint.optics.emission_per_nm)
    return replace(paint, optics=optics, emission_per_nm=factor * paint.emission_per_nm)


def _shifted(paint: PaintDraws, deviations: float) -> PaintDraws:
    """Return the paint moved along the first principal component of its draws, all of them alike."""
    centred = paint.emission_per_nm - paint.emission_per_nm.mean(axis=0)
    if not centred.any():
        return paint
    scores, sizes, components = np.linalg.svd(centred, full_matrices=False)
    # the sign of a component is arbitrary: more of it is more light
    component = components[0] * (1.0 if components[0].sum() >= 0.0 else -1.0)
    move = deviations * sizes[0] / np.sqrt(len(scores)) * component
    moved = np.maximum(paint.emission_per_nm + move, 0.0)
    optics = replace(paint.optics, emission_per_nm=np.maximum(paint.optics.emission_per_nm + move, 0.0))
    return replace(paint, optics=optics, emission_per_nm=moved)


@dataclass(frozen=True, slots=True)
class ToleranceSettings:
    """What counts as too much, runs of the box, fingers of the last check, and the seed; checks take the next seed."""

    allowed_rel: float = ALLOWED_REL
    runs: int = RUNS
    seed: int = 0
    checked: int = 24


class _Growth:
    """Growth of the error over that of the finger as drawn, for one seed."""

    def __init__(
        self, evaluate: Evaluate, design: FingerDesign, paints: Paints, inputs: Sequence[ToleranceInput], seed: int
    ) -> None:
        self.evaluate, self.design, self.paints, self.inputs, self.seed = evaluate, design, paints, inputs, seed
        self.nominal_deg = evaluate(design, paints, seed)

    def of(self, steps: Floats) -> float:
        """Return the growth at steps in half-ranges."""
        design, paints = varied_finger(self.design, self.paints, self.inputs, steps)
        return self.evaluate(design, paints, self.seed) / self.nominal_deg - 1.0

    def alone(self, number: int, step: float) -> float:
        """Return the growth with one number moved."""
        return self.of(step * np.eye(len(self.inputs))[number])


@dataclass(frozen=True, slots=True)
class _Side:
    """What was tried to one side of a number: steps in half-ranges, growths, and what ended it."""

    number: int
    sign: float
    steps: tuple[float, ...]
    losses: tuple[float, ...]
    ended_by: str

    def limit(self, allowed: float, noise: float) -> Limit:
        """Return the limit, within the noise of a loss and within the steps between which the loss exceeds it."""
        if not self.steps:
            return Limit(None, None, None)
        found = limit_of_curve(self.steps, self.losses, allowed, noise)
        if found.value is None:
            return found
        low, high = _bracket(self.steps, self.losses, allowed)
        return Limit(
            found.value,
            low if found.low is None else min(found.low, low),
            None if found.high is None else max(found.high, high),
        )


def _spread(numbers: int, settings: ToleranceSettings) -> Floats:
    """Return Sobol' points in [-1, 1] for the runs: a whole power of two is balanced, its first points still spread."""
    whole = 2 ** int(np.ceil(np.log2(settings.runs)))
    sequence = qmc.Sobol(numbers, rng=np.random.default_rng(settings.seed))
    return np.asarray(2.0 * sequence.random(whole)[: settings.runs] - 1.0)


def study_tolerances(
    evaluate: Evaluate,
    design: FingerDesign,
    paints: Paints,
    inputs: Sequence[ToleranceInput],
    settings: ToleranceSettings,
    progress: Progress | None = None,
) -> "ToleranceFindings":
    """Find how far numbers of a finger may vary, alone and together, and which of them matter.

    Parameters
    ----------
    evaluate
        Error of a finger in deg for a seed, see :class:`FingerError`.
    design, paints
        The finger as drawn.
    inputs
        What varies, see :func:`tolerance_inputs`.
    settings
        Allowed growth, runs and seed.
    progress
        Called after each evaluated number and each run.

    Raises
    ------
    SimulateError
        Nothing varies, runs are too few, or the finger as drawn cannot be evaluated.
    """
    _check(inputs, settings)
    told = Steps(progress, 2 * len(inputs) + settings.runs + 1)
    growth = _Growth(evaluate, design, paints, inputs, settings.seed)
    sides = []
    for number, one in enumerate(inputs):
        for sign in (-1.0, 1.0):
            sides.append(_search(growth, number, sign, settings.allowed_rel))
            told.done(f"{one.field} alone")
    check = _Growth(evaluate, design, paints, inputs, settings.seed + 1)
    checked = [_checked(check, side, settings.allowed_rel) for side in sides]
    noise = _noise(checked, settings.allowed_rel)
    factor = _box_factor(sides, settings.allowed_rel)
    told.done("limits once more")
    units = _spread(len(inputs), settings)
    factor, losses, notes = _all_together(growth, factor, units, lambda: told.done("all together"))
    emulator = fit_chaos(units, losses, settings.seed)
    together = limit_together(emulator, settings.allowed_rel, seed=settings.seed)
    reached = 1.0 if together.value is None else together.value
    within = _check_together(check, factor * reached, settings)
    given_share, told_of_share = _within_given(check, emulator, factor, settings)
    return ToleranceFindings(
        growth.nominal_deg,
        tuple(sides),
        tuple(checked),
        noise,
        factor,
        units,
        losses,
        emulator,
        together,
        within,
        settings.checked,
        given_share,
        (*notes, *told_of_share),
    )


@dataclass(frozen=True, slots=True)
class ToleranceFindings:
    """What :func:`study_tolerances` finds, in half-ranges; `record` makes it a record."""

    nominal_deg: float
    sides: tuple[_Side, ...]
    checked: tuple[float | None, ...]
    noise: float
    factor: float
    units: Floats
    losses: Floats
    emulator: ChaosEmulator
    together: Limit
    within: int
    count: int
    given_share: float
    notes: tuple[str, ...] = ()

    def record(
        self,
        design: FingerDesign,
        paint_sha256: Mapping[str, str],
        inputs: Sequence[ToleranceInput],
        settings: ToleranceSettings,
        contact_places_mm: Sequence[float],
        calibration: Calibration,
    ) -> FingerTolerances:
        """Return the record of a study."""
        rows = self._rows(inputs, settings.allowed_rel)
        together = [None if x is None else self.factor * x for x in (self.together.value, self.together.low,
                                                                     self.together.high)]  # fmt: skip
        return FingerTolerances(
            name=design.name,
            sentence=_sentence(rows, together[0], settings.allowed_rel, self.nominal_deg, self.factor),
            objective=OBJECTIVE,
            calibration=calibration,
            allowed_rel=settings.allowed_rel,
            nominal_error_deg=self.nominal_deg,
            contact_places_mm=tuple(contact_places_mm),
            rows=rows,
            together_factor=together[0],
            together_low95=together[1],
            together_high95=together[2],
            within_given_share=self.given_share,
            checked_within=self.within,
            checked_fingers=self.count,
            box_factor=self.factor,
            q2=self.emulator.q2,
            noise_rel=self.noise,
            inputs=self.units,
            losses_rel=self.losses,
            design=design,
            paints=dict(paint_sha256),
            notes=self.notes,
        )

    def _rows(self, inputs: Sequence[ToleranceInput], allowed: float) -> tuple[ToleranceRow, ...]:
        indices = sobol_indices(self.emulator)
        rows = []
        for k, one in enumerate(inputs):
            less, more = (self._side(2 * k + side, one, allowed) for side in (0, 1))
            rows.append(
                ToleranceRow(
                    field=one.field, unit=one.unit, nominal=one.nominal, given=one.half_range, origin=one.origin,
                    less=less, more=more, first=_index(indices.first, k), total=_index(indices.total, k),
                    is_distinguishable=bool(indices.distinguishable[k]),
                )
            )  # fmt: skip
        return tuple(rows)

    def _side(self, number: int, one: ToleranceInput, allowed: float) -> ToleranceSide:
        side = self.sides[number]
        limit = side.limit(allowed, self.noise)
        value, low, high = (None if x is None else x * one.half_range for x in (limit.value, limit.low, limit.high))
        return ToleranceSide(
            limit=value,
            low95=low,
            high95=high,
            tried=max(side.steps, default=0.0) * one.half_range,
            ended_by=side.ended_by,
            checked_loss_rel=self.checked[number],
        )


def _search(growth: _Growth, number: int, sign: float, allowed: float) -> _Side:
    """Move one number to one side until the error has grown too much, then narrow the bracket."""
    steps, losses, ended_by = [], [], ""
    for step in _TRIED:
        try:
            losses.append(growth.alone(number, sign * step))
        except ImpossibleFingerError as refused:
            ended_by = str(refused)
            break
        steps.append(step)
        if losses[-1] > allowed:
            break
    for _ in range(_REFINED):
        if max(losses, default=0.0) <= allowed:
            break
        low, high = _bracket(steps, losses, allowed)
        if high - low <= _NARROW_REL * high:
            break
        step = _between(steps, losses, allowed)
        losses.append(growth.alone(number, sign * step))
        steps.append(step)
    return _Side(number, sign, tuple(steps), tuple(losses), ended_by)


def _ordered(steps: Sequence[float], losses: Sequence[float], allowed: float) -> tuple[Floats, Floats, int]:
    """Return steps and losses in order from 0 on, and the number of the first that exceeds what is allowed."""
    order = np.argsort(steps)
    step, loss = (np.concatenate([[0.0], np.asarray(values)[order]]) for values in (steps, losses))
    return step, loss, int(np.flatnonzero(loss > allowed)[0])


def _bracket(steps: Sequence[float], losses: Sequence[float], allowed: float) -> tuple[float, float]:
    """Return the last step within what is allowed and the first beyond it, where there is one."""
    step, _, above = _ordered(steps, losses, allowed)
    return float(step[above - 1]), float(step[above])


def _between(steps: Sequence[float], losses: Sequence[float], allowed: float) -> float:
    """Return the step to try next: where a power law meets what is allowed, or a little beyond it.

    The law runs through both ends of the bracket, or through the two steps above it; near the best value of a number a
    loss grows with the square of the step, which is assumed where neither tells. No law holds for a loss that flattens
    or turns steep, so that a loss near what is allowed proves nothing: the limit is between two steps, and where the
    law puts it beside one of them, the next step goes to its other side.
    """
    step, loss, above = _ordered(steps, losses, allowed)
    low, high = float(step[above - 1]), float(step[above])
    first, second, power = above - 1, above, 2.0
    if not (low > 0.0 and loss[first] > 0.0) and above + 1 < len(step):
        first, second = above, above + 1
    if step[first] > 0.0 and 0.0 < loss[first] < loss[second]:
        # flatter than this the law would go to zero
        power = max(float(np.log(loss[second] / loss[first]) / np.log(step[second] / step[first])), 0.2)
    wanted = high * (allowed / float(loss[above])) ** (1.0 / power)
    aside = min(_ASIDE_REL * high, (high - low) / 2.0)
    if len(steps) > len(_TRIED) and low > 0.0 and high > low / 0.6:
        return float(np.sqrt(low * high))  # the law has failed
    return float(np.clip(wanted, low + aside, high - aside))


def _checked(check: _Growth, side: _Side, allowed: float) -> float | None:
    """Return the growth at a limit with another seed."""
    limit = side.limit(allowed, 0.0).value
    return None if limit is None else check.alone(side.number, side.sign * limit)


def _noise(checked: Sequence[float | None], allowed: float) -> float:
    """Return the standard deviation of a growth: what two seeds make of the limits, over sqrt(2)."""
    known = np.array([loss for loss in checked if loss is not None])
    return float(np.sqrt(((known - allowed) ** 2).mean() / 2.0)) if known.size else 0.0


def _box_factor(sides: Sequence[_Side], allowed: float) -> float:
    """Return the half-ranges of the box over the given ones."""
    limits = [limit for side in sides if (limit := side.limit(allowed, 0.0).value) is not None]
    refused = [max(side.steps, default=0.0) for side in sides if side.ended_by]
    if refused and min(refused) == 0.0:
        blocked = next(side for side in sides if side.ended_by and not side.steps)
        raise SimulateError(
            f"a finger at the given half-range cannot be built ({blocked.ended_by}). Give a smaller half-range (--vary)"
        )
    return min([_BOX_OVER_NARROWEST * min(limits, default=np.inf), *refused, _TRIED[-1]])


def _all_together(
    growth: _Growth, factor: float, units: Floats, done: Callable[[], None]
) -> tuple[float, Floats, tuple[str, ...]]:
    """Return the half-ranges of the box over the given ones, growths of its fingers, and what is said of the box.

    A box in which a finger cannot be built is made smaller, also where each number alone goes further.
    """
    first, losses, most, refusal = factor, np.empty(len(units)), 0, ""
    while True:
        try:
            for run, unit in enumerate(units):
                losses[run] = growth.of(factor * unit)
                if run >= most:
                    most = run + 1
                    done()
        except ImpossibleFingerError as refused:
            refusal = str(refused)
            if factor * _NARROWER < _SMALLEST_BOX:
                raise SimulateError(
                    f"not even fingers within {factor:.2g} times the given half-ranges can be built ({refusal}). Give "
                    "smaller half-ranges (--vary)"
                ) from None
            factor *= _NARROWER
            continue
        told = (
            f"all numbers together vary by {factor:.2g} times the given half-ranges in place of {first:.2g}, because "
            f"one of those fingers cannot be built: {refusal}"
        )
        return factor, losses, (told,) if refusal else ()


def _check_together(check: _Growth, factor: float, settings: ToleranceSettings) -> int:
    """Return how many checked fingers stay within what is allowed at a factor on all half-ranges, with another seed."""
    rng = np.random.default_rng(settings.seed + 1)
    units = rng.uniform(-1.0, 1.0, (settings.checked, len(check.inputs)))
    return sum(_stays(check, factor * unit, settings.allowed_rel) for unit in units)


def _within_given(
    check: _Growth, emulator: ChaosEmulator, factor: float, settings: ToleranceSettings
) -> tuple[float, tuple[str, ...]]:
    """Return the share of fingers within what is allowed that vary as given, and what is said of it."""
    if factor >= 1.0:
        return share_within(emulator, 1.0 / factor, settings.allowed_rel), ()
    # the emulator knows nothing beyond its box
    told = f"the share of fingers within the given half-ranges is that of {settings.checked} evaluated fingers"
    return _check_together(check, 1.0, settings) / settings.checked, (told,)


def _stays(check: _Growth, steps: Floats, allowed: float) -> bool:
    """Return whether a finger can be built and stays within what is allowed."""
    try:
        return check.of(steps) <= allowed
    except ImpossibleFingerError:
        return False


def _index(estimates: Estimates, k: int) -> VarianceShare:
    low, value, high = (float(x[k]) for x in (estimates.low, estimates.value, estimates.high))
    return VarianceShare(estimate=value, low95=min(low, value), high95=max(high, value))


def _sentence(
    rows: Sequence[ToleranceRow], together: float | None, allowed: float, nominal_deg: float, factor: float
) -> str:
    """Say what is found."""
    sides = [(row, side.limit) for row in rows for side in (row.less, row.more) if side.limit is not None]
    grown = f"the expected error of the normal, {nominal_deg:.2f} deg, grows by {100 * allowed:.0f} %"
    if together is None:
        told = f"All numbers together may vary by more than {factor:.2g} times the given half-ranges before {grown}"
    elif together == 0.0:
        little = "the emulator explains too little of the variance to find the factor at which"
        told = f"{len(rows)} numbers need more runs (--runs): {little} {grown}"
    else:
        told = (
            f"When all numbers vary together by {together:.2g} times the given half-ranges, {grown} in 5 % of fingers"
        )
    if sides:
        row, limit = min(sides, key=lambda pair: (pair[1] or 0.0) / pair[0].given)
        told += (
            f"; of the values varied alone, {row.field} has the narrowest limit relative to its half-range: {limit:.3g}"
            f"{'' if row.unit == '1' else f' {row.unit}'}"
        )
    most = max(rows, key=lambda row: row.total.estimate)
    if not most.is_distinguishable:
        return f"{told}; no number's share of the variance can be distinguished from 0."
    return f"{told}; {most.field} has the largest share of the variance ({100 * most.total.estimate:.0f} %)."


def _check(inputs: Sequence[ToleranceInput], settings: ToleranceSettings) -> None:
    """Refuse a study that tells nothing."""
    if not inputs:
        raise SimulateError("no number varies; give --vary FIELD=HALF_RANGE with a half-range above 0")
    if settings.runs < 4 * len(inputs):
        raise SimulateError(
            f"--runs {settings.runs}: {len(inputs)} numbers need at least {4 * len(inputs)} runs; give more runs, or "
            "leave numbers out (--vary FIELD=0)"
        )
    if not settings.allowed_rel > 0.0:
        raise SimulateError(f"--allowed {settings.allowed_rel:g}: the allowed growth must be more than 0, such as 0.1")


class FingerError:
    """Error of the normal of a finger, calibrated as it was built or as the finger as drawn was.

    With a shared calibration the map from colour to normal is taught by the finger as drawn, at the same places; each
    finger still has its own picture without contact. Where a moved camera sees a place in another pixel, the place
    is taken as known.
    """

    def __init__(
        self,
        open_evaluator: Callable[[int], FingerEvaluator],
        design: FingerDesign,
        paints: Paints,
        calibration: Calibration = "own",
    ) -> None:
        """Take what opens an evaluator for a seed, and the finger as drawn."""
        self.open_evaluator, self.design, self.paints, self.calibration = open_evaluator, design, paints, calibration
        self._open: dict[int, FingerEvaluator] = {}

    def __call__(self, design: FingerDesign, paints: Paints, seed: int) -> float:
        """Return the error in deg."""
        if seed not in self._open:
            self._open[seed] = self.open_evaluator(seed)
        evaluator = self._open[seed]
        found = evaluator.evaluate(design, paints)
        if self.calibration == "own":
            return found.normal_error_deg
        return evaluator.error_with_calibration_of(evaluator.evaluate(self.design, self.paints), found, design)
