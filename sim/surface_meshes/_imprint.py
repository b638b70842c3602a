"""The coat where a rigid body of any shape is pressed in, the height of triangles over the pad, and height maps.

A geometric imprint, no mechanical solution: the body's shape, rounded at its rim, and a bulge around it that keeps the
volume of the gel. For a ball and a cylinder it is the analytic press of :mod:`sim.surface_meshes`.

Everyday objects as such bodies: chip, pecan, edge of a tape, spoon's handle, broccoli, can. They stand for what the
paper's fingers grasp. The paper gives no sizes; those here are usual ones, assumed. Only the side that touches matters
to a rigid indenter: each body is a height over an outline, closed by a cone on its far side. It looks along -y; depths
count from where it first touches the pad.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from data_schemas import SimulateError
from data_schemas.storage import parse_in_child, read_bytes, read_npy
from sim.surface_meshes._finger_shape import BLEND_MM, SMALLEST_BULGE_MEAN
from sim.surface_meshes._solid import stl_bytes

Floats = NDArray[np.float64]

# cells that a triangle's edge runs through belong to it: rounding of a share of a cell
_ON_EDGE = 1e-9
_MOST_PAIRS = 20_000_000


def height_over_pad_mm(corners_mm: Floats, x_mm: Floats, z_mm: Floats, side: Literal["lowest", "highest"]) -> Floats:
    """Return the lowest or highest y of triangles over each place of the pad, NaN where there is none.

    Parameters
    ----------
    corners_mm
        Corners of the triangles in the axes of the pad, shape (n, 3, 3).
    x_mm, z_mm
        Places across (nx,) and along (nz,) the pad, evenly spaced.
    side
        Which of several heights over one place counts.

    Returns
    -------
    array
        Shape (nx, nz).

    Raises
    ------
    SimulateError
        When the triangles cover so many places together that they cannot be drawn.
    """
    x, z = corners_mm[:, :, 0], corners_mm[:, :, 2]
    first_x, last_x = _covered(x, x_mm)
    first_z, last_z = _covered(z, z_mm)
    along = np.maximum(last_z - first_z, 0)
    count = np.maximum(last_x - first_x, 0) * along
    if count.sum() > _MOST_PAIRS:
        raise SimulateError(
            f"a mesh of {len(corners_mm)} triangles covers the pad {count.sum() / (x_mm.size * z_mm.size):.0f} times, "
            "which is too often; give a mesh with fewer layers or larger triangles"
        )
    owner = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    i, j = first_x[owner] + within // along[owner], first_z[owner] + within % along[owner]
    (x0, x1, x2), (z0, z1, z2) = x[owner].T, z[owner].T
    area = (x1 - x0) * (z2 - z0) - (x2 - x0) * (z1 - z0)
    flat = np.where(area == 0.0, 1.0, area)
    b = ((x_mm[i] - x0) * (z2 - z0) - (x2 - x0) * (z_mm[j] - z0)) / flat
    c = ((x1 - x0) * (z_mm[j] - z0) - (x_mm[i] - x0) * (z1 - z0)) / flat
    inside = (area != 0.0) & (b >= -_ON_EDGE) & (c >= -_ON_EDGE) & (b + c <= 1.0 + _ON_EDGE)
    y0, y1, y2 = corners_mm[owner[inside], :, 1].T
    y = y0 + b[inside] * (y1 - y0) + c[inside] * (y2 - y0)
    height = np.full((x_mm.size, z_mm.size), np.inf if side == "lowest" else -np.inf)
    (np.minimum if side == "lowest" else np.maximum).at(height, (i[inside], j[inside]), y)
    return np.where(np.isfinite(height), height, np.nan)


def _covered(values: Floats, grid: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first place of a grid in the range of each row of values, and that after the last."""
    step = (grid[-1] - grid[0]) / (grid.size - 1)
    low, high = (values.min(axis=1) - grid[0]) / step, (values.max(axis=1) - grid[0]) / step
    first = np.clip(np.ceil(low - _ON_EDGE), 0, grid.size).astype(np.int64)
    return first, np.clip(np.floor(high + _ON_EDGE) + 1, 0, grid.size).astype(np.int64)


