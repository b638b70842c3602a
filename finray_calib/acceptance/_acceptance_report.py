"""From the facts of an acceptance check to its report: every check gets one result, also where nothing was measured.

Verdicts on what the devices say and do (handshakes, moves of the wheel, safety layers of the laser) and on what the
frames show (filters, revisits, dark level, read noise, exposure ratios); and a result in words, the same on the
terminal, in JUnit XML and on the page.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    AcceptanceReport,
    BlockedLight,
    CameraSettings,
    CheckFacts,
    CheckPlan,
    CheckResult,
    CheckVerdict,
    DarkFrames,
    ExposureLevel,
    LatencyTry,
    RigFile,
    Section,
    TriggerLatency,
    WarmUp,
)
from finray_calib.acceptance._conformity import (
    GUARD_FACTOR,
    ToleranceInterval,
    limit_text,
    measured,
    not_proven,
    overall,
    unmeasured,
)
from finray_calib.acceptance._device_checks import (
    CLOCK_SD_S,
    judge_frames,
    judge_handshakes,
    judge_light_off,
    judge_reconnect,
    report_of,
    results_of,
)

Floats = NDArray[np.float64]

SECTIONS: Final[dict[Section, str]] = {
    "opening": "rig opens",
    "handshake": "devices answer",
    "wheel": "wheel moves",
    "dark frames": "dark frames",
    "filters": "filters in their slots",
    "revisits": "wheel repeats optically",
    "exposures": "exposure ratios",
    "warm-up": "lamp settles",
    "stray light": "stray light",
    "trigger latency": "trigger latency",
    "light off": "laser off after a mishap",
    "closing": "rig closes with its lights off",
    "reconnect": "devices come back",
}


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
    limits = plan.limits
    judged: dict[Section, tuple[CheckResult, ...]] = {
        "handshake": judge_handshakes(facts.handshakes, limits.handshake_s),
        "wheel": judge_wheel(facts, plan),
        "dark frames": judge_dark_frames(facts, plan, rig.camera),
        "filters": judge_filters(facts),
        "revisits": _seen_to_turn((*judge_revisits(facts, plan), *judge_picture(facts, plan)), facts),
        "exposures": (
            *judge_exposures(facts, plan),
            *judge_lamp(facts, plan),
            *judge_frames("exposures", facts.frame_overheads_s, limits.frame_overhead_s),
        ),
        "warm-up": judge_warm_up(facts, plan, rig.camera),
        "stray light": judge_stray_light(facts, plan, rig.camera),
        "trigger latency": judge_latency(facts, plan),
        "light off": judge_light_off(facts, plan, rig),
        "reconnect": judge_reconnect(facts, limits.reconnect_s),
    }
    return report_of(facts, plan, rig, results_of(SECTIONS, judged, facts.errors), notes)


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
        where = f"slot {first.arrived_slot}"
        if first.arrived_slot is None:
            where = "no slot, or its frame was not that of the filter"
        evidence = f"the first one was sent from slot {first.from_slot} to slot {first.to_slot} and reported {where}"
    else:
        evidence = (
            f"all {moves} moves arrived, by the reported position and, where bright enough, the frame after each; with "
            f"95 % confidence at most {100 * largest_failure_share(moves):.1f} % of moves fail"
        )
    durations_s = [move.duration_s for move in facts.moves]
    mean_s = sum(durations_s) / moves
    arrives = measured(
        "wheel", *arrival, float(len(wrong)), 0.0, "moves", evidence, limits=ToleranceInterval(None, 0.0)
    )
    in_time = measured(
        "wheel", *times, max(durations_s), CLOCK_SD_S, "s", f"mean {mean_s:.3g} s of {moves} moves",
        limits=ToleranceInterval(None, plan.limits.move_s),
    )  # fmt: skip
    if facts.filter_proof is None or facts.filter_proof.verdict != "confirmed":
        arrives = not_proven(arrives, NOT_SEEN_TO_TURN)
    if "wheel" in facts.errors:
        arrives = not_proven(arrives, f"an error left this undecided (see {SECTIONS['wheel']})")
    return (arrives, *_seen_to_turn((in_time,), facts))


def _seen_to_turn(results: tuple[CheckResult, ...], facts: CheckFacts) -> tuple[CheckResult, ...]:
    """Let results on the wheel pass only where the frames show that it turns: its word proves no move.

    One pair of filters that look alike does not hide that. Whether it arrives at each slot, only all filters show.
    """
    if facts.filter_proof is not None and facts.filter_proof.shows_turns:
        return results
    return tuple(not_proven(one, NOT_SEEN_TO_TURN) for one in results)


def largest_failure_share(tries: int) -> float:
    """Return the share of failures that is ruled out with 95 % confidence when none of `tries` failed.

    .. math:: p = 1 - 0.05^{1/n}
    """
    return -math.expm1(math.log(0.05) / tries)


ROUNDING_DN2: Final = 1.0 / 12.0
"""Variance of rounding to whole counts."""
LEAST_NOISE_DN: Final = 0.4
"""Below it, rounding hides what the noise is."""
MOST_AT_ZERO: Final = 1e-3  # share of counts at 0: beyond it, the noise is cut off
NOT_SEEN_TO_TURN: Final = (
    "only the wheel reports that it turned, because the frames do not show every filter in its slot"
)
LIT_IN_THE_DARK: Final = (
    "the white frames are hardly brighter than the dark frames, so the lamp was always off, or also on in the dark "
    "frames"
)
SATURATED_SHARE: Final = 0.95
"""Of full scale, mean of the region: from there on more light adds nothing."""
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
        return (unmeasured("revisits", name, what, "UNDECIDED", "the plan asks for none, or has one filter only"),)
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
    limits = ToleranceInterval(None, 100 * plan.limits.revisit_rel)
    return (measured("revisits", name, what, 100 * moved, sd, "%", evidence, limits=limits),)


SHIFT_SCALE_SD: Final = 0.05
"""Of a shift of the picture, relative: how it is measured."""
PINNED: Final = (
    "dust or stains on sensor and windows look like texture and would hide a shift; put a printed dot pattern in the "
    "place of the white tile, then set texture_is_of_the_tile = true in the plan"
)


def judge_picture(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    r"""Return how far the picture moves when the wheel comes back, as root mean square of n shifts.

    .. math:: y^2 = \sum (r^2 + c^2) / n, \quad u^2 = y^2 / 4 n + \sum s^2 / n^2 + (0.05 y)^2

    with the shifts r along rows and c along columns and the uncertainty s of each, which is mostly noise; the scale of
    a shift is known to 5 %. Noise makes y larger than it is: the check errs to the safe side. Texture that does not
    move with the target makes y smaller: the frames cannot rule it out, so without a statement in the plan, and where
    some pairs show too little texture, the check fails or stays undecided.
    """
    if not facts.revisits:
        return ()
    name, what = "picture stays in place", "RMS shift of the picture of the white tile over a move away and back"
    limits = ToleranceInterval(None, plan.limits.pixel_shift_px)
    shifts = [(one.moved_px, one.still_px) for one in facts.revisits if one.moved_px is not None]
    if not shifts:
        return (unmeasured("revisits", name, what, "UNDECIDED", "not recorded", limit_text(None, limits.high, "px")),)
    seen = [(moved, still) for moved, still in shifts if moved.sd_px is not None]
    few = (
        f"{len(shifts) - len(seen)} of {len(shifts)} pairs of frames show too little texture above noise and fixed "
        "pattern; put a printed dot pattern or a rough matt surface in the place of the white tile, in focus, and "
        "choose a region of 64 x 64 pixels or more"
    )
    if not seen:
        return (unmeasured("revisits", name, what, "UNDECIDED", few, limit_text(None, limits.high, "px")),)
    number = len(seen)
    moved_px, still_px = (
        math.sqrt(sum(one.row_px**2 + one.column_px**2 for one in each if one is not None) / number)
        for each in zip(*seen, strict=True)
    )
    mean_square = sum((moved.sd_px or 0.0) ** 2 for moved, _ in seen) / number
    sd = math.sqrt(moved_px**2 / (4 * number) + mean_square / number + (SHIFT_SCALE_SD * moved_px) ** 2)
    evidence = f"{number} times behind filter {facts.revisit_filter}; {still_px:.2g} px without a move"
    found = measured("revisits", name, what, moved_px, sd, "px", evidence, limits=limits)
    if number < len(shifts):
        return (not_proven(found, few),)
    return (found if plan.texture_is_of_the_tile else not_proven(found, PINNED),)


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
            f"{evidence}; the rig file states {camera.black_level_dn:g} DN",
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
        reason = f"{100 * dark.at_zero_fraction:.2g} % of the counts are 0, so noise is cut off; raise the black level"
        return unmeasured("dark frames", name, what, "UNDECIDED", reason, limit)
    if dark.noise_dn < LEAST_NOISE_DN:
        reason = f"{dark.noise_dn:.2g} DN, which rounding to whole counts hides; raise the camera's gain"
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
        limits = ToleranceInterval(-most, most)
        results.append(measured("exposures", name, what, 100 * (ratio - 1.0), 100 * sd, "%", evidence, limits=limits))
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


LEAST_WHITE_SHARE: Final = 0.05
"""Of full scale, mean of the region: below it, noise and the dark level decide."""
LEAST_WATCH: Final = 2.0
"""Of the time in which a lamp must settle: one that was watched for less could settle later unseen."""
LAST_SHARE: Final = 0.2
"""Of the looks at the lamp, at the end: their mean is the level that it settles at."""


def judge_warm_up(facts: CheckFacts, plan: CheckPlan, camera: CameraSettings) -> tuple[CheckResult, ...]:
    """Return how long the lamp needs to settle, and how far the dark level moved meanwhile."""
    settles = (
        "lamp settles",
        "time after switching on from which the lamp stays within lamp_drift_rel of its final level",
    )
    dark = ("dark level stays", "change of the dark level while the lamp was on")
    limit = limit_text(None, plan.limits.lamp_settles_s, "s")
    if (warm := facts.warm_up) is None:
        if "warm-up" in facts.errors:
            return ()
        reason = "the plan asks for no warm-up (warm_up_s = 0)"
        return tuple(unmeasured("warm-up", *both, "UNDECIDED", reason) for both in (settles, dark))
    before, after = np.array(warm.dark_before_dn), np.array(warm.dark_after_dn)
    sd = math.hypot(_sd_of_mean(before), _sd_of_mean(after), math.sqrt(2.0 * ROUNDING_DN2))
    span_s, most_dn = warm.times_s[-1], plan.limits.black_level_dn
    evidence = f"{before.size} dark frames before and {after.size} after {span_s:.3g} s of light"
    change_dn = float(after.mean() - before.mean())
    stays = measured("warm-up", *dark, change_dn, sd, "DN", evidence, limits=ToleranceInterval(-most_dn, most_dn))
    darkest_dn = max(before.mean(), after.mean()) - camera.black_level_dn
    if np.mean(warm.white_dn) - darkest_dn < LEAST_WHITE_SHARE * (2**camera.bit_depth - 1):
        stays = not_proven(stays, LIT_IN_THE_DARK)
    return _settling(warm, plan, camera, (*settles, limit)), stays


def _settling(warm: WarmUp, plan: CheckPlan, camera: CameraSettings, words: tuple[str, str, str]) -> CheckResult:
    """Judge the time until the lamp has settled."""
    name, what, limit = words
    allowed, most_s = plan.limits.lamp_drift_rel, plan.limits.lamp_settles_s
    dark_dn, times_s = np.array(warm.dark_before_dn), np.array(warm.times_s)
    levels = np.array(warm.white_dn) + camera.black_level_dn - dark_dn.mean()
    last = max(round(LAST_SHARE * levels.size), 4)
    least_dn = max(LEAST_WHITE_SHARE * (2**camera.bit_depth - 1), 5.0 * float(dark_dn.std(ddof=1)))
    if levels.size < 2 * last or levels[-last:].mean() < least_dn:
        reason = (
            f"the lamp was too dim, only {levels[-last:].mean():.3g} DN above the dark frames in {levels.size} "
            f"readings, but {least_dn:.3g} DN in {2 * last} readings are needed; check lamp, tile and lens cap, or "
            "raise warm_up_s"
        )
        return unmeasured("warm-up", name, what, "UNDECIDED", reason, limit)
    away = levels / levels[-last:].mean() - 1.0
    noise = float(np.std(np.diff(away), ddof=1)) / math.sqrt(2.0)
    drift = float(np.polyfit(times_s[-last:], away[-last:], 1)[0]) * float(times_s[-1] - times_s[-last])
    span_s = float(times_s[-1])
    if (found := _unsettled(drift, noise, last, allowed)) is not None:
        why, drifts = found
        reason = f"not settled within the {span_s:.3g} s that it was watched: {why}; raise warm_up_s"
        return unmeasured("warm-up", name, what, "FAIL" if drifts and span_s > most_s else "UNDECIDED", reason, limit)
    sooner_s, later_s = (_settled_s(times_s, away, allowed + sign * noise) for sign in (1.0, -1.0))
    step_s = span_s / (times_s.size - 1)
    sd_s = math.hypot(step_s, later_s - sooner_s) / math.sqrt(12.0)
    evidence = (
        f"{levels.size} frames behind filter {warm.filter_name} within {span_s:.3g} s; starts {100 * away[0]:+.2g} % "
        f"from its final level, scatters by {100 * noise:.2g} %"
    )
    value_s, limits = 0.5 * (sooner_s + later_s), ToleranceInterval(None, most_s)
    result, least_s = measured("warm-up", name, what, value_s, sd_s, "s", evidence, limits=limits), LEAST_WATCH * most_s
    if span_s + step_s >= least_s:
        return result
    return not_proven(result, f"too short to see a slow lamp settle; raise warm_up_s to {least_s:g} or more")


def _unsettled(drift: float, noise: float, looks: int, allowed: float) -> tuple[str, bool] | None:
    """Return why the end of the watch is no level to settle at, and whether that is a proven drift; None if it is."""
    if abs(drift) <= allowed and 2.0 * noise <= allowed:
        return None
    # of a line through evenly spaced looks
    drift_sd = noise * math.sqrt(12.0 * (looks - 1) / (looks * (looks + 1)))
    drifts = abs(drift) - GUARD_FACTOR * drift_sd > allowed
    if drifts or 2.0 * noise <= allowed:
        return f"it still changes by {100 * drift:+.2g} % in the last fifth", drifts
    return f"it flickers by {100 * noise:.2g} % from frame to frame", drifts


def _settled_s(times_s: Floats, away: Floats, allowed: float) -> float:
    """Return the middle between the last look outside and the next one (s); 0 where none was outside."""
    outside = np.flatnonzero(np.abs(away) > allowed)
    if not outside.size:
        return 0.0
    last = int(outside[-1])
    return float(times_s[last : last + 2].mean())


def judge_stray_light(facts: CheckFacts, plan: CheckPlan, camera: CameraSettings) -> tuple[CheckResult, ...]:
    """Return how much laser light comes through the filters that block it, or past them: the worst verdict of all.

    Each mean may be off by rounding. Less light than in the dark frames, beyond the limit, is a fault too.
    """
    if (stray := facts.stray_light) is None:
        return ()
    name, what = (
        "stray light",
        "laser light of the white tile behind a filter that blocks it, relative to one that passes it",
    )
    most = 100 * plan.limits.stray_light_rel
    limit, words = ToleranceInterval(-most, most), limit_text(-most, most, "%")
    if stray.missing is not None or stray.passed is None:
        return (unmeasured("stray light", name, what, "UNDECIDED", stray.missing or "not recorded", words),)
    passed, passed_sd = rate_dn_per_s(stray.passed.level)
    reason = None
    if not stray.blocked:
        reason = "nothing was recorded behind a filter that blocks the laser"
    elif max((dark.at_zero_fraction for dark in facts.darks), default=0.0) > MOST_AT_ZERO:
        reason = "dark frames have counts of 0, which hide faint light; raise the black level"
    elif passed <= 3.0 * passed_sd:
        reason = f"the laser is not seen behind filter {stray.passed.filter_name} either; check tile, box and laser"
    elif max(dn for one in stray.blocked for dn in one.level.dark_dn) > SATURATED_SHARE * (2**camera.bit_depth - 1):
        reason = (
            "the frames with the laser off are saturated, so stray light would not show; find which other light is on"
        )
    if reason is not None:
        return (unmeasured("stray light", name, what, "UNDECIDED", reason, words),)

    def behind(one: BlockedLight) -> CheckResult:
        rate, sd = rate_dn_per_s(one.level)
        sd = math.hypot(sd, math.sqrt(2.0 * ROUNDING_DN2) / one.level.exposure_s)
        evidence = (
            f"worst of {len(stray.blocked)} filters, behind {one.filter_name}, {one.level.exposure_s:.3g} s; includes "
            "what filter and tile let through or re-radiate; leaking room light is subtracted (see dark rate)"
        )
        share_sd = math.hypot(sd / passed, rate * passed_sd / passed**2)
        return measured("stray light", name, what, 100 * rate / passed, 100 * share_sd, "%", evidence, limits=limit)

    found = tuple(behind(one) for one in stray.blocked)
    worst = [one for one in found if one.verdict == overall(found)]
    return (max(worst, key=lambda one: abs(one.value or 0.0)),)


MOST_SHARE_SD: Final = 0.05
"""Of the lit share of an exposure: beyond it, a share is mostly noise."""


def judge_latency(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    r"""Return how long after its request an exposure collects light.

    A light that goes on at a time t after the request, and is seen for a share f of the exposure T, tells that the
    exposure began at

    .. math:: L = t - T (1 - f)

    The light goes on at any time between its command and its confirmation; that half width over the root of 3 is the
    same in every try. An exposure that was lit all the while, or not at all, tells only that L is larger or smaller;
    one whose share is not known within 5 % tells nothing. A begin before the request, beyond noise, fails.
    """
    if (found := facts.latency) is None:
        return ()
    name, what = "trigger latency", "time from the request of an exposure until the camera collects light"
    words = limit_text(None, plan.limits.latency_s, "s")
    if found.missing is not None or found.exposure_s is None:
        return (unmeasured("trigger latency", name, what, "UNDECIDED", found.missing or "not recorded", words),)
    seen = [one for one in found.tries if 0.02 < one.lit_share < 0.98 and one.lit_share_sd <= MOST_SHARE_SD]
    if len(seen) < 4:
        return (unmeasured("trigger latency", name, what, "UNDECIDED", _unseen(found), words),)
    value_s, sd_s, scatter_s, switching_s = latency_s(seen, found.exposure_s)
    early = value_s + GUARD_FACTOR * sd_s < 0.0
    limits = ToleranceInterval(0.0 if early else None, plan.limits.latency_s)
    evidence = "the camera delivers frames that began before their request; " if early else ""
    evidence += (
        f"{len(seen)} of {len(found.tries)} exposures of {found.exposure_s:.3g} s saw the {found.light} go on; scatter "
        f"{scatter_s:.2g} s, the {found.light} is confirmed {switching_s:.2g} s after its command"
    )
    return (measured("trigger latency", name, what, value_s, sd_s, "s", evidence, limits=limits),)


def latency_s(seen: list[LatencyTry], exposure_s: float) -> tuple[float, float, float, float]:
    """Return the mean latency, its standard uncertainty, the scatter of one try and the time of switching (s)."""
    each = np.array([0.5 * (t.on_earliest_s + t.on_latest_s) - exposure_s * (1.0 - t.lit_share) for t in seen])
    switching_s = float(np.mean([t.on_latest_s - t.on_earliest_s for t in seen]))
    level_s = exposure_s * float(np.mean([t.lit_share_sd for t in seen]))
    sd_s = math.sqrt(_sd_of_mean(each) ** 2 + (switching_s / math.sqrt(12.0)) ** 2 + level_s**2)
    return float(each.mean()), sd_s, float(each.std(ddof=1)), switching_s


def _unseen(found: TriggerLatency) -> str:
    """Say what exposures tell that did not see the light go on."""
    lit = sum(one.lit_share >= 0.98 for one in found.tries)
    dark = sum(one.lit_share <= 0.02 for one in found.tries)
    noisy = sum(one.lit_share_sd > MOST_SHARE_SD for one in found.tries)
    return (
        f"of {len(found.tries)} exposures of {found.exposure_s:.3g} s, {lit} began after the {found.light} was on, "
        f"{dark} ended before the {found.light} was on, and {noisy} are too noisy; dim the {found.light} or close the "
        "aperture, so that exposures last longer than switching, and raise latency_tries"
    )


def rate_dn_per_s(level: ExposureLevel) -> tuple[float, float]:
    r"""Return the signal per second of exposure (DN/s) and its standard uncertainty.

    Each mean of n frames has the standard uncertainty of GUM Supplement 1 (6.4.9), which few frames enlarge:

    .. math:: u^2 = \frac{n - 1}{n - 3} \frac{s^2}{n}
    """
    white, dark = np.array(level.white_dn), np.array(level.dark_dn)
    sd_dn = math.hypot(_sd_of_mean(white), _sd_of_mean(dark))
    return float(white.mean() - dark.mean()) / level.exposure_s, sd_dn / level.exposure_s


def _sd_of_mean(values: Floats) -> float:
    """Return the standard uncertainty of the mean of four values or more (GUM Supplement 1, 6.4.9)."""
    return math.sqrt(float(values.var(ddof=1)) / values.size * (values.size - 1) / (values.size - 3))
