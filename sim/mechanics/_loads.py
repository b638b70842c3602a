"""A finger under loads: pressed until a force is reached, pushed at tip or side, twisted at the tip.

The latter two need no indenter; from them comes its stiffness in bending and twist. And a block of its gel between
plates, as a bench presses it to learn its moduli.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from data_schemas import FingerDesign, NoEquilibriumError, Preset, SimulateError
from sim.mechanics._assembly import Assembly, Elasticity, State, Term
from sim.mechanics._derivatives import StableEquilibrium, residual_and_energy
from sim.mechanics._finger_mesh import STEPS, MeshSteps, finger_materials, finger_mesh, finger_ties
from sim.mechanics._increments import Extrapolation, Increment, Load, Watch, load_increments
from sim.mechanics._indenters import rigid_indenter
from sim.mechanics._linear_solver import SymmetricSolver, linear_solver
from sim.mechanics._materials import Ogden
from sim.mechanics._mesh import Block, FingerMesh, graded, hexahedra_on_grid
from sim.mechanics._newton import Equilibrium, NewtonOptions, Supports, find_equilibrium
from sim.mechanics._penalty_contact import PenaltyContact, PenaltyTouch, coat_points, penalty_mpa_per_mm
from sim.mechanics._press import PressedFinger, PressHistory, PressSettings, check_no_path

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Place = Literal["tip", "side", "pad"]
Plates = Literal["lubricated", "bonded", "confined"]

_SIDE_REACH_MM = 3.0  # a force at the side is spread this far to both sides along the finger
_PAD_REACH_MM = 5.0  # a force under the pad is spread this far to both sides along the finger
_ON_SIDE_MM = 1e-6


class DeadForce:
    """A :class:`~sim.mechanics._assembly.Term`: Pi = -F . mean of u over some nodes; F keeps its direction.

    Parameters
    ----------
    nodes
        Nodes (m,) that share the force evenly.
    force_n
        F (3,), which may be changed.
    """

    def __init__(self, nodes: IntArray, force_n: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self._nodes = nodes
        self.force_n = np.array(force_n, dtype=np.float64)

    def energy(self, u: FloatArray) -> float:
        """Return Pi in N mm."""
        return -float(self.force_n @ u[self._nodes].mean(axis=0))

    def gradient(self, u: FloatArray) -> FloatArray:
        """Return dPi/du in N, shape (n, 3)."""
        out = np.zeros_like(u)
        out[self._nodes] = -self.force_n / len(self._nodes)
        return out

    def hessian(self, u: FloatArray, project: bool) -> sp.coo_array | sp.csr_array:
        """Return zero."""
        return sp.coo_array((u.size, u.size))

    def max_step(self, u: FloatArray, du: FloatArray) -> float:
        """Return 1: a force allows every step."""
        return 1.0


@dataclass(frozen=True, slots=True)
class PushedFinger:
    """Equilibria under a force that grows to its whole size, k increments.

    Attributes
    ----------
    force_n
        Force on the finger, (k, 3).
    moved_mm
        Mean displacement of the nodes that it acts on, (k, 3).
    displacement_mm
        Of all nodes at the whole force, (n, 3).
    mesh
        The mesh.
    """

    force_n: FloatArray
    moved_mm: FloatArray
    displacement_mm: FloatArray
    mesh: FingerMesh

    @property
    def stiffness_n_per_mm(self) -> float:
        """Whole force over how far its place has moved along it (a secant)."""
        force = self.force_n[-1]
        size = float(np.linalg.norm(force))
        return size**2 / float(force @ self.moved_mm[-1])


@dataclass(frozen=True, slots=True)
class TwistedFinger:
    """Equilibria of a finger whose tip end is turned about the finger's long axis, k increments.

    Attributes
    ----------
    angle_deg
        Turn of the tip end, from x towards y, (k,).
    torque_n_mm
        Torque about the middle of the tip end that it takes, (k,).
    side_force_n
        Force across the finger (x, y) that holds the axis in its place, (k, 2): zero only if the finger would twist
        about this axis by itself.
    displacement_mm
        Of all nodes at the whole angle, (n, 3).
    mesh
        The mesh.
    """

    angle_deg: FloatArray
    torque_n_mm: FloatArray
    side_force_n: FloatArray
    displacement_mm: FloatArray
    mesh: FingerMesh

    @property
    def stiffness_n_mm_per_deg(self) -> float:
        """Torque over angle at the whole angle (a secant)."""
        return float(self.torque_n_mm[-1] / self.angle_deg[-1])


class LoadedFinger:
    """A finger held at its base; one mesh, and one analysis of its matrix, for all its loads.

    Contact between ribs is not computed.

    Parameters
    ----------
    design
        Finger; its indenter plays no part.
    preset
        Fineness of the mesh; the design's own by default.
    threads
        Of elements and factorisation.
    steps
        Sizes in place of a preset, for studies of convergence.
    """

    def __init__(
        self, design: FingerDesign, preset: Preset | None = None, threads: int = 1, steps: MeshSteps | None = None
    ) -> None:
        sizes = steps or STEPS[preset or design.mesh.preset]
        self.mesh = finger_mesh(design, steps=sizes)
        self._middle_mm = design.pad.length_mm / 2.0
        self._ties = finger_ties(design, self.mesh, sizes.skeleton_mm)
        elasticity = Elasticity(self.mesh, finger_materials(design), threads)
        self._assembly = Assembly(elasticity, self._ties)
        self._held = Supports.at_rest(len(self.mesh.nodes_mm), self.mesh.node_sets["fixed"])
        self._solver = linear_solver(threads=threads)

    def push(self, place: Place, force_n: tuple[float, float, float], increments: int = 1) -> PushedFinger:
        """Push the tip or the side with a force that keeps its direction.

        Parameters
        ----------
        place
            "tip": spread over the end of the tip. "side": over the face at the end of x that the force points away
            from, 6 mm along the finger at the middle of the pad. "pad": under the gel, over its inner face, 10 mm along
            the finger at its middle: what the finger gives way without the gel.
        force_n
            Across the finger (x), along the pad's normal (y; the grasp pushes to -y), along the finger (z).
        increments
            Equal parts of the force.

        Raises
        ------
        SimulateError
            When the force is zero, or no equilibrium is found.
        """
        whole = np.array(force_n, dtype=np.float64)
        if not np.isfinite(whole).all() or not whole.any():
            raise SimulateError(f"force_n must be finite and not zero for a push, got {list(force_n)} N")
        nodes = self.nodes_at(place, float(whole[0]))
        force = DeadForce(nodes)

        def loading(fraction: float) -> Supports:
            force.force_n[:] = fraction * whole
            return self._held

        self._assembly.terms = (*self._ties, force)
        reached = self._path(loading, increments)
        moved = np.array([step.equilibrium.state.u_mm[nodes].mean(axis=0) for step in reached])
        forces = np.array([step.fraction for step in reached])[:, None] * whole
        return PushedFinger(forces, moved, reached[-1].equilibrium.state.u_mm, self.mesh)

    def twist(self, angle_deg: float, increments: int = 1) -> TwistedFinger:
        """Turn the tip end about a line along z through its middle; it stays free to move along z.

        Parameters
        ----------
        angle_deg
            From x towards y; large turns take several increments.
        increments
            Equal parts of the angle.

        Raises
        ------
        SimulateError
            When the angle is zero or beyond 90 deg, or no equilibrium is found.
        """
        if not 0.0 < abs(angle_deg) <= 90.0:
            raise SimulateError(
                f"angle_deg must be at most 90 deg to either side and not zero for a twist, got {angle_deg:g} deg"
            )
        end = self.mesh.node_sets["tip_end"]
        middle = (self.mesh.nodes_mm[end].min(axis=0) + self.mesh.nodes_mm[end].max(axis=0)) / 2.0
        arm = (self.mesh.nodes_mm[end] - middle)[:, :2]
        fixed = self._held.fixed.copy()
        fixed[end, :2] = True

        def turned(fraction: float) -> FloatArray:
            turn = np.radians(fraction * angle_deg)
            return np.asarray(arm @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]))

        def loading(fraction: float) -> Supports:
            move = np.zeros_like(self.mesh.nodes_mm)
            move[end, :2] = turned(fraction) - arm
            return Supports(fixed, move)

        self._assembly.terms = tuple(self._ties)
        reached = self._path(loading, increments)
        forces = [step.equilibrium.gradient_n[end, :2] for step in reached]
        places = [turned(step.fraction) for step in reached]
        torques = [float((p[:, 0] * f[:, 1] - p[:, 1] * f[:, 0]).sum()) for p, f in zip(places, forces, strict=True)]
        return TwistedFinger(
            angle_deg=np.array([step.fraction for step in reached]) * angle_deg,
            torque_n_mm=np.array(torques),
            side_force_n=np.array([f.sum(axis=0) for f in forces]),
            displacement_mm=reached[-1].equilibrium.state.u_mm,
            mesh=self.mesh,
        )

    def _path(self, loading: Callable[[float], Supports], increments: int) -> list[Increment]:
        """Return the equilibria from rest to the whole load.

        Raises
        ------
        SimulateError
            When one may be unstable.
        """
        stops = [(k + 1) / increments for k in range(increments)]
        reached = list(load_increments(self._assembly, self._solver, Load(loading), stops))
        for step in reached:
            if step.equilibrium.unstable:
                raise SimulateError(
                    f"at {step.fraction:.3g} of the load, {step.equilibrium.unstable}; give a smaller load or more "
                    "increments"
                )
        return reached

    def nodes_at(self, place: Place, towards_n: float) -> IntArray:
        """Return the nodes that share a force; at the side, those of the face that it presses on."""
        if place == "tip":
            return np.asarray(self.mesh.node_sets["tip_end"])
        part = self.mesh.surfaces["inner"] if place == "pad" else self.mesh.hexahedra["skeleton"]
        nodes = np.unique(part)
        x, z = self.mesh.nodes_mm[nodes, 0], self.mesh.nodes_mm[nodes, 2]
        along = np.abs(z - self._middle_mm)
        if place == "pad":
            return np.asarray(nodes[along <= max(_PAD_REACH_MM, along.min())])
        outer = x.min() if towards_n >= 0.0 else x.max()
        return np.asarray(nodes[(np.abs(x - outer) < _ON_SIDE_MM) & (along <= max(_SIDE_REACH_MM, along.min()))])


Progress = Callable[[int, int, str], None]

_TOUCH_MM = 0.1  # pushed in by displacement first: without contact nothing would hold an indenter under a force


def press_to_force(
    design: FingerDesign,
    force_n: float,
    settings: PressSettings | None = None,
    *,
    folder: Path = Path(),
    progress: Progress | None = None,
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
    settings
        How it is computed; ``increments`` are equal parts of the force, and ``contact`` plays no part.
    folder
        Where the design stands.
    progress
        Called before each iteration and after each increment.

    Returns
    -------
    PressedFinger
        Its mesh has one node more than the finger's, the last: the indenter.

    Raises
    ------
    SimulateError
        When the force is not positive, the indenter has no exact distances (a mesh of the user) or friction, or not
        even the first part of the force finds an equilibrium.
    """
    check_no_path(design)
    check_force(design, force_n)
    settings = settings or PressSettings()
    watch = Watch(progress, settings.increments, settings.budget_s)
    options = NewtonOptions(tell=watch.tell)
    touch = _DrivenIndenter(design, settings.preset, folder)
    ties = finger_ties(design, touch.mesh, STEPS[settings.preset or design.mesh.preset].skeleton_mm)
    assembly = Assembly(Elasticity(touch.mesh, finger_materials(design), settings.threads), [*touch.terms, *ties])
    solver = linear_solver(threads=settings.threads)
    first = touch.first_touch(assembly, solver, options)
    touched = first.state
    begin = float(touch.force_n(touched.u_mm)[1]) / force_n
    predict = Extrapolation()
    predict(assembly.at_rest(), 0.0, 0.0)
    history = PressHistory(assembly, ties, touch)
    history.unstable = first.unstable and f"at first touch, {first.unstable}"
    reached_n = 0.0
    try:
        load = Load(lambda share: touch.push_with(share * force_n))
        for step in load_increments(
            assembly, solver, load, settings.stops, (begin, touched), options=options, predict=predict
        ):
            depth_mm, reached_n = touch.depth_mm(step.equilibrium.state), step.fraction * force_n
            history.add(depth_mm, step.equilibrium)
            reached = sum(step.fraction >= stop for stop in settings.stops)
            watch.reached(reached, f"pressed with {reached_n:.2f} N to a push of {depth_mm:.2f} mm")
    except NoEquilibriumError as stuck:
        if history.depth_mm is None:
            raise
        touch.push_with(reached_n)
        return history.pressed(str(stuck))
    return history.pressed()


