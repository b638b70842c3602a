"""The device part of an acceptance check: it records what the devices do; :mod:`finray_calib.acceptance` judges.

Who the devices say they are, where the wheel goes, what the frames show, and how fast the light goes off.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final, Literal, Protocol, TypeVar

import numpy as np

from data_schemas import (
    BandPassFilter,
    CaptureError,
    CheckFacts,
    CheckPlan,
    DeviceIdentity,
    Handshake,
    LightOff,
    RigFile,
    Section,
    UnsafeError,
    WheelMove,
    WrongPositionError,
)
from rigs import OpenRig, Operator, TerminalOperator, open_rig, rig_locked
from rigs.capture._check_frames import CheckFrames
from rigs.capture._exposure import WHEEL_DEADLINE_S
from rigs.capture._plan import planned_filters, require_named, require_region_inside
from rigs.capture.light_off_time import (
    CameraWatch,
    ConnectionWatch,
    LaserWatch,
    Sight,
    after_exception,
    after_kill,
    can_be_asked_anew,
    find_sight,
)
from rigs.light_guard import GuardedLight, LightLostError, is_hazardous

Progress = Callable[[int, int, str], None]
T = TypeVar("T")

QUIET_SHARE: Final = 0.95
"""Of the limit: when a dead-man is asked whether it has acted. Earlier questions would keep it from acting."""
WITH_OPEN_RIG: Final[tuple[Section, ...]] = (
    "handshake", "wheel", "dark frames", "filters", "revisits", "exposures", "light off",
)  # fmt: skip
STEPS: Final = len(WITH_OPEN_RIG) + 3
"""Opening, these, closing, and the laser's layers without the rig."""


def check_filters(plan: CheckPlan, rig: RigFile) -> list[BandPassFilter]:
    """Return the filters to be checked, after checking the plan against the rig.

    Raises
    ------
    CaptureError
        The check has no name, the rig lacks a filter, or the region is empty or leaves the frame.
    """
    require_named("plan.check_name", plan.check_name)
    require_region_inside(plan.region, rig.camera)
    return planned_filters(plan.filters, rig)


def record_facts(
    rig: RigFile,
    plan: CheckPlan,
    rig_folder: Path,
    progress: Progress = lambda done, total, what: None,
    *,
    operator: Operator | None = None,
) -> tuple[CheckFacts, tuple[str, ...]]:
    """Try the devices of a rig and return what they did, with the notes of the rig.

    A device error ends its own section only; all lights are confirmed off before the next begins. A light that is
    not confirmed off ends everything, and so does a laser of class 3R or above that went out by itself.

    Parameters
    ----------
    rig, plan
        The rig and what to check on it.
    rig_folder
        Where relative paths in the rig file start.
    progress
        Called with (done, total, text) at the start of every section.
    operator
        Who places the white tile; a person at the terminal when left out.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, or another process uses it.
    """
    filters = check_filters(plan, rig)
    with rig_locked(rig):
        return _Recorder(rig, plan, rig_folder, filters, progress).record(operator or TerminalOperator())


