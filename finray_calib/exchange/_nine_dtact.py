"""9DTact calibration folders as records: a tactile capture, and a table prediction carried over from another sensor.

A folder holds the images of a ball press, the scale and the depth table. The sensor sees a black gel through a
translucent layer: contact makes a dark blob whose darkness grows with depth. The maker's calibration is a table of
depth against grey levels of darkening. Reproducing it gives a simulation by table, a reference that any physical
model has to beat.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import ContactCircle, ImportFormatError, IndenterPose, SimulatedPress, TactileCapture
from data_schemas.storage import read_npy
from finray_calib.compare import disc
from rigs.cameras import read_picture

#: Grey levels of darkening that the maker's own calibration takes as contact.
_CONTACT_LEVELS_DN = 3


@dataclass(frozen=True, slots=True)
class DarkenedCircle:
    """Hold the circle around a contact: centre as (row, column) and radius, px."""

    center_px: tuple[int, int]
    radius_px: int


def darkened_circle(no_contact_rgb: NDArray[np.uint8], sample_rgb: NDArray[np.uint8]) -> DarkenedCircle:
    """Return the circle that encloses the largest region darkened by contact.

    A pixel is in contact where the mean over channels of max(0, no_contact - sample) exceeds 3 DN. Valid for a
    press that leaves one blob, as a ball does.

    Parameters
    ----------
    no_contact_rgb, sample_rgb : ndarray of uint8, shape (H, W, 3)

    Returns
    -------
    DarkenedCircle
        Rounded down to whole pixels, as the maker's calibration does.

    Raises
    ------
    ImportFormatError
        If no pixel got darker by more than 3 DN, or the circle has a radius below 1 px.
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
    if radius < 1.0:
        raise ImportFormatError(
            "The largest region of the sample that is darker than the no-contact image by more than "
            f"{_CONTACT_LEVELS_DN} DN has a radius below 1 px, so it is noise, and there is no contact. Check that the "
            "sample shows the ball pressed on, and that the two images are not exchanged."
        )
    return DarkenedCircle((int(row), int(column)), int(radius))


