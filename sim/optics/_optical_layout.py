"""Where light panels and camera stand: a panel is a rectangle in space, the camera a pinhole that faces the mirror."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, ImpossibleFingerError, LightPanel
from sim.surface_meshes import layout_scale, mirror_shape


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
    """Return the rectangle of a light panel: normal (sin b cos a, sin a, cos b cos a), angle a and azimuth b."""
    angle, azimuth = np.radians(light.angle_deg), np.radians(light.azimuth_deg)
    normal = np.array([np.sin(azimuth) * np.cos(angle), np.sin(angle), np.cos(azimuth) * np.cos(angle)])
    across = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
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
            raise ImpossibleFingerError(
                "the camera does not see the coated face; check camera.field_of_view_deg, the mirror and the panel's "
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
    mirror, aim = mirror_shape(design), np.radians(design.camera.aim_deg)
    through_mirror = np.array([np.cos(aim), np.sin(aim)])
    forward = through_mirror - 2.0 * (through_mirror @ mirror.normal_yz) * mirror.normal_yz
    rows, columns = design.camera.height_px // 2, design.camera.width_px // 2
    place = design.camera.position_mm
    tan_per_px = np.tan(np.radians(design.camera.field_of_view_deg) / 2.0) / np.hypot(rows, columns)
    return CameraPose(
        centre_mm=np.array(place if place is not None else [0.0, *(_CAMERA * layout_scale(design))]),
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
