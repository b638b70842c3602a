"""Verdicts of an acceptance check on light over time and off its way: warm-up, stray light, trigger latency."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    BlockedLight,
    CheckFacts,
    CheckPlan,
    CheckResult,
    ExposureLevel,
    LatencyTry,
    TriggerLatency,
    WarmUp,
)
from finray_calib.acceptance._conformity import ToleranceInterval, limit_text, measured, unmeasured

Floats = NDArray[np.float64]
LAST_SHARE: Final = 0.2
"""Of the looks at the lamp, at the end: their mean is the level that it settles at."""


def judge_warm_up(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    """Return how long the lamp needs to settle, and how far the dark level moved meanwhile."""
    settles = ("lamp settles", "time after switching on from which the lamp stays within lamp_drift_rel of its end")
    dark = ("dark level stays", "change of the dark level while the lamp was on")
    limit = limit_text(None, plan.limits.lamp_settles_s, "s")
    if (warm := facts.warm_up) is None:
        if "warm-up" in facts.errors:
            return ()
        reason = "the plan asks for none (warm_up_s = 0)"
        return tuple(unmeasured("warm-up", *both, "UNDECIDED", reason) for both in (settles, dark))
    before, after = np.array(warm.dark_before_dn), np.array(warm.dark_after_dn)
    sd = math.hypot(_sd_of_mean(before), _sd_of_mean(after))
    span_s, most_dn = warm.times_s[-1], plan.limits.black_level_dn
    evidence = f"{before.size} dark frames before and {after.size} after {span_s:.3g} s of light"
    change_dn = float(after.mean() - before.mean())
    limits = ToleranceInterval(-most_dn, most_dn)
    return (
        _settling(warm, plan, (*settles, limit)),
        measured("warm-up", *dark, change_dn, sd, "DN", evidence, limits=limits),
    )


def _settling(warm: WarmUp, plan: CheckPlan, words: tuple[str, str, str]) -> CheckResult:
    """Judge the time until the lamp has settled."""
    name, what, limit = words
    times_s, levels, allowed = np.array(warm.times_s), np.array(warm.white_dn), plan.limits.lamp_drift_rel
    last = max(round(LAST_SHARE * levels.size), 4)
    if levels.size < 2 * last or levels[-last:].mean() <= 0.0:
        return unmeasured("warm-up", name, what, "UNDECIDED", "the lamp was hardly seen", limit)
    away = levels / levels[-last:].mean() - 1.0
    noise = float(np.std(np.diff(away), ddof=1)) / math.sqrt(2.0)
    drift = float(np.polyfit(times_s[-last:], away[-last:], 1)[0]) * float(times_s[-1] - times_s[-last])
    span_s = float(times_s[-1])
    if abs(drift) > allowed or 2.0 * noise > allowed:
        why = (
            f"it flickers by {100 * noise:.2g} % from frame to frame"
            if 2.0 * noise > allowed
            else f"it still changes by {100 * drift:+.2g} % in the last fifth"
        )
        reason = f"not settled within the {span_s:.3g} s that it was watched: {why}; raise warm_up_s"
        slow = abs(drift) > allowed and span_s > plan.limits.lamp_settles_s
        return unmeasured("warm-up", name, what, "FAIL" if slow else "UNDECIDED", reason, limit)
    sooner_s, later_s = (_settled_s(times_s, away, allowed + sign * noise) for sign in (1.0, -1.0))
    step_s = span_s / (times_s.size - 1)
    sd_s = math.hypot(step_s, later_s - sooner_s) / math.sqrt(12.0)
    evidence = (
        f"{levels.size} frames behind filter {warm.filter_name} within {span_s:.3g} s; begins {100 * away[0]:+.2g} % "
        f"from its end, scatters by {100 * noise:.2g} %"
    )
    limits = ToleranceInterval(None, plan.limits.lamp_settles_s)
    return measured("warm-up", name, what, 0.5 * (sooner_s + later_s), sd_s, "s", evidence, limits=limits)


def _settled_s(times_s: Floats, away: Floats, allowed: float) -> float:
    """Return the middle between the last look outside and the next one (s); 0 where none was outside."""
    outside = np.flatnonzero(np.abs(away) > allowed)
    if not outside.size:
        return 0.0
    last = int(outside[-1])
    return float(times_s[last : last + 2].mean())


def judge_stray_light(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    """Return how much laser light comes through the filters that block it, or past them."""
    if (stray := facts.stray_light) is None:
        return ()
    name, what = "stray light", "laser light of the white tile behind a filter that blocks it, of that which passes"
    limit = ToleranceInterval(None, 100 * plan.limits.stray_light_rel)
    words = limit_text(None, limit.high, "%")
    if stray.missing is not None or stray.passed is None:
        return (unmeasured("stray light", name, what, "UNDECIDED", stray.missing or "not recorded", words),)
    passed, passed_sd = rate_dn_per_s(stray.passed.level)
    if passed <= 3.0 * passed_sd:
        reason = f"the laser is not seen behind filter {stray.passed.filter_name} either; check tile, box and laser"
        return (unmeasured("stray light", name, what, "UNDECIDED", reason, words),)

    def share(one: BlockedLight) -> tuple[float, float]:
        rate, sd = rate_dn_per_s(one.level)
        return rate / passed, math.hypot(sd / passed, rate * passed_sd / passed**2)

    shares = [(*share(one), one) for one in stray.blocked]
    value, sd, worst = max(shares, key=lambda each: each[0])
    evidence = (
        f"largest of {len(shares)} filters, behind {worst.filter_name}, {worst.level.exposure_s:.3g} s; includes what "
        "filter and tile let through or re-radiate; leaking room light is subtracted (see dark rate)"
    )
    return (measured("stray light", name, what, 100 * value, 100 * sd, "%", evidence, limits=limit),)


def judge_latency(facts: CheckFacts, plan: CheckPlan) -> tuple[CheckResult, ...]:
    r"""Return how long after its request an exposure collects light.

    A light that goes on at a time t after the request, and is seen for a share f of the exposure T, tells that the
    exposure began at

    .. math:: L = t - T (1 - f)

    The light goes on at any time between its command and its confirmation; that half width over the root of 3 is the
    same in every try. An exposure that was lit all the while, or not at all, tells only that L is larger or smaller.
    """
    if (found := facts.latency) is None:
        return ()
    name, what = "trigger latency", "time from the request of an exposure until the camera collects light"
    limits = ToleranceInterval(None, plan.limits.latency_s)
    words = limit_text(None, limits.high, "s")
    if found.missing is not None or found.exposure_s is None:
        return (unmeasured("trigger latency", name, what, "UNDECIDED", found.missing or "not recorded", words),)
    seen = [one for one in found.tries if 0.02 < one.lit_share < 0.98]
    if len(seen) < 4:
        return (unmeasured("trigger latency", name, what, "UNDECIDED", _unseen(found), words),)
    value_s, sd_s, scatter_s, switching_s = latency_s(seen, found.exposure_s)
    evidence = (
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
    return (
        f"of {len(found.tries)} exposures of {found.exposure_s:.3g} s, {lit} began after the {found.light} was on and "
        f"{dark} ended before: dim the {found.light} or close the aperture, for exposures longer than switching "
        "takes, and raise latency_tries"
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
