"""From band signals to the stored paint calibration."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from data_schemas.curves import HELD_UNCERTAINTY_REL
from data_schemas.fit import BandResidual, Diagnostics, Estimate, PaintCalibration
from data_schemas.radiometry import BandSignals
from finray_calib.fit.band_model import PARAMETER_NAMES
from finray_calib.fit.emission import EmissionPosterior, fit_emission
from finray_calib.fit.likelihood import BandData
from finray_calib.fit.prior import EmissionPrior
from finray_calib.fit.reflectance import METHOD, reflectance
from finray_calib.fit.sampler import SamplerSettings
from finray_calib.fit.summary import summarise
from finray_calib.spectra.band_tolerances import tolerances_of
from finray_calib.spectra.rig_curves import WAVELENGTH_NM, held_shares, weights_of

Floats = NDArray[np.float64]
FAMILY = "zheng2014 (skew-Cauchy, the paper's)"
BAND_CALIBRATION_REL = 0.01
# What a region's photon noise does not know: the shape of each channel's response inside a band, and stray light in
# camera and enclosure. Without them a tail of a thousandth of the peak would be trusted to a hundredth of itself.
CHANNEL_RESPONSE_REL = 0.003
STRAY_LIGHT_REL = 0.003
PRIOR_DRAWS = 2000
SMALLEST_P = 0.01
LARGEST_SHARE_BELOW_LASER = 0.05


def calibrate_paint(
    bands: BandSignals,
    seed: int,
    prior: EmissionPrior | None = None,
    settings: SamplerSettings | None = None,
) -> PaintCalibration:
    """Fit the paper's emission family to band signals and return the calibration record.

    Parameters
    ----------
    bands
        Band signals of one paint.
    seed
        Seed of the starts and of the sampler.
    prior, settings
        Prior and sampler settings; defaults are documented in their classes.

    Raises
    ------
    FitError
        Fewer than four usable bands, or values that are not numbers.
    """
    prior, settings = prior or EmissionPrior(), settings or SamplerSettings()
    rng = np.random.default_rng(seed)
    data = BandData(
        y=bands.fluorescence,
        covariance=bands.fluorescence_covariance + _channel_covariance(bands),
        usable=bands.usable(),
        weights=weights_of(bands.optics, bands.channel_weights),
        band_calibration_rel=BAND_CALIBRATION_REL,
        tolerances=tolerances_of(bands.optics, bands.channel_weights),
    )
    posterior = fit_emission(data, prior, settings, rng)
    curve = posterior.spectrum_bands(WAVELENGTH_NM)
    at_laser = _estimate(posterior.reflectance_at_laser)
    predicted, sd = posterior.bands.predicted_mean, posterior.bands.predicted_sd
    residuals = _residuals(bands, posterior)
    diagnostics = _diagnostics(posterior, settings)
    return PaintCalibration(
        paint_name=bands.paint_name,
        family=FAMILY,
        parameters=_parameters(posterior),
        prior=_prior_in_words(prior),
        sampled=PARAMETER_NAMES,
        map_estimate=dict(zip(PARAMETER_NAMES, map(float, posterior.map_estimate), strict=True)),
        draws=posterior.draws,
        prior_draws=prior.draw(PRIOR_DRAWS, rng),
        wavelength_nm=WAVELENGTH_NM,
        emission_per_nm=curve.mean,
        emission_low95_per_nm=curve.low95,
        emission_high95_per_nm=curve.high95,
        emission_low68_per_nm=curve.low68,
        emission_high68_per_nm=curve.high68,
        energy_yield=_estimate(posterior.energy_yield),
        reflectance=reflectance(bands, curve.mean, at_laser),
        reflectance_method=METHOD,
        optics=bands.optics,
        usable=bands.usable(),
        measured=bands.fluorescence,
        measured_sd=np.sqrt(np.diag(data.covariance)).reshape(-1, 3),
        predicted=predicted,
        predicted_sd=sd,
        bands=residuals,
        chi_square=posterior.bands.total_chi2,
        degrees_of_freedom=data.kept.size - len(PARAMETER_NAMES),
        diagnostics=diagnostics,
        warnings=_warnings(posterior, residuals, diagnostics),
    )


def _channel_covariance(bands: BandSignals) -> Floats:
    """Return the variances of channel response, held ends of curves, and stray light.

    Stray light is relative to the brightest emission band. Where a curve holds its end value, that share of the
    band's weight carries a relative uncertainty of 0.5.
    """
    y, usable = bands.fluorescence, bands.usable()
    emission = usable & np.array([[f.name != bands.optics.excitation_filter] for f in bands.optics.filters])
    brightest = float(np.abs(y[emission]).max()) if emission.any() else 0.0
    relative = np.hypot(CHANNEL_RESPONSE_REL, HELD_UNCERTAINTY_REL * held_shares(bands.optics))
    return np.diag(((relative * y) ** 2 + (STRAY_LIGHT_REL * brightest) ** 2).ravel())


def _estimate(draws: Floats) -> Estimate:
    """Return the record of a posterior summary."""
    summary = summarise(draws)
    return Estimate(
        estimate=summary.estimate,
        sd=summary.sd,
        low68=summary.low68,
        high68=summary.high68,
        low95=summary.low95,
        high95=summary.high95,
    )


def _parameters(posterior: EmissionPosterior) -> dict[str, Estimate]:
    """Summarise the sampled parameters, the quantities of the curve and the paper's symbols."""
    quantities: Mapping[str, Floats] = {
        **{name: posterior.draws[:, i] for i, name in enumerate(PARAMETER_NAMES)},
        "mode_nm": posterior.mode_nm,
        "fwhm_nm": posterior.fwhm_nm,
        "peak_per_nm": posterior.peak_per_nm,
        "location_nm": posterior.location_nm,
        "scale_nm": posterior.scale_nm,
        "skewness": posterior.skewness,
        "amplitude_nm": posterior.amplitude_nm,
        "reflectance_at_laser": posterior.reflectance_at_laser,
        "share_below_laser": posterior.share_below_laser,
    }
    return {name: _estimate(draws) for name, draws in quantities.items()}


