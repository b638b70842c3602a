"""A whole finger under an indenter on a path: balance, limit analysis, release, and the way back without friction."""

from functools import cache

import numpy as np
import pytest

from data_schemas import SimulateError
from sim import preset_design
from sim.experiments import press_records
from sim.mechanics import (
    IndenterPath,
    PressSettings,
    contact_forces_n,
    finger_materials,
    press_along,
    press_finger,
    read_path,
    slip_torque_n_mm,
)
from sim.mechanics._assembly import Assembly, Elasticity
from sim.mechanics._finger_mesh import STEPS, finger_ties

COARSE = PressSettings("coarse")


def small_finger(friction, depth_mm=1.0):
    """The 48 x 18 finger under a ball of 8 mm radius, a little beside its middle."""
    design = preset_design("baby-48x18")
    changes = {"shape": "ball", "radius_mm": 8.0, "friction": friction, "depth_mm": depth_mm, "across_mm": 0.4}
    return design.model_copy(update={"indenter": design.indenter.model_copy(update=changes)})


def path_of(*poses):
    """A path of (across, push, along, turn about y, increments)."""
    x, push, z, turn, steps = np.array(poses, dtype=float).T
    still = np.zeros_like(turn)
    return IndenterPath(np.column_stack([x, -push, z]), np.column_stack([still, turn, still]), steps.astype(int))


@cache
def twisted():
    """Pressed in by 1 mm, turned by 30 deg about the normal, lifted off."""
    path = path_of((0, 1.0, 0, 0, 2), (0, 1.0, 0, 30, 3), (0, -0.2, 0, 30, 1))
    return press_along(small_finger(0.5), path, COARSE)


def test_the_base_holds_what_the_indenter_pushes():
    pressed, design = twisted(), small_finger(0.5)
    mesh, last = pressed.mesh, len(pressed.depth_mm) - 1
    ties = finger_ties(design, mesh, STEPS["coarse"].skeleton_mm)
    elasticity = Elasticity(mesh, finger_materials(design))
    for k in range(last):
        u = pressed.displacement_mm[k]
        state = relaxed(Assembly(elasticity, ties), u)
        held = mesh.node_sets["fixed"]
        reaction = Assembly(elasticity, ties).assemble(state)[0][held]
        arms = mesh.nodes_mm[held] + u[held] - pressed.motion.origins_mm[k]
        force, torque = pressed.force_n[k], pressed.motion.torque_n_mm[k]
        # limits of friction are renewed once more after the last equilibrium, by a thousandth at most
        settled = 1e-3 * np.linalg.norm(force)
        np.testing.assert_allclose(reaction.sum(axis=0), force, atol=settled)
        # at the ball's radius from its middle
        np.testing.assert_allclose(np.cross(arms, reaction).sum(axis=0), torque, atol=8.0 * settled)
    assert np.abs(pressed.motion.torque_n_mm[last - 1]).max() > 0.1


def relaxed(assembly, u):
    """The state of displacements with the incompatible modes that belong to them: Newton's method in each element."""
    rest, still = assembly.at_rest(), np.zeros_like(u)
    state = assembly.with_own_pressures(type(rest)(u, rest.modes))
    for _ in range(8):
        assembly.assemble(state)
        state = state.moved(1.0, still, assembly.elasticity.mode_step(still))
    return state


def test_the_torque_of_a_twist_is_that_of_the_limit_analysis():
    pressed = twisted()
    turned = 4  # the last increment of the twist
    frictionless = press_finger(small_finger(0.0), PressSettings("coarse", 2))
    limit = 0.5 * slip_torque_n_mm(*contact_forces_n(frictionless), 1.0)
    torque = -pressed.motion.torque_n_mm[:, 1]
    # it rises to the limit and stays there
    np.testing.assert_allclose(torque[2 : turned + 1], torque[2], rtol=0.01)
    assert torque[2] > 10.0 * abs(torque[1])
    # nothing sticks any more
    assert (pressed.motion.slip_mm[turned] > 0.0).sum() == (pressed.motion.pressure_mpa[turned] > 0.0).sum()
    # friction's change of the pressures, which the limit analysis leaves out, and the four points of each face
    assert torque[turned] == pytest.approx(limit, rel=0.1)


