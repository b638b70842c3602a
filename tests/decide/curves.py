"""Random angle curves whose optimum is known, shared by the tests and benchmarks of the decision."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from finray_calib.decide._capture_errors import CaptureErrors
from finray_calib.decide._gaussian_process import draw_normal, matern_correlation
from finray_calib.decide._sim_to_real import (
    MOVED_SD_DEG,
    PRIOR_ERROR_LENGTH_DEG,
    PRIOR_ERROR_LENGTH_LOG_SD,
    PRIOR_ERROR_LOG_SD,
    PRIOR_ERROR_REL,
    PROPORTIONAL_PROBABILITY,
    USUAL_CONTRAST,
    edges_and_glints,
)

Floats = NDArray[np.float64]
Family = Literal["model", "tilt", "bump"]
Pair = tuple[NDArray[np.float64], NDArray[np.float64]]

FINE_DEG = np.arange(0, 91.0)
SWEEP_DEG = np.arange(0, 91.0, 10)
PEDESTAL = 0.5
"""Of the curve beside its hill of height 1: keeps noisy values positive."""


def random_curve(rng: np.random.Generator) -> Floats:
    """Return an asymmetric positive curve on FINE_DEG with its peak between 15 and 60 deg, with a small ripple."""
    center, width, skew = rng.uniform(15, 60), rng.uniform(18, 45), rng.uniform(-0.6, 0.6)
    x = (FINE_DEG - center) / width
    curve = np.exp(-0.5 * (x / (1 + skew * np.tanh(x))) ** 2)
    curve += 0.03 * rng.standard_normal() * np.sin(FINE_DEG / rng.uniform(8, 14) + rng.uniform(0, 6))
    return np.asarray(PEDESTAL + curve / curve.max())


def sweep(curve: Floats, rng: np.random.Generator, noise: float, repeats: int, scale: float = 0.0) -> Floats:
    """Return values (A, R): the curve times a scale per repeat, with own noise relative to the curve's maximum."""
    own = noise * curve.max() * rng.standard_normal((len(SWEEP_DEG), repeats))
    return np.asarray((curve[:: int(SWEEP_DEG[1])][:, None] + own) * (1 + scale * rng.standard_normal(repeats)))


def regret_of(curve: Floats, angle_deg: float) -> float:
    """Return the relative loss of an angle against the curve's maximum."""
    return float(1 - np.interp(angle_deg, FINE_DEG, curve) / curve.max())


def log_discrepancy(family: Family, rng: np.random.Generator, simulated: Floats) -> Floats:
    """Return ln(simulated / real) on FINE_DEG, apart from a common scale.

    "model" is a draw of the whole prior of the decision. Its shape is wrong for the others: a tilt (sd
    15 % from the middle to the ends), or a bump (sd 20 %) of half-width 15 deg anywhere.
    """
    if family == "model":
        contrast = min(float(np.log(simulated).std()) / USUAL_CONTRAST, 1.0)
        size = contrast if rng.random() < PROPORTIONAL_PROBABILITY else 1.0
        amplitude = size * PRIOR_ERROR_REL * np.exp(PRIOR_ERROR_LOG_SD * rng.standard_normal())
        length_deg = PRIOR_ERROR_LENGTH_DEG * np.exp(PRIOR_ERROR_LENGTH_LOG_SD * rng.standard_normal())
        correlation = matern_correlation(FINE_DEG, FINE_DEG, length_deg, rng.choice([0.5, 1.5, 2.5]))
        shape = draw_normal(amplitude**2 * correlation, 1, rng)[0]
        shape += size * edges_and_glints(FINE_DEG, 1, FINE_DEG, rng)[0]
        moved = np.interp(FINE_DEG + MOVED_SD_DEG * rng.standard_normal(), FINE_DEG, simulated)
        return np.asarray(shape + np.log(simulated / moved))
    if family == "tilt":
        return np.asarray(0.15 * rng.standard_normal() * (FINE_DEG / 45 - 1))
    center = rng.uniform(0, 90)
    return np.asarray(0.2 * rng.standard_normal() * np.exp(-0.5 * ((FINE_DEG - center) / 15) ** 2))


