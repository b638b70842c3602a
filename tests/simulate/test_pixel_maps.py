"""What each pixel sees: against the closed form of a flat finger, and against the renderer's own surfaces when bent."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import drjit as dr
import numpy as np
import pytest

from data_schemas import CameraCalibration, FingerDesign, ImpossibleFingerError, LightPanel, SimulateError
from data_schemas._design_parts import TactileCamera
from sim.optics import camera_pose, paint_bands, pixel_maps
from sim.optics._optical_layout import pixel_directions
from sim.optics._pixel_maps import NOTHING, _meet, camera_rays
from sim.optics._scene import finger_scene
from sim.surface_meshes import FingerShape, bent, pressed_shape, rest_shape, vertex_normals
from tests.simulate.closed_form_view import coat_positions

SMALL = FingerDesign(camera=TactileCamera(width_px=160, height_px=120))
# the mirror's 241 facets and the coat's 0.1 mm grid against their smooth forms
FACETS_MM = 1e-3
# the renderer starts rays (1 + largest coordinate) x 8.9e-5 off a surface, 0.007 mm here, at up to three surfaces
SPAWN_MM = 0.03


def maps_of(design, renderer, shape=None, **options):
    return pixel_maps(
        design, pressed_shape(design) if shape is None else shape, rest_shape(design), renderer, **options
    )


@pytest.mark.parametrize("variant", ["scalar", "llvm"])
def test_flat_finger_agrees_with_the_closed_form(request, variant):
    maps, expected = maps_of(SMALL, request.getfixturevalue(variant)), coat_positions(SMALL)
    seen = np.isfinite(expected[..., 0])
    assert seen.sum() > 500
    assert maps.sees("coat")[seen].all()
    # beyond that the coat is seen through the base face only, which the closed form leaves out
    assert (maps.sees("coat") & ~seen).sum() < 0.03 * seen.sum()
    np.testing.assert_allclose(maps.position_mm[seen][:, [2, 0]], expected[seen], atol=FACETS_MM)
    on_coat = maps.sees("coat")
    np.testing.assert_array_equal(np.isfinite(maps.depth_mm), on_coat)
    np.testing.assert_array_equal(np.isnan(maps.uv[..., 0]), maps.part == NOTHING)
    # the press moves points through the pad only, so that they keep their place along and across it
    np.testing.assert_allclose(maps.coat_mm(SMALL)[seen], expected[seen], atol=FACETS_MM)
    assert np.isnan(maps.coat_mm(SMALL)[~on_coat]).all()


def test_depth_and_contact_are_those_of_the_press(scalar):
    maps = maps_of(SMALL, scalar)
    assert maps.contact.sum() > 50
    z = maps.position_mm[..., 2][maps.contact]
    np.testing.assert_allclose(np.abs(z - 35.0).max(), np.sqrt(27.75), atol=1.0)
    np.testing.assert_allclose(maps.depth_mm[maps.sees("coat")], 6.0 - maps.position_mm[maps.sees("coat")][:, 1])
    # 1.5 mm in the middle, less what the pixels next to it are off the middle
    assert 1.45 < np.nanmax(maps.depth_mm) <= 1.5
    assert (maps.depth_along_ray_mm[maps.contact] < maps.depth_mm[maps.contact]).all()
    slope = maps.normal[maps.sees("coat")]
    np.testing.assert_allclose(np.linalg.norm(slope, axis=-1), 1.0, rtol=1e-9)
    assert (slope[:, 1] > 0.5).all()  # outward from the gel


def test_nothing_is_displaced_at_rest(scalar):
    maps = maps_of(SMALL, scalar, rest_shape(SMALL))
    assert (maps.depth_mm[maps.sees("coat")] == 0.0).all()
    assert not maps.contact.any()
    assert np.isnan(maps.contact_distance).all()


def traced_by_renderer(design, shape, paints, renderer, rays):
    """Follow rays through the finger's scene by its materials, refracted where that is possible."""
    bands = paint_bands(paints["red"], paints["green"], design.light)
    scene = finger_scene(design, shape, bands, renderer)
    centre = [float(v) for v in camera_pose(design).centre_mm]
    flat = rays.reshape(-1, 3).T.astype(np.float32)
    ray = renderer.Ray3f(renderer.Point3f(*centre), renderer.Vector3f(flat))
    points, uv = np.full((flat.shape[1], 3), np.nan), np.full((flat.shape[1], 2), np.nan)
    active = renderer.Bool([True] * flat.shape[1])
    for _ in range(8):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        delta = renderer.has_flag(si.bsdf().flags(), renderer.BSDFFlags.Delta)
        delta &= ~renderer.has_flag(si.bsdf().flags(), renderer.BSDFFlags.Smooth)
        ends = (active & ~delta).numpy()
        points[ends], uv[ends] = si.p.numpy().T[ends], si.uv.numpy().T[ends]
        active &= delta
        # a dielectric reflects when the first number is below its reflectance, else it refracts
        chosen = si.bsdf().sample(renderer.BSDFContext(), si, 0.999999, renderer.Point2f(0.5), active)[0]
        ray = si.spawn_ray(si.to_world(chosen.wo))
        dr.eval(ray, active)
    return points.reshape(rays.shape), uv.reshape(*rays.shape[:2], 2)


