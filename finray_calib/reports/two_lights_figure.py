"""Figure of one panel beside two: their pictures, and how evenly each lights the coat. PNG bytes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure

from data_schemas.illumination import TwoLights
from finray_calib.reports.illumination_pictures import (
    BAND_COLOURS,
    BAND_TITLES,
    DOTS_PER_INCH,
    draw_pictures,
    explain_pictures,
)
from finray_calib.reports.style import new_figure, png_bytes, styled


@styled()
def two_lights_png(study: TwoLights) -> bytes:
    """Draw the images with one panel and with two, and below how even the light is."""
    figure = new_figure(13.5, 8.6)
    above, below = figure.subfigures(2, 1, height_ratios=(1.25, 1.0), squeeze=False)[:, 0]
    draw_pictures(above, study, [name.replace(", ", ",\n") for name in study.lights], (0, 1), 0)
    _evenness_panels(below, study)
    explain_pictures(figure, study)
    return png_bytes(figure, DOTS_PER_INCH)


def _evenness_panels(figure: SubFigure, study: TwoLights) -> None:
    """Draw each band along the pad with one panel and two, and the variation over the coat."""
    *along, variation = figure.subplots(1, 4)
    for axes, band in zip(along, study.bands, strict=False):
        k = study.channels.index(band)
        for name, dashes, values in zip(study.lights, ("--", "-"), study.along_rel, strict=True):
            axes.semilogy(study.z_mm, values[k], dashes, color=BAND_COLOURS[band], label=name)
        axes.set(title=f"{BAND_TITLES[band]} along the pad", xlabel="z along, from the base (mm)")
        axes.legend(loc="best", fontsize=8)
    along[0].set_ylabel("mean over the width, relative to the\nmean with one panel (log scale)")
    _variation_panel(variation, study)


def _variation_panel(axes: Axes, study: TwoLights) -> None:
    """Draw the variation of each band over the whole coat and its middle, with one panel and two."""
    width = 0.2
    of = {(u.lights, u.channel): u for u in study.uniformity}
    for n, (name, hatch) in enumerate(zip(study.lights, ("", "//"), strict=True)):
        for m, (part, alpha) in enumerate((("variation_rel", 0.45), ("middle_variation_rel", 1.0))):
            at = np.arange(len(study.bands)) + (2 * m + n - 1.5) * width
            axes.bar(at, [getattr(of[name, b], part) for b in study.bands], width, hatch=hatch, alpha=alpha,
                     color=[BAND_COLOURS[b] for b in study.bands], edgecolor="white",
                     label=f"{name.split(',')[0]}, {('whole coat', 'middle 70 %')[m]}")  # fmt: skip
    axes.set_xticks(np.arange(len(study.bands)), [BAND_TITLES[b].split(" ")[0] for b in study.bands])
    axes.set(title="variation over the coat (sd / mean)\npale: whole coat, full: middle 70 %;\nhatched: two panels")
    axes.grid(visible=False, axis="x")