def check_force(design: FingerDesign, force_n: float) -> None:
    """Check that a design's indenter can be pressed to a force.

    Raises
    ------
    SimulateError
        See :func:`press_to_force`.
    """
    if not 0.0 < force_n < np.inf:
        raise SimulateError(f"force_n must be finite and above 0 N for a press, got {force_n:g} N")
    if design.indenter.shape == "mesh" or design.indenter.friction > 0.0:
        raise SimulateError(
            "with --force, the indenter must be a cylinder, ball or cuboid without friction; set indenter.shape and "
            "indenter.friction = 0, or press to a depth (leave --force out)"
        )


class _DrivenIndenter(PenaltyTouch):
    """The coat against exact distances of an indenter that is a node of its own, driven by a force."""

    def __init__(self, design: FingerDesign, preset: Preset | None, folder: Path) -> None:
        indenter, finger = rigid_indenter(design, folder), finger_mesh(design, preset)
        if indenter.body is None:
            raise SimulateError(
                "with --force, indenter.shape must be cylinder, ball or cuboid; press a mesh to a "
                "depth (leave --force out)"
            )
        self._node = len(finger.nodes_mm)
        mesh = replace(finger, nodes_mm=np.concatenate([finger.nodes_mm, [indenter.touching.position_mm]]))
        self._step_mm = STEPS[preset or design.mesh.preset].pad_mm
        points = coat_points(mesh.nodes_mm, mesh.surfaces["coat"], indenter.body)
        contact = PenaltyContact(
            mesh.nodes_mm, points, indenter.body, indenter.pose(_TOUCH_MM),
            penalty_mpa_per_mm(design, self._step_mm), reference_node=self._node, curvature=False,
        )  # fmt: skip
        super().__init__(mesh, contact)
        self._force = DeadForce(np.array([self._node]))
        self.terms: tuple[Term, ...] = (contact, self._force)
        self._held = Supports.at_rest(self._node + 1, np.append(mesh.node_sets["fixed"], self._node))
        self._free = self._held.fixed.copy()
        self._free[self._node, 1] = False

    @property
    def note(self) -> str:
        """How the surfaces touch, and what drives the indenter."""
        return f"{super().note}; the indenter is driven by a force of {-self._force.force_n[1]:g} N"

    def first_touch(self, assembly: Assembly, solver: SymmetricSolver, options: NewtonOptions) -> Equilibrium:
        """Return the equilibrium at a small push without the force.

        Raises
        ------
        NoEquilibriumError
            When there is none, or the coat is not touched: nothing would hold the indenter under a force.
        """
        touched = find_equilibrium(assembly, assembly.at_rest(), self._held, solver, options)
        if touched.failure:
            why = f"{touched.failure}; try a finer mesh"
            raise NoEquilibriumError(f"no equilibrium at a push of {_TOUCH_MM:g} mm: {why}")
        if not self.force_n(touched.state.u_mm)[1] > 0.0:
            raise NoEquilibriumError(
                f"the indenter touches no node of the coat at a push of {_TOUCH_MM:g} mm, where a press with --force "
                f"begins, because the coat's elements are {self._step_mm:g} mm wide; take a finer [mesh] preset, or "
                "press to a depth with --contact barrier"
            )
        return touched

    def push_with(self, force_n: float) -> Supports:
        """Set the force and return the supports."""
        self._force.force_n[1] = -force_n
        return Supports(self._free, np.zeros_like(self.mesh.nodes_mm))

    def depth_mm(self, state: State) -> float:
        """Return the push from first touch."""
        return _TOUCH_MM - float(state.u_mm[self._node, 1])


