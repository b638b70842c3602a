"""Characterise a camera from a camera session: frames by exposure, channel by channel, to EMVA 1288 quantities."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from data_schemas.camera import (
    FEWEST_LEVELS,
    CameraCharacterisation,
    CameraSession,
    ChannelCharacterisation,
    ChannelName,
)
from data_schemas.capture import Frame, FrameType
from data_schemas.errors import RadiometryError
from finray_calib.radiometry.channel_characterisation import ChannelLevels, characterise_channel
from finray_calib.radiometry.frame_stack import FrameStack, Sites, StackStatistics
from finray_calib.radiometry.photon_transfer import SMALLEST_CHI_SQUARE_P
from finray_calib.radiometry.pixel_merge import cut
from finray_calib.radiometry.region import whole_cells

ReadCounts = Callable[[Frame], NDArray[np.uint16]]
CHANNELS: dict[str, dict[ChannelName, Sites]] = {
    "RGGB": {"red": ((0, 0, 2),), "green": ((0, 1, 2), (1, 0, 2)), "blue": ((1, 1, 2),)},
}
# EMVA 1288 asks for an offset at which at most 0.5 % of the dark counts fall to zero.
LARGEST_EMPTY_FRACTION = 0.005
# A smaller dark variance is mostly that of rounding (EMVA 1288).
SMALLEST_DARK_VARIANCE_DN2 = 0.24


@dataclass(frozen=True, slots=True)
class _Stack:
    """Equal exposures: exposure time and the statistics of every channel."""

    exposure_s: float
    channels: tuple[StackStatistics, ...]


def characterise_camera(session: CameraSession, read: ReadCounts) -> CameraCharacterisation:
    """Turn a camera session into gain, noise, dark current, saturation, linearity, PRNU and DSNU of every channel.

    Frames are read one at a time; memory does not grow with their number.

    Parameters
    ----------
    session
        A finished camera session.
    read
        Returns the raw counts of a frame of the session (checks its checksum).

    Raises
    ------
    RadiometryError
        Too few exposures, no dark frames, a channel that is saturated everywhere, frames without noise or of
        unequal size.
    """
    sites = CHANNELS[session.rig.camera.bayer_pattern]
    lit = _stacks(session, "white", tuple(sites.values()), read)
    dark = _stacks(session, "dark", tuple(sites.values()), read)
    _require_levels(lit, dark)
    repeatability_rel = _repeatability_rel(lit, dark)
    channels = []
    for index, name in enumerate(sites):
        levels = ChannelLevels(
            exposure_s=np.array([stack.exposure_s for stack in lit.values()]),
            lit=tuple(stack.channels[index] for stack in lit.values()),
            dark=tuple(dark[asked_s].channels[index] for asked_s in lit),
            dark_exposure_s=np.array([stack.exposure_s for stack in dark.values()]),
            all_dark=tuple(stack.channels[index] for stack in dark.values()),
        )
        channels.append(characterise_channel(name, levels, repeatability_rel))
    empty_fraction = max(s.empty_fraction for stack in dark.values() for s in stack.channels)
    return CameraCharacterisation(
        camera_name=session.plan.camera_name,
        camera=session.rig.camera,
        filter_name=session.plan.filter_name,
        channels=tuple(channels),
        light_repeatability_rel=repeatability_rel,
        warnings=_warnings(channels, empty_fraction),
        notes=session.notes,
    )


def _stacks(
    session: CameraSession, frame_type: FrameType, sites: tuple[Sites, ...], read: ReadCounts
) -> dict[float, _Stack]:
    """Return the stacks of one frame type by the exposure that was asked for (s), in its order."""
    grouped: dict[float, list[Frame]] = {}
    for frame in session.frames:
        if frame.frame_type == frame_type:
            grouped.setdefault(frame.exposure_requested_s, []).append(frame)
    full_scale_dn, region = 2**session.rig.camera.bit_depth - 1, whole_cells(session.plan.region)
    stacks = {}
    for asked_s, frames in sorted(grouped.items()):
        stack = FrameStack(f"{frame_type} frames of {asked_s:g} s", sites, full_scale_dn)
        for frame in frames:
            stack.add(cut(read(frame), region))
        stacks[asked_s] = _Stack(float(np.mean([f.exposure_s for f in frames])), stack.statistics())
    return stacks


def _require_levels(lit: dict[float, _Stack], dark: dict[float, _Stack]) -> None:
    """Refuse too few exposures, and flat frames without dark ones of the same exposure."""
    if len(lit) < FEWEST_LEVELS:
        raise RadiometryError(
            f"session.frames: flat frames at {len(lit)} exposures, at least {FEWEST_LEVELS} are needed: raise "
            "plan.levels and capture again"
        )
    lost = [asked_s for asked_s in lit if asked_s not in dark]
    if lost:
        raise RadiometryError(
            f"session.frames: no dark frames of {', '.join(f'{t:g} s' for t in lost[:3])} ({len(lost)} of {len(lit)} "
            "exposures lack them); capture them at every exposure of the flat frames"
        )


def _repeatability_rel(lit: dict[float, _Stack], dark: dict[float, _Stack]) -> float:
    """Return the relative standard deviation of the light from frame to frame, without the pixels' noise."""
    excess, freedom = 0.0, 0
    for asked_s, stack in lit.items():
        pairs = [
            (c, d) for c, d in zip(stack.channels, dark[asked_s].channels, strict=True) if c.saturated_fraction == 0
        ]
        if not pairs:
            continue
        bright, black = max(pairs, key=lambda pair: pair[0].mean_dn)
        signal_dn = bright.mean_dn - black.mean_dn
        if signal_dn > 0.0:
            flicker_dn2 = float(np.var(bright.frame_means_dn, ddof=1)) - bright.variance_dn2 / bright.pixels
            excess += (bright.frames - 1) * flicker_dn2 / signal_dn**2
            freedom += bright.frames - 1
    return float(np.sqrt(max(excess, 0.0) / max(freedom, 1)))


