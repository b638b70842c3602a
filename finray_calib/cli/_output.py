"""What a command says: sentences for a person, one JSON object for a program, or warnings alone.

Results go to standard output; warnings, progress and questions go to standard error. With ``--json`` standard output
gets one object instead, when the command ends, also where it fails. With ``--quiet`` neither sentences nor progress
are shown. On a terminal, lines are folded at 80 columns; a file or a pipe gets them as they are.
"""

import contextlib
import json
import math
import os
import re
import shlex
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

from data_schemas import FinrayError, system_words
from data_schemas.storage import is_child, progress_sender, tell

Progress = Callable[[int, int, str], None]
WIDTH = 80
LOG_INTERVAL_S = 8.0  # between the lines of a long command whose output goes to a file
AS_JSON, QUIET = "--json", "--quiet"


@dataclass
class _Spoken:
    """What the command that is running has said, and how it speaks."""

    as_json: bool = False
    quiet: bool = False
    text: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    result: dict[str, Any] = field(default_factory=dict)
    written: list[str] = field(default_factory=list)
    error: str | None = None
    open_first: str | None = None
    next: str | None = None
    is_told: bool = False
    command: str = ""


_spoken = _Spoken()


def begin(words: Sequence[str]) -> list[str]:
    """Begin what a command says, and return its words without ``--json`` and ``--quiet``, which stand anywhere."""
    global _spoken
    end = words.index("--") if "--" in words else len(words)
    _spoken = _Spoken(AS_JSON in words[:end], QUIET in words[:end])
    return [word for place, word in enumerate(words) if place >= end or word not in (AS_JSON, QUIET)]


def how_to_speak() -> list[str]:
    """Return the words that make another process of this command speak as this one does."""
    return [AS_JSON] * _spoken.as_json + [QUIET] * _spoken.quiet


def is_for_a_terminal() -> bool:
    """Return whether sentences are read on a terminal."""
    return not (_spoken.as_json or _spoken.quiet) and sys.stdout.isatty()


def is_for_a_program() -> bool:
    """Return whether the numbers are read by a program (``--json``)."""
    return _spoken.as_json


def say(text: str, fold: bool = True) -> None:
    """Tell the user a result; a script for a shell is not folded.

    Raises
    ------
    FinrayError
        Standard output takes nothing more; the rest of the output is dropped.
    """
    if "-0" in text:
        from data_schemas import unsigned_zeros

        text = unsigned_zeros(text)
    _spoken.text += text.split("\n")
    if not (_spoken.as_json or _spoken.quiet):
        _write(_folded(text, fold and sys.stdout.isatty()))


def wrote(path: Path, text: str) -> None:
    """Tell the user that a file or folder is stored, and what it is."""
    _spoken.written.append(os.fspath(path))
    say(f"{path}: {text}")


def give(**values: Any) -> None:
    """Give a program the numbers of the result under stable names that end in their units."""
    _spoken.result.update(values)


def suggest_file(path: Path) -> None:
    """Name the file that a person opens first, in the last line."""
    _spoken.open_first = os.fspath(path)


def suggest_command(*words: str | Path) -> None:
    """Name the command that usually follows, at the end; paths are quoted where a shell needs it."""
    _spoken.next = " ".join(word if isinstance(word, str) else shlex.quote(os.fspath(word)) for word in words)


def warn(text: str) -> None:
    """Tell the user something that is not a result; a full disk behind standard error ends no capture."""
    _spoken.warnings.append(text)
    guide(text)


def fail(text: str) -> None:
    """Tell the user in one line why the command could not do its work."""
    _spoken.error = text
    guide(text)


def guide(text: str) -> None:
    """Tell whoever stands at the rig what happens or what to do, with ``--quiet`` too."""
    with contextlib.suppress(OSError):
        sys.stderr.write(_folded(text, sys.stderr.isatty()) + "\n")


def leave_to_other_process() -> None:
    """Let the process of a long verb, which has said everything, have the last word."""
    _spoken.is_told = True


