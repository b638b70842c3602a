import colour
import numpy as np
import pytest

from data_schemas import CompareError
from finray_calib.compare._displayed_images import (
    PIXELS_PER_DEGREE,
    display_white_dn,
    displayed_image,
    flip_errors,
    flip_mean,
    perceived_image,
)


def test_linear_light_goes_through_the_curve_of_srgb():
    light = np.linspace(0, 1, 3000).reshape(-1, 10, 3)
    # colour-science, same standard
    assert displayed_image(400 * light, 400.0, linear=True) == pytest.approx(colour.cctf_encoding(light), abs=1e-12)


def test_encoded_values_are_shown_as_they_are_and_everything_is_clipped():
    image = np.array([[[-5.0, 51.0, 300.0], [np.nan, 0.0, 255.0]]])
    shown = displayed_image(image, 255.0, linear=False)
    assert shown[0, 0].tolist() == [0.0, 0.2, 1.0]
    assert np.isnan(shown[0, 1, 0])
    assert shown[0, 1, 1:].tolist() == [0.0, 1.0]


def test_white_is_the_brightest_half_per_cent_without_contact():
    image = np.arange(3000.0).reshape(10, 100, 3)
    image[0, 0, 0] = np.nan
    assert display_white_dn(image) == pytest.approx(np.percentile(np.arange(1.0, 3000), 99.5))
    for black in (np.zeros((4, 4, 3)), np.full((4, 4, 3), np.nan)):
        with pytest.raises(
            CompareError, match=r"no-contact image is too dark to be shown, because .*; check the light"
        ):
            display_white_dn(black)
    with pytest.raises(CompareError, match="white level must be positive, got 0"):
        displayed_image(image, 0.0, linear=True)


def textured(rng, shape=(90, 120, 3)):
    """Two displayed images of smooth colours, one with a brighter spot, and noise in both."""
    rows, columns = np.indices(shape[:2])
    pad = 0.4 + 0.2 * np.sin(rows / 9)[..., None] * [1.0, 0.7, 0.3] + 0.1 * np.cos(columns / 7)[..., None]
    spot = 0.2 * np.exp(-((rows - 40) ** 2 + (columns - 60) ** 2) / 300)[..., None] * [1.0, -0.5, 0.3]
    return [np.clip(i + 0.02 * rng.standard_normal(shape), 0.0, 1.0) for i in (pad, pad + spot)]


def test_flip_ends_at_none_and_at_the_largest_difference():
    black, white = np.zeros((32, 32, 3)), np.ones((32, 32, 3))
    everywhere = np.ones((32, 32), bool)
    assert flip_mean(black, black, everywhere) == 0
    # the paper's scale ends at 1
    assert flip_mean(black, white, everywhere) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("pixels_per_deg", [PIXELS_PER_DEGREE, 40.0])
@pytest.mark.parametrize("light", [1.0, 0.1])
def test_flip_agrees_with_its_makers_program(pixels_per_deg, light):
    """Both compute in single precision."""
    program = pytest.importorskip("flip_evaluator")
    reference, test = (light * image for image in textured(np.random.default_rng(5)))
    images = (image.astype(np.float32) for image in (reference, test))
    settings = {"inputsRGB": True, "applyMagma": False, "computeMeanError": False}
    found = program.evaluate(*images, "LDR", **settings, parameters={"ppd": pixels_per_deg})[0]
    whole = np.asarray(found, dtype=np.float64).reshape(reference.shape[:2])
    rows, columns = np.indices(whole.shape)
    for row, column, radius in ((45, 60, 12), (3, 116, 12), (45, 60, 200)):
        mask = np.hypot(rows - row, columns - column) < radius
        assert flip_mean(reference, test, mask, pixels_per_deg) == pytest.approx(whole[mask].mean(), abs=1e-6)
    where = np.ones(whole.shape, bool)
    seen = [perceived_image(image, where, pixels_per_deg) for image in (reference, test)]
    # a difference of structure of 1e-6 shows through its square root
    assert np.abs(flip_errors(*seen) - whole.ravel()).max() < 1e-3


def test_flip_of_a_region_is_that_of_the_whole_picture():
    """What lies farther from the region than the filters reach changes nothing but the order of sums."""
    reference, test = textured(np.random.default_rng(6))
    mask = np.zeros(reference.shape[:2], bool)
    mask[30:50, 50:70] = True
    found = flip_mean(reference, test, mask)
    reference[:15], test[:, 90:] = 0.0, 1.0
    assert flip_mean(reference, test, mask) == pytest.approx(found, rel=1e-6)
    assert flip_mean(reference, test, ~mask) > 1.5 * found


def test_a_pixel_that_is_missing_in_one_image_is_black_in_both():
    reference, test = textured(np.random.default_rng(7))
    mask = np.zeros(reference.shape[:2], bool)
    mask[20:60, 40:80] = True
    black = [image.copy() for image in (reference, test)]
    reference[70, 60, 1] = np.nan
    for image in black:
        image[70, 60] = 0.0
    assert flip_mean(reference, test, mask) == pytest.approx(flip_mean(*black, mask), rel=1e-12)
