"""Search the numbers of a finger's design for what it is to be good in, within limits.

A Sobol' screen of designs is evaluated first; then an emulator of each objective proposes one design after the other by
knowledge gradient, and last the design of the best expected value. Every evaluation is kept as it is made, so that a
search that was interrupted continues, and a longer one begins with what there is.
"""

import hashlib
import json
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    DesignObjective,
    DesignParameter,
    DesignRole,
    EvaluatedDesign,
    FingerDesign,
    LightPlaceMap,
    Provenance,
    SimulateError,
)
from data_schemas.storage import read_record, write_record
from finray_calib.decide import DesignEmulator, DesignSearch, best_design, losses, next_design, screening_designs
from sim.experiments._design_sensitivities import (
    PAD_FORCE_N,
    TIP_FORCE_N,
    TWIST_DEG,
    changed_design,
    design_value,
)
from sim.experiments._finger_evaluation import EvaluationSettings, FingerEvaluator, LightMeasure
from sim.experiments._light_angle import panels_in_the_way
from sim.experiments._paint_choice import PaintDraws
from sim.mechanics import LoadedFinger
from sim.optics import Progress
from sim.surface_meshes import FingerShape, rest_shape

Floats = NDArray[np.float64]
Evaluate = Callable[[FingerDesign], EvaluatedDesign]

_LIGHT: Final = {
    "normal-error": DesignObjective(
        name="normal-error", unit="deg", larger_is_better=False,
        meaning="expected error of the sensed normal at places that were left out when the map was trained; places "
            "that the camera does not see count as not tilted",
    ),
    "evenness": DesignObjective(
        name="evenness", unit="1", larger_is_better=True,
        meaning="luminance without contact: its 5 % quantile over the pad, divided by its 95 % quantile",
    ),
    "brightness": DesignObjective(
        name="brightness", unit="1", larger_is_better=True,
        meaning="camera signal of the coat without contact / radiance of a panel of power_rel = 1",
    ),
}  # fmt: skip
_LOADS: Final = {
    "softness": DesignObjective(
        name="softness", unit="N/mm", larger_is_better=False,
        meaning=f"stiffness under {PAD_FORCE_N:g} N in the middle of the pad; a low value means that the finger "
            "adapts to the object that it grips",
    ),
    "bending-stiffness": DesignObjective(
        name="bending-stiffness", unit="N/mm", larger_is_better=True,
        meaning=f"stiffness in bending under {TIP_FORCE_N:g} N at the tip",
    ),
    "twist-stiffness": DesignObjective(
        name="twist-stiffness", unit="N mm/deg", larger_is_better=True,
        meaning=f"torque / angle when the tip is turned by {TWIST_DEG:g} deg",
    ),
}  # fmt: skip
OBJECTIVES: Final[Mapping[str, DesignObjective]] = {**_LIGHT, **_LOADS}
"""What a finger can be searched for, by name."""

_USUAL: Final[Mapping[str, tuple[float, float, bool]]] = {
    "light.angle_deg": (-60.0, 75.0, False),
    "light.position_mm[y]": (0.6, 1.5, True),
    "light.position_mm[z]": (-4.0, 3.0, False),
    "second_light.angle_deg": (105.0, 180.0, False),
    "second_light.power_rel": (0.25, 4.0, True),
    "light.power_rel": (0.25, 4.0, True),
    "pad.thickness_mm": (0.7, 1.3, True),
    "pad.radius_mm": (0.7, 2.0, True),
    "mirror.radius_mm": (0.6, 2.5, True),
    "camera.aim_deg": (-8.0, 8.0, False),
    "skeleton.rib_thickness_mm": (0.6, 1.5, True),
    "skeleton.rib_width_mm": (0.7, 1.4, True),
    "skeleton.rib_count": (3.0, 9.0, False),
    "skeleton.rib_angle_deg": (-25.0, 25.0, False),
    "skeleton.front_fin_thickness_mm": (0.7, 1.4, True),
    "skeleton.back_fin_thickness_mm": (0.7, 1.4, True),
}
"""Field -> lower and upper limit, and whether these are times the value of the start."""
_OF_LIGHT: Final = ("light.angle_deg", "light.position_mm[y]", "light.position_mm[z]", "pad.thickness_mm")
_OF_LOADS: Final = ("skeleton.rib_thickness_mm", "skeleton.front_fin_thickness_mm")
_AXES: Final = "xyz"
_FIELD: Final = re.compile(r"([a-z0-9_]+(?:\.[a-z0-9_]+)+)(?:\[([xyz])\])?")
#: Proposals between two fits of the emulators' lengths and noise.
_REFIT: Final = 4
#: Of a parameter: millionths of a mm or a deg.
_DECIMALS: Final = 6
#: Less is said in seconds.
_MINUTES_FROM_S: Final = 90.0
_POWER: Final = "power_rel"


