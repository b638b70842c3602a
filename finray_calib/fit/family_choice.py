"""Which family of emission curves the bands speak for, and how clearly."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from finray_calib.fit.emission import EmissionPosterior
from finray_calib.fit.leave_one_band_out import BandPrediction

DEFAULT_FAMILY: Final = "log_normal_wavenumber"
"""Predicts the whole spectrum of measured paints best from eight bands (docs/explanation/model-of-the-paint.md)."""

SMALLEST_DEFAULT_PROBABILITY: Final = 0.1
CLEAR_SCORE_SD: Final = 2.0
"""Another family replaces the default only when the evidence and the left-out bands both speak clearly against it."""


@dataclass(frozen=True, slots=True)
class FamilyScore:
    """Scores of one family.

    Attributes
    ----------
    probability
        Of the family given the bands, all families equally likely beforehand.
    left_out
        Leave-one-band-out prediction.
    difference_sd
        Standard error of the difference of the summed score to the default family's, nats; 0 for the default.
    """

    probability: float
    left_out: BandPrediction
    difference_sd: float


def score_families(
    posteriors: Mapping[str, EmissionPosterior], left_out: Mapping[str, BandPrediction]
) -> dict[str, FamilyScore]:
    """Return the scores of families fitted to the same bands.

    The probability is the share of each evidence in the sum of all. The standard error of a difference of summed
    predictive scores over B bands is sqrt(B) times the standard deviation of the differences of the bands.

    Parameters
    ----------
    posteriors
        Posterior of each family, by name.
    left_out
        Leave-one-band-out prediction of each family.

    References
    ----------
    Vehtari, Gelman, Gabry, Statistics and Computing 27 (2017) 1413-1432, section 5.
    """
    ln_evidence = np.array([p.sampling.sample.ln_evidence for p in posteriors.values()])
    share = np.exp(ln_evidence - ln_evidence.max())
    share /= share.sum()
    base = left_out[DEFAULT_FAMILY].ln_density
    scores = {}
    for name, probability in zip(posteriors, share, strict=True):
        apart = (left_out[name].ln_density - base)[np.isfinite(base)]
        error = float(np.sqrt(apart.size) * apart.std(ddof=1)) if apart.size > 1 else 0.0
        scores[name] = FamilyScore(float(probability), left_out[name], error)
    return scores


def choose_family(scores: Mapping[str, FamilyScore]) -> tuple[str, str]:
    """Return the name of the family to report and the sentence that says why and how surely.

    The default family stays unless its probability is below 0.1 and the most probable one predicts left-out bands
    better by two standard errors: eight bands rarely tell families apart, measured paints did.
    """
    best = max(scores, key=lambda name: scores[name].probability)
    gain = scores[best].left_out.total - scores[DEFAULT_FAMILY].left_out.total
    clear = (
        scores[DEFAULT_FAMILY].probability < SMALLEST_DEFAULT_PROBABILITY
        and gain > CLEAR_SCORE_SD * scores[best].difference_sd
    )
    told = ", ".join(f"{name} {score.probability:.2f}" for name, score in scores.items())
    if best == DEFAULT_FAMILY:
        return best, f"{best}: the default, and the most probable given these bands ({told})"
    if clear:
        return best, (
            f"{best}: the bands speak clearly against the default, {DEFAULT_FAMILY} (probabilities {told}; left-out "
            f"bands predicted better by {gain:.1f} +- {scores[best].difference_sd:.1f} nats)"
        )
    return DEFAULT_FAMILY, (
        f"{DEFAULT_FAMILY}: the default, because the bands do not clearly tell the families apart (probabilities "
        f"{told}; left-out bands: {best} {gain:+.1f} +- {scores[best].difference_sd:.1f} nats)"
    )
