from pathlib import Path

import colour
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter

from data_schemas import BandPassFilter, LaserSettings, RigFile, bayer_planes
from data_schemas.storage import camera_response, halogen_lamp, planck_relative
from rigs.simulated import Bench, bench_scene
from rigs.simulated._bench import (
    FILTER_TOLERANCE_NM,
    LAMP_LEVEL_E_PER_S_NM,
    LASER_PEDESTAL_FWHM_NM,
    LASER_PEDESTAL_REL,
    PEAK_QUANTUM_EFFICIENCY,
    STEP_NM,
    TEXTURE_LENGTH_CELLS,
    WAVELENGTH_NM,
    colour_checker_reflectances,
    filter_transmission,
    laser_line,
)

FILTER = BandPassFilter(slot=1, name="600", center_nm=600.0)


@pytest.fixture(scope="module")
def bench(rig: RigFile) -> Bench:
    return Bench(rig, Path(), camera_response(rig.camera.response, Path()))


def full_width_nm(wavelength_nm: np.ndarray, values: np.ndarray) -> float:
    above = wavelength_nm[values >= 0.5 * values.max()]
    return float(above[-1] - above[0])


def test_filters_are_flat_topped_and_near_their_nominal_data() -> None:
    fine_nm = np.linspace(580.0, 620.0, 40_001)
    near = [filter_transmission(fine_nm, FILTER, np.random.default_rng(n)) for n in range(30)]
    centers = [float(fine_nm[t >= 0.5 * t.max()].mean()) for t in near]
    widths = [full_width_nm(fine_nm, t) for t in near]
    assert np.abs(np.array(centers) - 600.0).max() <= FILTER_TOLERANCE_NM + 1e-3  # the grid's step
    assert np.abs(np.array(widths) - 10.0).max() <= FILTER_TOLERANCE_NM + 2e-3
    assert np.std(centers) > 0.05
    for transmission in near:
        assert transmission.max() == pytest.approx(0.6, abs=1e-4)
        # a Gaussian of the same width would be down to 0.75 of its peak 3.2 nm off centre
        assert transmission[np.searchsorted(fine_nm, 603.2)] > 0.85 * 0.6


def test_blocking_differs_from_nominal_as_stated() -> None:
    far = np.array([450.0])
    od = [-np.log10(filter_transmission(far, FILTER, np.random.default_rng(n))[0]) for n in range(400)]
    assert np.mean(od) == pytest.approx(5.0, abs=5 * 0.15 / 20)  # 5 standard errors of 400 draws
    assert np.std(od) == pytest.approx(0.15, rel=5 / np.sqrt(800))


def test_laser_has_unit_power_its_width_and_a_weak_pedestal() -> None:
    fine_nm = np.linspace(380.0, 520.0, 140_001)
    line = laser_line(fine_nm, LaserSettings())
    assert np.trapezoid(line, fine_nm) == pytest.approx(1.0, abs=1e-3)  # the pedestal adds 0.08 %
    assert full_width_nm(fine_nm, line) == pytest.approx(2.0, abs=2e-3)
    pedestal = line[np.searchsorted(fine_nm, 455.0)] / line.max()
    assert 1e-5 < pedestal < 1e-4


@pytest.mark.parametrize("fwhm_nm", [0.01, 0.1, 0.5, 1.0, 2.0, 8.0])
@pytest.mark.parametrize("wavelength_nm", [450.0, 450.1, 450.25, 532.4])
def test_a_laser_of_any_width_has_unit_power_on_the_steps_of_the_bench(wavelength_nm: float, fwhm_nm: float) -> None:
    line = laser_line(WAVELENGTH_NM, LaserSettings(wavelength_nm=wavelength_nm, fwhm_nm=fwhm_nm))
    # the pedestal adds 5e-5 times 30 nm over the width, at least a width of two steps
    pedestal = LASER_PEDESTAL_REL * LASER_PEDESTAL_FWHM_NM / max(fwhm_nm, 2.0 * STEP_NM)
    assert STEP_NM * line.sum() == pytest.approx(1.0 + pedestal, abs=1e-5)
    # symmetric about the line, wherever it lies between two steps; 1e-6 is what the steps leave
    assert np.average(WAVELENGTH_NM, weights=line) == pytest.approx(wavelength_nm, abs=1e-4)


