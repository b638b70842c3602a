"""Objectives of sensing: facets against a coat that really has them, exposures and tables by hand, and the verb."""

from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from data_schemas import AngleConstraints, AngleObjective, FingerDesign, LightPanel, SimulateError
from data_schemas._design_parts import TactileCamera
from data_schemas.storage import assumed_camera_response
from sim.experiments import PaintedFinger, light_angle_sweep
from sim.experiments import _light_angle as objectives
from sim.experiments import _light_angle as tables
from sim.experiments._light_angle import exposed_table, facet_shares, facet_slopes, frames_e, in_the_way
from sim.experiments._optics_products import EXPOSURE_S, tactile_sensor
from sim.optics import (
    ProbePaths,
    measure_together,
    paint_bands,
    seen_points,
    sweep_light_angle,
    tilt_shares,
    tilted_facets,
    with_light_angle,
)
from sim.optics._probes import probes_on
from sim.surface_meshes import FingerShape, gel_faces, rest_shape

DESIGN = FingerDesign(camera=TactileCamera(width_px=64, height_px=48))
ANGLES_DEG = [0.0, 60.0]
STANDARD_ERRORS = 4.0
REPEATS = 4
SLOPE = 0.2
SENSOR = tactile_sensor(DESIGN, 1)
FULL_E = (SENSOR.full_scale_dn - SENSOR.black_level_dn) * SENSOR.gain_e_per_dn


def with_ramps():
    """Return a finger whose coat rises by SLOPE across and along, each in a strip of 2 mm, and falls back beside it."""
    x, z = np.linspace(-17.5, 17.5, 71), np.linspace(0.0, 70.0, 141)
    height = np.full((x.size, z.size), 6.0)
    for from_middle in (x[:, None], z[None, :] - 35.0):
        height = height + SLOPE * from_middle * np.exp(-((from_middle / 2.0) ** 4))
    surfaces = {**rest_shape(DESIGN).surfaces, **gel_faces(x, height, z)}
    return FingerShape(surfaces, np.full(len(surfaces["coat"].vertices_mm), np.nan), "two ramps")


@pytest.mark.renderer
def test_a_facet_is_as_bright_as_a_coat_that_has_its_tilt(llvm, paints):
    # twelve places on each strip, away from the other
    free = np.concatenate([np.linspace(-12.0, -6.0, 6), np.linspace(6.0, 12.0, 6)])
    places = np.concatenate([np.column_stack([0.0 * free, 35.0 + free]), np.column_stack([free, 35.0 + 0.0 * free])])
    on_strip = [slice(0, 12), slice(12, 24)]
    ramps = sweep_light_angle(
        DESIGN, paints, llvm, ANGLES_DEG, ProbePaths(1000, REPEATS, 3), places, shape=with_ramps()
    )
    rest, bands = rest_shape(DESIGN), paint_bands(paints["red"], paints["green"], DESIGN.light)
    facets = tilted_facets(np.tile([[0.0, 1.0, 0.0]], (24, 1)), SLOPE * np.concatenate([np.eye(2), -np.eye(2)]))
    designs = [with_light_angle(DESIGN, angle) for angle in ANGLES_DEG]
    traced = measure_together(
        designs, rest, bands, llvm, probes_on(DESIGN, rest, places), facets, ProbePaths(1000, REPEATS, 5), None
    )
    for axis, bands_seen in ((0, [0, 1]), (1, [2])):
        there = ramps.radiance_rel[:, :, on_strip[axis]].mean(axis=2)
        here, other = (traced[:, :, facet, on_strip[axis]].mean(axis=2) for facet in (axis, axis + 2))
        error = np.hypot(*(v.std(axis=1, ddof=1) / np.sqrt(REPEATS) for v in (there, here)))
        there, here, other = (v.mean(axis=1) for v in (there, here, other))
        # the strip's own ends, 1.5 mm away and 0.3 mm high, shade the facet and light it a little
        margin = STANDARD_ERRORS * error + 0.1 * there
        assert (np.abs(here - there) < margin).all()
        # and the tilt is no small matter: across it exchanges red and green, along it turns the coat from the panel
        assert (np.abs(here - other) > 1.5 * margin)[:, bands_seen].all()


