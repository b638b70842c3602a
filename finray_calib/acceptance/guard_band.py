r"""The decision rule of a check: guard bands on both sides of every limit (:mod:`finray_calib.acceptance.conformity`).

A value y with standard uncertainty u passes an upper limit T when

.. math:: y + k u \le T, \quad k = 1.645,

and fails it when ``y - k u > T``; between the two it is undecided. With a normally distributed value a quantity at the
limit passes, and fails, in 5 % of all checks each; one beyond it passes more rarely.
"""

import math
from typing import Final

from data_schemas.check import CheckResult, Section, Verdict
from finray_calib.acceptance.conformity import (
    COVERAGE_FACTOR,
    ISO_14253_1_FACTOR,
    ToleranceInterval,
    Zone,
    conformance_probability,
    zone,
)

GUARD_FACTOR: Final = ISO_14253_1_FACTOR * COVERAGE_FACTOR
"""Of the standard uncertainty: 95 % of a normal distribution lie on one side."""
_WORST_FIRST: Final[tuple[Verdict, ...]] = ("FAIL", "ERROR", "UNDECIDED", "PASS")
_VERDICTS: Final[dict[Zone, Verdict]] = {"accept": "PASS", "not decided": "UNDECIDED", "reject": "FAIL"}


def verdict_of(value: float, sd: float, low: float | None, high: float | None) -> Verdict:
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


def overall(results: tuple[CheckResult, ...]) -> Verdict:
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
    *,
    low: float | None = None,
    high: float | None = None,
) -> CheckResult:
    """Return the result of a check with a number, judged against its limits."""
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


def unmeasured(section: Section, name: str, what: str, verdict: Verdict, evidence: str, limit: str = "") -> CheckResult:
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
