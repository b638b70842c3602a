"""The devices of a rig for bluesky: camera, filter wheel, laser and lamp as ophyd-async devices.

::

    RE = RunEngine()
    with ophyd_rig(rig, Path()) as devices:
        RE(bp.count([devices.camera, devices.wheel]))

They are the same drivers with the same checks: a wheel has arrived when it says so twice, a frame counts only if wheel
and lights stand as they stood before the exposure, a laser is lit behind its guard processes only. The RunEngine stops
what a plan has moved when the plan ends, fails or pauses: a light is off then. When the program dies, its guard
switches off. The RunEngine only logs that a light is not confirmed off: the end of :func:`ophyd_rig` raises it.
"""

import asyncio
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np

from data_schemas import BadFrameError, MissingExtraError, RefusedError, RigFile, Target, UnsafeError
from rigs import Camera, FilterWheel, Light, Operator, open_rig, rig_locked
from rigs.capture import CAMERA_DEADLINE_MARGIN_S, CAMERA_EXPOSURES, WHEEL_DEADLINE_S
from rigs.light_guard import LightLostError, is_hazardous

try:
    from bluesky.run_engine import call_in_bluesky_event_loop
    from ophyd_async.core import (
        AsyncStatus,
        SignalR,
        SoftSignalBackend,
        StandardReadable,
        init_devices,
        soft_signal_r_and_setter,
        soft_signal_rw,
    )
    from ophyd_async.core import StandardReadableFormat as Format
except ImportError as missing:
    raise MissingExtraError(
        f"devices for bluesky need ophyd-async ({missing}); install it with pip install 'finray-calib[bluesky]'"
    ) from None

T = TypeVar("T")
Asked = TypeVar("Asked", int, str, bool)
Reading = float | int | str | bool
NO_SLOT = 0
"""Position of a wheel that has no filter in the beam; slots count from 1."""


class _Caller:
    """Makes the blocking calls of one device in a thread of its own, one after the other."""

    def __init__(self, name: str) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=name)

    async def __call__(self, function: Callable[[], T]) -> T:
        return await asyncio.wrap_future(self._thread.submit(function))

    def now(self, function: Callable[[], T]) -> T:
        """Make a call from another thread than that of the event loop."""
        return self._thread.submit(function).result()

    def close(self) -> None:
        """End the thread when its calls have ended."""
        self._thread.shutdown()


def _asked(kind: type[Asked], ask: Callable[[], Asked], call: _Caller) -> "SignalR[Asked]":
    """Return a signal whose value is asked of the device each time it is read."""

    async def getter() -> Asked:
        return await call(ask)

    return SignalR(SoftSignalBackend(kind, getter=getter))


class RigWheel(StandardReadable):
    """The filter wheel: ``yield from bps.mv(wheel, 3)``; its position is asked of the device each time it is read.

    Parameters
    ----------
    wheel
        As a rig opens it.
    filters
        Slot -> name of the filter.
    name
        Of the device, for the documents.
    """

    def __init__(self, wheel: FilterWheel, filters: dict[int, str], name: str = "wheel") -> None:
        self._wheel, self._filters = wheel, filters
        self.call = _Caller(name)
        with self.add_children_as_readables(Format.HINTED_UNCACHED_SIGNAL):
            self.slot = _asked(int, self.position, self.call)
        with self.add_children_as_readables(Format.UNCACHED_SIGNAL):
            self.filter_name = _asked(str, lambda: filters.get(self.position(), "no filter"), self.call)
        super().__init__(name=name)

    def position(self) -> int:
        """Return the slot in the beam, 0 where no filter is."""
        return self._wheel.position() or NO_SLOT

    @AsyncStatus.wrap
    async def set(self, value: int) -> None:
        """Move to a slot; done when the wheel says twice that it is there.

        Raises
        ------
        CaptureError
            The wheel has no such slot, did not arrive in time, or came to rest at another one.
        """
        await self.call(lambda: self._wheel.go_to(int(value), WHEEL_DEADLINE_S))


