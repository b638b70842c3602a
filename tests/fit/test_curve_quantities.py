import numpy as np
import pytest

from finray_calib.spectra import curve_quantities

GRID_NM = np.arange(380.0, 781.0)


def bell(center, fwhm, nm=GRID_NM):
    return np.exp(-4 * np.log(2) * ((nm - center) / fwhm) ** 2)


def test_quantities_of_a_gaussian_between_samples():
    got = curve_quantities(0.004 * bell(597.31, 48.0)[None], GRID_NM)
    # 1 nm samples of a 48 nm Gaussian: third order of the parabola 1e-3 nm, linear crossings 3e-3 nm
    assert got.mode_nm[0] == pytest.approx(597.31, abs=2e-3)
    assert got.fwhm_nm[0] == pytest.approx(48.0, abs=0.02)
    assert got.peak_per_nm[0] == pytest.approx(0.004, rel=1e-5)
    assert got.skew[0] == pytest.approx(0.0, abs=1e-3)
    assert got.energy_yield[0] == pytest.approx(0.004 * 48.0 * np.sqrt(np.pi / (4 * np.log(2))), rel=1e-9)


def test_skew_is_the_difference_of_the_half_widths_over_the_full_width():
    halves = np.where(GRID_NM > 560, bell(560, 60.0), bell(560, 40.0))
    got = curve_quantities(np.stack([halves, halves[::-1]]), GRID_NM)
    assert got.fwhm_nm == pytest.approx(50.0, abs=0.02)
    # the parabola across the kink of the second derivative puts the mode 0.2 nm off, 0.4 nm of 50 in the skew
    assert got.skew == pytest.approx([0.2, -0.2], abs=0.01)
    assert got.mode_nm == pytest.approx([560.0, 600.0], abs=0.25)


def test_width_is_that_of_the_highest_bump():
    two = bell(520, 20.0) + 0.9 * bell(600, 20.0)
    assert curve_quantities(two[None], GRID_NM).fwhm_nm[0] == pytest.approx(20.0, abs=0.05)


def test_shoulder_above_half_counts_to_the_width():
    """A second Gaussian of equal width 20 nm away: half maximum read off a fine grid."""
    fine = np.arange(400.0, 700.0, 0.001)
    two = bell(540, 30.0, fine) + 0.8 * bell(560, 30.0, fine)
    above = fine[two > two.max() / 2]
    got = curve_quantities((bell(540, 30.0) + 0.8 * bell(560, 30.0))[None], GRID_NM)
    assert got.fwhm_nm[0] == pytest.approx(above[-1] - above[0], abs=0.02)


def test_curve_that_never_falls_to_half_ends_with_the_grid():
    got = curve_quantities(bell(770, 100.0)[None], GRID_NM)
    assert got.fwhm_nm[0] == pytest.approx(780 - 720, abs=0.05)
    rising = curve_quantities(np.exp((GRID_NM - 780) / 50)[None], GRID_NM)
    assert rising.mode_nm[0] == pytest.approx(780.0, abs=1.0)
    assert np.isfinite([rising.fwhm_nm, rising.skew, rising.peak_per_nm]).all()


def test_curve_of_zeros_has_no_width_and_no_yield():
    got = curve_quantities(np.zeros((1, GRID_NM.size)), GRID_NM)
    assert got.peak_per_nm[0] == got.energy_yield[0] == 0.0
    assert np.isfinite([got.mode_nm, got.fwhm_nm, got.skew]).all()


def test_yield_stops_at_780_nm():
    wide = np.arange(380.0, 1001.0)
    assert curve_quantities(np.ones((1, wide.size)), wide).energy_yield[0] == pytest.approx(400.0)
