"""Indenters of a design: facets, poses, exact first touch, files of the user, and what the analytic press refuses."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_schemas import FieldError, FingerDesign, GelPad, Indenter, SimulateError
from sim import preset_design
from sim.mechanics import (
    Cylinder,
    IndenterPath,
    PressSettings,
    RoundedBox,
    Sphere,
    body_mesh,
    press_along,
    rigid_indenter,
    side_outline_mm,
)
from sim.mechanics import _press as press_module
from sim.mechanics._colliding_surfaces import edge_edge_mm, point_triangle_mm
from sim.mechanics._indenters import least_over_triangles, over_rectangle
from sim.mechanics._press import _first_on_coarse
from sim.mechanics._rigid_bodies import FacetedBody, TriangleMesh, check_closed_body, read_body, rotation_matrix
from sim.surface_meshes import pressed_height_mm, rest_height_mm, stl_bytes, unpressed_design

CUBE = TriangleMesh(
    np.array([[x, y, z] for x in (-3.0, 3.0) for y in (0.0, 4.0) for z in (-2.0, 2.0)]),
    np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]
    ),
)  # fmt: skip
DOME = GelPad(shape="ellipsoidal", semi_axes_mm=(50.0, 20.0, 90.0))


def volume_mm3(mesh):
    corners = mesh.vertices_mm[mesh.triangles]
    return np.einsum("ki,ki->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0


@pytest.mark.parametrize(
    ("body", "volume"),
    [
        (Sphere(4.0), 4.0 / 3.0 * np.pi * 64.0),
        (Cylinder(5.0), np.pi * 25.0 * 20.0),
        # Steiner: core + faces r + edges pi r^2 / 4 each + ball
        (
            RoundedBox((4.0, 3.0, 5.0), 1.0),
            6 * 4 * 8 + 2 * (6 * 4 + 4 * 8 + 6 * 8) + np.pi * (6 + 4 + 8) + 4 / 3 * np.pi,
        ),
    ],
    ids=["sphere", "cylinder", "cuboid"],
)
def test_facets_close_and_lie_a_chord_inside(body, volume):
    chord_mm = 0.004
    mesh = body_mesh(body, chord_mm, 10.0)
    check_closed_body(mesh, "body")
    # what is missing lies in a shell of at most the chord
    assert 0.0 < volume - volume_mm3(mesh) < volume * 3.0 * chord_mm / 3.0
    corners = mesh.vertices_mm[mesh.triangles]
    on_side = np.abs(corners[:, :, 0]).max(axis=1) < 9.99 if isinstance(body, Cylinder) else slice(None)
    depth = body.distances(corners[on_side].mean(axis=1))[0]
    assert -chord_mm <= depth.min()
    assert depth.max() <= 1e-12


def test_rotation_about_x_then_y_then_z():
    angles = (20.0, -35.0, 50.0)
    np.testing.assert_allclose(rotation_matrix(*angles), Rotation.from_euler("xyz", angles, degrees=True).as_matrix())


@pytest.mark.parametrize("pad", [GelPad(), DOME], ids=["flat", "dome"])
@pytest.mark.parametrize(
    "wanted",
    [
        {"shape": "ball", "radius_mm": 8.0, "position_mm": 12.0, "across_mm": 6.0},
        {"shape": "cylinder", "rotation_deg": (0.0, 35.0, 4.0), "across_mm": -3.0},
        {"shape": "cuboid", "size_mm": (16.0, 10.0, 12.0), "rotation_deg": (10.0, 20.0, 5.0), "position_mm": 60.0},
    ],
    ids=["ball", "cylinder", "cuboid"],
)
def test_first_touch_is_exact(pad, wanted):
    design = FingerDesign(pad=pad, indenter=Indenter(**wanted))
    indenter = rigid_indenter(design)
    x, z = np.linspace(-17.5, 17.5, 701), np.linspace(0.0, 70.0, 1401)
    xx, zz = np.meshgrid(x, z, indexing="ij")
    coat = np.column_stack([xx.ravel(), rest_height_mm(design, xx, zz).ravel(), zz.ravel()])
    distance = indenter.touching.distances(indenter.body, coat)[0]
    # the nearest of these points lies within 0.035 mm of the one that touches: h^2 / 2R
    assert -1e-8 < distance.min() < 2e-4


def test_a_ball_on_a_slope_touches_before_its_lowest_point_does():
    design = FingerDesign(pad=DOME, indenter=Indenter(shape="ball", position_mm=10.0))
    y = rigid_indenter(design).touching.position_mm[1]
    assert y > float(rest_height_mm(design, 0.0, 10.0)) + 10.0 + 0.015


def test_an_upright_cylinder_never_touches():
    design = FingerDesign(indenter=Indenter(rotation_deg=(0.0, 0.0, 90.0)))
    with pytest.raises(SimulateError, match="must not stand upright"):
        rigid_indenter(design)


def test_a_closed_file_is_an_indenter(tmp_path):
    (tmp_path / "cube.stl").write_bytes(stl_bytes(CUBE.triangles, CUBE.vertices_mm, "cube"))
    design = FingerDesign(indenter=Indenter(shape="mesh", file="cube.stl", across_mm=2.0, rotation_deg=(0, 0, 0)))
    indenter = rigid_indenter(design, tmp_path)
    assert indenter.body is None
    # the cube stands on the pad
    assert volume_mm3(indenter.surface) == pytest.approx(96.0)
    assert indenter.vertices_mm()[:, 1].min() == pytest.approx(6.0)
    assert indenter.vertices_mm()[:, 0].max() == pytest.approx(5.0)
    assert isinstance(indenter.exact_body(), FacetedBody)
    assert side_outline_mm(design) is None


def test_a_text_file_is_read_too(tmp_path):
    lines = ["solid cube"]
    for triangle in CUBE.vertices_mm[CUBE.triangles]:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x} {y} {z}" for x, y, z in triangle)]
        lines += ["endloop", "endfacet"]
    (tmp_path / "cube.stl").write_text("\n".join([*lines, "endsolid cube"]))
    assert volume_mm3(read_body(tmp_path / "cube.stl")) == pytest.approx(96.0)


def test_corners_on_both_sides_of_a_rounding_boundary_are_one(tmp_path):
    """Corners 1e-7 of the size apart, in any direction, are welded wherever they lie; an export repeats each corner."""
    rng = np.random.default_rng(1)
    size_mm = np.ptp(CUBE.vertices_mm, axis=0).max()
    for _ in range(20):
        corners = CUBE.vertices_mm[CUBE.triangles].reshape(-1, 3) + rng.uniform(0.0, 1e-6, 3) * size_mm
        corners += rng.uniform(-0.5e-7, 0.5e-7, corners.shape) * size_mm
        lines = ["solid cube", *(f"vertex {x:.12f} {y:.12f} {z:.12f}" for x, y, z in corners), "endsolid cube"]
        (tmp_path / "cube.stl").write_text("\n".join(lines))
        assert len(read_body(tmp_path / "cube.stl").vertices_mm) == len(CUBE.vertices_mm)


@pytest.mark.parametrize(
    ("triangles", "scale", "message"),
    [
        (CUBE.triangles[1:], 1.0, "the body is not closed, because 3 edges belong to only one triangle"),
        (
            np.vstack([CUBE.triangles[1:], CUBE.triangles[:1, ::-1]]),
            1.0,
            "3 edges have two triangles of opposite orientation",
        ),
        (CUBE.triangles, 1e-3, "seems to be in metres"),
        (CUBE.triangles, 1 / 25.4, "seems to be in inches or metres"),
        (CUBE.triangles, 1e3, "seems to be in micrometres"),
        (CUBE.triangles[:0], 1.0, "contains no triangles"),
        (np.vstack([CUBE.triangles[:1], CUBE.triangles[:1, ::-1]]), 1.0, "enclose no volume"),
        (CUBE.triangles, np.nan, "vertices with coordinates that are not finite"),
        (
            CUBE.triangles[:, ::-1],
            1.0,
            "the body is inside out, because its triangles face inward .enclosed volume -96 mm3.",
        ),
        (CUBE.triangles[:, [0, 0, 0]], 1.0, "none of the triangles has an area"),
    ],
    ids=[
        "open",
        "twisted",
        "metres",
        "inches",
        "micrometres",
        "empty",
        "flat",
        "not a number",
        "inside out",
        "needles",
    ],
)
def test_unusable_files_are_refused(tmp_path, triangles, scale, message):
    (tmp_path / "body.stl").write_bytes(stl_bytes(triangles, scale * CUBE.vertices_mm, "body"))
    with pytest.raises(SimulateError, match=message):
        read_body(tmp_path / "body.stl")


def test_files_that_are_no_stl_or_missing_are_refused(tmp_path):
    (tmp_path / "body.stl").write_text("not a mesh")
    with pytest.raises(SimulateError, match="neither a binary nor a text STL"):
        read_body(tmp_path / "body.stl")
    with pytest.raises(SimulateError, match="no such file; give the path of the indenter's STL file"):
        read_body(tmp_path / "absent.stl")


def test_a_file_beside_the_pad_is_refused(tmp_path):
    away = CUBE.vertices_mm + np.array([60.0, 0.0, 0.0])
    (tmp_path / "cube.stl").write_bytes(stl_bytes(CUBE.triangles, away, "cube"))
    design = FingerDesign(indenter=Indenter(shape="mesh", file="cube.stl"))
    with pytest.raises(SimulateError, match="does not touch the pad when it moves"):
        rigid_indenter(design, tmp_path)


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"shape": "cuboid"}, "size_mm is missing"),
        ({"shape": "mesh"}, "file is missing"),
        ({"shape": "ball", "file": "a.stl"}, "file is supported only for shape = .mesh."),
        ({"shape": "cuboid", "size_mm": (9.0, 1.0, 9.0)}, "edge_radius_mm = 1 mm must be at most half"),
        ({"friction": -0.1}, "must be at least 0"),
    ],
)
def test_incomplete_indenters_are_refused(wanted, message):
    with pytest.raises(FieldError, match=message):
        Indenter(**wanted)


def test_an_indenter_beside_the_pad_is_refused():
    with pytest.raises(FieldError, match=r"across_mm = 18 mm must lie on the pad"):
        FingerDesign(indenter=Indenter(across_mm=18.0))


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"depth_mm": 6.5}, "indenter.depth_mm = 6.5 mm goes through the pad"),
        ({"shape": "cuboid", "size_mm": (9.0, 9.0, 9.0)}, 'shape = "cuboid" is not supported by the analytic press'),
        ({"across_mm": 2.0}, "across_mm = 2 mm is not supported by the analytic press"),
        (
            {"rotation_deg": (0.0, 10.0, 0.0)},
            r"rotation_deg = \[0.0, 10.0, 0.0\] deg is not supported by the analytic press",
        ),
    ],
)
def test_the_analytic_press_refuses_what_it_cannot_shape(wanted, message):
    design = FingerDesign(indenter=Indenter(**wanted))
    x, z = np.zeros(1), np.linspace(0.0, 70.0, 5)
    with pytest.raises(SimulateError, match=message + r".*simulate press DESIGN"):
        pressed_height_mm(design, x, z)
    # at rest there is nothing to refuse
    np.testing.assert_array_equal(pressed_height_mm(unpressed_design(design), x, z), 6.0)


def test_the_outline_of_a_cuboid_is_its_own():
    design = FingerDesign(indenter=Indenter(shape="cuboid", size_mm=(16.0, 10.0, 12.0)))
    outline = side_outline_mm(design, 1.0)
    np.testing.assert_allclose(outline.min(axis=0), [29.0, 5.0])
    np.testing.assert_allclose(outline.max(axis=0), [41.0, 15.0])


def test_distances_of_vertices_and_edges():
    rng = np.random.default_rng(0)
    corners = rng.standard_normal((60, 4, 3))
    share = np.linspace(0.0, 1.0, 201)
    a, b, c, d = np.moveaxis(corners, 1, 0)
    one = a[:, None] + share[:, None] * (b - a)[:, None]
    two = c[:, None] + share[:, None] * (d - c)[:, None]
    sampled = np.linalg.norm(one[:, :, None] - two[:, None], axis=-1).min(axis=(1, 2))
    # half a step of the samples at an edge of up to 5 mm
    np.testing.assert_allclose(edge_edge_mm(corners), sampled, atol=0.03)
    assert (edge_edge_mm(corners) <= sampled + 1e-12).all()
    s, t = (m.ravel() for m in np.meshgrid(share[::2], share[::2]))
    inside = s + t <= 1.0
    plane = b[:, None] + s[inside, None] * (c - b)[:, None] + t[inside, None] * (d - b)[:, None]
    sampled = np.linalg.norm(plane - a[:, None], axis=-1).min(axis=1)
    np.testing.assert_allclose(point_triangle_mm(corners), sampled, atol=0.06)
    assert (point_triangle_mm(corners) <= sampled + 1e-12).all()


LARGE_MM = (90.0, 12.0, 150.0)
ROUND = GelPad(shape="cylindrical", radius_mm=60.0)


@pytest.mark.parametrize("pad", [GelPad(), DOME, ROUND], ids=["flat", "dome", "cylindrical"])
@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 30.0, -7.0), (11.0, -50.0, 6.0)])
def test_a_large_tilted_stl_touches_where_the_same_cuboid_does(tmp_path, pad, rotation):
    # triangles longer than the pad: the place of first touch is none of their corners
    place = {"across_mm": 6.0, "position_mm": 21.0, "rotation_deg": rotation}
    exact = FingerDesign(pad=pad, indenter=Indenter(shape="cuboid", size_mm=LARGE_MM, edge_radius_mm=0.01, **place))
    body = TriangleMesh(CUBE.vertices_mm * [15.0, 3.0, 37.5] - [0.0, 6.0, 0.0], CUBE.triangles)
    assert np.ptp(body.vertices_mm, axis=0) == pytest.approx(LARGE_MM)
    (tmp_path / "cuboid.stl").write_bytes(stl_bytes(body.triangles, body.vertices_mm, "cuboid"))
    design = FingerDesign(pad=pad, indenter=Indenter(shape="mesh", file="cuboid.stl", **place))
    touching = rigid_indenter(design, tmp_path).touching
    # the file holds single precision; faces that touch are the same, edges that do are rounded by 0.01 mm
    assert touching.position_mm == pytest.approx(rigid_indenter(exact).touching.position_mm, abs=1e-4)


def test_the_first_press_on_the_coarse_mesh_finds_the_file_beside_the_design(tmp_path, monkeypatch):
    """Without its folder the coarse press failed unnoticed, and the finer one began without its help."""
    (tmp_path / "cube.stl").write_bytes(stl_bytes(CUBE.triangles, CUBE.vertices_mm, "cube"))
    design = FingerDesign(indenter=Indenter(shape="mesh", file="cube.stl", depth_mm=1.0))
    pressed_as = lambda coarse, *_, folder=Path(), **__: rigid_indenter(coarse, folder)  # noqa: E731
    monkeypatch.setattr(press_module, "press_finger", pressed_as)
    coarse = _first_on_coarse(design, PressSettings("medium", 2), tmp_path, press_module.Watch(None, 2))
    assert coarse.touching.position_mm == rigid_indenter(design, tmp_path).touching.position_mm


def plan_area_mm2(triangles):
    one, two = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.abs(one[:, 0] * two[:, 2] - one[:, 2] * two[:, 0]).sum() / 2.0


@pytest.mark.parametrize(
    ("corners", "area_mm2", "count"),
    [
        ([(1.0, 0.0, 1.0), (2.0, 1.0, 1.0), (1.0, 2.0, 2.0)], 0.5, 1),
        # all of the rectangle of 4 by 3 mm, and a corner of it cut off: polygons of 4 and of 5 corners
        ([(-50.0, 0.0, -50.0), (90.0, 1.0, -50.0), (-50.0, 2.0, 90.0)], 12.0, 2),
        ([(-50.0, 0.0, -43.0), (50.0, 1.0, -43.0), (-50.0, 2.0, 57.0)], 12.0, 2),
        ([(-20.0, 0.0, -20.0), (26.0, 1.0, -20.0), (-20.0, 2.0, 26.0)], 11.5, 3),
    ],
    ids=["inside", "around", "by its corner", "cut off"],
)
def test_parts_over_a_rectangle_do_not_overlap(corners, area_mm2, count):
    parts = over_rectangle(np.array([corners]), (0.0, 4.0), (0.0, 3.0))
    # the clipping leaves points twice where an edge runs through a corner: triangles of no area
    assert (np.abs(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0])).max(axis=1) > 1e-9).sum() == count
    assert plan_area_mm2(parts) == pytest.approx(area_mm2, rel=1e-12)


@pytest.mark.parametrize(
    ("corners", "least_mm"),
    [
        ([(4.0, 0.5, 3.0), (9.0, -1.0, 3.0), (4.0, -1.0, 9.0)], 0.5),
        ([(0.0, 0.5, 1.0), (0.0, 0.7, 2.0), (-5.0, -1.0, 1.0)], 0.5),
        ([(1.0, 0.5, -2.0), (1.0, 0.5, 9.0), (1.0, 7.0, 2.0)], 0.5),
    ],
    ids=["a point", "an edge", "upright"],
)
def test_parts_without_area_keep_their_height(corners, least_mm):
    parts = over_rectangle(np.array([corners]), (0.0, 4.0), (0.0, 3.0))
    assert parts[..., 1].min() == pytest.approx(least_mm)
    assert least_over_triangles(parts, lambda points: points[:, 1], 0.0) == pytest.approx(least_mm)


def lining(step_mm, radius_mm, half_mm, length_mm):
    """A body 5 mm high whose lower face runs along a cylinder about z, corners on it; facets of a step."""
    x, z = np.arange(-half_mm, half_mm + 1e-9, step_mm), np.arange(-length_mm, length_mm + 1e-9, step_mm)
    xx, zz = np.meshgrid(x, z, indexing="ij")
    low = np.stack([xx, np.sqrt(radius_mm**2 - xx**2) - radius_mm, zz], -1).reshape(-1, 3)
    high = np.stack([xx, np.full_like(xx, 5.0), zz], -1).reshape(-1, 3)
    number = np.arange(xx.size).reshape(xx.shape)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    down = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    after, up = np.roll(rim, -1), len(low)
    sides = np.concatenate([np.stack([after, rim, rim + up], 1), np.stack([after, rim + up, after + up], 1)])
    return TriangleMesh(np.concatenate([low, high]), np.concatenate([down, down[:, ::-1] + up, sides])), x


def test_a_file_that_runs_along_a_curved_pad_is_not_divided_without_end(tmp_path, monkeypatch):
    body, x = lining(0.25, ROUND.radius_mm, 18.0, 36.0)
    (tmp_path / "lining.stl").write_bytes(stl_bytes(body.triangles, body.vertices_mm, "lining"))
    design = FingerDesign(pad=ROUND, indenter=Indenter(shape="mesh", file="lining.stl"))
    asked = []

    def height_mm(design, x, z):
        asked.append(len(x))
        return rest_height_mm(design, x, z)

    monkeypatch.setattr("sim.mechanics._indenters.rest_height_mm", height_mm)
    y = rigid_indenter(design, tmp_path).touching.position_mm[1]
    # three corners of each of four parts of 250 000 triangles
    assert max(asked) <= 3_000_000
    # where a facet lies lowest over the arc between its ends, whatever z
    fine = np.linspace(-17.5, 17.5, 700_001)
    chords = np.interp(fine, x, np.sqrt(ROUND.radius_mm**2 - x**2) - ROUND.radius_mm)
    least = (chords - rest_height_mm(design, fine, np.full_like(fine, 35.0))).min()
    # to a sixth of the curvature, 0.02 per mm, times the square of a facet's half diagonal, 0.18 mm
    assert y == pytest.approx(-least, abs=1.1e-4)


def test_a_file_that_runs_along_a_pad_of_too_much_curvature_is_refused():
    along = np.tile(np.eye(3), (250_001, 1, 1))
    with pytest.raises(SimulateError, match=r"in 250001 places, so its first touch is known only to 0\.33 mm"):
        least_over_triangles(along, lambda points: np.zeros(len(points)), 1.0)


@pytest.mark.parametrize("body", [Sphere(8.0), RoundedBox((3.0, 4.0, 5.0), 1.0)])
def test_the_distance_from_facets_is_that_of_the_body_that_they_stand_for(body):
    faceted = FacetedBody(body_mesh(body, 0.004, 0.0))
    rng = np.random.default_rng(4)
    places = rng.uniform(-1.1, 1.1, (600, 3)) * faceted.surface.vertices_mm.max(axis=0)
    exact, normals, _ = body.distances(places)
    near = np.abs(exact) < 1.5
    assert near.sum() > 100
    distance, normal, _ = faceted.distances(places)
    # facets lie up to the chord of 0.004 mm inside
    np.testing.assert_allclose(distance[near], exact[near], atol=0.005)
    outside = near & (exact > 0.2)
    # and are turned by up to chord / radius to the power of a half
    assert np.einsum("ki,ki->k", normal[outside], normals[outside]).min() > 0.995
    step = 1e-6 * rng.standard_normal(places.shape)
    slope = faceted.distances(places + step)[0] - faceted.distances(places - step)[0]
    np.testing.assert_allclose(slope[outside], 2.0 * (normal * step).sum(axis=1)[outside], atol=1e-9)


def test_sides_of_a_body_with_a_notch_are_told_apart():
    # an L of unit cubes: edges that bulge and one that does not
    square = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], dtype=float)
    vertices = np.concatenate([np.column_stack([square, np.full(6, z)]) for z in (0.0, 1.0)])
    caps = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    walls = [[k, (k + 1) % 6, (k + 1) % 6 + 6] for k in range(6)] + [[k, (k + 1) % 6 + 6, k + 6] for k in range(6)]
    surface = TriangleMesh(vertices, np.concatenate([caps[:, ::-1], caps + 6, np.array(walls)]))
    check_closed_body(surface, "L")
    places = np.random.default_rng(5).uniform([-1, -1, -1], [3, 3, 2], (4000, 3))
    x, y, z = places.T
    inside = (x > 0) & (y > 0) & (z > 0) & (z < 1) & (((x < 2) & (y < 1)) | ((x < 1) & (y < 2)))
    assert (inside == (FacetedBody(surface).distances(places)[0] < 0.0)).all()


def test_an_stl_on_a_path_is_the_body_that_it_stands_for(tmp_path):
    """A long cuboid that stands askew, pressed, dragged and twisted: force and torque as by its exact distances."""
    block = body_mesh(RoundedBox((3.0, 3.0, 6.0), 1.8), 0.002, 0.0)
    (tmp_path / "block.stl").write_bytes(stl_bytes(block.triangles, block.vertices_mm, "block"))
    base = preset_design("baby-48x18")  # with faces of 2 mm, so that both touch at 3 x 3 points of each
    common = {"friction": 0.4, "rotation_deg": (0.0, 20.0, 0.0)}
    path = IndenterPath(np.array([[0, -0.6, 0], [0, -0.6, 0.4]]), np.array([[0, 0, 0], [0, 15.0, 0]]), np.array([1, 2]))
    found = []
    for shape in ({"shape": "cuboid", "size_mm": (6.0, 6.0, 12.0), "edge_radius_mm": 1.8},
                  {"shape": "mesh", "file": "block.stl"}):  # fmt: skip
        indenter = base.indenter.model_copy(update={**common, **shape})
        design = base.model_copy(update={"indenter": indenter})
        found.append(press_along(design, path, PressSettings("coarse"), folder=tmp_path))
    exact, faceted = found
    assert faceted.unreached == ""
    # the chord of 0.002 mm is 0.35 % of the push
    np.testing.assert_allclose(faceted.force_n, exact.force_n, atol=0.01 * np.abs(exact.force_n).max())
    largest = np.abs(exact.motion.torque_n_mm).max()
    np.testing.assert_allclose(faceted.motion.torque_n_mm, exact.motion.torque_n_mm, atol=0.02 * largest)
    assert np.abs(exact.motion.torque_n_mm[-1, 1]) > 0.1 * largest