class _Recorder:
    """Walks through the sections of one check."""

    def __init__(
        self, rig: RigFile, plan: CheckPlan, rig_folder: Path, filters: list[BandPassFilter], progress: Progress
    ) -> None:
        self._rig, self._plan, self._folder, self._filters, self._progress = rig, plan, rig_folder, filters, progress
        self._facts = CheckFacts()
        self._errors: dict[Section, str] = {}
        self._ended: str | None = None
        self._done = 0
        self._has_dead_man: bool | None = None  # of a laser that has a guard
        self._sight: Sight | None = None
        self._frames: CheckFrames | None = None

    def record(self, operator: Operator) -> tuple[CheckFacts, tuple[str, ...]]:
        """Open the rig, try everything, close it, then try what needs the laser for itself."""
        notes: tuple[str, ...] = ()
        with ExitStack() as stack:
            opened = self._attempt("opening", lambda: stack.enter_context(open_rig(self._rig, self._folder, operator)))
            if opened is None:
                self._ended = "the rig could not be opened"
                self._errors |= dict.fromkeys(WITH_OPEN_RIG, f"not tried: {self._ended}")
            else:
                notes = opened.notes
                self._with_open_rig(opened)
            closing = stack.pop_all()
        self._attempt("closing", closing.close, also_when_ended=True)
        layers = self._attempt("light off", self._without_rig) or ()
        self._keep(light_off=(*self._facts.light_off, *layers), errors=self._errors)
        return self._facts, notes

    def _with_open_rig(self, opened: OpenRig) -> None:
        """Try everything that the open rig can show."""
        if isinstance(opened.laser, GuardedLight):
            self._has_dead_man = opened.laser.has_dead_man
        frames = self._frames = CheckFrames(
            opened,
            self._rig,
            self._plan,
            self._filters,
            lambda text: self._progress(self._done - 1, STEPS, text),
        )
        self._keep(handshakes=self._attempt("handshake", lambda: handshakes(opened, self._rig)) or ())
        moves: list[WheelMove] = []
        self._attempt("wheel", lambda: moves.extend(wheel_moves(opened, self._plan, self._filters)))
        self._keep(moves=tuple(moves))  # those before an error too
        self._lights_are_off(opened, "wheel")
        self._keep(darks=self._attempt("dark frames", frames.dark_frames) or ())
        self._lights_are_off(opened, "dark frames")
        self._keep(filter_proof=self._attempt("filters", frames.prove_filters))
        self._lights_are_off(opened, "filters")
        self._keep(revisits=self._attempt("revisits", frames.revisits) or (), revisit_filter=frames.revisit_filter)
        self._lights_are_off(opened, "revisits")
        self._keep(levels=self._attempt("exposures", frames.exposure_levels) or ())
        self._lights_are_off(opened, "exposures")
        self._attempt("light off", lambda: self._block_layer(opened))
        self._lights_are_off(opened, "light off")

    def _attempt(self, section: Section, act: Callable[[], T], *, also_when_ended: bool = False) -> T | None:
        """Return what `act` returns; note its error and return None."""
        if self._ended is not None and not also_when_ended:
            self._errors.setdefault(section, f"not tried: {self._ended}")
            return None
        self._progress(self._done, STEPS, section)
        self._done = min(self._done + 1, STEPS)
        try:
            return act()
        except CaptureError as error:
            self._errors.setdefault(section, str(error))
            if isinstance(error, UnsafeError):
                self._ended = "a light is not confirmed off"
            elif isinstance(error, LightLostError) and section == "light off" and is_hazardous(self._rig.laser):
                self._ended = "the laser went out, and is not lit again until a person has found out why"
            return None

    def _lights_are_off(self, opened: OpenRig, section: Section) -> None:
        """End the check when a light is on, or cannot be asked, between two sections."""
        if self._ended is not None:
            return
        try:
            on = [name for name, light in (("laser", opened.laser), ("lamp", opened.lamp)) if light.state()]
        except CaptureError as error:
            self._errors.setdefault(section, str(error))
            self._ended = f"a light does not report whether it is off ({error})"
            return
        if on:
            self._errors[section] = f"{on[0]}: reads back on after this section; pull its plug before you open the box"
            self._ended = f"the {on[0]} is on"

    def _keep(self, **what: object) -> None:
        """Add facts."""
        self._facts = self._facts.model_copy(update=what)

    def _block_layer(self, opened: OpenRig) -> None:
        """Try the block that lights the laser, and see whether the camera sees it."""
        opened.operator.place("white")
        self._keep(light_off=(after_exception(opened, self._plan.light_off_repeats),))
        if self._has_dead_man is not None and self._frames is not None:
            self._sight = find_sight(opened, self._rig, self._frames)

    def _without_rig(self) -> tuple[LightOff, ...]:
        """Try guard and dead-man, the rig being closed."""
        if self._has_dead_man is None:
            reason = "no guard on the simulated rig" if self._rig.is_simulated else "this laser has no guard process"
            return LightOff(layer="guard", missing=reason), LightOff(layer="dead-man", missing=reason)
        if (why := self._errors.get("light off")) is not None and is_hazardous(self._rig.laser):
            return LightOff(layer="guard", error=_not_lit(why)), LightOff(layer="dead-man", error=_not_lit(why))
        guard = self._layer("guard")
        if guard.error is not None and is_hazardous(self._rig.laser):
            return guard, LightOff(layer="dead-man", error=_not_lit(guard.error))
        if not self._has_dead_man:
            reason = "the laser's controller has no dead-man: when the computer hangs, the laser stays on"
            return guard, LightOff(layer="dead-man", missing=reason)
        return guard, self._layer("dead-man")

    def _layer(self, layer: Literal["guard", "dead-man"]) -> LightOff:
        """Try one layer before a witness."""
        laser, repeats = self._rig.laser, self._plan.light_off_repeats
        try:
            if self._sight is not None and self._frames is not None:
                with CameraWatch(self._rig, self._folder, self._frames, self._sight).open() as camera:
                    return after_kill(laser, layer, camera, repeats)
            if can_be_asked_anew(laser):
                quiet_s = QUIET_SHARE * self._plan.limits.light_off_s
                watch: LaserWatch = ConnectionWatch(laser, quiet_s) if layer == "dead-man" else ConnectionWatch(laser)
                return after_kill(laser, layer, watch, repeats)
        except UnsafeError:
            raise
        except CaptureError as error:
            return LightOff(layer=layer, error=str(error))
        return LightOff(
            layer=layer,
            missing="nobody can watch: the camera does not see the laser, and opening the laser's serial port a second "
            "time resets most boards, which switches it off",
        )


