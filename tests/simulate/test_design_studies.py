"""Design studies: the points of a plan, the metrics of images, what points share, and workers that fail and die."""

import os
import subprocess
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import colour
import numpy as np
import psutil
import pytest

from data_schemas import FingerSurfaces, PressMechanics, RecordError, SimulateError, StudyPoint, provenance
from data_schemas.storage import read_record, write_record
from data_schemas.storage._whole_files import part_name
from finray_calib.cli._study_run import stand_in_paints
from sim import preset_design
from sim.experiments import imprinted_shapes, paint_finger
from sim.mechanics._rigid_bodies import read_body
from sim.mechanics._skeleton import skeleton_mesh
from sim.optics import BAKE_SAMPLES, RenderSettings, choose_variant, open_renderer, render_press
from sim.studies import (
    SHIPPED_PLANS,
    StudyPaints,
    StudyTask,
    design_folder,
    point_code,
    point_file,
    read_plan,
    run_dataset,
    run_study,
    study_points,
)
from sim.studies import _engine as engine_module
from sim.studies import _point as point_module
from sim.studies._engine import _each, _Steps, open_workers
from sim.studies._point import (
    _mean_product,
    _metrics,
    _root,
    _Seen,
    _seen,
    compute_point,
    has_press,
    image_metrics,
    independent_halves,
    point_key,
    press_file,
    stored_point,
    vividness,
)
from sim.surface_meshes import everyday_objects, pressed_height_mm

ROOT = Path(__file__).resolve().parents[2]
HEAD = 'name = "a study"\n'


def plan_of(tmp_path, text):
    path = tmp_path / "plan.toml"
    path.write_text(HEAD + text)
    return read_plan(path)


def points_of(tmp_path, text):
    return study_points(*plan_of(tmp_path, text))


def vary(field, values):
    return f'[[vary]]\nfield = "{field}"\nvalues = {values}\n'


def test_a_grid_has_every_value_with_every_other(tmp_path):
    points = points_of(tmp_path, vary("light.angle_deg", [0.0, 30.0]) + vary("skeleton.rib_count", [5, 6, 7]))
    assert [point.number for point in points] == [1, 2, 3, 4, 5, 6]
    assert {(p.design.light.angle_deg, p.design.skeleton.rib_count) for p in points} == {
        (angle, ribs) for angle in (0.0, 30.0) for ribs in (5, 6, 7)
    }


def test_together_takes_the_values_in_step(tmp_path):
    text = 'combine = "together"\n' + vary("light.angle_deg", [0.0, 30.0]) + vary("indenter.depth_mm", [1.0, 2.0])
    assert [p.changes for p in points_of(tmp_path, text)] == [
        {"light.angle_deg": 0.0, "indenter.depth_mm": 1.0},
        {"light.angle_deg": 30.0, "indenter.depth_mm": 2.0},
    ]


def test_a_random_study_fills_its_box_evenly_and_repeats_itself(tmp_path):
    text = (
        'combine = "random"\ncount = 64\nseed = 4\n'
        '[[vary]]\nfield = "light.angle_deg"\nlow = 10.0\nhigh = 50.0\n'
        '[[vary]]\nfield = "skeleton.rib_count"\nlow = 4.0\nhigh = 8.0\n'
    )
    points = points_of(tmp_path, text)
    angles = np.array([p.design.light.angle_deg for p in points])
    # 64 points of a Sobol' sample: four in each sixteenth of the range
    assert np.histogram(angles, bins=16, range=(10.0, 50.0))[0].tolist() == [4] * 16
    assert {type(p.design.skeleton.rib_count) for p in points} == {int}
    assert [p.changes["skeleton.rib_count"] for p in points] == [p.design.skeleton.rib_count for p in points]
    assert [p.changes for p in points_of(tmp_path, text)] == [p.changes for p in points]


