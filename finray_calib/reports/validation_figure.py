"""The level of the simulation in the parts of the contact, channel by channel, against its validation uncertainty."""

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from data_schemas.compare import ValidationCell
from finray_calib.reports.number_text import percent, signed_percent
from finray_calib.reports.style import INK, MUTED, ORANGE, new_figure, styled, svg_text

_PARTS, _GAP = 3, 0.04


@styled()
def validation_figure(cells: tuple[ValidationCell, ...]) -> str:
    """Draw 3 x 3 parts of one channel: error and 2 u; parts outside it are framed, hatched and named."""
    figure = new_figure(4.0, 3.5)
    axes = figure.subplots()
    for cell in cells:
        _cell(axes, cell)
    axes.set(xlim=(-0.03, _PARTS + 0.03), ylim=(_PARTS + 0.03, -0.03))
    axes.set_axis_off()
    return svg_text(figure)


def _cell(axes: Axes, cell: ValidationCell) -> None:
    """Draw one part."""
    corner, side = (cell.column + _GAP, cell.row + _GAP), 1.0 - 2 * _GAP
    axes.add_patch(Rectangle(corner, side, side, facecolor="none", edgecolor=MUTED, linewidth=0.8))
    if not cell.within:
        axes.add_patch(Rectangle(corner, side, 0.2, facecolor="none", edgecolor=ORANGE, hatch="////", linewidth=0.0))
        axes.add_patch(Rectangle(corner, side, side, facecolor="none", edgecolor=INK, linewidth=2.4))
    weight, colour = ("normal", MUTED) if cell.within else ("bold", INK)
    lines = (
        (0.40, signed_percent(cell.error_rel), 11.0, INK, weight),
        (0.62, f"2 u = {percent(2 * cell.u_validation_rel)}", 9.0, MUTED, "normal"),
        (0.82, "within" if cell.within else "outside", 9.0, colour, weight),
    )
    for down, text, size, ink, bold in lines:
        axes.text(
            cell.column + 0.5, cell.row + down, text, ha="center", va="center", fontsize=size, color=ink, weight=bold
        )
