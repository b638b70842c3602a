"""``finray study pixel-scale``: from pictures of a ChArUco board to millimetres per pixel on the pad."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.board_options import board_pictures, tolerances
from finray_calib.cli.options import add_out, add_seed, command_line, input_digests, require_new, say, warn

if TYPE_CHECKING:
    from data_schemas.pixel_scale import PixelScale

HELP = "calibrate the camera and measure millimetres per pixel on the pad, with a ChArUco board"
DESCRIPTION = """\
Calibrate the lens and measure how many millimetres a pixel spans on the pad, along rows and along columns,
with standard uncertainty. Needed are one picture of a ChArUco board that lies where the coat of the pad is,
and four or more (ten are good) with the board turned and tilted, all with the camera as it stands in the
finger. Pictures through the mirror are recognised. Writes the record, and beside it the lens (FILE.lens.yaml)
for 'camera.calibration' of a design."""


def add_pixel_scale_study(studies: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the study."""
    parser = studies.add_parser(
        "pixel-scale", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "lens", type=Path, nargs="+", metavar="PICTURE",
        help="the board turned and tilted; or the folder of one tactile session, whose plan has the board on_pad",
    )  # fmt: skip
    parser.add_argument("--pad", type=Path, metavar="PICTURE", help="the board where the pad's coat is")
    parser.add_argument("--plan", type=Path, metavar="TOML", help="tactile plan whose [board] says what was printed")
    parser.add_argument("--squares", metavar="NxM", help="squares along and across, for example 7x5")
    parser.add_argument("--square-mm", type=float, metavar="MM", help="side of a printed square, measured")
    parser.add_argument("--marker-mm", type=float, metavar="MM", help="side of a marker")
    parser.add_argument("--dictionary", default="DICT_4X4_50", metavar="NAME", help="of OpenCV (default: DICT_4X4_50)")
    parser.add_argument(
        "--square-u-mm", type=float, metavar="MM", help="standard uncertainty of the side of a square; needed"
    )
    parser.add_argument(
        "--coat-behind-mm", type=float, default=0.0, metavar="MM",
        help="how far the coat lies behind the printed face, seen from the camera; negative: before it (default: 0)",
    )  # fmt: skip
    parser.add_argument(
        "--coat-behind-u-mm", type=float, default=0.0, metavar="MM", help="its standard uncertainty (default: 0)"
    )
    parser.add_argument("--lens-model", choices=("fisheye", "pinhole"), help="default: the one that fits better")
    parser.add_argument("--monochrome", action="store_true", help="16-bit pictures are grey, not Bayer counts")
    add_out(parser, "pixel-scale.json")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Calibrate, store and report."""
    from data_schemas.errors import CompareError
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record
    from finray_calib.compare.board_corners import find_board, require_plausible
    from finray_calib.compare.board_plane import Declared
    from finray_calib.compare.pixel_scale_record import pixel_scale
    from finray_calib.exchange.board_pictures import calibration_yaml, read_board_picture

    out = require_new(arguments.out or Path("pixel-scale.json"))
    lens_file = require_new(out.with_suffix(".lens.yaml"))
    board, pad, others = board_pictures(arguments)
    require_plausible(board)
    declared = Declared(*tolerances(arguments, board.square_mm))
    files = [pad, *others]
    pictures = {str(path): read_board_picture(path, arguments.monochrome) for path in files}
    sizes = {picture.shape for picture in pictures.values()}
    if len(sizes) > 1:
        raise CompareError(f"the pictures have several sizes (rows x columns): {sorted(sizes)}; one camera has one")
    views = [find_board(pictures[str(pad)], board, str(pad))]
    for path in others:
        try:
            views.append(find_board(pictures[str(path)], board, str(path)))
        except CompareError as error:
            warn(f"left out: {error}")
    height, width = next(iter(sizes))
    record = pixel_scale(
        views[0], views[1:], (width, height), board, declared, arguments.seed, arguments.lens_model, pictures
    )
    inputs = input_digests([*files, *([arguments.plan] if arguments.plan else [])])
    with ProductSet(out) as products:
        products.add(lens_file, calibration_yaml(record.calibration))
        write_record(record, out, provenance(command_line(), inputs, arguments.seed), products)
    say(_in_words(record, out, lens_file))


def _in_words(record: "PixelScale", out: Path, lens_file: Path) -> str:
    """Return what the user wants to know at once."""
    middle, over = record.middle, record.over_board
    lens = record.calibration
    u_middle = sorted(((line.u_rel, line.input) for line in record.budget), reverse=True)
    lines = [
        f"{out}, {lens_file}: {lens.model} lens from {len(record.lens_pictures)} pictures, corners to "
        f"{record.corner_sd_px:.2f} px",
        f"  at column {middle.column_px:.0f}, row {middle.row_px:.0f} (middle of the board on the pad), standard "
        "uncertainty u:",
        f"    along x  {middle.along_x_mm_per_px:.5g} mm/px, u = {middle.along_x_u_rel:.2%}",
        f"    along y  {middle.along_y_mm_per_px:.5g} mm/px, u = {middle.along_y_u_rel:.2%}",
        f"    mean     {middle.mean_mm_per_px:.5g} mm/px, u = {middle.mean_u_rel:.2%} "
        f"({', '.join(f'{name} {u:.2%}' for u, name in u_middle)})",
        f"  over the board {over.along_x_low_mm_per_px:.4g} to {over.along_x_high_mm_per_px:.4g} mm/px along x, "
        f"{over.along_y_low_mm_per_px:.4g} to {over.along_y_high_mm_per_px:.4g} mm/px along y",
        f"  in a plan: mm_per_px = {middle.mean_mm_per_px:.5g}, mm_per_px_u_rel = {middle.mean_u_rel:.2g}",
        *(f"  note: {note}" for note in record.notes),
    ]
    return "\n".join(lines)
