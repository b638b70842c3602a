"""What a section of the report is made of."""

import base64
from dataclasses import dataclass

from finray_calib.reports.images import ByteImage, png_data_uri
from finray_calib.reports.report_tables import ReportTable
from finray_calib.reports.style import svg_data_uri


@dataclass(frozen=True, slots=True)
class Picture:
    """An image inside the page; the alternative text carries its conclusion, the caption says what to see.

    A row whose first picture is small holds three of them on a wide screen.
    """

    source: str
    alternative: str
    caption: str
    is_raster: bool = False
    is_small: bool = False


@dataclass(frozen=True, slots=True)
class Content:
    """What a section shows: a sentence, rows of pictures, remarks, tables, and parts with a heading of their own."""

    lead: str
    picture_rows: tuple[tuple[Picture, ...], ...] = ()
    remarks: tuple[str, ...] = ()
    tables: tuple[ReportTable, ...] = ()
    parts: tuple["Part", ...] = ()
    has_wide_tables: bool = False


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a section; a detail waits in a fold."""

    title: str
    content: Content
    is_detail: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    """One stage of the report."""

    stage: str
    wall_time: str
    content: Content


def raster(rgb8: ByteImage, alternative: str, caption: str) -> Picture:
    """Return an (H, W, 3) sRGB image as a picture."""
    return Picture(png_data_uri(rgb8), alternative, caption, is_raster=True, is_small=True)


def figure_png(png: bytes, alternative: str, caption: str) -> Picture:
    """Return a figure that was drawn as PNG as a picture."""
    source = f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"
    return Picture(source, alternative, caption)


def drawing(svg: str, alternative: str, caption: str, is_small: bool = False) -> Picture:
    """Return SVG text as a picture."""
    return Picture(svg_data_uri(svg), alternative, caption, is_small=is_small)
