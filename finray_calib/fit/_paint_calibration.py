r"""From band signals to the stored paint calibration: fit, independent check, reflectance, warnings, record.

The independent check is the same posterior by Markov chains. The non-fluorescent reflectance comes from the white lamp,
under which a fluorescent paint sends reflected *and* re-emitted light through a filter. With the emission f known from
the laser, the re-emitted part of filter b is

.. math:: \Phi_b = \frac{\int f T_b Q\,d\lambda}{\int E T_b Q\,d\lambda}
    \int_{380}^{\lambda_a} E\,\frac{\lambda'}{\lambda_L}\,d\lambda'

where the paint is taken to absorb photons at all wavelengths from 380 nm to the foot of its emission as it does at the
laser line :math:`\lambda_L` (absorption of fluorescent paint is a flat, saturated plateau). That plateau is an
assumption: one laser does not measure it, so half of the subtracted light is carried as standard uncertainty.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from data_schemas import (
    BandResidual,
    BandSignals,
    ChainCheck,
    ColourCheckerMatch,
    Diagnostics,
    DiscrepancySettings,
    EmissionDetection,
    Estimate,
    FamilyResult,
    FitError,
    PaintCalibration,
    PaintWithoutEmission,
    PriorSensitivity,
)
from finray_calib.fit._absorption import matrix_warnings, paint_absorption, refuse_unfit_lights
from finray_calib.fit._band_data import BandData, band_data
from finray_calib.fit._detection import blank_model, detect_emission
from finray_calib.fit._emission import EmissionPosterior, estimate
from finray_calib.fit._family_choice import FamilyFits, FamilyScore, FitOptions, fit_families, fit_family
from finray_calib.fit._importance import mean_shifts
from finray_calib.fit._markov_chains import ChainDiagnostics, SamplerSettings, sample_posterior
from finray_calib.fit._prior import AbsorptionPrior, Discrepancy
from finray_calib.fit._reported_spectrum import (
    ReportedSpectrum,
    prior_share,
    prior_shares,
    reported_spectrum,
    simultaneous_band,
)
from finray_calib.spectra import WAVELENGTH_NM, CurveQuantities, family_named, from_mode_parameters, transmissions

Floats = NDArray[np.float64]

SMALLEST_P: Final = 0.01
LARGEST_CHAIN_SHIFT_SD: Final = 0.25
"""A mean of 400 effective draws moves by 0.05 sd; five times that is no longer chance."""


@dataclass(frozen=True, slots=True)
class CurveBands:
    """Posterior mean and pointwise limits of curves, each (L,), nm^-1."""

    mean: Floats
    low95: Floats
    high95: Floats
    low68: Floats
    high68: Floats


def curve_bands(curves: Floats) -> CurveBands:
    """Return mean and equal-tailed pointwise limits of (n, L) curves of finite numbers."""
    ordered = np.sort(curves, axis=0)  # np.quantile, which selects instead, takes three times as long
    place = np.array([[0.025], [0.16], [0.84], [0.975]]) * (len(curves) - 1)
    below = place.astype(np.int64)
    low, high = ordered[below[:, 0]], ordered[np.minimum(below[:, 0] + 1, len(curves) - 1)]
    low95, low68, high68, high95 = low + (place - below) * (high - low)
    return CurveBands(curves.mean(axis=0), low95, high95, low68, high68)


def _quantities(q: CurveQuantities) -> dict[str, Floats]:
    """Return the draws of the quantities that every curve has."""
    return {
        "mode_nm": q.mode_nm,
        "fwhm_nm": q.fwhm_nm,
        "skew": q.skew,
        "peak_per_nm": q.peak_per_nm,
        "energy_yield": q.energy_yield,
    }


def parameters(reported: ReportedSpectrum, posterior: EmissionPosterior) -> dict[str, Estimate]:
    """Summarise the quantities of the reported curve, then the sampled parameters of the family."""
    names = posterior.log_posterior.prior.names
    draws: Mapping[str, Floats] = {
        **_quantities(reported.quantities),
        "reflectance_at_laser": reported.posterior.reflectance_at_laser,
        "share_below_laser": posterior.share_below_laser,
        **{name: posterior.draws[:, i] for i, name in enumerate(names)},
    }
    return {name: estimate(values) for name, values in draws.items()}


def paper_parameters(posterior: EmissionPosterior) -> dict[str, Estimate]:
    """Summarise the paper's four parameters, in its symbols and units of this package."""
    mode, ln_fwhm, ln_peak, kappa = posterior.draws[:, :4].T
    location, scale, skewness, amplitude = from_mode_parameters(mode, ln_fwhm, kappa, ln_peak)
    draws = {"location_nm": location, "scale_nm": scale, "skewness": skewness, "amplitude_nm": amplitude}
    return {name: estimate(values) for name, values in draws.items()}


