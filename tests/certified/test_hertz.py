"""Contact against Hertz at small strain: a rigid sphere and a rigid cylinder on a half-space.

Blocks graded outwards from the contact, of 20 to 80 half-widths, and each with all cells halved. The far field errs by
(half-width / size of the block) to first order in the force of a sphere, and the elements by the square of their size;
both are extrapolated. The penalty is stiffer the finer the mesh is, so that its sinking goes with the mesh's error.
"""

import numpy as np
import pytest
import scipy.sparse as sp

from sim.mechanics import Cylinder, PenaltyContact, Pose, Sphere
from sim.mechanics._materials import neo_hooke
from sim.mechanics._newton import Supports
from tests.certified.blocks import GridBlock, assemble, press

RADIUS_MM = 10.0
DEPTH_MM = 0.05  # half a per cent of the radius: strains of a per cent
SPHERE_MM = np.sqrt(RADIUS_MM * DEPTH_MM)  # half-width of its contact
LINE_MM = 0.5  # about; it follows from the force, which depends on the block
GROWTH = 1.3
WEDGE_RAD = np.radians(3.0)
GEL = neo_hooke(0.1333, 500.0)


def contact_modulus_mpa():
    """E / (1 - nu^2) of the gel."""
    k = GEL.bulk_over_shear
    nu = (3 * k - 2) / (2 * (3 * k + 1))
    return 2 * GEL.shear_modulus_mpa * (1 + nu) / (1 - nu**2)


def graded(half_width_mm, cells, half_widths, halvings):
    """Coordinates from 0: even steps beyond the contact, then growing ones; then each step halved some times."""
    steps = [half_width_mm / cells] * int(np.ceil(1.4 * cells))
    while sum(steps) < half_widths * half_width_mm:
        steps.append(GROWTH * steps[-1])
    places = np.concatenate([[0.0], np.cumsum(steps)])
    for _ in range(halvings):
        places = np.sort(np.concatenate([places, (places[1:] + places[:-1]) / 2.0]))
    return places


def pressed(cells, nodes_mm, body, fixed, further=()):
    """Contact and displacements when a body that touched the top has gone in by the depth."""
    stiffness = 100 * GEL.shear_modulus_mpa / cells.spacing_mm
    contact = PenaltyContact(nodes_mm, cells.top_quads(), body, Pose((0, RADIUS_MM, 0)), stiffness, curvature=False)
    assembly = assemble(cells.mesh("mean_dilatation", nodes_mm), GEL, [contact, *further])

    def loading(fraction):
        contact.place(Pose((0.0, RADIUS_MM - DEPTH_MM * fraction, 0.0)))
        return Supports(fixed, np.zeros_like(nodes_mm))

    return contact, press(assembly, loading)[-1].state.u_mm


def block(thickness, places):
    cells = GridBlock([0.0, thickness], -places[::-1], places)
    cells.spacing_mm = places[1]
    fixed = Supports.at_rest(len(cells.nodes_mm), cells.numbers[:, 0].ravel()).fixed
    return cells, fixed


class Mirror:
    """Nodes that stay on a plane: k/2 sum (n . u)^2."""

    def __init__(self, nodes, normal, stiffness, count):
        held = np.zeros(count)
        held[nodes] = stiffness
        self.matrix = sp.kron(sp.diags_array(held), np.outer(normal, normal)).tocoo()

    def energy(self, u):
        return 0.5 * float(u.ravel() @ (self.matrix @ u.ravel()))

    def gradient(self, u):
        return (self.matrix @ u.ravel()).reshape(-1, 3)

    def hessian(self, u, project):
        return self.matrix

    def max_step(self, u, du):
        return 1.0


def sphere_over_hertz(half_widths, halvings):
    """Force over 4/3 E* sqrt(R depth^3), by a wedge of 3 deg of a cylindrical block: round to 5e-4 of its area."""
    places = graded(SPHERE_MM, 8, half_widths, halvings)
    cells, fixed = block(WEDGE_RAD, places)
    turn, y, radius = cells.nodes_mm.T
    # a hole of a hundredth of an element, with no way to close, keeps the elements at the axis from folding
    radius = np.maximum(radius, 0.01 * places[1])
    nodes = np.column_stack([radius * np.sin(turn), y, radius * np.cos(turn)])
    fixed[cells.numbers[0].ravel(), 0] = True
    fixed[np.ix_(cells.numbers[:, :, 0].ravel(), [0, 2])] = True
    normal = np.array([np.cos(WEDGE_RAD), 0.0, -np.sin(WEDGE_RAD)])
    # 1e5 N/mm against E* h of at most 20 N/mm: far below the strains in what it opens the wedge by
    far = Mirror(cells.numbers[1].ravel(), normal, 1e5, len(nodes))
    contact, u = pressed(cells, nodes, Sphere(RADIUS_MM), fixed, [far])
    whole = contact.force_n(u)[1] * 2.0 * np.pi / WEDGE_RAD
    return whole / (4.0 / 3.0 * contact_modulus_mpa() * np.sqrt(RADIUS_MM * DEPTH_MM**3))


def line_over_hertz(half_widths, halvings):
    """Half-width and peak pressure over those of Hertz at the force per length, which the block does not change."""
    places = graded(LINE_MM, 16, half_widths, halvings)
    cells, fixed = block(places[1], places)
    fixed[:, 0] = True
    fixed[cells.numbers[:, :, 0].ravel(), 2] = True
    contact, u = pressed(cells, cells.nodes_mm, Cylinder(RADIUS_MM), fixed)
    load = 2.0 * contact.force_n(u)[1] / places[1]
    half_width = np.sqrt(4.0 * load * RADIUS_MM / np.pi / contact_modulus_mpa())
    # Hertz: p^2 = p0^2 (1 - (z / a)^2); faces at the edge of the contact touch in part
    pressure, z = contact.pressures_mpa(u).mean(axis=1), contact.points_mm(u)[:, :, 2].mean(axis=1)
    inside = z < 0.85 * half_width
    slope, start = np.polyfit(z[inside] ** 2, pressure[inside] ** 2, 1)
    peak = 2.0 * load / np.pi / half_width
    return np.array([np.sqrt(-start / slope) / half_width, np.sqrt(start) / peak])


def test_sphere():
    near, far = sphere_over_hertz(40, 0), sphere_over_hertz(80, 0)
    fine = sphere_over_hertz(40, 1)
    # the errors that are extrapolated are there, of the sign of a stiffer block, and small
    assert 0.002 < near - fine < 0.01
    assert 0.002 < near - far < 0.02
    assert near + 4.0 / 3.0 * (fine - near) + 2.0 * (far - near) == pytest.approx(1.0, abs=0.02)


def test_line():
    near, far = line_over_hertz(20, 0), line_over_hertz(40, 0)
    fine = line_over_hertz(20, 1)
    # at a given force the far field is even to first order: its error falls with the square of the size
    assert near + 4.0 / 3.0 * (fine - near) + 4.0 / 3.0 * (far - near) == pytest.approx([1.0, 1.0], abs=0.01)
