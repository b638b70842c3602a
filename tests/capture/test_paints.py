from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq, minimize_scalar

from data_schemas import CaptureError, CurveError, HiddenPaint
from rigs import simulated_rig
from rigs._rig_files import GREEN_PAINT, RED_PAINT
from rigs.simulated import bench_truth
from rigs.simulated._bench import (
    STEP_NM,
    WAVELENGTH_NM,
    hidden_paint_matrix,
    measured_material_matrix,
    sample_matrix,
    skew_cauchy_shape,
)

LASER_NM = 450.0
PAINTS = [RED_PAINT, GREEN_PAINT]


def at(x_nm: float, paint: HiddenPaint) -> float:
    return float(skew_cauchy_shape(np.array(x_nm), paint.mode_nm, paint.fwhm_nm, paint.asinh_skewness))


@pytest.mark.parametrize("paint", PAINTS, ids=lambda p: p.name)
def test_shape_has_the_given_mode_and_width(paint: HiddenPaint) -> None:
    peak = minimize_scalar(lambda x: -at(x, paint), bracket=(paint.mode_nm - 9.0, paint.mode_nm + 11.0))
    half = 0.5 * -peak.fun
    left = brentq(lambda x: at(x, paint) - half, 380.0, peak.x)
    right = brentq(lambda x: at(x, paint) - half, peak.x, 800.0)
    assert peak.x == pytest.approx(paint.mode_nm, abs=1e-4)  # a maximum is flat: its place is good to sqrt(eps)
    assert right - left == pytest.approx(paint.fwhm_nm, abs=1e-6)


def test_symmetric_shape_is_half_a_cauchy_curve() -> None:
    x_nm = np.linspace(400.0, 700.0, 31)
    expected = 0.5 / (1.0 + ((x_nm - 550.0) / 20.0) ** 2)
    np.testing.assert_allclose(skew_cauchy_shape(x_nm, 550.0, 40.0, 0.0), expected, rtol=1e-9)


def test_shape_agrees_with_tabulated_mode_offset_of_the_family() -> None:
    # asinh skewness 2: the mode lies 0.334 scales above the location and the width is 1.420 scales.
    scale_nm = 48.0 / 1.420
    location_nm = 597.0 - 0.334 * scale_nm
    z = (np.array([560.0, 597.0, 650.0]) - location_nm) / scale_nm
    expected = (np.arctan(np.sinh(2.0) * z) / np.pi + 0.5) / (1.0 + z**2)
    # three printed digits of the table
    np.testing.assert_allclose(skew_cauchy_shape(location_nm + scale_nm * z, 597.0, 48.0, 2.0), expected, rtol=2e-3)


@pytest.mark.parametrize("paint", PAINTS, ids=lambda p: p.name)
def test_column_at_the_laser_is_the_pure_family_and_carries_the_energy_yield(paint: HiddenPaint) -> None:
    matrix = hidden_paint_matrix(paint, LASER_NM, WAVELENGTH_NM)
    column = matrix.emission_at(LASER_NM)
    area, _ = quad(lambda x: at(x, paint), 455.0, 780.0, epsabs=1e-12)
    x_nm = np.arange(470.0, 781.0)
    expected = paint.energy_yield * np.array([at(x, paint) for x in x_nm]) / area
    # the matrix is normalised by the trapezoid rule on 0.5 nm, whose cut edge may be off by one sample of 0.5 nm
    np.testing.assert_allclose(column(x_nm), expected, rtol=1e-3)
    assert (column.values[column.wavelength_nm <= 455.0] == 0).all()


@pytest.mark.parametrize("paint", PAINTS, ids=lambda p: p.name)
def test_energy_is_conserved_and_nothing_is_emitted_below_the_excitation(paint: HiddenPaint) -> None:
    matrix = hidden_paint_matrix(paint, LASER_NM, WAVELENGTH_NM)
    emitted = np.trapezoid(matrix.radiance_factor_per_nm, WAVELENGTH_NM, axis=0)
    assert (matrix.reflectance.values + emitted <= 1.0).all()
    assert (matrix.radiance_factor_per_nm >= 0).all()
    assert not np.triu(matrix.radiance_factor_per_nm).any()
    assert emitted[0] > 0.2
    assert emitted[-1] == 0.0
    assert matrix.reflectance(LASER_NM) == pytest.approx(paint.reflectance_at_laser, abs=0.01)
    assert matrix.reflectance(780.0) == pytest.approx(paint.reflectance_long_wavelength, abs=1e-3)


