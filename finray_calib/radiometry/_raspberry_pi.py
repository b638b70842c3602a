r"""Linear signals from Raspberry Pi images: raw Bayer counts, or an estimate from processed 8-bit images.

Raw counts are linear; only the black level is removed (and, where asked, the lens shading flattened). A processed
image went through black level, lens shading, white-balance gains g, colour matrix M and tone curve c:

.. math:: \mathrm{code} = 255\, c(M\, g\, s), \qquad s \approx g^{-1} M^{-1} c^{-1}(\mathrm{code} / 255)

What the camera also does and nobody records (sharpening, denoising, compression, contrast stretched from image to
image, shading adapted from image to image) is not undone; it is carried as a standard uncertainty.

What the metadata of an image says about its exposure is read from the table that ``rpicam-still --metadata`` writes, or
picamera2's ``capture_metadata()``; images that cannot be compared are refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError
from finray_calib.radiometry._libcamera_tuning import LEVELS, LibcameraTuning

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


LARGEST_CODE = 255
ROUNDING_CODES = 12**-0.5
# Assumed, not measured: sharpening and denoising change smooth regions by about one code (edges by more).
PROCESSING_CODES = 1.0
# JPEG at quality 93 (rpicam-still's default) with halved chroma changes smooth images with a noise of 1 to 2 codes by
# 1.1 to 2.3 codes (measured).
JPEG_CODES = 2.0
LUMA = np.array([0.299, 0.587, 0.114])


@dataclass(frozen=True, slots=True)
class LinearEstimate:
    """Values proportional to light, estimated from a processed image.

    Attributes
    ----------
    values_rel
        (H, W, 3) relative to full scale; NaN where the camera clipped.
    sd_rel
        (H, W, 3) standard uncertainty, same scale; NaN alike.
    steps
        What was undone and what is carried as uncertainty, in order.
    """

    values_rel: Floats
    sd_rel: Floats
    steps: tuple[str, ...]

    def __post_init__(self) -> None:
        for array in (self.values_rel, self.sd_rel):
            array.flags.writeable = False

    def typical_uncertainty_rel(self) -> float:
        """Return the median over pixels and channels of sd / value, of values above 1 % of full scale (NaN if none)."""
        bright = self.values_rel > 0.01
        return float(np.median(self.sd_rel[bright] / self.values_rel[bright])) if bright.any() else float("nan")


def raw_signal(
    counts: NDArray[np.uint16], bit_depth: int, black_level_rel: Floats, gains: Floats | None = None
) -> Floats:
    """Return the linear signal of an RGGB frame, (H, W) relative to full scale: black level off, shading flattened.

    ``s = (n / 2^bits - b) g``; clipped counts are NaN. No colour matrix and no white balance are applied.

    Parameters
    ----------
    counts
        (H, W) raw counts (DN) in RGGB order.
    bit_depth
        Bits of a count; full scale is ``2**bit_depth - 1`` DN.
    black_level_rel
        (3,) red, green, blue relative to full scale.
    gains
        (H, W, 3) lens-shading gains; the one of the pixel's own colour is used. None leaves the shading in.
    """
    channel = np.tile(np.array([[0, 1], [1, 2]]), (counts.shape[0] // 2, counts.shape[1] // 2))
    levels = 2**bit_depth
    clipped = counts >= levels - 1
    signal: Floats = np.where(clipped, np.nan, counts / levels - black_level_rel[channel])
    if gains is not None:
        signal *= np.take_along_axis(gains, channel[..., None], axis=-1)[..., 0]
    return signal


def processed_signal(
    codes: NDArray[np.uint8],
    tuning: LibcameraTuning,
    settings: CaptureSettings,
    undo_colour: bool = False,
    compressed: bool = False,
) -> LinearEstimate:
    """Estimate linear values from a processed 8-bit image by inverting its tone curve.

    Parameters
    ----------
    codes
        (H, W, 3) red, green, blue as stored.
    tuning
        Tuning that the camera used.
    settings
        Settings of the image; its colour matrix is preferred to the tuning's.
    undo_colour
        Also undo colour matrix and white balance, which gives camera channels as raw counts have them. Without it
        the values are linear mixtures of camera channels.
    compressed
        The image is a JPEG.

    Returns
    -------
    LinearEstimate
        A channel at code 255 is clipped. When colours are undone, a pixel with one channel clipped at either end is
        lost as a whole: the mixture cannot be solved.

    Raises
    ------
    ImportFormatError
        The tuning has no tone curve, or (for `undo_colour`) no usable colour matrix.
    """
    if tuning.tone_curve is None:
        raise ImportFormatError(
            "tuning: has no rpi.contrast gamma_curve, so the tone curve of a processed image is unknown; give the "
            "tuning file that the camera used, or capture raw (rpicam-still --raw)"
        )
    encoded, curve = codes / LARGEST_CODE, tuning.tone_curve
    values: Floats = np.interp(encoded, curve[:, 1], curve[:, 0])
    code_sd = float(np.sqrt(ROUNDING_CODES**2 + PROCESSING_CODES**2 + (JPEG_CODES**2 if compressed else 0.0)))
    steps = [
        f"tone curve of the tuning inverted; {code_sd:.1f} of 255 codes carried for rounding, assumed sharpening and "
        "denoising" + (", JPEG" if compressed else "")
    ]
    variance = (_slope(encoded, curve) * code_sd / LARGEST_CODE) ** 2
    if tuning.contrast is not None:
        variance += _stretch_sd(values, tuning) ** 2
        steps.append("contrast stretched from image to image (ce_enable): not undone, its limits are carried")
    bound = 0.0 if tuning.shading is None else tuning.shading.adaptive_bound_rel
    if bound:
        variance += (bound / np.sqrt(3.0) * np.array([1.0, 0.0, 1.0]) * values) ** 2
        steps.append(f"red and blue shading adapts within {bound:.0%}: not undone, carried")
    lost = codes == LARGEST_CODE
    if undo_colour:
        matrix = _undoing_matrix(tuning, settings)
        values, variance = values @ matrix.T, variance @ (matrix**2).T
        mixed = (codes == 0).any(axis=-1) & (codes != 0).any(axis=-1)
        lost = np.broadcast_to((lost.any(axis=-1) | mixed)[..., None], codes.shape)
        steps.append("colour matrix and white-balance gains undone")
    return LinearEstimate(
        values_rel=np.where(lost, np.nan, values),
        sd_rel=np.where(lost, np.nan, np.sqrt(variance)),
        steps=tuple(steps),
    )


def _slope(encoded: Floats, curve: Floats) -> Floats:
    """Return d(linear) / d(encoded) of the inverse tone curve; at a knot that of the steeper side's segment."""
    slopes = np.diff(curve[:, 0]) / np.diff(curve[:, 1])
    segment = np.clip(np.searchsorted(curve[:, 1], encoded, side="right") - 1, 0, len(slopes) - 1)
    return np.asarray(slopes[segment])


