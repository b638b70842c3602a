"""``finray demo``: all six stages on a simulated rig."""

import argparse
from collections.abc import Iterable
from pathlib import Path

from finray_calib.cli.options import add_out, add_seed, command_line, progress_bar, require_place, say

HELP = "run all six stages on a simulated rig and write a report"
DESCRIPTION = """\
Run capture, radiometry, fit, simulate, compare and decide on a simulated rig with two fluorescent paints, and
write report.html, summary.json and every stage's records. The rig's paints are hidden from the fitter, and the
capture that the render is compared with comes from a digital twin that the simulation does not know.

Give measured re-radiation matrices and a camera response to run it on real materials."""


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
    add_out(parser, "finray-demo/, or the next free finray-demo-N/")
    add_seed(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Run and report."""
    from finray_calib.demo.run_demo import run_demo
    from finray_calib.demo.stages import COMPILED_EFFORT, SCALAR_EFFORT, DemoSettings
    from sim.optics.variants import choose_variant

    materials = {c: f for c, f in (("red", arguments.red), ("green", arguments.green)) if f is not None}
    out = require_place(arguments.out or _next_free(Path("finray-demo")))
    _require_usable_curves(materials.values(), arguments.sensor)
    engine = choose_variant(arguments.engine)
    effort = SCALAR_EFFORT if engine.llvm_library is None else COMPILED_EFFORT
    settings = DemoSettings(out, materials, arguments.sensor, arguments.seed, command_line(), effort)
    results = run_demo(settings, engine, progress_bar)
    say(f"{results.decision.verdict.upper()}: {results.decision.sentence}")
    say(f"renderer: {results.renderer_note}")
    say(f"time: {sum(results.stage_wall_times_s.values()):.0f} s")
    say(f"report: {(out / 'report.html').resolve()}")


def _require_usable_curves(materials: Iterable[Path], sensor: Path | None) -> None:
    """Open a rig with every curve file that was given, before anything is written or takes time."""
    from rigs.open_rig import open_rig
    from rigs.presets import simulated_rig

    response = None if sensor is None else str(sensor.resolve())
    for sample in ["red", *(str(material.resolve()) for material in materials)]:
        with open_rig(simulated_rig(sample, response), Path()):
            pass


def _next_free(path: Path) -> Path:
    """Return the path, or the first of path-2, path-3 ... that does not exist."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}-{number}")
    return free
