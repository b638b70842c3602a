"""What is believed about a fluorescent paint before its bands are measured."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from finray_calib.fit.normal_distribution import normal_cdf, normal_quantile
from finray_calib.spectra.emission_families import COMMON_PARAMETERS, EmissionFamily

FloatArray = NDArray[np.float64]

REFLECTED_LASER = "ln_reflected_laser"
BLOCKING = "ln_blocking"
OWN_LEAK = "leak_{}"
"""Of a filter, by its name: ln(leak over the common one) in its standard deviations."""


@dataclass(frozen=True)
class Prior:
    """Independent truncated normal priors of all sampled parameters.

    Attributes
    ----------
    names
        Names of the D parameters.
    mean, sd
        (D,) of the normals before truncation.
    low, high
        (D,) truncation, infinite where there is none.
    words
        (D,) each prior in words.
    """

    names: tuple[str, ...]
    mean: FloatArray
    sd: FloatArray
    low: FloatArray
    high: FloatArray
    words: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of parameters D."""
        return len(self.names)

    @cached_property
    def ln_norm(self) -> float:
        """Logarithm of the normalisation of the truncated normals."""
        inside = normal_cdf((self.high - self.mean) / self.sd) - normal_cdf((self.low - self.mean) / self.sd)
        return -float(np.log(self.sd * np.sqrt(2 * np.pi) * inside).sum())

    def contains(self, theta: FloatArray) -> NDArray[np.bool_]:
        """Return which of the (n, D) parameter rows lie inside the truncation."""
        return np.asarray(((theta >= self.low) & (theta <= self.high)).all(axis=1))

    def log_density(self, theta: FloatArray) -> FloatArray:
        """Return the normalised log density of (n, D) parameter rows, minus infinity outside the truncation.

        Sum over parameters of ln N(theta; mean, sd) - ln P(low < theta < high).
        """
        z = (theta - self.mean) / self.sd
        return np.where(self.contains(theta), self.ln_norm - 0.5 * (z**2).sum(axis=1), -np.inf)

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count, D) independent draws, by inversion of the truncated distribution functions."""
        below, above = (normal_cdf((limit - self.mean) / self.sd) for limit in (self.low, self.high))
        share = below + (above - below) * rng.random((count, self.size))
        return np.asarray(self.mean + self.sd * normal_quantile(share))

    def widened(self, factor: float) -> Self:
        """Return the prior with all standard deviations multiplied by `factor`."""
        return replace(self, sd=self.sd * factor)


@dataclass(frozen=True, slots=True)
class EmissionPrior:
    """Prior of the quantities that all families share; each family adds its own.

    Attributes
    ----------
    mode_mean_nm, mode_sd_nm
        Mode of the emission, nm: visible fluorescent paints under blue light emit between cyan and deep red.
    mode_low_nm, mode_high_nm
        Truncation of the mode, nm: above the laser, and within reach of the last filter's tail.
    fwhm_median_nm, ln_fwhm_sd
        Full width at half maximum: paints, inks and papers measure 45 to 60 nm; 95 % lie within 28 to 90 nm.
    peak_median_per_nm, ln_peak_sd
        Height of the bispectral radiance factor, nm^-1: 0.003 over 50 nm re-emits some 15 % of the light.
    reflected_laser_median, ln_reflected_laser_sd
        Reflectance at the laser line: measured paints lie between 0.03 and 0.6.
    ln_blocking_sd
        Uncertainty of the filters' blocking, as the logarithm of a multiplier around 1.

    Raises
    ------
    FitError
        When a number is not finite, a standard deviation or median is not positive, or the truncation is empty.
    """

    mode_mean_nm: float = 560.0
    mode_sd_nm: float = 60.0
    mode_low_nm: float = 470.0
    mode_high_nm: float = 720.0
    fwhm_median_nm: float = 50.0
    ln_fwhm_sd: float = 0.3
    peak_median_per_nm: float = 0.003
    ln_peak_sd: float = 1.2
    reflected_laser_median: float = 0.1
    ln_reflected_laser_sd: float = 1.5
    ln_blocking_sd: float = 0.5

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if not np.isfinite(value):
                raise FitError(f"emission prior: {name} is {value:g}; must be a finite number")
            if ("_sd" in name or "_median" in name) and value <= 0:
                raise FitError(f"emission prior: {name} {value:g} must be positive")
        if not self.mode_low_nm < self.mode_high_nm:
            raise FitError(
                f"emission prior: mode_low_nm {self.mode_low_nm:g} nm must be below "
                f"mode_high_nm {self.mode_high_nm:g} nm"
            )

    def of(self, family: EmissionFamily, *, with_blocking: bool, own_leaks: Mapping[str, float] | None = None) -> Prior:
        """Return the joint prior of a family's parameters, the reflectance at the laser, the blocking and own leaks.

        Parameters
        ----------
        family
            Family of emission curves.
        with_blocking
            Whether the filters leak, so that the blocking is a parameter.
        own_leaks
            Standard deviation of ln(leak) around the common one, for each filter whose own leak is sampled.
        """
        log_normal = "log-normal, median {:g}{}, sd of the logarithm {:g}"
        inf = np.inf
        rows: list[tuple[str, float, float, float, float, str]] = [
            (
                COMMON_PARAMETERS[0],
                self.mode_mean_nm,
                self.mode_sd_nm,
                self.mode_low_nm,
                self.mode_high_nm,
                f"normal({self.mode_mean_nm:g}, {self.mode_sd_nm:g}) nm, cut to "
                f"{self.mode_low_nm:g}..{self.mode_high_nm:g} nm",
            )
        ]
        for name, median, unit, sd in (
            (COMMON_PARAMETERS[1], self.fwhm_median_nm, " nm", self.ln_fwhm_sd),
            (COMMON_PARAMETERS[2], self.peak_median_per_nm, " 1/nm", self.ln_peak_sd),
        ):
            rows.append((name, float(np.log(median)), sd, -inf, inf, log_normal.format(median, unit, sd)))
        for own in family.own:
            words = f"normal({own.mean:.3g}, {own.sd:g}), cut to {own.low:g}..{own.high:g}: {own.meaning}"
            rows.append((own.name, own.mean, own.sd, own.low, own.high, words))
        median, sd = self.reflected_laser_median, self.ln_reflected_laser_sd
        rows.append((REFLECTED_LASER, float(np.log(median)), sd, -inf, inf, log_normal.format(median, "", sd)))
        if with_blocking:
            words = f"log-normal multiplier of the filters' leak, median 1, sd of the logarithm {self.ln_blocking_sd:g}"
            rows.append((BLOCKING, 0.0, self.ln_blocking_sd, -inf, inf, words))
        for name, sd in (own_leaks or {}).items():
            words = f"normal(0, 1): ln(leak of filter {name} over the common one) in units of {sd:.2g}"
            rows.append((OWN_LEAK.format(name), 0.0, 1.0, -inf, inf, words))
        names, mean, sds, low, high, texts = zip(*rows, strict=True)
        return Prior(names, np.array(mean), np.array(sds), np.array(low), np.array(high), texts)
