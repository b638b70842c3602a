"""Friction with stick and slip: its law, its work, and half-spaces that a sphere shears and a flat punch twists.

The closed forms are those of small strain and of an incompressible half-space, in which pressure and shear do not act
on each other: C. Cattaneo (1938), R. D. Mindlin (1949) and the torsion of a rigid punch (K. L. Johnson, 1985, chapter
7). None of them knows of elements, increments, a penalty or a return mapping.
"""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from sim.mechanics import Pose, RoundedBox, SlidingContact, Sphere
from sim.mechanics._increments import Load, load_increments
from sim.mechanics._linear_solver import linear_solver
from sim.mechanics._materials import neo_hooke
from sim.mechanics._newton import Supports
from tests.certified.blocks import GridBlock, assemble, stretched, unit_cells

SHEAR_MPA, BULK_OVER_SHEAR = 0.27, 2000.0
GEL = neo_hooke(SHEAR_MPA / 2.0, BULK_OVER_SHEAR)
RATIO = 0.3


def face_under_a_ball(ratio, turn=None):
    """A block's top under a ball of 10 mm that is 0.05 mm deep in it; both turned if asked for."""
    turn = np.eye(3) if turn is None else turn
    block = unit_cells(3, 1, 3, size=(3.0, 1.0, 3.0))
    nodes = block.nodes_mm @ turn.T

    def pose(move, rotation_deg=(0.0, 0.0, 0.0)):
        own = Rotation.from_rotvec(rotation_deg, degrees=True).as_matrix()
        place = turn @ (np.array([1.4, 10.95, 1.6]) + move)
        return Pose(tuple(place), turn @ own @ turn.T)

    return SlidingContact(nodes, block.top_quads(), Sphere(10.0), pose((0, 0, 0)), 5.0, ratio), nodes, pose


def differentiated(function, at, direction, step):
    """Derivative along a direction by four points."""
    f = [function(at + k * step * direction) for k in (-2, -1, 1, 2)]
    return (8.0 * (f[2] - f[1]) - (f[3] - f[0])) / (12.0 * step)


@pytest.mark.parametrize("aside_mm", [1e-3, 0.2])
def test_derivatives_at_given_limits(aside_mm):
    contact, nodes, pose = face_under_a_ball(RATIO)
    contact.restart(pose((aside_mm, 0.0, 0.0)))
    rng = np.random.default_rng(1)
    u = 1e-5 * rng.standard_normal(nodes.shape)
    direction = rng.standard_normal(nodes.shape)
    # some stick at the small way, all slip at the large one
    assert (contact.slips_mm(u).max() > 0.0) == (aside_mm > 0.1)
    slope = differentiated(contact.energy, u, direction, 1e-6)
    assert slope == pytest.approx(float((contact.gradient(u) * direction).sum()), rel=1e-6)
    # the ball's curvature is left out of the second derivative, as in every press: what friction adds is compared
    free, _, _ = face_under_a_ball(0.0)
    free.place(contact.pose)
    change = differentiated(lambda v: contact.gradient(v) - free.gradient(v), u, direction, 1e-6).ravel()
    exact = (contact.hessian(u, False).tocsr() - free.hessian(u, False).tocsr()) @ direction.ravel()
    assert np.linalg.norm(change - exact) < 1e-6 * np.linalg.norm(exact)


def dragged(contact, pose, ways_mm, nodes):
    """Force on the ball, energy stored and work lost at each place of a ball that is dragged over a still face."""
    still, rows = np.zeros_like(nodes), []
    for way in ways_mm:
        contact.restart(pose((way, 0.0, 0.0)))
        while not contact.settle(still):
            pass
        rows.append((contact.force_n(still)[0], contact.stored_energy(still), contact.friction_work_n_mm(still)))
        contact.accept(still)
    return np.array(rows).T


def test_a_loop_of_dragging_loses_the_work_that_the_hand_does():
    contact, nodes, pose = face_under_a_ball(RATIO)
    there = np.linspace(0.0, 0.3, 301)
    ways = np.concatenate([there, there[::-1][1:], there[1:]])
    force, stored, lost = dragged(contact, pose, ways, nodes)
    # both ends of the loop are slid to from the left: the second round is closed
    second = slice(300, 901)
    work = -np.trapezoid(force[second], ways[second])
    # 300 points of a loop with two bends; the force is that of the end of an increment, of 1/300 of the way
    assert lost[301:901].sum() + stored[900] - stored[300] == pytest.approx(work, rel=5e-3)
    assert lost[301:901].sum() > 0.9 * work
    # it pulls one way, then the other, by the same force at the same place but for the ball's own sidewise push
    assert force[450] * force[750] < 0.0


