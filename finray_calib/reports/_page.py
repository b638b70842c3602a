"""What a page is made of, one design for all: a first screen, then sections, in one self-contained HTML file.

The first screen holds a sentence, a picture and three numbers with their lights; the first cell of a table's row is its
heading. Also the tables on origin: what was compared with what, and the files.
"""

import base64
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Final, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined

from data_schemas import IndenterPose, PatchScale, Provenance, SimulatedPress, TactileCapture
from finray_calib.reports._images import ByteImage, png_data_uri
from finray_calib.reports._plain_text import NO_VALUE, Json, unbroken
from finray_calib.reports._style import ReadableFigure, Reading, svg_data_uri


@dataclass(frozen=True, slots=True)
class Link:
    """Text that leads to a file beside the page."""

    text: str
    file: str


Cell = str | Link


@dataclass(frozen=True, slots=True)
class TableGroup:
    """Rows under a common heading; an empty heading shows none."""

    heading: str
    rows: tuple[tuple[Cell, ...], ...]


@dataclass(frozen=True, slots=True)
class ReportTable:
    """One table: caption, column headings and groups of rows."""

    caption: str
    columns: tuple[str, ...]
    groups: tuple[TableGroup, ...]
    is_words: bool = False


def one_group(
    caption: str, columns: tuple[str, ...], rows: Iterable[tuple[Cell, ...]], is_words: bool = False
) -> ReportTable:
    """Return a table of one group without a heading."""
    return ReportTable(caption, columns, (TableGroup("", tuple(rows)),), is_words)


def provenance_table(origin: Provenance) -> ReportTable:
    """List origin, versions, processor, seed and input hashes; what an older record does not hold is left out."""
    commit = origin.git_commit or "not run from a source tree"
    rows: list[tuple[str, ...]] = [
        ("made (UTC)", origin.created_utc),
        ("finray-calib", origin.package_version),
        ("source commit", f"{commit}, with changes that are not committed" if origin.git_dirty else commit),
        ("Python", origin.python_version),
        ("seed", "none" if origin.seed is None else str(origin.seed)),
    ]
    if origin.packages:
        rows.append(("packages", ", ".join(f"{name} {number}" for name, number in sorted(origin.packages.items()))))
    rows += [(what, said) for what, said in (("processor", origin.processor), ("renderer", origin.renderer)) if said]
    rows += [(f"SHA-256 of {name}", digest) for name, digest in sorted(origin.input_sha256.items())]
    return one_group("Where this report comes from", ("item", "value"), rows, is_words=True)


@dataclass(frozen=True, slots=True)
class Picture:
    """An image inside the page; the alternative text carries its conclusion, the caption says what to see.

    A row whose first picture is small holds three of them on a wide screen. The readings are values under the pointer.
    """

    source: str
    alternative: str
    caption: str
    is_raster: bool = False
    is_small: bool = False
    readings: tuple[Reading, ...] = ()


@dataclass(frozen=True, slots=True)
class PicturePair:
    """Two pictures of one size: side by side, and with scripts one over the other with a slider between them.

    The label says what the slider does, for those who do not see it.
    """

    first: Picture
    second: Picture
    label: str
    is_small: bool = False


@dataclass(frozen=True, slots=True)
class Content:
    """What a section shows: a sentence, rows of pictures, remarks, a list, tables, and parts with their own heading."""

    lead: str = ""
    picture_rows: tuple[tuple[Picture | PicturePair, ...], ...] = ()
    remarks: tuple[str, ...] = ()
    points: tuple[str, ...] = ()
    tables: tuple[ReportTable, ...] = ()
    parts: tuple["Part", ...] = ()
    has_wide_tables: bool = False


@dataclass(frozen=True, slots=True)
class Part:
    """A section, or a part of one; a detail waits in a fold, and a note stands beside the title."""

    title: str
    content: Content
    is_detail: bool = False
    note: str = ""


Light = Literal["good", "care", "bad", ""]
LIGHTS: Final = {"good": ("\u2713", "good"), "care": ("!", "with care"), "bad": ("\u2717", "not good")}
"""Sign and word of each traffic light; the empty one is no judgement."""


@dataclass(frozen=True, slots=True)
class KeyNumber:
    """A number of the first screen: what it is, its value, what stands beside it, its light and why it has that."""

    label: str
    value: str
    remark: str
    light: Light = ""
    reason: str = ""


