"""The journal of a session: one JSON object per line, on disk before the next step begins.

Each line ends with its link: the SHA-256 of the link before it and of the rest of the line. A line that was changed,
removed or moved breaks the chain. This detects accidents and edits, not forgery: whoever changes a journal on purpose
can compute all links anew.
"""

import contextlib
import fcntl
import hashlib
import json
import os
import re
import shlex
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple

from data_schemas import CaptureError
from data_schemas.storage import LARGEST_TEXT_BYTES, parse_json, read_bytes
from rigs import CallThread, Clock, NoAnswerError
from rigs.transports import Fault, fault_listener

JOURNAL_NAME = "journal.jsonl"
DISK_WITHIN_S: Final = 60.0
"""A disk that hangs (a network folder whose server is gone) must not keep a capture waiting with its lights on."""
CLOSE_WITHIN_S: Final = 1.0
FAULT_EVENT: Final = "fault"
_SPECIAL_IN_DOUBLE_QUOTES: Final = re.compile(r"""["$`\\!]""")
_LINKED: Final = re.compile(rb'(\{.*), "link": "([0-9a-f]{64})"\}', re.DOTALL)


class OtherCaptureError(CaptureError):
    """Another capture writes into the folder."""


class _Line(NamedTuple):
    """A line to be written: event, time of day, monotonic time (s) and the rest."""

    event: str
    utc: str
    monotonic_s: float
    what: Mapping[str, Any]


class _FaultLines:
    """Faults that no line of the journal has told yet; all of them are of one exchange. Threads may take them.

    Each line says how many faults it stands for (``times``), and its time is that of the last of them.
    """

    def __init__(self) -> None:
        self._turn, self._last, self._times, self._spent_s = threading.Lock(), Fault("", "", 0, 0.0), 0, 0.0
        self._utc, self._at_s = "", 0.0

    def belongs(self, fault: Fault) -> bool:
        """Whether a fault is of the exchange whose faults were counted last."""
        return fault.attempt > 1 and fault.device == self._last.device

    def count(self, fault: Fault, utc: str, at_s: float) -> None:
        """Count a fault."""
        with self._turn:
            self._last, self._times, self._spent_s = fault, self._times + 1, self._spent_s + fault.spent_s
            self._utc, self._at_s = utc, at_s

    def taken(self) -> tuple[_Line, ...]:
        """Return the line about them, if there are any; they are told with it."""
        with self._turn:
            if not self._times:
                return ()
            told = self._last._replace(spent_s=round(self._spent_s, 3))._asdict() | {"times": self._times}
            self._times, self._spent_s = 0, 0.0
            return (_Line(FAULT_EVENT, self._utc, self._at_s, told),)


