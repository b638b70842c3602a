"""Predict the ball press of a 9DTact sensor from its own depth table.

The sensor sees a black gel through a translucent layer: contact makes a dark blob whose darkness grows with
depth. The maker's calibration is a table of depth against grey levels of darkening. Reproducing it gives a
simulation by table, a reference that any physical model has to beat.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import ImportFormatError
from finray_calib.compare.regions import disc

#: Grey levels of darkening that the maker's own calibration takes as contact.
_CONTACT_LEVELS_DN = 3


@dataclass(frozen=True, slots=True)
class ContactCircle:
    """Hold the circle around a contact: centre as (row, column) and radius, px."""

    center_px: tuple[int, int]
    radius_px: int


def contact_circle(no_contact_rgb: NDArray[np.uint8], sample_rgb: NDArray[np.uint8]) -> ContactCircle:
    """Return the circle that encloses the largest region darkened by contact.

    A pixel is in contact where the mean over channels of max(0, no_contact - sample) exceeds 3 DN. Valid for a
    press that leaves one blob, as a ball does.

    Parameters
    ----------
    no_contact_rgb, sample_rgb : ndarray of uint8, shape (H, W, 3)

    Returns
    -------
    ContactCircle
        Rounded down to whole pixels, as the maker's calibration does.

    Raises
    ------
    ImportFormatError
        If no pixel got darker by more than 3 DN.
    """
    darkening = np.maximum(no_contact_rgb.astype(np.int16) - sample_rgb, 0).mean(axis=2)
    contours, _ = cv2.findContours(
        (darkening > _CONTACT_LEVELS_DN).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    if not contours:
        raise ImportFormatError(
            f"No pixel of the sample is darker than the no-contact image by more than {_CONTACT_LEVELS_DN} DN, so "
            "there is no contact. Check that the two images are not exchanged."
        )
    (column, row), radius = cv2.minEnclosingCircle(max(contours, key=cv2.contourArea))
    return ContactCircle((int(row), int(column)), int(radius))


def predict_press(
    no_contact_rgb: NDArray[np.uint8],
    circle: ContactCircle,
    mm_per_px: float,
    ball_radius_mm: float,
    table_mm: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Predict the image of a pressed ball from a depth table.

    Inside the circle (radius a) the gel follows a rigid ball, depth(r) = sqrt(R^2 - r^2) - sqrt(R^2 - a^2); the
    grey level whose table entry has that depth, interpolated linearly, is subtracted from all channels. The
    gel around the ball is left as it was, which is wrong: it bulges and gets brighter. Depths beyond the table
    take its last level.

    Parameters
    ----------
    no_contact_rgb : ndarray of uint8, shape (H, W, 3)
    circle : ContactCircle
    mm_per_px, ball_radius_mm : float
    table_mm : ndarray, shape (levels,)
        Depth at each grey level. Entries 0 and 1 are replaced by zero depth at level 0: the maker's entry 0 is
        the result of an indexing mistake and entry 1 is noise of the threshold.

    Returns
    -------
    ndarray, shape (H, W, 3)

    Raises
    ------
    ImportFormatError
        If the circle is as large as the ball.
    """
    contact_radius_mm = circle.radius_px * mm_per_px
    if contact_radius_mm >= ball_radius_mm:
        raise ImportFormatError(
            f"The contact circle has radius {contact_radius_mm:.3f} mm, not less than the ball's "
            f"{ball_radius_mm:.3f} mm. Check the scale (mm per px, not px per mm) and the ball radius."
        )
    inside = disc(no_contact_rgb.shape[:2], circle.center_px, circle.radius_px)
    rows, columns = np.nonzero(inside)
    distance_mm = mm_per_px * np.hypot(rows - circle.center_px[0], columns - circle.center_px[1])
    depth_mm = np.sqrt(ball_radius_mm**2 - distance_mm**2) - np.sqrt(ball_radius_mm**2 - contact_radius_mm**2)
    levels = np.arange(len(table_mm))
    darkening = np.interp(depth_mm, np.r_[0.0, table_mm[2:]], np.r_[0.0, levels[2:]])
    prediction = no_contact_rgb.astype(np.float64)
    prediction[inside] -= darkening[:, None]
    return prediction
