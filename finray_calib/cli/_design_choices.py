"""``finray design paints``: choose paints for a finger by their calibrations, before anything is moulded."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, go_on_with, progress_bar, say, wrote
from finray_calib.cli._run import (
    add_seed,
    command_line,
    file_name,
    input_digests,
    naming,
    open_engine,
    require_new,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from data_schemas import FingerDesign, PaintCalibration, PaintChoice

PAINTS_HELP = "rank calibrated paints for a finger by the error of the sensed normal"
PAINTS_DESCRIPTION = """\
Rank every pair of paints, one on each wall, by the expected error of the normal that the finger would sense, before
anything is moulded. The error is that of a map from colour to normal at places of the pad that have not taught it, with
the noise of the camera ('held-out normal error' of 'finray simulate sweep --objectives all'), at the light angle of the
design. The uncertainty of the emission comes from the posterior draws of each calibration; all pairs share paths, noise
and draws, and the last column says which differences to the best pair are real, all pairs together at 95 %.

Light is traced once for all pairs; another pair costs a second. What the intervals do not know: the camera's response
where it is assumed, the reflectance of the paints, and how far the simulation is from a real finger, which all pairs
share."""
PAINTS_EPILOG = """\
example:
  finray design paints flat-70x35 --paint a.paint.json --paint b.paint.json --paint c.paint.json"""


def add_design_choices(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the actions."""
    paints = actions.add_parser("paints", help=PAINTS_HELP, description=PAINTS_DESCRIPTION, epilog=PAINTS_EPILOG)
    paints.add_argument("design", type=Path, metavar="FINGER", help="finger design (TOML), or the name of a preset")
    paints.add_argument(
        "--paint", type=Path, action="append", required=True, metavar="FILE",
        help="paint calibration, written by 'finray fit'; at least two",
    )  # fmt: skip
    paints.add_argument("--engine", choices=["auto", "llvm"], default="auto", help="renderer (default: auto)")
    paints.add_argument("--out", type=Path, metavar="JSON", help="default: NAME.paint-choice.json; must be new")
    add_seed(paints)
    paints.set_defaults(run=run_paints)


def run_paints(arguments: argparse.Namespace) -> None:
    """Rank the pairs of paints, and store the ranking."""
    from data_schemas import SimulateError, provenance
    from data_schemas.storage import camera_response, write_record
    from finray_calib.decide import paint_choice
    from sim.experiments import BareFinger, PaintDraws, paint_pairs
    from sim.optics import read_calibration

    design, files, folder = _design(arguments.design)
    paints = _paints(arguments.paint)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.paint-choice.json"))
    camera = design.camera
    with naming(SimulateError, arguments.design):
        finger = BareFinger(
            design,
            camera_response(camera.response, folder),
            open_engine(arguments.engine),
            None if camera.calibration is None else read_calibration(folder / camera.calibration),
        )
    drawn = {name: PaintDraws.of(paint) for name, paint in paints.items()}
    with progress_bar(f"paints of {design.name}") as progress:
        found = paint_pairs(finger, drawn, arguments.seed, progress=progress)
    choice = paint_choice(
        design, found.pairs, found.normal_error_deg, found.separation_deg, found.exposure_rel, found.notes
    )
    write_record(choice, out, provenance(command_line(), input_digests([*files, *arguments.paint]), arguments.seed))
    say(choice.sentence)
    for line in _table(choice):
        say(line)
    wrote(out, "the ranking with its draws")
    give(sentence=choice.sentence, pairs=choice.pairs, notes=choice.notes)
    best = choice.pairs[0]
    chosen = dict(zip(paints, arguments.paint, strict=True))
    go_on_with(
        "finray simulate sweep", arguments.design, f"--paint red={chosen[best.red]} --paint green={chosen[best.green]}",
        "--objectives all",
    )  # fmt: skip


def _design(path: Path) -> "tuple[FingerDesign, list[Path], Path]":
    """Return a finger, the files it was read from, and where its relative paths start."""
    from sim import PRESETS, preset_design, read_design

    if not path.exists() and str(path) in PRESETS:
        return preset_design(str(path)), [], Path()
    return read_design(path), [path], path.parent


def _paints(files: "Sequence[Path]") -> "dict[str, PaintCalibration]":
    """Return calibrations by name; paints of one name are told apart by their files."""
    from data_schemas import PaintCalibration, SimulateError
    from data_schemas.storage import read_record

    if len({file.resolve() for file in files}) < max(len(files), 2):
        raise SimulateError("--paint: a finger carries two paints; give at least two files, each of them once")
    read = [read_record(file, PaintCalibration) for file in files]
    names = [paint.paint_name for paint in read]
    return {
        name if names.count(name) == 1 else f"{name} ({file})": paint
        for name, file, paint in zip(names, files, read, strict=True)
    }


def _table(choice: "PaintChoice") -> "Iterator[str]":
    """Yield the lines of the table, best pair first."""
    head = ("red wall", "green wall", "error (deg)", "above best (deg)", "")
    rows = [
        (
            row.red,
            row.green,
            str(row.normal_error_deg),
            "best" if place == 0 else str(row.above_best_deg),
            "" if place == 0 else "worse" if row.is_worse else "not told apart",
        )
        for place, row in enumerate(choice.pairs)
    ]
    widths = [max(len(line[k]) for line in (head, *rows)) for k in range(len(head))]
    for line in (head, *rows):
        yield "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
