"""The sweep's other objectives over the light angle, beside the decided angle and the angles that do not work."""

from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
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

_LOOKS: tuple[tuple[str, str, str], ...] = (
    (VERMILLION, "--", "^"),
    (GREEN, "-.", "s"),
    (ORANGE, ":", "D"),
    (SKY, "-", "v"),
)


@styled()
def other_objectives_figure(decision: LightAngleDecision, sweep: LightAngleSweep) -> str:
    """Draw every objective relative to its best rendered angle: 1 is best for each of them."""
    figure = new_figure(5.8, 4.1)
    axes = figure.subplots()
    lines = [("decided on", (BLUE, "-", "o"), sweep.values)]
    lines += [(o.name, look, o.utility) for o, look in zip(sweep.other_objectives, cycle(_LOOKS), strict=False)]
    for name, (colour, style, marker), utility in lines:
        mean = utility.mean(axis=1)
        axes.plot(
            sweep.angles_deg,
            mean / mean.max(),
            color=colour,
            linestyle=style,
            marker=marker,
            markersize=4.5,
            linewidth=1.5,
            label=name.replace("$", r"\$"),
        )
    if sweep.constraints is not None and not sweep.constraints.allowed.all():
        _mark_forbidden(axes, sweep.angles_deg, ~sweep.constraints.allowed)
    chosen = f"chosen: {decision.angle_deg:.0f} deg"
    axes.axvline(decision.angle_deg, color=MUTED, linewidth=1.6, linestyle="-.", label=chosen)
    axes.set(xlabel="angle of the blue light (deg)", ylabel="relative to its best (1)")
    legend_above(figure, axes, 2)
    return svg_text(figure)


def _mark_forbidden(axes: Axes, angles_deg: NDArray[np.float64], forbidden: NDArray[np.bool_]) -> None:
    """Cross out the rendered angles that clip or where the panel does not fit, half a step to both sides."""
    edges = np.concatenate([angles_deg[:1], (angles_deg[1:] + angles_deg[:-1]) / 2, angles_deg[-1:]])
    for number, index in enumerate(np.flatnonzero(forbidden)):
        label = "not possible" if number == 0 else None
        span = edges[index], edges[index + 1]
        axes.axvspan(*span, facecolor="none", edgecolor=INK, hatch="xxx", linewidth=0.0, alpha=0.4, label=label)
