"""Lens shading of a libcamera tuning (``rpi.alsc``): its tables, and the gains that flatten an image by them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import ImportFormatError
from finray_calib.radiometry.tuning_numbers import at_temperature, by_temperature, numbers

Floats = NDArray[np.float64]
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
