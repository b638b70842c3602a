"""Press an indenter into a finger: increments of the push, from first touch or from a stored press.

Contact is the fast penalty on exact distances, or the barrier with contact of the ribs; both with friction.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import ContactKind, FingerDesign, MissingExtraError, NoEquilibriumError, Preset, SimulateError
from sim.mechanics._assembly import Assembly, Elasticity, Modes, State, Term
from sim.mechanics._contact_library import contact_library_failure
from sim.mechanics._finger_mesh import STEPS, TiedNodes, finger_materials, finger_mesh, finger_ties
from sim.mechanics._increments import CoarserPath, Increment, Load, Watch, load_increments
from sim.mechanics._indenters import rigid_indenter
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._materials import material_of
from sim.mechanics._mesh import FingerMesh, OwnSurfaces, face_points
from sim.mechanics._newton import Equilibrium, NewtonOptions, Supports
from sim.mechanics._parts_contact import PartsContact, check_parts_contact
from sim.mechanics._penalty_contact import PenaltyPress, SlidingPress, penalty_mpa_per_mm

if TYPE_CHECKING:
    from sim.mechanics._barrier_contact import Barrier
    from sim.mechanics._penalty_contact import ContactMotion

FloatArray = NDArray[np.float64]
ContactChoice = Literal["auto", "penalty", "barrier"]


class Touch(Protocol):
    """What contact does at an equilibrium; `mesh` is the finger's, with one more node where the indenter is one."""

    mesh: FingerMesh
    kind: ContactKind

    @property
    def note(self) -> str:
        """How surfaces touch, in words."""
        ...

    def caveat(self, u: FloatArray) -> str:
        """Return what a user must know of the contact at an equilibrium, in words, or nothing."""
        ...

    def force_n(self, u: FloatArray) -> FloatArray:
        """Return the force on the indenter (3,)."""
        ...

    def energy_n_mm(self, u: FloatArray) -> float:
        """Return the energy that the contact stores, without friction."""
        ...

    def friction_work_n_mm(self, u: FloatArray) -> float:
        """Return the work lost to friction in the increment that ended at `u`."""
        ...

    def pressures_mpa(self, u: FloatArray) -> FloatArray:
        """Return the pressure at q points of the coat's f faces, (f, q)."""
        ...

    def touch_mm(self) -> FloatArray:
        """Return where these points lie in the undeformed pad, (f, q, 3)."""
        ...


class PressContact(Touch, Protocol):
    """What a press to a depth needs of its contact."""

    terms: tuple[Term, ...]
    settle_rel: float

    def push(self, depth_mm: float) -> Supports:
        """Move the indenter to a depth and return the supports; lagged forces are those of the last increment."""
        ...

    @property
    def settle(self) -> Callable[[State], bool] | None:
        """Renews lagged forces at an equilibrium and returns whether it still is one; None: nothing is lagged."""
        ...

    def accept(self, state: State) -> None:
        """Let the next increment begin at a stored state."""
        ...


def chosen_contact(wanted: ContactChoice = "auto") -> ContactKind:
    """Return the contact that a press begins with: the penalty, unless the barrier is asked for.

    Raises
    ------
    MissingExtraError
        When the barrier is asked for, and its library does not run here.
    """
    if wanted != "barrier":
        return "penalty"
    if (failure := contact_library_failure()) is not None:
        raise MissingExtraError(f"--contact barrier is not possible here: {failure}")
    return "barrier"


_LIFT_MM: Final = 1e-3  # a body that just touches does not cross


