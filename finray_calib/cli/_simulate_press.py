"""``finray simulate press``: press a finger by finite elements.

Increments that are kept for an interrupted press, and what the console says of a
press whose penalty rests on few nodes.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from finray_calib.cli._output import Progress, give, progress_bar, say, suggest_command, suggest_file, warn, wrote
from finray_calib.cli._run import (
    DEFAULT_INCREMENTS,
    LongWork,
    add_out,
    command_line,
    file_name,
    increment_count,
    input_digests,
    naming,
    number_within,
    require_ending,
    require_new,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_schemas import (
        FingerDesign,
        FingerSurfaces,
        PressMechanics,
        PressMotion,
        PressSensitivities,
        Provenance,
        SurrogateBars,
    )
    from sim.mechanics import PressedFinger


# an increment at the whole push, but for rounding
_SAME_DEPTH = 1e-9


class _Said(TypedDict, total=False):
    """What :func:`~sim.experiments.press_records` is told beside the press itself."""

    engine: str
    notes: tuple[str, ...]
    sensitivities: "PressSensitivities"
    wanted_force_n: float


def _indenter_file(design: "FingerDesign", folder: Path) -> list[Path]:
    """Read the STL of an indenter, for its checksum; one that is missing is told of by who parses it."""
    from data_schemas.storage import read_bytes

    path = folder / (design.indenter.file or "")
    if not path.is_file():
        return []
    read_bytes(path, "an indenter (STL)")
    return [path]


def _surrogate_file(arguments: argparse.Namespace) -> list[Path]:
    """Return the file of a taught surrogate, where one is given, for its checksum."""
    if arguments.surrogate is None:
        return []
    from data_schemas.storage import read_bytes

    read_bytes(arguments.surrogate, "a surrogate (.json)")
    return [arguments.surrogate]


def _path_file(arguments: argparse.Namespace) -> list[Path]:
    """Return the file of the indenter's path, where one is given, for its checksum."""
    if arguments.path is None:
        return []
    return [arguments.path]


def _with_given_path(design: "FingerDesign", path: Path | None) -> "FingerDesign":
    """Return a design whose indenter goes along the path of a file, where one is given; a fault in it is told now."""
    if path is None:
        return design
    from sim.mechanics import read_path

    return design.model_copy(update={"indenter": design.indenter.model_copy(update={"path": read_path(path)})})


def mechanics_paths(out: Path, resume: Path | None = None, goes_on: bool = False) -> dict[str, Path]:
    """Return the records of the press and of its surfaces, the mesh and the picture; all must be new.

    So must be the folder of the increments, but for a press that goes on from an increment in it, or that the same
    command has begun.
    """
    stem = _stem(require_ending(out, ".json"))
    endings = {
        "mechanics": ".mechanics.json",
        "surfaces": ".surfaces.json",
        "mesh": ".vtu",
        "picture": ".mechanics.png",
    }
    files = {what: require_new(out.with_name(stem + ending)) for what, ending in endings.items()}
    from data_schemas import RecordError

    increments = increments_of(out)
    if goes_on:
        return {**files, "increments": increments}
    if resume is None or resume.parent.absolute() != increments.absolute():
        require_new(increments)
    elif any(_number(stored) > _number(resume) for stored in increments.glob("*.json")):
        raise RecordError(
            f"{resume}: later increments are stored in the same folder; choose another --out so that they are kept"
        )
    return {**files, "increments": increments}


def increments_of(out: Path) -> Path:
    """Return the folder of the increments of a press."""
    return out.with_name(f"{_stem(out)}.increments")


def _stem(out: Path) -> str:
    """Return what the names of all files of a press begin with."""
    return out.name.removesuffix(".json").removesuffix(".press").removesuffix(".mechanics")


def _number(increment: Path) -> int:
    """Return the number of a stored increment."""
    return int(increment.stem) if increment.stem.isdecimal() else 0


