"""The one kind of FITS file that cameras of INDI servers send: a primary image of 16-bit whole numbers.

Source: FITS standard 4.0, sections 3 and 4: cards of 80 characters in blocks of 2880 bytes, then big-endian data.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import BadFrameError, RefusedError

BLOCK_BYTES: Final = 2880
CARD_BYTES: Final = 80
_LONGEST_HEADER_BYTES: Final = 100 * BLOCK_BYTES
_UNSIGNED_ZERO: Final = 32768.0
_TEXT: Final = re.compile(r"'((?:[^']|'')*)'")

CardValue = str | float | bool


@dataclass(frozen=True, slots=True)
class FitsImage:
    """Counts (DN), shape (H, W), rows as they are stored, and the values of the header's cards."""

    counts: NDArray[np.uint16]
    header: Mapping[str, CardValue]


def read_fits_image(data: bytes, name: str) -> FitsImage:
    """Return the primary image of a FITS file; `name` says where it is from, for messages.

    Raises
    ------
    BadFrameError
        The file is cut off or damaged.
    RefusedError
        It holds something else than one image of 16-bit whole numbers.
    """
    header, start = _header(data, name)
    unit = {key: header.get(key, default) for key, default in (("BZERO", 0.0), ("BSCALE", 1.0))}
    if (header.get("BITPIX"), header.get("NAXIS"), unit["BSCALE"]) != (16, 2, 1.0) or unit["BZERO"] not in (
        0.0,
        _UNSIGNED_ZERO,
    ):
        raise RefusedError(
            f"{name}: sends FITS with BITPIX {header.get('BITPIX')}, NAXIS {header.get('NAXIS')}, BSCALE "
            f"{unit['BSCALE']}, BZERO {unit['BZERO']}; one raw image of 16-bit counts is needed (BITPIX 16, NAXIS 2): "
            "choose a raw 16-bit capture format in the camera's driver"
        )
    width, height = (_length(header.get(axis)) for axis in ("NAXIS1", "NAXIS2"))
    if width * height == 0 or len(data) < start + 2 * width * height:
        raise BadFrameError(
            f"{name}: a frame of {width} x {height} px needs {2 * width * height} bytes after its header, "
            f"{len(data) - start} came"
        )
    stored = np.frombuffer(data, dtype=">u2", count=width * height, offset=start).reshape(height, width)
    # Stored values are signed; adding 32768 to them turns over their highest bit.
    highest_bit = np.uint16(0x8000)
    if unit["BZERO"] == _UNSIGNED_ZERO:
        counts = stored.astype(np.uint16) ^ highest_bit
    elif (stored & highest_bit).any():
        raise RefusedError(f"{name}: sends negative counts; choose a raw 16-bit capture format in the camera's driver")
    else:
        counts = stored.astype(np.uint16)
    return FitsImage(counts, header)


def _header(data: bytes, name: str) -> tuple[dict[str, CardValue], int]:
    """Return the cards up to END, and where the data starts."""
    header: dict[str, CardValue] = {}
    for at in range(0, min(len(data), _LONGEST_HEADER_BYTES), CARD_BYTES):
        card = data[at : at + CARD_BYTES].decode("ascii", "replace")
        key = card[:8].rstrip()
        if at == 0 and not card.startswith("SIMPLE  ="):
            break
        if key == "END":
            return header, -(-(at + CARD_BYTES) // BLOCK_BYTES) * BLOCK_BYTES
        if card[8:10] == "= " and (value := _value(card[10:])) is not None:
            header[key] = value
    raise BadFrameError(f"{name}: sends {data[:10]!r}..., which is no FITS file with a whole header; expose again")


def _value(field: str) -> CardValue | None:
    """Return the value of a card: text without the blanks at its end, number or truth value."""
    text = _TEXT.match(field.lstrip())
    if text:
        return text[1].replace("''", "'").rstrip()
    word = field.split("/")[0].strip()
    if word in ("T", "F"):
        return word == "T"
    try:
        return float(word.replace("D", "E"))
    except ValueError:
        return None


def _length(value: CardValue | None) -> int:
    """Return the length of an axis; 0 where it is none."""
    whole = isinstance(value, float) and value.is_integer() and 0.0 < value < 2**16
    return int(value) if whole and value is not None else 0
