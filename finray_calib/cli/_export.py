"""``finray export``: a calibrated paint, a press, a sensor, captures, frames or a request in other programs' formats.

Formats of a paint for spectra and renderers, the press of a design as an input deck of Abaqus or CalculiX, a
calibration folder that Taxim's programs render from, captures as one archive, the frames of a session as OME-TIFF,
NeXus or bluesky documents, and a page that tells a lab which captures to take.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import Progress, give, progress_bar, say, suggest_file, wrote
from finray_calib.cli._run import (
    DEFAULT_INCREMENTS,
    add_out,
    add_paint,
    add_seed,
    command_line,
    file_name,
    increment_count,
    input_digests,
    naming,
    number_within,
    open_engine,
    paint_files,
    require_new,
    whole_number,
)

if TYPE_CHECKING:
    from sim.experiments import BallPresses


DIALECTS = ("abaqus", "calculix")
PRESETS = ("coarse", "medium", "fine")  # as in data_schemas, which is too slow to load for --help


def add_deck_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a deck."""
    deck = parser.add_argument_group("decks")
    deck.add_argument("--dialect", choices=DIALECTS, help="program that the deck is for")
    deck.add_argument("--preset", choices=PRESETS, help="fineness of the mesh (default: the design's)")
    deck.add_argument(
        "--increments", type=increment_count, metavar="N", help=f"steps of the push (default: {DEFAULT_INCREMENTS})"
    )


def refuse_deck_options(arguments: argparse.Namespace) -> None:
    """Refuse what belongs to a deck, where a paint is exported.

    Raises
    ------
    RecordError
        When an option of a deck is given.
    """
    from data_schemas import RecordError

    given = [f"--{name}" for name in ("dialect", "preset", "increments") if getattr(arguments, name) is not None]
    if given:
        raise RecordError(
            f"{' and '.join(given)}: supported only for a deck; run 'finray export deck DESIGN {given[0]} ...'"
        )


def run_deck(arguments: argparse.Namespace) -> None:
    """Write the deck and report."""
    from data_schemas import SimulateError
    from data_schemas.storage import write_bytes
    from sim import read_design
    from sim.mechanics.other_engines import finger_deck

    path = _one_design(arguments)
    design = read_design(path)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.inp"))
    increments = arguments.increments or DEFAULT_INCREMENTS
    with naming(SimulateError, path):
        lines = finger_deck(design, arguments.dialect, arguments.preset, increments, command_line())
    write_bytes(out, "".join(f"{line}\n" for line in lines).encode("ascii", "replace"))
    wrote(out, f"{design.name}, {arguments.preset or design.mesh.preset} mesh, for {arguments.dialect}")
    give(kind="deck", format=arguments.dialect)


def _one_design(arguments: argparse.Namespace) -> Path:
    """Return the design that follows the word deck, after a check of the options."""
    from data_schemas import RecordError

    if arguments.dialect is None:
        raise RecordError(f"--dialect is missing, but a deck needs it; give one of {', '.join(DIALECTS)}")
    refuse_taxim_options(arguments)
    for name in ("format", "led", "camera_response"):
        if getattr(arguments, name) is not None:
            raise RecordError(f"--{name.replace('_', '-')} is only for paints; leave it out for a deck")
    if len(arguments.paint) != 2:  # the word and the file
        raise RecordError("a deck needs exactly one design; run 'finray export deck DESIGN.toml --dialect calculix'")
    design: Path = arguments.paint[1]
    return design


PRESSES = 48
BALL_DIAMETER_MM = 4.0
SAMPLES = 64
PAINTS = "wall_paint"
"""Where --paint stands among the arguments; "paint" is the file to export."""


