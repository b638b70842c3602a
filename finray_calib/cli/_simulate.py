"""``finray simulate`` and ``finray recolour``: render a press of a finger, sweep its light's angle, change its paints.

Beside the record of a press its images are written as files that other programs open.
"""

import argparse
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from finray_calib.cli._run import (
    DEFAULT_SEED,
    Progress,
    add_out,
    add_paint,
    add_paints_as_given,
    add_seed,
    command_line,
    file_name,
    input_digests,
    naming,
    open_engine,
    paint_files,
    progress_bar,
    require_new,
    say,
)
from finray_calib.cli._simulate_press import add_mechanics_options, require_optics_only, run_mechanics

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_schemas import FingerDesign, PaintCalibration, Provenance, SimulatedPress
    from finray_calib.cli._run import LongWork
    from sim.experiments import PaintedFinger, WhiteBalance
    from sim.optics import RenderLevel
    from sim.surface_meshes import FingerShape


SIMULATE_HELP = "render a press of a painted finger, or sweep the light angle"
SMALLEST_STEP_DEG = 0.5
SMALLEST_STEP_MM = 0.5
SIMULATE_DESCRIPTION = """\
Render the contact and no-contact image of a finger with calibrated paints. With --angles, sweep the angle of
the blue light instead and write the brightness beside the indenter at each angle, for 'finray decide': at the design's
position_mm, or with --positions at each of several places, one record for each. The angle lies between the pad's plane
and the direction in which the panel shines: 0 deg along the pad, 90 deg into it.

With --only optics the images are written as files too, in a folder beside the record: basis bands, spectra and
geometry per pixel (OpenEXR), raw frames and pictures (PNG), and the press as a capture for 'finray compare'.

Levels: b (default) the walls re-emit the blue light that reaches them; a the paper's emitter, textured by the
distance from the light (linear as printed, or inverse square; no angle dependence: for comparison only); c the
reference, fluorescence traced along every path: the mean of b without its smoothing, much noisier.

With --only mechanics, the indenter of the design is pressed in by finite elements; the fineness is that of the design's
[mesh] table. With --surfaces, such a deformed finger (FingerSurfaces record) takes the place of the analytic press."""


def add_simulate(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "simulate",
        help=SIMULATE_HELP,
        description=SIMULATE_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML)")
    add_paint(parser)
    parser.add_argument(
        "--only", choices=["mechanics", "optics"],
        help="mechanics: press the finger by finite elements (no paints needed); optics: render and write the images",
    )  # fmt: skip
    add_mechanics_options(parser)
    parser.add_argument("--angles", type=_angles, metavar="FIRST:LAST:STEP", help="light angles in deg, e.g. 0:120:10")
    parser.add_argument(
        "--positions", type=_positions, metavar="FIRST:LAST:STEP or MM,MM,...",
        help="with --angles: sweep with the indenter at each of these places along the pad (mm from the base), e.g. "
        "8:64:4, so that the light is decided on for the finger; places that are swept already are not swept again",
    )  # fmt: skip
    parser.add_argument(
        "--narrow-sweep", action="store_true", help="with --angles: they span less than 4 deg and are not radians"
    )
    add_paints_as_given(parser)
    parser.add_argument(
        "--objectives", choices=["intensity", "all"], default="intensity",
        help="with --angles: only the brightness beside the indenter (default), or also how well surface normals are "
        "told (Fisher information, held-out error), evenness, clipping and room for the panel (about a minute more)",
    )  # fmt: skip
    parser.add_argument("--surfaces", type=Path, metavar="FILE", help="the finger without and with contact, as meshes")
    parser.add_argument(
        "--level", choices=["a", "a_inverse_square", "b", "c"], default="b", help="how the walls emit (default: b)"
    )
    parser.add_argument(
        "--engine", choices=["auto", "llvm", "scalar", "calculix"], default="auto",
        help="renderer: auto (default), llvm or scalar; with --only mechanics: auto (in process) or calculix",
    )  # fmt: skip
    parser.add_argument("--samples", type=_even, metavar="N", help="paths per pixel (default 128) or per probe (4000)")
    parser.add_argument(
        "--denoise", action="store_true",
        help="with --only optics: also denoised pictures, for the eye only; needs pip install 'finray-calib[denoise]'",
    )  # fmt: skip
    parser.add_argument(
        "--pose-response", action="store_true",
        help="also render how the contact image changes with the indenter's depth and position, so that 'finray "
        "compare' can carry the pose's uncertainty (three times the time)",
    )  # fmt: skip
    add_out(parser, "DESIGN.press.json or DESIGN.sweep.json")
    add_seed(parser)
    # none, so that a seed without effect is told from none given
    parser.set_defaults(run=run_simulate, long_work=_long_work, seed=None)


