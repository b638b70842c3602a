"""The demo's report: one HTML page with everything inside, the verdict first, readable without scripts.

What the stages stored is gathered, and shown in six sections: one sentence, figures with their conclusion, tables.
"""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BandSignals,
    CaptureError,
    CaptureSession,
    FingerSurfaces,
    LightAngleDecision,
    LightAngleSweep,
    PaintCalibration,
    PhotometricErrorReport,
    PressMechanics,
    SimulatedPress,
    TactileCapture,
    bayer_planes,
    provenance,
)
from data_schemas.storage import MANIFEST_NAME, ProductSet, manifest_text, read_record
from finray_calib.demo._results import (
    COLOURS,
    STAGES,
    Colour,
    DemoResults,
    PaintResult,
    all_notes,
    assumptions,
    summary,
    trust_limits,
    truth_statement,
)
from finray_calib.demo._stages import (
    CAPTURE,
    DECISION,
    LOGS,
    MECHANICS,
    OTHER_TRUE_SWEEPS,
    PRESS,
    REPORT,
    REPORT_PAGE,
    SUMMARY,
    SURFACES,
    SWEEP,
    TRUE_SWEEP,
    Demo,
    demo_of,
)
from finray_calib.reports import (
    ByteImage,
    Content,
    KeyNumber,
    PaintTruth,
    Part,
    Picture,
    PicturePair,
    ReportPage,
    ReportTable,
    angle_figure,
    capture_sentence,
    clipped_remark,
    comparison_methods,
    decimals_for,
    decision_methods,
    decision_numbers,
    decision_table,
    display_remark,
    drawing,
    duration,
    emission_figure,
    error_map_figure,
    error_table,
    figure_png,
    fit_methods,
    fit_parts,
    fixed,
    grid_phrase,
    headline,
    level_a_sentence,
    limits_section,
    methods_part,
    mounting_picture,
    one_group,
    pad_window,
    paint_sentence,
    percent,
    places_part,
    pressed_finger_png,
    provenance_table,
    raster,
    report_html,
    score_figure,
    signals_table,
    significant,
    simulation_sentence,
    skill_number,
    to_display,
    touch_pair,
    verdict_light,
    verdict_sentence,
    verdict_words,
)
from finray_calib.sensing import rgb_image
from rigs.capture import read_frame_of, read_session
from rigs.simulated import bench_scene


def demo_report(results: DemoResults) -> str:
    """Return the report of one run as a self-contained HTML page.

    Parameters
    ----------
    results
        The six stages of one run.

    Returns
    -------
    str
        HTML text; equal input gives equal text.
    """
    decision = results.decision
    untouched, touched, _ = _strip(results)
    return report_html(
        ReportPage(
            verb="finray demo",
            title="From a painted sample to a light angle",
            lead="Two fluorescent paints were calibrated, the finger was simulated with them, the simulation was "
            "compared with a capture, and an angle for the blue light was chosen.",
            verdict=verdict_sentence(decision),
            light=verdict_light(decision),
            picture=PicturePair(untouched, touched, "Slide between the captured images without and with contact"),
            key_numbers=_key_numbers(results),
            parts=(
                Part("What was found", _seen(results)),
                limits_section(trust_limits(results), all_notes(results), assumptions(results)),
                *sections(results),
                methods_part(_methods(results), results.provenance),
            ),
            origin=provenance_table(results.provenance),
            command=results.command,
            summary=summary(results),
        )
    )


def _methods(results: DemoResults) -> tuple[str, ...]:
    """Return the methods of all stages."""
    paints = (fit_methods(results.paints[colour].fitted) for colour in COLOURS)
    return (
        *(text for paint in paints for text in paint),
        *comparison_methods(results.report),
        *decision_methods(results.decision, results.sweep),
    )


def _key_numbers(results: DemoResults) -> tuple[KeyNumber, ...]:
    """Return whether the angle is decided, what may be lost, and how good the simulation is."""
    decided, *_, most = decision_numbers(results.decision)
    return (decided, *([most] if most != decided else []), skill_number(results.report))


