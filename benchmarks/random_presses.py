"""Presses of random fingers by random indenters: how many get there, are refused, or end early, by class.

    python benchmarks/random_presses.py --seeds 0:100 --out bench-out/random-presses.jsonl [--budget 120]

One line of JSON for each seed, written when its press has ended; seeds that stand in the file are left out, so that an
interrupted run goes on and ranges of seeds add up. Coarse mesh, 5 mm in increments of 1 mm; cylinder, ball or cuboid,
turned and beside the middle. The table of all lines of the file is printed at the end. Bars: at least 99 % end within
the budget of processor time, converged, free of intersections and with an energy within 5 % of the work of the
indenter (trapezoids of a force that bends), or, at most 5 %, are refused before the solve. Exit status 1 when one is
missed.

With --paths the 48 x 18 finger is pressed, dragged by up to 2 mm and twisted by up to 20 deg at any place, with any
friction up to 1, and let go; each press must converge or end with an error that names its step.
"""

import argparse
import collections
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from data_schemas import FingerDesign, NoEquilibriumError, SimulateError
from sim import PRESETS, preset_design
from sim.mechanics import PressSettings, press_as_designed, press_finger

DEPTH_MM, INCREMENTS = 5.0, 5
ENERGY_REL = 0.05
GOOD = ("converged", "refused before the solve")
LEAST_GOOD, MOST_REFUSED = 0.99, 0.05


def random_design(seed: int) -> FingerDesign:
    """Return a finger and an indenter, of every number that a user may change.

    Raises
    ------
    ValidationError
        When numbers do not go together.
    """
    rng = np.random.default_rng(seed)
    base = preset_design(str(rng.choice(sorted(PRESETS))))
    pad, skeleton, mechanics = base.pad, base.skeleton, base.mechanics
    shape = str(rng.choice(["cylinder", "ball", "cuboid"]))
    indenter = {
        "shape": shape,
        "depth_mm": DEPTH_MM,
        "position_mm": float(rng.uniform(0.15, 0.85) * pad.length_mm),
        "across_mm": float(rng.uniform(-0.2, 0.2) * pad.width_mm),
        "rotation_deg": tuple(rng.uniform(-30.0, 30.0, 3)),
        "friction": float(rng.choice([0.0, 0.0, rng.uniform(0.1, 1.0)])),
        **(
            {"size_mm": tuple(rng.uniform(8.0, 50.0, 3)), "edge_radius_mm": float(rng.uniform(0.5, 2.0))}
            if shape == "cuboid"
            else {"radius_mm": float(rng.uniform(3.0, 25.0))}
        ),
    }
    changed = {
        "pad": pad.model_dump() | {"thickness_mm": pad.thickness_mm * float(rng.uniform(1.0, 1.5))},
        "skeleton": skeleton.model_dump()
        | {
            "rib_spacing_mm": None,
            "rib_count": int(rng.integers(3, 7)),
            "rib_thickness_mm": float(rng.uniform(0.6, 2.0)),
            "rib_width_mm": float(rng.uniform(2.0, 5.0)),
            "rib_angle_deg": float(rng.uniform(-20.0, 20.0)),
            "front_fin_thickness_mm": float(rng.uniform(1.0, 2.5)),
            "back_fin_thickness_mm": float(rng.uniform(1.0, 3.0)),
            "backing": skeleton.backing and skeleton.backing.model_dump(),
        },
        "mechanics": mechanics.model_dump()
        | {
            "gel": mechanics.gel.model_dump()
            | {
                "c10_mpa": float(10.0 ** rng.uniform(-1.5, -0.3)),
                "bulk_over_shear": float(10.0 ** rng.uniform(1.3, 4.0)),
            }
        },
        "indenter": indenter,
    }
    return FingerDesign.model_validate(base.model_dump() | changed)


def random_path(seed: int) -> FingerDesign:
    """Return the small finger with an indenter anywhere on its pad that presses, slides, twists and lets go."""
    rng = np.random.default_rng((27, seed))
    base = preset_design("baby-48x18")
    shape = str(rng.choice(["cylinder", "ball", "cuboid"]))
    sizes = {"radius_mm": float(rng.uniform(3.0, 15.0))}
    if shape == "cuboid":
        sizes = {"size_mm": tuple(rng.uniform(6.0, 30.0, 3)), "edge_radius_mm": float(rng.uniform(0.5, 2.0))}
    push, slide, way = rng.uniform(0.2, 2.0), rng.uniform(0.0, 2.0), rng.uniform(0.0, 2.0 * np.pi)
    aside = {"across_mm": float(slide * np.cos(way)), "along_mm": float(slide * np.sin(way))}
    turn, down = {"turn_y_deg": float(rng.uniform(-20.0, 20.0))}, {"push_mm": float(push)}
    indenter = {
        "shape": shape,
        "position_mm": float(rng.uniform(0.15, 0.85) * base.pad.length_mm),
        "across_mm": float(rng.uniform(-0.25, 0.25) * base.pad.width_mm),
        "rotation_deg": tuple(rng.uniform(-20.0, 20.0, 3)),
        "friction": float(rng.uniform(0.0, 1.0)),
        "path": [
            {**down, "increments": 2},
            {**down, **aside, "increments": 3},
            {**down, **aside, **turn, "increments": 2},
            {**aside, **turn, "push_mm": -0.2, "increments": 1},
        ],
        **sizes,
    }
    return FingerDesign.model_validate(base.model_dump() | {"indenter": indenter})


