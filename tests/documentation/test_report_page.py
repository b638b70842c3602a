"""The demo's page: verdict first, self-contained, accessible, safe, and equal bytes for equal input."""

import base64
import json
import re
from collections import Counter
from dataclasses import replace

import pytest
from example_records import example_decision, example_results
from html_page import TRUST, Page, assert_stands_alone, least_contrast, palettes

from data_schemas import RecordError
from finray_calib.demo import demo_report, summary
from finray_calib.demo._results import STAGES

HOSTILE = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def html() -> str:
    return demo_report(example_results())


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def test_every_tag_is_closed_in_order(page: Page) -> None:
    assert page.open == []


def test_the_verdict_stands_before_every_stage_image_and_table(page: Page, html: str) -> None:
    verdict = html.index("Several angles are equally good; take 32\u00a0deg", html.index("<body>"))
    assert verdict < min(html.index("<img"), html.index("<table"), *(html.index(f'id="{stage}"') for stage in STAGES))
    assert html.index(TRUST) < html.index('id="capture"')
    positions = [html.index(f'id="{stage}"') for stage in STAGES]
    assert positions == sorted(positions)
    assert "The angle is decided 32 deg \u2713 good : neighbouring angles are equally good" in page.prose
    first = Page(html[: html.index(TRUST)]).prose
    for shown in ("Captured, no contact", "Captured, contact", "The finger from the side, to scale", "Emission of the"):
        assert shown in first


def test_the_page_needs_nothing_from_outside_and_no_script(page: Page, html: str) -> None:
    assert_stands_alone(html)
    for image in page.all("img"):
        source = image["src"]
        assert source is not None
        assert source.startswith(("data:image/png;base64,", "data:image/svg+xml;base64,"))


def test_the_figures_themselves_load_nothing(page: Page) -> None:
    sources = [str(image["src"]) for image in page.all("img")]
    drawings = [base64.b64decode(s.split(",")[1]).decode() for s in sources if s.startswith("data:image/svg")]
    assert len(drawings) == 18  # six for each paint, error map, scores, angle; above them the finger and two spectra
    for svg in drawings:
        assert "<script" not in svg
        assert all(ref.startswith(("#", "data:")) for ref in re.findall(r'href="([^"]*)"', svg))


def test_the_page_travels_by_post(html: str) -> None:
    assert len(html.encode()) < 6_000_000


def test_what_a_slider_lays_over_each_other_has_one_size_and_stands_side_by_side_without_script(html: str) -> None:
    pairs = re.findall(r'<div class="pair" data-label="([^"]+)">(.*?)</div>', html, re.DOTALL)
    assert [label for label, _ in pairs] == [
        "Slide between the captured images without and with contact",
        "Slide between the captured and the simulated touch",
    ]
    for _, inside in pairs:
        images = [base64.b64decode(text) for text in re.findall(r'src="data:image/png;base64,([^"]+)"', inside)]
        assert len(images) == 2
        assert images[0][16:24] == images[1][16:24]  # width and height of a PNG
    assert Page(html).all("input") == []


def test_every_number_of_the_first_screen_is_judged_in_words(page: Page, html: str) -> None:
    numbers = re.findall(r'<div class="(good|care|bad|unjudged)"><dt>', html)
    assert len(numbers) == 3
    words = {"good": "\u2713 good", "care": "! with care", "bad": "\u2717 not good"}
    for light in set(numbers) - {"unjudged"}:
        assert page.prose.count(words[light]) >= numbers.count(light)


def test_contents_name_every_section(html: str) -> None:
    listed = re.findall(r'<li><a href="#([^"]+)">([^<]+)</a>', html)
    assert listed == re.findall(r'<summary><h2 id="([^"]+)">([^<]+)</h2>', html)
    assert ("compare", "Compare") in listed
    folds = re.findall(r"<details( open)?>\s*<summary><h2 id=\"([^\"]+)\"", html)
    assert [name for is_open, name in folds if not is_open] == ["methods-for-a-paper", "reproduce"]


def test_every_image_says_its_conclusion_in_words(page: Page) -> None:
    texts = [image["alt"] for image in page.all("img")]
    assert all(text is not None and len(text) > 20 for text in texts)
    assert any("the intervals are too narrow" in str(text) for text in texts)


def test_table_headings_have_a_scope_and_every_table_a_caption(page: Page) -> None:
    assert Counter(tag for tag, _ in page.tags)["caption"] == len(page.all("table")) > 0
    assert {heading.get("scope") for heading in page.all("th")} == {"col", "row", "rowgroup"}


