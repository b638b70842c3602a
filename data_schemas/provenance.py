"""Who made a product, when, with which version, from which inputs and with which seed."""

import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from data_schemas.units import Seed


class Provenance(BaseModel):
    """Origin of a stored product, embedded in every record."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    created_utc: str = Field(description="ISO 8601 time of writing, UTC")
    command: str = Field(description="the finray command that reproduces the product")
    package_version: str
    git_commit: str | None = Field(description="commit of the source tree, if it was run from one")
    python_version: str
    input_sha256: dict[str, str] = Field(description="name of each input file -> SHA-256 of its bytes")
    seed: Seed | None = Field(description="seed of the random generator, where there is chance")


@cache
def package_version() -> str:
    """Return the installed version of finray-calib."""
    try:
        return version("finray-calib")
    except PackageNotFoundError:
        return "unknown"


@cache
def _git_commit() -> str | None:
    """Return the commit of the source tree that holds this package, or None."""
    root = Path(__file__).resolve().parent.parent
    if not (root / ".git").exists():
        return None
    try:
        done = subprocess.run(
            ["git", "-C", str(root), "rev-parse", "HEAD"],
            capture_output=True,
            text=True,
            timeout=5,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() or None


def provenance(command: str, inputs: Mapping[str, str] | None = None, seed: int | None = None) -> Provenance:
    """Record the origin of a product that is made now.

    Parameters
    ----------
    command
        The command line that reproduces the product.
    inputs
        Name of each input file -> SHA-256 of its bytes.
    seed
        Seed of the random generator, where there is chance.
    """
    return Provenance(
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command,
        package_version=package_version(),
        git_commit=_git_commit(),
        python_version=platform.python_version(),
        input_sha256=dict(inputs or {}),
        seed=seed,
    )