@dataclass(frozen=True, slots=True)
class _Field:
    """A number of a design: a dotted field, or a coordinate of a place."""

    path: str
    axis: int | None

    @classmethod
    def of(cls, text: str) -> "_Field":
        found = _FIELD.fullmatch(text)
        if found is None:
            raise SimulateError(f"'{text}' is not a field of a design, such as light.angle_deg or light.position_mm[y]")
        return cls(found[1], None if found[2] is None else _AXES.index(found[2]))

    def value(self, design: FingerDesign) -> float:
        """Return the number of a design."""
        try:
            value = design_value(design, self.path)
        except AttributeError:
            raise SimulateError(
                f"'{self.path}' is not a field of a design; 'finray design init' writes a file with all fields"
            ) from None
        if self.axis is not None and isinstance(value, tuple):
            value = value[self.axis]
        elif self.axis is not None and value is not None:
            raise SimulateError(
                f"'{self.path}' of this finger is {value!r}, which has no coordinates; leave out [{_AXES[self.axis]}]"
            )
        if isinstance(value, bool) or not isinstance(value, int | float):
            hint = "; for a place, name its coordinate, as in light.position_mm[y]" if isinstance(value, tuple) else ""
            hint = "; write it into the design file first" if value is None else hint
            raise SimulateError(f"'{self.path}' of this finger is {value!r}, which is not a number{hint}")
        return value

    def changed(self, design: FingerDesign, value: float) -> FingerDesign:
        """Return a design with another number."""
        if self.axis is None:
            return changed_design(design, self.path, value)
        place = list(design_value(design, self.path))
        place[self.axis] = value
        return changed_design(design, self.path, tuple(place))


def design_parameter(design: FingerDesign, text: str) -> DesignParameter:
    """Return a parameter from FIELD=LOW:HIGH, or from FIELD where it has usual limits.

    Raises
    ------
    SimulateError
        When the design has no such number, a limit is not a number, the design refuses it, or nothing depends on it.
    """
    name, separator, limits = text.partition("=")
    one = _Field.of(name.strip())
    start = one.value(design)
    if one.path.endswith(f".{_POWER}") and len(design.lights) == 1:
        raise SimulateError(
            f"--within: {name.strip()} has no effect, because the power of all panels together is kept and this finger "
            "has one panel; leave it out, or add another panel to the design"
        )
    low, high = _limits(name.strip(), limits, start) if separator else _usual_limits(name.strip(), start)
    is_integer = isinstance(start, int)
    if is_integer and (low := float(np.ceil(low))) >= (high := float(np.floor(high))):
        raise SimulateError(f"--within: {text} holds no two whole numbers to choose from; give wider limits")
    for limit in (low, high):
        try:
            one.changed(design, round(limit) if is_integer else limit)
        except SimulateError as refused:
            raise SimulateError(f"--within: {name.strip()} = {limit:g} is not possible: {refused}") from None
    return DesignParameter(field=name.strip(), low=low, high=high, is_integer=is_integer, start=float(start))


