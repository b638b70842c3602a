"""Freeze today's schema of every kind whose version was raised, with a file of it: ``python -m tests.schemas.freeze``.

The file of a stored record is that of the version before, migrated and written by today's code. The file of a plan,
rig or design (TOML) is yours to write. What is frozen already is never written again.
"""

import json
import sys
from pathlib import Path
from typing import Any

from data_schemas import Provenance, Record
from data_schemas.json_schemas import STORED, WRITTEN_BY_PEOPLE
from data_schemas.storage import read_record, write_record

FROZEN = Path(__file__).resolve().parent / "frozen"
ORIGIN = Provenance(
    created_utc="2026-11-23T12:00:00+00:00",
    command="finray example --out example.json",
    package_version="0.1.0",
    git_commit=None,
    git_dirty=None,
    python_version="3.12.3",
    input_sha256={"input.csv": "0" * 64},
    seed=1,
    packages={"numpy": "2.1.0", "scipy": "1.15.0"},
    processor="an example, x86_64, avx2",
    renderer="scalar_rgb",
)


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


def folder_of(record_type: type[Record], version: int) -> Path:
    """Return where the schema and the file of a version stand."""
    return FROZEN / record_type.__name__ / f"v{version}"


def schema_of(record_type: type[Record]) -> dict[str, Any]:
    """Return today's schema of a kind as it is frozen."""
    return normalised_schema(
        record_type.model_json_schema(mode="validation"), by_people=record_type in WRITTEN_BY_PEOPLE
    )


def example_of(record_type: type[Record], version: int) -> Path:
    """Return the file of a version."""
    suffix = "toml" if record_type in WRITTEN_BY_PEOPLE else "json"
    return folder_of(record_type, version) / f"example.{suffix}"


def freeze(record_type: type[Record]) -> str | None:
    """Freeze today's version of a kind if it is new; return what is left to do, or None."""
    version = record_type.schema_version
    folder, kind = folder_of(record_type, version), record_type.__name__
    frozen = folder / "schema.json"
    if frozen.exists():
        if json.loads(frozen.read_text(encoding="utf-8")) == schema_of(record_type):
            return None
        return f"{kind}: its schema changed and its version {version} did not; raise schema_version to {version + 1}"
    folder.mkdir(parents=True, exist_ok=True)
    frozen.write_text(json.dumps(schema_of(record_type), indent=1, sort_keys=True) + "\n", encoding="utf-8")
    example = example_of(record_type, version)
    if example.exists():
        return None
    if record_type in WRITTEN_BY_PEOPLE:
        return f"{kind}: write a file of version {version} as {example}"
    write_record(read_record(example_of(record_type, version - 1), record_type), example, ORIGIN)
    return None


def main() -> int:
    """Freeze all kinds; tell what is left to do."""
    left = [said for said in map(freeze, (*WRITTEN_BY_PEOPLE, *STORED)) if said is not None]
    sys.stdout.write("".join(f"{line}\n" for line in left))
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
