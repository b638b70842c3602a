"""A container of tactile captures: the files of a folder of captures that go into one zip archive.

The layout is a standard that others can write without this program: docs/reference/tactile-captures.md.
"""

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from data_schemas import RecordError, SimulatedPress, TactileCapture
from data_schemas.storage import MANIFEST_NAME, files_in, folder_at, read_bytes, read_json, read_record

CAPTURE: Final = ".capture.json"
PRESS: Final = ".press.json"
_BESIDE: Final = re.compile(r"contacts\.png|circles\.csv|(readme|licen[cs]e|copying)[\w.-]*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class CaptureContainer:
    """What of a folder goes into a container.

    Attributes
    ----------
    captures
        Number of captures.
    presses
        Number of simulated presses.
    files
        All files, in the order of the archive; the checksums come after them.
    left_out
        Files that belong to no capture and no press.
    """

    captures: int
    presses: int
    files: tuple[Path, ...]
    left_out: tuple[Path, ...]

    def contents(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and content of each file, one after the other, and last the checksums of all."""
        lines = []
        for path in self.files:
            content = read_bytes(path)
            lines.append(f"{hashlib.sha256(content).hexdigest()}  {path.name}\n")
            yield path.name, content
        yield MANIFEST_NAME, "".join(lines).encode()


def capture_container(place: Path) -> CaptureContainer:
    """Return what of a folder goes into a container, after every record in it was read and found complete.

    Captures and simulated presses go in with their arrays, and what belongs to all: the picture of the contacts, the
    list of circles, texts named README or LICENSE.

    Parameters
    ----------
    place
        Folder of NAME.capture.json.

    Raises
    ------
    RecordError
        It is no folder or holds no capture.
    FinrayError
        A record in it is damaged.
    """
    folder = folder_at(place)
    inside = [] if folder is None else [path for path in files_in(folder) if not path.name.startswith(".")]
    captures = [path for path in inside if path.name.endswith(CAPTURE)]
    presses = [path for path in inside if path.name.endswith(PRESS)]
    if not captures:
        raise RecordError(
            f"{place}: holds no NAME{CAPTURE}; give a folder of captures, as 'finray import captures' writes it"
        )
    for path in captures:
        read_record(path, TactileCapture)
    for path in presses:
        read_record(path, SimulatedPress)
    records = [*captures, *presses]
    wanted = {*records, *_arrays(records), *(path for path in inside if _BESIDE.fullmatch(path.name))}
    left_out = tuple(path for path in inside if path not in wanted and path.name != MANIFEST_NAME)
    return CaptureContainer(len(captures), len(presses), tuple(sorted(wanted)), left_out)


def _arrays(records: Sequence[Path]) -> Iterator[Path]:
    """Yield the files that hold the arrays of records which were read."""
    for path in records:
        array_file = read_json(path).get("array_file")
        if array_file is not None:
            yield path.with_name(str(array_file["file"]))