def _limits(name: str, text: str, start: float) -> tuple[float, float]:
    """Return the limits that are given as LOW:HIGH."""
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise SimulateError(f"--within: '{name}={text}' must be FIELD=LOW:HIGH, such as light.angle_deg=0:60") from None
    if not (np.isfinite([low, high]).all() and low < high):
        raise SimulateError(
            f"--within: {name} = {low:g}:{high:g} must be two finite numbers LOW:HIGH with LOW below HIGH"
        )
    if not low <= start <= high:
        raise SimulateError(
            f"--within: {name} must include the design's own value of {start:g}, from which the search starts, but "
            f"{low:g} to {high:g} does not"
        )
    return low, high


def _usual_limits(name: str, start: float) -> tuple[float, float]:
    """Return the limits of a field that has usual ones."""
    if name not in _USUAL:
        raise SimulateError(f"--within: {name} has no default limits; give them as {name}=LOW:HIGH")
    low, high, is_relative = _USUAL[name]
    found = sorted((low * start, high * start)) if is_relative else [low, high]
    return min(found[0], start), max(found[1], start)


def default_parameters(design: FingerDesign, objectives: Sequence[DesignObjective]) -> tuple[DesignParameter, ...]:
    """Return the parameters that are varied where none are given, according to the objectives."""
    fields = list(_OF_LIGHT) if any(o.name in _LIGHT for o in objectives) else []
    if any(o.name in _LOADS for o in objectives):
        fields += [one for one in ("pad.thickness_mm", *_OF_LOADS) if one not in fields]
    if design.pad.radius_mm is not None:
        fields.append("pad.radius_mm")
    return tuple(design_parameter(design, one) for one in fields)


@dataclass(frozen=True)
class DesignSpace:
    """All designs within limits.

    Attributes
    ----------
    start
        The design that is given; what is no parameter stays as it is.
    parameters
        At least one. Where a panel's power is one, the power of all panels together stays that of the start.
    """

    start: FingerDesign
    parameters: tuple[DesignParameter, ...]
    _rest: dict[str, FingerShape] = field(default_factory=dict, repr=False)

    def changes(self, place: Floats) -> dict[str, float]:
        """Return the values of the parameters at a place, (D,) from 0 to 1."""
        found = {}
        for at, one in zip(place.tolist(), self.parameters, strict=True):
            value = one.low + at * (one.high - one.low)
            # the design of a place has the same digits on the way there and back
            found[one.field] = float(round(value)) if one.is_integer else round(value, _DECIMALS)
        return found

    def snapped(self, place: Floats) -> Floats:
        """Return the place (D,) of the design that is built: whole numbers are whole."""
        values = self.changes(place)
        return np.array([(values[one.field] - one.low) / (one.high - one.low) for one in self.parameters])

    def place(self, design: FingerDesign) -> Floats:
        """Return the place (D,) of a design."""
        values = [_Field.of(one.field).value(design) for one in self.parameters]
        return np.array([(v - one.low) / (one.high - one.low) for v, one in zip(values, self.parameters, strict=True)])

    def design_at(self, place: Floats) -> FingerDesign:
        """Return the design at a place, (D,) from 0 to 1.

        Raises
        ------
        SimulateError
            When its numbers do not go together.
        """
        design = self.start
        for one, value in zip(self.parameters, self.changes(place).values(), strict=True):
            design = _Field.of(one.field).changed(design, round(value) if one.is_integer else value)
        varied = {_Field.of(one.field).path for one in self.parameters}
        origin = {name: where for name, where in design.origin.items() if name not in varied}
        return _of_equal_power(design.model_copy(update={"origin": origin}), self.start, varied)

    def is_possible(self, place: Floats) -> bool:
        """Return whether a design's numbers go together and its panels pass through nothing."""
        try:
            design = self.design_at(place)
            rest = self._shape(design)
        except SimulateError:
            return False
        return not panels_in_the_way(design, rest)

    def _shape(self, design: FingerDesign) -> FingerShape:
        """Return the surfaces of a finger without contact, made once for equal pads and mirrors."""
        key = json.dumps([design.pad.model_dump(mode="json"), design.mirror.model_dump(mode="json")], sort_keys=True)
        if key not in self._rest:
            self._rest.clear()  # neighbours in time are of one pad, if any
            self._rest[key] = rest_shape(design)
        return self._rest[key]


