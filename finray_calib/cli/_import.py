"""``finray import``: what other labs and programs captured or computed becomes records.

Whole sets by a recipe, sensor folders of 9DTact, ball presses of Taxim and gs_sdk, images of a Raspberry Pi camera,
renders of any simulator, folders of band images, tables of band signals, and results files of Abaqus.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli._output import give, progress_bar, say, suggest_command, suggest_file, warn, wrote
from finray_calib.cli._radiometry import add_bands_format, add_signals_format
from finray_calib.cli._run import (
    add_out,
    command_line,
    distinct_file_names,
    file_name,
    input_digests,
    naming,
    require_new,
)

if TYPE_CHECKING:
    from data_schemas import MissingPart, Record, SimulatedPress, TactileCapture
    from finray_calib.exchange import Recipe


IMPORT_HELP = (
    "import what other labs and programs captured or computed (9DTact, Taxim, gs_sdk, Raspberry Pi, renders, Abaqus)"
)
NINE_DTACT = """\
Import a sensor folder of 9DTact as a tactile capture. With --predict-from, also write a simple prediction of
the press: the darkening-to-depth table of the other sensor applied to this one, labelled "table, not
rendered". Compare the two with 'finray compare'."""
RASPBERRY_PI = """\
Import the images of one press as a tactile capture: contact, no_contact and, if there is one,
repeat_no_contact (all DNG or 16-bit TIFF, or all PNG or JPEG), the metadata of each image beside it
(contact.json, from rpicam-still --metadata) and press.toml (name, [indenter]). Images with auto exposure or
auto white balance are refused."""
OTHER = """\
Import the folder of one press in a format that another installed package provides, as a tactile capture. How to
write one: docs/how-to/import-captures.md."""
CAPTURE_OUT = "FOLDER.capture.json, with --predict-from also FOLDER.press.json beside it"


