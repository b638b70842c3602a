"""Light in classic sensors against what owes nothing to the renderer: a furnace, a point of light, photons in slabs."""

from pathlib import Path

import numpy as np
import pytest

from data_schemas import CameraBelow, ColouredLight, GelPad, Indenter, PlainSensor, SensorCoat, TranslucentLayer
from sim import SENSORS, preset_sensor
from sim.experiments import pressed_coat, simulate_sensor_press
from sim.experiments._sensor_layers import _presses_over
from sim.experiments._sensor_press import _seen
from sim.optics import (
    analytic_gel,
    light_frame,
    plain_sensor_integrator,
    plain_sensor_scene,
    render_plain_sensor,
    seen_places_mm,
    sensor_calibration,
    sensor_pose,
)
from sim.optics._plain_sensor import light_colours

FLAT = GelPad(length_mm=16.0, width_mm=16.0, thickness_mm=4.0)
DOME = GelPad(shape="ellipsoidal", length_mm=16.0, width_mm=16.0, thickness_mm=5.0, semi_axes_mm=(16.0, 10.0, 16.0))
BALL = Indenter(shape="ball", radius_mm=4.0, depth_mm=1.0, position_mm=8.0)
SMALL = CameraBelow(width_px=16, height_px=16, field_of_view_deg=20.0)
DARK = {"wall_reflectance": 0.0, "box_reflectance": 0.0, "panel_reflectance": 0.0}


@pytest.mark.renderer
@pytest.mark.parametrize("pad", [FLAT, DOME], ids=["flat", "dome"])
def test_a_white_furnace_is_white(llvm, pad):
    """Panels all around below, and nothing that absorbs: every point shines as the panels do, the dent too.

    Paths end at 30 surfaces; in a gel that absorbs nothing, whose white walls are half of its surface, that cuts off
    0.5 to 0.9 % of the light (Mitsuba's own ``path`` to the same depth: 0.9913 +- 0.0007).
    """
    floor = ColouredLight(
        channel="white", angle_deg=90.0, distance_mm=0.0, depth_mm=40.45, width_mm=48.0, height_mm=48.0
    )
    side = ColouredLight(
        channel="white", angle_deg=0.0, distance_mm=24.0, depth_mm=20.25, width_mm=48.0, height_mm=40.4
    )
    sides = (side.model_copy(update={"azimuth_deg": azimuth}) for azimuth in (0.0, 90.0, 180.0, -90.0))
    sensor = PlainSensor(
        pad=pad, wall_reflectance=1.0, box_reflectance=1.0, panel_reflectance=0.0, lights=(floor, *sides),
        coating=SensorCoat(diffuse_share=1.0, diffuse_reflectance=1.0), indenter=BALL,
        camera=CameraBelow(distance_mm=30.0, width_px=8, height_px=8, field_of_view_deg=24.0),
    )  # fmt: skip
    scene = plain_sensor_scene(sensor, llvm)
    integrator = plain_sensor_integrator(scene, sensor, llvm)
    means = np.array(
        [np.array(llvm.render(scene, integrator=integrator, spp=256, seed=k)).mean(axis=(0, 1)) for k in range(8)]
    )
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    assert error.max() < 2e-3  # can tell
    # 1 % for the paths that end at 30 surfaces
    assert (np.abs(means.mean(axis=0) - 1.0) < 0.01 + 4.0 * error).all()