def band_integrals(bands: BandSignals, curves: Floats) -> tuple[Estimate, ...]:
    """Return the mean emission over each filter's transmission, nm^-1."""
    return tuple(estimate(curves @ passed / passed.sum()) for passed in transmissions(bands.optics))


def discrepancy(settings: Discrepancy) -> DiscrepancySettings:
    """Return the record of the hyper-parameters."""
    return DiscrepancySettings(
        amplitude_rel=settings.amplitude_rel,
        length_nm=settings.length_nm,
        floor_rel=settings.floor_rel,
        reabsorption_rel=settings.reabsorption_rel,
        origin=settings.origin,
    )


def prior_sensitivity(posterior: EmissionPosterior) -> dict[str, PriorSensitivity]:
    """Return how far the quantities move when the prior is made narrower and wider."""
    prior, quantities = posterior.log_posterior.prior, _quantities(posterior.quantities)
    halved, doubled = (mean_shifts(prior, posterior.draws, quantities, factor) for factor in (0.5, 2.0))
    return {name: PriorSensitivity(halved=halved[name], doubled=doubled[name]) for name in quantities}


def families(
    posteriors: Mapping[str, EmissionPosterior], scores: Mapping[str, FamilyScore]
) -> tuple[FamilyResult, ...]:
    """Return what each family makes of the bands; the paper's without discrepancy competes for no probability."""
    results = []
    for name, posterior in posteriors.items():
        score = scores.get(name)
        sample = posterior.sampling.sample
        left_out = score.left_out if score else None
        results.append(
            FamilyResult(
                name=posterior.family.name,
                title=posterior.family.title,
                with_discrepancy=posterior.log_posterior.discrepancy.acts,
                quantities={key: estimate(draws) for key, draws in _quantities(posterior.quantities).items()},
                ln_evidence=sample.ln_evidence,
                ln_evidence_sd=sample.ln_evidence_sd,
                probability=score.probability if score else None,
                left_out_bands=left_out.total if left_out else None,
                left_out_bands_sd=score.difference_sd if score else None,
                left_out_pareto_k=_finite(np.nanmax(left_out.pareto_k)) if left_out else None,
                chi_square=posterior.bands.total_chi2,
                method=posterior.sampling.method,
                pareto_k=_finite(sample.pareto_k),
            )
        )
    return tuple(results)


def band_residuals(bands: BandSignals, reported: ReportedSpectrum) -> tuple[BandResidual, ...]:
    """Return how well each filter is explained; a filter without usable channels has no degrees of freedom."""
    check = reported.posterior
    p_values = np.nan_to_num(check.p_value, nan=1.0)
    return tuple(
        BandResidual(
            filter_name=band.name,
            center_nm=band.center_nm,
            chi_square=float(np.nan_to_num(check.chi2[b])),
            degrees_of_freedom=int(check.degrees_of_freedom[b]),
            posterior_predictive_p=float(p_values[b]),
            explained=bool(p_values[b] >= SMALLEST_P),
            calibration_pull=estimate(check.imperfections[:, b]),
        )
        for b, band in enumerate(bands.optics.filters)
    )


def _finite(pareto_k: float) -> float | None:
    """Return a shape of weights, None where it cannot be estimated."""
    return float(pareto_k) if np.isfinite(pareto_k) else None


