"""How the light sits beside the pad: the panel at its angle, to scale, with the tolerance as a wedge."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Rectangle, Wedge

from data_schemas.decide import LightAngleDecision
from data_schemas.design import FingerDesign
from finray_calib.reports.style import BLUE, GREEN, INK, MUTED, SKY, new_figure, styled, svg_text

_BEFORE_MM, _AFTER_MM, _MARGIN_MM = 12.0, 34.0, 8.0
_RAY_MM, _ARC_MM = 20.0, 13.0


@styled()
def mounting_figure(decision: LightAngleDecision, design: FingerDesign) -> str:
    """Draw pad and panel from the side: along the pad to the right, into the pad upwards; lengths are to scale."""
    along, into = design.light.position_mm[2], design.light.position_mm[1]
    right = max(design.pad.length_mm, along) if design.pad.length_mm < _AFTER_MM else along + _AFTER_MM
    low, high = into - _MARGIN_MM, max(design.pad.thickness_mm, into + _RAY_MM) + _MARGIN_MM / 2
    left = along - (_BEFORE_MM if decision.angle_deg <= 90 else _RAY_MM + _MARGIN_MM)
    figure = new_figure(5.6, 5.6 * (high - low) / (right - left) + 0.2)
    axes = figure.subplots()
    axes.add_patch(
        Rectangle((0.0, 0.0), design.pad.length_mm, design.pad.thickness_mm, facecolor=SKY, alpha=0.3, edgecolor=MUTED)
    )
    axes.text(right - 3.0, design.pad.thickness_mm / 2, "pad", ha="right", va="center")
    axes.plot([along, right], [into, into], color=MUTED, linewidth=0.9, linestyle="--")
    axes.text(right, into - 0.6, "0 deg, along the pad", ha="right", va="top", fontsize=9, color=MUTED)
    axes.plot([along, along], [into, into + _RAY_MM], color=MUTED, linewidth=0.9, linestyle="--")
    axes.text(along - 0.8, into + _RAY_MM, "90 deg,\ninto the pad", ha="right", va="top", fontsize=9, color=MUTED)
    for start, end in decision.statement.equivalent_deg:
        axes.add_patch(
            Wedge((along, into), _RAY_MM, start, end, facecolor="none", edgecolor=GREEN, hatch="///", linewidth=0.8)
        )
    _panel(axes, (along, into), decision.angle_deg, design.light.height_mm)
    axes.set(xlim=(left, right), ylim=(low, high), aspect="equal")
    axes.set_axis_off()
    return svg_text(figure)


def _panel(axes: Axes, place_mm: tuple[float, float], angle_deg: float, height_mm: float) -> None:
    """Draw the panel from the side, its normal and the angle between normal and pad."""
    angle = np.radians(angle_deg)
    normal, edge = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)]) * height_mm / 2
    centre = np.array(place_mm)
    ends = np.stack([centre - edge, centre + edge])
    axes.plot(*ends.T, color=BLUE, linewidth=5.0, solid_capstyle="butt")
    axes.text(centre[0] - 1.5, centre[1] - 2.2, "light", ha="right", va="top", color=INK)
    tip = centre + _RAY_MM * normal
    axes.annotate(
        "", (tip[0], tip[1]), place_mm, arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1.8, "shrinkA": 0}
    )
    axes.add_patch(Arc(place_mm, 2 * _ARC_MM, 2 * _ARC_MM, theta1=0.0, theta2=angle_deg, color=INK, linewidth=1.2))
    middle = np.radians(angle_deg / 2)
    write = centre + (_ARC_MM + 1.0) * np.array([np.cos(middle), np.sin(middle)])
    axes.text(
        write[0], write[1], f"{angle_deg:.0f} deg", va="center", weight="bold", color=INK, backgroundcolor="white"
    )
