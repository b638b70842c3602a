"""Whether the angle that was decided on from a few places is the best of brute force over many, interpolating nothing.

    finray simulate sweep flat-70x35.toml --paint red=RED --paint green=GREEN --angles 4:49:3 \\
        --positions $(python -c "print(','.join(f'{8 + 56 * k / 44:.3f}' for k in range(45)))") \\
        --seed 7 --out brute/b.sweep.json
    python benchmarks/brute_force_angle.py light-angle-decision.json brute/b.*mm.sweep.json

The sweeps take some minutes and go on where they were cut off. They are of other places and of another seed than those
of the decision, whose angle should be among theirs: values are compared at swept angles only, at the one nearest to the
decided one. Returns 1 where its value is below 0.99 of the best.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from data_schemas import LightAngleDecision, LightAngleSweep
from data_schemas.storage import read_record

LEAST_SHARE = 0.99


def main() -> int:
    """Compare, and print a line for each way to weigh the places."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("decision", type=Path)
    parser.add_argument("sweeps", type=Path, nargs="+")
    arguments = parser.parse_args()
    decision = read_record(arguments.decision, LightAngleDecision)
    sweeps = [read_record(path, LightAngleSweep) for path in arguments.sweeps]
    angles_deg = sweeps[0].angles_deg
    # each repeat over its own mean: they share no scale
    curves = np.array([(sweep.values / sweep.values.mean(axis=0)).mean(axis=1) for sweep in sweeps])
    relative = curves / curves.max(axis=1, keepdims=True)
    value = relative.mean(axis=0) if decision.criterion == "average" else relative.min(axis=0)
    nearest, best = int(np.abs(angles_deg - decision.angle_deg).argmin()), int(value.argmax())
    share = float(value[nearest] / value[best])
    print(
        f"{len(sweeps)} places, {decision.criterion}: decided {decision.angle_deg:g} deg; at {angles_deg[nearest]:g} "
        f"deg {value[nearest]:.4f}, best {value[best]:.4f} at {angles_deg[best]:g} deg: {share:.4f} of it "
        f"(at least {LEAST_SHARE}): {'met' if share >= LEAST_SHARE else 'NOT MET'}"
    )
    return int(share < LEAST_SHARE)


if __name__ == "__main__":
    sys.exit(main())
