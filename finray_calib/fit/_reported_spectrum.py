r"""What a fit reports of the emission: draws of the curve, energy conserved, bands, and how much of each is belief.

The draws are those of the learned prior, or of a family that was asked for. Photons are conserved: a draw that emits
more than the laser's light that is absorbed,

.. math:: \int f \frac{\lambda}{\lambda_0}\,d\lambda > 1 - \rho,

has no likelihood. The simultaneous band holds whole curves, m +- q s with q the 95 % point over the draws of
the largest departure in standard deviations; the pointwise one holds 95 % at each wavelength.

A quantity whose variance is hardly smaller than before the measurement was not measured: its prior share is
var(q | y) / var(q), of peak and yield that of their logarithms, at most 1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import PriorShare
from finray_calib.fit._band_data import BandData
from finray_calib.fit._drawn_spectra import SpectrumPosterior, fit_spectrum
from finray_calib.fit._emission import EmissionPosterior
from finray_calib.fit._family_choice import FitOptions
from finray_calib.fit._measured_spectra import components_of, learned_spectra, prior_curves
from finray_calib.spectra import CurveQuantities, curve_quantities, photon_yield

Floats = NDArray[np.float64]

MEASURED_SPECTRA_TITLE: Final = "prior learned from measured spectra"


FEWEST_CONSERVING: Final = 100
"""Draws that conserve energy; with fewer the level of the measurement contradicts it, and none is left out."""
_COUNTED_REL = 0.05
_SD_FLOOR_REL = 0.003
_PRIOR_CURVES = 2000
_LOGARITHMIC = ("fwhm_nm", "peak_per_nm", "energy_yield")
_SHARED = ("mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield")


@dataclass(frozen=True)
class ReportedSpectrum:
    """The emission that is reported.

    Attributes
    ----------
    title
        What it rests on.
    posterior
        Draws of curve, reflectance and calibration, and the check of the bands.
    wavelength_nm
        (L,) grid, nm.
    excess_share
        Share of the draws that emitted more photons than are absorbed and were left out.
    conserving
        Whether enough draws were left; if not, all were kept.
    """

    title: str
    posterior: SpectrumPosterior
    wavelength_nm: Floats
    excess_share: float
    conserving: bool

    @property
    def curves(self) -> Floats:
        """Draws of the emission, (n, L), nm^-1."""
        return self.posterior.curves

    @cached_property
    def quantities(self) -> CurveQuantities:
        """Quantities of each draw."""
        return curve_quantities(self.curves, self.wavelength_nm)


def uses_learned_prior(options: FitOptions) -> bool:
    """Whether the learned prior is reported: no family was asked for, and paints may leave their family."""
    return options.family is None and options.discrepancy.acts


def reported_spectrum(
    data: BandData, options: FitOptions, posterior: EmissionPosterior, rng: np.random.Generator
) -> ReportedSpectrum:
    """Return what is reported: the learned prior's posterior, or that of the family that was asked for.

    Parameters
    ----------
    data
        Band values of the region.
    options
        What to fit.
    posterior
        Of the family.
    rng
        Source of all randomness.
    """
    if uses_learned_prior(options):
        title = MEASURED_SPECTRA_TITLE
        found = fit_spectrum(
            data, options.spectra or learned_spectra(), options.prior.ln_blocking_sd, len(posterior.draws), rng
        )
    else:
        title, found = posterior.family.title, _of_family(posterior)
    return _conserving(title, found, data)


def _of_family(posterior: EmissionPosterior) -> SpectrumPosterior:
    """Return the posterior of a family in the form of the learned one."""
    check, sample = posterior.bands, posterior.sampling.sample
    bands = posterior.log_posterior.data.weights.bands
    return SpectrumPosterior(
        curves=posterior.curve_draws.curves,
        reflectance_at_laser=posterior.reflectance_at_laser,
        imperfections=posterior.curve_draws.imperfections[:, :bands],
        ln_evidence=sample.ln_evidence,
        effective=1.0,
        chi2=check.chi2,
        degrees_of_freedom=check.degrees_of_freedom,
        p_value=check.p_value,
        total_chi2=check.total_chi2,
        predicted_mean=check.predicted_mean,
        predicted_sd=check.predicted_sd,
        components=np.empty(0, np.int64),
        band_draws=np.empty((0, 0)),
    )


def _conserving(title: str, found: SpectrumPosterior, data: BandData) -> ReportedSpectrum:
    """Leave out draws that emit more photons than are absorbed; fill up by repeating what is left in order."""
    good = _conserves(found, data)
    kept = conserving_draws(found, data)
    conserving = int(good.sum()) >= min(FEWEST_CONSERVING, good.size)
    return ReportedSpectrum(title, kept, data.weights.wavelength_nm, float(1 - good.mean()), conserving)


def _conserves(found: SpectrumPosterior, data: BandData) -> NDArray[np.bool_]:
    """Return which draws (n,) emit no more photons than are absorbed."""
    emitted = photon_yield(found.curves, data.weights.wavelength_nm, data.weights.laser_nm)
    return np.asarray(emitted <= 1 - found.reflectance_at_laser)


def conserving_draws(found: SpectrumPosterior, data: BandData) -> SpectrumPosterior:
    """Return the draws with those that emit too many photons replaced by others; all, where too few are left.

    Parameters
    ----------
    found
        Draws of the posterior.
    data
        Band values of the region.
    """
    good = _conserves(found, data)
    kept = np.flatnonzero(good)
    if kept.size == good.size or kept.size < min(FEWEST_CONSERVING, good.size):
        return found
    rows = np.where(good, np.arange(good.size), np.resize(kept, good.size))
    return replace(
        found,
        curves=found.curves[rows],
        reflectance_at_laser=found.reflectance_at_laser[rows],
        imperfections=found.imperfections[rows],
        components=found.components[rows] if found.components.size else found.components,
        band_draws=found.band_draws[rows] if found.band_draws.size else found.band_draws,
    )


def simultaneous_band(curves: Floats) -> tuple[Floats, Floats]:
    """Return the lower and upper limit (L,) of the band that holds 95 % of the draws (n, L) as whole curves.

    Counted where the mean exceeds 5 % of its peak; standard deviations below 0.3 % of the peak count as that.

    References
    ----------
    Crainiceanu, Ruppert, Carroll, Joy, Goodner, Spatially adaptive Bayesian penalized splines, Journal of
    Computational and Graphical Statistics 16 (2007) 265-288.
    """
    mean = curves.mean(axis=0)
    sd = curves.std(axis=0, ddof=1) + _SD_FLOOR_REL * mean.max()
    counted = mean > _COUNTED_REL * mean.max()
    largest = (np.abs(curves - mean)[:, counted] / sd[counted]).max(axis=1)
    reach = float(np.quantile(largest, 0.95)) * sd
    return np.maximum(mean - reach, 0.0), mean + reach


def prior_shares(
    reported: ReportedSpectrum,
    data: BandData,
    options: FitOptions,
    posterior: EmissionPosterior,
    rng: np.random.Generator,
) -> dict[str, PriorShare]:
    """Return how much of mode, width, peak and yield is prior, by name.

    Parameters
    ----------
    reported
        What is reported.
    data
        Band values of the region.
    options
        What was fitted.
    posterior
        Of the family, whose prior counts where it is reported.
    rng
        Of the prior draws.
    """
    weights = data.weights
    if uses_learned_prior(options):
        parts = components_of(options.spectra or learned_spectra(), weights.wavelength_nm, weights.laser_nm)
        curves = prior_curves(parts, _PRIOR_CURVES, rng)
    else:
        drawn = posterior.log_posterior.prior.draw(_PRIOR_CURVES, rng)
        curves = posterior.family.curves(drawn, weights.wavelength_nm) * (weights.wavelength_nm >= weights.laser_nm)
        curves = curves[curves.max(axis=1) > 0]
    before, after = _scaled(curve_quantities(curves, reported.wavelength_nm)), _scaled(reported.quantities)
    return {name: prior_share(before[name], after[name]) for name in _SHARED}


def _scaled(quantities: CurveQuantities) -> Mapping[str, Floats]:
    """Return quantities, those of scale as logarithms."""
    every = {name: np.asarray(getattr(quantities, name)) for name in _SHARED}
    return {n: np.log(np.maximum(v, 1e-12)) if n in _LOGARITHMIC else v for n, v in every.items()}


def prior_share(before: Floats, after: Floats) -> PriorShare:
    """Return what the measurement has left of the prior of one quantity.

    Parameters
    ----------
    before, after
        Draws of prior and posterior.
    """
    sd = float(before.std())
    return PriorShare(
        share=min(1.0, float(after.var()) / max(sd**2, 1e-300)),
        shift_sd=float(after.mean() - before.mean()) / max(sd, 1e-150),
    )
