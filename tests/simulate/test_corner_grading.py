"""Steps that grow from corners: lengths, ratios and ends by their definition."""

import numpy as np
import pytest

from data_schemas import FingerDesign
from sim.mechanics import skeleton_layout
from sim.mechanics._finger_mesh import TiedNodes
from sim.mechanics._mesh import CornerGrading, Tie, fitted_between, graded
from sim.mechanics._skeleton import skeleton_side_view

DESIGN = FingerDesign()


@pytest.mark.parametrize("corners", [(True, True), (True, False), (False, True)])
@pytest.mark.parametrize("length_mm", [1.2, 1.6, 7.0, 40.0])
def test_steps_grow_from_corners_by_at_most_the_ratio(length_mm, corners):
    places = graded(length_mm, 0.15, 4.0, 2.5, corners)
    steps = np.diff(places)
    assert places[0] == 0.0
    assert places[-1] == pytest.approx(length_mm)
    assert steps.min() == pytest.approx(0.15)
    assert steps.max() < 2.5 * 1.01
    assert (steps[1:] / steps[:-1]).max() < 4.0 * 1.01
    assert (steps[:-1] / steps[1:]).max() < 4.0 * 1.01
    for is_corner, step in zip(corners, (steps[0], steps[-1]), strict=True):
        assert not is_corner or step == pytest.approx(0.15)


def test_without_corners_or_room_steps_are_even():
    np.testing.assert_allclose(graded(6.0, 0.15, 4.0, 2.5, (False, False)), [0.0, 2.0, 4.0, 6.0])
    np.testing.assert_allclose(graded(0.4, 0.15, 4.0, 2.5), [0.0, 0.4])
    np.testing.assert_allclose(graded(5.0, 2.5, 1.0, 2.5), [0.0, 2.5, 5.0])


def test_a_pattern_fits_between_fins_of_any_distance():
    pattern = graded(20.0, 0.15, 4.0, 2.5)
    shares = fitted_between(pattern, np.array([30.0, 20.0, 10.0, 1.0]))
    np.testing.assert_allclose(shares[:, 1] * 20.0, pattern, atol=1e-12)
    steps = np.diff(shares, axis=0) * [30.0, 20.0, 10.0, 1.0]
    # the first step stays where there is room for as many; all grow where there is more, and are even where not
    np.testing.assert_allclose(steps[0], [0.225, 0.15, 0.15, 1.0 / (len(pattern) - 1)], atol=1e-12)
    assert np.ptp(steps[:, 3]) < 1e-12
    assert steps.min() > 0.0
    np.testing.assert_allclose(shares + shares[::-1], 1.0, atol=1e-12)


def test_a_graded_skeleton_has_short_edges_at_the_inner_corners():
    layout, thickness = skeleton_layout(DESIGN), DESIGN.skeleton.rib_thickness_mm
    view = skeleton_side_view(DESIGN, layout, 2.5, CornerGrading(0.15, 4.0))
    _, _, between, front, _ = view.ends
    # along the front fin's inner face, on both sides of every edge of a rib
    z = view.points_mm[front, :, 1]
    for edge in layout.ribs[:, :, 0].ravel():
        k = int(np.argmin(np.abs(z - edge)))
        assert z[k] == pytest.approx(edge)
        assert max(z[k + 1] - z[k], z[k] - z[k - 1]) < 0.15 * thickness * 1.01
    # and from the face, into the fin and along the ribs
    through = np.linalg.norm(np.diff(view.points_mm, axis=0), axis=2)
    ribs = view.kinds == "rib"
    assert through[front, :-1].max() == pytest.approx(0.15 * thickness)
    assert through[between, :-1][ribs].max() < 0.15 * thickness * 1.01
    assert through[front - 1, :-1][ribs].max() < 0.15 * thickness * 1.01


def test_a_node_on_a_long_narrow_face_is_tied_to_it():
    """Its own face's centre is further away than that of ten faces beside it."""
    edges = np.concatenate([[0.0], 4.0 + 0.1 * np.arange(12)])
    nodes = np.array([(10.0 * x, y, 0.0) for y in edges for x in (0.0, 1.0)])
    quads = np.array([(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(12)])
    place = np.array([[9.9, 3.9, 0.0]])
    tied = TiedNodes(np.concatenate([nodes, place]), Tie(np.array([len(nodes)]), quads), 1.0)
    u = np.concatenate([nodes, place]) @ np.array([[0.1, 0.0, 0.2], [0.0, 0.3, 0.1], [0.0, 0.0, 0.0]])
    # of a linear field nothing is left, on the face itself only
    np.testing.assert_allclose(tied.gaps_mm(u), 0.0, atol=1e-12)
