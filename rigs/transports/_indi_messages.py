"""INDI's stream of XML messages, taken apart as it arrives: no document type, no entities, nothing without a limit.

Source: INDI protocol 1.7 (E. Downey, 2007): a connection carries XML elements one after the other, without a root.
"""

import base64
import binascii
import codecs
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

from data_schemas import BadFrameError, LostError

LARGEST_BLOB_BYTES: Final = 2 * 8192 * 8192 + 2**20
"""The largest frame of a rig file at two bytes a pixel, and a header."""
LONGEST_MESSAGE_BYTES: Final = 2**20
# Base64 makes 4 of 3 and breaks its lines.
_LONGEST_BLOB_MESSAGE_BYTES: Final = LARGEST_BLOB_BYTES * 3 // 2
_NESTING: Final = 3
_PIECE_CHARACTERS: Final = 2**20
# XML 1.0, section 2.2, allows none of them; 0 tells that something else than INDI is sent.
_NO_XML: Final = dict.fromkeys([*range(1, 9), 11, 12, *range(14, 32), 0xFFFE, 0xFFFF], "\ufffd")


@dataclass(frozen=True, slots=True)
class IndiElement:
    """One member of a property: its attributes and its text without the blanks around it."""

    attributes: Mapping[str, str]
    text: str

    @property
    def name(self) -> str:
        """Name of the member."""
        return self.attributes.get("name", "")


@dataclass(frozen=True, slots=True)
class IndiMessage:
    """One message of the server: ``defNumberVector``, ``setBLOBVector``, ``delProperty``, ``message`` ..."""

    tag: str
    attributes: Mapping[str, str]
    elements: tuple[IndiElement, ...] = ()

    @property
    def device(self) -> str:
        """Device that it is about; empty for all."""
        return self.attributes.get("device", "")

    @property
    def name(self) -> str:
        """Property that it is about; empty for all."""
        return self.attributes.get("name", "")


@dataclass(slots=True)
class _Open:
    """An element whose end has not come."""

    tag: str
    attributes: dict[str, str]
    pieces: list[str] = field(default_factory=list)


class IndiReader:
    """Incremental parser of what a server sends.

    Parameters
    ----------
    name
        What is at the other end, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        # Drivers pass on labels in other encodings than they declare, and what a device says with control characters; a
        # bad letter must not end the session.
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = True
        # Newer expat waits for more input before it looks at the end of a message again; none may come.
        if hasattr(self._parser, "SetReparseDeferralEnabled"):
            self._parser.SetReparseDeferralEnabled(False)
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._text
        self._open: list[_Open] = []
        self._elements: list[IndiElement] = []
        self._finished: list[IndiMessage] = []
        self._finished_at = 0
        self._fed = 0
        # Inside an element XML allows no document type, and so no entities: nothing grows while it is read.
        self._parser.Parse("<root>", False)

    def feed(self, data: bytes) -> list[IndiMessage]:
        """Take in what came and return the messages that it completes.

        Raises
        ------
        LostError
            It is no INDI, or a message exceeds every limit; the connection is of no more use.
        """
        text = self._decoder.decode(data).translate(_NO_XML)
        try:
            for start in range(0, len(text), _PIECE_CHARACTERS):
                self._feed_piece(text[start : start + _PIECE_CHARACTERS])
        except expat.ExpatError as error:
            raise self._no_indi(f"XML {error}") from error
        messages, self._finished = self._finished, []
        return messages

    def _feed_piece(self, piece: str) -> None:
        self._parser.Parse(piece, False)
        self._fed += len(piece.encode())
        is_blob = len(self._open) > 1 and self._open[1].tag == "setBLOBVector"
        limit = _LONGEST_BLOB_MESSAGE_BYTES if is_blob else LONGEST_MESSAGE_BYTES
        # A piece may hold the whole limit and the start of what follows.
        if self._fed - self._finished_at > limit + _PIECE_CHARACTERS:
            raise self._no_indi(f"a message longer than {limit} bytes")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if len(self._open) >= _NESTING:
            raise self._no_indi(f"<{tag}> inside <{self._open[-1].tag}>")
        self._open.append(_Open(tag, attributes))

    def _text(self, text: str) -> None:
        if len(self._open) == _NESTING:
            self._open[-1].pieces.append(text)

    def _end(self, tag: str) -> None:
        if len(self._open) == 1:
            raise self._no_indi(f"</{tag}> without a start")
        ended = self._open.pop()
        if len(self._open) == _NESTING - 1:
            self._elements.append(IndiElement(ended.attributes, "".join(ended.pieces).strip()))
        else:
            self._finished.append(IndiMessage(ended.tag, ended.attributes, tuple(self._elements)))
            self._elements = []
            self._finished_at = self._parser.CurrentByteIndex

    def _no_indi(self, what: str) -> LostError:
        return LostError(f"{self._name}: sends {what}; check that an INDI server listens at this address")


def new_vector(kind: str, device: str, name: str, values: Mapping[str, str]) -> bytes:
    """Return the message that asks for new values of a property; `kind` is Number, Switch or Text."""
    members = "".join(
        f"<one{kind} name={quoteattr(member)}>{escape(value)}</one{kind}>" for member, value in values.items()
    )
    head = f"<new{kind}Vector device={quoteattr(device)} name={quoteattr(name)}>"
    return f"{head}{members}</new{kind}Vector>\n".encode()


def get_properties(device: str = "", name: str = "") -> bytes:
    """Return the message that asks for all properties, those of a device, or one."""
    which = (f" device={quoteattr(device)}" if device else "") + (f" name={quoteattr(name)}" if name else "")
    return f'<getProperties version="1.7"{which}/>\n'.encode()


def enable_blobs(device: str) -> bytes:
    """Return the message that asks for the frames of a device beside everything else."""
    return f"<enableBLOB device={quoteattr(device)}>Also</enableBLOB>\n".encode()


def number(text: str, name: str) -> float:
    """Return the number that a member holds; `name` says where, for the message.

    Raises
    ------
    LostError
        It is not a finite decimal number.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise LostError(f"{name} is {text[:40]!r}, which is not a number; restart the INDI driver")
    return value


def blob_bytes(blob: IndiElement, name: str) -> bytes:
    """Return what a BLOB holds, unpacked where its format ends in ``.z``.

    Raises
    ------
    BadFrameError
        It cannot be decoded, or its length differs from the one that it states.
    """
    try:
        data = base64.b64decode("".join(blob.text.split()), validate=True)
        if blob.attributes.get("format", "").endswith(".z"):
            unpacking = zlib.decompressobj()
            data = unpacking.decompress(data, LARGEST_BLOB_BYTES)
            if not unpacking.eof:
                raise BadFrameError(
                    f"{name}: the compressed frame is truncated or larger than {LARGEST_BLOB_BYTES} bytes"
                )
    except (binascii.Error, ValueError, zlib.error) as error:
        raise BadFrameError(f"{name}: the frame cannot be decoded ({error}); expose again") from error
    stated = blob.attributes.get("size", "")
    if stated and stated != str(len(data)):
        raise BadFrameError(
            f"{name}: the frame has {len(data)} bytes, but states a size of {stated[:20]} bytes; expose again"
        )
    return data
