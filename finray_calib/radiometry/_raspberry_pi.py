r"""Linear signals from Raspberry Pi images: raw Bayer counts, or an estimate from processed 8-bit images.

Raw counts are linear; only the black level is removed (and, where asked, the lens shading flattened). A processed
image went through black level, lens shading, white-balance gains g, colour matrix M and tone curve c:

.. math:: \mathrm{code} = 255\, c(M\, g\, s), \qquad s \approx g^{-1} M^{-1} c^{-1}(\mathrm{code} / 255)

What the camera also does and nobody records (sharpening, denoising, compression, contrast stretched from image to
image, shading adapted from image to image) is not undone; it is carried as a standard uncertainty.

What the metadata of an image says about its exposure is read from the table that ``rpicam-still --metadata`` writes, or
picamera2's ``capture_metadata()``; images that cannot be compared are refused.

A libcamera tuning file says the black level, tone curve, lens shading and colour matrix of such a camera. Both layouts
are read: version 2.0 (a list ``algorithms`` of one-entry tables) and the older one (one table of all algorithms).
Levels in the file are on a 16-bit scale whatever the sensor delivers; here they are relative to full scale. The tables
of the lens shading (``rpi.alsc``) give the gains that flatten an image. No file is opened: documents that are already
in memory are parsed.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import ImportFormatError

Floats = NDArray[np.float64]


def by_temperature(entries: Any, name: str, key: str, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return colour temperatures (T,), increasing, and the tables of `key` as (T, *shape).

    Raises
    ------
    ImportFormatError
        An entry has no temperature or table, temperatures do not increase, or a table is not numbers of the shape.
    """
    if not isinstance(entries, list) or not all(isinstance(e, Mapping) and "ct" in e and key in e for e in entries):
        raise ImportFormatError(f"tuning: {name} must be a list of objects with 'ct' (K) and '{key}'")
    temperature_k = numbers([e["ct"] for e in entries], f"{name} ct", (-1,))
    if (np.diff(temperature_k) <= 0).any():
        raise ImportFormatError(f"tuning: {name} must be in increasing order of 'ct', got {temperature_k.tolist()} K")
    return temperature_k, numbers([e[key] for e in entries], f"{name} {key}", (len(entries), *shape))


def at_temperature(temperature_k: Floats, tables: Floats, wanted_k: float) -> Floats:
    """Return the table at a colour temperature: linear between entries, end tables held."""
    position = float(np.interp(wanted_k, temperature_k, np.arange(len(temperature_k))))
    low = min(int(position), max(len(tables) - 2, 0))
    high = min(low + 1, len(tables) - 1)
    share = position - low
    return np.asarray((1.0 - share) * tables[low] + share * tables[high])


def numbers(values: Any, name: str, shape: tuple[int, ...]) -> Floats:
    """Return finite numbers in a shape.

    Raises
    ------
    ImportFormatError
        They are no numbers, not finite, or do not fill the shape.
    """
    try:
        array = np.array(values, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError):
        raise ImportFormatError(
            f"tuning: {name} is not an array of numbers of shape {shape}; check that the file is complete"
        ) from None
    if not np.isfinite(array).all():
        raise ImportFormatError(f"tuning: {name} contains NaN or infinite numbers; check that the file is complete")
    return array


# (rows, columns) by number of entries: the 16 x 12 regions of bcm2835 (Pi 0-4), the 32 x 32 regions of PiSP (Pi 5).
TABLE_SHAPES = {192: (12, 16), 1024: (32, 32)}


@dataclass(frozen=True, slots=True)
class LensShading:
    """Gains that flatten the field (``rpi.alsc``).

    Attributes
    ----------
    luminance
        (rows, columns) gain of all channels, strength applied.
    red_temperature_k, blue_temperature_k
        (T,) colour temperatures (K) of the tables of red and blue; T may be 0.
    red, blue
        (T, rows, columns) further gains of red and blue.
    adaptive_bound_rel
        How far the camera may move the red and blue gains by itself from image to image; 0 if it does not.
    """

    luminance: Floats
    red_temperature_k: Floats
    red: Floats
    blue_temperature_k: Floats
    blue: Floats
    adaptive_bound_rel: float


