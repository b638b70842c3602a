r"""Photon transfer (EMVA Standard 1288, release 4.0): gain, noise, saturation, linearity, pattern of stacks.

The temporal variance of a count grows with the mean above the black level b as

.. math:: \sigma_y^2 = \sigma_r^2 / g^2 + 1/12 + (\mu_y - b) / g

with gain g (e/DN), read noise :math:`\sigma_r` (e) and the variance 1/12 of rounding. The standard writes K = 1/g.

Welford's update (Technometrics 4 (1962) 419) keeps one running mean and one sum of squared deviations per pixel, so
that memory does not grow with the number of frames:

.. math:: m_n = m_{n-1} + \frac{d}{n}, \qquad q_n = q_{n-1} + d^2 \frac{n - 1}{n}, \qquad d = x_n - m_{n-1}
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from data_schemas import Estimate, RadiometryError, Resolvable

Floats = NDArray[np.float64]
Frame = NDArray[np.uint16] | Floats
# Where the pixels of a channel lie in a frame: (first row, first column, step) of each of its sites.
Sites = tuple[tuple[int, int, int], ...]
MONOCHROME: Sites = ((0, 0, 1),)
FEWEST_FRAMES = 2
SMALLEST_SITE_PX = 3
# A band of a megapixel frame and its intermediate results stay in the cache.
BAND_ROWS = 64
# [1 -2 1] along both axes has squared weights that sum to 36: white noise keeps its variance after division by 6.
SECOND_DIFFERENCE_GAIN = 6.0
# Sum of the squared autocorrelation of [1 -2 1] x [1 -2 1]: neighbours share pixels and count that much less.
LINE_DIFFERENCE_CORRELATION = 1.0 + 2.0 * ((2.0 / 3.0) ** 2 + (1.0 / 6.0) ** 2)
SECOND_DIFFERENCE_CORRELATION = LINE_DIFFERENCE_CORRELATION**2
# [1 -2 1] along one axis, as a factor of the variance.
LINE_DIFFERENCE_GAIN = 6.0


Pattern = Literal["spatial", "pixel_to_pixel", "rows", "columns", "pixels", "row_to_row", "column_to_column"]


@dataclass(frozen=True, slots=True)
class SpatialVariance:
    """Variance of the mean image over the pixels, not yet corrected for temporal noise.

    Attributes
    ----------
    variance_dn2
        Variance (DN^2).
    sd_dn2
        Its standard deviation (DN^2), from the fourth moment: hot pixels widen it.
    """

    variance_dn2: float
    sd_dn2: float


@dataclass(frozen=True, slots=True)
class RowsAndColumns:
    r"""Variances (DN^2) of a mean image, split into those of whole rows, whole columns and single pixels.

    With the mean image :math:`y_{mn} = \mu + r_m + c_n + p_{mn}` of M rows and N columns, :math:`p` with variance

    .. math:: s_p^2 = \frac{\sum (y_{mn} - y_m - y_n + \mu)^2}{(M - 1)(N - 1)}, \quad
              s_r^2 = \mathrm{var}(y_m) - s_p^2 / N, \quad s_c^2 = \mathrm{var}(y_n) - s_p^2 / M

    Attributes
    ----------
    rows, columns
        Without what single pixels and temporal noise leave in means of rows and columns.
    pixels
        The rest, with the temporal noise that is left in the mean image.
    row_to_row, column_to_column
        As `rows` and `columns`, but after second differences from one to the next: uneven light drops out.

    Notes
    -----
    Uncertainties of rows and columns are those of normal values; that of pixels is from the fourth moment. EMVA
    Standard 1288, release 4.0, has the same split; its factors differ by terms of the order 1 / M and 1 / N.
    """

    rows: SpatialVariance
    columns: SpatialVariance
    pixels: SpatialVariance
    row_to_row: SpatialVariance
    column_to_column: SpatialVariance


@dataclass(frozen=True, slots=True)
class StackStatistics:
    """One channel of a stack of equal exposures.

    Attributes
    ----------
    frames, pixels
        Number of frames and of pixels in the channel.
    mean_dn
        Mean over pixels and frames (DN).
    variance_dn2
        Temporal variance of one pixel in one frame (DN^2), mean over the pixels; the flicker of the whole frame is
        subtracted.
    saturated_fraction, empty_fraction
        Share of counts at full scale and at zero.
    frame_means_dn
        Mean of every frame (DN), shape (frames,).
    spatial, pixel_to_pixel
        Variance over the pixels as it is, and after second differences along rows and columns.
    lines
        The same for whole rows, whole columns and the rest.
    """

    frames: int
    pixels: int
    mean_dn: float
    variance_dn2: float
    saturated_fraction: float
    empty_fraction: float
    frame_means_dn: Floats
    spatial: SpatialVariance
    pixel_to_pixel: SpatialVariance
    lines: RowsAndColumns

    @property
    def mean_sd_dn(self) -> float:
        """Standard deviation of the mean due to temporal noise (DN)."""
        return float(np.sqrt(self.variance_dn2 / (self.frames * self.pixels)))

    @property
    def variance_sd_rel(self) -> float:
        """Relative standard deviation of the temporal variance: sqrt(2 / degrees of freedom)."""
        return float(np.sqrt(2.0 / (self.pixels * (self.frames - 1))))


class FrameStack:
    """Running moments of equal exposures.

    Parameters
    ----------
    what
        The stack in words, for messages.
    channels
        Sites of each channel.
    full_scale_dn
        Largest count (DN).
    """

    def __init__(self, what: str, channels: Iterable[Sites], full_scale_dn: int):
        self._what, self._channels, self._full_scale_dn = what, tuple(channels), full_scale_dn
        self._count = 0
        self._mean = self._squares = np.empty((0, 0))
        self._frame_means: dict[tuple[int, int, int], list[float]] = {s: [] for sites in self._channels for s in sites}
        self._saturated = dict.fromkeys(self._frame_means, 0)
        self._empty = dict.fromkeys(self._frame_means, 0)

    def add(self, frame: Frame) -> None:
        """Take one more frame (DN), shape (H, W).

        Raises
        ------
        RadiometryError
            The frame has another shape than those before, is too small, or holds NaN.
        """
        if frame.dtype.kind == "f" and not np.isfinite(frame).all():
            raise RadiometryError(
                f"{self._what}: frame {self._count + 1} contains NaN or infinite counts; give raw frames of whole "
                "counts"
            )
        if self._count == 0:
            self._start(frame)
        if frame.shape != self._mean.shape:
            raise RadiometryError(
                f"{self._what}: frame {self._count + 1} has {_size(frame)}, but the frames before it have "
                f"{_size(self._mean)}; capture all frames of the session with the same size"
            )
        self._count += 1
        for first in range(0, len(frame), BAND_ROWS):
            self._update(slice(first, first + BAND_ROWS), frame)
        for site, means in self._frame_means.items():
            pixels = _at(frame, site).copy()
            means.append(float(pixels.mean()))
            self._saturated[site] += int(np.count_nonzero(pixels >= self._full_scale_dn))
            self._empty[site] += int(np.count_nonzero(pixels <= 0))

    def _update(self, rows: slice, frame: Frame) -> None:
        """Do Welford's update in a band of rows."""
        change = frame[rows] - self._mean[rows]
        square = change * change
        square *= (self._count - 1) / self._count
        self._squares[rows] += square
        change /= self._count
        self._mean[rows] += change

    def statistics(self) -> tuple[StackStatistics, ...]:
        """Return the statistics of every channel.

        Raises
        ------
        RadiometryError
            There are fewer than two frames, which show no temporal noise.
        """
        if self._count < FEWEST_FRAMES:
            raise RadiometryError(
                f"{self._what}: has {self._count} frame, but at least {FEWEST_FRAMES} frames of the same exposure are "
                "needed to separate noise from pattern; raise plan.frames_per_level"
            )
        return tuple(self._channel(sites) for sites in self._channels)

    def _start(self, frame: Frame) -> None:
        """Take the shape of the first frame."""
        smallest = min(_at(frame, site).shape[axis] for site in self._frame_means for axis in (0, 1))
        if smallest < SMALLEST_SITE_PX:
            raise RadiometryError(
                f"{self._what}: the region has {_size(frame)}, but {SMALLEST_SITE_PX} rows and columns of every "
                "channel are needed; correct plan.region"
            )
        self._mean, self._squares = np.zeros(frame.shape), np.zeros(frame.shape)

    def _channel(self, sites: Sites) -> StackStatistics:
        """Pool the sites of a channel: pixel numbers add, everything else is averaged."""
        means = np.array([_at(self._mean, site).mean() for site in sites])
        spatial = [_variance(_at(self._mean, site)) for site in sites]
        rough = [_second_difference_variance(_at(self._mean, site)) for site in sites]
        split = [_rows_and_columns(_at(self._mean, site)) for site in sites]
        lines = {part.name: _pooled([getattr(site, part.name) for site in split]) for part in fields(RowsAndColumns)}
        pixels = [_at(self._mean, site).size for site in sites]
        return StackStatistics(
            frames=self._count,
            pixels=sum(pixels),
            mean_dn=float(means.mean()),
            variance_dn2=float(np.mean([self._temporal_variance(site) for site in sites])),
            saturated_fraction=sum(self._saturated[site] for site in sites) / (self._count * sum(pixels)),
            empty_fraction=sum(self._empty[site] for site in sites) / (self._count * sum(pixels)),
            frame_means_dn=np.mean([self._frame_means[site] for site in sites], axis=0),
            spatial=_pooled(spatial),
            pixel_to_pixel=_pooled(rough),
            lines=RowsAndColumns(**lines),
        )

    def _temporal_variance(self, site: tuple[int, int, int]) -> float:
        """Return the variance in time of one pixel (DN^2) without the flicker common to all pixels of the site."""
        squares = _at(self._squares, site)
        total = float(squares.mean()) / (self._count - 1)
        flicker = float(np.var(self._frame_means[site], ddof=1))
        return (total - flicker) * squares.size / (squares.size - 1)


