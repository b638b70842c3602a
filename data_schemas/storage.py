"""The only reader and writer of records: JSON plus arrays, atomic, hashed, versioned; TOML where a person writes.

A stored record is one JSON file (an envelope with kind, schema version and the record); arrays of more than
:data:`INLINE_VALUES` values stand in one ``.npz`` file beside it, whose name carries its SHA-256. The array
file is written first and the JSON gets its name last, so a record is either whole or absent.
"""

import hashlib
import io
import json
import tomllib
import zipfile
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas.errors import ChecksumError, NewerSchemaError, RecordError
from data_schemas.faults import explain
from data_schemas.model import Record
from data_schemas.provenance import Provenance
from data_schemas.whole_files import refuse_taken, sha256_of, write_bytes

INLINE_VALUES = 512
LONGEST_TOML_BYTES = 1 << 20
"""More than a person writes: /dev/zero has no end."""
R = TypeVar("R", bound=Record)


def _write_arrays(path: Path, content: bytes, sha256: str) -> None:
    """Write an array file; one with the same content, left by an earlier or simultaneous writer, serves as well."""
    try:
        write_bytes(path, content)
    except RecordError:
        if not path.is_file() or sha256_of(path) != sha256:
            raise


def write_record(record: Record, path: Path, provenance: Provenance) -> Path:
    """Store a record at `path` (a new ``.json`` file) and return the path.

    Raises
    ------
    RecordError
        The file exists already: a stored record is never overwritten.
    """
    refuse_taken(path)
    content = record.model_copy(update={"provenance": provenance}).model_dump(mode="python")
    arrays: dict[str, NDArray[Any]] = {}
    body = _to_json(content, "", arrays)
    array_file = None
    if arrays:
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays)
        digest = hashlib.sha256(buffer.getvalue()).hexdigest()
        array_file = {"file": f"{path.stem}.{digest[:12]}.npz", "sha256": digest}
        _write_arrays(path.with_name(array_file["file"]), buffer.getvalue(), digest)
    envelope = {
        "kind": type(record).__name__,
        "schema_version": record.schema_version,
        "array_file": array_file,
        "record": body,
    }
    write_bytes(path, (json.dumps(envelope, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode())
    return path


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


def read_record(path: Path, record_type: type[R]) -> R:
    """Read a stored record and check its kind, version, checksum and every field.

    Raises
    ------
    RecordError
        The file is missing, not JSON, of another kind or an earlier version, or a field is not what it must be.
    NewerSchemaError
        The record was written by a newer version.
    ChecksumError
        The array file is missing or was changed.
    """
    envelope = _load_json(path)
    kind = envelope.get("kind")
    if kind != record_type.__name__:
        raise RecordError(f"{path}: is a {kind or 'file of unknown kind'}, a {record_type.__name__} is needed here")
    version = envelope.get("schema_version")
    if not isinstance(version, int) or version < 1:
        raise RecordError(f"{path}: schema_version is {version!r}; it must be a whole number from 1")
    if version > record_type.schema_version:
        raise NewerSchemaError(
            f"{path}: schema_version {version} was written by a newer finray; this one reads up to "
            f"{record_type.schema_version}: update with 'pip install -U finray-calib'"
        )
    if version < record_type.schema_version:
        raise RecordError(
            f"{path}: was written by version {version} of the {kind} record, which differs from today's version "
            f"{record_type.schema_version}; run {record_type.written_by} again"
        )
    arrays = _load_arrays(path, envelope.get("array_file"))
    try:
        return record_type.model_validate(_from_json(path, envelope.get("record"), arrays))
    except ValidationError as error:
        raise RecordError(f"{path}: {explain(error, record_type)}") from None


def _load_json(path: Path) -> dict[str, Any]:
    """Read a JSON object."""
    if path.is_dir():
        raise RecordError(f"{path}: is a folder; give the .json file of the record")
    try:
        loaded = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RecordError(f"{path}: no such file; give the path of a stored record (.json)") from None
    except (OSError, ValueError, RecursionError) as error:
        raise RecordError(f"{path}: cannot be read as JSON ({error}); was it edited or cut off?") from None
    if not isinstance(loaded, dict):
        raise RecordError(f"{path}: is not a stored record (a JSON object with 'kind' and 'record')")
    return loaded


def _load_arrays(path: Path, array_file: Any) -> dict[str, NDArray[Any]]:
    """Read the array file of a record after checking its name and checksum; pickles are never loaded."""
    if array_file is None:
        return {}
    try:
        name, digest = str(array_file["file"]), str(array_file["sha256"])
    except (TypeError, KeyError):
        raise RecordError(f"{path}: array_file must hold 'file' and 'sha256'") from None
    if not name or name == ".." or Path(name).name != name:
        raise RecordError(f"{path}: array_file.file = {name!r} must be a plain file name beside the record")
    source = path.with_name(name)
    if not source.is_file():
        raise ChecksumError(f"{source}: is missing; it holds the arrays of {path.name}: keep the two files together")
    if sha256_of(source) != digest:
        raise ChecksumError(f"{source}: its SHA-256 differs from the one in {path.name}; the file was changed")
    try:
        with np.load(source, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}
    except (ValueError, OSError, zipfile.BadZipFile) as error:
        raise RecordError(f"{source}: cannot be read as numpy arrays ({error})") from None


def _from_json(path: Path, value: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """Replace array references by the arrays."""
    if isinstance(value, dict):
        if value.keys() == {"array", "shape", "dtype"}:
            array = arrays.get(str(value["array"]))
            if array is None or list(array.shape) != value["shape"]:
                raise RecordError(f"{path}: array '{value['array']}' is missing in its array file or has another shape")
            return array
        return {key: _from_json(path, v, arrays) for key, v in value.items()}
    if isinstance(value, list):
        return [_from_json(path, v, arrays) for v in value]
    return value


def read_toml(path: Path, record_type: type[R]) -> R:
    """Read a plan, rig or design file that a person wrote (TOML).

    Raises
    ------
    RecordError
        The file is missing, longer than a person writes or not TOML, or a field is unknown, missing, out of range or
        without effect.
    """
    try:
        with path.open("rb") as file:
            text = file.read(LONGEST_TOML_BYTES + 1)
        if len(text) > LONGEST_TOML_BYTES:
            raise RecordError(f"{path}: is longer than {LONGEST_TOML_BYTES} bytes; give the path of a TOML file")
        loaded = tomllib.loads(text.decode())
    except FileNotFoundError:
        raise RecordError(f"{path}: no such file; give the path of a TOML file") from None
    except IsADirectoryError:
        raise RecordError(f"{path}: is a folder; give the path of a TOML file") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RecordError(f"{path}: cannot be read as TOML ({error})") from None
    try:
        read = record_type.model_validate(loaded)
    except ValidationError as error:
        raise RecordError(f"{path}: {explain(error, record_type)}") from None
    for field, why in read.idle_fields().items():
        if _is_written(loaded, field):
            raise RecordError(f"{path}: {field} has no effect: {why}")
    return read


def _is_written(table: Any, field: str) -> bool:
    """Return whether a dotted path stands in a table."""
    name, _, inner = field.partition(".")
    return isinstance(table, dict) and name in table and (not inner or _is_written(table[name], inner))
