"""The compiled posterior against scipy's multivariate normal, with every term written out from its definition."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, truncnorm

from data_schemas import FitError
from finray_calib.fit import NO_DISCREPANCY, PAINT_DISCREPANCY, BandData, Discrepancy, EmissionPrior, LogPosterior
from finray_calib.fit.posterior_kernel import factorise, invert
from finray_calib.spectra import FAMILIES, band_quadrature, emission_weights
from tests.fit.synthetic_bands import LOG_NORMAL, full_sum, orange, simulate, without_band

# hardly any two bands then share discrepancy, so that nothing is cut off
SHORT = Discrepancy(0.12, 2.0, 0.1, 0.1, "for this test")


def edge(theta, wavelength_nm):
    """The re-absorbed blue edge: a logistic half a width below the mode, 0.12 widths wide."""
    width = np.exp(theta[1])
    return 1 / (1 + np.exp((wavelength_nm - (theta[0] - 0.5 * width)) / (0.12 * width)))


def discrepancy_covariance(theta, family, weights, discrepancy, wavelength_nm, in_band):
    """Covariance of the band values when f = s + (s + eps peak) d, for in-band weights (N, L) at wavelengths (L,)."""
    scale = family.curves(theta[None], wavelength_nm)[0] + discrepancy.floor_rel * np.exp(theta[2])
    apart = wavelength_nm[:, None] - wavelength_nm
    process = discrepancy.amplitude_rel**2 * np.exp(-(apart**2) / (2 * discrepancy.length_nm**2))
    blue = edge(theta, wavelength_nm)
    process = process + discrepancy.reabsorption_rel**2 * np.outer(blue, blue)
    scaled = in_band * scale
    return scaled @ process @ scaled.T


def at_nodes(weights):
    """All nodes in a row, and each row's in-band weights at them, (N, B Q)."""
    rule = band_quadrature(weights)
    own = weights.band_index[:, None] == np.arange(weights.bands)
    return rule.nodes_nm.ravel(), (own[:, :, None] * rule.in_band[:, None, :]).reshape(len(own), -1)


def plain_log_posterior(theta, data, family, prior, discrepancy):
    """One theta, everything spelled out with scipy's distributions; the mean by the full sum over wavelengths."""
    mu = full_sum(family, theta, data.weights)[0]
    same_band = data.weights.band_index[:, None] == data.weights.band_index
    y = np.nan_to_num(data.y.ravel())
    covariance = data.covariance + data.band_calibration_rel**2 * np.outer(y, y) * same_band
    covariance = covariance + np.outer(data.lamp_response_rel * mu, data.lamp_response_rel * mu)
    covariance = covariance + data.tile_uncertainty_rel**2 * (np.outer(mu, mu) - np.outer(y, y))
    if discrepancy.acts:
        covariance = covariance + discrepancy_covariance(
            theta, family, data.weights, discrepancy, *at_nodes(data.weights)
        )
    kept = data.usable.ravel()
    likelihood = multivariate_normal(mu[kept], covariance[np.ix_(kept, kept)]).logpdf(data.y.ravel()[kept])
    full = prior.of(family, with_blocking=True)
    bounds = np.stack([full.low - full.mean, full.high - full.mean]) / full.sd
    return likelihood, likelihood + truncnorm(*bounds, loc=full.mean, scale=full.sd).logpdf(theta).sum()


@pytest.fixture(scope="module")
def correlated(weights):
    """Band data with a full covariance, NaN where a value is lost, 2 % calibration.

    A lamp off by up to 12 %, and a white reference known to 10 %.
    """

    def build(lost):
        rng = np.random.default_rng(8)
        usable = np.ones(24, bool)
        usable[list(lost)] = False
        data, _ = simulate(orange(), weights, rng, usable=usable.reshape(8, 3))
        mix = np.eye(24) + 0.2 * rng.standard_normal((24, 24))
        y = np.where(data.usable, data.y, np.nan)
        lamp = np.linspace(-0.04, 0.12, 24)
        covariance = mix @ data.covariance @ mix.T + 0.1**2 * np.outer(data.y, data.y)
        return BandData(y, covariance, data.usable, weights, 0.02, lamp_response_rel=lamp, tile_uncertainty_rel=0.1)

    return build


@pytest.mark.parametrize("name", list(FAMILIES))
@pytest.mark.parametrize("discrepancy", [NO_DISCREPANCY, SHORT], ids=["family alone", "with discrepancy"])
@pytest.mark.parametrize("lost", [(), (0, 4, 11, 12, 13, 14)], ids=["all", "some lost"])
def test_log_posterior_equals_the_plain_scalar_twin(correlated, name, discrepancy, lost):
    data, family, prior = correlated(lost), FAMILIES[name], EmissionPrior()
    posterior = LogPosterior(data, family, prior, discrepancy)
    theta = orange(name) + 0.02 * posterior.prior.sd * np.random.default_rng(2).standard_normal((30, orange(name).size))
    likelihood, both = np.transpose([plain_log_posterior(t, data, family, prior, discrepancy) for t in theta])
    # the few-node rule is good to 1e-3 of the 0.3 % noise-limited values: a chi-square of thousands moves by 1e-4
    assert np.allclose(posterior.log_likelihood(theta), likelihood, rtol=2e-4, atol=0.02)
    assert np.allclose(posterior(theta), both, rtol=2e-4, atol=0.02)


