"""Every verb of several files, killed and refused by the system at every call that touches a file it writes.

    python -m benchmarks.commit_points --out bench-out/commit-points.json [--verbs decide ...] [--every 1]

A point is a call that opens, writes, names, removes or synchronises something below the output folders. At each, one
process is killed (in the middle of a write), and one each is told ENOSPC, EIO and EACCES. Then what is there is looked
at, and the same command runs again: nothing stored before may be harmed, no half set may pass for whole, the second
run must complete with the same content, and nothing may stay. What takes time is computed once and replayed. Bar: no
failure.
"""

import argparse
import contextlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from data_schemas import FingerDesign, NoEquilibriumError, provenance
from data_schemas.storage import write_record
from rigs import camera_plan, paint_plan, simulated_rig, write_plan, write_rig
from sim import design_toml
from sim.experiments._design_search import DesignSearch
from sim.mechanics import STEPS
from sim.mechanics._finger_mesh import MeshSteps
from tests.command_line.records import capture_of, press, sweep, with_known_camera
from tests.command_line.running import succeed
from tests.command_line.test_check_verb import PLAN as CHECK
from tests.command_line.test_compare_force_verb import bench
from tests.command_line.test_mechanics_verb import FINGER as PRESSED
from tests.command_line.verb_faults import ERRORS, Command, Replay, Tries, replaying
from tests.compare.board_scenes import FISHEYE, SIZE_PX, picture, poses
from tests.compare.force_curves import INCREMENTS_MM, force_at, power_law_press
from tests.compare.test_tone_curve import pair
from tests.documentation.example_records import example_results
from tests.exchange.ball_press_folders import write_catalog, write_taxim
from tests.exchange.recipe_folders import write_fots
from tests.exchange.taxim_presses import closed_form_presses
from tests.exchange.test_abaqus_results import DESIGN as ABAQUS_DESIGN
from tests.exchange.test_abaqus_results import results
from tests.exchange.test_render_folder import LINEAR, write_render
from tests.exchange.test_taxim_export import SENSOR