def _seen(results: DemoResults) -> Content:
    """Show the finger with its light and both spectra, and say what was found."""
    spectra = tuple(
        drawing(
            emission_figure(results.paints[colour].fitted),
            paint_sentence(results.paints[colour].fitted),
            f"Emission of the {colour} paint, as fitted, with its 95 % band.",
        )
        for colour in COLOURS
    )
    return Content(
        "The light on the finger, and what the paints emit.",
        picture_rows=((mounting_picture(results.decision, results.sweep),), spectra),
        points=_findings(results),
    )


def _findings(results: DemoResults) -> tuple[str, ...]:
    """Return the sentences below the verdict: simulation, each paint, and the truth where it is known."""
    truth = truth_statement(results)
    paints = [paint_sentence(results.paints[colour].fitted) for colour in COLOURS]
    return (simulation_sentence(results.report), *paints, *([] if truth is None else [truth]))


def sections(results: DemoResults) -> tuple[Part, ...]:
    """Return the six stages of a run in order, with their figures and tables."""
    makers = (_capture, _radiometry, _fit, simulate_section, compare_section, _decide)
    return tuple(
        Part(stage.capitalize(), make(results), note=duration(results.stage_wall_times_s[stage]))
        for stage, make in zip(STAGES, makers, strict=True)
    )


def _capture(results: DemoResults) -> Content:
    """Show what the rig saw."""
    rig = results.paints["red"].session.rig
    pictures = tuple(
        raster(
            paint.room_light_rgb8,
            f"The {paint.colour} paint sample under room light, as the camera of the rig saw it.",
            f"\u201c{paint.calibration.paint_name}\u201d under room light, as the camera sees it (preview)",
        )
        for paint in (results.paints[colour] for colour in COLOURS)
    )
    return Content(
        lead=f"Each paint was photographed raw through {len(rig.filter_wheel.filters)} band-pass filters, under the "
        f"{rig.laser.wavelength_nm:g} nm laser and under the white lamp, with dark frames and a white reference.",
        picture_rows=(pictures,),
        tables=(capture_table(results),),
    )


def _radiometry(results: DemoResults) -> Content:
    """Show the band signals."""
    paints = [results.paints[colour] for colour in COLOURS]
    pixels = " and ".join(f"{paint.bands.region_pixels}" for paint in paints)
    return Content(
        lead=f"The frames became one value per filter and channel over the painted regions ({pixels} pixels): "
        "dark-subtracted, per second of exposure, relative to the white reference, with their full covariance.",
        remarks=tuple(
            f"{paint.colour.capitalize()} paint: {int((~paint.bands.usable()).sum())} of {paint.bands.usable().size} "
            "values are flagged and not used by the fit."
            for paint in paints
        ),
        tables=tuple(signals_table(paint.fitted) for paint in paints),
    )


def _fit(results: DemoResults) -> Content:
    """Show the fits of both paints of a run."""
    paints = [results.paints[colour].fitted for colour in COLOURS]
    return Content(
        lead="The emission spectrum of each paint was inferred from its band signals. Several families of curves were "
        "fitted, each with a smooth random deviation (discrepancy) by which a real paint may differ from its family, "
        "with "
        "the reflected laser and the imperfections of the filters as further unknowns.",
        parts=fit_parts(paints),
    )


def _decide(results: DemoResults) -> Content:
    """Show the objective over the angle."""
    decision, sweep = results.decision, results.sweep
    picture = drawing(
        angle_figure(decision, sweep, results.true_sweeps),
        f"The objective, plotted against the light angle; the best angle is near {decision.angle_deg:.0f} deg. "
        f"{decision.sentence}",
        "Objective over the angle of the blue light: 0 deg along the pad, 90 deg straight into it. What to see: where "
        "the curve is flat the angle matters little"
        + ("; hatched angles are as good as the chosen one." if decision.statement.equivalent_deg else "."),
    )
    touched = (
        f" The finger was touched at {len(decision.contacts)} places: at one by finite elements, at the others by a "
        "formula."
        if len(decision.contacts) > 1
        else ""
    )
    return Content(
        lead=f"Objective: {decision.objective}. It was rendered at {len(sweep.angles_deg)} angles with "
        f"{sweep.values.shape[1]} repeats that share their random draws; random curves through them give the "
        f"probability of each angle.{touched}",
        picture_rows=((picture,),),
        remarks=(decision.sentence.removeprefix(decision.headline).strip(), capture_sentence(decision)),
        tables=(decision_table(decision),),
        parts=(places_part(decision),) if len(decision.contacts) > 1 else (),
    )


