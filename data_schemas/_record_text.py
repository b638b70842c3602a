"""What a record and its numbers say of themselves on a screen: a few lines, without arrays."""

import math
import re
from collections.abc import Iterator
from html import escape
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from data_schemas._model import Record


LINE: Final = 120
MOST_VALUES: Final = 6
"""Numbers and words of a record that does not say which of them to show."""

Row = tuple[str, str]


def record_text(record: "Record") -> str:
    """Return the record in some three to ten lines."""
    rows = [f"  {label}: {text}" if label else f"  {text}" for label, text in _rows(record)]
    return "\n".join(_cut(line) for line in (_title(record), *rows))


def record_html(record: "Record") -> str:
    """Return the same as an HTML table, every text escaped."""
    cells = (f"<tr><th>{escape(label)}</th><td>{escape(_cut(text))}</td></tr>" for label, text in _rows(record))
    return f"<table><caption>{escape(_cut(_title(record)))}</caption>{''.join(cells)}</table>"


def kind_in_words(kind: str) -> str:
    """Return what a kind of record is called in a sentence, such as "a paint calibration" or "band signals"."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", kind).lower()
    if words.endswith("s") and not words.endswith("ss"):
        return words
    return f"an {words}" if words[0] in "aeiou" else f"a {words}"


def needed_kind(kind: str) -> str:
    """Return that a kind of record is needed, such as "a paint calibration is needed"."""
    words = kind_in_words(kind)
    return f"{words} {'is' if words.startswith(('a ', 'an ')) else 'are'} needed"


def array_text(array: np.ndarray[Any, Any]) -> str:
    """Return the size of an array in place of its values: ``array(4000 x 7)``."""
    return f"array({' x '.join(map(str, array.shape))})"


def _title(record: "Record") -> str:
    """Return the record's kind and name."""
    fields = type(record).model_fields
    names = [n for n in fields if n == "name" or n.endswith("_name")]
    name = getattr(record, names[0], None) if names else None
    return type(record).__name__ + (f" {_plain(name)!r}" if isinstance(name, str) else "")


def _rows(record: "Record") -> Iterator[Row]:
    """Yield label and text of each line."""
    shown = [(name, _value(_inner(record, name))) for name in record.shown or type(record).model_fields]
    told = [(name, text) for name, text in shown if text and not re.fullmatch(r"(\w+_)?name", name)]
    yield from told if record.shown else told[:MOST_VALUES]
    values = {name: getattr(record, name, None) for name in type(record).model_fields if name != "provenance"}
    arrays = [f"{n} {' x '.join(map(str, v.shape))}" for n, v in values.items() if isinstance(v, np.ndarray)]
    if arrays:
        yield "arrays", _listed(arrays)
    more = [f"{n} ({len(v)})" for n, v in values.items() if isinstance(v, tuple | dict) and v]
    if more:
        yield "also", _listed(more)
    if record.provenance is not None:
        origin = record.provenance
        yield "made", f"{origin.created_utc}, finray-calib {_plain(origin.package_version)}: {_plain(origin.command)}"


def _inner(record: "Record", name: str) -> Any:
    """Return a field, or with dots in its name the field of an inner model; None where there is none."""
    part: Any = record
    for field in name.split("."):
        part = getattr(part, field, None)
    return part


def _value(value: Any) -> str:
    """Return a number, an estimate or some words; nothing for anything larger."""
    if isinstance(value, bool | int):
        return str(value)
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, str):
        return _plain(value)
    return str(value) if hasattr(value, "low95") and hasattr(value, "estimate") else ""


def _plain(text: str) -> str:
    """Return a text on one line, without characters that steer a terminal."""
    return "".join(c if c.isprintable() else " " for c in text).strip()


def _listed(items: list[str]) -> str:
    """Return as many items as fit into a line, and how many there are beside them."""
    text = ""
    for number, item in enumerate(items):
        longer = f"{text}, {item}".lstrip(", ")
        if len(longer) > LINE - 40 and number:
            return f"{text} and {len(items) - number} more"
        text = longer
    return text


