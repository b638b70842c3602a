"""``finray design optimise``, ``tolerances``, ``assess``: the best numbers of a sensor and their limits.

``assess`` finds light angle, tolerances and stiffness of a finger by one command.
"""

import argparse
import functools
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from finray_calib.cli._output import give, progress_bar, say, suggest_command, suggest_file, warn, wrote
from finray_calib.cli._run import (
    add_engine,
    add_paint,
    add_paints_as_given,
    add_seed,
    both_paint_files,
    command_line,
    file_name,
    input_digests,
    naming,
    new_page_beside,
    open_engine,
    paint_files,
    require_folder,
    require_new,
    whole_number,
    with_files_found_from,
)
from finray_calib.cli._study_run import calibrated_paints, stand_in_paints

if TYPE_CHECKING:
    from data_schemas import (
        DesignObjective,
        DesignOptimum,
        FingerDesign,
        FingerStiffness,
        FingerTolerances,
        LightAngleDecision,
        LightAngleSweep,
        Provenance,
        Record,
    )
    from sim.experiments import FingerEvaluator, LightMeasure, PaintDraws, ToleranceSettings

T = TypeVar("T", bound="Record")

OPTIMISE_HELP = "search the numbers of a finger, within limits, for the best design by your objectives"

OPTIMISE_DESCRIPTION = """\
Change the numbers of a finger within limits, and find the design that is best by the objectives that you name:

  normal-error       expected error of the sensed normal, over the pad
  evenness           evenness of the light on the coat without contact
  brightness         brightness of the coat without contact
  softness           how far the finger gives way under the pad
  bending-stiffness  stiffness against a force at the tip
  twist-stiffness    stiffness against a turn of the tip

A third of the evaluations (or --screen of them) screens the limits (Sobol' points); an emulator proposes the others one
by one. The design of the best expected value is recommended. It is compared with the start and with the best design of
the screening, with random seeds and at contact places that the search has not used. With several objectives (--and) 1 %
of one counts as 1 % of another, and the page shows the front: the best compromises, and which differences are real.

Each evaluation is stored as soon as it is finished: the same command continues where it was interrupted. Writes into
the folder: evaluations/, the recommended finger (TOML), optimum.json and optimum.html. Where the powers of the panels
are varied, their sum stays constant."""

OPTIMISE_EPILOG = """\
examples:
  finray design optimise flat-70x35 --for normal-error
  finray design optimise my.toml --for normal-error --and softness
      --within light.angle_deg=0:60 --within skeleton.rib_thickness_mm
      --within "light.position_mm[y]=-14:-7" --evaluations 80"""

OPTIMUM_NAME, OPTIMUM_PAGE_NAME, EVALUATIONS = "optimum.json", "optimum.html", "evaluations"

TOLERANCES_HELP = "how far light, camera, mirror, pad and paints may vary before the sensed normal gets worse"

TOLERANCES_DESCRIPTION = """\
Find how far a finger may vary before the expected error of its sensed normals has grown by a tenth (--allowed): each
number alone, by evaluating it, and all together, by an emulator of the error; and which numbers contribute most to the
variance (Sobol' indices). It is the same error that 'finray decide' decides on. Limits are evaluated once more with
other paths, paint draws and noise.

What varies: what a person mounts, casts or mixes (angle and place of the light, pose of the camera, bow of the mirror,
thickness of the pad, yield of the paints), the emission of the paints (within its calibrated uncertainty), and every
number of the design with an uncertainty_rel that light depends on. Half-ranges that you do not give are assumed; the
page says so. A ready-made finger takes some 8 minutes of processor time.
--vary FIELD=HALF_RANGE gives one in the field's own unit, --vary FIELD=0 leaves a number out. For a place, FIELD ends
with the axis, as in camera.position_mm.z.

By default each finger is calibrated as it was built. With --calibration shared all take the calibration of the finger
as drawn, which shows how well one calibration works for other fingers of the same drawing."""

