"""The live view of a rig in a terminal of 80 x 24 or more: picture, numbers and keys, in plain ANSI sequences.

Nothing is drawn before the terminal has taken what was drawn last, so that a slow line delays pictures and no key. The
terminal is as it was on every way out; Ctrl-Z stops the program only when the lamp is confirmed off.
"""

import contextlib
import signal
import textwrap
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CaptureError
from rigs import TerminalOperator
from rigs.live_view._live_server import LiveNumbers, LiveRig
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
    histogram_lines,
    picture_lines,
    require_terminal,
)

ENDS_WITHIN_S: Final = 10.0
"""An exposure, the answer of the camera and the lamp's way off."""
STALLS_AFTER_S: Final = 5.0
MOST_LINES_SAID: Final = 6
GOOD_SHARE: Final = (0.6, 0.8)
DARK_SHARE: Final = 0.1
REGION_STEP: Final = 0.04
REGION_FINE_STEP_PX: Final = 2
REGION_FACTOR: Final = 1.25
FOCUS_GOOD: Final = 0.97
STEPS: Final = {"up": (-1, 0), "down": (1, 0), "left": (0, -1), "right": (0, 1)}
HELP: Final = (
    "l Space Esc    lamp off",
    "o              lamp on",
    "+ -            double or halve the exposure",
    "m              meter: brightest pixel to 70 % of full scale",
    "f F            next filter, filter before",
    "1 to 9         filter of that number",
    "arrow keys     move the region; with Shift by 2 px",
    "< >            smaller or larger region",
    "a              the region is the whole frame",
    "Ctrl-L         draw the screen again",
    "q Ctrl-C       end, with the lamp off",
    "",
    "Picture: square root of the counts; full-scale pixels are red (no colours: X).",
    "Focus: turn the lens until its value stops growing. 100 % is the best since",
    "the last change of region, filter, exposure or lamp.",
    "The laser is never lit in this view.",
    "",
    "Any key goes back to the picture.",
)


class TerminalViewOperator(TerminalOperator):
    """A person at the terminal, who is asked in the view while it is shown."""

    def __init__(self) -> None:
        super().__init__()
        self._changed = threading.Condition()
        self._is_shown = False
        self._asked = ""

    @property
    def asked(self) -> str:
        """What is to be done now; empty where nothing is."""
        return self._asked

    def show_in_view(self, is_shown: bool) -> None:
        """Ask in the view from now on, or at the bare terminal; what was being asked in the view has no answer then."""
        with self._changed:
            self._is_shown = is_shown
            self._changed.notify_all()

    def done(self) -> None:
        """Take the word of the person that it is done."""
        with self._changed:
            self._asked = ""
            self._changed.notify_all()

    def do(self, instruction: str) -> None:
        """Show an instruction and wait for Enter.

        Raises
        ------
        CaptureError
            The view ended before, or nobody can answer.
        """
        with self._changed:
            if self._is_shown:
                self._asked = instruction
                self._changed.wait_for(lambda: not (self._asked and self._is_shown))
                unanswered, self._asked = bool(self._asked), ""
                if unanswered:
                    raise CaptureError(f"operator: the view ended before '{instruction}' was confirmed")
                return
        super().do(instruction)


def terminal_view(live: LiveRig, name: str, operator: TerminalViewOperator) -> None:
    """Show a rig in the terminal until q is pressed; the lamp is off and the terminal as before when it returns.

    Parameters
    ----------
    live
        The rig, which is not exposing yet.
    name
        What stands in the first line.
    operator
        With whom the rig was opened.

    Raises
    ------
    CaptureError
        Standard input or output is not a terminal.
    UnsafeError
        The lamp is not confirmed off.
    """
    require_terminal()
    _View(live, name, operator).run()


