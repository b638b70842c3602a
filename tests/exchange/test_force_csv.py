"""Measured forces as CSV files: what is read, and what is refused with the place and the remedy."""

import numpy as np
import pytest

from data_schemas import CompareError, ImportFormatError
from finray_calib.exchange import read_force_csv

ROWS = [(0.0, 0.0), (0.5, 1.0), (1.0, 2.1), (1.5, 3.2), (2.0, 4.3)]


def csv(header="displacement_mm,force_n", rows=ROWS):
    return "\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n"


def test_columns_in_any_order_with_comments_and_a_byte_order_mark(tmp_path):
    header = "\ufeffforce_n, displacement_mm,displacement_uncertainty_mm,force_uncertainty_n"
    rows = [(force, depth, 0.01, 0.02) for depth, force in ROWS]
    path = tmp_path / "bench.csv"
    path.write_text("# load cell 10 N\n" + csv(header, rows) + "# end\n", encoding="utf-8")
    measured = read_force_csv(path)
    np.testing.assert_array_equal(measured.displacement_mm, [row[0] for row in ROWS])
    np.testing.assert_array_equal(measured.force_n, [row[1] for row in ROWS])
    np.testing.assert_array_equal(measured.u_force_n, np.full(5, 0.02))
    np.testing.assert_array_equal(measured.u_displacement_mm, np.full(5, 0.01))
    # 0.02 N, and 0.01 mm at 3 N/mm
    np.testing.assert_allclose(measured.variance_n2(np.full(5, 3.0)), 0.02**2 + 0.03**2)


def test_uncertainties_may_be_absent(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text(csv())
    measured = read_force_csv(path)
    assert measured.u_force_n is None
    assert measured.u_displacement_mm is None
    assert not measured.variance_n2(np.ones(5)).any()


@pytest.mark.parametrize("first", ["", "sep=;\r\n", "\ufeffsep=;\n"])
def test_a_table_of_a_spreadsheet_with_decimal_commas(tmp_path, first):
    path, plain = tmp_path / "bench.csv", tmp_path / "plain.csv"
    plain.write_text(csv())
    path.write_text(first + csv().replace(",", ";").replace(".", ","))
    np.testing.assert_array_equal(read_force_csv(path).force_n, read_force_csv(plain).force_n)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            csv("displacement_mm,force_gf"),
            r"bench\.csv: column 'force_gf' is not supported; required columns are displacement_mm, force_n",
        ),
        (csv("displacement_um,force_n"), "column 'displacement_um' is not supported; .* mm and N"),
        (csv("displacement_mm,force_uncertainty_n"), "has no column 'force_n'"),
        (csv("displacement_mm,force_n,Force_N", [(*row, 1) for row in ROWS]), "a column appears twice"),
        (csv(rows=[*ROWS, ("1,5", "3,2")]), "line 7: has 4 columns, but the header has 2"),
        (csv(rows=[*ROWS, (2.5, "nan")]), "line 7: 'nan' is not a finite number"),
        (csv(rows=[*ROWS, (2.5, "five")]), "'five' is not a finite number"),
        ("", "must have a header row and at least two rows"),
    ],
)
def test_bad_files(text, message, tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text(text)
    with pytest.raises(ImportFormatError, match=message):
        read_force_csv(path)


def test_unloading_is_refused_with_its_row(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text(csv(rows=[*ROWS, (1.5, 2.6), (1.0, 1.5)]))
    with pytest.raises(CompareError, match=r"bench\.csv: row 6 below the header .* 1\.5 mm after 2 mm, .* Leave out"):
        read_force_csv(path)
    # a gauge that jitters by 2 % of the range goes on loading
    path.write_text(csv(rows=[*ROWS[:3], (0.96, 2.1), *ROWS[3:]]))
    assert len(read_force_csv(path).force_n) == 6


def test_a_missing_file_and_too_few_points(tmp_path):
    with pytest.raises(ImportFormatError, match="no such file"):
        read_force_csv(tmp_path / "none.csv")
    path = tmp_path / "bench.csv"
    path.write_text(csv(rows=ROWS[:3]))
    with pytest.raises(CompareError, match="has only 3 points"):
        read_force_csv(path)
