"""Images as a screen would show them: what CIEDE2000 and FLIP are defined for."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError

Floats = NDArray[np.float64]
#: Shown as white: the brightest half per cent of the no-contact image may clip, as a photographer would expose.
WHITE_PERCENTILE = 99.5


def display_white_dn(no_contact: Floats) -> float:
    """Return the level that is shown as white: the 99.5th percentile of all channels of the no-contact capture.

    One level for all images of a comparison and all channels: neither an error of exposure nor one of colour is hidden.

    Parameters
    ----------
    no_contact : ndarray, shape (H, W, 3)
        Linear light, black level removed; pixels that are not finite do not count.

    Raises
    ------
    CompareError
        The level is not positive.
    """
    white_dn = float(np.nanpercentile(no_contact, WHITE_PERCENTILE)) if np.isfinite(no_contact).any() else 0.0
    if not white_dn > 0:
        raise CompareError(
            f"The no-contact image is black ({WHITE_PERCENTILE} % of it lies at or below {white_dn:g} DN above the "
            "black level), so it cannot be shown: check the light and the black level of the capture"
        )
    return white_dn


def displayed_image(image: Floats, white_dn: float, linear: bool) -> Floats:
    """Return sRGB in 0..1: linear light over white through the curve of IEC 61966-2-1, encoded values over white as is.

    The channels are taken for the primaries of sRGB, which a raw camera's are not: differences of displayed images are
    for people's eyes. Values outside are clipped; NaN stays NaN.

    Parameters
    ----------
    image : ndarray, shape (H, W, 3)
    white_dn : float
        Level shown as white: `display_white_dn` for linear light, full scale for encoded values.
    linear : bool

    Raises
    ------
    CompareError
        The white level is not positive.
    """
    if not white_dn > 0:
        raise CompareError(f"The white level must be positive, got {white_dn} DN; give full scale, as 255 for 8 bit")
    share = np.clip(image / white_dn, 0.0, 1.0)
    if not linear:
        return np.asarray(share)
    return np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)
