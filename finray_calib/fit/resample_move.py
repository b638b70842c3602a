"""Draws that are carried on: an importance sample moved by Markov steps until nothing tells where a draw began."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.importance import WeightedSample
from finray_calib.fit.map_search import Maxima
from finray_calib.fit.sampler import LogDensity, Proposal

FloatArray = NDArray[np.float64]
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
