"""Decks read back: by meshio, which reads Abaqus' format, and by their lines; and ``finray export deck``."""

import re
from collections import Counter

import meshio
import numpy as np
import pytest

from data_schemas import FingerDesign, Indenter, OgdenSolid, SimulateError
from data_schemas._design_parts import MechanicalMaterials
from sim import design_toml
from sim.mechanics import Cylinder, Pose, RoundedBox, Sphere, finger_materials, finger_mesh
from sim.mechanics._finger_mesh import MeshSteps
from sim.mechanics.other_engines import finger_deck
from sim.mechanics.other_engines._deck import Push, deck_lines, finger_push, indenter_surface
from sim.surface_meshes import HEXAHEDRON_FACES
from tests.command_line.running import finray, succeed
from tests.simulate.surface_quality import hexahedra_volume_mm3

DESIGN = FingerDesign()


@pytest.fixture(scope="module")
def mesh():
    return finger_mesh(DESIGN, steps=MeshSteps(5.0, 3.0, 5.0, 5.0))


@pytest.fixture(scope="module")
def decks(mesh):
    return {
        dialect: list(finger_deck(DESIGN, dialect, "coarse", 3, "finray export deck", mesh=mesh))
        for dialect in ("abaqus", "calculix")
    }


def below(lines, head, count=1):
    at = next(k for k, line in enumerate(lines) if line.startswith(head))
    return lines[at + 1 : at + 1 + count]


def numbers(lines, head):
    """All data lines under a keyword."""
    at = next(k for k, line in enumerate(lines) if line == head)
    end = next(k for k in range(at + 1, len(lines)) if lines[k].startswith("*"))
    return [[float(v) for v in line.rstrip(",").split(",")] for line in lines[at + 1 : end]]


def elements(lines, name):
    (head,) = (line for line in lines if re.fullmatch(rf"\*ELEMENT, TYPE=\w+, ELSET={name}", line))
    return head.split("TYPE=")[1].split(",")[0], np.array(numbers(lines, head), dtype=np.int64)


def test_another_program_reads_nodes_and_elements(mesh, decks, tmp_path):
    # meshio knows one list of nodes and no continuum shells
    finger = decks["abaqus"][: decks["abaqus"].index("*NODE, NSET=INDENTER_NODES")]
    (tmp_path / "x.inp").write_text("\n".join(finger).replace("TYPE=CSS8", "TYPE=C3D8") + "\n")
    read = meshio.read(tmp_path / "x.inp")
    # nine digits are written
    np.testing.assert_allclose(read.points, mesh.nodes_mm, atol=1e-6)
    hexahedra = np.concatenate([cells.data for cells in read.cells])
    assert len(hexahedra) == sum(map(len, mesh.hexahedra.values()))
    assert (hexahedra_volume_mm3(read.points, hexahedra) > 0.0).all()


def test_the_papers_elements_for_abaqus(mesh, decks):
    kinds = {name: elements(decks["abaqus"], name.upper())[0] for name in mesh.hexahedra}
    assert kinds == {**dict.fromkeys(mesh.hexahedra, "C3D8R"), "film": "CSS8", "mirror": "CSS8"}
    assert elements(decks["abaqus"], "INDENTER_FACETS")[0] == "R3D4"
    assert any(line.startswith("*RIGID BODY, REF NODE=") for line in decks["abaqus"])
    assert below(decks["abaqus"], "*HYPERELASTIC, OGDEN, N=2")[0].startswith("6.279, 1.6663, 1.639, -7.136, ")


@pytest.mark.parametrize("sheet", ["film", "mirror"])
def test_continuum_shells_are_stacked_through_their_thickness(mesh, decks, sheet):
    _, rows = elements(decks["abaqus"], sheet.upper())
    cells = rows[:, 1:] - 1
    assert (np.sort(cells, axis=1) == np.sort(mesh.hexahedra[sheet], axis=1)).all()
    assert (hexahedra_volume_mm3(mesh.nodes_mm, cells) > 0.0).all()
    through = np.linalg.norm(mesh.nodes_mm[cells[:, 4:]] - mesh.nodes_mm[cells[:, :4]], axis=2)
    thickness = DESIGN.pad.film.thickness_mm if sheet == "film" else DESIGN.skeleton.mirror_thickness_mm
    # the mirror is curved: its sides stand a little oblique
    np.testing.assert_allclose(through, thickness, rtol=0.1)


