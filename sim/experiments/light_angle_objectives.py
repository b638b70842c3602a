"""Further objectives of the light angle: how well the camera then tells the direction of the touched surface.

All are measured on small facets of the undeformed coat, seen as the camera sees them through mirror and gel.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SimulateError
from data_schemas.simulate import AngleConstraints, AngleObjective
from finray_calib.compare.angle_objectives import held_out_normal_error_deg, normal_sigma_deg, uniformity
from rigs.simulated.sensor import Sensor
from sim.experiments.facet_table import (
    CLIPPED_LIMIT,
    OTHER_TILTS_DEG,
    SMALL_TILT_DEG,
    FacetTable,
    facet_table,
    frames_e,
    noise_variance_e2,
)
from sim.experiments.painted_finger import PaintedFinger
from sim.experiments.tactile_camera import EXPOSURE_S, tactile_sensor
from sim.optics.angle_batches import at_angle
from sim.optics.facets import seen_points
from sim.optics.panel_conflicts import in_the_way
from sim.optics.render import Progress
from sim.optics.variants import SCALAR_VARIANT
from sim.surface_meshes.finger_shape import FingerShape, pressed_shape, rest_shape

Floats = NDArray[np.float64]

POINTS_ACROSS: Final = 5
POINTS_ALONG: Final = 6
REPEATS: Final = 4
#: Directions per point and repeat. Four times as many lower the held-out error by 3 % at all angles alike.
RAYS: Final = 8192
FRAMES: Final = 4
WORST_TENTH: Final = 0.9

_SEEN = (
    "facets of the undeformed coat, seen through the mirror, one pixel of each colour; exposure set anew at each "
    f"angle, as long as it clips less than {CLIPPED_LIMIT:.1%} of the pressed coat"
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
    designs = [at_angle(finger.design, float(angle)) for angle in angles_deg]
    sensor = tactile_sensor(finger.design, seed)
    table = facet_table(finger, points, designs, to_camera, sensor, seed, rays, (rest, pressed), progress)
    return objectives_of(table, sensor, seed), AngleConstraints(
        clipped_share=table.clipped_share,
        clipped_limit_share=CLIPPED_LIMIT,
        exposure_rel=table.exposure_rel,
        in_the_way=tuple(in_the_way(design.light, rest) for design in designs),
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
            "the other objectives trace light once for all angles, which needs a compiled variant; leave out --engine "
            "scalar (LLVM must be installed), or ask for --objectives intensity"
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
            f"at x = {x_mm:.1f} mm, z = {z_mm:.1f} mm the colours of the coat do not change with its direction in two "
            "independent ways: no normal can be told; check the paints of both walls and the camera's response"
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
        _smaller_is_better(
            "held-out normal error",
            "mean angle between true and estimated normals at places left out of the calibration of a cubic map "
            f"(colour relative to no contact, place) -> slopes; facets tilted by 0 to {tilt_deg:g} deg, sensor noise; "
            f"{_SEEN}",
            held_out_errors_deg(table, sensor, seed),
        ),
        AngleObjective(
            name="uniformity",
            meaning="5 % over 95 % quantile over the pad of the luminance without contact, mean of R, G and B, each "
            "relative to its mean over the pad",
            unit="1",
            larger_is_better=True,
            values=_uniformities(table),
        ),
    )


def normal_sigmas_deg(table: FacetTable, sensor: Sensor) -> Floats:
    """Return the Cramer-Rao bound of the normal in deg, (angle, repeat, point), by differences of the small facets."""
    # facets 1 to 4 stand at 0, 90, 180 and 270 deg
    right, up, left, down = (table.signal_e[..., k, :] for k in range(1, 5))
    jacobian = np.stack([right - left, up - down], axis=-1) / (2.0 * np.tan(np.radians(SMALL_TILT_DEG)))
    return normal_sigma_deg(jacobian, noise_variance_e2(table.signal_e[..., 0, :], sensor, EXPOSURE_S))


def held_out_errors_deg(table: FacetTable, sensor: Sensor, seed: int) -> Floats:
    """Return the mean error of held-out places in deg, (angle, repeat); angles share the noise's seed of a repeat."""
    angles, repeats = table.signal_e.shape[:2]
    error_deg = np.empty((angles, repeats))
    for angle, repeat in np.ndindex(angles, repeats):
        signal_e = table.signal_e[angle, repeat]
        seen_e = frames_e(signal_e, FRAMES, sensor, EXPOSURE_S, np.random.default_rng([seed, repeat]))
        # the picture without contact is a mean of many frames: without noise of its own
        relative = seen_e / signal_e[:, :1, None]
        error_deg[angle, repeat] = held_out_normal_error_deg(relative, table.places_mm, table.slopes).mean()
    return error_deg


def _uniformities(table: FacetTable) -> Floats:
    """Return the uniformity of the coat without contact, (angle, repeat)."""
    white_e = table.signal_e[..., 0, :]
    luminance = (white_e / white_e.mean(axis=2, keepdims=True)).mean(axis=-1)
    return np.asarray(np.apply_along_axis(uniformity, 2, luminance))


def _smaller_is_better(name: str, meaning: str, values_deg: Floats) -> AngleObjective:
    """Return an objective that is an angular error."""
    return AngleObjective(name=name, meaning=meaning, unit="deg", larger_is_better=False, values=values_deg)
