r"""What is believed about a fluorescent paint before it is measured: its emission, its absorption, its departure.

The departure says how far a real paint may leave its family of curves, a multiplicative Gaussian process

.. math::
    f(\lambda) = s(\lambda) + (s(\lambda) + \epsilon\,s_{peak})\,d(\lambda), \qquad
    d \sim GP\left(0,\; a^2 e^{-(\lambda-\lambda')^2 / 2 \ell^2} + r^2 e(\lambda) e(\lambda')\right)

with s the curve of the family. The share :math:`\epsilon` of the peak lets a paint emit where the family has died
out. The rank-one part is re-absorption: a thick paint absorbs the blue edge of its own light, by an unknown
fraction of order r that falls from 1 to 0 around the blue half-maximum (the logistic e). Without a discrepancy the
intervals of every family are far too narrow on measured paint.

Distribution function and quantiles of the normal distribution come from the standard library: scipy.special has both,
but takes a third of a second to load, a tenth of a whole fit.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from statistics import NormalDist
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import FitError
from finray_calib.spectra import COMMON_PARAMETERS, EmissionFamily

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
                raise FitError(f"emission prior: {name} is {value:g}, but must be a finite number")
            if ("_sd" in name or "_median" in name) and value <= 0:
                raise FitError(f"emission prior: {name} is {value:g}, but must be positive")
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
            words = f"normal(0, 1): ln(leak of filter {name} / common leak) in units of {sd:.2g}"
            rows.append((OWN_LEAK.format(name), 0.0, 1.0, -inf, inf, words))
        names, mean, sds, low, high, texts = zip(*rows, strict=True)
        return Prior(names, np.array(mean), np.array(sds), np.array(low), np.array(high), texts)


@dataclass(frozen=True)
class AbsorptionPrior:
    """What is believed about the absorption of a fluorescent paint before it is measured.

    Attributes
    ----------
    stokes_median_nm, ln_stokes_sd
        Stokes shift, from the last maximum of the absorption to the emission's: ln(shift + 5 nm) is a mixture of two
        normals, that of fluorophores whose last absorption band emits, and that of few which absorb in the
        ultraviolet or hand their energy on. Learned from 142 measured pairs of curves.
    wide_stokes_share, wide_stokes_median_nm, ln_wide_stokes_sd
        Share, median and width of the second.
    absorbance_median_factor, ln_absorbance_sd
        Absorbance of the layer at its maximum; the median 1 absorbs nine tenths of the light.
    red_half_width_median_nm, ln_red_half_width_sd
        Half width at half maximum of the absorbance towards the red.
    blue_half_width_median_nm, ln_blue_half_width_sd
        The same towards the blue, where vibronic bands and further dyes widen it.
    blue_floor_low_rel, blue_floor_high_rel
        The logarithm of the floor in the far blue is uniform between these.
    deviation_rel, deviation_length_nm
        Smooth departure of real absorption from the family. Best fits of the family to whole measured excitation
        spectra leave 0.04 to 0.10; fits to a few lights leave more.

    Raises
    ------
    FitError
        A median, width or length is not positive, or the floor's limit is above 1.
    """

    stokes_median_nm: float = 19.0
    ln_stokes_sd: float = 0.47
    wide_stokes_share: float = 0.19
    wide_stokes_median_nm: float = 166.0
    ln_wide_stokes_sd: float = 0.38
    absorbance_median_factor: float = 1.0
    ln_absorbance_sd: float = 0.8
    red_half_width_median_nm: float = 20.0
    ln_red_half_width_sd: float = 0.4
    blue_half_width_median_nm: float = 60.0
    ln_blue_half_width_sd: float = 0.7
    blue_floor_low_rel: float = 0.02
    blue_floor_high_rel: float = 0.5
    deviation_rel: float = 0.12
    deviation_length_nm: float = 20.0

    def __post_init__(self) -> None:
        wrong = [f.name for f in fields(self) if not getattr(self, f.name) > 0]
        if wrong:
            raise FitError(f"absorption prior: {wrong[0]} is {getattr(self, wrong[0]):g}, but must be above 0")
        if not self.blue_floor_low_rel <= self.blue_floor_high_rel <= 1:
            raise FitError(
                f"absorption prior: the blue floor runs from {self.blue_floor_low_rel:g} to "
                f"{self.blue_floor_high_rel:g}, but must increase and end at 1 or below"
            )

    @cached_property
    def in_words(self) -> dict[str, str]:
        """Prior of each parameter with its origin."""
        return {
            "stokes_shift_nm": f"{100 * (1 - self.wide_stokes_share):.0f} % with a median of "
            f"{self.stokes_median_nm:g} nm, "
            f"{100 * self.wide_stokes_share:.0f} % of {self.wide_stokes_median_nm:g} nm (log-normal in shift + "
            f"{_STOKES_OFFSET_NM:g} nm, sd {self.ln_stokes_sd:g} and {self.ln_wide_stokes_sd:g}); 142 fluorophores: "
            "95 % lie within 3 to 240 nm",
            "peak_absorbance": f"log-normal, median {self.absorbance_median_factor:g}, sd of the logarithm "
            f"{self.ln_absorbance_sd:g}; from thin to saturated layers",
            "red_half_width_nm": f"log-normal, median {self.red_half_width_median_nm:g} nm, sd of the logarithm "
            f"{self.ln_red_half_width_sd:g}; four open materials",
            "blue_half_width_nm": f"log-normal, median {self.blue_half_width_median_nm:g} nm, sd of the logarithm "
            f"{self.ln_blue_half_width_sd:g}; four open materials",
            "blue_floor": f"log-uniform {self.blue_floor_low_rel:g} to {self.blue_floor_high_rel:g}; four open "
            "materials",
            "deviation": f"smooth Gaussian process of ln a, sd {self.deviation_rel:g}, length "
            f"{self.deviation_length_nm:g} nm; four open materials",
        }

    def _stokes_parts(self) -> tuple[tuple[float, float, float], ...]:
        """Return share, mean and standard deviation of ln(shift + offset) of both parts."""
        return (
            (1 - self.wide_stokes_share, math.log(self.stokes_median_nm + _STOKES_OFFSET_NM), self.ln_stokes_sd),
            (self.wide_stokes_share, math.log(self.wide_stokes_median_nm + _STOKES_OFFSET_NM), self.ln_wide_stokes_sd),
        )

    def stokes_density(self, shift_nm: FloatArray) -> FloatArray:
        """Return the prior density of Stokes shifts up to a factor; 0 for shifts not above 0."""
        shifted = np.maximum(shift_nm, 0.0) + _STOKES_OFFSET_NM
        parts = (
            share / sd * np.exp(-0.5 * ((np.log(shifted) - mean) / sd) ** 2) for share, mean, sd in self._stokes_parts()
        )
        return np.where(shift_nm > 0, sum(parts) / shifted, 0.0)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return (count,) Stokes shifts in nm, and (4, count) absorbance, half widths (red, blue, nm) and floor."""
        shift, wide = np.zeros(count), rng.random(count) < self.wide_stokes_share
        for (_, mean, sd), rows in zip(self._stokes_parts(), (~wide, wide), strict=True):
            below = normal_cdf((math.log(_STOKES_OFFSET_NM) - mean) / sd)
            drawn = normal_quantile(below + (1 - below) * rng.random(int(rows.sum())))
            shift[rows] = np.exp(mean + sd * drawn) - _STOKES_OFFSET_NM
        medians = (self.absorbance_median_factor, self.red_half_width_median_nm, self.blue_half_width_median_nm)
        spreads = (self.ln_absorbance_sd, self.ln_red_half_width_sd, self.ln_blue_half_width_sd)
        shape = [m * np.exp(s * rng.standard_normal(count)) for m, s in zip(medians, spreads, strict=True)]
        span = np.log(self.blue_floor_high_rel / self.blue_floor_low_rel)
        return shift, np.array([*shape, self.blue_floor_low_rel * np.exp(span * rng.random(count))])


