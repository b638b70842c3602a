"""Figures of a comparison: error map, changes by the touch, scores, budget, level by part, and force over the push."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from data_schemas import (
    FittedModulus,
    FittedToneCurve,
    ForceComparison,
    InputUncertainty,
    MaterialFit,
    PhotometricErrorReport,
    ValidationCell,
)
from finray_calib.reports._comparison_statements import row_of
from finray_calib.reports._images import Floats, TouchChanges, coarser, on_grid
from finray_calib.reports._plain_text import percent, signed_percent
from finray_calib.reports._style import (
    BLUE,
    CANDIDATES,
    CHANNELS,
    INK,
    MUTED,
    ORANGE,
    VERMILLION,
    legend_above,
    new_figure,
    png_bytes,
    styled,
    svg_text,
)

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
    figure, axes, below = _picture_over_bar(5.4, view)
    top = _top_inside(error, outline)
    extent = (0.0, float(width), float(height), 0.0)
    drawn = axes.imshow(error, cmap="cividis", vmin=0.0, vmax=top if top > 0 else 1.0, extent=extent)
    draw_outline(axes, outline, "--")
    axes.set(xlim=(columns.start, min(columns.stop, width)), ylim=(min(rows.stop, height), rows.start))
    axes.set_axis_off()
    _put_bar(figure, drawn, below, "error / untouched level (1)", "max")
    return svg_text(figure)


def _top_inside(error: NDArray[np.float64], outline: NDArray[np.bool_]) -> float:
    """Return what 99 % of a map stays below inside an outline, on a grid of the same view: the end of its colours."""
    inside = error[on_grid(outline, error.shape)]
    shown = inside if np.isfinite(inside).any() else error
    return float(np.nanpercentile(shown, SHOWN_PERCENTILE))


def draw_outline(axes: Axes, mask: NDArray[np.bool_], line: str) -> None:
    """Draw the border of a region, in its own pixels, as a dark line on a white one that is seen on any ground."""
    if not mask.any() or mask.all():
        return
    centers = np.arange(mask.shape[1]) + 0.5, np.arange(mask.shape[0]) + 0.5
    axes.contour(*centers, mask.astype(float), levels=[0.5], colors="white", linewidths=2.6)
    axes.contour(*centers, mask.astype(float), levels=[0.5], colors=INK, linewidths=1.2, linestyles=line)


_TALLEST = 1.2
"""Height of a picture over its width: the strip under a cylinder is six times as tall, and would fill screens."""


@styled()
def cause_figure(changed: NDArray[np.float32], all_changes: NDArray[np.float32]) -> str:
    """Draw what one cause changes in the image, on the scale of the largest of all causes.

    Parameters
    ----------
    changed
        (H, W) change relative to the pad's level.
    all_changes
        (causes, H, W) of which it is one.
    """
    rows, columns = np.flatnonzero(all_changes.any(axis=(0, 2))), np.flatnonzero(all_changes.any(axis=(0, 1)))
    shown = np.s_[..., rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if rows.size else np.s_[...]
    part = changed[shown]
    # what is cut away has no changes, and would pull the end of the colours down to them
    top = max(float(np.percentile(np.abs(all_changes[shown]), SHOWN_PERCENTILE)), 1e-9)
    figure, axes, below = _picture_over_bar(4.4, min(part.shape[0] / part.shape[1], _TALLEST))
    drawn = axes.imshow(part, cmap="PuOr_r", vmin=-top, vmax=top)
    axes.set_axis_off()
    _put_bar(figure, drawn, below, "change / level (1)", "both")
    return svg_text(figure)


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


def _put_bar(figure: Figure, drawn: AxesImage, below: Axes, label: str, extend: str) -> None:
    """Draw the bar of colours of a picture, with as many numbers as have room."""
    bar = figure.colorbar(drawn, cax=below, orientation="horizontal", extend=extend, ticks=MaxNLocator(_MOST_TICKS))
    bar.set_label(label)


_MOST_TICKS = 5
_LINES = ("-", "--")


@styled()
def change_figures(changes: TouchChanges) -> tuple[str, str, str]:
    """Draw captured change, simulated change and simulated minus captured, all on one scale with regions outlined."""
    height, width = changes.regions[0].shape
    figure, axes, below = _picture_over_bar(4.0, height / width)
    # cividis is brighter for larger values, so that brighter than untouched is bright also in a grey print
    drawn = axes.imshow(
        changes.captured, cmap="cividis", vmin=-changes.scale, vmax=changes.scale,
        extent=(0.0, float(width), float(height), 0.0),
    )  # fmt: skip
    for mask, line in zip(changes.regions, _LINES, strict=False):
        draw_outline(axes, mask, line)
    axes.set_axis_off()
    _put_bar(figure, drawn, below, "change / untouched level (1)", "both")

    def with_values(values: Floats) -> str:
        drawn.set_data(values)
        return svg_text(figure)

    left = changes.simulated - changes.captured
    return with_values(changes.captured), with_values(changes.simulated), with_values(left)


def _picture_over_bar(width_in: float, height_rel: float) -> tuple[Figure, Axes, Axes]:
    """Return a figure of a picture as wide as it, and the axes of the picture and of a bar of colours below.

    The places are known, so nothing has to be laid out, which takes as long as drawing.
    """
    below_in, picture_in = 0.62, width_in * height_rel
    figure = Figure(figsize=(width_in, picture_in + below_in))
    share = below_in / (picture_in + below_in)
    return (
        figure,
        figure.add_axes((0.0, share, 1.0, 1.0 - share)),
        figure.add_axes((0.04, 0.72 * share, 0.92, 0.17 * share)),
    )


@styled()
def tone_figure(curve: FittedToneCurve) -> str:
    """Draw the captured level over the render's light without contact, with the fitted curve and all of its draws."""
    figure = new_figure(5.4, 3.6)
    axes = figure.subplots()
    light = np.linspace(curve.log_light.min(), curve.log_light.max(), 80)
    for c, (name, marker, colour) in enumerate(CHANNELS):
        if curve.log_light.any() and not curve.log_light[:, c].any():
            continue  # a render without light in it
        axes.plot(
            curve.log_light[:, c], curve.level_dn[:, c], marker, color=colour, markersize=3, alpha=0.35, linewidth=0
        )
        drawn = np.array([_through(curve, c, p, b, light) for p, b in curve.draws])
        low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
        axes.fill_between(light, low, high, color=colour, alpha=0.2, linewidth=0)
        best = _through(curve, c, curve.exponent.estimate, curve.offset_dn.estimate, light)
        axes.plot(light, best, color=colour, linewidth=1.6, label=name, marker=marker, markevery=20, markersize=5)
    axes.set(xlabel="light of the render, ln(L / mean of its channel) (1)", ylabel="captured level (DN)")
    figure.legend(loc="outside upper left", ncols=3)
    return svg_text(figure)


