"""Zip archives: what of one is accepted, and the bytes of its files.

Nothing is ever unpacked to the disk: a file of an archive is read into memory when it is asked for, under the same
limits as any other. Before a single one is read, the list of all is checked: plain files and folders only, names that
stay within the archive, each once, stored or deflated, none over another, none that grows out of proportion.
"""

import os
import stat
import threading
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import PurePosixPath
from typing import BinaryIO, Final

ENDING: Final = ".zip"
MOST_MEMBERS: Final = 50_000
DEEPEST_MEMBER: Final = 16
LONGEST_MEMBER_NAME: Final = 1000
LARGEST_LIST_BYTES: Final = 16 << 20
"""Of the list of files at the end of an archive."""
LARGEST_UNPACKED_BYTES: Final = 8 << 30
MOST_GROWTH: Final = 200
"""Bytes of a file for each byte that it takes in the archive, beyond :data:`FREE_BYTES`."""
FREE_BYTES: Final = 16 << 20
NOT_OF_THE_USER: Final = "__MACOSX"
"""What the Finder of macOS puts beside the files; it is left out."""
_ENCRYPTED: Final = 0x1
_LOCAL_HEADER_BYTES: Final = 30
_DAMAGED = (
    zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError, OverflowError, IndexError,
)  # fmt: skip


class ZipArchive:
    """An archive whose list of files is accepted.

    Parameters
    ----------
    file
        The open archive, which is read now and not kept.

    Raises
    ------
    ValueError
        It is no zip archive, or one that is not accepted; the text follows its name and a colon.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = _ShortReads(file)
        self._reading = threading.Lock()
        try:
            self._archive = zipfile.ZipFile(self._file)
        except _DAMAGED as fault:
            raise ValueError(f"cannot be read as a zip archive ({brief_fault(fault)}); copy it again") from None
        entries = self._archive.infolist()
        self._entries = dict(_accepted(entries))
        _require_apart(entries)
        self.folders = frozenset(str(above) for name in self._entries for above in PurePosixPath(name).parents)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its files, sorted, with ``/`` between folders."""
        return tuple(sorted(self._entries))

    @property
    def top(self) -> str:
        """The one folder that holds all its files, as archives of a folder have it; "" where there is none."""
        tops = {name.partition("/")[0] for name in self._entries if not name.startswith(".")}
        return tops.pop() if len(tops) == 1 and tops <= self.folders else ""

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def size(self, name: str) -> int:
        """Return the size of a file, bytes."""
        return self._entries[name].file_size

    def read(self, name: str, file: BinaryIO) -> bytes:
        """Return the bytes of a file, whose checksum is right.

        Parameters
        ----------
        name
            One of :attr:`names`.
        file
            The archive, opened again.

        Raises
        ------
        ValueError
            It is damaged.
        """
        entry = self._entries[name]
        try:
            with self._reading, self._file.being(file), self._archive.open(entry) as opened:
                content = opened.read(entry.file_size + 1)
        except _DAMAGED as fault:
            raise ValueError(f"is corrupted in the archive ({brief_fault(fault)})") from None
        if len(content) != entry.file_size:
            raise ValueError(f"is cut off in the archive, at {len(content)} of {entry.file_size} bytes")
        return content