def point_light_radiance(offset_mm, depth_mm, sensor, power, normal):
    """Radiance above the face, through which it is looked at straight, of a coat lit by a point in air.

    Flux is conserved along each bundle of rays: E = I T sin(a) da / (r dr) for the angle a in air, which meets the coat
    at r = depth tan a + thickness tan g. No Hessian, no path is searched.
    """
    index, thickness = sensor.pad.refractive_index, sensor.pad.thickness_mm
    a = np.linspace(1e-4, np.radians(89.0), 200_001)
    g = np.arcsin(np.sin(a) / index)
    r = depth_mm * np.tan(a) + thickness * np.tan(g)
    s = ((np.cos(a) - index * np.cos(g)) / (np.cos(a) + index * np.cos(g))) ** 2
    p = ((index * np.cos(a) - np.cos(g)) / (index * np.cos(a) + np.cos(g))) ** 2
    spread = np.gradient(r, a) * r / np.sin(a)
    lateral = np.hypot(offset_mm[..., 0], offset_mm[..., 1])
    angle = np.interp(lateral, r, a)
    away = offset_mm / np.maximum(lateral, 1e-12)[..., None]
    towards = np.stack([away[..., 0] * np.sin(angle), np.cos(angle), away[..., 1] * np.sin(angle)], axis=-1)
    lit = power * np.maximum(towards @ normal, 0.0) * np.interp(lateral, r, (1.0 - 0.5 * (s + p)) / spread)
    straight = 1.0 - ((index - 1.0) / (index + 1.0)) ** 2
    return sensor.coating.diffuse_reflectance / np.pi * lit * straight / index**2


@pytest.mark.renderer
def test_a_point_of_light_under_a_flat_gel_in_closed_form(llvm):
    """The coat reflects 0.1 %, so that what it sees of itself changes nothing; the camera sees straight from afar."""
    led = ColouredLight(
        channel="green", azimuth_deg=30.0, angle_deg=50.0, turn_deg=15.0, distance_mm=9.0, depth_mm=8.0, width_mm=0.4,
        height_mm=0.4, power_rel=50.0,
    )  # fmt: skip
    sensor = PlainSensor(
        pad=FLAT, lights=(led,), coating=SensorCoat(diffuse_share=1.0, diffuse_reflectance=1e-3),
        camera=CameraBelow(distance_mm=400.0, field_of_view_deg=5.0, width_px=32, height_px=32), **DARK,
    )  # fmt: skip
    sensor = sensor.model_copy(update={"indenter": sensor.indenter.model_copy(update={"depth_mm": 0.0})})
    image = render_plain_sensor(sensor, llvm, seed=5, samples_per_pixel=64)
    places = seen_places_mm(sensor, analytic_gel(sensor, False), llvm)
    frame = light_frame(sensor, led)
    offset = places - frame.centre_mm[[0, 2]]
    wanted = point_light_radiance(offset, led.depth_mm, sensor, led.power_rel * frame.area_mm2, frame.normal)
    # pixels whose square lies on the pad
    inside = (np.abs(places[..., 0]) < 7.0) & (np.abs(places[..., 1] - 8.0) < 7.0)
    ratio = image.no_contact[..., 1][inside] / wanted[inside]
    error = ratio.std(ddof=1) / np.sqrt(ratio.size)
    assert inside.sum() > 100
    assert error < 2e-3
    assert abs(ratio.mean() - 1.0) < 5e-3 + 4.0 * error
    assert np.abs(ratio - 1.0).max() < 0.1  # everywhere, not in the mean
    assert image.no_contact[..., [0, 2]].max() == 0.0


def slab_reflectance(layer, thickness_mm, rays, rng):
    """Reflectance for diffuse light of an isotropically scattering slab before a dark ground, by following photons.

    With isotropic scattering sigma_s = 4 S / 3 and sigma_a = K / 2 (P. S. Mudgett, L. W. Richards, 1971).
    """
    scatter, absorb = 4.0 / 3.0 / layer.scattering_length_mm, 0.5 / layer.absorption_length_mm
    mu, depth, weight = np.sqrt(rng.random(rays)), np.zeros(rays), np.ones(rays)
    back = 0.0
    while len(weight):
        depth = depth - np.log(rng.random(len(depth))) / (scatter + absorb) * mu
        out, ground = depth <= 0.0, depth >= thickness_mm
        back += weight[out].sum()
        weight = np.where(ground, weight * layer.backing_reflectance, weight * scatter / (scatter + absorb))
        mu = np.where(ground, -np.sqrt(rng.random(len(mu))), 2.0 * rng.random(len(mu)) - 1.0)
        depth = np.minimum(depth, thickness_mm)
        kept = ~out & (weight > 1e-6)
        mu, depth, weight = mu[kept], depth[kept], weight[kept]
    return back / rays


