"""The command line: one file per verb, or per group of verbs that belong together.

A verb declares its options, calls the library and stores what comes back; nothing is computed here. Each file has an
``add_...`` that registers its verbs, and imports what is heavy when a verb runs: ``finray --help`` answers in 0.3 s.
Mistakes of the user end with exit status 2 and a sentence that says what to do.
"""

from typing import TYPE_CHECKING

from data_schemas import lazy_exports

if TYPE_CHECKING:
    from finray_calib.cli._bench import add_bench
    from finray_calib.cli._capture import add_capture
    from finray_calib.cli._check import add_certificate, add_check, add_history
    from finray_calib.cli._compare import add_compare
    from finray_calib.cli._decide import add_decide
    from finray_calib.cli._demo import add_demo, add_doctor
    from finray_calib.cli._design import add_design
    from finray_calib.cli._export import add_export
    from finray_calib.cli._fit import add_fit, add_fit_material
    from finray_calib.cli._import import add_import
    from finray_calib.cli._radiometry import add_radiometry
    from finray_calib.cli._rig import add_live, add_rig
    from finray_calib.cli._sense import add_sense
    from finray_calib.cli._simulate import add_recolour, add_simulate, current_spelling
    from finray_calib.cli._study import add_study
    from finray_calib.cli._trace import add_trace, add_verify
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "add_bench",
    "add_capture",
    "add_certificate",
    "add_check",
    "add_compare",
    "add_decide",
    "add_demo",
    "add_design",
    "add_doctor",
    "add_export",
    "add_fit",
    "add_fit_material",
    "add_history",
    "add_import",
    "add_live",
    "add_radiometry",
    "add_recolour",
    "add_rig",
    "add_sense",
    "add_simulate",
    "add_study",
    "add_trace",
    "add_verify",
    "current_spelling",
]
