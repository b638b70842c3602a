"""The program CalculiX: found, run on a deck in a process of its own, ended in time."""

import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from data_schemas.errors import MissingExtraError
from data_schemas.foreign_files import read_bytes

PROGRAM: Final = "ccx"
JOB: Final = "finger"
"""Name, without its ending, of every file of a run."""

_POLL_S = 0.2
_ENDS_WITHIN_S = 5.0


def find_calculix() -> str:
    """Return the path of CalculiX.

    Raises
    ------
    MissingExtraError
        When it is not installed.
    """
    path = shutil.which(PROGRAM)
    if path is None:
        raise MissingExtraError(
            f"CalculiX (the program {PROGRAM}) is not installed or not on the PATH; on Debian and Ubuntu: apt-get "
            "install calculix-ccx. Without it, press with the engine in process"
        )
    return path


def calculix_version() -> str:
    """Return the version of the installed CalculiX, for example "2.20".

    Raises
    ------
    MissingExtraError
        When it is not installed.
    """
    said = subprocess.run([find_calculix(), "-v"], capture_output=True, text=True, timeout=60.0, check=False).stdout
    found = re.search(r"Version\s+(\S+)", said)
    return found[1] if found else "of unknown version"


def run_calculix(
    lines: Iterable[str],
    folder: Path,
    threads: int = 1,
    time_limit_s: float = 3600.0,
    watch: Callable[[Path], None] | None = None,
) -> str:
    """Run CalculiX on a deck in a folder; its results are finger.frd, finger.dat and finger.sta there.

    Parameters
    ----------
    lines
        Of the deck.
    folder
        An empty folder.
    threads
        Of assembly and solver.
    time_limit_s
        After which the run is ended.
    watch
        Called several times a second with the folder.

    Returns
    -------
    str
        Why it ended early; empty when it did not.

    Raises
    ------
    MissingExtraError
        When CalculiX is not installed.
    """
    program = find_calculix()
    with (folder / f"{JOB}.inp").open("w", encoding="ascii") as deck:
        deck.writelines(f"{line}\n" for line in lines)
    # unbuffered: the totals of a run that is ended are those of its last increment
    count = str(threads)
    limits = {"OMP_NUM_THREADS": count, "CCX_NPROC_EQUATION_SOLVER": count, "GFORTRAN_UNBUFFERED_ALL": "y"}
    log = folder / f"{JOB}.log"
    end = time.monotonic() + time_limit_s
    with log.open("wb") as out:
        process = subprocess.Popen(
            [program, "-i", JOB],
            cwd=folder,
            env={**os.environ, **limits},
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            while process.poll() is None and time.monotonic() < end:
                if watch is not None:
                    watch(folder)
                time.sleep(_POLL_S)
            late = process.poll() is None
        finally:
            _end(process)
    if late:
        return f"CalculiX was ended after {time_limit_s:g} s; take a coarser mesh or a smaller push"
    return _complaint(read_bytes(log, "the log of CalculiX").decode("ascii", "replace"), process.returncode)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process that still runs, with what it has started."""
    for ending in (signal.SIGTERM, signal.SIGKILL):
        if process.poll() is not None:
            return
        os.killpg(process.pid, ending)
        try:
            process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            continue


def _complaint(log: str, status: int) -> str:
    """Return why a run ended early."""
    if "Job finished" in log:
        return ""
    said = re.search(r"\*ERROR[:\s]*(.*(?:\n {4,}\S.*)*)", log)
    reason = " ".join(said[1].split()) if said else f"it ended with status {status}"
    return f"CalculiX stopped: {reason}"
