"""The page of a search over designs: the best compromises, the effect of each parameter, the gains and their cost."""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.reports.design_search._optimum_page import front_rows, optimum_page
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["front_rows", "optimum_page"]
