"""Raspberry Pi files: raw Bayer counts (DNG, 16-bit TIFF), processed 8-bit images (PNG, JPEG), libcamera tunings."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.bayer import BayerOrder
from data_schemas.errors import BadFrameError, ImportFormatError
from data_schemas.foreign_files import LARGEST_TOML_BYTES, parse_json, read_bytes
from finray_calib.radiometry.libcamera_tuning import LibcameraTuning, parse_tuning
from rigs.cameras.dng_file import read_dng
from rigs.cameras.picture_files import read_picture
from rigs.cameras.raw_files import read_content, read_plain_counts

BitDepth = Literal[8, 10, 12, 14, 16]
BIT_DEPTHS: tuple[BitDepth, ...] = (8, 10, 12, 14, 16)
RAW_SUFFIXES = (".dng", ".tiff", ".tif")
PROCESSED_SUFFIXES = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True, slots=True)
class RawImage:
    """Raw Bayer counts (H, W) with the order of the colours and the bits of a count."""

    counts: NDArray[np.uint16]
    order: BayerOrder
    bit_depth: BitDepth


@dataclass(frozen=True, slots=True)
class ProcessedImage:
    """Encoded red, green and blue (H, W, 3) of a PNG or JPEG."""

    codes: NDArray[np.uint8]
    compressed: bool


def read_image(path: Path, order: BayerOrder | None, bit_depth: BitDepth | None) -> RawImage | ProcessedImage:
    """Read one image.

    Parameters
    ----------
    path
        DNG, TIFF, PNG or JPEG.
    order, bit_depth
        Bayer order and bits of a 16-bit TIFF, which cannot tell them; a DNG says them itself.

    Raises
    ------
    ImportFormatError
        The file is unreadable, or what its values mean cannot be known.
    MissingExtraError
        A packed or compressed DNG needs rawpy.
    """
    if path.suffix.lower() == ".dng":
        return _read_dng(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        return _read_bayer_tiff(path, order, bit_depth)
    bgr = read_picture(path, "a processed image (PNG, JPEG)", ImportFormatError)
    if bgr.dtype != np.uint8 or bgr.ndim != 3 or bgr.shape[2] != 3:
        raise ImportFormatError(
            f"{path}: is {bgr.dtype} of shape {bgr.shape}; a processed image is an 8-bit colour PNG or JPEG"
        )
    return ProcessedImage(np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8), path.suffix.lower() != ".png")


def read_tuning(path: Path) -> LibcameraTuning:
    """Read a libcamera tuning file.

    Raises
    ------
    ImportFormatError
        The file is missing, is not JSON, or is no Raspberry Pi tuning.
    """
    content = read_bytes(
        path, "the tuning file of the camera (libcamera's .json)", ImportFormatError, LARGEST_TOML_BYTES
    )
    # libcamera's own parser allows a comma after the last entry, and shipped files have some.
    document = parse_json(re.sub(rb",(\s*+[}\]])", rb"\1", content), path, ImportFormatError)
    try:
        return parse_tuning(document)
    except ImportFormatError as error:
        raise ImportFormatError(f"{path}: {error}") from None


def _read_dng(path: Path) -> RawImage:
    """Read a DNG, which says the order of its colours and its bits."""
    try:
        image = read_dng(read_content(path), path)
    except BadFrameError as error:
        raise ImportFormatError(str(error)) from error
    depths = [bits for bits in BIT_DEPTHS if 2**bits - 1 == image.white_dn]
    if not depths:
        raise ImportFormatError(
            f"{path}: white level {image.white_dn} DN is not understood; known is 2^bits - 1 for {BIT_DEPTHS} bits"
        )
    return RawImage(image.counts, image.order, depths[0])


def _read_bayer_tiff(path: Path, order: BayerOrder | None, bit_depth: BitDepth | None) -> RawImage:
    """Read Bayer counts of a TIFF, which says neither the order of its colours nor its bits."""
    if order is None or bit_depth is None:
        raise ImportFormatError(
            f"{path}: a TIFF does not say its Bayer order and bit depth, so its encoding cannot be known; give both "
            "(--bayer-order, --bit-depth), or use the DNG"
        )
    try:
        counts = read_plain_counts(path)
    except BadFrameError as error:
        raise ImportFormatError(str(error)) from error
    if int(counts.max()) >= 2**bit_depth:
        raise ImportFormatError(
            f"{path}: holds {counts.max()} DN, more than {bit_depth} bits allow ({2**bit_depth - 1}); correct "
            "--bit-depth"
        )
    return RawImage(counts, order, bit_depth)
