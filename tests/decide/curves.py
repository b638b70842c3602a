"""Random angle curves whose optimum is known, shared by the tests of this folder."""

import numpy as np

FINE_DEG = np.arange(0, 91.0)
SWEEP_DEG = np.arange(0, 91.0, 10)


def random_curve(rng):
    """Return an asymmetric positive curve on FINE_DEG with its peak between 15 and 60 deg, with a small ripple."""
    center, width, skew = rng.uniform(15, 60), rng.uniform(18, 45), rng.uniform(-0.6, 0.6)
    x = (FINE_DEG - center) / width
    curve = np.exp(-0.5 * (x / (1 + skew * np.tanh(x))) ** 2)
    curve += 0.03 * rng.standard_normal() * np.sin(FINE_DEG / rng.uniform(8, 14) + rng.uniform(0, 6))
    return 0.5 + curve / curve.max()


def sweep(curve, rng, noise, repeats, scale=0.0):
    """Return values (A, R): the curve times a scale per repeat, with own noise relative to the curve's maximum."""
    own = noise * curve.max() * rng.standard_normal((len(SWEEP_DEG), repeats))
    return (curve[:: int(SWEEP_DEG[1])][:, None] + own) * (1 + scale * rng.standard_normal(repeats))


def regret_of(curve, angle_deg):
    """Return the relative loss of an angle against the curve's maximum."""
    return float(1 - np.interp(angle_deg, FINE_DEG, curve) / curve.max())
