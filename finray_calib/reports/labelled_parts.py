"""Names and sizes in a drawing to scale: rows of labels with leaders, and dimension lines."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from finray_calib.reports.style import INK, MUTED

Floats = NDArray[np.float64]

# mean letter of 8 points, and the space between labels
_LETTER_IN, _SPACE_IN = 0.068, 0.15


@dataclass(frozen=True, slots=True)
class PartLabel:
    """Name of a part and a place on it, in the drawing's own coordinates."""

    text: str
    place_mm: tuple[float, float]


def label_row(axes: Axes, labels: Sequence[PartLabel], height_mm: float, inch_mm: float) -> None:
    """Write labels in a row at a height, in the order of their places, each as near to its place as there is room."""
    ordered = sorted(labels, key=lambda label: label.place_mm[0])
    wanted = np.array([label.place_mm[0] for label in ordered])
    widths = np.array([_LETTER_IN * max(map(len, label.text.split("\n"))) + _SPACE_IN for label in ordered])
    for label, centre in zip(ordered, spread(wanted, inch_mm * widths, axes.get_xlim()), strict=True):
        above = height_mm > label.place_mm[1]
        axes.annotate(
            label.text,
            label.place_mm,
            (centre, height_mm),
            ha="center",
            va="bottom" if above else "top",
            fontsize=8,
            color=INK,
            arrowprops={"arrowstyle": "-", "color": MUTED, "lw": 0.7, "shrinkA": 1, "shrinkB": 0},
            zorder=6,
        )
        axes.plot(*label.place_mm, marker="o", markersize=2.2, color=INK, zorder=6)


def spread(wanted: Floats, widths: Floats, limits: tuple[float, float]) -> Floats:
    """Return ascending centres, as near to the wanted ones as intervals of these widths allow (least squares).

    The sum of half widths before a centre taken from it, this is isotonic regression within bounds, which pooling
    neighbours, then clipping, solves. Where all intervals together do not fit within the limits, they end beyond the
    upper one.
    """
    offsets = np.concatenate([[0.0], np.cumsum((widths[1:] + widths[:-1]) / 2.0)])
    pools: list[tuple[float, int]] = []
    for value in wanted - offsets:
        mean, count = float(value), 1
        while pools and pools[-1][0] > mean:
            before, members = pools.pop()
            mean, count = (before * members + mean * count) / (members + count), members + count
        pools.append((mean, count))
    lowest, highest = limits[0] + widths[0] / 2.0, limits[1] - widths[-1] / 2.0 - offsets[-1]
    pooled = np.repeat([mean for mean, _ in pools], [count for _, count in pools])
    return np.asarray(np.maximum(np.minimum(pooled, highest), lowest) + offsets)


def dimension(
    axes: Axes,
    start_mm: tuple[float, float],
    end_mm: tuple[float, float],
    text: str,
    share: float = 0.5,
    outside: bool = False,
) -> None:
    """Draw a dimension line, its size at a share of its length, or outside where there is no room on it."""
    axes.annotate(
        "", start_mm, end_mm, arrowprops={"arrowstyle": "<->", "color": INK, "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
    )
    x, y = (1.0 - share) * np.array(start_mm) + share * np.array(end_mm)
    upright = abs(end_mm[1] - start_mm[1]) > abs(end_mm[0] - start_mm[0])
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
    if outside:
        axes.text(x + 0.8, y, text, ha="left", va="center", fontsize=8)
    else:
        axes.text(x, y, text, ha="center", va="center", fontsize=8, rotation=90 if upright else 0, bbox=box, zorder=7)
