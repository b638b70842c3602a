"""The lamp as an instrument: temperature or measured spectrum, its uncertainty in band values and in the rig file."""

import numpy as np
import pytest

from data_schemas import CurveError, LampSettings, RigFile
from data_schemas.storage import halogen_lamp, lamp_curve, planck_relative, read_toml
from finray_calib.fit import band_data
from finray_calib.spectra import lamp_response, rig_emission_weights
from rigs import simulated_rig, write_rig
from rigs.simulated import Bench
from rigs.simulated._bench import WAVELENGTH_NM

CHANNELS = np.array([0.01, 0.09, 0.9])


def test_band_values_move_with_the_lamp_as_new_weights_say(optics):
    """Weights made anew at 2866 K against the derivative: Wien's law in place of Planck's, and 10 K, cost 2 %."""
    curve = np.exp(-0.5 * ((np.arange(380.0, 781.0) - 580) / 25) ** 2)
    stated = optics.model_copy(update={"lamp_temperature_uncertainty_k": 10.0})
    hotter = optics.model_copy(update={"lamp": halogen_lamp(2866.0)})
    told, real = rig_emission_weights(stated, CHANNELS), rig_emission_weights(hotter, CHANNELS)
    signals = told.emission @ curve, real.emission @ curve
    seen = (signals[0] > 1e-3 * signals[0].max()) & (told.leaked_white < 0.01)
    # the true lamp is hotter than the stated one: measured values are those of the hotter weights
    assert lamp_response(stated, CHANNELS)[seen] == pytest.approx(
        np.log(signals[1] / signals[0])[seen], rel=0.03, abs=1e-4
    )
    assert seen.sum() > 6


def test_bands_far_from_the_laser_move_most_and_its_own_hardly(optics):
    moved = lamp_response(optics, CHANNELS).reshape(8, 3)
    assert abs(moved[1, 2]) < 0.005
    red = moved[5, 0]  # 50 K change the ratio of 450 to 600 nm by 5 %
    assert red == pytest.approx(1.438776877e7 / 2856.0**2 * (1 / 450 - 1 / 600) * 50, rel=0.03)


def test_a_lamp_is_named_by_temperature_or_file(tmp_path):
    assert LampSettings(spectrum="planck-3000K").temperature_k == 3000.0
    grid = np.arange(360.0, 801.0, 10.0)
    table = "\n".join(f"{x:g},{y:.6g}" for x, y in zip(grid, planck_relative(grid, 2700.0), strict=True))
    (tmp_path / "lamp.csv").write_text(f"wavelength_nm,power_rel\n{table}\n")
    measured = lamp_curve(LampSettings(spectrum="lamp.csv", temperature_uncertainty_k=15.0), tmp_path)
    assert measured(550.0) == pytest.approx(planck_relative(np.array([550.0]), 2700.0)[0], rel=1e-5)
    assert lamp_curve(LampSettings(spectrum="planck-2700K"), tmp_path)(450.0) < lamp_curve(LampSettings(), tmp_path)(
        450.0
    )


def test_errors_common_to_all_values_do_not_pull_the_level_down(red_bands):
    """Peelle's puzzle: a white reference known to 10 %, a lamp to 50 K, filters to 1 % and values to 0.5 %."""
    mu, rng, levels = red_bands.fluorescence.ravel(), np.random.default_rng(4), []
    white = red_bands.optics.white_reference.model_copy(update={"uncertainty_rel": 0.1})
    optics = red_bands.optics.model_copy(update={"white_reference": white})
    for _ in range(100):
        y = mu * (1 + 0.005 * rng.standard_normal(mu.size)) * (1 + 0.01 * rng.standard_normal(8).repeat(3))
        covariance = np.diag((0.005 * y) ** 2) + 0.1**2 * np.outer(y, y)
        drawn = {"optics": optics, "fluorescence": y.reshape(-1, 3), "fluorescence_covariance": covariance}
        data = band_data(red_bands.model_copy(update=drawn))
        levels.append([estimated_level(found, y, mu) for found in (data, data.at(mu))])
    measured, fitted = np.mean(levels, axis=0)
    assert measured < 0.97  # what the fit would do without a reference
    assert fitted == pytest.approx(1.0, abs=4 * np.std(levels, axis=0)[1] / 10)


def estimated_level(data, y, mu):
    """Return the least-squares factor of the known values of a paint."""
    kept = data.kept
    columns = np.column_stack([data.imperfections(), (data.lamp_response_rel * data.level)[kept]])
    weight = np.linalg.solve(data.covariance[np.ix_(kept, kept)] + columns @ columns.T, mu[kept])
    return weight @ y[kept] / (weight @ mu[kept])


@pytest.mark.parametrize("spectrum", ["led", "planck-900K", "planck-0900K", "planck-2856"])
def test_an_unknown_lamp_is_refused(spectrum):
    with pytest.raises(ValueError, match="is not supported; give planck-2856K"):
        LampSettings(spectrum=spectrum)


def test_a_missing_or_wrong_file_of_the_lamp_is_refused(tmp_path):
    with pytest.raises(CurveError, match=r"lamp\.csv"):
        lamp_curve(LampSettings(spectrum="lamp.csv"), tmp_path)
    (tmp_path / "lamp.csv").write_text("nm,counts\n400,1\n500,2\n")
    with pytest.raises(CurveError, match="a light needs wavelength_nm,power_rel"):
        lamp_curve(LampSettings(spectrum="lamp.csv"), tmp_path)


def test_the_rig_file_keeps_the_lamp_and_the_bench_shines_with_it(tmp_path, optics):
    rig = simulated_rig("red")
    rig = rig.model_copy(update={"lamp": LampSettings(spectrum="planck-3000K", temperature_uncertainty_k=20.0)})
    assert read_toml(write_rig(rig, tmp_path / "rig.toml"), RigFile).lamp == rig.lamp
    light = Bench(rig, tmp_path, optics.camera_response).lights["lamp"]
    assert light == pytest.approx(planck_relative(WAVELENGTH_NM, 3000.0))
