"""One page about a finger's design: the finger to be turned round, its drawing, its parts and all its numbers."""

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from data_schemas.design import FingerDesign
from finray_calib.reports.finger_scene import ScenePart, finger_scene, scene_values
from finray_calib.reports.number_text import NO_VALUE
from finray_calib.reports.page import render_page
from finray_calib.reports.report_tables import ReportTable, TableGroup, one_group
from sim.mechanics.skeleton import SkeletonLayout, skeleton_layout

TEMPLATE: Final = "finger_page.html.j2"
_ENDINGS: Final = {"_mm": "mm", "_deg": "deg", "_nm": "nm", "_px": "px", "_mpa": "MPa"}
_GROUPS: Final = ("pad", "skeleton", "mirror", "camera", "light", "second_light", "enclosure", "coating", "indenter",
                  "mechanics")  # fmt: skip


def finger_page(design: FingerDesign, picture_png: bytes, view: str, folder: Path = Path()) -> str:
    """Return the page of a finger's design, self-contained HTML; equal input gives equal text.

    Parameters
    ----------
    design
        Finger.
    picture_png
        Its drawing, which also serves where a browser draws nothing in three dimensions.
    view
        What its camera sees, in a few lines.
    folder
        Where the design stands.

    Raises
    ------
    SimulateError
        When the parts do not fit together.
    """
    parts, layout = finger_scene(design, folder), skeleton_layout(design)
    numbers = _numbers(design)
    assumed = sum(row[2] == "assumed" for group in numbers.groups for row in group.rows)
    return render_page(
        TEMPLATE,
        name=design.name,
        size=_size_text(parts),
        view=view.splitlines(),
        parts=[(part.name, part.colour, part.is_shown) for part in parts],
        scene=scene_values(parts),
        picture="data:image/png;base64," + base64.b64encode(picture_png).decode("ascii"),
        part_table=_part_table(design, layout, parts),
        numbers=numbers,
        assumed=assumed,
        counted=sum(len(group.rows) for group in numbers.groups),
    )


def _size_text(parts: tuple[ScenePart, ...]) -> str:
    """Return the size of the finger."""
    points = np.concatenate([part.vertices_mm for part in parts if part.is_shown])
    across, through, along = np.ptp(points, axis=0)
    return f"{along:.1f} mm long, {across:.1f} mm wide, {through:.1f} mm deep"


def _part_table(design: FingerDesign, layout: SkeletonLayout, parts: tuple[ScenePart, ...]) -> ReportTable:
    """List the parts that are shown, their sizes in the finger's axes and what the sizes rest on."""
    rows = []
    for part in parts:
        x, y, z = np.ptp(part.vertices_mm, axis=0)
        words, fields = _what(design, layout, part.name)
        size = NO_VALUE if part.name == "camera" else f"{z:.1f} x {x:.1f} x {y:.1f}"
        rows.append((part.name, size, words, _origins(design, fields)))
    columns = ("part", "length x width x depth (mm)", "what it is", "sizes come from")
    return one_group("Parts", columns, rows, is_words=True)


