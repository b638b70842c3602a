import numpy as np
import pytest
from scipy.ndimage import correlate1d
from scipy.signal import convolve2d
from skimage.metrics import structural_similarity as scikit_image_ssim

from data_schemas import CompareError
from finray_calib.compare import multi_scale_similarity, structural_similarity
from finray_calib.compare._structural_similarity import SCALE_WEIGHTS, similarity_of_all_scales


@pytest.fixture(scope="module")
def pair():
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[:192, :208]
    image = np.stack([np.sin(rows / 9), np.cos(columns / 7), np.sin((rows + columns) / 13)], axis=2) * 60 + 120
    return image, image + 12 * rng.standard_normal(image.shape) + 3 * np.sin(rows / 40)[..., None]


def independent(first, second, data_range):
    """The formulas of the paper written down again: one channel, full windows, means, products, decimation by 2."""
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    taps /= taps.sum()

    def windowed(image):
        return correlate1d(correlate1d(image, taps, axis=0), taps, axis=1)[5:-5, 5:-5]

    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    result = 1.0
    for scale, weight in enumerate(SCALE_WEIGHTS):
        mx, my = windowed(first), windowed(second)
        vx, vy = windowed(first**2) - mx**2, windowed(second**2) - my**2
        cov = windowed(first * second) - mx * my
        factor = (2 * cov + c2) / (vx + vy + c2)
        if scale == 4:
            factor = factor * (2 * mx * my + c1) / (mx**2 + my**2 + c1)
        result *= factor.mean() ** weight
        square = np.full((2, 2), 0.25)
        first, second = (convolve2d(image, square, mode="valid")[::2, ::2] for image in (first, second))
    return result


def test_it_agrees_with_the_paper_written_down_again(pair):
    found = multi_scale_similarity(*pair, 255.0)
    expected = np.mean([independent(pair[0][..., c], pair[1][..., c], 255.0) for c in range(3)])
    # Only the order of the sums differs.
    assert found.value == pytest.approx(expected, abs=1e-12)
    assert found.scales == 5
    assert found.label == "MS-SSIM, 5 scales (Wang 2003)"


def test_equal_images_score_one(pair):
    assert multi_scale_similarity(pair[0], pair[0], 255.0).value == pytest.approx(1.0, abs=1e-12)


def test_small_images_have_none_unless_asked_and_then_it_is_said(pair):
    small = [image[:100] for image in pair]
    assert multi_scale_similarity(*small, 255.0) is None
    found = multi_scale_similarity(*small, 255.0, fewer_scales=True)
    assert found.scales == 4
    assert found.label == "MS-SSIM with 4 of 5 scales, weights renormalised: not comparable with 5"
    assert multi_scale_similarity(pair[0][:10], pair[1][:10], 255.0, fewer_scales=True) is None
    one_scale = multi_scale_similarity(pair[0][:20], pair[1][:20], 255.0, fewer_scales=True)
    # with one scale it is SSIM itself, whatever the weight was
    _, ssim_map = scikit_image_ssim(
        pair[0][:20], pair[1][:20], data_range=255.0, channel_axis=2, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    assert one_scale.value == pytest.approx(ssim_map[5:-5, 5:-5].mean(), abs=1e-9)


def test_missing_pixels_and_what_lies_outside_the_mask_do_not_count(pair):
    first, second = pair[0].copy(), pair[1].copy()
    mask = np.ones(first.shape[:2], bool)
    mask[:, 120:] = False
    plain = multi_scale_similarity(first, second, 255.0, mask).value
    # beyond the reach of the coarsest window around the mask: 6 coarse pixels
    second[:, 120 + 6 * 16 :] = 0.0
    assert multi_scale_similarity(first, second, 255.0, mask).value == plain
    first[50, 50, 0] = np.nan
    with_gap = multi_scale_similarity(first, second, 255.0, mask).value
    # one pixel of 23 000 is gone; its windows at the finest scales with it
    assert with_gap == pytest.approx(plain, abs=5e-3)
    assert with_gap != plain
    first[:, ::8] = np.nan
    assert multi_scale_similarity(first, second, 255.0, mask) is None


@pytest.mark.parametrize("missing", [False, True])
def test_one_scale_and_several_formed_together_are_those_formed_apart(pair, missing):
    first, second = pair[0].copy(), pair[1]
    if missing:
        first[50:53, 50, 0] = np.nan
    single, multi = similarity_of_all_scales(first, second, 255.0)
    assert multi == multi_scale_similarity(first, second, 255.0)
    apart = structural_similarity(first, second, 255.0)
    assert single.mean == apart.mean
    np.testing.assert_array_equal(single.ssim_map, apart.ssim_map)
    small = similarity_of_all_scales(first[:100], second[:100], 255.0)
    assert small[1] is None
    assert small[0].mean == structural_similarity(first[:100], second[:100], 255.0).mean


def test_wrong_input_is_refused(pair):
    with pytest.raises(CompareError, match=r"images and a mask of one size .* got \(192, 208, 3\), \(100, 208, 3\)"):
        multi_scale_similarity(pair[0], pair[1][:100], 255.0)
    with pytest.raises(CompareError, match="data range must be positive, got 0"):
        multi_scale_similarity(*pair, 0.0)
