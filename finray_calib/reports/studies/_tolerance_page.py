"""The page of a finger's tolerances as one HTML file; every sentence and number is computed from the record."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from data_schemas import FingerDesign, FingerTolerances, ToleranceRow, ToleranceSide, package_version
from finray_calib.reports import (
    BLUE,
    ENOUGH_Q2,
    INK,
    MUTED,
    NO_VALUE,
    SKY,
    Content,
    KeyNumber,
    Light,
    Part,
    PartLabel,
    ReportPage,
    ReportTable,
    draw_body,
    draw_panel,
    drawing,
    files_table,
    finger_outline,
    is_contradicted,
    label_row,
    legend_above,
    light_of,
    limits_section,
    new_figure,
    one_group,
    percent,
    report_html,
    styled,
    svg_text,
)
from sim.optics import camera_pose
from sim.surface_meshes import mirror_shape

Floats = NDArray[np.float64]

#: What the fields are called on the drawing.
_WORDS: Final = {
    "angle_deg": "angle",
    "azimuth_deg": "turn",
    "aim_deg": "aim",
    "radius_mm": "radius of its bow",
    "thickness_mm": "thickness",
    "yield_rel": "yield",
    "emission_sd": "emission",
}
_AXES: Final = {"x": "across (x)", "y": "into the pad (y)", "z": "along the pad (z)"}
_LABEL_ROW_MM: Final = 17.0
_MARGIN_MM: Final = 20.0
_WIDTH_IN: Final = 9.5
_CONFIDENCE: Final = 0.95


def tolerance_page(found: FingerTolerances, command: str, digests: Mapping[str, str]) -> str:
    """Return the page of a finger's tolerances as self-contained HTML; equal input gives equal text.

    Parameters
    ----------
    found
        The record.
    command
        The command that reproduces it.
    digests
        Name of each input file -> SHA-256.
    """
    return report_html(
        ReportPage(
            verb="finray design tolerances",
            title=f"Tolerances of {found.name}",
            lead=f"How far this finger may vary before the expected error of its sensed normals grows by "
            f"{percent(found.allowed_rel)}.",
            verdict=_verdict(found),
            light=_light(found),
            sentence=found.sentence,
            picture=drawing(
                tolerance_drawing(found),
                "the finger from its side with the limits of its parts",
                f"Distance from the drawn value at which the error has grown by {percent(found.allowed_rel)}, each "
                "number alone. 'over' marks the largest distance that was evaluated.",
            ),
            key_numbers=_key_numbers(found),
            parts=(*_sections(found), limits_section(_limits(found), found.notes)),
            command=command,
            origin=files_table(digests, package_version()),
            summary=found.model_dump(mode="json", exclude={"provenance", "inputs", "losses_rel", "design"}),
        )
    )


def _light(found: FingerTolerances) -> Light:
    """Return how good the given tolerances are; never good by an emulator that is not, or that fingers contradict."""
    is_known = found.q2 >= ENOUGH_Q2 and not is_contradicted(found)
    return light_of(found.within_given_share >= _CONFIDENCE and is_known, is_bad=found.within_given_share < 0.5)


def _verdict(found: FingerTolerances) -> str:
    """Return the conclusion."""
    share, allowed = percent(found.within_given_share), percent(found.allowed_rel)
    told = f"The expected error grows by at most {allowed} in {share} of fingers that vary as given"
    if found.q2 < ENOUGH_Q2:
        return f"{told}, by an emulator that explains {percent(found.q2)} of its variance: give more runs (--runs)"
    return f"{told}; fingers evaluated again contradict it" if is_contradicted(found) else told


def _key_numbers(found: FingerTolerances) -> tuple[KeyNumber, ...]:
    """Return the numbers of the first screen."""
    factor = "more than " if found.together_factor is None else ""
    value = found.box_factor if found.together_factor is None else found.together_factor
    interval = (
        f"95 %: {_bound(found.together_low95, found)} to {_bound(found.together_high95, found)}; "
        if found.together_factor is not None
        else ""
    )
    good = light_of(found.q2 >= ENOUGH_Q2)
    return (
        KeyNumber("All half-ranges times", f"{factor}{value:.2g}", f"{interval}95 % of fingers stay within"),
        KeyNumber(
            "Evaluated again at these limits",
            f"{found.checked_within} of {found.checked_fingers}",
            f"fingers within the allowed growth, with other paths, paint draws and noise (expected: "
            f"{percent(_CONFIDENCE)})",
            light_of(not is_contradicted(found)),
            "fewer than chance explains" if is_contradicted(found) else "as many as chance explains",
        ),
        KeyNumber("The emulator predicts", percent(found.q2), "of the variance of runs left out (Q2)", good,
                  f"{'at least' if good == 'good' else 'less than'} {percent(ENOUGH_Q2)}"),
    )  # fmt: skip


def _bound(value: float | None, found: FingerTolerances) -> str:
    """Return a factor, or that it lies beyond the box."""
    return f"over {found.box_factor:.2g}" if value is None else f"{value:.2g}"


def _sections(found: FingerTolerances) -> tuple[Part, ...]:
    """Return what is found in tables and figures."""
    limits = Content(
        lead="Distances from the drawn value, downwards and upwards, with 95 % intervals by the noise of evaluations.",
        # the first screen shows it small
        picture_rows=(
            (
                drawing(
                    tolerance_drawing(found),
                    "the finger with its limits",
                    "The finger from its side, cut along the middle, with the limits of each part.",
                ),
            ),
        ),
        tables=(_limit_table(found.rows),),
        has_wide_tables=True,
    )
    shares = Content(
        lead=f"Shares of the variance of the error when all numbers vary within {found.box_factor:.2g} times their "
            f"given half-ranges. A share below {percent(max(1.0 - found.q2, 0.0))}, the share that the emulator "
            "does not explain, is not distinguishable from 0: this study cannot show a gain from a tighter "
            "tolerance of that number.",
        picture_rows=((drawing(variance_figure(found), "shares of the variance of each number",
                               "Sobol' indices with 95 % intervals: alone, and with its interactions."),),),
        tables=(_share_table(found.rows),),
    )  # fmt: skip
    return Part("Each number alone", limits), Part("Which numbers matter when all vary", shares)


def limit_text(side: ToleranceSide, unit: str) -> str:
    """Return the limit of one side: a distance, or the largest that was evaluated."""
    unit = "" if unit == "1" else f" {unit}"
    return f"over {side.tried:.3g}{unit}" if side.limit is None else f"{side.limit:.3g}{unit}"


def _with_interval(side: ToleranceSide) -> str:
    """Return a distance with its interval."""
    if side.limit is None:
        return f"over {side.tried:.3g}" + (" (not buildable beyond)" if side.ended_by else "")
    low, high = (NO_VALUE if x is None else f"{x:.3g}" for x in (side.low95, side.high95))
    return f"{side.limit:.3g} [{low}, {high}]"


def _limit_table(rows: Sequence[ToleranceRow]) -> ReportTable:
    """List the limits of each number alone."""
    columns = ("number", "drawn", "may be less by", "may be more by", "given half-range", "which comes from",
               "growth at the limits, evaluated again")  # fmt: skip
    return one_group(
        "Limits of each number alone",
        columns,
        [
            (row.field, f"{row.nominal:.4g}", _with_interval(row.less), _with_interval(row.more),
             f"{row.given:.3g}", row.origin,
             ", ".join(percent(side.checked_loss_rel) for side in (row.less, row.more)
                       if side.checked_loss_rel is not None) or NO_VALUE)
            for row in rows
        ],
    )  # fmt: skip


def _share_table(rows: Sequence[ToleranceRow]) -> ReportTable:
    """List the shares of the variance, the largest first."""
    ordered = sorted(rows, key=lambda row: -row.total.estimate)
    return one_group(
        "Shares of the variance (Sobol' indices)",
        ("number", "alone", "95 %", "with interactions", "95 %", ""),
        [
            (row.field, f"{row.first.estimate:.3f}", f"{row.first.low95:.3f} to {row.first.high95:.3f}",
             f"{row.total.estimate:.3f}", f"{row.total.low95:.3f} to {row.total.high95:.3f}",
             "" if row.is_distinguishable else "not distinguishable from 0")
            for row in ordered
        ],
    )  # fmt: skip


def _limits(found: FingerTolerances) -> tuple[str, ...]:
    """Say what the numbers do not know."""
    own = (
        "Each finger is calibrated as it was built: a limit states how far the built finger may differ from its "
        "drawing, not how far it may change after its calibration."
        if found.calibration == "own"
        else "All fingers take the calibration of the finger as drawn, and have their own picture without contact."
    )
    places = ", ".join(f"{place:.0f}" for place in found.contact_places_mm)
    return (
        f"The error is simulated: {found.objective}. Contacts at {places} mm along the pad.",
        own,
        "Half-ranges marked as assumed have not been measured; give your own with --vary. Shares and the common "
        "factor hold for half-ranges in these proportions.",
        "Numbers vary independently of each other and uniformly within their half-ranges; numbers that are "
        "not listed do not vary, such as the shape of the coat, the camera's response and the noise of its "
        "pixels.",
        f"The random numbers alone make the growth of the error scatter by {100.0 * found.noise_rel:.2g} %. "
        f"Intervals include this and the error of the emulator, but not how far the simulation is from a real finger.",
    )


@styled()
def variance_figure(found: FingerTolerances) -> str:
    """Draw the shares of the variance with their intervals, the largest on top (SVG)."""
    rows = sorted(found.rows, key=lambda row: row.total.estimate)
    figure = new_figure(6.6, 1.1 + 0.3 * len(rows))
    axes = figure.add_subplot()
    places = np.arange(len(rows), dtype=np.float64)
    unexplained = max(1.0 - found.q2, 0.0)
    axes.axvspan(0.0, unexplained, color=SKY, alpha=0.25, label=f"not explained, {percent(unexplained)}")
    for offset, name, marker, colour, label in (
        (0.14, "total", "s", BLUE, "with interactions"),
        (-0.14, "first", "o", INK, "alone"),
    ):
        shares = [getattr(row, name) for row in rows]
        values = np.array([share.estimate for share in shares])
        errors = np.array([[s.estimate - s.low95 for s in shares], [s.high95 - s.estimate for s in shares]])
        axes.errorbar(values, places + offset, xerr=errors, fmt=marker, color=colour, markersize=4.5, label=label)
    axes.set_yticks(places, [row.field for row in rows])
    axes.set(xlabel="share of the variance of the error", xlim=(0.0, 1.0), ylim=(-0.6, len(rows) - 0.4))
    legend_above(figure, axes, 3)
    return svg_text(figure)


@styled()
def tolerance_drawing(found: FingerTolerances) -> str:
    """Draw the finger from its side, cut along the middle, with the limits of its parts (SVG).

    Raises
    ------
    SimulateError
        When the parts of the design do not fit together.
    """
    design = found.design
    finger = finger_outline(design)
    low, high = finger.bounds_mm
    left, right = low[2] - _MARGIN_MM, high[2] + _MARGIN_MM
    inch = (right - left) / _WIDTH_IN
    labels = _labels(found)
    above, below = (_row_mm(labels[side], inch) for side in (True, False))
    bottom, top = low[1] - _LABEL_ROW_MM - below, max(high[1], design.pad.thickness_mm) + _LABEL_ROW_MM + above
    figure = new_figure(_WIDTH_IN, (top - bottom) / inch)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()
    draw_body(axes, finger, rasterized=True)
    _draw_optics(axes, design)
    for side, height in ((True, top - above - 1.0), (False, bottom + below + 1.0)):
        if labels[side]:
            label_row(axes, labels[side], height, inch)
    axes.text(left + 1.0, design.pad.thickness_mm, "base", va="bottom", color=MUTED)
    axes.text(right - 1.0, design.pad.thickness_mm, "tip", ha="right", va="bottom", color=MUTED)
    return svg_text(figure)


def _draw_optics(axes: Axes, design: FingerDesign) -> None:
    """Draw panels with their normals, and the camera's pinhole with its line of sight."""
    for light in design.lights:
        draw_panel(axes, light)
    pose = camera_pose(design)
    sight = pose.centre_mm + 9.0 * pose.forward
    axes.annotate("", (sight[2], sight[1]), (pose.centre_mm[2], pose.centre_mm[1]),
                  arrowprops={"arrowstyle": "->", "color": INK, "lw": 1.2}, zorder=5)  # fmt: skip
    axes.plot(pose.centre_mm[2], pose.centre_mm[1], "s", color=INK, markersize=5.0, zorder=5)


