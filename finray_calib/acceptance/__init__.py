r"""Acceptance of a rig: from what its devices did to a verdict for each check.

Limits are judged with guard bands (JCGM 106): a value y with standard uncertainty u passes an upper limit T when
:math:`y + 1.645 u \le T`, fails it when :math:`y - 1.645 u > T`, and is undecided between the two. What could not be
measured has a result too. Consumer's and producer's risk of inspecting many items are here as well.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.acceptance._acceptance_report import SECTIONS, judge, result_line, value_text
    from finray_calib.acceptance._conformity import (
        GUARD_FACTOR,
        ToleranceInterval,
        conformance_probability,
        global_risks,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "GUARD_FACTOR",
    "SECTIONS",
    "ToleranceInterval",
    "conformance_probability",
    "global_risks",
    "judge",
    "result_line",
    "value_text",
]
