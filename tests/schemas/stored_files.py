"""Changed copies of stored records, sealed anew: what is wrong with them is their content, not their seal."""

import json
from pathlib import Path
from typing import Any

from data_schemas.storage._records import content_sha256


def write_sealed(path: Path, envelope: dict[str, Any]) -> None:
    """Write an envelope with the seal of its content as it is now."""
    path.write_text(json.dumps(envelope | {"content_sha256": content_sha256(envelope)}, indent=1), encoding="utf-8")


def seal_again(path: Path) -> None:
    """Seal a file anew if it is a sealed record; anything else stays as it is."""
    try:
        envelope = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return
    if isinstance(envelope, dict) and "content_sha256" in envelope:
        write_sealed(path, envelope)
