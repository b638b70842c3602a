"""Light between the painted walls as matrix products: for many lights of one finger, whose walls are traced once."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.optical_design import LightPanel
from sim.optics.paint_bands import BAND_NAMES, PaintBands
from sim.optics.wall_baking import HIGHEST_ORDER, polynomial_basis
from sim.optics.wall_emission import TEXELS_ALONG, TEXELS_UP, WALLS, direct_irradiances, texel_uv
from sim.optics.wall_rays import POINTS_ALONG, POINTS_UP, rays_from_walls
from sim.surface_meshes.finger_shape import FingerShape

Floats = NDArray[np.float64]


class WallsMet(Protocol):
    """Mean over the rays of each group: LED radiance (group, light), per texel of a wall (group, light, wall, ...)."""

    @property
    def led(self) -> Floats:
        """Radiance of the LED."""

    @property
    def by_wall(self) -> Floats:
        """Radiance per radiance that a texel emits."""


class WallTracer(Protocol):
    """What traces rays for all lights, see :class:`sim.optics.angle_paths.AnglePaths`."""

    def trace(self, origins_mm: Floats, directions: Floats, per_group: int, seed: int, from_wall: bool) -> WallsMet:
        """Return what groups of rays have met."""


@dataclass(frozen=True, slots=True)
class WallExchange:
    """Light that reaches the walls, as coefficients of a polynomial over the receiving wall.

    Attributes
    ----------
    led
        Irradiance by the LED but for its direct light, (wall, coefficient, light), in units of the panel's radiance.
    exchange
        Irradiance per radiance that a texel emits, (wall, coefficient, light, emitting wall, TEXELS_ALONG, TEXELS_UP):
        the panel of the light keeps some of it away.
    """

    led: Floats
    exchange: Floats

    @classmethod
    def traced(cls, tracer: WallTracer, shape: FingerShape, samples: int, rng: np.random.Generator) -> "WallExchange":
        """Trace this many paths from each wall."""
        points = POINTS_ALONG * POINTS_UP
        per_point = max(1, round(samples / points))
        rays = rays_from_walls(shape, per_point, rng)
        met = tracer.trace(*rays, per_point, int(rng.integers(2**32)), from_wall=True)
        fit = np.pi * np.linalg.pinv(polynomial_basis(POINTS_ALONG, POINTS_UP))
        led = np.einsum("cp,wpl->wcl", fit, met.led.reshape(len(WALLS), points, -1))
        by_wall = met.by_wall.reshape(len(WALLS), points, -1)
        exchange = np.einsum("cp,wpt->wct", fit, by_wall, optimize=True)
        return cls(led, exchange.reshape(len(WALLS), len(fit), -1, len(WALLS), TEXELS_ALONG, TEXELS_UP))

    def emitted(self, light: int, direct: Floats, bands: PaintBands) -> Floats:
        """Return the radiance of the walls in their own bands, all orders of fluorescence together.

        L = sum over orders of K E / pi, E by the LED at first and then by what the walls have emitted.

        Parameters
        ----------
        light
            Number of the light.
        direct
            Its direct irradiance of the walls, (wall, TEXELS_ALONG, TEXELS_UP).
        bands
            Energy conversion of the paints.

        Returns
        -------
        array
            (wall, TEXELS_ALONG, TEXELS_UP), in units of the panel's radiance.
        """
        conversion = np.array([bands.conversion[wall] for wall in WALLS]) / np.pi
        irradiance = direct + _over_texels(self.led[..., light])
        latest = conversion[:, BAND_NAMES.index("led"), None, None] * irradiance
        total = latest
        of_band = conversion[:, [BAND_NAMES.index(wall) for wall in WALLS]]
        for _ in range(2, HIGHEST_ORDER + 1):
            received = np.einsum("wcvij,vij->vwc", self.exchange[:, :, light], latest, optimize=True)
            latest = np.einsum("wv,vwij->wij", of_band, _over_texels(received))
            total = total + latest
        return total


def direct_lights(design: FingerDesign, shape: FingerShape, lights: Sequence[LightPanel]) -> list[Floats]:
    """Return the walls' direct irradiance, (wall, TEXELS_ALONG, TEXELS_UP), by each light with the further ones."""
    of_walls = []
    for wall in WALLS:
        found = direct_irradiances(design, shape, wall, texel_uv(), [*lights, *design.lights[1:]])
        further = sum(found[len(lights) :], np.zeros((TEXELS_ALONG, TEXELS_UP)))
        of_walls.append([one + further for one in found[: len(lights)]])
    return [np.stack(pair) for pair in zip(*of_walls, strict=True)]


def _over_texels(coefficients: Floats) -> Floats:
    """Return polynomials (..., coefficient) at the texel centres, not below zero."""
    values = coefficients @ polynomial_basis(TEXELS_ALONG, TEXELS_UP).T
    return np.asarray(np.maximum(values, 0.0).reshape(*coefficients.shape[:-1], TEXELS_ALONG, TEXELS_UP))
