"""Sweep the angle of the blue light: the paper's brightness near the indenter, and further objectives.

The brightness comes with the uncertainty of the paints. The further objectives say how well the
camera then tells the direction of the touched surface. All are measured on small facets of the undeformed coat, seen as
the camera sees them through mirror and gel: camera signals of the tilted facets at each light angle. An
angle at which the panel passes through another part cannot be mounted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from data_schemas import (
    AngleConstraints,
    AngleObjective,
    FingerDesign,
    ImpossibleFingerError,
    LightAngleSweep,
    LightPanel,
    PaintCalibration,
    SimulateError,
)
from finray_calib.sensing import held_out_normal_error_deg, normal_sigma_deg, uniformity
from rigs.simulated.sensor import Sensor
from sim.experiments._optics_products import EXPOSURE_S, tactile_sensor
from sim.experiments._painted_finger import PaintedFinger
from sim.experiments._rendered_press import SHAPE_NOTE
from sim.optics import (
    BAND_NAMES,
    SCALAR_VARIANT,
    PaintBands,
    PaintOptics,
    ProbePaths,
    Progress,
    SeenPoints,
    check_paints,
    measure_together,
    paint_bands,
    panel_frame,
    seen_points,
    sweep_light_angle,
    tilt_shares,
    tilted_facets,
    with_light_angle,
)
from sim.surface_meshes import FingerShape, Surface, check_no_intersections, pressed_shape, rest_shape

Floats = NDArray[np.float64]
OBJECTIVE = (
    "white-balanced brightness beside the indenter: mean of camera R, G and B of the coating, each relative to its own "
    "mean over the sweep, at probe points on both edges of the contact, seen along the pad's normal"
)


def light_angle_sweep(
    finger: PaintedFinger,
    calibrations: Mapping[str, PaintCalibration],
    angles_deg: Sequence[float],
    paths: ProbePaths,
    paint_sha256: Mapping[str, str],
    progress: Progress | None = None,
    shapes: tuple[FingerShape, FingerShape] | None = None,
    further_objectives: bool = False,
) -> LightAngleSweep:
    """Measure the objective at every angle, with one draw of both paints and one noise seed per repeat.

    A repeat's camera signal is ``C diag(gain) basis``; the camera matrix C and the gain (yield of the draw over the
    mean yield) are those of the repeat's posterior draw, the same at every angle, so that a common scale cannot
    change the ranking. The value is the mean of the three channels, each relative to its mean over the sweep: the
    blue channel, tens of times brighter in raw counts, would otherwise be the only one that counts.
    `shapes` are the finger without and with contact, by default those of the design and its analytic press.

    With `further_objectives`, those of :mod:`sim.experiments._light_angle` are measured too, with the first
    draws of the paints, on the finger without contact.
    """
    if further_objectives:
        require_compiled(finger)
    shape, further = None if shapes is None else shapes[1], None
    # matrices of some hundred rows: threads that wait for each other cost more than they do, on a busy machine far more
    with threadpool_limits(limits=1, user_api="blas"):
        sweep = sweep_light_angle(
            finger.design, finger.paints, finger.renderer, angles_deg, paths, progress=progress, shape=shape
        )
        to_camera = _cameras_of_draws(finger, calibrations, sweep.bands, paths)
        if further_objectives:
            further = angle_objectives(
                finger, to_camera[:REPEATS], sweep.angles_deg, paths.seed, progress=progress, shapes=shapes
            )
    basis = sweep.radiance_rel
    rgb = np.einsum("rcb,arpb->arc", to_camera, basis) / basis.shape[2]
    channels = rgb / rgb.mean(axis=(0, 1))
    return LightAngleSweep(
        name=f"{finger.design.name}, light angle",
        objective=OBJECTIVE,
        label=sweep.label,
        angles_deg=sweep.angles_deg,
        values=channels.mean(axis=2),
        channels=channels,
        basis=basis,
        bands=BAND_NAMES,
        probe_points_mm=sweep.probe_points_mm,
        other_objectives=further[0] if further else (),
        constraints=further[1] if further else None,
        design=finger.design,
        paints=dict(paint_sha256),
        notes=(
            f"{SHAPE_NOTE}{'analytic press' if shape is None else shape.label}",
            f"camera response: {finger.response[0].source}",
            *finger.coverage_notes(sweep.bands),
        ),
    )


def _cameras_of_draws(
    finger: PaintedFinger, calibrations: Mapping[str, PaintCalibration], mean: PaintBands, paths: ProbePaths
) -> Floats:
    """Return the (channel, band) matrix of each repeat, (repeat, 3, 3), each for one draw of both paints."""
    rng = np.random.default_rng(paths.seed)
    return np.array([_camera_of_draw(finger, calibrations, mean, rng) for _ in range(paths.repeats)])


def _camera_of_draw(
    finger: PaintedFinger, calibrations: Mapping[str, PaintCalibration], mean: PaintBands, rng: np.random.Generator
) -> Floats:
    """Return the (channel, band) matrix for one draw of both paints."""
    drawn = {colour: _draw(finger.paints[colour], calibrations.get(colour), rng) for colour in ("red", "green")}
    bands = paint_bands(drawn["red"], drawn["green"], finger.design.light)
    gain = [bands.energy_conversion[c] / mean.energy_conversion[c] for c in ("red", "green")]
    return np.asarray(finger.camera_matrix(bands) * np.array([*gain, 1.0]))


def _draw(paint: PaintOptics, calibration: PaintCalibration | None, rng: np.random.Generator) -> PaintOptics:
    """Return the paint with the emission of one posterior draw (or as it is, without a calibration)."""
    if calibration is None:
        return paint
    emission = calibration.emission_draws_per_nm[rng.integers(len(calibration.emission_draws_per_nm))]
    return replace(paint, emission_per_nm=emission)


#: Tilts of facets: small ones for the derivative, then as much as an indentation gives, every quarter turn.
SMALL_TILT_DEG: Final = 4.0
OTHER_TILTS_DEG: Final = ((12.0, 45.0), (20.0, 0.0))
QUARTERS: Final = 4
CLIPPED_LIMIT: Final = 0.001
#: Three standard deviations of the shot noise of a full well of 5,000 e below full scale.
BRIGHT_SHARE: Final = 0.95
#: By which boxes that are near each other are widened: far above rounding.
_TOUCH_MM: Final = 1e-6


@dataclass(frozen=True, slots=True)
class FacetTable:
    """Camera signals of facets at each angle; the first facet is the coat without contact, the next four tilt little.

    Attributes
    ----------
    signal_e
        Mean signals, (angle, repeat, point, facet, 3), at an exposure set again at each angle and repeat.
    slopes
        (facet, 2), see :func:`facet_slopes`.
    places_mm
        (x, z) on the undeformed pad, (point, 2).
    exposure_rel
        Exposure time that this takes, relative to the shortest, (angle,).
    clipped_share
        Share of the pixels of the pressed coat with a channel at full scale, (angle,).
    """

    signal_e: Floats
    slopes: Floats
    places_mm: Floats
    exposure_rel: Floats
    clipped_share: Floats


def facet_slopes() -> Floats:
    """Return the slopes of the facets, (facet, 2): none, then four of each tilt, a quarter turn apart."""
    slopes = [np.zeros((1, 2))]
    for tilt_deg, first_deg in ((SMALL_TILT_DEG, 0.0), *OTHER_TILTS_DEG):
        turn = np.radians(first_deg + 360.0 / QUARTERS * np.arange(QUARTERS))
        slopes.append(np.tan(np.radians(tilt_deg)) * np.column_stack([np.cos(turn), np.sin(turn)]))
    return np.concatenate(slopes)


def facet_shares(rest: FingerShape, pressed: FingerShape) -> Floats:
    """Return which share of the pressed coat each facet stands for, (facet,): a press tilts little of it much."""
    tilts_deg = np.array([0.0, SMALL_TILT_DEG, *(tilt for tilt, _ in OTHER_TILTS_DEG)])
    none, *turned = tilt_shares(rest, pressed, tilts_deg)
    return np.concatenate([[none], np.repeat(np.array(turned) / QUARTERS, QUARTERS)])


def facet_table(
    finger: PaintedFinger,
    points: SeenPoints,
    designs: Sequence[FingerDesign],
    to_camera: Floats,
    sensor: Sensor,
    paths: ProbePaths,
    shapes: tuple[FingerShape, FingerShape],
    progress: Progress | None = None,
) -> FacetTable:
    """Trace the facets for all angles and expose them.

    Parameters
    ----------
    finger
        Paints and renderer.
    points
        Where facets stand and how the camera sees them.
    designs
        The finger at each light angle.
    to_camera
        From bands to camera for each repeat, (repeat, 3, 3).
    sensor
        Full scale of the camera.
    paths
        Directions per point and repeat; as many repeats as camera matrices.
    shapes
        The finger without contact, where light is traced, and with contact, which says how much of it is tilted.
    progress
        Called after each repeat.

    Raises
    ------
    SimulateError
        When the coat is black at some angle.
    """
    slopes, bands = facet_slopes(), check_paints(finger.design, finger.paints)
    facets = tilted_facets(points.normals, slopes)
    basis = measure_together(designs, shapes[0], bands, finger.renderer, points.probes, facets, paths, progress)
    rgb = np.einsum("rcb,arfpb->arpfc", to_camera, basis)
    return exposed_table(rgb, points.places_mm, facet_shares(*shapes), sensor)


def exposed_table(rgb: Floats, places_mm: Floats, shares: Floats, sensor: Sensor) -> FacetTable:
    """Expose camera radiances as long as less than `CLIPPED_LIMIT` of the pressed coat is clipped.

    Parameters
    ----------
    rgb
        (angle, repeat, point, facet, 3), any linear unit.
    places_mm
        (point, 2).
    shares
        Share of the pressed coat that each facet stands for, (facet,).
    sensor
        Full scale.

    Raises
    ------
    SimulateError
        When the coat is black at some angle.
    """
    angles, repeats, points = rgb.shape[:3]
    brightest = rgb.max(axis=-1).reshape(angles, repeats, -1)
    order = np.argsort(-brightest, axis=-1)
    covered = np.cumsum(np.tile(shares / points, points)[order], axis=-1)
    last = (covered < CLIPPED_LIMIT).sum(axis=-1, keepdims=True)
    level = np.take_along_axis(np.take_along_axis(brightest, order, axis=-1), last, axis=-1)[..., 0]
    if not (level > 0.0).all():
        raise ImpossibleFingerError(
            "the coat is black at some light angle, so no exposure can be set; check the light panel"
        )
    full_e = (sensor.full_scale_dn - sensor.black_level_dn) * sensor.gain_e_per_dn
    signal_e = rgb * (BRIGHT_SHARE * full_e / level)[:, :, None, None, None]
    clipped = (signal_e >= full_e).any(axis=-1).mean(axis=(1, 2)) @ shares
    time = 1.0 / level.mean(axis=1)
    return FacetTable(signal_e, facet_slopes(), places_mm, time / time.min(), np.asarray(clipped))


def noise_variance_e2(signal_e: Floats, sensor: Sensor, exposure_s: float) -> Floats:
    """Return the temporal variance of signals (e^2): read^2 + gain^2 / 12 of rounding + dark charge + the signal."""
    dark_e = sensor.dark_current_e_per_s * exposure_s
    return np.asarray(sensor.read_noise_e**2 + sensor.gain_e_per_dn**2 / 12.0 + dark_e + signal_e)


def frames_e(signal_e: Floats, frames: int, sensor: Sensor, exposure_s: float, rng: np.random.Generator) -> Floats:
    """Return noisy frames (point, facet, frame, 3) of signals (point, facet, 3), black level removed, in e."""
    points, facets, channels = signal_e.shape
    rate = np.repeat(signal_e[:, :, None] / exposure_s, frames, axis=2).reshape(points * facets, frames * channels)
    counts = sensor.expose(rate, exposure_s, rng).astype(np.float64) - sensor.black_level_dn
    return np.asarray(sensor.gain_e_per_dn * counts).reshape(points, facets, frames, channels)


POINTS_ACROSS: Final = 5
POINTS_ALONG: Final = 6
REPEATS: Final = 4
#: Directions per point and repeat. Four times as many lower the held-out error by 3 % at all angles alike.
RAYS: Final = 8192
FRAMES: Final = 4
WORST_TENTH: Final = 0.9

_SEEN = (
    "facets of the undeformed coat, seen through the mirror, one pixel of each colour; the exposure is set "
    f"for each angle, as long as possible with less than {100 * CLIPPED_LIMIT:g} % of the pressed coat clipped"
)


def angle_objectives(
    finger: PaintedFinger,
    to_camera: Floats,
    angles_deg: Sequence[float] | Floats,
    seed: int,
    rays: int = RAYS,
    progress: Progress | None = None,
    shapes: tuple[FingerShape, FingerShape] | None = None,
) -> tuple[tuple[AngleObjective, ...], AngleConstraints]:
    """Measure Fisher information, held-out normal error, uniformity and constraints over the light angle.

    Parameters
    ----------
    finger
        Design, paints, camera and renderer; its own light angle is replaced.
    to_camera
        From bands to camera for the paint draw of each repeat, (repeat, 3, 3), the same at all angles.
    angles_deg
        Light angles.
    seed
        Of paths and of the camera's noise.
    rays
        Directions per point and repeat.
    progress
        Called after each repeat.
    shapes
        The finger without and with contact; by default the design's indenter is pressed in analytically. The one with
        contact only says how much of the picture is tilted.

    Raises
    ------
    SimulateError
        With a scalar renderer, when the camera sees too little of the pad, or when the colours of some place do not
        tell its normal.
    """
    require_compiled(finger)
    rest, pressed = shapes or (rest_shape(finger.design), pressed_shape(finger.design))
    points = seen_points(finger.design, rest, finger.renderer, POINTS_ACROSS, POINTS_ALONG, finger.calibration)
    designs = [with_light_angle(finger.design, float(angle)) for angle in angles_deg]
    sensor = tactile_sensor(finger.design, seed)
    paths = ProbePaths(rays, len(to_camera), seed)
    table = facet_table(finger, points, designs, to_camera, sensor, paths, (rest, pressed), progress)
    return objectives_of(table, sensor, seed), AngleConstraints(
        clipped_share=table.clipped_share,
        clipped_limit_share=CLIPPED_LIMIT,
        exposure_rel=table.exposure_rel,
        in_the_way=tuple(panels_in_the_way(design, rest) for design in designs),
    )


def require_compiled(finger: PaintedFinger) -> None:
    """Refuse a scalar renderer, before anything else is measured.

    Raises
    ------
    SimulateError
        When light cannot be traced once for all angles.
    """
    if finger.renderer.variant() == SCALAR_VARIANT:
        raise SimulateError(
            "the other objectives need a compiled variant of Mitsuba, because light is traced once for all angles; "
            "leave out --engine scalar, and make sure that LLVM is installed, or give --objectives intensity"
        )


def objectives_of(table: FacetTable, sensor: Sensor, seed: int) -> tuple[AngleObjective, ...]:
    """Return the objectives of a table of signals, noise added with `seed`.

    Raises
    ------
    SimulateError
        When the colours of some place do not tell its normal.
    """
    sigma_deg = normal_sigmas_deg(table, sensor)
    blind = np.argwhere(~np.isfinite(sigma_deg))
    if blind.size:
        x_mm, z_mm = table.places_mm[blind[0, 2]]
        raise SimulateError(
            f"no normal can be computed at x = {x_mm:.1f} mm, z = {z_mm:.1f} mm, because the colours of the coat do "
            "not change there with its direction in two independent ways; check the paints of both walls and the "
            "camera's response"
        )
    median, worst = np.median(sigma_deg, axis=2), np.quantile(sigma_deg, WORST_TENTH, axis=2)
    tilt_deg = max(tilt for tilt, _ in OTHER_TILTS_DEG)
    return (
        _smaller_is_better(
            "normal from one pixel",
            f"standard deviation of the normal by Fisher information (Cramer-Rao), median over the pad; {_SEEN}",
            median,
        ),
        _smaller_is_better(
            "normal from one pixel, worst tenth of the pad", f"the same, 90 % quantile over the pad; {_SEEN}", worst
        ),
        _held_out_error(table, sensor, seed),
        AngleObjective(
            name="uniformity",
            meaning="ratio of the 5 % and the 95 % quantile over the pad of the luminance without contact, mean of "
            "R, G and B, each relative to its mean over the pad",
            unit="1",
            larger_is_better=True,
            values=uniformities(table),
        ),
        AngleObjective(
            name="colour separation",
            meaning="angle between the colours (R, G and B, each relative to no contact) of facets tilted "
            f"{tilt_deg:g} deg to opposite sides, mean of across and along the pad, median over the pad",
            unit="deg",
            larger_is_better=True,
            values=np.median(colour_separations_deg(table), axis=2),
        ),
    )


def normal_sigmas_deg(table: FacetTable, sensor: Sensor) -> Floats:
    """Return the Cramer-Rao bound of the normal in deg, (angle, repeat, point), by differences of the small facets."""
    # facets 1 to 4 stand at 0, 90, 180 and 270 deg
    right, up, left, down = (table.signal_e[..., k, :] for k in range(1, 5))
    jacobian = np.stack([right - left, up - down], axis=-1) / (2.0 * np.tan(np.radians(SMALL_TILT_DEG)))
    return normal_sigma_deg(jacobian, noise_variance_e2(table.signal_e[..., 0, :], sensor, EXPOSURE_S))


def _held_out_error(table: FacetTable, sensor: Sensor, seed: int) -> AngleObjective:
    """Return the error of normals at places that did not teach the map, all over the pad and along it."""
    places_mm, row_of_point = rows_along(table.places_mm[:, 1])
    errors_deg = held_out_errors_deg(table, sensor, seed)
    by_row = np.stack([errors_deg[..., row_of_point == row].mean(axis=-1) for row in range(len(places_mm))], axis=-1)
    tilt_deg = max(tilt for tilt, _ in OTHER_TILTS_DEG)
    return AngleObjective(
        name="held-out normal error",
        meaning="mean angle between true and estimated normals at places left out of the calibration of a cubic "
        f"map (colour relative to no contact, place) -> slopes; facets tilted by 0 to {tilt_deg:g} deg, sensor "
        f"noise; {_SEEN}",
        unit="deg",
        larger_is_better=False,
        values=errors_deg.mean(axis=-1),
        place_values=by_row,
        places_mm=places_mm,
    )


def rows_along(z_mm: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return the rows of the grid of points: their mean places along the pad (row,), and the row of each point."""
    low, high = float(z_mm.min()), float(z_mm.max())
    step = max(high - low, np.finfo(np.float64).tiny) / (POINTS_ALONG - 1)
    _, row_of_point = np.unique(np.rint((z_mm - low) / step), return_inverse=True)
    places = np.array([z_mm[row_of_point == row].mean() for row in range(row_of_point.max() + 1)])
    return places, row_of_point.astype(np.int64)


