"""From the facts of an acceptance check to its report: every check gets one result, also where nothing was measured."""

from typing import Final

from data_schemas.check import AcceptanceReport, CheckFacts, CheckPlan, CheckResult, Section
from data_schemas.rig import RigFile
from finray_calib.acceptance.guard_band import overall, unmeasured
from finray_calib.acceptance.judge_devices import judge_handshakes, judge_light_off, judge_wheel
from finray_calib.acceptance.judge_frames import judge_dark_frames, judge_exposures, judge_filters, judge_revisits

SECTIONS: Final[dict[Section, str]] = {
    "opening": "rig opens",
    "handshake": "devices answer",
    "wheel": "wheel moves",
    "dark frames": "dark frames",
    "filters": "filters in their slots",
    "revisits": "wheel repeats optically",
    "exposures": "exposure ratios",
    "light off": "laser off after a mishap",
    "closing": "rig closes with its lights off",
}
SIMULATED_NOTE: Final = "the rig is simulated: times are those of its simulated clock, and no device was tried"


def judge(facts: CheckFacts, plan: CheckPlan, rig: RigFile, notes: tuple[str, ...] = ()) -> AcceptanceReport:
    """Return the report of an acceptance check.

    Parameters
    ----------
    facts
        What the devices did.
    plan, rig
        The limits, and what the rig file claims.
    notes
        What the user should know about the rig.
    """
    results: list[CheckResult] = []
    judged = {
        "opening": (),
        "handshake": judge_handshakes(facts, plan),
        "wheel": judge_wheel(facts, plan),
        "dark frames": judge_dark_frames(facts, plan, rig.camera),
        "filters": judge_filters(facts),
        "revisits": judge_revisits(facts, plan),
        "exposures": judge_exposures(facts, plan),
        "light off": judge_light_off(facts, plan),
        "closing": (),
    }
    for section, title in SECTIONS.items():
        results += judged[section]
        if section in facts.errors:
            what = "what broke this part of the check off"
            results.append(unmeasured(section, title, what, "ERROR", facts.errors[section]))
    return AcceptanceReport(
        plan=plan,
        rig=rig,
        facts=facts,
        results=tuple(results),
        verdict=overall(tuple(results)),
        notes=(*notes, *((SIMULATED_NOTE,) if rig.is_simulated else ())),
    )
