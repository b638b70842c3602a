"""Draws of everything a comparison rests on and does not know exactly: paints, camera, pose, drift, render noise.

The inputs are known before the capture only so far; a camera whose blue is uncertain by 30 % makes most draws miss the
picture by far more than the true camera does. A squared error averaged over such draws is that of wrong cameras. So the
draws can be conditioned on the mean levels of parts of both captured images, with a model error of unknown size in
each: what the inputs cannot explain, or need not, stays an error of the model. Propagation is adaptive: draws are added
until the numbers that are printed no longer change.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import TactileCapture
from finray_calib.compare._region_sums import RenderLayers
from finray_calib.compare._regions import every_channel

Floats = NDArray[np.float64]
DRIFT, WALLS, PIXELS = "drift of the light", "render noise of the walls", "pixel noise of render and capture"
POSE = {"depth_mm": "depth of the indenter", "position_mm": "position of the indenter"}
#: Before any repeat is seen: two captures of one scene differ by about this in level (real sensors: 0.3 to 2 %), with
#: the weight of three observations.
PRIOR_DRIFT_REL, PRIOR_OBSERVATIONS = 0.007, 3
# a factor is never negative, whatever the tail of its distribution says
_LEAST_FACTOR = 1e-3
#: Noise that all pixels of a band share, from the bake of the walls; the same weight.
PRIOR_WALLS_REL = 0.012


@dataclass(frozen=True, slots=True)
class Inputs:
    """Hold the uncertain inputs of one comparison.

    Attributes
    ----------
    layers : RenderLayers
    pose_sd_mm : Mapping of str to float
        Standard uncertainty of the pose, for the derivatives that the render has.
    drift : tuple of (float, int), or None
        Scale and degrees of freedom of a Student t for the relative change of the light between two captures.
    walls : tuple of (ndarray of shape (L,), int), or None
        Scale per layer and degrees of freedom of the render noise that all pixels share.
    """

    layers: RenderLayers
    pose_sd_mm: Mapping[str, float]
    drift: tuple[float, int] | None
    walls: tuple[Floats, int] | None

    @property
    def pose_names(self) -> tuple[str, ...]:
        """Derivatives that are used."""
        return tuple(self.pose_sd_mm)

    @property
    def names(self) -> tuple[str, ...]:
        """All uncertain inputs but the pixels' noise."""
        known = self.layers.inputs.names if self.layers.inputs is not None else ()
        walls = (WALLS,) if self.walls is not None else ()
        drift = (DRIFT,) if self.drift is not None else ()
        return (*known, *(POSE[name] for name in self.pose_names), *walls, *drift)

    def draw(self, draws: int, rng: np.random.Generator, paired: bool = False) -> "InputDraws":
        """Return draws of all inputs from what is known of them before the capture is looked at.

        Parameters
        ----------
        draws
            Number of draws.
        rng
            Of what belongs to this comparison alone.
        paired
            Take the draws of paints and camera in their stored order, so that draw i is the same in every comparison
            that rests on them; else in random order.
        """
        shape = (draws, *self.layers.matrix.shape)
        factors = {}
        known = self.layers.inputs
        for i, name in enumerate(known.names if known is not None else ()):
            if known is not None:
                stored = known.factors.shape[1]
                order = np.arange(draws) % stored if paired else rng.integers(stored, size=draws)
                factors[name] = np.log(np.maximum(known.factors[i, order].astype(np.float64), _LEAST_FACTOR))
        if self.walls is not None:
            scale, freedom = self.walls
            t = np.maximum(scale * rng.standard_t(freedom, (draws, 1, shape[2])), _LEAST_FACTOR - 1.0)
            factors[WALLS] = np.broadcast_to(np.log1p(t), shape)
        moves = {POSE[name]: sd * rng.standard_normal(draws) for name, sd in self.pose_sd_mm.items()}
        drift = np.zeros(draws)
        if self.drift is not None:
            drift = np.log1p(np.maximum(self.drift[0] * rng.standard_t(self.drift[1], draws), _LEAST_FACTOR - 1.0))
        return InputDraws(self.layers.matrix, factors, moves, drift)

    def best(self) -> "InputDraws":
        """Return a single draw that holds the best values."""
        none = {POSE[name]: np.zeros(1) for name in self.pose_names}
        return InputDraws(self.layers.matrix, {}, none, np.zeros(1))


