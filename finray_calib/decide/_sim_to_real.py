"""How far the real curve may be from the simulated one, over the light angle: its prior, and what captures tell of it.

The error of the logarithm, t = ln(simulated / real), has four parts: the curve stands at other angles, as panel, mirror
and pad stand a little elsewhere; it has another shape, a random curve of any smoothness from 8 to 150 deg; edges of
shadows; and narrow reflections. A part of it is common to the image with and without contact; captures that are
compared with their own no-contact image do not see that part, and it keeps its prior.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from finray_calib.decide._capture_errors import CaptureErrors
from finray_calib.decide._gaussian_process import (
    LENGTHS_DEG,
    SMOOTHNESSES,
    CurvePosterior,
    CurvePrior,
    Observations,
    curve_posterior,
    quantiles,
)

Floats = NDArray[np.float64]

#: The curve of the finger is the simulated one at angles moved by as much (standard deviation, one for all places).
#: Where panel, mirror, pad and touch stand is known to some degrees as seen from the pad. On the flank of a lobe, 1 to
#: 2 % per deg, this is an error of about 10 %: shading models fitted to real sensors leave 20 to 33 % of the contact's
#: signal unexplained, 3 to 4 % of full scale, which is about a tenth of a pad's level.
MOVED_SD_DEG = 5.0
#: Prior of what is left, as standard deviation at an angle: lognormal, median 3 %, 95 % between 0.4 % and 21 %.
PRIOR_ERROR_REL = 0.03
PRIOR_ERROR_LOG_SD = 1.0
#: Prior of its length: lognormal, median 25 deg, sigma 0.8. No capture set varies the light's angle, so that edges of
#: shadows (some degrees) and a lobe that leans (the whole sweep) are both possible.
PRIOR_ERROR_LENGTH_DEG = 25.0
PRIOR_ERROR_LENGTH_LOG_SD = 0.8
#: Share of the variance that image with and without contact have in common. Nobody measured it. With three quarters,
#: captures that do not see that part take away a seventh of the sim-only bound at most.
COMMON_SHARE = 0.75
_NODES_REL = np.geomspace(0.002, 1.0, 21)
_LENGTHS_DEG = LENGTHS_DEG
_SMOOTHNESSES = SMOOTHNESSES

#: Two edges and a narrow reflection are each there with this probability, of a lognormal size (median, log sd).
EDGE_PROBABILITY = 0.5
EDGE_SIZE_REL, EDGE_SIZE_LOG_SD = 0.06, 0.8
_EDGE_WIDTHS_DEG, _GLINT_WIDTHS_DEG = (1.5, 10.0), (3.0, 15.0)
#: Beyond the ends of the grid a part of an edge or reflection still reaches in.
_BEYOND_DEG = 10.0
#: Shapes among which captures choose; a quarter of them have no edge.
_SHAPES = 500


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Hold the posterior of t, where captured curve = simulated curve * exp(-t), at one or more places.

    Attributes
    ----------
    visible : CurvePosterior
        The part that captures observe: all of t where absolute ratios are compared or there is no capture, else the
        part that belongs to the contact. The shape alone: without movement, edges and reflections.
    hidden : CurvePosterior or None
        Prior of the part that captures do not observe.
    noise : ndarray, shape (N, N)
        Covariance of the log errors at the captures, with what the uncertainty of the angles adds.
    """

    visible: CurvePosterior
    hidden: CurvePosterior | None
    noise: Floats
    _seen: Observations
    _ln_curves: Floats

    @cached_property
    def amplitude_quantiles_rel(self) -> tuple[float, float, float]:
        """Quantiles of the standard deviation of t at an angle, 2.5 %, 50 % and 97.5 %, without edges."""
        weights, amplitudes = self.visible.amplitude_weights, _NODES_REL
        if self.hidden is not None:
            weights = np.outer(weights, self.hidden.amplitude_weights).ravel()
            amplitudes = np.hypot.outer(_NODES_REL, _NODES_REL).ravel()
        low, median, high = quantiles(weights, amplitudes, (0.025, 0.5, 0.975))
        return low, median, high

    def draws(self, draws: int, rng: np.random.Generator) -> Floats:
        """Return joint draws (draws, C, G) of t, with the unknown scale of the first rig.

        Movement, edges and reflections are drawn from their prior and weighted by the likelihood of the captures,
        summed over smoothness, length and amplitude of the rest (importance sampling).
        """
        grid, at = self.visible.grid_deg, self._seen.angles_deg
        count = _SHAPES if at.size else draws
        everywhere = edges_and_glints(np.concatenate([grid, at]), count, grid, rng)
        moved, moved_at = self._moved(count, rng)
        shapes, shapes_at = everywhere[:, None, : grid.size] + moved, everywhere[:, grid.size :] + moved_at
        # what moves or cuts the common part is not seen by captures that see the contact's part only
        seen = np.ones(len(shapes)) if self.hidden is None else rng.random(len(shapes)) >= COMMON_SHARE
        if at.size:
            values = self._seen.values - seen[:, None] * shapes_at
            ln_weights = self.visible.ln_likelihood(values)
            weights = np.exp(ln_weights - ln_weights.max()).ravel()
            picked = rng.choice(weights.size, size=draws, p=weights / weights.sum())
            nodes, shape = np.divmod(picked, len(shapes))
            curves = self.visible.draws(draws, rng, values[shape], nodes)
        else:
            shape = np.arange(draws)
            curves = self.visible.draws(draws, rng)
        curves += shapes[shape]
        if self.hidden is not None:
            curves += self.hidden.draws(draws, rng)
        return np.asarray(curves)

    def _moved(self, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return draws of ln(f(angle) / f(angle + by)), one `by` for all places, beyond the sweep as at its ends.

        On the grid (count, C, G), and at the captures (count, N).
        """
        grid = self.visible.grid_deg
        by_deg = MOVED_SD_DEG * rng.standard_normal(count)
        places = [ln - np.interp(np.add.outer(by_deg, grid), grid, ln) for ln in self._ln_curves]
        moved = np.stack(places, axis=1)
        at = [
            [np.interp(angle, grid, row) for row in moved[:, contact]]
            for angle, contact in zip(self._seen.angles_deg, self._seen.contact, strict=True)
        ]
        return moved, np.array(at).reshape(-1, count).T


def edges_and_glints(angles_deg: Floats, count: int, grid_deg: Floats, rng: np.random.Generator) -> Floats:
    """Return draws (count, A) of ln(simulated / real) by up to two edges of shadows and by a narrow reflection.

    b tanh((angle - at) / width) with a width of 1.5 to 10 deg, and b exp(-((angle - at) / width)^2 / 2) with one of 3
    to 15 deg, at any angle, either way; each is there with a probability of 1/2, its size b lognormal (median 6 %,
    log sd 0.8). Where captures stand between them, they see such steps; a reflection narrower than the gap between
    two captures they do not see.

    Parameters
    ----------
    angles_deg : ndarray, shape (A,)
        Where.
    count : int
    grid_deg : ndarray, shape (G,)
        The sweep, inside which edges lie.
    rng : numpy.random.Generator
    """
    total = np.zeros((count, angles_deg.size))
    for low_deg, high_deg in (_EDGE_WIDTHS_DEG, _EDGE_WIDTHS_DEG, _GLINT_WIDTHS_DEG):
        is_there = rng.random((count, 1)) < EDGE_PROBABILITY
        size = EDGE_SIZE_REL * np.exp(EDGE_SIZE_LOG_SD * rng.standard_normal((count, 1)))
        size *= is_there * rng.choice([-1.0, 1.0], (count, 1))
        at = rng.uniform(grid_deg[0] - _BEYOND_DEG, grid_deg[-1] + _BEYOND_DEG, (count, 1))
        distance = (angles_deg - at) / np.exp(rng.uniform(np.log(low_deg), np.log(high_deg), (count, 1)))
        is_edge = low_deg == _EDGE_WIDTHS_DEG[0]
        total += size * (np.tanh(distance) if is_edge else np.exp(-(distance**2) / 2))
    return total


def discrepancy_posterior(errors: CaptureErrors, ln_curves: Floats, grid_deg: Floats) -> Discrepancy:
    """Return what captures say about the sim-to-real error at every angle and place; without captures, the prior.

    The error's smoothness (Matern 1/2, 3/2, 5/2), length (8 to 150 deg) and amplitude are summed over, see
    `curve_posterior`; so is, for several places, the share of it that they have in common. The noise of a capture holds
    the covariance of the reports and (slope * angle uncertainty)^2: the capture was taken at an angle that is known so
    well only. Absolute ratios observe t up to the scale of their rig (flat prior); errors relative to the no-contact
    image of each capture observe the part of the contact only, a quarter of the prior variance.

    Parameters
    ----------
    errors : CaptureErrors
    ln_curves : ndarray, shape (C, G)
        Logarithm of the simulated curve at each place. Moving it is a part of the error, and its slope tells what
        the uncertain angle of a capture does.
    grid_deg : ndarray, shape (G,)

    Returns
    -------
    Discrepancy

    References
    ----------
    M. C. Kennedy, A. O'Hagan, Bayesian calibration of computer models, J. R. Statist. Soc. B 63 (2001), 425-464.
    """
    contacts = len(ln_curves)
    slopes = np.gradient(ln_curves, grid_deg, axis=1)
    slope = np.array(
        [
            np.interp(angle, grid_deg, slopes[contact])
            for angle, contact in zip(errors.angles_deg, errors.contact, strict=True)
        ]
    )
    noise = errors.covariance + np.diag((slope * errors.angle_sd_deg) ** 2)
    seen = Observations(errors.angles_deg, errors.log_error, noise, _scale_indicator(errors), errors.contact)
    if not errors.names or errors.scale_of is not None:
        return Discrepancy(curve_posterior(_prior(1.0), seen, grid_deg, contacts), None, noise, seen, ln_curves)
    none = Observations(np.empty(0), np.empty(0), np.empty((0, 0)), np.empty((0, 0)), np.empty(0, dtype=np.int64))
    visible = curve_posterior(_prior(1.0 - COMMON_SHARE), seen, grid_deg, contacts)
    return Discrepancy(visible, curve_posterior(_prior(COMMON_SHARE), none, grid_deg, contacts), noise, seen, ln_curves)


def _prior(share: float) -> CurvePrior:
    """Return the prior of a part of the error that has this share of its variance."""
    return CurvePrior(
        PRIOR_ERROR_LENGTH_DEG,
        PRIOR_ERROR_LENGTH_LOG_SD,
        PRIOR_ERROR_REL * float(np.sqrt(share)),
        PRIOR_ERROR_LOG_SD,
        _NODES_REL,
        _SMOOTHNESSES,
        _LENGTHS_DEG,
    )


def _scale_indicator(errors: CaptureErrors) -> Floats:
    """Return (N, scales): 1 where a capture has that unknown scale; no column where none is unknown."""
    if errors.scale_of is None:
        return np.zeros((errors.angles_deg.size, 0))
    return np.equal.outer(errors.scale_of, np.unique(errors.scale_of)).astype(np.float64)
