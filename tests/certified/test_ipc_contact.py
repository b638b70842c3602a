"""Barrier contact: derivatives, agreement with the penalty on exact distances, contact of two parts, refusals."""

import numpy as np
import pytest

from data_schemas import SimulateError
from sim import preset_design
from sim.mechanics import Cylinder, PenaltyContact, Pose, PressSettings, body_mesh, press_finger
from sim.mechanics._barrier_contact import Drive
from sim.mechanics._materials import neo_hooke
from sim.mechanics._newton import Supports
from sim.surface_meshes import boundary_quads, split_quads
from tests.certified.barrier_contact import Barrier, BarrierContact, Obstacle
from tests.certified.blocks import GridBlock, assemble, press, unit_cells

SHEAR_MPA = 0.2666
GEL = neo_hooke(SHEAR_MPA / 2.0, 20.0)
BODY = Cylinder(10.0)
DEPTH_MM = 0.4


def outside(block):
    return split_quads(boundary_quads(block.hexahedra).quads, block.nodes_mm)


def pad():
    """A block 4 mm high under a cylinder across it."""
    return GridBlock(np.linspace(-3.0, 3.0, 4), np.linspace(0.0, 4.0, 3), np.linspace(-8.0, 8.0, 17))


def barrier_press(reach_mm, ratio=0.0):
    """Force of the push and the gap that is left, with the cylinder's true surface at first touch at the start."""
    block = pad()
    reference = len(block.nodes_mm)
    nodes = np.vstack([block.nodes_mm, [0.0, 14.0, 0.0]])
    facets = body_mesh(BODY, 0.001, 4.0)
    obstacle = Obstacle(facets.vertices_mm + np.array([0.0, 14.0 + reach_mm, 0.0]), facets.triangles, reference)
    contact = BarrierContact(nodes, outside(block), obstacle, Barrier(reach_mm, SHEAR_MPA, ratio))
    drive = Drive(reference, 1, met_mm=1e-6)
    assembly = assemble(block.mesh("mean_dilatation", nodes), GEL, [contact, drive])
    supports = Supports.at_rest(len(nodes), block.numbers[:, 0].ravel())
    supports.fixed[reference] = (True, False, True)
    drive.target_mm = -DEPTH_MM - reach_mm
    (reached,) = press(assembly, lambda share: supports)
    u = reached.state.u_mm
    return contact.force_n(u)[1], contact.gap_mm(u)


def test_penalty_and_barrier_agree_at_no_gap():
    block = pad()
    stiffness = 3000.0 * SHEAR_MPA  # sinks in by 0.1 um at this push
    contact = PenaltyContact(block.nodes_mm, block.top_quads(), BODY, Pose((0.0, 14.0, 0.0)), stiffness)
    assembly = assemble(block.mesh("mean_dilatation"), GEL, [contact])
    supports = Supports.at_rest(len(block.nodes_mm), block.numbers[:, 0].ravel())

    def loading(share):
        contact.place(Pose((0.0, 14.0 - share * DEPTH_MM, 0.0)))
        return supports

    penalty = contact.force_n(press(assembly, loading, (0.25, 0.5, 1.0))[-1].state.u_mm)[1]
    coarse, fine = barrier_press(0.02), barrier_press(0.01)
    assert coarse[1] > fine[1] > 0.0
    # the barrier keeps a gap, as if the cylinder were larger: force falls linearly with it
    slope = (coarse[0] - fine[0]) / (coarse[1] - fine[1])
    at_no_gap = fine[0] - slope * fine[1]
    assert abs(at_no_gap - penalty) < abs(coarse[0] - penalty) / 3.0
    # what is left: the barrier feels the faces' edges, the penalty their Gauss points (chords of h^2 / 8R = 12 um)
    assert at_no_gap == pytest.approx(penalty, rel=0.02)


