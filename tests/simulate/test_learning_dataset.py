"""Data sets for learning: what is drawn, what a sample holds against surfaces and renders, and shards that keep."""

import io
import tarfile
import time
from dataclasses import replace

import numpy as np
import pytest

from data_schemas import DatasetPlan, FingerDesign, PathPose, SimulateError, provenance
from finray_calib.cli._study_run import stand_in_paints
from sim import preset_design
from sim.experiments import (
    DEPTH_ZERO,
    FingerScene,
    PaintDraws,
    Rendering,
    SamplePaints,
    paint_finger,
    recoloured,
    render_noise_rel,
    render_samples,
    sampled_paints,
    simulate_press,
)
from sim.experiments._learning_samples import encoded_depth, encoded_normal, encoded_picture
from sim.experiments._sensor_press import surface_of
from sim.optics import RenderSettings, choose_variant, open_renderer, pixel_maps
from sim.optics import _render as renders
from sim.studies import DatasetTask, planned_shards, run_dataset, sampled_light, sampled_press
from sim.studies import _dataset as datasets
from sim.studies import _engine as engines
from sim.surface_meshes import FingerShape, contact_half_width_mm, gel_faces, pressed_shape, rest_shape
from tests.simulate.shards import read_shard


def plan_of(**changes):
    design = preset_design("baby-48x18")
    camera = design.camera.model_copy(update={"width_px": 96, "height_px": 72})
    known = {"design": design.model_copy(update={"camera": camera}), "radius_mm": (3.0, 5.0), "depth_mm": (0.4, 1.2)}
    return DatasetPlan(**{**known, "presses_per_shard": 2, "lights": 1, "paints": 2, "samples_per_pixel": 2, **changes})


@pytest.fixture(scope="module")
def paints():
    optics, _ = stand_in_paints()
    return {colour: PaintDraws(paint, paint.emission_per_nm[None]) for colour, paint in optics.items()}


def task_of(folder, paints, **changes):
    sources = dict.fromkeys(paints, "a stand-in")
    return DatasetTask(plan_of(**changes), paints, sources, "auto", folder, folder, provenance("a test", {}, 1))


def test_presses_are_drawn_by_their_number_alone_and_their_contact_lies_on_the_pad():
    plan = plan_of(shapes=("ball", "cylinder"))
    designs = [sampled_press(plan, press) for press in range(400)]
    assert designs[7] == sampled_press(plan, 7)
    for design in designs:
        half, indenter = float(contact_half_width_mm(design)), design.indenter
        assert half <= indenter.position_mm <= design.pad.length_mm - half
        assert indenter.shape == "ball" or indenter.across_mm == 0.0
        assert abs(indenter.across_mm) <= design.pad.width_mm / 2.0 - (half if indenter.shape == "ball" else 0.0)
    for name, low, high in (("radius_mm", 3.0, 5.0), ("depth_mm", 0.4, 1.2)):
        values = np.array([getattr(design.indenter, name) for design in designs])
        # four standard errors of the mean of 400 even draws
        assert values.mean() == pytest.approx((low + high) / 2.0, abs=4.0 * (high - low) / np.sqrt(12.0 * 400))
    balls = sum(design.indenter.shape == "ball" for design in designs)
    assert abs(balls - 200) < 4 * 10


def test_a_path_that_moves_aside_stays_on_the_pad():
    """A ball that is pressed in, dragged 8 mm towards the base and 3 mm across, and drawn back a little."""
    poses = ({"push_mm": 1.0}, {"push_mm": 1.0, "along_mm": -8.0, "across_mm": 3.0}, {"push_mm": 0.5, "along_mm": 1.0})
    design = plan_of().design
    indenter = design.indenter.model_copy(update={"path": tuple(PathPose(**pose) for pose in poses)})
    plan = plan_of(design=design.model_copy(update={"indenter": indenter}), press="finite elements", shapes=("ball",))
    ends = []
    for press in range(400):
        pressed = sampled_press(plan, press)
        half = float(contact_half_width_mm(pressed))
        for pose in (PathPose(), *pressed.indenter.path):
            along, across = pressed.indenter.position_mm + pose.along_mm, pressed.indenter.across_mm + pose.across_mm
            ends.append(
                (min(along, pressed.pad.length_mm - along) - half, pressed.pad.width_mm / 2 - abs(across) - half)
            )
    # the contact lies on the pad, and no part of the pad is left out: of 400 even draws some come near each edge
    assert np.min(ends, axis=0) == pytest.approx(0.0, abs=0.3)
    assert np.min(ends) >= -1e-9
    far = indenter.model_copy(update={"path": (PathPose(push_mm=1.0, along_mm=45.0),)})
    with pytest.raises(SimulateError, match=r"and indenter\.path moves it aside"):
        planned_shards(plan_of(design=design.model_copy(update={"indenter": far}), press="finite elements"), 2)


