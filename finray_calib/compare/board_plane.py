"""The plane of the pad behind a board whose place is known: as it was fitted, and as a stored record holds it."""

from dataclasses import dataclass

import numpy as np

from data_schemas.pixel_scale import PixelScale
from finray_calib.compare.lens_calibration import POSE, LensCalibration
from finray_calib.compare.pixel_scale import SeenPlane


@dataclass(frozen=True, slots=True)
class Declared:
    """What the user knows of the board and of the coat; uncertainties are standard ones.

    Attributes
    ----------
    square_u_rel
        Of the side of a printed square, relative to it.
    coat_behind_board_mm, coat_behind_board_u_mm
        From the printed face to the coat, away from the camera: the distance that the board's sheet keeps.
    """

    square_u_rel: float
    coat_behind_board_mm: float = 0.0
    coat_behind_board_u_mm: float = 0.0


def fitted_plane(found: LensCalibration, declared: Declared, widened_factor: float = 1.0) -> SeenPlane:
    """Return the plane of the first view, its standard deviations widened by a factor."""
    size = len(found.lens) + POSE
    return SeenPlane(
        found.model,
        found.lens,
        found.poses[0],
        found.covariance[:size, :size] * widened_factor**2,
        declared.coat_behind_board_mm,
        declared.coat_behind_board_u_mm,
        declared.square_u_rel,
    )


def seen_plane(record: PixelScale) -> SeenPlane:
    """Return the plane of a record, to ask it for the scale anywhere in the picture."""
    calibration = record.calibration
    return SeenPlane(
        model=calibration.model,
        lens=np.array([*calibration.focal_px, *calibration.centre_px, *calibration.distortion]),
        pose=np.array(record.place),
        covariance=record.covariance * record.widened_factor**2,
        behind_mm=record.coat_behind_board_mm,
        behind_u_mm=record.coat_behind_board_u_mm,
        square_u_rel=record.square_u_rel,
    )
