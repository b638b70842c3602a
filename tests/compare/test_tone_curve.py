"""A render in linear light against 8-bit captures of known curves and gains: what is found, what a blank earns."""

import cv2
import numpy as np
import pytest

from data_schemas import CompareError, DecideError, IndenterPose, PhotometricErrorReport, SimulatedPress, TactileCapture
from finray_calib.compare import CheckOptions, compare_checked, compare_press, find_mismatches
from finray_calib.compare._comparison import block_averaged_comparison
from finray_calib.compare._photometric_error import _tiles_of, square_draws
from finray_calib.compare._prepared_images import nuisances_of, prepare_images
from finray_calib.compare._region_sums import render_layers
from finray_calib.compare._tone_curve import encoded_layers, far_gain, fit_tone
from finray_calib.decide import decide
from tests.command_line.records import press as strip_press
from tests.command_line.records import sweep, with_known_camera

SHAPE = (120, 160)
RADIUS_PX = 14.0


def srgb(light):
    """IEC 61966-2-1, which is no power law."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def pad(span):
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]] / np.array(SHAPE)[:, None, None]
    return 0.1 * span ** np.stack([columns, rows, 1 - columns], axis=-1)


def distance():
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.hypot(rows - 62.0, columns - 70.0) / RADIUS_PX


def pressed(light):
    """A ball's shading: brighter on one side, darker on the other, with a halo that fades."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    across = np.stack([(columns - 70.0), (rows - 62.0), (70.0 - columns)], axis=-1) / RADIUS_PX
    return light * (1.0 + 0.5 * across * np.exp(-(distance() ** 2))[..., None])


def smooth_error(rng, size):
    field = np.stack([cv2.GaussianBlur(rng.normal(size=SHAPE), (0, 0), 20) for _ in range(3)], axis=-1)
    return np.exp(field * size / field.std())


def press_of(no_contact, contact, encoding="linear"):
    return SimulatedPress(
        name="ball", label="made up", method="rendered", encoding=encoding, no_contact=no_contact, contact=contact,
        distance=distance(), variance=None, light_angle_deg=None, design=None,
    )  # fmt: skip


def capture_of(no_contact_dn, contact_dn):
    return TactileCapture(
        name="capture", contact=contact_dn, no_contact=no_contact_dn, repeat_no_contact=None, layout="RGB",
        encoding="unknown", bit_depth=8, black_level_dn=0.0, exposure_s=None, light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=2.0, depth_mm=None, position_mm=None), contact_circle=None,
        mm_per_px=None, source="test",
    )  # fmt: skip


def eight_bit(encoded, rng):
    return np.rint(255 * encoded + rng.normal(0, 1.0, encoded.shape)).clip(0, 255).astype(np.uint16)


def pair(seed, span=3.0, error=0.05, gain=(1.0, 1.0, 1.0)):
    """Return a render whose light is wrong by a smooth field, and its capture through sRGB with a white balance."""
    rng = np.random.default_rng(seed)
    light = pad(span)
    balance = 0.6 * np.array([1.0, 0.8, 1.3]) / light.max()
    wrong = smooth_error(rng, error)
    no_contact = eight_bit(srgb(light * balance), rng)
    contact = eight_bit(srgb(pressed(light) * balance * np.array(gain)), rng)
    return press_of(light * wrong, pressed(light) * wrong), capture_of(no_contact, contact)


def test_a_render_in_linear_light_meets_an_encoded_capture():
    for seed in range(3):
        press, capture = pair(seed)
        report, shown = compare_checked(press, capture, 1)
        assert report.values == "encoded values, through a fitted tone curve"
        assert report.headline_skill.estimate > 0.95
        assert report.headline_skill.low95 <= report.headline_skill.estimate <= report.headline_skill.high95
        assert 0.0 < report.tone_curve.skill_u < 0.05
        # as code values, beside the capture's: the pictures of the page
        assert shown.encoding == "unknown"
        assert np.abs(shown.no_contact - capture.no_contact).max() < 1e-3
        red, green, blue = report.tone_curve.white_balance
        assert green.estimate == 1.0
        assert red.low95 < 1 / 0.8 < red.high95
        assert blue.low95 < 1.3 / 0.8 < blue.high95
        assert PhotometricErrorReport.model_validate(report.model_dump()).tone_curve.exponent.estimate > 0.0


