"""``finray simulate`` and ``finray recolour``: press a finger, render it, sweep its light's angle, change its paints.

Beside the record of a press its images are written as files that other programs open.
"""

import argparse
import hashlib
import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._fit import add_sensor_fit
from finray_calib.cli._output import give, progress_bar, say, suggest_command, suggest_file, warn, wrote
from finray_calib.cli._run import (
    LongWork,
    add_engine,
    add_out,
    add_paint,
    add_paints_as_given,
    add_seed,
    both_paint_files,
    command_line,
    file_name,
    input_digests,
    naming,
    paint_files,
    path_count,
    require_ending,
    require_new,
    whole_number,
    working_engine,
)
from finray_calib.cli._simulate_grasp import add_grasp
from finray_calib.cli._simulate_press import add_press

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_schemas import FingerDesign, PressSurrogate, Provenance, Record, SimulatedPress, TaughtPress
    from finray_calib import RenderOptions
    from sim.experiments import OpticsProducts, WhiteBalance


SIMULATE_HELP = "press a finger by finite elements, render it, sweep the light angle, or fit a sensor to captures"
SIMULATE_DESCRIPTION = """\
Simulate a finger: how it bends, what its camera sees, and how that changes with the angle of the blue light; and fit
a sensor to captures of it."""
SMALLEST_STEP_DEG = 0.5
SMALLEST_STEP_MM = 0.5
CHANGE_SHOWN = 4.0
NOTHING_KEPT = "Nothing is stored before the end, so the same command starts from the beginning"

RENDER_HELP = "render a painted finger or a classic sensor without and with contact, as its camera sees it"
RENDER_DESCRIPTION = """\
Render the contact and no-contact image of a finger with calibrated paints. With a DESIGN the indenter is pressed in by
a formula; with SURFACES, which 'finray simulate press' wrote, the finger has the deformed shape that they hold.

Levels: b (default) the walls re-emit the blue light that reaches them; a the paper's emitter, textured by the
distance from the light (linear as the paper prints it, or inverse square; no angle dependence: for comparison only); c
the reference: fluorescence traced along every path, without the smoothing of b and much noisier.

A DESIGN of kind = "sensor" ('finray design init gelsight-flat' writes one) is rendered as a classic sensor: coloured
lights, no paints. Its indenter (a ball, cylinder, cuboid or mesh) is pressed into its coat, or the coat comes from a
height map or mesh ([surface])."""

SWEEP_HELP = "measure the brightness beside the indenter over the angle of the light"
SWEEP_DESCRIPTION = """\
Measure the brightness beside the indenter at each angle of the blue light, for 'finray decide': where the design's
indenter touches, or with --positions at several places, one record for each. The angle lies between the pad's plane and
the direction in which the panel shines: 0 deg along the pad, 90 deg into it. The walls re-emit the blue light that
reaches them (level b)."""


def add_simulate(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and its jobs."""
    parser = verbs.add_parser("simulate", help=SIMULATE_HELP, description=SIMULATE_DESCRIPTION)
    jobs = parser.add_subparsers(dest="job", metavar="JOB", title="jobs", required=True)
    add_press(jobs)
    add_grasp(jobs)
    add_teach(jobs)
    add_render(jobs)
    add_sweep(jobs)
    add_sensor_fit(jobs)


TEACH_HELP = "train a surrogate of a finger, which presses in milliseconds with error bars"
TEACH_DESCRIPTION = """\
Train a surrogate of the design's finger, which computes a press in milliseconds, with error bars, for 'finray simulate
press --surrogate'. It covers presses by a cylinder or a ball of 6 to 20 mm radius, 0.5 to 4 mm deep, without friction,
on the middle line of the pad or beside it, also turned. The finger is condensed to its coat once; the rest is learned
from presses by finite elements, each where the surrogate is least certain. Finished presses are kept: the same command
continues after the last one."""


def add_teach(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray simulate teach``."""
    parser = jobs.add_parser("teach", help=TEACH_HELP, description=TEACH_DESCRIPTION)
    parser.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML); its indenter is ignored")
    parser.add_argument(
        "--presses",
        type=whole_number(1, MOST_PRESSES),
        metavar="N",
        help="presses by finite elements to train the surrogate on, at least 20 (default: 40)",
    )
    add_out(parser, "NAME.surrogate.json")
    parser.set_defaults(run=run_teach, long_work=_long_teach)