_STOKES_OFFSET_NM = 5.0
EDGE_OFFSET_FWHM = 0.5
EDGE_WIDTH_FWHM = 0.12
"""The re-absorbed edge: a logistic centred half a full width below the mode, 0.12 full widths wide."""


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """Hyper-parameters of the discrepancy.

    Attributes
    ----------
    amplitude_rel
        Standard deviation a of the relative discrepancy; 0 for none.
    length_nm
        Correlation length, nm.
    floor_rel
        Share of the peak that the relative discrepancy also acts on.
    reabsorption_rel
        Standard deviation r of the re-absorbed fraction at the blue edge.
    origin
        Where the numbers come from.

    Raises
    ------
    FitError
        When a number is out of its range.
    """

    amplitude_rel: float
    length_nm: float
    floor_rel: float
    reabsorption_rel: float
    origin: str

    def __post_init__(self) -> None:
        for name in ("amplitude_rel", "floor_rel", "reabsorption_rel"):
            if not 0 <= getattr(self, name) < 1:
                raise FitError(f"discrepancy: {name} {getattr(self, name):g} must be a share of 0 or more and below 1")
        if not 2 <= self.length_nm <= 200:
            raise FitError(f"discrepancy: length_nm {self.length_nm:g} nm must lie between 2 and 200 nm")

    @property
    def acts(self) -> bool:
        """Whether there is any discrepancy."""
        return self.amplitude_rel > 0 or self.reabsorption_rel > 0

    def smooth_kernel(self, one_nm: FloatArray, other_nm: FloatArray) -> FloatArray:
        """Return a^2 exp(-(l - l')^2 / (2 length^2)) between two sets of wavelengths, nm."""
        apart = (one_nm[:, None] - other_nm) / self.length_nm
        return np.asarray(self.amplitude_rel**2 * np.exp(-0.5 * apart**2))


