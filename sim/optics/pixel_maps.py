"""What each pixel sees: the ray of its centre through mirror and gel to the part of the finger it ends on."""

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from data_schemas.camera_calibration import CameraCalibration
from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.optics.finger_view import camera_pose, pixel_directions
from sim.optics.lines_of_sight import NOTHING, join_triangles, lines_of_sight
from sim.optics.opencv_camera import ray_table, require_same_shape
from sim.optics.panel_frame import panel_frame
from sim.surface_meshes.finger_shape import FingerShape
from sim.surface_meshes.surface import Surface, vertex_normals

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PixelMaps:
    """What the centres of the pixels see; arrays of (rows, columns, ...), NaN where a value has no meaning.

    Attributes
    ----------
    parts
        Names of the parts that :attr:`part` counts: the surfaces of the finger, then its light panels.
    part
        Index into ``parts``, or :data:`~sim.optics.lines_of_sight.NOTHING`.
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
    mesh = join_triangles(surfaces)
    index = design.pad.index_at(design.light.peak_wavelength_nm)
    origin = np.broadcast_to(camera_pose(design).centre_mm, rays.shape).reshape(-1, 3)
    triangle, barycentric, last_leg = lines_of_sight(mesh, origin, rays.reshape(-1, 3), index, renderer)
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