def test_a_finger_that_is_let_go_is_at_rest_again():
    pressed = twisted()
    assert pressed.unreached == ""
    assert (pressed.motion.pressure_mpa[-1] == 0.0).all()
    assert np.abs(pressed.force_n[-1]).max() == 0.0
    assert np.abs(pressed.displacement_mm[-1]).max() < 1e-3 * np.abs(pressed.displacement_mm[4]).max()
    mechanics, surfaces = press_records(small_finger(0.5), pressed, "coarse")
    assert mechanics.motion.patch_mm2[-1] == 0.0
    assert np.isnan(surfaces.contact_distance).all()


def test_the_way_back_without_friction_ends_where_it_began():
    there_and_back = path_of((0, 0.8, 0, 0, 1), (0.3, 1.0, 0.6, 10, 1), (0, 0.8, 0, 0, 1))
    pressed = press_along(small_finger(0.0), there_and_back, COARSE)
    # equilibria are found to a millionth of the forces
    np.testing.assert_allclose(pressed.force_n[2], pressed.force_n[0], atol=1e-5)
    np.testing.assert_allclose(pressed.displacement_mm[2], pressed.displacement_mm[0], atol=1e-5)
    assert np.abs(pressed.displacement_mm[1] - pressed.displacement_mm[0]).max() > 0.1
    assert (pressed.friction_work_n_mm == 0.0).all()
    plain = press_finger(small_finger(0.0, 0.8), PressSettings("coarse", 1))
    np.testing.assert_allclose(pressed.force_n[0], plain.force_n[0], atol=1e-5)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("across_mm,push_mm\n", "contains no poses"),
        ("across,push_mm\n0,1\n", "the column 'across' is unknown"),
        ("increments\n3\n", "no column moves"),
        ("push_mm,turn_y_deg\n1,ten\n", "line 2, column turn_y_deg"),
        ("push_mm,along_mm\n1\n", "line 2: has 1 columns"),
        ("push_mm,increments\n1,2.5\n", "line 2: 'increments': must be a whole number, got 2.5"),
        ("push_mm,increments\n1,0\n", "line 2: 'increments': must be at least 1, got 0"),
        ("push_mm\n1\n900\n", r"line 3: 'push_mm' \(in mm\): must be at most 200, got 900"),
        ("push_mm\nnan\n", "not a finite number"),
    ],
)
def test_a_path_that_cannot_be_followed_is_refused(tmp_path, text, says):
    file = tmp_path / "path.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(SimulateError, match=says) as refused:
        read_path(file)
    assert "path.csv" in str(refused.value)


def test_a_path_that_never_touches_is_refused_in_words():
    for poses in (((0, -1.0, 0, 0, 1),), ((0, -1.0, 0, 0, 1), (0, -1.0, 1.0, 10, 1))):
        with pytest.raises(SimulateError, match=r"touches no node .* at any increment .* positive into"):
            press_along(small_finger(0.5), path_of(*poses), COARSE)


def test_a_path_is_read_as_it_is_meant(tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("push_mm,turn_x_deg,along_mm,increments\n1,0,0,2\n# slide\n1,8,2,4\n", encoding="utf-8")
    path = IndenterPath.through(read_path(file), 7)
    move, turn = path.at(4.0 / 6.0)
    np.testing.assert_allclose(move, [0.0, -1.0, 1.0])
    np.testing.assert_allclose(turn, [4.0, 0.0, 0.0])
    assert path.total == 6
    assert path.is_corner(2.0 / 6.0)
    assert not path.is_corner(0.5)
