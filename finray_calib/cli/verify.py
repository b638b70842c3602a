"""``finray verify``: whether all that a folder holds is as it was written."""

import argparse
from pathlib import Path

from finray_calib.cli.options import say
from finray_calib.cli.trace import NOT_WHOLE, print_faults

HELP = "check that a session or a folder of products is as it was written"
DESCRIPTION = """\
Hash every file of a folder again that a record, a session or checksums speak of, and name what is missing, was changed,
or was made anew since something was made from it ("stale"). In a session, record, journal, checksums and frames are
compared with each other as well; of records, also the inputs that lie elsewhere are looked for (see 'finray trace').

The checksums detect accidents and edits, not forgery: whoever changes a file on purpose can compute them anew.
Exit status: 0 where all is whole, 1 where something is not, 2 for mistakes."""
MOST_NOTES = 10


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "verify", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of a session, of a demo or of products")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Verify, print the findings and return the exit status."""
    from finray_calib.lineage.verify_folder import verify_folder

    check = verify_folder(arguments.folder)
    for note in check.notes[:MOST_NOTES]:
        say(f"note: {note}")
    if len(check.notes) > MOST_NOTES:
        say(f"note: and {len(check.notes) - MOST_NOTES} more notes; 'finray trace RECORD' shows those of a record")
    print_faults(check.faults)
    if check.faults:
        return NOT_WHOLE
    say(f"{arguments.folder}: whole: {check.hashed} files, {len(check.records)} records among them")
    return 0
