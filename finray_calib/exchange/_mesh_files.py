"""A finger's solids and its mesh as files: printed parts and mould (STL, STEP), finite elements (VTU).

Slicers read STL. STEP files (ISO 10303-21, AP214) hold exact planes, cylinders and ellipsoids, no facets, for CAD
programs. A VTK unstructured grid (.vtu) of the finite-element mesh opens in ParaView and other viewers.
"""

import base64
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal
from xml.etree import ElementTree as ET

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, ImportFormatError, SimulateError, TactileCapture
from sim.mechanics import FingerMesh, Part, mould_sizes, mould_solid, mould_stl, part_solid, part_stl
from sim.surface_meshes import Edge, EllipseArc, Face, HollowCylinder, HollowEllipsoid, Plane, Solid, stl_bytes

PrintFormat = Literal["stl", "step"]


@dataclass(frozen=True, slots=True)
class PrintablePart:
    """One part: its size across, along the pad's normal and along the finger, what to know of it, files by format."""

    name: str
    size_mm: tuple[float, float, float]
    note: str
    files: dict[PrintFormat, bytes]


def printable_parts(
    design: FingerDesign,
    formats: Sequence[PrintFormat] = ("stl", "step"),
    one_piece: bool = False,
    lining_mm: float | None = None,
) -> tuple[PrintablePart, ...]:
    """Return what a finger is printed from, in mm and in the finger's axes, so that the parts fit together.

    Skeleton and base plate are prints of their own, because the base is stiffer; so is the backing, where there is one.
    Each part is one closed body. Equal designs give equal bytes.

    Parameters
    ----------
    design
        Finger.
    formats
        "stl": triangles. "step": planes, and the exact cylinder or ellipsoid on the bottom of the mould; curved fins
        are strips of 1 mm, 0.3 um from their curve, in both.
    one_piece
        Skeleton and base plate as one body, for a finger that is printed of one material.
    lining_mm
        Sheet laid on the bottom of the mould; by default 0.1 mm, and none in an ellipsoidal mould.

    Raises
    ------
    SimulateError
        When the parts do not fit together, or a lining is given to an ellipsoidal mould.
    """
    names: list[Part] = ["skeleton_and_base"] if one_piece else ["skeleton", "base_plate"]
    if design.skeleton.backing is not None:
        names.append("backing")
    parts = [_part(name, part_solid(design, name), partial(part_stl, design, name), design, formats) for name in names]
    sizes = mould_sizes(design, lining_mm)
    as_stl = partial(mould_stl, design, sizes.wall_mm, sizes.floor_mm, sizes.lining_mm)
    note = (
        f"before casting, lay a smooth sheet of {sizes.lining_mm:g} mm on the floor inside" if sizes.lining_mm else ""
    )
    return (*parts, _part("mould", mould_solid(design, sizes), as_stl, design, formats, note))


def _part(
    name: str,
    solid: Solid,
    as_stl: Callable[[], bytes],
    design: FingerDesign,
    formats: Sequence[PrintFormat],
    note: str = "",
) -> PrintablePart:
    """Return a part with its files."""
    files: dict[PrintFormat, bytes] = {}
    if "stl" in formats:
        files["stl"] = as_stl()
    if "step" in formats:
        files["step"] = step_bytes(solid, f"{name} of {design.name}")
    x, y, z = np.ptp(solid.corners_mm, axis=0)
    return PrintablePart(name, (float(x), float(y), float(z)), note, files)


Floats = NDArray[np.float64]
# corners of curved faces lie on them up to rounding
_UNCERTAINTY_MM = 1e-6


