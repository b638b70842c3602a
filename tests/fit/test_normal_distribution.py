"""The truth is scipy's."""

import numpy as np
import pytest
from scipy.special import gammaincc, ndtr, ndtri

from finray_calib.fit._prior import chi_square_survival, normal_cdf, normal_quantile

EXACT = 1e-14  # of the value; some rounding steps of 1e-16


def test_distribution_function_in_both_tails():
    z = np.append(np.linspace(-30.0, 8.0, 2001), [-np.inf, np.inf])
    # exp(-z^2 / 2) passes the rounding of z on, z^2 times as large
    assert np.allclose(normal_cdf(z), ndtr(z), rtol=EXACT * 50, atol=0.0)
    near = z[np.abs(z) < 5]
    assert np.allclose(normal_cdf(near), ndtr(near), rtol=EXACT, atol=0.0)


def test_quantiles():
    share = np.concatenate([10.0 ** np.linspace(-300, -1, 500), np.linspace(0.01, 0.99, 981), 1 - np.logspace(-15, -1)])
    assert np.allclose(normal_quantile(share), ndtri(share), rtol=EXACT, atol=EXACT)
    assert np.isfinite(normal_quantile(np.array([0.0, 1.0]))).all()


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 7])
def test_survival_of_chi_square(freedom):
    value = np.append(np.linspace(0.0, 200.0, 801), 1e-9)
    assert np.allclose(
        chi_square_survival(value, freedom), gammaincc(freedom / 2, value / 2), rtol=EXACT * 20, atol=0.0
    )
