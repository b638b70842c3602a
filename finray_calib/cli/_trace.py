"""``finray trace`` and ``finray verify``: where a number comes from, and whether all of it is as it was written."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, is_for_a_terminal, say

if TYPE_CHECKING:
    from data_schemas.storage import FileFault
    from finray_calib.lineage import Traced


TRACE_HELP = "show what a record was made from, down to the frames, and check all of it"
TRACE_DESCRIPTION = """\
Show the tree of files that a record was made from, down to the captured frames, and hash all of them again. The command
names files that are missing, were changed, or were made again since ("stale"). It searches for inputs by their recorded
names, from the record's folder, the folders above it and the working directory, and by their SHA-256 beside the record.

With --replay the command that made the record is run again into a temporary folder, and its numbers are compared.

The checksums detect accidents and edits, not forgery: whoever changes a file on purpose can compute them anew.

Exit status: 0 where every file is unchanged, 1 where one is not, 2 for mistakes."""
NOT_AS_WRITTEN = 1
COLUMNS = 80


def add_trace(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("trace", help=TRACE_HELP, description=TRACE_DESCRIPTION)
    parser.add_argument("record", type=Path, metavar="RECORD", help="a stored record (.json)")
    parser.add_argument("--replay", action="store_true", help="compute the record again and compare the numbers")
    parser.set_defaults(run=run_trace)


def run_trace(arguments: argparse.Namespace) -> int:
    """Trace, print the tree and its findings, and return the exit status."""
    from finray_calib.lineage import Tracer, findings

    tracer = Tracer()
    tree = tracer.trace(arguments.record)
    print_tree(tree)
    faults = findings(tree)
    print_faults(faults)
    give(unchanged=not faults, files=len(tracer.digests), faults=_faults(faults), replay=None)
    frames = sum(part.frames for part in tree.all() if not part.is_repeated)
    dirty = sum(part.is_dirty for part in tree.all())
    if dirty:
        say(f"note: {dirty} of the records were made by source code that differed from the commit that they name")
    if not faults:
        say(f"unchanged: {len(tracer.digests)} files hashed, {frames} of them frames")
    if arguments.replay and not faults:
        return _replay(tree)
    return NOT_AS_WRITTEN if faults else 0


def print_tree(tree: "Traced") -> None:
    """Print a tree: with lines and colours on a terminal, plain and indented in a pipe or file."""
    if not is_for_a_terminal():
        for line in _plain(tree, 0):
            say(line)
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.tree import Tree

    def branch(part: "Traced") -> Tree:
        grown = Tree("\n".join(escape(line) for line in _lines(part)), style="" if not part.faults else "red")
        for inner in part.inputs:
            grown.children.append(branch(inner))
        return grown

    Console(width=COLUMNS, highlight=False).print(branch(tree))


def print_faults(faults: "tuple[FileFault, ...]") -> None:
    """Print what is not as it was written, one line each."""
    if not faults:
        return
    say(f"\nNOT AS WRITTEN: {len(faults)} finding{'s' if len(faults) > 1 else ''}")
    for fault in faults:
        say(f"{fault.state}: {fault.path}: {fault.text}")


def _faults(faults: "tuple[FileFault, ...]") -> list[dict[str, str]]:
    """Return what is not as it was written, for a program."""
    return [{"state": fault.state, "path": str(fault.path), "text": fault.text} for fault in faults]


def _plain(part: "Traced", depth: int) -> list[str]:
    """Return the lines of a tree, indented by two blanks a level."""
    own = ["  " * depth + line for line in _lines(part)]
    return own + [line for inner in part.inputs for line in _plain(inner, depth + 1)]


def _lines(part: "Traced") -> list[str]:
    """Return what is said of one file: its name, kind and state, then its notes."""
    states = sorted({fault.state.upper() for fault in part.faults})
    state = ", ".join(states) if states else "unchanged"
    kind = "" if part.kind == "file" else f"  {part.kind}"
    frames = f", {part.frames} frames" if part.frames else ""
    above = ", inputs as above" if part.is_repeated else ""
    return [f"{part.name}{kind}  {state}{frames}{above}", *(f"  note: {note}" for note in part.notes)]


def _replay(tree: "Traced") -> int:
    """Compute a record again and tell how its numbers compare."""
    from finray_calib.lineage import replay

    outcome = replay(tree)
    say(outcome.sentence)
    give(replay={"agrees": outcome.agrees, "sentence": outcome.sentence, "differences": outcome.differences})
    for difference in outcome.differences:
        say(f"  {difference}")
    return 0 if outcome.agrees else NOT_AS_WRITTEN


VERIFY_HELP = "check that a session or a folder of products is unchanged"
VERIFY_DESCRIPTION = """\
Hash again every file of a folder that a record, a session or a list of checksums names. The command names files that
are missing, were changed, or were made again after something was made from them ("stale"). In a session it also
compares record, journal, checksums and frames with each other. It also searches for inputs of records that lie
elsewhere (see 'finray trace').

The checksums detect accidents and edits, not forgery: whoever changes a file on purpose can compute them anew.

Exit status: 0 where every file is unchanged, 1 where one is not, 2 for mistakes."""
MOST_NOTES = 10


def add_verify(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("verify", help=VERIFY_HELP, description=VERIFY_DESCRIPTION)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of a session, of a demo or of products")
    parser.set_defaults(run=run_verify)


def run_verify(arguments: argparse.Namespace) -> int:
    """Verify, print the findings and return the exit status."""
    from finray_calib.lineage import verify_folder

    check = verify_folder(arguments.folder)
    give(unchanged=not check.faults, files=check.hashed, records=len(check.records), faults=_faults(check.faults))
    for note in check.notes[:MOST_NOTES]:
        say(f"note: {note}")
    if len(check.notes) > MOST_NOTES:
        say(f"note: and {len(check.notes) - MOST_NOTES} more notes; 'finray trace RECORD' shows those of a record")
    print_faults(check.faults)
    if check.faults:
        return NOT_AS_WRITTEN
    say(f"{arguments.folder}: unchanged: {check.hashed} files, {len(check.records)} records among them")
    return 0
