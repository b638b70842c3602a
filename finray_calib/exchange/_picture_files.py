"""Pictures of other labs: PNG, JPEG, OpenEXR, arrays; frames of videos, and which of them hold the contact."""

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError
from data_schemas.storage import has_file, read_bytes, read_npy
from finray_calib.exchange._paint_reradiation import exr_pixels
from rigs.cameras import decoded_picture

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


_BITS: Final = {np.dtype(np.uint8): 8, np.dtype(np.uint16): 16}
_PICTURE: Final = "a picture (PNG, JPEG, npy) or OpenEXR image"
_UPRIGHT = 1
_ORIENTATION_TAG = 0x0112
#: More pixels of an OpenEXR image above full scale than these are no highlight, and fewer steps below it no picture.
_MOST_ABOVE_FULL, _LEAST_STEPS = 0.01, 256


def pixels_of(path: Path) -> NDArray[Any]:
    """Return a picture as stored, (H, W, 3) in RGB order, or (H, W, 1) where it is grey; npy in its own order.

    Raises
    ------
    ImportFormatError
        It is missing, of another kind or depth, turned by a mark that viewers follow, or transparent in part.
    """
    if not has_file(path):
        raise ImportFormatError(f"{path}: no such file; the folder must hold it")
    if path.suffix.lower() == ".npy":
        return _counts_array(path)
    content = read_bytes(path, _PICTURE, ImportFormatError)
    if not content.startswith((b"\x89PNG", b"\xff\xd8")):
        raise ImportFormatError(
            f"{path}: is neither PNG nor JPEG, and neither its name nor its content is that of another kind that is "
            f"read (npy, OpenEXR); {_conversion(path)}"
        )
    if (turned := orientation(content)) != _UPRIGHT:
        raise ImportFormatError(
            f"{path}: states that it is to be shown turned or mirrored (EXIF orientation {turned}). Some programs "
            "follow this and others do not, so that the orientation of its labels is not known. Turn the pixels "
            "themselves, as 'mogrify -auto-orient' does, and label the result"
        )
    return _in_rgb(decoded_picture(content, path, ImportFormatError), path)


_OPENED: Final = {
    ".npz": "numpy.load(FILE)",
    ".h5": "h5py.File(FILE)",
    ".hdf5": "h5py.File(FILE)",
    ".mat": "scipy.io.loadmat(FILE)",
}


def _conversion(path: Path) -> str:
    """Say how pictures of another kind, or a stack of them, become files that are read, one for each press."""
    kind = path.suffix.lower()
    if kind in (".png", ".jpg", ".jpeg"):  # a conversion by name would write over the originals
        return "its content does not match the ending of its name: copy it again from its source"
    if kind in (".mp4", ".mov", ".mkv", ".webm"):
        return CONVERT_VIDEO
    opened = _OPENED.get(kind)
    if opened is None:
        return (
            "convert all pictures without loss, such as with "
            f"'mogrify -format png *{path.suffix or '.tif'}', and name these"
        )
    images = f"{opened.replace('FILE', repr(path.name))}['NAME']"
    return (
        "it may hold many pictures: save each as a file of its own, as uint8 or uint16, in Python by "
        f"[numpy.save(f'{{k}}.npy', image) for k, image in enumerate({images})]"
    )


def _counts_array(path: Path) -> NDArray[Any]:
    """Return an array of counts, (H, W, 3), or (H, W, 1) where it is grey."""
    array = read_npy(path, _PICTURE, ImportFormatError)
    if array.dtype not in _BITS or array.ndim not in (2, 3) or array.shape[2:] not in ((), (1,), (3,)):
        raise ImportFormatError(
            f"{path}: holds {array.dtype} of shape {array.shape}; uint8 or uint16 of shape (rows, columns, 3), or "
            "(rows, columns) for grey, are read: save each picture as the counts of the camera"
        )
    return array[..., None] if array.ndim == 2 else array


def frame_of(content: bytes, path: Path) -> NDArray[Any]:
    """Return a frame of a video, (H, W, 3) in RGB order."""
    return in_colour(_in_rgb(decoded_picture(content, path, ImportFormatError), path))


def in_colour(picture: NDArray[Any]) -> NDArray[Any]:
    """Return a picture of one or three channels with three."""
    return picture if picture.shape[2] == 3 else np.repeat(picture, 3, axis=2)


