"""Presses of random fingers by random indenters: how many get there, are refused, or end early, by class.

    python benchmarks/random_presses.py --seeds 0:100 --out bench-out/random-presses.jsonl [--budget 120]

One line of JSON for each seed, written when its press has ended; seeds that stand in the file are left out, so that an
interrupted run goes on and ranges of seeds add up. Coarse mesh, 5 mm in increments of 1 mm; cylinder, ball, cuboid or a
closed STL, turned and beside the middle; gel and skeleton of any K/mu from 20 to 10,000. The table of all lines of the
file is printed at the end. Bars: at least 99 % end within the budget of processor time, converged, free of
intersections, at equilibria not known to be unstable, with no node of the coat over 0.2 mm in the indenter and an
energy within 5 % of the work of the indenter (trapezoids of a force that bends), or, at most 5 %, are refused before
the solve. Exit status 1 when one is missed. Each line has in `code` the digest of the sources that decide it; with
--renew, lines of other code are pressed again and replaced.

With --paths the 48 x 18 finger is pressed, dragged by up to 2 mm and twisted by up to 20 deg at any place, with any
friction up to 1, and let go; each press must converge or end with an error that names its step.
"""

import argparse
import collections
import hashlib
import inspect
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from data_schemas import FieldError, FingerDesign, NoEquilibriumError, SimulateError
from sim import PRESETS, mechanics, preset_design, surface_meshes
from sim.mechanics import PressedFinger, PressSettings, press_as_designed, press_finger, rigid_indenter
from sim.surface_meshes import stl_bytes

DEPTH_MM, INCREMENTS = 5.0, 5
ENERGY_REL = 0.05
PENETRATION_MM = (
    0.2  # a tenth of a coarse element: the penalty sinks in by its pressure over 50 times the gel's modulus
)
UNSTABLE = "may stand at an unstable equilibrium"
GOOD = ("converged", "refused before the solve")
LEAST_GOOD, MOST_REFUSED = 0.99, 0.05


def random_design(seed: int, folder: Path) -> FingerDesign:
    """Return a finger and an indenter, of every number of its mechanics that a user may change.

    Each part is changed with a chance of its own, in the neighbourhood of the ready-made fingers or, where a material
    is not known, over all that a design accepts. An STL of the indenter is written into the folder.

    Raises
    ------
    FieldError
        When numbers do not go together.
    """
    rng = np.random.default_rng(seed)
    base = preset_design(str(rng.choice(sorted(PRESETS))))
    pad = random_pad(rng, base)
    changed = {
        "pad": pad,
        "skeleton": random_skeleton(rng, base),
        "mechanics": random_materials(rng, base),
        "mirror": base.mirror.model_dump() | {"radius_mm": float(rng.uniform(250.0, 1000.0))},
        "indenter": random_indenter(rng, pad["length_mm"], pad["width_mm"], folder),
    }
    return FingerDesign.model_validate(base.model_dump() | changed)


def random_pad(rng: np.random.Generator, base: FingerDesign) -> dict[str, Any]:
    """Return a pad up to half as thick again, with or without a film."""
    film = {"thickness_mm": float(rng.uniform(0.05, 0.3))} if rng.random() < 0.7 else None
    return base.pad.model_dump() | {"thickness_mm": base.pad.thickness_mm * float(rng.uniform(1.0, 1.5)), "film": film}


def random_skeleton(rng: np.random.Generator, base: FingerDesign) -> dict[str, Any]:
    """Return fins, ribs and a backing, even or with a spacing."""
    kept = base.skeleton.model_dump()
    backing = None
    if rng.random() < 0.6:
        backing = {"thickness_mm": float(rng.uniform(0.4, 1.5)), "to_z_mm": float(rng.uniform(0.4, 0.9)) * 70.0}
    count = int(rng.integers(2, 8))
    spacing = base.pad.length_mm / (count + 1.0) * float(rng.uniform(0.8, 1.1)) if rng.random() < 0.3 else None
    return kept | {
        "rib_count": count,
        "rib_spacing_mm": spacing,
        "rib_thickness_mm": float(rng.uniform(0.6, 2.0)),
        "rib_width_mm": float(rng.uniform(2.0, 5.0)),
        "rib_angle_deg": float(rng.uniform(-20.0, 20.0)),
        "front_fin_thickness_mm": float(rng.uniform(1.0, 2.5)),
        "back_fin_thickness_mm": float(rng.uniform(1.0, 3.0)),
        "flange_mm": float(rng.uniform(0.5, 1.5)),
        "tip_length_mm": float(rng.uniform(3.0, 10.0)),
        "base_thickness_mm": float(rng.uniform(3.0, 10.0)),
        "mirror_thickness_mm": float(rng.uniform(0.1, 0.5)),
        "backing": backing,
    }