def test_friction_is_the_law_of_coulomb_at_every_point():
    contact, nodes, pose = face_under_a_ball(RATIO)
    still = np.zeros_like(nodes)
    dragged(contact, pose, [0.0, 1e-4, 3e-4], nodes)
    pressure = contact.pressures_mpa(still)
    shear = np.linalg.norm(contact.shears_mpa(still), axis=-1)
    assert (shear <= RATIO * pressure * (1.0 + 1e-3)).all()  # limits are settled to a thousandth
    slips = contact.slips_mm(still) > 0.0
    np.testing.assert_allclose(shear[slips], RATIO * pressure[slips], rtol=1e-3)
    # a ball that has turned back has no shear left where it never slipped
    stuck = (pressure > 0.0) & ~slips
    dragged(contact, pose, [0.0], nodes)
    assert np.abs(contact.shears_mpa(still)[stuck]).max() < 1e-3 * shear.max()


def test_the_same_in_turned_axes():
    turn = Rotation.from_rotvec([20.0, -70.0, 40.0], degrees=True).as_matrix()
    rng = np.random.default_rng(3)
    plain, nodes, pose = face_under_a_ball(RATIO)
    turned, _, turned_pose = face_under_a_ball(RATIO, turn)
    moves = [((0.01, -0.01, 0.0), (0, 0, 0)), ((0.1, -0.02, 0.05), (0, 10, 0)), ((0.0, -0.02, 0.1), (5, 20, -3))]
    for move, rotation in moves:
        u = 1e-3 * rng.standard_normal(nodes.shape)
        for contact, place, at in ((plain, pose, u), (turned, turned_pose, u @ turn.T)):
            contact.restart(place(move, rotation))
            while not contact.settle(at):
                pass
            contact.accept(at)
        np.testing.assert_allclose(turned.gradient(u @ turn.T), plain.gradient(u) @ turn.T, atol=1e-12)
        np.testing.assert_allclose(turned.torque_n_mm(u @ turn.T), turn @ plain.torque_n_mm(u), atol=1e-10)
        assert turned.energy(u @ turn.T) == pytest.approx(plain.energy(u), rel=1e-9)
        assert np.linalg.norm(plain.shears_mpa(u)) > 0.0


class HalfSpaceAround:
    """Displacements on the far faces of a block of an incompressible half-space, by the force on its top's origin.

    u_i = (delta_ij / r + r_i r_j / r^3) F_j / (4 pi G): a force in the full space twice over, as it leaves the plane
    through it free where the solid is incompressible. The force is renewed at equilibria until it has settled.
    """

    def __init__(self, nodes, far, held):
        self.nodes, self.far, self.force_n = nodes, far, np.zeros(3)
        fixed = held.copy()
        fixed[far] = True
        self.supports = Supports(fixed, np.zeros_like(nodes))

    def settle(self, force_n):
        """Renew the displacements; return whether they have hardly changed."""
        r = self.nodes[self.far]
        size = np.linalg.norm(r, axis=1)[:, None]
        move = (force_n / size + r * (r @ force_n)[:, None] / size**3) / (4.0 * np.pi * SHEAR_MPA)
        change = np.linalg.norm(force_n - self.force_n)
        self.force_n = force_n
        self.supports.displacement_mm[self.far] = move
        # what lies on the plane of symmetry stays there: the force has no part across it
        return bool(change <= 2e-3 * np.linalg.norm(force_n))