def _at(image: Frame, site: tuple[int, int, int]) -> Frame:
    """Return the pixels of a site."""
    row, column, step = site
    return image[row::step, column::step]


def _size(image: Frame) -> str:
    """Return the size of an image in words."""
    return " x ".join(map(str, image.shape)) + " px"


def _variance(image: Frame) -> SpatialVariance:
    """Return the variance over the pixels of an image."""
    squares = np.asarray((image - image.mean()) ** 2)
    variance = float(squares.sum()) / (squares.size - 1)
    return SpatialVariance(variance, float(np.sqrt(squares.var() / squares.size)))


def _second_difference_variance(image: Frame) -> SpatialVariance:
    """Return the variance of independent pixels; what changes slowly over the image drops out."""
    bent = np.diff(np.diff(image, 2, axis=0), 2, axis=1) / SECOND_DIFFERENCE_GAIN
    squares = np.asarray(bent**2)
    sd = float(np.sqrt(SECOND_DIFFERENCE_CORRELATION * squares.var() / squares.size))
    return SpatialVariance(float(squares.mean()), sd)


def _rows_and_columns(image: Frame) -> RowsAndColumns:
    """Return the variances of whole rows, whole columns and the rest of an image."""
    rows, columns = image.mean(axis=1), image.mean(axis=0)
    rest = image - rows[:, None] - columns + image.mean()
    degrees = (len(rows) - 1) * (len(columns) - 1)
    squares = np.asarray(rest**2)
    pixels = SpatialVariance(float(squares.sum()) / degrees, float(np.sqrt(squares.var() / squares.size)))

    # light that is neither of a row nor of a column is no pixel's either, and would be taken off too much
    single = _second_difference_variance(image)

    def without(noise: SpatialVariance, variance: float, sd_rel: float, averaged: int) -> SpatialVariance:
        sd = np.hypot(variance * sd_rel, noise.sd_dn2 / averaged)
        return SpatialVariance(variance - noise.variance_dn2 / averaged, float(sd))

    def lines(means: Floats, averaged: int) -> SpatialVariance:
        return without(pixels, float(means.var(ddof=1)), np.sqrt(2.0 / (means.size - 1)), averaged)

    def line_to_line(means: Floats, averaged: int) -> SpatialVariance:
        bent = np.diff(means, 2)
        variance = float(np.mean(bent**2)) / LINE_DIFFERENCE_GAIN
        return without(single, variance, np.sqrt(2.0 * LINE_DIFFERENCE_CORRELATION / bent.size), averaged)

    return RowsAndColumns(
        rows=lines(rows, len(columns)),
        columns=lines(columns, len(rows)),
        pixels=pixels,
        row_to_row=line_to_line(rows, len(columns)),
        column_to_column=line_to_line(columns, len(rows)),
    )


