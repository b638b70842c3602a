"""From the facts of an acceptance check to its report: every check gets one result, also where nothing was measured.

Verdicts on what the devices say and do (handshakes, moves of the wheel, safety layers of the laser) and on what the
frames show (filters, revisits, dark level, read noise, exposure ratios); and a result in words, the same on the
terminal, in JUnit XML and on the page.
"""

import math
from typing import Final

import numpy as np

from data_schemas import (
    AcceptanceReport,
    CameraSettings,
    CheckFacts,
    CheckPlan,
    CheckResult,
    CheckVerdict,
    DarkFrames,
    ExposureLevel,
    Handshake,
    LightLayer,
    LightOff,
    RigFile,
    Section,
)
from finray_calib.acceptance._conformity import ToleranceInterval, limit_text, measured, overall, unmeasured

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
    "reconnect": "devices come back",
}
SIMULATED_NOTE: Final = (
    "the rig is simulated, so no real device was tried; its simulated clock gives all times except the time "
    "until devices answer again"
)


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
        "exposures": (*judge_exposures(facts, plan), *judge_lamp(facts, plan), *judge_frames(facts, plan)),
        "light off": judge_light_off(facts, plan),
        "closing": (),
        "reconnect": judge_reconnect(facts, plan),
    }
    for section, title in SECTIONS.items():
        results += judged[section]
        if section in facts.errors:
            what = "the error that ended this part of the check"
            results.append(unmeasured(section, title, what, "ERROR", facts.errors[section]))
    return AcceptanceReport(
        plan=plan,
        rig=rig,
        facts=facts,
        results=tuple(results),
        verdict=overall(tuple(results)),
        notes=(*notes, *((SIMULATED_NOTE,) if rig.is_simulated else ())),
    )


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
    name, what = f"{hand.role} answers", f"slowest answer of the {hand.role} to questions about identity and state"
    if hand.error is not None or hand.identity is None or not hand.durations_s:
        return unmeasured("handshake", name, what, "ERROR", hand.error or "it was not asked")
    said = hand.identity
    words = [f"{key} {text}" for key in ("vendor", "model", "serial", "firmware") if (text := getattr(said, key))]
    if hand.driver in UNASKED:
        return unmeasured("handshake", name, what, "UNDECIDED", "it is switched by hand, so no device can be asked")
    if (said.role, said.driver) != (hand.role, hand.driver):
        return unmeasured(
            "handshake", name, what, "FAIL", f"a {said.role} behind driver '{said.driver}' answers", hand.driver
        )
    if not words:
        return unmeasured("handshake", name, what, "UNDECIDED", "it answers but does not identify itself")
    evidence = f"{', '.join(words)}; {len(hand.durations_s)} times asked"
    return measured(
        "handshake",
        name,
        what,
        max(hand.durations_s),
        CLOCK_SD_S,
        "s",
        evidence,
        limits=ToleranceInterval(None, plan.limits.handshake_s),
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
        evidence = (
            f"the first one was sent from slot {first.from_slot} to slot {first.to_slot} and reported slot "
            f"{first.arrived_slot}"
        )
    else:
        evidence = (
            f"all {moves} moves arrived, as the position read after each one shows; with 95 % confidence at "
            f"most {100 * largest_failure_share(moves):.1f} % of moves fail"
        )
    durations_s = [move.duration_s for move in facts.moves]
    mean_s = sum(durations_s) / moves
    return (
        measured("wheel", *arrival, float(len(wrong)), 0.0, "moves", evidence, limits=ToleranceInterval(None, 0.0)),
        measured(
            "wheel", *times, max(durations_s), CLOCK_SD_S, "s", f"mean {mean_s:.3g} s of {moves} moves",
            limits=ToleranceInterval(None, plan.limits.move_s),
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
            f"the laser was still on after {layer.still_on} of {layer.still_on + len(layer.latest_s)} "
            f"mishaps; each was watched for {layer.watched_s:g} s",
            f"at most {limit_s:g} s",
        )  # fmt: skip
    value_s, sd_s = slowest_off(layer)
    evidence = f"slowest of {len(layer.latest_s)} mishaps; measured by {layer.witness}"
    return measured("light off", name, what, value_s, sd_s, "s", evidence, limits=ToleranceInterval(None, limit_s))


def slowest_off(layer: LightOff) -> tuple[float, float]:
    r"""Return the time of the slowest mishap (s) with its standard uncertainty (s).

    Between the last look that saw the laser on, at a, and the first that saw it off, at b, all times are alike:

    .. math:: t = (a + b) / 2, \quad u^2 = (b - a)^2 / 12 + u_\text{clock}^2
    """
    slowest = max(range(len(layer.latest_s)), key=lambda i: layer.latest_s[i])
    earliest_s, latest_s = layer.earliest_s[slowest], layer.latest_s[slowest]
    return 0.5 * (earliest_s + latest_s), math.hypot((latest_s - earliest_s) / math.sqrt(12), CLOCK_SD_S)


ROUNDING_DN2: Final = 1.0 / 12.0
"""Variance of rounding to whole counts."""
LEAST_NOISE_DN: Final = 0.4
"""Below it, rounding hides what the noise is."""
MOST_AT_ZERO: Final = 1e-3  # share of counts at 0: beyond it, the noise is cut off
_PROOF: Final[dict[str, CheckVerdict]] = {"confirmed": "PASS", "contradicted": "FAIL", "cannot tell": "UNDECIDED"}


def judge_filters(facts: CheckFacts) -> tuple[CheckResult, ...]:
    """Return whether the white frames show the filters where the rig file puts them."""
    if facts.filter_proof is None:
        return ()
    verdict = _PROOF[facts.filter_proof.verdict]
    what = (
        "comparison of white frames under the lamp with what filters, lamp and camera predict, also with any two "
        "filters exchanged"
    )
    limit = "no exchange of two filters explains the frames equally well"
    return (unmeasured("filters", "filters in their slots", what, verdict, facts.filter_proof.text, limit),)


def judge_revisits(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    r"""Return how well the white signal repeats when the wheel comes back.

    .. math:: y = \sqrt{\textstyle\sum r^2 / n}, \quad u = y / \sqrt{2 n}
    """
    name, what = "wheel repeats optically", "RMS change of the white signal over a move away and back"
    if not facts.revisits:
        if "revisits" in facts.errors:
            return ()
        return (unmeasured("revisits", name, what, "UNDECIDED", "the plan asks for none, or names one filter only"),)
    moved, still = (
        math.sqrt(sum(value**2 for value in values) / len(values))
        for values in ([r.moved_rel for r in facts.revisits], [r.still_rel for r in facts.revisits])
    )
    number = len(facts.revisits)
    evidence = (
        f"{number} repeats behind filter {facts.revisit_filter}; without a move the signal changes by "
        f"{100 * still:.2g} %"
    )
    sd = 100 * moved / math.sqrt(2 * number)
    return (
        measured(
            "revisits",
            name,
            what,
            100 * moved,
            sd,
            "%",
            evidence,
            limits=ToleranceInterval(None, 100 * plan.limits.revisit_rel),
        ),
    )


def judge_dark_frames(facts: CheckFacts, plan: CheckPlan, camera: CameraSettings) -> tuple[CheckResult, ...]:
    """Return dark level, its growth with the exposure, and read noise."""
    if not facts.darks:
        return ()
    level_dn, level_sd_dn, rate, rate_sd = dark_line(facts.darks)
    frames = sum(len(dark.means_dn) for dark in facts.darks)
    exposures = ", ".join(f"{dark.exposure_s:.3g}" for dark in facts.darks)
    evidence, apart_dn = f"{frames} frames of {exposures} s", plan.limits.black_level_dn
    return (
        measured(
            "dark frames", "dark level", "dark level at exposure zero", level_dn, level_sd_dn, "DN",
            f"{evidence}; the rig file says {camera.black_level_dn:g} DN",
            limits=ToleranceInterval(camera.black_level_dn - apart_dn, camera.black_level_dn + apart_dn),
        ),
        _dark_rate(rate, rate_sd, f"{evidence}, lamp and laser off", plan.limits.dark_rate_dn_per_s),
        _read_noise(facts.darks[0], plan, camera),
    )  # fmt: skip


def _dark_rate(rate: float, sd: float, evidence: str, most: float) -> CheckResult:
    """Judge the growth of the dark level."""
    name, what = "dark rate", "growth of the dark level with the exposure: dark current and leaking light"
    if not math.isfinite(sd):
        reason = f"{evidence}: one exposure time shows no growth; raise longest_dark_s"
        return unmeasured("dark frames", name, what, "UNDECIDED", reason, limit_text(-most, most, "DN/s"))
    return measured("dark frames", name, what, rate, sd, "DN/s", evidence, limits=ToleranceInterval(-most, most))


def dark_line(darks: tuple[DarkFrames, ...]) -> tuple[float, float, float, float]:
    """Return level at exposure zero (DN) and rate (DN/s) of the dark frames' means, each with its standard uncertainty.

    Ordinary least squares over all frames; the uncertainty follows from their scatter about the line.
    """
    times = np.concatenate([np.full(len(dark.means_dn), dark.exposure_s) for dark in darks])
    means = np.concatenate([np.array(dark.means_dn) for dark in darks])
    design = np.column_stack([np.ones_like(times), times])
    solution, _, rank, _ = np.linalg.lstsq(design, means, rcond=None)
    residual = means - design @ solution
    if rank < 2:  # one exposure time only: a level, and nothing about its growth
        return float(means.mean()), float(means.std(ddof=1) / math.sqrt(means.size)), 0.0, math.inf
    variance = float(residual @ residual) / (means.size - 2)
    sd = np.sqrt(variance * np.diag(np.linalg.inv(design.T @ design)))
    return float(solution[0]), float(sd[0]), float(solution[1]), float(sd[1])


def _read_noise(dark: DarkFrames, plan: CheckPlan, camera: CameraSettings) -> CheckResult:
    r"""Judge the temporal noise of the shortest dark frames.

    .. math:: \sigma = K \sqrt{s^2 - 1/12}, \quad u = \sigma / \sqrt{2 n}

    with K the gain of the rig file (e/DN) and n differences of two counts.
    """
    name, what = "read noise", "temporal noise of a pixel in the dark, without rounding noise"
    low, high = (camera.read_noise_e * (1.0 + sign * plan.limits.read_noise_rel) for sign in (-1.0, 1.0))
    limit = f"{low:.4g} to {high:.4g} e"
    if dark.at_zero_fraction > MOST_AT_ZERO:
        reason = f"{100 * dark.at_zero_fraction:.2g} % of the counts are 0, so noise is cut off: raise the black level"
        return unmeasured("dark frames", name, what, "UNDECIDED", reason, limit)
    if dark.noise_dn < LEAST_NOISE_DN:
        reason = f"{dark.noise_dn:.2g} DN: rounding to whole counts hides it; raise the camera's gain"
        return unmeasured("dark frames", name, what, "UNDECIDED", reason, limit)
    noise_e = camera.gain_e_per_dn * math.sqrt(dark.noise_dn**2 - ROUNDING_DN2)
    differences = dark.pixels * (len(dark.means_dn) // 2)
    evidence = f"{dark.noise_dn:.3g} DN at {dark.exposure_s:.3g} s and {camera.gain_e_per_dn:g} e/DN of the rig file"
    sd_e = noise_e / math.sqrt(2 * differences)
    return measured("dark frames", name, what, noise_e, sd_e, "e", evidence, limits=ToleranceInterval(low, high))


def judge_exposures(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    """Return whether the signal is proportional to the exposure, at twice and four times the shortest of three."""
    if not facts.levels:
        return ()
    rates = [rate_dn_per_s(level) for level in facts.levels]
    first, most = rates[0], 100 * plan.limits.exposure_ratio_rel
    if min(rate for rate, _ in rates) <= 0.0:
        what, reason = "signal per second of exposure", "the white frames are no brighter than the dark ones"
        return (unmeasured("exposures", "exposure ratios", what, "FAIL", reason),)
    results = []
    for factor, level, (rate, rate_sd) in zip((2, 4), facts.levels[1:], rates[1:], strict=True):
        ratio = rate / first[0]
        sd = abs(ratio) * math.hypot(rate_sd / rate, first[1] / first[0])
        evidence = (
            f"{level.exposure_s:.4g} s against {facts.levels[0].exposure_s:.4g} s, {len(level.white_dn)} frames "
            f"each, dark level subtracted"
        )
        what = "signal per second of exposure, relative to that of the shortest of three"
        name = f"exposure ratio {factor} : 1"
        results.append(
            measured(
                "exposures",
                name,
                what,
                100 * (ratio - 1.0),
                100 * sd,
                "%",
                evidence,
                limits=ToleranceInterval(-most, most),
            )
        )
    return tuple(results)


def judge_lamp(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    r"""Return how far the lamp drifts while the white frames of the exposures are taken.

    Each frame relative to the mean of its exposure, averaged over the exposures of a round, gives a line through the n
    rounds; the change is its slope times n - 1. Its uncertainty is that of the scatter about the line, enlarged for
    few rounds (GUM Supplement 1, 6.4.9).
    """
    if not facts.levels or min(rate_dn_per_s(level)[0] for level in facts.levels) <= 0.0:
        return ()
    levels = [np.array(level.white_dn) - np.mean(level.dark_dn) for level in facts.levels]
    rounds = np.mean([level / level.mean() for level in levels], axis=0)
    number = np.arange(rounds.size) - 0.5 * (rounds.size - 1)
    spread = float(number @ number)
    slope, free = float(number @ rounds) / spread, rounds.size - 2
    scatter = rounds - rounds.mean() - slope * number
    name, what = "lamp is steady", "change of the lamp from the first to the last round of white frames"
    if free < 3:
        reason = f"{rounds.size} rounds are too few to give an uncertainty; raise exposure_rounds to 5 or more"
        return (unmeasured("exposures", name, what, "UNDECIDED", reason),)
    sd = math.sqrt(float(scatter @ scatter) / free / spread * free / (free - 2)) * (rounds.size - 1)
    most = 100 * plan.limits.lamp_drift_rel
    evidence = f"{rounds.size} rounds of {len(levels)} exposures within {facts.white_span_s:.3g} s"
    limits = ToleranceInterval(-most, most)
    change = 100 * slope * (rounds.size - 1)
    return (measured("exposures", name, what, change, 100 * sd, "%", evidence, limits=limits),)


def judge_frames(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    """Return how long a frame takes beyond its exposure."""
    if not (times_s := facts.frame_overheads_s):
        return ()
    what = (
        "longest time that a frame takes beyond its exposure (queries to wheel and lights, trigger, readout, transfer)"
    )
    evidence = f"mean {sum(times_s) / len(times_s):.3g} s of {len(times_s)} frames"
    limits = ToleranceInterval(None, plan.limits.frame_overhead_s)
    return (measured("exposures", "frames in time", what, max(times_s), CLOCK_SD_S, "s", evidence, limits=limits),)


def judge_reconnect(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    """Return whether the same devices answer after they were closed and opened again, and how soon."""
    if facts.reconnect_s is None:
        return ()
    name, what = "devices come back", "time until all devices answer after they were closed"
    said = {identity.role: identity for identity in facts.reconnected}
    before = [hand.identity for hand in facts.handshakes if hand.identity is not None]
    others = [one.role for one in before if said.get(one.role) != one]
    if others:
        now = said.get(others[0])
        named = "" if now is None else " ".join(filter(None, (now.vendor, now.model, now.serial, now.firmware)))
        reason = (
            f"another {others[0]} answers than before, or it names itself differently ({named or 'no name'}); give its "
            "address by serial number in the rig file"
        )
        return (unmeasured("reconnect", name, what, "FAIL", reason),)
    limits = ToleranceInterval(None, plan.limits.reconnect_s)
    unknown = sorted(set(said) - {one.role for one in before})
    evidence = f"{len(before)} devices, the same as before"
    evidence += f"; before they were closed, {', '.join(unknown)} gave no name" if unknown else ""
    return (measured("reconnect", name, what, facts.reconnect_s, CLOCK_SD_S, "s", evidence, limits=limits),)


def rate_dn_per_s(level: ExposureLevel) -> tuple[float, float]:
    r"""Return the signal per second of exposure (DN/s) and its standard uncertainty.

    Each mean of n frames has the standard uncertainty of GUM Supplement 1 (6.4.9), which few frames enlarge:

    .. math:: u^2 = \frac{n - 1}{n - 3} \frac{s^2}{n}
    """
    white, dark = np.array(level.white_dn), np.array(level.dark_dn)
    signal_dn = float(white.mean() - dark.mean())
    variance = sum(
        float(values.var(ddof=1)) / values.size * (values.size - 1) / (values.size - 3) for values in (white, dark)
    )
    return signal_dn / level.exposure_s, math.sqrt(variance) / level.exposure_s


def value_text(result: CheckResult) -> str:
    """Return ``1.25 +- 0.02 s``: value and standard uncertainty, which has two significant digits; "" without value."""
    if result.value is None or result.sd is None:
        return ""
    if result.sd == 0.0 or not math.isfinite(result.sd):
        return f"{result.value:g} {result.unit}".strip()
    places = max(1 - math.floor(math.log10(result.sd)), 0)
    return f"{result.value:.{places}f} +- {result.sd:.{places}f} {result.unit}".strip()


def result_line(result: CheckResult) -> str:
    """Return a result as one line: verdict, name, value and limit, then the evidence."""
    value = value_text(result)
    limit = f" (allowed: {result.limit})" if value and result.limit else ""
    return f"{result.verdict:<9} {result.name}: {value}{limit}{'; ' if value else ''}{result.evidence}"
