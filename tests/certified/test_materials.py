"""Materials: conventions, closed forms, stability."""

import numpy as np
import pytest

from data_schemas import SimulateError
from sim.mechanics import LinearElastic, Ogden
from sim.mechanics._materials import check_stability, neo_hooke, ogden_from_printed_form
from tests.certified.blocks import uniaxial_stress_mpa

TPU = Ogden((6.279, 1.639), (1.6663, -7.136))


def test_the_papers_table_in_the_two_conventions():
    assert TPU.shear_modulus_mpa == pytest.approx(7.918)
    with pytest.raises(
        SimulateError, match=r"shear modulus .* must be positive, got -0\.6166 MPa.*ogden_from_printed_form"
    ):
        ogden_from_printed_form(TPU.mu_mpa, TPU.alpha)


def test_conversion_of_constants_of_the_printed_form():
    # sum mu/alpha (lambda^alpha) has the uniaxial stress sum mu (lambda^(alpha-1) - lambda^(-alpha/2-1))
    mu, alpha, stretch = (3.0, -0.8), (1.7, -2.5), np.linspace(0.6, 2.0, 8)
    printed = sum(m * (stretch ** (a - 1) - stretch ** (-a / 2 - 1)) for m, a in zip(mu, alpha, strict=True))
    assert uniaxial_stress_mpa(ogden_from_printed_form(mu, alpha), stretch) == pytest.approx(printed, rel=1e-12)


def test_published_stress_of_the_table():
    # reference values of the same energy computed elsewhere (CalculiX agrees within its compressibility)
    assert uniaxial_stress_mpa(TPU, np.array([2.0, 0.6])) == pytest.approx([12.57, -43.05], abs=0.005)


def test_neo_hooke_is_one_term_of_ogden():
    gel = neo_hooke(0.1333)
    stretch = np.array([0.7, 1.0, 1.8])
    assert uniaxial_stress_mpa(gel, stretch) == pytest.approx(0.2666 * (stretch - stretch**-2), abs=1e-15)
    assert gel.bulk_modulus_mpa == pytest.approx(20 * 0.2666)
    nu = (3 * 20 - 2) / (2 * (3 * 20 + 1))
    assert nu == pytest.approx(0.475, abs=5e-4)
    assert gel.youngs_modulus_mpa == pytest.approx(2 * 0.2666 * (1 + nu))


def test_moduli_of_a_linear_elastic_material():
    onyx = LinearElastic(2100.0, 0.38)
    _, lame, mu = onyx.parameters
    assert mu * (3 * lame + 2 * mu) / (lame + mu) == pytest.approx(2100.0)
    assert lame / (2 * (lame + mu)) == pytest.approx(0.38)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Ogden((1.0,), (2.0, 3.0)), "as many finite alpha"),
        (lambda: Ogden((), ()), "as many finite alpha"),
        (lambda: Ogden((1.0, 1.0), (2.0, 0.0)), "alpha must not be 0"),
        (lambda: neo_hooke(0.1, 0.5), "bulk_over_shear must be above 2/3"),
        (lambda: LinearElastic(0.0, 0.3), "above 0 MPa, got 0"),
        (lambda: LinearElastic(2100.0, 0.5), r"above -1 and below 0\.5, got 0\.5"),
    ],
)
def test_bad_constants_are_refused(build, message):
    with pytest.raises(SimulateError, match=message):
        build()


def test_stability_over_the_strain_range():
    check_stability(TPU)
    check_stability(neo_hooke(0.1333))
    # a positive initial modulus, but a tension that falls beyond a stretch of about 1.4
    with pytest.raises(SimulateError, match=r"unstable \(Drucker\) under uniaxial load at a stretch of 1\.\d+"):
        check_stability(Ogden((2.0, -1.0), (2.0, 4.0)))
