"""Dark level of the region at every exposure time, from the dark frames before and after a session."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, Frame
from data_schemas.errors import RadiometryError
from finray_calib.radiometry.camera_noise import noise_variance_dn2
from finray_calib.radiometry.region import region_means

Floats = NDArray[np.float64]
ReadFrame = Callable[[Frame], NDArray[np.uint16]]


@dataclass(frozen=True, slots=True)
class DarkLevel:
    """Mean dark level of the region at one exposure time, channels red, green, blue.

    Attributes
    ----------
    level_dn, noise_variance
        (3,) level (DN) and the variance of its noise (DN^2); both are shared by every step of this exposure time.
    thermal_dn
        Level above that of the shortest exposure (DN): dark current, which brings shot noise of its own.
    drift_dn
        Change of the level from before to after the session (DN).
    drift_variance_dn2
        What that drift adds (DN^2), common to the channels: the level at the time of a frame lies evenly between.
    """

    level_dn: Floats
    noise_variance: Floats
    thermal_dn: float
    drift_dn: float
    drift_variance_dn2: float


def dark_levels(session: CaptureSession, read: ReadFrame) -> dict[float, DarkLevel]:
    """Return the dark level for each exposure time asked for (what is read back may jitter).

    Raises
    ------
    RadiometryError
        The session has no dark frames.
    """
    means: dict[float, list[Floats]] = {}
    pixels = np.ones(3)
    full_scale_dn = 2**session.rig.camera.bit_depth - 1
    for frame in session.frames:
        if frame.frame_type == "dark":
            reduced = region_means(read(frame), session.plan.region, full_scale_dn)
            means.setdefault(frame.exposure_requested_s, []).append(reduced.mean_dn)
            pixels = reduced.pixels
    if not means:
        raise RadiometryError("session.frames: no dark frames; capture darks before and after the session")
    thermal_dn = thermal_levels_dn({exposure_s: float(np.mean(rows)) for exposure_s, rows in means.items()})
    return {
        exposure_s: _level(np.array(rows), noise_variance_dn2(level, session.rig.camera) / pixels, level)
        for (exposure_s, rows), level in zip(means.items(), thermal_dn.values(), strict=True)
    }


def thermal_levels_dn(level_dn: dict[float, float]) -> dict[float, float]:
    """Return the dark level of each exposure time (s) above that of the shortest one (DN, at least 0)."""
    lowest_dn = level_dn[min(level_dn)]
    return {exposure_s: max(level - lowest_dn, 0.0) for exposure_s, level in level_dn.items()}


def _level(rows: Floats, noise: Floats, thermal_dn: float) -> DarkLevel:
    """Reduce the (frames, 3) means of one exposure time; noise (3,) is the variance of one frame's means."""
    half = len(rows) // 2
    drift_dn = float(np.mean(rows[half:]) - np.mean(rows[:half])) if half else 0.0
    by_chance = float(noise.sum() / 9) * (1 / half + 1 / (len(rows) - half)) if half else 0.0
    # Evenly distributed over +- drift / 2: a variance of drift^2 / 12.
    drift_variance_dn2 = max(drift_dn**2 - by_chance, 0.0) / 12
    return DarkLevel(rows.mean(axis=0), noise / len(rows), thermal_dn, drift_dn, drift_variance_dn2)