def imprinted_height_mm(rest_mm: Floats, tool_mm: Floats, x_mm: Floats, z_mm: Floats, thickness_mm: float) -> Floats:
    """Return the height of the coat with a rigid body in it.

    Smooth minimum of the coat and the body, plus B (s/l)^2 exp(-s/l) outside the contact, where s is the distance from
    its rim, l half the thickness, and B makes the net volume zero: the gel is incompressible.

    Parameters
    ----------
    rest_mm
        Height of the undeformed coat, shape (nx, nz).
    tool_mm
        Lowest height of the body, NaN where there is none.
    x_mm, z_mm
        Places across (nx,) and along (nz,), evenly spaced.
    thickness_mm
        Of the pad, at its crown.

    Raises
    ------
    SimulateError
        When the contact leaves no free face beside it for the displaced volume.
    """
    touched = np.nan_to_num(tool_mm, nan=np.inf) < rest_mm
    if not touched.any():
        return rest_mm.copy()
    tool = np.where(np.isnan(tool_mm), np.inf, tool_mm)
    dented = -BLEND_MM * np.logaddexp(-rest_mm / BLEND_MM, -tool / BLEND_MM)
    steps = [float(grid[1] - grid[0]) for grid in (x_mm, z_mm)]
    s = distance_transform_edt(~touched, sampling=steps) / (thickness_mm / 2.0)
    bulge = s**2 * np.exp(-s)
    mean = _mean(bulge)
    if mean < SMALLEST_BULGE_MEAN:
        raise SimulateError(
            "the indenter covers the pad from end to end and leaves no free face for the gel that it displaces; make "
            "the press shallower or the indenter smaller"
        )
    return np.asarray(dented + _mean(rest_mm - dented) / mean * bulge)


def _mean(values: Floats) -> float:
    """Return the mean over an evenly spaced grid by the trapezoid rule."""
    inner = np.trapezoid(np.trapezoid(values, axis=1), axis=0)
    return float(inner / ((values.shape[0] - 1) * (values.shape[1] - 1)))


_LARGEST_PICTURE_BYTES = 64 << 20


def read_height_map(path: Path) -> Floats:
    """Return the numbers of a height map as they are stored, (rows, columns): NPY, or a grey PNG of 8 or 16 bit.

    Raises
    ------
    SimulateError
        It cannot be read, or holds no finite numbers in rows and columns.
    """
    if path.suffix.lower() == ".npy":
        values = np.asarray(read_npy(path, "a height map (surface.file, NPY)", SimulateError), dtype=np.float64)
    else:
        content = read_bytes(path, "a height map (surface.file, PNG)", SimulateError, _LARGEST_PICTURE_BYTES)
        _, arrays = parse_in_child(f"{__name__}:grey_picture", content, path, "a PNG picture", SimulateError)
        values = np.asarray(arrays["picture"], dtype=np.float64)
    if values.ndim != 2 or min(values.shape) < 2 or not np.isfinite(values).all():
        raise SimulateError(
            f"{path}: a height map must contain finite numbers in at least 2 rows and 2 columns, got shape "
            f"{values.shape}"
        )
    return values


