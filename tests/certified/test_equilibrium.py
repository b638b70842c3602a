"""Newton's method, increments, ties and linear solvers on small blocks."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

from data_schemas import MissingExtraError, NoEquilibriumError, SimulateError
from sim.mechanics import Block, Cylinder, FingerMesh, LinearElastic, Ogden, PenaltyContact, Pose
from sim.mechanics import _assembly as assembly_module
from sim.mechanics import _increments as increments
from sim.mechanics import _newton as newton
from sim.mechanics._finger_mesh import TiedNodes
from sim.mechanics._increments import Load, State, load_increments
from sim.mechanics._increments import _Search as _IncrementSearch
from sim.mechanics._linear_solver import UpperBlocks, linear_solver, refined
from sim.mechanics._loads import DeadForce
from sim.mechanics._materials import neo_hooke
from sim.mechanics._mesh import Tie
from sim.mechanics._newton import (
    Equilibrium,
    NewtonOptions,
    Supports,
    _nearer_to_least,
    _Search,
    _Trial,
    find_equilibrium,
)
from tests.certified.blocks import GridBlock, assemble, press, unit_cells

GEL = neo_hooke(0.1333)
TPU = Ogden((6.279, 1.639), (1.6663, -7.136))
both_solvers = pytest.mark.parametrize("solver", ["pardiso", "superlu"])


def sheared_beam(length_mm=6.0):
    """A TPU beam whose far end is displaced across, its ends held; the supports at a share of 2 mm."""
    cells = unit_cells(6, 2, 2, size=(length_mm, 2.0, 2.0))
    assembly = assemble(cells.mesh("incompatible_modes"), TPU)
    ends = cells.numbers[[0, -1]].ravel()
    fixed = Supports.at_rest(assembly.count, ends).fixed

    def loading(fraction):
        move = np.zeros((assembly.count, 3))
        move[cells.numbers[-1].ravel(), 1] = 2.0 * fraction
        return Supports(fixed, move)

    return cells, assembly, loading


def test_work_of_the_supports_is_the_energy():
    cells, assembly, loading = sheared_beam()
    end = cells.numbers[-1].ravel()
    path = press(assembly, loading, np.linspace(0.05, 1.0, 20))
    force = np.array([0.0] + [e.gradient_n[end, 1].sum() for e in path])
    work = 2.0 * np.trapezoid(force, dx=0.05)
    # trapezoids of 20 steps of a force that grows nearly linearly
    assert path[-1].energy_n_mm == pytest.approx(work, rel=1e-3)
    balance = path[-1].gradient_n.sum(axis=0)
    assert np.abs(balance).max() <= 1e-6 * force[-1]


@both_solvers
def test_release_returns_to_rest(solver):
    _, assembly, loading = sheared_beam()
    path = press(assembly, loading, (0.5, 1.0, 0.5, 0.0), solver=solver)
    assert np.abs(path[1].state.u_mm).max() >= 2.0
    assert np.abs(path[-1].state.u_mm).max() <= 1e-6
    assert path[2].state.u_mm == pytest.approx(path[0].state.u_mm, abs=1e-6)


def test_release_from_contact_returns_to_rest():
    cells = GridBlock(np.linspace(0, 4, 3), np.linspace(0, 2, 3), np.linspace(-4, 4, 9))
    contact = PenaltyContact(cells.nodes_mm, cells.top_quads(), Cylinder(10.0), Pose((2.0, 12.0, 0.0)), 20.0)
    assembly = assemble(cells.mesh("mean_dilatation"), GEL, [contact])
    held = Supports.at_rest(assembly.count, cells.numbers[:, 0].ravel())

    def loading(fraction):
        contact.place(Pose((2.0, 12.01 - 0.5 * fraction, 0.0)))
        return held

    path = press(assembly, loading, (0.5, 1.0, 0.0))
    assert path[1].energy_n_mm > 0.01
    assert np.abs(path[-1].state.u_mm).max() <= 1e-6


def test_newton_converges_quadratically():
    _, assembly, loading = sheared_beam()
    reached = find_equilibrium(assembly, assembly.at_rest(), loading(0.5), linear_solver())
    r = np.array(reached.residuals_n)
    assert not reached.failure
    # each residual near the end is at most the square of the one before, up to a constant
    assert r[-1] <= 1e-3 * r[-2] <= 1e-4 * r[-3]
    assert len(r) <= 10


def test_a_whole_step_is_assembled_once_and_not_evaluated_before(monkeypatch):
    _, assembly, loading = sheared_beam()
    evaluate, levels = assembly_module.many_hexahedra, []

    def counted(*given):
        levels.append(given[7])
        return evaluate(*given)

    monkeypatch.setattr(assembly_module, "many_hexahedra", counted)
    reached = find_equilibrium(assembly, assembly.at_rest(), loading(0.5), linear_solver())
    assert not reached.failure
    # the energies of the start and of the step that moves the supports; then each state of the search, once
    assert levels.count(0) <= 2
    assert levels.count(1) == len(reached.residuals_n)
    rest = assemble(assembly.elasticity.mesh, TPU)
    gradient, _ = rest.assemble(reached.state)
    assert gradient == pytest.approx(reached.gradient_n, abs=1e-9)


def test_a_search_goes_on_with_the_elements_and_the_factors_of_before(monkeypatch):
    # as where friction's limits are renewed at an equilibrium: nothing but a term has changed
    _, assembly, loading = sheared_beam()
    pull = DeadForce(np.arange(assembly.count // 2))
    assembly.terms = (pull,)
    supports, solver = loading(0.5), linear_solver()
    before = find_equilibrium(assembly, assembly.at_rest(), supports, solver)
    pull.force_n[:] = (0.0, 1e-3, 0.0)
    evaluate, levels, factorised = assembly_module.many_hexahedra, [], []

    def counted(*given):
        levels.append(given[7])
        return evaluate(*given)

    monkeypatch.setattr(assembly_module, "many_hexahedra", counted)
    factorise = solver.factorise_definite
    monkeypatch.setattr(solver, "factorise_definite", lambda *given: factorised.append(1) or factorise(*given))
    further = find_equilibrium(assembly, before.state, supports, solver, after=before)
    assert not further.failure
    assert further.iterations > 0
    # the state that the search goes on from has been evaluated
    assert len(levels) == len(further.residuals_n) - 1
    assert not factorised
    afresh = find_equilibrium(assembly, before.state, supports, linear_solver())
    assert further.state.u_mm == pytest.approx(afresh.state.u_mm, abs=1e-7)
    assert np.abs(further.state.u_mm - before.state.u_mm).max() > 1e-5


class SideSprings:
    """Springs that hold every node where it is across an axis."""

    def __init__(self, stiffness_n_per_mm):
        self.stiffness_n_per_mm = stiffness_n_per_mm

    def energy(self, u_mm):
        return 0.5 * self.stiffness_n_per_mm * float((u_mm[:, 1:] ** 2).sum())

    def gradient(self, u_mm):
        force = np.zeros_like(u_mm)
        force[:, 1:] = self.stiffness_n_per_mm * u_mm[:, 1:]
        return force

    def hessian(self, u_mm, project):
        diagonal = np.zeros(u_mm.shape)
        diagonal[:, 1:] = self.stiffness_n_per_mm
        return sp.diags_array(diagonal.ravel()).tocoo()

    def max_step(self, u_mm, du_mm):
        return 1.0


def test_a_search_that_goes_on_is_tested_by_the_terms_as_they_are():
    # past Euler's load, and straight: only the springs keep it so
    cells = unit_cells(12, 2, 2, size=(24.0, 1.0, 1.2))
    assembly = assemble(cells.mesh("incompatible_modes", cells.nodes_mm), LinearElastic(1000.0, 0.3))
    springs = SideSprings(5.0)
    assembly.terms = (springs,)
    move = np.zeros((assembly.count, 3))
    move[cells.numbers[-1].ravel(), 0] = -0.5
    supports = Supports(Supports.at_rest(assembly.count, cells.numbers[[0, -1]].ravel()).fixed, move)
    solver = linear_solver()
    held = find_equilibrium(assembly, assembly.at_rest(), supports, solver)
    held = find_equilibrium(assembly, held.state, supports, solver)  # factorised here
    springs.stiffness_n_per_mm = 0.0
    released = find_equilibrium(assembly, held.state, supports, solver, after=held)
    assert not released.failure
    # the straight column's energy is twice that of the arch
    assert released.energy_n_mm < 0.6 * held.energy_n_mm
    assert np.abs(released.state.u_mm[:, 1:]).max() > 1.0


def test_a_column_buckles():
    # far past Euler's load, where the exact tangent has negative curvature, from a crookedness of a hundredth
    cells = unit_cells(12, 2, 2, size=(24.0, 1.0, 1.2))
    x = cells.nodes_mm.copy()
    x[:, 1] += 0.01 * (1.0 - np.cos(2 * np.pi * x[:, 0] / 24.0))
    assembly = assemble(cells.mesh("incompatible_modes", x), LinearElastic(1000.0, 0.3))
    fixed = Supports.at_rest(assembly.count, cells.numbers[[0, -1]].ravel()).fixed

    def loading(fraction):
        move = np.zeros((assembly.count, 3))
        move[cells.numbers[-1].ravel(), 0] = -fraction
        return Supports(fixed, move)

    path = press(assembly, loading, np.linspace(0.25, 1.0, 4))
    # where Newton's step leads uphill the other way is downhill: with curvature projected in its place it takes 24
    assert sum(e.iterations for e in path) <= 20
    sideways = path[-1].state.u_mm[cells.numbers[6].ravel(), 1].mean()
    # a clamped cosine arch that is d shorter has an amplitude of 2 sqrt(d L) / pi, less Euler's shortening
    # pi^2 h^2 / 3 L = 0.14 mm and a few per cent of the curve's higher order
    assert sideways == pytest.approx(2 * math.sqrt(24.0 * (1.0 - 0.14)) / math.pi, rel=0.05)


def test_a_shortened_step_goes_near_to_the_least_energy_along_it():
    def trial(share):
        asked.append(share)
        return _Trial(share, 7.0 + energy(share), SimpleNamespace(), energy(share))

    # what sticks and then slides, or bends and then stretches: steep beyond its least
    for energy, least in ((lambda t: -t + 50.0 * t**4, 200.0 ** (-1 / 3)), (lambda t: -t + 3.0 * t**2 + t**3, 0.1547)):
        asked = []
        first, refused = trial(0.02), trial(1.0)
        found = _nearer_to_least(trial, 7.0, -1.0, first, refused)
        assert len(asked) <= 2 + 3
        assert energy(found.share) <= 0.8 * energy(
            least
        )  # four fifths of the greatest fall; two fifths or less at first
        assert energy(first.share) >= 0.4 * energy(least)
    # a state that is not allowed has no energy: halves
    wall = _nearer_to_least(
        lambda t: trial(t) if t < 0.4 else _Trial(t, math.inf, None, math.inf),
        7.0,
        -1.0,
        first,
        _Trial(1.0, math.inf, None, math.inf),
    )
    assert 0.02 < wall.share < 0.4


def test_an_increment_too_large_is_cut_back():
    _, assembly, loading = sheared_beam()
    options = NewtonOptions(iterations=3)
    path = list(load_increments(assembly, linear_solver(), Load(loading), (1.0,), options=options))
    fractions = [i.fraction for i in path]
    assert len(fractions) > 1
    assert fractions[-1] == 1.0
    whole = press(assembly, loading)[-1]
    assert path[-1].equilibrium.state.u_mm == pytest.approx(whole.state.u_mm, abs=1e-5)


def test_a_search_in_short_steps_is_given_up_and_each_iteration_and_cutback_is_told():
    _, assembly, loading = sheared_beam()
    told = []
    # steps of at most 5 um of 2 mm: eight of them are no whole one
    options = NewtonOptions(longest_step_mm=0.005, tell=told.append)
    path = load_increments(assembly, linear_solver(), Load(loading), (1.0,), shortest_share=0.5, options=options)
    with pytest.raises(NoEquilibriumError, match="no equilibrium after 50 iterations"):
        list(path)
    first = [line for line in told if line.startswith("iteration ")][:9]
    assert [line.split(",")[0] for line in first] == [f"iteration {n}" for n in (*range(1, 9), 1)]
    assert all(" out of balance by " in line and line.endswith(" N allowed") for line in first)
    cut = [line for line in told if line.startswith("increment shortened from 1 to 0.5: ")]
    assert len(cut) == 1
    assert "the last 8 of 8 steps add up to only" in cut[0]


@pytest.mark.parametrize(
    ("residuals", "wanders"),
    [
        ([2000.0, 80.0, 110.0, 90.0, 60.0, 120.0, 85.0, *[70.0, 90.0, 40.0, 90.0, 110.0, 50.0, 60.0, 90.0]], True),
        ([2000.0, 80.0, 110.0, 90.0, 60.0, 120.0, 85.0, *[70.0, 90.0, 29.0, 90.0, 110.0, 50.0, 60.0, 90.0]], False),
        ([2000.0, 3.0, 0.6, 0.5, 0.4, 0.5, 0.4, *[0.6, 0.5, 0.4, 0.6, 0.5, 0.4, 0.6, 0.5]], False),  # soft, and near
        ([2000.0, *[90.0] * 12], False),  # too early to tell
    ],
)
def test_a_search_that_comes_no_nearer_is_given_up(residuals, wanders):
    _, assembly, loading = sheared_beam()
    search = _Search(assembly, loading(1.0), linear_solver(), NewtonOptions())
    search.residuals, search.removals = residuals, [0.0] * len(residuals)
    search.solved = len(residuals)
    assert bool(search.given_up()) == wanders
    if wanders:
        assert search.given_up() == "the forces are 40 N out of balance after 15 iterations, no closer than before"
    patient = _Search(assembly, loading(1.0), linear_solver(), NewtonOptions(stalled_after=0))
    patient.residuals, patient.removals = residuals, [0.0] * len(residuals)
    patient.solved = len(residuals)
    assert not patient.given_up()


@pytest.mark.parametrize(("iterations", "searches"), [(9, 2), (10, 1)])
def test_after_a_long_search_from_a_guess_half_the_way_is_gone(monkeypatch, iterations, searches):
    _, assembly, loading = sheared_beam()
    rest, begun = assembly.at_rest(), []

    def failing(assembly, state, *_):
        begun.append(state)
        return Equilibrium(state, np.zeros_like(state.u_mm), 0.0, (1.0,), "no equilibrium", iterations)

    monkeypatch.setattr(increments, "find_equilibrium", failing)
    search = _IncrementSearch(assembly, linear_solver(), Load(loading), NewtonOptions())
    guess = assembly.at_rest()
    assert search.equilibrium(rest, guess, 1.0, loading(1.0), last=False).failure
    assert [state is guess for state in begun] == [True, False][:searches]
    begun.clear()
    # the last try is patient
    assert search.equilibrium(rest, guess, 1.0, loading(1.0), last=True).failure
    assert [state is guess for state in begun] == [True, False, False]


@pytest.mark.parametrize(
    ("solved", "last", "over"),
    [(24, 0.5, False), (25, 0.5, True), (25, 0.04, False), (49, 0.04, False), (50, 0.04, True)],
)
def test_a_search_that_half_the_way_may_ease_ends_sooner_unless_it_arrives(solved, last, over):
    _, assembly, loading = sheared_beam()
    search = _Search(assembly, loading(1.0), linear_solver(), NewtonOptions(patience=25))
    search.solved, search.residuals, search.removals = solved, [1.0, 0.5, last], [1.0] * 3
    assert bool(search.given_up()) == over


def test_only_the_last_try_of_an_increment_has_all_iterations(monkeypatch):
    _, assembly, loading = sheared_beam()
    patience = []

    def failing(assembly, state, supports, solver, options):
        patience.append(options.patience)
        return Equilibrium(state, np.zeros_like(state.u_mm), 0.0, (1.0,), "no equilibrium", 50)

    monkeypatch.setattr(increments, "find_equilibrium", failing)
    search = _IncrementSearch(assembly, linear_solver(), Load(loading), NewtonOptions())
    for last in (False, True):
        assert search.equilibrium(assembly.at_rest(), None, 1.0, loading(1.0), last=last).failure
    assert patience == [25, 50, 50]


@both_solvers
def test_a_search_near_a_saddle_ends_at_a_least_energy(solver):
    # a straight column past Euler's load is in equilibrium, and buckles at the least touch: Newton's step by the exact
    # tangent, of negative curvature there, leads back to the straight one
    cells = unit_cells(12, 2, 2, size=(24.0, 1.0, 1.2))
    assembly = assemble(cells.mesh("incompatible_modes"), LinearElastic(1000.0, 0.3))
    supports = Supports.at_rest(assembly.count, cells.numbers[[0, -1]].ravel())
    supports.displacement_mm[cells.numbers[-1].ravel(), 0] = -1.0
    x, u = cells.nodes_mm, np.zeros((assembly.count, 3))
    u[:, 0] = -x[:, 0] / 24.0
    u[:, 1] = 0.02 * (1.0 - np.cos(2 * np.pi * x[:, 0] / 24.0)) * ~supports.fixed[:, 1]
    reached = find_equilibrium(
        assembly, State(u, assembly.elasticity.no_modes), supports, linear_solver(solver), NewtonOptions()
    )
    assert not reached.failure
    sideways = reached.state.u_mm[cells.numbers[6].ravel(), 1].mean()
    # see the column that buckles
    assert abs(sideways) == pytest.approx(2 * math.sqrt(24.0 * (1.0 - 0.14)) / math.pi, rel=0.05)
    assembly.assemble(reached.state)
    assembly.matrix.constrain(supports.fixed.ravel())
    upper = assembly.matrix.upper()
    assert np.linalg.eigvalsh((upper + sp.triu(upper, 1).T).toarray()).min() > 0.0


def test_a_watch_ends_a_press_before_the_iteration_that_would_take_too_long(monkeypatch):
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(increments, "time", SimpleNamespace(process_time=lambda: clock.now_s))
    told = []
    watch = increments.Watch(lambda *at: told.append(at), 4, 10.0)
    watch.tell("iteration 1")
    watch.reached(1, "pressed to 1 mm")
    clock.now_s = 4.0
    watch.tell("iteration 1")
    assert watch.left_s == 6.0
    clock.now_s = 8.5
    with pytest.raises(
        NoEquilibriumError, match=r"budget of 10 s of processor time is spent \(8\.5 s; the last iteration took 4\.5 s"
    ):
        watch.tell("iteration 2")
    assert told == [
        (0, 4, "iteration 1"),
        (1, 4, "pressed to 1 mm"),
        (1, 4, "pressed to 1 mm, iteration 1"),
        (1, 4, "pressed to 1 mm, iteration 2"),
    ]
    assert increments.Watch(None, 4).left_s is None


def test_increments_before_a_failure_are_kept():
    cells, assembly, _ = sheared_beam()
    ends = cells.numbers[[0, -1]].ravel()
    fixed = Supports.at_rest(assembly.count, ends).fixed

    def crush(fraction):
        move = np.zeros((assembly.count, 3))
        move[cells.numbers[-1].ravel(), 0] = -8.0 * fraction
        return Supports(fixed, move)

    kept = []
    with pytest.raises(SimulateError, match=r"no equilibrium was found beyond 0\.\d+ of the load: .+smaller load"):
        kept.extend(
            load_increments(assembly, linear_solver(), Load(crush), (0.2, 1.0), options=NewtonOptions(iterations=12))
        )
    assert 0.2 <= kept[-1].fraction < 0.75
    assert not kept[-1].equilibrium.failure


def test_a_start_inside_out_is_refused():
    _, assembly, loading = sheared_beam()
    state = assembly.at_rest()
    state.u_mm[:] = -2.0 * assembly.elasticity.mesh.nodes_mm * [1.0, 0.0, 0.0]
    reached = find_equilibrium(assembly, state, loading(0.0), linear_solver())
    assert "at the start an element is inside out, or a term is not defined" in reached.failure


class Wall:
    """A term that allows less than the whole step, like a collision-free step limit."""

    def __init__(self, limit_mm):
        self.limit_mm, self.asked = limit_mm, 0

    def energy(self, u):
        return math.inf if u[:, 1].max() > self.limit_mm else 0.0

    def gradient(self, u):
        return np.zeros_like(u)

    def hessian(self, u, project):
        return sp.coo_array((u.size, u.size))

    def max_step(self, u, du):
        self.asked += 1
        reach = (u + du)[:, 1].max()
        return 1.0 if reach <= self.limit_mm else 0.5


def test_a_term_limits_the_step_of_the_supports():
    _, assembly, loading = sheared_beam()
    assembly.terms = (Wall(1.2),)
    reached = find_equilibrium(assembly, assembly.at_rest(), loading(0.5), linear_solver())
    assert not reached.failure
    assembly.terms = (Wall(0.7),)
    stopped = find_equilibrium(assembly, assembly.at_rest(), loading(0.5), linear_solver())
    assert stopped.failure
    assert stopped.state.u_mm[:, 1].max() <= 0.7


def tied_blocks(lower_cells, upper_cells):
    """A block of cubic cells on another one, tied at their common face."""
    lower, upper = unit_cells(*lower_cells), unit_cells(*upper_cells)
    shift = len(lower.nodes_mm)
    nodes = np.vstack([lower.nodes_mm, upper.nodes_mm + np.array([0.0, 1.0, 0.0])])
    blocks = (
        Block("lower", lower.hexahedra, "material", "mean_dilatation"),
        Block("upper", upper.hexahedra + shift, "material", "mean_dilatation"),
    )
    tie = Tie(upper.numbers[:, 0].ravel() + shift, lower.top_quads())
    return FingerMesh(nodes, blocks, {}, {}, (tie,)), tie


def shear_force(mesh, terms):
    x = mesh.nodes_mm
    assembly = assemble(mesh, GEL, terms)
    top = x[:, 1] == 2.0
    fixed = np.repeat(((x[:, 1] == 0.0) | top)[:, None], 3, axis=1)
    reached = press(assembly, lambda f: Supports(fixed, 0.4 * f * top[:, None] * [1.0, 0.0, 0.0]))[-1]
    return reached.gradient_n[top, 0].sum(), reached.state.u_mm


def test_tied_blocks_act_as_one():
    one, _ = shear_force(unit_cells(3, 6, 3, size=(1.0, 2.0, 1.0)).mesh("mean_dilatation"), [])
    mesh, tie = tied_blocks((3, 3, 3), (3, 3, 3))
    term = TiedNodes(mesh.nodes_mm, tie, 1e4)
    tied, u = shear_force(mesh, [term])
    # the penalty's gap is the force of a node over k
    assert tied == pytest.approx(one, rel=1e-4)
    assert 0.0 < np.abs(term.gaps_mm(u)).max() <= one / 1e4
    mesh, tie = tied_blocks((3, 3, 3), (4, 3, 4))
    unlike, _ = shear_force(mesh, [TiedNodes(mesh.nodes_mm, tie, 1e4)])
    # the finer upper half is a little softer; forces that no tie passes on would cost a third
    assert unlike == pytest.approx(one, rel=0.02)


def test_derivatives_of_a_tie():
    mesh, tie = tied_blocks((3, 2, 3), (4, 2, 4))
    term = TiedNodes(mesh.nodes_mm, tie, 50.0)
    u = np.random.default_rng(0).standard_normal(mesh.nodes_mm.shape)
    slope = term.hessian(u, False) @ u.ravel()
    assert term.gradient(u).ravel() == pytest.approx(slope, abs=1e-11)  # quadratic energy
    assert term.energy(u) == pytest.approx(0.5 * slope @ u.ravel(), rel=1e-12)
    assert term.gradient(u).sum(axis=0) == pytest.approx(0.0, abs=1e-11)
    assert term.max_step(u, u) == 1.0


def test_a_node_off_the_faces_cannot_be_tied():
    mesh, tie = tied_blocks((3, 2, 3), (4, 2, 4))
    nodes = mesh.nodes_mm.copy()
    nodes[tie.slave_nodes[3], 1] += 0.2
    with pytest.raises(SimulateError, match=r"node \d+ at .* cannot be tied, because it lies 0\.2 mm off"):
        TiedNodes(nodes, tie, 1.0)


def random_system(seed, extra=()):
    """A symmetric positive definite matrix on the pattern of four nodes in a row, with some further couplings."""
    rng = np.random.default_rng(seed)
    cells = np.array([[0, 1, 2], [3, 2, 1]])
    pattern = UpperBlocks(4, [cells])
    blocks = rng.standard_normal((2, 9, 9))
    blocks = blocks @ blocks.transpose(0, 2, 1) + np.eye(9)
    pattern.add_cells(cells, pattern.slots(cells), blocks)
    dense = np.zeros((12, 12))
    for cell, block in zip(cells, blocks, strict=True):
        at = (3 * cell[:, None] + np.arange(3)).ravel()
        dense[np.ix_(at, at)] += block
    return pattern, dense


def whole(pattern):
    upper = pattern.upper().toarray()
    return upper + np.triu(upper, 1).T


def test_scatter_sum_and_product():
    pattern, dense = random_system(0)
    assert whole(pattern) == pytest.approx(dense, abs=1e-13)
    v = np.arange(12.0)
    assert pattern.times(v) == pytest.approx(dense @ v, abs=1e-11)
    # a vector in single precision is not summed in it
    v = np.linspace(0.1, 1.2, 12, dtype=np.float32)
    assert pattern.times(v) == pytest.approx(dense @ v.astype(np.float64), abs=1e-11)


def test_the_pattern_grows_where_a_term_needs_it():
    pattern, dense = random_system(1)
    far = sp.coo_array(([2.0, 2.0, 0.5, 0.5], ([0, 11, 4, 4], [11, 0, 4, 4])), shape=(12, 12))
    pattern.add_sparse(far)
    assert pattern.version == 1
    assert whole(pattern) == pytest.approx(dense + far.toarray(), abs=1e-13)
    pattern.add_sparse(far)
    assert pattern.version == 1
    pattern.constrain(np.arange(12) < 3)
    held = whole(pattern)
    assert np.array_equal(held[:3], np.eye(12)[:3])
    assert held[3:, 3:] == pytest.approx(dense[3:, 3:] + 2 * far.toarray()[3:, 3:], abs=1e-13)


@both_solvers
def test_linear_solvers_agree_with_a_dense_one(solver):
    opened = linear_solver(solver)
    right = np.arange(12.0)
    for seed in range(3):
        pattern, dense = random_system(seed)
        opened.factorise(pattern.upper(), pattern.version)
        assert opened.solve(right) == pytest.approx(np.linalg.solve(dense, right), rel=1e-9)


@both_solvers
@pytest.mark.parametrize(("change", "products"), [(0.0, 1), (1e-3, 3), (10.0, 4)])
def test_old_factors_are_tried_as_long_as_they_lead_there(solver, change, products):
    """A matrix near the factorised one is solved with; one far off is given up at the rate of the first four tries."""
    pattern, dense = random_system(0)
    opened = linear_solver(solver)
    opened.factorise(pattern.upper(), pattern.version)
    near = dense + change * np.diag(np.linspace(0.0, 1.0, 12) ** 3) * np.abs(np.diag(dense)).max()
    asked = []

    def times(vector):
        asked.append(vector)
        return near @ vector

    found = refined(times, opened, np.arange(12.0), 1e-6, 6)
    assert len(asked) <= products
    assert (found is None) == (change == 10.0)
    if found is not None:
        assert near @ found == pytest.approx(np.arange(12.0), abs=1e-4)


@pytest.mark.parametrize(("balanced", "tried"), [(0.04, True), (0.06, False)])
def test_old_factors_are_tried_near_to_balance_only(monkeypatch, balanced, tried):
    # further off, places come to touch or part, and solutions with old factors lead nowhere
    _, assembly, loading = sheared_beam()
    search = _Search(assembly, loading(1.0), linear_solver(), NewtonOptions(residual_rel=1e-6))
    asked = []
    monkeypatch.setattr(newton, "refined", lambda *_: asked.append(True))
    search.factors, search.bar_n, search.residuals = assembly.matrix.version, 1e-6 * 5.0, [100.0, balanced * 5.0]
    with_old_factors = search._with_old_factors  # noqa: SLF001 - a search shows it only by its time
    with_old_factors(np.ones(3 * assembly.count))
    assert bool(asked) == tried


@both_solvers
def test_solving_needs_a_matrix(solver):
    with pytest.raises(SimulateError, match="call factorise first"):
        linear_solver(solver).solve(np.ones(3))


def test_a_singular_matrix_is_named():
    with pytest.raises(SimulateError, match="singular: some part can move freely"):
        linear_solver("superlu").factorise(sp.csr_array(np.zeros((3, 3)) + np.diag([1.0, 1.0, 0.0])), 0)


@both_solvers
def test_a_singular_matrix_is_not_positive_definite(solver):
    # a rigid body without contact: nothing resists its move
    opened, unit = linear_solver(solver), np.diag([1.0, 1.0, 1.0])
    assert opened.factorise_definite(sp.csr_array(unit), 0)
    free = sp.csr_array(unit)
    free.data[2] = 0.0
    assert not opened.factorise_definite(free, 0)


def test_without_pardiso_superlu_takes_over(monkeypatch):
    monkeypatch.setitem(sys.modules, "pypardiso", None)
    assert type(linear_solver()).__name__ == "SuperLU"
    with pytest.raises(MissingExtraError, match=r"needs pypardiso.*choose superlu elsewhere"):
        linear_solver("pardiso")


def test_the_modes_of_each_element_follow_a_displacement_by_themselves():
    cells = unit_cells(1, 2, 8, size=(1.0, 1.0, 8.0))
    elasticity = assemble(cells.mesh("incompatible_modes"), Ogden((6.279, 1.639), (1.6663, -7.136), 26.0)).elasticity
    u = np.zeros_like(cells.nodes_mm)
    u[:, 1] = 0.02 * cells.nodes_mm[:, 2] ** 2
    u[:, 2] = -0.04 * cells.nodes_mm[:, 2] * cells.nodes_mm[:, 1]
    far = tuple(m + 0.05 for m in elasticity.no_modes)

    def unbalanced(modes):
        list(elasticity.matrices(u, modes))
        return elasticity.mode_residual_n()

    relaxed = elasticity.relaxed(u, far)
    # three steps of Newton's method on nine unknowns in each element
    assert unbalanced(relaxed) < 1e-2 * unbalanced(far)
    assert elasticity.energy(u, relaxed) < elasticity.energy(u, far)