def test_lights_turn_within_their_reach_and_differ_from_press_to_press():
    plan = plan_of(light_angle_reach_deg=3.0)
    angles = [sampled_light(plan, plan.design, press, light).light.angle_deg for press in range(50) for light in (0, 1)]
    assert len(set(angles)) == 100
    assert max(abs(angle - plan.design.light.angle_deg) for angle in angles) <= 3.0
    # the largest of 100 even draws stays within 0.9 of the reach with a probability below 1e-4
    assert max(abs(angle - plan.design.light.angle_deg) for angle in angles) > 0.9 * 3.0


@pytest.mark.parametrize("angle_deg", [178.0, -178.0])
def test_lights_turned_past_half_a_turn_are_the_same_angle_less_a_turn(angle_deg):
    plan = plan_of(light_angle_reach_deg=45.0)
    light = plan.design.light.model_copy(update={"angle_deg": angle_deg})
    designs = [sampled_light(plan, plan.design.model_copy(update={"light": light}), k, 0) for k in range(20)]
    turned = [(design.light.angle_deg - angle_deg + 180.0) % 360.0 - 180.0 for design in designs]
    assert min(turned) < 0.0 < max(turned)
    assert max(np.abs(turned)) <= 45.0 + 1e-9  # rounding of the turn
    for design in designs:
        assert FingerDesign.model_validate(design.model_dump()).light == design.light


def test_a_set_grows_by_whole_shards_without_changing_those_it_has(tmp_path, paints):
    task = task_of(tmp_path, paints)
    few, many = planned_shards(task.plan, 4), planned_shards(task.plan, 7)
    assert [list(shard.presses) for shard in many] == [[0, 1], [2, 3], [4, 5], [6]]
    assert [datasets.shard_key(task, shard) for shard in few] == [datasets.shard_key(task, s) for s in many[:2]]
    assert [datasets.split_of(press) for press in range(20)].count("test") == 2


@pytest.mark.parametrize(
    "changes",
    [{"radius_mm": (3.0, 6.0)}, {"lights": 2}, {"seed": 2}, {"samples_per_pixel": 4}, {"emission_ratio": 1.5},
     {"light_angle_reach_deg": 1.0}, {"shapes": ("cylinder",)}, {"press": "finite elements"}],
)  # fmt: skip
def test_each_part_of_a_plan_is_part_of_the_key(tmp_path, paints, changes):
    first, other = task_of(tmp_path, paints), task_of(tmp_path, paints, **changes)
    shard = planned_shards(first.plan, 2)[0]
    assert datasets.shard_key(first, shard) != datasets.shard_key(other, shard)


@pytest.mark.parametrize("field", ["response", "calibration"])
def test_another_content_of_a_file_of_the_camera_is_another_set(tmp_path, paints, field):
    design = plan_of().design
    camera = design.camera.model_copy(update={field: "camera.txt"})
    task = task_of(tmp_path, paints, design=design.model_copy(update={"camera": camera}))
    shard, keys = planned_shards(task.plan, 2)[0], []
    for content in ("one", "two", "one"):
        (tmp_path / "camera.txt").write_text(content)
        keys.append(datasets.shard_key(task, shard))
    assert keys[0] == keys[2] != keys[1]


def test_an_indenter_that_does_not_fit_is_refused_before_anything_is_computed():
    with pytest.raises(SimulateError, match=r"a ball of 40 mm radius, 3 mm deep, leaves no room on the pad of 48 x 18"):
        planned_shards(plan_of(radius_mm=(3.0, 40.0), depth_mm=(0.4, 3.0)), 2)
    with pytest.raises(SimulateError, match=r"goes through the pad"):
        planned_shards(plan_of(depth_mm=(0.4, 4.5)), 2)
    with pytest.raises(ValueError, match="the range must not run downwards, from 5 to 3 mm"):
        plan_of(radius_mm=(5.0, 3.0))


