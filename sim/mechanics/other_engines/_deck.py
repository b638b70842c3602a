"""A pressed finger as an input deck for Abaqus or CalculiX; mm, N, MPa.

It holds the mesh, the materials, the part of the indenter's surface that can touch (as quadrilaterals, at first
touch) and the contact. Where a program does not converge with Ogden's law, a law of the invariants that is fitted to
the rubber stands in.
"""

import math
import textwrap
from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, Preset, SimulateError
from sim.mechanics import (
    STEPS,
    Block,
    Body,
    Cylinder,
    FingerMesh,
    LinearElastic,
    Material,
    Ogden,
    Pose,
    RoundedBox,
    Sphere,
    check_no_path,
    finger_materials,
    finger_mesh,
    penalty_mpa_per_mm,
    rigid_indenter,
)
from sim.surface_meshes import HEXAHEDRON_FACES

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
_MODES: Final = {"uniaxial": -0.5, "planar": 0.0, "equibiaxial": 1.0}
_STRETCHES = 121  # per mode, even in log stretch: the fit changes by under 1e-4 with twice as many
_UNSTRETCHED = 1e-3  # |log stretch| under which a relative deviation of two vanishing stresses means nothing


@dataclass(frozen=True, slots=True)
class NodalField:
    """Values (n, components) at the nodes (n,), which count from 1, at a time of the step, whose period is 1."""

    step_fraction: float
    name: str
    nodes: IntArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class InvariantLaw:
    """Polynomial of second order, sum over i + j = 1, 2 of C_ij (I1 - 3)^i (I2 - 3)^j, with K/2 (J - 1)^2.

    Attributes
    ----------
    c_mpa
        C10, C01, C20, C11, C02.
    bulk_modulus_mpa
        K.
    stretches
        Range of the fit.
    deviation_rel
        Largest relative deviation of its stress from the fitted rubber's in the range: uniaxial, planar, equibiaxial.
    """

    c_mpa: tuple[float, float, float, float, float]
    bulk_modulus_mpa: float
    stretches: tuple[float, float]
    deviation_rel: float


def fit_invariant_law(rubber: Ogden, stretches: tuple[float, float] = (0.8, 1.25)) -> InvariantLaw:
    """Fit the polynomial of second order to a rubber's stresses; the initial shear modulus is kept exactly.

    Least squares of the relative deviation in uniaxial, planar and equibiaxial load, incompressible, evenly over the
    logarithm of the stretch. Outside its range the polynomial is no better than any extrapolation.

    Parameters
    ----------
    rubber
        Material to stand in for.
    stretches
        Least and largest stretch, around 1.

    Raises
    ------
    SimulateError
        When the range does not hold 1 inside, or when the fitted law is not stable in it.
    """
    if not 0.0 < stretches[0] < 1.0 < stretches[1]:
        raise SimulateError(
            f"the stretches of a fit must lie on both sides of 1 and above 0, got {stretches[0]} to {stretches[1]}"
        )
    logs = np.linspace(math.log(stretches[0]), math.log(stretches[1]), _STRETCHES)
    logs = logs[np.abs(logs) > _UNSTRETCHED]
    slopes, aims, curves = zip(*(_slopes(rubber, logs, second) for second in _MODES.values()), strict=True)
    slope, aim = np.concatenate(slopes), np.concatenate(aims)
    # C01 = mu / 2 - C10 keeps the initial shear modulus 2 (C10 + C01)
    half = rubber.shear_modulus_mpa / 2.0
    free = np.column_stack([slope[:, 0] - slope[:, 1], slope[:, 2:]])
    known = half * slope[:, 1]
    solution, *_ = np.linalg.lstsq(free / aim[:, None], (aim - known) / aim)
    c10, c20, c11, c02 = (float(c) for c in solution)
    law = (c10, half - c10, c20, c11, c02)
    for name, curve in zip(_MODES, curves, strict=True):
        if (curve @ law <= 0.0).any():
            raise SimulateError(
                f"the polynomial fitted to mu_mpa = {rubber.mu_mpa}, alpha = {rubber.alpha} loses its stiffness under "
                f"{name} load between stretches of {stretches[0]:g} and {stretches[1]:g}; take a smaller range"
            )
    deviation = float(np.abs(slope @ law / aim - 1.0).max())
    return InvariantLaw(law, rubber.bulk_modulus_mpa, stretches, deviation)