def press_contact(
    design: FingerDesign,
    mesh: FingerMesh,
    step_mm: float,
    wanted: ContactChoice = "auto",
    threads: int = 1,
    folder: Path = Path(),
    barrier: "Barrier | None" = None,
) -> PressContact:
    """Return the contact of a finger with its indenter at first touch.

    Parameters
    ----------
    design, mesh
        Finger.
    step_mm
        Edge of the pad's elements.
    wanted
        See :func:`chosen_contact`.
    threads
        Of the barrier.
    folder
        Where the design stands.
    barrier
        How the barrier acts; by default its stiffness is the gel's shear modulus.

    Raises
    ------
    SimulateError, MissingExtraError
        See :func:`~sim.mechanics.rigid_indenter` and :func:`chosen_contact`.
    """
    kind = chosen_contact(wanted)
    indenter = rigid_indenter(design, folder)
    if kind == "penalty":
        if indenter.body is None and OwnSurfaces(mesh).is_crossed_by(
            indenter.vertices_mm(_LIFT_MM), indenter.surface.triangles
        ):
            raise SimulateError(
                "the indenter starts inside the finger, but must be outside before the push; check indenter.file, "
                "position_mm, across_mm and rotation_deg"
            )
        stiffness = penalty_mpa_per_mm(design, step_mm)
        if design.indenter.friction > 0.0:
            return SlidingPress(mesh, indenter, stiffness, design.indenter.friction)
        return PenaltyPress(mesh, indenter, stiffness)
    # here, because they cannot be imported where the library does not run
    from sim.mechanics._barrier_contact import Barrier, BarrierPress

    indenter.check_surface()
    chosen = barrier or Barrier(stiffness_mpa=material_of(design.mechanics.gel, "mechanics.gel").shear_modulus_mpa)
    return BarrierPress(design, mesh, indenter, replace(chosen, friction_ratio=design.indenter.friction), threads)


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
        Energy that is stored, (k,): strain of the elements, ties and contact.
    displacement_mm
        Of the nodes, (k, n, 3); of the last increments only, (l, n, 3), where a stored press was continued.
    iterations
        Newton iterations of each increment, (k,).
    modes_mm
        Incompatible modes of each block at the last increment, (m, 3, 3) or (m, 0, 3).
    pressure_mpa, touch_mm
        Of the last increment: contact pressure at the q sampling points of the coat's f faces (f, q), and where these
        lie in the undeformed pad (f, q, 3).
    unreached
        Why the push ended early; empty when it did not.
    contact
        In words: how the indenter and the parts touch.
    contact_energy_n_mm
        Of the energy, what the contact stores, (k,); none where the results of another program do not hold it.
    friction_work_n_mm
        Work lost to friction from first touch on, (k,): each increment's force at its end, along its slip.
    kind
        How the contact was computed.
    crossing
        From which push on surfaces of the finger pass through each other, and where; empty where none do.
    motion
        Of an indenter on a path (:func:`~sim.mechanics.press_along`): its poses and what its contact does at each.
    unstable
        At which push first the finger may stand at an unstable equilibrium; empty where the search found none.
    parts_touch_from_mm
        Push at the first increment where contact between the finger's parts acted beside the penalty of the indenter;
        none where there was no such increment.
    """

    mesh: FingerMesh
    depth_mm: FloatArray
    force_n: FloatArray
    energy_n_mm: FloatArray
    displacement_mm: FloatArray
    iterations: NDArray[np.int64]
    modes_mm: Modes
    pressure_mpa: FloatArray
    touch_mm: FloatArray
    unreached: str
    contact: str
    contact_energy_n_mm: FloatArray | None = None
    friction_work_n_mm: FloatArray | None = None
    kind: ContactKind | Literal["unknown"] = "unknown"
    crossing: str = ""
    motion: "ContactMotion | None" = None
    unstable: str = ""
    parts_touch_from_mm: float | None = None


class PressHistory:
    """The increments of a press so far, after those of a press that is continued.

    Parameters
    ----------
    assembly, ties, touch
        What is in equilibrium, and its parts whose energies are stated separately.
    before
        The press that is continued.
    parts
        Contact of the parts among themselves, where the press may take it up.

    Attributes
    ----------
    crossing, unstable, parts_touch_from_mm
        See :class:`PressedFinger`.
    """

    def __init__(
        self,
        assembly: Assembly,
        ties: Sequence[TiedNodes],
        touch: Touch,
        before: PressedFinger | None = None,
        parts: PartsContact | None = None,
    ) -> None:
        self._assembly, self._ties, self._touch, self._before, self._parts = assembly, ties, touch, before, parts
        self._surfaces = OwnSurfaces(touch.mesh) if parts is None else parts.surfaces
        self.crossing, self.unstable = self._stored_crossing(), "" if before is None else before.unstable
        self.parts_touch_from_mm = None if before is None else before.parts_touch_from_mm
        self._states: list[State] = []
        self._iterations: list[int] = []
        self._rows: list[tuple[float, ...]] = []

    @property
    def depth_mm(self) -> float | None:
        """Push at the last increment; none before the first."""
        return self._rows[-1][0] if self._rows else None

    def _stored_crossing(self) -> str:
        """Return that surfaces pass through each other at the increment that is continued, or nothing."""
        if self._before is None or not (found := self._surfaces.crossing(self._before.displacement_mm[-1])):
            return ""
        return f"from a push of {self._before.depth_mm[-1]:.4g} mm or less on, {found}"

    def add(self, depth_mm: float, equilibrium: Equilibrium) -> None:
        """Add an increment, before its contact is moved on."""
        state = equilibrium.state
        contact = self._touch.energy_n_mm(state.u_mm)
        of_parts = 0.0 if self._parts is None else self._parts.energy_n_mm(state.u_mm)
        contact += of_parts
        if of_parts > 0.0 and self.parts_touch_from_mm is None:
            self.parts_touch_from_mm = depth_mm
        stored = self._assembly.elasticity.energy(state.u_mm, state.modes) + contact
        stored += sum(tie.energy(state.u_mm) for tie in self._ties)
        lost = self._touch.friction_work_n_mm(state.u_mm)
        if not self.crossing and (found := self._surfaces.crossing(state.u_mm)):
            self.crossing = f"from a push of {depth_mm:.4g} mm on, {found}"
        if not self.unstable and equilibrium.unstable:
            self.unstable = f"at a push of {depth_mm:.4g} mm, {equilibrium.unstable}"
        self._states.append(state)
        self._iterations.append(equilibrium.iterations)
        self._rows.append((depth_mm, stored, contact, lost, *self._touch.force_n(state.u_mm)))

    def pressed(self, unreached: str = "") -> PressedFinger:
        """Return what was reached."""
        rows, last, note = np.array(self._rows), self._states[-1], self._touch.note
        return PressedFinger(
            mesh=self._touch.mesh,
            depth_mm=self._after("depth_mm", rows[:, 0]),
            force_n=self._after("force_n", rows[:, 4:]),
            energy_n_mm=self._after("energy_n_mm", rows[:, 1]),
            displacement_mm=np.array([state.u_mm for state in self._states]),
            iterations=self._after("iterations", np.array(self._iterations, dtype=np.int64)),
            modes_mm=last.modes,
            pressure_mpa=self._touch.pressures_mpa(last.u_mm),
            touch_mm=self._touch.touch_mm(),
            unreached=unreached,
            contact=(note if self._parts is None else self._parts.note(note, last.u_mm, self.parts_touch_from_mm))
            + self._touch.caveat(last.u_mm),
            contact_energy_n_mm=self._after("contact_energy_n_mm", rows[:, 2]),
            friction_work_n_mm=self._after("friction_work_n_mm", np.cumsum(rows[:, 3]), goes_on=True),
            kind=self._touch.kind,
            crossing=self.crossing,
            unstable=self.unstable,
            parts_touch_from_mm=self.parts_touch_from_mm,
        )

    def _after(self, name: str, now: NDArray[Any], goes_on: bool = False) -> NDArray[Any]:
        """Return values after those before, NaN where an older file does not tell them; sums go on from the last."""
        if self._before is None:
            return now
        before = getattr(self._before, name)
        if before is None:
            before = np.full(len(self._before.depth_mm), np.nan)
        return np.concatenate([before, now + before[-1] if goes_on else now])


def _coat_areas_mm2(mesh: FingerMesh) -> FloatArray:
    """Return the areas at rest of the coat's f faces, (f,)."""
    corners = mesh.nodes_mm[mesh.surfaces["coat"]]
    return np.asarray(
        np.linalg.norm(np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1) / 2.0
    )


