"""A finger design as commented TOML, ready to be edited by a designer and read by ``read_toml``."""

import json
import textwrap
from collections.abc import Collection, Iterator

from pydantic import BaseModel

from data_schemas.design import FingerDesign
from data_schemas.optical_design import LightPanel

_HEAD = """\
# A finger: gel pad, coating, light, mirror, camera, indenter. mm and deg; pads are length x width.
# Axes: x across the pad, y from its inner face into the gel, z along it from the base.
# Every table of a finger must be there. A file that begins with preset = "flat-70x35" (finray design list tells all)
# takes what it leaves out from that ready-made finger.
# A number is assumed unless the table [origin] at the end says otherwise: measured, data sheet or paper.
"""
_LEFT_OUT = {"provenance", "schema_version", "name", "materials", "origin", "uncertainty_rel"}


def design_toml(design: FingerDesign) -> str:
    """Return a design as TOML; what is left out, or has no effect in this design, stands in comments."""
    idle = design.idle_fields()
    parts = [_HEAD, f"schema_version = {design.schema_version}\nname = {_value(design.name)}\n"]
    for name in (field for field in FingerDesign.model_fields if field not in _LEFT_OUT):
        part = getattr(design, name)
        if part is None:
            parts.append(_commented_out(name, LightPanel()))
        else:
            parts.append("".join(_table(name, part, idle)))
    for name, texts in (("materials", design.materials), ("origin", design.origin)):
        lines = "".join(f"{_value(key)} = {_value(text)}\n" for key, text in texts.items())
        parts.append(f"\n[{name}]\n{lines}")
    parts.append(_uncertainties(design.uncertainty_rel))
    return "".join(parts)


def _uncertainties(stated: dict[str, float]) -> str:
    """Return the table of uncertainties, or an example of it as a comment."""
    lines = [f"{_value(field)} = {_value(u)}" for field, u in stated.items()]
    head = "# Standard uncertainty of a number over its value, for comparisons with a measured force."
    example = '# [uncertainty_rel]\n# "mechanics.gel.c10_mpa" = 0.2'
    return "\n".join(["", head, *(["[uncertainty_rel]", *lines] if lines else [example]), ""])


def _commented_out(name: str, example: BaseModel) -> str:
    """Return a table that the design does not have, as a comment to be opened."""
    lines = "".join(_table(name, example, ())).strip().split("\n")
    return "\n" + "".join(f"# {line}\n" for line in lines)


def _table(name: str, part: BaseModel, idle: Collection[str]) -> Iterator[str]:
    """Yield the lines of a table and of the tables in it."""
    if name in idle:
        return
    yield f"\n[{name}]\n"
    inner = []
    for field, info in type(part).model_fields.items():
        value = getattr(part, field)
        if isinstance(value, BaseModel):
            inner.append((f"{name}.{field}", value))
            continue
        for line in textwrap.wrap(info.description or "", 116):
            yield f"# {line}\n"
        if value is None:
            yield f"# {field} = ...\n"
        else:
            yield f"{'# ' if f'{name}.{field}' in idle else ''}{field} = {_value(value)}\n"
    for path, model in inner:
        yield from _table(path, model, idle)


def _value(value: object) -> str:
    """Return a TOML value: text, number or list of numbers."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return repr(value)
