"""Ready-made fingers and classic sensors, their designs as commented TOML, and how every program reads them back.

The ready-made fingers are the paper's family of sizes and shapes of gel pads. The paper gives length and width of the
pads (but for the original finger), the thickness of film and mirror, the camera's field of view, the indenter and the
constants of the materials. Radii, semi-axes, other thicknesses and all dimensions of the skeletons it does not give;
they are assumed, and so not listed in ``origin``. As TOML a design is ready to be edited by a designer. The
file holds a whole finger, or names a ready-made one and changes numbers of it: `read_design`.

What is published of a classic sensor stands in ``origin`` and ``source`` of its design; all other numbers are assumed,
so that a picture shows what such a sensor sees, not what one specimen does.
"""

import textwrap
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ValidationError

from data_schemas import (
    Backing,
    CameraBelow,
    CoatSurface,
    ColouredLight,
    Film,
    FingerDesign,
    GelPad,
    Indenter,
    LightPanel,
    PlainSensor,
    RecordError,
    SensorCoat,
    SimulateError,
    Skeleton,
    TranslucentLayer,
    explain,
)
from data_schemas.storage import read_toml, read_toml_tables, toml_text

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
        raise SimulateError(f"there is no preset design '{name}'; valid names are {', '.join(PRESETS)}")
    return PRESETS[name][1](name)


def given_design(path: Path) -> tuple[FingerDesign, list[Path], Path]:
    """Return the finger of a file or of a preset's name, the files it was read from, and where its paths start.

    Raises
    ------
    RecordError, SimulateError
        When it cannot be read, or describes no finger.
    """
    if not path.is_file() and (str(path) in PRESETS or not (path.exists() or path.suffix or str(path) in SENSORS)):
        return preset_design(str(path)), [], Path()
    return read_design(path), [path], path.parent


def with_pad_size(design: FingerDesign, length_mm: float, width_mm: float) -> FingerDesign:
    """Return a finger with a pad of another size; panels, tip and backing move with its length.

    Mirror and camera follow the pad where the design leaves them to it; the indenter goes to its middle.
    """
    tables = design.model_dump(mode="python", exclude={"provenance"})
    share = min(1.0, length_mm / _NOMINAL_LENGTH_MM) / min(1.0, design.pad.length_mm / _NOMINAL_LENGTH_MM)
    stretch = length_mm / design.pad.length_mm
    tables["pad"] |= {"length_mm": length_mm, "width_mm": width_mm}
    tables["indenter"]["position_mm"] = length_mm / 2.0
    for panel in (tables["light"], tables["second_light"], *tables["further_lights"]):
        if panel is not None:
            x, y, z = panel["position_mm"]
            along = z * share if z < design.pad.length_mm / 2.0 else length_mm + (z - design.pad.length_mm) * share
            panel |= {"position_mm": (x * share, y * share, along)}
            panel |= {name: panel[name] * share for name in ("width_mm", "height_mm")}
    for table, field in ((tables["skeleton"], "tip_starts_mm"), (tables["skeleton"]["backing"] or {}, "to_z_mm")):
        if table.get(field) is not None:
            table[field] *= stretch
    tables["name"] = f"{design.name}-pad-{length_mm:g}x{width_mm:g}"
    tables["origin"] = {field: where for field, where in design.origin.items() if field not in _PAD_SIZE}
    try:
        return FingerDesign.model_validate(tables)
    except ValidationError as error:
        raise SimulateError(f"--pad {length_mm:g}x{width_mm:g}: {explain(error, FingerDesign)}") from None


_FINGER_HEAD = """\
# A finger: gel pad, coating, light, mirror, camera, indenter. mm and deg; pads are length x width.
# Axes: x across the pad, y from its inner face into the gel, z along it from the base.
# Every table of a finger must be there. A file that begins with preset = "flat-70x35" ('finray design list' lists them)
# takes what it leaves out from that ready-made finger.
# A number is assumed unless the table [origin] at the end says otherwise: measured, data sheet or paper.
"""
_NOT_IN_FINGER_TABLES = {"provenance", "schema_version", "name", "materials", "origin", "uncertainty_rel"}


