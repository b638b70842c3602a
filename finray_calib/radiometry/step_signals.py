r"""One linear signal per capture step: mean over the region, dark-corrected, per second.

For exposure time t the signal of a channel is :math:`S = (\bar D - \bar D_{dark}(t)) / t` in DN/s. Its noise
variance follows the photon transfer relation (EMVA 1288): :math:`\mathrm{var}(D) = \sigma_r^2 / K^2 +
(D - D_{dark}) / K + 1/12` with K in e/DN, divided by the number of pixels. Exposures of one step are merged
with inverse-variance weights; saturated exposures are left out.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import CaptureSession, Frame, FrameType
from data_schemas.errors import RadiometryError
from data_schemas.rig import CameraSettings
from finray_calib.radiometry.region import region_channels

Floats = NDArray[np.float64]
ReadFrame = Callable[[Frame], NDArray[np.uint16]]
StepKey = tuple[FrameType, str]
# A handful of hot pixels may sit at full scale without biasing the mean of thousands of pixels.
LARGEST_SATURATED_FRACTION = 1e-4


@dataclass(frozen=True, slots=True)
class StepSignal:
    """Signal of one step (frame type and filter), channels red, green, blue.

    Attributes
    ----------
    signal_dn_per_s, variance
        Merged signal (3,) and the variance of its noise (3,); NaN where every exposure is saturated.
    saturated_fraction
        Smallest saturated fraction of the region over the exposures (3,).
    shares
        (exposures, 3) weight of each exposure in the merged signal; the columns sum to 1 (0 where saturated).
    log_ratios
        Logarithms of later exposures' signals over the first one's, averaged over channels.
    log_ratio_noise_variance
        What photon noise alone would give for the variance of each log ratio.
    """

    signal_dn_per_s: Floats
    variance: Floats
    saturated_fraction: Floats
    shares: Floats
    log_ratios: tuple[float, ...]
    log_ratio_noise_variance: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class DarkLevel:
    """Mean dark level of the region at one exposure (3,), its variance and the change from before to after."""

    level_dn: Floats
    variance: Floats
    drift_dn: float


def dark_levels(session: CaptureSession, read: ReadFrame) -> dict[float, DarkLevel]:
    """Return the dark level of the region for each exposure time, from the frames before and after."""
    means: dict[float, list[Floats]] = {}  # by the exposure asked for: what is read back may jitter
    pixels = np.ones(3)
    for frame in _of_type(session, "dark"):
        channels = region_channels(read(frame), session.plan.region)
        means.setdefault(frame.exposure_requested_s, []).append(np.array([c.mean() for c in channels]))
        pixels = np.array([c.size for c in channels])
    noise = _noise_variance_dn2(np.zeros(3), session.rig.camera) / pixels
    levels = {}
    for exposure_s, rows in means.items():
        half = len(rows) // 2
        drift = float(np.mean(rows[half:]) - np.mean(rows[:half])) if half else 0.0
        mean = np.mean(rows, axis=0)
        levels[exposure_s] = DarkLevel(mean, noise / len(rows) + (drift / 2) ** 2 / 3, drift)
    return levels


def step_signals(session: CaptureSession, read: ReadFrame, darks: dict[float, DarkLevel]) -> dict[StepKey, StepSignal]:
    """Return the merged signal of every lit step of a session.

    Raises
    ------
    RadiometryError
        A frame has no dark frame of its exposure time.
    """
    grouped: dict[StepKey, list[tuple[Floats, Floats, Floats]]] = {}
    for frame in session.frames:
        if frame.frame_type == "dark" or frame.filter_name is None:
            continue
        dark = darks.get(frame.exposure_requested_s)
        if dark is None:
            raise RadiometryError(
                f"{frame.file}: no dark frame of {frame.exposure_s:g} s; capture darks of the same exposure time"
            )
        key = (frame.frame_type, frame.filter_name)
        grouped.setdefault(key, []).append(_one_exposure(session, read(frame), frame.exposure_s, dark))
    return {key: _merge(exposures) for key, exposures in grouped.items()}


def _of_type(session: CaptureSession, frame_type: FrameType) -> Iterable[Frame]:
    """Return the frames of one type in capture order."""
    return (f for f in session.frames if f.frame_type == frame_type)


def _noise_variance_dn2(signal_dn: Floats, camera: CameraSettings) -> Floats:
    """Return the temporal variance of one pixel (DN^2) by the photon transfer relation."""
    shot: Floats = np.maximum(signal_dn, 0.0) / camera.gain_e_per_dn
    return shot + (camera.read_noise_e / camera.gain_e_per_dn) ** 2 + 1 / 12


def _one_exposure(
    session: CaptureSession, counts: NDArray[np.uint16], exposure_s: float, dark: DarkLevel
) -> tuple[Floats, Floats, Floats]:
    """Return signal (DN/s), variance and saturated fraction (3,) of one exposure."""
    camera = session.rig.camera
    full_scale = 2**camera.bit_depth - 1
    channels = region_channels(counts, session.plan.region)
    mean = np.array([c.mean() for c in channels])
    pixels = np.array([c.size for c in channels])
    saturated = np.array([(c >= full_scale).mean() for c in channels])
    signal_dn = mean - dark.level_dn
    variance = _noise_variance_dn2(signal_dn, camera) / pixels + dark.variance
    return signal_dn / exposure_s, variance / exposure_s**2, saturated


def _merge(exposures: list[tuple[Floats, Floats, Floats]]) -> StepSignal:
    """Merge the exposures of one step by inverse variance, channel by channel."""
    signal, variance, saturated = (np.array(column) for column in zip(*exposures, strict=True))
    weight = np.where(saturated <= LARGEST_SATURATED_FRACTION, 1 / variance, 0.0)
    total = weight.sum(axis=0)
    lost = total == 0
    safe = np.where(lost, 1.0, total)
    ratios, noise = _log_ratios(signal, variance, weight > 0)
    return StepSignal(
        signal_dn_per_s=np.where(lost, np.nan, (weight * signal).sum(axis=0) / safe),
        variance=np.where(lost, np.nan, 1 / safe),
        saturated_fraction=saturated.min(axis=0),
        shares=weight / safe,
        log_ratios=ratios,
        log_ratio_noise_variance=noise,
    )


def _log_ratios(
    signal: Floats, variance: Floats, usable: NDArray[np.bool_]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return ln(S_later / S_first) averaged over well-measured channels, and its photon-noise variance."""
    ratios, noises = [], []
    for later in range(1, len(signal)):
        good = usable[0] & usable[later] & (signal[0] > 0) & (signal[later] > 0)
        if not good.any():
            continue
        first, other = signal[0, good], signal[later, good]
        noise = variance[0, good] / first**2 + variance[later, good] / other**2
        weight = 1 / noise
        ratios.append(float((weight * np.log(other / first)).sum() / weight.sum()))
        noises.append(float(1 / weight.sum()))
    return tuple(ratios), tuple(noises)
