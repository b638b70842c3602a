"""Check docs/verification.md against the code, and write results into it: ``python -m docs.verification_rows``.

Every test, benchmark, target of make and verb that a row names must exist. With results, of ``make bench`` and of
pytest (``--junitxml``), two kinds of rows are written anew; no other row is touched, and nothing is filled in that was
not measured:

    python -m docs.verification_rows [--bench bench-out] [--junit FILE.xml]

The summary at the top of the page is counted from the rows at each run.

- the table between the marks, one row for each number of ``benchmarks/table.py``;
- rows whose measured value is "N tests passed" or "N of M tests failed", by the tests that their command names.
"""

import argparse
import math
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "verification.md"
BEGIN, END = "<!-- written by make verification -->", "<!-- end of what is written -->"
SUMMARY_BEGIN, SUMMARY_END = "<!-- counted by make verification -->", "<!-- end of what is counted -->"
HEADER = ["| number | against | command | measured | bar | met |", "|---|---|---|---|---|---|"]
COUNTED = re.compile(r"\d+ tests passed|\d+ of \d+ tests failed|tests not run yet")
COMMAND, MEASURED, MET = 1, 2, 4


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the page.

    Attributes
    ----------
    line
        Where it stands, from 1.
    cells
        Claim, command, measured value, bar, met; or fewer, or more.
    """

    line: int
    cells: tuple[str, ...]

    @property
    def commands(self) -> list[str]:
        """What stands between backticks in the second cell."""
        return re.findall(r"`([^`]+)`", self.cells[COMMAND]) if len(self.cells) > COMMAND else []


def rows(text: str) -> list[Row]:
    """Return the rows of all tables, without headers."""
    found = []
    lines = text.split("\n")
    for number, line in enumerate(lines, start=1):
        is_header = number < len(lines) and re.fullmatch(r"\|[-| :]+\|", lines[number])
        if line.startswith("|") and not is_header and not re.fullmatch(r"\|[-| :]+\|", line):
            cells = re.split(r"(?<!\\)\|", line.strip().strip("|"))
            found.append(Row(number, tuple(cell.strip() for cell in cells)))
    return found


def missing(row: Row) -> list[str]:
    """Return what a row's commands name and the code lacks."""
    lacking: list[str] = []
    last_file = ""
    for command in row.commands:
        for named in _tests(command, last_file):
            path, _, test = named.partition("::")
            last_file = path
            file = _test_file(path)
            if file is None or (test and not _holds(file, test.split("::")[-1])):
                lacking.append(named)
        lacking += [part for part in _programs(command) if not _exists(part)]
    return lacking


def _tests(command: str, last_file: str) -> Iterator[str]:
    """Yield the tests that a command names, as FILE or FILE::NAME; ``::NAME`` is in the file named before."""
    words = command.split()
    for word in words if words[:1] == ["pytest"] or len(words) == 1 or words[0].startswith("test") else []:
        plain = re.sub(r"\[.*", "", word)
        if plain.startswith("::"):
            yield f"{last_file}{plain}"
        elif re.match(r"(tests|benchmarks)(/|$)|test_\w+\.py", plain):
            yield plain


def _test_file(name: str) -> Path | None:
    """Return the file or folder of a test, by its path or by its name alone."""
    if name and (ROOT / name).exists():
        return ROOT / name
    found = sorted((ROOT / "tests").rglob(name)) if name and "/" not in name else []
    return found[0] if found else None


def _holds(file: Path, test: str) -> bool:
    return test == "..." or bool(re.search(rf"\b(?:def|class) {re.escape(test)}\b", file.read_text(encoding="utf-8")))


def _programs(command: str) -> Iterator[str]:
    """Yield the benchmark, target or verb that a command runs, as ``kind:name``."""
    words = command.split()
    if words[:1] == ["make"]:
        yield from (f"make:{word}" for word in words[1:] if "=" not in word)
    elif words[:1] == ["finray"] and len(words) > 1 and words[1].isalpha():
        yield f"finray:{' '.join(words[1:3])}"
    elif words[:1] == ["python"]:
        yield f"python:{words[2] if words[1] == '-m' else words[1]}"