def _of_equal_power(design: FingerDesign, start: FingerDesign, varied: set[str]) -> FingerDesign:
    """Return a design whose panels together have the power of the start's, where that of one is varied."""
    if not any(one.endswith(f".{_POWER}") for one in varied):
        return design
    factor = sum(panel.power_rel for panel in start.lights) / sum(panel.power_rel for panel in design.lights)
    for name in ("light", "second_light"):
        if getattr(design, name) is not None:
            design = changed_design(design, f"{name}.{_POWER}", factor * getattr(design, name).power_rel)
    further = tuple(panel.model_copy(update={_POWER: factor * panel.power_rel}) for panel in design.further_lights)
    return design.model_copy(update={"further_lights": further})


_MOST_MAPPED: Final = 400


def map_axis(design: FingerDesign, text: str) -> tuple[str, Floats]:
    """Return field and values of one axis of a map from FIELD=LOW:HIGH:STEP; HIGH is one where steps end there.

    Raises
    ------
    SimulateError
        When the design has no such number, or the text states no rising steps.
    """
    name, _, steps = text.partition("=")
    _Field.of(name.strip()).value(design)
    try:
        low, high, step = (float(part) for part in steps.split(":"))
    except ValueError:
        low = high = step = float("nan")
    if not (np.isfinite([low, high, step]).all() and low < high and 0.0 < step <= high - low):
        raise SimulateError(f"--map: '{text}' must be FIELD=LOW:HIGH:STEP, such as light.angle_deg=0:75:15")
    count = int((high - low) / step + 1e-9) + 1
    if count > _MOST_MAPPED:
        raise SimulateError(
            f"--map: {name.strip()} has {count} values, but at most {_MOST_MAPPED} finger designs can be mapped; widen "
            "the step"
        )
    return name.strip(), np.round(low + step * np.arange(count), _DECIMALS)


def map_designs(
    design: FingerDesign,
    axes: Sequence[tuple[str, Floats]],
    evaluator: FingerEvaluator,
    paints: Mapping[str, PaintDraws],
    progress: Progress | None = None,
) -> LightPlaceMap:
    """Evaluate a finger over a grid of two of its numbers, with common paths, paint draws and noise.

    Surfaces and presses are made once for all fingers of one pad and mirror.

    Parameters
    ----------
    design
        The finger; what is on no axis stays as it is.
    axes
        Two, from :func:`map_axis`.
    evaluator, paints
        By what it is measured.
    progress
        Called after each finger.

    Raises
    ------
    SimulateError
        With more than 400 fingers, the same number twice, or when none of them can be built.
    """
    (first, at_first), (second, at_second) = axes
    shape = len(at_first), len(at_second)
    if first == second or shape[0] * shape[1] > _MOST_MAPPED:
        raise SimulateError(
            f"--map: {first} and {second} make {shape[0]} x {shape[1]} fingers, but must be two different numbers with "
            f"at most {_MOST_MAPPED} fingers in all; name two different numbers, or widen the steps"
        )
    errors: dict[tuple[int, ...], Floats] = {}
    values = np.full((2, *shape), np.nan)
    refused = ""
    for number, (i, j) in enumerate(np.ndindex(shape), start=1):
        try:
            finger = _Field.of(second).changed(
                _Field.of(first).changed(design, float(at_first[i])), float(at_second[j])
            )
            found = evaluator.evaluate(finger, paints)
            refused = refused or (f"a panel collides with {found.in_the_way}" if found.in_the_way else "")
            if not found.in_the_way:
                seen = found.seen_share * found.error_by_place_deg.mean(axis=1)
                errors[i, j] = seen + (1.0 - found.seen_share) * found.blind_error_deg
                values[:, i, j] = found.evenness_rel, found.brightness_rel
        except SimulateError as error:
            refused = refused or str(error)
        if progress is not None:
            progress(number, shape[0] * shape[1], f"{first} {at_first[i]:g}, {second} {at_second[j]:g}")
    if not errors:
        raise SimulateError(f"--map: no finger of the map can be built (first reason: {refused})")
    best = min(errors.values(), key=lambda one: float(one.mean()))
    mean, above_u = np.full(shape, np.nan), np.full(shape, np.nan)
    for place, by_draw in errors.items():
        mean[place] = by_draw.mean()
        # a real finger has one draw of the paints, not the mean of some
        above_u[place] = (by_draw - best).std(ddof=1) * np.sqrt(1.0 + 1.0 / len(by_draw))
    return LightPlaceMap(
        fields=(first, second), units=(_unit_of(first), _unit_of(second)), first=at_first, second=at_second,
        normal_error_deg=mean, above_best_u_deg=above_u, evenness_rel=values[0], brightness_rel=values[1],
    )  # fmt: skip


