"""What is believed about a fluorescent paint before its bands are measured."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from data_schemas.errors import FitError
from finray_calib.spectra.skew_cauchy import KAPPA_LIMIT

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class EmissionPrior:
    """Independent normal priors of the six parameters; mode and kappa are truncated.

    Attributes
    ----------
    mode_mean_nm, mode_sd_nm
        Mode of the emission, nm: visible fluorescent paints under blue light emit between cyan and deep red.
    mode_low_nm, mode_high_nm
        Truncation of the mode, nm: above the laser, and within reach of the last filter's tail.
    fwhm_median_nm, ln_fwhm_sd
        Full width at half maximum: paints measure 38 to 60 nm; the sd of the logarithm covers 20 to 100 nm.
    kappa_sd, kappa_limit
        asinh(skewness): centred on symmetry, truncated at plus and minus the limit.
    peak_median_per_nm, ln_peak_sd
        Height of the bispectral radiance factor, nm^-1: 0.003 over 50 nm re-emits some 15 % of the light.
    reflected_laser_median, ln_reflected_laser_sd
        Reflectance at the laser line: measured paints lie between 0.03 and 0.6.
    ln_blocking_sd
        Uncertainty of the filters' blocking, as the logarithm of a multiplier around 1.

    Raises
    ------
    FitError
        When a width or median is not positive, the truncation is empty or kappa_limit is above KAPPA_LIMIT.
    """

    mode_mean_nm: float = 560.0
    mode_sd_nm: float = 60.0
    mode_low_nm: float = 470.0
    mode_high_nm: float = 720.0
    fwhm_median_nm: float = 45.0
    ln_fwhm_sd: float = 0.4
    kappa_sd: float = 1.5
    kappa_limit: float = 6.0
    peak_median_per_nm: float = 0.003
    ln_peak_sd: float = 1.2
    reflected_laser_median: float = 0.1
    ln_reflected_laser_sd: float = 1.5
    ln_blocking_sd: float = 1.0

    def __post_init__(self) -> None:
        positive = (self.fwhm_median_nm, self.peak_median_per_nm, self.reflected_laser_median, self.kappa_limit)
        if not (min(positive) > 0 and (self.sd > 0).all()):
            raise FitError("emission prior: every median, limit and standard deviation must be positive")
        if not self.mode_low_nm < self.mode_high_nm:
            raise FitError(
                f"emission prior: mode_low_nm {self.mode_low_nm:g} nm must be below "
                f"mode_high_nm {self.mode_high_nm:g} nm"
            )
        if self.kappa_limit > KAPPA_LIMIT:
            raise FitError(f"emission prior: kappa_limit {self.kappa_limit:g} must be at most {KAPPA_LIMIT:g}")

    @cached_property
    def mean(self) -> FloatArray:
        """Means of the normals before truncation, (6,)."""
        logs = np.log([self.peak_median_per_nm, self.reflected_laser_median])
        return np.array([self.mode_mean_nm, np.log(self.fwhm_median_nm), 0.0, *logs, 0.0])

    @cached_property
    def sd(self) -> FloatArray:
        """Standard deviations of the normals before truncation, (6,)."""
        return np.array(
            [
                self.mode_sd_nm,
                self.ln_fwhm_sd,
                self.kappa_sd,
                self.ln_peak_sd,
                self.ln_reflected_laser_sd,
                self.ln_blocking_sd,
            ]
        )

    @cached_property
    def low(self) -> FloatArray:
        """Lower truncation, (6,), minus infinity where there is none."""
        return np.array([self.mode_low_nm, -np.inf, -self.kappa_limit, -np.inf, -np.inf, -np.inf])

    @cached_property
    def high(self) -> FloatArray:
        """Upper truncation, (6,), infinity where there is none."""
        return np.array([self.mode_high_nm, np.inf, self.kappa_limit, np.inf, np.inf, np.inf])

    @cached_property
    def _ln_norm(self) -> float:
        """Logarithm of the normalisation of the truncated normals."""
        inside = ndtr((self.high - self.mean) / self.sd) - ndtr((self.low - self.mean) / self.sd)
        return -float(np.log(self.sd * np.sqrt(2 * np.pi) * inside).sum())

    def contains(self, theta: FloatArray) -> NDArray[np.bool_]:
        """Return which of the (n, 6) parameter rows lie inside the truncation."""
        return np.asarray(((theta >= self.low) & (theta <= self.high)).all(axis=1))

    def log_density(self, theta: FloatArray) -> FloatArray:
        """Return the normalised log density of (n, 6) parameter rows, minus infinity outside the truncation.

        Sum over parameters of ln N(theta; mean, sd) - ln P(low < theta < high).
        """
        z = (theta - self.mean) / self.sd
        return np.where(self.contains(theta), self._ln_norm - 0.5 * (z**2).sum(axis=1), -np.inf)

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count, 6) independent draws, by inversion of the truncated distribution functions."""
        below, above = (ndtr((limit - self.mean) / self.sd) for limit in (self.low, self.high))
        return np.asarray(self.mean + self.sd * ndtri(below + (above - below) * rng.random((count, 6))))
