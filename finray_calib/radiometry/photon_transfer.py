r"""Arithmetic of photon transfer (EMVA Standard 1288, release 4.0): gain, noise, saturation, linearity, pattern.

The temporal variance of a count grows with the mean above the black level b as

.. math:: \sigma_y^2 = \sigma_r^2 / g^2 + 1/12 + (\mu_y - b) / g

with gain g (e/DN), read noise :math:`\sigma_r` (e) and the variance 1/12 of rounding. The standard writes K = 1/g.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from data_schemas.camera import Resolvable
from data_schemas.errors import RadiometryError
from data_schemas.estimate import Estimate
from finray_calib.radiometry.estimates import non_negative, normal_estimate, root_of
from finray_calib.radiometry.frame_stack import SpatialVariance, StackStatistics

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
ROUNDING_VARIANCE_DN2 = 1.0 / 12.0
# EMVA 1288: the gain line ends at 70 % of saturation, linearity is judged between 5 and 95 %.
LINE_END = 0.7
LINEARITY_RANGE = (0.05, 0.95)
# Clipped counts beyond this share bend mean and variance more than their noise.
LARGEST_SATURATED_FRACTION = 1e-4
# Beyond the maximum the variance must fall by this many standard deviations: noise does that once in a million.
SATURATION_SIGMAS = 5.0
# A line that a correct camera shows once in a thousand times does not fit; its intervals are then widened.
SMALLEST_CHI_SQUARE_P = 1e-3
WEIGHT_ITERATIONS = 3


@dataclass(frozen=True, slots=True)
class LineFit:
    """Straight line through measured points.

    Attributes
    ----------
    parameters, covariance
        Intercept and slope, shape (2,), and their covariance, shape (2, 2), widened by chi-square over degrees of
        freedom when the line does not fit.
    chi_square, degrees_of_freedom, chi_square_p
        How well the line fits, and the probability of a worse fit by noise alone.
    """

    parameters: Floats
    covariance: Floats
    chi_square: float
    degrees_of_freedom: int
    chi_square_p: float


def fit_line(x: Floats, y: Floats, sd: Floats) -> LineFit:
    """Fit ``y = intercept + slope x`` with weights 1/sd^2; x (n,), y and its standard deviations sd (n,)."""
    design = np.stack([np.ones_like(x), x], axis=1) / sd[:, None]
    covariance = np.asarray(np.linalg.inv(design.T @ design), dtype=np.float64)
    parameters = covariance @ design.T @ (y / sd)
    chi_square = float(np.sum((y / sd - design @ parameters) ** 2))
    freedom = len(x) - 2
    p = float(gammaincc(0.5 * freedom, 0.5 * chi_square)) if freedom else 1.0
    if p < SMALLEST_CHI_SQUARE_P:
        covariance = covariance * (chi_square / freedom)
    return LineFit(parameters, covariance, chi_square, freedom, p)


def require_noise(stacks: Sequence[StackStatistics], what: str) -> None:
    """Refuse stacks whose counts do not vary in time.

    Raises
    ------
    RadiometryError
        A stack has no temporal variance.
    """
    equal = sum(s.variance_dn2 <= 0.0 for s in stacks)
    if equal:
        raise RadiometryError(
            f"{what}: the frames of {equal} of {len(stacks)} exposures are equal (variance 0 DN^2), so that they "
            "show no noise: switch off noise reduction and averaging in the camera, and store each frame once"
        )


@dataclass(frozen=True, slots=True)
class PhotonTransfer:
    """Gain and read noise of one channel with the line behind them."""

    gain_e_per_dn: Estimate
    read_noise_e: Resolvable
    read_noise_dn: Resolvable
    line: LineFit


def photon_transfer(stacks: Sequence[StackStatistics], black_level_dn: float, what: str) -> PhotonTransfer:
    """Fit the photon transfer line to unsaturated stacks, dark ones among them.

    Weights are those of the fitted line, not of the measured variances, which would favour those that came out low.

    Parameters
    ----------
    stacks
        Statistics of one channel, dark and lit.
    black_level_dn
        Count without light and dark current (DN).
    what
        The channel in words, for messages.

    Raises
    ------
    RadiometryError
        The counts do not vary in time, or their variance does not grow with the signal.
    """
    require_noise(stacks, what)
    signal_dn = np.array([s.mean_dn for s in stacks]) - black_level_dn
    variance = np.array([s.variance_dn2 for s in stacks])
    rel = np.array([s.variance_sd_rel for s in stacks])
    mean_sd_dn = np.array([s.mean_sd_dn for s in stacks])
    expected, slope_per_e = variance, 0.0
    for _ in range(WEIGHT_ITERATIONS):
        line = fit_line(signal_dn, variance, np.hypot(rel * expected, slope_per_e * mean_sd_dn))
        slope_per_e = float(line.parameters[1])
        expected = np.maximum(line.parameters[0] + slope_per_e * signal_dn, 0.1 * variance)
    if slope_per_e <= 0.0:
        raise RadiometryError(
            f"{what}: the variance does not grow with the signal ({slope_per_e:.3g} DN^2 per DN); check that the "
            "lamp is on and that gamma, noise reduction and 8-bit conversion are off"
        )
    gain = 1.0 / slope_per_e
    noise_dn2 = float(line.parameters[0]) - ROUNDING_VARIANCE_DN2
    # read noise^2 in e^2 is noise / slope^2
    gradient = np.array([gain**2, -2.0 * noise_dn2 * gain**3])
    return PhotonTransfer(
        gain_e_per_dn=normal_estimate(gain, gain**2 * float(np.sqrt(line.covariance[1, 1]))),
        read_noise_e=root_of(noise_dn2 * gain**2, float(np.sqrt(gradient @ line.covariance @ gradient))),
        read_noise_dn=root_of(noise_dn2, float(np.sqrt(line.covariance[0, 0]))),
        line=line,
    )


def saturation_level(stacks: Sequence[StackStatistics]) -> int | None:
    """Return the level with the largest variance, behind which it falls; None when no level saturates.

    Parameters
    ----------
    stacks
        Lit stacks of one channel in order of exposure.
    """
    variance = np.array([s.variance_dn2 for s in stacks])
    peak = int(variance.argmax())
    noise = SATURATION_SIGMAS * np.sqrt(2.0) * stacks[peak].variance_sd_rel * variance[peak]
    return peak if (variance[peak:] < variance[peak] - noise).any() else None


@dataclass(frozen=True, slots=True)
class Linearity:
    """Deviation of the signal from a line through exposure.

    Attributes
    ----------
    error_rel
        Mean absolute deviation over the levels used (EMVA's linearity error).
    deviation_rel
        Deviation of every level, shape (levels,); NaN where it was not used.
    """

    error_rel: Resolvable
    deviation_rel: Floats


def linearity(exposure_s: Floats, signal_dn: Floats, noise_rel: Floats, used: Bools) -> Linearity:
    r"""Fit ``signal = a + b exposure`` with relative weights 1/signal^2 and return the deviations from it.

    .. math:: \delta_i = \frac{s_i - (a + b t_i)}{a + b t_i}, \qquad LE = \frac{1}{n} \sum_i |\delta_i|

    Noise makes LE larger than it is; it counts as resolved where it exceeds what the noise alone would give.

    Parameters
    ----------
    exposure_s, signal_dn, noise_rel
        Exposure (s), dark-corrected signal (DN) and its relative noise of every level, shape (levels,).
    used
        Levels between 5 and 95 % of saturation.
    """
    t, s = exposure_s[used], signal_dn[used]
    design = np.stack([np.ones_like(t), t], axis=1) / s[:, None]
    solve = np.linalg.pinv(design)
    fitted = s * (design @ (solve @ np.ones_like(s)))
    deviation = (s - fitted) / fitted
    residual = np.eye(len(s)) - design @ solve
    sd = np.sqrt(np.sum((residual * noise_rel[used]) ** 2, axis=1))
    everywhere = np.full(len(used), np.nan)
    everywhere[used] = deviation
    error = non_negative(
        float(np.abs(deviation).mean()),
        float(np.sqrt(np.sum(sd**2))) / len(s),
        low=float(np.sqrt(2.0 / np.pi) * sd.mean()),
    )
    return Linearity(error, everywhere)


def nonuniformity(
    lit: StackStatistics, dark: StackStatistics | None, kind: Literal["spatial", "pixel_to_pixel"]
) -> SpatialVariance:
    r"""Return the variance of the fixed pattern (DN^2): spatial minus what temporal noise leaves in the mean image.

    .. math:: s^2 = \Bigl(s_y^2 - \frac{\sigma_y^2}{L}\Bigr) - \Bigl(s_{dark}^2 - \frac{\sigma_{dark}^2}{L_{dark}}\Bigr)

    It may be negative by noise: its root then has an upper limit only.

    Parameters
    ----------
    lit
        Stack of L frames.
    dark
        Dark stack of the same exposure, subtracted; None for the pattern of `lit` itself.
    kind
        "spatial" (as it is) or "pixel_to_pixel" (after second differences).
    """
    signs = ((lit, 1.0),) if dark is None else ((lit, 1.0), (dark, -1.0))
    variance, sd_squares = 0.0, 0.0
    for stack, sign in signs:
        measured: SpatialVariance = getattr(stack, kind)
        temporal = stack.variance_dn2 / stack.frames
        variance += sign * (measured.variance_dn2 - temporal)
        sd_squares += measured.sd_dn2**2 + (temporal * stack.variance_sd_rel) ** 2
    return SpatialVariance(variance, float(np.sqrt(sd_squares)))
