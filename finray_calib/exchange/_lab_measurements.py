"""What a lab measures beside its captures: force over displacement, and pictures of a calibration board.

The CSV of a force has comment lines that start with #, one header row, and units in its names. Pictures of a board are
read as grey levels; the calibration made of them leaves as OpenCV's programs read it.
"""

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import BadFrameError, CameraCalibration, CompareError, CurveError, ImportFormatError
from data_schemas.storage import read_table, tiff_image
from finray_calib.exchange._set_files import TIFF_STARTS
from finray_calib.force import MeasuredForce
from rigs.cameras import decoded_picture, read_content, read_raw

NEEDED: Final = ("displacement_mm", "force_n")
#: Of the range of displacements: less is the jitter of a gauge.
_BACK_REL: Final = 0.05
OPTIONAL: Final = ("force_uncertainty_n", "displacement_uncertainty_mm")


def read_force_csv(path: Path) -> MeasuredForce:
    """Read a measured loading curve.

    Rows in the order of the measurement, loading only. Columns in any order: displacement_mm of the indenter along the
    pad's normal and force_n that pushes it back; if known, force_uncertainty_n and displacement_uncertainty_mm
    (standard uncertainties, independent between rows).

    Raises
    ------
    ImportFormatError
        The file is missing or no table of finite numbers, or a column is missing, doubled or unknown.
    CompareError
        There are too few points, an uncertainty is negative, the force pulls, or the indenter goes back.
    """
    try:
        header, table = read_table(path)
    except CurveError as error:
        raise ImportFormatError(str(error)) from None
    # a byte order mark that came under a comment
    header = [name.removeprefix("\ufeff").lower() for name in header]
    allowed = f"required columns are {', '.join(NEEDED)}; {', '.join(OPTIONAL)} are also allowed"
    unknown = [name for name in header if name not in {*NEEDED, *OPTIONAL}]
    if unknown:
        raise ImportFormatError(
            f"{path}: column '{unknown[0][:60]}' is not supported; {allowed}. Give mm and N, separated by commas"
        )
    missing = [name for name in NEEDED if name not in header]
    if missing:
        raise ImportFormatError(f"{path}: has no column '{missing[0]}'; {allowed}")
    if len(set(header)) < len(header):
        raise ImportFormatError(f"{path}: a column appears twice; {allowed}")
    columns = dict(zip(header, table.T, strict=True))
    _require_loading(path, columns["displacement_mm"])
    return MeasuredForce(
        path.name,
        columns["displacement_mm"],
        columns["force_n"],
        columns.get("force_uncertainty_n"),
        columns.get("displacement_uncertainty_mm"),
    )


def _require_loading(path: Path, displacement_mm: NDArray[np.float64]) -> None:
    """Refuse rows in which the indenter goes back: rubber pushes less on the way out."""
    deepest = np.maximum.accumulate(displacement_mm)
    back = np.flatnonzero(deepest - displacement_mm > _BACK_REL * np.ptp(displacement_mm))
    if back.size:
        row = int(back[0])
        raise CompareError(
            f"{path}: row {row + 1} below the header has a displacement of {displacement_mm[row]:g} mm after "
            f"{deepest[row]:g} mm, so the indenter moves back, and the force is lower than in loading. Leave out the "
            "rows of unloading; if all rows are of loading, sort them by displacement_mm"
        )


RAW_SUFFIXES = (".dng",)


def read_board_picture(path: Path, monochrome: bool = False) -> NDArray[np.uint8]:
    """Return a picture as grey levels of 8 bits (H, W), stretched to its own range.

    DNG, TIFF, PNG or JPEG. One number of 16 bits per pixel is taken for raw Bayer counts (RGGB), unless `monochrome`;
    of 8 bits for grey.

    Raises
    ------
    ImportFormatError
        The file is missing, is not a picture, or shows nothing.
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
        raise ImportFormatError(
            f"{path}: has {image.shape[2]} values per pixel, but must have 1 (raw or grey), or 3 or 4 (colour)"
        )
    low, high = float(levels.min()), float(levels.max())
    if high <= low:
        raise ImportFormatError(
            f"{path}: every pixel has the same value ({low:g}), so it shows no board; give a picture of the board"
        )
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
        raise ImportFormatError(
            f"{path}: has {image.dtype} pixels, which are not supported; save the picture with unsigned integers of 8 "
            "or 16 bits"
        )
    return np.asarray(image)
