"""Files that are either whole or absent, never overwritten, and known by their SHA-256.

A name that is taken is refused by the file system itself: of two writers at the same moment one wins.
"""

import errno
import hashlib
import os
import secrets
from pathlib import Path

from data_schemas.errors import RecordError
from data_schemas.foreign_files import open_regular

# What os.link says on file systems without hard links (FAT, some network and container mounts).
NO_HARD_LINKS = frozenset({errno.EPERM, errno.EACCES, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS})


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's bytes as 64 hex digits."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a new file so that it is either whole or absent: part file, fsync, link to its name, fsync of the folder.

    Raises
    ------
    RecordError
        Something has this name already: nothing stored is overwritten.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        _give_name(part, path)
    finally:
        part.unlink(missing_ok=True)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def refuse_taken(path: Path) -> None:
    """Refuse a name that something has already.

    Raises
    ------
    RecordError
        It exists.
    """
    if path.exists():
        raise _taken(path)


def _give_name(part: Path, path: Path) -> None:
    """Turn a finished part file into `path`, which must be free; linking refuses a taken name in one step."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise _taken(path) from None
    except OSError as error:
        if error.errno not in NO_HARD_LINKS:
            raise
        # Without hard links a moment is left between look and rename.
        if path.exists():
            raise _taken(path) from None
        part.replace(path)


def _taken(path: Path) -> RecordError:
    """Return the error for a name that is taken."""
    return RecordError(f"{path}: exists already and is not overwritten; choose another --out or move it away")