@dataclass(frozen=True, slots=True)
class InputDraws:
    """Hold draws of all inputs.

    Attributes
    ----------
    matrix_best : ndarray, shape (3, L)
        From layers to RGB at the best values.
    log_factors : Mapping of str to ndarray, shape (draws, 3, L)
        Logarithm of what each input multiplies the matrix by.
    moves_mm : Mapping of str to ndarray, shape (draws,)
        Of the pose.
    log_drift : ndarray, shape (draws,)
        Logarithm of the factor that brings the contact capture to the light of the no-contact image.
    """

    matrix_best: Floats
    log_factors: Mapping[str, Floats]
    moves_mm: Mapping[str, Floats]
    log_drift: Floats

    @property
    def matrix(self) -> Floats:
        """Matrices (draws, 3, L)."""
        total = np.zeros((len(self.log_drift), *self.matrix_best.shape))
        for factor in self.log_factors.values():
            total = total + factor
        return np.asarray(self.matrix_best * np.exp(total))

    @property
    def weights(self) -> Floats:
        """Weights (draws, 3, L (1 + poses)) of the layers and of their derivatives."""
        matrix = self.matrix
        return np.concatenate([matrix, *(matrix * move[:, None, None] for move in self.moves_mm.values())], axis=2)

    @property
    def drift(self) -> Floats:
        """Factors on the contact capture (draws,)."""
        return np.asarray(np.exp(self.log_drift))

    def only(self, name: str) -> "InputDraws":
        """Return draws in which one input varies and the others keep their mean."""

        def kept(key: str, values: Floats) -> Floats:
            return values if key == name else np.broadcast_to(values.mean(axis=0), values.shape)

        return InputDraws(
            self.matrix_best,
            {key: kept(key, values) for key, values in self.log_factors.items()},
            {key: kept(key, values) for key, values in self.moves_mm.items()},
            kept(DRIFT, self.log_drift),
        )


def inputs_of(
    layers: RenderLayers, capture: TactileCapture, no_contact: Floats, repeat: Floats | None, pad: NDArray[np.bool_]
) -> Inputs:
    """Collect what is uncertain in the comparison of a render with a capture in linear light.

    The change of light between two captures is a Student t whose scale joins a prior with the change between the
    no-contact image and its repeat; the noise that all pixels of a layer share likewise, with the difference of the
    render's halves.

    Parameters
    ----------
    layers
        The render.
    capture
        States the uncertainty of the pose.
    no_contact, repeat : ndarray, shape (H, W, 3)
        Captured; NaN where clipped.
    pad : ndarray of bool, shape (H, W)
        Pixels that see the pad.
    """
    changes = np.array([]) if repeat is None else np.array([_level_change(no_contact, repeat, pad)])
    walls = None
    if layers.inputs is not None and layers.contact_half.any():
        first, second = layers.halves("no_contact", pad)
        change = ((first - second) / 2.0).sum(axis=0) / np.maximum(np.abs(first + second).sum(axis=0) / 2.0, 1e-300)
        # the LED's own light does not come from a wall
        from_walls = np.array([name != "led" for name in layers.names])
        scale, freedom = _scale(PRIOR_WALLS_REL, change[None])
        walls = (np.where(from_walls, scale, 0.0), freedom)
    drift_scale, drift_freedom = _scale(PRIOR_DRIFT_REL, changes[:, None])
    return Inputs(layers, pose_sd_mm(layers, capture), (float(drift_scale[0]), drift_freedom), walls)


def pose_sd_mm(layers: RenderLayers, capture: TactileCapture) -> dict[str, float]:
    """Return the standard uncertainty of the pose that the capture states, for the derivatives that the render has."""
    stated = {
        "depth_mm": capture.indenter.depth_uncertainty_mm,
        "position_mm": capture.indenter.position_uncertainty_mm,
    }
    return {name: sd for name in layers.pose_names if (sd := stated[name]) is not None and sd > 0.0}


