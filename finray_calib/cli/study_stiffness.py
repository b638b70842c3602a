"""``finray study finger-stiffness``: bending and twist of fingers, with assumed dimensions changed."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.design_file import read_design
from finray_calib.cli.options import add_out, command_line, input_digests, progress_bar, require_new, say

if TYPE_CHECKING:
    from collections.abc import Iterator

    from data_schemas.design import FingerDesign
    from data_schemas.finger_stiffness import FingerStiffness, StiffnessOrder, StiffnessRow

NAME = "finger-stiffness"
HELP = "stiffness of fingers in bending and twist, with assumed dimensions changed"
DESCRIPTION = """\
Load fingers without an indenter: a force at the tip (away from the pad, and across), a force under the middle of the
pad, a twist of the tip; and let them grip a cylinder, for the torque at which it slips. Then change each dimension of
the skeleton that the design's origin does not list, one at a time, up and down, and say whether the order of the
fingers stays. Writes a record and a table (CSV)."""
EPILOG = """\
examples:
  finray study finger-stiffness flat-70x35 flat-70x35-soft --out stiffness
  finray study finger-stiffness mine.toml --vary 0"""
_PERCENT = 100.0
_RIB_FIELDS = ("skeleton.rib_count", "skeleton.rib_width_mm", "skeleton.rib_thickness_mm")


def add_stiffness_study(studies: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the study."""
    parser = studies.add_parser(
        NAME, help=HELP, description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("designs", nargs="+", metavar="DESIGN", help="finger design (TOML), or the name of a preset")
    parser.add_argument(
        "--vary", type=_percent, default=20.0, metavar="PERCENT",
        help="change of the assumed dimensions, 0 to 50 (default 20); 0 leaves them",
    )  # fmt: skip
    add_out(parser, f"{NAME}, a folder")
    parser.set_defaults(run=run_stiffness_study)


def _percent(text: str) -> float:
    """Parse a change in per cent."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 50.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number from 0 to 50 (per cent)")
    return value


def run_stiffness_study(arguments: argparse.Namespace) -> None:
    """Load the fingers, write record and table, and tell the order."""
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record
    from finray_calib.spectra.compiled import machine_threads
    from sim.experiments.finger_stiffness import study_finger_stiffness

    out = require_new(arguments.out or Path(NAME))
    designs = [_design(given) for given in arguments.designs]
    files = [Path(given) for given in arguments.designs if given.endswith(".toml")]
    origin = provenance(command_line(), input_digests(files), None)
    with progress_bar(NAME) as progress:
        study = study_finger_stiffness(designs, arguments.vary / _PERCENT, machine_threads(), progress)
    with ProductSet(out) as products:
        products.add(out / f"{NAME}.csv", _table(study).encode())
        write_record(study, out / f"{NAME}.json", origin, products)
    say(f"{out}: {NAME}.json, {NAME}.csv")
    for row in study.rows:
        if not row.changed:
            say(
                f"  {row.design}: bending {row.bending_n_per_mm:.3f} N/mm, sideways {row.sideways_n_per_mm:.2f} N/mm, "
                f"under the pad {row.pad_n_per_mm:.3f} N/mm, twist {row.twist_n_mm_per_deg:.2f} N mm/deg"
            )
            say(f"    a cylinder gripped with {study.grip_force_n:g} N {_held(row)}")
    for order in study.orders:
        say(f"  {order.measure}: {order.stiffer} / {order.softer} = {order.ratio:.3f}{_over_assumptions(study, order)}")
    for line in _ribs(study):
        say(f"  {line}")
    for row in study.rows:
        if row.failure:
            say(f"  {row.design}, {row.changed} {_PERCENT * row.change_rel:+.0f} %: {row.failure}")


def _held(row: "StiffnessRow") -> str:
    """Say at which torques a gripped cylinder turns, or why that is not known."""
    if row.slip_torque_per_friction_n_mm is None or row.tipping_torque_n_mm is None:
        return f"is not told of: {row.grip_failure}"
    return (
        f"slips about the pad's normal at {row.slip_torque_per_friction_n_mm:.1f} N mm times the coefficient of "
        f"friction, and tips about the finger's axis at {row.tipping_torque_n_mm:.1f} N mm"
    )


def _over_assumptions(study: "FingerStiffness", order: "StiffnessOrder") -> str:
    """Say whether an order holds over the changes; nothing where nothing was changed."""
    if not any(row.changed and not row.failure for row in study.rows):
        return "; no dimension was changed"
    holds = "holds" if order.smallest_ratio > 1.0 else f"does not hold ({order.at})"
    return (
        f"; an assumed dimension changed in both: at least {order.smallest_ratio:.3f}, the order {holds}; changed "
        f"independently: {order.independent_ratio:.3f}"
    )


def _ribs(study: "FingerStiffness") -> "Iterator[str]":
    """Yield what more, wider and thicker ribs do to each finger: measures over those of the finger as designed."""
    for row in study.rows:
        if row.changed not in _RIB_FIELDS or row.failure:
            continue
        designed = next(r for r in study.rows if r.design == row.design and not r.changed)
        ratios = (
            f"{measure.split('_')[0]} {getattr(row, measure) / getattr(designed, measure):.3f}"
            for measure in ("bending_n_per_mm", "sideways_n_per_mm", "pad_n_per_mm", "twist_n_mm_per_deg")
        )
        field = row.changed.removeprefix("skeleton.")
        yield f"{row.design}, {field} {_PERCENT * row.change_rel:+.0f} %: times {', '.join(ratios)}"


def _design(given: str) -> "FingerDesign":
    """Return a design by file or preset."""
    from sim.presets import preset_design

    return read_design(Path(given)) if given.endswith(".toml") else preset_design(given)


def _table(study: "FingerStiffness") -> str:
    """Return the rows as CSV."""
    import csv
    import io

    text = io.StringIO()
    fields = list(type(study.rows[0]).model_fields)
    writer = csv.DictWriter(text, fields, lineterminator="\n")
    writer.writeheader()
    writer.writerows(row.model_dump() for row in study.rows)
    return text.getvalue()
