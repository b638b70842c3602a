"""``finray export``: a calibrated paint, or the press of a finger, in the formats of other programs."""

import argparse
from pathlib import Path

from finray_calib.cli import export_capture_request, export_deck, export_taxim
from finray_calib.cli.options import add_out, add_seed, command_line, file_name, input_digests, require_new, say

HELP = "write a paint, a press or a sensor for other programs (CSV, netCDF, Mitsuba, CalculiX, Taxim), or a request"
USAGE = """finray export [-h] PAINT --format FORMAT [options]
       finray export [-h] deck DESIGN --dialect {abaqus,calculix} [--preset NAME] [--increments N] [--out FILE.inp]
       finray export [-h] taxim SENSOR [--paint COLOUR=FILE] [--presses N] [--ball-diameter-mm D] [--samples N]
       finray export [-h] capture-request DESIGN [--out FILE.md]"""
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

Decks (mm, N, MPa) hold mesh, materials, contact and push, and say in their header what is assumed. What CalculiX makes
of one, 'finray simulate DESIGN --only mechanics --engine calculix' reads back.

Taxim: ball presses all over a classic sensor (TOML), or with --paint a finger, are rendered, and the folder written
from which Taxim's programs render. It holds slope and place only: what it explains of unseen presses is told.
A capture request tells a lab which captures of a finger to take: a page, and plans for 'finray capture'."""
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
OTHERS = {"deck": export_deck.run, "taxim": export_taxim.run, "capture-request": export_capture_request.run}


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "export", help=HELP, usage=USAGE, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "paint",
        type=Path,
        nargs="+",
        metavar="PAINT",
        help="record written by 'finray fit'; or 'deck', 'taxim' or 'capture-request' and a design",
    )
    parser.add_argument("--format", choices=list(SUFFIXES), help="of a paint, see above")
    export_deck.add_options(parser)
    export_taxim.add_options(parser)
    parser.add_argument(
        "--led",
        type=Path,
        metavar="CSV",
        action="append",
        help="light of rgb-reradiation (wavelength_nm,power_rel); give it again for a second light (default: a "
        "Gaussian of 450 nm, FWHM 20 nm, labelled assumed)",
    )
    parser.add_argument(
        "--camera-response",
        type=Path,
        metavar="CSV",
        help="camera of rgb-reradiation (wavelength_nm,red_percent,green_percent,blue_percent; default: assumed)",
    )
    add_out(parser, "PAINT with the suffix of the format, DESIGN.inp, SENSOR.taxim or DESIGN.request.md")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Export and report."""
    from data_schemas.curve_files import read_camera_response
    from data_schemas.errors import RecordError
    from data_schemas.fit import PaintCalibration
    from data_schemas.provenance import provenance
    from data_schemas.standard_curves import assumed_camera_response
    from data_schemas.storage import read_record
    from data_schemas.whole_files import write_bytes
    from finray_calib.exchange.led_camera_json import read_light
    from finray_calib.exchange.led_camera_matrix import assumed_led
    from finray_calib.exchange.paint_formats import PAINT_FORMATS, ExportOptions

    other = OTHERS.get(str(arguments.paint[0]))
    if other is not None:
        other(arguments)
        return
    file = _one_paint(arguments)
    curves = [*(arguments.led or []), *([arguments.camera_response] if arguments.camera_response else [])]
    if curves and arguments.format != "rgb-reradiation":
        raise RecordError(
            f"--led and --camera-response belong to --format rgb-reradiation; leave them out for {arguments.format}"
        )
    paint = read_record(file, PaintCalibration)
    out = require_new(arguments.out or Path(file_name(paint.paint_name) + SUFFIXES[arguments.format]))
    options = ExportOptions(
        lights=tuple(read_light(path) for path in arguments.led or ()) or (assumed_led(),),
        response=(
            read_camera_response(arguments.camera_response) if arguments.camera_response else assumed_camera_response()
        ),
        seed=arguments.seed,
    )
    origin = provenance(command_line(), input_digests([file, *curves]), arguments.seed)
    write_bytes(out, PAINT_FORMATS[arguments.format](paint, origin, options))
    say(f"{out}: paint '{paint.paint_name}' as {arguments.format}")


def _one_paint(arguments: argparse.Namespace) -> Path:
    """Return the paint, after a check that nothing of a deck is asked for."""
    from data_schemas.errors import RecordError

    export_deck.refuse_options(arguments)
    export_taxim.refuse_options(arguments)
    if arguments.format is None:
        raise RecordError(
            f"--format is missing; give one of {', '.join(SUFFIXES)}. For the deck of a finger: finray export deck "
            "DESIGN --dialect calculix"
        )
    if len(arguments.paint) > 1:
        raise RecordError(f"{len(arguments.paint)} files are given; export writes one paint at a time")
    paint: Path = arguments.paint[0]
    return paint
