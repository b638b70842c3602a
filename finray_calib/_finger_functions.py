"""The functions of the library that need the simulation: a finger's design, its press, its render and its sweep."""

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import isfinite
from numbers import Real
from operator import index
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, SupportsIndex, TypedDict, TypeVar, Unpack

from pydantic import ValidationError

import sim.experiments
import sim.mechanics
import sim.optics
from data_schemas import (
    FingerDesign,
    FingerSurfaces,
    LightAngleSweep,
    PaintCalibration,
    PlainSensor,
    PressMechanics,
    SensorFit,
    SimulatedPress,
    SimulateError,
    TactileCapture,
    explain,
    look_like_radians,
    narrow_sweep_text,
)
from data_schemas.storage import given_path
from finray_calib._arguments import (
    NOT_IN_ORDER,
    PathLike,
    Progress,
    checked_seed,
    digest_of,
    given,
    given_list,
    made,
    naming,
    require_progress,
    require_truths,
)

Paint = PaintCalibration | PathLike
D = TypeVar("D", FingerDesign, PlainSensor)
DEFAULT_SAMPLES_PER_PIXEL = 128
DEFAULT_SAMPLES_PER_PROBE = 4000
SWEEP_REPEATS = 6
MOST_INCREMENTS = 1000
SURFACES_SUFFIX = ".surfaces.json"
MECHANICS_SUFFIX = ".mechanics.json"
_CHOICES: dict[str, tuple[str, ...]] = {
    "level": ("a", "a_inverse_square", "b", "c"),
    "engine": ("auto", "llvm", "scalar", "cuda"),
    "contact": ("auto", "penalty", "barrier"),
}
_TRUTHS = frozenset({"paints_as_given", "pose_response", "shared_light", "all_objectives", "narrow_sweep"})
_OF_ALL = frozenset({"samples", "engine", "paints_as_given"})
_OF_A_PRESS = _OF_ALL | {"level", "pose_response", "shared_light", "position_mm"}
_OF_A_FIT = _OF_ALL | {"shared_light"}
_OF_A_SWEEP = _OF_ALL | {"level", "all_objectives", "position_mm", "narrow_sweep"}


class FingerPress(NamedTuple):
    """A finger pressed by finite elements: its force over the push, and its surfaces without and with contact."""

    mechanics: PressMechanics
    surfaces: FingerSurfaces


class RenderOptions(TypedDict, total=False):
    """How a finger is rendered; every key has a default.

    Attributes
    ----------
    level
        How the walls emit: "b" (default), "a", "a_inverse_square" or "c"; a sweep knows "b" only.
    samples
        Paths per pixel of a press (even, default 128), or per probe of a sweep (default 4000).
    engine
        "auto" (default), "llvm", "scalar" or "cuda": an NVIDIA GPU, which "auto" never takes.
    paints_as_given
        Whether a red paint that emits at shorter wavelengths than the green one is meant so.
    pose_response
        Of a press: whether to render also how the image changes with the indenter's pose (three times the time).
    shared_light
        Of a press: whether pixels share the light that reaches the coat: less noise in the same time, but part of it
        common to neighbours. Needs LLVM; not for level "c".
    all_objectives
        Of a sweep: whether to measure also how well normals can be measured, evenness, clipping and room for the panel.
    position_mm
        Of a sweep: where the indenter touches along the pad, in mm from the base, in place of the design's.
    narrow_sweep
        Of a sweep: whether angles that span less than 4 deg are meant so, and are not radians.
    """

    level: "sim.optics.RenderLevel"
    samples: int
    engine: "sim.optics.Preference"
    paints_as_given: bool
    pose_response: bool
    shared_light: bool
    all_objectives: bool
    position_mm: float
    narrow_sweep: bool


class _Design(NamedTuple):
    """A design, where relative paths in it start, and its file if it has one."""

    design: FingerDesign
    folder: Path
    files: list[Path]


def finger_design(name_or_path: PathLike = "flat-70x35") -> FingerDesign:
    """Return a ready-made finger by its name, or read a design file (TOML).

    Raises
    ------
    SimulateError
        There is neither a ready-made finger nor a file of this name; the message lists the ready-made ones.
    RecordError
        The file is no design.
    """
    return _design(name_or_path).design


