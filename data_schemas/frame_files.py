"""TIFF files: stored frames, checked against the SHA-256 of their capture, and those of others."""

import hashlib
import io
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import ChecksumError, FinrayError, ImportFormatError
from data_schemas.foreign_files import digest_as_read, read_bytes
from data_schemas.limited_parsing import parse_in_child
from data_schemas.whole_files import write_bytes

LARGEST_DECODED_BYTES: Final = 256 << 20
"""Of the pixels of an image: 128 million raw counts of 16 bits, or 85 million RGB pixels of 8 bits."""
_UNCOMPRESSED: Final = 1


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
    if not path.exists():
        raise ChecksumError(f"{path}: frame is missing; restore it from a copy or capture the session again")
    content = read_bytes(path, "a frame of the session", ChecksumError)
    if digest_as_read(path) != sha256:
        raise ChecksumError(f"{path}: SHA-256 differs from the session's record; the frame was changed, restore it")
    return np.asarray(tiff_image(content, path, ChecksumError))


def tiff_image(content: bytes, where: object, error: type[FinrayError]) -> NDArray[Any]:
    """Return the first image of a TIFF, (H, W) or (H, W, samples); a compressed one is decoded in a child process.

    Parameters
    ----------
    content
        Bytes of the file.
    where
        The file, for messages.
    error
        Class of the error.

    Raises
    ------
    FinrayError
        Of the class `error`: it is no TIFF, is damaged, holds a stack of images, or is larger than
        :data:`LARGEST_DECODED_BYTES` when decoded.
    """
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            page: Any = file.pages[0]
            require_decoded_size(page)
            if len(file.pages) > 1 and file.pages[1].shape == page.shape:
                raise ValueError(f"holds a stack of {len(file.pages)} images, one is wanted")
            if page.compression == _UNCOMPRESSED:
                return np.asarray(page.asarray())
    except Exception as fault:  # of a broken file the TIFF reader raises nearly anything
        raise error(f"{where}: cannot be read as TIFF ({_brief(fault)}); is the file whole?") from None
    return parse_in_child(f"{__name__}:unpacked_tiff", content, where, "TIFF", error)[1]["image"]


def unpacked_tiff(content: bytes, where: str) -> tuple[None, dict[str, NDArray[Any]]]:
    """Decode a compressed TIFF; the child's side of :func:`tiff_image`."""
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            return None, {"image": np.asarray(file.pages[0].asarray())}
    except Exception as fault:
        raise ImportFormatError(f"{where}: cannot be read as TIFF ({_brief(fault)}); is the file whole?") from None


def require_decoded_size(page: Any) -> None:
    """Refuse a page of a TIFF that is larger when decoded than :data:`LARGEST_DECODED_BYTES`.

    Raises
    ------
    ValueError
        It is, or it has no pixels.
    """
    kind = page.dtype
    size = 0 if kind is None else math.prod(page.shape) * kind.itemsize
    if not 0 < size <= LARGEST_DECODED_BYTES:
        raise ValueError(
            f"an image of shape {page.shape} takes {size / 2**20:.4g} MB when decoded; more than 0 and at "
            f"most {LARGEST_DECODED_BYTES / 2**20:g} MB are allowed"
        )


def _brief(fault: Exception) -> str:
    """Return what the TIFF reader says, in one line of bounded length."""
    return " ".join(f"{fault}".split())[:200] or type(fault).__name__
