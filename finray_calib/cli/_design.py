"""``finray design``: write a finger's design file, and look at the finger before it is simulated.

Also the reader of the design that any verb is given: a whole finger, or a ready-made one with some numbers changed.
"""

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from finray_calib.cli._run import file_name, naming, open_engine, require_new, say

if TYPE_CHECKING:
    from pydantic import BaseModel

    from data_schemas import FingerDesign
    from sim.optics import CameraView


HELP = "write a finger design; draw it, see what its camera sees, print its parts"
DESCRIPTION = "Write a design file to start from, and look at a finger before anything is simulated."
INIT_DESCRIPTION = "Write the design of a ready-made finger, with comments, to be edited."
SHOW_DESCRIPTION = """\
Say what part of the pad the camera sees through the mirror, how many sensor pixels fall on a millimetre, and what else
is in the picture. With --out FILE.png, draw the finger from the side and from the front, with the names of its parts
and their sizes, and the camera's view below. With --out FILE.html, write one page with that drawing, the finger to be
turned round in a browser, and all its numbers with where they come from."""
EXPORT_DESCRIPTION = """\
Write what a finger is printed from, in mm and in the finger's axes (x across, y along the pad's outward normal, z along
the finger), so that the parts fit together:

  skeleton     fins, ribs and tip, one closed body
  base_plate   a print of its own, because it is stiffer; --one-piece joins it to the skeleton (skeleton_and_base)
  backing      plate on the back fin, where the design has one
  mould        tray in which the pad is cast, coat down, open where the inner face will be; its rim carries the
               film's flange. Upright walls, no allowance for shrinkage

STL is for slicers. STEP (AP214) is for CAD programs: planes, and the exact cylinder or ellipsoid on the bottom of the
mould; curved fins are strips of 1 mm, 0.3 um from their curve."""


_DRAWINGS = (".png", ".html")


