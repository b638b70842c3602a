r"""The decision rule: simple acceptance of JCGM 106:2012 with a guard band on both sides of every limit.

A value y with standard uncertainty u passes an upper limit T when

.. math:: y + k u \le T, \quad k = 1.645,

and fails it when ``y - k u > T``; between the two it is undecided. With a normally distributed value a quantity at the
limit passes, and fails, in 5 % of all checks each; one beyond it passes more rarely.
"""

from typing import Final

from data_schemas.check import CheckResult, Section, Verdict

GUARD_FACTOR: Final = 1.645
"""Of the standard uncertainty: 95 % of a normal distribution lie on one side."""
_WORST_FIRST: Final[tuple[Verdict, ...]] = ("FAIL", "ERROR", "UNDECIDED", "PASS")


def verdict_of(value: float, sd: float, low: float | None, high: float | None) -> Verdict:
    """Return whether a value is inside its limits.

    Parameters
    ----------
    value, sd
        The value and its standard uncertainty, in one unit.
    low, high
        Lowest and highest allowed value; None where there is none.
    """
    guard = GUARD_FACTOR * sd
    if (low is not None and value + guard < low) or (high is not None and value - guard > high):
        return "FAIL"
    if (low is None or value - guard >= low) and (high is None or value + guard <= high):
        return "PASS"
    return "UNDECIDED"


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
        verdict=verdict_of(value, sd, low, high),
        evidence=evidence,
    )


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
