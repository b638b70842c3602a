"""Figures of a decision on the light: objective over its angle, how it is mounted, powers and places. SVG text."""

from collections.abc import Sequence
from itertools import cycle
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.patches import Arc, Polygon, Rectangle, Wedge
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from data_schemas import (
    ColouredLight,
    FingerDesign,
    LightAngleDecision,
    LightAngleSweep,
    LightPlaceMap,
    LightPowers,
    SimulateError,
)
from finray_calib.reports._finger_views import FingerOutline, draw_body, draw_panel, finger_outline
from finray_calib.reports._plain_text import interval_words
from finray_calib.reports._style import (
    BLUE,
    CHANNELS,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    SKY,
    VERMILLION,
    ReadableFigure,
    legend_above,
    new_figure,
    readable,
    styled,
    svg_text,
)
from sim.optics import PanelFrame, light_frame, panel_frame

Floats = NDArray[np.float64]


def on_curve_scale(sweep: LightAngleSweep, decision: LightAngleDecision) -> Floats:
    """Return the (angle, repeat) values of a sweep on the scale of the curve of the renders alone.

    Each repeat is divided by its mean over the angles (a common scale cannot change the ranking) and multiplied
    by the mean of the curve over the same angles.
    """
    curve = np.interp(sweep.angles_deg, decision.grid_deg, decision.mean_simulation_only)
    return np.asarray(sweep.values / sweep.values.mean(axis=0) * curve.mean())


def true_value(true_sweeps: Sequence[LightAngleSweep]) -> Floats:
    """Return the value of each angle (A,): mean over places of the brightness over its greatest there."""
    curves = [(sweep.values / sweep.values.mean(axis=0)).mean(axis=1) for sweep in true_sweeps]
    return np.asarray(np.mean([curve / curve.max() for curve in curves], axis=0))


@styled()
def angle_figure(
    decision: LightAngleDecision, sweep: LightAngleSweep, true_sweeps: Sequence[LightAngleSweep] = ()
) -> ReadableFigure:
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
    if len(decision.contacts) < 2:  # the renders of one of several touches lie on no curve of this figure
        values = on_curve_scale(sweep, decision) / best
        for repeat in range(values.shape[1]):
            label = "renders" if repeat == 0 else None
            axes.plot(sweep.angles_deg, values[:, repeat], "o", color=INK, markersize=3.2, alpha=0.7, label=label)
    if true_sweeps:
        truth = true_value(true_sweeps)
        if len(decision.contacts) < 2:
            truth = on_curve_scale(true_sweeps[0], decision).mean(axis=1)
        angles = true_sweeps[0].angles_deg
        axes.plot(angles, truth / best, "--D", color=VERMILLION, linewidth=1.3, markersize=3.5, label="truth")
    _mark_captures(axes, decision, best)
    _mark_decision(axes, decision)
    axes.set(xlabel="angle of the blue light (deg)", ylabel="objective relative to its best (1)")
    axes.set_xlim(float(grid[0]), float(grid[-1]))
    axes.xaxis.set_major_locator(MultipleLocator(10 if np.ptp(grid) <= 130 else 30))
    legend_above(figure, axes, 3)
    return readable(figure, axes, angle_readings(decision))


def angle_readings(decision: LightAngleDecision) -> dict[float, str]:
    """Return the objective in words by angle (deg): the curve and the widest band that the figure shows."""
    middle = decision.mean if decision.validated else decision.mean_simulation_only
    low, high, source = decision.low95_simulation_only, decision.high95_simulation_only, "the renders alone"
    if decision.discrepancy_rel is not None:
        low, high = decision.low95, decision.high95
        source = "with captures" if decision.validated else "with the assumed error"
    best = float(decision.mean.max())
    return {
        float(angle): f"{angle:g} deg: {interval_words(value / best, least / best, most / best)} of the best "
        f"(95 %, {source})"
        for angle, value, least, most in zip(decision.grid_deg, middle, low, high, strict=True)
    }


def _mark_captures(axes: Axes, decision: LightAngleDecision, best: float) -> None:
    """Draw captures with twice the standard uncertainties of value and angle."""
    if not decision.captures or len(decision.contacts) > 1:  # a capture is of one place, this curve of all of them
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


_LOOKS: tuple[tuple[str, str, str], ...] = (
    (VERMILLION, "--", "^"),
    (GREEN, "-.", "s"),
    (ORANGE, ":", "D"),
    (SKY, "-", "v"),
    (INK, ":", "P"),
)


