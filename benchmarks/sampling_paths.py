"""The ways to draw from one posterior, each timed as its users run it: the fit's own path, emcee, NumPyro."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import emcee
import numpy as np

from benchmarks.plain_densities import FiveParameterDensity
from finray_calib.fit import FitSettings, LogPosterior, find_maxima
from finray_calib.fit._emission import draw_posterior

BURN_IN = 0.1  # of the steps; the walkers start around the maximum with the posterior's own width
NUTS_WARMUP, NUTS_DRAWS = 500, 1000  # a chain


@dataclass(frozen=True)
class Run:
    """One run of one sampler: processor seconds, effective draws, and the posterior's means and standard deviations."""

    seconds: float
    effective: float
    mean: np.ndarray
    sd: np.ndarray
    method: str

    @property
    def per_second(self) -> float:
        return self.effective / self.seconds


def run_fit(posterior: LogPosterior, draws: int, seed: int) -> Run:
    """Time the fit's path: all maxima, importance sampling (adapted where it must be), resampling."""
    rng, start = np.random.default_rng(seed), time.process_time()
    maxima = find_maxima(posterior, rng)
    _, kept, sampling = draw_posterior(posterior, maxima, FitSettings(draws, draws), rng)
    seconds = time.process_time() - start
    if sampling.chain is not None:
        mean, sd, effective = kept.mean(axis=0), kept.std(axis=0), sampling.chain.bulk_ess.min()
    else:
        mean, sd, effective = _weighted(sampling.sample.theta, sampling.sample.weight)
    return Run(seconds, float(effective), mean, sd, sampling.method)


def _weighted(theta: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return means and sds of weighted draws, and the effective number for the worst parameter's mean.

    That number, sd^2 / sum w^2 (theta - mean)^2, is what the autocorrelation time is to a chain; 1 / sum w^2 would
    claim up to twice as much, because the largest weights lie in the tails.
    """
    mean = weight @ theta
    apart = (theta - mean) ** 2
    variance = weight @ apart
    return mean, np.sqrt(variance), float((variance / (weight**2 @ apart)).min())


def run_emcee(
    density: Callable[[np.ndarray], object],
    posterior: LogPosterior,
    seed: int,
    *,
    steps: int,
    walkers: int,
    vectorize: bool,
) -> Run:
    """Time emcee's stretch move; effective draws by the longest autocorrelation time."""
    rng = np.random.default_rng(seed)
    maxima = find_maxima(posterior, rng)
    covariance = np.linalg.inv(maxima.information[0])
    walkers_start = rng.multivariate_normal(maxima.theta[0], covariance, walkers)
    prior = posterior.prior
    walkers_start = np.clip(walkers_start, prior.low + 1e-6, prior.high - 1e-6)
    sampler = emcee.EnsembleSampler(walkers, prior.size, density, vectorize=vectorize)
    sampler.random_state = np.random.RandomState(seed).get_state()
    start = time.process_time()
    sampler.run_mcmc(walkers_start, steps)
    seconds = time.process_time() - start
    discarded = int(BURN_IN * steps)
    chain = sampler.get_chain(discard=discarded, flat=True)
    tau = float(sampler.get_autocorr_time(discard=discarded, tol=0).max())
    return Run(seconds, len(chain) / tau, chain.mean(axis=0), chain.std(axis=0), f"emcee, tau {tau:.0f} steps")


def run_nuts(density: FiveParameterDensity, posterior: LogPosterior, seed: int, chains: int) -> Run:
    """Time NumPyro's NUTS with a dense mass matrix from call to draws, compilation included.

    It starts at the maximum: from NumPyro's default starts, two prior widths around zero, it does not arrive.
    """
    import numpyro
    from numpyro.diagnostics import effective_sample_size
    from numpyro.infer import MCMC, NUTS, init_to_value

    numpyro.enable_x64()
    import jax

    maximum = find_maxima(posterior, np.random.default_rng(seed)).theta[0]
    start_values = dict(zip(posterior.prior.names, maximum.tolist(), strict=True))
    start = time.process_time()
    kernel = NUTS(_numpyro_model(density), dense_mass=True, init_strategy=init_to_value(values=start_values))
    mcmc = MCMC(
        kernel,
        num_warmup=NUTS_WARMUP,
        num_samples=NUTS_DRAWS,
        num_chains=chains,
        chain_method="vectorized",
        progress_bar=False,
    )
    mcmc.run(jax.random.PRNGKey(seed))
    drawn = mcmc.get_samples(group_by_chain=True)
    samples = np.stack([np.asarray(drawn[name]) for name in posterior.prior.names], axis=-1)
    seconds = time.process_time() - start
    effective = min(float(effective_sample_size(samples[..., i])) for i in range(samples.shape[-1]))
    flat = samples.reshape(-1, samples.shape[-1])
    divergences = int(np.sum(mcmc.get_extra_fields()["diverging"]))
    return Run(seconds, effective, flat.mean(axis=0), flat.std(axis=0), f"NUTS, {divergences} divergences")


def _numpyro_model(density: FiveParameterDensity) -> Callable[[], None]:
    """Return the five-parameter model in NumPyro's words."""
    import jax.numpy as jnp
    import numpyro
    from numpyro import distributions as dist

    prior, wavelength, grid = density.prior, density.wavelength, np.arange(density.shapes.shape[1]) * density.step

    def model() -> None:
        theta = {}
        for name, mean, sd, low, high in zip(prior.names, prior.mean, prior.sd, prior.low, prior.high, strict=True):
            bounded = np.isfinite(low) or np.isfinite(high)
            theta[name] = numpyro.sample(
                name, dist.TruncatedNormal(mean, sd, low=low, high=high) if bounded else dist.Normal(mean, sd)
            )
        mode, ln_fwhm, ln_peak, kappa, ln_laser = theta.values()
        offset, peak, width = (jnp.interp(jnp.abs(kappa), grid, shape) for shape in density.shapes)
        scale = jnp.exp(ln_fwhm) / width
        z = (wavelength - (mode - jnp.sign(kappa) * offset * scale)) / scale
        curve = jnp.exp(ln_peak) / peak * (jnp.arctan(jnp.sinh(kappa) * z) / jnp.pi + 0.5) / (1 + z * z)
        mu = density.emission @ curve + jnp.exp(ln_laser) * density.laser
        numpyro.sample("y", dist.MultivariateNormal(mu, scale_tril=density.factor), obs=density.y)

    return model
