"""The frames of a session as other programs ask for them: one list, whatever was captured, and its runs of equal kind.

A paint, a camera and a tactile session are stored differently; the exporters of frames see one shape: what is in
front of the camera, which filter, which light, how long, and when after the first frame. Nothing is invented: what a
session does not know is None here and left out there.
"""

import io
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BandPassFilter,
    CameraSession,
    CameraSettings,
    CaptureSession,
    DeviceIdentity,
    Frame,
    LampSettings,
    LaserSettings,
    RecordError,
    RegionOfInterest,
    SpectralCurve,
    TactileFrame,
    TactileSession,
)
from data_schemas.storage import digest_as_read, has_file, read_frame, read_json, read_record, stored_kind
from rigs.capture import SESSION_KINDS, SESSION_NAME, read_session

Buffer = bytes | bytearray | memoryview
Progress = Callable[[int, int, str], None]
Value = str | int | float | bool | None
DARK: Final = "dark"
WHITE: Final = ("white", "laser white")
NOT_XML: Final = re.compile(r"[^\t\n\r -\uD7FF\uE000-\uFFFD\U00010000-\U0010FFFF]")
"""Characters that XML 1.0 does not know, not even by number."""
LARGEST_PLAIN_BYTES: Final = 4_000_000_000
"""Of a TIFF with offsets of 32 bits, less room for its directories."""


@dataclass(frozen=True, slots=True)
class SessionFrame:
    """One frame.

    Attributes
    ----------
    file, sha256
        The stored frame and its checksum.
    sequence
        Its number in the session.
    frame_type, target, light
        As the session names them; target and light are None where a finger brings its own light.
    band
        The filter in the beam; None without one.
    exposure_s
        As the camera read it back (s); None where it does not say.
    start_s
        Start of the exposure after that of the first frame (s), by a clock that never steps; by the host's clock in
        records of the first versions, which hold no other.
    captured_utc
        Start of the exposure by the host's clock, ISO 8601.
    facts
        What else the session knows of it, by name.
    """

    file: str
    sha256: str
    sequence: int
    frame_type: str
    target: str | None
    light: str | None
    band: BandPassFilter | None
    exposure_s: float | None
    start_s: float
    captured_utc: str
    facts: Mapping[str, Value]

    @property
    def filter_name(self) -> str:
        """Name of the filter; "no filter" without one."""
        return "no filter" if self.band is None else self.band.name

    @property
    def start_unix_s(self) -> float:
        """Start of the exposure by the host's clock, seconds since 1970."""
        return datetime.fromisoformat(self.captured_utc).timestamp()

    def known(self) -> dict[str, Value]:
        """Return everything that is known of the frame, by name."""
        return {
            "sequence": self.sequence,
            "file": self.file,
            "sha256": self.sha256,
            "frame_type": self.frame_type,
            "target": self.target,
            "light": self.light,
            "filter": self.filter_name,
            "captured_utc": self.captured_utc,
            **self.facts,
        }


@dataclass(frozen=True, slots=True)
class Series:
    """Frames of one kind that fill a rectangle: as many of each filter.

    Attributes
    ----------
    name
        What they show, such as "fluorescence of sample, laser".
    channels
        Frames of each filter, in the order in which they were taken.
    """

    name: str
    channels: tuple[tuple[SessionFrame, ...], ...]


