"""Ready-made fingers, a finger's design as commented TOML, and how every program reads it back.

The ready-made ones are the paper's family of sizes and shapes of gel pads. The paper gives length and width of the pads
(but for the original finger), the thickness of film and mirror, the camera's field of view, the indenter and the
constants of the materials. Radii, semi-axes, other thicknesses and all dimensions of the skeletons it does not give;
they are assumed, and so not listed in ``origin``. As TOML a design is ready to be edited by a designer. The
file holds a whole finger, or names a ready-made one and changes numbers of it: `read_design`.
"""

import json
import textwrap
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel

from data_schemas import Backing, Film, FingerDesign, GelPad, Indenter, LightPanel, RecordError, SimulateError, Skeleton
from data_schemas.storage import read_toml

# the panel at the tip, a mirror image of the one at the base
_LIGHT_AT_THE_TIP: Final = LightPanel(angle_deg=150.0, position_mm=(0.0, -4.0, 71.0))


_STIFF: Final = Skeleton(backing=Backing())
# the paper: thinner ribs
_SOFT: Final = Skeleton(rib_thickness_mm=0.8, backing=Backing())
_SMALL: Final = Skeleton(
    tip_length_mm=4.0,
    base_thickness_mm=4.0,
    front_fin_thickness_mm=1.2,
    back_fin_thickness_mm=1.2,
    rib_thickness_mm=0.9,
    rib_width_mm=2.0,
    backing=Backing(to_z_mm=40.0),
)
_ORIGINAL: Final = Skeleton(backing=None)
# like a box: the mirror ends with the pad, where the fins are still far apart
_WIDE: Final = Skeleton(
    tip_starts_mm=54.0,
    front_fin_thickness_mm=2.0,
    back_fin_thickness_mm=2.0,
    rib_count=4,
    rib_thickness_mm=1.6,
    rib_width_mm=4.0,
    backing=Backing(to_z_mm=45.0),
)
_NOMINAL_LENGTH_MM: Final = 70.0
_PAD_SIZE: Final = ("pad.length_mm", "pad.width_mm")


def _design(
    name: str,
    pad: GelPad,
    second_light: LightPanel | None = None,
    skeleton: Skeleton = _STIFF,
    assumed: tuple[str, ...] = (),
) -> FingerDesign:
    """Return a finger with the indenter on the middle of its pad and a light that grows with the finger."""
    indenter = Indenter(position_mm=pad.length_mm / 2.0)
    size = min(1.0, pad.length_mm / _NOMINAL_LENGTH_MM)
    light = LightPanel(position_mm=(0.0, -10.0 * size, -1.0 * size), width_mm=20.0 * size, height_mm=4.0 * size)
    design = FingerDesign(
        name=name, pad=pad, light=light, indenter=indenter, second_light=second_light, skeleton=skeleton
    )
    without = {*assumed, *(() if pad.film is not None else ("pad.film.thickness_mm",))}
    origin = {field: where for field, where in design.origin.items() if field not in without}
    return design.model_copy(update={"origin": origin})


def _ellipsoidal(semi_axes_mm: tuple[float, float, float]) -> GelPad:
    """Return a pad cast in a printed mould, which takes no film."""
    return GelPad(shape="ellipsoidal", semi_axes_mm=semi_axes_mm)


PRESETS: Final[dict[str, tuple[str, Callable[[str], FingerDesign]]]] = {
    "flat-70x35": ("the paper's finger for grasping, flat pad, stiff", lambda n: _design(n, GelPad(film=Film()))),
    "flat-70x35-soft": (
        "the same with thinner ribs",
        lambda n: _design(n, GelPad(film=Film()), skeleton=_SOFT),
    ),
    "flat-70x35-two-lights": (
        "the same with a second panel at the tip",
        lambda n: _design(n, GelPad(film=Film()), _LIGHT_AT_THE_TIP),
    ),
    "original-60x22": (
        "the original GelSight Fin Ray, without backing; the paper does not give its pad's size (assumed)",
        lambda n: _design(
            n,
            GelPad(length_mm=60.0, width_mm=22.0, thickness_mm=4.0, film=Film()),
            skeleton=_ORIGINAL,
            assumed=_PAD_SIZE,
        ),
    ),
    "baby-48x18": (
        "GelSight Baby Fin Ray",
        lambda n: _design(n, GelPad(length_mm=48.0, width_mm=18.0, thickness_mm=4.0, film=Film()), skeleton=_SMALL),
    ),
    "wide-50x60": (
        "box-like finger; the paper says 60 mm of width here and 50 mm later",
        lambda n: _design(n, GelPad(length_mm=50.0, width_mm=60.0, film=Film()), skeleton=_WIDE),
    ),
    "wide-50x50": (
        "box-like finger, the paper's later width",
        lambda n: _design(n, GelPad(length_mm=50.0, width_mm=50.0, film=Film()), skeleton=_WIDE),
    ),
    **{
        f"cylindrical-r{radius:g}": (
            f"70 x 35 mm, cylindrical pad of {radius:g} mm radius (assumed)",
            partial(_design, pad=GelPad(shape="cylindrical", radius_mm=radius, film=Film())),
        )
        for radius in (40.0, 60.0, 90.0)
    },
    **{
        f"ellipsoidal-{a:g}-{b:g}-{c:g}": (
            f"70 x 35 mm, pad cut from an ellipsoid of {a:g}, {b:g}, {c:g} mm (assumed)",
            partial(_design, pad=_ellipsoidal((a, b, c))),
        )
        for a, b, c in ((30.0, 8.0, 90.0), (30.0, 12.0, 90.0), (45.0, 20.0, 70.0))
    },
}
"""Name -> (what it is, its builder)."""


