"""Files of sets of presses: pictures, arrays, tables, frames of videos with those that hold the contact."""

import os
import re
import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Final
from unicodedata import normalize

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError
from data_schemas.storage import (
    finite_number,
    has_file,
    parse_in_child,
    parse_json,
    read_bytes,
    read_csv,
    read_json,
    read_npy,
    read_text,
)
from finray_calib.exchange._ball_presses import read_npz
from finray_calib.exchange._paint_reradiation import exr_pixels
from rigs.cameras import decoded_picture

Floats = NDArray[np.float64]

VIDEOS: Final = (".avi", ".mp4", ".m4v", ".mov", ".mkv", ".webm")
_MOST_DECODED_BYTES = 512 << 20
LARGEST_VIDEO_BYTES = 512 << 20
MOST_FRAMES = 20_000
_HEADER_BYTES = 8
_DEEPEST_LIST = 6
CONVERT_VIDEO: Final = "convert the video with 'ffmpeg -i VIDEO -c:v mjpeg -q:v 1 VIDEO.avi', or convert it to pictures"


@dataclass(frozen=True, slots=True)
class Video:
    """Frames of a video.

    Attributes
    ----------
    frames
        Bytes of every frame, JPEG (Motion JPEG in AVI) or PNG (decoded), in order.
    times_s
        Their times by the file from the first frame on, s; None where it states none.
    """

    frames: list[bytes]
    times_s: Floats | None


def read_video(path: Path) -> Video:
    """Return the frames of a video.

    Raises
    ------
    ImportFormatError
        The file is missing, its frames cannot be decoded, or there are too many.
    """
    content = read_bytes(path, "a video", ImportFormatError, LARGEST_VIDEO_BYTES)
    if (frames := _motion_jpeg_frames(content, path)) is not None:
        frame_s = _seconds_per_frame(content)
        return Video(frames, None if frame_s is None else np.arange(len(frames), dtype=np.float64) * frame_s)
    _, found = parse_in_child(f"{__name__}:decoded_video", content, path, "a video", ImportFormatError)
    ends = found["ends"].tolist()
    frames = [found["frames"][start:end].tobytes() for start, end in zip([0, *ends[:-1]], ends, strict=True)]
    times_s = np.asarray(found["times_ms"] - found["times_ms"][0], dtype=np.float64) / 1e3
    return Video(frames, times_s if len(frames) == 1 or (np.diff(times_s) > 0.0).all() else None)


