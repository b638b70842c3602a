"""What a touch changes in the capture and in the render, and what is left over, on one scale."""

from finray_calib.reports.compare_figures import draw_outline
from finray_calib.reports.comparison_images import Floats, TouchChanges
from finray_calib.reports.style import new_figure, styled, svg_text

_LINES = ("-", "--")


def change_figures(changes: TouchChanges) -> tuple[str, str, str]:
    """Draw captured change, simulated change and simulated minus captured, all on one scale with regions outlined."""
    maps = (changes.captured, changes.simulated, changes.simulated - changes.captured)
    captured, simulated, left = (_change_figure(values, changes) for values in maps)
    return captured, simulated, left


@styled()
def _change_figure(values: Floats, changes: TouchChanges) -> str:
    """Draw one map."""
    height, width = changes.regions[0].shape
    figure = new_figure(4.0, 4.0 * height / width + 0.75)
    axes = figure.subplots()
    # cividis is brighter for larger values, so that brighter than untouched is bright also in a grey print
    drawn = axes.imshow(
        values, cmap="cividis", vmin=-changes.scale, vmax=changes.scale, extent=(0.0, float(width), float(height), 0.0)
    )
    for mask, line in zip(changes.regions, _LINES, strict=False):
        draw_outline(axes, mask, line)
    axes.set_axis_off()
    bar = figure.colorbar(drawn, ax=axes, location="bottom", aspect=30, extend="both")
    bar.set_label("change / untouched level (1)")
    return svg_text(figure)