PAINT_DISCREPANCY = Discrepancy(
    0.12,
    12.0,
    0.1,
    0.1,
    "measured re-radiation matrices of an orange ink, a yellow textile and two papers: see the leave-one-material-out "
    "study in benchmarks/",
)
"""What measured paints, inks, papers and textiles ask for with the default family."""

NO_DISCREPANCY = Discrepancy(0.0, 12.0, 0.0, 0.0, "none: the curve is assumed to follow its family exactly")

_erfc = np.vectorize(math.erfc, otypes=[np.float64])
_quantile = np.vectorize(NormalDist().inv_cdf, otypes=[np.float64])
_SMALLEST, _LARGEST = float(np.finfo(float).tiny), 1 - float(np.finfo(float).epsneg)


def normal_cdf(z: ArrayLike) -> FloatArray:
    """Return erfc(-z / sqrt 2) / 2, to rounding in both tails."""
    return np.asarray(0.5 * _erfc(-np.asarray(z, dtype=np.float64) / math.sqrt(2)))


def normal_quantile(share: ArrayLike) -> FloatArray:
    """Return z of which normal_cdf(z) = share; 0 and 1 count as the numbers next to them.

    References
    ----------
    Wichura, Algorithm AS 241: the percentage points of the normal distribution, Applied Statistics 37 (1988) 477-484.
    """
    return np.asarray(_quantile(np.clip(np.asarray(share, dtype=np.float64), _SMALLEST, _LARGEST)))


def chi_square_of_bands(
    residual: FloatArray, covariance: NDArray[np.floating], band: NDArray[np.int64], bands: int
) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Return chi-square, channels and predictive p of each band, NaN where none is usable, means over the draws.

    Parameters
    ----------
    residual, covariance
        (n, K) of the usable values of n draws, and their covariances (n, K, K).
    band, bands
        (K,) band of each value, and how many there are.
    """
    chi2, p_value = np.full(bands, np.nan), np.full(bands, np.nan)
    for b in np.unique(band):
        rows = np.flatnonzero(band == b)
        own = residual[:, rows]
        each = np.einsum("ni,ni->n", own, np.linalg.solve(covariance[:, rows][:, :, rows], own[..., None])[..., 0])
        chi2[b], p_value[b] = each.mean(), chi_square_survival(each, rows.size).mean()
    return chi2, np.bincount(band, minlength=bands).astype(np.int64), p_value


def chi_square_survival(value: FloatArray, degrees_of_freedom: int) -> FloatArray:
    """Return the probability of a larger chi-square, in closed form for whole degrees of freedom.

    With x = value / 2 and a = 1/2 or 1, Q(a + 1, x) = Q(a, x) + x^a exp(-x) / Gamma(a + 1).
    """
    x = value / 2
    a = 0.5 if degrees_of_freedom % 2 else 1.0
    survival = _erfc(np.sqrt(x)) if degrees_of_freedom % 2 else np.exp(-x)
    while a < degrees_of_freedom / 2:
        survival = survival + x**a * np.exp(-x) / math.gamma(a + 1)
        a += 1
    return np.asarray(survival)