def predict_press(
    no_contact_rgb: NDArray[np.uint8],
    circle: DarkenedCircle,
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
    circle : DarkenedCircle
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
            f"The contact circle has a radius of {contact_radius_mm:.3f} mm, but it must be below the ball's radius, "
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


BALL_RADIUS_MM = 4.0
_RAW_SHAPE = (480, 640, 3)
_CROP_SHAPE = (345, 460, 3)


@dataclass(frozen=True, slots=True)
class NineDTactSensor:
    """Hold one sensor's ball press with its calibration.

    Attributes
    ----------
    no_contact_rgb, sample_rgb, repeat_no_contact_rgb : ndarray of uint8, shape (345, 460, 3)
        Rectified and cropped images in RGB order: before the press, with the ball pressed on, and a no-contact
        image from another step of the calibration. Camera-encoded, encoding unknown.
    mm_per_px : float
        Scale of the rectified images.
    ball_radius_mm : float
    depth_table_mm : ndarray, shape (levels,)
        Depth at each whole grey level of darkening, as stored; entry 0 is meaningless.
    circle : DarkenedCircle
        Around the contact in `sample_rgb`.
    """

    no_contact_rgb: NDArray[np.uint8]
    sample_rgb: NDArray[np.uint8]
    repeat_no_contact_rgb: NDArray[np.uint8]
    mm_per_px: float
    ball_radius_mm: float
    depth_table_mm: NDArray[np.float64]
    circle: DarkenedCircle


def read_nine_dtact(sensor_folder: Path) -> NineDTactSensor:
    """Read the ball press and the calibration of one 9DTact sensor.

    The repeat of the no-contact image is ``camera_calibration/ref.png``, taken at an earlier step of the same
    calibration. The maker names the scale "pixel per mm"; it is millimetres per pixel.

    Parameters
    ----------
    sensor_folder : Path
        The folder that holds ``camera_calibration`` and ``depth_calibration``.

    Returns
    -------
    NineDTactSensor

    Raises
    ------
    ImportFormatError
        If a file is missing, has the wrong shape, or would need unpickling.
    """
    depth = sensor_folder / "depth_calibration"
    no_contact = _load_rgb(depth / "rectify_crop_ref.png", _CROP_SHAPE)
    sample = _load_rgb(depth / "rectify_crop_sample.png", _CROP_SHAPE)
    return NineDTactSensor(
        no_contact_rgb=no_contact,
        sample_rgb=sample,
        repeat_no_contact_rgb=load_rectified_crop(sensor_folder, "camera_calibration/ref.png"),
        mm_per_px=_load_position_scale(sensor_folder / "camera_calibration")[2],
        ball_radius_mm=BALL_RADIUS_MM,
        depth_table_mm=load_depth_table(depth / "Pixel_to_Depth.npy"),
        circle=darkened_circle(no_contact, sample),
    )


def load_depth_table(path: Path) -> NDArray[np.float64]:
    """Load a depth table (mm per grey level) without running code from the file.

    Parameters
    ----------
    path : Path
        A ``Pixel_to_Depth.npy``.

    Returns
    -------
    ndarray, shape (levels,)
        Depth in mm, as stored.

    Raises
    ------
    ImportFormatError
        If the file is missing, pickled, or holds other than depths that grow, above 0 mm from entry 2 on.
    """
    table = np.asarray(_load_array(path), dtype=np.float64)
    # the maker's fit leaves entry 0 below 0, and entry 1 near it: no depth is read from them
    is_table = table.ndim == 1 and len(table) > 2 and bool(np.isfinite(table).all())
    if not (is_table and (np.diff(table[1:]) > 0).all() and table[2] > 0):
        raise ImportFormatError(
            f"{path}: expected one finite depth in mm per grey level, increasing from entry 1 on and above 0 mm from "
            f"entry 2 on, got an array of shape {table.shape}. Run the maker's depth calibration again."
        )
    return table


def load_rectified_crop(sensor_folder: Path, image: str) -> NDArray[np.uint8]:
    """Load a raw image of one sensor, rectify it and crop it around the centre dot.

    rectified[r, c] = raw[row_index[r, c], col_index[r, c]], then 345 x 460 px from int(centre - size / 2).

    Parameters
    ----------
    sensor_folder : Path
        The folder that holds ``camera_calibration`` and ``depth_calibration``.
    image : str
        Path of a raw 480 x 640 image below it.

    Returns
    -------
    ndarray of uint8, shape (345, 460, 3)
        In RGB order.

    Raises
    ------
    ImportFormatError
        If a file is missing or has the wrong shape, or the map points outside the image.
    """
    camera = sensor_folder / "camera_calibration"
    raw = _load_rgb(sensor_folder / image, _RAW_SHAPE)
    center_row, center_column, _ = _load_position_scale(camera)
    indices: list[NDArray[np.int32]] = []
    for name, limit in (("row_index.npy", _RAW_SHAPE[0]), ("col_index.npy", _RAW_SHAPE[1])):
        index = _load_array(camera / name)
        if index.shape != _RAW_SHAPE[:2] or index.dtype.kind != "i" or index.min() < 0 or index.max() >= limit:
            raise ImportFormatError(
                f"{camera / name}: expected {_RAW_SHAPE[0]} x {_RAW_SHAPE[1]} integer pixel indices from 0 to "
                f"{limit - 1}, got {index.dtype} of shape {index.shape}. Run the maker's camera calibration again."
            )
        indices.append(index)
    top, left = int(center_row - _CROP_SHAPE[0] / 2), int(center_column - _CROP_SHAPE[1] / 2)
    rectified: NDArray[np.uint8] = raw[indices[0], indices[1]]
    crop = rectified[max(top, 0) : top + _CROP_SHAPE[0], max(left, 0) : left + _CROP_SHAPE[1]]
    if crop.shape != _CROP_SHAPE:
        raise ImportFormatError(
            f"{camera / 'position_scale.npy'}: the crop of {_CROP_SHAPE[0]} x {_CROP_SHAPE[1]} px around row "
            f"{center_row:.0f}, column {center_column:.0f} extends beyond the image of {_RAW_SHAPE[0]} x "
            f"{_RAW_SHAPE[1]} px."
        )
    return crop


def _load_position_scale(camera_folder: Path) -> tuple[float, float, float]:
    """Return row and column of the centre dot (px) and the scale (mm per px)."""
    path = camera_folder / "position_scale.npy"
    values = _load_array(path)
    if values.shape != (3,) or not (np.isfinite(values).all() and (values > 0).all()):
        raise ImportFormatError(
            f"{path}: expected three positive numbers (row px, column px, mm per px), got {values.tolist()}."
        )
    row, column, mm_per_px = (float(value) for value in values)
    return row, column, mm_per_px


def _load_array(path: Path) -> NDArray[Any]:
    """Load a plain numeric .npy file; a pickled one could run a stranger's code."""
    if not path.is_file():
        raise ImportFormatError(f"{path}: no such file. Give the folder of one sensor as the maker's code wrote it.")
    array = read_npy(path, "an array of numbers (.npy)", ImportFormatError)
    if array.dtype.kind not in "iuf":
        raise ImportFormatError(f"{path}: expected real numbers, got {array.dtype}. Save the array again as numbers.")
    return array


def _load_rgb(path: Path, shape: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Load an 8-bit colour image in RGB order."""
    if not path.is_file():
        raise ImportFormatError(f"{path}: no such file. Give the folder of one sensor as the maker's code wrote it.")
    bgr = read_picture(path, "an 8-bit colour image", ImportFormatError)
    if bgr.shape != shape or bgr.dtype != np.uint8:
        raise ImportFormatError(
            f"{path}: expected an 8-bit colour image of {shape[0]} x {shape[1]} px, got {bgr.dtype} of shape "
            f"{bgr.shape}."
        )
    return np.asarray(bgr[..., ::-1], dtype=np.uint8)


TABLE_LABEL = "table, not rendered"


def nine_dtact_capture(folder: Path) -> TactileCapture:
    """Read a sensor folder of 9DTact (ball press, no contact, repeat of no contact) as a tactile capture.

    The images are camera-encoded 8-bit values whose transfer curve nobody recorded: ``encoding`` is "unknown".
    """
    sensor = read_nine_dtact(folder)
    return TactileCapture(
        name=_name(folder),
        contact=sensor.sample_rgb.astype(np.uint16),
        no_contact=sensor.no_contact_rgb.astype(np.uint16),
        repeat_no_contact=sensor.repeat_no_contact_rgb.astype(np.uint16),
        layout="RGB",
        encoding="unknown",
        bit_depth=8,
        black_level_dn=0.0,
        exposure_s=None,
        light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=sensor.ball_radius_mm, depth_mm=None, position_mm=None),
        contact_circle=ContactCircle(
            row_px=float(sensor.circle.center_px[0]),
            column_px=float(sensor.circle.center_px[1]),
            radius_px=float(sensor.circle.radius_px),
        ),
        mm_per_px=sensor.mm_per_px,
        source=f"9DTact calibration folder '{folder.name}' (MIT licence, (c) Changyi Lin)",
    )


def nine_dtact_prediction(folder: Path, other: Path) -> SimulatedPress:
    """Predict the ball press of `folder` with the darkening-to-depth table of the sensor in `other`.

    The prediction darkens the no-contact image inside the contact circle only: it knows no optics and no
    mechanics, and is the baseline that a rendered press has to beat.
    """
    sensor, donor = read_nine_dtact(folder), read_nine_dtact(other)
    predicted = predict_press(
        sensor.no_contact_rgb, sensor.circle, sensor.mm_per_px, sensor.ball_radius_mm, donor.depth_table_mm
    )
    return SimulatedPress(
        name=f"{_name(folder)}, table of {other.name}",
        label=TABLE_LABEL,
        method="table",
        encoding="unknown",
        no_contact=sensor.no_contact_rgb.astype(np.float32),
        contact=np.asarray(predicted, dtype=np.float32),
        distance=_distance(sensor),
        variance=None,
        light_angle_deg=None,
        design=None,
        notes=(f"predicted by the depth table of another sensor, {other.name}; nothing is rendered",),
    )


def _name(folder: Path) -> str:
    """Name a capture after its folder."""
    return f"9DTact {folder.resolve().name}"


def _distance(sensor: NineDTactSensor) -> NDArray[np.float32]:
    """Return the distance of each pixel from the circle's centre in radii."""
    rows, columns = np.indices(sensor.sample_rgb.shape[:2])
    row, column = sensor.circle.center_px
    distance: NDArray[np.float64] = np.hypot(rows - row, columns - column) / sensor.circle.radius_px
    return distance.astype(np.float32)