def colour_separations_deg(table: FacetTable) -> Floats:
    """Return the angle between the colours of facets that tilt most to opposite sides, (angle, repeat, point)."""
    relative = table.signal_e[..., -QUARTERS:, :] / table.signal_e[..., :1, :]
    direction = relative / np.linalg.norm(relative, axis=-1, keepdims=True)
    # facets stand a quarter turn apart: opposite ones two places from each other; exact for small angles
    apart = np.linalg.norm(direction[..., :2, :] - direction[..., 2:, :], axis=-1)
    return np.asarray(np.degrees(2.0 * np.arcsin(apart / 2.0)).mean(axis=-1))


def held_out_errors_deg(table: FacetTable, sensor: Sensor, seed: int, taught: FacetTable | None = None) -> Floats:
    """Return the mean errors at held-out points in deg, (angle, repeat, point); angles share the seeds of the noise.

    Parameters
    ----------
    table
        Signals.
    sensor
        Noise of the camera.
    seed
        Of the noise.
    taught
        Signals of the finger that was calibrated, at points near those of the table; by default it is the same one.
    """
    angles, repeats, points = table.signal_e.shape[:3]
    error_deg = np.empty((angles, repeats, points))
    if taught is not None:
        near = cKDTree(taught.places_mm).query(table.places_mm)[1]
        taught = replace(taught, signal_e=taught.signal_e[:, :, near], places_mm=taught.places_mm[near])
    for angle, repeat in np.ndindex(angles, repeats):
        noise = [seed, repeat]
        relative = _relative_frames(table.signal_e[angle, repeat], sensor, noise)
        teaching = None if taught is None else _relative_frames(taught.signal_e[angle, repeat], sensor, noise)
        found_deg = held_out_normal_error_deg(relative, table.places_mm, table.slopes, taught=teaching)
        error_deg[angle, repeat] = found_deg.mean(axis=(1, 2))
    return error_deg


