"""What each pixel sees: the ray of its centre through mirror and gel to the part of the finger it ends on.

The rays meet the renderer's own triangles and bend by the same smooth normals, so they hold for any deformed finger;
mirrors and clear faces are passed, everything else ends a ray. From them follows what the tactile camera sees of the
pad: how much of it, how finely, and what else is in the picture.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import CameraCalibration, FingerDesign, ImpossibleFingerError, SimulateError
from sim.optics._calibrated_camera import ray_table, read_calibration, require_same_shape
from sim.optics._optical_layout import CameraPose, camera_pose, panel_frame, pixel_directions
from sim.optics._renderer import SCALAR_VARIANT
from sim.surface_meshes import FingerShape, Surface, mirror_shape, rest_shape, vertex_normals

Floats = NDArray[np.float64]

_UNION_MM: Final = 0.05
"""Pixel of the drawing in which the coat that is seen is counted, well below a cell of the camera on the coat."""
_UNION_BITS: Final = 4
_CORNERS: Final = ((-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0))


@dataclass(frozen=True, slots=True)
class PixelMaps:
    """What the centres of the pixels see; arrays of (rows, columns, ...), NaN where a value has no meaning.

    Attributes
    ----------
    parts
        Names of the parts that :attr:`part` counts: the surfaces of the finger, then its light panels.
    part
        Index into ``parts``, or :data:`~sim.optics._pixel_maps.NOTHING`.
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
        From :func:`sim.optics.open_renderer`; a scalar variant works too, slowly.
    calibration
        Of the camera; without it the ideal pinhole of the design.

    Raises
    ------
    SimulateError
        When no pixel sees the coat, or the two shapes have different meshes.
    """
    rays = camera_rays(design, calibration)
    surfaces = {**shape.surfaces, **{f"panel {k + 1}": _panel(design, k) for k in range(len(design.lights))}}
    mesh = join_triangles(surfaces)
    index = design.pad.index_at(design.light.peak_wavelength_nm)
    origin = np.broadcast_to(camera_pose(design).centre_mm, rays.shape).reshape(-1, 3)
    triangle, barycentric, last_leg = lines_of_sight(mesh, origin, rays.reshape(-1, 3), index, renderer)
    met = triangle >= 0
    part = np.where(met, mesh.owner[triangle], NOTHING)
    on_coat = part == mesh.names.index("coat")
    if not on_coat.any():
        raise ImpossibleFingerError(
            f"the camera does not see the coated face ({shape.label}): check camera.field_of_view_deg"
            + ("" if calibration is None else f", camera.calibration ({calibration.source})")
            + ", mirror.radius_mm and whether the panel at light.position_mm blocks its view"
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
    return pose_rays(camera_pose(design), calibration)


def pose_rays(pose: CameraPose, calibration: CameraCalibration | None = None) -> Floats:
    """Return the same of a camera in a pose."""
    if calibration is None:
        return pixel_directions(pose)
    require_same_shape(calibration, pose.columns_px, pose.rows_px)
    film = np.stack(
        np.meshgrid(*((np.arange(count) + 0.5) / count for count in (pose.columns_px, pose.rows_px))), axis=-1
    )
    return ray_table(calibration).directions(film) @ np.stack([pose.right, pose.down, pose.forward])


def require_same_coat(pressed: FingerShape, rest: FingerShape) -> None:
    """Refuse shapes whose coats have different meshes.

    Raises
    ------
    SimulateError
        Their triangles differ.
    """
    after, before = pressed.surfaces["coat"].triangles, rest.surfaces["coat"].triangles
    if not np.array_equal(after, before):
        raise SimulateError(
            f"the coat '{pressed.label}' has {len(after)} triangles but the coat '{rest.label}' has {len(before)}, or "
            "their order differs; give the same mesh, deformed and at rest"
        )


def _coat_values(
    shape: FingerShape, rest: FingerShape, triangle: NDArray[np.int64], barycentric: Floats, leg: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return displacement inward and against the ray, and the contact distance, at places on the coat."""
    now, before = shape.surfaces["coat"], rest.surfaces["coat"]
    require_same_coat(shape, rest)
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


