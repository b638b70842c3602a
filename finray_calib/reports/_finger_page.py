"""One page about a finger's design: the finger to be turned round, its drawing, its parts and all its numbers.

And one with what was found of a finger: light angle, tolerances and stiffness.

A browser draws the parts: triangles, the edges that are seen as lines, colours and names.
"""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr

from data_schemas import FingerDesign, FingerStiffness, FingerTolerances, LightAngleDecision, package_version
from finray_calib.reports._decision_page import limits as decision_limits
from finray_calib.reports._decision_page import verdict_light, verdict_words
from finray_calib.reports._finger_views import PART_COLOURS
from finray_calib.reports._page import (
    Content,
    KeyNumber,
    Part,
    ReportPage,
    ReportTable,
    TableGroup,
    files_table,
    light_of,
    limits_section,
    one_group,
    render_page,
    report_html,
)
from finray_calib.reports._plain_text import NO_VALUE, percent
from finray_calib.reports._style import BLUE, GREEN, INK, MUTED, SKY, VERMILLION
from sim.mechanics import SkeletonLayout, pad_mesh, rigid_indenter, skeleton_layout, skeleton_mesh
from sim.optics import camera_pose, panel_frame
from sim.surface_meshes import boundary_quads, layout_scale, split_quads

Floats = NDArray[np.float64]
Numbers = NDArray[np.int64]

# a picture of 800 px shows a finger of 90 mm with 0.1 mm to the pixel: chords of a curved coat stay below that
_SKELETON_STEP_MM, _PAD_STEP_MM, _CHORD_MM = 5.0, 2.5, 0.05
_CAMERA_HALF_MM = 2.0
_SHARP = np.cos(np.radians(30.0))
_MOST_VERTICES = 2**16
_STEPS = 2**15 - 1


@dataclass(frozen=True, slots=True)
class ScenePart:
    """One part: what it is called, its colour (#rrggbb), whether it is shown at first, and its triangles."""

    name: str
    colour: str
    is_shown: bool
    vertices_mm: Floats
    triangles: Numbers


def finger_scene(design: FingerDesign, folder: Path = Path()) -> tuple[ScenePart, ...]:
    """Return the parts of a finger at rest, with its indenter where it first touches (not shown at first).

    Parameters
    ----------
    design
        Finger.
    folder
        Where the design stands: the STL of its indenter is relative to it.

    Raises
    ------
    SimulateError
        When the parts do not fit together, or the indenter's file is not a closed body.
    """
    return tuple(_parts(design, folder))


def _parts(design: FingerDesign, folder: Path) -> Iterator[ScenePart]:
    """Yield the parts."""
    pad = pad_mesh(design, _PAD_STEP_MM, design.pad.thickness_mm)
    surfaces = pad.surfaces
    clear = np.concatenate([surfaces["base"], surfaces["tip"], surfaces["inner"]])
    for name, colour, quads in (
        ("coating", "#8d959d", surfaces["coat"]),
        ("red wall", VERMILLION, surfaces["red"]),
        ("green wall", GREEN, surfaces["green"]),
        ("gel", PART_COLOURS["gel"], clear),
    ):
        yield ScenePart(name, colour, True, *_used(pad.nodes_mm, split_quads(quads, pad.nodes_mm)))
    sheet = "bond" if design.pad.film is None else "film"
    body = skeleton_mesh(design, _SKELETON_STEP_MM)
    colours = {sheet: "#e8c27a", **PART_COLOURS, "mirror": SKY}
    for mesh, name in ((pad, sheet), *((body, block.name) for block in body.blocks)):
        quads = boundary_quads(mesh.hexahedra[name]).quads
        triangles = split_quads(quads, mesh.nodes_mm)
        yield ScenePart(name.replace("_", " "), colours[name], True, *_used(mesh.nodes_mm, triangles))
    for number, light in enumerate(design.lights, start=1):
        panel = panel_frame(light)
        corners = [panel.centre_mm + a * panel.half_across_mm + b * panel.half_along_mm for a, b in _ROUND]
        name = "light panel" if len(design.lights) == 1 else f"light panel {number}"
        yield ScenePart(name, BLUE, True, np.array(corners), np.array([[0, 1, 2], [0, 2, 3]]))
    yield ScenePart("camera", INK, True, *_camera(design))
    yield ScenePart("indenter", MUTED, False, *_indenter(design, folder))