def random_materials(rng: np.random.Generator, base: FingerDesign) -> dict[str, Any]:
    """Return softer and stiffer materials, and every K/mu of the gel and the skeleton from 20 to 10,000."""
    found = base.mechanics.model_dump()
    found["gel"] |= {
        "c10_mpa": float(10.0 ** rng.uniform(-1.5, -0.3)),
        "bulk_over_shear": float(10.0 ** rng.uniform(1.3, 4.0)),
    }
    stiffer = float(10.0 ** rng.uniform(-0.5, 0.5))
    found["skeleton"] |= {
        "mu_mpa": tuple(mu * stiffer for mu in base.mechanics.skeleton.mu_mpa),
        "bulk_over_shear": float(10.0 ** rng.uniform(1.3, 4.0)),
    }
    for part in ("onyx", "mirror", "film"):
        found[part] = {
            "youngs_modulus_mpa": found[part]["youngs_modulus_mpa"] * float(10.0 ** rng.uniform(-0.5, 0.3)),
            "poisson_ratio": float(rng.uniform(0.2, 0.45)),
        }
    return found


def random_indenter(rng: np.random.Generator, length_mm: float, width_mm: float, folder: Path) -> dict[str, Any]:
    """Return a body of any shape, turned and beside the middle, with and without friction."""
    shape = str(rng.choice(["cylinder", "ball", "cuboid", "mesh"], p=[0.3, 0.3, 0.3, 0.1]))
    sizes: dict[str, Any] = {"radius_mm": float(rng.uniform(3.0, 25.0))}
    if shape == "cuboid":
        sizes = {"size_mm": tuple(rng.uniform(8.0, 50.0, 3)), "edge_radius_mm": float(rng.uniform(0.5, 2.0))}
    elif shape == "mesh":
        sizes = {"file": "random-indenter.stl"}
        write_random_stl(rng, folder / sizes["file"])
    return {
        "shape": shape,
        "depth_mm": DEPTH_MM,
        "position_mm": float(rng.uniform(0.15, 0.85) * length_mm),
        "across_mm": float(rng.uniform(-0.2, 0.2) * width_mm),
        "rotation_deg": tuple(rng.uniform(-30.0, 30.0, 3)),
        "friction": float(rng.choice([0.0, 0.0, rng.uniform(0.1, 1.0)])),
        **sizes,
    }


def write_random_stl(rng: np.random.Generator, path: Path) -> None:
    """Write the hull of 40 points on an ellipsoid of 4 to 20 mm as a closed STL."""
    points = rng.standard_normal((40, 3))
    points *= rng.uniform(4.0, 20.0, 3) / np.linalg.norm(points, axis=1)[:, None]
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ki,ki->k", across, hull.equations[:, :3]) < 0.0
    triangles = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    path.write_bytes(stl_bytes(triangles, points, "random hull"))


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


class Told:
    """The longest time of this process between two calls, from when it is made."""

    def __init__(self) -> None:
        self.longest_cpu_s, self._last = 0.0, time.process_time()

    def __call__(self, *_: object) -> None:
        """Hear of progress."""
        now = time.process_time()
        self.longest_cpu_s, self._last = max(self.longest_cpu_s, now - self._last), now


def measure_path(seed: int, budget_s: float) -> dict[str, Any]:
    """Move one indenter along its path, and return its class and what it took."""
    begin, told = time.process_time(), Told()
    found: dict[str, Any] = {"seed": seed, "why": ""}
    try:
        pressed = press_as_designed(random_path(seed), PressSettings("coarse", budget_s=budget_s), progress=told)
    except NoEquilibriumError as stuck:
        found |= {"class": "no first increment", "why": str(stuck)}
    except (SimulateError, FieldError) as refused:
        found |= {"class": "refused before the solve", "why": " ".join(str(refused).split())}
    else:
        kind = "passes through itself" if pressed.crossing else UNSTABLE if pressed.unstable else "converged"
        found |= {
            "class": "ended at a step that it names" if pressed.unreached else kind,
            "why": pressed.unreached or pressed.crossing or pressed.unstable,
            "increments": len(pressed.depth_mm),
            "iterations": int(pressed.iterations.sum()),
            "largest_force_n": float(np.linalg.norm(pressed.force_n, axis=1).max()),
            "last_force_n": float(np.linalg.norm(pressed.force_n[-1])),
        }
    told()
    return found | {"cpu_s": time.process_time() - begin, "longest_silence_cpu_s": told.longest_cpu_s}


def most_penetration_mm(design: FingerDesign, pressed: PressedFinger, folder: Path) -> float:
    """Return how deep the deepest node of the coat lies in the indenter at the end of the push."""
    indenter = rigid_indenter(design, folder)
    coat = np.unique(pressed.mesh.surfaces["coat"])
    places = pressed.mesh.nodes_mm[coat] + pressed.displacement_mm[-1][coat]
    pose = indenter.pose(float(pressed.depth_mm[-1]))
    distance, *_ = pose.distances(indenter.exact_body(), places)
    return float(-distance.min())


