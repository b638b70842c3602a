"""Relative root-mean-square error per channel: the photometric error of absolute pipelines."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.regions import pixels_within, usable_pixels


def relative_rms(
    simulated: NDArray[np.float64],
    captured: NDArray[np.float64],
    mask: NDArray[np.bool_],
    exposure_k: float = 1.0,
) -> NDArray[np.float64]:
    """Return the root-mean-square error of each channel relative to the capture's mean.

    sqrt(mean_p (k S - D)^2) / mean_p D, per channel. Valid for linear light with the black level removed only:
    an encoded value has no meaningful mean.

    Parameters
    ----------
    simulated, captured : ndarray, shape (H, W, C)
        Registered linear images in one unit; pixels that are not finite are left out.
    mask : ndarray of bool, shape (H, W)
    exposure_k : float
        Factor on the simulation.

    Returns
    -------
    ndarray, shape (C,)
        Dimensionless.

    Raises
    ------
    CompareError
        If shapes differ, no pixel is usable, or a channel of the capture is not positive in the mean.
    """
    simulation, capture = (np.asarray(image, dtype=np.float64) for image in (simulated, captured))
    used = usable_pixels(mask, simulation, capture)
    real = pixels_within(capture, used)
    mean = np.einsum("pc->c", real) / len(real)
    if (mean <= 0).any():
        raise CompareError(
            f"Channel {int(np.argmin(mean))} of the capture has mean {mean.min():.3g} over the region; a relative "
            "error needs a positive mean. Check the black level that was subtracted."
        )
    error = exposure_k * pixels_within(simulation, used) - real
    return np.asarray(np.sqrt(np.einsum("pc,pc->c", error, error) / len(real)) / mean)