def _design(given_design: FingerDesign | PathLike) -> _Design:
    """Return a design that was given as itself, by name or by file."""
    from sim import PRESETS, design_inputs, preset_design, read_design

    if isinstance(given_design, FingerDesign):
        return _Design(_valid(given_design), Path(), [])
    path = given_path(given_design, "design")
    if path.name.endswith(SURFACES_SUFFIX):
        return _design_of_surfaces(path)
    if not path.exists() and (os.fspath(given_design) in PRESETS or not path.suffix):
        return _Design(preset_design(os.fspath(given_design)), Path(), [])
    design = read_design(path)
    return _Design(design, path.parent, design_inputs(design, path))


def _valid(design: D) -> D:
    """Return a design whose numbers are checked again: ``model_copy(update=...)`` takes any.

    Raises
    ------
    SimulateError
        A number is not allowed; the message names it.
    """
    try:
        type(design).model_validate(design.model_dump(warnings=False))
    except ValidationError as refused:
        raise SimulateError(f"the design {design.name!r}: {explain(refused, type(design))}") from None
    return design


def _require_options(options: Mapping[str, object], known: frozenset[str]) -> None:
    """Refuse options that a function does not have, and values that they cannot have, before any work is done.

    Raises
    ------
    SimulateError
        An option is unknown or out of range; the message lists what is allowed.
    """
    for name, value in options.items():
        if name not in known:
            raise SimulateError(
                f"{name}: is not an option of this function; valid options are {', '.join(sorted(known))}"
            )
        if name in _CHOICES and value not in _CHOICES[name]:
            raise SimulateError(f"{name}={value!r}: must be one of {', '.join(_CHOICES[name])}")
        if name == "samples":
            _whole("samples", value, 1)
        if name in _TRUTHS:
            require_truths(**{name: value})


def _whole(name: str, value: object, least: int, most: int | None = None) -> None:
    """Refuse what is not a whole number between these."""
    number = least - 1 if isinstance(value, bool) or not isinstance(value, SupportsIndex) else index(value)
    if number < least or (most is not None and number > most):
        allowed = f"of {least} or more" if most is None else f"from {least} to {most}"
        raise SimulateError(f"{name}={value!r}: must be a whole number {allowed}")


def _positive(name: str, value: object, unit: str) -> None:
    """Refuse what is not a finite number above zero."""
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 < float(value) < float("inf"):
        raise SimulateError(f"{name}={value!r}: must be a finite number above 0 {unit}")


def _design_of_surfaces(surfaces: Path) -> _Design:
    """Return the design of a press whose surfaces are stored: it stands in the record of its mechanics beside them."""
    mechanics = surfaces.with_name(surfaces.name.removesuffix(SURFACES_SUFFIX) + MECHANICS_SUFFIX)
    if not mechanics.exists():
        raise SimulateError(
            f"{surfaces}: the design of these surfaces is stored in {mechanics.name}, but {mechanics.name} is missing "
            "from the folder; give the design file instead, and these surfaces as surfaces="
        )
    press, files = given(mechanics, PressMechanics)
    return _Design(press.design, surfaces.parent, files)


