"""The smooth map of a face against closed forms of its shape."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from data_schemas import FingerDesign, SimulateError
from sim.optics._position_map import PositionMap
from sim.surface_meshes import Surface, bent, rest_shape
from sim.surface_meshes._finger_shape import grid_surface

RADIUS_MM = 80.0
WIDTH_MM, LENGTH_MM = 35.0, 70.0


def arc(uv):
    """Inner face of a finger bent to RADIUS_MM towards the mirror, with d/dv and d2/dv2."""
    turn = LENGTH_MM / RADIUS_MM
    angle = uv[..., 1] * turn
    x, none = (uv[..., 0] - 0.5) * WIDTH_MM, np.zeros(uv.shape[:-1])
    position = np.stack([x, RADIUS_MM * (np.cos(angle) - 1.0), RADIUS_MM * np.sin(angle)], -1)
    dv = turn * RADIUS_MM * np.stack([none, -np.sin(angle), np.cos(angle)], -1)
    dvv = turn**2 * RADIUS_MM * np.stack([none, -np.cos(angle), -np.sin(angle)], -1)
    return position, dv, dvv


def unstructured(count=1500, seed=3):
    rng = np.random.default_rng(seed)
    edge = np.linspace(0.0, 1.0, 30)
    frame = [
        np.column_stack(p) for p in ((edge, 0 * edge), (edge, 0 * edge + 1), (0 * edge, edge), (0 * edge + 1, edge))
    ]
    uv = np.unique(np.concatenate([rng.random((count, 2)), *frame]), axis=0)
    triangles = Delaunay(uv).simplices
    a, b, c = (uv[triangles[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return Surface(arc(uv)[0], triangles[np.abs(area) > 1e-9], uv)


def structured():
    return bent(rest_shape(FingerDesign()), RADIUS_MM).surfaces["inner"]


@pytest.mark.parametrize("surface", [structured, unstructured])
def test_an_arc_and_its_derivatives_are_met(surface):
    face = PositionMap.of(surface())
    uv = np.random.default_rng(1).uniform(0.02, 0.98, (500, 2))
    position, dv, dvv = arc(uv)
    found = face.evaluate(uv[:, 0], uv[:, 1])
    # the spline itself is good to 1e-6 mm; what no vertex settles (between three columns of vertices, between
    # scattered ones) is filled smoothly, which is a hundred times coarser and still a hundredth of a facet's error
    np.testing.assert_allclose(np.stack(found.position, -1), position, atol=1e-4)
    np.testing.assert_allclose(np.stack(found.dv, -1), dv, atol=1e-4 * LENGTH_MM)
    np.testing.assert_allclose(np.stack(found.dvv, -1), dvv, atol=0.02 * LENGTH_MM**2 / RADIUS_MM)
    np.testing.assert_allclose(np.stack(found.du, -1), np.tile([WIDTH_MM, 0.0, 0.0], (500, 1)), atol=1e-3)
    assert np.abs(found.duu).max() < 0.1  # mm, against 35 mm across: rounding of vertices a few um apart in uv
    # facets of 3 mm lie h^2 / 8 R inside the arc
    assert face.gap_mm < 9.0 * 4.0 / 8.0 / RADIUS_MM


def test_normals_are_on_the_side_of_the_mesh():
    surface = structured()
    uv = np.array([[0.3, 0.4]])
    position = arc(uv)[0]
    outward = position + np.array([0.0, RADIUS_MM, 0.0])  # towards the centre of the arc lies the mirror
    outward = -outward * np.array([0.0, 1.0, 1.0]) / RADIUS_MM
    np.testing.assert_allclose(PositionMap.of(surface).normals(uv), outward, atol=1e-4)
    np.testing.assert_allclose(PositionMap.of(surface.reversed()).normals(uv), -outward, atol=1e-4)


def test_a_plane_is_known_as_one():
    assert PositionMap.of(rest_shape(FingerDesign()).surfaces["inner"]).is_plane
    assert not PositionMap.of(structured()).is_plane


@pytest.mark.renderer
@pytest.mark.parametrize("radius_mm", [None, RADIUS_MM])
def test_the_renderer_evaluates_the_same_map(llvm, radius_mm):
    shape = rest_shape(FingerDesign())
    face = PositionMap.of((shape if radius_mm is None else bent(shape, radius_mm)).surfaces["inner"])
    uv = np.random.default_rng(2).random((300, 2))
    uv[:2] = [[0.0, 0.0], [1.0, 1.0]]
    expected = face.evaluate(uv[:, 0], uv[:, 1])
    u, v = (llvm.Float(uv[:, k].astype(np.float32)) for k in (0, 1))
    found = face.in_renderer(llvm)(u, v)
    for name, exact, single in zip(expected._fields, expected, found, strict=True):
        for a, b in zip(exact, single, strict=True):
            # single precision of numbers up to 70 mm; second derivatives add 64^2 times their rounding
            scale = 64.0**2 if name in ("duu", "duv", "dvv") else 64.0 if name in ("du", "dv") else 1.0
            np.testing.assert_allclose(np.broadcast_to(np.array(b), len(uv)), a, atol=3e-5 * scale)


def test_folded_texture_coordinates_and_crumpled_faces_are_refused():
    u = np.linspace(0.0, 1.0, 9)
    points = np.stack([*np.meshgrid(35 * u, 0.0 * u[:1], 70 * u, indexing="ij")], -1)[:, 0]
    folded = grid_surface(points, np.abs(u - 0.5), u)
    with pytest.raises(SimulateError, match="texture coordinates of the inner face fold, because 64 of 128 triangles"):
        PositionMap.of(folded, "inner face")
    turned = folded.triangles[:33]  # 32 of one sense, the last of the other
    for triangles in (turned, turned[:, ::-1]):
        with pytest.raises(SimulateError, match="fold, because 1 of 33 triangles turn the other way"):
            PositionMap.of(Surface(folded.vertices_mm, triangles, folded.uv), "inner face")
    crumpled = points + np.random.default_rng(0).normal(0.0, 3.0, points.shape) * [0.0, 1.0, 0.0]
    fine = grid_surface(np.repeat(np.repeat(crumpled, 8, 0), 8, 1), np.linspace(0, 1, 72), np.linspace(0, 1, 72))
    with pytest.raises(
        SimulateError, match=r"the inner face is not a smooth face, because .* at most 0.3 mm is allowed"
    ):
        PositionMap.of(fine, "inner face")


def test_the_same_mesh_is_fitted_once_and_a_changed_one_again():
    surface = rest_shape(FingerDesign()).surfaces["inner"]
    face = PositionMap.of(surface)
    copy = replace(surface, vertices_mm=surface.vertices_mm.copy())
    assert PositionMap.of(copy) is face
    copy.vertices_mm[:, 1] += 1.0
    assert PositionMap.of(copy).positions_mm(np.array([0.3, 0.6]))[1] == pytest.approx(
        face.positions_mm(np.array([0.3, 0.6]))[1] + 1.0, abs=1e-6
    )
    with pytest.raises(ValueError, match="read-only"):
        face.coefficients_mm[0] = 0.0