def capture_table(results: DemoResults) -> ReportTable:
    """List what was captured of each paint, one column for each."""
    sessions = [results.paints[colour].session for colour in COLOURS]
    kinds = [Counter(frame.frame_type for frame in session.frames) for session in sessions]
    exposures = [[frame.exposure_s for frame in session.frames] for session in sessions]
    saturated = [max((frame.saturated_fraction for frame in session.frames), default=0.0) for session in sessions]
    rows: list[tuple[str, ...]] = [
        ("paint", *(session.plan.paint_name for session in sessions)),
        ("rig", *(session.rig.name for session in sessions)),
        ("frames", *(str(len(session.frames)) for session in sessions)),
        ("of which", *(", ".join(f"{n} {kind}" for kind, n in sorted(count.items())) for count in kinds)),
        ("exposures", *(_range(times, "s") for times in exposures)),
        ("saturated", *("none" if share == 0 else f"up to {percent(share)} of a region" for share in saturated)),
    ]
    columns = ("session", *(f"{colour} paint" for colour in COLOURS))
    return one_group("Frames of the two paint sessions", columns, rows, is_words=True)


def _range(values: list[float], unit: str) -> str:
    """Return the smallest and largest value."""
    if not values:
        return "none"
    return f"{significant(min(values), 2)} to {significant(max(values), 2)} {unit}"


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
        f"The finger was pressed by {mechanics.label}, with a force of {mechanics.force_n[-1, 1]:.2f} N at a push of "
        f"{mechanics.depth_mm[-1]:g} mm. No measurement has confirmed this force. "
    )


def _pressed_finger(results: DemoResults) -> tuple[tuple[Picture, ...], ...]:
    """Return a row with the pressed finger, where there is one."""
    mechanics, surfaces = results.mechanics, results.surfaces
    if mechanics is None or surfaces is None:
        return ()
    picture = figure_png(
        pressed_finger_png(mechanics, surfaces),
        "The finger from the side before and after the press: the indenter dents the pad and the finger "
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


def compare_section(results: DemoResults) -> Content:
    """Show capture, render, error map and scores."""
    report, capture = results.report, results.capture
    lead = (
        f"The render was compared with the capture \u201c{capture.name}\u201d {grid_phrase(report)}, "
        f"{_exposure_phrase(results)}. Beside it stand two candidates that need no simulation: leaving the image "
        "unchanged (do nothing), and repeating the capture (floor)."
    )
    if results.mechanics is not None:
        lead += " Both have the shape that finite elements gave, so the score does not test the mechanics."
    remarks = [display_remark(results.press), f"Values: {report.values}. SSIM settings: {report.ssim_settings}."]
    if results.report_level_a is not None:
        remarks.insert(0, level_a_sentence(report, results.report_level_a))
    return Content(
        lead=lead,
        picture_rows=((_touched(results),), _drawings(results)),
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
            f"Simulated image of the pressed pad. {simulation_sentence(results.report)}",
            "Simulated, contact. What to see: inside the outline it should look like the capture, except for noise.",
        ),
    )


def _touched(results: DemoResults) -> PicturePair:
    """Return the touch as captured and as simulated."""
    _, captured, simulated = _strip(results)
    return PicturePair(captured, simulated, "Slide between the captured and the simulated touch")


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
            simulation_sentence(report),
            "Skill by region, with 95 % intervals. What to see: the nearer the circle is to 1, the less can still be "
            "improved; the diamond is a repeated capture.",
        ),
    )


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
        f"Map of the error: half of the {places} are wrong by less than {percent(float(typical))}, one in twenty by "
        f"more "
        f"than {percent(float(large))}."
    )