def test_what_a_point_changes_is_no_longer_the_paper_s(tmp_path):
    (point,) = points_of(tmp_path, '[set]\n"pad.length_mm" = 66.0\n' + vary("indenter.radius_mm", [8.0]))
    assert "pad.width_mm" in point.design.origin
    assert "pad.length_mm" not in point.design.origin
    assert "indenter.radius_mm" not in point.design.origin


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            vary("light.angel_deg", [1.0]),
            r"point 1 \(light\.angel_deg = 1\.0\): 'light\.angel_deg' is not a field of a d",
        ),
        (vary("second_light.angle_deg", [1.0]), r"is not a field of this finger, because it has no \[second_light\]"),
        (
            vary("pad.length_mm", [-3.0]),
            r"point 1 \(pad\.length_mm = -3\.0\): 'pad\.length_mm' \(in mm\): must be",
        ),
        (vary("preset", ["flat"]), r"there is no preset design 'flat'; valid names are flat-70x35"),
        (vary("preset", [3]), r"preset must be the name of a ready-made finger, got 3"),
        (vary("seed", [-1]), r"seed must be a whole number of 0 or more, got -1"),
        (vary("seed", [1.2, 1.7]), r"seed must be a whole number of 0 or more, got 1\.2"),
        (
            vary("skeleton.rib_count", [3.6, 4.2]),
            r"point 1 \(skeleton\.rib_count = 3\.6\): 'skeleton\.rib_count': must be a whole number, got 3\.6",
        ),
    ],
)
def test_a_point_that_is_no_finger_is_refused_by_number_and_field(tmp_path, text, message):
    with pytest.raises(SimulateError, match=message):
        points_of(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"vary"),
        ('[[vary]]\nfield = "seed"\n', r"vary seed: give either values, or low and high"),
        ('[[vary]]\nfield = "seed"\nlow = 2.0\nhigh = 1.0\n', r"low and high must both be given, and low must"),
        (vary("seed", [1, 1]), r"vary seed: 1 is listed twice in its values"),
        (
            'combine = "together"\n' + vary("seed", [1, 2, 1]) + vary("light.angle_deg", [5.0, 5.0, 5.0]),
            r"vary: the point \[1, 5\.0\] is listed twice",
        ),
        (vary("seed", [1]) + vary("seed", [2]), r"seed is given more than once; give it once"),
        ("[set]\nseed = 3\n" + vary("seed", [1]), r"seed is given more than once"),
        ("count = 4\n" + vary("seed", [1]), r'count must be given with combine = "random", and only then'),
        ('combine = "random"\ncount = 4\n' + vary("seed", [1]), r'combine = "random" needs low and high, not values'),
        ('[[vary]]\nfield = "seed"\nlow = 1.0\nhigh = 2.0\n', r'low and high .* with combine = "random"; give'),
        (
            'combine = "together"\n' + vary("seed", [1]) + vary("light.angle_deg", [1.0, 2.0]),
            r"must have the same",
        ),
        ("[measure]\nimages = false\n" + vary("seed", [1]), r'press = "analytic" without images computes nothing'),
    ],
)
def test_a_plan_that_contradicts_itself_is_refused(tmp_path, text, message):
    with pytest.raises(RecordError, match=message):
        plan_of(tmp_path, text)


def test_a_plan_that_is_not_there_names_those_that_come_with_the_package():
    with pytest.raises(
        RecordError, match=r"no such plan; give a plan file \(TOML\) or one of the shipped plans, everyday-objects, f"
    ):
        read_plan("pads.toml")


@pytest.mark.parametrize("name", SHIPPED_PLANS)
def test_every_shipped_plan_makes_points(name):
    points = study_points(*read_plan(name))
    assert len(points) == len({str(point.changes) for point in points}) >= 6


def test_a_value_may_come_again_in_another_point_of_together(tmp_path):
    text = 'combine = "together"\n' + vary("light.angle_deg", [0.0, 0.0]) + vary("indenter.depth_mm", [1.0, 2.0])
    assert [p.design.indenter.depth_mm for p in points_of(tmp_path, text)] == [1.0, 2.0]


