"""The page of a comparison: verdict first, all numbers beside their bounds, self-contained, accessible and safe."""

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest
from example_records import example_results
from html_page import TRUST, Page, assert_stands_alone, contrast, least_contrast, palettes

from data_schemas import ErrorAttribution, ErrorCause, Interval, Provenance, RecordError, WhiteBalanceDrift
from data_schemas.storage import write_record
from finray_calib.compare import OWN_NOISE
from finray_calib.compare._comparison_record import COVERS_INPUTS, COVERS_PARTS
from finray_calib.reports import _comparison_figures, comparison_page, headline
from finray_calib.reports import _comparison_statements as words
from finray_calib.reports._comparison_figures import budget_figure, cause_figure
from finray_calib.reports._comparison_statements import budget_table, judged_skill, metric_table, validation_table
from finray_calib.reports._images import LARGEST_PIXELS, touch_changes, touch_pictures
from finray_calib.reports._methods import comparison_methods
from finray_calib.reports._page import images_table
from tests.command_line.running import finray

RESULTS = example_results()
REPORT, PRESS, CAPTURE = RESULTS.report, RESULTS.press, RESULTS.capture
HOSTILE = '</script><script>alert(1)</script> & "quoted" $\\frac{'
COMMAND = "finray compare press.json capture.json --out 'a <b>.json'"
DIGESTS = {"press.json": "ab" * 32, "capture.json": "cd" * 32}
LARGEST_PAGE_BYTES = 3_000_000  # what still travels by e-mail


def page_of(report=REPORT, press=PRESS, capture=CAPTURE) -> str:
    return comparison_page(report, press, capture, COMMAND, DIGESTS)


def with_skill(low: float, estimate: float, high: float, floor: bool = True):
    """Return the report with another headline skill, and without its floor where that is asked for."""
    regions = REPORT.regions if floor else tuple(r.model_copy(update={"rows": r.rows[:2]}) for r in REPORT.regions)
    skill = Interval(estimate=estimate, low95=low, high95=high)
    return REPORT.model_copy(update={"headline_skill": skill, "regions": regions})


@pytest.fixture(scope="module")
def html() -> str:
    return page_of()


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def test_the_page_says_that_noise_was_taken_out_only_where_it_was(html):
    free = "taken out of this number, as of the simulation\u2019s skill"
    within = "and in the simulation\u2019s skill too"
    encoded = page_of(REPORT.model_copy(update={"values": "encoded values, encoding unknown"}))
    linear, encoded = (text.replace("&#39;", "\u2019").replace("'", "\u2019") for text in (html, encoded))
    assert free in linear
    assert within not in linear
    assert within in encoded
    assert free not in encoded
    assert "noise is taken out" not in encoded.split(TRUST)[0]


def test_the_verdict_stands_before_trust_images_and_tables(html, page):
    assert page.open == []
    verdict = html.index("Better than no simulation</h2>")
    assert (
        verdict
        < html.index("what the touch changes, but not all of it")
        < html.index("<img")
        < html.index("<li>The simulated touch explains 93\u00a0% of the squared change")
        < html.index(TRUST)
        < html.index("<table")
    )
    headings = re.findall(r"<h2[^>]*>([^<]*)</h2>", html)
    assert headings == [
        "What was found",
        "How far to trust this", "Images", "All metrics", "Uncertainty", "Where the level agrees (ASME V&amp;V 20)",
        "What was compared", "Methods, for a paper", "How to get this again",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("interval", "floor", "verdict", "says"),
    [
        ((-0.5, -0.3, -0.1), True, "Worse than no simulation", "untouched pad is nearer to the capture"),
        ((-0.1, 0.1, 0.3), True, "Not distinguishable from no simulation", "gives no reason to prefer the simulation"),
        ((0.8, 0.9, 0.95), True, "Better than no simulation", "10 % of the squared change remains unexplained"),
        (
            (0.92, 0.95, 0.999),
            True,
            "As good as this capture can show",
            "no larger than that between two captures of the same touch",
        ),
        ((0.8, 0.9, 0.999), True, "Better than no simulation", "as good as the capture can show, or explain only 80 %"),
        ((0.8, 1.0, 1.2), False, "Better than no simulation", "predicts all of what the touch changes, within the unc"),
        ((0.8, 0.9, 0.999), False, "Better than no simulation", "10 % of the squared change remains unexplained"),
    ],
)
def test_the_verdict_is_where_the_interval_lies(interval, floor, verdict, says):
    report = with_skill(*interval, floor=floor)
    assert words.comparison_verdict(report) == verdict
    assert says in words.verdict_meaning(report)