def _warnings(channels: list[ChannelCharacterisation], empty_fraction: float) -> tuple[str, ...]:
    """Say in words what a user must know before trusting the numbers."""
    warnings = []
    for c in channels:
        if c.chi_square_p < SMALLEST_CHI_SQUARE_P:
            warnings.append(
                f"{c.channel}: variance against mean is no straight line (chi-square {c.chi_square:.0f} for "
                f"{c.degrees_of_freedom} degrees of freedom); intervals of gain and read noise are widened: look for "
                "gamma, noise reduction or a drifting lamp"
            )
        if c.saturation_dn is None:
            warnings.append(f"{c.channel}: no exposure saturates, so that saturation and dynamic range are not known")
        if np.median(c.curve.dark_variance_dn2) < SMALLEST_DARK_VARIANCE_DN2:
            warnings.append(
                f"{c.channel}: the dark variance is below {SMALLEST_DARK_VARIANCE_DN2:g} DN^2, where rounding hides "
                "the read noise; raise the camera's gain or bit depth to resolve it"
            )
    if empty_fraction > LARGEST_EMPTY_FRACTION:
        warnings.append(
            f"{empty_fraction:.1%} of the dark counts are 0 (at most {LARGEST_EMPTY_FRACTION:.1%} is allowed): the "
            "read noise comes out too small; raise the camera's black level"
        )
    gain = np.array([c.gain_e_per_dn.estimate for c in channels])
    weight = np.array([1.0 / c.gain_e_per_dn.sd**2 for c in channels])
    chi_square = float(np.sum(weight * (gain - np.average(gain, weights=weight)) ** 2))
    if len(channels) > 1 and gammaincc(0.5 * (len(channels) - 1), 0.5 * chi_square) < SMALLEST_CHI_SQUARE_P:
        warnings.append(
            "the channels differ in gain ("
            + ", ".join(f"{c.channel} {c.gain_e_per_dn.estimate:.3f} e/DN" for c in channels)
            + "): is white balance applied to the raw frames?"
        )
    return tuple(warnings)