class RigLight(StandardReadable):
    """Laser or lamp: ``yield from bps.mv(laser, True)``; off when the plan ends, fails, pauses or unstages it.

    A pause switches off, and going on switches on again what was on: a laser that harms eyes only after asking. A light
    that is once not confirmed off is never lit again.

    Parameters
    ----------
    light
        As a rig opens it: a laser behind its guard.
    name
        Of the device, for the documents.
    operator
        Who is asked before a light that harms eyes is lit again after a pause, or after it was lost: somebody may have
        opened the box. None where it harms nobody.
    """

    def __init__(self, light: Light, name: str, operator: Operator | None = None) -> None:
        self._light, self._operator = light, operator
        self._block = ExitStack()
        self._is_lit = self._was_lost = False
        self._not_off: UnsafeError | None = None
        # tasks of the RunEngine, one for each plan
        self._stopped: asyncio.Task[Any] | None = None
        self._paused: asyncio.Task[Any] | None = None
        self.call = _Caller(name)
        with self.add_children_as_readables(Format.HINTED_UNCACHED_SIGNAL):
            self.is_on = _asked(bool, self.state, self.call)
        super().__init__(name=name)

    def state(self) -> bool:
        """Return whether the light is on, as its controller says."""
        try:
            is_on = self._light.state()
        except LightLostError:
            self._was_lost = True
            raise
        self._was_lost |= self._is_lit and not is_on
        return is_on

    @AsyncStatus.wrap
    async def set(self, value: bool) -> None:
        """Switch; done when the controller confirms it.

        Raises
        ------
        CaptureError
            It must not be lit, did not come on, or went off by itself after it was lit.
        UnsafeError
            It is not confirmed off, or was not before.
        """
        self._stopped = self._paused = None
        await self.call(self._on if value else self.off)

    async def stop(self, success: bool | None = None) -> None:
        """Switch off: the plan has ended, failed or paused; a plan that stops a light itself says nothing of success.

        Raises
        ------
        UnsafeError
            It is not confirmed off, or was not before.
        """
        # in a pause the RunEngine stops what was moved first, and tells of the pause then, in the task of the plan
        self._stopped = asyncio.current_task() if self._is_lit and success is not None else None
        if success is None:
            self._paused = None
        await self.call(self.off)

    async def pause(self) -> None:
        """Switch off, and remember whether this plan had lit it.

        Raises
        ------
        UnsafeError
            It is not confirmed off, or was not before.
        """
        plan = asyncio.current_task()
        self._paused = plan if self._is_lit or plan in (self._stopped, self._paused) else None
        await self.call(self.off)

    async def resume(self) -> None:
        """Light again what a pause of this plan has switched off.

        Raises
        ------
        LightLostError
            A person would have to allow it and has not; it stays off, and the plan paused.
        """
        if self._paused is not None and not self._paused.done():
            await self.call(self._on_again)
        self._stopped = self._paused = None

    @AsyncStatus.wrap
    async def unstage(self) -> None:
        """Switch off with the end of a stage."""
        self._stopped = self._paused = None
        await self.call(self.off)
        await super().unstage()

    def _on_again(self) -> None:
        self._require_permission("was switched off by a pause")
        self._on()

    def _on(self) -> None:
        if self._not_off is not None:
            raise self._not_off
        if self._is_lit:
            if not self.state():
                self.off()
                raise LightLostError(
                    f"{self.name}: went off without a command and stays off; find out why, then switch it on again"
                )
            return
        if self._was_lost:
            self._require_permission("was lost")
        try:
            self._block.enter_context(self._light.lit())
        except UnsafeError as error:
            self._not_off = error
            raise
        self._is_lit = True

    def _require_permission(self, what_was: str) -> None:
        """Ask before a light that harms eyes is lit again."""
        if self._operator is not None and not self._operator.allows(
            f"The {self.name} {what_was}. Is the box closed, does everybody wear goggles, and may the {self.name} be "
            "switched on again?"
        ):
            raise LightLostError(
                f"{self.name}: {what_was}, and is switched on again only after a person at the terminal has confirmed "
                "that the box is closed; close the box, then continue in a terminal"
            )
        self._was_lost = False

    def off(self) -> None:
        """Switch off.

        Raises
        ------
        UnsafeError
            It is not confirmed off, or was not before: the RunEngine only logs what a stop raises.
        """
        self._is_lit = False
        try:
            self._block.close()
        except UnsafeError as error:
            self._not_off = error
        except LightLostError:
            self._was_lost = True
            raise
        if self._not_off is not None:
            raise self._not_off


class RigTarget(StandardReadable):
    """What is in view: ``yield from bps.mv(target, "sample")`` asks the operator to put it there, without a deadline.

    Parameters
    ----------
    operator
        Of the rig: a person, or the simulated one.
    name
        Of the device, for the documents.
    """

    def __init__(self, operator: Operator, name: str = "target") -> None:
        self._operator = operator
        self.call = _Caller(name)
        with self.add_children_as_readables(Format.UNCACHED_SIGNAL):
            self.in_view, self._set_in_view = soft_signal_r_and_setter(str, "unknown")
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def set(self, value: Target) -> None:
        """Have a target placed.

        Raises
        ------
        RefusedError
            There is no such target.
        CaptureError
            Nobody can answer.
        """
        if value not in get_args(Target):
            raise RefusedError(f"target: '{value}' is not valid; valid targets are {', '.join(get_args(Target))}")
        self._set_in_view("unknown")
        await self.call(lambda: self._operator.place(value))
        self._set_in_view(value)


