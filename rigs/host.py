"""The computer and the person at a real rig: system clock and terminal operator."""

import sys
import time
from datetime import UTC, datetime

from data_schemas.capture import Target
from data_schemas.errors import CaptureError

_TARGETS: dict[Target, str] = {
    "white": "Put the white tile in view, swing the filter wheel into the beam and close the box.",
    "sample": "Put the paint sample in view, swing the filter wheel into the beam and close the box.",
    "sample beside ColorChecker": "Put the sample beside the ColorChecker in view, swing the filter wheel out of the "
    "beam, open the box and switch the room light on.",
}


class SystemClock:
    """Clock of the host."""

    def utc(self) -> str:
        """Return the time of day, ISO 8601, UTC."""
        return datetime.now(UTC).isoformat(timespec="milliseconds")

    def monotonic_s(self) -> float:
        """Return seconds since an arbitrary start."""
        return time.monotonic()


class TerminalOperator:
    """A person at the terminal: reads an instruction, does it, presses Enter."""

    def __init__(self) -> None:
        self._in_view: Target | None = None

    def place(self, target: Target) -> None:
        """Have `target` put in view; nothing is asked when it is there already."""
        if target != self._in_view:
            self._in_view = None
            self.do(_TARGETS[target])
            self._in_view = target

    def swing_wheel_out(self) -> None:
        """Have the filter wheel swung out of the beam."""
        # The next place() asks for the wheel to be swung in again.
        self._in_view = None
        self.do("Swing the filter wheel out of the beam.")

    def tilt(self, angle_deg: float) -> None:
        """Have the sample tilted."""
        self.do(f"Turn the sample until its normal and the laser beam enclose {angle_deg:g} deg.")

    def do(self, instruction: str) -> None:
        """Show an instruction and wait for Enter.

        Raises
        ------
        CaptureError
            Nobody can answer: standard input is closed.
        """
        sys.stderr.write(f"\n{instruction}\nPress Enter when done. ")
        sys.stderr.flush()
        if not sys.stdin.readline():
            raise CaptureError(
                f"operator: '{instruction}' needs a person, and standard input is closed; run the capture in a terminal"
            )
