"""``finray demo``: all six stages on a simulated rig."""

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from finray_calib.cli.options import add_out, add_seed, command_line, progress_bar, require_place, say

HELP = "run all six stages on a simulated rig and write a report"
DESCRIPTION = """\
Run capture, radiometry, fit, simulate, compare and decide on a simulated rig with two fluorescent paints, and
write report.html, summary.json and every stage's records. The rig's paints are hidden from the fitter, and the
capture that the render is compared with comes from a digital twin that the simulation does not know.

Give measured re-radiation matrices and a camera response to run it on real materials. A demo that was interrupted, or
of which a stage died, goes on with the same command; what is stored and whole is not computed again."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "demo", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--red", type=Path, metavar="FILE", help="re-radiation matrix (CSV) that lies on the red wall")
    parser.add_argument(
        "--green", type=Path, metavar="FILE", help="re-radiation matrix (CSV) that lies on the green wall"
    )
    parser.add_argument("--sensor", type=Path, metavar="FILE", help="camera response (CSV) of both cameras")
    parser.add_argument("--engine", choices=["auto", "llvm", "scalar"], default="auto", help="renderer (default: auto)")
    add_out(parser, "finray-demo/, or the next free finray-demo-N/, or the last one if it was interrupted")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run and report."""
    from finray_calib.demo.run_demo import run_demo
    from finray_calib.demo.stages import COMPILED_EFFORT, SCALAR_EFFORT, DemoSettings, settings_json
    from sim.optics.variants import choose_variant

    materials = {c: f for c, f in (("red", arguments.red), ("green", arguments.green)) if f is not None}
    _require_usable_curves(materials.values(), arguments.sensor)
    engine = choose_variant(arguments.engine)
    effort = SCALAR_EFFORT if engine.llvm_library is None else COMPILED_EFFORT
    settings = DemoSettings(Path(), materials, arguments.sensor, arguments.seed, command_line(), effort)
    as_json = settings_json(settings, engine)
    out = require_place(arguments.out or _where_to_go_on(Path("finray-demo"), as_json))
    said = run_demo({**as_json, "out": str(out)}, progress_bar, say)
    say(f"{said['verdict'].upper()}: {said['sentence']}")
    say(f"renderer: {engine.note}")
    say(f"time: {said['seconds']:.0f} s")
    say(f"report: {(out / 'report.html').resolve()}")


def _require_usable_curves(materials: Iterable[Path], sensor: Path | None) -> None:
    """Open a rig with every curve file that was given, before anything is written or takes time."""
    from rigs.open_rig import open_rig
    from rigs.presets import simulated_rig

    response = None if sensor is None else str(sensor.resolve())
    for sample in ["red", *(str(material.resolve()) for material in materials)]:
        with open_rig(simulated_rig(sample, response), Path()):
            pass


def _where_to_go_on(path: Path, settings: Mapping[str, Any]) -> Path:
    """Return the last of path, path-2 ... if an interrupted demo with these settings is in it, else the next one."""
    from finray_calib.demo.demo_folder import can_go_on

    number, last, free = 1, path, path
    while free.exists():
        number, last = number + 1, free
        free = path.with_name(f"{path.name}-{number}")
    return last if can_go_on(last, settings) else free
