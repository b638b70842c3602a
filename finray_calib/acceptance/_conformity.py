r"""Does a measured quantity conform to its limits, how a check decides it, and what a certificate states of it.

All numbers of one call are in one unit, that of the quantity; probabilities are 0 to 1 (JCGM 106:2012, ISO 14253-1).

A quantity with estimate y and standard uncertainty u conforms to the tolerance interval :math:`[T_L, T_U]` with the
conformance probability :math:`p_c = P(T_L \le \eta \le T_U)`. A decision rule accepts where y lies in an acceptance
interval: inside the tolerance interval by a guard band w (guarded acceptance, ISO 14253-1), equal to it (simple
acceptance, w = 0), or outside it (guarded rejection, w < 0); w = r U with U = 2 u.

A check has guard bands on both sides of every limit: y passes an upper limit T when

.. math:: y + k u \le T, \quad k = 1.645,

and fails it when ``y - k u > T``; between the two it is undecided. With a normally distributed value a quantity at the
limit passes, and fails, in 5 % of all checks each; one beyond it passes more rarely.

Who bears the risk when many items are inspected: `global_risks`, the consumer's and the producer's (JCGM 106, 9.5).

On a certificate the coverage interval of a paint's result holds 95 % of the posterior draws, symmetric in probability
(JCGM 101). With its half width U and the standard uncertainty u of the draws,

.. math:: U = (y_{97.5} - y_{2.5}) / 2, \quad k = U / u,

so that k follows from the draws and is not taken from a normal distribution.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import date
from itertools import pairwise
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from data_schemas import (
    CERTIFIED,
    CertificateDetails,
    CertifiedName,
    CheckResult,
    CheckVerdict,
    Estimate,
    FinrayError,
    PaintCalibration,
    Reference,
    Section,
)

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
                f"tolerance interval [{self.low}, {self.high}]: at least one limit is needed, and every limit must be "
                "finite; give None for a side without a limit"
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
        raise FinrayError("standard uncertainty: is infinite, so no probability can be computed; measure again")
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
    if math.isnan(value):
        why = f"{evidence}; the observations give no number"
        return unmeasured(section, name, what, "UNDECIDED", why, limit_text(low, high, unit))
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
    """Return the probability that the quantity lies within its limits; None where its uncertainty is unbounded."""
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


def not_proven(found: CheckResult, why: str) -> CheckResult:
    """Return a result that may fail but not pass."""
    if found.verdict != "PASS":
        return found
    evidence = f"{found.evidence}; {why}"
    return found.model_copy(update={"verdict": "UNDECIDED", "p_conform": None, "evidence": evidence})


def value_text(result: CheckResult) -> str:
    """Return ``1.25 +- 0.02 s``: value and standard uncertainty, which has two significant digits; "" without value."""
    if result.value is None or result.sd is None:
        return ""
    if result.sd == 0.0 or not math.isfinite(result.sd):
        return f"{result.value:g} {result.unit}".strip()
    places = max(1 - math.floor(math.log10(result.sd)), 0)
    return f"{result.value:.{places}f} +- {result.sd:.{places}f} {result.unit}".strip()


def result_line(result: CheckResult) -> str:
    """Return a result as one line: verdict, name, value and limit, then the evidence."""
    value = value_text(result)
    limit = f" (allowed: {result.limit})" if value and result.limit else ""
    return f"{result.verdict:<9} {result.name}: {value}{limit}{'; ' if value else ''}{result.evidence}"


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
            f"support {support} and uncertainty {sd}: the support must be a finite interval with its lower limit "
            "first, and the uncertainty must be above 0; for an exact measurement, both risks are 0"
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
            f"the distribution of the items integrates to {whole:.6g} over {support}, but must integrate to 1; widen "
            "the support, or normalise the distribution to a density per unit of the quantity"
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


_EMISSION_REFERENCES: Final[tuple[Reference, ...]] = ("white reference", "filters", "lamp")
NO_REFERENCE: Final = "not traceable: no reference certificate recorded"
NOTHING_MEASURED: Final = "not traceable: no paint was measured"
SESSION_NOT_FOUND: Final = "not traceable: the session that it was measured in was not found"
CONFORMS_FROM: Final = 0.95
_QUANTILES_SD: Final = tuple(float(norm.ppf(level)) for level in (0.025, 0.16, 0.5, 0.84, 0.975))
"""Of a normal distribution, where a record holds those of the draws."""


@dataclass(frozen=True, slots=True)
class CertifiedResult:
    """One quantity of a certificate, in its unit.

    Attributes
    ----------
    name, title, unit
        The quantity.
    value, u
        Median of the draws and their standard deviation.
    low95, high95
        Coverage interval for 95 %.
    is_measured
        Whether the measurement, and not the prior, decides it: less than half of the prior's variance is left.
    traceability
        The certificates that it rests on, or that there are none.
    limits, p_conform, verdict
        The limits of the laboratory with the probability of conformity; None where it states none.
    """

    name: CertifiedName
    title: str
    unit: str
    value: float
    u: float
    low95: float
    high95: float
    is_measured: bool
    traceability: str
    limits: ToleranceInterval | None
    p_conform: float | None
    verdict: CheckVerdict | None

    @property
    def expanded(self) -> float:
        """Expanded uncertainty U: half of the coverage interval."""
        return 0.5 * (self.high95 - self.low95)

    @property
    def coverage_factor(self) -> float:
        """U over the standard uncertainty."""
        return self.expanded / self.u


def certified_results(
    paint: PaintCalibration, details: CertificateDetails, measured_on: date | None, *, is_simulated: bool | None = False
) -> tuple[CertifiedResult, ...]:
    """Return the results of a certificate.

    Parameters
    ----------
    paint
        The calibration.
    details
        References and limits of the laboratory.
    measured_on
        Day of the capture, on which a reference must have been valid; None where it is not known.
    is_simulated
        Whether the rig was simulated: then nothing is traceable, whatever the laboratory holds, and neither where
        that is not known (None), because the session was not found.

    Raises
    ------
    FinrayError
        The draws of the calibration cannot be trusted, or a quantity does not vary over them.
    """
    if not paint.diagnostics.trusted:
        raise FinrayError(
            f"'{paint.paint_name}': the draws of this fit cannot be trusted, so no uncertainty can be certified; look "
            "at the report of the fit ('finray fit --report'), then measure or fit again"
        )
    references = valid_references(details, measured_on)
    found = tuple(_result(paint, details, name, references) for name in CERTIFIED)
    if is_simulated is False:
        return found
    why = NOTHING_MEASURED if is_simulated else SESSION_NOT_FOUND
    return tuple(one if one.traceability.startswith("not") else replace(one, traceability=why) for one in found)


def _result(
    paint: PaintCalibration, details: CertificateDetails, name: CertifiedName, references: Mapping[Reference, str]
) -> CertifiedResult:
    """Return the result of one quantity."""
    title, unit = CERTIFIED[name]
    found = paint.parameters[name]
    if not found.sd > 0.0:
        raise FinrayError(f"'{paint.paint_name}': {name} has no uncertainty in this record; fit the paint again")
    is_measured = name not in paint.mostly_prior
    given = next((limits for limits in details.limits if limits.quantity == name), None)
    limits = None if given is None else ToleranceInterval(given.low, given.high)
    p_conform = None if limits is None or not is_measured else conformity_of(found, limits)
    return CertifiedResult(
        name=name,
        title=title,
        unit=unit,
        value=found.estimate,
        u=found.sd,
        low95=found.low95,
        high95=found.high95,
        is_measured=is_measured,
        traceability=_traceability(name, references, has_any=bool(details.references)),
        limits=limits,
        p_conform=p_conform,
        verdict=None if limits is None else _verdict(p_conform),
    )


def conformity_of(found: Estimate, limits: ToleranceInterval) -> float:
    r"""Return the probability that a quantity lies within its limits, from its median and intervals.

    .. math:: P(\eta \le T) = \Phi(z(T))

    with z linear between the quantiles that the record holds (2.5, 16, 50, 84 and 97.5 %) and beyond them: exact there
    for any distribution, and everywhere for a normal one.

    Parameters
    ----------
    found
        Median and intervals.
    limits
        In the unit of the quantity.
    """
    points = (found.low95, found.low68, found.estimate, found.high68, found.high95)

    def below(value: float) -> float:
        if not np.isfinite(value):
            return float(value > 0.0)
        first = min(max(int(np.searchsorted(points, value, side="right")) - 1, 0), len(points) - 2)
        width = points[first + 1] - points[first]
        if width <= 0.0:  # a quantity at the end of its range
            return float(value >= points[first])
        share = (value - points[first]) / width
        return float(norm.cdf(_QUANTILES_SD[first] + share * (_QUANTILES_SD[first + 1] - _QUANTILES_SD[first])))

    low, high = limits.edges
    return max(below(high) - below(low), 0.0)


def _verdict(p_conform: float | None) -> CheckVerdict:
    """Return the verdict of a probability of conformity; what was not measured is not decided."""
    if p_conform is None:
        return "UNDECIDED"
    if p_conform >= CONFORMS_FROM:
        return "PASS"
    return "FAIL" if p_conform <= 1.0 - CONFORMS_FROM else "UNDECIDED"


def valid_references(details: CertificateDetails, measured_on: date | None) -> dict[Reference, str]:
    """Return part -> certificate, of the references that were valid on the day of the measurement.

    One that was calibrated after that day, or had expired, does not count; where the day is not known none does that
    has a last day.
    """
    found: dict[Reference, str] = {}
    for held in details.references:
        ends = None if held.valid_until is None else date.fromisoformat(held.valid_until)
        if measured_on is None and ends is not None:
            continue
        if measured_on is not None and not date.fromisoformat(held.calibrated_on) <= measured_on <= (ends or date.max):
            continue
        found[held.of] = f"{held.number} ({held.issued_by})"
    return found


def _traceability(name: CertifiedName, references: Mapping[Reference, str], *, has_any: bool) -> str:
    """Return what a quantity is traceable through, or what it lacks."""
    needed = ("white reference",) if name == "reflectance_at_laser" else _EMISSION_REFERENCES
    lacking = [of for of in needed if of not in references]
    if not has_any:
        return NO_REFERENCE
    if lacking:
        return f"not traceable: no certificate valid on the day of the measurement for {', '.join(lacking)}"
    return "traceable through " + "; ".join(f"{of}: {references[of]}" for of in needed)