def _long_teach(arguments: argparse.Namespace) -> LongWork:
    """Return what is about to be done, and what of it is kept if its process dies."""
    kept = "Finished presses are kept, and the same command continues after the last one"
    return LongWork("the training of a surrogate", kept, arguments.out)


MOST_PRESSES = 400


def run_teach(arguments: argparse.Namespace) -> None:
    """Teach a surrogate, keep its presses, and tell how far it is off."""
    from data_schemas import SimulateError, TaughtPress, provenance
    from data_schemas.storage import clear_leftovers, read_record, write_record
    from finray_calib.spectra import machine_threads
    from sim import read_design
    from sim.experiments import DEFAULT_PRESSES, TrainingSettings, train_surrogate

    design = read_design(arguments.design)
    out = require_new(arguments.out or Path(f"{file_name(arguments.design.stem)}.surrogate.json"), ".json")
    kept = out.with_name(f"{out.name.removesuffix('.json').removesuffix('.surrogate')}.presses")
    clear_leftovers(kept)
    origin = provenance(command_line(), input_digests([arguments.design]), None)

    def stored(number: int) -> "TaughtPress | None":
        path = kept / f"{number + 1:03d}.json"
        return read_record(path, TaughtPress) if path.exists() else None

    def store(number: int, press: "TaughtPress") -> None:
        write_record(press, kept / f"{number + 1:03d}.json", origin)

    settings = TrainingSettings(arguments.presses or DEFAULT_PRESSES, threads=machine_threads())
    with progress_bar("teach") as progress, naming(SimulateError, arguments.design):
        taught = train_surrogate(design, settings, stored=stored, store=store, progress=progress)
    write_record(taught, out, origin)
    _report_taught(taught, out, kept)
    suggest_command("finray simulate press", arguments.design, "--surrogate", out)


def _report_taught(taught: "PressSurrogate", out: Path, kept: Path) -> None:
    """Tell how far a surrogate is off on presses that were left out of its teaching."""
    import numpy as np

    wrote(out, taught.label)
    wrote(kept, "presses that trained the surrogate; the same command with more --presses continues with them")
    errors = {"surface": taught.left_out_surface_rel, "force": taught.left_out_force_rel}
    shares = {name: np.quantile(values, [0.5, taught.level_share]) for name, values in errors.items()}
    for name, (half, most) in shares.items():
        share = f"{100 * taught.level_share:.0f} % of them up to {100 * most:.2f} %"
        say(
            f"  {name}: with its press left out of the training, half of the samples have an error of up to "
            f"{100 * half:.2f} %, {share}"
        )
    if taught.crossed_features is not None:
        say(
            "  ribs pass through each other or buckle in some presses; presses similar to those are computed by "
            "finite elements"
        )
    say(f"  {taught.processor_s / 60.0:.1f} min of processor time")
    give(
        label=taught.label, presses=taught.presses, processor_s=taught.processor_s, level_share=taught.level_share,
        surface_error_rel=shares["surface"], force_error_rel=shares["force"], family=taught.family.model_dump(),
    )  # fmt: skip
    suggest_file(out)