def diagnostics(posterior: EmissionPosterior, check: ChainCheck | None) -> Diagnostics:
    """Return the record of how far the draws can be trusted; emcee that made them counts as no check of its own."""
    sampling = posterior.sampling
    chain, effective = check, sampling.sample.effective
    if sampling.moved is not None:
        effective = float(min(sampling.moved.distinct, len(posterior.draws)))
    if sampling.chain is not None:
        effective = float(sampling.chain.bulk_ess.min())
        chain = chain_record(posterior.log_posterior.prior.names, sampling.chain, None)
    return Diagnostics(
        method=posterior.sampling.method,
        trusted=sampling.trusted,
        pareto_k=_finite(sampling.sample.pareto_k),
        effective_samples=effective,
        ln_evidence=sampling.sample.ln_evidence,
        ln_evidence_sd=sampling.sample.ln_evidence_sd,
        maxima=tuple(float(v) for v in posterior.maxima.log_posterior),
        memory=None if sampling.moved is None else sampling.moved.memory,
        chain=chain,
    )


PAPER_FAMILY: Final = "zheng2014"
PRIOR_DRAWS: Final = 2000
CURVE_DRAWS: Final = 400
_WIDE_LINE_NM: Final = 60.0  # an import refuses wider ones; rig files and stored signals may still hold them


