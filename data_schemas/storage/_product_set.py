"""Products of several files with one commit point: all of them are stored or none, whatever ends the writer.

::

    with ProductSet(record) as products:            # nothing has a name yet
        products.add(page, html)
        write_record(decision, record, origin, products)
    # here all of them have their names

What is added is written under hidden names (``.NAME.TOKEN.finray.part``; a new folder as a hidden folder). When the
block ends, the names are given in the order of :meth:`ProductSet.add`, the commit last: until it has its name, the
set does not count. A hidden set file (``.NAME.finray.set``) in each folder says what is being named; it is locked as
long as the writer lives.

What writers that died left, the next one that writes there removes, and readers never see it: parts and set files
without a lock. Where the commit of a set has no name, the other files of the set that have theirs are leftovers, too,
as long as they still have the content that their writer gave them. Nothing else is touched.

A folder's manifest holds the checksums of all its files in the format of ``sha256sum --check``, and says what no
longer agrees with them. They detect accidents and edits, not forgery: whoever changes a file on purpose can write the
checksums anew.
"""

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Any, Final, Literal, NamedTuple

from data_schemas import RecordError
from data_schemas.errors import naming_file
from data_schemas.storage._foreign_files import files_below, has_file, read_text
from data_schemas.storage._whole_files import (
    PART_ENDING,
    give_name,
    is_ours,
    lock,
    new_token,
    part_name,
    sha256_of,
    short_name,
    sync_folder,
    taken,
    write_all,
    write_bytes,
)

SET_ENDING: Final = ".finray.set"
LONGEST_SET_FILE_BYTES: Final = 1 << 24
_PART = re.compile(r"\..+\.([0-9a-f]{8})" + re.escape(PART_ENDING), re.DOTALL)
_SET = re.compile(r"\..+" + re.escape(SET_ENDING), re.DOTALL)
_DIGEST = re.compile(r"[0-9a-f]{64}")


class _Told(NamedTuple):
    """What a set file says."""

    token: str | None
    commit: str = ""
    commit_part: str = ""
    commit_sha256: str = ""
    files: tuple[tuple[str, str], ...] = ()
    others: tuple[str, ...] = ()

    def is_committed(self, folder: Path) -> bool:
        """Whether the commit got its name: its part is gone, or linked to a name, or the name is there."""
        home = folder.resolve()
        try:
            part = (home / self.commit_part).lstat()
        except OSError:
            return True
        commit = home / self.commit
        return part.st_nlink > 1 or (commit.is_file() and sha256_of(commit) == self.commit_sha256)


def clear_leftovers(folder: Path) -> None:
    """Remove what ended writers left in a folder; files of running ones, and every other file, stay.

    Removed are parts, and files that a set without commit has named already, where they still have the content that
    their writer gave them. What cannot be removed is left.

    Parameters
    ----------
    folder
        Where something is going to be written; it need not exist.
    """
    parts = {name: found[1] for name in _names(folder) if (found := _PART.fullmatch(name)) is not None}
    alive = set()
    # Listed after the parts: the set of each of these is there by now, if its writer lives.
    for name in _names(folder):
        if _SET.fullmatch(name):
            with contextlib.suppress(OSError, RecordError):
                if not _clear_set(folder / name):
                    alive.add(_read_set_file(folder / name).token)
    for name, token in parts.items():
        if token not in alive:
            with contextlib.suppress(OSError, RecordError):
                _clear_part(folder / name)


def refuse_unfinished(path: Path) -> None:
    """Refuse a file of a set whose commit has no name yet, because its writer is at work or died.

    Raises
    ------
    RecordError
        It is one.
    """
    set_file = _unfinished_set_of(path)
    if set_file is not None:
        raise RecordError(
            f"{path}: belongs to products that were not completely stored; wait for the command that writes them, or "
            "run that command again if it was interrupted"
        )


