"""A long verb in a process of its own: whatever kills that process, the user gets a sentence and a log."""

import argparse
import contextlib
import io
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from data_schemas.child_process import Child, tell
from data_schemas.errors import DiedError
from finray_calib.cli.options import Progress, progress_bar


@dataclass(frozen=True, slots=True)
class LongWork:
    """What a long verb is about to do, for the sentence that its user reads when its process dies.

    Attributes
    ----------
    words
        What it is called, such as "the press by finite elements".
    kept
        What is kept of it, and what the same command then does.
    beside
        The file beside which its log is put.
    """

    words: str
    kept: str
    beside: Path | None = None


Describe = Callable[[argparse.Namespace], LongWork]


def run_in_own_process(work: LongWork, words: Sequence[str]) -> int:
    """Run ``finray WORDS`` in a process of its own, pass on what it says, and return its exit status.

    Raises
    ------
    DiedError
        The process died; the message names what it did, its log and what to do.
    """
    log = _log_file(work.beside, words[0])
    was_there = log.exists()
    with Child(["finray_calib.cli.own_process"]) as child, _Screen() as screen:
        try:
            status = child.call(
                "finray_calib.cli.own_process:run_verb", {"words": list(words)}, log=log, hear=screen.show
            )
        except DiedError as died:
            raise DiedError(
                f"{work.words} {died}. Its log is {log}. {work.kept}; if that fails again, 'finray doctor' tells what "
                "this machine lacks"
            ) from None
        except KeyboardInterrupt:
            _tidy(log, was_there)
            raise
    _tidy(log, was_there)
    return int(status)


def _log_file(beside: Path | None, verb: str) -> Path:
    """Return a file beside the output, or that of this verb in the folder of temporary files."""
    place = (beside or Path(f"finray-{verb}")).absolute()
    if place.parent.is_dir() and os.access(place.parent, os.W_OK | os.X_OK):
        return place.with_name(f"{place.name.removesuffix('.json').removesuffix('.press')}.log")
    return Path(tempfile.gettempdir()) / f"finray-{verb}-{os.getpid()}.log"


def _tidy(log: Path, was_there: bool) -> None:
    """Remove the log of a verb that did not die, unless an earlier one wrote it."""
    if not was_there:
        log.unlink(missing_ok=True)


class _Screen:
    """Shows what the process tells: results, warnings and how far it is."""

    def __init__(self) -> None:
        self._bars = ExitStack()
        self._bar: Progress | None = None

    def __enter__(self) -> "_Screen":
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.close()

    def show(self, message: Any) -> None:
        """Show one message."""
        if isinstance(message, list):
            if self._bar is not None:
                self._bar(*message)
        elif "bar" in message:
            self._bars.close()
            self._bar = None if message["bar"] is None else self._bars.enter_context(progress_bar(message["bar"]))
        else:
            stream = sys.stdout if message["to"] == "out" else sys.stderr
            stream.write(message["text"])
            stream.flush()


class _Telling(io.TextIOBase):
    """A standard stream whose text the parent process shows."""

    def __init__(self, to: str) -> None:
        self._to = to

    def write(self, text: str) -> int:
        """Send the text."""
        tell({"to": self._to, "text": text})
        return len(text)


def run_verb(words: list[str]) -> int:
    """Be the process of a verb: run it, and tell the parent what it says; warnings of packages go to the log."""
    from finray_calib.cli.main import main

    log = sys.stderr
    logging.lastResort = logging.StreamHandler(log)

    def to_log(message: Any, category: Any, filename: str, lineno: int, file: Any = None, line: Any = None) -> None:
        log.write(warnings.formatwarning(message, category, filename, lineno, line))

    warnings.showwarning = to_log
    sys.argv = ["finray", *words]
    with contextlib.redirect_stdout(_Telling("out")), contextlib.redirect_stderr(_Telling("err")):
        return main(words)
