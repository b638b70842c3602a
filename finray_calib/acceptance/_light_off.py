"""Results on the light that goes off after a mishap: how soon, who saw it, and how much light could stay unseen."""

import math
from typing import Final

from data_schemas import (
    CheckFacts,
    CheckPlan,
    CheckResult,
    DiodeLevels,
    LaserSettings,
    LightLayer,
    LightOff,
    SightLevels,
    Witness,
)
from finray_calib.acceptance._conformity import ToleranceInterval, measured, not_proven, unmeasured
from finray_calib.acceptance._device_checks import CLOCK_SD_S

NO_DARK_REFERENCE: Final = (
    "the photodiode learned what dark is from the controller's word, so a laser that is only dimmed would look off; "
    "run the check in a terminal, and close the beam by hand when it asks"
)
NO_BLOCKED_REFERENCE: Final = (
    "the camera learned what dark is from the controller's word, so a laser that is only dimmed would look off; give "
    "the wheel a filter that blocks the laser"
)
NOT_LIT_CLOSED: Final = (
    "nobody proved that the laser was lit while its beam was closed by hand, so the cap may let light through: its "
    "controller must report it on before and after, and its light must be back when the beam is open; check again"
)
LEAST_BACK_SHARE: Final = 0.5
"""Of the laser's light before the beam was closed: so much must be back when it is open."""
NO_PULSES: Final = (
    "the photodiode's firmware looks for 0.1 ms in each 10 ms only, so a pulsed laser may look off; flash version 1.1"
)
CLASS_1_MW: Final = 0.039
"""Smallest accessible emission limit of class 1 from 400 to 1400 nm: that of blue light for hours (EN 60825-1:2014)."""
CLASS_1_NM: Final = (400.0, 1400.0)
MOST_BLOCKED_SHARE: Final = 0.1
"""Of the laser's light that the camera sees: a filter that lets more through does not block it."""
_BY: Final[dict[Witness, str]] = {
    "its own connection": "by the word of the laser's controller; nobody saw its light",
    "a new connection": "by the word of the laser's controller over a new connection; nobody saw its light",
    "the camera": "measured by the camera",
    "a photodiode": "measured by a photodiode",
}


_LAYERS: Final[dict[LightLayer, tuple[str, str]]] = {
    "block": ("laser off after an exception", "an exception leaves the block that lights the laser"),
    "guard": ("laser off by the guard", "the program that lights the laser is killed (SIGKILL)"),
    "dead-man": ("laser off by the dead-man", "the program, the guard and the watch of the laser are killed (SIGKILL)"),
}


def judge_light_off(facts: CheckFacts, plan: CheckPlan, laser: LaserSettings) -> tuple[CheckResult, ...]:
    """Return one result for each safety layer of the laser."""
    return tuple(_light_off(layer, plan, facts, laser) for layer in facts.light_off)


def _light_off(layer: LightOff, plan: CheckPlan, facts: CheckFacts, laser: LaserSettings) -> CheckResult:
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
        return _by_photodiode(found, facts.diode, laser)
    return _by_camera(found, facts.sight, laser) if layer.witness == "the camera" else found


def _by_photodiode(found: CheckResult, diode: DiodeLevels | None, laser: LaserSettings) -> CheckResult:
    """Let a result pass where a person closed the beam, no pulse is missed, and no harmful light stays unseen."""
    if diode is None or diode.closed_rel is None:
        return not_proven(found, NO_DARK_REFERENCE)
    unseen_rel = (diode.threshold_rel - diode.closed_rel) / (diode.on_rel - diode.closed_rel)
    dark = f"dark is what it read with the beam closed by hand, {diode.readings} times in a row"
    found = _with_unseen(found, unseen_rel, dark, laser)
    back_rel = (diode.on_again_rel or 0.0) - diode.closed_rel
    if not diode.reported_lit_closed or back_rel < LEAST_BACK_SHARE * (diode.on_rel - diode.closed_rel):
        found = not_proven(found, NOT_LIT_CLOSED)
    return found if diode.sees_pulses else not_proven(found, NO_PULSES)


def _by_camera(found: CheckResult, sight: SightLevels | None, laser: LaserSettings) -> CheckResult:
    """Let a result pass where a filter that blocks the laser shows what dark is, and no harmful light stays unseen."""
    if sight is None or sight.blocked_off_dn is None or sight.blocked_on_dn is None:
        return not_proven(found, NO_BLOCKED_REFERENCE)
    seen_dn = sight.on_dn - sight.blocked_off_dn
    if sight.blocked_on_dn - sight.blocked_off_dn > MOST_BLOCKED_SHARE * seen_dn:
        return not_proven(found, f"the laser is seen behind filter {sight.blocked_filter} too; {NO_BLOCKED_REFERENCE}")
    dark = f"dark is what it saw behind filter {sight.blocked_filter}, which blocks the laser"
    return _with_unseen(found, (sight.threshold_dn - sight.blocked_off_dn) / seen_dn, dark, laser)


def _with_unseen(found: CheckResult, unseen_rel: float, dark: str, laser: LaserSettings) -> CheckResult:
    """Say how much light would not be seen, and let a result pass where that much is of class 1."""
    unseen_mw = max(unseen_rel, 0.0) * laser.power_mw
    told = (
        f"{found.evidence}; {dark}; light below {100 * max(unseen_rel, 0.0):.2g} % of the laser's, {unseen_mw:.2g} mW "
        "of its power_mw, would not be seen"
    )
    found = found.model_copy(update={"evidence": told})
    if not CLASS_1_NM[0] <= laser.wavelength_nm <= CLASS_1_NM[1]:
        why = f"finray has no limit of class 1 at {laser.wavelength_nm:g} nm, so nobody says whether that is harmless"
        return not_proven(found, why)
    if unseen_mw <= CLASS_1_MW:
        return found
    return not_proven(
        found,
        f"that is more than the {CLASS_1_MW:g} mW of a class 1 laser, so it is no proof of off; shade the witness from "
        "other light, or let it see more of the laser",
    )


def slowest_off(layer: LightOff) -> tuple[float, float]:
    r"""Return the time of the slowest mishap (s) with its standard uncertainty (s).

    Between the last look that saw the laser on, at a, and the first that saw it off, at b, all times are alike:

    .. math:: t = (a + b) / 2, \quad u^2 = (b - a)^2 / 12 + u_\text{clock}^2
    """
    slowest = max(range(len(layer.latest_s)), key=lambda i: layer.latest_s[i])
    earliest_s, latest_s = layer.earliest_s[slowest], layer.latest_s[slowest]
    return 0.5 * (earliest_s + latest_s), math.hypot((latest_s - earliest_s) / math.sqrt(12), CLOCK_SD_S)
