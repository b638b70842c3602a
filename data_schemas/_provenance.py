"""Who made a product, when, with which software and machine, from which inputs and with which seed."""

import hashlib
import platform
import shlex
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from data_schemas._units import Seed
from data_schemas.storage import digest_as_read, sha256_of

NUMERICAL_PACKAGES: Final = (
    "numpy", "scipy", "numba", "llvmlite", "mitsuba", "drjit", "ipctk", "pypardiso", "mkl", "emcee", "nlopt",
    "colour-science", "opencv-contrib-python-headless", "rawpy",
)  # fmt: skip
"""Packages whose versions can change a stored number; of these the installed ones are recorded."""
_PACKAGES: Final = ("data_schemas", "rigs", "finray_calib", "sim")
_READ_AT_RUN_TIME: Final = (".py", ".c", ".json", ".toml")
_SOURCES: Final = (*_PACKAGES, "pyproject.toml")
_SIMD_FLAGS: Final = ("avx512f", "avx2", "avx", "sve", "asimd")


class Provenance(BaseModel):
    """Origin of a stored product, embedded in every record."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    created_utc: str = Field(description="ISO 8601 time of writing, UTC")
    command: str = Field(description="the finray command that reproduces the product, as typed into a shell")
    package_version: str
    git_commit: str | None = Field(description="commit of the source tree, if it was run from one")
    git_dirty: bool | None = Field(
        default=None, description="whether the source code differed from that commit; none where that is not known"
    )
    python_version: str
    input_sha256: dict[str, str] = Field(description="name of each input file -> SHA-256 of its bytes")
    seed: Seed | None = Field(description="seed of the random generator, where there is chance")
    packages: dict[str, str] = Field(
        default={}, description="version of each installed package that can change a stored number"
    )
    processor: str | None = Field(
        default=None, description="model and widest vector unit, which change the order of sums and so last digits"
    )
    renderer: str | None = Field(default=None, description="variant of the renderer, where one was opened")

    @property
    def code(self) -> str:
        """Version of the package and, where known, the commit of its sources and whether they were changed since."""
        commit = f", commit {self.git_commit[:12]}" if self.git_commit else ""
        return f"finray-calib {self.package_version}{commit}{', changed since' if self.git_dirty else ''}"

    def of_this_process(self) -> "Provenance":
        """Return the same origin with interpreter, packages, processor and renderer of the process that computes.

        It may run on another machine than the one that was asked.
        """
        here = provenance("")
        known = {name: getattr(here, name) for name in ("python_version", "packages", "processor", "renderer")}
        return self.model_copy(update=known)

    @property
    def arguments(self) -> tuple[str, ...] | None:
        """The words after "finray" on the command line, or None where the product was not made by one.

        ``shlex.join`` wrote the command and ``shlex.split`` takes it apart again without loss; no shell sees it.
        """
        try:
            program, *words = shlex.split(self.command)
        except ValueError:
            return None
        return tuple(words) if program == "finray" and words else None


@cache
def package_version() -> str:
    """Return the installed version of finray-calib."""
    try:
        return version("finray-calib")
    except PackageNotFoundError:
        return "unknown"


@cache
def _source_tree() -> tuple[str | None, bool | None]:
    """Return the commit of the source tree that holds this package, and whether its sources were changed since."""
    root = Path(__file__).resolve().parent.parent
    if not (root / ".git").exists():
        return None, None
    commit = _git(root, "rev-parse", "HEAD")
    changed = _git(root, "status", "--porcelain", "--", *_SOURCES)
    return (commit or "").strip() or None, None if changed is None else bool(changed.strip())


def _git(root: Path, *words: str) -> str | None:
    """Return what git says, or None where it does not answer."""
    try:
        done = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


@cache
def numerical_packages() -> dict[str, str]:
    """Return name -> version of the installed packages of :data:`NUMERICAL_PACKAGES`."""
    found = {}
    for name in NUMERICAL_PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


@cache
def processor() -> str:
    """Return the model of the processor and its widest vector unit, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    said = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    flags = set(said.get("flags", said.get("Features", "")).split())
    widest = next((flag for flag in _SIMD_FLAGS if flag in flags), None)
    words = (said.get("model name"), platform.machine(), widest)
    return ", ".join(word for word in words if word) or "unknown"


_opened_renderer: list[str] = []


def note_renderer(variant: str) -> None:
    """State the renderer's variant that this process has opened; provenance written from now on names it."""
    _opened_renderer[:] = [variant]


@cache
def code_digest() -> str:
    """Return the SHA-256 of the sources that this process runs: names and contents of all files of the packages.

    Two computers with the same digest run the same finray, installed or from a source tree.
    """
    root = Path(__file__).resolve().parent.parent
    lines = "".join(f"{sha256_of(root / name)}  {name}\n" for name in _source_names(root))
    return hashlib.sha256(lines.encode()).hexdigest()


def _source_names(root: Path) -> list[str]:
    """Return the names of all source files below a folder, without what editors and tools keep in hidden ones."""
    files = [file for package in _PACKAGES for file in (root / package).rglob("*") if file.suffix in _READ_AT_RUN_TIME]
    names = [file.relative_to(root) for file in files if file.is_file()]
    return sorted(name.as_posix() for name in names if not any(part.startswith(".") for part in name.parts))


def digest_of_input(path: Path) -> str:
    """Return the SHA-256 of an input's bytes as this process read them, also where the file has changed since.

    Raises
    ------
    LookupError
        Nothing has read the file through :mod:`data_schemas.storage._foreign_files`: a fault of the program.
    """
    digest = digest_as_read(path)
    if digest is None:
        raise LookupError(f"{path}: is named as an input but was never read")
    return digest


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
    commit, dirty = _source_tree()
    return Provenance(
        created_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command,
        package_version=package_version(),
        git_commit=commit,
        git_dirty=dirty,
        python_version=platform.python_version(),
        input_sha256=dict(inputs or {}),
        seed=seed,
        packages=numerical_packages(),
        processor=processor(),
        renderer=_opened_renderer[0] if _opened_renderer else None,
    )
