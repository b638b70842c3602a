"""The short check (``make quick``) names tests that are there, and some of every stage."""

import re

import pytest

from tests.architecture.test_conventions import ROOT

STAGES = ("capture", "radiometry", "fit", "simulate", "compare", "decide")
WHOLE = ("architecture",)


def quick_tests(makefile: str) -> list[str]:
    """Return what the variable QUICK of a Makefile lists."""
    found = re.search(r"^QUICK := ((?:.*\\\n)*.*)$", makefile, re.MULTILINE)
    assert found is not None, "the Makefile lists the tests of the short check as QUICK"
    return found[1].replace("\\\n", " ").split()


@pytest.fixture(scope="module")
def listed() -> list[str]:
    return quick_tests((ROOT / "Makefile").read_text(encoding="utf-8"))


def test_every_listed_test_is_there_once(listed):
    assert [path for path in listed if not (ROOT / path).exists()] == []
    assert len(set(listed)) == len(listed)


def test_every_stage_has_a_test_in_it(listed):
    rooms = {path.split("/")[1] for path in listed}
    assert set(STAGES) | {"schemas", *WHOLE} <= rooms
    assert [f"tests/{room}" for room in WHOLE if f"tests/{room}" not in listed] == []


def test_no_listed_test_waits_for_another_program(listed):
    marked = [path for path in listed if path.endswith(".py") and "mark.rigs" in (ROOT / path).read_text("utf-8")]
    assert marked == []


def test_a_list_over_several_lines_is_read_whole():
    assert quick_tests("A := x\nQUICK := one \\\n   two\nquick:\n") == ["one", "two"]
