"""Press until a force is reached, and the torque that the pressed contact can then hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.mechanics.assembly import Assembly
from sim.mechanics.contact_analytic import PenaltyContact
from sim.mechanics.elements import Elasticity
from sim.mechanics.finger_mesh import STEPS, Preset, finger_mesh
from sim.mechanics.indenters import rigid_indenter
from sim.mechanics.linear_solver import linear_solver
from sim.mechanics.loads import DeadForce
from sim.mechanics.newton import Extrapolation, Supports, find_equilibrium, load_increments
from sim.mechanics.press import PressedFinger, finger_materials, finger_ties

FloatArray = NDArray[np.float64]

_CONTACT_MODULI_PER_STEP = 100.0  # as in a press to a depth
_TOUCH_MM = 0.1  # pushed in by displacement first: without contact nothing would hold an indenter under a force


def press_to_force(
    design: FingerDesign,
    force_n: float,
    preset: Preset | None = None,
    increments: int = 4,
    threads: int = 1,
    folder: Path = Path(),
) -> PressedFinger:
    """Press the design's indenter in along the pad's normal until it pushes with a force; without friction.

    The indenter is a node that a dead force drives; it is free along the normal only. Where the force falls with the
    push (buckling), the push jumps on to where the force is reached again.

    Parameters
    ----------
    design
        Finger, materials and indenter; ``indenter.depth_mm`` plays no part.
    force_n
        Along the pad's normal, towards the finger.
    preset, threads
        See :func:`sim.mechanics.press.press_finger`.
    increments
        Equal parts of the force.
    folder
        Where the design stands.

    Returns
    -------
    PressedFinger
        Its mesh has one node more than the finger's, the last: the indenter.

    Raises
    ------
    SimulateError
        When the force is not positive, the indenter has no exact distances (a mesh of the user) or friction, or no
        equilibrium is found.
    """
    if not 0.0 < force_n < np.inf:
        raise SimulateError(f"force_n = {force_n:g} N: a press needs a finite force above 0 N")
    indenter = rigid_indenter(design, folder)
    if indenter.body is None or design.indenter.friction > 0.0:
        raise SimulateError(
            "a press to a force is without friction and on exact distances: give indenter.friction = 0 and a cylinder, "
            "ball or cuboid, or press to a depth"
        )
    steps = STEPS[preset or design.mesh.preset]
    finger = finger_mesh(design, preset)
    node = len(finger.nodes_mm)
    mesh = replace(finger, nodes_mm=np.concatenate([finger.nodes_mm, [indenter.touching.position_mm]]))
    stiffness = _CONTACT_MODULI_PER_STEP * 2.0 * design.mechanics.gel.c10_mpa / steps.pad_mm
    contact = PenaltyContact(
        mesh.nodes_mm, mesh.surfaces["coat"], indenter.body, indenter.pose(_TOUCH_MM),
        stiffness, reference_node=node, curvature=False,
    )  # fmt: skip
    force = DeadForce(np.array([node]))
    assembly = Assembly(
        Elasticity(mesh, finger_materials(design), threads),
        [contact, force, *finger_ties(design, mesh, steps.skeleton_mm)],
    )
    solver = linear_solver(threads=threads)
    held = Supports.at_rest(node + 1, np.append(mesh.node_sets["fixed"], node))
    free = held.fixed.copy()
    free[node, 1] = False
    touched = find_equilibrium(assembly, assembly.at_rest(), held, solver)
    if touched.failure:
        raise SimulateError(f"no equilibrium at a push of {_TOUCH_MM:g} mm: {touched.failure}; try a finer mesh")
    first_n = float(contact.force_n(touched.state.u_mm)[1])

    def loading(fraction: float) -> Supports:
        force.force_n[1] = -fraction * force_n
        return Supports(free, np.zeros_like(mesh.nodes_mm))

    predict = Extrapolation()
    predict(assembly.at_rest(), 0.0, 0.0)
    stops = [(k + 1) / increments for k in range(increments)]
    reached = list(load_increments(assembly, solver, loading, stops, touched.state, first_n / force_n, predict=predict))
    states = [step.equilibrium.state for step in reached]
    moved = np.array([-state.u_mm[node, 1] for state in states])
    # the energy of the force itself is no energy of the finger
    energies = np.array(
        [step.equilibrium.energy_n_mm + step.fraction * force_n * m for step, m in zip(reached, moved, strict=True)]
    )
    last = states[-1].u_mm
    return PressedFinger(
        mesh=mesh,
        depth_mm=_TOUCH_MM + moved,
        force_n=np.array([contact.force_n(state.u_mm) for state in states]),
        energy_n_mm=energies,
        displacement_mm=np.array([state.u_mm for state in states]),
        iterations=np.array([step.equilibrium.iterations for step in reached]),
        pressure_mpa=contact.pressures_mpa(last),
        touch_mm=contact.points_mm(np.zeros_like(last)),
        unreached="",
        contact=f"contact by penalty, the indenter driven by {force_n:g} N",
        modes_mm=states[-1].modes,
    )


def contact_forces_n(pressed: PressedFinger) -> tuple[FloatArray, FloatArray]:
    """Return where a pressed contact pushes, places on the coat at rest (k, 3), and how hard, (k,) in N.

    The pressures times their areas, made to add up to the size of the force on the indenter; places at rest: the
    patch's own stretch, a few per cent, is left out.
    """
    corners = pressed.mesh.nodes_mm[pressed.mesh.surfaces["coat"]]
    area = np.linalg.norm(np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1) / 2.0
    pushes = pressed.pressure_mpa * area[:, None]
    touching = pushes > 0.0
    whole = float(pushes.sum())
    if whole <= 0.0:
        raise SimulateError("nothing touches: a contact without pressure holds no torque; press deeper")
    return pressed.touch_mm[touching], pushes[touching] * float(np.linalg.norm(pressed.force_n[-1])) / whole


def slip_torque_n_mm(places_mm: FloatArray, forces_n: FloatArray, friction: float) -> float:
    r"""Return the torque about the pad's normal at which a pressed object begins to turn on the pad.

    T = mu min_c sum_i N_i |r_i - c|, in the plane across the normal (x, z).

    Coulomb's law with the frictionless normal forces N_i, taken to stay as they are while the object slides, on all
    of the patch at once, as a rigid body about the centre c that holds least (limit analysis: with c the friction
    forces add up to nothing, a pure torque). The pad's own shear before that, and the change of the pressures by
    friction, are left out.

    Parameters
    ----------
    places_mm, forces_n
        Of the normal forces, (k, 3) and (k,): see :func:`contact_forces_n`.
    friction
        Coulomb's coefficient mu between object and coat.

    Raises
    ------
    SimulateError
        When the coefficient is negative.
    """
    if not 0.0 <= friction < np.inf:
        raise SimulateError(f"friction = {friction:g}: Coulomb's coefficient must be finite and not negative")
    flat = places_mm[:, [0, 2]]

    def torque(centre: FloatArray) -> float:
        return float(forces_n @ np.linalg.norm(flat - centre, axis=1))

    start = forces_n @ flat / forces_n.sum()
    return friction * float(minimize(torque, start, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}).fun)


def frictionless_torque_n_mm(places_mm: FloatArray, forces_n: FloatArray, width_mm: float) -> float:
    """Return the torque about the finger's long axis that normal forces alone can hold: T = N (w / 2 - |x|).

    x is where their resultant N acts across the finger. An object that turns about that axis shifts the resultant
    towards the pad's edge and tips over it there; the finger's own twist (see
    :meth:`sim.mechanics.loads.LoadedFinger.twist`) is left out.

    Parameters
    ----------
    places_mm, forces_n
        Of the normal forces, (k, 3) and (k,).
    width_mm
        Of the pad.
    """
    whole = float(forces_n.sum())
    return whole * (width_mm / 2.0 - abs(float(forces_n @ places_mm[:, 0]) / whole))
