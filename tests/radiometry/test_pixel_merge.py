"""Exposure brackets merged pixel by pixel: bias, stated variance, saturation, streaming."""

import numpy as np
import pytest

from data_schemas import RegionOfInterest
from finray_calib.radiometry._step_signals import DarkMap, dark_map, merge_pixels
from tests.radiometry.sessions import CAMERA, SIDE_PX, frame, synthetic_session

AREA = RegionOfInterest(row_px=0, column_px=0, height_px=256, width_px=256)
EXPOSURES_S = (0.01, 0.04)
NO_OFFSET = DarkMap(
    offset_dn=np.zeros((256, 256), np.float32),
    offset_variance_dn2=0.0,
    level_dn={t: [16.0] * 4 for t in EXPOSURES_S},
    thermal_dn=dict.fromkeys(EXPOSURES_S, 0.0),
)
PIXELS = AREA.height_px * AREA.width_px


def bracket(dn_per_s: float, exposures_s: tuple[float, ...], dark_e_per_s: float = 0.0):
    """Frames of one even light, with the noise of the camera."""
    rng = np.random.default_rng(int(dn_per_s))
    images = {}
    for i, t in enumerate(exposures_s):
        gain = CAMERA.gain_e_per_dn
        electrons = rng.poisson((dn_per_s * gain + dark_e_per_s) * t, (256, 256))
        electrons = electrons + CAMERA.read_noise_e * rng.standard_normal((256, 256))
        counts = np.clip(np.rint(electrons / gain + CAMERA.black_level_dn), 0, 1023).astype(np.uint16)
        images[f"frames/{i:04d}.tiff"] = counts
    frames = [frame(i, name, "white", "450", t) for i, (name, t) in enumerate(zip(images, exposures_s, strict=True))]
    return frames, lambda f: images[f.file]


@pytest.mark.parametrize("dn_per_s", [200.0, 2_000.0, 20_000.0])
def test_merged_pixels_are_unbiased_and_as_noisy_as_stated(dn_per_s):
    frames, read = bracket(dn_per_s, (0.04, 0.01))
    merged = merge_pixels(frames, read, AREA, NO_OFFSET, CAMERA)
    sd = np.sqrt(merged.variance.mean())
    assert merged.signal_dn_per_s.mean() == pytest.approx(dn_per_s, abs=5 * sd / np.sqrt(PIXELS))
    # a variance of 65536 values is known to 0.6 %
    assert merged.signal_dn_per_s.var() == pytest.approx(float(merged.variance.mean()), rel=0.03)
    alone = merge_pixels(frames[:1], read, AREA, NO_OFFSET, CAMERA)
    assert merged.variance.mean() < alone.variance.mean()


def test_pixel_that_saturates_in_the_long_exposure_is_taken_from_the_short_one():
    frames, read = bracket(60_000.0, (0.04, 0.01))  # 2400 DN and 600 DN
    assert (read(frames[0]) == 1023).all()
    merged = merge_pixels(frames, read, AREA, NO_OFFSET, CAMERA)
    short = merge_pixels(frames[1:], read, AREA, NO_OFFSET, CAMERA)
    np.testing.assert_array_equal(merged.signal_dn_per_s, short.signal_dn_per_s)
    np.testing.assert_array_equal(merged.variance, short.variance)
    lost = merge_pixels(frames[:1], read, AREA, NO_OFFSET, CAMERA)
    assert np.isnan(lost.signal_dn_per_s).all()
    assert np.isnan(lost.variance).all()


def test_dark_current_adds_its_shot_noise():
    dark_e_per_s = 5.0 * CAMERA.gain_e_per_dn / 8.0  # 5 DN in 8 s
    frames, read = bracket(1.0, (8.0,), dark_e_per_s)
    dark = DarkMap(np.zeros((256, 256), np.float32), 0.0, {8.0: [21.0] * 4}, {8.0: 5.0})
    merged = merge_pixels(frames, read, AREA, dark, CAMERA)
    assert merged.signal_dn_per_s.var() == pytest.approx(float(merged.variance.mean()), rel=0.03)


def test_dark_map_finds_each_pixels_offset():
    offset = np.random.default_rng(1).integers(-3, 4, (SIDE_PX, SIDE_PX))

    def change(frames, images):
        for f in frames:
            images[f.file] = (images[f.file] + offset).astype(np.uint16)
        return frames

    synthetic = synthetic_session(np.random.default_rng(2), change=change)
    area = RegionOfInterest(row_px=0, column_px=0, height_px=SIDE_PX, width_px=SIDE_PX)
    dark = dark_map(synthetic.session, synthetic.read, area)
    off = dark.offset_dn - offset
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        site = off[row::2, column::2] + offset[row::2, column::2].mean()
        # 1024 values of an averaged noise: their spread is known to 2.2 %
        assert site.std() == pytest.approx(np.sqrt(dark.offset_variance_dn2), rel=0.15)
        assert abs(site.mean()) < 0.05