@dataclass(frozen=True, slots=True)
class GelBlock:
    """A block of gel between two rigid plates.

    Attributes
    ----------
    length_mm, width_mm, height_mm
        Its edges; the height lies along the push.
    plates
        "lubricated": plates without friction, sides free. "bonded": the gel is glued to both plates, sides free.
        "confined": lubricated plates, and walls around the sides.

    Raises
    ------
    SimulateError
        When an edge is not from 0.5 to 300 mm.
    """

    length_mm: float
    width_mm: float
    height_mm: float
    plates: Plates

    def __post_init__(self) -> None:
        for name in ("length_mm", "width_mm", "height_mm"):
            value = getattr(self, name)
            if not _EDGES_MM[0] <= value <= _EDGES_MM[1]:
                raise SimulateError(
                    f"{name} must be from {_EDGES_MM[0]:g} to {_EDGES_MM[1]:g} mm for an edge of a block, got "
                    f"{value:g} mm"
                )


_EDGES_MM = (0.5, 300.0)
# of the height: beyond, a mesh's corners fold, at glued plates long before
_DEEPEST_SHARES: dict[Plates, float] = {"lubricated": 0.5, "bonded": 0.25, "confined": 0.5}


@dataclass(frozen=True, slots=True)
class CompressedBlock:
    """Equilibria of a block, k pushes.

    Attributes
    ----------
    push_mm
        Of one plate towards the other, (k,).
    force_n
        That it takes, (k,).
    ln_force_per_ln_bulk
        d ln F / d ln(K/mu) at a constant mu, (k,).
    """

    push_mm: FloatArray
    force_n: FloatArray
    ln_force_per_ln_bulk: FloatArray


