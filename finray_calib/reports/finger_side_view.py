"""A finger from its side, cut along the middle, with named parts and sizes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Polygon, Rectangle
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from finray_calib.reports.finger_outline import PART_COLOURS, FingerOutline, outer_edges, side_polygons
from finray_calib.reports.labelled_parts import PartLabel, dimension, label_row
from finray_calib.reports.style import BLUE, HAIRLINE, INK, MUTED, ORANGE, SKY, VERMILLION
from sim.mechanics.skeleton import back_curve_mm
from sim.optics.finger_view import camera_pose
from sim.optics.panel_frame import panel_frame
from sim.surface_meshes.pressed_pad import rest_height_mm

_BEHIND_THE_CUT = "#e4e7eb"


def draw_side(axes: Axes, finger: FingerOutline) -> None:
    """Draw the cut at x = 0, paler what lies beyond it, and the indenter at first touch."""
    design, pad = finger.design, finger.design.pad
    for name in ("base_plate", "backing", "skeleton"):
        if name in finger.hexahedra:
            beyond = side_polygons(finger, name, 0.95 * finger.layout.half_width_mm)
            axes.add_collection(PolyCollection(list(beyond), facecolor=_BEHIND_THE_CUT, edgecolor="face"))
            axes.add_collection(LineCollection(list(outer_edges(beyond)), colors=HAIRLINE, linewidths=0.8))
            cut = side_polygons(finger, name, 0.01)
            axes.add_collection(PolyCollection(list(cut), facecolor=PART_COLOURS[name], edgecolor="face"))
            axes.add_collection(LineCollection(list(outer_edges(cut)), colors=MUTED, linewidths=0.8))
    z = np.linspace(0.0, pad.length_mm, 141)
    axes.fill_between(z, 0.0, rest_height_mm(design, 0.0, z), facecolor=PART_COLOURS["gel"], edgecolor=INK, lw=0.8)
    axes.plot(z, rest_height_mm(design, 0.0, z), color=INK, lw=1.8)
    flange = design.skeleton.flange_mm
    sheet = 0.0 if pad.film is None else pad.film.thickness_mm
    axes.plot([-flange, pad.length_mm + flange], [-sheet / 2.0] * 2, color=ORANGE, lw=2.0)
    mirror = back_curve_mm(finger.layout.mirror, np.linspace(*finger.layout.mirror_along_mm, 80), 0.0)
    axes.plot(mirror[:, 1], mirror[:, 0], color=SKY, lw=3.0)
    _draw_camera(axes, finger)
    _draw_lights(axes, design)
    _draw_indenter(axes, finger)
    low, high = finger.bounds_mm
    inch = finger.inch_mm
    _side_labels(axes, finger)
    dimension(axes, (low[2], low[1] - 0.2 * inch), (high[2], low[1] - 0.2 * inch), f"{high[2] - low[2]:.1f}")
    end = high[2] + 0.4 * inch
    dimension(axes, (end, low[1]), (end, finger.crown_mm), f"{finger.crown_mm - low[1]:.1f}")
    past = pad.length_mm + 0.2 * inch
    dimension(axes, (past, 0.0), (past, finger.crown_mm), f"{finger.crown_mm:.3g}", outside=True)
    over = pad.thickness_mm + 0.25 * inch
    dimension(axes, (0.0, over), (pad.length_mm, over), f"{pad.length_mm:g}", share=0.12)
    axes.set(
        ylabel="y (mm)",
        title="side view, cut along the middle (x = 0); pale: the side of the finger behind the cut",
    )


def _draw_camera(axes: Axes, finger: FingerOutline) -> None:
    """Draw the camera's pinhole and the edges of its field, by way of the mirror, up to the pad."""
    pose, mirror = camera_pose(finger.design), finger.layout.mirror
    y, z = pose.centre_mm[1:]
    axes.plot(z, y, marker="s", color=INK, markersize=8, zorder=5)
    sheet = back_curve_mm(mirror, np.linspace(*finger.layout.mirror_along_mm, 400), 0.0)
    for sign in (-1.0, 1.0):
        ray = (pose.forward + sign * pose.tan_half_width * pose.right)[1:]
        offset = sheet - pose.centre_mm[1:]
        across, along = offset @ np.array([-ray[1], ray[0]]), offset @ ray
        ahead = np.flatnonzero(along > 0.0)
        met = int(ahead[np.argmin(np.abs(across[ahead]) / along[ahead])])
        path = np.array([pose.centre_mm[1:], sheet[met]])
        if 0 < met < len(sheet) - 1:
            tangent = sheet[met + 1] - sheet[met - 1]
            out = 2.0 * (ray @ tangent) * tangent / (tangent @ tangent) - ray
            # straight on to the gel's inner face, where light is refracted
            end = sheet[met] - sheet[met, 0] / out[0] * out
            if 0.0 < end[1] < finger.design.pad.length_mm:
                path = np.vstack([path, end])
        axes.plot(path[:, 1], path[:, 0], color=INK, lw=0.9, ls=":")


def _draw_lights(axes: Axes, design: FingerDesign) -> None:
    """Draw each panel edge-on with its normal and its angle from the pad plane."""
    for light in design.lights:
        panel = panel_frame(light)
        ends = np.array([panel.centre_mm - panel.half_along_mm, panel.centre_mm + panel.half_along_mm])
        axes.plot(ends[:, 2], ends[:, 1], color=BLUE, lw=4.0, solid_capstyle="butt", zorder=5)
        y, z = panel.centre_mm[1:]
        tip = panel.centre_mm + 7.0 * panel.normal
        axes.annotate("", (tip[2], tip[1]), (z, y), arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1.5})
        axes.text(tip[2] + np.sign(panel.normal[2]) * 0.6, tip[1], f"{light.angle_deg:g}°", color=BLUE,
                  ha="left" if panel.normal[2] >= 0.0 else "right", va="center", fontsize=8)  # fmt: skip