@styled()
def other_objectives_figure(decision: LightAngleDecision, sweep: LightAngleSweep) -> str:
    """Draw every objective relative to its best rendered angle: 1 is best for each of them."""
    figure = new_figure(5.8, 4.1)
    axes = figure.subplots()
    decided = sweep.values
    if len(decision.contacts) > 1:  # the value over all touches, at the angles of the sweep
        decided = np.interp(sweep.angles_deg, decision.grid_deg, decision.mean)[:, None]
    others = [(o.name, o.utility) for o in sweep.other_objectives]
    if decision.aim == "normal":  # what was decided on stands among them; the brightness is that of this touch
        others = [(o.name, o.utility) for o in sweep.other_objectives if o.place_values is None]
        others.insert(0, ("brightness", sweep.values))
    lines = [("decided on", (BLUE, "-", "o"), decided)]
    lines += [(name, look, utility) for (name, utility), look in zip(others, cycle(_LOOKS), strict=False)]
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


_LOSS_LEVELS: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.4)


@styled()
def contacts_figure(decision: LightAngleDecision) -> str:
    """Draw how much less bright each touch is than at its own best angle, over angle and touch, with contour lines."""
    if decision.contact_value is None:
        raise ValueError("the decision contains no map over angle and touch; decide again on the same sweeps")
    order = np.argsort([contact.position_mm for contact in decision.contacts], kind="stable")
    contacts = [decision.contacts[k] for k in order]
    value = decision.contact_value[order]
    loss, label, top = 1.0 - value, "brightness lost", 0.6
    if decision.aim == "normal":
        loss, label, top = 1.0 / value - 1.0, "error added", 0.3
    figure = new_figure(5.8, 1.6 + 0.22 * len(contacts))
    axes = figure.subplots()
    rows = np.arange(len(contacts))
    places = np.array([contact.position_mm for contact in contacts])
    at = places if (np.diff(places) > 0).all() else rows.astype(np.float64)
    shown = axes.pcolormesh(
        decision.grid_deg, at, loss, cmap="cividis_r", vmin=0.0, vmax=top, shading="gouraud", rasterized=True
    )
    lines = axes.contour(decision.grid_deg, at, loss, levels=_LOSS_LEVELS, colors=INK, linewidths=0.7)
    axes.clabel(lines, fmt=lambda level: f"{100 * level:g} %", fontsize=8)
    axes.plot(
        [contact.best_deg for contact in contacts],
        at,
        "o",
        color=INK,
        markersize=4.5,
        markerfacecolor="white",
        clip_on=False,
    )
    axes.axvline(decision.angle_deg, color=VERMILLION, linewidth=1.8, linestyle="--")
    axes.text(
        decision.angle_deg, 1.01, f"{decision.angle_deg:.0f} deg", transform=axes.get_xaxis_transform(), ha="center",
        va="bottom", weight="bold",
    )  # fmt: skip
    axes.set(xlabel="angle of the blue light (deg)", ylabel="place, from the base (mm)")
    axes.set_yticks(at, [f"{place:g}" for place in places])
    axes.xaxis.set_major_locator(MultipleLocator(10 if np.ptp(decision.grid_deg) <= 130 else 30))
    axes.grid(visible=False)
    bar = figure.colorbar(shown, ax=axes, fraction=0.05, pad=0.02, format=lambda share, _: f"{100 * share:g} %")
    bar.set_label(label)
    return svg_text(figure)


_MARGIN_MM, _LABELS_MM = 6.0, 5.0
_RAY_MM, _ARC_MM = 24.0, 16.0


