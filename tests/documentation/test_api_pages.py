"""The pages of docs/reference are those that the code gives today."""

import importlib
import subprocess
import sys

import pytest

from docs import api_pages

PAGES = api_pages.pages()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_what_the_code_gives_today(name):
    stored = api_pages.PAGES / name
    assert stored.is_file(), "run: make reference"
    assert stored.read_text(encoding="utf-8") == PAGES[name], "run: make reference"


def test_no_page_is_of_a_face_that_is_gone():
    assert {path.name for path in api_pages.PAGES.iterdir()} == set(PAGES) | set(api_pages.BESIDE)


@pytest.mark.parametrize("face", ["finray_calib", "finray_calib.fit", "sim.optics", "data_schemas"])
def test_a_page_has_every_name_that_python_finds_in_the_face(face):
    names = [name for name in importlib.import_module(face).__all__ if not name.startswith("__")]
    assert names
    assert not [name for name in names if f"`{name}" not in PAGES[f"{face}.md"]]


def test_what_is_written_of_a_function_and_of_a_class():
    page = PAGES["finray_calib.md"]
    assert "- **`press_finger(design, *, force_n=None, increments=4, contact='auto', " in page
    assert "progress=None) -> FingerPress`** Press the design's indenter in by finite elements." in page
    assert "**`FingerPress(NamedTuple)`** A finger pressed by finite elements: its force over the push" in page
    assert "[_finger_functions](../../finray_calib/_finger_functions.py)" in page
    assert "- `DEFAULT_PAINTS` [_rig_files]" in PAGES["rigs.md"]


def test_a_name_that_leads_nowhere_is_told():
    with pytest.raises(LookupError, match=r"__init__\.py: exports no_such_name, which is defined nowhere"):
        api_pages.defined("no_such_name", api_pages.ROOT / "finray_calib" / "__init__.py")


def test_the_code_is_read_and_not_imported():
    loaded = "import sys, docs.api_pages as a; a.pages(); print(sorted({'numpy', 'sim', 'rigs'} & sys.modules.keys()))"
    told = subprocess.run(
        [sys.executable, "-c", loaded], capture_output=True, text=True, check=True, cwd=api_pages.ROOT
    )
    assert told.stdout.strip() == "[]"
