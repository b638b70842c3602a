"""Absorption shapes drawn from the prior and weighted by yields, and their smooth departure from the family."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from finray_calib.fit.absorption_prior import AbsorptionPrior
from finray_calib.spectra.absorption import absorptance, smooth_covariance

Floats = NDArray[np.float64]
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
            f"absorption: none of {CANDIDATES} shapes of the prior agrees with the yields under the lights and an "
            f"emission maximum at {modes_nm[lost][0]:g} nm; check the other lights' sessions (same paint, laser power) "
            "or leave them out"
        )
    mean = share @ weight
    effective = int(mean.sum() ** 2 / (mean**2).sum())
    return Candidates(columns, at_lights, cumulated / cumulated[:, -1:], effective)
