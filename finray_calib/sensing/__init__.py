"""Sense with a tactile camera: its lens, the scale of its pixels on the pad, and its map from colour to normals.

A ChArUco board gives lens and millimetres per pixel; presses of a ball teach the normal map n(dR, dG, dB, x, y), which
turns the change of colour into slopes, and slopes into depth. Every result has its uncertainty; a result that the
images do not determine is refused with the reason. Also here: how well a camera can determine normals from one light
angle. Arithmetic only: no files, no devices.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.sensing._contact_place import (
        ROW_AND_COLUMN,
        FoundCircle,
        changes_elsewhere,
        contact_distance,
        contact_of_depths,
        find_contact_circle,
        find_contact_outline,
        misplaced_circle,
        outline_distance,
        vote_on_circles,
        with_far_surface,
    )
    from finray_calib.sensing._lens_calibration import (
        BoardView,
        LensCalibration,
        calibrate_lens,
        find_board,
        require_plausible,
    )
    from finray_calib.sensing._normal_map import (
        NormalMap,
        SensingError,
        full_scale_dn,
        held_out_normal_error_deg,
        normal_sigma_deg,
        poisson_depth_mm,
        polynomial_terms,
        rgb_image,
        sensing_error,
        uniformity,
    )
    from finray_calib.sensing._normal_map_fit import (
        MINIMUM_PRESSES,
        CalibrationPress,
        contact_sha256,
        fit_normal_map,
        held_out_score,
        normal_map_of,
        normal_map_record,
        require_ball_press,
        require_matching_capture,
        sense_press,
        surface_triangles,
    )
    from finray_calib.sensing._pixel_scale import BoardUncertainty
    from finray_calib.sensing._scale_record import patch_scale, pixel_scale, scale_finding, with_measured_scale
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "MINIMUM_PRESSES",
    "ROW_AND_COLUMN",
    "BoardUncertainty",
    "BoardView",
    "CalibrationPress",
    "FoundCircle",
    "LensCalibration",
    "NormalMap",
    "SensingError",
    "calibrate_lens",
    "changes_elsewhere",
    "contact_distance",
    "contact_of_depths",
    "contact_sha256",
    "find_board",
    "find_contact_circle",
    "find_contact_outline",
    "fit_normal_map",
    "full_scale_dn",
    "held_out_normal_error_deg",
    "held_out_score",
    "misplaced_circle",
    "normal_map_of",
    "normal_map_record",
    "normal_sigma_deg",
    "outline_distance",
    "patch_scale",
    "pixel_scale",
    "poisson_depth_mm",
    "polynomial_terms",
    "require_ball_press",
    "require_matching_capture",
    "require_plausible",
    "rgb_image",
    "scale_finding",
    "sense_press",
    "sensing_error",
    "surface_triangles",
    "uniformity",
    "vote_on_circles",
    "with_far_surface",
    "with_measured_scale",
]
