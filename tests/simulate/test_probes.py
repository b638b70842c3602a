"""Where probes lie: on any deformed finger, at the same places of the undeformed pad."""

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from data_schemas import FingerDesign, GelPad, Indenter, SimulateError
from sim.optics._probes import default_probe_points_mm, probes_on
from sim.surface_meshes import bent, pressed_height_mm, pressed_shape, rest_shape

DESIGN = FingerDesign()
XZ_MM = np.array([[-11.0, 20.0], [3.0, 35.0], [11.0, 61.0]])


def test_on_the_analytic_press_they_lie_on_the_coat_and_look_along_the_normal():
    probes = probes_on(DESIGN, pressed_shape(DESIGN), XZ_MM)
    height = [pressed_height_mm(DESIGN, p[:1], p[1:])[0, 0] for p in XZ_MM]
    # chords of 0.1 mm on an indenter of 10 mm: 0.1^2 / 8 / 10 mm
    np.testing.assert_allclose(probes.points_mm, np.column_stack([XZ_MM[:, 0], height, XZ_MM[:, 1]]), atol=1.3e-4)
    np.testing.assert_allclose(probes.origins_mm, probes.points_mm * [1.0, 0.5, 1.0], atol=1e-12)
    np.testing.assert_allclose(probes.directions, [[0.0, 1.0, 0.0]] * 3, atol=1e-12)


def test_they_follow_a_bent_finger():
    radius_mm = 200.0
    probes = probes_on(DESIGN, bent(rest_shape(DESIGN), radius_mm), XZ_MM)
    turn = XZ_MM[:, 1] / radius_mm
    arm = radius_mm + DESIGN.pad.thickness_mm
    expected = np.column_stack([XZ_MM[:, 0], arm * np.cos(turn) - radius_mm, -arm * np.sin(-turn)])
    np.testing.assert_allclose(probes.points_mm, expected, atol=1e-4)  # chords of 0.1 mm
    across = np.zeros(3)
    np.testing.assert_allclose(probes.directions, np.column_stack([across, np.cos(turn), np.sin(turn)]), atol=1e-3)


@pytest.mark.parametrize("pad", [GelPad(), GelPad(shape="cylindrical", radius_mm=40.0)])
def test_default_probes_flank_the_contact_and_stay_on_the_pad(pad):
    design = DESIGN.model_copy(update={"pad": pad})
    points = default_probe_points_mm(design, pressed_shape(design))
    spacing_mm = 70.0 / 4000
    np.testing.assert_allclose(np.abs(points[:, 1] - 35.0), np.sqrt(27.75), atol=spacing_mm)
    edge = FingerDesign(indenter=Indenter(position_mm=69.0))
    assert default_probe_points_mm(edge, pressed_shape(edge))[:, 1].max() == pytest.approx(66.5)
    rest = default_probe_points_mm(DESIGN, rest_shape(DESIGN))
    np.testing.assert_allclose(rest[:, 1], 35.0)


def test_default_probes_lie_on_the_edge_of_a_ball_beside_the_middle():
    """The contact of a ball is a circle of radius sqrt(2 r d - d^2), wherever on the pad it is."""
    ball = Indenter(shape="ball", radius_mm=7.0, position_mm=26.0, across_mm=10.0, depth_mm=1.0)
    design = FingerDesign(indenter=ball)
    points = default_probe_points_mm(design, pressed_shape(design))
    assert len(np.unique(points, axis=0)) == 4
    # the coat's columns are 0.5 mm apart here, and the contact ends between two of them
    np.testing.assert_allclose(np.hypot(*(points - [10.0, 26.0]).T), np.sqrt(13.0), atol=0.5)
    rim = FingerDesign(indenter=ball.model_copy(update={"across_mm": 17.0}))
    assert default_probe_points_mm(rim, pressed_shape(rim))[:, 0].max() <= 0.45 * 35.0


@pytest.mark.parametrize(
    ("points", "said"), [(np.array([[18.0, 35.0]]), "lies outside the pad"), (np.zeros((4, 3)), "shape")]
)
def test_points_beside_the_pad_are_refused(points, said):
    with pytest.raises(SimulateError, match=said):
        probes_on(DESIGN, rest_shape(DESIGN), points)


def test_points_are_interpolated_as_by_another_program():
    """On a flat pad both diagonals of a quadrilateral of the mesh give the same, so scipy's triangles are as good."""
    shape, uv = pressed_shape(DESIGN), np.random.default_rng(1).uniform(0.01, 0.99, (200, 2))
    probes = probes_on(DESIGN, shape, (uv - [0.5, 0.0]) * [35.0, 70.0])
    coat = shape.surfaces["coat"]
    np.testing.assert_allclose(probes.points_mm, LinearNDInterpolator(coat.uv, coat.vertices_mm)(uv), atol=1e-10)


def test_a_curved_pad_keeps_its_probes_on_its_own_triangles():
    design = FingerDesign(pad=GelPad(shape="cylindrical", radius_mm=40.0))
    shape = pressed_shape(design)
    coat = shape.surfaces["coat"]
    # the centre of each triangle is the mean of its corners
    some = np.random.default_rng(2).choice(len(coat.triangles), 50, replace=False)
    uv, centres = (v[coat.triangles[some]].mean(axis=1) for v in (coat.uv, coat.vertices_mm))
    probes = probes_on(design, shape, (uv - [0.5, 0.0]) * [design.pad.width_mm, design.pad.length_mm])
    np.testing.assert_allclose(probes.points_mm, centres, atol=1e-9)