@pytest.mark.parametrize("thickness_mm", [0.2, 1.0, 2.5, 8.0])
@pytest.mark.parametrize(
    "layer",
    [
        TranslucentLayer(scattering_length_mm=8.3, absorption_length_mm=1e5, backing_reflectance=0.02),
        TranslucentLayer(scattering_length_mm=1.0, absorption_length_mm=20.0, backing_reflectance=0.3),
    ],
)
def test_a_translucent_layer_is_near_what_photons_do(layer, thickness_mm):
    """Kubelka and Munk's two fluxes are no exact transport: 0.03 is how far they stay from it for diffuse light."""
    found = slab_reflectance(layer, thickness_mm, 40_000, np.random.default_rng(3))
    assert layer.reflectance(np.array([thickness_mm]))[0] == pytest.approx(found, abs=0.03)


def test_a_translucent_layer_in_its_limits():
    layer = TranslucentLayer(scattering_length_mm=2.0, absorption_length_mm=1e6, backing_reflectance=0.1)
    thin, thick = layer.reflectance(np.array([0.0, 1e5]))
    assert thin == pytest.approx(0.1)
    assert 0.99 < thick <= 1.0
    # without absorption and ground: S t / (1 + S t)
    clear = layer.model_copy(update={"backing_reflectance": 0.0})
    assert clear.reflectance(np.array([3.0]))[0] == pytest.approx(1.5 / 2.5, rel=1e-3)


@pytest.mark.renderer
def test_nine_dtact_darkens_with_depth_and_brightens_beside_it(llvm):
    """As its published picture of a ball, 1.92 mm deep: green there, made linear by sRGB, over that without contact.

    The picture gives 0.39 within 0.5 mm of the middle, 0.43 at 1 mm, 0.55 at 2 mm and 1.1 to 1.3 from 3.8 to 6 mm.
    """
    sensor = preset_sensor("9dtact")
    small = sensor.camera.model_copy(update={"width_px": 64, "height_px": 48})
    press, _ = simulate_sensor_press(sensor.model_copy(update={"camera": small}), Path(), llvm, 2, 128)
    ratio, distance = press.contact[..., 1] / press.no_contact[..., 1], press.distance * 3.42  # half-width in mm
    for low, high, wanted in ((0.0, 0.7, 0.40), (0.7, 1.4, 0.44), (1.6, 2.4, 0.55)):
        here = (distance >= low) & (distance < high)
        assert ratio[here].mean() == pytest.approx(wanted, rel=0.15)
    halo = (distance > 3.9) & (distance < 6.0)
    assert 1.02 < np.median(ratio[halo]) < 1.4


