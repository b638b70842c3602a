"""Draws of everything a comparison rests on and does not know exactly: paints, camera, pose, drift, render noise."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from finray_calib.compare.render_layers import RenderLayers

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

    def draw(self, draws: int, rng: np.random.Generator, paired: bool = False) -> "Drawn":
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
        return Drawn(self.layers.matrix, factors, moves, drift)

    def best(self) -> "Drawn":
        """Return a single draw that holds the best values."""
        none = {POSE[name]: np.zeros(1) for name in self.pose_names}
        return Drawn(self.layers.matrix, {}, none, np.zeros(1))


@dataclass(frozen=True, slots=True)
class Drawn:
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

    def only(self, name: str) -> "Drawn":
        """Return draws in which one input varies and the others keep their mean."""

        def kept(key: str, values: Floats) -> Floats:
            return values if key == name else np.broadcast_to(values.mean(axis=0), values.shape)

        return Drawn(
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
    stated = {
        "depth_mm": capture.indenter.depth_uncertainty_mm,
        "position_mm": capture.indenter.position_uncertainty_mm,
    }
    poses = {name: sd for name in layers.pose_names if (sd := stated[name]) is not None and sd > 0.0}
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
    return Inputs(layers, poses, (float(drift_scale[0]), drift_freedom), walls)


def generator_of(capture: TactileCapture, seed: int) -> np.random.Generator:
    """Return the generator of what belongs to one capture alone."""
    digest = hashlib.sha256(capture.contact.tobytes() + capture.name.encode()).digest()
    return np.random.default_rng([int.from_bytes(digest[:8], "little"), seed])


def _level_change(no_contact: Floats, repeat: Floats, pad: NDArray[np.bool_]) -> float:
    """Return the relative change of the pad's level between two captures."""
    usable = pad & np.isfinite(no_contact).all(axis=2) & np.isfinite(repeat).all(axis=2)
    before = float(no_contact[usable].sum())
    return float(repeat[usable].sum()) / before - 1.0 if before > 0.0 else 0.0


def _scale(prior_rel: float, observed: Floats) -> tuple[Floats, int]:
    """Return scale and degrees of freedom of the next value, given (n, m) zero-mean observed ones and a prior."""
    freedom = PRIOR_OBSERVATIONS + len(observed)
    return np.sqrt((PRIOR_OBSERVATIONS * prior_rel**2 + (observed**2).sum(axis=0)) / freedom), freedom
