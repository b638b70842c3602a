"""Everyday objects as closed bodies for a press: chip, pecan, edge of a tape, spoon's handle, broccoli, can.

They stand for what the paper's fingers grasp. The paper gives no sizes; those here are usual ones, assumed. Only the
side that touches matters to a rigid indenter: each body is a height over an outline, closed by a cone on its far side.
It looks along -y; depths count from where it first touches the pad.
"""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sim.surface_meshes import stl_bytes

Floats = NDArray[np.float64]
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