def _pooled(parts: list[SpatialVariance]) -> SpatialVariance:
    """Return the mean of independent variances."""
    sd = float(np.sqrt(np.sum([part.sd_dn2**2 for part in parts]))) / len(parts)
    return SpatialVariance(float(np.mean([part.variance_dn2 for part in parts])), sd)


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
            f"{what}: the frames of {equal} of {len(stacks)} exposures are identical (variance 0 DN^2), so they show "
            "no noise; switch off noise reduction and averaging in the camera, and store each frame only once"
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


def nonuniformity(lit: StackStatistics, dark: StackStatistics | None, kind: Pattern) -> SpatialVariance:
    r"""Return the variance of the fixed pattern (DN^2): spatial minus what temporal noise leaves in the mean image.

    .. math:: s^2 = \Bigl(s_y^2 - \frac{\sigma_y^2}{L}\Bigr) - \Bigl(s_{dark}^2 - \frac{\sigma_{dark}^2}{L_{dark}}\Bigr)

    It may be negative by noise: its root then has an upper limit only. From the variances of whole rows and columns the
    temporal noise is taken out already.

    Parameters
    ----------
    lit
        Stack of L frames.
    dark
        Dark stack of the same exposure, subtracted; None for the pattern of `lit` itself.
    kind
        "spatial" (as it is), "pixel_to_pixel" (after second differences), or one of :class:`RowsAndColumns`.
    """
    signs = ((lit, 1.0),) if dark is None else ((lit, 1.0), (dark, -1.0))
    variance, sd_squares = 0.0, 0.0
    for stack, sign in signs:
        measured: SpatialVariance = getattr(stack.lines if hasattr(stack.lines, kind) else stack, kind)
        temporal = stack.variance_dn2 / stack.frames if kind in ("spatial", "pixel_to_pixel", "pixels") else 0.0
        variance += sign * (measured.variance_dn2 - temporal)
        sd_squares += measured.sd_dn2**2 + (temporal * stack.variance_sd_rel) ** 2
    return SpatialVariance(variance, float(np.sqrt(sd_squares)))


