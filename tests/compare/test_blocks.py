"""Blocks of pixels: their means, and how large they may be."""

import numpy as np
import pytest

from finray_calib.compare._image_noise import CaptureNoise, block_mean, largest_block_px
from finray_calib.compare._prepared_images import prepare_images
from tests.compare.layered_scenes import captured_of
from tests.compare.twins import SHAPE, distance_map, twin


def test_block_mean_is_the_mean_and_keeps_nan_to_its_block():
    image = np.arange(48.0).reshape(6, 8)
    image[0, 0] = np.nan
    means = block_mean(image, 2)
    assert means.shape == (3, 4)
    assert np.isnan(means[0, 0])
    assert np.isfinite(means).sum() == 11
    assert means[2, 3] == image[4:6, 6:8].mean()
    assert block_mean(image[:5, :7], 2).shape == (2, 3)
    assert block_mean(np.stack([image, -image], axis=2), 2)[2, 3].tolist() == [means[2, 3], -means[2, 3]]
    assert block_mean(image, 1) is image


@pytest.mark.parametrize(("half_width_px", "side"), [(2.0, 1), (7.9, 1), (8.1, 2), (15.9, 2), (33.0, 8)])
def test_blocks_reach_a_quarter_of_the_half_width(half_width_px, side):
    rows = np.abs(np.arange(120.0)[:, None] - 60.0) / half_width_px
    assert largest_block_px(np.broadcast_to(rows, (120, 40))) == side


def test_of_a_disc_the_radius_counts():
    rows, columns = np.mgrid[:121, :121]
    distance = np.hypot(rows - 60.0, columns - 60.0) / 20.0
    distance[:, :10] = np.nan
    # the slope of a cone is the same everywhere; 20 px: a quarter is 5, the next power of two below 4
    assert largest_block_px(distance) == 4


@pytest.mark.parametrize("distance", [np.full((20, 20), np.nan), np.full((20, 20), 5.0), np.ones((20, 20))])
def test_without_a_contact_in_sight_pixels_stay(distance):
    assert largest_block_px(distance) == 1


def test_blocks_of_a_capture_have_less_noise():
    """Means over 4 x 4 px: a sixteenth of the variance at the same level."""
    rng = np.random.default_rng(0)
    noise = CaptureNoise(np.full(3, 4.0), np.full(3, 0.2))
    flat = np.full((200, 200, 3), 100.0)
    noisy = flat + np.sqrt(24.0) * rng.standard_normal(flat.shape)
    blocked = captured_of(noisy, flat, noise=noise).blocked(4)
    assert blocked.variance(blocked.no_contact) == pytest.approx(np.full((50, 50, 3), 24.0 / 16.0))
    # four standard errors of a variance of 7500 blocks
    assert (blocked.contact - 100.0).var() == pytest.approx(1.5, rel=4.0 * np.sqrt(2.0 / 7500.0))
    assert blocked.repeat is None
    assert captured_of(noisy, flat, flat).blocked(4).repeat.shape == (50, 50, 3)


def test_a_clipped_pixel_takes_its_block_along():
    made = twin(np.random.default_rng(0))
    contact = made.capture.contact.copy()
    contact[9, 14, 1] = 4095
    images = prepare_images(made.press, made.capture.model_copy(update={"contact": contact}))
    assert images.clipped.sum() == 1
    # missing in one image means missing in all
    for image in (images.captured.contact, images.captured.no_contact, images.captured.repeat):
        assert np.isnan(image).all(axis=2).sum() == 1
        assert np.isnan(image[9, 14]).all()
    blocked = images.blocked(2)
    assert blocked.block_px == 2
    assert np.argwhere(blocked.clipped).tolist() == [[4, 7]]
    assert np.isnan(blocked.captured.contact[4, 7]).all()
    assert blocked.layers.contact.shape == (SHAPE[0] // 2, SHAPE[1] // 2, 3)
    assert blocked.distance[0, 0] == pytest.approx(distance_map()[:2, 0].mean(), rel=1e-6)


def test_block_mean_of_channels_has_the_digits_of_numpy():
    image = np.random.default_rng(2).random((41, 38, 3))
    for side in (2, 3, 8):
        rows, columns = 41 // side, 38 // side
        cut = image[: rows * side, : columns * side].reshape(rows, side, columns, side, 3)
        np.testing.assert_array_equal(block_mean(image, side), cut.mean(axis=(1, 3)))
