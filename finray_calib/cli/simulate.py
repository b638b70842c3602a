"""``finray simulate``: render a press of a finger, or sweep the angle of its light."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import (
    add_out,
    add_paint,
    add_seed,
    command_line,
    design_inputs,
    file_name,
    input_digests,
    open_engine,
    paint_files,
    progress_bar,
    require_new,
    say,
)

if TYPE_CHECKING:
    from data_schemas.design import FingerDesign

HELP = "render a press of a painted finger, or sweep the light angle"
SMALLEST_STEP_DEG = 0.5
DEFAULT_INCREMENTS = 4
DESCRIPTION = """\
Render the contact and no-contact image of a finger with calibrated paints. With --angles, sweep the angle of
the blue light instead and write the brightness beside the indenter at each angle, for 'finray decide'.

With --only optics the images are written as files too, in a folder beside the record: basis bands, spectra and
geometry per pixel (OpenEXR), raw frames and pictures (PNG), and the press as a capture for 'finray compare'.

Levels: b (default) the walls re-emit the blue light that reaches them; a the paper's emitter, textured by the
distance from the light (linear as printed, or inverse square; no angle dependence: for comparison only); c the
reference, fluorescence traced along every path: the mean of b without its smoothing, much noisier.

With --only mechanics, the indenter of the design is pressed in by finite elements; the fineness is that of the design's
[mesh] table. With --surfaces, such a deformed finger (FingerSurfaces record) takes the place of the analytic press."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "simulate", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML)")
    add_paint(parser)
    parser.add_argument(
        "--only", choices=["mechanics", "optics"],
        help="mechanics: press the finger by finite elements (no paints needed); optics: render and write the images",
    )  # fmt: skip
    parser.add_argument(
        "--increments", type=_count, metavar="N",
        help=f"with --only mechanics: steps of the push (default {DEFAULT_INCREMENTS})",
    )  # fmt: skip
    parser.add_argument(
        "--resume", type=Path, metavar="INCREMENT",
        help="with --only mechanics: go on from a stored increment, or the last one in a folder NAME.increments",
    )  # fmt: skip
    parser.add_argument(
        "--contact", choices=["auto", "penalty", "barrier"], default="auto",
        help="with --only mechanics: penalty (fast, no friction), barrier (friction, any indenter, contact of ribs) or "
        "auto (default: penalty where it can)",
    )  # fmt: skip
    parser.add_argument(
        "--sensitivities", action="store_true",
        help="with --only mechanics: also press with each uncertain modulus and thickness changed (some 15 presses), "
        "so that 'finray compare --force' can carry their uncertainty",
    )  # fmt: skip
    parser.add_argument("--angles", type=_angles, metavar="FIRST:LAST:STEP", help="light angles in deg, e.g. 0:120:10")
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
        "--denoise", action="store_true", help="with --only optics: also denoised pictures, for the eye only"
    )
    parser.add_argument(
        "--pose-response", action="store_true",
        help="also render how the contact image changes with the indenter's depth and position, so that 'finray "
        "compare' can carry the pose's uncertainty (three times the time)",
    )  # fmt: skip
    add_out(parser, "DESIGN.press.json or DESIGN.sweep.json")
    add_seed(parser)
    parser.set_defaults(run=run)


def _count(text: str) -> int:
    """Parse a number of increments."""
    if not text.isdecimal() or not 1 <= int(text) <= 1000:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from 1 to 1000")
    return int(text)


def _require_mechanics_only(arguments: argparse.Namespace) -> None:
    """Refuse what only the optics reads."""
    from data_schemas.errors import SimulateError

    optical: dict[str, object] = {
        "paint": [],
        "angles": None,
        "objectives": "intensity",
        "surfaces": None,
        "level": "b",
        "samples": None,
        "denoise": False,
        "pose_response": False,
    }
    for name, default in optical.items():
        if getattr(arguments, name) != default:
            raise SimulateError(f"--{name} belongs to the optics; leave it out with --only mechanics")
    if arguments.engine not in {"auto", "calculix"}:
        raise SimulateError(f"--engine {arguments.engine} renders; give calculix with --only mechanics, or none")
    if arguments.engine == "calculix" and arguments.contact != "auto":
        raise SimulateError("--contact: CalculiX has a contact of its own; leave out --contact, or --engine calculix")
    if arguments.sensitivities and (arguments.engine == "calculix" or arguments.resume is not None):
        raise SimulateError("--sensitivities need a whole press by the elements here; leave out --resume and --engine")
    if arguments.engine == "calculix" and arguments.resume is not None:
        raise SimulateError("--resume: CalculiX presses from first touch; leave out --resume, or --engine calculix")


def _indenter_file(design: "FingerDesign", folder: Path) -> list[Path]:
    """Return the STL of an indenter; one that is missing is told of by who reads it."""
    path = folder / (design.indenter.file or "")
    return [path] if path.is_file() else []


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


