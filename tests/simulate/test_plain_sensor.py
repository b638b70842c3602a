"""Classic sensors: against Mitsuba's own path tracer, mirrored geometry, and which slope of a dent each light finds."""

import numpy as np
import pytest
from scipy.stats import t as student_t

from data_schemas import (
    CHANNELS,
    CameraBelow,
    ColouredLight,
    FieldError,
    Film,
    GelPad,
    Indenter,
    PlainSensor,
    SimulateError,
)
from sim.optics import plain_sensor_integrator, plain_sensor_scene, render_plain_sensor
from sim.optics._plain_sensor import light_frame

CAMERA = CameraBelow(width_px=32, height_px=32, field_of_view_deg=27.0)
BALL = Indenter(shape="ball", radius_mm=4.0, depth_mm=1.0, position_mm=10.0)
DOME = GelPad(shape="ellipsoidal", length_mm=20.0, width_mm=20.0, thickness_mm=5.0, semi_axes_mm=(22.0, 14.0, 22.0))
SEEDS = 6
FALSE_ALARM = 0.01


def equal_means(one, other):
    """Compare (seed, value) samples by Welch's test, all values together at the stated rate of false alarms."""
    error = np.sqrt((one.var(axis=0, ddof=1) + other.var(axis=0, ddof=1)) / len(one))
    quantile = student_t.ppf(1.0 - FALSE_ALARM / (2.0 * one.shape[1]), df=len(one) - 1)
    return (np.abs(one.mean(axis=0) - other.mean(axis=0)) < quantile * error).all()


def blocks(image, count=4):
    """Means over a grid of blocks, flat."""
    size = image.shape[0] // count
    return image.reshape(count, size, count, size, 3).mean(axis=(1, 3))


def renders(renderer, scene, integrator, seeds, samples_per_pixel):
    return [np.array(renderer.render(scene, integrator=integrator, spp=samples_per_pixel, seed=seed)) for seed in seeds]


@pytest.mark.renderer
@pytest.mark.parametrize(
    ("walls", "pad"), [("dark", GelPad(length_mm=20.0, width_mm=20.0, thickness_mm=4.0)), ("clear", DOME)]
)
def test_the_connection_has_the_means_of_the_stock_path_tracer(llvm, walls, pad):
    wide = ColouredLight(channel="red", width_mm=24.0, height_mm=16.0, depth_mm=16.0, distance_mm=18.0)
    side = ColouredLight(
        channel="blue", azimuth_deg=90.0, angle_deg=60.0, width_mm=20.0, height_mm=12.0, depth_mm=14.0, power_rel=2.0
    )
    sensor = PlainSensor(pad=pad, walls=walls, wall_reflectance=0.6, lights=(wide, side), camera=CAMERA, indenter=BALL)
    scene = plain_sensor_scene(sensor, llvm)
    ours = renders(llvm, scene, plain_sensor_integrator(scene, sensor, llvm), range(SEEDS), 32)
    stock = renders(llvm, scene, scene.integrator(), range(100, 100 + SEEDS), 256)
    one, other = (np.array([blocks(image, 2)[..., [0, 2]].ravel() for image in images]) for images in (ours, stock))
    assert max(np.abs(x.std(axis=0, ddof=1) / x.mean(axis=0)).max() for x in (one, other)) < 0.15  # can tell
    assert equal_means(one, other)
    assert all(image[..., 1].max() == 0.0 for image in ours)


