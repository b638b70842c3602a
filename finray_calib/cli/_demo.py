"""``finray demo`` and ``finray doctor``: all six stages on a simulated rig, and whether this machine can run them."""

import argparse
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from finray_calib.cli._output import give, progress_bar, say, suggest_command, suggest_file, wrote
from finray_calib.cli._run import (
    add_engine,
    add_out,
    add_seed,
    command_line,
    require_place,
)

if TYPE_CHECKING:
    from finray_calib.demo import Finding


DEMO_HELP = "run all six stages on a simulated rig and write a report"
DEMO_DESCRIPTION = """\
Run capture, radiometry, fit, simulate, compare and decide on a simulated rig with two fluorescent paints, and
write report.html, summary.json and every stage's records. The rig's paints are hidden from the fitter, and the
capture that the render is compared with comes from a digital twin that the simulation does not know.

Give measured re-radiation matrices and a camera response to run it on real materials. A demo that was interrupted, or
of which a stage failed, continues with the same command; finished stages are not computed again."""


def add_demo(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("demo", help=DEMO_HELP, description=DEMO_DESCRIPTION)
    parser.add_argument(
        "--red", type=Path, metavar="FILE", help="re-radiation matrix (CSV) of the material on the red wall"
    )
    parser.add_argument(
        "--green", type=Path, metavar="FILE", help="re-radiation matrix (CSV) of the material on the green wall"
    )
    parser.add_argument("--sensor", type=Path, metavar="FILE", help="camera response (CSV) of both cameras")
    add_engine(parser)
    add_out(parser, "finray-demo/, or the next free finray-demo-N/; the last one is continued if it was interrupted")
    add_seed(parser)
    parser.set_defaults(run=run_demo_verb)


def run_demo_verb(arguments: argparse.Namespace) -> None:
    """Run and report."""
    from finray_calib.demo import COMPILED_EFFORT, SCALAR_EFFORT, DemoSettings, run_demo, settings_json
    from sim.optics import SCALAR_VARIANT, choose_variant

    materials = {c: f for c, f in (("red", arguments.red), ("green", arguments.green)) if f is not None}
    _require_usable_curves(materials.values(), arguments.sensor)
    engine = choose_variant(arguments.engine)
    effort = SCALAR_EFFORT if engine.variant == SCALAR_VARIANT else COMPILED_EFFORT
    settings = DemoSettings(Path(), materials, arguments.sensor, arguments.seed, command_line(), effort)
    as_json = settings_json(settings, engine)
    out = require_place(arguments.out or _folder_to_continue(Path("finray-demo"), as_json))
    said = run_demo({**as_json, "out": str(out)}, progress_bar, say)
    say(said["verdict"])
    say(f"{said['certainty'].capitalize()}; the report says why.")
    say(f"renderer: {engine.note}")
    say(f"time: {said['seconds']:.0f} s")
    wrote(out.resolve(), "records of all six stages, summary.json and report.html")
    give(verdict=said["certainty"], sentence=said["verdict"], time_s=said["seconds"], renderer=engine.note)
    suggest_file((out / "report.html").resolve())


def _require_usable_curves(materials: Iterable[Path], sensor: Path | None) -> None:
    """Open a rig with every curve file that was given, before anything is written or takes time."""
    from rigs import open_rig, simulated_rig

    response = None if sensor is None else str(sensor.resolve())
    for sample in ["red", *(str(material.resolve()) for material in materials)]:
        with open_rig(simulated_rig(sample, response), Path()):
            pass


def _folder_to_continue(path: Path, settings: Mapping[str, Any]) -> Path:
    """Return the last of path, path-2 ... if an interrupted demo with these settings is in it, else the next one."""
    from finray_calib.demo import can_continue

    number, last, free = 1, path, path
    while free.exists():
        number, last = number + 1, free
        free = path.with_name(f"{path.name}-{number}")
    return last if can_continue(last, settings) else free


DOCTOR_HELP = "list what this machine lacks, each with the command that repairs it"
DOCTOR_DESCRIPTION = """\
Look at Python, processor, renderer, contact library, solver, compiler, memory, disk, caches and serial ports, each by
using it in a process of its own, in at most 15 s. Every line is marked good, note (the demo runs without it, slower or
with less) or bad (the demo does not run), and gives the command that mends it. Nothing is changed.

The exit status is 0 when this machine can run the demo, else 1."""
NAME_WIDTH, WIDTH = 14, 80


def add_doctor(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("doctor", help=DOCTOR_HELP, description=DOCTOR_DESCRIPTION)
    parser.set_defaults(run=run_doctor)


def run_doctor(arguments: argparse.Namespace) -> int:
    """Look and tell; 1 where the demo would not run."""
    from data_schemas import package_version
    from finray_calib.demo import check_machine

    say(f"finray {package_version()} on this machine:\n")
    findings = []
    for finding in check_machine():
        findings.append({name: getattr(finding, name) for name in ("name", "state", "found", "mend")})
        say(line_of(finding))
    bad = any(finding["state"] == "bad" for finding in findings)
    give(demo_can_run=not bad, findings=findings)
    if not bad:
        say("\nThis machine can run the demo.")
        suggest_command("finray demo")
        return 0
    say("\nThis machine cannot run the demo until every line marked 'bad' is repaired.")
    return 1


def line_of(finding: "Finding") -> str:
    """Return a finding as lines of at most 80 characters, but for a command or a path that is longer itself."""
    first = f"  {finding.state:<5}{finding.name:<{NAME_WIDTH}}"
    text = textwrap.fill(
        finding.found, WIDTH, initial_indent=first, subsequent_indent=" " * len(first), break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip
    return f"{text}\n{' ' * len(first)}-> {finding.mend}" if finding.mend else text
