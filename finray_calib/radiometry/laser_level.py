"""Level of the laser on the white reference, referred to the lamp."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import RadiometryError
from finray_calib.radiometry.session_steps import SessionSteps

Floats = NDArray[np.float64]


def channel_weights(steps: SessionSteps) -> Floats:
    """Return inverse-variance weights (3,), sum 1, of the channels for the laser level V.

    Raises
    ------
    RadiometryError
        No channel sees the laser on the white reference.
    """
    laser, lamp = steps.laser_white, steps.white[steps.excitation]
    v, w = laser.signal_dn_per_s, lamp.signal_dn_per_s
    good = (v > 0) & (w > 0)  # false for lost channels (NaN)
    v, w = np.where(good, v, 1.0), np.where(good, w, 1.0)
    variance = (laser.noise_variance / v**2 + lamp.noise_variance / w**2) * (v / w) ** 2
    weight = np.where(good, 1 / np.where(good, variance, 1.0), 0.0)
    if weight.sum() == 0:
        raise RadiometryError(
            "the white reference under the laser gives no signal through the excitation filter: is the laser on the "
            "tile, and does plan.excitation_filter name the filter of the laser line?"
        )
    return np.asarray(weight / weight.sum())


def laser_level(steps: SessionSteps, weights: Floats) -> float:
    """Return V = sum_c w_c (white under the laser / white under the lamp) through the excitation filter."""
    lamp = positive(steps.white[steps.excitation].signal_dn_per_s)
    return float((weights * np.nan_to_num(steps.laser_white.signal_dn_per_s) / lamp).sum())


def positive(signal: Floats) -> Floats:
    """Replace unusable (NaN, zero or negative) denominators by 1; their entries carry a flag."""
    return np.where(np.isfinite(signal) & (signal > 0), signal, 1.0)
