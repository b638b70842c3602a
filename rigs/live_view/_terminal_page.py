"""A page of plain ANSI sequences in a terminal, with the keys that are pressed there.

Nothing is drawn before the terminal has taken what was drawn last, so that a slow line delays pictures and no key. The
terminal is left as it was found.
"""

import contextlib
import os
import re
import select
import sys
import termios
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import CaptureError
from rigs.live_view._live_server import SATURATED

LEAST_COLUMNS: Final = 80
LEAST_LINES: Final = 24
PANEL_COLUMNS: Final = 32
DRAWN_ANEW_S: Final = 5.0
"""What others wrote on the screen stays no longer."""
LOOK_S: Final = 0.05
CHUNK_BYTES: Final = 256
"""A terminal that takes more takes at least so many at once (Linux, WAKEUP_CHARS)."""
GREYS: Final = (16, *range(232, 256), 231)
"""Black, 24 greys and white of the palette of 256 colours."""
SHADES: Final = " .:-=+*#%"
FULL_SCALE_SIGN: Final = "X"
NO_COLOUR_TERMINALS: Final = ("vt", "linux-m", "xterm-mono")
BOLD, REVERSE, RED, GREEN, YELLOW, PLAIN = "1", "7", "31;1", "32", "33;1", ""
ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}


@dataclass(frozen=True, slots=True)
class Screen:
    """What a terminal can show.

    Attributes
    ----------
    columns, lines
        Its size.
    colours
        Whether it has 256 colours and the user wants them.
    blocks
        Whether it shows half blocks (UTF-8).
    """

    columns: int
    lines: int
    colours: bool = True
    blocks: bool = True

    @property
    def is_large_enough(self) -> bool:
        """Whether picture and numbers fit."""
        return self.columns >= LEAST_COLUMNS and self.lines >= LEAST_LINES

    def painted(self, text: str, style: str, width: int) -> str:
        """Return a text in a style, filled or cut to a width; without colours, what is bold or red is reversed."""
        text = text[:width].ljust(width)
        if not self.colours:
            style = {RED: REVERSE, YELLOW: BOLD, GREEN: PLAIN}.get(style, style)
        return f"\x1b[{style}m{text}\x1b[0m" if style else text


class TerminalPage(ABC):
    """Has a terminal, draws lines in it and takes keys; what they are, a child says."""

    def __init__(self) -> None:
        self._keys_of, self._screen_of = sys.stdin.fileno(), sys.stdout.fileno()
        self._typed = b""
        self._typed_s = 0.0
        self._unsent = b""
        self._drawn: list[str] = []
        self._drawn_anew_s = 0.0
        self._has_terminal = self._is_continued = False

    @abstractmethod
    def _lines(self, screen: Screen) -> list[str]:
        """Return the lines of the screen."""

    @abstractmethod
    def _press(self, key: str) -> None:
        """Do what a key stands for."""

    def _shown(self, is_shown: bool) -> None:  # noqa: B027 - a page that need not know
        """Learn that the page is shown from now on, or no longer."""

    def _turn(self) -> None:
        """Read keys, draw what is new, and send what the terminal takes."""
        if not self._unsent:
            self._draw()
        ready, takes, _ = select.select([self._keys_of], [self._screen_of] if self._unsent else [], [], LOOK_S)
        if ready:
            typed = os.read(self._keys_of, 256)
            if not typed:
                raise OSError("the terminal was closed")
            self._typed += typed
            self._typed_s = time.monotonic()
        if self._typed:
            is_complete = time.monotonic() - self._typed_s > LOOK_S
            keys, self._typed = keys_in(self._typed, is_complete)
            for key in keys:
                self._press(key)
        if takes:
            self._unsent = self._unsent[os.write(self._screen_of, self._unsent[:CHUNK_BYTES]) :]

    def _draw(self) -> None:
        """Queue the lines of the screen that changed."""
        size = os.get_terminal_size(self._screen_of)
        screen = Screen(size.columns or LEAST_COLUMNS, size.lines or LEAST_LINES, *_abilities())
        now_s = time.monotonic()
        lines = self._lines(screen)
        if len(lines) != len(self._drawn) or now_s - self._drawn_anew_s > DRAWN_ANEW_S:
            self._drawn, self._drawn_anew_s = [""] * len(lines), now_s
            self._unsent += b"\x1b[0m\x1b[2J"
        changed = [f"\x1b[{n + 1};1H\x1b[K{line}" for n, line in enumerate(lines) if line != self._drawn[n]]
        self._drawn = lines
        self._unsent += "".join(changed).encode(errors="replace")

    @contextmanager
    def _terminal(self) -> Iterator[None]:
        """Have the terminal for a ``with`` block: keys at once, a screen of its own, no cursor."""
        self._saved = termios.tcgetattr(self._keys_of)
        try:
            self._take()
            yield
        finally:
            self._give_back()

    @contextmanager
    def _given_back(self) -> Iterator[None]:
        """Give the terminal back for a ``with`` block."""
        self._give_back()
        yield
        self._saved = termios.tcgetattr(self._keys_of)
        self._take()

    def _take(self) -> None:
        """Have every key at once; Ctrl-S, which would hold the screen, is a key like others."""
        mode = termios.tcgetattr(self._keys_of)
        mode[0] &= ~(termios.IXON | termios.ICRNL)
        mode[3] &= ~(termios.ICANON | termios.ECHO)
        mode[6][termios.VMIN], mode[6][termios.VTIME] = 1, 0
        termios.tcsetattr(self._keys_of, termios.TCSAFLUSH, mode)
        self._shown(True)
        self._has_terminal, self._is_continued = True, False
        self._unsent, self._drawn = b"\x1b[?1049h\x1b[?25l\x1b[?7l", []

    def _give_back(self) -> None:
        """Leave the terminal as it was found; one that is gone takes nothing any more.

        The first byte (CAN) ends a sequence that was cut.
        """
        self._shown(False)
        self._has_terminal, self._unsent = False, b""
        with contextlib.suppress(OSError):
            os.write(self._screen_of, b"\x18\x1b[0m\x1b[?7h\x1b[?25h\x1b[?1049l")
        with contextlib.suppress(OSError, termios.error):
            termios.tcsetattr(self._keys_of, termios.TCSAFLUSH, self._saved)


