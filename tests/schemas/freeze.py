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
from data_schemas.storage._records import normalised_schema

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
