"""What a measured re-radiation matrix says about a paint: emission under the laser, absorption, yields.

Fits to such a stand-in: filter bands by the calibration's fitter, whole curves by least squares.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import least_squares

from data_schemas import (
    BandFit,
    BandPassFilter,
    ColourPatch,
    CurveFit,
    DonaldsonMatrix,
    Estimate,
    LaserSettings,
    Optics,
    PaintColour,
    PaintStandIn,
    Reradiation,
    SimulateError,
    SpectralCurve,
    WhiteReference,
)
from data_schemas.storage import assumed_camera_response, halogen_lamp
from finray_calib.fit import (
    DEFAULT_FAMILY,
    NO_DISCREPANCY,
    PAINT_DISCREPANCY,
    PAPER_FAMILY,
    AbsorptionPrior,
    BandData,
    Discrepancy,
    EmissionPosterior,
    EmissionPrior,
    ExcitationYield,
    FitSettings,
    curve_bands,
    estimate,
    fit_absorption,
    fit_emission,
    paper_parameters,
    patch_colours,
)
from finray_calib.spectra import (
    WAVELENGTH_NM,
    EmissionFamily,
    EmissionWeights,
    SkewCauchy,
    family_named,
    filter_transmission,
    photon_yield,
    weights_of,
)

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


PRINTED_STOKES_SHIFT_NM: Final[dict[PaintColour, float]] = {"red": 100.0, "green": 50.0}
PRINTED_PATCH: Final[dict[PaintColour, str]] = {"red": "Red", "green": "Green"}
PLATEAU_SHARE = 0.9
"""Neighbouring excitations of the measured matrices differ by some 5 % of noise: above this all is maximum."""
LIGHTS_NM = (LASER_NM, 405.0, 470.0, 500.0)
FIRST_STOKES_NM = 20.0
"""Nearer to the diagonal, reflected light spills into the emission bands."""
SHAPE_EXCITATION_NM = (380.0, 450.0)
"""Excitations whose emission is averaged to its shape: it does not depend on the excitation, and noise halves."""
STRIP_NM = (10.0, 60.0)
"""The strip beyond the emission's maximum in which yields are compared."""
BAND_NM = 10.0


def measure_stand_in(matrix: DonaldsonMatrix, colour: PaintColour, rng: np.random.Generator) -> PaintStandIn:
    """Read off a measured matrix what the paper states for a paint, and fit what a rig would see of it.

    Parameters
    ----------
    matrix
        Excitation over 380 to 450 nm and emission from 470 to 780 nm.
    colour
        Which of the paper's paints it stands for.
    rng
        Source of the noise of the bands and of all draws.

    Raises
    ------
    SimulateError
        The matrix does not cover the laser and the emission, or does not emit.
    """
    emission = _emission(matrix)
    absorption = _absorption(matrix, emission)
    peak_nm = _maximum_nm(emission)
    largest = float(absorption.values.max())
    plateau_nm = absorption.wavelength_nm[absorption.values >= PLATEAU_SHARE * largest]
    fine = _fine(emission)
    printed, closest = _patches(matrix.reflectance, PRINTED_PATCH[colour])
    paper, ours = fit_bands(fine, emission, float(matrix.reflectance(LASER_NM)), rng)
    bands = {f"{nm:g}": value * BAND_NM for nm, value in band_means(fine).items()}
    return PaintStandIn(
        colour=colour,
        material=matrix.name,
        source=matrix.source,
        emission=emission,
        absorption=absorption,
        emission_peak_nm=peak_nm,
        absorption_peak_nm=_maximum_nm(absorption),
        stokes_shift_nm=peak_nm - _maximum_nm(absorption),
        stokes_shift_low_nm=peak_nm - float(plateau_nm[-1]),
        stokes_shift_high_nm=peak_nm - float(plateau_nm[0]),
        printed_stokes_shift_nm=PRINTED_STOKES_SHIFT_NM[colour],
        absorption_edge_nm=_edge_nm(absorption),
        laser_absorption_factor=1 / largest,
        filter_bands=bands,
        energy_yield=float(np.trapezoid(fine, GRID_NM)),
        photon_yield=float(photon_yield(fine, GRID_NM, LASER_NM)),
        printed_patch=printed,
        closest_patch=closest,
        paper_curve=fit_whole_spectrum(PAPER_FAMILY, emission),
        our_curve=fit_whole_spectrum(DEFAULT_FAMILY, emission),
        absorption_curve=fit_whole_spectrum(PAPER_FAMILY, absorption),
        paper_fit=paper.record,
        our_fit=ours.record,
        one_laser=absorption_from(ours.draws_per_nm, absorption, LIGHTS_NM[:1], matrix.reflectance, rng),
        several_lights=absorption_from(ours.draws_per_nm, absorption, LIGHTS_NM, matrix.reflectance, rng),
    )


