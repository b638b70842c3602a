"""Printed parts and mould as STL and STEP: closed, of the volume of the mesh that is simulated, exact where curved."""

import json
import subprocess
from functools import cache

import numpy as np
import pytest
from scipy.integrate import dblquad

from data_schemas import FingerDesign, SimulateError
from finray_calib.cli import _run as options
from finray_calib.exchange import printable_parts
from finray_calib.exchange._mesh_files import step_bytes
from sim import PRESETS, preset_design
from sim.mechanics import mould_sizes, mould_solid, part_solid, part_stl, skeleton_mesh
from sim.surface_meshes import Edge, Face, Plane, Solid, boundary_quads, planar_solid
from tests.capture.drivers.programs import others_python
from tests.command_line.running import finray, succeed
from tests.exchange.step_reader import StepFile
from tests.simulate.surface_quality import hexahedra_volume_mm3

CURVED = ["cylindrical-r40", "ellipsoidal-30-8-90", "ellipsoidal-45-20-70"]
# volumes summed over some hundred faces in double precision
ROUNDING = 1e-11
WALL_MM, FLOOR_MM = 3.0, 3.0


@cache
def step_of(preset: str, part: str) -> bytes:
    design = preset_design(preset)
    solid = mould_solid(design, mould_sizes(design)) if part == "mould" else part_solid(design, part)
    return step_bytes(solid, f"{part} of {preset}")


def mesh_volume_mm3(preset: str, *parts: str) -> float:
    mesh = skeleton_mesh(preset_design(preset), 1.0)
    return sum(hexahedra_volume_mm3(mesh.nodes_mm, mesh.hexahedra[part]).sum() for part in parts)


def mould_volume_mm3(preset: str) -> float:
    """Return the volume of block less cavity; the paper's lining of 0.1 mm moves flat and cylindrical faces outward."""
    pad = preset_design(preset).pad
    half, middle = pad.width_mm / 2.0, pad.length_mm / 2.0
    crown = pad.thickness_mm + (0.0 if pad.shape == "ellipsoidal" else 0.1)

    def height(z: float, x: float) -> float:
        if pad.radius_mm is not None:
            radius = pad.radius_mm + 0.1
            return float(crown - radius + np.sqrt(radius**2 - x**2))
        if pad.semi_axes_mm is not None:
            a, b, c = pad.semi_axes_mm
            return float(crown - b + b * np.sqrt(1.0 - (x / a) ** 2 - (z / c) ** 2))
        return crown

    cavity, _ = dblquad(height, -half, half, -middle, middle, epsabs=1e-9, epsrel=1e-12)
    block = (pad.width_mm + 2 * WALL_MM) * (pad.length_mm + 2 * WALL_MM) * (crown + FLOOR_MM)
    return float(block - cavity)


@pytest.mark.parametrize("part", ["skeleton", "base_plate", "backing", "skeleton_and_base", "mould"])
def test_a_step_file_is_whole_and_every_edge_joins_two_faces(part):
    file = StepFile(step_of("flat-70x35", part))
    assert "AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }" in file.header
    assert file.references() <= set(file.entities)
    (brep,) = file.all("MANIFOLD_SOLID_BREP")
    assert brep.values[0] == f"'{part} of flat-70x35'"
    runs = sorted(run for _, _, loops in file.faces() for _, loop in loops for run in loop)
    edges = [number for number, e in file.entities.items() if getattr(e, "kind", "") == "EDGE_CURVE"]
    assert runs == [(edge, forward) for edge in sorted(edges) for forward in (False, True)]


@pytest.mark.parametrize("preset", ["flat-70x35", "baby-48x18", "wide-50x60"])
@pytest.mark.parametrize(
    ("part", "blocks"),
    [("skeleton", ["skeleton"]), ("skeleton_and_base", ["skeleton", "base_plate"]), ("backing", ["backing"])],
)
def test_flat_faces_close_the_volume_of_the_simulated_mesh(preset, part, blocks):
    file, volume = StepFile(step_of(preset, part)), 0.0
    for surface, outward, loops in file.faces():
        assert surface.kind == "PLANE"
        assert outward
        place, normal, _ = file.placement(surface.values[1])
        assert [kind for kind, _ in loops] == ["FACE_OUTER_BOUND"] + ["FACE_BOUND"] * (len(loops) - 1)
        for kind, loop in loops:
            corners = file.polygon(loop)
            np.testing.assert_allclose((corners - place) @ normal, 0.0, atol=1e-9)
            around = np.cross(corners, np.roll(corners, -1, axis=0)).sum(axis=0) @ normal / 2.0
            # counter-clockwise outside, clockwise around holes
            assert (around > 0.0) == (kind == "FACE_OUTER_BOUND")
            volume += around * (place @ normal) / 3.0
    assert volume == pytest.approx(mesh_volume_mm3(preset, *blocks), rel=ROUNDING)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_ready_made_finger_is_one_body_with_a_hole_between_neighbouring_ribs(preset):
    design = preset_design(preset)
    solid = part_solid(design, "skeleton_and_base")
    holes = sum(len(face.loops) - 1 for face in solid.faces)
    euler = len(solid.corners_mm) - len(solid.edges) + len(solid.faces) - holes
    ribs = design.skeleton.rib_count
    # the window in front, and at each side the gaps between base, ribs and tip, all into one hollow
    assert euler == 2 - 2 * (2 * (ribs + 1))
    assert len(mould_solid(design, mould_sizes(design)).faces) == 11