def _cut(line: str) -> str:
    """Return a line that fits."""
    return line if len(line) <= LINE else f"{line[: LINE - 4]} ..."


_SIGNIFICANT_OF_HALF_WIDTH = 2
_MOST_DECIMALS = 6


def decimals_for(half_width: float) -> int:
    """Return how many decimals show a half-width with two significant digits, at most 6; below 0 for tens."""
    if not (math.isfinite(half_width) and half_width > 0):
        return 3
    digits = _SIGNIFICANT_OF_HALF_WIDTH
    return min(digits - 1 - _magnitude(half_width, digits), _MOST_DECIMALS)


def _magnitude(value: float, digits: int) -> int:
    """Return the power of ten of the first digit of a number that is rounded to some digits: 9.96 begins with 10."""
    return int(f"{value:.{digits - 1}e}".partition("e")[2])


def interval_text(estimate: float, low: float, high: float, unit: str = "", most_decimals: int = 6) -> str:
    """Return ``597.1 [596.0, 598.3] nm``: estimate and interval, rounded to what the interval supports."""
    if low == high == estimate:
        return f"{significant(estimate)} {unit}".strip()
    places = min(decimals_for((high - low) / 2), most_decimals)
    if fixed(low, places) == fixed(high, places):  # two equal ends would look like an interval of no width
        return f"{fixed(estimate, places)} {unit}".strip()
    return f"{fixed(estimate, places)} [{fixed(low, places)}, {fixed(high, places)}] {unit}".strip()


_FORMAT = re.compile(
    r"(?P<place>(?:.?[<>^])?)(?P<sign>[-+ ]?)(?P<width>(?:[1-9]\d*)?)(?P<number>,?(?:\.\d+)?[eEfFgG%]?)"
)


def formatted_interval(numbers: tuple[float, float, float], form: str, unit: str, plain: str) -> str:
    """Return an estimate with its interval in a format such as ``.1f``, ``>30`` or ``>30.1f``.

    The sign, the decimals and their kind are those of each number; the width is that of the whole text, `plain` where
    no number is formatted. Per cent are of a ratio: "50 % [48 %, 52 %]".

    Raises
    ------
    ValueError
        It is another format, or per cent of what has a unit.
    """
    parts = _FORMAT.fullmatch(form)
    if parts is None:
        raise ValueError(
            f"{form!r} is not a format for a number with its interval; give decimals such as '.1f', '.3g' or '.2e', a "
            "width such as '>30', or both, such as '>30.1f'"
        )
    text, of_number = plain, parts["sign"] + parts["number"]
    if of_number:
        if of_number.endswith("%"):
            if unit not in ("", "1"):
                raise ValueError(
                    f"{form!r} formats a ratio in per cent, but this number is in {unit}; give decimals such as "
                    "'.1f', or divide .estimate, the median, by the whole first"
                )
            unit = ""
        estimate, low, high = (format(number, of_number).replace("%", " %") for number in numbers)
        text = f"{estimate} [{low}, {high}] {unit}".strip()
    return format(text, parts["place"] + parts["width"])


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
    return fixed(value, digits - 1 - _magnitude(value, digits))


def percent(fraction: float) -> str:
    """Return a fraction as per cent with two significant digits: ``0.34 %``, ``100 %``."""
    return f"{float(f'{100 * fraction:.2g}') + 0.0:g} %"  # + 0.0: a zero has no sign


_NEGATIVE_ZERO = re.compile(r"(?<![\w.,:=/+-])-(0(?:\.0+)?)(?![\w:-]|\.\w)")


def unsigned_zeros(text: str) -> str:
    """Return a text whose rounded zeros have no sign: ``0.0 mm`` for ``-0.0 mm``; options and file names stay."""
    return _NEGATIVE_ZERO.sub(r"\1", text)