def grey_picture(content: bytes, where: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the grey levels of a PNG; it runs in a child process.

    Raises
    ------
    SimulateError
        It is no PNG, or a coloured one.
    """
    import cv2

    picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None or picture.ndim != 2:
        held = "cannot be decoded" if picture is None else f"holds {picture.shape[2]} channels"
        raise SimulateError(f"{where}: {held}, but a height map must be a grey PNG of 8 or 16 bit")
    return {}, {"picture": picture}


Height = Callable[[Floats, Floats], Floats]

_AROUND: Final = 128
_RINGS: Final = 40
_ABOVE_MM: Final = 5.0
_GOLDEN_ANGLE: Final = np.pi * (3.0 - 5.0**0.5)


def everyday_objects() -> dict[str, bytes]:
    """Return the objects by the names of their files, as binary STL in mm; the same bytes each time."""
    outlines: Mapping[str, tuple[str, Floats, Height]] = {
        "chip": ("saddle, radii 55 and 90 mm", _ellipse(22.0, 30.0), _saddle(55.0, 90.0)),
        "pecan": ("half axes 9, 9 and 17 mm, furrows of 0.3 mm", _ellipse(8.9, 16.8), _furrowed((9.0, 9.0, 17.0), 0.3)),
        "tape-edge": ("edge 12 mm long and 2 mm thick", _rectangle(6.0, 0.99), _cylinder(1.0)),
        "spoon-handle": ("oval of 9 x 5 mm, turned by 25 deg", _turned(_rectangle(45.0, 4.45)), _oval(4.5, 2.5)),
        "broccoli": ("buds of 3.5 mm radius on a dome of 24 mm", _ellipse(19.0, 19.0), _buds(24.0, 3.5)),
        "can": ("diameter 66 mm", _rectangle(32.0, 24.0), _cylinder(33.0)),
    }
    return {
        f"{name}.stl": _body(outline, height, f"{name}: {what}") for name, (what, outline, height) in outlines.items()
    }


def _body(outline: Floats, height_mm: Height, title: str) -> bytes:
    """Close a height (x, z) over an outline (n, 2), star-shaped about 0, that runs from +x to +z."""
    shares = np.sin(np.linspace(np.pi / 2.0, 0.0, _RINGS, endpoint=False))  # close together where sides are steep
    places = np.concatenate([outline * share for share in shares] + [np.zeros((1, 2))])
    low = height_mm(places[:, 0], places[:, 1])
    top = [0.0, float(low.max()) + _ABOVE_MM, 0.0]
    vertices = np.vstack([np.column_stack([places[:, 0], low, places[:, 1]]), top])
    here, count = np.arange(len(outline)), len(outline)
    following = np.roll(here, -1)
    middle, apex = len(vertices) - 2, len(vertices) - 1
    triangles = [np.column_stack([here, np.full(count, apex), following])]
    for k in range(_RINGS - 1):
        a, b, c, d = k * count + here, k * count + following, (k + 1) * count + following, (k + 1) * count + here
        triangles += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    last = (_RINGS - 1) * count
    triangles.append(np.column_stack([last + here, last + following, np.full(count, middle)]))
    return stl_bytes(np.concatenate(triangles).astype(np.int64), vertices, title)


def _ellipse(half_x_mm: float, half_z_mm: float) -> Floats:
    angle = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    return np.column_stack([half_x_mm * np.cos(angle), half_z_mm * np.sin(angle)])


def _rectangle(half_x_mm: float, half_z_mm: float) -> Floats:
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]]) * [half_x_mm, half_z_mm]
    share = (np.arange(_AROUND // 4) / (_AROUND // 4))[:, None]
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])


_TURN: Final = np.radians(25.0)
_INTO_PLACE: Final = np.array([[np.cos(_TURN), np.sin(_TURN)], [-np.sin(_TURN), np.cos(_TURN)]])


def _turned(outline: Floats) -> Floats:
    return np.asarray(outline @ _INTO_PLACE)


def _saddle(along_mm: float, across_mm: float) -> Height:
    """Return z^2 / 2R - x^2 / 2S: it stands on the pad's side edges first."""
    return lambda x, z: z**2 / (2.0 * along_mm) - x**2 / (2.0 * across_mm)


def _cylinder(radius_mm: float) -> Height:
    """Return a cylinder whose axis lies across the pad."""
    return lambda x, z: radius_mm - np.sqrt(radius_mm**2 - z**2)


def _oval(half_width_mm: float, half_height_mm: float) -> Height:
    """Return half an oval bar along the turned x axis."""

    def height_mm(x: Floats, z: Floats) -> Floats:
        off = (np.column_stack([x, z]) @ _INTO_PLACE.T)[:, 1] / half_width_mm
        return np.asarray(half_height_mm * (1.0 - np.sqrt(1.0 - off**2)))

    return height_mm


def _furrowed(half_axes_mm: tuple[float, float, float], depth_mm: float) -> Height:
    """Return the lower half of an ellipsoid with furrows along it; a ridge is lowest."""
    a, b, c = half_axes_mm

    def height_mm(x: Floats, z: Floats) -> Floats:
        inside = 1.0 - (x / a) ** 2 - (z / c) ** 2
        round_it = np.arcsin(np.clip(x / (a * np.sqrt(np.maximum(1.0 - (z / c) ** 2, 1e-12))), -1.0, 1.0))
        return np.asarray(b * (1.0 - np.sqrt(inside)) + depth_mm * np.sin(5.0 * round_it) ** 2)

    return height_mm


def _buds(dome_mm: float, bud_mm: float) -> Height:
    """Return the lower envelope of balls that sit on a dome as seeds do on a sunflower."""
    number = np.arange(60)
    reach = 0.86 * bud_mm * np.sqrt(number)  # neighbours overlap
    number, reach = number[reach < 0.85 * dome_mm], reach[reach < 0.85 * dome_mm]
    x, z = reach * np.cos(_GOLDEN_ANGLE * number), reach * np.sin(_GOLDEN_ANGLE * number)
    y = dome_mm - np.sqrt(dome_mm**2 - reach**2)

    def height_mm(at_x: Floats, at_z: Floats) -> Floats:
        squared = bud_mm**2 - (at_x[:, None] - x) ** 2 - (at_z[:, None] - z) ** 2
        lowest = np.where(squared > 0.0, y - np.sqrt(np.maximum(squared, 0.0)), np.inf).min(axis=1)
        between = dome_mm - np.sqrt(dome_mm**2 - at_x**2 - at_z**2) - 0.4 * bud_mm
        return np.asarray(np.minimum(lowest, between) + bud_mm)

    return height_mm
