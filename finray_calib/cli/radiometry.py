"""``finray radiometry``: turn the frames of a session into band signals with covariance."""

import argparse
from pathlib import Path

from finray_calib.cli.options import (
    add_out,
    command_line,
    file_name,
    input_digests,
    naming,
    progress_bar,
    require_new,
    say,
)

HELP = "turn captured frames into one value per filter and channel, with covariance"
DESCRIPTION = """\
Correct a paint session for dark level and exposure, refer it to the white reference, and write one value per
filter and Bayer channel over the painted region: fluorescence (under the laser) and reflectance (under the
lamp), each with its full covariance and quality flags."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "radiometry", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("session", type=Path, metavar="SESSION", help="folder written by 'finray capture'")
    add_out(parser, "PAINT.bands.json")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Reduce and report."""
    from data_schemas.errors import RadiometryError
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record
    from finray_calib.radiometry.band_signals import band_signals
    from rigs.capture.paint_session import SESSION_NAME
    from rigs.capture.read_session import read_frame_of, read_session

    session = read_session(arguments.session)
    out = require_new(arguments.out or Path(f"{file_name(session.plan.paint_name)}.bands.json"))
    with progress_bar("radiometry"), naming(RadiometryError, arguments.session):
        bands = band_signals(session, lambda frame: read_frame_of(arguments.session, frame))
    write_record(bands, out, provenance(command_line(), input_digests([arguments.session / SESSION_NAME])))
    say(f"{out}: {len(bands.flags)} filters x 3 channels over {bands.region_pixels} px")
    for band, row in zip(bands.optics.filters, bands.flags, strict=True):
        bad = [f"{name} {flag}" for name, flag in zip(("red", "green", "blue"), row, strict=True) if flag != "ok"]
        if bad:
            say(f"  filter {band.name}: {', '.join(bad)}")
    for note in bands.notes:
        say(f"  note: {note}")
