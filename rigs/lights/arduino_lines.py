"""What the light's firmware says: lines of ASCII, each one word, and the version in ``LASER 1.1``."""

import re
from typing import Final, Literal, NamedTuple

from data_schemas.errors import LostError

BAUD: Final = 9600
Word = Literal["ON", "OFF", "ERR", "TRIP", "LASER"]
_WORDS: Final[dict[bytes, Word]] = {b"ON": "ON", b"OFF": "OFF", b"ERR": "ERR", b"TRIP": "TRIP", b"LASER": "LASER"}
LINE: Final = re.compile(rb"(?:(ON|OFF|ERR|TRIP)|(LASER) (\d{1,3}\.\d{1,3}))\r?\n")


class Said(NamedTuple):
    """One line of the firmware; `version` of a ``LASER`` line."""

    word: Word
    version: str = ""


def parse(line: bytes, name: str) -> Said:
    """Return what a line of the controller `name` says.

    Raises
    ------
    LostError
        No firmware of ours says this.
    """
    match = LINE.fullmatch(line)
    if match is None:
        raise LostError(
            f"{name}: says {line[:32]!r}, which the light's firmware never does; check the cable, the ground between "
            f"board and computer, the speed ({BAUD} baud) and that no other program uses the port"
        )
    return Said(_WORDS[match[1] or match[2]], (match[3] or b"").decode())
