"""Measured and simulated force over the push, with the simulation's band, and the error under it."""

import numpy as np

from data_schemas.force_comparison import ForceComparison
from finray_calib.reports.style import BLUE, INK, MUTED, VERMILLION, legend_above, new_figure, png_bytes, styled


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
    # withheld ends are no numbers
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
