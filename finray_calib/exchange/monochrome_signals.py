"""Band signals of a monochrome camera in the three columns of a colour camera."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.radiometry import BandSignals, Flag

Floats = NDArray[np.float64]
# The sites of a 2 x 2 cell that count as red, green and blue: one, two and one pixel of the same channel.
MONOCHROME_SHARES = (0.25, 0.5, 0.25)
_GREEN = 1


def one_channel(bands: BandSignals) -> BandSignals:
    """Merge the three pixel groups of a monochrome camera into the green column; red and blue become "weak"."""
    filters = len(bands.flags)
    merge = np.zeros((3 * filters, 3 * filters))
    for b in range(filters):
        merge[3 * b + _GREEN, 3 * b : 3 * b + 3] = MONOCHROME_SHARES
    unused = np.diag(np.tile([1.0, 0.0, 1.0], filters))  # a variance for columns that hold nothing

    def values(of: Floats) -> Floats:
        return (merge @ of.ravel()).reshape(filters, 3)

    def covariance(of: Floats) -> Floats:
        merged = merge @ of @ merge.T
        return np.asarray((merged + merged.T) / 2 + unused)

    return bands.model_copy(
        update={
            "fluorescence": values(bands.fluorescence),
            "fluorescence_covariance": covariance(bands.fluorescence_covariance),
            "reflectance": values(bands.reflectance),
            "reflectance_covariance": covariance(bands.reflectance_covariance),
            "saturated_fraction": values(bands.saturated_fraction),
            "channel_weights": np.array([0.0, 1.0, 0.0]),
            "flags": tuple(("weak", _worst(row), "weak") for row in bands.flags),
        }
    )


def _worst(row: tuple[Flag, Flag, Flag]) -> Flag:
    """Return the worst of the flags of a band."""
    return "saturated" if "saturated" in row else "weak" if "weak" in row else "ok"
