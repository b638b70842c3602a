"""``finray doctor``: whether this machine can run the demo, and what to do where it cannot."""

import argparse
import textwrap
from typing import TYPE_CHECKING

from finray_calib.cli.options import say

if TYPE_CHECKING:
    from finray_calib.demo.machine_checks import Finding

HELP = "tell what this machine lacks, each with the command that mends it"
DESCRIPTION = """\
Look at Python, processor, renderer, contact library, solver, compiler, memory, disk, caches and serial ports, each by
using it in a process of its own, in at most 15 s. Every line is good; or a note: the demo runs without it, slower or
with less; or bad: the demo does not run; with the command that mends it. Nothing is changed.

The exit status is 0 when this machine can run the demo, else 1."""
NAME_WIDTH, WIDTH = 14, 80


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "doctor", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Look and tell; 1 where the demo would not run."""
    from data_schemas.provenance import package_version
    from finray_calib.demo.machine_checks import check_machine

    say(f"finray {package_version()} on this machine:\n")
    bad = 0
    for finding in check_machine():
        say(line_of(finding))
        bad += finding.state == "bad"
    if not bad:
        say("\nThis machine can run the demo: finray demo")
        return 0
    say("\nThis machine cannot run the demo before what is marked 'bad' is mended.")
    return 1


def line_of(finding: "Finding") -> str:
    """Return a finding as lines of at most 80 characters, but for a command or a path that is longer itself."""
    first = f"  {finding.state:<5}{finding.name:<{NAME_WIDTH}}"
    text = textwrap.fill(
        finding.found, WIDTH, initial_indent=first, subsequent_indent=" " * len(first), break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip
    return f"{text}\n{' ' * len(first)}-> {finding.mend}" if finding.mend else text