def decoded_video(content: bytes, where: str) -> tuple[None, dict[str, NDArray[Any]]]:
    """Decode a video into PNG frames; the child's side of :func:`read_video`."""
    frames, ends, times_ms = bytearray(), list[int](), list[float]()
    decoded = len(content)
    with TemporaryDirectory(prefix="finray-video-") as folder:
        file = Path(folder) / "video"
        file.write_bytes(content)
        os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = "threads;1"
        video = cv2.VideoCapture(str(file), cv2.CAP_FFMPEG)
        while (read := video.read())[0]:
            decoded += read[1].nbytes
            if decoded > _MOST_DECODED_BYTES or len(ends) == MOST_FRAMES:
                raise ImportFormatError(
                    f"{where}: the video is too long, because only {MOST_FRAMES} frames and "
                    f"{_MOST_DECODED_BYTES >> 20} MB of decoded frames are supported; cut the video, or {CONVERT_VIDEO}"
                )
            # one growing buffer: to join a list of frames would need the memory twice
            frames += cv2.imencode(".png", read[1], [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].data
            ends.append(len(frames))
            times_ms.append(video.get(cv2.CAP_PROP_POS_MSEC))
        video.release()
    if not frames:
        raise ImportFormatError(f"{where}: cannot be decoded as a video; {CONVERT_VIDEO}")
    found = {"ends": np.array(ends, dtype=np.int64), "times_ms": np.array(times_ms)}
    return None, {"frames": np.frombuffer(frames, dtype=np.uint8), **found}


def _seconds_per_frame(content: bytes) -> float | None:
    """Return the time from frame to frame that the stream header of an AVI file states; None where there is none."""
    at = content.find(b"vids", 0, 1 << 16)  # behind it handler, flags, priority and language, first frame, scale, rate
    if at < 8 or content[at - 8 : at - 4] != b"strh" or at + 28 > len(content):
        return None
    scale, rate = struct.unpack("<II", content[at + 20 : at + 28])
    return scale / rate if scale and rate else None


def _motion_jpeg_frames(content: bytes, path: Path) -> list[bytes] | None:
    """Return the JPEG bytes of every frame of an AVI file, in order; None where it is none, or its frames are not."""
    if content[:4] != b"RIFF" or content[8:12] != b"AVI ":
        return None
    frames: list[bytes] = []
    for part in _video_parts(content, 0, len(content), 0):
        # a frame without content is one that was dropped: the one before it is shown again
        frames += [part] if part else frames[-1:]
    if not frames or len(frames) > MOST_FRAMES:
        raise ImportFormatError(
            f"{path}: has {len(frames)} frames, but only 1 to {MOST_FRAMES} are allowed; cut the video"
        )
    return frames if all(frame.startswith(b"\xff\xd8") for frame in frames) else None


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
_PICTURE: Final = "a picture (PNG, JPEG, TIFF, WebP, BMP, npy) or OpenEXR image"
_UPRIGHT = 1
_ORIENTATION_TAG = 0x0112
TIFF_STARTS: Final = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_BMP_START: Final = b"BM"
#: More pixels of an OpenEXR image above full scale than these are no highlight, and fewer steps below it no picture.
_MOST_ABOVE_FULL, _LEAST_STEPS = 0.01, 256
ARRAY_FILES: Final = (".npz", ".npy", ".tif", ".tiff")
#: Of numbers alone, without names of columns: lines of equally many.
TEXTS_OF_NUMBERS: Final = (".txt", ".csv", ".tsv", ".dat")
_MOST_KEPT = 2
#: Between a file and the array in it: ``set.npz::images[{press}]``.
ARRAY_IN: Final = "::"
_ARRAY_PLACE = re.compile(r"(?P<file>.+?)::(?P<array>[^\[\]]*)(?:\[(?P<index>\d+)\])?")


class ArrayFiles:
    """Read arrays of npz, npy and TIFF files; those of the last files are kept, since many presses need them."""

    def __init__(self) -> None:
        self._kept: dict[Path, tuple[Mapping[str, NDArray[Any]], tuple[str, ...]]] = {}

    def of(self, path: Path) -> tuple[Mapping[str, NDArray[Any]], tuple[str, ...]]:
        """Return the arrays of a file by name, and the names of its pickled ones; an npy or TIFF file has one, ""."""
        if path not in self._kept:
            while len(self._kept) >= _MOST_KEPT:
                del self._kept[next(iter(self._kept))]
            kind = path.suffix.lower()
            if kind not in (*ARRAY_FILES, *TEXTS_OF_NUMBERS):
                raise ImportFormatError(
                    f"{path}: arrays of pictures are read only from {', '.join(ARRAY_FILES)} files; {_conversion(path)}"
                )
            if kind == ".npz":
                self._kept[path] = read_npz(path)
            else:
                self._kept[path] = ({"": (_stack if kind in ARRAY_FILES else _numbers_of_text)(path)}, ())
        return self._kept[path]

    def array(self, path: Path, name: str) -> NDArray[Any]:
        """Return one of them."""
        arrays, pickled = self.of(path)
        if name in pickled:
            raise ImportFormatError(
                f"{path}: '{name}' is stored as pickled objects, which are never loaded; have its owner save it again "
                "as a plain array (numpy.savez with equal shapes)"
            )
        if name not in arrays:
            raise ImportFormatError(
                f"{path}: array '{name}' is missing; the file contains {', '.join(sorted(arrays)) or 'nothing'}"
            )
        return arrays[name]

    def count(self, path: Path, name: str) -> int:
        """Return the number of pictures in an array."""
        array = self.array(path, name)
        if array.ndim not in (3, 4):
            raise ImportFormatError(
                f"{path}: '{name}' of shape {array.shape} is not an array of pictures; its shape must be (pictures, "
                "rows, columns, 3), or (pictures, rows, columns) for grey"
            )
        return len(array)

    def picture(self, path: Path) -> NDArray[Any]:
        """Return the picture at a path into an array, ``set.npz::images[3]``."""
        place = _ARRAY_PLACE.fullmatch(path.name)
        if place is None:
            raise ImportFormatError(
                f"{path}: must end in ::ARRAY or ::ARRAY[number], such as ::images[3]; correct the path"
            )
        array = self.array(path.with_name(place["file"]), place["array"])
        if place["index"] is None:
            return array
        if array.ndim < 3 or int(place["index"]) >= len(array):
            raise ImportFormatError(
                f"{path}: the array of shape {array.shape} has no picture of this number; correct the recipe"
            )
        return np.asarray(array[int(place["index"])])


def file_of(path: Path) -> Path:
    """Return the file of a path, which may lead into an array of it."""
    return path.with_name(path.name.partition(ARRAY_IN)[0])


def require_inside(pattern: str) -> None:
    """Refuse a path that leaves the folder."""
    inner = PurePosixPath(pattern)
    if inner.is_absolute() or ".." in inner.parts or "\\" in pattern or inner.name.startswith(ARRAY_IN):
        raise ImportFormatError(f"recipe: {pattern!r} must be a path within the folder, with / between its parts")


def file_inside(folder: Path, inner: str) -> Path:
    """Return a path within a folder, which may lead into an array; a link that leads out of the folder is refused."""
    # macOS stores letters such as an umlaut in two parts, other systems in one
    forms = [folder / normalize(form, inner) for form in ("NFC", "NFD")]
    found = next((form for form in forms if has_file(file_of(form))), folder / inner)
    # both are opened, by readers of arrays and by those of whole files
    if not all(path.resolve().is_relative_to(folder.resolve()) for path in (found, file_of(found))):
        raise ImportFormatError(f"{found}: points outside the folder; copy the file into the folder")
    return found


Corners = Sequence[tuple[float, float]]


def stretched(image: NDArray[Any], corners_px: Corners | None, size_px: tuple[int, int] | None) -> NDArray[Any]:
    """Return an image (H, W) or (H, W, 3) whose four corners, column and row, become those of another size."""
    if corners_px is None or size_px is None:
        return image
    width, height = size_px
    corners = [[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]]
    seen, wanted = (np.array(places, dtype=np.float32) for places in (corners_px, corners))
    turned = cv2.getPerspectiveTransform(seen, wanted)
    return cv2.warpPerspective(np.ascontiguousarray(image), turned, size_px, flags=cv2.INTER_AREA)


def largest_within(values: Floats, corners_px: Corners | None) -> float:
    """Return the largest value (H, W) between four corners as they are stored, not as a stretch interpolates it."""
    if corners_px is None:
        return float(values.max())
    corners = np.rint([corners_px[k] for k in (0, 1, 3, 2)]).astype(np.int32)
    return float(values[cv2.fillConvexPoly(np.zeros(values.shape, np.uint8), corners, 1) > 0].max(initial=-np.inf))


def _numbers_of_text(path: Path) -> Floats:
    """Return the numbers of a text, (lines, numbers), parted by blanks, tabs, commas or semicolons; # begins a comment.

    Raises
    ------
    ImportFormatError
        Something else is in it, or its lines differ in length.
    """
    lines = (line.partition("#")[0] for line in read_text(path, "a text of numbers", ImportFormatError).splitlines())
    rows = [re.split(r"[\s,;]+", line.strip(" \t,;")) for line in lines if line.strip()]
    if len({len(row) for row in rows}) != 1:
        raise ImportFormatError(f"{path}: must hold lines of equally many numbers to be read by their places")
    try:
        return np.array([[finite_number(cell) for cell in row] for row in rows], dtype=np.float64)
    except ValueError as error:
        raise ImportFormatError(
            f"{path}: must hold numbers alone, with decimal points, to be read by their places: {error}; name the "
            "columns of a table in place of places"
        ) from None


def _stack(path: Path) -> NDArray[Any]:
    """Return the array of an npy file, or all pictures of a TIFF."""
    if path.suffix.lower() == ".npy":
        return read_npy(path, _PICTURE, ImportFormatError)
    content = read_bytes(path, "a stack of pictures (TIFF)", ImportFormatError)
    _require_upright(content, path)
    return parse_in_child(f"{__name__}:decoded_pages", content, path, "TIFF", ImportFormatError)[1]["pages"]


def decoded_pages(content: bytes, where: str) -> tuple[None, dict[str, NDArray[Any]]]:
    """Decode all pictures of a file of a kind that few programs write, in RGB order; run in a child process."""
    try:
        is_read, pages = cv2.imdecodemulti(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        if len({page.shape for page in pages}) > 1:
            raise ImportFormatError(
                f"{where}: contains pictures of several sizes; save each picture as a separate file"
            )
        stack = pages[0][None] if len(pages) == 1 else np.stack(pages) if is_read and pages else None
    except (cv2.error, MemoryError):
        stack = None
    if stack is None:
        raise ImportFormatError(
            f"{where}: cannot be decoded, because it is corrupted or all its pictures together are too large (above "
            "some 300 MB); copy it again, or save each picture as a separate file"
        )
    return None, {"pages": stack if stack.ndim == 3 else np.ascontiguousarray(stack[..., _RGB[stack.shape[-1]]])}


_RGB: Final = {1: [0], 2: [0, 1], 3: [2, 1, 0], 4: [2, 1, 0, 3]}


def pixels_of(path: Path, arrays: ArrayFiles | None = None) -> NDArray[Any]:
    """Return a picture as stored, (H, W, 3) in RGB order, or (H, W, 1) where it is grey; arrays in their own order.

    Parameters
    ----------
    path
        A file, or a picture in an array of one.
    arrays
        Keeps files of arrays that are read more than once.

    Raises
    ------
    ImportFormatError
        It is missing, of another kind or depth, turned by a mark that viewers follow, or transparent in part.
    """
    if not has_file(file_of(path)):
        raise ImportFormatError(f"{file_of(path)}: no such file, but the folder must contain it")
    if file_of(path) != path:
        return _counts_array((arrays or ArrayFiles()).picture(path), path)
    if path.suffix.lower() == ".npy":
        return _counts_array(read_npy(path, _PICTURE, ImportFormatError), path)
    content = read_bytes(path, _PICTURE, ImportFormatError)
    is_common = content.startswith((b"\x89PNG", b"\xff\xd8"))
    if not is_common and not content.startswith((*TIFF_STARTS, _BMP_START)) and content[8:12] != b"WEBP":
        raise ImportFormatError(
            f"{path}: is neither PNG nor JPEG, and neither its name nor its content is that of another supported "
            f"format (TIFF, WebP, BMP, npy, OpenEXR); {_conversion(path)}"
        )
    _require_upright(content, path)
    if is_common:
        return _in_rgb(decoded_picture(content, path, ImportFormatError), path)
    pages = parse_in_child(f"{__name__}:decoded_pages", content, path, "a picture", ImportFormatError)[1]["pages"]
    if len(pages) > 1:
        raise ImportFormatError(
            f"{path}: contains {len(pages)} pictures; write {path.name}::[{{press}}] if each picture is a press, or "
            f"{path.name}::[0] for the first"
        )
    page = pages[0]
    return _in_rgb(page if page.ndim == 2 else page[..., _RGB[page.shape[2]]], path)


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
        return "its content does not match its file extension, so copy the file again from its source"
    if kind in (".mp4", ".mov", ".mkv", ".webm"):
        return CONVERT_VIDEO
    opened = _OPENED.get(kind)
    if opened is None:
        return (
            f"convert all pictures without loss, such as with 'mogrify -format png *{path.suffix or '.tif'}', and "
            "give the converted ones"
        )
    images = f"{opened.replace('FILE', repr(path.name))}['NAME']"
    return (
        "if it contains many pictures, save each as a uint8 or uint16 file, in Python by "
        f"[numpy.save(f'{{k}}.npy', image) for k, image in enumerate({images})]"
    )


def _counts_array(array: NDArray[Any], path: Path) -> NDArray[Any]:
    """Return an array of counts or fractions, (H, W, 3), or (H, W, 1) where it is grey."""
    if array.ndim == 3 and array.shape[0] in (1, 3) and array.shape[2] not in (1, 3):
        array = np.moveaxis(array, 0, 2)  # the order of PyTorch
    known = array.dtype in _BITS or array.dtype.kind == "f"
    if not known or array.ndim not in (2, 3) or array.shape[2:] not in ((), (1,), (3,)):
        raise ImportFormatError(
            f"{path}: contains {array.dtype} of shape {array.shape}, but only uint8, uint16 or fractions of shape "
            "(rows, columns, 3), or (rows, columns) for grey, are supported; save each picture as the counts of the "
            "camera"
        )
    return array[..., None] if array.ndim == 2 else array


def map_of(path: Path, arrays: ArrayFiles) -> Floats:
    """Return a map of one value per pixel, (H, W), such as depths: grey pictures, OpenEXR of one channel, arrays.

    Raises
    ------
    ImportFormatError
        It is missing, has several values per pixel, or holds some that are no numbers.
    """
    if not has_file(file_of(path)):
        raise ImportFormatError(f"{file_of(path)}: no such file, but the folder must contain it")
    if path.suffix.lower() == ".exr":
        values = np.stack([np.asarray(channel) for channel in exr_pixels(path).values()], axis=-1)
    elif file_of(path) != path:
        values = arrays.picture(path)
    elif path.suffix.lower() in (".npy", ".tif", ".tiff"):
        values = _stack(path)
        values = values[0] if path.suffix.lower() != ".npy" and len(values) == 1 else values
    else:
        values = pixels_of(path)
    if not np.isfinite(values).all():  # before channels are compared: NaN differs from itself
        raise ImportFormatError(
            f"{path}: {100 * (~np.isfinite(values)).mean():.3g} % of its values are NaN or infinite; fill them, or "
            "name the press in presses.leave_out"
        )
    if values.ndim == 3 and (values == values[..., :1]).all():
        values = values[..., 0]
    if values.ndim != 2:
        raise ImportFormatError(
            f"{path}: a map must have one value per pixel, got shape {values.shape}; give the map itself, because the "
            "colours of a picture of a map cannot be read as values"
        )
    return values.astype(np.float64)


def frame_of(content: bytes, path: Path) -> NDArray[Any]:
    """Return a frame of a video, (H, W, 3) in RGB order."""
    return in_colour(_in_rgb(decoded_picture(content, path, ImportFormatError), path))


def in_colour(picture: NDArray[Any]) -> NDArray[Any]:
    """Return a picture of one or three channels with three."""
    return picture if picture.shape[2] == 3 else np.repeat(picture, 3, axis=2)


def _in_rgb(picture: NDArray[Any], path: Path) -> NDArray[Any]:
    """Return what OpenCV decoded with its channels in the order of RGB, without an opaque alpha channel."""
    if picture.dtype not in _BITS:
        raise ImportFormatError(
            f"{path}: contains {picture.dtype}, but only pictures of 8 or 16 bits are supported; convert the picture"
        )
    if picture.ndim == 2:
        return picture[..., None]
    if picture.shape[2] == 4 and (clear := picture[..., 3] < np.iinfo(picture.dtype).max).any():
        raise ImportFormatError(
            f"{path}: {100 * clear.mean():.2g} % of its pixels are transparent, so their colours are not those of the "
            "camera; save the picture without transparency, as the camera took it, or render it opaque"
        )
    return picture[..., 2::-1]


def _require_upright(content: bytes, path: Path) -> None:
    """Refuse a picture that viewers turn: some libraries do too."""
    if (turned := orientation(content)) != _UPRIGHT:
        raise ImportFormatError(
            f"{path}: is marked to be shown turned or mirrored (EXIF orientation {turned}). Some programs follow this "
            "mark and others do not, so the orientation of the labels is unknown. Turn the pixels themselves, as "
            "'mogrify -auto-orient' does, and label the result"
        )


def orientation(content: bytes) -> int:
    """Return how a picture is marked to be turned (EXIF): 1 for upright, or where it says nothing that is known."""
    if content.startswith(TIFF_STARTS[:2]):
        exif = content
    else:
        is_jpeg, is_webp = content.startswith(b"\xff\xd8"), content.startswith(b"RIFF")
        mark = b"Exif\0\0" if is_jpeg else b"EXIF" if is_webp else b"eXIf"
        behind = len(mark) + 4 * is_webp  # where the size of a chunk follows its name
        at = content.find(mark, 0, 1 << 16) if is_jpeg else content.find(mark)
        if at < 0:
            return _UPRIGHT
        exif = content[at + behind : at + behind + (1 << 16)].removeprefix(b"Exif\0\0")
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


def steps_of(image: NDArray[Any], path: Path, full_scale_rel: float) -> NDArray[np.uint16]:
    """Return values of light (H, W, channels) in steps of which 65535 are full scale.

    Raises
    ------
    ImportFormatError
        Some are no numbers or below 0, much of it lies above full scale, or so little of the scale is used that steps
        would be seen.
    """
    if not np.isfinite(image).all() or image.min(initial=0.0) < 0.0:
        raise ImportFormatError(f"{path}: contains NaN, infinite or negative values; render or save it again")
    largest, above = float(image.max()), float((image > full_scale_rel).mean())
    if above > _MOST_ABOVE_FULL or largest * 65535.0 < _LEAST_STEPS * full_scale_rel:
        what = (
            f"{100 * above:.3g} % of its values lie above picture.full_scale = {full_scale_rel:g} and would be clipped"
            if above > _MOST_ABOVE_FULL
            else f"its values fill only {largest / full_scale_rel * 65535.0:.3g} of the 65535 steps below "
            f"picture.full_scale = {full_scale_rel:g}"
        )
        raise ImportFormatError(
            f"{path}: {what}. Give a full scale a little above the largest value of all pictures (here {largest:.4g})"
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
                f"{first_path} has {kinds[0]}, but {path} has {kinds[1]}, so their values cannot be compared; save all "
                "pictures, with and without contact, in the same format. If one is no picture of the camera, such as a "
                "map of depths, let presses.files, presses.only or presses.leave_out pass it over"
            )


def exr_rgb(path: Path) -> Floats:
    """Return the channels R, G, B of an OpenEXR image, (H, W, 3), none below zero.

    Those without a layer are its picture, else those of the only layer that has all three.

    Raises
    ------
    ImportFormatError
        It cannot be read, lacks a channel, has several layers of colours, or holds what is no finite number.
    """
    found: dict[str, NDArray[Any]] = exr_pixels(path)
    layers: dict[str, dict[str, str]] = {}
    for name in found:
        layer, _, colour = name.rpartition(".")
        layers.setdefault(layer, {})[colour.upper()] = name
    pictures = {layer: names for layer, names in layers.items() if {"R", "G", "B"} <= names.keys()}
    if not pictures:
        raise ImportFormatError(f"{path}: must have the channels R, G and B, got {', '.join(sorted(found)) or 'none'}")
    if "" not in pictures and len(pictures) > 1:
        raise ImportFormatError(
            f"{path}: has several layers of R, G and B ({', '.join(sorted(pictures))}), so it is unknown which is the "
            "picture; save the layer of the picture alone"
        )
    names = pictures.get("") or next(iter(pictures.values()))
    image = np.stack([np.asarray(found[names[c]], dtype=np.float64) for c in "RGB"], axis=-1)
    if image.ndim != 3 or not np.isfinite(image).all():
        raise ImportFormatError(f"{path}: contains NaN or infinite values; render it again")
    return np.maximum(image, 0.0)


TABLES: Final = (".jsonl", ".ndjson")


def table_rows(path: Path, names: Collection[str] = ()) -> tuple[list[str], list[dict[str, str]]]:
    """Return columns and lines of a table: CSV, a list of JSON objects, or JSON lines; some columns may hold names."""
    kind = path.suffix.lower()
    if kind not in (".json", *TABLES):
        columns, lines = read_csv(path, "a CSV file", ImportFormatError, skip_space=True, other_marks=True, names=names)
        return columns, [dict(zip(columns, cells, strict=False)) for _, cells in lines]
    if kind == ".json":
        whole = read_json(path, "labels (JSON)", ImportFormatError, any_number=True)
        if isinstance(whole, dict):  # such as { "version": 1, "presses": [ ... ] }
            lists = [of for of in whole.values() if isinstance(of, list) and of and isinstance(of[0], dict)]
            whole = lists[0] if len(lists) == 1 else whole
    else:
        text = read_text(path, "labels (JSON lines)", ImportFormatError)
        said = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
        whole = [
            parse_json(line.encode(), f"{path}, line {number}", ImportFormatError, any_number=True)
            for number, line in said
        ]
    if not isinstance(whole, list) or not all(isinstance(of, dict) for of in whole):
        raise ImportFormatError(f"{path}: must be a list of objects, [{{ ... }}, ...], with one for each press")
    rows = [{key: _cell(value) for key, value in flat_entries(of)} for of in whole]
    return list(dict.fromkeys(key for row in rows for key in row)), rows


def _cell(value: object) -> str:
    """Return a value of a JSON file as the cell of a table."""
    return value if isinstance(value, str) else "" if value is None or isinstance(value, bool) else repr(value)


def flat_entries(whole: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield key and value of an object and of all in it: outer.inner, and list[0] of lists."""
    inside = list(whole.items())
    for key, value in inside:  # grows while it is read
        if isinstance(value, dict):
            inside += [(f"{key}.{inner}", of) for inner, of in value.items()]
        elif isinstance(value, list):
            inside += [(f"{key}[{k}]", of) for k, of in enumerate(value)]
        else:
            yield key, value
