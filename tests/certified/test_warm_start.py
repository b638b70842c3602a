"""Starts that save iterations, failures that are cut back, and a press that goes on from a stored increment."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from data_schemas import Indenter, PressIncrement, PressMechanics, SimulateError
from data_schemas.storage import read_record
from sim import preset_design
from sim.experiments import increment_record, stored_press
from sim.mechanics import STEPS, PressSettings, finger_materials, finger_mesh, press_finger
from sim.mechanics._assembly import Assembly, Elasticity
from sim.mechanics._finger_mesh import MeshSteps, finger_ties
from sim.mechanics._increments import CoarserPath, Interpolation, Load, Watch, load_increments
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._materials import neo_hooke
from sim.mechanics._mesh import CornerGrading
from sim.mechanics._newton import Supports
from sim.mechanics._penalty_contact import PenaltyContact, PenaltyPress
from sim.mechanics._press import _first_on_coarse, press_contact
from tests.certified.blocks import assemble, unit_cells
from tests.command_line.running import finray, succeed

SMALL = preset_design("baby-48x18")
PLAN = (
    'preset = "flat-70x35"\nname = "small"\n'
    "[pad]\nlength_mm = 48.0\nwidth_mm = 18.0\nfilm = {}\n[indenter]\nposition_mm = 24.0\n"
)
LONGEST_S = 900.0


def to_depth(depth_mm):
    return SMALL.model_copy(update={"indenter": SMALL.indenter.model_copy(update={"depth_mm": depth_mm})})


@pytest.fixture(scope="module")
def halfway():
    return press_finger(to_depth(1.0), PressSettings("coarse", 2))


class Faulty:
    """A solver whose first factorisations fail."""

    def __init__(self, failures):
        self._solver, self.left, self.asked = linear_solver(), failures, 0

    def factorise(self, upper, pattern):
        self.asked += 1
        if self.left:
            self.left -= 1
            raise SimulateError("the stiffness matrix is singular")
        self._solver.factorise(upper, pattern)

    def factorise_definite(self, upper, pattern):
        self.factorise(upper, pattern)
        return True

    def solve(self, right_side):
        return self._solver.solve(right_side)


def sheared_block():
    cells = unit_cells(2, 2, 2)
    assembly = assemble(cells.mesh("mean_dilatation"), neo_hooke(0.1333))
    top = cells.numbers[:, -1].ravel()
    fixed = Supports.at_rest(assembly.count, np.concatenate([cells.numbers[:, 0].ravel(), top])).fixed

    def loading(fraction):
        move = np.zeros((assembly.count, 3))
        move[top, 0] = 0.3 * fraction
        return Supports(fixed, move)

    return assembly, loading


def test_a_failed_factorisation_is_cut_back():
    # the supports' step fails with the exact tangent, then without negative curvature: the increment is halved
    assembly, loading = sheared_block()
    path = list(load_increments(assembly, Faulty(2), Load(loading), (1.0,)))
    assert [step.fraction for step in path] == [0.5, 1.0]
    assembly, loading = sheared_block()
    # one failure: the projected tangent leads on, with no cutback
    assert [step.fraction for step in load_increments(assembly, Faulty(1), Load(loading), (1.0,))] == [1.0]
    with pytest.raises(
        SimulateError, match=r"no equilibrium was found beyond 0 of the load: the stiffness matrix is singular"
    ):
        list(load_increments(assembly, Faulty(10**6), Load(loading), (1.0,)))


def test_iterations_are_solved_systems_that_end_with_old_factors():
    assembly, loading = sheared_block()
    solver = Faulty(0)
    path = list(load_increments(assembly, solver, Load(loading), (0.5, 1.0)))
    # the last steps of a search, where the tangent stands still, factorise nothing
    assert len(path) <= solver.asked < sum(step.equilibrium.iterations for step in path)
    for step in path:
        assert step.equilibrium.iterations == len(step.equilibrium.residuals_n) - 1


def test_displacements_move_to_another_mesh():
    coarse, other = (
        finger_mesh(SMALL, "coarse"),
        finger_mesh(SMALL, steps=MeshSteps(2.6, 1.4, 1.9, 1.9, CornerGrading(0.4, 1.5))),
    )
    slope = np.array([[0.1, 0.2, 0.0], [0.0, 0.3, 0.1], [0.2, 0.0, -0.1]])
    moved = Interpolation(coarse, other)(coarse.nodes_mm @ slope)
    # trilinear hexahedra hold a linear field exactly
    assert moved == pytest.approx(other.nodes_mm @ slope, abs=1e-11)
    with pytest.raises(SimulateError, match=r"mesh of the same finger, but the point .* lies outside the other mesh"):
        Interpolation(coarse, finger_mesh(preset_design("flat-70x35"), "coarse"))
    with pytest.raises(SimulateError, match=r"mesh of the same finger, but backing is a part of only one"):
        Interpolation(coarse, finger_mesh(preset_design("original-60x22"), "coarse"))


def test_a_guess_from_another_mesh_takes_few_iterations():
    """Elements find their incompatible modes first; without that this search takes 14 steps."""
    design = preset_design("flat-70x35")
    design = design.model_copy(update={"indenter": design.indenter.model_copy(update={"depth_mm": 2.0})})
    coarse = press_finger(design, PressSettings("coarse", 1))
    steps = replace(STEPS["medium"], pad_mm=2.0, pad_layer_mm=2.0)
    mesh = finger_mesh(design, steps=steps)
    touch = press_contact(design, mesh, steps.pad_mm, "penalty")
    parts = [*touch.terms, *finger_ties(design, mesh, steps.skeleton_mm)]
    assembly = Assembly(Elasticity(mesh, finger_materials(design), 1), parts)
    path = CoarserPath(coarse.mesh, mesh, np.ones(1), coarse.displacement_mm)
    found = list(load_increments(assembly, linear_solver(), Load(lambda s: touch.push(2.0 * s)), (1.0,), predict=path))
    assert found[-1].equilibrium.iterations <= 8
    assert np.abs(touch.force_n(found[-1].equilibrium.state.u_mm)[1] / coarse.force_n[-1, 1] - 1.0) < 0.05


def test_a_start_saves_iterations(halfway):
    started = press_finger(to_depth(1.0), PressSettings("coarse", 2), start=halfway)
    # its own path, but for the incompatible modes: the first increment has little left to do
    assert started.iterations[0] <= halfway.iterations[0] - 3
    assert started.force_n == pytest.approx(halfway.force_n, abs=1e-5 * halfway.force_n[-1, 1])


def test_a_press_starts_from_what_touches_after_a_tenth_of_the_way(halfway, monkeypatch):
    monkeypatch.setattr(PenaltyPress, "hold", lambda *_: False)
    plain = press_finger(to_depth(0.5), PressSettings("coarse", 1))
    assert halfway.iterations[0] <= plain.iterations[0] - 2
    assert halfway.force_n[0] == pytest.approx(plain.force_n[0], abs=1e-5 * plain.force_n[0, 1])


@pytest.mark.parametrize("friction", [0.0, 0.3], ids=["smooth", "with friction"])
def test_the_curvature_of_a_sharp_edge_saves_iterations_near_the_equilibrium(friction, monkeypatch):
    edge = Indenter(
        shape="cuboid",
        size_mm=(10.0, 10.0, 10.0),
        edge_radius_mm=0.5,
        position_mm=24.0,
        rotation_deg=(25.0, 0.0, 20.0),
        depth_mm=2.0,
        friction=friction,
    )
    design, settings = SMALL.model_copy(update={"indenter": edge}), PressSettings("coarse", 2)
    pressed = press_finger(design, settings)
    monkeypatch.setattr(PenaltyContact, "approach", lambda _: None)
    plain = press_finger(design, settings)
    assert pressed.iterations.sum() <= plain.iterations.sum() - 4
    # friction is settled to a thousandth of the normal forces
    near_rel = 1e-3 if friction > 0.0 else 1e-5
    assert pressed.force_n == pytest.approx(plain.force_n, abs=near_rel * plain.force_n[-1, 1])


def test_a_finer_press_starts_from_the_first_increment_on_the_coarse_mesh(halfway, tmp_path):
    start = _first_on_coarse(to_depth(1.0), PressSettings("medium", 2), tmp_path, Watch(None, 2))
    assert start.depth_mm == pytest.approx([0.5])
    assert start.force_n[0] == pytest.approx(halfway.force_n[0], abs=1e-5)
    assert _first_on_coarse(to_depth(1.0), PressSettings("coarse", 2), tmp_path, Watch(None, 2)) is None
    assert (
        _first_on_coarse(to_depth(1.0), PressSettings("medium", 2, contact="barrier"), tmp_path, Watch(None, 2)) is None
    )
    # a coarse press that fails costs the finer one its start, no more
    assert _first_on_coarse(to_depth(0.0), PressSettings("medium", 2), tmp_path, Watch(None, 2)) is None


def test_a_stored_increment_must_fit(halfway):
    record = increment_record(to_depth(1.0), halfway, "coarse")
    assert stored_press(record, to_depth(3.0)).displacement_mm[-1] == pytest.approx(halfway.displacement_mm[-1])
    told = "at a push of 0.5 mm the search could not leave an unstable equilibrium"
    leaning = increment_record(to_depth(1.0), replace(halfway, unstable=told), "coarse")
    assert (record.unstable, stored_press(leaning, to_depth(3.0)).unstable) == ("", told)
    softer = to_depth(1.0).model_copy(update={"name": "another"})
    with pytest.raises(SimulateError, match=r"another design, which differs in name; only indenter\.depth_mm may"):
        stored_press(record, softer)
    moved = record.model_copy(update={"nodes_mm": record.nodes_mm + 0.1})
    with pytest.raises(SimulateError, match="has another mesh of this design"):
        stored_press(moved, to_depth(3.0))
    assert record.contact == "penalty"
    with pytest.raises(SimulateError, match=r"pressed with --contact penalty, but --contact barrier was given; give"):
        stored_press(record, to_depth(3.0), "barrier")
    of_older_version = record.model_copy(update={"contact": None})
    assert stored_press(of_older_version, to_depth(3.0), "penalty").kind == "unknown"
    with pytest.raises(SimulateError, match=r"has already reached 1 mm, but indenter\.depth_mm is only 0\.7 mm"):
        press_finger(to_depth(0.7), PressSettings("coarse", 2), resume=halfway)
    with pytest.raises(SimulateError, match="resume with the same design, mesh and --contact"):
        press_finger(preset_design("original-60x22"), PressSettings("coarse", 2), resume=halfway)


def test_an_increment_of_other_contact_points_is_not_continued(halfway):
    record = increment_record(to_depth(1.0), halfway, "coarse")
    assert (record.points_per_side, record.points_on_border) == (2, True)
    # the cylinder lies across the whole pad: its border touches, where older versions had no points
    older = {"points_per_side": None, "points_on_border": None}
    with pytest.raises(
        SimulateError,
        match=r"no point of the coat's border, which the indenter touches .* Press again from the beginning",
    ):
        stored_press(record.model_copy(update=older), to_depth(3.0))
    # a blunt ball amid the pad touches inner faces alone, whose points have stayed
    ball = SMALL.indenter.model_copy(update={"shape": "ball", "radius_mm": 6.0, "depth_mm": 0.4})
    design = SMALL.model_copy(update={"indenter": ball})
    pressed = press_finger(design, PressSettings("coarse", 1))
    record = increment_record(design, pressed, "coarse")
    deeper = design.model_copy(update={"indenter": ball.model_copy(update={"depth_mm": 0.6})})
    before = stored_press(record.model_copy(update=older), deeper)
    whole = press_finger(deeper, PressSettings("coarse", 3))
    assert press_finger(deeper, PressSettings("coarse", 3), resume=before).force_n[-1] == pytest.approx(
        whole.force_n[-1], abs=1e-5 * whole.force_n[-1, 1]
    )
    # the same ball, sharper than a face: 3 x 3 points now, 2 x 2 then
    sharp = design.model_copy(update={"indenter": ball.model_copy(update={"radius_mm": 1.0})})
    pressed = press_finger(sharp, PressSettings("coarse", 1))
    record = increment_record(sharp, pressed, "coarse")
    assert record.points_per_side == 3
    assert stored_press(record, sharp).depth_mm == pytest.approx([0.4])
    with pytest.raises(SimulateError, match=r"acted at 2 x 2 points of each face .* now acts at 3 x 3"):
        stored_press(record.model_copy(update=older), sharp)


def test_a_killed_press_goes_on(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "d.toml").write_text(PLAN + "depth_mm = 1.5\n")
    press = "simulate press d.toml --increments 3"
    command = [sys.executable, "-m", "finray_calib.cli.main", *press.split(), "--out", "cut.json"]
    killed = subprocess.Popen(command, env=os.environ)
    deadline = time.monotonic() + LONGEST_S
    first = tmp_path / "cut.increments" / "001.json"
    while not first.exists() and killed.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    assert not (tmp_path / "cut.mechanics.json").exists()
    assert read_record(tmp_path / "cut.increments" / "001.json", PressIncrement).depth_mm == pytest.approx([0.5])

    # --resume goes on from increments that lie elsewhere; the same command finds its own
    (tmp_path / "cut.increments").rename(tmp_path / "kept.increments")
    succeed(f"{press} --out moved.json --resume kept.increments")
    (tmp_path / "kept.increments").rename(tmp_path / "cut.increments")
    again = finray(f"{press} --out cut.json")
    assert again.status == 0
    assert "cut.increments: this press was interrupted; it continues after increment 00" in again.err
    succeed(f"{press} --out whole.json")
    cut, whole = (read_record(tmp_path / f"{name}.mechanics.json", PressMechanics) for name in ("cut", "whole"))
    assert cut.depth_mm == pytest.approx(whole.depth_mm, rel=1e-12)
    # both are equilibria to 1e-6 of their forces
    assert cut.force_n == pytest.approx(whole.force_n, abs=1e-5 * whole.force_n[-1, 1])

    (tmp_path / "empty").mkdir()
    nothing = finray(f"{press} --out other.json --resume empty")
    assert nothing.status == 2
    assert "holds no increment of a press" in nothing.err
    optical = finray("simulate render d.toml --resume cut.increments")
    assert optical.status == 2
    assert "finray simulate: error: 'finray simulate render' does not take --resume cut.increments" in optical.err


def test_friction_of_a_press_that_is_gone_on_with_is_nearly_what_it_was(monkeypatch):
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))
    aslant = {"friction": 0.5, "position_mm": 30.0, "rotation_deg": (20.0, 0.0, 10.0)}

    def design(depth_mm):
        return SMALL.model_copy(update={"indenter": SMALL.indenter.model_copy(update={**aslant, "depth_mm": depth_mm})})

    whole = press_finger(design(0.9), PressSettings("coarse", 3))
    first = press_finger(design(0.6), PressSettings("coarse", 2))
    again = press_finger(design(0.9), PressSettings("coarse", 3), resume=first)
    assert whole.kind == again.kind == "penalty"
    # anchors are not stored but taken from one straight way: a measured 0.9 % off; without any, 17 %
    off = np.linalg.norm(again.force_n[-1] - whole.force_n[-1])
    assert off < 0.03 * np.linalg.norm(whole.force_n[-1])
