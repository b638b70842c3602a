import numpy as np
import pytest

from data_schemas import CompareError
from finray_calib.compare._candidate_errors import chromaticity_error

SHAPE = (50, 60, 3)
EVERYWHERE = np.ones(SHAPE[:2], bool)


def colour(*rgb):
    return np.broadcast_to(np.array(rgb, float), SHAPE).copy()


def test_the_distance_of_two_colours():
    error = chromaticity_error(colour(50, 30, 20), colour(20, 30, 50), EVERYWHERE)
    assert error.rms == pytest.approx(0.3)
    assert (error.mean_red, error.mean_green) == pytest.approx((0.3, 0.0))
    assert error.noise_rms == 0
    assert error.pixels_used == 3000


def test_an_exposure_factor_does_not_matter():
    rng = np.random.default_rng(0)
    first, second = rng.uniform(10, 100, SHAPE), rng.uniform(10, 100, SHAPE)
    plain = chromaticity_error(first, second, EVERYWHERE).rms
    assert chromaticity_error(3.7 * first, second, EVERYWHERE).rms == pytest.approx(plain, rel=1e-12)


def test_noise_bias_is_removed():
    rng = np.random.default_rng(1)
    simulated, captured = colour(300, 200, 100), colour(290, 205, 105)
    simulated_variance, captured_variance = colour(50, 30, 20), colour(90, 60, 40)
    squares = []
    for _ in range(100):
        noisy = [i + np.sqrt(v) * rng.standard_normal(SHAPE) for i, v in
                 ((simulated, simulated_variance), (captured, captured_variance))]  # fmt: skip
        error = chromaticity_error(*noisy, EVERYWHERE, simulated_variance, captured_variance)
        squares.append(error.rms**2)
    truth = chromaticity_error(simulated, captured, EVERYWHERE).rms ** 2
    # Four standard errors of the mean, and the second order that is left: (noise / sum)^2 of the noise itself.
    margin = 4 * np.std(squares, ddof=1) / 10 + error.noise_rms**2 * 190 / 600**2
    assert np.mean(squares) == pytest.approx(truth, abs=margin)
    assert error.noise_rms**2 > 10 * margin


def test_dark_pixels_are_left_out():
    captured = colour(50, 30, 20)
    captured[:10] = 1.0
    captured[10, 0, 0] = np.nan
    error = chromaticity_error(colour(50, 30, 20), captured, EVERYWHERE, captured_variance=colour(4, 4, 4))
    assert error.pixels_used == 3000 - 600 - 1
    assert error.rms == 0
    with pytest.raises(CompareError, match="None of the 3000 pixels of the region is usable"):
        chromaticity_error(colour(0, 0, 0), captured, EVERYWHERE)
