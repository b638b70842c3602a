"""Images in files and streams: raw Bayer counts, and pictures whose size is known before they are decoded.

Raw counts come from TIFF, PNG, DNG, and JPEG of legacy Raspberry Pi cameras with appended raw data; pictures come from
PNG and JPEG that are whole. Of DNG the TIFF reader takes the plain ones, LibRaw (rawpy) packed, compressed and coded
ones.
"""

import io
import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from data_schemas import BadFrameError, FinrayError, MissingExtraError
from data_schemas.storage import (
    FIRST_RED,
    LARGEST_DECODED_BYTES,
    BayerOrder,
    parse_in_child,
    read_bytes,
    require_decoded_size,
    rggb_frame,
    tiff_image,
)

COLOUR_FILTER_ARRAY: Final = 32803
LINEARIZATION_TAG: Final = 50712
ORDER_OF_PATTERN: Final[dict[str, BayerOrder]] = {
    "".join(str("RGB".index(colour)) for colour in order): order for order in FIRST_RED
}


@dataclass(frozen=True, slots=True)
class DngImage:
    """What a DNG holds.

    Attributes
    ----------
    counts
        (H, W) raw counts (DN) of the active area.
    order
        Colours of its first 2 x 2 pixels, row by row.
    white_dn
        Count of full scale; 0 where the file does not say it.
    """

    counts: NDArray[np.uint16]
    order: BayerOrder
    white_dn: int


def read_dng(content: bytes, path: Path) -> DngImage:
    """Read the raw counts of a DNG; `path` says where `content` is from, for messages.

    Raises
    ------
    BadFrameError
        It is broken, holds no raw image, or one of another pattern than 2 x 2 Bayer.
    MissingExtraError
        It is packed, compressed or coded by a table, which needs rawpy.
    """
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            raw = [p for top in file.pages for p in (top, *(top.pages or ())) if p.photometric == COLOUR_FILTER_ARRAY]
            tags = raw[0].tags if raw else None
            plain = None if tags is None else _plain_counts(raw[0])
            pattern = b"" if tags is None else bytes(tags.valueof("CFAPattern", b""))
            white_dn = 0 if tags is None else int(np.ravel(tags.valueof("WhiteLevel", 0))[0])
    except Exception as error:  # of a broken file the TIFF reader raises nearly anything
        raise BadFrameError(f"{path}: cannot be read as DNG ({error}); check that the file is complete") from error
    if tags is None:
        raise BadFrameError(f"{path}: contains no colour filter array (Bayer) image; give a raw DNG")
    counts, sites = (plain, list(pattern)) if plain is not None else _by_libraw(content, path)
    order = ORDER_OF_PATTERN.get("".join(map(str, sites)))
    if order is None or counts.ndim != 2:
        raise BadFrameError(
            f"{path}: Bayer pattern {sites} of an image of shape {counts.shape} is not supported; supported patterns "
            f"are {', '.join(FIRST_RED)} (red 0, green 1, blue 2), of shape (H, W)"
        )
    return DngImage(counts, order, white_dn)


def _plain_counts(page: Any) -> NDArray[np.uint16] | None:
    """Return the active area of an uncompressed page of one or two whole bytes a count, without a table; else None."""
    require_decoded_size(page)
    is_coded = LINEARIZATION_TAG in page.tags
    if is_coded or page.compression != 1 or page.bitspersample not in (8, 16) or np.dtype(page.dtype).kind != "u":
        return None
    counts = np.asarray(page.asarray(), dtype=np.uint16)
    top, left, bottom, right = page.tags.valueof("ActiveArea") or (0, 0, *counts.shape[:2])
    return counts[top:bottom, left:right]


def _by_libraw(content: bytes, path: Path) -> tuple[NDArray[np.uint16], list[int]]:
    """Return counts and the colours of the first 2 x 2 pixels (red 0, green 1, blue 2)."""
    try:
        import rawpy  # the child needs it; without it there is no need for one
    except ImportError as error:
        raise MissingExtraError(
            f"{path}: reading a DNG whose counts are packed, compressed or coded by a table needs rawpy ({error}); "
            "install it with pip install 'finray-calib[dng]'"
        ) from None
    del rawpy
    value, arrays = parse_in_child(f"{__name__}:unpacked_dng", content, path, "DNG", BadFrameError)
    return arrays["counts"], list(value)


def unpacked_dng(content: bytes, where: str) -> tuple[list[int], dict[str, NDArray[np.uint16]]]:
    """Decode what is no plain DNG by LibRaw; it runs in a child process, for LibRaw is C++ and files lie."""
    import rawpy

    try:
        with rawpy.imread(io.BytesIO(content)) as raw:
            counts = np.array(raw.raw_image_visible, dtype=np.uint16)
            colours = raw.color_desc.decode()  # "RGBG": LibRaw tells the two greens apart
            sites = ["RGB".find(colours[site]) for site in np.ravel(raw.raw_colors_visible[:2, :2])]
    except (rawpy.LibRawError, ValueError, TypeError) as error:
        raise BadFrameError(f"{where}: cannot be read as DNG ({error}); check that the file is complete") from error
    return sites, {"counts": counts}


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
        A packed, compressed or coded DNG needs rawpy.
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
            f"{path}: is {counts.dtype} of shape {counts.shape}, but raw Bayer counts must be one number of 8 or 16 "
            "bits per pixel, of shape (H, W); export the raw data, not a picture"
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
        f"{path}: no raw data follow the JPEG, but a processed picture is not proportional to light; capture with "
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


PNG_START: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
_JPEG_CHANNELS: Final = 3


