"""Checksums of all files of a folder in the format of ``sha256sum --check``, and what no longer agrees with them.

They detect accidents and edits, not forgery: whoever changes a file on purpose can write the checksums anew.
"""

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final, Literal

from data_schemas import RecordError
from data_schemas.storage._foreign_files import files_below, has_file, open_regular, read_text
from data_schemas.storage._product_set import clear_leftovers
from data_schemas.storage._whole_files import write_bytes

MANIFEST_NAME: Final = "manifest-sha256.txt"
FileState = Literal["missing", "changed", "stale"]
_LINE: Final = re.compile(r"([0-9a-f]{64})  (\S.*)")


@dataclass(frozen=True, slots=True)
class FileFault:
    """A file that is not what it was.

    Attributes
    ----------
    path
        The file.
    state
        "missing"; "changed": its content is another; "stale": made anew since something was made from it.
    text
        What is wrong, for its user.
    """

    path: Path
    state: FileState
    text: str


def sha256_now(path: Path) -> str:
    """Return the SHA-256 of a regular file as it is now; provenance takes that of the bytes that were read instead.

    Raises
    ------
    RecordError
        It is no regular file, or cannot be read.
    """
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def manifest_text(folder: Path, added: Mapping[str, str] | None = None, left_out: Iterable[str] = ()) -> bytes:
    """Return the checksums of all files below a folder as ``sha256sum`` writes them.

    Parameters
    ----------
    folder
        Folder; hidden files in it are left out.
    added
        Name -> SHA-256 of files that will be stored together with the checksums.
    left_out
        Names of files or folders in it that are no products, such as logs.
    """
    files = (path for path in folder.rglob("*") if path.is_file() and not _is_hidden(path, folder))
    named = {path.relative_to(folder).as_posix(): path for path in files}
    skipped = set(left_out)
    digests = {name: sha256_now(path) for name, path in named.items() if name.split("/")[0] not in skipped}
    lines = [f"{digest}  {name}\n" for name, digest in sorted({**digests, **(added or {})}.items())]
    return "".join(lines).encode()


def write_manifest(folder: Path) -> Path:
    """Write the checksums of all files below a folder into it and return their file, which must be new."""
    for inside in (folder, *(path for path in folder.rglob("*") if path.is_dir())):
        clear_leftovers(inside)
    write_bytes(folder / MANIFEST_NAME, manifest_text(folder))
    return folder / MANIFEST_NAME


def read_manifest(folder: Path) -> dict[str, str]:
    """Return name -> SHA-256 of the files that the checksums of a folder list.

    Raises
    ------
    RecordError
        There are none, or a line is none of ``sha256sum``'s, leads out of the folder, or lists a file twice.
    """
    path = folder / MANIFEST_NAME
    listed: dict[str, str] = {}
    for number, line in enumerate(read_text(path, "checksums as 'sha256sum' writes them").splitlines(), 1):
        match = _LINE.fullmatch(line)
        name = "" if match is None else match[2]
        if match is None or PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts or name in listed:
            raise RecordError(f"{path}, line {number}: must hold a SHA-256, two spaces and a file of the folder, once")
        listed[name] = match[1]
    return listed


def manifest_faults(folder: Path, known: Mapping[Path, str] | None = None) -> tuple[list[FileFault], list[Path]]:
    """Return what does not agree with the checksums of a folder, and the files that they do not list.

    Parameters
    ----------
    folder
        Folder with checksums.
    known
        Checksums of files that were hashed already.
    """
    path = folder / MANIFEST_NAME
    if not has_file(path):
        return [FileFault(path, "missing", "the checksums of the folder's files are missing")], []
    try:
        listed = read_manifest(folder)
    except RecordError as error:
        return [FileFault(path, "changed", str(error).removeprefix(f"{path}"))], []
    faults = [fault for name, digest in listed.items() for fault in _fault(folder / name, digest, known or {})]
    unlisted = sorted(
        file
        for file in files_below(folder)
        if file != path and not _is_hidden(file, folder) and file.relative_to(folder).as_posix() not in listed
    )
    return faults, unlisted


def _fault(file: Path, digest: str, known: Mapping[Path, str]) -> Iterable[FileFault]:
    """Yield what is wrong with a listed file."""
    if not file.exists() and not has_file(file):
        yield FileFault(file, "missing", f"is missing; {MANIFEST_NAME} lists it")
        return
    try:
        now = known.get(file) or sha256_now(file)
    except RecordError as error:
        yield FileFault(file, "changed", str(error).removeprefix(f"{file}: "))
        return
    if now != digest:
        yield FileFault(file, "changed", f"was changed: its SHA-256 is not the one in {MANIFEST_NAME}")


def _is_hidden(path: Path, folder: Path) -> bool:
    """Return whether a file or a folder above it is hidden: parts of files being written, marks of programs."""
    return any(part.startswith(".") for part in path.relative_to(folder).parts)
