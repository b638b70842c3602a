"""Images for the screen and figures: known values, outlines, and marks that do not rely on colour."""

import base64
import io
import re
from dataclasses import replace
from itertools import pairwise
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from example_records import example_decision, example_results
from html_page import Page, assert_stands_alone

from data_schemas import RecordError
from finray_calib.reports import (
    angle_figure,
    clipped_remark,
    display_white,
    error_map_figure,
    pad_window,
    raspberry_pi_display,
    score_figure,
    to_display,
    touch_pair,
)
from finray_calib.reports._decision_figures import on_curve_scale
from finray_calib.reports._fit_figures import (
    absorption_figure,
    bands_figure,
    draw_emission,
    emission_figure,
    families_figure,
    marginals_figure,
    reflectance_figure,
)
from finray_calib.reports._images import (
    CLIPPED_GREYS,
    TouchChanges,
    is_unmixed,
    png_bytes,
    png_data_uri,
    touch_pictures,
    with_outline,
)
from finray_calib.reports._page import ReportPage, drawing, report_html
from finray_calib.reports._style import CANDIDATES, CHANNELS, ReadableFigure, Reading, new_figure, readable
from finray_calib.sensing import rgb_image

RESULTS = example_results()


def test_srgb_transfer_of_known_values() -> None:
    # Mid grey 0.2140 is code value 127 or 128 of sRGB (IEC 61966-2-1), 0.001 lies on the straight part.
    image = np.array([[[0.0, 0.001, 0.2140], [1.0, 2.0, np.nan]]])
    assert to_display(image, np.ones(3), linear=True).tolist() == [[[0, 3, 127], [255, 255, 0]]]
    assert to_display(image, np.ones(3), linear=False)[0, 0].tolist() == [0, 0, 55]


def test_white_balance_makes_a_grey_card_grey_and_refuses_a_dark_channel() -> None:
    card = np.full((20, 20, 3), (2.0, 5.0, 0.3))
    assert np.unique(to_display(card, display_white(card), linear=True)).tolist() == [255]
    with pytest.raises(RecordError, match=r"every channel must be above 0 to be shown white-balanced"):
        display_white(card * [1.0, 1.0, 0.0])


def test_a_raspberry_pi_shows_daylight_grey_and_its_leds_blue() -> None:
    pad = np.ones((4, 4), dtype=bool)
    daylight = np.full((4, 4, 3), (1 / 2.31, 1.0, 1 / 1.24))  # what the sensor sees of a grey card at 8575 K
    card = raspberry_pi_display(daylight, pad)
    assert np.ptp(card.astype(int)) <= 1
    assert card[0, 0, 1] == round(255 * np.interp(0.7 * 65535, [32768, 49152], [54876, 61183]) / 65535)
    led = raspberry_pi_display(np.full((4, 4, 3), (0.034, 0.075, 0.83)), pad)  # the IMX219's response at 450 nm
    assert led[0, 0, 0] == 0
    assert led[0, 0, 1] == 0
    assert led[0, 0, 2] > 200
    with pytest.raises(RecordError, match=r"the pad is black in a Raspberry Pi's colours"):
        raspberry_pi_display(np.zeros((4, 4, 3)), pad)


def test_a_bayer_frame_becomes_half_size_rgb_above_black() -> None:
    capture = RESULTS.capture
    frame = np.zeros((4, 6, 1), dtype=np.uint16)
    frame[0::2, 0::2], frame[0::2, 1::2], frame[1::2, 0::2], frame[1::2, 1::2] = 116, 216, 236, 316
    assert np.array_equal(rgb_image(frame, capture), np.full((2, 3, 3), (100.0, 210.0, 300.0)))
    rgb = np.full((2, 2, 3), 20, dtype=np.uint16)
    assert np.array_equal(rgb_image(rgb, capture.model_copy(update={"layout": "RGB"})), np.full((2, 2, 3), 4.0))


def test_an_outline_is_a_white_line_beside_a_black_one_on_any_grid() -> None:
    grey = np.full((40, 40, 3), 90, dtype=np.uint8)
    mask = np.zeros((20, 20), dtype=bool)
    mask[5:15, 5:15] = True
    drawn = with_outline(grey, mask)[..., 0]
    assert drawn[20, [8, 9, 10, 11, 20]].tolist() == [90, 0, 255, 90, 90]
    assert np.array_equal(with_outline(grey, np.ones((20, 20), dtype=bool)), grey)


