"""What a libcamera tuning file says about a Raspberry Pi image: black level, tone curve, lens shading, colour matrix.

Both layouts are read: version 2.0 (a list ``algorithms`` of one-entry tables) and the older one (one table of all
algorithms). Levels in the file are on a 16-bit scale whatever the sensor delivers; here they are relative to full
scale. The tables of the lens shading (``rpi.alsc``) give the gains that flatten an image. Documents that are already in
memory are parsed; no file is opened.
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
            f"tuning: {name} is not an array of numbers of shape {shape}; is the file whole?"
        ) from None
    if not np.isfinite(array).all():
        raise ImportFormatError(f"tuning: {name} holds NaN or infinite numbers; is the file whole?")
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
            f"tuning: rpi.alsc luminance_lut has {flat.size} entries; tables of 16 x 12 (192) or 32 x 32 (1024) are "
            "known"
        )
    shape = TABLE_SHAPES[flat.size]
    luminance = flat.reshape(shape)
    strength = _number(parameters, "luminance_strength", 1.0)
    red_k, red = by_temperature(parameters.get("calibrations_Cr", []), "rpi.alsc calibrations_Cr", "table", shape)
    blue_k, blue = by_temperature(parameters.get("calibrations_Cb", []), "rpi.alsc calibrations_Cb", "table", shape)
    gains = 1.0 + strength * (luminance - 1.0)
    if min(table.min(initial=1.0) for table in (gains, red, blue)) <= 0:
        raise ImportFormatError("tuning: rpi.alsc holds a gain that is zero or negative; gains must be positive")
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
        raise ImportFormatError(f"tuning: is a {type(document).__name__}, a tuning file is a JSON object")
    version = document.get("version", 1.0)
    if not isinstance(version, (int, float)) or version >= 3.0:
        raise ImportFormatError(
            f"tuning: has version {version!r}; versions below 3 are understood: give the tuning file of an older "
            "libcamera"
        )
    entries = document.get("algorithms") if version >= 2.0 else [document]
    if not isinstance(entries, list) or not all(isinstance(e, Mapping) for e in entries):
        raise ImportFormatError(f"tuning: version {version:g} needs a list 'algorithms' of objects")
    found = {
        name: parameters
        for entry in entries
        for name, parameters in entry.items()
        if name.startswith("rpi.") and isinstance(parameters, Mapping) and parameters.get("enabled", True)
    }
    if not found:
        raise ImportFormatError(
            "tuning: holds no 'rpi.' algorithm, so it is not for a Raspberry Pi; give a file such as "
            "/usr/share/libcamera/ipa/rpi/vc4/imx219.json"
        )
    return found


def _black_level(parameters: Mapping[str, Any]) -> Floats:
    """Return black levels of red, green and blue, relative to full scale."""
    common = parameters.get("black_level", DEFAULT_BLACK_LEVEL_DN)
    levels = numbers([parameters.get(f"black_level_{c}", common) for c in "rgb"], "rpi.black_level", (3,))
    if not ((levels >= 0) & (levels < LEVELS / 2)).all():
        raise ImportFormatError(
            f"tuning: rpi.black_level is {levels.tolist()}; it must be 0 to {LEVELS / 2:.0f} on the 16-bit scale"
        )
    return levels / LEVELS


def _tone_curve(flat: Any) -> Floats:
    """Return the (N, 2) tone curve, 0..1, strictly increasing in both columns."""
    points = numbers(flat, "rpi.contrast gamma_curve", (-1, 2)) / FULL_SCALE_DN
    if len(points) < 2 or (np.diff(points, axis=0) <= 0).any() or points.min() < 0 or points.max() > 1:
        raise ImportFormatError(
            "tuning: rpi.contrast gamma_curve must be two or more pairs that rise strictly within 0 to 65535; a curve "
            "that is flat cannot be inverted"
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