def _not_lit(why: str) -> str:
    """Say that a laser that harms eyes is not lit after an error: it may be that somebody opened the box."""
    return f"not tried: the laser is not lit again until a person has found out why: {why}"


HANDSHAKES: Final = 3


class _Named(Protocol):
    """What every device of a rig is."""

    def identity(self) -> DeviceIdentity:
        """Return what it says it is."""
        ...


def handshakes(opened: OpenRig, rig: RigFile) -> tuple[Handshake, ...]:
    """Ask every device who it is and how it stands."""
    return (
        _handshake(opened, "camera", rig.camera.driver, opened.camera, lambda: None),
        _handshake(opened, "filter wheel", rig.filter_wheel.driver, opened.wheel, opened.wheel.position),
        _handshake(opened, "laser", rig.laser.driver, opened.laser, opened.laser.state),
        _handshake(opened, "lamp", rig.lamp.driver, opened.lamp, opened.lamp.state),
    )


def _handshake(opened: OpenRig, role: object, driver: str, device: _Named, state: Callable[[], object]) -> Handshake:
    """Ask one device some times."""
    durations_s: list[float] = []
    identity, error = None, None
    try:
        for _ in range(HANDSHAKES):
            start_s = opened.clock.monotonic_s()
            identity = device.identity()
            state()
            durations_s.append(opened.clock.monotonic_s() - start_s)
    except CaptureError as raised:
        error = str(raised)
    return Handshake.model_validate(
        {"role": role, "driver": driver, "identity": identity, "durations_s": durations_s, "error": error}
    )


def wheel_moves(opened: OpenRig, plan: CheckPlan, filters: Sequence[BandPassFilter]) -> Iterator[WheelMove]:
    """Turn the wheel to filters drawn at random, never to the one in the beam; arrival is asked afresh."""
    opened.operator.place("white")
    rng = np.random.default_rng(plan.seed)
    slots = [band.slot for band in filters]
    for _ in range(plan.wheel_moves):
        here = opened.wheel.position()
        elsewhere = [slot for slot in slots if slot != here]
        if not elsewhere:
            return
        slot = int(rng.choice(elsewhere))
        start_s = opened.clock.monotonic_s()
        # where it stands is asked below, and is what the check is about
        with suppress(WrongPositionError):
            opened.wheel.go_to(slot, WHEEL_DEADLINE_S)
        duration_s = opened.clock.monotonic_s() - start_s
        arrived = opened.wheel.position()
        yield WheelMove(from_slot=here, to_slot=slot, arrived_slot=arrived, duration_s=duration_s)
