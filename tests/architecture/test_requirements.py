"""What is installed: lock files that hold all requirements with hashes, and licences that the project may use.

Licences that bind whoever only uses a package (GPL, AGPL) are refused. LGPL and MPL are allowed: such a package is
imported as it is, may be exchanged for another build, and no copy of it is distributed with finray-calib.
"""

import re
import tomllib
from importlib.metadata import Distribution, distributions
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LOCKS = {"plain": [], "sim": ["sim"], "dev": ["dev"], "bench": ["dev", "bench"]}
PINNED = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>[^ ;]+)(?: ; (?P<marker>[^\\]+?))? \\$")
HASH = re.compile(r"^    --hash=sha256:[0-9a-f]{64}(?: \\)?$")
STRONG = re.compile(r"(?<!L)(?<!Lesser )(?<!Library or )\b(AGPL|GPL|General Public Licen[cs]e)", re.IGNORECASE)
# packages whose metadata name no licence: read in the text that they bring
IN_FILE = {
    "dynesty": "MIT License",
    "ipctk": "MIT License",
    "openexr": "Redistribution and use in source and binary forms",
}
# without metadata and without a file: the adapters of Micro-Manager's demo, whose sources say BSD
WITHOUT = {"mm-test-adapters"}


def locked(name: str) -> dict[str, str]:
    """Return the pinned version of each package of a lock file that this Python and machine install."""
    found = {}
    for line in (ROOT / "requirements" / f"{name}.lock").read_text(encoding="utf-8").splitlines():
        pinned = PINNED.match(line)
        if pinned and (pinned["marker"] is None or Requirement(f"x ; {pinned['marker']}").marker.evaluate()):
            found[canonicalize_name(pinned["name"])] = pinned["version"]
    return found


def asked_for(extras: list[str]) -> list[Requirement]:
    """Return the project's requirements with these extras, and those of its build."""
    project = PROJECT["project"]
    texts = [*project["dependencies"], *PROJECT["dependency-groups"]["build"]]
    waiting = list(extras)
    while waiting:
        for text in project["optional-dependencies"][waiting.pop()]:
            requirement = Requirement(text)
            if requirement.name == "finray-calib":
                waiting += requirement.extras
            else:
                texts.append(text)
    found = [Requirement(text) for text in texts]
    return [r for r in found if r.marker is None or r.marker.evaluate(default_environment())]


@pytest.mark.parametrize("name", [*LOCKS, "others"])
def test_every_line_is_a_version_or_a_hash(name: str) -> None:
    lines = (ROOT / "requirements" / f"{name}.lock").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if not (PINNED.match(line) or HASH.match(line))] == []
    for line, after in zip(lines, [*lines[1:], ""], strict=True):
        assert HASH.match(after) or not line.endswith("\\"), line


@pytest.mark.parametrize("name", LOCKS)
def test_a_lock_file_holds_what_pyproject_asks_for(name: str) -> None:
    versions = locked(name)
    for requirement in asked_for(LOCKS[name]):
        version = versions.get(canonicalize_name(requirement.name))
        assert version is not None, f"requirements/{name}.lock lacks {requirement.name}: make lock"
        assert requirement.specifier.contains(version, prereleases=True), f"{requirement} is {version}: make lock"


def test_the_lock_files_agree() -> None:
    everything = locked("bench")
    for name in ("plain", "sim", "dev"):
        assert locked(name).items() <= everything.items()
    assert not {"mitsuba", "drjit", "ipctk", "pypardiso", "mkl"} & locked("plain").keys()


def licence_of(package: Distribution) -> str:
    """Return what a package's metadata say of its licence."""
    metadata = package.metadata
    said = [metadata.get("License-Expression", ""), metadata.get("License", "").strip().partition("\n")[0]]
    return "; ".join([*said, *(c for c in metadata.get_all("Classifier") or [] if c.startswith("License"))])


def licence_texts(package: Distribution) -> str:
    """Return the licence files that a package brings."""
    files = [f for f in package.files or [] if re.search(r"licen[cs]e|copying", f.name, re.IGNORECASE)]
    return "\n".join(Path(str(f.locate())).read_text(encoding="utf-8", errors="replace") for f in files)


def test_no_package_has_a_licence_that_binds_its_users() -> None:
    installed = {canonicalize_name(p.metadata["Name"]): p for p in distributions()}
    checked = 0
    for name in locked("dev").keys() & installed.keys():
        package = installed[name]
        said = licence_of(package).strip("; ")
        if name in IN_FILE:
            assert IN_FILE[name] in licence_texts(package), f"{name} has another licence than it had"
        elif name not in WITHOUT:
            assert said, f"{name} names no licence: read its text and list it here"
        assert not STRONG.search(said), f"{name} is {said}: it belongs into requirements/others.in"
        checked += 1
    assert checked > 60


def test_a_binding_licence_is_recognised() -> None:
    for text in ("GPL-3.0-only", "GNU General Public License v3", "AGPL-3.0", "License :: OSI Approved :: GPLv3 (GPL)"):
        assert STRONG.search(text), text
    for text in (
        "LGPL-2.1-only",
        "GNU Lesser General Public License v3.0",
        "GNU Library or Lesser General Public License v2 (LGPLv2)",
        "MPL-2.0",
        "BSD-3-Clause",
    ):
        assert not STRONG.search(text), text


def test_what_has_a_binding_licence_runs_apart() -> None:
    assert "lewis" in locked("others")
    assert not {"lewis", "pylablib", "gmsh", "alpyca"} & locked("bench").keys()
