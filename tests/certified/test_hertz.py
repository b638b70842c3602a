"""Contact against Hertz: a rigid cylinder on a deep block in plane strain."""

import numpy as np
import pytest

from sim.mechanics.contact_analytic import PenaltyContact
from sim.mechanics.materials import neo_hooke
from sim.mechanics.newton import Supports
from sim.mechanics.signed_distances import Cylinder, Pose
from tests.certified.blocks import GridBlock, assemble, press, stretched

RADIUS_MM = 10.0
GEL = neo_hooke(0.1333, 500.0)


def contact_modulus_mpa():
    """E / (1 - nu^2) of the gel."""
    k = GEL.bulk_over_shear
    nu = (3 * k - 2) / (2 * (3 * k + 1))
    return 2 * GEL.shear_modulus_mpa * (1 + nu) / (1 - nu**2)


def test_line_contact():
    # half a block of 40 mm (23 half-widths away) and one element's thickness, first elements of 0.067 mm
    along = stretched(60, 40.0, 4.5)
    thick = along[1]
    cells = GridBlock([0.0, thick], -along[::-1], along)
    stiffness = 100 * GEL.shear_modulus_mpa / thick
    contact = PenaltyContact(cells.nodes_mm, cells.top_quads(), Cylinder(RADIUS_MM), Pose((0, RADIUS_MM, 0)), stiffness)
    assembly = assemble(cells.mesh("mean_dilatation"), GEL, [contact])
    fixed = Supports.at_rest(assembly.count, cells.numbers[:, 0].ravel()).fixed
    fixed[:, 0] = True
    fixed[cells.numbers[:, :, 0].ravel(), 2] = True

    def loading(fraction):
        contact.place(Pose((0.0, RADIUS_MM - 0.2 * fraction, 0.0)))
        return Supports(fixed, np.zeros_like(cells.nodes_mm))

    u = press(assembly, loading)[-1].state.u_mm
    load = 2 * contact.force_n(u)[1] / thick
    half_width = np.sqrt(4 * load * RADIUS_MM / np.pi / contact_modulus_mpa())
    peak = 2 * load / np.pi / half_width
    # Hertz: p^2 = p0^2 (1 - (z/a)^2), fitted over faces that touch as a whole
    pressure = contact.pressures_mpa(u)
    whole = pressure.min(axis=1) > 0.0
    p, z = pressure[whole].mean(axis=1), contact.points_mm(u)[whole, :, 2].mean(axis=1)
    slope, start = np.polyfit(z**2, p**2, 1)
    assert np.sqrt(-start / slope) == pytest.approx(half_width, rel=0.01)
    assert np.sqrt(start) == pytest.approx(peak, rel=0.01)
