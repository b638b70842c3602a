"""Where light panels, camera and mirror stand, and which point of the coated face each pixel sees.

A panel is a rectangle in space. The pixel's ray is followed in closed form: pinhole, convex mirror, refraction at the
flat inner face, coated face. So the position map has no noise and needs no renderer.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, LightPanel, SimulateError
from sim.surface_meshes import MirrorShape, layout_scale, mirror_shape, pressed_height_mm


@dataclass(frozen=True, slots=True)
class PanelFrame:
    """The panel as a rectangle: centre, half edges and unit normal, in mm of the pad's axes."""

    centre_mm: NDArray[np.float64]
    half_across_mm: NDArray[np.float64]
    half_along_mm: NDArray[np.float64]
    normal: NDArray[np.float64]

    @property
    def area_mm2(self) -> float:
        """Area of the panel."""
        return float(4.0 * np.linalg.norm(self.half_across_mm) * np.linalg.norm(self.half_along_mm))


def panel_frame(light: LightPanel) -> PanelFrame:
    """Return the rectangle of a light panel: normal (0, sin a, cos a) for the light angle a from the pad plane."""
    angle = np.radians(light.angle_deg)
    normal = np.array([0.0, np.sin(angle), np.cos(angle)])
    across = np.array([1.0, 0.0, 0.0])
    return PanelFrame(
        np.array(light.position_mm, dtype=np.float64),
        across * light.width_mm / 2.0,
        np.cross(normal, across) * light.height_mm / 2.0,
        normal,
    )