def honest_captures(
    curve: Floats,
    log_error: Floats,
    angles_deg: Floats,
    rng: np.random.Generator,
    absolute: bool,
    noise_rel: float = 0.01,
    angle_sd_deg: float = 1.0,
) -> CaptureErrors:
    """Return what captures of the real curve tell, with noise and an angle known so well as they state.

    Absolute ratios have a common scale that nobody knows.
    """
    angles = np.asarray(angles_deg, dtype=np.float64)
    true_deg = angles + angle_sd_deg * rng.standard_normal(angles.size)
    real = curve * np.exp(-log_error)
    error = np.log(np.interp(angles, FINE_DEG, curve) / np.interp(true_deg, FINE_DEG, real))
    error += noise_rel * rng.standard_normal(angles.size) + (3 * rng.standard_normal() if absolute else 0.0)
    return CaptureErrors(
        tuple(f"capture at {angle:g} deg" for angle in angles),
        angles,
        np.full(angles.size, angle_sd_deg),
        error,
        noise_rel**2 * np.eye(angles.size),
        np.zeros(angles.size, dtype=np.int64) if absolute else None,
    )


def shadow_edge(rng: np.random.Generator) -> Pair:
    """A broad lobe behind an edge: beyond some angle a part of the light is shadowed, in the finger elsewhere."""
    simulated, real = (np.cos(np.radians(FINE_DEG - top)) ** 2 for top in rng.uniform(20, 60) + rng.normal(0, 5, 2))
    at_deg, width_deg, depth = rng.uniform(15, 80), rng.uniform(2, 8), rng.uniform(0.1, 0.5)
    moved_deg, other_depth = at_deg + rng.normal(0, 6), np.clip(depth + rng.normal(0, 0.1), 0, 0.9)
    return (
        (0.2 + simulated) * (1 - depth / (1 + np.exp(-(FINE_DEG - at_deg) / width_deg))),
        (0.2 + real) * (1 - other_depth / (1 + np.exp(-(FINE_DEG - moved_deg) / width_deg))),
    )


def triangle(rng: np.random.Generator) -> Pair:
    """Two straight slopes that meet in a kink, which the finger has some degrees elsewhere."""
    top_deg, rise, fall = rng.uniform(15, 75), *rng.uniform(0.003, 0.012, 2)

    def curve(at_deg: float) -> Floats:
        return np.maximum(1 - np.where(at_deg > FINE_DEG, rise * (at_deg - FINE_DEG), fall * (FINE_DEG - at_deg)), 0.05)

    return curve(top_deg), curve(top_deg + rng.normal(0, 4))


def plateau(rng: np.random.Generator) -> Pair:
    """A lobe cut off flat, whose top leans in the finger."""
    top_deg, cut = rng.uniform(20, 60), rng.uniform(0.75, 0.95)
    curve = 0.2 + np.minimum(np.cos(np.radians(FINE_DEG - top_deg)) ** 2, cut)
    return curve, curve * (1 + rng.normal(0, 0.08) * (FINE_DEG - top_deg) / 60)


def glint(rng: np.random.Generator) -> Pair:
    """A lobe on which the finger has a narrow reflection, or a narrow shadow, that the simulation does not know."""
    top_deg = rng.uniform(15, 60)
    curve = 0.2 + np.cos(np.radians(FINE_DEG - top_deg)) ** rng.uniform(1, 6)
    at_deg, width_deg = top_deg + rng.normal(0, 25), rng.uniform(3, 9)
    size = rng.uniform(0.03, 0.25) * rng.choice([1, 1, -1])
    return curve, curve * (1 + size * np.exp(-0.5 * ((FINE_DEG - at_deg) / width_deg) ** 2))


def near_flat(rng: np.random.Generator) -> Pair:
    """A curve that hardly depends on the angle, and an error of some waves that is about as small."""
    curve = 1 + rng.uniform(0.01, 0.05) * np.cos(np.radians(FINE_DEG - rng.uniform(0, 90))) ** 2
    return curve, curve * np.exp(_waves(rng, rng.uniform(0.005, 0.02)))


