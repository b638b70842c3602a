"""Trace a record to what was captured, hash every file on the way again, and compute a record again.

An input is looked for by its recorded name, relative to the record, to the folders above it and to the working
directory, and then by its SHA-256 among the files beside the record. What is found is compared with the SHA-256 that
the record holds; records are checked against their seals as well, sessions frame by frame. All files of a folder are
checked in the same way.

To compute a record again its command is run into a temporary folder, and the numbers are compared. The command is
taken apart into words and run without a shell. Names of inputs become the files that were found for them, names of
outputs lead into the temporary folder. Nothing is written anywhere else.
"""

import math
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
from pydantic import ValidationError

from data_schemas import FinrayError, Provenance, RecordError
from data_schemas.json_schemas import STORED
from data_schemas.storage import (
    A_RECORD,
    MANIFEST_NAME,
    FileFault,
    FileState,
    files_below,
    files_in,
    folder_at,
    has_file,
    manifest_faults,
    read_json,
    read_record,
    sha256_of,
    stored_kind,
)
from rigs.capture import JOURNAL_NAME, SESSION_KINDS, SESSION_NAME, verify_session

KINDS: Final = {record_type.__name__: record_type for record_type in STORED}
FOLDERS_ABOVE: Final = 4
"""Of a record, in which its inputs are looked for by name."""
MOST_NEIGHBOURS: Final = 200
"""Files beside a record that are hashed in search of an input whose name changed."""


@dataclass(frozen=True, slots=True)
class Traced:
    """A file of the tree.

    Attributes
    ----------
    name
        As the record that was made from it names it.
    path
        Where it was found; None where it was not.
    kind
        Kind of a record, "file" of anything else.
    faults
        What is wrong with it, with its own files (arrays, pages, frames) and with its name.
    notes
        What cannot be checked, or does no harm.
    inputs
        What it was made from.
    frames
        Frames of a session that are as they were captured.
    is_repeated
        Whether its inputs stand at an earlier place of the tree.
    is_dirty
        Whether it was made by sources that differed from the commit that it names.
    """

    name: str
    path: Path | None
    kind: str
    faults: tuple[FileFault, ...] = ()
    notes: tuple[str, ...] = ()
    inputs: tuple["Traced", ...] = ()
    frames: int = 0
    is_repeated: bool = False
    is_dirty: bool = False

    def all(self) -> Iterator["Traced"]:
        """Yield this file and all below it, each place of the tree once."""
        yield self
        for part in self.inputs:
            yield from part.all()

    @property
    def is_intact(self) -> bool:
        """Whether nothing is wrong with it and all below it."""
        return not any(part.faults for part in self.all())


