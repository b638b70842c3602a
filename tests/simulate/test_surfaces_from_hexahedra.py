"""Surfaces from hexahedra: against a slow twin, closed forms, and the surfaces of the undeformed finger."""

import functools
import time
from collections import Counter

import numpy as np
import pytest

from data_schemas import FingerDesign, SimulateError
from data_schemas._design_parts import TactileCamera
from sim import PRESETS, preset_design
from sim.mechanics import finger_mesh
from sim.mechanics._mesh import hexahedra_on_grid
from sim.optics import pixel_maps
from sim.optics._position_map import PositionMap
from sim.surface_meshes import (
    GEL_FACES,
    Surface,
    bent,
    boundary_quads,
    check_closed,
    check_no_intersections,
    coat_nodes,
    mirror_shape,
    rest_height_mm,
    rest_shape,
    shape_from_mesh,
    split_quads,
)
from sim.surface_meshes._hexahedra import DARK_BODIES
from tests.simulate.surface_quality import hexahedra_volume_mm3, smooth_normals, surface_quality

DESIGN = FingerDesign()
ROUNDING_MM = 1e-10


@functools.cache
def meshed(name="flat-70x35", preset="coarse"):
    return finger_mesh(preset_design(name), preset)


def brick(used, size_mm=(1.0, 1.0, 1.0)):
    """Return nodes and hexahedra of the used cells of a brick."""
    points = np.stack(np.meshgrid(*(np.arange(n + 1.0) for n in used.shape), indexing="ij"), axis=-1)
    grid = hexahedra_on_grid(points * np.array(size_mm), used)
    return grid.nodes_mm, grid.hexahedra


def slow_boundary(hexahedra):
    """Return the boundary quads, starting at their smallest node: one face after the other."""
    sides = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
    faces = [tuple(int(one[corner]) for corner in side) for one in hexahedra for side in sides]
    times = Counter(frozenset(face) for face in faces)
    return {rotated(face) for face in faces if times[frozenset(face)] == 1}


def rotated(quad):
    first = quad.index(min(quad))
    return tuple(quad[first:] + quad[:first])


@pytest.mark.parametrize("seed", range(5))
def test_boundary_equals_that_of_the_slow_twin(seed):
    rng = np.random.default_rng(seed)
    nodes, hexahedra = brick(rng.random((5, 6, 4)) < 0.6)
    shuffled = rng.permutation(len(nodes))[hexahedra]
    found = boundary_quads(rng.permutation(shuffled))
    assert {rotated(tuple(quad)) for quad in found.quads.tolist()} == slow_boundary(shuffled)
    assert len(found.quads) == len(slow_boundary(shuffled))


def test_each_quad_names_its_hexahedron():
    _, hexahedra = brick(np.ones((2, 3, 4), dtype=bool))
    found = boundary_quads(hexahedra)
    assert all(set(quad) <= set(hexahedra[owner]) for quad, owner in zip(found.quads, found.owner, strict=True))


def test_normals_point_outward_and_the_volume_is_that_of_the_brick():
    nodes, hexahedra = brick(np.ones((2, 3, 4), dtype=bool), (0.5, 2.0, 1.0))
    triangles = split_quads(boundary_quads(hexahedra).quads, nodes)
    corners = nodes[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normals, corners.mean(axis=1) - nodes.mean(axis=0)) > 0.0).all()
    found = surface_quality(triangles, nodes, hexahedra)
    assert (found.triangles, found.euler_number, found.is_closed, found.degenerate) == (104, 2, True, 0)
    assert found.volume_mm3 == pytest.approx(24.0, rel=1e-14)
    assert found.hexahedra_volume_mm3 == pytest.approx(24.0, rel=1e-14)


def test_a_ring_has_one_handle():
    used = np.ones((3, 3, 1), dtype=bool)
    used[1, 1, 0] = False
    nodes, hexahedra = brick(used)
    assert surface_quality(split_quads(boundary_quads(hexahedra).quads, nodes), nodes, hexahedra).euler_number == 0