def generator_of(capture: TactileCapture, seed: int) -> np.random.Generator:
    """Return the generator of what belongs to one capture alone."""
    digest = hashlib.sha256(capture.contact.tobytes() + capture.name.encode()).digest()
    return np.random.default_rng([int.from_bytes(digest[:8], "little"), seed])


def _level_change(no_contact: Floats, repeat: Floats, pad: NDArray[np.bool_]) -> float:
    """Return the relative change of the pad's level between two captures."""
    usable = pad & every_channel(np.isfinite(no_contact) & np.isfinite(repeat))
    before = float(no_contact[usable].sum())
    return float(repeat[usable].sum()) / before - 1.0 if before > 0.0 else 0.0


def _scale(prior_rel: float, observed: Floats) -> tuple[Floats, int]:
    """Return scale and degrees of freedom of the next value, given (n, m) zero-mean observed ones and a prior."""
    freedom = PRIOR_OBSERVATIONS + len(observed)
    return np.sqrt((PRIOR_OBSERVATIONS * prior_rel**2 + (observed**2).sum(axis=0)) / freedom), freedom


#: Sizes of the model's relative error that are thought possible, evenly spread in their logarithm.
MODEL_ERROR_REL = np.geomspace(0.003, 0.3, 13)
# of the variance of the model's error: common to a channel, to a channel of one image, and of each part alone
_SHARES = (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)


def condition_on_levels(
    drawn: InputDraws, residual: Callable[[InputDraws], Floats], noise_variance: Floats, rng: np.random.Generator
) -> InputDraws:
    """Return the draws conditioned on captured levels.

    With residuals e = ln(simulated / captured) of the levels, model error d and noise: e = d + noise. Given the size t
    of the model error, d ~ N(0, t^2 C), each draw z moves by -cov(z, e) (cov(e) + R)^-1 (e + r), r ~ N(0, R),
    R = t^2 C + noise: conditional simulation, exact for normal inputs that act linearly on e. The size is drawn from
    its own posterior, N(mean e; 0, cov(e) + R) on a grid with a flat prior in ln t.

    Parameters
    ----------
    drawn
        Draws from what is known before.
    residual
        Returns the residuals (draws, images, channels, parts) of draws.
    noise_variance : ndarray, shape (images, channels, parts)
        Relative variance of the levels from noise.
    rng
        Generator of r and t.

    References
    ----------
    M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425; P. Abrahamsen, Norsk Regnesentral 917 (1997),
    conditional simulation.
    """
    e = residual(drawn)
    pattern = _model_covariance(e.shape[1:])
    flat = e.reshape(len(e), -1)
    z, mean = _packed(drawn), flat.mean(axis=0)
    between = (z - z.mean(axis=0)).T @ (flat - mean) / (len(flat) - 1)
    spread = np.atleast_2d(np.cov(flat, rowvar=False))
    noise = np.diag(noise_variance.ravel())
    covariances = [t**2 * pattern + noise for t in MODEL_ERROR_REL]
    log_likelihood = np.array([_log_normal_density(mean, spread + r) for r in covariances])
    chance = np.exp(log_likelihood - log_likelihood.max())
    size = rng.choice(len(MODEL_ERROR_REL), size=len(flat), p=chance / chance.sum())
    moved = z.copy()
    for i, covariance in enumerate(covariances):
        chosen = size == i
        if chosen.any():
            r = rng.standard_normal((int(chosen.sum()), len(mean))) @ np.linalg.cholesky(covariance).T
            moved[chosen] -= np.linalg.solve(spread + covariance, (flat[chosen] + r).T).T @ between.T
    return _unpacked(drawn, moved)


def _model_covariance(shape: tuple[int, ...]) -> Floats:
    """Return C (n, n) for levels of (images, channels, parts), unit variance."""
    images, channels, parts = shape
    of_channel = np.kron(np.ones((images, images)), np.kron(np.eye(channels), np.ones((parts, parts))))
    of_image = np.kron(np.eye(images * channels), np.ones((parts, parts)))
    common, image, own = _SHARES
    return np.asarray(common * of_channel + image * of_image + own * np.eye(images * channels * parts))


