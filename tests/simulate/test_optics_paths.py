"""The band path tracer: connection on and off have equal means on a bent finger; chains are channels and linear."""

from itertools import product

import numpy as np
import pytest

from data_schemas import FingerDesign, LightPanel
from data_schemas._design_parts import TactileCamera
from sim.optics import TEXELS_ALONG, inner_face, open_renderer, paint_bands
from sim.optics._painted_walls import TEXELS_UP, direct_irradiance, texel_uv
from sim.optics._path_rules import LedSearch
from sim.optics._scene import finger_scene
from sim.surface_meshes import bent, pressed_shape, rest_shape

CAMERA = TactileCamera(width_px=96, height_px=72)
# large panels, of which one has a narrow beam: paths meet them by chance often enough to be compared with
DESIGN = FingerDesign(
    camera=CAMERA,
    light=LightPanel(position_mm=(0.0, -22.0, 20.0), angle_deg=75.0, width_mm=30.0, height_mm=30.0, beam_exponent=2.0),
    second_light=LightPanel(
        position_mm=(0.0, -32.0, 45.0), angle_deg=100.0, width_mm=20.0, height_mm=20.0, power_rel=3.0
    ),
)
BENDING_RADIUS_MM = 100.0
SEEDS = 6
RAYS = 40_000
# two-sided, 6 seeds each: a false alarm in about one of 100 changes of the random numbers, and these are fixed
STANDARD_ERRORS = 3.0
FLOAT32 = 1e-4


def build(renderer, paints, design=DESIGN, radius_mm=BENDING_RADIUS_MM):
    shape = bent(pressed_shape(design), radius_mm)
    return finger_scene(design, shape, paint_bands(paints["red"], paints["green"], design.light), renderer), shape


def rays_to_the_coat(shape, design, seed):
    """Rays from 1 mm above the inner face into the gel, spread over the pad."""
    rng, face = np.random.default_rng(seed), inner_face(design, shape).map
    uv = rng.uniform(0.1, 0.9, (RAYS, 2))
    into = -face.normals(uv)
    directions = into + 0.3 * rng.normal(size=into.shape)
    return face.positions_mm(uv) + into, directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def led_means(renderer, scene, shape, integrator, design=DESIGN, first_seed=0):
    means = []
    for seed in range(first_seed, first_seed + SEEDS):
        o, d = (np.ascontiguousarray(v.T, np.float32) for v in rays_to_the_coat(shape, design, seed))
        sampler = renderer.load_dict({"type": "independent"})
        sampler.seed(seed, RAYS)
        rays = renderer.Ray3f(renderer.Point3f(o), renderer.Vector3f(d))
        means.append(integrator.sample(scene, sampler, rays, None, renderer.Bool(True))[0].numpy()[2].mean())
    return np.mean(means), np.std(means, ddof=1) / np.sqrt(SEEDS)


@pytest.mark.renderer
def test_connection_on_and_off_have_equal_means_on_a_bent_finger_with_film_and_two_beams(llvm, paints):
    from sim.optics._band_paths import band_integrator

    scene, shape = build(llvm, paints)
    on, on_error = led_means(llvm, scene, shape, band_integrator(scene, DESIGN, shape), first_seed=100)
    off, off_error = led_means(
        llvm, scene, shape, band_integrator(scene, DESIGN, shape, led=LedSearch(refractive=False))
    )
    assert on_error < 0.02 * on
    assert off_error < 0.02 * off
    assert abs(on - off) < STANDARD_ERRORS * np.hypot(on_error, off_error)


@pytest.mark.renderer
def test_channels_are_the_chains_in_order_and_linear_in_the_emission(llvm, paints):
    from sim.optics._band_paths import band_integrator

    scene, shape = build(llvm, paints)
    even = np.ones((TEXELS_ALONG, TEXELS_UP))
    light = {"led>green": even, "led>red": even, "led>green>red": 0.5 * even, "led>red>red": 0.25 * even}
    integrator = band_integrator(scene, DESIGN, shape, light)
    assert integrator.chains == ("led>red", "led>green", "led", "led>green>red", "led>red>red")
    image = np.array(llvm.render(scene, integrator=integrator, spp=4, seed=1))
    assert image.shape == (36, 48, 5)
    assert (image.mean(axis=(0, 1)) > 0.0).all()
    np.testing.assert_allclose(image[..., 3], 0.5 * image[..., 0], rtol=FLOAT32)
    np.testing.assert_allclose(image[..., 4], 0.25 * image[..., 0], rtol=FLOAT32)
    dark = np.array(llvm.render(scene, integrator=band_integrator(scene, DESIGN, shape), spp=4, seed=1))
    assert dark.shape == (36, 48, 3)
    assert dark[..., :2].max() == 0.0
    np.testing.assert_allclose(dark[..., 2], image[..., 2], rtol=FLOAT32)


