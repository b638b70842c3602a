"""A command that is killed, or refused by the system, at each of its calls that touch files below its output folders.

What takes time is computed once and replayed; every try is a forked process of its own, and so is its rerun.
"""

import errno
import hashlib
import io
import json
import pickle
import re
import shlex
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

from data_schemas.storage._product_set import is_complete
from finray_calib.cli.main import main
from tests.file_faults import KILLED, FileFaults, contents, in_child

ERRORS = (errno.ENOSPC, errno.EIO, errno.EACCES)
OWN = ("mine.html", ".mine.part", ".b.12345678.part", "e.0123456789ab.npz", ".x.set", "z.finray.set")
"""Files of the user that look like a product or like what a writer leaves."""


@dataclass(frozen=True, slots=True)
class Command:
    """A verb that writes several files.

    Attributes
    ----------
    words
        Its arguments; ``{o}`` and ``{e}`` are two folders to write into.
    commit
        What has its name last, below ``{o}``.
    replayed
        "module:function" of what takes time.
    steps
        Parts of names of files that are products by themselves and stay when the command is interrupted.
    again
        Exit status of the same command where everything is stored already: 2, or 0 of what grows and is written anew.
    """

    words: str
    commit: str
    replayed: tuple[str, ...] = ()
    steps: tuple[str, ...] = ()
    again: int = 2


class Replay:
    """A function whose results are kept, by its arguments."""

    def __init__(self, function: Callable[..., Any]):
        self._function = function
        self._results: dict[str, Any] = {}

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        parts = [_digest(part) for part in (*arguments, *sorted(options.items()))]
        key = " ".join(parts)
        if key not in self._results:
            self._results[key] = self._function(*arguments, **options)
        return self._results[key]


def _digest(part: Any) -> str:
    """Return what tells an argument from others of its kind, as far as its bytes can."""
    try:
        return hashlib.sha256(pickle.dumps(part)).hexdigest()
    except (pickle.PicklingError, TypeError, AttributeError):
        return type(part).__name__


@contextmanager
def replaying(names: Sequence[str]) -> Iterator[None]:
    """Replay functions of modules for a ``with`` block."""
    with ExitStack() as stack:
        for name in names:
            module, _, function = name.partition(":")
            owner = import_module(module)
            stack.enter_context(patch.object(owner, function, Replay(getattr(owner, function))))
        yield


def fresh_folders(*folders: Path) -> dict[str, bytes]:
    """Make folders anew, with files of the user, and return what lies in them."""
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name in OWN:
            (folder / name).write_bytes(b"the user's own")
    return products(*folders)


@dataclass
class Tries:
    """One command, tried again and again in fresh folders that hold files of the user already."""

    command: Command
    top: Path
    ended: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.here, self.there = self.top / "here", self.top / "there"
        words = self.command.words.format(o=self.here, e=self.there)
        self._words = shlex.split(words)

    def fresh(self) -> dict[str, bytes]:
        """Make the folders anew and return what lies in them."""
        return fresh_folders(self.here, self.there)

    def run(self, faults: FileFaults | None = None) -> tuple[int, str]:
        """Run the command in a forked process; return its exit status and what it said on standard error."""
        said = self.top / "said"

        def work() -> int:
            out, err = io.StringIO(), io.StringIO()
            with patch.object(sys, "argv", ["finray", *self._words]), redirect_stdout(out), redirect_stderr(err):
                if faults is None:
                    status = main(self._words)
                else:
                    with faults.active():
                        status = main(self._words)
            said.write_text(err.getvalue())
            return status

        said.write_text("")
        return in_child(work), said.read_text()

    def count(self) -> list[str]:
        """Run without faults in this process, which computes what will be replayed; return the points."""
        self.fresh()
        faults = FileFaults((self.here, self.there))
        with (
            patch.object(sys, "argv", ["finray", *self._words]),
            redirect_stdout(io.StringIO()),
            redirect_stderr(io.StringIO()) as err,
            faults.active(),
        ):
            assert main(self._words) in (0, 1), err.getvalue()
        self.whole = products(self.here, self.there)
        return faults.seen

    def try_all(self, error_numbers: Sequence[int | None], every: int = 1) -> Counter[str]:
        """Try every point with a kill (None) and errors, check what is left and what a rerun makes of it; count.

        Raises
        ------
        AssertionError
            Something stored was harmed, a half set passes for whole, a rerun does not complete, or something stays.
        """
        points = self.count()
        self.points = len(points)
        assert self.points > 5
        for error_number in error_numbers:
            for number in range(0, len(points), every):
                self._try(number, error_number, points[number])
        return self.ended

    def _try(self, number: int, error_number: int | None, call: str) -> None:
        """Try one point."""
        what = f"{self.command.words}: {call} (point {number}), {error_number and errno.errorcode[error_number]}"
        before = self.fresh()
        status, said = self.run(FileFaults((self.here, self.there), number, error_number))
        kind = "kill" if error_number is None else errno.errorcode[error_number]
        assert status in ((KILLED,) if error_number is None else (0, 1, 2)), f"{what}: {status} {said}"
        assert "Traceback" not in said, what
        now = products(self.here, self.there)
        assert before.items() <= now.items(), what
        is_there = all(now.get(path) == content for path, content in self.whole.items())
        assert is_complete(self.here / self.command.commit) == is_there, what
        if not is_there:
            halves = [p for p in map(Path, now.keys() & self.whole.keys() - before.keys()) if not self._is_step(p)]
            assert not any(is_complete(path) for path in halves if path.suffix == ".json"), what
            self.ended[f"{kind}, half set named"] += bool(halves)
        self.ended[f"{kind}, {'whole' if is_there else 'absent'}"] += 1
        assert not (is_there and status == 2), f"{what}: told {said}, but it is stored"
        again, said = self.run()
        assert again == (self.command.again if is_there else 0), f"{what}: the rerun says {said}"
        after = products(self.here, self.there)
        assert after == self.whole, f"{what}: {sorted(after.keys() ^ self.whole.keys())}"

    def _is_step(self, path: Path) -> bool:
        """Whether a file is a product by itself."""
        return any(step in str(path) for step in self.command.steps)


def products(*folders: Path) -> dict[str, bytes]:
    """Return path -> bytes of all files; without the time of their origin; of records without seal and increments."""
    found = contents(*folders)
    for path in found:
        if path.endswith(".json") and ".finray.part/" not in path:
            stored = json.loads(Path(path).read_bytes())
            stored.pop("content_sha256", None)
            if "companions" in stored:  # their checksums hold the time, too; a reader checks them
                stored["companions"] = sorted(stored["companions"])
            origin = (stored.get("record") or {}).get("provenance") or {}
            origin.pop("created_utc", None)
            inputs = origin.get("input_sha256", {})
            origin["input_sha256"] = {name: inputs[name] for name in inputs if ".increments/" not in name}
            found[path] = json.dumps(stored).encode()
        elif path.endswith(".html"):
            found[path] = re.sub(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", b"TIME", found[path])
    return found
