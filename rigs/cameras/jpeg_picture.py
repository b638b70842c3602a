"""Pictures of a JPEG stream: their size before anything is decoded, and their pixels only when they are whole."""

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import BadFrameError

JPEG_START, JPEG_END, PADDING = b"\xff\xd8", b"\xff\xd9", b"\x00\r\n"


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
        raise BadFrameError(f"{name}: sent a picture of {len(body)} bytes that is torn or no JPEG")
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
    raise BadFrameError(f"{name}: sent a picture of {len(body)} bytes that is torn or no JPEG")
