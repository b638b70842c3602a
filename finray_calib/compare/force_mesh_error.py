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
    share
        Of the force, or of its difference from another mesh's curve.
    other
        That curve.
    source
        In words where it is known from; empty where nothing is known.
    """

    share: float
    other: ForceCurve | None
    source: str

    def at(self, depth: Floats, force: Floats) -> Floats:
        """Return the standard uncertainty at pushes (n,) with the force that the press has there."""
        return self.share * (force if self.other is None else self.other.at(depth) - force)


def mesh_error(press: PressMechanics, other: PressMechanics | None) -> MeshError:
    """Return what is known of the error of a press's mesh.

    With the excess e of the press's preset and e' of the other one's over an infinitely fine mesh (on the 70 x 35
    finger), forces F and F': e F, or with another mesh |F' - F| e / |e - e'|, this finger's own.

    Raises
    ------
    CompareError
        When the other press is of another design, or on the same preset.
    """
    excess = press.mesh_excess_rel
    if other is None:
        known = "the mesh's excess on the 70 x 35 finger (--other-mesh tells this one's)"
        return MeshError(0.0, None, "") if excess is None else MeshError(excess, None, known)
    curve, share = _curve_on_other_mesh(press, other), 1.0
    if excess is not None and other.mesh_excess_rel is not None and excess != other.mesh_excess_rel:
        share = excess / abs(excess - other.mesh_excess_rel)
    return MeshError(share, curve, "its difference from the other mesh, extrapolated")


def _curve_on_other_mesh(press: PressMechanics, other: PressMechanics) -> ForceCurve:
    """Return the curve of the same finger on another mesh."""
    own = press.design.model_dump(exclude={"mesh", "provenance", "uncertainty_rel"})
    if own != other.design.model_dump(exclude={"mesh", "provenance", "uncertainty_rel"}):
        raise CompareError(f"{other.name}: is a press of another design; give the same one on another mesh")
    if other.preset == press.preset:
        raise CompareError(f"{other.name}: is on the {other.preset} mesh too; give a press on another one")
    return ForceCurve(other.name, other.depth_mm, other.force_n[:, 1])
