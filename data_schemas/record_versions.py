"""Versions of records: when one is raised, how files of the versions before are read, which of them carry a seal.

The version of a kind is raised whenever its schema changes: a field is added, removed, renamed, or allows something
else. ``tests/schemas/frozen/KIND/vN`` keeps the schema of every version and a file of it, and a test fails when
the schema changed and the version did not. A file of an earlier version is migrated when it is read, one small
function for each step of one version; nothing is rewritten on the disk. ``docs/explanation/versions-of-records.md``
tells how to add a field.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from data_schemas.errors import NewerSchemaError, RecordError
from data_schemas.model import Record

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


def _as_it_is(body: Body) -> Body:
    """Return a record whose new fields all have a value that says "not known"."""
    return body


MIGRATIONS: Final[dict[tuple[str, int], Migration]] = {
    # provenance may name packages, processor, renderer and changed sources; the envelope carries a seal
    **dict.fromkeys(LAST_UNSEALED.items(), _as_it_is),
    # the probability that the loss is within the tolerance
    ("LightAngleDecision", 2): _as_it_is,
    # whether there is emission at all; none: not judged
    ("PaintCalibration", 3): _as_it_is,
    # a laser may declare what switches it off outside the computer
    ("RigFile", 1): _as_it_is,
    ("CaptureSession", 2): _as_it_is,
    ("CameraSession", 2): _as_it_is,
    ("BandSignals", 2): _as_it_is,
    ("PixelSignals", 2): _as_it_is,
    ("AcceptanceReport", 2): _as_it_is,
    ("PaintCalibration", 4): _as_it_is,
    ("PaintWithoutEmission", 1): _as_it_is,
}
"""(kind, version) -> what turns the content of that version into that of the next; arrays stand in it as arrays."""

NOT_MIGRATED: Final[dict[tuple[str, int], str]] = {
    ("PaintCalibration", 1): "it holds draws of another model of the paint, without the discrepancy",
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
            f"{path}: schema_version {version} was written by a newer finray; this one reads up to "
            f"{record_type.schema_version}: update with 'pip install -U finray-calib'"
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
        if (kind, step) not in MIGRATIONS:
            why = f" ({NOT_MIGRATED[kind, step]})" if (kind, step) in NOT_MIGRATED else ""
            raise RecordError(
                f"{path}: was written by version {version} of the {kind} record, which differs from today's version "
                f"{today}{why}; run {record_type.written_by} again"
            )
        try:
            body = MIGRATIONS[kind, step](body)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as fault:
            raise RecordError(
                f"{path}: cannot be read as version {step} of the {kind} record ({type(fault).__name__}: {fault}); "
                f"was it edited? Run {record_type.written_by} again"
            ) from None
    return body


def is_sealed(kind: str, version: int) -> bool:
    """Return whether files of this version carry the SHA-256 of their content."""
    return version > LAST_UNSEALED.get(kind, 0)


def normalised_schema(schema: dict[str, Any], *, by_people: bool) -> dict[str, Any]:
    """Return a JSON Schema without words, so that two are equal where they allow the same files.

    Parameters
    ----------
    schema
        As pydantic makes it.
    by_people
        Whether people write such files: what they leave out takes its default, which counts therefore, and they write
        no provenance. In a stored record every field stands written, and no default counts.
    """
    words = {"title", "description", "examples", "$schema"} | (set() if by_people else {"default"})
    kept: dict[str, Any] = _without_words(schema, frozenset(words))
    if by_people:
        definitions = kept.get("$defs", {})
        definitions.pop("Provenance", None)
        for model in (kept, *definitions.values()):
            model.get("properties", {}).pop("provenance", None)
    return kept


def _without_words(value: Any, words: frozenset[str], *, names: bool = False) -> Any:
    """Return part of a schema without its words; where keys are `names` of fields, all of them stay."""
    if isinstance(value, dict):
        return {
            key: _without_words(inner, words, names=not names and key in {"properties", "$defs"})
            for key, inner in value.items()
            if names or key not in words
        }
    if isinstance(value, list):
        return [_without_words(inner, words) for inner in value]
    return value
