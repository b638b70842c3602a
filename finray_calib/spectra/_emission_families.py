"""The four families of emission curves behind one interface, the paper's skew-Cauchy, and quantities of any curve.

Whatever its family, a curve has a mode, a width, a skew, a peak and an area.

The skew-Cauchy curve is that of Zheng, Sato and Sato (2014). Its published "peak wavelength" l0 is *not* the peak: for
a skewed curve the maximum lies up to 0.349 scale lengths away. This module therefore distinguishes the location (l0)
from the mode (the real maximum), and the fit samples mode, ln FWHM, kappa = asinh(skewness) and ln peak, which bands
determine far more directly.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import CurveError, FitError
from finray_calib.spectra.family_kernels import GAUSSIAN_MIXTURE, LOG_NORMAL, SKEW_CAUCHY, SKEW_T, curves, shape_table

FloatArray = NDArray[np.float64]

COMMON_PARAMETERS: Final = ("shape_mode_nm", "ln_shape_fwhm_nm", "ln_shape_peak_per_nm")
"""First parameters of every family; of the mixture they describe its first component."""


@dataclass(frozen=True, slots=True)
class ShapeParameter:
    """A parameter that only one family has: a normal prior, truncated.

    Attributes
    ----------
    name
        Name, dimensionless unless it ends in a unit.
    mean, sd
        Of the normal before truncation.
    low, high
        Truncation.
    meaning
        In words.
    """

    name: str
    mean: float
    sd: float
    low: float
    high: float
    meaning: str


@dataclass(frozen=True, slots=True)
class EmissionFamily:
    """A parametric family of emission curves.

    Attributes
    ----------
    name
        Name on the command line and in records.
    title
        Name in figures.
    code
        Number of the family in :mod:`finray_calib.spectra.family_kernels`.
    own
        The family's own parameters, after :data:`COMMON_PARAMETERS`.
    """

    name: str
    title: str
    code: int
    own: tuple[ShapeParameter, ...]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters in order."""
        return (*COMMON_PARAMETERS, *(p.name for p in self.own))

    def curves(self, theta: ArrayLike, wavelength_nm: ArrayLike) -> FloatArray:
        """Return the emission curves of parameter rows, nm^-1.

        Parameters
        ----------
        theta
            (n, >= D) parameters in the order of :attr:`parameter_names`; further columns are ignored.
        wavelength_nm
            (L,) wavelengths, nm.

        Returns
        -------
        numpy.ndarray
            (n, L), in the unit of the peak.
        """
        rows = np.ascontiguousarray(theta, dtype=np.float64)
        grid_nm = np.ascontiguousarray(wavelength_nm, dtype=np.float64).view()
        grid_nm.flags.writeable = False  # one signature, compiled once, for stored and for new grids
        return np.asarray(curves(self.code, rows, skew_shape_table(), grid_nm))


_KAPPA = ShapeParameter("kappa", 0.0, 1.5, -6.0, 6.0, "asinh of the skewness omega; positive: red tail")
_LN_TAIL = ShapeParameter(
    "ln_tail", float(np.log(4.0)), 0.7, -0.5, 4.0, "logarithm of the degrees of freedom; 0 is the paper's curve"
)
_ASYMMETRY = ShapeParameter(
    "ln_asymmetry", 0.35, 0.2, -1.5, 1.5, "logarithm of red / blue half width in wavenumber; measured 0.30 to 0.47"
)
_SHIFT = ShapeParameter("shift_nm", 35.0, 20.0, 5.0, 120.0, "second component's centre minus the first's")
_WIDTH_RATIO = ShapeParameter("ln_width_ratio", 0.3, 0.3, -1.0, 1.5, "second width / first width, logarithm")
_HEIGHT_RATIO = ShapeParameter("ln_height_ratio", -1.0, 0.8, -6.0, 1.5, "second height / first height, logarithm")

FAMILIES: Final = {
    family.name: family
    for family in (
        EmissionFamily("zheng2014", "skew-Cauchy (the paper's)", SKEW_CAUCHY, (_KAPPA,)),
        EmissionFamily("skew_t", "skew-t", SKEW_T, (_KAPPA, _LN_TAIL)),
        EmissionFamily("log_normal_wavenumber", "log-normal in wavenumber", LOG_NORMAL, (_ASYMMETRY,)),
        EmissionFamily("gaussian_mixture", "two Gaussians", GAUSSIAN_MIXTURE, (_SHIFT, _WIDTH_RATIO, _HEIGHT_RATIO)),
    )
}


