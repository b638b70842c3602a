"""Figures of fitted paints: spectra and parameters, signals filter by filter, and maps of mode and yield. SVG text."""

import textwrap
from collections.abc import Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from data_schemas import MappedQuantity, Optics, PaintCalibration, PaintMap, PaintSpot, PaintWithoutEmission
from finray_calib.fit import BudgetRow
from finray_calib.reports._fit_statements import BUDGET_NAMES, joined_budget, parameter_words
from finray_calib.reports._fitted_paint import FittedPaint, PaintTruth
from finray_calib.reports._plain_text import filter_label, interval_words
from finray_calib.reports._style import (
    BLUE,
    CHANNELS,
    GREEN,
    HAIRLINE,
    INK,
    MUTED,
    ORANGE,
    SKY,
    VERMILLION,
    ReadableFigure,
    legend_above,
    new_figure,
    readable,
    styled,
    svg_text,
)

Floats = NDArray[np.float64]
PER_THOUSAND = 1e3
SHOWN_NM = (430.0, 760.0)
EXCITATION_SHOWN_NM = (330.0, 650.0)
FEW_DECADES = 2.0
EMISSION_LABEL = "radiance factor per nm\n(10$^{-3}$ nm$^{-1}$)"
_FAMILY_STYLES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (SKY, (0, (1, 1))), (INK, (0, (5, 1, 1, 1, 1, 1))))


def emission_figure(paint: FittedPaint) -> ReadableFigure:
    """Draw the emission of a paint, beside the truth where it is known."""
    return draw_emission(paint.fit, paint.truth)


@styled()
def draw_emission(fit: PaintCalibration, truth: PaintTruth | None = None) -> ReadableFigure:
    """Draw the emission with its 68 and 95 % bands, the paper's curve, the truth, and where the filters look."""
    figure = new_figure(5.4, 3.9)
    axes = figure.subplots()
    x, high95 = fit.wavelength_nm, PER_THOUSAND * fit.emission_high95_per_nm
    low, high = fit.emission_low95_simultaneous_per_nm, fit.emission_high95_simultaneous_per_nm
    if low is not None and high is not None:
        for limit, label in ((low, "95 %, whole curve"), (high, None)):
            axes.plot(x, PER_THOUSAND * limit, color=MUTED, linewidth=0.9, label=label)
        high95 = np.maximum(high95, PER_THOUSAND * high)
    _band(axes, x, fit.emission_low95_per_nm, fit.emission_high95_per_nm, "95 %, pointwise", outlined=True)
    _band(axes, x, fit.emission_low68_per_nm, fit.emission_high68_per_nm, "68 %, pointwise")
    axes.plot(x, PER_THOUSAND * fit.emission_per_nm, color=BLUE, label="fit")
    paper = PER_THOUSAND * fit.family_emission_per_nm[-1]
    axes.plot(x, paper, color=VERMILLION, linestyle="-.", linewidth=1.3, label="the paper's curve")
    top = max(float(high95.max()), float(paper.max()))
    if truth is not None:
        true_x, true = truth.emission.wavelength_nm, PER_THOUSAND * truth.emission.values
        axes.plot(true_x, true, color=INK, linestyle="--", linewidth=1.4, label=_truth_name(truth))
        top = max(top, PER_THOUSAND * float(truth.emission(np.arange(*SHOWN_NM)).max()))
    axes.set(xlim=SHOWN_NM, ylim=(-0.09 * top, 1.08 * top))
    _mark_filters(axes, fit.optics)
    axes.set(xlabel="wavelength (nm)", ylabel=EMISSION_LABEL)
    legend_above(figure, axes, 3)
    return readable(figure, axes, emission_readings(fit, truth))


