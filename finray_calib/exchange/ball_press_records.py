"""Ball presses of another lab as tactile captures: 8-bit colour images of unknown encoding with a labelled circle."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import ContactCircle, IndenterPose, TactileCapture
from data_schemas.errors import ImportFormatError
from rigs.cameras.picture_files import read_picture

Bytes = NDArray[np.uint8]
LARGEST_BALL_MM = 100.0


@dataclass(frozen=True, slots=True)
class BallPress:
    """One press: its image in RGB order, and the circle that someone drew around the contact.

    Attributes
    ----------
    name
        Of the press within its folder.
    rgb
        (H, W, 3).
    row_px, column_px, radius_px
        Centre and radius of the circle.
    ball_diameter_mm
        Of the ball.
    """

    name: str
    rgb: Bytes
    row_px: float
    column_px: float
    radius_px: float
    ball_diameter_mm: float


def press_captures(
    presses: Sequence[BallPress], no_contact_rgb: Bytes, mm_per_px: float, source: str
) -> list[TactileCapture]:
    """Return a tactile capture of each press; all share one no-contact image, and none has a repeat of it.

    Exposure, gains and transfer curve are not known: ``encoding`` is "unknown" and ``exposure_s`` is left out.

    Raises
    ------
    ImportFormatError
        When an image has another size than the no-contact image, a circle lies outside its image, or is larger than
        the ball.
    """
    for press in presses:
        _check(press, no_contact_rgb, mm_per_px, source)
    return [_capture(press, no_contact_rgb, mm_per_px, source) for press in presses]


def require_length(value_mm: float | None, what: str, option: str, largest_mm: float = LARGEST_BALL_MM) -> float:
    """Return a length that the user, or the folder, must give.

    Raises
    ------
    ImportFormatError
        When it is missing, not above zero, or too large to be meant.
    """
    if value_mm is None:
        raise ImportFormatError(f"{what} is not in the folder; give it with {option}")
    if not 0.0 < value_mm <= largest_mm:
        raise ImportFormatError(f"{what}: {value_mm:g} mm must be above 0 and at most {largest_mm:g} mm")
    return value_mm


def _capture(press: BallPress, no_contact_rgb: Bytes, mm_per_px: float, source: str) -> TactileCapture:
    """Return the record of one press."""
    return TactileCapture(
        name=press.name,
        contact=press.rgb.astype(np.uint16),
        no_contact=no_contact_rgb.astype(np.uint16),
        repeat_no_contact=None,
        layout="RGB",
        encoding="unknown",
        bit_depth=8,
        black_level_dn=0.0,
        exposure_s=None,
        light_angle_deg=None,
        indenter=IndenterPose(shape="ball", radius_mm=press.ball_diameter_mm / 2.0, depth_mm=None, position_mm=None),
        contact_circle=ContactCircle(row_px=press.row_px, column_px=press.column_px, radius_px=press.radius_px),
        mm_per_px=mm_per_px,
        source=source,
    )


def _check(press: BallPress, no_contact_rgb: Bytes, mm_per_px: float, source: str) -> None:
    """Refuse a press whose image or circle cannot be."""
    where = f"{source}: {press.name}"
    rows, columns = no_contact_rgb.shape[:2]
    if press.rgb.shape != no_contact_rgb.shape:
        raise ImportFormatError(
            f"{where}: an image of shape {press.rgb.shape} beside a no-contact image of {no_contact_rgb.shape}; both "
            "must come from one camera at one size"
        )
    if not (0.0 <= press.row_px < rows and 0.0 <= press.column_px < columns):
        raise ImportFormatError(
            f"{where}: the circle's centre, row {press.row_px:g}, column {press.column_px:g}, lies outside the picture "
            f"of {columns} x {rows} px; are x (column) and y (row) exchanged?"
        )
    ball_px = press.ball_diameter_mm / 2.0 / mm_per_px
    if not 0.0 < press.radius_px < ball_px:
        raise ImportFormatError(
            f"{where}: a contact circle of {press.radius_px:g} px radius must be above 0 and below the ball's "
            f"{ball_px:.4g} px ({press.ball_diameter_mm:g} mm diameter at {mm_per_px:g} mm per px); correct "
            "--ball-diameter-mm (diameter, not radius) or --mm-per-px (not px per mm), or the label"
        )


def read_rgb(path: Path) -> Bytes:
    """Read an 8-bit colour image in RGB order.

    Raises
    ------
    ImportFormatError
        When the file is missing or holds something else.
    """
    if not path.is_file():
        raise ImportFormatError(f"{path}: no such file; the folder must hold it")
    bgr = read_picture(path, "an 8-bit colour image (PNG, JPEG)", ImportFormatError)
    if bgr.ndim != 3 or bgr.shape[2] != 3 or bgr.dtype != np.uint8:
        raise ImportFormatError(
            f"{path}: expected an 8-bit colour image (PNG, JPEG), got {bgr.dtype} of shape {bgr.shape}; convert it"
        )
    return np.asarray(bgr[..., ::-1], dtype=np.uint8)