def family_named(name: str) -> EmissionFamily:
    """Return a family by its name.

    Raises
    ------
    FitError
        There is no such family.
    """
    if name not in FAMILIES:
        raise FitError(f"family: {name!r} is unknown; valid families are {', '.join(FAMILIES)}")
    return FAMILIES[name]


@lru_cache(maxsize=1)
def skew_shape_table() -> FloatArray:
    """Return the shape table of the skew families, read-only."""
    table = np.asarray(shape_table())
    table.flags.writeable = False
    return table


KAPPA_LIMIT = 8.0
"""Largest abs(asinh(skewness)); beyond it the curve is a half Cauchy to 0.1 %."""

_BISECTIONS = 60  # halves a bracket of 20 scale lengths down to rounding


def skew_cauchy(
    wavelength_nm: ArrayLike, location_nm: ArrayLike, scale_nm: ArrayLike, skewness: ArrayLike, amplitude: ArrayLike
) -> FloatArray:
    """Return the skew-Cauchy curve h / (g^2 + (l - l0)^2) * (atan(w (l - l0) / g) / pi + 1/2).

    Valid for scale > 0. All arguments broadcast. The tails fall like 1 / l^2 on both sides: the curve has an
    area but neither a mean nor a variance.

    Parameters
    ----------
    wavelength_nm
        Wavelength l, nm.
    location_nm
        l0, nm; called peak wavelength in the paper, but the peak is elsewhere unless the skewness is 0.
    scale_nm
        g (gamma), nm.
    skewness
        w (omega), dimensionless; positive for a tail towards long wavelengths.
    amplitude
        h, in the unit of the curve times nm^2; the curve at l0 is h / (2 g^2).

    Returns
    -------
    numpy.ndarray
        The curve, broadcast shape.

    References
    ----------
    Zheng, Sato, Sato, Spectra estimation of fluorescent and reflective scenes by using ordinary illuminants,
    ECCV 2014, LNCS 8693.
    """
    scale = np.asarray(scale_nm, dtype=np.float64)
    z = (np.asarray(wavelength_nm, dtype=np.float64) - np.asarray(location_nm, dtype=np.float64)) / scale
    height = np.asarray(amplitude, dtype=np.float64) / scale**2
    return np.asarray(_unit_curve(z, np.asarray(skewness, dtype=np.float64)) * height)