def emission_readings(fit: PaintCalibration, truth: PaintTruth | None = None) -> dict[float, str]:
    """Return the emission in words by wavelength (nm), in the unit of the figure: 1/1000 per nm."""
    curves = (fit.emission_per_nm, fit.emission_low95_per_nm, fit.emission_high95_per_nm)
    shown = np.flatnonzero((fit.wavelength_nm >= SHOWN_NM[0]) & (fit.wavelength_nm <= SHOWN_NM[1]))
    known = [""] * shown.size
    if truth is not None:
        known = [
            f"; {_truth_name(truth)} {PER_THOUSAND * value:.3f}" for value in truth.emission(fit.wavelength_nm[shown])
        ]
    return {
        float(fit.wavelength_nm[k]): f"{fit.wavelength_nm[k]:g} nm: "
        f"{interval_words(*(PER_THOUSAND * curve[k] for curve in curves))} x 10^-3 per nm (95 %, each wavelength){true}"
        for k, true in zip(shown, known, strict=True)
    }


def _truth_name(truth: PaintTruth) -> str:
    """Return how the known spectrum of a paint is called."""
    return "measured" if truth.is_measured else "truth"


_BUDGET_COLOURS = (BLUE, ORANGE, GREEN, VERMILLION, SKY, INK, "#cc79a7", "#f0e442", "#999999", "#661100")
_BUDGET_HATCHES = ("", "//", "..", "xx")


