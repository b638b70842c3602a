r"""Running mean and variance of a stack of equal exposures, and what photon transfer needs of them per channel.

Welford's update keeps one mean and one sum of squared deviations per pixel, so that memory does not grow with the
number of frames:

.. math:: m_n = m_{n-1} + \frac{d}{n}, \qquad q_n = q_{n-1} + d^2 \frac{n - 1}{n}, \qquad d = x_n - m_{n-1}

Source: B. P. Welford, Technometrics 4 (1962) 419.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import RadiometryError

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
SECOND_DIFFERENCE_CORRELATION = (1.0 + 2.0 * ((2.0 / 3.0) ** 2 + (1.0 / 6.0) ** 2)) ** 2


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
                f"{self._what}: frame {self._count + 1} holds NaN or infinite counts; give raw frames of whole counts"
            )
        if self._count == 0:
            self._start(frame)
        if frame.shape != self._mean.shape:
            raise RadiometryError(
                f"{self._what}: frame {self._count + 1} has {_size(frame)}, those before have {_size(self._mean)}; "
                "frames of a session must be equal in size: capture it again"
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
                f"{self._what}: {self._count} frame, at least {FEWEST_FRAMES} of the same exposure are needed to tell "
                "noise from pattern: raise plan.frames_per_level"
            )
        return tuple(self._channel(sites) for sites in self._channels)

    def _start(self, frame: Frame) -> None:
        """Take the shape of the first frame."""
        smallest = min(_at(frame, site).shape[axis] for site in self._frame_means for axis in (0, 1))
        if smallest < SMALLEST_SITE_PX:
            raise RadiometryError(
                f"{self._what}: the region has {_size(frame)}; {SMALLEST_SITE_PX} rows and columns of every channel "
                "are needed: correct plan.region"
            )
        self._mean, self._squares = np.zeros(frame.shape), np.zeros(frame.shape)

    def _channel(self, sites: Sites) -> StackStatistics:
        """Pool the sites of a channel: pixel numbers add, everything else is averaged."""
        means = np.array([_at(self._mean, site).mean() for site in sites])
        spatial = [_variance(_at(self._mean, site)) for site in sites]
        rough = [_second_difference_variance(_at(self._mean, site)) for site in sites]
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


def _pooled(parts: list[SpatialVariance]) -> SpatialVariance:
    """Return the mean of independent variances."""
    sd = float(np.sqrt(np.sum([part.sd_dn2**2 for part in parts]))) / len(parts)
    return SpatialVariance(float(np.mean([part.variance_dn2 for part in parts])), sd)
