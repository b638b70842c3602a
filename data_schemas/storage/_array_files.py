"""Files of arrays: npz and npy as they are declared, TIFF frames, and formats whose parsers may crash.

Shape and type are checked before memory is taken, nothing pickled is ever loaded, and of an archive only the arrays
that are asked for are read. Stored frames are checked against the SHA-256 of their capture.

Parsers of others that can crash, hang or fill the memory run on the bytes of one file in a child process. The child
is started by the first file that needs it and serves the later ones, so that a folder of compressed raw images pays
for one start. Its death, and what it takes beyond the limits, is an error that names the file.
"""

import atexit
import hashlib
import io
import math
import os
import tempfile
import threading
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import ChecksumError, FinrayError, ImportFormatError, ProcessDiedError, RecordError
from data_schemas.storage._child_process import Child
from data_schemas.storage._foreign_files import LARGEST_ARRAY_FILE_BYTES, MB, digest_as_read, read_bytes
from data_schemas.storage._whole_files import write_bytes
from data_schemas.storage._zip_archives import brief_fault

LARGEST_FOREIGN_ARRAYS_BYTES: Final = 512 * MB
"""Of all arrays of a file of others together, unpacked."""
MOST_DIMENSIONS: Final = 8
_LONGEST_HEADER: Final = 10_000  # as numpy has it; a plain array's header has some 100 characters
_COMPRESSIONS: Final = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_ENCRYPTED: Final = 1  # a bit of a zip entry's flags


@dataclass(frozen=True, slots=True)
class DeclaredArray:
    """What a record says of one of its arrays: shape, and type as numpy writes it (``<f8``)."""

    shape: tuple[int, ...]
    dtype: str


class _NoArrayError(ValueError):
    """A member of an archive that is called an array and is none."""


class _PickledError(ValueError):
    """An array of objects: loading it could run a stranger's code."""


def read_declared_arrays(
    content: bytes, declared: Mapping[str, DeclaredArray], where: object, error: type[FinrayError] = RecordError
) -> dict[str, NDArray[Any]]:
    """Return the arrays that a record declares from the bytes of its array file, read-only.

    The file is uncompressed, as records are written, so that no array is larger than the file.

    Parameters
    ----------
    content
        Bytes of the npz file.
    declared
        Name -> shape and type; other arrays of the file are not read.
    where
        The file, for messages.
    error
        Class of the error.

    Raises
    ------
    FinrayError
        Of the class `error`: the archive is damaged or compressed, or an array is missing or not as declared.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return {name: _declared(archive, name, wanted) for name, wanted in declared.items()}
    except Exception as fault:  # of a damaged archive zipfile raises nearly anything
        raise error(f"{where}: cannot be read as numpy arrays ({fault})") from None


def read_npz(
    path: Path, what: str = "an npz file", error: type[FinrayError] = RecordError
) -> tuple[dict[str, NDArray[Any]], tuple[str, ...]]:
    """Return the arrays of numbers of another program's npz file by name, and the names of its pickled ones.

    What else lies in the file, such as a text, is left out.

    Raises
    ------
    FinrayError
        Of the class `error`: the file is missing, damaged or no npz file, or its arrays are larger than
        :data:`LARGEST_FOREIGN_ARRAYS_BYTES` together.
    """
    content = read_bytes(path, what, error, LARGEST_ARRAY_FILE_BYTES)
    arrays: dict[str, NDArray[Any]] = {}
    pickled = []
    room = LARGEST_FOREIGN_ARRAYS_BYTES
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for entry in archive.infolist():
                name = entry.filename.removesuffix(".npy")
                if name == entry.filename:
                    continue
                try:
                    array = _member(archive, entry, room)
                except _PickledError:
                    pickled.append(name)
                    continue
                except _NoArrayError:
                    continue
                if array.dtype.kind in "fiub":
                    arrays[name] = array
                    room -= array.nbytes
    except Exception as fault:  # of a damaged archive zipfile raises nearly anything
        raise error(
            f"{path}: cannot be read as npz ({fault}); copy it again, or have its owner save it again (numpy.savez)"
        ) from None
    return arrays, tuple(pickled)


def read_npy(path: Path, what: str = "an npy file", error: type[FinrayError] = RecordError) -> NDArray[Any]:
    """Return the array of numbers of an npy file, read-only.

    Raises
    ------
    FinrayError
        Of the class `error`: the file is missing, damaged, pickled, or no array of numbers.
    """
    content = read_bytes(path, what, error, LARGEST_ARRAY_FILE_BYTES)
    file = io.BytesIO(content)
    try:
        shape, fortran, dtype = _header(file)
        if dtype.kind not in "fiub":
            raise ValueError(f"contains {dtype}, not real numbers")
        if len(content) - file.tell() != math.prod(shape) * dtype.itemsize:
            raise ValueError(f"does not have the number of bytes that {dtype} of shape {shape} needs")
        return _shaped(content[file.tell() :], shape, fortran, dtype)
    except Exception as fault:  # of a damaged header numpy raises nearly anything
        raise error(
            f"{path}: is not a plain numeric .npy file ({fault}). Pickled files are not supported, because loading "
            "one can run code; save a numeric array with numpy.save"
        ) from None


def _declared(archive: zipfile.ZipFile, name: str, wanted: DeclaredArray) -> NDArray[Any]:
    """Read one array of a record."""
    try:
        entry = archive.getinfo(f"{name}.npy")
    except KeyError:
        raise ValueError(f"array {name!r} is missing") from None
    if entry.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"array {name!r} is compressed, but arrays of records must not be compressed")
    return _member(archive, entry, entry.compress_size, wanted)


def _member(
    archive: zipfile.ZipFile, entry: zipfile.ZipInfo, room_bytes: int, wanted: DeclaredArray | None = None
) -> NDArray[Any]:
    """Read one array of an archive after its header was checked."""
    name = entry.filename.removesuffix(".npy")
    if entry.compress_type not in _COMPRESSIONS or entry.flag_bits & _ENCRYPTED:
        raise ValueError(f"array {name!r} is encrypted, or its compression is not supported")
    with archive.open(entry) as opened:
        file: Any = opened
        shape, fortran, dtype = _header(file)
        if wanted is not None and (shape, dtype.str) != (wanted.shape, wanted.dtype):
            raise ValueError(
                f"array {name!r} is {dtype.str} of shape {shape}, but the record declares {wanted.dtype} of shape "
                f"{wanted.shape}"
            )
        if dtype.kind not in "fiub":
            return np.empty(0, dtype)
        size = math.prod(shape) * dtype.itemsize
        if size > room_bytes:
            raise ValueError(f"array {name!r} has {size / MB:.4g} MB, but at most {room_bytes / MB:.4g} MB are allowed")
        if entry.file_size != file.tell() + size:
            raise ValueError(f"array {name!r} does not have the number of bytes that {dtype} of shape {shape} needs")
        return _shaped(file.read(size), shape, fortran, dtype)


def _header(file: BinaryIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Return shape, order and type that an npy header states, without reading the numbers."""
    try:
        version = np.lib.format.read_magic(file)
    except ValueError as fault:
        raise _NoArrayError(str(fault)) from None
    if version == (1, 0):
        header: Any = np.lib.format.read_array_header_1_0(file, max_header_size=_LONGEST_HEADER)
    elif version == (2, 0):
        header = np.lib.format.read_array_header_2_0(file, max_header_size=_LONGEST_HEADER)
    else:
        raise ValueError(f"npy format {version[0]}.{version[1]} is not supported; save the array in format 1.0 or 2.0")
    shape, fortran, dtype = header
    if dtype.hasobject:
        raise _PickledError("contains pickled objects, which are never loaded")
    if len(shape) > MOST_DIMENSIONS or any(length < 0 for length in shape):
        raise ValueError(
            f"{shape} is not a valid shape; only lengths of at least 0 and at most {MOST_DIMENSIONS} "
            "dimensions are allowed"
        )
    return tuple(int(length) for length in shape), bool(fortran), dtype


