"""The functions of the library: from a rig to a decision, one per stage, with those that read, write and trace.

Those of the finger stand in :mod:`finray_calib._finger_functions`. Where a file went in, the record that comes out
names it with its SHA-256, so that a stored result can be traced. A fit needs no records of fingers, which take as long
to load as its own: the functions that do load them when they are called.
"""

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from pydantic import ValidationError

import data_schemas
import finray_calib.exchange
import finray_calib.lineage
import rigs
from data_schemas import (
    BandSignals,
    CameraCharacterisation,
    CameraPlan,
    CameraSession,
    CaptureError,
    CaptureSession,
    FitError,
    ImportFormatError,
    PaintCalibration,
    PaintMap,
    PaintPlan,
    PaintWithoutEmission,
    PixelSignals,
    RadiometryError,
    Record,
    RecordError,
    RigFile,
    explain,
    provenance,
)
from data_schemas.storage import given_path, writing
from data_schemas.storage import read_record as read_stored
from data_schemas.storage import write_record as write_stored
from finray_calib._arguments import (
    PathLike,
    Progress,
    checked_seed,
    digests_of,
    given,
    given_list,
    made,
    naming,
    require_progress,
    require_truths,
)


def read_record(path: PathLike) -> Record:
    """Read a stored record, of whatever kind: its file (.json), or the folder of a session.

    Raises
    ------
    RecordError
        It is no record, of a version that cannot be read, or not what its kind must be.
    ChecksumError
        It was changed after it was written.
    """
    from data_schemas.json_schemas import STORED
    from data_schemas.storage import A_RECORD, read_json, stored_kind
    from rigs.capture import SESSION_NAME

    file = given_path(path, "path")
    if file.is_dir():
        if not (file / SESSION_NAME).exists():
            raise RecordError(
                f"{file}: this folder contains no session ({SESSION_NAME} is missing); give the path of {A_RECORD}"
            )
        file = file / SESSION_NAME
    if file.suffix == ".toml":
        raise RecordError(f"{file}: is a TOML file, not a stored record; to read a finger design, call finger_design")
    envelope = read_json(file, A_RECORD)
    kind = stored_kind(envelope)
    kinds = {record_type.__name__: record_type for record_type in STORED}
    if kind not in kinds:
        raise RecordError(
            f"{file}: is not a stored record, because its 'kind' is {kind!r}; valid kinds are "
            f"{', '.join(sorted(kinds))}"
        )
    return read_stored(file, kinds[kind])


def write_record(record: Record, path: PathLike) -> Path:
    """Store a record in a new file (.json, arrays beside it) and return its path.

    A record that a function of the library made keeps its origin. One that was read from a file gets a new one, which
    quotes the old: it may have been changed since.

    Raises
    ------
    RecordError
        The file exists already, and a stored record is never overwritten; it cannot be written; or what was given is
        no valid record.
    """
    if not isinstance(record, Record):
        raise RecordError(
            f"{(f'{path}: ' if isinstance(path, str | os.PathLike) else '')}the first argument must be a record, for "
            "example the result of fit_paint, and the second must be its path, but the first is of type "
            f"{type(record).__name__}"
        )
    try:
        type(record).model_validate(record.__dict__)  # model_copy(update=...) takes anything
    except ValidationError as refused:
        raise RecordError(
            f"{path}: was not written, because the record is not valid: {explain(refused, type(record))}"
        ) from None
    origin = record.provenance
    if origin is None:
        origin = provenance("finray_calib.write_record, from Python")
    elif not origin.command.endswith(", from Python"):
        command = f"finray_calib.write_record, of what was made by: {origin.command}, from Python"
        origin = provenance(command, origin.input_sha256, origin.seed)
    file = given_path(path, "path")
    if file.suffix != ".json":
        raise RecordError(f"{file}: the name of a stored record must end in .json; choose another name")
    with writing(file):
        return write_stored(record, file, origin)


def trace_record(path: PathLike) -> "finray_calib.lineage.Traced":
    """Return the tree of files that a stored record was made from, every one of them hashed again.

    Its `is_intact` says whether all is as it was written; `finray_calib.lineage.findings` lists what is not.
    """
    from finray_calib.lineage import Tracer

    return Tracer().trace(given_path(path, "path"))


