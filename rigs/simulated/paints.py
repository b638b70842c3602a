"""What is painted on the simulated bench: a hidden paint of the paper's family, or a measured material.

Both become a re-radiation (Donaldson) matrix D(out, in) in nm^-1 and a reflectance curve.
"""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq, minimize_scalar

from data_schemas.curve_files import read_donaldson_matrix
from data_schemas.curves import DonaldsonMatrix, SpectralCurve
from data_schemas.errors import CurveError
from data_schemas.rig import HiddenPaint

Floats = NDArray[np.float64]
SMALLEST_STOKES_SHIFT_NM = 5.0
YIELD_ENDS_NM = 780.0
EDGE_STEEPNESS = 8.0


@cache
def _standard_shape(asinh_skewness: float) -> tuple[float, float]:
    """Return the mode and the full width at half maximum of the skew-Cauchy shape with location 0, scale 1."""

    def shape(z: float) -> float:
        return float((np.arctan(np.sinh(asinh_skewness) * z) / np.pi + 0.5) / (1.0 + z * z))

    # The mode lies within 0.35 scales of the location for every skewness; the half maximum within 2 of the mode.
    mode = minimize_scalar(lambda z: -shape(z), bounds=(-0.4, 0.4), method="bounded", options={"xatol": 1e-12}).x
    half = 0.5 * shape(mode)
    left = brentq(lambda z: shape(z) - half, mode - 2.0, mode, xtol=1e-13)
    right = brentq(lambda z: shape(z) - half, mode, mode + 2.0, xtol=1e-13)
    return float(mode), float(right - left)


def skew_cauchy_shape(wavelength_nm: Floats, mode_nm: float, fwhm_nm: float, asinh_skewness: float) -> Floats:
    r"""Evaluate the paper's emission shape from its mode, width and skewness, not normalised.

    .. math:: f(\lambda) = \frac{\arctan(\omega z) / \pi + 1/2}{1 + z^2}, \quad z = (\lambda - \lambda_0)/\gamma

    Location and scale are solved numerically so that the mode and the full width at half maximum are as given.

    Parameters
    ----------
    wavelength_nm
        Wavelength (nm), any shape.
    mode_nm, fwhm_nm
        Wavelength of the maximum and full width at half maximum (nm).
    asinh_skewness
        ``asinh(omega)``; 0 is the symmetric Cauchy shape.

    Returns
    -------
    ndarray
        Shape of `wavelength_nm`; at most 1.

    Source: Zheng, Sato and Sato, ECCV 2014.
    """
    mode, width = _standard_shape(asinh_skewness)
    scale_nm = fwhm_nm / width
    z = (wavelength_nm - (mode_nm - scale_nm * mode)) / scale_nm
    values: Floats = (np.arctan(np.sinh(asinh_skewness) * z) / np.pi + 0.5) / (1.0 + z * z)
    return values


