"""From linear images to what a screen shows: white balance, sRGB transfer, outlines, PNG bytes and data URIs."""

import base64

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import RecordError

FloatImage = NDArray[np.float64]
ByteImage = NDArray[np.uint8]

WHITE_PERCENTILE = 99.5
"""Share of pixels, in per cent, that must not clip in the display; the rest are glints and hot pixels."""


CLIPPED_GREYS = (225, 140)
"""The two levels that clipped pixels are drawn with."""


def display_white(image: NDArray[np.floating]) -> FloatImage:
    """Return the value of each channel that a display shall show as white, (3,): a high percentile.

    Parameters
    ----------
    image
        (..., 3) pixels to balance by, any unit.

    Raises
    ------
    RecordError
        When a channel has no light to balance by.
    """
    white = np.nanpercentile(np.asarray(image, dtype=np.float64).reshape(-1, 3), WHITE_PERCENTILE, axis=0)
    if not (white > 0).all():
        raise RecordError(
            f"display image: the {WHITE_PERCENTILE} % brightest pixels per channel are {white.tolist()}; every channel "
            "must be above 0 to be shown white-balanced: check black level and exposure"
        )
    return np.asarray(white)


def to_display(image: NDArray[np.floating], white: FloatImage, linear: bool) -> ByteImage:
    """Return 8-bit sRGB code values of an image: divided by the white of each channel, then the sRGB transfer.

    s = 12.92 v up to v = 0.0031308, else 1.055 v^(1/2.4) - 0.055 (IEC 61966-2-1). Encoded values (`linear`
    False) have their curve already and are only scaled.

    Parameters
    ----------
    image
        (H, W, 3), any unit; NaN is shown black.
    white
        (3,) value per channel shown as white, same unit.
    """
    value = np.clip(np.nan_to_num(np.asarray(image, dtype=np.float64)) / white, 0.0, 1.0)
    if linear:
        value = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * value), dtype=np.uint8)


def with_outline(image: ByteImage, mask: NDArray[np.bool_]) -> ByteImage:
    """Return the image with the border of a mask drawn as a white line beside a black one (seen on any ground).

    The mask is stretched to the image when their sizes differ.
    """
    height, width = image.shape[:2]
    inside = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    outer = cv2.dilate(inside, cross) > inside
    inner = inside > cv2.erode(inside, cross, borderValue=1)
    drawn = image.copy()
    drawn[outer] = 0
    drawn[inner] = 255
    return drawn


def missing(image: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return which pixels (H, W) of an image (H, W, 3) have a channel without value."""
    return np.asarray(np.isnan(image).any(axis=-1), dtype=np.bool_)


def with_clipped(image: ByteImage, clipped: NDArray[np.bool_]) -> ByteImage:
    """Return the image with clipped pixels as a chequerboard of two greys, which no colour of light looks like.

    Where a channel is at full scale the colour is not known: shown as it is, or unmixed, it takes a false one.
    """
    drawn = image.copy()
    rows, columns = np.nonzero(clipped)
    drawn[rows, columns] = np.where((rows // 2 + columns // 2) % 2 == 0, *CLIPPED_GREYS)[:, None]
    return drawn


def clipped_remark(clipped: NDArray[np.bool_]) -> str:
    """Return what a caption says of clipped pixels; nothing where there are none."""
    return " Grey chequers: clipped, the colour is not known." if clipped.any() else ""


def png_bytes(rgb: ByteImage) -> bytes:
    """Return an (H, W, 3) sRGB image as PNG bytes."""
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
    return encoded.tobytes()


def png_data_uri(rgb: ByteImage) -> str:
    """Return an (H, W, 3) sRGB image as a PNG data URI for an HTML image."""
    return "data:image/png;base64," + base64.b64encode(png_bytes(rgb)).decode("ascii")
