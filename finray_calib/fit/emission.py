"""Fit the emission of one paint: from band values to posterior draws with their diagnostics."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.band_model import PARAMETER_NAMES, emission_curves
from finray_calib.fit.diagnostics import ChainDiagnostics
from finray_calib.fit.likelihood import BandData, LogPosterior
from finray_calib.fit.map_search import Maxima, find_maxima
from finray_calib.fit.mixture_proposal import MixtureProposal
from finray_calib.fit.predictive import BandCheck, check_bands
from finray_calib.fit.prior import EmissionPrior
from finray_calib.fit.sampler import SamplerSettings, sample_posterior
from finray_calib.spectra.band_weights import read_only
from finray_calib.spectra.skew_cauchy import from_mode_parameters, share_below

FloatArray = NDArray[np.float64]

_REFERENCE_ROUNDS = 2
"""The filters' tolerances act at the best fit; the first round starts from calibration errors alone."""

YIELD_END_NM = 780.0
"""The energy yield is counted from the laser line to here, nm: the end of the visible."""


@dataclass(frozen=True, slots=True)
class SpectrumBands:
    """Pointwise posterior of the emission curve, each field (L,) in nm^-1: mean and equal-tailed limits."""

    mean: FloatArray
    low95: FloatArray
    high95: FloatArray
    low68: FloatArray
    high68: FloatArray


@dataclass(frozen=True, slots=True)
class EmissionPosterior:
    """Posterior of a paint's emission.

    Attributes
    ----------
    draws
        (N, 6) posterior draws in the order of :attr:`parameter_names`.
    maxima
        All distinct maxima with their log posterior, best first; more than one means that the bands leave a
        real ambiguity.
    diagnostics
        Convergence of the chains.
    bands
        Posterior predictive check of each band.
    laser_nm
        Centroid of the laser line, nm.
    """

    draws: FloatArray
    maxima: Maxima
    diagnostics: ChainDiagnostics
    bands: BandCheck
    laser_nm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "draws", read_only(self.draws))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the columns of the draws."""
        return PARAMETER_NAMES

    @property
    def map_estimate(self) -> FloatArray:
        """Parameters of the highest maximum, (6,)."""
        return np.asarray(self.maxima.theta[0])

    @property
    def mode_nm(self) -> FloatArray:
        """Draws of the wavelength of the maximum, (N,), nm."""
        return np.asarray(self.draws[:, 0])

    @property
    def fwhm_nm(self) -> FloatArray:
        """Draws of the full width at half maximum, (N,), nm."""
        return np.asarray(np.exp(self.draws[:, 1]))

    @property
    def peak_per_nm(self) -> FloatArray:
        """Draws of the height of the maximum, (N,), nm^-1."""
        return np.asarray(np.exp(self.draws[:, 3]))

    @property
    def location_nm(self) -> FloatArray:
        """Draws of l0 of the paper, (N,), nm."""
        return from_mode_parameters(*self.draws[:, :4].T)[0]

    @property
    def scale_nm(self) -> FloatArray:
        """Draws of g (gamma) of the paper, (N,), nm."""
        return from_mode_parameters(*self.draws[:, :4].T)[1]

    @property
    def skewness(self) -> FloatArray:
        """Draws of w (omega) of the paper, (N,)."""
        return np.asarray(np.sinh(self.draws[:, 2]))

    @property
    def amplitude_nm(self) -> FloatArray:
        """Draws of h of the paper, (N,), nm (nm^-1 times nm^2)."""
        return from_mode_parameters(*self.draws[:, :4].T)[3]

    @property
    def reflectance_at_laser(self) -> FloatArray:
        """Draws of the reflectance at the laser line, (N,)."""
        return np.asarray(np.exp(self.draws[:, 4]))

    @property
    def energy_yield(self) -> FloatArray:
        """Draws of the integral of the emission curve from the laser line to 780 nm, (N,), dimensionless.

        Emitted over incident energy relative to a perfect white; above 1 it is not physical.
        """
        area = np.pi * self.amplitude_nm / (2 * self.scale_nm)
        return np.asarray(area * (self._share_below(YIELD_END_NM) - self._share_below(self.laser_nm)))

    @property
    def share_below_laser(self) -> FloatArray:
        """Draws of the share of the curve's area below the laser line, (N,).

        Emission there would gain energy: a large share says that the curve's blue tail is not physical.
        """
        return self._share_below(self.laser_nm)

    def spectrum_bands(self, wavelength_nm: FloatArray) -> SpectrumBands:
        """Return the posterior mean curve and its pointwise 68 % and 95 % limits at (L,) wavelengths, nm.

        Zero below the laser line: no paint emits below its excitation.
        The bands hold what the four-parameter family allows; a real paint may leave the family.
        """
        curves = emission_curves(self.draws, wavelength_nm) * (wavelength_nm >= self.laser_nm)
        low95, low68, high68, high95 = np.quantile(curves, [0.025, 0.16, 0.84, 0.975], axis=0)
        return SpectrumBands(curves.mean(axis=0), low95, high95, low68, high68)

    def _share_below(self, wavelength_nm: float) -> FloatArray:
        """Return draws of the share of the area below a wavelength, (N,)."""
        return share_below((wavelength_nm - self.location_nm) / self.scale_nm, self.skewness)


def fit_emission(
    data: BandData, prior: EmissionPrior, settings: SamplerSettings, rng: np.random.Generator
) -> EmissionPosterior:
    """Return the posterior of a paint's emission from its band values.

    Finds all maxima, then samples p(theta | y) proportional to N(y; mu(theta), C(theta)) prior(theta). Valid as
    far as the paint's emission is a skew-Cauchy curve: read :attr:`EmissionPosterior.bands` before the
    intervals.

    Parameters
    ----------
    data
        Band values with covariance, usable entries and the rig's weights.
    prior
        Prior of the six parameters.
    settings
        Length and size of the sampling.
    rng
        Source of all randomness.

    Returns
    -------
    EmissionPosterior
        Draws, maxima, diagnostics and band checks.
    """
    log_posterior = LogPosterior(data, prior)
    maxima = find_maxima(log_posterior, rng)
    for _ in range(_REFERENCE_ROUNDS if data.tolerances is not None else 0):
        log_posterior = LogPosterior(data, prior, maxima.theta[0])
        maxima = find_maxima(log_posterior, rng)
    proposal = MixtureProposal.around(maxima, prior).adapted(log_posterior, rng)
    draws, diagnostics = sample_posterior(log_posterior, proposal, settings, rng)
    return EmissionPosterior(draws, maxima, diagnostics, check_bands(log_posterior, draws), data.weights.laser_nm)