def test_unmixing_shows_the_light_of_each_source_whatever_the_camera() -> None:
    rng = np.random.default_rng(3)
    press = RESULTS.press
    bands, nowhere = rng.uniform(0.1, 1.0, (*press.distance.shape, 3)), np.zeros(press.distance.shape, dtype=bool)
    assert press.camera_matrix is not None
    camera = bands @ press.camera_matrix.T
    window = pad_window(press)
    pad = np.isfinite(press.distance)
    expected = to_display(bands, display_white(bands[pad]), linear=True)[window].astype(int)
    shown, touched = touch_pair(press, camera, 0.5 * camera, nowhere)
    # Rounding of the inverse may move a value over the edge between two codes.
    assert np.abs(shown - expected).max() <= 1
    half = to_display(0.5 * bands, display_white(bands[pad]), linear=True)[window].astype(int)
    assert np.abs(touched - half).max() <= 1  # the touched image keeps the white of the untouched one
    blue_first = press.model_copy(
        update={"bands": ("led", "green", "red"), "camera_matrix": press.camera_matrix[:, ::-1].copy()}
    )
    assert np.abs(touch_pair(blue_first, camera, camera, nowhere)[0] - expected).max() <= 1


def test_glare_beside_the_pad_does_not_set_the_scale() -> None:
    press, nowhere = RESULTS.press, np.zeros(RESULTS.press.distance.shape, dtype=bool)
    glare = press.no_contact.copy()
    glare[~np.isfinite(press.distance)] = 1e3
    plain, bright = (touch_pair(press, image, image, nowhere)[0] for image in (press.no_contact, glare))
    on_pad = np.isfinite(press.distance)[pad_window(press)]
    assert np.array_equal(plain[on_pad], bright[on_pad])


def test_images_are_not_unmixed_without_matrix_or_linear_light() -> None:
    press, nowhere = RESULTS.press, np.zeros(RESULTS.press.distance.shape, dtype=bool)
    assert is_unmixed(press)
    for update in ({"camera_matrix": None}, {"encoding": "unknown"}, {"bands": ("a", "b", "c")}):
        plain = press.model_copy(update=update)
        assert not is_unmixed(plain)
        shown, _ = touch_pair(plain, press.no_contact, press.contact, nowhere)
        white = display_white(press.no_contact[np.isfinite(press.distance)])
        linear = plain.encoding == "linear"
        assert np.array_equal(shown, to_display(press.no_contact, white, linear)[pad_window(press)])


def test_clipped_pixels_are_shown_as_clipped_and_not_in_a_false_colour() -> None:
    """Unmixed, a pixel whose red is at full scale would be cyan."""
    press, capture = RESULTS.press, RESULTS.capture
    row, column = (int(n[0]) for n in np.nonzero(press.distance <= 0.5))
    full = 2**capture.bit_depth - 1
    contact = capture.contact.copy()
    assert capture.layout == "Bayer RGGB"
    contact[2 * row, 2 * column] = full
    glared = capture.model_copy(update={"contact": contact})
    window = pad_window(press)
    place = row - window[0].start, column - window[1].start
    pictures = touch_pictures(press, glared, ())
    before, after = (rgb_image(image, glared) for image in (glared.no_contact, glared.contact))
    nowhere = np.zeros(press.distance.shape, dtype=bool)
    for shown in (pictures.captured, touch_pair(press, before, after, nowhere)[1]):
        pixel = shown[place].tolist()
        assert pixel[0] == pixel[1] == pixel[2]
        assert pixel[0] in CLIPPED_GREYS
    assert pictures.clipped[1][place]
    # neighbours and the untouched picture stay as they were
    plain = touch_pictures(press, capture, ())
    changed = (pictures.captured != plain.captured).any(axis=-1)
    assert changed.sum() <= 1
    assert np.array_equal(pictures.captured_untouched, plain.captured_untouched)


def test_captions_tell_of_clipped_pixels_where_there_are_any() -> None:
    assert clipped_remark(np.zeros((3, 3), dtype=bool)) == ""
    assert "clipped, so the colour is not known" in clipped_remark(np.eye(3, dtype=bool))


