"""A pressed finger as an input deck for Abaqus or CalculiX; mm, N, MPa."""

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from sim.mechanics.materials import Material
from sim.mechanics.mesh import Block, FingerMesh
from sim.mechanics.other_engines.deck_indenter import IndenterSurface
from sim.mechanics.other_engines.deck_materials import Dialect, deck_materials
from sim.surface_meshes.hexahedra import FACES

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_PER_LINE = 12  # Abaqus allows 16 numbers in a line
_SHELL_MM = 1.0  # thickness of CalculiX' shell of hexahedra in the place of a rigid surface
_SHEETS = ("film", "mirror")
_CYCLES = {0: [0, 3, 7, 4, 1, 2, 6, 5], 1: [0, 4, 5, 1, 3, 7, 6, 2], 2: [0, 1, 2, 3, 4, 5, 6, 7]}
_EDGES = {0: (0, 1), 1: (0, 3), 2: (0, 4)}
# the gel is nearly incompressible: full integration locks in CalculiX (+12 % of force on a block), one point does not
_CALCULIX: Final = {"mean_dilatation": "C3D8R", "incompatible_modes": "C3D8I"}
_SMALLEST_STEP = 1e-4


@dataclass(frozen=True, slots=True)
class Push:
    """What is done to a finger: the indenter at first touch, how far it goes, and how contact and solver are set.

    Attributes
    ----------
    indenter
        Surface of the indenter.
    depth_mm
        Push along -y.
    increments
        Equal steps that are wanted.
    stiffness_mpa_per_mm
        Of the contact.
    friction
        Coulomb's coefficient.
    """

    indenter: IndenterSurface
    depth_mm: float
    increments: int
    stiffness_mpa_per_mm: float
    friction: float = 0.0


def deck_lines(
    mesh: FingerMesh, materials: dict[str, Material], push: Push, dialect: Dialect, heading: Iterable[str]
) -> Iterator[str]:
    """Yield the lines of a deck.

    Nodes and elements are numbered from 1 in the order of the mesh; the indenter's follow. Node sets FIXED, FLANGE,
    INDENTER (Abaqus: the reference node alone); element sets are named as the blocks, in capitals. Abaqus: C3D8R with
    enhanced hourglass control, CSS8 with its thickness along the third direction for film and mirror, R3D4 for the
    indenter, and a results file in ASCII. CalculiX: C3D8I, C3D8R for the gel, and for the indenter a shell of
    hexahedra all of whose nodes are prescribed; the solver is the one that the program was built with.

    Parameters
    ----------
    mesh
        Finger with its node set "fixed", surface "coat" and ties.
    materials
        By the names that the blocks give.
    push
        Indenter and contact.
    dialect
        Program.
    heading
        What the file is about: comments at its top, to which notes on the materials are added.

    Raises
    ------
    SimulateError
        When the push is not one, or the program cannot hold a material.
    """
    if push.depth_mm <= 0.0 or push.increments < 1:
        raise SimulateError(
            f"a deck needs a push above 0 mm in at least one increment, got {push.depth_mm:g} mm in {push.increments}"
        )
    used = {block.material for block in mesh.blocks}
    found = deck_materials({name: m for name, m in materials.items() if name in used}, dialect)
    yield from (f"** {_one_line(text)}" for text in (*heading, *found.notes))
    yield "*HEADING"
    yield f"finger under a rigid indenter, push of {push.depth_mm:g} mm; mm, N, MPa"
    yield from _nodes(mesh.nodes_mm, 1, "FINGER")
    first = yield from _elements(mesh, dialect)
    yield from _indenter(push.indenter, len(mesh.nodes_mm) + 1, first, dialect)
    yield from _named_sets(mesh)
    yield from found.lines
    yield from _sections(mesh, dialect)
    yield from _contact(push, dialect)
    yield from _step(push, mesh, dialect)


def _one_line(text: str) -> str:
    """Return a comment as both programs read it: one line of ASCII."""
    return " ".join(text.split()).encode("ascii", "replace").decode("ascii")