def add_render(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray simulate render``."""
    parser = jobs.add_parser("render", help=RENDER_HELP, description=RENDER_DESCRIPTION)
    parser.add_argument(
        "design", type=Path, metavar="DESIGN|SURFACES",
        help="finger design (TOML), or NAME.surfaces.json, whose design is in NAME.mechanics.json beside it",
    )  # fmt: skip
    _add_scene(parser)
    parser.add_argument(
        "--level",
        choices=["a", "a_inverse_square", "b", "c"],
        default="b",
        help="how the light of the walls is modelled (default: b)",
    )
    parser.add_argument(
        "--samples", type=path_count, default=128, metavar="N", help="paths per pixel, an even number (default: 128)"
    )
    parser.add_argument(
        "--images", action="store_true",
        help="also write a folder of images (basis bands, spectra and geometry per pixel as OpenEXR, raw frames and "
        "pictures as PNG), and a finger's press as a capture for 'finray compare'",
    )  # fmt: skip
    parser.add_argument(
        "--denoise", action="store_true",
        help="like --images, but with denoised pictures for viewing, not for measuring (needs pip install "
             "'finray-calib[denoise]')",
    )  # fmt: skip
    parser.add_argument(
        "--pose-response", action="store_true",
        help="also render how the contact image changes with the indenter's depth and position, so that 'finray "
             "compare' can include the pose's uncertainty (takes three times as long)",
    )  # fmt: skip
    parser.add_argument(
        "--shared-light", action="store_true",
        help="let pixels share the light that reaches the coat, found once by paths from points all over it; the "
             "same time then gives less noise, but neighbouring pixels share a part of it (needs LLVM; not with "
             "--level c)",
    )  # fmt: skip
    add_out(parser, "NAME.press.json")
    add_seed(parser)
    parser.set_defaults(run=run_render, long_work=_long_render)


def add_sweep(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray simulate sweep``."""
    parser = jobs.add_parser("sweep", help=SWEEP_HELP, description=SWEEP_DESCRIPTION)
    parser.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML)")
    parser.add_argument(
        "--angles", type=_angles, required=True, metavar="FIRST:LAST:STEP", help="light angles in deg, e.g. 0:120:10"
    )
    parser.add_argument(
        "--positions", type=_positions, metavar="FIRST:LAST:STEP or MM,MM,...",
        help=(
                "sweep with the indenter at each of these places along the pad (mm from the base), e.g. 8:64:4, so "
                "that the light angle can be decided for all of them; places that were swept before are not swept "
                "again"
            ),
    )  # fmt: skip
    _add_scene(parser)
    parser.add_argument(
        "--narrow-sweep",
        action="store_true",
        help="confirm that the angles, which span less than 4 deg, are in degrees and not in radians",
    )
    parser.add_argument(
        "--objectives", choices=["intensity", "all"], default="intensity",
        help=(
                "what to compute: intensity is only the brightness beside the indenter (default); all adds how well "
                "normals can be measured (Fisher information, held-out error), evenness, colours, clipping and room "
                "for the panel, at the first of --positions only, and takes 15 s more"
            ),
    )  # fmt: skip
    parser.add_argument(
        "--samples", type=path_count, default=4000, metavar="N",
        help="light paths to each probe, an even number (default: 4000)",
    )  # fmt: skip
    add_out(parser, "NAME.sweep.json")
    add_seed(parser)
    parser.set_defaults(run=run_sweep, long_work=_long_sweep)


def _add_scene(parser: argparse.ArgumentParser) -> None:
    """Add what a render and a sweep are made of."""
    add_paint(parser)
    add_paints_as_given(parser)
    parser.add_argument(
        "--surfaces", type=Path, metavar="FILE",
        help="surfaces of the finger without and with contact, from 'finray simulate press' (default: pressed by a "
             "formula)",
    )  # fmt: skip
    add_engine(parser)


def _long_render(arguments: argparse.Namespace) -> LongWork:
    """Return what is about to be done, and what of it is kept if its process dies."""
    return LongWork("the render", NOTHING_KEPT, arguments.out)


def _long_sweep(arguments: argparse.Namespace) -> LongWork:
    """Return what is about to be done, and what of it is kept if its process dies."""
    kept = "Finished places are kept, and the same command continues with the others"
    return LongWork("the sweep of the light angle", kept if arguments.positions else NOTHING_KEPT, arguments.out)


