"""How far inputs may vary before a result is too much worse, and which of them makes it so: limits and Sobol' indices.

Arithmetic on tables of inputs and results. A polynomial chaos stands for a result that is slow to compute; what it does
not explain is found by leaving each run out in turn, and widens every interval. The intervals of the posterior alone
hold the true index far too seldom, because what the polynomial leaves out is not in them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Final

import numpy as np
from numpy.polynomial.legendre import legval
from numpy.typing import NDArray
from scipy.stats import qmc

from data_schemas import DecideError

Floats = NDArray[np.float64]
Orders = NDArray[np.int64]

#: Of the posterior of each of six fits; the 95 % limits of an index are then known to a tenth of their width.
_DRAWS: Final = 100
_MOST_TERMS: Final = 700
_HIGHEST_ORDERS: Final = (1, 2, 3, 4, 6, 8)
_DECAYS: Final = (1.0, 0.3, 0.1)
_NOISES: Final = tuple(10.0 ** np.arange(-6.0, 2.0))
_ROUNDS: Final = 3  # of learning which inputs count
_LEAST_RELEVANCE: Final = 1e-3
_CONSTANT: Final = 100.0  # prior variance of the mean; the values have variance 1
LIMITS: Final = (0.025, 0.975)


@dataclass(frozen=True, slots=True)
class Estimates:
    """Estimates with 95 % limits, each (input,)."""

    value: Floats
    low: Floats
    high: Floats


@dataclass(frozen=True, slots=True)
class SobolIndices:
    """Shares of the variance of a result.

    Attributes
    ----------
    first
        Share that an input makes alone.
    total
        Share that would be gone if the input did not vary.
    unexplained_share
        Share of the variance that the emulator does not explain, 1 - Q2. An index below it is not distinguishable
        from 0.
    """

    first: Estimates
    total: Estimates
    unexplained_share: float

    @property
    def distinguishable(self) -> NDArray[np.bool_]:
        """Whether the total index is above what is not explained."""
        return np.asarray(self.total.value > self.unexplained_share)


@dataclass(frozen=True, slots=True)
class ChaosEmulator:
    """A result as a sum of products of Legendre polynomials of its inputs, with the posterior of the coefficients.

    Attributes
    ----------
    orders
        Order of each input in each term, (term, input); the first term is the constant.
    coefficients
        Mean of the posterior, (term,).
    draws
        Of the posterior of this fit and of those to four fifths of the runs, (draw, term).
    q2
        Share of the variance of runs that are left out (a fifth at a time, or one) which the others predict.
    residual
        Standard deviation of what is not predicted.
    unexplained_high
        97.5 % limit of the share that is not predicted, 1 - Q2, by resampling the runs.
    """

    orders: Orders
    coefficients: Floats
    draws: Floats
    q2: float
    residual: float
    unexplained_high: float

    def predict(self, inputs: Floats) -> Floats:
        """Return the result at inputs (point, input) of -1 to 1, (point,)."""
        return np.asarray(_terms(inputs, self.orders) @ self.coefficients)

    def predict_draws(self, inputs: Floats) -> Floats:
        """Return the draws of the result, (draw, point)."""
        return np.asarray(self.draws @ _terms(inputs, self.orders).T)


def fit_chaos(inputs: Floats, values: Floats, seed: int = 0) -> ChaosEmulator:
    r"""Fit a polynomial chaos by Bayesian linear regression.

    .. math:: y = \sum_a c_a \prod_i P_{a_i}(x_i) \sqrt{2 a_i + 1}, \quad c_a \sim N(0, \tau^2 w_a)

    Terms of one and of two inputs. Highest order, decay of the prior with the order, noise and the relevance of each
    input are those that best predict runs that are left out. Valid for a smooth result of independent inputs that are
    uniform within -1 to 1; interactions of three inputs stay unexplained.

    Parameters
    ----------
    inputs
        (run, input), -1 to 1.
    values
        Results, (run,).
    seed
        Of the draws.

    Raises
    ------
    DecideError
        With fewer runs than twice the inputs, shapes that do not fit, inputs outside -1 to 1, or values that are all
        equal.

    References
    ----------
    B. Sudret, Global sensitivity analysis using polynomial chaos expansions, Reliab. Eng. Syst. Saf. 93 (2008) 964-979.
    """
    _check_runs(inputs, values)
    rng = np.random.default_rng(seed)
    orders, mean, draws, left_out = _fitted(inputs, values, rng)
    # what was chosen by the runs left out must not be judged by them: folds choose and fit for themselves
    fold = rng.permutation(len(values)) % _FOLDS
    errors, of_folds = np.empty(len(values)), [(orders, draws)]
    for k in range(_FOLDS):
        held = fold == k
        fold_orders, fold_mean, fold_draws, _ = _fitted(inputs[~held], values[~held], rng)
        errors[held] = _terms(inputs[held], fold_orders) @ fold_mean - values[held]
        of_folds.append((fold_orders, fold_draws))
    shares = errors**2 / float(values.var())
    unexplained = max(float(shares.mean()), left_out)
    resampled = shares[rng.integers(len(shares), size=(_RESAMPLED, len(shares)))].mean(axis=1)
    high = max(unexplained, float(np.quantile(resampled, LIMITS[1])))
    orders, draws = _on_common_terms(of_folds)
    full = np.zeros(len(orders))
    full[: len(mean)] = mean
    return ChaosEmulator(orders, full, draws, 1.0 - unexplained, float(values.std() * np.sqrt(unexplained)), high)


_FOLDS: Final = 5
_RESAMPLED: Final = 400


def _fitted(inputs: Floats, values: Floats, rng: np.random.Generator) -> tuple[Orders, Floats, Floats, float]:
    """Return orders, mean and draws of the coefficients, and the share of the variance that is not predicted."""
    # values that the runs left out alone make different are all equal here
    centre, scale = float(values.mean()), float(values.std()) or 1.0
    standard = (values - centre) / scale
    candidates = [_orders(inputs.shape[1], highest) for highest in _HIGHEST_ORDERS]
    tried = [
        (*found, orders)
        for number, orders in enumerate(candidates)
        if number == 0 or len(orders) <= _MOST_TERMS
        for decay in _DECAYS
        for found in _learned(_terms(inputs, orders), orders, standard, decay)
    ]
    left_out, weights, noise, orders = min(tried, key=lambda one: one[0])
    mean, draws = _posterior(_terms(inputs, orders), standard, weights, noise, left_out, rng)
    mean, draws = scale * mean, scale * draws
    mean[0] += centre
    draws[:, 0] += centre
    return orders, mean, draws, left_out


def _on_common_terms(fits: Sequence[tuple[Orders, Floats]]) -> tuple[Orders, Floats]:
    """Return the terms of all fits, those of the first one first, and all draws on them."""
    column: dict[tuple[int, ...], int] = {}
    for orders, _ in fits:
        for term in orders.tolist():
            column.setdefault(tuple(term), len(column))
    pooled = []
    for orders, draws in fits:
        wide = np.zeros((len(draws), len(column)))
        wide[:, [column[tuple(term)] for term in orders.tolist()]] = draws
        pooled.append(wide)
    return np.array(list(column), dtype=np.int64), np.concatenate(pooled)


def sobol_indices(emulator: ChaosEmulator) -> SobolIndices:
    r"""Return first and total Sobol' indices of inputs that are uniform within -1 to 1.

    .. math:: S_i = \sum_{a: only\ i} c_a^2 / \sum_{a \ne 0} c_a^2, \quad T_i = \sum_{a: a_i > 0} c_a^2 / \sum c_a^2

    Intervals (95 %) are those of the posterior, widened at both ends by the upper limit of the unexplained share: it
    may belong to any input, or to none.
    """
    unexplained = float(np.clip(1.0 - emulator.q2, 0.0, 1.0))
    alone = (emulator.orders > 0) & ((emulator.orders > 0).sum(axis=1) == 1)[:, None]
    return SobolIndices(_shares(emulator, alone), _shares(emulator, emulator.orders > 0), unexplained)


def _shares(emulator: ChaosEmulator, mask: NDArray[np.bool_]) -> Estimates:
    """Return the share of the variance in the terms of each input."""
    value = _share(emulator.coefficients[None], mask)[0]
    low, high = np.quantile(_share(emulator.draws, mask), LIMITS, axis=0)
    unexplained = min(max(emulator.unexplained_high, 0.0), 1.0)
    return Estimates(value, np.maximum(low - unexplained, 0.0), np.minimum(high + unexplained, 1.0))


def _share(coefficients: Floats, mask: NDArray[np.bool_]) -> Floats:
    """Return (draw, input)."""
    squares = coefficients[:, 1:] ** 2
    return np.asarray(squares @ mask[1:] / np.maximum(squares.sum(axis=1, keepdims=True), np.finfo(np.float64).tiny))


@dataclass(frozen=True, slots=True)
class Limit:
    """How far a size may go; 95 % limits. None where all that was tried is allowed."""

    value: float | None
    low: float | None
    high: float | None


def limit_of_curve(sizes: Sequence[float], losses: Sequence[float], allowed: float, noise: float) -> Limit:
    """Return where a loss first exceeds what is allowed, linear between sizes; the loss is 0 at size 0.

    Parameters
    ----------
    sizes
        Tried, > 0, in any order.
    losses
        At these sizes.
    allowed
        Largest loss.
    noise
        Standard deviation of a loss; the limits are those of losses two of them higher and lower.
    """
    order = np.argsort(sizes)
    size = np.concatenate([[0.0], np.asarray(sizes, dtype=np.float64)[order]])
    loss = np.concatenate([[0.0], np.asarray(losses, dtype=np.float64)[order]])
    return Limit(*(_crossing(size, loss, allowed + by * noise) for by in (0.0, -2.0, 2.0)))


def _crossing(size: Floats, loss: Floats, level: float) -> float | None:
    """Return the first place at which a loss exceeds a level."""
    above = np.flatnonzero(loss[1:] > level)
    if not above.size:
        return None
    k = int(above[0]) + 1
    if loss[k - 1] >= level:  # the noise alone is as much as is allowed
        return float(size[k - 1])
    share = (level - loss[k - 1]) / (loss[k] - loss[k - 1])
    return float(size[k - 1] + share * (size[k] - size[k - 1]))


_SCALES: Final = 60
_SAMPLES: Final = 2048
CONFIDENCE: Final = 0.95


def limit_together(emulator: ChaosEmulator, allowed: float, seed: int = 0) -> Limit:
    """Return how far all inputs may vary together: largest half-range at which 95 % of results keep what is allowed.

    All inputs are uniform within plus and minus the half-range, as a share of the emulated one. A result is counted
    from that where all inputs are 0, and with the emulator's residual added in proportion to the half-range, as if all
    of it were of the result itself: on the safe side.

    Parameters
    ----------
    emulator
        Of the loss.
    allowed
        Largest loss.
    seed
        Of inputs and residuals.
    """
    rng = np.random.default_rng(seed)
    unit = 2.0 * qmc.Sobol(emulator.orders.shape[1], rng=rng).random(_SAMPLES) - 1.0
    residual = emulator.residual * rng.standard_normal(_SAMPLES)
    scales = np.linspace(0.0, 1.0, _SCALES + 1)[1:]
    drawn = emulator.predict_draws(np.zeros((1, unit.shape[1])))
    within = np.stack(
        [(emulator.predict_draws(scale * unit) - drawn + scale * residual <= allowed).mean(axis=1) for scale in scales]
    )
    of_draws = [_largest(scales, one) for one in within.T]
    low, high = np.quantile(of_draws, LIMITS)
    value = _largest(scales, within.mean(axis=1))
    return Limit(*(float(x) if x < 1.0 else None for x in (value, low, high)))


def share_within(emulator: ChaosEmulator, scale: float, allowed: float) -> float:
    """Return the share of results within what is allowed, inputs uniform within plus and minus a half-range."""
    rng = np.random.default_rng(0)
    unit = 2.0 * qmc.Sobol(emulator.orders.shape[1], rng=rng).random(2 * _SAMPLES) - 1.0
    found = emulator.predict(scale * unit) - emulator.predict(np.zeros((1, unit.shape[1])))
    found += scale * emulator.residual * rng.standard_normal(2 * _SAMPLES)
    return float((found <= allowed).mean())


def _largest(scales: Floats, within: Floats) -> float:
    """Return the last scale before the share within falls below the confidence for the first time; 1 if it never does.

    0 where even the smallest one is too large.
    """
    below = np.flatnonzero(within < CONFIDENCE)
    if not below.size:
        return 1.0
    k = int(below[0])
    if k == 0:
        return 0.0
    share = (within[k - 1] - CONFIDENCE) / (within[k - 1] - within[k])
    return float(scales[k - 1] + share * (scales[k] - scales[k - 1]))


def _check_runs(inputs: Floats, values: Floats) -> None:
    """Refuse runs that no emulator can be fitted to."""
    if inputs.ndim != 2 or values.shape != inputs.shape[:1] or len(values) < 2 * inputs.shape[1] + 2:
        raise DecideError(
            f"an emulator of {inputs.shape[-1]} inputs needs at least {2 * inputs.shape[-1] + 2} runs, got inputs of "
            f"shape {inputs.shape} and values of shape {values.shape}; give more runs"
        )
    if not (np.abs(inputs) <= 1.0).all():
        raise DecideError(f"inputs must lie between -1 and 1, got {inputs.min():g} to {inputs.max():g}")
    if not values.std() > 0.0:
        raise DecideError(
            f"all {len(values)} runs have the same value, {values[0]:g}, so nothing depends on the inputs"
        )


def _orders(inputs: int, highest: int) -> Orders:
    """Return the orders of all terms of one and two inputs up to a total order, (term, input), constant first."""
    return np.array(list(_each_order(inputs, highest)), dtype=np.int64)


def _each_order(inputs: int, highest: int) -> Iterator[list[int]]:
    yield [0] * inputs
    for k, order in product(range(inputs), range(1, highest + 1)):
        yield [order if j == k else 0 for j in range(inputs)]
    for (a, b), p in product(combinations(range(inputs), 2), range(1, highest)):
        for q in range(1, highest + 1 - p):
            yield [p if j == a else q if j == b else 0 for j in range(inputs)]


def _terms(inputs: Floats, orders: Orders) -> Floats:
    """Return the orthonormal terms at inputs, (point, term)."""
    highest = int(orders.max(initial=0))
    # (order, point, input)
    of_orders = np.stack([np.sqrt(2 * k + 1) * legval(inputs, np.eye(highest + 1)[k]) for k in range(highest + 1)])
    found = np.ones((len(inputs), len(orders)))
    for k in range(inputs.shape[1]):
        used = orders[:, k] > 0
        found[:, used] *= of_orders[orders[used, k], :, k].T
    return found


def _learned(terms: Floats, orders: Orders, values: Floats, decay: float) -> Iterator[tuple[float, Floats, float]]:
    """Yield the error of runs left out (share of the variance), prior weights and noise, as relevances are learned."""
    relevance = np.ones(orders.shape[1])
    for _ in range(_ROUNDS):
        weights = _weights(orders, relevance, decay)
        errors = _left_out(terms, values, weights)
        best = int(np.argmin(errors))
        yield float(errors[best]), weights, _NOISES[best]
        gram = (terms * weights) @ terms.T + _NOISES[best] * np.eye(len(values))
        mean = weights * (terms.T @ np.linalg.solve(gram, values))
        shares = (mean[1:] ** 2) @ (orders[1:] > 0)
        relevance = np.clip(np.sqrt(shares / max(float(shares.max()), np.finfo(np.float64).tiny)), _LEAST_RELEVANCE, 1)


def _weights(orders: Orders, relevance: Floats, decay: float) -> Floats:
    """Return the prior variance of each term, (term,)."""
    total = orders.sum(axis=1)
    weights = decay ** np.maximum(total - 1, 0) * np.prod(np.where(orders > 0, relevance, 1.0), axis=1)
    weights[0] = _CONSTANT
    return np.asarray(weights)


def _left_out(terms: Floats, values: Floats, weights: Floats) -> Floats:
    """Return the mean squared error of runs left out for each noise, exact for given weights."""
    eigenvalues, vectors = np.linalg.eigh((terms * weights) @ terms.T)
    turned = vectors.T @ values
    errors = []
    for noise in _NOISES:
        inverse = 1.0 / (np.maximum(eigenvalues, 0.0) + noise)
        residual = (vectors @ (inverse * turned)) / ((vectors**2) @ inverse)
        errors.append(float((residual**2).mean()))
    return np.array(errors)


def _posterior(
    terms: Floats, values: Floats, weights: Floats, noise: float, left_out: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return mean and draws of the coefficients; what is not predicted counts as noise of the runs.

    The prior is at most as wide as the most likely one of the values: a fit through all runs of few says nothing of the
    noise, and its coefficients would be drawn from any size.
    """
    gram = (terms * weights) @ terms.T + noise * np.eye(len(values))
    gain = weights[:, None] * np.linalg.solve(gram, terms).T
    prior_variance = min(left_out / noise, float(values @ np.linalg.solve(gram, values)) / len(values))
    before = np.sqrt(prior_variance * weights) * rng.standard_normal((_DRAWS, len(weights)))
    seen = before @ terms.T + np.sqrt(left_out) * rng.standard_normal((_DRAWS, len(values)))
    return gain @ values, before + (values - seen) @ gain.T