def calibrate_paint(
    bands: BandSignals,
    seed: int,
    options: FitOptions | None = None,
    other_lights: Sequence[BandSignals] = (),
    colour_match: ColourCheckerMatch | None = None,
) -> PaintCalibration | PaintWithoutEmission:
    """Fit all families of emission curves to band signals and return the calibration record.

    Where the signals hold no emission beyond reflected laser, leak and stray light there is nothing to fit: the record
    then holds the limit of the yield in place of a spectrum, see :func:`~finray_calib.fit.detect_emission`.

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
    try:
        detection = detect_emission(bands, data, options.prior, seed)
        if not detection.measured:
            return _without_emission(bands, data, detection, options)
        # of the whole process: two fits at the same time in threads of one process would hold each other up
        with threadpool_limits(limits=1, user_api="blas"):  # its matrices are small, and the families fill the cores
            return _calibrate(bands, data, detection, np.random.default_rng(seed), options, other_lights, colour_match)
    except np.linalg.LinAlgError:
        raise FitError(f"the equations of the fit have no solution; {_likely_cause(bands, data)}") from None


def _likely_cause(bands: BandSignals, data: BandData) -> str:
    """Return which input most likely leaves the equations without a solution."""
    laser, optics = bands.optics.laser, bands.optics
    chosen = next((one for one in optics.filters if one.name == optics.excitation_filter), None)
    if chosen is not None and abs(laser.wavelength_nm - chosen.center_nm) > 0.5 * (chosen.fwhm_nm + laser.fwhm_nm):
        return (
            f"the likely cause is the laser's wavelength of {laser.wavelength_nm:g} nm, which the excitation filter "
            f"'{chosen.name}' ({chosen.center_nm:g} nm, {chosen.fwhm_nm:g} nm wide) does not pass; correct one of them"
        )
    if laser.fwhm_nm > _WIDE_LINE_NM:
        return (
            f"the likely cause is the laser's fwhm_nm of {laser.fwhm_nm:g} nm, within which all emission would lie; a "
            f"laser has 1 to 5 nm and an LED at most {_WIDE_LINE_NM:g} nm"
        )
    kept_sd = np.sqrt(np.diag(data.covariance)[data.kept])
    surest = optics.filters[data.weights.band_index[data.kept[np.argmin(kept_sd)]]]
    return (
        f"the likely cause is filter '{surest.name}', whose signals have the smallest standard deviation of all "
        f"({kept_sd.min():.1g} of the white reference); check its curve, its exposures and the noise of the camera"
    )


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
    reported = reported_spectrum(data, options, posterior, rng)
    _require_energy(estimate(reported.quantities.energy_yield), bands)
    independent = options.check_by_emcee and posterior.sampling.chain is None
    check = check_by_chain(posterior, options.settings.chain, rng) if independent else None
    at_laser = estimate(reported.posterior.reflectance_at_laser)
    curve, drawn = curve_bands(reported.curves), reported.curves[:CURVE_DRAWS]
    reflected = reflectance(bands, curve.mean, at_laser) if colour_match is None else colour_match.at_filters
    lights = [_under_other_light(light, fits.chosen, options, rng) for light in other_lights]
    reradiation = paint_absorption(bands, drawn, reflected, lights, rng)
    residuals, measured_sd = band_residuals(bands, reported), np.sqrt(np.diag(data.covariance)).reshape(-1, 3)
    shares = prior_shares(reported, data, options, posterior, rng)
    shares["stokes_shift_nm"] = prior_share(
        AbsorptionPrior().draw(PRIOR_DRAWS, rng)[0], reradiation.stokes_shift_draws_nm
    )
    return PaintCalibration(
        detection=detection,
        **_family_fields(fits, options),
        **_posterior_fields(reported, posterior, curve, bands, rng),
        prior_shares=shares,
        reflectance=reflected,
        reflectance_method=REFLECTANCE_METHOD if colour_match is None else colour_match.statement,
        colour_match=colour_match,
        reradiation=reradiation,
        **_measurement_fields(bands, data, reported),
        measured_sd=measured_sd,
        bands=residuals,
        diagnostics=diagnostics(posterior, check),
        warnings=(
            *fit_warnings(posterior, residuals, check, options.check_by_emcee),
            *energy_warnings(reported),
            *matrix_warnings(bands, drawn, reflected, reradiation),
        ),
    )


def _under_other_light(
    light: BandSignals, family: str, options: FitOptions, rng: np.random.Generator
) -> tuple[float, Floats]:
    """Return the wavelength of another light, nm, and draws of the emission that it excites, (N, L), nm^-1."""
    data = band_data(light)
    reported = reported_spectrum(data, options, fit_family(data, family, options, rng), rng)
    return light.optics.laser.wavelength_nm, reported.curves


def _require_energy(energy_yield: Estimate, bands: BandSignals) -> None:
    """Refuse a paint that emits more light than the laser brings."""
    if energy_yield.low95 > 1.0:
        raise FitError(
            f"'{bands.paint_name}' would emit {energy_yield.estimate:.3g} times the energy of the laser (95 %: at "
            f"least {energy_yield.low95:.3g}), but no paint emits more energy than falls on it; check whether the "
            "level of the white reference under the laser is too low, and whether band signals are in per cent"
        )


def _family_fields(fits: FamilyFits, options: FitOptions) -> dict[str, Any]:
    """Return the fields of the record that tell of the families."""
    others = {**fits.posteriors, f"{PAPER_FAMILY} alone": fits.alone}
    shown = [curve_bands(p.curve_draws.curves) for p in others.values()]
    return {
        "family": fits.chosen,
        "family_title": fits.posterior.family.title,
        "family_choice": fits.why,
        "discrepancy": discrepancy(options.discrepancy),
        "paper": paper_parameters(fits.alone),
        "families": families(others, fits.scores),
        "family_emission_per_nm": np.array([s.mean for s in shown]),
        "family_low95_per_nm": np.array([s.low95 for s in shown]),
        "family_high95_per_nm": np.array([s.high95 for s in shown]),
    }


def _posterior_fields(
    reported: ReportedSpectrum,
    posterior: EmissionPosterior,
    curve: CurveBands,
    bands: BandSignals,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Return the fields of the record that tell of the reported curve and of the family's parameters."""
    prior = posterior.log_posterior.prior
    low, high = simultaneous_band(reported.curves)
    return {
        "spectrum_from": reported.title,
        "parameters": parameters(reported, posterior),
        "prior": dict(zip(prior.names, prior.words, strict=True)),
        "prior_sensitivity": prior_sensitivity(posterior),
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
        "emission_low95_simultaneous_per_nm": low,
        "emission_high95_simultaneous_per_nm": high,
        "emission_draws_per_nm": reported.curves[:CURVE_DRAWS],
        "energy_yield": estimate(reported.quantities.energy_yield),
        "band_integrals": band_integrals(bands, reported.curves),
    }