class RigCamera(StandardReadable):
    """The camera: ``trigger`` takes a frame of ``exposure_s`` seconds; the event holds it with what was read back.

    Parameters
    ----------
    camera
        As a rig opens it.
    rig
        Its bits and exposures are those of the camera.
    surroundings
        What must not change during an exposure: the wheel and the lights.
    name
        Of the device, for the documents.
    """

    def __init__(
        self, camera: Camera, rig: RigFile, surroundings: "tuple[RigWheel | RigLight, ...]", name: str = "camera"
    ) -> None:
        self._camera, self._rig, self._surroundings = camera, rig, surroundings
        self._full_scale_dn = 2**rig.camera.bit_depth - 1
        self.call = _Caller(name)
        with self.add_children_as_readables(Format.CONFIG_SIGNAL):
            self.exposure_s = soft_signal_rw(float, rig.camera.shortest_exposure_s, units="s")
        with self.add_children_as_readables(Format.HINTED_UNCACHED_SIGNAL):
            self.mean_dn, self._set_mean = soft_signal_r_and_setter(float, units="DN")
        with self.add_children_as_readables(Format.UNCACHED_SIGNAL):
            self.frame, self._set_frame = soft_signal_r_and_setter(np.ndarray, units="DN")
            self.exposed_s, self._set_exposed = soft_signal_r_and_setter(float, units="s")
            self.saturated_fraction, self._set_saturated = soft_signal_r_and_setter(float)
            self.captured_utc, self._set_captured = soft_signal_r_and_setter(str)
        super().__init__(name=name)

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        """Take one frame.

        Raises
        ------
        RefusedError
            The camera cannot expose for so long.
        BadFrameError
            The wheel or a light changed during the exposure.
        CaptureError
            The camera did not deliver a good frame in time.
        """
        exposure_s, limits = await self.exposure_s.get_value(), self._rig.camera
        if not limits.shortest_exposure_s <= exposure_s <= limits.longest_exposure_s:
            raise RefusedError(
                f"camera: exposure_s = {exposure_s:g} s is outside the range of the rig file; "
                f"{limits.shortest_exposure_s:g} to {limits.longest_exposure_s:g} s are allowed"
            )
        before = await self._surrounded()
        limit_s = CAMERA_EXPOSURES * exposure_s + CAMERA_DEADLINE_MARGIN_S
        raw = await self.call(lambda: self._camera.expose(exposure_s, limit_s))
        after = await self._surrounded()
        if before != after:
            raise BadFrameError(
                f"camera: the state was {before} before the exposure, but {after} after it, so the frame is not used; "
                "take the frame again"
            )
        self._set_frame(raw.counts)
        self._set_mean(float(raw.counts.mean()))
        self._set_exposed(raw.exposure_s)
        self._set_saturated(float(np.mean(raw.counts >= self._full_scale_dn)))
        self._set_captured(raw.captured_utc)

    async def _surrounded(self) -> dict[str, Reading]:
        """Return where the wheel and the lights are; asking also tells the guard of a light that the plan is alive."""
        found: dict[str, Reading] = {}
        for device in self._surroundings:
            ask = device.position if isinstance(device, RigWheel) else device.state
            found[device.name] = await device.call(ask)
        return found


@dataclass(frozen=True, slots=True)
class OphydRig:
    """The devices of an open rig for bluesky."""

    camera: RigCamera
    wheel: RigWheel
    laser: RigLight
    lamp: RigLight
    target: RigTarget


@contextmanager
def ophyd_rig(rig: RigFile, folder: Path, operator: Operator | None = None) -> Iterator[OphydRig]:
    """Open a rig as ophyd-async devices for a ``with`` block, as :func:`rigs.open_rig` does.

    Raises
    ------
    RefusedError
        There is no RunEngine yet: its event loop runs the devices.
    CaptureError
        Another process holds a device, or one cannot be reached.
    UnsafeError
        At the end: a light was not confirmed off.
    """
    try:
        call_in_bluesky_event_loop(asyncio.sleep(0.0))
    except RuntimeError:
        raise RefusedError(
            "bluesky: there is no RunEngine yet; create it before the devices (RE = RunEngine())"
        ) from None
    with rig_locked(rig), open_rig(rig, folder, operator) as opened, ExitStack() as ended:
        filters = {band.slot: band.name for band in rig.filter_wheel.filters}
        with init_devices(set_name=False):
            wheel = RigWheel(opened.wheel, filters)
            laser = RigLight(opened.laser, "laser", opened.operator if is_hazardous(rig.laser) else None)
            lamp = RigLight(opened.lamp, "lamp")
            target = RigTarget(opened.operator)
            camera = RigCamera(opened.camera, rig, (wheel, laser, lamp))
        for device in (target, wheel, camera, lamp, laser):  # the last one is ended first
            ended.callback(device.call.close)
            if isinstance(device, RigLight):
                ended.callback(device.call.now, device.off)
        yield OphydRig(camera, wheel, laser, lamp, target)
