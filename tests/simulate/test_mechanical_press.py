"""A whole finger pressed by finite elements on the coarse mesh."""

from dataclasses import replace

import numpy as np
import pytest

from data_schemas import FingerDesign, Indenter, SimulateError
from sim import preset_design
from sim.experiments import press_records
from sim.mechanics import (
    PressSettings,
    contact_distance,
    contact_pressure_mpa,
    press_finger,
    rigid_indenter,
    touch_areas_mm2,
)
from sim.surface_meshes import check_closed, check_no_intersections, restore_shapes

DESIGN = FingerDesign(indenter=Indenter(depth_mm=1.0))


@pytest.fixture(scope="module")
def pressed():
    steps = []
    result = press_finger(DESIGN, PressSettings(increments=2), progress=lambda *step: steps.append(step))
    ends = [(1, 2, "pressed to 0.50 mm"), (2, 2, "pressed to 1.00 mm")]
    assert [step for step in steps if step in ends] == ends
    # and before each iteration, how far the search is
    iterations = [what for _, _, what in steps if "iteration " in what]
    assert len(iterations) == result.iterations.sum()
    assert all(" N allowed" in what for what in iterations)
    assert any(what.startswith("pressed to 0.50 mm, iteration 1, out of balance by ") for what in iterations)
    return result


@pytest.fixture(scope="module")
def records():
    return press_records(DESIGN, press_finger(DESIGN, PressSettings(increments=1)))


def test_the_force_pushes_back_along_the_normal_and_grows(pressed):
    np.testing.assert_allclose(pressed.depth_mm, [0.5, 1.0])
    assert 0.0 < pressed.force_n[0, 1] < pressed.force_n[1, 1]
    # the finger is its own mirror image; the equilibrium is known to 1e-6 of the force
    assert np.abs(pressed.force_n[:, 0]).max() < 1e-4 * pressed.force_n[1, 1]
    assert not pressed.unreached


def test_the_work_of_the_indenter_is_the_stored_energy(pressed):
    # F grows from 0; two trapezoids of a nearly straight curve differ from its integral by a few parts in a hundred
    depth, force = np.r_[0.0, pressed.depth_mm], np.r_[0.0, pressed.force_n[:, 1]]
    assert np.trapezoid(force, depth) == pytest.approx(pressed.energy_n_mm[-1], rel=0.05)


def test_one_step_reaches_what_two_reach(pressed, records):
    mechanics, _ = records
    # the finger has one equilibrium at this push, and both are known to 1e-6 of the force
    assert mechanics.force_n[-1, 1] == pytest.approx(pressed.force_n[-1, 1], rel=1e-4)


def test_the_base_holds_still_and_the_coat_goes_down_under_the_indenter(pressed):
    last = pressed.displacement_mm[-1]
    np.testing.assert_array_equal(last[pressed.mesh.node_sets["fixed"]], 0.0)
    coat = pressed.mesh.node_sets["coat"]
    under = coat[np.abs(pressed.mesh.nodes_mm[coat, 2] - 35.0) < 1.1]
    # all of the push, but for what the contact's penalty gives way and for the chord of an element of 2 mm
    assert np.all(last[under, 1] == pytest.approx(-1.0, abs=0.1))


def test_the_contact_lies_under_the_indenter(pressed):
    coat = pressed.mesh.node_sets["coat"]
    distance = contact_distance(pressed, coat)
    inside = pressed.mesh.nodes_mm[coat][distance <= 1.0]
    assert len(inside) > 0
    # the chord of the cylinder at the whole push is more than the patch of a finger that gives way
    assert np.abs(inside[:, 2] - 35.0).max() <= np.sqrt(2 * 10.0 * 1.0)


def test_the_pressure_at_the_nodes_holds_the_force(pressed):
    pressure, coat = contact_pressure_mpa(pressed), pressed.mesh.surfaces["coat"]
    corners = pressed.mesh.nodes_mm[coat]
    # elements of the flat coat are rectangles
    areas = np.abs((corners[:, 2] - corners[:, 0])[:, 0] * (corners[:, 2] - corners[:, 0])[:, 2])
    whole = (areas * pressure[coat].mean(axis=1)).sum()
    # elements at the pad's edges are narrower, so that the nodes' mean is no quadrature; the coat leans by degrees
    assert whole == pytest.approx(np.linalg.norm(pressed.force_n[-1]), rel=0.02)
    assert not pressure[np.setdiff1d(np.arange(len(pressure)), coat)].any()
    assert 0.0 < pressure.max() <= pressed.pressure_mpa.max()
    assert np.abs(pressed.mesh.nodes_mm[pressure > 0.0, 2] - 35.0).max() <= np.sqrt(2 * 10.0 * 1.0) + 2.5


def test_the_surfaces_close_and_the_gel_keeps_its_volume(records):
    mechanics, stored = records
    rest, shape = restore_shapes(stored)
    check_no_intersections(shape.gel)
    # K/mu = 20: a confined pad loses up to 1 % of its volume at this push
    assert check_closed(shape.gel) == pytest.approx(check_closed(rest.gel), rel=0.01)
    assert shape.label == "finite elements, push of 1 mm"
    assert stored.push_mm == 1.0
    assert mechanics.label.startswith("finite elements, coarse mesh, ")


def test_a_press_without_depth_is_refused():
    with pytest.raises(SimulateError, match="must be above 0 mm for a press"):
        press_finger(FingerDesign(indenter=Indenter(depth_mm=0.0)))


def test_a_record_says_where_a_press_may_stand_at_an_unstable_equilibrium(pressed):
    told = "at a push of 1 mm the search could not leave an unstable equilibrium"
    for unstable in ("", told):
        mechanics, _ = press_records(DESIGN, replace(pressed, unstable=unstable))
        assert (told in mechanics.notes) == bool(unstable)


def test_a_turned_cylinder_does_not_sink_into_the_border_of_the_pad():
    """By Gauss points alone, 0.4 mm inside the border, a node of it lies 0.12 mm in the cylinder."""
    turned = Indenter(radius_mm=10.0, position_mm=24.0, rotation_deg=(0.0, 0.0, 25.0), depth_mm=1.0)
    finger = preset_design("baby-48x18").model_copy(update={"indenter": turned})
    pressed = press_finger(finger, PressSettings("coarse", 1))
    coat = np.unique(pressed.mesh.surfaces["coat"])
    places = pressed.mesh.nodes_mm[coat] + pressed.displacement_mm[-1][coat]
    indenter = rigid_indenter(finger)
    distance, *_ = indenter.pose(1.0).distances(indenter.exact_body(), places)
    assert distance.min() > -0.02
    # the pressures, by the areas that their points stand for, push as hard along the normals of the cylinder
    pushed = (touch_areas_mm2(pressed) * pressed.pressure_mpa).sum()
    assert pushed * np.cos(np.radians(25.0)) == pytest.approx(pressed.force_n[-1, 1], rel=0.02)
