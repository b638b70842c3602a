"""Pictures of PNG and JPEG files: their size and their wholeness are known before anything is decoded."""

import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import BadFrameError, FinrayError
from data_schemas.foreign_files import read_bytes
from data_schemas.frame_files import LARGEST_DECODED_BYTES
from rigs.cameras.jpeg_picture import JPEG_END, JPEG_START, PADDING, jpeg_size_px

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
        :data:`data_schemas.frame_files.LARGEST_DECODED_BYTES` when decoded.
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
        raise error(f"{where}: is neither PNG nor JPEG; give a picture of one of these kinds")
    if not 0 < size <= LARGEST_DECODED_BYTES:
        raise error(
            f"{where}: takes {size / 2**20:.4g} MB when decoded; more than 0 and at most "
            f"{LARGEST_DECODED_BYTES / 2**20:g} MB are allowed: give a smaller picture"
        )
    try:
        picture = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    if picture is None:
        raise error(f"{where}: cannot be decoded; the picture is damaged: copy it again")
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
    raise error(f"{where}: is a PNG that is cut off or damaged (a checksum is wrong); copy it again")


def _jpeg_bytes(content: bytes, where: object, error: type[FinrayError]) -> int:
    """Return how many bytes a JPEG's pixels have; its end mark must be there, as a decoder fills in what is missing."""
    if content.find(JPEG_END, len(JPEG_START)) < 0 or not _ends_whole(content):
        raise error(f"{where}: is a JPEG that is cut off; copy it again")
    try:
        height, width = jpeg_size_px(content, str(where))
    except BadFrameError:
        raise error(f"{where}: is a JPEG whose header is damaged; copy it again") from None
    return width * height * _JPEG_CHANNELS


def _ends_whole(content: bytes) -> bool:
    """Return whether the last scan of a JPEG ends with its mark; cameras may write more data behind it."""
    return content.rstrip(PADDING).endswith(JPEG_END) or content.rfind(JPEG_END) > content.rfind(b"\xff\xda")
