"""Stored frames: uncompressed 16-bit TIFF, checked against the SHA-256 of their capture."""

import hashlib
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import ChecksumError
from data_schemas.foreign_files import digest_as_read, read_bytes
from data_schemas.whole_files import write_bytes


def write_frame(path: Path, frame: NDArray[np.uint16], description: str) -> str:
    """Write a frame, raw (H, W) or RGB (H, W, 3), as uncompressed 16-bit TIFF and return its SHA-256.

    Raises
    ------
    RecordError
        The file exists already.
    """
    import tifffile  # here and below, because most verbs touch no frame

    buffer = io.BytesIO()
    photometric = "rgb" if frame.ndim == 3 else "minisblack"
    tifffile.imwrite(buffer, frame, photometric=photometric, description=description, metadata=None)
    write_bytes(path, buffer.getvalue())
    return hashlib.sha256(buffer.getvalue()).hexdigest()


def read_frame(path: Path, sha256: str) -> NDArray[np.uint16]:
    """Read a raw frame after checking that it is the one that was captured.

    Raises
    ------
    ChecksumError
        The frame is missing or its bytes differ from the recorded checksum.
    """
    import tifffile

    if not path.exists():
        raise ChecksumError(f"{path}: frame is missing; restore it from a copy or capture the session again")
    content = read_bytes(path, "a frame of the session", ChecksumError)
    if digest_as_read(path) != sha256:
        raise ChecksumError(f"{path}: SHA-256 differs from the session's record; the frame was changed, restore it")
    frame: NDArray[np.uint16] = tifffile.imread(io.BytesIO(content))
    return frame
