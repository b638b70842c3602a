import numpy as np
import pytest
from skimage.metrics import structural_similarity as scikit_image_ssim

from data_schemas import CompareError
from finray_calib.compare import structural_similarity

REFERENCE = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "channel_axis": -1}
#: scikit-image filters with scipy, we with OpenCV: only rounding of the weights and sums differs.
ROUNDING = 1e-9


def pair(rng, shape=(150, 97, 3)):
    first = 120 + 40 * np.sin(np.arange(shape[1]) / 9)[None, :, None] + 20 * rng.standard_normal(shape)
    return first, first + 12 * rng.standard_normal(shape) + 3


@pytest.mark.parametrize("channels", [1, 3, 8])
def test_floats_agree_with_scikit_image(channels):
    first, second = pair(np.random.default_rng(0), (150, 97, channels))
    expected, expected_map = scikit_image_ssim(first, second, data_range=255, full=True, **REFERENCE)
    result = structural_similarity(first, second, 255)
    assert result.mean == pytest.approx(expected, abs=ROUNDING)
    inner = (slice(5, -5), slice(5, -5))
    assert np.abs(result.ssim_map - expected_map.mean(axis=-1))[inner].max() < ROUNDING
    outside = np.ones(result.ssim_map.shape, bool)
    outside[inner] = False
    assert np.isnan(result.ssim_map[outside]).all()


def test_eight_bit_agrees_with_scikit_image():
    first, second = (np.clip(image, 0, 255).astype(np.uint8) for image in pair(np.random.default_rng(1)))
    expected = scikit_image_ssim(first, second, data_range=255, **REFERENCE)
    assert structural_similarity(first, second, 255).mean == pytest.approx(expected, abs=ROUNDING)


def test_an_image_equals_itself_and_the_range_matters():
    first, second = pair(np.random.default_rng(2))
    assert structural_similarity(first, first, 255).mean == pytest.approx(1, abs=1e-12)
    assert structural_similarity(first, second, 255).mean < structural_similarity(first, second, 4095).mean


def test_the_mask_selects_window_centres():
    first, second = pair(np.random.default_rng(3))
    mask = np.zeros(first.shape[:2], bool)
    mask[30:60, 20:70] = True
    result = structural_similarity(first, second, 255, mask)
    assert result.mean == pytest.approx(result.ssim_map[30:60, 20:70].mean(), rel=1e-12)
    assert structural_similarity(first, second, 255).mean_within(mask) == result.mean


def test_a_missing_pixel_spoils_only_the_windows_that_touch_it():
    first, second = pair(np.random.default_rng(4))
    whole = structural_similarity(first, second, 255).ssim_map
    first[70, 40, 1] = np.nan
    holed = structural_similarity(first, second, 255).ssim_map
    spoiled = np.zeros(whole.shape, bool)
    spoiled[65:76, 35:46] = True
    inner = np.isfinite(whole)
    assert np.isnan(holed[spoiled]).all()
    assert (holed[inner & ~spoiled] == whole[inner & ~spoiled]).all()


def test_wrong_input_is_refused():
    image = np.ones((20, 20, 3))
    with pytest.raises(CompareError, match=r"at least 11 x 11 px, got the shapes \(10, 20, 3\)"):
        structural_similarity(image[:10], image[:10], 1.0)
    with pytest.raises(CompareError, match=r"of the same shape .* got the shapes \(20, 20, 3\) and \(20, 19, 3\)"):
        structural_similarity(image, image[:, :19], 1.0)
    with pytest.raises(CompareError, match="data range must be positive, got 0"):
        structural_similarity(image, image, 0)
    with pytest.raises(CompareError, match=r"mask has shape \(19, 20\) but the images are 20 x 20 px"):
        structural_similarity(image, image, 1.0, np.ones((19, 20), bool))


def test_region_without_a_complete_window_has_no_similarity():
    image = np.ones((20, 20, 3))
    border = np.zeros((20, 20), bool)
    border[0] = True
    assert np.isnan(structural_similarity(image, image, 1.0, border).mean)
    image[10, 10] = np.nan
    assert np.isnan(structural_similarity(image, image, 1.0).mean)
