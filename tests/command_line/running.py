"""Run the command line in this process and look at the files it reads and writes."""

import json
import math
import os
import re
import shlex
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any
from unittest.mock import patch

from data_schemas.storage import sha256_of
from finray_calib.cli import _run as options
from finray_calib.cli.main import main
from tests.schemas.stored_files import seal_again

PROGRESS = re.compile(r"[a-z]+: .+ \(\d+ of \d+\)")


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a user sees: exit status, standard output, standard error."""

    status: int
    out: str
    err: str


def finray(arguments: str) -> Outcome:
    """Run ``finray ARGUMENTS`` as a shell would split them."""
    out, err = StringIO(), StringIO()
    words = shlex.split(arguments)
    # How far a command is, it tells now and then by the clock: on a busy machine more often.
    silent = patch.object(options, "LOG_INTERVAL_S", math.inf)
    with silent, patch.object(sys, "argv", ["finray", *words]), redirect_stdout(out), redirect_stderr(err):
        try:
            status = main()
        except SystemExit as stop:  # how argparse ends
            status = int(stop.code or 0)
    return Outcome(status, out.getvalue(), err.getvalue())


def succeed(arguments: str) -> str:
    """Run ``finray ARGUMENTS``, which must succeed and keep standard error empty; return its output.

    Lines of progress may stand there: a busy machine is slow enough for them, a free one is not.
    """
    outcome = finray(arguments)
    told = [line for line in outcome.err.splitlines() if not PROGRESS.fullmatch(line)]
    assert (outcome.status, told) == (0, []), outcome.err
    return outcome.out


def tree(*folders: Path) -> dict[str, str]:
    """Return path -> SHA-256 of every file, and "folder" for every folder."""
    return {
        os.fspath(path): "folder" if path.is_dir() else sha256_of(path)
        for folder in folders
        for path in sorted(folder.rglob("*"))
    }


def load(path: Path) -> dict[str, Any]:
    """Return a stored record's JSON."""
    return dict(json.loads(path.read_text(encoding="utf-8")))


def edit(path: Path, old: str, new: str) -> None:
    """Replace a text that stands in a file at least once, at its first place; a sealed record is sealed anew."""
    text = path.read_text(encoding="utf-8")
    assert old in text, f"{path} holds no {old!r}"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    seal_again(path)
