"""``finray fit``: the emission spectrum of a paint with its uncertainty."""

import argparse
from pathlib import Path

from finray_calib.cli.options import (
    add_out,
    add_seed,
    command_line,
    file_name,
    input_digests,
    naming,
    progress_bar,
    require_new,
    say,
)

HELP = "fit the emission spectrum of a paint, with uncertainty"
DESCRIPTION = """\
Fit the paper's skew-Cauchy emission spectrum to band signals: NLopt finds the maxima of the posterior, emcee
samples it. Writes the posterior draws, the spectrum with its 95 % band, how well each filter is explained,
and convergence diagnostics."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "fit", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bands", type=Path, metavar="BANDS", help="record written by 'finray radiometry'")
    add_out(parser, "PAINT.paint.json")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Fit and report."""
    from data_schemas.errors import FitError
    from data_schemas.provenance import provenance
    from data_schemas.radiometry import BandSignals
    from data_schemas.storage import read_record, write_record
    from finray_calib.fit.paint_calibration import calibrate_paint

    bands = read_record(arguments.bands, BandSignals)
    out = require_new(arguments.out or Path(f"{file_name(bands.paint_name)}.paint.json"))
    with progress_bar("fit"), naming(FitError, arguments.bands):
        paint = calibrate_paint(bands, arguments.seed)
    write_record(paint, out, provenance(command_line(), input_digests([arguments.bands]), arguments.seed))
    say(f"{out}: emission of '{paint.paint_name}' ({paint.family})")
    for name in ("mode_nm", "fwhm_nm"):
        value = paint.parameters[name]
        interval = f"[{value.low95:.1f}, {value.high95:.1f}] nm (95 %)"
        say(f"  {name.removesuffix('_nm'):10s} {value.estimate:.1f} {interval}")
    y = paint.energy_yield
    say(f"  yield      {y.estimate:.3f} [{y.low95:.3f}, {y.high95:.3f}] (95 %)")
    say(f"  chi-square {paint.chi_square:.1f} for {paint.degrees_of_freedom} degrees of freedom")
    for warning in paint.warnings:
        say(f"  warning: {warning}")
