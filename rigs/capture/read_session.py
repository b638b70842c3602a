"""Read a stored session, paint or camera, and its frames."""

from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.camera import CameraSession
from data_schemas.capture import CaptureSession, Frame
from data_schemas.errors import RecordError
from data_schemas.foreign_files import read_json
from data_schemas.frame_files import read_frame
from data_schemas.storage import read_record
from rigs.capture.journal import JOURNAL_NAME
from rigs.capture.session_folder import SESSION_NAME

SessionKind = Literal["paint", "camera"]
KINDS: dict[str, SessionKind] = {CaptureSession.__name__: "paint", CameraSession.__name__: "camera"}


def session_kind(folder: Path) -> SessionKind:
    """Tell what was captured into `folder`: a paint or a camera.

    Raises
    ------
    RecordError
        The folder is missing, holds no session or one of another kind, or the capture was not finished.
    """
    path = _session_file(folder)
    stored = read_json(path, "a capture session (.json)")
    kind = stored.get("kind") if isinstance(stored, dict) else None
    if kind not in KINDS:
        raise RecordError(f"{path}: is a {kind or 'file of unknown kind'}, a {' or '.join(KINDS)} is needed here")
    return KINDS[kind]


def read_session(folder: Path) -> CaptureSession:
    """Read the paint session that was captured into `folder`.

    Raises
    ------
    RecordError
        The folder is missing, holds no paint session, or the capture was not finished.
    """
    return read_record(_session_file(folder), CaptureSession)


def read_camera_session(folder: Path) -> CameraSession:
    """Read the camera session that was captured into `folder`.

    Raises
    ------
    RecordError
        The folder is missing, holds no camera session, or the capture was not finished.
    """
    return read_record(_session_file(folder), CameraSession)


def _session_file(folder: Path) -> Path:
    """Return the session's record, or say why there is none."""
    if (folder / SESSION_NAME).is_file():
        return folder / SESSION_NAME
    if not folder.is_dir():
        raise RecordError(f"{folder}: no such folder; give the folder that 'finray capture' wrote")
    if (folder / JOURNAL_NAME).is_file():
        raise RecordError(
            f"{folder}: the capture was not finished ({SESSION_NAME} is missing); the last line of {JOURNAL_NAME} says "
            f"why; go on with: finray capture --resume {folder}"
        )
    raise RecordError(f"{folder}: holds no capture session ({SESSION_NAME}); give the folder 'finray capture' wrote")


def read_frame_of(folder: Path, frame: Frame) -> NDArray[np.uint16]:
    """Return the counts of one frame (DN), shape (H, W), after checking its checksum.

    Raises
    ------
    RecordError
        The frame's path leads out of the session's folder (a link).
    ChecksumError
        The frame is missing or was changed.
    """
    path = folder / frame.file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise RecordError(f"{path}: leads out of the session's folder; frames must be plain files inside it")
    return read_frame(path, frame.sha256)
