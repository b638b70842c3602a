"""Pixels that share light: node weights, points on the walls, and the picture against the path tracer's."""

import numpy as np
import pytest

from benchmarks.fluorescence_levels import finger
from benchmarks.fluorescence_levels import paints as glowing_paints
from data_schemas import SimulateError
from sim.optics import LoadedScene, RenderSettings, paint_bands, render_press
from sim.optics._painted_walls import TEXELS_ALONG, TEXELS_UP
from sim.optics._render import open_guide, open_scene
from sim.surface_meshes import rest_shape

pytestmark = pytest.mark.renderer


@pytest.fixture
def gathers(llvm):
    from sim.optics import _shared_gathers  # needs the variant set

    return _shared_gathers


def test_nodes_stand_for_a_light_that_is_quadratic_in_place_and_linear_in_height(gathers):
    rng = np.random.default_rng(0)
    nodes = np.stack(np.meshgrid(np.arange(0.0, 36.0), np.arange(0.0, 71.0, 2.0)), axis=-1).reshape(-1, 2)
    places = rng.uniform((0.0, 0.0), (35.0, 70.0), (50, 2))

    def height(p):
        return 1.5 * np.exp(-((p - [17.0, 40.0]) ** 2).sum(axis=-1) / 30.0)

    def light(p):
        x, z = p.T
        return 2.0 + 0.1 * x - 0.02 * z + 0.004 * x * x - 0.001 * x * z + 0.0005 * z * z + 0.3 * height(p)

    weights = gathers.regression_weights(places, nodes, height(places), height(nodes))
    # the term of the height is held back a little where the coat is flat: 1e-6 of the kernel's weight
    np.testing.assert_allclose(weights @ light(nodes), light(places), rtol=1e-3)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-4)


def test_bins_hold_the_directions_that_are_drawn_in_them(llvm, gathers):
    import drjit as dr

    bins = gathers.DirectionBins.of(np.array([[0.6, 0.1, 0.0]]))
    assert bins.lowest_cosine <= -0.1
    assert bins.lowest_cosine > -0.2
    numbers = np.arange(bins.count)
    for x, y in ((0.02, 0.03), (0.5, 0.5), (0.97, 0.98)):
        drawn = bins.direction(dr.arange(llvm.UInt32, bins.count), llvm.Float(x), llvm.Float(y)).numpy().T
        np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-6)
        np.testing.assert_array_equal(bins.of_directions(drawn), numbers)


def test_draws_from_a_list_of_directions_bring_all_light_in_the_mean(gathers):
    """Every direction that is lit is listed, as often as its weight says; the chances of all add up to 1."""
    rng = np.random.default_rng(0)
    lit = rng.random((2, 5, 300)) * (rng.random((5, 300)) < 0.5)
    sent = lit**4
    # a place that the LED does not reach, and a dark one
    lit[1, 3], lit[:, 4], sent[1, 3], sent[:, 4] = 0.0, 0.0, 0.0, 0.0
    lists = gathers.choices_of(list(lit), list(sent))
    for place in range(4):
        bins, over_chance = lists[place].T
        light = rng.random(300) * (lit[:, place] > 0.0).any(axis=0)
        np.testing.assert_allclose((light[bins.astype(int)] * over_chance).mean(), light.sum(), rtol=1e-5)
        # nearly as often as it matters: the light that is sent itself would hardly vary between draws
        value = lit[0, place][bins.astype(int)] * over_chance
        evenly = lit[0, place][lit[0, place] > 0.0]
        assert value.std() / value.mean() < 1.5 * evenly.std() / evenly.mean()
    assert (lists[4] == 0.0).all()


