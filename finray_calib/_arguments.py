"""What the functions of the library take and tell: records or paths, lists, seeds, options; origins and errors.

Every argument is checked before any work is done. An error that a package below raises in the words of the command
line names the argument of the function in place of the option.
"""

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from contextlib import contextmanager
from operator import index
from pathlib import Path
from typing import Any, Final, TypeVar

from data_schemas import FinrayError, Record, RecordError, keeps_options, kind_in_words, needed_kind, provenance
from data_schemas import naming as naming_files
from data_schemas.storage import digest_as_read, given_path
from data_schemas.storage import read_record as read_stored

R = TypeVar("R", bound=Record)
PathLike = str | os.PathLike[str]
NOT_IN_ORDER: Final = (str, bytes, Mapping, Set)
"""What Python can walk through, yet is no list: a text by its characters, a dict and a set in no order of the user."""


def given(what: R | PathLike, kind: type[R]) -> tuple[R, list[Path]]:
    """Return a record that was given as itself or as the path of a stored one, and the files that were read.

    Raises
    ------
    RecordError
        It is neither, of another kind, or cannot be read.
    """
    if isinstance(what, kind):
        return what, []
    if isinstance(what, str | os.PathLike):
        path = given_path(what, kind.__name__)
        return read_stored(path, kind), [path]
    raise RecordError(
        f"{needed_kind(kind.__name__)} (a {kind.__name__} or the path of its file), but {_in_words(what)} was given"
    )


def _in_words(what: object) -> str:
    """Return what a user gave, in words, such as "a paint calibration" or "a value of type int"."""
    if isinstance(what, Record):
        return kind_in_words(type(what).__name__)
    return "a single path" if isinstance(what, str | os.PathLike) else f"a value of type {type(what).__name__}"


def given_list(what: object, kind: type[Record], argument: str) -> list[Any]:
    """Return the records and paths of a list that the user gave.

    Raises
    ------
    RecordError
        It is no list, such as a record or a path alone, a dict or a set.
    """
    if isinstance(what, (Record, os.PathLike, *NOT_IN_ORDER)) or not isinstance(what, Iterable):
        if isinstance(what, Record) and not isinstance(what, kind):
            raise RecordError(f"{argument}: {needed_kind(kind.__name__)}, but {_in_words(what)} was given")
        raise RecordError(
            f"{argument}: must be a list whose elements are each a {kind.__name__} or the path of its file, but "
            f"{_in_words(what)} was given"
        )
    return list(what)


def checked_seed(seed: int) -> int:
    """Return a seed that the random generators and the record can hold; asked for before any work is done.

    Raises
    ------
    RecordError
        It is not a whole number from 0 to 2^63 - 1.
    """
    try:
        number = -1 if isinstance(seed, bool) else index(seed)
    except TypeError:
        number = -1
    if not 0 <= number < 2**63:
        raise RecordError(f"seed={seed!r}: must be a whole number from 0 to 2^63 - 1, such as 1")
    return number


def require_truths(**options: object) -> None:
    """Refuse options that are neither true nor false, before any work is done: the text "no" would count as true.

    Raises
    ------
    RecordError
        One is something else; the message names it.
    """
    for name, value in options.items():
        if not isinstance(value, bool) and type(value).__name__ not in ("bool", "bool_"):  # numpy's, not imported here
            raise RecordError(f"{name}={value!r}: must be True or False")


def made(record: R, call: str, inputs: Iterable[Path], seed: int | None = None) -> R:
    """Return a record with its origin: the function of the library, the files that went in, and the seed."""
    return record.model_copy(
        update={"provenance": provenance(f"finray_calib.{call}, from Python", digests_of(inputs), seed)}
    )


def digests_of(paths: Iterable[Path]) -> dict[str, str]:
    """Return path as given -> SHA-256 of the bytes that were read, of the files that were."""
    read = {path.as_posix(): digest_as_read(path) for path in paths}
    return {name: digest for name, digest in read.items() if digest is not None}


def digest_of(record: Record, files: list[Path]) -> str:
    """Return the SHA-256 that stands for a record: of its file, or of its content where it has none."""
    if files and (digest := digest_as_read(files[0])) is not None:
        return digest
    return hashlib.sha256(record.model_dump_json(exclude={"provenance"}).encode()).hexdigest()


Progress = Callable[[int, int, str], None]


def require_progress(progress: object) -> None:
    """Refuse what cannot be called to tell of progress; asked for before any work is done.

    Raises
    ------
    RecordError
        It is no function.
    """
    if progress is not None and not callable(progress):
        raise RecordError(
            f"progress={progress!r}: must be None or a function of three arguments (steps done, steps in total, a "
            "text), such as print"
        )


_ARGUMENTS: Final = {
    "'finray simulate render --paint'": "render_press",
    "('finray fit --family')": "(fit_paint with family=)",
    "--accept-repeat": "accept_repeat=True",
    "--aim brightness": "aim='brightness'",
    "--angles": "angles_deg",
    "--assume-yield Y": "options.assumed_yield",
    "--assume-yield": "options.assumed_yield",
    "--calibrated": "options.calibrated=True",
    "--captures": "captures",
    "--engine llvm": "engine='llvm'",
    "--engine scalar": "engine='scalar'",
    "--free": "free",
    "--increments 4": "increments=4",
    "--known-first-touch": "known_first_touch",
    "--lamp": "options.lamp",
    "--laser-fwhm-nm": "options.laser_fwhm_nm",
    "--laser-nm": "options.laser_nm",
    "--level b": "level='b'",
    "--objectives all": "all_objectives=True",
    "--objectives intensity": "all_objectives=False",
    "--other-light": "other_lights",
    "--paint files": "paints (red, green)",
    "--out": "out",
    "--paint-name": "options.paint_name",
    "--paint red=FILE and --paint green=FILE": "red and green",
    "--pose-response": "pose_response",
    "--register": "register",
    "--relative": "relative",
    "--response": "options.response",
    "--rig RIG": "rig",
    "--samples": "samples",
    "--shared-light": "shared_light",
    "--surfaces": "surfaces",
    "--weights": "weights",
    "--white-balance": "white_balance",
    "--white-reflectance": "options.white_reflectance",
    "--white-uncertainty-rel": "options.white_uncertainty_rel",
}
"""Option of the command line, as errors of the packages below name it -> argument of the library."""


@contextmanager
def naming(kind: type[FinrayError], *paths: Path) -> Iterator[None]:
    """Put the files in front of an error of this kind, and arguments in place of options of the command line."""
    try:
        with naming_files(kind, *paths):
            yield
    except FinrayError as error:
        if keeps_options():
            raise
        told = str(error)
        for option, argument in _ARGUMENTS.items():
            # an option as a word, not as a part of a path or of a longer option
            told = re.sub(rf"(?<![\w./-]){re.escape(option)}(?![\w/-])", argument, told)
        if told == str(error):
            raise
        raise type(error)(told) from None
