"""What the tactile camera sees of the pad: how much of it, how finely, and what else is in the picture."""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.optics.opencv_file import read_calibration
from sim.optics.pixel_maps import PixelMaps, pixel_maps
from sim.surface_meshes.finger_shape import rest_shape

Floats = NDArray[np.float64]
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
        return "\n".join(
            (
                f"{self.design.name}: the camera sees {self.coat_share:.0%} of the coat through the mirror",
                f"  along the pad   z = {z_low:.1f} to {z_high:.1f} mm of 0 to {pad.length_mm:g} mm, "
                f"{_range(self.px_per_mm_along)} px/mm",
                f"  across the pad  x = {x_low:.1f} to {x_high:.1f} mm of {-half:g} to {half:g} mm, "
                f"{_range(self.px_per_mm_across)} px/mm",
                f"  of the picture  coat {self.picture_share('coat'):.0%}, red wall {walls[0]:.1%}, green wall "
                f"{walls[1]:.1%}",
            )
        )


def camera_view(design: FingerDesign, folder: Path, renderer: ModuleType) -> CameraView:
    """Return what the camera of a design sees of the undeformed finger.

    Parameters
    ----------
    design
        The finger.
    folder
        Where a relative path of camera.calibration starts.
    renderer
        From :func:`sim.optics.variants.open_renderer`.

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
    share = float(np.nansum(area_mm2)) / (design.pad.length_mm * design.pad.width_mm)
    return CameraView(design, maps, share, along, across)


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
