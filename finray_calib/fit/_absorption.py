r"""Absorption and Stokes shift of a paint: what the yields under several lights say, and what stays belief.

The energy yield under a light at l_i is proportional to the photons it brings in and the share that is absorbed,

.. math:: \ln\frac{Y_i}{Y_0} = \ln\frac{a(\lambda_i)}{a(\lambda_0)} + \ln\frac{\lambda_i}{\lambda_0} + \epsilon_i

(Kasha's rule: the shape of the emission does not depend on the excitation). The absorptance is the family of
:func:`finray_calib.spectra.absorption.absorptance` times the exponential of a smooth Gaussian process. The process
is integrated out for the weights of candidate shapes and then drawn given the yields, so that the draws are those
of the whole model. With emission and reflectance the absorption makes the reradiation matrix, whose doubts are told.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from data_schemas import BandSignals, Estimate, FitError, Reradiation, SpectralCurve
from finray_calib.fit._emission import estimate
from finray_calib.fit._prior import AbsorptionPrior
from finray_calib.spectra import WAVELENGTH_NM, absorptance, photon_yield, reradiation_matrix, smooth_covariance

Floats = NDArray[np.float64]


def paint_absorption(
    bands: BandSignals,
    drawn: Floats,
    reflected: tuple[Estimate, ...],
    lights: Sequence[tuple[float, Floats]],
    rng: np.random.Generator,
) -> Reradiation:
    """Return the absorption: prior-driven with one light, constrained by the yields of several.

    Parameters
    ----------
    bands
        Band signals under the first light.
    drawn
        (N, L) emission draws under it, nm^-1.
    reflected
        Reflectance at each filter.
    lights
        Excitation wavelength of each other light, nm, and (N, L) emission draws under it, nm^-1.
    rng
        Of the draws of the absorption.
    """
    laser_nm = bands.optics.laser.wavelength_nm
    yields = excitation_yields({laser_nm: drawn, **dict(lights)})
    least = _reflected_curve(bands, reflected, "low95")
    return fit_absorption(drawn, WAVELENGTH_NM, laser_nm, yields, AbsorptionPrior(), rng, least)


def matrix_warnings(
    bands: BandSignals, drawn: Floats, reflected: tuple[Estimate, ...], reradiation: Reradiation
) -> tuple[str, ...]:
    """Return what is doubtful about the matrix that absorption, emission draws and reflectance make together."""
    mean, sd = _reflected_curve(bands, reflected), _reflected_curve(bands, reflected, "sd")
    return reradiation_matrix(drawn, WAVELENGTH_NM, reradiation, mean, bands.paint_name, sd).warnings


def _reflected_curve(
    bands: BandSignals, reflected: tuple[Estimate, ...], quantity: Literal["estimate", "sd", "low95"] = "estimate"
) -> SpectralCurve:
    """Return the reflectance (or its standard uncertainty or lower 95 % limit) between the filters' centres."""
    pairs = sorted((f.center_nm, getattr(r, quantity)) for f, r in zip(bands.optics.filters, reflected, strict=True))
    nm, values = np.array(pairs).T
    return SpectralCurve(name="reflectance", wavelength_nm=nm, values=values, source="filters of the session")


CANDIDATES = 20_000
_ABSORPTANCE_FLOOR = 1e-9  # a bell's tail underflows to 0, whose logarithm does not exist
_JITTER = 1e-10


@dataclass(frozen=True, slots=True)
class LightYields:
    """What the lights beside the laser say: ln of photons absorbed, relative to the laser.

    Attributes
    ----------
    laser_nm
        Wavelength to which all is relative, nm.
    lights_nm
        (Y,) further lights, nm.
    ln_absorbed
        (Y,) ln a(l) / a(laser) as measured.
    sd_rel
        (Y + 1,) relative standard uncertainty of each yield, the laser's first.
    """

    laser_nm: float
    lights_nm: Floats
    ln_absorbed: Floats
    sd_rel: Floats


