"""Results of a search are least energies: a column past Euler's load, against all eigenvalues of its tangent."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from sim.mechanics import LinearElastic, Ogden
from sim.mechanics import _newton as newton
from sim.mechanics._increments import Load, State, load_increments
from sim.mechanics._linear_solver import least_curvature, linear_solver, stays_definite
from sim.mechanics._newton import NewtonOptions, Supports, find_equilibrium
from tests.certified.blocks import assemble, unit_cells

LENGTH_MM, HEIGHT_MM, WIDTH_MM = 24.0, 1.0, 1.2
SHORTER_MM = 1.0
# Euler's load shortens a clamped column by this before it buckles
EULER_MM = math.pi**2 * HEIGHT_MM**2 / (3.0 * LENGTH_MM)
STEEL = LinearElastic(1000.0, 0.3)
CELLS = unit_cells(12, 2, 2, size=(LENGTH_MM, HEIGHT_MM, WIDTH_MM))
both_solvers = pytest.mark.parametrize("solver", ["pardiso", "superlu"])


class Column:
    """A column between two clamps, one of which comes nearer, and to the side by a share of that."""

    def __init__(self, sideways_share=0.0, material=STEEL, size=1.0):
        mesh = CELLS.mesh("incompatible_modes")
        self.size = size  # over that of the constants above
        self.assembly = assemble(replace(mesh, nodes_mm=size * mesh.nodes_mm), material)
        self.fixed = Supports.at_rest(self.assembly.count, CELLS.numbers[[0, -1]].ravel()).fixed
        self.sideways_share = sideways_share

    def at(self, share):
        move = np.zeros((self.assembly.count, 3))
        end = CELLS.numbers[-1].ravel()
        move[end, 0], move[end, 1] = -SHORTER_MM * share, self.sideways_share * SHORTER_MM * share
        return Supports(self.fixed, self.size * move)

    def bent(self, amplitude_mm, shortened_mm):
        x, u = CELLS.nodes_mm, np.zeros((self.assembly.count, 3))
        u[:, 0] = -x[:, 0] * shortened_mm / LENGTH_MM
        u[:, 1] = amplitude_mm * (1.0 - np.cos(2 * np.pi * x[:, 0] / LENGTH_MM)) * ~self.fixed[:, 1]
        return State(self.size * u, self.assembly.elasticity.no_modes)

    def eigenvalues_n_per_mm(self, state):
        """Return all eigenvalues of the tangent at a state."""
        self.assembly.assemble(state)
        self.assembly.matrix.constrain(self.fixed.ravel())
        upper = self.assembly.matrix.upper()
        return np.linalg.eigvalsh((upper + sp.triu(upper, 1).T).toarray())

    def check(self, equilibrium, shortened_mm):
        """Check that all eigenvalues of the tangent are positive, and the height of the arch."""
        assert not equilibrium.failure
        assert not equilibrium.unstable
        assert self.eigenvalues_n_per_mm(equilibrium.state).min() > 0.0
        height = abs(equilibrium.state.u_mm[CELLS.numbers[6].ravel(), 1].mean()) / self.size
        # of a cosine arch; a few per cent are of the curve's higher order. Below Euler's load it stays as it is
        arch = 2.0 * math.sqrt(LENGTH_MM * max(shortened_mm - EULER_MM, 0.0)) / math.pi
        assert height == pytest.approx(arch, rel=0.05, abs=0.01)


@both_solvers
@pytest.mark.parametrize("stops", [4, 10])
@pytest.mark.parametrize("sideways_share", [0.0, 1e-6, 1e-4, 1e-2])
def test_a_column_between_moving_clamps_is_stable_at_every_increment(solver, stops, sideways_share):
    column = Column(sideways_share)
    shares = np.arange(1, stops + 1) / stops
    path = list(load_increments(column.assembly, linear_solver(solver), Load(column.at), shares))
    assert [step.fraction for step in path][-1] == 1.0
    for step in path:
        if sideways_share < 1e-3 or step.fraction > 0.3:  # a column pushed aside is no symmetric one near Euler's load
            column.check(step.equilibrium, SHORTER_MM * step.fraction)


def test_a_saddle_is_left_in_few_steps():
    # a tangent without negative curvature resists the bending that grows; whole steps alone take 12
    column = Column()
    reached = find_equilibrium(
        column.assembly, column.bent(1e-6, SHORTER_MM), column.at(1.0), linear_solver(), NewtonOptions()
    )
    column.check(reached, SHORTER_MM)
    assert reached.iterations <= 9


@both_solvers
@pytest.mark.parametrize("amplitude_mm", [0.0, 1e-12, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("moving", [True, False])
def test_a_column_bent_by_next_to_nothing_buckles(solver, amplitude_mm, moving):
    column = Column()
    start = column.bent(amplitude_mm, 0.0 if moving else SHORTER_MM)
    column.check(find_equilibrium(column.assembly, start, column.at(1.0), linear_solver(solver)), SHORTER_MM)


@pytest.mark.parametrize("size", [2e-3, 500.0])
def test_a_small_and_a_large_column_are_tested_like_any_other(size):
    column = Column(size=size)
    options = NewtonOptions(force_floor_n=1e-2 * size**2, longest_step_mm=8.0 * size)
    stops = np.arange(1, 11) / 10
    for step in load_increments(column.assembly, linear_solver(), Load(column.at), stops, options=options):
        column.check(step.equilibrium, SHORTER_MM * step.fraction)


@pytest.mark.parametrize("bulk_over_shear", [21.0, 2000.0, 10_000.0])
def test_a_saddle_of_a_nearly_incompressible_column_is_left_downwards(monkeypatch, bulk_over_shear):
    left = []
    search = newton._Search  # noqa: SLF001
    downwards = search._downwards  # noqa: SLF001

    def watched(self, state, way):
        found = downwards(self, state, way)
        left.append(found[1] - self.assembly.energy(state))
        return found

    monkeypatch.setattr(search, "_downwards", watched)
    column = Column(material=Ogden((300.0,), (2.0,), bulk_over_shear))
    path = list(load_increments(column.assembly, linear_solver(), Load(column.at), np.arange(1, 5) / 4))
    assert not any(step.equilibrium.unstable for step in path)
    assert left
    assert max(left) < 0.0


@both_solvers
def test_what_cannot_be_left_is_told(monkeypatch, solver):
    monkeypatch.setattr(newton, "_MOST_SADDLES", 0)
    column = Column()
    begin = column.bent(0.0, SHORTER_MM)
    reached = find_equilibrium(column.assembly, begin, column.at(1.0), linear_solver(solver))
    assert not reached.failure
    assert "could not leave an unstable equilibrium" in reached.unstable
    # rounding decides at which of its saddles, straight or in several waves, a column is found
    assert column.eigenvalues_n_per_mm(reached.state).min() < 0.0
    # asked for no test, a search makes none
    quick = find_equilibrium(column.assembly, begin, column.at(1.0), linear_solver(solver), NewtonOptions(stable=False))
    assert not quick.failure
    assert not quick.unstable


def chain(count=400):
    """A chain of springs between walls, as the upper triangle of its matrix and whole."""
    upper = sp.diags_array([np.full(count, 2.0), np.full(count - 1, -1.0)], offsets=[0, 1]).tocsr()
    return upper, upper + sp.triu(upper, 1).T


@both_solvers
@pytest.mark.parametrize("local", [True, False])
@pytest.mark.parametrize("kept", [1.0, 0.3, 0.06, 0.04, 1e-3, 0.0, -1e-3, -1.0])
def test_a_shape_that_has_lost_its_stiffness_is_found(solver, local, kept):
    upper, whole = chain()
    opened = linear_solver(solver)
    assert opened.factorise_definite(upper, 0)
    place = np.arange(len(upper.indptr) - 1)
    shape = np.sin(np.pi * (place + 1) / (len(place) + 1))
    if local:
        shape = np.where((place >= 140) & (place <= 180), np.sin(np.pi * (place - 140) / 40.0), 0.0)
    image = whole @ shape
    times = lambda x: whole @ x - (1.0 - kept) * image * (image @ x) / (shape @ image)  # noqa: E731
    # a twentieth is asked for
    assert stays_definite(times, opened, len(place)) == (kept >= 0.05)


@both_solvers
@pytest.mark.parametrize("kept", [0.5, 0.06, 0.04, 1e-3, -1e-3, -1.0])
def test_several_shapes_that_have_lost_their_stiffness_are_found(solver, kept):
    # twenty shapes of the chain at once, by different shares
    upper, whole = chain()
    opened = linear_solver(solver)
    assert opened.factorise_definite(upper, 0)
    place, numbers = np.arange(400) + 1.0, np.arange(1, 21)
    shapes = np.sin(np.pi * np.outer(place, numbers) / 401.0)
    images = whole @ shapes
    lost = np.linspace(1.0, 0.5, 20) * (1.0 - kept) / (shapes * images).sum(axis=0)
    assert stays_definite(lambda x: whole @ x - images @ (lost * (images.T @ x)), opened, 400) == (kept >= 0.05)


@both_solvers
@pytest.mark.parametrize(("pushed", "holds"), [(0.5, True), (0.93, True), (0.97, False), (1.01, False), (3.0, False)])
def test_a_push_that_softens_every_shape_is_found(solver, pushed, holds):
    # a chain on which an even load acts: all eigenvalues sink by the same, and the first one is zero at a share of 1
    upper, whole = chain()
    opened = linear_solver(solver)
    assert opened.factorise_definite(upper, 0)
    lowest = 2.0 - 2.0 * math.cos(math.pi / 401.0)
    assert stays_definite(lambda x: whole @ x - pushed * lowest * x, opened, 400) == holds


@both_solvers
@pytest.mark.parametrize(("stiffness", "holds"), [(1.0, True), (0.2, True), (0.0, False), (-0.3, False)])
def test_springs_that_lost_their_stiffness_are_found(solver, stiffness, holds):
    # ten springs beside each other, as of ribs' elements that are pressed
    upper, whole = chain()
    opened = linear_solver(solver)
    assert opened.factorise_definite(upper, 0)
    ends = np.zeros((10, 400))
    ends[np.arange(10), 150 + np.arange(10)], ends[np.arange(10), 151 + np.arange(10)] = -1.0, 1.0
    times = lambda x: whole @ x - (1.0 - stiffness) * (ends.T @ (ends @ x))  # noqa: E731
    assert stays_definite(times, opened, 400) == holds


@both_solvers
def test_the_least_curvature_is_that_of_a_dense_solver(solver):
    upper, whole = chain(80)
    rng = np.random.default_rng(3)
    push = sp.diags_array(rng.uniform(0.0, 0.02, 80)).tocsr()
    exact = (upper - push).tocsr()
    opened = linear_solver(solver)
    assert opened.factorise_definite(upper, 0)
    curvature, way = least_curvature(exact, upper, opened)
    dense = (whole - push).toarray()
    lowest = scipy.linalg.eigh(dense, whole.toarray(), eigvals_only=True)[0]
    assert lowest < 0.0
    assert curvature == pytest.approx(lowest, rel=0.02)  # asked for to 1 %
    assert way @ dense @ way == pytest.approx(curvature * (way @ (whole @ way)), rel=0.02)


@pytest.mark.parametrize("kept", [0.9, -0.1])
def test_superlu_does_not_take_exchanged_rows_for_a_definite_matrix(kept):
    # eigenvalues of about 1 and -1, with tiny pivots that leave the diagonal
    upper = sp.csr_array(np.array([[1e-9, 1.0], [0.0, 1e-9 * kept]]))
    assert not linear_solver("superlu").factorise_definite(upper, 0)
