"""A classic sensor as its design says: in words with where its numbers come from, and drawn with its camera's view."""

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon, Rectangle
from numpy.typing import NDArray
from pydantic import BaseModel

from data_schemas import ColouredLight, PlainSensor
from finray_calib.reports._style import (
    BLUE,
    GREEN,
    HAIRLINE,
    INK,
    MUTED,
    ORANGE,
    VERMILLION,
    new_figure,
    png_bytes,
    styled,
)
from sim.optics import light_frame, sensor_pose
from sim.surface_meshes import rest_height_mm

Floats = NDArray[np.float64]

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
        f"{sensor.name}: {seen.mean():.0%} of the picture shows the coat",
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
    return f" (standard uncertainty {sensor.uncertainty_rel[field]:.1%})" if field in sensor.uncertainty_rel else ""


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
    figure.suptitle(f"{sensor.name} (mm): x across the pad, y into its gel, z along it")
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
    axes.set(title=f"camera: {seen.mean():.0%} shows the coat", xlabel="column (px)", ylabel="row (px)")
    axes.grid(visible=False)