def add_taxim_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a Taxim folder."""
    taxim = parser.add_argument_group("Taxim folders")
    taxim.add_argument(
        "--presses",
        type=whole_number(1, 100_000),
        metavar="N",
        help=f"number of ball presses to render (default: {PRESSES})",
    )
    taxim.add_argument(
        "--ball-diameter-mm",
        type=number_within("a number of mm", (0.0, 100.0), above=True),
        metavar="D",
        help=f"diameter of the ball in mm (default: {BALL_DIAMETER_MM:g})",
    )
    taxim.add_argument(
        "--samples", type=whole_number(1, 100_000), metavar="N", help=f"paths per pixel (default {SAMPLES})"
    )
    add_paint(taxim, "paint calibration of a finger's wall; without paints the design is a classic sensor", PAINTS)


def refuse_taxim_options(arguments: argparse.Namespace) -> None:
    """Refuse what belongs to a Taxim folder, where something else is exported.

    Raises
    ------
    RecordError
        When an option of a Taxim folder is given.
    """
    from data_schemas import RecordError

    names = ("presses", "ball_diameter_mm", "samples")
    given = [f"--{name.replace('_', '-')}" for name in names if getattr(arguments, name) is not None]
    given += ["--paint"] if getattr(arguments, PAINTS) else []
    if given:
        raise RecordError(
            f"{' and '.join(given)}: supported only for a Taxim folder; run 'finray export taxim SENSOR {given[0]} ...'"
        )


def run_taxim(arguments: argparse.Namespace) -> None:
    """Render, write the folder and report."""
    from data_schemas import RecordError, provenance
    from data_schemas.storage import ProductSet
    from finray_calib.exchange import FEWEST_PRESSES, taxim_files

    refuse_deck_options(arguments)
    for name in ("format", "led", "camera_response"):
        if getattr(arguments, name) is not None:
            raise RecordError(f"--{name.replace('_', '-')} is only for paints; leave it out for a Taxim folder")
    if len(arguments.paint) != 2:  # the word and the file
        raise RecordError("a Taxim folder needs exactly one sensor or finger; run 'finray export taxim SENSOR.toml'")
    if arguments.presses is not None and arguments.presses < FEWEST_PRESSES:  # found before anything is rendered
        raise RecordError(
            f"--presses {arguments.presses}: a shading table needs at least {FEWEST_PRESSES} presses; give more, or "
            f"leave --presses out for {PRESSES}"
        )
    default = Path(f"{file_name(arguments.paint[1].stem)}.taxim")
    out = require_new(arguments.out or default)
    with progress_bar("rendering") as progress:
        presses, inputs = _finger(arguments, progress) if getattr(arguments, PAINTS) else _sensor(arguments, progress)
    origin = provenance(command_line(), input_digests(inputs), arguments.seed)
    files, table = taxim_files(presses, arguments.seed, origin.model_dump(mode="json"))
    with ProductSet(out) as products:
        for name, content in files.items():
            products.add(out / name, content)
    median, least, most = table.explained_median_range()
    wrote(out, f"Taxim calibration folder of {table.presses} presses, {presses.mm_per_px:.4g} mm per px")
    give(kind="taxim", format="taxim", presses=table.presses, mm_per_px=presses.mm_per_px, explained_rel=median)
    say(f"  {presses.label}")
    say(f"  explains {median:.3f} [{least:.3f}, {most:.3f}] of the change by contact, on presses not used for it")
    say(f"  slopes up to {table.steepest_deg:.0f} deg; shadows beside a contact are not exported")


def _sensor(arguments: argparse.Namespace, progress: Progress) -> "tuple[BallPresses, list[Path]]":
    """Render a classic sensor."""
    from sim import read_sensor, sensor_inputs
    from sim.experiments import render_ball_presses

    path: Path = arguments.paint[1]
    _refuse_finger(path)
    sensor = read_sensor(path)
    presses = render_ball_presses(sensor, open_engine("auto"), *_amounts(arguments), progress, path.parent)
    return presses, sensor_inputs(sensor.model_copy(update={"surface": None}), path)


def _refuse_finger(path: Path) -> None:
    """Refuse the design of a finger, whose walls need paints."""
    from data_schemas import FinrayError, RecordError
    from sim import read_design

    try:
        design = read_design(path)
    except FinrayError:
        return
    raise RecordError(
        f"{path}: is the design of a finger, '{design.name}', but paints for its walls are missing; add --paint "
        "red=PAINT.paint.json and --paint green=PAINT.paint.json, or give a classic sensor, which needs no paints"
    )


def _finger(arguments: argparse.Namespace, progress: Progress) -> "tuple[BallPresses, list[Path]]":
    """Render a finger with its paints."""
    from data_schemas import PaintCalibration
    from data_schemas.storage import read_record
    from sim import design_inputs, read_design
    from sim.experiments import paint_finger, paint_optics, render_finger_presses

    path: Path = arguments.paint[1]
    files = paint_files(arguments, dest=PAINTS)
    design = read_design(path)
    paints = {colour: paint_optics(read_record(file, PaintCalibration)) for colour, file in files.items()}
    finger = paint_finger(design, paints, path.parent, open_engine("auto"))
    return render_finger_presses(finger, *_amounts(arguments), progress), [
        *design_inputs(design, path),
        *files.values(),
    ]


def _amounts(arguments: argparse.Namespace) -> tuple[float, int, int, int]:
    """Return the ball's radius, the number of presses, the seed and the paths per pixel."""
    radius_mm = (arguments.ball_diameter_mm or BALL_DIAMETER_MM) / 2.0
    return radius_mm, arguments.presses or PRESSES, arguments.seed, arguments.samples or SAMPLES


