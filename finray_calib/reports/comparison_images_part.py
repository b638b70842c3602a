"""The part of a comparison's page that shows images: capture, render, what the touch changes in both, and the error."""

import numpy as np

from data_schemas.capture import TactileCapture
from data_schemas.compare import PhotometricErrorReport
from data_schemas.simulate import SimulatedPress
from finray_calib.reports import comparison_words as words
from finray_calib.reports.change_figure import change_figures
from finray_calib.reports.compare_figures import error_map_figure, score_figure
from finray_calib.reports.comparison_images import TouchChanges, TouchPictures, touch_changes, touch_pictures
from finray_calib.reports.demo_results import headline
from finray_calib.reports.images import clipped_remark
from finray_calib.reports.section import Content, Part, Picture, drawing, raster
from finray_calib.reports.statements import simulation_sentence
from finray_calib.reports.touch_images import pad_window
from finray_calib.reports.touch_sections import display_remark

_BLANK = " Blank: not compared (clipped, or not on the pad)."


def images_part(report: PhotometricErrorReport, press: SimulatedPress, capture: TactileCapture) -> Part:
    """Show capture, render, what the touch changes in both, and the error."""
    factors = tuple(region.factor for region in report.regions)
    blank = _BLANK if np.isnan(report.error_map).any() else ""
    pictures = _pictures(report, touch_pictures(press, capture, factors))
    changes = _changes(report, touch_changes(press, capture, factors), blank)
    rows = (pictures, changes, (_error(report, press, blank), _scores(report)))
    return Part("Images", Content(lead=display_remark(press), picture_rows=rows))


def _pictures(report: PhotometricErrorReport, shown: TouchPictures) -> tuple[Picture, ...]:
    """Show the pad as captured and as simulated."""
    return (
        raster(
            shown.captured_untouched,
            "Captured image of the untouched pad.",
            f"Captured, no contact.{clipped_remark(shown.clipped[0])}",
        ),
        raster(
            shown.captured,
            "Captured image of the pressed pad, scored regions outlined.",
            f"Captured, contact. Outlined: the regions that are scored.{clipped_remark(shown.clipped[1])}",
        ),
        raster(
            shown.simulated,
            f"Simulated image of the pressed pad. {simulation_sentence(report)}",
            "Simulated, contact. What to see: inside the outlines it should look like the capture, but for noise.",
        ),
    )


def _changes(report: PhotometricErrorReport, changes: TouchChanges, blank: str) -> tuple[Picture, ...]:
    """Show what the touch changes in capture and render, and what is left over."""
    captured, simulated, left = change_figures(changes)
    return (
        drawing(
            captured,
            "Map of what the touch changes in the capture.",
            f"Change by the touch, captured: bright is brighter than untouched, dark is darker.{blank}",
            is_small=True,
        ),
        drawing(
            simulated,
            "Map of what the touch changes in the simulation.",
            "Change by the touch, simulated, on the same scale. What to see: it should agree with the captured one.",
            is_small=True,
        ),
        drawing(
            left,
            f"Map of simulated minus captured change. {words.verdict_meaning(report)}",
            "Simulated minus captured, on the same scale. What to see: it should be even.",
            is_small=True,
        ),
    )


def _error(report: PhotometricErrorReport, press: SimulatedPress, blank: str) -> Picture:
    """Show where the simulation is wrong."""
    typical, large = (float(np.nanpercentile(np.abs(report.error_map), p)) for p in (50, 95))
    return drawing(
        error_map_figure(report, press.distance <= headline(report).factor, pad_window(press)),
        words.error_alternative(report, typical, large),
        "Error of the simulation, RMS over the channels, relative to the untouched level; outlined: the region of the "
        "headline score. What to see: bright spots are where the simulation is wrong; the noise of both images is part "
        f"of it.{blank}",
    )


def _scores(report: PhotometricErrorReport) -> Picture:
    """Return the figure of the skill."""
    return drawing(
        score_figure(report),
        simulation_sentence(report),
        "Skill by region, with 95 % intervals. What to see: the nearer the circle is to 1, the less is left to gain; "
        "the diamond is a repeated capture, with its noise; at 0 the simulation is worth as much as an image of "
        "the untouched pad.",
    )
