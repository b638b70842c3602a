"""The way to a load: equilibria at shares of it, with smaller increments where needed and predicted starts.

A prediction extrapolates the increments before, or takes a press on a coarser mesh of the same finger.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from data_schemas import NoEquilibriumError, SimulateError
from sim.mechanics._assembly import Assembly, State
from sim.mechanics._linear_solver import SymmetricSolver
from sim.mechanics._mesh import FingerMesh
from sim.mechanics._newton import Equilibrium, NewtonOptions, Supports, find_equilibrium

_MODE_STEPS = 4  # element by element; the second one usually changes nothing any more
_MODES_SETTLED_REL = 1e-3  # of the energy; Newton's method does the rest
# a search that has taken this long from a guess is not begun again from the last equilibrium: half the way is cheaper
_LONG_GUESS = 10
# iterations after which half the way is tried instead: searches that wander beside a saddle take 50 and fail, and the
# same way in two halves took 15 to 32
_PATIENCE = 25
_TOUCHING = 0.1  # of an increment's way: what touches there is held in the linear answer that a search starts from
_MOST_ROUNDS = 12  # renewals of lagged forces; each takes the change down to about the coefficient of friction
LAGGED_REL = 1e-3  # of the forces, out of balance: nearer than this is of no use while lagged forces still change
# and, in a press to a depth, from where the curvature of sharp edges counts: without it 10 to 20 iterations follow
CURVED_REL = 1e-2


@dataclass(frozen=True, slots=True)
class Increment:
    """An equilibrium on the way to the full load, with the share of the load that it carries."""

    fraction: float
    equilibrium: Equilibrium


class Watch:
    """Tells how far a press is, and ends it when its processor time is spent.

    Parameters
    ----------
    progress
        Called with stops done, stops in all and words.
    total
        Number of stops.
    budget_s
        Processor time of this process, all threads together, from now on; none: any. The press ends where the next
        iteration, taken to be as long as the last one, would exceed it.
    """

    def __init__(
        self, progress: Callable[[int, int, str], None] | None, total: int, budget_s: float | None = None
    ) -> None:
        self._progress, self._total, self._budget_s = progress, total, budget_s
        self._begin_s = time.process_time()
        self._told_s: float | None = None
        self._before = ""
        self._done = 0

    @property
    def left_s(self) -> float | None:
        """Processor time that is left, none of an unlimited one."""
        return None if self._budget_s is None else self._budget_s - (time.process_time() - self._begin_s)

    def coarse(self, done: int, total: int, what: str) -> None:
        """Tell of the press on the coarse mesh that goes before; none of its increments counts."""
        if self._progress is not None:
            self._progress(0, self._total, f"{what} on the coarse mesh")

    def reached(self, done: int, what: str) -> None:
        """Tell of an increment; what is told from now on is beyond it."""
        self._done, self._before = done, f"{what}, "
        if self._progress is not None:
            self._progress(done, self._total, what)

    def tell(self, what: str) -> None:
        """Tell of an iteration.

        Raises
        ------
        NoEquilibriumError
            When the budget does not allow it.
        """
        if self._progress is not None:
            self._progress(self._done, self._total, self._before + what)
        now = time.process_time()
        last_s, self._told_s = 0.0 if self._told_s is None else now - self._told_s, now
        left_s = self.left_s
        if left_s is not None and left_s < last_s:
            raise NoEquilibriumError(
                f"the budget of {self._budget_s:g} s of processor time is spent ({now - self._begin_s:.1f} s; the last "
                f"iteration took {last_s:.1f} s). The earlier increments are kept; allow more time, or continue from "
                "them"
            )


Predictor = Callable[[State, float, float], State | None]
"""From the last equilibrium, its share of the load and the share aimed at: where to start the search, or nothing."""


class Extrapolation:
    """A predictor: the straight line through the last two equilibria."""

    def __init__(self) -> None:
        self._known: list[tuple[float, State]] = []

    def __call__(self, state: State, at: float, aim: float) -> State | None:
        """Return the state expected at the share `aim` of the load after the equilibrium `state` at the share `at`."""
        if not self._known or self._known[-1][0] != at:
            self._known = [*self._known[-1:], (at, state)]
        if len(self._known) < 2:
            return None
        (before, old), (_, new) = self._known
        further = (aim - at) / (at - before)
        return State(
            new.u_mm + further * (new.u_mm - old.u_mm),
            tuple(n + further * (n - o) for n, o in zip(new.modes, old.modes, strict=True)),
            tuple(n + further * (n - o) for n, o in zip(new.pressures_mpa, old.pressures_mpa, strict=True)),
        )


def _allowed(assembly: Assembly, state: State, guess: State | None, supports: Supports) -> State | None:
    """Return a guess with the supports in their place, if no term forbids the way there and its energy is finite."""
    if guess is None:
        return None
    u = np.where(supports.fixed, supports.displacement_mm, guess.u_mm)
    there = State(u, guess.modes, guess.pressures_mpa)
    if assembly.max_step(state, u - state.u_mm) < 1.0 or not math.isfinite(assembly.energy(there)):
        return None
    return with_own_modes(assembly, there) if guess.modes is state.modes else there


def with_own_modes(assembly: Assembly, state: State) -> State:
    """Return a state with the incompatible modes that belong to its displacements, as nearly as a few steps tell.

    A guess from another mesh brings displacements only: bent elements are too stiff without their modes, and Newton's
    method goes astray on all unknowns. Steps of all elements together, as long as they lower the energy.
    """
    energy, still = assembly.energy(state), np.zeros_like(state.u_mm)
    for _ in range(_MODE_STEPS):
        assembly.assemble(state)
        there = state.moved(1.0, still, assembly.elasticity.mode_step(still))
        new = assembly.energy(there)
        if not new < energy:
            break
        state, fallen, energy = there, energy - new, new
        if fallen < _MODES_SETTLED_REL * abs(energy):
            break
    return state


@dataclass(frozen=True, slots=True)
class Load:
    """What a load does at a share of it, and which equilibria are its own.

    Attributes
    ----------
    at
        Sets the terms (an indenter's place) for a share of the load and returns the supports at that share.
    settle
        Renews at an equilibrium what terms have lagged (friction) and tells whether it still is one; else the search
        goes on from there.
    refuse
        Tells why an equilibrium at a share of the load is none of this load's path (an indenter that has passed through
        the coat), or nothing; a smaller increment is tried then.
    settle_rel
        Of the forces, out of balance, at which `settle` is asked first.
    take_up
        Adds a term that an equilibrium at a share of the load calls for and the ones before do not (contact of parts
        that have come near) and tells so, or returns nothing; the same increment is then sought again with it.
    accept
        Told each equilibrium that is kept, before the next increment begins.
    hold
        From a state and two shares of the load, lets contact act at the second share at those places alone that touch
        at the first one, as if they could not part, until :attr:`at` is called; tells whether there are any.
    """

    at: Callable[[float], Supports]
    settle: Callable[[State], bool] | None = None
    settle_rel: float = LAGGED_REL
    refuse: Callable[[State, float], str] | None = None
    take_up: Callable[[State, float], str] | None = None
    accept: Callable[[State], None] | None = None
    hold: Callable[[State, float, float], bool] | None = None


@dataclass(frozen=True, slots=True)
class _Search:
    """What every search for an increment's equilibrium shares."""

    assembly: Assembly
    solver: SymmetricSolver
    load: Load
    options: NewtonOptions

    def equilibrium(
        self, state: State, guess: State | None, share: float, supports: Supports, last: bool
    ) -> Equilibrium:
        """Search from a guess, where there is one, and then from a state; with patience when it is the last try."""
        options = self.options
        if not last:
            options = replace(options, patience=_PATIENCE)
        if self.load.settle is not None:
            options = replace(options, residual_rel=max(self.load.settle_rel, options.residual_rel), stable=False)
        reached = self._from(state if guess is None else guess, supports, options)
        if reached.failure and guess is not None and (last or reached.iterations < _LONG_GUESS):
            reached = self._from(state, supports, options)
        if reached.failure and last:
            reached = self._from(state, supports, replace(options, stalled_after=0))
        reached = self._settled(reached, supports, options)
        if self.load.refuse is not None and not reached.failure:
            return replace(reached, failure=self.load.refuse(reached.state, share))
        return reached

    def touched(self, state: State, last_share: float, share: float, supports: Supports) -> State | None:
        """Return the linear answer to a share of the load in which a tenth of the way decides what touches, or nothing.

        A rigid body that is moved in all at once touches far more than it does in the end, and Newton's method lets go
        of about half of that at a time; what it has too little of, it takes up at once.
        """
        if self.load.hold is None:
            return None
        held = self.load.hold(state, last_share + _TOUCHING * (share - last_share), share)
        found = self._linear(state, supports.fixed.ravel()) if held else None
        self.load.at(share)
        return found

    def _linear(self, state: State, fixed: NDArray[np.bool_]) -> State | None:
        """Return the state after a whole step of Newton's method, or nothing where the tangent is not definite."""
        elasticity, matrix = self.assembly.elasticity, self.assembly.matrix
        gradient, _ = self.assembly.assemble(state)
        matrix.constrain(fixed)
        if not self.solver.factorise_definite(matrix.upper(), matrix.version):
            return None
        du = self.solver.solve(np.where(fixed, 0.0, -gradient.ravel())).reshape(-1, 3)
        step = elasticity.mode_step(du)
        pressures, _ = elasticity.full_step_pressures_mpa(du, step)
        return state.moved(1.0, du, step).towards(pressures, 1.0)

    def _from(self, state: State, supports: Supports, options: NewtonOptions) -> Equilibrium:
        return find_equilibrium(self.assembly, state, supports, self.solver, options)

    def _settled(self, reached: Equilibrium, supports: Supports, options: NewtonOptions) -> Equilibrium:
        """Return the equilibrium at which nothing that terms have lagged changes any more."""
        if self.load.settle is None:
            return reached
        final = replace(self.options, patience=options.patience)
        for _ in range(_MOST_ROUNDS):
            if reached.failure:
                return reached
            if self.load.settle(reached.state):
                if options is final:
                    return reached
                options = final
            further = find_equilibrium(self.assembly, reached.state, supports, self.solver, options, reached)
            reached = replace(further, iterations=reached.iterations + further.iterations)
        return replace(reached, failure=f"friction and push have not settled in {_MOST_ROUNDS} rounds")