def _through(curve: FittedToneCurve, channel: int, exponent: float, offset_dn: float, light: Floats) -> Floats:
    """Return the level of a channel over the logarithm of light, through the middle of its points."""
    level = np.maximum(curve.level_dn[:, channel] - offset_dn, 1e-3)
    middle = (np.log(level) - exponent * curve.log_light[:, channel]).mean()
    return np.asarray(offset_dn + np.exp(middle + exponent * light))


_LOOK = {"A": ("from repeated observations (A)", BLUE, ""), "B": ("from other knowledge (B)", ORANGE, "///")}
_LINE_LENGTH = 24


@styled()
def budget_figure(bars: list[tuple[InputUncertainty, float]], text: Callable[[float], str], label: str) -> str:
    """Draw one bar for each input, the longest on top, with its value written at its end.

    Parameters
    ----------
    bars
        Inputs and the standard uncertainty that each makes alone.
    text
        How a value is written.
    label
        What the values are, with their unit.
    """
    ranked = sorted(bars, key=lambda bar: bar[1])
    top = max((value for _, value in ranked), default=0.0) or 1.0
    figure = new_figure(5.6, 0.46 * len(ranked) + 1.2)
    axes = figure.subplots()
    seen: set[str] = set()
    for place, (line, value) in enumerate(ranked):
        name, colour, hatch = _LOOK[line.evaluation]
        named = None if line.evaluation in seen else name
        seen.add(line.evaluation)
        axes.barh(place, value, height=0.6, color=colour, edgecolor=INK, hatch=hatch, linewidth=0.6, label=named)
        axes.text(value + 0.015 * top, place, text(value), va="center", fontsize=9)
    axes.set_yticks(range(len(ranked)), [_in_lines(line.input) for line, _ in ranked])
    axes.set(xlim=(0.0, 1.25 * top), xlabel=label)
    axes.locator_params(axis="x", nbins=5)
    axes.grid(visible=False, axis="y")
    figure.legend(loc="outside upper left", ncols=2, columnspacing=1.2)
    return svg_text(figure)


def _in_lines(name: str) -> str:
    """Return a name in at most two lines that leave room for the bars; a dollar sign is no mathematics here."""
    lines = [""]
    for word in name.split():
        longer = f"{lines[-1]} {word}".strip()
        if len(longer) <= _LINE_LENGTH or not lines[-1]:
            lines[-1] = longer
        else:
            lines.append(word)
    if len(lines) > 2:
        lines = [lines[0], f"{lines[1]}\N{HORIZONTAL ELLIPSIS}"]
    return "\n".join(line[: _LINE_LENGTH + 1] for line in lines).replace("$", r"\$")


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