def press_finger(
    design: FingerDesign | PathLike,
    *,
    force_n: float | None = None,
    increments: int = 4,
    contact: "sim.mechanics.ContactChoice" = "auto",
    budget_s: float | None = None,
    progress: Progress | None = None,
) -> FingerPress:
    """Press the design's indenter in by finite elements.

    Parameters
    ----------
    design
        A design, its file, or the name of a ready-made finger; ``indenter.depth_mm`` is the push.
    force_n
        Press until the indenter pushes with this force in N, frictionless, in place of the design's depth.
    increments
        Steps of the push, 1 to 1000.
    contact
        "penalty" (fast), "barrier" (contact of ribs too) or "auto": the penalty, and the barrier where ribs meet.
    budget_s
        Processor time, all threads together, after which the press ends early with the increments that it has.
    progress
        Called before each iteration and after each increment.

    Raises
    ------
    SimulateError
        No equilibrium was found, or the gel is torn. A push that ended early is no error: `mechanics.unreached` says
        why.
    """
    from finray_calib.spectra import machine_threads
    from sim.experiments import press_records
    from sim.mechanics import PressSettings, press_to_force
    from sim.mechanics import press_as_designed as press

    require_progress(progress)
    _whole("increments", increments, 1, MOST_INCREMENTS)
    _require_options({"contact": contact}, frozenset({"contact"}))
    for name, value, unit in (("force_n", force_n, "N"), ("budget_s", budget_s, "s")):
        if value is not None:
            _positive(name, value, unit)
    finger, folder, files = _design(design)
    settings = PressSettings(None, increments, machine_threads(), contact, budget_s)
    if force_n is not None and contact == "barrier":
        raise SimulateError(
            "force_n works only with penalty contact, but contact='barrier' was given; leave out contact or force_n"
        )
    with naming(SimulateError, *files[:1]):
        if force_n is not None:
            pressed = press_to_force(finger, force_n, settings, folder=folder, progress=progress)
        else:
            pressed = press(finger, settings, folder=folder, progress=progress)
        mechanics, surfaces = press_records(finger, pressed, wanted_force_n=force_n)
    if finger.indenter.file is not None:
        files = [*files, folder / finger.indenter.file]
    return FingerPress(made(mechanics, "press_finger", files), made(surfaces, "press_finger", files))


def render_press(
    design: FingerDesign | PathLike,
    *,
    red: Paint,
    green: Paint,
    surfaces: FingerSurfaces | PathLike | None = None,
    seed: int = 1,
    progress: Progress | None = None,
    **options: Unpack[RenderOptions],
) -> SimulatedPress:
    """Render the contact and no-contact image of a painted finger, in its camera's linear RGB.

    Parameters
    ----------
    design
        A design, its file, the name of a ready-made finger, or the surfaces of a press (NAME.surfaces.json), whose
        design stands in NAME.mechanics.json beside them.
    red, green
        Paints of the two walls, see :func:`finray_calib.fit_paint`.
    surfaces
        The finger without and with contact, see :func:`press_finger`; by default the indenter is pressed in
        analytically.
    seed
        Of the random generator.
    progress
        Called with parts done, parts in all and what is done.
    **options
        See :class:`RenderOptions`.

    Raises
    ------
    SimulateError
        The paints look swapped, or the scene cannot be rendered.
    """
    from sim.experiments import simulate_press

    require_progress(progress)
    seed = checked_seed(seed)
    _require_options(options, _OF_A_PRESS)
    rendering = _rendering(seed, options)
    scene, digests, files = _scene(design, {"red": red, "green": green}, surfaces, options)
    with naming(SimulateError):
        press = simulate_press(scene, rendering, digests, progress)
    return made(press, "render_press", files, seed)


def render_images(
    design: FingerDesign | PathLike,
    *,
    red: Paint,
    green: Paint,
    surfaces: FingerSurfaces | PathLike | None = None,
    seed: int = 1,
    progress: Progress | None = None,
    **options: Unpack[RenderOptions],
) -> "sim.experiments.OpticsProducts":
    """Render as :func:`render_press` does, and return all images of the press beside its record.

    Parameters
    ----------
    design, red, green, surfaces, seed, progress, **options
        See :func:`render_press`.

    Returns
    -------
    sim.experiments.OpticsProducts
        The record (`press`), the press as a capture with raw counts, the images of its bands and spectra with their
        noise, and the geometry in each pixel.
    """
    from sim.experiments import simulate_images

    require_progress(progress)
    seed = checked_seed(seed)
    _require_options(options, _OF_A_PRESS)
    rendering = _rendering(seed, options)
    scene, digests, files = _scene(design, {"red": red, "green": green}, surfaces, options)
    with naming(SimulateError):
        products = simulate_images(scene, rendering, digests, progress)
    return replace(products, press=made(products.press, "render_images", files, seed))


