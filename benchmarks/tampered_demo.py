"""Fifty changes of a real finished demo, each found by ``finray verify`` and, in its tree, by ``finray trace``.

    python benchmarks/tampered_demo.py finray-demo

The demo itself is not touched: each change is made to a copy. What was done already is read from the log beside the
demo (DEMO.tampered.jsonl), so that an interrupted run goes on.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.lineage.tamperings import DECISION, TAMPERINGS, Tampering


def main() -> int:
    """Make the changes that are left and print the table; 1 where one was not found."""
    demo = Path(sys.argv[1]).resolve()
    log = demo.with_name(f"{demo.name}.tampered.jsonl")
    done = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    known = {(entry["group"], entry["what"]) for entry in done}
    if not done and (outcome := _finray("verify", demo)).returncode:
        sys.stdout.write(outcome.stdout)
        return 1
    for tampering in TAMPERINGS:
        if (tampering.group, tampering.what) not in known:
            entry = _tampered(demo, tampering)
            done.append(entry)
            with log.open("a") as file:
                file.write(json.dumps(entry) + "\n")
    for entry in done:
        sys.stdout.write(f"{'found' if entry['found'] else 'MISSED'}  {entry['group']}: {entry['what']}\n")
    found = sum(entry["found"] for entry in done)
    sys.stdout.write(f"{found} of {len(done)} found\n")
    return 0 if found == len(TAMPERINGS) else 1


def _tampered(demo: Path, tampering: Tampering) -> dict[str, object]:
    """Change a copy of the demo and say whether both commands find it and name the file."""
    with tempfile.TemporaryDirectory(dir=demo.parent) as made:
        folder = Path(made) / demo.name
        shutil.copytree(demo, folder, symlinks=True)
        tampering.change(folder)
        verified, traced = _finray("verify", folder), _finray("trace", folder / DECISION)
    by_verify = verified.returncode == 1 and _names(verified.stdout, tampering.named)
    by_trace = traced.returncode == 1 and _names(traced.stdout, tampering.named)
    found = by_verify and by_trace == tampering.in_tree
    return {"group": tampering.group, "what": tampering.what, "found": found, "verify": by_verify, "trace": by_trace}


def _finray(verb: str, path: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "finray_calib.cli.main", verb, str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _names(said: str, file: str) -> bool:
    """Whether a finding names the file."""
    findings = said.partition("NOT AS WRITTEN")[2].splitlines()[1:]
    return any(file in line for line in findings)


if __name__ == "__main__":
    sys.exit(main())