def preset_design(name: str) -> FingerDesign:
    """Return a ready-made finger.

    Raises
    ------
    SimulateError
        When there is none of this name; the message lists them.
    """
    if name not in PRESETS:
        raise SimulateError(f"there is no preset design '{name}'; there are {', '.join(PRESETS)}")
    return PRESETS[name][1](name)


_HEAD = """\
# A finger: gel pad, coating, light, mirror, camera, indenter. mm and deg; pads are length x width.
# Axes: x across the pad, y from its inner face into the gel, z along it from the base.
# Every table of a finger must be there. A file that begins with preset = "flat-70x35" ('finray design list' lists them)
# takes what it leaves out from that ready-made finger.
# A number is assumed unless the table [origin] at the end says otherwise: measured, data sheet or paper.
"""
_LEFT_OUT = {"provenance", "schema_version", "name", "materials", "origin", "uncertainty_rel"}


def design_toml(design: FingerDesign) -> str:
    """Return a design as TOML; what is left out, or has no effect in this design, stands in comments."""
    idle = design.idle_fields()
    parts = [_HEAD, f"schema_version = {design.schema_version}\nname = {toml_value(design.name)}\n"]
    for name in (field for field in FingerDesign.model_fields if field not in _LEFT_OUT):
        part = getattr(design, name)
        if isinstance(part, tuple):
            parts.append(_listed(name, part, idle))
        elif part is None:
            parts.append(commented_out(name, LightPanel()))
        else:
            parts.append("".join(table_lines(name, part, idle)))
    for name, texts in (("materials", design.materials), ("origin", design.origin)):
        lines = "".join(f"{toml_value(key)} = {toml_value(text)}\n" for key, text in texts.items())
        parts.append(f"\n[{name}]\n{lines}")
    parts.append(uncertainty_lines(design.uncertainty_rel))
    return "".join(parts)


def _listed(name: str, entries: tuple[BaseModel, ...], idle: Collection[str]) -> str:
    """Return a list of tables, or how one is begun."""
    lines = (
        "".join(table_lines(name, entry, idle, in_list=True, with_words=k == 0)) for k, entry in enumerate(entries)
    )
    return "".join(lines) or f"\n# [[{name}]] begins one more, with the fields of [light]; there may be several.\n"


def uncertainty_lines(stated: Mapping[str, float], example_field: str = "mechanics.gel.c10_mpa") -> str:
    """Return the table of uncertainties, or an example of it as a comment."""
    lines = [f"{toml_value(field)} = {toml_value(u)}" for field, u in stated.items()]
    head = "# Standard uncertainty of a number over its value, for comparisons with a measured force."
    example = f'# [uncertainty_rel]\n# "{example_field}" = 0.2'
    return "\n".join(["", head, *(["[uncertainty_rel]", *lines] if lines else [example]), ""])


def commented_out(name: str, example: BaseModel) -> str:
    """Return a table that the design does not have, as a comment to be opened."""
    lines = "".join(table_lines(name, example, ())).strip().split("\n")
    return "\n" + "".join(f"# {line}\n" for line in lines)