def render_sensor(
    sensor: PlainSensor | PathLike,
    *,
    seed: int = 1,
    samples: int = DEFAULT_SAMPLES_PER_PIXEL,
    engine: "sim.optics.Preference" = "auto",
) -> SimulatedPress:
    """Render the contact and no-contact image of a classic sensor, in its camera's linear RGB.

    Parameters
    ----------
    sensor
        A design, its file, or the name of a ready-made sensor, such as "gelsight-flat".
    seed
        Of the random generator.
    samples
        Paths per pixel, an even number.
    engine
        "auto", "llvm" or "scalar".

    Raises
    ------
    SimulateError
        There is neither a ready-made sensor nor a file of this name, or the scene cannot be rendered.
    """
    from sim.experiments import simulate_sensor_press

    seed = checked_seed(seed)
    _require_options({"samples": samples, "engine": engine}, _OF_ALL)
    if samples % 2:
        raise SimulateError(
            f"samples={samples}: must be an even number of 2 or more, because a press is rendered as two halves"
        )
    design, folder, files = _plain_sensor(sensor)
    with naming(SimulateError, *files[:1]):
        press, _ = simulate_sensor_press(design, folder, _renderer(engine), seed, samples)
    return made(press, "render_sensor", files, seed)


def fit_sensor(
    design: FingerDesign | PlainSensor | PathLike,
    captures: Sequence[TactileCapture | PathLike],
    *,
    paints: Mapping[str, Paint] | None = None,
    free: Sequence[str] = (),
    seed: int = 1,
    progress: Progress | None = None,
    **options: Unpack[RenderOptions],
) -> SensorFit:
    """Fit the numbers of a sensor to captures of it: light powers, yields, gain, shift, scale, blur and what is `free`.

    Parameters
    ----------
    design
        A design, its file or the name of a ready-made one, of a painted finger or of a classic sensor; of its camera's
        size and lit as in the captures.
    captures
        Presses of one sensor at one exposure, with linear values.
    paints
        "red" and "green" of a painted finger, see :func:`finray_calib.fit_paint`.
    free
        Further numbers of the design, by dotted path, such as ``pad.thickness_mm``; by default none.
    seed
        Of the renders and of the draws.
    progress
        Called with parts done, parts in all and what is done.
    **options
        ``samples``, ``engine``, ``shared_light`` and ``paints_as_given`` of :class:`RenderOptions`.

    Raises
    ------
    SimulateError
        The captures do not go with each other or with the design, or a number cannot be free.
    """
    from sim.experiments import fit_sensor as fit_scene

    require_progress(progress)
    seed = checked_seed(seed)
    _require_options(options, _OF_A_FIT)
    read = [given(capture, TactileCapture) for capture in given_list(captures, TactileCapture, "captures")]
    if not read:
        raise SimulateError("captures: the list is empty; give at least one capture of the sensor")
    if isinstance(free, NOT_IN_ORDER):
        raise SimulateError(
            f"free={free!r}: must be a list of dotted paths to numbers of the design, such as ['pad.thickness_mm']"
        )
    if paints is not None and not (isinstance(paints, Mapping) and set(paints) in (set(), {"red", "green"})):
        raise SimulateError(
            "paints: must name one paint for each wall, such as {'red': PAINT, 'green': PAINT}, or be left out"
        )
    scene, files = _layered(design, dict(paints or {}), seed, options)
    with naming(SimulateError, *files[:1]):
        fit = fit_scene(scene, [capture for capture, _ in read], free, seed, progress)
    return made(fit, "fit_sensor", [*files, *(file for _, of in read for file in of)], seed)


def _layered(
    design: FingerDesign | PlainSensor | PathLike, paints: dict[str, Paint], seed: int, options: RenderOptions
) -> "tuple[sim.experiments.SensorScene, list[Path]]":
    """Return what renders a sensor in layers, and the files that were read."""
    from sim.experiments import ClassicLayers, FingerLayers

    samples = options.get("samples", DEFAULT_SAMPLES_PER_PIXEL)
    if isinstance(design, PlainSensor) or _is_classic(design):
        if paints:
            raise SimulateError("paints: a classic sensor has no painted walls; leave paints out")
        sensor, folder, files = _plain_sensor(design)
        return ClassicLayers(sensor, _renderer(options.get("engine", "auto")), folder, seed, samples), files
    painted, _, files = _scene(design, paints, None, options)
    shared = options.get("shared_light", False)
    return FingerLayers(painted.finger, painted.calibrations, seed, samples, shared), files