@pytest.mark.parametrize("span", [1.2, 3.0])
def test_a_blank_earns_exactly_nothing_whatever_the_curve(span):
    press, capture = pair(0, span)
    blank = press.model_copy(update={"contact": press.no_contact})
    report = compare_press(blank, capture, seed=1)
    for region in report.regions:
        row = next(row for row in region.rows if row.candidate == "simulation")
        assert (row.skill.estimate, row.skill.low95, row.skill.high95) == (0.0, 0.0, 0.0)


def test_a_gain_common_to_both_images_of_the_render_changes_nothing():
    press, capture = pair(1)
    brighter = press.model_copy(update={"contact": 4 * press.contact, "no_contact": 4 * press.no_contact})
    first, second = (compare_press(p, capture, seed=1) for p in (press, brighter))
    assert second.headline_skill.estimate == pytest.approx(first.headline_skill.estimate, abs=1e-5)
    assert any("a gain common to both captured images" in note for note in first.notes)


def test_the_contact_is_not_used_for_the_curve():
    press, capture = pair(2)
    other = capture.model_copy(update={"contact": capture.no_contact[::-1].copy()})
    first, second = (compare_press(press, c, seed=1).tone_curve for c in (capture, other))
    assert first.exponent == second.exponent
    np.testing.assert_array_equal(first.draws, second.draws)


@pytest.mark.parametrize("kind", ["power", "sRGB", "linear"])
@pytest.mark.parametrize(("span", "error"), [(1.5, 0.05), (4.0, 0.05), (4.0, 0.2)])
def test_the_interval_of_the_exponent_holds_the_true_one(kind, span, error):
    """40 pads of each kind and error: 95 % intervals miss at most 7 with probability 0.9995 at the nominal rate."""
    held = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        light = pad(span) * np.exp(rng.normal(0, 0.2, 3))
        light *= 0.85 / light.max()
        power = {"power": rng.normal(0.45, 0.05), "linear": 1.0, "sRGB": None}[kind]
        counts = eight_bit(srgb(light) if power is None else light**power, rng).astype(float)
        mean = counts.mean()
        if power is None:
            at = ((mean / 255 + 0.055) / 1.055) ** 2.4
            power = float(np.log(srgb(1.001 * at) / srgb(0.999 * at)) / np.log(1.001 / 0.999))
        everywhere = np.ones(SHAPE, dtype=bool)
        tone = fit_tone(light * smooth_error(rng, error), counts, everywhere, 255.0, np.random.default_rng(1))
        # exponents of curves with different offsets compare by their slope at the mean level
        slope = tone.draws[:, 0] * (mean - tone.draws[:, 1]) / mean
        low, high = np.quantile(slope, (0.025, 0.975))
        held += low <= power <= high
    assert held >= 33


def test_a_pad_without_contrast_keeps_what_is_known_of_cameras():
    flat = np.full((*SHAPE, 3), 0.3)
    counts = eight_bit(np.full((*SHAPE, 3), 0.6), np.random.default_rng(0)).astype(float)
    tone = fit_tone(flat, counts, np.ones(SHAPE, dtype=bool), 255.0, np.random.default_rng(0))
    slope = tone.draws[:, 0] * (counts.mean() - tone.draws[:, 1]) / counts.mean()
    assert 0.1 < slope.std() < 0.35
    assert 0.4 < np.median(slope) < 0.6


def test_where_the_render_is_black_nothing_is_said():
    press, capture = pair(0)
    dark = press.no_contact.copy()
    dark[:, :5] = 0.0
    layers = render_layers(press.model_copy(update={"no_contact": dark}))
    shown = encoded_layers(layers, capture.no_contact.astype(float), 0.45, 0.0)
    np.testing.assert_array_equal(shown.contact[:, :5], capture.no_contact[:, :5])


