import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from data_schemas import CurveError
from finray_calib.spectra import SkewCauchy, from_mode_parameters, skew_cauchy
from finray_calib.spectra._emission_families import KAPPA_LIMIT, shape_tables, to_mode_parameters

# kappa, m(w), peak p, FWHM/g: independent table of the literature study, printed to three decimals
TABLE = [
    (0.0, 0.0, 0.5, 2.0),
    (0.5, 0.160, 0.513, 2.011),
    (1.0, 0.299, 0.558, 1.869),
    (1.5, 0.349, 0.627, 1.627),
    (2.0, 0.334, 0.702, 1.420),
    (2.5, 0.296, 0.770, 1.280),
    (3.0, 0.255, 0.827, 1.190),
    (4.0, 0.184, 0.907, 1.093),
    (5.0, 0.131, 0.951, 1.047),
]


@pytest.mark.parametrize(("kappa", "mode", "peak", "width"), TABLE)
def test_shape_tables_agree_with_the_printed_table(kappa, mode, peak, width):
    for sign in (1, -1):
        got = shape_tables(sign * kappa)
        assert np.allclose(got, [sign * mode, peak, width], atol=5.1e-4)  # half a printed digit


@pytest.mark.parametrize("kappa", [0.013, 0.777, 1.589, 2.991, 4.321, 5.999, 7.7])
def test_shape_tables_agree_with_scipy_root_finding(kappa):
    w = np.sinh(kappa)

    def negative(z):
        return -float(skew_cauchy(z, 0.0, 1.0, w, 1.0))

    top = minimize_scalar(negative, bracket=(-0.5, min(0.3, kappa / 3), 1.5), options={"xtol": 1e-10})
    half = [brentq(lambda z: negative(z) - top.fun / 2, *ends, xtol=1e-13) for ends in ((top.x, 20), (-20, top.x))]
    mode, peak, width = shape_tables(kappa)
    assert peak == pytest.approx(-top.fun, abs=1e-6)
    assert width == pytest.approx(half[0] - half[1], abs=1e-6)
    assert mode == pytest.approx(top.x, abs=1e-6)


@pytest.mark.parametrize(("scale", "skewness"), [(31.3, 3.07), (25.0, 0.0), (20.0, -1.0)])
def test_area_is_pi_h_over_2_g(scale, skewness):
    curve = SkewCauchy(590.0, scale, skewness, 1.0)
    area = sum(quad(curve, *ends, epsabs=1e-12)[0] for ends in ((-np.inf, 590.0), (590.0, np.inf)))
    assert curve.area == pytest.approx(area, rel=1e-9)


@given(
    st.floats(450, 750),
    st.floats(np.log(10), np.log(150)),
    st.floats(-6, 6),
    st.floats(np.log(1e-5), np.log(0.1)),
)
def test_mode_parameters_make_a_round_trip(mode, ln_fwhm, kappa, ln_peak):
    curve = SkewCauchy.from_mode(mode, ln_fwhm, kappa, ln_peak)
    assert np.allclose(curve.to_mode(), [mode, ln_fwhm, kappa, ln_peak], rtol=1e-10, atol=1e-10)


def test_mode_parameters_are_what_they_say_on_the_curve():
    curve = SkewCauchy.from_mode(600.0, np.log(50.0), 1.2, np.log(0.003))
    grid = np.arange(500.0, 700.0, 0.001)
    values = curve(grid)
    peak = np.exp(curve.to_mode()[3])
    above = grid[values >= peak / 2]
    assert curve.mode_nm == pytest.approx(grid[values.argmax()], abs=2e-3)  # the top is flat: two grid steps
    assert curve.fwhm_nm == pytest.approx(above[-1] - above[0], abs=2e-3)
    assert peak == pytest.approx(values.max(), rel=1e-7)


def test_functions_broadcast_over_many_curves():
    kappa = np.linspace(-3, 3, 7)
    paper = from_mode_parameters(np.full(7, 580.0), np.log(40.0), kappa, np.log(0.002))
    back = to_mode_parameters(*paper)
    assert np.allclose(back[0], 580.0)
    assert np.allclose(back[2], kappa)
    assert skew_cauchy(np.arange(3.0)[:, None], *paper).shape == (3, 7)


def test_skewness_beyond_the_tables_is_refused():
    with pytest.raises(CurveError, match="but at most 8 is allowed"):
        shape_tables(KAPPA_LIMIT + 0.1)


@pytest.mark.parametrize(("scale", "amplitude"), [(0.0, 1.0), (10.0, -1.0), (np.nan, 1.0)])
def test_curve_without_width_or_height_is_refused(scale, amplitude):
    with pytest.raises(CurveError, match="must both be positive"):
        SkewCauchy(600.0, scale, 0.0, amplitude)