def load_increments(
    assembly: Assembly,
    solver: SymmetricSolver,
    load: Load,
    stops: Sequence[float],
    begin: tuple[float, State] | None = None,
    shortest_share: float = 1.0 / 64.0,
    options: NewtonOptions | None = None,
    predict: Predictor | None = None,
) -> Iterator[Increment]:
    """Yield equilibria at the given shares of the load, and between them where smaller increments are needed.

    Parameters
    ----------
    assembly, solver, options
        See :func:`~sim.mechanics._newton.find_equilibrium`.
    load
        What acts.
    stops
        Rising or falling shares at which equilibria are wanted.
    begin
        Share and state to go on from; by default 0 and rest.
    shortest_share
        Least increment, as a share of the way from one stop to the next.
    predict
        Where to start the search at a share of the load; by default the last two equilibria are extrapolated. Where
        that start is not allowed or leads nowhere, the search starts from the last equilibrium.

    Raises
    ------
    NoEquilibriumError
        When an increment of the least size finds no equilibrium; all increments before have been yielded.
    """
    options = options or NewtonOptions()
    tell = options.tell or (lambda _: None)
    search = _Search(assembly, solver, load, options)
    at, start = begin or (0.0, assembly.at_rest())
    state = assembly.with_own_pressures(start)
    predicted = predict or Extrapolation()
    for stop in stops:
        way = stop - at
        part, done = 1.0, 0.0
        while done < 1.0:
            part = min(part, 1.0 - done)
            aim = stop if done + part >= 1.0 else stop - way * (1.0 - done - part)
            supports = load.at(aim)
            guess = predicted(state, at, aim) or search.touched(state, at, aim, supports)
            guess = _allowed(assembly, state, guess, supports)
            reached = search.equilibrium(state, guess, aim, supports, last=part / 2.0 < shortest_share)
            if reached.failure:
                part /= 2.0
                if part < shortest_share:
                    stuck = NoEquilibriumError(
                        f"no equilibrium was found beyond {at:.4g} of the load: {reached.failure}. The increments up "
                        "to there are kept; try a finer mesh, smaller increments, or a smaller load"
                    )
                    stuck.reason = reached.failure
                    raise stuck
                tell(f"increment shortened from {2.0 * part:.3g} to {part:.3g}: {reached.failure}")
                continue
            if load.take_up is not None and (taken_up := load.take_up(reached.state, aim)):
                tell(taken_up)
                continue
            state, at, done = reached.state, aim, done + part
            if load.accept is not None:
                load.accept(state)
            part *= 2.0
            yield Increment(at, reached)


FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float
)
_NEAREST_CENTRES = 64  # hexahedra whose boxes are looked at
_CANDIDATES = (2, 16)  # nearest of these boxes that a node is looked for in, more for who lies in none
_INVERSION_STEPS = 5  # Newton's method in a convex hexahedron converges in three or four
_TOGETHER = 20_000  # pairs of node and hexahedron inverted at a time: 60 MB
_BOXES_TOGETHER = 500_000  # pairs of node and box looked at at a time: 100 MB
# curved walls have other chords on another mesh: a node may lie this share of a hexahedron's half-size outside
_OUTSIDE = 0.5
_SLIGHTLY = 1e-6  # beyond this a better hexahedron is looked for among more candidates


class Interpolation:
    """Takes displacements of one mesh of a finger to the nodes of another one, block by block at rest coordinates.

    Trilinear in the hexahedron that a node lies in; just beyond the surface the hexahedron's field is continued. Where
    both meshes have the same hexahedra (a dimension has changed a little), node to node.

    Parameters
    ----------
    source, target
        Meshes with blocks of the same names.

    Raises
    ------
    SimulateError
        When the meshes are not of the same finger: a block is missing or lies elsewhere.
    """

    def __init__(self, source: FingerMesh, target: FingerMesh) -> None:
        missing = set(target.hexahedra) ^ set(source.hexahedra)
        if missing:
            raise SimulateError(
                f"a press can start only from a mesh of the same finger, but {', '.join(sorted(missing))} is a part of "
                "only one of the two meshes"
            )
        count = len(target.nodes_mm)
        self._cells, self._weights = np.zeros((count, 8), np.int64), np.zeros((count, 8))
        if all(np.array_equal(cells, source.hexahedra[name]) for name, cells in target.hexahedra.items()):
            self._cells[:, 0], self._weights[:, 0] = np.arange(count), 1.0
            return
        for name, hexahedra in target.hexahedra.items():
            nodes = np.unique(hexahedra)
            cells, weights, outside = _located(source.nodes_mm, source.hexahedra[name], target.nodes_mm[nodes])
            worst = int(np.argmax(outside))
            if outside[worst] > _OUTSIDE:
                x, y, z = target.nodes_mm[nodes[worst]]
                raise SimulateError(
                    f"a press can start only from a mesh of the same finger, but the point ({x:.2f}, {y:.2f}, {z:.2f}) "
                    f"mm of its part {name} lies outside the other mesh"
                )
            self._cells[nodes], self._weights[nodes] = cells, weights

    def __call__(self, displacement_mm: FloatArray) -> FloatArray:
        """Return the displacement (n, 3) at the target's nodes of one (m, 3) of the source's nodes."""
        return np.asarray(np.einsum("na,nai->ni", self._weights, displacement_mm[self._cells]))


