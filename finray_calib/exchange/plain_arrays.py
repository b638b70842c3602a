"""Read the arrays of a foreign npz file, but never a pickled object: that would run a stranger's code."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import array_files
from data_schemas.errors import ImportFormatError

Arrays = dict[str, NDArray[Any]]


def read_npz(path: Path) -> tuple[Arrays, tuple[str, ...]]:
    """Return the arrays of an npz file by name, and the names of its pickled ones, which are left out.

    What else lies in the file, such as a text, is left out too.

    Raises
    ------
    ImportFormatError
        When the file is missing, damaged or no npz file.
    """
    if not path.exists():
        raise ImportFormatError(f"{path}: no such file; the folder must hold it")
    return array_files.read_npz(path, "an npz file", ImportFormatError)


def require_array(
    arrays: Mapping[str, NDArray[Any]], pickled: tuple[str, ...], name: str, dims: int, path: Path
) -> NDArray[Any]:
    """Return an array of numbers of so many dimensions.

    Raises
    ------
    ImportFormatError
        When it is missing, pickled, not finite numbers, or has other dimensions.
    """
    if name in pickled:
        raise ImportFormatError(
            f"{path}: {name!r} is stored as pickled objects, which are never loaded; have its owner save it again as a "
            "plain array (numpy.savez with equal shapes)"
        )
    if name not in arrays:
        raise ImportFormatError(f"{path}: array {name!r} is missing; it holds {', '.join(sorted(arrays)) or 'nothing'}")
    array = arrays[name]
    if array.dtype.kind not in "uif" or array.ndim != dims or not np.isfinite(array).all():
        raise ImportFormatError(
            f"{path}: {name!r} must be finite numbers of {dims} dimensions, got {array.dtype} of shape {array.shape}"
        )
    return array
