"""JSON that people can read: one key per line, lists of plain values on one line."""

import json
from typing import Any


def readable_json(content: dict[str, Any]) -> str:
    """Return JSON text with objects indented and every list without objects inside on one line.

    Parameters
    ----------
    content
        Dicts, lists, texts, finite numbers, booleans and None.
    """
    return _text(content, 0) + "\n"


def _text(value: Any, depth: int) -> str:
    """Return a value, indented by its depth."""
    inner, outer = " " * (depth + 1), " " * depth
    if isinstance(value, dict) and value:
        rows = (f"{inner}{_plain(str(key))}: {_text(item, depth + 1)}" for key, item in value.items())
        return "{\n" + ",\n".join(rows) + f"\n{outer}}}"
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return "[\n" + ",\n".join(inner + _text(item, depth + 1) for item in value) + f"\n{outer}]"
    return _plain(value)


def _plain(value: Any) -> str:
    """Return a value on one line; NaN has no place in JSON."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
