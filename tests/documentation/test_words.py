"""Words that had to be read twice do not come back, and the pages stay short.

What is checked: pages for users, help of all commands, and texts in the code that are no docstrings, such as errors.
"""

import argparse
import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from finray_calib.cli.main import build_parser

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("tutorials", "how-to", "explanation")
PAGES = [ROOT / "README.md", ROOT / "examples" / "README.md"]
PAGES += [page for kind in KINDS for page in sorted((ROOT / "docs" / kind).glob("*.md"))]
REFERENCE = [
    page
    for page in sorted((ROOT / "docs" / "reference").glob("*.md"))
    if page.name not in {"rooms.md", "README.md"}
    and not page.name.startswith(("data_schemas", "finray_calib", "rigs", "sim"))
]
"""Pages of the reference that people wrote; the others are docstrings."""
CODE = [file for package in ("finray_calib", "sim", "rigs", "data_schemas") for file in (ROOT / package).rglob("*.py")]
ODD = {
    r"\bwhat (was|is) stored is whole\b|\bstored and whole\b": "files already written are complete",
    r"\b(is|are) told\b(?! (apart|to\b|not|what|which|that|from|by))": "the command reports it",
    r"\btold are\b": "the answer gives",
    r"\btells? all\b": "lists them",
    r"\bnothing (above|below) [^.]* says anything\b|\bsays anything\b": "is not meaningful",
    r"\b(is|are) yours to give\b": "enter it",
    r"\bstranger than\b": "the model does not describe it",
    r"\bhas it is told\b": "reports a camera that stands elsewhere",
    r"\bchains strong that\b": "which the render left out because they were weak",
    r"\bof glass and metal\b": "real",
    r"\bshouts on\b": "prints a warning",
    r"\bnothing tells\b": "cannot be seen",
    r"\bby whatever\b": "after any interruption",
    r"\b(is|be) gone on with\b": "continues",
    r"\bgoes on (after|with)\b": "continues",
    r"\bstages, which are whole\b|\bNOT WHOLE\b": "complete, unchanged",
    r"\bfor want of\b": "for lack of",
    r"\bnot told apart\b": "not distinguishable",
    r"\bnought\b": "zero",
    r"\bforetells?\b": "predicts",
    r"\bribs do not see each other\b": "contact between ribs is not computed",
    r"\bis (no finger's|the mesh's)\b": "comes from the mesh, not from the finger",
    r"\bengine in process\b": "name the option to leave out",
    r"\bto speak of\b": "that matters",
    r"\bhas looked why\b": "has found out why",
    r"\bto be had for\b|\bcan be had\b": "the best compromises",
    r"\b(do|does) as well\b": "are as good",
    r"\banswer(s|ed)? to the order\b": "answers the request",
    r"\bthe design as it is\b": "the unchanged design",
    r"\ball the same\b(?=[.;:,]| and)": "anyway",
    r"\bevenly likely\b": "uniformly distributed",
    r"\bover its (mean|norm|value)\b|\bcontact over no contact\b|\bover the root of\b": "divided by: x / its mean",
    r"\btaught by\b(?! the)|\bteaching presses\b": "trained on; training presses",
    r"\b(unit|number|name|place|stage|light|panel)s? stands?\b(?! (for|in for|still)\b)": "is, is given, is at rest",
    r"\b(face|room)s of the (code|house)\b": "package",
    r"\bby the word of the (laser|controller|lamp)\b|\bcontroller's word\b": "reported by the controller only",
    r"\bno (witness|proof) of\b": "does not confirm",
    r"\b(error|width|stiffness|root mean square)[^.;]{0,60} over (that|those) (of|before|at)\b": "divided by: x / y",
    r"\b(that|which) (did not|no) teach|\bpress(es)? taught\b": "trained on; training presses",
    r"\bwithin each other\b": "nested",
    r"\bholds [^.;]{1,60}, where [^.;]{1,60} (is|are) needed": "contains X, but Y is needed",
    r"\bneeded (is|are)\b": "must be",
    r"\bdamaged (lines?|data|message)\b": "corrupted data",
    r"\bthe ones? of\b": "repeat the noun",
    r"\b(is|are) understood\b": "is supported",
    r"\b(by|with|under) (the|a) (penalty|barrier)\b(?! (contact|method))": "with penalty contact, with barrier contact",
    r"\bdo(es)? not (hold|carry) (contact|uncertainty)\b": "leaves it out",
    r"\bas a witness\b|\bits own witness\b|\bwitness(es)? (of|that)\b": "confirms that",
    r"\bpress less deep\b": "press less deeply",
    r"\bis a [A-Z][a-z]+[A-Z]\w+, a [A-Z][a-z]+[A-Z]\w+ is needed": "contains band signals, but a paint is needed",
}
"""What was read twice -> what to write; a page says it in other words, or not."""
MOST_WORDS = 40_000
MOST_WORDS_OF_README, MOST_LINES_OF_README = 1000, 90
OVERLAP_WORDS, LARGEST_OVERLAP = 8, 0.02


