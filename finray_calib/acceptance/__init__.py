r"""Acceptance of a rig: from what its devices did to a verdict for each check.

Limits are judged with guard bands (JCGM 106): a value y with standard uncertainty u passes an upper limit T when
:math:`y + 1.645 u \le T`, fails it when :math:`y - 1.645 u > T`, and is undecided between the two. What could not be
measured has a result too. `global_risks` is for who makes sensors in numbers and chooses a guard band: the shares of
good ones that are turned away and of bad ones that are let through. No command needs it.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.acceptance._acceptance_report import SECTIONS, judge
    from finray_calib.acceptance._conformity import (
        GUARD_FACTOR,
        NO_REFERENCE,
        CertifiedResult,
        ToleranceInterval,
        certified_results,
        conformance_probability,
        global_risks,
        result_line,
        value_text,
    )
    from finray_calib.acceptance._equivalence import ComparedQuantity, Equivalence, tins_are_equivalent
    from finray_calib.acceptance._gauge_study import GaugeStudy, balanced_values, gauge_study
    from finray_calib.acceptance._press_checks import PRESS_SECTIONS, judge_pressing
    from finray_calib.acceptance._session_history import (
        Alarm,
        Chart,
        ChartedQuantity,
        ChartRules,
        History,
        SessionFacts,
        chart_rules,
        run_length,
        session_facts,
        session_history,
        watch,
    )
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "GUARD_FACTOR",
    "NO_REFERENCE",
    "PRESS_SECTIONS",
    "SECTIONS",
    "Alarm",
    "CertifiedResult",
    "Chart",
    "ChartRules",
    "ChartedQuantity",
    "ComparedQuantity",
    "Equivalence",
    "GaugeStudy",
    "History",
    "SessionFacts",
    "ToleranceInterval",
    "balanced_values",
    "certified_results",
    "chart_rules",
    "conformance_probability",
    "gauge_study",
    "global_risks",
    "judge",
    "judge_pressing",
    "result_line",
    "run_length",
    "session_facts",
    "session_history",
    "tins_are_equivalent",
    "value_text",
    "watch",
]