def add_design(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
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
        help="drawing, the camera's view of the pad",
        description=SHOW_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    show.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML), or the name of a preset")
    show.add_argument("--engine", choices=["auto", "llvm", "scalar"], default="auto", help="renderer (default: auto)")
    show.add_argument(
        "--out", type=Path, metavar="FILE", help="drawing (.png) or interactive page (.html); must be new"
    )
    show.set_defaults(run=run_show)
    export = actions.add_parser(
        "export",
        help="files to print skeleton, base plate, backing and the pad's mould (STL, STEP)",
        description=EXPORT_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    export.add_argument("design", type=Path, metavar="DESIGN", help="finger design (TOML)")
    export.add_argument("--out", type=Path, metavar="FOLDER", help="default: NAME.print; must be new")
    export.add_argument("--format", choices=["stl", "step", "both"], default="both", help="default: both")
    export.add_argument("--one-piece", action="store_true", help="skeleton and base plate as one body")
    export.add_argument(
        "--lining-mm",
        type=float,
        metavar="MM",
        help="sheet laid on the mould's bottom for a smooth pad (default: 0.1, the paper's Mylar; 0 if ellipsoidal)",
    )
    export.set_defaults(run=run_export)


def run_list(arguments: argparse.Namespace) -> None:
    """Tell the ready-made fingers."""
    from sim import PRESETS

    width = max(len(name) for name in PRESETS)
    for name, (what, _) in PRESETS.items():
        say(f"{name:{width}}  {what}")


def run_init(arguments: argparse.Namespace) -> None:
    """Write a design file."""
    from data_schemas.storage import write_bytes
    from sim import design_toml, preset_design

    design = preset_design(arguments.preset)
    out = require_new(arguments.out or Path(f"{design.name}.toml"))
    write_bytes(out, design_toml(design).encode())
    say(f"{out}: edit it, then 'finray design show {out}'")


def run_show(arguments: argparse.Namespace) -> None:
    """Tell what the camera sees, and draw the finger."""
    from data_schemas import SimulateError
    from data_schemas.storage import write_bytes
    from finray_calib.reports import finger_outline
    from sim import PRESETS, preset_design
    from sim.optics import camera_view

    is_preset = not arguments.design.exists() and str(arguments.design) in PRESETS
    design = preset_design(str(arguments.design)) if is_preset else read_design(arguments.design)
    out = None if arguments.out is None else _drawing_path(arguments.out)
    with naming(SimulateError, arguments.design):
        finger_outline(design, arguments.design.parent)  # parts that do not fit are told before anything is shown
        view = camera_view(design, arguments.design.parent, open_engine(arguments.engine))
    say(str(view))
    if out is not None:
        write_bytes(out, _drawing(view, arguments.design.parent, out.suffix.lower()))
        say(f"{out}: written")


def _drawing_path(path: Path) -> Path:
    """Return where the drawing goes, a new file whose ending says what it is."""
    from data_schemas import RecordError

    if path.suffix.lower() not in _DRAWINGS:
        raise RecordError(f"{path}: a drawing's name must end in {' or '.join(_DRAWINGS)}; choose another --out")
    return require_new(path)


def _drawing(view: "CameraView", folder: Path, suffix: str) -> bytes:
    """Return the drawing as a picture or as a page."""
    from finray_calib.reports import finger_page_png

    picture = finger_page_png(view, folder)
    if suffix == ".png":
        return picture
    from finray_calib.reports import finger_page

    return finger_page(view.design, picture, str(view), folder).encode()


def run_export(arguments: argparse.Namespace) -> None:
    """Write the printed parts and the mould."""
    from data_schemas import SimulateError
    from data_schemas.storage import ProductSet
    from finray_calib.exchange import PrintFormat, printable_parts

    design = read_design(arguments.design)
    folder = require_new(arguments.out or Path(f"{file_name(design.name)}.print"))
    formats: tuple[PrintFormat, ...] = ("stl", "step") if arguments.format == "both" else (arguments.format,)
    with naming(SimulateError, arguments.design):
        parts = printable_parts(design, formats, arguments.one_piece, arguments.lining_mm)
    with ProductSet(folder) as products:
        for part in parts:
            for suffix, content in part.files.items():
                products.add(folder / f"{part.name}.{suffix}", content)
    for part in parts:
        x, y, z = part.size_mm
        names = " and ".join(f"{part.name}.{suffix}" for suffix in part.files)
        say(f"{folder}: {names}: {x:.1f} x {y:.1f} x {z:.1f} mm (x, y, z)" + (f"; {part.note}" if part.note else ""))


OPTIONAL_TABLES: Final = ("mesh",)
"""A choice of how to compute, no part of the finger."""
FILM_MATERIAL: Final = "mechanics.film"
FILM_OF_THE_PAD: Final = "pad.film"


def read_design(path: Path) -> "FingerDesign":
    """Read a finger's design (TOML).

    With ``preset = "flat-70x35"`` above its first table the file changes that ready-made finger; without it the file
    must hold every table of a finger, so that none is made of defaults that nobody asked for.

    Raises
    ------
    RecordError
        See :func:`~data_schemas.storage.read_toml`; tables are missing; of the name of a ready-made finger it says how
        to write its file.
    SimulateError
        There is no ready-made finger of this name.
    """
    from data_schemas import FingerDesign, RecordError, SimulateError
    from data_schemas.storage import read_toml
    from sim import PRESETS, preset_design

    def complete(tables: dict[str, Any]) -> dict[str, Any]:
        written = dict(tables)
        preset = written.pop("preset", None)
        if preset is None:
            _require_tables(path, written, FingerDesign)
            return written
        if not isinstance(preset, str):
            raise RecordError(f"{path}: preset = {preset!r} must be the name of a ready-made finger")
        try:
            ready = preset_design(preset)
        except SimulateError as error:
            raise SimulateError(f"{path}: {error}") from None
        values = ready.model_dump(mode="python", exclude_unset=True)
        origin = {field: where for field, where in ready.origin.items() if not _changes(written, ready, field)}
        return _merged({**values, "origin": origin}, written)

    if path.name == str(path) and path.name in PRESETS and not path.exists():
        raise RecordError(f"{path}: no such file; write it first: finray design init {path}, then give {path}.toml")
    return read_toml(path, FingerDesign, complete)


def _require_tables(path: Path, written: Mapping[str, Any], model: "type[BaseModel]") -> None:
    """Refuse a design in which a part of the finger is not there."""
    from data_schemas import RecordError

    wanted = [name for name in _tables(model) if name != FILM_MATERIAL or _at(written, FILM_OF_THE_PAD) is not None]
    missing = [name for name in wanted if not isinstance(_at(written, name), dict)]
    if missing:
        raise RecordError(
            f"{path}: a finger without {', '.join(f'[{name}]' for name in missing)}; write what is missing (finray "
            'design init writes a whole finger), or let it come from a ready-made one: preset = "flat-70x35" above the '
            "first table (finray design list tells all)"
        )


def _tables(model: "type[BaseModel]", above: str = "") -> Iterator[str]:
    """Yield the dotted names of the tables that every finger has."""
    from pydantic import BaseModel

    for name, field in model.model_fields.items():
        kind = field.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel) and name not in OPTIONAL_TABLES:
            yield f"{above}{name}"
            yield from _tables(kind, f"{above}{name}.")


def _at(table: Any, field: str) -> Any:
    """Return what stands at a dotted path of a table; None where nothing does."""
    for name in field.split("."):
        table = table.get(name) if isinstance(table, Mapping) else None
    return table


def _changes(written: Mapping[str, Any], ready: "FingerDesign", field: str) -> bool:
    """Return whether a file gives a field another value than the ready-made finger has."""
    value: Any = ready
    for name in field.split("."):
        value = getattr(value, name, None)
    given = _at(written, field)
    return given is not None and (tuple(given) if isinstance(given, list) else given) != value


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return tables in which each value of `above` replaces that of `below`."""
    both = {**below, **above}
    for name in below.keys() & above.keys():
        if isinstance(below[name], Mapping) and isinstance(above[name], Mapping):
            both[name] = _merged(below[name], above[name])
    return both