def _is_classic(design: FingerDesign | PathLike) -> bool:
    """Return whether a design, its file or its name is one of a classic sensor."""
    from sim import SENSORS, is_sensor

    if isinstance(design, FingerDesign):
        return False
    path = given_path(design, "design")
    return is_sensor(path) if path.exists() else os.fspath(design) in SENSORS


def _plain_sensor(sensor: FingerDesign | PlainSensor | PathLike) -> tuple[PlainSensor, Path, list[Path]]:
    """Return a classic sensor, the folder that its files are relative to, and the files that were read."""
    from sim import SENSORS, preset_sensor, read_sensor, sensor_inputs

    if isinstance(sensor, PlainSensor):
        return _valid(sensor), Path(), []
    if isinstance(sensor, FingerDesign):
        raise SimulateError(f"{sensor.name} is a painted finger, but this function supports only classic sensors")
    path = given_path(sensor, "sensor")
    if not path.exists() and os.fspath(sensor) in SENSORS:
        return preset_sensor(os.fspath(sensor)), Path(), []
    if not path.exists():
        raise SimulateError(
            f"{path}: no such file; give a ready-made sensor ({', '.join(SENSORS)}) or the path of a design (TOML)"
        )
    design = read_sensor(path)
    return design, path.parent, sensor_inputs(design, path)


def _rendering(seed: int, options: RenderOptions) -> "sim.experiments.Rendering":
    """Return how a press is rendered."""
    from sim.experiments import Rendering

    samples = options.get("samples", DEFAULT_SAMPLES_PER_PIXEL)
    if samples < 2 or samples % 2:
        raise SimulateError(
            f"samples={samples}: must be an even number of 2 or more, because a press is rendered as two halves"
        )
    level, pose = options.get("level", "b"), options.get("pose_response", False)
    return Rendering(level, seed, samples, with_pose_response=pose, shared_light=options.get("shared_light", False))


def sweep_light_angle(
    design: FingerDesign | PathLike,
    angles_deg: Sequence[float],
    *,
    red: Paint,
    green: Paint,
    surfaces: FingerSurfaces | PathLike | None = None,
    seed: int = 1,
    progress: Progress | None = None,
    **options: Unpack[RenderOptions],
) -> LightAngleSweep:
    """Measure the brightness beside the indenter over the angle of the light, for `decide_light_angle`.

    Parameters
    ----------
    design, red, green, surfaces, seed, progress, **options
        See :func:`render_press`.
    angles_deg
        Increasing, at least 4 of them for a decision; 0 along the pad, 90 into it.
    """
    from sim.experiments import light_angle_sweep
    from sim.optics import ProbePaths

    require_progress(progress)
    seed = checked_seed(seed)
    _require_options(options, _OF_A_SWEEP)
    angles_deg = _angles(angles_deg)
    if options.get("level", "b") != "b":
        raise SimulateError("level: sweeps support only level b; leave level out")
    if not options.get("narrow_sweep", False) and look_like_radians(angles_deg):
        raise SimulateError(f"angles_deg: {narrow_sweep_text(angles_deg)}")
    scene, digests, files = _scene(design, {"red": red, "green": green}, surfaces, options)
    paths = ProbePaths(options.get("samples", DEFAULT_SAMPLES_PER_PROBE), SWEEP_REPEATS, seed)
    with naming(SimulateError):
        sweep = light_angle_sweep(
            scene.finger, scene.calibrations, angles_deg, paths, digests, progress,
            shapes=scene.shapes, further_objectives=options.get("all_objectives", False),
        )  # fmt: skip
    return made(sweep, "sweep_light_angle", files, seed)


def _angles(angles_deg: Sequence[float]) -> list[float]:
    """Return the angles of a sweep as floats."""
    try:
        angles = [] if isinstance(angles_deg, NOT_IN_ORDER) else [float(angle) for angle in angles_deg]
    except (TypeError, ValueError):
        angles = []
    if not angles or not all(isfinite(angle) for angle in angles):
        raise SimulateError(
            f"angles_deg={angles_deg!r}: must be a list of finite angles in deg, such as [0, 30, 60, 90]"
        )
    for angle in angles:
        if not -180.0 <= angle <= 180.0:
            raise SimulateError(f"angles_deg: {angle:g} deg is out of range; light angles must be from -180 to 180 deg")
    for before, angle in pairwise(angles):
        if before >= angle:
            raise SimulateError(
                f"angles_deg: {angle:g} deg follows {before:g} deg, but the angles must increase; "
                "list each angle once, in increasing order"
            )
    return angles


