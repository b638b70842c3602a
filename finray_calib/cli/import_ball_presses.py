"""``finray import taxim`` and ``finray import ball-presses``: another lab's ball presses become tactile captures."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import add_out, command_line, input_digests, require_new, say

if TYPE_CHECKING:
    from data_schemas.capture import TactileCapture

TAXIM = """\
Import the ball presses of a Taxim calibration folder (dataPack.npz, params.json) as tactile captures: 8-bit
values of unknown encoding, with the labelled contact circle. Pickled parts (shadowTable.npz) are never
loaded; what is left out is told."""
BALL_PRESSES = """\
Import a folder of ball presses as tactile captures. It holds background.png (no contact) and either the
catalog.csv of gs_sdk (a folder per press with gelsight.png and label.npz) or plain images with circles.csv
(image,column_px,row_px,radius_px). Presses without a labelled circle are left out, and told."""
NEXT = "finray study normal-map"


def add_parser(formats: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register both formats."""
    for name, help_line, description, run in (
        ("taxim", "ball presses of a Taxim calibration folder", TAXIM, run_taxim),
        ("ball-presses", "background, ball presses and labelled circles (gs_sdk)", BALL_PRESSES, run_ball_presses),
    ):
        parser = formats.add_parser(
            name, help=help_line, description=description, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        parser.add_argument("folder", type=Path, metavar="FOLDER", help="the calibration folder")
        taxim = name == "taxim"
        ball = "default: 4, as of Taxim's own folders" if taxim else "needed unless the catalog gives it"
        scale = "default: pixmm of params.json" if taxim else "needed; not px per mm"
        parser.add_argument("--ball-diameter-mm", type=float, metavar="D", help=f"of the ball ({ball})")
        parser.add_argument(
            "--mm-per-px", type=float, metavar="S", required=not taxim, help=f"side of a pixel on the gel ({scale})"
        )
        add_out(parser, "FOLDER.captures, a folder with a capture of each press")
        parser.set_defaults(run=run)


def run_taxim(arguments: argparse.Namespace) -> None:
    """Import a Taxim folder and report."""
    from finray_calib.exchange.taxim_folder import DATA_PACK, PARAMETERS, read_taxim

    folder: Path = arguments.folder
    out = _new_folder(arguments)
    found = read_taxim(folder, arguments.ball_diameter_mm, arguments.mm_per_px)
    files = [path for path in (folder / DATA_PACK, folder / PARAMETERS) if path.is_file()]
    _store(found.captures, files, out)
    for line in found.assumed:
        say(f"  assumed: {line}")
    _tell_left_out(found.left_out)


def run_ball_presses(arguments: argparse.Namespace) -> None:
    """Import a folder of ball presses and report."""
    from data_schemas.foreign_files import digest_as_read
    from finray_calib.exchange.ball_press_folder import read_ball_presses

    folder: Path = arguments.folder
    out = _new_folder(arguments)
    found = read_ball_presses(folder, arguments.mm_per_px, arguments.ball_diameter_mm)
    files = sorted(p for p in folder.rglob("*") if digest_as_read(p) is not None)
    _store(found.captures, files, out)
    _tell_left_out(found.left_out)


def _new_folder(arguments: argparse.Namespace) -> Path:
    """Return the folder to write, which must be new."""
    return require_new(arguments.out or Path(f"{arguments.folder.resolve().name}.captures"))


def _store(captures: "Sequence[TactileCapture]", files: list[Path], out: Path) -> None:
    """Write a capture of each press and say so."""
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record

    origin = provenance(command_line(), input_digests(files))
    with ProductSet(out) as products:
        for number, capture in enumerate(captures, start=1):
            write_record(capture, out / f"press-{number:03d}.capture.json", origin, products)
    rows, columns = captures[0].contact.shape[:2]
    say(f"{out}: {len(captures)} captures, {columns} x {rows} px, encoding {captures[0].encoding}")
    say(f"  {captures[0].source}; a normal map of them: {NEXT} {out}/*.capture.json")


def _tell_left_out(lines: Sequence[str]) -> None:
    """Say what of the folder was left out."""
    for line in lines:
        say(f"  left out: {line}")
