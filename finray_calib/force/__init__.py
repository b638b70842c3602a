"""Compare measured and simulated force over displacement: error, its uncertainty, and a validation statement.

The error E = F(d - d_0) - F_measured(d), d_0 the displacement of first touch, is judged against u_val^2 = u_numerical^2
+ u_input^2 + u_data^2 (ASME V&V 20): mesh, constants and dimensions of the design, and the measurement. Where nothing
is known of them, errors are given without verdicts. `fit_material` solves the inverse problem: with which moduli the
computed force is the measured one, and which moduli a curve does not determine. `calibrate_cell` determines from known
masses how many newtons a count of a load cell is.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.force._cell_calibration import (
        Gravity,
        Loads,
        calibrate_cell,
        loading_order,
    )
    from finray_calib.force._force_comparison import compare_force
    from finray_calib.force._force_curves import ForceCurve, MeasuredForce
    from finray_calib.force._material_fit import BULK_RANGE, GEL_RANGE_MPA, ForceModel, fit_material
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "BULK_RANGE",
    "GEL_RANGE_MPA",
    "ForceCurve",
    "ForceModel",
    "Gravity",
    "Loads",
    "MeasuredForce",
    "calibrate_cell",
    "compare_force",
    "fit_material",
    "loading_order",
]
