"""Verdicts on what the devices say and do: handshakes, moves of the wheel, safety layers of the laser."""

import math
from typing import Final

from data_schemas.check import CheckFacts, CheckPlan, CheckResult, Handshake, LightLayer, LightOff
from finray_calib.acceptance.guard_band import measured, unmeasured

CLOCK_SD_S: Final = 0.005
"""Of one time on a computer that does other things: scheduler and serial buffers, a few milliseconds."""
UNASKED: Final = ("manual",)
"""Drivers behind which a person stands: nobody names itself and no time is kept."""
_LAYERS: Final[dict[LightLayer, tuple[str, str]]] = {
    "block": ("laser off after an exception", "an exception leaves the block that lights the laser"),
    "guard": ("laser off by the guard", "the program that lights the laser is killed (SIGKILL)"),
    "dead-man": ("laser off by the dead-man", "the program, the guard and the watch of the laser are killed (SIGKILL)"),
}


def judge_handshakes(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    """Return one result for each device: it answers, names itself, and does so in time."""
    return tuple(_handshake(hand, plan) for hand in facts.handshakes)


def _handshake(hand: Handshake, plan: CheckPlan) -> CheckResult:
    """Judge one device."""
    name, what = f"{hand.role} answers", f"slowest answer of the {hand.role} to who it is and how it stands"
    if hand.error is not None or hand.identity is None or not hand.durations_s:
        return unmeasured("handshake", name, what, "ERROR", hand.error or "it was not asked")
    said = hand.identity
    words = [f"{key} {text}" for key in ("vendor", "model", "serial", "firmware") if (text := getattr(said, key))]
    if hand.driver in UNASKED:
        return unmeasured("handshake", name, what, "UNDECIDED", "a person switches it, nothing can be asked")
    if (said.role, said.driver) != (hand.role, hand.driver):
        return unmeasured(
            "handshake", name, what, "FAIL", f"a {said.role} behind driver '{said.driver}' answers", hand.driver
        )
    if not words:
        return unmeasured("handshake", name, what, "UNDECIDED", "it answers and does not say what it is")
    evidence = f"{', '.join(words)}; {len(hand.durations_s)} times asked"
    return measured(
        "handshake", name, what, max(hand.durations_s), CLOCK_SD_S, "s", evidence, high=plan.limits.handshake_s
    )


def judge_wheel(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    """Return whether the wheel arrives, and how long its moves take."""
    arrival, times = ("wheel arrives", "moves that ended at another slot"), ("wheel moves in time", "longest move")
    if not facts.moves:
        if "wheel" in facts.errors:
            return ()
        reason = "no move was made: the plan asks for none, or names one filter only"
        return tuple(unmeasured("wheel", *both, "UNDECIDED", reason) for both in (arrival, times))
    wrong = [move for move in facts.moves if move.arrived_slot != move.to_slot]
    moves = len(facts.moves)
    if wrong:
        first = wrong[0]
        evidence = f"the first: sent from slot {first.from_slot} to {first.to_slot}, reads {first.arrived_slot}"
    else:
        evidence = (
            f"{moves} of {moves} arrived, read afresh after each: with 95 % confidence at most "
            f"{100 * largest_failure_share(moves):.1f} % of all moves go wrong"
        )
    durations_s = [move.duration_s for move in facts.moves]
    mean_s = sum(durations_s) / moves
    return (
        measured("wheel", *arrival, float(len(wrong)), 0.0, "moves", evidence, high=0.0),
        measured(
            "wheel", *times, max(durations_s), CLOCK_SD_S, "s", f"mean {mean_s:.3g} s of {moves} moves",
            high=plan.limits.move_s,
        ),
    )  # fmt: skip


def largest_failure_share(tries: int) -> float:
    """Return the share of failures that is ruled out with 95 % confidence when none of `tries` failed.

    .. math:: p = 1 - 0.05^{1/n}
    """
    return -math.expm1(math.log(0.05) / tries)


def judge_light_off(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    """Return one result for each safety layer of the laser."""
    return tuple(_light_off(layer, plan) for layer in facts.light_off)


def _light_off(layer: LightOff, plan: CheckPlan) -> CheckResult:
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
            f"still on in {layer.still_on} of {layer.still_on + len(layer.latest_s)} mishaps, watched for "
            f"{layer.watched_s:g} s",
            f"at most {limit_s:g} s",
        )  # fmt: skip
    value_s, sd_s = slowest_off(layer)
    evidence = f"slowest of {len(layer.latest_s)}; seen by {layer.witness}"
    return measured("light off", name, what, value_s, sd_s, "s", evidence, high=limit_s)


def slowest_off(layer: LightOff) -> tuple[float, float]:
    r"""Return the time of the slowest mishap (s) with its standard uncertainty (s).

    Between the last look that saw the laser on, at a, and the first that saw it off, at b, all times are alike:

    .. math:: t = (a + b) / 2, \quad u^2 = (b - a)^2 / 12 + u_\text{clock}^2
    """
    slowest = max(range(len(layer.latest_s)), key=lambda i: layer.latest_s[i])
    earliest_s, latest_s = layer.earliest_s[slowest], layer.latest_s[slowest]
    return 0.5 * (earliest_s + latest_s), math.hypot((latest_s - earliest_s) / math.sqrt(12), CLOCK_SD_S)
