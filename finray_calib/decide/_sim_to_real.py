"""How far the real curve may be from the simulated one, over the light angle: its prior, and what captures tell of it.

The error of the logarithm, t = ln(simulated / real), has four parts: the curve stands at other angles, as panel, mirror
and pad stand a little elsewhere; it has another shape, a random curve of any smoothness from 8 to 150 deg; edges of
shadows; and narrow reflections. A part of it is common to the image with and without contact; captures that are
compared with their own no-contact image see an unknown share of the error only, and perhaps nothing.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

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
Indices = NDArray[np.int64]

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
#: These sizes hold for a curve whose logarithm has this standard deviation over the angle, as sweeps of a pad have
#: (0.1 to 0.4). Errors of models are mostly found as a share of the signal; so with this probability, those of a
#: curve that varies less are less in proportion. What the model lacks altogether is not.
USUAL_CONTRAST = 0.3
PROPORTIONAL_PROBABILITY = 0.5
#: Captures beside their own no-contact images see with this probability next to nothing of the error, as both images
#: share panel, coat and camera; else any share of it, all alike likely. Nobody measured it.
BLIND_PROBABILITY = 0.5
_LEAST_SHARE = 0.02
_LEAST_CONTRAST_REL = 0.02
_NODES_REL = np.geomspace(0.002, 1.0, 21)

#: Two edges and a narrow reflection are each there with this probability, of a lognormal size (median, log sd).
EDGE_PROBABILITY = 0.5
EDGE_SIZE_REL, EDGE_SIZE_LOG_SD = 0.06, 0.8
_EDGE_WIDTHS_DEG, _GLINT_WIDTHS_DEG = (1.5, 10.0), (3.0, 15.0)
#: Beyond the ends of the grid a part of an edge or reflection still reaches in.
_BEYOND_DEG = 10.0
#: Shapes among which captures choose; a quarter of them have no edge.
_SHAPES = 500


@dataclass(frozen=True, slots=True)
class ErrorDraws:
    """Hold joint draws (S, C, G) of the sim-to-real error.

    Attributes
    ----------
    whole : ndarray
        The error, with the unknown scale of the first rig.
    seen : ndarray
        What one more capture of the same kind would see of it; without captures, the error less its mean over the grid.
    """

    whole: Floats
    seen: Floats


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Hold the posterior of t, where captured curve = simulated curve * exp(-t), at one or more places.

    Attributes
    ----------
    visible : CurvePosterior
        The part that captures observe: all of t where absolute ratios are compared or there is no capture, else the
        part that belongs to the contact. The shape alone: without movement, edges and reflections.
    hidden : CurvePosterior or None
        The part that captures do not observe, of unit standard deviation; its size follows from that of the visible
        part and the share that is seen.
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
        share, share_weights = np.ones(1), np.ones(1)
        if self.hidden is not None:
            share, share_weights = np.linspace(_LEAST_SHARE, 1.0, 21), np.full(21, (1 - BLIND_PROBABILITY) / 21)
            share_weights[0] += BLIND_PROBABILITY
        root = np.sqrt(share)
        prior = (1 - PROPORTIONAL_PROBABILITY) * np.exp(_ln_prior(root))
        prior += PROPORTIONAL_PROBABILITY * np.exp(_ln_prior(root * self._contrast_share))
        weights = self.visible.amplitude_weights[:, None] * share_weights * prior / np.exp(_ln_prior(np.ones(1)))
        amplitudes = np.divide.outer(_NODES_REL, root)
        low, median, high = quantiles(weights.ravel() / weights.sum(), amplitudes.ravel(), (0.025, 0.5, 0.975))
        return low, median, high

    @property
    def captures(self) -> int:
        """Number of captures N."""
        return int(self._seen.angles_deg.size)

    def draws(self, draws: int, rng: np.random.Generator) -> ErrorDraws:
        """Return joint draws of t, with the unknown scale of the first rig.

        Movement, edges, reflections, whether sizes go with the contrast of the curve, and the share that captures see
        are drawn from their prior and weighted by the likelihood of the captures, summed over smoothness, length and
        amplitude of the rest (importance sampling).
        """
        shapes = self._shapes(_SHAPES if self.captures else draws, rng)
        part_of, amplitude_of, shape = self._picked(shapes, draws, rng)
        values = self._seen.values - shapes.at_captures[shape]
        nodes = part_of * _NODES_REL.size + amplitude_of
        visible = self.visible.draws(draws, rng, values, nodes)
        curves = visible + shapes.curves[shape]
        if self.hidden is None:
            seen = curves if self.captures else curves - curves.mean(axis=2, keepdims=True)
            return ErrorDraws(curves, seen)
        unseen = _NODES_REL[amplitude_of] * np.sqrt(1 / shapes.seen_share[shape] - 1)
        curves += unseen[:, None, None] * self.hidden.draws(draws, rng, nodes=part_of)
        return ErrorDraws(curves, visible + shapes.seen[shape])

    def _picked(self, shapes: "_Shapes", draws: int, rng: np.random.Generator) -> tuple[Indices, Indices, Indices]:
        """Return for each draw the part (smoothness and length) and the amplitude of the rest, and the shape."""
        if self.captures:
            ln_weights = self.visible.ln_likelihood(self._seen.values - shapes.at_captures)
            ln_weights += _ln_prior(shapes.size) - _ln_prior(np.ones(1))
            weights = np.exp(ln_weights - ln_weights.max()).ravel()
            picked = rng.choice(weights.size, size=draws, p=weights / weights.sum())
            part_of, amplitude_of, shape = np.unravel_index(picked, ln_weights.shape)
            return part_of, amplitude_of, shape
        weights = self.visible.weights.sum(axis=1)
        ln_amplitude = _ln_prior(shapes.size)
        # the largest of logarithms with Gumbel noise is a draw by their weights
        amplitude_of = (ln_amplitude + rng.gumbel(size=ln_amplitude.shape)).argmax(axis=0)
        return rng.choice(weights.size, size=draws, p=weights), amplitude_of, np.arange(draws)

    def _shapes(self, count: int, rng: np.random.Generator) -> "_Shapes":
        """Return draws of what is not a Gaussian process, and what they make of the sizes of the rest."""
        grid, at = self.visible.grid_deg, self._seen.angles_deg
        features = edges_and_glints(np.concatenate([grid, at]), count, grid, rng)
        moved, moved_at = self._moved(count, rng)
        size = np.where(rng.random(count) < PROPORTIONAL_PROBABILITY, self._contrast_share, 1.0)
        share, is_seen = np.ones(count), np.ones(count)
        if self.hidden is not None:
            share = rng.uniform(_LEAST_SHARE, 1.0, count)
            share[rng.random(count) < BLIND_PROBABILITY] = _LEAST_SHARE
            is_seen = (rng.random(count) < share).astype(np.float64)
        features *= size[:, None]
        features, features_at = features[:, None, : grid.size], is_seen[:, None] * features[:, grid.size :]
        return _Shapes(
            curves=features + moved,
            seen=is_seen[:, None, None] * features + share[:, None, None] * moved,
            at_captures=features_at + share[:, None] * moved_at,
            seen_share=share,
            size=size * np.sqrt(share),
        )

    @property
    def _contrast_share(self) -> float:
        """Standard deviation of the log curves over the angle as a share of the usual one, at most 1."""
        contrast = float(np.sqrt(self._ln_curves.var(axis=1).mean()))
        return float(np.clip(contrast / USUAL_CONTRAST, _LEAST_CONTRAST_REL, 1.0))

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


@dataclass(frozen=True, slots=True)
class _Shapes:
    """Hold S draws of t without its Gaussian process, of what captures see of it, and of the share they see.

    `curves` and `seen` (S, C, G), `at_captures` (S, N), `seen_share` and `size` (S,), the factor of the amplitude of
    what they see of the rest.
    """

    curves: Floats
    seen: Floats
    at_captures: Floats
    seen_share: Floats
    size: Floats


def _ln_prior(factor: Floats) -> Floats:
    """Return the log prior (A, S) of the amplitudes that are summed over: lognormal, its median times each factor."""
    ln = -0.5 * (np.log(np.divide.outer(_NODES_REL, factor) / PRIOR_ERROR_REL) / PRIOR_ERROR_LOG_SD) ** 2
    return np.asarray(log_softmax(ln, axis=0))


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
    well only. Absolute ratios observe t up to the scale of their rig (flat prior). Errors relative to the no-contact
    image of each capture observe a share s of it, which nobody measured: with a probability of 1/2 next to nothing,
    else uniform from 0 to 1. Of the random curve they see a part with the variance s a^2, beside a hidden one with
    (1 - s) a^2 of the same smoothness and length; of the movement the share s; and edges and reflections with the
    probability s. A small visible error so says that the whole is small, or that the share is.

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
        return Discrepancy(curve_posterior(_prior(), seen, grid_deg, contacts), None, noise, seen, ln_curves)
    none = Observations(np.empty(0), np.empty(0), np.empty((0, 0)), np.empty((0, 0)), np.empty(0, dtype=np.int64))
    visible = curve_posterior(_prior(), seen, grid_deg, contacts)
    unit = replace(_prior(), amplitude_rel=1.0, amplitudes_rel=np.ones(1))
    return Discrepancy(visible, curve_posterior(unit, none, grid_deg, contacts), noise, seen, ln_curves)


def _prior() -> CurvePrior:
    """Return the prior of the shape."""
    return CurvePrior(
        PRIOR_ERROR_LENGTH_DEG,
        PRIOR_ERROR_LENGTH_LOG_SD,
        PRIOR_ERROR_REL,
        PRIOR_ERROR_LOG_SD,
        _NODES_REL,
        SMOOTHNESSES,
        LENGTHS_DEG,
    )


def _scale_indicator(errors: CaptureErrors) -> Floats:
    """Return (N, scales): 1 where a capture has that unknown scale; no column where none is unknown."""
    if errors.scale_of is None:
        return np.zeros((errors.angles_deg.size, 0))
    return np.equal.outer(errors.scale_of, np.unique(errors.scale_of)).astype(np.float64)
