"""Ready-made classic sensors, a sensor's design as commented TOML, and how every program reads it back.

What is published of a sensor stands in ``origin`` and ``source`` of its design; all other numbers are assumed, so that
a picture shows what such a sensor sees, not what one specimen does.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from data_schemas import (
    CameraBelow,
    CoatSurface,
    ColouredLight,
    GelPad,
    Indenter,
    PlainSensor,
    RecordError,
    SensorCoat,
    SimulateError,
    TranslucentLayer,
)
from data_schemas.storage import read_toml, read_toml_tables
from sim._designs import PRESETS, changes, commented_out, merged, table_lines, toml_value, uncertainty_lines


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
            "the model of DIGIT (Lambeta et al., RA-L 2020) in facebookresearch/tacto, config_digit.yml: gel of 20 x "
            "30 mm rounded with a radius of 100 mm, its middle 22 mm before the camera, whose field is 60 deg over "
            "the length; three LEDs 20 mm from the axis, 17 mm below the gel, a third of a turn apart. The side of "
            "red is that of its picture of a real sensor. Thickness, coat, walls and the size of the LEDs (1.3 mm) "
            "are assumed"
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
            "darkening follows that picture within 16 %; the ring of lights, camera and walls are assumed"
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
    "gelsight-wedge": ("classic sensor: GelSight Wedge, the camera looks at the pad aslant", _gelsight_wedge),
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
        raise SimulateError(f"there is no preset sensor '{name}'; there are {', '.join(SENSORS)}")
    return SENSORS[name][1](name)


KINDS: Final = ("finger", "sensor")
_HEAD = """\
# A classic sensor: gel pad, coat, lights, camera, and what is pressed in. mm and deg.
# Axes: x across the pad, y from its inner face into the gel, z along it. The camera's columns run along +x, its rows
# against z. What is left out takes the value that the ready-made sensor of preset = "gelsight-flat" has, or else the
# default ('finray design list' lists them).
# A number is assumed unless the table [origin] at the end says otherwise: measured, data sheet or paper.
"""
_LEFT_OUT = {"provenance", "name", "source", "origin", "uncertainty_rel", "lights"}


def sensor_toml(sensor: PlainSensor) -> str:
    """Return a sensor's design as TOML; what is left out, or has no effect in this design, stands in comments."""
    idle = sensor.idle_fields()
    parts = [_HEAD, f'schema_version = {sensor.schema_version}\nkind = "sensor"\nname = {toml_value(sensor.name)}\n']
    parts.append(f"# {PlainSensor.model_fields['source'].description}\nsource = {toml_value(sensor.source)}\n")
    tables = []
    for name, info in PlainSensor.model_fields.items():
        value = getattr(sensor, name)
        if name in _LEFT_OUT or name == "surface":
            continue
        if isinstance(value, str | int | float):
            comment = f"# {info.description}\n" if info.description else ""
            parts.append(f"{comment}{'# ' if name in idle else ''}{name} = {toml_value(value)}\n")
        else:
            tables.append("".join(table_lines(name, value, idle)))
    for number, light in enumerate(sensor.lights):
        lines = "".join(table_lines("lights", light, idle, in_list=True, with_words=number == 0))
        tables.append(lines)
    example = CoatSurface(file="coat.npy", step_mm=0.05)
    tables.append(
        commented_out("surface", example)
        if sensor.surface is None
        else "".join(table_lines("surface", sensor.surface, idle))
    )
    origins = "".join(f"{toml_value(field)} = {toml_value(where)}\n" for field, where in sensor.origin.items())
    return "".join(
        [*parts, *tables, f"\n[origin]\n{origins}", uncertainty_lines(sensor.uncertainty_rel, "pad.thickness_mm")]
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
        raise RecordError(f"{path}: kind = {kind!r} must be {' or '.join(map(repr, KINDS))}")
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
        if preset is None:
            return written
        if not isinstance(preset, str):
            raise RecordError(f"{path}: preset = {preset!r} must be the name of a ready-made sensor")
        if preset in PRESETS:
            raise RecordError(f'{path}: preset = "{preset}" is a finger; leave out kind = "sensor"')
        try:
            ready = preset_sensor(preset)
        except SimulateError as error:
            raise SimulateError(f"{path}: {error}") from None
        values = ready.model_dump(mode="python", exclude_unset=True)
        kept = {field: where for field, where in ready.origin.items() if not changes(written, ready, field)}
        return merged({**values, "origin": kept}, written)

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