@dataclass(frozen=True, slots=True)
class SessionFrames:
    """The frames of a session, in the order of their numbers, and what they have in common.

    Attributes
    ----------
    folder, sha256
        The session's folder, and the checksum of its record.
    kind, sample, rig
        What was captured: the kind of session, the name of the paint, camera or finger, and that of the rig.
    camera
        As the rig file describes it.
    region
        Painted (and white) area of the frame, if the session has one.
    mm_per_px
        Side of a pixel on the pad (mm), where the session knows it.
    laser, lamp
        Of the rig; None where a finger brings its own light.
    filters, curves
        Filters of the rig, and the measured transmission of those that have one, by name.
    devices, notes, frames
        As the session holds them.
    """

    folder: Path
    sha256: str
    kind: Literal["paint", "camera", "tactile"]
    sample: str
    rig: str
    camera: CameraSettings
    region: RegionOfInterest | None
    mm_per_px: float | None
    laser: LaserSettings | None
    lamp: LampSettings | None
    filters: tuple[BandPassFilter, ...]
    curves: Mapping[str, SpectralCurve]
    devices: tuple[DeviceIdentity, ...]
    notes: tuple[str, ...]
    frames: tuple[SessionFrame, ...]

    @property
    def first(self) -> SessionFrame:
        """The frame whose exposure began first, from which :attr:`SessionFrame.start_s` counts."""
        return min(self.frames, key=lambda frame: frame.start_s)

    def counts(self, frame: SessionFrame) -> NDArray[np.uint16]:
        """Return the counts of a frame (DN), (H, W) or RGB (H, W, 3), after checking its checksum.

        Raises
        ------
        RecordError
            The frame's path leads out of the session's folder (a link).
        ChecksumError
            The frame is missing or was changed.
        """
        path = self.folder / frame.file
        if not path.resolve().is_relative_to(self.folder.resolve()):
            raise RecordError(
                f"{path}: points outside the folder of the session; frames must be plain files in this folder"
            )
        return read_frame(path, frame.sha256)

    def device(self, role: str) -> DeviceIdentity | None:
        """Return what a device of the rig said it is."""
        return next((device for device in self.devices if device.role == role), None)

    def bytes_of_frames(self, shape: tuple[int, ...]) -> int:
        """Return the bytes of all frames of this shape."""
        return len(self.frames) * 2 * int(np.prod(shape))

    def series(self) -> tuple[Series, ...]:
        """Return the frames in runs of one kind, target, light and tilt, each with as many frames of every filter."""
        runs: dict[tuple[Any, ...], dict[str, list[SessionFrame]]] = {}
        for frame in self.frames:
            kind = (frame.frame_type, frame.target, frame.light, frame.facts.get("tilt_deg"))
            runs.setdefault(kind, {}).setdefault(frame.filter_name, []).append(frame)
        found = []
        for (frame_type, target, light, tilt_deg), channels in runs.items():
            words = [frame_type, f"of {target}" if target else "", f"at {tilt_deg:g} deg" if tilt_deg else ""]
            name = " ".join(word for word in words if word) + (f", light {light}" if light else "")
            by_count: dict[int, list[tuple[SessionFrame, ...]]] = {}
            for frames in channels.values():
                by_count.setdefault(len(frames), []).append(tuple(frames))
            found += [Series(name, tuple(alike)) for alike in by_count.values()]
        return tuple(found)


class FrameSink:
    """An open file that a library fills through Python: all of it on the disk at the end of the block, or an error.

    HDF5 crashes where a disk refuses to write. So what is written after the first refusal is dropped silently, and
    :meth:`require_room` and the end of the block raise it.

    Parameters
    ----------
    handle
        Descriptor for reading and writing, which stays open.
    """

    def __init__(self, handle: int) -> None:
        self._file = os.fdopen(handle, "w+b", buffering=0, closefd=False)
        self._refused: OSError | None = None
        self.read, self.readinto = self._file.read, self._file.readinto
        self.seek, self.tell, self.flush = self._file.seek, self._file.tell, self._file.flush

    def __enter__(self) -> "FrameSink":
        return self

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        if self._refused is None:
            self._tried(lambda: os.fsync(self._file.fileno()))
        self._file.close()
        self.require_room()

    def fileno(self) -> int:
        """Refuse to give the descriptor: what is written around this object is not seen here."""
        raise io.UnsupportedOperation("fileno")

    def write(self, content: Buffer) -> int:
        """Write all of it, or drop it where the disk has refused something."""
        rest = memoryview(content).cast("B")
        size = rest.nbytes

        def write_on() -> None:
            nonlocal rest
            while rest and self._refused is None:
                rest = rest[self._file.write(rest) or 0 :]

        self._tried(write_on)
        return size

    def truncate(self, size: int) -> int:
        """Set the length of the file, or drop it where the disk has refused something."""
        self._tried(lambda: self._file.truncate(size))
        return size

    def require_room(self) -> None:
        """Raise what the disk refused."""
        if self._refused is not None:
            raise self._refused

    def _tried(self, call: Callable[[], object]) -> None:
        try:
            call()
        except OSError as error:
            self._refused = self._refused or error


def read_session_frames(folder: Path) -> SessionFrames:
    """Read the session of a folder, of any kind.

    Raises
    ------
    RecordError
        The folder is missing, holds no session or no frames, the capture was not finished, frames are missing, or one
        names a filter that is not in the rig.
    """
    path = folder / SESSION_NAME
    stored = read_json(path, "a capture session (.json)") if path.is_file() else None
    kind = stored_kind(stored)
    session = read_record(path, SESSION_KINDS[kind]) if kind in SESSION_KINDS else read_session(folder)
    seen = _tactile(folder, session) if isinstance(session, TactileSession) else _bench(folder, session)
    if not seen.frames:
        raise RecordError(f"{folder}: the session has no frames, so there is nothing to export")
    lost = [frame.file for frame in seen.frames if not has_file(folder / frame.file)]
    if lost:
        raise RecordError(
            f"{folder / lost[0]}: {len(lost)} of {len(seen.frames)} frames of the session are missing; restore them "
            f"from a copy, then run 'finray verify {folder}'"
        )
    return seen