_BULK_STEP_LN = 1e-4


def compress_block(
    block: GelBlock, material: Ogden, push_mm: Sequence[float], cells: int = 8, threads: int = 1
) -> CompressedBlock:
    """Compress a block between its plates.

    One eighth of it is meshed, by symmetry; sides do not touch the plates.

    Parameters
    ----------
    block, material
        What is compressed.
    push_mm
        Rising pushes, of at most half the height; a quarter of it between bonded plates.
    cells
        Some elements through half the height of a bonded block; the others deform alike everywhere.
    threads
        Of elements and factorisation.

    Raises
    ------
    SimulateError
        When a push is not above 0 or too deep, or finds no stable equilibrium.
    """
    pushes = np.asarray(push_mm, dtype=np.float64)
    deepest = _DEEPEST_SHARES[block.plates] * block.height_mm
    if not (pushes[0] > 0.0 and (np.diff(pushes) > 0.0).all() and pushes[-1] <= deepest):
        raise SimulateError(
            f"pushes of a {block.plates} block {block.height_mm:g} mm high must increase, be above 0 and at most "
            f"{deepest:g} mm, got up to {pushes.max():.3g} mm; leave out the points beyond"
        )
    mesh, fixed, push = _eighth(block, cells)
    elasticity = Elasticity(mesh, {"gel": material}, threads)
    sides = [
        Elasticity(mesh, {"gel": replace(material, bulk_over_shear=material.bulk_over_shear * math.exp(step))}, threads)
        for step in (-_BULK_STEP_LN, _BULK_STEP_LN)
    ]
    assembly, solver = Assembly(elasticity), linear_solver(threads=threads)
    load = Load(lambda share: Supports(fixed, share * pushes[-1] * push))
    rows, stops = [], list(pushes / pushes[-1])
    for step in load_increments(assembly, solver, load, stops):
        if step.fraction not in stops:  # an increment that was shortened
            continue
        state = step.equilibrium.state
        stable = StableEquilibrium(assembly, load.at(step.fraction), state, solver, push)
        low, high = (residual_and_energy(side, state)[0] for side in sides)
        # the whole stores eight times the energy of its eighth, and its force is the derivative of that by the push
        force = 8.0 * float((step.equilibrium.gradient_n * push).sum())
        slope = 8.0 * float(((high - low) * stable.follow).sum()) / (2.0 * _BULK_STEP_LN)
        rows.append((step.fraction * pushes[-1], force, slope / force))
    wanted = np.array(rows)
    return CompressedBlock(wanted[:, 0], wanted[:, 1], wanted[:, 2])