@styled()
def mounting_figure(decision: LightAngleDecision, design: FingerDesign) -> str:
    """Draw the finger from the side with its light at the decided angle, to scale: along the pad to the right."""
    along, into = design.light.position_mm[2], design.light.position_mm[1]
    pad = design.pad
    finger = _outline(design)
    least, greatest = (
        (np.zeros(2), np.array([pad.thickness_mm, pad.length_mm]))
        if finger is None
        else tuple(bound[1:] for bound in finger.bounds_mm)
    )
    left, right = min(least[1], along - _RAY_MM * (decision.angle_deg > 90)), max(greatest[1], along + _RAY_MM)
    low, high = min(least[0], into - _LABELS_MM), max(pad.thickness_mm, greatest[0], into + _RAY_MM) + _LABELS_MM
    left, right, low = left - _MARGIN_MM, right + _MARGIN_MM, low - _MARGIN_MM
    figure = new_figure(5.8, 5.8 * (high - low) / (right - left))
    figure.set_layout_engine("none")  # to the edges: there are no labels to make room for
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(left, right), ylim=(low, high), aspect="equal")
    axes.set_axis_off()
    if finger is None:
        axes.add_patch(Rectangle((0.0, 0.0), pad.length_mm, pad.thickness_mm, facecolor=SKY, alpha=0.3))
    else:
        draw_body(axes, finger, rasterized=True)
    touched = [contact.position_mm for contact in decision.contacts]
    axes.plot(touched, np.full(len(touched), pad.thickness_mm + 1.6), "v", color=VERMILLION, markersize=5.0)
    axes.text(pad.length_mm, pad.thickness_mm / 2, " tip", ha="left", va="bottom", weight="bold")
    axes.text(0.0, pad.thickness_mm / 2, "base ", ha="right", va="bottom", weight="bold")
    axes.text(0.7 * pad.length_mm, pad.thickness_mm / 2, "gel pad", ha="center", va="center")
    axes.plot([along, along + 1.7 * _RAY_MM], [into, into], color=INK, linewidth=0.9, linestyle="--")
    axes.text(along + 1.75 * _RAY_MM, into, "0 deg", va="center", backgroundcolor="white")
    axes.plot([along, along], [into, into + _RAY_MM], color=INK, linewidth=0.9, linestyle="--")
    axes.text(along, into + _RAY_MM + 0.5, "90 deg", ha="center", va="bottom")
    ranges = decision.statement.equivalent_deg if decision.tolerance_deg is None else (decision.tolerance_deg,)
    for start, end in () if decision.at_range_end else ranges:
        axes.add_patch(
            Wedge((along, into), _RAY_MM, start, end, facecolor="white", alpha=0.8, edgecolor=GREEN, hatch="///")
        )
    _panel(axes, (along, into), decision.angle_deg, design.light.height_mm)
    return svg_text(figure)


def _outline(design: FingerDesign) -> FingerOutline | None:
    """Return the parts of a finger; None where they do not fit together, which a sweep need not know."""
    try:
        return finger_outline(design)
    except SimulateError:
        return None


def _panel(axes: Axes, place_mm: tuple[float, float], angle_deg: float, height_mm: float) -> None:
    """Draw the panel from the side, its normal and the angle between normal and pad."""
    angle = np.radians(angle_deg)
    normal, edge = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)]) * height_mm / 2
    centre = np.array(place_mm)
    ends = np.stack([centre - edge, centre + edge])
    axes.plot(*ends.T, color=BLUE, linewidth=5.0, solid_capstyle="butt")
    axes.text(
        centre[0],
        centre[1] - height_mm / 2 - 1.5,
        "light",
        ha="center",
        va="top",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )
    tip = centre + _RAY_MM * normal
    axes.annotate(
        "", (tip[0], tip[1]), place_mm, arrowprops={"arrowstyle": "-|>", "color": BLUE, "lw": 1.8, "shrinkA": 0}
    )
    axes.add_patch(
        Arc(
            place_mm,
            2 * _ARC_MM,
            2 * _ARC_MM,
            theta1=min(0.0, angle_deg),
            theta2=max(0.0, angle_deg),
            color=INK,
            linewidth=1.2,
        )
    )
    middle = np.radians(angle_deg / 2)
    write = centre + (_ARC_MM + 1.0) * np.array([np.cos(middle), np.sin(middle)])
    axes.text(
        write[0], write[1], f"{angle_deg:.0f} deg", va="center", weight="bold", color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )  # fmt: skip


#: Two fingers of a map differ where their difference is that many standard uncertainties.
_REAL_U: Final = 2.0
_LIT_MARGIN_MM: Final = 9.0
_SIDES: Final = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
_COLOURS: Final = {"red": CHANNELS[0][2], "green": CHANNELS[1][2], "blue": CHANNELS[2][2], "white": "#d9d9d9"}


def _frame_of(record: LightPowers, number: int) -> PanelFrame:
    """Return where a light stands."""
    if record.sensor is not None:
        return light_frame(record.sensor, record.sensor.lights[number])
    return panel_frame((record.design or FingerDesign()).lights[number])