def design_toml(design: FingerDesign) -> str:
    """Return a design as TOML; what is left out, or has no effect in this design, stands in comments."""
    idle = design.unused_fields()
    parts = [_FINGER_HEAD, f"schema_version = {design.schema_version}\nname = {_toml_value(design.name)}\n"]
    for name in (field for field in FingerDesign.model_fields if field not in _NOT_IN_FINGER_TABLES):
        part = getattr(design, name)
        if isinstance(part, tuple):
            parts.append(_listed(name, part, idle))
        elif part is None:
            parts.append(_commented_out(name, LightPanel()))
        else:
            parts.append("".join(_table_lines(name, part, idle)))
    for name, texts in (("materials", design.materials), ("origin", design.origin)):
        lines = "".join(f"{_toml_value(key)} = {_toml_value(text)}\n" for key, text in texts.items())
        parts.append(f"\n[{name}]\n{lines}")
    parts.append(_uncertainty_lines(design.uncertainty_rel))
    return "".join(parts)


def _listed(name: str, entries: tuple[BaseModel, ...], idle: Collection[str]) -> str:
    """Return a list of tables, or how one is begun."""
    lines = (
        "".join(_table_lines(name, entry, idle, in_list=True, with_words=k == 0)) for k, entry in enumerate(entries)
    )
    return "".join(lines) or f"\n# [[{name}]] adds one more, with the fields of [light]; there may be several.\n"


def _uncertainty_lines(stated: Mapping[str, float], example_field: str = "mechanics.gel.c10_mpa") -> str:
    """Return the table of uncertainties, or an example of it as a comment."""
    lines = [f"{_toml_value(field)} = {_toml_value(u)}" for field, u in stated.items()]
    head = "# Relative standard uncertainty of a number, for comparisons with a measured force."
    example = f'# [uncertainty_rel]\n# "{example_field}" = 0.2'
    return "\n".join(["", head, *(["[uncertainty_rel]", *lines] if lines else [example]), ""])


def _commented_out(name: str, example: BaseModel) -> str:
    """Return a table that the design does not have, as a comment to be opened."""
    lines = "".join(_table_lines(name, example, ())).strip().split("\n")
    return "\n" + "".join(f"# {line}\n" for line in lines)


_NO_PATH: Final = """\
# [[indenter.path]] begins a pose that a press by finite elements moves through, in place of depth_mm; there may be
# several: across_mm, push_mm, along_mm, turn_x_deg, turn_y_deg, turn_z_deg, increments.
"""
_NO_SURFACE: Final = "\n# [surface] gives the shape of the pressed coat; leave [indenter] out if you give [surface].\n"
_OF_PACKAGES: Final = ("parameters", "package")


def _table_lines(
    name: str, part: BaseModel, idle: Collection[str], *, in_list: bool = False, with_words: bool = True
) -> Iterator[str]:
    """Yield the lines of a table, or of one entry of a list of tables, and of the tables in it."""
    if name in idle:
        return
    yield f"\n[[{name}]]\n" if in_list else f"\n[{name}]\n"
    inner: list[tuple[str, BaseModel, bool]] = []
    fields = type(part).model_fields.items()
    for field, info in sorted(fields, key=lambda one: one[0] in _OF_PACKAGES):
        value = getattr(part, field)
        if isinstance(value, BaseModel):
            inner.append((f"{name}.{field}", value, False))
            continue
        if field == "path":
            inner += [(f"{name}.{field}", pose, True) for pose in value]
            if not value and f"{name}.{field}" not in idle:
                yield _NO_PATH
            continue
        if field in _OF_PACKAGES and not value:
            continue
        for line in textwrap.wrap(info.description or "", 116) if with_words else ():
            yield f"# {line}\n"
        if value is None and not with_words:
            continue
        if value is None:
            yield f"# {field} = ...\n"
        else:
            yield f"{'# ' if f'{name}.{field}' in idle else ''}{field} = {_toml_value(value)}\n"
    for number, (path, model, listed) in enumerate(inner):
        yield from _table_lines(path, model, idle, in_list=listed, with_words=not (listed and number))