def jagged(rng: np.random.Generator) -> Pair:
    """A lobe on which four reflections come and go in the finger, each within 2 deg."""
    curve = 0.2 + np.cos(np.radians(FINE_DEG - rng.uniform(15, 60))) ** rng.uniform(1, 6)
    steps = sum(
        size * np.tanh((FINE_DEG - at_deg) / 1.5) / 2
        for at_deg, size in zip(rng.uniform(0, 90, 4), 0.1 * rng.standard_normal(4), strict=True)
    )
    return curve, curve * np.exp(steps)


def wandering(rng: np.random.Generator) -> Pair:
    """A lobe, and an error of three waves of 50 to 240 deg, 3 to 15 %."""
    curve = 0.2 + np.cos(np.radians(FINE_DEG - rng.uniform(15, 60))) ** rng.uniform(1, 6)
    return curve, curve * np.exp(_waves(rng, rng.uniform(0.03, 0.15)))


def _waves(rng: np.random.Generator, size: float) -> Floats:
    """A few sines of random length and phase: smooth, but no Gaussian process."""
    return np.asarray(
        sum(
            size * np.sqrt(2 / 3) * rng.standard_normal() * np.sin(2 * np.pi * FINE_DEG / length + phase)
            for length, phase in zip(rng.uniform(50, 240, 3), rng.uniform(0, 6.3, 3), strict=True)
        )
    )


SWEPT = np.array(
    [
        [0.592, 0.698, 0.795, 0.870, 0.930, 0.977, 1.000, 0.994, 0.959, 0.898],
        [0.680, 0.793, 0.879, 0.937, 0.979, 1.000, 1.000, 0.974, 0.922, 0.846],
        [0.806, 0.893, 0.960, 0.994, 1.000, 0.996, 0.972, 0.924, 0.851, 0.756],
        [0.876, 0.944, 0.987, 1.000, 0.991, 0.959, 0.916, 0.855, 0.773, 0.670],
        [0.924, 0.973, 1.000, 0.995, 0.963, 0.910, 0.854, 0.784, 0.696, 0.590],
        [0.956, 0.994, 1.000, 0.976, 0.929, 0.862, 0.776, 0.699, 0.614, 0.509],
        [0.970, 1.000, 0.991, 0.956, 0.899, 0.816, 0.715, 0.628, 0.540, 0.442],
        [0.975, 1.000, 0.990, 0.950, 0.879, 0.796, 0.688, 0.578, 0.495, 0.401],
        [0.985, 1.000, 0.989, 0.929, 0.860, 0.763, 0.663, 0.541, 0.457, 0.365],
        [0.990, 1.000, 0.984, 0.941, 0.868, 0.776, 0.659, 0.539, 0.437, 0.349],
        [0.983, 1.000, 0.974, 0.917, 0.848, 0.749, 0.634, 0.509, 0.400, 0.319],
        [1.000, 0.996, 0.989, 0.940, 0.872, 0.765, 0.653, 0.537, 0.402, 0.321],
        [0.989, 1.000, 0.986, 0.933, 0.857, 0.761, 0.653, 0.530, 0.394, 0.299],
        [0.984, 1.000, 0.973, 0.925, 0.853, 0.756, 0.635, 0.515, 0.377, 0.279],
        [0.992, 1.000, 0.983, 0.932, 0.870, 0.772, 0.640, 0.513, 0.383, 0.279],
    ]
)
"""Brightness beside a cylinder every 4 mm from 8 to 64 mm of flat-70x35, at 0, 10, ... 90 deg: `finray simulate`."""


def swept(rng: np.random.Generator) -> Pair:
    """Simulated as swept at one place of the finger; real as at a neighbouring one, or on the way to it."""
    place = rng.integers(len(SWEPT) - 1)
    first, second = (place, place + 1) if rng.random() < 0.5 else (place + 1, place)
    here, there = (PchipInterpolator(SWEEP_DEG, SWEPT[k])(FINE_DEG) for k in (first, second))
    share = rng.uniform(0.2, 1)
    return here, (1 - share) * here + share * there


