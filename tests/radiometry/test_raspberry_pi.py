import cv2
import numpy as np
import pytest

from data_schemas import ImportFormatError
from data_schemas.storage import rggb_frame
from finray_calib.radiometry import (
    capture_settings,
    parse_tuning,
    processed_signal,
    raw_signal,
    require_same_settings,
    shading_gains,
)
from finray_calib.radiometry._raspberry_pi import JPEG_CODES, LUMA
from tests.radiometry.libcamera_documents import metadata, version_2

FIXED = parse_tuning(version_2(contrast_adapts=False))
ADAPTING = parse_tuning(version_2())
SETTINGS = capture_settings(metadata(), "contact.png")


def camera_image(seed=1):
    """Smooth camera values whose processed image stays inside its gamut (0..0.4 of full scale)."""
    rng = np.random.default_rng(seed)
    smooth = cv2.GaussianBlur(rng.standard_normal((60, 80, 3)), (0, 0), 12)
    return 0.2 + 0.02 * smooth / smooth.std()


def process(camera, tuning, settings, stretch=None):
    """The camera's chain of the documentation: gains, colour matrix, (stretch,) tone curve, 8 bits."""
    gains = np.array([settings.red_gain_factor, 1.0, settings.blue_gain_factor])
    linear = (camera * gains) @ settings.colour_matrix.T
    linear = np.clip(linear if stretch is None else stretch(linear), 0, 1)
    encoded = np.interp(linear, tuning.tone_curve[:, 0], tuning.tone_curve[:, 1])
    return np.rint(255 * encoded).astype(np.uint8)


def test_a_processed_image_returns_to_camera_values_within_its_uncertainty():
    camera = camera_image()
    estimate = processed_signal(process(camera, FIXED, SETTINGS), FIXED, SETTINGS, undo_colour=True)
    score = (estimate.values_rel - camera) / estimate.sd_rel
    # Here only rounding is at work, which is part of what is carried: far inside, and without bias.
    assert np.abs(score).max() < 3.0
    assert abs(np.mean(score)) < 0.1
    # Rounding alone is 0.29 of the 1.04 codes carried.
    assert np.std(score) < 0.5
    assert estimate.steps[-1] == "colour matrix and white-balance gains were undone"
    assert 0.005 < estimate.typical_uncertainty_rel() < 0.1


def test_without_undoing_colours_the_tone_curve_alone_is_inverted():
    camera = camera_image()
    gains = np.array([SETTINGS.red_gain_factor, 1.0, SETTINGS.blue_gain_factor])
    mixture = (camera * gains) @ SETTINGS.colour_matrix.T
    estimate = processed_signal(process(camera, FIXED, SETTINGS), FIXED, SETTINGS)
    # The slope of the inverse curve is below 2.2 on 0..1, so half a code is 0.0043 at most.
    np.testing.assert_allclose(estimate.values_rel, mixture, atol=0.5 / 255 * 2.3)


def test_the_contrast_stretch_lies_within_the_carried_uncertainty():
    """libcamera's stretch at its limits: 500 of 65535 pulled down, 2000 pushed up, median kept."""
    camera = camera_image()
    gains = np.array([2.0, 1.0, 1.5])
    median = np.median((camera * gains) @ SETTINGS.colour_matrix.T @ LUMA)
    knots = np.array([0, 0.015 + 500 / 65535, median, 0.95 - 2000 / 65535, 1])

    def stretch(linear):
        return np.interp(linear, knots, [0, 0.015, median, 0.95, 1])

    codes = process(camera, ADAPTING, SETTINGS, stretch)
    carried = processed_signal(codes, ADAPTING, SETTINGS, undo_colour=True)
    ignored = processed_signal(codes, FIXED, SETTINGS, undo_colour=True)
    # The largest stretch is sqrt(3) sd; rounding comes on top.
    assert np.abs((carried.values_rel - camera) / carried.sd_rel).max() < 2.5
    assert (carried.sd_rel > ignored.sd_rel).all()
    assert any("ce_enable" in step for step in carried.steps)
    assert not any("ce_enable" in step for step in ignored.steps)