def is_complete(path: Path) -> bool:
    """Return whether a product (a file, or a folder that is one) is there, and is none of a set without commit."""
    return path.exists() and _unfinished_set_of(path) is None


def _unfinished_set_of(path: Path) -> Path | None:
    """Return the set file that names a file and whose commit has no name, if there is one."""
    whole_path = path.absolute()
    for folder in (whole_path.parent, whole_path.parent.parent):
        for name in _names(folder):
            if _SET.fullmatch(name):
                told = _read_set_file(folder / name)
                named = any((folder / file).is_relative_to(whole_path) for file, _ in told.files)
                if named and not told.is_committed(folder):
                    return folder / name
    return None


def _names(folder: Path) -> list[str]:
    """Return the hidden names in a folder that can be listed: those of parts and set files are."""
    try:
        return [name for name in os.listdir(folder) if name[0] == "."]
    except OSError:
        return []


def _read_set_file(path: Path) -> _Told:
    """Return what a set file says; nothing where it is cut off or none."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return _Told(None)
    try:
        return _told_in(handle)
    finally:
        os.close(handle)


def _told_in(handle: int) -> _Told:
    """Return what an open set file says."""
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        return _Told(None)
    content = os.pread(handle, LONGEST_SET_FILE_BYTES, 0)
    lines = [_json_object(line) for line in content.split(b"\n")[:2]]
    token = lines[0].get("token")
    told = _Told(token if isinstance(token, str) else None)
    try:
        return told._replace(
            commit=str(lines[1]["commit"]),
            commit_part=str(lines[1]["commit_part"]),
            commit_sha256=str(lines[1]["commit_sha256"]),
            files=tuple((str(entry["file"]), str(entry["sha256"])) for entry in lines[1]["files"]),
            others=tuple(str(other) for other in lines[1]["others"]),
        )
    except (IndexError, KeyError, TypeError):  # the names had not been begun
        return told


def _json_object(line: bytes) -> Mapping[str, Any]:
    """Return a line's JSON object; an empty one where there is none."""
    try:
        loaded = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return loaded if isinstance(loaded, dict) else {}


def _clear_set(set_file: Path, *, is_other: bool = False) -> bool:
    """Remove the set file of a dead writer and what its set has named; return whether it is gone.

    The set's files in other folders come first: with its parts goes what tells that it has no commit.
    """
    try:
        handle = os.open(set_file, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return True
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode) or lock(handle) is not True:
            return False
        if os.fstat(handle).st_nlink == 0:
            return True
        told = _told_in(handle)
        folder = set_file.parent
        for other in () if is_other else told.others:
            if not _clear_other(folder.resolve() / other, told.token):
                return False
        if told.files and not told.is_committed(folder):
            for file in _named_by(told, folder):
                file.unlink()
            for made in _folders_of(told, folder):
                with contextlib.suppress(OSError):  # something else is in it
                    made.rmdir()
        set_file.unlink()
        return True
    finally:
        os.close(handle)


def _clear_other(set_file: Path, token: str | None) -> bool:
    """Remove what a set has left in another folder; return whether it is gone."""
    if not _SET.fullmatch(set_file.name) or not _clear_set(set_file, is_other=True):
        return False
    for name in _names(set_file.parent):
        found = _PART.fullmatch(name)
        if found is not None and found[1] == token:
            _clear_part(set_file.with_name(name))
    return True


def _named_by(told: _Told, folder: Path) -> Iterator[Path]:
    """Yield the files of a set that have their names and the content that their writer gave them, the last first."""
    for name, sha256 in reversed(told.files):
        inner = PurePosixPath(name)
        if inner.is_absolute() or ".." in inner.parts or not _DIGEST.fullmatch(sha256):
            continue
        path = folder / inner
        if any((folder / above).is_symlink() for above in (inner, *inner.parents[:-1])) or not path.is_file():
            continue
        if sha256_of(path) == sha256:
            yield path