def _eighth(block: GelBlock, cells: int) -> tuple[FingerMesh, NDArray[np.bool_], FloatArray]:
    """Return one eighth of a block, which unknowns are held, and how its plate moves with the push."""
    half = np.array([block.length_mm, block.height_mm, block.width_mm]) / 2.0
    if block.plates == "bonded":
        first = half[1] / cells
        # finer towards the free edges at the plate, where stress is infinite
        lines = [graded(size, first / 2.0, 1.5, max(first, size / cells), (False, True)) for size in half]
    else:
        lines = [np.array([0.0, size / 2.0, size]) for size in half]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    grid = hexahedra_on_grid(points, np.ones([len(line) - 1 for line in lines], dtype=np.bool_))
    nodes = grid.nodes_mm
    fixed = nodes == 0.0
    plate = nodes[:, 1] == half[1]
    fixed[plate, 1] = True
    if block.plates == "bonded":
        fixed[plate] = True
    if block.plates == "confined":
        fixed[:, [0, 2]] |= nodes[:, [0, 2]] == half[[0, 2]]
    push = np.zeros_like(nodes)
    push[plate, 1] = -0.5
    mesh = FingerMesh(nodes, (Block("gel", grid.hexahedra, "gel", "mean_dilatation"),), {}, {}, ())
    return mesh, fixed, push
