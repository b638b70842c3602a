"""``finray rig`` and ``finray live``: write a rig file, find devices, show what they report, and look through them."""

import argparse
import contextlib
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from data_schemas import CaptureError, FinrayError
from data_schemas.storage import read_text
from finray_calib.cli._capture import Attended, capture, resume, warn_of_laser
from finray_calib.cli._output import give, guide, is_for_a_terminal, say, suggest_command, warn, wrote
from finray_calib.cli._run import (
    add_out,
    command_line,
    ended_by_signals,
    input_digests,
    interruptible,
    require_new,
    whole_number,
)

if TYPE_CHECKING:
    from data_schemas import (
        CameraPlan,
        LoadCellCalibration,
        LoadCellSettings,
        PaintPlan,
        RigFile,
        TactilePlan,
        TactileRig,
    )
    from rigs import FoundDevice, LoadCell, Role


RIG_HELP = "write a rig file, find devices, and show what the devices of a rig report"
INIT_HELP = "write a commented rig file to start from"
INIT_DESCRIPTION = """\
Write a rig file with a comment on every value, based on a preset.

"paper": the paper's set-up. On a terminal you choose among the devices that are found; otherwise the preset's own
are written. The command lists what is left to fill in.

"finger": a rig that presses a finger by itself: camera, stage with GRBL, load cell with HX711.

"simulated-finger": the same to practise on without any device; with it comes a plan.

"simulated", "simulated-green": a rig to practise on without any device, with a red or a green paint under its lens:
the commands of the how-to pages run on it, and its file states the true spectrum of the paint."""
DETECT_HELP = "list the cameras, filter wheels and lights that can be found"
DETECT_DESCRIPTION = """\
Ask every driver what it can find, and print driver and address as a rig file names them. Serial ports behind USB are
opened for a moment; most Arduino boards restart then."""
SHOW_HELP = "show what each device of a rig reports"
SHOW_DESCRIPTION = """\
Open each device of a rig on its own and print what it is, the position of the wheel, whether the lights are off, what
switches them off when a process or the computer fails, one dark exposure of the camera, and the filters. Nothing moves
and the lights stay off. If a device cannot be reached, the others are still shown, and the exit status is 2."""


CALIBRATE_HELP = "calibrate the load cell of a rig with known masses"
CALIBRATE_DESCRIPTION = """\
Ask for one mass after another on the load cell, up and down again, and store the slope in newtons per count with its
uncertainty, linearity, hysteresis, noise and drift. The rig file names the record (calibration of [load_cell]). Place
the masses so that they load the cell in the direction in which the finger presses. The stage is not opened."""
READINGS_OF_A_MASS = 40
SETTLES_WITHIN_S = 1.0
FINGER_PRESETS = ("finger", "simulated-finger")
PRACTICE_PRESSES = """\
# A tactile session of a stage: one press to a depth, one until a force.
schema_version = 2
kind = "tactile"
name = "practice finger"
design = "simulated finger"
exposures_s = [0.01]
led_current_ma = 20.0
light_angle_deg = 30.0
light_angle_uncertainty_deg = 0.5

[indenter]
shape = "ball"
radius_mm = 4.0

[[presses]]
depth_mm = 0.5
position_mm = 8.0
depth_uncertainty_mm = 0.02
position_uncertainty_mm = 0.1

[[presses]]
depth_mm = 1.5             # must not be exceeded
until_force_n = 1.0        # ends the press
force_limit_n = 2.0        # stops the stage and ends the session
position_mm = 12.0
depth_uncertainty_mm = 0.02
position_uncertainty_mm = 0.1
"""
PRACTICE_PAINTS = {"simulated": "red", "simulated-green": "green"}


