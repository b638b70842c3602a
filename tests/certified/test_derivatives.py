"""Derivatives of a press: an identity that holds for any finger, the work of the push, and differences of presses."""

import math
from dataclasses import replace

import numpy as np
import pytest

from data_schemas import FingerDesign, NoEquilibriumError, SimulateError
from sim import preset_design
from sim.experiments._design_sensitivities import changed_design, design_value, press_sensitivities
from sim.mechanics import STEPS, DesignChange, LinearElastic, PressSettings, press_derivatives, press_finger
from sim.mechanics._contact_library import contact_library_failure
from sim.mechanics._derivatives import StableEquilibrium
from sim.mechanics._finger_mesh import MeshSteps
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._newton import Supports
from tests.certified.blocks import assemble, unit_cells

MODULI = (
    "mechanics.gel.c10_mpa",
    "mechanics.skeleton.mu_mpa",
    "mechanics.onyx.youngs_modulus_mpa",
    "mechanics.mirror.youngs_modulus_mpa",
    "mechanics.film.youngs_modulus_mpa",
)
OTHERS = ("mechanics.gel.bulk_over_shear", "skeleton.rib_thickness_mm", "pad.thickness_mm", "indenter.depth_mm")
SETTINGS = PressSettings("coarse", 1)
STEP_LN = 1e-4


def design():
    finger = FingerDesign()
    return finger.model_copy(update={"indenter": finger.indenter.model_copy(update={"depth_mm": 1.0})})


def scaled(finger, field, ln):
    value, factor = design_value(finger, field), math.exp(ln)
    return changed_design(
        finger, field, tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
    )


def change(finger, field, step=STEP_LN):
    return DesignChange(scaled(finger, field, -step), scaled(finger, field, step), 2.0 * step)


@pytest.fixture(scope="module")
def pressed():
    return press_finger(design(), SETTINGS)


@pytest.fixture(scope="module")
def derivatives(pressed):
    return press_derivatives(design(), pressed, {f: change(design(), f) for f in (*MODULI, *OTHERS)}, SETTINGS)


def test_a_force_is_proportional_to_all_moduli_together(pressed, derivatives):
    # F(s E_1, ..., s E_n) = s F: Euler's identity, for force and energy; nothing moves
    ours = [derivatives.names.index(name) for name in MODULI]
    force, energy = derivatives.force_n[0, ours, 1].sum(), derivatives.energy_n_mm[0, ours].sum()
    # an equilibrium to 1e-6 of its forces
    assert force == pytest.approx(pressed.force_n[-1, 1], rel=1e-5)
    assert energy == pytest.approx(pressed.energy_n_mm[-1], rel=1e-5)
    moved = derivatives.displacement_mm[ours]
    assert np.abs(moved.sum(axis=0)).max() < 1e-4 * np.abs(moved).max()


def test_the_work_of_a_push_is_its_force(pressed, derivatives):
    # d Pi / d depth = F: an identity of the whole chain, contact and all
    at = derivatives.names.index("indenter.depth_mm")
    assert derivatives.energy_n_mm[0, at] == pytest.approx(pressed.force_n[-1, 1] * 1.0, rel=1e-5)


@pytest.mark.parametrize("field", ["mechanics.gel.c10_mpa", "skeleton.rib_thickness_mm"])
def test_differences_of_whole_presses_agree(pressed, derivatives, field):
    # short, because the lines of the mesh have kinks where an edge stops to follow a thickness
    step = 0.002
    low, high = (press_finger(scaled(design(), field, s), SETTINGS, start=pressed) for s in (-step, step))
    at = derivatives.names.index(field)
    # Newton's last step leaves far less than the 1e-6 of the forces that would do, or 5e-4 would be left here
    found = derivatives.force_n[0, at, 1] / pressed.force_n[-1, 1]
    assert found == pytest.approx(math.log(high.force_n[-1, 1] / low.force_n[-1, 1]) / (2.0 * step), rel=1e-4)
    energy = (high.energy_n_mm[-1] - low.energy_n_mm[-1]) / (2.0 * step)
    assert derivatives.energy_n_mm[0, at] == pytest.approx(energy, rel=1e-4)
    coat = pressed.mesh.node_sets["coat"]
    moved = (high.displacement_mm[-1] - low.displacement_mm[-1])[coat] / (2.0 * step)
    assert np.abs(derivatives.displacement_mm[at][coat] - moved).max() < 1e-3 * np.abs(moved).max()