def sheared_sphere(shares, radius_mm=10.0, depth_mm=0.1, size_mm=8.0, cells=(12, 10), growth=3.6):
    """Press a sphere into half a block, then move it aside by shares of the way to full slip.

    Returns Q / mu P and the stick radius over the contact's, each share.
    """
    half, down = stretched(cells[0], size_mm, growth), stretched(cells[1], size_mm, growth)
    block = GridBlock(np.concatenate([-half[:0:-1], half]), -down[::-1], half)
    nodes, n = block.nodes_mm, block.numbers
    held = np.zeros_like(nodes, dtype=bool)
    held[n[:, :, 0].ravel(), 2] = True
    far = np.unique(np.concatenate([n[0].ravel(), n[-1].ravel(), n[:, 0].ravel(), n[:, :, -1].ravel()]))
    around = HalfSpaceAround(nodes, far, held)
    top = block.top_quads()
    near = np.linalg.norm(nodes[top].mean(axis=1)[:, [0, 2]], axis=1) < 2.0 * np.sqrt(radius_mm * depth_mm)
    eps = 100.0 * SHEAR_MPA / half[1]
    contact = SlidingContact(nodes, top[near], Sphere(radius_mm), Pose((0, radius_mm, 0)), eps, RATIO)
    assembly = assemble(block.mesh("mean_dilatation"), GEL, [contact])
    patch_mm = np.sqrt(radius_mm * depth_mm)
    push_n = 16.0 / 3.0 * SHEAR_MPA * patch_mm**3 / radius_mm
    whole_mm = 3.0 * RATIO * push_n * 1.5 / (16.0 * patch_mm * SHEAR_MPA)
    poses = [(depth_mm / 2.0, 0.0), (depth_mm, 0.0), *((depth_mm, s * whole_mm) for s in shares)]

    def loading(share):
        k = min(int(share), len(poses) - 1)
        before = np.array(poses[k - 1] if k else (0.0, 0.0))
        down_mm, aside_mm = before + (share - k) * (np.array(poses[k]) - before)
        contact.restart(Pose((aside_mm, radius_mm - down_mm, 0.0)))
        return around.supports

    def settle(state):
        force = contact.force_n(state.u_mm)
        far_settled = around.settle(-2.0 * np.array([force[0], force[1], 0.0]))
        return contact.settle(state.u_mm) and far_settled

    load = Load(loading, settle, accept=lambda state: contact.accept(state.u_mm))
    corners = nodes[top[near]]
    across = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    areas = np.repeat(np.linalg.norm(across, axis=1)[:, None] / 8.0, 4, axis=1)
    rows = []
    for step in load_increments(assembly, linear_solver(), load, [k + 1.0 for k in range(len(poses))]):
        if step.fraction != int(step.fraction) or step.fraction <= 2.0:
            continue
        u = step.equilibrium.state.u_mm
        touches, slips = contact.pressures_mpa(u) > 0.0, contact.slips_mm(u) > 0.0
        force = contact.force_n(u)
        rows.append((-force[0] / (RATIO * force[1]), np.sqrt(areas[touches & ~slips].sum() / areas[touches].sum())))
    return np.array(rows).T


def test_a_sheared_sphere_is_that_of_cattaneo_and_mindlin():
    shares = np.array([0.25, 0.5, 0.8, 1.3])
    pull, stick = sheared_sphere(shares)
    # d = 3 mu P (2 - nu) / (16 a G) (1 - (1 - Q / mu P)^(2/3)); the bar: 3 % of the limit. 15 elements in the patch
    expected = 1.0 - np.maximum(1.0 - shares, 0.0) ** 1.5
    np.testing.assert_allclose(pull, expected, atol=0.03)
    # c / a = (1 - Q / mu P)^(1/3), by the areas of points, of which the patch's radius is some 15: half a point or so
    np.testing.assert_allclose(stick, np.cbrt(np.maximum(1.0 - pull, 0.0)), atol=0.05)
    assert stick[-1] == 0.0


class Turned:
    """Nodes of two faces of a wedge, the second of which does what the first does: k/2 sum |u_b - R u_a|^2."""

    def __init__(self, first, second, turn, stiffness, count):
        pick = sp.csr_array((np.ones(len(first)), (np.arange(len(first)), first)), shape=(len(first), count))
        other = sp.csr_array((np.ones(len(second)), (np.arange(len(second)), second)), shape=(len(second), count))
        apart = sp.kron(other, np.eye(3)) - sp.kron(pick, turn)
        self.matrix = (stiffness * (apart.T @ apart)).tocoo()

    def energy(self, u):
        return 0.5 * float(u.ravel() @ (self.matrix @ u.ravel()))

    def gradient(self, u):
        return (self.matrix @ u.ravel()).reshape(-1, 3)

    def hessian(self, u, project):
        return self.matrix

    def max_step(self, u, du):
        return 1.0


WEDGE_RAD = np.radians(3.0)


