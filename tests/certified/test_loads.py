"""Loads without an indenter, a press to a force, and the torque that a contact holds."""

import numpy as np
import pytest

from data_schemas import Indenter, NoEquilibriumError, SimulateError
from sim import preset_design
from sim.experiments import study_finger_stiffness
from sim.experiments._design_sensitivities import _held_torques, _row
from sim.experiments._mechanical_press import tipping_torque_n_mm
from sim.mechanics import (
    LinearElastic,
    LoadedFinger,
    PressSettings,
    contact_forces_n,
    frictionless_torque_n_mm,
    press_finger,
    press_to_force,
    slip_torque_n_mm,
)
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._loads import DeadForce
from sim.mechanics._newton import Supports, find_equilibrium
from tests.certified.blocks import assemble, unit_cells

SMALL = preset_design("baby-48x18")


@pytest.fixture(scope="module")
def finger():
    return LoadedFinger(SMALL, "coarse")


def test_a_force_bends_a_beam_as_timoshenko_says():
    length, height, width, modulus, poisson, force = 20.0, 1.0, 1.5, 1000.0, 0.3, 0.01
    cells = unit_cells(20, 2, 2, size=(length, height, width))
    end = cells.numbers[-1].ravel()
    assembly = assemble(
        cells.mesh("incompatible_modes"), LinearElastic(modulus, poisson), [DeadForce(end, (0.0, -force, 0.0))]
    )
    held = Supports.at_rest(assembly.count, cells.numbers[0].ravel())
    reached = find_equilibrium(assembly, assembly.at_rest(), held, linear_solver())
    inertia, shear = width * height**3 / 12.0, modulus / (2.0 * (1.0 + poisson))
    sag = force * length**3 / (3.0 * modulus * inertia) + force * length / (5.0 / 6.0 * shear * width * height)
    # the clamp, which lets nothing contract, and two elements through the height stiffen by about a per cent
    assert -reached.state.u_mm[end, 1].mean() == pytest.approx(sag, rel=0.02)
    base = reached.gradient_n[cells.numbers[0].ravel()].sum(axis=0)
    assert base == pytest.approx([0.0, force, 0.0], abs=1e-6 * force)
    # Clapeyron: the strain energy is half of the work of the force, so the whole is minus that
    assert reached.energy_n_mm == pytest.approx(-0.5 * force * sag, rel=0.02)


def test_displacements_are_reciprocal(finger):
    # Betti: the side moves under a force at the tip as the tip does under the same force at the side; forces so small
    # that the finger is linear
    force = (1e-3, 0.0, 0.0)
    side = finger.nodes_at("side", 1.0)
    by_tip, by_side = finger.push("tip", force), finger.push("side", force)
    there = by_tip.displacement_mm[side, 0].mean()
    back = by_side.displacement_mm[finger.mesh.node_sets["tip_end"], 0].mean()
    assert there == pytest.approx(back, rel=1e-4)
    assert by_tip.moved_mm[-1, 0] > there > 0.0


def test_a_twist_holds_its_balance(finger):
    turned = finger.twist(4.0, increments=2)
    mirrored = finger.twist(-4.0)
    # the finger is its own mirror image, and the twist one of its solutions whatever the increments
    assert mirrored.torque_n_mm[-1] == pytest.approx(-turned.torque_n_mm[-1], rel=1e-5)
    assert mirrored.stiffness_n_mm_per_deg == pytest.approx(turned.stiffness_n_mm_per_deg, rel=1e-5)
    assert turned.torque_n_mm[0] == pytest.approx(turned.torque_n_mm[1] / 2.0, rel=0.1)
    # nodes of the tip end keep their distances across the finger
    end = turned.mesh.node_sets["tip_end"]
    rest, now = turned.mesh.nodes_mm[end, :2], (turned.mesh.nodes_mm + turned.displacement_mm)[end, :2]
    assert np.linalg.norm(now - now[0], axis=1) == pytest.approx(np.linalg.norm(rest - rest[0], axis=1), abs=1e-9)


