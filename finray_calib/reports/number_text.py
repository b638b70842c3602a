"""Numbers as a reader should see them: as many digits as the interval supports, never more."""

import math
import re

from data_schemas.estimate import Estimate

NO_VALUE = "\N{EN DASH}"
"""Stands where there is no number to show."""

_SIGNIFICANT_OF_HALF_WIDTH = 2
_MOST_DECIMALS = 6


def decimals_for(half_width: float) -> int:
    """Return how many decimals show a half-width with two significant digits, at most 6; below 0 for tens."""
    if not (math.isfinite(half_width) and half_width > 0):
        return 3
    magnitude = math.floor(math.log10(half_width))
    return min(_SIGNIFICANT_OF_HALF_WIDTH - 1 - magnitude, _MOST_DECIMALS)


def interval_text(estimate: float, low: float, high: float, unit: str = "", most_decimals: int = 6) -> str:
    """Return ``597.1 [596.0, 598.3] nm``: estimate and interval, rounded to what the interval supports."""
    if low == high == estimate:
        return f"{significant(estimate)} {unit}".strip()
    places = min(decimals_for((high - low) / 2), most_decimals)
    return f"{fixed(estimate, places)} [{fixed(low, places)}, {fixed(high, places)}] {unit}".strip()


def estimate_text(value: Estimate, unit: str = "", factor: float = 1.0) -> str:
    """Return an estimate with its 95 % interval, times a factor for the unit."""
    return interval_text(factor * value.estimate, factor * value.low95, factor * value.high95, unit)


def fixed(value: float, places: int) -> str:
    """Return a number with fixed decimals, rounded to tens and hundreds for decimals below 0.

    A rounded zero has no sign, and what is not finite is named.
    """
    if math.isnan(value):
        return "not given"
    if math.isinf(value):
        return "infinite" if value > 0 else "-infinite"
    text = f"{round(value, places):.{max(places, 0)}f}"
    return text.lstrip("-") if float(text) == 0 else text


def significant(value: float, digits: int = 3) -> str:
    """Return a number with a few significant digits; very large and very small ones as a power of ten."""
    if value == 0 or not math.isfinite(value):
        return fixed(value, 0)
    if not 1e-4 <= abs(value) < 1e5:
        return f"{value:.{digits - 1}e}"
    return fixed(value, digits - 1 - math.floor(math.log10(abs(value))))


def percent(fraction: float) -> str:
    """Return a fraction as per cent, as "below 0.1 %" when it rounds to less, and as "12 times" from 10 on."""
    if 0 < abs(fraction) < 0.0005:
        return "below 0.1 %"
    if abs(fraction) >= 10:
        return f"{fixed(fraction, 0)} times"
    value = 100 * fraction
    text = fixed(value, 0 if abs(value) >= 10 else 1)
    return f"{text.removesuffix('.0')} %"


def signed_percent(fraction: float) -> str:
    """Return a fraction as per cent with its sign; what rounds to nothing is 0 %."""
    text = percent(fraction) if abs(fraction) >= 0.0005 else "0 %"
    return f"+{text}" if fraction >= 0.0005 else text


def probability(value: float) -> str:
    """Return a probability with two decimals; never 0 or 1, which no finite number of draws can show."""
    if value > 0.99:
        return "above 0.99"
    return "below 0.01" if value < 0.01 else f"{value:.2f}"


def pareto_text(k: float | None) -> str:
    """Return the shape k of importance weights with two decimals; a dash where it cannot be estimated."""
    return NO_VALUE if k is None else fixed(k, 2)


def duration(seconds: float) -> str:
    """Return a wall time in seconds or minutes."""
    if seconds >= 120:
        return f"{seconds / 60:.1f} min"
    return f"{seconds:.1f} s" if seconds < 20 else f"{seconds:.0f} s"


def skill_text(estimate: float, low: float, high: float) -> str:
    """Return a skill score with its interval, at most three decimals."""
    return interval_text(estimate, low, high, most_decimals=3)


def unbroken(text: str) -> str:
    """Return the text as a page shows it: +- as one sign, number and unit on one line, and so [low, high]."""
    text = text.replace(" +- ", " \u00b1 ")
    units = re.sub(r"(?<=[\d\]]) (?=(?:%|nm|deg|dB|DN|mm|ms|s|px|pixels)(?![\w/]))", "\u00a0", text)
    return re.sub(r"\[[^\[\]]{0,40}\]", lambda found: found[0].replace(" ", "\u00a0"), units)
