"""From band signals to the stored paint calibration."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from data_schemas.colour_checker import ColourCheckerMatch
from data_schemas.curves import HELD_UNCERTAINTY_REL, SpectralCurve
from data_schemas.estimate import Estimate
from data_schemas.fit import PaintCalibration
from data_schemas.radiometry import BandSignals
from data_schemas.reradiation import Reradiation
from finray_calib.fit import calibration_records as records
from finray_calib.fit.absorption_fit import fit_absorption
from finray_calib.fit.absorption_prior import AbsorptionPrior
from finray_calib.fit.band_data import BandData
from finray_calib.fit.calibration_warnings import absorption_warnings, fit_warnings, signal_warnings
from finray_calib.fit.chain_check import check_by_chain
from finray_calib.fit.discrepancy import NO_DISCREPANCY, PAINT_DISCREPANCY, Discrepancy
from finray_calib.fit.emission import FEWEST_DRAWS, EmissionPosterior, FitSettings, fit_emission
from finray_calib.fit.family_choice import DEFAULT_FAMILY, FamilyScore, choose_family, score_families
from finray_calib.fit.leave_one_band_out import BandPrediction, leave_one_band_out
from finray_calib.fit.other_lights import excitation_yields, refuse_unfit_lights
from finray_calib.fit.prior import EmissionPrior
from finray_calib.fit.reflectance import METHOD, reflectance
from finray_calib.spectra.band_tolerances import tolerances_of
from finray_calib.spectra.compiled import machine_threads
from finray_calib.spectra.emission_families import FAMILIES, family_named, tables
from finray_calib.spectra.reradiation_matrix import reradiation_matrix
from finray_calib.spectra.rig_curves import WAVELENGTH_NM, held_shares, weights_of

Floats = NDArray[np.float64]

BAND_CALIBRATION_REL: Final = 0.01
# What a region's photon noise does not know: the shape of each channel's response inside a band, and stray light in
# camera and enclosure. Without them a tail of a thousandth of the peak would be trusted to a hundredth of itself.
CHANNEL_RESPONSE_REL: Final = 0.003
STRAY_LIGHT_REL: Final = 0.003
# Where more of a channel's white signal is leak, the channel measures the filter's blocking and not its band: a floor
# that is nowhere as flat as its optical density says.
LARGEST_LEAK_OF_WHITE: Final = 0.1
PAPER_FAMILY: Final = "zheng2014"
PRIOR_DRAWS: Final = 2000
CURVE_DRAWS: Final = 400
_GOOD_EFFECTIVE_SHARE_OF_OTHERS: Final = 0.3  # a little above what is trusted: adapting costs more than draws


@dataclass(frozen=True, slots=True)
class FitOptions:
    """What to fit and how.

    Attributes
    ----------
    family
        Name of the family to report; None lets the bands choose, see :func:`choose_family`.
    discrepancy
        How far the paint may leave the family.
    prior
        Prior of the quantities common to all families.
    settings
        Size of the sampling.
    check_by_emcee
        Whether to sample the reported posterior again with emcee, as an independent check.
    """

    family: str | None = None
    discrepancy: Discrepancy = PAINT_DISCREPANCY
    prior: EmissionPrior = field(default_factory=EmissionPrior)
    settings: FitSettings = field(default_factory=FitSettings)
    check_by_emcee: bool = False


def calibrate_paint(
    bands: BandSignals,
    seed: int,
    options: FitOptions | None = None,
    other_lights: Sequence[BandSignals] = (),
    colour_match: ColourCheckerMatch | None = None,
) -> PaintCalibration:
    """Fit all families of emission curves to band signals and return the calibration record.

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
        Fewer than four usable bands, values that are not numbers, an unknown family, or another light of another
        paint, at the same wavelength, or too dim to constrain the absorption.
    """
    options = options or FitOptions()
    if options.family is not None:
        family_named(options.family)
    refuse_unfit_lights(bands, other_lights)
    # of the whole process: two fits at the same time in threads of one process would hold each other up
    with threadpool_limits(limits=1, user_api="blas"):  # its matrices are small, and the families fill the cores
        return _calibrate(bands, np.random.default_rng(seed), options, other_lights, colour_match)


def _calibrate(
    bands: BandSignals,
    rng: np.random.Generator,
    options: FitOptions,
    other_lights: Sequence[BandSignals],
    colour_match: ColourCheckerMatch | None,
) -> PaintCalibration:
    """Return the calibration record."""
    data = band_data(bands)
    fitted = _choose(data, options, rng)
    posterior = fitted.posterior
    independent = options.check_by_emcee and posterior.sampling.chain is None
    check = check_by_chain(posterior, options.settings.chain, rng) if independent else None
    at_laser, curve = (
        records.estimate(posterior.reflectance_at_laser),
        records.curve_bands(posterior.curve_draws.curves),
    )
    reflected = reflectance(bands, curve.mean, at_laser) if colour_match is None else colour_match.at_filters
    drawn = posterior.curve_draws.curves[:CURVE_DRAWS]
    yields = [_yields(b, fitted.chosen, options, rng) for b in other_lights]
    reradiation = _reradiation(bands, drawn, reflected, yields, rng)
    mean_reflected, sd_reflected = _reflected_curve(bands, reflected), _reflected_curve(bands, reflected, "sd")
    diffuse = reradiation_matrix(drawn, WAVELENGTH_NM, reradiation, mean_reflected, bands.paint_name, sd_reflected)
    residuals, measured_sd = records.residuals(bands, posterior), np.sqrt(np.diag(data.covariance)).reshape(-1, 3)
    return PaintCalibration(
        **_family_fields(fitted, options),
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
            *signal_warnings(bands, measured_sd),
            *fit_warnings(posterior, residuals, check, options.check_by_emcee),
            *absorption_warnings(reradiation),
            *diffuse.warnings,
        ),
    )


@dataclass(frozen=True, slots=True)
class _Fitted:
    """All families, the one that is reported, and why."""

    posteriors: dict[str, EmissionPosterior]
    paper: EmissionPosterior
    scores: dict[str, FamilyScore]
    chosen: str
    why: str
    posterior: EmissionPosterior


def _choose(data: BandData, options: FitOptions, rng: np.random.Generator) -> _Fitted:
    """Fit all families and return them with the one to report: the asked one, or the best by the rule."""
    posteriors, left_out, paper = _fit_families(data, options, rng)
    scores = score_families(posteriors, left_out)
    chosen, why = choose_family(scores)
    if options.family is not None and options.family != chosen:
        why = f"{options.family}: asked for; the rule would take {why}"
    chosen = options.family or chosen
    posterior = posteriors[chosen]
    if chosen != DEFAULT_FAMILY:
        posterior = _fit(data, chosen, options.discrepancy, options, rng)
    return _Fitted(posteriors, paper, scores, chosen, why, posterior)


def _family_fields(fitted: _Fitted, options: FitOptions) -> dict[str, Any]:
    """Return the fields of the record that tell of the families."""
    others = {**fitted.posteriors, f"{PAPER_FAMILY} alone": fitted.paper}
    shown = [records.curve_bands(p.curve_draws.curves) for p in others.values()]
    return {
        "family": fitted.chosen,
        "family_title": fitted.posterior.family.title,
        "family_choice": fitted.why,
        "discrepancy": records.discrepancy(options.discrepancy),
        "paper": records.paper_parameters(fitted.paper),
        "families": records.families(others, fitted.scores),
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


def band_data(bands: BandSignals) -> BandData:
    """Return the data of the likelihood for the band signals of a region.

    Raises
    ------
    FitError
        Fewer than four usable bands, or values that are not numbers.
    """
    weights = weights_of(bands.optics, bands.channel_weights)
    in_band = weights.leaked_white.reshape(-1, 3) <= LARGEST_LEAK_OF_WHITE
    return BandData(
        y=bands.fluorescence,
        covariance=bands.fluorescence_covariance + _channel_covariance(bands),
        usable=bands.usable() & in_band,
        weights=weights,
        band_calibration_rel=BAND_CALIBRATION_REL,
        tolerances=tolerances_of(bands.optics, bands.channel_weights),
    )


def _fit_families(
    data: BandData, options: FitOptions, rng: np.random.Generator
) -> tuple[dict[str, EmissionPosterior], dict[str, BandPrediction], EmissionPosterior]:
    """Return posterior and left-out bands of each family, and the posterior of the paper's curve alone.

    Side by side in threads, each with randomness of its own. The families beside the default get fewer draws:
    one of them that is reported after all is fitted again.
    """
    sizes = options.settings
    few = replace(
        sizes,
        importance_draws=max(sizes.importance_draws // 2, FEWEST_DRAWS),
        kept_draws=max(sizes.kept_draws // 2, FEWEST_DRAWS),
        good_effective_share=_GOOD_EFFECTIVE_SHARE_OF_OTHERS,
    )
    fewer = replace(options, settings=few)

    def fitted(name: str, own: np.random.Generator) -> tuple[EmissionPosterior, BandPrediction]:
        posterior = _fit(data, name, options.discrepancy, options if name == DEFAULT_FAMILY else fewer, own)
        return posterior, leave_one_band_out(posterior.log_posterior, posterior.sampling.sample)

    *own, last = rng.spawn(len(FAMILIES) + 1)
    tables()  # once, before several ask for them at the same time
    with ThreadPoolExecutor(machine_threads()) as pool:
        running = {name: pool.submit(fitted, name, each) for name, each in zip(FAMILIES, own, strict=True)}
        alone = pool.submit(_fit, data, PAPER_FAMILY, NO_DISCREPANCY, options, last)
        results = {name: done.result() for name, done in running.items()}
        paper = alone.result()
    posteriors = {name: posterior for name, (posterior, _) in results.items()}
    return posteriors, {name: left_out for name, (_, left_out) in results.items()}, paper


def _fit(
    data: BandData, family: str, discrepancy: Discrepancy, options: FitOptions, rng: np.random.Generator
) -> EmissionPosterior:
    """Return the posterior of one family."""
    return fit_emission(data, FAMILIES[family], options.prior, discrepancy, options.settings, rng)


def _channel_covariance(bands: BandSignals) -> Floats:
    """Return the variances of channel response, held ends of curves, and stray light.

    Stray light is relative to the brightest emission band. Where a curve holds its end value, that share of the
    band's weight carries a relative uncertainty of 0.5.
    """
    y, usable = bands.fluorescence, bands.usable()
    emission = usable & ~bands.at_excitation()[:, None]
    brightest = float(np.abs(y[emission]).max()) if emission.any() else 0.0
    relative = np.hypot(CHANNEL_RESPONSE_REL, HELD_UNCERTAINTY_REL * held_shares(bands.optics))
    return np.diag(((relative * y) ** 2 + (STRAY_LIGHT_REL * brightest) ** 2).ravel())


def _yields(
    bands: BandSignals, family: str, options: FitOptions, rng: np.random.Generator
) -> tuple[float, EmissionPosterior]:
    """Return the wavelength of another light and the emission that it excites."""
    name = family if family in FAMILIES else DEFAULT_FAMILY
    posterior = _fit(band_data(bands), name, options.discrepancy, options, rng)
    return bands.optics.laser.wavelength_nm, posterior


def _reradiation(
    bands: BandSignals,
    drawn: Floats,
    reflected: tuple[Estimate, ...],
    lights: Sequence[tuple[float, EmissionPosterior]],
    rng: np.random.Generator,
) -> Reradiation:
    """Return the absorption: prior-driven with one light, constrained by the yields of several."""
    laser_nm = bands.optics.laser.wavelength_nm
    yields = excitation_yields({laser_nm: drawn, **{nm: p.curve_draws.curves for nm, p in lights}})
    least = _reflected_curve(bands, reflected, "low95")
    return fit_absorption(drawn, WAVELENGTH_NM, laser_nm, yields, AbsorptionPrior(), rng, least)


def _reflected_curve(
    bands: BandSignals, reflected: tuple[Estimate, ...], quantity: Literal["estimate", "sd", "low95"] = "estimate"
) -> SpectralCurve:
    """Return the reflectance (or its standard uncertainty or lower 95 % limit) between the filters' centres."""
    pairs = sorted((f.center_nm, getattr(r, quantity)) for f, r in zip(bands.optics.filters, reflected, strict=True))
    nm, values = np.array(pairs).T
    return SpectralCurve(name="reflectance", wavelength_nm=nm, values=values, source="filters of the session")