def test_lamp_agrees_with_cie_standard_illuminant_a() -> None:
    illuminant = colour.SDS_ILLUMINANTS["A"]
    expected = np.array([illuminant[float(x)] for x in range(400, 781, 20)]) / 100.0
    # illuminant A is defined with older radiation constants: 2855.5 K in today's, 0.07 % at 400 nm
    np.testing.assert_allclose(halogen_lamp()(np.arange(400, 781, 20)), expected, rtol=1e-3)
    assert planck_relative(np.array([560.0]), 5000.0)[0] == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(("slot", "channel"), [(1, 2), (3, 1), (6, 0), (8, 0)])
def test_band_electrons_agree_with_adaptive_quadrature(bench: Bench, rig: RigFile, slot: int, channel: int) -> None:
    optic = rig.filter_wheel.filters[slot - 1]
    rng = np.random.default_rng([rig.simulated.seed, 1])
    for earlier in rig.filter_wheel.filters[:slot]:
        off_center_nm, off_width_nm = rng.uniform(-0.2, 0.2, 2)
        floor = 10.0 ** -(earlier.blocking_od + 0.15 * rng.standard_normal())
    response = camera_response(rig.camera.response, Path())[channel]

    def integrand(x_nm: float) -> float:
        distance = abs(2 * (x_nm - optic.center_nm - off_center_nm) / (optic.fwhm_nm + off_width_nm))
        transmission = 0.6 * 2.0 ** -(distance**4.8) + floor
        lamp = (x_nm / 560.0) ** -5 * np.expm1(1.438776877e7 / 560 / 2856) / np.expm1(1.438776877e7 / x_nm / 2856)
        return transmission * lamp * float(response(x_nm))

    edges = [optic.center_nm - 12, optic.center_nm, optic.center_nm + 12]
    spans = zip([360.0, *edges], [*edges, 800.0], strict=True)
    expected = sum(quad(integrand, a, b, limit=2000, epsrel=1e-6)[0] for a, b in spans)
    got = bench.band_electrons_per_s(bench.lights["lamp"], slot)[channel]
    # 0.5 nm steps against the response's kinks every 2 nm
    assert got == pytest.approx(LAMP_LEVEL_E_PER_S_NM * PEAK_QUANTUM_EFFICIENCY * expected, rel=1e-4)


def test_laser_on_white_is_seen_at_its_filter_only(bench: Bench) -> None:
    white = 0.98 * bench.lights["laser"]
    at_450, at_600 = (bench.band_electrons_per_s(white, slot).max() for slot in (2, 6))
    assert at_600 / at_450 < 1e-4


def test_fluorescence_lifts_the_sample_under_the_laser_only_at_its_emission(bench: Bench) -> None:
    laser = bench.lights["laser"]
    sample = bench.sample_radiance(laser)
    at_laser, at_emission = np.searchsorted(WAVELENGTH_NM, [450.0, 600.0])
    assert sample[at_laser] == pytest.approx(0.05 * laser[at_laser], rel=1e-3)
    assert sample[at_emission] > 1e3 * laser[at_emission]