@pytest.mark.renderer
@pytest.mark.parametrize("name", ["gelsight-flat", "digit", "gelsight-wedge"])
def test_each_light_of_a_ready_made_sensor_finds_the_slope_that_faces_it(llvm, name):
    sensor = preset_sensor(name)
    camera = sensor.camera
    small = camera.model_copy(update={"width_px": 80, "height_px": 80 * camera.height_px // camera.width_px})
    sensor = sensor.model_copy(update={"camera": small})
    press, _ = simulate_sensor_press(sensor, Path(), llvm, 4, 128)
    coat = pressed_coat(sensor)
    places = seen_places_mm(sensor, coat.pressed, llvm)
    x, z = places[..., 0] - sensor.indenter.across_mm, places[..., 1] - sensor.indenter.position_mm
    ring = (press.distance > 0.3) & (press.distance < 0.95)
    x, z, gain = x[ring], z[ring], press.contact[ring] / press.no_contact[ring]
    for light in sensor.lights:
        azimuth, channel = np.radians(light.azimuth_deg), ("red", "green", "blue").index(light.channel)
        towards = -(x * np.sin(azimuth) + z * np.cos(azimuth)) / np.hypot(x, z)
        facing, away = (gain[side * towards > 0.5, channel] for side in (1, -1))
        assert facing.size > 10
        error = np.hypot(*(g.std(ddof=1) / np.sqrt(g.size) for g in (facing, away)))
        assert facing.mean() > away.mean() + 4.0 * error


def test_a_straight_camera_sees_what_snell_says(scalar):
    """Two ways: triangles and bent rays here, the plane and a spline of the dent in the export for Taxim."""
    sensor = PlainSensor(pad=FLAT, camera=SMALL, indenter=BALL)
    _, wanted = _seen(sensor, sensor.pressed_pad())
    coat = pressed_coat(sensor)
    places = seen_places_mm(sensor, coat.pressed, scalar)
    found = np.hypot(places[..., 0], places[..., 1] - 8.0) / np.sqrt(2.0 * 4.0 * 1.0 - 1.0)
    np.testing.assert_allclose(found, wanted, atol=0.01)


def test_a_turned_camera_looks_where_it_is_turned():
    camera = CameraBelow(
        distance_mm=30.0, across_mm=2.0, along_mm=-3.0, tilt_deg=20.0, pan_deg=-10.0, roll_deg=90.0, width_px=40,
        height_px=20,
    )  # fmt: skip
    pose = sensor_pose(PlainSensor(camera=camera))
    np.testing.assert_allclose(pose.centre_mm, [2.0, -30.0, 7.0])
    axes = np.stack([pose.right, pose.down, pose.forward])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert np.degrees(np.arcsin(pose.forward[2])) == pytest.approx(20.0)
    assert np.degrees(np.arctan2(pose.forward[0], pose.forward[1])) == pytest.approx(-10.0)
    # a quarter of a turn: what was down in the picture, against z, is now to the right
    assert pose.right[2] < -0.9
    assert pose.tan_half_height == pytest.approx(pose.tan_half_width / 2.0)


@pytest.mark.renderer
def test_a_press_is_seen_where_its_map_says_with_a_turned_camera(llvm):
    camera = CameraBelow(
        distance_mm=30.0, tilt_deg=12.0, along_mm=-6.0, pan_deg=-8.0, across_mm=4.0, roll_deg=35.0, width_px=40,
        height_px=40, field_of_view_deg=28.0,
    )  # fmt: skip
    ball = BALL.model_copy(update={"position_mm": 10.0, "across_mm": 2.0})
    lights = tuple(
        ColouredLight(channel="white", azimuth_deg=a, angle_deg=60.0, depth_mm=12.0, width_mm=6.0) for a in (0.0, 180.0)
    )
    press, _ = simulate_sensor_press(
        PlainSensor(pad=FLAT, camera=camera, indenter=ball, lights=lights), Path(), llvm, 1, 64
    )
    change = np.abs(press.contact - press.no_contact)[..., 0] / np.median(press.no_contact[..., 0])
    rows, columns = np.mgrid[:40, :40]
    weights = np.where(change > 0.3 * np.percentile(change, 99.0), change, 0.0)
    shown = np.array([np.average(rows, weights=weights), np.average(columns, weights=weights)])
    inside = press.distance <= 1.0
    said = np.array([rows[inside].mean(), columns[inside].mean()])
    assert inside.sum() > 50
    # a third of the contact's radius
    assert np.linalg.norm(shown - said) < np.sqrt(inside.sum() / np.pi) / 3.0


def test_a_calibrated_lens_takes_the_place_of_the_field_of_view(scalar, tmp_path):
    """A calibration without distortion is the pinhole; its own field counts, not the design's."""
    focal = 32.0 / np.tan(np.radians(20.0) / 2.0)
    (tmp_path / "lens.yaml").write_text(
        f"image_width: 64\nimage_height: 64\ncamera_matrix: [{focal}, 0, 31.5, 0, {focal}, 31.5, 0, 0, 1]\n"
        "distortion_coefficients: [0, 0, 0, 0]\n"
    )
    ideal = PlainSensor(pad=FLAT, camera=SMALL, indenter=BALL)
    camera = SMALL.model_copy(update={"field_of_view_deg": 60.0, "calibration": "lens.yaml"})
    calibrated = ideal.model_copy(update={"camera": camera})
    gel = analytic_gel(ideal, True)
    found = seen_places_mm(calibrated, gel, scalar, sensor_calibration(calibrated, tmp_path))
    np.testing.assert_allclose(found, seen_places_mm(ideal, gel, scalar), atol=2e-3)
    image = render_plain_sensor(calibrated, scalar, 1, 2, folder=tmp_path)
    assert image.contact.shape == (16, 16, 3)


def test_colours_by_name_and_by_spectrum(tmp_path):
    lights = tuple(ColouredLight(channel=c, azimuth_deg=a) for c, a in (("red", 0.0), ("blue", 90.0), ("white", 180.0)))
    ideal = PlainSensor(lights=lights)
    np.testing.assert_array_equal(light_colours(ideal), [[1, 0, 0], [0, 0, 1], [1, 1, 1]])
    (tmp_path / "eye.csv").write_text(
        "wavelength_nm,red_percent,green_percent,blue_percent\n"
        + "".join(f"{w},{50 * (w >= 600)},{100 * (500 <= w < 600)},{25 * (w < 500)}\n" for w in range(380, 781, 10))
    )
    measured = ideal.model_copy(update={"camera": CameraBelow(response="eye.csv")})
    colours = light_colours(measured, tmp_path)
    # a red LED of 630 nm and 25 nm lies above 590 nm but for its tail; a response of 50 % of the largest
    np.testing.assert_allclose(colours[0], [0.5, 0.0, 0.0], atol=0.01)
    np.testing.assert_allclose(colours[1][2], 0.25, atol=0.01)
    assert (colours[2] > 0.02).all()
    assumed = light_colours(ideal.model_copy(update={"camera": CameraBelow(response="assumed")}))
    assert (assumed.argmax(axis=1)[:2] == [0, 2]).all()
    assert (assumed > 0.0).all()  # a real camera leaks


@pytest.mark.renderer
def test_powers_add_up(llvm):
    """Two lights of one channel are the sum of each: what a recombination of light bases needs."""
    one, other = (ColouredLight(channel="red", azimuth_deg=a, power_rel=p) for a, p in ((20.0, 1.0), (150.0, 3.0)))
    sums = []
    for lights in ((one,), (other,), (one, other)):
        image = render_plain_sensor(PlainSensor(pad=FLAT, camera=SMALL, indenter=BALL, lights=lights), llvm, 3, 256)
        values = image.contact[..., 0].astype(float)
        sums.append((values.mean(), np.sqrt(image.contact_variance[..., 0].astype(float).sum()) / values.size))
    (a, ea), (b, eb), (both, eab) = sums
    assert abs(both - a - b) < 4.0 * np.hypot(eab, np.hypot(ea, eb))
    assert eab < 0.02 * both


def test_presets_are_those_that_are_listed():
    assert list(SENSORS) == ["gelsight-flat", "digit", "9dtact", "gelsight-wedge"]
    for name in SENSORS:
        sensor = preset_sensor(name)
        assert sensor.name == name
        assert sensor.source
        assert sensor.origin


def test_presses_over_a_pad_are_at_places_of_their_own():
    """A cylinder reaches across the pad: beside the middle line it would be pressed twice at the same place."""
    for shape, count in (("ball", 5), ("cylinder", 3)):
        indenter = BALL.model_copy(update={"shape": shape})
        presses = _presses_over(PlainSensor(pad=FLAT, indenter=indenter))
        assert len({(one.indenter.across_mm, one.indenter.position_mm) for one in presses}) == len(presses) == count