@dataclass(frozen=True, slots=True)
class Candidates:
    """Absorption shapes drawn from the prior, with their weights for each maximum of the emission.

    Attributes
    ----------
    columns
        (5, K) arguments of :func:`absorptance`.
    ln_at_lights
        (K, Y) ln a(l) / a(laser) of each shape at the lights.
    cumulated
        (M, K) distribution function of the weights for each distinct emission maximum.
    effective
        Effective number of shapes.
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


class Deviation:
    """Smooth departure of ln a from the family, relative to the laser, given the yields.

    Parameters
    ----------
    points_nm
        (E,) wavelengths at which it is drawn, nm.
    yields
        What the lights say.
    prior
        Size and length of the departure.
    """

    def __init__(self, points_nm: Floats, yields: LightYields, prior: AbsorptionPrior) -> None:
        self.lights, self.sd = yields.lights_nm.size, yields.sd_rel
        points = np.concatenate([yields.lights_nm, points_nm])
        at = np.append(points, yields.laser_nm)
        full = smooth_covariance(at, prior.deviation_rel, prior.deviation_length_nm)
        difference = np.eye(at.size)[:-1]
        difference[:, -1] = -1.0
        self.covariance = difference @ full @ difference.T
        self.root = np.linalg.cholesky(self.covariance + _JITTER * np.eye(points.size))
        noise = np.diag(self.sd[1:] ** 2) + self.sd[0] ** 2
        self.seen = self.covariance[: self.lights, : self.lights] + noise

    def log_likelihood(self, residual: Floats) -> Floats:
        """Return the log density up to a constant of (K, lights) residuals of ln yield."""
        if self.lights == 0:
            return np.zeros(len(residual))
        solved = np.linalg.solve(self.seen, residual.T)
        return np.asarray(-0.5 * np.einsum("kl,lk->k", residual, solved))

    def draw(self, residual: Floats, rng: np.random.Generator) -> Floats:
        """Return (N, E) draws given (N, lights) residuals, by conditioning prior draws (Matheron's rule)."""
        prior = rng.standard_normal((len(residual), len(self.root))) @ self.root.T
        if self.lights == 0:
            return prior
        noise = rng.standard_normal((len(residual), self.lights + 1)) * self.sd
        seen = prior[:, : self.lights] + noise[:, 1:] - noise[:, :1]
        gain = np.linalg.solve(self.seen, self.covariance[: self.lights, self.lights :])
        return np.asarray(prior[:, self.lights :] + (residual - seen) @ gain)


def ln_relative(columns: Floats, wavelength_nm: Floats, laser_nm: float) -> Floats:
    """Return ln a(l) / a(laser) of (5, K) shapes at (L,) wavelengths in nm, (K, L)."""
    values = absorptance(np.append(wavelength_nm, laser_nm), *columns[:, :, None])
    logarithm = np.log(np.maximum(values, _ABSORPTANCE_FLOOR))
    return np.asarray(logarithm[:, :-1] - logarithm[:, -1:])


def draw_candidates(
    modes_nm: Floats,
    counts: NDArray[np.int64],
    yields: LightYields,
    deviation: Deviation,
    prior: AbsorptionPrior,
    rng: np.random.Generator,
) -> Candidates:
    """Draw absorption shapes around the emission maxima and weight them for each.

    The likelihood does not know the emission's maximum, so it is computed once for all; the prior of the Stokes
    shift tells how well a shape goes with each maximum.

    Parameters
    ----------
    modes_nm, counts
        (M,) distinct maxima of the emission draws, nm, and how many draws have each.
    yields
        What the lights say.
    deviation
        Departure of real absorption from the shapes, integrated out.
    prior
        Prior of shift and shape.
    rng
        Source of all randomness.

    Raises
    ------
    FitError
        No shape agrees with the yields and an emission maximum.
    """
    share = counts / counts.sum()
    shift_nm, shape = prior.draw(CANDIDATES, rng)
    peak_nm = rng.choice(modes_nm, CANDIDATES, p=share) - shift_nm
    columns = np.concatenate([peak_nm[None], shape])
    at_lights = ln_relative(columns, yields.lights_nm, yields.laser_nm)
    log_likelihood = deviation.log_likelihood(yields.ln_absorbed - at_lights)
    density = prior.stokes_density(modes_nm[:, None] - peak_nm)
    weight = density / (share @ density) * np.exp(log_likelihood - log_likelihood.max())
    cumulated = np.cumsum(weight, axis=1)
    lost = cumulated[:, -1] == 0
    if lost.any():
        raise FitError(
            f"absorption: none of {CANDIDATES} shapes of the prior agrees both with the yields under the lights and "
            f"with an emission maximum at {modes_nm[lost][0]:g} nm; check the sessions of the other lights (same "
            "paint, correct laser power), or leave them out"
        )
    mean = share @ weight
    effective = int(mean.sum() ** 2 / (mean**2).sum())
    return Candidates(columns, at_lights, cumulated / cumulated[:, -1:], effective)


EXCITATION_NM: Floats = np.arange(300.0, 781.0, 5.0)
EXCITATION_NM.flags.writeable = False
REDRAWS = 40
LARGEST_YIELD_SD_REL = 0.5
FEWEST_SHAPES = 50
MEASURED_STOKES_SD_NM = 15.0
"""A Stokes shift with a larger standard deviation is belief, whatever was measured."""
_ONE_LIGHT = (
    "the Stokes shift comes from the prior: one laser at {laser:g} nm fixes absorption at {laser:g} nm only; measure "
    "the yield under further lights to learn the rest"
)
_SEVERAL_LIGHTS = (
    "yields under lights at {lights} nm constrain the absorption between them; elsewhere, and for the Stokes shift "
    "where no light lies near the edge of the absorption, the values come from the prior"
)
_BOUNDED = "; the reflectance only bounds the absorption from above"
_FEW_SHAPES = (
    "; the yields contradict the prior (only {shapes} absorption shapes fit): trust the curve only near the lights"
)


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
) -> Reradiation:
    """Return the posterior of the absorption, one draw for each emission draw.

    The emission draws keep their weights: yields judge absorption shapes, and an emission draw enters through its
    maximum, from which the prior of the Stokes shift counts. Energy is conserved: draws that would send out more
    photons than the paint can absorb, P(laser) a(l)/a(laser) > 1 - reflectance(l), are drawn again, and what still
    exceeds it is cut there, where the paint absorbs all that it does not reflect. Importance sampling from the prior;
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

    Returns
    -------
    Reradiation
        Absorption relative to the laser with its 95 % limits and draws, on a grid of 5 nm, and the Stokes shift.

    Raises
    ------
    FitError
        Emission draws do not fit the grid or hold no light above the laser; the first yield is not the laser's; a
        yield is not positive or its uncertainty not within 0 to 0.5; two lights have the same wavelength.
    """
    mode_nm = _modes(emission_draws_per_nm, wavelength_nm, laser_nm)
    seen = _relative_to_laser(yields, laser_nm)
    sampler = _Sampler(mode_nm, seen, prior, EXCITATION_NM, rng)
    most = 1 - (np.zeros(EXCITATION_NM.size) if least_reflectance is None else least_reflectance(EXCITATION_NM))
    ceiling = most / photon_yield(emission_draws_per_nm, wavelength_nm, laser_nm)[:, None]
    draws, shift_nm, rejected, violating = sampler.draw_below(ceiling)
    low95, high95 = np.quantile(draws, [0.025, 0.975], axis=0)
    return Reradiation(
        excitation_nm=EXCITATION_NM,
        laser_nm=laser_nm,
        absorption_rel=draws.mean(axis=0),
        low95=low95,
        high95=high95,
        absorption_rel_draws=draws,
        stokes_shift_nm=estimate(shift_nm),
        stokes_shift_draws_nm=shift_nm,
        measured_at_nm=tuple(light.excitation_nm for light in yields),
        prior_driven=len(yields) == 1 or float(shift_nm.std()) > MEASURED_STOKES_SD_NM,
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
        """Return absorptions, shifts (nm), and the shares first above the (N, E) ceiling and above it at the laser."""
        count = self.mode_nm.size
        draws, shift_nm = self.draw(np.arange(count))
        rows = np.flatnonzero((draws > ceiling).any(axis=1))
        rejected = rows.size / count
        for _ in range(REDRAWS - 1):
            if rows.size == 0:
                break
            draws[rows], shift_nm[rows] = self.draw(rows)
            rows = np.flatnonzero((draws > ceiling).any(axis=1))
        at_laser = np.abs(self.excitation_nm - self.yields.laser_nm).argmin()
        violating = float((ceiling[:, at_laser] < 1).mean())  # more than is absorbed at the laser itself
        return np.minimum(draws, ceiling), shift_nm, rejected, violating


def _modes(draws: Floats, wavelength_nm: Floats, laser_nm: float) -> Floats:
    """Return the wavelength of the maximum of each emission draw above the laser, nm."""
    if draws.ndim != 2 or draws.shape[1:] != wavelength_nm.shape or not np.isfinite(draws).all():
        raise FitError(
            "absorption: the emission draws must be finite and of shape (draws, wavelengths), but have shape "
            f"{draws.shape} on a grid of shape {wavelength_nm.shape}"
        )
    above = np.where(wavelength_nm > laser_nm, draws, 0.0)
    if not (above.max(axis=1, initial=0.0) > 0).all():
        raise FitError(
            f"absorption: an emission draw is 0 at all wavelengths above the laser's {laser_nm:g} nm; check the "
            "wavelengths"
        )
    return np.asarray(wavelength_nm[above.argmax(axis=1)])


def _relative_to_laser(yields: Sequence[ExcitationYield], laser_nm: float) -> LightYields:
    """Return what the lights say relative to the laser; refuse yields that cannot be used."""
    if not yields or yields[0].excitation_nm != laser_nm:
        first = f"{yields[0].excitation_nm:g} nm" if yields else "missing"
        raise FitError(
            f"absorption: the first yield must be the yield under the laser at {laser_nm:g} nm, but it is {first}; "
            "give the yield under the laser first"
        )
    for light in yields:
        if not (light.yield_rel > 0 and 0 < light.sd_rel <= LARGEST_YIELD_SD_REL):
            raise FitError(
                f"absorption: at {light.excitation_nm:g} nm the yield is {light.yield_rel:g} with relative "
                f"uncertainty {light.sd_rel:g}, but the yield must be above 0, and its uncertainty above 0 and at "
                f"most {LARGEST_YIELD_SD_REL:g}; measure this light longer, or leave it out"
            )
    if len({light.excitation_nm for light in yields}) < len(yields):
        raise FitError("absorption: two yields have the same excitation wavelength; average them first")
    lights_nm = np.array([light.excitation_nm for light in yields[1:]])
    ln_energy = np.array([np.log(light.yield_rel / yields[0].yield_rel) for light in yields[1:]])
    sd_rel = np.array([light.sd_rel for light in yields])
    return LightYields(laser_nm, lights_nm, ln_energy - np.log(lights_nm / laser_nm), sd_rel)


def _statement(yields: Sequence[ExcitationYield], laser_nm: float, bounded: bool, effective: int) -> str:
    """Say what the measurement fixes."""
    if len(yields) == 1:
        return _ONE_LIGHT.format(laser=laser_nm) + (_BOUNDED if bounded else "")
    lights = ", ".join(f"{light.excitation_nm:g}" for light in sorted(yields, key=lambda y: y.excitation_nm))
    few = _FEW_SHAPES.format(shapes=effective) if effective < FEWEST_SHAPES else ""
    return _SEVERAL_LIGHTS.format(lights=lights) + few


_SMALLEST_YIELD_SD_REL: Final = 1e-4  # draws that all agree still measure no yield better than this
_ABOVE_EXCITATION_NM: Final = 20.0  # emission is compared between lights only beyond the longest light's own line


def refuse_unfit_lights(bands: BandSignals, other_lights: Sequence[BandSignals]) -> None:
    """Refuse other lights of another paint or at a wavelength that was given already.

    Raises
    ------
    FitError
        The sessions are not of one paint, or two have the same excitation.
    """
    for light in other_lights:
        if light.paint_name != bands.paint_name:
            raise FitError(
                f"other lights: one session is of paint {light.paint_name!r}, but the first is of paint "
                f"{bands.paint_name!r}; give sessions of one paint. If both are, give it one name: paint_name in the "
                "plans, or --paint-name where 'finray import signals' read tables"
            )
    lights_nm = [light.optics.laser.wavelength_nm for light in (bands, *other_lights)]
    if len(set(lights_nm)) < len(lights_nm):
        raise FitError(
            f"other lights: two sessions have the same excitation wavelength (the first has {lights_nm[0]:g} nm, the "
            f"others have {', '.join(f'{nm:g}' for nm in lights_nm[1:])} nm); give one session per light"
        )


def excitation_yields(curves_per_nm: Mapping[float, Floats]) -> list[ExcitationYield]:
    """Return the yield of each light, all counted over the same emission wavelengths.

    The area of the emission above the longest light. Alone, the laser's yield constrains nothing, however uncertain
    it is; beside others a light that is too uncertain is for the absorption fit to refuse.

    Parameters
    ----------
    curves_per_nm
        (N, L) emission draws by excitation wavelength, nm; the laser's first.
    """
    counted = max(curves_per_nm) + _ABOVE_EXCITATION_NM <= WAVELENGTH_NM
    largest = LARGEST_YIELD_SD_REL if len(curves_per_nm) == 1 else np.inf
    yields = []
    for excitation_nm, curves in curves_per_nm.items():
        area = curves[:, counted].sum(axis=1)
        sd_rel = float(np.clip(area.std() / area.mean(), _SMALLEST_YIELD_SD_REL, largest))
        yields.append(ExcitationYield(excitation_nm, float(area.mean()), sd_rel))
    return yields
