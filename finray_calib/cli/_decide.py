"""``finray decide`` and ``finray design lights``: the angle to mount the light at, and the power of each light.

The angle is decided over the places that are touched, with probability and risk; the powers for an even coat.
"""

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._design_search import light_measure
from finray_calib.cli._output import give, progress_bar, say, suggest_command, suggest_file, wrote
from finray_calib.cli._run import (
    add_engine,
    add_out,
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
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from data_schemas import FingerDesign, LightPlaceMap, LightPowers, PlainSensor, Provenance
    from finray_calib.decide import LightBasis
    from sim.experiments import LitFinger
    from sim.optics import Progress

HELP = "decide on the light angle from sweeps at the places that are touched"
DESCRIPTION = """\
Decide on the angle of the blue light (light.angle_deg of the design: between the pad's plane and the direction in which
the panel shines; 0 along the pad, 90 into it). Give one sweep for each place where the finger is touched, as 'finray
simulate sweep --positions' writes them; one sweep alone decides for its one place only. The decision rests on the
expected error of the sensed normal if the sweeps were made with --objectives all, else on the brightness. The answer
gives the angle with its tolerance, what is lost against the best at every place, the probability that another angle is
better, and by how much. Photometric error reports, one for each physical capture, correct the simulated curves near
their angles and show how sure they are elsewhere; without any, the angle stays undecided. The answer also names the
capture that would help most."""


def add_decide(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("decide", help=HELP, description=DESCRIPTION)
    parser.add_argument(
        "sweeps", type=Path, nargs="+", metavar="SWEEP",
        help="record written by 'finray simulate sweep', one for each touch",
    )  # fmt: skip
    parser.add_argument(
        "--weights", type=_weights, metavar="W,W,...",
        help="how often each touch occurs, in the order of the sweeps (default: all equally), e.g. from a log of "
             "grasps",
    )  # fmt: skip
    parser.add_argument(
        "--criterion", choices=["average", "worst"], default="average",
        help="least loss on average over the touches (default), or at the worst of them",
    )  # fmt: skip
    parser.add_argument(
        "--aim", choices=["brightness", "normal"],
        help="decide on the brightness of the touches, or on the expected error of the sensed normal, which sweeps "
             "with --objectives all hold (default: the latter, if the sweeps hold it and neither reports nor weights "
             "are given)",
    )  # fmt: skip
    parser.add_argument(
        "--photometric-error", type=Path, action="append", default=[], metavar="REPORT", dest="reports",
        help="record written by 'finray compare' (repeatable, one for each capture); captures at several light "
            "angles help most",
    )  # fmt: skip
    parser.add_argument(
        "--narrow-sweep",
        action="store_true",
        help="the sweep's angles span less than 4 deg and are meant in degrees, not in radians",
    )
    add_out(parser, "light-angle-decision.json")
    add_seed(parser)
    parser.set_defaults(run=run)


def _weights(text: str) -> list[float]:
    """Parse W,W,...; whether they fit the sweeps is judged with these."""
    try:
        weights = [float(part) for part in text.split(",")]
    except ValueError:
        weights = []
    if not weights or not all(0.0 < weight < math.inf for weight in weights):
        raise argparse.ArgumentTypeError(f"{text!r} must be numbers above 0 with commas between them, e.g. 3,1,1")
    return weights


def run(arguments: argparse.Namespace) -> None:
    """Decide and report."""
    from data_schemas import DecideError, LightAngleSweep, PhotometricErrorReport, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.decide import decide
    from finray_calib.reports import decision_page, verdict_words

    out = require_new(arguments.out or Path("light-angle-decision.json"), ".json")
    page = new_page_beside(out)
    paths = [*arguments.sweeps, *arguments.reports]
    sweeps = [read_record(path, LightAngleSweep) for path in arguments.sweeps]
    reports = [read_record(path, PhotometricErrorReport) for path in arguments.reports]
    with naming(DecideError, *paths):
        decision = decide(
            sweeps,
            reports,
            arguments.seed,
            arguments.narrow_sweep,
            arguments.weights,
            arguments.criterion,
            arguments.aim,
        )
    inputs = input_digests(paths)
    with ProductSet(out) as products:
        products.add(page, decision_page(decision, sweeps, command_line(), inputs).encode())
        write_record(decision, out, provenance(command_line(), inputs, arguments.seed), products)
    say(decision.headline)
    say(f"\n{verdict_words(decision).capitalize()}. {decision.sentence.removeprefix(decision.headline).strip()}\n")
    wrote(out, decision.verdict.upper())
    wrote(page, "the decision with its reasons, for the person who mounts the light")
    give(
        verdict=decision.verdict, angle_deg=decision.angle_deg, tolerance_deg=decision.tolerance_deg,
        headline=decision.headline, sentence=decision.sentence, validated=decision.validated,
        next_capture=decision.next_capture,
    )  # fmt: skip
    suggest_file(page)


LIGHTS_HELP = "powers of the lights for an even coat; a map over the angle and the place of a light"

LIGHTS_DESCRIPTION = """\
Find the powers of the lights by which the coat of a finger or classic sensor is lit most evenly, without and with
contact. The light of all sources adds up, so each is traced only once. The most even powers are the solution of a
convex problem, so that no other allowed powers are more even. The answer states how certain they are, how bright the
coat is then, and, of a finger, how the expected error of the sensed normal changes.

Each power stays within --range times its present value, and all lights together emit at most --total times
as much light as now.

--map, given twice, evaluates a finger over two of its numbers, such as the angle of its light and the light's place:

  --map light.angle_deg=0:75:15 --map "light.position_mm[y]=-14:-6:2"

It takes some ten seconds of processor time for each light of a finger, three for each finger of a map, minutes for a
classic sensor. Writes a record, its page, and the design with the new powers."""

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
        help="limits of each power, as factors of its present value (default: 0.25:4)",
    )  # fmt: skip
    lights.add_argument(
        "--total", type=float, default=1.0, metavar="FACTOR",
        help="upper limit for the light of all lights together, as a factor of the present one (default: 1)",
    )  # fmt: skip
    lights.add_argument(
        "--map", dest="axes", action="append", default=[], metavar="FIELD=LOW:HIGH:STEP",
        help="a number of the finger and its values; give it twice, for a map over two numbers",
    )  # fmt: skip
    lights.add_argument(
        "--samples", type=path_count, metavar="N",
        help="paths of a batch, an even number: per point of a finger (default: 512), per pixel of a sensor (32)",
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
    """What was traced of each light: the basis, where its rows are, and what further is told or was read."""

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
        raise SimulateError("--map: give it twice, once for each of two numbers of a finger, or leave it out")
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
    _store_powers(out, record, origin)
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
        raise SimulateError("--paint: a classic sensor carries no fluorescent paint; leave it out")
    scene = ClassicLayers(
        sensor, open_engine(arguments.engine), folder, arguments.seed, samples=arguments.samples or 32
    )
    return _LightsApart(*render_each_light(scene, 6, progress))


def _store_powers(out: Path, record: "LightPowers", origin: "Provenance") -> None:
    """Store the record, its page and the design with the new powers together."""
    from data_schemas import FingerDesign
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.reports.studies import light_powers_page
    from sim import design_toml, sensor_toml
    from sim.experiments import with_changed_values

    page, file = new_page_beside(out), require_new(out.with_suffix(".toml"))
    changed = with_changed_values(record.subject, {row.field: round(row.power_rel, 4) for row in record.rows})
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
