"""Read a 9DTact calibration folder: the images of a ball press, the scale and the depth table."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.array_files import read_npy
from data_schemas.errors import ImportFormatError
from finray_calib.exchange.nine_dtact_table import ContactCircle, contact_circle
from rigs.cameras.picture_files import read_picture

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
    circle : ContactCircle
        Around the contact in `sample_rgb`.
    """

    no_contact_rgb: NDArray[np.uint8]
    sample_rgb: NDArray[np.uint8]
    repeat_no_contact_rgb: NDArray[np.uint8]
    mm_per_px: float
    ball_radius_mm: float
    depth_table_mm: NDArray[np.float64]
    circle: ContactCircle


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
        circle=contact_circle(no_contact, sample),
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
        If the file is missing, pickled, or does not hold depths that grow from entry 1 on.
    """
    table = np.asarray(_load_array(path), dtype=np.float64)
    if table.ndim != 1 or len(table) < 3 or not (np.diff(table[1:]) > 0).all():
        raise ImportFormatError(
            f"{path}: expected one depth in mm per grey level, growing from entry 1 on, got shape {table.shape}. "
            "Run the maker's depth calibration again."
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
                f"{camera / name}: expected {_RAW_SHAPE[0]} x {_RAW_SHAPE[1]} whole pixel indices from 0 to "
                f"{limit - 1}, got {index.dtype} of shape {index.shape}. Run the maker's camera calibration again."
            )
        indices.append(index)
    top, left = int(center_row - _CROP_SHAPE[0] / 2), int(center_column - _CROP_SHAPE[1] / 2)
    rectified: NDArray[np.uint8] = raw[indices[0], indices[1]]
    crop = rectified[max(top, 0) : top + _CROP_SHAPE[0], max(left, 0) : left + _CROP_SHAPE[1]]
    if crop.shape != _CROP_SHAPE:
        raise ImportFormatError(
            f"{camera / 'position_scale.npy'}: the crop of {_CROP_SHAPE[0]} x {_CROP_SHAPE[1]} px around row "
            f"{center_row:.0f}, column {center_column:.0f} leaves the image of {_RAW_SHAPE[0]} x {_RAW_SHAPE[1]} px."
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
        raise ImportFormatError(f"{path}: expected real numbers, got {array.dtype}. Save it again from numbers.")
    return array


def _load_rgb(path: Path, shape: tuple[int, int, int]) -> NDArray[np.uint8]:
    """Load an 8-bit colour image in RGB order."""
    if not path.is_file():
        raise ImportFormatError(f"{path}: no such file. Give the folder of one sensor as the maker's code wrote it.")
    bgr = read_picture(path, "an 8-bit colour image", ImportFormatError)
    if bgr.shape != shape or bgr.dtype != np.uint8:
        raise ImportFormatError(
            f"{path}: expected an 8-bit colour image of {shape[0]} x {shape[1]} px, got {bgr.dtype} of {bgr.shape}."
        )
    return np.asarray(bgr[..., ::-1], dtype=np.uint8)
