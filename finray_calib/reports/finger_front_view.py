"""A finger from its front, with the hollow behind its pad, named parts and sizes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from finray_calib.reports.finger_outline import PART_COLOURS, FingerOutline
from finray_calib.reports.labelled_parts import PartLabel, dimension, label_row
from finray_calib.reports.style import BLUE, GREEN, INK, MUTED, VERMILLION
from sim.optics.finger_view import camera_pose


def draw_front(axes: Axes, finger: FingerOutline) -> None:
    """Draw the finger as seen from the indenter, with the hollow behind the pad dashed."""
    design, layout, pad = finger.design, finger.layout, finger.design.pad
    low, high = finger.bounds_mm
    half, window = layout.half_width_mm, pad.width_mm / 2.0
    _box(axes, (low[2], layout.base_line[0]), half, facecolor=PART_COLOURS["base_plate"], edgecolor=MUTED)
    _box(axes, (layout.base_line[0], high[2]), half, facecolor=PART_COLOURS["skeleton"], edgecolor=MUTED)
    _box(axes, (0.0, pad.length_mm), window, facecolor=PART_COLOURS["gel"], edgecolor=INK)
    for x, colour in ((-window, VERMILLION), (window, GREEN)):
        axes.plot([0.0, pad.length_mm], [x, x], color=colour, lw=3.5, solid_capstyle="butt")
    inner = layout.rib_inner_mm
    ends = layout.base_line[0], layout.tip_line[0]
    _box(axes, ends, inner, fill=False, edgecolor=INK, ls="--", lw=0.9)
    for first, last in layout.ribs[:, :, 0]:
        for x in (-half, inner):
            axes.add_patch(Rectangle((first, x), last - first, half - inner, fill=False, edgecolor=MUTED, hatch="////"))
    for light in design.lights:
        z = light.position_mm[2]
        across = light.position_mm[0] + np.array([-0.5, 0.5]) * light.width_mm
        axes.plot([z, z], across, color=BLUE, lw=4.0, solid_capstyle="butt")
    pose = camera_pose(design).centre_mm
    axes.plot(pose[2], pose[0], marker="s", color=INK, markersize=8)
    _front_touch(axes, finger, window)
    _front_labels(axes, finger)
    inch = finger.inch_mm
    for away, edge, text in ((0.3, half, ""), (0.7, inner, "hollow ")):
        end = float(high[2]) + away * inch
        dimension(axes, (end, -edge), (end, edge), f"{text}{2.0 * edge:.1f}")
    dimension(axes, (0.12 * pad.length_mm, -window), (0.12 * pad.length_mm, window), f"{pad.width_mm:g}")
    axes.set(
        xlabel="z along the finger, from the base of the pad (mm)",
        ylabel="x (mm)",
        title="front view, as a touched object sees the finger; dashed: the hollow behind the pad, hatched: its ribs",
    )


def _front_touch(axes: Axes, finger: FingerOutline, half_mm: float) -> None:
    """Mark where the indenter first touches: a line under a cylinder, a point under anything else."""
    across, at = finger.touch_mm
    x = [-half_mm, half_mm] if finger.design.indenter.shape == "cylinder" else [across]
    axes.plot([at] * len(x), x, color=MUTED, ls="--", marker="x" if len(x) == 1 else "", lw=1.2)


def _touch_x_mm(finger: FingerOutline, half_mm: float) -> float:
    """Return x of the place that the name of the first touch points at."""
    return -0.7 * half_mm if finger.design.indenter.shape == "cylinder" else finger.touch_mm[0]


def _front_labels(axes: Axes, finger: FingerOutline) -> None:
    """Name the parts of the front view."""
    design, layout = finger.design, finger.layout
    half, window, length = layout.half_width_mm, design.pad.width_mm / 2.0, design.pad.length_mm
    pose, light = camera_pose(design).centre_mm, design.light
    rib = (window + half) / 2.0
    above = [
        PartLabel("base plate", (layout.base_line[0] - design.skeleton.base_thickness_mm / 2.0, 0.9 * half)),
        PartLabel("light panel (behind)", (light.position_mm[2], light.position_mm[0] + 0.4 * light.width_mm)),
        PartLabel("wall painted green", (0.45 * length, window)),
        PartLabel("front fin (frame around the pad)", (0.8 * length, rib)),
    ]
    below = [
        PartLabel("camera (behind)", (pose[2], pose[0])),
        PartLabel("wall painted red", (0.6 * length, -window)),
        PartLabel("first touch", (finger.touch_mm[1], _touch_x_mm(finger, window))),
    ]
    if len(layout.ribs):
        z = float(layout.ribs[-1, :, 0].mean())
        below.append(PartLabel(f"rib {design.skeleton.rib_width_mm:g} wide", (z, -(layout.rib_inner_mm + half) / 2.0)))
    row = 0.45 * finger.inch_mm
    label_row(axes, above, finger.front_mm - row, finger.inch_mm)
    label_row(axes, below, row - finger.front_mm, finger.inch_mm)


def _box(axes: Axes, ends: tuple[float, float], half_mm: float, **style: Any) -> None:
    """Draw a rectangle over z and -half .. half across."""
    axes.add_patch(Rectangle((ends[0], -half_mm), ends[1] - ends[0], 2.0 * half_mm, **style))
