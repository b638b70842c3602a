"""A parsed HTML page: tags, prose, what was never closed, what it loads, and the contrast of its colours."""

import re
from html.parser import HTMLParser
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "finray_calib/reports/templates/page.js"
VOID = {"meta", "img", "br", "link", "hr"}
TRUST = 'id="how-far-to-trust-this"'
"""Where the first section ends that says what was found."""


class Page(HTMLParser):
    """Collects tags with their attributes, the text outside scripts and styles, and tags that were never closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.text.append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]

    @property
    def prose(self) -> str:
        return " ".join(" ".join(self.text).split())


def assert_stands_alone(html: str) -> None:
    """Nothing is loaded, the browser is told to load nothing, and the only scripts are the numbers and the page's own.

    The page's own script holds nothing of the record, and there is nothing that only it can show.
    """
    page, markup = Page(html), re.sub(r"data:image/[^\"]*", "", html)
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", markup)
    policies = [meta["content"] for meta in page.all("meta") if meta.get("http-equiv") == "Content-Security-Policy"]
    assert [policy.split(";")[:2] for policy in policies if policy] == [["default-src 'none'", " img-src data:"]]
    assert page.all("link") == []
    assert not any(name.startswith("on") for _, attributes in page.tags for name in attributes)
    assert [script.get("type") for script in page.all("script")] == ["application/json", None]
    own = html.rpartition("<script>")[2].partition("</script>")[0].strip()
    assert own == SCRIPT.read_text(encoding="utf-8").strip()
    assert not any("hidden" in attributes for _, attributes in page.tags)


def palettes(html: str) -> list[dict[str, str]]:
    """Return the colours of a page by their names, light and dark."""
    blocks = re.findall(r":root \{(.*?)\}", html, re.DOTALL)
    return [dict(re.findall(r"--([a-z]+): (#[0-9a-f]{6})", block)) for block in blocks]


def least_contrast(palette: dict[str, str]) -> float:
    """Return the smallest contrast of a colour of letters on a ground of a page."""
    inks = [palette[name] for name in ("ink", "muted", "accent", "good", "care", "bad")]
    return min(contrast(ink, palette[ground]) for ink in inks for ground in ("ground", "pale", "box"))


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of two colours after WCAG 2.1."""
    lighter, darker = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def _luminance(colour: str) -> float:
    """Return the relative luminance after WCAG 2.1."""
    values = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
