"""``finray simulate --only mechanics``: press a finger by finite elements."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import Progress, require_new, say

if TYPE_CHECKING:
    from data_schemas.design import FingerDesign
    from data_schemas.provenance import Provenance


def mechanics_paths(out: Path) -> dict[str, Path]:
    """Return the records of the press and of its surfaces, the mesh and the picture; all must be new."""
    stem = out.name.removesuffix(".json").removesuffix(".press")
    endings = {
        "mechanics": ".mechanics.json",
        "surfaces": ".surfaces.json",
        "mesh": ".vtu",
        "picture": ".mechanics.png",
    }
    return {what: require_new(out.with_name(stem + ending)) for what, ending in endings.items()}


def simulate_mechanics_verb(
    design: "FingerDesign", increments: int, out: Path, origin: "Provenance", progress: Progress
) -> None:
    """Press the design's indenter in, store forces, surfaces, mesh and picture, and tell the curve."""
    files = mechanics_paths(out)
    # MKL's waiting threads take the processor from the elements' threads
    os.environ.setdefault("KMP_BLOCKTIME", "0")
    from data_schemas.storage import write_bytes, write_record
    from finray_calib.exchange.vtu import vtu_bytes
    from finray_calib.reports.pressed_finger_figure import pressed_finger_png
    from sim.experiments.mechanical_press import press_records
    from sim.mechanics.press import press_finger

    threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    pressed = press_finger(design, None, increments, threads, progress)
    mechanics, surfaces = press_records(design, pressed)
    write_record(mechanics, files["mechanics"], origin)
    write_record(surfaces, files["surfaces"], origin)
    write_bytes(files["mesh"], vtu_bytes(pressed.mesh, pressed.displacement_mm[-1]))
    write_bytes(files["picture"], pressed_finger_png(mechanics, surfaces))
    say(f"{files['mechanics']}: {mechanics.label}")
    for depth, force in zip(mechanics.depth_mm, mechanics.force_n, strict=True):
        say(f"  push {depth:6.3f} mm   force {force[1]:7.3f} N")
    if mechanics.unreached:
        say(f"  the push ended early: {mechanics.unreached}")
    say(f"{files['surfaces']}: for 'finray simulate DESIGN --only optics --surfaces {files['surfaces'].name}'")
    say(f"{files['mesh']}: the pressed mesh, for ParaView")
    say(f"{files['picture']}: the finger before and after, and its force")