def shares(rng: np.random.Generator) -> Pair:
    """Light by three ways (straight, by a mirror, diffuse), whose weights and widths the simulation has wrong."""
    tops_deg, powers = np.array([rng.uniform(0, 50), rng.uniform(40, 90)]), rng.uniform(2, 10, 2)
    weights = np.array([1.0, rng.uniform(0.2, 0.8), rng.uniform(0.1, 0.5)])

    def curve(weights: Floats, powers: Floats) -> Floats:
        lobes = np.clip(np.cos(np.radians(FINE_DEG - tops_deg[:, None])), 0, None) ** powers[:, None]
        return np.asarray(weights[:2] @ lobes + weights[2])

    others = np.exp(0.15 * rng.standard_normal(3)), np.exp(0.2 * rng.standard_normal(2))
    return curve(weights, powers), curve(weights * others[0], powers * others[1])


def refracted(rng: np.random.Generator) -> Pair:
    """A panel before a clear layer, by distance and Fresnel's transmittance; posture and index are a little wrong."""

    def curve(tilt_deg: float, index: float, across: float, along: float, floor: float) -> Floats:
        angle = np.radians(FINE_DEG)
        distance_sq = (np.cos(angle) - along) ** 2 + (np.sin(angle) + across) ** 2
        incident = np.radians(np.clip(np.abs(FINE_DEG - tilt_deg), 0, 89.9))
        inside = np.arcsin(np.sin(incident) / index)
        ratio_s = (np.cos(incident) - index * np.cos(inside)) / (np.cos(incident) + index * np.cos(inside))
        ratio_p = (index * np.cos(incident) - np.cos(inside)) / (index * np.cos(incident) + np.cos(inside))
        passed = 1 - (ratio_s**2 + ratio_p**2) / 2
        return np.asarray(floor + passed * np.cos(incident) / distance_sq)

    posture = np.array(
        [rng.uniform(20, 70), rng.uniform(1.4, 1.5), rng.uniform(-0.2, 0.2), rng.uniform(-0.4, 0.4), 0.1]
    )
    return curve(*posture), curve(*(posture + np.array([3.0, 0.03, 0.03, 0.05, 0.02]) * rng.standard_normal(5)))


def two_tops(rng: np.random.Generator) -> Pair:
    """Two tops of nearly the same height, which in the finger are a few percent higher or lower each."""
    tops_deg, widths_deg = (rng.uniform(8, 35), rng.uniform(50, 82)), rng.uniform(8, 20, 2)
    heights = 1 + np.array([0.0, rng.uniform(-0.08, 0.08)])
    hills = np.exp(-0.5 * ((FINE_DEG - np.array(tops_deg)[:, None]) / widths_deg[:, None]) ** 2)
    return 0.5 + heights @ hills, 0.5 + (heights * np.exp(0.05 * rng.standard_normal(2))) @ hills


FOREIGN = (shadow_edge, triangle, plateau, glint, near_flat, jagged, wandering, swept)
"""Simulated and real curves that no Gaussian process drew: with kinks, edges, flat tops and narrow peaks."""

UNSEEN = (shares, refracted, two_tops)
"""The same, by formulas of light: no constant of the prior was chosen by them."""


def occluded(rng: np.random.Generator) -> Pair:
    """A lobe, and an edge that hides the panel along a straight line; in the finger it stands elsewhere."""
    top_deg, at_deg, width_deg, depth = (
        rng.uniform(10, 70),
        rng.uniform(20, 80),
        rng.uniform(6, 20),
        rng.uniform(0.2, 0.7),
    )
    side = rng.choice([-1, 1])

    def curve(at_deg: float, width_deg: float, depth: float) -> Floats:
        hidden = depth * np.clip(0.5 + side * (FINE_DEG - at_deg) / width_deg, 0, 1)
        return np.asarray((0.15 + np.cos(np.radians(FINE_DEG - top_deg)) ** 2) * (1 - hidden))

    other_depth = np.clip(depth + rng.normal(0, 0.08), 0, 0.9)
    moved_deg, other_width_deg = at_deg + rng.normal(0, 5), width_deg * np.exp(rng.normal(0, 0.2))
    return curve(at_deg, width_deg, depth), curve(moved_deg, other_width_deg, other_depth)


