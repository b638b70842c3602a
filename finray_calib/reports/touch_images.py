"""The images of a touch as a screen shows them: light of each source unmixed where that is possible, cut to the pad."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.simulate import SimulatedPress
from finray_calib.reports.images import ByteImage, display_white, missing, to_display, with_clipped, with_outline

SHOWN_AS_RGB = ("red", "green", "led")
"""Bands shown as red, green and blue: emission of the two paints, and light of the LED."""
MARGIN_REL = 0.12
"""Border left around the pad, as a share of its height in the image; the painted walls lie in it."""


def is_unmixed(press: SimulatedPress) -> bool:
    """Whether the images of a press, and of its capture, can be split into red emission, green emission and LED."""
    return press.encoding == "linear" and press.camera_matrix is not None and set(press.bands) == set(SHOWN_AS_RGB)


def touch_pair(
    press: SimulatedPress, no_contact: NDArray[np.floating], contact: NDArray[np.floating], region: NDArray[np.bool_]
) -> tuple[ByteImage, ByteImage]:
    """Return the untouched and the touched image for the screen, cut to the pad; the second with a region outlined.

    Camera RGB x becomes bands C^-1 x with the press's camera matrix C. Both images are divided by the same white:
    a high percentile of each band over the untouched pad, so that glare beside the pad does not set the scale.
    Without a camera matrix the camera's own channels are shown.

    Parameters
    ----------
    press
        Gives camera matrix, encoding and the pad.
    no_contact, contact
        (H, W, 3) images of one camera, on the grid of the press, any unit; NaN where clipped, which is drawn so.
    region
        (H, W) mask that is outlined.

    Raises
    ------
    RecordError
        When a channel has no light on the pad.
    """
    before, after = (shown_bands(press, np.asarray(image, dtype=np.float64)) for image in (no_contact, contact))
    pad = np.isfinite(press.distance)
    white, linear = display_white(before[pad]), press.encoding == "linear"
    shown, touched = (with_clipped(to_display(image, white, linear), missing(image)) for image in (before, after))
    window = pad_window(press)
    return shown[window], with_outline(touched, region)[window]


def pad_window(press: SimulatedPress) -> tuple[slice, slice]:
    """Return rows and columns that hold the pad and a margin."""
    rows, columns = np.nonzero(np.isfinite(press.distance))
    margin = round(MARGIN_REL * (rows.max() - rows.min()))
    return (
        slice(int(max(rows.min() - margin, 0)), int(rows.max() + margin + 1)),
        slice(int(max(columns.min() - margin, 0)), int(columns.max() + margin + 1)),
    )


def shown_bands(press: SimulatedPress, image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light of each source in the order it is shown, or the image itself."""
    if press.camera_matrix is None or not is_unmixed(press):
        return image
    order = [press.bands.index(name) for name in SHOWN_AS_RGB]
    # A camera whose channels see alike has no inverse; the pseudo-inverse then still gives a picture.
    return np.asarray(image @ np.linalg.pinv(press.camera_matrix)[order].T)