@pytest.mark.parametrize(
    ("interval", "light"),
    [((-0.1, 0.1, 0.3), "bad"), ((0.0, 0.5, 0.95), "bad"), ((0.5, 0.93, 0.99), "care"), ((0.9, 0.95, 0.99), "good")],
)
def test_the_light_of_the_skill_follows_its_interval_not_its_estimate(interval, light):
    html = page_of(with_skill(*interval))
    assert f'<section class="verdict {light}"' in html
    assert f'<div class="{light}"><dt>Skill of the simulation</dt>' in html


def test_a_capture_made_from_the_render_is_no_good_news():
    html = page_of(with_skill(0.99, 1.0, 1.01).model_copy(update={"findings": (OWN_NOISE,)}))
    assert '<section class="verdict care"' in html
    assert "This comparison proves nothing about the simulation" in html
    assert '<div class="care"><dt>Skill of the simulation</dt>' in html


def test_a_skill_is_judged_alike_on_all_pages():
    assert judged_skill(0.92, 0.97) == ("good", "its interval lies above 0.9; 1 is perfect")
    assert judged_skill(0.7, 0.8)[1].endswith("but lies below 0.9")
    assert judged_skill(0.7, 0.95)[1].endswith("but reaches below 0.9")
    assert judged_skill(-0.1, 0.95) == ("bad", "its interval reaches 0, the score of an untouched image")
    assert judged_skill(-0.2, -0.1)[1].startswith("its interval lies below 0")
    assert judged_skill(None, None)[0] == "care"


def test_without_a_repeat_or_a_brightness_the_bounds_stand_in_their_place():
    report = with_skill(0.8, 0.9, 0.95, floor=False).model_copy(update={"objective_error": None})
    html = page_of(report)
    labels = re.findall(r'<div class="(\w+)"><dt>([^<]+)</dt>', html)
    assert labels == [
        ("care", "Skill of the simulation"),
        ("care", "Skill of a repeated capture"),
        ("unjudged", "Doing nothing"),
    ]


def test_no_more_than_all_is_explained():
    text = plain(Page(page_of(with_skill(0.95, 1.02, 1.1))))
    assert "explains all of the squared change in the image: skill 1.020 [0.950, 1.100]" in text
    assert "the interval is wide" not in text


def test_every_metric_stands_beside_doing_nothing_and_the_floor():
    table = metric_table(REPORT, headline(REPORT))
    rows = {row[0]: row[1:] for group in table.groups for row in group.rows}
    assert table.columns == ("metric", "do nothing", "simulation", "floor (a repeat)", "better is")
    assert rows["all channels"] == ("0", "0.931 [0.913, 0.949]", "0.998 [0.998, 0.999]", "higher; 1 is perfect")
    assert rows["relative RMS, green"][:3] == ("18.9 [17.0, 20.8] %", "3.69 [3.32, 4.06] %", "0.540 [0.486, 0.594] %")
    assert rows["chromaticity, RMS (1)"][1] == "0.0123 [0.0111, 0.0135]"
    assert rows["SSIM of the whole frame"][:3] == ("0.930", "0.984", "0.991")
    assert "FLIP, mean" not in rows  # nobody has it
    alone = metric_table(with_skill(0.8, 0.9, 0.95, floor=False), headline(REPORT).model_copy(
        update={"rows": headline(REPORT).rows[:2]}))  # fmt: skip
    assert alone.groups[0].rows[0][3] == "\N{EN DASH}"
    withheld = (
        headline(REPORT)
        .rows[1]
        .model_copy(update={"relative_rms": None, "difference_gradient_rms_per_px": None, "chromaticity_rms": None})
    )
    encoded = metric_table(REPORT, headline(REPORT).model_copy(update={"rows": (withheld,)}))
    assert [group.heading for group in encoded.groups] == [table.groups[0].heading, table.groups[2].heading]


