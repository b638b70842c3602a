"""``finray simulate --only mechanics``: press a finger by finite elements."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from finray_calib.cli.options import Progress, require_new, say

if TYPE_CHECKING:
    from data_schemas.design import FingerDesign
    from data_schemas.press_mechanics import PressSensitivities
    from data_schemas.provenance import Provenance
    from sim.mechanics.press import PressedFinger
    from sim.mechanics.press_contact import ContactChoice


class _Engine(TypedDict, total=False):
    """What :func:`~sim.experiments.mechanical_press.press_records` is told beside the press itself."""

    engine: str
    notes: tuple[str, ...]
    sensitivities: "PressSensitivities"


def mechanics_paths(out: Path, resume: Path | None = None) -> dict[str, Path]:
    """Return the records of the press and of its surfaces, the mesh and the picture; all must be new.

    So must be the folder of the increments, but for a press that goes on from an increment in it.
    """
    stem = out.name.removesuffix(".json").removesuffix(".press")
    endings = {
        "mechanics": ".mechanics.json",
        "surfaces": ".surfaces.json",
        "mesh": ".vtu",
        "picture": ".mechanics.png",
    }
    files = {what: require_new(out.with_name(stem + ending)) for what, ending in endings.items()}
    from data_schemas.errors import RecordError

    increments = out.with_name(stem + ".increments")
    if resume is None or resume.parent.absolute() != increments.absolute():
        require_new(increments)
    elif any(_number(stored) > _number(resume) for stored in increments.glob("*.json")):
        raise RecordError(f"{resume}: later increments stand beside it; give another --out to leave them as they are")
    return {**files, "increments": increments}


def _number(increment: Path) -> int:
    """Return the number of a stored increment."""
    return int(increment.stem) if increment.stem.isdecimal() else 0


def last_increment(resume: Path) -> Path:
    """Return the record to go on from: a file, or the last one in a folder of increments."""
    from data_schemas.errors import RecordError

    if not resume.is_dir():
        return resume
    stored = sorted(resume.glob("*.json"), key=_number)
    if not stored:
        raise RecordError(f"{resume}: holds no increment of a press; give a folder or file that --only mechanics wrote")
    return stored[-1]


def simulate_mechanics_verb(
    design: "FingerDesign",
    increments: int,
    resume: Path | None,
    out: Path,
    origin: "Provenance",
    progress: Progress,
    engine: str = "auto",
    contact: "ContactChoice" = "auto",
    folder: Path = Path(),
    sensitivities: bool = False,
) -> None:
    """Press the design's indenter in, store forces, surfaces, mesh and picture, and tell the curve.

    Raises
    ------
    SimulateError
        When the push ended early, after what was reached has been stored.
    """
    files = mechanics_paths(out, resume)
    from data_schemas.errors import SimulateError
    from data_schemas.storage import write_bytes, write_record
    from finray_calib.exchange.vtu import vtu_bytes
    from finray_calib.reports.pressed_finger_figure import pressed_finger_png
    from sim.experiments.force_sensitivities import press_sensitivities
    from sim.experiments.mechanical_press import press_records

    if engine == "calculix":
        pressed, said = _pressed_by_calculix(design, increments, progress)
    else:
        kept = files["increments"]
        pressed = _pressed(design, increments, resume, kept, origin, progress, contact, folder)
        said = _Engine()
        if sensitivities and not pressed.unreached:
            said["sensitivities"] = press_sensitivities(design, pressed, _threads(), progress, contact, folder)
    mechanics, surfaces = press_records(design, pressed, **said)
    write_record(mechanics, files["mechanics"], origin)
    write_record(surfaces, files["surfaces"], origin)
    write_bytes(files["mesh"], vtu_bytes(pressed.mesh, pressed.displacement_mm[-1]))
    write_bytes(files["picture"], pressed_finger_png(mechanics, surfaces, folder))
    say(f"{files['mechanics']}: {mechanics.label}")
    for depth, force in zip(mechanics.depth_mm, mechanics.force_n, strict=True):
        say(f"  push {depth:6.3f} mm   force {force[1]:7.3f} N")
    if mechanics.sensitivities is not None:
        say(f"  {len(mechanics.sensitivities.varied)} presses with one number changed, for 'finray compare --force'")
    say(f"{files['surfaces']}: for 'finray simulate DESIGN --only optics --surfaces {files['surfaces'].name}'")
    say(f"{files['mesh']}: the pressed mesh, for ParaView")
    say(f"{files['picture']}: the finger before and after, and its force")
    if mechanics.unreached:
        raise SimulateError(
            f"the push ended early, at {mechanics.depth_mm[-1]:.4g} of {design.indenter.depth_mm:g} mm: "
            f"{mechanics.unreached}. What was reached is stored and can be rendered"
        )


def _pressed(
    design: "FingerDesign",
    increments: int,
    resume: Path | None,
    folder: Path,
    origin: "Provenance",
    progress: Progress,
    contact: "ContactChoice",
    design_folder: Path,
) -> "PressedFinger":
    """Press, or go on pressing, and store each increment."""
    from data_schemas.press_mechanics import PressIncrement
    from data_schemas.storage import read_record, write_record
    from sim.experiments.mechanical_press import increment_record, stored_press
    from sim.mechanics.press import press_finger

    before = None if resume is None else stored_press(read_record(resume, PressIncrement), design)
    threads = _threads()

    def store(pressed: "PressedFinger") -> None:
        write_record(increment_record(design, pressed), folder / f"{len(pressed.depth_mm):03d}.json", origin)

    return press_finger(design, None, increments, threads, progress, None, before, store, contact, design_folder)


def _pressed_by_calculix(
    design: "FingerDesign", increments: int, progress: Progress
) -> "tuple[PressedFinger, _Engine]":
    """Press with CalculiX; return also its name and what must be said about it."""
    from sim.mechanics.other_engines.calculix import calculix_notes, calculix_version, press_finger_calculix

    engine = f"CalculiX {calculix_version()}"
    pressed = press_finger_calculix(design, None, increments, _threads(), progress)
    return pressed, {"engine": engine, "notes": calculix_notes(design)}


def _threads() -> int:
    """Return the number of processors that may be used."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