@pytest.mark.parametrize("preset", CURVED)
def test_the_bottom_of_a_curved_mould_is_the_designed_face_itself(preset):
    pad, file = preset_design(preset).pad, StepFile(step_of(preset, "mould"))
    middle = pad.length_mm / 2.0
    if pad.radius_mm is not None:
        (cylinder,) = file.all("CYLINDRICAL_SURFACE")
        place, axis, _ = file.placement(cylinder.values[1])
        np.testing.assert_allclose([*place[:2], *axis], [0.0, pad.thickness_mm - pad.radius_mm, 0.0, 0.0, 1.0])
        assert cylinder.values[2] == pytest.approx(pad.radius_mm + 0.1, rel=ROUNDING)
        assert len(file.all("CIRCLE")) == 2
        return
    assert pad.semi_axes_mm is not None
    semi_axes = np.array(pad.semi_axes_mm)
    centre = np.array([0.0, pad.thickness_mm - semi_axes[1], middle])
    (patch,) = [e for e in file.entities.values() if isinstance(e, dict) and "RATIONAL_B_SPLINE_SURFACE" in e]
    degree_u, degree_v, references, *_ = patch["B_SPLINE_SURFACE"]
    assert (degree_u, degree_v) == (2.0, 2.0)
    poles = np.array([[file.point(r) for r in row] for row in references])
    weights = np.array(patch["RATIONAL_B_SPLINE_SURFACE"][0])
    assert weights.min() > 0.0
    t = np.linspace(0.0, 1.0, 21)
    bernstein = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2], axis=1)
    weight = np.einsum("ui,vj,ij->uv", bernstein, bernstein, weights)
    points = np.einsum("ui,vj,ijx->uvx", bernstein, bernstein, poles * weights[..., None]) / weight[..., None]
    np.testing.assert_allclose((((points - centre) / semi_axes) ** 2).sum(axis=-1), 1.0, rtol=ROUNDING)
    # seen from outside the mould's solid, that is from inside the ellipsoid, u x v comes towards the viewer
    du, dv = points[11, 10] - points[10, 10], points[10, 11] - points[10, 10]
    assert np.cross(du, dv)[1] < 0.0
    # the patch reaches beyond the corners of the pad
    assert points[0, 0, 0] < -pad.width_mm / 2.0
    assert points[0, 0, 2] < 0.0
    assert len(file.all("ELLIPSE")) == 4


def test_the_patch_of_a_pad_that_reaches_the_equator_keeps_positive_weights():
    # its corners lie 0.6 deg above the equator, where a weight of the patch's middle becomes 0
    design = FingerDesign.model_validate({"pad": {"shape": "ellipsoidal", "semi_axes_mm": (24.75, 5.0, 49.5)}})
    file = StepFile(step_bytes(mould_solid(design, mould_sizes(design)), "mould"))
    (patch,) = [e for e in file.entities.values() if isinstance(e, dict) and "RATIONAL_B_SPLINE_SURFACE" in e]
    weights = np.array(patch["RATIONAL_B_SPLINE_SURFACE"][0])
    assert 0.0 < weights.min() < 0.02
    corner = file.point(patch["B_SPLINE_SURFACE"][2][0][0])
    assert corner[0] < -design.pad.width_mm / 2.0
    assert corner[2] < 0.0


