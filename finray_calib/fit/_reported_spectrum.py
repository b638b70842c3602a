r"""What a fit reports of the emission: draws of the curve, energy conserved, bands, and how much of each is belief.

The draws are those of the learned prior, or of a family that was asked for. Photons are conserved: a draw that emits
more than the laser's light that is absorbed,

.. math:: \int f \frac{\lambda}{\lambda_0}\,d\lambda > 1 - \rho,

has no likelihood. The simultaneous band holds whole curves, m +- q s with q the 95 % point over the draws of
the largest departure in standard deviations; the pointwise one holds 95 % at each wavelength.

A quantity whose variance is hardly smaller than before the measurement was not measured: its prior share is
var(q | y) / var(q), of peak and yield that of their logarithms, at most 1.

Under the learned prior, given its component c, a curve f is normal before and after the measurement, and its departures
take it below zero, where no paint emits less than nothing. What a fit reports is the cut curve, and the cut adds light
to the bands: by itself it would leave the measured values by more than their errors allow. The paint is therefore what
is cut, and reported are draws of

.. math:: p(c, f, \rho \mid y) = p(c \mid y)\,
          \frac{p(f, \rho \mid c)\, N(y;\, A \max(f, 0) + \rho l, N)}{\int p(f', \rho' \mid c)\,
          N(y;\, A \max(f', 0) + \rho' l, N)\, df'\, d\rho'}

with p(c | y) of the normal curves, before the cut. Draws of the normal posterior are exchanged for others of their
component by the rule of Metropolis, whose weight is the ratio of both likelihoods, and nothing where height or
reflectance are below zero:

.. math:: w(f, \rho) = N(y;\, A \max(f, 0) + \rho l, N) / N(y;\, A f + \rho l, N)

An exchange leaves that distribution as it is, and as many as are made here come close to it (docs/verification.md).
Weighted by w over all components, as the evidence of cut curves would be, few draws in a hundred would count.

L. Tierney, Markov chains for exploring posterior distributions, Annals of Statistics 22 (1994) 1701-1728: the
independence chain.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import Estimate, PriorShare
from finray_calib.fit._band_data import BandData
from finray_calib.fit._emission import FEWEST_DRAWS, EmissionPosterior, estimate
from finray_calib.fit._family_choice import FitOptions
from finray_calib.fit._measured_spectra import (
    MeasuredSpectra,
    Rig,
    ScoredSpectra,
    components_of,
    learned_spectra,
    prior_curves,
    scored_components,
)
from finray_calib.fit._prior import chi_square_of_bands
from finray_calib.spectra import CurveQuantities, curve_quantities, photon_yield

Floats = NDArray[np.float64]

MEASURED_SPECTRA_TITLE: Final = "prior learned from measured spectra"

_EXCHANGES: Final = 8
"""Proposals for each draw; where a paint emits nothing over wide ranges, a quarter of them are accepted."""
_NO_WEIGHT: Final = -1e100
"""Logarithm of the weight of what cannot be; finite, so that its difference from itself is a number."""
_AT_ONCE: Final = 2000
"""Draws whose proposals are held in memory together: 18,000 curves, 60 MB."""

FEWEST_CONSERVING: Final = 100
"""Draws that conserve energy; with fewer the level of the measurement contradicts it, and none is left out."""
_COUNTED_REL = 0.05
_PROMINENCE_REL = 0.05
_SD_FLOOR_REL = 0.003
_PRIOR_CURVES = 2000
_LOGARITHMIC = ("fwhm_nm", "peak_per_nm", "energy_yield")
_SHARED = ("mode_nm", "fwhm_nm", "peak_per_nm", "energy_yield")


@dataclass(frozen=True)
class SpectrumPosterior:
    """Posterior of the emission under the learned prior.

    Attributes
    ----------
    curves
        (n, L) draws, nm^-1, of 0 or more, zero below the laser.
    reflectance_at_laser
        (n,) draws.
    imperfections
        (n, B) draws of the calibration of each band, in prior standard deviations.
    ln_evidence
        Of the prior, nats.
    effective
        How many components share the posterior.
    chi2, degrees_of_freedom, p_value
        (B,) posterior mean chi-square of each band, its usable channels, and posterior predictive probability of a
        larger one; NaN where no channel is usable.
    total_chi2
        Posterior mean chi-square of all values.
    predicted_mean, predicted_sd
        (B, C) predicted band values, noise left out of the standard deviation.
    components, band_draws
        (n,) component of each draw, and (n, K) the values of the usable bands that its curve gives without any error;
        empty where no component made it.
    """

    curves: Floats
    reflectance_at_laser: Floats
    imperfections: Floats
    ln_evidence: float
    effective: float
    chi2: Floats
    degrees_of_freedom: NDArray[np.int64]
    p_value: Floats
    total_chi2: float
    predicted_mean: Floats
    predicted_sd: Floats
    components: NDArray[np.int64]
    band_draws: Floats


def fit_spectrum(
    data: BandData, spectra: MeasuredSpectra, ln_blocking_sd: float, draws: int, rng: np.random.Generator
) -> SpectrumPosterior:
    """Return draws of the emission under the learned prior.

    Two passes: all components with one size of the departure and the filters' tolerances at a paint that only reflects,
    then the best with all sizes and a second dye, and with the tolerances at the mean of the first.

    Parameters
    ----------
    data
        Band values with covariance, usable entries and the rig's weights.
    spectra
        What was learned.
    ln_blocking_sd
        Uncertainty of the filters' blocking, as the logarithm of a multiplier around 1.
    draws
        Number of draws.
    rng
        Source of all randomness.
    """
    return draw_spectra(scored_components(data, spectra, ln_blocking_sd), draws, rng)


def draw_spectra(fitted: ScoredSpectra, draws: int, rng: np.random.Generator) -> SpectrumPosterior:
    """Draw component, height and departures, nowhere below zero, and check the bands.

    Parameters
    ----------
    fitted
        The mixture.
    draws
        Number of draws.
    rng
        Source of all randomness.
    """
    rig, scored, columns, data = fitted.rig, fitted.scored, fitted.columns, fitted.rig.data
    picked = rng.choice(scored.chosen.size, draws, p=scored.weight)
    curves, both, paint = draw_components(fitted, picked, rng)
    predicted = fitted.bands[scored.chosen[picked]] * both[:, :1] + rig.laser * both[:, 1:]
    # what is uncertain beside noise and paint, given their sum
    pulls = rng.standard_normal((draws, columns.shape[1]))
    noise_root = np.linalg.cholesky(data.covariance[np.ix_(data.kept, data.kept)])
    left = rig.y - paint - pulls @ columns.T - rng.standard_normal(paint.shape) @ noise_root.T
    pulls += left @ np.linalg.solve(fitted.noise, columns)
    return SpectrumPosterior(
        curves,
        both[:, 1],
        pulls[:, : data.weights.bands],
        scored.ln_evidence,
        float(1 / (scored.weight**2).sum()),
        *_checked(rig, predicted, scored.inverse[picked]),
        components=picked,
        band_draws=paint,
    )


def draw_components(
    fitted: ScoredSpectra, picked: NDArray[np.int64], rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Return one draw of each component picked: curve (n, L), height and reflectance (n, 2), bands (n, K).

    Parameters
    ----------
    fitted
        The mixture.
    picked
        (n,) scored components, each as often as it is to be drawn.
    rng
        Source of all randomness.
    """
    rig, draws = fitted.rig, picked.size
    curves, both, paint = np.empty((draws, rig.emission.shape[1])), np.empty((draws, 2)), np.empty((draws, rig.y.size))
    for rows in np.array_split(np.argsort(picked), max(1, -(-draws // _AT_ONCE))):
        curves[rows], both[rows], paint[rows] = _cut_draws(fitted, picked[rows], rng)
    return curves, both, paint


def _cut_draws(
    fitted: ScoredSpectra, picked: NDArray[np.int64], rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Return one cut curve of each component picked, its height and reflectance, and its bands without error."""
    signed, both, positive, bands = _normal_draws(fitted, np.tile(picked, 1 + _EXCHANGES), rng)
    curves = np.maximum(signed, 0.0)
    paint = bands + (curves - signed) @ fitted.rig.emission.T
    ln = np.where(positive, _chi_square(fitted, bands) / 2 - _chi_square(fitted, paint) / 2, _NO_WEIGHT)
    kept = np.arange(picked.size)
    for proposed in np.arange(picked.size, ln.size).reshape(_EXCHANGES, -1):
        accepted = -rng.standard_exponential(picked.size) < ln[proposed] - ln[kept]
        kept = np.where(accepted, proposed, kept)
    return curves[kept], both[kept], paint[kept]


def _normal_draws(
    fitted: ScoredSpectra, picked: NDArray[np.int64], rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.bool_], Floats]:
    """Return the same of the normal posterior, by Matheron's rule, and whether height and reflectance are positive.

    Where they are not, their sizes are taken, so that something is left where no draw is positive.
    """
    rig, scored = fitted.rig, fitted.scored
    roots = np.linalg.cholesky(np.linalg.inv(scored.precision[picked]))
    both = scored.height[picked] + np.einsum("nij,nj->ni", roots, rng.standard_normal((picked.size, 2)))
    positive, both = (both > 0).all(axis=1), np.abs(both)
    noise = rng.standard_normal((picked.size, rig.y.size)) @ np.linalg.cholesky(fitted.noise).T
    curves = np.empty((picked.size, fitted.parts.wavelength_nm.size))
    bands = fitted.bands[scored.chosen[picked]] * both[:, :1] + rig.laser * both[:, 1:]
    for p in np.unique(picked):
        rows = np.flatnonzero(picked == p)
        v = fitted.directions(int(p))
        seen = v @ rig.emission.T
        z = rng.standard_normal((rows.size, len(v)))
        misfit = rig.y - bands[rows] - z @ seen - noise[rows]
        z += misfit @ scored.inverse[p] @ seen.T
        curves[rows] = fitted.parts.curves[scored.chosen[p]] * both[rows, :1] + z @ v
        bands[rows] += z @ seen
    return curves, both, positive, bands


def _chi_square(fitted: ScoredSpectra, bands: Floats) -> Floats:
    """Return the chi-square (n,) of the measured bands about (n, K) others."""
    whitened = (fitted.rig.y - bands) @ np.linalg.cholesky(np.linalg.inv(fitted.noise))
    return np.asarray((whitened**2).sum(axis=1))


def _checked(
    rig: Rig, predicted: Floats, inverses: Floats
) -> tuple[Floats, NDArray[np.int64], Floats, float, Floats, Floats]:
    """Return chi-square, channels and predictive p of each band, the total, and mean and sd of the prediction."""
    data, residual = rig.data, rig.y - predicted
    some = slice(None, None, max(1, len(predicted) // 200))
    residual, covariance = residual[some], np.linalg.inv(inverses[some])
    checks = chi_square_of_bands(residual, covariance, data.weights.band_index[data.kept], data.weights.bands)
    total = float(np.einsum("ni,nij,nj->n", residual, inverses[some], residual).mean())
    mean, sd = np.zeros(data.y.size), np.zeros(data.y.size)
    mean[data.kept] = predicted.mean(axis=0)
    measured = np.diag(data.covariance)[data.kept]
    variance = predicted.var(axis=0, ddof=1) + np.diagonal(covariance, axis1=1, axis2=2).mean(axis=0) - measured
    sd[data.kept] = np.sqrt(np.maximum(variance, 0.0))
    return *checks, total, mean.reshape(data.y.shape), sd.reshape(data.y.shape)


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
    good = conserves(found.curves, found.reflectance_at_laser, data)
    kept = conserving_draws(found, data)
    conserving = int(good.sum()) >= min(FEWEST_CONSERVING, good.size)
    return ReportedSpectrum(title, kept, data.weights.wavelength_nm, float(1 - good.mean()), conserving)


def conserves(curves: Floats, reflectance: Floats, data: BandData) -> NDArray[np.bool_]:
    """Return which of curves (n, L) with reflectances (n,) emit no more photons than are absorbed."""
    emitted = photon_yield(curves, data.weights.wavelength_nm, data.weights.laser_nm)
    return np.asarray(emitted <= 1 - reflectance)


def conserving_draws(found: SpectrumPosterior, data: BandData) -> SpectrumPosterior:
    """Return the draws with those that emit too many photons replaced by others; all, where too few are left.

    Parameters
    ----------
    found
        Draws of the posterior.
    data
        Band values of the region.
    """
    good = conserves(found.curves, found.reflectance_at_laser, data)
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


@dataclass(frozen=True, slots=True)
class TwoMaxima:
    """Two maxima of an emission spectrum, as a paint of two dyes has them, in the draws that have two.

    Attributes
    ----------
    probability
        Share of the draws that have at least two.
    first_nm, second_nm
        Places of the two highest, by wavelength.
    second_to_first
        Height of the second over that of the first.
    """

    probability: float
    first_nm: Estimate
    second_nm: Estimate
    second_to_first: Estimate


def two_maxima(wavelength_nm: Floats, curves: Floats) -> TwoMaxima | None:
    """Return the two highest maxima of drawn spectra (n, L), or None where fewer than half of them have two.

    None, too, where fewer than 100 have two: an interval needs as many. A maximum counts where the curve falls by 5 %
    of its peak on both sides before it rises higher.
    """
    from scipy.signal import find_peaks

    found = []
    for curve in curves:
        peaks, _ = find_peaks(curve, prominence=_PROMINENCE_REL * curve.max())
        if len(peaks) > 1:
            first, second = np.sort(peaks[np.argsort(curve[peaks])[-2:]])
            found.append((wavelength_nm[first], wavelength_nm[second], curve[second] / curve[first]))
    if len(found) < max(FEWEST_DRAWS, len(curves) / 2):
        return None
    first_nm, second_nm, ratio = (estimate(column) for column in np.array(found).T)
    return TwoMaxima(len(found) / len(curves), first_nm, second_nm, ratio)


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
