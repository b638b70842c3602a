"""The spline that smooths the walls' light, against known light with the noise of a bake."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.stats import t as student_t

from sim.optics import TEXELS_ALONG
from sim.optics._painted_walls import TEXELS_UP
from sim.optics._wall_spline import BATCHES, choose_smoother, smooth_batches

Z_MM = (np.arange(TEXELS_ALONG) + 0.5)[:, None] * 70.0 / TEXELS_ALONG
UP = (np.arange(TEXELS_UP) + 0.5) / TEXELS_UP
# the default finger's walls by seven million paths, means over 5 mm, at rest and with a cylinder of 10 mm at 35 mm
OF_STRIPS = {
    "rest": [1.0, 1.084, 1.052, 0.957, 0.846, 0.736, 0.634, 0.544, 0.461, 0.395, 0.343, 0.299, 0.27, 0.271],
    "pressed": [1.0, 1.074, 1.043, 0.953, 0.868, 0.826, 0.688, 0.487, 0.395, 0.367, 0.329, 0.291, 0.262, 0.26],
}
AT_REST, PRESSED = (
    np.maximum(CubicSpline(np.arange(2.5, 70.0, 5.0), values)(Z_MM), 0.0) * (0.8 + 0.4 * UP)
    for values in OF_STRIPS.values()
)
# of one texel of one batch of a default bake; few bright paths, so skewed like this gamma distribution
NOISE_REL = 0.9
BAKES = 60


def bakes(light, count=BAKES, noise_rel=NOISE_REL, seed=1):
    """Return noisy batches of light, (bake, batch, along, up)."""
    shape = 1.0 / noise_rel**2
    drawn = np.random.default_rng(seed).gamma(shape, 1.0 / shape, (count, BATCHES, *light.shape))
    return light * drawn


def strips(maps):
    """Return means over 5 mm of the wall."""
    return maps.reshape(*maps.shape[:-2], 14, 5 * TEXELS_UP).mean(axis=-1)


def polynomial(maps):
    """Return least-squares polynomials of degree 7 by 1, which smoothed the walls before."""
    legendre = np.polynomial.legendre.legvander
    basis = np.kron(legendre(Z_MM[:, 0] / 35.0 - 1.0, 7), legendre(2.0 * UP - 1.0, 1))
    return (maps.reshape(*maps.shape[:-2], -1) @ np.linalg.pinv(basis).T @ basis.T).reshape(maps.shape)


def bias_by_strip(smooth, light):
    """Return the mean error of strips, and its standard error, as shares of the light there."""
    off = strips(smooth - light) / strips(light)
    return off.mean(axis=0), off.std(axis=0, ddof=1) / np.sqrt(len(off))


@pytest.mark.parametrize("light", [AT_REST, PRESSED], ids=["rest", "pressed"])
def test_no_strip_of_a_wall_is_off_by_more_than_one_per_cent(light):
    traced = bakes(light)
    # what was traced is unbiased and has the same noise: the difference tells the smoothing alone
    raw = traced.mean(axis=1)
    bias, error = bias_by_strip(np.stack([smooth_batches(bake).mean for bake in traced]) - raw + light, light)
    assert (np.abs(bias) < 0.01 + 3.0 * error).all()
    assert np.sqrt(max(np.mean(bias**2 - error**2), 0.0)) < 0.005


def test_the_polynomial_that_stood_here_rings_on_both_sides_of_a_contact():
    raw = bakes(PRESSED).mean(axis=1)
    bias, error = bias_by_strip(polynomial(raw) - raw + PRESSED, PRESSED)
    assert (np.abs(bias) > 0.02 + 3.0 * error).sum() >= 4


def test_intervals_of_texels_hold_the_light_as_often_as_they_say():
    """Over the wall, as such intervals promise: 95 % of texels by Student's t of 15 degrees of freedom."""
    smooth = [smooth_batches(bake) for bake in bakes(PRESSED, 30)]
    held = [np.abs(s.mean - PRESSED) < student_t.ppf(0.975, BATCHES - 1) * s.error_sd for s in smooth]
    assert 0.93 < np.mean(held) < 0.98


def test_strength_follows_light_and_noise():
    """A press needs a more flexible curve than the wall at rest, and so does the same light with less noise."""

    def freedom_of(light, noise):
        chosen = [choose_smoother(b.mean(axis=0), b.var(axis=0, ddof=1) / BATCHES) for b in bakes(light, 20, noise)]
        return np.mean([smoother.gain.sum() for smoother in chosen])

    freedom = [freedom_of(light, noise) for light, noise in ((AT_REST, 0.3), (PRESSED, 0.3), (PRESSED, 0.9))]
    assert freedom[1] > 1.15 * freedom[0]
    assert freedom[1] > 1.15 * freedom[2]


def test_smoothing_takes_noise_off_and_keeps_the_sum_of_batches():
    smooth = np.stack([smooth_batches(bake).mean for bake in bakes(PRESSED)])
    raw = bakes(PRESSED).mean(axis=1)
    noise = [np.sqrt(np.mean((maps - PRESSED) ** 2 / PRESSED**2)) for maps in (smooth, raw)]
    assert noise[0] < 0.4 * noise[1]
    one = smooth_batches(bakes(PRESSED, 1)[0])
    np.testing.assert_allclose(one.batches.mean(axis=0), one.mean)
    # halves are smoothed as the other half chose: what one of them was is not in its own weights
    changed = bakes(PRESSED, 1)[0]
    changed[:8] *= 3.0
    np.testing.assert_allclose(smooth_batches(changed).batches[:8], 3.0 * one.batches[:8], rtol=1e-12)


def test_dark_walls_stay_dark_and_straight_light_stays_as_it_is():
    dark = smooth_batches(np.zeros((BATCHES, TEXELS_ALONG, TEXELS_UP)))
    assert not dark.batches.any()
    assert dark.error_sd.max() < 1e-12
    plane = np.broadcast_to(3.0 + UP, (TEXELS_ALONG, TEXELS_UP))
    smoother = choose_smoother(plane, np.full(plane.shape, 0.04))
    np.testing.assert_allclose(smoother(plane), plane, rtol=1e-9)


def test_light_below_zero_by_more_than_noise_is_set_to_zero():
    """Only a sheer fall of light can make a curve do that; noise about zero stays, or dark walls would shine."""
    step = np.where(Z_MM < 20.0, 100.0, -0.5) * np.ones(TEXELS_UP)
    noisy = step + np.random.default_rng(2).normal(0.0, 0.1, (BATCHES, *step.shape))
    np.testing.assert_allclose(smooth_batches(noisy).mean[-20:], 0.0, atol=1e-12)
    about_zero = smooth_batches(np.random.default_rng(3).normal(0.0, 0.1, (BATCHES, TEXELS_ALONG, TEXELS_UP)))
    assert (about_zero.mean < 0.0).any()
