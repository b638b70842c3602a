"""The wheel and the source archive hold what they must, and the container file installs what the project needs."""

import re
import subprocess
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from hatchling.build import build_sdist, build_wheel

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PACKAGES = ("data_schemas", "rigs", "finray_calib", "sim")
FOR_DEVELOPERS = {".gitignore"}


def tracked(*folders: str) -> set[str]:
    """Return the files of the project that are under version control and there."""
    listed = subprocess.run(["git", "ls-files", *folders], capture_output=True, text=True, check=True, cwd=ROOT)
    return {name for name in listed.stdout.split("\n") if name and (ROOT / name).exists()}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[set[str], set[str]]:
    """Names of the files in the wheel and in the source archive."""
    folder = tmp_path_factory.mktemp("dist")
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(ROOT)
        wheel, source = build_wheel(str(folder)), build_sdist(str(folder))
    with zipfile.ZipFile(folder / wheel) as archive:
        in_wheel = set(archive.namelist())
    with tarfile.open(folder / source) as archive:
        in_source = {name.partition("/")[2] for name in archive.getnames()}
    return in_wheel, in_source


def test_the_wheel_holds_every_file_of_the_packages_and_nothing_else(built):
    of_packages = {name for name in built[0] if ".dist-info/" not in name}
    assert tracked(*PACKAGES) <= of_packages
    # what is not tracked yet is new here; compiled files and caches must not be shipped
    assert not [name for name in of_packages if "__pycache__" in name or name.endswith((".pyc", ".so", ".log"))]
    assert {name.split("/")[0] for name in of_packages} == set(PACKAGES)


def test_data_files_of_each_kind_are_in_the_wheel(built):
    data = {Path(name).suffix for name in tracked(*PACKAGES)} - {".py", ""}
    assert {".json", ".toml", ".j2", ".css", ".typed"} <= data
    assert {suffix for suffix in data if not any(name.endswith(suffix) for name in built[0])} == set()
    assert any(name.endswith("measured_spectra.json") for name in built[0])
    assert all((f"{package}/py.typed") in built[0] for package in PACKAGES)


def test_the_source_archive_holds_the_project(built):
    missing = tracked() - built[1] - FOR_DEVELOPERS
    assert missing == set()


def test_the_citation_names_this_version_and_licence():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", text, flags=re.MULTILINE)[1] == PROJECT["version"]
    assert re.search(r"^license: (.+)$", text, flags=re.MULTILINE)[1] == PROJECT["license"]


def test_the_container_copies_what_the_build_reads_and_runs_as_a_user():
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    copied = {name for line in re.findall(r"^COPY (.+) \S+$", text, flags=re.MULTILINE) for name in line.split()}
    assert copied == {"requirements/sim.lock", "pyproject.toml", "README.md", "LICENSE", *PACKAGES}
    assert all((ROOT / name).exists() for name in copied)
    assert "--require-hashes" in text
    assert text.index("USER finray") < text.index("ENTRYPOINT")
