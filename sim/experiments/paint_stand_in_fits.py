"""Fits to a measured stand-in: filter bands by the calibration's fitter, whole curves by least squares."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.curves import SpectralCurve
from data_schemas.devices import LaserSettings
from data_schemas.estimate import Estimate
from data_schemas.paper_paints import BandFit, CurveFit
from data_schemas.radiometry import Optics
from data_schemas.reradiation import Reradiation
from data_schemas.rig import WhiteReference
from data_schemas.standard_curves import assumed_camera_response, halogen_lamp
from finray_calib.fit.absorption_fit import ExcitationYield, fit_absorption
from finray_calib.fit.absorption_prior import AbsorptionPrior
from finray_calib.fit.calibration_records import curve_bands, estimate, paper_parameters
from finray_calib.fit.discrepancy import NO_DISCREPANCY, PAINT_DISCREPANCY, Discrepancy
from finray_calib.fit.emission import EmissionPosterior, FitSettings, fit_emission
from finray_calib.fit.family_choice import DEFAULT_FAMILY
from finray_calib.fit.likelihood import BandData
from finray_calib.fit.paint_calibration import PAPER_FAMILY
from finray_calib.fit.prior import EmissionPrior
from finray_calib.spectra.band_weights import EmissionWeights
from finray_calib.spectra.emission_families import EmissionFamily, family_named
from finray_calib.spectra.rig_curves import WAVELENGTH_NM, filter_transmission, weights_of
from finray_calib.spectra.skew_cauchy import SkewCauchy

Floats = NDArray[np.float64]
LASER_NM = 450.0
FILTER_CENTER_NM = (405.0, 450.0, 500.0, 532.0, 560.0, 600.0, 630.0, 660.0)
GRID_NM = WAVELENGTH_NM
LEVEL_CHANNELS = (0.0, 0.0, 1.0)
"""The blue channel alone measures the laser: red and green hardly see it."""
CALIBRATION_REL, FLOOR_REL = 0.01, 0.003
"""Assumed errors of the bands: of the value, common to its channels, and of the brightest one."""
LEAST_RESPONSE_REL = 0.02
"""A channel that responds less than this share of the best one in a band sees little but leaks: not used."""
JUDGED_SHARE = 0.05
"""Coverage counts where the measured emission exceeds this share of its peak."""
YIELD_SD_REL = 0.05
ABSORPTION_DRAWS = 400


@dataclass(frozen=True, slots=True)
class FittedBands:
    """A fit to the bands: its record and its (N, L) draws of the emission, nm^-1."""

    record: BandFit
    draws_per_nm: Floats


def band_means(emission_per_nm: Floats) -> dict[float, float]:
    """Return filter centre (nm) -> mean of an emission on the 1 nm grid over the filter's pass band, nm^-1."""
    passed = np.array([filter_transmission(band, GRID_NM) for band in _optics().filters])
    means = passed @ emission_per_nm / passed.sum(axis=1)
    return dict(zip(FILTER_CENTER_NM, map(float, means), strict=True))


def fit_bands(
    emission_per_nm: Floats, measured: SpectralCurve, reflectance_at_laser: float, rng: np.random.Generator
) -> tuple[FittedBands, FittedBands]:
    """Fit what eight filters and a colour camera see of an emission: the paper's way, then ours.

    The paper's way is its equation and nothing else; ours is the default family with the discrepancy of real paint.
    Both get the same bands with the same errors.

    Parameters
    ----------
    emission_per_nm
        (L,) true emission on the 1 nm grid.
    measured
        The same as measured, to judge the fits.
    reflectance_at_laser
        Reflectance at the laser line, 0..1.
    rng
        Source of noise and draws.
    """
    data = _seen(emission_per_nm, reflectance_at_laser, rng)
    return (
        _fit(data, PAPER_FAMILY, NO_DISCREPANCY, measured, rng),
        _fit(data, DEFAULT_FAMILY, PAINT_DISCREPANCY, measured, rng),
    )


def absorption_from(
    draws_per_nm: Floats,
    absorption: SpectralCurve,
    lights_nm: Sequence[float],
    reflectance: SpectralCurve,
    rng: np.random.Generator,
) -> Reradiation:
    """Return our posterior of the absorption from emission draws and the measured yields under some lights.

    Parameters
    ----------
    draws_per_nm
        (N, L) emission draws under the laser on the 1 nm grid, nm^-1.
    absorption
        Measured absorption, from which the yields follow.
    lights_nm
        Excitation lights, the laser first, nm.
    reflectance
        Bound of the absorption, 0..1.
    rng
        Source of all randomness.
    """
    yields = [ExcitationYield(nm, float(absorption(nm)) * nm / LASER_NM, YIELD_SD_REL) for nm in lights_nm]
    return fit_absorption(
        draws_per_nm[:ABSORPTION_DRAWS], GRID_NM, LASER_NM, yields, AbsorptionPrior(), rng, reflectance
    )