def last_increment(resume: Path) -> Path:
    """Return the record to go on from: a file, or the last one in a folder of increments."""
    from data_schemas import RecordError

    if not resume.is_dir():
        return resume
    stored = sorted(resume.glob("*.json"), key=_number)
    if not stored:
        raise RecordError(
            f"{resume}: holds no increment of a press; give a folder or file that 'finray simulate press' wrote"
        )
    return stored[-1]


def interrupted_increments(increments: Path, depth_mm: float, origin: "Provenance") -> tuple[bool, Path | None]:
    """Return whether the same command has begun this press, and the increment after which it goes on (none: the start).

    Parameters
    ----------
    increments
        Folder of the increments.
    depth_mm
        The whole push; an increment at it is computed again, as its press was not stored.
    origin
        Of the press that is to be: command, version and inputs must be those of the stored increments.
    """
    from data_schemas import PressIncrement
    from data_schemas.storage import clear_leftovers, read_record

    clear_leftovers(increments)
    if increments.is_dir() and not any(increments.iterdir()):
        return True, None  # interrupted before its first increment was stored
    last = None
    stored = sorted(increments.glob("*.json"), key=_number)
    for path in stored:
        record = read_record(path, PressIncrement)
        if record.provenance is None or _same_run(record.provenance) != _same_run(origin):
            return False, None
        if record.depth_mm[-1] < depth_mm * (1.0 - _SAME_DEPTH):
            last = path
    return bool(stored), last


def _same_run(origin: "Provenance") -> tuple[object, ...]:
    """Return what two runs of one command have in common, whichever increment they went on from."""
    inputs = {name: digest for name, digest in origin.input_sha256.items() if ".increments/" not in name}
    return origin.command, origin.package_version, origin.git_commit, inputs


def run_press(arguments: argparse.Namespace) -> None:
    """Press the design's indenter in, store forces, surfaces, mesh and picture, and tell the curve.

    Raises
    ------
    SimulateError
        When the push ended early, or the presses with one number changed could not be made, after what was reached
        has been stored, and at least a picture.
    """
    from data_schemas import NoEquilibriumError, SimulateError, provenance
    from data_schemas.storage import read_bytes, write_bytes
    from sim import read_design

    _require_one_way(arguments, "" if arguments.path is None else "--path")
    design, folder = _with_given_path(read_design(arguments.design), arguments.path), arguments.design.parent
    if design.indenter.path:
        _require_one_way(arguments, f"{arguments.design}: indenter.path")
    resume = None if arguments.resume is None else last_increment(arguments.resume)
    out = arguments.out or Path(f"{file_name(arguments.design.stem)}.press.json")
    read = [arguments.design, *_indenter_file(design, folder), *_path_file(arguments), *_surrogate_file(arguments)]
    goes_on = False
    if resume is None:
        begun = increments_of(out)
        goes_on, resume = interrupted_increments(
            begun, design.indenter.depth_mm, provenance(command_line(), input_digests(read), None)
        )
    files = mechanics_paths(out, resume, goes_on)
    if goes_on:
        where = "starts again from the beginning" if resume is None else f"continues after increment {resume.stem}"
        warn(f"{files['increments']}: this press was interrupted; it {where}")
    if resume is not None:
        read_bytes(resume, "a stored increment of a press (.json)")
        read.append(resume)
    origin = provenance(command_line(), input_digests(read), None)
    if arguments.surrogate is not None and not goes_on and _answered(arguments, design, files, origin):
        return
    try:
        with progress_bar("simulate") as progress, naming(SimulateError, arguments.design):
            pressed, said = _pressed(arguments, design, resume, files["increments"], origin, progress)
            unvaried = _vary(arguments, design, pressed, said, progress)
    except NoEquilibriumError as stuck:
        if resume is not None:
            raise
        from finray_calib.reports import untouched_finger_png

        write_bytes(files["picture"], untouched_finger_png(design, str(stuck), folder))
        raise NoEquilibriumError(f"{stuck}. {files['picture']} shows where the indenter touches") from stuck
    changed = [name for name, digest in input_digests(read).items() if digest != origin.input_sha256[name]]
    if changed:
        raise SimulateError(f"{changed[0]}: was changed while the press was computed from it; run the command again")
    _store(design, pressed, said, files, origin, folder)
    if unvaried:
        raise SimulateError(f"{unvaried}. The press itself is stored; to compute its sensitivities, try a smaller push")


