"""A finger from its side, cut along the middle, and from its front, with named parts and sizes, to scale.

Where the parts lie, in which colours and on what scale; rows of labels with leaders, and dimension lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Polygon, Rectangle
from numpy.typing import NDArray

from data_schemas import FingerDesign, LightPanel
from finray_calib.reports._style import BLUE, GREEN, HAIRLINE, INK, MUTED, ORANGE, SKY, VERMILLION
from sim.mechanics import SkeletonLayout, back_curve_mm, rigid_indenter, side_outline_mm, skeleton_layout, skeleton_mesh
from sim.optics import PanelFrame, camera_pose, panel_frame
from sim.surface_meshes import rest_height_mm

Floats = NDArray[np.float64]

PART_COLOURS = {"skeleton": "#b8c0c8", "base_plate": "#7d8590", "backing": "#c9a97a", "gel": "#f6e7c1"}
"""Fill of the parts in every drawing of a finger."""

_STEP_MM = 1.5
# of the page's width, what axis labels and margins leave for the drawing; and rows of labels above and below a view
_DRAWING_IN, _LABELS_IN = 9.9, 0.85
# of a large indenter only the lower part is shown
_MOST_OF_INDENTER_MM = 24.0
# corners of an indenter this near to the coat at first touch touch it: its round edges are chords
_TOUCH_MM = 0.05


@dataclass(frozen=True, slots=True)
class FingerOutline:
    """A finger's parts and its bounds.

    ``indenter_mm`` is the outline (m, 2), z and y, of the indenter at first touch, None for a mesh that is not at hand;
    ``touch_mm`` is the place, x and z, where it touches first.
    """

    design: FingerDesign
    layout: SkeletonLayout
    nodes_mm: Floats
    hexahedra: dict[str, NDArray[np.int64]]
    indenter_mm: Floats | None
    touch_mm: tuple[float, float]

    @property
    def bounds_mm(self) -> tuple[Floats, Floats]:
        """Least and greatest x, y, z of the skeleton and its plates."""
        return self.nodes_mm.min(axis=0), self.nodes_mm.max(axis=0)

    @property
    def crown_mm(self) -> float:
        """Height of the coat under the indenter."""
        return float(rest_height_mm(self.design, 0.0, self.design.indenter.position_mm))

    @property
    def indenter_height_mm(self) -> float:
        """How much of the indenter is shown above the crown."""
        height = 2.0 * self.design.indenter.radius_mm if self.indenter_mm is None else np.ptp(self.indenter_mm[:, 1])
        return float(min(height, _MOST_OF_INDENTER_MM))

    @property
    def inch_mm(self) -> float:
        """What an inch of the page shows: finger, dimension lines at the tip and a margin fill the page."""
        low, high = self.bounds_mm
        return 1.25 * float(high[2] - low[2]) / _DRAWING_IN

    @property
    def side_mm(self) -> tuple[float, float]:
        """Least and greatest y of the side view with its labels."""
        row = self.inch_mm * _LABELS_IN
        return self.bounds_mm[0][1] - row, self.crown_mm + self.indenter_height_mm + row

    @property
    def front_mm(self) -> float:
        """Greatest x of the front view with its labels."""
        return self.layout.half_width_mm + self.inch_mm * _LABELS_IN

    @property
    def views_in(self) -> float:
        """Height of both views on the page, inches."""
        low, high = self.side_mm
        return (high - low + 2.0 * self.front_mm) / self.inch_mm


def finger_outline(design: FingerDesign, folder: Path | None = None) -> FingerOutline:
    """Return the parts of a design.

    Parameters
    ----------
    design
        Finger and indenter.
    folder
        Where the design stands; without it, the mesh of an indenter is not looked for.

    Raises
    ------
    SimulateError
        When they do not fit together.
    """
    mesh = skeleton_mesh(design, _STEP_MM)
    outline, touch = side_outline_mm(design, folder=folder), _first_touch_mm(design, folder)
    return FingerOutline(design, skeleton_layout(design), mesh.nodes_mm, mesh.hexahedra, outline, touch)


def _first_touch_mm(design: FingerDesign, folder: Path | None) -> tuple[float, float]:
    """Return where the indenter touches first, x and z; of an edge or a face its middle."""
    wanted, pad = design.indenter, design.pad
    place = wanted.across_mm, wanted.position_mm
    if wanted.shape in ("cylinder", "ball") or (wanted.shape == "mesh" and folder is None):
        return place
    x, y, z = rigid_indenter(design, folder or Path()).vertices_mm().T
    over = (np.abs(x) <= pad.width_mm / 2.0) & (z >= 0.0) & (z <= pad.length_mm)
    if not over.any():
        return place
    gap = y[over] - rest_height_mm(design, x[over], z[over])
    touching = gap <= gap.min() + _TOUCH_MM
    middle = [(v[over][touching].min() + v[over][touching].max()) / 2.0 for v in (x, z)]
    return float(middle[0]), float(middle[1])


def side_polygons(finger: FingerOutline, name: str, x_mm: float) -> Floats:
    """Return the quadrilaterals (m, 4, 2) of z and y in which a part is met at x."""
    corners = finger.nodes_mm[finger.hexahedra[name]]
    met = (corners[..., 0].min(axis=1) <= x_mm) & (corners[..., 0].max(axis=1) > x_mm)
    # corners 0, 3, 7, 4 of C3D8: the face at the lower end of the first grid direction, which is x
    return np.asarray(corners[met][:, [0, 3, 7, 4]][..., [2, 1]])


def outer_edges(polygons: Floats) -> Floats:
    """Return the edges (m, 2, 2) that belong to one polygon only."""
    edges = np.stack([polygons, np.roll(polygons, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    keys = np.sort(np.round(edges, 6).view(np.complex128)[..., 0], axis=1)
    _, first, times = np.unique(keys, axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[first[times == 1]])


_BEHIND_THE_CUT = "#e4e7eb"


def draw_side(axes: Axes, finger: FingerOutline) -> None:
    """Draw the cut at x = 0, paler what lies beyond it, and the indenter at first touch."""
    design, pad = finger.design, finger.design.pad
    draw_body(axes, finger)
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


def draw_body(axes: Axes, finger: FingerOutline, rasterized: bool = False) -> None:
    """Draw skeleton, plates, gel pad, coat, film and mirror from the side; many small faces may be drawn as pixels."""
    design, pad = finger.design, finger.design.pad
    for name in ("base_plate", "backing", "skeleton"):
        if name in finger.hexahedra:
            beyond = side_polygons(finger, name, 0.95 * finger.layout.half_width_mm)
            axes.add_collection(
                PolyCollection(list(beyond), facecolor=_BEHIND_THE_CUT, edgecolor="face", rasterized=rasterized)
            )
            axes.add_collection(
                LineCollection(list(outer_edges(beyond)), colors=HAIRLINE, linewidths=0.8, rasterized=rasterized)
            )
            cut = side_polygons(finger, name, 0.01)
            axes.add_collection(
                PolyCollection(list(cut), facecolor=PART_COLOURS[name], edgecolor="face", rasterized=rasterized)
            )
            axes.add_collection(
                LineCollection(list(outer_edges(cut)), colors=MUTED, linewidths=0.8, rasterized=rasterized)
            )
    z = np.linspace(0.0, pad.length_mm, 141)
    axes.fill_between(z, 0.0, rest_height_mm(design, 0.0, z), facecolor=PART_COLOURS["gel"], edgecolor=INK, lw=0.8)
    axes.plot(z, rest_height_mm(design, 0.0, z), color=INK, lw=1.8)
    flange = design.skeleton.flange_mm
    sheet = 0.0 if pad.film is None else pad.film.thickness_mm
    axes.plot([-flange, pad.length_mm + flange], [-sheet / 2.0] * 2, color=ORANGE, lw=2.0)
    mirror = back_curve_mm(finger.layout.mirror, np.linspace(*finger.layout.mirror_along_mm, 80), 0.0)
    axes.plot(mirror[:, 1], mirror[:, 0], color=SKY, lw=3.0)


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


_ARROW_MM = 7.0


def draw_panel(axes: Axes, light: LightPanel) -> PanelFrame:
    """Draw a light panel edge-on with its normal, and return where it stands."""
    panel = panel_frame(light)
    ends = np.array([panel.centre_mm - panel.half_along_mm, panel.centre_mm + panel.half_along_mm])
    axes.plot(ends[:, 2], ends[:, 1], color=BLUE, lw=4.0, solid_capstyle="butt", zorder=5)
    tip = panel.centre_mm + _ARROW_MM * panel.normal
    axes.annotate("", (tip[2], tip[1]), (panel.centre_mm[2], panel.centre_mm[1]),
                  arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1.5}, zorder=5)  # fmt: skip
    return panel


def _draw_lights(axes: Axes, design: FingerDesign) -> None:
    """Draw each panel with its angle from the pad plane."""
    for light in design.lights:
        panel = draw_panel(axes, light)
        tip = panel.centre_mm + _ARROW_MM * panel.normal
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
    if indenter.is_packaged:
        return f"{indenter.shape} of {indenter.package}"
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


# mean letter of 8 points, and the space between labels
_LETTER_IN, _SPACE_IN = 0.068, 0.15


@dataclass(frozen=True, slots=True)
class PartLabel:
    """Name of a part and a place on it, in the drawing's own coordinates."""

    text: str
    place_mm: tuple[float, float]