@styled()
def lit_pad_figure(record: LightPowers) -> str:
    """Draw the pad from its inner side, now and with the recommended powers (SVG)."""
    now = record.basis.sum(axis=0)
    then = np.array([row.power_rel / row.now_rel for row in record.rows]) @ record.basis
    shown = [_over_mean(one, record.at_rest) for one in (now, then)]
    top = max(1.5, float(np.quantile(np.concatenate(shown), 0.98)))
    figure = new_figure(9.5, 2.2 + 6.6 * _aspect(record))
    drawn = []
    for axes, title, brightness, powers in zip(
        figure.subplots(2, 1, sharex=True), ("now", "recommended"), shown,
        ([row.now_rel for row in record.rows], [row.power_rel for row in record.rows]), strict=True,
    ):  # fmt: skip
        drawn.append(_draw_lit(axes, record, brightness, top))
        _draw_powers(axes, record, powers)
        axes.set_title(title)
    figure.axes[1].set_xlabel("along the pad from its base (mm)")
    figure.colorbar(drawn[0], ax=figure.axes[:2], label="brightness / its mean", shrink=0.8)
    return svg_text(figure)


def _aspect(record: LightPowers) -> float:
    """Return height over width of what one panel of the drawing shows."""
    low, high = _extent_mm(record)
    return float(min((high[0] - low[0]) / (high[1] - low[1]), 1.0))


def _extent_mm(record: LightPowers) -> tuple[Floats, Floats]:
    """Return the corners (x, z) around pad and lights."""
    pad = record.subject.pad
    corners = [_corners_xz(_frame_of(record, k)) for k in range(len(record.rows))]
    corners.append(np.array([[-pad.width_mm / 2.0, 0.0], [pad.width_mm / 2.0, pad.length_mm]]))
    whole = np.concatenate(corners)
    return whole.min(axis=0) - _LIT_MARGIN_MM, whole.max(axis=0) + _LIT_MARGIN_MM


def _corners_xz(frame: PanelFrame) -> Floats:
    """Return the corners (x, z) of a light, (4, 2)."""
    corners = frame.centre_mm + _SIDES[:, :1] * frame.half_across_mm + _SIDES[:, 1:] * frame.half_along_mm
    return np.asarray(corners[:, [0, 2]])


def _over_mean(brightness: Floats, at_rest: int) -> Floats:
    """Return brightness over its mean, each state by itself."""
    states = brightness[:at_rest], brightness[at_rest:]
    return np.concatenate([one / one.mean() for one in states])


def _draw_lit(axes: Axes, record: LightPowers, brightness: Floats, top: float) -> PathCollection:
    """Draw the pad and the brightness of its places, z to the right."""
    pad = record.subject.pad
    axes.add_patch(
        Rectangle((0.0, -pad.width_mm / 2.0), pad.length_mm, pad.width_mm, facecolor="#30363d", edgecolor=MUTED)
    )
    x, z = record.places_mm.T
    style: dict[str, Any] = {"cmap": "inferno", "vmin": 0.0, "vmax": top, "edgecolors": "white", "linewidths": 0.3}
    rest = slice(None, record.at_rest), slice(record.at_rest, None)
    # a finger is touched where it is looked at at rest: beside each other both can be seen
    aside = 0.022 * pad.length_mm if np.array_equal(record.places_mm[rest[0]], record.places_mm[rest[1]]) else 0.0
    axes.scatter(z[rest[1]] + aside, x[rest[1]], c=brightness[rest[1]], marker="^", s=60, **style)
    seen = axes.scatter(z[rest[0]] - aside, x[rest[0]], c=brightness[rest[0]], marker="o", s=75, **style)
    low, high = _extent_mm(record)
    axes.set(aspect="equal", xlim=(low[1], high[1]), ylim=(low[0], high[0]), ylabel="across (mm)")
    axes.grid(visible=False)
    return seen


def _draw_powers(axes: Axes, record: LightPowers, powers: Sequence[float]) -> None:
    """Draw the lights, each with its power."""
    middle = record.subject.pad.length_mm / 2.0
    for number, power in enumerate(powers):
        light, frame = record.subject.lights[number], _frame_of(record, number)
        colour = _COLOURS[light.channel] if isinstance(light, ColouredLight) else BLUE
        axes.add_patch(
            Polygon(_corners_xz(frame)[:, ::-1], facecolor=colour, edgecolor=colour, linewidth=2.0, zorder=4)
        )
        z, x = frame.centre_mm[2], frame.centre_mm[0]
        axes.annotate(
            f"{power:.2g}", (z, x), xytext=(-8 if z < middle else 8, 0), textcoords="offset points", va="center",
            ha="right" if z < middle else "left", color=INK, fontsize=9, fontweight="bold", zorder=6,
            annotation_clip=False,
        )  # fmt: skip