def sawtooth(rng: np.random.Generator) -> Pair:
    """Teeth of 18 to 40 deg on a slope, which the finger has some degrees elsewhere and of another height."""
    period_deg, height, slope = rng.uniform(18, 40), rng.uniform(0.03, 0.2), rng.normal(0, 0.15)
    first_deg = rng.uniform(0, period_deg)

    def curve(first_deg: float, height: float, slope: float) -> Floats:
        teeth = ((FINE_DEG + first_deg) / period_deg) % 1 - 0.5
        return np.asarray(1 + slope * (FINE_DEG - 45) / 45 + height * teeth)

    other = first_deg + rng.normal(0, 3), height * np.exp(rng.normal(0, 0.2)), slope + rng.normal(0, 0.03)
    return curve(first_deg, height, slope), curve(*other)


def stepped_plateau(rng: np.random.Generator) -> Pair:
    """A flat top with a step of some percent on it, which the finger has elsewhere and of another height."""
    low_deg, high_deg = np.sort(rng.uniform(10, 80, 2))
    high_deg = max(high_deg, low_deg + 20)
    flanks = 0.2 + 1 / ((1 + np.exp(-(FINE_DEG - low_deg) / 3)) * (1 + np.exp((FINE_DEG - high_deg) / 3)))
    at_deg, step = rng.uniform(low_deg, high_deg), rng.normal(0, 0.04)
    moved_deg, other_step = at_deg + rng.normal(0, 6), step + rng.normal(0, 0.03)
    return flanks * (1 + step * (at_deg < FINE_DEG)), flanks * (1 + other_step * (moved_deg < FINE_DEG))


def small_bump(rng: np.random.Generator) -> Pair:
    """Flat but for a bump of 1 to 6 %, 4 to 10 deg wide, which the finger has some degrees elsewhere."""
    at_deg, width_deg, height = rng.uniform(5, 85), rng.uniform(4, 10), rng.uniform(0.01, 0.06)

    def curve(at_deg: float, height: float) -> Floats:
        return np.asarray(1 + height * np.exp(-0.5 * ((FINE_DEG - at_deg) / width_deg) ** 2))

    return curve(at_deg, height), curve(at_deg + rng.normal(0, 6), height * np.exp(rng.normal(0, 0.4)))


def cusp(rng: np.random.Generator) -> Pair:
    """A top where the slope is infinite, most of which lies between two angles of the sweep."""
    top_deg, falls = rng.uniform(15, 75), rng.uniform(0.2, 0.6, 2)

    def curve(top_deg: float, falls: Floats) -> Floats:
        fall = np.where(top_deg > FINE_DEG, falls[0], falls[1])
        return np.maximum(1 - fall * np.sqrt(np.abs(FINE_DEG - top_deg) / 60), 0.05)

    return curve(top_deg, falls), curve(top_deg + rng.normal(0, 3), falls * np.exp(rng.normal(0, 0.1, 2)))


AUDIT = (occluded, sawtooth, stepped_plateau, small_bump, cusp)
"""Sharper curves, written after the prior was fixed; claims are known to fail on the last."""


def _lobe(rng: np.random.Generator) -> Floats:
    return np.asarray(0.2 + np.cos(np.radians(FINE_DEG - rng.uniform(15, 60))) ** rng.uniform(1, 6))


def moved(rng: np.random.Generator) -> Pair:
    """Moved by 4 deg, as triangles are."""
    curve = _lobe(rng)
    return curve, np.interp(FINE_DEG + rng.normal(0, 4), FINE_DEG, curve)


def leaning(rng: np.random.Generator) -> Pair:
    """Leaning by 8 % over 60 deg, as plateaus do."""
    curve = _lobe(rng)
    return curve, curve * (1 + rng.normal(0, 0.08) * (FINE_DEG - 45) / 60)


def rippled(rng: np.random.Generator) -> Pair:
    """With waves of 0.5 to 2 %, as near-flat curves have."""
    curve = _lobe(rng)
    return curve, curve * np.exp(_waves(rng, rng.uniform(0.005, 0.02)))


def compressed(rng: np.random.Generator) -> Pair:
    """By a camera whose response is a power of about 1, with up to 10 % of stray light: the best angle stays."""
    curve = _lobe(rng)
    return curve, (curve + rng.uniform(0, 0.1)) ** np.exp(0.1 * rng.standard_normal())


LOBE_ERRORS = (moved, leaning, rippled, compressed, glint, jagged, wandering)
"""Errors of one simulated curve, of which a claim without captures cannot know which one the finger has."""
