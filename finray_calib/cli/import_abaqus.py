"""``finray import abaqus``: a finger that Abaqus has pressed becomes records of its mechanics and its surfaces."""

import argparse
from pathlib import Path

from finray_calib.cli.design_file import read_design
from finray_calib.cli.options import add_out, command_line, file_name, input_digests, naming, require_new, say

HELP = "import the results file of a deck that Abaqus has run"
DESCRIPTION = """\
Read the displacements of a finger from the results file (ASCII .fil) of a deck that 'finray export deck DESIGN
--dialect abaqus' wrote: forces and pushes, and the surfaces of the pressed finger for 'finray simulate DESIGN
--surfaces'. Give the design and mesh of the deck."""
PRESETS = ("coarse", "medium", "fine")


def add_parser(formats: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the format."""
    parser = formats.add_parser(
        "abaqus", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path, metavar="FILE.fil", help="results file in ASCII")
    parser.add_argument("--design", type=Path, required=True, metavar="DESIGN", help="the deck's design (TOML)")
    parser.add_argument("--preset", choices=PRESETS, help="the deck's mesh (default: the design's)")
    add_out(parser, "DESIGN.surfaces.json, beside it DESIGN.mechanics.json")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Import and report."""
    from data_schemas.errors import ImportFormatError
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record
    from sim.experiments.mechanical_press import press_records
    from sim.mechanics.other_engines.abaqus_press import pressed_by_abaqus
    from sim.mechanics.other_engines.abaqus_results import read_fil

    design = read_design(arguments.design)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.surfaces.json"))
    stem = out.name.removesuffix(".json").removesuffix(".surfaces")
    forces_out = require_new(out.with_name(f"{stem}.mechanics.json"))
    fields = read_fil(arguments.results)
    with naming(ImportFormatError, arguments.results):
        pressed = pressed_by_abaqus(design, fields, arguments.preset)
    mechanics, surfaces = press_records(design, pressed, arguments.preset, "Abaqus")
    origin = provenance(command_line(), input_digests([arguments.design, arguments.results]), None)
    with ProductSet(out) as products:
        write_record(mechanics, forces_out, origin, products)
        write_record(surfaces, out, origin, products)
    say(f"{forces_out}: {mechanics.label}")
    for depth, force in zip(mechanics.depth_mm, mechanics.force_n, strict=True):
        say(f"  push {depth:6.3f} mm   force {force[1]:7.3f} N")
    if mechanics.unreached:
        say(f"  the push ended early: {mechanics.unreached}")
    say(f"{out}: for 'finray simulate DESIGN --only optics --surfaces {out.name}'")
