"""A capture session on the screen: in browsers of this computer, and in a terminal of 80 x 24 or more.

Both are views of one :class:`WatchedSession`. The session does not end with its views: a page that is closed and a
terminal that is gone leave it running, and the address shows it again.
"""

import contextlib
import signal
import termios
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CaptureError
from rigs.live_view._live_server import LiveServer, live_server
from rigs.live_view._terminal_page import (
    BOLD,
    GREEN,
    LEAST_COLUMNS,
    LEAST_LINES,
    PANEL_COLUMNS,
    PLAIN,
    RED,
    REVERSE,
    YELLOW,
    Screen,
    TerminalPage,
    bar,
    duration,
    picture_lines,
)
from rigs.live_view._watched_session import SessionNumbers, WatchedSession

PAGE_ASKS_WITHIN_S: Final = 6.0
"""A page waits at most 5 s for a change before it asks anew."""
LAST_WORD_S: Final = 3.0
"""How long an open page gets to learn how the session ended."""
HEADLINE_LINES: Final = 3
MOST_LINES_SAID: Final = 3
"""Where nothing is asked: a question is shown to its end."""
LEAST_PANEL_LINES: Final = 4
"""Of the numbers, beside a long question: lights, whether they are kept off, time left and its bar."""
MOST_TOLD_LINES: Final = 2
KEYS: Final = " l LIGHT OFF   Enter done, go on   y n yes, no   q end   ? help"
HELP: Final = (
    "l Space Esc    all lights off until you confirm; the frame",
    "               under way is discarded and taken again",
    "Enter          you have done what was asked: continue",
    "y n            answer yes or no to a question",
    "g              goggles are on: light a laser of class 3R or above again",
    "e              end here, where that is offered",
    "q              end the session, after you confirm",
    "Ctrl-C         end the session at once, with the lights off",
    "Ctrl-L         draw the screen again",
    "",
    "Drift: \u00b1 is the noise of the pixels; the light's own flicker is not in it.",
    "The session continues if this terminal is closed. Its address, for a browser",
    "of this computer:",
)
LETTERS: Final = {
    "A": "010 101 111 101 101", "B": "110 101 110 101 110", "C": "011 100 100 100 011", "D": "110 101 101 101 110",
    "E": "111 100 110 100 111", "F": "111 100 110 100 100", "G": "0110 1000 1011 1001 0110", "H": "101 101 111 101 101",
    "I": "1 1 1 1 1", "J": "001 001 001 101 010", "K": "101 101 110 101 101", "L": "100 100 100 100 111",
    "M": "10001 11011 10101 10001 10001", "N": "1001 1101 1011 1001 1001", "O": "0110 1001 1001 1001 0110",
    "P": "110 101 110 100 100", "Q": "0110 1001 1001 1010 0101", "R": "110 101 110 101 101", "S": "011 100 010 001 110",
    "T": "111 010 010 010 010", "U": "101 101 101 101 111", "V": "101 101 101 101 010",
    "W": "10001 10001 10101 11011 10001", "X": "101 101 010 101 101", "Y": "101 101 010 010 010",
    "Z": "111 001 010 100 111", "1": "01 11 01 01 01", "2": "110 001 010 100 111",
    "3": "110 001 010 001 110", "4": "101 101 111 001 001",
    "?": "110 001 010 000 010", "+": "000 010 111 010 000", " ": "00 00 00 00 00",
}  # fmt: skip
"""Rows of dots of each letter."""


