"""Light that the painted walls emit: baked from the panel (level b) or by the rule of the paper (level a)."""

from collections.abc import Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.optics.paint_bands import PaintBands
from sim.optics.pressed_pad import pressed_profile
from sim.optics.refracted_light import refracted_irradiance
from sim.optics.scene import PANEL_RADIANCE_REL

Level = Literal["a", "a_inverse_square", "b"]
"""b: baked; a: emitter proportional to the distance from the blue light, as printed; a_inverse_square: 1/d^2."""

LEVEL_NAMES: dict[Level, str] = {
    "a": "level a (paper's emitter)",
    "a_inverse_square": "level a (paper's emitter, inverse square)",
    "b": "level b",
}

TEXELS_ALONG, TEXELS_UP = 70, 8
# the panel is at least its own height away from any wall: these points resolve it to parts in ten thousand
_PANEL_QUADRATURE = (12, 4)
# a texture that is black everywhere turns the stock tracer's emitter sampling into 0 / 0
_SMALLEST_RADIANCE_REL = 1e-12
WALL_SIDES = {"red": -1.0, "green": 1.0}
_BAND_OF_PAINT = {"red": 0, "green": 1}


def wall_emission(
    design: FingerDesign,
    bands: PaintBands,
    level: Level = "b",
    indirect: Mapping[str, NDArray[np.float64]] | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Return the radiance emitted by the walls "red" and "green", in units of the panel's radiance.

    Level b: L = K E / pi in the paint's own band; E is the panel's direct irradiance through the flat inner face
    plus `indirect`. It follows position and angle of the panel. Left out: emission excited by the other paint.
    Level a: the paper's texture, intensity following the distance from the panel's centre alone, with the gain
    that gives level b's mean; it knows nothing of the panel's angle beyond that gain.

    Parameters
    ----------
    design
        Finger with its press and light angle.
    bands
        Energy conversion of the two paints.
    level
        Which rule.
    indirect
        Irradiance of each wall by mirror, coating, other wall and ends, shape (TEXELS_ALONG, TEXELS_UP), from
        :func:`sim.optics.wall_baking.indirect_irradiance`; none by default (a one-bounce bake).

    Returns
    -------
    dict
        Arrays of shape (TEXELS_ALONG, TEXELS_UP, 3 bands) at texel centres.
    """
    emission = {}
    for wall, side in WALL_SIDES.items():
        points = wall_points_mm(design, wall)
        irradiance = direct_irradiance(design, points.reshape(-1, 3), side).reshape(points.shape[:2])
        if indirect is not None:
            irradiance = irradiance + indirect[wall]
        profile = bands.energy_conversion[wall] / np.pi * irradiance
        if level != "b":
            distance = np.linalg.norm(points - np.array(design.light.position_mm), axis=-1)
            shape = distance if level == "a" else distance**-2
            profile = shape * profile.mean() / shape.mean()
        emission[wall] = np.zeros((*profile.shape, 3))
        emission[wall][..., _BAND_OF_PAINT[wall]] = np.maximum(profile, _SMALLEST_RADIANCE_REL)
    return emission


def unbaked_emission() -> dict[str, NDArray[np.float64]]:
    """Return faint uniform walls, to be replaced by a bake."""
    emission = {wall: np.zeros((TEXELS_ALONG, TEXELS_UP, 3)) for wall in WALL_SIDES}
    for wall, band in _BAND_OF_PAINT.items():
        emission[wall][..., band] = _SMALLEST_RADIANCE_REL
    return emission


def direct_irradiance(design: FingerDesign, points_mm: NDArray[np.float64], side: float) -> NDArray[np.float64]:
    """Return the panel's direct irradiance at points (n, 3) of the wall at `side` (-1 red, +1 green) of the pad."""
    normals = np.broadcast_to([-side, 0.0, 0.0], points_mm.shape)
    return PANEL_RADIANCE_REL * refracted_irradiance(points_mm, normals, design.light, design.pad, _PANEL_QUADRATURE)


def wall_points_mm(design: FingerDesign, wall: str) -> NDArray[np.float64]:
    """Return the points of a wall's texel centres, shape (TEXELS_ALONG, TEXELS_UP, 3)."""
    z = (np.arange(TEXELS_ALONG) + 0.5) / TEXELS_ALONG * design.pad.length_mm
    up = (np.arange(TEXELS_UP) + 0.5) / TEXELS_UP
    y = up[None, :] * pressed_profile(design, z)[:, None]
    x = WALL_SIDES[wall] * design.pad.width_mm / 2.0
    return np.stack(np.broadcast_arrays(x, y, z[:, None]), axis=-1)