@pytest.mark.parametrize("preset", CURVED)
def test_edges_of_a_curved_mould_run_along_their_arcs(preset):
    file = StepFile(step_of(preset, "mould"))
    curved = [edge for edge in file.all("EDGE_CURVE") if file.at(edge.values[3]).kind in ("CIRCLE", "ELLIPSE")]
    assert curved
    for edge in curved:
        _, start, end, curve, sense = edge.values
        assert sense == ".T."
        place, axis, across = file.placement(file.at(curve).values[1])
        radii = file.at(curve).values[2:]
        first, second = radii[0], radii[-1]
        assert first >= second
        angles = []
        for corner in (file.point(start), file.point(end)):
            u, v = (corner - place) @ across / first, (corner - place) @ np.cross(axis, across) / second
            assert u**2 + v**2 == pytest.approx(1.0, rel=ROUNDING)
            assert (corner - place) @ axis == pytest.approx(0.0, abs=1e-9)
            angles.append(np.arctan2(v, u))
        # with growing angle the arc passes over the top of the ellipse (the largest y), and is less than half of it
        swept = (angles[1] - angles[0]) % (2.0 * np.pi)
        assert 0.0 < swept < np.pi
        middle = angles[0] + swept / 2.0
        top = place + first * np.cos(middle) * across + second * np.sin(middle) * np.cross(axis, across)
        assert top[1] > max(file.point(start)[1], file.point(end)[1])


@pytest.mark.parametrize("preset", ["flat-70x35", *CURVED])
def test_triangles_of_a_mould_hold_the_same_volume(preset):
    (mould,) = [part for part in printable_parts(preset_design(preset), ("stl",)) if part.name == "mould"]
    corners = np.frombuffer(mould.files["stl"][84:], dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])["v"]
    a, b, c = corners.astype(np.float64).transpose(1, 0, 2)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
    # chords of 0.5 mm lie 0.8 um within a radius of 40 mm, over 2450 mm^2: 2 mm^3 of 16 000
    assert volume == pytest.approx(mould_volume_mm3(preset), rel=2e-4)
    assert ("lay a smooth sheet of 0.1 mm" in mould.note) == (not preset.startswith("ellipsoidal"))


@pytest.mark.rigs
def test_another_program_reads_the_same_volumes(tmp_path):
    """Gmsh reads STEP through Open CASCADE; it is a GPL program and runs as a process of its own."""
    wanted = {"skeleton": mesh_volume_mm3("flat-70x35", "skeleton")}
    wanted["skeleton_and_base"] = wanted["skeleton"] + mesh_volume_mm3("flat-70x35", "base_plate")
    (tmp_path / "skeleton.step").write_bytes(step_of("flat-70x35", "skeleton"))
    (tmp_path / "skeleton_and_base.step").write_bytes(step_of("flat-70x35", "skeleton_and_base"))
    for preset in ["flat-70x35", *CURVED]:
        wanted[preset] = mould_volume_mm3(preset)
        (tmp_path / f"{preset}.step").write_bytes(step_of(preset, "mould"))
    script = """
import json, pathlib, sys, gmsh
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
found = {}
for path in sorted(pathlib.Path(sys.argv[1]).glob("*.step")):
    gmsh.clear()
    shapes = gmsh.model.occ.importShapes(str(path))
    found[path.stem] = [(dimension, gmsh.model.occ.getMass(dimension, tag)) for dimension, tag in shapes]
print(json.dumps(found))
"""
    command = [others_python("gmsh"), "-c", script, str(tmp_path)]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True, timeout=600).stdout)
    for name, volume in wanted.items():
        ((dimension, mass),) = found[name]
        assert dimension == 3
        # what Open CASCADE's own integration over rational patches leaves
        assert mass == pytest.approx(volume, rel=1e-7 if name.startswith("ell") else 1e-9), name


