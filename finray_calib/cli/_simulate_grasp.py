"""``finray simulate grasp``: two fingers of a gripper close on the design's object and carry it."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, progress_bar, say, suggest_command, suggest_file, warn, wrote
from finray_calib.cli._run import (
    LongWork,
    add_out,
    command_line,
    file_name,
    increment_count,
    input_digests,
    naming,
    number_within,
    require_ending,
    require_new,
)

if TYPE_CHECKING:
    from data_schemas import ObjectGrasp, Provenance
    from sim.mechanics import Grasp

GRASP_HELP = "close two facing fingers on an object, and let them carry its weight"
GRASP_DESCRIPTION = """\
Close two fingers of the design, face to face, on its indenter as a free rigid object: both begin where they touch it,
close by equal distances, and the object moves and turns to where the forces on it balance. With --mass, the fingers
then carry the object while its weight grows from nothing to all of it, and the command reports how much they hold; this
needs friction (indenter.friction). indenter.depth_mm is ignored. The command stores the grasp (NAME.grasp.json), each
finger's forces and deformed surfaces (NAME.near... and NAME.far..., for 'finray simulate render') and a picture.

Exit status: 0 also where the object is lost, which the last lines report; 2 after a mistake, or where the fingers do
not get hold of the object at all."""

LARGEST_FORCE_N, LARGEST_MASS_KG = 200.0, 20.0
FEWEST_TOUCHING = 8
"""Below this many points of contact on a finger their places decide the force; a choice, not measured."""


def add_grasp(jobs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register ``finray simulate grasp``."""
    parser = jobs.add_parser("grasp", help=GRASP_HELP, description=GRASP_DESCRIPTION)
    parser.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML); its indenter is the object")
    parser.add_argument(
        "--force",
        type=number_within("a force in N", (0.01, LARGEST_FORCE_N)),
        required=True,
        metavar="NEWTON",
        help="closing force in N, as the mean over both fingers",
    )
    parser.add_argument(
        "--mass", type=_mass, default=0.0, metavar="KG", help="mass of the carried object in kg (default: 0, none)"
    )
    parser.add_argument(
        "--down", choices=["tip", "side", "near"], default="tip",
        help="direction of gravity: tip (default; the gripper points down), side (the gripper is horizontal, with its "
        "fingers side by side), or near (horizontal, with the near finger below the object)",
    )  # fmt: skip
    parser.add_argument(
        "--increments", type=increment_count, default=4, metavar="N",
        help="number of steps to the force, and again to the whole weight (default: 4); shorter steps are inserted "
             "where needed",
    )  # fmt: skip
    add_out(parser, "NAME.grasp.json, with the other files beside it")
    parser.set_defaults(run=run_grasp, long_work=_long_grasp)


def _long_grasp(arguments: argparse.Namespace) -> LongWork:
    """Return what is about to be done, and what of it is kept if its process dies."""
    return LongWork(
        "the grasp by finite elements",
        "Nothing is stored before the end, so the same command starts from the beginning",
        arguments.out,
    )


def _mass(text: str) -> float:
    """Parse a mass."""
    of_a_body = number_within("0 or a mass in kg", (1e-6, LARGEST_MASS_KG))
    try:
        return 0.0 if float(text) == 0.0 else of_a_body(text)
    except ValueError:
        return of_a_body(text)


def _paths(out: Path) -> dict[str, Path]:
    """Return the files that are written; all must be new."""
    stem = require_ending(out, ".json").name.removesuffix(".json").removesuffix(".grasp")
    endings = {"grasp": ".grasp.json", "picture": ".grasp.png"}
    for side in ("near", "far"):
        endings |= {side: f".{side}.mechanics.json", f"{side} surfaces": f".{side}.surfaces.json"}
    return {what: require_new(out.with_name(stem + ending)) for what, ending in endings.items()}


def run_grasp(arguments: argparse.Namespace) -> None:
    """Grasp, store the grasp, both fingers and a picture, and tell what was held."""
    from data_schemas import SimulateError, provenance
    from data_schemas.storage import read_bytes
    from finray_calib.spectra import machine_threads
    from sim import read_design
    from sim.mechanics import GraspTask, PressSettings, grasp_object

    design, folder = read_design(arguments.design), arguments.design.parent
    files = _paths(arguments.out or Path(f"{file_name(arguments.design.stem)}.grasp.json"))
    read = [arguments.design]
    if design.indenter.file:
        read_bytes(folder / design.indenter.file, "an object (STL)")
        read.append(folder / design.indenter.file)
    origin = provenance(command_line(), input_digests(read), None)
    task = GraspTask(arguments.force, arguments.mass, arguments.down, arguments.increments, arguments.increments)
    with progress_bar("simulate") as progress, naming(SimulateError, arguments.design):
        found = grasp_object(design, task, PressSettings(threads=machine_threads()), folder=folder, progress=progress)
        changed = [name for name, digest in input_digests(read).items() if digest != origin.input_sha256[name]]
        if changed:
            raise SimulateError(
                f"{changed[0]}: was changed while the grasp was computed from it; run the command again"
            )
    from sim.experiments import grasp_record

    _store(found, grasp_record(design, task, found), files, origin, folder)


