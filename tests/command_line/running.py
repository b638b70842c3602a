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
from finray_calib.cli import _output as options
from finray_calib.cli.main import main
from tests.schemas.stored_files import seal_again

SCRIPTS = Path(__file__).parents[2] / "docs" / "how-to" / "use-finray-in-a-script.md"
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
    if status in (0, 1) and not {"-h", "--help", "--version"} & set(words):
        require_documented(options.spoken(status))
    return Outcome(status, out.getvalue(), err.getvalue())


def documented() -> dict[str, set[str]]:
    """Return command -> keys that the page on scripts says its result may have; "import", "study": any other of it."""
    table = SCRIPTS.read_text(encoding="utf-8").partition("| command | keys")[2]
    found: dict[str, set[str]] = {}
    for row in table.splitlines()[2:]:
        _, names, keys, _ = row.split("|")
        commands = re.findall("`([a-z -]+)`", names) or ["study"]
        found |= {command: set(re.findall(r"`(\w+)`", keys)) for command in commands}
    return found


def require_documented(spoken: dict[str, Any]) -> None:
    """Check that what ``--json`` would print of the last command is JSON, and that the page names its keys."""
    json.dumps(spoken, allow_nan=False)
    known, command = documented(), spoken["command"]
    keys = known[command] if command in known else known[command.split()[0]]
    assert spoken["result"], f"{command}: a program gets no result"
    assert set(spoken["result"]) <= keys, f"{command}: {SCRIPTS.name} lacks {set(spoken['result']) - keys}"


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
