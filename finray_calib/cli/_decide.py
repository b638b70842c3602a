"""``finray decide``: the angle to mount the light at, with probability and risk."""

import argparse
from pathlib import Path

from finray_calib.cli._run import (
    add_out,
    add_seed,
    command_line,
    input_digests,
    naming,
    new_page_beside,
    require_new,
    say,
)

HELP = "decide on the light angle from a sweep"
DESCRIPTION = """\
Decide on the angle of the blue light from a sweep: the angle, the probability that it is within 5 degrees of
the best, the expected loss with its 95 % bound, and the range of angles that are as good. Photometric error
reports, one for each physical capture, correct the simulated curve near their angles and say how sure it is
elsewhere; the decision is shown with and without them, and without any it says that it is not validated. The
next render and the next capture that would help most are named."""


def add_decide(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "decide", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sweep", type=Path, metavar="SWEEP", help="record written by 'finray simulate sweep'")
    parser.add_argument(
        "--photometric-error", type=Path, action="append", default=[], metavar="REPORT", dest="reports",
        help="record written by 'finray compare', once for each capture; best at several light angles",
    )  # fmt: skip
    parser.add_argument(
        "--narrow-sweep", action="store_true", help="the sweep's angles span less than 4 deg and are not radians"
    )
    add_out(parser, "light-angle-decision.json")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Decide and report."""
    from data_schemas import DecideError, LightAngleSweep, PhotometricErrorReport, provenance
    from data_schemas.storage import ProductSet, read_record, write_record
    from finray_calib.decide import decide
    from finray_calib.reports import decision_page

    out = require_new(arguments.out or Path("light-angle-decision.json"))
    page = new_page_beside(out)
    paths = [arguments.sweep, *arguments.reports]
    sweep = read_record(arguments.sweep, LightAngleSweep)
    reports = [read_record(path, PhotometricErrorReport) for path in arguments.reports]
    with naming(DecideError, *paths):
        decision = decide(sweep, reports, arguments.seed, arguments.narrow_sweep)
    inputs = input_digests(paths)
    with ProductSet(out) as products:
        products.add(page, decision_page(decision, sweep, command_line(), inputs).encode())
        write_record(decision, out, provenance(command_line(), inputs, arguments.seed), products)
    say(f"{out}: {decision.verdict.upper()}")
    say(f"  {decision.sentence}")
    say(f"{page}: written, for whoever mounts the light")