@contextmanager
def shown_session(
    session: WatchedSession, port: int, in_terminal: bool, tell_address: Callable[[str], None]
) -> Iterator[None]:
    """Show a session, which the ``with`` block runs in the main thread, until it ends.

    Parameters
    ----------
    session
        What is shown.
    port
        On 127.0.0.1; 0 takes a free one.
    in_terminal
        Whether this terminal shows it too.
    tell_address
        Called with the address, which holds the token, before the session begins.
    """
    with live_server(session, port) as server, _signals_of_a_session(session):
        threads = [threading.Thread(target=server.serve_forever, args=(0.2,), name="session server", daemon=True)]
        tell_address(server.url)
        page = _SessionPage(session, server.url) if in_terminal else None
        if page is not None:
            threads.append(threading.Thread(target=page.run, name="session page", daemon=True))
        for thread in threads:
            thread.start()
        ended = "ended"
        try:
            yield
            ended = f"done: {session.latest(-1, 0.0)[1].stored} frames are stored"
        except BaseException as error:
            ended = "ended by hand" if isinstance(error, KeyboardInterrupt) else f"ended: {error}"
            raise
        finally:
            _end(session, ended, server, page)
            for thread in threads:
                thread.join(LAST_WORD_S)


def _end(session: WatchedSession, words: str, server: LiveServer, page: "_SessionPage | None") -> None:
    """Tell the views that the session ended, and end them."""
    session.has_ended(words)
    if page is not None:
        page.stop()
    last, end_s = session.latest(-1, 0.0)[1].number, time.monotonic() + LAST_WORD_S
    is_open = time.monotonic() - server.asked_s < PAGE_ASKS_WITHIN_S
    while is_open and server.sent < last and time.monotonic() < end_s:
        time.sleep(0.05)
    server.shutdown()