def _toml_value(value: object) -> str:
    """Return a TOML value: text, number or list of numbers."""
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_toml_value(key)} = {_toml_value(one)}" for key, one in value.items()) + " }"
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
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
        if tables.get("kind") == "sensor":
            raise RecordError(
                f"{path}: contains the design of a classic sensor, but the design of a finger is needed; 'finray "
                "design init flat-70x35' writes one"
            )
        if preset is None:
            _require_tables(path, written, FingerDesign)
            return written
        return _onto_preset(path, preset, preset_design, written)

    if not path.exists() and str(path) in SENSORS:
        raise SimulateError(
            f"{path}: is a classic sensor, but a finger is needed; give {', '.join(PRESETS)} or a design file"
        )
    if path.name == str(path) and path.name in PRESETS and not path.exists():
        raise RecordError(f"{path}: no such file; write it with 'finray design init {path}', then give {path}.toml")
    return read_toml(path, FingerDesign, complete)


def _onto_preset(
    path: Path, preset: object, ready_made: Callable[[str], FingerDesign | PlainSensor], written: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the tables of a ready-made design with those of a file over them; what is changed loses its origin."""
    if not isinstance(preset, str):
        kind = "finger" if ready_made is preset_design else "sensor"
        raise RecordError(f"{path}: preset must be the name of a ready-made {kind}, got {preset!r}")
    try:
        ready = ready_made(preset)
    except SimulateError as error:
        raise SimulateError(f"{path}: {error}") from None
    values = ready.model_dump(mode="python", exclude_unset=True)
    origin = {field: where for field, where in ready.origin.items() if not _changes(written, ready, field)}
    return _merged({**values, "origin": origin}, written)


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
            f"{path}: is not a complete finger, because it lacks {', '.join(f'[{name}]' for name in missing)}; add "
            "what is missing ('finray design init' writes a complete finger), or start from a ready-made finger with "
            "preset = \"flat-70x35\" above the first table ('finray design list' lists them)"
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


def _changes(written: Mapping[str, Any], ready: BaseModel, field: str) -> bool:
    """Return whether a file gives a field another value than the ready-made design has; a list counts as a whole."""
    value: Any = ready
    for name in field.split("."):
        if isinstance(value, tuple):
            return field.split(".")[0] in written
        value = getattr(value, name, None)
    given = _at(written, field)
    return given is not None and (tuple(given) if isinstance(given, list) else given) != value


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables in which each value of `above` replaces that of `below`."""
    both = {**below, **above}
    for name in below.keys() & above.keys():
        if isinstance(below[name], Mapping) and isinstance(above[name], Mapping):
            both[name] = _merged(below[name], above[name])
    return both


def _gelsight_flat(name: str) -> PlainSensor:
    """Return a flat GelSight with three light banks around its gel."""
    bank = {"angle_deg": 19.0, "distance_mm": 12.59, "depth_mm": 4.293, "width_mm": 9.0, "height_mm": 6.3}
    return PlainSensor(
        name=name,
        pad=GelPad(length_mm=20.0, width_mm=20.0, thickness_mm=4.5, refractive_index=1.5403),
        coating=SensorCoat(diffuse_share=1.0, diffuse_reflectance_rgb=(0.506, 0.397, 0.453)),
        lights=(
            ColouredLight(channel="red", azimuth_deg=0.0, **bank),
            ColouredLight(channel="green", azimuth_deg=-120.0, **bank),
            ColouredLight(channel="blue", azimuth_deg=120.0, **bank),
        ),
        camera=CameraBelow(distance_mm=36.55, field_of_view_deg=23.0, width_px=240, height_px=240),
        indenter=Indenter(shape="ball", radius_mm=4.0, depth_mm=1.0, position_mm=10.0),
        source=(
            "Agarwal, Man, Yuan, Simulation of vision-based tactile sensors using physics based rendering (ICRA "
            "2021) and its scene flatgel in CMURoboTouch/tactile_optical_simulation: three banks a third of a turn "
            "apart, each of two strips (one rectangle here) 12.59 mm from the axis and 8.79 mm below the coat, "
            "tilted up by 19 deg; camera 41.05 mm below the coat; clear core of index 1.5403; diffuse coat. The "
            "inner face is put 4.5 mm below the coat, above the banks, which shine through air here and through the "
            "core there; pad, field of view and powers are assumed"
        ),
        origin={
            **dict.fromkeys(
                ("lights.azimuth_deg", "lights.angle_deg", "lights.distance_mm", "lights.width_mm", "lights.height_mm"),
                "paper",
            ),
            **dict.fromkeys(
                ("pad.refractive_index", "coating.diffuse_share", "coating.diffuse_reflectance_rgb"), "paper"
            ),
        },
    )


def _digit(name: str) -> PlainSensor:
    """Return a DIGIT: a rounded gel over three LEDs."""
    led = {"angle_deg": 40.4, "distance_mm": 20.0, "depth_mm": 14.0, "width_mm": 1.3, "height_mm": 1.3}
    return PlainSensor(
        name=name,
        pad=GelPad(
            shape="ellipsoidal", length_mm=30.0, width_mm=20.0, thickness_mm=3.0, semi_axes_mm=(100.0, 100.0, 100.0)
        ),
        coating=SensorCoat(diffuse_share=0.8),
        lights=(
            ColouredLight(channel="red", azimuth_deg=120.0, **led),
            ColouredLight(channel="green", azimuth_deg=-120.0, **led),
            ColouredLight(channel="blue", azimuth_deg=0.0, **led),
        ),
        camera=CameraBelow(distance_mm=19.0, field_of_view_deg=46.8, width_px=240, height_px=320),
        indenter=Indenter(shape="ball", radius_mm=3.0, depth_mm=0.8, position_mm=15.0),
        source=(
            "the model of DIGIT (Lambeta et al., RA-L 2020) in facebookresearch/tacto, config_digit.yml: gel "
            "of 20 x 30 mm rounded with a radius of 100 mm, its middle 22 mm before the camera, whose field "
            "is 60 deg over the length; three LEDs 20 mm from the axis, 17 mm below the gel, a third of a "
            "turn apart. The red light is on the side that TACTO's picture of a real sensor shows. "
            "Thickness, coat, walls and the size of the LEDs (1.3 mm) are assumed"
        ),
        origin=dict.fromkeys(
            (
                "pad.length_mm", "pad.width_mm", "pad.semi_axes_mm", "lights.azimuth_deg", "lights.distance_mm",
                "camera.field_of_view_deg",
            ),
            "paper",
        ),
    )  # fmt: skip


def _nine_dtact(name: str) -> PlainSensor:
    """Return a 9DTact: a translucent layer before black gel under even white light."""
    ring = tuple(
        ColouredLight(
            channel="white", azimuth_deg=45.0 * k - 180.0, angle_deg=60.0, distance_mm=20.0, depth_mm=5.0, width_mm=6.0,
            height_mm=3.0,
        )
        for k in range(8)
    )  # fmt: skip
    return PlainSensor(
        name=name,
        pad=GelPad(length_mm=18.0, width_mm=24.0, thickness_mm=2.8),
        coating=SensorCoat(
            diffuse_share=1.0,
            translucent=TranslucentLayer(thickness_mm=2.5, scattering_length_mm=8.3, backing_reflectance=0.02),
        ),
        lights=ring,
        camera=CameraBelow(distance_mm=18.0, field_of_view_deg=61.5, width_px=320, height_px=240),
        indenter=Indenter(shape="ball", radius_mm=4.0, depth_mm=1.92, position_mm=9.0),
        source=(
            "9DTact (Lin et al., RA-L 2023, arXiv 2308.14277) and linchangyi1/9DTact: a white-lit translucent layer "
            "before black gel; calibrated picture of 23.5 x 17.6 mm; mould sheets of 2.5 and 2.8 mm; ball of 4.0 mm "
            "radius, pressed 1.92 mm deep in its picture of sensor 1. The scattering length is chosen so that the "
            "darkening follows that picture within 10 % under the ball and 22 % at its rim; the ring of lights, camera "
            "and walls are assumed"
        ),
        origin={
            **dict.fromkeys(("pad.length_mm", "pad.width_mm", "coating.translucent.thickness_mm"), "paper"),
            **dict.fromkeys(("indenter.radius_mm", "indenter.depth_mm"), "paper"),
            "coating.translucent.scattering_length_mm": "measured",
        },
    )


def _gelsight_wedge(name: str) -> PlainSensor:
    """Return a GelSight Wedge: a camera that looks at the pad aslant, by a mirror that is unfolded here."""
    side = {"angle_deg": 35.0, "distance_mm": 17.0, "depth_mm": 5.0, "width_mm": 30.0, "height_mm": 2.0}
    return PlainSensor(
        name=name,
        pad=GelPad(length_mm=27.0, width_mm=35.0, thickness_mm=5.5),
        coating=SensorCoat(diffuse_share=0.9),
        lights=(
            ColouredLight(channel="red", azimuth_deg=180.0, **side),
            ColouredLight(channel="blue", azimuth_deg=0.0, **side),
            ColouredLight(
                channel="green", azimuth_deg=90.0, angle_deg=35.0, distance_mm=21.0, depth_mm=5.0, width_mm=22.0,
                height_mm=2.0,
            ),
        ),
        camera=CameraBelow(
            distance_mm=23.1, across_mm=-2.0, pan_deg=13.2, field_of_view_deg=97.6, width_px=320, height_px=240
        ),
        indenter=Indenter(shape="ball", radius_mm=6.0, depth_mm=1.2, position_mm=13.5),
        source=(
            "GelSight Wedge (Wang, She, Romero, Adelson, ICRA 2021, arXiv 2106.08851) as GelSight- "
            "lab/EstimateModulus uses it: pad of 35 x 27 mm, 5.5 mm thick; red and blue along the long sides, green "
            "at the near end; the camera's pose and field are those of a pinhole fitted to its published corners of "
            "the pad (config_100.csv, 0.3 px), with the plane mirror unfolded. Sizes, angles and powers of the "
            "lights are assumed"
        ),
        origin={
            **dict.fromkeys(
                ("pad.length_mm", "pad.width_mm", "pad.thickness_mm", "lights.channel", "lights.azimuth_deg"), "paper"
            ),
            **dict.fromkeys(
                ("camera.distance_mm", "camera.across_mm", "camera.pan_deg", "camera.field_of_view_deg"), "measured"
            ),
        },
    )  # fmt: skip


SENSORS: Final[dict[str, tuple[str, Callable[[str], PlainSensor]]]] = {
    "gelsight-flat": ("classic sensor: flat GelSight, red, green and blue from three sides", _gelsight_flat),
    "digit": ("classic sensor: DIGIT, a rounded gel over three LEDs", _digit),
    "9dtact": ("classic sensor: 9DTact, translucent gel before black gel under white light", _nine_dtact),
    "gelsight-wedge": ("classic sensor: GelSight Wedge, its camera looks at the pad at an angle", _gelsight_wedge),
}
"""Name -> (what it is, its builder)."""


def preset_sensor(name: str) -> PlainSensor:
    """Return a ready-made classic sensor.

    Raises
    ------
    SimulateError
        When there is none of this name; the message lists them.
    """
    if name not in SENSORS:
        raise SimulateError(f"there is no preset sensor '{name}'; valid names are {', '.join(SENSORS)}")
    return SENSORS[name][1](name)


KINDS: Final = ("finger", "sensor")
_SENSOR_HEAD = """\
# A classic sensor: gel pad, coat, lights, camera, and what is pressed in. mm and deg.
# Axes: x across the pad, y from its inner face into the gel, z along it. The camera's columns run along +x, its rows
# against z. What is left out takes the value that the ready-made sensor of preset = "gelsight-flat" has, or else the
# default ('finray design list' lists them).
# A number is assumed unless the table [origin] at the end says otherwise: measured, data sheet or paper.
"""
_NOT_IN_SENSOR_TABLES = {"provenance", "name", "source", "origin", "uncertainty_rel", "lights"}


def sensor_toml(sensor: PlainSensor) -> str:
    """Return a sensor's design as TOML; what is left out, or has no effect in this design, stands in comments."""
    idle = sensor.unused_fields()
    parts = [
        _SENSOR_HEAD,
        f'schema_version = {sensor.schema_version}\nkind = "sensor"\nname = {_toml_value(sensor.name)}\n',
    ]
    parts.append(f"# {PlainSensor.model_fields['source'].description}\nsource = {_toml_value(sensor.source)}\n")
    tables = []
    for name, info in PlainSensor.model_fields.items():
        value = getattr(sensor, name)
        if name in _NOT_IN_SENSOR_TABLES or name == "surface":
            continue
        if isinstance(value, str | int | float):
            comment = f"# {info.description}\n" if info.description else ""
            parts.append(f"{comment}{'# ' if name in idle else ''}{name} = {_toml_value(value)}\n")
        else:
            tables.append("".join(_table_lines(name, value, idle)))
    for number, light in enumerate(sensor.lights):
        lines = "".join(_table_lines("lights", light, idle, in_list=True, with_words=number == 0))
        tables.append(lines)
    example = CoatSurface(file="coat.npy", step_mm=0.05)
    tables.append(
        f"{_NO_SURFACE}{_commented_out('surface', example).lstrip()}"
        if sensor.surface is None
        else "".join(_table_lines("surface", sensor.surface, idle))
    )
    origins = "".join(f"{_toml_value(field)} = {_toml_value(where)}\n" for field, where in sensor.origin.items())
    return "".join(
        [*parts, *tables, f"\n[origin]\n{origins}", _uncertainty_lines(sensor.uncertainty_rel, "pad.thickness_mm")]
    )


def is_sensor(path: Path) -> bool:
    """Return whether a design file is of a classic sensor: it says so as its ``kind``, or by its preset.

    Raises
    ------
    RecordError
        The file cannot be read, or is of an unknown kind.
    """
    if not path.exists() or path.suffix.lower() != ".toml":
        return False
    tables = read_toml_tables(path)
    kind = tables.get("kind")
    if kind is not None and kind not in KINDS:
        raise RecordError(f"{path}: kind must be {' or '.join(map(repr, KINDS))}, got {kind!r}")
    return kind == "sensor" or (kind is None and tables.get("preset") in SENSORS)


def read_sensor(path: Path) -> PlainSensor:
    """Read the design of a classic sensor (TOML).

    With ``preset = "gelsight-flat"`` above its first table the file changes that ready-made sensor; of ``lights`` it
    changes all or none.

    Raises
    ------
    RecordError
        See :func:`~data_schemas.storage.read_toml`.
    SimulateError
        There is no ready-made sensor of this name.
    """

    def complete(tables: dict[str, Any]) -> dict[str, Any]:
        written = {name: value for name, value in tables.items() if name != "kind"}
        preset = written.pop("preset", None)
        if "skeleton" in written:
            raise RecordError(f"{path}: contains the design of a finger, but that of a classic sensor is needed")
        if isinstance(preset, str) and preset in PRESETS:
            raise RecordError(f'{path}: kind = "sensor" does not fit the finger preset = "{preset}"; leave out kind')
        return written if preset is None else _onto_preset(path, preset, preset_sensor, written)

    return read_toml(path, PlainSensor, complete)


def sensor_inputs(sensor: PlainSensor, path: Path) -> list[Path]:
    """Return the design's file and those that it names."""
    camera = sensor.camera
    named = [
        camera.calibration,
        None if camera.response in ("ideal", "assumed") else camera.response,
        sensor.indenter.file if sensor.surface is None else sensor.surface.file,
    ]
    return [path, *(path.parent / name for name in named if name is not None)]
