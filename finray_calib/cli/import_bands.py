"""``finray import bands``: a folder of wavelength-named TIFF images becomes band signals."""

import argparse
from pathlib import Path

from finray_calib.cli.options import add_out, command_line, file_name, naming, require_new, say

HELP = "import a folder of wavelength-named TIFF images of a paint"
DESCRIPTION = """\
Reduce TIFF images that another lab took of a paint through band-pass filters (paint and white reference under
the lamp, paint and white reference under the laser) to band signals for 'finray fit'. The folder must hold a
bands.toml that says which image shows what, and what camera, filters and laser were used: see
docs/how-to/import-band-images.md."""


def add_parser(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser(
        "bands", help=HELP, description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="holds bands.toml and the images")
    add_out(parser, "PAINT.bands.json")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> None:
    """Import and report."""
    import_bands(arguments.folder, arguments.out)


def import_bands(folder: Path, out: Path | None) -> None:
    """Reduce a folder of band images, store the band signals and say what is in them."""
    from data_schemas.errors import RadiometryError
    from data_schemas.provenance import provenance
    from data_schemas.storage import write_record
    from finray_calib.exchange.band_folder import import_band_folder

    if out is not None:
        require_new(out)
    with naming(RadiometryError, folder):
        bands, digests = import_band_folder(folder)
    out = require_new(out or Path(f"{file_name(bands.paint_name)}.bands.json"))
    inputs = {(folder / name).as_posix(): digest for name, digest in digests.items()}
    write_record(bands, out, provenance(command_line(), inputs))
    usable = int(bands.usable().sum())
    say(f"{out}: {len(bands.flags)} filters, {usable} usable values over {bands.region_pixels} px")
    for note in bands.notes:
        say(f"  note: {note}")