def parse_shading(parameters: Mapping[str, Any]) -> LensShading | None:
    """Return the shading tables of the algorithm's parameters; None when it has none.

    Raises
    ------
    ImportFormatError
        A table has another size than libcamera's, or a gain is not positive.
    """
    if "luminance_lut" not in parameters:
        return None
    flat = numbers(parameters["luminance_lut"], "rpi.alsc luminance_lut", (-1,))
    if flat.size not in TABLE_SHAPES:
        raise ImportFormatError(
            f"tuning: rpi.alsc luminance_lut has {flat.size} entries, but only tables of 16 x 12 (192) or 32 x 32 "
            "(1024) are supported"
        )
    shape = TABLE_SHAPES[flat.size]
    luminance = flat.reshape(shape)
    strength = _number(parameters, "luminance_strength", 1.0)
    red_k, red = by_temperature(parameters.get("calibrations_Cr", []), "rpi.alsc calibrations_Cr", "table", shape)
    blue_k, blue = by_temperature(parameters.get("calibrations_Cb", []), "rpi.alsc calibrations_Cb", "table", shape)
    gains = 1.0 + strength * (luminance - 1.0)
    if min(table.min(initial=1.0) for table in (gains, red, blue)) <= 0:
        raise ImportFormatError("tuning: rpi.alsc contains a gain that is zero or negative, but gains must be positive")
    adaptive = parameters.get("n_iter", 1) != 0
    bound = _number(parameters, "lambda_bound", 0.05) if adaptive else 0.0
    return LensShading(gains, red_k, red, blue_k, blue, bound)