class CoarserPath:
    """A predictor for :func:`sim.mechanics._increments.load_increments`: the coarser press's increment, interpolated.

    Parameters
    ----------
    source, target
        The coarser mesh and the one that is to be solved.
    fractions
        Rising shares of the load (k,) of the coarser press's equilibria.
    displacements_mm
        Their displacements (k, m, 3).
    """

    def __init__(
        self, source: FingerMesh, target: FingerMesh, fractions: ArrayLike, displacements_mm: FloatArray
    ) -> None:
        self._interpolation = Interpolation(source, target)
        self._beyond = Extrapolation()
        self._fractions = np.concatenate([[0.0], np.asarray(fractions, dtype=np.float64)])
        self._path = np.concatenate([np.zeros((1, *displacements_mm.shape[1:])), displacements_mm])

    def _at(self, fraction: float) -> FloatArray:
        """Return the coarser displacement at a share of the load, on straight lines between its equilibria."""
        k = int(np.clip(np.searchsorted(self._fractions, fraction), 1, len(self._fractions) - 1))
        low, high = self._fractions[k - 1 : k + 1]
        share = (fraction - low) / (high - low)
        return np.asarray((1.0 - share) * self._path[k - 1] + share * self._path[k])

    def __call__(self, state: State, at: float, aim: float) -> State | None:
        """Return the equilibrium at the share `at`, displaced by what the coarser one moves on to the share `aim`.

        Beyond the coarser press's last equilibrium, its own last two are extrapolated.
        """
        further = self._beyond(state, at, aim)
        if aim > self._fractions[-1]:
            return further
        moved = self._interpolation(self._at(aim) - self._at(at))
        return State(state.u_mm + moved, state.modes, state.pressures_mpa)


