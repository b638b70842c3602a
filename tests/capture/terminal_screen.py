"""A terminal for tests: a pseudo-terminal with a program in it, and what its screen shows.

The screen knows the few sequences that the live view uses and refuses others; `tests/capture/test_terminal_view.py`
compares it with tmux.
"""

import codecs
import fcntl
import os
import re
import select
import signal
import struct
import subprocess
import termios
import time
from contextlib import suppress

PATIENCE_S = 60.0
CUT = re.compile(r"\x1b[\[?0-9;]*(?=[\x18\x1b])|\x18")
"""A sequence that another one or CAN ends."""
SEQUENCE = re.compile(r"\x1b\[(\??)([0-9;]*)([A-Za-z])")


class Screen:
    """Rows of characters with the colours of each; text of the bare terminal is kept apart."""

    def __init__(self, columns: int, lines: int) -> None:
        self.columns, self.lines = columns, lines
        self.cells = [[(" ", "")] * columns for _ in range(lines)]
        self.is_other = False
        self.cursor_is_shown = True
        self.bare_text = ""
        self._row = self._column = 0
        self._style = ""
        self._rest = ""

    def feed(self, text: str) -> None:
        """Take what a program wrote."""
        text, self._rest = self._rest + text, ""
        at = 0
        while at < len(text):
            if text[at] not in "\x1b\x18":
                self._put(text[at])
                at += 1
            elif (found := SEQUENCE.match(text, at)) is not None:
                self._do(found[1], found[2], found[3])
                at = found.end()
            elif (cut := CUT.match(text, at)) is not None:
                at = cut.end()
            elif len(text) - at < 20:
                self._rest = text[at:]
                return
            else:
                raise AssertionError(f"a sequence that the screen does not know: {text[at : at + 20]!r}")

    def _put(self, character: str) -> None:
        if not self.is_other:
            self.bare_text += character
        elif self._row < self.lines and self._column < self.columns:
            self.cells[self._row][self._column] = (character, self._style)
            self._column += 1

    def _do(self, private: str, numbers: str, letter: str) -> None:
        if not self.is_other and (private, numbers) != ("?", "1049"):
            self.cursor_is_shown = letter == "h" if (private, numbers) == ("?", "25") else self.cursor_is_shown
            return
        match private, letter:
            case "", "H":
                # as in terminals: beyond the edge is at the edge, which happens to what is written while it shrinks
                row, column = (int(n) - 1 for n in numbers.split(";"))
                self._row, self._column = min(row, self.lines - 1), min(column, self.columns - 1)
            case "", "J":
                assert numbers == "2"
                self.cells = [[(" ", "")] * self.columns for _ in range(self.lines)]
            case "", "K":
                assert not numbers
                self.cells[self._row][self._column :] = [(" ", "")] * (self.columns - self._column)
            case "", "m":
                self._style = "" if numbers in ("", "0") else numbers
            case "?", "h" | "l" if numbers in ("7", "25", "1049"):
                self.is_other = letter == "h" if numbers == "1049" else self.is_other
                self.cursor_is_shown = letter == "h" if numbers == "25" else self.cursor_is_shown
            case _:
                raise AssertionError(f"a sequence that the screen does not know: {private}{numbers}{letter}")

    def rows(self) -> list[str]:
        """Return the text of each line."""
        return ["".join(character for character, _ in row) for row in self.cells]

    @property
    def text(self) -> str:
        """All of it."""
        return "\n".join(self.rows())


class Terminal:
    """A program in a pseudo-terminal of its own, whose session it leads."""

    def __init__(self, command: list[str], size: tuple[int, int] = (80, 24), **environment: str) -> None:
        self._ours, theirs = self._open = list(os.openpty())
        self.bytes = b""
        self.resize(*size)
        self.mode_before = termios.tcgetattr(theirs)
        own = {"TERM": "xterm-256color", "PYTHONIOENCODING": "utf-8", **environment}
        self.process = subprocess.Popen(
            command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
            env={**{k: v for k, v in os.environ.items() if k != "NO_COLOR"}, **own},
        )  # fmt: skip
        self._theirs = theirs
        self._decode = codecs.getincrementaldecoder("utf-8")("replace").decode

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        self.close_window()

    def close_window(self) -> None:
        """Close it, as a user who closes the window or a connection that is lost."""
        while self._open:
            os.close(self._open.pop())

    def resize(self, columns: int, lines: int) -> None:
        """Make it as large as that; the screen begins anew."""
        fcntl.ioctl(self._ours, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        was_other = self.screen.is_other if hasattr(self, "screen") else False
        self.screen = Screen(columns, lines)
        self.screen.is_other = was_other

    @property
    def mode(self) -> list:
        """How the terminal is set now."""
        return termios.tcgetattr(self._theirs)

    def press(self, keys: str) -> None:
        """Type."""
        os.write(self._ours, keys.encode())

    def read(self, for_s: float = 0.1) -> None:
        """Take what the program wrote."""
        if select.select([self._ours], [], [], for_s)[0]:
            with suppress(OSError):
                taken = os.read(self._ours, 65536)
                self.bytes += taken
                self.screen.feed(self._decode(taken))

    def until(self, shows, patience_s: float = PATIENCE_S) -> None:
        """Read until the screen shows a text, or a condition holds."""
        end = time.monotonic() + patience_s
        while time.monotonic() < end:
            if shows() if callable(shows) else shows in self.screen.text:
                return
            self.read()
        raise AssertionError(f"not within {patience_s} s: {shows}\n{self.screen.text}\n{self.screen.bare_text}")

    def status(self) -> int:
        """Read until the program has ended, and return its exit status."""
        self.until(lambda: self.process.poll() is not None)
        self.read()
        return self.process.returncode
