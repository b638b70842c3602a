"""Links, images and commands that the documentation names exist."""

import re
from pathlib import Path

import pytest

from finray_calib.cli.main import build_parser

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = [README, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)")
VERB = re.compile(r"\bfinray ([a-z]+)\b")


def links(page: Path) -> list[str]:
    """Return the targets of links and images outside code blocks."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return LINK.findall(text)


def code(page: Path) -> str:
    """Return what stands in code blocks and between backticks."""
    text = page.read_text(encoding="utf-8")
    return "\n".join(re.findall(r"^```.*?^```|`[^`\n]+`", text, flags=re.MULTILINE | re.DOTALL))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_relative_link_leads_to_a_file(page):
    relative = [target for target in links(page) if not re.match(r"[a-z]+:", target)]
    missing = [t for t in relative if t.partition("#")[0] and not (page.parent / t.partition("#")[0]).exists()]
    assert not missing


def test_links_are_found_at_all():
    assert {"docs/images/touch.png", "docs/verification.md", "LICENSE"} <= set(links(README))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_command_that_is_named_exists(page):
    verbs = set(re.findall(r"^    (\w+)", build_parser().format_help(), flags=re.MULTILINE))
    assert {"capture", "decide", "demo"} <= verbs
    assert set(VERB.findall(code(page))) <= verbs


def test_readme_names_the_six_stages_and_the_two_commands():
    text = code(README)
    assert {"capture", "radiometry", "fit", "simulate", "compare", "decide", "demo"} <= set(VERB.findall(text))
    assert re.search(r"^make demo\b", text, flags=re.MULTILINE)
    assert re.search(r"^make test\b", text, flags=re.MULTILINE)