def add_import(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb and its formats."""
    parser = verbs.add_parser("import", help=IMPORT_HELP, description=IMPORT_HELP)
    formats = parser.add_subparsers(dest="format", metavar="FORMAT", title="formats", required=True)
    add_captures_format(formats)
    dtact = _add_format(formats, "9dtact", "sensor folder of 9DTact", NINE_DTACT)
    dtact.add_argument(
        "--predict-from",
        type=Path,
        metavar="FOLDER",
        help="folder of another sensor, whose depth table is used to predict the press",
    )
    pi = _add_format(formats, "raspberry-pi", "images of one press, taken with rpicam-still", RASPBERRY_PI)
    pi.add_argument("--tuning", type=Path, metavar="FILE", help="libcamera tuning file that the camera used")
    pi.add_argument(
        "--undo-colour", action="store_true", help="undo colour matrix and white balance (PNG and JPEG only)"
    )
    pi.add_argument(
        "--flatten-shading",
        action="store_true",
        help="flatten the lens shading with the tables of the tuning file (raw images only)",
    )
    pi.add_argument("--bayer-order", choices=["RGGB", "BGGR", "GRBG", "GBRG"], help="of 16-bit TIFFs")
    pi.add_argument("--bit-depth", type=int, choices=[8, 10, 12, 14, 16], help="of 16-bit TIFFs")
    other = _add_format(formats, "other", "folder of one press, by a format of another package", OTHER)
    other.add_argument(
        "--format", dest="package_format", required=True, metavar="NAME", help="name of the package's format"
    )
    add_ball_press_formats(formats)
    add_render_format(formats)
    add_bands_format(formats)
    add_signals_format(formats)
    add_abaqus_format(formats)


def _add_format(
    formats: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str, help_line: str, description: str
) -> argparse.ArgumentParser:
    """Register a format of tactile captures."""
    parser = formats.add_parser(name, help=help_line, description=description)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of one sensor or one press")
    add_out(parser, CAPTURE_OUT if name == "9dtact" else "FOLDER.capture.json")
    parser.set_defaults(run=run_import, predict_from=None, tuning=None)
    return parser


def run_import(arguments: argparse.Namespace) -> None:
    """Import and report."""
    from data_schemas import ImportFormatError, provenance
    from data_schemas.storage import ProductSet, digest_as_read, write_record

    folder: Path = arguments.folder
    out = require_new(arguments.out or Path(f"{folder.resolve().name}.capture.json"), ".json")
    press_out = out.with_name(f"{out.name.removesuffix('.json').removesuffix('.capture')}.press.json")
    if arguments.predict_from is not None:
        if arguments.predict_from.resolve() == folder.resolve():
            raise ImportFormatError(
                f"--predict-from {arguments.predict_from}: is the same sensor, but a table cannot be tested on the "
                "presses that it was made from; give the folder of another sensor"
            )
        require_new(press_out)
    capture, press = _READERS[arguments.format](arguments)
    sources = [f for f in (folder, arguments.predict_from) if f is not None]
    files = sorted(f for source in sources for f in source.rglob("*") if digest_as_read(f) is not None)
    files += [] if arguments.tuning is None else [arguments.tuning]
    origin = provenance(command_line(), input_digests(files))
    with ProductSet(out) as products:
        if press is not None:
            write_record(press, press_out, origin, products)
        write_record(capture, out, origin, products)
    rows, columns = capture.contact.shape[:2]
    wrote(out, f"{capture.name}, {columns} x {rows} px, encoding {capture.encoding}")
    say(f"  {capture.source}")
    give(captures=1, width_px=columns, height_px=rows, encoding=capture.encoding, source=capture.source)
    if press is not None:
        wrote(press_out, f"{press.name} ({press.label})")
    suggest_command("finray compare", "PRESS" if press is None else press_out, out)


def _nine_dtact(arguments: argparse.Namespace) -> "tuple[TactileCapture, SimulatedPress | None]":
    """Import a 9DTact sensor folder, with a prediction if asked."""
    from finray_calib.exchange import nine_dtact_capture, nine_dtact_prediction

    other: Path | None = arguments.predict_from
    return nine_dtact_capture(arguments.folder), None if other is None else nine_dtact_prediction(
        arguments.folder, other
    )


def _raspberry_pi(arguments: argparse.Namespace) -> "tuple[TactileCapture, None]":
    """Import a folder of Raspberry Pi images."""
    from finray_calib.exchange import RaspberryPiOptions, raspberry_pi_capture, read_tuning

    options = RaspberryPiOptions(
        tuning=None if arguments.tuning is None else read_tuning(arguments.tuning),
        undo_colour=arguments.undo_colour,
        flatten_shading=arguments.flatten_shading,
        bayer_order=arguments.bayer_order,
        bit_depth=arguments.bit_depth,
    )
    return raspberry_pi_capture(arguments.folder, options), None


def _other(arguments: argparse.Namespace) -> "tuple[TactileCapture, None]":
    """Import a folder by a format of another package."""
    from finray_calib.exchange import capture_by_package

    return capture_by_package(arguments.package_format, arguments.folder), None


_READERS: "dict[str, Callable[[argparse.Namespace], tuple[TactileCapture, SimulatedPress | None]]]" = {
    "9dtact": _nine_dtact,
    "raspberry-pi": _raspberry_pi,
    "other": _other,
}


TAXIM = """\
Import the ball presses of a Taxim calibration folder (dataPack.npz, params.json) as tactile captures: 8-bit
values of unknown encoding, with the labelled contact circle. Pickled parts (shadowTable.npz) are never
loaded; what is left out is listed."""
BALL_PRESSES = """\
Import a folder of ball presses as tactile captures. It holds background.png (no contact) and either the catalog.csv of
gs_sdk (a folder per press with gelsight.png and label.npz) or plain images with circles.csv
(image,column_px,row_px,radius_px). Presses without a labelled circle are left out, and named."""


def add_ball_press_formats(formats: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register both formats."""
    for name, help_line, description, run in (
        ("taxim", "ball presses of a Taxim calibration folder", TAXIM, run_taxim),
        ("ball-presses", "background, ball presses and labelled circles (gs_sdk)", BALL_PRESSES, run_ball_presses),
    ):
        parser = formats.add_parser(name, help=help_line, description=description)
        parser.add_argument("folder", type=Path, metavar="FOLDER", help="the calibration folder")
        taxim = name == "taxim"
        ball = "default: 4, as in Taxim's own folders" if taxim else "required unless the catalog gives it"
        scale = "default: pixmm of params.json" if taxim else "required; not px per mm"
        parser.add_argument("--ball-diameter-mm", type=float, metavar="D", help=f"diameter of the ball ({ball})")
        parser.add_argument(
            "--mm-per-px",
            type=float,
            metavar="S",
            required=not taxim,
            help=f"side of a pixel on the gel, mm ({scale})",
        )
        add_out(parser, "FOLDER.captures, a folder with a capture of each press")
        parser.set_defaults(run=run)


def run_taxim(arguments: argparse.Namespace) -> None:
    """Import a Taxim folder and report."""
    from finray_calib.exchange import DATA_PACK, PARAMETERS, read_taxim

    folder: Path = arguments.folder
    out = _new_folder(arguments)
    found = read_taxim(folder, arguments.ball_diameter_mm, arguments.mm_per_px)
    files = [path for path in (folder / DATA_PACK, folder / PARAMETERS) if path.is_file()]
    _store(found.captures, files, out)
    for line in found.assumed:
        say(f"  assumed: {line}")
    _report_left_out(found.left_out)


def run_ball_presses(arguments: argparse.Namespace) -> None:
    """Import a folder of ball presses and report."""
    from data_schemas.storage import digest_as_read
    from finray_calib.exchange import read_ball_presses

    folder: Path = arguments.folder
    out = _new_folder(arguments)
    found = read_ball_presses(folder, arguments.mm_per_px, arguments.ball_diameter_mm)
    files = sorted(p for p in folder.rglob("*") if digest_as_read(p) is not None)
    _store(found.captures, files, out)
    _report_left_out(found.left_out)


def _new_folder(arguments: argparse.Namespace) -> Path:
    """Return the folder to write, which must be new."""
    return require_new(arguments.out or Path(f"{arguments.folder.resolve().name}.captures"))


def _store(captures: "Sequence[TactileCapture]", files: list[Path], out: Path) -> None:
    """Write a capture of each press and say so."""
    from data_schemas import provenance
    from data_schemas.storage import ProductSet, write_record

    origin = provenance(command_line(), input_digests(files))
    with ProductSet(out) as products:
        for number, capture in enumerate(captures, start=1):
            write_record(capture, out / f"press-{number:03d}.capture.json", origin, products)
    rows, columns = captures[0].contact.shape[:2]
    encoding, source = captures[0].encoding, captures[0].source
    wrote(
        out, f"{len(captures)} capture{'' if len(captures) == 1 else 's'}, {columns} x {rows} px, encoding {encoding}"
    )
    say(f"  {source}")
    give(captures=len(captures), width_px=columns, height_px=rows, encoding=encoding, source=source)
    suggest_command("finray sense teach", out)


def _report_left_out(lines: Sequence[str]) -> None:
    """Say what of the folder was left out."""
    give(left_out=list(lines))
    for line in lines:
        say(f"  left out: {line}")


RENDER = """\
Import what a simulator rendered as the simulated side of a comparison: a folder with contact and no_contact
(PNG, JPEG, OpenEXR or npy), depth.npy (mm, positive into the gel) or contact_mask.png, and render.json (simulator,
encoding, channels, contact_circle), or a folder of such folders, one for each press, where no_contact beside
the folders stands for all of them. With --capture the contact is where the circle of the capture is, so that
both sides are scored over one region."""


def add_render_format(formats: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the format."""
    parser = formats.add_parser(
        "render", help="images rendered by any simulator, as the simulated side of a comparison", description=RENDER
    )
    parser.add_argument(
        "folder", type=Path, metavar="FOLDER", help="folder with the images of one press, or a folder of such folders"
    )
    parser.add_argument(
        "--capture", type=Path, metavar="FILE",
        help="capture of the press, or a folder of captures (NAME.capture.json), whose circle or outline marks the "
             "contact",
    )  # fmt: skip
    add_out(parser, "FOLDER.press.json; for several presses FOLDER.presses, a folder with NAME.press.json")
    parser.set_defaults(run=run_render)


def run_render(arguments: argparse.Namespace) -> None:
    """Import renders and report."""
    from data_schemas import provenance
    from data_schemas.storage import ProductSet, digest_as_read, write_record
    from finray_calib.exchange import read_renders

    folder, name = arguments.folder, arguments.folder.resolve().name
    captures, read = _captures(arguments.capture, name)
    presses = read_renders(folder, captures)
    one = name in presses and not (folder / name).is_dir()
    out = require_new(arguments.out or Path(f"{name}.press.json" if one else f"{name}.presses"), ".json" if one else "")
    files = sorted(p for p in folder.rglob("*") if digest_as_read(p) is not None)
    origin = provenance(command_line(), input_digests([*files, *read]))
    with ProductSet(out) as products:
        for press in presses.values():
            write_record(press, out if one else out / f"{file_name(press.name)}.press.json", origin, products)
    first = next(iter(presses.values()))
    rows, columns = first.contact.shape[:2]
    light = "linear light" if first.encoding == "linear" else "encoded values"
    wrote(out, f"{len(presses)} press{'es' if len(presses) > 1 else ''}, {columns} x {rows} px, {light}; {first.label}")
    give(presses=len(presses), width_px=columns, height_px=rows, encoding=first.encoding, label=first.label)
    place: Path | None = arguments.capture
    if one and place is not None and place.is_dir():
        place /= f"{name}{CAPTURE}"
    suggest_command("finray compare", out, place or ("CAPTURE" if one else "CAPTURES"))
    say(f"  {first.notes[0]}")


def _captures(place: Path | None, name: str) -> "tuple[dict[str, TactileCapture], list[Path]]":
    """Return press name -> its capture where that tells where the contact is, and the files that were read."""
    from data_schemas import ImportFormatError, TactileCapture
    from data_schemas.storage import files_in, folder_at, read_record

    if place is None:
        return {}, []
    ending = ".capture.json"
    inside = folder_at(place, ImportFormatError)
    files = [place] if inside is None else files_in(inside, ending)
    read = {(name if inside is None else f.name.removesuffix(ending)): read_record(f, TactileCapture) for f in files}
    found = {press: c for press, c in read.items() if c.contact_circle is not None or c.contact_outline is not None}
    if not found:
        raise ImportFormatError(
            f"{place}: holds no capture with a contact circle or outline; leave --capture out, and describe "
            "the contact in the render's folder (contact_mask.png, depth.npy or render.json)"
        )
    return found, files


ABAQUS_HELP = "import the results file of a deck that Abaqus has run"
ABAQUS_DESCRIPTION = """\
Read the displacements of a finger from the results file (ASCII .fil) of a deck that 'finray export deck DESIGN
--dialect abaqus' wrote: forces and pushes, and the surfaces of the pressed finger for 'finray simulate
render SURFACES'. Give the design and mesh of the deck."""
PRESETS = ("coarse", "medium", "fine")


def add_abaqus_format(formats: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the format."""
    parser = formats.add_parser("abaqus", help=ABAQUS_HELP, description=ABAQUS_DESCRIPTION)
    parser.add_argument("results", type=Path, metavar="FILE.fil", help="results file in ASCII")
    parser.add_argument("--design", type=Path, required=True, metavar="DESIGN", help="the deck's design (TOML)")
    parser.add_argument("--preset", choices=PRESETS, help="mesh of the deck (default: that of the design)")
    add_out(parser, "DESIGN.surfaces.json, beside it DESIGN.mechanics.json")
    parser.set_defaults(run=run_abaqus)


def run_abaqus(arguments: argparse.Namespace) -> None:
    """Import and report."""
    from data_schemas import ImportFormatError, provenance
    from data_schemas.storage import ProductSet, write_record
    from sim import read_design
    from sim.experiments import press_records
    from sim.mechanics.other_engines import pressed_by_abaqus, read_fil

    design = read_design(arguments.design)
    out = require_new(arguments.out or Path(f"{file_name(design.name)}.surfaces.json"), ".json")
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
    wrote(forces_out, mechanics.label)
    give(label=mechanics.label, depth_mm=mechanics.depth_mm, force_n=mechanics.force_n[:, 1],
         unreached=mechanics.unreached)  # fmt: skip
    for depth, force in zip(mechanics.depth_mm, mechanics.force_n, strict=True):
        say(f"  push {depth:6.3f} mm   force {force[1]:7.3f} N")
    if mechanics.unreached:
        say(f"  the push ended early: {mechanics.unreached}")
    wrote(out, "the pressed finger, to be rendered")
    suggest_command("finray simulate render", out, "--paint red=FILE --paint green=FILE")


DESCRIPTION = """\
Import a folder of presses of another lab as tactile captures. A recipe, a short TOML file, says which files are the
presses, where the image without contact is, which columns hold the contact, and what the scale and the ball are. Give
the name of a recipe that comes with finray (--list shows the names) or a file of your own. From a video the images with
contact, without contact, and its repeat are taken. Contact circles that the set does not state are searched for. OUT
gets a capture of each press, a picture of all contacts to check (contacts.png), and circles.csv where a contact is a
circle. If a circle is wrong, correct circles.csv and import again with --circles.

Without --recipe, the command says what the folder holds and writes the start of a recipe for it (OUT ends in .toml).

With --predict-from N, N presses spread over the set train a look-up table. What the table predicts of each other press
is stored beside its capture, and 'finray compare OUT OUT' then scores these predictions as a yardstick for simulators.
Files with pickled objects are never opened."""
CAPTURE, PRESS = ".capture.json", ".press.json"
CONTACTS, CIRCLES, SOLID = "contacts.png", "circles.csv", ".indenter.stl"


def add_captures_format(formats: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the format."""
    parser = formats.add_parser(
        "captures", help="a folder of presses of any lab, read by a recipe", description=DESCRIPTION
    )
    parser.add_argument(
        "folder", type=Path, nargs="?", metavar="FOLDER", help="folder of the set, or a zip archive of it"
    )
    parser.add_argument("--recipe", metavar="NAME|FILE", help="recipe by which the folder is read")
    parser.add_argument("--list", action="store_true", help="list the recipes that come with finray, and stop")
    parser.add_argument(
        "--circles", type=Path, metavar="CSV",
        help="contact circles (CSV) to use instead of those of the recipe, with the columns image (name of the "
             "press), column_px, row_px and radius_px",
    )  # fmt: skip
    parser.add_argument(
        "--ball-diameter-mm",
        type=float,
        metavar="D",
        help="diameter of the ball in mm, instead of that of the recipe",
    )
    parser.add_argument(
        "--mm-per-px",
        type=float,
        metavar="S",
        help="scale in mm per pixel (not px per mm), instead of that of the recipe",
    )
    parser.add_argument(
        "--predict-from", type=int, metavar="N", help="train a look-up table on N presses and predict the others"
    )
    add_out(parser, "FOLDER.captures, a folder with NAME.capture.json")
    parser.set_defaults(run=run_captures)


def run_captures(arguments: argparse.Namespace) -> None:
    """Import and report."""
    from data_schemas import ImportFormatError, provenance
    from data_schemas.storage import ProductSet, write_record
    from finray_calib.exchange import outline_solid_stl, read_by_recipe, read_circles, recipe_names
    from finray_calib.reports import ContactSheet

    if arguments.list:
        give(recipes=list(recipe_names()))
        say(_recipes(recipe_names()))
        return
    folder: Path | None = arguments.folder
    if folder is None:
        raise ImportFormatError(
            "FOLDER is missing; give FOLDER and --recipe NAME|FILE. The recipes that come with finray are "
            f"{', '.join(recipe_names())}"
        )
    if arguments.recipe is None:
        _survey(folder, arguments)
        return
    recipe, recipe_file = _recipe(arguments)
    out = require_new(arguments.out or Path(f"{folder.resolve().name.removesuffix('.zip')}.captures"))
    circles = {} if arguments.circles is None else read_circles(arguments.circles)
    given = [recipe_file, *([] if arguments.circles is None else [arguments.circles])]
    sheet, files, told, predicted = ContactSheet(), _Names(), _Told(), 0
    made_of: dict[str, tuple[Path, ...]] = {}
    with ProductSet(out) as products:

        def store(record: "Record", place: str, read: Iterable[Path]) -> None:
            write_record(record, out / place, provenance(command_line(), input_digests([*read, *given])), products)

        def take(name: str, capture: "TactileCapture", read: tuple[Path, ...]) -> None:
            sheet.add(name, capture)
            told.add(capture)
            made_of[name] = read
            store(capture, f"{files.of(name)}{CAPTURE}", read)
            if recipe.indenter.extruded_mm is not None:
                solid = outline_solid_stl(capture, recipe.indenter.extruded_mm)
                products.add(out / f"{files.of(name)}{SOLID}", solid)

        with progress_bar("import") as progress:
            found = read_by_recipe(folder, recipe, circles, progress, take)
        for name, press, taught in _predicted(found.captures, arguments.predict_from):
            read = {path for source in (name, *taught) for path in made_of[source]}
            store(press, f"{files.of(name)}{PRESS}", sorted(read))
            predicted += 1
        products.add(out / CONTACTS, sheet.png())
        if told.circles:
            products.add(out / CIRCLES, sheet.circles_csv().encode())
    _tell(out, told, found.left_out, predicted)


def _survey(folder: Path, arguments: argparse.Namespace) -> None:
    """Say what a folder holds, and write the start of a recipe."""
    from data_schemas import ImportFormatError
    from data_schemas.storage import write_bytes
    from finray_calib.exchange import survey_folder

    of_recipe = (arguments.circles, arguments.ball_diameter_mm, arguments.mm_per_px, arguments.predict_from)
    if any(value is not None for value in of_recipe):
        raise ImportFormatError(
            "--circles, --ball-diameter-mm, --mm-per-px and --predict-from work only with --recipe NAME|FILE; add "
            "it, or leave them out"
        )
    out = require_new(arguments.out or Path(f"{folder.resolve().name.removesuffix('.zip')}.recipe.toml"), ".toml")
    found = survey_folder(folder)
    write_bytes(out, found.recipe.encode())
    wrote(out, "the start of a recipe: correct it")
    give(files=list(found.lines))
    for line in found.lines:
        say(f"  {line}")
    suggest_command("finray import captures", folder, "--recipe", out)


class _Names:
    """Give every press a file name of its own."""

    def __init__(self) -> None:
        self._seen: list[str] = []

    def of(self, name: str) -> str:
        """Return the file name of a press, the same each time."""
        if name not in self._seen:
            self._seen.append(name)
        return distinct_file_names(self._seen)[name]


#: Presses that are named where only these lack something.
_NAMED = 5


class _Told:
    """Keep what is said of a set: its size, its circles, what the first capture tells of all, and what each lacks."""

    def __init__(self) -> None:
        self.count = self.circles = 0
        self.first: TactileCapture | None = None
        self.lacks: dict[MissingPart, list[str]] = {}

    def add(self, capture: "TactileCapture") -> None:
        """Count a capture and what it lacks; only the first is kept."""
        self.count += 1
        self.circles += capture.contact_circle is not None
        self.first = self.first or capture
        for part in capture.missing:
            self.lacks.setdefault(part, []).append(capture.name)


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
    from finray_calib.compare import predict_press, spread_over, train_table
    from finray_calib.sensing import contact_sha256

    if count is None:
        return
    names = list(captures)
    if not 1 <= count < len(names):
        raise ImportFormatError(
            f"--predict-from {count}: must be 1 to {len(names) - 1} for {len(names)} presses, "
            "because at least one must be left to predict"
        )
    taught = [names[i] for i in spread_over(len(names), count)]
    table = train_table([captures[name] for name in taught])
    for name in names:
        capture = captures[name]
        if contact_sha256(capture) not in table.training_sha256:
            yield name, predict_press(table, capture), taught
        elif capture.name not in table.training_presses:
            warn(f"{name}: has the same image as a training press of the table, so it is not predicted")


def _tell(out: Path, told: _Told, left_out: dict[str, list[str]], predicted: int) -> None:
    """Say what was imported and what it lacks."""
    first = told.first
    if first is None:
        return
    rows, columns = first.contact.shape[:2]
    wrote(out, f"{told.count} captures, {columns} x {rows} px, encoding {first.encoding}")
    give(captures=told.count, width_px=columns, height_px=rows, encoding=first.encoding, source=first.source,
         licence=first.licence, left_out=left_out, predicted=predicted)  # fmt: skip
    suggest_file(out / CONTACTS)
    say(f"  {first.source}")
    say(f"  licence: {first.licence or 'not stated by the recipe'}")
    for part, names in told.lacks.items():
        named = f": {', '.join(names)}" if len(names) <= _NAMED else ""
        some = "" if len(names) == told.count else f" ({len(names)} of {told.count} presses{named})"
        say(f"  lacks {part.what}{some}: {part.lost}")
    for why, names in left_out.items():
        say(f"  left out: {', '.join(names)}: {why}")
    if not told.circles:
        say(f"  {CIRCLES} is not written, because no press has a circle")
    if predicted:
        say(f"  {predicted} presses are predicted by a table that was trained on other presses")
        suggest_command("finray compare", out, out)
    if first.contact_told_by == "search":
        correct = (
            "give the corners of wrong ones as outline_px below [contact] of the recipe, and import again"
            if first.contact_circle is None
            else f"correct wrong circles in {out / CIRCLES} (set source to label in these rows), and import again with "
            "--circles"
        )
        warn(f"the contacts were found by an automatic search; check them in {out / CONTACTS}, {correct}")