@styled()
def lights_from_the_side(record: LightPowers) -> str:
    """Draw a finger from its side with its lights, their angles and recommended powers (SVG).

    Raises
    ------
    SimulateError
        When the parts of the design do not fit together.
    """
    design = record.design or FingerDesign()
    finger = finger_outline(design)
    low, high = finger.bounds_mm
    figure = new_figure(9.5, 9.5 * (high[1] - low[1] + 20.0) / (high[2] - low[2] + 30.0))
    axes = figure.add_subplot()
    axes.set(xlim=(low[2] - 15.0, high[2] + 15.0), ylim=(low[1] - 10.0, high[1] + 10.0), aspect="equal")
    axes.set_axis_off()
    draw_body(axes, finger, rasterized=True)
    for light, row in zip(design.lights, record.rows, strict=True):
        panel = draw_panel(axes, light)
        below = (panel.centre_mm[2], panel.centre_mm[1] - abs(panel.half_along_mm[1]))
        axes.annotate(
            f"power {row.power_rel:.2g}\n{light.angle_deg:g}\N{DEGREE SIGN}", below,
            xytext=(0, -6), textcoords="offset points", ha="center", va="top", color=INK, fontsize=9, zorder=6,
            bbox={"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )  # fmt: skip
    return svg_text(figure)


def light_map_sentence(found: LightPlaceMap) -> str:
    """Say which finger of a map senses normals best, and which others are not distinguishable from it."""
    error = found.normal_error_deg
    i, j = np.unravel_index(int(np.nanargmin(error)), error.shape)
    alike = (error - error[i, j] <= _REAL_U * found.above_best_u_deg) & np.isfinite(error)
    ranges = []
    for k, (name, values, unit) in enumerate(zip(found.fields, (found.first, found.second), found.units, strict=True)):
        inside = values[alike.any(axis=1 - k)]
        ranges.append(f"{name} from {inside.min():g} to {inside.max():g}" + ("" if unit == "1" else f" {unit}"))
    unbuilt, more = int(np.isnan(error).sum()), int(alike.sum()) - 1
    others = "All others that can be built are distinguishable from it."
    if more > 0:
        who = "other is" if more == 1 else "others are"
        others = f"{more} {who} not distinguishable from it, within {' and '.join(ranges)}."
    return (
        f"Of {error.size} fingers of the map, the one with {found.fields[0]} = {found.first[i]:g} and "
        f"{found.fields[1]} = {found.second[j]:g} senses normals best, with an error of {error[i, j]:.2f} deg. "
        f"{others}" + (f" {unbuilt} cannot be built." if unbuilt else "")
    )


@styled()
def light_map_figure(found: LightPlaceMap) -> str:
    """Draw the error of the normal, the evenness and the brightness over two numbers of a finger (SVG)."""
    figure = new_figure(10.5, 3.6)
    best = np.unravel_index(int(np.nanargmin(found.normal_error_deg)), found.normal_error_deg.shape)
    near = found.normal_error_deg - found.normal_error_deg[best] <= _REAL_U * found.above_best_u_deg
    panels = (
        ("error of the normal (deg)", found.normal_error_deg, "viridis_r"),
        ("evenness", found.evenness_rel, "viridis"),
        ("brightness over the greatest", found.brightness_rel / np.nanmax(found.brightness_rel), "viridis"),
    )
    for axes, (title, values, colours) in zip(figure.subplots(1, 3, sharey=True), panels, strict=True):
        drawn = axes.pcolormesh(found.second, found.first, values, cmap=colours, shading="nearest")
        figure.colorbar(drawn, ax=axes, shrink=0.9)
        i, j = np.nonzero(near)
        axes.plot(found.second[j], found.first[i], ".", color="white", markeredgecolor=INK, markersize=7)
        axes.plot(found.second[best[1]], found.first[best[0]], "*", color="white", markeredgecolor=INK, markersize=15)
        axes.set(title=title, xlabel=_named(found, 1))
        axes.grid(visible=False)
    figure.axes[0].set_ylabel(_named(found, 0))
    return svg_text(figure)


def _named(found: LightPlaceMap, number: int) -> str:
    """Return the name of an axis with its unit."""
    unit = found.units[number]
    return found.fields[number] + ("" if unit == "1" else f" ({unit})")