@pytest.mark.renderer
@pytest.mark.parametrize("radius_mm", [250.0, -400.0])
def test_bent_finger_agrees_with_the_materials_of_the_renderer(llvm, paints, radius_mm):
    shape = bent(pressed_shape(SMALL), radius_mm)
    maps = maps_of(SMALL, llvm, shape)
    points, uv = traced_by_renderer(SMALL, shape, paints, llvm, camera_rays(SMALL))
    seen = maps.sees("coat") | maps.sees("red") | maps.sees("green")
    assert seen.sum() > 500
    off = np.linalg.norm(maps.position_mm[seen] - points[seen], axis=-1)
    # a ray along an edge between two faces may take either; nearly all must agree
    assert np.mean(off < SPAWN_MM) > 0.995
    close = np.flatnonzero(seen.ravel())[off < SPAWN_MM]
    uv_error = maps.uv.reshape(-1, 2)[close] - uv.reshape(-1, 2)[close]
    # walls are 6 mm high, and their texture coordinate runs over that
    assert np.abs(uv_error).max() < 2.0 * SPAWN_MM / 6.0


@pytest.mark.renderer
def test_bent_finger_keeps_the_coordinates_of_the_undeformed_one(llvm):
    rest = rest_shape(SMALL)
    maps = maps_of(SMALL, llvm, bent(rest, 300.0))
    on_coat = maps.sees("coat")
    z, x = maps.coat_mm(SMALL)[on_coat].T
    y_c = -300.0
    expected = np.column_stack([x, y_c - (y_c - 6.0) * np.cos(z / y_c), (y_c - 6.0) * np.sin(z / y_c)])
    np.testing.assert_allclose(maps.position_mm[on_coat], expected, atol=FACETS_MM)


def test_calibrated_pinhole_sees_what_the_ideal_one_sees(scalar):
    pose = camera_pose(SMALL)
    focal = 80.0 / pose.tan_half_width
    camera = CameraCalibration(
        model="pinhole", width_px=160, height_px=120, focal_px=(focal, focal), centre_px=(79.5, 59.5), source="ideal"
    )
    np.testing.assert_allclose(camera_rays(SMALL, camera), pixel_directions(pose), atol=1e-7)
    ideal, calibrated = maps_of(SMALL, scalar), maps_of(SMALL, scalar, calibration=camera)
    assert np.mean(ideal.part == calibrated.part) > 0.999


def test_normals_of_a_sphere_point_outward():
    from sim.surface_meshes._finger_shape import grid_surface

    theta, phi = np.linspace(0.5, 2.5, 80), np.linspace(0.0, 2.0, 80)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    points = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1)
    normals = vertex_normals(grid_surface(points, theta, phi))
    lean = np.linalg.norm(normals - points.reshape(-1, 3), axis=-1).reshape(80, 80)
    # edges of 0.025 on a unit sphere: facets lean by half of that, which cancels at vertices inside
    assert lean.max() < 0.025
    assert lean[1:-1, 1:-1].max() < 0.001


def test_camera_that_sees_nothing_is_refused(scalar):
    hidden = SMALL.model_copy(
        update={"light": LightPanel(position_mm=(0.0, -2.0, -1.5), angle_deg=180.0, width_mm=300.0, height_mm=3.0)}
    )
    hidden = hidden.model_copy(update={"camera": TactileCamera(width_px=64, height_px=48, field_of_view_deg=20.0)})
    aside = CameraCalibration(
        model="pinhole", width_px=64, height_px=48, focal_px=(400.0, 400.0), centre_px=(2000.0, 24.0), source="off.yaml"
    )
    with pytest.raises(
        ImpossibleFingerError, match=r"does not see the coated face .*field_of_view_deg.*\(off\.yaml\).*mirror"
    ):
        maps_of(hidden, scalar, calibration=aside)


def test_depth_needs_the_same_mesh(scalar):
    shape = pressed_shape(SMALL)
    coat = shape.surfaces["coat"]
    turned = replace(coat, triangles=np.roll(coat.triangles, 1, axis=1))
    other = FingerShape({**shape.surfaces, "coat": turned}, shape.contact_distance, "turned")
    with pytest.raises(SimulateError, match=r"the coat 'turned' has .* the same mesh, deformed and at rest"):
        maps_of(SMALL, scalar, other)


@dataclass
class Lanes:
    """An array of the renderer."""

    values: np.ndarray

    def numpy(self):
        return self.values


def test_place_of_a_ray_that_meets_nothing_is_not_read(llvm):
    """The renderer never writes it: it holds what was in the memory before, at times a number that cannot be cast."""
    never_written = np.array([0x7FA00000], np.uint32).view(np.float32)[0]
    found = SimpleNamespace(
        is_valid=lambda: Lanes(np.array([True, False])),
        prim_index=Lanes(np.array([5, 77], np.uint32)),
        prim_uv=Lanes(np.array([[0.25, never_written], [0.5, never_written]], np.float32)),
    )
    scene = SimpleNamespace(ray_intersect_preliminary=lambda rays, coherent: found)
    triangle, barycentric = _meet(scene, np.zeros((2, 3)), np.ones((2, 3)), llvm)
    assert triangle.tolist() == [5, NOTHING]
    np.testing.assert_array_equal(barycentric, [[0.25, 0.25, 0.5], [1.0, 0.0, 0.0]])
