"""The sweep's objective as seen in an image: brightness beside the indenter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError

Floats = NDArray[np.float64]
# The paper reads "a point near the indenter": a ring from the edge of the contact to half a half-width beyond.
RING = (1.0, 1.5)


@dataclass(frozen=True, slots=True)
class BrightnessError:
    """Relative error of the simulated brightness beside the indenter and its standard uncertainty."""

    error_rel: float
    sd_rel: float


def brightness_beside_contact(image: Floats, distance: Floats, white: Floats) -> float:
    """Return the white-balanced brightness over the ring of 1 to 1.5 contact half-widths.

    The mean over pixels and channels of ``image / white``; pixels with NaN are left out.

    Parameters
    ----------
    image
        (H, W, 3) linear light.
    distance
        (H, W) distance from the contact's centre in half-widths, NaN off the pad.
    white
        (3,) level per channel that counts as one.

    Raises
    ------
    CompareError
        No usable pixel lies in the ring.
    """
    ring = np.isfinite(distance) & (distance >= RING[0]) & (distance <= RING[1]) & np.isfinite(image).all(axis=-1)
    if not ring.any():
        raise CompareError(
            f"no usable pixel lies {RING[0]:g} to {RING[1]:g} contact half-widths from the indenter: the press is too "
            "near the edge of the image, or the image is clipped there"
        )
    return float((image[ring] / white).mean())


def brightness_error(
    simulated: Floats,
    captured: Floats,
    no_contact: Floats,
    repeat: Floats | None,
    distance: Floats,
    factor_sd_rel: float,
) -> BrightnessError:
    """Return (simulated - captured) / captured of the brightness beside the indenter.

    Every channel counts relative to its no-contact level, as in the sweep's objective. The uncertainty holds the
    repeatability of the capture (difference of two no-contact images, over sqrt 2) and that of the exposure
    factor; it does not know how the error depends on the angle of the light.
    """
    pad = np.isfinite(distance) & np.isfinite(no_contact).all(axis=-1)
    white = no_contact[pad].mean(axis=0)
    real = brightness_beside_contact(captured, distance, white)
    error = brightness_beside_contact(simulated, distance, white) / real - 1
    repeatability = 0.0
    if repeat is not None:
        first, second = (brightness_beside_contact(i, distance, white) for i in (no_contact, repeat))
        repeatability = abs(second / first - 1) / np.sqrt(2)
    return BrightnessError(error, float(np.hypot(repeatability, np.nan_to_num(factor_sd_rel))))
