"""The first screen of a design study: its numbers are judged by all points together, not by the two extremes alone."""

import cv2
import numpy as np
import pytest
from html_page import Page, assert_stands_alone

from data_schemas import FingerDesign, StudyMetric, StudyPoint, StudyResult, StudyRow
from finray_calib.reports._methods import study_methods
from finray_calib.reports.studies import (
    _design_study_page,
    design_study_page,
    points_by_code,
    study_differences,
    study_differences_text,
    study_pictures_webp,
)
from finray_calib.reports.studies._design_study_page import _all_views, _changed, _names, _pictures_in_a_row


def metric(value: float, half: float | None, name: str = "evenness") -> StudyMetric:
    low, high = (None, None) if half is None else (value - half, value + half)
    return StudyMetric(name=name, value=value, low95=low, high95=high, unit="1", meaning="darkest over brightest")


def test_points_that_differ_by_noise_only_are_seldom_called_different():
    """At most 5 % of studies of 40 equal points, sd 1; the 95 % interval of each point alone would call most so."""
    rng = np.random.default_rng(6)
    called, alone = 0, 0
    for _ in range(400):
        values = np.sort(rng.standard_normal(40))
        called += _changed([metric(float(value), 1.96) for value in values])[0] == "good"
        alone += values[-1] - values[0] > 2 * 1.96
    assert called <= 20
    assert alone > 200


def test_a_real_difference_is_called_one_and_no_interval_is_not_judged():
    assert _changed([metric(0.2, 0.01), metric(0.3, 0.01), metric(0.4, 0.01)])[0] == "good"
    assert _changed([metric(0.2, 0.01), metric(0.21, 0.01)]) == ("care", "no difference between the points is shown")
    assert _changed([metric(0.2, None), metric(0.9, None)]) == ("", "computed without an interval")


def test_the_page_shows_three_numbers_and_says_how_it_was_done():
    rows = tuple(
        StudyRow(
            number=k,
            changes={"light.angle_deg": 30.0 * k},
            metrics=(metric(0.2 * k, 0.01), metric(3.0, None, "force_n")),
        )
        for k in (1, 2, 3)
    )
    result = StudyResult(name="tilt", about="", varied=("light.angle_deg",), points=rows, failures=())
    html = design_study_page(result, [], "finray study run tilt.toml", {}, "0.1.0")
    assert_stands_alone(html)
    text = Page(html).prose
    assert "evenness 0.2 to 0.6 darkest over brightest \u2713 good : the points differ by more than" in text
    assert "The force is lowest at angle 30 deg (3, as at other points)." in text
    assert "Computed 3 of 3 points \u2713 good : none failed" in text
    told = " ".join(study_methods(result))
    assert told in text
    assert "varied in light.angle_deg: 3 designs were computed." in told


SHARES = {"red_share": 0.41, "green_share": 0.4, "blue_share": 0.19}


def pictured(number: int, changes: dict[str, str | float]) -> StudyPoint:
    rng = np.random.default_rng(number)
    images = {name: rng.random((60, 80, 3)).astype(np.float32) for name in ("no_contact", "contact")}
    metrics = tuple(metric(value, 0.02, name) for name, value in (*SHARES.items(), ("vividness", 7.0 + number)))
    return StudyPoint(
        study="pads", number=number, key="0" * 64, changes=changes, design=FingerDesign(), metrics=metrics,
        processor_s=1.0, **images,
    )  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [
        [{"preset": "flat-70x35"}, {"preset": "cylindrical-r60"}, {"preset": "a <b> & c"}],
        [{"preset": "flat-70x35", "indenter.depth_mm": 0.8}, {"preset": "wide-50x50", "indenter.depth_mm": 0.9}],
        [
            {"light.angle_deg": 0.0, "indenter.position_mm": 15.0},
            {"light.angle_deg": 0.0, "indenter.position_mm": 20.0},
        ],
    ],
    ids=["by name", "together", "along an axis"],
)
def test_pictures_have_their_numbers_and_points_their_names(changes):
    points = [pictured(k, change) for k, change in enumerate(changes, start=1)]
    rows = tuple(StudyRow(number=p.number, changes=p.changes, metrics=p.metrics) for p in points)
    result = StudyResult(name="pads", about="", varied=tuple(changes[0]), points=rows, failures=())
    html = design_study_page(result, points, "finray study run pads.toml", {}, "0.1.0")
    assert_stands_alone(html)
    assert "Red, green, blue is the strongest on 41, 40, 19 % of the coat; vividness 8" in " ".join(html.split())
    assert "share of the coat where each light is the strongest" in html
    pictures = cv2.imdecode(np.frombuffer(study_pictures_webp(points), np.uint8), cv2.IMREAD_COLOR)
    assert pictures.shape[1] > pictures.shape[0] / 2
    assert pictures.std() > 20.0
    assert study_pictures_webp([]) is None


