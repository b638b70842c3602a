"""What physics does not allow is refused, with the value, the rule and what to do."""

import numpy as np
import pytest
from pydantic import ValidationError

from benchmarks.emission_detection import REFLECTANCES, Rig, bell
from data_schemas import BandSignals, FitError, SimulateError
from finray_calib.fit import FitOptions, calibrate_paint
from sim.experiments import require_paints_in_order


@pytest.fixture(scope="module")
def bands():
    return Rig(1, 5.0).signals("orange", REFLECTANCES["black"], 0.2 * bell(600, 50), np.random.default_rng(8))


def changed(bands, **update):
    return BandSignals.model_validate(bands.model_dump() | update)


@pytest.mark.parametrize("name", ["fluorescence_covariance", "reflectance_covariance"])
@pytest.mark.parametrize(
    ("poison", "message"),
    [
        (lambda c: 0 * c, r"has a variance of 0 for a usable value, .*flag the value as weak"),
        (lambda c: -c, r"has a variance of -"),
        (lambda c: np.where(np.eye(24) > 0, np.nan, c), r"must be finite|not finite"),
        (lambda c: np.where(np.eye(24) > 0, np.inf, c), r"must be finite|not finite"),
        (lambda c: np.sqrt(np.outer(np.diag(c), np.diag(c))), r"is not positive definite over the usable values"),
        (lambda c: np.triu(c + 0.5 * np.sqrt(np.outer(np.diag(c), np.diag(c)))), r"is not symmetric"),
    ],
    ids=["zero", "negative", "nan", "infinite", "singular", "asymmetric"],
)
def test_a_covariance_that_no_measurement_has_is_refused(bands, name, poison, message):
    with pytest.raises(ValidationError, match=message):
        changed(bands, **{name: poison(getattr(bands, name))})


def test_values_that_are_not_used_need_no_covariance(bands):
    covariance = bands.fluorescence_covariance.copy()
    lost = ~bands.usable().ravel()
    assert lost.any()
    covariance[lost], covariance[:, lost] = 0.0, 0.0
    assert changed(bands, fluorescence_covariance=covariance).flags == bands.flags


def test_a_paint_that_emits_more_than_falls_on_it_is_refused(bands):
    """Band signals in per cent."""
    emission = ~bands.at_excitation()[:, None] & np.ones(3, bool)
    factor = np.where(emission, 100.0, 1.0)
    bright = changed(
        bands,
        fluorescence=bands.fluorescence * factor,
        fluorescence_covariance=bands.fluorescence_covariance * np.outer(factor, factor),
    )
    with pytest.raises(FitError, match=r"'orange' would emit \d+(\.\d+)? times the energy of the laser .*in per cent"):
        calibrate_paint(bright, 1, FitOptions(family="log_normal_wavenumber"))


def test_swapped_paints_are_refused():
    files = {"red": "a.json", "green": "b.json"}
    with pytest.raises(
        SimulateError,
        match=r"look swapped, because red=a\.json emits most at 516 nm, below green=b\.json at 597 nm.* give --x if",
    ):
        require_paints_in_order({"red": 516.0, "green": 597.0}, files, "--x")
    require_paints_in_order({"red": 597.0, "green": 516.0}, files, "--x")
    require_paints_in_order({"red": 597.0}, files, "--x")


@pytest.mark.parametrize(
    ("laser", "message"),
    [
        ({"wavelength_nm": 650.0}, r"wavelength of 650 nm, which the excitation filter '450' \(450 nm, .* not pass"),
        ({"fwhm_nm": 300.0}, r"the laser's fwhm_nm of 300 nm, .* an LED at most 60 nm"),
        ({}, r"filter '\d+', whose signals have the smallest standard deviation of all"),
    ],
    ids=["laser behind another filter", "white light", "unknown"],
)
def test_equations_without_a_solution_name_the_likely_cause(bands, monkeypatch, laser, message):
    def without_solution(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("finray_calib.fit._paint_calibration.detect_emission", without_solution)
    optics = bands.optics.model_copy(update={"laser": bands.optics.laser.model_copy(update=laser)})
    with pytest.raises(FitError, match=message):
        calibrate_paint(bands.model_copy(update={"optics": optics}), 1)