@pytest.mark.renderer
@pytest.mark.parametrize("axis", ["x", "z"])
def test_mirrored_geometry_gives_the_mirrored_image(llvm, axis):
    lights = {"red": 20.0, "green": 75.0, "blue": -130.0}
    ball = BALL.model_copy(update={"position_mm": 7.0})
    sensor = PlainSensor(
        lights=tuple(ColouredLight(channel=c, azimuth_deg=a) for c, a in lights.items()), camera=CAMERA, indenter=ball
    )
    turned = {c: -a if axis == "x" else 180.0 - a if a > 0.0 else -180.0 - a for c, a in lights.items()}
    mirrored = sensor.model_copy(
        update={
            "lights": tuple(ColouredLight(channel=c, azimuth_deg=a) for c, a in turned.items()),
            "indenter": ball if axis == "x" else ball.model_copy(update={"position_mm": 13.0}),
        }
    )
    found = []
    for one, seeds in ((sensor, range(SEEDS)), (mirrored, range(50, 50 + SEEDS))):
        scene = plain_sensor_scene(one, llvm)
        found.append(renders(llvm, scene, plain_sensor_integrator(scene, one, llvm), seeds, 32))
    back = [image[:, ::-1] if axis == "x" else image[::-1] for image in found[1]]
    assert equal_means(*(np.array([blocks(i).ravel() for i in images]) for images in (found[0], back)))
    assert not equal_means(*(np.array([blocks(i).ravel() for i in images]) for images in found))


@pytest.mark.renderer
def test_each_light_is_brightest_on_the_slope_that_faces_it(llvm):
    sensor = PlainSensor(camera=CAMERA, indenter=BALL)
    image = render_plain_sensor(sensor, llvm, seed=3, samples_per_pixel=256)
    rows, columns = np.mgrid[:32, :32] + 0.5
    x, z = columns / 16.0 - 1.0, 1.0 - rows / 16.0
    ring = (np.hypot(x, z) > 0.06) & (np.hypot(x, z) < 0.26)  # the dent's half-width is 2.6 mm of 10 mm
    gain = image.contact / image.no_contact
    for light in sensor.lights:
        channel, azimuth = CHANNELS.index(light.channel), np.radians(light.azimuth_deg)
        from_light = -(x * np.sin(azimuth) + z * np.cos(azimuth)) / np.hypot(x, z)
        facing, away = (gain[..., channel][ring & (s * from_light > 0.5)] for s in (1, -1))
        error = np.hypot(*(g.std(ddof=1) / np.sqrt(g.size) for g in (facing, away)))
        assert facing.mean() > away.mean() + 5.0 * error  # a false alarm once in a million


def test_lights_stand_behind_the_middle_and_shine_upward():
    sensor = PlainSensor()
    light = ColouredLight(channel="red", azimuth_deg=90.0, angle_deg=30.0, distance_mm=15.0, depth_mm=9.0)
    frame = light_frame(sensor, light)
    np.testing.assert_allclose(frame.centre_mm, [-15.0, -9.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(frame.normal, [np.sqrt(0.75), 0.5, 0.0], atol=1e-12)
    across, along = frame.half_across_mm, frame.half_along_mm
    np.testing.assert_allclose(np.cross(across, along), frame.normal * frame.area_mm2 / 4.0, atol=1e-9)


def test_a_scalar_variant_renders_too(scalar):
    sensor = PlainSensor(camera=CameraBelow(width_px=8, height_px=8))
    image = render_plain_sensor(sensor, scalar, samples_per_pixel=4)
    assert image.contact.shape == (8, 8, 3)
    assert np.isfinite(image.contact).all()
    assert image.variant == "scalar_rgb"


def test_refusals(scalar):
    with pytest.raises(SimulateError, match="even number of at least 2"):
        render_plain_sensor(PlainSensor(), scalar, samples_per_pixel=3)
    with pytest.raises(SimulateError, match="a film on the inner face is not supported"):
        plain_sensor_scene(PlainSensor(pad=DOME.model_copy(update={"film": Film()})), scalar)
    narrow = PlainSensor(lights=(ColouredLight(channel="red", beam_exponent=4.0),))
    with pytest.raises(SimulateError, match=r"lights\.beam_exponent: scalar_rgb supports only Lambertian lights"):
        render_plain_sensor(narrow, scalar, samples_per_pixel=2)
    with pytest.raises(FieldError, match=r"it must be more than 1\.53 mm"):
        ColouredLight(channel="red", depth_mm=1.0)
    deep = PlainSensor(indenter=BALL.model_copy(update={"depth_mm": 5.0}))
    with pytest.raises(SimulateError, match="goes through the pad"):
        plain_sensor_scene(deep, scalar)
    with pytest.raises(FieldError, match="must lie on the pad"):
        PlainSensor(indenter=BALL.model_copy(update={"position_mm": 21.0}))
