"""Work of what moves a body against the energy that is told as stored and lost, with the barrier and its friction."""

import numpy as np
import pytest

from sim import preset_design
from sim.mechanics import PressSettings, press_finger
from tests.certified.sliding_block import drag


def press_and_drag(ratio, stops):
    """Press a plate into a block by 0.1 mm times the share up to 1, then drag it along x by the rest in mm.

    Returns share, force on the plate (x, y), stored energy and the work lost to friction in the increment, each stop.
    """
    rows = []
    # the drive meets its depth more closely than in a press: the balance below is sharper than 1e-4 mm times the force
    for at in drag(ratio, stops, met_mm=1e-7):
        u = at.state.u_mm
        stored = at.assembly.elasticity.energy(u, at.state.modes) + at.contact.barrier_energy(u)
        force = at.contact.force_n(u)
        rows.append((at.share, force[0], force[1], stored, at.contact.friction_work_n_mm(u)))
    return np.array(rows).T


def test_the_stored_energy_is_the_work_without_friction():
    share, _, force, stored, lost = press_and_drag(0.0, [0.5, 0.625, 0.75, 0.875, 1.0])
    assert share == pytest.approx([0.5, 0.625, 0.75, 0.875, 1.0])  # no cutbacks: Simpson's rule needs even steps
    work = 0.0125 / 3.0 * (force[0] + 4.0 * force[1] + 2.0 * force[2] + 4.0 * force[3] + force[4])
    # of fourth order in steps of 0.4 % of the block's height; the drive's own spring would be off by far more
    assert stored[-1] - stored[0] == pytest.approx(work, rel=1e-5)
    np.testing.assert_array_equal(lost, 0.0)


@pytest.mark.parametrize("ratio", [0.3, 0.8])
def test_the_work_of_sliding_is_what_friction_takes(ratio):
    share, pull, push, stored, lost = press_and_drag(ratio, [1.0, *np.arange(1.1, 2.01, 0.1)])
    steps = np.diff(share[-4:])
    # the whole face slides: forces hardly change, so that their values at the ends of the steps give the work
    work = -(pull[-3:] * steps).sum()
    assert lost[-3:].sum() + stored[-1] - stored[-4] == pytest.approx(work, rel=5e-3)
    # beside the plate's way the face slips back by what the block's shear relaxes
    assert lost[-3:] == pytest.approx(ratio * push[-3:] * steps, rel=0.1)


@pytest.mark.parametrize("contact", ["penalty", "barrier"])
def test_a_press_tells_what_is_stored_and_what_is_lost(contact):
    small = preset_design("baby-48x18")
    indenter = small.indenter.model_copy(update={"depth_mm": 0.2, "friction": 0.5})
    pressed = press_finger(small.model_copy(update={"indenter": indenter}), PressSettings("coarse", 2, contact=contact))
    assert pressed.kind == contact
    depth, force = np.r_[0.0, pressed.depth_mm], np.r_[0.0, pressed.force_n[:, 1]]
    assert (pressed.contact_energy_n_mm > 0.0).all()
    assert (pressed.contact_energy_n_mm < 0.2 * pressed.energy_n_mm).all()
    # the coat hardly slips under a cylinder; what is lost never comes back
    assert (np.diff(np.r_[0.0, pressed.friction_work_n_mm]) >= 0.0).all()
    assert pressed.friction_work_n_mm[-1] < 0.05 * pressed.energy_n_mm[-1]
    whole = pressed.energy_n_mm[-1] + pressed.friction_work_n_mm[-1]
    # two trapezoids of a curve that starts with a bend, some hundredths
    assert np.trapezoid(force, depth) == pytest.approx(whole, rel=0.06)
