"""`finray decide` and `finray fit --report` as real processes, killed or refused by the kernel at their system calls.

    python -m benchmarks.kernel_faults --out bench-out/kernel-faults.json [--verbs decide] [--every 1]

Independent of `benchmarks.commit_points`, whose points are calls of Python's ``os``: here strace (apt-get install
strace) lists the system calls of a whole run that open, write, name, remove or synchronise something below the output
folders, and then has the kernel kill the process, or answer ENOSPC or EIO, at each of them. Then the same command runs
again. Bar: nothing is harmed, no half set passes for whole, the second run completes, nothing stays.
"""

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

from data_schemas import provenance
from data_schemas.storage import write_record
from data_schemas.storage._product_set import is_complete
from tests.command_line.records import capture_of, press, sweep, with_known_camera
from tests.command_line.running import succeed
from tests.command_line.verb_faults import fresh_folders, products
from tests.documentation.example_records import example_results

CALLS = (
    "openat", "write", "fsync", "link", "linkat", "rename", "renameat", "renameat2", "unlink", "unlinkat", "mkdir",
    "mkdirat",
)  # fmt: skip
HOW = ("signal=SIGKILL", "error=ENOSPC", "error=EIO")
VERBS = {
    "decide": ("decide {i}/sweep.json --photometric-error {i}/report.json --out {o}/d.json", "d.json"),
    "fit": ("fit {i}/bands.json --out {o}/red.paint.json --report {e}/red.html", "red.paint.json"),
}
_LINE = re.compile(r"(?:\[pid +)?(\d+)\]? +(\w+)\((.*)")


class Point(NamedTuple):
    """The `number`-th time (from 1) that a thread makes a system call."""

    call: str
    number: int


class Run:
    """One command, run as a process of its own in fresh folders."""

    def __init__(self, words: str, commit: str, top: Path):
        self.here, self.there, self._log, self._commit = top / "here", top / "there", top / "strace", commit
        python = [sys.executable, "-m", "finray_calib.cli.main"]
        self._command = [*python, *shlex.split(words.format(i=top / "inputs", o=self.here, e=self.there))]
        self._environment = {**os.environ, "PYTHONHASHSEED": "0", "PYTHONDONTWRITEBYTECODE": "1"}

    def fresh(self) -> dict[str, bytes]:
        """Make the folders anew, with files of the user, and return what lies in them."""
        return fresh_folders(self.here, self.there)

    def run(self, *strace: str) -> tuple[int, str]:
        """Run, below strace where something is asked of it; return exit status and standard error."""
        below = ["strace", "-f", "-y", "-o", str(self._log), *strace] if strace else []
        done = subprocess.run([*below, *self._command], env=self._environment, capture_output=True, check=False)
        return done.returncode, done.stderr.decode()

    def points(self) -> list[Point]:
        """Return the system calls of a whole run that touch the output folders."""
        self.fresh()
        status, said = self.run("-e", f"trace={','.join(CALLS)}")
        assert status == 0, said
        self.whole = products(self.here, self.there)
        seen: Counter[tuple[str, str]] = Counter()
        found = []
        for line in self._log.read_text(errors="replace").splitlines():
            made = _LINE.match(line)
            if made is None or made[2] not in CALLS:
                continue
            seen[made[1], made[2]] += 1
            if self._touches(made[2], made[3]) and (made[2] != "openat" or "O_CREAT" in made[3] or "O_RDWR" in made[3]):
                found.append(Point(made[2], seen[made[1], made[2]]))
        return found

    def _touches(self, call: str, text: str) -> bool:
        """Whether the arguments of a system call name something in the output folders; of a write, its file does."""
        if call == "write":
            text = text.partition(">")[0] + ">"
        return any(f"{folder}/" in text or f"<{folder}>" in text for folder in (self.here, self.there))

    def try_at(self, point: Point, how: str) -> str:
        """Inject a fault, look at what is there, run again, look again; return what became of the first run."""
        before = self.fresh()
        asked = ("-e", f"trace={point.call}", "-e", f"inject={point.call}:{how}:when={point.number}")
        status, said = self.run(*asked)
        lines = self._log.read_text(errors="replace").splitlines()
        # The log ends where the process does.
        made = [found for line in lines if (found := _LINE.match(line)) and found[2] == point.call]
        hit = [found[3] for found in made if "(INJECTED)" in found[3] or "signal" in how][-1:]
        if not any(self._touches(point.call, text) for text in hit):
            return "another call was hit"
        what = f"{point}, {how}: status {status}, {said.strip()[-300:]}"
        assert "Traceback" not in said, what
        now = products(self.here, self.there)
        assert before.items() <= now.items(), what
        is_there = all(now.get(path) == content for path, content in self.whole.items())
        assert is_complete(self.here / self._commit) == is_there, what
        assert not (status == 2 and is_there), what
        named = any(path in now for path in self.whole.keys() - before.keys())
        again, told = self.run()
        assert again == (2 if is_there else 0), f"{what}; the rerun: {told}"
        after = products(self.here, self.there)
        assert after == self.whole, f"{what}; differ: {sorted(after.items() ^ self.whole.items(), key=str)[:2]}"
        return f"{how.partition('=')[2]}, {'whole' if is_there else 'half set' if named else 'absent'} before the rerun"


def main() -> int:
    """Try both verbs and return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--verbs", nargs="+", default=list(VERBS), choices=list(VERBS))
    parser.add_argument("--every", type=int, default=1, help="try every so manieth point only")
    arguments = parser.parse_args()
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        laboratory(top / "inputs")
        for verb in arguments.verbs:
            run = Run(*VERBS[verb], top)
            points = run.points()[:: arguments.every]
            ended: Counter[str] = Counter()
            failures = []
            for how in HOW:
                for point in points:
                    try:
                        ended[run.try_at(point, how)] += 1
                    except AssertionError as failed:
                        failures.append(str(failed))
            found[verb] = {
                "points": len(points),
                "calls": dict(Counter(point.call for point in points)),
                "ended": dict(sorted(ended.items())),
                "failures": failures,
            }
            sys.stdout.write(f"{verb}: {json.dumps(found[verb])}\n")
            sys.stdout.flush()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps({"verbs": found}, indent=1) + "\n")
    return 1 if any(one["failures"] for one in found.values()) else 0


def laboratory(folder: Path) -> None:
    """Write what the verbs read."""
    linear, origin = with_known_camera(press()), provenance("benchmark")
    for name, record in {
        "press": linear,
        "capture": capture_of(linear, 50.0),
        "sweep": sweep(),
        "bands": example_results().paints["red"].bands,
    }.items():
        write_record(record, folder / f"{name}.json", origin)
    succeed(f"compare {folder}/press.json {folder}/capture.json --out {folder}/report.json")


if __name__ == "__main__":
    sys.exit(main())
