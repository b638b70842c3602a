"""The whole finger in two engines on one mesh: the engine in process against CalculiX, one thread each.

    python benchmarks/mechanics_engines.py --out bench-out/mechanics-engines.json

Needs CalculiX (Debian: calculix-ccx). A neo-Hookean skeleton of the shear modulus of the paper's TPU, so that both
engines have the same law, the coarse mesh, a cylinder of 10 mm radius pushed 3 mm in by three increments without
friction. Bars: force within 3 %, displacement of the pad within 2 % rms of its largest, CPU time of the whole command
``finray simulate press DESIGN`` (start, meshes, press, records, picture) a fifth of CalculiX' own; the press
alone is shown beside it. What is left over: C3D8R has one point and hourglass control where the engine in process has
mean dilatation at eight; CalculiX touches facets at points of its own.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMBA_NUM_THREADS="1", KMP_BLOCKTIME="0")

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from data_schemas import FingerDesign, OgdenSolid
from sim import design_toml, preset_design
from sim.mechanics import PressedFinger, PressSettings, press_finger
from sim.mechanics.other_engines import calculix_version, press_finger_calculix

DEPTH_MM = 3.0
INCREMENTS = 3
FORCE_BAR_REL = 0.03
FIELD_BAR_REL = 0.02
SPEED_BAR = 5.0


def the_finger() -> FingerDesign:
    """The paper's stiff finger with neo-Hookean TPU."""
    design = preset_design("flat-70x35")
    tpu = OgdenSolid(mu_mpa=(sum(design.mechanics.skeleton.mu_mpa),), alpha=(2.0,))
    return design.model_copy(
        update={
            "mechanics": design.mechanics.model_copy(update={"skeleton": tpu}),
            "indenter": design.indenter.model_copy(update={"depth_mm": DEPTH_MM}),
        }
    )


def cpu_s() -> float:
    """CPU time of this process and of those that it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def command_cpu_s(design: FingerDesign) -> float:
    """CPU time of the whole command, one thread, with compiled code in its cache."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "finger.toml").write_text(design_toml(design))
        command = [sys.executable, "-m", "finray_calib.cli.main", "simulate", "press", str(folder / "finger.toml")]
        start = cpu_s()
        subprocess.run(
            [*command, "--increments", str(INCREMENTS), "--out", str(folder / "press.json")],
            check=True,
            capture_output=True,
        )
        return cpu_s() - start


def _press_in_process(design: FingerDesign) -> PressedFinger:
    return press_finger(design, PressSettings("coarse", INCREMENTS))


def _press_by_calculix(design: FingerDesign) -> PressedFinger:
    return press_finger_calculix(design, "coarse", INCREMENTS)


def pad_difference(ours: PressedFinger, theirs: PressedFinger) -> float:
    """Rms of the difference of the gel's displacement at the last increment, as a share of the largest."""
    nodes = np.unique(ours.mesh.hexahedra["gel"])
    u, v = ours.displacement_mm[-1][nodes], theirs.displacement_mm[-1][nodes]
    return float(np.sqrt(((u - v) ** 2).sum(axis=1).mean()) / np.linalg.norm(u, axis=1).max())


def main() -> int:
    """Measure, print, store; return 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    design = the_finger()
    command_cpu_s(design)  # compiles
    command_s = command_cpu_s(design)
    pressed, seconds, wall = [], [], []
    for press in (_press_in_process, _press_by_calculix):
        start, clock = cpu_s(), time.perf_counter()
        pressed.append(press(design))
        seconds.append(cpu_s() - start)
        wall.append(time.perf_counter() - clock)
    ours, theirs = pressed
    found = {
        "depth_mm": ours.depth_mm.tolist(),
        "force_n": ours.force_n[:, 1].tolist(),
        "force_calculix_n": theirs.force_n[:, 1].tolist(),
        "force_difference_rel": float(abs(theirs.force_n[-1, 1] / ours.force_n[-1, 1] - 1.0)),
        "pad_difference_rel": pad_difference(ours, theirs),
        "cpu_s": seconds,
        "wall_s": wall,
        "iterations": [int(p.iterations.sum()) for p in pressed],
        "command_cpu_s": command_s,
        "press_speed_ratio": seconds[1] / seconds[0],
        "speed_ratio": seconds[1] / command_s,
        "reached": bool(not ours.unreached and not theirs.unreached),
        "calculix": calculix_version(),
    }
    print(f"{'push mm':>8} {'in process N':>13} {'CalculiX N':>11}")
    for depth, a, b in zip(found["depth_mm"], found["force_n"], found["force_calculix_n"], strict=True):
        print(f"{depth:8.2f} {a:13.4f} {b:11.4f}")
    names = ("in process", f"CalculiX {found['calculix']}")
    for name, cpu, clock, count in zip(names, seconds, wall, found["iterations"], strict=True):
        print(f"{name}: {count} iterations, {cpu:.1f} s of CPU, {clock:.1f} s on the clock")
    print(f"the whole command: {command_s:.1f} s of CPU; the press alone {found['press_speed_ratio']:.2f} times faster")
    rows = (
        ("force", found["force_difference_rel"], FORCE_BAR_REL, found["force_difference_rel"] <= FORCE_BAR_REL),
        ("pad, rms", found["pad_difference_rel"], FIELD_BAR_REL, found["pad_difference_rel"] <= FIELD_BAR_REL),
        ("command, times faster", found["speed_ratio"], SPEED_BAR, found["speed_ratio"] >= SPEED_BAR),
        ("push reached", float(found["reached"]), 1.0, found["reached"]),
    )
    for what, value, bar, met in rows:
        print(f"{what:22} {value:8.4f}   bar {bar:g}   {'met' if met else 'MISSED'}")
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(found, indent=1))
    return 0 if all(met for *_, met in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
