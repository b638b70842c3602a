"""The few-node rule against the full sum over wavelengths, and its Gauss nodes against numpy's."""

import numpy as np
import pytest

from data_schemas import Optics
from finray_calib.fit import EmissionPrior
from finray_calib.spectra import (
    FAMILIES,
    EmissionWeights,
    band_quadrature,
    emission_weights,
    gauss_nodes,
    rig_emission_weights,
)
from tests.fit.synthetic_bands import orange

CHANNEL_WEIGHTS = (0.01, 0.09, 0.9)
# a tenth of the best band calibration, and a third of what stray light is taken to be of the brightest band
LARGEST_ERROR_REL = 1e-3


def by_rule(rule, weights, family, theta):
    """Return the (n, N) emission and leaked emission of parameter rows by the few-node rule."""
    at_nodes = family.curves(theta, rule.nodes_nm.ravel()).reshape(len(theta), *rule.nodes_nm.shape)
    at_grid = family.curves(theta, rule.grid_nm)
    in_band = np.einsum("rq,nrq->nr", rule.in_band, at_nodes[:, weights.band_index])
    return in_band + at_grid @ rule.out_of_band.T, at_grid @ rule.leaked.T


def weights_with(optics: Optics, shape_order: float, fwhm_nm: float) -> EmissionWeights:
    filters = tuple(f.model_copy(update={"shape_order": shape_order, "fwhm_nm": fwhm_nm}) for f in optics.filters)
    return rig_emission_weights(optics.model_copy(update={"filters": filters}), CHANNEL_WEIGHTS)


@pytest.fixture(scope="module", params=[(1.0, 10.0), (2.0, 10.0), (4.0, 13.0)], ids=["Gaussian", "flat", "hard-coated"])
def measured(request, optics):
    """Weights and rule of the assumed camera with 10 nm Gaussian, 10 nm flat-topped and 13 nm square filters."""
    weights = weights_with(optics, *request.param)
    return weights, band_quadrature(weights)


@pytest.mark.parametrize("name", list(FAMILIES))
def test_rule_equals_the_full_sum_over_the_prior(measured, name):
    weights, rule = measured
    family = FAMILIES[name]
    theta = EmissionPrior().of(family, with_blocking=True).draw(600, np.random.default_rng(7))
    theta = theta[theta[:, 1] >= np.log(20.0)]
    full = family.curves(theta, weights.wavelength_nm) @ weights.emission.T
    got, _ = by_rule(rule, weights, family, theta)
    brightest = full.max(axis=1, keepdims=True)
    error = np.abs(got - full) / (full + brightest)
    # kinked curves (the strongest skews) between two points of the shared grid are the exception: one in a hundred
    assert np.quantile(error, 0.99) < LARGEST_ERROR_REL
    # and wholly wrong for none: such a kink misses at most the width of a grid cell of the 40 nm of leaked light
    assert error.max() < 0.05


def test_smooth_emission_is_integrated_to_a_thousandth_of_every_band_value(measured):
    """Two Gaussians of 30 nm and more; the faintest values are light that only leaks through a filter."""
    weights, rule = measured
    family = FAMILIES["gaussian_mixture"]
    theta = EmissionPrior().of(family, with_blocking=True).draw(600, np.random.default_rng(8))
    theta = theta[theta[:, 1] + np.minimum(theta[:, 4], 0.0) >= np.log(30.0)]
    full = family.curves(theta, weights.wavelength_nm) @ weights.emission.T
    got, leaked = by_rule(rule, weights, family, theta)
    bright = full > 0.01 * full.max(axis=1, keepdims=True)
    assert bright.sum() > 1000
    assert np.abs(got / full - 1)[bright].max() < LARGEST_ERROR_REL
    through = family.curves(theta, weights.wavelength_nm) @ weights.leaked_emission.T
    bright = through > 0.01 * through.max(axis=1, keepdims=True)
    assert np.abs(leaked[bright] / through[bright] - 1).max() < LARGEST_ERROR_REL


@pytest.mark.parametrize("name", list(FAMILIES))
def test_the_band_below_the_laser_sees_emission_through_its_leak(measured, name):
    """The 405 nm filter: one Gauss rule for pass band and floor would lose up to a fifth of its little light."""
    weights, rule = measured
    theta = orange(name)[None]
    full = FAMILIES[name].curves(theta, weights.wavelength_nm) @ weights.emission.T
    got, _ = by_rule(rule, weights, FAMILIES[name], theta)
    # the blue channel is blind to the red light that leaks: a ten-millionth of what the red one sees is nothing
    assert np.allclose(got[0, :3], full[0, :3], rtol=LARGEST_ERROR_REL, atol=1e-7 * full[0, 0])


def test_straight_lines_are_integrated_exactly(measured):
    """Degree 1 lies within both parts, Gauss nodes in the band and splines outside."""
    weights, rule = measured
    for slope in (0.0, 1e-5):
        line = 0.001 + slope * (weights.wavelength_nm - 560)
        nodes, grid = 0.001 + slope * (rule.nodes_nm - 560), 0.001 + slope * (rule.grid_nm - 560)
        in_band = np.einsum("rq,rq->r", rule.in_band, nodes[weights.band_index])
        assert np.allclose(in_band + rule.out_of_band @ grid, weights.emission @ line, rtol=1e-10, atol=0)
        assert np.allclose(rule.leaked @ grid, weights.leaked_emission @ line, rtol=1e-10, atol=0)


def test_rule_of_a_rig_without_leak(rig):
    curves = rig.sampled(np.arange(380.0, 781.0))
    weights = emission_weights(**(curves | {"filters": curves["filters"]._replace(leak=0.0)}))
    rule = band_quadrature(weights)
    assert (rule.leaked == 0).all()
    assert rule.nodes_nm.shape == (8, 6)
    with pytest.raises(ValueError, match="read-only"):
        rule.in_band[0, 0] = 1.0


@pytest.mark.parametrize("count", [2, 4, 6, 8])
def test_gauss_nodes_of_a_dense_uniform_measure_are_legendres(count):
    x, width = np.linspace(-1, 1, 200_001, retstep=True)
    weight = np.full(x.size, width)
    weight[[0, -1]] /= 2
    # the trapezoidal moments of the dense measure are good to the square of its step, 1e-10
    assert gauss_nodes(x, weight, count) == pytest.approx(np.polynomial.legendre.leggauss(count)[0], abs=1e-8)


@pytest.mark.parametrize("count", [3, 6])
def test_gauss_nodes_of_a_dense_gaussian_measure_are_hermites(count):
    x = np.linspace(-12, 12, 4801)
    shifted = 560.0 + 4.0 * x
    nodes = gauss_nodes(shifted, np.exp(-(x**2)), count)
    # the trapezoidal rule of a Gaussian is exact to rounding
    assert nodes == pytest.approx(560 + 4 * np.polynomial.hermite.hermgauss(count)[0], abs=1e-9)
