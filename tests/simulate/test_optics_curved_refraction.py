"""Refracted paths through a curved inner face: Snell's law, solid angles, film; the flat closed form as oracle."""

import numpy as np
import pytest

from data_schemas import Film, FingerDesign, GelPad, LightPanel
from sim.optics import inner_face, refract_through
from sim.optics._refraction import curved_irradiance, film_transmittance, fresnel_transmittance
from sim.surface_meshes import bent, rest_shape
from tests.simulate.flat_refraction import refracted_irradiance, trace_crossing

DESIGN = FingerDesign(pad=GelPad(film=None))
PAD = DESIGN.pad
INDEX = PAD.index_at(DESIGN.light.peak_wavelength_nm)


def columns(points):
    return tuple(np.asarray(points).T)


def points_and_feet(count=400, seed=1):
    """Points of the undeformed gel, feet on the inner face, and points where a panel may be."""
    rng = np.random.default_rng(seed)
    p = rng.uniform([-17.0, 0.1, 0.3], [17.0, 6.0, 69.7], (count, 3))
    q = rng.uniform([-10.0, -13.0, -4.0], [10.0, -7.0, 2.0], (count, 3))
    return p, np.column_stack([p[:, 0] / PAD.width_mm + 0.5, p[:, 2] / PAD.length_mm]), q


def bend(points, radius_mm):
    turn, arm = -points[:, 2] / radius_mm, -radius_mm - points[:, 1]
    return np.column_stack([points[:, 0], -radius_mm - arm * np.cos(turn), arm * np.sin(turn)])


def face_of(radius_mm=None):
    shape = rest_shape(DESIGN)
    return inner_face(DESIGN, shape if radius_mm is None else bent(shape, radius_mm))


def test_a_flat_face_gives_the_closed_form():
    (p, foot, q), face, normal = points_and_feet(), face_of(), np.array([0.0, 0.6, 0.8])
    path = refract_through(face.map.evaluate, columns(p), columns(foot), columns(q), face)
    flat = trace_crossing(p, q, normal, INDEX)
    inside = (np.abs(flat.crossing_mm[:, 0]) < PAD.width_mm / 2) & (flat.crossing_mm[:, 2] > 0.0)
    np.testing.assert_array_equal(path.found, inside)
    cos_panel = np.maximum(-np.stack(path.to_panel, -1) @ normal, 0.0)
    expected = INDEX**2 * flat.transmittance * flat.solid_angle_per_mm2
    np.testing.assert_allclose((path.weight * cos_panel)[inside], expected[inside], rtol=1e-9)
    np.testing.assert_allclose(np.stack(path.to_crossing, -1)[inside], flat.direction[inside], atol=1e-9)


@pytest.mark.parametrize("radius_mm", [200.0, 80.0, 50.0, -150.0])
def test_paths_through_an_arc_obey_snells_law_about_its_known_normal(radius_mm):
    (p, foot, q), face = points_and_feet(), face_of(radius_mm)
    path = refract_through(face.map.evaluate, columns(bend(p, radius_mm)), columns(foot), columns(q), face)
    assert path.found.mean() > 0.7  # bent away, the far part of the face looks past the panel
    crossing = np.stack(path.crossing, -1)[path.found]
    normal = crossing + np.array([0.0, radius_mm, 0.0])
    normal[:, 0] = 0.0
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), abs(radius_mm), atol=1e-4)
    normal /= radius_mm
    across = [np.cross(np.stack(d, -1)[path.found], normal) for d in (path.to_crossing, path.to_panel)]
    # the map's slope is good to 1e-4, see the tests of the map
    np.testing.assert_allclose(INDEX * across[0], across[1], atol=1e-4)


