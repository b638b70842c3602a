"""Files, folders and modules that pages, docstrings and comments name are there."""

import re
import subprocess
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TRACKED = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
# the changelog names what was, and this test a file that is not there
NO_SUCH = "tests/documentation/test_verification.py"
TEXTS = [name for name in TRACKED if name.endswith((".md", ".py", ".toml", ".importlinter", "Makefile"))]
TEXTS = [name for name in TEXTS if name not in ("CHANGELOG.md", Path(__file__).relative_to(ROOT).as_posix(), NO_SUCH)]
FOLDERS = "data_schemas|rigs|finray_calib|sim|tests|benchmarks|docs"
PATH = re.compile(rf"(?<![\w./-])((?:{FOLDERS})/[\w./-]*\w)")
DOTTED = re.compile(r"(?<![\w./-])((?:data_schemas|rigs|finray_calib|sim|tests)(?:\.[A-Za-z_]\w*)+)")
GROUPS = {
    f"finray_calib.{kind}"
    for kind in (
        "cameras",
        "filter_wheels",
        "lights",
        "stages",
        "load_cells",
        "import_formats",
        "materials",
        "indenter_shapes",
        "pad_shapes",
        "metrics",
    )
}
"""Groups of entry points: names of no module."""
OF_EVERY_MODULE = {"__file__", "__name__", "__path__"}


def missing_paths(text: str) -> list[str]:
    """Return the paths that a text names and that are not there; KIND stands for any name."""
    return [path for path in PATH.findall(text) if not _is_there(path)]


def _is_there(path: str) -> bool:
    known = re.split(r"/(?=[A-Z]+(?:/|$))", path)[0]
    return (ROOT / known).exists() or (ROOT / f"{known}.py").exists()


def missing_names(text: str) -> list[str]:
    """Return the dotted names of this project that lead nowhere."""
    found = [name for name in dict.fromkeys(DOTTED.findall(text)) if name not in GROUPS and not name.endswith(".md")]
    return [name for name in found if not _leads_somewhere(name)]


@cache
def _leads_somewhere(name: str) -> bool:
    """Whether the longest part that is a module, or a folder, says the next word."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        folder = ROOT.joinpath(*parts[:k])
        file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
        if k == len(parts) and (folder.is_dir() or file.is_file()):
            return True
        if file.is_file():
            words = set(re.findall(r"\w+", file.read_text(encoding="utf-8")))
            return parts[k] in words | OF_EVERY_MODULE
    return False


@pytest.mark.parametrize("name", TEXTS)
def test_every_file_and_module_that_is_named_is_there(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    assert missing_paths(text) == []
    assert missing_names(text) == []


def test_what_is_not_there_is_found():
    text = "see sim/mechanics/_press.py, docs/KIND/x, rigs/capture/nothing.py and docs/nowhere/at-all.md"
    assert missing_paths(text) == ["rigs/capture/nothing.py", "docs/nowhere/at-all.md"]
    names = "rigs.contracts.plugin, finray_calib.fit.calibrate_paint, finray_calib.fit.no_such_thing, sim.no_room.name"
    assert missing_names(names) == ["finray_calib.fit.no_such_thing", "sim.no_room.name"]
