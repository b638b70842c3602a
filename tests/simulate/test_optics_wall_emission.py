"""What the painted walls emit: baked chains, and the paper's rule."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from data_schemas import FingerDesign, GelPad, LightPanel
from sim.optics import WALLS, last_band, paint_bands, panel_frame, paper_emission
from sim.optics._painted_walls import direct_irradiance, direct_lights, excited, texel_uv, unbaked_walls, wall_map
from sim.surface_meshes import bent, pressed_shape, rest_shape
from tests.simulate.flat_refraction import refracted_irradiance


def first_order(design, shape, bands):
    return excited("led", {wall: direct_irradiance(design, shape, wall, texel_uv()) for wall in WALLS}, bands)


def test_direct_light_at_rest_is_the_flat_closed_form_and_both_walls_are_alike():
    design = FingerDesign(pad=GelPad(film=None))
    shape = rest_shape(design)
    found = {wall: direct_irradiance(design, shape, wall, texel_uv()) for wall in WALLS}
    points = wall_map(shape, "red").positions_mm(texel_uv()).reshape(-1, 3)
    np.testing.assert_allclose(points[:, 0], -17.5, atol=1e-9)
    normals = np.broadcast_to([1.0, 0.0, 0.0], points.shape)
    expected = refracted_irradiance(points, normals, design.light, design.pad, (12, 4)).reshape(found["red"].shape)
    # the map of the face is a plane to parts in 1e8; where a panel point is lost at the base's edge both lose it
    np.testing.assert_allclose(found["red"], expected, rtol=1e-6)
    np.testing.assert_allclose(found["red"], found["green"], rtol=1e-6)


def test_without_refraction_a_bent_wall_sees_the_panel_along_straight_lines():
    light = LightPanel(position_mm=(0.0, -20.0, 20.0), angle_deg=80.0, beam_exponent=2.0, power_rel=3.0)
    pad = GelPad(film=None, refractive_index=1.0)
    design = FingerDesign(pad=pad, light=light)
    shape, uv, frame = bent(rest_shape(design), 150.0), np.array([[0.5, 0.6]]), panel_frame(light)
    where = wall_map(shape, "red")
    point, inward = where.positions_mm(uv)[0], -where.normals(uv)[0]

    def kernel(v, u):
        d = frame.centre_mm + u * frame.half_across_mm + v * frame.half_along_mm - point
        r = np.linalg.norm(d)
        return max(d @ inward / r, 0.0) * max(-(d @ frame.normal) / r, 0.0) ** 2 / r**2 * frame.area_mm2 / 4.0

    expected = 3.0 * dblquad(kernel, -1, 1, -1, 1, epsabs=1e-10)[0]
    assert direct_irradiance(design, shape, "red", uv)[0] == pytest.approx(expected, rel=1e-4)  # 12 x 4 points


def test_two_panels_give_the_sum_of_each():
    one, other = LightPanel(), LightPanel(position_mm=(0.0, -8.0, 66.0), angle_deg=150.0, power_rel=0.4)
    uv = texel_uv()[::7, ::3]
    parts = [FingerDesign(light=light) for light in (one, other)]
    both = FingerDesign(light=one, second_light=other)
    sums = [direct_irradiance(d, rest_shape(d), "green", uv) for d in (*parts, both)]
    np.testing.assert_allclose(sums[2], sums[0] + sums[1], rtol=1e-12)


@pytest.mark.renderer
def test_lights_together_in_single_precision_are_each_alone(llvm):
    """Sharp and wide beams, near and far, on a bent finger; the second panel is added to every one."""
    lights = [LightPanel(angle_deg=angle, beam_exponent=m) for angle, m in ((0.0, 1.0), (40.0, 3.0), (120.0, 1.0))]
    lights.append(LightPanel(position_mm=(4.0, -14.0, 35.0), width_mm=12.0, angle_deg=90.0, power_rel=0.3))
    further = LightPanel(position_mm=(0.0, -8.0, 66.0), angle_deg=150.0, power_rel=0.4)
    shape = bent(pressed_shape(FingerDesign()), 150.0)
    together = direct_lights(FingerDesign(light=lights[0], second_light=further), shape, lights)
    for light, found in zip(lights, together, strict=True):
        design = FingerDesign(light=light, second_light=further)
        alone = np.stack([direct_irradiance(design, shape, wall, texel_uv()) for wall in WALLS])
        # single precision, and three Newton steps in place of five
        np.testing.assert_allclose(found, alone, rtol=1e-4, atol=1e-5 * alone.max())


def test_level_b_follows_the_angle_and_level_a_only_its_gain(paints):
    def walls(angle):
        design = FingerDesign(light=LightPanel(angle_deg=angle))
        shape = pressed_shape(design)
        return design, shape, first_order(design, shape, paint_bands(paints["red"], paints["green"], design.light))

    (design, shape, b30), (_, _, b90) = walls(30.0), walls(90.0)
    assert np.ptp(b30["led>red"] / b90["led>red"]) > 0.5  # the profile itself changes with the angle
    a30, a90 = (paper_emission(design, shape, b, "a")["led>red"] for b in (b30, b90))
    s30 = paper_emission(design, shape, b30, "a_inverse_square")["led>red"]
    np.testing.assert_allclose(a30 / a30.mean(), a90 / a90.mean(), rtol=1e-12)
    assert a30.mean() == pytest.approx(b30["led>red"].mean(), rel=1e-12)
    assert s30.mean() == pytest.approx(b30["led>red"].mean(), rel=1e-12)
    distance = np.linalg.norm(wall_map(shape, "red").positions_mm(texel_uv()) - [0.0, -10.0, -1.0], axis=-1)
    np.testing.assert_allclose(a30 / a30[0, 0], distance / distance[0, 0], rtol=1e-12)
    np.testing.assert_allclose(s30 / s30[0, 0], (distance[0, 0] / distance) ** 2, rtol=1e-12)


def test_a_chain_excites_by_the_column_of_its_last_band(paints):
    design = FingerDesign()
    bands = paint_bands(paints["red"], paints["green"], design.light)
    light = {"red": np.full((2, 3), np.pi), "green": np.full((2, 3), 2 * np.pi)}
    made = excited("led", light, bands)
    np.testing.assert_allclose(made["led>red"], bands.energy_conversion["red"])
    np.testing.assert_allclose(made["led>green"], 2 * bands.energy_conversion["green"])
    # these paints have no absorption spectrum: nothing but the LED excites them
    assert all((v == 0.0).all() for v in excited("led>green", light, bands).values())
    assert last_band("led>green>red") == "red"


def test_unbaked_walls_are_faint_in_their_own_band_only():
    for k, (wall, emission) in enumerate(unbaked_walls().items()):
        assert wall == WALLS[k]
        assert (emission[..., k] > 0.0).all()
        assert (np.delete(emission, k, axis=-1) == 0.0).all()