def light_of(is_good: bool, is_bad: bool = False) -> Light:
    """Return the traffic light of a number: within its limit, clearly outside, or neither."""
    return "good" if is_good else "bad" if is_bad else "care"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportPage:
    """A page: the first screen, the sections in their order, and where all of it comes from.

    Attributes
    ----------
    verb
        The command that makes such pages.
    title, lead
        What the page is about; the lead may be empty.
    verdict, light, sentence
        The conclusion, its traffic light, and one sentence below it, which may be empty.
    picture
        The picture that shows the conclusion, or None.
    key_numbers
        The three numbers to know first.
    parts
        Sections.
    command, origin
        The command that makes the page again (empty: not known) and its files; None where nothing was stored.
    summary
        Every number of the page.
    """

    verb: str
    title: str
    lead: str = ""
    verdict: str
    light: Light = ""
    sentence: str = ""
    picture: Picture | PicturePair | None
    key_numbers: tuple[KeyNumber, ...]
    parts: tuple[Part, ...]
    command: str = ""
    origin: ReportTable | None
    summary: Json


def report_html(page: ReportPage) -> str:
    """Return a page as self-contained HTML; equal input gives equal text."""
    names = [re.sub(r"[^a-z0-9]+", "-", part.title.lower()).strip("-") for part in page.parts]
    anchors = [name if names.index(name) == k and name else f"{name}-{k + 1}" for k, name in enumerate(names)]
    return render_page("report_page.html.j2", page=page, sections=tuple(zip(anchors, page.parts, strict=True)))


def findings_section(findings: Iterable[str]) -> tuple[Part, ...]:
    """Return the section of what was found, in sentences; none where nothing was."""
    points = tuple(findings)
    return (Part("What was found", Content(points=points)),) if points else ()


def limits_section(limits: Iterable[str], notes: Sequence[str] = (), assumed: Sequence[str] = ()) -> Part:
    """Return the section of what the numbers rest on: limits, assumptions, and the notes of the records in a fold."""
    parts = [] if not assumed else [Part("Assumed, not measured", Content(points=tuple(assumed)))]
    if notes:
        parts.append(Part(f"Notes of the records ({len(notes)})", Content(points=tuple(notes)), is_detail=True))
    return Part("How far to trust this", Content(points=tuple(limits), parts=tuple(parts)))


def raster(rgb8: ByteImage, alternative: str, caption: str) -> Picture:
    """Return an (H, W, 3) sRGB image as a picture."""
    return Picture(png_data_uri(rgb8), alternative, caption, is_raster=True, is_small=True)


def figure_png(png: bytes, alternative: str, caption: str, is_small: bool = False) -> Picture:
    """Return a figure that was drawn as PNG as a picture."""
    source = f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
    return Picture(source, alternative, caption, is_small=is_small)


