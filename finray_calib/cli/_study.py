"""``finray study``: ready-made studies; each writes a record and a figure into a folder.

The paper's paints, its optical studies (fluorescent rendering, two lights, light angle), and the stiffness of fingers
in bending and twist with assumed dimensions changed.
"""

import argparse
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from finray_calib.cli._output import give, progress_bar, say, suggest_file, wrote
from finray_calib.cli._run import (
    add_engine,
    add_out,
    add_paint,
    add_seed,
    command_line,
    input_digests,
    number_within,
    open_engine,
    paint_files,
    require_new,
    whole_number,
)
from finray_calib.cli._study_run import add_design_studies, calibrated_paints, stand_in_paints

if TYPE_CHECKING:
    from collections.abc import Iterator

    from data_schemas import (
        FingerDesign,
        FingerStiffness,
        FluorescentRendering,
        LightAngleIntensity,
        PaperStatement,
        StiffnessOrder,
        StiffnessRow,
        TwoLights,
    )
    from finray_calib.cli._run import LongWork
    from sim.experiments import PaintedFinger


STUDY_HELP = "run a ready-made study of the paper: paints, fluorescent rendering, two lights, light angle, stiffness"
WIDTH = 80
PAPER_PAINTS_HELP = "the paper's statements on its red and green paint beside measured stand-ins"
PAPER_PAINTS_DESCRIPTION = """\
Compare what the paper states about its two fluorescent paints (Stokes shifts of 100 and 50 nm, 2 to 5 %
reradiation, its four-parameter curve, the ColorChecker match) with measured materials of the same
colours, and say which statements hold and why the others do not. The materials are also seen through
the paper's eight filters, with errors of 1 % and 0.3 %, and fitted twice: by the paper's curve alone,
and by the model of 'finray fit' with its 95 % band. Writes a record and a figure."""
PAPER_PAINTS_EPILOG = """\
The materials are re-radiation (Donaldson) matrices as CSV: first column emission_nm, then one column for each
excitation wavelength in nm, values as radiance factor in the emission band; lines that start with # are comments.
Excitations from 380 to 450 nm and emission from 470 to 780 nm are needed. Openly licensed ones (BSD-3-Clause): the
Post-it notes of github.com/afichet/spectral-exr, the inks and textiles of github.com/afichet/fluorescence-rgb.

example:
  finray study paper-paints --red ink.csv --green textile.csv --out study"""


