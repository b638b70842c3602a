"""From press and capture to the report: blocks, clipping, brightness beside the indenter."""

import numpy as np
import pytest

from data_schemas.errors import CompareError
from finray_calib.compare.blocks import block_mean, block_side_px
from finray_calib.compare.brightness import brightness_beside_contact, brightness_error
from finray_calib.compare.comparison_record import DILATED, compare_press
from tests.command_line.records import capture_of
from tests.command_line.records import press as press_record


def test_block_mean_is_the_mean_and_keeps_nan_to_its_block():
    image = np.arange(48.0).reshape(6, 8)
    image[0, 0] = np.nan
    means = block_mean(image, 2)
    assert means.shape == (3, 4)
    assert np.isnan(means[0, 0])
    assert means[2, 3] == image[4:6, 6:8].mean()
    assert block_mean(image[:5, :7], 2).shape == (2, 3)
    assert block_mean(image, 1) is image


@pytest.mark.parametrize(("noise_rel", "side"), [(0.02, 1), (0.05, 2), (0.11, 4), (0.2, 8), (5.0, 8)])
def test_block_is_as_large_as_the_noise_asks_for(noise_rel, side):
    level = np.full((16, 16, 3), 4.0)
    variance = np.broadcast_to((noise_rel * 4.0) ** 2 * np.array([1.0, 0.25, 0.04]), level.shape)
    everywhere = np.ones((16, 16), bool)
    assert block_side_px(level, variance, everywhere) == side
    assert block_side_px(level, None, everywhere) == 1


def test_brightness_is_white_balanced_and_taken_in_the_ring():
    distance = np.array([[0.0, 1.0, 1.5, 1.6, np.nan]])
    image = np.array([[[9.0, 9, 9], [2, 20, 200], [4, 40, 400], [9, 9, 9], [9, 9, 9]]])
    white = np.array([1.0, 10.0, 100.0])
    assert brightness_beside_contact(image, distance, white) == pytest.approx(3.0)
    with pytest.raises(CompareError, match=r"no usable pixel lies 1 to 1\.5 contact half-widths"):
        brightness_beside_contact(np.full_like(image, np.nan), distance, white)


def test_brightness_error_and_its_uncertainty():
    distance = np.linspace(0.0, 3.0, 31)[None, :]
    captured = np.full((1, 31, 3), 100.0)
    error = brightness_error(1.1 * captured, captured, captured, 1.02 * captured, distance, 0.01)
    assert error.error_rel == pytest.approx(0.1)
    assert error.sd_rel == pytest.approx(np.hypot(0.02 / np.sqrt(2), 0.01))
    assert brightness_error(captured, captured, captured, None, distance, np.nan).sd_rel == 0.0


def test_clipped_pixels_are_counted():
    press = press_record()
    capture = capture_of(press, 50.0)
    clean = next(r for r in compare_press(press, capture, 1).regions if r.region == DILATED)
    assert clean.clipped_fraction == 0.0
    contact = capture.contact.copy()
    contact[20:26, 38:42] = 2**16 - 1
    clipped = compare_press(press, capture.model_copy(update={"contact": contact}), 1)
    region = next(r for r in clipped.regions if r.region == DILATED)
    assert region.clipped_fraction == pytest.approx(24 / (clean.pixels))
    assert region.pixels == clean.pixels - 24
