"""Camera noise from two images, against noise that was put in."""

import numpy as np
import pytest
from scipy import stats

from data_schemas import CompareError
from finray_calib.compare import _image_noise as module
from finray_calib.compare._image_noise import NO_NOISE, CaptureNoise, capture_noise

OFFSET_DN2, SLOPE_DN = 4.0, 0.2
SHAPE = (400, 400)
LEVELS_DN = np.array([60.0, 500.0, 2000.0])
# Sum of the squared autocorrelations of the high-pass: neighbouring squares are not independent.
SHARED = (1.0 + 2.0 * ((4.0 / 6.0) ** 2 + (1.0 / 6.0) ** 2)) ** 2


def scene():
    """Even ramps from 50 to 2050 DN."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[0]
    return 50.0 + 2000.0 * np.stack([columns, rows, 1.0 - columns], axis=-1)


def stated_rel(levels_dn):
    """Four standard errors of a line fitted to the variances of 20 classes of level, relative to the variance."""
    middle = 50.0 + 2000.0 * (np.arange(module.LEVELS) + 0.5) / module.LEVELS
    pixels = SHAPE[0] * SHAPE[1] / module.LEVELS
    sd = np.sqrt(2.0 * SHARED / pixels) * (OFFSET_DN2 + SLOPE_DN * middle)
    covariance = np.linalg.inv(np.stack([1.0 / sd, middle / sd]) @ np.stack([1.0 / sd, middle / sd], axis=1))
    at = np.stack([np.ones_like(levels_dn), levels_dn], axis=1)
    variance = OFFSET_DN2 + SLOPE_DN * levels_dn
    return 4.0 * np.sqrt(np.einsum("li,ij,lj->l", at, covariance, at)) / variance


def exposed(image, rng):
    return image + np.sqrt(OFFSET_DN2 + SLOPE_DN * image) * rng.standard_normal(image.shape)


def variance_at(noise):
    return noise.variance(np.repeat(LEVELS_DN[:, None], 3, axis=1))


STATED_REL = stated_rel(LEVELS_DN)
TRUTH = (OFFSET_DN2 + SLOPE_DN * LEVELS_DN)[:, None]


def test_read_and_shot_noise_are_found():
    rng = np.random.default_rng(0)
    noise = capture_noise(exposed(scene(), rng), exposed(scene(), rng))
    assert (np.abs(variance_at(noise) / TRUTH - 1.0) < STATED_REL[:, None]).all()
    # between levels 500 and 2000 DN the slope is as sure as the variances there
    assert noise.slope == pytest.approx(SLOPE_DN, rel=STATED_REL[1:].sum())


def test_read_noise_alone_has_no_slope():
    rng = np.random.default_rng(1)
    first, second = (scene() + 3.0 * rng.standard_normal((*SHAPE, 3)) for _ in range(2))
    assert variance_at(capture_noise(first, second)) == pytest.approx(9.0, rel=STATED_REL.max())


def test_drift_and_slow_change_are_no_noise():
    """Light 2 % up, with a smooth spot of 100 DN: a plain difference would find more than twice the noise."""
    first, second = (exposed(scene(), np.random.default_rng(seed)) for seed in (2, 3))
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    spot = 100.0 * np.exp(-((rows - 200.0) ** 2 + (columns - 150.0) ** 2) / (2.0 * 20.0**2))
    still, changed = capture_noise(first, second), capture_noise(first, 1.02 * second + spot[..., None])
    # Means of squares grow by (1 + 1.02^2) / 2, levels by 1.01; the spot moves a few pixels to other classes.
    expected = (1.0 + 1.02**2) / 2.0 * (OFFSET_DN2 + SLOPE_DN * LEVELS_DN / 1.01)[:, None] / TRUTH
    assert variance_at(changed) / variance_at(still) == pytest.approx(np.repeat(expected, 3, axis=1), rel=0.01)
    plain = 0.5 * ((1.02 * second + spot[..., None] - first) ** 2).mean()
    assert plain > 2.0 * still.variance(first).mean()


def test_a_few_changed_pixels_do_not_count():
    rng = np.random.default_rng(4)
    first, second = exposed(scene(), rng), exposed(scene(), rng)
    clean = variance_at(capture_noise(first, second))
    rows, columns = rng.choice(SHAPE[0], 100), rng.choice(SHAPE[1], 100)
    second[rows, columns] += 1000.0
    # 900 pixels of 160 000 hold a spoilt neighbourhood, 0.6 %; that many good ones of about 6 times the mean square
    # stay in the trimmed mean instead of them
    assert variance_at(capture_noise(first, second)) == pytest.approx(clean, rel=0.06)
    # untrimmed the specks alone would add this much
    assert 0.5 * 1000.0**2 * 100 / (SHAPE[0] * SHAPE[1]) > 50.0


def test_a_fixed_pattern_is_no_noise():
    pattern = 50.0 * np.random.default_rng(5).standard_normal((*SHAPE, 3))
    noise = capture_noise(scene() + pattern, scene() + pattern)
    assert (noise.offset == 0.0).all()
    assert (noise.slope == 0.0).all()


def test_what_trimming_takes_away_is_put_back_as_for_a_normal_distribution():
    share = 1.0 - module._TRIMMED_SHARE  # noqa: SLF001
    limit = stats.chi2.ppf(share, 1)
    assert pytest.approx(stats.chi2.cdf(limit, 3) / share, rel=1e-4) == module._TRIMMED_MEAN  # noqa: SLF001


def test_clipped_pixels_spoil_only_their_neighbourhood():
    rng = np.random.default_rng(6)
    first, second = exposed(scene(), rng), exposed(scene(), rng)
    whole = variance_at(capture_noise(first, second))
    second[100:150, 100:150, 1] = np.nan
    assert variance_at(capture_noise(first, second)) == pytest.approx(whole, rel=STATED_REL.max())


def test_too_few_pixels_are_refused():
    image = np.ones((24, 24, 3))
    # the outer ring has no whole neighbourhood: 22 x 22 are left
    with pytest.raises(CompareError, match=r"only 484 pixels .* at least 500 are needed .* shorter exposure"):
        capture_noise(image, image)


def test_variance_follows_the_level_and_no_pixel_is_quieter_than_black():
    noise = CaptureNoise(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.0, 0.5]))
    assert noise.variance(np.array([10.0, 10.0, -10.0])).tolist() == [2.0, 2.0, 3.0]
    assert NO_NOISE.variance(np.full((2, 2, 3), 100.0)).tolist() == np.zeros((2, 2, 3)).tolist()
