"""Drawings of a finger: the cut is that of the mesh, labels do not overlap, a press shows what its records say."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.optimize import minimize

from data_schemas import FingerDesign, Indenter, PressMechanics
from data_schemas._design_parts import TactileCamera
from finray_calib.demo._report import compare_section, simulate_section
from finray_calib.reports import finger_outline, finger_page_png, pressed_finger_png
from finray_calib.reports._finger_pictures import _draw_after, _draw_curve, finger_png
from finray_calib.reports._finger_views import outer_edges, side_polygons, spread
from sim import preset_design
from sim.optics import camera_view
from sim.surface_meshes import pressed_shape, rest_shape, store_shapes
from tests.documentation.example_records import example_results

SMALL = TactileCamera(width_px=160, height_px=120)


def pixels(png):
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)


def polygon_area(polygons):
    y, z = polygons[..., 0], polygons[..., 1]
    return np.abs((y * np.roll(z, -1, axis=1) - np.roll(y, -1, axis=1) * z).sum(axis=1)).sum() / 2.0


def test_the_cut_through_base_plate_and_backing_has_their_size():
    finger = finger_outline(FingerDesign())
    skeleton, (low, _) = finger.design.skeleton, finger.bounds_mm
    base = side_polygons(finger, "base_plate", 0.01)
    deep = finger.layout.front_outer_mm - low[1]
    # its back end follows the curve of the back fin, which is a little oblique
    assert polygon_area(base) == pytest.approx(deep * skeleton.base_thickness_mm, rel=0.05)
    backing = side_polygons(finger, "backing", 0.01)
    ends = backing[..., 0].min(), backing[..., 0].max()
    # an offset curve, slightly inclined: as long as its ends are apart, to 5 %
    assert polygon_area(backing) >= skeleton.backing.thickness_mm * (ends[1] - ends[0])
    assert polygon_area(backing) == pytest.approx(skeleton.backing.thickness_mm * (ends[1] - ends[0]), rel=0.05)


def test_ribs_stand_beside_the_cut_and_not_in_it():
    finger = finger_outline(FingerDesign())
    beyond, cut = (side_polygons(finger, "skeleton", x) for x in (0.95 * finger.layout.half_width_mm, 0.01))
    z_rib = float(finger.layout.ribs[2, :, 0].mean())

    def has_material(polygons, y):
        low, high = polygons.min(axis=1), polygons.max(axis=1)
        return ((low < (z_rib, y)) & (high > (z_rib, y))).all(axis=1).any()

    assert has_material(beyond, -6.0)
    assert not has_material(cut, -6.0)


def test_outer_edges_are_those_of_one_polygon():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    edges = outer_edges(np.stack([square, square + np.array([1.0, 0.0])]))
    assert len(edges) == 6
    assert np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum() == pytest.approx(6.0)


@pytest.mark.parametrize("seed", range(5))
def test_labels_keep_their_distance_and_move_as_little_as_possible(seed):
    rng = np.random.default_rng(seed)
    wanted, widths = np.sort(rng.uniform(0.0, 50.0, 6)), rng.uniform(4.0, 12.0, 6)
    limits = (-5.0, 60.0)
    centres = spread(wanted, widths, limits)
    room = np.diff(centres) - (widths[1:] + widths[:-1]) / 2.0
    assert room.min() > -1e-9
    # truth: the same least squares with the same constraints by a general solver
    bounds = [
        {"type": "ineq", "fun": lambda c: np.diff(c) - (widths[1:] + widths[:-1]) / 2.0},
        {"type": "ineq", "fun": lambda c: np.r_[c[0] - widths[0] / 2 - limits[0], limits[1] - c[-1] - widths[-1] / 2]},
    ]
    best = minimize(lambda c: ((c - wanted) ** 2).sum(), centres + 0.1, constraints=bounds, method="SLSQP")
    np.testing.assert_allclose(centres, best.x, atol=1e-3)  # of 65 mm, as far as the solver goes


@pytest.mark.parametrize("name", ["flat-70x35-two-lights", "original-60x22", "wide-50x60", "ellipsoidal-30-12-90"])
def test_ready_made_fingers_are_drawn(name):
    picture = pixels(finger_png(preset_design(name)))
    assert picture.shape[1] == 1320
    # of each part, in its own colour: gel, skeleton, base plate, mirror, light, painted walls (blue, green, red)
    for colour in ("f6e7c1", "b8c0c8", "7d8590", "56B4E9", "0072B2", "D55E00", "009E73"):
        bgr = np.array([int(colour[k : k + 2], 16) for k in (4, 2, 0)])
        assert (picture == bgr).all(axis=-1).sum() > 200


@pytest.mark.parametrize(
    ("indenter", "touch_mm"),
    [
        (Indenter(shape="cuboid", size_mm=(30.0, 20.0, 12.0), position_mm=40.0, across_mm=2.0), (2.0, 40.0)),
        # turned by 30 deg about x: the corner of the inner box, 4 - 1 along and 20 - 1 up, lies lowest
        (
            Indenter(shape="cuboid", size_mm=(10.0, 40.0, 8.0), position_mm=55.0, rotation_deg=(30.0, 0.0, 0.0)),
            (0.0, 55.0 + 3.0 * np.cos(np.radians(30.0)) - 19.0 * np.sin(np.radians(30.0))),
        ),
        (Indenter(shape="ball", radius_mm=8.0, position_mm=30.0, across_mm=-3.0), (-3.0, 30.0)),
    ],
    ids=["face", "edge", "ball"],
)
def test_the_first_touch_is_where_the_indenter_is_lowest(indenter, touch_mm):
    finger = finger_outline(FingerDesign(indenter=indenter))
    # chords of round edges of 1 mm, and the middle of those within 0.05 mm of the coat
    assert finger.touch_mm == pytest.approx(touch_mm, abs=0.25)
    lowest = finger.indenter_mm[finger.indenter_mm[:, 1].argmin()]
    assert lowest[1] == pytest.approx(6.0, abs=0.05)


def test_the_mesh_of_an_indenter_is_drawn_where_it_is_at_hand(tmp_path):
    corners = np.array([[-8.0, 0.0, -6.0], [8.0, 0.0, -6.0], [0.0, 0.0, 10.0], [2.0, -12.0, 3.0]])
    faces = [corners[list(k)] for k in ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))]
    text = ["solid spike"]
    for a, b, c in faces:
        if np.cross(b - a, c - a) @ (a - corners.mean(axis=0)) < 0.0:
            b, c = c, b
        lines = [f"vertex {' '.join(map(str, p))}" for p in (a, b, c)]
        text += ["facet normal 0 0 0", "outer loop", *lines, "endloop", "endfacet"]
    (tmp_path / "spike.stl").write_text("\n".join([*text, "endsolid spike"]) + "\n")
    design = FingerDesign(indenter=Indenter(shape="mesh", file="spike.stl", position_mm=30.0))
    finger = finger_outline(design, tmp_path)
    assert finger.touch_mm == pytest.approx((2.0, 33.0), abs=0.01)  # the tip of the spike
    assert finger.indenter_height_mm == pytest.approx(12.0)
    bare = finger_outline(design)
    assert bare.indenter_mm is None
    assert bare.touch_mm == (0.0, 30.0)
    assert (pixels(finger_png(design, tmp_path)).size, pixels(finger_png(design)).size) > (0, 0)


def test_a_page_holds_drawing_and_view(scalar, tmp_path):
    design = FingerDesign(camera=SMALL)
    view = camera_view(design, tmp_path, scalar)
    page, drawing = pixels(finger_page_png(view)), pixels(finger_png(design))
    assert page.shape[0] == pytest.approx(drawing.shape[0] + 4.8 * 120, abs=1)


def press_records(depth_mm, unreached=""):
    design = FingerDesign(indenter=Indenter(depth_mm=depth_mm))
    surfaces = store_shapes(rest_shape(design), pressed_shape(design), "press")
    depth = np.array([0.5, 1.0]) * (depth_mm if not unreached else 0.8 * depth_mm)
    mechanics = PressMechanics(
        name="press", label="analytic", preset="coarse", depth_mm=depth, force_n=np.outer(depth, [0.0, 2.0, 0.0]),
        energy_n_mm=depth**2, iterations=np.array([3, 4]), largest_pressure_mpa=0.1, unreached=unreached, design=design,
    )  # fmt: skip
    return mechanics, surfaces


def test_the_report_of_the_demo_shows_the_pressed_finger_and_what_nobody_measured():
    mechanics, surfaces = press_records(3.0)
    bare = example_results()
    results = replace(bare, mechanics=mechanics, surfaces=surfaces)
    simulated, compared = simulate_section(results), compare_section(results)
    assert "6.00 N at a push of 3 mm. No measurement has confirmed this force" in simulated.lead
    assert simulated.picture_rows[0][0].source.startswith("data:image/png;base64,")
    assert "so the score does not test the mechanics" in compared.lead
    assert len(simulate_section(bare).picture_rows) == len(simulated.picture_rows) - 1
    assert "mechanics" not in compare_section(bare).lead


def test_a_deeper_press_is_seen_and_a_push_that_ended_early_is_marked():
    shallow, deep = (pixels(pressed_finger_png(*press_records(depth))) for depth in (0.5, 3.0))
    assert shallow.shape == deep.shape == (1056, 1560, 3)
    assert (shallow != deep).any(axis=-1).mean() > 0.01
    vermillion = np.array([0x00, 0x5E, 0xD5])

    def marked(picture):
        return (picture == vermillion).all(axis=-1).sum()

    early = pixels(pressed_finger_png(*press_records(3.0, "no equilibrium")))
    assert marked(deep) == 0
    assert marked(early) > 50


@pytest.mark.parametrize(("wall", "is_seen"), [("red", True), ("green", False)])
def test_the_pressed_finger_is_seen_from_the_side_from_which_z_runs_to_the_right(wall, is_seen):
    """With y up, right x up points to the viewer: z x y = -x, where the red wall is; else the picture is mirrored."""
    rest = rest_shape(FingerDesign())
    surface = rest.surfaces[wall]
    is_inside = (np.abs(surface.uv - 0.5) < 0.4999).all(axis=1, keepdims=True)  # the gel stays closed
    bulged = replace(surface, vertices_mm=surface.vertices_mm + is_inside * (0.5, 0.0, 0.0))
    shown = _draw_after(Figure().subplots(), rest, replace(rest, surfaces={**rest.surfaces, wall: bulged}))
    assert shown.get_array().max() == pytest.approx(0.5 * is_seen)


def test_names_with_dollar_signs_are_shown_and_not_read_as_mathematics():
    mechanics, surfaces = press_records(1.0)
    assert pressed_finger_png(mechanics.model_copy(update={"name": "gel $5 {a$"}), surfaces)


def curve(mechanics):
    axes = Figure().subplots()
    _draw_curve(axes, mechanics)
    return axes


def test_the_curve_of_a_press_to_a_force_marks_the_force_that_was_wanted():
    mechanics, _ = press_records(3.0, "no equilibrium")
    of_force = curve(mechanics.model_copy(update={"wanted_force_n": 9.0}))
    for axes, said in ((curve(mechanics), "requested push, 3 mm"), (of_force, "requested force, 9 N")):
        (label,) = (text.get_text() for text in axes.get_legend().get_texts())
        assert said in label
    assert list(of_force.lines[-1].get_ydata()) == [9.0, 9.0]


def test_the_curve_shows_a_force_that_is_not_the_finger_s():
    mechanics, _ = press_records(3.0)
    assert curve(mechanics).get_ylim()[0] == 0.0
    assert curve(mechanics).get_title() == "6.00 N at 3.00 mm"
    pulled = curve(mechanics.model_copy(update={"force_n": -mechanics.force_n}))
    assert pulled.get_ylim()[0] < -6.0
    assert "the indenter touches no node or has passed through" in pulled.get_title()