def run_captures(arguments: argparse.Namespace) -> None:
    """Write the container of a folder of captures and report."""
    from data_schemas import RecordError
    from data_schemas.storage import write_zip
    from finray_calib.exchange import capture_container

    _refuse_options(arguments, "captures")
    if len(arguments.paint) != 2:  # the word and the folder
        raise RecordError("captures need exactly one folder; run 'finray export captures FOLDER --out FILE.zip'")
    folder: Path = arguments.paint[1]
    out = require_new(arguments.out or Path(f"{folder.resolve().name.removesuffix('.zip')}.zip"))
    if out.suffix.lower() != ".zip":
        raise RecordError(f"{out}: must be a zip archive; choose an --out that ends in .zip")
    container = capture_container(folder)
    write_zip(out, container.contents())
    simulated = f" and {container.presses} simulated presses" if container.presses else ""
    wrote(
        out,
        f"{container.captures} captures{simulated}; 'finray compare' and the other commands read it like the folder",
    )
    left_out = [path.name for path in container.left_out]
    give(kind="captures", format="zip", captures=container.captures, presses=container.presses, left_out=left_out)
    for name in left_out[:MOST_LEFT_OUT]:
        say(f"  left out, as it belongs to no capture: {name}")
    if len(left_out) > MOST_LEFT_OUT:
        say(f"  left out: {len(left_out) - MOST_LEFT_OUT} more files")


MOST_LEFT_OUT = 10


def _refuse_options(arguments: argparse.Namespace, what: str) -> None:
    """Refuse what belongs to a deck, a Taxim folder or a paint."""
    from data_schemas import RecordError

    refuse_deck_options(arguments)
    refuse_taxim_options(arguments)
    for name in ("format", "led", "camera_response"):
        if getattr(arguments, name) is not None:
            raise RecordError(f"--{name.replace('_', '-')} is only for paints; leave it out for {what}")