def _answered(
    arguments: argparse.Namespace, design: "FingerDesign", files: dict[str, Path], origin: "Provenance"
) -> bool:
    """Let a taught surrogate answer and store that; return False where finite elements are to press instead."""
    from data_schemas import PressSurrogate, SimulateError
    from data_schemas.storage import read_record
    from sim.experiments import LIMIT_REL, SurrogateFinger, press_records

    limit_rel = LIMIT_REL if arguments.largest_error is None else arguments.largest_error
    taught = read_record(arguments.surrogate, PressSurrogate)
    with naming(SimulateError, arguments.design):
        opened = SurrogateFinger(taught, limit_rel)
        pressed, bars, notes, doubt = opened.press_as_designed(design, arguments.increments or DEFAULT_INCREMENTS)
    if doubt:
        warn(
            f"{arguments.surrogate}: the surrogate is not used, because {doubt}; finite elements compute the press "
            "instead"
        )
        return False
    mechanics, surfaces = press_records(design, pressed, taught.preset, taught.label, notes)
    mechanics = mechanics.model_copy(update={"surrogate": bars})
    _write(mechanics, surfaces, pressed, files, origin, arguments.design.parent)
    return True


def _pressed(
    arguments: argparse.Namespace,
    design: "FingerDesign",
    resume: Path | None,
    increments: Path,
    origin: "Provenance",
    progress: Progress,
) -> "tuple[PressedFinger, _Said]":
    """Press by what was asked for; return also what must be said about it."""
    from finray_calib.spectra import machine_threads

    count, threads, folder = arguments.increments or DEFAULT_INCREMENTS, machine_threads(), arguments.design.parent
    if arguments.engine == "calculix":
        from sim.mechanics.other_engines import calculix_notes, calculix_version, press_finger_calculix

        engine = f"CalculiX {calculix_version()}"
        pressed = press_finger_calculix(design, None, count, threads, progress)
        return pressed, {"engine": engine, "notes": calculix_notes(design)}
    from sim.mechanics import PressSettings, press_as_designed, press_to_force

    if design.indenter.path:
        settings = PressSettings(None, count, threads, arguments.contact, arguments.budget)
        return press_as_designed(design, settings, folder=folder, progress=progress), {}
    if arguments.force is not None:
        settings = PressSettings(None, count, threads, budget_s=arguments.budget)
        pressed = press_to_force(design, arguments.force, settings, folder=folder, progress=progress)
        return pressed, {"wanted_force_n": arguments.force}
    return _pressed_to_depth(arguments, design, count, resume, increments, origin, progress), {}


def _vary(
    arguments: argparse.Namespace, design: "FingerDesign", pressed: "PressedFinger", said: _Said, progress: Progress
) -> str:
    """Find what the force depends on, if that was asked for, and add it to what is said; return why it failed."""
    if not arguments.sensitivities or pressed.unreached:
        return ""
    from data_schemas import SimulateError
    from finray_calib.spectra import machine_threads
    from sim.experiments import press_sensitivities

    folder, contact = arguments.design.parent, arguments.contact
    try:
        said["sensitivities"] = press_sensitivities(design, pressed, machine_threads(), progress, contact, folder)
    except SimulateError as failed:
        unvaried = f"the sensitivities of the force could not be computed: {failed}"
        said["notes"] = (unvaried,)
        return unvaried
    return ""


