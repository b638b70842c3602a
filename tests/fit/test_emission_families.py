"""The four families against closed forms, scipy's distributions and the exact skew-Cauchy curve."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq, least_squares
from scipy.stats import t as student_t

from data_schemas import FitError
from finray_calib.fit import EmissionPrior
from finray_calib.spectra import COMMON_PARAMETERS, FAMILIES, SkewCauchy, curve_quantities, family_named
from finray_calib.spectra.family_kernels import cell_of_table

GRID_NM = np.arange(380.0, 781.0)
FINE_NM = np.arange(300.0, 1500.0, 0.02)
# The shape table is interpolated by cubics over steps of 0.05 in kappa: 1e-6 of a peak, width or mode.
TABLE_REL = 1e-6


def curve(name, *theta):
    return lambda nm: FAMILIES[name].curves(np.array([theta]), np.atleast_1d(nm))[0]


@pytest.mark.parametrize("kappa", [-5.99, -1.234, -0.01, 0.0, 0.03, 0.777, 1.8184, 4.02, 6.0])
@pytest.mark.parametrize(("mode", "fwhm"), [(597.3, 48.2), (505.0, 21.0)])
def test_zheng2014_is_the_exact_skew_cauchy_curve(mode, fwhm, kappa):
    expected = SkewCauchy.from_mode(mode, np.log(fwhm), kappa, np.log(0.004))(GRID_NM)
    got = curve("zheng2014", mode, np.log(fwhm), np.log(0.004), kappa)(GRID_NM)
    assert np.abs(got - expected).max() < TABLE_REL * 0.004


@pytest.mark.parametrize("kappa", [-2.3, 0.0, 0.4, 3.0])
def test_skew_t_with_one_degree_of_freedom_is_zheng2014(kappa):
    own = (590.0, np.log(40.0), np.log(0.002), kappa)
    # one grid line of the table at ln tail 0, up to the rounding of 0.6 / 0.1
    assert np.allclose(curve("skew_t", *own, 0.0)(GRID_NM), curve("zheng2014", *own)(GRID_NM), rtol=1e-9, atol=0)


def unit_skew_t(z, kappa, ln_tail):
    """Student's t density relative to its centre, times the arctangent's share, by scipy."""
    n = np.exp(ln_tail)
    return student_t.pdf(z, n) / student_t.pdf(0.0, n) * (np.arctan(np.sinh(kappa) * z) / np.pi + 0.5)


@pytest.mark.parametrize(("kappa", "ln_tail"), [(0.0, 1.4), (0.33, -0.47), (-1.81, 0.55), (2.6, 3.97), (5.9, 1.01)])
def test_skew_t_equals_scipys_density_about_an_exact_maximum(kappa, ln_tail):
    def slope(z):
        n, w = np.exp(ln_tail), np.sinh(kappa)
        return -(n + 1) * z / (n + z * z) + w / (np.pi * (1 + (w * z) ** 2)) / (np.arctan(w * z) / np.pi + 0.5)

    top = brentq(slope, -1.5, 1.5, xtol=1e-14)
    height = unit_skew_t(top, kappa, ln_tail)
    right, left = (
        brentq(lambda z: unit_skew_t(z, kappa, ln_tail) - height / 2, top, end, xtol=1e-13) for end in (30, -30)
    )
    scale = 45.0 / (right - left)
    expected = 0.003 / height * unit_skew_t((GRID_NM - 570.0) / scale + top, kappa, ln_tail)
    got = curve("skew_t", 570.0, np.log(45.0), np.log(0.003), kappa, ln_tail)(GRID_NM)
    # a cubic table in two directions, the coarser one in steps of 0.1
    assert np.abs(got - expected).max() < 10 * TABLE_REL * 0.003


@pytest.mark.parametrize("asymmetry", [-1.5, -0.2, 0.0, 1e-6, 0.35, 1.5])
@pytest.mark.parametrize(("mode", "fwhm"), [(597.0, 48.0), (500.0, 90.0)])
def test_log_normal_has_exactly_its_mode_width_and_height(mode, fwhm, asymmetry):
    f = curve("log_normal_wavenumber", mode, np.log(fwhm), np.log(0.004), asymmetry)
    assert f(mode)[0] == pytest.approx(0.004, rel=1e-12)
    red, blue = (brentq(lambda nm: f(nm)[0] - 0.002, mode, mode + sign * 1.2 * fwhm, xtol=1e-11) for sign in (1, -1))
    assert red - blue == pytest.approx(fwhm, rel=1e-10)
    # the definition of the asymmetry: red over blue half width, both in wavenumber; below 1e-5 it counts as none
    half_red, half_blue = 1e4 / mode - 1e4 / red, 1e4 / blue - 1e4 / mode
    assert np.log(half_red / half_blue) == pytest.approx(asymmetry, abs=2e-6)


def test_log_normal_is_the_siano_metzler_form():
    """Written out from the literature, with its own width and maximum in wavenumber (kK)."""
    nu_m, width, r = 1e4 / 597.0, 1.4, np.exp(0.35)
    ends = [nu_m - width * r / (1 + r), nu_m + width / (1 + r)]
    fwhm = 1e4 / ends[0] - 1e4 / ends[1]
    inside = 1 - (1e4 / GRID_NM - nu_m) * (r * r - 1) / (r * width)
    assert inside.min() < 0 < inside.max()  # the support ends on the blue side
    expected = np.zeros_like(GRID_NM)
    expected[inside > 0] = np.exp(-np.log(2) / np.log(r) ** 2 * np.log(inside[inside > 0]) ** 2)
    got = curve("log_normal_wavenumber", 597.0, np.log(fwhm), 0.0, 0.35)(GRID_NM)
    assert np.allclose(got, expected, rtol=1e-9, atol=1e-20)  # where it vanishes the compiled curve ends at e^-80


def test_gaussian_mixture_is_two_gaussians():
    def bell(center, fwhm):
        return np.exp(-4 * np.log(2) * ((GRID_NM - center) / fwhm) ** 2)

    got = curve("gaussian_mixture", 570.0, np.log(40.0), np.log(0.004), 35.0, 0.3, -1.0)(GRID_NM)
    expected = 0.004 * (bell(570, 40) + np.exp(-1) * bell(605, 40 * np.exp(0.3)))
    assert np.allclose(got, expected, rtol=1e-12)


@pytest.mark.parametrize(("mode", "fwhm", "kappa"), [(597.0, 48.0, 1.8184), (515.0, 38.0, -0.8), (600.0, 45.0, 0.0)])
def test_area_of_zheng2014_is_pi_h_over_2_g(mode, fwhm, kappa):
    f = curve("zheng2014", mode, np.log(fwhm), np.log(0.004), kappa)
    exact = SkewCauchy.from_mode(mode, np.log(fwhm), kappa, np.log(0.004))
    area = sum(quad(lambda nm: f(nm)[0], *ends, epsabs=1e-12)[0] for ends in ((-np.inf, mode), (mode, np.inf)))
    assert area == pytest.approx(np.pi * exact.amplitude / (2 * exact.scale_nm), rel=2 * TABLE_REL)


@pytest.mark.parametrize("truth", [(597.0, 48.0, 1.8184), (516.0, 38.0, 0.8), (600.0, 45.0, -2.7)])
def test_parameters_are_recovered_from_a_noise_free_spectrum_of_the_paper(truth):
    mode, fwhm, kappa = truth
    spectrum = SkewCauchy.from_mode(mode, np.log(fwhm), kappa, np.log(0.004))(GRID_NM)

    def misfit(theta):
        return (curve("zheng2014", *theta)(GRID_NM) - spectrum) / 0.004

    start = np.array([mode + 6, np.log(fwhm) + 0.2, np.log(0.003), kappa + 0.4])
    end = least_squares(misfit, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=[10, 0.1, 0.1, 0.1]).x
    got = SkewCauchy.from_mode(end[0], end[1], end[3], end[2])
    expected = SkewCauchy.from_mode(mode, np.log(fwhm), kappa, np.log(0.004))
    assert got.to_mode()[3] == pytest.approx(expected.to_mode()[3], abs=TABLE_REL)
    for name in ("mode_nm", "fwhm_nm"):
        assert getattr(got, name) == pytest.approx(getattr(expected, name), rel=TABLE_REL)
    # the paper's own four follow from them through the slope of the shape table, which costs a factor of some ten
    for name in ("location_nm", "scale_nm", "skewness", "amplitude"):
        assert getattr(got, name) == pytest.approx(getattr(expected, name), rel=10 * TABLE_REL)


@pytest.mark.parametrize("name", ["zheng2014", "skew_t", "log_normal_wavenumber"])
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_common_parameters_are_those_of_the_curve_over_the_whole_prior(name, seed):
    family = FAMILIES[name]
    theta = EmissionPrior().of(family, with_blocking=True).draw(1, np.random.default_rng(seed))
    got = curve_quantities(family.curves(theta, FINE_NM), FINE_NM)
    # a parabola through samples 0.02 nm apart: the kink of a strong skew moves its top by less than one step
    assert got.mode_nm[0] == pytest.approx(theta[0, 0], abs=0.02)
    assert got.peak_per_nm[0] == pytest.approx(np.exp(theta[0, 2]), rel=1e-4)
    assert got.fwhm_nm[0] == pytest.approx(np.exp(theta[0, 1]), rel=2e-4)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_mixture_parameters_are_those_of_its_first_component(seed):
    family = FAMILIES["gaussian_mixture"]
    theta = EmissionPrior().of(family, with_blocking=True).draw(1, np.random.default_rng(seed))
    both = family.curves(theta, FINE_NM)
    theta[:, 3], theta[:, 4], theta[:, 5] = (
        theta[:, 0] + theta[:, 3],
        theta[:, 1] + theta[:, 4],
        theta[:, 2] + theta[:, 5],
    )
    second = theta[0, 5] - 4 * np.log(2) * ((FINE_NM - theta[0, 3]) / np.exp(theta[0, 4])) ** 2
    got = curve_quantities(both - np.exp(second), FINE_NM)
    assert got.mode_nm[0] == pytest.approx(theta[0, 0], abs=1e-3)
    assert got.peak_per_nm[0] == pytest.approx(np.exp(theta[0, 2]), rel=1e-6)
    assert got.fwhm_nm[0] == pytest.approx(np.exp(theta[0, 1]), rel=1e-5)


def test_every_family_has_the_common_parameters_first_and_curves_of_many_rows():
    for family in FAMILIES.values():
        assert family.parameter_names[:3] == COMMON_PARAMETERS
        theta = EmissionPrior().of(family, with_blocking=True).draw(5, np.random.default_rng(1))
        rows = family.curves(theta, GRID_NM)
        assert rows.shape == (5, GRID_NM.size)
        assert (rows >= 0).all()
        assert np.allclose(
            rows[3], family.curves(theta[3:4, : len(family.parameter_names)], GRID_NM)[0], rtol=0, atol=0
        )


def test_unknown_family_is_refused_with_the_known_ones():
    with pytest.raises(FitError, match="'cauchy' is unknown; valid families are zheng2014, skew_t"):
        family_named("cauchy")


@pytest.mark.parametrize("name", list(FAMILIES))
@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf, 1e30, -1e30])
def test_no_parameter_leads_outside_the_table(name, poison):
    # compiled functions check no index; NaN as an integer is -2^63 on x86 and 0 on ARM
    usual = np.array([600.0, np.log(40.0), np.log(0.01), 0.5, 0.3, 0.1])[: 3 + len(FAMILIES[name].own)]
    for place in range(usual.size):
        poisoned = usual.copy()
        poisoned[place] = poison
        values = FAMILIES[name].curves(np.stack([usual, poisoned, usual]), GRID_NM)
        assert np.isfinite(values[[0, 2]]).all()
        np.testing.assert_array_equal(values[0], values[2])
        assert not (np.isnan(poison) and np.isfinite(values[1]).any())


@pytest.mark.parametrize(
    ("place", "cell"), [(np.nan, 1), (-np.inf, 1), (np.inf, 7), (1e30, 7), (0.2, 1), (1.0, 1), (1.99, 1), (6.5, 6)]
)
def test_every_place_has_a_cell_of_the_table(place, cell):
    assert cell_of_table(place, 7) == cell
