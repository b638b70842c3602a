"""The curve between the levels of a render and of a capture: straight, a power, or with an offset."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Below this correlation the two images do not show the same light, and no curve between their levels means anything.
LEAST_CORRELATION = 0.9
#: Standard deviation of the logarithm of the render's levels that a curve needs: a flat field has none.
LEAST_CONTRAST = 0.15


@dataclass(frozen=True, slots=True)
class ToneCurve:
    """Fit of a capture's levels to a render's, in the channel where they agree best.

    Attributes
    ----------
    channel : str
    exponent : float
        p of capture = a render^p; 1 for linear light.
    correlation : float
        Of the logarithms of the levels.
    offset_dn : float
        b of capture = k render + b.
    offset_fits_better : bool
        Whether the straight line with offset leaves less than the power.
    """

    channel: str
    exponent: float
    correlation: float
    offset_dn: float
    offset_fits_better: bool


def tone_curve(rendered: Floats, captured: Floats) -> ToneCurve | None:
    """Fit the exponent between the levels of a render and of a capture.

    p = sd(log D) / sd(log S): both have errors, so that neither may stand as the exact one. Channels are fitted apart
    (a gain for each), and the one with the highest correlation speaks.

    Parameters
    ----------
    rendered, captured : ndarray, shape (P, 3)
        Positive levels of the same places.

    Returns
    -------
    ToneCurve or None
        None where the images have too little contrast or too little in common.
    """
    logs = np.log(rendered), np.log(captured)
    contrasts = [values.std(axis=0) for values in logs]
    enough = (contrasts[0] >= LEAST_CONTRAST) & (contrasts[1] >= LEAST_CONTRAST / 10)
    correlations = [float(np.corrcoef(logs[0][:, c], logs[1][:, c])[0, 1]) if enough[c] else 0.0 for c in range(3)]
    channel = int(np.argmax(correlations))
    if correlations[channel] < LEAST_CORRELATION:
        return None
    level, real = rendered[:, channel], captured[:, channel]
    exponent = float(contrasts[1][channel] / contrasts[0][channel])
    power = level**exponent
    power *= (real * power).sum() / (power * power).sum()
    gain, offset = np.polyfit(level, real, 1)
    line_error, power_error = (float(((fit - real) ** 2).sum()) for fit in (gain * level + offset, power))
    return ToneCurve(
        ("red", "green", "blue")[channel], exponent, correlations[channel], float(offset), line_error < power_error
    )