def finish(command: str, status: int) -> None:
    """End what a command says: where to look, or the JSON object.

    Raises
    ------
    FinrayError
        Standard output takes nothing more.
    """
    if _spoken.is_told:
        return
    _spoken.is_told, _spoken.command = True, command
    if _spoken.as_json:
        _write(json.dumps(spoken(status), ensure_ascii=False, allow_nan=False))
        return
    if _spoken.next is not None:
        say(f"next: {_spoken.next}")
    if _spoken.open_first is not None:
        say(f"look at: {_spoken.open_first}")


def spoken(status: int) -> dict[str, Any]:
    """Return what ``--json`` prints of the command that ended last."""
    from data_schemas import package_version

    return {
        "finray_version": package_version(),
        "command": _spoken.command,
        "exit_status": status,
        "error": _spoken.error,
        "result": plain(_spoken.result),
        "written": _spoken.written,
        "open_first": _spoken.open_first,
        "look_at": _spoken.open_first,  # the name before 0.1.0, for one release
        "next": _spoken.next,
        "warnings": _spoken.warnings,
        "text": [line for line in _spoken.text if line],
    }


def plain(value: Any) -> Any:
    """Return a value of what JSON knows: records and estimates as objects, arrays as lists, no number as null."""
    if hasattr(value, "model_dump"):
        return plain(value.model_dump(exclude={"provenance"}))
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if is_dataclass(value) and not isinstance(value, type):
        return {part.name: plain(getattr(value, part.name)) for part in fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, Path):
        return os.fspath(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Iterable) and not isinstance(value, str):
        return [plain(inner) for inner in value]
    return value


def _write(text: str) -> None:
    """Write a text and a line's end to standard output."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except OSError as error:
        _drop_output()
        if isinstance(error, BrokenPipeError):
            told = "the program that read it has ended (such as 'head' behind a pipe); send the output to a file"
        else:
            told = f"{system_words(error)}; send the output to another file, or to the terminal"
        raise FinrayError(f"standard output cannot be written: {told}. Files already written are complete") from None


def _drop_output() -> None:
    """Let what standard output still holds go nowhere: Python would write it once more at its end, and fail again."""
    with contextlib.suppress(OSError, ValueError):  # it may be closed, or none of the system's
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _folded(text: str, on_terminal: bool) -> str:
    """Return lines that fit a terminal: what goes on is indented or stands below its column, and paths are not cut."""
    if not on_terminal:
        return text
    return "\n".join(_fold(line) for line in text.split("\n"))


def _fold(line: str) -> str:
    """Return one line in as many as it takes."""
    if len(line) <= WIDTH:
        return line
    column = re.match(r"\s*\S+ {2,}(?=\S)", line)
    hanging = " " * (column.end() if column else len(line) - len(line.lstrip()) + 2)
    return textwrap.fill(
        line, WIDTH, subsequent_indent=hanging, break_long_words=False, break_on_hyphens=False,
        replace_whitespace=False, drop_whitespace=True,
    )  # fmt: skip


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """Show a progress bar on standard error while the block runs; in a log file or a pipe, a line now and then."""
    if _spoken.quiet:
        yield lambda done, total, what: None
        return
    if is_child():  # its parent shows it
        tell({"bar": title})
        yield progress_sender()
        tell({"bar": None})
        return
    if not sys.stderr.isatty():
        yield _lines_now_and_then(title)
        return
    with _moving_bar(title) as progress:
        yield progress


@contextmanager
def _moving_bar(title: str) -> Iterator[Progress]:
    """Show a bar whose sign and time move even while nothing is counted."""
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        SpinnerColumn("line"),
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TaskProgressColumn("[progress.percentage]{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=None)

        def update(done: int, total: int, what: str) -> None:
            # a bar that stands at nothing looks broken: it sways until the first step is done
            bar.update(task, completed=done, total=total if done else None, description=f"{title}: {what}")

        yield update


def _lines_now_and_then(title: str) -> Progress:
    """Return what writes how far a long block is, at most one line in :data:`LOG_INTERVAL_S`."""
    last_s = time.monotonic()

    def update(done: int, total: int, what: str) -> None:
        nonlocal last_s
        if time.monotonic() - last_s >= LOG_INTERVAL_S:
            last_s = time.monotonic()
            guide(f"{title}: {what} ({done} of {total})")

    return update
