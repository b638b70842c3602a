"""Press an indenter into a finger: increments of the push, forces, displacements and the contact patch."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.mechanical_design import ElasticSolid, NeoHookeSolid, OgdenSolid
from sim.mechanics.assembly import Assembly
from sim.mechanics.contact_analytic import PenaltyContact
from sim.mechanics.elements import Elasticity
from sim.mechanics.finger_mesh import STEPS, Preset, finger_mesh
from sim.mechanics.linear_solver import linear_solver
from sim.mechanics.materials import LinearElastic, Ogden, check_stability, neo_hooke
from sim.mechanics.mesh import FingerMesh
from sim.mechanics.newton import Increment, Supports, load_increments
from sim.mechanics.signed_distances import Body, Cylinder, Pose, Sphere
from sim.mechanics.ties import TiedNodes
from sim.surface_meshes.pressed_pad import rest_height_mm

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

# contact sinks in by pressure / stiffness: at a tenth of the gel's modulus by a thousandth of an element
_CONTACT_MODULI_PER_STEP = 100.0
# a patch that reaches over this share of the pad is a strip across it
_WHOLE_WIDTH = 0.95
# per node, against the fin's E times element size: the tie opens by a hundredth of the fin's own strain
_TIE_MODULI_TIMES_STEP = 100.0


@dataclass(frozen=True, slots=True)
class PressedFinger:
    """Equilibria of a finger under a rigid indenter; k increments, the last one is the whole push.

    Attributes
    ----------
    mesh
        The mesh.
    depth_mm
        Push of the indenter from first touch, (k,).
    force_n
        Force on the indenter, (k, 3).
    energy_n_mm
        Strain energy with that of contact and ties, (k,).
    displacement_mm
        Of the nodes, (k, n, 3).
    iterations
        Newton iterations of each increment, (k,).
    pressure_mpa, touch_mm
        Of the last increment: contact pressure at the q sampling points of the coat's f faces (f, q), and where these
        lie in the undeformed pad (f, q, 3).
    unreached
        Why the push ended early; empty when it did not.
    """

    mesh: FingerMesh
    depth_mm: FloatArray
    force_n: FloatArray
    energy_n_mm: FloatArray
    displacement_mm: FloatArray
    iterations: NDArray[np.int64]
    pressure_mpa: FloatArray
    touch_mm: FloatArray
    unreached: str


def press_finger(
    design: FingerDesign,
    preset: Preset | None = None,
    increments: int = 4,
    threads: int = 1,
    progress: Progress | None = None,
) -> PressedFinger:
    """Press the design's indenter in by its depth, without friction, from first touch on the middle line.

    Contact by penalty on exact signed distances. A push of 5 mm and more buckles ribs, which takes more increments;
    ribs may then pass through each other, which is not checked here.

    Parameters
    ----------
    design
        Finger, materials and indenter; ``indenter.depth_mm`` is the whole push.
    preset
        Fineness of the mesh; the design's own by default.
    increments
        Equal steps of the push that are wanted; smaller ones are put between where needed.
    threads
        Of elements and factorisation.
    progress
        Called after each increment.

    Raises
    ------
    SimulateError
        When there is no push, or not even the first increment finds an equilibrium.
    """
    if design.indenter.depth_mm <= 0.0:
        raise SimulateError(f"indenter.depth_mm = {design.indenter.depth_mm:g} mm: a press needs a depth above 0 mm")
    mesh = finger_mesh(design, preset)
    contact = _contact(design, mesh, STEPS[preset or design.mesh.preset].pad_mm)
    elasticity = Elasticity(mesh, finger_materials(design), threads)
    assembly = Assembly(elasticity, [contact, *_ties(design, mesh, STEPS[preset or design.mesh.preset].skeleton_mm)])
    supports = Supports.at_rest(len(mesh.nodes_mm), mesh.node_sets["fixed"])

    def loading(fraction: float) -> Supports:
        contact.place(_pose(design, fraction * design.indenter.depth_mm))
        return supports

    stops = [(k + 1) / increments for k in range(increments)]
    reached: list[Increment] = []
    forces: list[FloatArray] = []
    unreached = ""
    try:
        for step in load_increments(assembly, linear_solver(threads=threads), loading, stops):
            reached.append(step)
            forces.append(contact.force_n(step.equilibrium.state.u_mm))
            if progress is not None:
                depth = step.fraction * design.indenter.depth_mm
                progress(sum(step.fraction >= s for s in stops), increments, f"pressed to {depth:.2f} mm")
    except SimulateError as stuck:
        if not reached:
            raise
        unreached = str(stuck)
        contact.place(_pose(design, reached[-1].fraction * design.indenter.depth_mm))
    return _result(design, mesh, contact, reached, np.array(forces), unreached)


def finger_materials(design: FingerDesign) -> dict[str, Ogden | LinearElastic]:
    """Return the engine's materials by the names that the mesh's blocks give.

    Raises
    ------
    SimulateError
        When a rubber's constants make it unstable.
    """
    found: dict[str, Ogden | LinearElastic] = {}
    for name in type(design.mechanics).model_fields:
        solid = getattr(design.mechanics, name)
        if isinstance(solid, OgdenSolid):
            rubber = Ogden(solid.mu_mpa, solid.alpha, solid.bulk_over_shear)
            check_stability(rubber)
            found[name] = rubber
        elif isinstance(solid, NeoHookeSolid):
            found[name] = neo_hooke(solid.c10_mpa, solid.bulk_over_shear)
        elif isinstance(solid, ElasticSolid):
            found[name] = LinearElastic(solid.youngs_modulus_mpa, solid.poisson_ratio)
    return found


def contact_distance(pressed: PressedFinger, nodes: NDArray[np.int64]) -> FloatArray:
    """Return the distance of coat nodes from the middle of the contact in units of its half-width; <= 1 in contact.

    The patch is taken as an ellipse in the undeformed pad, or as a strip where it reaches across the pad. It ends half
    the distance between sampling points beyond the outermost one that touches, and is known to about that. NaN without
    contact.
    """
    touching = pressed.touch_mm[pressed.pressure_mpa > 0.0]
    # two Gauss points lie 1/sqrt(3) of a face apart, on average half a face
    margin = np.median(np.ptp(pressed.touch_mm, axis=1), axis=0) * np.sqrt(3.0) / 4.0
    if not len(touching):
        return np.full(len(nodes), np.nan)
    places = pressed.mesh.nodes_mm[nodes]
    squares = np.zeros(len(nodes))
    for axis in (0, 2):
        low, high = touching[:, axis].min() - margin[axis], touching[:, axis].max() + margin[axis]
        pad_low, pad_high = places[:, axis].min(), places[:, axis].max()
        if high - low < _WHOLE_WIDTH * (pad_high - pad_low):
            squares += ((places[:, axis] - (low + high) / 2.0) / ((high - low) / 2.0)) ** 2
    return np.asarray(np.sqrt(squares))


def _contact(design: FingerDesign, mesh: FingerMesh, step_mm: float) -> PenaltyContact:
    """Return the contact of the coat with the indenter at first touch."""
    shear_mpa = 2.0 * design.mechanics.gel.c10_mpa
    radius = design.indenter.radius_mm
    body: Body = Cylinder(radius) if design.indenter.shape == "cylinder" else Sphere(radius)
    stiffness = _CONTACT_MODULI_PER_STEP * shear_mpa / step_mm
    return PenaltyContact(mesh.nodes_mm, mesh.surfaces["coat"], body, _pose(design, 0.0), stiffness, curvature=False)


def _pose(design: FingerDesign, depth_mm: float) -> Pose:
    """Return the indenter's place at a depth below the crown of the undeformed pad."""
    at = design.indenter.position_mm
    crown = float(rest_height_mm(design, 0.0, at))
    return Pose((0.0, crown + design.indenter.radius_mm - depth_mm, at))


