"""The table of a design study as xarray, netCDF and Parquet: the numbers of the record, with units and limits."""

import io

import numpy as np
import pytest

from data_schemas import StudyMetric, StudyResult, StudyRow
from finray_calib.exchange import parquet_table, study_dataset, study_netcdf
from finray_calib.exchange._learning_dataset import _of_one_kind

xarray = pytest.importorskip("xarray")


def metric(name, value, reach95=None):
    low, high = (None, None) if reach95 is None else (value - reach95, value + reach95)
    return StudyMetric(name=name, value=value, low95=low, high95=high, unit="N", meaning=f"meaning of {name}")


@pytest.fixture
def result():
    rows = (
        StudyRow(number=1, changes={"light.angle_deg": 0.0, "preset": "a"}, metrics=(metric("force_n", 2.0, 0.5),)),
        StudyRow(number=4, changes={"light.angle_deg": 30.0, "preset": "b"},
                 metrics=(metric("force_n", 3.0, 0.25), metric("push_mm", 1.5))),
    )  # fmt: skip
    return StudyResult(name="a study", about="why", varied=("light.angle_deg", "preset"), points=rows)


def test_a_dataset_has_the_numbers_limits_and_changes_of_each_point(result, tmp_path):
    (tmp_path / "table.nc").write_bytes(study_netcdf(result))
    for found in (study_dataset(result), xarray.load_dataset(tmp_path / "table.nc", engine="h5netcdf")):
        assert found.attrs == {"name": "a study", "about": "why"}
        assert found["point"].values.tolist() == [1, 4]
        assert found["light.angle_deg"].values.tolist() == [0.0, 30.0]
        assert found["preset"].values.tolist() == ["a", "b"]
        assert found["force_n"].values.tolist() == [2.0, 3.0]
        assert found["force_n_low95"].values.tolist() == [1.5, 2.75]
        assert found["force_n_high95"].values.tolist() == [2.5, 3.25]
        assert found["force_n"].attrs == {"units": "N", "long_name": "meaning of force_n"}
        # a point that lacks a number; limits that no point has are no column
        assert np.isnan(found["push_mm"].values[0])
        assert found["push_mm"].values[1] == 1.5
        assert set(found.data_vars) == {"force_n", "force_n_low95", "force_n_high95", "push_mm"}


def test_a_parquet_table_reads_back(result):
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [{"point": 1, "preset": "a", "force_n": 2.0}, {"point": 4, "preset": "b", "force_n": None}]
    assert parquet.read_table(io.BytesIO(parquet_table(rows))).to_pylist() == rows


def test_a_column_of_numbers_and_words_is_text_in_parquet():
    assert _of_one_kind([1, 0.5, None]) == [1, 0.5, None]
    assert _of_one_kind([0.5, None, "own", True]) == ["0.5", None, "own", "True"]
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = [{"point": 1, "given": 0.5, "tried": 1}, {"point": 2, "given": "own"}, {"point": 3, "given": True}]
    found = parquet.read_table(io.BytesIO(parquet_table(rows))).to_pylist()
    assert [row["given"] for row in found] == ["0.5", "own", "True"]
    assert [row["tried"] for row in found] == [1, None, None]
