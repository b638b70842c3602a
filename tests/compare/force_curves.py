"""Presses whose force is a power of the push, F = a d^1.5, and of every input."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, PressMechanics, PressSensitivities, VariedPress
from finray_calib.force import MeasuredForce

Floats = NDArray[np.float64]

FORCE_AT_1_MM_N = 1.6
EXPONENT = 1.5
INCREMENTS_MM = np.array([0.5, 1.0, 1.5, 2.0])
CHANGE_REL = 0.1
DEEPEST_MM = 1.8  # what an error takes up as an offset must stay on the press
# d ln F / d ln x of each input, and its standard uncertainty
POWERS = {"mechanics.gel.c10_mpa": 0.7, "mechanics.skeleton.mu_mpa": 0.3, "pad.thickness_mm": -0.4}
U_REL = {"mechanics.gel.c10_mpa": 0.15, "mechanics.skeleton.mu_mpa": 0.2, "pad.thickness_mm": 0.05}


def force_at(depth_mm: Floats, factor: float = 1.0) -> Floats:
    """Return a d^1.5 in N; 0 above the pad."""
    return factor * FORCE_AT_1_MM_N * np.maximum(depth_mm, 0.0) ** EXPONENT


def power_law_press(powers: Mapping[str, float] = POWERS, u_rel: Mapping[str, float] = U_REL) -> PressMechanics:
    """Return the press; its force is the product of its inputs to these powers times d^1.5."""
    varied = tuple(
        VariedPress(
            field=field,
            change_rel=CHANGE_REL,
            depth_mm=INCREMENTS_MM,
            force_n=force_at(INCREMENTS_MM, (1.0 + CHANGE_REL) ** power),
        )
        for field, power in powers.items()
    )
    force = force_at(INCREMENTS_MM)
    return PressMechanics(
        name="power law, push of 2 mm",
        label="closed form",
        preset="coarse",
        depth_mm=INCREMENTS_MM,
        force_n=np.outer(force, [0.0, 1.0, 0.0]),
        energy_n_mm=force * INCREMENTS_MM / (EXPONENT + 1.0),
        iterations=np.ones(len(force), np.int64),
        largest_pressure_mpa=0.1,
        unreached="",
        design=FingerDesign(uncertainty_rel=dict(u_rel)),
        sensitivities=PressSensitivities(preset="coarse", depth_mm=INCREMENTS_MM, force_n=force, varied=varied)
        if varied
        else None,
    )


def measure(
    rng: np.random.Generator,
    offset_mm: float,
    model_error_rel: float,
    noise_n: float,
    factor: float = 1.0,
    points: int = 40,
) -> MeasuredForce:
    """Return what a bench would read of a finger whose force is `factor` d^1.5 and a bend that no input explains."""
    displacement = np.linspace(0.0, DEEPEST_MM, points) + offset_mm
    depth = displacement - offset_mm
    true = true_force(depth, model_error_rel, factor)
    return MeasuredForce(
        "bench.csv", displacement, true + noise_n * rng.standard_normal(points), np.full(points, noise_n)
    )


def true_force(depth_mm: Floats, model_error_rel: float, factor: float = 1.0) -> Floats:
    """Return the force of a finger that stiffens by d^(1 + model error) more than the model."""
    return force_at(depth_mm, factor) * (1.0 + model_error_rel * (2.0 * depth_mm - 2.0))