def _nodes(places_mm: FloatArray, first: int, name: str) -> Iterator[str]:
    """Yield nodes with their set."""
    yield f"*NODE, NSET={name}"
    for number, (x, y, z) in enumerate(places_mm.tolist(), first):
        yield f"{number}, {x:.9g}, {y:.9g}, {z:.9g}"


def _cells(cells: IntArray, first: int, kind: str, name: str) -> Iterator[str]:
    """Yield elements with their set; corners count from 0."""
    yield f"*ELEMENT, TYPE={kind}, ELSET={name}"
    for number, corners in enumerate((cells + 1).tolist(), first):
        yield f"{number}, {', '.join(map(str, corners))}"


def _element_type(block: Block, dialect: Dialect) -> str:
    """Return the element of a block: the paper's for Abaqus."""
    if dialect == "calculix":
        return _CALCULIX[block.element]
    return "CSS8" if block.name in _SHEETS else "C3D8R"


def _elements(mesh: FingerMesh, dialect: Dialect) -> Generator[str, None, int]:
    """Yield the blocks; return the next free number."""
    first = 1
    for block in mesh.blocks:
        kind = _element_type(block, dialect)
        cells = _stacked(block.hexahedra, mesh.nodes_mm) if kind == "CSS8" else block.hexahedra
        yield from _cells(cells, first, kind, block.name.upper())
        first += len(cells)
    return first


def _stacked(hexahedra: IntArray, nodes_mm: FloatArray) -> IntArray:
    """Return hexahedra turned so that their third direction, the thickness of CSS8, is the thinnest one."""
    lengths = [
        float(np.linalg.norm(nodes_mm[hexahedra[:, b]] - nodes_mm[hexahedra[:, a]], axis=1).mean())
        for a, b in _EDGES.values()
    ]
    return hexahedra[:, _CYCLES[int(np.argmin(lengths))]]


def _indenter(surface: IndenterSurface, node: int, element: int, dialect: Dialect) -> Iterator[str]:
    """Yield the indenter: a rigid surface with a reference node, or a shell of hexahedra."""
    count = len(surface.nodes_mm)
    facets = surface.quads + node - 1
    yield from _nodes(surface.nodes_mm, node, "INDENTER_NODES")
    if dialect == "abaqus":
        yield from _nodes(surface.nodes_mm.mean(axis=0, keepdims=True), node + count, "INDENTER")
        yield from _cells(facets, element, "R3D4", "INDENTER_FACETS")
        yield f"*RIGID BODY, REF NODE={node + count}, ELSET=INDENTER_FACETS"
        yield from ("*SURFACE, NAME=S_INDENTER, TYPE=ELEMENT", "INDENTER_FACETS, SPOS")
        return
    yield from _nodes(surface.nodes_mm + _SHELL_MM * surface.inward, node + count, "INDENTER_NODES")
    yield from _cells(np.hstack([facets + count, facets]), element, "C3D8", "INDENTER_FACETS")
    yield from ("*NSET, NSET=INDENTER", "INDENTER_NODES,", "*SURFACE, NAME=S_INDENTER, TYPE=ELEMENT")
    yield "INDENTER_FACETS, S2"


def _named_sets(mesh: FingerMesh) -> Iterator[str]:
    """Yield node sets, the coat and the ties' surfaces."""
    yield from _node_set("FIXED", mesh.node_sets["fixed"])
    for name in ("coat", "flange"):
        if name in mesh.node_sets:
            yield from _node_set(name.upper(), mesh.node_sets[name])
    yield from _surface("S_COAT", mesh, mesh.surfaces["coat"])
    for number, tie in enumerate(mesh.ties, 1):
        yield from _node_set(f"TIED_{number}", tie.slave_nodes)
        yield from (f"*SURFACE, NAME=S_TIED_{number}, TYPE=NODE", f"TIED_{number},")
        yield from _surface(f"S_TO_{number}", mesh, tie.master_quads)
        # all slave nodes lie on the master faces; 0.1 mm is beyond any chord of a curved fin
        yield f"*TIE, NAME=TIE_{number}, POSITION TOLERANCE=0.1, ADJUST=NO"
        yield f"S_TIED_{number}, S_TO_{number}"


