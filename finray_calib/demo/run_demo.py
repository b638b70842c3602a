"""Run the whole way on a simulated rig: each stage in a process of its own, from where an earlier run was stopped."""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from data_schemas.child_process import Child
from data_schemas.errors import DiedError
from finray_calib.demo.demo_folder import LOGS, Product, Stage, held, note_time, noted_times, whole_stages
from finray_calib.demo.stages import CAPTURE, COLOURS, DECISION, MECHANICS, PRESS, REPORT, SURFACES, SWEEP, TRUE_SWEEP

Count = Callable[[int, int, str], None]
OpenBar = Callable[[str], AbstractContextManager[Count]]
Say = Callable[[str], None]

RUN_STAGE = "finray_calib.demo.stages:run_stage"
PAINTS = tuple(f"{colour}/paint.json" for colour in COLOURS)
# what a process loads while the stage before it computes
IMPORTS: Mapping[str, tuple[str, ...]] = {
    "paints": (
        "finray_calib.demo.stages",
        "rigs.capture.paint_session",
        "rigs.presets",
        "finray_calib.radiometry.band_signals",
        "finray_calib.fit.paint_calibration",
    ),
    "press": ("finray_calib.demo.stages", "sim.mechanics.press", "sim.experiments.mechanical_press"),
    "renders": (
        "finray_calib.demo.stages",
        "mitsuba",
        "sim.experiments.press",
        "sim.experiments.light_angle",
        "sim.experiments.digital_twin",
        "rigs.simulated.bench_truth",
    ),
    "verdict": (
        "finray_calib.demo.stored_results",
        "finray_calib.compare.comparison_record",
        "finray_calib.decide.decision_record",
    ),
}


def _paint_stages(colour: str) -> tuple[Stage, ...]:
    """Return the stages of one paint."""
    session, bands = f"{colour}/session/session.json", f"{colour}/bands.json"
    products = (
        Product(session, "data_schemas.capture:CaptureSession", is_session=True),
        Product(bands, "data_schemas.radiometry:BandSignals", (session,)),
        Product(f"{colour}/paint.json", "data_schemas.fit:PaintCalibration", (bands,)),
    )
    return tuple(
        _stage(kind, f"the {kind} of the {colour} paint", kind, "paints", product, colour=colour)
        for kind, product in zip(("capture", "radiometry", "fit"), products, strict=True)
    )


def _stage(kind: str, words: str, what: str, process: str, *products: Product, **arguments: Any) -> Stage:
    """Return a stage that is a method of the demo."""
    return Stage(kind, words, RUN_STAGE, {"what": what, "arguments": arguments}, products, process)


def _product(file: str, record_type: str, *inputs: str) -> Product:
    return Product(file, f"data_schemas.{record_type}", inputs)


STAGES: tuple[Stage, ...] = (
    *(stage for colour in COLOURS for stage in _paint_stages(colour)),
    _stage(
        "simulate", "the press by finite elements", "press", "press",
        _product(MECHANICS, "press_mechanics:PressMechanics"), _product(SURFACES, "surfaces:FingerSurfaces"),
    ),
    _stage(
        "simulate", "the render of the press", "simulate", "renders",
        _product(PRESS["b"], "simulate:SimulatedPress", SURFACES, *PAINTS),
    ),
    _stage(
        "simulate", "the render with the paper's emitter", "simulate", "renders",
        _product(PRESS["a"], "simulate:SimulatedPress", SURFACES, *PAINTS), level="a",
    ),
    _stage(
        "simulate", "the sweep of the light angle", "sweep", "renders",
        _product(SWEEP, "simulate:LightAngleSweep", SURFACES, *PAINTS),
    ),
    _stage(
        "simulate", "the sweep of the true finger", "true_sweep", "renders",
        _product(TRUE_SWEEP, "simulate:LightAngleSweep", SURFACES),
    ),
    _stage(
        "capture", "the capture of the digital twin", "twin", "renders",
        _product(CAPTURE, "capture:TactileCapture", SURFACES),
    ),
    *(
        _stage(
            "compare", f"the comparison of {what} with the capture", "compare", "verdict",
            _product(REPORT[level], "compare:PhotometricErrorReport", PRESS[level], CAPTURE), level=level,
        )
        for level, what in (("b", "the render"), ("a", "the paper's emitter"))
    ),
    _stage(
        "decide", "the decision on the light angle", "decide", "verdict",
        _product(DECISION, "decide:LightAngleDecision", SWEEP, REPORT["b"]),
    ),
)  # fmt: skip
REPORT_STAGE = Stage("", "the report", "finray_calib.demo.stored_results:write_report", {}, (), "verdict")