def read_picture(
    path: Path, what: str = "a picture (PNG or JPEG)", error: type[FinrayError] = BadFrameError
) -> NDArray[Any]:
    """Return a picture as OpenCV decodes it: (H, W) grey or (H, W, 3 or 4) blue, green, red (alpha).

    Parameters
    ----------
    path
        PNG or JPEG.
    what
        What should lie there, for messages.
    error
        Class of the error.

    Raises
    ------
    FinrayError
        Of the class `error`: the file is missing, is no PNG or JPEG, is cut off or damaged, or larger than
        :data:`data_schemas.storage.LARGEST_DECODED_BYTES` when decoded.
    """
    return decoded_picture(read_bytes(path, what, error), path, error)


def decoded_picture(content: bytes, where: object, error: type[FinrayError] = BadFrameError) -> NDArray[Any]:
    """Return the picture that bytes hold; see :func:`read_picture`."""
    import cv2

    if content.startswith(PNG_START):
        size = _png_bytes(content, where, error)
    elif content.startswith(JPEG_START):
        size = _jpeg_bytes(content, where, error)
    else:
        raise error(f"{where}: is neither PNG nor JPEG; give a PNG or JPEG picture")
    if not 0 < size <= LARGEST_DECODED_BYTES:
        raise error(
            f"{where}: takes {size / 2**20:.4g} MB when decoded, but must take more than 0 and at most "
            f"{LARGEST_DECODED_BYTES / 2**20:g} MB; give a smaller picture"
        )
    try:
        picture = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None:
        raise error(f"{where}: cannot be decoded, because the picture is corrupted; copy it again")
    return np.asarray(picture)


def _png_bytes(content: bytes, where: object, error: type[FinrayError]) -> int:
    """Return how many bytes a PNG's pixels have, after the checksums of all its chunks.

    Source: ISO/IEC 15948, 5.3: a chunk is its length, its name, that many bytes, and a CRC-32 of name and bytes.
    """
    at, size = len(PNG_START), None
    view = memoryview(content)
    while at + 12 <= len(content):
        length = int.from_bytes(view[at : at + 4])
        name = bytes(view[at + 4 : at + 8])
        end = at + 8 + length
        if end + 4 > len(content) or zlib.crc32(view[at + 4 : end]) != int.from_bytes(view[end : end + 4]):
            break
        if size is None:
            if name != b"IHDR" or length != 13:
                break
            width, height = int.from_bytes(view[at + 8 : at + 12]), int.from_bytes(view[at + 12 : at + 16])
            bits, colour = view[at + 16], view[at + 17]
            size = width * height * _PNG_CHANNELS.get(colour, 4) * (2 if bits == 16 else 1)
        if name == b"IEND":
            return size
        at = end + 4
    raise error(f"{where}: is a PNG that is truncated or corrupted (a checksum is wrong); copy it again")


def _jpeg_bytes(content: bytes, where: object, error: type[FinrayError]) -> int:
    """Return how many bytes a JPEG's pixels have; its end mark must be there, as a decoder fills in what is missing."""
    if not _ends_whole(content):
        raise error(f"{where}: is a truncated JPEG; copy it again")
    try:
        height, width = jpeg_size_px(content, str(where))
    except BadFrameError:
        raise error(f"{where}: is a JPEG with a corrupted header; copy it again") from None
    return width * height * _JPEG_CHANNELS


def _ends_whole(content: bytes) -> bool:
    """Return whether a JPEG reaches its end mark, segment by segment; cameras may write any data behind it."""
    at = len(JPEG_START)
    while (marker := _MARKER.search(content, at)) is not None:
        if marker[0].endswith(JPEG_END):
            return True
        at = marker.end() + int.from_bytes(content[marker.end() : marker.end() + 2])
    return False


JPEG_START, JPEG_END, PADDING = b"\xff\xd8", b"\xff\xd9", b"\x00\r\n"
# In the data of a scan 0xFF stands before 0, or before the number of a restart (ITU-T T.81, B.1.1.5).
_MARKER: Final = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]", re.DOTALL)


def decoded_jpeg(body: bytes, name: str) -> NDArray[np.uint8]:
    """Return the picture of a JPEG, (H, W, 3) RGB.

    Parameters
    ----------
    body
        The bytes; zeros and line ends may follow the JPEG.
    name
        Where it comes from, for the message.

    Raises
    ------
    BadFrameError
        It is cut off or no JPEG at all.
    """
    whole = body.rstrip(PADDING)
    bgr = None
    # A decoder fills the missing part of a cut-off JPEG with grey and says nothing: the end mark must be there.
    if whole.startswith(JPEG_START) and whole.endswith(JPEG_END):
        try:
            bgr = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        except cv2.error:
            bgr = None
    if bgr is None:
        raise BadFrameError(f"{name}: sent a picture of {len(body)} bytes that is incomplete or not a JPEG")
    return np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)


def jpeg_size_px(body: bytes, name: str) -> tuple[int, int]:
    """Return height and width of a JPEG as its frame header states them; nothing is decoded.

    Raises
    ------
    BadFrameError
        It has no frame header where one must be.

    Notes
    -----
    ITU-T T.81, B.1 and B.2.2: segments of a marker (0xFF and a byte) and a length that counts itself; the markers
    C0 to CF but C4, C8 and CC begin a frame header: length, precision (1 byte), lines (2), samples a line (2).
    """
    at = len(JPEG_START)
    while body.startswith(JPEG_START) and at + 9 <= len(body) and body[at] == 0xFF:
        marker = body[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(body[at + 5 : at + 7]), int.from_bytes(body[at + 7 : at + 9])
        length = int.from_bytes(body[at + 2 : at + 4])
        if length < 2 or marker in (0xD9, 0xDA):
            break
        at += 2 + length
    raise BadFrameError(f"{name}: sent a picture of {len(body)} bytes that is incomplete or not a JPEG")