FINGER = (
    'preset = "flat-70x35"\nname = "small finger"\n'
    "[camera]\nwidth_px = 64\nheight_px = 48\n[indenter]\ndepth_mm = 0.2\n"
)
STUDY = """
kind = "design"
name = "two angles"
[set]
"camera.width_px" = 160
"camera.height_px" = 120
[measure]
samples = 2
[[vary]]
field = "light.angle_deg"
values = [0.0, 40.0]
"""
PAINTS = "--paint red={i}/fitted.paint.json --paint green={i}/fitted.paint.json"
RENDERED = (
    "finray_calib._finger_functions:_scene",
    "sim.experiments._rendered_press:simulate_press",
    "sim.experiments._optics_products:simulate_images",
    "finray_calib.cli._simulate:_views",
)
COMPARED = (
    "finray_calib.compare._comparison_record:compare_checked",
    "finray_calib.reports._comparison_page:comparison_page",
)
COMMANDS = {
    "decide": Command(
        "decide {i}/sweep.json --photometric-error {i}/report.json --out {o}/d.json",
        "d.json",
        ("finray_calib.decide._decision_record:decide", "finray_calib.reports._decision_page:decision_page"),
    ),
    "fit --report": Command(
        "fit {i}/bands.json --out {o}/red.paint.json --report {e}/red.html",
        "red.paint.json",
        ("finray_calib.fit._paint_calibration:calibrate_paint", "finray_calib.reports._fit_page:paint_report"),
    ),
    "fit --map": Command(
        "fit {i}/pixels.json --map --paint {i}/fitted.paint.json --out {o}/red.map.json",
        "red.map.json",
        ("finray_calib.fit._pixel_maps:map_paint", "finray_calib.reports._fit_figures:paint_map_figure"),
    ),
    "radiometry --pixels": Command(
        "radiometry {i}/session --pixels --out {o}/red.bands.json",
        "red.bands.json",
        (
            "finray_calib.radiometry._session_steps:session_steps",
            "finray_calib.radiometry._band_signals:bands_of_steps",
            "finray_calib.radiometry._pixel_signals:pixel_signals",
        ),
    ),
    "radiometry --report": Command(
        "radiometry {i}/camera --out {o}/c.camera.json --report {e}/c.html",
        "c.camera.json",
        (
            "finray_calib.radiometry._camera_characterisation:characterise_camera",
            "finray_calib.reports._camera_page:camera_page",
        ),
    ),
    "compare": Command("compare {i}/press.json {i}/capture.json --out {o}/e.json", "e.json", COMPARED),
    "compare, folders": Command(
        "compare {i}/simulated {i}/captured --out {o}/pairs", "pairs/summary.json", COMPARED, (".photometric-error.",)
    ),
    "compare --force": Command(
        "compare {i}/power.mechanics.json --force {i}/bench.csv --out {o}/f.json",
        "f.json",
        (
            "finray_calib.force._force_comparison:compare_force",
            "finray_calib.reports._comparison_figures:force_figure_png",
        ),
    ),
    "simulate": Command(
        f"simulate render {{i}}/finger.toml {PAINTS} --engine scalar --samples 2 --out {{o}}/p.press.json",
        "p.press.json",
        RENDERED,
    ),
    "simulate render --images": Command(
        f"simulate render {{i}}/finger.toml {PAINTS} --images --engine scalar --samples 2 --out {{o}}/p.press.json",
        "p.press.json",
        RENDERED,
    ),
    "simulate press": Command(
        "simulate press {i}/pressed.toml --increments 2 --out {o}/m.press.json",
        "m.mechanics.json",
        ("finray_calib.reports._finger_pictures:pressed_finger_png",),
        (".increments/",),
    ),
    "check run": Command(
        "check run {i}/check.toml --rig {i}/rig.toml --out {o}/check",
        "check",
        (
            "rigs.capture._check_session:record_facts",
            "finray_calib.acceptance._acceptance_report:judge",
            "finray_calib.reports._check_page:check_report",
            "finray_calib.exchange._record_formats:junit_xml",
        ),
    ),
    "design export": Command(
        "design export {i}/whole.toml --out {o}/print",
        "print",
        ("finray_calib.exchange._mesh_files:printable_parts",),
    ),
    "export taxim": Command(
        "export taxim {i}/sensor.toml --presses 30 --out {o}/taxim",
        "taxim",
        ("finray_calib.cli._export:_sensor", "finray_calib.exchange._taxim_export:taxim_files"),
    ),
    "export capture-request": Command(
        "export capture-request {i}/whole.toml --out {o}/f.request.md",
        "f.request.md",
        ("finray_calib.cli._export:open_engine", "sim.optics._pixel_maps:camera_view"),
    ),
    "export protocol": Command(
        "export protocol {i}/whole.toml --out {o}/protocol",
        "protocol",
        (
            "sim.experiments._press_protocol:press_protocol",
            "finray_calib.reports.studies._protocol_page:protocol_page",
        ),
    ),
    "import ball-presses": Command(
        "import ball-presses {i}/balls --mm-per-px 0.1 --out {o}/balls",
        "balls",
        ("finray_calib.exchange._ball_presses:read_ball_presses",),
    ),
    "import captures": Command("import captures {i}/fots --recipe fots-gelsight --out {o}/set", "set"),
    "import render": Command("import render {i}/ball --out {o}/ball.press.json", "ball.press.json"),
    "bench tactile": Command(
        "bench tactile {i}/set --teach 3 --out {o}/bench", "bench/row.json", COMPARED, ("/bench/",)
    ),
    "sense run": Command(
        "sense run {i}/map.json {i}/t.captures/press-001.capture.json --out {o}/s.json",
        "s.json",
        ("finray_calib.sensing._normal_map_fit:sense_press", "finray_calib.reports._images:sensed_png"),
    ),
    "certificate": Command(
        "certificate {i}/fitted.paint.json --out {o}/c.html",
        "c.html",
        ("finray_calib.reports._certificate_page:certificate_pdf",),
    ),
    "import 9dtact --predict-from": Command(
        "import 9dtact {i}/one --predict-from {i}/two --out {o}/one.capture.json", "one.capture.json"
    ),
    "import abaqus": Command(
        "import abaqus {i}/x.fil --design {i}/x.toml --out {o}/x.surfaces.json",
        "x.surfaces.json",
        (
            "sim.mechanics.other_engines._abaqus:read_fil",
            "sim.mechanics.other_engines._abaqus:pressed_by_abaqus",
        ),
    ),
    "study light-angle": Command(
        "study light-angle --samples 200 --out {o}/light-angle",
        "light-angle",
        (
            "finray_calib.cli._study:_finger",
            "finray_calib.cli._study:_draw",
            "sim.experiments._illumination:study_light_angle",
        ),
    ),
    "study finger-stiffness": Command(
        "study finger-stiffness baby-48x18 --vary 0 --out {o}/stiffness",
        "stiffness",
        ("sim.experiments._design_sensitivities:study_finger_stiffness",),
    ),
    "study run": Command(
        "study run {i}/study.toml --engine scalar --out {o}/study",
        "study/study.json",
        ("sim.studies._point:_rendered", "finray_calib.reports.studies._design_study_page:design_study_page"),
        ("/points/",),
        0,
    ),
    "study dataset": Command(
        "study dataset {i}/finger.toml --presses 2 --presses-per-shard 1 --lights 1 --paints 1 --samples 2 "
        "--radius-mm 3 5 --depth-mm 0.4 1.2 --out {o}/set",
        "set/dataset.json",
        (
            "sim.studies._dataset:press_samples",
            "sim.studies._dataset:pixel_places_mm",
        ),
        ("/shards/",),
        0,
    ),
    "design paints": Command(
        "design paints {i}/whole.toml --paint {i}/fitted.paint.json --paint {i}/fitted-green.paint.json "
        "--out {o}/p.json",
        "p.json",
        ("finray_calib.cli._design:open_engine", "sim.experiments._paint_choice:paint_pairs"),
    ),
    "design tolerances": Command(
        f"design tolerances {{i}}/whole.toml {PAINTS} --runs 60 --out {{o}}/t.json",
        "t.json",
        (
            "sim.experiments._tolerance_study:study_tolerances",
            "finray_calib.reports.studies._tolerance_page:tolerance_page",
        ),
    ),
    "design optimise": Command(
        "design optimise {i}/whole.toml --for bending-stiffness --within skeleton.rib_thickness_mm --evaluations 10 "
        "--confirm 0 --out {o}/found",
        "found/optimum.json",
        (
            "finray_calib.decide._design_optimum:design_optimum",
            "finray_calib.reports.studies._optimum_page:optimum_page",
        ),
        ("/evaluations/",),
        0,
    ),
    "sense scale": Command(
        "sense scale {boards} --pad {i}/board-0.png --squares 7x5 --square-mm 3 --marker-mm 2.2 "
        "--square-u-mm 0.003 --out {o}/scale.json",
        "scale.json",
        (
            "finray_calib.sensing._lens_calibration:find_board",
            "finray_calib.sensing._scale_record:pixel_scale",
            "finray_calib.exchange._lab_measurements:read_board_picture",
        ),
    ),
}