def _angles(text: str) -> list[float]:
    """Parse FIRST:LAST:STEP in degrees, both ends included."""
    try:
        first, last, step = (float(part) for part in text.split(":"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be FIRST:LAST:STEP in deg, for example 0:120:10") from None
    if not (SMALLEST_STEP_DEG <= step <= last - first and first >= -90 and last <= 180):
        raise argparse.ArgumentTypeError(
            f"{text!r}: must have -90 <= FIRST < LAST <= 180 deg and a STEP from {SMALLEST_STEP_DEG:g} deg to LAST - "
            "FIRST"
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
    except (ValueError, OverflowError):
        places = []
    # a place is named in its file to 0.1 mm
    if not places or not all(map(math.isfinite, places)) or len({f"{place:.1f}" for place in places}) < len(places):
        raise argparse.ArgumentTypeError(
            f"{text!r} must be FIRST:LAST:STEP in mm with a STEP of {SMALLEST_STEP_MM:g} mm or more, for example "
            "8:64:4, "
            "or places at least 0.1 mm apart with commas between them, for example 8,15,35"
        )
    return places


RENAMED = {("study", "normal-map"): ("sense", "teach"), ("study", "pixel-scale"): ("sense", "scale")}
"""Verb and job of an earlier version -> those of today."""


def current_spelling(words: Sequence[str]) -> list[str]:
    """Return the words of a command as they are spelled now, and report them where they are spelled as before.

    Before, ``finray simulate DESIGN`` did the three jobs by its options ``--only mechanics``, ``--only optics`` and
    ``--angles``, and teaching and the pixels' scale were studies.
    """
    if tuple(words[:2]) in RENAMED:
        return _told([*RENAMED[words[0], words[1]], *words[2:]])
    if len(words) < 2 or words[0] != "simulate" or words[1].isalpha() or words[1] in ("-h", "--help"):
        return list(words)
    options, only = [], ""
    rest = iter(words[1:])
    for word in rest:
        if word == "--only":
            only = next(rest, "")
        elif word.startswith("--only="):
            only = word.removeprefix("--only=")
        else:
            options.append(word)
    if only == "mechanics":
        job = ["press"]
    elif any(word.split("=")[0] == "--angles" for word in options):
        job = ["sweep"]
    else:
        job = ["render", *(["--images"] if only == "optics" else [])]
    return _told(["simulate", job[0], *options, *job[1:]])


def _told(now: list[str]) -> list[str]:
    """Return the words of a command after telling that they are spelled so now."""
    warn(
        "this spelling is from an earlier version and will be removed in the next one; type "
        f"{shlex.join(['finray', *now])} instead"
    )
    return now


def run_render(arguments: argparse.Namespace) -> None:
    """Render a press and store it, with its images if they are wanted."""
    from data_schemas import SimulatedPress
    from data_schemas.storage import write_record
    from finray_calib import render_images, render_press
    from finray_calib.reports import require_denoiser
    from sim import is_sensor

    if is_sensor(arguments.design):
        _render_sensor(arguments)
        return
    out = arguments.out or Path(f"{file_name(Path(arguments.design).stem)}.press.json")
    out, with_images = require_new(out, ".json"), arguments.images or arguments.denoise
    folder, capture = _image_paths(out) if with_images else (out, out)
    if arguments.denoise:
        require_denoiser()
    options: RenderOptions = {
        "level": arguments.level,
        "samples": arguments.samples,
        "engine": working_engine(arguments.engine),
        "paints_as_given": arguments.paints_as_given,
        "pose_response": arguments.pose_response,
        "shared_light": arguments.shared_light,
    }
    render = render_images if with_images else render_press
    with progress_bar("simulate") as progress:
        rendered = render(
            arguments.design, **both_paint_files(arguments), surfaces=arguments.surfaces, seed=arguments.seed,
            progress=progress, **options,
        )  # fmt: skip
    if not isinstance(rendered, SimulatedPress):
        _store_images(rendered, arguments, out, folder, capture)
        return
    write_record(rendered, out, _origin(rendered, arguments.seed))
    wrote(out, rendered.label)
    _give_press(rendered, out)


def _give_press(press: "SimulatedPress", out: Path) -> None:
    """Give what a program wants to know of a rendered press, and what usually follows."""
    rows, columns = press.contact.shape[:2]
    give(name=press.name, label=press.label, width_px=columns, height_px=rows, light_angle_deg=press.light_angle_deg)
    suggest_command("finray compare", out, "CAPTURE")


def _render_sensor(arguments: argparse.Namespace) -> None:
    """Render a press on a classic sensor and store it, with pictures if they are wanted."""
    from data_schemas import SimulateError
    from data_schemas.storage import ProductSet, write_record
    from finray_calib import render_sensor
    from finray_calib.exchange import write_picture_folder

    of_fingers = {
        "--paint": bool(arguments.paint), "--surfaces": arguments.surfaces is not None,
        "--level": arguments.level != "b", "--pose-response": arguments.pose_response, "--denoise": arguments.denoise,
        "--shared-light": arguments.shared_light,
    }  # fmt: skip
    given = [name for name, is_given in of_fingers.items() if is_given]
    if given:
        raise SimulateError(
            f"{arguments.design}: is a classic sensor; leave out {', '.join(given)}, supported only for painted fingers"
        )
    out = require_new(arguments.out or Path(f"{file_name(Path(arguments.design).stem)}.press.json"), ".json")
    folder = _image_paths(out)[0] if arguments.images else None
    press = render_sensor(
        arguments.design, seed=arguments.seed, samples=arguments.samples, engine=working_engine(arguments.engine)
    )
    origin = _origin(press, arguments.seed)
    with ProductSet(out) as stored:
        if folder is not None:
            write_picture_folder(folder, press, _sensor_views(press), origin, stored)
        write_record(press, out, origin, stored)
    wrote(out, f"{press.label}; {', '.join(press.notes)}")
    _give_press(press, out)
    if folder is not None:
        wrote(folder, "images; README.txt in this folder explains each of them")
        suggest_file(folder)


def _sensor_views(press: "SimulatedPress") -> "dict[str, NDArray[np.uint8]]":
    """Return pictures for the eye, all channels on one scale: without and with contact, and four times the change."""
    import numpy as np

    from finray_calib.reports import to_display

    pad = np.isfinite(press.distance)
    pad |= not pad.any()  # nothing is pressed in, so that no pixel has a distance from the contact
    white = np.full(3, max(float(np.percentile(press.no_contact[pad].max(axis=-1), 99.0)), np.finfo(np.float32).tiny))
    change = 0.5 * white + CHANGE_SHOWN * (press.contact - press.no_contact)
    images = {"no_contact-view": press.no_contact, "contact-view": press.contact}
    shown = {name: to_display(image, white, linear=True) for name, image in images.items()}
    return shown | {"change-view": to_display(change, white, linear=False)}


def run_sweep(arguments: argparse.Namespace) -> None:
    """Sweep the angle of the light, at one place or at several, and store a record of each."""
    from data_schemas import SimulateError, look_like_radians, narrow_sweep_text

    if not arguments.narrow_sweep and look_like_radians(arguments.angles):
        raise SimulateError(f"--angles: {narrow_sweep_text(arguments.angles)}")
    out = arguments.out or Path(f"{file_name(Path(arguments.design).stem)}.sweep.json")
    if arguments.positions is None:
        _sweep(arguments, require_new(out, ".json"), None, "simulate")
        return
    if arguments.surfaces is not None:
        raise SimulateError(
            "--positions works only for presses by a formula, but --surfaces is a press at one place; sweep each "
            "place with its own --surfaces and --out, and give all sweeps to 'finray decide'"
        )
    _sweep_places(arguments, require_ending(out, ".json"))


def _sweep(arguments: argparse.Namespace, out: Path, position_mm: float | None, title: str) -> None:
    """Sweep at one place and store the record."""
    from data_schemas.storage import write_record
    from finray_calib import sweep_light_angle

    options: RenderOptions = {
        "samples": arguments.samples,
        "engine": working_engine(arguments.engine),
        "paints_as_given": arguments.paints_as_given,
        "all_objectives": _has_all_objectives(arguments, position_mm),
        "narrow_sweep": True,
    }
    if position_mm is not None:
        options["position_mm"] = position_mm
    with progress_bar(title) as progress:
        sweep = sweep_light_angle(
            arguments.design, arguments.angles, **both_paint_files(arguments), surfaces=arguments.surfaces,
            seed=arguments.seed, progress=progress, **options,
        )  # fmt: skip
    write_record(sweep, out, _origin(sweep, arguments.seed))
    wrote(out, f"{len(sweep.angles_deg)} angles, {sweep.label}")
    give(angles_deg=sweep.angles_deg, brightness_mean=sweep.values.mean(axis=1), label=sweep.label)
    suggest_command("finray decide", out)


def _has_all_objectives(arguments: argparse.Namespace, position_mm: float | None) -> bool:
    """Return whether a sweep holds all objectives: they are of the undeformed pad, and so the same at every place."""
    is_first = position_mm is None or position_mm == arguments.positions[0]
    return arguments.objectives == "all" and is_first


def _sweep_places(arguments: argparse.Namespace, out: Path) -> None:
    """Sweep at each place and store its record as soon as it is done; what is there already is kept."""
    from data_schemas import SimulateError
    from finray_calib import finger_design

    design = finger_design(arguments.design)
    length_mm = design.pad.length_mm
    off = [place for place in arguments.positions if not 0.0 < place < length_mm]
    if off:
        raise SimulateError(
            f"--positions: {off[0]:g} mm is not on the pad; give places above 0 and below {length_mm:g} mm"
        )
    stem = out.name.removesuffix(".json").removesuffix(".sweep")
    outs = {place: out.with_name(f"{stem}.{place:04.1f}mm.sweep.json") for place in arguments.positions}
    kept = [path for place, path in outs.items() if _is_swept(path, design, place, arguments)]
    todo = {place: require_new(path) for place, path in outs.items() if path not in kept}
    for number, (place, path) in enumerate(todo.items(), start=1):
        _sweep(arguments, path, place, f"simulate, place {number} of {len(todo)}")
    for path in kept:
        say(f"{path}: exists already, made from the same inputs")
    suggest_command("finray decide", *outs.values())


def _is_swept(path: Path, design: "FingerDesign", position_mm: float, arguments: argparse.Namespace) -> bool:
    """Return whether a record is there that this command would write again: same design, paints, angles and effort."""
    if not path.exists():
        return False
    from data_schemas import LightAngleSweep, package_version
    from data_schemas.storage import read_bytes, read_record

    stored = read_record(path, LightAngleSweep)
    indenter = design.indenter.model_copy(update={"position_mm": position_mm})
    touched = design.model_copy(update={"indenter": indenter, "provenance": None})
    paints = {c: hashlib.sha256(read_bytes(file)).hexdigest() for c, file in both_paint_files(arguments).items()}
    origin = stored.provenance
    return (
        origin is not None
        and (origin.seed, origin.package_version) == (arguments.seed, package_version())
        and _effort(origin.command) == _effort(command_line())
        and (stored.design, stored.paints) == (touched, paints)
        and stored.angles_deg.tolist() == arguments.angles
        and (bool(stored.other_objectives) or not _has_all_objectives(arguments, position_mm))
    )


def _effort(command: str) -> tuple[str, ...]:
    """Return what a command says of samples, objectives and engine."""
    words = command.replace("=", " ").split()
    return tuple(" ".join(words[k : k + 2]) for k, word in enumerate(words) if word in _EFFORT)


_EFFORT = frozenset({"--samples", "--objectives", "--engine"})


def _origin(record: "Record", seed: int) -> "Provenance":
    """Return this command as the origin of a record of the library, with the inputs that the library has read."""
    from data_schemas import provenance

    read = {} if record.provenance is None else record.provenance.input_sha256
    return provenance(command_line(), read, seed)


def _image_paths(out: Path) -> tuple[Path, Path]:
    """Return the folder of images and the record of the capture beside a press record; both must be new."""
    stem = out.name.removesuffix(".json").removesuffix(".press")
    return require_new(out.with_name(f"{stem}.optics")), require_new(out.with_name(f"{stem}.capture.json"))


def _store_images(
    products: "OpticsProducts", arguments: argparse.Namespace, out: Path, folder: Path, capture: Path
) -> None:
    """Write the record of a press, its capture and the folder of its images."""
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.exchange import write_optics_folder

    press = products.press
    origin = _origin(press, arguments.seed)
    with ProductSet(out) as stored:
        write_optics_folder(folder, products, _views(press, arguments.samples, arguments.denoise), origin, stored)
        write_record(products.capture, capture, origin, stored)
        write_record(press, out, origin, stored)
    wrote(out, press.label)
    depth = f"{press.design.camera.bit_depth}-bit " if press.design else ""
    wrote(capture, f"{depth}raw counts, for 'finray compare'")
    wrote(folder, "images; README.txt in this folder explains each of them")
    say(str(products.colours))
    _give_press(press, out)
    suggest_file(folder / "README.txt")


def _views(press: "SimulatedPress", samples: int, denoise: bool) -> "dict[str, NDArray[np.uint8]]":
    """Return pictures for the eye: the camera's colours, as a Raspberry Pi shows them, and the bands as colours."""
    import numpy as np

    from finray_calib.reports import denoised, display_white, raspberry_pi_display, to_display
    from sim.experiments import camera_rgb

    bands = {"contact": press.contact_bands, "no_contact": press.no_contact_bands}
    pictures: dict[str, NDArray[np.float32]] = {"contact-view": press.contact, "no_contact-view": press.no_contact}
    pictures |= {f"{state}-view-bands": image for state, image in bands.items() if image is not None}
    if denoise and press.camera_matrix is not None:
        clean = {state: denoised(image, samples) for state, image in bands.items() if image is not None}
        pictures |= {f"{state}-view-denoised": camera_rgb(image, press.camera_matrix) for state, image in clean.items()}
        pictures |= {f"{state}-view-bands-denoised": image for state, image in clean.items()}
    pad = np.isfinite(press.distance)
    shown = {name: to_display(image, display_white(image[pad]), linear=True) for name, image in pictures.items()}
    camera = {"contact": press.contact, "no_contact": press.no_contact}
    return shown | {f"{state}-view-pi": raspberry_pi_display(image, pad) for state, image in camera.items()}


RECOLOUR_HELP = "show a rendered press with other paints, camera or white balance"
RECOLOUR_DESCRIPTION = """\
Recompute the images of a press that 'finray simulate render' has made, for paints of another yield, absorption at the
LED or emission shape, for another camera, or with another white balance. Nothing is rendered: the press stores the
light of each chain of fluorescence separately. The command refuses changes that need a new render: of a paint's
reflectance by more than 0.01 in a band, of a band's place by more than 10 nm, or such that the light that one paint
excites in another grows to three times as much."""


def add_recolour(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("recolour", help=RECOLOUR_HELP, description=RECOLOUR_DESCRIPTION)
    parser.add_argument("press", type=Path, metavar="PRESS", help="rendered press (JSON)")
    add_paint(parser, "paint calibrations of both walls (give an unchanged one again)")
    parser.add_argument("--camera", type=Path, metavar="FILE", help="camera response (CSV)")
    parser.add_argument(
        "--white-balance", type=_white_balance, metavar="R:G:B",
        help="gains of red, green and blue, e.g. 1.8:1:1.4, or 'pad' to make the untouched pad grey on average",
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
        raise argparse.ArgumentTypeError(f"{text!r} must be R:G:B, for example 1.8:1:1.4, or 'pad'") from None
    if not all(0.0 < gain <= 1000.0 for gain in (red, green, blue)):
        raise argparse.ArgumentTypeError(f"{text!r}: the gains must be above 0 and at most 1000")
    return red, green, blue


def run_recolour(arguments: argparse.Namespace) -> None:
    """Recolour, store and report."""
    from time import perf_counter

    from data_schemas import PaintCalibration, SimulatedPress, SimulateError, digest_of_input, provenance
    from data_schemas.storage import read_camera_response, read_record, write_record
    from sim.experiments import paint_optics, recoloured

    files = paint_files(arguments, without="the press's own paints")
    if not files and arguments.camera is None and arguments.white_balance is None:
        raise SimulateError("no change was requested; give --paint for both walls, --camera or --white-balance")
    out = require_new(arguments.out or arguments.press.with_name(f"{arguments.press.stem}-recoloured.json"), ".json")
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
    wrote(out, f"{made.label}, {1000.0 * took_s:.0f} ms of arithmetic")
    _give_press(made, out)
