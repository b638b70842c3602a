"""docs/verification.md names what exists, and results are written into the rows that are theirs, and no other."""

import json
import os
import re

import pytest

from benchmarks.table import rows as numbers
from docs import verification_rows as page

TEXT = page.PAGE.read_text(encoding="utf-8")


def row(command, measured="passes", met="yes"):
    return page.rows(
        f"| claim | command | measured | bar | met |\n|---|---|\n| a | {command} | {measured} | b | {met} |"
    )[0]


def without_summary(text):
    return re.sub(f"{page.SUMMARY_BEGIN}.*{page.SUMMARY_END}", "", text, flags=re.DOTALL)


def test_every_row_names_what_exists():
    assert len(page.rows(TEXT)) > 300
    assert [(r.line, name) for r in page.rows(TEXT) for name in page.missing(r)] == []


@pytest.mark.parametrize(
    ("command", "lacking"),
    [
        ("`pytest tests/fit/test_likelihood.py tests/fit/test_no.py`", ["tests/fit/test_no.py"]),
        ("`test_thorlabs.py::test_nothing`", ["test_thorlabs.py::test_nothing"]),
        ("`test_thorlabs.py::test_a_mute_wheel_times_out`, `::test_no`", ["test_thorlabs.py::test_no"]),
        ("`::test_a_mute_wheel_times_out`", ["::test_a_mute_wheel_times_out"]),
        ("`python benchmarks/samplers.py`, `python -m benchmarks.no`", ["python:benchmarks.no"]),
        ("`make bench`, `make tea`", ["make:tea"]),
        ("`finray simulate press X --force 2`, `finray simulates X`", ["finray:simulates X"]),
        ('`pytest tests/decide -k angle`, headless Chromium, `preset = "medium"`', []),
    ],
)
def test_what_is_not_there_is_found(command, lacking):
    assert page.missing(row(command)) == lacking


def test_a_cell_may_hold_a_bar():
    (found,) = page.rows("| what | command |\n|---|---|\n| a \\| b | `make bench` |")
    assert (found.line, found.cells) == (3, ("a \\| b", "`make bench`"))


@pytest.mark.parametrize(("ratio", "measured", "met"), [(0.46, "0.46x", "yes"), (0.61, "0.61x", "no")])
def test_a_result_is_written_and_the_others_stay(tmp_path, ratio, measured, met):
    result = tmp_path / "left-out.json"
    result.write_text(json.dumps({"ratio": ratio, "coverage95": 0.92}))
    os.utime(result, (1_790_000_000, 1_790_000_000))  # 2026-09-21, before the first commit
    made = page.updated(TEXT, tmp_path, {})
    command = "`python benchmarks/leave_one_material_out.py`"
    what = "full-spectrum error, one material left out | the paper's family"
    assert f"| {what} | {command} | {measured}; 2026-09-21 | at most 0.55x | {met} |" in made
    assert made.count("\n| coverage of 95 % bands, one material left out | nominal |") == 1
    pairs = zip(without_summary(made).split("\n"), without_summary(TEXT).split("\n"), strict=True)
    assert sum(new != old for new, old in pairs) == 2
    assert (f"{what.split(' | ')[0]}, against the paper's family: **no**" in made) == (met == "no")
    # what was measured once stays when there is no result of it
    assert page.updated(made, None, {}) == made


def test_the_page_holds_every_number_of_make_bench():
    table = page.bench_table(TEXT, None)
    assert len(table) == len(numbers()) + 2
    assert "\n".join(table) in TEXT


JUNIT = """<testsuites><testsuite>
<testcase classname="tests.fit.test_prior" name="test_a"/>
<testcase classname="tests.fit.test_prior.TestB" name="test_b"/>
<testcase classname="tests.fit.test_prior" name="test_c"><skipped/></testcase>
<testcase classname="tests.fit.test_likelihood" name="test_d"><failure/></testcase>
</testsuite></testsuites>"""


@pytest.mark.parametrize(
    ("command", "before", "after"),
    [
        ("`pytest tests/fit/test_prior.py`", "tests not run yet", "| 2 tests passed | b | yes |"),
        ("`pytest tests/fit`", "7 tests passed", "| 1 of 3 tests failed | b | no |"),
        ("`pytest tests/decide`", "7 tests passed", None),
        ("`pytest tests/fit/test_prior.py`", "0.3 %", None),
    ],
)
def test_tests_are_counted_where_a_row_counts_them(tmp_path, command, before, after):
    (tmp_path / "tests.xml").write_text(JUNIT)
    made = page.counted(row(command, before), page.outcomes(tmp_path / "tests.xml"))
    assert made == (after and f"| a | {command} {after}")


def test_a_page_without_marks_is_left_alone():
    plain = re.sub(f"{page.BEGIN}.*", "", without_summary(TEXT), flags=re.DOTALL)
    assert page.updated(plain, None, {}) == plain


def test_the_summary_of_the_page_is_that_of_its_rows():
    assert page.updated(TEXT, None, {}) == TEXT
    judged = [r for r in page.rows(without_summary(TEXT)) if len(r.cells) > 4]
    short = [r for r in judged if not r.cells[-1].startswith(("yes", "-")) or r.cells[-1].endswith(" no")]
    listed = re.findall(r"^- .*\*\*$", TEXT, flags=re.MULTILINE)
    assert [line.split(": **")[-1].removesuffix("**") for line in listed] == [r.cells[-1] for r in short]


@pytest.mark.parametrize(
    ("said", "counted"),
    [
        ("yes", "met"),
        ("yes, simulated", "met"),
        ("yes, no hardware", "met"),
        ("yes by that rule; of all, no", "in part"),
        ("no: 13 seen", "not met"),
        ("in part: yes; to 5 mm no", "in part"),
        ("95 % yes; 68 % no", "in part"),
        ("nearly", "in part"),
        ("not shown yet", "not shown"),
        ("not yet", "not shown"),
        ("-", "no bar"),
    ],
)
def test_a_verdict_is_counted_as_what_it_says(said, counted):
    assert page.verdict(row("`make bench`", met=said)) == counted


def test_the_summary_counts_rows_by_section_and_names_what_is_not_met():
    table = "\n| claim | command | measured | bar | met |\n|---|---|---|---|---|\n"
    first = f"## One\n{table}| a | `x` | 1 | 2 | yes |\n| b | `x` | 3 | 2 | no |\n"
    text = f"{first}### Two\n{table}| the same | s | 4 | 2 | nearly |"
    made = page.summary(text)
    assert (
        "| [One](#one) | 1 | 0 | 1 | 0 | 0 |\n| [Two](#two) | 0 | 1 | 0 | 0 | 0 |\n| all | 1 | 1 | 1 | 0 | 0 |" in made
    )
    assert "[One](#one):\n\n- b: **no**\n\n[Two](#two):\n\n- the same: **nearly**" in made


def test_the_page_of_trust_counts_every_row_and_hides_none_that_failed():
    text = (
        "## One\n\n| claim | command | measured | bar | met |\n|---|---|---|---|---|\n| a | `x` | 1 | 2 | yes |\n"
        "| b | `x` | 3 | 2 | no |\n| c | `x` | 4 | none | - |\n| d | `x` | 5 | 2 | at 128 only |\n"
    )
    counted = page.trust_page(text)
    assert "| One | 1 | 1 | 2 |" in counted
    assert "- **b**: 3; bar: 2; met: no" in counted
    assert "- **d**: 5; bar: 2; met: at 128 only" in counted
    assert "**a**" not in counted
