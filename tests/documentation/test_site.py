"""The documentation builds as a site without a warning; nothing in it is loaded from outside; every page is found."""

import json
import re
from pathlib import Path

import pytest
from lxml import html
from markdown_it import MarkdownIt
from mkdocs.commands.build import build
from mkdocs.config import load_config

ROOT = Path(__file__).resolve().parents[2]
LOADING = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href"}
"""Elements that fetch something when a page is opened, and where they say what."""
STYLE_URL = re.compile(r"url\(\s*['\"]?(https?:)?//", re.IGNORECASE)
MOST_MB = 40


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly: a warning ends it."""
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("NO_MKDOCS_2_WARNING", "1")
        patched.setenv("COLUMNS", "100")
        build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder), strict=True))
    return folder


def test_every_page_of_the_folder_is_on_the_site(site):
    pages = [path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md")]
    missing = [page for page in pages if not (site / page.with_name(page.name.replace("README.md", "index.md"))
                                              .with_suffix(".html")).is_file()]  # fmt: skip
    assert len(pages) > 80
    assert missing == []
    for page in ("project/changelog.html", "project/contributing.html", "reference/commands.html"):
        assert (site / page).is_file()


def test_every_page_is_in_the_navigation(site):
    tree = html.parse(site / "index.html")
    listed = {Path(link).name for link in tree.xpath("//nav//a/@href")}
    for page in (ROOT / "docs").rglob("*.md"):
        name = "index.html" if page.name == "README.md" else page.with_suffix(".html").name
        assert name in listed, page


def test_nothing_is_loaded_from_outside(site):
    outside = [
        f"{page.relative_to(site)}: {address}"
        for page in site.rglob("*.html")
        for element, attribute in LOADING.items()
        for address in html.parse(page).xpath(f"//{element}/@{attribute}")
        if re.match(r"(https?:)?//", address)
    ]
    assert outside == []
    assert [str(s) for s in site.rglob("*.css") if STYLE_URL.search(s.read_text(encoding="utf-8"))] == []


def test_links_between_pages_lead_to_files_and_headings(site):
    ids = {page: set(html.parse(page).xpath("//@id")) for page in site.rglob("*.html")}
    wrong = []
    for page in ids:
        for link in html.parse(page).xpath("//article//a/@href"):
            path, _, anchor = link.partition("#")
            target = (page.parent / path).resolve() if path else page
            if re.match(r"[a-z]+:", link):
                continue
            if not target.exists() or (anchor and target in ids and anchor not in ids[target]):
                wrong.append(f"{page.relative_to(site)}: {link}")
    assert wrong == []


def counted(root: html.HtmlElement) -> dict[str, int]:
    """Return how many list items, numbered lists, tables, code blocks and quotations a text has."""
    return {name: len(root.xpath(f"//{name}")) for name in ("li", "ol", "table", "pre", "blockquote")}


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("[teh]*/*.md")), ids=lambda page: page.stem)
def test_lists_tables_and_code_stand_as_another_parser_has_them(site, page):
    if page.name == "architecture.md":
        pytest.skip("its drawing is a table on the site")
    name = "index.html" if page.name == "README.md" else f"{page.stem}.html"
    (article,) = html.parse(site / page.parent.name / name).xpath("//article")
    text = page.read_text(encoding="utf-8")
    other = html.fromstring(MarkdownIt("commonmark").enable("table").render(text))
    assert counted(html.fromstring(html.tostring(article))) == counted(other)


def test_the_search_knows_the_pages_and_the_commands(site):
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    found = {entry["location"].partition("#")[0] for entry in index["docs"]}
    assert {"tutorials/first-paint.html", "how-to/press-a-finger.html", "reference/commands.html"} <= found


def test_the_page_of_commands_has_every_verb(site):
    text = html.parse(site / "reference" / "commands.html").getroot().text_content()
    for verb in ("finray simulate press", "finray fit", "finray rig init", "finray check run"):
        assert f"usage: {verb}" in text


def test_the_site_is_small(site):
    assert sum(path.stat().st_size for path in site.rglob("*") if path.is_file()) < MOST_MB * 1e6