@styled()
def budget_figure(rows: Sequence[BudgetRow], least_share: float, height_in: float = 4.6) -> str:
    """Draw the budget of a paint as one bar of 100 % for each quantity.

    Parameters
    ----------
    rows
        Of the budget.
    least_share
        A source stands by itself where it makes so much of any variance.
    height_in
        Of the figure.
    """
    figure = new_figure(5.0, height_in)
    axes = figure.subplots()
    _draw_budget(axes, rows, least_share)
    bars, sources = axes.get_legend_handles_labels()
    names = [textwrap.fill(source, 32) for source in sources]
    figure.legend(bars, names, loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    return svg_text(figure)


def _draw_budget(axes: Axes, rows: Sequence[BudgetRow], least_share: float) -> None:
    """Draw a bar of 100 % for each quantity, its parts the shares of the sources."""
    sources = joined_budget(rows, least_share)
    names = [name for name in BUDGET_NAMES if any(row.quantity == name for row in rows)]
    left, place = np.zeros(len(names)), np.arange(len(names))[::-1]
    for number, (source, (_, shares)) in enumerate(sources.items()):
        width = np.array([100 * shares.get(name, 0.0) for name in names])
        axes.barh(
            place, width, left=left, height=0.7, color=_BUDGET_COLOURS[number % len(_BUDGET_COLOURS)], label=source,
            hatch=_BUDGET_HATCHES[number // len(_BUDGET_COLOURS)], edgecolor="white", linewidth=0.6,
        )  # fmt: skip
        left = left + width
    axes.set_yticks(place, [BUDGET_NAMES[name] for name in names], fontsize=8)
    axes.set(xlim=(0, 100))
    axes.tick_params(labelsize=8)
    axes.set_xlabel("share of the variance (%)", fontsize=8)


def _band(axes: Axes, x: Floats, low: Floats, high: Floats, label: str, *, outlined: bool = False) -> None:
    """Fill between two curves; the outlined one is the wider of two."""
    look = {"facecolor": SKY, "edgecolor": BLUE, "linestyle": ":"} if outlined else {"facecolor": BLUE, "linewidth": 0}
    axes.fill_between(x, PER_THOUSAND * low, PER_THOUSAND * high, alpha=0.35, label=label, **look)


def _mark_filters(axes: Axes, optics: Optics) -> None:
    """Mark the pass bands of the filters along the lower edge."""
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    shown = [band for band in optics.filters if SHOWN_NM[0] < band.center_nm < SHOWN_NM[1]]
    for number, band in enumerate(shown):
        axes.axvspan(
            band.center_nm - band.fwhm_nm / 2,
            band.center_nm + band.fwhm_nm / 2,
            ymax=0.06,
            facecolor=HAIRLINE,
            edgecolor=MUTED,
            linewidth=0.6,
            hatch="////",
            label=None if number else "filters",
        )


@styled()
def families_figure(paint: FittedPaint) -> str:
    """Draw the mean emission by every family of curves, and by the paper's curve without discrepancy."""
    fit = paint.fit
    figure = new_figure(5.4, 3.7)
    axes = figure.subplots()
    names = [*(family.title for family in paint.competing), "the paper's curve alone"]
    for curve, name, (colour, line) in zip(fit.family_emission_per_nm, names, cycle(_FAMILY_STYLES), strict=False):
        axes.plot(fit.wavelength_nm, PER_THOUSAND * curve, color=colour, linestyle=line, linewidth=1.5, label=name)
    axes.set(xlim=SHOWN_NM, ylim=(0, None), xlabel="wavelength (nm)", ylabel=EMISSION_LABEL)
    legend_above(figure, axes, 2)
    return svg_text(figure)


@styled()
def absorption_figure(paint: FittedPaint) -> ReadableFigure:
    """Draw the absorption relative to the laser line with its 95 % band, and which lights were measured."""
    absorption = paint.fit.reradiation
    figure = new_figure(5.4, 3.5)
    axes = figure.subplots()
    x, low, high = absorption.excitation_nm, absorption.low95, absorption.high95
    band = "95 % band, from the prior" if absorption.prior_driven else "95 % band"
    hatch = "///" if absorption.prior_driven else None
    axes.fill_between(x, low, high, facecolor=SKY, edgecolor=BLUE, hatch=hatch, alpha=0.35, label=band)
    axes.plot(x, absorption.absorption_rel, color=BLUE, label="mean")
    for nm in sorted({absorption.laser_nm, *absorption.measured_at_nm}):
        label = "measured light" if nm == absorption.laser_nm else None
        axes.axvline(nm, color=INK, linestyle="--", linewidth=1.2, label=label)
    axes.set(xlim=EXCITATION_SHOWN_NM, ylim=(0, 1.08 * float(high.max())), xlabel="excitation wavelength (nm)")
    axes.set_ylabel(f"absorbed, relative to\n{absorption.laser_nm:g} nm (1)")
    legend_above(figure, axes, 3)
    source = "95 %, from the prior" if absorption.prior_driven else "95 %"
    texts = {
        float(nm): f"{nm:g} nm: {interval_words(*values)} of the absorption at {absorption.laser_nm:g} nm ({source})"
        for nm, *values in zip(x, absorption.absorption_rel, low, high, strict=True)
    }
    return readable(figure, axes, texts)


@styled()
def marginals_figure(paint: FittedPaint) -> str:
    """Draw prior and posterior of every sampled parameter, each scaled to its own peak."""
    fit = paint.fit
    rows = -(-len(fit.sampled) // 2)
    figure = new_figure(5.4, 1.55 * rows + 0.4)
    panels = figure.subplots(rows, 2, squeeze=False).ravel()
    for column, name in enumerate(fit.sampled):
        logarithmic = name.startswith("ln_")
        _marginal(panels[column], fit.prior_draws[:, column], fit.draws[:, column], logarithmic)
        panels[column].set_xlabel(_axis_label(name))
    for spare in panels[len(fit.sampled) :]:
        spare.set_axis_off()
    legend_above(figure, panels[0], 3)
    return svg_text(figure)


def _axis_label(name: str) -> str:
    """Return what a parameter is, with its unit."""
    unit = next((u for ending, u in (("_per_nm", "1/nm"), ("_nm", "nm")) if name.endswith(ending)), "1")
    return f"{parameter_words(name).removesuffix(', logarithm')} ({unit})"


def _marginal(axes: Axes, prior: Floats, posterior: Floats, logarithmic: bool) -> None:
    """Draw one panel; logarithms are shown as the quantity itself on a logarithmic axis."""
    densities, edges = zip(*(np.histogram(draws, bins=30) for draws in (prior, posterior)), strict=True)
    before, after = (density / density.max() for density in densities)
    x_before, x_after = (np.exp(edge) if logarithmic else edge for edge in edges)
    axes.stairs(before, x_before, fill=True, facecolor="none", edgecolor=MUTED, hatch="////", lw=0.8, label="prior")
    # A posterior much narrower than the prior is still seen by its edge.
    axes.stairs(after, x_after, fill=True, facecolor=SKY, edgecolor=BLUE, lw=1.6, label="posterior")
    if logarithmic:
        few_decades = float(np.ptp(np.log10(x_before))) < FEW_DECADES
        axes.set_xscale("log")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few_decades else (1.0,), numticks=5))
        if few_decades:
            axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.set(yticks=[], ylim=(0, 1.08))
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False)


