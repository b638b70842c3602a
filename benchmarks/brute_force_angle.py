"""Whether the angle that was decided on from a few places is the best of brute force over 45, interpolating nothing.

For a decision on the brightness of touches:

    finray simulate sweep flat-70x35.toml --paint red=RED --paint green=GREEN --angles 4:49:3 \\
        --positions $(python -c "print(','.join(f'{8 + 56 * k / 44:.3f}' for k in range(45)))") \\
        --seed 7 --out brute/b.sweep.json
    python benchmarks/brute_force_angle.py light-angle-decision.json --sweeps brute/b.*mm.sweep.json

The sweeps take some minutes and go on where they were cut off. For a decision on the error of the sensed normal, which
is measured here at 45 places along the pad, at every 5 deg (six minutes):

    python benchmarks/brute_force_angle.py light-angle-decision.json --design flat-70x35.toml --red RED --green GREEN

Both are of other places and of another seed than those of the decision, whose angle should be among theirs: values are
compared at swept angles only, at the one nearest to the decided one. Returns 1 where its value is below 0.99 of the
best.
"""

import argparse
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import finray_calib as finray
from data_schemas import LightAngleDecision, LightAngleSweep
from data_schemas.storage import read_record
from sim.experiments import _light_angle

LEAST_SHARE = 0.99
PLACES = 45
SEED = 7
STEP_DEG = 5.0


def main() -> int:
    """Compare, and print a line for each way to weigh the places."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("decision", type=Path)
    parser.add_argument("--sweeps", type=Path, nargs="+")
    parser.add_argument("--design", type=Path)
    parser.add_argument("--red", type=Path)
    parser.add_argument("--green", type=Path)
    arguments = parser.parse_args()
    decision = read_record(arguments.decision, LightAngleDecision)
    if (decision.aim == "normal") != (arguments.sweeps is None):
        parser.error(f"the decision is on {decision.aim}: see the two commands above")
    if arguments.sweeps is None:
        angles_deg, values = normals_over_angles(arguments.design, arguments.red, arguments.green, decision)
    else:
        angles_deg, values = brightness_over_angles(arguments.sweeps)
    relative = values / values.max(axis=1, keepdims=True)
    by_criterion = {
        "average": (relative.mean(axis=0), decision.angle_average_deg),
        "worst": (relative.min(axis=0), decision.angle_worst_deg),
    }
    shares = [
        compare(criterion, len(values), angles_deg, value, decided_deg)
        for criterion, (value, decided_deg) in by_criterion.items()
        if decided_deg is not None
    ]
    return int(min(shares) < LEAST_SHARE)


def compare(
    criterion: str, places: int, angles_deg: NDArray[np.float64], value: NDArray[np.float64], decided_deg: float
) -> float:
    """Print and return the value of the decided angle over that of the best one."""
    nearest, best = int(np.abs(angles_deg - decided_deg).argmin()), int(value.argmax())
    share = float(value[nearest] / value[best])
    print(
        f"{places} places, {criterion}: decided {decided_deg:g} deg; at {angles_deg[nearest]:g} deg "
        f"{value[nearest]:.4f}, best {value[best]:.4f} at {angles_deg[best]:g} deg: {share:.4f} of it "
        f"(at least {LEAST_SHARE}): {'met' if share >= LEAST_SHARE else 'NOT MET'}"
    )
    return share


def brightness_over_angles(paths: list[Path]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the swept angles and the brightness of the touch at each place, (place, angle)."""
    sweeps = [read_record(path, LightAngleSweep) for path in paths]
    # each repeat over its own mean: they share no scale
    return sweeps[0].angles_deg, np.array([(s.values / s.values.mean(axis=0)).mean(axis=1) for s in sweeps])


def normals_over_angles(
    design: Path, red: Path, green: Path, decision: LightAngleDecision
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return angles, and the inverse error of the sensed normal at each place along the pad, (place, angle)."""
    angles_deg = np.arange(decision.grid_deg[0], decision.grid_deg[-1] + 0.5 * STEP_DEG, STEP_DEG)
    with patch.object(_light_angle, "POINTS_ALONG", PLACES):
        sweep = finray.sweep_light_angle(
            design, angles_deg.tolist(), red=red, green=green, seed=SEED, samples=400, all_objectives=True
        )
    error = next(objective for objective in sweep.other_objectives if objective.place_values is not None)
    return sweep.angles_deg, 1.0 / np.asarray(error.place_values).mean(axis=1).T


if __name__ == "__main__":
    sys.exit(main())
