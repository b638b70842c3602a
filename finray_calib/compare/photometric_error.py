"""How far a simulated press is from a capture: metrics of the noise-free images with what their inputs leave open."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.compare.comparison import Comparison
from finray_calib.compare.input_draws import Drawn, Inputs
from finray_calib.compare.region_draws import CANDIDATES, RegionDraws, propagated_draws, resampled_draws
from finray_calib.compare.stopping_rule import Propagated, propagate

Floats = NDArray[np.float64]
RESAMPLED_DRAWS = 2000

_HEADLINE = "headline"


@dataclass(frozen=True, slots=True)
class RegionResult:
    """Hold the draws of one region and of its gradients."""

    images: RegionDraws
    gradients: RegionDraws | None


@dataclass(frozen=True, slots=True)
class ErrorDraws:
    """Hold the draws of every region.

    Attributes
    ----------
    regions : list of RegionResult
    whole : list of RegionResult or None
        The values over all of each region, where the draws come from parts of it.
    propagated : Propagated or None
        The draws of the inputs, where these have a known uncertainty.
    """

    regions: list[RegionResult]
    whole: list[RegionResult] | None
    propagated: Propagated | None


def error_draws(comparison: Comparison, rng: np.random.Generator) -> ErrorDraws:
    """Propagate the inputs where their uncertainty is known, else resample parts of the regions."""
    if comparison.inputs is None or comparison.layers.inputs is None:
        return ErrorDraws(resampled(comparison, rng), best(comparison), None)
    regions, all_draws = propagated(comparison, comparison.inputs, rng)
    return ErrorDraws(regions, None, all_draws)


def propagated(
    comparison: Comparison, inputs: Inputs, rng: np.random.Generator
) -> tuple[list[RegionResult], Propagated]:
    """Propagate all inputs until the headline skill is stable.

    Returns
    -------
    list of RegionResult
        One for each region.
    Propagated
        The draws behind them, with "exposure" among them, and whether the stopping rule was met.
    """

    def block(draws: int) -> dict[str, Floats]:
        drawn = comparison.conditioned(inputs.draw(draws, rng), rng)
        exposure = comparison.exposure_of(drawn.matrix, rng)
        found = {"exposure": exposure}
        for i, result in enumerate(_results(comparison, drawn, exposure, rng)):
            for part, of_part in (("images", result.images), ("gradients", result.gradients)):
                if of_part is not None:
                    found |= {f"{i} {part} {name}": values for name, values in of_part.error.items()}
                    found[f"{i} {part} level"] = of_part.level
            found[_HEADLINE] = result.images.skill("simulation", comparison.channel_weights)
        return found

    all_draws = propagate(block, _HEADLINE)
    return [_gathered(comparison, all_draws, i) for i in range(len(comparison.regions))], all_draws


def resampled(comparison: Comparison, rng: np.random.Generator) -> list[RegionResult]:
    """Return the regions' draws from parts of themselves, for images of which no input has a known uncertainty."""
    return [
        RegionResult(
            resampled_draws(sums, RESAMPLED_DRAWS, rng),
            None if gradients is None else resampled_draws(gradients, RESAMPLED_DRAWS, rng),
        )
        for sums, gradients in zip(comparison.sums, comparison.gradients, strict=True)
    ]


def best(comparison: Comparison) -> list[RegionResult]:
    """Return the regions at the best values of all inputs, as a single draw."""
    inputs = comparison.inputs or Inputs(comparison.layers, {}, None, None)
    drawn = inputs.best()
    return _results(comparison, drawn, comparison.exposure_of(drawn.matrix), None)


def _results(
    comparison: Comparison, drawn: Drawn, exposure: Floats, rng: np.random.Generator | None
) -> list[RegionResult]:
    """Return the draws of all regions; noise of the pixels varies where there is a generator."""
    return [
        RegionResult(
            propagated_draws(sums, drawn, exposure, rng),
            None if gradients is None else propagated_draws(gradients, drawn, exposure, rng),
        )
        for sums, gradients in zip(comparison.sums, comparison.gradients, strict=True)
    ]


def _gathered(comparison: Comparison, all_draws: Propagated, i: int) -> RegionResult:
    """Return the draws of region `i` from all blocks."""
    found: dict[str, RegionDraws] = {}
    for part, sums in (("images", comparison.sums[i]), ("gradients", comparison.gradients[i])):
        if sums is not None:
            errors = {
                name: all_draws.draws[f"{i} {part} {name}"]
                for name in CANDIDATES
                if f"{i} {part} {name}" in all_draws.draws
            }
            found[part] = RegionDraws(errors, all_draws.draws[f"{i} {part} level"], sums.pixels)
    return RegionResult(found["images"], found.get("gradients"))
