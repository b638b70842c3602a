"""All six stages on a simulated rig (capture, radiometry, fit, simulate, compare, decide), and one report on them.

Each stage goes from stored records to stored records in a process of its own; an interrupted demo continues where it
stopped. `check_machine` checks beforehand what the machine needs, each check in a process of its own.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.demo._machine_checks import Finding, check_machine
    from finray_calib.demo._report import demo_report
    from finray_calib.demo._results import DemoResults, PaintResult, summary
    from finray_calib.demo._run import can_continue, run_demo
    from finray_calib.demo._stages import COMPILED_EFFORT, SCALAR_EFFORT, DemoSettings, settings_json, true_paint_optics
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "COMPILED_EFFORT",
    "SCALAR_EFFORT",
    "DemoResults",
    "DemoSettings",
    "Finding",
    "PaintResult",
    "can_continue",
    "check_machine",
    "demo_report",
    "run_demo",
    "settings_json",
    "summary",
    "true_paint_optics",
]
