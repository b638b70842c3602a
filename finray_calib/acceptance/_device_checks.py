"""Results on devices: they answer in time, and come back; the light goes off after a mishap; the report of a check."""

import math
from collections.abc import Mapping, Sequence
from statistics import linear_regression, median
from typing import Final

from data_schemas import (
    AcceptanceReport,
    CheckFacts,
    CheckPlan,
    CheckResult,
    DarkFrames,
    DeviceIdentity,
    DiodeLevels,
    ExposureLevel,
    Handshake,
    LaserSettings,
    LightLayer,
    LightOff,
    PressDevice,
    PressFacts,
    RigFile,
    Section,
    SightLevels,
    TactileCheckPlan,
    TactileRig,
    Witness,
)
from finray_calib.acceptance._conformity import (
    ToleranceInterval,
    measured,
    not_proven,
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


REMEDIES: Final = {
    " answers": "check cable, supply and address, and that the driver is that of the device",
    "wheel arrives": "tighten the wheel's belt or motor, find what rubs, and home the wheel",
    "wheel moves in time": "find what rubs on the wheel, and check its supply",
    "wheel repeats optically": "tighten the wheel's belt or motor and the filters in their slots",
    "picture stays in place": "tighten filters, lens, camera and tile",
    "dark level": "correct black_level_dn of the rig file (a camera session measures it)",
    "dark rate": "close the box and cover what glows in it; if a cap on the lens changes nothing, cool the camera",
    "read noise": "correct gain_e_per_dn and read_noise_e of the rig file (a camera session measures them)",
    "exposure ratio": "switch off gamma and automatic exposure; raise shortest_exposure_s of the rig file",
    "exposure ratios": "check lamp, tile and lens cap",
    "frames in time": "close other programs that use the camera, its cable or the disk",
    "trigger latency": "see the page of the camera's driver; each request must begin a new exposure",
    "devices come back": "check cables and supplies, and the names of the ports",
    "lamp is steady": "let the lamp warm up for longer, check its supply",
    "lamp settles": "check the lamp's supply, or wait for longer before every session",
    "dark level stays": "let the camera warm up before every session",
    "stray light": "close gaps beside the filters, cover what reflects; replace a filter that blocks too little",
    "laser off": "do not use this laser until the protection that should have switched it off is repaired",
    "load cell keeps its zero": "let cell and amplifier warm up, keep draughts and cables away",
    "calibration is recent": "calibrate the load cell again (finray rig calibrate-cell)",
    "load cell is straight": "find what rubs on the cell, tighten its screws and calibrate it again; else replace it",
    "calibration holds": "lay the mass on nothing but the cell, or calibrate the cell again with masses that you trust",
    "load cell is quiet": "keep its cable away from motors and mains, tighten its screws, check the amplifier's supply",
    "load cell returns to zero": "find what rubs on the cell, tighten its screws; replace one that was overloaded",
    "readings a second": "correct rate_hz of the rig file, or the pin of the amplifier that sets its rate",
    "readings in time": "close other programs, plug the board straight into the computer, check its cable",
    "goes as far as sent": "correct the controller's steps per mm ($100 to $102 of GRBL), tighten screw and coupling",
    " moves in time": "raise the controller's limits of speed and acceleration ($110 to $122 of GRBL), or lower the "
    "speeds of the rig file",
    " reports its position": "set finer microsteps, and the controller's steps per mm ($100 to $102 of GRBL) with them",
    "press axis turns without play": "tighten or preload the nut of the screw, its bearings and its coupling",
    "force stops the stage": "do not press with this rig before it stops in time: lower press_speed_mm_per_s, and "
    "check the cell's cable and rate",
    "stage stops": "do not press with this rig before it stops in time: check the controller's cable, raise its "
    "acceleration ($120 to $122 of GRBL)",
    "position survives stops": "the motor loses steps: lower acceleration and speeds, check its current, and find "
    "what rubs",
    "touch repeats": "tighten stage, finger and indenter; a stage that loses steps must go more slowly",
}
"""What to do about a check that failed, by a part of its name; the longest part counts."""


def remedy_of(check_name: str) -> str | None:
    """Return what to do where a check failed; None where its evidence says it."""
    name = max((name for name in REMEDIES if name in check_name), key=len, default=None)
    return None if name is None else REMEDIES[name]


def _with_remedy(result: CheckResult) -> CheckResult:
    """Let a check that failed say what to do."""
    if result.verdict != "FAIL" or (remedy := remedy_of(result.name)) is None:
        return result
    return result.model_copy(update={"evidence": f"{result.evidence}. What to do: {remedy}"})


def results_of(
    sections: dict[Section, str], judged: Mapping[Section, tuple[CheckResult, ...]], errors: Mapping[Section, str]
) -> tuple[CheckResult, ...]:
    """Return the results in the order of their sections, each with the error that ended its section."""
    results: list[CheckResult] = []
    for section, title in sections.items():
        results += map(_with_remedy, judged.get(section, ()))
        if section in errors:
            what = "the error that ended this part of the check"
            results.append(unmeasured(section, title, what, "ERROR", errors[section]))
    return tuple(results)


def report_of(
    facts: CheckFacts | PressFacts,
    plan: CheckPlan | TactileCheckPlan,
    rig: RigFile | TactileRig,
    results: tuple[CheckResult, ...],
    notes: tuple[str, ...] = (),
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
            "handshake", name, what, "FAIL", f"it answers as a {said.role} of driver '{said.driver}'", hand.driver
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
            f"a different {others[0]} answers than before, or the same one gives another name ({named or 'no name'}); "
            "give its address by serial number in the rig file"
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


NO_DARK_REFERENCE: Final = (
    "the dark level of the photodiode was taken while only the controller reported the laser off, so a laser that is "
    "only dimmed would look off; run the check in a terminal, and close the beam by hand when it asks"
)
NO_BLOCKED_REFERENCE: Final = (
    "the dark level of the camera was taken while only the controller reported the laser off, so a laser that is "
    "only dimmed would look off; give the wheel a filter that blocks the laser"
)
NOT_LIT_CLOSED: Final = (
    "it was not shown that the laser was on while its beam was closed by hand, so the cap may let light through: the "
    "laser must be reported on before and after, and its light must return when the beam is opened; check again"
)
LEAST_BACK_SHARE: Final = 0.5
"""Of the laser's light before the beam was closed: so much must be back when it is open."""
NO_PULSES: Final = (
    "the photodiode's firmware looks for 0.1 ms in each 10 ms only, so a pulsed laser may look off; flash version 1.1"
)
UNSEEN_LASER: Final = (
    "no instrument saw the laser go off: stray light was not measured, or behind the filter that passes the laser the "
    "camera saw no clear difference between laser on and off, or still saw light with the laser reported off; place a "
    "photodiode or the camera where it sees the laser, and check again"
)
DARK_SD: Final = 6.0
"""Standard deviations of the mean of a dark frame: by noise one is beyond once in 10^9."""
LEAST_ABOVE_DN: Final = 0.25
"""Of the mean of a region: rounding moves it by less."""
LEAST_ABOVE_SHARE: Final = 2e-4
"""Of full scale: a dark level wanders by less within a part of the check."""
LEAST_SEEN: Final = 10.0
"""Of that margin: a laser that is seen by less is no proof."""
OTHER_DARK: Final = (
    "with the laser off the instrument read a level that differs from its dark level, so other light changed or the "
    "laser is only dimmed; keep the box shut and the room as it is, and check again"
)
BETWEEN_PULSES: Final = (
    "the frames are exposed for less than 20 ms, so the pulses of a laser that is only dimmed may lie between them; "
    "close the aperture or put a grey filter before the camera, so that exposures are longer"
)
SLOWEST_PULSES_S: Final = 0.02
LEAST_OF_CLASS_MW: Final = {"3R": 1.0, "3B": 5.0, "4": 500.0}
"""Power from which a visible laser is of its class: a smaller power_mw is not that of the label."""
CLASS_1_MW: Final = 0.039
"""Smallest accessible emission limit of class 1 from 400 to 1400 nm: that of blue light for hours (EN 60825-1:2014)."""
CLASS_1_NM: Final = (400.0, 1400.0)
MOST_BLOCKED_SHARE: Final = 0.1
"""Of the laser's light that the camera sees: a filter that lets more through does not block it."""
_BY: Final[dict[Witness, str]] = {
    "its own connection": "reported by the laser's controller only; its light was not observed",
    "a new connection": "reported by the laser's controller only, over a new connection; its light was not observed",
    "the camera": "measured by the camera",
    "a photodiode": "measured by a photodiode",
}


_LAYERS: Final[dict[LightLayer, tuple[str, str]]] = {
    "block": ("laser off after an exception", "an exception leaves the block that lights the laser"),
    "guard": ("laser off by the guard", "the program that lights the laser is killed (SIGKILL)"),
    "dead-man": ("laser off by the dead-man", "the program, the guard and the watch of the laser are killed (SIGKILL)"),
}


def judge_light_off(facts: CheckFacts, plan: CheckPlan, rig: RigFile) -> tuple[CheckResult, ...]:
    """Return one result for each safety layer of the laser."""
    return tuple(_light_off(layer, plan, facts, rig) for layer in facts.light_off)


def _light_off(layer: LightOff, plan: CheckPlan, facts: CheckFacts, rig: RigFile) -> CheckResult:
    """Judge one layer by its slowest mishap."""
    name, mishap = _LAYERS[layer.layer]
    what = f"time until the laser is off when {mishap}"
    if layer.error is not None:
        return unmeasured("light off", name, what, "ERROR", layer.error)
    if layer.missing is not None:
        return unmeasured("light off", name, what, "UNDECIDED", layer.missing)
    limit_s = plan.limits.light_off_s
    if layer.still_on or not layer.latest_s:
        return unmeasured(
            "light off", name, what, "FAIL",
            f"the laser was still on after {layer.still_on} of {layer.still_on + len(layer.latest_s)} "
            f"mishaps; each was watched for {layer.watched_s:g} s",
            f"at most {limit_s:g} s",
        )  # fmt: skip
    value_s, sd_s = slowest_off(layer)
    by = "nobody" if layer.witness is None else _BY[layer.witness]
    evidence = f"slowest of {len(layer.latest_s)} mishaps, {by}"
    found = measured("light off", name, what, value_s, sd_s, "s", evidence, limits=ToleranceInterval(None, limit_s))
    if layer.witness == "a photodiode":
        return _by_photodiode(found, facts.diode, rig.laser)
    return _by_camera(found, facts.sight, rig.laser) if layer.witness == "the camera" else _by_report(found, facts, rig)


def _by_report(found: CheckResult, facts: CheckFacts, rig: RigFile) -> CheckResult:
    """Let a controller's word pass where the camera saw the laser go off whenever it said so: in the stray light part.

    Behind the filter that passes the laser, every frame with the laser off must be as dark as those behind a filter
    that blocks it, by the line through the shortest dark frames, but for what the dark level drifted since those.
    """
    stray = facts.stray_light
    if stray is None or stray.passed is None or not stray.blocked or not facts.darks:
        return not_proven(found, UNSEEN_LASER)
    passed = stray.passed.level
    blocked = min((one.level for one in stray.blocked), key=lambda level: sum(level.dark_dn) / len(level.dark_dn))
    longer_dn, first = sum(blocked.dark_dn) / len(blocked.dark_dn), facts.darks[0]
    shortest_dn = min(sum(first.means_dn) / len(first.means_dn), longer_dn)
    dark_dn = shortest_dn + (longer_dn - shortest_dn) * min(passed.exposure_s / blocked.exposure_s, 1.0)
    # by the median distance: a single lit frame must not widen what counts as dark
    apart_dn = [abs(dn - median(level.dark_dn)) for level in (passed, blocked) for dn in level.dark_dn]
    least_dn = max(LEAST_ABOVE_DN, LEAST_ABOVE_SHARE * (2**rig.camera.bit_depth - 1))
    margin_dn = max(DARK_SD * 1.4826 * median(apart_dn), least_dn) + _drift_dn(facts.darks, blocked)
    seen_dn = sum(passed.white_dn) / len(passed.white_dn) - dark_dn
    if seen_dn < LEAST_SEEN * margin_dn or max(passed.dark_dn) > dark_dn + margin_dn:
        return not_proven(found, UNSEEN_LASER)
    dark = f"before, the camera saw no light behind filter {stray.passed.filter_name} while the laser was reported off"
    return _with_unseen(found, margin_dn / seen_dn, dark, rig.laser)


def _drift_dn(darks: Sequence[DarkFrames], later: ExposureLevel) -> float:
    """Return by how much the dark level of a later part differs from the line through the dark frames (DN)."""
    exposures_s = [one.exposure_s for one in darks]
    means_dn = [sum(one.means_dn) / len(one.means_dn) for one in darks]
    rate, level_dn = (0.0, means_dn[0]) if len(set(exposures_s)) < 2 else linear_regression(exposures_s, means_dn)
    return abs(sum(later.dark_dn) / len(later.dark_dn) - level_dn - rate * later.exposure_s)


def _by_photodiode(found: CheckResult, diode: DiodeLevels | None, laser: LaserSettings) -> CheckResult:
    """Let a result pass where a person closed the beam, no pulse is missed, and no harmful light stays unseen."""
    if diode is None or diode.closed_rel is None:
        return not_proven(found, NO_DARK_REFERENCE)
    if abs(diode.closed_rel - diode.off_rel) > diode.threshold_rel - diode.closed_rel:
        return not_proven(found, OTHER_DARK)
    unseen_rel = (diode.threshold_rel - diode.closed_rel) / (diode.on_rel - diode.closed_rel)
    dark = f"the photodiode's dark level was read {diode.readings} times in a row with the beam closed by hand"
    found = _with_unseen(found, unseen_rel, dark, laser)
    back_rel = (diode.on_again_rel or 0.0) - diode.closed_rel
    if not diode.reported_lit_closed or back_rel < LEAST_BACK_SHARE * (diode.on_rel - diode.closed_rel):
        found = not_proven(found, NOT_LIT_CLOSED)
    return found if diode.sees_pulses else not_proven(found, NO_PULSES)


def _by_camera(found: CheckResult, sight: SightLevels | None, laser: LaserSettings) -> CheckResult:
    """Let a result pass where a filter that blocks the laser shows what dark is, and no harmful light stays unseen."""
    if sight is None or sight.blocked_off_dn is None or sight.blocked_on_dn is None:
        return not_proven(found, NO_BLOCKED_REFERENCE)
    margin_dn = sight.threshold_dn - sight.off_dn
    if sight.blocked_off_dn >= sight.threshold_dn or abs(sight.blocked_off_dn - sight.off_dn) > margin_dn:
        return not_proven(found, OTHER_DARK)
    seen_dn = sight.on_dn - sight.blocked_off_dn
    if sight.blocked_on_dn - sight.blocked_off_dn > MOST_BLOCKED_SHARE * seen_dn:
        return not_proven(found, f"the laser is seen behind filter {sight.blocked_filter} too; {NO_BLOCKED_REFERENCE}")
    dark = f"the camera's dark level was taken behind filter {sight.blocked_filter}, which blocks the laser"
    found = _with_unseen(found, (sight.threshold_dn - sight.blocked_off_dn) / seen_dn, dark, laser)
    return not_proven(found, BETWEEN_PULSES) if sight.exposure_s < SLOWEST_PULSES_S else found


def _with_unseen(found: CheckResult, unseen_rel: float, dark: str, laser: LaserSettings) -> CheckResult:
    """Say how much light would not be seen, and let a result pass where that much is of class 1."""
    unseen_mw = max(unseen_rel, 0.0) * max(laser.power_mw, LEAST_OF_CLASS_MW.get(laser.laser_class, 0.0))
    told = (
        f"{found.evidence}; {dark}; light below {100 * max(unseen_rel, 0.0):.2g} % of the laser's, {unseen_mw:.2g} mW "
        "at most, would not be seen"
    )
    found = found.model_copy(update={"evidence": told})
    if not CLASS_1_NM[0] <= laser.wavelength_nm <= CLASS_1_NM[1]:
        why = (
            f"finray knows the class 1 limit from {CLASS_1_NM[0]:g} to {CLASS_1_NM[1]:g} nm only, not at "
            f"{laser.wavelength_nm:g} nm, so it cannot tell whether the light that would not be seen is harmless"
        )
        return not_proven(found, why)
    if unseen_mw <= CLASS_1_MW:
        return found
    return not_proven(
        found,
        f"that is more than the {CLASS_1_MW:g} mW of a class 1 laser, so 'off' is not proved; shade the instrument "
        "from other light, or place it where it sees more of the laser",
    )


def slowest_off(layer: LightOff) -> tuple[float, float]:
    r"""Return the time of the slowest mishap (s) with its standard uncertainty (s).

    Between the last look that saw the laser on, at a, and the first that saw it off, at b, all times are alike:

    .. math:: t = (a + b) / 2, \quad u^2 = (b - a)^2 / 12 + u_\text{clock}^2
    """
    slowest = max(range(len(layer.latest_s)), key=lambda i: layer.latest_s[i])
    earliest_s, latest_s = layer.earliest_s[slowest], layer.latest_s[slowest]
    return 0.5 * (earliest_s + latest_s), math.hypot((latest_s - earliest_s) / math.sqrt(12), CLOCK_SD_S)