def kind_of(pressed: PressedFinger, energy_off_rel: float, penetration_mm: float) -> str:
    """Return the class of a press that has found increments."""
    if pressed.unreached:
        return "budget spent" if pressed.unreached.startswith("the budget") else "no equilibrium further on"
    if pressed.crossing:
        return "passes through itself"
    if penetration_mm > PENETRATION_MM:
        return "the indenter is in the coat"
    if pressed.unstable:
        return UNSTABLE
    return "converged" if abs(energy_off_rel) <= ENERGY_REL else "energy is not the work"


def measure(seed: int, budget_s: float) -> dict[str, Any]:
    """Press one finger, and return its class and what it took."""
    begin, told = time.process_time(), Told()
    found: dict[str, Any] = {"seed": seed}
    settings = PressSettings("coarse", INCREMENTS, budget_s=budget_s)
    try:
        with tempfile.TemporaryDirectory() as made:
            design = random_design(seed, Path(made))
            pressed = press_finger(design, settings, folder=Path(made), progress=told)
            told()
            penetration = most_penetration_mm(design, pressed, Path(made))
    except NoEquilibriumError as stuck:
        found |= {"class": "no first increment", "why": str(stuck)}
    except (SimulateError, FieldError) as refused:
        found |= {"class": "refused before the solve", "why": " ".join(str(refused).split())}
    else:
        push, force = np.append(0.0, pressed.depth_mm), np.append(0.0, pressed.force_n[:, 1])
        work = float(np.trapezoid(force, push)) - float(np.nan_to_num(np.asarray(pressed.friction_work_n_mm))[-1])
        off = float(pressed.energy_n_mm[-1]) / work - 1.0 if work > 0.0 else np.inf
        found |= {
            "class": kind_of(pressed, off, penetration),
            "why": pressed.unreached or pressed.crossing or pressed.unstable,
            "depth_mm": float(pressed.depth_mm[-1]),
            "force_n": float(pressed.force_n[-1, 1]),
            "contact": pressed.kind,
            "iterations": int(pressed.iterations.sum()),
            "energy_off_rel": off,
            "penetration_mm": penetration,
        }
    return found | {"cpu_s": time.process_time() - begin, "longest_silence_cpu_s": told.longest_cpu_s}


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
    silences = [row["longest_silence_cpu_s"] for row in rows if "longest_silence_cpu_s" in row]
    if silences:
        lines.append(f"longest silence of {len(silences)}: {max(silences):.1f} s of processor time")
    return "\n".join(lines), good >= LEAST_GOOD and refused <= MOST_REFUSED


def code_of_today() -> str:
    """Return the digest of what decides a row: mechanics, surfaces, ready-made designs and these draws."""
    rooms = [Path(inspect.getfile(room)).parent for room in (mechanics, surface_meshes)]
    sources = [path for room in rooms for path in sorted(room.rglob("*.py"))]
    digest = hashlib.sha256()
    for path in [*sources, Path(inspect.getfile(preset_design)), Path(__file__)]:
        digest.update(path.read_bytes())
    return f"sources {digest.hexdigest()[:8]}"


def compile_elements() -> None:
    """Press once, so that no press counts the compilation of the elements, which comes once with an installation."""
    base = preset_design("baby-48x18")
    indenter = base.indenter.model_copy(update={"depth_mm": 0.1, "friction": 0.3})
    press_finger(base.model_copy(update={"indenter": indenter}), PressSettings("coarse", 1))


def main() -> int:
    """Press what has not been pressed, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0:20", metavar="FIRST:END")
    parser.add_argument("--out", type=Path, default=Path("bench-out/random-presses.jsonl"))
    parser.add_argument("--budget", type=float, default=120.0, metavar="SECONDS")
    parser.add_argument("--paths", action="store_true", help="presses along a path")
    parser.add_argument("--renew", action="store_true", help="press again what OUT has from other code")
    arguments = parser.parse_args()
    measured = measure_path if arguments.paths else measure
    first, end = (int(part) for part in arguments.seeds.split(":"))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    rows = arguments.out.read_text().splitlines() if arguments.out.exists() else []
    known = {row["seed"]: row for row in map(json.loads, rows)}
    code = code_of_today()
    compile_elements()
    for seed in range(first, end):
        if seed not in known or (arguments.renew and known[seed].get("code") != code):
            known[seed] = measured(seed, arguments.budget) | {"code": code}
            whole = arguments.out.with_suffix(".part")
            whole.write_text("".join(json.dumps(row) + "\n" for row in known.values()))
            whole.replace(arguments.out)
            print(seed, known[seed]["class"], f"{known[seed]['cpu_s']:.0f} s", flush=True)
    text, met = table(list(known.values()))
    print(text)
    return 0 if met else 1


if __name__ == "__main__":
    raise SystemExit(main())
