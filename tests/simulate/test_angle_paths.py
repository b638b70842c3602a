"""Paths for all light angles at once against a scene with the panel in place, one angle after the other."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from data_schemas import FingerDesign, LightPanel, SimulateError
from data_schemas._design_parts import TactileCamera
from sim.optics import (
    TEXELS_ALONG,
    LoadedScene,
    ProbePaths,
    bake_walls,
    last_band,
    open_scene,
    paint_bands,
    sweep_light_angle,
)
from sim.optics._painted_walls import TEXELS_UP
from sim.optics._path_rules import even_points, even_points_of_groups
from sim.optics._probes import probes_on
from sim.optics._render import lit_integrator
from sim.surface_meshes import bent, pressed_shape

CAMERA = TactileCamera(width_px=64, height_px=48)
TIP = LightPanel(position_mm=(0.0, -10.0, 71.0), angle_deg=150.0)
STANDARD_ERRORS = 4.0
REPEATS, SAMPLES = 6, 2000
ANGLE_DEG = 50.0
XZ_MM = np.array([[-5.0, 29.0], [5.0, 41.0]])


def one_by_one(design, paints, renderer, points_mm):
    """Return (repeat, probe, band) with the panel as a surface of the scene, as pictures are rendered."""
    shape, bands = pressed_shape(design), paint_bands(paints["red"], paints["green"], design.light)
    scene, values = open_scene(design, shape, bands, renderer), []
    for repeat, light in enumerate(
        bake_walls(LoadedScene(scene, design, shape, bands, renderer), "b", 7, 10_000, REPEATS)
    ):
        integrator, chains = lit_integrator(scene, design, shape, renderer, light)
        origins = np.repeat(points_mm * [1.0, 0.5, 1.0], SAMPLES, axis=0).T.astype(np.float32)
        sampler = renderer.load_dict({"type": "independent"})
        sampler.seed(repeat, origins.shape[1])
        rays = renderer.Ray3f(renderer.Point3f(np.ascontiguousarray(origins)), renderer.Vector3f(0.0, 1.0, 0.0))
        radiance, _, further = integrator.sample(scene, sampler, rays, None, renderer.Bool(True))
        channels = np.stack([*radiance.numpy(), *(np.array(channel) for channel in further)]).astype(float)
        means = channels.reshape(len(chains), -1, SAMPLES).mean(axis=2)
        of_band = [[k for k, c in enumerate(chains) if last_band(c) == band] for band in ("red", "green", "led")]
        values.append(np.stack([means[k].sum(axis=0) for k in of_band], axis=-1))
    return np.array(values)


@pytest.mark.renderer
@pytest.mark.parametrize(
    "change",
    [
        {"light": LightPanel(position_mm=(0.0, -8.0, 10.0), beam_exponent=4.0)},
        {"second_light": TIP},
    ],
    ids=["narrow beam farther in", "two lights"],
)
def test_all_angles_at_once_see_what_each_angle_sees(llvm, paints, change):
    design = FingerDesign(camera=CAMERA, **change)
    sweep = sweep_light_angle(design, paints, llvm, [0.0, ANGLE_DEG], ProbePaths(2 * SAMPLES, REPEATS, 3), XZ_MM)
    turned = design.light.model_copy(update={"angle_deg": ANGLE_DEG})
    there = one_by_one(design.model_copy(update={"light": turned}), paints, llvm, sweep.probe_points_mm)
    # the mean over the probes, band by band: the bake's noise is common to them
    here, there = sweep.radiance_rel[1].mean(axis=1), there.mean(axis=1)
    error = np.hypot(*(v.std(axis=0, ddof=1) / np.sqrt(REPEATS) for v in (here, there)))
    assert (error < 0.15 * there.mean(axis=0)).all()
    assert (np.abs(here.mean(axis=0) - there.mean(axis=0)) < STANDARD_ERRORS * error).all()


@pytest.mark.renderer
def test_the_panel_keeps_light_of_the_walls_away_in_each_of_its_poses(llvm, paints):
    from sim.optics._angle_paths import AnglePaths
    from sim.optics._band_paths import band_integrator

    # before the middle of the pad: flat over it at 90 deg, on edge at 0 deg
    light = LightPanel(position_mm=(0.0, -14.0, 35.0), width_mm=30.0, height_mm=20.0, angle_deg=90.0)
    flat, paths = FingerDesign(camera=CAMERA, light=light), 200_000
    on_edge = flat.model_copy(update={"light": light.model_copy(update={"angle_deg": 0.0})})
    away = light.model_copy(update={"position_mm": (0.0, -200.0, 35.0)})
    shape, bands = pressed_shape(flat), paint_bands(paints["red"], paints["green"], light)
    origins, directions = (np.tile(v, (paths, 1)) for v in ([[0.0, 0.5, 35.0]], [[0.0, 1.0, 0.0]]))
    tracer = AnglePaths(open_scene(flat, shape, bands, llvm), flat, shape, [flat.light, on_edge.light, away])
    seen = tracer.trace(origins, directions, paths, 1, from_wall=False)
    there = []
    for design in (flat, on_edge):
        scene = open_scene(design, shape, bands, llvm)
        parameters = llvm.traverse(scene)
        parameters["panel0.bsdf.reflectance.value"] = llvm.Color3f(0.0)
        parameters.update()
        bright = {f"led>{wall}": np.ones((TEXELS_ALONG, TEXELS_UP)) for wall in ("red", "green")}
        sampler = llvm.load_dict({"type": "independent"})
        sampler.seed(2, paths)
        rays = llvm.Ray3f(*(k(np.ascontiguousarray(v.T, dtype=np.float32)) for k, v in (
            (llvm.Point3f, origins), (llvm.Vector3f, directions))))  # fmt: skip
        integrator = band_integrator(scene, design, shape, bright)
        there.append(integrator.sample(scene, sampler, rays, None, llvm.Bool(True))[0].numpy()[:2].sum(axis=0))
    here, means = seen.by_wall.sums()[:, 0], np.mean(there, axis=1)
    error = np.hypot(1.0, 1.0) * np.std(there, axis=1) / np.sqrt(paths)
    assert (np.abs(here[:2] - means) < STANDARD_ERRORS * error).all()
    # on edge, 7 % are kept away: far more than the noise could hide
    assert here[2] - here[1] > 2.0 * STANDARD_ERRORS * error[1]


@pytest.mark.renderer
def test_an_angle_is_found_as_if_it_were_alone(llvm, paints):
    """What is shared leaves no trace: the same paths, each with its own panel in the way."""
    design, paths = FingerDesign(camera=CAMERA), ProbePaths(SAMPLES, 2, 4)
    together = sweep_light_angle(design, paints, llvm, [0.0, 30.0, 60.0, 110.0], paths, XZ_MM).radiance_rel
    for k, angle in ((1, 30.0), (3, 110.0)):
        alone = sweep_light_angle(design, paints, llvm, [angle], paths, XZ_MM).radiance_rel[0]
        np.testing.assert_allclose(together[k], alone, rtol=1e-5)


@pytest.mark.renderer
def test_no_meeting_is_lost_where_there_are_more_than_was_made_room_for(llvm, paints, monkeypatch):
    from sim.optics import _angle_paths

    # flat before the middle of the pad it keeps away most of what leaves through the inner face
    light = LightPanel(position_mm=(0.0, -14.0, 35.0), width_mm=30.0, height_mm=20.0, angle_deg=90.0)
    design, paths, found = FingerDesign(camera=CAMERA, light=light), ProbePaths(SAMPLES, 1, 4), []
    for share in (4.0, 1e-6):
        monkeypatch.setattr(_angle_paths, "_MEETINGS_LOGGED", share)
        found.append(sweep_light_angle(design, paints, llvm, [90.0], paths, XZ_MM).radiance_rel)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)
    # the poison of this test: it sees where no meeting is counted
    none = csr_array((2, 2 * TEXELS_ALONG * TEXELS_UP), dtype=np.float32)
    walls = csr_array((none.shape[1],) * 2, dtype=np.float32)
    monkeypatch.setattr(
        _angle_paths.AnglePaths, "_kept_away", lambda _tracer, _log, groups, _: (none if groups == 2 else walls,)
    )
    forgotten = sweep_light_angle(design, paints, llvm, [90.0], paths, XZ_MM).radiance_rel
    assert forgotten[..., :2].sum() > 1.005 * found[0][..., :2].sum()


def test_even_points_are_uniform_and_even():
    rng = np.random.default_rng(2)
    points = even_points(1000, 3, rng)
    assert points.shape == (1000, 3)
    assert ((points >= 0.0) & (points < 1.0)).all()
    # a tenth of each axis holds a tenth of the points to a few, where random numbers would scatter by ten
    for axis in points.T:
        assert np.abs(np.histogram(axis, 10, (0.0, 1.0))[0] - 100).max() <= 4
    groups = even_points_of_groups(2, 1000, 3, np.random.default_rng(2)).reshape(2, 1000, 3)
    np.testing.assert_array_equal(groups[0], points)
    assert np.ptp((groups[1] - points) % 1.0, axis=0).max() < 1e-9  # the second one is the first one, shifted
    # another shift gives independent means
    means = [even_points(50, 2, rng)[:, 0].mean() for _ in range(400)]
    assert abs(np.mean(means) - 0.5) < 4.0 * np.std(means) / 20.0


@pytest.mark.renderer
def test_a_sweep_follows_a_bent_finger(llvm, paints):
    shape = bent(pressed_shape(FingerDesign()), 150.0)
    sweep = sweep_light_angle(FingerDesign(), paints, llvm, [0.0, 60.0], ProbePaths(4000, 4, 5), XZ_MM, shape=shape)
    flat = sweep_light_angle(FingerDesign(), paints, llvm, [0.0, 60.0], ProbePaths(4000, 4, 5), XZ_MM)
    np.testing.assert_allclose(sweep.probe_points_mm, probes_on(FingerDesign(), shape, XZ_MM).points_mm)
    # the same random numbers: bent to 150 mm, the painted bands gain 4 to 8 %, within their noise of some per cent
    ratio = (sweep.radiance_rel.mean((1, 2)) / flat.radiance_rel.mean((1, 2)))[:, :2]
    assert (ratio != 1.0).all()
    assert (np.abs(ratio - 1.06) < 0.2).all()


@pytest.mark.renderer
def test_a_panel_that_reaches_into_the_gel_at_a_later_angle_is_refused(llvm, paints):
    # 4 mm high at y = -1.9: half its height times cos(angle) is 1.0 mm at 60 deg and 2 mm at 0 deg
    design = FingerDesign(camera=CAMERA, light=LightPanel(position_mm=(0.0, -1.9, -6.0), height_mm=4.0))
    with pytest.raises(SimulateError, match="gel"):
        sweep_light_angle(design, paints, llvm, [60.0, 0.0], ProbePaths(10, 1, 1), XZ_MM)