def test_the_volume_of_a_frustum_is_exact():
    nodes, hexahedra = brick(np.ones((1, 1, 1), dtype=bool))
    scaled = nodes.copy()
    scaled[:, :2] = (nodes[:, :2] - 0.5) * np.where(nodes[:, 2:] > 0.5, 2.0, 3.0)
    expected = (9.0 + 4.0 + 6.0) / 3.0
    assert hexahedra_volume_mm3(scaled, hexahedra)[0] == pytest.approx(expected, rel=1e-14)


def test_warped_faces_make_the_two_volumes_differ():
    rng = np.random.default_rng(7)
    nodes, hexahedra = brick(np.ones((6, 6, 6), dtype=bool))
    nodes = nodes + rng.normal(0.0, 0.03, nodes.shape)
    found = surface_quality(split_quads(boundary_quads(hexahedra).quads, nodes), nodes, hexahedra)
    # each of 216 boundary quads is off by about its warp / 6 of 0.03 mm^3 at random, together 0.1 mm^3
    assert 0.0 < abs(found.volume_mm3 - found.hexahedra_volume_mm3) < 0.5


def test_quads_are_split_on_the_shorter_diagonal():
    nodes = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
    assert split_quads(np.array([[0, 1, 2, 3]]), nodes).tolist() == [[0, 1, 3], [1, 2, 3]]
    assert split_quads(np.array([[1, 2, 3, 0]]), nodes).tolist() == [[1, 2, 3], [1, 3, 0]]
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    square[2] -= 1e-13  # rounding must not turn the split
    assert split_quads(np.array([[0, 1, 2, 3]]), square).tolist() == [[0, 1, 2], [0, 2, 3]]
    square[2] += 2e-13
    assert split_quads(np.array([[0, 1, 2, 3]]), square).tolist() == [[0, 1, 2], [0, 2, 3]]


def test_open_flipped_and_degenerate_triangles_are_counted():
    nodes, hexahedra = brick(np.ones((2, 2, 2), dtype=bool))
    triangles = split_quads(boundary_quads(hexahedra).quads, nodes)
    opened = surface_quality(triangles[1:], nodes, hexahedra)
    assert (opened.open_edges, opened.flipped_edges, opened.is_closed) == (3, 0, False)
    turned = triangles.copy()
    turned[0] = turned[0, ::-1]
    flipped = surface_quality(turned, nodes, hexahedra)
    assert (flipped.flipped_edges, flipped.is_closed) == (3, False)
    flat = nodes.copy()
    a, b, c = triangles[0]
    flat[a] = (nodes[b] + nodes[c]) / 2.0
    assert surface_quality(triangles, flat, hexahedra).degenerate >= 1


def test_200_000_hexahedra_take_half_a_second():
    nodes, hexahedra = brick(np.ones((100, 100, 20), dtype=bool))
    nodes = nodes + np.random.default_rng(0).normal(0.0, 0.01, nodes.shape)
    spent = []
    for _ in range(3):
        start = time.process_time()
        triangles = split_quads(boundary_quads(hexahedra).quads, nodes)
        spent.append(time.process_time() - start)
    assert len(hexahedra) == 200_000
    assert len(triangles) == 4 * (100 * 100 + 2 * 100 * 20)
    assert min(spent) < 0.5