def test_frame_shows_bright_sample_and_dark_cloth(bench: Bench) -> None:
    planes = bayer_planes(bench.electrons_per_s("white", "lamp", 6))
    height, width, _ = planes.shape
    center, corner = planes[height // 2, width // 2, 0], planes[2, 2, 0]
    assert corner / center == pytest.approx(0.04 / 0.98, rel=0.2)  # up to 15 % gradient and 5 % texture between them
    assert not bench.darkness().any()
    assert bench.darkness().shape == (128, 160)


def test_laser_spot_falls_to_about_60_percent_at_the_edge_of_the_region() -> None:
    scene = bench_scene(512, 640, seed=1)
    half = 55
    region = scene.laser[256 - half : 256 + half, 320 - half : 320 + half]
    top, left = np.unravel_index(scene.laser.argmax(), scene.laser.shape)
    assert (top, left) != (256, 320)
    edges = [region[0].mean(), region[-1].mean(), region[:, 0].mean(), region[:, -1].mean()]
    assert 0.5 < min(edges) < 0.75
    for texture in scene.texture.values():
        assert 0.01 < texture.std() < 0.02
        assert texture.mean() == pytest.approx(1.0, abs=1e-12)


def test_texture_and_fixed_pattern_share_no_random_numbers() -> None:
    texture = bench_scene(64, 64, seed=3).texture["white"]
    for seed in (3, [3, 4]):
        draws = np.random.default_rng(seed).standard_normal((64, 64))
        # Smoothing over some 25 cells leaves about 160 independent values: 5 / sqrt(160) is 0.4, the shared stream 0.9.
        smooth = gaussian_filter(draws, TEXTURE_LENGTH_CELLS, mode="wrap")
        assert abs(np.corrcoef(texture.ravel(), smooth.ravel())[0, 1]) < 0.4


def test_room_light_frame_shows_the_colour_checker(bench: Bench) -> None:
    scene = bench_scene(64, 80, seed=1)
    assert sorted(set(scene.patch.ravel())) == list(range(-1, 25))
    planes = bayer_planes(bench.electrons_per_s("sample beside ColorChecker", "room", None))
    mean = {n: planes[scene.patch == n].mean(axis=0) for n in range(25)}
    greys = [mean[n][1] for n in range(19, 25)]  # the last row runs from white to black
    assert greys == sorted(greys, reverse=True)
    assert mean[15][0] > 2 * mean[15][2]  # patch 15 is red
    assert mean[13][2] > mean[13][0]  # patch 13 is blue
    assert mean[0][1] < mean[24][1]  # the board is darker than the black patch


def test_colour_checker_reflectances_are_reflectances() -> None:
    reflectances = colour_checker_reflectances(np.array([450.0, 550.0, 650.0]))
    assert reflectances.shape == (24, 3)
    assert (reflectances > 0.02).all()
    assert (reflectances < 0.95).all()
    assert reflectances[18].min() > 0.85


def test_laser_light_bleaches_the_emission_and_nothing_else(rig: RigFile) -> None:
    paint = rig.simulated.paint.model_copy(update={"bleaching_per_j": 2.0})
    fading = rig.model_copy(update={"simulated": rig.simulated.model_copy(update={"paint": paint})})
    faded = Bench(fading, Path(), camera_response(rig.camera.response, Path()))
    inside = np.s_[60:68, 76:84]

    def left(light: str, slot: int, dose_j: float, target: str = "sample") -> float:
        fresh, later = (faded.electrons_per_s(target, light, slot, d)[inside].mean() for d in (0.0, dose_j))
        return later / fresh

    # behind 600 nm the laser shows emission alone (reflected laser is blocked to 1e-5, the emission is above 1e-2)
    assert left("laser", 6, 0.3) == pytest.approx(np.exp(-2.0 * 0.3), rel=2e-3)
    # behind 450 nm it shows reflected light: the emission's tail there is about 1 % of it
    assert left("laser", 2, 0.3) == pytest.approx(1.0, abs=0.02)
    assert np.exp(-0.6) < left("lamp", 6, 0.3) < 1.0
    assert left("laser", 6, 0.3, "white") == 1.0


def test_paint_without_bleaching_stays(bench: Bench) -> None:
    fresh, later = (bench.electrons_per_s("sample", "laser", 6, dose_j) for dose_j in (0.0, 100.0))
    np.testing.assert_array_equal(fresh, later)
