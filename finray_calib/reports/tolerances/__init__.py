"""The page of a finger's tolerances: a drawing with the limits at the parts, shares of the variance, and numbers."""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.reports.tolerances._tolerance_page import (
        limit_text,
        tolerance_drawing,
        tolerance_page,
        variance_figure,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["limit_text", "tolerance_drawing", "tolerance_page", "variance_figure"]