def shading_gains(shading: LensShading, temperature_k: float, shape: tuple[int, int]) -> Floats:
    """Return the (H, W, 3) gains that flatten an image of the whole sensor field, smallest gain of a channel 1.

    Red is luminance x red table, green luminance, blue luminance x blue table; tables are linear in colour
    temperature and bilinear between the centres of their cells. Valid for images that show the whole field of the
    sensor; a cropped sensor mode sees only the middle of the tables.

    Parameters
    ----------
    shading
        Tables of the tuning.
    temperature_k
        Colour temperature that the camera reported (K).
    shape
        (H, W) of the image.
    """
    red, blue = (
        at_temperature(k, tables, temperature_k) if len(k) else np.ones_like(shading.luminance)
        for k, tables in ((shading.red_temperature_k, shading.red), (shading.blue_temperature_k, shading.blue))
    )
    tables = np.stack([red * shading.luminance, shading.luminance, blue * shading.luminance], axis=-1)
    tables /= tables.min(axis=(0, 1))
    return np.asarray(cv2.resize(tables, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float64)


def _number(parameters: Mapping[str, Any], name: str, default: float) -> float:
    """Return one finite number of rpi.alsc."""
    return float(numbers(parameters.get(name, default), f"rpi.alsc {name}", ()))


FULL_SCALE_DN = 65535.0
LEVELS = 65536.0
DEFAULT_BLACK_LEVEL_DN = 4096


@dataclass(frozen=True, slots=True)
class AdaptiveContrast:
    """Limits of the per-image stretch before the tone curve, relative to full scale (the file's ``ce_enable``).

    The dark end of the histogram is moved down to `low_level` by at most `low_max`, the bright end up to
    `high_level` by at most `high_max`; the median stays where it is.
    """

    low_level_rel: float
    low_max_rel: float
    high_level_rel: float
    high_max_rel: float


@dataclass(frozen=True, slots=True)
class LibcameraTuning:
    """The parts of a tuning file that turn counts into images.

    Attributes
    ----------
    target
        "bcm2835" (Pi 0-4) or "pisp" (Pi 5).
    black_level_rel
        (3,) red, green, blue, relative to full scale.
    tone_curve
        (N, 2) linear value -> encoded value, both 0..1 and strictly increasing; None if the file has none.
    contrast
        Limits of the adaptive stretch; None if it is switched off.
    shading
        Lens shading; None if the file has none.
    matrix_temperature_k, colour_matrices
        (M,) and (M, 3, 3): white-balanced camera RGB -> linear image RGB; M may be 0.
    """

    target: str
    black_level_rel: Floats
    tone_curve: Floats | None
    contrast: AdaptiveContrast | None
    shading: LensShading | None
    matrix_temperature_k: Floats
    colour_matrices: Floats

    def colour_matrix(self, temperature_k: float) -> Floats:
        """Return the (3, 3) colour matrix at a colour temperature (K): linear between entries, ends held.

        Raises
        ------
        ImportFormatError
            The tuning has no colour matrices.
        """
        if not len(self.colour_matrices):
            raise ImportFormatError(
                "tuning: has no rpi.ccm matrices, so the colour correction cannot be undone; import without undoing "
                "it, or give the tuning file of the camera"
            )
        return at_temperature(self.matrix_temperature_k, self.colour_matrices, temperature_k)


def parse_tuning(document: Mapping[str, Any]) -> LibcameraTuning:
    """Parse the content of a tuning file.

    Parameters
    ----------
    document
        The JSON document: version 2.0 (``algorithms``) or the older layout (algorithms at the top level).

    Raises
    ------
    ImportFormatError
        The document is no Raspberry Pi tuning, or an entry is not what libcamera itself would accept.

    References
    ----------
    libcamera, ``src/ipa/rpi/controller`` (reading of each algorithm, version 0.7).
    """
    algorithms = _algorithms(document)
    contrast = algorithms.get("rpi.contrast", {})
    ccm = algorithms.get("rpi.ccm", {})
    temperature_k, matrices = by_temperature(ccm.get("ccms", []), "rpi.ccm", "ccm", (3, 3))
    return LibcameraTuning(
        target=str(document.get("target", "bcm2835")),
        black_level_rel=_black_level(algorithms.get("rpi.black_level", {})),
        tone_curve=_tone_curve(contrast["gamma_curve"]) if "gamma_curve" in contrast else None,
        contrast=_adaptive_contrast(contrast),
        shading=parse_shading(algorithms["rpi.alsc"]) if "rpi.alsc" in algorithms else None,
        matrix_temperature_k=temperature_k,
        colour_matrices=matrices,
    )


def _algorithms(document: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the enabled algorithms by name, from either layout."""
    if not isinstance(document, Mapping):
        raise ImportFormatError(
            "tuning: is not a JSON object; give the tuning file that libcamera has for this camera (such as "
            "imx219.json)"
        )
    version = document.get("version", 1.0)
    if not isinstance(version, (int, float)) or version >= 3.0:
        raise ImportFormatError(
            f"tuning: version {version!r} is not supported, only versions below 3 are; give the tuning file of an "
            "older libcamera"
        )
    entries = document.get("algorithms") if version >= 2.0 else [document]
    if not isinstance(entries, list) or not all(isinstance(e, Mapping) for e in entries):
        raise ImportFormatError(f"tuning: 'algorithms' must be a list of objects in version {version:g}")
    found = {
        name: parameters
        for entry in entries
        for name, parameters in entry.items()
        if name.startswith("rpi.") and isinstance(parameters, Mapping) and parameters.get("enabled", True)
    }
    if not found:
        raise ImportFormatError(
            "tuning: contains no 'rpi.' algorithm, so it is not for a Raspberry Pi; give a file such as "
            "/usr/share/libcamera/ipa/rpi/vc4/imx219.json"
        )
    return found


def _black_level(parameters: Mapping[str, Any]) -> Floats:
    """Return black levels of red, green and blue, relative to full scale."""
    common = parameters.get("black_level", DEFAULT_BLACK_LEVEL_DN)
    levels = numbers([parameters.get(f"black_level_{c}", common) for c in "rgb"], "rpi.black_level", (3,))
    if not ((levels >= 0) & (levels < LEVELS / 2)).all():
        raise ImportFormatError(
            f"tuning: rpi.black_level is {levels.tolist()}, but must be at least 0 and below {LEVELS / 2:.0f} on the "
            "16-bit scale"
        )
    return levels / LEVELS


def _tone_curve(flat: Any) -> Floats:
    """Return the (N, 2) tone curve, 0..1, strictly increasing in both columns."""
    points = numbers(flat, "rpi.contrast gamma_curve", (-1, 2)) / FULL_SCALE_DN
    if len(points) < 2 or (np.diff(points, axis=0) <= 0).any() or points.min() < 0 or points.max() > 1:
        raise ImportFormatError(
            "tuning: rpi.contrast gamma_curve must have two or more pairs of numbers within 0 to 65535, and both "
            "numbers must increase from pair to pair; a flat curve cannot be inverted"
        )
    return points


def _adaptive_contrast(parameters: Mapping[str, Any]) -> AdaptiveContrast | None:
    """Return the limits of the adaptive stretch with libcamera's defaults; None when it is off."""
    if not parameters or not parameters.get("ce_enable", 1):
        return None
    defaults = {"lo_level": 0.015, "lo_max": 500.0, "hi_level": 0.95, "hi_max": 2000.0}
    values = numbers([parameters.get(k, v) for k, v in defaults.items()], "rpi.contrast", (4,)).tolist()
    low_level, low_max_dn, high_level, high_max_dn = values
    return AdaptiveContrast(low_level, low_max_dn / FULL_SCALE_DN, high_level, high_max_dn / FULL_SCALE_DN)


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
                f"{image}: {what} was on ({control} = {metadata[control]}), so brightness or colour may differ from "
                f"image to image; {LOCK}"
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
                    f"{control} is {one:g} {unit} in {first}, but {two:g} {unit} in {image}; images of one press need "
                    f"the same settings, so {LOCK}"
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
            f"{image}: its metadata has no {control}, so its exposure is not known; write the metadata with "
            "rpicam-still --metadata, or with picamera2's capture_metadata()"
        )
    try:
        values = np.array(metadata[control], dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        values = np.empty(0)
    signed = control in ("ColourCorrectionMatrix", "SensorBlackLevels")
    if values.shape != (count,) or not np.isfinite(values).all() or not (signed or (values > 0).all()):
        raise ImportFormatError(
            f"{image}: {control} is {metadata[control]!r}, but must be {count} finite number(s)"
            + ("" if signed else " above 0")
        )
    if control == "SensorBlackLevels" and not ((values >= 0.0) & (values < LEVELS)).all():
        raise ImportFormatError(
            f"{image}: SensorBlackLevels is {metadata[control]!r}, but black levels must be 0 to {LEVELS - 1:g} (16 "
            "bits)"
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
        f"the tone curve of the tuning was inverted, with a standard uncertainty of {code_sd:.1f} of 255 codes for "
        "rounding, assumed sharpening and denoising" + (", JPEG" if compressed else "")
    ]
    variance = (_slope(encoded, curve) * code_sd / LARGEST_CODE) ** 2
    if tuning.contrast is not None:
        variance += _stretch_sd(values, tuning) ** 2
        steps.append(
            "the contrast was stretched from image to image (ce_enable); this was not undone, but its limits are "
            "included in the uncertainty"
        )
    bound = 0.0 if tuning.shading is None else tuning.shading.adaptive_bound_rel
    if bound:
        variance += (bound / np.sqrt(3.0) * np.array([1.0, 0.0, 1.0]) * values) ** 2
        steps.append(
            f"the shading of red and blue adapts within {100 * bound:.0f} %; this was not undone, but is included in "
            "the uncertainty"
        )
    lost = codes == LARGEST_CODE
    if undo_colour:
        matrix = _undoing_matrix(tuning, settings)
        values, variance = values @ matrix.T, variance @ (matrix**2).T
        mixed = (codes == 0).any(axis=-1) & (codes != 0).any(axis=-1)
        lost = np.broadcast_to((lost.any(axis=-1) | mixed)[..., None], codes.shape)
        steps.append("colour matrix and white-balance gains were undone")
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
