"""Read a stored paint session and its frames."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, Frame
from data_schemas.errors import RecordError
from data_schemas.storage import read_frame, read_record
from rigs.capture.journal import JOURNAL_NAME
from rigs.capture.paint_session import SESSION_NAME


def read_session(folder: Path) -> CaptureSession:
    """Read the session that was captured into `folder`.

    Raises
    ------
    RecordError
        The folder is missing, holds no session, or the capture was not finished.
    """
    if (folder / SESSION_NAME).is_file():
        return read_record(folder / SESSION_NAME, CaptureSession)
    if not folder.is_dir():
        raise RecordError(f"{folder}: no such folder; give the folder that 'finray capture' wrote")
    if (folder / JOURNAL_NAME).is_file():
        raise RecordError(
            f"{folder}: the capture was not finished ({SESSION_NAME} is missing); the last line of {JOURNAL_NAME} says "
            "why: capture again into another folder"
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
