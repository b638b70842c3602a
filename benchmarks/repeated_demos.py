"""Run ``finray demo`` many times, on free and on busy cores, and count how it ended.

    python -m benchmarks.repeated_demos [--free 20] [--busy 10] [--out bench-out/repeated-demos]

Every run starts in a new folder and a new process; a busy run has as many endless loops beside it as there are cores.
One line of ``runs.jsonl`` a run, written when it ends; a study that was stopped goes on with what is missing of this
commit. What a run that failed has printed stays beside it. Exit status 1 when any run failed.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST_S = 3600.0


@contextmanager
def busy_cores(loops: int) -> Iterator[None]:
    """Keep cores busy by endless loops in processes of their own."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def commit() -> str:
    """Return the commit of the tree, marked where it has changes."""
    return subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.strip()


def run_once(folder: Path, number: int, load: str) -> dict[str, object]:
    """Run the demo once; keep its folder only where it failed."""
    out = folder / f"{load}-{number}"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    command = [sys.executable, "-X", "faulthandler", "-m", "finray_calib.cli.main", "demo", "--out", str(out / "demo")]
    with busy_cores((os.cpu_count() or 1) if load == "busy" else 0), (out / "printed.txt").open("wb") as printed:
        before, start = os.times(), time.perf_counter()
        try:
            status = subprocess.run(command, stdout=printed, stderr=printed, timeout=LONGEST_S, check=False).returncode
        except subprocess.TimeoutExpired:
            status = None
        clock_s, after = time.perf_counter() - start, os.times()
    report = next(iter((out / "demo").rglob("*.html")), None)
    row = {
        "load": load,
        "status": status,
        "report": report is not None,
        "clock_s": round(clock_s, 1),
        "processor_s": round(sum(after[2:4]) - sum(before[2:4]), 1),
        "commit": commit(),
        "python": sys.version.split()[0],
    }
    if status == 0 and report is not None:
        shutil.rmtree(out)
    return row


def main() -> int:
    """Run what is missing, print the counts; return 1 when a run failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--free", type=int, default=20)
    parser.add_argument("--busy", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("bench-out/repeated-demos"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    log, here = arguments.out / "runs.jsonl", commit()
    known = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    rows = [row for row in known if row["commit"] == here]
    for load, wanted in (("free", arguments.free), ("busy", arguments.busy)):
        for number in range(sum(row["load"] == load for row in rows), wanted):
            row = run_once(arguments.out, number, load)
            rows.append(row)
            with log.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(row, flush=True)
    failed = [row for row in rows if row["status"] != 0 or not row["report"]]
    for load in ("free", "busy"):
        times = sorted(row["clock_s"] for row in rows if row["load"] == load)
        ended = sum(row["load"] == load for row in rows) - sum(row["load"] == load for row in failed)
        if times:
            print(f"{load}: {ended} of {len(times)} ended well, {times[0]:.0f} to {times[-1]:.0f} s")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
