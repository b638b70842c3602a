"""The only reader and writer of records: JSON plus arrays, atomic, sealed, versioned; TOML where a person writes.

A stored record is one JSON file (an envelope with kind, schema version, the record and its seal); arrays of more than
:data:`INLINE_VALUES` values stand in one ``.npz`` file beside it, whose name carries its SHA-256. The array
file gets its name first and the JSON last, so a record is either whole or absent. The seal is the SHA-256
of the rest of the envelope, checked when the record is read: it detects accidents and edits, not forgery, as whoever
changes a record on purpose can compute it anew.

The version of a kind is raised whenever its schema changes: a field is added, removed, renamed, or allows something
else. ``tests/schemas/frozen/KIND/vN`` keeps the schema of every version and a file of it, and a test fails when
the schema changed and the version did not. A file of an earlier version is migrated when it is read, one small
function for each step that is more than a new field with a default; nothing is rewritten on the disk.
``docs/explanation/versions-of-records.md`` tells how to add a field.
"""

import hashlib
import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas import (
    ChecksumError,
    NewerSchemaError,
    Provenance,
    Record,
    RecordError,
    explain,
    kind_in_words,
    needed_kind,
)
from data_schemas.storage._array_files import DeclaredArray, read_declared_arrays
from data_schemas.storage._foreign_files import (
    LARGEST_ARRAY_FILE_BYTES,
    digest_as_read,
    has_file,
    read_bytes,
    read_json,
    read_toml_tables,
)
from data_schemas.storage._product_set import ProductSet, refuse_unfinished
from data_schemas.storage._whole_files import refuse_existing

INLINE_VALUES = 512
A_RECORD = "a stored record (.json)"
R = TypeVar("R", bound=Record)
Complete = Callable[[dict[str, Any]], dict[str, Any]]