def _ties(design: FingerDesign, mesh: FingerMesh, step_mm: float) -> list[TiedNodes]:
    """Return the ties of the mesh."""
    fin = finger_materials(design)["skeleton"]
    stiffness = _TIE_MODULI_TIMES_STEP * fin.youngs_modulus_mpa * step_mm
    return [TiedNodes(mesh.nodes_mm, tie, stiffness) for tie in mesh.ties]


def _result(
    design: FingerDesign,
    mesh: FingerMesh,
    contact: PenaltyContact,
    reached: Sequence[Increment],
    forces: FloatArray,
    unreached: str,
) -> PressedFinger:
    """Collect the increments."""
    last = reached[-1].equilibrium.state.u_mm
    return PressedFinger(
        mesh=mesh,
        depth_mm=np.array([step.fraction for step in reached]) * design.indenter.depth_mm,
        force_n=forces,
        energy_n_mm=np.array([step.equilibrium.energy_n_mm for step in reached]),
        displacement_mm=np.array([step.equilibrium.state.u_mm for step in reached]),
        iterations=np.array([len(step.equilibrium.residuals_n) for step in reached]),
        pressure_mpa=contact.pressures_mpa(last),
        touch_mm=contact.points_mm(np.zeros_like(last)),
        unreached=unreached,
    )
