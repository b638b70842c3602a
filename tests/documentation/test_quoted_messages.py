"""Messages and lines of output that pages quote exist in the code.

A quoted text is compared word by word with the texts of the code. A value that the code fills in
stands for a word that looks like a value: with a digit, a capital letter, a quotation mark, or a unit. "..." in the
quotation stands for any words. What two texts of the code make together is listed in `COMPOSED`.
"""

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [page for kind in ("tutorials", "how-to", "reference") for page in sorted((ROOT / "docs" / kind).glob("*.md"))]
HEADS = ("message", "it says", "warning")
"""First column of a table that quotes messages."""
BLOCKS = {
    "first-paint.md": r"^    red\.paint\.json: .*\n.*\n",
    "first-finger.md": r"^ +push .*\n +push .*\n",
    "first-comparison.md": r"^    headline: .*\n",
    "calibrate-a-paint.md": r"(?<=```text\n)(?:.*\n)+?(?=```)",
    "connect-a-manual-wheel.md": r"^ +Turn the filter wheel .*\n +Press Enter .*\n",
    "when-something-fails.md": r"^finray demo: error: (?:.*\n)+?(?=```)",
}
"""Page -> its lines of output; those of `finray doctor` and `finray trace` are tables that programs fill in."""
COMPOSED = {
    "emission measured: the signal exceeds reflected laser, leak and stray light by 362 standard deviations "
    "(threshold 3.2)": (
        "emission measured: ...",
        "the signal exceeds reflected laser, leak and stray light by 362 standard deviations (threshold 3.2)",
    ),
    "finray demo: error: the press by finite elements was ended by SIGILL (a compiled library uses instructions that "
    "this processor does not have); it had taken 0.31 GiB of memory. Its log is "
    "finray-demo/logs/the-press-by-finite-elements.log. Finished work is kept; run the same command again to continue. "
    "If it fails again, run 'finray doctor' to see what this machine lacks": (
        "the press by finite elements",
        "was ended by SIGILL",
        "a compiled library uses instructions that this processor does not have",
        "; it had taken 0.31 GiB of memory",
        "... Its log is FILE. Finished work is kept; run the same command again to continue. If it fails again, run "
        "'finray doctor' to see what this machine lacks",
    ),
    "fails when it opens": ("fails ...", "when it opens"),
}
"""What several functions make together -> the texts of the code that it is made of; its numbers may be others."""
VALUE = "\0"
LEAST_LITERAL = 0.25
"""Of the words of a quotation, this share must be words of one text of the code."""
MOST_WORDS_OF_A_VALUE = 20
UNITS = frozenset({"deg", "mm", "px", "s", "nm", "N", "%", "red", "green", "blue", ""})


def without_numbers(quotation: str) -> str:
    """Return a quotation with "#" for its numbers, which a page takes from a run and may take anew."""
    return re.sub(r"\d+", "#", quotation)


MADE_OF = {without_numbers(quotation): texts for quotation, texts in COMPOSED.items()}