DECADES_SHOWN = 4.0
SMALLEST_REACH_SD = 3.5
_SIDE_BY_SIDE = (-0.22, 0.0, 0.22)


@styled()
def bands_figure(paint: FittedPaint) -> str:
    """Draw measured against predicted band signals, and below the difference in standard deviations.

    The prediction is the family's curve with the spread that discrepancy and imperfections of the rig allow it.
    """
    fit = paint.fit
    poor = [i for i, band in enumerate(fit.bands) if not band.explained]
    return _signals_figure(fit, fit.usable, (fit.predicted, fit.predicted_sd), "predicted", poor)


@styled()
def blank_figure(paint: PaintWithoutEmission) -> str:
    """Draw measured band signals against those of a sample that reflects as much and emits nothing.

    Filters below the laser see no emission; the verdict does not use them.
    """
    optics = paint.optics
    seen = [f.name == optics.excitation_filter or f.center_nm > optics.laser.wavelength_nm for f in optics.filters]
    used = paint.usable & np.array(seen)[:, None]
    return _signals_figure(paint, used, (paint.blank, paint.blank_sd), "expected without emission", [])


def _signals_figure(
    fit: PaintCalibration | PaintWithoutEmission,
    usable: NDArray[np.bool_],
    expected_and_sd: tuple[Floats, Floats],
    label: str,
    poor: list[int],
) -> str:
    """Draw measured against expected band signals, and below the difference in standard deviations of both."""
    expected, expected_sd = expected_and_sd
    figure = new_figure(5.4, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(5, 3))
    top = float(np.nanmax(fit.measured))
    floor = top * 10**-DECADES_SHOWN
    index = np.arange(len(fit.optics.filters), dtype=np.float64)
    total_sd = np.hypot(fit.measured_sd, expected_sd)
    residual = np.asarray((fit.measured - expected) / np.where(total_sd > 0, total_sd, np.inf))
    for channel, (name, marker, colour) in enumerate(CHANNELS):
        used = usable[:, channel]
        x = index + _SIDE_BY_SIDE[channel]
        predicted, spread = expected[:, channel], 2 * expected_sd[:, channel]
        _boxes(upper, x, np.maximum(predicted - spread, floor), np.maximum(predicted + spread, 1.04 * floor))
        measured, double_sd = np.maximum(fit.measured[:, channel], floor), 2 * fit.measured_sd[:, channel]
        error = np.stack([np.minimum(double_sd, 0.999 * measured), double_sd])
        upper.errorbar(
            x[used], measured[used], error[:, used], fmt=marker, color=colour, markersize=5, linewidth=1, label=name
        )
        upper.plot(x[~used], measured[~used], marker, markersize=5, markerfacecolor="white", markeredgecolor=MUTED)
        lower.plot(x[used], residual[used, channel], marker, color=colour, markersize=5)
    upper.set(yscale="log", ylim=(0.7 * floor, 2.5 * top), ylabel="signal relative\nto white (1)")
    upper.yaxis.set_major_locator(LogLocator(numticks=6))
    upper.yaxis.set_minor_locator(NullLocator())
    upper.grid(visible=False, axis="x")
    upper.bar(0, 0, color=HAIRLINE, edgecolor=MUTED, label=label)
    lower.axhspan(-2, 2, facecolor=HAIRLINE, alpha=0.5, linewidth=0)
    lower.axhline(0, color=MUTED, linewidth=0.8)
    reach = max(SMALLEST_REACH_SD, 1.15 * float(np.abs(residual[usable]).max(initial=0.0)))
    lower.set(ylim=(-reach, reach), ylabel="difference (sd)", xlabel="filter centre (nm)")
    _mark_unexplained(upper, lower, poor)
    legend_above(figure, upper, 5)
    lower.set_xticks(index, [filter_label(band.name, band.center_nm) for band in fit.optics.filters])
    lower.grid(visible=False, axis="x")
    return svg_text(figure)


