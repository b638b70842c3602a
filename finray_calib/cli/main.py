"""The command ``finray``: six verbs, one per stage, and what stands beside them."""

import argparse
import atexit
import errno
import gc
import os
import sys
from collections.abc import Sequence

from data_schemas import DiedError, FinrayError, system_words
from data_schemas.storage import OBJECTS_PER_COLLECTION
from finray_calib.cli import (
    add_capture,
    add_certificate,
    add_check,
    add_compare,
    add_decide,
    add_demo,
    add_design,
    add_doctor,
    add_export,
    add_fit,
    add_history,
    add_import,
    add_live,
    add_radiometry,
    add_recolour,
    add_rig,
    add_sense,
    add_simulate,
    add_study,
    add_trace,
    add_verify,
    spelled_now,
)
from finray_calib.cli._run import say, warn

USER_MISTAKE = 2
DIED = 3
INTERRUPTED = 130
TO_DO = {
    errno.ENOSPC: "free space on the disk, then run the command again",
    errno.EDQUOT: "your share of the disk is used up: free space, then run the command again",
    errno.EFBIG: "the file system, or 'ulimit -f', allows no larger file: write to another --out",
    errno.EIO: "the disk or the network folder has a fault ('dmesg' tells): write to another --out",
    errno.EROFS: "this disk can only be read: write to another --out",
    errno.ENOMEM: "close other programs, then run the command again",
    errno.EMFILE: "allow more open files with 'ulimit -n 4096', then run the command again",
    errno.ENFILE: "close other programs, then run the command again",
    errno.EPIPE: "a process that finray talked to has ended: run the command again",
    errno.ECONNRESET: "a process that finray talked to has ended: run the command again",
}
"""What to do about an error of the operating system that names no file."""
VERBS = {
    "capture": add_capture,
    "radiometry": add_radiometry,
    "fit": add_fit,
    "simulate": add_simulate,
    "recolour": add_recolour,
    "compare": add_compare,
    "sense": add_sense,
    "decide": add_decide,
    "import": add_import,
    "export": add_export,
    "rig": add_rig,
    "live": add_live,
    "check": add_check,
    "history": add_history,
    "certificate": add_certificate,
    "design": add_design,
    "study": add_study,
    "doctor": add_doctor,
    "trace": add_trace,
    "verify": add_verify,
    "demo": add_demo,
}
DESCRIPTION = """\
Calibrate fluorescent-paint tactile fingers: from a painted sample to a decision on the light angle.

  capture -> radiometry -> fit -> simulate -> compare -> decide

Each verb reads stored records and writes the next one. Start with: finray demo"""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line; heavy packages are not imported here."""
    parser = argparse.ArgumentParser(
        prog="finray", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action="store_true", help="print the version and stop")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", title="verbs")
    for add_verb in VERBS.values():
        add_verb(verbs)
    return parser


def main(arguments: Sequence[str] | None = None, in_own_process: bool = False) -> int:
    """Run the command line, a long verb in a process of its own if that is wanted, and return its exit status.

    0, 1 for a rig that is not accepted, records that are not whole or a machine that cannot run the demo, 2 for a
    user's mistake, 3 when the process of a long stage died, 130 when interrupted.
    """
    gc.set_threshold(OBJECTS_PER_COLLECTION)
    parser = build_parser()
    words = spelled_now(sys.argv[1:] if arguments is None else arguments)
    parsed, unknown = parser.parse_known_args(words)
    if unknown:
        verb = " ".join(filter(None, ("finray", parsed.verb, getattr(parsed, "job", None))))
        told = f"'{verb}' knows no {' '.join(unknown)}; '{verb} --help' lists what can be given"
        warn(f"finray {parsed.verb}: error: {told}")
        return USER_MISTAKE
    if parsed.verb is None and not parsed.version:
        parser.print_help()
        return USER_MISTAKE
    try:
        if parsed.version:
            from data_schemas import package_version

            say(f"finray {package_version()}")
            return 0
        describe = getattr(parsed, "long_work", None)
        if in_own_process and describe is not None:
            from finray_calib.cli._run import run_in_own_process

            return run_in_own_process(describe(parsed), words)
        status = parsed.run(parsed)
    except (FinrayError, OSError) as error:
        warn(f"finray {parsed.verb or '--version'}: error: {_one_line(error)}")
        return DIED if isinstance(error, DiedError) else USER_MISTAKE
    except KeyboardInterrupt:
        warn(f"finray {parsed.verb}: interrupted; files already written are complete")
        return INTERRUPTED
    return int(status or 0)


def _one_line(error: Exception) -> str:
    """Return the message in one line; errors of the operating system name the file and what to check."""
    text = str(error)
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {error.strerror}; check the path, its permissions and the space on the disk"
    elif isinstance(error, OSError):
        todo = TO_DO.get(error.errno or 0, "'finray doctor' says what this computer lacks")
        text = f"this computer: {system_words(error)}; {todo}"
    return " ".join(text.split())


def program() -> int:
    """Run :func:`main` as a process of its own, which ends without a last search for cycles: a tenth of a fit."""
    atexit.register(gc.freeze)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by who started us, as service managers may
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "r" if name == "stdin" else "w"))
    return main(in_own_process=True)


if __name__ == "__main__":
    sys.exit(program())