def add_study(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and its studies."""
    parser = verbs.add_parser("study", help=STUDY_HELP, description=STUDY_HELP)
    parser.set_defaults(long_work=_long_work)
    studies = parser.add_subparsers(dest="study", metavar="STUDY", title="studies", required=True)
    paints = studies.add_parser(
        "paper-paints", help=PAPER_PAINTS_HELP, description=PAPER_PAINTS_DESCRIPTION, epilog=PAPER_PAINTS_EPILOG
    )
    for colour in ("red", "green"):
        paints.add_argument(
            f"--{colour}", type=Path, action="append", default=[], metavar="CSV",
            help=f"measured matrix to use as the {colour} paint (repeatable)",
        )  # fmt: skip
    add_out(paints, "paper-paints, a folder")
    add_seed(paints)
    paints.set_defaults(run=run_paper_paints)
    add_design_studies(studies)
    add_illumination_studies(studies)
    add_stiffness_study(studies)


def _long_work(arguments: argparse.Namespace) -> "LongWork":
    """Return which study is about to be made."""
    from finray_calib.cli._run import LongWork

    kept = "Nothing is stored before the end, so the same command starts from the beginning"
    if arguments.study == "run":
        return LongWork("the design study", "Finished points are kept, and the same command continues with the others")
    if arguments.study == "dataset":
        kept = "Finished shards are kept, and the same command continues with the others"
        return LongWork("the data set", kept, arguments.out)
    return LongWork(f"the study {arguments.study}", kept, getattr(arguments, "out", None))


def run_paper_paints(arguments: argparse.Namespace) -> None:
    """Compare the paper's statements with measured materials, and report."""
    import numpy as np

    from data_schemas import provenance
    from data_schemas.storage import ProductSet, read_donaldson_matrix, write_record
    from finray_calib.reports import paper_paints_png
    from sim.experiments import reproduce_paper_paints

    out = require_new(arguments.out or Path("paper-paints"))
    red, green = ([read_donaldson_matrix(path) for path in paths] for paths in (arguments.red, arguments.green))
    study = reproduce_paper_paints(red, green, np.random.default_rng(arguments.seed))
    inputs = input_digests([*arguments.red, *arguments.green])
    picture = paper_paints_png(study)
    with ProductSet(out) as products:
        products.add(out / "paper-paints.png", picture)
        write_record(study, out / "paper-paints.json", provenance(command_line(), inputs, arguments.seed), products)
    wrote(out, "paper-paints.json, paper-paints.png")
    give(statements={s.subject: s.verdict for s in study.statements}, notes=[study.caveat])
    suggest_file(out / "paper-paints.png")
    for statement in study.statements:
        say(_in_words(statement))
    say("\n" + textwrap.fill(study.caveat, WIDTH))


def _in_words(statement: "PaperStatement") -> str:
    """Return a statement as a block of lines: verdict and subject, then paper, measurement and reason."""
    widest = max(map(len, statement.ours), default=0)
    return "\n".join(
        (
            f"\n{statement.verdict.upper()}: {statement.subject}",
            _entry("paper", statement.paper),
            _entry("here", statement.measure),
            *(_entry("", f"{name:{widest}s}  {text}", widest + 2) for name, text in statement.ours.items()),
            _entry("why", statement.why),
        )
    )


def _entry(title: str, text: str, hanging: int = 0) -> str:
    """Return a titled paragraph; further lines start below the text, `hanging` characters further in."""
    indent = " " * 8
    return textwrap.fill(text, WIDTH, initial_indent=f"  {title:6s}", subsequent_indent=indent + " " * hanging)


FLATTEST = "ellipsoidal-30-8-90"
_BANDS = {"red": "red emission", "green": "green emission", "led": "blue light"}
ILLUMINATION_EPILOG = """\
Without --design, the preset {preset}. Without --paint, the two default paints of the simulated rig stand in for
the paper's, whose spectra nobody has published; the record says so."""
FLUORESCENT = """\
The paper's figure of its fluorescent light source and rendering: painted walls whose light depends on their distance
from the blue light (as printed, and by the inverse square) beside walls that re-emit the light that reaches them. The
figure shows press and rest through the camera and per band, the emission along the walls, and how much they differ.
docs/explanation/fluorescent-rendering.md gives the reasons."""
TWO = """\
The paper's second blue light: one panel at the base against panels at base and tip (second_light of the design, else
the panel mirrored to the tip): images, and how evenly the coat is lit."""
ANGLE = """\
The paper's light angle: brightness at both edges of the contact from -30 to 120 deg, with the mirror and without, the
angle at which it is highest with 95 % limits, and what the paper's 30 deg loses."""


@dataclass(frozen=True, slots=True)
class _Study:
    """What one study needs: words, default design, default paths, and who makes and tells it."""

    name: str
    help: str
    description: str
    preset: str
    samples: int
    make: Callable[..., Any]
    tell: Callable[[Any], None]


def add_illumination_studies(studies: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the three studies."""
    for study in STUDIES:
        parser = studies.add_parser(
            study.name,
            help=study.help,
            description=study.description,
            epilog=ILLUMINATION_EPILOG.format(preset=study.preset),
        )
        parser.add_argument(
            "--design", type=Path, metavar="TOML", help=f"finger design (default: preset {study.preset})"
        )
        add_paint(parser)
        is_image = study.name != "light-angle"
        whose = "pixel, an even number" if is_image else "probe and repeat"
        parser.add_argument("--samples", type=whole_number(2, 1_000_000, even=is_image), metavar="N",
                            default=study.samples, help=f"paths per {whose} (default: {study.samples})")  # fmt: skip
        add_engine(parser)
        add_out(parser, f"{study.name}, a folder")
        add_seed(parser)
        parser.set_defaults(run=partial(run_illumination_study, study))


def run_illumination_study(study: _Study, arguments: argparse.Namespace) -> None:
    """Make a study; write its record and figure; tell its numbers."""
    from data_schemas import provenance
    from data_schemas.storage import ProductSet, write_record
    from sim import design_inputs

    out = require_new(arguments.out or Path(study.name))
    finger, paints = _finger(study, arguments)
    designs = [] if arguments.design is None else design_inputs(finger.design, arguments.design)
    files = [*designs, *dict(arguments.paint).values()]
    origin = provenance(command_line(), input_digests(files), arguments.seed)
    with progress_bar(study.name) as progress:
        record = study.make(finger, arguments.seed, arguments.samples, paints, progress)
    picture = _draw(record)
    with ProductSet(out) as products:
        products.add(out / f"{study.name}.png", picture)
        write_record(record, out / f"{study.name}.json", origin, products)
    wrote(out, f"{study.name}.json, {study.name}.png")
    give(paints=paints, notes=record.notes)
    suggest_file(out / f"{study.name}.png")
    for colour, paint in paints.items():
        say(f"{colour} paint: {paint}")
    study.tell(record)
    for note in record.notes:
        say(f"note: {note}")


def _finger(study: _Study, arguments: argparse.Namespace) -> "tuple[PaintedFinger, dict[str, str]]":
    """Return the finger, and by colour where its paint comes from."""
    from sim import preset_design, read_design
    from sim.experiments import paint_finger

    files = paint_files(arguments, without="the simulated rig's paints")
    design = preset_design(study.preset) if arguments.design is None else read_design(arguments.design)
    folder = Path() if arguments.design is None else arguments.design.parent
    paints, sources = calibrated_paints(files) if files else stand_in_paints()
    return paint_finger(design, paints, folder, open_engine(arguments.engine)), sources


def _make_fluorescent(finger: "PaintedFinger", *settings: Any) -> "FluorescentRendering":
    """Make the study of the paper's emitter."""
    from sim.experiments import study_fluorescent_rendering

    return study_fluorescent_rendering(finger, *settings)


def _make_two_lights(finger: "PaintedFinger", *settings: Any) -> "TwoLights":
    """Make the study of the second panel."""
    from sim.experiments import study_two_lights

    return study_two_lights(finger, *settings)


def _make_light_angle(finger: "PaintedFinger", *settings: Any) -> "LightAngleIntensity":
    """Make the study of the light angle."""
    from sim.experiments import study_light_angle

    return study_light_angle(finger, *settings)


def _draw(record: Any) -> bytes:
    """Draw the figure of a study."""
    from data_schemas import FluorescentRendering, TwoLights
    from finray_calib.reports import fluorescent_rendering_png, light_angle_png, two_lights_png

    if isinstance(record, FluorescentRendering):
        return fluorescent_rendering_png(record)
    return two_lights_png(record) if isinstance(record, TwoLights) else light_angle_png(record)


def _report_fluorescent(study: "FluorescentRendering") -> None:
    """Say how far the paper's emitter is from the baked walls."""
    say(
        f"\nCompared with walls that re-emit the light that reaches them, in blocks of {study.block_px} px of the "
        "coat with contact, at equal mean brightness:"
    )
    for d in study.differences:
        if d.state == "contact" and d.band != "led":
            name = "as printed (proportional to distance)" if d.level == "a" else "inverse square of the distance"
            say(
                f"  {name:38s} {d.band:6s} {100 * d.shape_error_rel:5.1f} % error (render noise "
                f"{100 * d.noise_rel:.1f} %)"
            )
    for k, wall in enumerate(study.walls):
        off = ", ".join(f"{100 * v:.0f} %" for v in study.wall_error_rel[:-1, k])
        say(
            f"  {wall} wall along z: error {off}; {100 * study.second_order_wall_share[wall]:.1f} % of its "
            "light is excited by the other paint"
        )
    means = study.wall_by_angle_rel.mean(axis=2) / study.wall_radiance_rel[-1].mean(axis=1)
    told = ", ".join(f"{angle:g} deg {mean[0]:.2f}" for angle, mean in zip(study.angles_deg, means, strict=True))
    say(f"  red wall by light angle (the paper's rule: no change): {told}")


def _report_two_lights(study: "TwoLights") -> None:
    """Say how even the light is with one panel and with two."""
    x, y, z = study.tip_light_position_mm
    say(f"\nPanel at the tip: ({x:g}, {y:g}, {z:g}) mm, {study.tip_light_angle_deg:g} deg. Without contact, by area:")
    say(
        f"  {'':28s}{'channel':9s}sd / mean   of the middle 70 %   darkest / brightest along z   noise of a cell / mean"
    )
    for u in study.uniformity:
        numbers = f"{u.variation_rel:9.2f}{u.middle_variation_rel:21.2f}{u.min_to_max_ratio:30.2f}{u.noise_rel:25.2f}"
        say(f"  {u.lights:28s}{u.channel:9s}{numbers}")
    say(
        "  red, green, led: light of each paint and of the LEDs, before the camera; R, G, B: the camera's "
        f"channels.\n  Cells of {study.cell_mm:g} mm; their noise is subtracted from sd / mean, but not from "
        "darkest / brightest."
    )


def _report_light_angle(study: "LightAngleIntensity") -> None:
    """Say where each curve is highest and what the paper's angle loses."""
    from finray_calib.reports import interval_text

    for p, probe in enumerate(study.probes):
        x, y, z = study.probe_points_mm[p]
        where = f"x = {x:g}, y = {y:.1f}, z = {z:.1f} mm"
        say(f"\n{probe} ({where}), panel's centre {study.led_depth_mm:g} mm below the inner face;")
        say(
            "  angle of the highest brightness (95 % limits), and how much less the paper's "
            f"{study.printed_angle_deg:g} deg gives:"
        )
        for top in study.maxima:
            if top.probe == probe:
                angle = interval_text(top.angle_deg, top.low95_deg, top.high95_deg, most_decimals=1)
                limits = f"[{100 * top.loss_at_printed_low95_rel:.1f} %, {100 * top.loss_at_printed_high95_rel:.1f} %]"
                lost = f"loss {100 * top.loss_at_printed_rel:4.1f} % {limits}"
                say(f"  {top.mirror:15s}{_BANDS[top.band]:15s}{angle:>18s} deg  {lost}")
        depths = {f"{study.led_depth_mm:g}": tuple(study.elevation_deg.tolist()), **study.elevation_by_depth_deg}
        told = ", ".join(f"{_whole(depths[mm][p])} deg ({mm} mm)" for mm in sorted(depths, key=float))
        say(f"  direct light alone, by depth of the panel: {told}")


def _whole(angle_deg: float) -> str:
    """Return an angle without decimals; never "-0"."""
    return f"{round(angle_deg):d}"


STUDIES = (
    _Study(
        "fluorescent-rendering",
        "the paper's emitter on the painted walls beside walls that re-emit the light that reaches them", FLUORESCENT,
        "flat-70x35", 32, _make_fluorescent, _report_fluorescent,
    ),
    _Study(
        "two-lights", "one panel at the base against base and tip", TWO,
        FLATTEST, 32, _make_two_lights, _report_two_lights,
    ),
    _Study(
        "light-angle", "brightness beside the indenter over the light angle", ANGLE,
        FLATTEST, 12_000, _make_light_angle, _report_light_angle,
    ),
)  # fmt: skip

STIFFNESS_NAME = "finger-stiffness"
STIFFNESS_HELP = "stiffness of fingers in bending and twist, with assumed dimensions changed"
STIFFNESS_DESCRIPTION = """\
Load fingers without an indenter: a force at the tip (away from the pad, and across), a force under the middle of the
pad, a twist of the tip; and let them grip a cylinder, for the torque at which it slips. Then change each dimension of
the skeleton that the design's origin does not list, one at a time, up and down, and say whether the fingers keep their
order of stiffness. Writes a record and a table (CSV)."""
STIFFNESS_EPILOG = """\
examples:
  finray study finger-stiffness flat-70x35 flat-70x35-soft --out stiffness
  finray study finger-stiffness mine.toml --vary 0"""
_PERCENT = 100.0
_RIB_FIELDS = ("skeleton.rib_count", "skeleton.rib_width_mm", "skeleton.rib_thickness_mm")


def add_stiffness_study(studies: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the study."""
    parser = studies.add_parser(
        STIFFNESS_NAME, help=STIFFNESS_HELP, description=STIFFNESS_DESCRIPTION, epilog=STIFFNESS_EPILOG
    )
    parser.add_argument("designs", nargs="+", metavar="DESIGN", help="finger design (TOML), or the name of a preset")
    parser.add_argument(
        "--vary", type=number_within("a change in per cent", (0.0, 50.0)), default=20.0, metavar="PERCENT",
        help="change of the assumed dimensions in per cent, 0 to 50 (default: 20); 0 leaves them unchanged",
    )  # fmt: skip
    add_out(parser, f"{STIFFNESS_NAME}, a folder")
    parser.set_defaults(run=run_stiffness_study)


def run_stiffness_study(arguments: argparse.Namespace) -> None:
    """Load the fingers, write record and table, and tell the order."""
    from data_schemas import provenance
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.spectra import machine_threads
    from sim.experiments import study_finger_stiffness

    out = require_new(arguments.out or Path(STIFFNESS_NAME))
    designs = [_design(given) for given in arguments.designs]
    files = [Path(given) for given in arguments.designs if given.endswith(".toml")]
    origin = provenance(command_line(), input_digests(files), None)
    with progress_bar(STIFFNESS_NAME) as progress:
        study = study_finger_stiffness(designs, arguments.vary / _PERCENT, machine_threads(), progress)
    with ProductSet(out) as products:
        products.add(out / f"{STIFFNESS_NAME}.csv", _table(study).encode())
        write_record(study, out / f"{STIFFNESS_NAME}.json", origin, products)
    wrote(out, f"{STIFFNESS_NAME}.json, {STIFFNESS_NAME}.csv")
    give(rows=study.rows, orders=study.orders)
    suggest_file(out / f"{STIFFNESS_NAME}.csv")
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
        return f"has no result: {row.grip_failure}"
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
        f"; with the same assumed dimension changed in both, the ratio is at least {order.smallest_ratio:.3f} and the "
        f"order {holds}; with independent changes, the ratio is at least {order.independent_ratio:.3f}"
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
    from sim import preset_design, read_design

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