def in_rows(pictures: Sequence[Picture]) -> tuple[tuple[Picture, ...], ...]:
    """Return small pictures in rows of at most three, of about one length: a last one alone would be drawn large."""
    count = -(-len(pictures) // 3)
    ends = [round(k * len(pictures) / max(count, 1)) for k in range(count + 1)]
    return tuple(tuple(pictures[a:b]) for a, b in pairwise(ends))


def drawing(figure: str | ReadableFigure, alternative: str, caption: str, is_small: bool = False) -> Picture:
    """Return SVG text, or a figure with values under the pointer, as a picture."""
    if isinstance(figure, str):
        figure = ReadableFigure(figure, ())
    return Picture(svg_data_uri(figure.svg), alternative, caption, is_small=is_small, readings=figure.readings)


def images_table(press: SimulatedPress, capture: TactileCapture) -> ReportTable:
    """List what was captured and what was rendered, each beside the other."""
    made = press.provenance.created_utc if press.provenance else NO_VALUE
    taken = capture.provenance.created_utc if capture.provenance else NO_VALUE
    rows = [
        ("name", capture.name, press.name),
        ("what", capture.source, press.label),
        ("stored (UTC)", taken, made),
        ("image", _layout(capture), f"{press.contact.shape[1]} x {press.contact.shape[0]} px"),
        ("values", _encoding(capture.encoding), _encoding(press.encoding)),
        ("exposure", _unit(capture.exposure_s, "s"), "fitted, see above" if press.encoding == "linear" else NO_VALUE),
        ("light angle", _with_u(capture.light_angle_deg, capture.light_angle_uncertainty_deg, "deg"),
         _unit(press.light_angle_deg, "deg")),
        ("LED current", _unit(capture.led_current_ma, "mA"), NO_VALUE),
        ("indenter", *_indenter(capture.indenter, press)),
        ("scale, as the capture states it", _scale(capture), NO_VALUE),
        ("finger", NO_VALUE, "no design" if press.design is None else press.design.name),
    ]  # fmt: skip
    rows += [(f"{colour} paint", NO_VALUE, f"SHA-256 {digest}") for colour, digest in sorted(press.paints.items())]
    return one_group("What was compared with what", ("item", "capture", "simulation"), rows, is_words=True)


def files_table(digests: Mapping[str, str], version: str) -> ReportTable:
    """List the files that went in, by content, and the version that read them."""
    rows = [("finray-calib", version), *((f"SHA-256 of {name}", digest) for name, digest in sorted(digests.items()))]
    return one_group("Program and input files", ("item", "value"), rows, is_words=True)


def scale_table(scale: PatchScale) -> ReportTable:
    """List millimetres per raw pixel along x and y at the patch and over patch and pad, and the regions' extents."""
    middle, patch, pad = scale.middle, scale.over_patch, scale.over_pad
    rows = [
        (
            "mm per pixel at the middle of the patch",
            _known(middle.along_x_mm_per_px, middle.along_x_u_rel * middle.along_x_mm_per_px),
            _known(middle.along_y_mm_per_px, middle.along_y_u_rel * middle.along_y_mm_per_px),
        ),
        *(
            (
                f"mm per pixel, range over the {name}",
                f"{over.along_x_low_mm_per_px:.4g} to {over.along_x_high_mm_per_px:.4g}",
                f"{over.along_y_low_mm_per_px:.4g} to {over.along_y_high_mm_per_px:.4g}",
            )
            for name, over in (("patch", patch), ("pad", pad))
        ),
        *(
            (
                f"{extent.region}, extent in mm",
                _known(extent.along_x_mm, extent.along_x_u_mm),
                _known(extent.along_y_mm, extent.along_y_u_mm),
            )
            for extent in scale.extents
        ),
    ]
    columns = ("length", "along x (rows)", "along y (columns)")
    return one_group("Scale of the capture's raw pixels on the pad", columns, rows, is_words=True)


def _known(value: float, u: float) -> str:
    """Return a value with its standard uncertainty, in its unit."""
    return f"{value:.4g} (u = {u:.2g})"


def _scale(capture: TactileCapture) -> str:
    """Return the scale that the capture carries."""
    u = (
        None
        if capture.mm_per_px is None or capture.mm_per_px_u_rel is None
        else (capture.mm_per_px * capture.mm_per_px_u_rel)
    )
    return _with_u(capture.mm_per_px, u, "mm per pixel")


def _layout(capture: TactileCapture) -> str:
    """Return size, layout and depth of a captured image."""
    height, width = capture.contact.shape[:2]
    return (
        f"{width} x {height} px, {capture.layout}, {capture.bit_depth} bit, black level {capture.black_level_dn:g} DN"
    )


def _encoding(encoding: str) -> str:
    """Return what the values mean."""
    return "linear light" if encoding == "linear" else "encoded, curve unknown"


def _unit(value: float | None, unit: str) -> str:
    """Return a value with its unit, or that it is not known."""
    return "not recorded" if value is None else f"{value:.4g} {unit}"


def _with_u(value: float | None, u: float | None, unit: str) -> str:
    """Return a value with its standard uncertainty where that is known."""
    text = _unit(value, unit)
    return text if value is None or u is None else f"{text} (u = {u:.2g} {unit})"


def _indenter(pose: IndenterPose, press: SimulatedPress) -> tuple[str, str]:
    """Return what was pressed, in the capture and in the simulation."""
    parts = [pose.shape if pose.radius_mm is None else f"{pose.shape}, radius {pose.radius_mm:g} mm"]
    if pose.depth_mm is not None:
        parts.append(f"depth {_with_u(pose.depth_mm, pose.depth_uncertainty_mm, 'mm')}")
    if pose.position_mm is not None:
        parts.append(f"at {_with_u(pose.position_mm, pose.position_uncertainty_mm, 'mm')} along the pad")
    if pose.tilt_deg is not None:
        parts.append(f"tilt {_with_u(pose.tilt_deg, pose.tilt_uncertainty_deg, 'deg')}")
    if press.design is None:
        return "; ".join(parts), NO_VALUE
    simulated = press.design.indenter
    return "; ".join(parts), f"{simulated.shape}, depth {simulated.depth_mm:g} mm"


def render_page(template: str, **values: object) -> str:
    """Return a template filled with values; text is escaped, and a missing value is an error.

    Parameters
    ----------
    template
        File name in the folder of templates.
    values
        What the template names.
    """
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> Environment:
    """Return what compiles the templates, and keeps them compiled."""
    environment = Environment(
        loader=PackageLoader("finray_calib.reports", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["unbroken"] = unbroken
    environment.globals["LIGHTS"] = LIGHTS
    return environment
