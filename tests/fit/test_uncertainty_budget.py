"""The budget by source: it adds up, agrees with sessions measured again, and with a closed form of a linear model."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from threadpoolctl import threadpool_limits

from benchmarks.emission_detection import REFLECTANCES, Rig, bell
from data_schemas import FitError
from finray_calib.fit import BUDGETED, FitOptions, band_data, calibrate_paint, uncertainty_budget
from finray_calib.fit._measured_spectra import height_prior, learned_spectra, scored_components
from finray_calib.fit._reported_spectrum import conserving_draws, draw_spectra
from finray_calib.fit._uncertainty_budget import (
    DRAWS,
    ComponentDraws,
    UncertaintySource,
    budget_sources,
    component_draws,
    moved_means,
    quantity_draws,
    source_shares,
)

REPEATS = 20
LN_BLOCKING_SD = 0.5


def paint_bands(mode_nm, fwhm_nm, energy_yield, seed):
    """An orange paint whose white reference is known to 3 %."""
    emission = energy_yield * bell(mode_nm, fwhm_nm)
    found = Rig(1, 5.0).signals("orange", REFLECTANCES["orange"], emission, np.random.default_rng(seed))
    y, white = found.fluorescence.ravel(), found.optics.white_reference.model_copy(update={"uncertainty_rel": 0.03})
    return found.model_copy(
        update={
            "optics": found.optics.model_copy(update={"white_reference": white}),
            "fluorescence_covariance": found.fluorescence_covariance + 0.03**2 * np.outer(y, y),
        }
    )


@pytest.fixture(scope="module")
def bands():
    return paint_bands(590, 45, 0.2, 8)


@pytest.fixture(scope="module")
def paint(bands):
    few = replace(FitOptions().settings, importance_draws=4000, kept_draws=1000)
    return calibrate_paint(bands, 1, FitOptions(settings=few))


@pytest.fixture(scope="module")
def rows(bands, paint):
    return uncertainty_budget(bands, paint, seed=3)


def of(rows, quantity):
    return {row.source: row for row in rows if row.quantity == quantity}


def test_shares_of_every_quantity_add_up_to_all_of_its_variance(rows, paint):
    for name in BUDGETED:
        found = of(rows, name).values()
        assert sum(row.share for row in found) == pytest.approx(1.0, abs=1e-12)
        assert min(row.share for row in found) >= 0.0
        sd = paint.reradiation.stokes_shift_nm.sd if name == "stokes_shift_nm" else paint.parameters[name].sd
        assert np.sqrt(sum(row.standard_uncertainty**2 for row in found)) == pytest.approx(sd)


def test_the_sources_are_those_of_the_likelihood(bands):
    """Their covariances add up to that of the bands, and the white reference is found in it."""
    data = band_data(bands)
    fitted = scored_components(data, learned_spectra(), LN_BLOCKING_SD)
    sources = budget_sources(bands, data, fitted)
    total = sum(source.root @ source.root.T for source in sources)
    assert total == pytest.approx(fitted.noise, rel=1e-9, abs=1e-12 * fitted.noise.max())
    level = fitted.rig.data.level[data.kept]
    white = next(source.root for source in sources if source.name == "white reference")
    assert white @ white.T == pytest.approx(0.03**2 * np.outer(level, level), rel=1e-6)


def drawn_components(data, seed):
    """Return the posterior and its draws, of rare components too."""
    fitted, rng = scored_components(data, learned_spectra(), LN_BLOCKING_SD), np.random.default_rng(seed)
    return fitted, component_draws(draw_spectra(fitted, DRAWS, rng), fitted, data, rng)


def mean_quantities(data, draws, seed):
    """Return the posterior means (5,) of the quantities."""
    fitted = scored_components(data, learned_spectra(), LN_BLOCKING_SD)
    drawn = conserving_draws(draw_spectra(fitted, draws, np.random.default_rng(seed)), data)
    return np.mean(list(quantity_draws(drawn.curves, drawn.reflectance_at_laser, data).values()), axis=1)


@pytest.mark.parametrize(
    ("source", "made_of"),
    [
        ("camera response", (590, 45, 0.2, 8)),
        ("calibration of each filter", (590, 45, 0.2, 8)),
        ("white reference", (590, 45, 0.2, 8)),
        ("camera response", (540, 35, 0.1, 9)),
    ],
)
def test_a_session_measured_again_with_one_error_alone(source, made_of):
    """Spread of the estimate over 20 sessions, each fitted anew, against the spread that the budget gives those errors.

    Both take the same errors: the mean jumps where the weights move, one session in twenty by two standard deviations,
    so that a variance over 20 sessions has no chi-square distribution. The budget holds noise and heights of one place:
    for that its standard uncertainty may be off by a quarter, and shares below 2 % of the variance, where the
    scatter of the draws counts, are not compared.
    """
    bands = paint_bands(*made_of)
    data = band_data(bands)
    with threadpool_limits(limits=1, user_api="blas"):
        fitted, drawn = drawn_components(data, 3)
        only = next(one for one in budget_sources(bands, data, fitted) if source in one.name)
        shares = source_shares(drawn, fitted, (only,))[1][0]
        errors = np.random.default_rng(5).standard_normal((REPEATS, only.root.shape[1])) @ only.root.T
        found = []
        for error in errors:
            y = data.y.ravel().copy()
            y[data.kept] += error
            found.append(mean_quantities(replace(data, y=y.reshape(data.y.shape)), 800, 0))
    expected = moved_means(drawn, fitted, [errors])[0].std(axis=0)
    compared = shares > 0.02
    assert compared.any()
    ratio = np.std(found, axis=0)[compared] / expected[compared]
    assert ratio == pytest.approx(1.0, abs=0.25), np.array(BUDGETED[:-1])[compared]


def test_shares_depend_little_on_the_seed():
    """Three seeds of the orange paint, whose errors move the weights of components most: a share scatters by 0.006.

    Stray light moves up to a quarter of the weight to components that 20,000 draws meet less than once on average.
    """
    bands = paint_bands(590, 45, 0.2, 8)
    data, shares = band_data(bands), []
    for seed in range(3):
        fitted, drawn = drawn_components(data, seed)
        shares.append(source_shares(drawn, fitted, budget_sources(bands, data, fitted))[1])
    assert np.ptp(shares, axis=0).max() < 0.03  # of three values, 1.7 standard deviations on average, and at most 5


def test_a_linear_model_has_its_closed_form():
    """One normal paint of two directions: shares of the draws against P, A and N, within 4 standard errors."""
    rng = np.random.default_rng(6)
    seen, noise_roots = rng.standard_normal((5, 2)), [0.3 * rng.standard_normal((5, 5)) for _ in range(3)]
    noise, q = sum(root @ root.T for root in noise_roots), np.array([1.0, -0.5])
    posterior = np.linalg.inv(np.eye(2) + seen.T @ np.linalg.solve(noise, seen))
    gain = posterior @ seen.T @ np.linalg.inv(noise)
    exact = np.array([np.sum((q @ gain @ root) ** 2) for root in noise_roots]) / (q @ posterior @ q)
    draws = rng.multivariate_normal(np.zeros(2), posterior, 40_000)
    one = np.zeros((1, 5)), np.zeros((1, 5, 5))
    fitted = SimpleNamespace(noise=noise, evidence_derivatives=lambda places: one)
    count = len(draws)
    drawn = ComponentDraws((draws @ q)[:, None], draws @ seen.T, np.zeros(count, np.int64), np.full(count, 1 / count))
    sources = tuple(UncertaintySource("", "", "B", root) for root in noise_roots)
    variance, shares = source_shares(drawn, fitted, sources)
    assert variance[0] == pytest.approx(q @ posterior @ q, rel=4 * np.sqrt(2 / 40_000))
    assert shares[:, 0] == pytest.approx(exact, abs=4 * 2 / np.sqrt(40_000))
    assert exact.sum() < 1


def test_weights_that_move_with_the_data_have_their_closed_form():
    """Two shapes whose quantities lie far apart: the variance of the mean over one source, by quadrature.

    y is normal of variance 2 around -2 or 2, and the source is nine tenths of the noise of 1. The square of the slope
    at the measured place would be far from that variance.
    """
    rng, y, q, count = np.random.default_rng(2), 2.0, np.array([10.0, 0.0]), 400_000
    middle, total, source = np.array([-2.0, 2.0]), 2.0, 0.9

    def mean(at):
        weight = np.exp(-0.5 * (at[:, None] - middle) ** 2 / total)
        weight /= weight.sum(axis=1, keepdims=True)
        return (weight * (q + middle + (at[:, None] - middle) / total)).sum(axis=1), weight

    nodes, share = np.polynomial.hermite_e.hermegauss(100)
    found, share = mean(y + np.sqrt(source) * nodes)[0], share / share.sum()
    apart = found - share @ found
    exact = share @ apart**2
    rare = mean(np.array([y]))[1][0, 0]
    component = (rng.random(count) >= rare).astype(np.int64)
    paint = middle[component] + (y - middle[component]) / total + np.sqrt(0.5) * rng.standard_normal(count)
    slope, curvature = -(y - middle)[:, None] / total, np.full((2, 1, 1), -1 / total)
    fitted = SimpleNamespace(noise=np.eye(1), evidence_derivatives=lambda places: (slope[places], curvature[places]))
    drawn = ComponentDraws((q[component] + paint)[:, None], paint[:, None], component, np.full(count, 1 / count))
    one = UncertaintySource("", "", "B", np.array([[np.sqrt(source)]]))
    variance, shares = source_shares(drawn, fitted, (one,))
    # scatter of a variance over the 2,000 errors that are drawn, and of the square of the rare shape's share
    scatter = np.hypot(np.sqrt((share @ apart**4 / exact**2 - 1) / 2000), 2 / np.sqrt(count * rare))
    assert variance[0] * shares[0, 0] == pytest.approx(exact, rel=4 * scatter)
    local = (np.diff(mean(np.array([y - 1e-4, y + 1e-4]))[0])[0] / 2e-4) ** 2 * source
    assert abs(local / exact - 1) > 4 * scatter


def test_the_evidence_of_components_follows_the_bands(bands):
    """Slope and curvature against the evidence at bands that were moved, the height of the departures held."""
    fitted = scored_components(band_data(bands), learned_spectra(), LN_BLOCKING_SD)
    places = np.argsort(-fitted.scored.weight)[:3]
    slope, curvature = fitted.evidence_derivatives(places)
    rig, scored, moved = fitted.rig, fitted.scored, np.linalg.cholesky(fitted.noise)[:, 2]
    mean, precision = height_prior(fitted.parts, scored.chosen[places])
    for which, place in enumerate(places):
        design = np.stack([fitted.bands[scored.chosen[place]], rig.laser], axis=1)
        covariance = np.linalg.inv(scored.inverse[place]) + design / precision[which] @ design.T
        evidence = multivariate_normal(design @ mean[which], covariance, allow_singular=True)
        change = evidence.logpdf(rig.y + moved) - evidence.logpdf(rig.y)
        assert moved @ slope[which] + 0.5 * moved @ curvature[which] @ moved == pytest.approx(
            change, rel=1e-4, abs=1e-4
        )


def test_other_band_signals_hold_no_budget(bands, paint):
    other = bands.model_copy(update={"fluorescence": 1.5 * bands.fluorescence})
    with pytest.raises(FitError, match="do not reproduce this calibration"):
        uncertainty_budget(other, paint)
    of_family = paint.model_copy(update={"spectrum_from": "log-normal"})
    with pytest.raises(FitError, match="fit the paint without --family"):
        uncertainty_budget(bands, of_family)
