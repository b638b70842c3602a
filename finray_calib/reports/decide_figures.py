"""The objective over the light angle: curve, bands, renders, decision and the angles that do as well."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from data_schemas.decide import LightAngleDecision
from data_schemas.simulate import LightAngleSweep
from finray_calib.reports.style import (
    BLUE,
    GREEN,
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


def on_curve_scale(sweep: LightAngleSweep, decision: LightAngleDecision) -> Floats:
    """Return the (angle, repeat) values of a sweep on the scale of the curve of the renders alone.

    Each repeat is divided by its mean over the angles (a common scale cannot change the ranking) and multiplied
    by the mean of the curve over the same angles.
    """
    curve = np.interp(sweep.angles_deg, decision.grid_deg, decision.mean_simulation_only)
    return np.asarray(sweep.values / sweep.values.mean(axis=0) * curve.mean())


@styled()
def angle_figure(decision: LightAngleDecision, sweep: LightAngleSweep, true_sweep: LightAngleSweep | None) -> str:
    """Draw the objective relative to the best of the mean curve, over the angle of the light.

    The curve of the real finger with its band, the one of the renders alone (dashed where captures moved the former),
    and captures as points with their standard uncertainties, doubled.
    """
    figure = new_figure(5.8, 4.1)
    axes = figure.subplots()
    grid, best = decision.grid_deg, float(decision.mean.max())
    if decision.discrepancy_rel is not None:
        axes.fill_between(
            grid,
            decision.low95 / best,
            decision.high95 / best,
            facecolor=SKY,
            alpha=0.28,
            edgecolor=BLUE,
            linestyle=":",
            label="95 % with captures" if decision.validated else "95 % with the assumed error",
        )
    low, high = decision.low95_simulation_only / best, decision.high95_simulation_only / best
    axes.fill_between(grid, low, high, facecolor=BLUE, alpha=0.35, linewidth=0, label="95 % of the renders alone")
    if decision.validated:
        axes.plot(grid, decision.mean / best, color=BLUE, label="mean with captures")
    style, name = ("--", "mean of the renders") if decision.validated else ("-", "mean curve")
    axes.plot(grid, decision.mean_simulation_only / best, color=BLUE, linestyle=style, linewidth=1.2, label=name)
    values = on_curve_scale(sweep, decision) / best
    for repeat in range(values.shape[1]):
        label = "renders" if repeat == 0 else None
        axes.plot(sweep.angles_deg, values[:, repeat], "o", color=INK, markersize=3.2, alpha=0.7, label=label)
    if true_sweep is not None:
        truth = on_curve_scale(true_sweep, decision).mean(axis=1) / best
        axes.plot(true_sweep.angles_deg, truth, "--D", color=VERMILLION, linewidth=1.3, markersize=3.5, label="truth")
    _mark_captures(axes, decision, best)
    _mark_decision(axes, decision)
    axes.set(xlabel="angle of the blue light (deg)", ylabel="objective relative to its best (1)")
    axes.set_xlim(float(grid[0]), float(grid[-1]))
    axes.xaxis.set_major_locator(MultipleLocator(10 if np.ptp(grid) <= 130 else 30))
    legend_above(figure, axes, 3)
    return svg_text(figure)


def _mark_captures(axes: Axes, decision: LightAngleDecision, best: float) -> None:
    """Draw captures with twice the standard uncertainties of value and angle."""
    if not decision.captures:
        return
    axes.errorbar(
        [capture.light_angle_deg for capture in decision.captures],
        [capture.value / best for capture in decision.captures],
        xerr=[2 * capture.light_angle_uncertainty_deg for capture in decision.captures],
        yerr=[2 * capture.sd / best for capture in decision.captures],
        fmt="s",
        color=ORANGE,
        markeredgecolor=INK,
        ecolor=INK,
        markersize=6.5,
        linewidth=1.4,
        label="captures",
    )


def _mark_decision(axes: Axes, decision: LightAngleDecision) -> None:
    """Hatch the equivalent angles and mark the decided one."""
    for number, (low, high) in enumerate(decision.statement.equivalent_deg):
        label = "equivalent angles" if number == 0 else None
        # A single angle would have no width to be seen.
        margin = 0.5 if high - low < 1 else 0.0
        axes.axvspan(
            low - margin, high + margin, facecolor="none", edgecolor=GREEN, hatch="///", linewidth=0.8, label=label
        )
    axes.axvline(
        decision.angle_deg, color=MUTED, linewidth=1.6, linestyle="-.", label=f"chosen: {decision.angle_deg:.0f} deg"
    )
