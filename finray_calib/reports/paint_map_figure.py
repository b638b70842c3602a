"""Figure of a paint map: mode, yield, their uncertainty and chi-square, with a caption in plain words."""

import textwrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from data_schemas.paint_map import MappedQuantity, PaintMap, PaintSpot
from finray_calib.reports.style import HAIRLINE, new_figure, styled, svg_text

Floats = NDArray[np.float64]
MOST_DOTS = 240
"""Dots along the longer side of a map; each shows the median of its pixels."""
SHOWN_PERCENTILES = (1.0, 99.0)
_WIDTH_IN, _CAPTION_SIGNS = 9.6, 122
_NAMES: dict[MappedQuantity, str] = {"mode_nm": "mode", "peak_per_nm": "peak", "energy_yield": "energy yield"}


@styled()
def paint_map_figure(fitted: PaintMap) -> str:
    """Return the figure of a paint map as SVG text."""
    return svg_text(draw_paint_map(fitted))


def draw_paint_map(fitted: PaintMap) -> Figure:
    """Draw five maps with colour bars and the caption."""
    panels: tuple[tuple[str, NDArray[np.floating], str], ...] = (
        ("mode (nm)", fitted.mode_nm, "viridis"),
        ("energy yield (1)", fitted.energy_yield, "cividis"),
        ("chi-square per band (1)", fitted.chi_square / np.maximum(fitted.bands_used, 1), "magma"),
        ("sd of mode (nm)", fitted.mode_sd_nm, "viridis"),
        ("sd of yield, relative (1)", fitted.energy_yield_sd / fitted.energy_yield, "cividis"),
    )
    rows, columns = fitted.mode_nm.shape
    height_in = 2 * min(max(3.0 * rows / columns, 1.4), 3.6) + 1.9
    figure = new_figure(_WIDTH_IN, height_in)
    axes = figure.subplots(2, 3)
    for ax, (title, values, colours) in zip(axes.ravel(), panels, strict=False):
        _draw(figure, ax, fitted, title, values, colours)
    _draw_blocks(figure, axes[1, 2], fitted)
    figure.supxlabel(
        "\n".join(textwrap.wrap(caption(fitted), _CAPTION_SIGNS)), x=0.01, ha="left", fontsize=9, parse_math=False
    )
    return figure


def _draw(figure: Figure, axes: Axes, fitted: PaintMap, title: str, values: NDArray[np.floating], colours: str) -> None:
    """Draw one map; the scale leaves out a hundredth of the pixels at each end."""
    shown = thinned(values)
    low, high = np.nanpercentile(shown, SHOWN_PERCENTILES)
    axes.set_facecolor(HAIRLINE)
    image = axes.imshow(shown, cmap=colours, vmin=low, vmax=high, extent=_extent(fitted))
    _finish(figure, axes, image, title)


def _draw_blocks(figure: Figure, axes: Axes, fitted: PaintMap) -> None:
    """Draw the yield of the blocks relative to their median, symmetric about 0."""
    deviation = fitted.block_energy_yield / np.nanmedian(fitted.block_energy_yield) - 1
    reach = max(float(np.nanmax(np.abs(deviation))), 1e-3)
    rows, columns = deviation.shape
    area, side = fitted.area, fitted.block_px
    left, top = area.column_px, area.row_px
    axes.set_facecolor(HAIRLINE)
    extent = (left, left + columns * side, top + rows * side, top)
    image = axes.imshow(100 * deviation, cmap="PuOr", vmin=-100 * reach, vmax=100 * reach, extent=extent)
    for number, spot in enumerate(fitted.worst_spots, 1):
        axes.annotate(str(number), (spot.column_px, spot.row_px), ha="center", va="center", fontsize=8)
    axes.set(xlim=(left, left + area.width_px), ylim=(top + area.height_px, top))
    _finish(figure, axes, image, f"yield of {side} x {side} px blocks (%)")