def run_capture_request(arguments: argparse.Namespace) -> None:
    """Write page and plans, and report."""
    from data_schemas import RecordError, SimulateError
    from data_schemas.storage import ProductSet
    from finray_calib.exchange import PlannedView, capture_request
    from finray_calib.reports import finger_outline
    from sim import read_design
    from sim.optics import camera_view

    _refuse_options(arguments, "a capture request")
    if len(arguments.paint) != 2:  # the word and the file
        raise RecordError("a capture request needs exactly one design; run 'finray export capture-request DESIGN.toml'")
    path: Path = arguments.paint[1]
    design = read_design(path)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.request.md"))
    with naming(SimulateError, path):
        finger_outline(design, path.parent)  # nobody can print, and then capture, parts that do not fit
        seen = camera_view(design, path.parent, open_engine("auto"))
    scale, u_rel = seen.mm_per_px
    view = PlannedView(*seen.seen_mm, mm_per_px=scale, mm_per_px_u_rel=u_rel)
    request = capture_request(design, path.name, out.name.removesuffix(".md"), view)
    plans = {require_new(out.with_name(name)): text for name, text in request.plans.items()}
    with ProductSet(out) as products:
        for plan, text in plans.items():
            products.add(plan, text.encode())
        products.add(out, request.page.encode())
    wrote(out, f"what to capture of {design.name}")
    for plan in plans:
        wrote(plan, "plan for 'finray capture'")
    give(kind="capture-request", format="markdown")
    suggest_file(out)


FRAME_ENDINGS = {"ome-tiff": (".ome.tiff", ".ome.tif"), "nexus": (".nxs", ".h5", ".hdf5"), "bluesky": (".jsonl",)}
"""Endings of the files that hold the frames of a session, by the word of the command; the first is the default."""


def run_frames(arguments: argparse.Namespace) -> None:
    """Write the frames of a session and report."""
    from data_schemas import RecordError
    from finray_calib.exchange import read_session_frames, write_bluesky_documents, write_nexus, write_ome_tiff

    word = str(arguments.paint[0])
    endings = FRAME_ENDINGS[word]
    _refuse_options(arguments, "the frames of a session")
    if len(arguments.paint) != 2:  # the word and the folder
        raise RecordError(
            f"{word} needs exactly one session; run 'finray export {word} SESSION --out FILE{endings[0]}'"
        )
    folder: Path = arguments.paint[1]
    session = read_session_frames(folder)
    out = require_new(arguments.out or Path(f"{file_name(folder.resolve().name)}{endings[0]}"))
    if not out.name.lower().endswith(endings):
        raise RecordError(f"{out}: a file of {word} must end in {' or '.join(endings)}; choose another --out")
    write = {"ome-tiff": write_ome_tiff, "nexus": write_nexus, "bluesky": write_bluesky_documents}[word]
    if word == "bluesky":
        require_new(out.with_suffix(".nxs"))
    with progress_bar("writing frames") as progress:
        count = write(session, out, command_line(), progress)
    frames = len(session.frames)
    if word == "ome-tiff":
        wrote(out, f"{frames} frames of {session.sample} in {count} images, a channel for each filter")
    elif word == "nexus":
        wrote(out, f"{frames} frames of {session.sample} as NeXus; the default plot is the stack of all frames")
    else:
        wrote(out, f"documents of a run with {count} events, one a line")
        wrote(out.with_suffix(".nxs"), "the frames that the documents point to")
    give(kind="frames", format=word, session=session.kind, frames=frames)
    suggest_file(out)


RECIPES = ("protocol-balls", "protocol-solids")


def run_protocol(arguments: argparse.Namespace) -> None:
    """Write the sheet, the table and the solids, and report."""
    from data_schemas import RecordError
    from data_schemas.storage import ProductSet
    from finray_calib.reports.studies import protocol_page
    from sim import is_sensor, read_design, read_sensor
    from sim.experiments import press_protocol

    _refuse_options(arguments, "a press protocol")
    if len(arguments.paint) != 2:  # the word and the file
        raise RecordError(
            "a press protocol needs exactly one finger or classic sensor; run 'finray export protocol SENSOR.toml'"
        )
    path: Path = arguments.paint[1]
    sensor = read_sensor(path) if is_sensor(path) else read_design(path)
    with naming(RecordError, path):
        protocol = press_protocol(sensor)
    out = require_new(arguments.out or Path(f"{file_name(sensor.name)}.protocol"))
    with ProductSet(out) as products:
        for solid in protocol.solids:
            products.add(out / "solids" / f"{solid.name}.stl", solid.stl)
        products.add(out / "presses.csv", protocol.table_csv().encode())
        products.add(out / "protocol.html", protocol_page(protocol, RECIPES).encode())
    wrote(out, f"what to print and press for {sensor.name}: {len(protocol.presses)} presses, each taken twice")
    give(kind="protocol", format="html", presses=len(protocol.presses), solids=len(protocol.solids))
    suggest_file(out / "protocol.html")


