"""Calibration of a load cell: from counts under known masses to newtons per count, with their uncertainty."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_schemas import CurveError, LoadCellCalibration

Floats = NDArray[np.float64]
LEAST_LOADS = 5
LEAST_SLOPE_SD = 10.0
"""A slope that noise explains is none."""


class Gravity(NamedTuple):
    """Local acceleration of free fall and its standard uncertainty (m/s^2)."""

    value_m_per_s2: float
    uncertainty_m_per_s2: float


class Loads(NamedTuple):
    """Masses that lay on the cell, and its readings.

    Attributes
    ----------
    masses_kg
        In the order in which they lay there, loading and then unloading, empty first and last; shape (n,).
    counts
        Readings of each, shape (n, r).
    at_s
        Middle of each, on one clock; shape (n,).
    mass_uncertainty_rel
        Relative standard uncertainty that all masses share.
    """

    masses_kg: Floats
    counts: Floats
    at_s: Floats
    mass_uncertainty_rel: float


class WeightedLine(NamedTuple):
    """A straight line: value at 0, slope, and the slope's standard uncertainty."""

    start: float
    slope: float
    slope_uncertainty: float


def weighted_line(x: Floats, y: Floats, u: Floats) -> WeightedLine:
    r"""Return the weighted least-squares line through points.

    .. math:: u^2(b) = \max(1, \tfrac{\chi^2}{\nu - 2}) / \sum w (x - \bar x)^2, \quad w = u^{-2}

    Where points scatter more than their uncertainties, the scatter counts; nu / (nu - 2) is the variance of Student's t
    with nu = n - 2, because few points estimate it.

    Parameters
    ----------
    x, y
        Points, shape (n,), n of at least 5.
    u
        Standard uncertainties of `y`, above 0.
    """
    weights = u**-2.0
    mean_x, mean_y = np.average(x, weights=weights), np.average(y, weights=weights)
    spread = float(np.sum(weights * (x - mean_x) ** 2))
    slope = float(np.sum(weights * (x - mean_x) * (y - mean_y))) / spread
    start = float(mean_y - slope * mean_x)
    chi2, freedom = float(np.sum(weights * (y - start - slope * x) ** 2)), len(x) - 2
    return WeightedLine(start, slope, float(np.sqrt(max(1.0, chi2 / (freedom - 2)) / spread)))


def calibrate_cell(
    loads: Loads, gravity: Gravity, cell: str, calibrated_utc: str, certificate: str | None = None
) -> LoadCellCalibration:
    r"""Return the calibration of a load cell.

    .. math:: c = c_0 + m g / s, \quad
              \left(\tfrac{u_s}{s}\right)^2 = \left(\tfrac{u_b}{b}\right)^2 + u_m^2 + \left(\tfrac{u_g}{g}\right)^2

    Valid for static loads along the cell's axis, at the temperature of the calibration. Buoyancy of the air (0.015 % of
    steel) is not corrected.

    Parameters
    ----------
    loads
        Masses and counts.
    gravity
        Local gravity.
    cell, calibrated_utc
        Which cell, and when.
    certificate
        Of the masses; none: not recorded.

    Raises
    ------
    CurveError
        Too few loads, a cell that does not follow them, or the same counts throughout.
    """
    masses_kg, counts = loads.masses_kg, loads.counts
    _require_loads(masses_kg)
    readings = counts.shape[1]
    means, sds = counts.mean(axis=1), counts.std(axis=1, ddof=1)
    if not sds.all():
        raise CurveError("load cell: is stuck, because all readings of a load are equal; check amplifier and wiring")
    noise_counts = float(np.sqrt(np.mean(sds**2)))
    # one scatter for all loads: that of a single one is known too badly to weigh with
    uncertainties = np.full(len(means), noise_counts / np.sqrt(readings))
    force_n = masses_kg * gravity.value_m_per_s2
    line = weighted_line(force_n, means, uncertainties)
    if abs(line.slope) < LEAST_SLOPE_SD * line.slope_uncertainty:
        raise CurveError(
            f"load cell: the counts do not follow the masses ({line.slope:.4g} +- {line.slope_uncertainty:.2g} counts "
            "per newton); check that each mass lay on the cell when the command asked for it"
        )
    slope = 1.0 / line.slope
    slope_rel = np.sqrt(
        (line.slope_uncertainty / line.slope) ** 2
        + loads.mass_uncertainty_rel**2
        + (gravity.uncertainty_m_per_s2 / gravity.value_m_per_s2) ** 2
    )
    residuals_n = (means - line.start) * slope - force_n
    linearity_n, hysteresis_n = _form(masses_kg, residuals_n)
    return LoadCellCalibration(
        cell=cell,
        calibrated_utc=calibrated_utc,
        certificate=certificate,
        gravity_m_per_s2=gravity.value_m_per_s2,
        gravity_uncertainty_m_per_s2=gravity.uncertainty_m_per_s2,
        masses_kg=tuple(masses_kg.tolist()),
        mass_uncertainty_rel=loads.mass_uncertainty_rel,
        counts=tuple(means.tolist()),
        counts_uncertainties=tuple(uncertainties.tolist()),
        slope_n_per_count=slope,
        slope_uncertainty_n_per_count=float(abs(slope) * slope_rel),
        linearity_n=linearity_n,
        hysteresis_n=hysteresis_n,
        noise_n=noise_counts * abs(slope),
        drift_n_per_s=_drift_n_per_s(loads, means, slope),
        readings=readings,
    )


def _require_loads(masses_kg: Floats) -> None:
    """Refuse too few loads for a line and its scatter."""
    if len(masses_kg) < LEAST_LOADS or len(set(masses_kg.tolist())) < 3:
        raise CurveError(
            f"load cell: {len(masses_kg)} loads of {len(set(masses_kg.tolist()))} masses are too few; give at least "
            "two masses besides the empty cell"
        )


def _form(masses_kg: Floats, residuals_n: Floats) -> tuple[float, float]:
    """Return the largest mean residual of a mass, and the largest difference of one mass (N)."""
    groups = [residuals_n[masses_kg == mass] for mass in sorted(set(masses_kg.tolist()))]
    return max(abs(float(group.mean())) for group in groups), max(float(np.ptp(group)) for group in groups)


def _drift_n_per_s(loads: Loads, means: Floats, slope_n_per_count: float) -> float:
    """Return the drift of the empty cell between the first and the last load; 0 where one of them was not empty."""
    if loads.masses_kg[0] or loads.masses_kg[-1]:
        return 0.0
    return float((means[-1] - means[0]) * slope_n_per_count / (loads.at_s[-1] - loads.at_s[0]))


def loading_order(masses_kg: Sequence[float]) -> tuple[float, ...]:
    """Return the order of loads: empty, up, down, empty; a drift with time then leaves the slope alone."""
    up = sorted(set(masses_kg))
    return (0.0, *up, *up[::-1], 0.0)