def touch_areas_mm2(pressed: PressedFinger) -> FloatArray:
    """Return the areas at rest that the q sampling points of the coat's f faces stand for, (f, q)."""
    count, quads = pressed.pressure_mpa.shape[1], pressed.mesh.surfaces["coat"]
    shares = face_points(quads, math.isqrt(count)).shares if pressed.kind == "penalty" else 1.0 / count
    return np.asarray(_coat_areas_mm2(pressed.mesh)[:, None] * np.broadcast_to(shares, pressed.pressure_mpa.shape))


def contact_pressure_mpa(pressed: PressedFinger) -> FloatArray:
    """Return the contact pressure of the last increment at the mesh's n nodes, (n,); 0 away from the coat.

    p_a = sum_f A_f p_f / sum_f A_f over the faces f at node a, with p_f the mean of a face's points by the areas that
    they stand for, and A_f its area at rest: pressure times the coat's area is the same at the nodes as on the faces.
    """
    faces, areas = pressed.mesh.surfaces["coat"], touch_areas_mm2(pressed)
    count = len(pressed.mesh.nodes_mm)
    held = np.bincount(faces.ravel(), np.repeat((areas * pressed.pressure_mpa).sum(axis=1), 4), count)
    area = np.bincount(faces.ravel(), np.repeat(areas.sum(axis=1), 4), count)
    return np.asarray(np.divide(held, area, out=np.zeros(count), where=area > 0.0))


