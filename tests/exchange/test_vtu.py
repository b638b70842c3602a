"""A finger's mesh in a .vtu file, read back by meshio."""

import meshio
import numpy as np
import pytest

from data_schemas import FingerDesign, SimulateError
from finray_calib.exchange import vtu_bytes
from sim.mechanics import finger_mesh
from sim.mechanics._finger_mesh import MeshSteps


@pytest.fixture(scope="module")
def mesh():
    return finger_mesh(FingerDesign(), steps=MeshSteps(5.0, 3.0, 5.0, 5.0))


def test_another_program_reads_mesh_displacement_and_parts(mesh, tmp_path):
    displacement = np.random.default_rng(3).normal(size=mesh.nodes_mm.shape)
    (tmp_path / "finger.vtu").write_bytes(vtu_bytes(mesh, displacement))
    read = meshio.read(tmp_path / "finger.vtu")
    np.testing.assert_array_equal(read.points, mesh.nodes_mm)
    np.testing.assert_array_equal(read.point_data["displacement_mm"], displacement)
    (cells,) = read.cells
    assert cells.type == "hexahedron"
    (number,) = read.cell_data["block"]
    assert list(read.field_data) == ["gel", "film", "skeleton", "base_plate", "backing", "mirror"]
    for name, hexahedra in mesh.hexahedra.items():
        np.testing.assert_array_equal(cells.data[number == read.field_data[name][0]], hexahedra)


def test_another_program_reads_the_contact_pressure(mesh, tmp_path):
    pressure = np.random.default_rng(4).uniform(0.0, 0.1, len(mesh.nodes_mm))
    (tmp_path / "finger.vtu").write_bytes(vtu_bytes(mesh, np.zeros_like(mesh.nodes_mm), pressure))
    read = meshio.read(tmp_path / "finger.vtu")
    assert set(read.point_data) == {"displacement_mm", "contact_pressure_mpa"}
    np.testing.assert_array_equal(read.point_data["contact_pressure_mpa"], pressure)
    with pytest.raises(SimulateError, match=r"contact_pressure_mpa must .* the shape of the nodes, \(\d+,\)"):
        vtu_bytes(mesh, None, pressure[1:])


def test_a_finger_at_rest_has_no_displacement(mesh, tmp_path):
    (tmp_path / "rest.vtu").write_bytes(vtu_bytes(mesh))
    read = meshio.read(tmp_path / "rest.vtu")
    assert not read.point_data
    assert len(read.points) == len(mesh.nodes_mm)


@pytest.mark.parametrize("wrong", ["shape", "value"])
def test_a_displacement_that_is_not_one_per_node_is_refused(mesh, wrong):
    displacement = np.zeros_like(mesh.nodes_mm)
    if wrong == "value":
        displacement[0, 0] = np.nan
    else:
        displacement = displacement[1:]
    with pytest.raises(
        SimulateError, match=r"displacement_mm must be finite and have the shape of the nodes, \(\d+, 3\)"
    ):
        vtu_bytes(mesh, displacement)