HELP = (
    "write a paint, a press, a sensor, captures or frames for other programs (CSV, netCDF, Mitsuba, CalculiX, Taxim, "
    "zip, OME-TIFF, NeXus, bluesky), or what a lab is to capture"
)
USAGE = """finray export [-h] PAINT --format FORMAT [options]
       finray export [-h] deck DESIGN --dialect {abaqus,calculix}
                     [--preset NAME] [--increments N] [--out FILE.inp]
       finray export [-h] taxim SENSOR [--paint COLOUR=FILE] [--presses N]
                     [--ball-diameter-mm D] [--samples N]
       finray export [-h] capture-request DESIGN [--out FILE.md]
       finray export [-h] protocol SENSOR [--out FOLDER]
       finray export [-h] captures FOLDER [--out FILE.zip]
       finray export [-h] {ome-tiff,nexus,bluesky} SESSION [--out FILE]"""
DESCRIPTION = """\
Write a paint fitted by 'finray fit' in the format of another program, or the press of a finger design (TOML) as an
input deck of a finite-element program.

  csv              emission with 68 % and 95 % limits
  json             emission, absorption, reflectance and parameters with limits
  netcdf           posterior, prior, data and diagnostics; opens in ArviZ; needs
                   pip install 'finray-calib[netcdf]'
  spdx             mean emission as IES TM-27-14; opens in colour-science
  mitsuba          mean emission as a spectrum file of Mitsuba
  rgb-reradiation  light x camera R, G, B: what returns by reflectance and by fluorescence, with uncertainty (JSON)
  exr              mean reradiation matrix as bispectral OpenEXR (Fichet 2021); needs
                   pip install 'finray-calib[exr]'

Formats that hold no uncertainty say so in their header.

Decks (mm, N, MPa) hold mesh, materials, contact and push, and say in their header what is assumed. 'finray simulate
press DESIGN --engine calculix' runs CalculiX on such a deck and reads its results.

Taxim: the command renders ball presses all over a classic sensor (TOML) or, with --paint, a finger, and writes the
folder from which Taxim's programs render. The folder describes colour by slope and place only; the command reports how
much of the change in presses not used for it the folder explains.

A capture request states which captures of a finger a lab should take: a page, and plans for 'finray capture'.

A protocol is for any tactile sensor: a sheet to print, a table of presses, and twelve solids to print (STL). The solids
and some balls are pressed into the sensor, which takes about an hour.

Captures: a folder that 'finray import captures' wrote becomes one zip archive, which the other commands read like the
folder.

The frames of a capture session, bit for bit, with exposure, time, filter, light and Bayer pattern: ome-tiff for image
viewers, nexus (HDF5) and bluesky (documents as JSON lines, with the frames in a NeXus file beside) for beamline tools.
The last two need pip install 'finray-calib[nexus]'."""
# Named here as well because the parser is built before anything heavy is imported; a test compares the two lists.
SUFFIXES = {
    "csv": ".csv",
    "json": ".export.json",
    "netcdf": ".nc",
    "spdx": ".spdx",
    "mitsuba": ".spd",
    "rgb-reradiation": ".rgb.json",
    "exr": ".exr",
}

# What else than a paint is exported, by its first word; all of it shares the paint's parser.
OTHERS = {
    "deck": run_deck,
    "taxim": run_taxim,
    "capture-request": run_capture_request,
    "protocol": run_protocol,
    "captures": run_captures,
    **dict.fromkeys(FRAME_ENDINGS, run_frames),
}