def _shaped(content: bytes, shape: tuple[int, ...], fortran: bool, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the numbers of an array, read-only."""
    if len(content) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"is cut off, with {len(content)} bytes for {dtype} of shape {shape}")
    flat = np.frombuffer(content or bytearray(), dtype if dtype.kind != "b" else np.uint8)
    if dtype.kind == "b":
        if flat.max(initial=0) > 1:
            raise ValueError("a Boolean value is neither 0 nor 1")
        flat = flat.view(np.bool_)
    return flat.reshape(shape, order="F" if fortran else "C")


Arrays = dict[str, NDArray[Any]]
Parser = Callable[[bytes, str], tuple[Any, Mapping[str, NDArray[Any]]]]
LONGEST_PARSING_S: Final = 15.0
MOST_MEMORY_BYTES: Final = 768 * MB
"""Address space of a parser beyond that of the interpreter."""
_LONGEST_LOADING_S: Final = 60.0
_CONTENT, _ARRAYS = "content", "arrays.npz"


class _OwnChild(threading.local):
    """The child of a thread: it ends with the thread that started it."""

    child: Child | None = None
    parent: int = 0


_OWN = _OwnChild()


def parse_in_child(
    function: str, content: bytes, where: object, what: str, error: type[FinrayError] = RecordError
) -> tuple[Any, Arrays]:
    """Run a parser on the bytes of a file in a child process with limits of time and memory.

    Parameters
    ----------
    function
        "module:function" that takes the bytes and `where` as text, and returns (JSON, arrays by name).
    content
        The bytes.
    where
        File they came from, for messages.
    what
        What the file should be: "a calibration of OpenCV".
    error
        Class of the error where the parser dies.

    Returns
    -------
    tuple
        What the parser returned; the arrays are read-only.

    Raises
    ------
    FinrayError
        What the parser raised, or `error` where it died, took more than :data:`LONGEST_PARSING_S` or more than
        :data:`MOST_MEMORY_BYTES`.
    """
    with TemporaryDirectory(prefix="finray-parsing-") as name:
        folder = Path(name)
        (folder / _CONTENT).write_bytes(content)
        arguments = {"function": function, "folder": name, "where": str(where)}
        try:
            # what the parser needs itself counts neither as memory nor as time of this file
            _child().call(f"{__name__}:load_parser", {"function": function}, time_s=_LONGEST_LOADING_S)
            answer = _child().call(
                f"{__name__}:parse_file", arguments, time_s=LONGEST_PARSING_S, memory_bytes=MOST_MEMORY_BYTES
            )
        except ProcessDiedError as death:
            remedy = "the file is corrupted or malicious"
            if str(death).startswith("took longer"):
                again = "try again when the computer is less busy; if it takes as long again, the file is too large"
                remedy = f"{again} (cut it), corrupted or malicious"
            raise error(f"{where}: cannot be read as {what}, because the parser {death}; {remedy}") from None
        declared = {key: DeclaredArray(tuple(shape), dtype) for key, (shape, dtype) in answer["arrays"].items()}
        if not declared:
            return answer["value"], {}
        stored = read_bytes(folder / _ARRAYS, "arrays of a parser", error, LARGEST_ARRAY_FILE_BYTES)
        return answer["value"], read_declared_arrays(stored, declared, where, error)


def load_parser(function: str) -> None:
    """Import a parser; the child's side of :func:`parse_in_child`."""
    import_module(function.split(":")[0])


def parse_file(function: str, folder: str, where: str) -> dict[str, Any]:
    """Run a parser; the child's side of :func:`parse_in_child`."""
    module, name = function.split(":")
    parser: Parser = getattr(import_module(module), name)
    before, tempfile.tempdir = tempfile.tempdir, folder  # the parent removes it, also where the child is killed
    try:
        value, arrays = parser(read_bytes(Path(folder) / _CONTENT), where)
    finally:
        tempfile.tempdir = before
    if arrays:
        np.savez(Path(folder) / _ARRAYS, allow_pickle=False, **arrays)
    return {"value": value, "arrays": {key: (array.shape, array.dtype.str) for key, array in arrays.items()}}


def end_child() -> None:
    """End this thread's child, if there is one; the next file that needs it starts another."""
    if _OWN.child is not None and _OWN.parent == os.getpid():
        _OWN.child.end()


def _child() -> Child:
    """Return this thread's child; a process that was forked has its own."""
    if _OWN.child is None or _OWN.parent != os.getpid():
        if _OWN.child is None:
            atexit.register(end_child)
        _OWN.child, _OWN.parent = Child(), os.getpid()
    return _OWN.child


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
    # as bytes, because tifffile refuses text beyond ASCII, and names of filters are in any language
    tifffile.imwrite(buffer, frame, photometric=photometric, description=description.encode(), metadata=None)
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
        raise ChecksumError(f"{path}: the frame is missing; restore it from a copy, or capture the session again")
    content = read_bytes(path, "a frame of the session", ChecksumError)
    if digest_as_read(path) != sha256:
        raise ChecksumError(
            f"{path}: the frame was changed (its SHA-256 differs from the session's record); restore the frame"
        )
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
                raise ValueError(f"contains a stack of {len(file.pages)} images, but a single image is needed")
            if page.compression == _UNCOMPRESSED:
                return np.asarray(page.asarray())
    except Exception as fault:  # of a broken file the TIFF reader raises nearly anything
        raise error(f"{where}: cannot be read as TIFF ({brief_fault(fault)}); copy it again") from None
    return parse_in_child(f"{__name__}:unpacked_tiff", content, where, "TIFF", error)[1]["image"]


def unpacked_tiff(content: bytes, where: str) -> tuple[None, dict[str, NDArray[Any]]]:
    """Decode a compressed TIFF; the child's side of :func:`tiff_image`."""
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(content)) as file:
            return None, {"image": np.asarray(file.pages[0].asarray())}
    except Exception as fault:
        raise ImportFormatError(f"{where}: cannot be read as TIFF ({brief_fault(fault)}); copy it again") from None


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
            f"an image of shape {page.shape} takes {size / 2**20:.4g} MB when decoded, but only sizes above 0 and "
            f"up to {LARGEST_DECODED_BYTES / 2**20:g} MB are supported"
        )


BayerOrder = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
"""Colours of the first 2 x 2 pixels, row by row."""
FIRST_RED: Final[dict[BayerOrder, tuple[int, int]]] = {"RGGB": (0, 0), "GRBG": (0, 1), "GBRG": (1, 0), "BGGR": (1, 1)}
"""Rows and columns to leave out at the start, so that the frame begins with red."""


def rggb_frame(counts: NDArray[np.uint16], order: BayerOrder) -> NDArray[np.uint16]:
    """Return a Bayer frame that begins with red and has whole 2 x 2 cells, by cutting off rows and columns.

    Parameters
    ----------
    counts
        (H, W) raw counts (DN).
    order
        Colours of the first 2 x 2 pixels, row by row.
    """
    row, column = FIRST_RED[order]
    height, width = ((n - first) // 2 * 2 for n, first in zip(counts.shape, (row, column), strict=True))
    return np.ascontiguousarray(counts[row : row + height, column : column + width])