def _folders_of(told: _Told, folder: Path) -> list[Path]:
    """Return the new folders of a set, inner ones first."""
    inner = {above for name, _ in told.files for above in list(PurePosixPath(name).parents)[:-1]}
    plain = [above for above in inner if not above.is_absolute() and ".." not in above.parts]
    return [folder / above for above in sorted(plain, key=lambda path: len(path.parts), reverse=True)]


def _clear_part(path: Path) -> None:
    """Remove a part whose writer is dead."""
    if stat.S_ISDIR(path.lstat().st_mode):
        shutil.rmtree(path)
        return
    handle = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        if stat.S_ISREG(os.fstat(handle).st_mode) and lock(handle) is True and os.fstat(handle).st_nlink > 0:
            path.unlink()
    finally:
        os.close(handle)


# What os.rename says of a folder where the file system cannot rename folders.
NO_FOLDER_RENAME: Final = frozenset(
    {errno.EXDEV, errno.EPERM, errno.EACCES, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS}
)
_TAKEN_FOLDER: Final = frozenset({errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR, errno.EISDIR})


class _Added(NamedTuple):
    """A file of a set: its hidden name, the name that it gets, and its SHA-256."""

    part: Path
    path: Path
    sha256: str


class ProductSet:
    """Several new files that are stored together; a ``with`` block at whose end they get their names.

    Where the block fails, or giving the names, nothing of the set is left.

    Parameters
    ----------
    commit
        What makes the set whole: the file that gets its name last (a record), or a new folder that holds all of it.

    Raises
    ------
    RecordError
        At the beginning: another process writes the same product now. Later: a name is taken; nothing stored is
        overwritten.
    """

    def __init__(self, commit: Path):
        self._commit, self._home, self._token = commit, commit.parent, new_token()
        self._added: list[_Added] = []
        self._set_files: dict[Path, tuple[Path, int]] = {}  # by folder
        self._staged: dict[Path, Path] = {}  # new folder -> its hidden name
        self._given: list[tuple[Path, Path]] = []  # names, and the hidden names before, as they were begun
        self._last: Path | None = None
        self._made: list[Path] = []

    def __enter__(self) -> "ProductSet":
        self._home.mkdir(parents=True, exist_ok=True)
        try:
            self._open_set_file(self._commit)
        except BaseException:
            self._sweep(True)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        is_settled = True
        try:
            if error is None:
                try:
                    self._store()
                except BaseException:
                    is_settled = self._take_back()
                    raise
        finally:
            self._sweep(is_settled)

    def add(self, path: Path, content: bytes, *, same_serves: bool = False) -> Path:
        """Write a file of the set under a hidden name and return the name that it will get.

        Parameters
        ----------
        path
            Its name. A file below the folder that is the commit, or below a folder beside the commit that does not
            exist yet, gets its name together with that folder.
        content
            Its bytes.
        same_serves
            Whether a file of this name that holds the same bytes serves as well (names that carry a checksum).

        Raises
        ------
        RecordError
            The name is taken.
        """
        sha256 = hashlib.sha256(content).hexdigest()
        if any(added.path == path for added in self._added):
            raise RecordError(
                f"{path}: two products of one command would have this name; give each product a different name"
            )
        if path.exists() or path.is_symlink():
            if same_serves and path.is_file() and sha256_of(path) == sha256:
                return path
            raise taken(path)
        part = self._part_of(path)
        with naming_file(path):
            handle = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        self._added.append(_Added(part, path, sha256))
        try:
            write_all(handle, content, path)
        finally:
            os.close(handle)
        return path

    def added_below(self, folder: Path) -> dict[str, str]:
        """Return path from a folder -> SHA-256 of the files of the set that were added so far and will lie below it."""
        below = (added for added in self._added if added.path.is_relative_to(folder))
        return {added.path.relative_to(folder).as_posix(): added.sha256 for added in below}

    def _part_of(self, path: Path) -> Path:
        """Return the hidden name of a file; the folders that it needs are made."""
        top = self._new_folder_of(path)
        if top is not None:
            if top not in self._staged:
                staged = top.with_name(part_name(top.name, self._token))
                staged.mkdir()
                self._staged[top] = staged
            part = self._staged[top] / path.relative_to(top)
            part.parent.mkdir(parents=True, exist_ok=True)
            return part
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.parent not in self._set_files:
            self._open_set_file(path)
        return path.with_name(part_name(path.name, self._token))

    def _new_folder_of(self, path: Path) -> Path | None:
        """Return the folder beside the commit, or the commit itself, that gets its name with `path` in it."""
        below = path.relative_to(self._home).parts if path.is_relative_to(self._home) else ()
        if len(below) < 2 or ".." in below:
            return None
        top = self._home / below[0]
        if top.exists():
            if top == self._commit:
                raise taken(top)
            return None
        return top

    def _open_set_file(self, path: Path) -> None:
        """Create and lock the set file of a folder."""
        set_file = path.with_name(f".{short_name(path.name)}{SET_ENDING}")
        while True:
            clear_leftovers(path.parent)
            try:
                with naming_file(path):
                    handle = os.open(set_file, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666)
            except FileExistsError:
                raise RecordError(
                    f"{path}: another process seems to be writing this file; wait until it ends. If there is no such "
                    f"process, delete {set_file}, which an interrupted process left behind (without file locks, "
                    "finray cannot distinguish such a file from work in progress)"
                ) from None
            if is_ours(handle):
                break
            os.close(handle)
        self._set_files[path.parent] = set_file, handle
        with naming_file(path):
            os.write(handle, json.dumps({"token": self._token}).encode() + b"\n")

    def _store(self) -> None:
        """Give the names, the commit last; what comes before is on the disk by then."""
        commits = [a for a in self._added if a.path.is_relative_to(self._commit)]
        if not commits:
            raise ValueError(f"{self._commit}: is the commit of a set and was not added")
        commit = commits[-1]
        self._last = commit.path
        self._declare(commit)
        for added in self._added:
            if added not in commits:
                self._name(added)
        for folder in self._set_files:
            sync_folder(folder)
        self._name(commit)
        sync_folder(self._home)

    def _declare(self, commit: _Added) -> None:
        """Say in the set files what is going to be named, and have all that was written on the disk."""
        for staged in self._staged.values():
            for folder in sorted((staged, *_folders_in(staged)), reverse=True):
                sync_folder(folder)
        for folder, (_, handle) in self._set_files.items():
            files = [a for a in self._added if self._folder_of(a) == folder]
            told = {
                "commit": _path_from(folder, commit.path),
                "commit_part": _path_from(folder, commit.part),
                "commit_sha256": commit.sha256,
                "files": [{"file": a.path.relative_to(folder).as_posix(), "sha256": a.sha256} for a in files],
                "others": [_path_from(folder, other) for at, (other, _) in self._set_files.items() if at != folder],
            }
            write_all(handle, json.dumps(told).encode() + b"\n", folder)
            sync_folder(folder)

    def _folder_of(self, added: _Added) -> Path:
        """Return the folder whose set file tells of a file."""
        return self._home if self._top_of(added) is not None else added.path.parent

    def _top_of(self, added: _Added) -> Path | None:
        """Return the new folder that a file gets its name with."""
        return next((top for top in self._staged if added.path.is_relative_to(top)), None)

    def _name(self, added: _Added) -> None:
        """Give a file its name, or the new folder that holds it."""
        top = self._top_of(added)
        if top is None:
            self._name_file(added)
        elif not any(path.is_relative_to(top) for path, _ in self._given):
            self._name_folder(top, [a for a in self._added if a.path.is_relative_to(top)])

    def _name_file(self, added: _Added) -> None:
        """Give a file its name."""
        self._given.append((added.path, added.part))
        give_name(added.part, added.path)

    def _name_folder(self, top: Path, inside: list[_Added]) -> None:
        """Give a new folder its name with all that is in it; file by file where folders cannot be renamed."""
        self._given.append((top, self._staged[top]))
        try:
            os.rename(self._staged[top], top)
            return
        except OSError as error:
            if error.errno in _TAKEN_FOLDER or top.exists():
                raise taken(top) from None
            if error.errno not in NO_FOLDER_RENAME:
                raise
        for folder in (top, *(top / f.relative_to(self._staged[top]) for f in sorted(_folders_in(self._staged[top])))):
            folder.mkdir()
            self._made.append(folder)
        for added in inside:
            if added is inside[-1]:
                for folder in reversed(self._made):
                    sync_folder(folder)
                sync_folder(self._home)
            self._name_file(added)
        sync_folder(inside[-1].path.parent)

    def _take_back(self) -> bool:
        """Take back the names that were given, the commit's first; return whether no half set is left."""
        for path, part in reversed(self._given):
            try:
                if not part.exists():
                    path.rename(part)
                elif path.exists() and path.samefile(part):  # it was linked
                    path.unlink()
            except OSError:
                return path in (self._commit, self._last)
        for folder in sorted(self._made, reverse=True):
            with contextlib.suppress(OSError):
                folder.rmdir()
        return True

    def _sweep(self, is_settled: bool) -> None:
        """Remove parts, then set files; where something stays, so does what tells the next run of it."""
        if is_settled:
            with contextlib.suppress(OSError):
                # The commit's part first: without it the set counts as committed, whatever becomes of the rest.
                for added in sorted(self._added, key=lambda a: a.path != self._last):
                    added.part.unlink(missing_ok=True)
                for staged in self._staged.values():
                    if staged.exists():
                        shutil.rmtree(staged)
                # The first one, which knows the others, last.
                for set_file, _ in reversed(self._set_files.values()):
                    set_file.unlink(missing_ok=True)
        for _, handle in self._set_files.values():
            os.close(handle)


