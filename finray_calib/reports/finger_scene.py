"""The parts of a finger as a browser draws them: triangles, the edges that are seen as lines, colours and names."""

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from finray_calib.reports.finger_outline import PART_COLOURS
from finray_calib.reports.style import BLUE, GREEN, INK, MUTED, SKY, VERMILLION
from sim.mechanics.body_meshes import body_mesh
from sim.mechanics.indenters import rigid_indenter
from sim.mechanics.pad_mesh import pad_mesh
from sim.mechanics.skeleton_mesh import skeleton_mesh
from sim.optics.finger_view import camera_pose
from sim.optics.panel_frame import panel_frame
from sim.surface_meshes.back_mirror import layout_scale
from sim.surface_meshes.hexahedra import boundary_quads, split_quads

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
        When the parts do not fit together, or the indenter's file is no closed body.
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
    mesh = indenter.surface
    if indenter.body is not None:
        mesh = body_mesh(indenter.body, _CHORD_MM, 0.75 * design.pad.width_mm)
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
