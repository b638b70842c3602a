"""Frames of Motion-JPEG videos (AVI), and which of them hold the contact."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError
from data_schemas.storage import read_bytes

Floats = NDArray[np.float64]

LARGEST_VIDEO_BYTES = 512 << 20
MOST_FRAMES = 20_000
_HEADER_BYTES = 8
_DEEPEST_LIST = 6
CONVERT_VIDEO: Final = "convert the video: ffmpeg -i VIDEO -c:v mjpeg -q:v 1 VIDEO.avi, or to pictures"


def motion_jpeg_frames(path: Path) -> list[bytes]:
    """Return the JPEG bytes of every frame of an AVI file, in order.

    Raises
    ------
    ImportFormatError
        The file is missing, no AVI, its frames are no JPEG pictures, or there are too many.
    """
    content = read_bytes(path, "a Motion-JPEG video (AVI)", ImportFormatError, LARGEST_VIDEO_BYTES)
    if content[:4] != b"RIFF" or content[8:12] != b"AVI ":
        raise ImportFormatError(f"{path}: is not an AVI video; {CONVERT_VIDEO}")
    frames: list[bytes] = []
    for part in _video_parts(content, 0, len(content), 0):
        # a frame without content is one that was dropped: the one before it is shown again
        frames += [part] if part else frames[-1:]
    if not frames or len(frames) > MOST_FRAMES:
        raise ImportFormatError(f"{path}: holds {len(frames)} frames; 1 to {MOST_FRAMES} are allowed: cut the video")
    if not all(frame.startswith(b"\xff\xd8") for frame in frames):
        raise ImportFormatError(f"{path}: its frames are not JPEG pictures (Motion JPEG); {CONVERT_VIDEO}")
    return frames


def _video_parts(content: bytes, at: int, end: int, depth: int) -> Iterator[bytes]:
    """Return the video chunks between two places; lists are entered, what is cut off is left out."""
    while at + _HEADER_BYTES <= end:
        name, size = content[at : at + 4], struct.unpack("<I", content[at + 4 : at + 8])[0]
        start, stop = at + _HEADER_BYTES, at + _HEADER_BYTES + size
        if name in (b"RIFF", b"LIST") and depth < _DEEPEST_LIST:
            yield from _video_parts(content, start + 4, min(stop, end), depth + 1)
        elif name[2:] in (b"dc", b"db") and stop <= end:
            yield content[start:stop]
        at = stop + size % 2


#: Frames whose change is at least the first share of the largest hold the contact; below the other there is none.
HOLD_SHARE, REST_SHARE = 0.9, 0.3


def longest_hold(strength: Floats) -> int:
    """Return the middle of the longest run of frames near the largest value."""
    held = np.concatenate([[False], strength >= HOLD_SHARE * strength.max(), [False]])
    starts, stops = np.flatnonzero(~held[:-1] & held[1:]), np.flatnonzero(held[:-1] & ~held[1:])
    longest = int(np.argmax(stops - starts))
    return int((starts[longest] + stops[longest] - 1) // 2)


def small_frame(picture: NDArray[Any]) -> Floats:
    """Return a frame in few pixels, for choosing frames."""
    return np.asarray(cv2.resize(picture, (160, 120), interpolation=cv2.INTER_AREA), dtype=np.float64)


def begins_early(strength: Floats, before: int, outliers: int) -> bool:
    """Return whether contact begins within the first frames, by their change; so many readings may be wrong."""
    # noise makes all later frames differ from the first one alike
    rest = np.sort(strength[1:before])
    if rest.size <= 2 * outliers:
        return False
    rises = rest[-1 - outliers] - rest[0]
    return bool(rises > REST_SHARE * (strength.max() - rest[0]))
