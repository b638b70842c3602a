"""Meshes that cross, against the IPC Toolkit's own test and against cases that are known by construction."""

import time

import numpy as np
import pytest

from sim.mechanics._contact_library import contact_library, contact_library_failure
from sim.surface_meshes._solid import crossing_pair

TRIANGLE = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])


def with_needle(first, second):
    """A triangle in the plane z = 0 and a thin one from one place to another."""
    needle = np.array([first, second, np.add(second, [0.0, 0.0, 1e-3])])
    return np.concatenate([TRIANGLE, needle]), np.array([[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize("turn", range(6))
@pytest.mark.parametrize(
    ("first", "second", "crosses"),
    [
        ((1.0, 1.0, -1.0), (1.0, 1.0, 1.0), True),
        ((1.0, 1.0, 0.0), (1.0, 1.0, 1.0), True),  # ends on it
        ((1.0, 1.0, 1e-6), (1.0, 1.0, 1.0), False),  # ends a nanometre above it
        ((2.0, 2.0, -1.0), (2.0, 2.0, 1.0), True),  # through its edge
        ((2.001, 2.001, -1.0), (2.001, 2.001, 1.0), False),  # beside it
        ((3.0, 3.0, -1.0), (3.0, 3.0, 1.0), False),  # inside its box
        ((-1.0, 1.0, 2.0), (5.0, 1.0, 1.0), False),
        ((1.0, 1.0, 5.0), (1.0, 1.0, 7.0), False),
        ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), True),  # through its corner
    ],
)
def test_an_edge_and_a_triangle(first, second, crosses, turn):
    """Whatever the order of the axes and of the triangles is."""
    vertices, triangles = with_needle(first, second)
    axes = np.roll([0, 1, 2], turn % 3)
    found = crossing_pair(vertices[:, axes], triangles if turn < 3 else triangles[::-1])
    assert (found is not None) is crosses
    if found is not None:
        assert set(found[0].tolist()) | set(found[1].tolist()) <= set(range(6))


def test_grids_that_cross_at_their_nodes_are_found():
    """No edge has both ends off the other plane: touching must count."""
    places = np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
    quads = [(0, 1, 4, 3), (1, 2, 5, 4), (3, 4, 7, 6), (4, 5, 8, 7)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    flat, upright = np.insert(places, 2, 0.0, axis=1), np.insert(places, 1, 0.0, axis=1)
    both = np.concatenate([triangles, triangles + 9])
    assert crossing_pair(np.concatenate([flat, upright]), both) is not None
    assert crossing_pair(np.concatenate([flat, upright + np.array([0.0, 0.0, 1.001])]), both) is None


def test_neighbours_and_what_lies_in_one_plane_do_not_cross():
    rng = np.random.default_rng(1)
    for _ in range(50):
        size = int(rng.integers(2, 9))
        x, y = np.meshgrid(np.arange(size + 1.0), np.arange(size + 1.0), indexing="ij")
        height = rng.normal(size=x.shape) * rng.choice([0.0, 0.3])
        vertices = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
        corner = (np.arange(size)[:, None] * (size + 1) + np.arange(size)).ravel()
        first = np.column_stack([corner, corner + 1, corner + size + 2])
        second = np.column_stack([corner, corner + size + 2, corner + size + 1])
        turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        assert crossing_pair(vertices @ turned, np.concatenate([first, second])) is None


@pytest.mark.skipif(contact_library_failure() is not None, reason=f"NO BARRIER CONTACT: {contact_library_failure()}")
def test_the_toolkit_says_the_same_of_random_triangles():
    """Of 2000 meshes of a few triangles, most share vertices and some 750 cross."""
    ipctk, rng, crossing = contact_library(), np.random.default_rng(2), 0
    for _ in range(2000):
        count = int(rng.integers(4, 14))
        vertices = rng.normal(size=(count, 3)) * rng.choice([1.0, 0.1], size=(count, 1))
        triangles = np.array([rng.choice(count, 3, replace=False) for _ in range(rng.integers(2, 7))])
        ours = crossing_pair(vertices, triangles) is not None
        places = np.asfortranarray(vertices)
        theirs = ipctk.has_intersections(ipctk.CollisionMesh(places, ipctk.edges(triangles), triangles), places)
        assert ours == theirs, (vertices.tolist(), triangles.tolist())
        crossing += ours
    assert 400 < crossing < 1600


def sheets(cells, apart):
    """Two wavy sheets of triangles, one over the other."""
    x, y = np.meshgrid(np.arange(cells + 1.0), np.arange(cells + 1.0), indexing="ij")
    sheet = np.column_stack([x.ravel(), y.ravel(), 0.1 * np.sin(x + y).ravel()])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    first = np.column_stack([corner, corner + cells + 1, corner + cells + 2])
    one = np.concatenate([first, np.column_stack([corner, corner + cells + 2, corner + 1])])
    above = sheet + np.array([0.3, 0.2, apart])
    return np.concatenate([sheet, above]), np.concatenate([one, one + len(sheet)])


@pytest.mark.parametrize("far_mm", [1e3, 1e6, -1e9])
def test_a_corner_far_away_neither_hides_a_crossing_nor_makes_the_search_slow(far_mm):
    """Without a bound on the grid by all other corners one cell holds them all: 20 to 100 times the time."""
    for apart, crosses in ((0.0, True), (0.5, False)):
        vertices, triangles = sheets(60, apart)
        vertices[30 * 61 + 30, 2] = -abs(far_mm)  # away from the other sheet
        assert (crossing_pair(vertices, triangles) is not None) is crosses
    away = np.concatenate([vertices, [[far_mm, far_mm, far_mm], [far_mm + 1.0, far_mm, 0.0], [far_mm, 1.0, far_mm]]])
    more = np.concatenate([triangles, [[len(vertices) + k for k in range(3)]]])
    plain, near, far = sheets(60, 0.5)[0], np.inf, np.inf
    for _ in range(3):
        begin = time.process_time()
        assert crossing_pair(plain, triangles) is None
        middle = time.process_time()
        assert crossing_pair(away, more) is None
        near, far = min(near, middle - begin), min(far, time.process_time() - middle)
    assert far < 5.0 * near + 0.01