def step_bytes(solid: Solid, name: str) -> bytes:
    """Return a solid as a STEP file in mm; equal solids give equal bytes (the file bears no date).

    Parameters
    ----------
    solid
        Solid.
    name
        Of the part, as CAD programs show it.
    """
    file = _StepFile()
    shell = file.add("CLOSED_SHELL", "''", _list(_faces(file, solid)))
    body = file.add("MANIFOLD_SOLID_BREP", _text(name), shell)
    origin = file.placement(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    shape = file.add("ADVANCED_BREP_SHAPE_REPRESENTATION", _text(name), _list([origin, body]), _units(file))
    file.add("SHAPE_DEFINITION_REPRESENTATION", _product(file, name), shape)
    header = (
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
        f"FILE_NAME({_text(name)},'',(''),(''),'finray-calib','','');\n"
        "FILE_SCHEMA(('AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }'));\nENDSEC;\nDATA;\n"
    )
    return (header + "".join(file.lines) + "ENDSEC;\nEND-ISO-10303-21;\n").encode("ascii")


class _StepFile:
    """Numbered lines of the data section; equal directions share one line."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._known: dict[str, str] = {}

    def add(self, kind: str, *values: str) -> str:
        """Add an entity and return its name."""
        return self.add_text(f"{kind}({','.join(values)})")

    def add_text(self, text: str) -> str:
        """Add an entity of several kinds, written out, and return its name."""
        name = f"#{len(self.lines) + 1}"
        self.lines.append(f"{name}={text};\n")
        return name

    def point(self, place_mm: Floats) -> str:
        """Add a point."""
        return self.add("CARTESIAN_POINT", "''", _numbers(place_mm))

    def direction(self, vector: Floats) -> str:
        """Add a direction, once."""
        text = _numbers(vector / np.linalg.norm(vector))
        if text not in self._known:
            self._known[text] = self.add("DIRECTION", "''", text)
        return self._known[text]

    def placement(self, place_mm: Floats, axis: Floats, across: Floats) -> str:
        """Add a place with its z axis and its x axis."""
        return self.add("AXIS2_PLACEMENT_3D", "''", self.point(place_mm), self.direction(axis), self.direction(across))


def _faces(file: _StepFile, solid: Solid) -> list[str]:
    """Add corners, edges and faces, and return the faces."""
    corners = [file.add("VERTEX_POINT", "''", file.point(corner)) for corner in solid.corners_mm]
    edges = [
        file.add("EDGE_CURVE", "''", corners[edge.start], corners[edge.end], _curve(file, edge, solid), ".T.")
        for edge in solid.edges
    ]
    return [_face(file, face, edges) for face in solid.faces]


def _curve(file: _StepFile, edge: Edge, solid: Solid) -> str:
    """Add the curve of an edge."""
    if edge.arc is not None:
        return _ellipse(file, edge.arc)
    start, end = solid.corners_mm[edge.start], solid.corners_mm[edge.end]
    vector = file.add("VECTOR", "''", file.direction(end - start), "1.")
    return file.add("LINE", "''", file.point(start), vector)


def _ellipse(file: _StepFile, arc: EllipseArc) -> str:
    """Add an ellipse, its larger semi-axis first, as some readers want it."""
    u, v = (arc.u_mm, arc.v_mm) if arc.u_mm @ arc.u_mm >= arc.v_mm @ arc.v_mm else (arc.v_mm, -arc.u_mm)
    place = file.placement(arc.centre_mm, np.cross(u, v), u)
    long_mm, short_mm = (float(np.linalg.norm(axis)) for axis in (u, v))
    if np.isclose(long_mm, short_mm, rtol=1e-12, atol=0.0):
        return file.add("CIRCLE", "''", place, _number(long_mm))
    return file.add("ELLIPSE", "''", place, _number(long_mm), _number(short_mm))


def _face(file: _StepFile, face: Face, edges: list[str]) -> str:
    """Add a face with its bounds."""
    surface, outward = _surface(file, face.surface)
    bounds = []
    for place, loop in enumerate(face.loops):
        runs = [file.add("ORIENTED_EDGE", "''", "*", "*", edges[edge], _logical(forward)) for edge, forward in loop]
        kind = "FACE_BOUND" if place else "FACE_OUTER_BOUND"
        bounds.append(file.add(kind, "''", file.add("EDGE_LOOP", "''", _list(runs)), ".T."))
    return file.add("ADVANCED_FACE", "''", _list(bounds), surface, _logical(outward))


def _surface(file: _StepFile, surface: Plane | HollowCylinder | HollowEllipsoid) -> tuple[str, bool]:
    """Add a surface; tell whether its own normal points out of the solid."""
    if isinstance(surface, Plane):
        place = file.placement(surface.point_mm, surface.normal, _across(surface.normal))
        return file.add("PLANE", "''", place), True
    if isinstance(surface, HollowCylinder):
        place = file.placement(surface.centre_mm, surface.axis, _across(surface.axis))
        return file.add("CYLINDRICAL_SURFACE", "''", place, _number(surface.radius_mm)), False
    return _ellipsoid(file, surface), True


def _across(axis: Floats) -> Floats:
    """Return a direction perpendicular to another."""
    return np.asarray(np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))]))


def _ellipsoid(file: _StepFile, surface: HollowEllipsoid) -> str:
    """Add the cap of an ellipsoid as a rational patch of second degree, which is exact; d/du x d/dv points inward.

    Coefficients of a product of at most quadratic polynomials in u and v at the patch's control points are its polar
    forms: 1, u, u^2 become 1, (-U, 0, U) and (U^2, -U^2, U^2) on -U .. U.
    """
    (one, u, uu), (_, v, vv) = (
        (np.ones(3), most * np.array([-1.0, 0.0, 1.0]), most**2 * np.array([1.0, -1.0, 1.0]))
        for most in (surface.tan_half_across, surface.tan_half_along)
    )
    u, uu, v, vv = (np.outer(u, one), np.outer(uu, one), np.outer(one, v), np.outer(one, vv))
    weights = 1.0 + uu + vv
    unit = np.stack([2.0 * u, 1.0 - uu - vv, 2.0 * v], axis=-1) / weights[..., None]
    poles = surface.centre_mm + unit * surface.semi_axes_mm
    points = _list(_list(file.point(pole) for pole in row) for row in poles)
    return file.add_text(
        f"(BOUNDED_SURFACE()B_SPLINE_SURFACE(2,2,{points},.UNSPECIFIED.,.F.,.F.,.F.)"
        "B_SPLINE_SURFACE_WITH_KNOTS((3,3),(3,3),(0.,1.),(0.,1.),.UNSPECIFIED.)GEOMETRIC_REPRESENTATION_ITEM()"
        f"RATIONAL_B_SPLINE_SURFACE({_list(_numbers(row) for row in weights)})REPRESENTATION_ITEM('')SURFACE())"
    )


def _units(file: _StepFile) -> str:
    """Add the units: mm, rad, sr."""
    length = file.add_text("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    angle = file.add_text("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid_angle = file.add_text("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    uncertainty = file.add(
        "UNCERTAINTY_MEASURE_WITH_UNIT",
        f"LENGTH_MEASURE({_number(_UNCERTAINTY_MM)})",
        length,
        "'distance_accuracy_value'",
        "''",
    )
    return file.add_text(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT(({uncertainty}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT(({length},{angle},{solid_angle}))REPRESENTATION_CONTEXT('',''))"
    )


def _product(file: _StepFile, name: str) -> str:
    """Add what the shape is the shape of."""
    context = file.add("APPLICATION_CONTEXT", "'automotive design'")
    file.add("APPLICATION_PROTOCOL_DEFINITION", "'international standard'", "'automotive_design'", "2000", context)
    of_product = file.add("PRODUCT_CONTEXT", "''", context, "'mechanical'")
    product = file.add("PRODUCT", _text(name), _text(name), "''", _list([of_product]))
    file.add("PRODUCT_RELATED_PRODUCT_CATEGORY", "'part'", "$", _list([product]))
    version = file.add("PRODUCT_DEFINITION_FORMATION", "''", "''", product)
    of_design = file.add("PRODUCT_DEFINITION_CONTEXT", "'part definition'", context, "'design'")
    definition = file.add("PRODUCT_DEFINITION", "'design'", "''", version, of_design)
    return file.add("PRODUCT_DEFINITION_SHAPE", "''", "''", definition)


def _list(values: Iterable[str]) -> str:
    """Return values in brackets."""
    return f"({','.join(values)})"


def _numbers(values: Floats) -> str:
    """Return real numbers in brackets."""
    return _list(_number(float(value)) for value in values)


def _number(value: float) -> str:
    """Return a real number so that it is read back exactly: with a point, its exponent with a capital E."""
    digits, _, exponent = repr(value + 0.0).partition("e")
    return (digits if "." in digits else digits + ".") + (f"E{int(exponent)}" if exponent else "")


def _logical(value: bool) -> str:
    """Return a truth value."""
    return ".T." if value else ".F."


def _text(value: str) -> str:
    """Return a string: quotes and backslashes doubled, other than printable ASCII as UTF-16 or UTF-32 numbers."""
    written = []
    for letter in value:
        if " " <= letter <= "~":
            written.append(letter * 2 if letter in "'\\" else letter)
        elif ord(letter) < 0x10000:
            written.append(f"\\X2\\{ord(letter):04X}\\X0\\")
        else:
            written.append(f"\\X4\\{ord(letter):08X}\\X0\\")
    return f"'{''.join(written)}'"


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
            raise SimulateError(
                f"{name} must be finite and have the shape of the nodes, {shapes[name]}, got shape {values.shape}"
            )
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


def outline_solid_stl(capture: TactileCapture, height_mm: float) -> bytes:
    """Return the straight solid over the hull of a capture's contact outline as an STL file, mm.

    Its axes are those of a design's indenter: x along the picture's columns, z against its rows, y up from the face
    that touches. Its origin lies in the middle of the picture, so that a design places it where the camera looks:
    ``indenter.position_mm`` is the pad's middle plus ``camera.along_mm``, and ``indenter.across_mm`` is
    ``camera.across_mm``.

    Parameters
    ----------
    capture
        With an outline and a scale.
    height_mm
        Of the solid.

    Raises
    ------
    ImportFormatError
        The capture has no outline or no scale, or the outline lies on one line.
    """
    if not capture.contact_outline or capture.mm_per_px is None:
        raise ImportFormatError(f"{capture.name}: has no contact outline in mm; give [contact] and [scale]")
    places = np.array([(p.column_px, p.row_px) for p in capture.contact_outline], dtype=np.float32)
    corners = cv2.convexHull(places)[:, 0].astype(np.float64)
    if len(corners) < 3:
        raise ImportFormatError(
            f"{capture.name}: the contact outline lies on one line; give at least three corners that do not"
        )
    rows, columns = capture.contact.shape[:2]
    x, z = capture.mm_per_px * (corners - np.array([columns - 1, rows - 1]) / 2.0).T * np.array([[1.0], [-1.0]])
    if (x * np.roll(z, -1) - z * np.roll(x, -1)).sum() < 0.0:
        x, z = x[::-1], z[::-1]
    n = len(x)
    vertices = np.concatenate([np.column_stack([x, np.full(n, y), z]) for y in (0.0, height_mm)])
    fan = np.array([(0, k, k + 1) for k in range(1, n - 1)])
    after = np.roll(np.arange(n), -1)
    sides = [(k, k + n, after[k]) for k in range(n)] + [(after[k], k + n, after[k] + n) for k in range(n)]
    # seen along +y, from below, a turn from x to z is counter-clockwise
    triangles = np.concatenate([fan, fan[:, ::-1] + n, np.array(sides)])
    title = f"contact of {capture.name}"[:80].encode("ascii", "replace").decode()
    return stl_bytes(triangles.astype(np.int64), vertices, title)
