"""The one nuisance of a force comparison: the displacement at which the indenter first touches."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from data_schemas.errors import CompareError
from finray_calib.compare.force_curve import ForceCurve
from finray_calib.compare.force_inputs import ForceInputs
from finray_calib.compare.measured_force import MeasuredForce

Floats = NDArray[np.float64]

# of the largest force: no finite-element press is better
_MODEL_ERROR_REL = 0.01
_TRIES = 201
# of the press's depth: far below what any bench reads
_TOLERANCE = 1e-7


def first_touch_weight(curve: ForceCurve, measured: MeasuredForce, inputs: ForceInputs) -> Floats:
    """Return the inverse covariance (n, n) of simulated minus measured force, in 1/N^2, for a fit of first touch.

    What the inputs do is shared by the points, so that a force that is off by a factor does not move first touch; what
    the measurement states is not. A model that is off by a hundredth of the largest force is allowed for everywhere.

    Parameters
    ----------
    inputs
        At the measured displacements.
    """
    effects = measured.force_n * inputs.ln_force_per_ln_input * inputs.u_rel[:, None]
    slope = curve.slope_at(np.clip(measured.displacement_mm, 0.0, curve.reach_mm))
    own = measured.variance_n2(slope) + (_MODEL_ERROR_REL * measured.force_n.max()) ** 2
    return np.asarray(np.linalg.inv(effects.T @ effects + np.diag(own)), dtype=np.float64)


def fitted_first_touch_mm(curve: ForceCurve, measured: MeasuredForce, weight: Floats) -> float:
    """Return the displacement of first touch that minimises e' W e, with e = F(d - offset) - measured.

    A grid over the offsets with which every point lies within the curve's reach and half of them beyond first touch;
    then Brent's method between the neighbours of its best.

    Raises
    ------
    CompareError
        When the best offset would need a deeper press.
    """
    tolerance_mm = _TOLERANCE * curve.reach_mm
    most = float(measured.displacement_mm.max())
    shallowest, deepest = most - curve.reach_mm, float(np.median(measured.displacement_mm))
    if deepest <= shallowest:
        raise CompareError(_deeper(measured.name, most, curve))

    def misfits(offsets_mm: Floats) -> Floats:
        errors = curve.at(measured.displacement_mm - offsets_mm[:, None]) - measured.force_n
        return np.asarray(np.einsum("ki,ij,kj->k", errors, weight, errors, optimize=True))

    offsets = np.linspace(shallowest, deepest, _TRIES)
    best = int(np.argmin(misfits(offsets)))
    low, high = offsets[max(best - 1, 0)], offsets[min(best + 1, _TRIES - 1)]
    found = minimize_scalar(
        lambda offset_mm: float(misfits(np.array([offset_mm]))[0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": tolerance_mm},
    )
    # the bounded search stays inside its ends by a few tolerances
    if found.x - shallowest < 10.0 * tolerance_mm:
        raise CompareError(_deeper(measured.name, curve.reach_mm, curve))
    return float(found.x)


def check_reach(curve: ForceCurve, measured: MeasuredForce, offset_mm: float) -> None:
    """Refuse points deeper than the press, or all of them above the pad.

    Raises
    ------
    CompareError
        When a point lies deeper, or none lies beyond first touch.
    """
    deepest = float(measured.displacement_mm.max()) - offset_mm
    if deepest <= 0.0:
        raise CompareError(f"{measured.name}: no point lies beyond first touch at 0 mm; have first touch fitted")
    if deepest > curve.reach_mm:
        raise CompareError(_deeper(measured.name, deepest, curve))


def _deeper(name: str, deepest_mm: float, curve: ForceCurve) -> str:
    """Return what to do where a press is not deep enough."""
    return (
        f"{name}: reaches {deepest_mm:.4g} mm or more from first touch, the simulated press serves to "
        f"{curve.reach_mm:.4g} mm; simulate with a larger indenter.depth_mm, or leave the deeper points out"
    )