def _slopes(rubber: Ogden, logs: FloatArray, second: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d psi / d log stretch of the five terms (m, 5) and of the rubber (m,), and of the terms once more."""
    share = np.array([1.0, second, -(1.0 + second)])
    stretch = np.exp(np.outer(logs, share))
    i1, i2 = (stretch**2).sum(1) - 3.0, (stretch**-2).sum(1) - 3.0
    d1, d2 = 2.0 * stretch**2 @ share, -2.0 * stretch**-2 @ share
    dd1, dd2 = 4.0 * stretch**2 @ share**2, 4.0 * stretch**-2 @ share**2
    first = np.column_stack([d1, d2, 2.0 * i1 * d1, d1 * i2 + i1 * d2, 2.0 * i2 * d2])
    again = np.column_stack(
        [
            dd1,
            dd2,
            2.0 * (d1**2 + i1 * dd1),
            dd1 * i2 + 2.0 * d1 * d2 + i1 * dd2,
            2.0 * (d2**2 + i2 * dd2),
        ]
    )
    terms = zip(rubber.mu_mpa, rubber.alpha, strict=True)
    aim = sum((2.0 * m / a * (stretch**a @ share) for m, a in terms), np.zeros_like(logs))
    return first, aim, again


Dialect = Literal["abaqus", "calculix"]

_NO_TERM = "1e6"  # D2 in 1/MPa of a term that shall vanish; CalculiX takes 0 for a value of its own
_ABAQUS_TERMS = 6
_LARGEST_DEVIATION_REL = 0.05  # of a stand-in: beside it, the engines are to agree within 3 %


@dataclass(frozen=True, slots=True)
class DeckMaterials:
    """Lines of the materials, and what must be said about them."""

    lines: tuple[str, ...]
    notes: tuple[str, ...]


def deck_materials(materials: Mapping[str, Material], dialect: Dialect) -> DeckMaterials:
    """Return the materials under their names in capitals.

    Ogden's law is written in the 2 mu / alpha^2 convention, which both programs share, with D1 = 2/K. For CalculiX a
    rubber that is not neo-Hookean becomes a polynomial of the invariants: CalculiX 2.20 takes the stretches from the
    roots of a cubic, whose rounding error exceeds the tangent at strains of some 1e-6 to 1e-5. A push of 1 mm in one
    increment passes over these strains and converges with Ogden's law too; one of 0.05 mm does not. A law without
    stretches has nothing to round.

    Raises
    ------
    SimulateError
        When the program cannot hold a material.
    """
    lines: list[str] = []
    notes: list[str] = []
    for name, material in materials.items():
        lines.append(f"*MATERIAL, NAME={name.upper()}")
        if isinstance(material, LinearElastic):
            lines += ["*ELASTIC", _numbers(material.youngs_modulus_mpa, material.poisson_ratio)]
            continue
        if not isinstance(material, Ogden):
            raise SimulateError(
                f"mechanics.{name}: {material.name} is a law of another package, which an input deck of CalculiX or "
                "Abaqus cannot contain; leave law out of the design, or press without --engine calculix"
            )
        d1 = 2.0 / material.bulk_modulus_mpa
        if material.alpha == (2.0,):
            lines += ["*HYPERELASTIC, NEO HOOKE", _numbers(material.mu_mpa[0] / 2.0, d1)]
        elif dialect == "calculix":
            law = _stand_in(name, material)
            lines += ["*HYPERELASTIC, POLYNOMIAL, N=2", f"{_numbers(*law.c_mpa, d1)}, {_NO_TERM}"]
            notes.append(
                f"{name}: a polynomial of the invariants replaces Ogden's law, because CalculiX does not converge with "
                f"that law at small strains; the stress deviates by at most {100.0 * law.deviation_rel:.1f} % for "
                f"stretches of {law.stretches[0]:g} to {law.stretches[1]:g}, and by more beyond"
            )
        else:
            lines += _ogden(name, material, d1)
    return DeckMaterials(tuple(lines), tuple(notes))


def _stand_in(name: str, material: Ogden) -> InvariantLaw:
    """Return the polynomial for a rubber."""
    law = fit_invariant_law(material)
    if law.deviation_rel > _LARGEST_DEVIATION_REL:
        raise SimulateError(
            f"mechanics.{name}: every polynomial of second order deviates from this Ogden rubber by "
            f"{100.0 * law.deviation_rel:.0f} % or more for stretches of {law.stretches[0]:g} to {law.stretches[1]:g}, "
            f"but at most {100.0 * _LARGEST_DEVIATION_REL:g} % are allowed in an input deck of CalculiX. Press without "
            "--engine calculix"
        )
    return law


def _ogden(name: str, material: Ogden, d1: float) -> list[str]:
    """Return Ogden's law: pairs mu, alpha, then D of each term, eight numbers in a line."""
    terms = len(material.mu_mpa)
    if terms > _ABAQUS_TERMS:
        raise SimulateError(
            f"mechanics.{name}: has {terms} Ogden terms, but an Abaqus deck can contain at most {_ABAQUS_TERMS}"
        )
    values = [v for pair in zip(material.mu_mpa, material.alpha, strict=True) for v in pair]
    values += [d1, *[0.0] * (terms - 1)]
    return [f"*HYPERELASTIC, OGDEN, N={terms}", *(_numbers(*values[k : k + 8]) for k in range(0, len(values), 8))]


def _numbers(*values: float) -> str:
    """Return a data line; CalculiX reads 20 characters of each number."""
    return ", ".join(f"{value:.10g}" for value in values)


FACET_DEG: Final = 1.5
"""Turn from one facet to the next: chords leave a radius of 10 mm by 10 (1 - cos 0.75 deg) = 0.9 um."""

_REACH_DEG = 80.0  # from the underside, on all round sides
_BALL_REACH_DEG = 60.0  # a ball pushed in by half its radius; further round, a grid of two turns is squeezed
_BALL_FACET_DEG = 3.0  # facets of a ball count squared; at most 8.4 um inside a radius of 10 mm
_FLAT_MM = 10.0  # a flat stretch is divided too, lest facets be needles


@dataclass(frozen=True, slots=True)
class IndenterSurface:
    """Facets of an indenter towards the pad, outward.

    Attributes
    ----------
    nodes_mm
        Corners (n, 3) at first touch.
    quads
        Facets (m, 4).
    inward
        Unit vectors (n, 3) into the body.
    chord_error_mm
        How far the middles of the facets lie inside the true surface at most.
    """

    nodes_mm: FloatArray
    quads: IntArray
    inward: FloatArray
    chord_error_mm: float


def deepest_ball_mm(radius_mm: float) -> float:
    """Return how deep a ball can be pushed before the gel reaches the rim of its facets."""
    return radius_mm * (1.0 - math.cos(math.radians(_BALL_REACH_DEG)))


def indenter_surface(body: Body, pose: Pose, across_mm: float) -> IndenterSurface:
    """Return the facets of a cylinder, a ball or a rounded cuboid around the direction of the push.

    Each is a box with rounded edges: a ball has no flat part, a cylinder one along its axis only.

    Parameters
    ----------
    body, pose
        The indenter at first touch; it is pushed along -y of the finger.
    across_mm
        Length of an endless cylinder.

    Raises
    ------
    SimulateError
        When the body is of another kind.
    """
    edge_mm, flat_mm, drop_mm, arcs_deg, step_deg = _rounded(body, across_mm)
    turns, shifts = zip(
        *(_profile(f, arc, step_deg) for f, arc in zip(flat_mm, arcs_deg, strict=True)),
        strict=True,
    )
    outward = np.stack(
        np.broadcast_arrays(np.tan(turns[0])[:, None], np.array(-1.0), np.tan(turns[1])[None, :]), axis=-1
    )
    outward = outward / np.linalg.norm(outward, axis=-1, keepdims=True)
    middle = np.stack(np.broadcast_arrays(shifts[0][:, None], np.array(-drop_mm), shifts[1][None, :]), axis=-1)
    # the body's own axes: the push is along -y of a body that is not turned
    points = (middle + edge_mm * outward).reshape(-1, 3) @ pose.rotation.T + np.array(pose.position_mm)
    number = np.arange(len(points)).reshape(outward.shape[:2])
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    inside, _, _ = pose.distances(body, points[quads].mean(axis=1))
    return IndenterSurface(points, quads, -outward.reshape(-1, 3) @ pose.rotation.T, -float(inside.min()))


def _rounded(body: Body, across_mm: float) -> tuple[float, tuple[float, float], float, tuple[float, float], float]:
    """Return edge radius, flat half sizes along x and z, depth of the flat, arcs along x and z, and facets in deg."""
    if isinstance(body, Sphere):
        return body.radius_mm, (0.0, 0.0), 0.0, (_BALL_REACH_DEG, _BALL_REACH_DEG), _BALL_FACET_DEG
    if isinstance(body, Cylinder) and not np.isfinite(body.half_length_mm):
        return body.radius_mm, (across_mm / 2.0, 0.0), 0.0, (0.0, _REACH_DEG), FACET_DEG
    if isinstance(body, RoundedBox):
        x, y, z = (half - body.edge_radius_mm for half in body.half_sizes_mm)
        return body.edge_radius_mm, (x, z), y, (_REACH_DEG, _REACH_DEG), 2.0 * _BALL_FACET_DEG
    raise SimulateError(
        "an input deck of CalculiX or Abaqus can contain only a cylinder, a ball or a cuboid as indenter; change "
        "indenter.shape, or press without "
        "--engine calculix"
    )


def _profile(flat_mm: float, arc_deg: float, step_deg: float) -> tuple[FloatArray, FloatArray]:
    """Return turn in rad and shift in mm of the points along one direction: arc, flat part, arc."""
    arc = np.radians(np.linspace(0.0, arc_deg, round(arc_deg / step_deg) + 1))
    pieces = int(np.ceil(2.0 * flat_mm / _FLAT_MM))
    flat = np.linspace(-flat_mm, flat_mm, pieces + 1) if pieces else np.zeros(1)
    turn = np.concatenate([-arc[:0:-1], np.zeros(len(flat)), arc[1:]])
    shift = np.concatenate([np.full(len(arc) - 1, -flat_mm), flat, np.full(len(arc) - 1, flat_mm)])
    return turn, shift


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
            f"a deck needs a push above 0 mm in at least one increment, got {push.depth_mm:g} mm in {push.increments} "
            "increments"
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
    faces = np.sort(cells[near][:, HEXAHEDRON_FACES], axis=2).reshape(-1, 4)
    number_of = {tuple(face): k for k, face in enumerate(faces.tolist())}
    yield f"*SURFACE, NAME={name}, TYPE=ELEMENT"
    for quad in np.sort(quads, axis=1).tolist():
        owner, face = divmod(number_of[tuple(quad)], len(HEXAHEDRON_FACES))
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


_STEEPEST_DEG: Final = 30.0  # the facets of a turned indenter look this far round its side


def finger_push(design: FingerDesign, preset: Preset, increments: int) -> Push:
    """Return the design's press.

    Raises
    ------
    SimulateError
        When there is no push, or a deck cannot hold the indenter.
    """
    depth_mm = design.indenter.depth_mm
    if depth_mm <= 0.0:
        raise SimulateError(f"indenter.depth_mm must be above 0 mm for a press, got {depth_mm:g} mm")
    other = design.indenter.is_packaged or design.indenter.shape == "mesh"
    indenter = None if other else rigid_indenter(design)
    if indenter is None or indenter.body is None:
        raise SimulateError(
            f'indenter.shape = "{design.indenter.shape}" is not supported, because an input deck of CalculiX or '
            "Abaqus can contain only a cylinder, a ball or a cuboid; press other bodies with finray's own elements "
            "(without --engine calculix)"
        )
    tilt_deg = float(np.degrees(np.arccos(np.clip(indenter.touching.rotation[1, 1], -1.0, 1.0))))
    if design.indenter.shape != "ball" and tilt_deg > _STEEPEST_DEG:
        raise SimulateError(
            f"indenter.rotation_deg = {list(design.indenter.rotation_deg)} deg tilts the indenter by {tilt_deg:.0f} "
            f"deg, but at most {_STEEPEST_DEG:g} deg are allowed, because an input deck of CalculiX or Abaqus contains "
            "only its underside. Swap its sizes to turn it by 90 deg, or press with finray's own elements (without "
            "--engine calculix)"
        )
    if design.indenter.shape == "ball" and depth_mm > deepest_ball_mm(design.indenter.radius_mm):
        raise SimulateError(
            f"indenter.depth_mm = {depth_mm:g} mm is too deep, because an input deck of CalculiX or Abaqus contains a "
            f"ball only up to {_BALL_REACH_DEG:g} deg from its lowest point. Press at most "
            f"{deepest_ball_mm(design.indenter.radius_mm):.3g} mm deep with indenter.radius_mm = "
            f"{design.indenter.radius_mm:g} mm, or press with finray's own elements (without --engine calculix)"
        )
    # an endless cylinder is cut off beyond the pad, wherever it lies and whichever way it is turned
    length_mm = 2.0 * (design.pad.width_mm + design.pad.length_mm)
    return Push(
        indenter=indenter_surface(indenter.body, indenter.touching, length_mm),
        depth_mm=depth_mm,
        increments=increments,
        stiffness_mpa_per_mm=penalty_mpa_per_mm(design, STEPS[preset].pad_mm),
        friction=design.indenter.friction,
    )


def finger_deck(
    design: FingerDesign,
    dialect: Dialect,
    preset: Preset | None = None,
    increments: int = 4,
    command: str = "",
    mesh: FingerMesh | None = None,
) -> Iterator[str]:
    """Return the lines of a design's deck; a deck of a fine mesh has a million.

    Parameters
    ----------
    design
        Finger, materials, indenter.
    dialect
        Program.
    preset
        Fineness of the mesh; the design's own by default.
    increments
        Steps of the push.
    command
        That asked for it, for the heading.
    mesh
        The mesh, where it is made already.

    Raises
    ------
    SimulateError
        When the parts do not fit together, or the program cannot hold the press.
    """
    check_no_path(design)
    preset = preset or design.mesh.preset
    push = finger_push(design, preset, increments)
    heading = _heading(design, dialect, preset, push, command)
    return deck_lines(mesh or finger_mesh(design, preset), finger_materials(design), push, dialect, heading)


def _heading(design: FingerDesign, dialect: Dialect, preset: Preset, push: Push, command: str) -> Iterator[str]:
    """Yield what the deck is about."""
    gel = design.mechanics.gel
    yield f"finger {design.name}, {preset} mesh, for {'Abaqus' if dialect == 'abaqus' else 'CalculiX'}"
    yield "units: mm, N, MPa; x across the finger, y out of the pad, z from base to tip"
    if command:
        yield f"written by: {command}"
    yield f"indenter: {design.indenter.shape}, facets at most {1e3 * push.indenter.chord_error_mm:.2g} um inside it"
    yield f"contact: penalty of {push.stiffness_mpa_per_mm:.4g} MPa/mm, friction {push.friction:g}"
    yield (
        f"assumed: K/mu = {gel.bulk_over_shear:g} of the gel and {design.mechanics.skeleton.bulk_over_shear:g} of the "
        "skeleton (the paper gives none)"
    )
    yield "assumed: dimensions that the design's table origin does not list, most of them of the skeleton"
    if dialect == "abaqus":
        yield "not tested with Abaqus, which was not available; elements as in the paper (C3D8R, CSS8, R3D4)"
        yield "one C3D8R through a rib or fin is too soft in bending: take the medium or fine mesh"
    else:
        yield "solver: the default of the program, SPOOLES if it has no other"
    for where in sorted(set(design.origin.values())):
        fields = ", ".join(field for field, origin in design.origin.items() if origin == where)
        yield from textwrap.wrap(f"{where}: {fields}", 116)
