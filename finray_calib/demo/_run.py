"""Run all stages on a simulated rig, each in a process of its own, from where an earlier run was stopped.

To which demo a folder belongs, which stages are complete in it as records and checksums prove, and how an interrupted
demo continues.
"""

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

from data_schemas import ProcessDiedError, Record, RecordError, provenance
from data_schemas.storage import (
    MANIFEST_NAME,
    Child,
    clear_leftovers,
    lock,
    open_regular,
    parse_json,
    read_json,
    read_record,
    read_text,
    sha256_of,
    write_bytes,
)
from finray_calib.demo._stages import (
    CAPTURE,
    COLOURS,
    DECISION,
    LOGS,
    MECHANICS,
    OTHER_SWEEPS,
    OTHER_TRUE_SWEEPS,
    PRESS,
    REPORT,
    REPORT_PAGE,
    SURFACES,
    SWEEP,
    TRUE_SWEEP,
)

SETTINGS, TIMES = "demo.json", "stage-times.jsonl"


@dataclass(frozen=True, slots=True)
class Product:
    """A record that a stage stores.

    Attributes
    ----------
    file
        Its path in the folder of the demo.
    record_type
        "module:class" of the record.
    inputs
        The stored files that it is made from; the record holds their SHA-256.
    is_session
        Whether it belongs to a session, whose checksums cover its frames.
    """

    file: str
    record_type: str
    inputs: tuple[str, ...] = ()
    is_session: bool = False


@dataclass(frozen=True, slots=True)
class Stage:
    """A part of the demo that runs at one go.

    Attributes
    ----------
    kind
        Which of the six stages it belongs to.
    words
        What it is called in a sentence, such as "the fit of the red paint".
    function, arguments
        "module:function" that runs it and stores its products, and what that is given beside the settings.
    products
        What it leaves.
    process
        Stages of one name share a process.
    """

    kind: str
    words: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    products: tuple[Product, ...] = ()
    process: str = ""


