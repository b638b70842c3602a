"""Photon transfer against the EMVA 1288 reference package, a camera model of other people, and closed forms."""

import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from data_schemas import RadiometryError
from finray_calib.radiometry import FrameStack, PhotonTransfer, linearity, photon_transfer
from finray_calib.radiometry._photon_transfer import (
    MONOCHROME,
    StackStatistics,
    fit_line,
    non_negative,
    nonuniformity,
    normal_estimate,
    root_of,
    saturation_level,
)
from rigs.simulated.sensor import Sensor
from tests.radiometry.camera_sessions import DSNU_E, GAIN_E_PER_DN, PRNU_REL, READ_NOISE_E, SENSOR

FULL_SCALE_DN = 4095


def stack_of(*frames: np.ndarray, full_scale_dn: int = FULL_SCALE_DN) -> StackStatistics:
    stack = FrameStack("test frames", [MONOCHROME], full_scale_dn)
    for frame in frames:
        stack.add(frame)
    return stack.statistics()[0]


def require(*packages: str) -> None:
    lost = [name for name in packages if importlib.util.find_spec(name) is None]
    if lost:
        pytest.skip(f"NOT CHECKED against other people's cameras: pip install {' '.join(lost)}")


# The EMVA 1288 reference implementation on the same frames.


