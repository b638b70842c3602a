"""The drawing, the walks and the table of tasks in the documentation say what is in the code."""

import ast
import graphlib
import re
from functools import cache
from pathlib import Path

import pytest

from docs.rooms_drawing import (
    BEGIN,
    PAGE,
    TABLE_PAGE,
    imports_between_rooms,
    mermaid,
    redrawn,
    table_page,
    without_shortcuts,
)
from tests.architecture.test_conventions import ROOT

PAGES = [ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
# `path/to/file.py::Name.part`, or a path alone
PLACE = re.compile(r"`((?:\w+/)+\w+\.py)(?:::([\w.]+))?`")
TASKS = (
    "Add a filter wheel",
    "Change the prior of the mode",
    "Add a metric",
    "Change a page's plot",
    "Add a pad shape",
    "Add a material",
    "Add a record field",
    "Add an import format",
    "Add an indenter",
    "Add a study",
    "Add a check",
    "Add a report section",
)


def places(text: str) -> list[tuple[str, str]]:
    """Return (path, symbol) of every place that a text names; the symbol is empty where a file is named alone."""
    return PLACE.findall(text)


@cache
def symbols(path: Path) -> frozenset[str]:
    """Return what a file defines at its top, and ``Class.member`` for the members of its classes."""
    return frozenset(_defined(ast.parse(path.read_bytes()).body, ""))


def _defined(body: list[ast.stmt], above: str) -> set[str]:
    found: set[str] = set()
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(above + node.name)
        if isinstance(node, ast.ClassDef):
            found |= _defined(node.body, f"{above}{node.name}.")
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {above + target.id for target in targets if isinstance(target, ast.Name)}
    return found


def rows(text: str) -> dict[str, list[str]]:
    """Return the other cells of each row of the table of tasks, by task."""
    table = text.partition("## Where a change goes")[2]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in table.splitlines() if line[:1] == "|"]
    return {task.strip(): rest for task, *rest in cells[2:]}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_place_that_a_page_names_is_there(page):
    for path, symbol in places(page.read_text(encoding="utf-8")):
        assert (ROOT / path).is_file(), f"{page.name} names {path}, which is not there"
        assert not symbol or symbol in symbols(ROOT / path), f"{page.name} names {path}::{symbol}; it is elsewhere now"


def test_each_common_task_begins_at_a_symbol():
    table = rows(PAGE.read_text(encoding="utf-8"))
    assert set(table) == set(TASKS)
    for task, (where, what) in table.items():
        assert any(symbol for _, symbol in places(where)), f"{task}: name a symbol to begin at"
        assert len(what) > 40, f"{task}: say what to do there"


def test_both_walks_name_a_function_at_each_step():
    text = PAGE.read_text(encoding="utf-8")
    for title in ("A frame, from the camera to a decision", "A design, from its file to an angle"):
        walk = text.partition(f"## {title}\n")[2].partition("\n## ")[0]
        steps = re.split(r"^\d+\. ", walk, flags=re.MULTILINE)[1:]
        assert len(steps) >= 6
        for step in steps:
            assert any(symbol for _, symbol in places(step)), step


def test_the_drawing_is_that_of_the_code():
    page = PAGE.read_text(encoding="utf-8")
    rooms = imports_between_rooms()
    assert redrawn(page, rooms) == page, "draw it again: make drawing"
    assert TABLE_PAGE.read_text(encoding="utf-8") == table_page(rooms), "draw it again: make drawing"


def test_a_page_without_room_for_the_drawing_is_refused():
    with pytest.raises(ValueError, match="needs the two lines"):
        redrawn(PAGE.read_text(encoding="utf-8").replace(BEGIN, ""), {})


def test_arrows_that_follow_from_others_are_left_out():
    rooms = {"cli": {"fit", "ground"}, "fit": {"ground", "spectra"}, "spectra": {"ground"}, "ground": set()}
    assert without_shortcuts(rooms) == {"cli": {"fit"}, "fit": {"spectra"}, "spectra": {"ground"}, "ground": set()}
    assert "    cli --> fit\n" in mermaid(rooms)
    assert "cli --> ground" not in mermaid(rooms)


def test_rooms_that_import_each_other_are_not_drawn():
    with pytest.raises(graphlib.CycleError):
        mermaid({"fit": {"compare"}, "compare": {"fit"}})


def test_a_symbol_that_is_not_there_is_found(tmp_path):
    file = tmp_path / "rooms.py"
    file.write_text("LIMIT = 1\nshare: float = 0.5\n\nclass Wheel:\n    slots: int\n    def go_to(self): ...\n")
    assert symbols(file) == {"LIMIT", "share", "Wheel", "Wheel.slots", "Wheel.go_to"}
    assert places("see `a/b.py::Wheel.go_to`, `a/c.py` and `b.py::x`") == [("a/b.py", "Wheel.go_to"), ("a/c.py", "")]