def run(arguments: argparse.Namespace) -> None:
    """Render or sweep, and report."""
    from data_schemas.design import FingerDesign
    from data_schemas.errors import SimulateError
    from data_schemas.fit import PaintCalibration
    from data_schemas.provenance import provenance
    from data_schemas.storage import read_record, read_toml, sha256_of, write_record
    from data_schemas.surfaces import FingerSurfaces
    from finray_calib.cli.simulate_optics import DEFAULT_SAMPLES, simulate_optics
    from sim.experiments.light_angle import light_angle_sweep
    from sim.experiments.painted_finger import paint_finger, paint_optics
    from sim.experiments.press import simulate_press
    from sim.surface_meshes.stored_shape import restore_shapes

    design = read_toml(arguments.design, FingerDesign)
    kind = "press" if arguments.angles is None else "sweep"
    out = arguments.out or Path(f"{file_name(design.name)}.{kind}.json")
    if arguments.only == "mechanics":
        _require_mechanics_only(arguments)
        from finray_calib.cli.simulate_mechanics import last_increment, simulate_mechanics_verb

        resume = None if arguments.resume is None else last_increment(arguments.resume)
        read = [arguments.design, *([resume] if resume else []), *_indenter_file(design, arguments.design.parent)]
        origin = provenance(command_line(), input_digests(read), None)
        with progress_bar("simulate") as progress:
            simulate_mechanics_verb(
                design, arguments.increments or DEFAULT_INCREMENTS, resume, out, origin, progress, arguments.engine,
                arguments.contact, arguments.design.parent, arguments.sensitivities,
            )  # fmt: skip
        return
    if arguments.engine == "calculix":
        raise SimulateError("--engine calculix presses, it does not render; add --only mechanics, or leave it out")
    if arguments.contact != "auto":
        raise SimulateError("--contact is that of the finite elements; add --only mechanics or leave it out")
    if arguments.sensitivities:
        raise SimulateError("--sensitivities are those of a force; add --only mechanics or leave it out")
    if arguments.resume is not None:
        raise SimulateError("--resume goes on with a press of finite elements; add --only mechanics or leave it out")
    require_new(out)
    if arguments.increments is not None:
        raise SimulateError("--increments are steps of finite elements; add --only mechanics or leave it out")
    files = paint_files(arguments)
    if arguments.angles is not None and arguments.level != "b":
        raise SimulateError(
            f"--level {arguments.level}: sweeps are made with level b (the paper's emitters of level a know no light "
            "angle, level c is too noisy); leave out --level, or --angles"
        )
    if arguments.objectives != "intensity" and arguments.angles is None:
        raise SimulateError("--objectives are those of a sweep; add --angles FIRST:LAST:STEP, or leave it out")
    if arguments.denoise and arguments.only != "optics":
        raise SimulateError("--denoise makes pictures, which --only optics writes; add --only optics or leave it out")
    if arguments.only == "optics" and arguments.angles is not None:
        raise SimulateError("--angles writes no images; leave out --only optics, or --angles")
    if arguments.pose_response and (arguments.angles is not None or arguments.surfaces is not None):
        raise SimulateError(
            "--pose-response belongs to one press by the analytic contact; leave it out, or --angles and --surfaces"
        )
    calibrations = {colour: read_record(path, PaintCalibration) for colour, path in files.items()}
    digests = {colour: sha256_of(path) for colour, path in files.items()}
    meshes = [] if arguments.surfaces is None else [arguments.surfaces]
    shapes = restore_shapes(read_record(meshes[0], FingerSurfaces)) if meshes else None
    paints = {colour: paint_optics(calibration) for colour, calibration in calibrations.items()}
    finger = paint_finger(design, paints, arguments.design.parent, open_engine(arguments.engine))
    origin = provenance(
        command_line(),
        input_digests([*design_inputs(design, arguments.design), *files.values(), *meshes]),
        arguments.seed,
    )
    with progress_bar("simulate") as progress:
        if arguments.only == "optics":
            simulate_optics(
                finger, arguments.level, arguments.seed, arguments.samples, digests, out, origin, progress,
                arguments.denoise, shapes, calibrations, arguments.pose_response,
            )  # fmt: skip
        elif arguments.angles is None:
            samples = arguments.samples or DEFAULT_SAMPLES
            press = simulate_press(
                finger, arguments.level, arguments.seed, samples, digests, progress, shapes, calibrations,
                arguments.pose_response,
            )  # fmt: skip
            write_record(press, out, origin)
            say(f"{out}: {press.label}")
        else:
            sweep = light_angle_sweep(
                finger, calibrations, arguments.angles, 6, arguments.samples or 4000, arguments.seed, digests, progress,
                shapes and shapes[1], arguments.objectives == "all", shapes and shapes[0],
            )  # fmt: skip
            write_record(sweep, out, origin)
            say(f"{out}: {len(sweep.angles_deg)} angles, {sweep.label}")