def test_pictures_are_cut_to_what_is_lit_and_show_what_the_touch_changes():
    point = pictured(1, {"preset": "flat-70x35"})
    dark = np.full((60, 80, 3), 1e-3, dtype=np.float32)
    rest, pressed = dark.copy(), dark.copy()
    rest[20:40, 30:70] = pressed[20:40, 30:70] = 1.0
    pressed[25:30, 40:50, 0] = 2.0
    rest[5, 5] = pressed[5, 5] = 9.0  # one bright pixel is noise
    one = point.model_copy(update={"no_contact": rest, "contact": pressed})
    (before, after, change), (larger, *_) = _all_views([one, point.model_copy(update={"no_contact": rest.copy()})])
    assert larger.shape == before.shape == after.shape == change.shape == (20, 40, 3)
    assert (before == 255).all()
    assert (change[6:9, 11:19, 0] == 255).all()  # smoothed by a pixel at its edges
    assert (change[:2, :, 0] == 128).all()
    assert set(change[..., 1:].ravel()) == {128}
    aside = dark.copy()
    aside[20:50, 10:20] = 1.0
    views = _all_views([one, point.model_copy(update={"no_contact": aside, "contact": aside})])
    assert {picture.shape for of_point in views for picture in of_point} == {(30, 60, 3)}  # rows 20-50, columns 10-70


def test_pictures_of_a_grid_stand_in_rows_of_its_last_field():
    grid = [pictured(1, {"indenter.position_mm": at, "light.angle_deg": a}) for at in (1.0, 2.0) for a in (0, 15, 30)]
    assert _pictures_in_a_row(grid) == 3
    assert _pictures_in_a_row([pictured(1, {"preset": str(k)}) for k in range(7)]) == 4
    together = [pictured(1, {"preset": "a", "indenter.depth_mm": depth}) for depth in (0.8, 1.2, 0.8, 1.5)]
    assert _pictures_in_a_row(together) == 4


def test_points_are_named_in_ranges_by_the_code_that_computed_them():
    one = study({float(k): 1.0 for k in range(1, 8)}, 0.1)
    codes = ["a", "a", "a", "b", "a", None, None]
    rows = tuple(row.model_copy(update={"computed_by": code}) for row, code in zip(one.points, codes, strict=True))
    assert points_by_code(one.model_copy(update={"points": rows})) == {
        "a": "1 to 3, 5", "b": "4", "unknown code": "6 to 7",
    }  # fmt: skip


def test_a_point_is_named_by_what_it_changes_with_its_unit():
    point = pictured(1, {"preset": "flat-70x35", "indenter.depth_mm": 0.8, "skeleton.rib_count": 5})
    assert _names(point) == "flat-70x35\ndepth 0.8 mm\nrib count 5"
    twice = pictured(2, {"light.angle_deg": 30.0, "second_light.angle_deg": 20.0})
    assert _names(twice) == "light angle 30 deg\nsecond light angle 20 deg"


def study(values: dict[float, float], half: float | None, name: str = "one") -> StudyResult:
    rows = tuple(
        StudyRow(number=k, changes={"light.angle_deg": angle}, metrics=(metric(value, half),))
        for k, (angle, value) in enumerate(values.items(), start=1)
    )
    return StudyResult(name=name, about="", varied=("light.angle_deg",), points=rows, failures=())


def test_two_studies_of_equal_points_seldom_differ_and_a_real_difference_is_found():
    """In at most 5 % of pairs of studies does any of 20 equal points differ; single limits would say so in most."""
    rng = np.random.default_rng(3)
    called, alone = 0, 0
    for _ in range(400):
        one, two = (dict(enumerate(rng.standard_normal(20))) for _ in range(2))
        found = study_differences(study(one, 1.96), study(two, 1.96))
        called += any(d.is_apart for d in found)
        alone += any(not d.low95 <= 0.0 <= d.high95 for d in found)
    assert called <= 400 * 0.05 + 2 * np.sqrt(400 * 0.05 * 0.95)
    assert alone > 200
    found = study_differences(study({0.0: 1.0, 30.0: 2.0, 60.0: 3.0}, 0.05), study({30.0: 2.5, 60.0: 3.0}, 0.05))
    assert [(d.changes["light.angle_deg"], d.is_apart) for d in found] == [(30.0, True), (60.0, False)]
    assert found[0].low95 == pytest.approx(0.5 - 0.05 * np.sqrt(2.0))
    text = study_differences_text(found)
    assert "light.angle_deg 30:\n  evenness  2 -> 2.5  0.500 [0.429, 0.571], differs" in text
    assert text.endswith("no difference shown")
    (same,) = study_differences(study({0.0: 1.0}, None), study({0.0: 1.0}, None))
    assert same.is_apart is None
    assert study_differences_text([same]).endswith("the same")


def test_pictures_of_many_points_fit_into_webp(monkeypatch):
    """WebP holds 16383 px: 52 points, two in a row, were taller at 120 dots per inch, and an empty file was stored."""
    tallest = _design_study_page.TALLEST_WEBP_PX
    heights = (tallest, tallest + 1)
    assert [cv2.imencode(".webp", np.zeros((height, 1, 3), np.uint8))[0] for height in heights] == [True, False]
    monkeypatch.setattr(_design_study_page, "TALLEST_WEBP_PX", 800)
    points = [pictured(k, {"light.angle_deg": float(k // 2), "indenter.depth_mm": 0.8 + k % 2}) for k in range(2, 8)]
    assert _pictures_in_a_row(points) == 2
    pictures = cv2.imdecode(np.frombuffer(study_pictures_webp(points), np.uint8), cv2.IMREAD_COLOR)
    assert 750 < pictures.shape[0] <= 800
