"""Results on devices that every rig has: they answer, are in time, come back; and the report of a check."""

from collections.abc import Mapping, Sequence
from typing import Final

from data_schemas import (
    AcceptanceReport,
    CheckFacts,
    CheckPlan,
    CheckResult,
    DeviceIdentity,
    Handshake,
    PressDevice,
    PressFacts,
    RigFile,
    Section,
    TactileCheckPlan,
    TactileRig,
)
from finray_calib.acceptance._conformity import (
    ToleranceInterval,
    measured,
    overall,
    unmeasured,
)

SIMULATED_NOTE: Final = (
    "the rig is simulated, so no real device was tried; its simulated clock gives all times except the time "
    "until devices answer again"
)


CLOCK_SD_S: Final = 0.005
"""Of one time on a computer that does other things: scheduler and serial buffers, a few milliseconds."""
UNASKED: Final = ("manual",)
"""Drivers behind which a person stands: nobody names itself and no time is kept."""


def results_of(
    sections: dict[Section, str], judged: Mapping[Section, tuple[CheckResult, ...]], errors: Mapping[Section, str]
) -> tuple[CheckResult, ...]:
    """Return the results in the order of their sections, each with the error that ended its section."""
    results: list[CheckResult] = []
    for section, title in sections.items():
        results += judged.get(section, ())
        if section in errors:
            what = "the error that ended this part of the check"
            results.append(unmeasured(section, title, what, "ERROR", errors[section]))
    return tuple(results)


def report_of(
    facts: CheckFacts | PressFacts,
    plan: CheckPlan | TactileCheckPlan,
    rig: RigFile | TactileRig,
    results: tuple[CheckResult, ...],
    notes: tuple[str, ...],
) -> AcceptanceReport:
    """Return the report with its verdict, and with a note where the rig is simulated."""
    more = (SIMULATED_NOTE,) if rig.is_simulated else ()
    return AcceptanceReport(
        plan=plan, rig=rig, facts=facts, results=results, verdict=overall(results), notes=(*notes, *more)
    )


def judge_handshakes(handshakes: Sequence[Handshake], most_s: float) -> tuple[CheckResult, ...]:
    """Return one result for each device: it answers, names itself, and does so in time."""
    return tuple(_handshake(hand, most_s) for hand in handshakes)


def _handshake(hand: Handshake, most_s: float) -> CheckResult:
    """Judge one device."""
    name, what = f"{hand.role} answers", f"slowest answer of the {hand.role} to questions about identity and state"
    if hand.error is not None or hand.identity is None or not hand.durations_s:
        return unmeasured("handshake", name, what, "ERROR", hand.error or "it was not asked")
    said = hand.identity
    named = ("vendor", "model", "serial", "firmware")
    words = [f"{key} {text}" for key in named if (text := getattr(said, key, ""))]
    if hand.driver in UNASKED:
        return unmeasured("handshake", name, what, "UNDECIDED", "it is switched by hand, so no device can be asked")
    if (said.role, said.driver) != (hand.role, hand.driver):
        return unmeasured(
            "handshake", name, what, "FAIL", f"a {said.role} behind driver '{said.driver}' answers", hand.driver
        )
    if not words:
        return unmeasured("handshake", name, what, "UNDECIDED", "it answers but does not identify itself")
    evidence = f"{', '.join(words)}; {len(hand.durations_s)} times asked"
    limits = ToleranceInterval(None, most_s)
    return measured("handshake", name, what, max(hand.durations_s), CLOCK_SD_S, "s", evidence, limits=limits)


def judge_frames(section: Section, times_s: Sequence[float], most_s: float) -> tuple[CheckResult, ...]:
    """Return how long a frame takes beyond its exposure."""
    if not times_s:
        return ()
    what = "longest time that a frame takes beyond its exposure (queries to devices, trigger, readout, transfer)"
    evidence = f"mean {sum(times_s) / len(times_s):.3g} s of {len(times_s)} frames"
    limits = ToleranceInterval(None, most_s)
    return (measured(section, "frames in time", what, max(times_s), CLOCK_SD_S, "s", evidence, limits=limits),)


def judge_reconnect(facts: CheckFacts | PressFacts, most_s: float) -> tuple[CheckResult, ...]:
    """Return whether the same devices answer after they were closed and opened again, and how soon."""
    if facts.reconnect_s is None:
        return ()
    name, what = "devices come back", "time until all devices answer after they were closed"
    said = {identity.role: identity for identity in facts.reconnected}
    before = [hand.identity for hand in facts.handshakes if hand.identity is not None]
    others = [one.role for one in before if said.get(one.role) != one]
    if others:
        now = said.get(others[0])
        named = "" if now is None else " ".join(filter(None, _words_of(now)))
        reason = (
            f"another {others[0]} answers than before, or it names itself differently ({named or 'no name'}); give its "
            "address by serial number in the rig file"
        )
        return (unmeasured("reconnect", name, what, "FAIL", reason),)
    limits = ToleranceInterval(None, most_s)
    unknown = sorted(set(said) - {one.role for one in before})
    evidence = f"{len(before)} devices, the same as before"
    evidence += f"; before they were closed, {', '.join(unknown)} gave no name" if unknown else ""
    return (measured("reconnect", name, what, facts.reconnect_s, CLOCK_SD_S, "s", evidence, limits=limits),)


def _words_of(said: DeviceIdentity | PressDevice) -> tuple[str, ...]:
    """Return what a device says of itself."""
    return tuple(getattr(said, key, "") for key in ("vendor", "model", "serial", "firmware"))
