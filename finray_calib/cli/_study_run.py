"""``finray study run`` and ``show``: a design study by its plan, and the table of one that was run.

And the paints of a study: calibrated ones, or those of the simulated rig in their place.
"""

import argparse
import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, look_at, progress_bar, say, wrote
from finray_calib.cli._run import (
    add_paint,
    add_paints_as_given,
    command_line,
    file_name,
    input_digests,
    paint_files,
    require_place,
)

if TYPE_CHECKING:
    from data_schemas import Provenance, StudyMetric, StudyPoint, StudyResult
    from sim.optics import PaintOptics
    from sim.studies import StudyPaints

RUN_HELP = "run a design study by its plan: change a finger, and press, render and measure each variant"
RUN_DESCRIPTION = """\
Change one finger as a plan (TOML) says, and compute every variant: press, images, colours, evenness, how the touch
shows, force. Points are computed by worker processes, as many as cores and memory allow; what points share is computed
once. Each point is stored as soon as it is finished: an interrupted study continues with the same command. A point that
fails leaves its reason and stops no other.

Writes into the folder of the study: points/ (a record each), table.csv (one row a point), study.json, study.html.

A plan names its finger, what is set, what varies and what is computed:

  name = "tilt"
  design = "flat-70x35"       # a ready-made finger, or a file beside the plan
  combine = "grid"            # or "together"; or "random" with count = 64 and
                              # low, high in place of values

  [set]
  "indenter.depth_mm" = 1.5

  [measure]
  press = "finite elements"   # or "analytic": the pad takes its shape at
                              # once, without force

  [[vary]]
  field = "light.angle_deg"
  values = [0.0, 30.0, 60.0]"""
RUN_EPILOG = """\
examples:
  finray study run pad-shapes
  finray study run tilt.toml --paint red=r.json --paint green=g.json
  finray study run big.toml --scheduler tcp://10.0.0.5:8786

A Dask scheduler is one whose workers see the same folders.
Plans that come with finray: """
SHOW_HELP = "show the table of a design study"
TABLE_NAME, RESULT_NAME, PAGE_NAME = "table.csv", "study.json", "study.html"


