"""From press and capture to the report: rows, statements, notes, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from data_schemas import CompareError, ContactCircle
from finray_calib.compare import DILATED, CheckOptions, compare_checked, compare_press
from finray_calib.compare import _input_draws as stopping_rule
from finray_calib.compare._candidate_errors import chromaticity_error, skill_interval
from finray_calib.compare._comparison_record import ALWAYS_UNKNOWN, COVERS_INPUTS, COVERS_PARTS
from finray_calib.compare._image_noise import CaptureNoise
from finray_calib.compare._input_draws import DRIFT, PIXELS, POSE, WALLS
from finray_calib.compare._prepared_images import holds_noise_of, prepare_images
from finray_calib.compare._regions import PATCH
from finray_calib.reports._comparison_statements import simulation_sentence
from tests.command_line.records import capture_of
from tests.command_line.records import press as made_up_press
from tests.compare.twins import BLACK_DN, DN_PER_UNIT, FULL_SCALE_DN, NAMES, SHAPE, distance_map, twin


@pytest.fixture(autouse=True)
def _few_draws(monkeypatch):
    """Blocks of 500 draws, 12 at most: contents of the report are tested here, not its last digit."""
    monkeypatch.setattr(stopping_rule, "BLOCK_DRAWS", 500)


@pytest.fixture
def pair():
    made = twin(np.random.default_rng(0))
    return made.press, made.capture


def rows_of(report, region=DILATED):
    found = next(r for r in report.regions if r.region == region)
    return {row.candidate: row for row in found.rows}


def test_linear_light_with_known_inputs_gives_every_figure(pair):
    report = compare_press(*pair, seed=1)
    assert report.values == "linear light"
    assert [r.region for r in report.regions] == [PATCH, DILATED]
    assert [r.pixels for r in report.regions] == [int((distance_map() <= k).sum()) for k in (1.0, 2.0)]
    rows = rows_of(report)
    assert list(rows) == ["do nothing", "simulation", "floor"]
    assert report.headline_region == DILATED
    assert report.headline_skill == rows["simulation"].skill
    nothing = rows["do nothing"].skill
    assert (nothing.estimate, nothing.low95, nothing.high95) == (0.0, 0.0, 0.0)
    for row in rows.values():
        for interval in (row.skill, *row.relative_rms, row.difference_gradient_rms_per_px):
            assert interval.low95 <= interval.estimate <= interval.high95
    # the twin is right but for its inputs and 5 % of shape; the floor is noise, which is taken out
    assert 0.9 < report.headline_skill.estimate < 1.0
    assert rows["floor"].skill.estimate > report.headline_skill.estimate
    # similarity is that of the images as they are: the render's noise makes it prefer doing nothing
    assert rows["simulation"].ssim < rows["do nothing"].ssim
    assert rows["simulation"].psnr_db > rows["do nothing"].psnr_db
    assert set(report.ssim_full_frame) == set(rows)
    assert report.withheld == ()
    assert report.interval_covers == COVERS_INPUTS
    assert report.exposure_factor_sd > 0.0
    assert {line.input for line in report.budget} == {*NAMES, POSE["depth_mm"], WALLS, DRIFT, PIXELS}
    assert len(report.validation) == 27
    assert report.objective_error.source == "; ".join(NAMES)
    assert report.error_map.shape == SHAPE
    assert 500 * 4 <= report.monte_carlo.draws <= 500 * 12
    left_out = report.monte_carlo.not_included
    assert left_out[:2] == ALWAYS_UNKNOWN
    # depth is stated and rendered, position neither; both paints are calibrated
    assert [text.split(":")[0] for text in left_out[2:]] == [f"the {POSE['position_mm']}"]


def test_a_capture_of_another_press_is_told_by_its_place_and_its_name(pair):
    """A circle in the middle of the press's own contact says nothing, nor do numbers without a unit."""
    press, capture = pair
    cell = 1 if capture.layout == "RGB" else 2
    near, far = (np.unravel_index(find(press.distance), SHAPE) for find in (np.nanargmin, np.nanargmax))
    told = {}
    for case, (row, column), names in (
        ("right", near, ("ball 5mm 03", "ball_5mm_17")),
        ("elsewhere", far, ("ball 03", "ball 17")),
        ("named", near, ("ball 5mm", "ball_10mm")),
    ):
        circle = ContactCircle(row_px=cell * row, column_px=cell * column, radius_px=3.0 * cell)
        other = capture.model_copy(update={"contact_circle": circle, "name": names[1]})
        report, _ = compare_checked(press.model_copy(update={"name": names[0]}), other, seed=1)
        told[case] = [text for text in report.findings if text.startswith(("place:", "names:"))]
    assert told["right"] == []
    (place,) = told["elsewhere"]
    centres = re.findall(r"centre at row (\d+) px, column (\d+) px, radius \d+ px", place)
    assert np.abs(np.array(centres[1], dtype=float) - far).max() <= 3.0  # part of the circle is outside the image
    assert "check that both are of the same press" in place
    assert told["named"] == [
        "names: the render ball 5mm is named by 5 mm, but the capture ball_10mm by 10 mm: check that both are of the "
        "same press"
    ]


