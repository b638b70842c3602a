"""Gather what the stages of a demo stored, and write its summary and its report."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, TactileCapture
from data_schemas.compare import PhotometricErrorReport
from data_schemas.decide import LightAngleDecision
from data_schemas.errors import CaptureError
from data_schemas.fit import PaintCalibration
from data_schemas.folder_manifest import MANIFEST_NAME, manifest_text
from data_schemas.press_mechanics import PressMechanics
from data_schemas.product_set import ProductSet
from data_schemas.provenance import provenance
from data_schemas.radiometry import BandSignals
from data_schemas.simulate import LightAngleSweep, SimulatedPress
from data_schemas.storage import read_record
from data_schemas.surfaces import FingerSurfaces
from finray_calib.demo.demo_folder import LOGS, REPORT_PAGE, SUMMARY
from finray_calib.demo.stages import (
    CAPTURE,
    DECISION,
    MECHANICS,
    PRESS,
    REPORT,
    SURFACES,
    SWEEP,
    TRUE_SWEEP,
    Demo,
    demo_of,
)
from finray_calib.reports.demo_report import demo_report
from finray_calib.reports.demo_results import COLOURS, Colour, DemoResults, PaintResult
from finray_calib.reports.fitted_paint import PaintTruth
from finray_calib.reports.images import to_display
from finray_calib.reports.summary import summary
from rigs.capture.read_session import read_frame_of, read_session
from rigs.simulated.scene import lay_out
from rigs.simulated.sensor import bayer_planes

PREVIEW_STEP = 2
WHITE_PATCH = 19  # of the ColorChecker


def write_report(settings: Mapping[str, Any], seconds: Mapping[str, float]) -> dict[str, str]:
    """Write summary and report of a demo whose stages are all stored; return the verdict and its sentence.

    Parameters
    ----------
    settings
        As :func:`finray_calib.demo.stages.settings_json` returns them.
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
    return {"verdict": results.decision.verdict, "sentence": results.decision.sentence}


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
        true_sweep=read_record(demo.path(TRUE_SWEEP), LightAngleSweep),
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
            kind="hidden paper-family paint" if material is None else f"measured material {material.name}",
        ),
        room_light_rgb8=_room_light_preview(demo.path(colour) / "session", colour, session),
    )


def _room_light_preview(folder: Path, colour: Colour, session: CaptureSession) -> NDArray[np.uint8]:
    """Return the room-light frame as a small picture, balanced so that the ColorChecker's white patch is white."""
    frame = next((f for f in session.frames if f.frame_type == "room light"), None)
    if frame is None:
        raise CaptureError(f"session of the {colour} paint: holds no room-light frame")
    planes = bayer_planes(read_frame_of(folder, frame)) - session.rig.camera.black_level_dn
    height, width = planes.shape[:2]
    white = planes[lay_out(height, width, seed=0).patch == WHITE_PATCH].mean(axis=0)
    return to_display(planes[::PREVIEW_STEP, ::PREVIEW_STEP], white, linear=True)
