"""Penalty contact: exact distances, derivatives, balance of forces, bodies driven by supports and by loads."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from data_schemas import SimulateError
from sim.mechanics import Cylinder, PenaltyContact, Pose, RoundedBox, Sphere, face_points, quad_shapes
from sim.mechanics._materials import neo_hooke
from sim.mechanics._newton import Supports
from sim.mechanics._penalty_contact import PenaltyTouch, coat_points
from tests.certified.blocks import GridBlock, assemble, press

GEL = neo_hooke(0.1333)
TURNED = Rotation.from_rotvec([0.4, -0.8, 0.3]).as_matrix()
BODIES = {
    "sphere": Sphere(3.0),
    "endless cylinder": Cylinder(3.0),
    "cylinder": Cylinder(3.0, 4.0, 0.7),
    "cuboid": RoundedBox((3.0, 4.0, 2.5), 0.8),
}
each_body = pytest.mark.parametrize("body", BODIES.values(), ids=BODIES.keys())


@each_body
def test_distance_normal_and_curvature_agree(body):
    pose = Pose((1.0, -2.0, 0.5), TURNED)
    points = np.random.default_rng(0).uniform(-6.0, 6.0, (400, 3)) + pose.position_mm
    distance, normal, hessian = pose.distances(body, points)
    away = distance > -0.5  # the skeleton of the body, where the normal jumps, lies deeper
    points, normal, hessian = points[away], normal[away], hessian[away]
    for axis, step in enumerate(1e-5 * np.eye(3)):
        low, high = (pose.distances(body, points + s) for s in (-step, step))
        # second differences of rounding (1e-16 / 1e-5); a few points lie within a step of a change of curvature
        slope, bend = (high[0] - low[0]) / 2e-5, (high[1] - low[1]) / 2e-5
        assert slope == pytest.approx(normal[:, axis], abs=1e-6)
        off = np.abs(bend - hessian[:, :, axis]).max(axis=1)
        assert np.quantile(off, 0.99) <= 1e-6
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0)


@each_body
def test_distance_is_that_to_the_nearest_surface_point(body):
    # the foot point x - d n lies on the surface, whichever way the body is described
    points = np.random.default_rng(1).uniform(-7.0, 7.0, (300, 3))
    distance, normal, _ = body.distances(points)
    out = distance > 0.0
    foot = body.distances(points[out] - distance[out, None] * normal[out])[0]
    assert foot == pytest.approx(0.0, abs=1e-12)


def test_places_on_the_bodies():
    points = np.array([[4.5, 1.0, 0.0], [0.0, 0.0, 5.0]])
    assert Cylinder(3.0, 4.0, 0.7).distances(points)[0] == pytest.approx([0.5, 2.0])
    corner = 0.8 * (1 - 3**-0.5)
    box = RoundedBox((3.0, 4.0, 2.5), 0.8)
    assert box.distances(np.array([[3.0 - corner, 4.0 - corner, 2.5 - corner]]))[0] == pytest.approx(0.0, abs=1e-15)


def touching(body, reference):
    cells = GridBlock(np.linspace(-2, 2, 4), [0.0, 1.0], np.linspace(-2, 2, 4))
    nodes = np.vstack([cells.nodes_mm, np.zeros(3)]) if reference else cells.nodes_mm
    pose = Pose((0.1, 1.0 + 2.3, -0.2), TURNED)
    contact = PenaltyContact(nodes, cells.top_quads(), body, pose, 7.0, len(nodes) - 1 if reference else None)
    u = 0.1 * np.random.default_rng(2).standard_normal(nodes.shape)
    assert 4 < (contact.gaps_mm(u) < 0).sum() < 36
    return contact, u


@each_body
@pytest.mark.parametrize("reference", [False, True], ids=["placed", "driven"])
def test_gradient_and_hessian_are_the_derivatives(body, reference):
    contact, u = touching(body, reference)
    gradient, hessian = contact.gradient(u), contact.hessian(u, False).toarray()
    steps = 1e-6 * np.eye(u.size).reshape(-1, *u.shape)
    slope = np.array([contact.energy(u + s) - contact.energy(u - s) for s in steps]) / 2e-6
    curve = np.stack([(contact.gradient(u + s) - contact.gradient(u - s)).ravel() for s in steps], 1) / 2e-6
    assert np.abs(slope - gradient.ravel()).max() <= 1e-7 * np.abs(gradient).max()
    assert np.abs(curve - hessian).max() <= 1e-7 * np.abs(hessian).max()
    projected = contact.hessian(u, True).toarray()
    assert np.linalg.eigvalsh(projected).min() >= -1e-12 * np.abs(projected).max()
    assert contact.max_step(u, u) == 1.0


def test_curvature_that_is_left_out_counts_near_an_equilibrium_until_the_body_is_placed():
    contact, u = touching(Sphere(3.0), False)
    contact.curvature = False
    far = contact.hessian(u, False).toarray()
    contact.approach()
    steps = 1e-6 * np.eye(u.size).reshape(-1, *u.shape)
    curve = np.stack([(contact.gradient(u + s) - contact.gradient(u - s)).ravel() for s in steps], 1) / 2e-6
    near = contact.hessian(u, False).toarray()
    assert np.abs(curve - near).max() <= 1e-7 * np.abs(near).max()
    assert np.abs(near - far).max() > 1e-3 * np.abs(near).max()
    contact.place(contact.pose)
    assert np.array_equal(contact.hessian(u, False).toarray(), far)


def test_points_that_are_held_act_alone_and_pull_until_the_body_is_placed():
    contact, u = touching(Sphere(3.0), False)
    pose, pushed = contact.pose, contact.gradient(u)
    assert contact.hold(u, Pose((0.1, 4.3, -0.2), TURNED))
    # 1 mm further away nothing touches, and the points that did are pulled
    assert not contact.pressures_mpa(u).any()
    pulled = contact.gradient(u)
    assert pulled[:, 1].sum() < 0.0 < pushed[:, 1].sum()
    assert ((pulled != 0.0) == (pushed != 0.0)).all()
    steps = 1e-6 * np.eye(u.size).reshape(-1, *u.shape)
    curve = np.stack([(contact.gradient(u + s) - contact.gradient(u - s)).ravel() for s in steps], 1) / 2e-6
    hessian = contact.hessian(u, False).toarray()
    assert np.abs(curve - hessian).max() <= 1e-7 * np.abs(hessian).max()
    contact.place(pose)
    assert np.array_equal(contact.gradient(u), pushed)


def test_force_on_the_body_balances_that_on_the_nodes():
    contact, u = touching(Sphere(3.0), True)
    gradient = contact.gradient(u)
    assert gradient[:-1].sum(axis=0) == pytest.approx(contact.force_n(u), rel=1e-12)
    assert gradient.sum(axis=0) == pytest.approx(0.0, abs=1e-13)


def test_areas_and_pressure_of_a_flat_punch():
    cells = GridBlock(np.linspace(0, 4, 5), [0.0, 1.0], np.linspace(0, 2, 3))
    punch = RoundedBox((10.0, 1.0, 10.0), 0.5)
    contact = PenaltyContact(cells.nodes_mm, cells.top_quads(), punch, Pose((2.0, 1.99, 1.0)), 5.0)
    u = np.zeros_like(cells.nodes_mm)
    assert contact.pressures_mpa(u) == pytest.approx(0.05)
    assert contact.force_n(u) == pytest.approx([0.0, 0.05 * 8.0, 0.0], abs=1e-15)
    assert contact.points_mm(u)[..., 1] == pytest.approx(1.0)


@pytest.mark.parametrize("per_side", [2, 3])
@pytest.mark.parametrize("to_border", [False, True], ids=["inside", "to the border"])
def test_an_even_pressure_has_the_nodal_forces_of_its_exact_integral(per_side, to_border):
    """Faces of uneven sides: each of their corners carries a quarter of the face, whatever rule the face has."""
    cells = GridBlock([0.0, 1.0, 1.7, 4.0], [0.0, 1.0], [0.0, 0.5, 2.0])
    quads, depth, eps = cells.top_quads(), 0.01, 5.0
    points = face_points(quads, per_side, to_border)
    punch = RoundedBox((10.0, 1.0, 10.0), 0.5)
    contact = PenaltyContact(cells.nodes_mm, points, punch, Pose((2.0, 2.0 - depth, 1.0)), eps)
    corners = cells.nodes_mm[quads]
    areas = np.ptp(corners[..., 0], axis=1) * np.ptp(corners[..., 2], axis=1)
    exact = np.zeros(len(cells.nodes_mm))
    np.add.at(exact, quads, eps * depth * areas[:, None] / 4.0)
    assert contact.gradient(np.zeros_like(cells.nodes_mm))[:, 1] == pytest.approx(exact, abs=1e-15)
    np.testing.assert_allclose(points.shares.sum(axis=1), 1.0, rtol=1e-15)


def test_points_lie_on_the_border_and_on_no_inner_side():
    cells = GridBlock(np.linspace(0, 4, 5), [0.0, 1.0], np.linspace(0, 3, 4))
    quads = cells.top_quads()
    for per_side in (2, 3):
        points = face_points(quads, per_side)
        shapes, _ = quad_shapes(points.places)
        at = np.einsum("kqa,kai->kqi", shapes, cells.nodes_mm[quads])[..., [0, 2]].reshape(-1, 2)
        on_border = (np.isclose(at, 0.0) | np.isclose(at, [4.0, 3.0])).any(axis=1)
        assert on_border.sum() == per_side * 2 * (4 + 3) - 4  # those of the corners are on two sides
        inside = at[~on_border]
        assert np.abs(inside - np.round(inside)).min() > 0.05


def test_a_sharp_body_is_met_at_more_points():
    cells = GridBlock(np.linspace(0, 8, 5), [0.0, 1.0], np.linspace(0, 8, 5))
    counts = {
        body: coat_points(cells.nodes_mm, cells.top_quads(), body).shares.shape[1]
        for body in (Sphere(3.0), Sphere(1.0), Cylinder(2.5), Cylinder(9.0, 4.0, 1.0), RoundedBox((5.0, 5.0, 5.0), 1.9))
    }
    assert list(counts.values()) == [4, 9, 4, 9, 9]


@pytest.mark.parametrize(
    ("depth_mm", "caveat"), [(0.4, "a node of the coat lies 0.23 mm inside the indenter"), (0.3, "")]
)
def test_a_corner_between_the_points_is_told(depth_mm, caveat):
    """A cube on its corner at a node misses the 2 x 2 points of faces of 2 mm; the nearest of its sides is told."""
    cells = GridBlock(np.linspace(0, 4, 3), [0.0, 1.0], np.linspace(0, 4, 3))
    quads, diagonal = cells.top_quads(), np.ones(3) / np.sqrt(3.0)
    on_corner = Rotation.align_vectors([[0.0, -1.0, 0.0]], [diagonal])[0].as_matrix()
    cube, high_mm = RoundedBox((5.0, 5.0, 5.0), 1e-6), 5.0 * np.sqrt(3.0)
    pose = Pose((2.0, 1.0 + high_mm - depth_mm, 2.0), on_corner)
    contact = PenaltyContact(cells.nodes_mm, face_points(quads), cube, pose, 5.0)
    u = np.zeros_like(cells.nodes_mm)
    assert (contact.gaps_mm(u) > 0.0).all()
    assert contact.sunk_mm(u) == pytest.approx(depth_mm / np.sqrt(3.0), abs=1e-5)
    mesh = replace(cells.mesh("mean_dilatation"), surfaces={"coat": quads})
    told = PenaltyTouch(mesh, contact).caveat(u)
    assert told.startswith(f"; {caveat} (at most 0.20 mm is allowed)") if caveat else told == ""
    finer = PenaltyContact(cells.nodes_mm, face_points(quads, 3), cube, pose, 5.0)
    assert (finer.gaps_mm(u) < 0.0).any() == bool(caveat)


class Weight:
    """A dead load on one node."""

    def __init__(self, node, force_n):
        self.node, self.force_n = node, np.asarray(force_n, dtype=float)

    def energy(self, u):
        return -float(self.force_n @ u[self.node])

    def gradient(self, u):
        out = np.zeros_like(u)
        out[self.node] = -self.force_n
        return out

    def hessian(self, u, project):
        return sp.coo_array((u.size, u.size))

    def max_step(self, u, du):
        return 1.0


def block_under_cylinder(loads):
    """A gel block 6 x 2 x 8 mm under a cylinder whose reference node is the last of the mesh."""
    cells = GridBlock(np.linspace(0, 6, 4), np.linspace(0, 2, 3), np.linspace(-4, 4, 9))
    body = len(cells.nodes_mm)
    nodes = np.vstack([cells.nodes_mm, [3.0, 12.0, 0.0]])
    contact = PenaltyContact(nodes, cells.top_quads(), Cylinder(10.0), Pose((3.0, 11.98, 0.0)), 20.0, body)
    assembly = assemble(cells.mesh("mean_dilatation", nodes), GEL, [contact, *loads(body)])
    return cells, contact, assembly, body


def test_a_body_driven_by_supports_and_one_driven_by_a_load_agree():
    cells, contact, assembly, body = block_under_cylinder(lambda body: [])
    held = Supports.at_rest(assembly.count, np.append(cells.numbers[:, 0].ravel(), body))

    def pushed(fraction):
        move = np.zeros((assembly.count, 3))
        move[body, 1] = -0.4 * fraction
        return Supports(held.fixed, move)

    reached = press(assembly, pushed)[-1]
    force = reached.gradient_n[body]
    assert force == pytest.approx(-contact.force_n(reached.state.u_mm), rel=1e-9, abs=1e-9)
    floor = reached.gradient_n[cells.numbers[:, 0].ravel()].sum(axis=0)
    # the bar is 0.5 %; the residual of 1e-6 allows far less
    assert floor + force == pytest.approx(0.0, abs=1e-5 * abs(force[1]))

    cells, _, assembly, body = block_under_cylinder(lambda body: [Weight(body, force)])
    fixed = held.fixed.copy()
    fixed[body, 1] = False
    free = Supports(fixed, np.zeros((assembly.count, 3)))
    assert press(assembly, lambda _: free)[-1].state.u_mm[body, 1] == pytest.approx(-0.4, abs=1e-5)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Sphere(0.0), "sphere: radius_mm must be above 0 mm"),
        (lambda: Cylinder(-1.0), "cylinder: radius_mm must be above 0 mm"),
        (lambda: Cylinder(3.0, 2.0, 2.5), "cylinder: edge_radius_mm must be above 0 and at most 2 mm"),
        (lambda: RoundedBox((3.0, 0.0, 1.0), 0.1), "cuboid: half_y_mm must be above 0 mm"),
        (lambda: RoundedBox((3.0, 3.0, 1.0), 0.0), "cuboid: edge_radius_mm must be above 0 and at most 1 mm"),
        (lambda: Pose((0.0, 0.0, 0.0), 2 * np.eye(3)), "proper rotation matrix"),
        (lambda: Pose((0.0, 0.0, 0.0), -np.eye(3)), "proper rotation matrix"),
    ],
)
def test_bad_bodies_are_refused(build, message):
    with pytest.raises(SimulateError, match=message):
        build()


def test_a_contact_needs_a_stiffness():
    cells = GridBlock([0.0, 1.0], [0.0, 1.0], [0.0, 1.0])
    with pytest.raises(SimulateError, match="stiffness must be above 0 MPa/mm"):
        PenaltyContact(cells.nodes_mm, cells.top_quads(), Sphere(1.0), Pose((0.0, 2.0, 0.0)), 0.0)