class Journal:
    """Append-only log of a session; a ``with`` block that closes with the outcome ("done" or the error).

    Threads may write. The file is locked while it is open: one capture writes into a folder at a time.

    Parameters
    ----------
    folder
        Folder of the session.
    clock
        Where the time of each line comes from.
    resumed
        Whether the journal of an interrupted session goes on; else it must not exist.
    told
        Called with the event and the rest of every line that is on the disk.

    Raises
    ------
    OtherCaptureError
        The folder holds a journal already, or another capture writes into it now.
    """

    def __init__(
        self,
        folder: Path,
        clock: Clock,
        *,
        resumed: bool = False,
        told: Callable[[str, Mapping[str, Any]], None] = lambda event, what: None,
    ):
        self._clock, self._turn, self._link, self._told = clock, threading.Lock(), b"", told
        self._path = folder / JOURNAL_NAME
        # a journal appears under its name with its first line whole: an interrupted session always says how it began
        self._nameless = None if resumed else folder / f".{JOURNAL_NAME}.part"
        if not resumed:
            self._require_new()
        self._file = (self._nameless or self._path).open("a", encoding="utf-8")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            raise OtherCaptureError(
                f"{self._path}: another capture is writing into this folder; wait until it ends"
            ) from None
        if self._nameless is not None:
            try:
                self._require_new()  # again: the lock of a file that got its name meanwhile is ours too
            except OtherCaptureError:
                self._file.close()
                raise
            self._file.truncate(0)
        else:
            self._link = next((line.link.encode() for line in reversed(linked_lines(folder))), b"")
            if not _ends_with_newline(self._path):
                self._file.write("\n")  # an interrupted line stays as it is; readers pass over it
        self._disk, self._is_closed, self._faults = CallThread("journal"), False, _FaultLines()

    def append(self, event: str, **what: Any) -> None:
        """Write one line (start, step, frame, note or stop) and wait until it is on the disk.

        Faults that wait to be told are written before it.

        Raises
        ------
        CaptureError
            The disk does not take it.
        """
        with self._turn:
            lines = self._put(*self._faults.taken())
            lines += self._put(_Line(event, *self._now(), what))
        for line in lines:
            self._told(line.event, line.what)

    def note_fault(self, fault: Fault) -> None:
        """Count a fault; of one exchange the first, second, fourth, eighth and so on are written at once.

        A port that stays away fails five times a second. The others are written before the next line of any kind.

        Raises
        ------
        CaptureError
            The disk does not take them.
        """
        if not self._faults.belongs(fault):
            self.write_faults()
        self._faults.count(fault, *self._now())
        if fault.attempt & (fault.attempt - 1) == 0:  # a power of two
            self.write_faults()

    def write_faults(self) -> None:
        """Write the faults that were counted since the last line, if there are any."""
        with self._turn:
            lines = self._put(*self._faults.taken())
        for line in lines:
            self._told(line.event, line.what)

    def _now(self) -> tuple[str, float]:
        return self._clock.utc(), round(self._clock.monotonic_s(), 3)

    def _put(self, *lines: _Line) -> tuple[_Line, ...]:
        """Have lines on the disk, and return them."""
        for event, utc, monotonic_s, what in lines:
            if self._is_closed:  # a thread that the disk held back
                raise CaptureError(f"{self._path}: is closed, because the capture has ended")
            line = {"event": event, "utc": utc, "monotonic_s": monotonic_s, **what}
            self._put_text(json.dumps(line, ensure_ascii=False)[:-1])
        return lines

    def _put_text(self, text: str) -> None:
        """Have a line without its closing brace on the disk, with its link."""
        # set before the line is written: one that the disk refuses stays in the buffer, and comes before the next
        link = self._link = _link_of(self._link, text.encode())
        try:
            self._disk.call(lambda: self._write(f'{text}, "link": "{link.decode()}"}}\n'), DISK_WITHIN_S)
        except NoAnswerError:
            raise disk_hangs(self._path, self._path.parent) from None
        except OSError as error:
            resume = f"run '{resume_command(self._path.parent)}'"
            raise CaptureError(
                f"{self._path}: cannot be written ({error.strerror}); free space or repair the disk, then "
                f"{resume if self._nameless is None else 'begin the capture again (nothing was captured yet)'}"
            ) from None

    def _write(self, line: str) -> None:
        """Have a line on the disk."""
        self._file.write(line)
        self._file.flush()
        os.fsync(self._file.fileno())
        if self._nameless is not None:
            self._nameless.rename(self._path)
            self._nameless = None
            _sync_folder(self._path.parent)

    def __enter__(self) -> "Journal":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        outcome = "done" if error is None else f"{type(error).__name__}: {error}"
        try:
            if self._nameless is None:  # else nothing began
                self.append("stop", outcome=outcome)
        except CaptureError:
            if error is None:
                raise
            # what ended the capture says more than a last line that finds no space
        finally:
            self._is_closed = True
            # an error is passed over: what is left of a line that found no space
            self._disk.close(self._file.close, CLOSE_WITHIN_S)

    def _require_new(self) -> None:
        """Refuse a folder that has a journal."""
        if self._path.exists():
            raise OtherCaptureError(
                f"{self._path}: exists already, so another capture writes into this folder; choose another --out"
            )


