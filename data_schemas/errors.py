"""Every error that finray raises for a user.

The tree (the command line prints the message and ends with status 2; no traceback)::

    FinrayError
    ├── RecordError            a stored record, plan, rig or design file is not what it must be
    │   ├── FieldError         a record or design made in Python has a value that is not allowed
    │   ├── NewerSchemaError   written by a newer finray
    │   └── ChecksumError      a stored file was changed or is missing
    ├── ImportFormatError      a foreign file or folder is not in the format it claims
    ├── CurveError             a spectral curve or re-radiation matrix is unusable or out of range
    ├── CaptureError           a capture could not be done as planned
    │   ├── SaturatedError     no allowed exposure avoids saturation
    │   ├── RefusedError       a device refuses what was asked, or cannot do it
    │   │   └── FrameSizeError a frame has another size than the rig file says
    │   ├── TimedOutError      a device did not answer or finish before its deadline
    │   ├── LostError          the connection to a device broke
    │   ├── WrongPositionError a filter wheel stands somewhere else than it should
    │   ├── SignalChangedError a frame shows another signal than was metered before
    │   ├── BadFrameError      a frame is torn, stale or not what was asked for
    │   └── UnsafeError        a light could not be confirmed off
    ├── RadiometryError        frames cannot be turned into band signals
    ├── FitError               band signals cannot be fitted
    ├── SimulateError          a scene cannot be built or rendered
    │   ├── ImpossibleFingerError  a finger of these numbers cannot be made, or seen by its camera
    │   └── NoEquilibriumError a press ended before what was asked for
    ├── CompareError           a render and a capture cannot be compared
    ├── DecideError            a sweep does not allow a decision
    ├── MissingExtraError      an optional package or system library is needed
    └── ProcessDiedError              a process of its own died, or did not end in time

Messages name the thing (file and field, or device), what was asked, what is allowed with units, and what
to do next.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Final


class FinrayError(Exception):
    """Base of all errors that a user can act on."""


class RecordError(FinrayError):
    """A stored record, plan, rig or design file is not what it must be."""


class FieldError(RecordError, ValueError):
    """A record, a design or a part of one was made in Python with a value that is not allowed.

    It stands in the place of pydantic's ``ValidationError`` where a class is called; ``model_validate``,
    ``model_validate_json`` and a ``TypeAdapter`` still raise pydantic's.
    """

    @property
    def without_field(self) -> str:
        """What is wrong without the name of the field, for files whose columns have other names."""
        return re.sub(r"^'[^']*'( \(in [^)]*\))?: ", "", str(self))


class NewerSchemaError(RecordError):
    """A record was written by a newer version of finray."""


class ChecksumError(RecordError):
    """A stored file is missing or differs from its recorded checksum."""


class ImportFormatError(FinrayError):
    """A foreign file or folder is not in the format it claims."""


class CurveError(FinrayError):
    """A spectral curve or re-radiation matrix is unusable or does not cover what is asked."""


class CaptureError(FinrayError):
    """A capture could not be done as planned."""


class SaturatedError(CaptureError):
    """No allowed exposure avoids saturation."""


class RefusedError(CaptureError):
    """A device refuses what was asked, or cannot do it."""


class FrameSizeError(RefusedError):
    """A frame has another size than the rig file says; another attempt may succeed."""


class TimedOutError(CaptureError):
    """A device did not answer, or did not finish, before its deadline."""


class LostError(CaptureError):
    """The connection to a device broke, or the device left it."""


class WrongPositionError(CaptureError):
    """A filter wheel stands somewhere else than it should."""


class SignalChangedError(CaptureError):
    """A frame shows another signal than was metered before: one of the two was taken at a faulty rig."""


class BadFrameError(CaptureError):
    """A frame is torn, stale, or not what was asked for; another attempt may succeed."""


class UnsafeError(CaptureError):
    """A light could not be confirmed off, or a stage not be seen to stop."""


class RadiometryError(FinrayError):
    """Frames cannot be turned into band signals."""


class FitError(FinrayError):
    """Band signals cannot be fitted."""


class SimulateError(FinrayError):
    """A scene cannot be built or rendered."""


class ImpossibleFingerError(SimulateError):
    """A finger of these numbers and paints cannot be made, or its camera does not see enough of the pad."""


class NoEquilibriumError(SimulateError):
    """A press found no equilibrium beyond some share of its load; `reason` says what ended its search."""

    reason = ""


class CompareError(FinrayError):
    """A render and a capture cannot be compared."""


class DecideError(FinrayError):
    """A sweep does not allow a decision."""


class MissingExtraError(FinrayError):
    """An optional package or system library is needed for what was asked."""


class ProcessDiedError(FinrayError):
    """A child process died, or did not end in time; what it had stored before is complete."""


def why_failed(error: FinrayError) -> str:
    """Return why one of many pieces of work failed, for the list of those that did.

    A wrong field is said to be one of a record that finray made: files are read without that error, so that the fault
    is more likely in the program than in what was asked.
    """
    return f"finray made an invalid record: {error}" if isinstance(error, FieldError) else str(error)


@contextmanager
def naming(kind: type[FinrayError], *paths: Path) -> Iterator[None]:
    """Put the names of the files in front of an error of this kind, whose raiser does not know them."""
    try:
        yield
    except kind as error:
        if not paths or any(str(error).startswith((f"{path}:", f"{path},", f"{path}/")) for path in paths):
            raise
        raise type(error)(f"{' and '.join(map(str, paths))}: {error}") from None


_KEEPS_OPTIONS: Final = ContextVar("_KEEPS_OPTIONS", default=False)


@contextmanager
def keeping_options() -> Iterator[None]:
    """Leave options of the command line in errors of the library, whose functions the command line calls."""
    token = _KEEPS_OPTIONS.set(True)
    try:
        yield
    finally:
        _KEEPS_OPTIONS.reset(token)


def keeps_options() -> bool:
    """Return whether the command line calls, so that errors name its options and not arguments of the library."""
    return _KEEPS_OPTIONS.get()


def system_words(error: BaseException) -> str:
    """Return what the operating system, or a library over it, says of an error: words without ``[Errno 28]``."""
    told = error.args[1] if type(error).__name__ == "error" and len(error.args) == 2 else error  # termios.error
    text = re.sub(r"\[Errno -?\d+\] ?", "", str(told)).strip()
    if not text:
        silent = {"TimeoutError": "it took too long", "ConnectionResetError": "the other end closed the connection"}
        return silent.get(type(error).__name__, type(error).__name__)
    return text if text[1:2].isupper() else text[0].lower() + text[1:]


_HIDDEN_ENDINGS = (".finray.part", ".finray.set")


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Give an error of the operating system the name of the file that was written, not none and not a hidden one."""
    try:
        yield
    except OSError as error:
        if error.filename is None or str(error.filename).endswith(_HIDDEN_ENDINGS):
            error.filename = str(path)
        raise
