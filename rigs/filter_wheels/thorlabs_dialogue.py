"""Commands of the Thorlabs filter wheels and their answers.

A command ends with CR; the wheel repeats it, then says the value of a query or an error, each ended by CR, then the
prompt ``> ``.
"""

import re
from typing import Final

from data_schemas.errors import LostError, RefusedError
from rigs.transports.serial_link import SerialLink

QUIET_S: Final = 0.1
"""Silence after which nothing of a former session is under way; a USB adapter holds bytes back for 16 ms."""

# The prompt's space is stripped with the next answer, so that a wheel without one is understood too.
_PROMPT: Final = b">"
_ERROR: Final = "Command error"


class Dialogue:
    """Commands and their answers over a link; after a failure it first finds its step again.

    Parameters
    ----------
    link
        Open link to the wheel.
    name
        Name and address of the wheel, for messages.
    """

    def __init__(self, link: SerialLink, name: str) -> None:
        self._link = link
        self._name = name
        self._in_step = False

    def ask(self, keyword: str, end_s: float) -> str:
        """Return the value that the wheel says to ``keyword?``."""
        command = f"{keyword}?"
        said = self._exchange(command, end_s)
        if len(said) != 1:
            raise self._garbled(command, said)
        return said[0]

    def ask_number(self, keyword: str, end_s: float) -> int:
        """Return the whole number that the wheel says to ``keyword?``."""
        value = self.ask(keyword, end_s)
        if not re.fullmatch(r"\d{1,3}", value, re.ASCII):
            raise self._garbled(f"{keyword}?", [value])
        return int(value)

    def assign(self, keyword: str, value: int, end_s: float) -> None:
        """Say ``keyword=value`` and wait for the prompt."""
        command = f"{keyword}={value}"
        said = self._exchange(command, end_s)
        if said:
            raise self._garbled(command, said)

    def _exchange(self, command: str, end_s: float) -> list[str]:
        """Say a command; return the lines between its echo and the prompt."""
        if not self._in_step:
            self._find_step(end_s)
        self._in_step = False
        self._link.write(command.encode() + b"\r", end_s)
        frame = self._link.read_until(_PROMPT, end_s)[: -len(_PROMPT)]
        lines = [line.strip() for line in frame.decode("ascii", "replace").strip().split("\r")]
        if lines[0] != command:
            raise self._garbled(command, lines)
        self._in_step = True
        if lines[1:] and lines[1].startswith(_ERROR):
            raise RefusedError(
                f"{self._name}: refuses '{command}' ({lines[1].removeprefix(_ERROR).strip()}); check that it is an "
                "FW102C or FW212C and that its position count is set right"
            )
        return lines[1:]

    def _find_step(self, end_s: float) -> None:
        """End a command that was cut off, and forget answers that still come: a bare CR provokes one prompt more."""
        self._link.write(b"\r", end_s)
        self._link.read_until(_PROMPT, end_s)
        self._link.drain(QUIET_S, end_s)

    def _garbled(self, command: str, said: list[str]) -> LostError:
        return LostError(
            f"{self._name}: answers '{command}' with {said!r}; check that no other program uses the port, the cable, "
            "and that this port belongs to the wheel"
        )
