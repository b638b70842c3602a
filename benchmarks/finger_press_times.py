"""Presses of the 70 x 35 finger by the command, each in a process of its own: what it takes, and whether it gets there.

    python benchmarks/finger_press_times.py --out bench-out/finger-press-times.json [--only WORDS]

Bars: coarse mesh to 2 mm in 25 s; medium mesh to 5 mm in 150 s and 1.5 GB; to 10 mm, through the buckling of ribs: on
the coarse mesh cylinder and cuboid, with and without friction, on the medium one a cylinder without friction. The
medium one with friction, some twenty minutes, is shown. Times are by the clock: take them on a machine that does
nothing else. Each press is stored as it ends, beside those that OUT has already, so that a stopped run loses one press
and ``--only`` adds to the others. Exit status 1 when a bar is missed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from data_schemas import Indenter, Preset, PressMechanics
from data_schemas._design_parts import MeshPreset
from data_schemas.storage import read_record
from sim import design_toml, preset_design

CYLINDER: dict[str, Any] = {"shape": "cylinder"}
CUBOID: dict[str, Any] = {"shape": "cuboid", "size_mm": (50.0, 15.0, 15.0)}


@dataclass(frozen=True)
class Press:
    """One press and its bars."""

    preset: Preset
    indenter: dict[str, Any]
    depth_mm: float
    increments: int
    friction: float = 0.0
    options: tuple[str, ...] = ()
    wall_bar_s: float | None = None
    memory_bar_gb: float | None = None
    must_reach: bool = True


BARRIER = ("--contact", "barrier")
PRESSES = {
    "coarse, 2 mm": Press("coarse", CYLINDER, 2.0, 4, wall_bar_s=25.0),
    "medium, 5 mm": Press("medium", CYLINDER, 5.0, 5, wall_bar_s=150.0, memory_bar_gb=1.5),
    "coarse, 10 mm, cylinder": Press("coarse", CYLINDER, 10.0, 5, options=BARRIER),
    "coarse, 10 mm, cylinder, friction 0.3": Press("coarse", CYLINDER, 10.0, 5, 0.3, BARRIER),
    "coarse, 10 mm, cuboid": Press("coarse", CUBOID, 10.0, 5, options=BARRIER),
    "coarse, 10 mm, cuboid, friction 0.3": Press("coarse", CUBOID, 10.0, 5, 0.3, BARRIER),
    "medium, 10 mm, cylinder": Press("medium", CYLINDER, 10.0, 10),
    "medium, 10 mm, cylinder, friction 0.3": Press("medium", CYLINDER, 10.0, 10, 0.3, BARRIER, must_reach=False),
}


def measure(press: Press, folder: Path) -> dict[str, Any]:
    """Press by the command and return force, time and memory."""
    indenter = Indenter(**press.indenter, depth_mm=press.depth_mm, friction=press.friction)
    changed = {"indenter": indenter, "mesh": MeshPreset(preset=press.preset)}
    (folder / "finger.toml").write_text(design_toml(preset_design("flat-70x35").model_copy(update=changed)))
    asked = ["simulate", "press", "finger.toml", "--increments", str(press.increments), *press.options]
    began = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-m", "finray_calib.cli.main", *asked, "--out", "finger.press.json"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
    )
    # wait4, not wait: it tells this child's memory
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    found: dict[str, Any] = {
        "reached": child.returncode == 0,
        "wall_s": time.perf_counter() - began,
        "cpu_s": used.ru_utime + used.ru_stime,
        "largest_memory_gb": used.ru_maxrss / 1024**2,
    }
    if (folder / "finger.mechanics.json").exists():
        record = read_record(folder / "finger.mechanics.json", PressMechanics)
        found |= {
            "depth_mm": float(record.depth_mm[-1]),
            "force_n": float(record.force_n[-1, 1]),
            "iterations": int(record.iterations.sum()),
            "increments": len(record.depth_mm),
        }
    return found


def missed(press: Press, found: dict[str, Any]) -> list[str]:
    """Return the bars that are missed."""
    over = []
    if press.must_reach and not found["reached"]:
        over.append("the push is not reached")
    if press.wall_bar_s is not None and found["wall_s"] > press.wall_bar_s:
        over.append(f"over {press.wall_bar_s:g} s")
    if press.memory_bar_gb is not None and found["largest_memory_gb"] > press.memory_bar_gb:
        over.append(f"over {press.memory_bar_gb:g} GB")
    return over


def _stored(out: Path | None) -> dict[str, Any]:
    """Return the presses that a file holds, of a run that was stopped or of others by ``--only``."""
    return dict(json.loads(out.read_text())["presses"]) if out and out.exists() else {}


def main() -> int:
    """Measure, print, store; return 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--only", default="", metavar="WORDS", help="presses whose name holds these words")
    arguments = parser.parse_args()
    presses = _stored(arguments.out)
    faults = []
    for name, press in PRESSES.items():
        if arguments.only not in name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            found = measure(press, Path(folder))
        presses[name], over = found, missed(press, found)
        faults += over
        print(
            f"{name:38} {found.get('depth_mm', 0.0):6.2f} mm {found.get('force_n', 0.0):7.3f} N "
            f"{found.get('iterations', 0):4d} iterations in {found.get('increments', 0):3d} increments "
            f"{found['wall_s']:6.0f} s ({found['cpu_s']:.0f} CPU s) {found['largest_memory_gb']:.2f} GB   "
            f"{'MISSED: ' + ', '.join(over) if over else 'met'}",
            flush=True,
        )
        if arguments.out:
            arguments.out.parent.mkdir(parents=True, exist_ok=True)
            arguments.out.write_text(json.dumps({"presses": presses}, indent=1))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
