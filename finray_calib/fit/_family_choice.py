r"""All families of emission curves fitted to the same bands, which one the bands speak for, and how clearly.

A family is judged by how well it predicts each band from the others,

.. math:: p(y_b | y_{-b}) = \left[ E_{\theta|y}\, \frac{1}{p(y_b | y_{-b}, \theta)} \right]^{-1}

Without a band the posterior is wider, so posterior draws are the wrong sample for it: the draws of the proposal, whose
tails are heavier, are weighted anew for each band instead. Given theta the bands are jointly normal, and the
conditional density follows from the inverse covariance. A leak of the band's own that is sampled is known from that
band alone: it is integrated over its prior again. The excitation band has no score: it measures the reflectance at the
laser, which no other band predicts and no family of emission curves describes.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit._band_data import BandData
from finray_calib.fit._emission import FEWEST_DRAWS, EmissionPosterior, FitSettings, fit_emission
from finray_calib.fit._importance import WeightedSample, log_sum_exp, smooth_weights
from finray_calib.fit._likelihood import LogPosterior
from finray_calib.fit._measured_spectra import MeasuredSpectra
from finray_calib.fit._prior import NO_DISCREPANCY, PAINT_DISCREPANCY, Discrepancy, EmissionPrior
from finray_calib.spectra import FAMILIES, machine_threads, skew_shape_table


@dataclass(frozen=True, slots=True)
class FitOptions:
    """What to fit and how.

    Attributes
    ----------
    family
        Name of the family to report; None lets the bands choose, see :mod:`finray_calib.fit._family_choice`.
    discrepancy
        How far the paint may leave the family.
    prior
        Prior of the quantities common to all families.
    settings
        Size of the sampling.
    check_by_emcee
        Whether to sample the reported posterior again with emcee, as an independent check.
    spectra
        Learned prior of the spectrum that is reported where no family is asked for; None takes the one shipped.
    """

    family: str | None = None
    discrepancy: Discrepancy = PAINT_DISCREPANCY
    prior: EmissionPrior = field(default_factory=EmissionPrior)
    settings: FitSettings = field(default_factory=FitSettings)
    check_by_emcee: bool = False
    spectra: MeasuredSpectra | None = None


FloatArray = NDArray[np.float64]

_DRAWS: Final = 2000
_NODES, _NODE_WEIGHTS = np.polynomial.hermite_e.hermegauss(12)
_PEAK_STEPS: Final = 12  # of at most one prior standard deviation


@dataclass(frozen=True, slots=True)
class BandPrediction:
    """Predictive scores of the left-out bands.

    Attributes
    ----------
    ln_density
        (B,) ln p(y_b | y_-b), nats; NaN for the excitation band and where no channel is usable. Higher is better.
    pareto_k
        (B,) diagnostic of the weights without the band; above 0.7 the band decides the fit and its score is only
        indicative.
    """

    ln_density: FloatArray
    pareto_k: FloatArray

    @property
    def total(self) -> float:
        """Sum over the bands, nats."""
        return float(np.nansum(self.ln_density))


def leave_one_band_out(log_posterior: LogPosterior, sample: WeightedSample) -> BandPrediction:
    """Return the leave-one-band-out predictive score of each band.

    Valid with a discrepancy. Without one a band can decide the fit, and its score came out up to 3 nats too high even
    where the diagnostic of the weights was small.

    Parameters
    ----------
    log_posterior
        Data, family and discrepancy.
    sample
        Weighted draws of the posterior, from a proposal with heavier tails.

    References
    ----------
    Burkner, Gabry, Vehtari, Efficient leave-one-out cross-validation for Bayesian non-factorized normal and Student-t
    models, Computational Statistics 36 (2021) 1243-1261.
    """
    p = log_posterior.problem
    kept = np.flatnonzero(sample.weight > 0)[:_DRAWS]
    theta, ln_weight = sample.theta[kept], np.log(sample.weight[kept])
    precision, predicted = log_posterior.precisions(theta), log_posterior.predict_usable(theta)
    pull = np.einsum("nij,nj->ni", precision, p.y - predicted)
    bands = log_posterior.data.weights.bands
    score, k = np.full(bands, np.nan), np.full(bands, np.nan)
    excitation = log_posterior.data.weights.band_index[np.argmax(log_posterior.data.weights.is_excitation)]
    for band in np.setdiff1d(p.band, excitation):
        rows = np.flatnonzero(p.band == band)
        own = precision[:, rows][:, :, rows]
        error = np.linalg.solve(own, pull[:, rows, None])[..., 0]
        quadratic = np.einsum("ni,nij,nj->n", error, own, error)
        if band in log_posterior.own_leaks:
            quadratic = _without_own_leak(log_posterior, theta, rows, predicted[:, rows], error, own)
        ln_p = 0.5 * (np.linalg.slogdet(own)[1] - quadratic - rows.size * np.log(2 * np.pi))
        smoothed = smooth_weights(ln_weight - ln_p)
        top = float(ln_p.max())
        score[band] = float(np.log(smoothed.weight @ np.exp(ln_p - top))) + top
        k[band] = smoothed.pareto_k
    return BandPrediction(score, k)


def _without_own_leak(
    log_posterior: LogPosterior,
    theta: FloatArray,
    rows: NDArray[np.int64],
    predicted: FloatArray,
    error: FloatArray,
    precision: FloatArray,
) -> FloatArray:
    r"""Return -2 ln of the mean of exp(-e^T P e / 2) over the prior of the band's own leak, (n,).

    With the leak x the prediction moves as g = (x - 1) / (1 + (x - 1) w), of which it is a linear function. By
    Gauss-Hermite nodes around the peak in z = ln(x / common) / sd.
    """
    p = log_posterior.problem
    own = p.rows[rows]
    column, sd, white = own["leak_at"][0], own["leak_sd"][0], own["leaked_white"]
    common, drawn = np.exp(theta[:, p.shapes + 1]), theta[:, column]

    def opened(z: FloatArray) -> tuple[FloatArray, FloatArray]:
        leak = (common * np.exp(sd * z))[:, None]
        below = 1 + (leak - 1) * white
        return (leak - 1) / below, sd * leak / below**2

    beside = theta.copy()
    beside[:, column] += 1.0
    change = log_posterior.predict_usable(beside)[:, rows] - predicted
    start = opened(drawn)[0]
    slope = change / (opened(drawn + 1.0)[0] - start)
    peak = drawn.copy()
    for _ in range(_PEAK_STEPS):
        now, rate = opened(peak)
        pull = np.einsum("ni,nij->nj", slope * rate, precision)
        curvature = 1 + np.einsum("nj,nj->n", pull, slope * rate)
        downhill = np.einsum("nj,nj->n", pull, error - slope * (now - start)) - peak
        peak = peak + np.clip(downhill / curvature, -1.0, 1.0)
    terms = []
    for node, weight in zip(_NODES, _NODE_WEIGHTS, strict=True):
        z = peak + node / np.sqrt(curvature)
        left = error - slope * (opened(z)[0] - start)
        terms.append(np.log(weight) + 0.5 * (node**2 - z**2 - np.einsum("ni,nij,nj->n", left, precision, left)))
    return np.asarray(np.log(2 * np.pi * curvature) - 2 * log_sum_exp(np.array(terms)))


DEFAULT_FAMILY: Final = "log_normal_wavenumber"
"""Predicts the whole spectrum of measured paints best from eight bands (docs/explanation/model-of-the-paint.md)."""

SMALLEST_DEFAULT_PROBABILITY: Final = 0.1
CLEAR_SCORE_SD: Final = 2.0
"""Another family replaces the default only when the evidence and the left-out bands both clearly contradict it."""

RULED_OUT_PROBABILITY: Final = 1e-4
"""Below it the evidence alone decides: priors of four numbers twice as wide change a probability by a factor of 16."""


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
    better by two standard errors: eight bands rarely tell families apart, measured paints did. A default that is ruled
    out does not stay: where nothing fits, left-out bands scatter too much to say so.
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
    against = gain < -CLEAR_SCORE_SD * scores[best].difference_sd
    if scores[DEFAULT_FAMILY].probability < RULED_OUT_PROBABILITY and not clear and not against:
        return best, (
            f"{best}: the bands rule out the default, {DEFAULT_FAMILY} (probabilities {told}; log score of left-out "
            f"bands {gain:+.1f} +- {scores[best].difference_sd:.1f} nats)"
        )
    if clear:
        return best, (
            f"{best}: the bands clearly contradict the default, {DEFAULT_FAMILY} (probabilities {told}; {best} "
            f"predicts left-out bands better by {gain:.1f} +- {scores[best].difference_sd:.1f} nats of log score)"
        )
    left_out = f"log score of left-out bands: {best} {gain:+.1f} +- {scores[best].difference_sd:.1f} nats"
    if scores[DEFAULT_FAMILY].probability < SMALLEST_DEFAULT_PROBABILITY:
        return DEFAULT_FAMILY, (
            f"{DEFAULT_FAMILY}: the default is kept although the bands make it improbable (probabilities {told}), "
            f"because {best} does not predict left-out bands clearly better ({left_out})"
        )
    return DEFAULT_FAMILY, (
        f"{DEFAULT_FAMILY}: the default, because the bands do not clearly distinguish the families (probabilities "
        f"{told}; {left_out})"
    )


_GOOD_EFFECTIVE_SHARE_OF_OTHERS: Final = 0.3  # a little above what is trusted: adapting costs more than draws


@dataclass(frozen=True, slots=True)
class FamilyFits:
    """All families, the one that is reported, and why.

    Attributes
    ----------
    posteriors
        Of each family with its discrepancy.
    alone
        Of the one family that was also fitted without discrepancy.
    scores
        Of each family.
    chosen, why
        Name of the family to report, and the sentence that says why.
    posterior
        Of the family to report, with all draws.
    """

    posteriors: dict[str, EmissionPosterior]
    alone: EmissionPosterior
    scores: dict[str, FamilyScore]
    chosen: str
    why: str
    posterior: EmissionPosterior


def fit_families(data: BandData, options: FitOptions, alone: str, rng: np.random.Generator) -> FamilyFits:
    """Fit all families and return them with the one to report: the requested one, or the best by the rule.

    Parameters
    ----------
    data
        Band values of the region.
    options
        What to fit and how.
    alone
        Name of the family to fit without discrepancy as well.
    rng
        Of all draws.
    """
    posteriors, left_out, without_discrepancy = _side_by_side(data, options, alone, rng)
    scores = score_families(posteriors, left_out)
    chosen, why = choose_family(scores)
    if options.family is not None and options.family != chosen:
        why = f"{options.family}: chosen by the option 'family'; without this option it would be {why}"
    chosen = options.family or chosen
    posterior = posteriors[chosen] if chosen == DEFAULT_FAMILY else fit_family(data, chosen, options, rng)
    return FamilyFits(posteriors, without_discrepancy, scores, chosen, why, posterior)


def fit_family(data: BandData, family: str, options: FitOptions, rng: np.random.Generator) -> EmissionPosterior:
    """Return the posterior of the family of a name."""
    return fit_emission(data, FAMILIES[family], options.prior, options.discrepancy, options.settings, rng)


def _side_by_side(
    data: BandData, options: FitOptions, alone: str, rng: np.random.Generator
) -> tuple[dict[str, EmissionPosterior], dict[str, BandPrediction], EmissionPosterior]:
    """Return posterior and left-out bands of each family, and the posterior of one without discrepancy.

    Side by side in threads, each with randomness of its own. The families beside the default get fewer draws:
    one of them that is reported after all is fitted again.
    """
    sizes = options.settings
    few = replace(
        sizes,
        importance_draws=max(sizes.importance_draws // 2, FEWEST_DRAWS),
        kept_draws=max(sizes.kept_draws // 2, FEWEST_DRAWS),
        good_effective_share=_GOOD_EFFECTIVE_SHARE_OF_OTHERS,
    )
    fewer, exact = replace(options, settings=few), replace(options, discrepancy=NO_DISCREPANCY)

    def fitted(name: str, own: np.random.Generator) -> tuple[EmissionPosterior, BandPrediction]:
        posterior = fit_family(data, name, options if name == DEFAULT_FAMILY else fewer, own)
        return posterior, leave_one_band_out(posterior.log_posterior, posterior.sampling.sample)

    *own, last = rng.spawn(len(FAMILIES) + 1)
    skew_shape_table()  # once, before several ask for them at the same time
    with ThreadPoolExecutor(machine_threads()) as pool:
        running = {name: pool.submit(fitted, name, each) for name, each in zip(FAMILIES, own, strict=True)}
        without_discrepancy = pool.submit(fit_family, data, alone, exact, last)
        results = {name: done.result() for name, done in running.items()}
        posteriors = {name: posterior for name, (posterior, _) in results.items()}
        return posteriors, {name: left_out for name, (_, left_out) in results.items()}, without_discrepancy.result()