class _ShortReads:
    """An open archive that is not read in pieces as large as a forged list of files would have it."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._most_bytes = file, LARGEST_LIST_BYTES

    @contextmanager
    def being(self, file: BinaryIO) -> Iterator[None]:
        """Read from the archive as it was opened again, files of any length."""
        self._file, self._most_bytes = file, LARGEST_UNPACKED_BYTES
        yield

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def read(self, count: int | None = -1) -> bytes:
        wanted = count if count is not None and count >= 0 else self._left()
        if wanted > self._most_bytes:
            raise ValueError(f"has a list of files of {wanted} bytes, but at most {self._most_bytes} are read")
        return self._file.read(wanted)

    def _left(self) -> int:
        at = self._file.tell()
        end = self._file.seek(0, os.SEEK_END)
        return max(0, end - self._file.seek(at))


def _accepted(entries: list[zipfile.ZipInfo]) -> Iterator[tuple[str, zipfile.ZipInfo]]:
    """Yield name and entry of the files; an archive with one that is not accepted is refused."""
    if len(entries) > MOST_MEMBERS:
        raise ValueError(
            f"contains {len(entries)} files, but at most {MOST_MEMBERS} are read; give an archive with fewer"
        )
    total = sum(entry.file_size for entry in entries)
    if total > LARGEST_UNPACKED_BYTES:
        raise ValueError(
            f"has {total / 2**30:.3g} GB when unpacked, but at most {LARGEST_UNPACKED_BYTES / 2**30:g} GB are "
            "read; unpack it and give the folder"
        )
    seen: set[str] = set()
    for entry in entries:
        name = entry.filename.rstrip("/")
        why = _refused(entry, name) or ("is in the archive twice" if name in seen else None)
        if why is not None:
            raise ValueError(f"{entry.orig_filename[:80]!r} {why}; create the archive again from plain files")
        seen.add(name)
        if not entry.is_dir() and PurePosixPath(name).parts[0] != NOT_OF_THE_USER:
            yield name, entry
    files = {entry.filename for entry in entries if not entry.is_dir()}
    inside = {str(above) for name in seen for above in PurePosixPath(name).parents}
    if both := sorted(files & inside):
        raise ValueError(f"{both[0][:80]!r} is both a file and a folder; create the archive again from plain files")


def _refused(entry: zipfile.ZipInfo, name: str) -> str | None:
    """Return why an entry is not accepted; None where it is."""
    parts = name.split("/")
    kind = stat.S_IFMT(entry.external_attr >> 16)
    wanted = stat.S_IFDIR if entry.is_dir() else stat.S_IFREG
    reasons = (
        (entry.filename != entry.orig_filename.replace(os.sep, "/") or "\\" in entry.orig_filename,
         "is a name with a null byte or a backslash"),
        (not name or name.startswith("/") or (len(name) > 1 and name[1] == ":"), "is not a path within the archive"),
        (any(part in ("", ".", "..") for part in parts), "leads out of its folder, or has an empty part"),
        (not name.isprintable() or len(name.encode(errors="surrogatepass")) > LONGEST_MEMBER_NAME,
         f"has control characters, or more than {LONGEST_MEMBER_NAME} bytes"),
        (len(parts) > DEEPEST_MEMBER, f"lies more than {DEEPEST_MEMBER} folders deep"),
        (kind not in (0, wanted), "is a link or a device"),
        (bool(entry.flag_bits & _ENCRYPTED), "is encrypted"),
        (entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED),
         "is compressed by a method other than deflate"),
        (entry.compress_type == zipfile.ZIP_STORED and entry.file_size != entry.compress_size,
         "is stored uncompressed, but states two sizes"),
        (entry.file_size > MOST_GROWTH * entry.compress_size + FREE_BYTES,
         f"grows from {entry.compress_size} to {entry.file_size} bytes, over {MOST_GROWTH} times"),
    )  # fmt: skip
    return next((why for is_so, why in reasons if is_so), None)


def _require_apart(entries: list[zipfile.ZipInfo]) -> None:
    """Refuse files that share bytes of the archive, by which a small one would unpack to a large one."""
    end = 0
    for entry in sorted(entries, key=lambda e: e.header_offset):
        if entry.header_offset < end:
            raise ValueError(
                f"{entry.filename[:80]!r} overlaps another file; create the archive again from plain files"
            )
        end = entry.header_offset + _LOCAL_HEADER_BYTES + entry.compress_size


def brief_fault(fault: object) -> str:
    """Return what the reader says, in one line of bounded length."""
    return " ".join(f"{fault}".split())[:200] or type(fault).__name__