def _node_set(name: str, nodes: IntArray) -> Iterator[str]:
    """Yield a node set."""
    yield f"*NSET, NSET={name}"
    numbers = [str(n + 1) for n in nodes.tolist()]
    for k in range(0, len(numbers), _PER_LINE):
        yield ", ".join(numbers[k : k + _PER_LINE]) + ","


def _surface(name: str, mesh: FingerMesh, quads: IntArray) -> Iterator[str]:
    """Yield a surface as faces of elements."""
    cells = np.concatenate([block.hexahedra for block in mesh.blocks])
    wanted = np.isin(cells, quads).sum(axis=1) >= 4
    near = np.flatnonzero(wanted)
    faces = np.sort(cells[near][:, FACES], axis=2).reshape(-1, 4)
    number_of = {tuple(face): k for k, face in enumerate(faces.tolist())}
    yield f"*SURFACE, NAME={name}, TYPE=ELEMENT"
    for quad in np.sort(quads, axis=1).tolist():
        owner, face = divmod(number_of[tuple(quad)], len(FACES))
        yield f"{near[owner] + 1}, S{face + 1}"


def _sections(mesh: FingerMesh, dialect: Dialect) -> Iterator[str]:
    """Yield the sections."""
    controls = ""
    if dialect == "abaqus":
        yield "*SECTION CONTROLS, NAME=ONE_POINT, HOURGLASS=ENHANCED"
        controls = ", CONTROLS=ONE_POINT"
    for block in mesh.blocks:
        ends = controls if _element_type(block, dialect) == "C3D8R" else ""
        yield f"*SOLID SECTION, ELSET={block.name.upper()}, MATERIAL={block.material.upper()}{ends}"
    if dialect == "calculix":
        # prescribed all over: any material will do
        yield from ("*MATERIAL, NAME=INDENTER_MATERIAL", "*ELASTIC", "2100, 0.38")
        yield "*SOLID SECTION, ELSET=INDENTER_FACETS, MATERIAL=INDENTER_MATERIAL"


def _contact(push: Push, dialect: Dialect) -> Iterator[str]:
    """Yield the contact of the coat with the indenter."""
    yield "*SURFACE INTERACTION, NAME=TOUCH"
    if dialect == "abaqus":
        yield from ("*SURFACE BEHAVIOR, PENALTY=LINEAR", f"{push.stiffness_mpa_per_mm:.6g}")
    else:
        yield from ("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", f"{push.stiffness_mpa_per_mm:.6g}")
    if push.friction > 0.0:
        stick = f", {push.stiffness_mpa_per_mm / 10.0:.6g}" if dialect == "calculix" else ""
        yield from ("*FRICTION", f"{push.friction:.6g}{stick}")
    yield "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE"
    yield "S_COAT, S_INDENTER"


def _step(push: Push, mesh: FingerMesh, dialect: Dialect) -> Iterator[str]:
    """Yield supports, the push and what is to be written."""
    step = 1.0 / push.increments
    last = "6" if dialect == "abaqus" else "3"
    yield from ("*BOUNDARY", "FIXED, 1, 3", "INDENTER, 1, 1", f"INDENTER, 3, {last}")
    yield "*STEP, NLGEOM=YES, INC=1000" if dialect == "abaqus" else "*STEP, NLGEOM, INC=1000"
    yield from ("*STATIC", f"{step:.8g}, 1., {_SMALLEST_STEP:g}, {step:.8g}")
    yield from ("*BOUNDARY", f"INDENTER, 2, 2, {-push.depth_mm:.8g}")
    if dialect == "abaqus":
        yield from ("*OUTPUT, FIELD, VARIABLE=PRESELECT", "*FILE FORMAT, ASCII", "*NODE FILE, NSET=FINGER", "U")
        yield from ("*NODE FILE, NSET=INDENTER", "U, RF")
    else:
        yield from ("*NODE PRINT, NSET=INDENTER, TOTALS=ONLY", "RF")
        for block in mesh.blocks:
            yield from (f"*EL PRINT, ELSET={block.name.upper()}, TOTALS=ONLY", "ELSE")
        yield from ("*NODE FILE", "U", "*CONTACT FILE", "CDIS, CSTR")
    yield "*END STEP"