def test_a_shard_has_no_time_and_no_owner_and_reads_back_by_the_rules_of_webdataset(tmp_path):
    members = [
        ("000001.json", b'{"press": 1}'),
        ("000001.rgb.png", b"1"),
        ("000002.json", b"{}"),
        ("000002.rgb.png", b"2"),
    ]
    content = datasets.shard_bytes(members)
    assert content == datasets.shard_bytes(members)
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        assert {(info.mtime, info.uid, info.uname, info.mode) for info in archive} == {(0, 0, "", 0o644)}
    (tmp_path / "shard.tar").write_bytes(content)
    assert read_shard(tmp_path / "shard.tar") == [
        {"__key__": "000001", "json": {"press": 1}, "rgb.png": b"1"},
        {"__key__": "000002", "json": {}, "rgb.png": b"2"},
    ]


@pytest.mark.renderer
def test_depth_and_normals_are_those_of_the_pressed_surface():
    design = sampled_press(plan_of(depth_mm=(1.0, 1.2)), 3)
    rest, pressed = rest_shape(design), pressed_shape(design)
    maps = pixel_maps(design, pressed, rest, open_renderer(choose_variant("auto"), threads=1))
    seen = maps.sees("coat")
    x, z = maps.position_mm[seen][:, 0], maps.position_mm[seen][:, 2]

    surface = surface_of(design)
    everywhere = np.meshgrid(np.linspace(-9.0, 9.0, 181), np.linspace(0.0, 48.0, 481), indexing="ij")
    bent_xx, bent_xz, bent_zz = (
        np.abs(surface.ev(*everywhere, dx=dx, dy=dy)).max() for dx, dy in ((2, 0), (1, 1), (0, 2))
    )
    depth_mm = (encoded_depth(maps)[seen].astype(float) - DEPTH_ZERO) / 1e3
    off_mm = np.abs(depth_mm - (design.pad.thickness_mm - surface.ev(x, z)))
    # sag of triangles of 0.5 x 0.1 mm where the surface is bent most, and half a micrometre of rounding
    assert off_mm.max() < bent_xx * 0.5**2 / 8.0 + bent_xz * 0.5 * 0.1 / 4.0 + bent_zz * 0.1**2 / 8.0 + 0.5e-3
    # most of the coat is hardly bent: rounding alone
    assert np.median(off_mm) < 0.5e-3
    normal = (encoded_normal(maps)[seen].astype(float) - 1.0) / 32767.0 - 1.0
    assert np.abs(np.linalg.norm(normal, axis=1) - 1.0).max() < 1e-4
    for across, cell_mm, bent, slope in (
        (0, 0.5, bent_xx, surface.ev(x, z, dx=1)),
        (2, 0.1, bent_zz, surface.ev(x, z, dy=1)),
    ):
        off = np.abs(-normal[:, across] / normal[:, 1] - slope)
        # a vertex's normal is a mean over the faces around it: a slope turns by its bend over half a cell
        assert off.max() < bent * cell_mm / 2.0
        assert np.median(off) < 1e-4
    assert (encoded_depth(maps)[~seen] == 0).all()
    assert (encoded_normal(maps)[~seen] == 0).all()


@pytest.mark.renderer
def test_pictures_are_those_of_a_render_of_the_same_press_recoloured(paints):
    design = sampled_press(plan_of(), 0)
    optics = {colour: paint.optics for colour, paint in paints.items()}
    finger = paint_finger(design, optics, None, open_renderer(choose_variant("auto"), threads=1))
    look = sampled_paints(finger, paints, 1.5, np.random.default_rng(2))
    assert all(1.0 / 1.5 <= factor <= 1.5 for factor in look.factors.values())
    (truth,), render = render_samples(finger, [look], RenderSettings("b", 5, 2))
    press = simulate_press(FingerScene(finger), Rendering(seed=5, samples_per_pixel=2), {})
    shown = recoloured(press, look.optics)
    for stored, image in ((truth.rest, shown.no_contact), (truth.contact, shown.contact)):
        wanted = encoded_picture(image, np.array(truth.gains))
        # single precision may round a level otherwise
        assert np.abs(stored.astype(int) - wanted.astype(int)).max() <= 1
        assert (stored == wanted).mean() > 0.999
    coat = render.no_contact_maps.sees("coat")
    assert (np.array(truth.gains) * shown.no_contact[coat].mean(axis=0)) == pytest.approx([0.18] * 3, rel=1e-5)