def table_lines(
    name: str, part: BaseModel, idle: Collection[str], *, in_list: bool = False, with_words: bool = True
) -> Iterator[str]:
    """Yield the lines of a table, or of one entry of a list of tables, and of the tables in it."""
    if name in idle:
        return
    yield f"\n[[{name}]]\n" if in_list else f"\n[{name}]\n"
    inner = []
    for field, info in type(part).model_fields.items():
        value = getattr(part, field)
        if isinstance(value, BaseModel):
            inner.append((f"{name}.{field}", value))
            continue
        for line in textwrap.wrap(info.description or "", 116) if with_words else ():
            yield f"# {line}\n"
        if value is None and not with_words:
            continue
        if value is None:
            yield f"# {field} = ...\n"
        else:
            yield f"{'# ' if f'{name}.{field}' in idle else ''}{field} = {toml_value(value)}\n"
    for path, model in inner:
        yield from table_lines(path, model, idle)


def toml_value(value: object) -> str:
    """Return a TOML value: text, number or list of numbers."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    return repr(value)


OPTIONAL_TABLES: Final = ("mesh",)
"""A choice of how to compute, no part of the finger."""
FILM_MATERIAL: Final = "mechanics.film"
FILM_OF_THE_PAD: Final = "pad.film"


def read_design(path: Path) -> FingerDesign:
    """Read a finger's design (TOML).

    With ``preset = "flat-70x35"`` above its first table the file changes that ready-made finger; without it the file
    must hold every table of a finger, so that none is made of defaults that nobody asked for.

    Raises
    ------
    RecordError
        See :func:`~data_schemas.storage.read_toml`; tables are missing; of the name of a ready-made finger it says how
        to write its file.
    SimulateError
        There is no ready-made finger of this name.
    """

    def complete(tables: dict[str, Any]) -> dict[str, Any]:
        written = {name: value for name, value in tables.items() if name != "kind"}
        preset = written.pop("preset", None)
        if preset is None:
            _require_tables(path, written, FingerDesign)
            return written
        if not isinstance(preset, str):
            raise RecordError(f"{path}: preset = {preset!r} must be the name of a ready-made finger")
        try:
            ready = preset_design(preset)
        except SimulateError as error:
            raise SimulateError(f"{path}: {error}") from None
        values = ready.model_dump(mode="python", exclude_unset=True)
        origin = {field: where for field, where in ready.origin.items() if not changes(written, ready, field)}
        return merged({**values, "origin": origin}, written)

    if path.name == str(path) and path.name in PRESETS and not path.exists():
        raise RecordError(f"{path}: no such file; write it first: finray design init {path}, then give {path}.toml")
    return read_toml(path, FingerDesign, complete)


def design_inputs(design: FingerDesign, path: Path) -> list[Path]:
    """Return the design's file and those that it names."""
    named = [design.camera.calibration, None if design.camera.response == "assumed" else design.camera.response]
    return [path, *(path.parent / name for name in named if name is not None)]


def _require_tables(path: Path, written: Mapping[str, Any], model: type[BaseModel]) -> None:
    """Refuse a design in which a part of the finger is not there."""
    wanted = [name for name in _tables(model) if name != FILM_MATERIAL or _at(written, FILM_OF_THE_PAD) is not None]
    missing = [name for name in wanted if not isinstance(_at(written, name), dict)]
    if missing:
        raise RecordError(
            f"{path}: a finger without {', '.join(f'[{name}]' for name in missing)}; write what is missing (finray "
            'design init writes a whole finger), or let it come from a ready-made one: preset = "flat-70x35" above the '
            "first table ('finray design list' lists them)"
        )


def _tables(model: type[BaseModel], above: str = "") -> Iterator[str]:
    """Yield the dotted names of the tables that every finger has."""
    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel) and name not in OPTIONAL_TABLES:
            yield f"{above}{name}"
            yield from _tables(kind, f"{above}{name}.")


def _at(table: Any, field: str) -> Any:
    """Return what stands at a dotted path of a table; None where nothing does."""
    for name in field.split("."):
        table = table.get(name) if isinstance(table, Mapping) else None
    return table


def changes(written: Mapping[str, Any], ready: BaseModel, field: str) -> bool:
    """Return whether a file gives a field another value than the ready-made design has; a list counts as a whole."""
    value: Any = ready
    for name in field.split("."):
        if isinstance(value, tuple):
            return field.split(".")[0] in written
        value = getattr(value, name, None)
    given = _at(written, field)
    return given is not None and (tuple(given) if isinstance(given, list) else given) != value


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables in which each value of `above` replaces that of `below`."""
    both = {**below, **above}
    for name in below.keys() & above.keys():
        if isinstance(below[name], Mapping) and isinstance(above[name], Mapping):
            both[name] = merged(below[name], above[name])
    return both
