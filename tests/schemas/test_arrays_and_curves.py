"""Array fields, spectral curves and the files they come from."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from data_schemas import ArraySpec, CurveError, FieldError, Model, SpectralCurve, require_coverage
from data_schemas.storage import read_camera_response, read_donaldson_matrix


class Table(Model):
    values: Annotated[NDArray[np.float64], ArraySpec("<f8", ("row", "3"), "DN")]
    counts: Annotated[NDArray[np.uint16], ArraySpec("<u2", ("row",), "DN")] = np.zeros(1, np.uint16)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([[1.0, 2.0]], r"must have shape \(row, 3\), got \(1, 2\)"),
        ([1.0, 2.0, 3.0], "must have 2 dimensions"),
        ([[1.0, np.nan, 3.0]], "must be finite, got 1 NaN"),
        ([["a", "b", "c"]], "must be numbers"),
    ],
)
def test_array_that_is_not_what_it_must_be(values, message):
    with pytest.raises(FieldError, match=message):
        Table(values=values)


def test_integers_are_not_rounded_silently():
    with pytest.raises(FieldError, match="values that uint16 cannot represent"):
        Table(values=np.ones((1, 3)), counts=np.array([1.5]))
    with pytest.raises(FieldError, match="values that uint16 cannot represent"):
        Table(values=np.ones((1, 3)), counts=np.array([70000]))


def test_lengths_along_one_dimension_agree():
    """In every model, and of lists too, one within another model included."""

    class Listed(Model):
        dimension_of: ClassVar[Mapping[str, str]] = {"names": "row", "inner.counts": "row"}
        names: tuple[str, ...]
        values: Annotated[NDArray[np.float64], ArraySpec("<f8", ("row", "3"), "DN")]
        inner: Table | None = None

    with pytest.raises(FieldError, match="'counts' has 1 entry along 'row', but 'values' has 2"):
        Table(values=np.ones((2, 3)))
    assert Listed(names=("a", "b"), values=np.ones((2, 3))).inner is None
    with pytest.raises(FieldError, match="'values' has 2 entries along 'row', but 'names' has 1"):
        Listed(names=("a",), values=np.ones((2, 3)))
    with pytest.raises(FieldError, match=r"'inner\.counts' has 1 entry along 'row', but 'names' has 2"):
        Listed(names=("a", "b"), values=np.ones((2, 3)), inner=Table(values=np.ones((1, 3))))


def test_caller_cannot_change_a_record_through_its_array():
    mine = np.ones((1, 3))
    table = Table(values=mine)
    mine[0, 0] = 5.0
    assert table.values[0, 0] == 1.0


@given(x=st.floats(200.0, 2500.0))
def test_curve_holds_its_end_values(x):
    curve = SpectralCurve(name="q", wavelength_nm=[400.0, 700.0], values=[1.0, 2.0], source="test")
    value = float(curve(x))
    assert value == pytest.approx(np.clip(1.0 + (x - 400.0) / 300.0, 1.0, 2.0))


def test_coverage_rule():
    curve = SpectralCurve(name="green", wavelength_nm=[400.0, 700.0], values=[1.0, 1.0], source="cam.csv")
    x = np.arange(380.0, 781.0)
    assert require_coverage(curve, x, np.exp(-(((x - 550) / 10) ** 2)), "filter 550") is None
    weight = np.exp(-4 * np.log(2) * ((x - 405) / 10) ** 2)
    # 1 nm samples below 400 nm of a Gaussian band with sigma = 10 / 2.355 nm: Phi((399.5 - 405) / 4.247) = 0.0977
    assert curve.share_outside(x, weight) == pytest.approx(0.0977, abs=2e-3)
    note = require_coverage(curve, x, weight, "filter 405")
    assert note is not None
    assert "end value is used" in note
    with pytest.raises(CurveError, match=r"cam.csv: curve 'green' covers only 400 to 700 nm, and 5\d %"):
        require_coverage(curve, x, np.exp(-(((x - 399) / 10) ** 2)), "filter 399")


def matrix_file(tmp_path, rows):
    path = tmp_path / "paint.csv"
    path.write_text("# comment\nemission_nm,450,460\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (
            ["460,0,0.1", "450,0.1,0"],
            "paint.csv: wavelengths must increase from row to row: 450 nm follows 460",
        ),
        (["450,0.1,nan", "460,0,0.1"], "paint.csv, line 3: 'nan' is not a finite number"),
        (["450,0.1", "460,0,0.1"], "line 3: has 2 columns, but the header has 3"),
        (["450,0.1,red", "460,0,0.1"], "line 3: 'red' is not a finite number"),
        (["0.45,0.1,0", "0.46,0,0.1"], "check that they are in nm"),
        (["450,0.1,0"], "at least two rows"),
        (
            ["450,0.1,0", "460,0,0.1", "480,0,0"],
            r"paint.csv: emission_nm steps range from 10 to 20 nm, but must be equal",
        ),
    ],
)
def test_bad_matrix_file(tmp_path, rows, message):
    with pytest.raises(CurveError, match=message):
        read_donaldson_matrix(matrix_file(tmp_path, rows))


def test_matrix_header(tmp_path):
    path = tmp_path / "paint.csv"
    path.write_text("wavelength,450\n450,1\n460,1\n")
    with pytest.raises(CurveError, match="needs 'emission_nm'"):
        read_donaldson_matrix(path)
    path.write_text("emission_nm,blue,460\n450,1,0\n460,1,0\n")
    with pytest.raises(CurveError, match="must contain only excitation wavelengths"):
        read_donaldson_matrix(path)
    with pytest.raises(CurveError, match="no such file"):
        read_donaldson_matrix(tmp_path / "absent.csv")
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(CurveError, match="cannot be read as UTF-8"):
        read_donaldson_matrix(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wavelength_nm,r,g,b\n400,1,1,1\n410,1,1,1\n", "a camera response needs wavelength_nm,red_percent"),
        (
            "wavelength_nm,red_percent,green_percent,blue_percent\n400,1,-1,1\n410,1,1,1\n",
            "is negative, but must be at least 0",
        ),
        (
            "wavelength_nm,red_percent,green_percent,blue_percent\n400,1,0,1\n410,1,0,1\n",
            "column 'green_percent' is 0 in all rows",
        ),
        ("wavelength_nm,red_percent,green_percent,blue_percent\n410,1,1,1\n400,1,1,1\n", "must increase"),
    ],
)
def test_bad_camera_response(tmp_path, text, message):
    path = tmp_path / "camera.csv"
    path.write_text(text)
    with pytest.raises(CurveError, match=message):
        read_camera_response(path)


def test_a_matrix_that_makes_light_is_refused(tmp_path):
    """A column sends out more than falls in: entries in per cent, or a yield above what energy allows."""
    header = "emission_nm,450,460,470\n"
    rows = [(450, 0.1, 0, 0), (460, 0, 0.1, 0), (470, 0.0, 0, 0.2), (480, 0.6, 0, 0), (490, 0.49, 0.3, 0)]
    path = tmp_path / "paint.csv"
    path.write_text(header + "".join(",".join(map(str, row)) + "\n" for row in rows))
    assert read_donaldson_matrix(path).radiance_factor_per_nm.sum() * 10 == pytest.approx(1.39)
    rows[-1] = (490, 0.61, 0.3, 0)
    path.write_text(header + "".join(",".join(map(str, row)) + "\n" for row in rows))
    with pytest.raises(CurveError, match=r"at 450 nm the matrix returns 1\.31 times the light .* \(1\.21 by"):
        read_donaldson_matrix(path)


def test_one_camera_channel_far_above_the_others_is_refused(tmp_path):
    path, rows = tmp_path / "camera.csv", "wavelength_nm,red_percent,green_percent,blue_percent\n"
    for factor, wrong in ((29, False), (31, True), (1 / 29, False), (1 / 31, True)):
        path.write_text(rows + f"500,1,2,{2 * factor}\n600,2,1,1e-9\n")
        if wrong:
            with pytest.raises(
                CurveError, match=r"channels peak at red 2 %, green 2 %, blue .* one channel that is more than 30 times"
            ):
                read_camera_response(path)
        else:
            assert read_camera_response(path)[0].values.max() == 0.02


@pytest.mark.shared_data
def test_measured_matrix_keeps_the_published_values(shared_data):
    """Sanity values printed in the data's README: reflectance and strongest emission at 450 nm."""
    paint = read_donaldson_matrix(shared_data / "spectra/materials/hercules_orange_ink.csv")
    assert float(paint.reflectance(450.0)) == pytest.approx(0.036, abs=5e-4)
    emission = paint.emission_at(450.0)
    assert emission.wavelength_nm[emission.values.argmax()] == 600.0
    assert emission.values.max() * 10 == pytest.approx(0.058, abs=5e-4)
    with pytest.raises(CurveError, match="no data for excitation at 250 nm"):
        paint.emission_at(250.0)