def _unit_of(name: str) -> str:
    """Return the unit that the name of a field ends with."""
    path = name.partition("[")[0]
    return next((unit for unit in ("deg", "mm", "nm") if path.endswith(f"_{unit}")), "1")


class DesignEvaluations:
    """Evaluates designs, and keeps each evaluation in a folder by the content that it was computed from.

    Parameters
    ----------
    folder
        Where evaluations are kept; one that is there is not computed again.
    objectives
        What is computed.
    origin
        Of the records.
    light
        Of objectives of light; None where there are none.
    """

    def __init__(
        self, folder: Path, objectives: Sequence[DesignObjective], origin: Provenance, light: LightMeasure | None
    ) -> None:
        self._folder, self._origin, self._light = folder, origin, light
        self._loads = any(one.name in _LOADS for one in objectives)
        self._evaluators: dict[EvaluationSettings, FingerEvaluator] = {}
        self.computed = 0

    def evaluate(self, design: FingerDesign, again: int = 0) -> EvaluatedDesign:
        """Return the numbers of a design, from the folder where it is there.

        Parameters
        ----------
        design
            The finger.
        again
            0 in a search; from 1 on with other seeds and contact places.
        """
        key = self._key(design, again)
        file = self._folder / f"{key[:20]}.json"
        if file.exists():
            kept = read_record(file, EvaluatedDesign)
            if kept.key == key:
                return kept
        begun = time.process_time()
        values: dict[str, float] = {}
        failure = ""
        try:
            values = self._values(design, again)
        except SimulateError as failed:
            failure = str(failed)
        spent_s = time.process_time() - begun
        found = EvaluatedDesign(key=key, design=design, values=values, failure=failure, processor_s=spent_s)
        self._folder.mkdir(parents=True, exist_ok=True)
        write_record(found, file, self._origin)
        self.computed += 1
        return found

    def _key(self, design: FingerDesign, again: int) -> str:
        """Return the SHA-256 of what an evaluation is computed from."""
        given: dict[str, Any] = {
            "version": 1,
            "design": design.model_dump(mode="json", exclude={"provenance", "name", "origin", "materials"}),
            "loads": self._loads,
        }
        if self._light is not None:
            settings = asdict(self._light.again(again, design.pad.length_mm))
            given |= {"settings": settings, "paints": dict(self._light.sources), **self._light.files}
        return hashlib.sha256(json.dumps(given, sort_keys=True, allow_nan=False).encode()).hexdigest()

    def _values(self, design: FingerDesign, again: int) -> dict[str, float]:
        """Compute the numbers of a design; all of its light, where any is asked for."""
        values: dict[str, float] = {}
        if self._light is not None:
            settings = self._light.again(again, design.pad.length_mm)
            if settings not in self._evaluators:
                light = self._light
                self._evaluators[settings] = FingerEvaluator(
                    light.response, light.renderer, settings, light.calibration
                )
            found = self._evaluators[settings].evaluate(design, self._light.paints)
            values |= {
                "normal-error": found.error_with_unseen_deg,
                "evenness": found.evenness_rel,
                "brightness": found.brightness_rel,
            }
        if self._loads:
            finger = LoadedFinger(design)
            values |= {
                "softness": finger.push("pad", (0.0, -PAD_FORCE_N, 0.0)).stiffness_n_per_mm,
                "bending-stiffness": finger.push("tip", (0.0, -TIP_FORCE_N, 0.0)).stiffness_n_per_mm,
                "twist-stiffness": finger.twist(TWIST_DEG).stiffness_n_mm_per_deg,
            }
        return values