class Tracer:
    """Traces records; what was hashed once is not hashed again.

    Parameters
    ----------
    working
        Directory in which recorded names may start beside the folders of the record.
    moved_sessions
        Whether the files that a session read may be elsewhere: its record holds their content.
    """

    def __init__(self, working: Path | None = None, *, moved_sessions: bool = False):
        self._moved_sessions = moved_sessions
        self._working = Path.cwd() if working is None else working
        self._digests: dict[Path, str] = {}
        self._traced: dict[Path, Traced] = {}
        self._open: set[Path] = set()

    @property
    def digests(self) -> Mapping[Path, str]:
        """SHA-256 of the files that were hashed, by resolved path."""
        return self._digests

    def trace(self, path: Path) -> Traced:
        """Trace a stored record.

        Raises
        ------
        RecordError
            There is no such file, or it is no record at all.
        """
        if folder_at(path) is not None:
            raise RecordError(
                f"{path}: is a folder or a zip archive; give the path of {A_RECORD}, or check a folder with 'finray "
                "verify'"
            )
        if not path.exists() and not has_file(path):
            raise RecordError(f"{path}: no such file; give the path of {A_RECORD}")
        traced = self._traced_file(str(path), path, None, None)
        if traced.kind == "file" and not traced.faults:
            raise RecordError(
                f"{path}: is not a stored record (a JSON object with 'kind' and 'record'); give the path of {A_RECORD}"
            )
        return traced

    def _traced_file(self, name: str, path: Path, wanted: str | None, consumer: Provenance | None) -> Traced:
        """Trace a file that was found, and compare it with the SHA-256 that is wanted."""
        place = path.resolve()
        if place in self._open:
            return Traced(name, path, "file", (FileFault(path, "changed", "is made from itself"),))
        if place in self._traced:
            before = self._traced[place]
            own = Traced(name, path, before.kind, frames=before.frames, is_repeated=True)
        else:
            self._open.add(place)
            own = self._own(name, path)
            self._open.discard(place)
            before = self._traced[place] = own
        return replace(own, faults=(*self._unlike(path, wanted, consumer, before), *own.faults))

    def _own(self, name: str, path: Path) -> Traced:
        """Trace a file by itself."""
        if path.suffix != ".json":
            return Traced(name, path, "file")
        try:
            envelope = read_json(path, A_RECORD)
        except FinrayError as error:
            return Traced(name, path, "file", (_changed(path, error),))
        kind = stored_kind(envelope)
        if kind is None or kind not in KINDS:
            return Traced(name, path, "file")
        return self._record(name, path, envelope, kind)

    def _record(self, name: str, path: Path, envelope: dict[str, Any], kind: str) -> Traced:
        """Trace a record: its seal, the files that belong to it, and its inputs."""
        faults = [*self._belonging(path, envelope)]
        provenance = _provenance(envelope)
        try:
            read_record(path, KINDS[kind])
        except FinrayError as error:
            if not faults:  # else they say it already
                faults.append(_changed(path, error))
        no_seal = "has no seal (a checksum of its content), because an early version wrote it"
        notes = [] if "content_sha256" in envelope else [no_seal]
        frames = 0
        if kind in SESSION_KINDS and path.name == SESSION_NAME:
            check = verify_session(path.parent)
            self._digests.update({file.resolve(): digest for file, digest in check.digests.items()})
            faults = [*check.faults]
            notes += [*check.notes]
            frames = sum(file.parent.name == "frames" for file in check.digests)
        inputs = () if provenance is None else self._inputs(path, provenance)
        is_dirty = provenance is not None and bool(provenance.git_dirty)
        return Traced(name, path, kind, tuple(faults), tuple(notes), inputs, frames, is_dirty=is_dirty)

    def _belonging(self, path: Path, envelope: dict[str, Any]) -> Iterator[FileFault]:
        """Yield what is wrong with the array file and the companions of a record."""
        array_file, companions = envelope.get("array_file"), envelope.get("companions")
        named: dict[str, str] = dict(companions) if isinstance(companions, dict) else {}
        if isinstance(array_file, dict):
            named[str(array_file.get("file"))] = str(array_file.get("sha256"))
        for name, digest in named.items():
            file = path.parent / name
            if not has_file(file):
                yield FileFault(file, "missing", f"is missing; it belongs to {path.name}")
            elif not file.resolve().is_relative_to(path.parent.resolve()):
                yield FileFault(path, "changed", f"names {name!r}, which is outside of its folder")
            elif self._digest(file) != digest:
                yield FileFault(file, "changed", f"was changed: its SHA-256 is not the one in {path.name}")

    def _inputs(self, path: Path, provenance: Provenance) -> tuple[Traced, ...]:
        """Trace the inputs of a record."""
        return tuple(
            self._input(path, name, digest, provenance) for name, digest in sorted(provenance.input_sha256.items())
        )

    def _input(self, path: Path, name: str, digest: str, provenance: Provenance) -> Traced:
        """Find and trace one input of a record."""
        named = [file for file in self._candidates(path.parent, name) if has_file(file)]
        for file in named:
            if self._digest(file) == digest:
                return self._traced_file(name, file, digest, provenance)
        beside = [file for file in files_in(path.parent) if file.suffix == PurePosixPath(name).suffix]
        for file in beside[:MOST_NEIGHBOURS]:
            if self._digest(file) == digest:
                found = self._traced_file(name, file, digest, provenance)
                return replace(found, notes=(f"found by its SHA-256 as {file}", *found.notes))
        if named:
            return self._traced_file(name, named[0], digest, provenance)
        if self._moved_sessions and path.name == SESSION_NAME:  # which holds plan, rig and curves itself
            return Traced(name, None, "file", notes=(f"not found; {SESSION_NAME} holds what was read from it",))
        missing = FileFault(path.parent / name, "missing", f"is missing; {path.name} was made from it")
        return Traced(name, None, "file", (missing,))

    def _candidates(self, folder: Path, name: str) -> Iterator[Path]:
        """Yield where a recorded name may lead, the likeliest first."""
        recorded = Path(name)
        if recorded.is_absolute():
            yield recorded
        above = [folder, *folder.resolve().parents[:FOLDERS_ABOVE]]
        if not recorded.is_absolute():
            for start in (folder, self._working, *above[1:]):
                yield start / recorded
        parts = recorded.parts
        for first in range(1, len(parts)):
            for start in above:
                yield start.joinpath(*parts[first:])

    def _unlike(
        self, path: Path, wanted: str | None, consumer: Provenance | None, own: Traced
    ) -> tuple[FileFault, ...]:
        """Return what is wrong with a file whose SHA-256 is not the wanted one."""
        if wanted is None or self._digest(path) == wanted or own.faults:
            return ()
        made = _created(path) if own.kind in KINDS else None
        used = None if consumer is None else _time(consumer.created_utc)
        if made is not None and used is not None and made >= used:
            text = f"was made again at {made.isoformat()}, after records had been made from it: make the records again"
            return (FileFault(path, "stale", text),)
        return (FileFault(path, "changed", "is not the file that was read: its SHA-256 differs"),)

    def _digest(self, file: Path) -> str | None:
        """Return the SHA-256 of a file as it is now; None where it cannot be read."""
        place = file.resolve()
        if place not in self._digests:
            try:
                self._digests[place] = sha256_of(place)
            except RecordError:
                return None
        return self._digests[place]


