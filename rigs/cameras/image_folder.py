"""A folder of images in place of a camera: a stored session again, or raw images that something else took."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Final, NoReturn

import numpy as np
from numpy.typing import NDArray

from data_schemas import BadFrameError, CameraSettings, DeviceIdentity, RecordError, RefusedError
from data_schemas.storage import finite_number, read_csv
from rigs import RawFrame
from rigs.cameras._genicam import name_of
from rigs.cameras._image_files import SUFFIXES, read_exposure_s, read_raw
from rigs.capture import SESSION_NAME, read_camera_session, read_frame_of, read_session, session_kind

EXPOSURES_NAME: Final = "frames.csv"
EXPOSURE_TOLERANCE_REL: Final = 0.05
"""An image stands for an exposure within this; the capture engine allows no more."""


@dataclass(frozen=True, slots=True)
class StoredImage:
    """An image of the folder: its name, how it is read, and its exposure time."""

    name: str
    read: Callable[[], NDArray[np.uint16]]
    exposure_s: float


class ImageFolder:
    """Delivers every image of a folder once, in order of their names, when its exposure is asked for.

    Parameters
    ----------
    settings
        Camera of the rig file.
    images
        What the folder holds, in order.
    kind
        What the folder is, for the identity.
    """

    def __init__(self, settings: CameraSettings, images: tuple[StoredImage, ...], kind: str) -> None:
        self._settings, self._images, self._kind = settings, images, kind
        self._unused = list(range(len(images)))
        self._where = name_of(settings)

    def identity(self) -> DeviceIdentity:
        """Return what the folder is."""
        return DeviceIdentity(role="camera", driver="folder", address=self._settings.address, model=self._kind)

    def expose(self, exposure_s: float, deadline_s: float) -> RawFrame:
        """Return the first image that was not used yet and has this exposure (s), within 5 %.

        Raises
        ------
        RefusedError
            There is none.
        BadFrameError
            The image is unreadable or was changed; it counts as used.
        """
        number = next((n for n in self._unused if self._fits(n, exposure_s)), None)
        if number is None:
            self._refuse(exposure_s)
        self._unused.remove(number)
        image = self._images[number]
        try:
            counts = image.read()
        except RecordError as error:  # a frame of a session is missing or differs from its checksum
            raise BadFrameError(f"{self._where}: {error}") from error
        if counts.max(initial=0) >= 2**self._settings.bit_depth:
            raise BadFrameError(
                f"{self._where}: {image.name} contains a count of {counts.max()} DN, but {self._settings.bit_depth} "
                "bits allow less; correct bit_depth in the rig file"
            )
        return RawFrame(
            counts=counts,
            exposure_requested_s=exposure_s,
            exposure_s=image.exposure_s,
            captured_utc=datetime.now(UTC).isoformat(timespec="milliseconds"),
            frame_id=number,
            settings={"file": image.name},
        )

    def _fits(self, number: int, exposure_s: float) -> bool:
        return abs(self._images[number].exposure_s - exposure_s) <= EXPOSURE_TOLERANCE_REL * exposure_s

    def _refuse(self, exposure_s: float) -> NoReturn:
        """Say why there is no image."""
        if not self._unused:
            raise RefusedError(
                f"{self._where}: all {len(self._images)} images are used up; add images or plan fewer exposures"
            )
        left = sorted({self._images[number].exposure_s for number in self._unused})
        raise RefusedError(
            f"{self._where}: none of the {len(self._unused)} unused images has an exposure of {exposure_s:g} s, only "
            f"of {', '.join(f'{t:g}' for t in left)} s; capture with these exposures"
        )


@contextmanager
def open_camera(settings: CameraSettings, folder: Path) -> Iterator[ImageFolder]:
    """Open a folder of images for a ``with`` block: a stored session, or raw images.

    Exposures come from the session, from `frames.csv` (``file,exposure_s``) or from the images' own EXIF data.

    Raises
    ------
    RefusedError
        The folder is missing, holds no images or not all of their exposures, or its session cannot be read.
    """
    path, where = folder / settings.address, name_of(settings)
    if not path.is_dir():
        raise RefusedError(
            f"{where}: the folder {path} does not exist; give a folder of raw images or a stored session"
        )
    if (path / SESSION_NAME).is_file():
        yield ImageFolder(settings, _session_images(path, where), "stored session")
    else:
        yield ImageFolder(settings, _raw_images(path, where), "raw images")


def _session_images(path: Path, where: str) -> tuple[StoredImage, ...]:
    """Return the frames of a stored session in the order of their capture."""
    try:
        read = read_session if session_kind(path) == "paint" else read_camera_session
        frames = read(path).frames
    except RecordError as error:
        raise RefusedError(f"{where}: {error}") from error
    return tuple(StoredImage(f.file, partial(read_frame_of, path, f), f.exposure_s) for f in frames)


def _raw_images(path: Path, where: str) -> tuple[StoredImage, ...]:
    """Return the images of a folder in order of their names."""
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
    if not files:
        raise RefusedError(f"{where}: {path} contains no images; supported file name endings are {', '.join(SUFFIXES)}")
    listed = _listed_exposures(path / EXPOSURES_NAME, where)
    lost = sorted(set(listed) - {file.name for file in files})
    if lost:
        raise RefusedError(
            f"{where}: {EXPOSURES_NAME} names {lost[0]}, but {lost[0]} is missing from {path}; correct the list"
        )
    images = []
    for file in files:
        exposure_s = listed[file.name] if file.name in listed else read_exposure_s(file)
        if exposure_s is None:
            raise RefusedError(
                f"{where}: the exposure of {file.name} is unknown; add {EXPOSURES_NAME} with the columns 'file' and "
                "'exposure_s' to the folder"
            )
        images.append(StoredImage(file.name, partial(read_raw, file), exposure_s))
    return tuple(images)


def _listed_exposures(path: Path, where: str) -> dict[str, float]:
    """Read the exposures (s) of images by name; nothing where there is no list."""
    if not path.is_file():
        return {}
    header, rows = read_csv(path, f"{EXPOSURES_NAME} (columns file,exposure_s)", RefusedError)
    try:
        at_file, at_time = header.index("file"), header.index("exposure_s")
        listed: dict[str, float] = {}
        for line, cells in rows:
            if cells[at_file] in listed:
                raise ValueError(f"{cells[at_file]} is listed twice, the second time in line {line}")
            listed[cells[at_file]] = finite_number(cells[at_time])
    except (ValueError, IndexError) as error:
        raise RefusedError(
            f"{where}: {path} cannot be read ({error}); it needs the columns 'file' and 'exposure_s', with exposures "
            "as numbers in seconds"
        ) from None
    wrong = [name for name, exposure_s in listed.items() if not exposure_s > 0.0]
    if wrong:
        raise RefusedError(
            f"{where}: {path} gives {wrong[0]} an exposure of {listed[wrong[0]]:g} s, but exposures must be above 0 s"
        )
    return listed
