"""A result of an acceptance check in words, the same on the terminal, in JUnit XML and on the page."""

import math

from data_schemas.check import CheckResult


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
