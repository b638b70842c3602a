"""The scene as Mitsuba sees it, against closed forms and against the package's own numpy optics."""

import numpy as np
import pytest

from data_schemas import Coating, FingerDesign, GelPad, LightPanel
from data_schemas._design_parts import Enclosure, Mirror, TactileCamera
from sim.optics import TEXELS_ALONG, camera_pose, paint_bands
from sim.optics._optical_layout import pixel_directions
from sim.optics._painted_walls import TEXELS_UP, texel_uv, wall_map
from sim.optics._path_rules import LedSearch
from sim.optics._scene import band_film, camera_sensor, finger_scene, panel_shape
from sim.surface_meshes import pressed_shape
from tests.simulate.closed_form_view import coat_positions
from tests.simulate.flat_refraction import refracted_irradiance

SMALL_CAMERA = TactileCamera(width_px=64, height_px=48)
# a false alarm of a right program: 0.3 % per comparison; seeds are fixed, so a pass stays a pass
STANDARD_ERRORS = 3.0


def bands_of(paints, design):
    return paint_bands(paints["red"], paints["green"], design.light)


def test_a_diffuse_patch_under_the_panel_has_radiance_rho_e_over_pi(scalar):
    light = LightPanel(angle_deg=60.0, position_mm=(0.0, -10.0, 20.0))
    transform = scalar.ScalarTransform4f
    # a white floor at y = 4 mm that faces the panel
    floor = transform().translate([0, 4, 30]).rotate([1, 0, 0], 90).scale(40)
    up_again = transform().look_at(origin=[0, 3, 30], target=[0, 4, 30], up=[1, 0, 0])
    scene = scalar.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "floor": {"type": "rectangle", "to_world": floor, "bsdf": {"type": "diffuse", "reflectance": 0.5}},
            "panel": panel_shape(light, scalar, 0.05),
            "sensor": {"type": "radiancemeter", "to_world": up_again, "film": band_film(1, 1)},
        }
    )
    halves = [np.array(scalar.render(scene, spp=4096, seed=k)).reshape(3)[2] for k in range(8)]
    air = GelPad(refractive_index=1.0)
    irradiance = refracted_irradiance(np.array([[0.0, 4.0, 30.0]]), np.array([[0.0, -1.0, 0.0]]), light, air)[0]
    standard_error = np.std(halves, ddof=1) / np.sqrt(len(halves))
    assert standard_error < 0.01 * np.mean(halves)
    assert abs(np.mean(halves) - 0.5 * irradiance / np.pi) < STANDARD_ERRORS * standard_error


def test_the_camera_of_the_scene_looks_where_the_position_map_says(scalar):
    design = FingerDesign(camera=SMALL_CAMERA)
    pose = camera_pose(design)
    directions = pixel_directions(pose)
    sensor = scalar.load_dict(camera_sensor(design, scalar))
    for row, column in ((0, 0), (3, 30), (23, 5), (12, 16)):
        at = [(column + 0.5) / pose.columns_px, (row + 0.5) / pose.rows_px]
        ray, _ = sensor.sample_ray(0.0, 0.5, at, [0.5, 0.5])
        np.testing.assert_allclose(np.array(ray.d), directions[row, column], atol=1e-5)  # float32


def test_the_position_map_follows_rays_through_the_rendered_meshes(scalar, paints):
    design = FingerDesign(camera=SMALL_CAMERA)
    scene = finger_scene(design, pressed_shape(design), bands_of(paints, design), scalar)
    pose, expected = camera_pose(design), coat_positions(design)
    directions = pixel_directions(pose)
    checked = 0
    for row, column in zip(*np.nonzero(np.isfinite(expected[..., 0])), strict=True):
        on_mirror = scene.ray_intersect(scalar.Ray3f(pose.centre_mm.tolist(), directions[row, column].tolist()))
        d, n = directions[row, column], np.array(on_mirror.sh_frame.n)
        d = d - 2.0 * (d @ n) * n
        at_face = scene.ray_intersect(on_mirror.spawn_ray(d.tolist()))
        inside = d / design.pad.index_at(design.light.peak_wavelength_nm)
        inside[1] = np.sqrt(1.0 - inside[0] ** 2 - inside[2] ** 2)
        on_coat = scene.ray_intersect(at_face.spawn_ray(inside.tolist()))
        # mesh facets of 0.1 mm (pad) and 0.3 mm (mirror) and float32 move a grazing ray by a few micrometres
        np.testing.assert_allclose(np.array(on_coat.p)[[2, 0]], expected[row, column], atol=0.03)
        checked += 1
    assert checked > 100


def test_the_pad_fills_a_good_part_of_the_frame_and_is_seen_to_both_ends():
    seen = coat_positions(FingerDesign())
    inside = np.isfinite(seen[..., 0])
    assert inside.mean() > 0.2
    assert np.nanmin(seen[..., 0]) < 1.0
    assert np.nanmax(seen[..., 0]) > 65.0
    assert np.nanmax(np.abs(seen[..., 1])) > 17.0


