"""The flat oracle itself against closed forms: view factors, Snell, Fresnel, diffuse transmittance."""

import numpy as np
import pytest
from scipy.integrate import dblquad, quad

from data_schemas import GelPad, LightPanel
from sim.optics import panel_frame
from tests.simulate.flat_refraction import fresnel_transmittance, refracted_irradiance, trace_crossing

PAD = GelPad()
AIR_PAD = GelPad(refractive_index=1.0)
INTO_GEL_FROM_ABOVE = np.array([[0.0, -1.0, 0.0]])  # a surface that looks down at the inner face


def panel(angle_deg=90.0, position=(0.0, -10.0, 35.0), width=20.0, height=4.0):
    return LightPanel(angle_deg=angle_deg, position_mm=position, width_mm=width, height_mm=height)


def parallel_rectangle_irradiance(a, b, c):
    """Patch parallel to a rectangle a x b with one corner on its normal at distance c (Howell B-4), unit radiance."""
    x, y = a / c, b / c
    rx, ry = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    return 0.5 * (x / rx * np.arctan(y / rx) + y / ry * np.arctan(x / ry))


def test_without_refraction_a_parallel_patch_sees_the_closed_form_factor():
    point = np.array([[0.0, 6.0, 35.0]])
    computed = refracted_irradiance(point, INTO_GEL_FROM_ABOVE, panel(), AIR_PAD)
    expected = 4.0 * parallel_rectangle_irradiance(10.0, 2.0, 16.0)
    assert computed[0] == pytest.approx(expected, rel=1e-8)  # Gauss-Legendre on a smooth kernel


def test_without_refraction_a_perpendicular_patch_agrees_with_direct_integration():
    point, light = np.array([-17.5, 3.0, 30.0]), panel(angle_deg=40.0)
    frame = panel_frame(light)

    def kernel(v, u):
        q = frame.centre_mm + u * frame.half_across_mm + v * frame.half_along_mm
        d = q - point
        r = np.linalg.norm(d)
        return max(d[0] / r, 0.0) * max(-(d @ frame.normal) / r, 0.0) / r**2 * frame.area_mm2 / 4.0

    expected = dblquad(kernel, -1, 1, -1, 1, epsabs=1e-12)[0]
    computed = refracted_irradiance(point[None], np.array([[1.0, 0.0, 0.0]]), light, AIR_PAD)
    assert computed[0] == pytest.approx(expected, rel=1e-7)


def test_crossings_obey_snells_law():
    rng = np.random.default_rng(5)
    p = rng.uniform([-17, 0.05, 0], [17, 7, 70], (200, 3))
    q = rng.uniform([-10, -20, -5], [10, -3, 70], (200, 3))
    seen = trace_crossing(p, q, np.array([0.0, 1.0, 0.0]), 1.41)
    to_panel = (q - seen.crossing_mm) / np.linalg.norm(q - seen.crossing_mm, axis=1, keepdims=True)
    # tangential components: n * in gel = in air, and the ray continues through the crossing
    np.testing.assert_allclose(1.41 * seen.direction[:, [0, 2]], to_panel[:, [0, 2]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(seen.direction, axis=1), 1.0, rtol=1e-12)


def test_the_solid_angle_is_the_derivative_of_the_direction():
    p, q, step = np.array([1.0, 4.0, 20.0]), np.array([-3.0, -10.0, 3.0]), 1e-4
    normal = np.array([0.0, 1.0, 0.0])
    moved = [trace_crossing(p, q + d, normal, 1.41).direction for d in (np.array([step, 0, 0]), np.array([0, 0, step]))]
    here = trace_crossing(p, q, normal, 1.41)
    solid_angle = np.linalg.norm(np.cross(moved[0] - here.direction, moved[1] - here.direction)) / step**2
    assert here.solid_angle_per_mm2 == pytest.approx(solid_angle, rel=1e-4)  # forward difference of first order


def test_fresnel_at_normal_incidence_and_at_brewsters_angle():
    assert fresnel_transmittance(np.array(1.0), np.array(1.0), 1.41) == pytest.approx(4 * 1.41 / 2.41**2, rel=1e-12)
    air = np.arctan(1.41)
    s_reflectance = ((1 - 1.41**2) / (1 + 1.41**2)) ** 2
    computed = fresnel_transmittance(np.cos(np.pi / 2 - air), np.cos(air), 1.41)
    assert computed == pytest.approx(1 - s_reflectance / 2, rel=1e-9)


def test_an_all_covering_panel_gives_the_diffuse_transmittance_of_the_gel_face():
    pad = GelPad(length_mm=1000.0, width_mm=1000.0)
    light = panel(position=(0.0, -5.0, 500.0), width=400.0, height=400.0)
    computed = refracted_irradiance(np.array([[0.0, 1.0, 500.0]]), INTO_GEL_FROM_ABOVE, light, pad, (240, 240))

    def transmitted(angle):
        in_gel = np.arcsin(np.sin(angle) / 1.41)
        t = fresnel_transmittance(np.cos(in_gel), np.cos(angle), 1.41)
        return 2.0 * np.pi * t * np.cos(angle) * np.sin(angle)

    expected = quad(transmitted, 0.0, np.pi / 2)[0]
    # beyond 200 mm at 5 mm depth lies less than (5/200)^2 = 0.06 % of the flux; the quadrature adds as much
    assert computed[0] == pytest.approx(expected, rel=2e-3)


def test_light_beside_the_inner_face_does_not_enter():
    point = np.array([[0.0, 3.0, 0.5]])
    light = panel(position=(0.0, -10.0, -40.0), angle_deg=60.0)
    inside = refracted_irradiance(np.array([[0.0, 6.0, 30.0]]), INTO_GEL_FROM_ABOVE, light, PAD)
    # every straight crossing from this panel to the point lies at z < 0
    assert refracted_irradiance(point, INTO_GEL_FROM_ABOVE, light, PAD)[0] == 0.0
    assert inside[0] > 0.0


def test_a_small_panel_gives_the_cosine_of_its_refracted_elevation():
    point = np.array([[0.0, 6.0, 29.0]])
    angles = np.arange(-20.0, 131.0, 10.0)
    small = {"position": (0.0, -10.0, -1.0), "width": 0.1, "height": 0.1}
    curve = np.array([refracted_irradiance(point, INTO_GEL_FROM_ABOVE, panel(a, **small), PAD)[0] for a in angles])
    crossing = trace_crossing(
        point[0], np.array([0.0, -10.0, -1.0]), np.array([0.0, 1.0, 0.0]), PAD.index_at(450.0)
    ).crossing_mm
    elevation = np.degrees(np.arctan2(10.0, crossing[2] + 1.0))
    expected = np.maximum(np.cos(np.radians(angles - elevation)), 0.0)
    # the panel is 0.1 mm at 20 mm, so its own extent matters at 1e-4
    np.testing.assert_allclose(curve / curve.max(), expected / expected.max(), atol=2e-4)
