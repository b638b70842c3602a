"""Light that reaches the painted walls by detours."""

import numpy as np
import pytest

from data_schemas.design import Coating, FingerDesign, LightPanel, Mirror, TactileCamera
from sim.optics import scene as scene_module
from sim.optics.paint_bands import paint_bands
from sim.optics.render import open_scene
from sim.optics.variants import choose_variant, open_renderer
from sim.optics.wall_baking import indirect_irradiance, light_walls
from sim.optics.wall_emission import TEXELS_ALONG, TEXELS_UP, wall_emission

CAMERA = TactileCamera(width_px=64, height_px=48)
STANDARD_ERRORS = 3.0
REPEATS = 8


def estimates(design, paints, renderer, samples, repeats=REPEATS, seed=1):
    scene, _ = open_scene(design, paint_bands(paints["red"], paints["green"], design.light), renderer)
    return indirect_irradiance(scene, design, renderer, seed, samples, repeats)


def mean_and_error(results, wall):
    means = [result[wall].mean() for result in results]
    return np.mean(means), np.std(means, ddof=1) / np.sqrt(len(means))


@pytest.mark.renderer
def test_connected_paths_find_what_stock_paths_find_beyond_the_direct_light(llvm_choice, paints):
    design = FingerDesign(camera=CAMERA)
    connected = estimates(design, paints, open_renderer(llvm_choice), 10_000)
    stock = estimates(design, paints, open_renderer(choose_variant("scalar")), 5000)
    assert connected[0]["red"].shape == (TEXELS_ALONG, TEXELS_UP)
    for wall in ("red", "green"):
        (fast, fast_error), (slow, slow_error) = (mean_and_error(r, wall) for r in (connected, stock))
        assert fast_error < 0.15 * fast
        assert slow_error < 0.15 * slow
        assert abs(fast - slow) < STANDARD_ERRORS * np.hypot(fast_error, slow_error)


@pytest.mark.renderer
def test_most_light_reaches_the_walls_by_detours_and_none_in_a_black_finger(llvm, paints, black_paints, monkeypatch):
    light = LightPanel(position_mm=(0.0, -8.0, 10.0))
    bright = FingerDesign(camera=CAMERA, light=light)
    bands = paint_bands(paints["red"], paints["green"], light)
    direct = wall_emission(bright, bands)["red"].mean() / bands.energy_conversion["red"] * np.pi * 3
    assert estimates(bright, paints, llvm, 20_000, repeats=1)[0]["red"].mean() > direct
    monkeypatch.setattr(scene_module, "BOX_REFLECTANCE", 0.0)
    black = FingerDesign(
        camera=CAMERA,
        light=light,
        coating=Coating(diffuse_share=1.0, diffuse_reflectance=0.0),
        mirror=Mirror(reflectance=0.0),
    )
    # what is left are reflections at the ends of the gel
    assert estimates(black, black_paints(), llvm, 20_000, repeats=1)[0]["red"].mean() < 0.1 * direct


def test_lighting_the_walls_replaces_their_textures(scalar, paints):
    design = FingerDesign(camera=CAMERA)
    bands = paint_bands(paints["red"], paints["green"], design.light)
    scene, _ = open_scene(design, bands, scalar)
    indirect = {"red": np.full((TEXELS_ALONG, TEXELS_UP), 2.0), "green": np.zeros((TEXELS_ALONG, TEXELS_UP))}
    light_walls(scene, design, bands, scalar, "b", indirect)
    expected = wall_emission(design, bands, "b", indirect)
    added = expected["red"] - wall_emission(design, bands)["red"]
    np.testing.assert_allclose(added[..., 0], bands.energy_conversion["red"] * 2.0 / np.pi)
    si = scene.ray_intersect(scalar.Ray3f([-16.0, 3.03, 35.03], [-1.0, 0.0, 0.0]))
    middle = expected["red"][TEXELS_ALONG // 2 - 1 : TEXELS_ALONG // 2 + 1]
    seen = np.array(si.emitter(scene).eval(si))
    assert middle.min(axis=(0, 1))[0] <= seen[0] * (1 + 1e-6)
    assert seen[0] * (1 - 1e-6) <= middle.max(axis=(0, 1))[0]
    assert seen[1] == seen[2] == 0.0


def test_the_same_seed_gives_the_same_bake(scalar, paints):
    design = FingerDesign(camera=CAMERA)
    one, two, other = (estimates(design, paints, scalar, 300, repeats=1, seed=s)[0]["green"] for s in (4, 4, 5))
    np.testing.assert_array_equal(one, two)
    assert (one != other).any()
