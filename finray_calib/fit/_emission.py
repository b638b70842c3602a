r"""Posterior of a paint's emission for one family: the whole path from band values to draws, curves and checks.

Given theta everything else is jointly normal, so a posterior draw of the curve with its discrepancy, and of the rig's
imperfections, is a prior draw plus the correction that its misfit to the data asks for (Matheron's rule):

.. math:: (\delta, k) = (\delta_0, k_0) + \mathrm{cov}[(\delta, k), y]\,C(\theta)^{-1}
          (y - \mu(\theta) - A\delta_0 - U k_0 - e_0)

Posterior predictive checks tell whether the fitted curve describes each band; a summary is one number and its
intervals from draws.
"""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import Estimate, FitError, SamplingMethod
from finray_calib.fit._band_data import BandData, band_values, blocking_column
from finray_calib.fit._importance import (
    GOOD_EFFECTIVE_SHARE,
    SMALLEST_EFFECTIVE_SHARE,
    MixtureProposal,
    WeightedSample,
    importance_sample,
)
from finray_calib.fit._likelihood import LogPosterior, Maxima, find_maxima, starting_points
from finray_calib.fit._markov_chains import ChainDiagnostics, MovedDraws, SamplerSettings, moved_draws, sample_posterior
from finray_calib.fit._prior import EDGE_OFFSET_FWHM, EDGE_WIDTH_FWHM, Discrepancy, EmissionPrior, chi_square_of_bands
from finray_calib.spectra import CurveQuantities, EmissionFamily, curve_quantities

FloatArray = NDArray[np.float64]

_RANK_TOLERANCE = 1e-9  # of the largest eigenvalue of the Gaussian process on the grid


@dataclass(frozen=True, slots=True)
class CurveDraws:
    """Joint posterior draws.

    Attributes
    ----------
    curves
        (n, L) emission curves with discrepancy, nm^-1; never negative, zero below the laser line.
    family_curves
        (n, L) the family's curves alone.
    imperfections
        (n, M) the rig's imperfections k in prior standard deviations: calibration of each band, then, when the
        filters have tolerances, blocking, centre and width of each filter.
    """

    curves: FloatArray
    family_curves: FloatArray
    imperfections: FloatArray


def curve_draws(log_posterior: LogPosterior, theta: FloatArray, rng: np.random.Generator) -> CurveDraws:
    """Return one joint draw of discrepancy and imperfections for each parameter row.

    Parameters
    ----------
    log_posterior
        Data, family, discrepancy and imperfections.
    theta
        (n, D) posterior draws.
    rng
        Source of all randomness.
    """
    p, data, d = log_posterior.problem, log_posterior.data, log_posterior.discrepancy
    grid, nodes = data.weights.wavelength_nm, data.quadrature.nodes_nm.ravel()
    split, count = len(grid), len(theta)
    every = np.concatenate([grid, nodes])
    shape = log_posterior.family.curves(theta, every)
    scale = shape + d.floor_rel * np.exp(theta[:, 2, None])
    edge = d.reabsorption_rel * _blue_edge(theta, every)
    relative = _smooth_draws(log_posterior, every, count, rng) + edge * rng.standard_normal((count, 1))
    delta = scale * relative
    u = log_posterior.imperfections
    k = rng.standard_normal((count, u.shape[1]))
    noise = np.linalg.cholesky(data.covariance_without_tile(data.kept))
    member = np.zeros((len(p.y), len(nodes)))  # in-band weights of each row at all nodes
    columns = p.band[:, None] * p.in_band.shape[1] + np.arange(p.in_band.shape[1])
    np.put_along_axis(member, columns, p.in_band, axis=1)
    predicted = log_posterior.predict_usable(theta)
    common = data.common_rel[:, data.kept]
    simulated = predicted * (1 + rng.standard_normal((count, len(common))) @ common)
    simulated += delta[:, split:] @ member.T + k @ u.T
    misfit = p.y - simulated - rng.standard_normal((count, len(p.y))) @ noise.T
    alpha = np.einsum("nij,nj->ni", log_posterior.precisions(theta), misfit)
    pull = (alpha @ member) * scale[:, split:]
    smooth = pull @ d.smooth_kernel(nodes, grid)
    rigid = edge[:, :split] * (pull * edge[:, split:]).sum(axis=1, keepdims=True)
    curves = shape[:, :split] + delta[:, :split] + scale[:, :split] * (smooth + rigid)
    above = grid >= data.weights.laser_nm
    k += alpha @ u
    for band, column in log_posterior.own_leaks.items():
        k[:, blocking_column(band, data.weights.bands)] = theta[:, column]
    return CurveDraws(np.maximum(curves, 0.0) * above, shape[:, :split] * above, k)