def _relative_frames(signal_e: Floats, sensor: Sensor, seed: list[int]) -> Floats:
    """Return noisy frames relative to no contact, (point, facet, frame, 3).

    The picture without contact is each finger's own and a mean of many frames: without noise of its own.
    """
    return frames_e(signal_e, FRAMES, sensor, EXPOSURE_S, np.random.default_rng(seed)) / signal_e[:, :1, None]


def uniformities(table: FacetTable) -> Floats:
    """Return the uniformity of the coat without contact, (angle, repeat)."""
    white_e = table.signal_e[..., 0, :]
    luminance = (white_e / white_e.mean(axis=2, keepdims=True)).mean(axis=-1)
    return np.asarray(np.apply_along_axis(uniformity, 2, luminance))


def _smaller_is_better(name: str, meaning: str, values_deg: Floats) -> AngleObjective:
    """Return an objective that is an angular error."""
    return AngleObjective(name=name, meaning=meaning, unit="deg", larger_is_better=False, values=values_deg)


def panels_in_the_way(design: FingerDesign, shape: FingerShape) -> str:
    """Return the name of the first surface that any panel passes through, or an empty text when all fit."""
    return next(filter(None, (in_the_way(panel, shape) for panel in design.lights)), "")


def in_the_way(light: LightPanel, shape: FingerShape) -> str:
    """Return the name of the first surface that the panel passes through, or an empty text when it fits.

    Panels are sheets without thickness, so a fit is necessary but not sufficient: housing and wires need room too.
    """
    panel = panel_surface(light)
    for name, surface in shape.surfaces.items():
        near = _near(surface, panel)
        if near is None:
            continue
        try:
            check_no_intersections({"light panel": panel, name: near})
        except SimulateError:
            return name
    return ""


def _near(surface: Surface, panel: Surface) -> Surface | None:
    """Return the triangles of a surface whose boxes reach into the panel's box, which alone can meet it, if any."""
    corners = surface.vertices_mm[surface.triangles]
    low, high = panel.vertices_mm.min(axis=0) - _TOUCH_MM, panel.vertices_mm.max(axis=0) + _TOUCH_MM
    reached = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    if not reached.any():
        return None
    used, place = np.unique(surface.triangles[reached], return_inverse=True)
    return Surface(surface.vertices_mm[used], place.reshape(-1, 3), surface.uv[used])


def panel_surface(light: LightPanel) -> Surface:
    """Return a light panel as two triangles."""
    frame = panel_frame(light)
    sides = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corners = frame.centre_mm + sides[:, :1] * frame.half_across_mm + sides[:, 1:] * frame.half_along_mm
    return Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), (sides + 1.0) / 2.0)