@contextmanager
def open_rig(rig: PathLike) -> "Iterator[rigs.OpenRig]":
    """Open all devices of a rig file (TOML) for a ``with`` block; lights are off and connections closed at its end.

    Raises
    ------
    CaptureError
        A device cannot be reached, is in use, or is not what the rig file says.
    """
    from data_schemas.storage import read_toml
    from rigs import open_rig as open_devices
    from rigs import rig_locked

    path = given_path(rig, "rig")
    settings = read_toml(path, RigFile)
    with rig_locked(settings), open_devices(settings, path.parent) as opened:
        yield opened


def capture_session(
    plan: PathLike, rig: PathLike, out: PathLike, *, progress: Progress | None = None
) -> CaptureSession | CameraSession:
    """Capture what a plan says into a new folder: a paint sample, or the frames that characterise a camera.

    Parameters
    ----------
    plan, rig
        Files of the plan and of the rig (TOML).
    out
        Folder of the session; must be new.
    progress
        Called with frames done, frames in all and what is done.

    Raises
    ------
    CaptureError
        The plan does not fit the rig, a device failed, or the laser must not go on. What was captured stays, and
        ``finray capture --resume`` goes on with it.
    """
    from data_schemas.storage import read_toml, read_toml_tables
    from rigs.capture import SessionRequest, camera_step, capture_camera_session, capture_paint_session, paint_steps
    from rigs.light_guard import require_outside_layer, safety_lines

    require_progress(progress)
    plan_file, rig_file, folder = given_path(plan, "plan"), given_path(rig, "rig"), given_path(out, "out")
    kind = read_toml_tables(plan_file).get("kind", "paint")
    if kind not in ("paint", "camera"):
        raise CaptureError(
            f"{plan_file}: plans of kind {kind!r} need a person at the rig, so they cannot be run from Python; run "
            "this plan with 'finray capture'"
        )
    settings = read_toml(rig_file, RigFile)
    if not settings.is_simulated:
        with naming(CaptureError, rig_file):
            require_outside_layer(settings.laser)
        warnings.warn("\n".join(safety_lines(settings.laser)), stacklevel=2)

    def request() -> SessionRequest:
        """Ask for the session, once the plan is read: the files are named by what was read of them."""
        sources, command = digests_of([plan_file, rig_file]), "finray_calib.capture_session, from Python"
        return SessionRequest(folder, command, rig_folder=rig_file.parent, progress=progress, sources=sources)

    if kind == "camera":
        camera_plan = read_toml(plan_file, CameraPlan)
        with naming(CaptureError, plan_file):
            camera_step(camera_plan, settings)
        with naming(CaptureError):
            return capture_camera_session(settings, camera_plan, request())
    paint_plan = read_toml(plan_file, PaintPlan)
    with naming(CaptureError, plan_file):
        paint_steps(paint_plan, settings)
    with naming(CaptureError):
        return capture_paint_session(settings, paint_plan, request())


def reduce_session(
    session: PathLike, *, camera: CameraCharacterisation | PathLike | None = None, accept_repeat: bool = False
) -> BandSignals | CameraCharacterisation:
    """Reduce the folder of a session: a paint's to its band signals, a camera's to its characteristics.

    Parameters
    ----------
    session
        Folder written by :func:`capture_session`.
    camera
        Characterisation whose gain, read noise and black level are used for a paint session.
    accept_repeat
        Whether a filter and its own repeat may disagree, as they do on a fading sample.

    Raises
    ------
    RadiometryError
        Frames are missing, saturated or lost in the dark.
    """
    from finray_calib.radiometry import characterise_camera
    from rigs.capture import SESSION_NAME, read_camera_session, read_frame_of, session_kind

    require_truths(accept_repeat=accept_repeat)
    folder = given_path(session, "session")
    if session_kind(folder) == "paint":
        return _reduced(folder, camera, accept_repeat, None)[0]
    if camera is not None or accept_repeat:
        raise RadiometryError(
            f"{folder}: is a camera session, but camera and accept_repeat are only for paint sessions; leave them out"
        )
    captured = read_camera_session(folder)
    with naming(RadiometryError, folder):
        measured = characterise_camera(captured, lambda frame: read_frame_of(folder, frame))
    return made(measured, "reduce_session", [folder / SESSION_NAME])