def _prior_in_words(prior: EmissionPrior) -> dict[str, str]:
    """Describe the prior of each sampled parameter."""
    p = prior
    texts = (
        f"normal({p.mode_mean_nm:g}, {p.mode_sd_nm:g}) nm, cut to {p.mode_low_nm:g}..{p.mode_high_nm:g} nm",
        f"log-normal, median {p.fwhm_median_nm:g} nm, sd of the logarithm {p.ln_fwhm_sd:g}",
        f"normal(0, {p.kappa_sd:g}), cut to +-{p.kappa_limit:g}",
        f"log-normal, median {p.peak_median_per_nm:g} 1/nm, sd of the logarithm {p.ln_peak_sd:g}",
        f"log-normal, median {p.reflected_laser_median:g}, sd of the logarithm {p.ln_reflected_laser_sd:g}",
        f"log-normal multiplier of the filters' blocking, median 1, sd of the logarithm {p.ln_blocking_sd:g}",
    )
    return dict(zip(PARAMETER_NAMES, texts, strict=True))


def _residuals(bands: BandSignals, posterior: EmissionPosterior) -> tuple[BandResidual, ...]:
    """Return how well each filter is explained; a filter without usable channels has no degrees of freedom."""
    check = posterior.bands
    return tuple(
        BandResidual(
            filter_name=band.name,
            center_nm=band.center_nm,
            chi_square=float(np.nan_to_num(check.chi2[b])),
            degrees_of_freedom=int(check.degrees_of_freedom[b]),
            posterior_predictive_p=float(np.nan_to_num(check.p_value[b], nan=1.0)),
        )
        for b, band in enumerate(bands.optics.filters)
    )


def _diagnostics(posterior: EmissionPosterior, settings: SamplerSettings) -> Diagnostics:
    """Return the record of the chain's convergence."""
    chain = posterior.diagnostics

    def by_name(values: Floats) -> dict[str, float]:
        return dict(zip(PARAMETER_NAMES, map(float, values), strict=True))

    return Diagnostics(
        walkers=settings.walkers,
        steps=chain.steps,
        converged=chain.converged,
        acceptance_fraction=float(chain.acceptance),
        autocorrelation_time=by_name(chain.autocorrelation_steps),
        r_hat=by_name(chain.r_hat),
        effective_samples=by_name(chain.bulk_ess),
        maxima=tuple(float(v) for v in posterior.maxima.log_posterior),
    )


def _warnings(
    posterior: EmissionPosterior, residuals: tuple[BandResidual, ...], diagnostics: Diagnostics
) -> tuple[str, ...]:
    """Say what a reader of the numbers must know."""
    warnings = []
    bad = [r.filter_name for r in residuals if r.posterior_predictive_p < SMALLEST_P]
    if bad:
        warnings.append(
            f"the family cannot explain filter{'s' if len(bad) > 1 else ''} {', '.join(bad)} (posterior predictive p < "
            f"{SMALLEST_P:g}): the paint is not of this family and the intervals are too narrow"
        )
    if len(diagnostics.maxima) > 1 and diagnostics.maxima[0] - diagnostics.maxima[1] < 5:
        warnings.append(f"the bands leave an ambiguity: {len(diagnostics.maxima)} maxima of the posterior")
    if not diagnostics.converged:
        warnings.append("the chain has not converged: use more steps before quoting the intervals")
    below = float(np.median(posterior.share_below_laser))
    if below > LARGEST_SHARE_BELOW_LASER:
        warnings.append(f"{below:.0%} of the fitted emission lies below the laser line, which no paint can do")
    return tuple(warnings)
