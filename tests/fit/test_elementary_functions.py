"""The compiled elementary functions beside numpy's, over the ranges that their docstrings state."""

import subprocess
import sys

import numpy as np
import pytest

from finray_calib.spectra.family_kernels import arctangent, falling_exponential, log_of_one_plus


def test_arctangent_is_exact_to_rounding():
    x = np.concatenate([np.sinh(np.linspace(-15, 15, 2001)), [0.0, 0.41421356, -2.4142136]])
    ours = [arctangent(value) for value in x]
    np.testing.assert_allclose(ours, np.arctan(x), rtol=4e-16, atol=1e-16)


def test_falling_exponential_follows_numpy_and_ends_at_minus_80():
    x = -np.linspace(0, 80, 2001)
    ours = np.array([falling_exponential(value) for value in x])
    np.testing.assert_allclose(ours, np.exp(x), rtol=1e-11, atol=1e-13)
    assert falling_exponential(-1e4) == falling_exponential(-80.0)


@pytest.mark.parametrize(("largest", "rtol"), [(40.0, 1e-14), (1e4, 1e-8)])
def test_logarithm_follows_numpy(largest, rtol):
    x = np.expm1(np.linspace(-np.log(largest), np.log(largest), 2001))
    ours = [log_of_one_plus(value) for value in x]
    np.testing.assert_allclose(ours, np.log1p(x), rtol=rtol, atol=0)


def test_logarithm_keeps_its_digits_near_zero():
    x = np.array([1e-12, -1e-9, 3e-6])
    np.testing.assert_allclose([log_of_one_plus(value) for value in x], np.log1p(x), rtol=1e-15)


LOADS = """
import sys
import numba, numpy as np
from finray_calib.spectra.family_kernels import arctangent
assert arctangent(1.0) == np.arctan(1.0)
print("scipy.linalg" in sys.modules)
product = numba.njit(lambda a, b: a @ b)
print(product(np.eye(2), np.full((2, 2), 3.0)).tolist(), "scipy.linalg" in sys.modules)
"""


def test_compiled_functions_load_no_scipy_and_those_of_others_multiply_matrices():
    done = subprocess.run([sys.executable, "-c", LOADS], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[:2] == ["False", "[[3.0, 3.0], [3.0, 3.0]] True"]
