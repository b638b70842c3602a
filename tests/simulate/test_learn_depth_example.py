"""The example that learns depth: its integration against known surfaces, its gradients, and that it learns at all."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

FILE = Path(__file__).resolve().parents[2] / "examples" / "learn-depth" / "learn_depth.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("learn_depth", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_slopes_of_a_known_surface_integrate_to_it(example):
    x, z = np.arange(50) * example.CELL_MM, np.arange(100) * example.CELL_MM
    u, v = x[:, None] - 15.0, z[None, :] - 40.0
    depth = 1.5 * np.exp(-(u**2 + v**2) / 18.0)
    found = example.integrated(np.stack([-u / 9.0 * depth, -v / 9.0 * depth], axis=-1), 1e6)
    # slopes are means of two neighbours: an error of cell^2 / 12 times the third derivative, 1.5 * 1.38 / 27 mm^-2,
    # over a width of 3 mm
    bound = example.CELL_MM**2 / 12.0 * 1.5 * 1.38 / 27.0 * 3.0
    assert np.abs(found - (depth - depth.mean())).max() < 2.0 * bound


def test_the_pull_to_depth_0_weakens_each_wave_by_its_length(example):
    cells, waves, reach_mm = 100, 3, 5.0
    z = (np.arange(cells) + 0.5) * example.CELL_MM
    k = waves * np.pi / (cells * example.CELL_MM)
    slopes = np.zeros((40, cells, 2))
    slopes[..., 1] = -k * np.sin(k * z)
    found = example.integrated(slopes, reach_mm)
    # the least of (slope - wanted)^2 + (depth / reach)^2; differences err by (k cell)^2 / 12, and slopes as much again
    wanted = np.cos(k * z) * k**2 / (k**2 + reach_mm**-2)
    assert np.abs(found - wanted).max() < (k * example.CELL_MM) ** 2 / 4.0


def test_gradients_are_those_of_finite_differences(example):
    rng = np.random.default_rng(0)
    network = example.Network([4, 6, 6, 2], rng)
    # with no bias a unit whose inputs are all off stands on its kink, where there is no gradient
    network.biases = [rng.normal(size=bias.shape) for bias in network.biases]
    inputs, wanted = rng.normal(size=(30, 4)), rng.normal(size=(30, 2))

    def loss():
        return float(((network.layers(inputs)[-1] - wanted) ** 2).sum() / len(inputs))

    gradients = network.gradients(inputs, wanted)
    for part, gradient in zip([*network.weights, *network.biases], gradients, strict=True):
        for at in list(np.ndindex(part.shape))[:5]:
            before, step = part[at], 1e-6
            part[at] = before + step
            above = loss()
            part[at] = before - step
            below = loss()
            part[at] = before
            assert gradient[at] == pytest.approx((above - below) / (2.0 * step), rel=1e-4, abs=1e-7)


def test_a_network_learns_a_curve_that_no_straight_line_follows(example):
    rng = np.random.default_rng(0)
    inputs = rng.uniform(-2.0, 2.0, (4096, 2))
    wanted = np.stack([np.abs(inputs[:, 0]), inputs[:, 0] * inputs[:, 1]], axis=-1)
    network = example.Network([2, 16, 16, 2], rng)
    network.train(inputs, wanted, rng)
    fresh = rng.uniform(-2.0, 2.0, (1000, 2))
    truth = np.stack([np.abs(fresh[:, 0]), fresh[:, 0] * fresh[:, 1]], axis=-1)
    unexplained = ((network.layers(fresh)[-1] - truth) ** 2).mean(axis=0) / truth.var(axis=0)
    # a straight line explains nothing of either
    assert (unexplained < 0.1).all()
