"""The elastic layer against what shares nothing with it: the equations of equilibrium, Hertz, and contact's law."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from data_schemas import SimulateError
from sim.mechanics import layer_compliance, press_layer


def sunk_by_navier(k_per_mm, thickness_mm, poisson_ratio):
    """Sink of the face under sigma = -cos k x, of shear modulus 1, from the equations of equilibrium in plane strain.

    u = U(y) sin k x along the layer and v = V(y) cos k x across it, with the base at y = 0 and the face at y = h.
    """
    ratio = 2.0 * (1.0 - poisson_ratio) / (1.0 - 2.0 * poisson_ratio)  # (lambda + 2 mu) / mu
    mixed = ratio - 1.0

    def slopes(_, y):
        u, du, v, dv = y
        return np.stack(
            [
                du, ratio * k_per_mm**2 * u + mixed * k_per_mm * dv,
                dv, (k_per_mm**2 * v - mixed * k_per_mm * du) / ratio,
            ]
        )  # fmt: skip

    def ends(base, face):
        shear = face[1] - k_per_mm * face[2]
        normal = ratio * face[3] + (ratio - 2.0) * k_per_mm * face[0]
        return np.array([base[0], base[2], shear, normal + 1.0])

    y = np.linspace(0.0, thickness_mm, 400)
    found = solve_bvp(slopes, ends, y, np.zeros((4, y.size)), tol=1e-8, max_nodes=100_000)
    assert found.success
    return -found.sol(thickness_mm)[2]


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.45, 0.49])
@pytest.mark.parametrize("k_per_mm", [0.1, 0.5, 1.0, 3.0])
def test_compliance_solves_the_equations_of_equilibrium(k_per_mm, poisson_ratio):
    found = layer_compliance(np.array([k_per_mm]), 2.0, poisson_ratio)[0]
    assert found == pytest.approx(sunk_by_navier(k_per_mm, 2.0, poisson_ratio), rel=1e-5)


def test_compliance_in_its_limits():
    k = np.array([0.0, 19.99, 20.01, 1e4])
    found = layer_compliance(k, 1.0, 0.45)
    assert found[0] == pytest.approx((1.0 - 0.9) / (2.0 - 0.9))
    np.testing.assert_allclose(found[1:], 0.55 / k[1:], rtol=1e-12)
    assert layer_compliance(np.zeros(1), 1.0, 0.5)[0] == 0.0


def ball(depth_mm, radius_mm, grid):
    away = np.hypot(grid[:, None], grid[None, :])
    cap = radius_mm - np.sqrt(np.maximum(radius_mm**2 - away**2, 0.0))
    return np.where(away < radius_mm, depth_mm - cap, -np.inf)


def test_a_ball_on_a_thick_layer_is_that_of_hertz():
    """Radius, force, pressure and the free face beside the contact, for a depth that is small against the radius."""
    radius, depth, nu, grid = 4.0, 0.04, 0.45, np.arange(-1.5, 1.5001, 0.02)
    layer = press_layer(ball(depth, radius, grid), grid, grid, 40.0, nu)
    contact = np.sqrt((layer.pressure_rel > 0.0).sum() / np.pi) * 0.02
    half_width, modulus = np.sqrt(radius * depth), 2.0 / (1.0 - nu)
    # a step of the grid; and 1 / 40 for the layer, which is a hundred contact radii thick
    assert contact == pytest.approx(half_width, abs=0.02)
    assert layer.force_mm2 == pytest.approx(4.0 / 3.0 * modulus * np.sqrt(radius) * depth**1.5, rel=0.03)
    middle = len(grid) // 2
    assert layer.pressure_rel[middle, middle] == pytest.approx(2.0 * modulus * depth / (np.pi * half_width), rel=0.03)
    r = grid[grid > 1.2 * half_width]
    s = half_width / r
    free = (half_width**2 / (np.pi * radius)) * ((2.0 - 1.0 / s**2) * np.arcsin(s) + np.sqrt(1.0 / s**2 - 1.0))
    found = layer.sunk_mm[middle, grid > 1.2 * half_width]
    # what is far away sinks less on a grid that repeats: one constant for all places
    np.testing.assert_allclose(found - found.mean(), free - free.mean(), atol=0.01 * depth)


def test_a_thin_nearly_incompressible_layer_bulges_and_keeps_its_volume():
    grid = np.arange(-10.0, 10.001, 0.1)
    layer = press_layer(ball(0.5, 4.0, grid), grid, grid, 1.0, 0.4999)
    assert layer.sunk_mm.max() == pytest.approx(0.5, abs=1e-3)
    assert -layer.sunk_mm.min() > 0.05
    # a pressure that is the same everywhere sinks nothing, so the sum over the layer is none; what lies beside the grid
    # is a hundredth of it
    assert abs(layer.sunk_mm.sum()) < 0.02 * np.abs(layer.sunk_mm).sum()


def test_contact_obeys_its_law():
    """No pull, no overlap, touching where it presses, for a body without any symmetry."""
    x, z = np.arange(-5.0, 5.001, 0.1), np.arange(0.0, 12.001, 0.1)
    wanted = 0.6 - 0.08 * (x[:, None] - 1.0) ** 2 - 0.03 * (z[None, :] - 5.0) ** 2 + 0.05 * np.sin(3.0 * x[:, None])
    wanted[(x[:, None] > 2.0) & (z[None, :] > 6.0)] = -np.inf
    layer = press_layer(wanted, x, z, 3.0, 0.48)
    touched = layer.pressure_rel > 0.0
    assert touched.any()
    assert (layer.pressure_rel >= 0.0).all()
    assert np.sqrt(np.mean((layer.sunk_mm - wanted)[touched] ** 2)) < 2e-4 * wanted.max()
    assert (layer.sunk_mm - wanted)[~touched].min() > -2e-4 * wanted.max()


def test_nothing_is_pressed_and_too_few_steps(monkeypatch):
    grid = np.arange(-1.0, 1.001, 0.1)
    layer = press_layer(np.full((21, 21), -np.inf), grid, grid, 1.0, 0.49)
    assert layer.force_mm2 == 0.0
    assert not layer.sunk_mm.any()
    monkeypatch.setattr("sim.mechanics._elastic_layer._MOST_STEPS", 2)
    with pytest.raises(SimulateError, match="was not found in 2 steps"):
        press_layer(ball(0.5, 4.0, grid), grid, grid, 1.0, 0.49)
