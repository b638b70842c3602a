"""What each pixel sees: the ray of its centre through mirror and gel to the part of the finger it ends on.

The rays meet the renderer's own triangles and bend by the same smooth normals, so the maps hold for any deformed
finger. Mirrors and clear faces are passed, everything else ends a ray.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.camera_calibration import CameraCalibration
from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.finger_view import camera_pose, pixel_directions
from sim.optics.opencv_camera import ray_table, require_same_shape
from sim.optics.panel_frame import panel_frame
from sim.optics.variants import SCALAR_VARIANT
from sim.surface_meshes.finger_shape import FingerShape
from sim.surface_meshes.surface import Surface

Floats = NDArray[np.float64]

CLEAR_FACES = ("inner", "base", "tip")
NOTHING = -1
"""Part of a pixel whose ray leaves the finger (it sees the cloth) or is lost between clear faces."""

# surfaces whose normals the renderer interpolates; the others are flat facets
_SMOOTH = ("coat", "mirror", "inner")
_MOST_CROSSINGS = 12
# rays start this far off the surface they leave: a hundred roundings of the renderer's 32-bit coordinates
_CLEARANCE_MM = 1e-3


@dataclass(frozen=True, slots=True)
class PixelMaps:
    """What the centres of the pixels see; arrays of (rows, columns, ...), NaN where a value has no meaning.

    Attributes
    ----------
    parts
        Names of the parts that :attr:`part` counts: the surfaces of the finger, then its light panels.
    part
        Index into ``parts``, or NOTHING.
    uv
        Texture coordinates of the point seen, those of the undeformed finger.
    position_mm, normal
        Point seen and its outward normal, in the axes of the undeformed pad.
    depth_mm
        How far the point of the coat has moved inward, against its normal at rest.
    depth_along_ray_mm
        How far it has moved towards the camera, against the ray's last leg.
    contact_distance
        Distance from the centre of the contact in units of its half-width; the contact is where it is <= 1.
    last_leg
        Unit direction in which the ray of the pixel meets the point seen.
    """

    parts: tuple[str, ...]
    part: NDArray[np.int16]
    uv: Floats
    position_mm: Floats
    normal: Floats
    depth_mm: Floats
    depth_along_ray_mm: Floats
    contact_distance: Floats
    last_leg: Floats

    def sees(self, name: str) -> NDArray[np.bool_]:
        """Return which pixels see a part."""
        return np.asarray(self.part == self.parts.index(name))

    @property
    def contact(self) -> NDArray[np.bool_]:
        """Pixels that see the contact."""
        return np.asarray(self.contact_distance <= 1.0)

    def coat_mm(self, design: FingerDesign) -> Floats:
        """Return the undeformed place (z along, x across) of the point of the coat, NaN where another part is seen."""
        place = np.stack([self.uv[..., 1] * design.pad.length_mm, (self.uv[..., 0] - 0.5) * design.pad.width_mm], -1)
        return np.where(self.sees("coat")[..., None], place, np.nan)


@dataclass(frozen=True, slots=True)
class _Triangles:
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


def pixel_maps(
    design: FingerDesign,
    shape: FingerShape,
    rest: FingerShape,
    renderer: ModuleType,
    calibration: CameraCalibration | None = None,
) -> PixelMaps:
    """Trace the centre of each pixel, one pixel per Bayer cell.

    Parameters
    ----------
    design
        Camera, lights and refractive index.
    shape
        Surfaces of the finger as it is.
    rest
        The same meshes undeformed: what :attr:`PixelMaps.depth_mm` counts from.
    renderer
        From :func:`sim.optics.variants.open_renderer`; a scalar variant works too, slowly.
    calibration
        Of the camera; without it the ideal pinhole of the design.

    Raises
    ------
    SimulateError
        When no pixel sees the coat, or the two shapes have different meshes.
    """
    rays = camera_rays(design, calibration)
    surfaces = {**shape.surfaces, **{f"panel {k + 1}": _panel(design, k) for k in range(len(design.lights))}}
    mesh = _triangles(surfaces)
    index = design.pad.index_at(design.light.peak_wavelength_nm)
    origin = np.broadcast_to(camera_pose(design).centre_mm, rays.shape).reshape(-1, 3)
    triangle, barycentric, last_leg = _trace(mesh, origin, rays.reshape(-1, 3), index, renderer)
    met = triangle >= 0
    part = np.where(met, mesh.owner[triangle], NOTHING)
    on_coat = part == mesh.names.index("coat")
    if not on_coat.any():
        raise SimulateError(
            f"the camera does not see the coated face ({shape.label}): check camera.field_of_view_deg"
            + ("" if calibration is None else f", camera.calibration ({calibration.source})")
            + ", mirror.radius_mm and whether light.position_mm stands in its way"
        )

    def spread(values: Floats, where: NDArray[np.bool_]) -> Floats:
        full = np.full((len(part), *values.shape[1:]), np.nan)
        full[where] = values
        return full.reshape(*rays.shape[:2], *values.shape[1:])

    normal = mesh.at(mesh.normals, triangle[met], barycentric[met])
    on_mesh = triangle[on_coat] - mesh.first["coat"]
    inward, along_ray, distance = _coat_values(shape, rest, on_mesh, barycentric[on_coat], last_leg[on_coat])
    return PixelMaps(
        parts=mesh.names,
        part=part.astype(np.int16).reshape(rays.shape[:2]),
        uv=spread(mesh.at(mesh.uv, triangle[met], barycentric[met]), met),
        position_mm=spread(mesh.at(mesh.corners, triangle[met], barycentric[met]), met),
        normal=spread(normal / np.linalg.norm(normal, axis=-1, keepdims=True), met),
        depth_mm=spread(inward, on_coat),
        depth_along_ray_mm=spread(along_ray, on_coat),
        contact_distance=spread(distance, on_coat),
        last_leg=spread(last_leg[met], met),
    )


def camera_rays(design: FingerDesign, calibration: CameraCalibration | None = None) -> Floats:
    """Return the unit direction through the centre of each pixel, shape (rows, columns, 3), in the pad's axes."""
    pose = camera_pose(design)
    if calibration is None:
        return pixel_directions(pose)
    require_same_shape(calibration, pose.columns_px, pose.rows_px)
    film = np.stack(
        np.meshgrid(*((np.arange(count) + 0.5) / count for count in (pose.columns_px, pose.rows_px))), axis=-1
    )
    return ray_table(calibration).directions(film) @ np.stack([pose.right, pose.down, pose.forward])