def add_rig(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and what it can do."""
    parser = verbs.add_parser("rig", help=RIG_HELP, description=RIG_HELP)
    actions = parser.add_subparsers(dest="action", metavar="ACTION", title="actions", required=True)
    init = actions.add_parser("init", help=INIT_HELP, description=INIT_DESCRIPTION)
    presets = ("paper", *FINGER_PRESETS, *PRACTICE_PAINTS)
    told = f"{', '.join(presets)}; default: paper"
    init.add_argument("--preset", choices=presets, default="paper", metavar="PRESET", help=told)
    add_out(init, "rig.toml")
    init.set_defaults(run=run_init)
    detect = actions.add_parser("detect", help=DETECT_HELP, description=DETECT_DESCRIPTION)
    detect.set_defaults(run=run_detect)
    show = actions.add_parser("show", help=SHOW_HELP, description=SHOW_DESCRIPTION)
    show.add_argument("rig", type=Path, metavar="RIG", help="rig file (TOML)")
    show.set_defaults(run=run_show)
    _add_calibrate_cell(actions)


def _add_calibrate_cell(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the calibration of a load cell."""
    parser = actions.add_parser("calibrate-cell", help=CALIBRATE_HELP, description=CALIBRATE_DESCRIPTION)
    parser.add_argument("rig", type=Path, metavar="RIG", help="rig file (TOML) with a [load_cell] table")
    parser.add_argument("--masses-g", type=_masses_kg, required=True, metavar="G,G,...", help="known masses, grams")
    parser.add_argument("--gravity", type=float, required=True, metavar="M/S2", help="local gravity, m/s^2")
    parser.add_argument(
        "--gravity-uncertainty", type=float, default=0.001, metavar="M/S2", help="standard uncertainty (default: 0.001)"
    )
    parser.add_argument(
        "--mass-uncertainty", type=float, default=0.001, metavar="REL",
        help="relative standard uncertainty of the masses (default: 0.001)",
    )  # fmt: skip
    parser.add_argument(
        "--certificate",
        metavar="TEXT",
        help="certificate of the masses; without it, the calibration is not traceable",
    )
    add_out(parser, "the file that the rig file names")
    parser.set_defaults(run=run_calibrate_cell)


def _masses_kg(text: str) -> tuple[float, ...]:
    """Parse masses in grams."""
    try:
        masses_kg = tuple(1e-3 * float(part) for part in text.split(","))
    except ValueError:
        masses_kg = ()
    if len(set(masses_kg)) < 2 or not all(0.0 < mass < 1000.0 for mass in masses_kg):
        raise argparse.ArgumentTypeError(
            f"{text!r} must be two or more different masses in grams, such as 20,50,100,200"
        )
    return masses_kg


def run_calibrate_cell(arguments: argparse.Namespace) -> None:
    """Read the cell under each mass, and store its calibration."""
    import numpy as np

    from data_schemas import RecordError, TactileRig, provenance
    from data_schemas.storage import read_toml, write_record
    from finray_calib.force import Gravity, Loads, calibrate_cell, loading_order
    from rigs.capture import open_tactile_rig

    rig = read_toml(arguments.rig, TactileRig)
    if rig.load_cell is None:
        raise RecordError(
            f"{arguments.rig}: has no [load_cell] table; add it with the driver and address of the load cell"
        )
    _require_masses(arguments, rig.load_cell.capacity_n)
    out = require_new(arguments.out or arguments.rig.parent / rig.load_cell.calibration, ".json")
    order = loading_order(arguments.masses_g)
    counts, at_s = [], []
    with ended_by_signals(), open_tactile_rig(rig, arguments.rig.parent, only="load cell") as opened:
        for number, mass_kg in enumerate(order, 1):
            opened.lay(mass_kg)
            counts.append(_counts_of(opened.load_cell, rig.load_cell))
            at_s.append(opened.clock.monotonic_s())
            guide(f"  {number}/{len(order)} {1e3 * mass_kg:g} g: {np.mean(counts[-1]):.0f} counts")
        when_utc = opened.clock.utc()
    loads = Loads(np.array(order), np.array(counts, dtype=float), np.array(at_s), arguments.mass_uncertainty)
    gravity = Gravity(arguments.gravity, arguments.gravity_uncertainty)
    address = f"{rig.load_cell.driver} {rig.load_cell.address}".strip()
    record = calibrate_cell(loads, gravity, f"{rig.name}, {address}", when_utc, arguments.certificate)
    write_record(record, out, provenance(command_line(), input_digests([arguments.rig]), None))
    _report_calibration(record, out)


def _require_masses(arguments: argparse.Namespace, capacity_n: float) -> None:
    """Refuse a gravity that is nowhere on Earth, and masses that the cell does not stand."""
    from data_schemas import CurveError

    if not 9.7 <= arguments.gravity <= 9.9:
        raise CurveError(
            f"--gravity {arguments.gravity:g}: must be 9.7 to 9.9 m/s^2 (9.78 at the equator, 9.83 at the poles)"
        )
    for name in ("gravity_uncertainty", "mass_uncertainty"):
        if not 0.0 <= getattr(arguments, name) <= 0.1:
            raise CurveError(f"--{name.replace('_', '-')} {getattr(arguments, name):g}: must be 0 to 0.1")
    heaviest_n = max(arguments.masses_g) * arguments.gravity
    if heaviest_n > capacity_n:
        raise CurveError(
            f"--masses-g: {1e3 * max(arguments.masses_g):g} g weigh {heaviest_n:.3g} N, but the cell can bear "
            f"only {capacity_n:g} N (capacity_n of the rig file); leave that mass out"
        )


def _counts_of(cell: "LoadCell | None", settings: "LoadCellSettings") -> list[int]:
    """Return readings of what lies on the cell, after it has settled."""
    if cell is None:
        raise CaptureError("load cell: could not be opened; check its cable and its address in the rig file")
    for _ in range(round(SETTLES_WITHIN_S * settings.rate_hz)):
        cell.read(settings.silent_s)
    return [cell.read(settings.silent_s).counts for _ in range(READINGS_OF_A_MASS)]


def _report_calibration(record: "LoadCellCalibration", out: Path) -> None:
    """Say what the cell is like."""
    slope, u = record.slope_n_per_count, record.slope_uncertainty_n_per_count
    wrote(out, f"load cell: {1e6 * slope:.5g} +- {1e6 * u:.2g} uN per count (standard uncertainty)")
    say(f"  linearity {1e3 * record.linearity_n:.2g} mN, hysteresis {1e3 * record.hysteresis_n:.2g} mN")
    say(f"  noise of a reading {1e3 * record.noise_n:.2g} mN, drift {1e3 * record.drift_n_per_s:.2g} mN/s")
    say(f"  {record.traceability}")
    give(
        calibration=str(out), slope_n_per_count=slope, slope_uncertainty_n_per_count=u, linearity_n=record.linearity_n,
        hysteresis_n=record.hysteresis_n, noise_n=record.noise_n, drift_n_per_s=record.drift_n_per_s,
        traceability=record.traceability,
    )  # fmt: skip


def run_init(arguments: argparse.Namespace) -> None:
    """Write a rig file."""
    from rigs import paper_rig, simulated_rig, to_fill_in, write_rig

    out = require_new(arguments.out or Path("rig.toml"), ".toml")
    if arguments.preset in FINGER_PRESETS:
        _init_finger(out, arguments.preset == "simulated-finger")
        return
    if (paint := PRACTICE_PAINTS.get(arguments.preset)) is not None:
        wrote(write_rig(simulated_rig(paint), out), "rig file")
        say(f"  a rig to practise on: camera, wheel, lights and a {paint} paint are simulated; the true spectrum")
        say("  of the paint is in [simulated.paint]")
        give(rig=str(out), to_fill_in=[])
        suggest_command("finray rig show", out)
        return
    chosen = chosen_devices()
    wrote(write_rig(paper_rig(chosen), out), "rig file")
    give(rig=str(out), to_fill_in=list(to_fill_in(chosen)))
    for text in to_fill_in(chosen):
        say(f"  fill in or check: {text}")
    suggest_command("finray rig show", out)


def _init_finger(out: Path, simulated: bool) -> None:
    """Write a rig that presses by itself, with a plan where it is one to practise on."""
    from data_schemas.storage import write_bytes
    from rigs import tactile_rig, write_tactile_rig

    plan = require_new(out.with_name(f"{out.stem}-presses.toml"), ".toml") if simulated else None
    wrote(write_tactile_rig(tactile_rig(simulated=simulated), out), "rig file")
    if plan is None:
        left = ["camera, stage, load_cell: addresses, as 'finray rig detect' lists them",
                "stage: clear_mm, base_mm, press_travel_mm and pad_travel_mm are those of the simulated finger: home "
                "your stage, move it by hand and enter its places; wrong values drive the indenter into the bench",
                "stage: press_axis and pad_axis are your axes, into_pad and from_base the signs of their directions",
                "load_cell: capacity_n and force_limit_n"]  # fmt: skip
        give(rig=str(out), to_fill_in=left)
        for text in left:
            say(f"  fill in or check: {text}")
        suggest_command("finray rig show", out)
        return
    write_bytes(plan, PRACTICE_PRESSES.encode())
    wrote(plan, "plan of two presses")
    say("  a finger to practise on: camera, stage and load cell are simulated; calibrate the cell first")
    give(rig=str(out), plan=str(plan), to_fill_in=[])
    suggest_command("finray rig calibrate-cell", out, "--masses-g", "20,50,100,200", "--gravity", "9.80665")


def run_detect(arguments: argparse.Namespace) -> None:
    """Print what is found."""
    from rigs import detect

    detection = detect()
    rows = [("device", "driver", "address", "what it is")]
    rows += [(d.kind, d.driver, d.address, d.what) for d in detection.devices]
    give(
        devices=[{"kind": d.kind, "driver": d.driver, "address": d.address, "what": d.what} for d in detection.devices],
        not_searched=list(detection.not_searched),
    )
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    for row in rows if detection.devices else ():
        say("  ".join([*(f"{row[column]:{widths[column]}}" for column in range(3)), row[3]]))
    if not detection.devices:
        say("no device found")
    for note in detection.notes:
        warn(f"note: {note}")
    if detection.not_searched:
        unsearched = ", ".join(detection.not_searched)
        warn(f"note: {unsearched} cannot be found by a search; enter their addresses in the rig file by hand")


def run_show(arguments: argparse.Namespace) -> None:
    """Print what every device reports."""
    from data_schemas import RigFile, TactileRig
    from data_schemas.storage import read_toml
    from rigs import inspect_rig, inspect_tactile_rig

    if _has_a_wheel(arguments.rig):
        rig = read_toml(arguments.rig, RigFile)
        name, parts = rig.name, inspect_rig(rig, arguments.rig.parent)
    else:
        tactile = read_toml(arguments.rig, TactileRig)
        name, parts = tactile.name, inspect_tactile_rig(tactile, arguments.rig.parent)
    say(name)
    given = []
    failed = []
    told: dict[str, str] = {}
    for part in parts:
        error = None if part.error is None else str(part.error)
        given.append({"title": part.title, "lines": part.lines, "warnings": part.warnings, "error": error})
        say(f"\n{part.title}")
        for line in part.lines:
            say(f"  {line}")
        for warning in part.warnings:
            say(f"  warning: {warning}")
        if error is not None:
            say(f"  ERROR: {f'the same as above ({told[error]})' if error in told else error}")
            told.setdefault(error, part.title)
            failed.append(part.title)
    give(rig_name=name, parts=given)
    if failed:
        raise CaptureError(
            f"{arguments.rig}: {'; '.join(failed)} could not be shown; correct the errors printed above and run "
            "'finray rig show' again"
        )


def _has_a_wheel(path: Path) -> bool:
    """Whether a rig file is that of a paint rig; what is no TOML at all is left to its reader, which says why."""
    from data_schemas import RecordError
    from data_schemas.storage import read_toml_tables

    try:
        tables = read_toml_tables(path)
    except RecordError:
        return True
    return not tables.keys() <= TACTILE_TABLES or "name" not in tables


def chosen_devices() -> "dict[Role, FoundDevice]":
    """Return the devices that the user takes, by their role; none where nobody can be asked."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return {}
    from rigs import detect

    guide("looking for devices ...")
    detection = detect()
    for note in detection.notes:
        warn(f"note: {note}")
    return choose(detection.devices)


def choose(devices: "tuple[FoundDevice, ...]") -> "dict[Role, FoundDevice]":
    """Offer each device for each role that it can have, until one is taken; a camera's own wheel before others."""
    roles: dict[Role, str] = {"camera": "camera", "filter wheel": "filter wheel", "laser": "light", "lamp": "light"}
    chosen: dict[Role, FoundDevice] = {}
    for role, kind in roles.items():
        camera = chosen.get("camera")
        for device in sorted(devices, key=lambda device: not _is_within(device, camera)):
            if device.kind != kind or device in chosen.values() or not _offered(role, device):
                continue
            chosen[role] = device
            break
    return chosen


def _is_within(device: "FoundDevice", camera: "FoundDevice | None") -> bool:
    """Whether a device is part of the camera: one driver shows both at one address."""
    return camera is not None and (device.driver, device.address) == (camera.driver, camera.address)


def _offered(role: str, device: "FoundDevice") -> bool:
    """Ask whether a device is to be used; Enter means yes, the end of the input no."""
    sys.stderr.write(f"{role} found: {device.what} ({device.driver}, {device.address}); use it? [Y/n] ")
    sys.stderr.flush()
    answer = sys.stdin.readline()
    return bool(answer) and answer.strip().lower() in ("", "y", "yes")


TACTILE_TABLES = {"schema_version", "name", "camera", "stage", "load_cell", "simulated"}
LIVE_HELP = "show what a rig's camera sees, or run a session, in the browser or the terminal"
LIVE_DESCRIPTION = """\
Open a rig and show what its camera sees in the browser of this computer: focus of a region that you draw, exposure and
saturation, histogram, and a key that switches the lamp off. Lamp and filter wheel follow the page. The laser stays off.
The address that is printed holds a token and is answered on 127.0.0.1 only: give it to nobody. Ctrl-C ends it, with the
lights off. While it runs, no session can be captured on this rig.

With --terminal the same is shown in this terminal, of 80 x 24 or more; ? shows its keys.

With --plan it runs the session of 'finray capture' in the view: what to do next in large words, the newest frame,
signal to noise, drift of the references, time left, and a key that switches all lights off. Closing the page or the
terminal does not end the session; the same address, which is also written to OUT.live-address while it runs, shows it
again. Ctrl-C ends it with the lights off; --resume, here or in 'finray capture', continues it."""
LAST_EXPOSURE_S = 10.0


def add_live(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("live", help=LIVE_HELP, description=LIVE_DESCRIPTION)
    parser.add_argument("--rig", type=Path, metavar="RIG", help="rig file (TOML)")
    parser.add_argument("--plan", type=Path, metavar="PLAN", help="run this plan, as 'finray capture' does")
    parser.add_argument("--resume", type=Path, metavar="SESSION", help="continue an interrupted session")
    parser.add_argument(
        "--like",
        type=Path,
        metavar="SESSION",
        help="earlier session on this rig whose white frames the new white frames must resemble",
    )
    add_out(parser, "NAME-session/, with --plan")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--port", type=whole_number(1024, 65535), default=0, metavar="N", help="port on 127.0.0.1 (default: a free one)"
    )
    where.add_argument("--terminal", action="store_true", help="show the view in this terminal instead of the browser")
    parser.set_defaults(run=run_live)


def run_live(arguments: argparse.Namespace) -> None:
    """Show the rig until Ctrl-C, or a session until its end."""
    from data_schemas import RigFile
    from data_schemas.storage import read_toml

    if arguments.resume is not None or arguments.plan is not None:
        _run_session(arguments)
        return
    if arguments.rig is None:
        raise CaptureError(
            "--rig is missing; give --rig to see the picture of its camera, --rig and --plan to run a "
            "session, or --resume to continue one"
        )
    if arguments.out is not None or arguments.like is not None:
        raise CaptureError("live: --out and --like are only for a session; add its --plan, or leave them out")
    rig = read_toml(arguments.rig, RigFile)
    if arguments.terminal:
        _live_in_terminal(rig, arguments.rig.parent)
    else:
        _live_in_browser(rig, arguments.rig.parent, arguments.port)


def _live_in_browser(rig: "RigFile", folder: Path, port: int) -> None:
    """Serve until Ctrl-C."""
    from rigs import open_rig, rig_locked
    from rigs.live_view import LiveRig, live_server

    with rig_locked(rig), open_rig(rig, folder) as opened:
        live = LiveRig(opened, rig)
        with live_server(live, port) as server:
            live.start()
            try:
                with contextlib.suppress(KeyboardInterrupt), ended_by_signals():
                    say(f"{server.url}\n  open it in a browser; Ctrl-C ends the view, with the lights off")
                    give(url=server.url)
                    server.serve_forever(poll_interval=0.2)
            finally:
                live.stop()
                live.ended(LAST_EXPOSURE_S)


def _live_in_terminal(rig: "RigFile", folder: Path) -> None:
    """Show it in the terminal; afterwards say what a plan takes over."""
    from rigs import open_rig, rig_locked
    from rigs.live_view import LiveRig, TerminalViewOperator, require_terminal, terminal_view

    require_terminal()
    if not is_for_a_terminal():
        raise CaptureError(
            "live --terminal: cannot be combined with --json or --quiet, because it draws a picture in the terminal; "
            "leave them out"
        )
    operator = TerminalViewOperator()
    with ended_by_signals(), rig_locked(rig), open_rig(rig, folder, operator) as opened:
        live = LiveRig(opened, rig)
        terminal_view(live, rig.name, operator)
    names = ("row_px", "column_px", "height_px", "width_px")
    region = dict(zip(names, live.region, strict=True))
    with contextlib.suppress(FinrayError):  # the terminal may be gone
        say("\n".join(["[region]", *(f"{name} = {value}" for name, value in region.items())]))


def _run_session(arguments: argparse.Namespace) -> None:
    """Run or continue a session in the view."""
    from rigs.live_view import require_terminal

    if arguments.terminal:
        require_terminal()
        if not is_for_a_terminal():
            raise CaptureError(
                "live --terminal: cannot be combined with --json or --quiet, because it draws a picture in the "
                "terminal; leave them out"
            )

    @contextmanager
    def attend(
        rig: "RigFile | TactileRig", plan: "PaintPlan | CameraPlan | TactilePlan", out: Path
    ) -> Iterator[Attended]:
        with _in_view(rig, plan, out, arguments.port, arguments.terminal) as attended:
            yield attended

    if arguments.resume is not None:
        if arguments.plan is not None or arguments.rig is not None or arguments.out is not None:
            raise CaptureError(
                "--resume takes plan, rig and folder from the session, so they cannot be given again; "
                "leave out --plan, --rig and --out"
            )
        with interruptible(arguments.resume):
            resume(arguments.resume, arguments.like, attend)
        return
    if arguments.rig is None:
        raise CaptureError("live --plan: --rig is missing; give the rig on which to capture the plan")
    arguments.attend, arguments.dry_run = attend, False
    capture(arguments)


@contextmanager
def _in_view(
    rig: "RigFile | TactileRig",
    plan: "PaintPlan | CameraPlan | TactilePlan",
    out: Path,
    port: int,
    in_terminal: bool,
) -> "Iterator[Attended]":
    """Attend to a session in the browser, or in the terminal too."""
    from data_schemas import RigFile
    from rigs.live_view import WatchedSession, shown_session

    takes_time, has_lights = True, isinstance(rig, RigFile)
    if isinstance(rig, RigFile):
        warn_of_laser(rig)
        takes_time = not rig.is_simulated
    name = next(str(getattr(plan, part)) for part in ("paint_name", "camera_name", "name") if hasattr(plan, part))
    laser = getattr(rig, "laser", None)
    session = WatchedSession(name, rig.camera, getattr(plan, "region", None), takes_time, has_lights, laser)
    file = out.absolute().with_name(f"{out.absolute().name}.live-address")
    _require_unseen(file, out)

    def tell_address(url: str) -> None:
        file.unlink(missing_ok=True)
        file.touch(mode=0o600, exist_ok=False)
        file.write_text(f"{url}\n", encoding="utf-8")
        say(
            f"{url}\n  open it in a browser; the address is also stored in {file}, which only you can read. "
            "Ctrl-C ends the session"
        )
        give(url=url)

    def progress(done: int, total: int, what: str) -> None:
        session.progress(done, total, what)
        if not in_terminal:
            guide(f"  {done}/{total} {what}")

    try:
        with shown_session(session, port, in_terminal, tell_address):
            yield Attended(progress, session.operator, session.mend, session)
    finally:
        file.unlink(missing_ok=True)


def _require_unseen(file: Path, out: Path) -> None:
    """Refuse a session whose view is open; a file that a killed view left behind is of no view.

    Raises
    ------
    CaptureError
        The address in the file answers.
    """
    if not file.is_file():
        return
    try:
        url = read_text(file, "the address of a session's view", CaptureError).strip()
        port = urlsplit(url).port
        with socket.create_connection(("127.0.0.1", port or 0), timeout=1.0):
            pass
    except (FinrayError, OSError, ValueError, OverflowError):
        return
    raise CaptureError(
        f"{out}: the view of this session is already open at {url}; open that address, or end the session first"
    )