def measure_path(seed: int, budget_s: float) -> dict[str, Any]:
    """Move one indenter along its path, and return its class and what it took."""
    begin = time.process_time()
    found: dict[str, Any] = {"seed": seed, "why": "", "longest_silence_cpu_s": 0.0}
    try:
        pressed = press_as_designed(random_path(seed), PressSettings("coarse", budget_s=budget_s))
    except NoEquilibriumError as stuck:
        found |= {"class": "no first increment", "why": str(stuck)}
    except (SimulateError, ValidationError) as refused:
        found |= {"class": "refused before the solve", "why": " ".join(str(refused).split())}
    else:
        kind = "passes through itself" if pressed.crossing else "converged"
        found |= {
            "class": "ended at a step that it names" if pressed.unreached else kind,
            "why": pressed.unreached or pressed.crossing,
            "increments": len(pressed.depth_mm),
            "iterations": int(pressed.iterations.sum()),
            "largest_force_n": float(np.linalg.norm(pressed.force_n, axis=1).max()),
            "last_force_n": float(np.linalg.norm(pressed.force_n[-1])),
        }
    return found | {"cpu_s": time.process_time() - begin}


def measure(seed: int, budget_s: float) -> dict[str, Any]:
    """Press one finger, and return its class and what it took."""
    begin, told, silence = time.process_time(), [time.process_time()], [0.0]

    def progress(*_: object) -> None:
        silence.append(time.process_time() - told[-1])
        told.append(time.process_time())

    found: dict[str, Any] = {"seed": seed}
    try:
        pressed = press_finger(
            random_design(seed), PressSettings("coarse", INCREMENTS, budget_s=budget_s), progress=progress
        )
    except NoEquilibriumError as stuck:
        found |= {"class": "no first increment", "why": str(stuck)}
    except (SimulateError, ValidationError) as refused:
        found |= {"class": "refused before the solve", "why": " ".join(str(refused).split())}
    else:
        push, force = np.append(0.0, pressed.depth_mm), np.append(0.0, pressed.force_n[:, 1])
        work = float(np.trapezoid(force, push)) - float(np.nan_to_num(np.asarray(pressed.friction_work_n_mm))[-1])
        off = float(pressed.energy_n_mm[-1]) / work - 1.0 if work > 0.0 else np.inf
        kind = "converged"
        if pressed.unreached:
            kind = "budget spent" if pressed.unreached.startswith("the budget") else "no equilibrium further on"
        elif pressed.crossing:
            kind = "passes through itself"
        elif abs(off) > ENERGY_REL:
            kind = "energy is not the work"
        found |= {
            "class": kind,
            "why": pressed.unreached or pressed.crossing,
            "depth_mm": float(pressed.depth_mm[-1]),
            "force_n": float(pressed.force_n[-1, 1]),
            "contact": pressed.kind,
            "iterations": int(pressed.iterations.sum()),
            "energy_off_rel": off,
        }
    return found | {"cpu_s": time.process_time() - begin, "longest_silence_cpu_s": max(silence)}


def table(rows: list[dict[str, Any]]) -> tuple[str, bool]:
    """Return the table by class, and whether the bars are met."""
    counts = collections.Counter(row["class"] for row in rows)
    lines = [
        f"{len(rows)} presses",
        "| class | presses | share | processor time, median and most, s |",
        "|---|---|---|---|",
    ]
    for kind, count in counts.most_common():
        times = [row["cpu_s"] for row in rows if row["class"] == kind]
        lines.append(f"| {kind} | {count} | {count / len(rows):.1%} | {np.median(times):.0f}, {max(times):.0f} |")
    good, refused = sum(counts[kind] for kind in GOOD) / len(rows), counts[GOOD[1]] / len(rows)
    lines.append(f"longest silence: {max(row['longest_silence_cpu_s'] for row in rows):.1f} s of processor time")
    return "\n".join(lines), good >= LEAST_GOOD and refused <= MOST_REFUSED


def main() -> int:
    """Press what has not been pressed, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:20", metavar="FIRST:END")
    parser.add_argument("--out", type=Path, default=Path("bench-out/random-presses.jsonl"))
    parser.add_argument("--budget", type=float, default=120.0, metavar="SECONDS")
    parser.add_argument("--paths", action="store_true", help="presses along a path")
    arguments = parser.parse_args()
    measured = measure_path if arguments.paths else measure
    first, end = (int(part) for part in arguments.seeds.split(":"))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    known = [json.loads(line) for line in arguments.out.read_text().splitlines()] if arguments.out.exists() else []
    done = {row["seed"] for row in known}
    for seed in range(first, end):
        if seed not in done:
            known.append(measured(seed, arguments.budget))
            with arguments.out.open("a") as file:
                file.write(json.dumps(known[-1]) + "\n")
            print(seed, known[-1]["class"], f"{known[-1]['cpu_s']:.0f} s", flush=True)
    text, met = table(known)
    print(text)
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
