"""``finray import captures``: another lab's folder of presses becomes tactile captures, read by a recipe."""

import argparse
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, go_on_with, look_at, progress_bar, say, warn, wrote
from finray_calib.cli._run import (
    add_out,
    command_line,
    distinct_file_names,
    input_digests,
    require_new,
)

if TYPE_CHECKING:
    from data_schemas import Record, SimulatedPress, TactileCapture
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
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.exchange import read_by_recipe, read_circles, recipe_names
    from finray_calib.reports import ContactSheet

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
    circles = {} if arguments.circles is None else read_circles(arguments.circles)
    given = [recipe_file, *([] if arguments.circles is None else [arguments.circles])]
    sheet, files, told = ContactSheet(), _Names(), _Told()
    made_of: dict[str, tuple[Path, ...]] = {}
    with ProductSet(out) as products:

        def store(record: "Record", place: str, read: Iterable[Path]) -> None:
            write_record(record, out / place, provenance(command_line(), input_digests([*read, *given])), products)

        def take(name: str, capture: "TactileCapture", read: tuple[Path, ...]) -> None:
            sheet.add(name, capture)
            told.add(capture)
            made_of[name] = read
            store(capture, f"{files.of(name)}{CAPTURE}", read)

        with progress_bar("import") as progress:
            found = read_by_recipe(folder, recipe, circles, progress, take)
        predicted = 0
        for name, press, taught in _predicted(found.captures, arguments.predict_from):
            read = {path for source in (name, *taught) for path in made_of[source]}
            store(press, f"{files.of(name)}{PRESS}", sorted(read))
            predicted += 1
        products.add(out / CONTACTS, sheet.png())
        products.add(out / CIRCLES, sheet.circles_csv().encode())
    _tell(out, told, found.left_out, predicted)


class _Names:
    """Give every press a file name of its own."""

    def __init__(self) -> None:
        self._seen: list[str] = []

    def of(self, name: str) -> str:
        """Return the file name of a press, the same each time."""
        if name not in self._seen:
            self._seen.append(name)
        return distinct_file_names(self._seen)[name]


class _Told:
    """Keep what is said of a set: its size, and what the first capture tells of all."""

    def __init__(self) -> None:
        self.count = 0
        self.first: TactileCapture | None = None

    def add(self, capture: "TactileCapture") -> None:
        """Count a capture; only the first is kept."""
        self.count += 1
        self.first = self.first or capture


def _recipe(arguments: argparse.Namespace) -> "tuple[Recipe, Path]":
    """Return the recipe, with the sizes that the user gives, and its file."""
    from finray_calib.exchange import read_recipe, with_sizes

    recipe, path = read_recipe(arguments.recipe)
    return with_sizes(recipe, arguments.ball_diameter_mm, arguments.mm_per_px), path


def _recipes(names: tuple[str, ...]) -> str:
    """Return a line for each recipe."""
    from finray_calib.exchange import read_recipe

    return "\n".join(f"{name:28} {read_recipe(name)[0].what}" for name in names)


def _predicted(
    captures: "Mapping[str, TactileCapture]", count: int | None
) -> "Iterator[tuple[str, SimulatedPress, list[str]]]":
    """Yield name and prediction of every press that does not teach, also under another name, and which presses do."""
    from data_schemas import ImportFormatError
    from finray_calib.compare import predict_press, spread_over, teach_table
    from finray_calib.sensing import contact_sha256

    if count is None:
        return
    names = list(captures)
    if not 1 <= count < len(names):
        raise ImportFormatError(f"--predict-from {count}: must be 1 to {len(names) - 1}, for {len(names)} presses")
    taught = [names[i] for i in spread_over(len(names), count)]
    table = teach_table([captures[name] for name in taught])
    for name in names:
        capture = captures[name]
        if contact_sha256(capture) not in table.taught_by_sha256:
            yield name, predict_press(table, capture), taught
        elif capture.name not in table.taught_by:
            warn(f"{name}: is the same image as a press that taught the table, and is not predicted")


def _tell(out: Path, told: _Told, left_out: dict[str, list[str]], predicted: int) -> None:
    """Say what was imported and what it lacks."""
    first = told.first
    if first is None:
        return
    rows, columns = first.contact.shape[:2]
    wrote(out, f"{told.count} captures, {columns} x {rows} px, encoding {first.encoding}")
    give(captures=told.count, width_px=columns, height_px=rows, encoding=first.encoding, source=first.source,
         licence=first.licence, left_out=left_out, predicted=predicted)  # fmt: skip
    look_at(out / CONTACTS)
    say(f"  {first.source}")
    say(f"  licence: {first.licence or 'not stated by the recipe'}")
    for part in first.missing:
        say(f"  lacks {part.what}: {part.lost}")
    for why, names in left_out.items():
        say(f"  left out: {', '.join(names)}: {why}")
    if predicted:
        say(f"  {predicted} presses are predicted by a table that others taught")
        go_on_with("finray compare", out, out)
    if first.contact_told_by == "search":
        correct = (
            ""
            if first.contact_circle is None
            else (f", correct {out / CIRCLES} (told_by: label, where you did), and import with --circles")
        )
        warn(f"the contacts were searched for: look at {out / CONTACTS}{correct}")