def reduce_pixels(
    session: PathLike,
    *,
    camera: CameraCharacterisation | PathLike | None = None,
    whole_frame: bool = False,
    accept_repeat: bool = False,
) -> PixelSignals:
    """Reduce a paint session to the signals of every pixel of its region, for :func:`map_paint`.

    Parameters
    ----------
    session, camera, accept_repeat
        See :func:`reduce_session`.
    whole_frame
        Whether to take every pixel of the frame.
    """
    require_truths(whole_frame=whole_frame, accept_repeat=accept_repeat)
    pixels = _reduced(given_path(session, "session"), camera, accept_repeat, whole_frame)[1]
    if pixels is None:
        raise RadiometryError(f"{session}: no pixel signals were computed, which is a bug in finray; report it")
    return pixels


def _reduced(
    folder: Path, camera: CameraCharacterisation | PathLike | None, accept_repeat: bool, whole_frame: bool | None
) -> tuple[BandSignals, PixelSignals | None]:
    """Return the band signals of a paint session and, unless `whole_frame` is None, those of its pixels."""
    from finray_calib.radiometry import bands_of_steps, pixel_signals, session_steps, with_camera
    from rigs.capture import SESSION_NAME, read_frame_of, read_session

    captured, files = read_session(folder), [folder / SESSION_NAME]
    if camera is not None:
        measured, read = given(camera, CameraCharacterisation)
        captured, files = with_camera(captured, measured), [*files, *read]
    with naming(RadiometryError, folder):
        steps = session_steps(captured, lambda frame: read_frame_of(folder, frame))
        bands = bands_of_steps(captured, steps, accept_repeat)
        if whole_frame is None:
            return made(bands, "reduce_session", files), None
        pixels = pixel_signals(captured, lambda frame: read_frame_of(folder, frame), steps, bands, whole_frame)
    return bands, made(pixels, "reduce_pixels", files)


def import_bands(folder: PathLike) -> BandSignals:
    """Reduce a folder of another lab's band images, described by its ``bands.toml``, to band signals."""
    from finray_calib.exchange import import_band_folder

    images = given_path(folder, "folder")
    with naming(RadiometryError, images):
        bands, digests = import_band_folder(images)
    inputs = {(images / name).as_posix(): digest for name, digest in digests.items()}
    return bands.model_copy(update={"provenance": provenance("finray_calib.import_bands, from Python", inputs)})


def import_signals(
    table: PathLike, *, rig: PathLike | None = None, options: "finray_calib.exchange.SignalOptions | None" = None
) -> BandSignals:
    """Read a table (CSV) of band signals that were measured by other means, such as a photodiode behind filters.

    Parameters
    ----------
    table
        One row for each filter; docs/reference/tables-of-band-signals.md lists the columns.
    rig
        Rig file with the filters that the table names, and with laser, lamp, white reference and uncertainties.
    options
        What the table does not hold, in place of what the rig file states.

    Raises
    ------
    ImportFormatError
        A column or cell is wrong or missing, or no filter passes the laser.
    """
    from finray_calib.exchange import import_signal_table

    require_truths(**{"options.calibrated": getattr(options, "calibrated", False)})
    place = None if rig is None else given_path(rig, "rig")
    with naming(ImportFormatError):
        bands, files = import_signal_table(given_path(table, "table"), place, options)
    return made(bands, "import_signals", files)


def fit_paint(
    bands: BandSignals | PathLike | Sequence[BandSignals | PathLike],
    *,
    other_lights: Sequence[BandSignals | PathLike] = (),
    family: str = "auto",
    discrepancy: bool = True,
    check: bool = False,
    room_light: PathLike | None = None,
    seed: int = 1,
) -> PaintCalibration | PaintWithoutEmission:
    """Fit the emission spectrum of a paint, with its uncertainty, to band signals.

    Parameters
    ----------
    bands
        Band signals, see :func:`reduce_session`; several of them are repeats of one paint on one rig and become one
        calibration, whose intervals hold what differs between the sessions.
    other_lights
        Band signals of the same paint under other excitation lights: they constrain its absorption.
    family
        Family of curves to report; "auto" lets the bands choose.
    discrepancy
        Whether the paint may depart from its family; without, it is taken to be exactly of it.
    check
        Whether to sample again with emcee, as an independent check.
    room_light
        Folder of a session whose room-light frame shows a ColorChecker: the reflectance is then that of the patch
        closest to the paint (the paper's way, 30 % uncertain).
    seed
        Of the random generator; the same seed gives the same numbers.

    Returns
    -------
    PaintCalibration or PaintWithoutEmission
        The latter for a sample without emission beyond reflected laser, leak and stray light.

    Raises
    ------
    FitError
        The signals do not allow a fit.
    """
    from finray_calib.fit import (
        NO_DISCREPANCY,
        PAINT_DISCREPANCY,
        FitOptions,
        calibrate_paint,
        outlying_session_warnings,
    )

    seed = checked_seed(seed)
    require_truths(discrepancy=discrepancy, check=check)
    signals, files, scatter = _of_sessions(bands)
    others = [given(other, BandSignals) for other in given_list(other_lights, BandSignals, "other_lights")]
    files += [file for _, read in others for file in read]
    options = FitOptions(
        family=None if family == "auto" else family,
        discrepancy=PAINT_DISCREPANCY if discrepancy else NO_DISCREPANCY,
        check_by_emcee=check,
    )
    match = None if room_light is None else _room_light_match(given_path(room_light, "room_light"), signals)
    with naming(FitError, *files):
        paint = calibrate_paint(signals, seed, options, [other for other, _ in others], match)
    if scatter is not None and isinstance(paint, PaintCalibration):
        warnings_of_all = (*paint.warnings, *outlying_session_warnings(scatter))
        paint = paint.model_copy(update={"between_sessions": scatter, "warnings": warnings_of_all})
    if room_light is not None:
        from rigs.capture import SESSION_NAME

        files.append(given_path(room_light, "room_light") / SESSION_NAME)
    return made(paint, "fit_paint", files, seed)


