import numpy as np
import pytest

from data_schemas import LightPanel, SimulateError
from sim.optics import PaintOptics, camera_matrix, paint_bands
from sim.optics._paint_bands import band_mean, led_band, led_upper_edge_nm
from tests.simulate.conftest import gaussian

LIGHT = LightPanel()
W = np.arange(380.0, 781.0, 1.0)
# trapezoid rule on a smooth, well resolved Gaussian
QUADRATURE = 1e-6


def paint(name="paint", peak=0.004, center=600.0, reflectance=0.3, wavelength=W):
    emission = gaussian(wavelength, center, 15.0, peak)
    return PaintOptics(name, wavelength, emission, np.full(wavelength.size, reflectance))


def test_bands_have_unit_integral_and_the_energy_conversion_is_the_gaussian_area():
    result = paint_bands(paint("red"), paint("green", center=530.0, peak=0.002), LIGHT)
    for band in result.bands:
        assert np.trapezoid(band.density_per_nm, band.wavelength_nm) == pytest.approx(1.0, rel=1e-12)
    area = 15.0 * np.sqrt(2.0 * np.pi)
    assert result.energy_conversion["red"] == pytest.approx(0.004 * area, rel=QUADRATURE)
    # the LED's edge lies 3.6 standard deviations below this emission: 1.5e-4 of it is cut
    assert result.energy_conversion["green"] == pytest.approx(0.002 * area, rel=3e-4)
    assert [band.centroid_nm for band in result.bands] == pytest.approx([600.0, 530.0, 450.0], abs=0.05)


def test_a_paint_that_makes_photons_is_refused_although_its_energy_is_less():
    # 0.35 reflected and 0.55 of the energy at 620 nm: 0.9 of the energy, and 0.35 + 0.55 x 620 / 450 = 1.108 photons
    area = 15.0 * np.sqrt(2.0 * np.pi)
    bright = paint("bright", peak=0.55 / area, center=620.0, reflectance=0.35)
    with pytest.raises(SimulateError, match=r"paint bright returns 1\.108 photons for each photon at 450 nm"):
        paint_bands(bright, paint("green", center=530.0), LIGHT)


def test_the_led_has_its_width_and_edge():
    band = led_band(LIGHT)
    half = band.wavelength_nm[band.density_per_nm >= band.density_per_nm.max() / 2.0]
    assert half[-1] - half[0] == pytest.approx(20.0, abs=1.0)  # grid of 0.5 nm
    edge = np.interp(led_upper_edge_nm(LIGHT), band.wavelength_nm, band.density_per_nm / band.density_per_nm.max())
    assert edge == pytest.approx(0.01, rel=0.01)  # linear interpolation on the 0.5 nm grid


def test_emission_below_the_leds_edge_is_cut_and_reported():
    edge = led_upper_edge_nm(LIGHT)
    result = paint_bands(paint("red", center=edge), paint("green", center=600.0), LIGHT)
    assert result.cut_share["red"] == pytest.approx(0.5, abs=1e-3)  # half of a Gaussian centred on the edge
    assert result.cut_share["green"] == pytest.approx(0.0, abs=QUADRATURE)
    assert result.bands[0].wavelength_nm[0] == pytest.approx(edge)


def test_band_reflectance_of_a_linear_curve_is_its_value_at_the_centroid():
    linear = PaintOptics("red", W, gaussian(W, 600.0, 15.0, 0.004), (W - 380.0) / 800.0)
    result = paint_bands(linear, paint("green", center=530.0), LIGHT)
    expected = [(band.centroid_nm - 380.0) / 800.0 for band in result.bands]
    np.testing.assert_allclose(result.reflectance["red"], expected, rtol=QUADRATURE)
    np.testing.assert_allclose(result.reflectance["green"], 0.3, rtol=1e-12)


def test_camera_matrix_of_a_flat_and_a_linear_response():
    bands = paint_bands(paint("red"), paint("green", center=530.0), LIGHT)
    response = np.stack([np.ones(W.size), W / 1000.0, np.zeros(W.size)])
    matrix = camera_matrix(response, W, bands)
    np.testing.assert_allclose(matrix[0], 1.0, rtol=1e-12)
    np.testing.assert_allclose(matrix[1], [b.centroid_nm / 1000.0 for b in bands.bands], rtol=QUADRATURE)
    np.testing.assert_array_equal(matrix[2], 0.0)


def test_a_response_of_the_wrong_shape_is_refused():
    bands = paint_bands(paint("red"), paint("green"), LIGHT)
    with pytest.raises(SimulateError, match=r"shape \(3, 401\)"):
        camera_matrix(np.ones((W.size, 3)), W, bands)


def test_a_paint_that_gains_energy_is_refused():
    area = 15.0 * np.sqrt(2.0 * np.pi)
    with pytest.raises(SimulateError, match="paint glow returns more energy than the LED brings"):
        paint_bands(paint("glow", peak=0.71 / area, reflectance=0.3), paint(), LIGHT)
    paint_bands(paint("bright", peak=0.5 / area, reflectance=0.3), paint(), LIGHT)


@pytest.mark.parametrize("wavelength", [W, np.arange(380.0, 470.0)])
def test_a_paint_without_emission_above_the_led_is_refused(wavelength):
    dark = PaintOptics("dark", wavelength, np.zeros(wavelength.size), np.full(wavelength.size, 0.3))
    with pytest.raises(SimulateError, match="paint dark has no emission above the LED's upper edge at 476 nm"):
        paint_bands(dark, paint(), LIGHT)


def test_a_curve_that_misses_a_band_is_refused_and_a_small_gap_holds_the_end_value():
    band = led_band(LIGHT)
    with pytest.raises(SimulateError, match="reflectance of x is known only from 450 to 600 nm, so 49 % of a band"):
        band_mean(np.array([450.0, 600.0]), np.array([0.2, 0.2]), band, "reflectance of x")
    value = band_mean(
        np.array([445.0, 446.0, 600.0]), np.array([0.2, 0.2, 0.2]), led_band(LightPanel(fwhm_nm=8.0)), "x"
    )
    assert value == pytest.approx(0.2, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"reflectance": np.full(3, 0.2)}, "equally long lists"),
        ({"wavelength_nm": np.array([400.0, 400.0])}, "wavelength_nm must increase"),
        ({"emission_per_nm": np.array([np.nan, 0.0])}, "must be finite"),
        ({"emission_per_nm": np.array([-1e-3, 0.0])}, "emission_per_nm must be 0 or more"),
        ({"reflectance": np.array([0.2, 1.2])}, r"reflectance from 0 to 1"),
    ],
)
def test_impossible_paints_are_refused(change, match):
    values = {
        "name": "p",
        "wavelength_nm": np.array([400.0, 700.0]),
        "emission_per_nm": np.zeros(2),
        "reflectance": np.full(2, 0.2),
    }
    with pytest.raises(SimulateError, match=match):
        PaintOptics(**(values | change))