def identity(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what must be the same for a demo to continue: version, seed, materials, camera, renderer and its effort.

    Parameters
    ----------
    settings
        As :func:`finray_calib.demo.settings_json` returns them.
    """
    made_now = provenance("")
    files = {**settings["materials"], "sensor": settings["sensor"]}
    return {
        "version": made_now.package_version,
        "source": made_now.git_commit,
        "packages": made_now.packages,
        "seed": settings["seed"],
        "files_sha256": {name: sha256_of(Path(path)) for name, path in files.items() if path is not None},
        "renderer": settings["engine"]["variant"],
        "effort": settings["effort"],
    }


@contextlib.contextmanager
def held(out: Path, settings: Mapping[str, Any]) -> Iterator[None]:
    """Make the folder of a new demo, or take over that of an interrupted one; nobody else writes into it meanwhile.

    Raises
    ------
    RecordError
        The folder holds something else, a finished demo, one with other settings, or one that is running.
    """
    mine = identity(settings)
    clear_leftovers(out)  # of a demo that was killed before its first file had its name
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        write_bytes(out / SETTINGS, (json.dumps(mine, indent=1) + "\n").encode())
    if not (out / SETTINGS).is_file():
        raise RecordError(f"{out}: exists already and is not empty; choose another --out or move it away")
    with open_regular(out / SETTINGS) as file:
        if not _is_free(file):
            raise RecordError(f"{out}: another 'finray demo' is writing into it; wait, or choose another --out")
        if (why := _why_not(out, mine)) is not None:
            raise RecordError(f"{out}: {why}; choose another --out")
        for folder in (out, *(path for path in out.iterdir() if path.is_dir())):
            clear_leftovers(folder)  # what a killed stage was writing
        yield


def can_continue(out: Path, settings: Mapping[str, Any]) -> bool:
    """Return whether the folder holds an interrupted demo with these settings that no other process is running."""
    if not (out / SETTINGS).is_file() or _why_not(out, identity(settings)) is not None:
        return False
    with open_regular(out / SETTINGS) as file:
        return _is_free(file)


def _is_free(file: BinaryIO) -> bool:
    """Lock an open file until it is closed; False where another process has locked it."""
    return lock(file.fileno()) is not False


def _why_not(out: Path, mine: Mapping[str, Any]) -> str | None:
    """Return why a demo cannot go on in a folder of a demo, or None when it can."""
    if (out / REPORT_PAGE).exists():
        return f"already contains a finished demo, whose report is {out / REPORT_PAGE}"
    try:
        theirs = read_json(out / SETTINGS)
    except RecordError as error:
        return f"the settings of its demo cannot be read ({error})"
    if not isinstance(theirs, dict) or theirs.keys() != mine.keys():
        return f"{SETTINGS} was written by another version of finray"
    other = [text for name in mine for text in _differences(name, theirs[name], mine[name])]
    return (
        (
            f"contains an unfinished demo with another {', another '.join(other)}, whose files would mix with the new "
            "ones"
        )
        if other
        else None
    )


def _differences(name: str, theirs: Any, mine: Any) -> list[str]:
    """Return in words what differs in a setting, or in the entries of a table of them."""
    if isinstance(theirs, dict) and isinstance(mine, dict):
        names = sorted(theirs.keys() | mine.keys())
        return [text for key in names for text in _differences(key, theirs.get(key), mine.get(key))]
    return [] if theirs == mine else [f"{name} {theirs} (now {mine})"]


def complete_stages(out: Path, stages: Sequence[Stage]) -> set[int]:
    """Return the numbers of the stages whose products are all there, as their records and checksums prove.

    Raises
    ------
    RecordError
        A product was changed, or made from other files than those that are there.
    """
    whole, missing = set[int](), set[str]()
    for number, stage in enumerate(stages):
        absent = {product.file for product in stage.products if not _is_complete(out, product, missing)}
        missing |= absent
        if stage.products and not absent:
            whole.add(number)
    return whole


def _is_complete(out: Path, product: Product, missing: set[str]) -> bool:
    """Return whether a product is there; one that is there must be what its record says."""
    path = out / product.file
    if not path.exists() or (product.is_session and not (path.parent / MANIFEST_NAME).exists()):
        return False
    module, name = product.record_type.split(":")
    record_type: type[Record] = getattr(import_module(module), name)
    record = read_record(path, record_type)
    made_from = {} if record.provenance is None else record.provenance.input_sha256
    for needed in product.inputs:
        if needed in missing or made_from.get(needed) != sha256_of(out / needed):
            why = "is not complete" if needed in missing else "has changed since"
            raise RecordError(
                f"{path}: was made from {needed}, which {why}; move {path.name} away to have it made again"
            )
    if product.is_session:
        _require_complete(path.parent)
    return True


def _require_complete(folder: Path) -> None:
    """Refuse a session that is not as it was captured."""
    from rigs.capture import verify_session

    for fault in verify_session(folder).faults:
        raise RecordError(f"{fault.path}: {fault.text}; move {folder} away to have it captured again")


def note_time(out: Path, stage: Stage, seconds: float) -> None:
    """Add the wall time (s) of a finished stage to those of the folder."""
    path = out / TIMES
    is_cut_off = path.is_file() and not read_text(path).endswith("\n")
    line = json.dumps({"kind": stage.kind, "stage": stage.words, "seconds": round(seconds, 3)})
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" * is_cut_off + line + "\n")
        file.flush()
        os.fsync(file.fileno())


def noted_times(out: Path, stages: Sequence[Stage]) -> dict[str, float]:
    """Return the wall time (s) of each of the six stages; 0 where a demo was cut off before it was noted."""
    seconds = {stage.kind: 0.0 for stage in stages if stage.kind}
    lines = read_text(out / TIMES).splitlines() if (out / TIMES).is_file() else []
    for line in lines:
        with contextlib.suppress(RecordError, KeyError, TypeError):  # a line that was cut off
            noted = parse_json(line.encode(), out / TIMES)
            seconds[noted["kind"]] += float(noted["seconds"])
    return seconds


Count = Callable[[int, int, str], None]
OpenBar = Callable[[str], AbstractContextManager[Count]]
Say = Callable[[str], None]

RUN_STAGE = "finray_calib.demo._stages:run_stage"
PAINTS = tuple(f"{colour}/paint.json" for colour in COLOURS)
# what a process loads while the stage before it computes
IMPORTS: Mapping[str, tuple[str, ...]] = {
    "paints": (
        "finray_calib.demo._stages",
        "rigs.capture._paint_session",
        "rigs._rig_files",
        "finray_calib.radiometry._band_signals",
        "finray_calib.fit._paint_calibration",
    ),
    "press": ("finray_calib.demo._stages", "sim.mechanics._press", "sim.experiments._mechanical_press"),
    "renders": (
        "finray_calib.demo._stages",
        "mitsuba",
        "sim.experiments._rendered_press",
        "sim.experiments._light_angle",
        "sim.experiments._optics_products",
        "rigs.simulated._bench",
    ),
    "verdict": (
        "finray_calib.demo._report",
        "finray_calib.compare._comparison_record",
        "finray_calib.decide._decision_record",
    ),
}


def _paint_stages(colour: str) -> tuple[Stage, ...]:
    """Return the stages of one paint."""
    session, bands = f"{colour}/session/session.json", f"{colour}/bands.json"
    products = (
        Product(session, "data_schemas._capture:CaptureSession", is_session=True),
        Product(bands, "data_schemas._radiometry:BandSignals", (session,)),
        Product(f"{colour}/paint.json", "data_schemas._fit:PaintCalibration", (bands,)),
    )
    return tuple(
        _stage(kind, f"the {kind} of the {colour} paint", kind, "paints", product, colour=colour)
        for kind, product in zip(("capture", "radiometry", "fit"), products, strict=True)
    )


def _stage(kind: str, words: str, what: str, process: str, *products: Product, **arguments: Any) -> Stage:
    """Return a stage that is a method of the demo."""
    return Stage(kind, words, RUN_STAGE, {"what": what, "arguments": arguments}, products, process)


def _product(file: str, record_type: str, *inputs: str) -> Product:
    return Product(file, record_type, inputs)


STAGES: tuple[Stage, ...] = (
    *(stage for colour in COLOURS for stage in _paint_stages(colour)),
    _stage(
        "simulate", "the press by finite elements", "press", "press",
        _product(MECHANICS, "data_schemas._simulate:PressMechanics"),
        _product(SURFACES, "data_schemas._simulate:FingerSurfaces"),
    ),
    _stage(
        "simulate", "the render of the press", "simulate", "renders",
        _product(PRESS["b"], "data_schemas._simulate:SimulatedPress", SURFACES, *PAINTS),
    ),
    _stage(
        "simulate", "the render with the paper's emitter", "simulate", "renders",
        _product(PRESS["a"], "data_schemas._simulate:SimulatedPress", SURFACES, *PAINTS), level="a",
    ),
    _stage(
        "simulate", "the sweep of the light angle", "sweep", "renders",
        _product(SWEEP, "data_schemas._simulate:LightAngleSweep", SURFACES, *PAINTS),
    ),
    _stage(
        "simulate", "the sweeps at other places", "other_sweeps", "renders",
        *(_product(name, "data_schemas._simulate:LightAngleSweep", *PAINTS) for name in OTHER_SWEEPS),
    ),
    _stage(
        "simulate", "the sweeps of the true finger", "true_sweeps", "renders",
        _product(TRUE_SWEEP, "data_schemas._simulate:LightAngleSweep", SURFACES),
        *(_product(name, "data_schemas._simulate:LightAngleSweep") for name in OTHER_TRUE_SWEEPS),
    ),
    _stage(
        "capture", "the capture of the digital twin", "twin", "renders",
        _product(CAPTURE, "data_schemas._capture:TactileCapture", SURFACES),
    ),
    *(
        _stage(
            "compare", f"the comparison of {what} with the capture", "compare", "verdict",
            _product(REPORT[level], "data_schemas._compare:PhotometricErrorReport", PRESS[level], CAPTURE), level=level,
        )
        for level, what in (("b", "the render"), ("a", "the paper's emitter"))
    ),
    _stage(
        "decide", "the decision on the light angle", "decide", "verdict",
        _product(DECISION, "data_schemas._decide:LightAngleDecision", SWEEP, *OTHER_SWEEPS, REPORT["b"]),
    ),
)  # fmt: skip
REPORT_STAGE = Stage("", "the report", "finray_calib.demo._report:write_report", {}, (), "verdict")


def run_demo(
    settings: Mapping[str, Any],
    open_bar: OpenBar,
    say: Say,
    stages: Sequence[Stage] = STAGES,
    report: Stage = REPORT_STAGE,
) -> dict[str, Any]:
    """Run capture, radiometry, fit, simulate, compare and decide; write all products, summary and report.

    In a folder with an interrupted demo of the same settings the run continues: what is complete there, as records and
    checksums prove, is not computed again.

    Parameters
    ----------
    settings
        As :func:`finray_calib.demo.settings_json` returns them.
    open_bar
        Opens a progress bar for a stage.
    say
        Tells the user where the demo continues.
    stages, report
        What to run.

    Returns
    -------
    dict
        What the report says: verdict, certainty; and `seconds`, the wall time of all stages.

    Raises
    ------
    RecordError
        The folder holds something else, a finished demo or one with other settings, or a product was changed.
    ProcessDiedError
        The process of a stage died; the message names the stage, its log and what to do.
    FinrayError
        What a stage refuses.
    """
    out = Path(settings["out"])
    with held(out, settings), contextlib.ExitStack() as stack:
        whole = complete_stages(out, stages)
        if whole:
            say(f"{out}: continues after {len(whole)} of {len(stages)} stages, which are complete")
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
        except ProcessDiedError as died:
            raise ProcessDiedError(
                f"{stage.words} {died}. Its log is {log}. Finished work is kept; run the same command again to "
                "continue. If it fails again, run 'finray doctor' to see what this machine lacks"
            ) from None
        if following is None or following.process != stage.process:
            child.end()
        with contextlib.suppress(OSError):
            if log.stat().st_size == 0:
                log.unlink()
            log.parent.rmdir()
        return said
