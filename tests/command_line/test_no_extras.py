"""No verb needs a package that `make demo` does not install: all tests of this folder run without them."""

import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from tests.command_line.conftest import FOR_A_MAKE, NOT_FOR_USERS, PACKAGES_OF_EXTRAS
from tests.command_line.running import finray

ROOT = Path(__file__).parents[2]
HIDDEN = [name for extra, names in PACKAGES_OF_EXTRAS.items() if extra not in FOR_A_MAKE for name in names]


def test_every_extra_is_hidden_here_or_belongs_to_a_make():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    # what `make demo` installs is no extra in this sense
    installed = {"sim"}
    assert set(extras) - installed == {*PACKAGES_OF_EXTRAS, *NOT_FOR_USERS}


@pytest.mark.parametrize("name", HIDDEN)
def test_the_package_is_hidden_from_this_process_and_its_children(name):
    with pytest.raises(ImportError):
        import_module(name)
    child = subprocess.run([sys.executable, "-c", f"import {name}"], capture_output=True, text=True, check=False)
    assert child.returncode == 1
    assert f"import of {name} halted" in child.stderr


@pytest.mark.parametrize(("file_format", "ending"), [("exr", "exr"), ("netcdf", "nc")])
def test_a_format_of_others_that_needs_an_extra_names_it(paints, tmp_path, file_format, ending):
    outcome = finray(f"export {paints}/red/paint.json --format {file_format} --out {tmp_path}/paint.{ending}")
    assert outcome.status == 2
    assert f"pip install 'finray-calib[{file_format}]'" in outcome.err


@pytest.mark.parametrize("word", ["nexus", "bluesky"])
def test_frames_for_beamline_tools_name_the_extra(lab, tmp_path, word):
    ending = {"nexus": "nxs", "bluesky": "jsonl"}[word]
    outcome = finray(f"export {word} {lab}/session --out {tmp_path}/a.{ending}")
    assert outcome.status == 2
    assert "pip install 'finray-calib[nexus]'" in outcome.err
    assert list(tmp_path.iterdir()) == []
