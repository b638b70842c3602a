r"""Gauge repeatability and reproducibility: how much of what is seen is the measurement, and how surely that is known.

Samples are measured in sessions, all samples in each (crossed): a session homes the wheel and starts the lamp anew. In
each session a sample may be mounted several times (nested), with repeats of each mount,

.. math:: y = \mu + P_i + S_j + (PS)_{ij} + M_{k(ij)} + e_{l(ijk)}

Without mounts it is the design of the AIAG's manual, with operators for sessions. Variances follow from the mean
squares of the analysis of variance; the variance of the measurement is the sum of all but that of the samples, a
combination :math:`\gamma = \sum c_i MS_i` with no c below 0. Its interval is that of the modified large-sample method,

.. math:: \gamma - \sqrt{\textstyle\sum (G_i c_i MS_i)^2}, \quad \gamma + \sqrt{\textstyle\sum (H_i c_i MS_i)^2}, \quad
    G_i = 1 - \nu_i / \chi^2_{1-\alpha/2, \nu_i}, \quad H_i = \nu_i / \chi^2_{\alpha/2, \nu_i} - 1

which covers at its rate where Satterthwaite's and the bootstrap fall short. Share and number of distinct categories
have the intervals of generalised draws :math:`MS_i \nu_i / \chi^2`. All effects are taken as normal and independent.

References
----------
Burdick, Borror, Montgomery, Design and Analysis of Gauge R&R Studies, SIAM 2005. AIAG, Measurement Systems Analysis,
4th edition 2010.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f

from data_schemas import CheckVerdict, FinrayError

Floats = NDArray[np.float64]
POOLED_ABOVE: Final = 0.25
"""p of the interaction from which it is pooled with the repeats (AIAG's manual); others take 0.05."""
ACCEPTED_SHARE, REFUSED_SHARE = 0.10, 0.30
"""Of the measurement's standard deviation in the total one: below, acceptable; above, not (AIAG)."""
FEWEST_SESSIONS: Final = 6
"""Below it the interval of the measurement's standard deviation spans a factor of five and more."""
DRAWS: Final = 20_000
_ALPHA: Final = 0.05


@dataclass(frozen=True, slots=True)
class Stratum:
    """A line of the analysis of variance.

    Attributes
    ----------
    source
        What varies.
    freedom, mean_square
        Degrees of freedom, and the mean square.
    f_ratio, p
        Against the stratum below it, and the probability of a larger one by chance; None for the last.
    variance
        Estimate of the variance, 0 where it came out negative.
    was_negative
        Whether it did.
    """

    source: str
    freedom: int
    mean_square: float
    f_ratio: float | None
    p: float | None
    variance: float
    was_negative: bool


@dataclass(frozen=True, slots=True)
class Interval:
    """Estimate with both ends of its 95 % interval."""

    estimate: float
    low95: float
    high95: float


@dataclass(frozen=True, slots=True)
class GaugeStudy:
    """What a study says of the measurement, in the unit of the values.

    Attributes
    ----------
    samples, sessions, mounts, repeats
        Its size; mounts is 1 where the samples were not mounted anew within a session.
    strata
        The analysis of variance, the samples first.
    is_pooled
        Whether the interaction was pooled with the repeats.
    gauge_sd
        Standard deviation of the measurement: repeats, mounts, sessions and their interaction with the samples.
    sample_sd
        That between samples.
    share
        Of the measurement's standard deviation in the total one ("%GRR"), 0 to 1.
    categories
        Number of distinct categories, sqrt(2) times the ratio of the standard deviations, not rounded.
    verdict
        PASS: the share is below 10 %; FAIL: above 30 %; both with its interval. UNDECIDED between.
    """

    samples: int
    sessions: int
    mounts: int
    repeats: int
    strata: tuple[Stratum, ...]
    is_pooled: bool
    gauge_sd: Interval
    sample_sd: Interval
    share: Interval
    categories: Interval
    verdict: CheckVerdict

    @property
    def distinct_categories(self) -> int:
        """Number of distinct categories as the AIAG counts it: rounded down, at least 1."""
        return max(math.floor(self.categories.estimate), 1)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader should know of the study."""
        told = [
            f"the variance of {s.source} was estimated below 0 and is set to 0" for s in self.strata if s.was_negative
        ]
        if self.is_pooled:
            told.append(
                f"the interaction was pooled with the repeats, because its p value is above {POOLED_ABOVE:g} (AIAG)"
            )
        if self.sessions < FEWEST_SESSIONS:
            told.append(
                f"only {self.sessions} sessions were measured, so differences between sessions are poorly known and "
                f"the interval is wide; measure in {FEWEST_SESSIONS} or more sessions"
            )
        return tuple(told)


def gauge_study(values: Floats, pooled_above: float = POOLED_ABOVE) -> GaugeStudy:
    """Analyse a balanced study.

    Parameters
    ----------
    values
        (samples, sessions, mounts, repeats), in any unit.
    pooled_above
        p of the interaction from which it is pooled with the repeats; 1 never pools. Not used with mounts.

    Raises
    ------
    FinrayError
        Fewer than two samples or sessions, nothing repeated, values that are not finite, or no scatter at all.
    """
    p, s, m, r = values.shape
    _check(values)
    if m > 1 and r > 1:
        strata, combination, parts = _nested(values)
        is_pooled = False
    else:
        strata, combination, parts, is_pooled = _crossed(values.reshape(p, s, m * r), pooled_above)
    squares = np.array([stratum.mean_square for stratum in strata])
    freedom = np.array([stratum.freedom for stratum in strata])
    gauge_variance = sum(stratum.variance for stratum in strata[1:])
    low, high = mls_interval(combination, squares, freedom)
    gauge_sd = Interval(math.sqrt(gauge_variance), math.sqrt(max(low, 0.0)), math.sqrt(high))
    sample_sd, ratio = _generalised(strata[0].variance, gauge_variance, combination, parts, squares, freedom)
    share = Interval(*(1.0 / math.sqrt(1.0 + x**2) for x in (ratio.estimate, ratio.high95, ratio.low95)))
    categories = Interval(*(math.sqrt(2.0) * x for x in (ratio.estimate, ratio.low95, ratio.high95)))
    verdict: CheckVerdict = "PASS" if share.high95 <= ACCEPTED_SHARE else "UNDECIDED"
    verdict = "FAIL" if share.low95 > REFUSED_SHARE else verdict
    return GaugeStudy(p, s, m, r, strata, is_pooled, gauge_sd, sample_sd, share, categories, verdict)


def balanced_values(measurements: Sequence[tuple[str, str, str, float]]) -> Floats:
    """Return the values of a study as an array (samples, sessions, mounts, repeats).

    Parameters
    ----------
    measurements
        Sample, session, mount (within sample and session) and value of each capture.

    Raises
    ------
    FinrayError
        Some sample has more or fewer captures in some session, or in some mount, than another.
    """
    cells: dict[tuple[str, str], dict[str, list[float]]] = {}
    for sample, session, mount, value in measurements:
        cells.setdefault((sample, session), {}).setdefault(mount, []).append(value)
    samples, sessions = (list(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))
    sizes = {
        (sample, session): [len(values) for values in cells.get((sample, session), {}).values()]
        for sample in samples
        for session in sessions
    }
    if not sizes:
        raise FinrayError("gauge study: the file lists no capture; add one row for each capture")
    usual = next(iter(sizes.values()))
    for (sample, session), size in sizes.items():
        if size != usual or len(set(usual)) > 1:
            raise FinrayError(
                f"gauge study: sample {sample} in session {session} has {len(size)} mounts with {size} captures, but "
                "every sample needs the same number of mounts, and of captures of each mount, in every session; "
                "complete the sample, or leave the sample or the session out"
            )
    return np.array([[list(cells[sample, session].values()) for session in sessions] for sample in samples])


def _check(values: Floats) -> None:
    """Refuse what holds no study."""
    p, s, m, r = values.shape
    if p < 2 or s < 2 or m * r < 2:
        raise FinrayError(
            f"gauge study: has {p} samples, {s} sessions, {m} mounts and {r} repeats, but needs at least two samples, "
            "two sessions, and two mounts or two repeats"
        )
    if not np.isfinite(values).all():
        raise FinrayError(
            "gauge study: at least one value is not a finite number; give a finite value for every capture"
        )
    if not (values.var(axis=(2, 3)) > 0).any():
        raise FinrayError(
            "gauge study: values do not differ at all between mounts and repeats, so their scatter "
            "cannot be estimated; give values with all their digits"
        )


def mls_interval(combination: Floats, squares: Floats, freedom: Floats) -> tuple[float, float]:
    """Return the 95 % interval of a sum of mean squares with weights of 0 or more, by the modified large-sample method.

    Parameters
    ----------
    combination, squares, freedom
        (n,) weights, mean squares and their degrees of freedom.
    """
    parts = combination * squares
    lower = 1.0 - freedom / chi2.ppf(1.0 - _ALPHA / 2, freedom)
    upper = freedom / chi2.ppf(_ALPHA / 2, freedom) - 1.0
    centre, below, above = float(parts.sum()), ((lower * parts) ** 2).sum(), ((upper * parts) ** 2).sum()
    return centre - math.sqrt(float(below)), centre + math.sqrt(float(above))


def _generalised(
    sample_variance: float, gauge_variance: float, combination: Floats, parts: Floats, squares: Floats, freedom: Floats
) -> tuple[Interval, Interval]:
    """Return the standard deviation between samples, and its ratio to the measurement's, by generalised draws."""
    drawn = squares * freedom / np.random.default_rng(0).chisquare(freedom, (DRAWS, len(freedom)))
    sample_sd, gauge_sd = np.sqrt(np.maximum(drawn @ parts, 0.0)), np.sqrt(drawn @ combination)
    ends = [_ALPHA / 2, 1.0 - _ALPHA / 2]
    return (
        Interval(math.sqrt(sample_variance), *map(float, np.quantile(sample_sd, ends))),
        Interval(math.sqrt(sample_variance / gauge_variance), *map(float, np.quantile(sample_sd / gauge_sd, ends))),
    )


_Analysis = tuple[tuple[Stratum, ...], Floats, Floats]


def _strata(sources: Sequence[tuple[str, float, int, int, float]]) -> tuple[Stratum, ...]:
    """Return the lines of (source, sum of squares, freedom, line that it is tested against, observations a level)."""
    squares = [sum_of_squares / freedom for _, sum_of_squares, freedom, _, _ in sources]
    lines = []
    for number, (source, _, freedom, below, size) in enumerate(sources):
        own, last = squares[number], number == len(sources) - 1
        other = 0.0 if last else squares[below]
        ratio = None if last or other <= 0.0 else own / other
        chance = None if ratio is None else float(f.sf(ratio, freedom, sources[below][2]))
        variance = own if last else (own - other) / size
        lines.append(Stratum(source, freedom, own, ratio, chance, max(variance, 0.0), variance < 0.0))
    return tuple(lines)


def _crossed(values: Floats, pooled_above: float) -> tuple[tuple[Stratum, ...], Floats, Floats, bool]:
    """Analyse (samples, sessions, repeats)."""
    p, s, r = values.shape
    of_samples, of_sessions, cells, mean = _means(values)
    samples, sessions = s * r * ((of_samples - mean) ** 2).sum(), p * r * ((of_sessions - mean) ** 2).sum()
    both = r * ((cells - of_samples[:, None] - of_sessions[None] + mean) ** 2).sum()
    repeats = ((values - cells[:, :, None]) ** 2).sum()
    df_both, df_repeats = (p - 1) * (s - 1), p * s * (r - 1)
    strata = _strata([
        ("samples", samples, p - 1, 2, s * r),
        ("sessions", sessions, s - 1, 2, p * r),
        ("samples x sessions", both, df_both, 3, r),
        ("repeats", repeats, df_repeats, 3, 1),
    ])  # fmt: skip
    chance = strata[2].p
    if chance is None or chance <= pooled_above:
        combination = np.array([0.0, 1 / (p * r), (p - 1) / (p * r), (r - 1) / r])
        return strata, combination, np.array([1.0, 0.0, -1.0, 0.0]) / (s * r), False
    pooled = _strata([
        ("samples", samples, p - 1, 2, s * r),
        ("sessions", sessions, s - 1, 2, p * r),
        ("repeats", both + repeats, df_both + df_repeats, 2, 1),
    ])  # fmt: skip
    return pooled, np.array([0.0, 1 / (p * r), 1 - 1 / (p * r)]), np.array([1.0, 0.0, -1.0]) / (s * r), True


def _nested(values: Floats) -> _Analysis:
    """Analyse (samples, sessions, mounts, repeats) with mounts nested in samples and sessions."""
    p, s, m, r = values.shape
    mounts = values.mean(axis=3)
    of_samples, of_sessions, cells, mean = _means(mounts)
    strata = _strata([
        ("samples", s * m * r * ((of_samples - mean) ** 2).sum(), p - 1, 2, s * m * r),
        ("sessions", p * m * r * ((of_sessions - mean) ** 2).sum(), s - 1, 2, p * m * r),
        ("samples x sessions", m * r * ((cells - of_samples[:, None] - of_sessions[None] + mean) ** 2).sum(),
         (p - 1) * (s - 1), 3, m * r),
        ("mounts", r * ((mounts - cells[:, :, None]) ** 2).sum(), p * s * (m - 1), 4, r),
        ("repeats", ((values - mounts[..., None]) ** 2).sum(), p * s * m * (r - 1), 4, 1),
    ])  # fmt: skip
    combination = np.array([0.0, 1 / (p * m * r), (p - 1) / (p * m * r), (m - 1) / (m * r), (r - 1) / r])
    return strata, combination, np.array([1.0, 0.0, -1.0, 0.0, 0.0]) / (s * m * r)


def _means(values: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Return the means of samples, of sessions, of both together, and of all values (samples, sessions, repeats)."""
    return values.mean(axis=(1, 2)), values.mean(axis=(0, 2)), values.mean(axis=2), float(values.mean())
