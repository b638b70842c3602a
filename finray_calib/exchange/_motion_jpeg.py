"""Frames of a video whose frames are JPEG pictures (Motion JPEG in AVI, as webcams and OpenCV write it).

Only the container is read here; each frame is decoded as a picture. Other videos are to be converted first.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

from data_schemas import ImportFormatError
from data_schemas.storage import read_bytes

LARGEST_VIDEO_BYTES = 512 << 20
MOST_FRAMES = 20_000
_HEADER_BYTES = 8
_DEEPEST_LIST = 6
_CONVERT = "convert the video: ffmpeg -i VIDEO -c:v mjpeg -q:v 1 VIDEO.avi, or to pictures"


def motion_jpeg_frames(path: Path) -> list[bytes]:
    """Return the JPEG bytes of every frame of an AVI file, in order.

    Raises
    ------
    ImportFormatError
        The file is missing, no AVI, its frames are no JPEG pictures, or there are too many.
    """
    content = read_bytes(path, "a Motion-JPEG video (AVI)", ImportFormatError, LARGEST_VIDEO_BYTES)
    if content[:4] != b"RIFF" or content[8:12] != b"AVI ":
        raise ImportFormatError(f"{path}: is no AVI video; {_CONVERT}")
    frames = [part for part in _parts(content, 0, len(content), 0) if part]
    if not frames or len(frames) > MOST_FRAMES:
        raise ImportFormatError(
            f"{path}: holds {len(frames)} frames; 1 to {MOST_FRAMES} are allowed: give a part of it"
        )
    if not all(frame.startswith(b"\xff\xd8") for frame in frames):
        raise ImportFormatError(f"{path}: its frames are no JPEG pictures (Motion JPEG); {_CONVERT}")
    return frames


def _parts(content: bytes, at: int, end: int, depth: int) -> Iterator[bytes]:
    """Return the video chunks between two places; lists are entered, what is cut off is left out."""
    while at + _HEADER_BYTES <= end:
        name, size = content[at : at + 4], struct.unpack("<I", content[at + 4 : at + 8])[0]
        start, stop = at + _HEADER_BYTES, at + _HEADER_BYTES + size
        if name in (b"RIFF", b"LIST") and depth < _DEEPEST_LIST:
            yield from _parts(content, start + 4, min(stop, end), depth + 1)
        elif name[2:] in (b"dc", b"db") and stop <= end:
            yield content[start:stop]
        at = stop + size % 2