def main() -> int:
    """Try all verbs and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--verbs", nargs="+", default=list(COMMANDS), choices=list(COMMANDS), metavar="VERB")
    parser.add_argument("--every", type=int, default=1, help="try every so manieth point only")
    arguments = parser.parse_args()
    found: dict[str, Any] = {}
    cv2.setNumThreads(1)  # a forked try would wait for ever for threads that were not forked with it
    # Synchronising is a point, but no power fails here: it would only take time.
    with tempfile.TemporaryDirectory() as top, patch.object(os, "fsync", lambda handle: None), stand_ins():
        inputs = Path(top) / "inputs"
        boards = laboratory(inputs)
        for name in arguments.verbs:
            words = COMMANDS[name].words.format(i=inputs, boards=boards, o="{o}", e="{e}")
            command = replace(COMMANDS[name], words=words)
            found[name] = one_verb(command, Path(top) / "tries", arguments.every)
            told = found[name].get("failure") or ", ".join(f"{k}: {v}" for k, v in found[name]["ended"].items())
            sys.stdout.write(f"{name}: {found[name].get('points', 0)} points in {found[name]['s']:.0f} s; {told}\n")
            sys.stdout.flush()
            arguments.out.parent.mkdir(parents=True, exist_ok=True)
            arguments.out.write_text(json.dumps({"verbs": found}, indent=1) + "\n")
    tries = sum(v for one in found.values() for k, v in one.get("ended", {}).items() if "named" not in k)
    failures = [name for name, one in found.items() if "failure" in one]
    sys.stdout.write(f"{len(found)} verbs, {tries} tries; failed: {', '.join(failures) or 'none'}\n")
    return 1 if failures else 0


def one_verb(command: Command, top: Path, every: int) -> dict[str, Any]:
    """Try one verb at all its points."""
    begun = time.monotonic()
    tries = Tries(command, top)
    try:
        with replaying(("data_schemas._provenance:provenance", *command.replayed)):
            ended = tries.try_all([None, *ERRORS], every)
    except AssertionError as failed:
        return {"failure": str(failed), "s": time.monotonic() - begun}
    return {"points": tries.points, "ended": dict(sorted(ended.items())), "s": time.monotonic() - begun}


@contextlib.contextmanager
def stand_ins() -> Iterator[None]:
    """Replace what no verb needs to be true here by something quick."""
    made = Replay(lambda: closed_form_presses(30))
    fitted = Replay(DesignSearch.emulators)
    paints = example_results().paints
    linear = with_known_camera(press())
    study = "sim.experiments._design_sensitivities"
    with contextlib.ExitStack() as stack:
        for target, value in {
            "sim.experiments._sensor_press.render_ball_presses": lambda *_: made(),
            "finray_calib.fit._paint_calibration.calibrate_paint": lambda *_: paints["red"].calibration,
            "sim.mechanics._press.press_finger": ReplayedPress(),
            f"{study}.LoadedFinger": Quick,
            f"{study}.press_to_force": no_grip,
            "sim.studies._engine.open_workers": lambda *_: contextlib.nullcontext(),
            "sim.studies._engine._each": one_after_the_other,
            "time.process_time": lambda: 0.0,
            "sim.experiments._design_search.DesignEvaluations._values": stiffness,
            "sim.experiments._design_search.DesignSearch.emulators": lambda *search, **how: fitted(*search, **how),
            "sim.experiments._design_search.next_design": anywhere,
            "sim.experiments._design_search.best_design": anywhere,
            "sim.experiments._tolerance_study.FingerError": lambda *_: turned_error,
            "finray_calib.cli._design_search._evaluators": lambda *_: lambda seed: Places(),
        }.items():
            stack.enter_context(patch(target, value))
        read = {"9dtact": lambda _: (capture_of(linear, 50.0), linear)}
        stack.enter_context(patch.dict("finray_calib.cli._import._READERS", read))
        stack.enter_context(patch("finray_calib.exchange._render_files._exr_images", Once(ORIGINAL_IMAGES)))
        steps = MeshSteps(pad_mm=3.0, pad_layer_mm=3.0, skeleton_mm=4.0, across_mm=4.0)
        stack.enter_context(patch.dict(STEPS, {"coarse": steps}))
        yield


class Once:
    """A function that works once, before the first fork, as the threads of OpenEXR are not forked."""

    def __init__(self, function: Callable[..., Any]):
        self._function, self._made = function, None

    def __call__(self, *arguments: Any) -> Any:
        self._made = self._made or self._function(*arguments)
        return self._made


class ReplayedPress:
    """A press by finite elements that is computed once, then stores its increments again."""

    def __init__(self) -> None:
        self._pressed: Any = None
        self._steps: list[Any] = []

    def __call__(self, *arguments: Any, resume: Any = None, store: Any = None, **options: Any) -> Any:
        from sim.mechanics import press_finger

        if self._pressed is None:
            self._pressed = ORIGINAL_PRESS(*arguments, store=self._steps.append, **options)
            assert press_finger is self
        for step in self._steps:
            if resume is None or len(step.depth_mm) > len(resume.depth_mm):
                store(step)
        return self._pressed


class Quick:
    """A finger whose stiffness is known without computing it."""

    def __init__(self, design: FingerDesign, threads: int) -> None:
        pass

    def push(self, place: str, force_n: tuple[float, float, float]) -> Any:
        return type("Pushed", (), {"stiffness_n_per_mm": 2.0})

    def twist(self, angle_deg: float) -> Any:
        return type("Twisted", (), {"stiffness_n_mm_per_deg": 3.0})


def no_grip(*_: Any, **__: Any) -> None:
    """Find no equilibrium."""
    raise NoEquilibriumError("no equilibrium at a push of 0.1 mm")


def one_after_the_other(client: Any, compute: Any, task: Any, points: Sequence[Any], *_: Any) -> Iterator[Any]:
    """Compute points in this process: the workers of a study were not forked with a try."""
    for point in points:
        yield point, compute(task, point)


def stiffness(_: Any, design: FingerDesign, again: int) -> dict[str, float]:
    """Return the stiffness of a made-up finger."""
    return {"bending-stiffness": 0.5 * design.skeleton.rib_thickness_mm**2}


def anywhere(emulators: Any, weights: Any, rng: np.random.Generator, is_worth_trying: Any) -> Any:
    """Propose a random design."""
    return rng.random(1)


def turned_error(design: FingerDesign, paints: Any, seed: int) -> float:
    """Return an error in degrees that depends on the light's angle."""
    return 5.0 + (design.light.angle_deg - 30.0) ** 2 / 500.0


