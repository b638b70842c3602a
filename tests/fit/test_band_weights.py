from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from data_schemas import CurveError, FitError
from finray_calib.spectra import FilterSet, SkewCauchy, emission_weights
from tests.fit.synthetic_bands import ZHENG, full_sum, orange

GRID = np.arange(380.0, 781.0)


def integral(function, center):
    """Integral over the grid's range by adaptive quadrature, with the narrow places named."""
    return quad(function, 380.0, 780.0, points=[center - 12, center, center + 12, 450.0], limit=400, epsabs=1e-14)[0]


def expected_value(rig, band, channel, theta):
    """The measurement equation written out with scipy's quadrature; the leak of all light is exp(theta[5]) nominal."""
    curve = SkewCauchy.from_mode(theta[0], theta[1], theta[3], theta[2])
    laser_scale = quad(rig.laser, 380.0, 780.0, points=[450.0])[0]

    def passed(b, x, more=True):
        return rig.transmission(b, x) + np.expm1(theta[5]) * rig.leak * more

    def white(b, c):
        return integral(lambda x: rig.white(x) * rig.lamp(x) * passed(b, x) * rig.response(c, x), rig.center_nm[b])

    def under_laser(function, b, c):
        leaks = b != rig.excitation
        return integral(
            lambda x: function(x) * rig.laser(x) / laser_scale * passed(b, x, leaks) * rig.response(c, x), 450.0
        )

    visible = sum(
        share * under_laser(rig.white, rig.excitation, c) / white(rig.excitation, c)
        for c, share in enumerate(rig.channel_weights)
    )
    center = rig.center_nm[band]
    places = sorted({450.0, *(x for x in (center - 12, center, center + 12) if x > 450.0)})

    def emission(x):
        return curve(x) * passed(band, x) * rig.response(channel, x)

    emitted = quad(emission, 450.0, 780.0, points=places, limit=400, epsabs=1e-14)[0]
    reflected = np.exp(theta[4]) * under_laser(np.ones_like, band, channel)
    return (emitted + reflected) / white(band, channel) / visible


@pytest.mark.parametrize(("band", "channel"), [(0, 2), (1, 0), (1, 2), (2, 1), (4, 1), (5, 0), (7, 0), (7, 2)])
def test_predicted_band_equals_the_measurement_equation(rig, weights, band, channel):
    theta = orange("zheng2014")
    got = full_sum(ZHENG, theta, weights).reshape(8, 3)[band, channel]
    # a 1 nm trapezoid of 4 nm and 10 nm Gaussians is exact to rounding; only the cut of the emission at the laser
    # costs half a step, which shows in the filters that pass little else
    tolerance = 1e-4 if band <= rig.excitation else 1e-5
    assert got == pytest.approx(expected_value(rig, band, channel, theta), rel=tolerance)


def test_perfect_white_has_a_reading_of_one_in_the_excitation_band(rig, weights):
    reflected = weights.reflected_laser.reshape(8, 3)[rig.excitation] * rig.white(450.0)
    assert reflected @ rig.channel_weights == pytest.approx(1.0, rel=1e-4)  # the white's slope across the laser line


def test_scale_of_lamp_laser_and_camera_does_not_matter(rig, weights):
    curves = rig.sampled(GRID)
    scaled = curves | {"lamp": 7 * curves["lamp"], "laser": 3 * curves["laser"], "response": 0.2 * curves["response"]}
    other = emission_weights(**scaled)
    # the camera and laser cancel; the lamp's own scale cancels between W and V
    assert np.allclose(other.emission, weights.emission, rtol=1e-12)
    assert np.allclose(other.reflected_laser, weights.reflected_laser, rtol=1e-12)


def test_rows_are_band_major_and_the_laser_is_found(weights):
    assert weights.bands == 8
    assert weights.band_index.tolist() == [b for b in range(8) for _ in range(3)]
    assert np.flatnonzero(weights.is_excitation).tolist() == [3, 4, 5]
    assert weights.laser_nm == pytest.approx(450.0, abs=1e-6)
    with pytest.raises(ValueError, match="read-only"):
        weights.emission[0, 0] = 1.0


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"wavelength_nm": GRID[::-1]}, CurveError, "wavelengths in nm, in increasing order"),
        ({"lamp": np.ones(7)}, CurveError, "lamp: has shape"),
        ({"white_reflectance": np.full(401, -0.1)}, CurveError, "negative or not finite"),
        ({"laser": np.full(401, np.nan)}, CurveError, "negative or not finite"),
        ({"laser": np.zeros(401)}, CurveError, "laser: the area under the curve is zero"),
        ({"lamp": np.zeros(401)}, FitError, "white signal of band 0, channel 0 is zero"),
        ({"filters": FilterSet(np.ones((8, 401)), 8)}, FitError, "valid bands are 0 to 7"),
        ({"channel_weights": (1.0, 1.0, 1.0)}, FitError, "the weights sum to 3, but must sum to 1"),
        ({"channel_weights": (0.5, 0.5)}, CurveError, "channel_weights: has shape"),
    ],
)
def test_unusable_curves_are_refused(rig, change, error, message):
    with pytest.raises(error, match=message):
        emission_weights(**(rig.sampled(GRID) | change))


def test_excitation_filter_that_blocks_the_laser_is_refused(rig):
    curves = rig.sampled(GRID)
    curves["filters"].transmission[rig.excitation, GRID < 500] = 0.0
    curves["filters"].transmission[rig.excitation, GRID >= 500] = 0.5
    curves["laser"][GRID >= 500] = 0.0
    with pytest.raises(FitError, match="passes no laser light"):
        emission_weights(**curves)


def test_weights_of_different_lengths_are_refused(weights):
    with pytest.raises(FitError, match="'reflected_laser' has shape"):
        replace(weights, reflected_laser=np.ones(5))