@pytest.mark.parametrize("radius_mm", [80.0, -150.0])
def test_the_solid_angle_is_the_derivative_of_the_direction(radius_mm):
    (p, foot, q), face, step = points_and_feet(60), face_of(radius_mm), 1e-3
    p = bend(p, radius_mm)

    def direction(moved):
        return np.stack(
            refract_through(face.map.evaluate, columns(p), columns(foot), columns(moved), face).to_crossing, -1
        )

    e1, e2 = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.8, -0.6])
    by_1, by_2 = ((direction(q + step * e) - direction(q - step * e)) / (2 * step) for e in (e1, e2))
    path = refract_through(face.map.evaluate, columns(p), columns(foot), columns(q), face)
    cos_panel = np.abs(np.stack(path.to_panel, -1) @ np.cross(e1, e2))
    transmittance = fresnel_transmittance(path.cos_gel, path.cos_air, INDEX)
    found = path.found
    expected = INDEX**2 * transmittance * np.linalg.norm(np.cross(by_1, by_2), axis=-1)
    # central differences of a third-order spline, whose second derivative jumps in slope at the knots
    np.testing.assert_allclose((path.weight * cos_panel)[found], expected[found], rtol=2e-3)


def test_few_steps_are_enough_in_the_renderer():
    p, foot, q = points_and_feet()
    face = face_of(50.0)
    few, many = (
        refract_through(face.map.evaluate, columns(bend(p, 50.0)), columns(foot), columns(q), face, steps=steps)
        for steps in (3, 12)
    )
    np.testing.assert_array_equal(few.found, many.found)
    np.testing.assert_allclose(few.weight, many.weight, rtol=1e-3)  # far below the noise of one connection


def test_the_irradiance_of_a_flat_face_is_that_of_the_closed_form():
    points = np.array([[-17.5, 3.0, 10.0], [-17.5, 1.0, 40.0]])
    normals = np.tile([1.0, 0.0, 0.0], (2, 1))
    foot = np.column_stack([np.zeros(2), points[:, 2] / PAD.length_mm])
    light = LightPanel(angle_deg=60.0)
    curved = curved_irradiance(points, normals, foot, light, face_of(), (12, 4))
    np.testing.assert_allclose(curved, refracted_irradiance(points, normals, light, PAD, (12, 4)), rtol=1e-9)
    narrow = curved_irradiance(points, normals, foot, light.model_copy(update={"beam_exponent": 3.0}), face_of())
    assert (narrow < curved).all()


def test_film_at_normal_incidence_matched_index_and_grazing_light():
    one = np.ones(1)
    outer, inner, bare = (((a - b) / (a + b)) ** 2 for a, b in ((1.0, 1.65), (1.65, 1.41), (1.0, 1.41)))
    expected = (1 - outer) * (1 - inner) / (1 - outer * inner) / (1 - bare)
    assert film_transmittance(one, one, 1.41, 1.65)[0] == pytest.approx(expected, rel=1e-12)
    air = np.linspace(0.0, 1.5, 40)
    cos_gel, cos_air = np.sqrt(1 - (np.sin(air) / 1.41) ** 2), np.cos(air)
    np.testing.assert_allclose(film_transmittance(cos_gel, cos_air, 1.41, 1.41), 1.0, rtol=1e-12)
    dense = film_transmittance(cos_gel, cos_air, 1.41, 1.65)
    assert (dense < 1.0).all()
    assert (dense * fresnel_transmittance(cos_gel, cos_air, 1.41) > 0.0).all()


def test_a_film_weakens_every_path_by_its_own_angle():
    (p, foot, q), bare = points_and_feet(100), face_of(100.0)
    filmed = inner_face(FingerDesign(pad=GelPad(film=Film())), bent(rest_shape(DESIGN), 100.0))
    paths = [
        refract_through(f.map.evaluate, columns(bend(p, 100.0)), columns(foot), columns(q), f) for f in (bare, filmed)
    ]
    found = paths[0].found
    expected = film_transmittance(paths[0].cos_gel, paths[0].cos_air, INDEX, 1.65)
    np.testing.assert_allclose(
        (paths[1].weight / np.where(found, paths[0].weight, 1.0))[found], expected[found], rtol=1e-9
    )