def test_the_channel_in_which_capture_and_simulation_differ_most_need_not_be_the_one_that_changes_most():
    drift = WhiteBalanceDrift(
        gains=(1.1, 1.0, 1.0), expected_gains=(1.1, 1.05, 1.0), u_rel=(0.002,) * 3, uneven_rel=(0.002,) * 3,
        blocks=(50,) * 3, corrected=False,
    )  # fmt: skip
    told = words.white_balance_sentence(drift)
    assert "differ most in green: the capture changes by 0 %, the simulation by +5 %" in told
    assert "not known" in words.white_balance_sentence(drift.model_copy(update={"blocks": (0, 0, 0)}))


@pytest.mark.parametrize("lost", [-0.01, 0.0])
def test_no_share_of_a_loss_is_told_where_noise_was_subtracted_and_nothing_is_lost(lost):
    depth = ErrorCause(cause="depth", parameters=(), skill_lost=0.02, skill_regained=0.0, like=(), advice="press less")
    found = ErrorAttribution(
        causes=(depth,), skill_lost=lost, saturation_skill=0.0, noise_skill=0.0, remainder_skill=lost - 0.02, maps=None
    )
    told = words.causes_sentence(found)
    assert told.startswith(f"No skill is lost: 1 - skill is {lost:.3f}")
    assert "times" not in told
    assert "by depth (20 %)" in words.causes_sentence(found.model_copy(update={"skill_lost": 0.1}))


def test_the_budget_adds_up_and_names_what_each_input_rests_on():
    rows = {row[0]: row[1:] for row in budget_table(REPORT).groups[0].rows}
    # (0.006, 0.011, 0.002, 0.005): sum of squares 1.86e-4
    assert rows["root of the sum of squares"][:3] == ("0.014", "100 %", "0.5 %")
    assert rows["pose of the indenter"][:2] == ("0.011", "65 %")
    assert rows["pose of the indenter"][3].startswith("B: depth and position")
    assert rows["part of the region that was looked at"][2] == "\N{EN DASH}"
    nothing = REPORT.model_copy(update={"budget": (REPORT.budget[0].model_copy(update={"skill_u": 0.0}),)})
    assert budget_table(nothing).groups[0].rows[0][2] == "\N{EN DASH}"
    unmeasured = tuple(line.model_copy(update={"objective_u_rel": None}) for line in REPORT.budget)
    without_brightness = budget_table(REPORT.model_copy(update={"budget": unmeasured})).groups[0].rows
    assert {row[3] for row in without_brightness} == {"\N{EN DASH}"}
    assert "<svg" in budget_figure([(nothing.budget[0], 0.0)], str, "u")


def test_parts_outside_the_validation_uncertainty_are_named_not_only_coloured(page):
    rows = {group.heading: group.rows for group in validation_table(REPORT).groups}
    assert [row[0] for row in rows["green"] if row[3] == "outside"] == ["top left", "bottom right"]
    assert rows["green"][8][1:3] == ("+5.4 %", "1.8 %")
    assert "25 of 27 parts and channels agree within the validation uncertainty" in plain(page)
    assert "the largest error outside it is +5.4 % in green, bottom right" in plain(page)
    assert "green: 7 of 9 parts within" in page.prose
    inside = tuple(cell for cell in REPORT.validation if cell.within)
    assert words.validation_sentence(inside) == (
        "Level by part: all 25 parts and channels agree within the validation uncertainty."
    )


def plain(page: Page) -> str:
    """Return the prose with common spaces."""
    return page.prose.replace("\u00a0", " ")


def test_averaged_blocks_are_told(page):
    blocks = Page(page_of(REPORT.model_copy(update={"block_px": 4})))
    assert "Compared over blocks of 4 x 4 px, which average out render noise" in plain(blocks)
    assert "4600 blocks of 4 x 4 px" in plain(blocks)
    assert "Compared pixel by pixel; values: linear light." in plain(page)


def test_what_the_numbers_do_not_know_is_said(page):
    for text in (
        "The intervals cover paint posterior, camera, pose, render noise",
        "Not in the intervals: the spectrum of the blue LED, which is nominal.",
        "Check: no shift between render and capture above 0.3 px was found.",
        "Beside the indenter the simulation is 1.8 % brighter than the capture (95 %: +0.6 % to +3 %)",
        "one exposure factor, the same for all channels, known to 0.2 %",
    ):
        assert text in plain(page)


