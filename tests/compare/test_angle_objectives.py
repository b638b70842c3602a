"""Fisher information, held-out error and uniformity against closed forms, estimators and a linear world."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_schemas import CompareError
from finray_calib.sensing import held_out_normal_error_deg, normal_sigma_deg, uniformity
from finray_calib.sensing._normal_map import angle_between_deg

JACOBIAN_E = np.array([[300.0, 40.0], [-250.0, 60.0], [20.0, 800.0]])
VARIANCE_E2 = np.array([150.0, 200.0, 900.0])


def test_two_channels_that_each_see_one_slope_add_up_as_errors_do():
    jacobian = np.array([[200.0, 0.0], [0.0, 50.0], [0.0, 0.0]])
    sigma = normal_sigma_deg(jacobian, np.array([16.0, 25.0, 9.0]))
    # slopes are known to 4/200 and 5/50
    assert sigma == pytest.approx(np.degrees(np.sqrt((0.02**2 + 0.1**2) / 2.0)), rel=1e-12)


def test_the_bound_is_what_weighted_least_squares_reaches():
    rng = np.random.default_rng(1)
    draws = 40_000
    noise = rng.standard_normal((draws, 3)) * np.sqrt(VARIANCE_E2)
    weight = 1.0 / np.sqrt(VARIANCE_E2)
    slopes = np.linalg.lstsq(weight[:, None] * JACOBIAN_E, (weight * noise).T, rcond=None)[0]
    found = np.degrees(np.sqrt((slopes**2).mean()))
    # a standard deviation from n draws is known to 1 / sqrt(2 n); two slopes
    assert normal_sigma_deg(JACOBIAN_E, VARIANCE_E2) == pytest.approx(found, rel=4.0 / np.sqrt(2.0 * draws))


def test_channels_that_change_alike_tell_no_normal_however_bright():
    alike = np.outer([1.0, 2.0, 0.5], [3.0, 4.0])
    sigma = normal_sigma_deg(np.stack([alike, 1e4 * alike, 0.0 * alike]), np.broadcast_to(VARIANCE_E2, (3, 3)))
    assert np.isinf(sigma).all()


@pytest.mark.parametrize(("variance", "shape"), [([1.0, 1.0, 0.0], (3, 2)), ([1.0, 1.0, 1.0], (2, 2))])
def test_fisher_refuses_what_does_not_fit(variance, shape):
    with pytest.raises(CompareError, match="Fisher information"):
        normal_sigma_deg(np.ones(shape), np.array(variance))


def test_the_angle_between_normals_is_that_of_the_rotation_between_them():
    rng = np.random.default_rng(2)
    a, b = rng.uniform(-0.5, 0.5, (2, 20, 2))
    for one, other, angle in zip(a, b, angle_between_deg(a, b), strict=True):
        normals = [np.array([[-g[0], 1.0, -g[1]]]) / np.sqrt(1.0 + g @ g) for g in (one, other)]
        cosine = np.clip((normals[0] * normals[1]).sum(), -1.0, 1.0)
        turn = Rotation.align_vectors(normals[1], normals[0])[0].magnitude()
        assert angle == pytest.approx(np.degrees(turn), abs=1e-6)
        assert angle == pytest.approx(np.degrees(np.arccos(cosine)), abs=1e-6)
    # where an arccosine has lost all digits
    assert angle_between_deg(np.zeros(2), np.array([1e-9, 0.0])) == pytest.approx(np.degrees(1e-9), rel=1e-9)


def linear_world(points, rng, frames=1, noise=0.0):
    """Return signals that are linear in the slopes, with a level that is linear in the place."""
    places = rng.uniform(-1.0, 1.0, (points, 2)) * [17.0, 35.0]
    slopes = rng.uniform(-0.3, 0.3, (12, 2))
    level = 1000.0 + places @ np.array([[10.0, -5.0, 2.0], [3.0, 4.0, -6.0]])
    signals = level[:, None] + slopes @ JACOBIAN_E.T
    exact = np.repeat(signals[:, :, None], frames, axis=2)
    return exact + noise * np.sqrt(VARIANCE_E2) * rng.standard_normal(exact.shape), places, slopes


def test_a_world_within_the_polynomials_is_learnt_exactly():
    # 35 of 40 points are seen; cubic terms of signals around 1000 leave ten digits
    error = held_out_normal_error_deg(*linear_world(40, np.random.default_rng(3)), folds=8)
    assert error.shape == (40, 12, 1)
    assert error.max() < 1e-6


def test_with_noise_the_held_out_error_comes_to_the_cramer_rao_bound():
    signals, places, slopes = linear_world(200, np.random.default_rng(4), frames=10, noise=0.3)
    error = held_out_normal_error_deg(signals, places, slopes, degree=1).mean()
    bound = normal_sigma_deg(JACOBIAN_E, 0.3**2 * VARIANCE_E2)
    # the mean length of a normal error in two slopes of mean square sigma^2 lies between those of an error in one slope
    # only and of equal errors in both; tilts of up to 17 deg shorten angles by cos^2, 0.91 at most
    assert 0.91 * np.sqrt(4.0 / np.pi) * bound < error
    # 24,000 angles are known on average to 0.4 %, and six terms from 16,000 rows add nothing to it
    assert error < 1.01 * np.sqrt(np.pi / 2.0) * bound


def test_the_held_out_error_sees_what_the_calibration_has_not():
    signals, places, slopes = linear_world(30, np.random.default_rng(5))
    stained = signals.copy()
    # a colour of its own at one place, which no other place teaches
    stained[7] *= [1.3, 0.8, 1.0]
    error = held_out_normal_error_deg(stained, places, slopes, degree=1).mean(axis=(1, 2))
    assert error[7] > 5.0 * np.median(np.delete(error, 7))


def test_a_channel_that_does_not_vary_is_no_division_by_zero():
    signals, places, slopes = linear_world(30, np.random.default_rng(6))
    signals[..., 1] = 7.0
    assert np.isfinite(held_out_normal_error_deg(signals, places, slopes, degree=1)).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"places_mm": np.zeros((5, 3))}, "a calibration table needs"),
        ({"folds": 1}, "must be 2 to 30 for 30"),
        ({"folds": 31}, "must be 2 to 30 for 30"),
        ({"degree": 7}, "240 rows, but needs at least 792"),
    ],
)
def test_tables_without_a_calibration_are_refused(change, said):
    signals, places, slopes = linear_world(30, np.random.default_rng(7))
    table = {"signals": signals, "places_mm": places, "slopes": slopes}
    with pytest.raises(CompareError, match=said):
        held_out_normal_error_deg(**{**table, **change})


def test_uniformity_is_the_ratio_of_quantiles():
    assert uniformity(np.full(7, 3.0)) == pytest.approx(1.0)
    # 101 evenly spaced values: the quantiles fall on values
    assert uniformity(np.linspace(1.0, 3.0, 101)) == pytest.approx(1.1 / 2.9, rel=1e-12)


@pytest.mark.parametrize("luminance", [np.array([]), np.array([1.0, 0.0])])
def test_uniformity_needs_light(luminance):
    with pytest.raises(CompareError, match="uniformity needs positive"):
        uniformity(luminance)
