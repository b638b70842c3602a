from pathlib import Path

import numpy as np
import pytest

from data_schemas import ImportFormatError
from finray_calib.exchange import read_tuning
from finray_calib.radiometry import parse_tuning, shading_gains
from finray_calib.radiometry._raspberry_pi import LensShading
from tests.radiometry.libcamera_documents import GAMMA, algorithms, version_2

INSTALLED = Path("/usr/share/libcamera/ipa")


def test_both_layouts_say_the_same():
    new, old = parse_tuning(version_2()), parse_tuning(algorithms())
    assert new.target == old.target == "bcm2835"
    for one in (new, old):
        np.testing.assert_allclose(one.black_level_rel, 64 / 1024, rtol=1e-12)  # 4096 of 65536 is 64 of 1024
        assert one.tone_curve is not None
        np.testing.assert_allclose(one.tone_curve[:, 1], one.tone_curve[:, 0] ** GAMMA, atol=1e-9)
        assert one.shading is not None
        assert one.shading.luminance.shape == (12, 16)
        assert one.shading.adaptive_bound_rel == 0.05  # libcamera's default
        assert one.contrast is not None
        assert one.contrast.high_max_rel == pytest.approx(2000 / 65535)  # libcamera's default
    np.testing.assert_array_equal(new.colour_matrices, old.colour_matrices)


def test_a_disabled_algorithm_counts_as_absent():
    document = algorithms(contrast_adapts=False) | {"version": 1.0}
    document["rpi.alsc"]["enabled"] = False
    tuning = parse_tuning(document)
    assert tuning.shading is None
    assert tuning.contrast is None
    del document["rpi.contrast"]
    assert parse_tuning(document).tone_curve is None
    document["rpi.alsc"] = {"n_iter": 0}
    assert parse_tuning(document).shading is None


def test_colour_matrices_are_linear_in_temperature_and_held_at_the_ends():
    tuning = parse_tuning(version_2())
    first, last = tuning.colour_matrices
    np.testing.assert_allclose(tuning.colour_matrix(3500.0), 0.75 * first + 0.25 * last, rtol=1e-12)
    np.testing.assert_array_equal(tuning.colour_matrix(1000.0), first)
    np.testing.assert_array_equal(tuning.colour_matrix(9000.0), last)
    assert first[0, 1] == -0.6  # row by row, as libcamera reads them
    without = version_2()
    without["algorithms"] = without["algorithms"][:-1]
    with pytest.raises(ImportFormatError, match=r"has no rpi.ccm matrices"):
        parse_tuning(without).colour_matrix(4000.0)


@pytest.mark.parametrize("table_shape", [(12, 16), (32, 32)])
def test_shading_gains_are_the_tables_at_the_cells_centres(table_shape):
    shading = parse_tuning(version_2(table_shape=table_shape)).shading
    assert shading is not None
    rows, columns = table_shape
    gains = shading_gains(shading, 4000.0, (rows * 9, columns * 9))
    at_centers = gains[4::9, 4::9]
    luminance = 1 + 0.5 * np.add.outer(np.linspace(-1, 1, rows) ** 2, np.linspace(-1, 1, columns) ** 2)
    np.testing.assert_allclose(at_centers[..., 1], luminance / luminance.min(), rtol=1e-6)
    # Red: a uniform table (1.4 at 4000 K) only scales, and the smallest gain of a channel is 1.
    np.testing.assert_allclose(at_centers[..., 0], at_centers[..., 1], rtol=1e-6)
    blue = np.linspace(1, 2, rows * columns).reshape(table_shape) * luminance
    np.testing.assert_allclose(at_centers[..., 2], blue / blue.min(), rtol=1e-6)


def test_shading_without_colour_tables_is_luminance_alone():
    table = np.ones((12, 16)) + np.arange(16) / 16
    none = np.empty((0, 12, 16))
    gains = shading_gains(LensShading(table, np.empty(0), none, np.empty(0), none, 0.0), 4000.0, (12, 16))
    np.testing.assert_allclose(gains, np.repeat(table[..., None], 3, axis=-1), rtol=1e-6)


def change(name, **parameters):
    document = algorithms()
    document[name] = document[name] | parameters
    return document


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([], r"is not a JSON object; give the tuning file that libcamera has"),
        ({"version": 3.0, "algorithms": []}, r"version 3.0 is not supported, only versions below 3"),
        ({"version": 2.0, "algorithms": {}}, r"'algorithms' must be a list of objects in version 2"),
        ({"version": 1.0, "camera": {}}, r"contains no 'rpi.' algorithm"),
        (
            change("rpi.black_level", black_level=40_000),
            r"rpi.black_level is \[40000.*at least 0 and below 32768 on the 16-bit scale",
        ),
        (change("rpi.contrast", gamma_curve=[0, 0, 9, 9, 9, 10]), r"gamma_curve must have two or more pairs"),
        (change("rpi.contrast", gamma_curve=[0, 0, 9]), r"gamma_curve is not an array of numbers of shape \(-1, 2\)"),
        (change("rpi.contrast", lo_max=float("nan")), r"rpi.contrast contains NaN"),
        (change("rpi.alsc", luminance_lut=[1.0] * 100), r"luminance_lut has 100 entries, but .*\(192\) or 32 x 32"),
        (change("rpi.alsc", luminance_lut=[[1.0, 2.0], [3.0]]), r"luminance_lut is not an array of numbers"),
        (change("rpi.alsc", luminance_strength="strong"), r"luminance_strength is not an array of numbers"),
        (change("rpi.alsc", luminance_lut=[-9.0] * 192), r"contains a gain that is zero or negative"),
        (change("rpi.alsc", calibrations_Cr=[{"table": []}]), r"calibrations_Cr must be a list of objects with 'ct'"),
        (
            change("rpi.ccm", ccms=[{"ct": 5000, "ccm": [1] * 9}, {"ct": 3000, "ccm": [1] * 9}]),
            r"rpi.ccm must be in increasing order of 'ct', got \[5000.0, 3000.0\] K",
        ),
    ],
)
def test_what_libcamera_would_refuse_is_refused(document, message):
    with pytest.raises(ImportFormatError, match=message):
        parse_tuning(document)


def test_installed_tuning_files_are_understood():
    """Real files where libcamera is installed; they are not copied into the project."""
    files = sorted(INSTALLED.glob("r*/**/*.json"))
    if not files:
        pytest.skip(f"LIBCAMERA ABSENT: no tuning file below {INSTALLED}; real tuning files were NOT read")
    for path in files:
        tuning = read_tuning(path)
        assert 0 < tuning.black_level_rel.max() < 0.2, path
        assert tuning.tone_curve is not None, path
