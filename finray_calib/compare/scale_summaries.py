"""Scales at many places in a few numbers: at one place, as a range, over the board, and as a coarse map."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.pixel_scale import LocalScale, ScaleRange
from finray_calib.compare.board_corners import BoardView
from finray_calib.compare.lens_calibration import project
from finray_calib.compare.pixel_scale import ScaleDraws, SeenPlane, plane_scale, scales_only

Floats = NDArray[np.float64]

_MAP_COLUMNS, _MAP_ROWS = 33, 25
#: Where the map is known less well than this, pictures of the board did not reach: nothing is stated there.
_UNKNOWN_U_REL = 0.1
_OVER_BOARD = 9


def local_scale(found: ScaleDraws, pixel: Floats) -> LocalScale:
    """Return the scale at the only place that was asked for, a pixel (2,)."""
    (x, y, mean), (u_x, u_y, u_mean) = found.mm_per_px[0], found.u_rel[0]
    return LocalScale(
        column_px=float(pixel[0]),
        row_px=float(pixel[1]),
        along_x_mm_per_px=float(x),
        along_y_mm_per_px=float(y),
        mean_mm_per_px=float(mean),
        along_x_u_rel=float(u_x),
        along_y_u_rel=float(u_y),
        mean_u_rel=float(u_mean),
    )


def scale_range(scales: Floats) -> ScaleRange:
    """Return the range of scales (N, 3), of which some are finite."""
    low, high = np.nanmin(scales, axis=0), np.nanmax(scales, axis=0)
    return ScaleRange(
        along_x_low_mm_per_px=float(low[0]),
        along_x_high_mm_per_px=float(high[0]),
        along_y_low_mm_per_px=float(low[1]),
        along_y_high_mm_per_px=float(high[1]),
    )


def range_over_board(plane: SeenPlane, pad: BoardView) -> ScaleRange:
    """Return the range over the part of the picture that the board covers."""
    share = np.linspace(0.0, 1.0, _OVER_BOARD)
    low, high = pad.places_mm.min(axis=0), pad.places_mm.max(axis=0)
    grid = np.stack(np.meshgrid(*(low[i] + share * (high[i] - low[i]) for i in (0, 1))), -1).reshape(-1, 2)
    pixels = project(plane.model, plane.lens, plane.pose, np.column_stack([grid, np.zeros(len(grid))]))[0]
    return scale_range(scales_only(plane, pixels))


def scale_map(plane: SeenPlane, size_px: tuple[int, int]) -> dict[str, Any]:
    """Return the fields of a record that hold a coarse map over the picture, NaN where the scale is not known."""
    columns, rows = (
        np.linspace(0.0, side - 1.0, count) for side, count in zip(size_px, (_MAP_COLUMNS, _MAP_ROWS), strict=True)
    )
    pixels = np.stack(np.meshgrid(columns, rows), -1).reshape(-1, 2)
    found = plane_scale(plane, pixels)
    unknown = ~(found.u_rel.max(axis=1) <= _UNKNOWN_U_REL)
    scales, u_rel = found.mm_per_px.copy(), found.u_rel.copy()
    scales[unknown], u_rel[unknown] = np.nan, np.nan
    shape = (len(rows), len(columns), 3)
    return {
        "map_columns_px": columns,
        "map_rows_px": rows,
        "map_mm_per_px": scales.reshape(shape),
        "map_u_rel": u_rel.reshape(shape),
    }
