"""Light that reaches the painted walls by detours, and fluorescence excited by fluorescence."""

from dataclasses import replace

import numpy as np
import pytest

from data_schemas import Coating, FingerDesign, GelPad, LightPanel
from data_schemas._design_parts import Enclosure, Mirror, TactileCamera
from sim.optics import (
    TEXELS_ALONG,
    WALLS,
    LoadedScene,
    PaintOptics,
    bake_walls,
    choose_variant,
    last_band,
    open_renderer,
    open_scene,
    paint_bands,
)
from sim.optics._painted_walls import TEXELS_UP, direct_irradiance, indirect_irradiance, light_walls, texel_uv
from sim.surface_meshes import pressed_shape, rest_shape

CAMERA = TactileCamera(width_px=64, height_px=48)
# in a scalar variant the film is an approximation, see sim.optics._scene
BARE = GelPad(film=None)
STANDARD_ERRORS = 3.0
REPEATS = 8


@pytest.fixture
def mutual_paints(paints) -> dict[str, PaintOptics]:
    """Paints of which the red one absorbs what the green one emits."""
    w = paints["red"].wavelength_nm
    absorption = {"red": np.exp(-0.5 * ((w - 500.0) / 40.0) ** 2), "green": np.exp(-0.5 * ((w - 440.0) / 30.0) ** 2)}
    return {name: replace(paint, absorption_rel=absorption[name]) for name, paint in paints.items()}


def finger(design, paints, renderer):
    shape, bands = pressed_shape(design), paint_bands(paints["red"], paints["green"], design.light)
    return open_scene(design, shape, bands, renderer), design, shape, bands


def estimates(design, paints, renderer, samples, repeats=REPEATS, seed=1):
    scene, _, shape, _ = finger(design, paints, renderer)
    bakes = (indirect_irradiance(scene, design, shape, renderer, seed + 100 * k, samples) for k in range(repeats))
    return [{wall: smooth.mean for wall, smooth in bake.items()} for bake in bakes]


def mean_and_error(results, name):
    means = [result[name].mean() for result in results]
    return np.mean(means), np.std(means, ddof=1) / np.sqrt(len(means))


@pytest.mark.renderer
def test_connected_paths_find_what_stock_paths_find_beyond_the_direct_light(llvm_choice, paints):
    design = FingerDesign(camera=CAMERA, pad=BARE)
    connected = estimates(design, paints, open_renderer(llvm_choice), 10_000)
    stock = estimates(design, paints, open_renderer(choose_variant("scalar")), 5000)
    assert connected[0]["red"].shape == (TEXELS_ALONG, TEXELS_UP)
    for wall in WALLS:
        (fast, fast_error), (slow, slow_error) = (mean_and_error(r, wall) for r in (connected, stock))
        assert fast_error < 0.15 * fast
        assert slow_error < 0.15 * slow
        assert abs(fast - slow) < STANDARD_ERRORS * np.hypot(fast_error, slow_error)


@pytest.mark.renderer
def test_a_guide_leaves_the_light_of_a_bake_and_takes_noise_out(llvm, paints):
    from sim.optics._band_paths import mirror_guide

    scene, design, shape, _ = finger(FingerDesign(camera=CAMERA), paints, llvm)
    guide = mirror_guide(scene, design, shape)
    plain, guided = (
        [indirect_irradiance(scene, design, shape, llvm, seed + k, 10_000, g) for k in range(16)]
        for seed, g in ((100, None), (200, guide))
    )
    plain, guided = ([{w: s.mean for w, s in bake.items()} for bake in bakes] for bakes in (plain, guided))
    for wall in WALLS:
        (one, one_error), (other, other_error) = (mean_and_error(r, wall) for r in (plain, guided))
        assert abs(one - other) < STANDARD_ERRORS * np.hypot(one_error, other_error)
    # of texels, whose noise is that of many paths: measured 0.6 of it
    noise = [np.std([b[w] for b in bakes for w in WALLS], axis=0).mean() for bakes in (plain, guided)]
    assert noise[1] < 0.8 * noise[0]


