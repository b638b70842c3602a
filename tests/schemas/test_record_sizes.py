"""Records whose arrays and lists disagree in size are refused with both fields and both sizes."""

import numpy as np
import pytest
from pydantic import ValidationError

from data_schemas import FieldError, LightAngleSweep, PaintCalibration, Record, SimulatedPress, TactileCapture
from tests.command_line.records import press, sweep
from tests.documentation.example_records import example_results
from tests.schemas.test_storage import capture

RESULTS = example_results()


def changed(record: Record, **fields: object) -> Record:
    """Validate the record again with some fields replaced."""
    return type(record).model_validate({**dict(record), **fields})


@pytest.mark.parametrize("record", [RESULTS.press, RESULTS.sweep, RESULTS.capture, RESULTS.paints["red"].calibration])
def test_consistent_record_is_accepted(record):
    assert isinstance(changed(record), SimulatedPress | LightAngleSweep | TactileCapture | PaintCalibration)


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((5, 4, 1), r"layout Bayer RGGB needs even numbers of rows and columns \(2 x 2 cells\), got 5 x 4"),
        ((4, 5, 1), "needs even numbers of rows and columns .* got 4 x 5"),
        ((4, 4, 3), r"layout Bayer RGGB needs 1 sample\(s\) per pixel, but the images have 3"),
    ],
)
def test_bayer_capture(shape, message):
    with pytest.raises(FieldError, match=message):
        capture(np.ones(shape, np.uint16))


def test_capture_images_of_different_size():
    with pytest.raises(ValidationError, match="'repeat_no_contact' has 6 entries along 'row', but 'contact' has 4"):
        changed(capture(np.ones((4, 4, 1), np.uint16)), repeat_no_contact=np.ones((6, 4, 1), np.uint16))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"contact": np.ones((60, 81, 3))}, "'contact' has 81 entries along 'column', but 'no_contact' has 80"),
        ({"distance": np.ones((59, 80))}, "'distance' has 59 entries along 'row', but 'no_contact' has 60"),
        ({"variance": np.ones((61, 80, 3))}, "'variance' has 61 entries along 'row', but 'no_contact' has 60"),
        (
            {"bands": ("a",), "contact_bands": np.ones((60, 79, 1))},
            "'contact_bands' has 79 entries along 'column', but 'no_contact' has 80",
        ),
        (
            {"bands": ("a", "b"), "no_contact_bands": np.ones((60, 80, 3))},
            "'no_contact_bands' has 3 entries along 'band', but 'bands' has 2",
        ),
        (
            {"bands": ("a", "b"), "camera_matrix": np.ones((3, 3))},
            "'camera_matrix' has 3 entries along 'band', but 'bands' has 2",
        ),
        ({"bands": ("a", "b"), "camera_matrix": np.ones((2, 2))}, r"must have shape \(3, band\), got \(2, 2\)"),
    ],
)
def test_simulated_press(fields, message):
    with pytest.raises(ValidationError, match=message):
        changed(press(), **fields)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"values": np.ones((12, 6))}, "'values' has 12 entries along 'angle', but 'angles_deg' has 13"),
        ({"basis": np.ones((12, 6, 2, 3))}, "'basis' has 12 entries along 'angle', but 'angles_deg' has 13"),
        ({"basis": np.ones((13, 5, 2, 3))}, "'basis' has 5 entries along 'repeat', but 'values' has 6"),
        ({"basis": np.ones((13, 6, 2, 4))}, "'basis' has 4 entries along 'band', but 'bands' has 3"),
        ({"probe_points_mm": np.zeros((4, 3))}, "'probe_points_mm' has 4 entries along 'probe', but 'basis' has 2"),
    ],
)
def test_light_angle_sweep(fields, message):
    with pytest.raises(ValidationError, match=message):
        changed(sweep(), **fields)


CALIBRATION = RESULTS.paints["red"].calibration
FILTERS = len(CALIBRATION.optics.filters)
GRID = CALIBRATION.wavelength_nm.size


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("emission_low95_per_nm", np.ones(3), "has 3 entries along 'wavelength', but 'wavelength_nm' has"),
        ("draws", np.ones((9, 99)), rf"has 99 entries along 'parameter', but 'sampled' has {len(CALIBRATION.sampled)}"),
        ("prior_draws", np.ones((9, 99)), "has 99 entries along 'parameter', but 'sampled' has"),
        ("measured", np.ones((1, 3)), f"has 1 entry along 'filter', but 'optics.filters' has {FILTERS}"),
        ("predicted_sd", np.ones((1, 3)), "has 1 entry along 'filter', but 'optics.filters' has"),
        ("usable", np.ones((1, 3), np.bool_), "has 1 entry along 'filter', but 'optics.filters' has"),
        ("bands", CALIBRATION.bands[:-1], f"has {FILTERS - 1} entries along 'filter', but 'optics.filters'"),
        ("family_emission_per_nm", np.ones((2, GRID)), "has 2 entries along 'family', but 'families' has 3"),
        ("family_low95_per_nm", np.ones((9, GRID)), "has 9 entries along 'family', but 'families' has 3"),
        ("emission_draws_per_nm", np.ones((9, 3)), f"has 3 entries along 'wavelength', but 'wavelength_nm' has {GRID}"),
        ("band_integrals", CALIBRATION.band_integrals[:-1], "has 7 entries along 'filter', but"),
        ("reflectance", CALIBRATION.reflectance[:-1], f"has {FILTERS - 1} entries along 'filter', but 'optics"),
    ],
)  # fmt: skip
def test_paint_calibration(field, value, message):
    with pytest.raises(ValidationError, match=f"'{field}' {message}"):
        changed(CALIBRATION, **{field: value})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("low95", np.ones(3), "has 3 entries along 'excitation', but 'excitation_nm' has"),
        ("absorption_rel_draws", np.ones((40, 3)), "has 3 entries along 'excitation', but"),
        ("stokes_shift_draws_nm", np.ones(7), "has 7 entries along 'draw', but 'absorption_rel_draws' has 40"),
    ],
)
def test_reradiation(field, value, message):
    reradiation = CALIBRATION.reradiation
    with pytest.raises(ValidationError, match=f"'{field}' {message}"):
        type(reradiation).model_validate({**dict(reradiation), field: value})
