"""Coulomb friction of the barrier contact: derivatives at fixed lag, and the slip limit of a sliding block."""

import numpy as np
import pytest

from tests.certified.sliding_block import block_under_a_plate, drag

RATIO = 0.3


def differentiated(function, at, direction, step=1e-7):
    """Derivative along a direction by four points; the step is small beside the stick's 1e-3 mm."""
    f = [function(at + k * step * direction) for k in (-2, -1, 1, 2)]
    return (8.0 * (f[2] - f[1]) - (f[3] - f[0])) / (12.0 * step)


def test_derivatives_of_friction_at_fixed_lag():
    block, nodes, contact = block_under_a_plate(RATIO, project=False)
    rng = np.random.default_rng(0)
    u = 1e-3 * rng.standard_normal(nodes.shape)
    u[-1, 1] = -0.01
    contact.accept(u)
    contact.restart()
    # slips within the smooth range, and far beyond it
    for slip_mm in (4e-4, 0.03):
        there = u.copy()
        there[-1, 0] += slip_mm
        there[: len(block.nodes_mm)] += 1e-5 * rng.standard_normal(block.nodes_mm.shape)
        direction = rng.standard_normal(u.shape)
        exact = contact.hessian(there, False).tocsr() @ direction.ravel()
        change = differentiated(contact.gradient, there, direction).ravel()
        assert np.linalg.norm(change - exact) < 1e-7 * np.linalg.norm(exact)
        slope = differentiated(contact.energy, there, direction)
        assert slope == pytest.approx(float((contact.gradient(there) * direction).sum()), rel=1e-7)


def slide(ratio):
    """Press a plate 0.1 mm into a block, drag it 2 mm along x; forces on the plate at each step."""
    stops = [1.0, 1.05, 1.2, 1.4, 1.7, 2.0, 2.4, 3.0]
    forces = {round(at.share, 6): at.contact.force_n(at.state.u_mm) for at in drag(ratio, stops)}
    return np.array([forces[stop] for stop in stops])


@pytest.mark.parametrize("ratio", [RATIO, 0.8])
def test_a_sliding_block_reaches_the_slip_limit_and_no_more(ratio):
    forces = slide(ratio)
    tangential, normal = -forces[:, 0], forces[:, 1]
    assert (normal > 1.0).all()
    # it sticks at first, and drags the block along
    assert 0.0 < tangential[1] < 0.9 * ratio * normal[1]
    # Coulomb: sliding everywhere, force is mu N in its direction
    np.testing.assert_allclose(tangential[-2:], ratio * normal[-2:], rtol=0.005)
    # lagged to 1e-3 of the normal force, as is stated
    assert (tangential <= 1.005 * ratio * normal).all()


def test_without_friction_a_plate_drags_nothing():
    forces = slide(0.0)
    assert np.abs(forces[:, [0, 2]]).max() < 1e-6 * forces[:, 1].min()
