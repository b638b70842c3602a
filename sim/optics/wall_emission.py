"""Light that the painted walls emit, per chain of fluorescence: excited by the LED, or by what other paint emitted.

A chain names the way of the energy: "led>red" is LED light turned into red emission at the red wall,
"led>green>red" green emission of the green wall turned into red emission at the red wall.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.optical_design import LightPanel
from sim.optics.curved_refraction import curved_irradiance
from sim.optics.gel_face import inner_face
from sim.optics.paint_bands import BAND_NAMES, PaintBands
from sim.optics.position_map import PositionMap
from sim.surface_meshes.finger_shape import FingerShape

Level = Literal["a", "a_inverse_square", "b"]
"""b: baked; a: emitter proportional to the distance from the blue light, as printed; a_inverse_square: 1/d^2."""

LEVEL_NAMES: dict[Level, str] = {
    "a": "level a (paper's emitter)",
    "a_inverse_square": "level a (paper's emitter, inverse square)",
    "b": "level b",
}

WallLight = Mapping[str, NDArray[np.float64]]
"""Per chain of fluorescence: radiance of the wall at its end, (TEXELS_ALONG, TEXELS_UP), in units of the panel's."""

FIRST_CHAINS = ("led>red", "led>green", "led")
"""The chains of first order, in the order of the bands."""

TEXELS_ALONG, TEXELS_UP = 70, 8
# a texture that is black everywhere turns the stock tracer's emitter sampling into 0 / 0
SMALLEST_RADIANCE_REL = 1e-12
WALLS = ("red", "green")
# feet of the walls' points on the inner face, as its coordinate across
_FOOT_ACROSS = {"red": 0.0, "green": 1.0}
# the panel is at least its own height away from any wall: these points resolve it to parts in ten thousand
_PANEL_QUADRATURE = (12, 4)


def last_band(chain: str) -> str:
    """Return the band in which a chain's light is, "red", "green" or "led"; also the name of its last wall."""
    return chain.rsplit(">", 1)[-1]


def excited(
    chain: str, irradiance: Mapping[str, NDArray[np.float64]], bands: PaintBands
) -> dict[str, NDArray[np.float64]]:
    """Return what the light of a chain makes the walls emit, L = K E / pi in each paint's own band.

    Parameters
    ----------
    chain
        The chain whose light falls onto the walls.
    irradiance
        Irradiance of the walls "red" and "green" by that light, any shape.
    bands
        Energy conversion of the paints.
    """
    column = BAND_NAMES.index(last_band(chain))
    return {f"{chain}>{wall}": np.asarray(bands.conversion[wall][column] / np.pi * irradiance[wall]) for wall in WALLS}


def paper_emission(design: FingerDesign, shape: FingerShape, light: WallLight, level: Level) -> WallLight:
    """Return the emission of the walls by the rule of the paper, with the mean of a baked one.

    Intensity follows the distance from the panel's centre alone: proportional to it as printed, or to its inverse
    square. It knows nothing of the panel's angle beyond the gain; only the chains of first order remain.
    """
    emission = {}
    for wall in WALLS:
        points = wall_map(shape, wall).positions_mm(texel_uv())
        distance = np.linalg.norm(points - np.array(design.light.position_mm), axis=-1)
        rule = distance if level == "a" else distance**-2
        emission[f"led>{wall}"] = rule * light[f"led>{wall}"].mean() / rule.mean()
    return emission


def unbaked_walls() -> dict[str, NDArray[np.float64]]:
    """Return faint uniform emission (TEXELS_ALONG, TEXELS_UP, 3 bands) per wall, a place for a bake to be put."""
    emission = {wall: np.zeros((TEXELS_ALONG, TEXELS_UP, len(BAND_NAMES))) for wall in WALLS}
    for wall in WALLS:
        emission[wall][..., BAND_NAMES.index(wall)] = SMALLEST_RADIANCE_REL
    return emission


def direct_irradiance(
    design: FingerDesign, shape: FingerShape, wall: str, uv: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the direct irradiance of all panels at points of a wall, in units of the first panel's radiance.

    By quadrature over the panels through the inner face, whatever its shape; see
    :func:`sim.optics.curved_refraction.curved_irradiance`. Valid while the coating does not shade the wall.

    Parameters
    ----------
    design, shape
        Panels and surfaces.
    wall
        "red" or "green".
    uv
        Texture coordinates (u up the wall, v along), shape (..., 2).
    """
    return sum(direct_irradiances(design, shape, wall, uv, design.lights), np.zeros(uv.shape[:-1]))


def direct_irradiances(
    design: FingerDesign, shape: FingerShape, wall: str, uv: NDArray[np.float64], lights: Sequence[LightPanel]
) -> list[NDArray[np.float64]]:
    """Return the same for each of several panels alone, which need not be those of the design."""
    where, face = wall_map(shape, wall), inner_face(design, shape)
    points, inward = where.positions_mm(uv).reshape(-1, 3), -where.normals(uv).reshape(-1, 3)
    foot = np.stack([np.full(uv.shape[:-1], _FOOT_ACROSS[wall]), uv[..., 1]], axis=-1).reshape(-1, 2)
    return [
        light.power_rel * curved_irradiance(points, inward, foot, light, face, _PANEL_QUADRATURE).reshape(uv.shape[:-1])
        for light in lights
    ]


def wall_map(shape: FingerShape, wall: str) -> PositionMap:
    """Return where a wall is; its normals point out of the gel."""
    return PositionMap.of(shape.surfaces[wall], f"{wall} wall")


def texel_uv() -> NDArray[np.float64]:
    """Return the texture coordinates (up, along) of the texel centres, shape (TEXELS_ALONG, TEXELS_UP, 2)."""
    return grid_uv(TEXELS_ALONG, TEXELS_UP)


def grid_uv(along: int, up: int) -> NDArray[np.float64]:
    """Return texture coordinates (up, along) at the centres of a regular grid, shape (along, up, 2)."""
    v, u = np.meshgrid((np.arange(along) + 0.5) / along, (np.arange(up) + 0.5) / up, indexing="ij")
    return np.stack([u, v], axis=-1)
