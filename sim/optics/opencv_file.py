"""Read calibrations of a camera as OpenCV's own programs and ROS write them."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas.camera_calibration import CameraCalibration
from data_schemas.errors import ImportFormatError
from data_schemas.faults import explain
from data_schemas.foreign_files import read_bytes
from data_schemas.limited_parsing import parse_in_child

Floats = NDArray[np.float64]

_MATRIX_NAMES = ("camera_matrix", "K", "cameraMatrix")
_DISTORTION_NAMES = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D")
# what calibration programs call the two models; the second column are those of ROS
_MODEL_NAMES = {
    "pinhole": "pinhole", "plumb_bob": "pinhole", "rational_polynomial": "pinhole", "": "pinhole",
    "fisheye": "fisheye", "equidistant": "fisheye",
}  # fmt: skip
_LARGEST_FILE_BYTES = 1_000_000
_DEEPEST, _MOST_NUMBERS = 4, 64


def read_calibration(path: Path) -> CameraCalibration:
    """Read a calibration written by cv2.FileStorage (YAML or JSON), OpenCV's calibration sample, or ROS camera_info.

    Fields: camera_matrix (3 x 3); distortion_coefficients or dist_coeffs; image_width, image_height;
    distortion_model (pinhole or fisheye, plumb_bob, rational_polynomial or equidistant), pinhole if it is missing.

    Raises
    ------
    ImportFormatError
        The file is missing or unreadable, or a field is missing or not what it must be.
    """
    content = read_bytes(path, "an OpenCV calibration (YAML or JSON)", ImportFormatError, _LARGEST_FILE_BYTES)
    found, _ = parse_in_child(f"{__name__}:calibration_fields", content, path, "a calibration", ImportFormatError)
    try:
        return CameraCalibration.model_validate({**found["values"], "source": path.name})
    except ValidationError as error:
        reason = explain(error, CameraCalibration)
        raise ImportFormatError(f"{path}: {found['coefficients']} and {found['matrix']}: {reason}") from None


def calibration_fields(content: bytes, where: str) -> tuple[dict[str, Any], dict[str, Floats]]:
    """Return what a calibration says, not yet checked; it runs in a child process, for OpenCV's YAML crashes at depth.

    Raises
    ------
    ImportFormatError
        The file is unreadable, or a field is missing or not what it must be.
    """
    storage = _open_storage(content, where)
    try:
        matrix_name, matrix = _first_matrix(where, storage, _MATRIX_NAMES)
        coefficients_name, coefficients = _first_matrix(where, storage, _DISTORTION_NAMES)
        if matrix.size != 9:
            raise ImportFormatError(f"{where}: {matrix_name} must hold 3 x 3 numbers, got {matrix.size}")
        k = matrix.reshape(3, 3)
        if not (np.isfinite(matrix).all() and np.isfinite(coefficients).all()):
            raise ImportFormatError(f"{where}: {matrix_name} and {coefficients_name} must be finite numbers")
        if k[0, 1] != 0.0 or (k[1:, :2] != np.array([[0.0, k[1, 1]], [0.0, 0.0]])).any() or k[2, 2] != 1.0:
            raise ImportFormatError(f"{where}: {matrix_name} must be [fx 0 cx; 0 fy cy; 0 0 1], got {k.tolist()}")
        values: dict[str, Any] = {
            "model": _model(where, storage),
            "width_px": _whole_number(where, storage, "image_width"),
            "height_px": _whole_number(where, storage, "image_height"),
            "focal_px": (k[0, 0], k[1, 1]),
            "centre_px": (k[0, 2], k[1, 2]),
            "distortion": tuple(coefficients.tolist()),
        }
    finally:
        storage.release()
    return {"values": values, "matrix": matrix_name, "coefficients": coefficients_name}, {}


def _open_storage(content: bytes, where: str) -> Any:
    """Open a calibration; plain YAML gets the header that OpenCV's reader wants."""
    try:
        text = content.decode("utf-8")
        if not text.lstrip().startswith(("%YAML", "{", "<?xml")):
            text = "%YAML:1.0\n---\n" + text.lstrip().removeprefix("---")
        return cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError, UnicodeDecodeError) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise ImportFormatError(f"{where}: cannot be read as YAML or JSON of OpenCV ({reason})") from None


def _first_matrix(where: str, storage: Any, names: tuple[str, ...]) -> tuple[str, Floats]:
    """Return the name and the numbers of the first of several fields that is there."""
    for name in names:
        node = storage.getNode(name)
        if not node.empty():
            return name, _numbers(where, name, node)
    raise ImportFormatError(f"{where}: field {names[0]} is missing (also known as {', '.join(names[1:])})")


def _numbers(where: str, name: str, node: Any, depth: int = 0) -> Floats:
    """Return the numbers of OpenCV's matrix, of ROS's {rows, cols, data}, or of plain (nested) lists."""
    if depth > _DEEPEST or (node.isSeq() and node.size() > _MOST_NUMBERS):
        raise ImportFormatError(f"{where}: {name} must be a matrix of at most {_MOST_NUMBERS} numbers")
    if node.isMap():
        return _numbers(where, f"{name}.data", node.getNode("data"), depth + 1)
    if node.isSeq():
        items = [node.at(i) for i in range(node.size())]
        return np.concatenate([np.empty(0), *(_numbers(where, name, item, depth + 1) for item in items)])
    if node.isInt() or node.isReal():
        return np.array([node.real()])
    raise ImportFormatError(f"{where}: {name} must be a matrix or a list of numbers")


def _whole_number(where: str, storage: Any, name: str) -> int:
    """Return a field that counts pixels."""
    node = storage.getNode(name)
    if not node.isInt():
        raise ImportFormatError(f"{where}: field {name} (whole number of pixels) is missing")
    return int(node.real())


def _model(where: str, storage: Any) -> str:
    """Return which of the two models the coefficients belong to."""
    named = storage.getNode("distortion_model")
    if named.empty():
        sample = storage.getNode("fisheye_model")  # what OpenCV's calibration sample writes
        return "fisheye" if not sample.empty() and sample.real() == 1.0 else "pinhole"
    name = named.string().lower() if named.isString() else ""
    if name not in _MODEL_NAMES or not name:
        known = ", ".join(filter(None, _MODEL_NAMES))
        raise ImportFormatError(f"{where}: distortion_model is '{name}', known are {known}")
    return _MODEL_NAMES[name]
