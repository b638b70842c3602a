"""The small twin of benchmarks/coverage_of_intervals.py: the same script with 24 paints."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "coverage_of_intervals.py"
PAINTS = 24
ERROR_RATE = 1e-3


@pytest.mark.timeout(280)
def test_intervals_hold_the_truth_as_often_as_they_say(tmp_path):
    out = tmp_path / "coverage.json"
    options = ["--paints", str(PAINTS), "--seed", "20261121", "--error-rate", str(ERROR_RATE), "--out", str(out)]
    options += ["--most-steps", "1000"]
    run = subprocess.run([sys.executable, SCRIPT, *options], capture_output=True, text=True, check=False, timeout=270)
    assert run.returncode == 0, run.stdout + run.stderr
    record = json.loads(out.read_text())
    assert len(record["paints"]) == PAINTS
    for name, row in record["table"].items():
        for level in ("95", "68"):
            low, high = row[f"limits{level}"]
            assert low <= row[f"hits{level}"] <= high, name
        # Kolmogorov-Smirnov at the same declared rate
        assert row["rank_uniformity_p"] > ERROR_RATE, name
