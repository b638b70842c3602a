"""Posterior draws by Markov chains: emcee, an importance sample that is carried on, and the diagnostics of both.

emcee moves its walkers by differential evolution, snooker, stretch and jumps between all maxima. An importance sample
that falls short is moved by Markov steps until nothing tells where a draw began. R-hat, effective sample size and
autocorrelation time take chains of one quantity as (steps, chains); walkers of an ensemble are treated as chains.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import FitError
from finray_calib.fit._importance import WeightedSample, tempered_weights
from finray_calib.fit._likelihood import Maxima

FloatArray = NDArray[np.float64]

LARGEST_R_HAT = 1.01
SMALLEST_EFFECTIVE_SAMPLES = 400.0
"""A chain is trusted below this R-hat and above this effective sample size (Vehtari and others, 2021)."""

_WINDOW = 5.0  # Sokal: sum the autocorrelation to the first lag beyond five autocorrelation times


@dataclass(frozen=True, slots=True)
class ChainDiagnostics:
    """How far the chains can be trusted, per parameter.

    Attributes
    ----------
    r_hat
        (6,) rank-normalised split R-hat, 1 when the chains agree.
    bulk_ess
        (6,) bulk effective sample size.
    autocorrelation_steps
        (6,) integrated autocorrelation time, steps.
    acceptance
        Accepted share of the proposals.
    steps
        Steps kept per walker, after the discarded start.
    walkers
        Number of walkers.
    converged
        True when the chain is longer than the demanded number of autocorrelation times and R-hat is close to 1.
    """

    r_hat: FloatArray
    bulk_ess: FloatArray
    autocorrelation_steps: FloatArray
    acceptance: float
    steps: int
    walkers: int
    converged: bool


def rank_r_hat(chains: FloatArray) -> float:
    """Return the rank-normalised split R-hat, the larger of bulk and folded.

    sqrt(((n - 1)/n W + B/n) / W) of the normal scores of the ranks of the split chains; folded with
    abs(x - median). Valid for four or more steps.

    Parameters
    ----------
    chains
        (steps, chains) values of one quantity.

    References
    ----------
    Vehtari, Gelman, Simpson, Carpenter, Buerkner, Rank-normalization, folding, and localization: an improved
    R-hat, Bayesian Analysis 16 (2021) 667-718.
    """
    halves = _split(chains)
    return max(_r_hat(_normal_scores(halves)), _r_hat(_normal_scores(np.abs(halves - np.median(halves)))))


def bulk_ess(chains: FloatArray) -> float:
    """Return the bulk effective sample size of the rank-normalised split chains.

    S / (1 + 2 sum rho_t) with Geyer's initial monotone positive sequence over pairs of lags, S the number of
    values; at most S log10(S).

    Parameters
    ----------
    chains
        (steps, chains) values of one quantity.

    References
    ----------
    Vehtari et al., Bayesian Analysis 16 (2021) 667-718, section 3.2.
    """
    scores = _normal_scores(_split(chains))
    steps, count = scores.shape
    covariance = _autocovariance(scores).mean(axis=1)
    within = covariance[0] * steps / (steps - 1)
    between = scores.mean(axis=0).var(ddof=1) if count > 1 else 0.0
    marginal = within * (steps - 1) / steps + between
    rho = 1 - (within - covariance * steps / (steps - 1)) / marginal
    rho[0] = 1.0
    pairs = rho[: steps // 2 * 2].reshape(-1, 2).sum(axis=1)
    positive = pairs[: int(np.argmax(pairs <= 0))] if (pairs <= 0).any() else pairs
    tau = max(-1 + 2 * float(np.minimum.accumulate(positive).sum()), 1 / np.log10(scores.size))
    return float(scores.size / tau)


def autocorrelation_time(chains: FloatArray) -> float:
    """Return the integrated autocorrelation time in steps, 1 + 2 sum rho_t, with Sokal's window.

    The autocorrelation functions are averaged over the chains. Trust it when the chains are longer than 50
    times the result.

    Parameters
    ----------
    chains
        (steps, chains) values of one quantity.

    References
    ----------
    Goodman, Weare, Comm. Appl. Math. Comp. Sci. 5 (2010) 65-80; Sokal, Monte Carlo methods (1989).
    """
    covariance = _autocovariance(chains).mean(axis=1)
    tau = 2 * np.cumsum(covariance / covariance[0]) - 1
    beyond = np.arange(tau.size) >= _WINDOW * tau
    return float(tau[np.argmax(beyond)] if beyond.any() else tau[-1])


def _split(chains: FloatArray) -> FloatArray:
    """Return first and second halves as separate chains."""
    half = chains.shape[0] // 2
    return np.concatenate([chains[:half], chains[-half:]], axis=1)


def _normal_scores(values: FloatArray) -> FloatArray:
    """Return the normal quantiles of the fractional ranks."""
    from scipy.special import ndtri  # here, because it takes long to load, and most fits have no chain

    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(count) - (count - 1) / 2)[place].reshape(values.shape)  # repeated values share their mean rank
    return np.asarray(ndtri((ranks - 0.375) / (values.size + 0.25)))


def _r_hat(chains: FloatArray) -> float:
    """Return the Gelman-Rubin ratio of chains."""
    steps = chains.shape[0]
    within = chains.var(axis=0, ddof=1).mean()
    between = chains.mean(axis=0).var(ddof=1)
    return float(np.sqrt((steps - 1) / steps + between / within))


def _autocovariance(chains: FloatArray) -> FloatArray:
    """Return the biased autocovariance of each chain by FFT, (steps, chains)."""
    steps = chains.shape[0]
    size = 1 << (2 * steps - 1).bit_length()
    spectrum = np.fft.rfft(chains - chains.mean(axis=0), n=size, axis=0)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, n=size, axis=0)[:steps] / steps)


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
                f"sampler: walkers must be an even number of at least {LEAST_WALKERS}, twice the parameters of the "
                f"largest model, but is {self.walkers}"
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


IntArray = NDArray[np.int64]

LARGEST_MEMORY: Final = 0.15
"""Correlation with the start; chance alone leaves 0.1 as the largest of thirty columns of 1000 draws."""

SMALLEST_DISTINCT_SHARE: Final = 0.8
"""Of the draws: copies that never moved apart are one draw, whatever their ranks say."""

_FEWEST_OF_A_MAXIMUM: Final = 10  # draws: chance overlap of fewer would look like memory

_BLOCKS: Final = (100, 200, 400)  # sweeps; each is tried where the one before did not suffice
_OPTIMAL_STEP: Final = 2.38  # times the difference of two draws, over sqrt(2 D): best for a normal posterior
_SHORT_STEP: Final = 0.3  # of that, every second time: for bent ridges
_BETWEEN_MAXIMA: Final = 0.1  # share of steps by the whole difference, which leads from one maximum to another
_JITTER: Final = 1e-5  # of the spread: the steps must be able to reach every point


@dataclass(frozen=True, slots=True)
class MovedDraws:
    """Posterior draws and how far they forgot where they began.

    Attributes
    ----------
    theta
        (N, D) draws of equal weight.
    memory
        Largest correlation with what was before the last block of sweeps: of ranks and of distances from the middle
        rank of each parameter, of the ranks of the density, and of belonging to each maximum.
    sweeps
        Moves tried by each draw.
    """

    theta: FloatArray
    memory: float
    sweeps: int

    @property
    def distinct(self) -> int:
        """Number of different draws."""
        return len(np.unique(self.theta, axis=0))

    @property
    def forgotten(self) -> bool:
        """Whether nothing that was looked at depends on the importance sample that the draws came from."""
        return self.memory <= LARGEST_MEMORY and self.distinct >= SMALLEST_DISTINCT_SHARE * len(self.theta)


def moved_draws(
    log_density: LogDensity,
    proposal: Proposal,
    sample: WeightedSample,
    maxima: Maxima,
    count: int,
    rng: np.random.Generator,
) -> MovedDraws:
    """Return draws of a density: an importance sample resampled, then moved until it has forgotten itself.

    One sweep lets each draw jump to a draw of the proposal (accepted as in an independence chain), the next one lets it
    step by the difference of two others (differential evolution; the two come from the other half, so that the
    density is kept). An importance sample that is right on average but uneven becomes even; tails that it missed are
    reached from the draws beside them. Sweeps cannot tell of a maximum, or of the far end of a ridge, that no draw
    has met, nor of an exchange with a place that holds a few draws in a hundred and is none of the known maxima.

    Parameters
    ----------
    log_density
        Function of (n, D) rows returning (n,) log densities.
    proposal
        Normalised density that covers the posterior, roughly.
    sample
        Weighted draws of that proposal.
    maxima
        Of the density: draws must change between them.
    count
        Number of draws.
    rng
        Source of all randomness.

    References
    ----------
    Gilks, Berzuini, Following a moving target: Monte Carlo inference for dynamic Bayesian models, J. Royal Statistical
    Society B 63 (2001) 127-146; ter Braak, Statistics and Computing 16 (2006) 239-249.
    """
    population = _Population(log_density, proposal, sample.resampled(count, rng), rng)
    memory = 1.0
    for block in _BLOCKS:
        start = population.columns(maxima)
        for _ in range(block // 2):
            population.sweep(population.jump)
            population.sweep(population.step)
        memory = _largest_correlation(start, population.columns(maxima))
        if memory <= LARGEST_MEMORY:
            break
    return MovedDraws(population.theta, memory, population.sweeps)


class _Population:
    """Draws on the move and their log densities."""

    def __init__(
        self, log_density: LogDensity, proposal: Proposal, theta: FloatArray, rng: np.random.Generator
    ) -> None:
        self.theta, self.sweeps = theta, 0
        self._log_density, self._proposal, self._rng = log_density, proposal, rng
        self._density = log_density(theta)
        self._jitter = _JITTER * theta.std(axis=0)

    def sweep(self, move: Callable[[IntArray, IntArray], FloatArray]) -> None:
        """Let each half of the draws, cut anew, make one move while the other half stands still."""
        order = self._rng.permutation(len(self.theta))
        middle = len(order) // 2
        for moving, standing in ((order[:middle], order[middle:]), (order[middle:], order[:middle])):
            theta = move(moving, standing)
            density = self._log_density(theta)
            ln_ratio = density - self._density[moving]
            if move == self.jump:
                ln_ratio += self._proposal.log_density(self.theta[moving]) - self._proposal.log_density(theta)
            taken = np.log(self._rng.random(len(moving))) < ln_ratio
            self.theta[moving[taken]], self._density[moving[taken]] = theta[taken], density[taken]
        self.sweeps += 1

    def jump(self, moving: IntArray, _: IntArray) -> FloatArray:
        """Return draws of the proposal."""
        return self._proposal.draw(len(moving), self._rng)

    def step(self, moving: IntArray, standing: IntArray) -> FloatArray:
        """Return the draws shifted along differences of two standing ones."""
        count, size = len(moving), self.theta.shape[1]
        first = self._rng.integers(len(standing), size=count)
        second = (first + self._rng.integers(1, len(standing), size=count)) % len(standing)
        length = _OPTIMAL_STEP / np.sqrt(2 * size) * self._rng.choice([1.0, _SHORT_STEP], size=count)
        length[self._rng.random(count) < _BETWEEN_MAXIMA] = 1.0
        apart = self.theta[standing[first]] - self.theta[standing[second]]
        jitter = self._jitter * self._rng.standard_normal((count, size))
        return np.asarray(self.theta[moving] + length[:, None] * apart + jitter)

    def columns(self, maxima: Maxima) -> FloatArray:
        """Return what a draw must forget, (N, columns), each column around 0."""
        ranks = _centred_ranks(np.column_stack([self.theta, self._density]))
        apart = self.theta[:, None] - maxima.theta
        nearest = np.einsum("nki,kij,nkj->nk", apart, maxima.information, apart).argmin(axis=1)
        belongs = (nearest[:, None] == np.arange(len(maxima.theta))).astype(np.float64)
        return np.column_stack([ranks, _centred_ranks(np.abs(ranks)), belongs - belongs.mean(axis=0)])


def _centred_ranks(values: FloatArray) -> FloatArray:
    """Return the ranks of each column around 0; equal values, copies of one draw, keep their order."""
    order = values.argsort(axis=0, kind="stable").argsort(axis=0, kind="stable")
    return np.asarray(order - (len(values) - 1) / 2)


def _largest_correlation(first: FloatArray, second: FloatArray) -> float:
    """Return the largest size of the correlation of columns; those of maxima that hold hardly a draw do not count."""
    products, squares = (first * second).sum(axis=0), np.square([first, second]).sum(axis=1)
    counted = squares.min(axis=0) >= _FEWEST_OF_A_MAXIMUM
    return float(np.abs(products[counted] / np.sqrt(squares[0] * squares[1])[counted]).max())
