"""Raw pixel formats of GenICam cameras: which one to ask for, and counts from what it holds."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import BadFrameError, RefusedError

CONTAINER_BITS: Final = {8: 8, 10: 16, 12: 16, 14: 16, 16: 16}


@dataclass(frozen=True, slots=True)
class RawPixels:
    """A raw pixel format: its name and the bits of a count inside its container."""

    name: str
    bits: int

    @property
    def container(self) -> type[np.uint8 | np.uint16]:
        """Type of one count in the camera's buffer."""
        return np.uint8 if CONTAINER_BITS[self.bits] == 8 else np.uint16


def raw_pixels(offered: tuple[str, ...], bit_depth: int, camera: str) -> RawPixels:
    """Choose the raw pixel format: Bayer RG with the asked bits or 16, monochrome only where there is no Bayer.

    Raises
    ------
    RefusedError
        The camera has no such format.
    """
    colours = "BayerRG" if any(name.startswith("Bayer") for name in offered) else "Mono"
    for bits in sorted({bit_depth, 8 if bit_depth <= 8 else 16}):
        if f"{colours}{bits}" in offered:
            return RawPixels(f"{colours}{bits}", bits)
    raise RefusedError(
        f"{camera}: has no raw pixel format with {bit_depth} bits and Bayer pattern RGGB; it offers "
        f"{', '.join(offered)}: correct bit_depth of the rig file, or use another camera"
    )


def right_aligned(counts: NDArray[np.uint16], pixels: RawPixels, bit_depth: int, camera: str) -> NDArray[np.uint16]:
    """Return counts (DN) with the lowest bit of the converter at the lowest bit, shape (H, W).

    Cameras put the 10 or 12 bits of their converter at the top of a 16-bit format.

    Raises
    ------
    RefusedError
        The counts have more bits than the rig file says.
    BadFrameError
        A count is larger than its format allows.
    """
    if pixels.bits == 16:
        surplus = 16 - bit_depth
        if surplus and np.any(counts & np.uint16(2**surplus - 1)):
            raise RefusedError(
                f"{camera}: {pixels.name} carries more than the {bit_depth} bits of the rig file (its lowest "
                f"{surplus} bits are not all 0); correct bit_depth, or see what the camera does to raw counts"
            )
        return counts >> np.uint16(surplus)
    if counts.max(initial=0) >= 2**pixels.bits:
        raise BadFrameError(f"{camera}: {pixels.name} holds a count of {counts.max()} DN, more than {pixels.bits} bits")
    return counts