def odd(text: str) -> list[str]:
    """Return what a text holds of the oddities, line breaks taken out."""
    flat = " ".join(text.split())
    return [
        f"{found.group()!r}: {better}" for pattern, better in ODD.items() for found in re.finditer(pattern, flat, re.I)
    ]


def texts_of(file: Path) -> Iterator[str]:
    """Yield the texts of a file of code that are no docstrings and no patterns of one word."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


def helps(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    """Yield the help of a parser and of its verbs."""
    yield parser.prog, parser.format_help()
    for action in parser._actions:  # noqa: SLF001 - argparse offers no other way to its verbs
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for child in dict.fromkeys(action.choices.values()):
                yield from helps(child)


def without_code(page: Path) -> str:
    """Return a page without its blocks of code."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return "\n".join(line for line in text.splitlines() if not re.match(r" {4}(?! *[-|*\d])", line))


def prose(page: Path) -> str:
    """Return a page without its blocks of code and tables."""
    return "\n".join(line for line in without_code(page).splitlines() if not line.lstrip().startswith("|"))


@pytest.mark.parametrize("page", [*PAGES, *REFERENCE], ids=lambda page: str(page.relative_to(ROOT)))
def test_no_page_has_words_that_were_read_twice(page):
    assert odd(page.read_text(encoding="utf-8")) == []


def test_no_help_has_them():
    assert [(name, found) for name, text in helps(build_parser()) for found in odd(text)] == []


def test_no_text_of_the_code_has_them():
    assert [(file.name, found) for file in CODE for text in texts_of(file) for found in odd(text)] == []


def test_per_cent_has_a_space_in_the_pages():
    """As the SI writes it, `0.6 %`; code and names of keys between backticks may differ."""
    pages = {page.name: re.sub(r"`[^`]*`", "", without_code(page)) for page in PAGES}
    assert [(name, found) for name, text in pages.items() for found in re.findall(r"\S*\d%", text)] == []


def test_no_number_of_the_code_is_formatted_with_per_cent_and_no_space():
    """Python's format `.1%` writes none: the texts take `{100 * share:.1f} %`."""
    for file in CODE:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FormattedValue) and node.format_spec is not None:
                ends = ast.unparse(node.format_spec).rstrip("'\"")
                assert not ends.endswith("%"), f"{file.relative_to(ROOT)}:{node.lineno}"


def test_what_was_read_twice_is_found():
    assert len(odd("the drift is told, and what was stored is whole")) == 2
    assert odd("a.json: is a PaintCalibration, a BandSignals is needed here") != []
    assert odd("it cannot be told apart; it is told to stop") == []


def test_the_pages_have_at_most_forty_thousand_words():
    pages = {kind: sorted((ROOT / "docs" / kind).glob("*.md")) for kind in KINDS}
    counted = {kind: sum(len(without_code(page).split()) for page in pages[kind]) for kind in KINDS}
    assert sum(counted.values()) <= MOST_WORDS, counted


def test_the_readme_is_short_and_shows_a_touch():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES_OF_README
    assert len(text.split()) <= MOST_WORDS_OF_README
    assert text.index("docs/images/touch.png") < text.index("## Try it")


def test_little_is_said_twice():
    """Of all runs of eight words in the prose, at most 2 % occur more than once."""
    runs: Counter[tuple[str, ...]] = Counter()
    for page in PAGES:
        words = re.findall(r"[\w'.-]+", prose(page).lower())
        runs.update(tuple(words[k : k + OVERLAP_WORDS]) for k in range(len(words) - OVERLAP_WORDS + 1))
    twice = sum(count for count in runs.values() if count > 1)
    assert twice / runs.total() < LARGEST_OVERLAP, [" ".join(run) for run, count in runs.most_common(20)]
