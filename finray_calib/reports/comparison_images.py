"""The images of a comparison as a screen shows them, and what the touch changes in each, on one scale."""

from dataclasses import dataclass
from math import ceil, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.errors import RecordError
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.linear_image import full_scale_dn, rgb_image
from finray_calib.reports.images import ByteImage, display_white, missing, to_display, with_clipped, with_outline
from finray_calib.reports.touch_images import pad_window, shown_bands

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
LARGEST_PIXELS = 100_000
"""Pictures have no more: a noisy image hardly compresses, and the page should travel by e-mail."""
LARGEST_MAP_PIXELS = 45_000
"""Nor maps: single pixels of a noisy difference say nothing."""
_LARGEST_SIDE_PX, _LEAST_BLOCKS = 8, 16
_SD_OF_MEDIAN_STEP = 1.4826 / sqrt(2.0)
"""Standard deviation of one value by the median absolute difference of two."""


@dataclass(frozen=True, slots=True)
class TouchPictures:
    """The pad in 8-bit sRGB: captured untouched and touched, simulated touched; scored regions outlined.

    `clipped` are the masks of the clipped pixels of both captured pictures, which are drawn as such.
    """

    captured_untouched: ByteImage
    captured: ByteImage
    simulated: ByteImage
    clipped: tuple[Mask, Mask]


@dataclass(frozen=True, slots=True)
class TouchChanges:
    """What the touch changes, mean over the channels relative to the untouched level, (H, W); NaN where clipped.

    `regions` are the outlines of the scored regions on the same grid.
    """

    captured: Floats
    simulated: Floats
    regions: tuple[Mask, ...]

    @property
    def scale(self) -> float:
        """Return the end of a common colour scale: what 99 % of the values of both maps stay below."""
        both = np.abs(np.stack([self.captured, self.simulated]))
        top = float(np.nanpercentile(both, 99.0)) if np.isfinite(both).any() else 0.0
        return top if top > 0 else 1.0


def require_one_grid(press: SimulatedPress, capture: TactileCapture) -> None:
    """Refuse a render that is not on the grid of the capture.

    Raises
    ------
    RecordError
        Their sizes differ.
    """
    height, width = rgb_image(capture.no_contact, capture).shape[:2]
    if press.contact.shape[:2] != (height, width):
        raise RecordError(
            f"comparison page: the render has {press.contact.shape[1]} x {press.contact.shape[0]} px, the capture "
            f"{width} x {height} px; give the render on the grid of the capture (registered)"
        )


def touch_pictures(press: SimulatedPress, capture: TactileCapture, factors: tuple[float, ...]) -> TouchPictures:
    """Return capture and render as pictures, cut to the pad, with the regions of these half-widths outlined.

    Linear light is divided by the white of each untouched pad, with common headroom for what the touch makes brighter;
    encoded values are shown as they are.
    """
    linear, window = capture.encoding == "linear", pad_window(press)
    captured = [shown_bands(press, rgb_image(image, capture)) for image in (capture.no_contact, capture.contact)]
    simulated = [shown_bands(press, image.astype(np.float64)) for image in (press.no_contact, press.contact)]
    if linear:
        whites = _whites(captured, simulated, np.isfinite(press.distance))
    else:
        whites = [np.full(3, full_scale_dn(capture))] * 2
    untouched, touched = (missing(image[window]) for image in captured)
    clipped = (untouched, touched)
    masks = [press.distance[window] <= factor for factor in factors]
    return TouchPictures(
        _fitted(with_clipped(to_display(captured[0][window], whites[0], linear), clipped[0])),
        _outlined(with_clipped(to_display(captured[1][window], whites[0], linear), clipped[1]), masks),
        _outlined(to_display(simulated[1][window], whites[1], linear), masks),
        clipped,
    )


def _whites(captured: list[Floats], simulated: list[Floats], pad: Mask) -> list[Floats]:
    """Return what is shown white in capture and render, from the untouched and the touched image of each."""
    before, after = ([display_white(pair[i][pad]) for pair in (captured, simulated)] for i in (0, 1))
    headroom = max(1.0, *(float((a / b).max()) for a, b in zip(after, before, strict=True)))
    return [headroom * white for white in before]


def touch_changes(press: SimulatedPress, capture: TactileCapture, factors: tuple[float, ...]) -> TouchChanges:
    """Return what the touch changes in capture and render.

    change = mean over the channels of (contact - no contact) / mean no-contact level over the pad

    Each side is divided by its own level, so an exposure common to both of its images cancels. Noisy maps are averaged
    over blocks, so that what the touch changes is seen.
    """
    window, pad = pad_window(press), np.isfinite(press.distance)
    captured = _change(rgb_image(capture.no_contact, capture), rgb_image(capture.contact, capture), pad)
    simulated = _change(press.no_contact.astype(np.float64), press.contact.astype(np.float64), pad)
    regions = tuple((press.distance <= factor)[window] for factor in factors)
    side = max(_steady_side(image[window]) for image in (captured, simulated))
    return TouchChanges(coarser(captured[window], side), coarser(simulated[window], side), regions)


def _change(no_contact: Floats, contact: Floats, pad: Mask) -> Floats:
    """Return the relative change of one side."""
    level = np.nanmean(no_contact[pad], axis=0)
    return np.asarray(((contact - no_contact) / level).mean(axis=-1))


def _steady_side(values: Floats) -> int:
    """Return the side of blocks whose noise is a tenth of what the map shows; at most 8 px, and 16 blocks stay.

    The noise is the median of the differences of neighbours, as that of a normal distribution.
    """
    steps = np.abs(np.diff(values, axis=1))
    noise = float(np.nanmedian(steps)) * _SD_OF_MEDIAN_STEP
    largest = max(1, min(_LARGEST_SIDE_PX, min(values.shape) // _LEAST_BLOCKS))
    shown = np.abs(coarser(values, largest))
    level = float(np.nanpercentile(shown, 99.0)) if np.isfinite(shown).any() else 0.0
    side = 1
    while 2 * side <= largest and noise / side > 0.1 * level:
        side *= 2
    return side


def coarser(values: Floats, least_side_px: int = 1) -> Floats:
    """Return a map averaged over blocks until it has few enough pixels; NaN stays out of the means."""
    side = max(least_side_px, ceil(sqrt(values.size / LARGEST_MAP_PIXELS)))
    rows, columns = (max(n // side, 1) for n in values.shape)
    blocks = values[: rows * side, : columns * side].reshape(rows, side, columns, side)
    known = np.isfinite(blocks).sum(axis=(1, 3))
    total = np.nansum(blocks, axis=(1, 3))
    return np.where(known > 0, total / np.maximum(known, 1), np.nan)


def _fitted(image: ByteImage) -> ByteImage:
    """Return the picture, made smaller where it has too many pixels."""
    height, width = image.shape[:2]
    share = sqrt(LARGEST_PIXELS / (height * width))
    if share >= 1:
        return image
    size = (max(int(width * share), 1), max(int(height * share), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _outlined(image: ByteImage, masks: list[Mask]) -> ByteImage:
    """Return the fitted picture with every region outlined."""
    drawn = _fitted(image)
    for mask in masks:
        drawn = with_outline(drawn, mask)
    return drawn