def _log_normal_density(x: Floats, covariance: Floats) -> float:
    """Return the logarithm of N(x; 0, covariance) but for a constant."""
    factor = np.linalg.cholesky(covariance)
    scaled = np.linalg.solve(factor, x)
    return float(-0.5 * scaled @ scaled - np.log(np.diag(factor)).sum())


def _packed(drawn: InputDraws) -> Floats:
    """Return all inputs side by side (draws, n)."""
    parts = [f.reshape(len(f), -1) for f in drawn.log_factors.values()]
    return np.concatenate([*parts, *(m[:, None] for m in drawn.moves_mm.values()), drawn.log_drift[:, None]], axis=1)


def _unpacked(drawn: InputDraws, z: Floats) -> InputDraws:
    """Return draws of these values."""
    factors, at = {}, 0
    size = drawn.matrix_best.size
    for name in drawn.log_factors:
        factors[name] = z[:, at : at + size].reshape(-1, *drawn.matrix_best.shape)
        at += size
    moves = {name: z[:, at + i] for i, name in enumerate(drawn.moves_mm)}
    return InputDraws(drawn.matrix_best, factors, moves, z[:, -1])


BLOCK_DRAWS = 10_000
LARGEST_BLOCKS = 12
COVERAGE = 0.95
_LEAST_BLOCKS = 4
_WANTED_DIGITS = 2


@dataclass(frozen=True, slots=True)
class Propagated:
    """Hold the draws of the headline and of all else, and whether the rule was met.

    Attributes
    ----------
    draws : dict of str to ndarray
        Draws along the first axis.
    significant_digits : int
        Digits of the headline's standard uncertainty to half a unit of which estimate, standard uncertainty and both
        ends of the 95 % interval are stable: 2, or 1, or 0 where not even one is.
    """

    draws: dict[str, Floats]
    significant_digits: int


def propagate(block: Callable[[int], dict[str, Floats]], headline: str) -> Propagated:
    """Draw blocks until the headline's statistics are stable to two digits, at most 120,000 draws.

    After each block of 10,000 draws the mean y, the standard deviation u(y) and the ends of the 95 % interval are
    formed; with s the standard error of each over h blocks, the rule is 2 s < delta / 2, where delta is a unit of the
    last significant digit of u(y).

    Parameters
    ----------
    block : callable
        Number of draws -> named draws (along the first axis).
    headline : str
        The name that is watched.

    Returns
    -------
    Propagated

    References
    ----------
    JCGM 101:2008, 7.9.
    """
    blocks: list[dict[str, Floats]] = []
    statistics: list[tuple[float, float, float, float]] = []
    digits = 0
    while len(blocks) < LARGEST_BLOCKS and digits < _WANTED_DIGITS:
        blocks.append(block(BLOCK_DRAWS))
        values = blocks[-1][headline]
        low, high = ends(values)
        statistics.append((float(values.mean()), float(values.std(ddof=1)), float(low), float(high)))
        if len(blocks) >= _LEAST_BLOCKS:
            u = float(np.concatenate([b[headline] for b in blocks]).std(ddof=1))
            error = 2.0 * np.std(statistics, axis=0, ddof=1).max() / np.sqrt(len(blocks))
            digits = sum(bool(error <= numerical_tolerance(u, n)) for n in range(1, _WANTED_DIGITS + 1))
    return Propagated({name: np.concatenate([b[name] for b in blocks]) for name in blocks[0]}, digits)


def numerical_tolerance(u: float, significant_digits: int) -> float:
    """Return half a unit of the last significant digit of a standard uncertainty (JCGM 101:2008, 7.9.2)."""
    if not u > 0.0:
        return 0.0
    return float(0.5 * 10.0 ** (np.floor(np.log10(u)) - (significant_digits - 1)))


def ends(values: Floats) -> tuple[Floats, Floats]:
    """Return both ends of the probabilistically symmetric 95 % interval along the first axis."""
    tail = (1.0 - COVERAGE) / 2.0
    low, high = np.quantile(values, [tail, 1.0 - tail], axis=0)
    return np.asarray(low), np.asarray(high)