def test_elements_of_calculix(mesh, decks):
    kinds = {name: elements(decks["calculix"], name.upper())[0] for name in mesh.hexahedra}
    assert kinds == {**dict.fromkeys(mesh.hexahedra, "C3D8I"), "gel": "C3D8R"}
    surface = finger_push(DESIGN, "coarse", 3).indenter
    kind, rows = elements(decks["calculix"], "INDENTER_FACETS")
    assert kind == "C3D8"
    nodes = np.zeros((rows[:, 1:].max() + 1, 3))
    at = [k for k, line in enumerate(decks["calculix"]) if line == "*NODE, NSET=INDENTER_NODES"]
    for start in at:
        for line in decks["calculix"][start + 1 : start + 1 + len(surface.nodes_mm)]:
            number, *place = line.split(",")
            nodes[int(number)] = [float(v) for v in place]
    assert (hexahedra_volume_mm3(nodes, rows[:, 1:]) > 0.0).all()
    # S2 of the shell is the face that looks at the pad
    outer = rows[:, 1:][:, HEXAHEDRON_FACES[1]] - 1 - len(mesh.nodes_mm)
    assert {frozenset(q) for q in outer.tolist()} == {frozenset(q) for q in surface.quads.tolist()}


@pytest.mark.parametrize("dialect", ["abaqus", "calculix"])
def test_the_coat_is_named_by_its_elements_faces(mesh, decks, dialect):
    lines = decks[dialect]
    cells = np.concatenate([block.hexahedra for block in mesh.blocks])
    at = lines.index("*SURFACE, NAME=S_COAT, TYPE=ELEMENT")
    named = []
    for line in lines[at + 1 : at + 1 + len(mesh.surfaces["coat"])]:
        element, face = line.split(", S")
        named.append(frozenset(cells[int(element) - 1][HEXAHEDRON_FACES[int(face) - 1]].tolist()))
    assert Counter(named) == Counter(frozenset(q) for q in mesh.surfaces["coat"].tolist())


@pytest.mark.parametrize("dialect", ["abaqus", "calculix"])
def test_the_step(decks, dialect):
    lines = decks[dialect]
    assert lines[0] == f"** finger fin-ray-70x35, coarse mesh, for {'Abaqus' if dialect == 'abaqus' else 'CalculiX'}"
    assert "** units: mm, N, MPa; x across the finger, y out of the pad, z from base to tip" in lines
    assert "** written by: finray export deck" in lines
    assert below(lines, "*STATIC") == ["0.33333333, 1., 0.0001, 0.33333333"]
    assert "INDENTER, 2, 2, -1.5" in lines
    assert "FIXED, 1, 3" in lines
    assert lines[-1] == "*END STEP"
    assert max(map(len, lines)) <= 132 or all(line.startswith("**") for line in lines if len(line) > 132)
    # 0.1333 MPa, and D1 = 2 / (20 x 0.2666 MPa)
    assert below(lines, "*HYPERELASTIC, NEO HOOKE") == ["0.1333, 0.3750937734"]


def test_a_stand_in_for_ogdens_law_is_told(decks):
    (note,) = (line for line in decks["calculix"] if "polynomial of the invariants" in line)
    assert re.search(r"deviates by at most 0\.9 % for stretches of 0\.8 to 1\.25", note)
    c10, c01, *_ = (float(v) for v in below(decks["calculix"], "*HYPERELASTIC, POLYNOMIAL, N=2")[0].split(","))
    assert 2.0 * (c10 + c01) == pytest.approx(6.279 + 1.639, rel=1e-8)
    assert not any("polynomial" in line for line in decks["abaqus"])


@pytest.mark.parametrize(
    # two chords of a facet of a ball leave it twice as far as one does, and further where the grid is squeezed
    ("body", "chord_mm"),
    [
        (Cylinder(10.0), 10.0 * (1.0 - np.cos(np.radians(0.75)))),
        (Sphere(4.0), 2.5 * 4.0 * (1.0 - np.cos(np.radians(1.5)))),
        (RoundedBox((8.0, 5.0, 6.0), 1.0), 0.015),
    ],
    ids=["cylinder", "ball", "cuboid"],
)
def test_facets_lie_on_the_indenter(body, chord_mm):
    pose = Pose((1.0, 12.0, 30.0))
    surface = indenter_surface(body, pose, 40.0)
    distance, normal, _ = pose.distances(body, surface.nodes_mm)
    np.testing.assert_allclose(distance, 0.0, atol=1e-9)
    # inside the true surface by no more than is said; a facet's middle lies deepest
    middles, _, _ = pose.distances(body, surface.nodes_mm[surface.quads].mean(axis=1))
    assert (middles <= 1e-9).all()
    assert surface.chord_error_mm == pytest.approx(-middles.min())
    # the bounds are for the chords of a circle: a cylinder keeps them to the distortion of its arc
    assert surface.chord_error_mm <= 1.02 * chord_mm
    edges = surface.nodes_mm[surface.quads]
    facing = np.cross(edges[:, 1] - edges[:, 0], edges[:, 3] - edges[:, 0])
    assert (np.einsum("ij,ij->i", facing, normal[surface.quads[:, 0]]) > 0.0).all()
    assert surface.nodes_mm[:, 1].min() == pytest.approx(12.0 - {Sphere: 4.0, Cylinder: 10.0}.get(type(body), 5.0))


def with_indenter(**changes):
    return DESIGN.model_copy(update={"indenter": Indenter(**changes)})


