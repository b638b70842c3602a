"""A finite-element mesh of the finger as a VTK unstructured grid (.vtu), which ParaView and other viewers open."""

import base64
import sys
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.mechanics.mesh import FingerMesh

VTK_HEXAHEDRON = 12
"""VTK's number of the cell; its corners stand in the order of Abaqus' C3D8."""

_TYPE_NAMES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}


def vtu_bytes(mesh: FingerMesh, displacement_mm: NDArray[np.float64] | None = None) -> bytes:
    """Return a mesh, undeformed, with the displacement of its nodes, as the text of a .vtu file.

    In ParaView, the filter Warp By Vector shows the deformed finger, and ``block`` tells the parts apart; the field
    data hold the number of each part under its name. Lossless: numbers are stored as they are, base64-encoded.

    Parameters
    ----------
    mesh
        Mesh with k blocks.
    displacement_mm
        Of the nodes, shape (n, 3); none for a finger at rest.

    Returns
    -------
    bytes
        XML: points in mm, hexahedra, the point data "displacement_mm" (if given), the cell data "block" (0 to k - 1)
        and, named as the blocks, field data of one such number each.

    Raises
    ------
    SimulateError
        When the displacement is not one finite vector per node.

    Source: VTK User's Guide, "XML file formats", version 1.0 with 64-bit headers.
    """
    if displacement_mm is not None and (
        displacement_mm.shape != mesh.nodes_mm.shape or not np.isfinite(displacement_mm).all()
    ):
        raise SimulateError(
            f"displacement_mm must be finite, of shape {mesh.nodes_mm.shape} as the nodes, got {displacement_mm.shape}"
        )
    hexahedra = np.concatenate([block.hexahedra for block in mesh.blocks])
    owner = np.repeat(np.arange(len(mesh.blocks)), [len(block.hexahedra) for block in mesh.blocks])
    order = {"little": "LittleEndian", "big": "BigEndian"}[sys.byteorder]
    file = ET.Element("VTKFile", type="UnstructuredGrid", version="1.0", byte_order=order, header_type="UInt64")
    grid = ET.SubElement(file, "UnstructuredGrid")
    # numbers under names, not VTK's array of text: that is a type which other readers refuse
    _fill(grid, "FieldData", {block.name: np.array([k], dtype=np.int64) for k, block in enumerate(mesh.blocks)})
    piece = ET.SubElement(grid, "Piece", NumberOfPoints=str(len(mesh.nodes_mm)), NumberOfCells=str(len(hexahedra)))
    points = {} if displacement_mm is None else {"displacement_mm": displacement_mm}
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