def test_png_holds_the_same_pixels() -> None:
    image = np.random.default_rng(1).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    decoded = cv2.imdecode(np.frombuffer(png_bytes(image), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert np.array_equal(decoded[..., ::-1], image)
    assert base64.b64decode(png_data_uri(image).split(",")[1]) == png_bytes(image)


def test_every_figure_is_well_formed_and_undated() -> None:
    paint, outline = RESULTS.paints["green"].fitted, RESULTS.press.distance <= 2.0
    makers = {
        "emission": lambda: emission_figure(paint).svg,
        "families": lambda: families_figure(paint),
        "absorption": lambda: absorption_figure(paint).svg,
        "bands": lambda: bands_figure(paint),
        "marginals": lambda: marginals_figure(paint),
        "reflectance": lambda: reflectance_figure(paint),
        "error map": lambda: error_map_figure(RESULTS.report, outline),
        "scores": lambda: score_figure(RESULTS.report),
        "angle": lambda: angle_figure(RESULTS.decision, RESULTS.sweep, RESULTS.true_sweeps).svg,
    }
    for name, make in makers.items():
        svg = make()
        assert ElementTree.fromstring(svg).tag.endswith("svg"), name
        assert "<dc:date>" not in svg, name


def test_series_differ_by_marker_and_not_only_by_colour() -> None:
    assert len({marker for _, marker, _ in CHANNELS}) == len(CHANNELS)
    assert len({marker for marker, _ in CANDIDATES.values()}) == len(CANDIDATES)


def test_the_angle_figure_shows_more_when_there_is_more() -> None:
    validated = angle_figure(example_decision("tie"), RESULTS.sweep, RESULTS.true_sweeps).svg
    alone = angle_figure(example_decision("tie", validated=False), RESULTS.sweep).svg
    assert len(validated) > len(alone)


def test_a_sweep_on_the_scale_of_the_curve_ignores_the_scale_of_each_repeat() -> None:
    scaled = RESULTS.sweep.model_copy(update={"values": RESULTS.sweep.values * [2.0, 70.0, 0.1]})
    one, other = (on_curve_scale(sweep, RESULTS.decision) for sweep in (RESULTS.sweep, scaled))
    np.testing.assert_allclose(one, other, rtol=1e-12)  # only rounding may differ
    curve = np.interp(RESULTS.sweep.angles_deg, RESULTS.decision.grid_deg, RESULTS.decision.mean)
    np.testing.assert_allclose(one.mean(axis=0), curve.mean(), rtol=1e-12)


def test_names_with_mathematics_and_negative_scores_are_drawn() -> None:
    region = RESULTS.report.regions[0]
    worse = region.rows[1].skill.model_copy(update={"estimate": -3.0, "low95": -4.0, "high95": -2.0})
    rows = (region.rows[0], region.rows[1].model_copy(update={"skill": worse}))
    report = RESULTS.report.model_copy(
        update={"regions": (region.model_copy(update={"region": "$\\frac{ a very long name", "rows": rows}),)}
    )
    assert "<svg" in score_figure(report)


def test_an_error_map_without_error_or_outline_is_drawn() -> None:
    report = RESULTS.report.model_copy(update={"error_map": np.zeros((8, 10), dtype=np.float32)})
    assert "<svg" in error_map_figure(report, np.ones((8, 10), dtype=bool))


def test_unknown_parameters_and_many_of_them_are_drawn() -> None:
    paint = RESULTS.paints["red"].fitted
    fit = paint.fit.model_copy(update={"sampled": ("shape_mode_nm", "ln_shape_fwhm_nm", "stokes_shift_nm")})
    assert "<svg" in marginals_figure(replace(paint, fit=fit))


def test_a_band_that_is_not_explained_is_marked() -> None:
    paint = RESULTS.paints["red"].fitted
    assert all(band.explained for band in paint.fit.bands)
    poor = (paint.fit.bands[0].model_copy(update={"explained": False}), *paint.fit.bands[1:])
    marked = bands_figure(replace(paint, fit=paint.fit.model_copy(update={"bands": poor})))
    assert len(marked) > len(bands_figure(paint))


def test_an_absorption_that_was_measured_under_several_lights_is_drawn_differently() -> None:
    paint = RESULTS.paints["red"].fitted
    measured = paint.fit.reradiation.model_copy(update={"measured_at_nm": (405.0, 450.0), "prior_driven": False})
    fit = paint.fit.model_copy(update={"reradiation": measured})
    assert absorption_figure(replace(paint, fit=fit)).svg != absorption_figure(paint).svg


READING = re.compile(r"^([-\d.]+) (nm|deg): (\S+) \[(\S+), ([^\]]+)\] (.+)$")


def said(figure: ReadableFigure) -> np.ndarray:
    """Return place, estimate and limits that a figure says under the pointer, one row for each strip."""
    found = [READING.match(reading.text) for reading in figure.readings]
    return np.array([[float(one[k]) for k in (1, 3, 4, 5)] for one in found if one])


def test_values_under_the_pointer_are_those_of_the_record() -> None:
    paint = RESULTS.paints["red"].fitted
    fit, absorption, decision = paint.fit, paint.fit.reradiation, RESULTS.decision
    best, assumed = decision.mean.max(), decision.discrepancy_rel is not None
    widest = (
        (decision.low95, decision.high95)
        if assumed
        else (decision.low95_simulation_only, decision.high95_simulation_only)
    )
    middle = decision.mean if decision.validated else decision.mean_simulation_only
    emission = (fit.wavelength_nm, fit.emission_per_nm, fit.emission_low95_per_nm, fit.emission_high95_per_nm)
    expected = {
        "emission": (emission_figure(paint), 100, emission),
        "absorption": (
            absorption_figure(paint),
            60,
            (absorption.excitation_nm, absorption.absorption_rel, absorption.low95, absorption.high95),
        ),
        "angle": (
            angle_figure(decision, RESULTS.sweep),
            50,
            (decision.grid_deg, middle / best, *(limit / best for limit in widest)),
        ),
    }
    for name, (figure, least, (places, *curves)) in expected.items():
        rows = said(figure)
        assert len(rows) == len(figure.readings) >= least, name
        at = np.searchsorted(places, rows[:, 0])
        np.testing.assert_array_equal(places[at], rows[:, 0], err_msg=name)
        for column, curve in enumerate(curves, start=1):  # three decimals are written, of emission in thousandths
            factor = 1e3 if name == "emission" else 1.0
            np.testing.assert_allclose(rows[:, column], factor * curve[at], rtol=0, atol=5.1e-4, err_msg=name)


def test_a_known_spectrum_is_under_the_pointer_too() -> None:
    paint = RESULTS.paints["red"].fitted
    assert paint.truth is not None
    for reading in emission_figure(paint).readings[::20]:
        nm, true = float(reading.text.split(" ")[0]), float(reading.text.rpartition("; truth ")[2])
        assert true == pytest.approx(1e3 * float(paint.truth.emission(np.array([nm]))[0]), abs=5.1e-4)
    assert all("truth" not in reading.text for reading in draw_emission(paint.fit).readings)


def test_a_strip_lies_over_the_point_that_it_describes() -> None:
    """Points of one colour each are searched for among the pixels of the drawn figure."""
    figure = new_figure(5.0, 3.0)
    axes = figure.subplots()
    places, colours = [-2.0, 1.0, 7.0], [(255, 0, 0), (0, 255, 0), (0, 0, 255)]
    for place, colour in zip(places, colours, strict=True):
        axes.plot([place], [place**2], "s", color=[c / 255 for c in colour], markersize=8)
    axes.set(xlim=(-5.0, 9.0), xlabel="place", ylabel="a label that moves the plot to the right")
    drawn = readable(figure, axes, {place: f"at {place:g}" for place in [*places, 12.0]})
    assert [reading.text for reading in drawn.readings] == ["at -2", "at 1", "at 7"]  # 12 is outside
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    image = cv2.imdecode(np.frombuffer(buffer.getvalue(), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    for reading, colour in zip(drawn.readings, colours, strict=True):
        down, across = (found.mean() / size for found, size in zip(
            np.nonzero((image[..., ::-1] == colour).all(axis=-1)), image.shape, strict=False
        ))  # fmt: skip
        assert reading.left_rel < across < reading.left_rel + reading.width_rel
        assert reading.top_rel < down < reading.top_rel + reading.height_rel
    for one, other in pairwise(drawn.readings):
        assert one.left_rel + one.width_rel == pytest.approx(other.left_rel, abs=2e-5)


def test_a_figure_without_places_has_no_strips_and_one_place_has_all() -> None:
    figure = new_figure(3.0, 2.0)
    axes = figure.subplots()
    axes.set_xlim(0.0, 1.0)
    assert readable(figure, axes, {}).readings == ()
    (only,) = readable(figure, axes, {0.5: "half"}).readings
    box = axes.get_position()
    assert (only.left_rel, only.width_rel) == (pytest.approx(box.x0, abs=1e-4), pytest.approx(box.width, abs=1e-4))


def test_words_under_the_pointer_are_escaped_and_readers_of_a_screen_skip_them() -> None:
    hostile = '</title><script>alert(1)</script> & "quoted"'
    picture = drawing(ReadableFigure("<svg/>", (Reading(0.1, 0.1, 0.5, 0.8, hostile),)), "what it shows", "caption")
    page = ReportPage(
        verb="finray test", title="t", verdict="v", picture=picture, key_numbers=(), parts=(), origin=None, summary={}
    )
    html = report_html(page)
    assert_stands_alone(html)
    parsed = Page(html)
    assert parsed.prose.count(hostile) == 1
    (overlay,) = parsed.all("svg")
    assert overlay["aria-hidden"] == "true"
    assert [image["alt"] for image in parsed.all("img")] == ["what it shows"]


def test_the_colours_of_a_change_are_those_of_the_regions_and_not_of_what_lies_beside_them():
    """Beside the touch the change is 5, in its region 0.3; the maps are coarser than the mask."""
    region = np.zeros((8, 12), bool)
    region[2:6, 4:8] = True
    captured = np.where(region[::2, ::2], 0.3, 5.0)
    assert TouchChanges(captured, -captured, (region,)).scale == pytest.approx(0.3)
    assert TouchChanges(captured, captured, (np.zeros((8, 12), bool),)).scale == pytest.approx(5.0)
