"""The sections on simulation and comparison: renders, captures, error map and scores."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.compare import PhotometricErrorReport
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.linear_image import rgb_image
from finray_calib.reports import statements
from finray_calib.reports.compare_figures import error_map_figure, score_figure
from finray_calib.reports.demo_results import DemoResults, headline
from finray_calib.reports.images import ByteImage, clipped_remark
from finray_calib.reports.number_text import decimals_for, fixed, percent, significant
from finray_calib.reports.pressed_finger_figure import pressed_finger_png
from finray_calib.reports.report_tables import error_table
from finray_calib.reports.section import Content, Picture, drawing, figure_png, raster
from finray_calib.reports.touch_images import is_unmixed, pad_window, touch_pair

OUTLINED = "outlined: the region that is scored"


def simulate_section(results: DemoResults) -> Content:
    """Show the two renders."""
    press, sweep = results.press, results.sweep
    angle = "" if press.light_angle_deg is None else f" with the light at {press.light_angle_deg:g} deg"
    untouched, touched = _renders(results)
    pictures = (
        raster(untouched, "Simulated image of the untouched pad.", "Simulated, no contact"),
        raster(
            touched,
            "Simulated image of the pressed pad, with the region of the headline score outlined.",
            f"Simulated, contact; {OUTLINED}. What to see: the touch changes brightness and colour inside the outline.",
        ),
    )
    return Content(
        lead=f"{_push_phrase(results)}The finger, untouched and pressed{angle}: {press.label}. Then the light was "
        f"swept: {sweep.label}.",
        picture_rows=(*_pressed_finger(results), pictures),
        remarks=(display_remark(press),),
    )


def _push_phrase(results: DemoResults) -> str:
    """Say what the press took."""
    mechanics = results.mechanics
    if mechanics is None:
        return ""
    return (
        f"The finger was pressed by {mechanics.label}: {mechanics.force_n[-1, 1]:.2f} N at a push of "
        f"{mechanics.depth_mm[-1]:g} mm, a force that no measurement has confirmed. "
    )


def _pressed_finger(results: DemoResults) -> tuple[tuple[Picture, ...], ...]:
    """Return a row with the pressed finger, where there is one."""
    mechanics, surfaces = results.mechanics, results.surfaces
    if mechanics is None or surfaces is None:
        return ()
    picture = figure_png(
        pressed_finger_png(mechanics, surfaces),
        f"The finger from the side before and after the press: the pad gives way under the indenter and the finger "
        f"bends; the force rises to {mechanics.force_n[-1, 1]:.2f} N.",
        "The whole finger from the side, to scale, and its force. What to see: the dent in the pad, and how the fins "
        "bend around the indenter.",
    )
    return ((picture,),)


def _renders(results: DemoResults) -> tuple[ByteImage, ByteImage]:
    """Return both renders for the screen."""
    press = results.press
    return touch_pair(press, press.no_contact, press.contact, _scored(results))


def _scored(results: DemoResults) -> NDArray[np.bool_]:
    """Return the mask of the region of the headline score."""
    return results.press.distance <= headline(results.report).factor


def display_remark(press: SimulatedPress) -> str:
    """Say what was done to the images for the screen."""
    cut = "Images are cut to the pad"
    if is_unmixed(press):
        return (
            f"{cut} and unmixed into red emission (shown red), green emission (green) and LED light (blue), each "
            "balanced for the screen on the untouched pad; the numbers use the camera's linear values."
        )
    if press.encoding == "linear":
        return (
            f"{cut}; each channel is balanced for the screen on the untouched pad. The numbers use the camera's linear "
            "values."
        )
    return f"{cut}; they hold encoded values, which are only scaled for the screen."


def compare_section(results: DemoResults) -> Content:
    """Show capture, render, error map and scores."""
    report, capture = results.report, results.capture
    lead = (
        f"The render was compared with the capture \u201c{capture.name}\u201d {grid_phrase(report)}, "
        f"{_exposure_phrase(results)}. Beside it stand two candidates that need no simulation: leaving the image "
        "unchanged (do nothing), and repeating the capture (floor)."
    )
    if results.mechanics is not None:
        lead += " Both have the shape that finite elements gave: the score says nothing of the mechanics."
    remarks = [display_remark(results.press), f"Values: {report.values}. SSIM settings: {report.ssim_settings}."]
    if results.report_level_a is not None:
        remarks.insert(0, statements.level_a_sentence(report, results.report_level_a))
    return Content(
        lead=lead,
        picture_rows=(_strip(results), _drawings(results)),
        remarks=tuple(remarks),
        tables=(error_table(report, results.report_level_a),),
    )


def _strip(results: DemoResults) -> tuple[Picture, ...]:
    """Return the captured images beside the render."""
    capture = results.capture
    before, after = (rgb_image(image, capture) for image in (capture.no_contact, capture.contact))
    window = pad_window(results.press)
    remarks = [clipped_remark(np.isnan(image[window])) for image in (before, after)]
    untouched, touched = touch_pair(results.press, before, after, _scored(results))
    return (
        raster(untouched, "Captured image of the untouched pad.", f"Captured, no contact.{remarks[0]}"),
        raster(
            touched,
            "Captured image of the pressed pad, with the scored region outlined.",
            f"Captured, contact; {OUTLINED}.{remarks[1]}",
        ),
        raster(
            _renders(results)[1],
            f"Simulated image of the pressed pad. {statements.simulation_sentence(results.report)}",
            "Simulated, contact. What to see: inside the outline it should look like the capture, but for noise.",
        ),
    )


def _drawings(results: DemoResults) -> tuple[Picture, ...]:
    """Return error map and scores."""
    report = results.report
    blank = "; blank: clipped in the capture" if np.isnan(report.error_map).any() else ""
    return (
        drawing(
            error_map_figure(report, _scored(results), pad_window(results.press)),
            _error_alternative(report),
            "Difference of simulation and capture, RMS over the channels, relative to the mean untouched level; "
            f"{OUTLINED}{blank}. What to see: bright spots are where the simulation is wrong.",
        ),
        drawing(
            score_figure(report),
            statements.simulation_sentence(report),
            "Skill by region, with 95 % intervals. What to see: the nearer the circle is to 1, the less is left to "
            "gain; the diamond is a repeated capture, with its noise.",
        ),
    )


def grid_phrase(report: PhotometricErrorReport) -> str:
    """Say over which pixels or blocks images were compared."""
    if report.block_px == 1:
        return "pixel by pixel"
    return f"over blocks of {report.block_px} x {report.block_px} px, which average out render noise"


def _exposure_phrase(results: DemoResults) -> str:
    """Say whether the render was scaled, and by what."""
    factor, sd = results.report.exposure_factor, results.report.exposure_factor_sd
    if factor is None:
        return "without any scaling"
    unit = "DN per unit of panel radiance" if results.press.method == "rendered" else "DN per unit of the prediction"
    if sd is None or sd <= 0:
        return f"after one exposure factor for all channels, {significant(factor)} {unit}"
    places = decimals_for(sd)
    return f"after one exposure factor for all channels, {fixed(factor, places)} \u00b1 {fixed(sd, places)} {unit}"


def _error_alternative(report: PhotometricErrorReport) -> str:
    """Say in words what the error map shows."""
    error = np.abs(report.error_map)
    typical, large = np.nanmedian(error), np.nanpercentile(error, 95)
    places = "pixels" if report.block_px == 1 else "blocks"
    return (
        f"Map of the error: half of the {places} err by less than {percent(float(typical))}, one in twenty by more "
        f"than {percent(float(large))}."
    )