@pytest.mark.parametrize(
    ("stored", "said"),
    [
        (COVERS_INPUTS, "The 95 % intervals cover the metric that"),
        (COVERS_PARTS, "The intervals show how much a number depends on"),
        ("these intervals show how much a number depends on the pixels", "These intervals show how much a number"),
        ("how much a number depends on which part of the region", "The intervals cover how much a number depends on"),
    ],
)
def test_what_the_intervals_cover_is_a_sentence_also_in_older_reports(stored, said):
    report = REPORT.model_copy(update={"interval_covers": stored})
    assert words.limits(report)[0].startswith(said)
    assert f" {said}" in f" {comparison_methods(report)[1]}"


def test_a_comparison_of_encoded_values_tells_what_is_missing():
    run = REPORT.monte_carlo.model_copy(update={"significant_digits": 0})
    bare = REPORT.model_copy(
        update={
            "values": "encoded values, encoding unknown", "objective_error": None, "exposure_factor": None,
            "budget": (), "validation": (), "monte_carlo": run, "findings": (),
            "withheld": ("relative RMS: the encoding is unknown",),
        }
    )  # fmt: skip
    page = Page(page_of(bare))
    for text in (
        "scores compare code values only",
        "Withheld: relative RMS: the encoding is unknown.",
        "The render was not scaled.",
        "ended before the uncertainty was steady to one significant digit",
    ):
        assert text in plain(page)
    for absent in ("V&V 20", "Beside the indenter", "root of the sum of squares"):
        assert absent not in page.prose
    assert words.objective_sentence(bare) is None
    assert words.validation_sentence(()) is None


def test_a_difference_that_is_not_seen_is_not_called_brighter():
    error = REPORT.objective_error.model_copy(update={"error_rel": Interval(estimate=0.01, low95=-0.01, high95=0.03)})
    assert "no difference in brightness is seen: +1 %, 95 %: -1 % to +3 %" in str(
        words.objective_sentence(REPORT.model_copy(update={"objective_error": error}))
    )


def test_it_says_what_was_measured_with_what_and_when():
    stored = Provenance(
        created_utc="2026-11-20T08:30:00+00:00", command="finray capture", package_version="0", git_commit=None,
        python_version="3", input_sha256={}, seed=None,
    )  # fmt: skip
    pose = CAPTURE.indenter.model_copy(update={"depth_uncertainty_mm": 0.05, "tilt_deg": 2.0})
    capture = CAPTURE.model_copy(
        update={"provenance": stored, "light_angle_uncertainty_deg": 0.5, "led_current_ma": 20.0, "indenter": pose}
    )
    rows = {row[0]: row[1:] for row in images_table(PRESS, capture).groups[0].rows}
    assert rows["stored (UTC)"] == ("2026-11-20T08:30:00+00:00", "\N{EN DASH}")
    assert rows["light angle"] == ("30 deg (u = 0.5 deg)", "30 deg")
    assert rows["LED current"][0] == "20 mA"
    assert rows["indenter"][0] == (
        "cylinder, radius 10 mm; depth 1.5 mm (u = 0.05 mm); at 35 mm along the pad; tilt 2 deg"
    )
    unknown = pose.model_copy(update={"depth_mm": None, "position_mm": None, "tilt_deg": None})
    plain_press = PRESS.model_copy(update={"design": None})
    rows = {row[0]: row[1:] for row in images_table(
        plain_press, CAPTURE.model_copy(update={"indenter": unknown, "exposure_s": None, "encoding": "unknown"})
    ).groups[0].rows}  # fmt: skip
    assert rows["indenter"] == ("cylinder, radius 10 mm", "\N{EN DASH}")
    assert rows["exposure"][0] == "not recorded"
    assert rows["values"][0] == "encoded, curve unknown"


