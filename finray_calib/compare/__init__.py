r"""Compare a simulated press with its capture: skill over declared regions, with its noise floor and an interval.

Of render S, capture D and no-contact image B, all in linear light,

.. math:: E = 1 - \frac{\sum_c w_c \sum_p (k S - D)^2}{\sum_c w_c \sum_p (B - D)^2}

with pixels p, channels c, their weights w and one exposure factor k: 1 explains the whole contact signal, 0 is doing
nothing. Noise of render and camera is taken out of the squares, and every number has an interval from what paints,
camera, pose and light leave open. Images that do not belong together are refused before anything is compared. Every
metric of ours is a field of `ErrorRow`, computed for one candidate in one region by `_candidate_errors.py`; a package
outside the tree may bring others (`Metric`).

`structural_similarity` and `multi_scale_similarity` are for beside numbers that others publish: comparisons hold them
of images as a display shows them.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.compare._batch import (
        PairRow,
        PressTable,
        levelled_images,
        pair_by_name,
        pairs_of_rows,
        predict_press,
        predicted_press,
        rank_simulators,
        skill_differences,
        skill_over_presses,
        spread_over,
        to_capture,
        train_table,
        worst_pairs,
    )
    from finray_calib.compare._candidate_errors import METRICS, Metric, check_metric
    from finray_calib.compare._comparison_record import (
        NO_DRIFT,
        OWN_NOISE,
        CheckOptions,
        checked_report,
        compare_checked,
        compare_press,
        shown_press,
    )
    from finray_calib.compare._displayed_images import ciede2000, displayed_image, srgb_to_lab
    from finray_calib.compare._image_noise import capture_noise
    from finray_calib.compare._mismatch import find_mismatches
    from finray_calib.compare._regions import DILATED, Region, contact_regions, disc, strip_from_distance
    from finray_calib.compare._registration import register_press
    from finray_calib.compare._structural_similarity import multi_scale_similarity, structural_similarity
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "DILATED",
    "METRICS",
    "NO_DRIFT",
    "OWN_NOISE",
    "CheckOptions",
    "Metric",
    "PairRow",
    "PressTable",
    "Region",
    "capture_noise",
    "check_metric",
    "checked_report",
    "ciede2000",
    "compare_checked",
    "compare_press",
    "contact_regions",
    "disc",
    "displayed_image",
    "find_mismatches",
    "levelled_images",
    "multi_scale_similarity",
    "pair_by_name",
    "pairs_of_rows",
    "predict_press",
    "predicted_press",
    "rank_simulators",
    "register_press",
    "shown_press",
    "skill_differences",
    "skill_over_presses",
    "spread_over",
    "srgb_to_lab",
    "strip_from_distance",
    "structural_similarity",
    "to_capture",
    "train_table",
    "worst_pairs",
]
