"""The independent check: the same posterior by Markov chains."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from data_schemas.fit import ChainCheck
from finray_calib.fit.diagnostics import ChainDiagnostics
from finray_calib.fit.emission import EmissionPosterior
from finray_calib.fit.sampler import SamplerSettings, sample_posterior

FloatArray = NDArray[np.float64]


def check_by_chain(posterior: EmissionPosterior, settings: SamplerSettings, rng: np.random.Generator) -> ChainCheck:
    """Sample a posterior again with emcee and compare the means with the stored draws.

    Parameters
    ----------
    posterior
        What was fitted.
    settings
        Length and size of the chain.
    rng
        Source of all randomness.
    """
    chain, diagnostics = sample_posterior(posterior.log_posterior, posterior.proposal, settings, rng)
    apart = (chain.mean(axis=0) - posterior.draws.mean(axis=0)) / posterior.draws.std(axis=0, ddof=1)
    return chain_record(posterior.log_posterior.prior.names, diagnostics, apart)


def chain_record(names: Sequence[str], chain: ChainDiagnostics, mean_shift_sd: FloatArray | None) -> ChainCheck:
    """Return the record of a chain's diagnostics; without shifts where the chain itself made the draws."""

    def by_name(values: FloatArray) -> dict[str, float]:
        return dict(zip(names, map(float, values), strict=True))

    return ChainCheck(
        walkers=chain.walkers,
        steps=chain.steps,
        converged=chain.converged,
        acceptance_fraction=chain.acceptance,
        autocorrelation_time=by_name(chain.autocorrelation_steps),
        r_hat=by_name(chain.r_hat),
        effective_samples=by_name(chain.bulk_ess),
        mean_shift_sd={} if mean_shift_sd is None else by_name(mean_shift_sd),
    )
