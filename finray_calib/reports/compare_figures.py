"""Figures of a comparison: the error map and the score of every region. Each returns SVG text."""

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from data_schemas.compare import PhotometricErrorReport
from finray_calib.reports.comparison_images import coarser
from finray_calib.reports.demo_results import row_of
from finray_calib.reports.style import CANDIDATES, INK, MUTED, new_figure, styled, svg_text

SHOWN_PERCENTILE = 99.0
"""The colour scale ends here, in per cent of the pixels, so that single glints do not flatten the map."""


@styled()
def error_map_figure(
    report: PhotometricErrorReport, outline: NDArray[np.bool_], window: tuple[slice, slice] | None = None
) -> str:
    """Draw the error map with its colour bar and the outline of the headline region.

    Parameters
    ----------
    report
        Comparison whose map is drawn.
    outline
        (H, W) mask of the headline region, on any grid of the same view.
    window
        Rows and columns of that grid to show; all when None.
    """
    error = coarser(np.abs(report.error_map).astype(np.float64))
    height, width = outline.shape
    rows, columns = window or (slice(0, height), slice(0, width))
    view = (min(rows.stop, height) - rows.start) / (min(columns.stop, width) - columns.start)
    figure = new_figure(5.4, 5.4 * 0.8 * view + 0.1)
    axes = figure.subplots()
    top = float(np.nanpercentile(error, SHOWN_PERCENTILE))
    extent = (0.0, float(width), float(height), 0.0)
    drawn = axes.imshow(error, cmap="cividis", vmin=0.0, vmax=top if top > 0 else 1.0, extent=extent)
    draw_outline(axes, outline, "--")
    axes.set(xlim=(columns.start, min(columns.stop, width)), ylim=(min(rows.stop, height), rows.start))
    axes.set_axis_off()
    bar = figure.colorbar(drawn, ax=axes, shrink=0.9, extend="max")
    bar.set_label("error / untouched level (1)")
    return svg_text(figure)


def draw_outline(axes: Axes, mask: NDArray[np.bool_], line: str) -> None:
    """Draw the border of a region, in its own pixels, as a dark line on a white one that is seen on any ground."""
    if not mask.any() or mask.all():
        return
    centers = np.arange(mask.shape[1]) + 0.5, np.arange(mask.shape[0]) + 0.5
    axes.contour(*centers, mask.astype(float), levels=[0.5], colors="white", linewidths=2.6)
    axes.contour(*centers, mask.astype(float), levels=[0.5], colors=INK, linewidths=1.2, linestyles=line)


@styled()
def score_figure(report: PhotometricErrorReport) -> str:
    """Draw the skill of doing nothing, of the simulation and of a repeat, region by region."""
    figure = new_figure(5.4, 0.85 * len(report.regions) + 1.2)
    axes = figure.subplots()
    named: set[str] = set()
    for place, region in enumerate(report.regions):
        for offset, (candidate, (marker, colour)) in zip((0.22, 0.0, -0.22), CANDIDATES.items(), strict=True):
            row = row_of(region, candidate)
            if row is None:
                continue
            skill = row.skill
            error = [[max(skill.estimate - skill.low95, 0.0)], [max(skill.high95 - skill.estimate, 0.0)]]
            axes.errorbar(
                [skill.estimate],
                [place + offset],
                xerr=error,
                fmt=marker,
                color=colour,
                markersize=6.5,
                linewidth=1.6,
                label=None if candidate in named else candidate,
            )
            named.add(candidate)
    axes.axvline(0, color=MUTED, linewidth=1)
    axes.axvline(1, color=MUTED, linewidth=1, linestyle=":")
    axes.set(ylim=(len(report.regions) - 0.5, -0.5), xlabel="skill (1): 0 is doing nothing, 1 is perfect")
    axes.set_yticks(range(len(report.regions)), [_wrapped(region.region) for region in report.regions])
    axes.grid(visible=False, axis="y")
    figure.legend(loc="outside upper left", ncols=3)
    return svg_text(figure)


def _wrapped(name: str) -> str:
    """Break a long name after the word nearest to its middle; a dollar sign is shown, not read as mathematics."""
    breaks = [i for i, letter in enumerate(name) if letter == " "]
    if len(name) > 14 and breaks:
        at = min(breaks, key=lambda i: abs(i - len(name) / 2))
        name = f"{name[:at]}\n{name[at + 1 :]}"
    return name.replace("$", r"\$")