def _finish(figure: Figure, axes: Axes, image: object, title: str) -> None:
    """Add title and colour bar; the coordinates are pixels of the raw frame."""
    axes.set_title(title)
    axes.grid(visible=False)
    axes.tick_params(labelsize=8)
    bar = figure.colorbar(image, ax=axes, shrink=0.9, pad=0.02)  # type: ignore[arg-type]
    bar.ax.tick_params(labelsize=8)


def _extent(fitted: PaintMap) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of the map in pixels of the raw frame."""
    area = fitted.area
    return (
        float(area.column_px),
        float(area.column_px + area.width_px),
        float(area.row_px + area.height_px),
        float(area.row_px),
    )


def thinned(values: NDArray[np.floating]) -> Floats:
    """Return a map of at most MOST_DOTS dots a side, each the median of its square of pixels, NaN where none is."""
    rows, columns = values.shape
    side = 2 * -(-max(rows, columns) // (2 * MOST_DOTS))  # whole Bayer cells: no chequers of their channels' noise
    padded = np.full((-(-rows // side) * side, -(-columns // side) * side), np.nan)
    padded[:rows, :columns] = values
    down, across = padded.shape[0] // side, padded.shape[1] // side
    squares = padded.reshape(down, side, across, side).swapaxes(1, 2).reshape(down, across, side**2)
    known = np.isfinite(squares).any(axis=2)
    out = np.full(known.shape, np.nan)
    out[known] = np.nanmedian(squares[known], axis=1)
    return out


def caption(fitted: PaintMap) -> str:
    """Say in plain words what the figure shows."""
    parts = [
        f"Paint '{fitted.paint_name}', {fitted.fitted_pixels} raw pixels ({fitted.family}); grey: not fitted. "
        "Each dot is the median of its pixels; axes are pixels of the raw frame.",
        f"{spread_sentence(fitted, 'energy_yield').capitalize()}.",
        f"{spread_sentence(fitted, 'mode_nm').capitalize()}.",
        "Noisy pixels lean on the fit of the whole region. Chi-square per band up to about 1 means that the curve "
        "explains the pixel; bright patches are dirt, glare or bare ground.",
    ]
    if fitted.worst_spots:
        parts.append(f"Numbers: the blocks that depart most. {spots_note(fitted)}")
    return " ".join(parts)


def spread_sentence(fitted: PaintMap, quantity: MappedQuantity) -> str:
    """Say how much a quantity differs between pixels."""
    spread, name = fitted.uniformity[quantity], _NAMES[quantity]
    if quantity == "mode_nm":
        middle, sd, limit = f"{spread.estimate:.1f} nm", f"{spread.sd:.2f} nm", f"{spread.high:.2f} nm"
    else:
        middle = f"{spread.estimate:.3g}" + (" 1/nm" if quantity == "peak_per_nm" else "")
        sd, limit = (f"{100 * value / spread.estimate:.1f} %" for value in (spread.sd, spread.high))
    if spread.pixels == 0:
        return f"{name}: median {middle}; the pixels are too noisy to tell how uniform the paint is"
    if not spread.resolved:
        return f"{name}: median {middle}; no differences between single pixels beyond their noise (below {limit})"
    return f"{name}: median {middle}; the paint differs by {sd} (1 sd) between pixels, noise subtracted"


def spots_note(fitted: PaintMap) -> str:
    """Say what a block shows that single pixels do not, and what else than paint it may be."""
    return (
        f"Medians of {fitted.block_px} x {fitted.block_px} px show less than the noise of one pixel hides; "
        "the white tile's own texture counts as the paint's: a session with the tile shifted tells them apart."
    )


def spot_sentence(spot: PaintSpot) -> str:
    """Say where the yield departs and by how much."""
    return (
        f"around row {spot.row_px}, column {spot.column_px}: yield {100 * spot.deviation_rel:+.1f} % "
        f"(+-{100 * spot.deviation_sd_rel:.1f} %), mode {spot.mode_shift_nm:+.1f} nm"
    )