def _pressed_to_depth(
    arguments: argparse.Namespace,
    design: "FingerDesign",
    count: int,
    resume: Path | None,
    kept: Path,
    origin: "Provenance",
    progress: Progress,
) -> "PressedFinger":
    """Press, or go on pressing, and store each increment."""
    from data_schemas import PressIncrement
    from data_schemas.storage import read_record, write_record
    from finray_calib.spectra import machine_threads
    from sim.experiments import increment_record, stored_press
    from sim.mechanics import PressSettings, press_finger

    folder, contact = arguments.design.parent, arguments.contact
    digest = origin.input_sha256.get((folder / (design.indenter.file or "")).as_posix())
    before = None
    if resume is not None:
        before = stored_press(read_record(resume, PressIncrement), design, contact, digest, folder)

    def store(pressed: "PressedFinger") -> None:
        record = increment_record(design, pressed, indenter_sha256=digest)
        path = kept / f"{len(pressed.depth_mm):03d}.json"
        if not path.exists():  # the last one of an interrupted press is computed again
            write_record(record, path, origin)

    settings = PressSettings(None, count, machine_threads(), contact, arguments.budget)
    return press_finger(design, settings, folder=folder, resume=before, store=store, progress=progress)


def _store(
    design: "FingerDesign",
    pressed: "PressedFinger",
    said: "_Said",
    files: dict[str, Path],
    origin: "Provenance",
    folder: Path,
) -> None:
    """Write records, mesh and picture, tell the curve, and what is wrong with the press."""
    from data_schemas import SimulateError
    from sim.experiments import press_records

    mechanics, surfaces = press_records(design, pressed, **said)
    _write(mechanics, surfaces, pressed, files, origin, folder)
    if pressed.crossing:
        remedy = "press with --contact barrier, or less deeply" if pressed.motion is None else "push less on the path"
        warn(f"warning: {pressed.crossing}; the results from there on are not physical. To avoid this, {remedy}")
    if pressed.unstable:
        warn(f"warning: {pressed.unstable}; press in smaller increments to see whether this warning remains")
    if mechanics.motion is None:
        warn_of_few_nodes(pressed, mechanics)
    if mechanics.unreached:
        if mechanics.motion is not None:
            raise SimulateError(
                f"the path ended early, after {len(mechanics.depth_mm)} increments: {mechanics.unreached}. The "
                "increments reached so far are stored"
            )
        reached = f"{mechanics.depth_mm[-1]:.4g} of {design.indenter.depth_mm:g} mm"
        if mechanics.wanted_force_n is not None:
            reached = f"{mechanics.force_n[-1, 1]:.4g} of {mechanics.wanted_force_n:g} N"
        raise SimulateError(
            f"the push ended early, at {reached}: {mechanics.unreached}. The increments reached so far are stored and "
            "can be rendered"
        )


def _write(
    mechanics: "PressMechanics",
    surfaces: "FingerSurfaces",
    pressed: "PressedFinger",
    files: dict[str, Path],
    origin: "Provenance",
    folder: Path,
) -> None:
    """Write records, mesh and picture, and tell the curve."""
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.exchange import vtu_bytes
    from finray_calib.reports import indenter_path_png, pressed_finger_png
    from sim.mechanics import contact_pressure_mpa

    touched = contact_pressure_mpa(pressed)
    with ProductSet(files["mechanics"]) as products:
        products.add(files["mesh"], vtu_bytes(pressed.mesh, pressed.displacement_mm[-1], touched))
        moved = mechanics.motion is not None
        picture = indenter_path_png(mechanics) if moved else pressed_finger_png(mechanics, surfaces, folder)
        products.add(files["picture"], picture)
        write_record(surfaces, files["surfaces"], origin, products)
        write_record(mechanics, files["mechanics"], origin, products)
    _tell(mechanics, files)


