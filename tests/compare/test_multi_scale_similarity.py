import numpy as np
import pytest
from scipy.ndimage import correlate1d
from scipy.signal import convolve2d

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
    assert found == pytest.approx(expected, abs=1e-12)


def test_equal_images_score_one(pair):
    assert multi_scale_similarity(pair[0], pair[0], 255.0) == pytest.approx(1.0, abs=1e-12)


def test_small_images_have_none(pair):
    assert multi_scale_similarity(*(image[:175] for image in pair), 255.0) is None
    assert multi_scale_similarity(*(image[:176] for image in pair), 255.0) > 0.0


def test_missing_pixels_do_not_count(pair):
    first, second = pair[0].copy(), pair[1]
    plain = multi_scale_similarity(first, second, 255.0)
    first[50, 50, 0] = np.nan
    with_gap = multi_scale_similarity(first, second, 255.0)
    # one pixel of 40 000 is gone; its windows at the finest scales with it
    assert with_gap == pytest.approx(plain, abs=5e-3)
    assert with_gap != plain
    first[:, ::8] = np.nan
    assert multi_scale_similarity(first, second, 255.0) is None


@pytest.mark.parametrize("missing", [False, True])
def test_one_scale_formed_with_several_is_that_formed_apart(pair, missing):
    first, second = pair[0].copy(), pair[1]
    if missing:
        first[50:53, 50, 0] = np.nan
    single, _ = similarity_of_all_scales(first, second, 255.0)
    apart = structural_similarity(first, second, 255.0)
    assert single.mean == apart.mean
    np.testing.assert_array_equal(single.ssim_map, apart.ssim_map)
    small = similarity_of_all_scales(first[:100], second[:100], 255.0)
    assert small[1] is None
    assert small[0].mean == structural_similarity(first[:100], second[:100], 255.0).mean


def test_wrong_input_is_refused(pair):
    with pytest.raises(
        CompareError, match=r"images of the same shape .* got the shapes \(192, 208, 3\) and \(100, 208, 3\)"
    ):
        multi_scale_similarity(pair[0], pair[1][:100], 255.0)
    with pytest.raises(CompareError, match="data range must be positive, got 0"):
        multi_scale_similarity(*pair, 0.0)
