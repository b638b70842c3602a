"""Random curves over the light angle that may have one pointed place: a kink, or a cusp where the slope is infinite.

A Gaussian process spreads its roughness over all angles, so that a curve that is smooth but for its top is taken to be
smooth there as well, and its top between two angles of a sweep to be known. Light has such points: where a shadow
begins, a slope changes at once; where light is totally reflected, or passes a straight edge at a grazing angle, the
curve goes as the square root of the distance.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from finray_calib.decide._gaussian_process import CurvePosterior, CurvePrior, Observations, curve_posterior

Floats = NDArray[np.float64]

#: A curve has a pointed place with this probability, at any angle of the grid, with either exponent.
POINTED_PROBABILITY = 0.5
#: Beside the pointed place the curve goes as the distance to this power: a cusp, and a kink.
EXPONENTS = (0.5, 1.0)
#: Standard deviation of what it adds at this distance: lognormal, median 20 % of the mean curve, log sd 1.
SIZE_AT_DEG = 30.0
POINTED_SIZE_REL, POINTED_SIZE_LOG_SD = 0.2, 1.0
SIZES_REL = np.geomspace(0.05, 0.8, 4)


@dataclass(frozen=True, eq=False)
class PointedPosterior:
    """Hold what observations say about one random curve that may have a pointed place.

    The curve is a Gaussian process with an unknown constant, `smooth`, plus, with a probability of 1/2, b_1 |d|^p
    before and b_2 |d|^p beyond a place from which the angle is d away. Place, exponent and size of b are summed over,
    like smoothness, length and amplitude of the process; b_1 and b_2 are independent and normal.

    Attributes
    ----------
    smooth : CurvePosterior
        Of the curve without a pointed place.
    """

    smooth: CurvePosterior
    _sides: Floats  # (G + N, F, 2): what a unit of b_1 and b_2 adds on the grid and to the values, for each of F places
    _precision: Floats  # (parts, A, F, 2, 2) and
    _pull: Floats  # (parts, A, F, 2): information of the values on b_1 and b_2
    _plain: Floats  # (parts, A): weights of curves without a pointed place
    _pointed: Floats  # (parts, A, F, sizes): of curves with one

    @property
    def grid_deg(self) -> Floats:
        """Angles of the curve, shape (G,)."""
        return self.smooth.grid_deg

    @property
    def seen(self) -> Observations:
        """Values of the curve."""
        return self.smooth.seen

    @cached_property
    def mean(self) -> Floats:
        """Expected curve with its constant, shape (1, G)."""
        size, found = self.grid_deg.size, np.zeros(self.grid_deg.size)
        for number, weights in enumerate(self._weights):
            precision, pull = self._precision[number][:, :, None], self._pull[number][:, :, None]
            sides = _mean_of_sizes(precision, pull, SIZES_REL)
            first = np.einsum("afs,afsi->afi", self._pointed[number], sides)
            left = weights[:, None] * self.seen.values - np.einsum("nfi,afi->an", self._sides[size:], first)
            found += np.einsum("agn,an->g", self.smooth.response(number), left)
            found += np.einsum("gfi,afi->g", self._sides[:size], first)
        return found[None]

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (G, G) of the curve with its constant."""
        size, found = self.grid_deg.size, self.smooth.second_moment(self._weights)
        on_grid, at_seen = self._sides[:size], self._sides[size:]
        flat_grid, flat_seen = on_grid.reshape(size, -1), at_seen.reshape(len(at_seen), -1)
        of_sides = np.zeros((flat_grid.shape[1] // 2, 2, 2))
        for number in range(len(self._weights)):
            of_values, (first, second) = self.smooth.response(number), self._sides_of(number)
            # a unit of b adds to the expected curve its sides less what they change in what is left of the values
            added = np.einsum("gfi,afi->ag", on_grid, first, optimize=True)
            added -= np.einsum("agn,an->ag", of_values, np.einsum("nfi,afi->an", at_seen, first, optimize=True))
            both = (of_values @ self.seen.values).T @ added
            # the square of that, multiplied out: no array of grid x places x amplitudes
            half = np.einsum("nfi,afij->anfj", at_seen, second, optimize=True).reshape(len(second), len(at_seen), -1)
            weighted = np.moveaxis(of_values, 1, 0).reshape(size, -1)
            both -= weighted @ (half @ flat_grid.T).reshape(-1, size)
            found += both + both.T
            found += np.moveaxis(of_values @ (half @ flat_seen.T), 1, 0).reshape(size, -1) @ weighted.T
            of_sides += second.sum(axis=0)
        found += np.einsum("gfi,fij->gfj", on_grid, of_sides).reshape(size, -1) @ flat_grid.T
        return found - np.outer(self.mean[0], self.mean[0])

    @property
    def _weights(self) -> Floats:
        """Weights (parts, A) of smoothness, length and amplitude, with and without a pointed place."""
        return np.asarray(self._plain + self._pointed.sum(axis=(2, 3)))

    def _sides_of(self, number: int) -> tuple[Floats, Floats]:
        """Return the expected b (A, F, 2) of one part and its expected square (A, F, 2, 2), times the weights."""
        precision, pull, weights = self._precision[number], self._pull[number], self._pointed[number]
        sides, covariance = _of_sizes(precision[:, :, None], pull[:, :, None], SIZES_REL)
        square = covariance + sides[..., None] * sides[..., None, :]
        return np.einsum("afs,afsi->afi", weights, sides), np.einsum("afs,afsij->afij", weights, square)

    def draws(self, count: int, rng: np.random.Generator) -> Floats:
        """Return joint draws (count, 1, G) of the curve with its constant."""
        weights = np.concatenate([self._plain.ravel(), self._pointed.ravel()])
        picked = rng.choice(weights.size, size=count, p=weights)
        normals = rng.standard_normal((count, 2, 1))
        first = self._plain.size
        part, amplitude, place, size = np.unravel_index(np.maximum(picked - first, 0), self._pointed.shape)
        nodes = np.where(picked < first, picked, part * self._plain.shape[1] + amplitude)
        at = (part, amplitude, place)
        sides, covariance = _of_sizes(self._precision[at], self._pull[at], SIZES_REL[size])
        sides = np.where(picked[:, None] < first, 0.0, sides + (np.linalg.cholesky(covariance) @ normals)[..., 0])
        added = np.einsum("nki,ki->kn", self._sides[:, place], sides)
        grid = self.grid_deg.size
        rest = self.smooth.draws(count, rng, self.seen.values - added[:, grid:], nodes)
        return np.asarray(rest + added[:, None, :grid])


def pointed_posterior(prior: CurvePrior, seen: Observations, grid_deg: Floats) -> PointedPosterior:
    """Return what observations say about one random curve that may have a kink or a cusp.

    With W of the curve without it (see `curve_posterior`), U (N, 2) what the two sides add to the values for a unit of
    b, and b ~ N(0, s^2 I),

    G = U' W U,  h = U' W y,  b | y ~ N((G + I / s^2)^-1 h, (G + I / s^2)^-1),
    p(y | place, p, s) = p(y) |I + s^2 G|^-1/2 exp(h' (G + I / s^2)^-1 h / 2).

    Parameters
    ----------
    prior : CurvePrior
        Of the curve without it.
    seen : Observations
        Of one curve.
    grid_deg : ndarray, shape (G,)
        Angles of the curve, at each of which the pointed place may be.

    Returns
    -------
    PointedPosterior
    """
    smooth = curve_posterior(prior, seen, grid_deg)
    angles = np.concatenate([grid_deg, seen.angles_deg])
    sides = np.concatenate([_beside(angles, grid_deg, exponent) for exponent in EXPONENTS], axis=1)
    at_seen = sides[grid_deg.size :]
    shape = (len(smooth.parts), prior.amplitudes_rel.size, sides.shape[1], 2)
    precision, pull = np.empty((*shape, 2)), np.empty(shape)
    for number, part in enumerate(smooth.parts):  # by itself: together they hold hundreds of MB
        solved = np.einsum("anm,mfi->anfi", part.solve, at_seen, optimize=True)
        precision[number] = np.einsum("nfi,anfj->afij", at_seen, solved, optimize=True)
        pull[number] = np.einsum("n,anfi->afi", seen.values, solved, optimize=True)
    ln_size = -0.5 * (np.log(SIZES_REL / POINTED_SIZE_REL) / POINTED_SIZE_LOG_SD) ** 2
    mean = _mean_of_sizes(precision[:, :, :, None], pull[:, :, :, None], SIZES_REL)
    ln_gain = 0.5 * np.einsum("pafsi,pafi->pafs", mean, pull) - 2 * np.log(SIZES_REL)
    ln_gain -= 0.5 * np.log(_with_prior(precision[:, :, :, None], SIZES_REL)[3])
    ln_gain += ln_size - np.log(np.exp(ln_size).sum() * sides.shape[1])
    ln_plain = np.array([part.ln_weight for part in smooth.parts])
    ln_pointed = ln_gain + ln_plain[..., None, None]
    largest = max(ln_plain.max(), ln_pointed.max())
    plain = (1 - POINTED_PROBABILITY) * np.exp(ln_plain - largest)
    pointed = POINTED_PROBABILITY * np.exp(ln_pointed - largest)
    total = plain.sum() + pointed.sum()
    return PointedPosterior(smooth, sides, precision, pull, plain / total, pointed / total)


def _beside(angles_deg: Floats, places_deg: Floats, exponent: float) -> Floats:
    """Return |d|^p (N, F, 2) before and beyond each place, relative to that at 30 deg."""
    distance = np.subtract.outer(angles_deg, places_deg) / SIZE_AT_DEG
    return np.stack([np.maximum(-distance, 0.0) ** exponent, np.maximum(distance, 0.0) ** exponent], axis=-1)


def _of_sizes(precision: Floats, pull: Floats, sizes: Floats) -> tuple[Floats, Floats]:
    """Return mean (..., 2) and covariance (..., 2, 2) of b for standard deviations (...) of it."""
    one, two, both, determinant = _with_prior(precision, sizes)
    covariance = np.stack([two, -both, -both, one], axis=-1) / determinant[..., None]
    return _mean_of_sizes(precision, pull, sizes), covariance.reshape(*one.shape, 2, 2)


def _mean_of_sizes(precision: Floats, pull: Floats, sizes: Floats) -> Floats:
    """Return the mean (..., 2) of b; written out, as a million systems of two equations are solved."""
    one, two, both, determinant = _with_prior(precision, sizes)
    before, beyond = pull[..., 0], pull[..., 1]
    pair = (two * before - both * beyond, one * beyond - both * before)
    return np.asarray(np.stack(pair, axis=-1) / determinant[..., None])


def _with_prior(precision: Floats, sizes: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return both diagonal elements (...), the other one and the determinant of G + I / s^2."""
    one, two = (precision[..., k, k] + 1 / sizes**2 for k in (0, 1))
    both = np.broadcast_to(precision[..., 0, 1], one.shape)
    return one, two, both, one * two - both**2