def template_of(node: ast.AST) -> str | None:
    """Return a text of the code with `VALUE` where a value is filled in; None for what is no text."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(str(v.value) if isinstance(v, ast.Constant) else VALUE for v in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = template_of(node.left), template_of(node.right)
        return None if left is None and right is None else f"{left or VALUE}{right or VALUE}"
    return None


@functools.cache
def templates() -> dict[tuple[str, ...], frozenset[str]]:
    """Return the words of every text in the code, docstrings left out, and which of them hold no value."""
    found: dict[tuple[str, ...], frozenset[str]] = {}
    for package in ("finray_calib", "sim", "rigs", "data_schemas"):
        for file in (ROOT / package).rglob("*.py"):
            tree = ast.parse(file.read_text(encoding="utf-8"))
            bare = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
            for text in (template_of(node) for node in ast.walk(tree) if id(node) not in bare):
                words = tuple((text or "").split())
                if any(word.strip(VALUE) for word in words):
                    found[words] = frozenset(plain(word) for word in words if VALUE not in word)
    return found


def plain(word: str) -> str:
    """Return a word without the punctuation around it."""
    return word.strip(".,;:()[]'\"")


def is_value(word: str) -> bool:
    """Whether a word of a quotation looks like what a program fills in."""
    return bool(re.search(r"[\dA-Z'\"]", word)) or "..." in word or plain(word) in UNITS


def same_word(quoted: str, word: str) -> bool:
    """Whether a quoted word is a word of the code, or fits one with a value in it."""
    if VALUE not in word:
        return plain(quoted) == plain(word)
    pattern = ".*".join(re.escape(part) for part in word.strip(".,;:()").split(VALUE))
    return bool(plain(word).strip(VALUE + "[]() ,")) and bool(re.fullmatch(pattern, quoted.strip(".,;:()")))


@functools.cache
def corpus() -> str:
    """Return all texts of the code, one a line, values as `VALUE`."""
    return "\n".join(f" {' '.join(map(plain, words))} " for words in templates())


@functools.cache
def may_be_filled_in(phrase: tuple[str, ...]) -> bool:
    """Whether a program may fill in a phrase: values, and between them words that stand so in one text of the code."""
    runs = " ".join("\n" if is_value(word) else plain(word) for word in phrase).split("\n")
    return all(not run.strip() or f" {run.strip()} " in corpus() for run in runs)


def fits(quoted: tuple[str, ...], words: tuple[str, ...]) -> int | None:
    """Return how many words a quotation has of a text of the code that begins as it does; None where it differs."""
    if not quoted:
        return 0
    found: list[int | None] = []
    if quoted[0] == "...":
        found += [fits(quoted[1:], words[k:]) for k in range(len(words) + 1)]
    if words and same_word(quoted[0], words[0]):
        rest = fits(quoted[1:], words[1:])
        found.append(None if rest is None else rest + 1)
        if words[0].endswith(VALUE):  # a value that begins within this word, such as a unit or "%, a remark)"
            ends = range(2, min(len(quoted), MOST_WORDS_OF_A_VALUE) + 1)
            found += [fits(quoted[k:], words[1:]) for k in ends if may_be_filled_in(quoted[1:k])]
    if words and VALUE in words[0]:
        if not plain(words[0]).strip(VALUE):  # a value alone, which may be empty
            found.append(fits(quoted, words[1:]))
        ends = range(1, min(len(quoted), MOST_WORDS_OF_A_VALUE) + 1)
        found += [fits(quoted[k:], words[1:]) for k in ends if may_be_filled_in(quoted[:k])]
    return max((end for end in found if end is not None), default=None)


def is_in_the_code(quotation: str) -> bool:
    """Whether some text of the code has the words of a quotation, enough of them literally."""
    quoted = tuple(re.sub(r"^(finray \w+: error:|\S+\.json:) ", "", quotation).split())
    wanted = {plain(word) for word in quoted} - {""}
    needed = max(1, round(LEAST_LITERAL * sum(not is_value(word) for word in quoted)))
    for words, literal in templates().items():
        if len(wanted & literal) < min(needed, len(wanted)):
            continue
        starts = [
            j for j in range(len(words)) if quoted[0] == "..." or VALUE in words[j] or same_word(quoted[0], words[j])
        ]
        if any((found := fits(quoted, words[j:])) is not None and found >= needed for j in starts):
            return True
    return False


def cells(text: str) -> Iterator[str]:
    """Yield the first cells of the tables whose first column quotes messages."""
    head = None
    for line in text.splitlines():
        if not line.startswith("|"):
            head = None
            continue
        first = re.split(r"(?<!\\)\|", line)[1].strip()
        if head is None:
            head = first
        elif head in HEADS and not set(first) <= set("-: "):
            yield first


def quotations(page: Path) -> list[str]:
    """Return the texts that a page quotes: what stands in backticks of a cell, else the cell; and lines of output."""
    text = page.read_text(encoding="utf-8")
    found = []
    for cell in cells(text):
        found += re.findall(r"`([^`]+)`", cell) or [part.strip() for part in cell.split(";")]
    if page.name in BLOCKS:
        (block,) = re.findall(BLOCKS[page.name], text, flags=re.MULTILINE)
        found += (
            [" ".join(block.split())] if block.startswith("finray ") else [line.strip() for line in block.splitlines()]
        )
    return found


QUOTED = [(page.name, quotation) for page in PAGES for quotation in quotations(page)]


@pytest.mark.parametrize(("page", "quotation"), QUOTED, ids=lambda text: text)
def test_what_a_page_quotes_is_a_text_of_the_code(page, quotation):
    for text in MADE_OF.get(without_numbers(quotation), (quotation,)):
        assert is_in_the_code(text), f"{page} quotes {text!r}"


def test_quotations_are_found_and_a_false_one_is_refused():
    assert len(QUOTED) > 150
    assert set(MADE_OF) <= {without_numbers(quotation) for _, quotation in QUOTED}
    assert is_in_the_code("has slots 1 to 6, but the rig file puts ...")
    assert not is_in_the_code("has slots 1 to 6, but the rig file wants ...")
    assert not is_in_the_code("the guard process has finished (killed)")
    assert not is_in_the_code("there are no presses with one number changed")