def test_monochromatic_light_returns_its_column() -> None:
    matrix = hidden_paint_matrix(RED_PAINT, LASER_NM, WAVELENGTH_NM)
    light = np.zeros(len(WAVELENGTH_NM))
    light[np.searchsorted(WAVELENGTH_NM, 500.0)] = 1.0 / STEP_NM
    np.testing.assert_allclose(
        matrix.radiance_factor_per_nm @ light * STEP_NM, matrix.emission_at(500.0).values, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"absorption_peak_nm": 600.0}, r"absorption_peak_nm = 600 must be below mode_nm = 597 nm"),
        ({"absorption_peak_nm": 300.0, "mode_nm": 480.0}, r"absorbs only up to 390 nm, but the laser is at 450 nm"),
        ({"energy_yield": 0.99}, r"energy_yield = 0.99 means that more light is emitted than absorbed"),
    ],
)
def test_contradicting_paint_is_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(CurveError, match=message):
        hidden_paint_matrix(RED_PAINT.model_copy(update=change), LASER_NM, WAVELENGTH_NM)


@pytest.mark.parametrize("paint", PAINTS, ids=lambda p: p.name)
def test_truth_of_a_hidden_paint(paint: HiddenPaint) -> None:
    truth = bench_truth(simulated_rig(paint.name), Path())
    assert truth.mode_nm == pytest.approx(paint.mode_nm, abs=0.011)  # searched in steps of 0.01 nm
    assert truth.fwhm_nm == pytest.approx(paint.fwhm_nm, abs=0.021)
    assert truth.energy_yield == pytest.approx(paint.energy_yield, rel=1e-3)  # half a step at the cut edge
    assert truth.emission.wavelength_nm[[0, -1]].tolist() == [470.0, 780.0]
    assert truth.reflectance_at_laser == pytest.approx(0.05, abs=0.01)


@pytest.fixture
def material(tmp_path: Path) -> Path:
    """A measured matrix with a Gaussian emission around 560 nm, some negative noise and a sloping diagonal."""
    emission_nm, excitation_nm = np.arange(380, 781, 10), np.arange(300, 781, 10)
    band = 0.05 * np.exp(-0.5 * ((emission_nm - 560.0) / 25.0) ** 2) - 0.0005
    values = np.where(emission_nm[:, None] > excitation_nm[None, :], band[:, None], 0.0)
    values += np.where(emission_nm[:, None] == excitation_nm[None, :], (emission_nm[:, None] - 300) / 600, 0.0)
    rows = [f"{e}," + ",".join(f"{v:.9g}" for v in row) for e, row in zip(emission_nm, values, strict=True)]
    path = tmp_path / "yellow.csv"
    path.write_text("emission_nm," + ",".join(map(str, excitation_nm)) + "\n" + "\n".join(rows) + "\n")
    return path


def test_measured_material_keeps_its_bands_and_clips_noise(material: Path) -> None:
    matrix = measured_material_matrix(material, WAVELENGTH_NM)
    column = matrix.emission_at(450.0)
    assert column(560.0) == pytest.approx(0.0495 / 10)
    assert (matrix.radiance_factor_per_nm >= 0).all()
    assert matrix.emission_at(360.0)(365.0) == 0.0
    assert matrix.reflectance(450.0) == pytest.approx(0.25)


def test_truth_of_a_measured_material_comes_from_its_bands(material: Path) -> None:
    truth = bench_truth(simulated_rig(str(material)), Path("/"))
    bands_nm = np.arange(470.0, 781.0, 10.0)
    band = np.clip((0.05 * np.exp(-0.5 * ((bands_nm - 560.0) / 25.0) ** 2) - 0.0005) / 10, 0, None)
    curve = PchipInterpolator(bands_nm, band)
    half = 0.5 * band.max()
    width = brentq(lambda x: curve(x) - half, 560, 700) - brentq(lambda x: curve(x) - half, 480, 560)
    assert truth.mode_nm == 560.0
    assert truth.fwhm_nm == pytest.approx(width, abs=0.021)
    assert truth.energy_yield == pytest.approx(quad(curve, 470.0, 780.0, limit=200)[0], rel=2e-3)


def test_missing_material_and_missing_table_are_named(tmp_path: Path) -> None:
    with pytest.raises(CurveError, match=r"none\.csv: no such file"):
        sample_matrix(simulated_rig("none.csv"), tmp_path)
    bare = simulated_rig("red").model_copy(update={"simulated": None})
    with pytest.raises(CaptureError, match=r"has no \[simulated\] table"):
        sample_matrix(bare, tmp_path)


@pytest.mark.shared_data
@pytest.mark.parametrize(
    ("name", "mode_nm", "peak_per_band", "reflectance"),
    # sanity values of the data's own description, three printed digits
    [("hercules_orange_ink", 600.0, 0.058, 0.036), ("textile_yellow", 510.0, 0.086, 0.027)],
)
def test_truth_of_published_materials(
    shared_data: Path, name: str, mode_nm: float, peak_per_band: float, reflectance: float
) -> None:
    truth = bench_truth(simulated_rig(f"materials/{name}.csv"), shared_data / "spectra")
    assert truth.mode_nm == mode_nm
    assert truth.emission.values.max() * 10.0 == pytest.approx(peak_per_band, abs=6e-4)
    assert truth.reflectance_at_laser == pytest.approx(reflectance, abs=6e-4)