class Places:
    """An evaluator that knows its contact places."""

    def contact_places_mm(self, design: FingerDesign) -> list[float]:
        return [35.0]


def laboratory(folder: Path) -> str:
    """Write all that the verbs read, and return the pictures of boards."""
    folder.mkdir()
    rig = simulated_rig("red", width_px=320, height_px=256)
    write_rig(rig, folder / "rig.toml")
    write_plan(paint_plan("red", rig.camera), folder / "plan.toml")
    whole, of_abaqus = design_toml(FingerDesign()), design_toml(ABAQUS_DESIGN)
    texts = {
        "finger": FINGER,
        "pressed": PRESSED,
        "whole": whole,
        "check": CHECK,
        "sensor": SENSOR,
        "x": of_abaqus,
        "study": STUDY,
    }
    for name, text in texts.items():
        (folder / f"{name}.toml").write_text(text)
    origin, linear = provenance("benchmark"), with_known_camera(press())
    for name, record in {
        "press": linear, "capture": capture_of(linear, 50.0), "sweep": sweep(),
        "simulated/one.press": linear, "simulated/two.press": press(),
        "captured/one.capture": capture_of(linear, 50.0), "captured/two.capture": capture_of(linear, 20.0),
        "power.mechanics": power_law_press({}, {}),
    }.items():  # fmt: skip
        write_record(record, folder / f"{name}.json", origin)
    pushes_mm = np.linspace(0.1, 1.0, 10) * INCREMENTS_MM[-1]
    bench(folder / "bench.csv", force_at(pushes_mm), pushes_mm)
    succeed(f"capture {folder}/plan.toml --rig {folder}/rig.toml --out {folder}/session")
    for colour, paint in example_results().paints.items():
        write_record(paint.calibration, folder / f"{colour}.paint.json", origin)
    write_plan(camera_plan("lab camera", rig.camera), folder / "camera.toml")
    succeed(f"capture {folder}/camera.toml --rig {folder}/rig.toml --out {folder}/camera")
    succeed(f"radiometry {folder}/session --pixels --out {folder}/bands.json")
    (folder / "bands.pixels.json").rename(folder / "pixels.json")
    write_rig(simulated_rig("green", width_px=320, height_px=256), folder / "green-rig.toml")
    write_plan(paint_plan("green", rig.camera), folder / "green-plan.toml")
    succeed(f"capture {folder}/green-plan.toml --rig {folder}/green-rig.toml --out {folder}/green-session")
    succeed(f"radiometry {folder}/green-session --out {folder}/green-bands.json")
    with patch("finray_calib.fit._paint_calibration.calibrate_paint", ORIGINAL_FIT):
        succeed(f"fit {folder}/bands.json --out {folder}/fitted.paint.json")
        succeed(f"fit {folder}/green-bands.json --out {folder}/fitted-green.paint.json")
    succeed(f"compare {folder}/press.json {folder}/capture.json --out {folder}/report.json")
    write_catalog(folder / "balls")
    succeed(f"import captures {write_fots(folder / 'fots')} --recipe fots-gelsight --out {folder}/set")
    succeed(f"import taxim {write_taxim(folder / 't')} --out {folder}/t.captures")
    succeed(f"sense teach {' '.join(map(str, sorted((folder / 't.captures').glob('*.json'))))} --out {folder}/map.json")
    simulated, _ = pair(0)
    write_render(folder / "ball", simulated.contact, simulated.no_contact, **LINEAR)
    for name in ("one", "two"):
        (folder / name).mkdir()
        (folder / name / "a.png").write_bytes(b"\x89PNG")
    (folder / "x.fil").write_text(results(0.8)[0])
    rng = np.random.default_rng(5)
    for k, pose in enumerate(poses("fisheye", FISHEYE, rng, 6)):
        noisy = picture("fisheye", FISHEYE, pose) + rng.normal(0.0, 2.0, SIZE_PX[::-1])
        cv2.imwrite(str(folder / f"board-{k}.png"), np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return " ".join(f"{folder}/board-{k}.png" for k in range(1, 7))


def _originals() -> tuple[Any, Any, Any]:
    """Return the press, the fit and the encoded images before they are replaced."""
    from finray_calib.exchange._render_files import _exr_images
    from finray_calib.fit import calibrate_paint
    from sim.mechanics import press_finger

    return press_finger, calibrate_paint, _exr_images


ORIGINAL_PRESS, ORIGINAL_FIT, ORIGINAL_IMAGES = _originals()

if __name__ == "__main__":
    sys.exit(main())