def findings(traced: Traced) -> tuple[FileFault, ...]:
    """Return all faults of a tree, each once, missing files first."""
    order: dict[FileState, int] = {"missing": 0, "changed": 1, "stale": 2}
    faults = dict.fromkeys(fault for part in traced.all() for fault in part.faults)
    return tuple(sorted(faults, key=lambda fault: (order[fault.state], fault.path)))


def _changed(path: Path, error: FinrayError) -> FileFault:
    """Return the fault of a file that its reader refuses."""
    return FileFault(path, "changed", str(error).removeprefix(f"{path}: "))


def _created(path: Path) -> datetime | None:
    """Return when a record was written."""
    try:
        envelope = read_json(path, A_RECORD)
        return _time(envelope["record"]["provenance"]["created_utc"])
    except (FinrayError, KeyError, TypeError):
        return None


def _provenance(envelope: dict[str, Any]) -> Provenance | None:
    """Return the origin that a record names, be it damaged or not."""
    try:
        return Provenance.model_validate(envelope["record"]["provenance"])
    except (ValidationError, KeyError, TypeError):
        return None


def _time(text: str) -> datetime | None:
    """Return a time of day, or None where the text is none."""
    try:
        return datetime.fromisoformat(text)
    except (TypeError, ValueError):
        return None


DEMO_MARK: Final = ("demo.json", "report.html")
"""Files of a finished demo, which writes checksums of all its files last."""


@dataclass(frozen=True, slots=True)
class FolderCheck:
    """What was found in a folder.

    Attributes
    ----------
    records
        The records, with what they were made from.
    faults
        What has changed since it was written; empty where nothing has.
    notes
        What cannot be checked, or does no harm.
    hashed
        Number of files of the folder that were hashed.
    """

    records: tuple[Traced, ...]
    faults: tuple[FileFault, ...]
    notes: tuple[str, ...]
    hashed: int