def test_ids_are_unique_and_labels_and_links_point_to_them(page: Page) -> None:
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {str(a["href"]).removeprefix("#") for a in page.all("a")} <= set(ids)
    assert {a["aria-labelledby"] for _, a in page.tags if "aria-labelledby" in a} <= set(ids)
    assert page.all("html")[0]["lang"] == "en"


def test_text_colours_have_a_contrast_of_at_least_4_5(html: str) -> None:
    light, dark = palettes(html)
    assert least_contrast(light) >= 4.5
    assert least_contrast(dark) >= 4.5


def test_the_embedded_json_is_the_summary(html: str) -> None:
    block = re.search(r'<script type="application/json" id="summary">(.*?)</script>', html, re.DOTALL)
    assert block is not None
    assert json.loads(block[1]) == summary(example_results())


def test_equal_input_gives_equal_bytes_whatever_the_users_matplotlib_settings(html: str) -> None:
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 20.0, "axes.grid": False, "svg.hashsalt": None}):
        assert demo_report(example_results()) == html


@pytest.fixture(scope="module")
def hostile() -> str:
    """Return the page of a smaller, unvalidated, needs captures run whose red paint has a hostile name."""
    results = example_results(paint_name=HOSTILE)
    press = results.press.model_copy(update={"camera_matrix": None})
    decision = example_decision("needs captures", validated=False)
    return demo_report(replace(results, press=press, decision=decision, true_sweeps=(), report_level_a=None))


def test_hostile_names_stay_text(hostile: str) -> None:
    assert HOSTILE not in hostile
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in hostile
    assert_stands_alone(hostile)
    block = re.search(r'id="summary">(.*?)</script>', hostile, re.DOTALL)
    assert block is not None
    assert json.loads(block[1])["paints"]["red"]["paint_name"] == HOSTILE


def test_another_verdict_is_named_in_title_and_box(hostile: str) -> None:
    text = Page(hostile).prose
    assert text.startswith("32 deg is the best guess of the simulation; a capture has to confirm it: From a painted")
    assert "The angle is not decided 32 deg ! with care : captures are needed" in text
    assert "not validated against a capture" in text
    assert "hidden true finger" not in text


def test_true_finger_and_paper_emitter_are_told_only_where_they_were_rendered(page: Page, hostile: str) -> None:
    for words in (
        "On the true finger, which neither the fit nor the decision saw",
        "With the paper's emitter",
        "simulation, paper's emitter 0.702",
    ):
        assert words in page.prose
        assert words not in Page(hostile).prose


def test_the_display_of_the_images_is_explained(page: Page, hostile: str) -> None:
    assert "unmixed into red emission (shown red), green emission (green) and LED light (blue)" in page.prose
    assert "each channel is balanced for the screen" in Page(hostile).prose
    assert "the numbers use the camera's linear values" in page.prose


def test_trust_is_short_and_all_notes_wait_in_a_fold(page: Page, html: str) -> None:
    trust = html[html.index('<section aria-labelledby="how-far-to-trust-this">') :].partition("</section>")[0]
    fold = trust[trust.index("<details>") :]
    assert "<li>Renderer: Rendered with the path tracer" in trust
    assert (
        len(Page(trust.split("<h3>")[0].replace("<details open>", "")).prose.split()) < 238
    )  # a minute of reading (238 words of English non-fiction, Brysbaert 2019)
    assert "Notes of the records (4)" in fold
    for line in ("radiometry, both paints: camera response R", "fit, both paints: 3.1 %", "simulate: 48 samples"):
        assert line in " ".join(fold.split()).replace("\u00a0", " ")
    assert "details::details-content { content-visibility: visible" in html  # open in print


def test_every_scrolling_table_can_be_reached_by_keyboard(page: Page) -> None:
    boxes = [attributes for _, attributes in page.tags if attributes.get("class") == "scroll"]
    assert len(boxes) == len(page.all("table"))
    assert all(box["tabindex"] == "0" and box["role"] == "region" and box["aria-label"] for box in boxes)


def test_results_without_a_paint_or_a_stage_are_refused() -> None:
    results = example_results()
    with pytest.raises(RecordError, match=r"paints must be exactly 'red' and 'green', got \['red'\]"):
        replace(results, paints={"red": results.paints["red"]})
    with pytest.raises(RecordError, match=r"wall times \(s\) must be given for each of the stages .* got \['fit'\]"):
        replace(results, stage_wall_times_s={"fit": 1.0})
    region = results.report.model_copy(update={"headline_region": "elsewhere"})
    with pytest.raises(RecordError, match="headline region 'elsewhere' is not among the regions of the report"):
        demo_report(replace(results, report=region))
