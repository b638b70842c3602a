"""What paths do where they meet a painted wall: note the texels for later, or take up the light that it sends.

Import this module only after a compiled variant has been set (see :mod:`sim.optics.variants`).
"""

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from sim.optics.lookup_tables import LookupTable, Tally, cell_at
from sim.optics.wall_emission import TEXELS_ALONG, TEXELS_UP

Floats = NDArray[np.float64]


def first_texel(si: Any, is_green: Any) -> tuple[Any, Any, Any]:
    """Return number, and share of the way up and along to the next ones, of the texel below and before wall points.

    Texels of the red wall come first, then those of the green one, (along, up) each.
    """
    x = dr.clip(si.uv.x * TEXELS_UP - 0.5, 0.0, TEXELS_UP - 1.0)
    y = dr.clip(si.uv.y * TEXELS_ALONG - 0.5, 0.0, TEXELS_ALONG - 1.0)
    i, j = cell_at(x, TEXELS_UP - 1), cell_at(y, TEXELS_ALONG - 1)
    first = (dr.select(is_green, mi.UInt32(TEXELS_ALONG), mi.UInt32(0)) + j) * TEXELS_UP + i
    return first, x - mi.Float(i), y - mi.Float(j)


class WallTexels:
    """Adds up, per group, what paths carry to the texels of the walls, and what the panels keep away from them."""

    def __init__(self, by_wall: Tally, kept_away: Tally, group: Any, count: int) -> None:
        self.by_wall, self.kept_away, self.group, self.count = by_wall, kept_away, group, count

    def met(self, si: Any, is_green: Any, throughput: Any, free: Sequence[Any], active: Any) -> None:
        """Note that paths have met a wall; they are free for some angles."""
        carried = dr.select(is_green, throughput.y, throughput.x)
        _note_wall(self.by_wall, si, self.group, is_green, carried, active)
        for k in range(self.count):
            _note_wall(self.kept_away, si, self.group * self.count + k, is_green, carried, active & ~free[k])


class WallGlow:
    """Adds up what known walls send along each path: radiance (path, angle, 2)."""

    def __init__(self, emitted: Floats, paths: int) -> None:
        self.count = len(emitted)
        self.texels = LookupTable(emitted.reshape(-1, 1), mi)
        self.radiance = Tally(paths * self.count * 2, mi)
        self.path = dr.arange(mi.UInt32, paths)

    def met(self, si: Any, is_green: Any, throughput: Any, free: Sequence[Any], active: Any) -> None:
        """Add the emission where paths have met a wall, as :meth:`BandPaths.wall_radiance` reads it."""
        carried = dr.select(is_green, throughput.y, throughput.x)
        around = _texels_around(si, mi.UInt32(0), is_green)
        per_angle = 2 * TEXELS_ALONG * TEXELS_UP
        for k in range(self.count):
            here = active & free[k]
            glow = mi.Float(0)
            for weight, texel in around:
                glow += weight * self.texels.row(texel + k * per_angle, here)
            band = (self.path * self.count + k) * 2 + dr.select(is_green, mi.UInt32(1), mi.UInt32(0))
            self.radiance.add(carried * glow, band, here)


def _note_wall(by_wall: Tally, si: Any, group: Any, is_green: Any, carried: Any, active: Any) -> None:
    """Add what a path carries to the texels around a wall point, as :meth:`BandPaths.wall_radiance` reads them."""
    for weight, texel in _texels_around(si, group, is_green):
        by_wall.add(carried * weight, texel, active)


def _texels_around(si: Any, group: Any, is_green: Any) -> list[tuple[Any, Any]]:
    """Return weight and index of the four texels around a wall point."""
    first, s, t = first_texel(si, is_green)
    first += group * (2 * TEXELS_ALONG * TEXELS_UP)
    return [
        (along * up, first + (b * TEXELS_UP + a))
        for b, along in ((0, 1.0 - t), (1, t))
        for a, up in ((0, 1.0 - s), (1, s))
    ]
