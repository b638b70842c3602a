"""Images of a tactile capture as numbers that can be compared: black level removed, one RGB value per pixel."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture

Floats = NDArray[np.float64]


def rgb_image(counts: NDArray[np.uint16], capture: TactileCapture) -> Floats:
    """Return (H, W, 3) values in DN with the black level removed.

    A Bayer frame becomes one RGB value per 2 x 2 cell (half the size, the two greens averaged): no value is
    interpolated from neighbours. Values are proportional to light only where ``capture.encoding`` is "linear".
    A value that was clipped in any sample of its cell is NaN.
    """
    full_scale = 2**capture.bit_depth - 1
    return per_cell(np.where(counts >= full_scale, np.nan, counts - capture.black_level_dn), capture)


def per_cell(values: Floats, capture: TactileCapture) -> Floats:
    """Return (H, W, 3) of an RGB image as it is, of a Bayer image one RGB value per cell."""
    if capture.layout == "RGB":
        return values
    plane = values[..., 0]
    green = (plane[0::2, 1::2] + plane[1::2, 0::2]) / 2
    return np.stack([plane[0::2, 0::2], green, plane[1::2, 1::2]], axis=-1)


def full_scale_dn(capture: TactileCapture) -> float:
    """Return full scale above black level, DN."""
    return float(2.0**capture.bit_depth - 1.0 - capture.black_level_dn)
