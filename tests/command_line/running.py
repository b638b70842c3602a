"""Run the command line, in this process or as a program, and look at the files it reads and writes."""

import json
import math
import os
import re
import shlex
import signal
import subprocess
import sys
import time
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

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = ROOT / "docs" / "reference" / "keys-of-json-results.md"
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


class Program:
    """``finray`` as a user runs it, in a session of its own."""

    def __init__(self, arguments: str, folder: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "finray_calib.cli.main", *shlex.split(arguments)], cwd=folder, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": os.fspath(ROOT)},
            start_new_session=True,
        )  # fmt: skip

    def wait_for(self, path: Path, limit_s: float = 240.0) -> None:
        """Wait until it has written a file."""
        deadline = time.monotonic() + limit_s
        while not path.exists():
            assert self.process.poll() is None, self.end()
            assert time.monotonic() < deadline
            time.sleep(0.01)

    def kill(self) -> None:
        """Kill it and all its children."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.communicate()

    def children(self) -> list[int]:
        """Return the processes that it has started itself."""
        return children_of(self.process.pid)

    def end(self, limit_s: float = 280.0) -> tuple[int, str, str]:
        """Wait for its end; return exit status, standard output and standard error."""
        out, err = self.process.communicate(timeout=limit_s)
        return self.process.returncode, out, err


def children_of(pid: int) -> list[int]:
    """Return the processes that a process has started itself."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(fields[1]) == pid:
            found.append(int(stat.parent.name))
    return found


def documented() -> dict[str, set[str]]:
    """Return command -> keys that the page says its result may have; "import", "study": any other of it."""
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
