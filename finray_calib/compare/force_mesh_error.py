"""How far the mesh may put a simulated force off: by the 70 x 35 finger's convergence, or by another mesh."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from data_schemas.press_mechanics import PressMechanics
from finray_calib.compare.force_curve import ForceCurve

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MeshError:
    """What the mesh may make a force wrong by.

    Attributes
    ----------
    excess_rel
        By how much the force exceeds that of an infinitely fine mesh.
    other
        Curve of another mesh, if there is one.
    source
        In words where it is known from; empty where nothing is known.
    """

    excess_rel: float
    other: ForceCurve | None
    source: str

    def at(self, depth: Floats, force: Floats) -> Floats:
        """Return the standard uncertainty, N, at pushes (n,) with the force that the press has there."""
        known = self.excess_rel / (1.0 + self.excess_rel) * force
        return known if self.other is None else np.maximum(known, np.abs(self.other.at(depth) - force))


def mesh_error(press: PressMechanics, other: PressMechanics | None) -> MeshError:
    """Return what is known of the error of a press's mesh, taken for its standard uncertainty.

    F e / (1 + e) with the force F and the excess e of the press's preset on the 70 x 35 finger; |F' - F| where the
    force F' on another mesh differs by more.

    Raises
    ------
    CompareError
        When the other press is of another design, or on the same preset.
    """
    sources = [] if press.mesh_excess_rel is None else ["the mesh's excess on the 70 x 35 finger"]
    curve = None if other is None else _curve_on_other_mesh(press, other)
    if curve is not None:
        sources.append("the other mesh's difference")
    return MeshError(press.mesh_excess_rel or 0.0, curve, " or ".join(sources))


def _curve_on_other_mesh(press: PressMechanics, other: PressMechanics) -> ForceCurve:
    """Return the curve of the same finger on another mesh."""
    own = press.design.model_dump(exclude={"mesh", "provenance", "uncertainty_rel"})
    if own != other.design.model_dump(exclude={"mesh", "provenance", "uncertainty_rel"}):
        raise CompareError(f"{other.name}: is a press of another design; give the same one on another mesh")
    if other.preset == press.preset:
        raise CompareError(f"{other.name}: is on the {other.preset} mesh too; give a press on another one")
    return ForceCurve(other.name, other.depth_mm, other.force_n[:, 1])
