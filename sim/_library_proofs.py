"""Proof that a compiled library runs on this machine, in a process of its own, and remembered.

A library that was built for another processor, or against another compiler, does not raise: it ends the process. It is
therefore used first in a child, whose death is a sentence. The outcome is kept in the user's cache folder under a name
that holds the processor, Python and the library's files, so that the same library is tried once.
"""

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from data_schemas import FinrayError
from data_schemas.storage import call_in_child, read_json, write_bytes

_TIME_S = 120.0
_CERTAIN = "was ended by SIGILL"  # of the ways to fail only this one will be the same the next time


def proof_failure(
    function: str,
    arguments: Mapping[str, str],
    libraries: Sequence[str],
    time_s: float = _TIME_S,
    remember: bool = True,
) -> str | None:
    """Run a function that uses a library, "module:function", in a child; return None, or how it failed.

    Parameters
    ----------
    function
        Raises a :class:`~data_schemas.FinrayError`, or ends its process, where the library does not work.
    arguments
        Its keyword arguments.
    libraries
        Modules and paths of files; the proof is made again when one of them changes.
    time_s
        A proof that takes longer has failed.
    remember
        False where the outcome hangs on more than these files, Python and the processor.

    Returns
    -------
    str or None
        What follows a name, such as "was ended by SIGILL (...)".
    """
    note = _notes() / f"{_name(function, arguments, libraries)}.json" if remember else None
    remembered = None if note is None else _read(note)
    if remembered is not None:
        return remembered or None
    try:
        call_in_child(function, arguments, time_s=time_s)
    except (FinrayError, OSError) as failed:
        if note is not None and _CERTAIN in str(failed):
            _write(note, str(failed))
        return str(failed)
    if note is not None:
        _write(note, "")
    return None


def is_installed(module: str) -> bool:
    """Return whether a module can be found, without importing it."""
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def _name(function: str, arguments: Mapping[str, str], libraries: Sequence[str]) -> str:
    """Return the name of a proof: a digest of all that its outcome hangs on."""
    from llvmlite import binding  # it asks the processor itself, where /proc/cpuinfo may be another machine's

    features = binding.get_host_cpu_features().flatten()
    files = [_state(name) for name in (function.partition(":")[0], *libraries)]
    content = [function, dict(arguments), files, sys.version, sys.prefix, binding.get_host_cpu_name(), features]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def _state(name: str) -> list[str | int]:
    """Return where a module or file is, its size and the time of its last change."""
    path = Path(name)
    if not path.is_absolute():
        found = find_spec(name) if is_installed(name) else None
        path = Path(name if found is None or found.origin is None else found.origin)
    path = path.resolve()
    if not path.is_file():
        return [str(path), 0, 0]
    status = path.stat()
    return [str(path), status.st_size, status.st_mtime_ns]


def _notes() -> Path:
    """Return the folder where outcomes are kept."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "finray-calib" / "proofs"


def _read(note: Path) -> str | None:
    """Return a kept outcome, or None; what is not one is removed."""
    if not note.is_file():
        return None
    try:
        failure = read_json(note)["failure"]
    except (FinrayError, OSError, KeyError, TypeError):
        failure = None
    if isinstance(failure, str):
        return failure
    with contextlib.suppress(OSError):
        note.unlink()
    return None


def _write(note: Path, failure: str) -> None:
    """Keep an outcome, where the folder allows it; another process may have been first."""
    with contextlib.suppress(OSError, FinrayError):
        write_bytes(note, json.dumps({"failure": failure}).encode())
