import numpy as np
import pytest

from finray_calib.compare._image_noise import NOISE_EXCESS, gradient_variance, image_gradient

SHAPE = (64, 80, 5)


def plane(along_rows, along_columns):
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.repeat((along_rows * rows + along_columns * columns)[..., None], SHAPE[2], axis=2).astype(float)


def test_a_plane_has_its_own_slope_and_no_border():
    gradient = image_gradient(plane(3.0, 4.0))
    assert gradient.shape == (2, *SHAPE)
    assert gradient[0, 1:-1, 1:-1] == pytest.approx(3.0, rel=1e-12)
    assert gradient[1, 1:-1, 1:-1] == pytest.approx(4.0, rel=1e-12)
    assert np.isnan(gradient[:, [0, -1]]).all()
    assert np.isnan(gradient[:, :, [0, -1]]).all()


def test_a_missing_pixel_takes_out_its_neighbours_and_nothing_else():
    image = plane(3.0, 4.0)
    image[20, 30, 1] = np.nan
    gone = np.isnan(image_gradient(image)).any(axis=(0, 3))
    assert gone[19:22, 29:32].all()
    assert gone[1:-1, 1:-1].sum() == 9


def test_the_noise_of_gradients_is_foretold():
    rng = np.random.default_rng(1)
    sd = 1.0 + plane(0.02, 0.0)
    sums, expected = [], gradient_variance(sd**2)[:, 1:-1, 1:-1]
    for _ in range(200):
        sums.append((image_gradient(sd * rng.standard_normal(SHAPE))[:, 1:-1, 1:-1] ** 2).sum(axis=(1, 2, 3)))
    # 200 sums: means within 4 standard errors, variances to 4 times 10 %
    assert np.mean(sums, axis=0) == pytest.approx(expected.sum(axis=(1, 2, 3)), rel=4 * 0.01)
    both, independent = np.sum(sums, axis=1), 2.0 * (expected**2).sum()
    assert np.var(both, ddof=1) == pytest.approx(NOISE_EXCESS * independent, rel=0.4)