def _measurement_fields(bands: BandSignals, data: BandData, reported: ReportedSpectrum) -> dict[str, Any]:
    """Return the fields of the record that set what was measured beside what is predicted."""
    return {
        "paint_name": bands.paint_name,
        "optics": bands.optics,
        "usable": data.usable,
        "measured": bands.fluorescence,
        "predicted": reported.posterior.predicted_mean,
        "predicted_sd": reported.posterior.predicted_sd,
        "chi_square": reported.posterior.total_chi2,
        "usable_values": data.kept.size,
    }


def check_by_chain(posterior: EmissionPosterior, settings: SamplerSettings, rng: np.random.Generator) -> ChainCheck:
    """Sample a posterior again with emcee and compare the means with the stored draws.

    Parameters
    ----------
    posterior
        What was fitted.
    settings
        Length and size of the chain.
    rng
        Source of all randomness.
    """
    chain, diagnostics = sample_posterior(posterior.log_posterior, posterior.proposal, settings, rng)
    apart = (chain.mean(axis=0) - posterior.draws.mean(axis=0)) / posterior.draws.std(axis=0, ddof=1)
    return chain_record(posterior.log_posterior.prior.names, diagnostics, apart)


def chain_record(names: Sequence[str], chain: ChainDiagnostics, mean_shift_sd: Floats | None) -> ChainCheck:
    """Return the record of a chain's diagnostics; without shifts where the chain itself made the draws."""

    def by_name(values: Floats) -> dict[str, float]:
        return dict(zip(names, map(float, values), strict=True))

    return ChainCheck(
        walkers=chain.walkers,
        steps=chain.steps,
        converged=chain.converged,
        acceptance_fraction=chain.acceptance,
        autocorrelation_time=by_name(chain.autocorrelation_steps),
        r_hat=by_name(chain.r_hat),
        effective_samples=by_name(chain.bulk_ess),
        mean_shift_sd={} if mean_shift_sd is None else by_name(mean_shift_sd),
    )


LARGEST_SHARE_BELOW_LASER: Final = 0.05
LARGEST_EXCESS_SHARE: Final = 0.8
"""A paint that emits all that it absorbs lies at half: its draws are cut there. Far beyond, the level is wrong."""
_CLOSE_MAXIMA_NATS: Final = 5.0


def fit_warnings(
    posterior: EmissionPosterior, bands: Sequence[BandResidual], check: ChainCheck | None, check_asked: bool
) -> tuple[str, ...]:
    """Say what the fit could not explain, leaves open, or could not sample.

    Parameters
    ----------
    posterior
        What was fitted.
    bands
        How well each filter is explained.
    check
        The independent run of emcee, if there was one.
    check_asked
        Whether one was asked for.
    """
    said = []
    bad = [r.filter_name for r in bands if not r.explained]
    if bad:
        said.append(
            f"the model cannot explain the frames of filter{('s' if len(bad) > 1 else '')} {', '.join(bad)} "
            f"(posterior predictive p < {SMALLEST_P:g}), so the intervals are too narrow; check these frames"
        )
    maxima = posterior.maxima
    close = maxima.theta[maxima.log_posterior > maxima.log_posterior[0] - _CLOSE_MAXIMA_NATS]
    if len(close) > 1:
        modes = ", ".join(f"{theta[0]:.0f}" for theta in close)
        said.append(f"the bands do not decide between {len(close)} maxima of the posterior, with modes at {modes} nm")
    if not posterior.sampling.trusted:
        said.append(
            "the sampling cannot be trusted, because neither importance sampling nor moved draws nor emcee reached "
            "the required quality"
        )
    if check is not None and max(map(abs, check.mean_shift_sd.values())) > LARGEST_CHAIN_SHIFT_SD:
        said.append("emcee disagrees with the stored draws, so do not quote the intervals")
    if check_asked and check is None:
        said.append(
            "the check by emcee was left out, because emcee itself made the draws, and a second run would not be "
            "independent"
        )
    below = float(np.median(posterior.share_below_laser))
    if below > LARGEST_SHARE_BELOW_LASER:
        said.append(
            f"{100 * below:.0f} % of the fitted curve lies below the laser line, where no paint can emit; this part "
            "was cut"
        )
    return tuple(said)