def twisted_punch(shares, cells=20, halves=80.0, growth=1.3, depth_mm=0.01):
    """Press a flat punch of radius 1 mm into a wedge of a half-space, then turn it by shares of the first slip's angle.

    Returns the torque over mu P a, the torque over that of full stick, the radius up to which it sticks, and how near
    the shear is to its limit, over what the closed form of full stick says.
    """
    steps = [1.0 / cells] * int(1.4 * cells)
    while sum(steps) < halves:
        steps.append(growth * steps[-1])
    places = np.concatenate([[0.0], np.cumsum(steps)])
    block = GridBlock([0.0, WEDGE_RAD], -places[::-1], places)
    turn, y, radius = block.nodes_mm.T
    radius = np.maximum(radius, 0.01 * places[1])
    nodes = np.column_stack([radius * np.sin(turn), y, radius * np.cos(turn)])
    fixed = Supports.at_rest(len(nodes), block.numbers[:, 0].ravel()).fixed
    fixed[np.ix_(block.numbers[:, :, 0].ravel(), [0, 2])] = True
    fixed[block.numbers[:, :, -1].ravel()] = True
    about = Rotation.from_rotvec([0.0, WEDGE_RAD, 0.0]).as_matrix()
    round_it = Turned(block.numbers[0].ravel(), block.numbers[1].ravel(), about, 1e4, len(nodes))
    top = block.top_quads()
    # only the disc can touch, so that a flat body over it is a flat punch with a sharp rim
    disc = top[np.linalg.norm(nodes[top].mean(axis=1)[:, [0, 2]], axis=1) < 1.0]
    flat, eps = RoundedBox((5.0, 1.0, 5.0), 0.1), 100.0 * SHEAR_MPA * cells

    def pose(down_mm, angle):
        return Pose((0.0, 1.0 - down_mm, 0.0), Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix())

    contact = SlidingContact(nodes, disc, flat, pose(0.0, 0.0), eps, RATIO)
    assembly = assemble(block.mesh("mean_dilatation", nodes), GEL, [contact, round_it])
    first = RATIO * depth_mm  # mu P / (8 G a^2), with P = 8 G a d
    angles = [0.0, *(share * first for share in shares)]

    def loading(share):
        k = min(int(share), len(angles) - 1)
        before = angles[k - 1] if k else 0.0
        contact.restart(pose(depth_mm * min(share, 1.0), before + (share - k) * (angles[k] - before)))
        return Supports(fixed, np.zeros_like(nodes))

    settle = Load(loading, lambda state: contact.settle(state.u_mm), accept=lambda state: contact.accept(state.u_mm))
    rows, whole = [], 2.0 * np.pi / WEDGE_RAD
    for step in load_increments(assembly, linear_solver(), settle, [k + 1.0 for k in range(len(angles))]):
        if step.fraction != int(step.fraction) or step.fraction < 2.0:
            continue
        u = step.equilibrium.state.u_mm
        push, torque = whole * contact.force_n(u)[1], -whole * contact.torque_n_mm(u)[1]
        angle = angles[int(step.fraction) - 1]
        at_mm = np.linalg.norm(contact.points_mm(np.zeros_like(nodes))[..., [0, 2]], axis=-1)
        shear = np.linalg.norm(contact.shears_mpa(u), axis=-1) / (RATIO * contact.pressures_mpa(u))
        inside = (at_mm > 0.3) & (at_mm < 0.85)
        sticks = contact.slips_mm(u) == 0.0
        stick_mm = float(at_mm[~sticks].min()) if (~sticks).any() else 1.0
        near_limit = float(np.mean(shear[inside] / at_mm[inside])) * first / angle
        rows.append((torque / (RATIO * push), torque / (16.0 / 3.0 * SHEAR_MPA * angle), stick_mm, near_limit))
    return np.array(rows).T


def test_a_twisted_punch_slips_as_its_closed_forms_say():
    shares = [0.5, 0.9, 1.1, 2.0, 4.0, 8.0]
    over_limit, over_stick, stick_mm, near_limit = twisted_punch(shares)
    # Reissner and Sagoci: T = 16/3 G a^3 phi while all of it sticks; the bar of all of this is 3 %
    np.testing.assert_allclose(over_stick[:2], 1.0, atol=0.03)
    # the shear over mu p is r / a times the angle over the first slip's: the rim slips first, at T = 2/3 mu P a
    assert near_limit[0] == pytest.approx(1.0, abs=0.03)
    # the force comes out too high by some 1 % for the block's size and 2 % for the rim's element
    assert over_limit[0] / 0.5 == pytest.approx(2.0 / 3.0, rel=0.03)
    # pressure grows without bound at the rim: the last element of 0.05 a does not tell, the others stick until then
    assert stick_mm[0] > 0.9
    assert stick_mm[2] < 1.0
    assert (np.diff(stick_mm) <= 0.0).all()
    # and slip is full at pi/4 mu P a
    assert over_limit[-1] == pytest.approx(np.pi / 4.0, rel=0.03)
