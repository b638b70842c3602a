"""The uncertainty budget of a comparison: what each input does alone."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.compare import InputUncertainty
from finray_calib.compare.brightness import brightness_draws
from finray_calib.compare.comparison import Comparison
from finray_calib.compare.input_draws import DRIFT, PIXELS, POSE, PRIOR_DRIFT_REL, WALLS, Inputs
from finray_calib.compare.region_draws import propagated_draws

Floats = NDArray[np.float64]
Evaluation = Literal["A", "B"]
ALONE_DRAWS = 4000
"""Draws of one line of the budget; its standard uncertainty is then known to 1 %."""


def uncertainty_budget(
    comparison: Comparison,
    inputs: Inputs,
    ring: NDArray[np.bool_],
    share: Floats,
    capture: TactileCapture,
    rng: np.random.Generator,
) -> tuple[InputUncertainty, ...]:
    """Return one line for each input, the largest first.

    Each input varies alone, the others at their means: for the skill as the captured levels have narrowed it, for the
    objective as it is known before. As the skill is no linear function of the inputs, which the capture has also tied
    to each other, the squares of the lines need not add up to the square of the whole.

    Parameters
    ----------
    comparison, inputs
        Both sides and what is uncertain.
    ring, share
        Pixels and weights of the objective, see :mod:`finray_calib.compare.brightness`.
    capture
        Tells where the uncertainty of the pose comes from.
    rng
        Of the draws.
    """
    origins = _origins(inputs, capture)
    lines = []
    before = inputs.draw(ALONE_DRAWS, rng)
    after = comparison.conditioned(before, rng)
    for name, (evaluation, source) in origins.items():
        noise = rng if name == PIXELS else None
        drawn = after.only(name)
        draws = propagated_draws(comparison.sums[-1], drawn, comparison.exposure_of(drawn.matrix, noise), noise)
        skill = draws.skill("simulation", comparison.channel_weights)
        objective = brightness_draws(comparison, inputs, ring, before.only(name), noise).error_rel(share)
        lines.append(
            InputUncertainty(
                input=name,
                evaluation=evaluation,
                source=source,
                skill_u=float(skill.std(ddof=1)),
                objective_u_rel=float(objective.std(ddof=1)),
            )
        )
    return tuple(sorted(lines, key=lambda line: -line.skill_u))


def _origins(inputs: Inputs, capture: TactileCapture) -> dict[str, tuple[Evaluation, str]]:
    """Return kind and source of every input."""
    known = inputs.layers.inputs
    found: dict[str, tuple[Evaluation, str]] = {}
    if known is not None:
        found |= {n: (e, s) for n, e, s in zip(known.names, known.evaluations, known.sources, strict=True)}
    for name, sd_mm in inputs.pose_sd_mm.items():
        found[POSE[name]] = ("B", f"{sd_mm:g} mm, as {capture.name} states")
    if inputs.walls is not None:
        found[WALLS] = ("A", "difference of the render's independent halves, with a prior")
    if inputs.drift is not None:
        scale, freedom = inputs.drift
        origin = f"{scale:.2%}, from the repeat of the no-contact image" if freedom > 3 else f"{PRIOR_DRIFT_REL:.1%}"
        found[DRIFT] = ("A" if freedom > 3 else "B", f"{origin} and what real sensors show")
    found[PIXELS] = ("A", "difference of both no-contact images at pixel scale, and of the render's halves")
    return found