@pytest.mark.renderer
def test_a_channel_that_sees_no_light_stays_dark(paints):
    """Such as blue behind a filter of long wavelengths: its gain was infinite, and its picture 0 times that."""
    optics = {colour: paint.optics for colour, paint in paints.items()}
    finger = paint_finger(sampled_press(plan_of(), 0), optics, None, open_renderer(choose_variant("auto"), threads=1))
    blind = finger.response[2].model_copy(update={"values": np.zeros_like(finger.response[2].values)})
    finger = replace(finger, response=(*finger.response[:2], blind))
    (truth,), render = render_samples(finger, [SamplePaints(optics, {}, {})], RenderSettings("b", 5, 2))
    assert truth.gains[2] == 1.0
    assert truth.rest[..., 2].max() == truth.contact[..., 2].max() == 0
    coat = render.no_contact_maps.sees("coat")
    assert truth.rest[..., :2][coat].mean() > 50.0  # middle grey is 118
    assert 0.0 < render_noise_rel(finger, render) < np.inf


def test_a_paint_that_returns_more_light_than_it_gets_is_drawn_again(paints):
    class Finger:
        design = plan_of().design

    bright = {
        colour: PaintDraws(p.optics, np.stack([p.optics.emission_per_nm * 1e4, p.optics.emission_per_nm]))
        for colour, p in paints.items()
    }
    rng = np.random.default_rng(0)
    assert all(sampled_paints(Finger, bright, 1.0, rng).draws == {"red": 1, "green": 1} for _ in range(5))
    hopeless = {colour: PaintDraws(p.optics, p.emission_per_nm[:1]) for colour, p in bright.items()}
    with pytest.raises(SimulateError, match="none of 50 draws of the paints conserves energy"):
        sampled_paints(Finger, hopeless, 1.0, rng)


def test_only_shapes_that_may_pass_through_themselves_are_searched(monkeypatch):
    searched = []
    monkeypatch.setattr(renders, "check_no_intersections", searched.append)
    shape = pressed_shape(sampled_press(plan_of(), 0))
    renders.check_apart(shape, is_analytic=True)
    assert not searched
    renders.check_apart(shape, is_analytic=False)
    assert len(searched) == 1
    x, z = np.linspace(-9.0, 9.0, 19), np.linspace(0.0, 48.0, 49)
    through = 4.0 - 4.1 * np.exp(-(x[:, None] ** 2 + (z - 24.0) ** 2) / 10.0)
    faces = gel_faces(x, through, z)
    nowhere = np.full(len(faces["coat"].vertices_mm), np.nan)
    renders.check_apart(FingerShape({**shape.surfaces, **faces}, nowhere, "below its plane"), is_analytic=True)
    assert len(searched) == 2


def test_a_shard_that_the_disk_shows_late_is_told_and_taken_up_by_the_next_run(tmp_path, paints, monkeypatch):
    """The disk of this computer shows nothing for a while of what the workers have written."""
    monkeypatch.setattr(engines, "WAIT_FOR_FILES_S", 3.0)
    task = task_of(tmp_path, paints, presses_per_shard=1)
    shards = planned_shards(task.plan, 2)
    look, shown_at_s, computed = datasets.stored_shard, {0: np.inf, 1: np.inf}, []

    def late(task, shard):
        return look(task, shard) if time.monotonic() > shown_at_s[shard.number] else None

    def here(compute, task, jobs, *_):
        """Compute in this process, which sees at once what it has written."""
        for shard in jobs:
            shown_at_s[shard.number] = -np.inf
            reason = compute(task, shard)
            computed.append(shard.number)
            shown_at_s[shard.number] = time.monotonic() + (1.0 if shard.number == 0 else np.inf)
            yield shard, reason

    monkeypatch.setattr(datasets, "stored_shard", late)
    monkeypatch.setattr(datasets, "each_computed", here)
    kept, failed = run_dataset(task, shards, workers=1)
    # the first one came within the wait; the second one did not, and is told
    assert [record.number for record in kept] == [0]
    assert [failure.press for failure in failed] == [1]
    assert f"does not see it in {tmp_path} after 3 s" in failed[0].reason
    shown_at_s[1] = -np.inf
    kept, failed = run_dataset(task, shards, workers=1)
    assert [record.number for record in kept] == [0, 1]
    assert failed == []
    assert computed == [0, 1]  # nothing was computed again