def _tell(mechanics: "PressMechanics", files: dict[str, Path]) -> None:
    """Tell the curve and what is stored."""
    wrote(files["mechanics"], mechanics.label)
    give(
        label=mechanics.label, depth_mm=mechanics.depth_mm, force_n=mechanics.force_n[:, 1],
        largest_pressure_mpa=mechanics.largest_pressure_mpa, unreached=mechanics.unreached,
    )  # fmt: skip
    if mechanics.motion is not None:
        _report_motion(mechanics, mechanics.motion)
    elif mechanics.surrogate is not None:
        _report_bars(mechanics, mechanics.surrogate)
    else:
        for depth, force in zip(mechanics.depth_mm, mechanics.force_n, strict=True):
            say(f"  push {depth:6.3f} mm   force {force[1]:7.3f} N")
    if mechanics.slip_torque_per_friction_n_mm is not None:
        say(
            f"  the grip resists a torque of {mechanics.slip_torque_per_friction_n_mm:.3g} N mm times the friction "
            f"coefficient about the pad's normal, and {mechanics.tipping_torque_n_mm:.3g} N mm about the finger's long "
            "axis"
        )
    if mechanics.sensitivities is not None:
        _report_sensitivities(mechanics.sensitivities)
    wrote(files["surfaces"], "surfaces of the pressed finger, for 'finray simulate render'")
    wrote(files["mesh"], "the pressed mesh, for ParaView")
    shown = "the finger before and after, and its force"
    if mechanics.motion is not None:
        shown = "forces and torques along the path, pressure and slip on the pad"
    wrote(files["picture"], shown)
    suggest_command("finray simulate render", files["surfaces"], "--paint red=FILE --paint green=FILE")
    suggest_file(files["picture"])


def _report_sensitivities(found: "PressSensitivities") -> None:
    """Tell what the force at the whole push answers to, the strongest first."""
    slopes = {slope.field: float(slope.ln_force_per_ln_number[-1]) for slope in found.slopes}
    give(ln_force_per_ln_number=slopes, pressed_again=[varied.field for varied in found.varied])
    say("  change of the force at the full push, in %, when a number grows by 1 %:")
    for field, slope in sorted(slopes.items(), key=lambda pair: -abs(pair[1])):
        say(f"    {field:38s} {slope:+.3f}")
    if found.varied:
        say(f"  {len(found.varied)} presses, each with one number changed, for numbers without a derivative")
    say("  'finray compare --force' includes their uncertainty")


def _report_bars(mechanics: "PressMechanics", bars: "SurrogateBars") -> None:
    """Tell a surrogate's curve with its bars."""
    give(force_bar_n=bars.force_bar_n, surface_bar_mm=bars.surface_bar_mm, bar_level=bars.level_share)
    rows = zip(mechanics.depth_mm, mechanics.force_n[:, 1], bars.force_bar_n, bars.surface_bar_mm, strict=True)
    for depth, force, bar, surface in rows:
        say(
            f"  push {depth:6.3f} mm   force {force:7.3f} +- {bar:.3f} N   coat position +- {1e3 * surface:.0f} um "
            "(rms)"
        )
    say(
        f"  computed by a surrogate: in {100 * bars.level_share:.0f} % of presses its error bars contain its "
        f"difference from finite elements; the error of the finite elements is not included"
    )


def _report_motion(mechanics: "PressMechanics", motion: "PressMotion") -> None:
    """Tell forces and torques at each increment of a path, and how much of the patch sticks."""
    give(
        force_xyz_n=mechanics.force_n, torque_xyz_n_mm=motion.torque_n_mm, moves_mm=motion.moves_mm,
        turns_deg=motion.turns_deg, patch_mm2=motion.patch_mm2, stuck_mm2=motion.stuck_mm2,
        friction_work_n_mm=mechanics.friction_work_n_mm,
    )  # fmt: skip
    say("  on the indenter: force (N), and torque (N mm) about its middle;")
    say("  x across, y along the normal, z along the finger")
    rows = zip(
        motion.moves_mm, motion.turns_deg, mechanics.force_n, motion.torque_n_mm, motion.patch_mm2, motion.stuck_mm2,
        strict=True,
    )  # fmt: skip
    for move, turn, force, torque, patch, stuck in rows:
        where = f"move {_three(move, 2)} mm  turn {_three(turn, 1)} deg"
        share = f"{100 * stuck / patch:3.0f} % of {patch:.3g} mm2 sticks" if patch > 0.0 else "nothing touches"
        say(f"  {where}  force {_three(force, 3)}  torque {_three(torque, 2)}  {share}")


def _three(values: "NDArray[np.float64]", digits: int) -> str:
    """Return three numbers in columns; what rounds to 0 has no sign, whose removal would move the columns."""
    return " ".join(f"{value:7.{digits}f}" for value in values.round(digits) + 0.0)


