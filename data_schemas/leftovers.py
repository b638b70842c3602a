"""What writers that died left in a folder: known, removed by the next one that writes there, kept from readers.

A writer leaves hidden files only (see :mod:`data_schemas.whole_files` and :mod:`data_schemas.product_set`): parts
(``.NAME.TOKEN.finray.part``) and set files (``.NAME.finray.set``), which are locked as long as it lives. A set file
tells which names its set was about to give. Where the set's commit has no name, the other files of the set that have
theirs are leftovers, too, as long as they still have the content that their writer gave them. Nothing else is touched.
"""

import contextlib
import json
import os
import re
import shutil
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final, NamedTuple

from data_schemas.errors import RecordError
from data_schemas.whole_files import PART_ENDING, lock, sha256_of

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
    """Remove what dead writers left in a folder; what a living one writes, and every other file, stays.

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
            f"{path}: belongs to products that were not stored completely; wait for the command that writes them, or "
            "run it again if it was interrupted"
        )


def is_whole(path: Path) -> bool:
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
    """Return the names in a folder that can be listed."""
    try:
        return os.listdir(folder)
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
