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


def brightness_beside_contact(image: Floats, distance: Floats) -> float:
    """Return the mean of R + G + B over the ring of 1 to 1.5 contact half-widths; NaN pixels are left out.

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
    return float(image[ring].sum(axis=-1).mean())


def brightness_error(
    simulated: Floats,
    captured: Floats,
    no_contact: Floats,
    repeat: Floats | None,
    distance: Floats,
    factor_sd_rel: float,
) -> BrightnessError:
    """Return (simulated - captured) / captured of the brightness beside the indenter.

    The uncertainty holds the repeatability of the capture (difference of two no-contact images, over sqrt 2)
    and the exposure factor's; it does not know how the error depends on the angle of the light.
    """
    real = brightness_beside_contact(captured, distance)
    error = brightness_beside_contact(simulated, distance) / real - 1
    repeatability = 0.0
    if repeat is not None:
        first, second = (brightness_beside_contact(i, distance) for i in (no_contact, repeat))
        repeatability = abs(second / first - 1) / np.sqrt(2)
    return BrightnessError(error, float(np.hypot(repeatability, factor_sd_rel)))