def contact_distance(pressed: PressedFinger, nodes: NDArray[np.int64]) -> FloatArray:
    """Return the distance of coat nodes from the middle of the contact in units of its half-width; <= 1 in contact.

    The patch is taken as an ellipse in the undeformed pad, or as a strip where it reaches across the pad. It ends half
    the distance between sampling points beyond the outermost one that touches, and is known to about that. NaN without
    contact.
    """
    touching = pressed.touch_mm[pressed.pressure_mpa > 0.0]
    # n Gauss points lie on average 1/n of a face apart, and the outermost ones by the last place
    count = math.isqrt(pressed.touch_mm.shape[1])
    last = np.polynomial.legendre.leggauss(count)[0][-1]
    margin = np.median(np.ptp(pressed.touch_mm, axis=1), axis=0) / (2.0 * count * last)
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


_WHOLE_WIDTH = 0.95  # a patch that reaches over this share of the pad is a strip across it

Progress = Callable[[int, int, str], None]

_SAME_SHARE = 1e-9  # two shares of a push that differ by rounding


@dataclass(frozen=True, slots=True)
class PressSettings:
    """How a press is computed.

    Attributes
    ----------
    preset
        Fineness of the mesh; the design's own by default.
    increments
        Equal steps of the push that are wanted; smaller ones are put between where needed.
    threads
        Of elements and factorisation.
    contact
        "auto": the penalty; a press whose parts pass through each other by it goes on from the last increment where
        they do not, with the barrier between its parts. Where parts were within the barrier's reach there, it begins
        again with the barrier for all contact.
    budget_s
        Processor time that it may take, see :class:`~sim.mechanics._increments.Watch`; then it ends early.
    """

    preset: Preset | None = None
    increments: int = 4
    threads: int = 1
    contact: ContactChoice = "auto"
    budget_s: float | None = None

    @property
    def stops(self) -> list[float]:
        """Shares of the push that are wanted."""
        return [(k + 1) / self.increments for k in range(self.increments)]


def press_finger(
    design: FingerDesign,
    settings: PressSettings | None = None,
    *,
    folder: Path = Path(),
    start: PressedFinger | None = None,
    resume: PressedFinger | None = None,
    store: Callable[[PressedFinger], None] | None = None,
    progress: Progress | None = None,
) -> PressedFinger:
    """Press the design's indenter in by its depth along the pad's normal, from first touch.

    Contact by a penalty on exact distances, without contact between ribs, or by a barrier with contact of all parts;
    with the design's friction. Each increment is checked for surfaces of the finger that pass through each other, and
    the result states it. A push of 5 mm and more buckles ribs, which takes more increments.

    Parameters
    ----------
    design
        Finger, materials and indenter; ``indenter.depth_mm`` is the whole push.
    settings
        How it is computed.
    folder
        Where the design stands: the STL of an indenter is relative to it.
    start
        The same press on a coarser mesh, whose displacements, interpolated, are where each increment's search starts.
        By default a finer mesh than coarse starts from the first increment on the coarse one (not with the barrier).
    resume
        The same press on the same mesh to a lower depth, to go on from.
    store
        Called after each increment with the press so far, for example to keep it for `resume`.
    progress
        Called before each iteration and after each increment.

    Raises
    ------
    SimulateError
        When there is no push, not even the first increment finds an equilibrium or has the time to, or `start` or
        `resume` is a press of another finger or mesh.
    """
    check_no_path(design)
    depth = design.indenter.depth_mm
    if depth <= 0.0:
        raise SimulateError(f"indenter.depth_mm must be above 0 mm for a press, got {depth:g} mm")
    settings = settings or PressSettings()
    if resume is not None and resume.kind == "barrier" and settings.contact == "auto":
        settings = replace(settings, contact="barrier")
    watch = Watch(progress, settings.increments, settings.budget_s)
    touch, history, path = _prepared(design, settings, folder, start, resume, watch)
    clean, done = resume, 0
    try:
        for step in path:
            history.add(step.fraction * depth, step.equilibrium)
            if history.crossing and settings.contact == "auto" and _barrier_may_help(touch):
                watch.reached(done, f"{history.crossing}; pressing again with contact of all parts")
                again = replace(settings, contact="barrier", budget_s=watch.left_s)
                by_barrier = partial(press_finger, design, again, folder=folder, store=store, progress=progress)
                return _pressed_again(by_barrier, clean, history.crossing)
            clean = history.pressed()
            if store is not None:
                store(clean)
            done = settings.increments - sum(step.fraction < stop for stop in settings.stops)
            watch.reached(done, f"pressed to {step.fraction * depth:.2f} mm")
    except NoEquilibriumError as stuck:
        if history.depth_mm is None:
            raise
        touch.push(history.depth_mm)
        return history.pressed(str(stuck))
    return history.pressed()


