"""Metering: the longest exposure of a ladder of factor-of-two steps that keeps the brightest pixels in range."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import SaturatedError

Counts = NDArray[np.uint16]
BRIGHTEST_PERCENTILE = 99.9
SATURATED_STEPS_DOWN = 3
# A signal below this share of full scale is mostly noise: it guides the next guess but decides nothing.
TRUSTED_SIGNAL_FRACTION = 0.05


def exposure_ladder(shortest_s: float, longest_s: float) -> tuple[float, ...]:
    """Return the exposures (s) that captures use: the shortest times powers of two, up to the longest.

    Few distinct exposures mean few dark frames.
    """
    rungs = math.floor(math.log2(longest_s / shortest_s) + 1e-9) + 1 if longest_s > shortest_s else 1
    return tuple(shortest_s * 2.0**k for k in range(rungs))


def rung_at_or_below(ladder: tuple[float, ...], exposure_s: float) -> float:
    """Return the longest exposure of the ladder (s) that is not longer than `exposure_s`, at least the first."""
    tolerance = 1.0 + 1e-9  # 0.25 of a rung must find the rung two below despite rounding
    return max((rung for rung in ladder if rung <= exposure_s * tolerance), default=ladder[0])


def brightest_dn(counts: Counts) -> float:
    """Return the 99.9 percentile (DN) of the brightest of the four Bayer sites of a region."""
    sites = [counts[row::2, column::2] for row in (0, 1) for column in (0, 1)]
    return max(float(np.percentile(site, BRIGHTEST_PERCENTILE)) for site in sites)


def saturated_fraction(counts: Counts, full_scale_dn: int) -> float:
    """Return the share of pixels (0..1) at full scale."""
    return float(np.mean(counts >= full_scale_dn))


def meter_exposure(
    take: Callable[[float], Counts],
    ladder: tuple[float, ...],
    full_scale_dn: int,
    black_level_dn: float,
    target_fraction: float,
    what: str,
    first_guess_s: float | None = None,
) -> float:
    """Find the longest exposure of the ladder with which nothing in the metered region is too bright.

    The 99.9 percentile of the brightest Bayer site stays at or below `target_fraction` of full scale, and no
    pixel saturates. The search brackets the answer and predicts the next rung from the signal, which is
    proportional to the exposure.

    Parameters
    ----------
    take
        Takes a frame with an exposure (s) and returns the counts of the metered region (DN), shape (h, w).
    ladder
        Allowed exposures (s), increasing.
    full_scale_dn, black_level_dn
        Largest count and count without light (DN).
    target_fraction
        Largest brightness as a fraction of full scale.
    what
        Filter and light in words, for the message.
    first_guess_s
        Where to start (s), such as the exposure of a similar step; the middle of the ladder if left out.

    Returns
    -------
    float
        Exposure (s), one of the ladder.

    Raises
    ------
    SaturatedError
        Even the shortest exposure is too bright.
    """
    fits, fails = -1, len(ladder)
    guess = len(ladder) // 2 if first_guess_s is None else ladder.index(rung_at_or_below(ladder, first_guess_s))
    while fails - fits > 1:
        rung = min(max(guess, fits + 1), fails - 1)
        counts = take(ladder[rung])
        peak_dn = brightest_dn(counts)
        signal_dn = max(peak_dn - black_level_dn, 1.0)
        rungs_up = math.floor(math.log2((target_fraction * full_scale_dn - black_level_dn) / signal_dn))
        if counts.max() >= full_scale_dn or peak_dn > target_fraction * full_scale_dn:
            fails = rung
            guess = rung - SATURATED_STEPS_DOWN if peak_dn >= full_scale_dn else rung + min(rungs_up, -1)
        else:
            fits = rung
            guess = rung + max(rungs_up, 1)
            if signal_dn >= TRUSTED_SIGNAL_FRACTION * full_scale_dn:
                fails = min(fails, rung + max(rungs_up, 0) + 1)
    if fits < 0:
        raise SaturatedError(
            f"{what}: the region is brighter than {target_fraction:.0%} of full scale ({full_scale_dn} DN) even at the "
            f"shortest exposure; the camera allows {ladder[0]:g} to {ladder[-1]:g} s: dim the light, close the "
            "aperture or raise target_fraction"
        )
    return ladder[fits]