def test_changes_are_on_one_scale_and_do_not_know_a_common_exposure():
    changes = touch_changes(PRESS, CAPTURE, (1.0, 2.0))
    brighter = touch_changes(
        PRESS.model_copy(update={"contact": 3 * PRESS.contact, "no_contact": 3 * PRESS.no_contact}), CAPTURE, (1.0, 2.0)
    )
    np.testing.assert_allclose(brighter.simulated, changes.simulated, atol=1e-6)  # single precision of the images
    middle = changes.simulated[:, changes.simulated.shape[1] // 2]
    # the fixture dents by 35 % of the level at the middle and adds 12 % of a ring's tail
    assert -0.6 < middle.mean() < -0.2
    assert changes.scale >= np.nanpercentile(np.abs(changes.captured), 99) * 0.9
    flat = touch_changes(PRESS.model_copy(update={"contact": PRESS.no_contact}),
                         CAPTURE.model_copy(update={"contact": CAPTURE.no_contact}), (1.0,))  # fmt: skip
    assert flat.scale == 1.0


def test_large_noisy_images_make_no_large_page():
    rng = np.random.default_rng(4)
    height, width = 480, 640
    rows, columns = np.mgrid[0:height, 0:width]
    distance = np.hypot(rows - 240.0, columns - 320.0) / 60.0
    noisy = rng.uniform(0.1, 1.0, (height, width, 3)).astype(np.float32)
    press = PRESS.model_copy(update={"no_contact": noisy, "contact": noisy[::-1].copy(), "distance": distance})
    frames = [rng.integers(100, 1000, (2 * height, 2 * width, 1)).astype(np.uint16) for _ in range(2)]
    capture = CAPTURE.model_copy(update={"no_contact": frames[0], "contact": frames[1]})
    error = rng.uniform(0.0, 1.0, (height, width)).astype(np.float32)
    html = page_of(REPORT.model_copy(update={"error_map": error}), press, capture)
    assert len(html.encode()) < LARGEST_PAGE_BYTES
    shown = touch_pictures(press, capture, (1.0,)).captured
    assert 0.99 * LARGEST_PIXELS < shown.shape[0] * shown.shape[1] <= LARGEST_PIXELS


def test_a_render_off_the_grid_of_the_capture_is_refused():
    small = PRESS.model_copy(update={"contact": PRESS.contact[:50]})
    with pytest.raises(
        RecordError, match=r"render has 128 x 50 px, but the capture has 128 x 96 px; give the render on the"
    ):
        page_of(press=small)


def test_hostile_names_stay_text_and_nothing_comes_from_outside():
    budget = (REPORT.budget[0].model_copy(update={"input": HOSTILE, "source": HOSTILE}),)
    texts = {"simulated": HOSTILE, "label": HOSTILE, "interval_covers": HOSTILE, "notes": (HOSTILE,), "budget": budget}
    page = Page(html := page_of(
        REPORT.model_copy(update=texts), PRESS.model_copy(update={"name": HOSTILE}),
        CAPTURE.model_copy(update={"name": HOSTILE, "source": HOSTILE}),
    ))  # fmt: skip
    assert "<script>alert" not in html
    assert page.prose.count(HOSTILE) >= 6
    assert_stands_alone(html)
    assert embedded(html)["photometric_error"]["simulated"] == HOSTILE


def embedded(html: str) -> dict:
    """Return the JSON inside a page."""
    block = re.search(r'<script type="application/json" id="summary">(.*?)</script>', html, re.DOTALL)
    assert block is not None
    return json.loads(block[1])


def test_the_embedded_json_holds_every_number_but_draws_and_maps(html):
    numbers = embedded(html)
    assert numbers["command"] == COMMAND
    assert numbers["input_sha256"] == DIGESTS
    report = numbers["photometric_error"]
    assert report["headline_skill"]["estimate"] == REPORT.headline_skill.estimate
    assert len(report["validation"]) == 27
    assert set(report["objective_error"]) == {"error_rel", "rig", "source"}
    assert "error_map" not in report


def test_it_reads_well_without_eyes_colour_or_mouse(page):
    texts = [str(image["alt"]) for image in page.all("img")]
    assert len(texts) == 14  # two pairs of pictures, three changes, error, scores, two budgets, three channels
    assert all(len(text) > 20 for text in texts)
    assert any("25 of 27" in text or "7 of 9" in text for text in texts)
    assert {heading.get("scope") for heading in page.all("th")} == {"col", "row", "rowgroup"}
    assert len(page.all("caption")) == len(page.all("table")) == 6
    boxes = [attributes for _, attributes in page.tags if attributes.get("class") == "scroll"]
    assert len(boxes) == 6
    assert all(box["tabindex"] == "0" and box["aria-label"] for box in boxes)
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {a["aria-labelledby"] for _, a in page.tags if "aria-labelledby" in a} <= set(ids)
    assert page.all("html")[0]["lang"] == "en"


def test_letters_of_page_and_figures_have_a_contrast_of_at_least_4_5(html, page):
    assert min(least_contrast(palette) for palette in palettes(html)) >= 4.5
    grounds = ("#ffffff", "#f0f6fb", "#f6f8fa")  # page, verdict box, table groups; in the dark figures stand on white
    sources = [str(image["src"]) for image in page.all("img")]
    drawings = [base64.b64decode(s.split(",")[1]).decode() for s in sources if s.startswith("data:image/svg")]
    letters = {
        colour.lower() if colour else "#000000"
        for svg in drawings
        for colour in re.findall(r'<g id="text_\d+">(?:\s*<!--.*?-->)?\s*<g(?: style="fill: (#[0-9a-f]{6}))?', svg)
    }
    assert letters
    assert min(contrast(ink, ground) for ink in letters for ground in grounds) >= 4.5


def test_equal_input_gives_equal_bytes_and_no_claim_of_traceability(html):
    assert page_of() == html
    assert "traceable" not in html.lower()


def test_the_verb_writes_record_and_page_or_neither(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_record(PRESS, Path("press.json"), RESULTS.provenance)
    write_record(CAPTURE, Path("capture.json"), RESULTS.provenance)
    outcome = finray("compare press.json capture.json --out error.json")
    assert outcome.status == 0
    assert "error.html: its page" in outcome.out
    text = plain(Page(Path("error.html").read_text(encoding="utf-8")))
    assert "finray compare press.json capture.json --out error.json" in text
    assert f"stored (UTC) {RESULTS.provenance.created_utc} {RESULTS.provenance.created_utc}" in text
    Path("taken.html").touch()
    outcome = finray("compare press.json capture.json --out taken.json")
    assert outcome.status == 2
    assert "taken.html: exists already and is not overwritten" in outcome.err
    assert not Path("taken.json").exists()


def test_noise_does_not_hide_what_the_touch_changes():
    """In blocks of 4 px, the largest that leave 16 across the picture, noise of 40 % falls below the dent of 35 %."""
    rng = np.random.default_rng(6)
    noise = 1 + 0.4 * rng.standard_normal(PRESS.contact.shape)
    noisy = PRESS.model_copy(update={"contact": (PRESS.contact * noise).astype(np.float32)})
    changes = touch_changes(noisy, CAPTURE, (1.0,))
    assert changes.captured.shape == tuple(n // 4 for n in touch_changes(PRESS, CAPTURE, (1.0,)).captured.shape)
    middle = changes.simulated[:, changes.simulated.shape[1] // 2]
    assert middle.mean() < -0.1


def test_an_interval_above_one_altogether_means_disagreement():
    assert any("model and noise disagree" in limit for limit in words.limits(with_skill(1.05, 1.1, 1.2)))
    assert not any("model and noise disagree" in limit for limit in words.limits(with_skill(0.95, 1.02, 1.1)))


def test_the_picture_of_a_cause_under_a_cylinder_does_not_fill_the_screen():
    """The region that such a picture shows is six times as tall as wide; the picture with its bar is nearly square."""
    change = np.random.default_rng(1).normal(size=(180, 30)).astype(np.float32)
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', cause_figure(change, change[None]))
    assert size
    assert float(size[2]) < 1.6 * float(size[1])


def test_the_colours_of_a_cause_reach_as_far_as_its_changes_however_small_the_pad_is_in_the_picture(monkeypatch):
    ends = []
    monkeypatch.setattr(_comparison_figures, "_put_bar", lambda figure, drawn, *rest: ends.append(drawn.get_clim()))
    change = np.zeros((200, 200), dtype=np.float32)
    change[90:104, 90:104] = 0.1  # half a per cent of the pixels
    cause_figure(change, change[None])
    assert ends == [pytest.approx((-0.1, 0.1))]