def test_derivatives():
    block = unit_cells(3, 2, 3, size=(6.0, 3.0, 6.0))
    nodes = np.vstack([block.nodes_mm, [0.0, 0.0, 0.0]])
    corners = np.array([[-40.0, 3.01, -40.0], [80.0, 3.01, -40.0], [0.0, 3.02, 80.0]])
    obstacle = Obstacle(corners, np.array([[0, 1, 2]]), len(nodes) - 1)
    contact = BarrierContact(nodes, outside(block), obstacle, Barrier(), project=False)
    rng = np.random.default_rng(0)
    u, direction, step = 1e-3 * rng.standard_normal(nodes.shape), rng.standard_normal(nodes.shape), 1e-7
    values = [u + k * step * direction for k in (-2, -1, 1, 2)]

    def change(function):
        """Derivative by four points; the step is small beside the gap of 0.01 mm."""
        f = [function(v) for v in values]
        return (8.0 * (f[2] - f[1]) - (f[3] - f[0])) / (12.0 * step)

    gradient = contact.gradient(u)
    assert change(contact.energy) == pytest.approx(float((gradient * direction).sum()), rel=1e-7)
    exact = contact.hessian(u, False).tocsr() @ direction.ravel()
    assert np.linalg.norm(change(contact.gradient).ravel() - exact) < 1e-7 * np.linalg.norm(exact)
    # what the parts are pushed with is what the obstacle is pushed back with
    assert np.abs(gradient.sum(axis=0)).max() < 1e-12 * np.abs(gradient).max()
    projected = contact.hessian(u, True).toarray()
    assert np.linalg.eigvalsh(projected).min() > -1e-9 * np.abs(projected).max()


def test_two_blocks_that_meet_share_the_push():
    low, high = unit_cells(2, 2, 2, size=(2.0, 2.0, 2.0)), unit_cells(3, 2, 3, size=(2.0, 2.0, 2.0))
    count, start = len(low.nodes_mm), 2.3
    nodes = np.concatenate([low.nodes_mm, high.nodes_mm + np.array([0.0, start, 0.0])])
    low.hexahedra = np.concatenate([low.hexahedra, high.hexahedra + count])
    contact = BarrierContact(nodes, split_quads(boundary_quads(low.hexahedra).quads, nodes), None, Barrier())
    assembly = assemble(low.mesh("mean_dilatation", nodes), GEL, [contact])
    fixed = np.zeros((len(nodes), 3), dtype=bool)
    bottom, top = low.numbers[:, 0].ravel(), high.numbers[:, -1].ravel() + count
    fixed[bottom, 1] = fixed[top, 1] = True
    for numbers, shift in ((low.numbers, 0), (high.numbers, count)):
        # rollers: each block may widen from one corner
        fixed[numbers[0].ravel() + shift, 0] = fixed[numbers[:, :, 0].ravel() + shift, 2] = True
    push = 0.7

    def loading(share):
        displacement = np.zeros_like(nodes)
        displacement[top, 1] = -push * share
        return Supports(fixed, displacement)

    reached = press(assembly, loading, (0.4, 0.45, 0.6, 0.8, 1.0))[-1]
    gap = contact.gap_mm(reached.state.u_mm)
    assert 0.0 < gap < 0.02
    force = -reached.gradient_n[top, 1].sum()
    assert force == pytest.approx(reached.gradient_n[bottom, 1].sum(), rel=1e-6)
    # each block is squeezed evenly by half of what is left of the push
    squeezed = (push - (start - 2.0) + gap) / 2.0
    one = unit_cells(1, 1, 1, size=(2.0, 2.0, 2.0))
    held = np.zeros((8, 3), dtype=bool)
    held[one.numbers[:, [0, -1]].ravel(), 1] = held[one.numbers[0].ravel(), 0] = held[
        one.numbers[:, :, 0].ravel(), 2
    ] = True
    down = np.zeros((8, 3))
    down[one.numbers[:, -1].ravel(), 1] = -squeezed
    alone = press(assemble(one.mesh("mean_dilatation"), GEL), lambda share: Supports(held, share * down))[-1]
    # the gap is not quite even over faces that do not match; 0.02 mm of 0.21 mm is known to a share of it
    assert force == pytest.approx(-alone.gradient_n[one.numbers[:, -1].ravel(), 1].sum(), rel=0.01)