@pytest.mark.parametrize(("x_mm", "z_mm"), [(-17.3, 20.0), (-12.0, 35.0), (5.0, 66.0)])
def test_points_on_a_wall_cover_its_solid_angle(llvm, gathers, x_mm, z_mm):
    """Closed form: a corner of a rectangle a x b at a distance d covers atan(a b / (d sqrt(a^2 + b^2 + d^2)))."""
    import drjit as dr

    design = finger(64)
    shape = rest_shape(design)
    scene = open_scene(design, shape, paint_bands(*glowing_paints().values(), design.light), llvm)
    pad = design.pad
    radiance = np.ones((1, 2, TEXELS_ALONG, TEXELS_UP, 3))
    walls = gathers.LitWalls(radiance, shape, pad.thickness_mm, pad.length_mm)
    count = 20_000
    start = llvm.Point3f(dr.full(llvm.Float, x_mm, count), pad.thickness_mm - 0.3, z_mm)
    si = scene.ray_intersect(llvm.Ray3f(start, llvm.Vector3f(0.0, 1.0, 0.0)))
    sampler = llvm.load_dict({"type": "independent"})
    sampler.seed(1, count)
    sample = tuple(sampler.next_1d() for _ in range(3))
    seen, _, solid_angle, _ = walls.aim(scene, si, 0, sample, llvm.Bool(True))
    values = np.array(dr.select(seen, solid_angle, 0.0), dtype=np.float64)
    a, d = pad.thickness_mm, x_mm + pad.width_mm / 2.0
    expected = sum(np.arctan(a * b / (d * np.sqrt(a * a + b * b + d * d))) for b in (z_mm, pad.length_mm - z_mm))
    error = values.std() / np.sqrt(count)
    assert abs(values.mean() - expected) < 4.0 * error
    assert error < 0.02 * expected


def test_every_node_lies_on_the_coat(llvm, gathers, monkeypatch):
    """With this rim the outer nodes lie on edges of the mesh, which a ray may slip through."""
    import drjit as dr

    monkeypatch.setattr(gathers, "_RIM_MM", 0.1)
    design = finger(64)
    shape, bands = rest_shape(design), paint_bands(*glowing_paints().values(), design.light)
    scene = open_scene(design, shape, bands, llvm)
    nodes = gathers.Nodes(LoadedScene(scene, design, shape, bands, llvm), np.full((1, 2), 0.5), np.eye(3)[1:2])
    si = nodes.seen(scene, dr.arange(llvm.UInt32, nodes.count))
    assert np.array(si.shape == nodes.coat).all()
    assert nodes.count == 36 * 36


@pytest.fixture
def shared_at_rest(llvm, gathers, monkeypatch):
    """Return a maker of shared light of a finger at rest with walls of even light, two batches."""
    monkeypatch.setattr(gathers, "RAYS", 16)
    design = finger(64)
    shape, bands = rest_shape(design), paint_bands(*glowing_paints().values(), design.light)
    scene = open_scene(design, shape, bands, llvm)
    guide, lit = open_guide(scene, design, shape, llvm), LoadedScene(scene, design, shape, bands, llvm)

    def made(wall_radiance):
        emission = np.full((4, TEXELS_ALONG, TEXELS_UP), wall_radiance)
        light = {f"led>{wall}": emission for wall in ("red", "green")}
        return gathers.SharedGathers(lit, light, np.zeros((4, 2, TEXELS_ALONG, TEXELS_UP, 3)), guide, 1)

    return made


def test_points_between_places_are_read_by_their_bilinear_weights(gathers, shared_at_rest):
    nodes = shared_at_rest(0.0).nodes
    places = nodes.grid(gathers.PLACE_MM)
    light = 2.0 + places @ [0.3, -0.7]
    np.testing.assert_allclose(nodes.between(nodes.uv) @ light, 2.0 + nodes.uv @ [0.3, -0.7], rtol=1e-6)


def test_a_sharing_that_is_a_fifth_too_dark_is_mended_by_what_the_nodes_send(gathers, shared_at_rest, monkeypatch):
    """By construction: whatever the sharing does wrong, what nodes send in the mean is by their own paths."""
    right = gathers.regression_weights
    monkeypatch.setattr(gathers, "regression_weights", lambda *places: 0.8 * right(*places))
    found = {}

    def kept(self, sent, shared):
        found["sent"], found["shared"] = sent, shared
        found["missed"] = missed(self, sent, shared)
        return found["missed"]

    missed = gathers.SharedGathers.missed_at_nodes
    monkeypatch.setattr(gathers.SharedGathers, "missed_at_nodes", kept)
    shared_at_rest(1.0)
    own, shared, mended = (
        values.mean(axis=(0, 1))[:2] for values in (found["sent"], found["shared"], found["shared"] + found["missed"])
    )
    assert (shared / own < 0.85).all()
    # what smoothing leaves out of the mean is second order: walls of even light change slowly over the pad
    np.testing.assert_allclose(mended / own, 1.0, atol=0.02)