def test_colour_errors_are_those_of_the_noise_free_images():
    """The twin's model error has no colour; doing nothing misses the colour of the contact."""
    made = twin(np.random.default_rng(0), render_noise=0.02)
    rows = rows_of(compare_press(made.press, made.capture, seed=1))
    within = distance_map() <= 2.0
    truth = chromaticity_error(made.clean_no_contact, made.clean_contact, within).rms
    # noise of 2 % in the channels of 6000 pixels, to first order
    assert rows["do nothing"].chromaticity_rms.estimate == pytest.approx(truth, rel=0.01)
    found = rows["simulation"].chromaticity_rms
    assert found.low95 < 0.001
    assert 0.0 < found.estimate < 0.1 * truth
    # made of the capture itself: only the noise of two images is in it, and nothing else
    floor = rows["floor"].chromaticity_rms
    assert floor is None or floor.estimate < 0.05 * truth


def test_the_seed_decides_the_draws_and_nothing_else(pair):
    one, again, other = (compare_press(*pair, seed=s) for s in (1, 1, 2))
    assert one.headline_skill == again.headline_skill
    assert one.headline_skill != other.headline_skill
    assert one.exposure_factor == other.exposure_factor
    assert (one.error_map == other.error_map).all()
    # what reports share does not depend on the seed: the exposure of a draw is that of its paints
    draws = [r.objective_error.log_exposure_draws for r in (one, other)]
    assert draws[0] == pytest.approx(draws[1], abs=0.2)
    assert np.corrcoef(*draws)[0, 1] > 0.9