LEAST_HEALING_S: Final = 300.0
HEALING_SHARE: Final = 0.5


def healing_s(typical_s: float) -> float:
    """Return how long faults may hold a session up (s): half of its typical duration, five minutes at least."""
    return max(LEAST_HEALING_S, HEALING_SHARE * typical_s)


class StatedTimes(NamedTuple):
    """How long a session takes (s), without the time that people need, and how long faults may hold it up."""

    typical_s: float
    longest_s: float
    healing_s: float


class HealingTimeError(CaptureError):
    """Faults have held a session up for longer than it stated."""


class HealingTime:
    """The time that faults have cost a session.

    Parameters
    ----------
    most_s
        More than that ends the session.
    folder
        Folder of the session, for the message.
    """

    def __init__(self, most_s: float, folder: Path) -> None:
        self._most_s, self._folder = most_s, folder
        self.lost_s = 0.0

    def lose(self, spent_s: float) -> None:
        """Count time.

        Raises
        ------
        HealingTimeError
            It is used up.
        """
        self.lost_s += spent_s
        if self.lost_s > self._most_s:
            raise HealingTimeError(
                f"{self._folder}: recovery from faults has delayed the session by {self.lost_s:.0f} s, but at most "
                f"{self._most_s:.0f} s are allowed; repair the device that {JOURNAL_NAME} names most often, then run "
                f"'{resume_command(self._folder)}'"
            )


_HEALING: ContextVar[HealingTime | None] = ContextVar("time that faults have cost", default=None)


class Began(NamedTuple):
    """When something began that may have to be done again, and what faults had cost until then (s)."""

    at_s: float
    lost_s: float


def beginning() -> Began:
    """Return that something begins now."""
    healing = _HEALING.get()
    return Began(time.monotonic(), 0.0 if healing is None else healing.lost_s)


def lost_since(began: Began) -> None:
    """Count all time since then as lost, once.

    Raises
    ------
    HealingTimeError
        The session has lost more than it stated.
    """
    if (healing := _HEALING.get()) is not None:
        healing.lose(max(time.monotonic() - began.at_s - (healing.lost_s - began.lost_s), 0.0))


@contextmanager
def faults_noted(journal: Journal, folder: Path, most_s: float = LEAST_HEALING_S) -> Iterator[None]:
    """Note the faults after which an exchange is repeated, for a ``with`` block; end it when they cost too much."""
    healing = HealingTime(most_s, folder)

    def note(fault: Fault) -> None:
        journal.note_fault(fault)
        healing.lose(fault.spent_s)

    token = _HEALING.set(healing)
    try:
        with fault_listener(note):
            yield
    except BaseException:
        with contextlib.suppress(CaptureError):  # what ended the capture says more than a line that finds no space
            journal.write_faults()
        raise
    finally:
        _HEALING.reset(token)
    journal.write_faults()


def fault_notes(folder: Path) -> tuple[str, ...]:
    """Return what the journal of a session says about faults that did not stop it; nothing where there were none."""
    lines = read_journal(folder)
    faults = [line for line in lines if line["event"] == FAULT_EVENT]
    times = Counter[str]()
    for line in faults:
        times[str(line["device"])] += int(line.get("times", 1))
    counted = [f"{name} {number}" for name, number in times.items()]
    retaken = sum(line["event"] == "refused" for line in lines)
    lost = sum(line["event"] == "light lost" for line in lines)
    said = [f"{_were(times.total(), 'message', ' to devices')} repeated ({', '.join(counted)})"] if faults else []
    said += [f"{_were(retaken, 'frame')} taken again"] if retaken else []
    said += [f"a light went off or stopped answering, number of times: {lost}"] if lost else []
    aside = sum(int(line["frames"]) for line in lines if line["event"] == "set aside")
    repaired = f"{_were(aside, 'frame', ' from before a repair')} set aside and taken again"
    notes = (f"{repaired}; {JOURNAL_NAME} gives the reason",) if aside else ()
    if not said:
        return notes
    spent_s = sum(float(line["spent_s"]) for line in faults)
    return (
        *notes,
        f"faults that did not stop the session: {', '.join(said)}; {JOURNAL_NAME} lists them ({spent_s:.1f} s lost)",
    )


