import numpy as np
import pytest

from data_schemas.errors import CompareError
from finray_calib.compare.gradient_error import difference_gradient_error, gradient_squares

SHAPE = (64, 80, 3)
EVERYWHERE = np.ones(SHAPE[:2], bool)
LEVEL = np.array([100.0, 50.0, 10.0])


def plane(along_rows, along_columns):
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.repeat((along_rows * rows + along_columns * columns)[..., None], 3, axis=2).astype(float)


def test_a_plane_has_its_own_slope():
    error = difference_gradient_error(plane(3.0, 4.0), np.zeros(SHAPE), LEVEL, EVERYWHERE)
    assert error.per_channel_rms_per_px == pytest.approx(5.0 / LEVEL, rel=1e-12)
    assert error.rms_per_px == pytest.approx(np.sqrt(np.mean((5.0 / LEVEL) ** 2)), rel=1e-12)
    # the border of one pixel has no complete window
    assert error.pixels_used == (SHAPE[0] - 2) * (SHAPE[1] - 2)


def test_equal_changes_have_no_error_and_a_constant_does_not_count():
    change = np.random.default_rng(0).normal(size=SHAPE)
    assert difference_gradient_error(change + 7.0, change, LEVEL, EVERYWHERE).rms_per_px == pytest.approx(0, abs=1e-13)


def test_noise_bias_is_removed():
    rng = np.random.default_rng(1)
    sd = np.array([2.0, 1.0, 0.5]) * (1 + plane(0.01, 0.0)[..., :1])
    signal, noise_variance = plane(0.3, -0.2), np.broadcast_to(sd**2, SHAPE)
    plain, corrected = [], []
    for _ in range(100):
        noisy = signal + sd * rng.standard_normal(SHAPE)
        plain.append(difference_gradient_error(noisy, np.zeros(SHAPE), LEVEL, EVERYWHERE).rms_per_px ** 2)
        error = difference_gradient_error(noisy, np.zeros(SHAPE), LEVEL, EVERYWHERE, noise_variance)
        corrected.append(error.rms_per_px**2)
    truth = np.mean(0.13 / LEVEL**2)
    # Four standard errors of the mean of 100 squares: passes by chance alone in all but 1 of 16 000 runs.
    margin = 4 * np.std(corrected, ddof=1) / 10
    assert np.mean(corrected) == pytest.approx(truth, abs=margin)
    assert np.mean(plain) > truth + 10 * margin
    assert np.mean(plain) - truth == pytest.approx(error.noise_rms_per_px**2, abs=margin)


def test_pure_noise_is_never_below_zero():
    quiet = np.zeros(SHAPE)
    assert difference_gradient_error(quiet, quiet, LEVEL, EVERYWHERE, np.ones(SHAPE)).rms_per_px == 0


def test_a_missing_pixel_takes_out_its_neighbours_and_nothing_else():
    change = plane(3.0, 4.0)
    change[20, 30, 1] = np.nan
    squares = gradient_squares(change, LEVEL)
    gone = np.isnan(squares).any(axis=2)
    assert gone[19:22, 29:32].all()
    assert gone[1:-1, 1:-1].sum() == 9
    assert squares[18, 30] == pytest.approx((5.0 / LEVEL) ** 2)


def test_wrong_input_is_refused():
    with pytest.raises(
        CompareError, match=r"must be positive in every channel, got \[1.0, 0.0, 1.0\]: check the black"
    ):
        gradient_squares(np.zeros(SHAPE), np.array([1.0, 0.0, 1.0]))
    with pytest.raises(CompareError, match="None of the 5120 pixels of the region is usable"):
        difference_gradient_error(np.full(SHAPE, np.nan), np.zeros(SHAPE), LEVEL, EVERYWHERE)