def check_no_path(design: FingerDesign) -> None:
    """Check that a design's indenter has no path, where it is pressed along the pad's normal.

    Raises
    ------
    SimulateError
        When it has one.
    """
    if design.indenter.path:
        raise SimulateError(
            f"indenter.path: has {len(design.indenter.path)} poses, but this press goes only along the pad's normal; "
            "leave [[indenter.path]] out of the design, or press without --force, --sensitivities, --resume, --engine "
            "and --contact barrier"
        )


def _prepared(
    design: FingerDesign,
    settings: PressSettings,
    folder: Path,
    start: PressedFinger | None,
    resume: PressedFinger | None,
    watch: Watch,
) -> tuple[PressContact, PressHistory, Iterator[Increment]]:
    """Return the contact, the history that an earlier press began, and the increments still to be found."""
    depth, steps = design.indenter.depth_mm, STEPS[settings.preset or design.mesh.preset]
    bare = finger_mesh(design, settings.preset)
    touch = press_contact(design, bare, steps.pad_mm, settings.contact, settings.threads, folder)
    ties = finger_ties(design, touch.mesh, steps.skeleton_mm)
    assembly = Assembly(Elasticity(touch.mesh, finger_materials(design), settings.threads), [*touch.terms, *ties])
    begin, done = _begun(resume, touch, depth)
    if start is None and resume is None:
        predict = _path_from_coarse(_first_on_coarse(design, settings, folder, watch), touch.mesh, depth)
    else:
        predict = None if start is None else _path_of(start, touch.mesh, depth)
    had_mm = None if resume is None else resume.parts_touch_from_mm
    may_act = settings.contact == "auto" and _barrier_may_help(touch)
    check_parts_contact(had_mm, settings.contact, may_act)
    parts = None
    if may_act:
        at_first = assembly.at_rest() if begin is None else begin[1]
        parts = PartsContact(design, touch.mesh, assembly, settings.threads, at_first.u_mm, had_mm is not None)
        if resume is not None:
            parts.check_start(float(resume.depth_mm[-1]))
    path = load_increments(
        assembly,
        linear_solver(threads=settings.threads),
        _load(touch, parts, depth, steps.pad_mm),
        [stop for stop in settings.stops if stop > done + _SAME_SHARE],
        begin,
        options=NewtonOptions(tell=watch.tell),
        predict=predict,
    )
    return touch, PressHistory(assembly, ties, touch, resume, parts), path


def _load(touch: PressContact, parts: PartsContact | None, depth_mm: float, pad_mm: float) -> Load:
    """Return the push, with what refuses an equilibrium of it or calls for contact of the parts."""

    def accept(state: State) -> None:
        touch.accept(state)
        if parts is not None:
            parts.accept(state)

    held = touch.hold if isinstance(touch, PenaltyPress | SlidingPress) else None
    return Load(
        at=lambda share: touch.push(share * depth_mm),
        settle=touch.settle,
        settle_rel=touch.settle_rel,
        refuse=lambda state, share: _passed_through(touch, state, share * depth_mm, pad_mm),
        take_up=None if parts is None else lambda state, share: parts.take_up(state, share * depth_mm),
        accept=accept,
        hold=held and (lambda state, part, share: held(state, part * depth_mm, share * depth_mm)),
    )


def _begun(
    resume: PressedFinger | None, touch: PressContact, depth_mm: float
) -> tuple[tuple[float, State] | None, float]:
    """Return the share and the state that the search goes on from, if any, and the share that a press has done."""
    if resume is None:
        return None, 0.0
    share, state = resumed(resume, touch.mesh, depth_mm)
    _take_up(touch, share, state, depth_mm)
    return (share, state), share


