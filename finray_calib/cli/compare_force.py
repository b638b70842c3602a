"""``finray compare PRESS.mechanics.json --force CSV``: a measured force against the simulated press."""

import argparse
from pathlib import Path

from finray_calib.cli.options import command_line, input_digests, naming, require_new, say

DEFAULT_OUT = "force-comparison.json"


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add the options of a comparison of forces."""
    parser.add_argument(
        "--force", type=Path, metavar="CSV",
        help="compare the force of SIMULATED (NAME.mechanics.json) with a measured one: columns displacement_mm and "
        "force_n, if known force_uncertainty_n and displacement_uncertainty_mm",
    )  # fmt: skip
    parser.add_argument(
        "--known-first-touch", action="store_true",
        help="with --force: displacements count from first touch; it is not fitted",
    )  # fmt: skip
    parser.add_argument(
        "--other-mesh", type=Path, metavar="FILE",
        help="with --force: the same press on another mesh; where they differ by more than the mesh of the 70 x 35 "
        "finger is known to be off by, that is its uncertainty",
    )  # fmt: skip


def compare_force_verb(arguments: argparse.Namespace) -> None:
    """Compare, store record and figure, and tell the table."""
    from data_schemas.errors import CompareError

    if arguments.simulated is None or arguments.capture is not None or arguments.pairs is not None:
        raise CompareError(
            "--force compares one record with a CSV: give NAME.mechanics.json, no CAPTURE and no --pairs"
        )
    if arguments.register or arguments.despite_mismatch or arguments.normal_map is not None:
        raise CompareError("--force: --register, --despite-mismatch and --normal-map belong to images; leave them out")

    import numpy as np

    from data_schemas.press_mechanics import PressMechanics
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.storage import read_record, write_record
    from finray_calib.compare.force_comparison import compare_force
    from finray_calib.exchange.force_csv import read_force_csv
    from finray_calib.reports.force_figure import force_figure_png
    from finray_calib.reports.force_table import force_lines

    out = require_new(arguments.out or Path(DEFAULT_OUT))
    if out.suffix != ".json":
        raise CompareError(f"{out}: is to be a record; choose an --out that ends in .json, the figure goes beside it")
    picture = require_new(out.with_suffix(".png"))
    press = read_record(arguments.simulated, PressMechanics)
    other = None if arguments.other_mesh is None else read_record(arguments.other_mesh, PressMechanics)
    measured = read_force_csv(arguments.force)
    with naming(CompareError, arguments.simulated):
        comparison = compare_force(
            press, measured, np.random.default_rng(arguments.seed), not arguments.known_first_touch, other
        )
    read = [arguments.simulated, arguments.force, *([] if arguments.other_mesh is None else [arguments.other_mesh])]
    with ProductSet(out) as products:
        products.add(picture, force_figure_png(comparison))
        write_record(comparison, out, provenance(command_line(), input_digests(read), arguments.seed), products)
    say(force_lines(comparison))
    say(f"{out}: written\n{picture}: {'curve and points' if comparison.withheld else 'curve, band and points'}")


def refuse_force_options(arguments: argparse.Namespace) -> None:
    """Refuse options that belong to a comparison of forces where images are compared."""
    from data_schemas.errors import CompareError

    if arguments.known_first_touch or arguments.other_mesh is not None:
        raise CompareError("--known-first-touch and --other-mesh belong to --force CSV; add it, or leave them out")
