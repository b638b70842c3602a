"""What the metadata of a Raspberry Pi image says about its exposure, and refusal of images that cannot be compared.

The metadata is the table that ``rpicam-still --metadata`` writes, or picamera2's ``capture_metadata()``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import ImportFormatError
from finray_calib.radiometry.libcamera_tuning import LEVELS

Floats = NDArray[np.float64]
# What each control reports while something is adjusted from image to image.
AUTOMATICS: dict[str, tuple[tuple[object, ...], str]] = {
    "AeEnable": ((True, 1), "auto exposure"),
    "ExposureTimeMode": ((0,), "auto exposure"),
    "AnalogueGainMode": ((0,), "auto gain"),
    "AeState": ((1, 2), "auto exposure (AeState 1 searching, 2 converged)"),
    "AwbEnable": ((True, 1), "auto white balance"),
}
LOCK = "fix exposure, gain and white balance (rpicam-still --shutter --gain --awbgains) and capture again"
# Locked settings read back the same to the last digit; a change below this is lost in the light's repeatability.
SAME_SETTING_REL = 1e-3


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """Settings that one image was taken with.

    Attributes
    ----------
    exposure_s, analogue_gain_factor, digital_gain_factor
        Exposure time and gains; the digital gain is 1 where the metadata has none, and never applies to raw counts.
    red_gain_factor, blue_gain_factor
        White balance; never applies to raw counts.
    temperature_k
        Colour temperature that the camera believed (K); None if the metadata has none.
    colour_matrix
        (3, 3) matrix that was applied, saturation included; None if the metadata has none.
    black_level_rel
        (3,) red, green, blue relative to full scale; None if the metadata has none.
    """

    exposure_s: float
    analogue_gain_factor: float
    digital_gain_factor: float
    red_gain_factor: float
    blue_gain_factor: float
    temperature_k: float | None
    colour_matrix: Floats | None
    black_level_rel: Floats | None


def capture_settings(metadata: Mapping[str, Any], image: str) -> CaptureSettings:
    """Read the settings of one image, and refuse it when something was automatic.

    Parameters
    ----------
    metadata
        libcamera's metadata by control name; exposure time in microseconds, levels on the 16-bit scale.
    image
        Name of the image, for messages.

    Raises
    ------
    ImportFormatError
        Auto exposure, auto gain or auto white balance was on; a needed value is missing or not a positive number.

    References
    ----------
    libcamera, ``control_ids_core.yaml``.
    """
    for control, (values, what) in AUTOMATICS.items():
        if metadata.get(control) in values:
            raise ImportFormatError(
                f"{image}: {what} was on ({control} = {metadata[control]}), so its brightness or colour is not that of "
                f"the other images; {LOCK}"
            )
    red, blue = _numbers(metadata, "ColourGains", 2, image)
    temperature = _optional(metadata, "ColourTemperature", 1, image)
    matrix = _optional(metadata, "ColourCorrectionMatrix", 9, image)
    levels = _optional(metadata, "SensorBlackLevels", 4, image)  # red, green, green, blue
    digital = _optional(metadata, "DigitalGain", 1, image)
    return CaptureSettings(
        exposure_s=_positive(metadata, "ExposureTime", image) * 1e-6,
        analogue_gain_factor=_positive(metadata, "AnalogueGain", image),
        digital_gain_factor=1.0 if digital is None else float(digital[0]),
        red_gain_factor=float(red),
        blue_gain_factor=float(blue),
        temperature_k=None if temperature is None else float(temperature[0]),
        colour_matrix=None if matrix is None else matrix.reshape(3, 3),
        black_level_rel=None if levels is None else levels[[0, 1, 3]] / LEVELS,
    )


def require_same_settings(settings: Mapping[str, CaptureSettings]) -> None:
    """Refuse images of one press that were not taken with the same exposure time and gains (within 0.1 %).

    Parameters
    ----------
    settings
        By name of the image; the first is compared with all others.

    Raises
    ------
    ImportFormatError
        A setting differs: something was automatic, or was changed between the images.
    """
    names = {
        "exposure_s": ("ExposureTime", "s"),
        "analogue_gain_factor": ("AnalogueGain", ""),
        "digital_gain_factor": ("DigitalGain", ""),
        "red_gain_factor": ("ColourGains (red)", ""),
        "blue_gain_factor": ("ColourGains (blue)", ""),
    }
    (first, reference), *others = settings.items()
    for image, other in others:
        for field, (control, unit) in names.items():
            one, two = getattr(reference, field), getattr(other, field)
            if abs(two - one) > SAME_SETTING_REL * one:
                raise ImportFormatError(
                    f"{control} differs: {one:g} {unit} in {first}, {two:g} {unit} in {image}; images of one press "
                    f"need the same settings: {LOCK}"
                )


def _positive(metadata: Mapping[str, Any], control: str, image: str) -> float:
    """Return one positive number."""
    return float(_numbers(metadata, control, 1, image)[0])


def _optional(metadata: Mapping[str, Any], control: str, count: int, image: str) -> Floats | None:
    """Return the numbers of a control, or None where the metadata lacks it."""
    return _numbers(metadata, control, count, image) if control in metadata else None


def _numbers(metadata: Mapping[str, Any], control: str, count: int, image: str) -> Floats:
    """Return `count` finite numbers of a control; all but matrix entries and black levels must be positive."""
    if control not in metadata:
        raise ImportFormatError(
            f"{image}: its metadata has no {control}, so nothing says how it was exposed; write the metadata with "
            "rpicam-still --metadata, or with picamera2's capture_metadata()"
        )
    try:
        values = np.array(metadata[control], dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        values = np.empty(0)
    signed = control in ("ColourCorrectionMatrix", "SensorBlackLevels")
    if values.shape != (count,) or not np.isfinite(values).all() or not (signed or (values > 0).all()):
        raise ImportFormatError(
            f"{image}: {control} is {metadata[control]!r}; it must be {count} finite number(s)"
            + ("" if signed else " above 0")
        )
    if control == "SensorBlackLevels" and not ((values >= 0.0) & (values < LEVELS)).all():
        raise ImportFormatError(
            f"{image}: SensorBlackLevels is {metadata[control]!r}; black levels are 0 to {LEVELS - 1:g} of 16 bits"
        )
    return values
