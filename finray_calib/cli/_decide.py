"""``finray decide``: the angle to mount the light at, over the places that are touched, with probability and risk."""

import argparse
import math
from pathlib import Path

from finray_calib.cli._output import give, say, suggest_file, wrote
from finray_calib.cli._run import (
    add_out,
    add_seed,
    command_line,
    input_digests,
    naming,
    new_page_beside,
    require_new,
)

HELP = "decide on the light angle from sweeps at the places that are touched"
DESCRIPTION = """\
Decide on the angle of the blue light (light.angle_deg of the design: between the pad's plane and the direction in which
the panel shines; 0 along the pad, 90 into it). Give one sweep for each place where the finger is touched, as 'finray
simulate sweep --positions' writes them; one sweep alone decides for its one place only. The decision rests on the
expected error of the sensed normal if the sweeps were made with --objectives all, else on the brightness. The answer
gives the angle with its tolerance, what is lost against the best at every place, the probability that another angle is
better, and by how much. Photometric error reports, one for each physical capture, correct the simulated curves near
the angles of the captures, and show how far the curves can be trusted at other angles. Without a report the angle stays
undecided. The answer also names the capture that would help most."""


def add_decide(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("decide", help=HELP, description=DESCRIPTION)
    parser.add_argument(
        "sweeps", type=Path, nargs="+", metavar="SWEEP",
        help="record written by 'finray simulate sweep', one for each touch",
    )  # fmt: skip
    parser.add_argument(
        "--weights", type=_weights, metavar="W,W,...",
        help="relative frequency of each touch, in the order of the sweeps, e.g. from a log of grasps (default: all "
             "equal)",
    )  # fmt: skip
    parser.add_argument(
        "--criterion", choices=["average", "worst"], default="average",
        help="what to minimise: the average loss over the touches, or the loss at the worst touch (default: average)",
    )  # fmt: skip
    parser.add_argument(
        "--aim", choices=["brightness", "normal"],
        help="quantity to decide by: the brightness of the touches, or the expected error of the sensed normal, "
             "which needs sweeps made with --objectives all (default: normal for such sweeps if neither reports nor "
             "weights are given, otherwise brightness)",
    )  # fmt: skip
    parser.add_argument(
        "--photometric-error", type=Path, action="append", default=[], metavar="REPORT", dest="reports",
        help="record written by 'finray compare' (repeatable, one for each capture); captures at several light "
            "angles help most",
    )  # fmt: skip
    parser.add_argument(
        "--narrow-sweep",
        action="store_true",
        help="confirm that the angles of the sweep, which span less than 4 deg, are in degrees and not in radians",
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