def test_wrong_loads_are_refused(finger):
    with pytest.raises(SimulateError, match="must be finite and not zero for a push"):
        finger.push("tip", (0.0, 0.0, 0.0))
    with pytest.raises(SimulateError, match="must be at most 90 deg to either side and not zero"):
        finger.twist(0.0)
    with pytest.raises(SimulateError, match="must be finite and above 0 N for a press"):
        press_to_force(SMALL, -1.0)
    rough = SMALL.model_copy(update={"indenter": SMALL.indenter.model_copy(update={"friction": 0.3})})
    with pytest.raises(
        SimulateError, match="with --force, the indenter must be a cylinder, ball or cuboid without friction"
    ):
        press_to_force(rough, 1.0)


def test_a_press_to_a_force_is_the_press_to_its_depth():
    driven = press_to_force(SMALL, 0.8, PressSettings("coarse", 1))
    depth = {"depth_mm": float(driven.depth_mm[-1])}
    design = SMALL.model_copy(update={"indenter": SMALL.indenter.model_copy(update=depth)})
    pushed = press_finger(design, PressSettings("coarse", 1))
    assert driven.force_n[-1, 1] == pytest.approx(0.8, rel=1e-5)
    # both are equilibria to 1e-6 of their forces
    assert pushed.force_n[-1] == pytest.approx(driven.force_n[-1], abs=1e-5)
    assert pushed.energy_n_mm[-1] == pytest.approx(driven.energy_n_mm[-1], rel=1e-5)
    places, forces = contact_forces_n(driven)
    assert forces.sum() == pytest.approx(np.linalg.norm(driven.force_n[-1]), rel=1e-12)
    # normal to the finger's middle plane, the patch is its own mirror image
    assert frictionless_torque_n_mm(places, forces, 18.0) == pytest.approx(9.0 * forces.sum(), rel=1e-3)


def test_torque_at_slip_of_known_patches():
    radius = np.sqrt(np.linspace(0.0, 1.0, 200, endpoint=False) + 0.5 / 200)
    turn = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    x, z = (radius[:, None] * np.cos(turn)).ravel(), (radius[:, None] * np.sin(turn)).ravel()
    disc = np.column_stack([4.0 + 3.0 * x, np.zeros_like(x), 20.0 + 3.0 * z])
    even = np.full(len(disc), 5.0 / len(disc))
    # an even pressure on a disc of radius R: 2/3 mu N R; rings of equal areas miss it by 1e-5
    assert slip_torque_n_mm(disc, even, 0.4) == pytest.approx(2.0 / 3.0 * 0.4 * 5.0 * 3.0, rel=1e-4)
    pair = np.array([[-2.0, 0.0, 7.0], [2.0, 0.0, 7.0]])
    # two points: each holds mu N_i; the weaker one gives way about the stronger one
    assert slip_torque_n_mm(pair, np.array([3.0, 1.0]), 0.5) == pytest.approx(0.5 * 1.0 * 4.0, rel=1e-5)
    assert frictionless_torque_n_mm(pair, np.array([3.0, 1.0]), 10.0) == pytest.approx(4.0 * (5.0 - 1.0), rel=1e-12)
    with pytest.raises(SimulateError, match="must be a finite coefficient of 0 or more"):
        slip_torque_n_mm(pair, np.ones(2), -0.1)