def hidden_paint_matrix(paint: HiddenPaint, laser_nm: float, wavelength_nm: Floats) -> DonaldsonMatrix:
    r"""Build the re-radiation matrix of a hidden paint.

    .. math:: D(o, i) = Y \frac{a(i)}{a(i_L)} e(o) \;\; \text{for } o > i + 5\,\text{nm, else } 0

    e is the skew-Cauchy shape with integral 1 from the laser line (+5 nm) to 780 nm, so that the column at the
    laser line is the pure paper family there and integrates to the energy yield Y. Emission below the
    excitation is cut off. The absorptance a is a plateau that falls half-way between the absorption peak and
    the mode of the emission; the reflectance rises there, and reflectance + absorptance <= 1.

    Parameters
    ----------
    paint
        The hidden parameters.
    laser_nm
        Wavelength of the laser (nm).
    wavelength_nm
        Common axis of emission and excitation (nm), increasing in equal steps, shape (L,).

    Raises
    ------
    CurveError
        The parameters contradict each other: absorption peak not below the mode, laser not absorbed, or more
        light emitted than absorbed.
    """
    plateau = _absorption_plateau(paint, laser_nm, wavelength_nm)
    at_laser = float(np.interp(laser_nm, wavelength_nm, plateau))
    stokes_shift_nm = wavelength_nm[:, None] - wavelength_nm[None, :]
    emission = skew_cauchy_shape(wavelength_nm, paint.mode_nm, paint.fwhm_nm, paint.asinh_skewness)
    counted = (wavelength_nm > laser_nm + SMALLEST_STOKES_SHIFT_NM) & (wavelength_nm <= YIELD_ENDS_NM)
    emission *= paint.energy_yield / np.trapezoid(emission[counted], wavelength_nm[counted])
    matrix = np.where(stokes_shift_nm > SMALLEST_STOKES_SHIFT_NM, np.outer(emission, plateau / at_laser), 0.0)
    absorptance = (1.0 - paint.reflectance_at_laser) * plateau
    emitted = np.trapezoid(matrix, wavelength_nm, axis=0)
    if (emitted > absorptance + 1e-12).any():
        raise CurveError(
            f"simulated.paint: energy_yield = {paint.energy_yield:g} means that more light is emitted than absorbed "
            f"(reflectance_at_laser = {paint.reflectance_at_laser:g}); lower one of the two"
        )
    rise = paint.reflectance_long_wavelength - paint.reflectance_at_laser
    return DonaldsonMatrix(
        name=paint.name,
        emission_nm=wavelength_nm,
        excitation_nm=wavelength_nm,
        radiance_factor_per_nm=matrix,
        reflectance=SpectralCurve(
            name=f"{paint.name}, reflectance",
            wavelength_nm=wavelength_nm,
            values=paint.reflectance_at_laser + rise * (1.0 - plateau),
            source="simulated",
        ),
        source="simulated",
    )


def _absorption_plateau(paint: HiddenPaint, laser_nm: float, wavelength_nm: Floats) -> Floats:
    """Return the relative absorptance: 1, falling to 0 half-way between absorption peak and emission mode."""
    if paint.absorption_peak_nm >= paint.mode_nm:
        raise CurveError(
            f"simulated.paint: absorption_peak_nm = {paint.absorption_peak_nm:g} must be below mode_nm = "
            f"{paint.mode_nm:g} nm (a paint emits at longer wavelengths than it absorbs)"
        )
    edge_nm = 0.5 * (paint.absorption_peak_nm + paint.mode_nm)
    if laser_nm > edge_nm:
        raise CurveError(
            f"simulated.paint: absorbs up to {edge_nm:g} nm only, but the laser has {laser_nm:g} nm; raise "
            "absorption_peak_nm or mode_nm"
        )
    width_nm = (paint.mode_nm - paint.absorption_peak_nm) / EDGE_STEEPNESS
    return np.asarray(0.5 * (1.0 - np.tanh(0.5 * (wavelength_nm - edge_nm) / width_nm)))


def measured_material_matrix(path: Path, wavelength_nm: Floats) -> DonaldsonMatrix:
    """Read a measured re-radiation matrix and interpolate it to the bench's wavelengths.

    Monotone cubic (PCHIP) along emission, linear along excitation; outside the measured excitation nothing is
    emitted. Negative measurement noise becomes 0: a bench cannot emit negative light.
    """
    measured = read_donaldson_matrix(path)
    along_emission = PchipInterpolator(measured.emission_nm, measured.radiance_factor_per_nm, axis=0, extrapolate=False)
    rows = np.clip(np.nan_to_num(along_emission(wavelength_nm)), 0.0, None)
    matrix = np.array([np.interp(wavelength_nm, measured.excitation_nm, row, left=0.0, right=0.0) for row in rows])
    return DonaldsonMatrix(
        name=measured.name,
        emission_nm=wavelength_nm,
        excitation_nm=wavelength_nm,
        radiance_factor_per_nm=matrix,
        reflectance=measured.reflectance,
        source=measured.source,
    )