@pytest.mark.parametrize("turn_deg", [0.0, 90.0])
@pytest.mark.parametrize("position_mm", [5.0, 65.0])
def test_an_endless_cylinder_crosses_the_whole_pad(turn_deg, position_mm):
    push = finger_push(with_indenter(rotation_deg=(0.0, turn_deg, 0.0), position_mm=position_mm), "coarse", 1)
    nodes, pad = push.indenter.nodes_mm, DESIGN.pad
    axis, low, high = (2, 0.0, pad.length_mm) if turn_deg else (0, -pad.width_mm / 2.0, pad.width_mm / 2.0)
    assert nodes[:, axis].min() < low
    assert nodes[:, axis].max() > high


def test_any_name_makes_comments_of_one_line_of_ascii(mesh):
    push = finger_push(DESIGN, "coarse", 1)
    lines = list(deck_lines(mesh, finger_materials(DESIGN), push, "calculix", ["gr\u00f6\u00dfer\n*STEP"]))
    assert lines[0] == "** gr??er *STEP"


@pytest.mark.parametrize(
    ("design", "match"),
    [
        (with_indenter(depth_mm=0.0), "must be above 0 mm for a press"),
        (
            with_indenter(shape="cuboid", size_mm=(20.0, 10.0, 15.0), rotation_deg=(40.0, 0.0, 0.0)),
            "tilts the indenter by 40 deg",
        ),
        (
            with_indenter(shape="ball", radius_mm=3.0, depth_mm=2.0),
            r"contains a ball only up to 60 deg .* Press at most 1\.5 mm deep",
        ),
        (
            with_indenter(shape="mesh", file="x.stl"),
            "deck of CalculiX or Abaqus can contain only a cylinder, a ball or a cuboid",
        ),
    ],
)
def test_a_press_that_a_deck_cannot_hold_is_refused(design, match):
    with pytest.raises(SimulateError, match=match):
        finger_push(design, "coarse", 4)


def test_other_bodies_pushes_and_laws_are_refused(mesh):
    class Cone:
        """A body that no deck knows."""

    with pytest.raises(SimulateError, match="only a cylinder, a ball or a cuboid as indenter"):
        indenter_surface(Cone(), Pose((0.0, 0.0, 0.0)), 1.0)
    push = finger_push(DESIGN, "coarse", 4)
    with pytest.raises(SimulateError, match="a deck needs a push above 0 mm"):
        next(deck_lines(mesh, finger_materials(DESIGN), Push(push.indenter, 0.0, 4, 1.0), "abaqus", ()))
    many = OgdenSolid(mu_mpa=(1.0,) * 7, alpha=(1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5))
    design = DESIGN.model_copy(update={"mechanics": MechanicalMaterials(skeleton=many)})
    with pytest.raises(SimulateError, match="an Abaqus deck can contain at most 6"):
        list(finger_deck(design, "abaqus", mesh=mesh))


def test_a_rubber_that_no_polynomial_follows_is_refused(mesh):
    rubber = OgdenSolid(mu_mpa=(1.0,), alpha=(12.0,))
    design = DESIGN.model_copy(update={"mechanics": MechanicalMaterials(skeleton=rubber)})
    with pytest.raises(
        SimulateError, match=r"every polynomial of second order deviates from this Ogden rubber by 25 % or more"
    ):
        list(finger_deck(design, "calculix", mesh=mesh))


def test_friction_is_written(mesh):
    lines = list(finger_deck(with_indenter(friction=0.3), "abaqus", mesh=mesh))
    assert below(lines, "*FRICTION") == ["0.3"]


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "finger.toml"
    path.write_text(design_toml(DESIGN))
    return path


@pytest.mark.parametrize("dialect", ["abaqus", "calculix"])
def test_the_verb_writes_a_deck_once(stored, tmp_path, dialect):
    out = tmp_path / "x.inp"
    asked = f"export deck {stored} --dialect {dialect} --out {out}"
    assert f"{out}: fin-ray-70x35, coarse mesh, for {dialect}" in succeed(asked)
    assert "*END STEP" in out.read_text()
    again = finray(asked)
    assert (again.status, "exists already" in again.err) == (2, True)


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ("deck {file}", "--dialect is missing, but a deck needs it; give one of abaqus, calculix"),
        ("deck --dialect abaqus", "a deck needs exactly one design"),
        ("deck {file} --dialect abaqus --format csv", "--format is only for paints"),
        ("deck {file} --dialect abaqus --presses 9", "--presses: supported only for a Taxim folder"),
        ("deck {file} --dialect abaqus --paint red=a.json", "--paint: supported only for a Taxim folder"),
        ("{file}", "--format is missing"),
        ("{file} --dialect abaqus", "--dialect: supported only for a deck"),
        ("{file} {file} --format csv", "2 files are given"),
    ],
)
def test_mistakes_of_the_verb(stored, words, match):
    said = finray(f"export {words.format(file=stored)}")
    assert said.status == 2
    assert match in said.err
