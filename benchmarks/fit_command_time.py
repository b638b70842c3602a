"""Wall time of ``finray fit BANDS``, the whole process, with a warm and with an empty cache of compiled code.

As users run it: no limits on threads, Python's byte code kept.

    python benchmarks/fit_command_time.py --out bench-out/fit-command.json
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.paint_problems import paint_signals
from data_schemas import provenance
from data_schemas.storage import write_record

WARM_BAR_S, COLD_BAR_S = 3.0, 20.0
NOT_SET_BY_USERS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "PYTHONDONTWRITEBYTECODE")


def fit_seconds(bands: Path, out: Path, cache: Path) -> dict[str, float]:
    """Run the command once; return its wall seconds and the processor seconds of its process."""
    environment = {name: value for name, value in os.environ.items() if name not in NOT_SET_BY_USERS}
    environment["NUMBA_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-m", "finray_calib.cli.main", "fit", str(bands), "--seed", "1", "--out", str(out)]
    before, start = os.times(), time.perf_counter()
    subprocess.run(command, env=environment, check=True, capture_output=True)
    wall, after = time.perf_counter() - start, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return {"wall_s": wall, "processor_s": used}


def main() -> int:
    """Time the command, print, store; return 1 when a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--warm-runs", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bands, cache = folder / "orange.bands.json", folder / "compiled"
        write_record(paint_signals(arguments.seed), bands, provenance("fit_command_time", {}, arguments.seed))
        cold = fit_seconds(bands, folder / "cold.paint.json", cache)
        warm = [fit_seconds(bands, folder / f"warm{i}.paint.json", cache) for i in range(arguments.warm_runs)]
    warm_s = float(np.median([run["wall_s"] for run in warm]))
    processor_s = float(np.median([run["processor_s"] for run in warm]))
    print(f"finray fit, warm: {warm_s:.2f} s wall, {processor_s:.2f} s of one processor (bar {WARM_BAR_S:g} s)")
    print(f"finray fit, cold: {cold['wall_s']:.2f} s wall, {cold['processor_s']:.2f} s (bar {COLD_BAR_S:g} s)")
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        record = {"warm_s": warm_s, "cold_s": cold["wall_s"], "warm_runs": warm, "cold_run": cold}
        arguments.out.write_text(json.dumps(record, indent=1))
    return 0 if warm_s < WARM_BAR_S and cold["wall_s"] < COLD_BAR_S else 1


if __name__ == "__main__":
    sys.exit(main())
