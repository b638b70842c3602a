"""The paper's model of its paints beside ours, on measured stand-ins: one row of two panels for each material."""

import io

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from data_schemas.reradiation import CurveFit, PaintStandIn, PaperPaints
from finray_calib.reports.style import (
    BLUE,
    GREEN,
    HAIRLINE,
    INK,
    MUTED,
    ORANGE,
    SKY,
    VERMILLION,
    new_figure,
    styled,
)

Floats = NDArray[np.float64]
PERCENT = 100.0
BAND_NM = 10.0
EMISSION_SHOWN_NM = (460.0, 740.0)
ABSORPTION_SHOWN_NM = (340.0, 780.0)
PRINTED_BAND_PERCENT = (2.0, 5.0)
RESOLUTION_DPI = 150
_TITLES = (
    "What it emits under a {laser:.0f} nm laser",
    "What it absorbs (photons), compared with {laser:.0f} nm",
)


@styled()
def paper_paints_png(study: PaperPaints) -> bytes:
    """Draw emission (left) and absorption (right) of every stand-in and return the bytes of a PNG image.

    Equal records give equal bytes: the image holds no date and no version.
    """
    figure = new_figure(11.0, 3.1 * len(study.stand_ins) + 1.3)
    panels = figure.subplots(len(study.stand_ins), 2, squeeze=False)
    for (left, right), paint in zip(panels, study.stand_ins, strict=True):
        _emission_panel(left, paint)
        _absorption_panel(right, paint, study.laser_nm)
        name = paint.material.replace("_", " ")
        left.set_ylabel(f"{name}\n(stands for the {paint.colour} paint)\n\nradiance factor per 10 nm (%)")
    for axes, title in zip(panels[0], _TITLES, strict=True):
        axes.set_title(title.format(laser=study.laser_nm), loc="left", fontweight="bold")
    for axes in panels[-1]:
        axes.set_xlabel("wavelength (nm)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2, columnspacing=1.2, handletextpad=0.5)
    handles, labels = panels[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, columnspacing=1.2, handletextpad=0.5)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=RESOLUTION_DPI, metadata={"Software": None})
    return buffer.getvalue()


def _emission_panel(axes: Axes, paint: PaintStandIn) -> None:
    """Draw the measured emission, what the eight filters see of it, and both equations fitted to those bands."""
    low, high = PRINTED_BAND_PERCENT
    axes.axhspan(low, high, facecolor=ORANGE, alpha=0.25, linewidth=0, label="paper: 2 to 5 %")
    per_band = PERCENT * BAND_NM
    measured = paint.emission
    axes.plot(measured.wavelength_nm, per_band * measured.values, "o", color=INK, markersize=3.5, label="measured")
    centers = [float(nm) for nm in paint.filter_bands]
    axes.plot(
        centers,
        [PERCENT * value for value in paint.filter_bands.values()],
        "s",
        markersize=9,
        markerfacecolor="none",
        markeredgecolor=INK,
        label="what the filters see",
    )
    paper, ours = (fit for fit in paint.fits if fit.seen == "filter bands")
    for fit, colour, dashes, whose in (
        (paper, VERMILLION, "--", "the paper's equation"),
        (ours, BLUE, "-", "ours (log-normal)"),
    ):
        label = f"{whose} fitted to the filters"
        axes.plot(fit.curve.wavelength_nm, per_band * fit.curve.values, dashes, color=colour, label=label)
    top = per_band * max(float(measured.values.max()), paper.curve.values.max(), ours.curve.values.max())
    axes.set(xlim=EMISSION_SHOWN_NM, ylim=(0, max(1.3 * top, 1.3 * high)))
    _mark_location(axes, paper)
    text = (
        f"all emitted light: {PERCENT * paint.energy_yield:.0f} % of the energy\n"
        f"error to measured: paper {PERCENT * paper.residual_rel:.0f} %, ours {PERCENT * ours.residual_rel:.0f} %"
    )
    axes.text(0.98, 0.95, text, transform=axes.transAxes, ha="right", va="top", fontsize=9)


def _mark_location(axes: Axes, fit: CurveFit) -> None:
    """Mark the paper's lambda_0, which is called the peak, on the wavelength axis."""
    location_nm = fit.parameters["location_nm"]
    axes.plot(
        [location_nm, location_nm],
        [0, 0.12],
        color=VERMILLION,
        linewidth=2.5,
        transform=axes.get_xaxis_transform(),
        label=r"its $\lambda_0$, called the peak",
    )


def _absorption_panel(axes: Axes, paint: PaintStandIn, laser_nm: float) -> None:
    """Draw the measured absorption, our bands from one and from several lights, and the paper's maximum."""
    several, one = paint.several_lights, paint.one_laser
    lights = ", ".join(f"{nm:.0f}" for nm in sorted(several.measured_at_nm))
    axes.fill_between(
        one.excitation_nm, one.low95, one.high95, facecolor=HAIRLINE, alpha=0.8, linewidth=0,
        label="ours, 95 %: laser only (prior, reflectance)",
    )  # fmt: skip
    axes.fill_between(
        several.excitation_nm, several.low95, several.high95, facecolor=SKY, alpha=0.5, edgecolor=BLUE,
        linestyle=":", label=f"ours, 95 %: lights {lights} nm",
    )  # fmt: skip
    measured = paint.absorption
    axes.plot(measured.wavelength_nm, measured.values, "o", color=INK, markersize=3.5, label="measured")
    emission = paint.emission.values / paint.emission.values.max()
    axes.plot(paint.emission.wavelength_nm, emission, ":", color=GREEN, label="its emission, scaled")
    axes.axvline(laser_nm, color=MUTED, linewidth=1.0)
    top = 1.4 * max(1.0, float(measured.values.max()))
    axes.set(xlim=ABSORPTION_SHOWN_NM, ylim=(0, top))
    axes.text(laser_nm - 3, 0.02 * top, "laser", color=MUTED, fontsize=9, ha="right", va="bottom")
    _printed_shift(axes, paint, 0.87 * top)


def _printed_shift(axes: Axes, paint: PaintStandIn, height: float) -> None:
    """Draw the printed Stokes shift as an arrow from the emission's peak to where the paper puts the absorption's."""
    peak_nm, shift_nm = paint.emission_peak_nm, paint.printed_stokes_shift_nm
    axes.annotate(
        "",
        (peak_nm - shift_nm, height),
        (peak_nm, height),
        arrowprops={"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0},
    )
    axes.plot([], [], color=VERMILLION, label="paper: Stokes shift")
    axes.axvline(peak_nm - shift_nm, ymax=0.69, color=VERMILLION, linewidth=1.0, linestyle="--")
    low, high = paint.stokes_shift_low_nm, paint.stokes_shift_high_nm
    axes.text(
        peak_nm + 6,
        height,
        f"paper {shift_nm:.0f} nm\n"
        f"measured {paint.stokes_shift_nm:.0f} nm ({low:.0f} to {high:.0f} nm\n"
        "are as good on the plateau)",
        va="center",
        fontsize=8.5,
    )