def _stretch_sd(values: Floats, tuning: LibcameraTuning) -> Floats:
    """Return the standard uncertainty of linear values from the unknown contrast stretch.

    The stretch is zero at black, at the median and at white, and at most ``low_max`` and ``high_max`` at the ends of
    the histogram. Unknown and one-sided within [0, limit], it has the root mean square limit / sqrt(3).
    """
    limits = tuning.contrast
    if limits is None:
        return np.zeros_like(values)
    low = limits.low_level_rel + limits.low_max_rel
    high = limits.high_level_rel
    median = float(np.clip(np.median(values @ LUMA), low + 1e-6, high - 1e-6))
    knots = np.array([0.0, low, median, high, 1.0])
    shift = np.array([0.0, limits.low_max_rel, 0.0, limits.high_max_rel, 0.0])
    return np.asarray(np.interp(values, knots, shift) / np.sqrt(3.0))


def _undoing_matrix(tuning: LibcameraTuning, settings: CaptureSettings) -> Floats:
    """Return the (3, 3) matrix from linear image RGB to camera RGB: colour matrix and white balance undone."""
    if settings.colour_matrix is not None:
        matrix = settings.colour_matrix
    elif settings.temperature_k is not None:
        matrix = tuning.colour_matrix(settings.temperature_k)
    else:
        raise ImportFormatError(
            "metadata: has neither ColourCorrectionMatrix nor ColourTemperature, so the colour matrix is unknown; "
            "capture raw (rpicam-still --raw), or import without undoing colours"
        )
    if abs(np.linalg.det(matrix)) < 1e-3:  # a saturation of zero makes grey images: colours cannot be recovered
        raise ImportFormatError(
            f"metadata: the colour matrix {np.round(matrix, 3).tolist()} cannot be inverted (saturation 0?); capture "
            "raw (rpicam-still --raw)"
        )
    gains = np.array([settings.red_gain_factor, 1.0, settings.blue_gain_factor])
    return np.asarray(np.linalg.inv(matrix) / gains[:, None])
