import dynesty
import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import multivariate_normal

from finray_calib.fit import (
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    EmissionPrior,
    LogPosterior,
    find_maxima,
    importance_sample,
)
from finray_calib.fit._importance import MixtureProposal
from finray_calib.fit._likelihood import Maxima
from finray_calib.spectra import FAMILIES
from tests.fit.synthetic_bands import LOG_NORMAL, orange, simulate

PRIOR = EmissionPrior().of(LOG_NORMAL, with_blocking=True)
CENTRE = PRIOR.mean + 0.3 * PRIOR.sd
MIX = np.tril(np.full((6, 6), 0.3), -1) + np.eye(6)
COVARIANCE = (0.1 * MIX @ MIX.T) * np.outer(PRIOR.sd, PRIOR.sd) * 0.1
LN_MASS = -12.3


def normal_density(theta):
    """A normal density of mass exp(-12.3)."""
    return multivariate_normal(CENTRE, COVARIANCE).logpdf(theta) + LN_MASS


def laplace():
    peak = np.array([multivariate_normal(CENTRE, COVARIANCE).logpdf(CENTRE) + LN_MASS])
    return MixtureProposal.around(Maxima(CENTRE[None], peak, np.linalg.inv(COVARIANCE)[None]), PRIOR)


def test_evidence_and_moments_of_a_normal_density():
    sample = importance_sample(normal_density, laplace(), 8000, np.random.default_rng(1))
    assert sample.trusted
    assert sample.ln_evidence == pytest.approx(LN_MASS, abs=4 * sample.ln_evidence_sd)  # error rate 6e-5
    assert sample.ln_evidence_sd < 0.02
    sd = np.sqrt(np.diag(COVARIANCE))
    mean = sample.weight @ sample.theta
    apart = sample.theta - mean
    # five standard errors
    assert (np.abs(mean - CENTRE) < 5 * sd / np.sqrt(sample.effective)).all()
    got = (sample.weight[:, None] * apart).T @ apart / np.outer(sd, sd)
    assert np.allclose(got, COVARIANCE / np.outer(sd, sd), atol=5 * np.sqrt(2 / sample.effective))


def test_reported_error_of_the_evidence_is_its_scatter():
    samples = [importance_sample(normal_density, laplace(), 1000, np.random.default_rng(seed)) for seed in range(100)]
    scatter = np.std([s.ln_evidence for s in samples], ddof=1)
    # relative standard error of a standard deviation of 100 values: 7 %; four of them
    assert np.mean([s.ln_evidence_sd for s in samples]) == pytest.approx(scatter, rel=0.28)


def test_resampled_frequencies_are_the_weights():
    sample = importance_sample(normal_density, laplace(), 500, np.random.default_rng(1))
    count = 100_000
    draws = sample.resampled(count, np.random.default_rng(2))
    rows, times = np.unique(draws[:, 0], return_counts=True)
    frequency = dict(zip(rows, times, strict=True))
    got = np.array([frequency.get(value, 0) for value in sample.theta[:, 0]])
    assert np.abs(got - count * sample.weight).max() <= 1 + 1e-6  # systematic resampling rounds up or down
    assert abs(np.corrcoef(draws[:-1, 0], draws[1:, 0])[0, 1]) < 5 / np.sqrt(count)  # random order


def test_a_proposal_beside_the_density_is_not_trusted():
    beside = MixtureProposal(np.ones(1), CENTRE[None] + 12 * np.sqrt(np.diag(COVARIANCE)), COVARIANCE[None], PRIOR)
    sample = importance_sample(normal_density, beside, 4000, np.random.default_rng(1))
    assert not sample.trusted


@pytest.mark.parametrize(
    ("name", "discrepancy"), [("log_normal_wavenumber", PAINT_DISCREPANCY), ("zheng2014", NO_DISCREPANCY)]
)
def test_evidence_is_that_of_dynesty(weights, name, discrepancy):
    """Nested sampling of the same six parameters from the prior's quantiles."""
    family = FAMILIES[name]
    data, _ = simulate(orange(name), weights, np.random.default_rng(4), family=family, discrepancy=discrepancy)
    posterior = LogPosterior(data, family, EmissionPrior(), discrepancy)
    prior, rng = posterior.prior, np.random.default_rng(5)
    maxima = find_maxima(posterior, rng)
    proposal = MixtureProposal.around(maxima, prior).adapted(posterior, rng)
    sample = importance_sample(posterior, proposal, 8000, rng)
    assert sample.trusted
    below, above = (ndtr((limit - prior.mean) / prior.sd) for limit in (prior.low, prior.high))

    def from_cube(u):
        return prior.mean + prior.sd * ndtri(below + (above - below) * np.clip(u, 1e-12, 1 - 1e-12))

    sampler = dynesty.NestedSampler(
        lambda theta: float(posterior.log_likelihood(theta[None])[0]),
        from_cube,
        prior.size,
        nlive=60,
        bound="single",
        sample="rwalk",
        walks=15,
        rstate=np.random.default_rng(6),
    )
    sampler.run_nested(dlogz=0.3, print_progress=False)
    nested = sampler.results
    # three combined standard errors
    assert sample.ln_evidence == pytest.approx(
        nested.logz[-1], abs=3 * np.hypot(nested.logzerr[-1], sample.ln_evidence_sd)
    )
