"""Posterior draws by emcee: differential evolution, snooker, stretch and jumps between all maxima."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from finray_calib.fit.diagnostics import (
    LARGEST_R_HAT,
    SMALLEST_EFFECTIVE_SAMPLES,
    ChainDiagnostics,
    autocorrelation_time,
    bulk_ess,
    rank_r_hat,
)
from finray_calib.fit.mixture_proposal import tempered_weights

FloatArray = NDArray[np.float64]
LogDensity = Callable[[FloatArray], FloatArray]

LEAST_WALKERS = 24
"""Twice the parameters of the largest model: a mixture of two components with reflected laser, blocking and four own
leaks has 12."""

_DISCARDED_SHARE = 0.3
_CANDIDATES_PER_WALKER = 40


class Proposal(Protocol):
    """A normalised density that can be drawn from."""

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count, D) draws."""

    def log_density(self, theta: FloatArray) -> FloatArray:
        """Return the log density of (n, D) rows."""


@dataclass(frozen=True, slots=True)
class SamplerSettings:
    """How long and with how many walkers to sample.

    Attributes
    ----------
    walkers
        Number of walkers, even and at least twice the number of parameters of the largest model.
    block_steps
        Steps before the first convergence check.
    most_steps
        Limit of the steps; a chain that reaches it is returned as not converged.
    autocorrelation_times
        Demanded length of the kept chain in autocorrelation times.
    largest_r_hat
        Demanded rank-normalised split R-hat.
    kept_draws
        Number of thinned draws returned.

    Raises
    ------
    FitError
        When a number is out of its range.
    """

    walkers: int = 64
    block_steps: int = 300
    most_steps: int = 8000
    autocorrelation_times: float = 50.0
    largest_r_hat: float = LARGEST_R_HAT
    kept_draws: int = 4000

    def __post_init__(self) -> None:
        if self.walkers < LEAST_WALKERS or self.walkers % 2:
            raise FitError(
                f"sampler: {self.walkers} walkers; must be an even number of at least {LEAST_WALKERS}, twice the "
                "parameters of the largest model"
            )
        if not 100 <= self.block_steps <= self.most_steps:
            raise FitError(
                f"sampler: block_steps {self.block_steps} must be at least 100 and at most most_steps {self.most_steps}"
            )
        if self.kept_draws < 100:
            raise FitError(f"sampler: kept_draws {self.kept_draws} must be at least 100 for 95 % intervals")


def sample_posterior(
    log_density: LogDensity, proposal: Proposal, settings: SamplerSettings, rng: np.random.Generator
) -> tuple[FloatArray, ChainDiagnostics]:
    """Return draws from a density and the diagnostics of the chain.

    Walkers start from importance-resampled draws of the proposal, which already spreads them over separate
    maxima in nearly the right proportion; independence jumps from the same proposal keep exchanging them.
    Blocks, each at least a third of what has been run, are added until the kept chain (the first 30 % are
    discarded) is longer than the demanded number of autocorrelation times and R-hat is small, or the limit is
    reached.

    Parameters
    ----------
    log_density
        Function of (n, D) rows returning (n,) log densities, minus infinity where not allowed.
    proposal
        Normalised density that covers the posterior, roughly.
    settings
        Length and size.
    rng
        Source of all randomness.

    Returns
    -------
    tuple
        (N, D) thinned draws and the ChainDiagnostics.
    """
    import emcee  # here, because it loads scipy.stats, which takes longer than the usual fit

    start = initial_walkers(log_density, proposal, settings.walkers, rng)
    sampler = emcee.EnsembleSampler(
        settings.walkers, start.shape[1], log_density, vectorize=True, moves=_moves(proposal, rng)
    )
    legacy = np.random.RandomState(rng.integers(2**32))  # emcee takes no Generator
    state: Any = emcee.State(start, random_state=legacy.get_state())
    block = settings.block_steps
    while True:
        state = sampler.run_mcmc(state, block, skip_initial_state_check=True)
        chain = sampler.get_chain(discard=int(_DISCARDED_SHARE * sampler.iteration))
        diagnostics = _diagnose(chain, float(sampler.acceptance_fraction.mean()), settings)
        block = min(max(settings.block_steps, sampler.iteration // 3), settings.most_steps - sampler.iteration)
        if diagnostics.converged or block < 1:
            break
    flat = chain.reshape(-1, chain.shape[2])
    kept = np.linspace(0, len(flat) - 1, min(settings.kept_draws, len(flat))).round().astype(int)
    return flat[kept], diagnostics


def initial_walkers(log_density: LogDensity, proposal: Proposal, walkers: int, rng: np.random.Generator) -> FloatArray:
    """Return (walkers, D) starting points: distinct proposal draws chosen by tempered importance weight.

    The weights (density / proposal)^a are flattened, a <= 1, until their effective number is twice the
    walkers, so that a proposal that fits badly still gives an ensemble that spans all directions.
    """
    candidates = proposal.draw(_CANDIDATES_PER_WALKER * walkers, rng)
    ln_weight = log_density(candidates) - proposal.log_density(candidates)
    share = tempered_weights(ln_weight, 2.0 * walkers)
    return np.asarray(candidates[rng.choice(len(candidates), walkers, replace=False, p=share)])


def _moves(proposal: Proposal, rng: np.random.Generator) -> list[tuple[Any, float]]:
    """Return the mixture of emcee moves."""
    import emcee

    jump_rng = np.random.default_rng(rng.integers(2**63))

    def jump(coordinates: FloatArray, _: object) -> tuple[FloatArray, FloatArray]:
        proposed = proposal.draw(len(coordinates), jump_rng)
        return proposed, proposal.log_density(coordinates) - proposal.log_density(proposed)

    return [
        (emcee.moves.MHMove(jump), 0.5),
        (emcee.moves.DEMove(), 0.35),
        (emcee.moves.DEMove(gamma0=1.0), 0.05),
        (emcee.moves.DESnookerMove(), 0.05),
        (emcee.moves.StretchMove(), 0.05),
    ]


def _diagnose(chain: FloatArray, acceptance: float, settings: SamplerSettings) -> ChainDiagnostics:
    """Return the diagnostics of a (steps, walkers, D) chain."""
    columns = [chain[:, :, i] for i in range(chain.shape[2])]
    tau = np.array([autocorrelation_time(c) for c in columns])
    r_hat = np.array([rank_r_hat(c) for c in columns])
    ess = np.array([bulk_ess(c) for c in columns])
    long_enough = len(chain) >= settings.autocorrelation_times * tau.max() and ess.min() >= SMALLEST_EFFECTIVE_SAMPLES
    return ChainDiagnostics(
        r_hat=r_hat,
        bulk_ess=ess,
        autocorrelation_steps=tau,
        acceptance=acceptance,
        steps=len(chain),
        walkers=chain.shape[1],
        converged=bool(long_enough and r_hat.max() <= settings.largest_r_hat),
    )