def verify_folder(folder: Path) -> FolderCheck:
    """Re-hash all files of a folder that a record, a session or checksums name, and report what has changed.

    Raises
    ------
    RecordError
        There is no such folder, or nothing in it that could be checked.
    """
    inside = folder_at(folder)
    if inside is None:
        what = "is a file, not a folder (check a record with 'finray trace');" if folder.exists() else "no such folder;"
        raise RecordError(
            f"{folder}: {what} give the folder of a session or of products, or a zip archive of such a folder"
        )
    folder = inside
    tracer, records = Tracer(moved_sessions=True), list[Traced]()
    faults: dict[FileFault, None] = {}
    notes: dict[str, None] = {}
    for path in _visible(folder):
        if path.suffix == ".json":
            records += _record(tracer, path, faults)
    for traced in records:
        faults |= dict.fromkeys(findings(traced))
        notes |= dict.fromkeys(f"{part.path or part.name}: {note}" for part in traced.all() for note in part.notes)
    for session in _sessions(folder):
        check = verify_session(session)
        faults |= dict.fromkeys(check.faults)
        notes |= dict.fromkeys(f"{session / SESSION_NAME}: {note}" for note in check.notes)
    bound = set(tracer.digests) | _files_of(records)
    for listed in (path.parent for path in _visible(folder) if path.name == MANIFEST_NAME):
        of_manifest, unlisted = manifest_faults(listed, tracer.digests)
        told = {fault.path.resolve() for fault in faults}
        faults |= dict.fromkeys(fault for fault in of_manifest if fault.path.resolve() not in told)
        bound |= {path.resolve() for path in files_below(listed) if path not in (listed / MANIFEST_NAME, *unlisted)}
    dirty = {part.path for traced in records for part in traced.all() if part.is_dirty}
    if dirty:
        were, name = ("record was", "it names") if len(dirty) == 1 else ("records were", "they name")
        notes[f"{len(dirty)} {were} made by source code that differed from the commit that {name}"] = None
    faults |= dict.fromkeys(_missing_checksums(folder))
    notes |= dict.fromkeys(_unbound(folder, bound))
    hashed = sum(path.resolve() in bound for path in _visible(folder))
    if not (records or faults or hashed):
        raise RecordError(f"{folder}: holds no stored record, session or checksums; give a folder that finray wrote")
    return FolderCheck(tuple(records), tuple(faults), tuple(notes), hashed)


def _record(tracer: Tracer, path: Path, faults: dict[FileFault, None]) -> Iterator[Traced]:
    """Yield a JSON file traced as a record, if it is one; one that cannot be read is a fault."""
    try:
        envelope = read_json(path)
    except FinrayError as error:
        faults[_changed(path, error)] = None
        return
    if stored_kind(envelope) in KINDS:
        yield tracer.trace(path)


def _visible(folder: Path) -> list[Path]:
    """Return the files of a folder and below it that are not hidden."""
    return sorted(
        path for path in files_below(folder) if not any(part.startswith(".") for part in path.relative_to(folder).parts)
    )


def _sessions(folder: Path) -> list[Path]:
    """Return the folders of sessions, those among them that lost their record or journal as well."""
    marks = {path.parent for path in _visible(folder) if path.name == JOURNAL_NAME}
    marks |= {path.parent.parent for path in _visible(folder) if path.parent.name == "frames"}
    return sorted(mark for mark in marks if mark.is_relative_to(folder))


def _files_of(records: list[Traced]) -> set[Path]:
    """Return the records themselves, resolved, which their seals bind."""
    return {part.path.resolve() for traced in records for part in traced.all() if part.path is not None}


def _missing_checksums(folder: Path) -> Iterator[FileFault]:
    """Yield finished demos whose checksums are missing."""
    for mark in _visible(folder):
        demo = mark.parent
        is_finished = mark.name == DEMO_MARK[0] and all(has_file(demo / name) for name in DEMO_MARK)
        if is_finished and not has_file(demo / MANIFEST_NAME):
            yield FileFault(demo / MANIFEST_NAME, "missing", "the checksums of a finished demo are missing")


def _unbound(folder: Path, bound: set[Path]) -> Iterator[str]:
    """Yield what no record and no checksums speak of."""
    loose = [path for path in _visible(folder) if path.resolve() not in bound and path.name != MANIFEST_NAME]
    if loose:
        shown = ", ".join(str(path.relative_to(folder)) for path in loose[:5])
        more = f" and {len(loose) - 5} more" if len(loose) > 5 else ""
        yield f"not checked, because no record and no list of checksums names them: {shown}{more}"


REPLAYED: Final = ("radiometry", "fit", "simulate", "recolour", "compare", "decide", "import", "study", "demo")
"""Verbs that compute; what others did (a capture) cannot be done again."""
OUTPUTS: Final = ("--out", "--report")
TOLERANCE_REL: Final[Mapping[str, float]] = {
    "PaintCalibration": 2e-6,
    "PaintMap": 2e-6,
    "SimulatedPress": 2e-6,
    "LightAngleSweep": 2e-6,
    "PressMechanics": 1e-6,
    "FingerSurfaces": 1e-6,
    "PressIncrement": 1e-6,
    "PhotometricErrorReport": 2e-5,
    "LightAngleDecision": 2e-5,
}
"""Kind -> largest difference of a number over the largest magnitude of its field that a replay may have; else 0.

On one machine the numbers of a fit come out the same. Threads and vector units of another one take sums in another
order, so that last digits differ; draws and presses carry these further. Reports and decisions are made from such
records."""
MOST_DIFFERENCES: Final = 10


