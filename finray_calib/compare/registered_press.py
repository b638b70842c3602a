"""A simulated press on the pixel grid of a capture: every image of the record moved by one map."""

from typing import Any, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas.arrays import ArraySpec
from data_schemas.capture import TactileCapture
from data_schemas.errors import CompareError
from data_schemas.model import Model
from data_schemas.simulate import SimulatedPress
from finray_calib.compare.image_warp import warp_image
from finray_calib.compare.linear_image import rgb_image
from finray_calib.compare.registration import Registration, register

Floats = NDArray[np.float64]


def register_press(press: SimulatedPress, capture: TactileCapture) -> tuple[Registration, str]:
    """Find the drift of the camera between a render and a capture.

    On the images without contact, where nothing but the camera can move; where they have too few edges, on those with
    contact, which takes an error of the indenter's place for a part of the drift.

    Returns
    -------
    Registration
    str
        "no contact" or "contact": the images it rests on.

    Raises
    ------
    CompareError
        Neither pair of images gives a map that can be trusted; the message holds both reasons.
    """
    reasons = []
    pairs = (
        ("no contact", press.no_contact, capture.no_contact),
        ("contact", press.contact, capture.contact),
    )
    for state, rendered, counts in pairs:
        try:
            return register(rendered.astype(np.float64), rgb_image(counts, capture)), state
        except CompareError as error:
            reasons.append(f"on the images with {state}: {error}")
    raise CompareError("; ".join(reasons))


def move_press(press: SimulatedPress, to_render: Floats) -> SimulatedPress:
    """Return a press with all its images and the distance map on the grid of the capture.

    Light is interpolated by Lanczos' kernel over 8 x 8 pixels and stays at or above zero where it was; beyond the
    render's edge the nearest pixel stands in, and the distance is NaN there, so that no region holds such a pixel. The
    distance is interpolated linearly. Variances become those of interpolated pixels up to their correlation.

    Parameters
    ----------
    press : SimulatedPress
        In linear light, or a table prediction in encoded values, whose interpolation is an approximation.
    to_render : ndarray, shape (2, 3)
        See `finray_calib.compare.registration.Registration`.
    """
    moved = _moved(press, to_render)
    distance = warp_image(press.distance, to_render, cv2.INTER_LINEAR)
    distance[np.isnan(warp_image(press.contact, to_render)).any(axis=2)] = np.nan
    return press.model_copy(update={**moved, "distance": distance.astype(np.float32)})


def _moved(record: Model, to_render: Floats) -> dict[str, Any]:
    """Return the fields of a record that hold images, moved; fields in inner records too."""
    update: dict[str, Any] = {}
    for name, info in type(record).model_fields.items():
        value = getattr(record, name)
        # the spec of an optional array stands inside the union
        inner = (m for part in get_args(info.annotation) for m in getattr(part, "__metadata__", ()))
        spec = next((m for m in (*info.metadata, *inner) if isinstance(m, ArraySpec)), None)
        if isinstance(value, Model):
            update[name] = value.model_copy(update=_moved(value, to_render))
        elif value is not None and spec is not None and "row" in spec.dims and not spec.allow_nan:
            update[name] = _moved_image(value, spec.dims.index("row"), to_render)
    return update


def _moved_image(image: NDArray[np.float32], row_axis: int, to_render: Floats) -> NDArray[np.float32]:
    """Return an array whose rows and columns are those of an image, moved plane by plane."""
    rows, columns = image.shape[row_axis : row_axis + 2]
    planes = np.moveaxis(image, (row_axis, row_axis + 1), (-2, -1)).astype(np.float64)
    moved = np.empty(planes.shape, dtype=np.float32)
    flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
    for index in np.ndindex(planes.shape[:-2]):
        plane = np.ascontiguousarray(planes[index])
        warped = cv2.warpAffine(plane, to_render, (columns, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        # the kernel overshoots at edges, but light is never negative
        moved[index] = np.maximum(warped, 0.0) if plane.min() >= 0 else warped
    return np.ascontiguousarray(np.moveaxis(moved, (-2, -1), (row_axis, row_axis + 1)))