def from_mode_parameters(
    mode_nm: ArrayLike, ln_fwhm_nm: ArrayLike, kappa: ArrayLike, ln_peak: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return (location_nm, scale_nm, skewness, amplitude) of curves given by mode, ln FWHM, kappa and ln peak.

    g = FWHM / v(kappa), l0 = mode - g m(kappa), w = sinh(kappa), h = peak g^2 / p(kappa). Valid for
    abs(kappa) <= KAPPA_LIMIT. All arguments broadcast.

    Parameters
    ----------
    mode_nm
        Wavelength of the maximum, nm.
    ln_fwhm_nm
        Natural logarithm of the full width at half maximum in nm.
    kappa
        asinh(skewness).
    ln_peak
        Natural logarithm of the height of the maximum.

    Raises
    ------
    CurveError
        When abs(kappa) exceeds KAPPA_LIMIT.
    """
    mode_offset, peak, width = shape_tables(kappa)
    scale = np.exp(np.asarray(ln_fwhm_nm, dtype=np.float64)) / width
    location = np.asarray(mode_nm, dtype=np.float64) - scale * mode_offset
    amplitude = np.exp(np.asarray(ln_peak, dtype=np.float64)) * scale**2 / peak
    return location, scale, np.sinh(np.asarray(kappa, dtype=np.float64)), amplitude


def to_mode_parameters(
    location_nm: ArrayLike, scale_nm: ArrayLike, skewness: ArrayLike, amplitude: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return (mode_nm, ln_fwhm_nm, kappa, ln_peak): the inverse of :func:`from_mode_parameters`."""
    location, scale, skew, height = (
        np.asarray(v, dtype=np.float64) for v in (location_nm, scale_nm, skewness, amplitude)
    )
    kappa = np.arcsinh(skew)
    mode_offset, peak, width = shape_tables(kappa)
    return location + scale * mode_offset, np.log(scale * width), kappa, np.log(height * peak / scale**2)


def shape_tables(kappa: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mode offset m, peak p and full width v of the unit curve (atan(w z)/pi + 1/2) / (1 + z^2).

    mode = l0 + g m, peak value = (h / g^2) p, FWHM = g v, with w = sinh(kappa). m is odd, p and v are even.
    By bisection to rounding, for abs(kappa) <= KAPPA_LIMIT.

    Parameters
    ----------
    kappa
        asinh(skewness), any shape.

    Returns
    -------
    tuple of numpy.ndarray
        m, p, v, each of the shape of `kappa`, dimensionless.

    Raises
    ------
    CurveError
        When abs(kappa) exceeds KAPPA_LIMIT.
    """
    values = np.asarray(kappa, dtype=np.float64)
    if not (np.abs(values) <= KAPPA_LIMIT).all():
        largest = float(np.abs(values).max())
        raise CurveError(
            f"skew-Cauchy curve: abs(asinh(skewness)) is {largest:.3g}, but at most {KAPPA_LIMIT:g} is allowed; limit "
            "the skewness, because a larger one cannot be told from a half Cauchy"
        )
    w = np.sinh(np.abs(values))

    def rises(z: FloatArray) -> NDArray[np.bool_]:
        slope = -2 * z / (1 + z * z) * (np.arctan(w * z) / np.pi + 0.5) + w / np.pi / (1 + (w * z) ** 2)
        return np.asarray(slope > 0)

    m = _bisect(rises, np.zeros_like(w), np.full_like(w, 1.2))
    p = _unit_curve(m, w)
    right = _bisect(lambda z: _unit_curve(z, w) > p / 2, m, np.full_like(w, 20.0))
    left = _bisect(lambda z: _unit_curve(z, w) < p / 2, np.full_like(w, -20.0), m)
    return np.asarray(np.sign(values) * m), p, right - left


@dataclass(frozen=True, slots=True)
class SkewCauchy:
    """One skew-Cauchy curve.

    Attributes
    ----------
    location_nm
        l0 of the paper, nm. It is not the peak; see :attr:`mode_nm`.
    scale_nm
        g (gamma) of the paper, nm, above 0.
    skewness
        w (omega) of the paper.
    amplitude
        h of the paper, unit of the curve times nm^2.

    Raises
    ------
    CurveError
        When the scale or the amplitude is not positive.
    """

    location_nm: float
    scale_nm: float
    skewness: float
    amplitude: float

    def __post_init__(self) -> None:
        if not (self.scale_nm > 0 and self.amplitude > 0):
            raise CurveError(
                f"skew-Cauchy curve: scale {self.scale_nm:g} nm and amplitude {self.amplitude:g} must both be positive"
            )

    @classmethod
    def from_mode(cls, mode_nm: float, ln_fwhm_nm: float, kappa: float, ln_peak: float) -> Self:
        """Build the curve from its mode, ln FWHM, kappa = asinh(skewness) and ln peak."""
        return cls(*(float(value) for value in from_mode_parameters(mode_nm, ln_fwhm_nm, kappa, ln_peak)))

    def to_mode(self) -> tuple[float, float, float, float]:
        """Return (mode_nm, ln_fwhm_nm, kappa, ln_peak)."""
        mode, ln_fwhm, kappa, ln_peak = to_mode_parameters(
            self.location_nm, self.scale_nm, self.skewness, self.amplitude
        )
        return float(mode), float(ln_fwhm), float(kappa), float(ln_peak)

    def __call__(self, wavelength_nm: ArrayLike) -> FloatArray:
        """Return the curve at the wavelengths."""
        return skew_cauchy(wavelength_nm, self.location_nm, self.scale_nm, self.skewness, self.amplitude)

    @property
    def mode_nm(self) -> float:
        """Wavelength of the maximum, l0 + g m(w), nm."""
        return self.to_mode()[0]

    @property
    def fwhm_nm(self) -> float:
        """Full width at half maximum, g v(w), nm."""
        return float(np.exp(self.to_mode()[1]))

    @property
    def area(self) -> float:
        """Area over all wavelengths, pi h / (2 g): independent of the skewness."""
        return float(np.pi * self.amplitude / (2 * self.scale_nm))


def _unit_curve(z: FloatArray, skewness: FloatArray) -> FloatArray:
    """Return (atan(w z)/pi + 1/2) / (1 + z^2)."""
    return np.asarray((np.arctan(skewness * z) * (1 / np.pi) + 0.5) / (1 + z * z))


def _bisect(still_below: Callable[[FloatArray], NDArray[np.bool_]], low: FloatArray, high: FloatArray) -> FloatArray:
    """Return where `still_below` turns false between `low` and `high`, element by element."""
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        below = still_below(middle)
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return (low + high) / 2


YIELD_END_NM = 780.0
"""The energy yield is counted up to here, nm: the end of the visible."""


@dataclass(frozen=True, slots=True)
class CurveQuantities:
    """Quantities of n curves, each (n,).

    Attributes
    ----------
    mode_nm
        Wavelength of the maximum, nm.
    fwhm_nm
        Full width between the half-maximum crossings nearest to the mode on either side, nm.
    skew
        (red half width - blue half width) / FWHM, -1 to 1; positive for a tail towards long wavelengths.
    peak_per_nm
        Height of the maximum, nm^-1.
    energy_yield
        Integral up to 780 nm: emitted over incident energy relative to a perfect white.
    """

    mode_nm: FloatArray
    fwhm_nm: FloatArray
    skew: FloatArray
    peak_per_nm: FloatArray
    energy_yield: FloatArray


def curve_quantities(curves: FloatArray, wavelength_nm: FloatArray) -> CurveQuantities:
    """Return the quantities of curves sampled on a fine, even grid.

    The maximum is that of the parabola through the highest sample and its neighbours, the half-maximum crossings
    are linear between samples; where a curve does not fall to half within the grid, the grid's end counts.

    Parameters
    ----------
    curves
        (n, L) curves of 0 or more, nm^-1.
    wavelength_nm
        (L,) even grid, nm.
    """
    rows, step = np.arange(len(curves)), float(wavelength_nm[1] - wavelength_nm[0])
    top = np.clip(curves.argmax(axis=1), 1, len(wavelength_nm) - 2)
    left, middle, right = (curves[rows, top + offset] for offset in (-1, 0, 1))
    bend = left - 2 * middle + right
    inside = bend < 0
    shift = np.clip(np.where(inside, 0.5 * (left - right) / np.where(inside, bend, -1.0), 0.0), -1.0, 1.0)
    peak = middle - 0.25 * (left - right) * shift
    mode = wavelength_nm[top] + shift * step
    red = _crossing(curves, top, peak / 2, 1) * step + wavelength_nm[0]
    blue = _crossing(curves, top, peak / 2, -1) * step + wavelength_nm[0]
    width = red - blue
    skew = (red + blue - 2 * mode) / np.where(width > 0, width, 1.0)
    counted = wavelength_nm <= YIELD_END_NM
    area = np.trapezoid(curves[:, counted], wavelength_nm[counted], axis=1)
    return CurveQuantities(mode, width, skew, peak, np.asarray(area))


def _crossing(curves: FloatArray, top: NDArray[np.intp], half: FloatArray, direction: int) -> FloatArray:
    """Return the fractional sample where each curve first falls to half on one side of its top, (n,)."""
    count = curves.shape[1]
    samples = np.arange(count)
    beyond = (samples - top[:, None]) * direction > 0
    below = beyond & (curves < half[:, None])
    order = below if direction > 0 else below[:, ::-1]
    first = order.argmax(axis=1)
    first = first if direction > 0 else count - 1 - first
    rows = np.arange(len(curves))
    low, high = curves[rows, first], curves[rows, np.clip(first - direction, 0, count - 1)]
    fraction = (half - low) / np.where(high > low, high - low, 1.0)
    end = count - 1 if direction > 0 else 0
    return np.where(below.any(axis=1), first - direction * np.clip(fraction, 0.0, 1.0), float(end))
