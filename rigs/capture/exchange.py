"""One checked exposure: wheel in place before and after, lights as planned, exposure and frame as asked."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass

from data_schemas.capture import LightState
from data_schemas.errors import CaptureError
from data_schemas.rig import CameraSettings
from rigs.capture.plan import Step
from rigs.open_rig import OpenRig
from rigs.protocols import RawFrame

WHEEL_DEADLINE_S = 20.0
CAMERA_DEADLINE_MARGIN_S = 5.0
# Cameras set exposures in multiples of a line time; more than this is a setting that was not taken.
EXPOSURE_TOLERANCE_REL = 0.05


@dataclass(frozen=True, slots=True)
class CheckedFrame:
    """A raw frame with the wheel's position before and after it."""

    raw: RawFrame
    slot_before: int | None
    slot_after: int | None


@contextmanager
def shine(opened: OpenRig, light: LightState) -> Iterator[None]:
    """Keep the planned light on for a ``with`` block and check that only this one is on."""
    device = {"lamp": opened.lamp, "laser": opened.laser}.get(light)
    with nullcontext() if device is None else device.lit():
        for name, other in (("lamp", opened.lamp), ("laser", opened.laser)):
            if other.state() != (name == light):
                raise CaptureError(
                    f"{name}: reads back {'on' if other.state() else 'off'} where the step needs light '{light}'; "
                    "check its connection and switch"
                )
        yield


def expose_checked(opened: OpenRig, camera: CameraSettings, step: Step, exposure_s: float) -> CheckedFrame:
    """Turn the wheel to the filter of `step`, expose once and check everything that can be read back.

    Raises
    ------
    CaptureError
        The wheel is or was at another slot, or the camera used another exposure or frame size.
    """
    if step.slot is not None and opened.wheel.position() != step.slot:
        opened.wheel.go_to(step.slot, WHEEL_DEADLINE_S)
    before = _require_slot(opened, step, "before")
    raw = opened.camera.expose(exposure_s, exposure_s + CAMERA_DEADLINE_MARGIN_S)
    after = _require_slot(opened, step, "after")
    if abs(raw.exposure_s / exposure_s - 1.0) > EXPOSURE_TOLERANCE_REL:
        raise CaptureError(
            f"camera: {exposure_s:g} s were asked for {step.label}, it reads back {raw.exposure_s:g} s (within "
            f"{EXPOSURE_TOLERANCE_REL:.0%} is allowed); correct shortest_exposure_s and longest_exposure_s of the rig"
        )
    if raw.counts.shape != (camera.height_px, camera.width_px):
        raise CaptureError(
            f"camera: delivered a frame of {raw.counts.shape[0]} x {raw.counts.shape[1]} px, the rig file says "
            f"{camera.height_px} x {camera.width_px} px (height x width); correct the rig file"
        )
    return CheckedFrame(raw, before, after)


def _require_slot(opened: OpenRig, step: Step, when: str) -> int | None:
    """Return the wheel's position after checking that it is the one of the step."""
    position = opened.wheel.position()
    if position != step.slot:
        raise CaptureError(
            f"filter wheel: reads slot {position} {when} the exposure of {step.label}, slot {step.slot} is needed; "
            "the wheel slipped or is not where the operator left it: home it and start again"
        )
    return position