def add_export(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("export", help=HELP, usage=USAGE, description=DESCRIPTION)
    parser.add_argument(
        "paint",
        type=Path,
        nargs="+",
        metavar="PAINT",
        help="record written by 'finray fit'; or a word and its source: 'deck', 'taxim', 'capture-request' or "
        "'protocol' and a design, 'captures' and a folder, or 'ome-tiff', 'nexus' or 'bluesky' and a session",
    )
    parser.add_argument("--format", choices=list(SUFFIXES), help="format of the paint file, as listed above")
    add_deck_options(parser)
    add_taxim_options(parser)
    parser.add_argument(
        "--led",
        type=Path,
        metavar="CSV",
        action="append",
        help="light spectrum for rgb-reradiation (columns wavelength_nm,power_rel); give it again for a second light "
        "(default: a Gaussian at 450 nm, FWHM 20 nm, labelled assumed)",
    )
    parser.add_argument(
        "--camera-response",
        type=Path,
        metavar="CSV",
        help=(
            "camera response for rgb-reradiation (columns wavelength_nm,red_percent,green_percent,blue_percent; "
            "default: an assumed one)"
        ),
    )
    add_out(
        parser,
        "PAINT with the suffix of the format, DESIGN.inp, SENSOR.taxim, DESIGN.request.md, SENSOR.protocol, "
        "FOLDER.zip, or SESSION.ome.tiff, .nxs or .jsonl",
    )
    add_seed(parser)
    parser.set_defaults(run=run_export)


def run_export(arguments: argparse.Namespace) -> None:
    """Export and report."""
    from data_schemas import PaintCalibration, RecordError, provenance
    from data_schemas.storage import assumed_camera_response, read_camera_response, read_light, read_record, write_bytes
    from finray_calib.exchange import PAINT_FORMATS, ExportOptions, assumed_led

    other = OTHERS.get(str(arguments.paint[0]))
    if other is not None:
        other(arguments)
        return
    file = _one_paint(arguments)
    curves = [*(arguments.led or []), *([arguments.camera_response] if arguments.camera_response else [])]
    if curves and arguments.format != "rgb-reradiation":
        raise RecordError(
            f"--led and --camera-response are only for --format rgb-reradiation; leave them out for {arguments.format}"
        )
    paint = read_record(file, PaintCalibration)
    out = require_new(arguments.out or Path(file_name(paint.paint_name) + SUFFIXES[arguments.format]))
    ending = Path(f"paint{SUFFIXES[arguments.format]}").suffix
    if out.suffix.lower() != ending:
        raise RecordError(f"{out}: a file of --format {arguments.format} must end in {ending}; choose another --out")
    options = ExportOptions(
        lights=tuple(read_light(path) for path in arguments.led or ()) or (assumed_led(),),
        response=(
            read_camera_response(arguments.camera_response) if arguments.camera_response else assumed_camera_response()
        ),
        seed=arguments.seed,
    )
    origin = provenance(command_line(), input_digests([file, *curves]), arguments.seed)
    write_bytes(out, PAINT_FORMATS[arguments.format](paint, origin, options))
    wrote(out, f"paint '{paint.paint_name}' as {arguments.format}")
    give(kind="paint", format=arguments.format)


def _one_paint(arguments: argparse.Namespace) -> Path:
    """Return the paint, after a check that nothing of a deck is asked for."""
    from data_schemas import RecordError

    refuse_deck_options(arguments)
    refuse_taxim_options(arguments)
    if arguments.format is None:
        raise RecordError(
            f"--format is missing; give one of {', '.join(SUFFIXES)}. For the deck of a finger, run 'finray export "
            "deck DESIGN --dialect calculix'"
        )
    if len(arguments.paint) > 1:
        raise RecordError(
            f"{len(arguments.paint)} files are given, but only one paint can be written at a time; give one file"
        )
    paint: Path = arguments.paint[0]
    return paint
