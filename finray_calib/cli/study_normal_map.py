"""``finray study normal-map``: from captures of ball presses to the map that senses a normal from a colour."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import add_out, add_seed, command_line, input_digests, naming, require_new, say

if TYPE_CHECKING:
    from numpy import float64
    from numpy.typing import NDArray

    from data_schemas.capture import TactileCapture

HELP = "fit the map from colour to surface normal to captures of ball presses"
DESCRIPTION = """\
Fit the map from change of colour (and place in the picture) to surface normal, as a tactile sensor uses it, to
at least 12 captures of ball presses with a known contact circle, and score it on random halves of them that it
has not seen. 'finray import taxim' and 'finray import ball-presses' make such captures; those of
'finray capture' get their circles from --circles."""


def add_normal_map_study(studies: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the study."""
    parser = studies.add_parser(
        "normal-map", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("captures", type=Path, nargs="+", metavar="CAPTURE", help="tactile captures of ball presses")
    parser.add_argument(
        "--circles", type=Path, metavar="CSV",
        help="contact circles: image,column_px,row_px,radius_px, image being the capture's file name",
    )  # fmt: skip
    parser.add_argument(
        "--scale", type=Path, metavar="FILE",
        help="mm per pixel as 'finray study pixel-scale' measured it, in place of what the captures state",
    )  # fmt: skip
    add_out(parser, "normal-map.json")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Fit, store and report."""
    from data_schemas.capture import TactileCapture
    from data_schemas.errors import CompareError
    from data_schemas.provenance import provenance
    from data_schemas.storage import read_record, write_record
    from finray_calib.compare.normal_map_record import normal_map_record, require_ball_press

    out = require_new(arguments.out or Path("normal-map.json"))
    files: list[Path] = arguments.captures
    captures = _circled([read_record(path, TactileCapture) for path in files], files, arguments.circles)
    captures = _scaled(captures, arguments.scale)
    for path, capture in zip(files, captures, strict=True):
        with naming(CompareError, path):
            require_ball_press(capture)
    others = "" if len(files) == 1 else f" and {len(files) - 1} more"
    with naming(CompareError, Path(f"{files[0]}{others}")):
        record = normal_map_record(captures, out.name.removesuffix(".json"), arguments.seed)
    inputs = [*files, *(path for path in (arguments.circles, arguments.scale) if path)]
    write_record(record, out, provenance(command_line(), input_digests(inputs), arguments.seed))
    splits = len(record.held_out_angle_deg)
    say(f"{out}: normal map of {record.presses} presses, {record.width_px} x {record.height_px} px")
    say(f"  on presses it has not seen ({splits} random halves: median [least, most])")
    say(f"  explains {_spread(record.held_out_explained_rel, 3)} of the squared slopes; 0 is knowing nothing")
    say(f"  mean angle of its normals {_spread(record.held_out_angle_deg, 1)} deg")


def _circled(captures: "list[TactileCapture]", files: list[Path], circles: Path | None) -> "list[TactileCapture]":
    """Give captures the contact circles of a file."""
    from data_schemas.errors import CompareError
    from finray_calib.exchange.ball_press_folder import read_circles

    if circles is None:
        return captures
    found = read_circles(circles)
    missing = [path.name for path in files if path.name not in found]
    if missing:
        raise CompareError(f"{circles}: no circle for {missing[0]}; add a line, or leave that capture out")
    return [
        capture.model_copy(update={"contact_circle": found[path.name]})
        for capture, path in zip(captures, files, strict=True)
    ]


def _scaled(captures: "list[TactileCapture]", scale: Path | None) -> "list[TactileCapture]":
    """Give captures the mean scale of a file, at the middle of the board on the pad."""
    from data_schemas.errors import CompareError
    from data_schemas.pixel_scale import PixelScale
    from data_schemas.storage import read_record
    from finray_calib.compare.patch_scale import with_measured_scale

    if scale is None:
        return captures
    found = read_record(scale, PixelScale)
    with naming(CompareError, scale):
        return [with_measured_scale(capture, found) for capture in captures]


def _spread(values: "NDArray[float64]", digits: int) -> str:
    """Return median and range in words."""
    import numpy as np

    return f"{np.median(values):.{digits}f} [{values.min():.{digits}f}, {values.max():.{digits}f}]"
