"""The paper's optical studies: ``finray study fluorescent-rendering``, ``two-lights`` and ``light-angle``."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from finray_calib.cli.design_file import read_design
from finray_calib.cli.options import (
    add_out,
    add_paint,
    add_seed,
    command_line,
    design_inputs,
    input_digests,
    open_engine,
    paint_files,
    progress_bar,
    require_new,
    say,
)

if TYPE_CHECKING:
    from data_schemas.illumination import FluorescentRendering, LightAngleIntensity, TwoLights
    from sim.experiments.painted_finger import PaintedFinger
    from sim.optics.paint_bands import PaintOptics

STAND_IN = "stand-in: default hidden paint of the simulated rig, not the paper's paint"
FLATTEST = "ellipsoidal-30-8-90"
_BANDS = {"red": "red emission", "green": "green emission", "led": "blue light"}
EPILOG = """\
Without --design, the preset {preset}. Without --paint, the two default paints of the simulated rig stand in for
the paper's, whose spectra nobody has published; the record says so."""
FLUORESCENT = """\
The paper's figure of its fluorescent light source and rendering: painted walls that shine by their distance from
the blue light (as printed, and by the inverse square) beside walls that re-emit the light that reaches them. Press
and rest through the camera and per band, emission along the walls, and by how much they differ. Why: see
docs/explanation/fluorescent-rendering.md."""
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
            epilog=EPILOG.format(preset=study.preset),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        parser.add_argument(
            "--design", type=Path, metavar="TOML", help=f"finger design (default: preset {study.preset})"
        )
        add_paint(parser)
        whose = "probe and repeat" if study.name == "light-angle" else "pixel, an even number"
        parser.add_argument("--samples", type=partial(_samples, even=study.name != "light-angle"), metavar="N",
                            default=study.samples, help=f"paths per {whose} (default: {study.samples})")  # fmt: skip
        parser.add_argument("--engine", choices=["auto", "llvm", "scalar"], default="auto", help="renderer")
        add_out(parser, f"{study.name}, a folder")
        add_seed(parser)
        parser.set_defaults(run=partial(run_study, study))


def run_study(study: _Study, arguments: argparse.Namespace) -> None:
    """Make a study; write its record and figure; tell its numbers."""
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record

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
    say(f"{out}: {study.name}.json, {study.name}.png")
    for colour, paint in paints.items():
        say(f"{colour} paint: {paint}")
    study.tell(record)
    for note in record.notes:
        say(f"note: {note}")


def _finger(study: _Study, arguments: argparse.Namespace) -> "tuple[PaintedFinger, dict[str, str]]":
    """Return the finger, and by colour where its paint comes from."""
    from sim.experiments.painted_finger import paint_finger
    from sim.presets import preset_design

    files = paint_files(arguments, without="the simulated rig's paints")
    design = preset_design(study.preset) if arguments.design is None else read_design(arguments.design)
    folder = Path() if arguments.design is None else arguments.design.parent
    paints, sources = _calibrated(files) if files else _stand_ins()
    return paint_finger(design, paints, folder, open_engine(arguments.engine)), sources


def _calibrated(files: dict[str, Path]) -> "tuple[dict[str, PaintOptics], dict[str, str]]":
    """Return the optics of calibrated paints and their names and checksums."""
    from data_schemas.fit import PaintCalibration
    from data_schemas.provenance import digest_of_input
    from data_schemas.storage import read_record
    from sim.experiments.painted_finger import paint_optics

    paints = {colour: read_record(file, PaintCalibration) for colour, file in files.items()}
    sources = {c: f"{paint.paint_name}, SHA-256 {digest_of_input(files[c])}" for c, paint in paints.items()}
    return {colour: paint_optics(paint) for colour, paint in paints.items()}, sources


def _stand_ins() -> "tuple[dict[str, PaintOptics], dict[str, str]]":
    """Return the optics of the simulated rig's two default paints."""
    from finray_calib.demo.stages import true_paint_optics
    from rigs.presets import DEFAULT_PAINTS, simulated_rig
    from rigs.simulated.bench_truth import bench_truth

    truths = {colour: bench_truth(simulated_rig(colour, None, seed=1), Path()) for colour in DEFAULT_PAINTS}
    paints = {colour: true_paint_optics(colour, truth) for colour, truth in truths.items()}
    return paints, dict.fromkeys(paints, STAND_IN)


def _samples(text: str, even: bool) -> int:
    """Parse a number of paths; an image is rendered as two halves, whose difference is its noise."""
    if not text.isdecimal() or int(text) < 2 or (even and int(text) % 2):
        kind = "an even whole number" if even else "a whole number"
        raise argparse.ArgumentTypeError(f"{text!r} must be {kind} from 2, for example 64")
    return int(text)


