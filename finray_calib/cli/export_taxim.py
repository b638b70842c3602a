"""``finray export taxim``: a classic sensor or a finger as a calibration folder that Taxim's programs render from."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.design_file import read_design
from finray_calib.cli.options import (
    Progress,
    add_paint,
    command_line,
    design_inputs,
    file_name,
    input_digests,
    open_engine,
    paint_files,
    progress_bar,
    require_new,
    say,
)

if TYPE_CHECKING:
    from sim.experiments.taxim_calibration import BallPresses

PRESSES = 48
BALL_DIAMETER_MM = 4.0
SAMPLES = 64
PAINTS = "wall_paint"
"""Where --paint stands among the arguments; "paint" is the file to export."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a Taxim folder."""
    taxim = parser.add_argument_group("Taxim folders")
    taxim.add_argument("--presses", type=_count, metavar="N", help=f"ball presses to render (default {PRESSES})")
    taxim.add_argument(
        "--ball-diameter-mm", type=_length, metavar="D", help=f"of the ball (default {BALL_DIAMETER_MM:g})"
    )
    taxim.add_argument("--samples", type=_count, metavar="N", help=f"paths per pixel (default {SAMPLES})")
    add_paint(taxim, "paint calibration of a finger's wall; without paints the design is a classic sensor", PAINTS)


def _count(text: str) -> int:
    """Parse a number of presses or paths."""
    if not text.isdecimal() or not 1 <= int(text) <= 100_000:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from 1 to 100000")
    return int(text)


def _length(text: str) -> float:
    """Parse a length in mm."""
    try:
        length_mm = float(text)
    except ValueError:
        length_mm = 0.0
    if not 0.0 < length_mm <= 100.0:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number of mm above 0 and at most 100")
    return length_mm


def refuse_options(arguments: argparse.Namespace) -> None:
    """Refuse what belongs to a Taxim folder, where something else is exported.

    Raises
    ------
    RecordError
        When an option of a Taxim folder is given.
    """
    from data_schemas.errors import RecordError

    names = ("presses", "ball_diameter_mm", "samples")
    given = [f"--{name.replace('_', '-')}" for name in names if getattr(arguments, name) is not None]
    given += ["--paint"] if getattr(arguments, PAINTS) else []
    if given:
        raise RecordError(
            f"{' and '.join(given)}: belongs to a Taxim folder: finray export taxim SENSOR {given[0]} ..."
        )


def run(arguments: argparse.Namespace) -> None:
    """Render, write the folder and report."""
    from data_schemas.errors import RecordError
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from finray_calib.cli.export_deck import refuse_options as refuse_deck
    from finray_calib.exchange.taxim_export import taxim_files
    from finray_calib.exchange.taxim_table import FEWEST_PRESSES

    refuse_deck(arguments)
    for name in ("format", "led", "camera_response"):
        if getattr(arguments, name) is not None:
            raise RecordError(f"--{name.replace('_', '-')} belongs to a paint; leave it out for a Taxim folder")
    if len(arguments.paint) != 2:  # the word and the file
        raise RecordError("a Taxim folder needs one sensor or finger: finray export taxim SENSOR.toml")
    if arguments.presses is not None and arguments.presses < FEWEST_PRESSES:  # found before anything is rendered
        raise RecordError(
            f"--presses {arguments.presses}: a shading table needs at least {FEWEST_PRESSES} presses; ask for more, or "
            f"leave it out for {PRESSES}"
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
    say(f"{out}: Taxim calibration folder of {table.presses} presses, {presses.mm_per_px:.4g} mm per px")
    say(f"  {presses.label}")
    say(f"  explains {median:.3f} [{least:.3f}, {most:.3f}] of the contact's change on presses it has not seen")
    say(f"  slopes up to {table.steepest_deg:.0f} deg; shadows beside a contact are not exported")


def _sensor(arguments: argparse.Namespace, progress: Progress) -> "tuple[BallPresses, list[Path]]":
    """Render a classic sensor."""
    from data_schemas.plain_sensor import PlainSensor
    from data_schemas.storage import read_toml
    from sim.experiments.taxim_calibration import render_ball_presses

    path: Path = arguments.paint[1]
    _refuse_finger(path)
    sensor = read_toml(path, PlainSensor)
    return render_ball_presses(sensor, open_engine("auto"), *_amounts(arguments), progress), [path]


def _refuse_finger(path: Path) -> None:
    """Refuse the design of a finger, whose walls need paints."""
    from data_schemas.errors import FinrayError, RecordError

    try:
        design = read_design(path)
    except FinrayError:
        return
    raise RecordError(
        f"{path}: is the design of a finger, '{design.name}', whose walls need paints: add "
        "--paint red=PAINT.paint.json and --paint green=PAINT.paint.json; without paints a Taxim "
        "folder is that of a classic sensor"
    )


def _finger(arguments: argparse.Namespace, progress: Progress) -> "tuple[BallPresses, list[Path]]":
    """Render a finger with its paints."""
    from data_schemas.fit import PaintCalibration
    from data_schemas.storage import read_record
    from sim.experiments.painted_finger import paint_finger, paint_optics
    from sim.experiments.taxim_finger import render_finger_presses

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
