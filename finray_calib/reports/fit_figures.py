"""Figures of one fitted paint over the wavelength, and of its parameters. Each returns SVG text."""

from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from data_schemas.radiometry import Optics
from finray_calib.reports.fit_tables import parameter_words
from finray_calib.reports.fitted_paint import FittedPaint
from finray_calib.reports.style import (
    BLUE,
    GREEN,
    HAIRLINE,
    INK,
    MUTED,
    ORANGE,
    SKY,
    VERMILLION,
    legend_above,
    new_figure,
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


@styled()
def emission_figure(paint: FittedPaint) -> str:
    """Draw the emission with its 68 and 95 % bands, the paper's curve, the truth, and where the filters look."""
    fit, truth = paint.fit, paint.truth
    figure = new_figure(5.4, 3.9)
    axes = figure.subplots()
    x, high95 = fit.wavelength_nm, PER_THOUSAND * fit.emission_high95_per_nm
    _band(axes, x, fit.emission_low95_per_nm, fit.emission_high95_per_nm, "95 % band", outlined=True)
    _band(axes, x, fit.emission_low68_per_nm, fit.emission_high68_per_nm, "68 % band")
    axes.plot(x, PER_THOUSAND * fit.emission_per_nm, color=BLUE, label="fit")
    paper = PER_THOUSAND * paint.paper_emission_per_nm
    axes.plot(x, paper, color=VERMILLION, linestyle="-.", linewidth=1.3, label="the paper's curve")
    top = max(float(high95.max()), float(paper.max()))
    if truth is not None:
        true_x, true = truth.emission.wavelength_nm, PER_THOUSAND * truth.emission.values
        name = "measured" if truth.is_measured else "truth"
        axes.plot(true_x, true, color=INK, linestyle="--", linewidth=1.4, label=name)
        top = max(top, PER_THOUSAND * float(truth.emission(np.arange(*SHOWN_NM)).max()))
    axes.set(xlim=SHOWN_NM, ylim=(-0.09 * top, 1.08 * top))
    _mark_filters(axes, fit.optics)
    axes.set(xlabel="wavelength (nm)", ylabel=EMISSION_LABEL)
    legend_above(figure, axes, 3)
    return svg_text(figure)


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
def absorption_figure(paint: FittedPaint) -> str:
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
    return svg_text(figure)


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