def _what(design: FingerDesign, layout: SkeletonLayout, name: str) -> tuple[str, tuple[str, ...]]:
    """Return what a part is, and the fields of the design that its size rests on."""
    pad, skeleton, indenter = design.pad, design.skeleton, design.indenter
    ribs = len(layout.ribs)
    size = ("pad.length_mm", "pad.width_mm", "pad.thickness_mm")
    shape = {"cylindrical": f", radius {pad.radius_mm} mm", "ellipsoidal": f", semi-axes {_text(pad.semi_axes_mm)} mm"}
    skeleton_sizes = (
        "front_fin_thickness_mm",
        "back_fin_thickness_mm",
        "rib_count",
        "rib_thickness_mm",
        "rib_width_mm",
    )
    known: dict[str, tuple[str, tuple[str, ...]]] = {
        "coating": (f"touched face of the pad, {pad.shape}{shape.get(pad.shape, '')}", size),
        "gel": (f"pad, {pad.thickness_mm:g} mm thick at its crown", size),
        "red wall": ("side of the pad at -x, painted", size),
        "green wall": ("side of the pad at +x, painted", size),
        "film": ("sheet under the pad, glued on the front fin", ("pad.film.thickness_mm", "skeleton.flange_mm")),
        "bond": ("skin of adhesive under the pad", ("skeleton.flange_mm",)),
        "skeleton": (
            f"fins {skeleton.front_fin_thickness_mm:g} mm in front, {skeleton.back_fin_thickness_mm:g} mm at the back, "
            f"{ribs} pairs of ribs {skeleton.rib_thickness_mm:g} x {skeleton.rib_width_mm:g} mm, tip "
            f"{skeleton.tip_length_mm:g} mm; hollow {2.0 * layout.rib_inner_mm:.1f} mm wide",
            tuple(f"skeleton.{field}" for field in skeleton_sizes),
        ),
        "base plate": (f"{skeleton.base_thickness_mm:g} mm thick", ("skeleton.base_thickness_mm",)),
        "backing": ("plate on the back fin, against twisting", ("skeleton.backing.thickness_mm",)),
        "mirror": (
            f"{skeleton.mirror_thickness_mm:g} mm thick, radius {design.mirror.radius_mm:g} mm",
            ("skeleton.mirror_thickness_mm", "mirror.radius_mm"),
        ),
        "camera": (
            f"field of view {design.camera.field_of_view_deg:g} deg; a cube marks its pinhole",
            ("camera.field_of_view_deg",),
        ),
        "indenter": (
            f"{indenter.shape}, pushed in by {indenter.depth_mm:g} mm (shown where it first touches)",
            ({"cuboid": "indenter.size_mm", "mesh": "indenter.file"}.get(indenter.shape, "indenter.radius_mm"),),
        ),
    }
    if name in known:
        return known[name]
    light = design.lights[1 if name.endswith("2") else 0]
    field = "second_light" if name.endswith("2") else "light"
    words = f"{light.width_mm:g} x {light.height_mm:g} mm, {light.angle_deg:g} deg from the pad plane"
    return words, (f"{field}.width_mm", f"{field}.height_mm", f"{field}.angle_deg")


def _origins(design: FingerDesign, fields: tuple[str, ...]) -> str:
    """Return where some fields come from: each origin with what rests on it."""
    by_origin: dict[str, list[str]] = {}
    for field in fields:
        name = field.rpartition(".")[2]
        for ending in _ENDINGS:
            name = name.removesuffix(ending)
        by_origin.setdefault(design.origin.get(field, "assumed"), []).append(name.replace("_", " "))
    return "; ".join(f"{origin}: {', '.join(names)}" for origin, names in by_origin.items())


def _numbers(design: FingerDesign) -> ReportTable:
    """List every number and choice of the design, as its file names them, with where it comes from."""
    groups = []
    for group in _GROUPS:
        value = getattr(design, group)
        rows = [] if value is None else list(_rows(value.model_dump(), group, design))
        if rows:
            groups.append(TableGroup(group, tuple(rows)))
    columns = ("field of the design file", "value", "comes from")
    return ReportTable("All numbers of the design", columns, tuple(groups), is_words=True)


def _rows(values: dict[str, Any], path: str, design: FingerDesign) -> Iterator[tuple[str, str, str]]:
    """Yield field, value with its unit, and origin, of a part of the design and of what lies within it."""
    for name, value in values.items():
        field = f"{path}.{name}"
        if isinstance(value, dict):
            yield from _rows(value, field, design)
        elif value is None:
            yield field, NO_VALUE, "not given"
        else:
            unit = next((unit for ending, unit in _ENDINGS.items() if name.endswith(ending)), "")
            yield field, f"{_text(value)} {unit}".strip(), design.origin.get(field, "assumed")


def _text(value: Any) -> str:
    """Return a value as a reader writes it."""
    if isinstance(value, tuple | list):
        return ", ".join(_text(one) for one in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