@pytest.mark.parametrize("discrepancy", [NO_DISCREPANCY, SHORT], ids=["family alone", "with discrepancy"])
def test_log_likelihood_is_exactly_normal_around_the_predicted_values(correlated, discrepancy):
    """The same without the error of the quadrature: scipy's density with the package's mean."""
    data = correlated((4, 11))
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), discrepancy)
    theta = posterior.prior.draw(50, np.random.default_rng(3))
    mu, covariance = posterior.predict_usable(theta), posterior.covariances(theta)
    expected = [
        multivariate_normal(m, c, allow_singular=False).logpdf(data.y.ravel()[data.kept])
        for m, c in zip(mu, covariance, strict=True)
    ]
    # rounding of two different factorisations of a covariance of condition 1e6 or so
    assert np.allclose(posterior.log_likelihood(theta), expected, rtol=1e-7, atol=1e-5)


def test_covariances_are_those_of_a_dense_gaussian_process_at_the_nodes(correlated, weights):
    data = correlated(())
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), SHORT)
    theta = posterior.prior.draw(20, np.random.default_rng(4))
    u = posterior.imperfections
    predicted, y = posterior.predict_usable(theta), data.y.ravel()
    for row, mu, got in zip(theta, predicted, posterior.covariances(theta), strict=True):
        lamp = data.lamp_response_rel * mu
        fixed = data.covariance + u @ u.T + np.outer(lamp, lamp) + 0.1**2 * (np.outer(mu, mu) - np.outer(y, y))
        expected = fixed + discrepancy_covariance(row, LOG_NORMAL, weights, SHORT, *at_nodes(weights))
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        # bands far apart are cut off: their outermost nodes, 4 nm or two lengths apart, share e^-2 of a hundredth each
        assert (np.abs(got - expected) < 5e-4 * scale).all()
        assert np.allclose(np.diag(got), np.diag(expected), rtol=1e-9, atol=0)
        assert np.array_equal(got, got.T)


@pytest.mark.parametrize("discrepancy", [NO_DISCREPANCY, SHORT], ids=["family alone", "with discrepancy"])
def test_precisions_are_inverse_covariances(correlated, discrepancy):
    posterior = LogPosterior(correlated((4, 11)), LOG_NORMAL, EmissionPrior(), discrepancy)
    theta = posterior.prior.draw(20, np.random.default_rng(5))
    for covariance, got in zip(posterior.covariances(theta), posterior.precisions(theta), strict=True):
        expected = np.linalg.inv(covariance)
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        # rounding of two different factorisations of a covariance of condition 1e6 or so
        assert (np.abs(got - expected) < 1e-8 * scale).all()
        assert np.array_equal(got, got.T)


def test_a_singular_covariance_is_refused(correlated, monkeypatch):
    posterior = LogPosterior(correlated((4, 11)), LOG_NORMAL, EmissionPrior(), NO_DISCREPANCY)
    size = posterior.data.kept.size
    factor = np.ones((size, size))
    factorise.py_func(factor, np.ones(size))
    invert.py_func(factor)
    monkeypatch.setattr(LogPosterior, "_matrices", lambda *_: factor[None])
    with pytest.raises(FitError, match=r"the covariance of the band values is singular.*leave one of them out"):
        posterior.precisions(orange()[None])


@pytest.mark.parametrize("variance", [1e-60, 1e60])
def test_the_determinant_neither_underflows_nor_overflows(variance):
    """The product of 24 such pivots, 1e-720 or 1e720, is no floating-point number."""
    half_log = factorise.py_func(np.diag(np.full(24, variance)), np.ones(24))
    assert half_log == pytest.approx(12 * np.log(variance), rel=1e-12)


def test_bands_four_lengths_apart_may_be_cut_off(correlated, weights):
    """What the cut leaves out of the default discrepancy is e^-8 of a correlation."""
    data = replace(correlated(()), lamp_response_rel=None, tile_uncertainty_rel=0.0)
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY)
    theta = orange()
    got = posterior.covariances(theta[None])[0] - posterior.problem.covariance[0]
    expected = discrepancy_covariance(theta, LOG_NORMAL, weights, PAINT_DISCREPANCY, *at_nodes(weights))
    sd = np.sqrt(np.diag(expected))
    seen = sd > 0
    correlation = ((got - expected) / np.where(seen, sd, 1.0) / np.where(seen, sd, 1.0)[:, None])[np.ix_(seen, seen)]
    # the nodes of two bands come up to 14 nm closer than their centres: e^-(34/12)^2/2 between the closest
    assert np.abs(correlation).max() < 0.02
    assert np.abs(np.diag(correlation)).max() < 1e-9