def _pressed_again(
    by_barrier: Callable[[], PressedFinger], clean: PressedFinger | None, crossing: str
) -> PressedFinger:
    """Return a press whose parts cross by the penalty, pressed again by the barrier from the start.

    Where that comes less far than the penalty came without a crossing, the penalty's increments stay.
    """
    if clean is not None and not clean.pressure_mpa.size:  # as stored: its surfaces are written already
        clean = None
    try:
        found = by_barrier()
    except NoEquilibriumError as stuck:
        if clean is None:
            raise
        return replace(clean, unreached=f"{stuck}; with penalty contact, {crossing}")
    if clean is not None and found.depth_mm[-1] < clean.depth_mm[-1]:
        return replace(
            clean,
            unreached=f"all-parts contact reached {found.depth_mm[-1]:.4g} mm only; with penalty contact, {crossing}",
        )
    return replace(found, contact=f"{found.contact}; with penalty contact, which was tried first, {crossing}")


def _take_up(touch: PressContact, share: float, state: State, depth_mm: float) -> None:
    """Let a contact go on from a stored state.

    The history of friction is not stored: the coat is taken to have come to touch and to slip on one straight way.
    """
    touch.push(share * depth_mm)
    if touch.settle is not None:
        touch.settle(state)
    touch.accept(state)


def _barrier_may_help(touch: PressContact) -> bool:
    """Whether parts that pass through each other can be pressed again with a contact that sees them all."""
    return touch.kind == "penalty" and contact_library_failure() is None


def _passed_through(touch: PressContact, state: State, pushed_mm: float, pad_mm: float) -> str:
    """Return that an equilibrium is one behind the coat, or nothing."""
    force_n = float(touch.force_n(state.u_mm)[1])
    # a round indenter may stand between the nodes of one element
    between = force_n == 0.0 and pushed_mm <= pad_mm
    return "" if force_n > 0.0 or between else "the indenter has passed through the coat"


def _first_on_coarse(design: FingerDesign, settings: PressSettings, folder: Path, watch: Watch) -> PressedFinger | None:
    """Press by the first increment on the coarse mesh, which halves the finer one's iterations there.

    Further increments are extrapolated: from 3 to 4 mm the coarse path led to a slow start on the medium mesh.
    """
    preset, contact = settings.preset or design.mesh.preset, settings.contact
    if preset == "coarse" or chosen_contact(contact) == "barrier":
        return None
    first = design.indenter.model_copy(update={"depth_mm": design.indenter.depth_mm / settings.increments})
    coarse = PressSettings("coarse", 1, settings.threads, "penalty", watch.left_s)
    try:
        return press_finger(design.model_copy(update={"indenter": first}), coarse, folder=folder, progress=watch.coarse)
    except SimulateError:
        return None


def _path_from_coarse(coarse: PressedFinger | None, mesh: FingerMesh, depth_mm: float) -> CoarserPath | None:
    """Return where a coarse press leads a finer mesh; none where the meshes are too far apart: it is help, not need."""
    try:
        return None if coarse is None else _path_of(coarse, mesh, depth_mm)
    except SimulateError:
        return None


def _path_of(press: PressedFinger, mesh: FingerMesh, depth_mm: float) -> CoarserPath:
    """Return the displacements of a coarser press on a mesh, by the share of the push."""
    return CoarserPath(press.mesh, mesh, list(press.depth_mm / depth_mm), press.displacement_mm)


def resumed(press: PressedFinger, mesh: FingerMesh, depth_mm: float) -> tuple[float, State]:
    """Return the share of a push that a stored press has done, and its state.

    Raises
    ------
    SimulateError
        When it stands on another mesh, or has been as deep already.
    """
    if not np.array_equal(press.mesh.nodes_mm, mesh.nodes_mm):
        raise SimulateError(
            f"the press to continue has another mesh ({len(press.mesh.nodes_mm)} nodes) than this press "
            f"({len(mesh.nodes_mm)} nodes); resume with the same design, mesh and --contact, or begin a new press"
        )
    done = float(press.depth_mm[-1])
    if done >= (1.0 - _SAME_SHARE) * depth_mm:
        raise SimulateError(
            f"the press to continue has already reached {done:g} mm, but indenter.depth_mm is only {depth_mm:g} mm; "
            "raise indenter.depth_mm, or resume from an earlier increment"
        )
    return done / depth_mm, State(press.displacement_mm[-1], press.modes_mm)
