"""A taught surrogate on unseen presses: surface, force, whether its bars hold, and time, beside POD + Gaussian process.

    finray design init flat-70x35 --out finger.toml
    finray simulate teach finger.toml
    python benchmarks/press_surrogate.py finger.surrogate.json --presses 200 --out bench-out/press-surrogate.jsonl

Presses are drawn at random over the family (seed 7), every seventh to the deepest push, and pressed by finite elements
in four increments. They are kept beside the results, and the same command goes on after the last one; 200 take about an
hour of processor time, --seconds ends sooner. Of each press a line of JSON holds its errors, at every increment from
0.5 mm on. Increments of a press are not independent: whether bars hold is also told of the last ones alone, with the
range that 95 % leave to so many draws. POD + Gaussian process learns the whole field
and force from the same presses, with the same features and kernel, without the condensed finger.

Bars: root mean square error of the surface within 2 % of its own displacement and force within 2 %, at the median and
for 90 %; 95 % of errors within their bars; 50 ms of processor time. Exit status 1 when one is missed.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from scipy.stats import binom

from data_schemas import Indenter, PressSurrogate, TaughtPress, provenance
from data_schemas.storage import read_record, write_record
from sim.experiments import SurrogateFinger, TrainingSettings
from sim.experiments._press_surrogate import Process, likeliest_kernel, press_to_teach, rms_length

SURFACE_BAR_REL, FORCE_BAR_REL, LEVEL_BAR, TIME_BAR_S = 0.02, 0.02, 0.95, 0.05
SEED = 7
DEEPEST_EACH = 7


def drawn(family, count):
    """Return presses at random over the family."""

    def between(share, bounds):
        return float(bounds[0] + share * (bounds[1] - bounds[0]))

    found = []
    for number, (along, across, size, turn, shape, depth) in enumerate(np.random.default_rng(SEED).random((count, 6))):
        cylinder = shape < 0.5
        small, large = family.radius_mm
        found.append(
            Indenter(
                shape="cylinder" if cylinder else "ball",
                radius_mm=float(small * (large / small) ** size),
                position_mm=between(along, family.position_mm),
                across_mm=between(across, family.across_mm),
                rotation_deg=(0.0, between(turn, family.turn_deg) if cylinder else 0.0, 0.0),
                depth_mm=between(1.0 if number % DEEPEST_EACH == DEEPEST_EACH - 1 else depth, family.depth_mm),
            )
        )
    return found


def held_out(taught, folder, count, seconds):
    """Return presses by finite elements; those that are kept are not pressed again, and none is begun after a time."""
    found, begun = [], time.monotonic()
    for number, indenter in enumerate(drawn(taught.family, count)):
        path = folder / f"{number + 1:03d}.json"
        if not path.exists():
            if time.monotonic() - begun > seconds:
                break
            design = taught.design.model_copy(update={"indenter": indenter, "provenance": None})
            press = press_to_teach(design, taught.preset, TrainingSettings(count), number, None)
            write_record(press, path, provenance(" ".join(sys.argv), {}, SEED))
            print(f"press {number + 1} of {count}: {press.processor_s:.0f} s", flush=True)
        found.append(read_record(path, TaughtPress))
    return found


def answered(opened, press):
    """Return a row of errors, bars and times for each increment of a press."""
    coat, rows = opened.finger.coat, []
    for k, depth in enumerate(press.depth_mm[: press.sound].tolist()):
        if depth < opened.record.family.depth_mm[0]:
            continue
        begun = time.process_time()
        answer = opened.press(press.design.indenter.model_copy(update={"depth_mm": depth}))
        opened.surfaces(answer)
        took = time.process_time() - begun
        true = press.displacement_mm[k][coat]
        own, push = rms_length(true), float(press.force_n[k, 1])
        surface, force = rms_length(answer.displacement_mm[coat] - true), abs(answer.force_n[1] - push)
        rows.append(
            {
                "depth_mm": depth,
                "surface_rel": surface / own,
                "force_rel": float(force / push),
                "surface_inside": bool(surface <= answer.surface_bar_mm),
                "force_inside": bool(force <= answer.force_bar_n),
                "surface_bar_rel": answer.surface_bar_mm / own,
                "force_bar_rel": answer.force_bar_n / push,
                "condensed_surface_rel": rms_length(answer.contact.coat_mm - true) / own,
                "condensed_force_rel": float(abs(answer.contact.force_n[1] / push - 1.0)),
                "doubted": bool(answer.doubt),
                "time_s": took,
            }
        )
    return rows


def plainly(taught, teachers, held):
    """Return errors of surface and force of POD + Gaussian process of whole fields, for each increment of `held`."""
    coat = SurrogateFinger(taught).finger.coat

    def samples(presses):
        for press in presses:
            for k, depth in enumerate(press.depth_mm[: press.sound].tolist()):
                indenter = press.design.indenter.model_copy(update={"depth_mm": depth})
                field = press.displacement_mm[k][coat].astype(float).ravel() / depth
                yield depth, taught.family.features(indenter), field, float(press.force_n[k, 1]) / depth

    _, places, fields, forces = (np.array(x) for x in zip(*samples(teachers), strict=True))
    # across the middle line both halves are alike: the same presses, mirrored
    sides = np.array([-1.0, 1.0, 1.0])
    rest = SurrogateFinger(taught).finger.mesh.nodes_mm[coat]
    image = np.array([np.argmin(np.linalg.norm(rest - point * sides, axis=1)) for point in rest])
    mirrored = (fields.reshape(len(fields), -1, 3)[:, image] * sides).reshape(len(fields), -1)
    places = np.concatenate([places, places * np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0])])
    fields, forces = np.concatenate([fields, mirrored]), np.concatenate([forces, forces])
    mean, level = fields.mean(axis=0), forces.mean()
    modes = np.linalg.svd(fields - mean, full_matrices=False)[2][:40]
    amplitudes, pulls = (fields - mean) @ modes.T, forces - level
    found = []
    of_field = Process(likeliest_kernel(places, amplitudes @ amplitudes.T), places)
    of_force = Process(likeliest_kernel(places, np.outer(pulls, pulls)), places)
    for depth, place, field, force in samples(held):
        if depth < taught.family.depth_mm[0]:
            continue
        guess = mean + np.linalg.solve(of_field.matrix, of_field.between(place[None])[0]) @ amplitudes @ modes
        push = level + np.linalg.solve(of_force.matrix, of_force.between(place[None])[0]) @ pulls
        off = rms_length((guess - field).reshape(-1, 3)) / rms_length(field.reshape(-1, 3))
        found.append((off, abs(push / force - 1.0)))
    return np.array(found)


def summary(rows, plain):
    """Return the numbers that the bars judge, and those beside them."""
    of = {name: np.array([row[name] for row in rows], dtype=float) for name in rows[0]}
    errors = {"surface": of["surface_rel"], "force": of["force_rel"]}
    errors |= {"condensed surface": of["condensed_surface_rel"], "condensed force": of["condensed_force_rel"]}
    errors |= {"plain surface": plain[:, 0], "plain force": plain[:, 1]} if len(plain) else {}
    return {
        **{f"{name}, {word}": float(np.quantile(found, q)) for name, found in errors.items() for word, q in QUANTILES},
        "surface inside its bar": float(of["surface_inside"].mean()),
        "force inside its bar": float(of["force_inside"].mean()),
        "bar of the surface, half": float(np.median(of["surface_bar_rel"])),
        "bar of the force, half": float(np.median(of["force_bar_rel"])),
        "doubted": float(of["doubted"].mean()),
        "time, mean": float(of["time_s"].mean()),
        "time, largest": float(of["time_s"].max()),
    }


def inside_of_last(by_press, name):
    """Return how many last increments are inside their bars, of how many, and the least that 95 % leave to chance."""
    inside = [rows[-1][name] for rows in by_press if rows]
    return sum(inside), len(inside), int(binom.ppf(0.025, len(inside), LEVEL_BAR))


QUANTILES = (("half", 0.5), ("90 %", 0.9), ("largest", 1.0))


def main() -> int:
    """Press, compare, judge."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surrogate", type=Path)
    parser.add_argument("--presses", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=np.inf, help="after which no further press begins")
    parser.add_argument("--out", type=Path, default=Path("bench-out/press-surrogate.jsonl"))
    arguments = parser.parse_args()
    taught = read_record(arguments.surrogate, PressSurrogate)
    held = held_out(taught, arguments.out.with_suffix(".presses"), arguments.presses, arguments.seconds)
    opened = SurrogateFinger(taught)
    opened.surfaces(opened.press(held[0].design.indenter))  # what is compiled and kept once
    by_press = [answered(opened, press) for press in held]
    rows = [row for found in by_press for row in found]
    stem = arguments.surrogate.name.removesuffix(".json").removesuffix(".surrogate")
    kept = sorted(arguments.surrogate.with_name(f"{stem}.presses").glob("*.json"))[: taught.presses]
    plain = plainly(taught, [read_record(path, TaughtPress) for path in kept], held) if kept else np.empty((0, 2))
    found = {"presses": len(held), "increments": len(rows), "taught by": taught.presses, **summary(rows, plain)}
    told = ("shape", "radius_mm", "position_mm", "across_mm", "rotation_deg", "depth_mm")
    with arguments.out.open("w", encoding="utf-8") as file:
        for number, (press, answers) in enumerate(zip(held, by_press, strict=True)):
            own = {name: getattr(press.design.indenter, name) for name in told}
            file.write(json.dumps({"press": number + 1, **own, "increments": answers}) + "\n")
    for name, value in found.items():
        print(f"{name}: {value:.4g}")
    for name in ("surface_inside", "force_inside"):
        print(f"{name}:", "{} of {} last increments, at least {} asked".format(*inside_of_last(by_press, name)))
    met = [
        *(found[f"surface, {word}"] <= SURFACE_BAR_REL for word in ("half", "90 %")),
        *(found[f"force, {word}"] <= FORCE_BAR_REL for word in ("half", "90 %")),
        *(found[f"{name} inside its bar"] >= LEVEL_BAR for name in ("surface", "force")),
        found["time, mean"] <= TIME_BAR_S,
    ]
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
