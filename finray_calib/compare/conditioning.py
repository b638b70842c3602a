"""What the capture itself says about the inputs: paints, camera and pose narrowed by the levels that were captured.

The inputs are known before the capture only so far; a camera whose blue is uncertain by 30 % makes most draws miss the
picture by far more than the true camera does. A squared error averaged over such draws is that of wrong cameras. So the
draws are conditioned on the mean levels of parts of both captured images, with a model error of unknown size in each:
what the inputs cannot explain, or need not, stays an error of the model.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from finray_calib.compare.input_draws import Drawn

Floats = NDArray[np.float64]
#: Sizes of the model's relative error that are thought possible, evenly spread in their logarithm.
MODEL_ERROR_REL = np.geomspace(0.003, 0.3, 13)
# of the variance of the model's error: common to a channel, to a channel of one image, and of each part alone
_SHARES = (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)


def condition_on_levels(
    drawn: Drawn, residual: Callable[[Drawn], Floats], noise_variance: Floats, rng: np.random.Generator
) -> Drawn:
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


def _packed(drawn: Drawn) -> Floats:
    """Return all inputs side by side (draws, n)."""
    parts = [f.reshape(len(f), -1) for f in drawn.log_factors.values()]
    return np.concatenate([*parts, *(m[:, None] for m in drawn.moves_mm.values()), drawn.log_drift[:, None]], axis=1)


def _unpacked(drawn: Drawn, z: Floats) -> Drawn:
    """Return draws of these values."""
    factors, at = {}, 0
    size = drawn.matrix_best.size
    for name in drawn.log_factors:
        factors[name] = z[:, at : at + size].reshape(-1, *drawn.matrix_best.shape)
        at += size
    moves = {name: z[:, at + i] for i, name in enumerate(drawn.moves_mm)}
    return Drawn(drawn.matrix_best, factors, moves, z[:, -1])
