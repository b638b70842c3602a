r"""Charts of a quantity over sessions: is it still what it was, with a stated rate of false alarms.

Two charts watch a series :math:`x_i`, standardised by mean and standard deviation of the m sessions of the reference.
Shewhart's alarms where one session stands out, :math:`|x_i| > k`. The exponentially weighted mean

.. math:: z_i = \lambda x_i + (1 - \lambda) z_{i-1}, \quad |z_i| > L \sqrt{\lambda / (2 - \lambda)}

alarms where several lean the same way. After an alarm both begin anew. The false alarms of a session are one over the
mean number of sessions to an alarm of either, which the Markov chain of the weighted mean gives (Brook and Evans 1972).
Mean and standard deviation of few sessions are poorly known: with limits that ignore it, ten sessions of reference give
up to 25 times the false alarms that were asked for. Here the rate is averaged over what the reference may have been:
k is the prediction limit of Student's t for half of the rate, L follows so that both charts together keep all of it.

Valid for sessions that are independent and normally distributed while nothing is wrong.

References
----------
Roberts, Technometrics 1 (1959) 239-250. Lucas and Saccucci, Technometrics 32 (1990) 1-12. Brook and Evans, Biometrika
59 (1972) 539-549.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import chi2, norm
from scipy.stats import t as student

from data_schemas import FinrayError

Floats = NDArray[np.float64]
ChartName = Literal["Shewhart", "EWMA"]

SMOOTHING_FACTOR: Final = 0.2
FEWEST_REFERENCE: Final = 6
"""Sessions of a reference: with fewer, limits are so wide that little is seen."""
OUTLIER_P: Final = 0.01
"""Below it, a session of the reference stands out from the others (Grubbs' test)."""
_STATES, _NODES = 81, 16


@dataclass(frozen=True, slots=True)
class ChartRules:
    """Limits of both charts.

    Attributes
    ----------
    false_alarm_share
        Rate for one session of one quantity, for which the limits were computed.
    reference
        Sessions of the reference; None where mean and standard deviation are known.
    shewhart_factor
        k, in standard deviations of the reference.
    smoothing_factor, ewma_factor
        The weight of the newest session, and L, in standard deviations of the weighted mean.
    """

    false_alarm_share: float
    reference: int | None
    shewhart_factor: float
    smoothing_factor: float
    ewma_factor: float

    @property
    def ewma_limit_factor(self) -> float:
        """Largest weighted mean that is allowed, in standard deviations of the reference."""
        return self.ewma_factor * math.sqrt(self.smoothing_factor / (2.0 - self.smoothing_factor))


@lru_cache
def chart_rules(
    false_alarm_share: float, reference: int | None = None, smoothing_factor: float = SMOOTHING_FACTOR
) -> ChartRules:
    """Return limits that keep a rate of false alarms.

    Parameters
    ----------
    false_alarm_share
        Share of the sessions of one quantity with nothing wrong that give an alarm.
    reference
        Number of sessions that mean and standard deviation were estimated from; None where they are known.
    smoothing_factor
        Weight of the newest session in the weighted mean.

    Raises
    ------
    FinrayError
        The rate or the weight is out of range, or the reference has too few sessions.
    """
    if not 1e-6 <= false_alarm_share <= 0.2:
        raise FinrayError(f"false alarms: {false_alarm_share:g} is out of range; give 0.000001 to 0.2 of the sessions")
    if not 0.01 <= smoothing_factor <= 1.0:
        raise FinrayError(f"weight of the newest session: {smoothing_factor:g} is out of range; give 0.01 to 1")
    if reference is not None and reference < FEWEST_REFERENCE:
        raise FinrayError(f"reference of {reference} sessions: give {FEWEST_REFERENCE} or more")
    if reference is None:
        shewhart_factor = float(norm.isf(false_alarm_share / 4))
    else:
        shewhart_factor = float(student.isf(false_alarm_share / 4, reference - 1)) * math.sqrt(1.0 + 1.0 / reference)

    def excess(ewma_factor: float) -> float:
        rules = ChartRules(false_alarm_share, reference, shewhart_factor, smoothing_factor, ewma_factor)
        return math.log(false_alarm_rate(rules) / false_alarm_share)

    highest = shewhart_factor / math.sqrt(
        smoothing_factor / (2.0 - smoothing_factor)
    )  # beyond it the other chart alarms first
    ewma_factor = float(brentq(excess, 0.2, highest, xtol=1e-4))
    return ChartRules(false_alarm_share, reference, shewhart_factor, smoothing_factor, ewma_factor)


def false_alarm_rate(rules: ChartRules) -> float:
    """Return the false alarms for each session, averaged over what the reference may have been."""
    if rules.reference is None:
        return 1.0 / run_length(rules)
    freedom = rules.reference - 1
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    scales = np.sqrt(chi2.ppf(0.5 + 0.5 * nodes, freedom) / freedom)
    shifts, shares = np.polynomial.hermite_e.hermegauss(_NODES)
    shifts, shares = shifts / math.sqrt(rules.reference), shares / shares.sum()
    upper = shifts > 0  # both signs are alike
    rate = 0.0
    for scale, weight in zip(scales, 0.5 * weights, strict=True):
        for shift, share in zip(shifts[upper], 2.0 * shares[upper], strict=True):
            rate += weight * share / run_length(rules, float(shift), float(scale))
    return rate


def run_length(rules: ChartRules, shift_sd: float = 0.0, scale: float = 1.0) -> float:
    """Return the mean number of sessions to an alarm of either chart.

    Parameters
    ----------
    rules
        The limits.
    shift_sd
        True mean minus that of the reference, in true standard deviations.
    scale
        Standard deviation of the reference over the true one.
    """
    limit, weight = scale * rules.ewma_limit_factor, rules.smoothing_factor
    width = 2.0 * limit / _STATES
    places = -limit + width * (np.arange(_STATES) + 0.5)
    most = scale * rules.shewhart_factor
    upper = (places[None] + width / 2 - (1.0 - weight) * places[:, None]) / weight
    lower = upper - width / weight
    inside = ndtr(np.clip(upper, -most, most) - shift_sd) - ndtr(np.clip(lower, -most, most) - shift_sd)
    lengths = np.linalg.solve(np.eye(_STATES) - inside, np.ones(_STATES))
    return float(lengths[_STATES // 2])


@dataclass(frozen=True, slots=True)
class Alarm:
    """A session at which a chart alarmed: its place in the series, counted from 0."""

    place: int
    chart: ChartName


@dataclass(frozen=True, slots=True)
class Chart:
    """One quantity over sessions.

    Attributes
    ----------
    values
        (n,) in the unit of the quantity.
    mean, sd
        Of the reference.
    weighted
        (n,) exponentially weighted mean, in the unit of the quantity; the mean over the reference.
    rules
        Limits.
    alarms
        Alarms behind the reference, oldest first.
    outlier
        Place of the session that stands out of the reference; None where none does.
    """

    values: Floats
    mean: float
    sd: float
    weighted: Floats
    rules: ChartRules
    alarms: tuple[Alarm, ...]
    outlier: int | None


def watch(values: Sequence[float], rules: ChartRules, cleared: int = 0) -> Chart:
    """Chart a series whose first sessions are the reference.

    Parameters
    ----------
    values
        One for each session, oldest first.
    rules
        Limits, for the number of sessions of the reference.
    cleared
        Alarms before this place were looked into: the charts begin anew there.

    Raises
    ------
    FinrayError
        The series is shorter than its reference, holds a value that is not finite, or does not scatter in it.
    """
    series, count = np.asarray(values, dtype=np.float64), rules.reference or 0
    if count < 2 or series.size < count or not np.isfinite(series).all():
        raise FinrayError(f"series of {series.size} values: it needs the {count} of its reference, all finite numbers")
    mean, sd = float(series[:count].mean()), float(series[:count].std(ddof=1))
    if not sd > 0.0:
        raise FinrayError(
            "the sessions of the reference are all alike, so that it is not known how much they may differ"
        )
    weighted, alarms, z = np.full(series.size, mean), [], 0.0
    for place in range(max(count, cleared), series.size):
        x = (series[place] - mean) / sd
        z = rules.smoothing_factor * x + (1.0 - rules.smoothing_factor) * z
        weighted[place] = mean + sd * z
        found: list[ChartName] = []
        if abs(x) > rules.shewhart_factor:
            found.append("Shewhart")
        if abs(z) > rules.ewma_limit_factor:
            found.append("EWMA")
        alarms += [Alarm(place, chart) for chart in found]
        z = 0.0 if found else z
    return Chart(series, mean, sd, weighted, rules, tuple(alarms), _outlier(series[:count]))


def _outlier(reference: Floats) -> int | None:
    """Return the place of a session that stands out of the others (Grubbs' test, two sides), or None."""
    n = reference.size
    departures = np.abs(reference - reference.mean()) / reference.std(ddof=1)
    critical = float(student.isf(OUTLIER_P / (2 * n), n - 2))
    limit = (n - 1) / math.sqrt(n) * math.sqrt(critical**2 / (n - 2 + critical**2))
    return int(departures.argmax()) if departures.max() > limit else None
