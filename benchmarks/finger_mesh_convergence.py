"""Force of a pressed finger against the fineness of its mesh, pad and skeleton refined separately; the fine preset.

    python benchmarks/finger_mesh_convergence.py --out bench-out/finger-mesh-convergence.json

One increment of 2 mm on each mesh, started from the mesh before it, by the penalty path. The fine preset (some 600,000
unknowns) takes some GB and minutes on two cores. Bars: medium within 2 % of fine in force; fine below 8 GB, its
increment below 4 minutes. Exit status 1 when one is missed.

What the presets leave: the finger's stiffness under its pad at a small force, with all edges of the coarse skeleton
halved twice, is extrapolated to an infinitely fine skeleton. Stress is infinite at the sharp inner corners, where the
error falls as the 1.09th power of the edges.
"""

import argparse
import json
import os
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_schemas import FingerDesign, Indenter
from sim.mechanics import STEPS, LoadedFinger, finger_materials, finger_mesh
from sim.mechanics._assembly import Assembly, Elasticity
from sim.mechanics._finger_mesh import finger_ties
from sim.mechanics._increments import CoarserPath, Load, load_increments
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._press import press_contact

FORCE_BAR_REL, MEMORY_BAR_GB, TIME_BAR_S = 0.02, 8.0, 240.0
MEDIUM = STEPS["medium"]
SMALL_FORCE_N = 0.02
MESHES = {
    "coarse": STEPS["coarse"],
    "skeleton coarser": replace(MEDIUM, skeleton_mm=2.5, across_mm=5.0, corners=STEPS["coarse"].corners),
    "pad coarser": replace(MEDIUM, pad_mm=2.0, pad_layer_mm=2.0),
    "medium": MEDIUM,
    "pad finer": replace(MEDIUM, pad_mm=0.67, pad_layer_mm=0.67),
    "fine": STEPS["fine"],
}


def pressed(design, steps, before, threads):
    """Return mesh and displacements of one increment to the design's depth, and what it took."""
    began, used = time.perf_counter(), time.process_time()
    mesh = finger_mesh(design, steps=steps)
    touch = press_contact(design, mesh, steps.pad_mm, "penalty")
    parts = [*touch.terms, *finger_ties(design, mesh, steps.skeleton_mm)]
    assembly = Assembly(Elasticity(mesh, finger_materials(design), threads), parts)
    predict = None if before is None else CoarserPath(before[0], mesh, np.ones(1), before[1][None])
    depth = design.indenter.depth_mm
    solver = linear_solver(threads=threads)
    increments = load_increments(
        assembly, solver, Load(lambda share: touch.push(share * depth)), (1.0,), predict=predict
    )
    last = list(increments)[-1].equilibrium
    found = {
        "unknowns": 3 * len(mesh.nodes_mm),
        "force_n": float(touch.force_n(last.state.u_mm)[1]),
        "iterations": last.iterations,
        "wall_s": time.perf_counter() - began,
        "cpu_s": time.process_time() - used,
        "largest_memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2,
    }
    return (mesh, last.state.u_mm), found


def stiffnesses(design, threads):
    """Return the finger's stiffness under its pad, N/mm, of all presets and of coarse with its edges halved."""
    coarse, found = STEPS["coarse"], {}
    halved = {f"halved {n}": replace(coarse, corners=replace(coarse.corners, halvings=n)) for n in (1, 2)}
    for name, steps in (STEPS | halved).items():
        # the pad only passes the force on
        steps = replace(steps, pad_mm=coarse.pad_mm, pad_layer_mm=coarse.pad_layer_mm)
        finger = LoadedFinger(design, threads=threads, steps=steps)
        found[name] = finger.push("pad", (0.0, -SMALL_FORCE_N, 0.0)).stiffness_n_per_mm
    return found


def extrapolated(whole, half, quarter):
    """Return the limit of three values of a mesh whose edges are halved twice, and the power of the error's fall."""
    ratio = (whole - half) / (half - quarter)
    return quarter - (half - quarter) / (ratio - 1.0), np.log2(ratio)


def main() -> int:
    """Print force and cost of each mesh, the differences and whether the bars are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--depth", type=float, default=2.0, metavar="MM")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    threads = len(os.sched_getaffinity(0))
    design = FingerDesign(indenter=Indenter(depth_mm=arguments.depth))
    before, meshes = None, {}
    for name, steps in MESHES.items():
        before, found = pressed(design, steps, before, threads)
        meshes[name] = found
        print(
            f"{name:16} pad {steps.pad_mm:g} mm, skeleton {steps.skeleton_mm:g} mm, {steps.across_mm:g} mm across, "
            f"{steps.corners.thickness_share:g} of a thickness at corners: "
            f"{found['unknowns']} unknowns, {found['force_n']:.4f} N, {found['iterations']} iterations, "
            f"{found['wall_s']:.0f} s ({found['cpu_s']:.0f} CPU s), at most {found['largest_memory_gb']:.1f} GB",
            flush=True,
        )
    medium = meshes["medium"]["force_n"]
    for name in MESHES:
        print(f"{name:16} {100 * (meshes[name]['force_n'] / medium - 1.0):+6.2f} % of medium")
    stiffness = stiffnesses(design, threads)
    limit, power = extrapolated(*(stiffness[name] for name in ("coarse", "halved 1", "halved 2")))
    print(f"under the pad, of an infinitely fine skeleton: {limit:.4f} N/mm (error falls as power {power:.2f})")
    for name, value in stiffness.items():
        print(f"{name:16} {value:.4f} N/mm, {100 * (value / limit - 1.0):+6.2f} %")
    fine = meshes["fine"]
    judged = (
        ("medium against fine, force", abs(medium / fine["force_n"] - 1.0), FORCE_BAR_REL),
        ("largest memory, GB", fine["largest_memory_gb"], MEMORY_BAR_GB),
        ("fine increment, s", fine["wall_s"], TIME_BAR_S),
    )
    for what, value, bar in judged:
        print(f"{what:28} {value:8.4g}   bar {bar:g}   {'met' if value <= bar else 'MISSED'}")
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        found = {
            "depth_mm": arguments.depth,
            "meshes": meshes,
            "stiffness_n_per_mm": stiffness,
            "limit_n_per_mm": limit,
        }
        arguments.out.write_text(json.dumps(found, indent=1))
    return int(any(value > bar for _, value, bar in judged))


if __name__ == "__main__":
    sys.exit(main())