def add_design_studies(studies: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``run`` and ``show``."""
    run = studies.add_parser(
        "run",
        help=RUN_HELP,
        description=RUN_DESCRIPTION,
        epilog=RUN_EPILOG + "pad-shapes, finger-family, ribs, light-over-pad",
    )
    run.add_argument("plan", metavar="PLAN", help="plan (TOML), or the name of one that comes with finray")
    add_paint(run)
    add_paints_as_given(run)
    run.add_argument("--engine", choices=["auto", "llvm", "scalar"], default="auto", help="renderer (default: auto)")
    run.add_argument("--workers", type=_count, metavar="N", help="worker processes (default: by cores and memory)")
    run.add_argument("--scheduler", metavar="ADDRESS", help="compute on the workers of this Dask scheduler instead")
    run.add_argument("--out", type=Path, metavar="DIR", help="folder of the study (default: its name)")
    run.set_defaults(run=run_design_study)
    show = studies.add_parser("show", help=SHOW_HELP, description=SHOW_HELP)
    show.add_argument("study", type=Path, metavar="DIR", help="folder that 'finray study run' wrote")
    show.set_defaults(run=show_study)


def _count(text: str) -> int:
    """Parse a number of workers."""
    if not text.isdecimal() or not 1 <= int(text) <= 1024:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from 1 to 1024")
    return int(text)


def run_design_study(arguments: argparse.Namespace) -> None:
    """Run a study; store its table, its result and its page."""
    from data_schemas import SimulateError, StudyResult, StudyRow, provenance
    from data_schemas.storage import clear_leftovers
    from sim.studies import StudyPaints, StudyTask, read_plan, run_study, study_points

    plan, path = read_plan(arguments.plan)
    points = study_points(plan, path)
    paints, files = _paints(arguments) if plan.measure.images else (StudyPaints({}, {}), [])
    out = require_place(arguments.out or Path(file_name(plan.name)))
    out.mkdir(parents=True, exist_ok=True)
    clear_leftovers(out)
    origin = provenance(command_line(), input_digests([path, *files]), plan.seed)
    task = StudyTask(plan, paints, arguments.engine, out.absolute(), path.parent.absolute(), origin)
    with progress_bar(f"study {plan.name}") as progress:
        found, failures = run_study(task, points, arguments.workers, arguments.scheduler, progress)
    if not found:
        raise SimulateError(f"{path}: no point could be computed; the first failed because: {failures[0].reason}")
    result = StudyResult(
        name=plan.name,
        about=plan.about,
        varied=tuple(variation.field for variation in plan.vary),
        points=tuple(StudyRow(number=p.number, changes=p.changes, metrics=p.metrics) for p in found),
        failures=tuple(failures),
    )
    _store(out, result, found, origin)
    _tell(result)
    wrote(out, f"{RESULT_NAME}, {TABLE_NAME} and {PAGE_NAME}")
    look_at(out / PAGE_NAME)


def _tell(result: "StudyResult") -> None:
    """Tell the table of a study and which points failed."""
    from finray_calib.reports import study_text

    give(name=result.name, varied=result.varied, points=result.points, failures=result.failures)
    say(study_text(result))
    for failure in result.failures:
        say(f"point {failure.number} failed: {failure.reason}")


def _paints(arguments: argparse.Namespace) -> "tuple[StudyPaints, list[Path]]":
    """Return the paints of the walls, those of the simulated rig where none are given, and their files."""
    from sim.studies import StudyPaints

    files = paint_files(arguments, without="the simulated rig's paints")
    optics, sources = calibrated_paints(files, arguments.paints_as_given) if files else stand_in_paints()
    return StudyPaints(optics, sources), list(files.values())


STAND_IN = "stand-in: default hidden paint of the simulated rig, not the paper's paint"


def calibrated_paints(files: dict[str, Path], as_given: bool = True) -> "tuple[dict[str, PaintOptics], dict[str, str]]":
    """Return the optics of calibrated paints and their names and checksums."""
    from data_schemas import PaintCalibration, digest_of_input
    from data_schemas.storage import read_record
    from sim.experiments import paint_optics, require_paints_in_order

    paints = {colour: read_record(file, PaintCalibration) for colour, file in files.items()}
    if not as_given:
        modes_nm = {colour: paint.mode_nm.estimate for colour, paint in paints.items()}
        require_paints_in_order(modes_nm, {colour: str(file) for colour, file in files.items()}, "--paints-as-given")
    sources = {c: f"{paint.paint_name}, SHA-256 {digest_of_input(files[c])}" for c, paint in paints.items()}
    return {colour: paint_optics(paint) for colour, paint in paints.items()}, sources


def stand_in_paints() -> "tuple[dict[str, PaintOptics], dict[str, str]]":
    """Return the optics of the simulated rig's two default paints."""
    from finray_calib.demo import true_paint_optics
    from rigs import DEFAULT_PAINTS, simulated_rig
    from rigs.simulated import bench_truth

    truths = {colour: bench_truth(simulated_rig(colour, None, seed=1), Path()) for colour in DEFAULT_PAINTS}
    paints = {colour: true_paint_optics(colour, truth) for colour, truth in truths.items()}
    return paints, dict.fromkeys(paints, STAND_IN)


def _store(out: Path, result: "StudyResult", points: "Sequence[StudyPoint]", origin: "Provenance") -> None:
    """Store table, page and result together, in place of those of an earlier run of the same study."""
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.reports import design_study_page

    names = (RESULT_NAME, TABLE_NAME, PAGE_NAME)
    for name in names:  # made again from the points, which are what is kept
        (out / name).unlink(missing_ok=True)
    page = design_study_page(result, points, origin.command, origin.input_sha256, origin.package_version)
    with ProductSet(out / RESULT_NAME) as products:
        products.add(out / TABLE_NAME, table_csv(result).encode())
        products.add(out / PAGE_NAME, page.encode())
        write_record(result, out / RESULT_NAME, origin, products)


def table_csv(result: "StudyResult") -> str:
    """Return one row a point: number, what was changed, and each metric with its limits."""
    names = list(dict.fromkeys(metric.name for row in result.points for metric in row.metrics))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["point", *result.varied, *(f"{n}{end}" for n in names for end in ("", "_low95", "_high95"))])
    for row in result.points:
        metrics = {metric.name: metric for metric in row.metrics}
        cells = [value for name in names for value in _three(metrics.get(name))]
        writer.writerow([row.number, *(row.changes[field] for field in result.varied), *cells])
    return text.getvalue()


def _three(metric: "StudyMetric | None") -> tuple[float | None, float | None, float | None]:
    """Return a number and its limits; None where they are not known."""
    return (None, None, None) if metric is None else (metric.value, metric.low95, metric.high95)


def show_study(arguments: argparse.Namespace) -> None:
    """Show the table of a study."""
    from data_schemas import StudyResult
    from data_schemas.storage import read_record

    _tell(read_record(arguments.study / RESULT_NAME, StudyResult))
    if (arguments.study / PAGE_NAME).exists():
        look_at(arguments.study / PAGE_NAME)
