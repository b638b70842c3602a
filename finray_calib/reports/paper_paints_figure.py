"""The paper's model of its paints beside ours, on measured stand-ins: one row of two panels for each material."""

from collections.abc import Sequence

from matplotlib.axes import Axes

from data_schemas.paper_paints import BandFit, PaintStandIn, PaperPaints
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
    png_bytes,
    styled,
)

PERCENT = 100.0
BAND_NM = 10.0
EMISSION_SHOWN_NM = (460.0, 740.0)
ABSORPTION_SHOWN_NM = (340.0, 780.0)
PRINTED_BAND_PERCENT = (2.0, 5.0)
RESOLUTION_DPI = 110
ABSORPTION_HEADROOM = 1.75
SHIFT_HEIGHT = 0.77
LINE_HEIGHT = 0.07
_TITLES = (
    "What it emits under a {laser:.0f} nm laser",
    "What it absorbs (photons), relative to {laser:.0f} nm",
)
_WHY = (
    "Why they differ: eight bands do not hold an emission between and beyond them. The paper's curve is taken for "
    "exact, and its 95 % band is far too\nnarrow; ours lets the paint leave its curve and says by how much. 2 to 5 % "
    "is one 10 nm band, not all emitted light. Absorption is a plateau: where its\nmaximum lies, and with it the "
    "Stokes shift, is ill-defined, and one laser does not measure it (grey). Stand-ins, not the paper's own paints."
)