PREVIEW_STEP = 2
WHITE_PATCH = 19  # of the ColorChecker


def write_report(settings: Mapping[str, Any], seconds: Mapping[str, float]) -> dict[str, str]:
    """Write summary and report of a demo whose stages are all stored; return its first sentence, and how sure that is.

    Parameters
    ----------
    settings
        As :func:`finray_calib.demo.settings_json` returns them.
    seconds
        Wall time of each of the six stages.
    """
    demo = demo_of(settings)
    results = stored_results(demo, seconds)
    text = json.dumps(summary(results), indent=1, allow_nan=False, ensure_ascii=False)
    with ProductSet(demo.path(REPORT_PAGE)) as products:
        products.add(demo.path(SUMMARY), (text + "\n").encode())
        products.add(demo.path(REPORT_PAGE), demo_report(results).encode())
        out = demo.settings.out
        products.add(out / MANIFEST_NAME, manifest_text(out, products.added_below(out), (LOGS,)))
    decision = results.decision
    return {"verdict": verdict_sentence(decision), "certainty": verdict_words(decision)}


def stored_results(demo: Demo, seconds: Mapping[str, float]) -> DemoResults:
    """Read back everything that the stages stored."""
    settings = demo.settings
    return DemoResults(
        paints={colour: _paint(demo, colour) for colour in COLOURS},
        mechanics=read_record(demo.path(MECHANICS), PressMechanics),
        surfaces=read_record(demo.path(SURFACES), FingerSurfaces),
        press=read_record(demo.path(PRESS["b"]), SimulatedPress),
        capture=read_record(demo.path(CAPTURE), TactileCapture),
        report=read_record(demo.path(REPORT["b"]), PhotometricErrorReport),
        sweep=read_record(demo.path(SWEEP), LightAngleSweep),
        decision=read_record(demo.path(DECISION), LightAngleDecision),
        stage_wall_times_s=dict(seconds),
        renderer_note=demo.engine.note,
        command=settings.command,
        provenance=provenance(settings.command, {}, settings.seed),
        true_sweeps=tuple(read_record(demo.path(name), LightAngleSweep) for name in (TRUE_SWEEP, *OTHER_TRUE_SWEEPS)),
        report_level_a=read_record(demo.path(REPORT["a"]), PhotometricErrorReport),
    )


def _paint(demo: Demo, colour: Colour) -> PaintResult:
    """Return one paint from capture to fit, beside the truth."""
    session = read_session(demo.path(f"{colour}/session"))
    truth, material = demo.truth(colour), demo.settings.materials.get(colour)
    return PaintResult(
        colour=colour,
        session=session,
        bands=read_record(demo.path(f"{colour}/bands.json"), BandSignals),
        calibration=read_record(demo.path(f"{colour}/paint.json"), PaintCalibration),
        truth=PaintTruth(
            emission=truth.emission,
            mode_nm=truth.mode_nm,
            fwhm_nm=truth.fwhm_nm,
            energy_yield=truth.energy_yield,
            kind="simulated paint of the paper's family" if material is None else f"measured material {material.name}",
        ),
        room_light_rgb8=_room_light_preview(demo.path(colour) / "session", colour, session),
    )


def _room_light_preview(folder: Path, colour: Colour, session: CaptureSession) -> NDArray[np.uint8]:
    """Return the room-light frame as a small picture, balanced so that the ColorChecker's white patch is white."""
    frame = next((f for f in session.frames if f.frame_type == "room light"), None)
    if frame is None:
        raise CaptureError(f"the session of the {colour} paint has no room-light frame")
    planes = bayer_planes(read_frame_of(folder, frame)) - session.rig.camera.black_level_dn
    height, width = planes.shape[:2]
    white = planes[bench_scene(height, width, seed=0).patch == WHITE_PATCH].mean(axis=0)
    return to_display(planes[::PREVIEW_STEP, ::PREVIEW_STEP], white, linear=True)
