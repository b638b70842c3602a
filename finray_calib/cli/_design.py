"""``finray design``: write the design of a finger or sensor, look at it, print it, choose paints, filters and light."""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._design_search import add_assess, add_optimise, add_tolerances, light_measure
from finray_calib.cli._output import give, progress_bar, say, suggest_command, suggest_file, wrote
from finray_calib.cli._run import (
    add_engine,
    add_paint,
    add_paints_as_given,
    add_seed,
    command_line,
    file_name,
    input_digests,
    naming,
    new_page_beside,
    open_engine,
    path_count,
    require_new,
    with_files_found_from,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any

    import numpy as np
    from numpy.typing import NDArray

    from data_schemas import (
        FingerDesign,
        LightPlaceMap,
        LightPowers,
        Optics,
        PaintCalibration,
        PaintChoice,
        PlainSensor,
        Provenance,
        RigFile,
    )
    from finray_calib.decide import LightBasis
    from finray_calib.fit import CatalogueFilter
    from sim.experiments import LitFinger
    from sim.optics import Preference, Progress

    _Seen = tuple[str, dict[str, Any], Callable[[str], bytes]]
    """Remarks, further numbers for programs, and the drawing for an ending."""

HELP = "write a finger design; draw it, see its camera's view, print its parts, choose paints; choose a rig's filters"
DESCRIPTION = (
    "Write a design file to start from, and look at a finger or a classic sensor before anything is simulated."
)
INIT_DESCRIPTION = "Write the design of a ready-made finger or classic sensor, with comments, to be edited."
SHOW_DESCRIPTION = """\
Report what part of the pad the camera sees through the mirror, how many sensor pixels fall on a millimetre, and what
else is in the picture. With --out FILE.png, draw the finger from the side and from the front, with the names of its
parts and their sizes, and the camera's view below. With --out FILE.html, write one page with that drawing, a finger
that can be turned in a browser, and all its numbers with their origin.

For a classic sensor the command also reports where its lights are and which numbers are published; the drawing is a
.png."""
EXPORT_DESCRIPTION = """\
Write the files from which a finger is printed, in mm and in the finger's axes (x across, y along the pad's outward
normal, z along the finger), so that the parts fit together:

  skeleton     fins, ribs and tip, one closed body
  base_plate   printed separately, because it is stiffer; --one-piece joins it to the skeleton (skeleton_and_base)
  backing      plate on the back fin, where the design has one
  mould        tray in which the pad is cast with its coat down; open where
               the inner face will be. The flange of the film that closes it
               lies on the rim. Walls are upright, without shrinkage allowance

STL is for slicers. STEP (AP214) is for CAD programs: it holds planes, and the exact cylinder or ellipsoid on the bottom
of the mould; curved fins are approximated by strips of 1 mm, within 0.3 um of their curve."""

PAINTS_HELP = "rank calibrated paints for a finger by the error of the sensed normal"
PAINTS_DESCRIPTION = """\
Rank every pair of paints, one on each wall, by the expected error of the normal that the finger would sense, before
anything is moulded. The error is that of a map from colour to normal at places of the pad that it has not seen,
with the noise of the camera ('held-out normal error' of 'finray simulate sweep --objectives all'), at the light angle
of the design. The uncertainty of the emission comes from the posterior draws of each calibration. All pairs share
paths, noise and draws. The last column says which pairs differ from the best one, at 95 % for all pairs together.

Light is traced once for all pairs; another pair costs a second. The intervals leave out the camera's response where it
is assumed, the reflectance of the paints, and how far the simulation is from a real finger, which all pairs share."""
PAINTS_EPILOG = """\
example:
  finray design paints flat-70x35 --paint a.paint.json --paint b.paint.json --paint c.paint.json"""
FILTERS_DESCRIPTION = """\
For a rig (TOML): choose the emission filters that give the smallest expected error of the emission spectrum of a paint,
from a catalogue, with the rig's own laser, lamp and camera, and fit simulated paints with these and with the rig's
filters. The filter at the laser stays; --keep CENTRE keeps another one of the rig, such as one below the laser, which
shows what the paint absorbs under the lamp.

For a paint (JSON, written by 'finray fit'): rank the filters by how much of the variance of its spectrum each would
remove.

A catalogue is a CSV file with the columns centre_nm, width_nm and peak_transmission (0 to 1); without one, plain
filters of 10, 25 and 40 nm every 10 nm from 450 to 720 nm are offered."""
_SHOWN_NEXT = 8
_DRAWINGS = (".png", ".html")


def add_design(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("design", help=HELP, description=DESCRIPTION)
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    names = actions.add_parser("list", help="list the ready-made fingers and classic sensors")
    names.set_defaults(run=run_list)
    _add_init(actions)
    _add_show(actions)
    _add_export(actions)
    _add_paints(actions)
    add_tolerances(actions)
    add_assess(actions)
    add_optimise(actions)
    add_lights(actions)
    _add_filters(actions)


def _add_init(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    init = actions.add_parser(
        "init",
        help="write a design to start from",
        description=INIT_DESCRIPTION,
    )
    init.add_argument(
        "preset",
        nargs="?",
        default="flat-70x35",
        metavar="PRESET",
        help="preset to write, as 'finray design list' lists them (default: flat-70x35)",
    )
    init.add_argument("--out", type=Path, metavar="TOML", help="default: PRESET.toml; must be new")
    init.set_defaults(run=run_init)


def _add_show(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    show = actions.add_parser("show", help="draw a design and its camera's view", description=SHOW_DESCRIPTION)
    show.add_argument("design", type=Path, metavar="DESIGN", help="design (TOML), or the name of a preset")
    add_engine(show)
    show.add_argument(
        "--out", type=Path, metavar="FILE", help="drawing (.png) or interactive page (.html); must be new"
    )
    show.set_defaults(run=run_show)


def _add_export(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    export = actions.add_parser(
        "export",
        help="write files to print skeleton, base plate, backing and the pad's mould (STL, STEP)",
        description=EXPORT_DESCRIPTION,
    )
    export.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML)")
    export.add_argument("--out", type=Path, metavar="FOLDER", help="default: NAME.print; must be new")
    export.add_argument("--format", choices=["stl", "step", "both"], default="both", help="default: both")
    export.add_argument("--one-piece", action="store_true", help="write skeleton and base plate as one body")
    export.add_argument(
        "--lining-mm",
        type=float,
        metavar="MM",
        help="thickness of the sheet on the mould's bottom (default: 0.1, the paper's Mylar; 0 for an ellipsoidal pad)",
    )
    export.set_defaults(run=run_export)


def _add_paints(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    paints = actions.add_parser("paints", help=PAINTS_HELP, description=PAINTS_DESCRIPTION, epilog=PAINTS_EPILOG)
    paints.add_argument("design", type=Path, metavar="FINGER", help="finger design (TOML), or the name of a preset")
    paints.add_argument(
        "--paint", type=Path, action="append", required=True, metavar="FILE",
        help="paint calibration written by 'finray fit' (give at least two)",
    )  # fmt: skip
    add_engine(paints, is_scalar_enough=False)
    paints.add_argument("--out", type=Path, metavar="JSON", help="default: NAME.paint-choice.json; must be new")
    add_seed(paints)
    paints.set_defaults(run=run_paints)


def _add_filters(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    filters = actions.add_parser(
        "filters",
        help="find the best emission filters of a rig, or the best next filter for a paint",
        description=FILTERS_DESCRIPTION,
    )
    filters.add_argument("source", type=Path, metavar="RIG_OR_PAINT", help="rig file (.toml) or fitted paint (.json)")
    filters.add_argument("--catalogue", type=Path, metavar="CSV", help="filters that can be bought")
    filters.add_argument(
        "--number", type=int, metavar="N", help="total number of filters (default: as many as the rig has)"
    )
    filters.add_argument(
        "--keep", type=float, action="append", default=[], metavar="CENTRE",
        help="centre in nm of a filter of the rig to keep (repeatable)",
    )  # fmt: skip
    filters.add_argument(
        "--paints", type=int, default=40, metavar="N", help="simulated paints to fit (default: 40; 0 for none)"
    )
    add_seed(filters)
    filters.set_defaults(run=run_filters)


def run_filters(arguments: argparse.Namespace) -> None:
    """Choose the filters of a rig, or rank the next one of a paint."""
    from data_schemas import FitError
    from data_schemas.storage import read_csv
    from finray_calib.fit import filter_catalogue, stock_catalogue

    if arguments.paints < 0:
        raise FitError(f"--paints {arguments.paints}: must be 0 or more")
    catalogue = stock_catalogue()
    if arguments.catalogue is not None:
        header, rows = read_csv(arguments.catalogue, "a catalogue of filters (CSV)", FitError, comments=True)
        catalogue = filter_catalogue(header, rows, str(arguments.catalogue))
    if arguments.source.suffix.lower() == ".json":
        _rank_next(arguments, catalogue)
    else:
        _choose_filters(arguments, catalogue)


def _rank_next(arguments: argparse.Namespace, catalogue: "tuple[CatalogueFilter, ...]") -> None:
    """Tell the filters that would tell most of a fitted paint."""
    from data_schemas import FitError, PaintCalibration
    from data_schemas.storage import read_record
    from finray_calib.fit import next_filters

    if arguments.number is not None or arguments.keep:
        raise FitError("--number and --keep are only for a rig (TOML), not for a paint (JSON); leave them out")
    paint = read_record(arguments.source, PaintCalibration)
    ranked = next_filters(paint, catalogue)
    give(paint_name=paint.paint_name, next_filters=ranked)
    say(
        f"filters that could be added for '{paint.paint_name}', and the share of the spectrum's variance that "
        "each would remove:"
    )
    for one in ranked[:_SHOWN_NEXT]:
        say(f"  {one.filter.centre_nm:5g} nm, {one.filter.width_nm:g} nm wide  {100 * one.reduction_rel:4.0f} %")


def _choose_filters(arguments: argparse.Namespace, catalogue: "tuple[CatalogueFilter, ...]") -> None:
    """Tell the filters of a designed rig and what they are worth."""
    from data_schemas import FitError, RigFile
    from data_schemas.storage import read_toml
    from finray_calib.fit import design_filters

    optics = _optics_of(read_toml(arguments.source, RigFile), arguments.source.parent)
    with progress_bar("design") as progress, naming(FitError, arguments.source):
        found = design_filters(
            optics, catalogue, arguments.number, arguments.keep, arguments.paints, arguments.seed, progress
        )
    give(
        filters=[
            {"centre_nm": band.center_nm, "width_nm": band.fwhm_nm, "kept": band.name in found.kept}
            for band in found.filters
        ],
        screened_error_rel=found.screened_rel, screened_error_rig_rel=found.screened_rig_rel, paints=len(found.errors),
        median_ratio=list(found.median_ratio), mean_ratio=list(found.mean_ratio),
    )  # fmt: skip
    say(f"{len(found.filters)} filters for '{arguments.source}':")
    for band in found.filters:
        say(
            f"  {band.center_nm:5g} nm, {band.fwhm_nm:g} nm wide"
            + ("  (of the rig)" if band.name in found.kept else "")
        )
    say(f"  screening: expected error {found.screened_rel:.3f}, with the rig's filters {found.screened_rig_rel:.3f}")
    for name, ratio in (("median", found.median_ratio), ("mean", found.mean_ratio)):
        if len(found.errors):
            say(
                f"  fits of {len(found.errors)} simulated paints: {name} error {ratio[0]:.2f} times that of the rig's "
                f"own filters (95 %: {ratio[1]:.2f} to {ratio[2]:.2f})"
            )


def _optics_of(rig: "RigFile", folder: Path) -> "Optics":
    """Return the curves of a rig; the filter closest to the laser is the one at it."""
    from data_schemas import Optics
    from data_schemas.storage import camera_response, lamp_curve, read_filter_curves

    filters = rig.filter_wheel.filters
    at_laser = min(filters, key=lambda band: abs(band.center_nm - rig.laser.wavelength_nm))
    return Optics(
        filters=filters,
        excitation_filter=at_laser.name,
        laser=rig.laser,
        lamp=lamp_curve(rig.lamp, folder),
        lamp_temperature_k=rig.lamp.temperature_k,
        lamp_temperature_uncertainty_k=rig.lamp.temperature_uncertainty_k,
        white_reference=rig.white_reference,
        band_uncertainty=rig.band_uncertainty,
        camera_response=camera_response(rig.camera.response, folder),
        filter_curves=read_filter_curves(filters, folder),
    )


def run_list(arguments: argparse.Namespace) -> None:
    """Tell the ready-made fingers and classic sensors."""
    from sim import PRESETS, SENSORS

    told = {name: what for presets in (PRESETS, SENSORS) for name, (what, _) in presets.items()}
    give(designs=told)
    width = max(map(len, told))
    for name, what in told.items():
        say(f"{name:{width}}  {what}")
    suggest_command("finray design init NAME")


def run_init(arguments: argparse.Namespace) -> None:
    """Write a design file."""
    from data_schemas import SimulateError
    from data_schemas.storage import write_bytes
    from sim import PRESETS, SENSORS, design_toml, preset_design, preset_sensor, sensor_toml

    name = arguments.preset
    if name not in PRESETS and name not in SENSORS:
        known = ", ".join([*PRESETS, *SENSORS])
        raise SimulateError(f"there is no preset design '{name}'; valid names are {known}")
    text = sensor_toml(preset_sensor(name)) if name in SENSORS else design_toml(preset_design(name))
    out = require_new(arguments.out or Path(f"{name}.toml"), ".toml")
    write_bytes(out, text.encode())
    wrote(out, "the design, to be edited")
    give(name=name)
    suggest_command("finray design show", out)


def run_show(arguments: argparse.Namespace) -> None:
    """Tell what the camera of a finger or classic sensor sees, and draw it."""
    from data_schemas import PlainSensor, SimulateError
    from data_schemas.storage import write_bytes

    design, _, folder = _finger_or_sensor(arguments.design)
    what, endings = ("sensor", (".png",)) if isinstance(design, PlainSensor) else ("finger", _DRAWINGS)
    out = None if arguments.out is None else _drawing_path(arguments.out, endings)
    with naming(SimulateError, arguments.design):
        if isinstance(design, PlainSensor):
            told, numbers, draw = _seen_by_sensor(design, folder, arguments.engine)
        else:
            told, numbers, draw = _seen_by_finger(design, folder, arguments.engine)
    say(told)
    give(name=design.name, **numbers)
    if out is None:
        suggest_command("finray design show", arguments.design, "--out", Path(f"{design.name}{endings[-1]}"))
        return
    write_bytes(out, draw(out.suffix.lower()))
    wrote(out, f"drawing of the {what}")
    suggest_file(out)


def _seen_by_finger(design: "FingerDesign", folder: Path, engine: "Preference") -> "_Seen":
    """Return what the camera of a finger sees."""
    from finray_calib.reports import finger_outline, finger_page, finger_page_png
    from sim.optics import camera_view

    def draw(ending: str) -> bytes:
        picture = finger_page_png(view, folder)
        return picture if ending == ".png" else finger_page(design, picture, str(view), folder).encode()

    finger_outline(design, folder)  # parts that do not fit are told before anything is shown
    view = camera_view(design, folder, open_engine(engine))
    scale_mm, scale_u_rel = view.mm_per_px
    numbers = {"mm_per_px": scale_mm, "mm_per_px_u_rel": scale_u_rel, "seen_mm": list(view.seen_mm)}
    return str(view), numbers, draw


def _seen_by_sensor(sensor: "PlainSensor", folder: Path, engine: "Preference") -> "_Seen":
    """Return what the camera of a classic sensor sees, and what its numbers rest on."""
    from finray_calib.reports import sensor_png, sensor_text
    from sim.experiments import pressed_coat
    from sim.optics import seen_places_mm, sensor_calibration

    rest = pressed_coat(sensor, folder).rest  # what cannot be pressed in is told before anything is shown
    places = seen_places_mm(sensor, rest, open_engine(engine), sensor_calibration(sensor, folder))
    return sensor_text(sensor, places), {}, lambda ending: sensor_png(sensor, places)


def _drawing_path(path: Path, endings: tuple[str, ...]) -> Path:
    """Return where the drawing goes, a new file whose ending says what it is."""
    from data_schemas import RecordError

    if path.suffix.lower() not in endings:
        raise RecordError(f"{path}: a drawing's name must end in {' or '.join(endings)}; choose another --out")
    return require_new(path)


def run_export(arguments: argparse.Namespace) -> None:
    """Write the printed parts and the mould."""
    from data_schemas import SimulateError
    from data_schemas.storage import ProductSet
    from finray_calib.exchange import PrintFormat, printable_parts
    from sim import read_design

    design = read_design(arguments.design)
    folder = require_new(arguments.out or Path(f"{file_name(design.name)}.print"))
    formats: tuple[PrintFormat, ...] = ("stl", "step") if arguments.format == "both" else (arguments.format,)
    with naming(SimulateError, arguments.design):
        parts = printable_parts(design, formats, arguments.one_piece, arguments.lining_mm)
    with ProductSet(folder) as products:
        for part in parts:
            for suffix, content in part.files.items():
                products.add(folder / f"{part.name}.{suffix}", content)
    wrote(folder, f"{len(parts)} parts to print")
    give(parts={part.name: list(part.size_mm) for part in parts})
    suggest_file(folder)
    for part in parts:
        x, y, z = part.size_mm
        names = " and ".join(f"{part.name}.{suffix}" for suffix in part.files)
        say(f"  {names}: {x:.1f} x {y:.1f} x {z:.1f} mm (x, y, z)" + (f"; {part.note}" if part.note else ""))


def run_paints(arguments: argparse.Namespace) -> None:
    """Rank the pairs of paints, and store the ranking."""
    from data_schemas import SimulateError, provenance
    from data_schemas.storage import camera_response, write_record
    from finray_calib.decide import paint_choice
    from sim import given_design
    from sim.experiments import PaintDraws, UnpaintedFinger, paint_pairs
    from sim.optics import read_calibration

    design, files, folder = given_design(arguments.design)
    paints = _calibrations(arguments.paint)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.paint-choice.json"), ".json")
    camera = design.camera
    with naming(SimulateError, arguments.design):
        finger = UnpaintedFinger(
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
    for line in _paint_table(choice):
        say(line)
    wrote(out, "the ranking with its draws")
    give(sentence=choice.sentence, pairs=choice.pairs, notes=choice.notes)
    best = choice.pairs[0]
    chosen = dict(zip(paints, arguments.paint, strict=True))
    suggest_command(
        "finray simulate sweep", arguments.design, f"--paint red={chosen[best.red]} --paint green={chosen[best.green]}",
        "--objectives all",
    )  # fmt: skip


def _calibrations(files: "Sequence[Path]") -> "dict[str, PaintCalibration]":
    """Return calibrations by name; paints of one name are distinguished by their files."""
    from data_schemas import PaintCalibration, SimulateError
    from data_schemas.storage import read_record

    if len({file.resolve() for file in files}) < max(len(files), 2):
        raise SimulateError("--paint: must name at least two files, each once, because a finger carries two paints")
    read = [read_record(file, PaintCalibration) for file in files]
    names = [paint.paint_name for paint in read]
    return {
        name if names.count(name) == 1 else f"{name} ({file})": paint
        for name, file, paint in zip(names, files, read, strict=True)
    }


def _paint_table(choice: "PaintChoice") -> list[str]:
    """Return the lines of the table, best pair first."""
    from finray_calib.reports import aligned_lines

    head = ("red wall", "green wall", "error (deg)", "above best (deg)", "")
    rows = [
        (
            row.red,
            row.green,
            str(row.normal_error_deg),
            "best" if place == 0 else str(row.above_best_deg),
            "" if place == 0 else "worse" if row.is_worse else "not distinguishable",
        )
        for place, row in enumerate(choice.pairs)
    ]
    return aligned_lines(head, rows)


LIGHTS_HELP = "powers of the lights for an even coat; a map over the angle and the place of a light"
LIGHTS_DESCRIPTION = """\
Find the powers of the lights by which the coat of a finger or classic sensor is lit most evenly, without and with
contact. The light of all sources adds up, so each is traced only once. The powers found are the solution of a convex
problem, so that no other allowed powers light the coat more evenly. The answer states the uncertainty of the powers,
how bright the coat is then, and, for a finger, how the expected error of the sensed normal changes.

Each power stays within --range times its present value, and all lights together emit at most --total times
as much light as now.

--map, given twice, evaluates a finger over two of its numbers, such as the angle of its light and the light's place:

  --map light.angle_deg=0:75:15 --map "light.position_mm[y]=-14:-6:2"

It takes some ten seconds of processor time for each light of a finger, three for each point of a map, and minutes for
a classic sensor. Writes a record, its page, and the design with the new powers."""
LIGHTS_EPILOG = """\
examples:
  finray design lights digit
  finray design lights two-panels.toml --paint red=red.paint.json --paint green=green.paint.json --range 0.1:10"""


def add_lights(actions: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray design lights``."""
    lights = actions.add_parser("lights", help=LIGHTS_HELP, description=LIGHTS_DESCRIPTION, epilog=LIGHTS_EPILOG)
    lights.add_argument("design", type=Path, metavar="DESIGN", help="finger or sensor (TOML), or the name of a preset")
    lights.add_argument(
        "--range", dest="power_range", type=_power_range, default=(0.25, 4.0), metavar="LOW:HIGH",
        help="limits of each power, as factors of the present power (default: 0.25:4)",
    )  # fmt: skip
    lights.add_argument(
        "--total", type=float, default=1.0, metavar="FACTOR",
        help="upper limit of the total light of all lights, as a factor of the present total (default: 1)",
    )  # fmt: skip
    lights.add_argument(
        "--map", dest="axes", action="append", default=[], metavar="FIELD=LOW:HIGH:STEP",
        help="a number of the finger and its values, for a map over two numbers (give the option exactly twice)",
    )  # fmt: skip
    lights.add_argument(
        "--samples", type=path_count, metavar="N",
        help="even number of light paths in a batch, per point of a finger (default: 512) or pixel of a sensor (32)",
    )  # fmt: skip
    add_paint(lights)
    add_paints_as_given(lights)
    add_engine(lights, is_scalar_enough=False)
    lights.add_argument("--out", type=Path, metavar="JSON", help="default: NAME.light-powers.json; must be new")
    add_seed(lights)
    lights.set_defaults(run=run_lights)


def _power_range(text: str) -> tuple[float, float]:
    """Parse LOW:HIGH."""
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low, high = 1.0, 0.0
    if not 0.0 < low <= high < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} must be LOW:HIGH, two factors above 0, such as 0.25:4")
    return low, high


@dataclass(frozen=True, slots=True)
class _LightsApart:
    """What was traced of each light: the basis, where its rows are, further remarks, and the files that were read."""

    basis: "LightBasis"
    places_mm: "NDArray[np.float64]"
    finger: "LitFinger | None" = None
    mapped: "LightPlaceMap | None" = None
    notes: tuple[str, ...] = ()
    paints: tuple[Path, ...] = ()


def run_lights(arguments: argparse.Namespace) -> None:
    """Find the most even powers; store them with their page and the design that has them."""
    import numpy as np

    from data_schemas import FinrayError, PlainSensor, SimulateError, provenance
    from finray_calib.decide import PowerLimits, even_powers, light_powers
    from sim.experiments import powered_lights

    design, files, folder = _finger_or_sensor(arguments.design)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.light-powers.json"), ".json")
    if len(arguments.axes) not in (0, 2) or (arguments.axes and isinstance(design, PlainSensor)):
        raise SimulateError("--map needs a finger and two of its numbers; give --map twice, or leave it out")
    lights, share = powered_lights(design)
    low, high = (np.full(len(lights), limit) for limit in arguments.power_range)
    with naming(FinrayError, arguments.design), progress_bar(f"lights of {design.name}") as progress:
        limits = PowerLimits(low, high, share, arguments.total)
        if isinstance(design, PlainSensor):
            apart = _sensor_lights(arguments, design, folder, progress)
        else:
            apart = _finger_lights(arguments, design, folder, progress)
        found = even_powers(apart.basis, limits, arguments.seed)
        error = None if apart.finger is None else apart.finger.error_change(found.powers)
    record = light_powers(design, lights, apart.basis, limits, found, apart.places_mm, error, apart.mapped)
    record = record.model_copy(update={"notes": (*record.notes, *apart.notes)})
    origin = provenance(command_line(), input_digests([*files, *apart.paints]), arguments.seed)
    _store_powers(out, record, origin, folder)
    _report_powers(record)
    wrote(out, "powers, basis and draws")
    wrote(out.with_suffix(".toml"), "the design with these powers")
    suggest_command("finray design show", out.with_suffix(".toml"))
    suggest_file(out.with_suffix(".html"))


def _finger_or_sensor(path: Path) -> "tuple[FingerDesign | PlainSensor, list[Path], Path]":
    """Return the finger or classic sensor of a file or of a preset's name, its files, and where its paths start."""
    from sim import SENSORS, given_design, is_sensor, preset_sensor, read_sensor, sensor_inputs

    if not path.is_file() and str(path) in SENSORS:
        return preset_sensor(str(path)), [], Path()
    if is_sensor(path):
        sensor = read_sensor(path)
        return sensor, sensor_inputs(sensor, path), path.parent
    return given_design(path)


def _finger_lights(
    arguments: argparse.Namespace, design: "FingerDesign", folder: Path, progress: "Progress"
) -> _LightsApart:
    """Trace each panel of a finger, and the fingers of a map."""
    import numpy as np

    from sim.experiments import EvaluationSettings, FingerEvaluator, map_axis, map_designs

    axes = [map_axis(design, text) for text in arguments.axes]
    light, paints = light_measure(arguments, design, folder)
    settings = EvaluationSettings(rays=arguments.samples or 512, repeats=8, draws=24, seed=arguments.seed)
    evaluator = FingerEvaluator(light.response, light.renderer, settings, light.calibration)
    finger = evaluator.lit_apart(design, light.paints, progress)
    mapped = None
    if axes:
        coarse = FingerEvaluator(light.response, light.renderer, light.settings, light.calibration)
        mapped = map_designs(design, axes, coarse, light.paints, progress)
    notes = tuple(f"{colour} paint: {where}" for colour, where in light.sources.items())
    return _LightsApart(finger.basis(), np.concatenate([finger.points_mm] * 2), finger, mapped, notes, tuple(paints))


def _sensor_lights(
    arguments: argparse.Namespace, sensor: "PlainSensor", folder: Path, progress: "Progress"
) -> _LightsApart:
    """Render each light of a classic sensor."""
    from data_schemas import SimulateError
    from sim.experiments import ClassicLayers, render_each_light

    if arguments.paint:
        raise SimulateError("--paint: a classic sensor carries no fluorescent paint; leave --paint out")
    scene = ClassicLayers(
        sensor, open_engine(arguments.engine), folder, arguments.seed, samples=arguments.samples or 32
    )
    return _LightsApart(*render_each_light(scene, 6, progress))


def _store_powers(out: Path, record: "LightPowers", origin: "Provenance", folder: Path) -> None:
    """Store the record, its page and the design with the new powers together."""
    from data_schemas import FingerDesign
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.reports.studies import light_powers_page
    from sim import design_toml, sensor_toml
    from sim.experiments import with_changed_values

    page, file = new_page_beside(out), require_new(out.with_suffix(".toml"))
    changed = with_changed_values(record.subject, {row.field: round(row.power_rel, 4) for row in record.rows})
    changed = with_files_found_from(out.parent, changed, folder)
    text = design_toml(changed) if isinstance(changed, FingerDesign) else sensor_toml(changed)
    with ProductSet(out) as products:
        products.add(page, light_powers_page(record, origin.command, origin.input_sha256).encode())
        products.add(file, text.encode())
        write_record(record, out, origin, products)


def _report_powers(record: "LightPowers") -> None:
    """Tell the powers."""
    from finray_calib.reports import light_map_sentence

    say(record.sentence)
    for row in record.rows:
        range95 = f"[{row.optimum_rel.low95:.3g}, {row.optimum_rel.high95:.3g}]"
        say(f"  {row.field}: {row.now_rel:.3g} -> {row.power_rel:.3g} {range95}  {row.light}")
    if record.map is not None:
        say(light_map_sentence(record.map))
    give(
        sentence=record.sentence, rows=record.rows, variation_now_rel=record.variation_now_rel,
        variation_rel=record.variation_rel, gain_rel=record.gain_rel, brightness_rel=record.brightness_rel,
        normal_error=record.normal_error, map=record.map,
    )  # fmt: skip