def _folders_in(folder: Path) -> list[Path]:
    """Return the folders below a folder."""
    return [path for path in folder.rglob("*") if path.is_dir()]


def _path_from(folder: Path, path: Path) -> str:
    """Return a path as seen from a folder, with both at their real places."""
    return os.path.relpath(path.parent.resolve() / path.name, folder.resolve())


MANIFEST_NAME: Final = "manifest-sha256.txt"
FileState = Literal["missing", "changed", "stale"]
_LINE: Final = re.compile(r"([0-9a-f]{64})  (.+)")


@dataclass(frozen=True, slots=True)
class FileFault:
    """A file that is missing or was changed.

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
    digests = {name: sha256_of(path) for name, path in named.items() if name.split("/")[0] not in skipped}
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
    text = read_text(path, "checksums as 'sha256sum' writes them").removesuffix("\n")
    # a name may hold what else splits lines, such as a form feed
    for number, line in enumerate(text.split("\n") if text else (), 1):
        match = _LINE.fullmatch(line.removesuffix("\r"))
        name = "" if match is None else match[2]
        if match is None or PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts or name in listed:
            raise RecordError(
                f"{path}, line {number}: must contain a SHA-256, two spaces and the path of a file in the folder, "
                "each file only once"
            )
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
        return [FileFault(path, "changed", str(error).removeprefix(f"{path}").lstrip(":, "))], []
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
        now = known.get(file) or sha256_of(file)
    except RecordError as error:
        yield FileFault(file, "changed", str(error).removeprefix(f"{file}: "))
        return
    if now != digest:
        yield FileFault(file, "changed", f"was changed: its SHA-256 is not the one in {MANIFEST_NAME}")


def _is_hidden(path: Path, folder: Path) -> bool:
    """Return whether a file or a folder above it is hidden: parts of files being written, marks of programs."""
    return any(part.startswith(".") for part in path.relative_to(folder).parts)