@pytest.mark.renderer
def test_most_light_reaches_the_walls_by_detours_and_none_in_a_black_finger(llvm, paints, black_paints):
    light = LightPanel(position_mm=(0.0, -8.0, 10.0))
    bright = FingerDesign(camera=CAMERA, light=light)
    direct = direct_irradiance(bright, rest_shape(bright), "red", texel_uv()).mean()
    assert estimates(bright, paints, llvm, 20_000, repeats=1)[0]["red"].mean() > direct
    black = bright.model_copy(
        update={
            "coating": Coating(diffuse_share=1.0, diffuse_reflectance=0.0),
            "mirror": Mirror(reflectance=0.0),
            "enclosure": Enclosure(cloth_reflectance=0.0),
        }
    )
    # what is left are reflections at the ends of the gel
    assert estimates(black, black_paints(), llvm, 20_000, repeats=1)[0]["red"].mean() < 0.1 * direct


def test_lighting_the_walls_sets_the_sum_of_the_chains_of_each_band(scalar, paints):
    scene, *_ = finger(FingerDesign(camera=CAMERA), paints, scalar)
    ramp = np.linspace(1.0, 2.0, TEXELS_ALONG)[:, None] * np.ones(TEXELS_UP)
    light_walls(scene, {"led>red": ramp, "led>green>red": 2 * ramp, "led>green": 5 * ramp}, scalar)
    for x, k, expected in ((-16.0, 0, 3.0), (16.0, 1, 5.0)):
        si = scene.ray_intersect(scalar.Ray3f([x, 3.03, 52.5], [x, 0.0, 0.0]))
        seen = np.array(si.emitter(scene).eval(si))
        # at three quarters of the length, between centres of texels
        assert seen[k] == pytest.approx(expected * 1.75, rel=0.01)
        assert np.delete(seen, k).max() == 0.0


@pytest.mark.renderer
def test_one_chain_per_order_and_the_scalar_bake_agrees(llvm_choice, mutual_paints):
    design = FingerDesign(camera=CAMERA, pad=BARE)
    renderer = open_renderer(llvm_choice)
    compiled = bake_walls(LoadedScene(*finger(design, mutual_paints, renderer), renderer), samples=10_000, repeats=6)
    assert {"led>red", "led>green", "led>green>red"} <= compiled[0].keys()
    # red emission excites no green paint
    assert not any(">red>green" in chain for chain in compiled[0])
    renderer = open_renderer(choose_variant("scalar"))
    stock = bake_walls(LoadedScene(*finger(design, mutual_paints, renderer), renderer), samples=3000, repeats=6)
    for chain in ("led>red", "led>green>red"):
        (fast, fast_error), (slow, slow_error) = (mean_and_error(r, chain) for r in (compiled, stock))
        assert slow_error < 0.2 * slow
        assert abs(fast - slow) < STANDARD_ERRORS * np.hypot(fast_error, slow_error)


@pytest.mark.renderer
def test_chains_below_half_a_percent_are_left_out_and_level_a_has_the_first_order_only(llvm, mutual_paints):
    case = finger(FingerDesign(camera=CAMERA), mutual_paints, llvm)
    light = bake_walls(LoadedScene(*case, llvm), samples=10_000)[0]
    for wall in WALLS:
        of_wall = [v.mean() for chain, v in light.items() if last_band(chain) == wall]
        assert min(of_wall) >= 0.005 * sum(of_wall)
    paper = bake_walls(LoadedScene(*case, llvm), "a", samples=10_000)[0]
    assert set(paper) == {"led>red", "led>green"}
    assert paper["led>red"].mean() == pytest.approx(light["led>red"].mean(), rel=1e-6)


def test_the_same_seed_gives_the_same_bake(scalar, paints):
    design = FingerDesign(camera=CAMERA)
    one, two, other = (estimates(design, paints, scalar, 300, repeats=1, seed=s)[0]["green"] for s in (4, 4, 5))
    np.testing.assert_array_equal(one, two)
    assert (one != other).any()
