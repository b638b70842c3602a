import numpy as np
import pytest
from scipy.optimize import minimize

from finray_calib.fit import NO_DISCREPANCY, PAINT_DISCREPANCY, EmissionPrior, LogPosterior, find_maxima
from finray_calib.fit._likelihood import starting_points
from finray_calib.spectra import FAMILIES
from tests.fit.synthetic_bands import LOG_NORMAL, ZHENG, orange, simulate

VAGUE = EmissionPrior(fwhm_median_nm=45.0, ln_fwhm_sd=0.5)
# the search stops at changes of 1e-6 nats; a flat maximum is then right to a hundredth of a posterior sd
NATS = 1e-3
SAME_SD = 0.05


@pytest.fixture(scope="module", params=[NO_DISCREPANCY, PAINT_DISCREPANCY], ids=["family alone", "with discrepancy"])
def posterior(request, weights):
    data, _ = simulate(orange(), weights, np.random.default_rng(3), discrepancy=request.param)
    return LogPosterior(data, LOG_NORMAL, EmissionPrior(), request.param)


@pytest.fixture(scope="module")
def maxima(posterior):
    return find_maxima(posterior, np.random.default_rng(0))


def by_scipy(posterior, starts):
    """Return the best of scipy's local searches from all starts, in prior standard deviations around the mean."""
    prior = posterior.prior

    def objective(z):
        return -max(float(posterior((prior.mean + z * prior.sd)[None])[0]), -1e12)

    ends = []
    for start in starts:
        z = (start - prior.mean) / prior.sd
        for _ in range(3):  # a restart unlocks a collapsed simplex
            z = minimize(objective, z, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-9, "maxfev": 4000}).x
        ends.append((-objective(z), prior.mean + z * prior.sd))
    return max(ends, key=lambda end: end[0])


def test_best_maximum_is_the_one_that_scipy_finds(posterior, maxima):
    height, theta = by_scipy(posterior, [orange(), maxima.theta[0] + 0.1 * posterior.prior.sd])
    assert maxima.log_posterior[0] == pytest.approx(height, abs=NATS)
    apart = maxima.theta[0] - theta
    assert apart @ maxima.information[0] @ apart < SAME_SD**2


def test_no_point_of_a_dense_random_search_is_higher(posterior, maxima):
    best, height = maxima.theta[0], maxima.log_posterior[0]
    rng = np.random.default_rng(1)
    factor = np.linalg.cholesky(np.linalg.inv(maxima.information[0]))
    for width in (1.0, 0.1, 0.01):
        near = best + width * rng.standard_normal((2000, best.size)) @ factor.T
        assert posterior(near).max() <= height + 1e-5
    assert posterior(posterior.prior.draw(2000, rng)).max() < height


def test_reported_heights_and_curvatures_are_those_at_the_maxima(posterior, maxima):
    assert np.allclose(maxima.log_posterior, posterior(maxima.theta), rtol=0, atol=1e-9)
    for theta, information in zip(maxima.theta, maxima.information, strict=True):
        assert np.allclose(information, posterior.information(theta), rtol=1e-6, atol=1e-6)


def test_every_seed_finds_the_same_maximum(posterior, maxima):
    for seed in (5, 6, 7):
        other = find_maxima(posterior, np.random.default_rng(seed))
        assert other.log_posterior[0] == pytest.approx(maxima.log_posterior[0], abs=NATS)
        apart = other.theta[0] - maxima.theta[0]
        assert apart @ maxima.information[0] @ apart < SAME_SD**2


def test_laplace_mass_of_a_normal_density_is_exact(maxima):
    """ln of the height times sqrt((2 pi)^D / det information), written with eigenvalues."""
    roots = np.linalg.eigvalsh(maxima.information[0])
    expected = maxima.log_posterior[0] + 0.5 * np.log(2 * np.pi / roots).sum()
    assert maxima.ln_laplace_mass[0] == pytest.approx(expected, rel=1e-9)


@pytest.fixture(scope="module", params=[((2, 4, 5, 7), 1), ((2, 3, 6, 7), 0)], ids=["627 or 620 nm", "528 or 567 nm"])
def bimodal(request, weights):
    """A paint seen by the green channel behind four filters only, and the places of its two maxima."""
    bands, seed = request.param
    usable = np.zeros((8, 3), bool)
    usable[list(bands), 1] = True
    rng = np.random.default_rng(seed)
    theta = VAGUE.of(ZHENG, with_blocking=True).draw(1, rng)[0]
    theta[0], theta[2] = 520 + 120 * rng.random(), np.log(0.004)
    data, _ = simulate(theta, weights, rng, family=ZHENG, usable=usable)
    posterior = LogPosterior(data, ZHENG, VAGUE)
    return posterior, find_maxima(posterior, rng)


def test_both_maxima_of_an_ambiguous_session_are_found(bimodal):
    """With 500, 560, 600 and 660 nm alone, and with 500, 532, 630 and 660 nm alone."""
    posterior, found = bimodal
    assert len(found.theta) > 1
    assert found.log_posterior[0] - found.log_posterior[1] < 3
    assert (np.diff(found.log_posterior) <= 0).all()
    for i, theta in enumerate(found.theta):
        others = np.delete(found.theta, i, axis=0) - theta
        assert (np.einsum("ni,ij,nj->n", others, found.information[i], others) > 0.5).all()
    for theta, height in zip(found.theta[:2], found.log_posterior[:2], strict=True):
        top, _ = by_scipy(posterior, [theta])  # scipy climbs no further, so both are local maxima
        assert top == pytest.approx(height, abs=0.01)
    path = found.theta[0] + np.linspace(0, 1, 101)[:, None] * (found.theta[1] - found.theta[0])
    assert posterior(path).min() < found.log_posterior[1] - 0.1


def test_every_seed_finds_the_same_two_maxima(bimodal):
    posterior, found = bimodal
    for seed in (101, 102, 103):
        other = find_maxima(posterior, np.random.default_rng(seed))
        assert other.log_posterior[:2] == pytest.approx(found.log_posterior[:2], abs=0.01)


@pytest.mark.parametrize("name", list(FAMILIES))
def test_starting_points_cover_the_modes_and_are_scaled_to_the_data(weights, name):
    data, _ = simulate(orange(name), weights, np.random.default_rng(3), family=FAMILIES[name])
    posterior = LogPosterior(data, FAMILIES[name], EmissionPrior())
    starts = starting_points(posterior, np.random.default_rng(0))
    counts, _ = np.histogram(starts[:, 0], np.linspace(470, 720, 5))
    assert (counts == 4).all()
    # the brightest predicted emission band is the brightest measured one
    y, excitation = data.y.ravel(), weights.is_excitation
    predicted = posterior.predict_usable(starts)[:, ~excitation].max(axis=1)
    # laser light that leaks was part of the brightest value before its own scaling; the prior spreads by a factor of 3
    assert (np.abs(np.log(predicted / y[~excitation].max())) < np.log(2.0)).mean() > 0.5
