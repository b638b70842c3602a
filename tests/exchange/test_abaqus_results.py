"""Abaqus' results file in ASCII, written here by hand: no Abaqus was at hand, and no whole file of it."""

import numpy as np
import pytest

from data_schemas import FingerDesign, FingerSurfaces, ImportFormatError, PressMechanics
from data_schemas._design_parts import MeshPreset
from data_schemas.storage import read_record
from sim import design_toml
from sim.mechanics import finger_mesh
from sim.mechanics.other_engines import pressed_by_abaqus, read_fil
from sim.mechanics.other_engines._deck import finger_push
from sim.surface_meshes import restore_shapes
from tests.command_line.running import succeed

# version, heading of a step, the end of it: as files of Abaqus 6.23 begin
VERSION = "*I 19I 41921A6.23-1  A07-Nov-2A024     A16:50:01I 211I 18D 1.000000000000000D+00"


def integer(value: int) -> str:
    return f"I{len(str(value)):2d}{value}"


def real(value: float) -> str:
    return f"D{value:22.15E}".replace("E", "D")


def record(key: int, *items: float | str) -> str:
    words = [integer(i) if isinstance(i, int) else real(i) if isinstance(i, float) else f"A{i:8s}" for i in items]
    return "*" + integer(len(items) + 2) + integer(key) + "".join(words)


def start(total_time: float, step_time: float, number: int) -> str:
    text = [f"{'push':8s}", *[" " * 8] * 9]
    return record(2000, total_time, step_time, 0.0, 0.0, 1, 1, number, 0, 0.0, 0.0, 0.5, *text)


def lines(*records: str) -> str:
    run = "".join(records)
    return "\n".join(run[k : k + 80].ljust(80) for k in range(0, len(run), 80)) + "\n"


def sample() -> str:
    nodes = [record(101, n, 0.1 * n, -2.5e-3 * n, 1e-12) for n in (1, 2, 12345)]
    rigid = [record(101, 99, 0.0, -1.5, 0.0, 0.0, 0.0, 0.0), record(104, 99, 0.0, -6.5, 0.25, 0.0, 0.0, 0.0)]
    first = [start(0.5, 0.5, 1), record(1911, 1, "FINGER  "), *nodes, record(2001)]
    return lines(VERSION, *first, start(1.0, 1.0, 2), *nodes, *rigid, record(2001))


def test_displacements_and_forces_of_each_increment(tmp_path):
    path = tmp_path / "x.fil"
    path.write_text(sample())
    first, second, force = read_fil(path)
    assert [(f.step_fraction, f.name) for f in (first, second, force)] == [(0.5, "U"), (1.0, "U"), (1.0, "RF")]
    assert first.nodes.tolist() == [1, 2, 12345]
    np.testing.assert_array_equal(first.values[2], [1234.5, -30.8625, 1e-12])
    assert second.nodes.tolist() == [1, 2, 12345, 99]
    np.testing.assert_array_equal(force.values, [[0.0, -6.5, 0.25]])


def test_trimmed_blanks_do_no_harm(tmp_path):
    path = tmp_path / "x.fil"
    path.write_text("\n".join(line.rstrip() for line in sample().splitlines()))
    assert len(read_fil(path)) == 3


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("\0\0\x10\0binary", "not an Abaqus results file in ASCII"),
        (lines(VERSION), "contains no displacements"),
        (lines(VERSION, record(101, 7, 0.1, 0.2, 0.3)[:-30]), "is corrupted"),
        (lines(VERSION, record(101, 7, 0.1, 0.2, 0.3).replace("D ", "X ", 1)), "is corrupted"),
        (lines(VERSION, "*I 19" + record(101, 7, 0.1, 0.2, 0.3)[5:]), "has 6 items but states 9"),
        (lines(VERSION, record(2000)), "is corrupted"),
        (lines(VERSION, record(2000, 0.5)), "is corrupted"),
        (lines(VERSION, record(2000, 0.5, "step")), "is corrupted"),
        (lines(VERSION, record(2000, 0.5, float("nan"))), "is corrupted"),
        (lines(VERSION, record(101)), "is corrupted"),
        (lines(VERSION, record(101, 7)), "is corrupted"),
        (lines(VERSION, record(101, "node", 0.1, 0.2, 0.3)), "is corrupted"),
        (lines(VERSION, record(101, 10**20, 0.1, 0.2, 0.3)), "is corrupted"),
        (lines(VERSION, record(101, 7, 0.1, float("nan"), 0.3)), r"is corrupted \(displacements and forces need"),
        (lines(VERSION, record(104, 7, 0.1, "force", 0.3)), "is corrupted"),
    ],
)
def test_other_files_are_refused(tmp_path, text, match):
    path = tmp_path / "x.fil"
    path.write_text(text)
    with pytest.raises(ImportFormatError, match=match):
        read_fil(path)


