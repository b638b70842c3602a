"""What a session will take, found without moving, lighting or storing anything."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

from data_schemas.capture import PaintPlan
from data_schemas.errors import CaptureError
from data_schemas.rig import RigFile
from rigs.capture.exposure import exposure_ladder
from rigs.capture.frame_store import BYTES_PER_PIXEL
from rigs.capture.plan import Step
from rigs.open_rig import OpenRig

WHEEL_MOVE_S = 1.0  # to a neighbouring slot: the slowest of the usual wheels
METERING_FRAMES = 4  # a step, typically
LIT_SESSION_EXPOSURE_S = 0.5  # typical mean exposure; what it really is only metering tells


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a session will take.

    Attributes
    ----------
    steps, most_frames
        Steps, and frames if every step needs other exposures than the rest.
    targets
        How often the operator is asked for another target.
    moves
        Moves of the wheel.
    disk_bytes
        Space on disk for `most_frames`.
    typical_s, longest_s
        Duration with typical exposures, and if every frame took the camera's longest (s); operator not counted.
    """

    steps: int
    most_frames: int
    targets: int
    moves: int
    disk_bytes: int
    typical_s: float
    longest_s: float


def forecast(plan: PaintPlan, rig: RigFile, steps: Sequence[Step]) -> Forecast:
    """Return what a paint session of these steps will take.

    Parameters
    ----------
    plan, rig
        The plan and the rig that `steps` were listed for.
    steps
        Steps of the session.
    """
    rungs = len(exposure_ladder(rig.camera.shortest_exposure_s, rig.camera.longest_exposure_s))
    lit = (len(steps) + 1) * len(plan.bracket)
    darks = 2 * ((plan.darks_per_exposure + 1) // 2) * min(rungs, lit)
    moves = 2 * sum(a.slot != b.slot for a, b in pairwise(steps))
    frames, metering = lit + darks, METERING_FRAMES * len(steps)
    return Forecast(
        steps=len(steps),
        most_frames=frames,
        targets=2 * len(list(groupby(steps, key=lambda step: step.target))) - 1,
        moves=moves,
        disk_bytes=BYTES_PER_PIXEL * rig.camera.width_px * rig.camera.height_px * frames,
        typical_s=moves * WHEEL_MOVE_S + (frames + metering) * LIT_SESSION_EXPOSURE_S,
        longest_s=moves * WHEEL_MOVE_S + (frames + metering) * rig.camera.longest_exposure_s,
    )


def require_ready(opened: OpenRig, steps: Sequence[Step]) -> None:
    """Check the open devices against the steps: slots exist, lights are off.

    Raises
    ------
    CaptureError
        The wheel lacks a slot, or a light is on.
    """
    lost = sorted({step.slot for step in steps if step.slot is not None} - set(opened.wheel.slots))
    if lost:
        raise CaptureError(
            f"filter wheel: has no slot {lost[0]}; its slots are {', '.join(map(str, opened.wheel.slots))}: correct "
            "the slots of the rig file, or split the plan into sessions with fewer filters"
        )
    for name, light in (("lamp", opened.lamp), ("laser", opened.laser)):
        if light.state():
            raise CaptureError(f"{name}: is on although nobody asked; switch it off and look at its controller")