def _maximum_nm(curve: SpectralCurve) -> float:
    """Return the sample at the maximum, nm."""
    return float(curve.wavelength_nm[curve.values.argmax()])


def _emission(matrix: DonaldsonMatrix) -> SpectralCurve:
    """Return the emission under the laser: its shape averaged over excitations, its size that of the laser's column."""
    rows, columns = matrix.emission_nm, matrix.excitation_nm
    low_nm, high_nm = SHAPE_EXCITATION_NM
    averaged = (columns >= low_nm) & (columns <= high_nm)
    if not averaged.any() or columns[-1] < LASER_NM or rows[0] > LASER_NM + FIRST_STOKES_NM or rows[-1] < GRID_NM[-1]:
        raise SimulateError(
            f"{matrix.source}: covers excitation {columns[0]:g} to {columns[-1]:g} nm and emission {rows[0]:g} to "
            f"{rows[-1]:g} nm; needed are excitations within {low_nm:g} to {high_nm:g} nm and up to the laser at "
            f"{LASER_NM:g} nm, and emission from {LASER_NM + FIRST_STOKES_NM:g} to {GRID_NM[-1]:g} nm"
        )
    seen = rows >= LASER_NM + FIRST_STOKES_NM
    shape = np.where(seen, matrix.radiance_factor_per_nm[:, averaged].mean(axis=1), 0.0)
    total = matrix.emission_at(LASER_NM).values[seen].sum()
    if not (total > 0 and shape.sum() > 0):
        raise SimulateError(f"{matrix.source}: no emission above the laser at {LASER_NM:g} nm; is it fluorescent?")
    return SpectralCurve(
        name=f"{matrix.name}, emission", wavelength_nm=rows, values=shape * (total / shape.sum()), source=matrix.source
    )


def _absorption(matrix: DonaldsonMatrix, emission: SpectralCurve) -> SpectralCurve:
    """Return the photons absorbed at each excitation relative to the laser, from the light in a red strip."""
    rows, columns = matrix.emission_nm[:, None], matrix.excitation_nm
    peak_nm = rows[emission.values.argmax(), 0]
    strip = (rows >= peak_nm + STRIP_NM[0]) & (rows <= peak_nm + STRIP_NM[1]) & (rows >= columns + FIRST_STOKES_NM)
    expected = (emission.values[:, None] * strip).sum(axis=0)
    light = (matrix.radiance_factor_per_nm * strip).sum(axis=0)
    known = expected > 0
    if not (known.any() and np.interp(LASER_NM, columns, np.where(known, light, 0.0)) > 0):
        raise SimulateError(
            f"{matrix.source}: no emission {STRIP_NM[0]:g} to {STRIP_NM[1]:g} nm above the peak at {peak_nm:g} nm "
            f"under the laser at {LASER_NM:g} nm, so that absorption cannot be read off; is it fluorescent?"
        )
    photons = light[known] / expected[known] / columns[known]
    return SpectralCurve(
        name=f"{matrix.name}, absorption",
        wavelength_nm=columns[known],
        values=photons / np.interp(LASER_NM, columns[known], photons),
        source=matrix.source,
    )


def _edge_nm(absorption: SpectralCurve) -> float:
    """Return where absorption falls to half its maximum towards the red, between samples, nm."""
    x, share = absorption.wavelength_nm, absorption.values / absorption.values.max()
    last = int(np.flatnonzero(share >= 0.5)[-1])
    if last == len(x) - 1:
        return float(x[-1])
    return float(np.interp(0.5, share[[last + 1, last]], x[[last + 1, last]]))


def _fine(emission: SpectralCurve) -> Floats:
    """Return the emission on the fine grid: monotone cubic between samples, nothing below the first Stokes light."""
    curve = PchipInterpolator(emission.wavelength_nm, emission.values, extrapolate=False)
    return np.asarray(np.where(GRID_NM > LASER_NM, np.nan_to_num(curve(GRID_NM)), 0.0))


def _patches(reflectance: SpectralCurve, printed: str) -> tuple[ColourPatch, ColourPatch]:
    """Return the distance of the patch that the paper names and of the closest patch of the ColorChecker."""
    patches, x = patch_colours(), reflectance.wavelength_nm
    norm = np.linalg.norm(reflectance.values)
    errors = {
        name.capitalize(): float(np.linalg.norm(np.interp(x, GRID_NM, values) - reflectance.values) / norm)
        for name, values in zip(patches.names, patches.reflectance, strict=True)
    }
    closest = min(errors, key=lambda name: errors[name])
    return ColourPatch(name=printed, error_rel=errors[printed]), ColourPatch(name=closest, error_rel=errors[closest])