def _of_sessions(
    bands: BandSignals | PathLike | Sequence[BandSignals | PathLike],
) -> "tuple[BandSignals, list[Path], data_schemas.SessionScatter | None]":
    """Return the band signals of one session, or those that several share, the files, and how they differ."""
    if isinstance(bands, BandSignals | str | os.PathLike):
        return *given(bands, BandSignals), None
    from finray_calib.fit import combine_sessions

    read = [given(one, BandSignals) for one in given_list(bands, BandSignals, "bands")]
    files = [file for _, of_one in read for file in of_one]
    if len(read) == 1:
        return read[0][0], files, None
    with naming(FitError, *files):
        together, scatter = combine_sessions([one for one, _ in read])
    return together, files, scatter


def _room_light_match(folder: Path, bands: BandSignals) -> "data_schemas.ColourCheckerMatch":
    """Return the match of the paint to a ColorChecker patch in a session's room-light frame."""
    from finray_calib.fit import colour_checker_reflectance
    from rigs.capture import read_frame_of, read_session

    session = read_session(folder)
    with naming(FitError, folder):
        return colour_checker_reflectance(session, lambda frame: read_frame_of(folder, frame), bands.optics)


def map_paint(pixels: PixelSignals | PathLike, paint: PaintCalibration | PathLike) -> PaintMap:
    """Fit every pixel, starting from the fit of the region of the same session; see :func:`reduce_pixels`."""
    from finray_calib.fit import map_paint as fit_pixels

    signals, files = given(pixels, PixelSignals)
    region, read = given(paint, PaintCalibration)
    with naming(FitError, *files, *read):
        fitted = fit_pixels(signals, region)
    return made(fitted, "map_paint", [*files, *read])


def compare_press(
    simulated: "data_schemas.SimulatedPress | PathLike",
    capture: "data_schemas.TactileCapture | PathLike",
    *,
    register: bool = False,
    despite_mismatch: bool = False,
    relative: bool = False,
    normal_map: "data_schemas.NormalMapRecord | PathLike | None" = None,
    pixel_scale: "data_schemas.PixelScale | PathLike | None" = None,
    seed: int = 1,
) -> "data_schemas.PhotometricErrorReport":
    """Compare a simulated press with a tactile capture: skill over the contact and its halo, with floor and interval.

    Parameters
    ----------
    simulated, capture
        The two presses.
    register
        Whether to move the render by the drift of the camera; otherwise the drift is only told.
    despite_mismatch
        Whether to compare images that do not belong together; the report says so.
    relative
        Judge the change by contact alone: the captured image without contact stands in the place of the render's.
    normal_map
        Of the capture's sensor: normals and depth are then compared too.
    pixel_scale
        Of the capture's camera: patch and halo are then also given in mm.
    seed
        Of the random generator.

    Raises
    ------
    CompareError
        The images do not belong together.
    """
    from data_schemas import CompareError, NormalMapRecord, PixelScale, SimulatedPress, TactileCapture
    from finray_calib.compare import CheckOptions, compare_checked

    seed = checked_seed(seed)
    require_truths(register=register, despite_mismatch=despite_mismatch, relative=relative)
    press, files = given(simulated, SimulatedPress)
    captured, read = given(capture, TactileCapture)
    files += read
    normals, scale = None, None
    if normal_map is not None:
        normals, read = given(normal_map, NormalMapRecord)
        files += read
    if pixel_scale is not None:
        scale, read = given(pixel_scale, PixelScale)
        files += read
    with naming(CompareError, *files):
        options = CheckOptions(register, despite_mismatch, normals, scale, relative=relative)
        report, _ = compare_checked(press, captured, seed, options)
    return made(report, "compare_press", files, seed)