def _blue_edge(theta: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
    """Return the logistic that falls from 1 to 0 around the blue half-maximum, (n, L)."""
    mode, width = theta[:, 0, None], np.exp(theta[:, 1, None])
    u = (wavelength_nm - mode + EDGE_OFFSET_FWHM * width) / (EDGE_WIDTH_FWHM * width)
    return np.asarray(1 / (1 + np.exp(np.minimum(u, 60.0))))


def _smooth_draws(
    log_posterior: LogPosterior, wavelength_nm: FloatArray, count: int, rng: np.random.Generator
) -> FloatArray:
    """Return draws of the Gaussian process from its prior, (n, L)."""
    root = _process_root(log_posterior.discrepancy, wavelength_nm.tobytes())
    return np.asarray(rng.standard_normal((count, root.shape[1])) @ root.T)


@lru_cache(maxsize=4)
def _process_root(discrepancy: Discrepancy, wavelengths: bytes) -> FloatArray:
    """Return a factor of the process's covariance, (L, rank); all families of a fit share it."""
    wavelength_nm = np.frombuffer(wavelengths)
    roots, directions = np.linalg.eigh(discrepancy.smooth_kernel(wavelength_nm, wavelength_nm))
    large = roots > _RANK_TOLERANCE * max(float(roots[-1]), np.finfo(float).tiny)
    return np.asarray(directions[:, large] * np.sqrt(roots[large]))


_MOST_DRAWS = 500  # enough for a p-value to 2 %


@dataclass(frozen=True, slots=True)
class BandCheck:
    """Agreement of data and model in each band, channels taken together with their covariance.

    Attributes
    ----------
    chi2
        (B,) posterior mean chi-square; NaN where no channel is usable.
    degrees_of_freedom
        (B,) usable channels of the band.
    p_value
        (B,) posterior predictive probability of a larger chi-square; near 0 where the curve cannot follow the
        data. NaN where no channel is usable.
    total_chi2
        Posterior mean chi-square of all usable values with their full covariance.
    predicted_mean
        (B, C) posterior mean of the band values of the family's curve, dimensionless.
    predicted_sd
        (B, C) standard deviation of the predicted band values: posterior, imperfections of the rig and discrepancy
        together, without measurement noise. Where a value is not usable: of the posterior alone.
    """

    chi2: FloatArray
    degrees_of_freedom: NDArray[np.int64]
    p_value: FloatArray
    total_chi2: float
    predicted_mean: FloatArray
    predicted_sd: FloatArray


def check_bands(log_posterior: LogPosterior, draws: FloatArray) -> BandCheck:
    """Return the per-band posterior predictive check.

    T_b(theta) = (y - mu)_b^T C_bb^-1 (y - mu)_b with C the covariance of measurement, imperfections and discrepancy,
    over the band's usable channels. A replicate's T_b is chi-square with as many degrees of freedom as usable
    channels, so the predictive p is the mean over draws of the chi-square survival function of T_b.

    Parameters
    ----------
    log_posterior
        Measured band values with their covariance.
    draws
        (N, D) posterior draws.

    References
    ----------
    Gelman, Meng, Stern, Posterior predictive assessment of model fitness, Statistica Sinica 6 (1996) 733-807.
    """
    data, p = log_posterior.data, log_posterior.problem
    draws = draws[:: max(1, len(draws) // _MOST_DRAWS)]
    predicted, covariance = log_posterior.predict_usable(draws), log_posterior.covariances(draws)
    residual = p.y - predicted
    total = np.einsum("ni,ni->n", residual, np.linalg.solve(covariance, residual[..., None])[..., 0])
    curves = log_posterior.family.curves(draws, data.weights.wavelength_nm)
    every = band_values(curves, np.exp(draws[:, p.shapes]), data.weights, log_posterior.leaks(draws))
    variance = every.var(axis=0, ddof=1)
    measured = np.diag(data.covariance)[data.kept]
    variance[data.kept] += np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0) - measured
    shape = data.y.shape
    return BandCheck(
        *chi_square_of_bands(residual, covariance, p.band, data.weights.bands),
        float(total.mean()),
        every.mean(axis=0).reshape(shape),
        np.sqrt(np.maximum(variance, 0.0)).reshape(shape),
    )


_PILOT_DRAWS: Final = 1000
_WORTH_ADAPTING: Final = 20_000
"""Draws from which adapting the proposal, some ten thousand evaluations, pays even where the first one would do."""
_GOOD_SHARE_OF_MANY: Final = 0.55
"""Effective share at which adapting for so many draws stops: beyond it a round costs more than it gains."""

_GROWTHS: Final = 10
_TRIAL_DRAWS: Final = 2000  # tell whether a grown proposal is worth all draws
_DRAWS_OF_LAST_ADAPTATION: Final = 10_000  # a round; a curved ridge in ten dimensions needs them
_SHARE_OF_LAST_ADAPTATION: Final = 0.75  # the rest watches over what the adaptation forgot
_FEWEST_MOVED: Final = 1000  # as many as 95 % limits need
REFERENCE_ROUNDS: Final = 2
"""The filters' tolerances act at a reference fit that is refined twice; the first is fitted without them."""


FEWEST_DRAWS: Final = 100


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Size of the sampling.

    Attributes
    ----------
    importance_draws
        Draws of the proposal.
    kept_draws
        Draws of equal weight that are kept.
    good_effective_share
        Effective share of the draws at which the adaptation of a proposal stops.
    chain
        Settings of emcee, which takes over when importance sampling cannot be trusted.

    Raises
    ------
    FitError
        When there are too few draws for 95 % limits.
    """

    importance_draws: int = 6000
    kept_draws: int = 1000
    good_effective_share: float = GOOD_EFFECTIVE_SHARE
    chain: SamplerSettings = field(default_factory=SamplerSettings)

    def __post_init__(self) -> None:
        if not FEWEST_DRAWS <= self.kept_draws <= self.importance_draws:
            raise FitError(
                f"fit settings: kept_draws {self.kept_draws} must be at least {FEWEST_DRAWS} and at most "
                f"importance_draws {self.importance_draws}"
            )


@dataclass(frozen=True, slots=True)
class Sampling:
    """How the draws were made and whether they can be trusted.

    Attributes
    ----------
    method
        "importance sampling", "adapted importance sampling", "resample-move" or "emcee".
    sample
        The last importance sample; its evidence is that of the fit whatever the method, and no better than its k.
    moved
        The draws where they were moved.
    chain
        Diagnostics of emcee where it took over.
    """

    method: SamplingMethod
    sample: WeightedSample
    moved: MovedDraws | None = None
    chain: ChainDiagnostics | None = None

    @property
    def trusted(self) -> bool:
        """Whether the draws support 95 % limits."""
        if self.chain is not None:
            return self.chain.converged
        return self.sample.trusted if self.moved is None else self.moved.forgotten


@dataclass(frozen=True)
class EmissionPosterior:
    """Posterior of a paint's emission.

    Attributes
    ----------
    log_posterior
        What was sampled: data, family, prior and discrepancy.
    maxima
        All distinct maxima, best first; more than one means that the bands leave a real ambiguity.
    proposal
        Mixture that covers the posterior.
    draws
        (N, D) posterior draws of equal weight, columns as in ``log_posterior.prior.names``.
    sampling
        Method and diagnostics.
    curve_draws
        One emission curve with discrepancy for each draw.
    bands
        Posterior predictive check of each band.
    """

    log_posterior: LogPosterior
    maxima: Maxima
    proposal: MixtureProposal
    draws: FloatArray
    sampling: Sampling
    curve_draws: CurveDraws
    bands: BandCheck

    @property
    def family(self) -> EmissionFamily:
        """Family of emission curves."""
        return self.log_posterior.family

    @property
    def wavelength_nm(self) -> FloatArray:
        """Grid of the curves, (L,), nm."""
        return self.log_posterior.data.weights.wavelength_nm

    @property
    def laser_nm(self) -> float:
        """Centroid of the laser line, nm."""
        return self.log_posterior.data.weights.laser_nm

    @cached_property
    def quantities(self) -> CurveQuantities:
        """Quantities of each drawn curve, discrepancy included."""
        return curve_quantities(self.curve_draws.curves, self.wavelength_nm)

    @property
    def reflectance_at_laser(self) -> FloatArray:
        """Draws of the reflectance at the laser line, (N,)."""
        return np.asarray(np.exp(self.draws[:, self.log_posterior.problem.shapes]))

    @cached_property
    def share_below_laser(self) -> FloatArray:
        """Draws of the share of the family curve's area that lies below the laser line, (N,).

        Emission there would gain energy: a large share says that the curve's blue tail is not physical.
        """
        curves = self.family.curves(self.draws, self.wavelength_nm)
        below = curves[:, self.wavelength_nm < self.laser_nm].sum(axis=1)
        return np.asarray(below / curves.sum(axis=1))


def fit_emission(
    data: BandData,
    family: EmissionFamily,
    prior: EmissionPrior,
    discrepancy: Discrepancy,
    settings: FitSettings,
    rng: np.random.Generator,
) -> EmissionPosterior:
    """Return the posterior of a paint's emission from its band values.

    Finds all maxima, samples p(theta | y) and draws one curve with its discrepancy for each sample. Valid as far as
    the discrepancy describes how the paint leaves the family: read :attr:`EmissionPosterior.bands` before the
    intervals.

    Parameters
    ----------
    data
        Band values with covariance, usable entries and the rig's weights.
    family
        Family of emission curves.
    prior
        Prior of the quantities common to all families.
    discrepancy
        How far the paint may leave the family.
    settings
        Size of the sampling.
    rng
        Source of all randomness.
    """
    log_posterior = LogPosterior(data, family, prior, discrepancy)
    starts = starting_points(log_posterior, rng)
    if data.tolerances is not None:
        starts = np.array([log_posterior.climb(start) for start in starts])
        best, names = starts[log_posterior(starts).argmax()], log_posterior.prior.names
        for _ in range(REFERENCE_ROUNDS):
            log_posterior, best = log_posterior.refined(best)
        starts = log_posterior.carried(starts, names)
    maxima = find_maxima(log_posterior, rng, starts)
    proposal, draws, sampling = draw_posterior(log_posterior, maxima, settings, rng)
    curves = curve_draws(log_posterior, draws, rng)
    return EmissionPosterior(
        log_posterior, maxima, proposal, draws, sampling, curves, check_bands(log_posterior, draws)
    )


def draw_posterior(
    log_posterior: LogPosterior, maxima: Maxima, settings: FitSettings, rng: np.random.Generator
) -> tuple[MixtureProposal, FloatArray, Sampling]:
    """Return proposal, draws of equal weight and how they were made.

    Importance sampling around the maxima; where its diagnostic k or its effective number says no, the same with a
    proposal adapted to the posterior and grown where it falls short; where that says no, the draws are moved until they
    have forgotten where they began; where they do not, emcee with jumps between all maxima.
    """
    proposal = MixtureProposal.around(maxima, log_posterior.prior)
    method: SamplingMethod = "importance sampling"
    pilot = importance_sample(log_posterior, proposal, _PILOT_DRAWS, rng)
    many = settings.importance_draws >= _WORTH_ADAPTING
    if many or pilot.effective < SMALLEST_EFFECTIVE_SHARE * _PILOT_DRAWS:
        method = "adapted importance sampling"
        good_share = max(settings.good_effective_share, _GOOD_SHARE_OF_MANY if many else 0.0)
        proposal = proposal.adapted(log_posterior, rng, good_effective_share=good_share)
    sample = importance_sample(log_posterior, proposal, settings.importance_draws, rng)
    for growth in range(_GROWTHS):
        if sample.trusted:
            break
        method = "adapted importance sampling"
        last = growth == _GROWTHS - 1  # what growing did not mend, adapting all components together often does
        if last:
            adapted = proposal.adapted(log_posterior, rng, _DRAWS_OF_LAST_ADAPTATION)
            proposal = proposal.joined(adapted, _SHARE_OF_LAST_ADAPTATION)
        else:
            proposal = proposal.grown(sample.theta, sample.weight)
        trial = settings.importance_draws if last else min(_TRIAL_DRAWS, settings.importance_draws)
        sample = importance_sample(log_posterior, proposal, trial, rng)
        if sample.covered and trial < settings.importance_draws:
            sample = importance_sample(log_posterior, proposal, settings.importance_draws, rng)
    if sample.trusted:
        return proposal, sample.resampled(settings.kept_draws, rng), Sampling(method, sample)
    moved = moved_draws(log_posterior, proposal, sample, maxima, max(settings.kept_draws, _FEWEST_MOVED), rng)
    if moved.forgotten:
        return proposal, moved.theta[: settings.kept_draws], Sampling("resample-move", sample, moved)
    chain, diagnostics = sample_posterior(log_posterior, proposal, settings.chain, rng)
    chosen = rng.permutation(len(chain))[: settings.kept_draws]
    return proposal, chain[chosen], Sampling("emcee", sample, chain=diagnostics)


_FEWEST_DRAWS = 100


@dataclass(frozen=True, slots=True)
class Summary:
    """Estimate with equal-tailed intervals, in the unit of the draws.

    Attributes
    ----------
    estimate
        Median.
    sd
        Standard deviation.
    low68, high68
        16 % and 84 % quantiles.
    low95, high95
        2.5 % and 97.5 % quantiles.
    """

    estimate: float
    sd: float
    low68: float
    high68: float
    low95: float
    high95: float


def summarise(draws: NDArray[np.float64]) -> Summary:
    """Return median, standard deviation and equal-tailed 68 % and 95 % intervals of draws of one quantity.

    Parameters
    ----------
    draws
        (N,) posterior draws, at least 100.

    Raises
    ------
    FitError
        When there are fewer than 100 draws or one is not finite.
    """
    if draws.size < _FEWEST_DRAWS or not np.isfinite(draws).all():
        raise FitError(
            f"summary: 95 % limits need at least {_FEWEST_DRAWS} draws, all of them finite, but got {draws.size} "
            f"draws, {int((~np.isfinite(draws)).sum())} of them not finite"
        )
    low95, low68, median, high68, high95 = np.quantile(draws, [0.025, 0.16, 0.5, 0.84, 0.975])
    return Summary(float(median), float(draws.std(ddof=1)), float(low68), float(high68), float(low95), float(high95))


def estimate(draws: NDArray[np.float64]) -> Estimate:
    """Return the record of :func:`summarise`."""
    summary = summarise(draws)
    return Estimate(
        estimate=summary.estimate,
        sd=summary.sd,
        low68=summary.low68,
        high68=summary.high68,
        low95=summary.low95,
        high95=summary.high95,
    )