def require_terminal() -> None:
    """Check that standard input and output are a terminal that can place its cursor.

    Raises
    ------
    CaptureError
        They are not.
    """
    without = "; leave out --terminal to see the rig's picture in a browser"
    for stream, name in ((sys.stdin, "input"), (sys.stdout, "output")):
        if not stream.isatty():
            raise CaptureError(f"live --terminal: standard {name} is not a terminal{without}")
    kind = os.environ.get("TERM", "")
    if kind in ("", "dumb", "unknown"):
        raise CaptureError(f"live --terminal: this terminal (TERM={kind}) cannot place its cursor{without}")


def _abilities() -> tuple[bool, bool]:
    """Return whether colours are shown, and half blocks."""
    colours = not os.environ.get("NO_COLOR") and not os.environ.get("TERM", "").startswith(NO_COLOUR_TERMINALS)
    return colours, "utf" in (sys.stdout.encoding or "").lower()


def keys_in(typed: bytes, is_complete: bool) -> tuple[list[str], bytes]:
    """Return the keys in what a terminal sent, and the rest that may be the beginning of one.

    Parameters
    ----------
    typed
        Bytes from the terminal.
    is_complete
        Nothing more belongs to it: a lone escape is the key Esc.
    """
    keys: list[str] = []
    while typed:
        sequence = re.match(rb"\x1b(?:\[([0-9;]*)([@-~])|O([A-Z]))", typed)
        if sequence is not None:
            arrow = ARROWS.get((sequence[2] or sequence[3]).decode())
            if arrow is not None:
                keys.append(("fine " if sequence[1] and sequence[1].endswith(b";2") else "") + arrow)
            typed = typed[sequence.end() :]
        elif typed[:1] == b"\x1b":
            if not is_complete and re.fullmatch(rb"\x1b(\[[0-9;]*|O)?", typed):
                return keys, typed
            keys.append("escape")
            typed = typed[1:]
        else:
            special = {b"\r": "enter", b"\n": "enter", b"\x0c": "ctrl-l"}
            keys.append(special.get(typed[:1], typed[:1].decode("ascii", "replace")))
            typed = typed[1:]
    return keys, b""


