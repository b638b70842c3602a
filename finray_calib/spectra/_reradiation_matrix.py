"""The re-radiation (Donaldson) matrix of a paint from paired draws of its emission and its absorption.

The absorption is a saturated band with a steep red edge and a soft blue end.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import (
    EXTRAPOLATION_UNCERTAINTY_REL,
    CurveError,
    DonaldsonMatrix,
    Reradiation,
    SpectralCurve,
    read_only,
)
from finray_calib.spectra._band_weights import trapezoidal_weights

Floats = NDArray[np.float64]
ROUNDING = 1e-9
SURE_SD = 2.0
"""A law of conservation counts as broken where it is broken by more than this many standard deviations."""
_ENERGY = (
    "at {count} of {total} excitation wavelengths the paint gives back more energy than it receives, by more than two "
    "standard deviations (worst {worst_nm:g} nm: {emitted:.3f} emitted, {reflected:.3f} reflected, together "
    "{both:.3f} +- {sd:.3f}); check the calibration of emission and reflectance"
)
_PHOTONS = (
    "under the laser at {laser_nm:g} nm more photons leave the paint than come in, by more than two standard "
    "deviations ({emitted:.3f} emitted, {reflected:.3f} reflected, together {both:.3f} +- {sd:.3f}); check the "
    "calibration of emission and reflectance"
)


@dataclass(frozen=True, slots=True)
class ReradiationMatrix:
    """Mean and spread of a rank-one re-radiation matrix.

    Attributes
    ----------
    mean
        Rows are emission, columns excitation; reflectance stands apart.
    sd_per_nm
        (emission, excitation) standard deviation over the draws, nm^-1.
    warnings
        In words, where conservation of energy or photons is broken beyond the uncertainty.
    """

    mean: DonaldsonMatrix
    sd_per_nm: Floats
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "sd_per_nm", read_only(self.sd_per_nm))


def reradiation_matrix(
    emission_draws_per_nm: Floats,
    emission_nm: Floats,
    absorption: Reradiation,
    reflectance: SpectralCurve,
    name: str,
    reflectance_sd: SpectralCurve | None = None,
) -> ReradiationMatrix:
    r"""Return mean and standard deviation of the re-radiation matrix of a paint.

    .. math:: D(\lambda_o, \lambda_i) = e(\lambda_o)\, \frac{a(\lambda_i)}{a(\lambda_L)}\,
       \frac{\lambda_i}{\lambda_L} \;\; \text{for } \lambda_o > \lambda_i, \text{ else } 0

    D counts energy, a counts photons: hence the ratio of wavelengths. Each draw has rank one above its diagonal
    (the emission's shape does not depend on the excitation); the mean keeps what emission and absorption have in
    common. Measured materials keep a share of 0.946 to 0.998 of their squared entries in rank one.

    Emission and reflectance are uncertain, independently of each other: a warning needs emitted plus reflected above
    1 by more than two standard deviations.

    Parameters
    ----------
    emission_draws_per_nm
        (N, L) emission under the laser, nm^-1.
    emission_nm
        (L,) increasing grid, nm.
    absorption
        Its N draws belong to the emission draws one to one.
    reflectance
        Non-fluorescent reflectance (the diagonal), 0 to 1.
    name
        Of the paint.
    reflectance_sd
        Standard uncertainty of the reflectance; by default its ``uncertainty_rel``. Outside the range of the
        reflectance its end value is held and half of it is added in quadrature.

    Returns
    -------
    ReradiationMatrix
        Mean, standard deviation and warnings.

    Raises
    ------
    CurveError
        The draws are not paired or do not fit the grid.
    """
    draws = absorption.absorption_rel_draws
    if emission_draws_per_nm.shape != (len(draws), emission_nm.size):
        raise CurveError(
            f"re-radiation matrix of {name}: emission draws have shape {emission_draws_per_nm.shape}, but must have "
            f"({len(draws)} draws of the absorption, {emission_nm.size} wavelengths in nm); pair emission and "
            "absorption draws one to one"
        )
    excitation_nm, laser_nm = absorption.excitation_nm, absorption.laser_nm
    excited = draws * (excitation_nm / laser_nm)
    stokes = emission_nm[:, None] > excitation_nm
    mean = emission_draws_per_nm.T @ excited / len(draws)
    second_moment = (emission_draws_per_nm**2).T @ excited**2 / len(draws)
    sd = np.sqrt(np.maximum(second_moment - mean**2, 0.0))
    matrix = DonaldsonMatrix(
        name=name,
        emission_nm=emission_nm,
        excitation_nm=excitation_nm,
        radiance_factor_per_nm=np.where(stokes, mean, 0.0),
        reflectance=reflectance,
        source=f"{name}: emission and absorption draws, rank one",
    )
    warnings = _conservation_warnings(
        emission_draws_per_nm, emission_nm, excited, absorption, reflectance, reflectance_sd
    )
    return ReradiationMatrix(matrix, np.where(stokes, sd, 0.0), warnings)


@dataclass(frozen=True, slots=True)
class _Returned:
    """What comes back of the light that comes in, at each excitation (E,): emitted, reflected, and the sum's sd."""

    emitted: Floats
    reflected: Floats
    sd: Floats

    @property
    def excess(self) -> Floats:
        """By how much more than everything surely comes back."""
        return self.emitted + self.reflected - 1 - SURE_SD * self.sd

    def words(self, i: int) -> dict[str, float]:
        """Return the numbers at one excitation, named as in the warnings."""
        emitted, reflected = float(self.emitted[i]), float(self.reflected[i])
        return {"emitted": emitted, "reflected": reflected, "both": emitted + reflected, "sd": float(self.sd[i])}


def _conservation_warnings(
    emission_draws_per_nm: Floats,
    emission_nm: Floats,
    excited: Floats,
    absorption: Reradiation,
    reflectance: SpectralCurve,
    reflectance_sd: SpectralCurve | None,
) -> tuple[str, ...]:
    """Say where more energy (at any excitation) or more photons (under the laser) come back than come in."""
    excitation_nm, laser_nm = absorption.excitation_nm, absorption.laser_nm
    counted = (emission_nm[:, None] > excitation_nm) * trapezoidal_weights(emission_nm)[:, None]
    energy = _returned((emission_draws_per_nm @ counted) * excited, excitation_nm, reflectance, reflectance_sd)
    laser_photons = photon_yield(emission_draws_per_nm, emission_nm, laser_nm)[:, None]
    photons = _returned(laser_photons, np.array([laser_nm]), reflectance, reflectance_sd)
    warnings = []
    if (energy.excess > ROUNDING).any():
        worst = int(energy.excess.argmax())
        count, total = int((energy.excess > ROUNDING).sum()), excitation_nm.size
        at_nm = float(excitation_nm[worst])
        warnings.append(_ENERGY.format(count=count, total=total, worst_nm=at_nm, **energy.words(worst)))
    if photons.excess[0] > ROUNDING:
        warnings.append(_PHOTONS.format(laser_nm=laser_nm, **photons.words(0)))
    return tuple(warnings)


def _returned(
    emitted_draws: Floats, excitation_nm: Floats, reflectance: SpectralCurve, reflectance_sd: SpectralCurve | None
) -> _Returned:
    """Add the reflected light to (N, E) draws of the emitted light."""
    reflected = reflectance(excitation_nm)
    sd = reflectance.uncertainty_rel * reflected if reflectance_sd is None else reflectance_sd(excitation_nm)
    known_nm = reflectance.wavelength_nm
    held = (excitation_nm < known_nm[0]) | (excitation_nm > known_nm[-1])
    sd = np.hypot(sd, EXTRAPOLATION_UNCERTAINTY_REL * reflected * held)
    return _Returned(emitted_draws.mean(axis=0), reflected, np.hypot(emitted_draws.std(axis=0), sd))


LN_2, LN_10 = float(np.log(2.0)), float(np.log(10.0))


def absorptance(
    wavelength_nm: ArrayLike,
    peak_nm: ArrayLike,
    peak_absorbance: ArrayLike,
    red_half_width_nm: ArrayLike,
    blue_half_width_nm: ArrayLike,
    blue_floor: ArrayLike,
) -> Floats:
    r"""Return the share of photons that a paint layer absorbs.

    .. math:: a(\lambda) = 1 - 10^{-A b(\lambda)}, \quad
       b = \begin{cases} G(d/w_r) & d > 0 \\ c + (1 - c)\, G(d/w_b) & d \le 0 \end{cases}, \quad
       d = \lambda - \lambda_a, \; G(z) = 2^{-z^2}

    A thick layer (A > 1) saturates to a flat plateau; a thin one shows the band itself. The floor c stands for the
    higher absorption bands in the blue and ultraviolet. Valid for one absorbing species; all arguments broadcast.

    Parameters
    ----------
    wavelength_nm
        Wavelength, nm.
    peak_nm
        Maximum of absorption, nm: the emission's maximum minus the Stokes shift.
    peak_absorbance
        A, decadic absorbance of the layer at the maximum, above 0.
    red_half_width_nm, blue_half_width_nm
        Half widths at half maximum of the absorbance on either side, nm, above 0.
    blue_floor
        c, absorbance far in the blue relative to the maximum, 0 to 1.

    Returns
    -------
    numpy.ndarray
        Absorptance, 0 to 1, broadcast shape.

    Raises
    ------
    CurveError
        A width or the absorbance is not positive, or the floor is not within 0 to 1.
    """
    x, peak, absorbance, red, blue, floor = (
        np.asarray(v, dtype=np.float64)
        for v in (wavelength_nm, peak_nm, peak_absorbance, red_half_width_nm, blue_half_width_nm, blue_floor)
    )
    if not ((absorbance > 0).all() and (red > 0).all() and (blue > 0).all() and ((floor >= 0) & (floor <= 1)).all()):
        raise CurveError(
            "absorption band: absorbance and half widths (nm) must be above 0, and the blue floor must be within 0 to 1"
        )
    distance = x - peak
    bell = np.exp(-LN_2 * (distance / np.where(distance > 0, red, blue)) ** 2)
    band = np.where(distance > 0, bell, floor + (1 - floor) * bell)
    return np.asarray(-np.expm1(-LN_10 * absorbance * band))


def smooth_covariance(wavelength_nm: Floats, amplitude_rel: float, length_nm: float) -> Floats:
    """Return the covariance s^2 exp(-(l - l')^2 / (2 L^2)) of a smooth deviation of the logarithm of a curve.

    Parameters
    ----------
    wavelength_nm
        (L,) wavelengths, nm.
    amplitude_rel
        s, standard deviation of the logarithm.
    length_nm
        L, correlation length, nm.

    Returns
    -------
    numpy.ndarray
        (L, L), dimensionless.
    """
    z = (wavelength_nm[:, None] - wavelength_nm[None, :]) / length_nm
    return np.asarray(amplitude_rel**2 * np.exp(-0.5 * z**2))


def photon_yield(emission_per_nm: Floats, wavelength_nm: Floats, excitation_nm: float) -> Floats:
    r"""Return the ratio of emitted to incident photons of emission curves excited at one wavelength.

    .. math:: P = \int_{\lambda_x} e(\lambda)\, \lambda / \lambda_x \, d\lambda

    e counts energy per nm, so that each emitted photon carries less of it than the one that excited it. No paint
    emits below its excitation: what a curve holds there is not counted. Trapezoidal rule.

    Parameters
    ----------
    emission_per_nm
        (..., L) emission, nm^-1.
    wavelength_nm
        (L,) grid, nm.
    excitation_nm
        Excitation, nm.

    Returns
    -------
    numpy.ndarray
        (...), dimensionless; at most 1 - reflectance, because a photon makes at most one photon.
    """
    above = emission_per_nm * (wavelength_nm > excitation_nm) * wavelength_nm / excitation_nm
    return np.asarray(np.trapezoid(above, wavelength_nm, axis=-1))
