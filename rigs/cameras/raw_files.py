"""Raw Bayer counts of image files: TIFF, PNG, DNG, and JPEG of legacy Raspberry Pi cameras with appended raw data."""

import io
import re
import struct
from pathlib import Path
from typing import Any, Final

import numpy as np
import tifffile
from numpy.typing import NDArray

from data_schemas.bayer import BayerOrder, rggb_frame
from data_schemas.errors import BadFrameError
from data_schemas.foreign_files import read_bytes
from data_schemas.frame_files import tiff_image
from rigs.cameras.dng_file import read_dng
from rigs.cameras.picture_files import decoded_picture

JPEG_SUFFIXES: Final = (".jpeg", ".jpg")
SUFFIXES: Final = (".dng", ".png", ".tif", ".tiff", *JPEG_SUFFIXES)
EXPOSURE_TAG, EXIF_TAG = 33434, 34665

# The raw block that raspistill --raw and picamera append to a JPEG (documented in picamera's array module): "BRCM",
# a header at byte 176, packed rows from byte 32768; a row is padded to 32 bytes, the number of rows to 16.
BRCM_MARK: Final = b"BRCM"
BRCM_HEADER_AT, BRCM_PIXELS_AT = 176, 32768
BRCM_HEADER: Final = struct.Struct("<32s4H24s2H2B")
BRCM_ORDERS: Final[tuple[BayerOrder, ...]] = ("RGGB", "GBRG", "BGGR", "GRBG")
BRCM_BITS: Final = {3: 10, 4: 12}
ROW_BYTES, ROWS = 32, 16


def read_raw(path: Path) -> NDArray[np.uint16]:
    """Read raw Bayer counts (DN) with pattern RGGB, shape (H, W).

    A row or column is cut off where the sensor begins with another colour than red.

    Raises
    ------
    BadFrameError
        The file is unreadable, or holds a processed picture.
    MissingExtraError
        A packed or compressed DNG needs rawpy.
    """
    suffix = path.suffix.lower()
    if suffix in JPEG_SUFFIXES:
        return _appended_raw(read_content(path), path)
    if suffix == ".dng":
        image = read_dng(read_content(path), path)
        return rggb_frame(image.counts, image.order)
    return read_plain_counts(path)


def read_plain_counts(path: Path) -> NDArray[np.uint16]:
    """Read the counts (DN) of a TIFF or PNG, shape (H, W); neither says its Bayer pattern.

    Raises
    ------
    BadFrameError
        The file is unreadable, or holds a processed picture.
    """
    content = read_content(path)
    png = path.suffix.lower() == ".png"
    counts = decoded_picture(content, path) if png else tiff_image(content, path, BadFrameError)
    if counts.ndim != 2 or counts.dtype not in (np.uint8, np.uint16):
        raise BadFrameError(
            f"{path}: is {counts.dtype} of shape {counts.shape}; raw Bayer counts are one number of 8 or 16 bits per "
            "pixel (H, W): export the raw data, not a picture"
        )
    return counts.astype(np.uint16)


def read_exposure_s(path: Path) -> float | None:
    """Return the exposure time (s) that the EXIF data of a TIFF, DNG or JPEG state; None where they do not.

    Raises
    ------
    BadFrameError
        The file is unreadable.
    """
    content = read_content(path)
    if path.suffix.lower() not in JPEG_SUFFIXES:
        return _exposure_in_tiff_s(content)
    mark = content.find(b"Exif\0\0", 0, 65536)
    if mark < 2:
        return None
    size = int.from_bytes(content[mark - 2 : mark], "big")
    return _exposure_in_tiff_s(content[mark + 6 : mark - 2 + size])


def read_content(path: Path) -> bytes:
    """Return the bytes of an image file.

    Raises
    ------
    BadFrameError
        It is missing or cannot be read.
    """
    return read_bytes(path, "an image (DNG, TIFF, PNG, JPEG)", BadFrameError)


def _exposure_in_tiff_s(content: bytes) -> float | None:
    """Return the exposure time (s) of a TIFF, DNG or EXIF block, where it has one."""
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            tags = file.pages[0].tags
            value = tags.valueof(EXPOSURE_TAG)
            if value is None:
                value = (tags.valueof(EXIF_TAG) or {}).get("ExposureTime")
            return _seconds(value)
    except Exception:  # of a broken file the TIFF reader raises nearly anything; without a tag there is no exposure
        return None


def _seconds(value: Any) -> float | None:
    """Return a rational or plain number of seconds; None where it is none."""
    if value is None:
        return None
    seconds = float(value[0] / value[1]) if isinstance(value, tuple) else float(value)
    return seconds if np.isfinite(seconds) and seconds > 0.0 else None


def _appended_raw(content: bytes, path: Path) -> NDArray[np.uint16]:
    """Read the raw block behind a JPEG."""
    for start in (match.start() for match in re.finditer(BRCM_MARK, content)):
        found = _raw_block(content[start:])
        if found is not None:
            return found
    raise BadFrameError(
        f"{path}: no raw data follow the JPEG; a processed picture is not proportional to light: capture with "
        "'raspistill --raw', or use DNG or TIFF"
    )


def _raw_block(block: bytes) -> NDArray[np.uint16] | None:
    """Return the counts of a raw block, or None where it is none."""
    if len(block) < BRCM_PIXELS_AT:
        return None
    header = BRCM_HEADER.unpack_from(block, BRCM_HEADER_AT)
    _, width, height, pad_right, pad_down, _, _, _, order, coded = header
    bits = BRCM_BITS.get(coded)
    if bits is None or order >= len(BRCM_ORDERS) or not width or not height:
        return None
    group = {10: 5, 12: 3}[bits]  # bytes that hold 4 pixels of 10 or 2 of 12 bits
    row = _padded(-(-(width + pad_right) * bits // 8), ROW_BYTES)
    rows = _padded(height + pad_down, ROWS)
    if len(block) != BRCM_PIXELS_AT + row * rows:
        return None
    packed = np.frombuffer(block, dtype=np.uint8, offset=BRCM_PIXELS_AT).reshape(rows, row)[:height]
    pixels = group - 1
    groups = -(-width // pixels)
    if groups * group > row:
        return None
    sites = packed[:, : groups * group].reshape(height, groups, group).astype(np.uint16)
    low_bits = bits - 8
    shifts = np.arange(pixels, dtype=np.uint16) * np.uint16(low_bits)
    low = (sites[..., -1:] >> shifts) & np.uint16(2**low_bits - 1)
    counts = ((sites[..., :-1] << np.uint16(low_bits)) | low).reshape(height, groups * pixels)[:, :width]
    return rggb_frame(counts, BRCM_ORDERS[order])


def _padded(size: int, multiple: int) -> int:
    """Return the next multiple."""
    return -(-size // multiple) * multiple