class _View(TerminalPage):
    """One run of the view: reads keys, draws, and looks after the thread that exposes."""

    def __init__(self, live: LiveRig, name: str, operator: TerminalViewOperator) -> None:
        super().__init__()
        self._live, self._name, self._operator = live, name, operator
        self._number, self._number_s = -1, time.monotonic()
        self._helps = self._is_ending = self._stops = False
        self._said = ""

    def run(self) -> None:
        """Show the rig until the end is asked for."""
        try:
            with self._signals(), self._terminal():
                self._live.start()
                self._while_asked_for()
        finally:
            self._live.stop()
            has_ended = self._live.ended(ENDS_WITHIN_S)
        if not has_ended:
            raise CaptureError(
                f"live --terminal: camera and lamp gave no answer for {ENDS_WITHIN_S:g} s; check whether the "
                "lamp is off"
            )

    def _while_asked_for(self) -> None:
        """Take keys and draw until the end is asked for, and then until the lamp is off."""
        try:
            while not self._is_ending:
                self._turn()
                if self._stops:
                    self._stop_here()
                if self._is_continued:
                    self._take()
        except (KeyboardInterrupt, OSError):  # of the terminal, which is gone
            self._is_ending = True
        if self._has_terminal:
            self._end_in_view()

    def _end_in_view(self) -> None:
        """Show that the lamp goes off; a person who is asked takes as long as it takes, a second Ctrl-C ends it."""
        self._live.stop()
        self._said = "ending: the lamp goes off"
        end_s = time.monotonic() + ENDS_WITHIN_S
        with contextlib.suppress(KeyboardInterrupt, OSError):
            while not self._live.ended(0.0) and (self._operator.asked or time.monotonic() < end_s):
                self._turn()

    def _press(self, key: str) -> None:
        """Do what a key stands for."""
        self._said = self._said if self._is_ending else ""
        if key in ("l", " ", "escape"):
            self._live.ask({"lamp": False})
        elif key == "q":
            self._is_ending = True
        elif key == "ctrl-l":
            self._drawn = []
        elif self._operator.asked:
            if key == "enter":
                self._operator.done()
        elif self._helps or key == "?":
            self._helps = not self._helps
        elif not self._is_ending:
            self._set(key)

    def _set(self, key: str) -> None:
        """Ask for what a key changes: lamp, exposure, filter or region."""
        _, numbers = self._live.latest(-1, 0.0)
        filters = list(self._live.filters)
        match key:
            case "o":
                self._live.ask({"lamp": True})
            case "+" | "=":
                self._live.ask({"exposure_s": 2.0 * self._live.exposure_s})
            case "-":
                self._live.ask({"exposure_s": 0.5 * self._live.exposure_s})
            case "m" if numbers.suggested_s > 0:
                self._live.ask({"exposure_s": numbers.suggested_s})
            case "f" | "F":
                self._live.ask({"filter": next_filter(filters, self._live.filter_asked, 1 if key == "f" else -1)})
            case _ if key.isdecimal() and 0 < int(key) <= len(filters):
                self._live.ask({"filter": filters[int(key) - 1]})
            case _:
                region = changed_region(key, self._live.region, self._live.frame_size)
                if region is not None:
                    self._live.ask({"region": list(region)})

    def _shown(self, is_shown: bool) -> None:
        self._operator.show_in_view(is_shown)

    def _lines(self, screen: Screen) -> list[str]:
        """Return the lines of the screen."""
        picture, numbers = self._live.latest(-1, 0.0)
        if numbers.number != self._number:
            self._number, self._number_s = numbers.number, time.monotonic()
        age_s = time.monotonic() - self._number_s
        if not screen.is_large_enough:
            return small_screen(screen, numbers)
        if self._helps:
            return help_screen(screen, numbers)
        said = (self._said, YELLOW)
        if numbers.trouble:
            said = (numbers.trouble, RED)
        elif age_s > STALLS_AFTER_S:
            said = (f"NO NEW FRAME for {age_s:.0f} s", RED)
        if self._operator.asked:
            said = (f"{self._operator.asked} Press Enter when done.", YELLOW)
        return full_screen(screen, self._name, self._live, (picture, numbers), said)

    def _stop_here(self) -> None:
        """Switch the lamp off, give the terminal back, and stop until the user continues the program."""
        self._stops = False
        self._live.stop()
        if not self._live.ended(ENDS_WITHIN_S):
            self._said = "not stopped: the camera or the lamp gives no answer; the lamp may be on"
            return
        with self._given_back():
            before = signal.signal(signal.SIGTSTP, signal.SIG_DFL)
            signal.raise_signal(signal.SIGTSTP)
            signal.signal(signal.SIGTSTP, before)
        self._live.start()

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Take Ctrl-Z and the word to continue as ours for a ``with`` block."""

        def stop(number: int, frame: FrameType | None) -> None:
            self._stops = True

        def go_on(number: int, frame: FrameType | None) -> None:
            self._is_continued = True  # the shell may have set the terminal otherwise meanwhile

        before = {number: signal.signal(number, do)
                  for number, do in ((signal.SIGTSTP, stop), (signal.SIGCONT, go_on))}  # fmt: skip
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def next_filter(filters: list[str], now: str, step: int) -> str:
    """Return the filter that comes `step` behind the one in the beam; the first where none is."""
    return filters[(filters.index(now) + step) % len(filters)] if now in filters else filters[0]


def changed_region(
    key: str, region: tuple[int, int, int, int], frame: tuple[int, int]
) -> tuple[int, int, int, int] | None:
    """Return the region that a key leads to, inside the frame; None where the key changes no region."""
    rows, columns = frame
    row, column, height, width = region
    is_fine, name = key.startswith("fine "), key.removeprefix("fine ")
    if key == "a":
        return 0, 0, rows, columns
    if key in ("<", ">"):
        factor = REGION_FACTOR if key == ">" else 1.0 / REGION_FACTOR
        tall, wide = min(max(round(height * factor), 16), rows), min(max(round(width * factor), 16), columns)
        row, column, height, width = row + (height - tall) // 2, column + (width - wide) // 2, tall, wide
    elif name in STEPS:
        down, right = STEPS[name]
        row += down * (REGION_FINE_STEP_PX if is_fine else 2 * round(0.5 * REGION_STEP * rows))
        column += right * (REGION_FINE_STEP_PX if is_fine else 2 * round(0.5 * REGION_STEP * columns))
    else:
        return None
    return min(max(row, 0), rows - height), min(max(column, 0), columns - width), height, width


def small_screen(screen: Screen, numbers: LiveNumbers) -> list[str]:
    """Return the lines of a terminal that is too small."""
    told = (
        f"finray live needs {LEAST_COLUMNS} x {LEAST_LINES},",
        f"this terminal has {screen.columns} x {screen.lines}.",
        f"lamp {'ON' if numbers.lamp else 'off'}",
        "l light off, q quit",
    )
    lines = [screen.painted(text, RED if "ON" in text else PLAIN, screen.columns) for text in told]
    return [*lines, *[""] * screen.lines][: screen.lines]


def help_screen(screen: Screen, numbers: LiveNumbers) -> list[str]:
    """Return the lines of the help."""
    lamp = screen.painted(f"lamp {'ON' if numbers.lamp else 'off'}", RED if numbers.lamp else PLAIN, 8)
    lines = [screen.painted(" Keys of finray live", REVERSE, screen.columns), "  " + lamp, ""]
    lines += [f"  {text}".ljust(screen.columns) for text in HELP]
    return [*lines, *[" " * screen.columns] * screen.lines][: screen.lines]


def full_screen(
    screen: Screen,
    name: str,
    live: LiveRig,
    frame: tuple[NDArray[np.uint8], LiveNumbers],
    said: tuple[str, str],
) -> list[str]:
    """Return the lines of the screen: picture at the left, numbers at the right, what to do below."""
    picture, numbers = frame
    told = textwrap.wrap(said[0], screen.columns - 2)[:MOST_LINES_SAID] or [""]
    height, width = screen.lines - 2 - len(told), screen.columns - PANEL_COLUMNS - 1
    title = f" finray live   {name}"[: screen.columns - 16].ljust(screen.columns - 16)
    title += f"frame {numbers.number} ".rjust(16)
    if numbers.number == 0:
        shown = [" " * width] * height
    else:
        shown = picture_lines(screen, picture, (height, width), numbers.region, live.frame_size)
    panel = panel_lines(screen, numbers, live)[:height]
    panel += [" " * PANEL_COLUMNS] * (height - len(panel))
    keys = " l LIGHT OFF  o on  + - exposure  m meter  f filter  arrows region  ? help  q"
    return [
        screen.painted(title, REVERSE, screen.columns),
        *(f"{left} {right}" for left, right in zip(shown, panel, strict=True)),
        *(screen.painted(f" {text}", said[1], screen.columns) for text in told),
        screen.painted(keys, REVERSE, screen.columns),
    ]


def panel_lines(screen: Screen, numbers: LiveNumbers, live: LiveRig) -> list[str]:
    """Return the numbers beside the picture."""

    def line(text: str = "", style: str = PLAIN) -> str:
        return screen.painted(text, style, PANEL_COLUMNS)

    sharp = max(numbers.focus, 0.0) / numbers.best_focus if numbers.best_focus > 0 else 0.0
    aid, style = exposure_aid(numbers)
    row, column, height, width = live.region
    lamp = screen.painted(f" LAMP {'ON' if numbers.lamp else 'off'} ", RED if numbers.lamp else GREEN, 16)
    laser = screen.painted(f" LASER {'ON' if numbers.laser else 'off'} ", RED if numbers.laser else GREEN, 16)
    return [
        lamp + laser,
        line(),
        line(f"FOCUS {100 * sharp:4.0f} % of the best" if numbers.best_focus > 0 else "FOCUS too dark", BOLD),
        line(bar(screen, sharp), GREEN if sharp >= FOCUS_GOOD else PLAIN),
        line(f"now {max(numbers.focus, 0.0):.3g}, best {numbers.best_focus:.3g}"),
        line(),
        line(f"EXPOSURE {duration(numbers.exposure_s)}", BOLD),
        line(f"brightest {100 * numbers.brightest_fraction:.0f} % of full scale"),
        line(f"at full scale {100 * numbers.saturated_fraction:.2g} % of pixels", style if style == RED else PLAIN),
        line(aid, style),
        *(line(text) for text in histogram_lines(screen, numbers.histogram, 4)),
        line("0" + "full scale".rjust(PANEL_COLUMNS - 1)),
        line(f"FILTER {numbers.filter_name}", BOLD),
        *(line(text) for text in filter_lines(list(live.filters), numbers.filter_name)),
        line("REGION, for the plan", BOLD),
        line(f"row_px {row}  column_px {column}"),
        line(f"height_px {height}  width_px {width}"),
    ]


def exposure_aid(numbers: LiveNumbers) -> tuple[str, str]:
    """Return what to do about the exposure, and its style."""
    if numbers.number == 0:
        return "waiting for a frame", PLAIN
    if numbers.saturated_fraction > 0:
        return "clipped: expose less [-]", RED
    if numbers.brightest_fraction < DARK_SHARE and not numbers.lamp:
        return "the lamp is off: [o] switches it on", YELLOW
    if numbers.brightest_fraction < GOOD_SHARE[0]:
        return "expose more [+], 70 % is best", YELLOW
    if numbers.brightest_fraction > GOOD_SHARE[1]:
        return "expose less [-], 70 % is best", YELLOW
    return "good", GREEN


def filter_lines(filters: list[str], now: str) -> list[str]:
    """Return the filters with the keys that choose them, in two lines at most; the one in the beam in brackets."""
    parts = [f"{n} [{name}]" if name == now else f"{n} {name}" for n, name in enumerate(filters[:9], start=1)]
    lines = [""]
    for part in parts:
        joined = f"{lines[-1]}  {part}".strip()
        if len(joined) > PANEL_COLUMNS:
            lines.append(part)
        else:
            lines[-1] = joined
    return [*lines, ""][:2]