def _store(found: "Grasp", record: "ObjectGrasp", files: dict[str, Path], origin: "Provenance", folder: Path) -> None:
    """Write the records of both fingers, the grasp and its picture, and tell it."""
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.reports import grasp_png
    from sim.experiments import press_records
    from sim.mechanics import facing_design

    sides = {"near": (record.design, found.near), "far": (facing_design(record.design), found.far)}
    records = {side: press_records(design, pressed) for side, (design, pressed) in sides.items()}
    with ProductSet(files["grasp"]) as products:
        products.add(files["picture"], grasp_png(record, records["near"], records["far"], folder))
        for side, (mechanics, surfaces) in records.items():
            write_record(surfaces, files[f"{side} surfaces"], origin, products)
            write_record(mechanics, files[side], origin, products)
        write_record(record, files["grasp"], origin, products)
    _tell(record, files)
    for side, (_, pressed) in sides.items():
        if pressed.crossing:
            warn(
                f"warning: {side} finger: {pressed.crossing}; the results from there on are not physical. Close with "
                "less force"
            )
        if pressed.unstable:
            warn(
                f"warning: {side} finger: {pressed.unstable}; grasp in smaller increments to see whether this "
                "warning remains"
            )
        touching = int((pressed.pressure_mpa > 0.0).sum())
        if touching < FEWEST_TOUCHING:
            warn(
                f"warning: {side} finger: only {touching} points of its mesh touch the object, but below "
                f"{FEWEST_TOUCHING} the force depends on where the points lie; use a finer mesh (mesh.preset = "
                '"medium" in the design), or close with more force'
            )


def _tell(record: "ObjectGrasp", files: dict[str, Path]) -> None:
    """Tell the increments, how firmly the object is held, and what is stored."""
    wrote(files["grasp"], record.label)
    held_n, weight_n = float(record.carried_n[-1]), float(record.weight_n)
    give(
        label=record.label, closing_mm=record.closing_mm, closing_force_n=record.closing_force_n,
        carried_n=record.carried_n, moves_mm=record.moves_mm, turns_deg=record.turns_deg, weight_n=weight_n,
        stiffness_n_per_mm=record.stiffness_n_per_mm, lost=record.lost,
    )  # fmt: skip
    say(
        "  closing distance (mm), closing force (N), carried weight (N); move (mm) and turn (deg) of the object: "
        "x, y, z"
    )
    rows = zip(
        record.closing_mm, record.closing_force_n, record.carried_n, record.moves_mm, record.turns_deg, strict=True
    )
    for closing, force, carried, move, turn in rows:
        where = " ".join(f"{value:7.3f}" for value in move + 0.0)
        turned = " ".join(f"{value:6.2f}" for value in turn + 0.0)
        say(f"  {closing:6.3f}  {force:7.3f}  {carried:7.3f}   {where}   {turned}")
    if record.lost and record.mass_kg > 0.0 and held_n > 0.0:
        say(f"  the fingers hold {held_n:.3g} of {weight_n:.3g} N of weight, then the grasp ends: {record.lost}")
    elif record.lost:
        say(f"  the fingers close no further: {record.lost}")
    elif record.mass_kg > 0.0:
        say(f"  the fingers hold the whole weight of {weight_n:.3g} N")
    squeezed = (
        ": the grasp is not stable, and the object slips out or tips over at the slightest push"
        if record.stiffness_n_per_mm < 0.0
        else ""
    )
    say(f"  least resistance to a move of the object: {record.stiffness_n_per_mm:.3g} N/mm{squeezed}")
    for side in ("near", "far"):
        wrote(files[side], f"forces, torques and slip on the {side} finger")
        wrote(files[f"{side} surfaces"], f"surfaces of the {side} finger, for 'finray simulate render'")
    wrote(files["picture"], "the gripped object, the force and what the pads feel")
    suggest_command("finray simulate render", files["near surfaces"], "--paint red=FILE --paint green=FILE")
    suggest_file(files["picture"])