def label_row(axes: Axes, labels: Sequence[PartLabel], height_mm: float, inch_mm: float) -> None:
    """Write labels in a row at a height, in the order of their places, each as near to its place as there is room."""
    ordered = sorted(labels, key=lambda label: label.place_mm[0])
    wanted = np.array([label.place_mm[0] for label in ordered])
    widths = np.array([_LETTER_IN * max(map(len, label.text.split("\n"))) + _SPACE_IN for label in ordered])
    for label, centre in zip(ordered, spread(wanted, inch_mm * widths, axes.get_xlim()), strict=True):
        above = height_mm > label.place_mm[1]
        axes.annotate(
            label.text,
            label.place_mm,
            (centre, height_mm),
            ha="center",
            va="bottom" if above else "top",
            fontsize=8,
            color=INK,
            arrowprops={"arrowstyle": "-", "color": MUTED, "lw": 0.7, "shrinkA": 1, "shrinkB": 0},
            zorder=6,
        )
        axes.plot(*label.place_mm, marker="o", markersize=2.2, color=INK, zorder=6)


def spread(wanted: Floats, widths: Floats, limits: tuple[float, float]) -> Floats:
    """Return ascending centres, as near to the wanted ones as intervals of these widths allow (least squares).

    The sum of half widths before a centre taken from it, this is isotonic regression within bounds, which pooling
    neighbours, then clipping, solves. Where all intervals together do not fit within the limits, they end beyond the
    upper one.
    """
    offsets = np.concatenate([[0.0], np.cumsum((widths[1:] + widths[:-1]) / 2.0)])
    pools: list[tuple[float, int]] = []
    for value in wanted - offsets:
        mean, count = float(value), 1
        while pools and pools[-1][0] > mean:
            before, members = pools.pop()
            mean, count = (before * members + mean * count) / (members + count), members + count
        pools.append((mean, count))
    lowest, highest = limits[0] + widths[0] / 2.0, limits[1] - widths[-1] / 2.0 - offsets[-1]
    pooled = np.repeat([mean for mean, _ in pools], [count for _, count in pools])
    return np.asarray(np.maximum(np.minimum(pooled, highest), lowest) + offsets)


def dimension(
    axes: Axes,
    start_mm: tuple[float, float],
    end_mm: tuple[float, float],
    text: str,
    share: float = 0.5,
    outside: bool = False,
) -> None:
    """Draw a dimension line, its size at a share of its length, or outside where there is no room on it."""
    axes.annotate(
        "", start_mm, end_mm, arrowprops={"arrowstyle": "<->", "color": INK, "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
    )
    x, y = (1.0 - share) * np.array(start_mm) + share * np.array(end_mm)
    upright = abs(end_mm[1] - start_mm[1]) > abs(end_mm[0] - start_mm[0])
    box = {"facecolor": "white", "edgecolor": "none", "pad": 0.8}
    if outside:
        axes.text(x + 0.8, y, text, ha="left", va="center", fontsize=8)
    else:
        axes.text(x, y, text, ha="center", va="center", fontsize=8, rotation=90 if upright else 0, bbox=box, zorder=7)