def test_a_loud_render_is_compared_over_blocks():
    made = twin(np.random.default_rng(1), render_noise=0.5)
    report = compare_press(made.press, made.capture, seed=1)
    # 8 px of half-width: blocks of up to 2
    assert report.block_px == 2
    assert any("compared over blocks of 2 x 2 px" in note for note in report.notes)
    assert report.error_map.shape == (SHAPE[0] // 2, SHAPE[1] // 2)
    quiet = twin(np.random.default_rng(1), render_noise=0.02)
    assert compare_press(quiet.press, quiet.capture, seed=1).block_px == 1


def test_a_paint_without_calibration_is_said_to_be_left_out(pair):
    press, capture = pair
    known = press.known_inputs
    camera_only = known.model_copy(
        update={
            "names": known.names[2:], "keys": known.keys[2:], "evaluations": known.evaluations[2:],
            "sources": known.sources[2:], "factors": known.factors[2:],
        }
    )  # fmt: skip
    report = compare_press(press.model_copy(update={"known_inputs": camera_only}), capture, seed=1)
    for colour in ("red", "green"):
        assert f"the {colour} paint, for which the press holds no draws" in report.monte_carlo.not_included


def test_without_known_inputs_intervals_come_from_parts():
    press = made_up_press()
    report = compare_press(press, capture_of(press, 50.0), seed=1)
    assert report.interval_covers == COVERS_PARTS
    assert report.monte_carlo is None
    assert report.budget == report.validation == ()
    # noise of 1 DN is all that is wrong, and it is taken out
    assert report.headline_skill.estimate == pytest.approx(1.0, abs=1e-4)
    assert report.exposure_factor == pytest.approx(50.0, rel=1e-3)
    assert report.exposure_factor_sd is None
    assert report.objective_error is None
    assert any("no input of strip has a known uncertainty" in line for line in report.withheld)
    assert (
        "the render was not stored as two independent halves, so its noise is not known and stays in its errors"
        in report.notes
    )


def test_the_floor_of_linear_light_is_free_of_noise_and_the_sentence_says_so(pair):
    """Two images that differ by noise alone: left in, the noise would cost more skill than the floor shows lost."""
    report, (_, capture) = compare_press(*pair, seed=1), pair
    where = distance_map() <= 2.0
    contact, nothing, repeat = (
        image[where].astype(np.float64) for image in (capture.contact, capture.no_contact, capture.repeat_no_contact)
    )
    weights = np.asarray(report.channel_weights)
    with_noise = ((repeat - nothing) ** 2).sum(axis=0) @ weights / (((contact - nothing) ** 2).sum(axis=0) @ weights)
    lost = 1.0 - rows_of(report)["floor"].skill.estimate
    assert abs(lost) < 0.5 * with_noise  # all of it if it were left in, about 0 if not
    assert "its noise taken out as well" in simulation_sentence(report)


def test_pictures_of_one_level_are_refused():
    """Taken for a gain of the whole picture, their change is what rounding leaves: 1e-27 is no signal."""
    press = made_up_press("unknown")
    rows, columns = np.mgrid[0:160, 0:200].astype(np.float32)
    level = np.full((160, 200, 3), 120, np.uint16)
    images = {"contact": level - 10, "no_contact": level, "repeat_no_contact": level + 1}
    capture = capture_of(press, 1.0, encoding="unknown").model_copy(
        update={**images, "black_level_dn": 0.0, "bit_depth": 8}
    )
    distance = np.hypot(rows - 80, columns - 100) / 28
    flat = press.model_copy(
        update={"contact": 0.93 * level.astype("f4"), "no_contact": level.astype("f4"), "distance": distance}
    )
    with pytest.raises(CompareError, match="contact changes nothing in the region 'contact patch'"):
        compare_press(flat, capture, seed=1)


def test_without_a_repeat_neither_floor_nor_noise_is_known(pair):
    press, capture = pair
    report = compare_press(press, capture.model_copy(update={"repeat_no_contact": None}), seed=1)
    assert list(rows_of(report)) == ["do nothing", "simulation"]
    assert (
        "the capture has no repeat of the no-contact image, so neither the floor nor the camera's noise is known"
        in report.notes
    )
    drift = next(line for line in report.budget if line.input == DRIFT)
    assert drift.evaluation == "B"


def test_encoded_values_get_similarity_and_skill_only():
    press = made_up_press("unknown")
    report = compare_press(press, capture_of(press, 50.0, encoding="unknown"), seed=1)
    assert report.values == "encoded values, encoding unknown"
    assert len(report.withheld) == 1
    assert "the encoding of capture of the strip is unknown" in report.withheld[0]
    for row in rows_of(report).values():
        assert row.relative_rms is row.difference_gradient_rms_per_px is row.chromaticity_rms is None
        assert row.ssim is not None
    assert report.exposure_factor is report.objective_error is report.monte_carlo is None
    assert report.channel_weights == (1.0, 1.0, 1.0)
    assert "the noise of encoded images is not known, so it stays in their errors" in report.notes


def test_clipped_pixels_are_counted_and_left_out(pair):
    press, capture = pair
    contact = capture.contact.copy()
    contact[30:34, 20:26] = 2**capture.bit_depth - 1
    clean, clipped = (
        next(r for r in compare_press(press, c, seed=1).regions if r.region == DILATED)
        for c in (capture, capture.model_copy(update={"contact": contact}))
    )
    assert clean.clipped_fraction == 0.0
    assert clipped.clipped_fraction == pytest.approx(24 / clean.pixels)
    assert clipped.pixels == clean.pixels - 24
    estimates = [next(row for row in r.rows if row.candidate == "simulation").skill.estimate for r in (clean, clipped)]
    # 1 % of the region less
    assert estimates[0] == pytest.approx(estimates[1], abs=0.01)


def test_the_error_map_is_relative_to_each_channels_level():
    press = made_up_press()
    brighter = press.model_copy(update={"contact": 1.1 * press.contact})
    report = compare_press(brighter, capture_of(press, 50.0), seed=1)
    level = press.no_contact.mean(axis=(0, 1))
    expected = 0.1 * np.sqrt(((press.contact / level) ** 2).mean(axis=2))
    # noise of 1 DN in 5000, and of the exposure factor
    np.testing.assert_allclose(report.error_map, expected, atol=0.002)


def replaced(record, **changes):
    return record.model_copy(update=changes)


def test_a_skill_never_lies_outside_its_own_interval():
    """Noise that is taken out leaves estimates on both sides of 1; neither they nor their intervals are cut."""
    rng = np.random.default_rng(4)
    draws = 1.0 + 0.02 * rng.standard_normal(4000)
    for shift in (-0.5, 0.0, 0.1):
        found = skill_interval(draws + shift, draws + shift)
        # the quantile of 4000 draws is known to 0.05 standard deviations
        assert found.low95 == pytest.approx(1.0 + shift - 0.0392, abs=4 * 0.05 * 0.02)
        assert found.high95 == pytest.approx(1.0 + shift + 0.0392, abs=4 * 0.05 * 0.02)
    apart = skill_interval(draws, np.array([1.3]))
    assert apart.low95 <= apart.estimate == apart.high95 == 1.3


def test_every_skill_of_a_report_lies_in_its_interval(pair):
    report = compare_press(*pair, seed=1)
    skills = [row.skill for region in report.regions for row in region.rows]
    assert all(skill.low95 <= skill.estimate <= skill.high95 for skill in (*skills, report.headline_skill))


@pytest.mark.parametrize("render_noise", [0.1, 0.6])
@pytest.mark.parametrize("has_repeat", [True, False])
def test_a_capture_made_from_the_very_render_scores_1_and_says_so(render_noise, has_repeat):
    """The render's noise is in both images: taking it out once more would give 1.05 and 1.23."""
    made = twin(np.random.default_rng(3), render_noise)
    rng = np.random.default_rng(4)

    def exposed(image):
        counts = DN_PER_UNIT * image + BLACK_DN + 3.0 * rng.standard_normal(image.shape)
        return np.clip(np.rint(counts), 0, FULL_SCALE_DN).astype(np.uint16)

    repeat = exposed(made.press.no_contact) if has_repeat else None
    images = {"contact": exposed(made.press.contact), "no_contact": exposed(made.press.no_contact)}
    own = made.capture.model_copy(update={**images, "repeat_no_contact": repeat})
    report = compare_press(made.press, own, 1)
    assert report.headline_skill.estimate == pytest.approx(1.0, abs=0.002)
    assert report.headline_skill.low95 <= report.headline_skill.estimate <= report.headline_skill.high95
    assert "has the same noise as this render, so it was made from this render" in report.findings[0]


def test_captures_of_their_own_are_not_taken_for_the_render():
    for seed in range(10):
        made = twin(np.random.default_rng(seed), [0.02, 0.1, 0.6][seed % 3])
        assert not prepare_images(made.press, made.capture).holds_noise_of_render


@pytest.mark.parametrize("factor", [1.11, 1.15])
@pytest.mark.parametrize("render_noise", [0.012, 0.014, 0.02])
def test_a_camera_whose_noise_is_taken_too_large_is_no_copy_of_the_render(render_noise, factor):
    """Captures of their own; the render has a quarter to three quarters of the camera's noise."""
    for seed in range(4):
        made = twin(np.random.default_rng(seed), render_noise)
        images = prepare_images(made.press, made.capture)
        noise = images.captured.noise
        larger = CaptureNoise(factor * noise.offset, factor * noise.slope)
        assert not holds_noise_of(images.layers, replace(images.captured, noise=larger))


def test_images_of_another_size_are_refused(pair):
    press, capture = pair
    cut = {name: getattr(capture, name)[:, :-4] for name in ("contact", "no_contact", "repeat_no_contact")}
    with pytest.raises(
        CompareError, match=r"press has 80 x 64 px, but twin \d+ has 76 x 64 px; simulate with the camera of"
    ):
        compare_press(press, replaced(capture, **cut), seed=1)


def test_an_encoded_render_is_not_compared_with_linear_light(pair):
    press, capture = pair
    with pytest.raises(
        CompareError,
        match=r"press contains encoded values but twin \d+ contains linear light, and encoded values "
        r"cannot be converted",
    ):
        compare_press(replaced(press, encoding="unknown"), capture, seed=1)


def test_a_render_with_holes_is_refused(pair):
    press, capture = pair
    bands = press.contact_bands.copy()
    bands[5, 6, 2] = np.inf
    with pytest.raises(
        CompareError,
        match="press contains values that are not finite, because the render failed; simulate the press again",
    ):
        compare_press(replaced(press, contact_bands=bands), capture, seed=1)


def test_a_black_render_is_refused(pair):
    press, capture = pair
    dark = {n: np.zeros_like(press.no_contact_bands) for n in ("no_contact_bands", "no_contact_half_difference")}
    with pytest.raises(
        CompareError,
        match="no exposure factor fits, because the render or a channel of the capture without contact is black",
    ):
        compare_press(replaced(press, **dark), capture, seed=1)


def test_a_black_capture_is_refused(pair):
    press, capture = pair
    black = np.full_like(capture.no_contact, int(capture.black_level_dn))
    with pytest.raises(CompareError, match=r"Channel 0 of the no-contact image has a mean of 0 over the region"):
        compare_press(press, replaced(capture, no_contact=black, repeat_no_contact=black), seed=1)


def test_a_capture_without_contact_is_refused(pair):
    press, capture = pair
    above = [image - capture.black_level_dn for image in (capture.no_contact, capture.repeat_no_contact)]
    # at the same light: what drifts can look like a touch
    again = np.rint(above[1] * above[0].sum() / above[1].sum() + capture.black_level_dn).astype(np.uint16)
    with pytest.raises(CompareError, match="contact changes nothing in the region 'contact patch' beyond the camera's"):
        compare_press(press, replaced(capture, contact=again), seed=1)


@pytest.mark.parametrize(
    ("images", "said"),
    # with a repeat the camera's noise is looked for first
    [
        (("contact", "no_contact", "repeat_no_contact"), "only 0 pixels of the two no-contact images can be compared"),
        (("contact",), r"None of the \d+ pixels of the region is usable: all are clipped"),
    ],
)
def test_clipped_captures_are_refused(pair, images, said):
    press, capture = pair
    full = {name: np.full_like(capture.contact, 2**capture.bit_depth - 1) for name in images}
    with pytest.raises(CompareError, match=said):
        compare_press(press, replaced(capture, **full), seed=1)


def test_a_press_off_the_image_is_refused(pair):
    press, capture = pair
    with pytest.raises(CompareError, match=r"No pixel lies within 1\.0 half-widths of the contact line"):
        compare_press(replaced(press, distance=press.distance + 5.0), capture, seed=1)


def test_without_a_ring_beside_the_contact_there_is_no_objective(pair):
    """A contact that fills the image: nothing lies 1 to 1.5 half-widths away."""
    press, capture = pair
    with pytest.raises(CompareError, match=r"no usable pixel lies 1 to 1\.5 contact half-widths from the indenter"):
        compare_press(replaced(press, distance=0.2 * press.distance), capture, seed=1)


def test_a_channel_that_contact_does_not_change_has_no_skill_of_its_own():
    press = made_up_press()
    contact = press.contact.copy()
    contact[..., 0] = press.no_contact[..., 0]
    untouched = press.model_copy(update={"contact": contact})
    rows = rows_of(compare_press(untouched, capture_of(untouched, 50.0), seed=1))
    for row in rows.values():
        assert row.skill_per_channel[0] is None
        assert row.skill_per_channel[1] is not None


def test_relative_to_the_captured_rest_a_wrong_light_field_is_not_judged():
    """Light that falls off otherwise, and other powers: the change by contact is the same, and so is the score."""
    press = made_up_press()
    capture = capture_of(press, 200.0)
    rows, columns = np.mgrid[0:60, 0:80]
    field = np.stack([1.0 + columns / 80, 0.5 + rows / 60, 3.0 - columns / 80], axis=2)
    weaker = press.no_contact + 0.7 * (press.contact - press.no_contact)
    right = press.model_copy(update={"contact": weaker})
    wrong = right.model_copy(update={n: field * getattr(right, n) for n in ("contact", "no_contact")})
    options = CheckOptions(relative=True)
    found, again = (compare_checked(one, capture, 1, options)[0] for one in (right, wrong))
    # 0.7 of the change leaves 0.3^2 of its energy
    assert found.headline_skill.estimate == pytest.approx(1.0 - 0.09, abs=0.01)
    assert again.headline_skill.estimate == pytest.approx(found.headline_skill.estimate, abs=1e-6)
    assert any("only the change by contact is judged" in note for note in again.notes)
    absolute = compare_checked(wrong, capture, 1, CheckOptions(despite_mismatch=True))[0]
    assert absolute.headline_skill.estimate < 0.0
    blank = wrong.model_copy(update={"contact": wrong.no_contact})
    assert compare_checked(blank, capture, 1, options)[0].headline_skill.estimate == pytest.approx(0.0, abs=1e-3)


def test_relative_noise_of_the_render_is_taken_out_by_its_halves(pair):
    """A rendered twin has noise in both of its images, and its score hardly changes."""
    press, capture = pair
    report, shown = compare_checked(press, capture, 1, CheckOptions(relative=True))
    assert 0.85 < report.headline_skill.estimate < 1.01
    rest = capture.no_contact.astype(np.float64) - capture.black_level_dn
    np.testing.assert_allclose(shown.no_contact, rest, rtol=1e-6)


def noisy_capture(press, noise_rel, seed, with_repeat=True):
    """Return a capture of a press in linear light whose noise is a share of the level."""
    rng = np.random.default_rng(seed)

    def counts(image):
        light = 150.0 * image
        return np.rint(16.0 + light * (1.0 + noise_rel * rng.standard_normal(light.shape))).clip(0, 65535)

    images = {n: counts(getattr(press, n)).astype(np.uint16) for n in ("contact", "no_contact")}
    repeat = counts(press.no_contact).astype(np.uint16) if with_repeat else None
    return capture_of(press, 150.0).model_copy(update=images | {"repeat_no_contact": repeat})


def test_relative_noise_of_the_captured_rest_is_taken_out():
    """Noise of 4 %: a blank scores 0, not -0.04, and a weaker press 1 - 0.3^2, whatever the noise is."""
    press = made_up_press()
    blank = press.model_copy(update={"contact": press.no_contact})
    weaker = press.model_copy(update={"contact": press.no_contact + 0.7 * (press.contact - press.no_contact)})
    options = CheckOptions(relative=True)
    scores, gradients = [], []
    for seed in range(8):
        capture = noisy_capture(press, 0.04, seed)
        nothing = compare_checked(blank, capture, seed, options)[0]
        assert nothing.headline_skill.estimate == pytest.approx(0.0, abs=1e-5)
        assert nothing.headline_skill.low95 - 1e-5 <= 0.0 <= nothing.headline_skill.high95 + 1e-5
        found = compare_checked(weaker, capture, seed, options)[0]
        scores.append(found.headline_skill.estimate)
        gradients.append(rows_of(found)["simulation"].difference_gradient_rms_per_px.estimate)
    # noise that stayed in would lower the score by (S / B)^2 x 0.04^2 / (mean square of the change, 0.23^2) = 0.03
    assert np.mean(scores) == pytest.approx(0.91, abs=0.006)
    still = compare_checked(weaker, noisy_capture(press, 0.001, 1), 1, options)[0]
    of_still = rows_of(still)["simulation"].difference_gradient_rms_per_px.estimate
    assert np.mean(gradients) == pytest.approx(of_still, rel=0.25)


@pytest.mark.parametrize("encoding", ["linear", "unknown"])
def test_a_channel_that_the_render_leaves_dark_is_told(encoding):
    """Its change is a ratio of two zeros: it scores 0, as doing nothing does, and the report says so."""
    lit = made_up_press()
    capture = capture_of(lit, 200.0 if encoding == "linear" else 1.0, encoding=encoding)
    options = CheckOptions(relative=encoding == "linear")
    dark = lit.model_copy(update={n: getattr(lit, n) * np.array([1.0, 1.0, 0.0]) for n in ("contact", "no_contact")})
    found, whole = (compare_checked(one, capture, 1, options)[0] for one in (dark, lit))
    told = [text for text in found.findings if "has no light where the capture has some (blue 100 % of the" in text]
    assert len(told) == 1
    assert not any("has no light" in text for text in whole.findings)
    red, _, blue = rows_of(found)["simulation"].skill_per_channel
    assert blue == pytest.approx(0.0, abs=1e-4)
    assert red == pytest.approx(rows_of(whole)["simulation"].skill_per_channel[0], abs=0.02)
    if encoding == "unknown":
        assert [scale is None for scale in found.tone_curve.white_balance] == [False, False, True]
        assert found.tone_curve.white_balance[0].estimate == pytest.approx(1.0, abs=0.05)


def test_relative_stands_in_the_report():
    press = made_up_press()
    capture = capture_of(press, 200.0)
    assert compare_checked(press, capture, 1, CheckOptions(relative=True))[0].relative
    assert not compare_checked(press, capture, 1)[0].relative


def test_relative_says_that_it_cannot_be_registered():
    press = made_up_press()
    with pytest.raises(CompareError, match=r"--relative and --register cannot be combined, .* leave out one of these"):
        compare_checked(press, capture_of(press, 200.0), 1, CheckOptions(registered=True, relative=True))


def test_relative_needs_linear_values():
    press = made_up_press("unknown")
    with pytest.raises(
        CompareError, match="--relative needs linear values in both records, but the encoding of strip is unknown"
    ):
        compare_checked(press, capture_of(press, 2.0, encoding="unknown"), 1, CheckOptions(relative=True))