CLEAR_FACES = ("inner", "base", "tip")


def lines_of_sight(
    mesh: JoinedTriangles,
    origin: Floats,
    direction: Floats,
    index: float,
    renderer: ModuleType,
    clear_faces: Sequence[str] = CLEAR_FACES,
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
        From :func:`sim.optics.open_renderer`.
    clear_faces
        Names of the surfaces that rays pass.

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
    mirror = mesh.names.index("mirror") if "mirror" in mesh.names else NOTHING
    clear = [mesh.names.index(name) for name in clear_faces]
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


_SENSOR_PX_PER_CELL = 2.0


@dataclass(frozen=True, slots=True)
class CameraView:
    """View of the undeformed pad.

    Attributes
    ----------
    design
        The finger.
    maps
        What the centre of each Bayer cell sees.
    coat_share
        Share of the coat's area in the picture.
    px_per_mm_along, px_per_mm_across
        Sensor pixels per mm of the coat along (z) and across (x) the pad, per Bayer cell; NaN off the coat.
    """

    design: FingerDesign
    maps: PixelMaps
    coat_share: float
    px_per_mm_along: Floats
    px_per_mm_across: Floats

    def picture_share(self, part: str) -> float:
        """Return the share of the picture that shows a part."""
        return float(self.maps.sees(part).mean())

    @property
    def seen_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest place of the coat that is seen, along (z) and across (x) the pad."""
        place = self.maps.coat_mm(self.design)
        low, high = np.nanmin(place, axis=(0, 1)), np.nanmax(place, axis=(0, 1))
        return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))

    @property
    def mm_per_px(self) -> tuple[float, float]:
        """Median size of a sensor pixel on the coat, along and across together, and its relative standard uncertainty.

        Twice that uncertainty reaches as far as 95 % of the pixels.
        """
        both = 1.0 / np.concatenate([self.px_per_mm_along.ravel(), self.px_per_mm_across.ravel()])
        low, middle, high = np.nanpercentile(both, (2.5, 50.0, 97.5))
        return float(middle), float(max(middle - low, high - middle) / (2.0 * middle))

    def __str__(self) -> str:
        """Say it in a few lines."""
        (z_low, z_high), (x_low, x_high) = self.seen_mm
        pad, half = self.design.pad, self.design.pad.width_mm / 2.0
        walls = [self.picture_share(name) for name in ("red", "green")]
        pose, mirror, given = camera_pose(self.design), mirror_shape(self.design), self.design.camera.position_mm
        reach = mirror.half_length_mm - self.design.mirror.overhang_mm
        ends = [mirror.apex_yz_mm + side * reach * mirror.tangent_yz for side in (-1.0, 1.0)]
        return "\n".join(
            (
                f"{self.design.name}: the camera sees {100 * self.coat_share:.0f} % of the coat through the mirror",
                f"  along the pad   z = {z_low:.1f} to {z_high:.1f} mm of 0 to {pad.length_mm:g} mm, "
                f"{_range(self.px_per_mm_along)} px/mm",
                f"  across the pad  x = {x_low:.1f} to {x_high:.1f} mm of {-half:g} to {half:g} mm, "
                f"{_range(self.px_per_mm_across)} px/mm",
                f"  of the picture  coat {100 * self.picture_share('coat'):.0f} %, red wall {100 * walls[0]:.1f} %, "
                f"green wall "
                f"{100 * walls[1]:.1f} %",
                f"  camera          x, y, z = {_numbers(pose.centre_mm)} mm, {self.design.camera.aim_deg:g} deg to the "
                f"tip ({_told(self.design, 'camera.position_mm', given is not None)})",
                f"  mirror          y, z = {_numbers(ends[0])} to {_numbers(ends[1])} mm, radius {mirror.radius_mm:g} "
                f"mm ({_told(self.design, 'mirror.base_yz_mm', self.design.mirror.base_yz_mm is not None)})",
                *(
                    f"  light panel     x, y, z = {_numbers(light.position_mm)} mm, {light.angle_deg:g} deg from the "
                    f"pad plane, azimuth {light.azimuth_deg:g} deg"
                    for light in self.design.lights
                ),
            )
        )


def _numbers(values: Sequence[float] | Floats) -> str:
    """Return numbers to a tenth."""
    return ", ".join(f"{value + 0.0:.1f}" for value in values)


def _told(design: FingerDesign, field: str, is_given: bool) -> str:
    """Return where a place comes from."""
    return design.origin.get(field, "assumed") if is_given else "assumed, by the size of the pad"


def camera_view(design: FingerDesign, folder: Path, renderer: ModuleType) -> CameraView:
    """Return what the camera of a design sees of the undeformed finger.

    Parameters
    ----------
    design
        The finger.
    folder
        Where a relative path of camera.calibration starts.
    renderer
        From :func:`sim.optics.open_renderer`.

    Raises
    ------
    SimulateError
        When the camera does not see the coat.
    """
    calibration = None if design.camera.calibration is None else read_calibration(folder / design.camera.calibration)
    rest = rest_shape(design)
    maps = pixel_maps(design, rest, rest, renderer, calibration)
    by_row, by_column, area_mm2 = _jacobian(maps.coat_mm(design))
    along, across = _resolution(by_row, by_column, area_mm2)
    share = _union_share(maps.coat_mm(design), by_row, by_column, (design.pad.length_mm, design.pad.width_mm))
    return CameraView(design, maps, share, along, across)


def _union_share(place: Floats, by_row: Floats, by_column: Floats, pad_mm: tuple[float, float]) -> float:
    """Return the share of the coat in the picture; a place that the camera sees twice counts once."""
    size = tuple(math.ceil(length / _UNION_MM) for length in pad_mm)
    seen = np.zeros(size, dtype=np.uint8)
    corners = np.stack([place + (a * by_row + b * by_column) / 2.0 for a, b in _CORNERS], axis=2)
    corners = corners[np.isfinite(corners).all(axis=(2, 3))]  # (cells, corners, z and x)
    # pixel k of the drawing is centred at (k + 0.5) / size of the pad
    in_drawing = (corners / pad_mm + (0.0, 0.5)) * size - 0.5
    for cell in np.round(in_drawing[..., ::-1] * 2**_UNION_BITS).astype(np.int32):
        cv2.fillConvexPoly(seen, cell, 1, shift=_UNION_BITS)
    return float(seen.mean())


def _jacobian(place: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the change of place (z, x) per row and per column, and the area of the coat per cell, mm^2."""
    by_row, by_column = (_slope(place, axis) for axis in (0, 1))
    return by_row, by_column, np.abs(by_row[..., 0] * by_column[..., 1] - by_row[..., 1] * by_column[..., 0])


def _slope(place: Floats, axis: int) -> Floats:
    """Return differences between neighbours along an axis, at the edge of the coat to the one neighbour there is."""
    step = np.diff(place, axis=axis)
    none = np.full_like(np.take(place, [0], axis=axis), np.nan)
    before, after = np.concatenate([none, step], axis=axis), np.concatenate([step, none], axis=axis)
    both = 0.5 * (before + after)
    return np.where(np.isfinite(both), both, np.where(np.isfinite(before), before, after))


def _resolution(by_row: Floats, by_column: Floats, area_mm2: Floats) -> tuple[Floats, Floats]:
    """Return sensor pixels per mm along and across the pad: lengths of the columns of d(row, column)/d(z, x)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        along = np.hypot(by_column[..., 1], by_row[..., 1]) / area_mm2
        across = np.hypot(by_column[..., 0], by_row[..., 0]) / area_mm2
    return _SENSOR_PX_PER_CELL * along, _SENSOR_PX_PER_CELL * across


def _range(values: Floats) -> str:
    """Return the middle 90 % of values."""
    low, high = np.nanpercentile(values[np.isfinite(values)], (5.0, 95.0))
    return f"{low:.1f} to {high:.1f}"
