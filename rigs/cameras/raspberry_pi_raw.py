"""Raw streams of Raspberry Pi cameras: which sensor mode fits a rig file, and counts from the bytes of a buffer."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self, cast

import numpy as np
from numpy.typing import NDArray

from data_schemas.bayer import FIRST_RED, BayerOrder
from data_schemas.devices import CameraSettings
from data_schemas.errors import BadFrameError, RefusedError

CONTAINER_BITS: Final = 16
RAW_FORMAT: Final = re.compile(r"S(RGGB|GRBG|GBRG|BGGR)(8|10|12|14|16)")

Mode = Mapping[str, Any]


def chosen_mode(settings: CameraSettings, modes: Sequence[Mode], name: str) -> Mode:
    """Return the sensor mode of the rig file's bit depth whose frame has its size after the cut.

    Parameters
    ----------
    settings
        The camera of the rig file.
    modes
        ``Picamera2.sensor_modes``.
    name
        The camera, for the message.

    Raises
    ------
    RefusedError
        There is none.
    """
    asked = (settings.width_px, settings.height_px)
    fitting: dict[tuple[int, int], Mode] = {
        cut: mode
        for mode in modes
        if mode.get("bit_depth") == settings.bit_depth and (cut := _size_after_cut(mode)) is not None
    }
    if asked not in fitting:
        allowed = ", ".join(f"{width} x {height}" for width, height in sorted(fitting)) or "none"
        raise RefusedError(
            f"{name}: has no raw mode of {asked[0]} x {asked[1]} px with {settings.bit_depth} bits; with these bits it "
            f"has (width x height, cut to begin with red): {allowed}; correct the rig file"
        )
    return fitting[asked]


def _size_after_cut(mode: Mode) -> tuple[int, int] | None:
    """Return width and height of a mode's frame after the cut; None where it is no Bayer mode."""
    found = RAW_FORMAT.fullmatch(str(mode.get("unpacked", "")))
    if found is None:
        return None
    row, column = FIRST_RED[cast(BayerOrder, found[1])]
    width, height = mode["size"]
    return (width - column) // 2 * 2, (height - row) // 2 * 2


@dataclass(frozen=True, slots=True)
class RawLayout:
    """How the counts lie in a buffer, and what of them is the frame.

    Attributes
    ----------
    pixel_format
        libcamera's name of it, such as "SBGGR10".
    order
        Colours of the first 2 x 2 pixels, row by row.
    shift
        Bits below the counts: a Pi 5 puts them at the left end of 16 bits, a Pi 4 at the right end.
    bit_depth
        Bits of a count.
    stored_px, frame_px
        Width and height in the buffer (without padding) and after the cut.
    """

    pixel_format: str
    order: BayerOrder
    shift: int
    bit_depth: int
    stored_px: tuple[int, int]
    frame_px: tuple[int, int]

    @classmethod
    def of(cls, raw: Mapping[str, Any], mode: Mode, settings: CameraSettings, name: str) -> Self:
        """Return the layout of a configured raw stream.

        Raises
        ------
        RefusedError
            The camera did not take the format or size of `mode`.
        """
        found = RAW_FORMAT.fullmatch(raw["format"])
        bits = 0 if found is None else int(found[2])
        (width, height), asked = raw["size"], tuple(mode["size"])
        if found is None or (width, height) != asked or bits not in (settings.bit_depth, CONTAINER_BITS):
            raise RefusedError(
                f"{name}: asked for raw {mode['unpacked']} of {asked[0]} x {asked[1]} px, it gives {raw['format']} of "
                f"{width} x {height} px; update picamera2, or take another size or bit_depth"
            )
        frame_px = settings.width_px, settings.height_px
        return cls(
            found[0],
            cast(BayerOrder, found[1]),
            bits - settings.bit_depth,
            settings.bit_depth,
            (width, height),
            frame_px,
        )

    def counts(self, stored: NDArray[Any], name: str) -> NDArray[np.uint16]:
        """Return counts (DN), shape (H, W): padding off, right-aligned, beginning with red.

        Parameters
        ----------
        stored
            The bytes of a buffer, shape (rows, bytes in a row), as ``make_array("raw")`` returns them.
        name
            The camera, for messages.

        Raises
        ------
        BadFrameError
            The buffer has another size.
        RefusedError
            The counts do not fit the bit depth.
        """
        unpacked = stored.astype(np.uint16) if self.pixel_format.endswith("8") else stored.view(np.uint16)
        width, height = self.stored_px
        if unpacked.shape[0] != height or unpacked.shape[1] < width:
            raise BadFrameError(
                f"{name}: delivered a buffer of {unpacked.shape[0]} x {unpacked.shape[1]} values for a frame of "
                f"{height} x {width} px (height x width)"
            )
        shifted = unpacked[:, :width]
        if np.any(shifted & ((1 << self.shift) - 1)) or int(shifted.max()) >> self.shift >= 1 << self.bit_depth:
            raise RefusedError(
                f"{name}: its counts do not fit {self.bit_depth} bits in {self.pixel_format}; correct "
                "camera.bit_depth of the rig file"
            )
        row, column = FIRST_RED[self.order]
        frame = shifted[row : row + self.frame_px[1], column : column + self.frame_px[0]]
        return np.ascontiguousarray(frame >> self.shift)