Z68, Z95, Z95_ONE_SIDED = 0.9944578832, 1.9599639845, 1.6448536270


def normal_estimate(mean: float, sd: float) -> Estimate:
    """Return the estimate of a normally distributed value, in its unit."""
    return Estimate(
        estimate=mean,
        sd=sd,
        low68=mean - Z68 * sd,
        high68=mean + Z68 * sd,
        low95=mean - Z95 * sd,
        high95=mean + Z95 * sd,
    )


def non_negative(mean: float, sd: float, low: float = 0.0) -> Resolvable:
    """Return the estimate of a quantity that cannot be negative, with its upper limit when it is not resolved.

    Parameters
    ----------
    mean, sd
        Measured value, which noise may have made negative, and its standard deviation.
    low
        What noise alone would give on average; the lower ends of the intervals are lowered by it.
    """
    return _limited(mean, sd, low, lambda value: value)


def root_of(mean: float, sd: float, factor: float = 1.0) -> Resolvable:
    """Return `factor` times the square root of a measured variance, which noise may have made negative.

    Parameters
    ----------
    mean, sd
        Measured variance and its standard deviation, in the square of the result's unit over `factor`.
    factor
        Conversion to the result's unit.
    """
    return _limited(mean, sd, 0.0, lambda variance: factor * float(variance**0.5))


def _limited(mean: float, sd: float, low: float, scale: Callable[[float], float]) -> Resolvable:
    """Cut the intervals at zero and bring their ends to `scale`, which grows from 0."""

    def end(z: float) -> float:
        return scale(max(mean + z * sd - low * (z < 0), 0.0))

    resolved = end(-Z95) > 0.0
    # a mean below zero, by noise, is no better known
    low68, high68 = end(-Z68), scale(max(mean, 0.0) + Z68 * sd)
    return Resolvable(
        estimate=scale(max(mean, 0.0)),
        sd=0.5 * (high68 - low68),
        low68=low68,
        high68=high68,
        low95=end(-Z95),
        high95=scale(max(mean, 0.0) + (Z95 if resolved else Z95_ONE_SIDED) * sd),
        resolved=resolved,
    )
