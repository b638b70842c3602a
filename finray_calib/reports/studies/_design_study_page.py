"""The page of a design study, and its table as text: pictures of all points, numbers with intervals, what matters."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import t as student_t

from data_schemas import DesignValue, StudyMetric, StudyPoint, StudyResult, StudyRow
from finray_calib.reports import (
    BLUE,
    CHANNELS,
    HAIRLINE,
    INK,
    MUTED,
    NO_VALUE,
    ByteImage,
    Content,
    KeyNumber,
    Light,
    Part,
    Picture,
    ReportPage,
    ReportTable,
    aligned_lines,
    drawing,
    files_table,
    findings_section,
    interval_text,
    light_of,
    limits_section,
    lit_window,
    methods_part,
    new_figure,
    one_group,
    png_bytes,
    raster,
    report_html,
    study_methods,
    styled,
    svg_text,
    to_display,
)

MOST_PICTURES = 60
"""Points whose pictures the page shows; the records hold all."""

_LARGEST_SIDE_PX, _WEBP_QUALITY = 200, 85
_DOTS_PER_INCH, TALLEST_WEBP_PX = 120, 16383
_PANELS_IN_A_ROW, _PICTURES_IN_A_ROW, _MOST_IN_A_ROW = 2, 4, 6
_WHITE_PERCENTILE = 97.0  # of what is lit: brighter are the base and, at some angles, the panel itself
_CHANGE_SHOWN_REL, _DARK_REL, _CHANGE_BLUR_PX = 0.5, 0.02, 1.0
"""Change of light that is shown as black or white, what is added to dark pixels as a share of white, and the standard
deviation over which both pictures are smoothed before their change is taken, because their noise hides it."""
_UNITS: Mapping[str, str] = {"_mm": "mm", "_deg": "deg", "_nm": "nm", "_mpa": "MPa"}
_VIEWS = ("without contact", "with contact", "what the touch changes")
_SHOWN = ("vividness", "variation_rel", "touch_rel", "brightness_rel", "force_n", "seen_area_mm2")
"""Metrics with a panel of their own, and the order in which a sentence is made of them."""

_SHARES = tuple((f"{name}_share", marker, colour) for name, marker, colour in CHANNELS)
"""Metrics of one panel, the share of the coat where each light leads, with their markers and colours."""
_IN_CAPTIONS: Mapping[str, str] = {
    "variation_rel": "standard deviation / mean of the light",
    "vividness": "vividness",
    "touch_rel": "change by the touch",
    "force_n": "force in N",
}
"""Metrics below a picture, in words."""
_TITLES: Mapping[str, str] = {
    **_IN_CAPTIONS,
    "brightness_rel": "brightness / the panel's radiance",
    "seen_area_mm2": "visible area in mm\u00b2",
}
_MOST_NAMED_POINTS, _LONGEST_POINT_NAME = 12, 22

_BEST: Mapping[str, tuple[str, bool]] = {
    "vividness": ("The colours are most vivid", True),
    "variation_rel": ("the light is most even", False),
    "touch_rel": ("the touch changes the picture most", True),
    "force_n": ("the force is lowest", False),
}


def design_study_page(
    result: StudyResult, points: Sequence[StudyPoint], command: str, digests: Mapping[str, str], version: str
) -> str:
    """Return the page of a design study (HTML).

    Parameters
    ----------
    result
        The table of the study.
    points
        Its points with their images, in the same order.
    command
        That made it.
    digests
        Input file -> SHA-256.
    version
        Of the package.
    """
    computed, failed = len(result.points), len(result.failures)
    lost = f"failed: {failed}" if failed else "none failed"
    notes = tuple(dict.fromkeys(note for point in points for note in point.notes))
    return report_html(
        ReportPage(
            verb="finray study run",
            title=result.name,
            lead=result.about or f"What changes: {', '.join(result.varied)}.",
            verdict=f"{computed} of {computed + failed} points computed",
            light=light_of(not failed),
            sentence=_sentence(result),
            picture=_curves_picture(result),
            key_numbers=(
                KeyNumber("Computed", str(computed), f"of {computed + failed} points", light_of(not failed), lost),
                *list(_key_numbers(result))[:2],
            ),
            parts=(
                *findings_section(
                    (
                        *(f"Point {f.number} ({_words(f.changes)}) failed: {f.reason}" for f in result.failures),
                        *_mixed_code(result),
                    )
                ),
                limits_section(_limits(result), notes),
                *_sections(result, points),
                methods_part(study_methods(result), result.provenance),
            ),
            command=command,
            origin=files_table(digests, version),
            summary=result.model_dump(mode="json", exclude={"provenance"}),
        )
    )


_IMAGE_LIMITS = (
    "Intervals (95 %) of what images show come from independent renders of each point, and from halves of each "
    "render: they include the noise of the renders, and leave out assumed materials, dimensions and camera response, "
    "which all points share.",
    "All points share their random numbers, so the difference of two points is more certain than each of them.",
    "Vividness treats the camera's channels as sRGB, exposed and white-balanced on the coat itself; it ranks "
    "fingers with one camera and is not an absolute measure of colour.",
)
_FORCE_LIMITS = (
    "Forces are those of a finite-element model of assumed dimensions; no finger of this project has been measured. "
    "Their limits show the uncertainty that comes from the mesh, which mostly changes all points in the same way.",
)
_NO_FORCE_LIMITS = (
    "No mechanics: the pad takes the shape of what is pressed in at once, with a bulge around it; there is no force, "
    "and neither finger nor object bends.",
)


def _limits(result: StudyResult) -> tuple[str, ...]:
    """Return what the numbers of a study do not know."""
    names = _metric_names(result)
    of_images = _IMAGE_LIMITS if "vividness" in names else ()
    return (*of_images, *(_FORCE_LIMITS if "force_n" in names else _NO_FORCE_LIMITS))


def points_by_code(result: StudyResult) -> dict[str, str]:
    """Return version and commit of the code -> the numbers of the points that it computed, such as "1 to 3, 7"."""
    of_code: dict[str, list[list[int]]] = {}
    for row in result.points:
        runs = of_code.setdefault(row.computed_by or "unknown code", [[]])
        if runs[-1] and row.number == runs[-1][-1] + 1:
            runs[-1].append(row.number)
        else:
            runs.append([row.number])
    return {
        code: ", ".join(f"{run[0]} to {run[-1]}" if len(run) > 1 else str(run[0]) for run in runs if run)
        for code, runs in of_code.items()
    }


def _mixed_code(result: StudyResult) -> Iterator[str]:
    """Yield which points were computed by which code, where it was not the same for all."""
    of_code = points_by_code(result)
    if len(of_code) > 1:
        told = "; ".join(f"{numbers} by {code}" for code, numbers in of_code.items())
        yield (
            "The points were computed by different code, so that their differences may be those of the code: "
            f"{told}. 'finray study run' with --renew computes the older ones again."
        )


def study_text(result: StudyResult) -> str:
    """Return the table of a study as aligned text: one line a point."""
    names = _metric_names(result)
    return "\n".join(aligned_lines(("point", *result.varied, *names), _all_cells(result, names)))


@dataclass(frozen=True, slots=True)
class MetricDifference:
    """A metric at the same point of two studies.

    Attributes
    ----------
    changes
        What the point changes, in both studies.
    name, unit
        Of the metric.
    first, second
        Its values.
    difference, low95, high95
        Second less first, with limits as of two independent studies; None where a study gives no limits.
    is_apart
        Whether 0 lies outside limits that are so wide that they hold for all compared numbers together (Bonferroni);
        None without limits.
    """

    changes: Mapping[str, DesignValue]
    name: str
    unit: str
    first: float
    second: float
    difference: float
    low95: float | None
    high95: float | None
    is_apart: bool | None


def study_differences(first: StudyResult, second: StudyResult) -> list[MetricDifference]:
    r"""Return the metrics of all points that two studies have in common, and what they differ by.

    .. math:: d = b - a, \quad [d - \sqrt{(b - b_-)^2 + (a_+ - a)^2},\; d + \sqrt{(b_+ - b)^2 + (a - a_-)^2}]

    Parameters
    ----------
    first, second
        The studies; points are the same where they change the same fields to the same values.
    """
    others = {tuple(sorted(row.changes.items())): row for row in second.points}
    pairs = [
        (row, one, two)
        for row in first.points
        if (like := others.get(tuple(sorted(row.changes.items())))) is not None
        for one in row.metrics
        if (two := _found(like, one.name)) is not None
    ]
    # limits of three renders, whose halves leave five degrees of freedom, and a difference ten
    factor = float(student_t.ppf(1.0 - 0.025 / max(len(pairs), 1), 10) / student_t.ppf(0.975, 5))
    factor = max(factor, 1.0)
    return [_difference(row.changes, one, two, factor) for row, one, two in pairs]


def _difference(
    changes: Mapping[str, DesignValue], one: StudyMetric, two: StudyMetric, factor: float
) -> MetricDifference:
    """Return what a metric differs by, apart where limits that are wider by a factor leave 0 out."""
    gap, below, above = two.value - one.value, None, None
    if one.low95 is not None and one.high95 is not None and two.low95 is not None and two.high95 is not None:
        below = float(np.hypot(two.value - two.low95, one.high95 - one.value))
        above = float(np.hypot(two.high95 - two.value, one.value - one.low95))
    return MetricDifference(
        changes, one.name, one.unit, one.value, two.value, gap,
        None if below is None else gap - below,
        None if above is None else gap + above,
        None if below is None or above is None else gap > factor * below or -gap > factor * above,
    )  # fmt: skip


def study_differences_text(differences: Sequence[MetricDifference]) -> str:
    """Return differences as aligned text: one line for each number, points under their changes."""
    lines, at = [], None
    widths = [max(len(cell(d)) for d in differences) for cell in (lambda d: d.name, _ends)]
    for d in differences:
        if d.changes != at:
            at = d.changes
            lines.append(f"{_words(at)}:")
        lines.append(f"  {d.name.ljust(widths[0])}  {_ends(d).ljust(widths[1])}  {_judged(d)}".rstrip())
    return "\n".join(lines)


def _ends(d: MetricDifference) -> str:
    """Return both values of a number."""
    return f"{d.first:.4g} -> {d.second:.4g}{'' if d.unit == '1' else f' {d.unit}'}"


def _judged(d: MetricDifference) -> str:
    """Return a difference with its limits, and whether it is one."""
    if d.low95 is None or d.high95 is None:
        return f"{d.difference:+.3g}, without limits" if d.difference else "the same"
    told = interval_text(d.difference, d.low95, d.high95)
    return f"{told}{', differs' if d.is_apart else ', no difference shown'}"


def _sentence(result: StudyResult) -> str:
    """Say where each metric is best, and whether the next one is really worse."""
    parts = []
    for name, (words, is_high) in _BEST.items():
        rows = [(metric, row) for row in result.points if (metric := _found(row, name)) is not None]
        if len(rows) < 2:
            continue
        rows.sort(key=lambda pair: pair[0].value, reverse=is_high)
        (best, where), (second, _) = rows[0], rows[1]
        sure = "" if _apart(best, second) else ", not distinguishable from the next"
        sure = ", as at other points" if best.value == second.value else sure
        parts.append(f"{words} at {_spoken(where.changes)} ({_value(best)}{sure})")
    told = "; ".join(parts)
    return f"{told[:1].upper()}{told[1:]}." if parts else "One point was computed."


def _apart(one: StudyMetric, other: StudyMetric) -> bool:
    """Return whether two intervals do not overlap."""
    if one.low95 is None or one.high95 is None or other.low95 is None or other.high95 is None:
        return True
    return one.low95 > other.high95 or one.high95 < other.low95


def _key_numbers(result: StudyResult) -> Iterator[KeyNumber]:
    """Yield the range of the metrics that stand beside the verdict, and whether it is more than their intervals."""
    for name in dict.fromkeys((*_SHOWN, *_metric_names(result))):
        metrics = sorted((m for row in result.points if (m := _found(row, name)) is not None), key=lambda m: m.value)
        if metrics:
            low, high = metrics[0], metrics[-1]
            unit = "" if low.unit == "1" else f" {low.unit}"
            ends = list(dict.fromkeys((f"{low.value:.3g}", f"{high.value:.3g}")))
            yield KeyNumber(name, f"{' to '.join(ends)}{unit}", low.meaning, *_changed(metrics))


def _changed(ordered: Sequence[StudyMetric]) -> tuple[Light, str]:
    """Return the light of a metric by whether its points differ, in ascending order.

    The lowest and the highest are the extremes of all points, so the interval of each is widened until all hold
    together with 95 % (Bonferroni).
    """
    lowest, highest = ordered[0], ordered[-1]
    if lowest.value == highest.value:
        return "", "the same at all points"
    if lowest.high95 is None or highest.low95 is None:
        return "", "computed without an interval"
    factor = float(student_t.ppf(1.0 - 0.025 / len(ordered), 5) / student_t.ppf(0.975, 5))
    gap = highest.value - lowest.value
    if gap > factor * (lowest.high95 - lowest.value + highest.value - highest.low95):
        return "good", "the points differ by more than their intervals, which hold jointly for all points"
    return "care", "no difference between the points is shown"


def _curves_picture(result: StudyResult) -> Picture:
    """Show each metric at each point."""
    names = _metric_names(result)
    return drawing(
        _curves(result, [name for name in _SHOWN if name in names]),
        f"Each metric at each point of the study. {_sentence(result)}",
        "Each metric over the points, with 95 % limits. What to see: differences that are larger than the limits.",
    )


def _sections(result: StudyResult, points: Sequence[StudyPoint]) -> Iterator[Part]:
    """Yield pictures, curves, what matters, and all numbers."""
    shown = [point for point in points if point.contact is not None and point.no_contact is not None][:MOST_PICTURES]
    if shown:
        yield Part("Pictures", _pictures(shown))
    names = _metric_names(result)
    if len(result.varied) > 1:
        yield Part("What matters", Content(
            "Range of a metric's mean over the values of one field, all other fields averaged.",
            tables=(_effects(result, names),),
        ))  # fmt: skip
    yield Part("All numbers", Content(
        "One row for each point, as in table.csv; 95 % limits in brackets.",
        tables=(_table(result, names), _meanings(result)), has_wide_tables=True,
    ))  # fmt: skip


def study_pictures_webp(points: Sequence[StudyPoint]) -> bytes | None:
    """Return one picture (WebP) of all points: without contact, with it, and what changes; None without images.

    All are cut to what is lit and balanced alike, as on the page. The name of a point is what it changes; below it
    stand its numbers.
    """
    shown = [point for point in points if point.contact is not None and point.no_contact is not None][:MOST_PICTURES]
    if not shown:
        return None
    columns = _pictures_in_a_row(shown)
    rows, views = -(-len(shown) // columns), len(_VIEWS)
    with styled():
        height_in = 5.4 * rows
        figure = new_figure(2.5 * columns, height_in)
        for k, (point, pictures) in enumerate(zip(shown, _all_views(shown), strict=True)):
            row, column = divmod(k, columns)
            for below, image in enumerate(pictures):
                axes = figure.add_subplot(views * rows, columns, (views * row + below) * columns + column + 1)
                axes.imshow(image, interpolation="bicubic")
                axes.set_axis_off()
                if below == views - 1:
                    words = _caption(point).replace("; ", "\n")
                    axes.text(0.0, -0.04, words, fontsize=6, va="top", color=INK, transform=axes.transAxes)
                elif not below:
                    axes.set_title(_names(point), fontsize=8, loc="left", color=INK)
        figure.suptitle(f"From above: {', '.join(_VIEWS)}", fontsize=8, x=0.01, ha="left", color=MUTED)
        png = png_bytes(figure, min(_DOTS_PER_INCH, int(TALLEST_WEBP_PX / height_in)))
    picture = np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR))
    return bytes(cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY])[1])


def _pictures_in_a_row(points: Sequence[StudyPoint]) -> int:
    """Return how many points stand side by side: those of a grid that differ in its last field, if they are few."""
    last = [list(point.changes.values())[-1] for point in points]
    count = len(dict.fromkeys(last))
    is_grid = count < len(last) and last == (last[:count] * len(last))[: len(last)]
    return count if is_grid and 1 < count <= _MOST_IN_A_ROW else min(len(points), _PICTURES_IN_A_ROW)


def _names(point: StudyPoint) -> str:
    """Return what a point changes, a value a line."""
    return "\n".join(_named(point.changes))


def _spoken(changes: Mapping[str, DesignValue]) -> str:
    """Return what a point changes in a line: names by themselves, numbers with their unit."""
    return ", ".join(_named(changes)) or "all"


def _named(changes: Mapping[str, DesignValue]) -> Iterator[str]:
    """Yield each change; a field by its last part where no other has the same."""
    lasts = [field.rsplit(".", 1)[-1] for field in changes]
    for (field, value), last in zip(changes.items(), lasts, strict=True):
        yield _with_unit(last if lasts.count(last) == 1 else field, value)


def _with_unit(name: str, value: DesignValue) -> str:
    """Return a value by itself where it is a name, else as "depth 0.8 mm"."""
    if isinstance(value, str):
        return value
    words, unit = _in_words(name)
    return f"{words} {_short(value)} {unit}".rstrip()


def _in_words(field: str) -> tuple[str, str]:
    """Return the name of a field as words, and its unit: "light angle", "deg"."""
    ending = next((ending for ending in _UNITS if field.endswith(ending)), "")
    return field.removesuffix(ending).replace("_", " ").replace(".", " "), _UNITS.get(ending, "")


def _common_white(points: Sequence[StudyPoint]) -> NDArray[np.float64]:
    """Return the white of all pictures, by what is lit in those without contact."""
    pixels = np.concatenate(
        [image[lit_window([image])].reshape(-1, 3) for p in points if (image := p.no_contact) is not None]
    )
    white = np.percentile(pixels, _WHITE_PERCENTILE, axis=0).astype(np.float64)
    return np.where(white > 0.0, white, max(float(pixels.max()), 1.0))


def _all_views(points: Sequence[StudyPoint]) -> list[list[ByteImage]]:
    """Return the pictures of all points, balanced alike, and those of one size cut alike."""
    white, of_size = _common_white(points), dict[tuple[int, ...], list[NDArray[np.float32]]]()
    for point in points:
        if point.no_contact is not None:
            of_size.setdefault(point.no_contact.shape, []).append(point.no_contact)
    lit = {size: lit_window(images) for size, images in of_size.items()}
    return [_views(p, white, lit[p.no_contact.shape]) for p in points if p.no_contact is not None]


def _small(image: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return an image by blocks, at most about 200 px in size."""
    step = max(1, max(image.shape[:2]) // _LARGEST_SIDE_PX)
    rows, columns = (size // step * step for size in image.shape[:2])
    blocks = image[:rows, :columns].reshape(rows // step, step, columns // step, step, 3)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float64)


def _views(point: StudyPoint, white: NDArray[np.float64], lit: tuple[slice, slice]) -> list[ByteImage]:
    """Return a point's pictures without contact and with it, and what the touch changes: grey is no change."""
    if point.no_contact is None or point.contact is None:
        return []
    before, after = (_small(image[lit]) for image in (point.no_contact, point.contact))
    one, two = (cv2.GaussianBlur(image, (0, 0), _CHANGE_BLUR_PX) for image in (before, after))
    change = (two - one) / (0.5 * (one + two) + _DARK_REL * white) / _CHANGE_SHOWN_REL
    grey = np.rint(127.5 + 127.5 * np.clip(change, -1.0, 1.0)).astype(np.uint8)
    return [to_display(before, white, True), to_display(after, white, True), grey]


def _pictures(points: Sequence[StudyPoint]) -> Content:
    """Show each point without and with contact, all balanced alike."""
    pictures = tuple(
        raster(_stacked(views), f"Point {point.number}, {_words(point.changes)}.",
               f"{point.number}: {_spoken(point.changes)}. {_caption(point)}")
        for point, views in zip(points, _all_views(points), strict=True)
    )  # fmt: skip
    lead = (
        "What the camera sees, cut to what is lit: without contact, with it, and what the touch changes in each "
        f"channel, smoothed (grey: nothing; black and white: {100 * _CHANGE_SHOWN_REL:.0f} % and more; edges light up "
        "where the picture moves because the finger bends). Each channel is balanced for the screen, in the same way "
        "in all pictures. Base of the finger at the left, tip at the right; red paint on one wall, green on the "
        "other, blue light from the base. Below each picture: the share of the coat where each light is the strongest, "
        "and the evenness, the vividness and the change by the touch (the section 'What the metrics are' defines them)."
    )
    return Content(lead, (pictures,))  # one grid, whose pictures are all as wide


def _caption(point: StudyPoint) -> str:
    """Return the numbers of a point in a line."""
    found = {metric.name: metric for metric in point.metrics}
    shares = [found[name].value for name, _, _ in _SHARES if name in found]
    listed = ", ".join(f"{100.0 * share:.0f}" for share in shares)
    parts = [f"Red, green, blue is the strongest on {listed} % of the coat"] if shares else []
    parts += [f"{words} {_value(found[name])}" for name, words in _IN_CAPTIONS.items() if name in found]
    return f"{'; '.join(parts)}."


def _stacked(images: Sequence[ByteImage]) -> ByteImage:
    """Return images of one size as one above the other, with a gap."""
    gap = np.full((4, images[0].shape[1], 3), 255, dtype=np.uint8)
    return np.concatenate([part for image in images for part in (image, gap)][:-1])


def _curves(result: StudyResult, names: Sequence[str]) -> str:
    """Draw each metric over the points, and the shares of the coat that each light leads in one panel."""
    has_shares = all(name in _metric_names(result) for name, _, _ in _SHARES)
    panels = len(names) + has_shares
    columns = min(panels, _PANELS_IN_A_ROW)
    rows = -(-panels // max(columns, 1))
    with styled():
        figure = new_figure(3.3 * max(columns, 1), 2.5 * max(rows, 1))
        for k, name in enumerate(names):
            _panel(figure.add_subplot(rows, columns, k + 1), result, name)
        if has_shares:
            _shares_panel(figure.add_subplot(rows, columns, panels), result)
        return svg_text(figure)


def _panel(axes: Axes, result: StudyResult, name: str) -> None:
    """Draw one metric: over the values of the last field where they are numbers, a line for each of the others."""
    _begin_panel(axes, result, _TITLES.get(name, name))
    last, is_number = result.varied[-1], _is_over_numbers(result)
    lines: dict[str, list[tuple[float, StudyMetric]]] = {}
    for row in result.points:
        metric = _found(row, name)
        if metric is not None:
            others = {f: v for f, v in row.changes.items() if f != last} if is_number else {}
            lines.setdefault(_spoken(others), []).append((_place(result, row), metric))
    for number, (words, found) in enumerate(lines.items()):
        found.sort(key=lambda pair: pair[0])
        shade = (BLUE, INK, MUTED)[number % 3]
        style = ("-", "--", ":", "-.")[number // 3 % 4] if is_number else "none"
        _draw_metrics(axes, found, "o", shade, style, words)
    if len(lines) > 1 and len(lines) <= 6:
        axes.legend(fontsize=6)


def _shares_panel(axes: Axes, result: StudyResult) -> None:
    """Draw which share of the coat each light leads, at each point."""
    _begin_panel(axes, result, "share of the coat where each light is strongest")
    for number, (name, marker, colour) in enumerate(_SHARES):
        aside = 0.0 if _is_over_numbers(result) else 0.15 * (number - 1)
        found = [(_place(result, row) + aside, metric) for row in result.points if (metric := _found(row, name))]
        _draw_metrics(axes, found, marker, colour, "none", name.removesuffix("_share"))
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=6, ncols=3)


def _draw_metrics(
    axes: Axes, found: Sequence[tuple[float, StudyMetric]], marker: str, colour: str, style: str, label: str
) -> None:
    """Draw metrics with their limits at places along the axis."""
    places, values = [pair[0] for pair in found], [pair[1].value for pair in found]
    below = [m.value - (m.value if m.low95 is None else m.low95) for _, m in found]
    above = [(m.value if m.high95 is None else m.high95) - m.value for _, m in found]
    axes.errorbar(places, values, [np.maximum(below, 0.0), np.maximum(above, 0.0)], fmt=marker, ms=3, color=colour,
                  linestyle=style, linewidth=1, label=label)  # fmt: skip


def _begin_panel(axes: Axes, result: StudyResult, title: str) -> None:
    """Set title and horizontal axis: the last field, or the points by what they change where that is short."""
    axes.set_title(title, fontsize=9, loc="left", color=INK)
    axes.grid(axis="y", color=HAIRLINE)
    if _is_over_numbers(result):
        name, unit = _in_words(result.varied[-1])
        axes.set_xlabel(f"{name} in {unit}" if unit else name)
        return
    names = [", ".join(map(_short, row.changes.values())) for row in result.points]
    if len(names) > _MOST_NAMED_POINTS or max(map(len, names)) > _LONGEST_POINT_NAME:
        axes.set_xlabel("point")
        return
    axes.set_xticks([row.number for row in result.points], names, rotation=35, ha="right", rotation_mode="anchor")


def _is_over_numbers(result: StudyResult) -> bool:
    """Return whether the points lie along an axis, that of the last field, at least two on a line."""
    *others, last = result.varied
    lines = {str([row.changes[field] for field in others]) for row in result.points}
    is_line = len(lines) < len(result.points) or len(result.points) == 1
    return is_line and all(isinstance(row.changes[last], int | float) for row in result.points)


def _place(result: StudyResult, row: StudyRow) -> float:
    """Return where a point lies along the axis."""
    value = row.changes[result.varied[-1]]
    return float(value) if _is_over_numbers(result) else float(row.number)


def _effects(result: StudyResult, names: Sequence[str]) -> ReportTable:
    """Return by how much each field moves each metric."""
    rows = []
    for name in names:
        cells = []
        for field in result.varied:
            by_value: dict[DesignValue, list[float]] = {}
            for row in result.points:
                if (metric := _found(row, name)) is not None:
                    by_value.setdefault(row.changes[field], []).append(metric.value)
            means = [float(np.mean(values)) for values in by_value.values()]
            cells.append(f"{max(means) - min(means):.3g}" if len(means) > 1 else NO_VALUE)
        rows.append((name, *cells))
    return one_group("By how much each field changes each metric", ("metric", *result.varied), rows)


def _table(result: StudyResult, names: Sequence[str]) -> ReportTable:
    """Return all numbers."""
    return one_group("All points", ("point", *result.varied, *names), _all_cells(result, names))


def _all_cells(result: StudyResult, names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the cells of each point: its number, what it changes, its metrics."""
    return [(str(row.number), *_change_cells(result, row), *_metric_cells(row, names)) for row in result.points]


def _meanings(result: StudyResult) -> ReportTable:
    """Say what each metric is."""
    seen = {metric.name: metric for row in result.points for metric in row.metrics}
    return one_group("What the metrics are", ("metric", "unit", "meaning"),
                     [(m.name, m.unit, m.meaning) for m in seen.values()], is_words=True)  # fmt: skip


def _metric_names(result: StudyResult) -> list[str]:
    """Return the names of all metrics, in order."""
    return list(dict.fromkeys(metric.name for row in result.points for metric in row.metrics))


def _change_cells(result: StudyResult, row: StudyRow) -> tuple[str, ...]:
    """Return what a point changes, field by field."""
    return tuple(_short(row.changes[field]) for field in result.varied)


def _metric_cells(row: StudyRow, names: Sequence[str]) -> tuple[str, ...]:
    """Return the metrics of a point as text."""
    return tuple(NO_VALUE if (metric := _found(row, name)) is None else _value(metric) for name in names)


def _found(row: StudyRow, name: str) -> StudyMetric | None:
    """Return a metric of a point, or None."""
    return next((metric for metric in row.metrics if metric.name == name), None)


def _value(metric: StudyMetric) -> str:
    """Return a number with its interval."""
    if metric.low95 is None or metric.high95 is None or metric.low95 == metric.high95:
        return f"{metric.value:.4g}"
    return interval_text(metric.value, metric.low95, metric.high95)


def _short(value: DesignValue) -> str:
    """Return a value of a design."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _words(changes: Mapping[str, DesignValue]) -> str:
    """Say what a point changes."""
    return ", ".join(f"{field} {_short(value)}" for field, value in changes.items()) or "all"
