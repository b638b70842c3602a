"""The reduced matrix against scipy's integration of the closed forms."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from data_schemas import CurveError, SpectralCurve
from data_schemas.storage import read_light
from finray_calib.exchange import assumed_led, led_camera_matrix
from finray_calib.exchange._paint_reradiation import led_camera_json
from tests.exchange.conftest import LASER_NM, SD_REL, absorption, emission, reflectance

CENTER_NM, WIDTH_NM = (600.0, 535.0, 460.0), 40.0
# Curves are linear between samples 1 nm apart: the error of a Gaussian of 20 nm is 1 / (8 20^2) = 3e-4, that of the
# absorption's edge 1 / (8 12^2) = 9e-4.
INTERPOLATION_REL = 1.2e-3


def response(channel, wavelength_nm):
    return np.exp(-0.5 * ((wavelength_nm - CENTER_NM[channel]) / WIDTH_NM) ** 2)


def led(wavelength_nm, center_nm, sd_nm):
    return np.exp(-0.5 * ((wavelength_nm - center_nm) / sd_nm) ** 2)


@pytest.fixture(scope="module")
def camera():
    x = np.arange(380.0, 781.0)
    return tuple(SpectralCurve(name=f"c{c}", wavelength_nm=x, values=response(c, x), source="test") for c in range(3))


def light(center_nm, sd_nm=8.0):
    x = np.arange(center_nm - 48, center_nm + 48.5, 0.5)
    return SpectralCurve(name="led", wavelength_nm=x, values=7.0 * led(x, center_nm, sd_nm), source="test")


# The second light excites within the emission, where the edge out = in matters.
@pytest.mark.parametrize("center_nm", [450.0, 575.0])
def test_equals_scipy(spectra, camera, center_nm):
    matrix = led_camera_matrix(spectra, [light(center_nm)], camera)
    low, high = center_nm - 48, center_nm + 48
    area = quad(led, low, high, args=(center_nm, 8.0))[0]
    for c in range(3):

        def seen(out_nm, c=c):
            return emission(out_nm) * response(c, out_nm)

        def fluoresced(in_nm):
            beyond = quad(seen, in_nm, 780.0, points=[p for p in (600.0,) if p > in_nm])[0]
            return led(in_nm, center_nm, 8.0) * absorption(in_nm) * in_nm / LASER_NM * beyond

        def reflected(in_nm, c=c):
            return led(in_nm, center_nm, 8.0) * reflectance(in_nm) * response(c, in_nm)

        np.testing.assert_allclose(
            matrix.fluorescent[c, 0], quad(fluoresced, low, high, limit=200)[0] / area, rtol=INTERPOLATION_REL
        )
        kinks = [k for k in (450.0, 600.0) if low < k < high]
        np.testing.assert_allclose(
            matrix.reflected[c, 0], quad(reflected, low, high, points=kinks)[0] / area, rtol=INTERPOLATION_REL
        )


def test_uncertainty_of_a_common_factor_is_that_factor(spectra, camera):
    matrix = led_camera_matrix(spectra, [light(450.0)], camera)
    np.testing.assert_allclose(matrix.fluorescent_sd, SD_REL * matrix.fluorescent, rtol=1e-6)  # float rounding only


def test_uncertainty_of_reflectance_at_one_filter(spectra, camera):
    narrow = SpectralCurve(name="line", wavelength_nm=[449.9, 450.0, 450.1], values=[0.0, 1.0, 0.0], source="test")
    matrix = led_camera_matrix(spectra, [narrow], camera)
    # a line at the filter's centre feels that filter's reflectance alone, up to its width of 0.1 nm in 45 nm
    np.testing.assert_allclose(matrix.reflected_sd, 0.02 * matrix.white, rtol=0.005)
    np.testing.assert_allclose(matrix.reflected, 0.08 * matrix.white, rtol=0.005)


def test_two_lights_stand_side_by_side(spectra, camera):
    both = led_camera_matrix(spectra, [light(450.0), light(520.0)], camera)
    assert both.fluorescent.shape == (3, 2)
    alone = led_camera_matrix(spectra, [light(520.0)], camera)
    np.testing.assert_array_equal(both.fluorescent[:, 1:], alone.fluorescent)
    np.testing.assert_array_equal(both.reflected[:, 1:], alone.reflected)


def test_paint_without_emission_only_reflects(spectra, camera):
    dark = replace(spectra, emission_draws_per_nm=np.zeros_like(spectra.emission_draws_per_nm))
    assert not led_camera_matrix(dark, [light(450.0)], camera).fluorescent.any()


def test_light_outside_the_absorption_is_refused(spectra, camera):
    short = replace(
        spectra,
        excitation_nm=spectra.excitation_nm[200:],
        absorption_rel=spectra.absorption_rel[200:],
        absorption_rel_draws=spectra.absorption_rel_draws[:, 200:],
    )
    with pytest.raises(CurveError, match=r"covers only 500 to 780 nm, and .* of the weight of led lies outside"):
        led_camera_matrix(short, [light(450.0)], camera)


def test_unpaired_draws_are_refused(spectra):
    with pytest.raises(CurveError, match=r"absorption_rel_draws has shape \(399, 481\), but .* \(400, 481\)"):
        replace(spectra, absorption_rel_draws=spectra.absorption_rel_draws[1:])


def test_assumed_led_has_its_width():
    led_curve = assumed_led()
    np.testing.assert_allclose(led_curve([440.0, 450.0, 460.0]), [0.5, 1.0, 0.5])
    assert led_curve.source == "assumed"


def test_json_names_rows_columns_and_what_is_assumed(spectra, camera, origin):
    loaded = json.loads(led_camera_json(spectra, [assumed_led()], camera, origin))
    assert loaded["rows"] == ["red", "green", "blue"]
    assert loaded["columns"] == ["LED, 450 nm, FWHM 20 nm (assumed)"]
    total = np.array(loaded["reflected"]) + np.array(loaded["fluorescent"])
    np.testing.assert_allclose(loaded["total"], total, rtol=1e-5)  # six digits are written
    assert loaded["absorption"] == spectra.statement
    assert loaded["warnings"] == list(spectra.warnings)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wavelength_nm,power\n440,1\n450,2\n", "a light needs wavelength_nm,power_rel"),
        ("wavelength_nm,power_rel\n440,-1\n450,2\n", "power_rel must be at least 0"),
        ("wavelength_nm,power_rel\n440,0\n450,0\n", "above 0 in one or more"),
        ("wavelength_nm,power_rel\n450,1\n440,2\n", "wavelengths must increase"),
    ],
)
def test_bad_light_files(tmp_path, text, message):
    (tmp_path / "led.csv").write_text(text)
    with pytest.raises(CurveError, match=message):
        read_light(tmp_path / "led.csv")


def test_light_file_is_read(tmp_path):
    (tmp_path / "led.csv").write_text("# measured\nwavelength_nm,power_rel\n440,1\n450,2\n")
    curve = read_light(tmp_path / "led.csv")
    assert (curve.name, curve.values.tolist()) == ("led", [1.0, 2.0])
