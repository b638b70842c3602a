"""Short twin of benchmarks/fluorescence_levels.py: baked walls against path-wise fluorescence on the pressed finger."""

import numpy as np
import pytest

from benchmarks.fluorescence_levels import BIAS_BAR_REL, compared, finger, measure

pytestmark = pytest.mark.renderer


def test_baked_walls_have_the_mean_of_path_wise_fluorescence(llvm):
    """Bias under 1.5 % plus 3 combined standard errors in each band.

    Standard errors over few seeds are themselves uncertain: with Student's t for about 5 degrees of freedom a right
    program fails with a chance of at most 9 % over all seeds; these seeds are fixed. The benchmark makes the errors
    small, here they only guard against blunders such as a light path counted twice.
    """
    design = finger(96)
    baked = measure(design, "b", range(3), 32, bake_samples=8_000)
    paths = measure(design, "c", range(100, 106), 128)
    ratio, error = compared(baked, paths)
    assert (np.abs(ratio - 1.0) <= BIAS_BAR_REL + 3.0 * error).all()
    assert (error < 0.2).all()
