"""``finray import captures``: another lab's folder of presses becomes tactile captures, read by a recipe."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, go_on_with, look_at, progress_bar, say, warn, wrote
from finray_calib.cli._run import (
    add_out,
    command_line,
    file_name,
    input_digests,
    require_new,
)

if TYPE_CHECKING:
    from data_schemas import ContactCircle, SimulatedPress, TactileCapture
    from finray_calib.exchange import Recipe

DESCRIPTION = """\
Import a folder of presses of another lab as tactile captures. A recipe, a short TOML file, says which files
are the presses, where the image without contact is, which columns hold the contact, the scale and the ball:
one that comes with finray, by its name (--list shows them), or a file of your own. Videos give contact, no
contact and its repeat; contact circles that nobody drew are searched for. OUT gets a capture of each press,
a picture of all contacts to check (contacts.png), and circles.csv: correct it and give it with --circles.

With --predict-from N, presses spread over the set teach a table, and each of the others gets beside its
capture what the table predicts of it: 'finray compare OUT OUT' then scores these as a yardstick for
simulators. Files with pickled objects are never opened."""
CAPTURE, PRESS = ".capture.json", ".press.json"
CONTACTS, CIRCLES = "contacts.png", "circles.csv"


def add_captures_format(formats: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the format."""
    parser = formats.add_parser(
        "captures", help="a folder of presses of any lab, read by a recipe", description=DESCRIPTION
    )
    parser.add_argument("folder", type=Path, nargs="?", metavar="FOLDER", help="of the set")
    parser.add_argument("--recipe", metavar="NAME|FILE", help="how the folder is read; needed")
    parser.add_argument("--list", action="store_true", help="list the recipes that come with finray, and stop")
    parser.add_argument(
        "--circles", type=Path, metavar="CSV",
        help="contact circles in the place of what the recipe says: image (name of the press), column_px, row_px, "
        "radius_px",
    )  # fmt: skip
    parser.add_argument("--ball-diameter-mm", type=float, metavar="D", help="in the place of the recipe's")
    parser.add_argument("--mm-per-px", type=float, metavar="S", help="in the place of the recipe's; not px per mm")
    parser.add_argument(
        "--predict-from", type=int, metavar="N", help="teach a table with N presses and predict the others"
    )
    add_out(parser, "FOLDER.captures, a folder with NAME.capture.json")
    parser.set_defaults(run=run_captures)


def run_captures(arguments: argparse.Namespace) -> None:
    """Import and report."""
    from data_schemas import ImportFormatError, provenance
    from data_schemas.storage import ProductSet, digest_as_read, write_record
    from finray_calib.exchange import read_by_recipe, read_circles, recipe_names
    from finray_calib.reports import circles_csv, contacts_png

    if arguments.list:
        give(recipes=list(recipe_names()))
        say(_recipes(recipe_names()))
        return
    folder: Path | None = arguments.folder
    if folder is None or arguments.recipe is None:
        raise ImportFormatError(
            f"give FOLDER and --recipe NAME|FILE; recipes that come with finray: {', '.join(recipe_names())}"
        )
    recipe, recipe_file = _recipe(arguments)
    out = require_new(arguments.out or Path(f"{folder.resolve().name}.captures"))
    circles: dict[str, ContactCircle] = {} if arguments.circles is None else read_circles(arguments.circles)
    with progress_bar("import") as progress:
        found = read_by_recipe(folder, recipe, circles, progress)
    teaching: int | None = arguments.predict_from
    presses = {} if teaching is None else _predicted(list(found.captures.values()), teaching)
    files = sorted(p for p in folder.rglob("*") if digest_as_read(p) is not None)
    files += [recipe_file, *([] if arguments.circles is None else [arguments.circles])]
    origin = provenance(command_line(), input_digests(files))
    with ProductSet(out) as products:
        products.add(out / CONTACTS, contacts_png(found.captures))
        products.add(out / CIRCLES, circles_csv(found.captures).encode())
        for name, capture in found.captures.items():
            write_record(capture, out / f"{file_name(name)}{CAPTURE}", origin, products)
        for name, press in presses.items():
            write_record(press, out / f"{file_name(name)}{PRESS}", origin, products)
    _tell(out, found.captures, found.left_out, presses)


def _recipe(arguments: argparse.Namespace) -> "tuple[Recipe, Path]":
    """Return the recipe, with the sizes that the user gives, and its file."""
    from finray_calib.exchange import read_recipe, with_sizes

    recipe, path = read_recipe(arguments.recipe)
    return with_sizes(recipe, arguments.ball_diameter_mm, arguments.mm_per_px), path


def _recipes(names: tuple[str, ...]) -> str:
    """Return a line for each recipe."""
    from finray_calib.exchange import read_recipe

    return "\n".join(f"{name:28} {read_recipe(name)[0].what}" for name in names)


def _predicted(captures: "list[TactileCapture]", count: int) -> "dict[str, SimulatedPress]":
    """Return name -> prediction of every press that does not teach."""
    from data_schemas import ImportFormatError
    from finray_calib.compare import predict_press, spread_over, teach_table

    if not 1 <= count < len(captures):
        raise ImportFormatError(
            f"--predict-from {count}: must be 1 to {len(captures) - 1}, for {len(captures)} presses"
        )
    teaching = {captures[i].name for i in spread_over(len(captures), count)}
    table = teach_table([capture for capture in captures if capture.name in teaching])
    return {c.name: predict_press(table, c) for c in captures if c.name not in teaching}


def _tell(
    out: Path,
    captures: "dict[str, TactileCapture]",
    left_out: "dict[str, list[str]]",
    presses: "dict[str, SimulatedPress]",
) -> None:
    """Say what was imported and what it lacks."""
    first = next(iter(captures.values()))
    rows, columns = first.contact.shape[:2]
    wrote(out, f"{len(captures)} captures, {columns} x {rows} px, encoding {first.encoding}")
    give(captures=len(captures), width_px=columns, height_px=rows, encoding=first.encoding, source=first.source,
         licence=first.licence, left_out=left_out, predicted=len(presses))  # fmt: skip
    look_at(out / CONTACTS)
    say(f"  {first.source}")
    say(f"  licence: {first.licence or 'not stated by the recipe'}")
    for part in first.missing:
        say(f"  lacks {part.what}: {part.lost}")
    for why, names in left_out.items():
        say(f"  left out: {', '.join(names)}: {why}")
    if presses:
        taught = len(captures) - len(presses)
        say(f"  {len(presses)} presses are predicted by a table that {taught} others taught")
        go_on_with("finray compare", out, out)
    if first.contact_told_by == "search":
        correct = "" if first.contact_circle is None else f", correct {out / CIRCLES}, and import with --circles"
        warn(f"the contacts were searched for: look at {out / CONTACTS}{correct}")