def is_of_light(objective: DesignObjective) -> bool:
    """Return whether an objective is measured with light; others need neither paints nor renderer."""
    return objective.name in _LIGHT


def screen_size(evaluations: int, parameters: int) -> int:
    """Return how many designs are screened: a third, and at least three for each parameter and one more."""
    return min(max(evaluations // 3, 3 * (parameters + 1)), evaluations - 2)


def search_designs(
    space: DesignSpace,
    objectives: Sequence[DesignObjective],
    evaluate: Evaluate,
    evaluations: int,
    seed: int,
    progress: Progress | None = None,
    screened: int | None = None,
) -> DesignSearch:
    """Search a space of designs: screen, proposals by knowledge gradient, and the design of the best expected value.

    With several objectives each proposal is for a weighted sum of their losses; the weights change from proposal to
    proposal, so that designs all along the convex part of the front are proposed. The last design is for equal weights:
    1 % of one objective counts as 1 % of another.

    Parameters
    ----------
    space
        Designs within limits.
    objectives
        One or more.
    evaluate
        Computes or remembers the numbers of a design.
    evaluations
        Altogether, the start and the chosen design among them.
    seed
        Of screen and proposals: the same seed and evaluations give the same search.
    progress
        Called after each evaluation.
    screened
        Of the evaluations, how many are the screen's; by default as :func:`screen_size` says.

    Raises
    ------
    SimulateError
        When there are too few evaluations, or most of the screen fails.
    """
    count = len(space.parameters)
    screened = screen_size(evaluations, count) if screened is None else screened
    least = 3 * (count + 1)
    if evaluations < least + 4:
        raise SimulateError(
            f"--evaluations: {evaluations} are too few for {count} parameters; give at least {least + 4}"
        )
    if not least <= screened <= evaluations - 2:
        raise SimulateError(
            f"--screen: must be from {least} to {evaluations - 2} with {evaluations} evaluations and {count} "
            f"parameters, got {screened}; change --screen or --evaluations"
        )
    run = _Run(space, tuple(objectives), evaluate, evaluations, progress)
    run.add(space.place(space.start), "start")
    if run.evaluated[0].failure:
        raise SimulateError(f"the unchanged design cannot be evaluated: {run.evaluated[0].failure}")
    for place in screening_designs(count, screened, seed, space.is_possible):
        run.add(place, "screen")
    failures = [one.failure for one in run.evaluated if one.failure]
    if 2 * len(failures) > len(run.evaluated):
        raise SimulateError(
            f"most designs of the screening cannot be evaluated (first reason: {failures[0]}); give narrower limits"
        )
    emulators: tuple[DesignEmulator, ...] = ()
    for step in range(evaluations - len(run.evaluated) - 1):
        searched = run.searched()
        emulators = searched.emulators(emulators, is_fitted_again=step % _REFIT == 0)
        rng = np.random.default_rng([seed, step])
        weights = _weights(searched.losses, step, rng)
        run.add(next_design(emulators, weights, rng, run.is_worth_trying), "search")
    emulators = run.searched().emulators(emulators)
    rng = np.random.default_rng([seed, evaluations])
    run.add(best_design(emulators, np.ones(len(objectives)), rng, run.is_worth_trying), "chosen")
    if run.evaluated[-1].failure:
        raise SimulateError(f"the design with the best expected value cannot be evaluated: {run.evaluated[-1].failure}")
    return run.searched()


@dataclass
class _Run:
    """A search in progress."""

    space: DesignSpace
    objectives: tuple[DesignObjective, ...]
    evaluate: Evaluate
    evaluations: int
    progress: Progress | None
    places: list[Floats] = field(default_factory=list)
    roles: list[DesignRole] = field(default_factory=list)
    evaluated: list[EvaluatedDesign] = field(default_factory=list)

    def add(self, place: Floats, role: DesignRole) -> None:
        """Evaluate one more design."""
        place = self.space.snapped(place)
        self.evaluated.append(self.evaluate(self.space.design_at(place)))
        self.places.append(place)
        self.roles.append(role)
        if self.progress is not None:
            count = len(self.evaluated)
            self.progress(count, self.evaluations, f"design {count} of {self.evaluations}, {self._left()}")

    def _left(self) -> str:
        """Say how much processor time the designs to come will take, by the median of those so far."""
        left_s = float(np.median([one.processor_s for one in self.evaluated]))
        left_s *= self.evaluations - len(self.evaluated)
        return f"{left_s / 60.0:.0f} min left" if left_s >= _MINUTES_FROM_S else f"{left_s:.0f} s left"

    def searched(self) -> DesignSearch:
        """Return what was computed so far."""
        changes = tuple(self.space.changes(place) for place in self.places)
        return DesignSearch(
            self.objectives, self.space.parameters, np.array(self.places), changes, tuple(self.roles),
            tuple(self.evaluated),
        )  # fmt: skip

    def is_worth_trying(self, place: Floats) -> bool:
        """Return whether a design is possible and nearer to one that could be evaluated than to one that could not."""
        distance = np.linalg.norm(np.array(self.places) - place, axis=1)
        return not self.evaluated[int(distance.argmin())].failure and self.space.is_possible(place)


def _weights(seen: Floats, step: int, rng: np.random.Generator) -> Floats:
    """Return weights of the losses: equal ones, and random ones over the losses' spreads by turns."""
    count = seen.shape[1]
    if count == 1 or step % 2 == 0:
        return np.ones(count)
    spread = seen.std(axis=0)
    return np.asarray(rng.dirichlet(np.ones(count)) / np.where(spread > 0.0, spread, 1.0))


def confirmed_losses(
    designs: Sequence[FingerDesign],
    objectives: Sequence[DesignObjective],
    evaluations: DesignEvaluations,
    times: int,
    progress: Progress | None = None,
) -> Floats | None:
    """Return the losses of a few designs with seeds and contact places that no search has seen, (time, design, K).

    None where one of them cannot be evaluated so, or fewer than three times are asked for.

    Parameters
    ----------
    designs
        Fingers that are compared; all see the same seeds and places.
    objectives
        K of them. What has no random numbers (stiffness) is the same each time.
    evaluations
        Evaluates and keeps.
    times
        Seeds.
    progress
        Called after each evaluation.
    """
    if times < 3:
        return None
    found: list[list[EvaluatedDesign]] = []
    for again in range(1, times + 1):
        row = []
        for design in designs:
            row.append(evaluations.evaluate(design, again))
            if progress is not None:
                done = len(designs) * (again - 1) + len(row)
                progress(done, len(designs) * times, "other seeds and places")
        found.append(row)
    if any(one.failure for row in found for one in row):
        return None
    values = np.array([[[one.values[o.name] for o in objectives] for one in row] for row in found])
    return np.array([losses(of_seed, objectives) for of_seed in values])