def panel_quadrature(frame: PanelFrame, across: int, along: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return Gauss-Legendre points (m, 3) on a panel and their areas (m,)."""
    u, weight_u = np.polynomial.legendre.leggauss(across)
    v, weight_v = np.polynomial.legendre.leggauss(along)
    points = frame.centre_mm + u[:, None, None] * frame.half_across_mm + v[None, :, None] * frame.half_along_mm
    return points.reshape(-1, 3), np.outer(weight_u, weight_v).ravel() * frame.area_mm2 / 4.0


# Assumed place for a pad of 70 x 35 mm (y then z), chosen so that the pad fills the frame; it scales with the pad.
_CAMERA = np.array([-15.0, -2.0])
_CAMERA_AIM_DEG = 14.0
_BISECTIONS = 48
# around the coat's pixels, to hold the painted walls beside them
_WINDOW_MARGIN = 0.15


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Pinhole camera: centre in mm, unit axes, and the tangents of half its field in both directions."""

    centre_mm: NDArray[np.float64]
    forward: NDArray[np.float64]
    right: NDArray[np.float64]
    down: NDArray[np.float64]
    tan_half_width: float
    tan_half_height: float
    columns_px: int
    rows_px: int


@dataclass(frozen=True, slots=True)
class Window:
    """Rectangle of pixels that see the pad, or a part of it."""

    first_row: int
    last_row: int
    first_column: int
    last_column: int

    @classmethod
    def around(cls, *positions: NDArray[np.float64]) -> "Window":
        """Return the rectangle around all pixels that see the coat in any map, with a margin for the walls.

        Raises
        ------
        SimulateError
            When no pixel sees the coat.
        """
        seen = np.logical_or.reduce([np.isfinite(p[..., 0]) for p in positions])
        if not seen.any():
            raise SimulateError(
                "the camera does not see the coated face: check camera.field_of_view_deg, the mirror and the panel's "
                "position in the design"
            )
        ends = []
        for axis in (1, 0):
            where = np.flatnonzero(seen.any(axis=axis))
            margin = int(np.ceil(_WINDOW_MARGIN * len(where)))
            ends += [max(0, int(where[0]) - margin), min(seen.shape[1 - axis], int(where[-1]) + 1 + margin)]
        return cls(*ends)

    @property
    def rows(self) -> slice:
        """Rows of the window."""
        return slice(self.first_row, self.last_row)

    @property
    def columns(self) -> slice:
        """Columns of the window."""
        return slice(self.first_column, self.last_column)

    def film_crop(self) -> dict[str, int]:
        """Return the window as the crop of a renderer's film."""
        return {
            "crop_offset_x": self.first_column,
            "crop_offset_y": self.first_row,
            "crop_width": self.last_column - self.first_column,
            "crop_height": self.last_row - self.first_row,
        }


def camera_pose(design: FingerDesign) -> CameraPose:
    """Return the camera at the base: it looks at the mirror, the pad's length runs along the rows.

    The field of view of the design is taken over the picture's diagonal, as makers of lenses state it. One pixel
    is one Bayer cell, so there are half as many rows and columns as on the sensor.
    """
    mirror, aim = mirror_shape(design), np.radians(_CAMERA_AIM_DEG)
    through_mirror = np.array([np.cos(aim), np.sin(aim)])
    forward = through_mirror - 2.0 * (through_mirror @ mirror.normal_yz) * mirror.normal_yz
    rows, columns = design.camera.height_px // 2, design.camera.width_px // 2
    tan_per_px = np.tan(np.radians(design.camera.field_of_view_deg) / 2.0) / np.hypot(rows, columns)
    return CameraPose(
        centre_mm=np.array([0.0, *(_CAMERA * layout_scale(design))]),
        forward=np.array([0.0, *forward]),
        right=np.array([0.0, forward[1], -forward[0]]),
        down=np.array([-1.0, 0.0, 0.0]),
        tan_half_width=float(tan_per_px * columns),
        tan_half_height=float(tan_per_px * rows),
        columns_px=columns,
        rows_px=rows,
    )


def pixel_directions(pose: CameraPose) -> NDArray[np.float64]:
    """Return the unit direction through the centre of each pixel, shape (rows, columns, 3)."""
    u = ((np.arange(pose.columns_px) + 0.5) / pose.columns_px * 2.0 - 1.0) * pose.tan_half_width
    v = ((np.arange(pose.rows_px) + 0.5) / pose.rows_px * 2.0 - 1.0) * pose.tan_half_height
    rays = pose.forward + u[None, :, None] * pose.right + v[:, None, None] * pose.down
    return np.asarray(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def coat_positions(design: FingerDesign) -> NDArray[np.float64]:
    """Return where on the coated face each pixel looks.

    Returns
    -------
    array
        (z, x) in mm, shape (rows, columns, 2); NaN where the pixel does not see the coated face directly through
        mirror and inner face (walls, ends, box, or the light panel in front).
    """
    pose, mirror, pad = camera_pose(design), mirror_shape(design), design.pad
    with np.errstate(invalid="ignore", divide="ignore"):
        on_mirror, reflected = _reflect(pose.centre_mm, pixel_directions(pose), mirror)
        to_face = -on_mirror[..., 1] / reflected[..., 1]
        entry = on_mirror + to_face[..., None] * reflected
        seen = (reflected[..., 1] > 0.0) & (to_face > 0.0) & (np.abs(entry[..., 0]) < pad.width_mm / 2.0)
        seen &= (entry[..., 2] > 0.0) & (entry[..., 2] < pad.length_mm)
        seen &= ~_panel_blocks(design, np.broadcast_to(pose.centre_mm, entry.shape), on_mirror)
        seen &= ~_panel_blocks(design, on_mirror, entry)
        on_coat = _meet_coat(design, entry, _refract(reflected, pad.index_at(design.light.peak_wavelength_nm)))
        seen &= (np.abs(on_coat[..., 0]) < pad.width_mm / 2.0) & (on_coat[..., 2] > 0.0)
        seen &= on_coat[..., 2] < pad.length_mm
    return np.where(seen[..., None], on_coat[..., [2, 0]], np.nan)


def _reflect(
    origin: NDArray[np.float64], rays: NDArray[np.float64], mirror: MirrorShape
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where rays meet the mirror's front and their directions after it; NaN without a meeting."""
    start = origin[1:] - mirror.apex_yz_mm
    s0, h0 = start @ mirror.tangent_yz, start @ mirror.normal_yz
    ds, dh = rays[..., 1:] @ mirror.tangent_yz, rays[..., 1:] @ mirror.normal_yz
    # (h0 + t dh) + (s0 + t ds)^2 / (2 R) = 0 in the form that is stable for a flat mirror
    a, b, c = ds**2 / (2.0 * mirror.radius_mm), dh + s0 * ds / mirror.radius_mm, h0 + s0**2 / (2.0 * mirror.radius_mm)
    distance = 2.0 * c / (-b + np.sqrt(b**2 - 4.0 * a * c))
    s = s0 + distance * ds
    meets = origin + distance[..., None] * rays
    ok = (distance > 0.0) & (np.abs(s) < mirror.half_length_mm) & (np.abs(meets[..., 0]) < mirror.half_width_mm)
    normal_yz = mirror.normal_yz + (s / mirror.radius_mm)[..., None] * mirror.tangent_yz
    normal = np.concatenate([np.zeros((*s.shape, 1)), normal_yz], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    reflected = rays - 2.0 * np.sum(rays * normal, axis=-1, keepdims=True) * normal
    return np.where(ok[..., None], meets, np.nan), reflected


def _refract(rays: NDArray[np.float64], index: float) -> NDArray[np.float64]:
    """Refract rays with y > 0 into the gel at the plane y = 0."""
    refracted = rays / index
    refracted[..., 1] = np.sqrt(1.0 - refracted[..., 0] ** 2 - refracted[..., 2] ** 2)
    return refracted


def _meet_coat(design: FingerDesign, entry: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bisect for the point where rays from the inner face meet the coated face."""
    highest = design.pad.thickness_mm * 1.5
    near, far = np.zeros(entry.shape[:-1]), highest / rays[..., 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (near + far)
        below = middle * rays[..., 1] < _flat_pad_height_mm(design, entry[..., 2] + middle * rays[..., 2])
        near, far = np.where(below, middle, near), np.where(below, far, middle)
    return np.asarray(entry + (0.5 * (near + far))[..., None] * rays)


def _flat_pad_height_mm(design: FingerDesign, z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height of the coat of a flat pad, which is the same all across."""
    return np.asarray(pressed_height_mm(design, np.zeros(1), z_mm.ravel())[0].reshape(z_mm.shape))


def _panel_blocks(design: FingerDesign, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell whether the light panel stands between two points."""
    frame = panel_frame(design.light)
    before, after = (start - frame.centre_mm) @ frame.normal, (end - frame.centre_mm) @ frame.normal
    share = before / (before - after)
    point = start + share[..., None] * (end - start) - frame.centre_mm
    inside = np.ones(share.shape, dtype=np.bool_)
    for edge in (frame.half_across_mm, frame.half_along_mm):
        inside &= np.abs(point @ edge) < edge @ edge
    return inside & (share > 0.0) & (share < 1.0)