@pytest.mark.parametrize(
    ("indenter", "arm_mm"),
    [
        (Indenter(), 9.0 - 1.0),
        (Indenter(shape="ball"), 0.0),
        (Indenter(shape="cuboid", size_mm=(8.0, 5.0, 5.0), edge_radius_mm=0.5), 3.5 - 1.0),
        (Indenter(shape="cuboid", size_mm=(8.0, 5.0, 5.0), edge_radius_mm=0.5, across_mm=7.0), 0.0),
        (Indenter(shape="cuboid", size_mm=(40.0, 5.0, 5.0)), 9.0 - 1.0),
    ],
    ids=["cylinder", "ball", "narrow cuboid", "cuboid beside the force", "wide cuboid"],
)
def test_the_torque_without_friction_is_that_of_the_indenters_shape(indenter, arm_mm):
    """Two forces of 2 N whose resultant acts 1 mm beside the middle of a pad of 18 mm."""
    design = SMALL.model_copy(update={"indenter": indenter})
    assert design.pad.width_mm == 18.0
    places = np.array([[0.5, 6.0, 30.0], [1.5, 6.0, 34.0]])
    assert tipping_torque_n_mm(design, places, np.array([2.0, 2.0])) == pytest.approx(4.0 * arm_mm, abs=1e-12)


def test_the_order_of_two_fingers_and_its_table(monkeypatch):
    # the arithmetic of the study, with fingers whose stiffness is a product of their sizes in place of equilibria
    class Quick:
        def __init__(self, design, threads):
            self.size = design.skeleton.rib_thickness_mm

        def push(self, place, force_n):
            return type("Pushed", (), {"stiffness_n_per_mm": self.size})

        def twist(self, angle_deg):
            return type("Twisted", (), {"stiffness_n_mm_per_deg": self.size**2})

    monkeypatch.setattr("sim.experiments._design_sensitivities.LoadedFinger", Quick)
    monkeypatch.setattr("sim.experiments._design_sensitivities._held_torques", lambda design, threads: (7.0, 5.0, ""))
    stiff, soft = preset_design("flat-70x35"), preset_design("flat-70x35-soft")
    study = study_finger_stiffness([stiff, soft], 0.2)
    held = [(row.changed, row.slip_torque_per_friction_n_mm) for row in study.rows if row.tipping_torque_n_mm]
    assert held == [("", 7.0), ("", 7.0)]
    changed = {row.changed for row in study.rows}
    assert {"skeleton.rib_count", "skeleton.backing.thickness_mm", ""} <= changed
    assert "skeleton.mirror_thickness_mm" not in changed  # the paper gives it
    twist = next(order for order in study.orders if order.measure == "twist_n_mm_per_deg")
    assert (twist.stiffer, twist.softer) == (stiff.name, soft.name)
    assert twist.ratio == pytest.approx((1.2 / 0.8) ** 2)
    assert twist.smallest_ratio == pytest.approx((1.2 / 0.8) ** 2)
    assert twist.independent_ratio == pytest.approx((1.2 * 0.8 / (0.8 * 1.2)) ** 2)
    with pytest.raises(SimulateError, match="give each design a unique name"):
        study_finger_stiffness([stiff, stiff])
    with pytest.raises(SimulateError, match=r"give a share from 0 to 0\.5"):
        study_finger_stiffness([stiff], 0.6)


def test_a_grip_that_does_not_reach_its_force_holds_no_known_torque(monkeypatch):
    def early(*_, **__):
        return type(
            "Early", (), {"unreached": "no equilibrium was found beyond 0.5", "force_n": np.array([[0.0, 1.0, 0.0]])}
        )

    def never(*_, **__):
        raise NoEquilibriumError("no equilibrium at a push of 0.1 mm")

    monkeypatch.setattr("sim.experiments._design_sensitivities.press_to_force", early)
    assert _held_torques(SMALL, 1) == (None, None, "the grip ended early, at 1 N: no equilibrium was found beyond 0.5")
    monkeypatch.setattr("sim.experiments._design_sensitivities.press_to_force", never)
    assert _held_torques(SMALL, 1) == (None, None, "no equilibrium at a push of 0.1 mm")


def test_a_dimension_that_the_design_refuses_is_a_row_with_the_reason():
    design = preset_design("flat-70x35")
    row = _row(design, "skeleton.rib_thickness_mm", -2.0, -1.2, threads=1)
    assert row.bending_n_per_mm is None
    assert "-1.2 mm is outside 0.2 to 20 mm" in row.failure
