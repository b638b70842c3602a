"""Arrays of npz and npy files, read as they are declared: shape and type are checked before memory is taken.

Nothing pickled is ever loaded, and of an archive only the arrays that are asked for are read.
"""

import io
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FinrayError, RecordError
from data_schemas.foreign_files import LARGEST_ARRAY_FILE_BYTES, MB, read_bytes

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
            raise ValueError(f"holds {dtype}, not real numbers")
        if len(content) - file.tell() != math.prod(shape) * dtype.itemsize:
            raise ValueError(f"holds not as many bytes as {dtype} of shape {shape} has")
        return _shaped(content[file.tell() :], shape, fortran, dtype)
    except Exception as fault:  # of a damaged header numpy raises nearly anything
        raise error(
            f"{path}: not a plain numeric .npy file ({fault}); pickled files are refused, since loading one can run "
            "code: save it again with numpy.save from a numeric array"
        ) from None


def _declared(archive: zipfile.ZipFile, name: str, wanted: DeclaredArray) -> NDArray[Any]:
    """Read one array of a record."""
    try:
        entry = archive.getinfo(f"{name}.npy")
    except KeyError:
        raise ValueError(f"array {name!r} is missing in it") from None
    if entry.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"array {name!r} is compressed; arrays of records never are")
    return _member(archive, entry, entry.compress_size, wanted)


def _member(
    archive: zipfile.ZipFile, entry: zipfile.ZipInfo, room_bytes: int, wanted: DeclaredArray | None = None
) -> NDArray[Any]:
    """Read one array of an archive after its header was checked."""
    name = entry.filename.removesuffix(".npy")
    if entry.compress_type not in _COMPRESSIONS or entry.flag_bits & _ENCRYPTED:
        raise ValueError(f"array {name!r} is encrypted or packed in another way than numpy packs")
    with archive.open(entry) as opened:
        file: Any = opened
        shape, fortran, dtype = _header(file)
        if wanted is not None and (shape, dtype.str) != (wanted.shape, wanted.dtype):
            raise ValueError(
                f"array {name!r} is {dtype.str} of shape {shape}; the record declares {wanted.dtype} of {wanted.shape}"
            )
        if dtype.kind not in "fiub":
            return np.empty(0, dtype)
        size = math.prod(shape) * dtype.itemsize
        if size > room_bytes:
            raise ValueError(f"array {name!r} has {size / MB:.4g} MB, more than the {room_bytes / MB:.4g} MB allowed")
        if entry.file_size != file.tell() + size:
            raise ValueError(f"array {name!r} holds not as many bytes as {dtype} of shape {shape} has")
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
        raise ValueError(f"npy format {version[0]}.{version[1]} is not read; 1.0 and 2.0 are")
    shape, fortran, dtype = header
    if dtype.hasobject:
        raise _PickledError("holds pickled objects, which are never loaded")
    if len(shape) > MOST_DIMENSIONS or any(length < 0 for length in shape):
        raise ValueError(f"shape {shape} is none; at most {MOST_DIMENSIONS} dimensions are allowed")
    return tuple(int(length) for length in shape), bool(fortran), dtype


def _shaped(content: bytes, shape: tuple[int, ...], fortran: bool, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the numbers of an array, read-only."""
    if len(content) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"breaks off: {len(content)} bytes for {dtype} of shape {shape}")
    flat = np.frombuffer(content or bytearray(), dtype if dtype.kind != "b" else np.uint8)
    if dtype.kind == "b":
        if flat.max(initial=0) > 1:
            raise ValueError("a truth value is neither 0 nor 1")
        flat = flat.view(np.bool_)
    return flat.reshape(shape, order="F" if fortran else "C")