@pytest.mark.renderer
def test_facets_share_their_noise_and_the_derivative_does_not_depend_on_the_step(llvm, paints):
    points = seen_points(DESIGN, rest_shape(DESIGN), llvm, 3, 4)
    assert len(points.normals) == 12
    np.testing.assert_allclose(np.linalg.norm(points.probes.directions, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(points.probes.points_mm[:, [0, 2]], points.places_mm, atol=0.01)
    steps = np.tan(np.radians([2.0, 4.0]))
    slopes = np.array([[s * x, s * z] for s in steps for x, z in ((1, 0), (-1, 0), (0, 1), (0, -1))])
    facets = tilted_facets(points.normals, np.concatenate([[[0.0, 0.0]], slopes]))
    bands = paint_bands(paints["red"], paints["green"], DESIGN.light)
    traced = measure_together(
        [DESIGN], rest_shape(DESIGN), bands, llvm, points.probes, facets, ProbePaths(2000, 4, 1), None
    )[0]
    # mean over the pad, (repeat, facet, band)
    level = traced.mean(axis=2)
    small, large = (
        np.stack([level[:, k] - level[:, k + 1], level[:, k + 2] - level[:, k + 3]], axis=1) / (2.0 * step)
        for k, step in ((1, steps[0]), (5, steps[1]))
    )
    # a difference of 4 deg is worth 7 to 20 % of the level: the third order takes little from it
    strong = np.array([[True, True, False], [False, False, True]])
    ratio = (large.mean(axis=0) / small.mean(axis=0))[strong]
    np.testing.assert_allclose(ratio, 1.0, atol=0.05)
    # the random numbers are the same: facets differ much less than repeats of one facet do
    relative = level[:, 1] / level[:, 0]
    assert (relative.std(axis=0, ddof=1) < 0.5 * (level[:, 0].std(axis=0, ddof=1) / level[:, 0].mean(axis=0))).all()


def test_tilted_normals_stand_on_the_slopes():
    facets = tilted_facets(np.array([[0.0, 1.0, 0.0]]), np.array([[0.3, 0.0], [0.0, -0.2]]))
    np.testing.assert_allclose(facets.normals[0, 0], np.array([-0.3, 1.0, 0.0]) / np.sqrt(1.09), atol=1e-12)
    np.testing.assert_allclose(facets.normals[1, 0], np.array([0.0, 1.0, 0.2]) / np.sqrt(1.04), atol=1e-12)


def test_shares_of_tilts_add_up_over_the_coat():
    x, z = np.linspace(-17.5, 17.5, 3), np.linspace(0.0, 70.0, 8)
    flat, roof = np.full((3, 8), 6.0), np.broadcast_to(6.0 + 0.2 * np.maximum(z - 50.0, 0.0), (3, 8))
    rest, wedge = (
        FingerShape({**rest_shape(DESIGN).surfaces, **gel_faces(x, height, z)}, np.full(24, np.nan), "made up")
        for height in (flat, roof)
    )
    # 20 of 70 mm rise by atan 0.2 = 11.3 deg, nearest to 12
    np.testing.assert_allclose(tilt_shares(rest, wedge, np.array([0.0, 4.0, 12.0])), [5.0 / 7.0, 0.0, 2.0 / 7.0])
    shares = facet_shares(rest, wedge)
    np.testing.assert_allclose(shares, [5.0 / 7.0, 0, 0, 0, 0, *[0.5 / 7.0] * 4, 0, 0, 0, 0], atol=1e-12)
    with pytest.raises(SimulateError, match="the same mesh"):
        tilt_shares(rest_shape(DESIGN), with_ramps(), np.array([0.0, 10.0]))


def test_a_panel_in_the_mirror_does_not_fit():
    assert in_the_way(DESIGN.light, rest_shape(DESIGN)) == ""
    # the mirror runs from y = -20 mm at the base to -4.5 mm at the tip
    behind = LightPanel(position_mm=(0.0, -12.0, 35.0), angle_deg=0.0, height_mm=10.0)
    assert in_the_way(behind, rest_shape(DESIGN)) == "mirror"


def made_up(angles=3, repeats=2, points=12, seed=1):
    """Return colours that change with the slopes, the more the later the angle."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1.0, 1.0, (points, 2)) * [15.0, 30.0]
    gain = np.array([[-2.0, 0.3], [2.0, 0.3], [0.2, 2.5]])
    contrast = 0.2 * (1.0 + np.arange(angles))
    relative = 1.0 + contrast[:, None, None] * (facet_slopes() @ gain.T)
    level = rng.uniform(0.9, 1.1, (repeats, points))
    return level[None, :, :, None, None] * relative[:, None, None], places


def uniform_shares():
    return np.full(len(facet_slopes()), 1.0 / len(facet_slopes()))


def test_exposure_is_the_longest_that_clips_less_than_the_limit():
    rgb, places = made_up()
    table = exposed_table(rgb, places, uniform_shares(), SENSOR)
    # 12 points x 13 facets: one of them alone is 0.6 % of the picture, more than the limit
    np.testing.assert_allclose(table.signal_e.max(axis=(2, 3, 4)), tables.BRIGHT_SHARE * FULL_E)
    assert (table.clipped_share == 0.0).all()
    np.testing.assert_allclose(table.exposure_rel.min(), 1.0)
    # a glint that stands for less than the limit may clip, and costs no exposure
    shares = np.array([*np.full(12, 1.0 / 12.0), 0.0])
    glint = rgb.copy()
    glint[..., 12, :] *= 10.0
    glinting = exposed_table(glint, places, shares, SENSOR)
    np.testing.assert_allclose(
        glinting.signal_e[..., :12, :], exposed_table(rgb, places, shares, SENSOR).signal_e[..., :12, :]
    )
    assert glinting.signal_e[..., 12, :].max() > FULL_E
    assert (glinting.clipped_share < tables.CLIPPED_LIMIT).all()
    with pytest.raises(SimulateError, match="the coat is black"):
        exposed_table(np.zeros_like(rgb), places, uniform_shares(), SENSOR)


def test_objectives_prefer_the_angle_of_most_contrast_and_brightness_does_not_count():
    rgb, places = made_up()
    table = exposed_table(rgb, places, uniform_shares(), SENSOR)
    median, worst, held_out, even, colours = objectives.objectives_of(table, SENSOR, 3)
    # tilts of 20 deg across change red against green, the more the more contrast
    assert colours.larger_is_better
    assert (np.diff(colours.values.mean(axis=1)) > 0.0).all()
    assert held_out.places_mm is not None
    assert held_out.place_values is not None
    rows = [held_out.place_values[..., row] for row in range(len(held_out.places_mm))]
    points = [np.sum(objectives.rows_along(places[:, 1])[1] == row) for row in range(len(rows))]
    np.testing.assert_allclose(np.average(rows, axis=0, weights=points), held_out.values)
    for objective in (median, worst, held_out):
        assert not objective.larger_is_better
        assert (np.diff(objective.values.mean(axis=1)) < 0.0).all()
    assert (worst.values >= median.values).all()
    assert ((even.values > 0.0) & (even.values <= 1.0)).all()
    # four times brighter panels: the exposure takes it back
    brighter = exposed_table(4.0 * rgb, places, uniform_shares(), SENSOR)
    np.testing.assert_allclose(brighter.signal_e, table.signal_e)


def test_the_separation_is_the_angle_between_opposite_colours():
    rgb, places = made_up(angles=1, repeats=1)
    table = exposed_table(rgb, places, uniform_shares(), SENSOR)
    relative = rgb[0, 0, 0] / rgb[0, 0, 0, :1]
    expected = [
        np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
        for a, b in ((relative[9], relative[11]), (relative[10], relative[12]))
    ]
    np.testing.assert_allclose(objectives.colour_separations_deg(table), np.mean(expected), rtol=1e-6)


def test_rows_are_those_of_the_grid():
    z = np.repeat([7.0, 18.2, 29.4, 40.6, 51.8, 63.0], 5) + np.tile([-0.4, 0.3, 0.0, 0.2, -0.1], 6)
    places, row = objectives.rows_along(np.delete(z, slice(10, 15)))
    # a row that the camera does not see is no place
    assert places == pytest.approx([7.0, 18.2, 40.6, 51.8, 63.0])
    assert row.tolist() == np.repeat(np.arange(5), 5).tolist()


def test_the_derivative_is_that_of_the_linear_colours():
    rgb, places = made_up(angles=1, repeats=1)
    table = exposed_table(rgb, places, uniform_shares(), SENSOR)
    white = table.signal_e[0, 0, :, 0]
    gain = 0.2 * np.array([[-2.0, 0.3], [2.0, 0.3], [0.2, 2.5]])
    # inverse of F = sum over channels of g g' s^2 / v, point by point
    variance = (
        SENSOR.read_noise_e**2 + SENSOR.gain_e_per_dn**2 / 12.0 + SENSOR.dark_current_e_per_s * EXPOSURE_S + white
    )
    fisher = np.einsum("ci,cj,pc->pij", gain, gain, white**2 / variance)
    expected = np.degrees(np.sqrt(np.trace(np.linalg.inv(fisher), axis1=1, axis2=2) / 2.0))
    np.testing.assert_allclose(objectives.normal_sigmas_deg(table, SENSOR)[0, 0], expected, rtol=1e-9)


def test_colours_that_change_alike_are_refused():
    rgb, places = made_up()
    grey = np.repeat(rgb.mean(axis=-1, keepdims=True), 3, axis=-1)
    with pytest.raises(SimulateError, match="two independent ways"):
        objectives.objectives_of(exposed_table(grey, places, uniform_shares(), SENSOR), SENSOR, 1)


def test_frames_have_the_noise_that_the_bound_counts_with():
    signal_e = np.full((40, 13, 3), 800.0)
    frames = frames_e(signal_e, 20, SENSOR, EXPOSURE_S, np.random.default_rng(2))
    variance = tables.noise_variance_e2(signal_e[0, 0], SENSOR, EXPOSURE_S)[0]
    # the pattern of sensitivities (0.5 % of 800 e) and offsets (1 e) is the only further scatter; 31,200 values
    pattern = (SENSOR.prnu_rel * 800.0) ** 2 + SENSOR.dsnu_e**2
    assert frames.var() == pytest.approx(variance + pattern, rel=4.0 * np.sqrt(2.0 / frames.size))


def test_records_refuse_values_that_have_no_inverse_and_constraints_count():
    with pytest.raises(ValueError, match="made up: values must be positive"):
        AngleObjective(name="made up", meaning="", unit="deg", larger_is_better=False, values=np.array([[1.0, 0.0]]))
    with pytest.raises(ValueError, match="made up: place_values and places_mm must be given together"):
        AngleObjective(
            name="made up", meaning="", unit="deg", larger_is_better=False, values=np.ones((2, 2)),
            place_values=np.ones((2, 2, 3)),
        )  # fmt: skip
    constraints = AngleConstraints(
        clipped_share=np.array([0.0, 0.002, 0.0]),
        clipped_limit_share=0.001,
        exposure_rel=np.ones(3),
        in_the_way=("", "", "mirror"),
    )
    assert constraints.allowed.tolist() == [True, False, False]


def painted(paints, renderer):
    return PaintedFinger(DESIGN, paints, assumed_camera_response(), renderer)


def test_threads_do_not_wait_for_each_other_over_small_matrices(monkeypatch):
    """On a machine with other work, two threads of a fit of 1040 x 56 took 200 ms in place of one."""
    asked = []

    def recorded(*_given, **_named):
        asked.extend(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
        raise SimulateError("seen")

    monkeypatch.setattr(objectives, "sweep_light_angle", recorded)
    with threadpool_limits(limits=2, user_api="blas"), pytest.raises(SimulateError, match="seen"):
        light_angle_sweep(SimpleNamespace(design=DESIGN, paints={}, renderer=None), {}, [0.0], ProbePaths(), {})
    assert asked
    assert set(asked) == {1}


@pytest.mark.renderer
def test_all_objectives_of_a_finger(llvm, paints, monkeypatch):
    monkeypatch.setattr(objectives.angle_objectives, "__defaults__", (512, None, None))
    sweep = light_angle_sweep(
        painted(paints, llvm), {}, [0.0, 30.0, 60.0, 120.0], ProbePaths(100, 2, 1), {}, further_objectives=True
    )
    found, constraints = sweep.other_objectives, sweep.constraints
    assert constraints is not None
    assert sweep.values.shape == (4, 2)
    assert [o.values.shape for o in found] == [(4, 2)] * 5
    assert constraints.in_the_way == ("",) * 4
    assert constraints.allowed.all()
    # turned away from the pad, the panel leaves most of it dark: less even and harder to tell normals by
    sigma, worst, held_out, even, _ = (o.values.mean(axis=1) for o in found)
    assert sigma[3] > 1.5 * sigma[0]
    assert worst[3] > 1.5 * worst[0]
    assert even[3] < 0.7 * even[0]
    # to say "flat" each time would be as wrong as the mean tilt of the facets
    mean_tilt_deg = 4.0 * (4.0 + 12.0 + 20.0) / 13.0
    assert held_out[0] < min(held_out[3], mean_tilt_deg)


def test_a_scalar_renderer_is_refused(scalar, paints):
    with pytest.raises(SimulateError, match="need a compiled variant"):
        objectives.angle_objectives(painted(paints, scalar), np.eye(3)[None], [0.0, 30.0], 1)
    with pytest.raises(SimulateError, match="need a compiled variant"):
        light_angle_sweep(painted(paints, scalar), {}, [0.0, 30.0], ProbePaths(10, 2, 1), {}, further_objectives=True)


def test_a_pad_that_is_hardly_seen_is_refused(scalar):
    narrow = FingerDesign(camera=TactileCamera(width_px=64, height_px=48, field_of_view_deg=20.0))
    with pytest.raises(SimulateError, match="points spread over the pad, too few"):
        seen_points(narrow, rest_shape(narrow), scalar, 5, 6)
