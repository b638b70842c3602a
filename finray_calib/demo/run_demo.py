"""Run the whole way on a simulated rig and write the report."""

import json
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession
from data_schemas.errors import CaptureError, RecordError
from data_schemas.provenance import provenance
from data_schemas.whole_files import write_bytes
from finray_calib.demo.stages import Demo, DemoSettings
from finray_calib.reports.demo_report import demo_report
from finray_calib.reports.demo_results import COLOURS, Colour, DemoResults, PaintResult
from finray_calib.reports.fitted_paint import PaintTruth
from finray_calib.reports.images import to_display
from finray_calib.reports.summary import summary
from rigs.capture.read_session import read_frame_of
from rigs.simulated.scene import lay_out
from rigs.simulated.sensor import bayer_planes
from sim.optics.variants import RendererChoice, open_renderer

Count = Callable[[int, int, str], None]
OpenBar = Callable[[str], AbstractContextManager[Count]]
PREVIEW_STEP = 2
WHITE_PATCH = 19  # of the ColorChecker


@dataclass
class StageTimes:
    """Wall time of each stage (s), added up over its parts, with a progress bar while it runs."""

    open_bar: OpenBar
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def of(self, stage: str) -> Iterator[Count]:
        """Time a block as part of a stage."""
        start = time.monotonic()
        with self.open_bar(stage) as count:
            yield count
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.monotonic() - start


def run_demo(settings: DemoSettings, engine: RendererChoice, open_bar: OpenBar) -> DemoResults:
    """Run capture, radiometry, fit, simulate, compare and decide; write all products, summary and report.

    Parameters
    ----------
    settings
        Where to write and what to run on.
    engine
        Renderer.
    open_bar
        Opens a progress bar for a stage.

    Raises
    ------
    RecordError
        The output folder exists and is not empty.
    """
    if settings.out.exists() and (not settings.out.is_dir() or any(settings.out.iterdir())):
        raise RecordError(f"{settings.out}: exists already and is not empty; choose another --out or move it away")
    demo = Demo(settings, open_renderer(engine))
    times = StageTimes(open_bar)
    paints = {colour: _paint(demo, colour, times) for colour in COLOURS}
    with times.of("simulate") as count:
        mechanics, surfaces = demo.press(count)
        press = demo.simulate(count)
        demo.simulate(count, "a")
        sweep = demo.sweep(count)
        true_sweep = demo.true_sweep(count)
    with times.of("capture") as count:
        capture = demo.twin(count)
    with times.of("compare"):
        report, report_level_a = demo.compare(), demo.compare("a")
    with times.of("decide"):
        decision = demo.decide()
    results = DemoResults(
        paints=paints, mechanics=mechanics, surfaces=surfaces,
        press=press, capture=capture, report=report, sweep=sweep, decision=decision,
        stage_wall_times_s=times.seconds, renderer_note=engine.note, command=settings.command,
        provenance=provenance(settings.command, {}, settings.seed), true_sweep=true_sweep,
        report_level_a=report_level_a,
    )  # fmt: skip
    text = json.dumps(summary(results), indent=1, allow_nan=False, ensure_ascii=False)
    write_bytes(settings.out / "summary.json", (text + "\n").encode())
    write_bytes(settings.out / "report.html", demo_report(results).encode())
    return results


def _paint(demo: Demo, colour: Colour, times: StageTimes) -> PaintResult:
    """Calibrate one paint: capture, radiometry, fit."""
    with times.of("capture") as count:
        session = demo.capture(colour, count)
    with times.of("radiometry"):
        bands = demo.radiometry(colour)
    with times.of("fit"):
        calibration = demo.fit(colour)
    truth, material = demo.truth(colour), demo.settings.materials.get(colour)
    return PaintResult(
        colour=colour,
        session=session,
        bands=bands,
        calibration=calibration,
        truth=PaintTruth(
            emission=truth.emission,
            mode_nm=truth.mode_nm,
            fwhm_nm=truth.fwhm_nm,
            energy_yield=truth.energy_yield,
            kind="hidden paper-family paint" if material is None else f"measured material {material.name}",
        ),
        room_light_rgb8=_room_light_preview(demo, colour, session),
    )


def _room_light_preview(demo: Demo, colour: Colour, session: CaptureSession) -> NDArray[np.uint8]:
    """Return the room-light frame as a small picture, balanced so that the ColorChecker's white patch is white."""
    frame = next((f for f in session.frames if f.frame_type == "room light"), None)
    if frame is None:
        raise CaptureError(f"session of the {colour} paint: holds no room-light frame")
    planes = bayer_planes(read_frame_of(demo.path(colour) / "session", frame)) - session.rig.camera.black_level_dn
    height, width = planes.shape[:2]
    white = planes[lay_out(height, width, seed=0).patch == WHITE_PATCH].mean(axis=0)
    return to_display(planes[::PREVIEW_STEP, ::PREVIEW_STEP], white, linear=True)
