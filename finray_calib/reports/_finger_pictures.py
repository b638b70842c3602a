"""Pictures of a finger: its design with the camera's view below, pressed with its force; and of a classic sensor.

A finger is also drawn along an indenter's path. The camera's view shows the parts in its frame with a millimetre
grid, and how finely they are seen. A classic sensor is drawn as its design says, with its camera's view, and told in
words with where its numbers come from.
"""

import textwrap
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from pydantic import BaseModel

from data_schemas import ColouredLight, FingerDesign, FingerSurfaces, PlainSensor, PressMechanics, PressMotion
from finray_calib.reports._finger_views import PART_COLOURS, FingerOutline, draw_front, draw_side, finger_outline
from finray_calib.reports._style import (
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
from sim.mechanics import finger_mesh, side_outline_mm
from sim.optics import CameraView, light_frame, sensor_pose
from sim.surface_meshes import FingerShape, Surface, rest_height_mm, restore_shapes, shape_from_mesh

_PAGE_IN, _CAMERA_VIEW_IN = 11.0, 4.8
# titles and axes of both views
_TITLES_IN = 2.0


@styled()
def finger_page_png(view: CameraView, folder: Path | None = None) -> bytes:
    """Return the drawing of a finger with its camera's view below, as PNG bytes.

    Without the folder where the design stands, the mesh of an indenter is not drawn.

    Raises
    ------
    SimulateError
        When the parts of the design do not fit together.
    """
    finger = finger_outline(view.design, folder)
    figure = new_figure(_PAGE_IN, finger.views_in + _TITLES_IN + _CAMERA_VIEW_IN)
    rows = figure.add_gridspec(2, 1, height_ratios=(finger.views_in + _TITLES_IN, _CAMERA_VIEW_IN))
    _draw_finger(figure.add_subfigure(rows[0]), finger)
    draw_camera_view(figure.add_subfigure(rows[1]), view)
    return png_bytes(figure)


@styled()
def finger_png(design: FingerDesign, folder: Path | None = None) -> bytes:
    """Return the drawing of a finger as PNG bytes: cut along its middle, and from its front, on one scale.

    Raises
    ------
    SimulateError
        When the parts of the design do not fit together.
    """
    finger = finger_outline(design, folder)
    figure = new_figure(_PAGE_IN, finger.views_in + _TITLES_IN)
    _draw_finger(figure, finger)
    return png_bytes(figure)


def _draw_finger(figure: Figure | SubFigure, finger: FingerOutline) -> None:
    """Draw both views of a finger."""
    low, high = finger.side_mm
    side, front = figure.subplots(2, 1, sharex=True, height_ratios=(high - low, 2.0 * finger.front_mm))
    ends, inch = finger.bounds_mm, finger.inch_mm
    side.set(xlim=(ends[0][2] - 0.8 * inch, ends[1][2] + inch), ylim=(low, high))
    front.set_ylim(-finger.front_mm, finger.front_mm)
    draw_side(side, finger)
    draw_front(front, finger)
    figure.suptitle(
        f"{finger.design.name} (mm): z along the pad from its base, y along its outward normal, x across",
        parse_math=False,
    )
    for axes in (side, front):
        axes.set_aspect("equal")
        axes.grid(visible=False)
        axes.tick_params(labelbottom=True)


_COLOURS = {"coat": "#f3efe6", "red": VERMILLION, "green": GREEN, "panel 1": BLUE, "panel 2": BLUE}
_GRID_ALONG_MM, _GRID_ACROSS_MM = 10.0, 5.0


def draw_camera_view(figure: Figure | SubFigure, view: CameraView) -> None:
    """Draw the camera's frame on the left and the pad on the right of a figure or a part of one."""
    frame, pad = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    _draw_frame(frame, view)
    shown = _draw_pad(pad, view)
    bar = figure.colorbar(shown, ax=pad, shrink=0.9)
    bar.set_label("sensor pixels per mm of the coat (geometric mean)")


def _draw_frame(axes: Axes, view: CameraView) -> None:
    """Draw which part each pixel sees, and lines of equal place on the coat."""
    maps, camera = view.maps, view.design.camera
    picture = np.full((*maps.part.shape, 3), to_rgb(INK))
    for name in maps.parts:
        picture[maps.sees(name)] = to_rgb(_COLOURS.get(name, MUTED))
    extent = (0.0, float(camera.width_px), float(camera.height_px), 0.0)
    axes.imshow(picture, extent=extent, interpolation="nearest")
    place = maps.coat_mm(view.design)
    rows, columns = maps.part.shape
    x, y = (np.arange(columns) + 0.5) / columns * camera.width_px, (np.arange(rows) + 0.5) / rows * camera.height_px
    for k, step, name, colour in ((0, _GRID_ALONG_MM, "z", MUTED), (1, _GRID_ACROSS_MM, "x", ORANGE)):
        values = place[..., k]
        levels = np.arange(np.ceil(np.nanmin(values) / step) * step, np.nanmax(values), step)
        if levels.size:
            lines = axes.contour(x, y, values, levels=levels, colors=colour, linewidths=0.9)
            axes.clabel(lines, fmt=f"{name} %g", fontsize=7)
    axes.grid(visible=False)
    seen = ", ".join(
        f"{label} {100 * view.picture_share(name):.1f} %"
        for name, label in (("coat", "coat"), ("red", "red wall"), ("green", "green wall"))
    )
    axes.set(
        title=f"camera's frame: {seen}\n(black: the cloth; blue: a light panel)",
        xlabel="column (px)",
        ylabel="row (px)",
    )


def _draw_pad(axes: Axes, view: CameraView) -> PolyCollection:
    """Draw the pad and, at the places that are seen, how finely."""
    pad = view.design.pad
    fine = np.sqrt(view.px_per_mm_along * view.px_per_mm_across)
    place = view.maps.coat_mm(view.design)[..., ::-1]
    corners = np.stack([place[:-1, :-1], place[:-1, 1:], place[1:, 1:], place[1:, :-1]], axis=-2)
    values = np.stack([fine[:-1, :-1], fine[:-1, 1:], fine[1:, 1:], fine[1:, :-1]], axis=-1)
    whole = np.isfinite(corners).all(axis=(-1, -2)) & np.isfinite(values).any(axis=-1)
    axes.set_facecolor(HAIRLINE)
    shown = PolyCollection(corners[whole], array=np.nanmean(values[whole], axis=-1), cmap="viridis", edgecolors="face")
    axes.add_collection(shown)
    axes.set(
        xlim=(-pad.width_mm / 2, pad.width_mm / 2),
        ylim=(0.0, pad.length_mm),
        aspect="equal",
        title=f"pad: {100 * view.coat_share:.0f} % of the coat is seen (grey: not)",
        xlabel="x across (mm)",
        ylabel="z along, from the base (mm)",
    )
    axes.grid(visible=False)
    return shown


Floats = NDArray[np.float64]

# a triangle turned further from the viewer is seen edge-on
_LEAST_FACING = 0.05
# vertices of one line along the finger share u to rounding
_SAME_U = 1e-6


@styled()
def pressed_finger_png(mechanics: PressMechanics, surfaces: FingerSurfaces, folder: Path | None = None) -> bytes:
    """Return a picture of a pressed finger as PNG bytes.

    Left, the finger from its red side before the press, and after it, coloured by the length of the displacement
    (no exaggeration); a dashed line is the coat along the middle. Right, force along the pad's normal against push.

    Parameters
    ----------
    mechanics, surfaces
        The two records of one press.
    folder
        Where the design stands; an indenter of the user, an STL relative to it, is drawn only with it.

    Raises
    ------
    SimulateError
        When the surfaces are broken.
    """
    rest, pressed = restore_shapes(surfaces)
    depth_mm = float(mechanics.depth_mm[-1])
    figure = new_figure(13.0, 8.8)
    columns = figure.add_gridspec(1, 2, width_ratios=(2.0, 1.0))
    views, curve = (figure.add_subfigure(columns[k]) for k in range(2))
    before, after = views.subplots(2, 1, sharex=True, sharey=True)
    draw_shape(before, rest)
    _draw_indenter(before, mechanics.design, 0.0, folder)
    shown = _draw_after(after, rest, pressed)
    _draw_indenter(after, mechanics.design, depth_mm, folder)
    views.colorbar(shown, ax=[before, after], shrink=0.8, label="displacement of the surfaces that are seen (mm)")
    before.set_title("before: the indenter touches (colours: parts; dashed: the coat along the middle)")
    after.set_title(f"after a push of {depth_mm:.2f} mm, to scale (seen from the red side; grey: before)")
    for axes in (before, after):
        axes.set(aspect="equal", ylabel="y (mm)")
        axes.grid(visible=False)
        axes.autoscale_view()
    after.set_xlabel("z along the finger, from the base of the pad (mm)")
    _draw_curve(curve.subplots(), mechanics)
    figure.suptitle(f"{mechanics.name}: {mechanics.label}", parse_math=False)
    return png_bytes(figure)


_MOST_PATCHES = 10  # of a path are drawn, evenly chosen, the last one among them
_PATCHES_A_ROW = 5
_PATCH_MARGIN_MM = 1.0
_ARROWS_SHARE = 0.25  # of the patch's size, the longest arrow of shear


@styled()
def indenter_path_png(mechanics: PressMechanics) -> bytes:
    """Return a picture of an indenter's path as PNG bytes.

    Above, force and torque on the indenter at each increment. Below, the patch on the undeformed pad at up to ten of
    them: pressure by colour, what slips ringed, and the friction on the coat as arrows.

    Parameters
    ----------
    mechanics
        Of a press along a path.

    Raises
    ------
    ValueError
        When the press has no path.
    """
    motion = mechanics.motion
    if motion is None:
        raise ValueError("the press has no path to draw, because its indenter was pushed along the pad's normal")
    count = len(mechanics.depth_mm)
    shown = np.unique(np.round(np.linspace(0, count - 1, min(count, _MOST_PATCHES))).astype(int))
    rows = -(-len(shown) // _PATCHES_A_ROW)
    figure = new_figure(13.0, 3.6 + 3.2 * rows)
    above, below = np.asarray(figure.subfigures(2, 1, height_ratios=(3.6, 3.2 * rows)))
    _draw_wrench(above, mechanics, motion)
    axes = below.subplots(rows, _PATCHES_A_ROW, squeeze=False, sharex=True, sharey=True)
    for place in axes.flat[len(shown) :]:
        place.set_visible(False)
    for place, k in zip(axes.flat, shown, strict=False):
        drawn = draw_patch(place, motion, int(k))
    below.colorbar(drawn, ax=axes, shrink=0.8, label="pressure (MPa)")
    below.supxlabel("x across the pad (mm); ringed: slips in this increment; arrows: friction on the coat")
    below.supylabel("z along the finger (mm)")
    figure.suptitle(f"{mechanics.name}: {mechanics.label}, friction {motion.friction:g}", parse_math=False)
    return png_bytes(figure)


_AXES = (("across, x", VERMILLION), ("along the normal, y", BLUE), ("along the finger, z", GREEN))


def _draw_wrench(figure: SubFigure, mechanics: PressMechanics, motion: PressMotion) -> None:
    """Draw force, torque and what sticks, at each increment."""
    force, torque, sticks = figure.subplots(1, 3)
    steps = np.arange(1, len(mechanics.depth_mm) + 1)
    for k, (name, colour) in enumerate(_AXES):
        force.plot(steps, mechanics.force_n[:, k], "-o", color=colour, markersize=3, label=name)
        torque.plot(steps, motion.torque_n_mm[:, k], "-o", color=colour, markersize=3)
    for axes in (force, torque, sticks):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    force.set(xlabel="increment", ylabel="force on the indenter (N)")
    force.legend()
    torque.set(xlabel="increment", ylabel="torque about its middle (N mm)")
    sticks.plot(steps, motion.patch_mm2, "-o", color=INK, markersize=3, label="touches")
    sticks.plot(steps, motion.stuck_mm2, "-o", color=ORANGE, markersize=3, label="sticks")
    sticks.set(xlabel="increment", ylabel="area of the coat (mm2)", ylim=(0.0, None))
    sticks.legend()


def draw_patch(axes: Axes, motion: PressMotion, k: int) -> PathCollection:
    """Draw pressure, slip and friction of one increment at its points."""
    x, z = motion.points_mm[:, 0], motion.points_mm[:, 2]
    touches = motion.pressure_mpa[k] > 0.0
    slips = touches & (motion.slip_mm[k] > 0.0)
    axes.scatter(x, z, s=9, color=HAIRLINE, linewidths=0)
    drawn = axes.scatter(
        x[touches], z[touches], c=motion.pressure_mpa[k, touches], s=26, cmap="viridis", linewidths=0,
        vmin=0.0, vmax=float(motion.pressure_mpa.max()) or 1.0,
    )  # fmt: skip
    axes.scatter(x[slips], z[slips], s=34, facecolors="none", edgecolors=VERMILLION, linewidths=1.0)
    largest = float(np.linalg.norm(motion.shear_mpa[..., [0, 2]], axis=-1).max())
    size = max(float(np.ptp(x)), float(np.ptp(z)), 1.0)
    margin_mm = max(_PATCH_MARGIN_MM, _ARROWS_SHARE * size)
    if largest > 0.0:
        arrows = -motion.shear_mpa[k, touches][:, [0, 2]] * (_ARROWS_SHARE * size / largest)
        starts = np.column_stack([x, z])[touches]
        axes.quiver(*starts.T, *arrows.T, angles="xy", scale_units="xy", scale=1.0, color=INK, width=0.006)
    x_mm, y_mm, z_mm = motion.moves_mm[k]
    turn = float(np.linalg.norm(motion.turns_deg[k]))
    axes.set_title(
        f"{k + 1}: push {-y_mm + 0.0:.2f}, aside {np.hypot(x_mm, z_mm):.2f} mm\nturn {turn:.1f} deg", fontsize=8
    )
    axes.set(
        aspect="equal",
        xlim=(x.min() - margin_mm, x.max() + margin_mm),
        ylim=(z.min() - margin_mm, z.max() + margin_mm),
    )
    axes.grid(visible=False)
    return drawn


@styled()
def untouched_finger_png(design: FingerDesign, why: str, folder: Path | None = None) -> bytes:
    """Return a picture of a finger whose press found no equilibrium at all, as PNG bytes: where the indenter touches.

    Parameters
    ----------
    design
        Finger and indenter.
    why
        What the press said, for the picture's title.
    folder
        Where the design stands; an STL relative to it is drawn only with it.
    """
    mesh = finger_mesh(design)
    figure = new_figure(13.0, 6.0)
    axes = figure.subplots()
    draw_shape(axes, shape_from_mesh(design, mesh.nodes_mm, mesh.hexahedra))
    _draw_indenter(axes, design, 0.0, folder)
    axes.set_title("\n".join(textwrap.wrap(f"stopped where the indenter first touches: {why}", 120)))
    axes.set(aspect="equal", xlabel="z along the finger, from the base of the pad (mm)", ylabel="y (mm)")
    axes.grid(visible=False)
    axes.autoscale_view()
    return png_bytes(figure)


def draw_shape(axes: Axes, rest: FingerShape) -> None:
    """Draw the finger at rest, coloured by part."""
    for name in _farthest_first(rest):
        polygons = _polygons(rest.surfaces[name], _facing(rest.surfaces[name]))
        colour = PART_COLOURS.get(name, PART_COLOURS["gel"])
        axes.add_collection(
            PolyCollection(list(polygons), facecolors=colour, edgecolors="face", linewidths=0.7, snap=False)
        )
    _draw_lines(axes, rest)


def _draw_after(axes: Axes, rest: FingerShape, pressed: FingerShape) -> PolyCollection:
    """Draw the pressed finger, coloured by displacement, over the outlines of the finger at rest."""
    polygons, moved_mm = [], []
    for name in _farthest_first(rest):
        before, after = rest.surfaces[name], pressed.surfaces[name]
        facing = _facing(before)
        axes.add_collection(LineCollection(list(_outlines(before, facing)), colors=MUTED, linewidths=0.6, alpha=0.6))
        polygons.append(_polygons(after, facing))
        distance = np.linalg.norm(after.vertices_mm - before.vertices_mm, axis=1)
        moved_mm.append(distance[after.triangles[facing]].mean(axis=1))
    values = np.concatenate(moved_mm)
    shown = PolyCollection(
        list(np.concatenate(polygons)),
        array=values,
        cmap="viridis",
        edgecolors="face",
        linewidths=0.7,
        snap=False,
    )
    shown.set_clim(0.0, float(values.max()))
    axes.add_collection(shown)
    _draw_lines(axes, pressed)
    return shown


def _draw_lines(axes: Axes, shape: FingerShape) -> None:
    """Draw the edge of the mirror, and the coat along the middle of the pad."""
    for name, u, colour, style in (("mirror", 1.0, SKY, "-"), ("coat", 0.5, INK, "--")):
        surface = shape.surfaces[name]
        away = np.abs(surface.uv[:, 0] - u)
        line = np.flatnonzero(away < away.min() + _SAME_U)
        line = line[np.argsort(surface.uv[line, 1])]
        axes.plot(surface.vertices_mm[line, 2], surface.vertices_mm[line, 1], style, color=colour, lw=1.4)


def _draw_indenter(axes: Axes, design: FingerDesign, depth_mm: float, folder: Path | None) -> None:
    """Draw the indenter at a push from first touch."""
    outline = side_outline_mm(design, depth_mm, folder)
    if outline is not None:
        axes.add_patch(Polygon(outline, facecolor=HAIRLINE, edgecolor=MUTED, alpha=0.5, ls="--"))
        z, y = outline.mean(axis=0)
        axes.text(float(z), float(y), design.indenter.shape, ha="center", va="center", fontsize=8)


def _draw_curve(axes: Axes, mechanics: PressMechanics) -> None:
    """Draw the force along the pad's normal against the push, from nothing to the last increment."""
    depth = np.concatenate([[0.0], mechanics.depth_mm])
    force = np.concatenate([[0.0], mechanics.force_n[:, 1]])
    axes.plot(depth, force, "-o", color=BLUE, markersize=4)
    if mechanics.unreached:
        if mechanics.wanted_force_n is not None:
            label = f"requested force, {mechanics.wanted_force_n:g} N"
            axes.axhline(mechanics.wanted_force_n, color=VERMILLION, ls=":", label=label)
        else:
            wanted = mechanics.design.indenter.depth_mm
            axes.axvline(wanted, color=VERMILLION, ls=":", label=f"requested push, {wanted:g} mm")
        axes.legend(loc="lower right")
    axes.set(xlabel="push of the indenter from first touch (mm)", ylabel="force along the pad's normal (N)")
    title = f"{force[-1]:.2f} N at {depth[-1]:.2f} mm"
    if not force[-1] > 0.0:
        title += (
            ":\nthe force comes from the mesh, not from the finger: the indenter touches no node or has passed through"
        )
    # a little room below a force that pulls, none below nought
    axes.set(xlim=(0.0, None), ylim=(min(0.0, 1.1 * force.min()), None), title=title)


def _farthest_first(shape: FingerShape) -> list[str]:
    """Return the parts by their least x, the greatest first: what is nearer to the viewer hides what is farther."""
    return sorted(shape.surfaces, key=lambda name: -float(shape.surfaces[name].vertices_mm[:, 0].min()))


def _facing(surface: Surface) -> NDArray[np.int64]:
    """Return the triangles that look to the viewer at x = -infinity, who sees z run to the right, farthest first."""
    corners = surface.vertices_mm[surface.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.flatnonzero(-normal[:, 0] > _LEAST_FACING * np.linalg.norm(normal, axis=1))
    return facing[np.argsort(-corners[facing, :, 0].mean(axis=1), kind="stable")]


def _polygons(surface: Surface, facing: NDArray[np.int64]) -> Floats:
    """Return z and y of triangles, shape (m, 3, 2)."""
    return surface.vertices_mm[surface.triangles[facing]][..., [2, 1]]


def _outlines(surface: Surface, facing: NDArray[np.int64]) -> Floats:
    """Return z and y of the edges that only one of these triangles has, shape (m, 2, 2)."""
    triangles = surface.triangles[facing]
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, times = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(surface.vertices_mm[unique[times == 1]][..., [2, 1]])


_LIGHT_COLOURS = {"red": VERMILLION, "green": GREEN, "blue": BLUE, "white": "#f5d76e"}
_SENSOR_PAGE_IN = (11.0, 7.4)
_GRID_MM = 5.0
_VIEW_MM = 6.0
_UNITS = {"mm": "mm", "deg": "deg", "nm": "nm", "px": "px", "rel": "relative"}


def sensor_text(sensor: PlainSensor, places_mm: Floats) -> str:
    """Return what a sensor sees and what its numbers rest on, in lines.

    Parameters
    ----------
    sensor
        The sensor.
    places_mm
        From :func:`sim.optics.seen_places_mm` of the gel at rest.
    """
    seen = np.isfinite(places_mm[..., 0])
    low, high = np.nanmin(places_mm, axis=(0, 1)), np.nanmax(places_mm, axis=(0, 1))
    pad, middle = sensor.pad, sensor.pad.length_mm / 2.0
    scale = _mm_per_px(places_mm)
    lines = [
        f"{sensor.name}: {100 * seen.mean():.0f} % of the picture shows the coat",
        f"  across the pad  x = {low[0]:.1f} to {high[0]:.1f} mm of {-pad.width_mm / 2:g} to {pad.width_mm / 2:g} mm",
        f"  along the pad   z = {low[1]:.1f} to {high[1]:.1f} mm of 0 to {pad.length_mm:g} mm",
        f"  a pixel is      {np.nanmedian(scale):.4f} mm in the median, {np.nanpercentile(scale, 5):.4f} to "
        f"{np.nanpercentile(scale, 95):.4f} mm over 90 % of them",
        f"  gel             {pad.thickness_mm:g} mm thick, index {pad.refractive_index:g}, {sensor.walls} sides",
    ]
    for light in sensor.lights:
        x, y, z = light_frame(sensor, light).centre_mm
        lines.append(
            f"  {light.channel + ' light':15} at x = {x:.1f}, y = {y:.1f}, z = {z - middle:+.1f} mm from the middle, "
            f"{light.width_mm:g} x {light.height_mm:g} mm, {light.angle_deg:g} deg from the pad plane, power "
            f"{light.power_rel:g}"
        )
    told = [(field, value, sensor.origin.get(field, "assumed")) for field, value in _numbers(sensor)]
    assumed = sum(where == "assumed" for _, _, where in told)
    lines.append(
        f"  {assumed} of {len(told)} numbers are assumed; the others, with a stated uncertainty where there is one:"
    )
    lines += [
        f"    {where:10} {field} = {value}{_spread(sensor, field)}"
        for field, value, where in told
        if where != "assumed"
    ]
    if sensor.source:
        lines.append(f"  source: {sensor.source}")
    return "\n".join(lines)


def _mm_per_px(places_mm: Floats) -> Floats:
    """Return the side of the square that a pixel shows, mm."""
    by_row, by_column = np.diff(places_mm, axis=0)[:, :-1], np.diff(places_mm, axis=1)[:-1]
    return np.sqrt(np.abs(by_row[..., 0] * by_column[..., 1] - by_row[..., 1] * by_column[..., 0]))


def _spread(sensor: PlainSensor, field: str) -> str:
    """Return the stated uncertainty of a number."""
    return (
        f" (standard uncertainty {100 * sensor.uncertainty_rel[field]:.1f} %)"
        if field in sensor.uncertainty_rel
        else ""
    )


def _numbers(sensor: PlainSensor) -> Iterator[tuple[str, str]]:
    """Yield the numbers and choices of a design with their values; of the lights, those of all together."""
    for name in PlainSensor.model_fields:
        part = getattr(sensor, name)
        if isinstance(part, BaseModel):
            yield from _of_part(name, part)
        elif isinstance(part, float | int):
            yield name, f"{part:g}"
    for name in ColouredLight.model_fields:
        values = [getattr(light, name) for light in sensor.lights]
        if any(value is not None for value in values):
            yield f"lights.{name}", ", ".join(dict.fromkeys(_words(value) for value in values))


def _of_part(name: str, part: BaseModel) -> Iterator[tuple[str, str]]:
    for field in type(part).model_fields:
        value = getattr(part, field)
        if isinstance(value, BaseModel):
            yield from _of_part(f"{name}.{field}", value)
        elif value is not None:
            yield f"{name}.{field}", _words(value)


def _words(value: object) -> str:
    if isinstance(value, tuple):
        return " x ".join(_words(v) for v in value)
    return f"{value:g}" if isinstance(value, float | int) else str(value)


@styled()
def sensor_png(sensor: PlainSensor, places_mm: Floats) -> bytes:
    """Return the drawing of a classic sensor as PNG bytes: from below, cut along x = 0, and its camera's view.

    Parameters
    ----------
    sensor
        The sensor.
    places_mm
        From :func:`sim.optics.seen_places_mm` of the gel at rest.
    """
    figure = new_figure(*_SENSOR_PAGE_IN)
    (plan, view), (side, across) = figure.subplots(2, 2)
    _draw_plan(plan, sensor)
    _draw_view(view, places_mm)
    _draw_cut(side, sensor, 2)
    _draw_cut(across, sensor, 0)
    figure.suptitle(f"{sensor.name} (mm): x across the pad, y into its gel, z along it", parse_math=False)
    return png_bytes(figure)


def _corners(sensor: PlainSensor, light: ColouredLight) -> Floats:
    """Return the corners of a light, (4, 3)."""
    frame = light_frame(sensor, light)
    sides = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.asarray(frame.centre_mm + sides[:, :1] * frame.half_across_mm + sides[:, 1:] * frame.half_along_mm)


def _draw_plan(axes: Axes, sensor: PlainSensor) -> None:
    """Draw pad, lights and camera as the camera sees them from below."""
    pad = sensor.pad
    axes.add_patch(
        Rectangle((-pad.width_mm / 2, 0.0), pad.width_mm, pad.length_mm, facecolor=HAIRLINE, edgecolor=MUTED)
    )
    for light in sensor.lights:
        frame, corners = light_frame(sensor, light), _corners(sensor, light)
        axes.add_patch(
            Polygon(
                corners[:, [0, 2]],
                facecolor=_LIGHT_COLOURS[light.channel],
                edgecolor=_LIGHT_COLOURS[light.channel],
                linewidth=1.8,
            )
        )
        start, end = frame.centre_mm, frame.centre_mm + _VIEW_MM * frame.normal
        axes.annotate("", (end[0], end[2]), (start[0], start[2]), arrowprops={"arrowstyle": "->", "color": MUTED})
    centre = sensor_pose(sensor).centre_mm
    axes.plot(centre[0], centre[2], marker="x", color=INK, linestyle="none")
    axes.annotate("camera", (centre[0], centre[2]), textcoords="offset points", xytext=(6, 4))
    axes.set(title="lights below the pad", xlabel="x across (mm)", ylabel="z along (mm)", aspect="equal")
    axes.grid(visible=False)
    axes.margins(0.08)
    axes.autoscale_view()


def _draw_cut(axes: Axes, sensor: PlainSensor, along: int) -> None:
    """Draw the gel cut through its middle, the lights and the camera's field, seen along the other axis."""
    pad, pose = sensor.pad, sensor_pose(sensor)
    first, size = (0.0, pad.length_mm) if along else (-pad.width_mm / 2.0, pad.width_mm)
    place = np.linspace(first, first + size, 101)
    x, z = (np.zeros_like(place), place) if along else (place, np.full_like(place, pad.length_mm / 2.0))
    height = rest_height_mm(sensor.pressed_pad(), x, z)
    axes.fill_between(place, 0.0, height, color=HAIRLINE)
    axes.plot(place, height, color=INK)
    for light in sensor.lights:
        corners = _corners(sensor, light)
        axes.add_patch(
            Polygon(
                corners[:, [along, 1]],
                facecolor=_LIGHT_COLOURS[light.channel],
                edgecolor=_LIGHT_COLOURS[light.channel],
                linewidth=1.8,
            )
        )
    centre = pose.centre_mm[[along, 1]]
    axes.plot(*centre, marker="x", color=INK)
    axes.annotate("camera", (float(centre[0]), float(centre[1])), textcoords="offset points", xytext=(6, -2))
    # the edge of the field in the direction that this cut shows
    for right, down in ((1, 0), (-1, 0)) if not along else ((0, 1), (0, -1)):
        ray = pose.forward + right * pose.tan_half_width * pose.right + down * pose.tan_half_height * pose.down
        if ray[1] > 0.0:
            end = centre + ray[[along, 1]] * (-centre[1] / ray[1])
            axes.plot(*np.stack([centre, end], axis=-1), color=ORANGE, linewidth=1.0)
    name = "z along" if along else "x across"
    axes.set(
        title=f"cut {'along' if along else 'across'} the pad", xlabel=f"{name} (mm)", ylabel="y (mm)", aspect="equal"
    )
    axes.grid(visible=False)
    axes.margins(0.08)
    axes.autoscale_view()


def _draw_view(axes: Axes, places_mm: Floats) -> None:
    """Draw lines of equal place on the coat in the camera's picture."""
    rows, columns = places_mm.shape[:2]
    seen = np.isfinite(places_mm[..., 0])
    axes.imshow(np.where(seen, 1.0, 0.15), cmap="gray", vmin=0.0, vmax=1.0, extent=(0, columns, rows, 0))
    for k, name, colour in ((0, "x", ORANGE), (1, "z", MUTED)):
        values = places_mm[..., k]
        levels = np.arange(np.ceil(np.nanmin(values) / _GRID_MM) * _GRID_MM, np.nanmax(values), _GRID_MM)
        if levels.size:
            lines = axes.contour(
                np.arange(columns) + 0.5, np.arange(rows) + 0.5, values, levels=levels, colors=colour, linewidths=0.9
            )
            axes.clabel(lines, fmt=f"{name} %g", fontsize=7)
    axes.set(title=f"camera: {100 * seen.mean():.0f} % shows the coat", xlabel="column (px)", ylabel="row (px)")
    axes.grid(visible=False)
