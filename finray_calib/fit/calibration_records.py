"""The parts of the stored paint calibration, from posteriors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.estimate import Estimate
from data_schemas.fit import (
    BandResidual,
    ChainCheck,
    Diagnostics,
    DiscrepancySettings,
    FamilyResult,
    PriorSensitivity,
)
from data_schemas.radiometry import BandSignals
from finray_calib.fit.chain_check import chain_record
from finray_calib.fit.discrepancy import Discrepancy
from finray_calib.fit.emission import EmissionPosterior
from finray_calib.fit.family_choice import FamilyScore
from finray_calib.fit.prior_sensitivity import mean_shifts
from finray_calib.fit.summary import summarise
from finray_calib.spectra.rig_curves import transmissions
from finray_calib.spectra.skew_cauchy import from_mode_parameters

Floats = NDArray[np.float64]

SMALLEST_P: Final = 0.01
LARGEST_CHAIN_SHIFT_SD: Final = 0.25
"""A mean of 400 effective draws moves by 0.05 sd; five times that is no longer chance."""


@dataclass(frozen=True, slots=True)
class CurveBands:
    """Posterior mean and pointwise limits of curves, each (L,), nm^-1."""

    mean: Floats
    low95: Floats
    high95: Floats
    low68: Floats
    high68: Floats


def curve_bands(curves: Floats) -> CurveBands:
    """Return mean and equal-tailed pointwise limits of (n, L) curves of finite numbers."""
    ordered = np.sort(curves, axis=0)  # np.quantile, which selects instead, takes three times as long
    place = np.array([[0.025], [0.16], [0.84], [0.975]]) * (len(curves) - 1)
    below = place.astype(np.int64)
    low, high = ordered[below[:, 0]], ordered[np.minimum(below[:, 0] + 1, len(curves) - 1)]
    low95, low68, high68, high95 = low + (place - below) * (high - low)
    return CurveBands(curves.mean(axis=0), low95, high95, low68, high68)


def estimate(draws: Floats) -> Estimate:
    """Return the record of a posterior summary."""
    summary = summarise(draws)
    return Estimate(
        estimate=summary.estimate,
        sd=summary.sd,
        low68=summary.low68,
        high68=summary.high68,
        low95=summary.low95,
        high95=summary.high95,
    )


def _quantities(posterior: EmissionPosterior) -> dict[str, Floats]:
    """Return the draws of the quantities that every curve has."""
    q = posterior.quantities
    return {
        "mode_nm": q.mode_nm,
        "fwhm_nm": q.fwhm_nm,
        "skew": q.skew,
        "peak_per_nm": q.peak_per_nm,
        "energy_yield": q.energy_yield,
    }


def parameters(posterior: EmissionPosterior) -> dict[str, Estimate]:
    """Summarise the quantities of the curve, then the sampled parameters."""
    names = posterior.log_posterior.prior.names
    draws: Mapping[str, Floats] = {
        **_quantities(posterior),
        "reflectance_at_laser": posterior.reflectance_at_laser,
        "share_below_laser": posterior.share_below_laser,
        **{name: posterior.draws[:, i] for i, name in enumerate(names)},
    }
    return {name: estimate(values) for name, values in draws.items()}


def paper_parameters(posterior: EmissionPosterior) -> dict[str, Estimate]:
    """Summarise the paper's four parameters, in its symbols and units of this package."""
    mode, ln_fwhm, ln_peak, kappa = posterior.draws[:, :4].T
    location, scale, skewness, amplitude = from_mode_parameters(mode, ln_fwhm, kappa, ln_peak)
    draws = {"location_nm": location, "scale_nm": scale, "skewness": skewness, "amplitude_nm": amplitude}
    return {name: estimate(values) for name, values in draws.items()}


def band_integrals(bands: BandSignals, posterior: EmissionPosterior) -> tuple[Estimate, ...]:
    """Return the mean emission over each filter's transmission, nm^-1."""
    curves = posterior.curve_draws.curves
    return tuple(estimate(curves @ passed / passed.sum()) for passed in transmissions(bands.optics))