def _were(number: int, noun: str, which: str = "") -> str:
    """Return how many things, and the verb that follows."""
    return f"{number} {noun}{which} was" if number == 1 else f"{number} {noun}s{which} were"


def resume_command(session: Path) -> str:
    """Return the command that continues a session, for a sentence that has it in single quotes."""
    name = os.fspath(session)
    plain = shlex.quote(name)
    in_double = plain != name and not _SPECIAL_IN_DOUBLE_QUOTES.search(name)
    return "finray capture --resume " + (f'"{name}"' if in_double else plain)


def not_written(path: Path, error: OSError, session: Path) -> CaptureError:
    """Return the error of a frame that the disk refuses."""
    return CaptureError(
        f"{path}: cannot be written ({error.strerror}); free space or repair the disk, then run "
        f"'{resume_command(session)}'"
    )


def disk_hangs(path: Path, session: Path) -> CaptureError:
    """Return the error of a file of a session that the disk does not take, and does not refuse either."""
    return CaptureError(
        f"{path}: the disk does not respond (nothing was written for {DISK_WITHIN_S:g} s or more); check the disk, or "
        f"the server of the network folder, then run '{resume_command(session)}'"
    )


@dataclass(frozen=True, slots=True)
class LinkedLine:
    """A line of a journal.

    Attributes
    ----------
    number
        In the file, from 1.
    entry
        What it says, without its link.
    link
        Its link; empty in journals of old versions.
    holds
        Whether the link follows from the line and the link before it; True where it has none.
    """

    number: int
    entry: dict[str, Any]
    link: str
    holds: bool


def linked_lines(folder: Path) -> list[LinkedLine]:
    """Return the lines of a journal in order, each with whether its link holds; an interrupted line is passed over.

    Raises
    ------
    CaptureError
        There is no journal.
    """
    path = folder / JOURNAL_NAME
    if not path.exists():
        raise CaptureError(
            f"{folder}: contains no interrupted session ({JOURNAL_NAME} is missing); give the folder that 'finray "
            "capture' was writing"
        )
    content = read_bytes(path, "the journal of a session", CaptureError, LARGEST_TEXT_BYTES)
    lines: list[LinkedLine] = []
    before = b""
    for number, text in enumerate(content.split(b"\n"), 1):
        try:
            entry = parse_json(text, path, CaptureError)
        except CaptureError:
            continue
        if not isinstance(entry, dict) or "event" not in entry:
            continue
        linked = _LINKED.fullmatch(text)
        link = b"" if linked is None else linked[2]
        holds = linked is None or _link_of(before, linked[1]) == link
        entry.pop("link", None)
        lines.append(LinkedLine(number, entry, link.decode(), holds))
        before = link
    return lines


def read_journal(folder: Path) -> list[dict[str, Any]]:
    """Return what the lines of a journal say, in order; a line cut short by an interruption is passed over.

    Raises
    ------
    CaptureError
        There is no journal.
    """
    return [line.entry for line in linked_lines(folder)]


def _link_of(before: bytes, line: bytes) -> bytes:
    """Return the link of a line (without its closing brace) after the link before it."""
    return hashlib.sha256(before + b"\n" + line).hexdigest().encode()


def _sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _ends_with_newline(path: Path) -> bool:
    """Whether the file ends a line (or is empty)."""
    return read_bytes(path, JOURNAL_NAME, CaptureError, LARGEST_TEXT_BYTES)[-1:] in (b"", b"\n")
