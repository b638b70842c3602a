"""The pages of a search over designs and of a sensor's lights.

The best compromises, the effect of each parameter, the gains and their cost; powers of lights, and a map over two
numbers of a finger.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.reports.design_search._optimum_page import (
        front_rows,
        light_powers_page,
        optimum_page,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = ["front_rows", "light_powers_page", "optimum_page"]