def _long_work(arguments: argparse.Namespace) -> "LongWork":
    """Return what is about to be done, and what of it is kept if its process dies."""
    from finray_calib.cli._run import LongWork

    if arguments.only != "mechanics":
        words = "the render" if arguments.angles is None else "the sweep of the light angle"
        return LongWork(words, "Nothing is stored before its end: the same command begins again", arguments.out)
    words = "the press by finite elements"
    if arguments.force is not None or arguments.engine == "calculix":
        return LongWork(words, "Nothing is stored before its end: the same command begins again", arguments.out)
    return LongWork(words, "Finished increments are kept: the same command goes on after the last one", arguments.out)


def _even(text: str) -> int:
    """Parse an even number: a press is rendered as two independent halves, whose difference is the noise."""
    if not text.isdecimal() or int(text) < 2 or int(text) % 2:
        raise argparse.ArgumentTypeError(f"{text!r} must be an even whole number from 2, for example 128")
    return int(text)


def _angles(text: str) -> list[float]:
    """Parse FIRST:LAST:STEP in degrees, both ends included."""
    try:
        first, last, step = (float(part) for part in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be FIRST:LAST:STEP in deg, for example 0:120:10") from None
    if not (SMALLEST_STEP_DEG <= step <= last - first and first >= -90 and last <= 180):
        raise argparse.ArgumentTypeError(
            f"{text!r}: needs -90 <= FIRST < LAST <= 180 deg and a STEP of {SMALLEST_STEP_DEG:g} deg to LAST - FIRST"
        )
    count = int((last - first) / step + 1e-9) + 1
    return [first + i * step for i in range(count)]


def _positions(text: str) -> list[float]:
    """Parse FIRST:LAST:STEP or a list in mm; whether they lie on the pad is judged with the design."""
    try:
        if ":" in text:
            first, last, step = (float(part) for part in text.split(":"))
            count = int((last - first) / step + 1e-9) + 1 if SMALLEST_STEP_MM <= step <= last - first else 0
            places = [first + i * step for i in range(count)]
        else:
            places = sorted(float(part) for part in text.split(","))
    except ValueError:
        places = []
    if not places or len(set(places)) < len(places) or not all(map(math.isfinite, places)):
        raise argparse.ArgumentTypeError(
            f"{text!r} must be FIRST:LAST:STEP in mm with a STEP of {SMALLEST_STEP_MM:g} mm or more, for example "
            "8:64:4, "
            "or different places with commas between them, for example 8,15,35"
        )
    return places


def run_simulate(arguments: argparse.Namespace) -> None:
    """Press, render or sweep, and report."""
    if arguments.only == "mechanics":
        run_mechanics(arguments)
        return
    require_optics_only(arguments)
    _require_one_kind(arguments)
    _run_optics(arguments)


def _require_one_kind(arguments: argparse.Namespace) -> None:
    """Refuse options of a press and of a sweep that do not go together, and angles that look like radians."""
    from data_schemas import SimulateError, look_like_radians, narrow_sweep_text

    if arguments.angles is not None and arguments.level != "b":
        raise SimulateError(
            f"--level {arguments.level}: sweeps are made with level b (the paper's emitters of level a know no light "
            "angle, level c is too noisy); leave out --level, or --angles"
        )
    if arguments.objectives != "intensity" and arguments.angles is None:
        raise SimulateError("--objectives are those of a sweep; add --angles FIRST:LAST:STEP, or leave it out")
    if arguments.denoise and arguments.only != "optics":
        raise SimulateError("--denoise makes pictures, which --only optics writes; add --only optics or leave it out")
    if arguments.angles is not None and not arguments.narrow_sweep and look_like_radians(arguments.angles):
        raise SimulateError(f"--angles: {narrow_sweep_text(arguments.angles)}")
    if arguments.positions is not None and (arguments.angles is None or arguments.surfaces is not None):
        raise SimulateError(
            "--positions are places of the analytic press in a sweep; add --angles FIRST:LAST:STEP and leave out "
            "--surfaces (a press by finite elements is of one place: sweep each with its own --surfaces and --out)"
        )
    if arguments.only == "optics" and arguments.angles is not None:
        raise SimulateError("--angles writes no images; leave out --only optics, or --angles")
    if arguments.pose_response and (arguments.angles is not None or arguments.surfaces is not None):
        raise SimulateError(
            "--pose-response belongs to one press by the analytic contact; leave it out, or --angles and --surfaces"
        )


class _Scene(NamedTuple):
    """What is rendered, and from what it was read."""

    finger: "PaintedFinger"
    calibrations: "dict[str, PaintCalibration]"
    digests: dict[str, str]
    shapes: "tuple[FingerShape, FingerShape] | None"
    seed: int
    origin: "Provenance"


def _run_optics(arguments: argparse.Namespace) -> None:
    """Render or sweep."""
    from sim import read_design

    design = read_design(arguments.design)
    if arguments.positions is not None:
        _sweep_places(arguments, design)
        return
    kind = "press" if arguments.angles is None else "sweep"
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.{kind}.json"))
    scene = _scene(arguments, design)
    with progress_bar("simulate") as progress:
        if arguments.only == "optics":
            simulate_optics(
                scene.finger, arguments.level, scene.seed, arguments.samples, scene.digests, out, scene.origin,
                progress, arguments.denoise, scene.shapes, scene.calibrations, arguments.pose_response,
            )  # fmt: skip
        elif arguments.angles is None:
            _render(arguments, scene, out, progress)
        else:
            _sweep(arguments, scene, out, progress)


def _scene(arguments: argparse.Namespace, design: "FingerDesign") -> _Scene:
    """Read paints and surfaces, and paint the finger."""
    from data_schemas import FingerSurfaces, PaintCalibration, digest_of_input, provenance
    from data_schemas.storage import read_record
    from sim import design_inputs
    from sim.experiments import finger_scene, require_paints_in_order

    files = paint_files(arguments)
    calibrations = {colour: read_record(path, PaintCalibration) for colour, path in files.items()}
    if not arguments.paints_as_given:
        modes_nm = {colour: paint.mode_nm.estimate for colour, paint in calibrations.items()}
        require_paints_in_order(modes_nm, {c: str(f) for c, f in files.items()}, "--paints-as-given")
    digests = {colour: digest_of_input(path) for colour, path in files.items()}
    meshes = [] if arguments.surfaces is None else [arguments.surfaces]
    surfaces = read_record(arguments.surfaces, FingerSurfaces) if meshes else None
    scene = finger_scene(design, calibrations, arguments.design.parent, open_engine(arguments.engine), surfaces)
    seed = DEFAULT_SEED if arguments.seed is None else arguments.seed
    inputs = [*design_inputs(design, arguments.design), *files.values(), *meshes]
    origin = provenance(command_line(), input_digests(inputs), seed)
    return _Scene(scene.finger, calibrations, digests, scene.shapes, seed, origin)


def _sweep_places(arguments: argparse.Namespace, design: "FingerDesign") -> None:
    """Sweep at each place and write its record as soon as it is done; what is there already is kept."""
    from dataclasses import replace

    from data_schemas import SimulateError

    length_mm = design.pad.length_mm
    off = [place for place in arguments.positions if not 0.0 < place < length_mm]
    if off:
        raise SimulateError(f"--positions: {off[0]:g} mm is not on the pad, which reaches from 0 to {length_mm:g} mm")
    out = arguments.out or Path(f"{file_name(design.name)}.sweep.json")
    stem = out.name.removesuffix(".json").removesuffix(".sweep")
    outs = {place: out.with_name(f"{stem}.{place:04.1f}mm.sweep.json") for place in arguments.positions}
    scene = _scene(arguments, design)
    todo = {}
    for place, path in outs.items():
        finger = replace(scene.finger, design=_touched_at(design, place))
        if not _is_swept(path, finger.design, arguments, scene):
            todo[require_new(path)] = finger
    for number, (path, finger) in enumerate(todo.items()):
        with progress_bar(f"simulate, place {number + 1} of {len(todo)}") as progress:
            _sweep(arguments, scene._replace(finger=finger), path, progress)
    for path in outs.values():
        if path not in todo:
            say(f"{path}: is there already, from the same inputs")
    say(f"Decide on all of them: finray decide {out.with_name(stem)}.*mm.sweep.json")


def _touched_at(design: "FingerDesign", position_mm: float) -> "FingerDesign":
    """Return the design with its indenter at another place along the pad."""
    return design.model_copy(update={"indenter": design.indenter.model_copy(update={"position_mm": position_mm})})


def _is_swept(path: Path, design: "FingerDesign", arguments: argparse.Namespace, scene: _Scene) -> bool:
    """Return whether a record is there that this command would write again: same design, paints, angles and effort."""
    if not path.exists():
        return False
    from data_schemas import LightAngleSweep, package_version
    from data_schemas.storage import read_record

    stored = read_record(path, LightAngleSweep)
    origin = stored.provenance
    return (
        origin is not None
        and (origin.seed, origin.package_version) == (scene.seed, package_version())
        and _effort(origin.command) == _effort(command_line())
        and (stored.design, stored.paints) == (design, scene.digests)
        and stored.angles_deg.tolist() == arguments.angles
    )


def _effort(command: str) -> tuple[str, ...]:
    """Return what a command says of samples, objectives and engine."""
    words = command.replace("=", " ").split()
    return tuple(" ".join(words[k : k + 2]) for k, word in enumerate(words) if word in _EFFORT)


_EFFORT = frozenset({"--samples", "--objectives", "--engine"})


def _render(arguments: argparse.Namespace, scene: _Scene, out: Path, progress: Progress) -> None:
    """Render a press and write its record."""
    from data_schemas.storage import write_record
    from sim.experiments import simulate_press

    press = simulate_press(
        scene.finger, arguments.level, scene.seed, arguments.samples or DEFAULT_SAMPLES, scene.digests, progress,
        scene.shapes, scene.calibrations, arguments.pose_response,
    )  # fmt: skip
    write_record(press, out, scene.origin)
    say(f"{out}: {press.label}")


def _sweep(arguments: argparse.Namespace, scene: _Scene, out: Path, progress: Progress) -> None:
    """Sweep the angle of the light and write its record."""
    from data_schemas.storage import write_record
    from sim.experiments import light_angle_sweep

    rest, shape = scene.shapes or (None, None)
    sweep = light_angle_sweep(
        scene.finger, scene.calibrations, arguments.angles, 6, arguments.samples or 4000, scene.seed, scene.digests,
        progress, shape, arguments.objectives == "all", rest,
    )  # fmt: skip
    write_record(sweep, out, scene.origin)
    say(f"{out}: {len(sweep.angles_deg)} angles, {sweep.label}")


DEFAULT_SAMPLES = 128


def optics_paths(out: Path) -> tuple[Path, Path]:
    """Return the folder of images and the record of the capture beside a press record; both must be new."""
    stem = out.name.removesuffix(".json").removesuffix(".press")
    return require_new(out.with_name(f"{stem}.optics")), require_new(out.with_name(f"{stem}.capture.json"))


def simulate_optics(
    finger: "PaintedFinger",
    level: "RenderLevel",
    seed: int,
    samples: int | None,
    paint_sha256: Mapping[str, str],
    out: Path,
    origin: "Provenance",
    progress: Progress,
    denoise: bool,
    shapes: "tuple[FingerShape, FingerShape] | None",
    calibrations: "Mapping[str, PaintCalibration]",
    with_pose_response: bool,
) -> None:
    """Render a press and write its record, its capture and the folder of its images."""
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.exchange import write_optics_folder
    from finray_calib.reports import require_denoiser
    from sim.experiments import moved_designs, optics_products, pose_response, press_record
    from sim.optics import render_press

    folder, capture = optics_paths(out)
    if denoise:
        require_denoiser()
    samples = samples or DEFAULT_SAMPLES
    if with_pose_response:
        moved_designs(finger.design)  # what cannot be moved is told before anything is rendered
    render = render_press(
        finger.design, finger.paints, finger.renderer, level, seed, samples, progress, shapes, finger.calibration
    )
    pose = None
    if with_pose_response:
        pose = pose_response(finger, level, seed, samples, None, render.chains, progress=progress)
    press = press_record(finger, render, paint_sha256, calibrations, pose)
    products = optics_products(render, press, seed)
    press = press.model_copy(update={"notes": (*press.notes, str(products.colours))})
    with ProductSet(out) as stored:
        write_optics_folder(folder, products, _views(press, samples, denoise), origin, stored)
        write_record(products.capture, capture, origin, stored)
        write_record(press, out, origin, stored)
    say(f"{out}: {press.label}")
    say(f"{capture}: raw counts of {press.design.camera.bit_depth if press.design else 0} bit, for 'finray compare'")
    say(f"{folder}/: images; README.txt there says what each one is")
    say(str(products.colours))


def _views(press: "SimulatedPress", samples: int, denoise: bool) -> "dict[str, NDArray[np.uint8]]":
    """Return pictures for the eye: the camera's colours, and the bands as colours."""
    import numpy as np

    from finray_calib.reports import denoised, display_white, to_display
    from sim.experiments import camera_rgb

    bands = {"contact": press.contact_bands, "no_contact": press.no_contact_bands}
    pictures: dict[str, NDArray[np.float32]] = {"contact-view": press.contact, "no_contact-view": press.no_contact}
    pictures |= {f"{state}-view-bands": image for state, image in bands.items() if image is not None}
    if denoise and press.camera_matrix is not None:
        clean = {state: denoised(image, samples) for state, image in bands.items() if image is not None}
        pictures |= {f"{state}-view-denoised": camera_rgb(image, press.camera_matrix) for state, image in clean.items()}
        pictures |= {f"{state}-view-bands-denoised": image for state, image in clean.items()}
    pad = np.isfinite(press.distance)
    return {name: to_display(image, display_white(image[pad]), linear=True) for name, image in pictures.items()}


RECOLOUR_HELP = "show a rendered press with other paints, camera or white balance"
RECOLOUR_DESCRIPTION = """\
Recompute the images of a press that 'finray simulate' has rendered, for paints of another yield, absorption at the LED
or emission shape, for another camera, or with another white balance. Nothing is rendered: the light of each chain of
fluorescence was kept apart. Refused where a new render is needed: after a change of a paint's reflectance by more
than 0.01 in a band, of a band's place by more than 10 nm, or when paint excites paint three times as much."""


def add_recolour(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "recolour",
        help=RECOLOUR_HELP,
        description=RECOLOUR_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("press", type=Path, metavar="PRESS", help="rendered press (JSON)")
    add_paint(parser, "paint calibrations of both walls (an unchanged one again)")
    parser.add_argument("--camera", type=Path, metavar="FILE", help="camera response (CSV)")
    parser.add_argument(
        "--white-balance", type=_white_balance, metavar="R:G:B",
        help="gains of red, green and blue, e.g. 1.8:1:1.4; or 'pad': the untouched pad becomes grey on average",
    )  # fmt: skip
    add_out(parser, "PRESS-recoloured.json")
    parser.set_defaults(run=run_recolour)


def _white_balance(text: str) -> "WhiteBalance":
    """Parse R:G:B or pad."""
    if text == "pad":
        return "pad"
    try:
        red, green, blue = (float(part) for part in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be R:G:B, for example 1.8:1:1.4, or pad") from None
    if not all(0.0 < gain <= 1000.0 for gain in (red, green, blue)):
        raise argparse.ArgumentTypeError(f"{text!r}: gains must be above 0 and at most 1000")
    return red, green, blue


def run_recolour(arguments: argparse.Namespace) -> None:
    """Recolour, store and report."""
    from time import perf_counter

    from data_schemas import PaintCalibration, SimulatedPress, SimulateError, digest_of_input, provenance
    from data_schemas.storage import read_camera_response, read_record, write_record
    from sim.experiments import paint_optics, recoloured

    files = paint_files(arguments, without="the press's own paints")
    if not files and arguments.camera is None and arguments.white_balance is None:
        raise SimulateError("nothing is to change: give --paint for both walls, --camera or --white-balance")
    out = require_new(arguments.out or arguments.press.with_name(f"{arguments.press.stem}-recoloured.json"))
    press = read_record(arguments.press, SimulatedPress)
    paints = {colour: paint_optics(read_record(path, PaintCalibration)) for colour, path in files.items()}
    response = None if arguments.camera is None else read_camera_response(arguments.camera)
    digests = {colour: digest_of_input(path) for colour, path in files.items()}
    begun = perf_counter()
    with naming(SimulateError, arguments.press):
        made = recoloured(press, paints or None, response, arguments.white_balance, digests or None)
    took_s = perf_counter() - begun
    inputs = [arguments.press, *files.values(), *([arguments.camera] if arguments.camera else [])]
    write_record(made, out, provenance(command_line(), input_digests(inputs)))
    say(f"{out}: {made.label}, {1000.0 * took_s:.0f} ms of arithmetic")
