"""What CalculiX writes: excerpts of files of CalculiX 2.20, and broken ones."""

import numpy as np
import pytest

from data_schemas import ImportFormatError
from sim.mechanics.other_engines._calculix import read_convergence, read_frd, read_totals

HEAD = "    1C\n    1UVERSION            Version 2.20                                              \n"
NODES = "    2C                             2                                     1\n -1         1 0.00000E+00\n -3\n"
STEP = "    1PSTEP                         1           1           1\n"


def frame(time, name, rows):
    out = f"{STEP}  100CL  101{time:12.5E}           2                     0    1           1\n"
    out += f" -4  {name:8s}{len(rows[0][1]):5d}    1\n"
    out += "".join(f" -5  {'ALL'}         1    2    0    0\n" for _ in rows[0][1])
    return out + "".join(f" -1{node:10d}{''.join(f'{v:12.5E}' for v in values)}\n" for node, values in rows) + " -3\n"


FIRST = frame(1 / 3, "DISP", [(1, (0.0, -0.5, 1e-7)), (1000000, (1.5, 0.0, -2.25))])
SECOND = frame(1.0, "DISP", [(1, (0.0, -1.0, 0.0)), (1000000, (3.0, 0.0, 0.0))])
TOUCH = frame(1.0, "CONTACT", [(1, (0.0, 0.0, 0.0, 0.17, 0.0, 0.0))])


def test_fields_with_the_time_of_their_frame(tmp_path):
    path = tmp_path / "x.frd"
    path.write_text(HEAD + NODES + FIRST + SECOND + TOUCH + " 9999\n")
    first, second, touch = read_frd(path)
    assert (first.name, touch.name) == ("DISP", "CONTACT")
    np.testing.assert_allclose([first.step_fraction, second.step_fraction, touch.step_fraction], [0.333333, 1.0, 1.0])
    assert first.nodes.tolist() == [1, 1000000]
    np.testing.assert_array_equal(first.values, [[0.0, -0.5, 1e-7], [1.5, 0.0, -2.25]])
    assert touch.values[0, 3] == 0.17


def test_a_frame_that_breaks_off_is_left_out(tmp_path):
    path = tmp_path / "x.frd"
    path.write_text(HEAD + NODES + FIRST + SECOND[:-30])
    assert [f.step_fraction for f in read_frd(path)] == [pytest.approx(1 / 3, abs=1e-6)]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (HEAD + NODES, "contains no field DISP or CONTACT"),
        (
            HEAD + FIRST.replace("-5.00000E-01", "-5.00000E-0x"),
            "a value of the field DISP at time 0.333333 is not a number",
        ),
        (HEAD + FIRST.replace(" 1.50000E+00", " 1.50000E+0"), "must contain a node and values of 12 columns"),
    ],
)
def test_other_files_are_refused(tmp_path, text, match):
    path = tmp_path / "x.frd"
    path.write_text(text)
    with pytest.raises(ImportFormatError, match=match):
        read_frd(path)


DAT = """
 total force (fx,fy,fz) for set INDENTER and time  0.3333333E+00

        8.235708E-28 -2.083231E+00 -2.444486E-02

 total internal energy for set GEL and time  0.3333333E+00

        2.985965E-01

 total force (fx,fy,fz) for set INDENTER and time  0.6666667E+00

       -7.257520E-28 -4.236760E+00 -7.895768E-02
"""


def test_totals_by_quantity_and_set(tmp_path):
    path = tmp_path / "x.dat"
    path.write_text(DAT)
    totals = read_totals(path)
    np.testing.assert_allclose(totals["force", "INDENTER"][:, [0, 2]], [[1 / 3, -2.083231], [2 / 3, -4.23676]], 1e-6)
    np.testing.assert_allclose(totals["internal energy", "GEL"], [[1 / 3, 0.2985965]], 1e-6)


@pytest.mark.parametrize(
    ("text", "match"),
    [("\n", "contains no totals of sets"), (DAT.replace("-2.083231", "-2.08x"), "line 2: the total is no")],
)
def test_other_totals_are_refused(tmp_path, text, match):
    path = tmp_path / "x.dat"
    path.write_text(text)
    with pytest.raises(ImportFormatError, match=match):
        read_totals(path)


def test_increments_that_converged(tmp_path):
    path = tmp_path / "x.sta"
    path.write_text(
        "SUMMARY OF JOB INFORMATION\n  STEP      INC     ATT  ITRS     TOT TIME     STEP TIME      INC TIME\n"
        "     1          1     1    12  0.333333E+00  0.333333E+00  0.333333E+00\n"
        "     1          2     1U    6  0.333333E+00  0.333333E+00  0.333333E+00\n"
        "     1          2     2     5  0.500000E+00  0.500000E+00  0.166667E+00\n"
    )
    found = read_convergence(path)
    assert found.iterations.tolist() == [12, 5]
    np.testing.assert_allclose(found.times, [0.333333, 0.5])


def test_totals_of_uneven_length_are_refused(tmp_path):
    path = tmp_path / "x.dat"
    path.write_text(DAT.replace("-4.236760E+00 -7.895768E-02", "-4.236760E+00"))
    with pytest.raises(ImportFormatError, match="totals of force of INDENTER must all have the same number of values"):
        read_totals(path)
