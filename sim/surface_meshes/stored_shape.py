"""A finger's shapes without and with contact as a stored record, and back."""

import numpy as np

from data_schemas.surfaces import FingerSurfaces
from sim.surface_meshes.finger_shape import FingerShape
from sim.surface_meshes.surface import Surface


def store_shapes(rest: FingerShape, pressed: FingerShape, name: str, push_mm: float | None = None) -> FingerSurfaces:
    """Return a finger without and with contact, on the same meshes, as a record; the indenter's push where known."""
    surfaces = list(pressed.surfaces.values())
    return FingerSurfaces(
        name=name,
        label=pressed.label,
        push_mm=push_mm,
        parts=tuple(pressed.surfaces),
        vertex_counts=np.array([len(s.vertices_mm) for s in surfaces]),
        triangle_counts=np.array([len(s.triangles) for s in surfaces]),
        vertices_mm=np.concatenate([s.vertices_mm for s in surfaces]),
        rest_vertices_mm=np.concatenate([rest.surfaces[name].vertices_mm for name in pressed.surfaces]),
        uv=np.concatenate([s.uv for s in surfaces]),
        triangles=np.concatenate([s.triangles for s in surfaces]),
        contact_distance=pressed.contact_distance,
    )


def restore_shapes(record: FingerSurfaces) -> tuple[FingerShape, FingerShape]:
    """Return the shapes of a record: without and with contact.

    Raises
    ------
    SimulateError
        When a surface is missing or broken, or when the gel is open or inside out.
    """
    vertex_ends, triangle_ends = np.cumsum(record.vertex_counts), np.cumsum(record.triangle_counts)
    triangles, uv = np.split(record.triangles, triangle_ends[:-1]), np.split(record.uv, vertex_ends[:-1])
    shapes = []
    for vertices_mm, distance, label in (
        (record.rest_vertices_mm, np.full_like(record.contact_distance, np.nan), "at rest"),
        (record.vertices_mm, record.contact_distance, record.label),
    ):
        parts = zip(record.parts, np.split(vertices_mm, vertex_ends[:-1]), triangles, uv, strict=True)
        shapes.append(FingerShape({name: Surface(v, t, w) for name, v, t, w in parts}, distance, label))
    return shapes[0], shapes[1]