LARGEST_FORCE_N, LARGEST_BUDGET_S = 1000.0, 1e6


PRESS_HELP = "press the indenter into a finger by finite elements"
PRESS_DESCRIPTION = """\
Press the indenter of the design into the finger by finite elements, as finely as the design's [mesh] table says. The
command stores force against push (NAME.mechanics.json), the deformed finger (NAME.surfaces.json, for 'finray simulate
render'), its mesh (.vtu) and a picture, and each increment on the way, from which an interrupted press continues."""


def add_press(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray simulate press``."""
    parser = jobs.add_parser("press", help=PRESS_HELP, description=PRESS_DESCRIPTION)
    parser.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML)")
    parser.add_argument(
        "--increments", type=increment_count, metavar="N", help=f"steps of the push (default: {DEFAULT_INCREMENTS})"
    )
    parser.add_argument(
        "--force", type=number_within("a force in N", (0.0, LARGEST_FORCE_N), above=True), metavar="NEWTON",
        help="press until the indenter pushes with this force in N, without friction, instead of to the design's "
             "depth_mm",
    )  # fmt: skip
    parser.add_argument(
        "--path", type=Path, metavar="CSV",
        help="move the indenter along the poses of a CSV file, from first touch and with the design's friction, "
             "instead of the design's path or depth_mm; columns: across_mm, push_mm, along_mm, turn_x_deg, "
             "turn_y_deg, turn_z_deg and increments",
    )  # fmt: skip
    parser.add_argument(
        "--resume", type=Path, metavar="INCREMENT",
        help="continue from a stored increment, or from the last one in a folder NAME.increments",
    )  # fmt: skip
    parser.add_argument(
        "--budget", type=number_within("a processor time in s", (0.0, LARGEST_BUDGET_S), above=True), metavar="SECONDS",
        help="end the press before it takes more than this processor time in s (all threads together); the "
             "increments up to there are kept, with a picture, and the exit status is 2",
    )  # fmt: skip
    parser.add_argument(
        "--contact", choices=["auto", "penalty", "barrier"], default="auto",
        help="contact method: penalty (fast), barrier (also between ribs) or auto (default: penalty, and barrier "
             "where ribs meet)",
    )  # fmt: skip
    parser.add_argument(
        "--sensitivities", action="store_true",
        help="also report how the force depends on each uncertain modulus and thickness, by derivatives, so that "
            "'finray compare --force' can include their uncertainty",
    )  # fmt: skip
    parser.add_argument(
        "--engine", choices=["auto", "calculix"], default="auto",
        help="finite elements to use: finray's own (auto, the default) or those of the program CalculiX (calculix)",
    )  # fmt: skip
    _add_surrogate(parser)
    add_out(parser, "NAME.mechanics.json, with the other files beside it")
    parser.set_defaults(run=run_press, long_work=_long_press)


def _add_surrogate(parser: argparse.ArgumentParser) -> None:
    """Add what lets a surrogate answer."""
    parser.add_argument(
        "--surrogate", type=Path, metavar="FILE",
        help="compute the press with error bars by a surrogate that 'finray simulate teach' made; finite elements "
             "are used where the error bars are too large",
    )  # fmt: skip
    parser.add_argument(
        "--largest-error", type=number_within("a share (0.1 is 10 %)", (0.0, 1.0), above=True), metavar="SHARE",
        help="largest error bar of a surrogate, relative to the force or to the surface's displacement; above it, "
            "finite elements are used (default: 0.1)",
    )  # fmt: skip


def _long_press(arguments: argparse.Namespace) -> LongWork:
    """Return what is about to be done, and what of it is kept if its process dies."""
    kept = "Finished increments are kept, and the same command continues after the last one"
    moved = arguments.path is not None or _has_path(arguments.design)
    if arguments.force is not None or moved or arguments.engine == "calculix":
        kept = "Nothing is stored before the end, so the same command starts from the beginning"
    return LongWork("the press by finite elements", kept, arguments.out)


def _has_path(file: Path) -> bool:
    """Return whether a design's indenter has a path; a fault in the file is told by who presses it."""
    from data_schemas import FinrayError
    from sim import read_design

    try:
        return bool(read_design(file).indenter.path)
    except FinrayError:
        return False


def _require_one_way(arguments: argparse.Namespace, path: str) -> None:
    """Refuse what does not go together; `path` names where the indenter's path stands, nothing without one."""
    from data_schemas import SimulateError

    calculix = arguments.engine == "calculix"
    forced, resumes = arguments.force is not None, arguments.resume is not None
    calculix_or_resumes = ["--resume"] * resumes + ["--engine calculix"] * calculix
    others = ["--sensitivities"] * arguments.sensitivities + ["--contact barrier"] * (arguments.contact == "barrier")
    others += calculix_or_resumes
    own = ["--force"] * forced
    if arguments.surrogate is not None and (clash := [path] * bool(path) + own + others):
        raise SimulateError(
            "--surrogate computes only a press to a given depth along the pad's normal, without friction; leave out "
            f"--surrogate, or {_all_of(clash)}"
        )
    if arguments.largest_error is not None and arguments.surrogate is None:
        raise SimulateError(
            "--largest-error applies only to a surrogate; add --surrogate FILE, or leave --largest-error out"
        )
    if calculix and arguments.contact != "auto":
        raise SimulateError("--contact: CalculiX has its own contact method; leave out --contact or --engine calculix")
    if forced and others:
        raise SimulateError(
            "--force works only from first touch, with penalty contact and finray's own elements, and without "
            f"sensitivities; leave out --force, or {_all_of(others)}"
        )
    if path and (clash := own + others):
        raise SimulateError(
            f"{path} moves the indenter along given poses, which works only from first touch, with penalty contact "
            f"and finray's own elements, and without sensitivities; leave out {path}, or {_all_of(clash)}"
        )
    if arguments.sensitivities and calculix_or_resumes:
        raise SimulateError(
            "--sensitivities need a complete press by finray's own finite elements; leave out --sensitivities, or "
            f"{_all_of(calculix_or_resumes)}"
        )
    if arguments.budget is not None and (calculix or arguments.sensitivities):
        raise SimulateError(
            "--budget works only for a single press with finray's own elements; leave out --budget, or "
            f"{('--engine calculix' if calculix else '--sensitivities')}"
        )
    if calculix and resumes:
        raise SimulateError(
            "--resume: CalculiX can only press from first touch; leave out --resume, or --engine calculix"
        )


def _all_of(options: list[str]) -> str:
    """Return options as one list in words."""
    return " and ".join(([", ".join(options[:-1])] if options[1:] else []) + options[-1:])


def warn_of_few_nodes(pressed: "PressedFinger", mechanics: "PressMechanics") -> None:
    """Warn of a force that rests on few nodes; refuse one that rests on none.

    Raises
    ------
    SimulateError
        When the indenter touches no node of the coat at the end of its push.
    """
    from data_schemas import SimulateError
    from sim.mechanics import LARGEST_UNTOLD_REL, STEPS, chord_shortfall_rel

    if pressed.kind != "penalty":
        return
    push_mm, step_mm = float(mechanics.depth_mm[-1]), STEPS[mechanics.preset].pad_mm
    force_n = float(mechanics.force_n[-1, 1])
    finer = "a finer [mesh] preset"
    remedy = f"press with {finer if mechanics.wanted_force_n is not None else f'--contact barrier, or with {finer}'}"
    if force_n <= 0.0:
        raise SimulateError(
            f"at a push of {push_mm:.4g} mm the indenter touches no node of the coat, whose elements are {step_mm:g} "
            f"mm wide, so the force of {force_n:.3g} N comes from the mesh, not from the finger; {remedy}. What was "
            "computed is stored"
        )
    short = chord_shortfall_rel(mechanics.design, mechanics.preset, push_mm)
    if short > LARGEST_UNTOLD_REL:
        warn(
            f"warning: the coat's elements of {step_mm:g} mm are too wide for this indenter at a push of {push_mm:.4g} "
            f"mm, so the force there is some {100 * short:.0f} % too low; {remedy}"
        )
