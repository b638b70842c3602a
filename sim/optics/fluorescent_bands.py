"""Level c in bands: path-wise fluorescence in an rgb variant, one 3 x 3 throughput per path.

A path seen from the eye carries T (bands out, bands in). At ordinary surfaces T <- T diag(w), at paint T <- T M with
M = diag(reflectance) + K, and light L adds T L. Nothing is chosen by chance at paint, so one path serves every
conversion of bands, of every order.
Import this module after an ``*_ad_rgb`` variant has been set (see :mod:`sim.optics.variants`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.optics.fluorescent_paths import PanelLight, fluorescent_integrator, painted_bsdfs
from sim.optics.lookup_tables import LookupTable
from sim.optics.path_rules import MAX_DEPTH, ROULETTE_DEPTH
from sim.optics.variants import check_variant

# a matrix from measured tables may exceed energy balance by rounding only
_ENERGY_TOLERANCE = 1e-9


class BandCarrier:
    """Three rows of throughput: how much of each band's light reaches the red, green and LED band of the image."""

    def __init__(self, matrices: Sequence[NDArray[np.float64]]) -> None:
        rows = np.array(matrices, dtype=np.float64).reshape(-1, 3)
        self.columns = [LookupTable(rows[:, k : k + 1], mi) for k in range(3)]

    def start(self) -> list[Any]:
        """Return the unit matrix."""
        return [mi.Color3f(1, 0, 0), mi.Color3f(0, 1, 0), mi.Color3f(0, 0, 1)]

    def received(self, carried: list[Any], light: Any) -> Any:
        """Return T L."""
        return mi.Color3f(*[dr.dot(row, light) for row in carried])

    def scattered(self, carried: list[Any], weight: Any) -> list[Any]:
        """Return T diag(weight)."""
        return [row * weight for row in carried]

    def reradiated(self, carried: list[Any], si: Any, sampler: Any, paint: Any, painted: Any) -> list[Any]:
        """Return T M of the paint."""
        matrix = [mi.Color3f(*[column.row(3 * paint + k, painted) for column in self.columns]) for k in range(3)]
        changed = [row.x * matrix[0] + row.y * matrix[1] + row.z * matrix[2] for row in carried]
        return [dr.select(painted, new, old) for new, old in zip(changed, carried, strict=True)]

    def largest(self, carried: list[Any]) -> Any:
        """Return the largest entry of T."""
        return dr.maximum(dr.maximum(dr.max(carried[0]), dr.max(carried[1])), dr.max(carried[2]))

    def panel_light(self, si: Any, radiance: Any) -> Any:
        """Return light of the third band."""
        return mi.Color3f(0, 0, radiance)


def fluorescent_bands(
    scene: Any,
    matrices: Mapping[str, NDArray[np.float64]],
    max_depth: int = MAX_DEPTH,
    roulette_depth: int = ROULETTE_DEPTH,
    panels: PanelLight | None = None,
) -> Any:
    """Return the integrator of path-wise fluorescence in three bands.

    Parameters
    ----------
    scene
        Scene of an rgb variant whose three channels are the bands.
    matrices
        By id of the painted surfaces or of their BSDF: M[band out, band in], shape (3, 3), reflectance and
        reradiation together; it replaces the reflectance of that BSDF. Empty for a scene without paint.
    max_depth, roulette_depth
        Longest path, and from where on paths end by chance.
    panels
        LED panels of a finger, connected through its inner face, see :func:`fluorescent_integrator`.

    Raises
    ------
    SimulateError
        When a matrix is no 3 x 3 matrix, is negative or gains energy (a column that sums to more than 1), when the
        variant is not an rgb variant, or when no surface has one of the ids.
    """
    check_variant("rgb", "three bands")
    for name, matrix in matrices.items():
        if np.shape(matrix) != (3, 3) or not np.isfinite(matrix).all() or (matrix < 0.0).any():
            raise SimulateError(f"paint {name}: the band matrix must be 3 x 3 numbers >= 0, got {matrix}")
        gain = float(matrix.sum(axis=0).max())
        if gain > 1.0 + _ENERGY_TOLERANCE:
            raise SimulateError(f"paint {name} returns {gain:.3f} of the energy of one band; a column may sum to 1")
    paints = painted_bsdfs(scene, list(matrices))
    carrier = BandCarrier(list(matrices.values()) or [np.eye(3)])
    return fluorescent_integrator(carrier, paints, max_depth, roulette_depth, panels)