def write_record(record: Record, path: Path, provenance: Provenance, products: ProductSet | None = None) -> Path:
    """Store a record at `path` (a new ``.json`` file) and return the path.

    Parameters
    ----------
    record, path
        The record and its file.
    provenance
        Its origin.
    products
        The set that it is stored with; alone (with its array file) where left out. The record holds the SHA-256 of the
        files that were added before it and lie in its folder or below: a page, a picture.

    Raises
    ------
    RecordError
        The file exists already: a stored record is never overwritten.
    """
    if products is None:
        refuse_existing(path)
        with ProductSet(path) as alone:
            return write_record(record, path, provenance, alone)
    content = record.model_copy(update={"provenance": provenance}).model_dump(mode="python")
    arrays: dict[str, NDArray[Any]] = {}
    body = _to_json(content, "", arrays)
    array_file = None
    if arrays:
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays)
        digest = hashlib.sha256(buffer.getvalue()).hexdigest()
        array_file = {"file": f"{path.stem}.{digest[:12]}.npz", "sha256": digest}
        # One with the same content, left where its record was moved away, serves as well.
        products.add(path.with_name(array_file["file"]), buffer.getvalue(), same_serves=True)
    array_name = None if array_file is None else array_file["file"]
    companions = {name: digest for name, digest in products.added_below(path.parent).items() if name != array_name}
    envelope = {
        "kind": type(record).__name__,
        "schema_version": record.schema_version,
        "array_file": array_file,
        **({"companions": companions} if companions else {}),
        "record": body,
    }
    envelope["content_sha256"] = content_sha256(envelope)
    return products.add(path, (json.dumps(envelope, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode())


def content_sha256(envelope: Mapping[str, Any]) -> str:
    """Return the seal of an envelope: SHA-256 of all that it holds beside the seal, as canonical JSON.

    Canonical is: UTF-8, keys sorted, no spaces, numbers as Python writes them (the shortest decimal that reads back as
    the same number). Indentation and the order of keys do not matter, every value does.
    """
    content = {key: value for key, value in envelope.items() if key != "content_sha256"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode(errors="surrogatepass")).hexdigest()


def _to_json(value: Any, name: str, arrays: dict[str, NDArray[Any]]) -> Any:
    """Return `value` ready for JSON; large arrays go to `arrays` and leave a reference."""
    if isinstance(value, np.ndarray):
        if value.size > INLINE_VALUES:
            arrays[name] = value
            return {"array": name, "shape": list(value.shape), "dtype": value.dtype.str}
        return _nan_to_none(value.tolist())
    if isinstance(value, dict):
        return {key: _to_json(v, f"{name}.{key}".lstrip("."), arrays) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json(v, f"{name}.{i}".lstrip("."), arrays) for i, v in enumerate(value)]
    return value


def _nan_to_none(value: Any) -> Any:
    """Replace NaN in nested lists by None (JSON has no NaN)."""
    if isinstance(value, list):
        return [_nan_to_none(v) for v in value]
    return None if isinstance(value, float) and value != value else value


def stored_kind(envelope: object) -> str | None:
    """Return the kind of record that the content of a JSON file names; None where it names none."""
    kind = envelope.get("kind") if isinstance(envelope, dict) else None
    return kind if isinstance(kind, str) else None


def read_record(path: Path, record_type: type[R]) -> R:
    """Read a stored record and check its kind, version, checksum and every field.

    Raises
    ------
    RecordError
        The file is missing, not JSON, of another kind or a version that cannot be migrated, or a field is not what it
        must be.
    NewerSchemaError
        The record was written by a newer version.
    ChecksumError
        The record was changed after it was written, or its array file is missing or was changed.
    """
    refuse_unfinished(path)
    envelope = _load_json(path)
    kind = envelope.get("kind")
    if kind != record_type.__name__:
        why = f" (written by {record_type.written_by})" if record_type.written_by != Record.written_by else ""
        why = f"; {record_type.other_kinds[str(kind)]}" if str(kind) in record_type.other_kinds else why
        found = kind_in_words(str(kind)) if kind else "no record of a known kind"
        raise RecordError(f"{path}: contains {found}, but {needed_kind(record_type.__name__)}{why}")
    version = _required_version(path, envelope.get("schema_version"))
    refuse_newer(path, version, record_type)
    _check_seal(path, envelope, record_type)
    body = envelope.get("record")
    if not isinstance(body, dict):
        raise RecordError(f"{path}: 'record' must be a JSON object")
    arrays = _load_arrays(path, envelope.get("array_file"), _declared_arrays(path, body))
    try:
        return record_type.model_validate(migrate(path, record_type, version, _with_arrays(path, body, arrays)))
    except ValidationError as error:
        raise RecordError(f"{path}: {explain(error, record_type)}{_older_hint(envelope, version)}") from None


def _required_version(path: Path, version: Any) -> int:
    """Return the number of a version, or refuse what is none."""
    if type(version) is not int or version < 1:
        raise RecordError(f"{path}: schema_version must be a whole number from 1, got {version!r}")
    return version


def _check_seal(path: Path, envelope: dict[str, Any], record_type: type[Record]) -> None:
    """Refuse a record that was changed after it was written; records of versions before seals have none."""
    seal, kind = envelope.get("content_sha256"), record_type.__name__
    if seal is None and not is_sealed(kind, envelope["schema_version"]):
        return
    if seal != content_sha256(envelope):
        what = "has no seal" if seal is None else "does not match its seal"
        raise ChecksumError(
            f"{path}: {what} (content_sha256), so it was changed after it was written; restore the file, or run "
            f"{record_type.written_by} again"
        )


def _older_hint(envelope: dict[str, Any], version: int) -> str:
    """Return what may explain that a record of the time before frozen schemas does not fit."""
    if is_sealed(str(envelope.get("kind")), version):
        return ""
    origin = envelope["record"].get("provenance")
    commit = origin.get("git_commit") if isinstance(origin, dict) else None
    return (
        f". Earlier versions of finray stored different schemas as version {version}; this file was written by "
        f"{(f'commit {commit}' if commit else 'an unknown commit')}. Read it with that commit, or make the record "
        "again"
    )


def _load_json(path: Path) -> dict[str, Any]:
    """Read a JSON object."""
    loaded = read_json(path, A_RECORD)
    if not isinstance(loaded, dict):
        raise RecordError(
            f"{path}: is not a stored record (a JSON object with 'kind' and 'record'); give a record that finray wrote"
        )
    return loaded


def _is_reference(value: dict[str, Any]) -> bool:
    """Return whether an object stands for an array of the array file."""
    return value.keys() == {"array", "shape", "dtype"}


def _declared_arrays(path: Path, value: Any) -> dict[str, DeclaredArray]:
    """Return name -> shape and type of the arrays that a record refers to."""
    found: dict[str, DeclaredArray] = {}
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        found |= _declared_arrays(path, inner)
    if isinstance(value, dict) and _is_reference(value):
        name, shape, dtype = value["array"], value["shape"], value["dtype"]
        whole = isinstance(shape, list) and all(type(length) is int and length >= 0 for length in shape)
        if not (isinstance(name, str) and whole and isinstance(dtype, str)):
            raise RecordError(
                f"{path}: the array reference {str(value)[:80]} must give the name, the shape and the type of an array"
            )
        found[name] = DeclaredArray(tuple(shape), dtype)
    return found


def _load_arrays(path: Path, array_file: Any, declared: dict[str, DeclaredArray]) -> dict[str, NDArray[Any]]:
    """Read what a record declares from its array file, after checking the file's name and checksum."""
    if array_file is None:
        return {}
    try:
        name, digest = str(array_file["file"]), str(array_file["sha256"])
    except (TypeError, KeyError):
        raise RecordError(f"{path}: array_file must contain 'file' and 'sha256'") from None
    if not name or name == ".." or Path(name).name != name:
        raise RecordError(f"{path}: array_file.file = {name!r} must be a plain file name in the folder of the record")
    source = path.with_name(name)
    if not has_file(source):
        raise ChecksumError(
            f"{source}: is missing, but it contains the arrays of {path.name}; keep the two files together"
        )
    content = read_bytes(source, f"the arrays of {path.name}", RecordError, LARGEST_ARRAY_FILE_BYTES)
    if digest_as_read(source) != digest:
        raise ChecksumError(
            f"{source}: was changed (its SHA-256 differs from the SHA-256 in {path.name}); restore the file"
        )
    return read_declared_arrays(content, declared, source)


def _with_arrays(path: Path, value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """Replace array references by the arrays."""
    if isinstance(value, dict):
        if _is_reference(value):
            if value["array"] not in arrays:
                raise RecordError(
                    f"{path}: the record refers to the array {value['array']!r}, but array_file is missing, so the "
                    "record was edited; use the original, or make the record again"
                )
            return arrays[value["array"]]
        return {key: _with_arrays(path, v, arrays) for key, v in value.items()}
    if isinstance(value, list):
        return [_with_arrays(path, v, arrays) for v in value]
    return value


_KEYS_OF_KINDS: Final = {
    "camera_name": "the plan of a camera session",
    "check_name": "the plan of a check",
    "filter_wheel": "a rig file",
    "load_cell": "a rig file",
    "pad": "the design of a finger or sensor",
    "paint_name": "the plan of a paint session",
    "vary": "the plan of a study",
}
"""Keys at the top of a TOML file that one kind of file alone has, and what that kind is called."""


def toml_text(text: str) -> str:
    """Return a text as TOML writes it, a basic string in quotation marks."""
    # TOML escapes as JSON does, and also the DEL character, which JSON leaves as it is
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def read_toml(path: Path, record_type: type[R], complete: Complete = dict) -> R:
    """Read a plan, rig or design file that a person wrote (TOML).

    It may name the version of its kind as ``schema_version`` above its first table, as files that finray writes do;
    without it the file is of today's version.

    Parameters
    ----------
    path
        The file.
    record_type
        Its kind.
    complete
        Given what the file says, returns what is validated: a ready-made product whose numbers the file changes.

    Raises
    ------
    RecordError
        The file is missing, longer than a person writes or not TOML, or a field is unknown, missing, out of range or
        without effect.
    NewerSchemaError
        The file is of a newer version.
    """
    loaded = read_toml_tables(path, f"{kind_in_words(record_type.__name__)} (TOML)")
    version = _required_version(path, loaded.pop("schema_version", record_type.schema_version))
    unknown = loaded.keys() - record_type.model_fields.keys()
    lacks = any(field.is_required() and name not in loaded for name, field in record_type.model_fields.items())
    if lacks or 2 * len(unknown) > len(loaded):
        if found := [words for key, words in _KEYS_OF_KINDS.items() if key in unknown]:
            raise RecordError(
                f"{path}: contains {found[0]}, but {needed_kind(record_type.__name__)}; give the path of the right file"
            )
        version = min(version, record_type.schema_version)  # a file of another kind: what it lacks tells more
    try:
        read = record_type.model_validate(complete(migrate(path, record_type, version, loaded)))
    except ValidationError as error:
        raise RecordError(f"{path}: {explain(error, record_type)}") from None
    for field, why in read.unused_fields().items():
        if _is_written(loaded, field):
            raise RecordError(f"{path}: {field} has no effect, because {why}")
    return read


def _is_written(table: Any, field: str) -> bool:
    """Return whether a dotted path stands in a table."""
    name, _, inner = field.partition(".")
    return isinstance(table, dict) and name in table and (not inner or _is_written(table[name], inner))


Body = dict[str, Any]
Migration = Callable[[Body], Body]

_STORED_BEFORE_SEALS: Final = (
    "AcceptanceReport", "BandSignals", "CameraCharacterisation", "CameraSession", "CaptureSession", "ComparisonBatch",
    "FingerStiffness", "FingerSurfaces", "FluorescentRendering", "ForceComparison", "LightAngleDecision",
    "LightAngleIntensity", "LightAngleSweep", "NormalMapRecord", "PaintCalibration", "PaintMap", "PaperPaints",
    "PhotometricErrorReport", "PixelScale", "PixelSignals", "PressIncrement", "PressMechanics", "SimulatedPress",
    "TactileCapture", "TactileSession", "TwoLights",
)  # fmt: skip
LAST_UNSEALED: Final[dict[str, int]] = {**dict.fromkeys(_STORED_BEFORE_SEALS, 1), "PaintCalibration": 2}
"""Kind -> last version whose files carry no seal. Several schemas were stored under these numbers, as versions were not
raised with the schema before: which one a file has, only its provenance tells (the commit of the source tree)."""


def _with_verdict_of_captures(body: Body) -> Body:
    """Return a decision whose verdict "model-limited" has the name of what helps."""
    verdict = "needs captures" if body["verdict"] == "model-limited" else body["verdict"]
    return {**body, "verdict": verdict}


def _without_mean_of_skills(body: Body) -> Body:
    """Return a batch whose mean of skills, another statistic than today's, stands in its notes."""
    kept = {name: value for name, value in body.items() if name != "mean_skill"}
    mean = body["mean_skill"]
    if mean is None:
        return kept
    told = (
        f"mean of the skills {mean['estimate']:.3f}, 95 % {mean['low95']:.3f} to {mean['high95']:.3f} by Student's t, "
        "as an earlier version stored it; compare again for the skill of all presses together"
    )
    return {**kept, "notes": [*body["notes"], told]}


def _with_relative_of_notes(body: Body) -> Body:
    """Return a comparison that says in a field, as a note did, whether only the change by contact was judged."""
    said = "compared relative to the capture's own image without contact"
    return {**body, "relative": any(str(note).startswith(said) for note in body.get("notes", ()))}


def _with_relative_of_command(body: Body) -> Body:
    """Return a batch that says, as its command did, whether only the change by contact was judged."""
    command = str((body.get("provenance") or {}).get("command", ""))
    return {**body, "relative": any("--relative".startswith(word) and len(word) > 4 for word in command.split())}


def _with_integer_parameters(body: Body) -> Body:
    """Return a design search whose parameters are `is_integer`, which was `is_whole`."""
    parameters = [
        {"is_integer" if key == "is_whole" else key: value for key, value in parameter.items()}
        for parameter in body["parameters"]
    ]
    return {**body, "parameters": parameters}


def _with_training_sha256(body: Body) -> Body:
    """Return a normal map whose `taught_by_sha256` has the name that other trained records use."""
    return {"training_sha256" if key == "taught_by_sha256" else key: value for key, value in body.items()}


LEAST_LIMIT: Final = 1e-9
"""In place of a limit of 0, of which no rig keeps any more than of this one."""


def _with_limits_that_can_be_kept(body: Body) -> Body:
    """Return a check's report whose limits are above 0 and at most 1 where relative; its notes say what they were."""
    limits, told = dict(body["plan"].get("limits", {})), []
    for name, limit in limits.items():
        most = 1.0 if name.endswith("_rel") else 65535.0
        if (kept := min(max(limit, LEAST_LIMIT), most)) != limit:
            limits[name] = kept
            told.append(
                f"the limit {name} was {limit:g} in this report, but is read as {kept:g}, the nearest allowed value"
            )
    plan = {**body["plan"], "limits": limits} if told else body["plan"]
    return {**body, "plan": plan, "notes": [*body.get("notes", []), *told]}


MIGRATIONS: Final[dict[tuple[str, int], Migration]] = {
    ("LightAngleDecision", 3): _with_verdict_of_captures,
    ("AcceptanceReport", 9): _with_limits_that_can_be_kept,
    ("ComparisonBatch", 2): _without_mean_of_skills,
    # whether only the change by contact was judged; a note and the command said so before
    ("PhotometricErrorReport", 5): _with_relative_of_notes,
    ("ComparisonBatch", 3): _with_relative_of_command,
    # names that others use
    ("DesignOptimum", 3): _with_integer_parameters,
    ("NormalMapRecord", 4): _with_training_sha256,
}
"""(kind, version) -> what turns the content of that version into that of the next; arrays stand in it as arrays.

A version without a step differs from the next by new fields alone, each with a default that says "not known" or what
held before: its content is read as it is. The tests read a file of every version (``tests/schemas/frozen``)."""

NOT_MIGRATED: Final[dict[tuple[str, int], str]] = {
    ("PaintCalibration", 1): "it contains draws of another model of the paint, without the discrepancy",
}
"""(kind, version) -> why the next version cannot be made from it."""


def refuse_newer(path: Path, version: int, record_type: type[Record]) -> None:
    """Refuse a file of a version that this finray does not know.

    Raises
    ------
    NewerSchemaError
        The version is later than today's.
    """
    if version > record_type.schema_version:
        raise NewerSchemaError(
            f"{path}: schema_version {version} was written by a newer finray, but this one reads only up to "
            f"{record_type.schema_version}; update with 'pip install -U finray-calib'"
        )


def migrate(path: Path, record_type: type[Record], version: int, body: Body) -> Body:
    """Return the content of a record as today's version holds it; a field of another type is left to the reader.

    Raises
    ------
    NewerSchemaError
        The version is later than today's.
    RecordError
        A step between cannot be made from what is stored, or does not find what it migrates.
    """
    refuse_newer(path, version, record_type)
    kind, today = record_type.__name__, record_type.schema_version
    for step in range(version, today):
        if (kind, step) in NOT_MIGRATED:
            raise RecordError(
                f"{path}: version {version} of the {kind} record cannot be converted to version {today} "
                f"({NOT_MIGRATED[kind, step]}); run {record_type.written_by} again"
            )
        if (kind, step) not in MIGRATIONS:
            continue
        try:
            body = MIGRATIONS[kind, step](body)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as fault:
            raise RecordError(
                f"{path}: cannot be read as version {step} of the {kind} record ({type(fault).__name__}: {fault}), "
                f"perhaps because it was edited; run {record_type.written_by} again"
            ) from None
    return body


def is_sealed(kind: str, version: int) -> bool:
    """Return whether files of this version carry the SHA-256 of their content."""
    return version > LAST_UNSEALED.get(kind, 0)