def test_smooth_normals_are_those_of_a_sphere_however_quads_are_split():
    used = np.ones((12, 12, 12), dtype=bool)
    nodes, hexahedra = brick(used)
    quads = boundary_quads(hexahedra).quads
    on_cube = (nodes - 6.0) / 6.0
    onto_ball = on_cube / np.maximum(np.linalg.norm(on_cube, axis=1, keepdims=True), 1e-12)
    skin = np.unique(quads)
    for turn in (0, 1):
        rolled = np.roll(quads, turn, axis=1)
        triangles = np.stack([rolled[:, [0, 1, 2]], rolled[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
        normals = smooth_normals(triangles, onto_ball)
        # facets of h = 1/6 turn by h^2 / 8 relative to the tangent plane on average, most at the corners of the cube
        assert np.abs(normals[skin] - onto_ball[skin]).max() < 0.03
    inner = np.setdiff1d(np.arange(len(nodes)), skin)
    assert not normals[inner].any()


@pytest.mark.parametrize("name", PRESETS)
def test_a_mesh_at_rest_has_the_surfaces_of_the_undeformed_finger(name):
    design = preset_design(name)
    mesh = meshed(name)
    shape, rest = shape_from_mesh(design, mesh.nodes_mm, mesh.hexahedra), rest_shape(design)
    # chords of 2 mm on curved pads of 40 mm radius: h^2 / 12 R = 8 um of 6 mm
    assert check_closed(shape.gel) == pytest.approx(check_closed(rest.gel), rel=2e-3)
    assert np.isnan(shape.contact_distance).all()
    check_no_intersections(shape.surfaces, "finger")
    dark = {name: shape.surfaces[name] for name in (*DARK_BODIES, "mirror") if name in shape.surfaces}
    parts = [h for name, h in mesh.hexahedra.items() if name in dark]
    volume = hexahedra_volume_mm3(mesh.nodes_mm, np.concatenate(parts)).sum()
    assert check_closed(dark, "skeleton") == pytest.approx(volume, rel=1e-6)


@pytest.mark.parametrize("name", ["flat-70x35", "ellipsoidal-30-8-90"])
def test_optics_finds_smooth_faces_in_the_mesh(name):
    design, mesh = preset_design(name), meshed(name)
    faces = shape_from_mesh(design, mesh.nodes_mm, mesh.hexahedra).surfaces
    u, v = np.meshgrid(np.linspace(0.0, 1.0, 15), np.linspace(0.0, 1.0, 31), indexing="ij")
    edge, across = rest_height_mm(design, 17.5, 70.0 * v), 35.0 * u - 17.5
    expected = {
        "inner": (across, 0.0 * u),
        "coat": (across, rest_height_mm(design, across, 70.0 * v)),
        "red": (0.0 * u - 17.5, u * edge),
        "green": (0.0 * u + 17.5, u * edge),
    }
    flat = rest_shape(DESIGN).surfaces
    for face, (x, y) in expected.items():
        found = PositionMap.of(faces[face], face)
        # cubic splines through vertices every 2 mm of faces that bend over tens of mm
        places = np.stack([x, y, 70.0 * v], axis=-1)
        np.testing.assert_allclose(found.positions_mm(np.stack([u, v], axis=-1)), places, atol=5e-3)
        assert found.turn == PositionMap.of(flat[face], face).turn


@pytest.mark.parametrize("preset", ["medium", "fine"])
def test_finer_meshes_at_rest_are_closed_and_free_of_intersections(preset):
    mesh = meshed(preset=preset)
    shape = shape_from_mesh(DESIGN, mesh.nodes_mm, mesh.hexahedra)
    assert check_closed(shape.gel) == pytest.approx(14700.0, rel=1e-12)
    check_no_intersections(shape.surfaces, "finger")


def test_a_bent_mesh_is_the_bent_finger():
    mesh = meshed()
    at_rest = Surface(mesh.nodes_mm, np.array([[0, 1, 2]]), np.zeros((len(mesh.nodes_mm), 2)))
    carrier = rest_shape(DESIGN)
    with_nodes = type(carrier)({**carrier.surfaces, "all": at_rest}, carrier.contact_distance, "nodes")
    moved = bent(with_nodes, 300.0).surfaces["all"].vertices_mm
    distance = np.linspace(0.0, 2.0, len(mesh.node_sets["coat"]))
    shape = shape_from_mesh(DESIGN, mesh.nodes_mm, mesh.hexahedra, moved - mesh.nodes_mm, distance, label="bent")
    rest, expected = shape_from_mesh(DESIGN, mesh.nodes_mm, mesh.hexahedra), bent(carrier, 300.0)
    assert shape.label == "bent"
    assert check_closed(shape.gel) == pytest.approx(check_closed(expected.gel), rel=1e-4)
    for name, surface in shape.surfaces.items():
        np.testing.assert_array_equal(surface.triangles, rest.surfaces[name].triangles)
        np.testing.assert_array_equal(surface.uv, rest.surfaces[name].uv)
    numbers = coat_nodes(DESIGN, mesh.nodes_mm, mesh.hexahedra)
    np.testing.assert_array_equal(numbers, mesh.node_sets["coat"])
    np.testing.assert_allclose(shape.surfaces["coat"].vertices_mm, moved[numbers], atol=ROUNDING_MM)
    np.testing.assert_array_equal(shape.contact_distance, distance)


def test_texture_coordinates_are_those_of_the_undeformed_finger():
    mesh = meshed()
    faces = shape_from_mesh(DESIGN, mesh.nodes_mm, mesh.hexahedra).surfaces
    for name, axes in (("coat", (0, 2)), ("inner", (0, 2)), ("red", (1, 2)), ("green", (1, 2)), ("tip", (0, 1))):
        place = (faces[name].vertices_mm / [35.0, 6.0, 70.0] + [0.5, 0.0, 0.0])[:, axes]
        np.testing.assert_allclose(faces[name].uv, place, atol=1e-12)
    mirror, sheet = mirror_shape(DESIGN), faces["mirror"]
    np.testing.assert_allclose(sheet.vertices_mm[:, 0], (2.0 * sheet.uv[:, 0] - 1.0) * mirror.half_width_mm, atol=1e-9)
    s = (2.0 * sheet.uv[:, 1] - 1.0) * mirror.half_length_mm
    yz = mirror.apex_yz_mm + s[:, None] * mirror.tangent_yz - s[:, None] ** 2 / 800.0 * mirror.normal_yz
    np.testing.assert_allclose(sheet.vertices_mm[:, 1:], yz, atol=1e-9)
    corners = sheet.vertices_mm[sheet.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 1] > 0.0).all()  # to the pad


@pytest.mark.parametrize("name", ["flat-70x35", "wide-50x60"])
def test_the_camera_sees_the_meshed_finger_as_the_undeformed_one(name, scalar):
    design = preset_design(name).model_copy(update={"camera": TactileCamera(width_px=96, height_px=72)})
    mesh, rest = meshed(name), rest_shape(design)
    shape = shape_from_mesh(design, mesh.nodes_mm, mesh.hexahedra)
    seen, expected = pixel_maps(design, shape, shape, scalar), pixel_maps(design, rest, rest, scalar)
    for part in ("coat", "red", "green", "panel 1"):
        np.testing.assert_array_equal(seen.sees(part), expected.sees(part))
    coat = expected.sees("coat")
    assert coat.sum() > 200
    # The mean normal at a vertex between rows of 0.6 and 2.5 mm of a mirror of 400 mm radius is turned by up to
    # 1.9 mm / 800 mm, which moves what is seen at up to 40 mm by 0.1 mm; a pixel here covers 1.4 mm.
    assert np.linalg.norm((seen.position_mm - expected.position_mm)[coat], axis=1).max() < 0.12


def test_what_is_no_mesh_of_this_design_is_refused():
    mesh = meshed()
    parts = mesh.hexahedra
    with pytest.raises(SimulateError, match="no block gel; it has film, skeleton"):
        shape_from_mesh(DESIGN, mesh.nodes_mm, {name: h for name, h in parts.items() if name != "gel"})
    with pytest.raises(SimulateError, match="no face red and no face green and no face tip"):
        shape_from_mesh(preset_design("baby-48x18"), mesh.nodes_mm, parts)
    with pytest.raises(SimulateError, match="displacement_mm must be finite, of shape"):
        shape_from_mesh(DESIGN, mesh.nodes_mm, parts, np.zeros((3, 3)))
    flatter = DESIGN.model_copy(update={"mirror": DESIGN.mirror.model_copy(update={"radius_mm": 800.0})})
    with pytest.raises(SimulateError, match="no face of the block mirror lies on the mirror"):
        shape_from_mesh(flatter, mesh.nodes_mm, parts)


def test_gel_and_mirror_alone_make_a_shape():
    mesh = meshed()
    only = {name: mesh.hexahedra[name] for name in ("gel", "mirror")}
    assert set(shape_from_mesh(DESIGN, mesh.nodes_mm, only).surfaces) == {*GEL_FACES, "mirror"}
