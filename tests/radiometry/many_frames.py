"""A session of many frames on the disk, and its reduction in a process of its own whose memory is measured."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from data_schemas import CaptureSession, Frame, FrameType, provenance
from data_schemas.storage import write_frame, write_record
from rigs import paint_plan, simulated_rig
from rigs.capture import SESSION_NAME
from tests.radiometry.sessions import frame, record

ROOT = Path(__file__).resolve().parents[2]
FILTERS = ("450", "560", "600", "660")
EXPOSURE_S = 0.01
DISTINCT = 4
# getrusage would count the parent that it was forked from
REDUCE = """
import json, sys, time
from pathlib import Path
from finray_calib.radiometry._band_signals import band_signals
from rigs.capture._session_folder import read_frame_of, read_session
folder = Path(sys.argv[1])
session = read_session(folder)
start = time.perf_counter()
bands = band_signals(session, lambda frame: read_frame_of(folder, frame))
peak_kb = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps({
    "frames": len(session.frames), "seconds": time.perf_counter() - start, "pixels": bands.region_pixels,
    "peak_mb": peak_kb / 1024,
}))
"""


def write_session(folder: Path, frames: int, width_px: int, height_px: int) -> CaptureSession:
    """Write a session of `frames` frames; the region is the whole frame, which is the most that can be asked.

    Frames repeat after four of a kind (hard links): what is read and checked is as much as if all differed.
    """
    rng = np.random.default_rng(1)
    rig = simulated_rig("red", width_px=width_px, height_px=height_px)
    region = {"row_px": 0, "column_px": 0, "height_px": height_px, "width_px": width_px}
    plan = paint_plan("red", rig.camera).model_copy(update={"filters": FILTERS})
    plan = type(plan).model_validate(plan.model_dump() | {"region": region})
    steps: list[tuple[FrameType, str | None, float]] = [("dark", None, 16.0), ("laser white", "450", 500.0)]
    for kind, level in (("white", 600.0), ("reflectance", 300.0), ("fluorescence", 200.0)):
        steps += [(kind, name, level) for name in FILTERS]  # type: ignore[list-item]
    stored: dict[tuple[int, int], tuple[str, str]] = {}
    listed: list[Frame] = []
    for n in range(frames):
        which, copy = n % len(steps), n // len(steps) % DISTINCT
        kind, name, level_dn = steps[which]
        file = f"frames/{n:04d}.tiff"
        if (which, copy) in stored:
            source, digest = stored[which, copy]
            os.link(folder / source, folder / file)
        else:
            noisy = level_dn + 5.0 * rng.standard_normal((height_px, width_px), dtype=np.float32)
            digest = write_frame(folder / file, np.rint(noisy).clip(0, 1023).astype(np.uint16), "test")
            stored[which, copy] = (file, digest)
        listed.append(frame(n, file, kind, name, EXPOSURE_S).model_copy(update={"sha256": digest}))
    session = record(tuple(listed)).model_copy(update={"plan": plan, "rig": rig})
    write_record(session, folder / SESSION_NAME, provenance("test"))
    return session


def reduce_apart(folder: Path) -> dict[str, float]:
    """Reduce the session in a new process; return frames, seconds, region pixels and peak resident memory (MB)."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", REDUCE, str(folder)],
        capture_output=True, text=True, check=True, cwd=ROOT, env=environment, timeout=900,
    )  # fmt: skip
    found: dict[str, float] = json.loads(done.stdout)
    return found