def _bench(folder: Path, session: Any) -> SessionFrames:
    """Return the frames of a paint or camera session."""
    if not isinstance(session, CaptureSession | CameraSession):
        raise RecordError(f"{folder}: contains no session of frames; give the folder that 'finray capture' wrote")
    is_paint = isinstance(session, CaptureSession)
    rig, plan = session.rig, session.plan
    return SessionFrames(
        folder,
        str(digest_as_read(folder / SESSION_NAME)),
        kind="paint" if is_paint else "camera",
        sample=session.plan.paint_name if isinstance(session, CaptureSession) else session.plan.camera_name,
        rig=rig.name,
        camera=rig.camera,
        region=plan.region,
        mm_per_px=None,
        laser=rig.laser,
        lamp=rig.lamp,
        filters=rig.filter_wheel.filters,
        curves=session.filter_curves if isinstance(session, CaptureSession) else {},
        devices=session.devices,
        notes=session.notes,
        frames=_bench_frames(session.frames, rig.filter_wheel.filters, folder / SESSION_NAME),
    )


def _bench_frames(
    frames: tuple[Frame, ...], filters: tuple[BandPassFilter, ...], path: Path
) -> tuple[SessionFrame, ...]:
    bands: dict[str | None, BandPassFilter | None] = {None: None, **{band.name: band for band in filters}}
    for place, frame in enumerate(frames):
        if frame.filter_name not in bands:
            raise RecordError(
                f"{path}: frames[{place}]: filter '{frame.filter_name}' is not in the rig of the session (valid names "
                f"are {', '.join(band.name for band in filters)}), so the record was edited; restore it from a copy"
            )
    # records of the first versions hold no time of the monotonic clock
    is_timed = any(frame.middle_s > 0.0 for frame in frames)
    starts_s = [
        frame.middle_s - 0.5 * frame.exposure_s if is_timed else _unix_s(frame.captured_utc) for frame in frames
    ]
    first_s = min(starts_s, default=0.0)
    return tuple(
        SessionFrame(
            frame.file,
            frame.sha256,
            frame.sequence,
            frame.frame_type,
            frame.target,
            frame.light,
            bands[frame.filter_name],
            frame.exposure_s,
            start_s - first_s,
            frame.captured_utc,
            {
                "exposure_requested_s": frame.exposure_requested_s,
                "slot_before": frame.slot_before,
                "slot_after": frame.slot_after,
                "lights_before": ", ".join(frame.lights_before) or "none",
                "lights_after": ", ".join(frame.lights_after) or "none",
                "laser_dose_j": frame.laser_dose_j,
                "tilt_deg": frame.tilt_deg,
                **_of_camera(frame),
            },
        )
        for frame, start_s in zip(frames, starts_s, strict=True)
    )


def _tactile(folder: Path, session: TactileSession) -> SessionFrames:
    """Return the frames of a tactile session."""
    plan = session.plan
    return SessionFrames(
        folder,
        str(digest_as_read(folder / SESSION_NAME)),
        kind="tactile",
        sample=plan.design,
        rig=session.rig.name,
        camera=session.rig.camera,
        region=None,
        mm_per_px=plan.mm_per_px,
        laser=None,
        lamp=None,
        filters=(),
        curves={},
        devices=session.devices,
        notes=session.notes,
        frames=_tactile_frames(session.frames),
    )


def _tactile_frames(frames: tuple[TactileFrame, ...]) -> tuple[SessionFrame, ...]:
    starts_s = [frame.captured_s - (frame.exposure_s or 0.0) for frame in frames]
    first_s = min(starts_s, default=0.0)
    return tuple(
        SessionFrame(
            frame.file,
            frame.sha256,
            frame.sequence,
            frame.frame_type,
            None,
            None,
            None,
            frame.exposure_s,
            start_s - first_s,
            frame.captured_utc,
            {
                "exposure_requested_s": frame.exposure_requested_s,
                "place": frame.place,
                **_of_camera(frame),
            },
        )
        for frame, start_s in zip(frames, starts_s, strict=True)
    )


def _of_camera(frame: Frame | TactileFrame) -> dict[str, Value]:
    """Return what the camera said of a frame, and how often it was taken."""
    return {
        "saturated_fraction": frame.saturated_fraction,
        "attempts": frame.attempts,
        "camera_frame_id": frame.frame_id,
        "camera_time_s": frame.device_time_s,
        **{f"setting_{name}": value for name, value in frame.settings.items()},
    }


def _unix_s(utc: str) -> float:
    return datetime.fromisoformat(utc).timestamp()


def exchangeable(text: str) -> str:
    """Return a text with U+FFFD for every character that XML 1.0 does not know."""
    return NOT_XML.sub("\ufffd", text)
