"""From band values to trusted draws: routes of the sampling, their agreement, and what lost bands do."""

from dataclasses import replace

import numpy as np
import pytest

from data_schemas import FitError
from finray_calib.fit import (
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    EmissionPrior,
    FitSettings,
    SamplerSettings,
    fit_emission,
    sample_posterior,
)
from finray_calib.fit._emission import Sampling, draw_posterior
from finray_calib.fit._likelihood import Maxima
from finray_calib.spectra import FAMILIES
from tests.fit.synthetic_bands import LOG_NORMAL, QUICK, orange, simulate


@pytest.fixture(scope="module")
def simulated(weights):
    return simulate(orange(), weights, np.random.default_rng(11), discrepancy=PAINT_DISCREPANCY)


@pytest.fixture(scope="module")
def posterior(simulated):
    return fit_emission(
        simulated[0], LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY, FitSettings(), np.random.default_rng(12)
    )


def test_truth_lies_inside_the_posterior(posterior, simulated):
    assert posterior.sampling.trusted
    apart = posterior.draws.mean(axis=0) - orange()
    # chi-square with 6 degrees of freedom exceeds 35 with probability 4e-6
    assert apart @ np.linalg.inv(np.cov(posterior.draws.T)) @ apart < 35
    truth, curves = simulated[1], posterior.curve_draws.curves
    seen = (posterior.wavelength_nm > 560) & (posterior.wavelength_nm < 700)
    # five standard deviations at every wavelength
    assert (np.abs(truth - curves.mean(axis=0)) < 5 * curves.std(axis=0))[seen].all()


def test_quantities_are_those_of_the_drawn_curves(posterior):
    curves, q = posterior.curve_draws.curves, posterior.quantities
    for i in (0, 100, -1):
        assert q.peak_per_nm[i] == pytest.approx(curves[i].max(), rel=1e-3)
        assert q.mode_nm[i] == pytest.approx(posterior.wavelength_nm[curves[i].argmax()], abs=1.0)
        assert q.energy_yield[i] == pytest.approx(curves[i].sum(), rel=1e-3)
    assert posterior.reflectance_at_laser == pytest.approx(np.exp(posterior.draws[:, 4]))
    assert posterior.laser_nm == pytest.approx(450.0)


def test_share_below_the_laser_is_that_of_the_family_curve(weights):
    theta = np.array([480.0, np.log(60.0), np.log(0.004), 0.0, np.log(0.1), 0.0])
    data, _ = simulate(theta, weights, np.random.default_rng(1), family=FAMILIES["zheng2014"])
    fitted = fit_emission(data, FAMILIES["zheng2014"], EmissionPrior(), NO_DISCREPANCY, QUICK, np.random.default_rng(2))
    curve = FAMILIES["zheng2014"].curves(fitted.draws[:1], weights.wavelength_nm)[0]
    below = curve[weights.wavelength_nm < 450].sum() / curve.sum()
    assert fitted.share_below_laser[0] == pytest.approx(below, rel=1e-12)
    assert (
        np.median(fitted.share_below_laser) > 0.05
    )  # 7 % of a Lorentz curve of 60 nm lies 30 nm below its mode or further


def test_emcee_and_importance_sampling_agree(posterior):
    settings = SamplerSettings(walkers=32, most_steps=1500)
    chain, diagnostics = sample_posterior(
        posterior.log_posterior, posterior.proposal, settings, np.random.default_rng(3)
    )
    draws = posterior.draws
    assert posterior.sampling.method != "emcee"
    effective = min(posterior.sampling.sample.effective, diagnostics.bulk_ess.min(), len(draws))
    sd = draws.std(axis=0)
    # five combined standard errors of mean and of sd
    assert np.abs((chain.mean(axis=0) - draws.mean(axis=0)) / sd).max() < 5 * np.sqrt(2 / effective)
    assert np.abs(chain.std(axis=0) / sd - 1).max() < 5 / np.sqrt(effective)


class Banana:
    """A ridge two hundred times longer than wide, bent into a parabola."""

    def __init__(self):
        self.prior = EmissionPrior().of(LOG_NORMAL, with_blocking=True)
        self.unit = 0.15 * self.prior.sd

    def __call__(self, theta):
        z = (theta - self.prior.mean) / self.unit
        bent = (z[:, 1] - 5.0 * (z[:, 0] ** 2 - 1)) / 0.005
        others = (z[:, [0, 2, 3, 4, 5]] ** 2).sum(axis=1)
        return np.where(self.prior.contains(theta), -0.5 * (bent**2 + others), -np.inf)


def test_a_hard_density_falls_back_to_emcee_and_a_short_chain_is_not_trusted(monkeypatch):
    monkeypatch.setattr("finray_calib.fit._markov_chains.LARGEST_MEMORY", 0.0)  # as if the moved draws remembered
    hard = Banana()
    centre = hard.prior.mean - np.array([0, 5.0, 0, 0, 0, 0]) * hard.unit
    precision = np.diag(hard.unit**-2.0) * np.array([1, 0.005**-2, 1, 1, 1, 1])
    maxima = Maxima(centre[None], hard(centre[None]), precision[None])
    settings = FitSettings(importance_draws=2000, kept_draws=500, chain=SamplerSettings(walkers=32, most_steps=400))
    _, draws, sampling = draw_posterior(hard, maxima, settings, np.random.default_rng(3))
    assert sampling.method == "emcee"
    assert draws.shape == (500, 6)
    assert not sampling.sample.trusted
    assert sampling.chain.r_hat.max() > 1.1
    assert not sampling.trusted
    assert replace(sampling, chain=replace(sampling.chain, converged=True)).trusted


def test_trust_is_that_of_the_method_used(posterior):
    sample = posterior.sampling.sample
    assert replace(sample, pareto_k=0.71).trusted is False
    assert replace(sample, effective=799.0).trusted is False
    assert Sampling("importance sampling", replace(sample, pareto_k=0.9)).trusted is False


def test_lost_bands_widen_the_posterior(weights, posterior, simulated):
    """Only 450, 500, 630 and 660 nm are left of the same session: nothing around the mode at 597 nm."""
    usable = np.zeros((8, 3), bool)
    usable[[1, 2, 6, 7]] = True
    rng = np.random.default_rng(12)
    few = fit_emission(replace(simulated[0], usable=usable), LOG_NORMAL, EmissionPrior(), PAINT_DISCREPANCY, QUICK, rng)
    # the discrepancy alone leaves the mode uncertain by 8 nm between two filters
    for name, factor in (("mode_nm", 1.0), ("peak_per_nm", 1.3), ("energy_yield", 1.3)):
        assert getattr(few.quantities, name).std() > factor * getattr(posterior.quantities, name).std()
    low, high = np.quantile(few.quantities.mode_nm, [0.005, 0.995])
    assert low < 597 < high


def test_same_seed_gives_the_same_draws(simulated):
    runs = [
        fit_emission(simulated[0], LOG_NORMAL, EmissionPrior(), NO_DISCREPANCY, QUICK, np.random.default_rng(1))
        for _ in range(2)
    ]
    assert np.array_equal(runs[0].draws, runs[1].draws)
    assert np.array_equal(runs[0].curve_draws.curves, runs[1].curve_draws.curves)


@pytest.mark.parametrize("fields", [{"kept_draws": 99}, {"kept_draws": 4001, "importance_draws": 4000}])
def test_too_few_draws_are_refused(fields):
    with pytest.raises(FitError, match="must be at least 100 and at most importance_draws"):
        FitSettings(**fields)
