"""``finray fit PIXELS --map``: the emission of a paint pixel by pixel, and how uniform the paint is."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from finray_calib.cli.options import command_line, file_name, input_digests, naming, progress_bar, require_new, say

if TYPE_CHECKING:
    from data_schemas.paint_map import PaintMap


def run_map(arguments: argparse.Namespace) -> None:
    """Fit every pixel, store the map with its figure, and report.

    Parameters
    ----------
    arguments
        ``bands``: path of the pixel signals; ``paint``: path of the region's fit, required; ``out``: path or none.

    Raises
    ------
    FitError
        No fit of the region was given, or pixels and fit do not go together.
    """
    from data_schemas.errors import FitError
    from data_schemas.fit import PaintCalibration
    from data_schemas.product_set import ProductSet
    from data_schemas.provenance import provenance
    from data_schemas.radiometry import PixelSignals
    from data_schemas.storage import read_record, write_record
    from finray_calib.fit.pixel_maps import map_paint
    from finray_calib.reports.paint_map_figure import paint_map_figure

    if arguments.paint is None:
        raise FitError(
            f"{arguments.bands}: a map needs the fit of the region of the same session; run 'finray fit BANDS' first "
            "and add --paint PAINT.paint.json"
        )
    pixels = read_record(arguments.bands, PixelSignals)
    paint = read_record(arguments.paint, PaintCalibration)
    out = require_new(arguments.out or Path(f"{file_name(pixels.paint_name)}.map.json"))
    picture = require_new(out.with_suffix(".svg"))
    with progress_bar("fit every pixel"), naming(FitError, arguments.bands, arguments.paint):
        fitted = map_paint(pixels, paint)
    drawn = paint_map_figure(fitted).encode()
    digests = input_digests([arguments.bands, arguments.paint])
    with ProductSet(out) as products:
        products.add(picture, drawn)
        write_record(fitted, out, provenance(command_line(), digests), products)
    say(f"{out}: '{fitted.paint_name}' in {fitted.fitted_pixels} pixels ({fitted.family}); figure {picture}")
    _report(fitted)


def _report(fitted: "PaintMap") -> None:
    """Say how uniform the paint is and what could not be fitted."""
    from finray_calib.reports.paint_map_figure import spot_sentence, spots_note, spread_sentence

    for quantity in fitted.uniformity:
        say(f"  {spread_sentence(fitted, quantity)}")
    if fitted.unusable_pixels:
        say(f"  {fitted.unusable_pixels} pixels are masked or have fewer than four usable bands")
    if fitted.unconverged_pixels:
        say(f"  warning: {fitted.unconverged_pixels} pixels did not converge")
    if fitted.worst_spots:
        say(f"  spots whose yield departs. {spots_note(fitted)}")
    for spot in fitted.worst_spots:
        say(f"  {spot_sentence(spot)}")
