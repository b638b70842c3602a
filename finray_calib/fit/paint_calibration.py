"""From band signals to the stored paint calibration."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from data_schemas.colour_checker import ColourCheckerMatch
from data_schemas.emission_detection import EmissionDetection, PaintWithoutEmission
from data_schemas.errors import FitError
from data_schemas.estimate import Estimate
from data_schemas.fit import PaintCalibration
from data_schemas.radiometry import BandSignals
from finray_calib.fit import calibration_records as records
from finray_calib.fit.band_data import BandData
from finray_calib.fit.calibration_warnings import absorption_warnings, fit_warnings
from finray_calib.fit.chain_check import check_by_chain
from finray_calib.fit.detection import blank_model, detect_emission
from finray_calib.fit.emission import EmissionPosterior
from finray_calib.fit.family_fits import FamilyFits, fit_families
from finray_calib.fit.fit_options import FitOptions
from finray_calib.fit.measured_bands import band_data
from finray_calib.fit.other_lights import excited_emission, refuse_unfit_lights
from finray_calib.fit.paint_absorption import matrix_warnings, paint_absorption
from finray_calib.fit.reflectance import METHOD, reflectance
from finray_calib.spectra.emission_families import family_named
from finray_calib.spectra.rig_curves import WAVELENGTH_NM

PAPER_FAMILY: Final = "zheng2014"
PRIOR_DRAWS: Final = 2000
CURVE_DRAWS: Final = 400


def calibrate_paint(
    bands: BandSignals,
    seed: int,
    options: FitOptions | None = None,
    other_lights: Sequence[BandSignals] = (),
    colour_match: ColourCheckerMatch | None = None,
) -> PaintCalibration | PaintWithoutEmission:
    """Fit all families of emission curves to band signals and return the calibration record.

    Where the signals hold no emission beyond reflected laser, leak and stray light there is nothing to fit: the record
    then holds the limit of the yield in place of a spectrum, see :func:`~finray_calib.fit.detection.detect_emission`.

    Parameters
    ----------
    bands
        Band signals of one paint.
    seed
        Seed of all randomness.
    options
        What to fit; the defaults are those of :class:`FitOptions`.
    other_lights
        Band signals of the same paint under other excitation lights, which constrain its absorption.
    colour_match
        Closest ColorChecker patch, whose reflectance replaces the one measured under the lamp.

    Raises
    ------
    FitError
        Fewer than four usable bands, values that are not numbers, more light than the laser's, an unknown family, or
        another light of another paint, at the same wavelength, or too dim to constrain the absorption.
    """
    options = options or FitOptions()
    if options.family is not None:
        family_named(options.family)
    refuse_unfit_lights(bands, other_lights)
    data = band_data(bands)
    detection = detect_emission(bands, data, options.prior, seed)
    if not detection.measured:
        return _without_emission(bands, data, detection, options)
    # of the whole process: two fits at the same time in threads of one process would hold each other up
    with threadpool_limits(limits=1, user_api="blas"):  # its matrices are small, and the families fill the cores
        return _calibrate(bands, data, detection, np.random.default_rng(seed), options, other_lights, colour_match)


def _without_emission(
    bands: BandSignals, data: BandData, detection: EmissionDetection, options: FitOptions
) -> PaintWithoutEmission:
    """Return the record of a sample without emission."""
    blank = blank_model(bands, data, options.prior.ln_blocking_sd)
    expected, sd = np.zeros(data.y.size), np.zeros(data.y.size)
    expected[blank.rows], sd[blank.rows] = blank.mean, np.sqrt(np.diag(blank.covariance))
    rho = min(blank.reflectance_at_laser, 1.0)
    at_laser = Estimate(estimate=rho, sd=0.0, low68=rho, high68=rho, low95=rho, high95=rho)
    return PaintWithoutEmission(
        paint_name=bands.paint_name,
        detection=detection,
        reflectance_at_laser=blank.reflectance_at_laser,
        reflectance=reflectance(bands, np.zeros(WAVELENGTH_NM.size), at_laser),
        optics=bands.optics,
        usable=data.usable,
        measured=bands.fluorescence,
        measured_sd=np.sqrt(np.diag(data.covariance)).reshape(-1, 3),
        blank=expected.reshape(-1, 3),
        blank_sd=sd.reshape(-1, 3),
    )


def _calibrate(
    bands: BandSignals,
    data: BandData,
    detection: EmissionDetection,
    rng: np.random.Generator,
    options: FitOptions,
    other_lights: Sequence[BandSignals],
    colour_match: ColourCheckerMatch | None,
) -> PaintCalibration:
    """Return the calibration record."""
    fits = fit_families(data, options, PAPER_FAMILY, rng)
    posterior = fits.posterior
    energy_yield = records.estimate(posterior.quantities.energy_yield)
    _require_energy(energy_yield, bands)
    independent = options.check_by_emcee and posterior.sampling.chain is None
    check = check_by_chain(posterior, options.settings.chain, rng) if independent else None
    at_laser = records.estimate(posterior.reflectance_at_laser)
    curve, drawn = records.curve_bands(posterior.curve_draws.curves), posterior.curve_draws.curves[:CURVE_DRAWS]
    reflected = reflectance(bands, curve.mean, at_laser) if colour_match is None else colour_match.at_filters
    lights = [excited_emission(light, fits.chosen, options, rng) for light in other_lights]
    reradiation = paint_absorption(bands, drawn, reflected, lights, rng)
    residuals, measured_sd = records.residuals(bands, posterior), np.sqrt(np.diag(data.covariance)).reshape(-1, 3)
    return PaintCalibration(
        detection=detection,
        **_family_fields(fits, options),
        **_posterior_fields(posterior, curve, bands, rng),
        reflectance=reflected,
        reflectance_method=METHOD if colour_match is None else colour_match.statement,
        colour_match=colour_match,
        reradiation=reradiation,
        **_measurement_fields(bands, data, posterior),
        measured_sd=measured_sd,
        bands=residuals,
        diagnostics=records.diagnostics(posterior, check),
        warnings=(
            *fit_warnings(posterior, residuals, check, options.check_by_emcee),
            *absorption_warnings(reradiation),
            *matrix_warnings(bands, drawn, reflected, reradiation),
        ),
    )


def _require_energy(energy_yield: Estimate, bands: BandSignals) -> None:
    """Refuse a paint that emits more light than the laser brings."""
    if energy_yield.low95 > 1.0:
        raise FitError(
            f"'{bands.paint_name}' would emit {energy_yield.estimate:.3g} times the energy of the laser (95 %: at "
            f"least {energy_yield.low95:.3g}), and no paint emits more than falls on it: check the white reference "
            "under the laser (its level is too low), and that no band signals are in per cent"
        )


def _family_fields(fits: FamilyFits, options: FitOptions) -> dict[str, Any]:
    """Return the fields of the record that tell of the families."""
    others = {**fits.posteriors, f"{PAPER_FAMILY} alone": fits.alone}
    shown = [records.curve_bands(p.curve_draws.curves) for p in others.values()]
    return {
        "family": fits.chosen,
        "family_title": fits.posterior.family.title,
        "family_choice": fits.why,
        "discrepancy": records.discrepancy(options.discrepancy),
        "paper": records.paper_parameters(fits.alone),
        "families": records.families(others, fits.scores),
        "family_emission_per_nm": np.array([s.mean for s in shown]),
        "family_low95_per_nm": np.array([s.low95 for s in shown]),
        "family_high95_per_nm": np.array([s.high95 for s in shown]),
    }


def _posterior_fields(
    posterior: EmissionPosterior, curve: records.CurveBands, bands: BandSignals, rng: np.random.Generator
) -> dict[str, Any]:
    """Return the fields of the record that tell of the reported family's parameters and curve."""
    prior = posterior.log_posterior.prior
    return {
        "parameters": records.parameters(posterior),
        "prior": dict(zip(prior.names, prior.words, strict=True)),
        "prior_sensitivity": records.prior_sensitivity(posterior),
        "sampled": prior.names,
        "map_estimate": dict(zip(prior.names, map(float, posterior.maxima.theta[0]), strict=True)),
        "draws": posterior.draws,
        "prior_draws": prior.draw(PRIOR_DRAWS, rng),
        "wavelength_nm": WAVELENGTH_NM,
        "emission_per_nm": curve.mean,
        "emission_low95_per_nm": curve.low95,
        "emission_high95_per_nm": curve.high95,
        "emission_low68_per_nm": curve.low68,
        "emission_high68_per_nm": curve.high68,
        "emission_draws_per_nm": posterior.curve_draws.curves[:CURVE_DRAWS],
        "energy_yield": records.estimate(posterior.quantities.energy_yield),
        "band_integrals": records.band_integrals(bands, posterior),
    }


def _measurement_fields(bands: BandSignals, data: BandData, posterior: EmissionPosterior) -> dict[str, Any]:
    """Return the fields of the record that set what was measured beside what is predicted."""
    return {
        "paint_name": bands.paint_name,
        "optics": bands.optics,
        "usable": data.usable,
        "measured": bands.fluorescence,
        "predicted": posterior.bands.predicted_mean,
        "predicted_sd": posterior.bands.predicted_sd,
        "chi_square": posterior.bands.total_chi2,
        "usable_values": data.kept.size,
    }