@styled()
def paper_paints_png(study: PaperPaints) -> bytes:
    """Draw emission (left) and absorption (right) of every stand-in and return the bytes of a PNG image.

    Equal records give equal bytes: the image holds no date and no version.
    """
    figure = new_figure(11.5, 3.3 * len(study.stand_ins) + 1.9)
    panels = figure.subplots(len(study.stand_ins), 2, squeeze=False)
    for (left, right), paint in zip(panels, study.stand_ins, strict=True):
        _emission_panel(left, paint)
        _absorption_panel(right, paint, study.laser_nm)
        name = paint.material.replace("_", " ")
        left.set_ylabel(f"{name}\n(stands for the {paint.colour} paint)\n\nradiance factor per 10 nm (%)")
        right.set_ylabel("absorption (1 at the laser)")
    for axes, title in zip(panels[0], _TITLES, strict=True):
        axes.set_title(title.format(laser=study.laser_nm), loc="left", fontweight="bold")
    for axes in panels[-1]:
        axes.set_xlabel("wavelength (nm)")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    figure.legend(*panels[0, 1].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    figure.supxlabel(_WHY, x=0.01, ha="left", fontsize=9)
    return png_bytes(figure, RESOLUTION_DPI)


def _emission_panel(axes: Axes, paint: PaintStandIn) -> None:
    """Draw the measured emission, what the eight filters see of it, and both fits to those bands."""
    low, high = PRINTED_BAND_PERCENT
    axes.axhspan(low, high, facecolor=ORANGE, alpha=0.25, linewidth=0, label="paper: reradiation 2 to 5 %")
    per_band = PERCENT * BAND_NM
    measured = paint.emission
    axes.plot(measured.wavelength_nm, per_band * measured.values, "o", color=INK, markersize=3.5, label="measured")
    axes.plot(
        [float(nm) for nm in paint.filter_bands],
        [PERCENT * value for value in paint.filter_bands.values()],
        "s",
        markersize=9,
        markerfacecolor="none",
        markeredgecolor=INK,
        label="what the filters see",
    )
    _posterior(axes, paint.paper_fit, VERMILLION, "--", "paper's curve from the filters, 95 %")
    _posterior(axes, paint.our_fit, BLUE, "-", "ours from the filters, 95 %")
    highest = max(measured.values.max(), paint.paper_fit.mean_per_nm.max(), paint.our_fit.high95_per_nm.max())
    axes.set(xlim=EMISSION_SHOWN_NM, ylim=(0, 1.35 * max(per_band * float(highest), high)))
    _mark_location(axes, paint.paper_fit)
    lines = (
        (VERMILLION, f"paper: {_judged(paint.paper_fit)}"),
        (BLUE, f"ours: {_judged(paint.our_fit)}"),
        (INK, f"all emitted light: {PERCENT * paint.energy_yield:.0f} % of the energy"),
    )
    _write(axes, lines)


def _posterior(axes: Axes, fit: BandFit, colour: str, dashes: str, label: str) -> None:
    """Draw the mean and the 95 % band of a fit to the filter bands."""
    scale = PERCENT * BAND_NM
    axes.fill_between(
        fit.wavelength_nm, scale * fit.low95_per_nm, scale * fit.high95_per_nm, color=colour, alpha=0.25, linewidth=0
    )
    axes.plot(fit.wavelength_nm, scale * fit.mean_per_nm, dashes, color=colour, label=label)


def _judged(fit: BandFit) -> str:
    """Say how far a fit is off and whether it knows."""
    error, held = PERCENT * fit.residual_rel, PERCENT * fit.covered_share
    return f"{error:.0f} % off, its 95 % band holds {held:.0f} % of the measured"


def _write(axes: Axes, lines: Sequence[tuple[str, str]]) -> None:
    """Write lines of (colour, text) into the upper right corner."""
    for row, (colour, text) in enumerate(lines):
        height = 0.97 - LINE_HEIGHT * row
        axes.text(0.98, height, text, transform=axes.transAxes, ha="right", va="top", fontsize=9, color=colour)


def _mark_location(axes: Axes, fit: BandFit) -> None:
    """Mark the paper's lambda_0, which is called the peak, on the wavelength axis."""
    location_nm = fit.parameters["location_nm"].estimate
    axes.plot(
        [location_nm, location_nm],
        [0, 0.12],
        color=VERMILLION,
        linewidth=2.5,
        transform=axes.get_xaxis_transform(),
        label=r"paper's $\lambda_0$, called the peak",
    )


def _absorption_panel(axes: Axes, paint: PaintStandIn, laser_nm: float) -> None:
    """Draw the measured absorption, our bands from one and from several lights, and the paper's maximum."""
    several, one = paint.several_lights, paint.one_laser
    lights = ", ".join(f"{nm:.0f}" for nm in sorted(several.measured_at_nm))
    axes.fill_between(
        one.excitation_nm, one.low95, one.high95, facecolor=HAIRLINE, alpha=0.8, linewidth=0,
        label="ours, 95 %: the laser alone (prior)",
    )  # fmt: skip
    axes.fill_between(
        several.excitation_nm, several.low95, several.high95, facecolor=SKY, alpha=0.5, edgecolor=BLUE,
        linestyle=":", label=f"ours, 95 %: {lights} nm",
    )  # fmt: skip
    measured = paint.absorption
    axes.plot(measured.wavelength_nm, measured.values, "o", color=INK, markersize=3.5, label="measured")
    emission = paint.emission.values / paint.emission.values.max()
    axes.plot(paint.emission.wavelength_nm, emission, ":", color=GREEN, label="its emission, scaled")
    axes.axvline(laser_nm, color=MUTED, linewidth=1.0)
    top = ABSORPTION_HEADROOM * max(1.0, float(measured.values.max()))
    axes.set(xlim=ABSORPTION_SHOWN_NM, ylim=(0, top))
    axes.text(laser_nm - 3, 0.02 * top, "laser", color=MUTED, fontsize=9, ha="right", va="bottom")
    _printed_shift(axes, paint, SHIFT_HEIGHT * top)


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
    axes.axvline(peak_nm - shift_nm, ymax=SHIFT_HEIGHT, color=VERMILLION, linewidth=1.0, linestyle="--")
    low, high = paint.stokes_shift_low_nm, paint.stokes_shift_high_nm
    lines = (
        (VERMILLION, f"paper: Stokes shift {shift_nm:.0f} nm"),
        (INK, f"measured: {paint.stokes_shift_nm:.0f} nm"),
        (INK, f"({low:.0f} to {high:.0f} nm on the plateau)"),
    )
    _write(axes, lines)
