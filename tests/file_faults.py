"""Faults of files at a chosen call: the process is killed there, or the system refuses what was asked.

Every call of Python's ``os`` that opens, writes, names, removes or synchronises something below a folder is a point.
"""

import builtins
import io
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

CALLS = ("open", "write", "link", "rename", "replace", "unlink", "remove", "mkdir", "rmdir", "fsync", "truncate")
KILLED = 99
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT
_WHEN = re.compile(rb'"(created_utc|content_sha256)": "[^"]*"')


@dataclass
class FileFaults:
    """The points below some folders, counted; at one of them something happens.

    Attributes
    ----------
    folders
        Where points are.
    at
        Number of the point, from 0; None only counts.
    error_number
        What the system says there (errno); None kills the process before the call, or in the middle of a write.
    """

    folders: tuple[Path, ...]
    at: int | None = None
    error_number: int | None = None
    seen: list[str] = field(default_factory=list)

    @contextmanager
    def active(self) -> Iterator["FileFaults"]:
        """Watch the calls of a ``with`` block."""
        patches = [patch.object(os, name, self._watched(name, getattr(os, name))) for name in CALLS]
        opened = self._watched_open(builtins.open)
        patches += [patch.object(builtins, "open", opened), patch.object(io, "open", opened)]
        for one in patches:
            one.start()
        try:
            yield self
        finally:
            for one in patches:
                one.stop()

    def _watched(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def watched(*arguments: Any, **options: Any) -> Any:
            if self._is_point(name, arguments, options):
                self._meet(name, arguments, call)
            return call(*arguments, **options)

        return watched

    def _watched_open(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def watched(file: Any, mode: str = "r", *arguments: Any, **options: Any) -> Any:
            if not isinstance(file, int) and set(mode) & set("wxa+") and self._is_below(file):
                self._meet("open", (file,), call)
            return call(file, mode, *arguments, **options)

        return watched

    def _is_point(self, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> bool:
        if name == "open" and not arguments[1] & _WRITING:
            return False
        places: list[Any] = [arguments[0]]
        if options.get("dir_fd") is not None:
            places = [options["dir_fd"]]
        if name in ("link", "rename", "replace"):
            places.append(arguments[1])
        return any(self._is_below(place) for place in places)

    def _is_below(self, place: Any) -> bool:
        path = os.readlink(f"/proc/self/fd/{place}") if isinstance(place, int) else os.path.abspath(os.fspath(place))
        return any(Path(path).is_relative_to(folder) for folder in self.folders)

    def _meet(self, name: str, arguments: tuple[Any, ...], call: Callable[..., Any]) -> None:
        number = len(self.seen)
        self.seen.append(name)
        if number != self.at:
            return
        if self.error_number is not None:
            raise OSError(self.error_number, os.strerror(self.error_number), str(arguments[0]))
        if name == "write":
            call(arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
        os._exit(KILLED)


def in_child(work: Callable[[], int]) -> int:
    """Run something in a forked process and return its exit status."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            status = work()
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def contents(*folders: Path) -> dict[str, bytes]:
    """Return path -> bytes of every file, but for the time at which a record was made, and the empty folders."""
    found = {}
    for folder in folders:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                found[str(path)] = _WHEN.sub(b"", path.read_bytes())
            elif not any(path.iterdir()):
                found[str(path)] = b"empty folder"
    return found