TOLERANCES_EPILOG = """\
examples:
  finray design tolerances flat-70x35 --paint red=red.paint.json --paint green=green.paint.json
  finray design tolerances finger.toml --paint red=r.json --paint green=g.json --vary light.angle_deg=1 \\
      --vary camera.position_mm.z=0.2 --calibration shared"""

ASSESS_HELP = "light angle, tolerances and stiffness of a finger, also one with another size of pad, by one command"
ASSESS_DESCRIPTION = """\
Find what a designer needs to know first about a finger:

  light angle  the decision by the error of the sensed normal at six places
               along the pad, and the brightness around five contacts
  tolerances   how far the finger with that light may vary before the error
               has grown by a tenth, for contacts along the pad
  stiffness    against forces at tip and pad and a twist, also with each assumed dimension changed by 20 %

--pad gives the pad another size: mirror and camera follow it, panels, tip and backing move with its length.
The folder then holds the finger with the chosen light (TOML), the records and pages of 'finray decide' and 'finray
design tolerances', the table of 'finray study finger-stiffness', and one page with the numbers of all.

Each part is stored as soon as it is finished: the same command continues where it was interrupted.

--quick takes fewer paths and fingers, and does not change the assumed dimensions of the skeleton: a first result in a
third of the time. Everything is simulated: no finger was built."""
ASSESS_EPILOG = """\
examples:
  finray design assess flat-70x35 --pad 60x30 --paint red=red.paint.json --paint green=green.paint.json
  finray design assess finger.toml --paint red=r.json --paint green=g.json --quick"""
ASSESSMENT_PAGE, ASSESSED_FROM = "assessment.html", "computed-from.sha256"
_ANGLES_DEG = tuple(float(angle) for angle in range(-60, 121, 10))
_PLACES_REL = (0.12, 0.3, 0.5, 0.7, 0.88)
_PERCENT_CHANGE = 0.2
_MOST_EVALUATIONS = 1000