GAINS = [(1.0, 1.0, 1.06), (0.94, 1.0, 1.0), (1.0, 1.08, 1.0), (0.93, 1.0, 1.08)]


@pytest.mark.parametrize("gain", GAINS)
def test_a_gain_of_one_channel_is_seen_and_taken_out(gain):
    press, capture = pair(3, gain=gain)
    report, _ = compare_checked(press, capture, 1)
    drift, p = report.white_balance, report.tone_curve.exponent.estimate
    assert drift.corrected
    for c in range(3):
        # a gain of light is its power in the values: sRGB is one nearly
        assert np.log(drift.gains[c]) == pytest.approx(p * np.log(gain[c]), abs=max(0.004, 3 * drift.u_rel[c]))
    assert any("times as bright as its no-contact image in" in finding for finding in report.findings)
    clean, _ = compare_checked(*pair(3), 1)
    assert report.headline_skill.estimate == pytest.approx(clean.headline_skill.estimate, abs=0.02)


@pytest.mark.parametrize("encoding", ["linear", "unknown"])
def test_draws_at_the_pixels_of_the_region_are_those_of_whole_images(encoding):
    """Sums over tiles for draws of curve and gains, against images formed whole and squared one by one."""
    press, capture = pair(3, gain=(0.94, 1.0, 1.06))
    if encoding == "unknown":
        rest = capture.no_contact.astype(np.float32)
        press = press_of(rest, rest * (press.contact / press.no_contact) ** 0.45, "unknown")
    _, comparison = block_averaged_comparison(prepare_images(press, capture), capture)
    assert comparison.nuisances.is_corrected
    tiles = [_tiles_of(sums) for sums in comparison.sums]
    found = square_draws(comparison, comparison.nuisances, tiles, np.random.default_rng(1))
    nuisances, rng = comparison.nuisances, np.random.default_rng(1)
    if nuisances.tone is None:
        layers, best = nuisances.best()
        whole = ((layers, factors * best) for factors in nuisances.factor_draws(rng))
    else:
        whole = nuisances.drawn(nuisances.tone, rng)
    rest = comparison.captured.no_contact
    for of_regions, (layers, contact) in zip(found, whole, strict=True):
        shown = layers.contact.astype(float)
        squares = {"error": (shown - contact) ** 2, "signal": (rest - contact) ** 2, "level": contact}
        for region, sums, of in zip(of_regions, comparison.sums, tiles, strict=True):
            for name, square in squares.items():
                # only rounding differs: of products, and of sums that leave little of their terms, some 1e4 a pixel
                np.testing.assert_allclose(region[name], of.sums(square[sums.where]), rtol=1e-10, atol=1e-9)


def test_a_blank_with_the_gain_of_the_capture_earns_nothing():
    """An encoded prediction that is the untouched image with the capture's gain, and the same in light."""
    gain = np.array([0.93, 1.0, 1.08])
    press, capture = pair(4, gain=tuple(gain))
    untouched = capture.no_contact.astype(np.float32)
    of_values = np.exp(far_gain(*_images(press, capture), distance(), 255.0).log_captured)
    encoded = press_of(untouched, untouched * of_values.astype(np.float32), "unknown")
    light = press_of(press.no_contact, press.no_contact * gain)
    for blank in (encoded, light):
        report, _ = compare_checked(blank, capture, 1)
        assert report.white_balance.corrected
        assert report.headline_skill.estimate < 0.01
        # uncorrected it would have explained the drift
        naive = ((untouched * of_values - capture.contact)[distance() <= 2] ** 2).sum()
        assert naive < 0.9 * ((untouched - capture.contact)[distance() <= 2] ** 2.0).sum()


def _images(press, capture):
    captured = capture.contact.astype(float), capture.no_contact.astype(float)
    return captured, (captured[1], captured[1])


