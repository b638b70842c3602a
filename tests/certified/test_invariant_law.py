"""The polynomial that stands in for Ogden's law: against closed forms of incompressible stretching."""

import numpy as np
import pytest

from data_schemas import SimulateError
from sim.mechanics import Ogden
from sim.mechanics.other_engines._deck import fit_invariant_law
from tests.certified.blocks import uniaxial_stress_mpa

TPU = Ogden((6.279, 1.639), (1.6663, -7.136))


def uniaxial_mpa(c, stretch):
    """Nominal stress 2 (l - l^-2) (dW/dI1 + dW/dI2 / l)."""
    i1, i2 = stretch**2 + 2.0 / stretch - 3.0, 2.0 * stretch + stretch**-2 - 3.0
    c10, c01, c20, c11, c02 = c
    return 2.0 * (stretch - stretch**-2) * (c10 + 2 * c20 * i1 + c11 * i2 + (c01 + c11 * i1 + 2 * c02 * i2) / stretch)


def test_stress_stays_within_the_stated_deviation():
    law = fit_invariant_law(TPU)
    stretch = np.array([0.8, 0.9, 0.99, 1.01, 1.1, 1.25])
    ratio = uniaxial_mpa(law.c_mpa, stretch) / uniaxial_stress_mpa(TPU, stretch)
    # a few uniaxial stretches; the stated deviation is the worst of three modes
    assert np.abs(ratio - 1.0).max() <= law.deviation_rel + 1e-9
    assert law.deviation_rel <= 0.01
    assert 2.0 * (law.c_mpa[0] + law.c_mpa[1]) == pytest.approx(TPU.shear_modulus_mpa)
    assert law.bulk_modulus_mpa == TPU.bulk_modulus_mpa


def test_a_mooney_rivlin_rubber_is_found_exactly():
    # 2 mu / alpha^2 sum of l^2, and of l^-2: C10 = mu1 / 2, C01 = mu2 / 2
    law = fit_invariant_law(Ogden((1.0, 0.5), (2.0, -2.0)))
    np.testing.assert_allclose(law.c_mpa, [0.5, 0.25, 0.0, 0.0, 0.0], atol=1e-12)
    assert law.deviation_rel <= 1e-12


def test_a_range_on_one_side_is_refused():
    with pytest.raises(SimulateError, match="must lie on both sides of 1"):
        fit_invariant_law(TPU, (1.1, 2.0))


def test_a_law_without_stiffness_is_refused():
    with pytest.raises(SimulateError, match=r"loses its stiffness under (uniaxial|planar|equibiaxial) load"):
        fit_invariant_law(Ogden((5.0, -4.5), (2.0, 4.0)), (0.5, 2.0))
