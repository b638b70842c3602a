"""A design with one of its numbers changed."""

from typing import Any

from pydantic import ValidationError

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError


def design_value(design: FingerDesign, field: str) -> Any:
    """Return the value at a dotted path; None where a part that the path leads through is absent."""
    value: Any = design
    for name in field.split("."):
        value = None if value is None else getattr(value, name)
    return value


def changed_design(design: FingerDesign, field: str, value: Any) -> FingerDesign:
    """Return a design with the value at a dotted path changed.

    Raises
    ------
    SimulateError
        When the design refuses the value.
    """
    whole: dict[str, Any] = design.model_dump()
    place = whole
    *path, last = field.split(".")
    for name in path:
        place = place[name]
    place[last] = value
    try:
        return FingerDesign.model_validate(whole)
    except ValidationError as refused:
        raise SimulateError(refused.errors()[0]["msg"]) from refused
