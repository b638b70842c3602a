"""A release changes all places of its version together; the conda recipe asks for what the project asks for."""

import datetime
import importlib.util
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
import yaml
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
DAY = datetime.date(2030, 1, 2)
OF_CONDA = {"matplotlib": "matplotlib-base", "opencv-contrib-python-headless": "py-opencv"}
"""Name in the Python index -> name on conda-forge, where they differ."""


@pytest.fixture(scope="module")
def release() -> ModuleType:
    spec = importlib.util.spec_from_file_location("release", ROOT / "requirements" / "release.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def checkout(release: ModuleType, tmp_path: Path) -> Path:
    """A repository with the files that a release changes."""
    for name in (*release.PLACES, "CHANGELOG.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    release.git(tmp_path, "init", "--quiet")
    release.git(tmp_path, "config", "user.email", "somebody@example.org")
    release.git(tmp_path, "config", "user.name", "Somebody")
    release.git(tmp_path, "add", ".")
    release.git(tmp_path, "commit", "--quiet", "--message", "all")
    return tmp_path


def test_the_version_is_the_same_everywhere(release):
    found = {
        re.search(pattern, (ROOT / name).read_text(encoding="utf-8"))[1] for name, pattern in release.PLACES.items()
    }
    assert len(found) == 1


def test_a_dry_run_says_what_would_be_and_changes_nothing(release, checkout):
    lines = release.release(checkout, "0.2.0", DAY, write=False)
    assert 'pyproject.toml: version = "0.2.0"' in lines
    assert "CITATION.cff: date-released: 2030-01-02" in lines
    assert "CHANGELOG.md: ## 0.2.0 (2030-01-02)" in lines
    assert release.git(checkout, "status", "--porcelain") == ""
    assert release.git(checkout, "tag") == ""


def test_a_release_sets_commits_and_tags(release, checkout):
    release.release(checkout, "0.2.0", DAY, write=True)
    assert release.git(checkout, "tag").split() == ["v0.2.0"]
    assert release.git(checkout, "status", "--porcelain") == ""
    assert tomllib.loads((checkout / "pyproject.toml").read_text())["project"]["version"] == "0.2.0"
    cited = yaml.safe_load((checkout / "CITATION.cff").read_text())
    assert (cited["version"], cited["date-released"]) == ("0.2.0", DAY)
    changelog = (checkout / "CHANGELOG.md").read_text()
    assert changelog.index("## Unreleased") < changelog.index("## 0.2.0 (2030-01-02)")
    # what was unreleased is that version's, and nothing is unreleased any more
    with pytest.raises(release.ReleaseError, match="nothing stands below '## Unreleased'"):
        release.release(checkout, "0.3.0", DAY, write=False)


def test_the_first_release_may_have_the_version_that_stands_there(release, checkout):
    lines = release.release(checkout, "0.1.0", DAY, write=True)
    assert "CHANGELOG.md: ## 0.1.0 (2030-01-02)" in lines
    with pytest.raises(release.ReleaseError, match=r"v0\.1\.0: this tag is there already"):
        release.release(checkout, "0.1.0", DAY, write=True)


@pytest.mark.parametrize(
    ("version", "said"),
    [
        ("0.0.9", r"is at 0\.1\.0; give a later version"),
        ("1.0", "give three numbers"),
        ("v1.0.0", "give three numbers"),
    ],
)
def test_a_version_that_cannot_be_is_refused(release, checkout, version, said):
    with pytest.raises(release.ReleaseError, match=said):
        release.release(checkout, version, DAY, write=True)


def test_what_is_not_committed_is_named(release, checkout):
    (checkout / "CHANGELOG.md").write_text("other")
    with pytest.raises(release.ReleaseError, match=r"CHANGELOG\.md: is not committed"):
        release.release(checkout, "0.2.0", DAY, write=True)


def test_a_file_without_its_version_is_named(release, checkout):
    (checkout / "CITATION.cff").write_text("cff-version: 1.2.0\n")
    release.git(checkout, "commit", "--quiet", "--all", "--message", "cut")
    with pytest.raises(release.ReleaseError, match=r"CITATION\.cff: holds no version"):
        release.release(checkout, "0.2.0", DAY, write=True)


def test_the_program_prints_and_exits():
    done = subprocess.run(
        [shutil.which("python3") or "python3", ROOT / "requirements" / "release.py", "1.0"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "give three numbers" in done.stderr


def test_the_recipe_asks_for_what_the_project_asks_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = yaml.safe_load((ROOT / "requirements" / "recipe.yaml").read_text(encoding="utf-8"))
    asked = {f"{OF_CONDA.get(r.name, r.name)} {r.specifier}" for r in map(Requirement, project["dependencies"])}
    run = set(recipe["requirements"]["run"])
    assert run == asked | {f"python {project['requires-python']}"}
    assert recipe["build"]["python"]["entry_points"] == [f"{name} = {at}" for name, at in project["scripts"].items()]
    assert recipe["about"]["license"] == project["license"]
    assert recipe["about"]["summary"] == project["description"]
    backend = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["build-system"]["requires"]
    assert {part.replace(" ", "") for part in recipe["requirements"]["host"]} >= set(backend)