def run_demo(
    settings: Mapping[str, Any],
    open_bar: OpenBar,
    say: Say,
    stages: Sequence[Stage] = STAGES,
    report: Stage = REPORT_STAGE,
) -> dict[str, Any]:
    """Run capture, radiometry, fit, simulate, compare and decide; write all products, summary and report.

    A folder that holds an interrupted demo with the same settings is gone on with: what is whole there, as records and
    checksums prove, is not computed again.

    Parameters
    ----------
    settings
        As :func:`finray_calib.demo.stages.settings_json` returns them.
    open_bar
        Opens a progress bar for a stage.
    say
        Tells the user where the demo goes on.
    stages, report
        What to run.

    Returns
    -------
    dict
        What the report says: verdict, sentence; and `seconds`, the wall time of all stages.

    Raises
    ------
    RecordError
        The folder holds something else, a finished demo or one with other settings, or a product was changed.
    DiedError
        The process of a stage died; the message names the stage, its log and what to do.
    FinrayError
        What a stage refuses.
    """
    out = Path(settings["out"])
    with held(out, settings), contextlib.ExitStack() as stack:
        whole = whole_stages(out, stages)
        if whole:
            say(f"{out}: goes on after {len(whole)} of {len(stages)} stages, which are whole")
        left = [stage for number, stage in enumerate(stages) if number not in whole]
        processes = _Processes(stack)
        for stage, following in zip(left, [*left[1:], report], strict=True):
            start = time.monotonic()
            with open_bar(stage.kind) as count:
                processes.run(stage, {"settings": settings, **stage.arguments}, out, count, following)
            note_time(out, stage, time.monotonic() - start)
        seconds = noted_times(out, stages)
        said = processes.run(report, {"settings": settings, "seconds": seconds}, out, None, None)
    return {**said, "seconds": sum(seconds.values())}


class _Processes:
    """The processes of the stages: the next one starts, and loads its packages, while the present one computes."""

    def __init__(self, stack: contextlib.ExitStack) -> None:
        self._stack = stack
        self._children: dict[str, Child] = {}

    def _of(self, stage: Stage) -> Child:
        """Return the process of a stage."""
        if stage.process not in self._children:
            child = Child(IMPORTS.get(stage.process, ()))
            self._children[stage.process] = self._stack.enter_context(child)
        return self._children[stage.process]

    def run(
        self, stage: Stage, arguments: Mapping[str, Any], out: Path, count: Count | None, following: Stage | None
    ) -> Any:
        """Run a stage, with its log in the folder of logs, which stays only where something was written."""
        child, log = self._of(stage), out / LOGS / f"{stage.words.replace(' ', '-')}.log"
        if following is not None:
            self._of(following)
        log.parent.mkdir(exist_ok=True)
        try:
            said = child.call(
                stage.function, arguments, log=log, hear=None if count is None else lambda message: count(*message)
            )
        except DiedError as died:
            raise DiedError(
                f"{stage.words} {died}. Its log is {log}. What is finished is kept: the same command goes on there; "
                "if that fails again, 'finray doctor' tells what this machine lacks"
            ) from None
        if following is None or following.process != stage.process:
            child.end()
        with contextlib.suppress(OSError):
            if log.stat().st_size == 0:
                log.unlink()
            log.parent.rmdir()
        return said
