"""``finray radiometry``: turn the frames of a session into band signals with covariance, or characterise a camera."""

import argparse
from pathlib import Path

from finray_calib.cli.options import add_out

HELP = "turn captured frames into one value per filter and channel, with covariance"
DESCRIPTION = """\
Correct a paint session for dark level and exposure, refer it to the white reference, and write one value per
filter and Bayer channel over the painted region: fluorescence (under the laser) and reflectance (under the
lamp), each with its full covariance and quality flags. A camera session becomes a camera characterisation."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "radiometry", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("session", type=Path, metavar="SESSION", help="folder written by 'finray capture'")
    add_out(parser, "PAINT.bands.json, CAMERA.camera.json")
    parser.add_argument(
        "--camera", type=Path, metavar="FILE", help="use the gain, read noise and black level of this characterisation"
    )
    parser.add_argument(
        "--pixels",
        action="store_true",
        help="also write PAINT.pixels.json: every pixel of the region behind each filter",
    )
    parser.add_argument(
        "--accept-repeat",
        action="store_true",
        help="take a filter and its own repeat that disagree for one fading sample",
    )
    parser.add_argument("--whole-frame", action="store_true", help="with --pixels: every pixel of the frame")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Reduce what was captured and report."""
    from data_schemas.errors import RadiometryError
    from finray_calib.cli.characterise_camera import characterise
    from finray_calib.cli.reduce_paint import reduce_paint
    from rigs.capture.read_session import session_kind

    if arguments.whole_frame and not arguments.pixels:
        raise RadiometryError("--whole-frame: says how far the map of --pixels reaches; give --pixels too")
    if session_kind(arguments.session) == "paint":
        reduce_paint(
            arguments.session, arguments.out, arguments.camera, arguments.pixels, arguments.whole_frame,
            arguments.accept_repeat,
        )  # fmt: skip
        return
    if arguments.camera is not None or arguments.pixels:
        raise RadiometryError(f"{arguments.session}: is a camera session; --camera and --pixels are for paint sessions")
    characterise(arguments.session, arguments.out)