def vertex_normals(surface: Surface) -> Floats:
    """Return the normals of the vertices: means of the faces around them, weighted by their angles there."""
    corners = surface.vertices_mm[surface.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=-1, keepdims=True)
    normals = np.zeros_like(surface.vertices_mm)
    for k in range(3):
        a, b = (corners[:, (k + step) % 3] - corners[:, k] for step in (1, 2))
        cosine = np.sum(a * b, axis=-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
        np.add.at(normals, surface.triangles[:, k], face * np.arccos(np.clip(cosine, -1.0, 1.0))[:, None])
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _triangles(surfaces: Mapping[str, Surface]) -> _Triangles:
    """Join surfaces to one list of triangles."""
    counts = [len(s.triangles) for s in surfaces.values()]
    normals = []
    for name, surface in surfaces.items():
        corners = surface.vertices_mm[surface.triangles]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None]
        flat = np.broadcast_to(flat / np.linalg.norm(flat, axis=-1, keepdims=True), corners.shape)
        normals.append(vertex_normals(surface)[surface.triangles] if name in _SMOOTH else flat)
    return _Triangles(
        names=tuple(surfaces),
        owner=np.repeat(np.arange(len(counts)), counts),
        corners=np.concatenate([s.vertices_mm[s.triangles] for s in surfaces.values()]),
        normals=np.concatenate(normals),
        uv=np.concatenate([s.uv[s.triangles] for s in surfaces.values()]),
        first=dict(zip(surfaces, np.cumsum([0, *counts[:-1]]).tolist(), strict=True)),
    )


def _trace(
    mesh: _Triangles, origin: Floats, direction: Floats, index: float, renderer: ModuleType
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Follow rays to the first opaque part; return its triangle (NOTHING), the place on it and the last leg."""
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


def _load(mesh: _Triangles, renderer: ModuleType) -> Any:
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
        triangle = np.where(found.is_valid().numpy(), found.prim_index.numpy().astype(np.int64), NOTHING)
        uv = found.prim_uv.numpy().T.astype(np.float64)
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


def _coat_values(
    shape: FingerShape, rest: FingerShape, triangle: NDArray[np.int64], barycentric: Floats, leg: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return displacement inward and against the ray, and the contact distance, at places on the coat."""
    now, before = shape.surfaces["coat"], rest.surfaces["coat"]
    if now.triangles.shape != before.triangles.shape or (now.triangles != before.triangles).any():
        raise SimulateError(
            f"the coat '{shape.label}' has {len(now.triangles)} triangles and the coat '{rest.label}' "
            f"{len(before.triangles)}, or in another order: depths need the same mesh, deformed and at rest"
        )
    corners = now.triangles[triangle]

    def at(values: Floats) -> Floats:
        return np.asarray(np.einsum("nc,nc...->n...", barycentric, values[corners]))

    moved, outward = at(now.vertices_mm - before.vertices_mm), at(vertex_normals(before))
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    return -np.sum(moved * outward, axis=-1), -np.sum(moved * leg, axis=-1), at(shape.contact_distance)


def _panel(design: FingerDesign, number: int) -> Surface:
    """Return a light panel as two triangles."""
    frame = panel_frame(design.lights[number])
    sides = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = frame.centre_mm + sides[:, :1] * frame.half_across_mm + sides[:, 1:] * frame.half_along_mm
    return Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), (sides + 1.0) / 2.0)
