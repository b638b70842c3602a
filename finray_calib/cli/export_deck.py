"""``finray export deck``: the press of a finger design as an input deck of Abaqus or CalculiX."""

import argparse
from pathlib import Path

from finray_calib.cli.design_file import read_design
from finray_calib.cli.options import (
    DEFAULT_INCREMENTS,
    command_line,
    file_name,
    increment_count,
    naming,
    require_new,
    say,
)

DIALECTS = ("abaqus", "calculix")
PRESETS = ("coarse", "medium", "fine")  # as in data_schemas, which is too slow to load for --help


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a deck."""
    deck = parser.add_argument_group("decks")
    deck.add_argument("--dialect", choices=DIALECTS, help="program that the deck is for")
    deck.add_argument("--preset", choices=PRESETS, help="fineness of the mesh (default: the design's)")
    deck.add_argument(
        "--increments", type=increment_count, metavar="N", help=f"steps of the push (default {DEFAULT_INCREMENTS})"
    )


def refuse_options(arguments: argparse.Namespace) -> None:
    """Refuse what belongs to a deck, where a paint is exported.

    Raises
    ------
    RecordError
        When an option of a deck is given.
    """
    from data_schemas.errors import RecordError

    given = [f"--{name}" for name in ("dialect", "preset", "increments") if getattr(arguments, name) is not None]
    if given:
        raise RecordError(f"{' and '.join(given)}: belongs to a deck; write: finray export deck DESIGN {given[0]} ...")


def run(arguments: argparse.Namespace) -> None:
    """Write the deck and report."""
    from data_schemas.errors import SimulateError
    from data_schemas.whole_files import write_bytes
    from sim.mechanics.other_engines.deck_push import finger_deck

    path = _one_design(arguments)
    design = read_design(path)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.inp"))
    increments = arguments.increments or DEFAULT_INCREMENTS
    with naming(SimulateError, path):
        lines = finger_deck(design, arguments.dialect, arguments.preset, increments, command_line())
    write_bytes(out, "".join(f"{line}\n" for line in lines).encode("ascii", "replace"))
    say(f"{out}: {design.name}, {arguments.preset or design.mesh.preset} mesh, for {arguments.dialect}")


def _one_design(arguments: argparse.Namespace) -> Path:
    """Return the design that follows the word deck, after a check of the options."""
    from data_schemas.errors import RecordError

    if arguments.dialect is None:
        raise RecordError(f"a deck needs --dialect: one of {', '.join(DIALECTS)}")
    for name in ("format", "led", "camera_response"):
        if getattr(arguments, name) is not None:
            raise RecordError(f"--{name.replace('_', '-')} belongs to a paint; leave it out for a deck")
    if len(arguments.paint) != 2:  # the word and the file
        raise RecordError("a deck needs one design: finray export deck DESIGN.toml --dialect calculix")
    design: Path = arguments.paint[1]
    return design
