"""Figures of one paint filter by filter: band signals and reflectance. Each returns SVG text."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator
from numpy.typing import NDArray

from data_schemas.emission_detection import PaintWithoutEmission
from data_schemas.fit import PaintCalibration
from finray_calib.reports.fitted_paint import FittedPaint
from finray_calib.reports.style import (
    CHANNELS,
    HAIRLINE,
    INK,
    MUTED,
    VERMILLION,
    legend_above,
    new_figure,
    styled,
    svg_text,
)

Floats = NDArray[np.float64]
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
    lower.set_xticks(index, [f"{band.center_nm:g}" for band in fit.optics.filters])
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