def _scene(
    design: FingerDesign | PathLike,
    paints: dict[str, Paint],
    surfaces: FingerSurfaces | PathLike | None,
    options: RenderOptions,
) -> "tuple[sim.experiments.FingerScene, dict[str, str], list[Path]]":
    """Return the painted finger, the checksums of its paints, and all files that were read."""
    from sim.experiments import finger_scene, require_paints_in_order

    found = _design(design)
    if "position_mm" in options:
        indenter = found.design.indenter.model_copy(update={"position_mm": options["position_mm"]})
        found = found._replace(design=_valid(found.design.model_copy(update={"indenter": indenter})))
    if surfaces is None and not isinstance(design, FingerDesign) and os.fspath(design).endswith(SURFACES_SUFFIX):
        surfaces = design
    read = {colour: given(paint, PaintCalibration) for colour, paint in paints.items()}
    calibrations = {colour: paint for colour, (paint, _) in read.items()}
    if not options.get("paints_as_given", False):
        modes_nm = {colour: paint.mode_nm.estimate for colour, paint in calibrations.items()}
        names = {colour: str(paint[1][0]) if paint[1] else paint[0].paint_name for colour, paint in read.items()}
        require_paints_in_order(modes_nm, names, "--paints-as-given (from Python paints_as_given=True)")
    meshes, mesh_files = (None, []) if surfaces is None else given(surfaces, FingerSurfaces)
    with naming(SimulateError, *found.files[:1]):
        renderer = _renderer(options.get("engine", "auto"))
        scene = finger_scene(found.design, calibrations, found.folder, renderer, meshes)
    digests = {colour: digest_of(paint, files) for colour, (paint, files) in read.items()}
    return scene, digests, [*found.files, *(file for _, files in read.values() for file in files), *mesh_files]


def _renderer(preference: "sim.optics.Preference") -> ModuleType:
    """Open the renderer, and warn when another one than usual was taken because something is missing."""
    from sim.optics import choose_variant, open_renderer

    choice = choose_variant(preference)
    if choice.fell_back:
        warnings.warn(f"{choice.variant} renders: {choice.note}", stacklevel=4)
    return open_renderer(choice)


def recolour_press(
    press: SimulatedPress | PathLike,
    *,
    red: Paint | None = None,
    green: Paint | None = None,
    camera: PathLike | None = None,
    white_balance: "sim.experiments.WhiteBalance | None" = None,
) -> SimulatedPress:
    """Show a rendered press with other paints, another camera or white balance; nothing is rendered again.

    Parameters
    ----------
    press
        See :func:`render_press`.
    red, green
        Paints of both walls (an unchanged one again), or neither.
    camera
        Camera response (CSV).
    white_balance
        Gains of red, green and blue, or "pad": the untouched pad becomes grey on average.

    Raises
    ------
    SimulateError
        Nothing is to change, or too much changes to do without a new render.
    """
    from data_schemas.storage import read_camera_response
    from sim.experiments import paint_optics, recoloured

    if (red is None) != (green is None):
        raise SimulateError(
            "only one of red and green is given; give both (repeat the paint that does not change), or neither to "
            "keep the paints of the press"
        )
    if red is None and camera is None and white_balance is None:
        raise SimulateError("no change was requested; give red and green, camera or white_balance")
    rendered, files = given(press, SimulatedPress)
    paints = {c: given(p, PaintCalibration) for c, p in (("red", red), ("green", green)) if p is not None}
    camera_file = None if camera is None else given_path(camera, "camera")
    response = None if camera_file is None else read_camera_response(camera_file)
    optics = {colour: paint_optics(paint) for colour, (paint, _) in paints.items()}
    digests = {colour: digest_of(paint, read) for colour, (paint, read) in paints.items()}
    with naming(SimulateError, *files):
        shown = recoloured(rendered, optics or None, response, white_balance, digests or None)
    read_files = [*files, *(file for _, read in paints.values() for file in read)]
    return made(shown, "recolour_press", [*read_files, *([] if camera_file is None else [camera_file])])
