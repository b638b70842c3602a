"""``finray design``: write a finger's design file, and look at the finger before it is simulated."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import require_new, say

if TYPE_CHECKING:
    from data_schemas.design import FingerDesign
    from sim.mechanics.printed_parts import Part

HELP = "write a finger design; draw it, see what its camera sees, print its parts"
DESCRIPTION = "Write a design file to start from, and look at a finger before anything is simulated."
INIT_DESCRIPTION = "Write the design of a ready-made finger, with comments, to be edited."
SHOW_DESCRIPTION = """\
Say what part of the pad the camera sees through the mirror, how many sensor pixels fall on a millimetre, and what else
is in the picture. With --out, draw the finger from the side and from the front, with the names of its parts and their
sizes, and the camera's view below. With --stl, write what is printed: skeleton, base plate, backing (if there is one)
and the mould of the pad."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("design", help=HELP, description=DESCRIPTION)
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    names = actions.add_parser("list", help="the ready-made fingers")
    names.set_defaults(run=run_list)
    init = actions.add_parser(
        "init",
        help="write a design to start from",
        description=INIT_DESCRIPTION,
    )
    init.add_argument(
        "preset",
        nargs="?",
        default="flat-70x35",
        metavar="PRESET",
        help="default: flat-70x35; 'finray design list' tells all",
    )
    init.add_argument("--out", type=Path, metavar="TOML", help="default: PRESET.toml; must be new")
    init.set_defaults(run=run_init)
    show = actions.add_parser(
        "show",
        help="drawing, the camera's view of the pad, printed parts",
        description=SHOW_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    show.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML)")
    show.add_argument("--engine", choices=["auto", "llvm", "scalar"], default="auto", help="renderer (default: auto)")
    show.add_argument("--out", type=Path, metavar="PNG", help="drawing and camera's view; must be new")
    show.add_argument("--stl", type=Path, metavar="FOLDER", help="printed parts and mould (STL, mm); must be new files")
    show.set_defaults(run=run_show)


def run_list(arguments: argparse.Namespace) -> None:
    """Tell the ready-made fingers."""
    from sim.presets import PRESETS

    width = max(len(name) for name in PRESETS)
    for name, (what, _) in PRESETS.items():
        say(f"{name:{width}}  {what}")


def run_init(arguments: argparse.Namespace) -> None:
    """Write a design file."""
    from data_schemas.storage import write_bytes
    from sim.design_toml import design_toml
    from sim.presets import preset_design

    design = preset_design(arguments.preset)
    out = require_new(arguments.out or Path(f"{design.name}.toml"))
    write_bytes(out, design_toml(design).encode())
    say(f"{out}: edit it, then 'finray design show {out}'")


def run_show(arguments: argparse.Namespace) -> None:
    """Tell what the camera sees; draw the finger, write its parts."""
    from data_schemas.design import FingerDesign
    from data_schemas.storage import read_toml, write_bytes
    from sim.experiments.camera_view import camera_view
    from sim.optics.variants import choose_variant, open_renderer

    design = read_toml(arguments.design, FingerDesign)
    out = None if arguments.out is None else require_new(arguments.out)
    parts = {} if arguments.stl is None else _printed_parts(design, arguments.stl)
    view = camera_view(design, arguments.design.parent, open_renderer(choose_variant(arguments.engine)))
    say(str(view))
    if out is not None:
        from finray_calib.reports.finger_figure import finger_page_png

        write_bytes(out, finger_page_png(view))
        say(f"{out}: written")
    for path, content in parts.items():
        write_bytes(path, content)
        say(f"{path}: written")


def _printed_parts(design: "FingerDesign", folder: Path) -> dict[Path, bytes]:
    """Return the STL files of a design, all of which must be new."""
    from sim.mechanics.printed_parts import mould_stl, part_stl

    printed: list[Part] = ["skeleton", "base_plate"]
    if design.skeleton.backing is not None:
        printed.append("backing")
    for name in (*printed, "mould"):
        require_new(folder / f"{name}.stl")
    files = {folder / f"{name}.stl": part_stl(design, name) for name in printed}
    return {**files, folder / "mould.stl": mould_stl(design)}
