"""What every function of the library takes and gives: a record or its path, and a record that says where it is from."""

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from data_schemas import Record, RecordError, needed_kind, provenance
from data_schemas.storage import digest_as_read
from data_schemas.storage import read_record as read_stored

R = TypeVar("R", bound=Record)
PathLike = str | os.PathLike[str]


def given(what: R | PathLike, kind: type[R]) -> tuple[R, list[Path]]:
    """Return a record that was given as itself or as the path of a stored one, and the files that were read.

    Raises
    ------
    RecordError
        It is neither, of another kind, or cannot be read.
    """
    if isinstance(what, kind):
        return what, []
    if isinstance(what, str | os.PathLike):
        path = Path(what)
        return read_stored(path, kind), [path]
    raise RecordError(
        f"{needed_kind(kind.__name__)}, as a {kind.__name__} or the path of a stored one; a {type(what).__name__} was "
        "given"
    )


def made(record: R, call: str, inputs: Iterable[Path], seed: int | None = None) -> R:
    """Return a record with its origin: the function of the library, the files that went in, and the seed."""
    return record.model_copy(
        update={"provenance": provenance(f"finray_calib.{call}, from Python", digests_of(inputs), seed)}
    )


def digests_of(paths: Iterable[Path]) -> dict[str, str]:
    """Return path as given -> SHA-256 of the bytes that were read, of the files that were."""
    read = {path.as_posix(): digest_as_read(path) for path in paths}
    return {name: digest for name, digest in read.items() if digest is not None}


def digest_of(record: Record, files: list[Path]) -> str:
    """Return the SHA-256 that stands for a record: of its file, or of its content where it has none."""
    if files and (digest := digest_as_read(files[0])) is not None:
        return digest
    return hashlib.sha256(record.model_dump_json(exclude={"provenance"}).encode()).hexdigest()