def test_discrepancy_at_nodes_equals_that_on_the_whole_grid(weights):
    """The same double integral over every wavelength of the pass bands."""
    rule = band_quadrature(weights)
    theta = orange()
    nodes = discrepancy_covariance(theta, LOG_NORMAL, weights, PAINT_DISCREPANCY, *at_nodes(weights))
    grid = discrepancy_covariance(
        theta, LOG_NORMAL, weights, PAINT_DISCREPANCY, weights.wavelength_nm, weights.emission - weights.leaked_emission
    )
    bright = (rule.in_band.sum(axis=1) > 0.9 * weights.emission.sum(axis=1)) & ~weights.is_excitation
    assert bright.sum() > 8
    nodes, grid = nodes[np.ix_(bright, bright)], grid[np.ix_(bright, bright)]
    sd = np.sqrt(np.diag(grid))
    # the pass band ends where the filter has fallen to a thousandth: that much of a value, with every correlation
    assert (np.abs(nodes - grid) < 2e-3 * np.outer(sd, sd)).all()


def test_predicting_too_much_is_as_bad_as_predicting_too_little(weights):
    """A relative error that moved with the model would forgive any prediction that is far too bright."""
    data, _ = simulate(orange(), weights, np.random.default_rng(8))
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior())
    theta = np.tile(orange(), (2, 1))
    theta[:, [2, 4]] += np.log([[0.5], [1.5]])
    dark, bright = posterior.log_likelihood(theta) - posterior.log_likelihood(orange()[None])
    # half the signal is fifty calibration errors in each of the four bands that stand clear of the noise floor
    assert dark < -0.4 * 4 * 50**2
    assert bright == pytest.approx(dark, rel=0.1)


@pytest.mark.parametrize("discrepancy", [NO_DISCREPANCY, PAINT_DISCREPANCY], ids=["family alone", "with discrepancy"])
def test_information_is_minus_the_hessian(weights, discrepancy):
    """Against second differences of the density by Richardson extrapolation, at a maximum."""
    data, _ = simulate(orange(), weights, np.random.default_rng(1), discrepancy=discrepancy)
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior(), discrepancy)
    top = posterior.climb(orange())
    information = posterior.information(top)
    sd = np.sqrt(np.diag(np.linalg.inv(information)))

    def second(i, j, step):
        a, b = (np.eye(top.size)[k] * step * sd[k] for k in (i, j))
        plus, minus, left, right = posterior(top + np.array([a + b, -a - b, a - b, b - a]))
        return -(plus + minus - left - right) / (4 * step**2 * sd[i] * sd[j])

    expected = np.array(
        [[(4 * second(i, j, 0.05) - second(i, j, 0.1)) / 3 for j in range(top.size)] for i in range(top.size)]
    )
    scale = np.sqrt(np.outer(np.diag(information), np.diag(information)))
    # the information's own step, 0.001 prior sd, is a tenth of a posterior sd: its truncation is the square of that
    assert (np.abs(information - expected) < 0.02 * scale).all()


def test_information_at_a_saddle_is_still_a_covariance(weights):
    data, _ = simulate(orange(), weights, np.random.default_rng(1))
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior())
    for theta in posterior.prior.draw(20, np.random.default_rng(5)):
        roots = np.linalg.eigvalsh(posterior.information(theta) * np.outer(posterior.prior.sd, posterior.prior.sd))
        assert roots.min() >= 0.25 * (1 - 1e-6)  # rounding of eigenvalues that span many decades
    corner = np.where(np.isfinite(posterior.prior.low), posterior.prior.low, posterior.prior.mean)
    assert np.isfinite(posterior.information(corner)).all()


def test_outside_the_truncation_the_density_is_zero(weights):
    posterior = LogPosterior(simulate(orange(), weights, np.random.default_rng(1))[0], LOG_NORMAL, EmissionPrior())
    outside = np.tile(orange(), (3, 1))
    outside[0, 0], outside[1, 3] = 469.0, 1.6
    assert np.isneginf(posterior(outside)).tolist() == [True, True, False]
    assert np.isneginf(posterior.log_likelihood(outside[:2])).all()