def test_the_panel_in_front_of_the_camera_hides_the_pad():
    def sees(position):
        return np.isfinite(coat_positions(FingerDesign(light=LightPanel(position_mm=position)))[..., 0]).sum()

    assert sees((0.0, -3.0, 30.0)) < sees((0.0, -3.0, 500.0))


@pytest.mark.parametrize("wall", ["red", "green"])
def test_wall_texels_lie_where_they_were_baked(scalar, paints, wall):
    design = FingerDesign(camera=SMALL_CAMERA)
    coded = {}
    for name in ("red", "green"):
        points = wall_map(pressed_shape(design), name).positions_mm(texel_uv())
        coded[name] = np.stack([points[..., 2] / 70.0, points[..., 1] / 10.0, np.ones((TEXELS_ALONG, TEXELS_UP))], -1)
    scene = finger_scene(design, pressed_shape(design), bands_of(paints, design), scalar, emission=coded)
    side = -1.0 if wall == "red" else 1.0
    for y, z in ((1.0, 10.0), (4.2, 35.0), (5.0, 60.0)):
        si = scene.ray_intersect(scalar.Ray3f([side * 16.0, y, z], [side, 0.0, 0.0]))
        value = np.array(si.emitter(scene).eval(si))
        assert np.array(si.p)[0] == pytest.approx(side * 17.5, abs=1e-4)
        # bilinear interpolation between rows of the pressed profile, texels of 0.5 mm
        np.testing.assert_allclose(value, [z / 70.0, y / 10.0, 1.0], atol=3e-3)


def black_finger(**changes):
    """A finger whose only bright thing is the panel: no coating, mirror or box returns light."""
    return FingerDesign(
        camera=SMALL_CAMERA,
        coating=Coating(diffuse_share=1.0, diffuse_reflectance=0.0),
        mirror=Mirror(reflectance=0.0),
        enclosure=Enclosure(cloth_reflectance=0.0, panel_reflectance=0.0),
        **changes,
    )


@pytest.mark.renderer
def test_refracted_irradiance_agrees_with_brute_force_paths(llvm, black_paints):
    # from z = 10 mm no light reaches the wall through the pad's ends
    design = black_finger(light=LightPanel(angle_deg=70.0, position_mm=(0.0, -8.0, 10.0)))
    # the closed form knows no film
    design = design.model_copy(update={"pad": GelPad(film=None)})
    scene = finger_scene(design, pressed_shape(design), bands_of(black_paints(), design), llvm)
    integrator = llvm.load_dict({"type": "path", "max_depth": 8})
    sampler = llvm.load_dict({"type": "independent"})
    count, repeats = 200_000, 8
    for point in ([-17.5, 3.0, 14.0], [-17.5, 5.0, 25.0]):
        expected = refracted_irradiance(np.array([point]), np.array([[1.0, 0.0, 0.0]]), design.light, design.pad)[0]
        means = []
        for seed in range(repeats):
            sampler.seed(seed, count)
            local = llvm.warp.square_to_cosine_hemisphere(sampler.next_2d())
            rays = llvm.Ray3f(llvm.Point3f(-17.499, *point[1:]), llvm.Vector3f(local.z, local.x, local.y))
            radiance = integrator.sample(scene, sampler, rays)[0]
            means.append(float(np.pi * radiance.numpy()[2].mean()))
        standard_error = np.std(means, ddof=1) / np.sqrt(repeats)
        assert standard_error < 0.04 * expected
        assert abs(np.mean(means) - expected) < STANDARD_ERRORS * standard_error


@pytest.mark.renderer
def test_refractive_connection_has_the_mean_of_plain_paths_and_less_noise(llvm, paints):
    from sim.optics._band_paths import band_integrator

    design = FingerDesign(camera=SMALL_CAMERA)
    scene = finger_scene(design, pressed_shape(design), bands_of(paints, design), llvm)
    sampler = llvm.load_dict({"type": "independent"})
    count, repeats = 50_000, 8
    results = {}
    for refractive in (True, False):
        integrator, means = (
            band_integrator(scene, design, pressed_shape(design), led=LedSearch(refractive=refractive)),
            [],
        )
        for seed in range(repeats):
            sampler.seed(100 + seed, count)
            rays = llvm.Ray3f(llvm.Point3f(2.0, 3.0, 20.0), llvm.Vector3f(0.0, 1.0, 0.0))
            means.append(float(integrator.sample(scene, sampler, rays)[0].numpy()[2].mean()))
        results[refractive] = (np.mean(means), np.std(means, ddof=1) / np.sqrt(repeats))
    (connected, its_error), (plain, plain_error) = results[True], results[False]
    assert plain_error < 0.05 * plain
    assert abs(connected - plain) < STANDARD_ERRORS * np.hypot(its_error, plain_error)
    assert its_error < plain_error