def _located(nodes: FloatArray, hexahedra: IntArray, points: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return for each point the nodes (n, 8) and weights of its hexahedron, and how far outside it lies."""
    near = _nearest_boxes(nodes[hexahedra], points)
    owner, local = np.zeros(len(points), np.int64), np.full((len(points), 3), np.inf)
    left = np.arange(len(points))
    for candidates in _CANDIDATES:
        tried = near[left, :candidates]
        found = np.concatenate(
            [
                _local_coordinates(nodes[hexahedra[tried[rows]]], points[left[rows]])
                for rows in np.array_split(np.arange(len(left)), max(1, tried.size // _TOGETHER))
            ]
        )
        excess = np.where(np.isfinite(found).all(axis=2), np.abs(found).max(axis=2), np.inf) - 1.0
        best = excess.argmin(axis=1)
        row = np.arange(len(left))
        owner[left], local[left] = tried[row, best], found[row, best]
        left = left[excess[row, best] > _SLIGHTLY]
        if not len(left):
            break
    shapes, _ = _shapes(local)
    return hexahedra[owner], shapes, np.abs(local).max(axis=1) - 1.0


def _nearest_boxes(corners: FloatArray, points: FloatArray) -> IntArray:
    """Return for each point the hexahedra whose boxes are nearest, those with nearer centres first among equals.

    Centres alone would not do: of long and thin hexahedra the nearest centre may be that of another layer.
    """
    _, near = cKDTree(corners.mean(axis=1)).query(points, k=min(_NEAREST_CENTRES, len(corners)))
    near = near.reshape(len(points), -1)
    low, high = corners.min(axis=1), corners.max(axis=1)
    found = []
    for rows in np.array_split(np.arange(len(points)), max(1, near.size // _BOXES_TOGETHER)):
        place, cells = points[rows, None], near[rows]
        off = np.maximum(0.0, np.maximum(low[cells] - place, place - high[cells])).max(axis=2)
        order = np.argsort(off, axis=1, kind="stable")[:, : _CANDIDATES[-1]]
        found.append(np.take_along_axis(cells, order, axis=1))
    return np.concatenate(found)


def _local_coordinates(corners: FloatArray, points: FloatArray) -> FloatArray:
    """Return the local coordinates (n, c, 3) of points (n, 3) in hexahedra with corners (n, c, 8, 3)."""
    local = np.zeros((*corners.shape[:2], 3))
    for _ in range(_INVERSION_STEPS):
        shapes, slopes = _shapes(local)
        off = points[:, None] - np.einsum("nca,ncai->nci", shapes, corners)
        jacobian = np.einsum("ncai,ncaj->ncij", corners, slopes)
        # a far candidate may fold: its place is of no use, but must not stop the others
        folded = np.abs(np.linalg.det(jacobian)) < 1e-12
        jacobian[folded] = np.eye(3)
        step = np.linalg.solve(jacobian, off[..., None])[..., 0]
        step[folded] = np.inf
        local = np.clip(local + step, -1e3, 1e3)
    return local


def _shapes(local: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the trilinear shape functions at points (..., 3), shape (..., 8), and their gradients (..., 8, 3)."""
    sides = 1.0 + _CORNERS * local[..., None, :]
    x, y, z = sides[..., 0], sides[..., 1], sides[..., 2]
    slopes = np.stack([_CORNERS[:, 0] * y * z, _CORNERS[:, 1] * x * z, _CORNERS[:, 2] * x * y], axis=-1)
    return x * y * z / 8.0, slopes / 8.0