@styled()
def force_figure_png(comparison: ForceComparison) -> bytes:
    """Return a picture of a force comparison as PNG bytes.

    Above, the simulated force with its 95 % band over the design's inputs, and the measured points; below, simulated
    minus measured with 2 u_val. Points beyond 2 u_val are crosses. Without band and crosses where they are withheld.
    """
    points = sorted(comparison.points, key=lambda point: point.depth_mm)
    depth = np.array([p.depth_mm for p in points])
    measured, error = np.array([p.force_n for p in points]), np.array([p.error_n for p in points])
    curve = np.array([p.simulated_n.estimate for p in points])
    # withheld ends are not numbers
    low, high = np.array([(p.simulated_n.low95, p.simulated_n.high95) for p in points], dtype=np.float64).T
    doubled = 2.0 * np.array([p.u_validation_n for p in points])
    told, within = not comparison.withheld, np.array([p.within is not False for p in points])
    figure = new_figure(7.0, 6.4)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    if told:
        above.fill_between(depth, low, high, color=BLUE, alpha=0.2, lw=0.0, label="its 95 % band (inputs and numerics)")
        below.fill_between(depth, -doubled, doubled, color=MUTED, alpha=0.25, lw=0.0, label="2 u_val")
    above.plot(depth, curve, color=BLUE, label="simulated")
    near = ", within 2 u_val" if told else ""
    for own, marker, colour, said in ((within, "o", INK, near), (~within, "X", VERMILLION, ", beyond it")):
        if own.any():
            above.plot(depth[own], measured[own], marker, color=colour, ms=4, label=f"measured{said}")
            below.plot(depth[own], error[own], marker, color=colour, ms=4)
    below.axhline(0.0, color=MUTED, lw=0.8)
    above.set(ylabel="force along the pad's normal (N)")
    below.set(xlabel="push from first touch (mm)", ylabel="simulated - measured (N)")
    if told:
        below.legend(loc="best")
    legend_above(figure, above, 2)
    return png_bytes(figure)


@styled()
def material_fit_png(fit: MaterialFit) -> bytes:
    """Return a picture of a material fit as PNG bytes.

    Left, each curve: measured points, and the fitted force with the band in which 95 % of points measured again would
    lie. Right, each modulus before (grey) and after the curves (blue where measured, orange where the prior speaks),
    over its median: 95 % intervals, in a logarithmic scale.
    """
    rows = len(fit.curves)
    figure = new_figure(9.0, max(3.6, 2.6 * rows))
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.3, 1.0))
    for k, curve in enumerate(fit.curves):
        axes = figure.add_subplot(grid[k, 0])
        order = np.argsort(curve.displacement_mm)
        at = curve.displacement_mm[order]
        axes.fill_between(at, curve.low95_n[order], curve.high95_n[order], color=BLUE, alpha=0.2, lw=0.0)
        axes.plot(at, curve.fitted_n[order], color=BLUE, label="fitted, 95 % band of a point")
        axes.plot(at, curve.force_n[order], "o", color=INK, ms=3, label="measured")
        axes.axvline(curve.first_touch_mm.estimate, color=MUTED, lw=0.8, ls="--")
        axes.set(xlabel="displacement (mm), dashed: first touch", ylabel="force (N)")
        axes.set_title(f"{curve.measured}: {curve.specimen}", fontsize=9, parse_math=False)
        axes.legend(loc="upper left")
    _draw_moduli(figure.add_subplot(grid[:, 1]), fit.moduli)
    return png_bytes(figure)


def _draw_moduli(axes: Axes, moduli: Sequence[FittedModulus]) -> None:
    """Draw each modulus before and after the curves."""
    for k, modulus in enumerate(moduli):
        after, before = modulus.posterior, modulus.prior
        middle, colour = after.estimate, BLUE if modulus.verdict == "measured" else ORANGE
        axes.plot([before.low95 / middle, before.high95 / middle], [k + 0.14] * 2, color=MUTED, lw=3)
        axes.plot([after.low95 / middle, after.high95 / middle], [k - 0.14] * 2, color=colour, lw=5)
        axes.plot([1.0], [k - 0.14], "|", color=INK, ms=10)
        unit = "" if modulus.unit == "1" else f" {modulus.unit}"
        name = modulus.field.removeprefix("mechanics.")
        told = f"{name}: {after.estimate:.3g} [{after.low95:.3g}, {after.high95:.3g}]{unit}, {modulus.verdict}"
        axes.text(0.02, k + 0.3, told, fontsize=8, transform=axes.get_yaxis_transform())
    axes.set(xscale="log", yticks=[], ylim=(len(moduli) - 0.4, -0.6), xlabel="over the median")
    axes.set_title("95 % before (grey) and after the curves", fontsize=9)
