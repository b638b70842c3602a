"""Camera signals of small tilted facets of the coat at each light angle: what objectives of sensing rest on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from rigs.simulated.sensor import Sensor
from sim.experiments.painted_finger import PaintedFinger
from sim.optics.angle_batches import measure_together
from sim.optics.facets import SeenPoints, tilt_shares, tilted
from sim.optics.lit_scene import check_paints
from sim.optics.render import Progress
from sim.surface_meshes.finger_shape import FingerShape

Floats = NDArray[np.float64]

#: Tilts of facets: small ones for the derivative, then as much as an indentation gives, every quarter turn.
SMALL_TILT_DEG: Final = 4.0
OTHER_TILTS_DEG: Final = ((12.0, 45.0), (20.0, 0.0))
QUARTERS: Final = 4
CLIPPED_LIMIT: Final = 0.001
#: Three standard deviations of the shot noise of a full well of 5,000 e below full scale.
BRIGHT_SHARE: Final = 0.95


@dataclass(frozen=True, slots=True)
class FacetTable:
    """Camera signals of facets at each angle; the first facet is the coat without contact, the next four tilt little.

    Attributes
    ----------
    signal_e
        Mean signals, (angle, repeat, point, facet, 3), at an exposure set anew at each angle and repeat.
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
    seed: int,
    rays: int,
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
    seed, rays
        Random seed, and directions per point and repeat.
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
    facets = tilted(points.normals, slopes)
    basis = measure_together(
        designs, shapes[0], bands, finger.renderer, points.probes, facets, rays, len(to_camera), seed, progress
    )
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
        raise SimulateError("the coat is black at some light angle: no exposure can be set; check the light panel")
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