def _in_rgb(picture: NDArray[Any], path: Path) -> NDArray[Any]:
    """Return what OpenCV decoded with its channels in the order of RGB, without an opaque alpha channel."""
    if picture.dtype not in _BITS:
        raise ImportFormatError(f"{path}: holds {picture.dtype}; pictures of 8 or 16 bits are read: convert it")
    if picture.ndim == 2:
        return picture[..., None]
    if picture.shape[2] == 4 and (clear := picture[..., 3] < np.iinfo(picture.dtype).max).any():
        raise ImportFormatError(
            f"{path}: {100 * clear.mean():.2g} % of its pixels are transparent, and their colours are not those of the "
            "camera; save it without transparency, as the camera took it, or render it opaque"
        )
    return picture[..., 2::-1]


def orientation(content: bytes) -> int:
    """Return how a JPEG or PNG is marked to be turned (EXIF): 1 for upright, or where it says nothing that is known."""
    at = content.find(b"Exif\0\0", 0, 1 << 16) + 6 if content.startswith(b"\xff\xd8") else content.find(b"eXIf") + 4
    if at < 6:
        return _UPRIGHT
    exif = content[at : at + (1 << 16)]
    order = {b"II": "little", b"MM": "big"}.get(exif[:2])
    if order not in ("little", "big"):
        return _UPRIGHT

    def number(place: int, size: int) -> int:
        return int.from_bytes(exif[place : place + size], "big" if order == "big" else "little")

    first = number(4, 4)
    for entry in range(first + 2, first + 2 + 12 * min(number(first, 2), 256), 12):
        if number(entry, 2) == _ORIENTATION_TAG and 1 <= number(entry + 8, 2) <= 8:
            return number(entry + 8, 2)
    return _UPRIGHT


def exr_steps(path: Path, full_scale_rel: float) -> NDArray[np.uint16]:
    """Return an OpenEXR image (H, W, 3) in steps of which 65535 are full scale.

    Raises
    ------
    ImportFormatError
        Much of it lies above full scale, or so little of the scale is used that steps would be seen.
    """
    image = exr_rgb(path)
    largest, above = float(image.max()), float((image > full_scale_rel).mean())
    if above > _MOST_ABOVE_FULL or largest * 65535.0 < _LEAST_STEPS * full_scale_rel:
        what = (
            f"{100 * above:.3g} % of its values lie above picture.full_scale = {full_scale_rel:g} and would be clipped"
            if above > _MOST_ABOVE_FULL
            else f"its values fill only {largest / full_scale_rel * 65535.0:.3g} of the 65535 steps below "
            f"picture.full_scale = {full_scale_rel:g}"
        )
        raise ImportFormatError(
            f"{path}: {what}; its largest value is {largest:.4g}: give a full scale a little above the largest value "
            "of all pictures"
        )
    return np.clip(np.rint(image / full_scale_rel * 65535.0), 0.0, 65535.0).astype(np.uint16)


def require_alike(pictures: Mapping[Path, NDArray[Any]]) -> None:
    """Refuse pictures of one press of different depths or numbers of channels: their values mean different light.

    Raises
    ------
    ImportFormatError
        Two of them differ.
    """
    (first_path, first), *others = pictures.items()
    for path, picture in others:
        kinds = [
            f"{_BITS[p.dtype]} bits, {'grey' if p.shape[2] == 1 else 'colour'}"
            + (" and light (OpenEXR)" if file.suffix.lower() == ".exr" else "")
            for file, p in ((first_path, first), (path, picture))
        ]
        if kinds[0] != kinds[1]:
            raise ImportFormatError(
                f"{first_path} has {kinds[0]}, {path} has {kinds[1]}: values of the two cannot be compared; save the "
                "pictures of all presses and those without contact in one format"
            )


def exr_rgb(path: Path) -> Floats:
    """Return the channels R, G, B of an OpenEXR image, (H, W, 3), none below zero."""
    found: dict[str, NDArray[Any]] = exr_pixels(path)
    names = {name.rsplit(".", 1)[-1].upper(): name for name in found}
    if not {"R", "G", "B"} <= names.keys():
        raise ImportFormatError(f"{path}: needs the channels R, G and B, got {', '.join(sorted(found)) or 'none'}")
    image = np.stack([np.asarray(found[names[c]], dtype=np.float64) for c in "RGB"], axis=-1)
    if image.ndim != 3 or not np.isfinite(image).all():
        raise ImportFormatError(f"{path}: holds values that are not finite; render it again")
    return np.maximum(image, 0.0)
