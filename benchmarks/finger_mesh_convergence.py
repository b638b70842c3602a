"""Force of a pressed finger against the fineness of its mesh, pad and skeleton refined separately; the fine preset.

    python benchmarks/finger_mesh_convergence.py --out bench-out/finger-mesh-convergence.json

One increment of 2 mm on each mesh, started from the mesh before it, by the penalty path. The fine preset (some 600,000
unknowns) takes some GB and minutes on two cores. Bars: medium within 2 % of fine in force; fine below 8 GB, its
increment below 4 minutes. Exit status 1 when one is missed.

The force of an infinitely fine mesh is extrapolated: layers through fins and ribs, doubled twice, give the power by
which the error falls (near 1 beside sharp inner corners); it is used for the lengths of elements and the pad too.
"""

import argparse
import json
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.indenter import Indenter
from sim.mechanics.assembly import Assembly
from sim.mechanics.elements import Elasticity
from sim.mechanics.finger_mesh import STEPS, MeshSteps, finger_mesh
from sim.mechanics.finger_parts import finger_materials, finger_ties
from sim.mechanics.increments import load_increments
from sim.mechanics.linear_solver import linear_solver
from sim.mechanics.press_contact import press_contact
from sim.mechanics.warm_start import CoarserPath

FORCE_BAR_REL, MEMORY_BAR_GB, TIME_BAR_S = 0.02, 8.0, 240.0
MEDIUM = STEPS["medium"]
MESHES = {
    "coarse": STEPS["coarse"],
    "pad coarser": MeshSteps(2.0, 2.0, MEDIUM.skeleton_mm, MEDIUM.layers),
    "skeleton coarser": MeshSteps(MEDIUM.pad_mm, MEDIUM.pad_layer_mm, 2.5, 1),
    "one layer": MeshSteps(MEDIUM.pad_mm, MEDIUM.pad_layer_mm, MEDIUM.skeleton_mm, 1),
    "medium": MEDIUM,
    "pad finer": MeshSteps(0.67, 0.67, MEDIUM.skeleton_mm, MEDIUM.layers),
    "four layers": MeshSteps(MEDIUM.pad_mm, MEDIUM.pad_layer_mm, MEDIUM.skeleton_mm, 4),
    "four, shorter": MeshSteps(MEDIUM.pad_mm, MEDIUM.pad_layer_mm, 1.0, 4),
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
    increments = load_increments(assembly, solver, lambda share: touch.push(share * depth), (1.0,), predict=predict)
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


def extrapolated_n(force_n):
    """Return the force of an infinitely fine mesh, N, as far as these meshes tell."""
    one, two, four = (force_n[name] for name in ("one layer", "medium", "four layers"))
    power = np.log2((one - two) / (two - four))

    def whole_step(coarser_n, finer_n, refinement):
        """Return the change from a mesh to an infinitely fine one, from that to a finer one."""
        return (finer_n - coarser_n) / (1.0 - refinement**-power)

    layers = whole_step(two, four, 2.0)
    lengths = whole_step(four, force_n["four, shorter"], MEDIUM.skeleton_mm / MESHES["four, shorter"].skeleton_mm)
    pad = whole_step(two, force_n["pad finer"], MEDIUM.pad_mm / MESHES["pad finer"].pad_mm)
    return two + layers + lengths + pad


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
            f"{name:16} pad {steps.pad_mm:g} mm, skeleton {steps.skeleton_mm:g} mm / {steps.layers} layers: "
            f"{found['unknowns']} unknowns, {found['force_n']:.4f} N, {found['iterations']} iterations, "
            f"{found['wall_s']:.0f} s ({found['cpu_s']:.0f} CPU s), at most {found['largest_memory_gb']:.1f} GB",
            flush=True,
        )
    medium = meshes["medium"]["force_n"]
    for name in MESHES:
        print(f"{name:16} {100 * (meshes[name]['force_n'] / medium - 1.0):+6.2f} % of medium")
    limit = extrapolated_n({name: found["force_n"] for name, found in meshes.items()})
    for name in STEPS:
        print(f"{name:16} {100 * (meshes[name]['force_n'] / limit - 1.0):+6.2f} % of the extrapolated {limit:.3f} N")
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
        found = {"depth_mm": arguments.depth, "meshes": meshes, "extrapolated_n": limit}
        arguments.out.write_text(json.dumps(found, indent=1))
    return int(any(value > bar for _, value, bar in judged))


if __name__ == "__main__":
    sys.exit(main())
