"""Blocks of gel on a bench, in closed form: their forces, with what a bench adds to them."""

import math

import numpy as np
from scipy.optimize import minimize_scalar

from finray_calib.force import MeasuredForce

AREA_MM2, HEIGHT_MM = 400.0, 10.0


def energy_mpa(stretch, across, mu_mpa, bulk_mpa, alpha=2.0):
    """Ogden's energy of one term, of the stretches (stretch, across, across)."""
    volume = stretch * across**2
    shape = volume ** (-alpha / 3.0) * (stretch**alpha + 2.0 * across**alpha) - 3.0
    return 2.0 * mu_mpa / alpha**2 * shape + 0.5 * bulk_mpa * (volume - 1.0) ** 2


def force_n(push_mm, mu_mpa, bulk_mpa, plates, alpha=2.0):
    """The derivative of the least energy over the stretch across the push, by the push."""

    def least(stretch):
        if plates == "confined":
            return energy_mpa(stretch, 1.0, mu_mpa, bulk_mpa, alpha)
        found = minimize_scalar(
            lambda across: energy_mpa(stretch, across, mu_mpa, bulk_mpa, alpha),
            bounds=(0.8, 1.6), method="bounded", options={"xatol": 1e-12},
        )  # fmt: skip
        return float(found.fun)

    step = 1e-5
    at = 1.0 - np.maximum(push_mm, 0.0) / HEIGHT_MM
    force = np.array([(least(x - step) - least(x + step)) / (2.0 * step) for x in at]) * AREA_MM2
    return np.where(push_mm > 0.0, force, 0.0)


def measured(rng, c10_mpa, bulk_over_shear, plates, alpha=2.0, points=24):
    """A curve with an unknown first touch, zero, drift, noise, and edges that are a little off."""
    displacement = np.linspace(0.05, 2.6, points)
    mu = 2.0 * c10_mpa
    touch = rng.uniform(0.0, 0.3)
    ideal = force_n(displacement - touch, mu, mu * bulk_over_shear, plates, alpha)
    largest = ideal.max()
    off = math.exp(0.007 * rng.standard_normal())
    drift = largest * (0.005 * rng.standard_normal() + 0.01 * rng.standard_normal() * np.linspace(0.0, 1.0, points))
    noise = 0.004 * largest * rng.standard_normal(points)
    return MeasuredForce(f"{plates}.csv", displacement, off * ideal + drift + noise)