def test_jpeg_costs_what_is_carried_for_it():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:240, 0:320]
    smooth = np.stack([120 + 40 * np.sin(x / 60), 100 + 30 * np.cos(y / 50), 90 + 50 * np.sin((x + y) / 80)], axis=-1)
    noisy = np.clip(np.rint(smooth + 1.5 * rng.standard_normal(smooth.shape)), 0, 255).astype(np.uint8)
    _, stored = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 93])
    lost = (cv2.imdecode(stored, cv2.IMREAD_COLOR).astype(float) - noisy).std()
    assert 0.5 * JPEG_CODES < lost < JPEG_CODES
    one = processed_signal(noisy, FIXED, SETTINGS)
    other = processed_signal(noisy, FIXED, SETTINGS, compressed=True)
    assert (other.sd_rel > one.sd_rel).all()


def test_clipped_codes_are_lost():
    codes = np.full((4, 4, 3), 100, np.uint8)
    codes[0, 0, 0] = 255
    codes[1, 1, 2] = 0
    codes[2, 2] = 0
    plain = processed_signal(codes, FIXED, SETTINGS).values_rel
    assert np.argwhere(np.isnan(plain)).tolist() == [[0, 0, 0]]
    assert plain[1, 1, 2] == 0
    undone = processed_signal(codes, FIXED, SETTINGS, undo_colour=True).values_rel
    # One channel clipped spoils the mixture; a pixel that is black in all channels is dark.
    assert np.argwhere(np.isnan(undone).all(axis=-1)).tolist() == [[0, 0], [1, 1]]
    np.testing.assert_allclose(undone[2, 2], 0, atol=1e-12)
    assert np.isnan(processed_signal(0 * codes, FIXED, SETTINGS).typical_uncertainty_rel())


def test_the_matrix_of_the_metadata_comes_before_that_of_the_tuning():
    camera = camera_image()
    codes = process(camera, FIXED, SETTINGS)
    by_temperature = capture_settings(metadata(ColourCorrectionMatrix=None), "contact.png")
    # The tuning's matrix at 4000 K is the mean of its two, which is the one in the metadata.
    one = processed_signal(codes, FIXED, SETTINGS, undo_colour=True)
    other = processed_signal(codes, FIXED, by_temperature, undo_colour=True)
    np.testing.assert_allclose(one.values_rel, other.values_rel, rtol=1e-9)
    neither = capture_settings(metadata(ColourCorrectionMatrix=None, ColourTemperature=None), "contact.png")
    with pytest.raises(ImportFormatError, match=r"has neither ColourCorrectionMatrix nor ColourTemperature"):
        processed_signal(codes, FIXED, neither, undo_colour=True)
    grey = capture_settings(metadata(ColourCorrectionMatrix=[0.3, 0.6, 0.1] * 3), "contact.png")
    with pytest.raises(ImportFormatError, match=r"cannot be inverted \(saturation 0\?\)"):
        processed_signal(codes, FIXED, grey, undo_colour=True)


def test_a_tuning_without_tone_curve_is_refused():
    document = version_2()
    document["algorithms"] = [a for a in document["algorithms"] if "rpi.contrast" not in a]
    with pytest.raises(ImportFormatError, match=r"has no rpi.contrast gamma_curve"):
        processed_signal(np.zeros((2, 2, 3), np.uint8), parse_tuning(document), SETTINGS)