def add_assess(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray design assess``."""
    assess = actions.add_parser("assess", help=ASSESS_HELP, description=ASSESS_DESCRIPTION, epilog=ASSESS_EPILOG)
    assess.add_argument("design", type=Path, metavar="FINGER", help="finger design (TOML), or the name of a preset")
    assess.add_argument("--pad", type=_pad_size, metavar="LENGTHxWIDTH", help="pad size in mm, in place of "
                        "the design's, such as 60x30")  # fmt: skip
    add_paint(assess)
    add_paints_as_given(assess)
    assess.add_argument(
        "--quick",
        action="store_true",
        help="give a first result, from fewer light paths and fingers with drawn tolerances, with the assumed "
        "dimensions unchanged",
    )
    add_engine(assess, is_scalar_enough=False)
    assess.add_argument("--out", type=Path, metavar="DIR", help="default: NAME.assessed")
    add_seed(assess)
    assess.set_defaults(run=run_assess, vary=[], places_mm=[], calibration="own")


def _pad_size(text: str) -> tuple[float, float]:
    """Parse LENGTHxWIDTH."""
    length, _, width = text.partition("x")
    try:
        size = float(length), float(width)
    except ValueError:
        size = (0.0, 0.0)
    if not all(0.0 < side < float("inf") for side in size):
        raise argparse.ArgumentTypeError(f"{text!r} must be LENGTHxWIDTH of the pad in mm, such as 60x30")
    return size


def add_optimise(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray design optimise``."""
    search = actions.add_parser(
        "optimise", help=OPTIMISE_HELP, description=OPTIMISE_DESCRIPTION, epilog=OPTIMISE_EPILOG
    )
    search.add_argument("design", type=Path, metavar="FINGER", help="finger design (TOML), or the name of a preset")
    search.add_argument("--for", dest="first", required=True, metavar="OBJECTIVE", help="the first objective")
    search.add_argument("--and", dest="further", action="append", default=[], metavar="OBJECTIVE",
                        help="a further objective (repeatable)")  # fmt: skip
    search.add_argument(
        "--within", action="append", default=[], metavar="FIELD[=LOW:HIGH]",
        help="number of the design to vary, and its limits (repeatable; default: light angle and place, pad "
             "thickness, and ribs and fin if stiffness is an objective)",
    )  # fmt: skip
    search.add_argument("--evaluations", type=whole_number(1, _MOST_EVALUATIONS), default=60, metavar="N",
                        help="designs to compute (default: 60)")  # fmt: skip
    search.add_argument("--screen", type=whole_number(1, _MOST_EVALUATIONS), metavar="N",
                        help="evaluations that screen the limits, without the emulator (default: a third)")  # fmt: skip
    search.add_argument("--confirm", type=_confirmation_count, default=6, metavar="N",
                        help="new seeds and contact places to confirm the gain (default: 6; 0 for none)")  # fmt: skip
    add_paint(search)
    add_paints_as_given(search)
    add_engine(search, is_scalar_enough=False)
    search.add_argument("--out", type=Path, metavar="DIR", help="folder of the search (default: NAME.optimised)")
    add_seed(search)
    search.set_defaults(run=run_optimise)


def _confirmation_count(text: str) -> int:
    """Parse a number of confirmations: an interval needs three."""
    if not text.isdecimal() or not (int(text) == 0 or 3 <= int(text) <= 100):
        raise argparse.ArgumentTypeError(f"{text!r} must be 0, or a whole number from 3 to 100")
    return int(text)


def run_optimise(arguments: argparse.Namespace) -> None:
    """Search designs within limits; store the recommended finger, the search and its page."""
    from data_schemas import SimulateError, provenance
    from data_schemas.storage import clear_leftovers
    from finray_calib.decide import design_optimum
    from sim import given_design
    from sim.experiments import (
        DesignEvaluations,
        DesignSpace,
        confirmed_losses,
        default_parameters,
        design_parameter,
        is_of_light,
        search_designs,
    )

    objectives = _objectives([arguments.first, *arguments.further])
    design, files, folder = given_design(arguments.design)
    parameters = tuple(design_parameter(design, text) for text in arguments.within)
    parameters = parameters or default_parameters(design, objectives)
    if len({one.field for one in parameters}) < len(parameters):
        raise SimulateError("--within: a field is given twice; give each field once")
    out = require_folder(arguments.out or Path(f"{file_name(design.name)}.optimised"))
    light: LightMeasure | None = None
    paints: list[Path] = []
    if any(is_of_light(one) for one in objectives):
        light, paints = light_measure(arguments, design, folder)
    origin = provenance(command_line(), input_digests([*files, *paints]), arguments.seed)
    out.mkdir(parents=True, exist_ok=True)
    for kept in (out, out / EVALUATIONS):
        clear_leftovers(kept)
    evaluations = DesignEvaluations(out / EVALUATIONS, objectives, origin, light)
    with naming(SimulateError, arguments.design), progress_bar(f"search of {design.name}") as progress:
        searched = search_designs(
            DesignSpace(design, parameters), objectives, evaluations.evaluate, arguments.evaluations, arguments.seed,
            progress, arguments.screen,
        )  # fmt: skip
        compared = [searched.evaluated[k].design for k in (0, searched.screen_best, -1)]
        again = confirmed_losses(compared, objectives, evaluations, arguments.confirm, progress)
    notes = () if light is None else tuple(f"{colour} paint: {where}" for colour, where in light.sources.items())
    optimum = design_optimum(searched, again, arguments.seed, notes)
    finger = _store_optimum(out, optimum, origin, folder)
    _report_optimum(optimum)
    wrote(finger, "the recommended finger")
    wrote(out, f"{OPTIMUM_NAME}, {OPTIMUM_PAGE_NAME} and {EVALUATIONS}/ ({evaluations.computed} computed now)")
    suggest_command("finray design export", finger)
    suggest_file(out / OPTIMUM_PAGE_NAME)


def _objectives(names: Sequence[str]) -> "tuple[DesignObjective, ...]":
    """Return the objectives of these names."""
    from data_schemas import SimulateError
    from sim.experiments import OBJECTIVES

    for name in names:
        if name not in OBJECTIVES:
            raise SimulateError(f"--for, --and: unknown objective '{name}'; valid names are {', '.join(OBJECTIVES)}")
        if names.count(name) > 1:
            raise SimulateError(f"--for, --and: '{name}' is given twice; give each objective once")
    return tuple(OBJECTIVES[name] for name in names)


def light_measure(
    arguments: argparse.Namespace, design: "FingerDesign", folder: Path
) -> "tuple[LightMeasure, list[Path]]":
    """Return what light is measured with, and the files of the paints and of the camera."""
    import numpy as np

    from data_schemas import PaintCalibration
    from data_schemas.storage import camera_response, read_record
    from sim.experiments import EvaluationSettings, LightMeasure, PaintDraws, design_digests, read_design_files
    from sim.optics import read_calibration

    files = paint_files(arguments, without="the simulated rig's paints")
    optics, sources = calibrated_paints(files, arguments.paints_as_given) if files else stand_in_paints()
    if files:
        paints = {colour: PaintDraws.of(read_record(file, PaintCalibration)) for colour, file in files.items()}
    else:
        paints = {colour: PaintDraws(one, np.atleast_2d(one.emission_per_nm)) for colour, one in optics.items()}
    camera, named = design.camera, read_design_files(design, folder, ["camera"])
    return LightMeasure(
        response=camera_response(camera.response, folder),
        renderer=open_engine(arguments.engine, threads=1),
        paints=paints,
        sources=sources,
        settings=EvaluationSettings(seed=arguments.seed),
        calibration=None if camera.calibration is None else read_calibration(folder / camera.calibration),
        files=design_digests(design, folder, ["camera"]),
    ), [*files.values(), *named.values()]


def _store_optimum(out: Path, optimum: "DesignOptimum", origin: "Provenance", folder: Path) -> Path:
    """Store finger, page and search together, in place of those of an earlier run; return the finger's file."""
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.reports.studies import optimum_page
    from sim import design_toml

    finger = out / f"{file_name(optimum.design.name)}.toml"
    for file in (out / OPTIMUM_NAME, out / OPTIMUM_PAGE_NAME, finger):  # made again from the kept evaluations
        file.unlink(missing_ok=True)
    page = optimum_page(optimum, origin.command, origin.input_sha256, origin.package_version)
    with ProductSet(out / OPTIMUM_NAME) as products:
        products.add(finger, design_toml(with_files_found_from(out, optimum.design, folder)).encode())
        products.add(out / OPTIMUM_PAGE_NAME, page.encode())
        write_record(optimum, out / OPTIMUM_NAME, origin, products)
    return finger


def _report_optimum(optimum: "DesignOptimum") -> None:
    """Tell what was found."""
    from finray_calib.reports.studies import front_rows

    say(optimum.sentence)
    for one in optimum.gains:
        confirmed = ""
        if one.confirmed_rel is not None and one.confirmed_95_rel is not None:
            low, high = one.confirmed_95_rel
            confirmed = f", confirmed {100 * one.confirmed_rel:+.1f} % ({100 * low:+.1f} % to {100 * high:+.1f} %)"
        say(f"  {one.objective} compared with the {one.against}: in the search {100 * one.seen_rel:+.1f} %{confirmed}")
    front = front_rows(optimum)
    if len(optimum.objectives) > 1:
        say(f"  on the front: {len(front)} of {len(optimum.designs)} designs")
    give(
        sentence=optimum.sentence, objectives=optimum.objectives, parameters=optimum.parameters,
        chosen=optimum.designs[optimum.chosen - 1], gains=optimum.gains, front=front,
        regret_rel=optimum.regret_rel, regret_95_rel=optimum.regret_95_rel,
    )  # fmt: skip


def add_tolerances(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    tolerances = actions.add_parser(
        "tolerances", help=TOLERANCES_HELP, description=TOLERANCES_DESCRIPTION, epilog=TOLERANCES_EPILOG
    )
    tolerances.add_argument("design", type=Path, metavar="FINGER", help="finger design (TOML), or the name of a preset")
    add_paint(tolerances)
    add_paints_as_given(tolerances)
    tolerances.add_argument("--vary", type=_half_range, action="append", default=[], metavar="FIELD=HALF_RANGE",
        help="amount by which a number varies to either side, such as light.angle_deg=2 (repeatable)")  # fmt: skip
    tolerances.add_argument(
        "--contact", type=float, action="append", default=[], metavar="MM", dest="places_mm",
        help="middle of a contact along the pad, mm (repeatable; default: six from a tenth to nine tenths of the pad)",
    )  # fmt: skip
    tolerances.add_argument("--allowed", type=float, default=0.1, metavar="SHARE",
                            help="largest allowed growth of the error, as a share (default: 0.1)")  # fmt: skip
    tolerances.add_argument("--calibration", choices=["own", "shared"], default="own", help="calibrate each finger as "
        "it was built (own), or use the calibration of the finger as drawn for all (shared)")  # fmt: skip
    tolerances.add_argument("--runs", type=int, default=128, metavar="N",
                            help="number of fingers in which all numbers vary together (default: 128)")  # fmt: skip
    tolerances.add_argument("--samples", type=whole_number(1, 10**6), default=1024, metavar="N",
                            help="light paths per point and repeat (default: 1024, 1.4 to 3.6 s a finger)")  # fmt: skip
    add_engine(tolerances, is_scalar_enough=False)
    tolerances.add_argument("--out", type=Path, metavar="JSON", help="default: NAME.tolerances.json; must be new")
    add_seed(tolerances)
    tolerances.set_defaults(run=run_tolerances)


def _half_range(text: str) -> tuple[str, float]:
    """Parse FIELD=HALF_RANGE."""
    field, _, size = text.partition("=")
    try:
        return field, float(size)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} must be FIELD=HALF_RANGE, such as light.angle_deg=2 (in the field's own unit)"
        ) from None


def run_tolerances(arguments: argparse.Namespace) -> None:
    """Find a finger's tolerances; store them with their page."""
    from data_schemas import SimulateError, provenance
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.reports.studies import tolerance_page
    from sim import given_design
    from sim.experiments import ToleranceSettings, read_design_files

    if len(dict(arguments.vary)) < len(arguments.vary):
        raise SimulateError("--vary: a field is given twice; give each field once")
    design, files, folder = given_design(arguments.design)
    files = [*files, *read_design_files(design, folder, ["camera"]).values()]
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.tolerances.json"), ".json")
    page = new_page_beside(out)
    paint_paths = both_paint_files(arguments)
    paints = _paint_draws(paint_paths, arguments.paints_as_given)
    settings = ToleranceSettings(arguments.allowed, arguments.runs, arguments.seed)
    with naming(SimulateError, arguments.design):
        record = _tolerances(arguments, design, folder, paints, settings)
    inputs = input_digests([*files, *paint_paths.values()])
    with ProductSet(out) as products:
        products.add(page, tolerance_page(record, command_line(), inputs).encode())
        write_record(record, out, provenance(command_line(), inputs, arguments.seed), products)
    say(record.sentence)
    for line in _tolerance_table(record):
        say(line)
    wrote(out, "limits, shares and all runs")
    wrote(page, "the tolerances, for the person who builds the finger")
    give(
        sentence=record.sentence, rows=record.rows, nominal_error_deg=record.nominal_error_deg,
        together_factor=record.together_factor, together_low95=record.together_low95,
        together_high95=record.together_high95, within_given_share=record.within_given_share, q2=record.q2,
        calibration=record.calibration,
    )  # fmt: skip
    suggest_file(page)


def _tolerances(
    arguments: argparse.Namespace,
    design: "FingerDesign",
    folder: Path,
    paints: "dict[str, PaintDraws]",
    settings: "ToleranceSettings",
) -> "FingerTolerances":
    """Return the tolerances of a finger."""
    from sim.experiments import FingerError, study_tolerances, tolerance_inputs

    varied = tolerance_inputs(design, paints, dict(arguments.vary))
    evaluators = _evaluators(design, folder, arguments)
    error = FingerError(evaluators, design, paints, arguments.calibration)
    with progress_bar(f"tolerances of {design.name}") as progress:
        found = study_tolerances(error, design, paints, varied, settings, progress)
    digests = {colour: input_digests([file])[file.as_posix()] for colour, file in both_paint_files(arguments).items()}
    places = [float(place) for place in evaluators(arguments.seed).contact_places_mm(design)]
    return found.record(design, digests, varied, settings, places, arguments.calibration)


def _paint_draws(files: "Mapping[str, Path]", as_given: bool) -> "dict[str, PaintDraws]":
    """Return both paints with their draws, which must not look swapped."""
    from data_schemas import PaintCalibration
    from data_schemas.storage import read_record
    from sim.experiments import PaintDraws, require_paints_in_order

    paints = {colour: PaintDraws.of(read_record(file, PaintCalibration)) for colour, file in files.items()}
    if not as_given:
        modes_nm = {
            colour: float(one.optics.wavelength_nm[one.optics.emission_per_nm.argmax()])
            for colour, one in paints.items()
        }
        require_paints_in_order(modes_nm, {colour: str(file) for colour, file in files.items()}, "--paints-as-given")
    return paints


def _evaluators(
    design: "FingerDesign", folder: Path, arguments: argparse.Namespace
) -> "Callable[[int], FingerEvaluator]":
    """Return what opens an evaluator of fingers for a seed."""
    from data_schemas.storage import camera_response
    from sim.experiments import EvaluationSettings, FingerEvaluator
    from sim.optics import read_calibration

    camera = design.camera
    response, engine = camera_response(camera.response, folder), open_engine(arguments.engine)
    calibration = None if camera.calibration is None else read_calibration(folder / camera.calibration)

    def opened(seed: int) -> "FingerEvaluator":
        settings = EvaluationSettings(tuple(arguments.places_mm), arguments.samples, seed=seed)
        return FingerEvaluator(response, engine, settings, calibration)

    return opened


def _tolerance_table(record: "FingerTolerances") -> list[str]:
    """Return the lines of the table: limits alone and shares of the variance."""
    from finray_calib.reports import aligned_lines
    from finray_calib.reports.studies import limit_text

    head = ("number", "drawn", "less by", "more by", "assumed or given", "share of variance", "")
    rows = [
        (
            row.field,
            f"{row.nominal:.4g}",
            limit_text(row.less, row.unit),
            limit_text(row.more, row.unit),
            f"{row.given:.3g}",
            f"{row.total.estimate:.2f} [{row.total.low95:.2f}, {row.total.high95:.2f}]",
            "" if row.is_distinguishable else "not distinguishable from 0",
        )
        for row in record.rows
    ]
    return aligned_lines(head, rows)


def run_assess(arguments: argparse.Namespace) -> None:
    """Decide on the light of a finger, then find the tolerances and the stiffness of the finger with that light."""
    from data_schemas import FingerStiffness, FingerTolerances, LightAngleDecision, SimulateError, provenance
    from data_schemas.storage import write_bytes
    from finray_calib.reports import assessment_page, decision_page, finger_outline
    from finray_calib.reports.studies import tolerance_page
    from sim import design_toml, given_design, with_pad_size
    from sim.experiments import ToleranceSettings, read_design_files

    design, files, folder = given_design(arguments.design)
    files = [*files, *read_design_files(design, folder).values()]
    design = design if arguments.pad is None else with_pad_size(design, *arguments.pad)
    paint_paths = both_paint_files(arguments)
    paints = _paint_draws(paint_paths, arguments.paints_as_given)  # what is wrong with them is told before any work
    inputs = input_digests([*files, *paint_paths.values()])
    origin = provenance(command_line(), inputs, arguments.seed)
    arguments.samples = 256 if arguments.quick else 1024
    settings = ToleranceSettings(runs=96 if arguments.quick else 128, seed=arguments.seed)
    with naming(SimulateError, arguments.design):
        finger_outline(design, folder)  # parts that do not fit are told before any work
        of = _computed_from(arguments, design, files, paint_paths)
        parts = _AssessedParts(arguments.out or Path(f"{file_name(design.name)}.assessed"), origin, of)
        sweeps = _swept(arguments, design, folder, paint_paths, parts)
        decision = parts.part(
            "light-angle-decision", LightAngleDecision, lambda: _decided(sweeps, arguments.seed),
            lambda found: decision_page(found, sweeps, command_line(), inputs),
        )  # fmt: skip
        light = design.light.model_copy(update={"angle_deg": decision.angle_deg})
        design = design.model_copy(update={"light": light})
        if not (parts.out / "finger.toml").exists():
            write_bytes(
                parts.out / "finger.toml", design_toml(with_files_found_from(parts.out, design, folder)).encode()
            )
        tolerances = parts.part(
            "tolerances", FingerTolerances, lambda: _tolerances(arguments, design, folder, paints, settings),
            lambda found: tolerance_page(found, command_line(), inputs),
        )  # fmt: skip
        stiffness = parts.part("finger-stiffness", FingerStiffness, lambda: _stiffness(arguments, design))
    parts.warn_of_other_code()
    page = assessment_page(decision, tolerances, stiffness, command_line(), inputs)
    write_bytes(parts.out / ASSESSMENT_PAGE, page.encode())
    _report_assessment(decision, tolerances, stiffness)
    wrote(parts.out, "finger.toml with the light that was chosen, records and pages of each part")
    suggest_file(parts.out / ASSESSMENT_PAGE)


def _computed_from(
    arguments: argparse.Namespace, design: "FingerDesign", files: Sequence[Path], paints: "Mapping[str, Path]"
) -> "dict[str, object]":
    """Return by its role what all parts of an assessment are computed from; of files their SHA-256."""
    return {
        "design": design.model_dump(mode="json", exclude={"provenance"}),
        "files": [digest for file in files for digest in input_digests([file]).values()],
        "paints": {colour: digest for colour, file in paints.items() for digest in input_digests([file]).values()},
        **{name: getattr(arguments, name) for name in ("seed", "quick", "engine", "paints_as_given")},
    }


class _AssessedParts:
    """The parts of an assessment: each is stored once it is computed, and read back when the command is given again.

    The folder holds the SHA-256 of what all parts are computed from, so that an assessment of something else does not
    continue there.
    """

    def __init__(self, out: Path, origin: "Provenance", computed_from: "Mapping[str, object]") -> None:
        from data_schemas import RecordError
        from data_schemas.storage import clear_leftovers, read_text, write_bytes

        self.out, self._origin = require_folder(out), origin
        self._other_code: dict[str, str] = {}
        key = hashlib.sha256(json.dumps(computed_from, sort_keys=True).encode()).hexdigest()
        clear_leftovers(out)
        stored = out / ASSESSED_FROM
        if (out / ASSESSMENT_PAGE).exists() or (out.exists() and any(out.iterdir()) and not stored.exists()):
            what = "a finished assessment" if stored.exists() else "something other than an assessment"
            raise RecordError(f"{out}: contains {what}, which is not overwritten; choose another --out or move it away")
        if not stored.exists():
            write_bytes(stored, f"{key}\n".encode())
        elif read_text(stored, "the SHA-256 of an assessment's inputs").strip() != key:
            raise RecordError(
                f"{out}: contains an unfinished assessment that was started with another finger, pad, paint, seed, "
                "--engine, --quick or --paints-as-given; repeat the original command, or choose another --out"
            )
        elif kept := sum(1 for _ in out.glob("*.json")):
            say(f"{out}: continues; {kept} finished parts are kept")

    def part(self, name: str, kind: type[T], compute: Callable[[], T], page: Callable[[T], str] | None = None) -> T:
        """Return the record of a part, computed and stored with its page unless it is there."""
        from data_schemas.storage import ProductSet, read_record, write_record

        file = self.out / f"{name}.json"
        if file.exists():
            kept = read_record(file, kind)
            if kept.provenance is not None and kept.provenance.code != self._origin.code:
                self._other_code[name] = kept.provenance.code
            return kept
        record = compute()
        with ProductSet(file) as products:
            if page is not None:
                products.add(file.with_suffix(".html"), page(record).encode())
            write_record(record, file, self._origin, products)
        return record

    def warn_of_other_code(self) -> None:
        """Warn of parts that another version or commit computed."""
        other = "; ".join(f"{name} by {code}" for name, code in self._other_code.items())
        if other:
            warn(f"parts computed by other code than the present code ({self._origin.code}) are kept: {other}. To "
                 "compute them again, choose another --out")  # fmt: skip


def _swept(
    arguments: argparse.Namespace,
    design: "FingerDesign",
    folder: Path,
    paints: "Mapping[str, Path]",
    parts: _AssessedParts,
) -> "list[LightAngleSweep]":
    """Sweep the light's angle around contacts at five places; the first tells the error of the normal over the pad."""
    from data_schemas import LightAngleSweep

    return [
        parts.part(
            f"{share * design.pad.length_mm:04.1f}mm.sweep",
            LightAngleSweep,
            functools.partial(_sweep, arguments, with_files_found_from(None, design, folder), paints, number),
        )
        for number, share in enumerate(_PLACES_REL)
    ]


def _sweep(
    arguments: argparse.Namespace, design: "FingerDesign", paints: "Mapping[str, Path]", number: int
) -> "LightAngleSweep":
    """Sweep the light's angle at one of the places."""
    from finray_calib import sweep_light_angle

    place_mm = round(_PLACES_REL[number] * design.pad.length_mm, 1)
    with progress_bar(f"light at {place_mm:g} mm, place {number + 1} of {len(_PLACES_REL)}") as progress:
        return sweep_light_angle(
            design, _ANGLES_DEG, red=paints["red"], green=paints["green"], seed=arguments.seed, progress=progress,
            samples=2000 if arguments.quick else 4000, engine=arguments.engine,
            paints_as_given=arguments.paints_as_given, all_objectives=number == 0, position_mm=place_mm,
        )  # fmt: skip


def _decided(sweeps: "Sequence[LightAngleSweep]", seed: int) -> "LightAngleDecision":
    """Decide on the light angle."""
    from finray_calib.decide import decide

    return decide(sweeps, [], seed)


def _stiffness(arguments: argparse.Namespace, design: "FingerDesign") -> "FingerStiffness":
    """Load the finger, and with its assumed dimensions changed."""
    from finray_calib.spectra import machine_threads
    from sim.experiments import study_finger_stiffness

    with progress_bar(f"stiffness of {design.name}") as progress:
        share = 0.0 if arguments.quick else _PERCENT_CHANGE
        return study_finger_stiffness([design], share, machine_threads(), progress)


def _report_assessment(
    decision: "LightAngleDecision", tolerances: "FingerTolerances", stiffness: "FingerStiffness"
) -> None:
    """Tell what was found."""
    from finray_calib.reports import stiffness_rows

    say(f"Light: {decision.headline}")
    say(f"Tolerances: {tolerances.sentence}")
    for name, value, limits, _ in stiffness_rows(stiffness):
        say(f"Stiffness, {name}: {value}{limits and f' ({limits})'}")
    give(
        angle_deg=decision.angle_deg, tolerance_deg=decision.tolerance_deg, verdict=decision.verdict,
        headline=decision.headline, sentence=tolerances.sentence, rows=tolerances.rows,
        together_factor=tolerances.together_factor, within_given_share=tolerances.within_given_share,
        stiffness=stiffness.rows,
    )  # fmt: skip