_ROUND = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))


def _camera(design: FingerDesign) -> tuple[Floats, Numbers]:
    """Return a cube around the camera's pinhole."""
    signs = np.array([(x, y, z) for z in (-1.0, 1.0) for x, y in _ROUND])
    quads = boundary_quads(np.arange(8)[None]).quads
    cube = camera_pose(design).centre_mm + _CAMERA_HALF_MM * layout_scale(design) * signs
    return cube, split_quads(quads, cube)


def _indenter(design: FingerDesign, folder: Path) -> tuple[Floats, Numbers]:
    """Return the indenter where it first touches; a cylinder without ends is cut beyond the finger."""
    indenter = rigid_indenter(design, folder)
    mesh = indenter.facets(_CHORD_MM, 0.75 * design.pad.width_mm)
    placed = mesh.vertices_mm @ indenter.touching.rotation.T + np.array(indenter.touching.position_mm)
    return placed, mesh.triangles


def _used(nodes_mm: Floats, triangles: Numbers) -> tuple[Floats, Numbers]:
    """Return the vertices that triangles use, and the triangles of their numbers."""
    used, numbers = np.unique(triangles, return_inverse=True)
    return nodes_mm[used], numbers.reshape(-1, 3)


def sharp_edges(vertices_mm: Floats, triangles: Numbers) -> Numbers:
    """Return the edges (m, 2) of one triangle only, and those at which a surface turns by more than 30 degrees."""
    corners = vertices_mm[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    again = (edges[1:] == edges[:-1]).all(axis=1)
    smooth = again & (np.einsum("ex,ex->e", normals[owner[1:]], normals[owner[:-1]]) > _SHARP)
    hidden = np.concatenate([smooth, [False]]) | np.concatenate([[False], smooth])
    return np.asarray(np.unique(edges[~hidden], axis=0))


def scene_values(parts: tuple[ScenePart, ...]) -> dict[str, object]:
    """Return the scene as values for JSON: vertices as 16-bit steps from the middle, all base64 in little-endian.

    A step is 1/32767 of the largest distance from the middle along an axis: 2 um for a finger of 130 mm.
    """
    shown = np.concatenate([part.vertices_mm for part in parts if part.is_shown])
    centre = (shown.min(axis=0) + shown.max(axis=0)) / 2.0
    reach = max(float(np.abs(part.vertices_mm - centre).max()) for part in parts)
    return {
        "reach_mm": round(reach, 4),
        "radius_mm": round(float(np.linalg.norm(shown - centre, axis=1).max()), 4),
        "parts": [_part_values(part, centre, reach) for part in parts],
    }


def _part_values(part: ScenePart, centre_mm: Floats, reach_mm: float) -> dict[str, object]:
    """Return one part as values for JSON; numbers of vertices take 32 bits where 16 do not suffice."""
    steps = np.rint((part.vertices_mm - centre_mm) / reach_mm * _STEPS)
    wide = len(steps) > _MOST_VERTICES
    edges = sharp_edges(part.vertices_mm, part.triangles)
    return {
        "name": part.name,
        "colour": [int(part.colour[i : i + 2], 16) / 255 for i in (1, 3, 5)],
        "shown": part.is_shown,
        "wide": wide,
        "vertices": _base64(steps, "<i2"),
        "triangles": _base64(part.triangles, "<u4" if wide else "<u2"),
        "edges": _base64(edges, "<u4" if wide else "<u2"),
    }


def _base64(values: NDArray[np.generic], kind: str) -> str:
    """Return numbers as base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


TEMPLATE: Final = "finger_page.html.j2"
_ENDINGS: Final = {"_mm": "mm", "_deg": "deg", "_nm": "nm", "_px": "px", "_mpa": "MPa"}
_GROUPS: Final = ("pad", "skeleton", "mirror", "camera", "light", "second_light", "further_lights", "enclosure",
                  "coating", "indenter", "mechanics")  # fmt: skip


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


_SKELETON_SIZES = ("front_fin_thickness_mm", "back_fin_thickness_mm", "rib_count", "rib_thickness_mm", "rib_width_mm")


_INDENTER_SIZE = {
    **dict.fromkeys(("cylinder", "ball"), "indenter.radius_mm"), "cuboid": "indenter.size_mm", "mesh": "indenter.file",
}  # fmt: skip


def _what(design: FingerDesign, layout: SkeletonLayout, name: str) -> tuple[str, tuple[str, ...]]:
    """Return what a part is, and the fields of the design that its size rests on."""
    pad, skeleton, indenter = design.pad, design.skeleton, design.indenter
    ribs = len(layout.ribs)
    size = ("pad.length_mm", "pad.width_mm", "pad.thickness_mm")
    shape = {"cylindrical": f", radius {pad.radius_mm} mm", "ellipsoidal": f", semi-axes {_text(pad.semi_axes_mm)} mm"}
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
            tuple(f"skeleton.{field}" for field in _SKELETON_SIZES),
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
            (_INDENTER_SIZE.get(indenter.shape, "indenter.parameters"),),
        ),
    }
    if name in known:
        return known[name]
    number = int(name.rpartition(" ")[2]) if name[-1].isdigit() else 1
    light = design.lights[number - 1]
    fields = ["light", *(["second_light"] if design.second_light is not None else [])]
    field = fields[number - 1] if number <= len(fields) else "further_lights"
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
        parts = value if isinstance(value, tuple) else () if value is None else (value,)
        rows = [row for part in parts for row in _rows(part.model_dump(), group, design)]
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


_STIFFNESSES: Final = (
    ("bending at the tip", "bending_n_per_mm", "N/mm"),
    ("sideways at the tip", "sideways_n_per_mm", "N/mm"),
    ("under the middle of the pad", "pad_n_per_mm", "N/mm"),
    ("twist of the tip", "twist_n_mm_per_deg", "N mm/deg"),
)


def stiffness_rows(study: FingerStiffness) -> tuple[tuple[str, str, str, str], ...]:
    """Return of a study's first finger each stiffness: name, value, range over assumptions, what moves it most."""
    drawn, rows = study.rows[0], []
    for name, field, unit in _STIFFNESSES:
        value = getattr(drawn, field)
        if value is None:
            rows.append((name, NO_VALUE, "", ""))
            continue
        changed = [(getattr(row, field), row) for row in study.rows
                   if row.design == drawn.design and row.changed and getattr(row, field) is not None]  # fmt: skip
        limits = most = ""
        if changed:
            found = [other for other, _ in changed]
            limits = (
                f"{min(found):.3g} to {max(found):.3g} with one assumed dimension changed by {100 * study.share:.0f} %"
            )
            most = max(changed, key=lambda pair: abs(pair[0] - value))[1].changed
        rows.append((name, f"{value:.3g} {unit}", limits, most))
    return tuple(rows)


#: Share of the variance of runs left out (Q2) that an emulator of tolerances must explain to be relied on.
ENOUGH_Q2: Final = 0.9
_WITHIN, _RARE = 0.95, 0.025  # share of fingers at the joint limit; one side of a 95 % interval


def is_contradicted(found: FingerTolerances) -> bool:
    """Return whether fewer fingers stayed within what is allowed, at the joint limit, than chance lets one expect.

    Parameters
    ----------
    found
        With fingers that were evaluated again at their joint limit.
    """
    return float(bdtr(found.checked_within, found.checked_fingers, _WITHIN)) < _RARE


def _assessed_numbers(
    decision: LightAngleDecision, tolerances: FingerTolerances, rows: Sequence[tuple[str, ...]]
) -> tuple[KeyNumber, ...]:
    """Return the three numbers of the first screen."""
    band, factor = decision.tolerance_deg, tolerances.together_factor
    around = "" if band is None else f"{band[0]:.0f} to {band[1]:.0f} deg lose little"
    times = f"over {tolerances.box_factor:.2g}" if factor is None else f"{factor:.2g}"
    return (
        KeyNumber("Light angle", f"{decision.angle_deg:.0f} deg", around),
        KeyNumber(
            "Build tolerances",
            f"{times} times",
            "the given half-ranges, for all numbers together: then 95 % of fingers have at most a tenth more error",
            light_of(tolerances.q2 >= ENOUGH_Q2 and not is_contradicted(tolerances)),
            f"by an emulator that explains {percent(tolerances.q2)} of the variance of fingers left out of its fit"
            + ("; fingers evaluated again contradict it" if is_contradicted(tolerances) else ""),
        ),
        KeyNumber("Stiffness under the pad", rows[2][1], rows[2][2]),
    )


def assessment_page(
    decision: LightAngleDecision,
    tolerances: FingerTolerances,
    stiffness: FingerStiffness,
    command: str,
    digests: Mapping[str, str],
) -> str:
    """Return one page (HTML) with the light angle, the tolerances and the stiffness of a finger.

    Parameters
    ----------
    decision, tolerances, stiffness
        What was found; tolerances and stiffness of the finger with the light that was decided on.
    command
        That made them.
    digests
        Input file -> SHA-256.
    """
    rows = stiffness_rows(stiffness)
    shown = 4 if any(row[2] for row in rows) else 2  # a quick assessment changes no dimension
    heads = ("load", "stiffness", "range", "moved most by")[:shown]
    design, factor = tolerances.design, tolerances.together_factor
    words = verdict_words(decision).capitalize()
    length_mm, width_mm = design.pad.length_mm, design.pad.width_mm
    parts = (
        _assessed("Light angle", f"{decision.headline} {words}.", "light-angle-decision.html"),
        _assessed("Tolerances", tolerances.sentence, "tolerances.html"),
        Part("Stiffness", Content(
            "By finite elements, against small loads. Records: finger-stiffness.json.",
            tables=(one_group("Stiffness of the finger", heads, [row[:shown] for row in rows], is_words=True),),
        )),
        limits_section((*decision_limits(decision), _ASSESSED_LIMIT), tolerances.notes),
    )  # fmt: skip
    return report_html(
        ReportPage(
            verb="finray design assess",
            title=design.name,
            lead=f"A finger with a pad of {length_mm:g} x {width_mm:g} mm: where to put the light, "
            "how closely to build it, and how stiff it is.",
            verdict=f"Light at {decision.angle_deg:.0f} deg",
            light=verdict_light(decision),
            sentence=decision.headline,
            picture=None,
            key_numbers=_assessed_numbers(decision, tolerances, rows),
            parts=parts,
            command=command,
            origin=files_table(digests, package_version()),
            summary={
                "angle_deg": decision.angle_deg,
                "together_factor": factor,
                "stiffness": stiffness.rows[0].model_dump(mode="json"),
            },
        )
    )  # fmt: skip


_ASSESSED_LIMIT: Final = (
    "Tolerances and stiffness are simulated, of assumed dimensions of the skeleton; no finger of this "
    "drawing was built or loaded. The range of a stiffness changes one dimension at a time and is not a "
    "confidence interval."
)


def _assessed(title: str, sentence: str, file: str) -> Part:
    """Return a section that tells a result and names its own page."""
    return Part(title, Content(sentence, remarks=(f"All details: {file}, beside this page.",)))
