"""What is pressed into a classic sensor: bodies, imprints against the analytic press, height maps, meshes, refusals."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from data_schemas import CameraBelow, CoatSurface, GelPad, Indenter, PlainSensor, SimulateError
from sim.experiments import pressed_coat, simulate_sensor_press
from sim.optics import analytic_gel
from sim.surface_meshes import height_over_pad_mm, imprinted_height_mm, stl_bytes
from tests.command_line.mistakes import CUBE, FACETS

PAD = GelPad(length_mm=20.0, width_mm=16.0, thickness_mm=4.0)
BALL = Indenter(shape="ball", radius_mm=4.0, depth_mm=0.8, position_mm=12.0, across_mm=1.5)
SENSOR = PlainSensor(pad=PAD, indenter=BALL, camera=CameraBelow(width_px=24, height_px=24, field_of_view_deg=22.0))


def with_surface(**fields):
    return SENSOR.model_copy(update={"surface": CoatSurface(**fields)})


def ball_facets(radius_mm, count=80):
    """Corners (n, 3, 3) of a ball about the origin, outward."""
    polar, azimuth = np.linspace(0.0, np.pi, count), np.linspace(0.0, 2.0 * np.pi, 2 * count)
    p, a = np.meshgrid(polar, azimuth, indexing="ij")
    points = radius_mm * np.stack([np.sin(p) * np.cos(a), np.cos(p), np.sin(p) * np.sin(a)], axis=-1)
    q = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.concatenate(
        [np.stack([q[0], q[2], q[1]], -2).reshape(-1, 3, 3), np.stack([q[0], q[3], q[2]], -2).reshape(-1, 3, 3)]
    )


class TestIndenters:
    def test_of_a_ball_is_the_analytic_press(self):
        gel = analytic_gel(SENSOR, True)
        rest = analytic_gel(SENSOR, False)
        centre = np.array([BALL.across_mm, PAD.thickness_mm - BALL.depth_mm + BALL.radius_mm, BALL.position_mm])
        tool = height_over_pad_mm(ball_facets(4.0) + centre, gel.x_mm, gel.z_mm, "lowest")
        found = imprinted_height_mm(rest.height_mm, tool, gel.x_mm, gel.z_mm, PAD.thickness_mm)
        # the rim of the contact is found to a step of the grid (0.15 mm), at a slope of 0.6
        assert np.abs(found - gel.height_mm).max() < 0.06
        assert np.abs(found - gel.height_mm).mean() < 0.003
        volume = np.trapezoid(np.trapezoid(rest.height_mm - found, gel.z_mm, axis=1), gel.x_mm)
        assert abs(volume) < 1e-9 * PAD.length_mm * PAD.width_mm

    @pytest.mark.parametrize(
        "indenter",
        [
            Indenter(shape="cuboid", size_mm=(6.0, 4.0, 3.0), edge_radius_mm=0.5, depth_mm=0.7, position_mm=9.0),
            Indenter(shape="cylinder", radius_mm=3.0, rotation_deg=(0.0, 35.0, 0.0), depth_mm=0.7, position_mm=9.0),
        ],
        ids=["cuboid", "turned cylinder"],
    )
    def test_other_bodies_press_an_elastic_layer_to_their_depth(self, indenter):
        coat = pressed_coat(SENSOR.model_copy(update={"indenter": indenter}))
        depth = coat.rest.height_mm - coat.pressed.height_mm
        # facets of the turned cylinder lie up to 0.004 mm inside it
        assert depth.max() == pytest.approx(0.7, abs=6e-3)
        at = np.abs(coat.rest.x_mm).argmin(), np.abs(coat.rest.z_mm - 9.0).argmin()
        assert depth[at] == pytest.approx(0.7, abs=6e-3)
        # the gel goes aside; of the cylinder's bulge much lies beyond the pad, whose ends the layer does not know
        assert -0.3 < depth.min() < -0.02
        assert 0.3 < -depth[depth < 0.0].sum() / depth[depth > 0.0].sum() <= 1.0
        assert coat.label == f"elastic layer under a {indenter.shape}"
        assert coat.distance[at] < 0.2

    def test_of_a_mesh(self, tmp_path):
        facets = np.arange(3 * len(ball_facets(4.0, 30))).reshape(-1, 3)
        corners = ball_facets(4.0, 30)
        keep = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1) > 1e-9
        (tmp_path / "ball.stl").write_bytes(stl_bytes(facets[: keep.sum()], corners[keep].reshape(-1, 3), "ball"))
        mesh = Indenter(shape="mesh", file="ball.stl", depth_mm=0.8, position_mm=12.0, across_mm=1.5)
        coat = pressed_coat(SENSOR.model_copy(update={"indenter": mesh}), tmp_path)
        assert coat.files == (tmp_path / "ball.stl",)
        whole = pressed_coat(SENSOR)
        # facets of 0.4 mm cut 0.01 mm off the ball, at a slope of 0.6 beside the contact
        assert np.abs(coat.pressed.height_mm - whole.pressed.height_mm).max() < 0.05

    def test_triangles_over_the_pad(self):
        x, z = np.linspace(-1.0, 1.0, 5), np.linspace(0.0, 2.0, 5)
        slope = np.array([[[-1.0, 0.0, 0.0], [1.0, 2.0, 0.0], [-1.0, 0.0, 2.0]]])
        height = height_over_pad_mm(slope, x, z, "lowest")
        known = x[:, None] + z[None, :] <= 1.0 + 1e-9
        np.testing.assert_allclose(height[known], np.broadcast_to((x + 1.0)[:, None], (5, 5))[known])
        assert np.isnan(height[~known]).all()
        two = np.concatenate([slope, slope + np.array([0.0, 3.0, 0.0])])
        np.testing.assert_allclose(height_over_pad_mm(two, x, z, "highest")[known], height[known] + 3.0)

    def test_a_mesh_of_too_many_layers(self):
        x = z = np.linspace(0.0, 1.0, 1001)
        layer = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
        with pytest.raises(
            SimulateError, match=r"covers the pad 30 times, which is too often; give a mesh with fewer layers"
        ):
            height_over_pad_mm(np.repeat(layer, 30, axis=0), x, z, "lowest")

    def test_a_body_that_covers_the_pad(self):
        x, z = np.linspace(-8.0, 8.0, 41), np.linspace(0.0, 20.0, 51)
        rest = np.full((41, 51), 4.0)
        with pytest.raises(SimulateError, match="covers the pad from end to end and leaves no free face"):
            imprinted_height_mm(rest, np.full((41, 51), 3.5), x, z, 4.0)
        np.testing.assert_array_equal(imprinted_height_mm(rest, np.full((41, 51), np.nan), x, z, 4.0), rest)

    def test_a_body_that_goes_through_the_pad(self):
        cuboid = Indenter(shape="cuboid", size_mm=(3.0, 9.0, 3.0), edge_radius_mm=0.5, depth_mm=4.5, position_mm=9.0)
        with pytest.raises(
            SimulateError, match=r"= 4\.5 mm goes through the pad, .* reduce indenter.depth_mm to at most 3\.95 mm"
        ):
            pressed_coat(SENSOR.model_copy(update={"indenter": cuboid}))

    def test_a_body_larger_than_the_pad(self):
        cuboid = Indenter(shape="cuboid", size_mm=(40.0, 3.0, 60.0), edge_radius_mm=0.5, depth_mm=0.5, position_mm=9.0)
        with pytest.raises(SimulateError, match="the cuboid covers the pad from end to end"):
            pressed_coat(SENSOR.model_copy(update={"indenter": cuboid}))

    def test_the_depth_counts_from_first_touch_beside_the_crown_too(self, tmp_path):
        round_pad = GelPad(shape="cylindrical", radius_mm=12.0, length_mm=20.0, width_mm=16.0, thickness_mm=4.0)
        beside = BALL.model_copy(update={"across_mm": 5.0, "depth_mm": 0.5})
        coat = pressed_coat(SENSOR.model_copy(update={"pad": round_pad, "indenter": beside}))
        assert (coat.rest.height_mm - coat.pressed.height_mm).max() == pytest.approx(0.5, abs=0.01)

    def test_nothing_pressed_in(self):
        coat = pressed_coat(SENSOR.model_copy(update={"indenter": BALL.model_copy(update={"depth_mm": 0.0})}))
        np.testing.assert_array_equal(coat.rest.height_mm, coat.pressed.height_mm)
        assert np.isnan(coat.distance).all()


class TestHeightMaps:
    @pytest.fixture
    def depth(self):
        """Depth of the analytic ball on the pad, as the camera sees it: rows against z, 0.1 mm apart."""
        gel = analytic_gel(SENSOR, True)
        x, z = np.linspace(-8.0, 8.0, 161), np.linspace(0.0, 20.0, 201)
        height = RectBivariateSpline(gel.x_mm, gel.z_mm, gel.height_mm)(x, z)
        return (4.0 - height).T[::-1]

    def test_a_map_of_depths_is_the_press(self, depth, tmp_path):
        np.save(tmp_path / "coat.npy", depth)
        coat = pressed_coat(with_surface(file="coat.npy", step_mm=0.1), tmp_path)
        at = np.unravel_index((coat.rest.height_mm - coat.pressed.height_mm).argmax(), coat.rest.height_mm.shape)
        assert coat.rest.x_mm[at[0]] == pytest.approx(1.5, abs=0.15)
        assert coat.rest.z_mm[at[1]] == pytest.approx(12.0, abs=0.15)
        assert np.abs(coat.pressed.height_mm[::1, 0] - 4.0).max() < 0.1
        assert coat.label == "coat from coat.npy"
        assert coat.files == (tmp_path / "coat.npy",)
        # the equal circle: half-width of the geometric contact is 2.4 mm; a tenth of the depth lies a little inside
        half = np.sqrt((coat.distance <= 1.0).mean() * 16.0 * 20.0 / np.pi)
        assert 1.8 < half < 2.6

    def test_heights_pictures_and_shifts(self, depth, tmp_path):
        cv2.imwrite(str(tmp_path / "coat.png"), np.rint(1000.0 * (4.0 - depth)).astype(np.uint16))
        np.save(tmp_path / "coat.npy", depth)
        by_map = pressed_coat(with_surface(file="coat.npy", step_mm=0.1), tmp_path).pressed.height_mm
        surface = {"file": "coat.png", "step_mm": 0.1, "unit_mm": 0.001, "holds": "height"}
        by_picture = pressed_coat(with_surface(**surface), tmp_path).pressed.height_mm
        assert np.abs(by_map - by_picture).max() < 6e-4
        patch = depth[20:140, 40:140]
        np.save(tmp_path / "patch.npy", np.where(np.pad(np.ones((116, 96)), 2), patch, 0.0) * (patch > 0.05))
        moved = pressed_coat(with_surface(file="patch.npy", step_mm=0.1, position_mm=8.0, across_mm=-2.0), tmp_path)
        at = np.unravel_index((4.0 - moved.pressed.height_mm).argmax(), moved.pressed.height_mm.shape)
        # in the patch the press lies 0.6 mm to +x and 0.05 mm to +z of its middle
        assert moved.rest.x_mm[at[0]] == pytest.approx(-2.0 + 1.5 - 0.95, abs=0.2)
        assert moved.rest.z_mm[at[1]] == pytest.approx(8.0 + 12.0 - 12.05, abs=0.2)

    def test_a_map_of_the_pad_s_size_holds_up_to_its_edges(self, tmp_path):
        # 50 steps of 0.29 mm about the middle, 7.25 mm, begin 9e-16 mm inside the pad
        np.save(tmp_path / "coat.npy", np.full((51, 51), 0.03))
        square = with_surface(file="coat.npy", step_mm=0.29).model_copy(
            update={"pad": GelPad(length_mm=14.5, width_mm=14.5, thickness_mm=4.0)}
        )
        coat = pressed_coat(square, tmp_path)
        np.testing.assert_allclose(coat.rest.height_mm - coat.pressed.height_mm, 0.03, rtol=1e-12)

    def test_a_mesh_of_the_coat(self, tmp_path):
        gel = analytic_gel(SENSOR, True)
        faces = gel.faces()["coat"]
        (tmp_path / "coat.stl").write_bytes(stl_bytes(faces.triangles, faces.vertices_mm, "coat"))
        coat = pressed_coat(with_surface(file="coat.stl"), tmp_path)
        # single precision in the file, and triangles between the same places
        np.testing.assert_allclose(coat.pressed.height_mm, gel.height_mm, atol=1e-5)

    @pytest.mark.parametrize(
        ("values", "fields", "message"),
        [
            (np.zeros(5), {}, r"rows and 2 columns, got shape \(5,\)"),
            (np.full((200, 200), np.nan), {}, "finite numbers in at least 2 rows"),
            (np.full((30, 30), 0.5), {}, r"ends on the pad with a step of 0\.5 mm, but at most 0\.05 mm"),
            (np.full((400, 400), 800.0), {}, r"reaches down to -796 mm above .*; check unit_mm"),
            (
                np.full((400, 400), 4.0),
                {"position_mm": 900.0},
                "the map does not lie on the pad; correct surface.position_mm",
            ),
        ],
    )
    def test_refusals(self, tmp_path, values, fields, message):
        np.save(tmp_path / "coat.npy", values)
        with pytest.raises(SimulateError, match=message):
            pressed_coat(with_surface(file="coat.npy", step_mm=0.1, **fields), tmp_path)

    def test_files_that_are_none(self, tmp_path):
        with pytest.raises(SimulateError, match="no such file; give the path of a height map"):
            pressed_coat(with_surface(file="coat.npy", step_mm=0.1), tmp_path)
        cv2.imwrite(str(tmp_path / "coat.png"), np.zeros((8, 8, 3), np.uint8))
        png = {"file": "coat.png", "step_mm": 0.1, "unit_mm": 0.01}
        with pytest.raises(SimulateError, match=r"coat.png: holds 3 channels, but a height map must be a grey PNG"):
            pressed_coat(with_surface(**png), tmp_path)
        (tmp_path / "coat.png").write_bytes(b"no picture")
        with pytest.raises(SimulateError, match=r"coat.png: cannot be decoded"):
            pressed_coat(with_surface(**png), tmp_path)
        (tmp_path / "coat.stl").write_bytes(stl_bytes(FACETS, CUBE, "cube"))
        with pytest.raises(
            SimulateError, match=r"covers only \d+ % of the pad, but a mesh of the coat must cover all of it"
        ):
            pressed_coat(with_surface(file="coat.stl"), tmp_path)
        (tmp_path / "coat.stl").write_bytes(b"no mesh")
        with pytest.raises(SimulateError, match="neither a binary nor a text STL file"):
            pressed_coat(with_surface(file="coat.stl"), tmp_path)


def test_a_record_of_a_press(scalar, tmp_path):
    press, files = simulate_sensor_press(SENSOR, tmp_path, scalar, 1, 2)
    assert files == ()
    assert press.sensor == SENSOR
    assert press.design is None
    assert press.contact.shape == (24, 24, 3)
    assert (press.distance <= 1.0).sum() > 10
    away = SENSOR.model_copy(update={"camera": CameraBelow(tilt_deg=80.0, width_px=8, height_px=8)})
    with pytest.raises(SimulateError, match=r"the camera does not see the coat; check camera\.distance_mm"):
        simulate_sensor_press(away, Path(), scalar, 1, 2)