@pytest.mark.shared_data
def test_measured_camera_response(shared_data):
    red, green, blue = read_camera_response(shared_data / "spectra/cameras/ov5647.csv")
    assert [c.wavelength_nm[c.values.argmax()] for c in (red, green, blue)] == [604.0, 541.0, 460.0]


def test_a_matrix_in_per_cent_is_refused_unless_it_is_meant(tmp_path):
    path = tmp_path / "paint.csv"
    rows = "emission_nm,450,460\n450,79,0\n460,3,81\n"
    path.write_text(rows)
    with pytest.raises(CurveError, match=r"paint\.csv: the reflectance is 81 at 460 nm, .* in per cent"):
        read_donaldson_matrix(path)
    path.write_text("# allow: reflectance above 1.2\n" + rows.replace("460,3", "460,0.3"))
    assert read_donaldson_matrix(path).reflectance.values.max() == 81.0


def test_a_camera_response_beyond_measure_is_refused(tmp_path):
    path = tmp_path / "camera.csv"
    path.write_text("wavelength_nm,red_percent,green_percent,blue_percent\n400,1,2,3\n500,1,2e6,3\n")
    with pytest.raises(
        CurveError, match=r"camera\.csv: the largest camera response is 2e\+06 .* at most 1000 per cent"
    ):
        read_camera_response(path)