def energy_warnings(reported: ReportedSpectrum) -> tuple[str, ...]:
    """Say where the level of the signals contradicts the conservation of energy."""
    if reported.excess_share <= LARGEST_EXCESS_SHARE:
        return ()
    kept = " and were left out" if reported.conserving else "; too few other draws remain, so that all were kept"
    return (
        f"{100 * reported.excess_share:.0f} % of the draws emit more photons than are absorbed at the laser{kept}: the "
        "signals are brighter than energy allows; check the white reference and the laser's level",
    )


REFLECTANCE_METHOD = (
    "total radiance factor under the lamp minus the light that the paint re-emits, for which the absorption is assumed "
    "to be constant from 380 nm to where the emission begins (half of this light is stated as its uncertainty); at the "
    "laser line, from the reflected laser light"
)
PLATEAU_UNCERTAINTY_REL = 0.5
# The absorption ends where the emission rises to this share of its peak on the blue side.
FOOT_SHARE = 0.10
_NORMAL_68, _NORMAL_95 = 0.994458, 1.959964
# Without a usable channel nothing is known but that a reflectance lies between 0 and 1.
UNKNOWN_REFLECTANCE = Estimate(estimate=0.5, sd=12**-0.5, low68=0.16, high68=0.84, low95=0.025, high95=0.975)


def reflectance(bands: BandSignals, emission_per_nm: Floats, at_laser: Estimate) -> tuple[Estimate, ...]:
    """Return the reflectance at each filter (0..1) with its uncertainty.

    Parameters
    ----------
    bands
        Band signals with total radiance factors under the lamp.
    emission_per_nm
        (L,) fitted emission on :data:`WAVELENGTH_NM`.
    at_laser
        Reflectance at the laser line from the fit; used for the excitation filter.
    """
    variance = np.diag(bands.reflectance_covariance).reshape(-1, 3)
    usable = bands.usable() & (variance > 0)
    response = np.array([[c(f.center_nm) for c in bands.optics.camera_response] for f in bands.optics.filters])
    best = np.where(usable, response, -np.inf).argmax(axis=1)  # the channel that sees most of the band and least leak
    estimates = []
    for b, band in enumerate(bands.optics.filters):
        if band.name == bands.optics.excitation_filter:
            estimates.append(at_laser)
        elif not usable[b].any():
            estimates.append(UNKNOWN_REFLECTANCE)
        else:
            channel = int(best[b])
            emitted = _emitted(bands, b, channel, emission_per_nm)
            sd = float(np.hypot(np.sqrt(variance[b, channel]), PLATEAU_UNCERTAINTY_REL * emitted))
            estimates.append(_within_0_and_1(float(bands.reflectance[b, channel]) - emitted, sd))
    return tuple(estimates)


def _emitted(bands: BandSignals, band: int, channel: int, emission_per_nm: Floats) -> float:
    """Return the re-emitted part of the total radiance factor in one filter and channel."""
    optics = bands.optics
    lamp = optics.lamp(WAVELENGTH_NM)
    passed = transmissions(optics)[band] * optics.camera_response[channel](WAVELENGTH_NM)
    peak = int(emission_per_nm.argmax())
    foot = int(np.argmax(emission_per_nm[: peak + 1] >= FOOT_SHARE * emission_per_nm[peak]))
    photons = lamp * WAVELENGTH_NM / optics.laser.wavelength_nm  # f is what a unit of the laser's energy excites
    absorbed = float(np.trapezoid(photons[: foot + 1], WAVELENGTH_NM[: foot + 1]))
    return float((passed * emission_per_nm).sum() / (passed * lamp).sum()) * absorbed


def _within_0_and_1(value: float, sd: float) -> Estimate:
    """Return a normal estimate; reflectance cannot leave 0..1, so its ends are cut there."""
    low68, high68 = value - _NORMAL_68 * sd, value + _NORMAL_68 * sd
    low95, high95 = value - _NORMAL_95 * sd, value + _NORMAL_95 * sd
    cut = [float(np.clip(v, 0.0, 1.0)) for v in (value, low68, high68, low95, high95)]
    return Estimate(estimate=cut[0], sd=sd, low68=cut[1], high68=cut[2], low95=cut[3], high95=cut[4])
