"""The journal of a session: one JSON object per line, on disk before the next step begins."""

import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any

from data_schemas.errors import CaptureError
from rigs.protocols import Clock

JOURNAL_NAME = "journal.jsonl"


class Journal:
    """Append-only log of a session; a ``with`` block that closes with the outcome ("done" or the error).

    Parameters
    ----------
    folder
        Folder of the session.
    clock
        Where the time of each line comes from.

    Raises
    ------
    CaptureError
        The folder holds a journal already: another capture writes there.
    """

    def __init__(self, folder: Path, clock: Clock):
        self._clock = clock
        try:
            self._file = (folder / JOURNAL_NAME).open("x", encoding="utf-8")
        except FileExistsError:
            raise CaptureError(
                f"{folder / JOURNAL_NAME}: exists already, so that another capture writes into this folder; choose "
                "another --out"
            ) from None

    def append(self, event: str, **what: Any) -> None:
        """Write one line (start, step, frame, note or stop) and wait until it is on the disk."""
        line = {"event": event, "utc": self._clock.utc(), "monotonic_s": round(self._clock.monotonic_s(), 3), **what}
        self._file.write(json.dumps(line, ensure_ascii=False) + "\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def __enter__(self) -> "Journal":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        outcome = "done" if error is None else f"{type(error).__name__}: {error}"
        try:
            self.append("stop", outcome=outcome)
        finally:
            self._file.close()
