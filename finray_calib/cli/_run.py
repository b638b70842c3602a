"""What every verb needs to run: shared options, files it may write, interruption and a process of its own.

A verb names its inputs by their SHA-256 and never overwrites a file. Ctrl-C, SIGTERM and a closed terminal end a
capture cleanly, with a word on how to go on. A long verb runs in a process of its own: whatever kills that process, the
user gets a sentence and a log.
"""

import argparse
import contextlib
import io
import logging
import math
import os
import re
import shlex
import signal
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast

from data_schemas import FinrayError, ProcessDiedError, RecordError, SimulateError
from data_schemas import naming as naming
from data_schemas.storage import Child, given_path, tell
from finray_calib.cli._output import AS_JSON, QUIET, how_to_speak, leave_to_other_process
from finray_calib.cli._output import Progress as Progress
from finray_calib.cli._output import progress_bar as progress_bar
from finray_calib.cli._output import say as say
from finray_calib.cli._output import warn as warn

if TYPE_CHECKING:
    from types import ModuleType

    from data_schemas import FingerDesign, PlainSensor
    from sim.optics import Preference


LONGEST_NAME = 80
DEFAULT_INCREMENTS = 4
DEFAULT_SEED = 1


def add_out(parser: argparse.ArgumentParser, default: str) -> None:
    """Add ``--out``; stored files are never overwritten."""
    parser.add_argument("--out", type=Path, metavar="PATH", help=f"where to write (default: {default}); must be new")


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add ``--seed``; the same seed gives the same numbers."""
    parser.add_argument(
        "--seed", type=_whole_number, default=DEFAULT_SEED, metavar="N",
        help=f"random seed (default: {DEFAULT_SEED})",
    )  # fmt: skip


def add_engine(parser: argparse.ArgumentParser, *, is_scalar_enough: bool = True) -> None:
    """Add ``--engine``; what needs paths that only a compiled renderer traces has no scalar one."""
    scalar = ["scalar"] if is_scalar_enough else []
    parser.add_argument(
        "--engine", choices=["auto", "llvm", *scalar, "cuda"], default="auto",
        help="renderer: compiled for the processor (llvm) or for an NVIDIA GPU (cuda)"
        + (", or not compiled (scalar)" if scalar else "")
        + "; auto never takes the GPU (default: auto)",
    )  # fmt: skip


def whole_number(least: int, most: int, *, even: bool = False) -> Callable[[str], int]:
    """Return what parses a whole number within bounds; of paths it is even, as each half of a picture takes half."""

    def parse(text: str) -> int:
        if not text.isdecimal() or not least <= int(text) <= most or (even and int(text) % 2):
            kind = "an even whole number" if even else "a whole number"
            raise argparse.ArgumentTypeError(f"{text!r} must be {kind} from {least} to {most}")
        return int(text)

    return parse


def number_within(what: str, bounds: tuple[float, float], *, above: bool = False) -> Callable[[str], float]:
    """Return what parses a number within bounds, such as "a force in N", or above the lower one."""
    least, most = bounds

    def parse(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not least <= number <= most or (above and number == least):
            allowed = f"above {least:g} and at most {most:g}" if above else f"of {least:g} to {most:g}"
            raise argparse.ArgumentTypeError(f"{text!r} must be {what} {allowed}")
        return number

    return parse


increment_count: Final = whole_number(1, 1000)
path_count: Final = whole_number(2, 1_000_000, even=True)


def _whole_number(text: str) -> int:
    """Parse a seed."""
    try:
        seed = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number") from None
    if not 0 <= seed < 2**63:
        raise argparse.ArgumentTypeError(f"{seed} is out of range; give 0 to 2^63 - 1")
    return seed


def add_paint(
    parser: argparse._ActionsContainer, what: str = "paint calibration of a wall", dest: str = "paint"
) -> None:
    """Add ``--paint``, given once for each wall; read it with :func:`paint_files`."""
    parser.add_argument(
        "--paint", dest=dest, action="append", default=[], type=_paint_file, metavar="COLOUR=FILE",
        help=f"{what}: --paint red=FILE --paint green=FILE",
    )  # fmt: skip


def _paint_file(text: str) -> tuple[str, Path]:
    """Parse COLOUR=FILE."""
    colour, separator, file = text.partition("=")
    if not separator or colour not in {"red", "green"} or not file:
        raise argparse.ArgumentTypeError(f"{text!r} must be red=FILE or green=FILE")
    return colour, given_path(file, "--paint")


def paint_files(arguments: argparse.Namespace, without: str = "", dest: str = "paint") -> dict[str, Path]:
    """Return colour -> file of ``--paint``: both colours, or none where `without` says what stands in then."""
    given: list[tuple[str, Path]] = getattr(arguments, dest)
    files = dict(given)
    if len(files) < len(given):
        raise SimulateError("--paint: a colour is given twice; give one file for red and one for green")
    if len(files) == 1 and without:
        raise SimulateError(
            f"--paint: only one of the two walls is given; give both red=FILE and green=FILE, or neither for {without}"
        )
    return files


def add_paints_as_given(parser: argparse._ActionsContainer) -> None:
    """Add the option that accepts paints which :func:`sim.experiments.require_paints_in_order` takes to be swapped."""
    parser.add_argument(
        "--paints-as-given", action="store_true",
        help="confirm that the paint of the red wall is meant to emit at shorter wavelengths than that of the green "
            "wall",
    )  # fmt: skip


def both_paint_files(arguments: argparse.Namespace) -> dict[str, Path]:
    """Return the files of ``--paint``, red and green."""
    from finray_calib import finger_design

    files = paint_files(arguments)
    for colour in ("red", "green"):
        if colour not in files:
            finger_design(arguments.design)  # a mistake in the design is told first
            raise SimulateError(f"the {colour} wall has no paint; give --paint red=FILE and --paint green=FILE")
    return files


def working_engine(preference: "Preference") -> "Preference":
    """Return a renderer that works here, and tell when another one than usual is taken because something is missing."""
    from sim.optics import choose_variant

    choice = choose_variant(preference)
    if choice.fell_back:
        warn(f"{choice.variant} renders: {choice.note}")
        return "scalar"
    return preference


def open_engine(preference: "Preference", threads: int | None = None) -> "ModuleType":
    """Open the renderer of :func:`working_engine`, by default with a thread for each processor."""
    from sim.optics import choose_variant, open_renderer

    return open_renderer(choose_variant(working_engine(preference)), threads)


def command_line() -> str:
    """Return the command that is running, for the provenance of what it writes."""
    return shlex.join(["finray", *(word for word in sys.argv[1:] if word not in (AS_JSON, QUIET))])


def file_name(name: str) -> str:
    """Return a paint's or finger's name as a plain file name: ASCII letters, digits and ``_ . ( ) + -``, at most 80.

    Other characters become "-". A name never starts with a dot, which would hide the file or leave the folder, nor
    with a dash, which the next command would take for an option; what is empty then is "unnamed".
    """
    return re.sub(r"[^A-Za-z0-9_.()+-]", "-", name).lstrip(".-")[:LONGEST_NAME] or "unnamed"


def distinct_file_names(names: Iterable[str]) -> dict[str, str]:
    """Return each name with its plain file name; names whose file names would be one get a part of their own."""
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in dict.fromkeys(names):
        plain, number = file_name(name), 2
        # some file systems do not tell capitals from small letters
        while plain.casefold() in taken:
            plain, number = f"{file_name(name)[: LONGEST_NAME - 6]}-{number}", number + 1
        taken.add(plain.casefold())
        found[name] = plain
    return found


ENDINGS = {
    ".json": "must be a record: choose an --out that ends in .json",
    ".toml": "must be a TOML file: choose an --out that ends in .toml",
    ".html": "must be a page: choose a --report that ends in .html",
}
"""Ending of a name -> what is wrong with a name that has another one, and what to do."""


def require_new(path: Path, ending: str = "") -> Path:
    """Return `path` if nothing is there yet and its name ends so, found before any work is done.

    What dead writers left there is removed.
    """
    from data_schemas.storage import clear_leftovers

    clear_leftovers(path.parent)
    if path.exists():
        raise RecordError(f"{path}: exists already and is not overwritten; choose another --out or move it away")
    return require_place(require_ending(path, ending) if ending else path)


def require_ending(path: Path, ending: str) -> Path:
    """Return `path` if its name ends as that of its kind of file: .json, .toml or .html."""
    if path.suffix.lower() != ending:
        raise RecordError(f"{path}: {ENDINGS[ending]}")
    return path


def require_new_session(path: Path) -> Path:
    """Return the folder of a session if nothing is there, or only what a capture left that was killed as it began."""
    from rigs.capture import is_unstarted

    return require_place(path) if is_unstarted(path) else require_new(path)


def new_page_beside(record: Path) -> Path:
    """Return the name of the page beside a record, FILE.html for FILE.json, if nothing is there yet."""
    return require_new(record.with_suffix(".html"))


def require_place(path: Path) -> Path:
    """Return `path` if its nearest existing folder can be written to."""
    above = next(folder for folder in path.absolute().parents if folder.exists())
    if not above.is_dir():
        raise RecordError(f"{path}: cannot be written, because {above} is not a folder; choose another --out")
    if not os.access(above, os.W_OK | os.X_OK):
        raise RecordError(
            f"{path}: cannot be written, because the folder {above} is not writable; choose another --out, or change "
            "the permissions of the folder"
        )
    return path


def require_folder(path: Path) -> Path:
    """Return `path` if it is a folder, or one can be made there."""
    if path.exists() and not path.is_dir():
        raise RecordError(f"{path}: is a file, but a folder is to be written there; choose another --out")
    return require_place(path)


Designed = TypeVar("Designed", bound="FingerDesign | PlainSensor")


def with_files_found_from(place: Path | None, design: Designed, folder: Path) -> Designed:
    """Return a design of one folder whose files are found from another, where its TOML is written; None: from all."""
    if place is not None and place.resolve() == folder.resolve():
        return design
    named = {"camera": ("calibration", "response"), "indenter": ("file",), "surface": ("file",)}
    parts = {}
    for table, fields in named.items():
        part = getattr(design, table, None)
        files = {field: getattr(part, field, None) for field in fields}
        kept = {field: file for field, file in files.items() if file not in (None, "ideal", "assumed")}
        if part is not None and kept:
            whole = {field: str((folder / file).absolute()) for field, file in kept.items()}
            parts[table] = part.model_copy(update=whole)
    return cast("Designed", design.model_copy(update=parts))


def input_digests(paths: Iterable[Path]) -> dict[str, str]:
    """Return path as given -> SHA-256 of the bytes that were read; names alone collide (red/paint.json, green/...)."""
    from data_schemas import digest_of_input

    return {path.as_posix(): digest_of_input(path) for path in paths}


@contextmanager
def interruptible(out: Path) -> Iterator[None]:
    """Let SIGTERM and a closed terminal end a capture as Ctrl-C does, and say how to go on."""
    from data_schemas.storage import MANIFEST_NAME
    from rigs.capture import JOURNAL_NAME, OtherCaptureError

    with ended_by_signals():
        try:
            yield
        except OtherCaptureError:
            raise  # what the folder holds is not of this capture, which could not be resumed now
        except (KeyboardInterrupt, FinrayError, OSError):
            if (out / JOURNAL_NAME).exists() and not (out / MANIFEST_NAME).exists():
                again = shlex.join(["finray", "capture", "--resume", os.fspath(out)])
                warn(f"{out}: holds what was captured so far; continue with: {again}")
            raise


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let SIGTERM and a closed terminal end a block as Ctrl-C does."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


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
    ProcessDiedError
        The process died; the message names what it did, its log and what to do.
    """
    log = _log_file(work.beside, words[0])
    was_there = log.exists()
    with Child(["finray_calib.cli._run"]) as child, _Screen() as screen:
        try:
            terminals = [sys.stdout.isatty(), sys.stderr.isatty()]
            job = {"words": [*words, *how_to_speak()], "terminals": terminals}
            status = child.call("finray_calib.cli._run:run_verb", job, log=log, hear=screen.show)
        except ProcessDiedError as died:
            raise ProcessDiedError(
                f"{work.words} {died}. Its log is {log}. {work.kept}. If it fails again, run 'finray doctor' to see "
                "what this machine lacks"
            ) from None
        except KeyboardInterrupt:
            _tidy(log, was_there)
            raise
    _tidy(log, was_there)
    leave_to_other_process()
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

    def __init__(self, to: str, is_terminal: bool) -> None:
        self._to, self._is_terminal = to, is_terminal

    def isatty(self) -> bool:
        """Return whether the parent shows it on a terminal."""
        return self._is_terminal

    def write(self, text: str) -> int:
        """Send the text."""
        tell({"to": self._to, "text": text})
        return len(text)


def run_verb(words: list[str], terminals: list[bool]) -> int:
    """Be the process of a verb: run it, and tell the parent what it says; warnings of packages go to the log.

    Parameters
    ----------
    words
        Words of the command after ``finray``.
    terminals
        Whether standard output and standard error of the parent are terminals.
    """
    from finray_calib.cli.main import main

    log = sys.stderr
    logging.lastResort = logging.StreamHandler(log)

    def to_log(message: Any, category: Any, filename: str, lineno: int, file: Any = None, line: Any = None) -> None:
        log.write(warnings.formatwarning(message, category, filename, lineno, line))

    warnings.showwarning = to_log
    sys.argv = ["finray", *words]
    out, err = (_Telling(to, on_terminal) for to, on_terminal in zip(("out", "err"), terminals, strict=True))
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        return main(words)
