"""Image metrics beside the public alternative, in the same run: compare the medians as ratios."""

import colour
import numpy as np
import pytest
from skimage.metrics import structural_similarity as skimage_ssim

from finray_calib.compare import ciede2000, srgb_to_lab, structural_similarity


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    image = rng.random((480, 640, 3))
    return image, np.clip(image + 0.05 * rng.standard_normal(image.shape), 0.0, 1.0)


@pytest.mark.benchmark(group="SSIM, 640 x 480 x 3, float64")
def test_ssim_finray(benchmark, pair):
    benchmark(lambda: structural_similarity(*pair, 1.0))


@pytest.mark.benchmark(group="SSIM, 640 x 480 x 3, float64")
def test_ssim_scikit_image(benchmark, pair):
    benchmark(
        lambda: skimage_ssim(
            *pair, data_range=1.0, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
    )


@pytest.mark.benchmark(group="sRGB to CIEDE2000, 640 x 480 x 3, float64")
def test_ciede2000_finray(benchmark, pair):
    benchmark(lambda: ciede2000(srgb_to_lab(pair[0]), srgb_to_lab(pair[1])))


@pytest.mark.benchmark(group="sRGB to CIEDE2000, 640 x 480 x 3, float64")
def test_ciede2000_colour_science(benchmark, pair):
    def lab(image: np.ndarray) -> np.ndarray:
        return colour.XYZ_to_Lab(colour.sRGB_to_XYZ(image))

    benchmark(lambda: colour.delta_E(lab(pair[0]), lab(pair[1]), method="CIE 2000"))
