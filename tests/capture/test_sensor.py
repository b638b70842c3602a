from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from data_schemas import bayer_planes
from rigs.simulated.sensor import Sensor, mosaic, poisson_charge

SENSOR = Sensor(
    bit_depth=12,
    black_level_dn=100.0,
    gain_e_per_dn=2.0,
    read_noise_e=8.0,
    dark_current_e_per_s=5.0,
    full_well_e=7000.0,
    prnu_rel=0.0,
    dsnu_e=0.0,
    seed=3,
)
SHAPE = (256, 256)
PIXELS = SHAPE[0] * SHAPE[1]
# Every statistical bar below is 5 standard errors: a false alarm in 1.7 million runs, and the seeds are fixed.
SIGMAS = 5.0


def flat(electrons_per_s: float) -> np.ndarray:
    return np.full(SHAPE, electrons_per_s)


@pytest.mark.parametrize("exposure_s", [0.01, 1.0, 4.0])
def test_mean_is_black_level_plus_charge_over_gain(exposure_s: float) -> None:
    rate = 1000.0
    counts = SENSOR.expose(flat(rate), exposure_s, np.random.default_rng(1))
    expected = 100.0 + (rate + 5.0) * exposure_s / 2.0
    assert abs(counts.mean() - expected) < SIGMAS * counts.std() / np.sqrt(PIXELS)


def test_photon_transfer_slope_is_the_gain_and_intercept_the_read_noise() -> None:
    rng = np.random.default_rng(2)
    rates = np.array([0.0, 10.0, 60.0, 300.0, 1500.0, 5000.0])
    means, variances = [], []
    for rate in rates:
        # The difference of two frames cancels the fixed pattern, as in EMVA 1288.
        a, b = (SENSOR.expose(flat(rate), 1.0, rng).astype(float) for _ in range(2))
        means.append(0.5 * (a + b).mean())
        variances.append(0.5 * (a - b).var())
    # var = mean / K + read noise^2 / K^2 + 1/12 of quantisation; the sd of a variance of n pixels is var sqrt(2/n)
    expected = (np.array(means) - 100.0) / 2.0 + 8.0**2 / 2.0**2 + 1 / 12
    np.testing.assert_allclose(variances, expected, rtol=SIGMAS * np.sqrt(2 / PIXELS))


def test_black_level_and_read_noise_of_a_dark_frame() -> None:
    counts = SENSOR.expose(flat(0.0), 1e-6, np.random.default_rng(4)).astype(float)
    assert abs(counts.mean() - 100.0) < SIGMAS * 4.0 / np.sqrt(PIXELS)
    assert counts.var() == pytest.approx(16.0 + 1 / 12, rel=SIGMAS * np.sqrt(2 / PIXELS))


def test_saturation_clips_at_full_scale_and_at_full_well() -> None:
    rng = np.random.default_rng(5)
    deep = replace(SENSOR, full_well_e=1e6)
    assert (deep.expose(flat(1e9), 1.0, rng) == 4095).all()
    shallow = SENSOR.expose(flat(1e9), 1.0, rng).astype(float)
    assert abs(shallow.mean() - (100.0 + 7000.0 / 2.0)) < SIGMAS * 4.0 / np.sqrt(PIXELS)
    assert (replace(SENSOR, black_level_dn=0.0).expose(flat(0.0), 1e-6, rng) == 0).sum() > 0.4 * PIXELS


def test_fixed_pattern_repeats_with_the_seed_and_has_the_stated_spread() -> None:
    sensor = replace(SENSOR, prnu_rel=0.02, dsnu_e=6.0)
    sensitivity, offset_e = sensor.fixed_pattern(SHAPE)
    spread = SIGMAS / np.sqrt(2 * PIXELS)
    assert sensitivity.std() == pytest.approx(0.02, rel=spread)
    assert offset_e.std() == pytest.approx(6.0, rel=spread)
    np.testing.assert_array_equal(sensitivity, replace(sensor, read_noise_e=1.0).fixed_pattern(SHAPE)[0])
    assert not np.array_equal(sensitivity, replace(sensor, seed=4).fixed_pattern(SHAPE)[0])
    # independent of every other draw from the same seed: |correlation| stays below 4 / sqrt(pixels)
    other = np.random.default_rng(sensor.seed).standard_normal(SHAPE)
    assert abs(np.corrcoef(sensitivity.ravel(), other.ravel())[0, 1]) < 4 / np.sqrt(PIXELS)
    frames = [sensor.expose(flat(3000.0), 1.0, np.random.default_rng(n)).astype(float) for n in range(40)]
    expected = 100.0 + (3000.0 * sensitivity + 5.0 + offset_e) / 2.0
    residual = np.mean(frames, axis=0) - expected
    temporal_sd = np.sqrt(3000.0 / 4 + 16.0) / np.sqrt(40)
    assert residual.std() == pytest.approx(temporal_sd, rel=SIGMAS / np.sqrt(2 * PIXELS) + 0.005)  # 0.5 %: PRNU in shot


@pytest.mark.parametrize("mean_e", [0.2, 9.0, 10.5, 31.0, 4000.0])
def test_charge_follows_poisson_law(mean_e: float) -> None:
    draws = poisson_charge(np.full(20_000, mean_e), np.random.default_rng(6))
    assert (draws == np.rint(draws)).all()
    values, counts = np.unique(draws, return_counts=True)
    distance = np.abs(np.cumsum(counts) / draws.size - stats.poisson.cdf(values, mean_e)).max()
    # Kolmogorov's bound at an error rate of 1e-4 is 2.2 / sqrt(n); discrete laws only lower it.
    assert distance < 2.2 / np.sqrt(draws.size)


def test_charge_mixes_faint_and_bright_pixels() -> None:
    mean_e = np.tile([2.0, 500.0], 20_000)
    draws = poisson_charge(mean_e, np.random.default_rng(7))
    for start, mean in ((0, 2.0), (1, 500.0)):
        assert abs(draws[start::2].mean() - mean) < SIGMAS * np.sqrt(mean / 20_000)


def test_mosaic_and_planes_are_inverse() -> None:
    rgb = np.random.default_rng(8).random((5, 7, 3))
    raw = mosaic(rgb)
    assert raw.shape == (10, 14)
    assert raw[0, 0] == rgb[0, 0, 0]
    assert raw[0, 1] == raw[1, 0] == rgb[0, 0, 1]
    assert raw[1, 1] == rgb[0, 0, 2]
    np.testing.assert_allclose(bayer_planes(raw), rgb, rtol=1e-15)


def test_green_plane_is_the_mean_of_its_two_pixels() -> None:
    raw = np.array([[1, 10], [20, 4]], dtype=np.uint16)
    np.testing.assert_array_equal(bayer_planes(raw), [[[1.0, 15.0, 4.0]]])