def _boxes(axes: Axes, x: Floats, low: Floats, high: Floats) -> None:
    """Draw the predictive range of each value as a pale box behind its marker."""
    axes.bar(x, high - low, 0.2, bottom=low, color=HAIRLINE, edgecolor=MUTED, linewidth=0.6, zorder=1.5)


def _mark_unexplained(upper: Axes, lower: Axes, poor: list[int]) -> None:
    """Hatch the filters that the fit does not explain, in both panels."""
    for number, i in enumerate(poor):
        for axes in (upper, lower):
            axes.axvspan(
                i - 0.45,
                i + 0.45,
                facecolor="none",
                edgecolor=VERMILLION,
                hatch="///",
                alpha=0.5,
                zorder=0.5,
                label="not explained" if number == 0 else None,
            )


@styled()
def reflectance_figure(paint: FittedPaint) -> str:
    """Draw the total radiance factor under the lamp, and what remains of it without fluorescence."""
    bands, fit = paint.bands, paint.fit
    centers_nm = np.array([band.center_nm for band in bands.optics.filters])
    figure = new_figure(5.4, 3.4)
    axes = figure.subplots()
    usable = bands.usable()
    for channel, (name, marker, colour) in enumerate(CHANNELS):
        used = usable[:, channel]
        x = centers_nm[used] + 12 * _SIDE_BY_SIDE[channel]
        axes.plot(x, bands.reflectance[used, channel], marker, color=colour, markersize=5, alpha=0.85, label=name)
    estimate = np.array([r.estimate for r in fit.reflectance])
    error = np.array(
        [[r.estimate - r.low95 for r in fit.reflectance], [r.high95 - r.estimate for r in fit.reflectance]]
    )
    axes.errorbar(
        centers_nm,
        estimate,
        np.maximum(error, 0.0),
        color=INK,
        linestyle="-.",
        marker="_",
        markersize=12,
        linewidth=1.2,
        label="without fluorescence",
    )
    axes.set(xlabel="filter centre (nm)", ylabel="reflectance (1)", ylim=(0, None))
    axes.xaxis.set_major_locator(FixedLocator(list(centers_nm)))
    axes.tick_params(axis="x", labelrotation=45)
    legend_above(figure, axes, 4)
    return svg_text(figure)


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
        "Noisy pixels are pulled towards the fit of the region. Chi-square per band up to about 1 means that the curve "
        "explains the pixel; bright patches are dirt, glare or bare ground.",
    ]
    if fitted.worst_spots:
        parts.append(f"Numbers: the blocks that differ most. {spots_note(fitted)}")
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
        return f"{name}: median {middle}; the pixels are too noisy to show how uniform the paint is"
    if not spread.resolved:
        return f"{name}: median {middle}; no differences between single pixels beyond their noise (below {limit})"
    return f"{name}: median {middle}; the paint differs by {sd} (1 sd) between pixels, noise subtracted"


def spots_note(fitted: PaintMap) -> str:
    """Say what a block shows that single pixels do not, and what else than paint it may be."""
    return (
        f"Medians of {fitted.block_px} x {fitted.block_px} px show differences that the noise of single pixels hides. "
        "The texture of the white tile counts as the paint's; another session with the tile shifted separates the two."
    )


def spot_sentence(spot: PaintSpot) -> str:
    """Say where the yield departs and by how much."""
    return (
        f"around row {spot.row_px}, column {spot.column_px}: yield {100 * spot.deviation_rel:+.1f} % "
        f"(+-{100 * spot.deviation_sd_rel:.1f} %), mode {spot.mode_shift_nm:+.1f} nm"
    )
