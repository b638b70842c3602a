"""Force of a finger pressed by 2 mm against the fineness of its mesh, pad and skeleton refined separately.

The finest of both takes some GB and minutes on two cores. Exit status 1 when medium is not within 2 % of the finest.
"""

import argparse
import os
import sys
import time

import numpy as np

from data_schemas.design import FingerDesign, Indenter
from sim.mechanics.assembly import Assembly
from sim.mechanics.elements import Elasticity
from sim.mechanics.finger_mesh import STEPS, MeshSteps, finger_mesh
from sim.mechanics.linear_solver import linear_solver
from sim.mechanics.newton import load_increments
from sim.mechanics.press import finger_materials, finger_ties
from sim.mechanics.press_contact import press_contact
from sim.mechanics.warm_start import CoarserPath

BAR_REL = 0.02
PADS = ((2.0, 2.0), (1.0, 1.0), (0.67, 0.67))
SKELETONS = ((2.5, 1), (1.5, 2), (1.2, 3))


def main() -> int:
    """Print the force for each mesh and the differences."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--depth", type=float, default=2.0, metavar="MM")
    arguments = parser.parse_args()
    threads = len(os.sched_getaffinity(0))
    design = FingerDesign(indenter=Indenter(depth_mm=arguments.depth))
    meshes = [MeshSteps(*pad, *SKELETONS[1]) for pad in PADS]
    meshes += [MeshSteps(*PADS[1], *skeleton) for skeleton in (SKELETONS[0], SKELETONS[2])]
    before = None
    forces = {}
    for steps in (STEPS["coarse"], *meshes):
        began = time.process_time()
        mesh = finger_mesh(design, steps=steps)
        touch = press_contact(design, mesh, steps.pad_mm, "penalty")
        parts = [*touch.terms, *finger_ties(design, mesh, steps.skeleton_mm)]
        assembly = Assembly(Elasticity(mesh, finger_materials(design), threads), parts)
        predict = None if before is None else CoarserPath(before[0], mesh, np.ones(1), before[1][None])
        load = lambda share, touch=touch: touch.push(share * arguments.depth)  # noqa: E731
        last = list(load_increments(assembly, linear_solver(threads=threads), load, (1.0,), predict=predict))[-1]
        before = (mesh, last.equilibrium.state.u_mm)
        forces[steps] = float(touch.force_n(last.equilibrium.state.u_mm)[1])
        sys.stdout.write(
            f"pad {steps.pad_mm:g} mm, skeleton {steps.skeleton_mm:g} mm / {steps.layers} layers: "
            f"{3 * len(mesh.nodes_mm)} unknowns, {forces[steps]:.4f} N, {last.equilibrium.iterations} iterations, "
            f"{time.process_time() - began:.0f} CPU s\n"
        )
        sys.stdout.flush()
    medium = forces[meshes[1]]
    by_pad, by_skeleton = forces[meshes[2]] / medium - 1.0, forces[meshes[4]] / medium - 1.0
    sys.stdout.write(f"medium to fine: pad {100 * by_pad:+.2f} %, skeleton {100 * by_skeleton:+.2f} %\n")
    return int(abs(by_pad + by_skeleton) > BAR_REL)


if __name__ == "__main__":
    sys.exit(main())
