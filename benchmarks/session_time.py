"""How long a paint session takes beside its exposures and wheel moves: writing and checking overlap the wheel.

    python benchmarks/session_time.py --out bench-out/session-time.json

The simulated rig with real time: moves of 0.5 s a slot at most, exposures slept, frames of 1280 x 1024 px computed
beforehand (a camera's own transfer time is not counted). Bar: exposures + moves + 15 %.
"""

import argparse
import json
import sys
import tempfile
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from data_schemas import DeviceIdentity
from rigs import Camera, FilterWheel, RawFrame, SystemClock, open_rig, paint_plan, simulated_rig
from rigs.capture import SessionRequest, paint_steps
from rigs.capture._paint_session import capture_with

MOVE_S = 0.5
BAR = 1.15


@dataclass
class SleepingWheel:
    """A wheel that needs half a second for every move."""

    wheel: FilterWheel
    slept_s: float = 0.0

    @property
    def slots(self):
        return self.wheel.slots

    def identity(self) -> DeviceIdentity:
        return self.wheel.identity()

    def position(self):
        return self.wheel.position()

    def go_to(self, slot: int, deadline_s: float) -> None:
        time.sleep(MOVE_S)
        self.slept_s += MOVE_S
        self.wheel.go_to(slot, deadline_s)


@dataclass
class SleepingCamera:
    """A camera that takes its exposure and delivers at once what was computed for it in an earlier session."""

    camera: Camera
    stored: list[RawFrame] = field(default_factory=list)
    replaying: bool = False
    slept_s: float = 0.0

    def identity(self) -> DeviceIdentity:
        return self.camera.identity()

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        if not self.replaying:
            self.stored.append(self.camera.expose(exposure_s, deadline_s))
            return self.stored[-1]
        time.sleep(exposure_s)
        self.slept_s += exposure_s
        return replace(self.stored.pop(0), exposure_requested_s=exposure_s, captured_utc=SystemClock().utc())


def main() -> int:
    """Measure, print, store; return 1 when the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    rig = simulated_rig("red")
    plan = paint_plan("red", rig.camera)
    steps = paint_steps(plan, rig)
    with tempfile.TemporaryDirectory() as folder, open_rig(rig, Path()) as opened:
        camera = SleepingCamera(opened.camera)
        capture_with(
            replace(opened, camera=camera), rig, plan, steps, SessionRequest(Path(folder) / "first", "benchmark")
        )
        camera.replaying = True
        wheel = SleepingWheel(opened.wheel)
        timed = replace(opened, camera=camera, wheel=wheel, clock=SystemClock())
        start_s = time.perf_counter()
        session = capture_with(timed, rig, plan, steps, SessionRequest(Path(folder) / "second", "benchmark"))
        wall_s = time.perf_counter() - start_s
    needed_s = camera.slept_s + wheel.slept_s
    found = {
        "wall_s": wall_s,
        "exposures_s": camera.slept_s,
        "moves_s": wheel.slept_s,
        "ratio": wall_s / needed_s,
        "bar": BAR,
        "frames": len(session.frames),
        "megabytes": 1e-6 * len(session.frames) * np.prod(camera.camera.expose(1e-3, 1.0).counts.shape) * 2,
    }
    print(
        f"{found['frames']} frames, {found['megabytes']:.0f} MB: {wall_s:.1f} s for {camera.slept_s:.1f} s of "
        f"exposures and {wheel.slept_s:.1f} s of wheel moves: x{found['ratio']:.3f} (at most {BAR})"
    )
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(found, indent=1))
    return 0 if found["ratio"] <= BAR else 1


if __name__ == "__main__":
    sys.exit(main())
