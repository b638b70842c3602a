"""Checked exposures: wheel in place before and after, lights as planned, a new frame with the settings asked for."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Literal

import numpy as np

from data_schemas.capture import LightState
from data_schemas.devices import CameraSettings
from data_schemas.errors import BadFrameError, CaptureError, FrameSizeError, RefusedError, WrongPositionError
from rigs.capture.attempts import exposed, within_attempts
from rigs.capture.plan import Step
from rigs.open_rig import OpenRig
from rigs.protocols import RawFrame

WHEEL_DEADLINE_S = 20.0
CAMERA_DEADLINE_MARGIN_S = 5.0
CAMERA_EXPOSURES = 2  # drivers discard the frame that was under way when the exposure changed
# Cameras set exposures in multiples of a line time; more than this is a setting that was not taken.
EXPOSURE_TOLERANCE_REL = 0.05

LightName = Literal["lamp", "laser"]


@dataclass(frozen=True, slots=True)
class CheckedFrame:
    """A raw frame with what was read back beside it.

    Attributes
    ----------
    raw
        The frame.
    slot_before, slot_after
        Position of the wheel.
    lights_before, lights_after
        Lights that were on.
    attempts
        Exposures it took.
    delivered_s
        When the camera had delivered it (s, monotonic).
    """

    raw: RawFrame
    slot_before: int | None
    slot_after: int | None
    lights_before: tuple[LightName, ...]
    lights_after: tuple[LightName, ...]
    attempts: int
    delivered_s: float


@contextmanager
def shine(opened: OpenRig, light: LightState) -> Iterator[None]:
    """Keep the planned light on for a ``with`` block and check that only this one is on."""
    device = {"lamp": opened.lamp, "laser": opened.laser}.get(light)
    with nullcontext() if device is None else device.lit():
        _require_lights(opened, light)
        yield


class CheckedCamera:
    """The camera of a rig behind its wheel and lights: everything that can be read back is checked.

    Parameters
    ----------
    opened, settings
        The rig and what its file says about the camera.
    on_refusal
        Called with a text for every frame that is refused and taken again.
    """

    def __init__(
        self, opened: OpenRig, settings: CameraSettings, on_refusal: Callable[[str], None] = lambda text: None
    ) -> None:
        self._opened, self._settings, self._on_refusal = opened, settings, on_refusal
        self._last: RawFrame | None = None
        self._slot_of_header: dict[str, int] = {}
        self._header_of_slot: dict[int, str] = {}

    def expose(self, step: Step, exposure_s: float) -> CheckedFrame:
        """Turn the wheel to the filter of `step` and take a frame; four attempts at most.

        A refused frame is taken again, and so is one that did not come: a camera that is lost or late is connected
        again by its next exposure. A wheel that is lost is redone too, one that is late is not: it may be stuck.

        Raises
        ------
        WrongPositionError
            The wheel is or was at another slot.
        BadFrameError, FrameSizeError, LostError
            Every attempt failed.
        CaptureError
            A light is not as planned, or the camera used another exposure.
        """

        def once(attempt: int) -> CheckedFrame:
            return self._once(step, exposure_s, attempt)

        return within_attempts(once, self._on_refusal, f"{step.label}, {exposure_s:g} s")[0]

    def _once(self, step: Step, exposure_s: float, attempt: int) -> CheckedFrame:
        """Take one frame and check it."""
        opened = self._opened
        if step.slot is not None and opened.wheel.position() != step.slot:
            opened.wheel.go_to(step.slot, WHEEL_DEADLINE_S)
        slot_before, lights_before = _require_slot(opened, step, "before"), _require_lights(opened, step.light)
        raw = exposed(opened.camera, exposure_s, CAMERA_EXPOSURES * exposure_s + CAMERA_DEADLINE_MARGIN_S)
        delivered_s = opened.clock.monotonic_s()
        slot_after, lights_after = _require_slot(opened, step, "after"), _require_lights(opened, step.light)
        self._require_as_asked(raw, step, exposure_s)
        require_new(raw, self._last)
        self._require_own_header(raw, step)
        self._last = raw
        return CheckedFrame(raw, slot_before, slot_after, lights_before, lights_after, attempt, delivered_s)

    def _require_as_asked(self, raw: RawFrame, step: Step, exposure_s: float) -> None:
        """Refuse another exposure or frame size than was asked for."""
        asked = (self._settings.height_px, self._settings.width_px)
        shape = raw.counts.shape
        if len(shape) == 3:
            raise RefusedError(
                f"camera: delivers colour pictures ({shape[2]} values a pixel); filtered sessions need raw Bayer "
                "counts: choose a raw pixel format, or another driver"
            )
        if shape != asked:
            raise FrameSizeError(
                f"camera: delivered a frame of {' x '.join(map(str, shape))} px, the rig file says {asked[0]} x "
                f"{asked[1]} px (height x width); correct the rig file"
            )
        # a camera that does not read its exposure back says NaN, which is within nothing
        if not abs(raw.exposure_s / exposure_s - 1.0) <= EXPOSURE_TOLERANCE_REL:
            raise RefusedError(
                f"camera: {exposure_s:g} s were asked for {step.label}, it reads back {raw.exposure_s:g} s (within "
                f"{EXPOSURE_TOLERANCE_REL:.0%} is allowed); correct shortest_exposure_s and longest_exposure_s of the "
                "rig"
            )

    def _require_own_header(self, raw: RawFrame, step: Step) -> None:
        """Refuse a header that names one filter at two slots, or two at one: it tells another wheel, or an old move."""
        header = str(raw.settings.get("filter_header", ""))
        if not header or step.slot is None:
            return
        slot = self._slot_of_header.setdefault(header, step.slot)
        name = self._header_of_slot.setdefault(step.slot, header)
        if slot == step.slot and name == header:
            return
        before = f"as at slot {slot}" if slot != step.slot else f"where it said '{name}' before"
        raise RefusedError(
            f"camera: the frame's FILTER header says '{header}' at slot {step.slot}, {before}; it follows the wheel "
            f"'{raw.settings.get('active_filter', 'unknown')}': set the camera's ACTIVE_DEVICES to the wheel in use "
            "and give each slot a name of its own"
        )


def require_new(raw: RawFrame, last: RawFrame | None) -> None:
    """Refuse the frame that was delivered last time.

    Raises
    ------
    BadFrameError
        It has the number and time of the last one, or its payload where there are none.
    """
    if last is None:
        return
    if raw.frame_id is not None or raw.device_time_s is not None:
        same = (raw.frame_id, raw.device_time_s) == (last.frame_id, last.device_time_s)
    else:  # two frames of one value each may well be equal
        same = np.array_equal(raw.counts, last.counts) and raw.counts.min() < raw.counts.max()
    if same:
        raise BadFrameError(
            "camera: delivered the same frame twice; its stream hangs or a picture stands in for the camera"
        )


def _require_slot(opened: OpenRig, step: Step, when: str) -> int | None:
    """Return the wheel's position after checking that it is the one of the step; None when it is swung out.

    A wheel that the operator swung out of the beam still counts its slots.
    """
    if step.slot is None:
        return None
    position = opened.wheel.position()
    if position != step.slot:
        reads = "no slot (it moves)" if position is None else f"slot {position}"
        raise WrongPositionError(
            f"filter wheel: reads {reads} {when} the exposure of {step.label}, slot {step.slot} is needed; "
            "the wheel slipped or is not where the operator left it: home it and start again"
        )
    return position


def _require_lights(opened: OpenRig, planned: LightState) -> tuple[LightName, ...]:
    """Return the lights that are on after checking that it is the planned one alone."""
    states: dict[LightName, bool] = {"lamp": opened.lamp.state(), "laser": opened.laser.state()}
    for name, on in states.items():
        if on != (name == planned):
            raise CaptureError(
                f"{name}: reads back {'on' if on else 'off'} where the step needs light '{planned}'; check its "
                "connection, switch and interlock"
            )
    return tuple(name for name, on in states.items() if on)