def test_a_gain_that_is_too_large_is_refused():
    press, capture = pair(5, gain=(1.0, 1.0, 0.55))
    with pytest.raises(CompareError, match=r"0\.7\d\d times as bright as its no-contact image in blue"):
        compare_checked(press, capture, 1)
    report, _ = compare_checked(press, capture, 1, CheckOptions(despite_mismatch=True))
    assert report.forced_mismatch
    assert not report.white_balance.corrected


def test_a_change_across_the_picture_is_no_gain():
    press, capture = pair(6)
    ramp = 1.0 + 0.1 * np.linspace(0.0, 2.0, SHAPE[1])[None, :, None]
    uneven = np.rint(capture.contact * ramp).clip(0, 255).astype(np.uint16)
    with pytest.raises(CompareError, match=r"across the picture it changes by \d+\.\d %, so it is not a gain"):
        compare_checked(press, capture.model_copy(update={"contact": uneven}), 1)


def test_the_same_pairs_without_a_gain_raise_no_alarm():
    """Twenty pairs; the alarm stands at 1 % and at three standard uncertainties, noise of the blocks is 0.05 %."""
    for seed in range(20):
        press, capture = pair(seed)
        assert not nuisances_of(press, capture).is_corrected
        assert not [f for f in find_mismatches(press, capture) if f.about == "exposure"]


def test_an_effect_of_the_touch_that_reaches_far_is_no_gain():
    """A change that fades with the distance is not taken out."""
    press, capture = pair(7)
    fading = 1.0 - 0.06 * np.exp(-np.maximum(distance() - 3.0, 0.0))[..., None]
    report, _ = compare_checked(
        press, capture.model_copy(update={"contact": np.rint(capture.contact * fading).astype(np.uint16)}), 1
    )
    assert not report.white_balance.corrected


def test_without_a_surround_it_says_that_it_cannot_tell():
    press, capture = pair(0)
    near = press.model_copy(update={"distance": press.distance / 4.0})
    report = compare_press(near, capture, seed=1)
    assert report.white_balance is None
    assert any(
        "it is not known whether exposure or white balance changed between the captures" in n for n in report.notes
    )


def test_clipped_pixels_are_told_channel_by_channel():
    press, capture = pair(0)
    clipped = capture.contact.copy()
    inside = distance() <= 1
    bright = inside & (np.arange(SHAPE[1]) < 70)
    clipped[..., 2][bright] = np.random.default_rng(0).integers(250, 255, bright.sum())
    report, _ = compare_checked(press, capture.model_copy(update={"contact": clipped}), 1)
    told = next(f for f in report.findings if "of the contact patch lies at" in f)
    assert "blue 4" in told or "blue 5" in told
    assert "red 0.0 %" in told


@pytest.mark.parametrize("brighter", [0.0, 0.05])
def test_a_decision_takes_the_error_through_the_curve(brighter):
    """Light beside the strip that is 5 % brighter than the render's shows as its error, within its interval."""
    press = with_known_camera(strip_press())
    light = np.stack([press.no_contact, press.contact]) * 0.8 / press.no_contact.max()
    beside = 1.0 + brighter * ((press.distance > 0.9) & (press.distance < 1.6))[..., None]
    rng = np.random.default_rng(5)
    images = [eight_bit(srgb(image * np.array([0.9, 1.0, 0.7])), rng) for image in (light[0], light[1] * beside)]
    capture = capture_of(*images).model_copy(
        update={
            "light_angle_deg": 30.0,
            "indenter": IndenterPose(shape="cylinder", radius_mm=10.0, depth_mm=1.5, position_mm=None),
        }
    )
    report = compare_press(press, capture, seed=1)
    error = report.objective_error
    assert error.error_rel.estimate == pytest.approx(-brighter / (1 + brighter), abs=0.012)
    assert error.error_rel.low95 <= -brighter / (1 + brighter) <= error.error_rel.high95
    assert error.log_exposure_draws is None
    assert decide(sweep(), [report], 1).validated
    # without draws of its inputs a render is still compared, but says nothing for a decision
    without = compare_press(strip_press(), capture, seed=1)
    assert without.objective_error is None
    with pytest.raises(DecideError, match="because the render has no draws of its paints and camera"):
        decide(sweep(), [without], 1)