# --- a finger: the file that Abaqus would write for a coarse deck, from a made-up displacement

DESIGN = FingerDesign(mesh=MeshPreset(preset="coarse"))


def results(depth_mm, leave_out=0, with_force=True):
    """A pressed finger: the coat sags by 0.9 of the push, so that it lies inside the indenter where that is lowest."""
    mesh = finger_mesh(DESIGN)
    reference = len(mesh.nodes_mm) + len(finger_push(DESIGN, "coarse", 1).indenter.nodes_mm) + 1
    x, y, z = mesh.nodes_mm.T
    sag = -0.9 * depth_mm * np.exp(-(((z - 35.0) / 12.0) ** 2)) * np.clip(y / DESIGN.pad.thickness_mm, 0.0, 1.0)
    nodes = [record(101, n + 1, 0.0, float(s), 0.0) for n, s in enumerate(sag[: len(x) - leave_out])]
    rigid = [record(101, reference, 0.0, -depth_mm, 0.0, 0.0, 0.0, 0.0)]
    if with_force:
        rigid.append(record(104, reference, 0.1, -3.25, 0.2, 0.0, 0.0, 0.0))
    return lines(VERSION, start(1.0, 1.0, 1), *nodes, *rigid, record(2001)), sag


def test_a_results_file_becomes_surfaces(tmp_path):
    text, sag = results(0.8)
    (tmp_path / "x.fil").write_text(text)
    (tmp_path / "x.toml").write_text(design_toml(DESIGN))
    out = tmp_path / "x.surfaces.json"
    said = succeed(f"import abaqus {tmp_path / 'x.fil'} --design {tmp_path / 'x.toml'} --out {out}")
    assert "push  0.800 mm   force   3.250 N" in said
    mechanics = read_record(tmp_path / "x.mechanics.json", PressMechanics)
    assert mechanics.label.startswith("Abaqus, coarse mesh")
    np.testing.assert_allclose(mechanics.force_n, [[-0.1, 3.25, -0.2]])
    assert mechanics.largest_pressure_mpa > 0.0
    shapes = restore_shapes(read_record(out, FingerSurfaces))
    lowest = [shape.surfaces["coat"].vertices_mm[:, 1].min() for shape in shapes]
    assert lowest[0] - lowest[1] == pytest.approx(-sag.min(), rel=1e-6)


def test_results_that_end_before_the_push_begins_are_refused(tmp_path):
    (tmp_path / "x.fil").write_text(lines(VERSION, start(0.0, 0.0, 0), record(101, 1, 0.0, 0.0, 0.0), record(2001)))
    with pytest.raises(ImportFormatError, match=r"no increment after the start of the step .* let Abaqus finish"):
        pressed_by_abaqus(DESIGN, read_fil(tmp_path / "x.fil"))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"leave_out": 1}, "U of the nodes 1 to"),
        ({"with_force": False}, "RF of the nodes"),
    ],
)
def test_results_of_another_deck_are_refused(tmp_path, changes, match):
    (tmp_path / "x.fil").write_text(results(0.8, **changes)[0])
    with pytest.raises(ImportFormatError, match=match):
        pressed_by_abaqus(DESIGN, read_fil(tmp_path / "x.fil"))
