r"""Absorption and Stokes shift of a paint: what the yields under several lights say, and what stays belief.

The energy yield under a light at l_i is proportional to the photons it brings in and the share that is absorbed,

.. math:: \ln\frac{Y_i}{Y_0} = \ln\frac{a(\lambda_i)}{a(\lambda_0)} + \ln\frac{\lambda_i}{\lambda_0} + \epsilon_i

(Kasha's rule: the shape of the emission does not depend on the excitation). The absorptance is the family of
:func:`finray_calib.spectra.absorption.absorptance` times the exponential of a smooth Gaussian process. The process
is integrated out for the weights of candidate shapes and then drawn given the yields, so that the draws are those
of the whole model.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.curves import SpectralCurve
from data_schemas.errors import FitError
from data_schemas.estimate import Estimate
from data_schemas.reradiation import Reradiation
from finray_calib.fit.absorption_candidates import Deviation, LightYields, draw_candidates, ln_relative
from finray_calib.fit.absorption_prior import AbsorptionPrior
from finray_calib.fit.summary import summarise
from finray_calib.spectra.absorption import photon_yield

Floats = NDArray[np.float64]
EXCITATION_NM: Floats = np.arange(300.0, 781.0, 5.0)
EXCITATION_NM.flags.writeable = False
REDRAWS = 40
LARGEST_YIELD_SD_REL = 0.5
FEWEST_SHAPES = 50
PRIOR_DRIVEN_SHARE = 0.8
"""Further lights that narrow the Stokes shift by less than a fifth have not measured it."""
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
    emission_draws_per_nm, wavelength_nm
        (N, L) emission draws under the laser, nm^-1, at least 100, and their (L,) grid, nm.
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
    seen = _relative_to_laser(yields, laser_nm)
    sampler = _Sampler(mode_nm, seen, prior, excitation_nm, rng)
    most = 1.0 if least_reflectance is None else 1 - least_reflectance(excitation_nm)
    ceiling = most / photon_yield(emission_draws_per_nm, wavelength_nm, laser_nm)[:, None]
    draws, shift_nm, rejected, violating = sampler.draw_below(ceiling)
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
        prior_driven=len(yields) == 1 or float(shift_nm.std()) > PRIOR_DRIVEN_SHARE * prior.stokes_sd_nm,
        prior=prior.in_words,
        distinct_shapes=sampler.candidates.effective,
        rejected_share=rejected,
        violating_share=violating,
        statement=_statement(yields, laser_nm, least_reflectance is not None, sampler.candidates.effective),
    )


class _Sampler:
    """Draws one absorption for each emission draw."""

    def __init__(
        self,
        mode_nm: Floats,
        yields: LightYields,
        prior: AbsorptionPrior,
        excitation_nm: Floats,
        rng: np.random.Generator,
    ) -> None:
        self.mode_nm, self.yields, self.excitation_nm, self.rng = mode_nm, yields, excitation_nm, rng
        self.deviation = Deviation(excitation_nm, yields, prior)
        distinct_nm, self.mode, counts = np.unique(mode_nm, return_inverse=True, return_counts=True)
        self.candidates = draw_candidates(distinct_nm, counts, yields, self.deviation, prior, rng)

    def draw(self, rows: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return absorption and Stokes shift (nm) for some emission draws."""
        chosen = self.candidates.choose(self.mode[rows], self.rng)
        columns = self.candidates.columns[:, chosen]
        shapes = ln_relative(columns, self.excitation_nm, self.yields.laser_nm)
        residual = self.yields.ln_absorbed - self.candidates.ln_at_lights[chosen]
        return np.exp(shapes + self.deviation.draw(residual, self.rng)), self.mode_nm[rows] - columns[0]

    def draw_below(self, ceiling: Floats) -> tuple[Floats, Floats, float, float]:
        """Return absorptions, shifts (nm), and the shares of draws first and finally above the (N, E) ceiling."""
        count = self.mode_nm.size
        draws, shift_nm = self.draw(np.arange(count))
        rows = np.flatnonzero((draws > ceiling).any(axis=1))
        rejected = rows.size / count
        for _ in range(REDRAWS - 1):
            if rows.size == 0:
                break
            draws[rows], shift_nm[rows] = self.draw(rows)
            rows = np.flatnonzero((draws > ceiling).any(axis=1))
        return draws, shift_nm, rejected, rows.size / count


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


def _relative_to_laser(yields: Sequence[ExcitationYield], laser_nm: float) -> LightYields:
    """Return what the lights say relative to the laser; refuse yields that cannot be used."""
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
    lights_nm = np.array([light.excitation_nm for light in yields[1:]])
    ln_energy = np.array([np.log(light.yield_rel / yields[0].yield_rel) for light in yields[1:]])
    sd_rel = np.array([light.sd_rel for light in yields])
    return LightYields(laser_nm, lights_nm, ln_energy - np.log(lights_nm / laser_nm), sd_rel)


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