@pytest.mark.parametrize("name", list(FAMILIES))
@pytest.mark.parametrize("discrepancy", [NO_DISCREPANCY, PAINT_DISCREPANCY], ids=["family alone", "with discrepancy"])
def test_absurd_parameters_give_minus_infinity_or_a_number_but_never_nan(weights, name, discrepancy):
    posterior = LogPosterior(
        simulate(orange(), weights, np.random.default_rng(1))[0], FAMILIES[name], EmissionPrior(), discrepancy
    )
    size = posterior.prior.size
    theta = np.repeat(orange(name)[None], 7 * size, axis=0)
    absurd = (np.nan, np.inf, -np.inf, 1e3, -1e3, 1e308, -1e308)
    theta[np.arange(7 * size), np.tile(np.arange(size), 7)] = np.repeat(absurd, size)
    for values in (posterior(theta), posterior.log_likelihood(theta)):
        assert not np.isnan(values).any()
        assert (values < np.inf).all()
    assert np.isneginf(posterior(theta[:size])).all()  # NaN is nowhere allowed


def test_rig_without_leak_has_no_blocking_parameter(rig):
    curves = rig.sampled(np.arange(380.0, 781.0))
    filters = curves["filters"]
    without_leak = filters._replace(transmission=filters.transmission - rig.leak, leak=0.0)
    weights = emission_weights(**(curves | {"filters": without_leak}))
    data, _ = simulate(np.append(orange()[:5], 0.0), weights, np.random.default_rng(1))
    posterior = LogPosterior(data, LOG_NORMAL, EmissionPrior())
    assert posterior.prior.names[-1] == "ln_reflected_laser"
    assert posterior.prior.size == 5
    mu = posterior.predict_usable(orange()[None, :5])
    full = full_sum(LOG_NORMAL, np.append(orange()[:5], 0.0), weights)
    # 1e-3 of a value, or of the faintest emission band whose few photons come from the foot of the curve
    assert np.allclose(mu, full, rtol=1e-3, atol=1e-6 * full.max())


def changed(weights, **fields):
    values = {"y": np.ones((8, 3)), "covariance": 1e-6 * np.eye(24), "usable": np.ones((8, 3), bool)}
    return BandData(**(values | {"weights": weights} | fields))


def test_unusable_band_data_are_refused(weights):
    few = np.zeros((8, 3), bool)
    few[:3] = True
    nan = np.ones((8, 3))
    nan[2, 1] = np.nan
    skew = 1e-6 * np.eye(24)
    skew[0, 1] = 1e-7
    zero = 1e-6 * np.eye(24)
    zero[7, 7] = 0.0
    with pytest.raises(FitError, match="only 3 bands have a usable channel, but at least 4"):
        changed(weights, usable=few)
    with pytest.raises(FitError, match="NaN or infinite"):
        changed(weights, y=nan)
    with pytest.raises(FitError, match="NaN or infinite"):
        changed(weights, y=np.full((8, 3), np.inf))
    with pytest.raises(FitError, match="not positive definite"):
        changed(weights, covariance=np.ones((24, 24)))
    with pytest.raises(FitError, match="give every band value its own variance"):
        changed(weights, covariance=zero)
    with pytest.raises(FitError, match="finite and symmetric"):
        changed(weights, covariance=skew)
    with pytest.raises(FitError, match="finite and symmetric"):
        changed(weights, covariance=np.full((24, 24), np.nan))
    with pytest.raises(FitError, match="does not fit the 24 band values of the rig"):
        changed(weights, covariance=np.eye(8))
    with pytest.raises(FitError, match="does not fit the 24 band values of the rig"):
        changed(weights, y=np.ones((8, 2)))
    with pytest.raises(FitError, match="band_calibration_rel 1 must be"):
        changed(weights, band_calibration_rel=1.0)


def test_symmetry_is_judged_by_the_standard_deviations(weights):
    """A covariance of two bright values that rounds to nothing is no asymmetry; one of a dim and a bright may be."""
    variance = np.diag(np.logspace(-4, -12, 24))
    rounded = variance.copy()
    rounded[0, 1] = 1e-7 * np.sqrt(variance[0, 0] * variance[1, 1])
    assert changed(weights, covariance=rounded).kept.size == 24
    skew = variance.copy()
    skew[22, 23] = 1e-5 * np.sqrt(variance[22, 22] * variance[23, 23])
    with pytest.raises(FitError, match="finite and symmetric"):
        changed(weights, covariance=skew)


def test_nan_in_a_lost_entry_is_allowed(weights):
    y, usable = np.ones((8, 3)), np.ones((8, 3), bool)
    y[7, 2], usable[7, 2] = np.nan, False
    assert changed(weights, y=y, usable=usable).kept.size == 23


def test_leaving_out_a_band_keeps_the_rest_and_stops_at_four(weights):
    data = without_band(without_band(changed(weights), 5), 2)
    assert sorted(set(weights.band_index[data.kept])) == [0, 1, 3, 4, 6, 7]
    data = without_band(without_band(data, 0), 7)
    with pytest.raises(FitError, match="only 3 bands have a usable channel"):
        without_band(data, 1)
