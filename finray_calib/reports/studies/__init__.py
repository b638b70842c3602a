"""Pages of design studies: points of a study, searches, powers of lights, tolerances, and a lab's press protocol.

They are made of the sections, tables and drawings of :mod:`finray_calib.reports`.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.reports.studies._design_study_page import (
        MetricDifference,
        design_study_page,
        points_by_code,
        study_differences,
        study_differences_text,
        study_pictures_webp,
        study_text,
    )
    from finray_calib.reports.studies._optimum_page import front_rows, light_powers_page, optimum_page
    from finray_calib.reports.studies._protocol_page import protocol_page
    from finray_calib.reports.studies._tolerance_page import limit_text, tolerance_page
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "MetricDifference",
    "design_study_page",
    "front_rows",
    "light_powers_page",
    "limit_text",
    "optimum_page",
    "points_by_code",
    "protocol_page",
    "study_differences",
    "study_differences_text",
    "study_pictures_webp",
    "study_text",
    "tolerance_page",
]
