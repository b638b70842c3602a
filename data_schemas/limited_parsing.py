"""Parsers of others that can crash, hang or fill the memory, run on the bytes of one file in a child process.

The child is started by the first file that needs it and serves the later ones, so that a folder of compressed raw
images pays for one start. Its death, and what it takes beyond the limits, is an error that names the file.
"""

import atexit
import os
import threading
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.array_files import DeclaredArray, read_declared_arrays
from data_schemas.child_process import Child
from data_schemas.errors import DiedError, FinrayError, RecordError
from data_schemas.foreign_files import LARGEST_ARRAY_FILE_BYTES, MB, read_bytes

Arrays = dict[str, NDArray[Any]]
Parser = Callable[[bytes, str], tuple[Any, Mapping[str, NDArray[Any]]]]
LONGEST_PARSING_S: Final = 15.0
MOST_MEMORY_BYTES: Final = 768 * MB
"""Address space of a parser beyond that of the interpreter."""
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
            answer = _child().call(
                f"{__name__}:parse_file", arguments, time_s=LONGEST_PARSING_S, memory_bytes=MOST_MEMORY_BYTES
            )
        except DiedError as death:
            raise error(
                f"{where}: cannot be read as {what}: its parser {death}; the file is damaged, or made to do harm"
            ) from None
        declared = {key: DeclaredArray(tuple(shape), dtype) for key, (shape, dtype) in answer["arrays"].items()}
        if not declared:
            return answer["value"], {}
        stored = read_bytes(folder / _ARRAYS, "arrays of a parser", error, LARGEST_ARRAY_FILE_BYTES)
        return answer["value"], read_declared_arrays(stored, declared, where, error)


def parse_file(function: str, folder: str, where: str) -> dict[str, Any]:
    """Run a parser; the child's side of :func:`parse_in_child`."""
    module, name = function.split(":")
    parser: Parser = getattr(import_module(module), name)
    value, arrays = parser(read_bytes(Path(folder) / _CONTENT), where)
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