def _row_mm(labels: Sequence[PartLabel], inch_mm: float) -> float:
    """Return the height of a row of labels."""
    return 0.16 * inch_mm * max((label.text.count("\n") + 1 for label in labels), default=0)


def _labels(found: FingerTolerances) -> dict[bool, list[PartLabel]]:
    """Return the labels above (True) and below the finger: one for each part, with the limits of its numbers."""
    design = found.design
    places = _part_places(design)
    lines: dict[str, list[str]] = {}
    for row in found.rows:
        part, _, name = row.field.partition(".")
        if part == "paint":
            part, _, name = row.field.removeprefix("paint.").partition(".")
            part = f"{part} paint"
        lines.setdefault(part, []).append(f"{_name(name)}: {_range(row)}")
    labels: dict[bool, list[PartLabel]] = {True: [], False: []}
    for part, told in lines.items():
        place, is_above = places.get(part, places["pad"])
        labels[is_above].append(PartLabel("\n".join([part.replace("_", " "), *told]), place))
    return labels


def _part_places(design: FingerDesign) -> dict[str, tuple[tuple[float, float], bool]]:
    """Return a place (z, y) on each part, and whether its label stands above."""
    pad, camera, mirror = design.pad, camera_pose(design).centre_mm, mirror_shape(design).apex_yz_mm
    along = {"red paint": 0.35, "pad": 0.55, "green paint": 0.75, "coating": 0.9}
    places = {part: ((share * pad.length_mm, 0.6 * pad.thickness_mm), True) for part, share in along.items()}
    lights = zip(("light", "second_light"), design.lights, strict=False)
    return {
        **places,
        **{part: ((light.position_mm[2], light.position_mm[1]), True) for part, light in lights},
        "camera": ((float(camera[2]), float(camera[1])), False),
        "mirror": ((float(mirror[1]), float(mirror[0])), False),
    }


def _name(field: str) -> str:
    """Return what a number is called on the drawing."""
    within, _, last = field.rpartition(".")
    return _AXES.get(last) or f"{within} {_WORDS.get(last, last)}".lstrip()


def _range(row: ToleranceRow) -> str:
    """Return the limits of a number to both sides."""
    unit = {"1": "", "standard deviations": " sd", "deg": "\N{DEGREE SIGN}"}.get(row.unit, f" {row.unit}")
    less, more = (limit_text(side, "1") for side in (row.less, row.more))
    if less == more:
        both = f"\N{PLUS-MINUS SIGN}{less.removeprefix('over ')}{unit}"
        return f"over {both}" if less.startswith("over ") else both
    return f"\N{MINUS SIGN}{less} / +{more}{unit}"