def _exists(program: str) -> bool:
    kind, _, name = program.partition(":")
    if kind == "make":
        return bool(re.search(rf"^{re.escape(name)}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    if kind == "python":
        file = ROOT / (name if name.endswith(".py") else f"{name.replace('.', '/')}.py")
        return file.is_file()
    from finray_calib.cli.main import VERBS

    return name.split()[0] in VERBS


def bench_table(text: str, folder: Path | None) -> list[str]:
    """Return the table of ``make bench``: measured where `folder` holds the result, else as it stands in `text`."""
    from benchmarks.table import rows as numbers

    before = {row.cells[:2]: row.cells[MEASURED + 1 :] for row in rows(_between(text)) if len(row.cells) == 6}
    lines = list(HEADER)
    for number in numbers():
        what, against = number.what, number.against
        command = number.command if " " in number.command else f"python benchmarks/{number.command}"
        command = "make bench-fit" if number.command == "pytest" else command
        value = math.nan if folder is None else number.measured(folder)
        if folder is None or math.isnan(value):
            measured, _, met = before.get((what, against), ("not measured by this table yet", "", "not shown"))
        else:
            measured = f"{value:.3g}{number.unit}" if value < 1000 else f"{value:.0f}{number.unit}"
            measured += f"; {measured_when(folder / number.file)}"
            met = "yes" if number.low <= value <= number.high else "no"
        lines.append(f"| {what} | {against} | `{command}` | {measured} | {number.bar} | {met} |")
    return lines


def measured_when(result: Path) -> str:
    """Return the day on which a result was written and the newest commit of that time; without git the day alone."""
    written = datetime.fromtimestamp(result.stat().st_mtime, UTC)
    command = ["git", "log", "-1", "--format=%h", f"--before={written.isoformat(timespec='seconds')}"]
    try:
        found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        found = ""
    return f"{written:%Y-%m-%d}, {found}".removesuffix(", ")


def _between(text: str) -> str:
    return text.partition(BEGIN)[2].partition(END)[0]


def outcomes(junit: Path) -> dict[str, tuple[int, int]]:
    """Return test file -> tests that passed and tests that failed, of a JUnit file that pytest wrote."""
    counts: dict[str, tuple[int, int]] = {}
    for case in ET.parse(junit).getroot().iter("testcase"):
        parts = case.attrib["classname"].split(".")
        module = [k for k, part in enumerate(parts) if part.startswith("test_")]
        if not module or case.find("skipped") is not None:
            continue
        file = "/".join(parts[: module[0] + 1]) + ".py"
        failed = case.find("failure") is not None or case.find("error") is not None
        passed, bad = counts.get(file, (0, 0))
        counts[file] = (passed + (not failed), bad + failed)
    return counts


def counted(row: Row, results: Mapping[str, tuple[int, int]]) -> str | None:
    """Return the line of a row that counts tests, with their outcome; None where it counts none or they did not run."""
    if len(row.cells) != MET + 1 or not COUNTED.fullmatch(row.cells[MEASURED]):
        return None
    places = [place for command in row.commands for test in _tests(command, "") if (place := _test_file(test))]
    names = [place.relative_to(ROOT).as_posix() for place in places]
    ran = [counts for file, counts in results.items() if any(f"{file}/".startswith(f"{name}/") for name in names)]
    if not ran:
        return None
    passed, failed = (sum(counts) for counts in zip(*ran, strict=True))
    cells = list(row.cells)
    cells[MEASURED] = f"{failed} of {passed + failed} tests failed" if failed else f"{passed} tests passed"
    cells[MET] = "no" if failed else "yes"
    return f"| {' | '.join(cells)} |"


def updated(text: str, bench: Path | None, results: Mapping[str, tuple[int, int]]) -> str:
    """Return the page with what was measured."""
    lines = text.split("\n")
    for row in rows(text):
        line = counted(row, results)
        if line is not None:
            lines[row.line - 1] = line
    page = "\n".join(lines)
    if BEGIN in page:
        page = _replaced(page, BEGIN, END, "\n".join(bench_table(page, bench)))
    return _replaced(page, SUMMARY_BEGIN, SUMMARY_END, summary(page)) if SUMMARY_BEGIN in page else page


def _replaced(page: str, begin: str, end: str, made: str) -> str:
    """Return the page with what stands between two marks replaced."""
    head, _, rest = page.partition(begin)
    return f"{head}{begin}\n\n{made}\n\n{end}{rest.partition(end)[2]}"


NOT_BY_THIS_TABLE = "not measured by this table"
TRUST = """\
# Which number can I trust

Made from the rows of [Verification](../verification.md) when the site is built: how many claims of each subject met the
bar that was set before the measurement, which ones did not, and what was found in place of it. A number that stands in
no row was not tested against anything outside of the program; its interval then rests on the model alone, see [what
each number knows](../explanation/uncertainty.md). To trace one number of yours to its frames, see [trace and
verify](../how-to/trust-a-number.md).
"""


VERDICTS = ("met", "in part", "not met", "not shown", "no bar")


def verdict(row: Row) -> str:
    """Return which of `VERDICTS` the last cell of a row says; what begins with none of their words is met in part."""
    said = row.cells[-1].lower()
    first = re.match(r"[a-z]*", said)
    if said in ("-", ""):
        return "no bar"
    if said.startswith(("not shown", "not yet")):
        return "not shown"
    if said.startswith("yes") and said.endswith(" no"):
        return "in part"
    return {"yes": "met", "no": "not met"}.get(first.group() if first else "", "in part")


def by_subject(text: str, headings: tuple[str, ...] = ("## ",)) -> dict[str, list[Row]]:
    """Return heading -> the rows below it that have a verdict, without the summary of them all."""
    text = re.sub(f"{SUMMARY_BEGIN}.*{SUMMARY_END}", "", text, flags=re.DOTALL)
    lines = text.split("\n")
    subjects: dict[str, list[Row]] = {}
    for row in rows(text):
        if len(row.cells) > MET and NOT_BY_THIS_TABLE not in row.cells[-3]:
            heading = next(line for line in reversed(lines[: row.line]) if line.startswith(headings))
            subjects.setdefault(heading.lstrip("# "), []).append(row)
    return subjects


def summary(text: str) -> str:
    """Return a table of how many rows of each section met their bar, and a list of those that did not."""
    sections = by_subject(text, ("## ", "### "))
    table = [f"| section | {' | '.join(VERDICTS)} |", f"|---{'|---' * len(VERDICTS)}|"]
    total = dict.fromkeys(VERDICTS, 0)
    lists = []
    for heading, found in sections.items():
        link = f"[{heading}](#{re.sub(r'[^a-z0-9 -]', '', heading.lower()).replace(' ', '-')})"
        counts = {name: sum(verdict(row) == name for row in found) for name in VERDICTS}
        total = {name: total[name] + counts[name] for name in VERDICTS}
        table.append(f"| {link} | {' | '.join(str(counts[name]) for name in VERDICTS)} |")
        short = [row for row in found if verdict(row) not in ("met", "no bar")]
        lists += (
            [f"{link}:", "", *(f"- {_claim(row, found)}: **{row.cells[-1]}**" for row in short), ""] if short else []
        )
    table.append(f"| all | {' | '.join(str(total[name]) for name in VERDICTS)} |")
    return "\n".join([*table, "", "Rows that are not met, met in part, or not shown:", "", *lists]).rstrip()


def _claim(row: Row, found: list[Row]) -> str:
    """Return the claim of a row in few words; "the same" is preceded by the claim that it repeats."""
    claim = _shortened(row.cells[0], 30)
    if len(row.cells) > MET + 1 and row.cells[1] != "-":
        return f"{claim}, against {row.cells[1]}"
    others = [other.cells[0] for other in found if other.line < row.line and not other.cells[0].startswith("the same")]
    return f"{_shortened(others[-1], 15)}; {claim}" if claim.startswith("the same") and others else claim


def _shortened(text: str, words: int) -> str:
    kept = " ".join(text.split()[:words])
    return text if len(text.split()) <= words else kept + "`" * (kept.count("`") % 2) + " ..."


def trust_page(text: str) -> str:
    """Return a page that counts, for each subject of the page of rows, what met its bar, and lists what did not."""
    table = ["| subject | met | no bar set | not met, in part, or not shown |", "|---|---|---|---|"]
    lists = []
    for subject, found in by_subject(text).items():
        short = [row for row in found if verdict(row) not in ("met", "no bar")]
        met = sum(verdict(row) == "met" for row in found)
        table.append(f"| {subject} | {met} | {len(found) - met - len(short)} | {len(short)} |")
        lists += [f"## {subject}", "", *(_short_of(row) for row in short), ""] if short else []
    return "\n".join([TRUST, *table, "", *lists])


def _short_of(row: Row) -> str:
    """Return a row that did not meet its bar as an item of a list."""
    claim, measured, bar, met = (row.cells[k].replace("\\|", "|") for k in (0, -3, -2, -1))
    item = f"- **{claim}**: {measured}; bar: {bar}; met: {met}"
    return re.sub(r"\]\((?!\w+:|#)", "](../", item)  # the page lies one folder deeper


def main(words: list[str] | None = None) -> int:
    """Write the page and tell what its rows name in vain; return 1 when there is such a row."""
    parser = argparse.ArgumentParser(description="Check and fill docs/verification.md.")
    parser.add_argument("--bench", type=Path, metavar="FOLDER", help="results of make bench")
    parser.add_argument("--junit", type=Path, action="append", default=[], metavar="FILE", help="results of pytest")
    arguments = parser.parse_args(words)
    results: dict[str, tuple[int, int]] = {}
    for file in arguments.junit:
        results |= outcomes(file)
    text = updated(PAGE.read_text(encoding="utf-8"), arguments.bench, results)
    PAGE.write_text(text, encoding="utf-8")
    lacking = [(row, name) for row in rows(text) for name in missing(row)]
    for row, name in lacking:
        sys.stdout.write(f"{PAGE.name}:{row.line}: names {name}, which is not there\n")
    return int(bool(lacking))


if __name__ == "__main__":
    sys.exit(main())