def compare_force(
    press: "data_schemas.PressMechanics | PathLike",
    force_csv: PathLike,
    *,
    known_first_touch: bool = False,
    other_mesh: "data_schemas.PressMechanics | PathLike | None" = None,
    seed: int = 1,
) -> "data_schemas.ForceComparison":
    """Compare the force of a press by finite elements with a measured one.

    Parameters
    ----------
    press
        The mechanics of a press, see :func:`finray_calib.press_finger`.
    force_csv
        Columns displacement_mm and force_n; if known force_uncertainty_n and displacement_uncertainty_mm.
    known_first_touch
        Whether displacements count from first touch; otherwise first touch is fitted.
    other_mesh
        The same press on another mesh, for the uncertainty of the mesh.
    seed
        Of the random generator.
    """
    import numpy as np

    from data_schemas import CompareError, PressMechanics
    from finray_calib.exchange import read_force_csv
    from finray_calib.force import compare_force as compare

    seed = checked_seed(seed)
    require_truths(known_first_touch=known_first_touch)
    mechanics, files = given(press, PressMechanics)
    other, read = (None, []) if other_mesh is None else given(other_mesh, PressMechanics)
    force_file = given_path(force_csv, "force_csv")
    measured = read_force_csv(force_file)
    with naming(CompareError, *files):
        compared = compare(mechanics, measured, np.random.default_rng(seed), not known_first_touch, other)
    return made(compared, "compare_force", [*files, force_file, *read], seed)


def decide_light_angle(
    sweeps: "data_schemas.LightAngleSweep | PathLike | Sequence[data_schemas.LightAngleSweep | PathLike]",
    reports: "Sequence[data_schemas.PhotometricErrorReport | PathLike]" = (),
    *,
    narrow_sweep: bool = False,
    weights: Sequence[float] | None = None,
    criterion: Literal["average", "worst"] = "average",
    aim: Literal["brightness", "normal"] | None = None,
    seed: int = 1,
) -> "data_schemas.LightAngleDecision":
    """Decide on the angle of the light over touches of a finger: the angle, its risk, and what each touch loses.

    Parameters
    ----------
    sweeps
        One for each touch, see :func:`finray_calib.sweep_light_angle`; one alone decides for its place only.
    reports
        Comparisons with captures, see :func:`compare_press`; without any the decision is not validated.
    narrow_sweep
        Whether angles that span less than 4 deg are meant so, and are not radians.
    weights
        How often each touch occurs, in the order of the sweeps; by default all alike.
    criterion
        "average": the least loss on average over the touches; "worst": at the worst of them.
    aim
        "brightness" of the touches, or expected error of the sensed "normal" at places along the pad; by default the
        latter where a sweep holds it (``all_objectives=True``) and neither reports nor weights are given.
    seed
        Of the random generator.

    Raises
    ------
    DecideError
        The sweeps allow no decision or do not belong together, or a report is not of this finger.
    """
    from data_schemas import DecideError, LightAngleSweep, PhotometricErrorReport
    from finray_calib.decide import decide

    seed = checked_seed(seed)
    require_truths(narrow_sweep=narrow_sweep)
    alone = isinstance(sweeps, LightAngleSweep | str | os.PathLike)
    several = [sweeps] if alone else given_list(sweeps, LightAngleSweep, "sweeps")
    swept = [given(sweep, LightAngleSweep) for sweep in several]
    files = [file for _, read in swept for file in read]
    compared = [given(of, PhotometricErrorReport) for of in given_list(reports, PhotometricErrorReport, "reports")]
    files += [file for _, read in compared for file in read]
    with naming(DecideError, *files):
        decision = decide(
            [sweep for sweep, _ in swept],
            [report for report, _ in compared],
            seed,
            narrow_sweep,
            weights,
            criterion,
            aim,
        )
    return made(decision, "decide_light_angle", files, seed)
