r"""Does a measured quantity conform to its limits, and how a check decides it (JCGM 106:2012, ISO 14253-1).

All numbers of one call are in one unit, that of the quantity; probabilities are 0 to 1.

A quantity with estimate y and standard uncertainty u conforms to the tolerance interval
:math:`[T_L, T_U]` with the conformance probability :math:`p_c = P(T_L \le \eta \le T_U)`. A decision rule accepts where
y lies in an acceptance interval: inside the tolerance interval by a guard band w (guarded acceptance, ISO 14253-1),
equal to it (simple acceptance, w = 0), or outside it (guarded rejection, w < 0); w = r U with U = 2 u.

A check has guard bands on both sides of every limit: y passes an upper limit T when

.. math:: y + k u \le T, \quad k = 1.645,

and fails it when ``y - k u > T``; between the two it is undecided. With a normally distributed value a quantity at the
limit passes, and fails, in 5 % of all checks each; one beyond it passes more rarely.

Who bears the risk when many items are inspected: `global_risks`, the consumer's and the producer's (JCGM 106, 9.5).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from data_schemas import CheckResult, CheckVerdict, FinrayError, Section

Floats = NDArray[np.float64]
Zone = Literal["accept", "not decided", "reject"]

COVERAGE_FACTOR: Final = 2.0
"""Of the expanded uncertainty U = 2 u, which covers 95 % of a normal distribution."""
ISO_14253_1_FACTOR: Final = 1.645 / COVERAGE_FACTOR
"""Guard band over U for 95 % conformance probability at the end of the guard band (edition of 2017)."""


@dataclass(frozen=True, slots=True)
class ToleranceInterval:
    """Hold the lowest and highest conforming value; None where there is no limit.

    Raises
    ------
    FinrayError
        There is no limit at all, or the lower one is above the upper one.
    """

    low: float | None
    high: float | None

    def __post_init__(self) -> None:
        finite = [limit for limit in (self.low, self.high) if limit is not None]
        if not finite or not np.isfinite(finite).all():
            raise FinrayError(
                f"tolerance interval [{self.low}, {self.high}]: give a finite lower limit, a finite upper limit, or "
                "both; None stands for no limit"
            )
        if len(finite) == 2 and finite[0] > finite[1]:
            raise FinrayError(
                f"tolerance interval [{self.low}, {self.high}]: the lower limit must not be above the upper limit"
            )

    @property
    def edges(self) -> tuple[float, float]:
        """Both limits, infinite where there is none."""
        return (-np.inf if self.low is None else self.low, np.inf if self.high is None else self.high)

    def narrowed(self, guard: float) -> tuple[float, float]:
        """Return the limits moved inwards by a guard band (outwards where it is negative)."""
        low, high = self.edges
        return low + guard, high - guard


def conformance_probability(estimate: float, sd: float, tolerance: ToleranceInterval) -> float:
    """Return the probability that a normally distributed quantity conforms.

    p_c = Phi((T_U - y) / u) - Phi((T_L - y) / u). For u = 0: 1 or 0; a limit itself conforms.

    Parameters
    ----------
    estimate, sd : float
        Estimate y and standard uncertainty u, in the unit of the limits.
    tolerance : ToleranceInterval

    Returns
    -------
    float
        The specific consumer's risk of accepting this item is 1 - p_c, the producer's of rejecting it p_c.

    Raises
    ------
    FinrayError
        The uncertainty is negative, infinite or not a number.

    References
    ----------
    JCGM 106:2012, 7.2 to 7.4 and 9.3.
    """
    check_sd(sd)
    if np.isinf(sd):
        raise FinrayError("standard uncertainty inf: nothing is known, so no probability follows; measure again")
    low, high = tolerance.edges
    if sd == 0.0:
        return float(low <= estimate <= high)
    below, above = (low - estimate) / sd, (high - estimate) / sd
    # in the tail that is the farther one, so that nothing cancels
    return float(norm.cdf(-below) - norm.cdf(-above)) if below > 0 else float(norm.cdf(above) - norm.cdf(below))


def guard_band(sd: float, guard_factor: float = ISO_14253_1_FACTOR) -> float:
    """Return the guard band w = r U, U = 2 u, in the unit of the uncertainty.

    Parameters
    ----------
    sd : float
        Standard uncertainty u.
    guard_factor : float
        r. Of ISO 14253-1: 0.82; 0 is simple acceptance; 1 guards by the whole expanded uncertainty; negative values
        are guarded rejection.

    Raises
    ------
    FinrayError
        The uncertainty is negative or not a number.

    References
    ----------
    JCGM 106:2012, 8.3.2 and 8.3.3.
    """
    check_sd(sd)
    return guard_factor * COVERAGE_FACTOR * sd


def zone(estimate: float, sd: float, tolerance: ToleranceInterval, guard_factor: float = ISO_14253_1_FACTOR) -> Zone:
    """Return the verdict of a rule with guard bands on both sides of every limit.

    "accept": at least w inside all limits. "reject": more than w outside one of them. "not decided" between. With a
    factor of 0 (simple acceptance) nothing stays undecided.

    Parameters
    ----------
    estimate, sd : float
        In the unit of the limits.
    tolerance : ToleranceInterval
    guard_factor : float
        Guard band over expanded uncertainty, 0 or more.

    Raises
    ------
    FinrayError
        The factor is negative: acceptance and rejection would overlap.
    """
    if guard_factor < 0.0:
        raise FinrayError(f"guard factor {guard_factor}: must be 0 or more for a rule with three verdicts")
    guard = guard_band(sd, guard_factor)
    low, high = tolerance.edges
    if estimate + guard < low or estimate - guard > high:
        return "reject"
    return "accept" if estimate - guard >= low and estimate + guard <= high else "not decided"


def check_sd(sd: float) -> None:
    """Refuse a standard uncertainty that is negative or not a number."""
    if not sd >= 0.0:
        raise FinrayError(f"standard uncertainty {sd}: must be 0 or more, in the unit of the quantity")


GUARD_FACTOR: Final = ISO_14253_1_FACTOR * COVERAGE_FACTOR
"""Of the standard uncertainty: 95 % of a normal distribution lie on one side."""
_WORST_FIRST: Final[tuple[CheckVerdict, ...]] = ("FAIL", "ERROR", "UNDECIDED", "PASS")
_VERDICTS: Final[dict[Zone, CheckVerdict]] = {"accept": "PASS", "not decided": "UNDECIDED", "reject": "FAIL"}


def verdict_of(value: float, sd: float, low: float | None, high: float | None) -> CheckVerdict:
    """Return whether a value is inside its limits.

    Parameters
    ----------
    value, sd
        The value and its standard uncertainty, in one unit.
    low, high
        Lowest and highest allowed value; None where there is none.
    """
    if low is None and high is None:
        return "PASS"
    return _VERDICTS[zone(value, sd, ToleranceInterval(low, high))]


def overall(results: tuple[CheckResult, ...]) -> CheckVerdict:
    """Return the worst verdict: FAIL before ERROR before UNDECIDED before PASS; without results UNDECIDED."""
    found = {result.verdict for result in results}
    return next((verdict for verdict in _WORST_FIRST if verdict in found), "UNDECIDED")


def measured(
    section: Section,
    name: str,
    what: str,
    value: float,
    sd: float,
    unit: str,
    evidence: str,
    limits: ToleranceInterval | None = None,
) -> CheckResult:
    """Return the result of a check with a number, judged against its limits."""
    low, high = (None, None) if limits is None else (limits.low, limits.high)
    return CheckResult(
        section=section,
        name=name,
        what=what,
        value=value,
        unit=unit,
        sd=sd,
        low=low,
        high=high,
        limit=limit_text(low, high, unit),
        p_conform=_p_conform(value, sd, low, high),
        verdict=verdict_of(value, sd, low, high),
        evidence=evidence,
    )


def _p_conform(value: float, sd: float, low: float | None, high: float | None) -> float | None:
    """Return the probability that the quantity keeps its limits; None where its uncertainty is unbounded."""
    if low is None and high is None:
        return 1.0
    return conformance_probability(value, sd, ToleranceInterval(low, high)) if math.isfinite(sd) else None


def unmeasured(
    section: Section, name: str, what: str, verdict: CheckVerdict, evidence: str, limit: str = ""
) -> CheckResult:
    """Return the result of a check that has no number."""
    return CheckResult(
        section=section,
        name=name,
        what=what,
        value=None,
        unit="",
        sd=None,
        low=None,
        high=None,
        limit=limit,
        verdict=verdict,
        evidence=evidence,
    )


def limit_text(low: float | None, high: float | None, unit: str) -> str:
    """Return limits in words."""
    if low is None:
        text = "" if high is None else f"at most {high:.4g} {unit}"
    else:
        text = f"at least {low:.4g} {unit}" if high is None else f"{low:.4g} to {high:.4g} {unit}"
    return text.strip()


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclass(frozen=True, slots=True)
class GlobalRisks:
    """Hold the risks of inspecting many items.

    Attributes
    ----------
    consumer_share : float
        R_C: probability that an item is accepted and does not conform.
    producer_share : float
        R_P: probability that an item conforms and is rejected.
    conforming_share : float
        Probability that an item conforms, before inspection.
    """

    consumer_share: float
    producer_share: float
    conforming_share: float


def global_risks(
    prior: Callable[[Floats], Floats],
    support: tuple[float, float],
    sd: float,
    tolerance: ToleranceInterval,
    guard: float = 0.0,
) -> GlobalRisks:
    """Return the consumer's and producer's risk of inspecting items of a known distribution.

    R_C = int_{not C} g0(eta) P(accept | eta) d eta and R_P = int_C g0(eta) (1 - P(accept | eta)) d eta over conforming
    values C, with P(accept | eta) = Phi((A_U - eta) / u) - Phi((A_L - eta) / u): measurements scatter normally about
    the true value, and are accepted within the tolerance interval narrowed by the guard band.

    Parameters
    ----------
    prior : callable
        Density g0 of the quantity over the items, per unit of it, for example ``scipy.stats.gamma(4, scale=0.25).pdf``.
    support : tuple of float
        Finite interval that holds all of g0 that matters.
    sd : float
        Standard uncertainty u of one measurement, in the unit of the limits; above 0.
    tolerance : ToleranceInterval
    guard : float
        Guard band w, in that unit; negative for guarded rejection.

    Returns
    -------
    GlobalRisks

    Raises
    ------
    FinrayError
        The uncertainty is not above 0, the support is no finite interval, or the density is not 1 over it.

    References
    ----------
    JCGM 106:2012, 9.5.
    """
    check_sd(sd)
    if sd == 0.0 or not np.isfinite(support).all() or support[0] >= support[1]:
        raise FinrayError(
            f"support {support} and uncertainty {sd}: the support must be a finite interval, lowest value first, and "
            "the uncertainty of a measurement above 0; for an exact measurement both risks are 0"
        )
    value, weight = _quadrature(support, tolerance, guard, sd)
    weight = weight * np.asarray(prior(value))
    low, high = tolerance.narrowed(guard)
    # guard bands that overlap leave nothing that could be accepted
    accepted = np.maximum(norm.cdf((high - value) / sd) - norm.cdf((low - value) / sd), 0.0)
    conforms = (value >= tolerance.edges[0]) & (value <= tolerance.edges[1])
    whole = float(weight.sum())
    # a support that cuts more off than this changes risks that one would state
    if abs(whole - 1) > 1e-4:
        raise FinrayError(
            f"the distribution of the items integrates to {whole:.6g} over {support}: it must be a density, per unit "
            "of the quantity; widen the support or normalise it"
        )
    return GlobalRisks(
        consumer_share=float((weight * accepted)[~conforms].sum()),
        producer_share=float((weight * (1 - accepted))[conforms].sum()),
        conforming_share=float(weight[conforms].sum()),
    )


def _quadrature(
    support: tuple[float, float], tolerance: ToleranceInterval, guard: float, sd: float
) -> tuple[Floats, Floats]:
    """Return nodes and weights of Gauss-Legendre panels: short where acceptance changes, none across a limit."""
    bends = [limit + step * sd for limit in tolerance.narrowed(guard) for step in range(-8, 9, 2)]
    inner = [*np.linspace(*support, 33), *tolerance.edges, *bends]
    ends = sorted({float(end) for end in inner if support[0] <= end <= support[1]})
    middle, half = np.array([((b + a) / 2, (b - a) / 2) for a, b in pairwise(ends)]).T
    return (middle[:, None] + half[:, None] * _NODES).ravel(), (half[:, None] * _WEIGHTS).ravel()
