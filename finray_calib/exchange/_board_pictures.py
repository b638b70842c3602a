"""Pictures of a calibration board as grey levels, and the calibration that OpenCV's programs read."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import BadFrameError, CameraCalibration, ImportFormatError
from data_schemas.storage import tiff_image
from rigs.cameras import decoded_picture, read_content, read_raw

RAW_SUFFIXES = (".dng",)
TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def read_board_picture(path: Path, monochrome: bool = False) -> NDArray[np.uint8]:
    """Return a picture as grey levels of 8 bits (H, W), stretched to its own range.

    DNG, TIFF, PNG or JPEG. One number of 16 bits per pixel is taken for raw Bayer counts (RGGB), unless `monochrome`;
    of 8 bits for grey.

    Raises
    ------
    ImportFormatError
        The file is missing, is no picture, or shows nothing.
    """
    try:
        image = read_raw(path) if path.suffix.lower() in RAW_SUFFIXES else _decoded(path)
    except BadFrameError as error:
        raise ImportFormatError(str(error)) from None
    if image.ndim == 3 and image.shape[2] in (3, 4):
        levels = image[..., :3].astype(np.float64).mean(axis=2)
    elif image.ndim == 2 or image.shape[2] == 1:
        plane = image if image.ndim == 2 else image[..., 0]
        raw = plane.dtype == np.uint16 and not monochrome
        levels = (cv2.cvtColor(plane, cv2.COLOR_BayerRGGB2GRAY) if raw else plane).astype(np.float64)
    else:
        raise ImportFormatError(f"{path}: has {image.shape[2]} numbers per pixel; give 1 (raw or grey) or 3 (colour)")
    low, high = float(levels.min()), float(levels.max())
    if high <= low:
        raise ImportFormatError(f"{path}: every pixel has the same value ({low:g}); a board shows black and white")
    return np.asarray(np.rint((levels - low) / (high - low) * 255.0), dtype=np.uint8)


def calibration_yaml(calibration: CameraCalibration) -> bytes:
    """Return a calibration as cv2.FileStorage writes it, which `camera.calibration` of a design reads."""
    (fx, fy), (cx, cy) = calibration.focal_px, calibration.centre_px
    storage = cv2.FileStorage("", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML)
    storage.write("image_width", calibration.width_px)
    storage.write("image_height", calibration.height_px)
    storage.write("camera_matrix", np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))
    storage.write("distortion_coefficients", np.array([calibration.distortion]))
    storage.write("distortion_model", calibration.model)
    text: str = storage.releaseAndGetString()
    return text.encode()


def _decoded(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return the numbers of a TIFF, PNG or JPEG."""
    content = read_content(path)
    tiff = content[:4] in TIFF_STARTS
    image = tiff_image(content, path, ImportFormatError) if tiff else decoded_picture(content, path, ImportFormatError)
    if image.dtype not in (np.uint8, np.uint16):
        raise ImportFormatError(f"{path}: is no picture of 8 or 16 bits; give DNG, TIFF, PNG or JPEG")
    return np.asarray(image)
