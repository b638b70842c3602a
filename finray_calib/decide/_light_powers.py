"""Powers of a sensor's lights by which its coat is lit most evenly.

Light adds: what the coat sends to the camera is a sum over the lights, each traced once. The powers of least relative
variation are therefore the solution of a convex problem, found to rounding with a proof of how far it is from the
optimum. How sure the powers are follows from independent batches of paths and from draws of the paints.

All lights burn at once. What a pixel then tells of the normal is not concave in the powers once photons make its noise:
it is concave only where lights burn in turn, each with an exposure of its own. That is not solved here; what the even
powers cost in the error of the normal is evaluated by whoever can trace it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, nnls
from scipy.stats import t as student_t

from data_schemas import (
    DecideError,
    FingerDesign,
    LightPlaceMap,
    LightPowerRow,
    LightPowers,
    NormalErrorChange,
    PlainSensor,
    PropagatedDraws,
)

Floats = NDArray[np.float64]

#: Of paths and paints together. The 95 % limits of a power are then known to a tenth of their width.
DRAWS: Final = 200
#: Of the variance, beyond which no powers can do better; and of the largest variance where the least is 0.
LARGEST_GAP_REL: Final = 1e-8
_SMALLEST_GAP_REL: Final = 1e-12
_MOST_STEPS: Final = 1000
_LEAST_BATCHES: Final = 3


@dataclass(frozen=True, slots=True)
class LightBasis:
    """Brightness that each light gives to each place of the coat, at rest and touched, at the power that it has now.

    Unit: the mean over the places of all lights together, for each state and camera channel by itself; the brightness
    is the mean of the channels.

    Attributes
    ----------
    of_batches
        By independent batches of paths, (batch, light, row); a row is a place in a state, those at rest first.
    of_draws
        By draws of the paints, each with the mean of the batches, (draw, light, row); one where nothing is drawn.
    at_rest
        How many rows are at rest.
    """

    of_batches: Floats
    of_draws: Floats
    at_rest: int

    @classmethod
    def balanced(
        cls, rest: Floats, touched: Floats, drawn_rest: Floats | None = None, drawn_touched: Floats | None = None
    ) -> "LightBasis":
        """Return the basis of camera signals in any linear unit.

        Parameters
        ----------
        rest, touched
            Of each batch of paths, (batch, light, place, channel); places may differ between the two.
        drawn_rest, drawn_touched
            Of each draw of the paints, (draw, light, place, channel); without them nothing is drawn.

        Raises
        ------
        DecideError
            With fewer than three batches, or where all lights together leave a state dark.
        """
        if len(rest) < _LEAST_BATCHES:
            raise DecideError(
                f"a light basis needs at least {_LEAST_BATCHES} independent batches of paths to estimate its noise, "
                f"got {len(rest)}"
            )
        means = [one.mean(axis=0, keepdims=True) for one in (rest, touched)]
        drawn = [
            mean if given is None else given for mean, given in zip(means, (drawn_rest, drawn_touched), strict=True)
        ]
        batches = [_brightness(one, mean) for one, mean in zip((rest, touched), means, strict=True)]
        draws = [_brightness(one, one) for one in drawn]
        return cls(np.concatenate(batches, axis=2), np.concatenate(draws, axis=2), rest.shape[2])

    @property
    def mean(self) -> Floats:
        """Mean of the batches, (light, row)."""
        return np.asarray(self.of_batches.mean(axis=0))

    @property
    def mean_u(self) -> Floats:
        """Standard uncertainty of the mean by the paths, (light, row)."""
        return np.asarray(self.of_batches.std(axis=0, ddof=1) / np.sqrt(len(self.of_batches)))

    def spread(self, brightness: Floats) -> Floats:
        """Return the covariance over the places of what the lights give, mean of the states, (light, light).

        Parameters
        ----------
        brightness
            (light, row).
        """
        states = brightness[:, : self.at_rest], brightness[:, self.at_rest :]
        return np.asarray(np.mean([np.atleast_2d(np.cov(one, bias=True)) for one in states], axis=0))

    def level(self, brightness: Floats) -> Floats:
        """Return the mean over the places of what each light gives, mean of the states, (light,)."""
        return np.asarray((brightness[:, : self.at_rest].mean(axis=1) + brightness[:, self.at_rest :].mean(axis=1)) / 2)


def _brightness(signals: Floats, white: Floats) -> Floats:
    """Return white-balanced signals (sample, light, place): relative to the mean of all lights of a sample."""
    level = white.sum(axis=1).mean(axis=1)  # (sample, channel)
    seen = (level > 0.0).all(axis=0)
    if not seen.any():
        raise DecideError(
            "no channel of the camera sees the coat, even with all lights on; check the lights and the camera's "
            "response"
        )
    return np.asarray((signals[..., seen] / level[:, None, None, seen]).mean(axis=-1))


@dataclass(frozen=True, slots=True)
class PowerLimits:
    """What powers are allowed, as factors on the present ones.

    Attributes
    ----------
    low, high
        Of each light, (light,).
    share
        Of each light in the power of all now, (light,), sum 1.
    total_rel
        Largest power of all lights together, relative to now.
    """

    low: Floats
    high: Floats
    share: Floats
    total_rel: float = 1.0

    def __post_init__(self) -> None:
        """Check that powers exist.

        Raises
        ------
        DecideError
            When a lower limit is negative or above the upper one, or the lower limits need more than the total.
        """
        if not ((self.low >= 0.0) & (self.low <= self.high) & (self.high > 0.0)).all():
            raise DecideError(
                "limits of the powers must be two factors of 0 or more, the lower one first and the upper one above 0, "
                f"got {self.low.tolist()} to {self.high.tolist()}"
            )
        least = float(self.share @ self.low)
        if self.total_rel <= 0.0 or least > self.total_rel:
            raise DecideError(
                f"the lowest powers together are {least:.3g} times the present powers, but the total allows only "
                f"{self.total_rel:.3g} times; lower the lower limit or raise the total"
            )

    def brightest(self, direction: Floats) -> Floats:
        """Return the largest allowed powers in these proportions."""
        used = max(float((direction / self.high).max()), float(self.share @ direction) / self.total_rel)
        return np.asarray(direction / used)


@dataclass(frozen=True, slots=True)
class OptimalPowers:
    """Powers as factors on the present ones, (light,), their relative variance, and how much lower it could be."""

    powers: Floats
    variance_rel: float
    gap_rel: float


def most_uniform_powers(spread: Floats, level: Floats, limits: PowerLimits) -> OptimalPowers:
    r"""Return the powers p that minimise the relative variance of the brightness over the places.

    .. math:: \min_p \frac{p^T C p}{(m^T p)^2}, \quad l \le p \le h, \; a^T p \le A

    With q = p / m'p and s = 1 / m'p (Charnes and Cooper) it is the convex quadratic q'Cq within a polytope: m'q = 1,
    l s <= q <= h s, a'q <= A s. It is solved by simplicial decomposition: the least of the hull of some corners by
    non-negative least squares, then the corner that the gradient g points to, until that one's lower bound
    f(q) + g'(corner - q) is reached. Of equally even powers the brightest are returned.

    Parameters
    ----------
    spread
        C, covariance over the places of what the lights give, (light, light), symmetric; what noise makes negative is
        taken as 0.
    level
        m, mean over the places, (light,), none negative, not all 0.
    limits
        l, h, a and A.

    Raises
    ------
    DecideError
        When the problem has no solution, or the bound is not reached.

    References
    ----------
    B. von Hohenbalken, Simplicial decomposition in nonlinear programming algorithms, Math. Program. 13 (1977) 49-68.
    """
    values, vectors = np.linalg.eigh((spread + spread.T) / 2.0)
    factor = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    scale = float(np.sqrt(np.maximum(values, 0.0).max(initial=0.0))) or 1.0
    corners = _corner(np.zeros(len(level)), level, limits)[:, None]
    floor = _SMALLEST_GAP_REL * scale**2 * float((corners**2).sum())
    for _ in range(_MOST_STEPS):
        # |F q|^2 + (1 - sum)^2 over all scales is least in the direction of the least |F q|^2 of sum 1
        weights, _ = nnls(np.vstack([factor @ corners / scale, np.ones(corners.shape[1])]), _last_of(len(level) + 1))
        used = weights > 0.0
        corners, weights = corners[:, used], weights[used] / weights.sum()
        at = corners @ weights
        variance = float(((factor @ at) ** 2).sum())
        gradient = 2.0 * factor.T @ (factor @ at)
        corner = _corner(gradient, level, limits)
        gap = max(float(gradient @ (at - corner)), 0.0)
        if gap <= max(LARGEST_GAP_REL * variance, floor):
            return OptimalPowers(limits.brightest(at), variance, gap)
        corners = np.column_stack([corners, corner])
    raise DecideError(
        f"the search for the most even powers did not converge in {_MOST_STEPS} steps (the variance of {variance:.2g} "
        f"could still fall by up to {gap:.2g}); give wider limits, or fewer lights"
    )


def _last_of(size: int) -> Floats:
    """Return the unit vector of the last axis."""
    return np.asarray(np.eye(size)[-1])


def _corner(gradient: Floats, level: Floats, limits: PowerLimits) -> Floats:
    """Return the corner q of the polytope that is least along a gradient."""
    count = len(level)
    lines = np.vstack([
        np.column_stack([np.eye(count), -limits.high]),
        np.column_stack([-np.eye(count), limits.low]),
        np.append(limits.share, -limits.total_rel),
    ])  # fmt: skip
    largest = float(np.abs(gradient).max()) or 1.0
    found = linprog(
        np.append(gradient / largest, 0.0), A_ub=lines, b_ub=np.zeros(len(lines)), A_eq=np.append(level, 0.0)[None],
        b_eq=[1.0], bounds=[(0.0, None)] * (count + 1), method="highs",
    )  # fmt: skip
    if found.x is None:
        raise DecideError(f"no powers meet the limits ({found.message}); widen the limits")
    return np.asarray(found.x[:count], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class UniformPowers:
    """The most even powers and how sure they are.

    Attributes
    ----------
    powers
        Recommended, factors on those of now, (light,).
    variation_now_rel, variation_rel
        Standard deviation over the places of the brightness over its mean, each state by itself, with the powers of
        now and the recommended ones.
    gap_rel
        Of the variation: no allowed powers are more even than by this share of it, on this basis.
    power_draws
        The most even powers of each draw of paths and paints, (draw, light).
    variation_now_draws, variation_draws
        With the powers of now, and with the recommended ones, (draw,).
    brightness_rel
        Mean brightness over that of now.
    """

    powers: Floats
    variation_now_rel: float
    variation_rel: float
    gap_rel: float
    power_draws: Floats
    variation_now_draws: Floats
    variation_draws: Floats
    brightness_rel: float

    @property
    def gain_rel_draws(self) -> Floats:
        """By which share the variation falls, (draw,)."""
        now = self.variation_now_draws
        # a draw without any variation, once noise is taken out of it, can lose none
        return np.asarray(1.0 - np.divide(self.variation_draws, now, out=np.ones_like(now), where=now > 0.0))


def even_powers(basis: LightBasis, limits: PowerLimits, seed: int = 0, draws: int = DRAWS) -> UniformPowers:
    r"""Find the powers by which the coat is lit most evenly, and draw how they scatter with paths and paints.

    A draw is one draw of the paints and one of the mean of the batches: batches B_r scatter about their mean by
    :math:`E_r = (B_r - \bar B) / \sqrt{R (R - 1)}`, and :math:`\sum_r g_r E_r`, g normal, divided by the root of
    :math:`\chi^2_{R-1} / (R - 1)`, scatters as the mean does. Noise is taken out of every variance: it would count as
    unevenness.

    Parameters
    ----------
    basis
        What each light gives.
    limits
        Allowed powers.
    seed
        Of the draws.
    draws
        How many.

    Raises
    ------
    DecideError
        See :func:`most_uniform_powers`.
    """
    rng = np.random.default_rng(seed)
    mean, batches = basis.mean, len(basis.of_batches)
    scatter = (basis.of_batches - mean) / np.sqrt(batches * (batches - 1.0))
    noise = np.sum([basis.spread(one) for one in scatter], axis=0)
    now = np.ones(mean.shape[0])
    best = most_uniform_powers(basis.spread(mean) - noise, basis.level(mean), limits)
    found = np.empty((draws, len(now)))
    variation = np.empty((2, draws))
    for d in range(draws):
        factor2 = (batches - 1.0) / rng.chisquare(batches - 1.0)
        moved = np.tensordot(rng.standard_normal(batches), scatter, axes=1) * np.sqrt(factor2)
        drawn = basis.of_draws[d % len(basis.of_draws)] + moved
        spread, level = basis.spread(drawn) - (1.0 + factor2) * noise, basis.level(drawn)
        found[d] = most_uniform_powers(spread, level, limits).powers
        variation[:, d] = [_variation(spread, level, powers) for powers in (now, best.powers)]
    spread, level = basis.spread(mean) - noise, basis.level(mean)
    return UniformPowers(
        powers=best.powers,
        variation_now_rel=_variation(spread, level, now),
        variation_rel=_variation(spread, level, best.powers),
        # of a root half as much
        gap_rel=0.5 * best.gap_rel / best.variance_rel if best.variance_rel > 0.0 else 0.0,
        power_draws=found,
        variation_now_draws=variation[0],
        variation_draws=variation[1],
        brightness_rel=float(level @ best.powers / level.sum()),
    )


def _variation(spread: Floats, level: Floats, powers: Floats) -> float:
    """Return the relative standard deviation; 0 where it is within the noise."""
    return float(np.sqrt(np.maximum(powers @ spread @ powers, 0.0)) / (level @ powers))


@dataclass(frozen=True, slots=True)
class PoweredLight:
    """A light in words, where its power stands in the design, and that power."""

    field: str
    light: str
    power_rel: float


def error_change(now_deg: Floats, recommended_deg: Floats) -> NormalErrorChange:
    """Return what the powers do to the error of the normal, from paired draws of paths, paints and noise, (draw,) each.

    The interval is that of one more draw, Student's, since a real finger has one pair of paints and no mean of them.

    Raises
    ------
    DecideError
        With fewer than three draws.
    """
    count = len(now_deg)
    if count < _LEAST_BATCHES:
        raise DecideError(f"a change of the error needs at least {_LEAST_BATCHES} draws, got {count}")
    change = recommended_deg / now_deg - 1.0
    reach = student_t.ppf(0.975, count - 1) * change.std(ddof=1) * np.sqrt(1.0 + 1.0 / count)
    middle = float(change.mean())
    return NormalErrorChange(
        now_deg=float(now_deg.mean()), recommended_deg=float(recommended_deg.mean()), change_rel=middle,
        low95_rel=middle - float(reach), high95_rel=middle + float(reach),
    )  # fmt: skip


def light_powers(
    subject: FingerDesign | PlainSensor,
    lights: Sequence[PoweredLight],
    basis: LightBasis,
    limits: PowerLimits,
    found: UniformPowers,
    places_mm: Floats,
    normal_error: NormalErrorChange | None = None,
    mapped: LightPlaceMap | None = None,
) -> LightPowers:
    """Return powers, what they gain and what they cost as a record.

    Parameters
    ----------
    subject
        The finger or classic sensor as it is now.
    lights
        In the order of the basis.
    basis, limits, found
        What was solved.
    places_mm
        (x, z) of each row of the basis, (row, 2).
    normal_error
        What the powers do to it; None where it is not evaluated.
    mapped
        The finger over two of its numbers.
    """
    rows = tuple(
        LightPowerRow(
            field=one.field, light=one.light, now_rel=one.power_rel, least_rel=one.power_rel * limits.low[k],
            most_rel=one.power_rel * limits.high[k], power_rel=float(one.power_rel * found.powers[k]),
            optimum_rel=PropagatedDraws(one.power_rel * found.power_draws[:, k]).as_estimate(),
            share_now=float(limits.share[k]),
        )
        for k, one in enumerate(lights)
    )  # fmt: skip
    record = LightPowers(
        name=f"{subject.name}, lights",
        sentence="",
        rows=rows,
        total_rel=limits.total_rel,
        variation_now_rel=PropagatedDraws(found.variation_now_draws).as_estimate(),
        variation_rel=PropagatedDraws(found.variation_draws).as_estimate(),
        gain_rel=PropagatedDraws(found.gain_rel_draws).as_estimate(),
        gap_rel=found.gap_rel,
        brightness_rel=found.brightness_rel,
        normal_error=normal_error,
        at_rest=basis.at_rest,
        places_mm=places_mm,
        basis=basis.mean,
        basis_u=basis.mean_u,
        power_draws=found.power_draws,
        map=mapped,
        design=subject if isinstance(subject, FingerDesign) else None,
        sensor=subject if isinstance(subject, PlainSensor) else None,
        notes=_NOTES,
    )
    return record.model_copy(update={"sentence": powers_sentence(record)})


_NOTES: Final = (
    "the powers minimise the relative variation of the brightness, without and with contact, where all lights are on "
    "at once; this problem is convex, so no other allowed powers light the coat more evenly in this computation",
    "the powers that give the most information on the normal under shot noise were not sought; finding them is a "
    "convex problem only where the lights are switched on in turn, each with an exposure of its own",
    "intervals include the noise of the render and, for a finger, the draws of its paints; they include neither the "
    "differences between the LEDs of a batch nor the difference between the simulation and the real sensor",
    "power_rel is a factor of radiance, and the light of an LED is not proportional to its current; adjust "
    "the current until a picture shows that factor",
)


def powers_sentence(record: LightPowers) -> str:
    """Say which powers to set, what they gain, and what they do to the error of the normal."""
    now, then, gain = record.variation_now_rel, record.variation_rel, record.gain_rel
    if len(record.rows) == 1:
        return (
            "There is only one light, so its power does not change how evenly the pad is lit: the brightness of the "
            f"coat varies by {100 * now.estimate:.0f} % over the pad ({100 * now.low95:.0f} % to "
            f"{100 * now.high95:.0f} %)."
        )
    told = ", ".join(f"{row.light} at {row.power_rel:.3g}" for row in record.rows[:_MOST_NAMED])
    more = f" and {len(record.rows) - _MOST_NAMED} more as listed" if len(record.rows) > _MOST_NAMED else ""
    may_stay = record.total_rel >= 1.0 and all(row.least_rel <= row.now_rel <= row.most_rel for row in record.rows)
    if gain.high95 <= _NO_GAIN and may_stay:
        return (
            "No powers within the limits light the pad more evenly: keep the present powers. The brightness of the "
            f"coat then varies by {100 * now.estimate:.0f} % over the pad."
        )
    if gain.high95 <= _NO_GAIN:
        sentence = (
            "No powers within the limits light the pad more evenly than the present powers, which are outside the "
            f"limits. The most even powers within them are {told}{more}: the brightness of the coat then varies by "
            f"{100 * then.estimate:.0f} % over the pad."
        )
    else:
        stay = ", so the powers may stay as they are" if may_stay else ""
        lead = "Set" if gain.low95 > 0.0 else f"No gain is certain{stay}. The most even powers are"
        sentence = (
            f"{lead} {told}{more}: the brightness of the coat then varies by {100 * then.estimate:.0f} % over the pad "
            f"in place of {100 * now.estimate:.0f} %, {100 * gain.estimate:.0f} % less ({100 * gain.low95:.0f} to "
            f"{100 * gain.high95:.0f} %), at {record.brightness_rel:.2f} times the brightness."
        )
    error = record.normal_error
    if error is None:
        return f"{sentence} What this does to the error of the normal is not evaluated for a classic sensor."
    if error.low95_rel <= 0.0 <= error.high95_rel:
        what = "does not change significantly"
    else:
        what = f"{'grows' if error.change_rel > 0.0 else 'falls'} by {100 * abs(error.change_rel):.1f} %"
    return (
        f"{sentence} The expected error of the sensed normal {what} ({100 * error.low95_rel:+.1f} to "
        f"{100 * error.high95_rel:+.1f} %), from {error.now_deg:.2f} to {error.recommended_deg:.2f} deg."
    )


_MOST_NAMED: Final = 6
_NO_GAIN: Final = 0.005
