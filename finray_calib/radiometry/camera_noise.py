"""Temporal noise of one raw pixel."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas.devices import CameraSettings


def noise_variance_dn2(signal_dn: ArrayLike, camera: CameraSettings) -> NDArray[np.float64]:
    r"""Return the temporal variance of one pixel by the photon transfer relation.

    .. math:: \mathrm{var}(D) = \sigma_r^2 / K^2 + S / K + 1/12

    Valid below saturation. Read noise and gain are those of the camera settings; the gain cancels in the ratios
    that the band signals are, so that its error moves only these variances, all alike.

    Parameters
    ----------
    signal_dn
        Mean count from light and dark current (DN), any shape; negative values count as dark.
    camera
        Its gain K (e/DN) and read noise (e).

    Source: EMVA Standard 1288, release 4.0.
    """
    shot = np.maximum(np.asarray(signal_dn, dtype=np.float64), 0.0) / camera.gain_e_per_dn
    return np.asarray(shot + (camera.read_noise_e / camera.gain_e_per_dn) ** 2 + 1 / 12)
