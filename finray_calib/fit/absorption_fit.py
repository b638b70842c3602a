r"""Absorption and Stokes shift of a paint: what the yields under several lights say, and what stays belief.

The energy yield under a light at l_i is proportional to the photons it brings in and the share that is absorbed,

.. math:: \ln\frac{Y_i}{Y_0} = \ln\frac{a(\lambda_i)}{a(\lambda_0)} + \ln\frac{\lambda_i}{\lambda_0} + \epsilon_i

(Kasha's rule: the shape of the emission does not depend on the excitation). The absorptance is the family of
:func:`finray_calib.spectra.absorption.absorptance` times the exponential of a smooth Gaussian process. The process
is integrated out for the weights of candidate shapes and then drawn given the yields, so that the draws are those
of the whole model.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtr, ndtri

from data_schemas.curves import SpectralCurve
from data_schemas.errors import FitError
from data_schemas.estimate import Estimate
from data_schemas.reradiation import Reradiation
from finray_calib.fit.summary import summarise
from finray_calib.spectra.absorption import absorptance, photon_yield, smooth_covariance

Floats = NDArray[np.float64]
EXCITATION_NM: Floats = np.arange(300.0, 781.0, 5.0)
EXCITATION_NM.flags.writeable = False
CANDIDATES = 20_000
REDRAWS = 40
LARGEST_YIELD_SD_REL = 0.5
FEWEST_SHAPES = 50
_ABSORPTANCE_FLOOR = 1e-9  # a bell's tail underflows to 0, whose logarithm does not exist
_JITTER = 1e-10
_ONE_LIGHT = (
    "the Stokes shift comes from the prior: one laser at {laser:g} nm fixes absorption at {laser:g} nm only; measure "
    "the yield under further lights to learn the rest"
)
_SEVERAL_LIGHTS = (
    "yields under lights at {lights} nm constrain the absorption between them; beyond, and for the Stokes shift as far "
    "as no light lies near the edge of the absorption, the prior speaks"
)
_BOUNDED = "; the reflectance only bounds the absorption from above"
_FEW_SHAPES = "; the yields contradict the prior (only {shapes} absorption shapes fit): trust the curve near the lights"


@dataclass(frozen=True, slots=True)
class ExcitationYield:
    """Energy yield of a paint under one narrow light (up to some 15 nm wide).

    Attributes
    ----------
    excitation_nm
        Centroid of the light, nm.
    yield_rel
        Emitted over incident energy in any unit common to all lights, counted over the same emission wavelengths,
        all of them above the longest excitation.
    sd_rel
        Its standard uncertainty relative to the value, independent of the other lights', above 0 to 0.5.
    """

    excitation_nm: float
    yield_rel: float
    sd_rel: float


@dataclass(frozen=True)
class AbsorptionPrior:
    """What is believed about the absorption of a fluorescent paint before it is measured.

    Attributes
    ----------
    stokes_mean_nm, stokes_sd_nm
        Stokes shift, normal cut to above 0: eight measured paints, inks, textiles and papers lie within 20 to 50 nm.
    absorbance_median_factor, ln_absorbance_sd
        Absorbance of the layer at its maximum; the median 1 absorbs nine tenths of the light.
    red_half_width_median_nm, ln_red_half_width_sd
        Half width at half maximum of the absorbance towards the red.
    blue_half_width_median_nm, ln_blue_half_width_sd
        The same towards the blue, where vibronic bands and further dyes widen it.
    blue_floor_low_rel, blue_floor_high_rel
        The logarithm of the floor in the far blue is uniform between these.
    deviation_rel, deviation_length_nm
        Smooth departure of real absorption from the family. Best fits of the family to whole measured excitation
        spectra leave 0.04 to 0.10; fits to a few lights leave more.

    Raises
    ------
    FitError
        A median, width or length is not positive, or the floor's limit is above 1.
    """

    stokes_mean_nm: float = 35.0
    stokes_sd_nm: float = 15.0
    absorbance_median_factor: float = 1.0
    ln_absorbance_sd: float = 0.8
    red_half_width_median_nm: float = 20.0
    ln_red_half_width_sd: float = 0.4
    blue_half_width_median_nm: float = 60.0
    ln_blue_half_width_sd: float = 0.7
    blue_floor_low_rel: float = 0.02
    blue_floor_high_rel: float = 0.5
    deviation_rel: float = 0.12
    deviation_length_nm: float = 20.0

    def __post_init__(self) -> None:
        wrong = [f.name for f in fields(self) if not getattr(self, f.name) > 0]
        if wrong:
            raise FitError(f"absorption prior: {wrong[0]} is {getattr(self, wrong[0]):g}, it must be above 0")
        if not self.blue_floor_low_rel <= self.blue_floor_high_rel <= 1:
            raise FitError(
                f"absorption prior: the blue floor runs from {self.blue_floor_low_rel:g} to "
                f"{self.blue_floor_high_rel:g}, it must increase and end at 1 or below"
            )

    @cached_property
    def in_words(self) -> dict[str, str]:
        """Prior of each parameter with its origin."""
        return {
            "stokes_shift_nm": f"normal({self.stokes_mean_nm:g}, {self.stokes_sd_nm:g}) nm above 0; eight measured "
            "materials lie within 20 to 50 nm",
            "peak_absorbance": f"log-normal, median {self.absorbance_median_factor:g}, sd of the logarithm "
            f"{self.ln_absorbance_sd:g}; from thin to saturated layers",
            "red_half_width_nm": f"log-normal, median {self.red_half_width_median_nm:g} nm, sd of the logarithm "
            f"{self.ln_red_half_width_sd:g}; four open materials",
            "blue_half_width_nm": f"log-normal, median {self.blue_half_width_median_nm:g} nm, sd of the logarithm "
            f"{self.ln_blue_half_width_sd:g}; four open materials",
            "blue_floor": f"log-uniform {self.blue_floor_low_rel:g} to {self.blue_floor_high_rel:g}; four open "
            "materials",
            "deviation": f"smooth Gaussian process of ln a, sd {self.deviation_rel:g}, length "
            f"{self.deviation_length_nm:g} nm; four open materials",
        }

    def stokes_density(self, shift_nm: Floats) -> Floats:
        """Return the prior density of Stokes shifts up to a factor; 0 for shifts not above 0."""
        z = (shift_nm - self.stokes_mean_nm) / self.stokes_sd_nm
        return np.where(shift_nm > 0, np.exp(-0.5 * z**2), 0.0)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return (count,) Stokes shifts in nm, and (4, count) absorbance, half widths (red, blue, nm) and floor."""
        below = ndtr(-self.stokes_mean_nm / self.stokes_sd_nm)
        shift = self.stokes_mean_nm + self.stokes_sd_nm * ndtri(below + (1 - below) * rng.random(count))
        medians = (self.absorbance_median_factor, self.red_half_width_median_nm, self.blue_half_width_median_nm)
        spreads = (self.ln_absorbance_sd, self.ln_red_half_width_sd, self.ln_blue_half_width_sd)
        shape = [m * np.exp(s * rng.standard_normal(count)) for m, s in zip(medians, spreads, strict=True)]
        span = np.log(self.blue_floor_high_rel / self.blue_floor_low_rel)
        return shift, np.array([*shape, self.blue_floor_low_rel * np.exp(span * rng.random(count))])


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Absorption shapes drawn from the prior, with their weights for each maximum of the emission.

    ``columns`` (5, K) are the arguments of :func:`absorptance`, ``ln_at_lights`` (K, Y) is ln a(l) / a(laser), and
    ``cumulated`` (M, K) the distribution function of the weights for each distinct emission maximum.
    """

    columns: Floats
    ln_at_lights: Floats
    cumulated: Floats
    effective: int

    def choose(self, modes: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
        """Return one candidate for each emission draw, given the index of its maximum."""
        chosen = np.empty(modes.size, dtype=np.int64)
        for m in np.unique(modes):
            here = modes == m
            chosen[here] = np.searchsorted(self.cumulated[m], rng.random(int(here.sum())), side="right")
        return np.asarray(np.minimum(chosen, self.cumulated.shape[1] - 1), dtype=np.int64)


class _Deviation:
    """Smooth departure of ln a from the family, relative to the laser, given the yields."""

    def __init__(self, points_nm: Floats, laser_nm: float, lights: Sequence[ExcitationYield], prior: AbsorptionPrior):
        self.lights = len(lights) - 1
        at = np.append(points_nm, laser_nm)
        full = smooth_covariance(at, prior.deviation_rel, prior.deviation_length_nm)
        difference = np.eye(at.size)[:-1]
        difference[:, -1] = -1.0
        self.covariance = difference @ full @ difference.T
        self.root = np.linalg.cholesky(self.covariance + _JITTER * np.eye(points_nm.size))
        self.sd = np.array([light.sd_rel for light in lights])
        noise = np.diag(self.sd[1:] ** 2) + self.sd[0] ** 2
        self.factor = cho_factor(self.covariance[: self.lights, : self.lights] + noise)

    def log_likelihood(self, residual: Floats) -> Floats:
        """Return the log density up to a constant of (K, lights) residuals of ln yield."""
        if self.lights == 0:
            return np.zeros(len(residual))
        solved = cho_solve(self.factor, residual.T)
        return np.asarray(-0.5 * np.einsum("kl,lk->k", residual, solved))

    def draw(self, residual: Floats, rng: np.random.Generator) -> Floats:
        """Return (N, E) draws given (N, lights) residuals, by conditioning prior draws (Matheron's rule)."""
        prior = rng.standard_normal((len(residual), len(self.root))) @ self.root.T
        if self.lights == 0:
            return prior
        noise = rng.standard_normal((len(residual), self.lights + 1)) * self.sd
        seen = prior[:, : self.lights] + noise[:, 1:] - noise[:, :1]
        gain = cho_solve(self.factor, self.covariance[: self.lights, self.lights :])
        return np.asarray(prior[:, self.lights :] + (residual - seen) @ gain)


def fit_absorption(
    emission_draws_per_nm: Floats,
    wavelength_nm: Floats,
    laser_nm: float,
    yields: Sequence[ExcitationYield],
    prior: AbsorptionPrior,
    rng: np.random.Generator,
    least_reflectance: SpectralCurve | None = None,
    excitation_nm: Floats = EXCITATION_NM,
) -> Reradiation:
    """Return the posterior of the absorption, one draw for each emission draw.

    The emission draws keep their weights: yields judge absorption shapes, and an emission draw enters through its
    maximum, from which the prior of the Stokes shift counts. Draws that would send out more photons than the paint
    can absorb, P(laser) a(l)/a(laser) > 1 - reflectance(l), are drawn again. Importance sampling from the prior;
    valid while the yields do not contradict it (``distinct_shapes`` tells).

    Parameters
    ----------
    emission_draws_per_nm
        (N, L) emission draws under the laser, nm^-1, at least 100.
    wavelength_nm
        (L,) grid, nm.
    laser_nm
        Excitation of the emission draws, nm.
    yields
        The laser first, then the other lights. With the laser alone the posterior is the prior.
    prior
        Prior of shift and shape.
    rng
        Source of all randomness.
    least_reflectance
        Reflectance that the paint has at least (0..1), for instance the lower 95 % limit; none counts as 0.
    excitation_nm
        (E,) grid of the result, nm.

    Returns
    -------
    Reradiation
        Absorption relative to the laser with its 95 % limits and draws, and the Stokes shift.

    Raises
    ------
    FitError
        Emission draws do not fit the grid or hold no light above the laser; the first yield is not the laser's; a
        yield is not positive or its uncertainty not within 0 to 0.5; two lights have the same wavelength.
    """
    mode_nm = _modes(emission_draws_per_nm, wavelength_nm, laser_nm)
    _check_yields(yields, laser_nm)
    lights_nm = np.array([light.excitation_nm for light in yields[1:]])
    observed = np.array([np.log(light.yield_rel / yields[0].yield_rel) for light in yields[1:]])
    observed = observed - np.log(lights_nm / laser_nm)
    deviation = _Deviation(np.concatenate([lights_nm, excitation_nm]), laser_nm, yields, prior)
    distinct_nm, index, counts = np.unique(mode_nm, return_inverse=True, return_counts=True)
    candidates = _candidates(distinct_nm, counts, laser_nm, lights_nm, observed, deviation, prior, rng)
    reflected = 0.0 if least_reflectance is None else least_reflectance(excitation_nm)
    ceiling = (1 - reflected) / photon_yield(emission_draws_per_nm, wavelength_nm, laser_nm)[:, None]

    draws = np.empty((mode_nm.size, excitation_nm.size))
    shift_nm = np.empty(mode_nm.size)
    rows, rejected = np.arange(mode_nm.size), 0.0
    for attempt in range(REDRAWS):
        chosen = candidates.choose(index[rows], rng)
        shapes = _ln_relative(candidates.columns[:, chosen], excitation_nm, laser_nm)
        residual = observed - candidates.ln_at_lights[chosen]
        draws[rows] = np.exp(shapes + deviation.draw(residual, rng))
        shift_nm[rows] = mode_nm[rows] - candidates.columns[0, chosen]
        rows = np.flatnonzero((draws > np.broadcast_to(ceiling, draws.shape)).any(axis=1))
        if attempt == 0:
            rejected = rows.size / mode_nm.size
        if rows.size == 0:
            break
    low95, high95 = np.quantile(draws, [0.025, 0.975], axis=0)
    return Reradiation(
        excitation_nm=excitation_nm,
        laser_nm=laser_nm,
        absorption_rel=draws.mean(axis=0),
        low95=low95,
        high95=high95,
        absorption_rel_draws=draws,
        stokes_shift_nm=_estimate(shift_nm),
        stokes_shift_draws_nm=shift_nm,
        measured_at_nm=tuple(light.excitation_nm for light in yields),
        prior_driven=len(yields) == 1,
        prior=prior.in_words,
        distinct_shapes=candidates.effective,
        rejected_share=rejected,
        violating_share=rows.size / mode_nm.size,
        statement=_statement(yields, laser_nm, least_reflectance is not None, candidates.effective),
    )


def _modes(draws: Floats, wavelength_nm: Floats, laser_nm: float) -> Floats:
    """Return the wavelength of the maximum of each emission draw above the laser, nm."""
    if draws.ndim != 2 or draws.shape[1:] != wavelength_nm.shape or not np.isfinite(draws).all():
        raise FitError(
            f"absorption: emission draws have shape {draws.shape} on a grid of {wavelength_nm.shape} wavelengths; must "
            "be finite, (draws, wavelengths)"
        )
    above = np.where(wavelength_nm > laser_nm, draws, 0.0)
    if not (above.max(axis=1, initial=0.0) > 0).all():
        raise FitError(
            f"absorption: an emission draw holds no light above the laser at {laser_nm:g} nm; check the wavelengths"
        )
    return np.asarray(wavelength_nm[above.argmax(axis=1)])


def _check_yields(yields: Sequence[ExcitationYield], laser_nm: float) -> None:
    """Refuse yields that cannot be used."""
    if not yields or yields[0].excitation_nm != laser_nm:
        first = f"{yields[0].excitation_nm:g} nm" if yields else "missing"
        raise FitError(f"absorption: the first yield must be the laser's at {laser_nm:g} nm, it is {first}")
    for light in yields:
        if not (light.yield_rel > 0 and 0 < light.sd_rel <= LARGEST_YIELD_SD_REL):
            raise FitError(
                f"absorption: yield {light.yield_rel:g} with relative uncertainty {light.sd_rel:g} at "
                f"{light.excitation_nm:g} nm; the yield must be above 0 and its uncertainty within 0 to "
                f"{LARGEST_YIELD_SD_REL:g}: measure this light longer or leave it out"
            )
    if len({light.excitation_nm for light in yields}) < len(yields):
        raise FitError("absorption: two yields have the same excitation wavelength; average them first")


def _ln_relative(columns: Floats, wavelength_nm: Floats, laser_nm: float) -> Floats:
    """Return ln a(l) / a(laser) of (5, K) shapes, (K, L)."""
    values = absorptance(np.append(wavelength_nm, laser_nm), *columns[:, :, None])
    logarithm = np.log(np.maximum(values, _ABSORPTANCE_FLOOR))
    return np.asarray(logarithm[:, :-1] - logarithm[:, -1:])


def _candidates(
    modes_nm: Floats,
    counts: NDArray[np.int64],
    laser_nm: float,
    lights_nm: Floats,
    observed: Floats,
    deviation: _Deviation,
    prior: AbsorptionPrior,
    rng: np.random.Generator,
) -> _Candidates:
    """Draw absorption shapes around the emission maxima (with their numbers of draws) and weight them for each.

    The likelihood does not know the emission's maximum, so it is computed once for all; the prior of the Stokes
    shift tells how well a shape goes with each maximum.
    """
    share = counts / counts.sum()
    shift_nm, shape = prior.draw(CANDIDATES, rng)
    peak_nm = rng.choice(modes_nm, CANDIDATES, p=share) - shift_nm
    columns = np.concatenate([peak_nm[None], shape])
    at_lights = _ln_relative(columns, lights_nm, laser_nm)
    log_likelihood = deviation.log_likelihood(observed - at_lights)
    density = prior.stokes_density(modes_nm[:, None] - peak_nm)
    weight = density / (share @ density) * np.exp(log_likelihood - log_likelihood.max())
    cumulated = np.cumsum(weight, axis=1)
    mean = share @ weight
    effective = int(mean.sum() ** 2 / (mean**2).sum())
    return _Candidates(columns, at_lights, cumulated / cumulated[:, -1:], effective)


def _estimate(draws: Floats) -> Estimate:
    """Return the record of a posterior summary."""
    s = summarise(draws)
    return Estimate(estimate=s.estimate, sd=s.sd, low68=s.low68, high68=s.high68, low95=s.low95, high95=s.high95)


def _statement(yields: Sequence[ExcitationYield], laser_nm: float, bounded: bool, effective: int) -> str:
    """Say what the measurement fixes."""
    if len(yields) == 1:
        return _ONE_LIGHT.format(laser=laser_nm) + (_BOUNDED if bounded else "")
    lights = ", ".join(f"{light.excitation_nm:g}" for light in sorted(yields, key=lambda y: y.excitation_nm))
    few = _FEW_SHAPES.format(shapes=effective) if effective < FEWEST_SHAPES else ""
    return _SEVERAL_LIGHTS.format(lights=lights) + few