def picture_lines(
    screen: Screen,
    picture: NDArray[np.uint8],
    size: tuple[int, int],
    region: tuple[int, int, int, int],
    frame: tuple[int, int],
) -> list[str]:
    """Return a picture as lines of half blocks, two pixels to a character; as signs where there are no colours."""
    lines, columns = size
    scale = min(2 * lines / picture.shape[0], columns / picture.shape[1])
    tall = max(int(picture.shape[0] * scale) // 2, 1) * 2
    wide = max(int(picture.shape[1] * scale), 1)
    small = reduced(picture, tall, wide)
    edge = np.zeros((tall, wide), bool)
    top, left = region[0] * tall // frame[0], region[1] * wide // frame[1]
    bottom = max(-(-(region[0] + region[2]) * tall // frame[0]) - 1, top)
    right = max(-(-(region[1] + region[3]) * wide // frame[1]) - 1, left)
    edge[top : bottom + 1, [left, right]] = True
    edge[[top, bottom], left : right + 1] = True
    rows = (_coloured if screen.colours and screen.blocks else _signs)(screen, small, edge)
    above = (lines - len(rows)) // 2
    empty = " " * columns
    return [*[empty] * above, *(row + " " * (columns - wide) for row in rows), *[empty] * (lines - len(rows) - above)]


def reduced(picture: NDArray[np.uint8], tall: int, wide: int) -> NDArray[np.uint8]:
    """Return a picture of another size: means of its pixels; at full scale where any of them is."""
    rows = np.linspace(0, picture.shape[0], tall + 1)[:-1].astype(int)
    columns = np.linspace(0, picture.shape[1], wide + 1)[:-1].astype(int)
    if tall > picture.shape[0] or wide > picture.shape[1]:
        found: NDArray[np.uint8] = picture[np.ix_(rows, columns)]
        return found
    total = np.add.reduceat(np.add.reduceat(picture.astype(np.float64), rows, 0), columns, 1)
    count = np.outer(np.diff([*rows, picture.shape[0]]), np.diff([*columns, picture.shape[1]]))
    small: NDArray[np.uint8] = np.minimum(np.round(total / count), SATURATED - 1).astype(np.uint8)
    hot = np.maximum.reduceat(np.maximum.reduceat(picture, rows, 0), columns, 1) == SATURATED
    small[hot] = SATURATED
    return small


def _coloured(screen: Screen, small: NDArray[np.uint8], edge: NDArray[np.bool_]) -> list[str]:
    """Return half blocks: the upper pixel is the colour of the block, the lower that of its ground."""
    greys = np.asarray(GREYS)[small.astype(int) * len(GREYS) // (SATURATED + 1)]
    colours = np.where(edge, 220, np.where(small == SATURATED, 196, greys))
    rows = []
    for upper, lower in zip(colours[0::2], colours[1::2], strict=True):
        row, before = "", (-1, -1)
        for pair in zip(upper.tolist(), lower.tolist(), strict=True):
            if pair != before:
                row += f"\x1b[38;5;{pair[0]};48;5;{pair[1]}m"
                before = pair
            row += "\u2580"
        rows.append(row + "\x1b[0m")
    return rows


def _signs(screen: Screen, small: NDArray[np.uint8], edge: NDArray[np.bool_]) -> list[str]:
    """Return one sign for each two pixels: the denser the brighter, X at full scale, o on the edge of the region."""
    pairs = small.reshape(len(small) // 2, 2, -1)
    level = pairs.mean(axis=1) * len(SHADES) / (SATURATED + 1)
    signs = np.asarray(list(SHADES))[np.minimum(level.astype(int), len(SHADES) - 1)]
    signs[(pairs == SATURATED).any(axis=1)] = FULL_SCALE_SIGN
    signs[edge.reshape(pairs.shape).any(axis=1)] = "o"
    return ["".join(row) for row in signs.tolist()]


def duration(exposure_s: float) -> str:
    """Return an exposure in words."""
    return f"{1e3 * exposure_s:.3g} ms" if exposure_s < 0.1 else f"{exposure_s:.3g} s"


def bar(screen: Screen, share: float) -> str:
    """Return a share from 0 to 1 as a bar."""
    full = round(min(share, 1.0) * PANEL_COLUMNS)
    return ("\u2588" if screen.blocks else "#") * full + ("\u2591" if screen.blocks else ".") * (PANEL_COLUMNS - full)


def histogram_lines(screen: Screen, histogram: tuple[int, ...], height: int) -> list[str]:
    """Return a histogram as lines, the highest first: logarithm of the pixels, two bins to a column."""
    counts = np.asarray(histogram, float).reshape(PANEL_COLUMNS, -1).sum(axis=1)
    logs = np.log1p(counts)
    eighths = np.ceil(8 * height * logs / max(float(logs.max()), 1.0)).astype(int)
    signs = " \u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588" if screen.blocks else "    #####"
    return [
        "".join(signs[min(max(level - 8 * below, 0), 8)] for level in eighths.tolist())
        for below in reversed(range(height))
    ]
