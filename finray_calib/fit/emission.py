"""Posterior of a paint's emission for one family: the whole path from band values to draws."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from data_schemas.fit import SamplingMethod
from finray_calib.fit.band_data import BandData
from finray_calib.fit.curve_draws import CurveDraws, curve_draws
from finray_calib.fit.diagnostics import ChainDiagnostics
from finray_calib.fit.discrepancy import Discrepancy
from finray_calib.fit.importance import SMALLEST_EFFECTIVE_SHARE, WeightedSample, importance_sample
from finray_calib.fit.likelihood import LogPosterior
from finray_calib.fit.map_search import Maxima, find_maxima, starting_points
from finray_calib.fit.mixture_proposal import GOOD_EFFECTIVE_SHARE, MixtureProposal
from finray_calib.fit.predictive import BandCheck, check_bands
from finray_calib.fit.prior import EmissionPrior
from finray_calib.fit.resample_move import MovedDraws, moved_draws
from finray_calib.fit.sampler import SamplerSettings, sample_posterior
from finray_calib.spectra.curve_quantities import CurveQuantities, curve_quantities
from finray_calib.spectra.emission_families import EmissionFamily

FloatArray = NDArray[np.float64]

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
