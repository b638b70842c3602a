"""The absorption band: closed forms, limits and bad input."""

import numpy as np
import pytest

from data_schemas import CurveError
from finray_calib.spectra import absorptance, photon_yield, smooth_covariance

SHAPE = {
    "peak_nm": 560.0,
    "peak_absorbance": 0.7,
    "red_half_width_nm": 20.0,
    "blue_half_width_nm": 60.0,
    "blue_floor": 0.1,
}


def test_landmarks_are_those_of_the_equation():
    a = absorptance([560.0, 580.0, 500.0, 200.0], **SHAPE)
    absorbance = 0.7 * np.array([1.0, 0.5, 0.1 + 0.9 * 0.5, 0.1])
    # At 200 nm the bell is 2^-36, below 1e-10 of the floor.
    assert a == pytest.approx(1 - 10**-absorbance, rel=1e-9)


def test_a_thin_layer_shows_the_band_and_a_thick_one_a_plateau():
    x = np.arange(430.0, 600.0)
    thin = absorptance(x, **{**SHAPE, "peak_absorbance": 1e-6})
    twice = absorptance(x, **{**SHAPE, "peak_absorbance": 2e-6})
    assert twice == pytest.approx(2 * thin, rel=1e-5)  # the next term of the exponential is 2e-6 of the first
    thick = absorptance(x, **{**SHAPE, "peak_absorbance": 50.0})
    assert thick[x <= 560].min() > 0.999  # the floor alone absorbs 1 - 10^-5


@pytest.mark.parametrize(
    "wrong", [{"peak_absorbance": 0.0}, {"red_half_width_nm": -1.0}, {"blue_half_width_nm": 0.0}, {"blue_floor": 1.1}]
)
def test_impossible_shapes_are_refused(wrong):
    with pytest.raises(CurveError, match="half widths"):
        absorptance([500.0], **{**SHAPE, **wrong})


def test_covariance_falls_with_distance():
    k = smooth_covariance(np.array([400.0, 420.0]), 0.2, 20.0)
    assert k == pytest.approx(np.array([[0.04, 0.04 * np.exp(-0.5)], [0.04 * np.exp(-0.5), 0.04]]))


def test_photon_yield_of_a_line_is_its_energy_times_the_ratio_of_wavelengths():
    grid = np.arange(400.0, 701.0)
    line = np.where(grid == 600.0, 0.3, 0.0)
    assert photon_yield(line, grid, 450.0) == pytest.approx(0.3 * 600 / 450)
    assert photon_yield(line, grid, 600.0) == 0.0  # nothing is emitted at or below the excitation