def fit_whole_spectrum(family_name: str, measured: SpectralCurve) -> CurveFit:
    """Fit a family by least squares to all samples of a curve: what the equation can do when everything is seen."""
    family = family_named(family_name)
    x, y = measured.wavelength_nm, measured.values / measured.values.max()
    theta = _least_squares(family, x, y)
    theta[2] += np.log(measured.values.max())
    parameters = dict(zip(family.parameter_names, map(float, theta), strict=True))
    if family.name == PAPER_FAMILY:
        paper = SkewCauchy.from_mode(theta[0], theta[1], theta[3], theta[2])
        parameters |= {"location_nm": paper.location_nm, "scale_nm": paper.scale_nm, "skewness": paper.skewness}
    curve = SpectralCurve(
        name=family.title,
        wavelength_nm=GRID_NM,
        values=family.curves(theta[None], GRID_NM)[0],
        source="least squares, whole spectrum",
    )
    return CurveFit(
        family=family.title,
        parameters=parameters,
        mode_nm=float(theta[0]),
        fwhm_nm=float(np.exp(theta[1])),
        curve=curve,
        residual_rel=_residual_rel(family.curves(theta[None], x)[0], measured),
    )


def _optics() -> Optics:
    """Return the paper's filters and laser before the assumed camera and a halogen lamp."""
    return Optics(
        filters=tuple(
            BandPassFilter(slot=slot, name=f"{nm:g}", center_nm=nm) for slot, nm in enumerate(FILTER_CENTER_NM, 1)
        ),
        excitation_filter=f"{LASER_NM:g}",
        laser=LaserSettings(wavelength_nm=LASER_NM),
        lamp=halogen_lamp(),
        white_reference=WhiteReference(),
        camera_response=assumed_camera_response(),
    )


def _seen(emission_per_nm: Floats, reflectance_at_laser: float, rng: np.random.Generator) -> BandData:
    """Return noisy values of eight bands in three channels; noise grows where a channel responds less."""
    optics = _optics()
    weights: EmissionWeights = weights_of(optics, LEVEL_CHANNELS)
    exact = weights.emission @ emission_per_nm + reflectance_at_laser * weights.reflected_laser
    response = np.array([curve(np.array(FILTER_CENTER_NM)) for curve in optics.camera_response]).T
    relative = response / response.max(axis=1, keepdims=True)
    usable = relative >= LEAST_RESPONSE_REL
    brightest = exact[usable.ravel() & ~weights.is_excitation].max()
    floor = FLOOR_REL * brightest / np.maximum(relative, LEAST_RESPONSE_REL).ravel()
    calibration = 1 + CALIBRATION_REL * rng.standard_normal(weights.bands)
    y = exact * calibration[weights.band_index] + floor * rng.standard_normal(exact.size)
    return BandData(y.reshape(usable.shape), np.diag(floor**2), usable, weights, CALIBRATION_REL)


def _fit(
    data: BandData, family: str, discrepancy: Discrepancy, measured: SpectralCurve, rng: np.random.Generator
) -> FittedBands:
    """Return the posterior of one family as a record, with its draws."""
    posterior = fit_emission(data, family_named(family), EmissionPrior(), discrepancy, FitSettings(), rng)
    bands = curve_bands(posterior.curve_draws.curves)
    mean, low, high = (
        np.interp(measured.wavelength_nm, GRID_NM, curve) for curve in (bands.mean, bands.low95, bands.high95)
    )
    judged = measured.values > JUDGED_SHARE * measured.values.max()
    inside = (low <= measured.values) & (measured.values <= high)
    record = BandFit(
        family=posterior.family.title,
        with_discrepancy=discrepancy.acts,
        parameters=_parameters(posterior),
        wavelength_nm=GRID_NM,
        mean_per_nm=bands.mean,
        low95_per_nm=bands.low95,
        high95_per_nm=bands.high95,
        residual_rel=_residual_rel(mean, measured),
        covered_share=float(inside[judged].mean()),
        method=posterior.sampling.method,
        trusted=posterior.sampling.trusted,
    )
    return FittedBands(record, posterior.curve_draws.curves)


def _parameters(posterior: EmissionPosterior) -> dict[str, Estimate]:
    """Return the curve's maximum and width, and the paper's own parameters where it is the paper's family."""
    quantities = posterior.quantities
    common = {"mode_nm": estimate(quantities.mode_nm), "fwhm_nm": estimate(quantities.fwhm_nm)}
    return common | (paper_parameters(posterior) if posterior.family.name == PAPER_FAMILY else {})


def _residual_rel(fitted: Floats, measured: SpectralCurve) -> float:
    """Return the norm of the difference over that of the measured curve; where nothing was measured it is 0."""
    difference = np.where(measured.values != 0, fitted, 0.0) - measured.values
    return float(np.linalg.norm(difference) / np.linalg.norm(measured.values))


def _least_squares(family: EmissionFamily, x_nm: Floats, y: Floats) -> Floats:
    """Return the parameters of a curve of maximum about 1 with the least residual, from starts of both skews."""
    low = [320.0, np.log(10.0), -3.0, *(p.low for p in family.own)]
    high = [780.0, np.log(400.0), 3.0, *(p.high for p in family.own)]
    starts = [[x_nm[y.argmax()], np.log(50.0), 0.0, *(side * 0.3 for _ in family.own)] for side in (-1, 1)]
    scales = [10.0, 0.2, 0.2, *(1.0 for _ in family.own)]

    def residual(theta: Floats) -> Floats:
        return np.asarray(family.curves(theta[None], x_nm)[0] * (y != 0) - y)

    fits = [least_squares(residual, start, bounds=(low, high), x_scale=scales) for start in starts]
    return np.asarray(min(fits, key=lambda fit: float(fit.cost)).x)
