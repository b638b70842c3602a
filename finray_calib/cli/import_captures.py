"""``finray import``: captures that labs already have become records."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli import import_abaqus, import_ball_presses, import_bands
from finray_calib.cli.options import add_out, command_line, input_digests, require_new, say

if TYPE_CHECKING:
    from data_schemas.capture import TactileCapture
    from data_schemas.simulate import SimulatedPress

HELP = "import what other labs and programs captured or computed (9DTact, Taxim, gs_sdk, Raspberry Pi, Abaqus)"
NINE_DTACT = """\
Import a sensor folder of 9DTact as a tactile capture. With --predict-from, also write a simple prediction of
the press: the darkening-to-depth table of the other sensor applied to this one, labelled "table, not
rendered". Compare the two with 'finray compare'."""
RASPBERRY_PI = """\
Import the images of one press as a tactile capture: contact, no_contact and, if there is one,
repeat_no_contact (all DNG or 16-bit TIFF, or all PNG or JPEG), the metadata of each image beside it
(contact.json, from rpicam-still --metadata) and press.toml (name, [indenter]). Images with auto exposure or
auto white balance are refused."""
CAPTURE_OUT = "FOLDER.capture.json, with --predict-from also FOLDER.press.json beside it"


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and its formats."""
    parser = verbs.add_parser("import", help=HELP, description=HELP)
    formats = parser.add_subparsers(dest="format", metavar="FORMAT", title="formats", required=True)
    dtact = _add_format(formats, "9dtact", "sensor folder of 9DTact", NINE_DTACT)
    dtact.add_argument(
        "--predict-from", type=Path, metavar="FOLDER", help="other sensor whose table makes a prediction"
    )
    pi = _add_format(formats, "raspberry-pi", "images of one press, taken with rpicam-still", RASPBERRY_PI)
    pi.add_argument("--tuning", type=Path, metavar="FILE", help="libcamera tuning file that the camera used")
    pi.add_argument("--undo-colour", action="store_true", help="undo colour matrix and white balance (PNG, JPEG)")
    pi.add_argument("--flatten-shading", action="store_true", help="flatten the lens shading by the tuning (raw)")
    pi.add_argument("--bayer-order", choices=["RGGB", "BGGR", "GRBG", "GBRG"], help="of 16-bit TIFFs")
    pi.add_argument("--bit-depth", type=int, choices=[8, 10, 12, 14, 16], help="of 16-bit TIFFs")
    import_ball_presses.add_parser(formats)
    import_bands.add_parser(formats)
    import_abaqus.add_parser(formats)


def _add_format(
    formats: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str, help_line: str, description: str
) -> argparse.ArgumentParser:
    """Register a format of tactile captures."""
    parser = formats.add_parser(
        name, help=help_line, description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of one sensor or one press")
    add_out(parser, CAPTURE_OUT if name == "9dtact" else "FOLDER.capture.json")
    parser.set_defaults(run=run, predict_from=None, tuning=None)
    return parser


def run(arguments: argparse.Namespace) -> None:
    """Import and report."""
    from data_schemas.errors import ImportFormatError
    from data_schemas.foreign_files import digest_as_read
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record

    folder: Path = arguments.folder
    out = require_new(arguments.out or Path(f"{folder.resolve().name}.capture.json"))
    press_out = out.with_name(f"{out.name.removesuffix('.json').removesuffix('.capture')}.press.json")
    if arguments.predict_from is not None:
        if arguments.predict_from.resolve() == folder.resolve():
            raise ImportFormatError(
                f"--predict-from {arguments.predict_from}: a sensor's own table predicts what it was made from; give "
                "the folder of another sensor"
            )
        require_new(press_out)
    capture, press = _raspberry_pi(arguments) if arguments.format == "raspberry-pi" else _nine_dtact(arguments)
    sources = [f for f in (folder, arguments.predict_from) if f is not None]
    files = sorted(f for source in sources for f in source.rglob("*") if digest_as_read(f) is not None)
    files += [] if arguments.tuning is None else [arguments.tuning]
    origin = provenance(command_line(), input_digests(files))
    with ProductSet(out) as products:
        if press is not None:
            write_record(press, press_out, origin, products)
        write_record(capture, out, origin, products)
    rows, columns = capture.contact.shape[:2]
    say(f"{out}: {capture.name}, {columns} x {rows} px, encoding {capture.encoding}")
    say(f"  {capture.source}")
    if press is not None:
        say(f"{press_out}: {press.name} ({press.label})")


def _nine_dtact(arguments: argparse.Namespace) -> "tuple[TactileCapture, SimulatedPress | None]":
    """Import a 9DTact sensor folder, with a prediction if asked."""
    from finray_calib.exchange.nine_dtact_records import table_prediction, tactile_capture

    other: Path | None = arguments.predict_from
    return tactile_capture(arguments.folder), None if other is None else table_prediction(arguments.folder, other)


def _raspberry_pi(arguments: argparse.Namespace) -> "tuple[TactileCapture, None]":
    """Import a folder of Raspberry Pi images."""
    from finray_calib.exchange.raspberry_pi_folder import ImportOptions, tactile_capture
    from finray_calib.exchange.raspberry_pi_images import read_tuning

    options = ImportOptions(
        tuning=None if arguments.tuning is None else read_tuning(arguments.tuning),
        undo_colour=arguments.undo_colour,
        flatten_shading=arguments.flatten_shading,
        bayer_order=arguments.bayer_order,
        bit_depth=arguments.bit_depth,
    )
    return tactile_capture(arguments.folder, options), None
