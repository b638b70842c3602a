"""How a capture ends before its time: cleanly, and with a word on how to go on."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from data_schemas.errors import FinrayError
from finray_calib.cli.options import warn
from rigs.capture.journal import JOURNAL_NAME
from rigs.capture.session_folder import SESSION_NAME, lacks_manifest


@contextmanager
def interruptible(out: Path) -> Iterator[None]:
    """Let SIGTERM and a closed terminal end a capture as Ctrl-C does, and say how to go on."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    except (KeyboardInterrupt, FinrayError, OSError):
        if (out / JOURNAL_NAME).exists() and (not (out / SESSION_NAME).exists() or lacks_manifest(out)):
            warn(f"{out}: holds what was captured so far; go on with: finray capture --resume {out}")
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