@contextmanager
def _signals_of_a_session(session: WatchedSession) -> Iterator[None]:
    """Let a session run on when its terminal is closed and when Ctrl-Z is pressed, and end at the interrupt of a view.

    A shell has programs in the background ignore the interrupt, and :meth:`WatchedSession.end` needs it.
    """

    def run_on(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGTSTP:
            session.progress(
                0,
                1,
                "Ctrl-Z is ignored, because the lights of a stopped session would stay as they are; Ctrl-C ends it",
            )

    # Handlers, and not SIG_IGN, which programs that the rig starts would inherit.
    before = {number: signal.signal(number, run_on) for number in (signal.SIGHUP, signal.SIGTSTP)}
    before[signal.SIGINT] = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _SessionPage(TerminalPage):
    """The session in a terminal; it goes when the terminal goes."""

    def __init__(self, session: WatchedSession, address: str) -> None:
        super().__init__()
        self._session, self._address = session, address
        self._stop = threading.Event()
        self._helps = self._ends = False

    def run(self) -> None:
        """Show it until :meth:`stop`, or until the terminal is gone."""
        with contextlib.suppress(OSError, termios.error), self._terminal():
            while not self._stop.is_set():
                self._turn()

    def stop(self) -> None:
        """Give the terminal back."""
        self._stop.set()

    def _press(self, key: str) -> None:
        """Do what a key stands for."""
        _, numbers = self._session.latest(-1, 0.0)
        ended, helped, self._ends, self._helps = self._ends, self._helps, False, False
        if key in ("l", " ", "escape"):
            self._session.darken()
        elif ended or helped:  # whatever else is pressed goes back: it answers no question behind the screen
            if ended and key == "e":
                self._session.end()
        elif key == "q":
            self._ends = True
        elif key == "?":
            self._helps = True
        elif key == "ctrl-l":
            self._drawn = []
        else:
            word = {"enter": "done", "y": "yes", "n": "no", "e": "end", "g": "goggles"}.get(key)
            if word in numbers.answers:
                with contextlib.suppress(CaptureError):  # another view was faster
                    self._session.ask({"question": numbers.question, "answer": word})

    def _lines(self, screen: Screen) -> list[str]:
        """Return the lines of the screen."""
        picture, numbers = self._session.latest(-1, 0.0)
        if not screen.is_large_enough:
            return small_screen(screen, numbers)
        if self._helps:
            return help_screen(screen, numbers, self._address)
        return session_screen(screen, self._session, picture, numbers, self._ends)


def lights_line(screen: Screen, numbers: SessionNumbers) -> str:
    """Return both lights, 32 columns wide."""
    return "".join(
        screen.painted(f" {name} {'ON' if is_on else 'off'} ", RED if is_on else GREEN, PANEL_COLUMNS // 2)
        for name, is_on in (("LAMP", numbers.lamp), ("LASER", numbers.laser))
    )


def small_screen(screen: Screen, numbers: SessionNumbers) -> list[str]:
    """Return the lines of a terminal that is too small."""
    told = (
        numbers.headline,
        numbers.text,
        "LIGHT ON" if numbers.lamp or numbers.laser else "lights off",
        f"needs {LEAST_COLUMNS} x {LEAST_LINES}, has {screen.columns} x {screen.lines}",
        "l light off, Enter done, Ctrl-C end",
    )
    lines = [screen.painted(text, RED if "ON" in text else PLAIN, screen.columns) for text in told]
    return [*lines, *[""] * screen.lines][: screen.lines]


def help_screen(screen: Screen, numbers: SessionNumbers, address: str) -> list[str]:
    """Return the lines of the help."""
    lines = [screen.painted(" Keys of a session in finray live", REVERSE, screen.columns)]
    lines += ["  " + lights_line(screen, numbers), "", *(f"  {text}" for text in HELP), f"  {address}", ""]
    lines += ["  Picture: square root of the counts; full-scale pixels are red (no colours: X).",
              "  Any key goes back."]  # fmt: skip
    return [*lines, *[""] * screen.lines][: screen.lines]


def session_screen(
    screen: Screen, session: WatchedSession, picture: NDArray[np.uint8], numbers: SessionNumbers, ends: bool
) -> list[str]:
    """Return the lines: what to do in large letters, picture at the left, numbers at the right, what was noted."""
    style = YELLOW if numbers.question or numbers.kept_off else GREEN
    headline, text = numbers.headline, numbers.text
    if numbers.answers:
        text += {"done": " Press Enter when done.", "yes": " Press y or n.", "goggles": " Press g when they do."}[
            numbers.answers[0]
        ]
        text += " Press e to end here." if "end" in numbers.answers else ""
    if ends:
        headline, style = "END?", RED
        text = "Press e to end the session; finray capture --resume continues it later. Any other key goes back."
    free = screen.lines - HEADLINE_LINES - MOST_TOLD_LINES - 2
    most = free - LEAST_PANEL_LINES if numbers.question or ends else MOST_LINES_SAID
    said = textwrap.wrap(text, screen.columns - 2)[:most]
    said += [""] * (MOST_LINES_SAID - len(said))
    note = f"noted last: {numbers.told}" if numbers.told else ""
    told = (textwrap.wrap(note, screen.columns - 2) + [""] * MOST_TOLD_LINES)[:MOST_TOLD_LINES]
    height = free - len(said)
    width = screen.columns - PANEL_COLUMNS - 1
    region = session.region
    place = region.row_px, region.column_px, region.height_px, region.width_px
    shown = picture_lines(screen, picture, (height, width), place, session.frame_size) if numbers.frame else []
    panel = panel_lines(screen, numbers, height)
    title = f" finray live   session of {session.name}"[: screen.columns - 16].ljust(screen.columns - 16)
    return [
        screen.painted(title + f"{numbers.stored} stored ".rjust(16), REVERSE, screen.columns),
        *(screen.painted(line, style, screen.columns) for line in large_letters(screen, headline)),
        *(screen.painted(f" {line}", style if numbers.question or ends else PLAIN, screen.columns) for line in said),
        *(f"{left} {right}" for left, right in zip([*shown, *[" " * width] * height], panel, strict=False)),
        *(screen.painted(f" {line}", PLAIN, screen.columns) for line in told),
        screen.painted(KEYS, REVERSE, screen.columns),
    ]


def large_letters(screen: Screen, words: str) -> list[str]:
    """Return words in letters three lines high, or spaced ones where the terminal has no half blocks."""
    rows = [" " + "0".join(LETTERS.get(letter, LETTERS["?"]).split()[row] for letter in words) for row in range(5)]
    if not screen.blocks or len(rows[0]) > screen.columns:
        return ["", " " + " ".join(words) if 2 * len(words) < screen.columns else words, ""]
    signs = {("0", "0"): " ", ("1", "0"): "\u2580", ("0", "1"): "\u2584", ("1", "1"): "\u2588", (" ", " "): " "}
    blank = rows[0].replace("1", "0")
    pairs = ((rows[0], rows[1]), (rows[2], rows[3]), (rows[4], blank))
    return ["".join(signs[pair] for pair in zip(upper, lower, strict=True)) for upper, lower in pairs]


def panel_lines(screen: Screen, numbers: SessionNumbers, height: int) -> list[str]:
    """Return the numbers beside the picture."""

    def line(text: str = "", style: str = PLAIN) -> str:
        return screen.painted(text, style, PANEL_COLUMNS)

    if numbers.left >= 0:
        share = numbers.stored / max(numbers.stored + numbers.left, 1)
        counted = f"{numbers.stored} frames stored, {numbers.left} to take"
    else:
        share = numbers.done / max(numbers.total, 1)
        counted = f"{numbers.phase}: {numbers.done} of {numbers.total}" if numbers.phase else "no frame yet"
    is_hot = numbers.saturated_fraction > 0
    lines = [
        lights_line(screen, numbers),
        line("KEPT OFF by hand" if numbers.kept_off else "", RED if numbers.kept_off else PLAIN),
        line(time_left(numbers), BOLD),
        line(bar(screen, share)),
        line(counted),
        line(f"SIGNAL TO NOISE {numbers.snr:.0f} per pixel" if numbers.frame else "SIGNAL TO NOISE -", BOLD),
        line(f"{duration(numbers.exposure_s)}, brightest {100 * numbers.brightest_fraction:.0f} %"
             + (" HOT" if is_hot else ""), RED if is_hot else PLAIN),
        *(line(text, style) for text, style in filter_lines(numbers)),
        *(line(f"{'  ' if k else 'drift '}{100 * d.change_rel:+.2f}\u00b1{100 * d.uncertainty_rel:.2f} % {d.label}")
          for k, d in enumerate(numbers.drifts)),
        *([] if numbers.drifts else [line("drift: no reference taken twice")]),
        line(f"faults: {numbers.repeated} repeated, {numbers.retaken} retaken"),
        line(f"{numbers.lights_lost} lights lost, {numbers.repairs} repairs"),
    ]  # fmt: skip
    return [*lines, *[line()] * height][:height]


def time_left(numbers: SessionNumbers) -> str:
    """Return the time that is left in words."""
    if numbers.ended:
        return "ENDED"
    if numbers.time_left_s < 0:
        return "TIME LEFT after metering"
    left_s = numbers.time_left_s
    return f"TIME LEFT {left_s:.0f} s" if left_s < 90 else f"TIME LEFT {left_s / 60:.0f} min"


def filter_lines(numbers: SessionNumbers) -> list[tuple[str, str]]:
    """Return the filter in the beam, how many have all their frames, and how many frames each that is begun has."""
    filters, beam = numbers.filters, f"FILTER {numbers.filter_name}"
    if not any(f.planned for f in filters):
        return [(beam, BOLD), ("", PLAIN)]
    done = sum(f.stored >= f.planned for f in filters)
    begun = ", ".join(f"{f.name} {f.stored}/{f.planned}" for f in filters if 0 < f.stored < f.planned)
    whole = textwrap.shorten(begun, PANEL_COLUMNS, placeholder=" ...")
    return [(f"{beam}, {done} of {len(filters)} done", BOLD), (whole, PLAIN)]