def test_a_number_that_changes_the_mesh_is_pressed_again(pressed):
    # one rib more is another mesh; the press is whole again then
    finger, other = design(), changed_design(design(), "skeleton.rib_count", design().skeleton.rib_count + 1)
    found = press_derivatives(finger, pressed, {"skeleton.rib_count": DesignChange(finger, other, 1.0)}, SETTINGS)
    assert "changes the mesh and thereby the force" in found.refused["skeleton.rib_count"]
    assert not found.names


def test_presses_by_the_barrier_have_none(pressed):
    with pytest.raises(SimulateError, match=r"derivatives need a press .* with penalty contact"):
        press_derivatives(design(), replace(pressed, kind="barrier"), {}, SETTINGS)


def test_presses_whose_parts_touched_have_none(pressed):
    """The contact between the parts is not in them: without it they were 2 to 3 % off on a finger pressed by 9 mm."""
    assert pressed.parts_touch_from_mm is None
    touched = replace(pressed, parts_touch_from_mm=0.3)
    with pytest.raises(SimulateError, match="do not include contact between parts of the finger"):
        press_derivatives(design(), touched, {}, SETTINGS)


def test_sensitivities_tell_the_derivatives(pressed, derivatives):
    found = press_sensitivities(design(), pressed, fields=MODULI[:2])
    assert [slope.field for slope in found.slopes] == list(MODULI[:2])
    for k, slope in enumerate(found.slopes):
        own = derivatives.force_n[0, derivatives.names.index(MODULI[k]), 1] / pressed.force_n[0, 1]
        assert slope.ln_force_per_ln_number == pytest.approx([own], rel=1e-9)


def test_a_press_without_force_has_no_sensitivities(pressed):
    coarse = changed_design(design(), "mesh.preset", "coarse")
    loose = replace(pressed, force_n=0.0 * pressed.force_n)
    with pytest.raises(SimulateError, match=r"force of the press is 0 N at a push of [\d.]+ mm.*; press deeper"):
        press_sensitivities(coarse, loose, fields=MODULI[:1])


@pytest.mark.skipif(contact_library_failure() is not None, reason=f"NO BARRIER: {contact_library_failure()}")
def test_sensitivities_of_a_press_whose_parts_touch_are_presses_with_that_contact(monkeypatch):
    """All moduli 1 % higher give 1 % more force; the contact takes 2 % off it, which one press without would add."""
    monkeypatch.setitem(STEPS, "coarse", MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0))
    # from rest a press without that contact ends on a fold of more energy; from what touches first on one that is near
    monkeypatch.setattr("sim.mechanics._penalty_contact.PenaltyPress.hold", lambda *_: False)
    small = preset_design("baby-48x18")
    ribs = small.skeleton.model_copy(update={"rib_angle_deg": -20.0, "rib_thickness_mm": 0.8})
    indenter = small.indenter.model_copy(update={"position_mm": 24.0, "depth_mm": 4.5, "friction": 0.0})
    folding = small.model_copy(update={"skeleton": ribs, "indenter": indenter})
    touching = press_finger(folding, SETTINGS)
    without = press_finger(folding, replace(SETTINGS, contact="penalty"))
    assert (touching.parts_touch_from_mm, without.parts_touch_from_mm) == (4.5, None)
    assert without.force_n[-1, 1] > 1.01 * touching.force_n[-1, 1]
    found = press_sensitivities(folding, touching, fields=MODULI)
    assert found.slopes == ()
    force = touching.force_n[-1, 1]
    slopes = [math.log(varied.force_n[-1] / force) / math.log1p(varied.change_rel) for varied in found.varied]
    # Euler's identity; steps of 10 % leave their second order
    assert len(slopes) == len(MODULI)
    assert sum(slopes) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("solver", ["pardiso", "superlu"])
def test_a_column_beyond_its_critical_load_is_refused(solver):
    # Euler: a slender column of 20 x 1 x 1 mm held at both ends buckles at a strain of 4 pi^2 / 12 / 20^2 = 0.8 %
    cells = unit_cells(20, 1, 1, size=(20.0, 1.0, 1.0))
    assembly = assemble(cells.mesh("incompatible_modes"), LinearElastic(10.0, 0.3))
    held = Supports.at_rest(assembly.count, cells.numbers[[0, -1]].ravel())

    def compressed(strain):
        # it widens, so that the stress is along it alone
        state = assembly.at_rest()
        state.u_mm[:] = strain * (cells.nodes_mm - [0.0, 0.5, 0.5]) * [-1.0, 0.3, 0.3]
        return state

    StableEquilibrium(assembly, held, compressed(0.0075), linear_solver(solver))
    with pytest.raises(NoEquilibriumError, match="about to snap"):
        StableEquilibrium(assembly, held, compressed(0.009), linear_solver(solver))
