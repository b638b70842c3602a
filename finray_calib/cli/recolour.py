"""``finray recolour``: other paints, another camera or white balance on a rendered press, without a new render."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import (
    add_out,
    add_paint,
    command_line,
    input_digests,
    naming,
    paint_files,
    require_new,
    say,
)

if TYPE_CHECKING:
    from sim.experiments.recolour import WhiteBalance

HELP = "show a rendered press with other paints, camera or white balance"
DESCRIPTION = """\
Recompute the images of a press that 'finray simulate' has rendered, for paints of another yield, absorption at the LED
or emission shape, for another camera, or with another white balance. Nothing is rendered: the light of each chain of
fluorescence was kept apart. Refused where a new render is needed: after a change of a paint's reflectance by more
than 0.01 in a band, of a band's place by more than 10 nm, or when paint excites paint three times as much."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "recolour", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("press", type=Path, metavar="PRESS", help="rendered press (JSON)")
    add_paint(parser, "paint calibrations of both walls (an unchanged one again)")
    parser.add_argument("--camera", type=Path, metavar="FILE", help="camera response (CSV)")
    parser.add_argument(
        "--white-balance", type=_white_balance, metavar="R:G:B",
        help="gains of red, green and blue, e.g. 1.8:1:1.4; or 'pad': the untouched pad becomes grey on average",
    )  # fmt: skip
    add_out(parser, "PRESS-recoloured.json")
    parser.set_defaults(run=run)


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


def run(arguments: argparse.Namespace) -> None:
    """Recolour, store and report."""
    from time import perf_counter

    from data_schemas.curve_files import read_camera_response
    from data_schemas.errors import SimulateError
    from data_schemas.fit import PaintCalibration
    from data_schemas.provenance import digest_of_input, provenance
    from data_schemas.simulate import SimulatedPress
    from data_schemas.storage import read_record, write_record
    from sim.experiments.painted_finger import paint_optics
    from sim.experiments.recolour import recoloured

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
