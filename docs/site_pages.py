"""Pages and links of the site that ``make docs`` builds; a hook of MkDocs.

The pages of the folder also serve readers of the plain files: their links lead to code, schemas and pages of the
project outside of it, and lists are indented as in CommonMark. Here those pages join the site, linked files and folders
are copied beside it as text, and lists are indented by four, as Python-Markdown wants it.
"""

import argparse
import os
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from docs.api_pages import BESIDE
from docs.verification_rows import trust_page

ROOT = Path(__file__).resolve().parents[1]
OF_PROJECT = {
    "README.md": "project/readme.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "examples/README.md": "project/examples.md",
}
"""Page of the project -> its place on the site."""
COMMANDS = "reference/commands.md"
TRUST = "reference/which-number-can-i-trust.md"
LINK = re.compile(r"(\]\()([^)\s]+)(\))")
FENCE = re.compile(r"(^ *```.*?^ *```)", flags=re.MULTILINE | re.DOTALL)
MERMAID = re.compile(r"^```mermaid\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
KINDS = {"Tutorials": "tutorials", "How to": "how-to", "Explanation": "explanation", "Reference": "reference"}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Set the navigation: four kinds, each in the order of its list on the first page, and the project's own pages."""
    from importlib.metadata import version

    config.copyright = f"finray-calib {version('finray-calib')}, BSD-3-Clause"
    first = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    config.nav = [{"Home": "README.md"}, {"Gallery": "gallery.md"}]
    config.nav += [{kind: _pages(folder, first)} for kind, folder in KINDS.items()]
    config.nav += [{"Project": list(OF_PROJECT.values())}]
    return config


def _pages(folder: str, first: str) -> list[Any]:
    """Return the pages of a folder: its README, those that the first page lists, then the others."""
    names = sorted(path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs" / folder).glob("*.md"))
    listed = [name for name in re.findall(r"\]\(([\w./-]+\.md)", first) if name in names]
    pages = list(dict.fromkeys([*(n for n in names if n.endswith("README.md")), *listed, *names]))
    if folder != "reference":
        return list(pages)
    decisions = [path.relative_to(ROOT / "docs").as_posix() for path in sorted((ROOT / "docs/decisions").glob("0*.md"))]
    decided = {"Decision records": ["decisions/README.md", *decisions]}
    beside = [f"reference/{name}" for name in BESIDE]
    faces = [page for page in pages[1:] if page not in beside]
    return [pages[0], COMMANDS, TRUST, "verification.md", *beside, {"Folders of the code": faces}, decided]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of the project, that of the commands, and all that pages link to outside of the folder."""
    for source, place in OF_PROJECT.items():
        files.append(File.generated(config, place, content=(ROOT / source).read_text(encoding="utf-8")))
    files.append(File.generated(config, COMMANDS, content=command_page()))
    rows = (ROOT / "docs" / "verification.md").read_text(encoding="utf-8")
    files.append(File.generated(config, TRUST, content=trust_page(rows)))
    for page in [file for file in files if file.src_uri.endswith(".md")]:
        for _, target in _targets(page.content_string, _origin(page.src_uri)):
            place = _place(target)
            if place is not None and files.get_file_from_path(place) is None:
                files.append(_copy(config, target, place))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Lead links to where their files are on the site; draw what the site cannot draw as a list."""
    origin = _origin(page.file.src_uri)
    here = posixpath.dirname(page.file.src_uri)

    def moved(match: re.Match[str]) -> str:
        path, mark, anchor = match[2].partition("#")
        target = _in_project(path, origin)
        if target is None:
            return match[0]
        place = _place(target) or target.removeprefix("docs/")
        return f"{match[1]}{posixpath.relpath(place, here or '.')}{mark}{anchor}{match[3]}"

    text = indented_by_four(MERMAID.sub(lambda block: arrows_table(block[1]), markdown))
    parts = FENCE.split(text)
    return "".join(part if index % 2 else LINK.sub(moved, part) for index, part in enumerate(parts))


def indented_by_four(markdown: str) -> str:
    """Indent what belongs to an item of a list by four spaces, as far as it is indented to the text of the item."""
    lines: list[str] = []
    indent, fenced = 0, False
    for line in markdown.splitlines():
        item = None if fenced else re.match(r"(\d+\.|[-*]) +", line)
        if item:
            one_paragraph = indent and lines and not _blank_since_item(lines)
            lines += [] if one_paragraph or not lines or not lines[-1] else [""]
            indent = len(item[0])
        elif line and not line.startswith(" ") and not fenced:
            indent = 0
        inside = indent and line.startswith(" " * indent)
        lines.append(" " * (4 - indent) + line if inside else line)
        if line.lstrip().startswith("```"):
            fenced = not fenced
            if not line.startswith(" "):
                indent = 0
    return "\n".join(lines) + "\n"


def _blank_since_item(lines: list[str]) -> bool:
    """Whether a line without text stands between the last item of a list and the end."""
    for line in reversed(lines):
        if not line.strip():
            return True
        if re.match(r"(\d+\.|[-*]) +", line):
            return False
    return True


def _origin(src_uri: str) -> str:
    """Return the path in the project of a page of the site."""
    return next((source for source, place in OF_PROJECT.items() if place == src_uri), f"docs/{src_uri}")


def _targets(text: str, origin: str) -> Iterator[tuple[str, str]]:
    """Yield each link outside code blocks with the file or folder of the project that it leads to."""
    for part in FENCE.split(text)[::2]:
        for _, link, _ in LINK.findall(part):
            target = _in_project(link.partition("#")[0], origin)
            if target is not None:
                yield link, target


def _in_project(link: str, origin: str) -> str | None:
    """Return the path in the project that a relative link leads to; None for other links."""
    if not link or re.match(r"[a-z]+:", link):
        return None
    path = posixpath.normpath(posixpath.join(posixpath.dirname(origin), link))
    return path if (ROOT / path).exists() else None


def _place(target: str) -> str | None:
    """Return the place on the site of a file of the project; None for what lies in the folder of the pages."""
    if target in OF_PROJECT:
        return OF_PROJECT[target]
    if (ROOT / target).is_dir():
        return f"source/{target}/README.md"
    inside = target.startswith("docs/") and not target.endswith(".py")
    return None if inside else f"source/{target}.txt"


def _copy(config: MkDocsConfig, target: str, place: str) -> File:
    """Return a file as text, or the list of a folder's files."""
    path = ROOT / target
    if path.is_dir():
        names = "\n".join(
            f"- `{child.name}`" for child in sorted(path.iterdir()) if not child.name.startswith(("_", "."))
        )
        return File.generated(config, place, content=f"# {target}\n\nFiles of this folder of the project:\n\n{names}\n")
    return File.generated(config, place, content=path.read_bytes())


def arrows_table(drawing: str) -> str:
    """Return a drawing in Mermaid as a table of its arrows: the program that draws it would be loaded from outside."""
    named = dict(re.findall(r"(\w+)\[\"([^\"]+)\"\]", drawing))
    arrows: dict[str, list[str]] = {}
    for start, end in re.findall(r"(\w+) --> (\w+)", drawing):
        arrows.setdefault(start, []).append(end)
    rows = [
        f"| `{start}` | {', '.join(f'`{named.get(end, end)}`' for end in ends)} |" for start, ends in arrows.items()
    ]
    return "\n".join(["| folder | imports |", "|---|---|", *rows])


def command_page() -> str:
    """Return the help of every command, as a terminal of 80 columns prints it."""
    from finray_calib.cli.main import build_parser

    os.environ["COLUMNS"] = "80"
    parts = ["# Commands", "The help of every command, as `--help` prints it."]
    for name, parser in _parsers(build_parser()):
        parts += [f"## {name}", f"```text\n{parser.format_help()}```"]
    return "\n\n".join(parts) + "\n"


def _parsers(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield a parser and those of its verbs and actions, with their names."""
    yield parser.prog, parser
    for action in parser._actions:  # noqa: SLF001 - argparse offers no other way to its verbs
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for child in dict.fromkeys(action.choices.values()):
                yield from _parsers(child)
