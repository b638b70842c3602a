"""The look of every figure: one style, colours safe for colour-blind readers, and bytes that repeat.

Colour never stands alone: every series also has its own marker, line style or hatching.
"""

import base64
import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

# The palette of Okabe and Ito, told apart with all common kinds of colour blindness.
BLUE, VERMILLION, GREEN, ORANGE, SKY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9"
INK, MUTED, HAIRLINE = "#1c2128", "#57606a", "#d0d7de"

CHANNELS = (("red", "o", VERMILLION), ("green", "^", GREEN), ("blue", "s", BLUE))
CANDIDATES = {"do nothing": ("X", MUTED), "simulation": ("o", BLUE), "floor": ("D", ORANGE)}

_STYLE: dict[str, Any] = {
    "svg.hashsalt": "finray-calib",  # a fixed salt makes the ids, and so the bytes, repeat
    "svg.fonttype": "path",  # every reader sees the same lettering
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.labelsize": 10.0,
    "axes.titlesize": 10.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": HAIRLINE,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "hatch.linewidth": 0.6,
    "lines.linewidth": 1.8,
    "errorbar.capsize": 2.5,
    "image.interpolation": "nearest",
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw and save inside the style of the reports, whatever the user's own matplotlib settings."""
    with matplotlib.style.context(["default", _STYLE]):
        yield


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure of a size in inches (96 px on a screen)."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def legend_above(figure: Figure, axes: Axes, columns: int) -> None:
    """Put the legend of the axes above the figure, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=columns, columnspacing=1.4, handletextpad=0.5)


def svg_text(figure: Figure) -> str:
    """Return the figure as SVG text without date or creator, so that equal input gives equal bytes."""
    _lay_out(figure)
    for patch in (figure.patch, *(axes.patch for whole in figure.axes for axes in (whole, *whole.child_axes))):
        patch.set(facecolor="none", edgecolor="none")
    buffer = io.BytesIO()
    # `savefig` would draw all of it once more, for a layout that is done
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})  # type: ignore[no-untyped-call]
    return buffer.getvalue().decode("utf-8")


def _lay_out(figure: Figure) -> None:
    """Place the parts of a figure for SVG."""
    engine, dpi = figure.get_layout_engine(), figure.dpi
    if engine is None:
        return
    FigureCanvasSVG(figure)
    figure.dpi = _SVG_DPI
    for axes in figure.axes:
        axes.apply_aspect()
    engine.execute(figure)
    figure.set_layout_engine("none")
    figure.dpi = dpi


_SVG_DPI = 72.0


@dataclass(frozen=True, slots=True)
class Reading:
    """A text under the pointer, and the strip where it shows, in shares of the figure from the left top."""

    left_rel: float
    top_rel: float
    width_rel: float
    height_rel: float
    text: str


@dataclass(frozen=True, slots=True)
class ReadableFigure:
    """A figure as SVG text, and the values of its curves or points under the pointer."""

    svg: str
    readings: tuple[Reading, ...]


def readable(figure: Figure, axes: Axes, texts: Mapping[float, str]) -> ReadableFigure:
    """Return a figure with a strip over the plot for each place on its horizontal axis that has a text.

    Strips reach half way to their neighbours; places outside the plot are left out.
    """
    svg = svg_text(figure)  # lays the figure out: only now the places of the plot are final
    low, high = sorted(axes.get_xlim())
    places = sorted(place for place in texts if low <= place <= high)
    if not places:
        return ReadableFigure(svg, ())
    middles = [(one + other) / 2 for one, other in pairwise(places)]
    edges = [low, *middles, high]
    if middles:  # the ends reach as far out as in
        edges[0], edges[-1] = max(low, 2 * places[0] - middles[0]), min(high, 2 * places[-1] - middles[-1])
    to_share = axes.transData + figure.transFigure.inverted()
    along = to_share.transform(np.column_stack([edges, np.full(len(edges), axes.get_ylim()[0])]))[:, 0]
    plot = axes.get_position()
    top, height = round(1 - float(plot.y1), 4), round(float(plot.height), 4)
    return ReadableFigure(
        svg,
        tuple(
            Reading(round(float(left), 5), top, round(float(right - left), 5), height, texts[place])
            for place, left, right in zip(places, along[:-1], along[1:], strict=True)
        ),
    )


def png_bytes(figure: Figure, dots_per_inch: int = 120) -> bytes:
    """Return the figure as PNG bytes; equal figures give equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dots_per_inch, metadata={"Software": None})
    return buffer.getvalue()


def svg_data_uri(svg: str) -> str:
    """Return SVG text as a data URI for an HTML image."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg.encode("utf-8")).decode("ascii")