@pytest.mark.parametrize("order", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_every_bayer_order_is_cut_to_begin_with_red(order):
    value = {"R": 1, "G": 2, "B": 3}
    cell = np.array([value[c] for c in order], np.uint16).reshape(2, 2)
    frame = rggb_frame(np.tile(cell, (4, 5)), order)
    assert frame.shape[0] % 2 == frame.shape[1] % 2 == 0
    assert frame[:2, :2].tolist() == [[1, 2], [2, 3]]


def test_raw_counts_lose_black_level_and_shading():
    shading = FIXED.shading
    gains = shading_gains(shading, 4000.0, (24, 32))
    flat = 0.1 * np.array([3.0, 2.0, 1.0])  # red, green, blue of a uniform field
    channel = np.tile([[0, 1], [1, 2]], (12, 16))
    shaded = (flat / gains).reshape(-1, 3)[np.arange(24 * 32), channel.ravel()].reshape(24, 32)
    counts = np.rint(4096 * (shaded + FIXED.black_level_rel[0])).astype(np.uint16)
    counts[0, 0] = 4095
    signal = raw_signal(counts, 12, FIXED.black_level_rel, gains)
    assert np.isnan(signal[0, 0])
    # Half a count of 4096, times the largest gain.
    np.testing.assert_allclose(signal.ravel()[1:], flat[channel].ravel()[1:], atol=0.5 / 4096 * gains.max() * 1.01)
    unflattened = raw_signal(counts, 12, np.array([0.0625, 0.0625, 0.03125]))
    np.testing.assert_allclose(unflattened[1::2, 1::2], counts[1::2, 1::2] / 4096 - 0.03125, rtol=1e-12)


def test_settings_are_read_in_seconds_and_fractions():
    assert SETTINGS.exposure_s == pytest.approx(0.01, rel=1e-12)
    assert (SETTINGS.red_gain_factor, SETTINGS.blue_gain_factor, SETTINGS.temperature_k) == (2.0, 1.5, 4000.0)
    np.testing.assert_allclose(SETTINGS.black_level_rel, 64 / 1024, rtol=1e-12)
    bare = capture_settings(metadata(DigitalGain=None, SensorBlackLevels=None, AeState=None), "contact.png")
    assert bare.digital_gain_factor == 1.0
    assert bare.black_level_rel is None
    assert capture_settings(metadata(AeEnable=False, AwbEnable=False), "contact.png").exposure_s == SETTINGS.exposure_s


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"AeEnable": True}, r"contact.png: auto exposure was on \(AeEnable = True\).*--shutter --gain --awbgains"),
        ({"AwbEnable": True}, r"auto white balance was on \(AwbEnable = True\)"),
        ({"ExposureTimeMode": 0}, r"auto exposure was on \(ExposureTimeMode = 0\)"),
        ({"AnalogueGainMode": 0}, r"auto gain was on"),
        ({"AeState": 2}, r"auto exposure \(AeState 1 searching, 2 converged\) was on \(AeState = 2\)"),
        ({"ExposureTime": None}, r"its metadata has no ExposureTime, so its exposure is not known"),
        ({"ColourGains": None}, r"its metadata has no ColourGains"),
        ({"ColourGains": [1.0]}, r"ColourGains is \[1.0\], but must be 2 finite number\(s\) above 0"),
        ({"AnalogueGain": "high"}, r"AnalogueGain is 'high', but must be 1 finite number"),
        ({"ColourCorrectionMatrix": [1.0] * 8}, r"ColourCorrectionMatrix is .*must be 9 finite number\(s\)$"),
    ],
)
def test_automatic_or_incomplete_captures_are_refused(changes, message):
    with pytest.raises(ImportFormatError, match=message):
        capture_settings(metadata(**changes), "contact.png")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ExposureTime": 10_050}, r"ExposureTime is 0.01 s in a.png, but 0.01005 s in b.png"),
        ({"ColourGains": [2.0, 1.6]}, r"ColourGains \(blue\) is 1.5 +in a.png, but 1.6 +in b.png"),
        ({"AnalogueGain": 1.1}, r"AnalogueGain is .*, but"),
    ],
)
def test_settings_that_differ_are_refused(changes, message):
    one, other = capture_settings(metadata(), "a.png"), capture_settings(metadata(**changes), "b.png")
    with pytest.raises(ImportFormatError, match=message):
        require_same_settings({"a.png": one, "b.png": other})
    require_same_settings({"a.png": one, "b.png": capture_settings(metadata(ExposureTime=10_001), "b.png")})


@pytest.mark.parametrize("level", [-1, 65536])
def test_a_black_level_beyond_sixteen_bits_is_refused(level):
    with pytest.raises(
        ImportFormatError, match=r"contact\.dng: SensorBlackLevels is .*, but black levels must be 0 to 65535"
    ):
        capture_settings(metadata(SensorBlackLevels=[4096, 4096, 4096, level]), "contact.dng")
