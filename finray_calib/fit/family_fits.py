"""All families of emission curves fitted to the same bands, and the one to report."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from finray_calib.fit.band_data import BandData
from finray_calib.fit.discrepancy import NO_DISCREPANCY
from finray_calib.fit.emission import FEWEST_DRAWS, EmissionPosterior, fit_emission
from finray_calib.fit.family_choice import DEFAULT_FAMILY, FamilyScore, choose_family, score_families
from finray_calib.fit.fit_options import FitOptions
from finray_calib.fit.leave_one_band_out import BandPrediction, leave_one_band_out
from finray_calib.spectra.compiled import machine_threads
from finray_calib.spectra.emission_families import FAMILIES, tables

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
    """Fit all families and return them with the one to report: the asked one, or the best by the rule.

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
        why = f"{options.family}: asked for; the rule would take {why}"
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
    tables()  # once, before several ask for them at the same time
    with ThreadPoolExecutor(machine_threads()) as pool:
        running = {name: pool.submit(fitted, name, each) for name, each in zip(FAMILIES, own, strict=True)}
        without_discrepancy = pool.submit(fit_family, data, alone, exact, last)
        results = {name: done.result() for name, done in running.items()}
        posteriors = {name: posterior for name, (posterior, _) in results.items()}
        return posteriors, {name: left_out for name, (_, left_out) in results.items()}, without_discrepancy.result()
