"""Files that are either whole or absent, never overwritten, and known by their SHA-256.

A file is written under a hidden name first (a part, ``.NAME.TOKEN.finray.part``), which is locked as long as its
writer lives: the parts of dead writers are collected by :mod:`data_schemas.storage._product_set`. A name that is
taken is refused by the file system itself: of two writers at the same moment one wins. Products of several files are
written by :class:`ProductSet <data_schemas.storage._product_set.ProductSet>`.
"""

import contextlib
import errno
import fcntl
import hashlib
import os
import secrets
import stat
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from data_schemas import RecordError
from data_schemas.errors import naming_file, system_words
from data_schemas.storage._foreign_files import open_regular

# What os.link says on file systems without hard links (FAT, some network and container mounts).
NO_HARD_LINKS = frozenset({errno.EPERM, errno.EACCES, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS})
# What os.fsync says of a folder where the file system has no such thing.
NO_FOLDER_SYNC = frozenset({errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS})
PART_ENDING = ".finray.part"
EARLIEST = (1980, 1, 1, 0, 0, 0)
"""Date of the files in an archive."""
LONGEST_NAME_BYTES = 180
"""Of a name within a hidden name; file systems take 255 in all."""


def given_path(what: object, argument: str) -> Path:
    """Return the path that a user gave as an argument; a first part ``~`` is the user's home, as in a shell.

    Raises
    ------
    RecordError
        It is no path, an empty one, or there is no home.
    """
    if not isinstance(what, str | os.PathLike) or isinstance(path := os.fspath(what), bytes):
        raise RecordError(f"{argument}: must be the path of a file or folder, got type {type(what).__name__}")
    if not path:
        raise RecordError(f"{argument}: the path is empty; give the name of a file or folder")
    if Path(path).parts[:1] != ("~",):
        return Path(path)
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise RecordError(f"{path}: the home folder (~) is unknown; write the whole path") from None


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say in words why a file that a user named cannot be written.

    Raises
    ------
    RecordError
        The system refuses it: no permission, no space, a name that it does not take.
    """
    try:
        yield
    except (OSError, ValueError) as error:
        raise RecordError(f"{str(path)!r}: cannot be written ({system_words(error)}); choose another place") from None


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a regular file as it is now; provenance takes that of the bytes that were read instead.

    Raises
    ------
    RecordError
        It is no regular file, or cannot be read.
    """
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a new file so that it is complete or absent: part file, fsync, link to its name, fsync of the folder.

    Raises
    ------
    RecordError
        Something has this name already: nothing stored is overwritten.
    """
    write_atomically(path, lambda handle: write_all(handle, content, path))


def write_atomically(path: Path, fill: Callable[[int], None]) -> None:
    """Write a new file of any length as :func:`write_bytes` does.

    Parameters
    ----------
    path
        Its name.
    fill
        Writes all of it to an open descriptor, and has it on the disk.

    Raises
    ------
    RecordError
        Something has this name already: nothing stored is overwritten.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with naming_file(path):
        part, handle = _new_part(path)
    try:
        fill(handle)
        give_name(part, path)
        try:
            sync_folder(path.parent)
        except OSError:
            with contextlib.suppress(OSError):  # what may not be on the disk does not count as stored
                path.unlink()
            raise
    finally:
        with contextlib.suppress(OSError):  # collected by the next writer in this folder
            part.unlink(missing_ok=True)
        os.close(handle)


def write_zip(path: Path, files: Iterable[tuple[str, bytes]]) -> None:
    """Write a new zip archive that is complete or absent; the same files give the same bytes.

    Files are stored as they are, pictures and arrays hardly shrink, in the order of `files`, all with the earliest date
    that the format has and none of their owner.

    Parameters
    ----------
    path
        The archive; it must be new.
    files
        Name within the archive and content, one after the other.

    Raises
    ------
    RecordError
        Something has this name already.
    """

    def fill(handle: int) -> None:
        with os.fdopen(handle, "wb", closefd=False) as file:
            with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
                for name, content in files:
                    entry = zipfile.ZipInfo(name, EARLIEST)
                    entry.create_system = 3  # Unix, wherever it is written
                    entry.external_attr = (stat.S_IFREG | 0o644) << 16
                    with naming_file(path):
                        archive.writestr(entry, content)
            with naming_file(path):
                file.flush()
                os.fsync(handle)

    write_atomically(path, fill)


def refuse_existing(path: Path) -> None:
    """Refuse a name that something has already.

    Raises
    ------
    RecordError
        It exists.
    """
    if path.exists():
        raise taken(path)


def taken(path: Path) -> RecordError:
    """Return the error for a name that is taken."""
    return RecordError(f"{path}: exists already and is not overwritten; choose another name or move it away")


def part_name(name: str, token: str) -> str:
    """Return the hidden name of a file or folder that is being written."""
    return f".{short_name(name)}.{token}{PART_ENDING}"


def short_name(name: str) -> str:
    """Return a name that leaves room for a hidden name's marks: itself, or its beginning with a digest of it."""
    encoded = name.encode("utf-8", "surrogateescape")
    if len(encoded) <= LONGEST_NAME_BYTES:
        return name
    return f"{name[: LONGEST_NAME_BYTES // 8]}-{hashlib.sha256(encoded).hexdigest()[:16]}"


def new_token() -> str:
    """Return what tells the hidden files of one writer from those of another: 8 hex digits."""
    return secrets.token_hex(4)


def lock(handle: int) -> bool | None:
    """Try to lock an open file for this process, until it is closed; the lock vanishes with the process, too.

    Returns
    -------
    bool or None
        Whether it is ours; None where the file system has no locks.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def is_ours(handle: int) -> bool:
    """Lock a file that was just created; False where someone took it for a leftover before it was locked."""
    return lock(handle) is not False and os.fstat(handle).st_nlink > 0


def write_all(handle: int, content: bytes, path: Path) -> None:
    """Have all bytes in an open file, and the file on the disk; an error names the path it is for."""
    rest = memoryview(content)
    with naming_file(path):
        while rest:
            rest = rest[os.write(handle, rest) :]
        os.fsync(handle)


def give_name(part: Path, path: Path) -> None:
    """Turn a finished part file into `path`, which must be free; linking refuses a taken name in one step.

    Raises
    ------
    RecordError
        The name is taken.
    """
    try:
        os.link(part, path)
    except FileExistsError:
        raise taken(path) from None
    except OSError as error:
        if error.errno not in NO_HARD_LINKS:
            raise
        # Without hard links a moment is left between look and rename.
        if path.exists():
            raise taken(path) from None
        part.replace(path)


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with naming_file(folder):
            os.fsync(handle)
    except OSError as error:
        if error.errno not in NO_FOLDER_SYNC:
            raise
    finally:
        os.close(handle)


def _new_part(path: Path) -> tuple[Path, int]:
    """Create the locked part file of a single file; return it and its open descriptor."""
    while True:
        part = path.with_name(part_name(path.name, new_token()))
        handle = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        if is_ours(handle):
            return part, handle
        os.close(handle)
