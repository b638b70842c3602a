"""Mutated files through every reader: none may end in a traceback, crash, hang or fill the memory.

Every case is one mutation of one file of a valid example, drawn by its seed, and runs in a process of its own. Results
are appended to a file of JSON lines: a study that was stopped goes on where it was.

    python benchmarks/fuzz_readers.py --out bench-out/fuzz-readers.jsonl --rounds 180
"""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.fuzz.examples import READERS
from tests.fuzz.host import ACCEPTED, FAULTS, REFUSED, Host

ROUNDS = 180
"""28 readers times 180, and two in every twentieth round: 5,058 mutations."""


def main() -> int:
    """Run what is not yet done, and tell."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--only", default="", help="readers whose name holds this")
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    results = _done(arguments.out)
    chosen = [reader for reader in READERS if arguments.only in reader.name]
    with Host() as host, arguments.out.open("a") as file:
        for seed in range(arguments.rounds):
            for reader in (r.name for r in chosen if seed % r.every == 0):
                if (reader, seed) in results:
                    continue
                found = host.run(reader, seed)
                results[reader, seed] = found
                file.write(json.dumps(found) + "\n")
                file.flush()
                if found["outcome"] in FAULTS:
                    print(f"{found['outcome']}: {reader}, seed {seed}: {found['words']}: {found['text'][-300:]}")
    print(table(list(results.values())))
    return int(any(r["outcome"] in FAULTS for r in results.values()))


def _done(path: Path) -> dict[tuple[str, int], dict[str, Any]]:
    """Return the results of an earlier run."""
    lines = path.read_text().splitlines() if path.exists() else []
    found = [json.loads(line) for line in lines]
    return {(r["reader"], r["seed"]): r for r in found}


def table(results: list[dict[str, Any]]) -> str:
    """Return outcomes by reader and by class of mutation as Markdown."""
    columns = (REFUSED, ACCEPTED, "unchanged", *FAULTS)
    parts = []
    for key in ("reader", "mutation"):
        rows = [f"| {key} | mutations | {' | '.join(columns)} |", "|---" * (len(columns) + 2) + "|"]
        for name in sorted({r[key] for r in results}):
            counts = Counter(r["outcome"] for r in results if r[key] == name)
            rows.append(f"| {name} | {counts.total()} | " + " | ".join(str(counts[c]) for c in columns) + " |")
        counts = Counter(r["outcome"] for r in results)
        rows.append(f"| all | {counts.total()} | " + " | ".join(str(counts[c]) for c in columns) + " |")
        parts.append("\n".join(rows))
    slowest = max((r["cpu_s"] for r in results), default=0.0)
    most = max((r["memory_mb"] for r in results), default=0.0)
    parts.append(f"longest case {slowest:.1f} s of processor time, most memory {most:.0f} MB")
    return "\n\n".join(parts)


if __name__ == "__main__":
    sys.exit(main())