@dataclass(frozen=True, slots=True)
class Replayed:
    """How a record compares with what its command computes now.

    Attributes
    ----------
    agrees
        Whether all is within the tolerance of its kind.
    sentence
        The outcome in words.
    differences
        What differs by more, at most so many lines.
    """

    agrees: bool
    sentence: str
    differences: tuple[str, ...]


def replay(tree: Traced) -> Replayed:
    """Run the command of a traced, unchanged record again and compare.

    Raises
    ------
    RecordError
        The record holds no command that can be run again, or the command fails now.
    """
    path = tree.path
    assert path is not None  # noqa: S101 - a traced root was read
    record = read_record(path, KINDS[tree.kind])
    words = _words(path, record.provenance)
    with tempfile.TemporaryDirectory(prefix="finray-replay-") as made:
        folder = Path(made)
        arguments = _arguments(words, tree, folder)
        done = subprocess.run(
            [sys.executable, "-m", "finray_calib.cli.main", *arguments],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            said = done.stderr.strip().splitlines()
            raise RecordError(
                f"{path}: the command that made this record now fails: "
                f"{(said[-1] if said else f'status {done.returncode}')}"
            )
        again = read_record(_same_product(folder, path, tree.kind), KINDS[tree.kind])
    compared = compare(tree.kind, record.model_dump(exclude={"provenance"}), again.model_dump(exclude={"provenance"}))
    return replace(compared, differences=(*compared.differences, *_otherwise(record.provenance, again.provenance)))


def _otherwise(before: Provenance | None, again: Provenance | None) -> Iterator[str]:
    """Yield what else differs between the two runs and may explain a difference."""
    if before is None or again is None:
        return
    for name in ("git_commit", "git_dirty", "python_version", "processor", "renderer"):
        if getattr(before, name) != getattr(again, name):
            yield f"note: {name} was {getattr(before, name)}, is {getattr(again, name)}"
    for name in sorted(before.packages.keys() | again.packages.keys()):
        if before.packages.get(name) != again.packages.get(name):
            yield f"note: {name} was {before.packages.get(name)}, is {again.packages.get(name)}"


def _words(path: Path, provenance: Provenance | None) -> tuple[str, ...]:
    """Return the words of the command that made a record."""
    words = None if provenance is None else provenance.arguments
    if words is None:
        raise RecordError(f"{path}: contains no finray command, so it cannot be computed again")
    if words[0] not in REPLAYED:
        raise RecordError(
            f"{path}: was made by 'finray {words[0]}', which cannot be repeated; --replay supports only records of "
            f"{', '.join(REPLAYED)}"
        )
    return words


def _arguments(words: tuple[str, ...], tree: Traced, folder: Path) -> list[str]:
    """Return the words with inputs where they were found, and outputs in the folder."""
    found = {part.name: part.path.resolve() for part in tree.inputs if part.path is not None}
    arguments: list[str] = []
    is_output = False
    for word in words:
        option, equals, value = word.partition("=")
        if is_output:
            arguments.append(str(folder / Path(word).name))
        elif equals:
            place = folder / Path(value).name if _is_output(option) else _found(value, found)
            arguments.append(f"{option}={place}")
        else:
            arguments.append(_found(word, found))
        is_output = _is_output(word)
    return arguments


def _is_output(word: str) -> bool:
    """Return whether a word is an option of an output, or a beginning of it that is none of another option."""
    return word.startswith(("--o", "--rep")) and any(option.startswith(word) for option in OUTPUTS)


def _found(word: str, found: Mapping[str, Path]) -> str:
    """Return where the file or folder that a word names was found; the word itself where it names none."""
    if word.startswith("-"):
        return word
    plain = Path(word).as_posix()
    if plain in found:
        return str(found[plain])
    for name, path in found.items():
        if name.startswith(f"{plain}/"):
            below = Path(name).relative_to(plain).parts
            return str(path.parents[len(below) - 1])
    return str(Path(word).resolve()) if Path(word).exists() else word


def _same_product(folder: Path, path: Path, kind: str) -> Path:
    """Return the record that was made again: of the same kind, its name the likest."""

    def likeness(file: Path) -> int:
        pairs = zip(reversed(file.parts), reversed(path.resolve().parts), strict=False)
        return next((count for count, (a, b) in enumerate(pairs) if a != b), len(file.parts))

    made = [file for file in sorted(folder.rglob("*.json")) if _kind_of(file) == kind]
    if not made:
        raise RecordError(
            f"{path}: the command of this record does not make a {kind} in this version of finray; another version "
            "made it"
        )
    return max(made, key=likeness)


def _kind_of(file: Path) -> str | None:
    """Return the kind of a stored record."""
    try:
        return stored_kind(read_json(file))
    except FinrayError:
        return None


def compare(kind: str, before: Mapping[str, Any], again: Mapping[str, Any]) -> Replayed:
    """Compare the contents of two records of a kind, field by field.

    Parameters
    ----------
    kind
        Kind of both.
    before, again
        Their fields, arrays as arrays.
    """
    tolerance_rel = TOLERANCE_REL.get(kind, 0.0)
    values = changed = 0
    largest_rel, told = 0.0, list[str]()
    for place, a, b in _pairs("", before, again):
        if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.shape == b.shape:
            count, differing, difference_rel = _array_difference(a, b)
        else:
            count, differing = 1, int(not _same(a, b))
            difference_rel = _number_difference(a, b) if differing else 0.0
        values, changed = values + count, changed + differing
        largest_rel = max(largest_rel, difference_rel)
        if difference_rel > tolerance_rel:
            told.append(f"{place}: {_shown(a)} before, {_shown(b)} now")
    words = f"{values} values, {changed} differ"
    if changed and math.isfinite(largest_rel):
        words += f", by at most {largest_rel:.2g} of the largest value of their field"
    allowed = f"the tolerance {tolerance_rel:g} of {kind} records"
    if told:
        more = [f"and {len(told) - MOST_DIFFERENCES} more fields"] if len(told) > MOST_DIFFERENCES else []
        sentence = f"REPLAYED, DIFFERS by more than {allowed}: {words}"
        return Replayed(False, sentence, (*told[:MOST_DIFFERENCES], *more))
    return Replayed(True, f"replayed, agrees within {allowed}: {words}", ())


def _pairs(place: str, a: Any, b: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield place and values of two contents; lists of numbers as arrays."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in [*a, *(key for key in b if key not in a)]:
            yield from _pairs(f"{place}.{key}".lstrip("."), a.get(key), b.get(key))
    elif isinstance(a, list | tuple) and isinstance(b, list | tuple) and len(a) == len(b):
        for number, (x, y) in enumerate(zip(a, b, strict=True)):
            yield from _pairs(f"{place}[{number}]", x, y)
    else:
        yield place, a, b


def _same(a: Any, b: Any) -> bool:
    """Return whether two values are the same; two missing numbers are."""
    if isinstance(a, float) and isinstance(b, float) and math.isnan(a) and math.isnan(b):
        return True
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return False
    return bool(a == b) and type(a) is type(b)


def _number_difference(a: Any, b: Any) -> float:
    """Return the difference of two numbers over the larger magnitude; infinite for anything else."""
    if isinstance(a, float) and isinstance(b, float) and math.isfinite(a) and math.isfinite(b):
        return abs(a - b) / max(abs(a), abs(b))
    return math.inf


def _array_difference(a: np.ndarray, b: np.ndarray) -> tuple[int, int, float]:
    """Return how many values there are and differ, and the largest difference over the largest magnitude."""
    differs = ~((a == b) | (np.isnan(a) & np.isnan(b))) if a.dtype.kind == "f" else a != b
    if not differs.any():
        return a.size, 0, 0.0
    if a.dtype.kind != "f":
        return a.size, int(differs.sum()), math.inf
    scale = float(np.max(np.abs(a), where=np.isfinite(a), initial=0.0))  # by infinity any difference would be 0
    with np.errstate(invalid="ignore"):
        largest = float(np.max(np.abs(a[differs].astype(np.float64) - b[differs])))
    return a.size, int(differs.sum()), largest / scale if math.isfinite(largest) and scale > 0.0 else math.inf


def _shown(value: Any) -> str:
    """Return a value in few characters."""
    text = f"array {value.shape}" if isinstance(value, np.ndarray) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
