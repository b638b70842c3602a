"""Random angle curves whose optimum is known, shared by the tests and benchmarks of the decision."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from finray_calib.decide.capture_errors import CaptureErrors
from finray_calib.decide.discrepancy import PRIOR_ERROR_LOG_SD, PRIOR_ERROR_REL
from finray_calib.decide.gaussian_process import PRIOR_LENGTH_DEG, Matern52, draw_normal

Floats = NDArray[np.float64]
Family = Literal["model", "tilt", "bump"]

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


def log_discrepancy(family: Family, rng: np.random.Generator) -> Floats:
    """Return ln(simulated / real) on FINE_DEG, apart from a common scale.

    "model" is a draw of the prior of the decision. Its length scale or its shape are wrong for the others: a tilt (sd
    15 % from the middle to the ends), or a bump (sd 20 %) of half-width 15 deg anywhere.
    """
    if family == "model":
        amplitude = PRIOR_ERROR_REL * np.exp(PRIOR_ERROR_LOG_SD * rng.standard_normal())
        return draw_normal(Matern52(PRIOR_LENGTH_DEG, amplitude).covariance(FINE_DEG, FINE_DEG), 1, rng)[0]
    if family == "tilt":
        return np.asarray(0.15 * rng.standard_normal() * (FINE_DEG / 45 - 1))
    center = rng.uniform(0, 90)
    return np.asarray(0.2 * rng.standard_normal() * np.exp(-0.5 * ((FINE_DEG - center) / 15) ** 2))


def honest_captures(
    curve: Floats, log_error: Floats, angles_deg: Floats, rng: np.random.Generator, absolute: bool
) -> CaptureErrors:
    """Return what captures of the real curve tell, with 1 % noise and an angle known to 1 deg, as they state.

    Absolute ratios have a common scale that nobody knows.
    """
    noise_rel, angle_sd_deg = 0.01, 1.0
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