def discrepancy(settings: Discrepancy) -> DiscrepancySettings:
    """Return the record of the hyper-parameters."""
    return DiscrepancySettings(
        amplitude_rel=settings.amplitude_rel,
        length_nm=settings.length_nm,
        floor_rel=settings.floor_rel,
        reabsorption_rel=settings.reabsorption_rel,
        origin=settings.origin,
    )


def prior_sensitivity(posterior: EmissionPosterior) -> dict[str, PriorSensitivity]:
    """Return how far the quantities move when the prior is made narrower and wider."""
    prior, quantities = posterior.log_posterior.prior, _quantities(posterior)
    halved, doubled = (mean_shifts(prior, posterior.draws, quantities, factor) for factor in (0.5, 2.0))
    return {name: PriorSensitivity(halved=halved[name], doubled=doubled[name]) for name in quantities}


def families(
    posteriors: Mapping[str, EmissionPosterior], scores: Mapping[str, FamilyScore]
) -> tuple[FamilyResult, ...]:
    """Return what each family makes of the bands; the paper's without discrepancy competes for no probability."""
    results = []
    for name, posterior in posteriors.items():
        score = scores.get(name)
        sample = posterior.sampling.sample
        left_out = score.left_out if score else None
        results.append(
            FamilyResult(
                name=posterior.family.name,
                title=posterior.family.title,
                with_discrepancy=posterior.log_posterior.discrepancy.acts,
                quantities={key: estimate(draws) for key, draws in _quantities(posterior).items()},
                ln_evidence=sample.ln_evidence,
                ln_evidence_sd=sample.ln_evidence_sd,
                probability=score.probability if score else None,
                left_out_bands=left_out.total if left_out else None,
                left_out_bands_sd=score.difference_sd if score else None,
                left_out_pareto_k=_finite(np.nanmax(left_out.pareto_k)) if left_out else None,
                chi_square=posterior.bands.total_chi2,
                method=posterior.sampling.method,
                pareto_k=_finite(sample.pareto_k),
            )
        )
    return tuple(results)


def residuals(bands: BandSignals, posterior: EmissionPosterior) -> tuple[BandResidual, ...]:
    """Return how well each filter is explained; a filter without usable channels has no degrees of freedom."""
    check = posterior.bands
    p_values = np.nan_to_num(check.p_value, nan=1.0)
    return tuple(
        BandResidual(
            filter_name=band.name,
            center_nm=band.center_nm,
            chi_square=float(np.nan_to_num(check.chi2[b])),
            degrees_of_freedom=int(check.degrees_of_freedom[b]),
            posterior_predictive_p=float(p_values[b]),
            explained=bool(p_values[b] >= SMALLEST_P),
            calibration_pull=estimate(posterior.curve_draws.imperfections[:, b]),
        )
        for b, band in enumerate(bands.optics.filters)
    )


def _finite(pareto_k: float) -> float | None:
    """Return a shape of weights, None where it cannot be estimated."""
    return float(pareto_k) if np.isfinite(pareto_k) else None


def diagnostics(posterior: EmissionPosterior, check: ChainCheck | None) -> Diagnostics:
    """Return the record of how far the draws can be trusted; emcee that made them counts as no check of its own."""
    sampling = posterior.sampling
    chain, effective = check, sampling.sample.effective
    if sampling.moved is not None:
        effective = float(min(sampling.moved.distinct, len(posterior.draws)))
    if sampling.chain is not None:
        effective = float(sampling.chain.bulk_ess.min())
        chain = chain_record(posterior.log_posterior.prior.names, sampling.chain, None)
    return Diagnostics(
        method=posterior.sampling.method,
        trusted=sampling.trusted,
        pareto_k=_finite(sampling.sample.pareto_k),
        effective_samples=effective,
        ln_evidence=sampling.sample.ln_evidence,
        ln_evidence_sd=sampling.sample.ln_evidence_sd,
        maxima=tuple(float(v) for v in posterior.maxima.log_posterior),
        memory=None if sampling.moved is None else sampling.moved.memory,
        chain=chain,
    )
