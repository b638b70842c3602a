"""``finray study run``, ``show``, ``compare`` and ``dataset``: a study by its plan, its table, and data for learning.

And the paints of a study: calibrated ones, or those of the simulated rig in their place.
"""

import argparse
import csv
import hashlib
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, progress_bar, say, suggest_file, warn, wrote
from finray_calib.cli._run import (
    add_engine,
    add_paint,
    add_paints_as_given,
    add_seed,
    command_line,
    file_name,
    input_digests,
    paint_files,
    path_count,
    require_folder,
    whole_number,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_schemas import (
        DatasetFailure,
        DatasetPlan,
        DatasetShard,
        DesignValue,
        LearningDataset,
        Provenance,
        StudyFailure,
        StudyMetric,
        StudyPoint,
        StudyResult,
    )
    from sim.experiments import PaintDraws
    from sim.optics import PaintOptics
    from sim.studies import DatasetTask, StudyPaints, StudyTask

#: In the label of a render.
_RENDERER = re.compile(r"\b(?:scalar|llvm|cuda)\w*")
RUN_HELP = "run a design study by its plan: change a finger, and press, render and measure each variant"
RUN_DESCRIPTION = """\
Change one finger as a plan (TOML) says, and compute every variant: press, images, colours, evenness, change by
the touch, force. Points are computed by worker processes, as many as cores and memory allow; what points share is
computed once. Each point is stored as soon as it is finished: an interrupted study continues with the same command. A
point that fails is stored with its reason and does not stop the others.

Writes into the folder of the study: points/ (a record for each), table.csv (one row per point), study.json, study.html,
pictures.webp (all pictures in one).

A plan names its finger, what is set, what varies and what is computed:

  name = "tilt"
  design = "flat-70x35"       # a ready-made finger, or a file beside the plan
  combine = "grid"            # or "together"; or "random" with count = 64 and
                              # low, high in place of values

  [set]
  "indenter.depth_mm" = 1.5

  [measure]
  press = "finite elements"   # or "analytic": the pad takes the indenter's
                              # shape by a formula, without force

  [[vary]]
  field = "light.angle_deg"
  values = [0.0, 30.0, 60.0]"""
RUN_EPILOG = """\
examples:
  finray study run pad-shapes
  finray study run tilt.toml --paint red=r.json --paint green=g.json
  finray study run big.toml --scheduler tcp://10.0.0.5:8786

The workers of a Dask scheduler must see the same folders.
Plans that come with finray: """
SHOW_HELP = "show the table of a design study"
COMPARE_HELP = "compare two design studies point by point: which numbers differ by more than the uncertainties of both"
COMPARE_DESCRIPTION = """\
Compare the points that two design studies have in common: those that change the same fields to the same values. For
each number the command gives the difference with 95 % limits, as if the studies were independent. It says "differs"
at 95 % confidence for all numbers together. Two studies with the same seed share part of their noise, so that more
numbers may differ than the command reports."""
DATASET_HELP = "make a data set for learning: random presses of a finger, rendered, with depth, normals and labels"
DATASET_DESCRIPTION = """\
Draw random presses of a finger, render each without and with contact under several draws of the light and of the
paints, and store pictures with depth, normals and labels as shards that WebDataset reads (TAR of PNG and JSON).

One render of a press serves all its paints, and one press all its lights: samples of one press belong together, and the
index puts whole presses into training, validation and test. A shard is stored as soon as it is finished: an interrupted
data set continues with the same command, and grows with a larger --presses.

Writes into the folder: shards/, index.csv (and index.parquet where pyarrow is installed), places_mm.npy (what each
pixel sees of the pad), README.md (the card of the data set), dataset.json and manifest-sha256.txt."""
DATASET_EPILOG = """\
examples:
  finray study dataset flat-70x35 --presses 20 --size 160x120 --out presses
  finray study dataset finger.toml --presses 1000 --paint red=r.json --paint green=g.json --out presses
  finray study dataset finger.toml --presses 200 --press "finite elements" --shape ball --shape cylinder"""
DATASET_NAME, INDEX_NAME, CARD_NAME, PLACES_NAME = "dataset.json", "index.csv", "README.md", "places_mm.npy"
PARQUET_NAME, NETCDF_NAME = "table.parquet", "table.nc"
TABLE_NAME, RESULT_NAME, PAGE_NAME, PICTURES_NAME = "table.csv", "study.json", "study.html", "pictures.webp"


def add_design_studies(studies: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``run``, ``dataset``, ``show`` and ``compare``."""
    run = studies.add_parser(
        "run",
        help=RUN_HELP,
        description=RUN_DESCRIPTION,
        epilog=RUN_EPILOG + "pad-shapes, finger-family, ribs, light-over-pad,\neveryday-objects",
    )
    run.add_argument("plan", metavar="PLAN", help="plan (TOML), or the name of one that comes with finray")
    add_paint(run)
    add_paints_as_given(run)
    add_engine(run)
    _add_workers(run)
    run.add_argument("--renew", action="store_true", help="compute again the points that another version or commit of "
                     "finray computed (default: keep them, and list them)")  # fmt: skip
    run.add_argument("--out", type=Path, metavar="DIR", help="folder of the study (default: its name)")
    run.set_defaults(run=run_design_study)
    _add_dataset(studies)
    show = studies.add_parser("show", help=SHOW_HELP, description=SHOW_HELP)
    show.add_argument("study", type=Path, metavar="DIR", help="folder that 'finray study run' wrote")
    show.set_defaults(run=show_study)
    compare = studies.add_parser("compare", help=COMPARE_HELP, description=COMPARE_DESCRIPTION)
    for name in ("first", "second"):
        compare.add_argument(name, type=Path, metavar=name.upper(), help="folder that 'finray study run' wrote")
    compare.set_defaults(run=compare_studies)


def _add_workers(parser: argparse.ArgumentParser) -> None:
    """Add who computes."""
    workers = "worker processes (default: by cores and memory)"
    parser.add_argument("--workers", type=whole_number(1, 1024), metavar="N", help=workers)
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="address of a Dask scheduler whose workers compute instead"
    )


def _add_dataset(studies: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``dataset``."""
    made = studies.add_parser("dataset", help=DATASET_HELP, description=DATASET_DESCRIPTION, epilog=DATASET_EPILOG)
    made.add_argument("design", metavar="DESIGN", help="finger design (TOML), or a ready-made finger by its name")
    made.add_argument(
        "--presses", type=whole_number(1, 1_000_000), default=100, metavar="N", help="presses (default: 100)"
    )
    made.add_argument("--shape", action="append", choices=["ball", "cylinder"],
                      help="shape of the indenter (repeatable; default: ball)")  # fmt: skip
    for name, range_mm, what in (("radius", (3.0, 10.0), "indenter's radius"), ("depth", (0.3, 2.0), "push")):
        made.add_argument(f"--{name}-mm", type=float, nargs=2, metavar=("LOW", "HIGH"), default=range_mm,
                          help=f"range of the {what} in mm (default: {range_mm[0]:g} {range_mm[1]:g})")  # fmt: skip
    made.add_argument("--press", choices=["analytic", "finite elements"], default="analytic",
                      help="how to compute the press; finite elements give the force, but take longer (default: "
                           "analytic)")  # fmt: skip
    made.add_argument("--lights", type=whole_number(1, 1000), default=2, metavar="N",
                      help="number of draws of the light for each press (default: 2)")  # fmt: skip
    made.add_argument("--light-angle-deg", type=float, default=5.0, metavar="REACH",
                      help="largest turn of the panels in deg from their angle in the design (default: 5)")  # fmt: skip
    made.add_argument("--paints", type=whole_number(1, 1000), default=4, metavar="N",
                      help="number of draws of the paints for each light (default: 4)")  # fmt: skip
    made.add_argument("--emission-ratio", type=float, default=1.25, metavar="R",
                      help="largest factor R for paints without a posterior, whose emission is multiplied by 1/R to "
                           "R (default: 1.25)")  # fmt: skip
    made.add_argument("--size", type=_size, metavar="COLUMNSxROWS",
                      help="size of the pictures, one pixel for each Bayer cell (default: "
                           "the design's camera)")  # fmt: skip
    made.add_argument("--samples", type=path_count, default=32, metavar="N", help="paths per pixel (default: 32)")
    made.add_argument("--presses-per-shard", type=whole_number(1, 100_000), default=10, metavar="N",
                      help="number of presses in a shard (default: 10)")  # fmt: skip
    add_paint(made)
    add_paints_as_given(made)
    add_engine(made, is_scalar_enough=False)
    _add_workers(made)
    add_seed(made)
    made.add_argument("--out", type=Path, metavar="DIR", help="folder of the data set (default: DESIGN-dataset)")
    made.set_defaults(run=run_learning_dataset)


def _size(text: str) -> tuple[int, int]:
    """Parse the size of a picture; the camera has two pixels each way for each of them."""
    columns, separator, rows = text.partition("x")
    if not (separator and columns.isdecimal() and rows.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} must be columns x rows of the pictures, such as 160x120")
    if not (32 <= int(columns) <= 2048 and 24 <= int(rows) <= 2048):
        raise argparse.ArgumentTypeError(f"{text!r} must be 32x24 to 2048x2048 pixels")
    return int(columns), int(rows)


def run_design_study(arguments: argparse.Namespace) -> None:
    """Run a study; store its table, its result and its page."""
    from data_schemas import SimulateError, provenance
    from data_schemas.storage import clear_leftovers
    from finray_calib.reports.studies import points_by_code
    from sim.studies import (
        STUDY_FOLDERS,
        StudyPaints,
        StudyTask,
        design_folder,
        read_plan,
        run_study,
        study_points,
    )

    plan, path = read_plan(arguments.plan)
    points = study_points(plan, path)
    unused = "--paint" if arguments.paint else "--paints-as-given" if arguments.paints_as_given else ""
    if unused and not plan.measure.images:
        raise SimulateError(
            f"{path}: the plan renders no images (measure.images = false), so {unused} has no effect; leave it out"
        )
    paints, files = _paints(arguments) if plan.measure.images else (StudyPaints({}, {}), [])
    out = require_folder(arguments.out or Path(file_name(plan.name)))
    if out.exists() and any(out.iterdir()) and not any((out / name).is_dir() for name in STUDY_FOLDERS):
        raise SimulateError(f"{out}: holds something other than a design study; choose another --out")
    out.mkdir(parents=True, exist_ok=True)
    clear_leftovers(out)
    origin = provenance(command_line(), input_digests([path, *files]), plan.seed)
    folder = design_folder(path, points, out)
    task = StudyTask(plan, paints, arguments.engine, out.absolute(), folder, origin, arguments.renew)
    with progress_bar(f"study {plan.name}") as progress:
        found, failures = run_study(task, points, arguments.workers, arguments.scheduler, progress)
    if not found:
        raise SimulateError(f"{path}: no point could be computed. The first error is: {failures[0].reason}")
    result = _result(task, found, failures)
    _store(out, result, found, origin)
    _tell(result)
    other = "; ".join(f"{n} by {code}" for code, n in points_by_code(result).items() if code != origin.code)
    if other:
        warn(
            f"points computed by other code than the present code ({origin.code}) are kept: {other}. Give --renew to "
            "compute them again"
        )
    _warn_of_renderers(result, found)
    wrote(out, f"{RESULT_NAME}, {TABLE_NAME} and {PAGE_NAME}")
    suggest_file(out / PAGE_NAME)


def _warn_of_renderers(result: "StudyResult", points: "Sequence[StudyPoint]") -> None:
    """Warn of points that do not share their random numbers, because other renderers took them."""
    from finray_calib.reports.studies import points_by_code

    labels = {point.number: _RENDERER.search(point.notes[0]) for point in points if point.notes}
    named = {number: found[0] for number, found in labels.items() if found is not None}
    if len(set(named.values())) < 2:
        return
    rows = tuple(row.model_copy(update={"computed_by": named.get(row.number)}) for row in result.points)
    told = points_by_code(result.model_copy(update={"points": [row for row in rows if row.computed_by]}))
    warn(
        f"points were rendered by different renderers: {'; '.join(f'{n} by {one}' for one, n in told.items())}. Their "
        "differences contain the noise of both, because points share random numbers within one renderer only; for "
        "differences with less noise, run the study again with another --out"
    )


def _result(task: "StudyTask", points: "Sequence[StudyPoint]", failures: "Sequence[StudyFailure]") -> "StudyResult":
    """Return the table of a study, with the code that computed each point."""
    from data_schemas import StudyResult, StudyRow
    from sim.studies import point_code

    return StudyResult(
        name=task.plan.name,
        about=task.plan.about,
        varied=tuple(variation.field for variation in task.plan.vary),
        points=tuple(
            StudyRow(number=p.number, changes=p.changes, metrics=p.metrics, computed_by=point_code(task, p))
            for p in points
        ),
        failures=tuple(failures),
    )


def _tell(result: "StudyResult") -> None:
    """Tell the table of a study and which points failed."""
    from finray_calib.reports.studies import study_text

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


def run_learning_dataset(arguments: argparse.Namespace) -> None:
    """Make a data set for learning; store its shards, index, card and record."""
    from data_schemas import SimulateError, provenance
    from data_schemas.storage import clear_leftovers
    from sim.experiments import read_design_files
    from sim.studies import DatasetTask, planned_shards, run_dataset

    plan, path = _dataset_plan(arguments)
    shards = planned_shards(plan, arguments.presses)
    paints, sources, files = _paint_draws(arguments)
    out = require_folder(arguments.out or Path(f"{file_name(plan.design.name)}-dataset"))
    if out.exists() and any(out.iterdir()) and not (out / "shards").is_dir():
        raise SimulateError(f"{out}: holds something other than a data set; choose another --out")
    out.mkdir(parents=True, exist_ok=True)
    clear_leftovers(out)
    folder = Path() if path is None else path.parent
    read = [*([] if path is None else [path]), *read_design_files(plan.design, folder, ["camera"]).values()]
    origin = provenance(command_line(), input_digests([*read, *files]), plan.seed)
    task = DatasetTask(plan, paints, sources, arguments.engine, out.absolute(), folder.absolute(), origin)
    with progress_bar("data set") as progress:
        kept, failures = run_dataset(task, shards, arguments.workers, arguments.scheduler, progress)
    if not any(shard.samples for shard in kept):
        raise SimulateError(f"no press could be computed. The first error is: {failures[0].reason}")
    _store_dataset(task, out, arguments.presses, kept, failures)


def _dataset_plan(arguments: argparse.Namespace) -> "tuple[DatasetPlan, Path | None]":
    """Return what the presses are drawn from, and the file of the design if it is one."""
    from data_schemas import DatasetPlan, FieldError, SimulateError
    from sim import given_design

    design, files, _ = given_design(Path(arguments.design))
    if arguments.size is not None:
        columns, rows = arguments.size
        camera = design.camera.model_copy(update={"width_px": 2 * columns, "height_px": 2 * rows})
        design = design.model_copy(update={"camera": camera})
    try:
        plan = DatasetPlan(
            design=design,
            press=arguments.press,
            shapes=tuple(dict.fromkeys(arguments.shape or ["ball"])),
            radius_mm=tuple(arguments.radius_mm),
            depth_mm=tuple(arguments.depth_mm),
            lights=arguments.lights,
            light_angle_reach_deg=arguments.light_angle_deg,
            paints=arguments.paints,
            emission_ratio=arguments.emission_ratio,
            samples_per_pixel=arguments.samples,
            presses_per_shard=arguments.presses_per_shard,
            seed=arguments.seed,
        )
    except FieldError as error:
        raise SimulateError(f"finray study dataset: {error}") from None
    return plan, files[0] if files else None


def _paint_draws(arguments: argparse.Namespace) -> "tuple[dict[str, PaintDraws], dict[str, str], list[Path]]":
    """Return both paints with the draws of their emission, where they come from, and their files."""
    from data_schemas import PaintCalibration
    from data_schemas.storage import read_record
    from sim.experiments import PaintDraws

    files = paint_files(arguments, without="the simulated rig's paints")
    if not files:
        optics, sources = stand_in_paints()
        return {c: PaintDraws(paint, paint.emission_per_nm[None]) for c, paint in optics.items()}, sources, []
    _, sources = calibrated_paints(files, arguments.paints_as_given)
    paints = {colour: PaintDraws.of(read_record(file, PaintCalibration)) for colour, file in files.items()}
    return paints, sources, list(files.values())


_DATASET_NOTES = (
    "no camera: no shot or read noise, no defocus, no lens distortion except that of the design; the render's own "
    "noise is in render_noise_rel. Where nothing moves, this noise is the same in both pictures, so the difference of "
    "the two pictures has less noise than that of two camera pictures: add the noise of your camera while training",
    "no error of the model: materials, dimensions and the camera's response are those of the design in every sample, "
    "and a network trained here has not seen a real finger",
    "no wear, dirt, or other light; no more than one contact; no slip of the indenter along the pad",
)


def _store_dataset(
    task: "DatasetTask",
    out: Path,
    presses: int,
    shards: "Sequence[DatasetShard]",
    failures: "Sequence[DatasetFailure]",
) -> None:
    """Store index, card, places, checksums and record together, in place of those of an earlier run; tell them."""
    from data_schemas.storage import MANIFEST_NAME, ProductSet, manifest_text, write_record
    from finray_calib.exchange import dataset_card, index_csv, index_parquet
    from sim.studies import pixel_places_mm

    record, parquet = _dataset_record(task, presses, shards, failures), index_parquet(shards)
    contents = {CARD_NAME: dataset_card(record, task.origin, parquet is not None), INDEX_NAME: index_csv(shards)}
    contents |= {PLACES_NAME: _npy(pixel_places_mm(task))} | ({} if parquet is None else {"index.parquet": parquet})
    for name in (DATASET_NAME, *contents, "index.parquet", MANIFEST_NAME):
        (out / name).unlink(missing_ok=True)  # made again from the shards, which are what is kept
    with ProductSet(out / DATASET_NAME) as products:
        for name, content in contents.items():
            products.add(out / name, content)
        digests = {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}
        products.add(out / MANIFEST_NAME, manifest_text(out, digests))
        write_record(record, out / DATASET_NAME, task.origin, products)
    _report_dataset(record, out)


def _dataset_record(
    task: "DatasetTask", presses: int, shards: "Sequence[DatasetShard]", failures: "Sequence[DatasetFailure]"
) -> "LearningDataset":
    """Return the record of a data set."""
    from data_schemas import DatasetShardRow, LearningDataset
    from sim.experiments import REST_LEVEL
    from sim.studies import shard_file

    files = [shard_file(task.folder, shard.number) for shard in shards]
    samples = [sample for shard in shards for sample in shard.samples]
    parts = {sample.press: sample.split for sample in samples}
    rows = [
        DatasetShardRow(file=f"shards/{file.name}", sha256=shard.sha256, samples=len(shard.samples))
        for file, shard in zip(files, shards, strict=True)
    ]
    analytic = ("no force and no mechanics: the analytic press is the indenter's shape with a bulge around it",)
    return LearningDataset(
        name=task.folder.name,
        plan=task.plan,
        paints=dict(task.sources),
        presses=presses,
        samples=len(samples),
        rest_level_rel=REST_LEVEL,
        split_presses={part: sum(1 for p in parts.values() if p == part) for part in ("train", "validation", "test")},
        shards=tuple(rows),
        failures=tuple(failures),
        processor_s=sum(shard.processor_s for shard in shards),
        sample_bytes=sum(file.stat().st_size for file in files) // len(samples),
        notes=(*(analytic if task.plan.press == "analytic" else ()), *_DATASET_NOTES),
    )


def _npy(array: "NDArray[np.float64]") -> bytes:
    """Return an array as NPY."""
    import numpy as np

    stream = io.BytesIO()
    np.save(stream, array.astype(np.float32), allow_pickle=False)
    return stream.getvalue()


def _report_dataset(record: "LearningDataset", out: Path) -> None:
    """Say what a data set holds and what it took."""
    wrote(out, f"{len(record.shards)} shards, {INDEX_NAME}, {CARD_NAME}, {PLACES_NAME}, {DATASET_NAME}")
    give(
        name=record.name, samples=record.samples, split_presses=record.split_presses, failures=record.failures,
        processor_s=record.processor_s, sample_bytes=record.sample_bytes,
    )  # fmt: skip
    parts = ", ".join(f"{count} {part}" for part, count in record.split_presses.items())
    say(f"{record.samples} samples; presses: {parts}")
    say(
        f"{record.processor_s / record.samples:.2g} s of processor time and {record.sample_bytes / 1e6:.2g} "
        "MB for each sample"
    )
    for failure in record.failures:
        say(f"press {failure.press} failed: {failure.reason}")
    suggest_file(out / CARD_NAME)


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
    from finray_calib.exchange import parquet_table, study_netcdf
    from finray_calib.reports.studies import design_study_page, study_pictures_webp

    page = design_study_page(result, points, origin.command, origin.input_sha256, origin.package_version)
    made = {
        TABLE_NAME: table_csv(result).encode(),
        PAGE_NAME: page.encode(),
        PARQUET_NAME: parquet_table(_table_rows(result)),
        NETCDF_NAME: study_netcdf(result),
        PICTURES_NAME: study_pictures_webp(points),
    }
    for name in (RESULT_NAME, *made):  # those of an earlier run, once all that takes their place is made
        (out / name).unlink(missing_ok=True)
    with ProductSet(out / RESULT_NAME) as products:
        for name, content in made.items():
            if content is not None:
                products.add(out / name, content)
        write_record(result, out / RESULT_NAME, origin, products)


def table_csv(result: "StudyResult") -> str:
    """Return one row a point: number, what was changed, and each metric with its limits."""
    rows = _table_rows(result)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _table_rows(result: "StudyResult") -> "list[dict[str, DesignValue | None]]":
    """Return the rows of the table, all with the same columns."""
    names = list(dict.fromkeys(metric.name for row in result.points for metric in row.metrics))
    rows = []
    for row in result.points:
        metrics = {metric.name: metric for metric in row.metrics}
        numbers = {
            f"{name}{end}": value
            for name in names
            for end, value in zip(("", "_low95", "_high95"), _three(metrics.get(name)), strict=True)
        }
        rows.append({"point": row.number, **{field: row.changes[field] for field in result.varied}, **numbers})
    return rows


def _three(metric: "StudyMetric | None") -> tuple[float | None, float | None, float | None]:
    """Return a number and its limits; None where they are not known."""
    return (None, None, None) if metric is None else (metric.value, metric.low95, metric.high95)


def show_study(arguments: argparse.Namespace) -> None:
    """Show the table of a study."""
    _tell(_stored_study(arguments.study))
    if (arguments.study / PAGE_NAME).exists():
        suggest_file(arguments.study / PAGE_NAME)


def compare_studies(arguments: argparse.Namespace) -> None:
    """Show what two studies differ by."""
    from data_schemas import RecordError
    from finray_calib.reports.studies import study_differences, study_differences_text

    first, second = _stored_study(arguments.first), _stored_study(arguments.second)
    differences = study_differences(first, second)
    if not differences:
        raise RecordError(
            f"{arguments.first}, {arguments.second}: the two studies have no result of a point in common, because the "
            f"first changes {', '.join(first.varied)} and the second {', '.join(second.varied)}; give two studies "
            "whose plans share points"
        )
    alone = {
        name: [row.changes for row in study.points if row.changes not in [other.changes for other in beside.points]]
        for name, study, beside in (("only_first", first, second), ("only_second", second, first))
    }
    give(first=first.name, second=second.name, differences=differences, **alone)
    say(study_differences_text(differences))
    apart, judged = (sum(1 for d in differences if d.is_apart in wanted) for wanted in ((True,), (True, False)))
    say(f"{apart} of {judged} numbers with limits differ, at 95 % for all numbers together")
    for name, rows in alone.items():
        if rows:
            say(f"points in the {name.removeprefix('only_')} study only: {len(rows)}")
    if (arguments.second / PAGE_NAME).exists():
        suggest_file(arguments.second / PAGE_NAME)


def _stored_study(folder: Path) -> "StudyResult":
    """Return the result of a study by its folder."""
    from data_schemas import RecordError, StudyResult
    from data_schemas.storage import read_record

    if not (folder / RESULT_NAME).exists():
        raise RecordError(f"{folder}: holds no {RESULT_NAME}; give the folder that 'finray study run' wrote")
    return read_record(folder / RESULT_NAME, StudyResult)
