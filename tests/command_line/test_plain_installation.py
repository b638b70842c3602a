"""Without the extra `sim`: no plain verb imports its packages, and each verb that renders names the extra."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from finray_calib.cli.main import VERBS
from tests.command_line.test_check_verb import PLAN
from tests.command_line.test_mechanics_verb import BABY

ROOT = Path(__file__).resolve().parents[2]
# the extra's own packages and all that only they bring
OF_SIM = ("mitsuba", "drjit", "ipctk", "pypardiso", "mkl")
# runs at the start of every interpreter, also of those that a verb starts
ABSENT = f"""
import sys
from importlib.abc import MetaPathFinder

class Absent(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {OF_SIM!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Absent())
"""


@pytest.fixture(scope="module")
def absent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that hides the packages of `sim` from interpreters that have it on their path."""
    folder = tmp_path_factory.mktemp("absent")
    (folder / "sitecustomize.py").write_text(ABSENT)
    return folder


def run_plain(absent: Path, folder: Path, arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a verb in an interpreter that has no package of `sim`."""
    return python(absent, folder, "-m", "finray_calib.cli.main", *arguments.split())


def python(absent: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python without these packages."""
    path = {"PYTHONPATH": f"{absent}{os.pathsep}{ROOT}"}
    return subprocess.run(
        [sys.executable, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, **path},
    )


@pytest.mark.parametrize("name", OF_SIM)
def test_the_packages_are_absent_there(name: str, absent: Path, tmp_path: Path) -> None:
    in_child = (
        "from data_schemas.storage._child_process import call_in_child\n"
        f"call_in_child('importlib:import_module', {{'name': '{name}'}})"
    )
    for code in (f"import {name}", in_child):
        assert f"ModuleNotFoundError: No module named '{name}'" in python(absent, tmp_path, "-c", code).stderr


def test_every_verb_explains_itself(absent: Path, tmp_path: Path) -> None:
    for name in VERBS:
        done = run_plain(absent, tmp_path, f"{name} --help")
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith(f"usage: finray {name}")


@pytest.mark.parametrize(
    "arguments",
    [
        "capture {lab}/plan.toml --rig {lab}/rig.toml --out out --dry-run",
        "rig show {lab}/rig.toml",
        "rig detect",
        "radiometry {lab}/session --out out.json",
        "compare {lab}/press.json {lab}/capture.json --out out.json",
        "decide {lab}/sweep.json --out out.json",
        "design init --out out.toml",
        "design list",
        "design export {lab}/finger.toml --out out",
        "export deck {lab}/finger.toml --dialect abaqus --preset coarse --out out.inp",
    ],
)
def test_a_plain_verb_needs_no_package_of_the_simulation(
    arguments: str, absent: Path, lab: Path, tmp_path: Path
) -> None:
    done = run_plain(absent, tmp_path, arguments.format(lab=lab))
    assert done.returncode == 0, done.stderr


def test_from_a_capture_to_a_paint(absent: Path, lab: Path, tmp_path: Path) -> None:
    for arguments in (
        f"capture {lab}/plan.toml --rig {lab}/rig.toml --out session",
        "radiometry session --out bands.json",
        "fit bands.json --out paint.json --report paint.html",
        "export paint.json --format csv --out paint.csv",
    ):
        done = run_plain(absent, tmp_path, arguments)
        assert done.returncode == 0, done.stderr


def test_a_check_of_a_rig(absent: Path, lab: Path, tmp_path: Path) -> None:
    (tmp_path / "check.toml").write_text(PLAN)
    done = run_plain(absent, tmp_path, f"check run check.toml --rig {lab}/rig.toml --out out")
    assert done.returncode in {0, 1}, done.stderr  # 1: not accepted, as the simulated rig has no guard
    assert (tmp_path / "out/report.html").is_file()


@pytest.mark.parametrize(
    "arguments",
    [
        "demo --out out",
        "simulate render {lab}/finger.toml --paint red={paint} --paint green={paint} --out out.json",
        "simulate sweep {lab}/finger.toml --paint red={paint} --paint green={paint} --angles 0:90:30 --out out.json",
        "simulate render {lab}/finger.toml --paint red={paint} --paint green={paint} --images --out out.json",
        "design show {lab}/finger.toml --out out.png",
        "study two-lights --paint red={paint} --paint green={paint} --out out",
    ],
)
def test_a_verb_that_renders_names_the_extra_in_a_sentence(
    arguments: str, absent: Path, lab: Path, paints: Path, tmp_path: Path
) -> None:
    done = run_plain(absent, tmp_path, arguments.format(lab=lab, paint=paints / "red/paint.json"))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(
        "error: rendering needs Mitsuba, which is in the extra 'sim': pip install 'finray-calib[sim]'"
    )
    assert list(tmp_path.iterdir()) == []


def test_finite_elements_go_without(absent: Path, tmp_path: Path) -> None:
    """They take SciPy's solver and the penalty, with friction."""
    (tmp_path / "rough.toml").write_text(BABY + "friction = 0.3\ndepth_mm = 0.2\n")
    done = run_plain(absent, tmp_path, "simulate press rough.toml --increments 1")
    assert done.returncode == 0, done.stderr
    stored = next(tmp_path.glob("*.mechanics.json")).read_text()
    assert "Coulomb friction 0.3, which follows stick and slip" in stored
    done = run_plain(absent, tmp_path, "simulate press rough.toml --contact barrier --out other.press.json")
    assert done.returncode == 2
    assert "--contact barrier is not possible here: ipctk is not installed" in done.stderr
