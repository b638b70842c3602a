"""A finite-element mesh of the finger as a VTK unstructured grid (.vtu), which ParaView and other viewers open."""

import base64
import sys
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.mechanics import FingerMesh

VTK_HEXAHEDRON = 12
"""VTK's number of the cell; its corners stand in the order of Abaqus' C3D8."""

_TYPE_NAMES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}


def vtu_bytes(
    mesh: FingerMesh,
    displacement_mm: NDArray[np.float64] | None = None,
    contact_pressure_mpa: NDArray[np.float64] | None = None,
) -> bytes:
    """Return a mesh, undeformed, with the displacement of its nodes and the pressure on them, as a .vtu file's text.

    In ParaView, the filter Warp By Vector shows the deformed finger, and ``block`` tells the parts apart; the field
    data hold the number of each part under its name. Lossless: numbers are stored as they are, base64-encoded.

    Parameters
    ----------
    mesh
        Mesh with k blocks.
    displacement_mm
        Of the nodes, shape (n, 3); none for a finger at rest.
    contact_pressure_mpa
        At the nodes, shape (n,), 0 where nothing touches; none for a finger at rest.

    Returns
    -------
    bytes
        XML: points in mm, hexahedra, the point data "displacement_mm" and "contact_pressure_mpa" (if given), the cell
        data "block" (0 to k - 1) and, named as the blocks, field data of one such number each.

    Raises
    ------
    SimulateError
        When the displacement is not one finite vector per node, or the pressure not one finite number.

    Source: VTK User's Guide, "XML file formats", version 1.0 with 64-bit headers.
    """
    points = _at_nodes(mesh, displacement_mm=displacement_mm, contact_pressure_mpa=contact_pressure_mpa)
    hexahedra = np.concatenate([block.hexahedra for block in mesh.blocks])
    owner = np.repeat(np.arange(len(mesh.blocks)), [len(block.hexahedra) for block in mesh.blocks])
    order = {"little": "LittleEndian", "big": "BigEndian"}[sys.byteorder]
    file = ET.Element("VTKFile", type="UnstructuredGrid", version="1.0", byte_order=order, header_type="UInt64")
    grid = ET.SubElement(file, "UnstructuredGrid")
    # numbers under names, not VTK's array of text: that is a type which other readers refuse
    _fill(grid, "FieldData", {block.name: np.array([k], dtype=np.int64) for k, block in enumerate(mesh.blocks)})
    piece = ET.SubElement(grid, "Piece", NumberOfPoints=str(len(mesh.nodes_mm)), NumberOfCells=str(len(hexahedra)))
    _fill(piece, "PointData", points)
    _fill(piece, "CellData", {"block": owner.astype(np.int64)})
    _fill(piece, "Points", {"Points": mesh.nodes_mm})
    corners = hexahedra.shape[1]
    cells = {
        "connectivity": hexahedra.astype(np.int64).ravel(),
        "offsets": corners * np.arange(1, len(hexahedra) + 1, dtype=np.int64),
        "types": np.full(len(hexahedra), VTK_HEXAHEDRON, dtype=np.uint8),
    }
    _fill(piece, "Cells", cells)
    ET.indent(file, " ")
    return bytes(ET.tostring(file, encoding="utf-8", xml_declaration=True))


def _at_nodes(mesh: FingerMesh, **given: NDArray[np.float64] | None) -> dict[str, NDArray[np.float64]]:
    """Return what is given of vectors and numbers at the nodes, checked."""
    shapes = {"displacement_mm": mesh.nodes_mm.shape, "contact_pressure_mpa": mesh.nodes_mm.shape[:1]}
    found = {name: values for name, values in given.items() if values is not None}
    for name, values in found.items():
        if values.shape != shapes[name] or not np.isfinite(values).all():
            raise SimulateError(f"{name} must be finite, of shape {shapes[name]} as the nodes, got {values.shape}")
    return found


def _fill(piece: ET.Element, section: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Add a section with its arrays, base64 of the number of bytes and the bytes."""
    parent = ET.SubElement(piece, section)
    for name, values in arrays.items():
        attributes = {"type": _TYPE_NAMES[values.dtype.str[1:]], "Name": name, "format": "binary"}
        if section == "FieldData":
            attributes["NumberOfTuples"] = str(len(values))
        if values.ndim == 2:
            attributes["NumberOfComponents"] = str(values.shape[1])
        content = np.ascontiguousarray(values).tobytes()
        array = ET.SubElement(parent, "DataArray", attributes)
        array.text = base64.b64encode(np.uint64(len(content)).tobytes() + content).decode("ascii")
