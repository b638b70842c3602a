"""Exposures of a camera session: even steps up to beyond the saturation of every channel."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.camera import CameraPlan
from data_schemas.devices import CameraSettings
from data_schemas.errors import CaptureError

Counts = NDArray[np.uint16]
# The last level lies this far beyond saturation, so that the variance is seen to fall.
BEYOND_SATURATION = 1.15
# Fewer levels than planned fit below saturation when the shortest exposure is already this bright.
LARGEST_FIRST_FRACTION = 0.25
# A channel that needs exposures this many times longer is measured while the brightest is heavily saturated.
LARGEST_CHANNEL_RATIO = 10.0


def saturation_exposures_s(counts: Counts, exposure_s: float, camera: CameraSettings) -> dict[str, float]:
    """Return the exposure (s) that brings the mean of each channel to full scale, from one frame of the region.

    Parameters
    ----------
    counts
        Counts of the region (DN), shape (h, w), whole 2 x 2 cells.
    exposure_s
        Exposure of the frame (s).
    camera
        Its black level and bit depth.
    """
    sites = {"red": counts[0::2, 0::2], "blue": counts[1::2, 1::2]}
    sites["green"] = np.stack([counts[0::2, 1::2], counts[1::2, 0::2]])
    room_dn = 2**camera.bit_depth - 1 - camera.black_level_dn
    signal_dn = {name: float(pixels.mean()) - camera.black_level_dn for name, pixels in sites.items()}
    # Half a count is the least that is told from the black level of the rig file; dimmer channels count as that dim.
    return {name: exposure_s * room_dn / max(signal, 0.5) for name, signal in signal_dn.items()}


def level_exposures_s(saturation_s: dict[str, float], plan: CameraPlan, camera: CameraSettings) -> tuple[float, ...]:
    """Return the exposures (s) of the lit levels, increasing.

    The brightest channel gets `plan.levels` even steps to 1.15 of its saturation; every dimmer one goes on from there
    with its own steps, below which it has the finer ones of the channels before it.

    Raises
    ------
    CaptureError
        The shortest exposure is too long for even steps up to the first saturation, or none saturates.
    """
    longest_s = min(plan.longest_exposure_s, camera.longest_exposure_s)
    first_s = min(saturation_s.values())
    if camera.shortest_exposure_s > LARGEST_FIRST_FRACTION * first_s:
        raise CaptureError(
            f"camera: the white tile saturates in {first_s:.3g} s, the shortest exposure is "
            f"{camera.shortest_exposure_s:g} s and may be at most {LARGEST_FIRST_FRACTION:g} of that: dim the lamp, "
            "close the aperture or put a filter in the beam (plan.filter_name)"
        )
    if BEYOND_SATURATION * first_s > longest_s:
        raise CaptureError(
            f"camera: the white tile needs {BEYOND_SATURATION * first_s:.3g} s to saturate, at most {longest_s:g} s "
            "are allowed: brighten the lamp, or raise plan.longest_exposure_s or camera.longest_exposure_s"
        )
    exposures: list[float] = []
    for sat_s in sorted(saturation_s.values()):
        top_s = min(BEYOND_SATURATION * sat_s, longest_s)
        steps = np.linspace(max(top_s / plan.levels, camera.shortest_exposure_s), top_s, plan.levels)
        # 2 % apart is another level; closer ones would only repeat it.
        exposures += [float(t) for t in steps if t > 1.02 * max(exposures, default=0.0)]
    return tuple(exposures)


def level_notes(saturation_s: dict[str, float], plan: CameraPlan, camera: CameraSettings) -> tuple[str, ...]:
    """Return what the user should know about channels that are much dimmer than the brightest."""
    longest_s = min(plan.longest_exposure_s, camera.longest_exposure_s)
    first_s = min(saturation_s.values())
    notes = []
    for name, sat_s in saturation_s.items():
        if sat_s > longest_s:
            notes.append(
                f"{name} does not saturate within {longest_s:g} s: use a lamp or filter with more {name} light"
            )
        elif sat_s > LARGEST_CHANNEL_RATIO * first_s:
            notes.append(
                f"{name} saturates {sat_s / first_s:.0f} times later than the brightest channel: charge that spills "
                "over from saturated neighbours may disturb it"
            )
    return tuple(notes)