def test_the_drive_foresees_its_force_where_it_has_met_two_targets():
    # a force of 2 N at 1 mm and of 5 N at 3 mm: 6.5 N at 4 mm, so that the target is met at once
    drive, u = Drive(0, 1, stiffness_n_per_mm=10.0), np.zeros((1, 3))
    for target_mm, force_n in ((-1.0, 2.0), (-3.0, 5.0)):
        drive.aim(target_mm)
        u[0, 1] = target_mm
        drive.settle(u + (force_n - drive.gradient(u)) / 10.0)
        assert drive.gradient(u)[0, 1] == pytest.approx(force_n)
        drive.keep()
    for _ in range(2):  # an increment that begins again goes by what was kept
        drive.aim(-4.0)
        u[0, 1] = -4.0
        assert drive.gradient(u)[0, 1] == pytest.approx(6.5)
        assert drive.settle(u)
        drive.settle(u + 0.1)


def test_the_drive_foresees_nothing_from_a_stored_state_whose_force_it_never_found():
    # 5 N at 2 mm after a state at 1.98 mm that was read from a record: its slope would be 250 N/mm
    drive, u = Drive(0, 1), np.zeros((1, 3))
    drive.aim(-1.98)
    u[0, 1] = -1.98 + 1e-6
    assert drive.settle(u)
    drive.keep()
    drive.aim(-2.0)
    u[0, 1] = -2.0
    drive.settle(u + (5.0 - drive.gradient(u)) / 1e4)
    drive.keep()
    drive.aim(-2.5)
    u[0, 1] = -2.5
    assert drive.gradient(u)[0, 1] == pytest.approx(5.0)


def test_an_obstacle_inside_is_refused():
    block = pad()
    facets = body_mesh(BODY, 0.05, 4.0)
    nodes = np.vstack([block.nodes_mm, [0.0, 0.0, 0.0]])
    obstacle = Obstacle(facets.vertices_mm + np.array([0.0, 13.0, 0.0]), facets.triangles, len(nodes) - 1)
    with pytest.raises(SimulateError, match="the indenter starts inside the finger"):
        BarrierContact(nodes, outside(block), obstacle)


def test_what_is_tied_or_thin_at_rest_does_not_collide():
    # two sheets at 0.1 mm: one thin part, or two that are glued
    low, high = unit_cells(2, 1, 2), unit_cells(2, 1, 2)
    nodes = np.concatenate([low.nodes_mm, high.nodes_mm + np.array([0.0, 1.01, 0.0])])
    hexahedra = np.concatenate([low.hexahedra, high.hexahedra + len(low.nodes_mm)])
    contact = BarrierContact(nodes, split_quads(boundary_quads(hexahedra).quads, nodes), None, Barrier(reach_mm=0.05))
    assert contact.energy(np.zeros_like(nodes)) == 0.0
    assert contact.gap_mm(np.zeros_like(nodes)) == np.inf


@pytest.mark.parametrize(("friction", "within"), [(0.0, 0.06), (0.8, 0.06)])
def test_a_finger_pressed_with_either_contact(friction, within):
    design = preset_design("baby-48x18")
    update = {"depth_mm": 0.5, "friction": friction}
    design = design.model_copy(update={"indenter": design.indenter.model_copy(update=update)})
    penalty, barrier = (
        press_finger(design, PressSettings("coarse", 1, contact=kind)) for kind in ("penalty", "barrier")
    )
    assert not barrier.unreached
    # both touch along chords of elements of 2 mm, h^2 / 8R = 50 um of the 500 um, at other points of them
    assert barrier.force_n[-1, 1] == pytest.approx(penalty.force_n[-1, 1], rel=within)
    assert len(barrier.mesh.nodes_mm) == len(penalty.mesh.nodes_mm) + 1
    assert "barrier" in barrier.contact
    assert "contact between ribs is not computed" in penalty.contact