def test_a_panel_seen_by_smooth_faces_is_found_by_the_pixel_or_shared_but_not_both(llvm, gathers, shared_at_rest):
    """All light of the panels but the straight one, by paths from the coat: shared and the pixel's add up to it."""
    import drjit as dr

    from sim.optics._panel_light import FROM_EYE, FROM_SURFACE

    shared, count = shared_at_rest(0.0), 200_000
    scene = shared.finger.scene

    def led(kind, seed):
        sampler = llvm.load_dict({"type": "independent"})
        sampler.seed(seed, count)
        si = shared.nodes.seen(scene, dr.arange(llvm.UInt32, count) % shared.nodes.count)
        numbers = [sampler.next_1d() for _ in range(8)]
        if kind == "by pixel":
            values = gathers.mirrored_light(shared, scene, sampler, si, numbers, llvm.UInt32(0), llvm.Bool(True))
        else:
            way, density = shared.drawn(si, numbers[:4], 0.8)
            value = si.bsdf().eval(llvm.BSDFContext(), si, si.to_local(way))
            start = FROM_SURFACE if kind == "all" else FROM_EYE
            found = gathers.arriving_light(shared, scene, sampler, si.spawn_ray(way), llvm.UInt32(0), start)
            values = dr.select(density > 0.0, value.z * found[2] / density, 0.0)
        values = np.array(values, dtype=np.float64)
        return values.mean(), values.std() / np.sqrt(count)

    everything, kept, by_pixel = (led(kind, 3 + k) for k, kind in enumerate(("all", "shared", "by pixel")))
    error = np.sqrt(everything[1] ** 2 + kept[1] ** 2 + by_pixel[1] ** 2)
    # either part is much more than the error: counted twice or not at all it would be seen
    assert by_pixel[0] > 5.0 * error
    assert kept[0] > 10.0 * error
    assert abs(kept[0] + by_pixel[0] - everything[0]) < 4.0 * error


def test_the_picture_is_the_path_tracers_with_less_noise(llvm):
    design = finger(64)
    shared = render_press(design, glowing_paints(), llvm, RenderSettings(seed=3, shared_light=True))
    traced = render_press(design, glowing_paints(), llvm, RenderSettings(seed=3, samples_per_pixel=512))
    coat = shared.contact_maps.sees("coat")
    ratio = shared.contact_bands[coat].sum(axis=0) / traced.contact_bands[coat].sum(axis=0)
    # over some 200 pixels the path tracer's means have errors of 1 % (LED, with rare bright paths: 2 %), and the shared
    # ones, common to all pixels, of 1 %; without the light straight from walls and panels a half would be missing
    assert (np.abs(ratio - 1.0) < [0.05, 0.05, 0.1]).all(), ratio
    assert (shared.contact_variance[coat] > 0.0).all()
    assert shared.label.endswith("pixels share light")
    # with 16 paths per pixel instead of 512 the median noise would be 5.7 times as much
    noise = [np.median(np.sqrt(r.contact_variance[coat]) / r.contact_bands[coat], axis=0) for r in (shared, traced)]
    assert (noise[0][:2] < 2.0 * noise[1][:2]).all()


def test_sharing_is_refused_where_it_is_not_possible(scalar, paints):
    with pytest.raises(SimulateError, match="level c cannot share light"):
        RenderSettings("c", shared_light=True)
    with pytest.raises(SimulateError, match="--shared-light needs a compiled variant"):
        render_press(finger(64), paints, scalar, RenderSettings(shared_light=True))