def _draw_indenter(axes: Axes, finger: FingerOutline) -> None:
    """Draw the indenter where it first touches, as far up as there is room, and its push."""
    outline, height, crown = finger.indenter_mm, finger.indenter_height_mm, finger.crown_mm
    if outline is not None:
        shown = axes.add_patch(Polygon(outline, facecolor=HAIRLINE, edgecolor=MUTED, alpha=0.6, ls="--"))
        (left, right), (low, _) = axes.get_xlim(), axes.get_ylim()
        room = Rectangle((left, low), right - left, crown + height - low + 0.2, transform=axes.transData)
        shown.set_clip_path(room)
    z = _middle_mm(finger, 0.35)
    axes.annotate(
        "",
        (z, crown + 0.15 * height),
        (z, crown + 0.5 * height),
        arrowprops={"arrowstyle": "-|>", "color": VERMILLION},
    )


def _middle_mm(finger: FingerOutline, share: float) -> float:
    """Return z of the indenter's middle at a share of its height."""
    outline = finger.indenter_mm
    if outline is None:
        return finger.design.indenter.position_mm
    return float(np.mean(_crossings_mm(outline, finger.crown_mm + share * finger.indenter_height_mm)))


def _crossings_mm(outline: NDArray[np.float64], y_mm: float) -> NDArray[np.float64]:
    """Return z where a convex outline (m, 2), z and y, is crossed at a height; of its lowest point below it."""
    (z0, y0), (z1, y1) = outline.T, np.roll(outline, -1, axis=0).T
    crossed = (y0 > y_mm) != (y1 > y_mm)
    if not crossed.any():
        return outline[[outline[:, 1].argmin()], 0]
    return np.asarray((z0 + (y_mm - y0) / np.where(crossed, y1 - y0, 1.0) * (z1 - z0))[crossed])


def _indenter_size(design: FingerDesign) -> str:
    """Return the indenter's shape and size in words."""
    indenter = design.indenter
    if indenter.size_mm is not None:
        x, y, z = indenter.size_mm
        return f"{indenter.shape} {z:g} long, {x:g} wide, {y:g} high"
    return f"{indenter.shape} {indenter.file}" if indenter.file else f"{indenter.shape}, radius {indenter.radius_mm:g}"


def _side_labels(axes: Axes, finger: FingerOutline) -> None:
    """Name the parts of the side view."""
    design, layout = finger.design, finger.layout
    pad, skeleton, indenter = design.pad, design.skeleton, design.indenter
    length = pad.length_mm
    fin = (layout.front_inner_mm + layout.front_outer_mm) / 2.0
    above = [
        PartLabel(
            f"gel pad {length:g} x {pad.width_mm:g} x {pad.thickness_mm:g}", (0.2 * length, 0.6 * finger.crown_mm)
        ),
        PartLabel("coating (what is touched)", (0.78 * length, float(rest_height_mm(design, 0.0, 0.78 * length)))),
        PartLabel(
            f"{_indenter_size(design)},\npushed in by {indenter.depth_mm:g}",
            (_middle_mm(finger, 0.7), finger.crown_mm + 0.7 * finger.indenter_height_mm),
        ),
        PartLabel("tip", (layout.tip_line[0] + skeleton.tip_length_mm / 2.0, fin)),
    ]
    if pad.film is not None:
        above.append(PartLabel(f"film {pad.film.thickness_mm:g}", (-skeleton.flange_mm / 2.0, 0.0)))
    first, last = layout.mirror_along_mm
    backing_s, mirror_s, fin_s = first + np.array([0.52, 0.68, 0.84]) * (last - first)
    mirror = back_curve_mm(layout.mirror, mirror_s, 0.0)
    behind = skeleton.mirror_thickness_mm + skeleton.back_fin_thickness_mm
    fin_back = back_curve_mm(layout.mirror, fin_s, behind / 2.0)
    pose, light = camera_pose(design).centre_mm, design.light.position_mm
    below = [
        PartLabel("base plate", (layout.base_line[0] - skeleton.base_thickness_mm / 2.0, pose[1] - 3.0)),
        PartLabel(f"camera; dotted: its\nfield, {design.camera.field_of_view_deg:g}° diagonal", (pose[2], pose[1])),
        PartLabel(f"light panel{'s' * (len(design.lights) > 1)},\nnormal", (light[2], light[1])),
        PartLabel("mirror", (mirror[1], mirror[0])),
        PartLabel(f"back fin {skeleton.back_fin_thickness_mm:g}", (fin_back[1], fin_back[0])),
    ]
    if len(layout.ribs):
        (z0, s0), (z1, s1) = layout.ribs[min(1, len(layout.ribs) - 1)]
        back = back_curve_mm(layout.mirror, (s0 + s1) / 2.0, skeleton.mirror_thickness_mm)
        middle = 0.5 * (np.array([(z0 + z1) / 2.0, layout.front_inner_mm]) + back[::-1])
        below.append(PartLabel(f"{len(layout.ribs)} pairs of ribs {skeleton.rib_thickness_mm:g}", tuple(middle)))
    if skeleton.backing is not None:
        place = back_curve_mm(layout.mirror, backing_s, behind + skeleton.backing.thickness_mm)
        below.append(PartLabel(f"backing {skeleton.backing.thickness_mm:g}", (place[1], place[0])))
    row = 0.45 * finger.inch_mm
    label_row(axes, above, finger.side_mm[1] - row, finger.inch_mm)
    label_row(axes, below, finger.side_mm[0] + row, finger.inch_mm)