def test_flat_neighbours_become_one_face():
    # a square frame of 8 cubes of 3 x 3: a body with one handle
    points = np.stack(np.meshgrid(*[np.arange(4.0)] * 2, np.arange(2.0), indexing="ij"), -1).reshape(-1, 3)
    number = np.arange(32).reshape(4, 4, 2)
    around = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = [(i, j) for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    cubes = np.array([[number[i + a, j + b, c] for a, b, c in around] for i, j in cells])
    frame = planar_solid(points, boundary_quads(cubes).quads)
    assert (len(frame.corners_mm), len(frame.edges), len(frame.faces)) == (16, 24, 10)
    assert sorted(len(face.loops) for face in frame.faces) == [1] * 8 + [2] * 2
    cube = planar_solid(points, boundary_quads(cubes[:1]).quads)
    assert (len(cube.corners_mm), len(cube.edges), len(cube.faces)) == (8, 12, 6)


def test_surfaces_that_bound_no_solid_are_refused():
    corners = np.array([(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], dtype=np.float64)
    quads = boundary_quads(np.arange(8)[None]).quads
    with pytest.raises(SimulateError, match="the surface is open or pinched to an edge"):
        planar_solid(corners, quads[:-1])
    # a second cube that shares one upright edge only
    beyond = np.concatenate([corners, corners + np.array([1.0, 1.0, 0.0])])
    second = np.array([2, 9, 10, 11, 6, 13, 14, 15])
    with pytest.raises(SimulateError, match="pinched to an edge, but two faces must meet at every edge"):
        planar_solid(beyond, np.concatenate([quads, boundary_quads(second[None]).quads]))
    corners[6] += [0.0, 0.0, 0.1]
    with pytest.raises(SimulateError, match=r"warped by 0\.0\d+ mm"):
        planar_solid(corners, quads)
    plane = Plane(corners[0], np.array([0.0, 0.0, 1.0]))
    with pytest.raises(SimulateError, match="the solid is not closed; two faces must meet at every edge"):
        Solid(corners[:2], (Edge(0, 1),), (Face(plane, (((0, True),),)),))


def test_names_are_written_as_the_standard_says():
    solid = part_solid(preset_design("baby-48x18"), "base_plate")
    text = step_bytes(solid, "J\u00fcrgen's \\ 100 %\n\U0001f600").decode("ascii")
    assert "MANIFOLD_SOLID_BREP('J\\X2\\00FC\\X0\\rgen''s \\\\ 100 %\\X2\\000A\\X0\\\\X4\\0001F600\\X0\\'," in text
    assert step_bytes(solid, "a") == step_bytes(solid, "a")


def test_the_verb_writes_all_parts_once(tmp_path):
    succeed(f"design init flat-70x35 --out {tmp_path}/finger.toml")
    told = succeed(f"design export {tmp_path}/finger.toml --out {tmp_path}/print")
    parts = ("backing", "base_plate", "mould", "skeleton")
    assert sorted(p.name for p in (tmp_path / "print").iterdir()) == [
        f"{p}.{s}" for p in parts for s in ("step", "stl")
    ]
    assert "skeleton.stl and skeleton.step: 44.0 x 24.5 x 84.8 mm (x, y, z)" in told
    assert "lay a smooth sheet of 0.1 mm on the floor inside" in told
    assert (tmp_path / "print" / "skeleton.stl").read_bytes() == part_stl(preset_design("flat-70x35"))
    assert (tmp_path / "print" / "skeleton.step").read_bytes() == step_of("flat-70x35", "skeleton")
    again = finray(f"design export {tmp_path}/finger.toml --out {tmp_path}/print")
    assert again.status == 2
    assert "print: exists already and is not overwritten; choose another --out" in again.err
    told = succeed(f"design export {tmp_path}/finger.toml --out {tmp_path}/one --format step --one-piece --lining-mm 0")
    assert sorted(p.name for p in (tmp_path / "one").iterdir()) == [
        "backing.step",
        "mould.step",
        "skeleton_and_base.step",
    ]
    assert "lay a smooth sheet" not in told


FLAT = 'preset = "flat-70x35"\n'


def test_what_cannot_be_printed_or_written_is_told_before_anything_is_written(tmp_path, monkeypatch):
    design = tmp_path / "finger.toml"
    for text, arguments, message in (
        (FLAT + "[skeleton]\nrib_count = 40\nrib_thickness_mm = 1.8\n", "", r"finger.toml: .*overlap or nearly touch"),
        (FLAT, "--lining-mm -1", "lining_mm of a mould .* must be from 0 to 1 mm, got -1 mm"),
        (FLAT, "--lining-mm nan", "lining_mm of a mould .* must be from 0 to 1 mm, got nan mm"),
        (
            'preset = "ellipsoidal-30-8-90"\n',
            "--lining-mm 0.1",
            r"lining_mm = 0.1 mm is not supported, because a sheet cannot be bent to pad.shape = ellipsoidal",
        ),
    ):
        design.write_text(text)
        with pytest.raises(AssertionError, match=message):
            succeed(f"design export {design} --out {tmp_path}/print {arguments}")
        assert not (tmp_path / "print").exists()
    design.write_text(FLAT)
    monkeypatch.setattr(options.os, "access", lambda path, mode: False)
    outcome = finray(f"design export {design} --out {tmp_path}/print")
    assert outcome.status == 2
    assert "is not writable; choose another --out, or change the permissions" in outcome.err


def test_walls_carry_the_flange_of_the_film():
    design = FingerDesign.model_validate({"skeleton": {"flange_mm": 3.5}})
    assert mould_sizes(design).wall_mm == pytest.approx(5.5)
    assert mould_sizes(FingerDesign()).wall_mm == pytest.approx(WALL_MM)