def _make_fluorescent(finger: "PaintedFinger", *settings: Any) -> "FluorescentRendering":
    """Make the study of the paper's emitter."""
    from sim.experiments.fluorescent_rendering import study_fluorescent_rendering

    return study_fluorescent_rendering(finger, *settings)


def _make_two_lights(finger: "PaintedFinger", *settings: Any) -> "TwoLights":
    """Make the study of the second panel."""
    from sim.experiments.two_lights import study_two_lights

    return study_two_lights(finger, *settings)


def _make_light_angle(finger: "PaintedFinger", *settings: Any) -> "LightAngleIntensity":
    """Make the study of the light angle."""
    from sim.experiments.light_intensity import study_light_angle

    return study_light_angle(finger, *settings)


def _draw(record: Any) -> bytes:
    """Draw the figure of a study."""
    from data_schemas.illumination import FluorescentRendering, TwoLights
    from finray_calib.reports.fluorescent_rendering_figure import fluorescent_rendering_png
    from finray_calib.reports.light_angle_figure import light_angle_png
    from finray_calib.reports.two_lights_figure import two_lights_png

    if isinstance(record, FluorescentRendering):
        return fluorescent_rendering_png(record)
    return two_lights_png(record) if isinstance(record, TwoLights) else light_angle_png(record)


def _tell_fluorescent(study: "FluorescentRendering") -> None:
    """Say how far the paper's emitter is from the baked walls."""
    say(f"\nAgainst baked walls, blocks of {study.block_px} px of the coat with contact, at equal mean brightness:")
    for d in study.differences:
        if d.state == "contact" and d.band != "led":
            name = "as printed (proportional to distance)" if d.level == "a" else "inverse square of the distance"
            say(f"  {name:38s} {d.band:6s} {d.shape_error_rel:6.1%} off (render noise {d.noise_rel:.1%})")
    for k, wall in enumerate(study.walls):
        off = ", ".join(f"{v:.0%}" for v in study.wall_error_rel[:-1, k])
        say(f"  {wall} wall along z: {off} off; {study.second_order_wall_share[wall]:.1%} excited by other paint")
    means = study.wall_by_angle_rel.mean(axis=2) / study.wall_radiance_rel[-1].mean(axis=1)
    told = ", ".join(f"{angle:g} deg {mean[0]:.2f}" for angle, mean in zip(study.angles_deg, means, strict=True))
    say(f"  red wall by light angle (the paper's rule: no change): {told}")


def _tell_two_lights(study: "TwoLights") -> None:
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
        "  red, green, led: light of each paint and of the LEDs, before the camera; R, G, B: what it makes of them."
        f"\n  Cells of {study.cell_mm:g} mm; their noise is taken out of sd / mean, not of darkest / brightest."
    )


def _tell_light_angle(study: "LightAngleIntensity") -> None:
    """Say where each curve is highest and what the paper's angle loses."""
    from finray_calib.reports.number_text import interval_text

    for p, probe in enumerate(study.probes):
        x, y, z = study.probe_points_mm[p]
        where = f"x = {x:g}, y = {y:.1f}, z = {z:.1f} mm"
        say(f"\n{probe} ({where}), panel's centre {study.led_depth_mm:g} mm below the inner face;")
        say(f"  highest at (95 % limits), and what the paper's {study.printed_angle_deg:g} deg loses against it:")
        for top in study.maxima:
            if top.probe == probe:
                angle = interval_text(top.angle_deg, top.low95_deg, top.high95_deg, most_decimals=1)
                limits = f"[{top.loss_at_printed_low95_rel:.1%}, {top.loss_at_printed_high95_rel:.1%}]"
                lost = f"loss {top.loss_at_printed_rel:5.1%} {limits}"
                say(f"  {top.mirror:15s}{_BANDS[top.band]:15s}{angle:>18s} deg  {lost}")
        depths = {f"{study.led_depth_mm:g}": tuple(study.elevation_deg.tolist()), **study.elevation_by_depth_deg}
        told = ", ".join(f"{_whole(depths[mm][p])} deg ({mm} mm)" for mm in sorted(depths, key=float))
        say(f"  direct light alone, by depth of the panel: {told}")


def _whole(angle_deg: float) -> str:
    """Return an angle without decimals; never "-0"."""
    return f"{round(angle_deg):d}"


STUDIES = (
    _Study(
        "fluorescent-rendering", "the paper's emitter on the painted walls beside baked walls", FLUORESCENT,
        "flat-70x35", 32, _make_fluorescent, _tell_fluorescent,
    ),
    _Study(
        "two-lights", "one panel at the base against base and tip", TWO,
        FLATTEST, 32, _make_two_lights, _tell_two_lights,
    ),
    _Study(
        "light-angle", "brightness beside the indenter over the light angle", ANGLE,
        FLATTEST, 12_000, _make_light_angle, _tell_light_angle,
    ),
)  # fmt: skip