@dataclass(frozen=True)
class Compared:
    reference: dict[str, float]
    exposure_s: np.ndarray
    lit: list[StackStatistics]
    dark: list[StackStatistics]
    lit_many: StackStatistics
    dark_many: StackStatistics
    transfer: PhotonTransfer
    saturation: int

    @property
    def signal_dn(self) -> np.ndarray:
        return np.array([a.mean_dn - b.mean_dn for a, b in zip(self.lit, self.dark, strict=True)])

    def used(self, low: float, high: float) -> np.ndarray:
        return (self.signal_dn >= low * self.signal_dn[self.saturation]) & (
            self.signal_dn <= high * self.signal_dn[self.saturation]
        )


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Compared:
    require("emva1288", "lxml", "PIL")
    folder = tmp_path_factory.mktemp("emva")
    rng = np.random.default_rng(11)
    flat = np.full((160, 160), 350_000.0)
    exposure_s = np.linspace(1, 20, 20) * 1.15e-3
    images: dict[str, dict[str, dict[str, list[str]]]] = {"temporal": {}, "spatial": {}}

    def take(kind: str, t: float, photons: float, number: int) -> StackStatistics:
        frames = [SENSOR.expose(flat * (photons > 0), t, rng) for _ in range(number)]
        names = [f"{kind}_{t:.5f}_{photons:.0f}_{i}.npy" for i in range(number)]
        for name, frame in zip(names, frames, strict=True):
            np.save(folder / name, frame)
        images[kind].setdefault(f"{1e9 * t:.1f}", {})[f"{photons:.6f}"] = names
        return stack_of(*frames)

    lit = [take("temporal", t, 350_000.0 * t, 2) for t in exposure_s]
    dark = [take("temporal", t, 0.0, 2) for t in exposure_s]
    lit_many, dark_many = (take("spatial", exposure_s[8], p, 16) for p in (350_000.0 * exposure_s[8], 0.0))
    (folder / "images.json").write_text(json.dumps(images))
    script = Path(__file__).parent / "oracles" / "emva_reference.py"
    done = subprocess.run([sys.executable, script, folder], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    saturation = saturation_level(lit)
    assert saturation is not None
    dark_line = fit_line(exposure_s, np.array([s.mean_dn for s in dark]), np.array([s.mean_sd_dn for s in dark]))
    black_dn = float(dark_line.parameters[0])
    signal_dn = np.array([s.mean_dn for s in lit]) - black_dn
    below = [s for s, x in zip(lit, signal_dn, strict=True) if x <= 0.7 * signal_dn[saturation]]
    transfer = photon_transfer([*dark, *below], black_dn, "mono")
    reference = json.loads(done.stdout.splitlines()[-1])
    return Compared(reference, exposure_s, lit, dark, lit_many, dark_many, transfer, saturation)


def test_means_and_variances_are_those_of_the_emva_package(compared: Compared) -> None:
    np.testing.assert_allclose([s.mean_dn for s in compared.lit], compared.reference["mean_dn"], rtol=1e-12)
    # it divides by the number of pixels, we by one less (25 600 px)
    ours = np.array([s.variance_dn2 * (1 - 1 / s.pixels) for s in compared.lit])
    np.testing.assert_allclose(ours, compared.reference["variance_dn2"], rtol=1e-9)


def test_gain_and_dark_noise_agree_with_the_emva_package(compared: Compared) -> None:
    assert compared.saturation == compared.reference["saturation_index"]
    gain, noise = compared.transfer.gain_e_per_dn, compared.transfer.read_noise_e
    # The package fits without weights: its standard deviation is about 1.5 times ours, and the frames are the same.
    assert abs(1.0 / compared.reference["k_dn_per_e"] - gain.estimate) < 4 * gain.sd
    assert gain.sd < 0.004 * gain.estimate
    assert abs(compared.reference["sigma_d_e"] - noise.estimate) < 4 * 1.5 * noise.sd
    assert noise.sd < 0.01 * noise.estimate


def test_linearity_error_is_that_of_the_emva_package(compared: Compared) -> None:
    result = linearity(compared.exposure_s, compared.signal_dn, np.full(20, 1e-4), compared.used(0.05, 0.95))
    lowest, highest = np.nanmin(result.deviation_rel), np.nanmax(result.deviation_rel)
    # photons of its fit are 350 000 exposures: only rounding in the file names of exposures is left
    assert 100 * lowest == pytest.approx(compared.reference["lowest_percent"], abs=1e-5)
    assert 100 * highest == pytest.approx(compared.reference["highest_percent"], abs=1e-5)


def test_non_uniformities_are_those_of_the_emva_package(compared: Compared) -> None:
    k = compared.reference["k_dn_per_e"]
    dark = nonuniformity(compared.dark_many, None, "spatial")
    lit = nonuniformity(compared.lit_many, compared.dark_many, "spatial")
    signal_dn = compared.lit_many.mean_dn - compared.dark_many.mean_dn
    # it leaves the flicker of the frame mean in the temporal variance: 1/25 600 of it
    assert np.sqrt(dark.variance_dn2) == pytest.approx(k * compared.reference["dsnu_e"], rel=1e-4)
    assert 100 * np.sqrt(lit.variance_dn2) / signal_dn == pytest.approx(compared.reference["prnu_percent"], rel=1e-4)


# A camera model of other people: the truth is a property of the device.


def demo_camera(gain_e_per_dn: float, read_noise_e: float) -> Callable[[float], np.ndarray]:
    import mm_test_adapters
    import pymmcore

    core = pymmcore.CMMCore()
    libs = str(Path(mm_test_adapters.__file__).parent / "libs")
    core.setDeviceAdapterSearchPaths([libs])
    core.loadDevice("camera", "DemoCamera", "DCam")
    core.initializeDevice("camera")
    core.setCameraDevice("camera")
    for name, value in {
        "PixelType": "16bit",
        "BitDepth": "12",
        "Mode": "Noise",
        "Photon Conversion Factor": gain_e_per_dn,
        "ReadNoise (electrons)": read_noise_e,
        "Photon Flux": 50,
    }.items():
        core.setProperty("camera", name, value)

    def take(exposure_s: float) -> np.ndarray:
        core.setExposure(1e3 * exposure_s)
        core.snapImage()
        return np.array(core.getImage())

    return take


@pytest.mark.parametrize(
    ("k_dn_per_e", "read_noise_e", "longest_s", "noise_tolerance_rel"), [(1.0, 2.5, 0.06, 0.08), (2.0, 7.0, 0.03, 0.05)]
)
def test_micro_manager_demo_camera(
    k_dn_per_e: float, read_noise_e: float, longest_s: float, noise_tolerance_rel: float
) -> None:
    require("pymmcore", "mm_test_adapters")
    take = demo_camera(1.0 / k_dn_per_e, read_noise_e)
    exposures_s = np.linspace(longest_s / 12, longest_s, 12)
    dark = [stack_of(take(0.0), take(0.0)) for _ in range(4)]  # it makes no light at exposure 0 only
    lit = [stack_of(take(t), take(t)) for t in exposures_s]
    black_dn = float(np.mean([s.mean_dn for s in dark]))
    found = photon_transfer([*dark, *lit], black_dn, "demo camera")
    assert 1.0 / found.gain_e_per_dn.estimate == pytest.approx(k_dn_per_e, rel=0.01)
    assert found.gain_e_per_dn.sd < 0.0025 * found.gain_e_per_dn.estimate
    assert found.read_noise_e.estimate == pytest.approx(read_noise_e, rel=noise_tolerance_rel)


# Closed forms.


def test_stack_statistics_are_those_of_numpy() -> None:
    rng = np.random.default_rng(1)
    frames = rng.integers(0, 60_000, (7, 12, 10)).astype(np.uint16)
    found = stack_of(*frames, full_scale_dn=59_000)
    means = frames.mean(axis=(1, 2))
    assert found.mean_dn == pytest.approx(frames.mean(), rel=1e-13)
    np.testing.assert_allclose(found.frame_means_dn, means, rtol=1e-13)
    expected = (frames.var(axis=0, ddof=1).mean() - means.var(ddof=1)) * 120 / 119
    assert found.variance_dn2 == pytest.approx(expected, rel=1e-12)
    image = frames.mean(axis=0)
    assert found.spatial.variance_dn2 == pytest.approx(image.var(ddof=1), rel=1e-12)
    assert found.saturated_fraction == np.mean(frames >= 59_000)
    assert found.empty_fraction == np.mean(frames == 0)


def test_variance_of_a_pair_is_half_that_of_its_difference() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(500, 9, (2, 40, 40))
    # the lamp flickers by 5 DN between the two: no part of the pixels' noise
    assert stack_of(a, b + 5.0).variance_dn2 == pytest.approx(np.var(a - b, ddof=1) / 2, rel=1e-12)


def test_welford_does_not_lose_small_noise_on_a_large_mean() -> None:
    frames = 1e9 + np.random.default_rng(3).normal(0, 1, (50, 20, 20))
    expected = frames.var(axis=0, ddof=1).mean() - frames.mean(axis=(1, 2)).var(ddof=1)
    assert stack_of(*frames).variance_dn2 == pytest.approx(expected * 400 / 399, rel=1e-6)


def test_second_differences_keep_pixels_and_drop_shading() -> None:
    rng = np.random.default_rng(4)
    pixels = rng.normal(0, 3, (400, 400))
    y, x = np.mgrid[0:400, 0:400]
    shaded = 500 + pixels + 0.1 * x - 0.05 * y + 40 * np.sin(x / 60)
    found = stack_of(shaded, shaded)
    assert found.spatial.variance_dn2 > 50 * 9
    # five standard deviations of the estimate itself
    assert abs(found.pixel_to_pixel.variance_dn2 - 9.0) < 5 * found.pixel_to_pixel.sd_dn2
    assert found.pixel_to_pixel.sd_dn2 == pytest.approx(9 * np.sqrt(2 * 3.781 / 398**2), rel=0.03)


def test_line_fit_is_that_of_numpy() -> None:
    rng = np.random.default_rng(5)
    x, sd = np.linspace(0, 10, 12), rng.uniform(0.5, 2.0, 12)
    y = 3 + 0.5 * x + sd * rng.standard_normal(12)
    fit = fit_line(x, y, sd)
    slope_first, covariance = np.polyfit(x, y, 1, w=1 / sd, cov="unscaled")
    np.testing.assert_allclose(fit.parameters, slope_first[::-1], rtol=1e-10)
    np.testing.assert_allclose(fit.covariance, covariance[::-1, ::-1], rtol=1e-10)
    assert fit.chi_square_p > 1e-3
    bent = fit_line(x, y + 3 * x**2, sd)
    assert bent.chi_square_p < 1e-10
    np.testing.assert_allclose(bent.covariance, covariance[::-1, ::-1] * bent.chi_square / 10, rtol=1e-10)


def exposed(sensor: Sensor, side_px: int = 128) -> tuple[list[StackStatistics], list[StackStatistics]]:
    rng = np.random.default_rng(6)
    flat = np.full((side_px, side_px), 1.0)
    levels_e = np.linspace(0.06, 1.2, 20) * 7000
    lit = [stack_of(*(sensor.expose(e * flat, 1.0, rng) for _ in range(2))) for e in levels_e]
    return lit, [stack_of(*(sensor.expose(0 * flat, 1e-3, rng) for _ in range(2))) for _ in range(4)]


def test_sensor_gain_read_noise_and_saturation() -> None:
    lit, dark = exposed(replace(SENSOR, dark_current_e_per_s=0.0))
    found = photon_transfer([*dark, *lit[:11]], float(np.mean([s.mean_dn for s in dark])), "mono")
    for estimate, truth in ((found.gain_e_per_dn, GAIN_E_PER_DN), (found.read_noise_e, READ_NOISE_E)):
        # five standard deviations: a false alarm in 1.7 million runs
        assert abs(estimate.estimate - truth) < 5 * estimate.sd
        assert estimate.sd < 0.01 * truth
    assert found.read_noise_dn.estimate == pytest.approx(READ_NOISE_E / GAIN_E_PER_DN, rel=0.02)
    # the last level at which the full well of 7000 e clips hardly any draw: 0.96, just before 1.02
    assert saturation_level(lit) == 15
    assert saturation_level(lit[:15]) is None


def test_rounding_is_no_read_noise() -> None:
    # read noise 0.6 DN: with the variance of rounding (0.083 DN^2) in it, it would come out 11 % too large
    sensor = replace(SENSOR, read_noise_e=1.2, dark_current_e_per_s=0.0, prnu_rel=0.0, dsnu_e=0.0)
    lit, dark = exposed(sensor)
    found = photon_transfer([*dark, *lit[:11]], float(np.mean([s.mean_dn for s in dark])), "mono")
    assert abs(found.read_noise_e.estimate - 1.2) < 5 * found.read_noise_e.sd
    assert found.read_noise_e.sd < 0.015 * 1.2


def test_standard_deviation_of_the_read_noise_follows_from_the_line() -> None:
    lit, dark = exposed(replace(SENSOR, dark_current_e_per_s=0.0))
    found = photon_transfer([*dark[:1], *lit[:11]], float(np.mean([s.mean_dn for s in dark])), "mono")
    draws = np.random.default_rng(10).multivariate_normal(found.line.parameters, found.line.covariance, 100_000)
    expected = np.std(np.sqrt(draws[:, 0] - 1 / 12) / draws[:, 1])
    # 100 000 draws tell it to 0.2 %; the rest is first order
    assert found.read_noise_e.sd == pytest.approx(expected, rel=0.02)


def test_noise_of_the_variance_is_no_saturation() -> None:
    rng = np.random.default_rng(12)
    stacks = [stack_of(*rng.normal(1000, 20, (2, 40, 40))) for _ in range(30)]
    variance = [s.variance_dn2 for s in stacks]
    assert min(variance) < 0.95 * max(variance)
    assert saturation_level(stacks) is None
    assert saturation_level([*stacks, stack_of(*rng.normal(1000, 10, (2, 40, 40)))]) == int(np.argmax(variance))


def test_pattern_of_the_sensor_is_found_or_limited() -> None:
    rng = np.random.default_rng(7)
    flat = np.full((128, 128), 3500.0)

    def patterns(sensor: Sensor, number: int) -> tuple[float, float, float, float]:
        lit = stack_of(*(sensor.expose(flat, 1.0, rng) for _ in range(number)))
        dark = stack_of(*(sensor.expose(0 * flat, 1.0, rng) for _ in range(number)))
        dsnu, prnu = nonuniformity(dark, None, "spatial"), nonuniformity(lit, dark, "pixel_to_pixel")
        return dsnu.variance_dn2, dsnu.sd_dn2, prnu.variance_dn2, prnu.sd_dn2

    dsnu_dn2, dsnu_sd, prnu_dn2, prnu_sd = patterns(SENSOR, 16)
    assert abs(dsnu_dn2 - (DSNU_E / GAIN_E_PER_DN) ** 2) < 5 * dsnu_sd
    assert abs(prnu_dn2 - (PRNU_REL * 1750) ** 2) < 5 * prnu_sd
    clean = replace(SENSOR, prnu_rel=0.0, dsnu_e=0.0)
    dsnu_dn2, dsnu_sd, prnu_dn2, prnu_sd = patterns(clean, 4)
    for variance, sd in ((dsnu_dn2, dsnu_sd), (prnu_dn2, prnu_sd)):
        limit = root_of(variance, sd)
        assert abs(variance) < 5 * sd
        assert not limit.resolved
        # noise left in the mean of 4 lit frames is 15 DN; its variance is known to 2 %: a limit of 2.7 DN on average
        assert limit.low95 == 0.0 < limit.high95 < 5.0


def test_linearity_finds_a_known_bend_and_knows_noise() -> None:
    t = np.linspace(0.1, 1.0, 10)
    everywhere = np.ones(10, dtype=bool)
    straight = linearity(t, 5.0 + 900 * t, np.full(10, 1e-6), everywhere)
    assert straight.error_rel.estimate < 1e-12
    bent = linearity(t, 900 * t * (1 + 0.02 * t), np.full(10, 1e-5), everywhere)
    # a straight line through relative weights leaves residuals of the order of the bend
    assert 1e-4 < bent.error_rel.estimate < 0.02
    assert bent.error_rel.resolved
    # numpy's weighted polynomial fit gives the same line
    s = 900 * t * (1 + 0.02 * t)
    fitted = np.polyval(np.polyfit(t, s, 1, w=1 / s), t)
    np.testing.assert_allclose(bent.deviation_rel, (s - fitted) / fitted, atol=1e-12)
    noisy = linearity(
        t, 900 * t * (1 + 1e-3 * np.random.default_rng(8).standard_normal(10)), np.full(10, 1e-3), everywhere
    )
    assert not noisy.error_rel.resolved
    assert noisy.error_rel.high95 < 3e-3
    some = linearity(t, 900 * t, np.full(10, 1e-3), t < 0.75)
    assert np.isnan(some.deviation_rel).tolist() == (t >= 0.75).tolist()


def test_intervals_of_estimates() -> None:
    normal = normal_estimate(10.0, 1.0)
    assert (normal.low95, normal.high95) == pytest.approx((8.04, 11.96), abs=1e-3)
    resolved = root_of(100.0, 4.0, factor=0.5)
    assert (resolved.estimate, resolved.resolved) == (5.0, True)
    assert resolved.low95 == pytest.approx(0.5 * np.sqrt(100 - 1.95996 * 4), abs=1e-4)
    assert resolved.sd == pytest.approx(0.5 * 4 / (2 * 10), rel=0.01)  # first order
    negative = root_of(-1.0, 1.0)
    assert (negative.estimate, negative.low95, negative.resolved) == (0.0, 0.0, False)
    assert negative.high95 == pytest.approx(np.sqrt(1.64485), abs=1e-4)
    weak = non_negative(1.0, 1.0)
    assert (weak.low95, weak.resolved) == (0.0, False)
    assert weak.high95 == pytest.approx(2.64485, abs=1e-4)
    assert not non_negative(3.0, 1.0, low=2.0).resolved


# Frames that cannot be used.


def test_frames_of_unequal_size_are_refused() -> None:
    with pytest.raises(
        RadiometryError, match=r"test frames: frame 2 has 8 x 6 px, but the frames before it have 8 x 8 px; capture"
    ):
        stack_of(np.ones((8, 8)), np.ones((8, 6)))


def test_nan_is_refused() -> None:
    with pytest.raises(RadiometryError, match=r"test frames: frame 1 contains NaN or infinite counts"):
        stack_of(np.full((8, 8), np.nan), np.ones((8, 8)))


def test_single_frame_is_refused() -> None:
    with pytest.raises(RadiometryError, match=r"test frames: has 1 frame, but at least 2 frames of the same exposure"):
        stack_of(np.ones((8, 8)))


def test_region_without_second_differences_is_refused() -> None:
    with pytest.raises(RadiometryError, match=r"the region has 2 x 9 px, but 3 rows and columns of every channel"):
        stack_of(np.ones((2, 9)), np.ones((2, 9)))


def test_equal_frames_are_refused() -> None:
    frame = np.arange(64.0).reshape(8, 8)
    with pytest.raises(
        RadiometryError, match=r"mono: the frames of 3 of 3 exposures are identical \(variance 0 DN\^2\)"
    ):
        photon_transfer([stack_of(k * frame, k * frame) for k in (1, 2, 3)], 0.0, "mono")


def test_variance_that_does_not_grow_is_refused() -> None:
    rng = np.random.default_rng(9)
    stacks = [stack_of(*rng.normal(m, 10 - 0.08 * m, (2, 50, 50))) for m in (10, 40, 70, 100)]
    with pytest.raises(RadiometryError, match=r"mono: the variance does not grow with the signal \(-"):
        photon_transfer(stacks, 0.0, "mono")
