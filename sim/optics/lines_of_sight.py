"""Rays through the mirror and the clear faces of a finger, bent as the renderer bends them, to the part they end on.

They meet the renderer's own triangles and bend by the same smooth normals, so they hold for any deformed finger.
Mirrors and clear faces are passed, everything else ends a ray.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.optics.variants import SCALAR_VARIANT
from sim.surface_meshes.surface import Surface, vertex_normals

Floats = NDArray[np.float64]

CLEAR_FACES = ("inner", "base", "tip")
NOTHING = -1
"""What a ray ends on that leaves the finger (it sees the cloth) or is lost between clear faces."""

# surfaces whose normals the renderer interpolates; the others are flat facets
_SMOOTH = ("coat", "mirror", "inner")
_MOST_CROSSINGS = 12
# rays start this far off the surface they leave: a hundred roundings of the renderer's 32-bit coordinates
_CLEARANCE_MM = 1e-3


@dataclass(frozen=True, slots=True)
class JoinedTriangles:
    """All surfaces in one list of triangles, with what each one needs when a ray meets it."""

    names: tuple[str, ...]
    owner: NDArray[np.int64]
    corners: Floats
    normals: Floats
    uv: Floats
    first: Mapping[str, int]

    def at(self, values: Floats, triangle: NDArray[np.int64], barycentric: Floats) -> Floats:
        """Interpolate values of corners, (triangle, 3 corners, ...)."""
        return np.asarray(np.einsum("nc,nc...->n...", barycentric, values[triangle]))


def join_triangles(surfaces: Mapping[str, Surface]) -> JoinedTriangles:
    """Join surfaces to one list of triangles."""
    counts = [len(s.triangles) for s in surfaces.values()]
    normals = []
    for name, surface in surfaces.items():
        corners = surface.vertices_mm[surface.triangles]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None]
        flat = np.broadcast_to(flat / np.linalg.norm(flat, axis=-1, keepdims=True), corners.shape)
        normals.append(vertex_normals(surface)[surface.triangles] if name in _SMOOTH else flat)
    return JoinedTriangles(
        names=tuple(surfaces),
        owner=np.repeat(np.arange(len(counts)), counts),
        corners=np.concatenate([s.vertices_mm[s.triangles] for s in surfaces.values()]),
        normals=np.concatenate(normals),
        uv=np.concatenate([s.uv[s.triangles] for s in surfaces.values()]),
        first=dict(zip(surfaces, np.cumsum([0, *counts[:-1]]).tolist(), strict=True)),
    )


def lines_of_sight(
    mesh: JoinedTriangles, origin: Floats, direction: Floats, index: float, renderer: ModuleType
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Follow rays to the first opaque part.

    Parameters
    ----------
    mesh
        All surfaces of the finger.
    origin, direction
        Starts in mm and unit directions, shape (n, 3).
    index
        Refractive index of the gel.
    renderer
        From :func:`sim.optics.variants.open_renderer`.

    Returns
    -------
    triangle
        Number of the triangle, or NOTHING, shape (n,).
    barycentric
        Place on it, shape (n, 3).
    last_leg
        Unit direction in which it is met, shape (n, 3).
    """
    scene = _load(mesh, renderer)
    mirror, clear = mesh.names.index("mirror"), [mesh.names.index(name) for name in CLEAR_FACES]
    end = np.full(len(origin), NOTHING, dtype=np.int64)
    place, leg = np.zeros((len(origin), 3)), np.zeros((len(origin), 3))
    on_way, origin, direction = np.arange(len(origin)), origin.copy(), direction.copy()
    for _ in range(_MOST_CROSSINGS):
        triangle, barycentric = _meet(scene, origin, direction, renderer)
        met = triangle >= 0
        on_way, direction, triangle, barycentric = on_way[met], direction[met], triangle[met], barycentric[met]
        owner = mesh.owner[triangle]
        ends = ~np.isin(owner, [mirror, *clear])
        end[on_way[ends]], place[on_way[ends]], leg[on_way[ends]] = triangle[ends], barycentric[ends], direction[ends]
        go_on = ~ends
        on_way, triangle, barycentric = on_way[go_on], triangle[go_on], barycentric[go_on]
        if not on_way.size:
            break
        normal = mesh.at(mesh.normals, triangle, barycentric)
        direction = _bend(direction[go_on], normal, owner[go_on] == mirror, index)
        origin = mesh.at(mesh.corners, triangle, barycentric) + _CLEARANCE_MM * direction
    return end, place, leg


def _bend(direction: Floats, normal: Floats, mirrored: NDArray[np.bool_], index: float) -> Floats:
    """Reflect at mirrors and, where refraction is impossible, at clear faces; refract at the others."""
    normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    cosine = np.sum(direction * normal, axis=-1, keepdims=True)
    ratio = np.where(cosine < 0.0, 1.0 / index, index)  # the gel's normals point out of it
    inside = 1.0 - ratio**2 * (1.0 - cosine**2)
    across = direction - cosine * normal
    refracted = ratio * across + np.sign(cosine) * np.sqrt(np.maximum(inside, 0.0)) * normal
    reflects = mirrored[:, None] | (inside < 0.0)
    return np.asarray(np.where(reflects, direction - 2.0 * cosine * normal, refracted))


def _load(mesh: JoinedTriangles, renderer: ModuleType) -> Any:
    """Return the renderer's scene of all triangles as one mesh, whose primitives keep their order."""
    count = len(mesh.corners)
    body = renderer.Mesh("finger", 3 * count, count)
    parameters = renderer.traverse(body)
    parameters["vertex_positions"] = mesh.corners.astype(np.float32).ravel()
    parameters["faces"] = np.arange(3 * count, dtype=np.uint32)
    parameters.update()
    return renderer.load_dict({"type": "scene", "finger": body})


def _meet(scene: Any, origin: Floats, direction: Floats, renderer: ModuleType) -> tuple[NDArray[np.int64], Floats]:
    """Return the triangle each ray meets first (NOTHING) and the barycentric place on it."""
    if renderer.variant() == SCALAR_VARIANT:
        triangle, uv = _meet_one_by_one(scene, origin.tolist(), direction.tolist(), renderer)
    else:
        rays = renderer.Ray3f(*(renderer.Vector3f(v.T.astype(np.float32)) for v in (origin, direction)))
        found = scene.ray_intersect_preliminary(rays, coherent=True)
        met = found.is_valid().numpy()
        triangle = np.where(met, found.prim_index.numpy().astype(np.int64), NOTHING)
        # what is not met has a place that was never written
        uv = np.where(met[:, None], found.prim_uv.numpy().T, np.float32(0.0)).astype(np.float64)
    return triangle, np.column_stack([1.0 - uv.sum(axis=-1), uv])


def _meet_one_by_one(
    scene: Any, origin: Sequence[Any], direction: Sequence[Any], renderer: ModuleType
) -> tuple[NDArray[np.int64], Floats]:
    """Meet triangles in a variant without arrays."""
    triangle, uv = np.full(len(origin), NOTHING, dtype=np.int64), np.zeros((len(origin), 2))
    for k, (start, towards) in enumerate(zip(origin, direction, strict=True)):
        found = scene.ray_intersect_preliminary(renderer.Ray3f(start, towards))
        if found.is_valid():
            triangle[k], uv[k] = found.prim_index, found.prim_uv
    return triangle, uv