@pytest.mark.renderer
def test_more_chains_at_one_wall_than_a_packet_of_texels_holds(llvm, paints):
    """Texels are fetched four chains at a time: nine chains end at the red wall here, and one at the green."""
    from sim.optics._band_paths import band_integrator

    scene, shape = build(llvm, paints)
    along = np.linspace(1.0, 2.0, TEXELS_ALONG)[:, None] * np.ones(TEXELS_UP)
    further = [f"led>{'>'.join(way)}>red" for way in (["green"], ["red"], *product(("red", "green"), repeat=2))]
    further += ["led>red>red>red>red", "led>green>green>green>red"]
    shares = dict(zip(further, 0.5 ** np.arange(1, 9), strict=True))
    light = {"led>red": along, "led>green": along, **{chain: share * along for chain, share in shares.items()}}
    integrator = band_integrator(scene, DESIGN, shape, light)
    image = np.array(llvm.render(scene, integrator=integrator, spp=4, seed=1))
    assert integrator.chains[3:] == tuple(further)
    assert image.shape == (36, 48, 11)
    assert image[..., 0].mean() > 0.0
    for k, share in enumerate(shares.values()):
        np.testing.assert_allclose(image[..., 3 + k], share * image[..., 0], rtol=FLOAT32)
    few = band_integrator(scene, DESIGN, shape, {"led>red": along, "led>green": along})
    np.testing.assert_allclose(
        image[..., :3], np.array(llvm.render(scene, integrator=few, spp=4, seed=1)), rtol=FLOAT32
    )


def test_one_panel_plus_one_panel_lights_the_painted_walls_like_two():
    """The direct light of the walls is calculated, so that it adds up exactly, film, beam and bending included."""
    found = []
    for first, second in ((1.0, 3.0), (1.0, 0.0), (0.0, 3.0)):
        design = DESIGN.model_copy(
            update={
                "light": DESIGN.light.model_copy(update={"power_rel": first}),
                "second_light": DESIGN.second_light.model_copy(update={"power_rel": second}),
            }
        )
        shape = bent(pressed_shape(design), BENDING_RADIUS_MM)
        found.append({wall: direct_irradiance(design, shape, wall, texel_uv()) for wall in ("red", "green")})
    both, one, other = found
    for wall in both:
        np.testing.assert_allclose(both[wall], one[wall] + other[wall], rtol=1e-12)
        assert (one[wall] > 0.0).any()
        assert (other[wall] > 0.0).any()


@pytest.mark.renderer
def test_one_panel_plus_one_panel_equals_two(llvm, paints):
    from sim.optics._band_paths import band_integrator

    faint = {"power_rel": 1e-9}
    cases = (
        {},
        {"light": DESIGN.light.model_copy(update=faint)},
        {"second_light": DESIGN.second_light.model_copy(update=faint)},
    )
    found = []
    for change in cases:  # both panels stay where they are: they also shade and reflect
        design = DESIGN.model_copy(update=change)
        scene, shape = build(llvm, paints, design)
        found.append(led_means(llvm, scene, shape, band_integrator(scene, design, shape), design))
    (both, both_error), (second, second_error), (first, first_error) = found
    assert max(both_error, second_error, first_error) < 0.03 * both
    assert abs(first + second - both) < STANDARD_ERRORS * np.sqrt(both_error**2 + second_error**2 + first_error**2)


@pytest.mark.renderer
def test_an_integrator_belongs_to_the_variant_that_is_set(llvm_choice, spectral_choice, paints):
    """The renderer refuses integrators of another variant: which one was set first must not matter."""
    shape, bands = rest_shape(DESIGN), paint_bands(paints["red"], paints["green"], DESIGN.light)
    for choice in (spectral_choice, llvm_choice, spectral_choice, llvm_choice):
        renderer = open_renderer(choice)
        from sim.optics._band_paths import band_integrator  # the first time in whatever variant is set

        integrator = band_integrator(finger_scene(DESIGN, shape, bands, renderer), DESIGN, shape)
        assert isinstance(integrator, renderer.Integrator)
