"""The one exposure factor that a render may be granted, from the images without contact."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.render_layers import RenderLayers

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ExposureFit:
    """Hold the levels without contact that give the exposure factor of any draw.

    1 / k = mean over channels of S0 / B, each the mean over pixels: the white-balanced level is matched. One factor for
    all channels: a gain per channel would hide an error of the paint. It is taken from the images without contact,
    because fitted to the press itself it can stand in for missing physics: a depth-table prediction of a real ball
    press that leaves out the bright halo gains 0.18 of skill over the disc of twice the contact radius from a factor of
    1.04.

    Attributes
    ----------
    simulated_layers : ndarray, shape (L,)
        Mean of each layer of the render.
    captured : ndarray, shape (C,)
        Mean of each channel of the capture.
    noise_sd_rel : float
        Standard deviation of the factor from the noise of render and capture.
    """

    simulated_layers: Floats
    captured: Floats
    noise_sd_rel: float

    def __call__(self, matrix: Floats) -> Floats:
        """Return the factors (draws,) of matrices (draws, C, L)."""
        return np.asarray(1.0 / (matrix @ self.simulated_layers / self.captured).mean(axis=1))


def exposure_fit(layers: RenderLayers, no_contact: Floats, variance: Floats, used: NDArray[np.bool_]) -> ExposureFit:
    """Take the levels over the `used` pixels of the captured no-contact image (H, W, 3) and of its noise variance.

    Raises
    ------
    CompareError
        One of the images without contact is black there.
    """
    captured = no_contact[used].mean(axis=0)
    simulated = layers.no_contact[used].astype(np.float64).mean(axis=0)
    levels = layers.matrix @ simulated
    if not (captured > 0.0).all() or not float((levels / captured).mean()) > 0.0:
        raise CompareError(
            "no exposure factor fits: the render or the capture without contact is black over the region; check the "
            "light and the black level"
        )
    # 1 / k is a mean over channels of S0 / B, whose channels share the noise of the render's layers
    of_render = (layers.rgb(layers.no_contact_half)[used] / captured).mean(axis=1) ** 2
    of_capture = ((levels / captured**2) ** 2 * variance[used]).sum(axis=1) / len(captured) ** 2
    noise = np.sqrt((of_render + of_capture).mean() / used.sum()) / (levels / captured).mean()
    return ExposureFit(simulated, captured, float(noise))