def test_the_folder_of_a_shipped_study_does_not_hide_its_plan(tmp_path, monkeypatch):
    """The same command continues a study, whose folder has the name of the plan."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pad-shapes" / "points").mkdir(parents=True)
    plan, path = read_plan("pad-shapes")
    assert plan.name == "pad-shapes"
    assert path.is_file()


# everyday objects


def test_everyday_objects_are_the_same_closed_bodies_each_time(tmp_path):
    objects = everyday_objects()
    assert objects == everyday_objects()
    plan, path = read_plan("everyday-objects")
    points = study_points(plan, path)
    folder = design_folder(path, points, tmp_path)
    assert sorted(objects) == sorted(file.name for file in folder.iterdir())
    for point in points:
        read_body(folder / point.design.indenter.file)  # refuses what is open, twisted or inside out
        rest, pressed = imprinted_shapes(point.design, folder)
        depth = (rest.surfaces["coat"].vertices_mm - pressed.surfaces["coat"].vertices_mm)[:, 1]
        # the grid of 0.2 mm may miss the lowest place; the smooth minimum rounds by 0.15 ln 2 at most
        assert depth.max() == pytest.approx(point.design.indenter.depth_mm, abs=0.03)
        assert (pressed.contact_distance <= 1.0).any()


def test_the_imprint_of_a_can_is_the_analytic_press_of_its_cylinder(tmp_path):
    (tmp_path / "can.stl").write_bytes(everyday_objects()["can.stl"])
    design = preset_design("flat-70x35")
    can = design.indenter.model_copy(update={"shape": "mesh", "file": "can.stl", "depth_mm": 1.2})
    cylinder = design.indenter.model_copy(update={"radius_mm": 33.0, "depth_mm": 1.2})
    assert imprinted_shapes(design.model_copy(update={"indenter": cylinder})) is None
    _, pressed = imprinted_shapes(design.model_copy(update={"indenter": can}), tmp_path)
    x, y, z = pressed.surfaces["coat"].vertices_mm.T
    analytic = pressed_height_mm(design.model_copy(update={"indenter": cylinder}), np.unique(x), np.unique(z))
    off = np.abs(y.reshape(analytic.shape) - analytic)
    # the rim of the contact is found to a step of the grid (0.2 mm), at a slope of 0.27
    assert off.max() < 0.06
    assert off.mean() < 0.01


def test_another_content_of_an_indenter_s_file_is_another_point(tmp_path):
    text = '[set]\n"indenter.shape" = "mesh"\n' + vary("indenter.file", ["it.stl"])
    keys = set()
    for press in ("analytic", "finite elements"):
        for content in (b"one", b"two"):
            (tmp_path / "it.stl").write_bytes(content)
            task, (point,) = study_of(tmp_path, f'[measure]\npress = "{press}"\n' + text)
            keys |= {point_key(task, point), press_file(task, point.design)}
    assert len(keys - {None}) == 6


def test_another_content_of_a_file_of_the_camera_is_another_point_where_there_are_pictures(tmp_path):
    kept = []
    for images in ("true", "false"):
        for content in ("one", "two"):
            (tmp_path / "camera.csv").write_text(content)
            text = f'[measure]\npress = "finite elements"\nimages = {images}\n[set]\n"camera.response" = "camera.csv"\n'
            task, (point, *_) = study_of(tmp_path, text + vary("light.angle_deg", [0.0, 30.0]))
            kept.append(point_key(task, point))
    assert kept[0] != kept[1]
    assert kept[2] == kept[3]


# metrics


def test_products_of_independent_rows_know_no_noise():
    rng = np.random.default_rng(5)
    signal = rng.normal(size=20_000)
    noisy = signal + rng.normal(scale=3.0, size=(3, signal.size))
    # the product of two rows has a standard deviation of 9 per value: 9 / sqrt(3 x 20,000) of the mean square 1
    assert _root(_mean_product(noisy)) == pytest.approx(1.0, abs=4 * 0.5 * 9.0 / np.sqrt(60_000))
    assert np.sqrt((noisy.mean(axis=0) ** 2).mean()) > 1.9
    assert _root(_mean_product(np.array([[1.0, -1.0], [-1.0, 1.0], [0.0, 0.0]]))) == 0.0


def test_vividness_is_the_chroma_of_another_library():
    grey = np.full((5, 3), [0.2, 0.4, 0.7])
    assert vividness(grey) == pytest.approx(0.0, abs=0.02)  # the library's white differs from sRGB's in the 5th digit
    rgb = np.random.default_rng(2).uniform(0.05, 1.0, size=(40, 3))
    balanced = np.clip(0.18 * rgb / rgb.mean(axis=0), 0.0, 1.0)
    lab = colour.XYZ_to_Lab(
        colour.RGB_to_XYZ(balanced, "sRGB"), colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    )
    assert vividness(rgb) == pytest.approx(np.hypot(lab[:, 1], lab[:, 2]).mean(), abs=0.05)


def test_shares_and_variation_are_those_of_a_coat_whose_light_is_known():
    light = np.array([[3.0, 1.0, 1.0], [1.0, 3.0, 1.0], [1.0, 3.0, 1.0], [1.0, 1.0, 9.0]])
    rgb = np.repeat(np.array([[1.0], [2.0], [3.0], [2.0]]), 3, axis=1)
    one = _Seen(light, rgb, np.full(6, 2.0), np.full(6, 2.5))
    found = _metrics([one, one, one])
    assert [found[f"{name}_share"] for name in ("red", "green", "blue")] == [0.25, 0.5, 0.25]
    assert found["variation_rel"] == pytest.approx(np.std([1, 2, 3, 2]) / 2.0)
    assert found["touch_rel"] == pytest.approx(0.25**2)
    assert found["brightness_rel"] == pytest.approx(2.0)


@pytest.mark.parametrize("touch", [0.0, 0.1, 0.5])
def test_limits_of_the_touch_hold_it_also_where_it_drowns_in_noise(monkeypatch, touch):
    """95 % limits from six halves, 40 cells, noise of 0.4 a cell; in 300 worlds at most three standard errors fewer."""
    rng, held, lows = np.random.default_rng(9), 0, []
    flat = np.ones((3, 3))
    for _ in range(300):
        signal = touch * rng.choice([-1.0, 1.0], size=40)
        seen = [
            _Seen(flat, flat, np.ones(40), 1.0 + signal + rng.normal(scale=0.4, size=40)) for _ in range(6)
        ]  # fmt: skip
        monkeypatch.setattr(point_module, "_seen", lambda design, one, matrix: one)
        found = {m.name: m for m in image_metrics(preset_design("flat-70x35"), seen, np.eye(3))}["touch_rel"]
        assert 0.0 <= found.low95 <= found.value <= found.high95
        held += found.low95 <= touch <= found.high95
        lows.append(found.low95)
    assert held >= 300 * 0.95 - 3 * np.sqrt(300 * 0.95 * 0.05)
    assert (np.median(lows) > 0.0) == (touch > 0.2)


@pytest.mark.renderer
def test_the_halves_of_a_render_are_independent_and_make_it_together(monkeypatch):
    """Their noise, of few paths and a coarse bake, over cells of the coat; a common bake would make them alike."""
    monkeypatch.setitem(BAKE_SAMPLES, False, 8_000)
    camera = preset_design("flat-70x35").camera.model_copy(update={"width_px": 160, "height_px": 120})
    design = preset_design("flat-70x35").model_copy(update={"camera": camera})
    optics, _ = stand_in_paints()
    renderer = open_renderer(choose_variant("auto"), threads=1)
    finger = paint_finger(design, optics, Path(), renderer)
    renders = [render_press(design, finger.paints, renderer, RenderSettings("b", seed, 32)) for seed in range(6)]
    halves = [independent_halves(render) for render in renders]
    for render, (one, two) in zip(renders, halves, strict=True):
        assert np.allclose(0.5 * (one.contact_bands + two.contact_bands), render.contact_bands, atol=1e-9)
        assert np.abs(one.no_contact_bands - two.no_contact_bands).max() > 0.0
    matrix = finger.camera_matrix(renders[0].bands)
    light = np.array([[_seen(design, half, matrix).light for half in pair] for pair in halves])
    noise = (light - light.mean(axis=(0, 1))) / light.mean(axis=(0, 1, 2))
    one, two = noise[:, 0].ravel(), noise[:, 1].ravel()
    # each has its own noise, less the mean of all twelve, which alone makes them alike by -1/11
    alike = (one @ two) / np.sqrt((one @ one) * (two @ two))
    assert -0.4 < alike < 0.2
    whole = replace(renders[0], variant="scalar_rgb")
    assert independent_halves(whole) == (whole,)


# workers


def behave(task, point):
    """Fail, die or work, by the seed of a point."""
    if point.seed == 1:
        raise SimulateError("no equilibrium")
    if point.seed == 2:
        os._exit(7)
    Path(task.folder, f"{point.number}").write_text("done")


def tried(task, point):
    try:
        behave(task, point)
    except SimulateError as error:
        return str(error)
    return None


def test_a_point_that_fails_or_kills_its_worker_stops_no_other(tmp_path):
    plan, path = plan_of(tmp_path, vary("seed", [0, 1, 2, 3, 4]))
    points = study_points(plan, path)
    task = StudyTask(plan, StudyPaints({}, {}), "scalar", tmp_path, tmp_path, provenance("a test", {}, 1))
    told = []
    with open_workers(2) as workers:
        ended = {
            point.seed: reason
            for point, reason in _each(workers, tried, task, points, _Steps(5, lambda *step: told.append(step)), "")
        }
    assert ended.pop(2).startswith("its worker process died twice")
    assert ended == {0: None, 1: "no equilibrium", 3: None, 4: None}
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.isdecimal()) == ["1", "4", "5"]
    assert [done for done, _, _ in told] == [1, 2, 3, 4, 5]


def study_of(tmp_path, text, sources=None):
    plan, path = plan_of(tmp_path, text)
    paints = StudyPaints({}, sources or {})
    task = StudyTask(plan, paints, "auto", tmp_path / "out", tmp_path, provenance("a test", {}, 1))
    return task, study_points(plan, path)


def test_a_folder_of_another_study_is_refused(tmp_path):
    task, points = study_of(tmp_path, vary("light.angle_deg", [0.0, 30.0]), {"red": "one", "green": "two"})
    file = point_file(task.folder, 1)
    file.parent.mkdir(parents=True)
    other = StudyPoint(
        study="a study", number=1, key="0" * 64, changes={}, design=points[0].design, metrics=(), processor_s=1.0
    )
    write_record(other, file, task.origin)
    with pytest.raises(SimulateError, match=r"00001\.json: was computed from another plan, design, paint or seed"):
        run_study(task, points, workers=1)


OLDER = {"package_version": "0.0.9", "git_commit": "ab" * 20, "git_dirty": False}


def test_a_point_of_other_code_is_kept_and_computed_anew_when_asked(tmp_path):
    task, (point, _) = study_of(tmp_path, vary("light.angle_deg", [0.0, 30.0]))
    record = StudyPoint(
        study="a study", number=1, key=point_key(task, point), changes=point.changes, design=point.design, metrics=(),
        processor_s=1.0,
    )  # fmt: skip
    file = point_file(task.folder, 1)
    file.parent.mkdir(parents=True)
    renewing = replace(task, renew=True)
    for origin, is_other in ((task.origin, False), (task.origin.model_copy(update=OLDER), True)):
        file.unlink(missing_ok=True)
        write_record(record, file, origin)
        assert stored_point(task, point) is not None
        assert (stored_point(renewing, point) is None) is is_other
    assert point_code(task, stored_point(task, point)) == f"finray-calib 0.0.9, commit {'ab' * 6}"


def latest(record_type):
    folders = (ROOT / "tests/schemas/frozen" / record_type.__name__).glob("v*")
    return read_record(max(folders, key=lambda v: int(v.name[1:])) / "example.json", record_type)


def test_a_point_whose_press_is_of_other_code_is_computed_anew_when_asked(tmp_path):
    text = '[measure]\npress = "finite elements"\nimages = false\n' + vary("light.angle_deg", [0.0])
    task, (point,) = study_of(tmp_path, text)
    surfaces = press_file(task, point.design)
    mechanics = surfaces.with_name(surfaces.name.replace("surfaces", "mechanics"))
    surfaces.parent.mkdir(parents=True)
    older, renewing = task.origin.model_copy(update=OLDER), replace(task, renew=True)
    write_record(latest(FingerSurfaces), surfaces, older)
    write_record(latest(PressMechanics), mechanics, older)
    compute_point(task, point)
    told = point_code(task, stored_point(task, point))
    assert told == f"{task.origin.code}; its press by finray-calib 0.0.9, commit {'ab' * 6}"
    assert has_press(task, surfaces)
    assert not has_press(renewing, surfaces)
    assert stored_point(renewing, point) is None

    mechanics.unlink()
    write_record(latest(PressMechanics), mechanics, task.origin)  # as if it had been pressed anew
    assert has_press(renewing, surfaces)
    file = point_file(task.folder, 1)
    kept = read_record(file, StudyPoint)
    file.unlink()
    write_record(kept, file, older)
    assert stored_point(renewing, point) is None
    compute_point(renewing, point)
    assert stored_point(renewing, point).provenance.code == task.origin.code


def test_a_point_is_known_by_design_paints_seed_and_measure(tmp_path):
    text = vary("light.angle_deg", [0.0])
    task, (point,) = study_of(tmp_path, text, {"red": "one"})
    others = [
        study_of(tmp_path, text, {"red": "another"}),
        study_of(tmp_path, "seed = 2\n" + text, {"red": "one"}),
        study_of(tmp_path, "[measure]\nsamples = 2\n" + text, {"red": "one"}),
        study_of(tmp_path, vary("light.angle_deg", [1.0]), {"red": "one"}),
    ]
    keys = {point_key(task, point), *(point_key(other, *points) for other, points in others)}
    assert len(keys) == 5


def test_points_that_differ_in_the_light_share_their_press(tmp_path):
    text = '[measure]\npress = "finite elements"\n'
    task, points = study_of(
        tmp_path, text + vary("light.angle_deg", [0.0, 30.0]) + vary("indenter.position_mm", [20.0, 35.0])
    )
    files = [press_file(task, point.design) for point in points]
    assert files[0] == files[2] != files[1] == files[3]


def test_points_whose_panels_move_the_base_plate_do_not_share_their_press(tmp_path):
    """The base plate lies below all panels, so that a panel that reaches lower lengthens the skeleton."""
    text = '[measure]\npress = "finite elements"\n'
    task, points = study_of(tmp_path, text + vary("light.height_mm", [4.0, 12.0]))
    meshes = [skeleton_mesh(point.design, 4.0) for point in points]
    lowest_mm = [mesh.nodes_mm[:, 2].min() for mesh in meshes]
    assert lowest_mm[1] < lowest_mm[0] - 1.0
    files = [press_file(task, point.design) for point in points]
    assert files[0] != files[1]


LIGHTS_DEG = [float(angle) for angle in range(0, 100, 10)]


def presses_of_ten_lights(tmp_path, monkeypatch, press):
    """Run a study of ten lights in this process; return the design of each press, the points, and those that failed."""
    text = '[measure]\npress = "finite elements"\nimages = false\nincrements = 2\n'
    finger = 'design = "baby-48x18"\n[set]\n"indenter.depth_mm" = 0.3\n'
    task, points = study_of(tmp_path, finger + text + vary("light.angle_deg", LIGHTS_DEG))
    pressed = []

    def counted(design, *given, **options):
        pressed.append(design)
        return press(design, *given, **options)

    monkeypatch.setattr(point_module, "press_as_designed", counted)
    monkeypatch.setattr(engine_module, "open_workers", lambda *given: nullcontext())
    monkeypatch.setattr(
        engine_module, "_each", lambda _workers, compute, task, jobs, *_: ((job, compute(task, job)) for job in jobs)
    )
    return pressed, *run_study(task, points, workers=1)


def test_a_study_of_ten_lights_on_one_press_presses_once(tmp_path, monkeypatch):
    pressed, kept, failed = presses_of_ten_lights(tmp_path, monkeypatch, point_module.press_as_designed)
    assert (len(pressed), failed) == (1, [])
    assert [record.design.light.angle_deg for record in kept] == LIGHTS_DEG
    forces = {metric.value for record in kept for metric in record.metrics if metric.name == "force_n"}
    assert len(forces) == 1
    assert forces.pop() > 0.0


def test_a_press_that_lights_do_not_share_is_counted_for_each(tmp_path, monkeypatch):
    """The poison of the test above: a press known by its light, too, is made ten times."""
    known_by = point_module.press_file

    def by_light(task, design):
        file = known_by(task, design)
        return file.with_name(f"{design.light.angle_deg:g}-{file.name}")

    def refused(*given, **options):
        raise SimulateError("counted, not pressed")

    for module in (point_module, engine_module):
        monkeypatch.setattr(module, "press_file", by_light)
    pressed, kept, failed = presses_of_ten_lights(tmp_path, monkeypatch, refused)
    assert (len(pressed), kept, len(failed)) == (len(LIGHTS_DEG), [], len(LIGHTS_DEG))


def test_everything_listens_on_the_loopback_interface_only():
    with open_workers(1):
        own = psutil.Process()
        listening = [
            connection.laddr.ip
            for process in (own, *own.children(recursive=True))
            for connection in process.net_connections()
            if connection.status == psutil.CONN_LISTEN
        ]
    assert listening
    assert {ip for ip in listening if ip != "::1"} == {"127.0.0.1"}


def test_a_scheduler_that_does_not_answer_is_told(tmp_path):
    task, points = study_of(tmp_path, vary("light.angle_deg", [0.0]))
    with pytest.raises(SimulateError, match=r"--scheduler tcp://127\.0\.0\.1:1: no Dask scheduler answers there"):
        run_study(task, points, scheduler="tcp://127.0.0.1:1")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a small disk")
def test_a_full_disk_loses_nothing_that_is_finished(tmp_path):
    """What did not fit is told, leaves no part behind, and is computed once there is room."""
    disk = tmp_path / "out"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "none", str(disk)], check=False).returncode:
        pytest.skip("this machine mounts no small disk")
    try:
        task, points = study_of(tmp_path, vary("seed", [0, 1, 2]))
        (disk / "filler").write_bytes(b"0" * 150_000)
        reasons = {}
        with open_workers(1) as workers:
            reasons |= {p.number: r for p, r in _each(workers, stored_big_point, task, points, _Steps(3, None), "")}
            full = [number for number, reason in reasons.items() if reason is not None]
            assert full
            assert all("No space left on device" in reasons[number] for number in full)
            kept = {path: path.read_bytes() for path in (disk / "points").glob("*.json")}
            assert len(kept) == 3 - len(full)
            assert not [path for path in (disk / "points").iterdir() if path.name.startswith(".")]
            (disk / "filler").unlink()
            left = [point for point in points if stored_point(task, point) is None]
            assert [p.number for p in left] == full
            ended = [r for _, r in _each(workers, stored_big_point, task, left, _Steps(len(left), None), "")]
        assert ended == [None] * len(full)
        assert all(path.read_bytes() == content for path, content in kept.items())
        assert all(stored_point(task, point) is not None for point in points)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def stored_big_point(task, point):
    """Store the record of a point, of 40 kB that cannot be made smaller; return why not."""
    image = np.random.default_rng(point.seed).random((60, 58, 3)).astype(np.float32)
    record = StudyPoint(
        study="a study", number=point.number, key=point_key(task, point), changes=point.changes, design=point.design,
        metrics=(), contact=image, processor_s=1.0,
    )  # fmt: skip
    try:
        write_record(record, point_file(task.folder, point.number), task.origin)
    except RecordError as error:
        return str(error)
    return None


@pytest.mark.parametrize(("run", "kept"), [(run_dataset, "shards"), (run_study, "points"), (run_study, "presses")])
def test_what_a_killed_run_left_beside_its_last_result_is_collected(tmp_path, run, kept):
    """Nothing is left to compute, so that no writer enters the folder again."""
    (tmp_path / kept).mkdir()
    part = tmp_path / kept / part_name("00000.json", "0123abcd")
    part.write_bytes(b"half of")
    (tmp_path / kept / "00000.json").write_bytes(b"whole")
    run(SimpleNamespace(folder=tmp_path), [])
    assert [path.name for path in (tmp_path / kept).iterdir()] == ["00000.json"]
