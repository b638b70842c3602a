"""Picture of what a finger's camera sees: the parts in its frame with a millimetre grid, and how finely."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, SubFigure

from finray_calib.reports.style import (
    BLUE,
    GREEN,
    HAIRLINE,
    INK,
    MUTED,
    ORANGE,
    VERMILLION,
    new_figure,
    png_bytes,
    styled,
)
from sim.experiments.camera_view import CameraView

_COLOURS = {"coat": "#f3efe6", "red": VERMILLION, "green": GREEN, "panel 1": BLUE, "panel 2": BLUE}
_GRID_ALONG_MM, _GRID_ACROSS_MM = 10.0, 5.0


@styled()
def camera_view_png(view: CameraView) -> bytes:
    """Return the figure of a camera's view as PNG bytes."""
    return png_bytes(draw_camera_view(view))


def draw_camera_view(view: CameraView) -> Figure:
    """Draw the camera's frame on the left and the pad on the right."""
    figure = new_figure(11.0, 4.6)
    draw_camera_view_on(figure, view)
    return figure


def draw_camera_view_on(figure: Figure | SubFigure, view: CameraView) -> None:
    """Draw the camera's frame on the left and the pad on the right of a figure or a part of one."""
    frame, pad = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _draw_frame(frame, view)
    shown = _draw_pad(pad, view)
    bar = figure.colorbar(shown, ax=pad, shrink=0.9)
    bar.set_label("sensor pixels per mm of the coat (geometric mean)")


def _draw_frame(axes: Axes, view: CameraView) -> None:
    """Draw which part each pixel sees, and lines of equal place on the coat."""
    maps, camera = view.maps, view.design.camera
    picture = np.full((*maps.part.shape, 3), to_rgb(INK))
    for name in maps.parts:
        picture[maps.sees(name)] = to_rgb(_COLOURS.get(name, MUTED))
    extent = (0.0, float(camera.width_px), float(camera.height_px), 0.0)
    axes.imshow(picture, extent=extent, interpolation="nearest")
    place = maps.coat_mm(view.design)
    rows, columns = maps.part.shape
    x, y = (np.arange(columns) + 0.5) / columns * camera.width_px, (np.arange(rows) + 0.5) / rows * camera.height_px
    for k, step, name, colour in ((0, _GRID_ALONG_MM, "z", MUTED), (1, _GRID_ACROSS_MM, "x", ORANGE)):
        values = place[..., k]
        levels = np.arange(np.ceil(np.nanmin(values) / step) * step, np.nanmax(values), step)
        if levels.size:
            lines = axes.contour(x, y, values, levels=levels, colors=colour, linewidths=0.9)
            axes.clabel(lines, fmt=f"{name} %g", fontsize=7)
    axes.grid(visible=False)
    seen = ", ".join(
        f"{label} {view.picture_share(name):.1%}"
        for name, label in (("coat", "coat"), ("red", "red wall"), ("green", "green wall"))
    )
    axes.set(
        title=f"camera's frame: {seen}\n(black: the cloth; blue: a light panel)",
        xlabel="column (px)",
        ylabel="row (px)",
    )


def _draw_pad(axes: Axes, view: CameraView) -> PolyCollection:
    """Draw the pad and, at the places that are seen, how finely."""
    pad = view.design.pad
    fine = np.sqrt(view.px_per_mm_along * view.px_per_mm_across)
    place = view.maps.coat_mm(view.design)[..., ::-1]
    corners = np.stack([place[:-1, :-1], place[:-1, 1:], place[1:, 1:], place[1:, :-1]], axis=-2)
    values = np.stack([fine[:-1, :-1], fine[:-1, 1:], fine[1:, 1:], fine[1:, :-1]], axis=-1)
    whole = np.isfinite(corners).all(axis=(-1, -2)) & np.isfinite(values).any(axis=-1)
    axes.set_facecolor(HAIRLINE)
    shown = PolyCollection(corners[whole], array=np.nanmean(values[whole], axis=-1), cmap="viridis", edgecolors="face")
    axes.add_collection(shown)
    axes.set(
        xlim=(-pad.width_mm / 2, pad.width_mm / 2),
        ylim=(0.0, pad.length_mm),
        aspect="equal",
        title=f"pad: {view.coat_share:.0%} of the coat is seen (grey: not)",
        xlabel="x across (mm)",
        ylabel="z along, from the base (mm)",
    )
    axes.grid(visible=False)
    return shown
