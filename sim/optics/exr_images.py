"""OpenEXR images of single precision, written by the renderer's own writer: no further package is needed."""

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.optics.variants import SCALAR_VARIANT


def exr_image(channels: Mapping[str, NDArray[Any]], attributes: Mapping[str, str]) -> bytes:
    """Return channels as one OpenEXR image of scan lines, losslessly compressed (PIZ).

    Parameters
    ----------
    channels
        Values (rows, columns) by name; a dot separates a layer from its channel. Stored as 32-bit floats.
    attributes
        Further fields of the header: text only, for the renderer's writer makes doubles of all numbers.
    """
    mitsuba = importlib.import_module("mitsuba")
    if mitsuba.variant() is None:
        mitsuba.set_variant(SCALAR_VARIANT)  # images are the same in all variants
    values = np.stack([np.asarray(channel, dtype=np.float32) for channel in channels.values()], axis=-1)
    image = mitsuba.Bitmap(values, mitsuba.Bitmap.PixelFormat.MultiChannel, list(channels))
    header = image.metadata()
    for name, text in attributes.items():
        header[name] = text
    stream = mitsuba.MemoryStream()
    image.write(stream, mitsuba.Bitmap.FileFormat.OpenEXR)
    return bytes(stream.raw_buffer())
