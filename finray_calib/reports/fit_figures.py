"""Figures of one fitted paint: emission, bands, prior and posterior, reflectance. Each returns SVG text."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from data_schemas.radiometry import Optics
from finray_calib.reports.demo_results import PaintResult
from finray_calib.reports.style import (
    BLUE,
    CHANNELS,
    HAIRLINE,
    INK,
    MUTED,
    SKY,
    legend_above,
    new_figure,
    styled,
    svg_text,
)

Floats = NDArray[np.float64]
PER_THOUSAND = 1e3
SHOWN_NM = (430.0, 760.0)
DECADES_SHOWN = 4.0
FEW_DECADES = 2.0
_SIDE_BY_SIDE = (-0.22, 0.0, 0.22)

_PARAMETER_LABELS = {
    "mode_nm": "mode (nm)",
    "ln_fwhm_nm": "FWHM (nm)",
    "kappa": "asinh(skewness) (1)",
    "ln_peak_per_nm": "peak (1/nm)",
    "ln_reflected_laser": "reflectance at laser (1)",
    "ln_blocking": "filter leak multiplier (1)",
}


@styled()
def emission_figure(paint: PaintResult) -> str:
    """Draw the fitted emission with its 68 and 95 % bands, the truth, and where the filters look."""
    fit, truth = paint.calibration, paint.truth
    figure = new_figure(5.4, 3.7)
    axes = figure.subplots()
    x = fit.wavelength_nm
    low95, high95, low68, high68, mean = (
        PER_THOUSAND * curve
        for curve in (
            fit.emission_low95_per_nm,
            fit.emission_high95_per_nm,
            fit.emission_low68_per_nm,
            fit.emission_high68_per_nm,
            fit.emission_per_nm,
        )
    )
    axes.fill_between(x, low95, high95, facecolor=SKY, alpha=0.35, edgecolor=BLUE, linestyle=":", label="95 % band")
    axes.fill_between(x, low68, high68, facecolor=BLUE, alpha=0.35, linewidth=0, label="68 % band")
    axes.plot(x, mean, color=BLUE, label="fit")
    true_x = truth.emission.wavelength_nm
    name = "measured" if truth.is_measured else "truth"
    axes.plot(true_x, PER_THOUSAND * truth.emission.values, color=INK, linestyle="--", linewidth=1.4, label=name)
    top = max(float(high95.max()), PER_THOUSAND * float(truth.emission(np.arange(*SHOWN_NM)).max()))
    axes.set(xlim=SHOWN_NM, ylim=(-0.09 * top, 1.08 * top))
    _mark_filters(axes, fit.optics)
    axes.set(xlabel="wavelength (nm)", ylabel="radiance factor per nm\n(10$^{-3}$ nm$^{-1}$)")
    legend_above(figure, axes, 5)
    return svg_text(figure)


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
def bands_figure(paint: PaintResult) -> str:
    """Draw measured against predicted band signals, and below the difference in standard deviations."""
    fit = paint.calibration
    figure = new_figure(5.4, 4.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(5, 3))
    top = float(np.nanmax(fit.measured))
    floor = top * 10**-DECADES_SHOWN
    index = np.arange(len(fit.optics.filters), dtype=np.float64)
    total_sd = np.hypot(fit.measured_sd, fit.predicted_sd)
    residual = (fit.measured - fit.predicted) / np.where(total_sd > 0, total_sd, np.inf)
    for channel, (name, marker, colour) in enumerate(CHANNELS):
        used = fit.usable[:, channel]
        x = index + _SIDE_BY_SIDE[channel]
        predicted, spread = fit.predicted[:, channel], 2 * fit.predicted_sd[:, channel]
        _boxes(upper, x, np.maximum(predicted - spread, floor), np.maximum(predicted + spread, 1.04 * floor))
        measured = np.maximum(fit.measured[:, channel], floor)
        error = np.stack(
            [np.minimum(2 * fit.measured_sd[:, channel], 0.999 * measured), 2 * fit.measured_sd[:, channel]]
        )
        upper.errorbar(
            x[used], measured[used], error[:, used], fmt=marker, color=colour, markersize=5, linewidth=1, label=name
        )
        upper.plot(x[~used], measured[~used], marker, markersize=5, markerfacecolor="white", markeredgecolor=MUTED)
        lower.plot(x[used], residual[used, channel], marker, color=colour, markersize=5)
    upper.set(yscale="log", ylim=(0.7 * floor, 2.5 * top), ylabel="signal relative\nto white (1)")
    upper.yaxis.set_major_locator(LogLocator(numticks=6))
    upper.yaxis.set_minor_locator(NullLocator())
    upper.grid(visible=False, axis="x")
    upper.bar(0, 0, color=HAIRLINE, edgecolor=MUTED, label="predicted")
    legend_above(figure, upper, 4)
    lower.axhspan(-2, 2, facecolor=HAIRLINE, alpha=0.5, linewidth=0)
    lower.axhline(0, color=MUTED, linewidth=0.8)
    reach = max(3.5, 1.15 * float(np.abs(residual[fit.usable]).max(initial=0.0)))
    lower.set(ylim=(-reach, reach), ylabel="difference (sd)", xlabel="filter centre (nm)")
    lower.set_xticks(index, [f"{band.center_nm:g}" for band in fit.optics.filters])
    lower.grid(visible=False, axis="x")
    return svg_text(figure)


def _boxes(axes: Axes, x: Floats, low: Floats, high: Floats) -> None:
    """Draw the predictive range of each value as a pale box behind its marker."""
    axes.bar(x, high - low, 0.2, bottom=low, color=HAIRLINE, edgecolor=MUTED, linewidth=0.6, zorder=1.5)


@styled()
def marginals_figure(paint: PaintResult) -> str:
    """Draw prior and posterior of every sampled parameter, each scaled to its own peak."""
    fit = paint.calibration
    rows = -(-len(fit.sampled) // 2)
    figure = new_figure(5.4, 1.55 * rows + 0.4)
    panels = figure.subplots(rows, 2, squeeze=False).ravel()
    known = {"mode_nm": paint.truth.mode_nm, "ln_fwhm_nm": float(np.log(paint.truth.fwhm_nm))}
    for column, name in enumerate(fit.sampled):
        logarithmic = name.startswith("ln_")
        _marginal(panels[column], fit.prior_draws[:, column], fit.draws[:, column], known.get(name), logarithmic)
        panels[column].set_xlabel(_PARAMETER_LABELS.get(name, name.removeprefix("ln_")))
    for spare in panels[len(fit.sampled) :]:
        spare.set_axis_off()
    legend_above(figure, panels[0], 3)
    return svg_text(figure)


def _marginal(axes: Axes, prior: Floats, posterior: Floats, truth: float | None, logarithmic: bool) -> None:
    """Draw one panel; logarithms are shown as the quantity itself on a logarithmic axis."""
    densities, edges = zip(*(np.histogram(draws, bins=30) for draws in (prior, posterior)), strict=True)
    before, after = (density / density.max() for density in densities)
    x_before, x_after = (np.exp(edge) if logarithmic else edge for edge in edges)
    axes.stairs(before, x_before, fill=True, facecolor="none", edgecolor=MUTED, hatch="////", lw=0.8, label="prior")
    # A posterior much narrower than the prior is still seen by its edge.
    axes.stairs(after, x_after, fill=True, facecolor=SKY, edgecolor=BLUE, lw=1.6, label="posterior")
    if truth is not None:
        axes.axvline(np.exp(truth) if logarithmic else truth, color=INK, linestyle="--", linewidth=1.4, label="truth")
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


@styled()
def reflectance_figure(paint: PaintResult) -> str:
    """Draw the total radiance factor under the lamp, and what remains of it without fluorescence."""
    bands, fit = paint.bands, paint.calibration
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
