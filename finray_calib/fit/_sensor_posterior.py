"""Posterior of what makes a sensor's pictures, when a model predicts the means of their blocks.

The pictures are taken as the model times one plus a smooth error of unknown size (what the model does not have, such as
uneven paint or a vignetting lens) plus noise of blocks, which pictures and channels share. At given sizes of both
errors all is Gaussian about the model's tangent; the sizes are integrated over a grid.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert
from scipy.sparse import csr_matrix

from data_schemas import FitError

Floats = NDArray[np.float64]
Predict = Callable[[Floats], Floats]
BLOCKS: Final = (24, 16)
"""Along the longer and the shorter side of the pad's picture."""
_LEAST_BLOCK_PX = 6
_LEAST_SEEN = 0.5
_FEWEST_BLOCKS = 20
DISCREPANCY_SIZES_REL = (0.0, 0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2, 0.4)
INDEPENDENT_SIZES_REL = (
    0.0, 0.002, 0.003, 0.0045, 0.007, 0.01, 0.015, 0.022, 0.033, 0.05, 0.075, 0.11, 0.17, 0.25, 0.4,
)  # fmt: skip
"""Sizes of both errors, relative to the picture: even in the logarithm, all of one prior weight."""
SIZES_REL: Final = tuple((d, n) for n in INDEPENDENT_SIZES_REL for d in DISCREPANCY_SIZES_REL)

# of the smooth error's variance: what all channels and pictures share, what all pictures of a channel share, the rest
_SHARES = (0.5, 0.4, 0.1)
_KEPT_VARIANCE = 0.99
# relative errors count from this share of a channel's mean: where a channel is dark they would mean nothing
_DARKEST_REL = 0.05
_MOST_STEPS = 25
_CLOSE_SD = 0.1
# of one step, in standard deviations of the prior
_LONGEST_MOVE = 1.0
# of the search from the prior's middle, in its standard deviations
_FARTHEST = 4.0
# variance of an unexplained error of a block that pictures do not share, over that which they do
_LEAST_APART = 0.05
_LEAST_INFORMATION = 1e-6
# of a block's squared residual, the least that a fit leaves
_LEAST_LEFT = 0.1
# of the noise of blocks: rounds of covariance and sizes by turns; least excess of the sizes' scatter
_NOISE_ROUNDS = 5
_LEAST_EXCESS = 0.01
# of the usual block, the least noise that a block is taken to have
_LEAST_OF_USUAL = 1e-3


@dataclass(frozen=True, slots=True)
class PictureBlocks:
    """Means over blocks of several pictures, in the order picture, channel, block; of all channels or some.

    Attributes
    ----------
    values, variance
        (picture, channel, block) means and their known variance.
    places
        (block, 2) middles, in lengths of the pad's picture.
    averaging
        (block, pixel) sparse: averages over the pixels of a block that see the pad and are not clipped.
    """

    values: Floats
    variance: Floats
    places: Floats
    averaging: csr_matrix

    def means(self, pictures: Floats) -> Floats:
        """Return block means (picture, channel, block) of pictures (picture, channel, row, column)."""
        flat = pictures.reshape(-1, pictures.shape[-2] * pictures.shape[-1])
        return np.asarray((self.averaging @ flat.T).T).reshape(*pictures.shape[:2], -1)

    def variance_of_means(self, variance: Floats) -> Floats:
        """Return the variance of block means of pictures whose pixels have independent noise."""
        return replace(self, averaging=self.averaging.multiply(self.averaging).tocsr()).means(variance)

    def features(self, correlation_length: float) -> Floats:
        r"""Return what a smooth relative error of unit size consists of, (number of values, feature).

        Over places its correlation is :math:`\exp(-d^2 / 2 l^2)`; half its variance is common to all channels and
        pictures, two fifths to the pictures of a channel, a tenth is of one channel of one picture.

        Parameters
        ----------
        correlation_length
            l, in lengths of the pad's picture.
        """
        distance2 = ((self.places[:, None] - self.places[None]) ** 2).sum(axis=-1)
        sizes, vectors = np.linalg.eigh(np.exp(-0.5 * distance2 / correlation_length**2))
        order = np.argsort(sizes)[::-1]
        kept = 1 + int(np.searchsorted(np.cumsum(sizes[order]) / sizes.sum(), _KEPT_VARIANCE))
        over_places = vectors[:, order[:kept]] * np.sqrt(sizes[order[:kept]])
        pictures, channels = self.values.shape[:2]
        groups = (
            np.ones((pictures * channels, 1)),
            np.tile(np.eye(channels), (pictures, 1)),
            np.eye(pictures * channels),
        )
        return np.concatenate(
            [np.sqrt(s) * np.kron(g, over_places) for s, g in zip(_SHARES, groups, strict=True)], axis=1
        )


def picture_blocks(pictures: Floats, variance: Floats, on_pad: NDArray[np.bool_]) -> PictureBlocks:
    """Divide the pad's picture into up to 24 blocks along its longer and 16 along its shorter side, and average there.

    A block has at least 6 pixels along each side: a blur, which is narrower, then hardly smooths the model's own noise.

    Parameters
    ----------
    pictures, variance
        (picture, 3, row, column) and the variance of each pixel; NaN where clipped.
    on_pad
        (row, column) whether the camera sees the pad by the design.

    Raises
    ------
    FitError
        Fewer than 20 blocks hold light that is not clipped.
    """
    rows, columns = np.nonzero(on_pad)
    usable = np.asarray(np.isfinite(pictures).all(axis=(0, 1)))[rows, columns]
    spans = np.array([np.ptp(rows) + 1, np.ptp(columns) + 1]) if len(rows) else np.ones(2)
    side = np.maximum(spans / np.array(BLOCKS if spans[0] >= spans[1] else BLOCKS[::-1]), _LEAST_BLOCK_PX)
    number = [np.floor((at - at.min()) / size).astype(int) for at, size in zip((rows, columns), side, strict=True)]
    _, at, count = np.unique(number[0] * on_pad.shape[1] + number[1], return_inverse=True, return_counts=True)
    good = np.bincount(at, usable, len(count)) >= _LEAST_SEEN * np.maximum(count, 0.5 * side.prod())
    if good.sum() < _FEWEST_BLOCKS:
        raise FitError(
            f"only {int(good.sum())} blocks of the pad's picture are seen and not clipped, but at least "
            f"{_FEWEST_BLOCKS} are needed; capture with a shorter exposure, or check the camera of the design"
        )
    kept = usable & good[at]
    block = (np.cumsum(good) - 1)[at[kept]]
    total = np.bincount(block)
    pixel = rows[kept] * on_pad.shape[1] + columns[kept]
    averaging = csr_matrix((1.0 / total[block], (block, pixel)), shape=(len(total), on_pad.size))
    places = np.stack([np.bincount(block, of[kept]) / total for of in (rows, columns)], axis=-1) / spans.max()
    empty = PictureBlocks(np.empty(0), np.empty(0), places, averaging)
    means, spread = np.nan_to_num(pictures), np.nan_to_num(variance)
    return replace(empty, values=empty.means(means), variance=empty.variance_of_means(spread))


def placed_picture(picture: Floats, rows_px: float, columns_px: float, scale: float, blur_px: float) -> Floats:
    """Return a picture (row, column) scaled about its middle, shifted and blurred by a Gaussian."""
    rows, columns = picture.shape
    middle = np.array([(columns - 1) / 2.0, (rows - 1) / 2.0])
    matrix = np.eye(2, 3) / scale
    matrix[:, 2] = middle - (middle + np.array([columns_px, rows_px])) / scale
    moved = cv2.warpAffine(
        picture, matrix, (columns, rows), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
    )
    # one size of kernel for all widths: a size that follows the width would jump
    return np.asarray(cv2.GaussianBlur(moved, (25, 25), blur_px, borderType=cv2.BORDER_REFLECT))


@dataclass(frozen=True, slots=True)
class PicturePosterior:
    """Draws of the standardised parameters, whose prior is the unit normal, and of both errors' sizes.

    ``theta`` (draw, parameter), ``discrepancy_rel`` and ``independent_rel`` (draw,); ``mean`` (parameter,) is the
    point about which the model was linearised; ``residual_rel`` the rms of the residuals over the picture's mean.
    ``noise_share`` (parameter,) is how much of what the pictures seem to tell of a parameter is the model's own noise.
    """

    theta: Floats
    mean: Floats
    discrepancy_rel: Floats
    independent_rel: Floats
    residual_rel: float
    converged: bool
    noise_share: Floats


@dataclass(frozen=True, slots=True)
class _Tangent:
    """The model about a point, all relative to the picture, as root(pictures) times their mean, then contrasts.

    Columns (value, 2 parameters + 2): slopes, residual, slopes of the half differences, half differences. ``seen``
    (picture, channel, block) is the camera's variance.
    """

    point: Floats
    columns: Floats
    seen: Floats

    def noise(self, independent_rel: float, blocks_alike: bool = False) -> Floats:
        """Return the covariance of the channels of each block, (picture, block, channel, channel).

        That of the model is told by its half differences (:func:`_noise_of_halves`). An unexplained error of a block
        is taken to be shared by pictures, channels and blocks in the same ratios.
        """
        pictures = len(self.seen)
        of_model, by_block = _noise_of_halves(self.columns[:, -1].reshape(self.seen.shape))
        sizes = np.trace(of_model, axis1=1, axis2=2)
        common, apart = float(sizes[0]), float(sizes[1:].mean())
        ratio = min(max(apart / common, _LEAST_APART), 1.0) if common > 0.0 else 1.0
        unexplained = np.full((pictures, 1, 1), ratio)
        unexplained[0] = 1.0
        unexplained *= pictures / unexplained.sum()
        # with neither noise nor error the solution would claim to be exact: a ten-thousandth is below every camera
        if blocks_alike:
            by_block = np.ones_like(by_block)
        own = max(independent_rel, 1e-4) ** 2 * unexplained * _correlation(of_model.sum(axis=0))
        seen = np.moveaxis(self.seen, 1, 2)[..., None] * np.eye(self.seen.shape[1])
        return np.asarray(seen + by_block[:, None, None] * (of_model + own)[:, None])


def _noise_of_halves(halves: Floats) -> tuple[Floats, Floats]:
    """Return the covariance of channels, (picture, channel, channel), and how much larger that of a block is, (block,).

    Pictures that are rendered with common random numbers share most of their noise: it is apart for the mean of the
    pictures and for their contrasts. Channels that see the same light share its noise. Few blocks, where light has
    edges, hold most of it.

    Parameters
    ----------
    halves
        (picture, channel, block) half differences of the model, as mean and contrasts of pictures.
    """
    by_picture, by_block = halves.transpose(0, 2, 1), np.ones(halves.shape[2])
    for _ in range(_NOISE_ROUNDS):
        covariance = (by_picture / by_block[:, None]).transpose(0, 2, 1) @ by_picture / len(by_block)
        spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        if not (spread > 0.0).all():
            break
        roots = np.linalg.cholesky(np.array([_correlation(one) for one in covariance]))
        whitened = np.linalg.solve(roots[:, None], (by_picture / spread[:, None])[..., None])
        by_block = _variances_by_block((whitened**2).mean(axis=(0, 2, 3)), halves.shape[0] * halves.shape[1])
    return covariance, by_block


def _variances_by_block(squares: Floats, freedom: int) -> Floats:
    r"""Return variances of blocks, 1 in the mean, from mean squares with few degrees of freedom, by empirical Bayes.

    .. math:: g_b = \frac{\nu s_0^2 + d s_b^2}{\nu + d}, \quad
        \mathrm{var}(\ln s_b^2) = \psi'(d / 2) + \psi'(\nu / 2), \quad
        \ln s_0^2 = \overline{\ln s_b^2} - \psi(d / 2) + \ln(d / 2) + \psi(\nu / 2) - \ln(\nu / 2)

    Source: G. K. Smyth, Statistical Applications in Genetics and Molecular Biology 3 (2004) 3.
    """
    from scipy.special import digamma, polygamma

    usual = float(np.median(squares))
    if len(squares) < 2 or usual <= 0.0:
        return np.ones_like(squares)
    # a block whose halves agree to the last digit is one that no path found, and tells nothing of its noise
    logs, half = np.log(np.maximum(squares, _LEAST_OF_USUAL * usual)), 0.5 * freedom
    excess = max(float(logs.var(ddof=1) - polygamma(1, half)), _LEAST_EXCESS)
    # psi'(x) is 1 / x + 1 / (2 x^2) to 5 % above 1
    own = max((1.0 + np.sqrt(1.0 + 2.0 * excess)) / (2.0 * excess), 0.5)
    centre = np.exp(logs.mean() - digamma(half) + np.log(half) + digamma(own) - np.log(own))
    found = (own * centre + half * squares) / (own + half)
    return np.asarray(np.maximum(found / found.mean(), _LEAST_OF_USUAL))


def _correlation(covariance: Floats) -> Floats:
    """Return a covariance (3, 3) as correlations, of which each channel keeps a part of its own."""
    spread = np.sqrt(np.diagonal(covariance))
    if not (spread > 0.0).all():
        return np.eye(len(covariance))
    correlation = covariance / np.outer(spread, spread)
    return np.asarray((1.0 - _LEAST_APART) * correlation + _LEAST_APART * np.eye(len(covariance)))


def _whitened(columns: Floats, noise: Floats) -> Floats:
    """Return columns (value, k) in units of the noise (picture, block, channel, channel)."""
    pictures, blocks, channels = noise.shape[:3]
    by_block = columns.reshape(pictures, channels, blocks, -1).transpose(0, 2, 1, 3)
    return np.asarray(np.linalg.solve(np.linalg.cholesky(noise), by_block).reshape(columns.shape))


@dataclass(frozen=True, slots=True)
class _Grid:
    """At each pair of sizes: log evidence, mean and covariance of the parameters."""

    log_evidence: Floats
    means: Floats
    covariances: Floats

    @property
    def weights(self) -> Floats:
        weight: Floats = np.exp(self.log_evidence - self.log_evidence.max())
        return np.asarray(weight / weight.sum())


DRAWS: Final = 2000


def sample_picture_posterior(
    predict: Predict,
    blocks: PictureBlocks,
    steps: Floats,
    rng: np.random.Generator,
    *,
    correlation_length: float,
    start: Floats | None = None,
) -> PicturePosterior:
    r"""Fit standardised parameters to the blocks of pictures and draw from their posterior.

    .. math:: y = f(\theta) + m \, (\sigma_d \Phi w + \sigma_n e) + e_y, \quad \theta, w \sim N(0, 1)

    with m the model's own picture, :math:`\Phi` of :meth:`PictureBlocks.features` and :math:`e_y` of known variance;
    e has unit size in the mean, and channels, pictures and blocks share it as they share the noise of the model.
    The model is rendered and has noise of its own, which would make what smooths it (blur) look right and what it
    hides (slopes) look small; the squared residual is therefore the product of the residuals of two independent halves
    of it. Gauss-Newton finds the tangent; there the posterior is Gaussian at each pair of sizes, and draws come from
    the mixture over the grid of sizes. Valid where f is near its tangent over the posterior's width, and where the
    noise of the model is a small part of its slopes (``noise_share``).

    Parameters
    ----------
    predict
        Returns from standardised parameters (parameter,) block means and half the difference of the model's halves, in
        the order of `blocks`, (2, value).
    blocks
        What was measured, with the camera's variance.
    steps
        (parameter,) half steps of the differences that make the tangent.
    rng
        Of the draws.
    correlation_length
        Of the smooth error, in lengths of the pad's picture.
    start
        (parameter,) where the search begins; by default at zero.

    Raises
    ------
    FitError
        The model predicts numbers that are not finite, or no light at all.
    """
    features = mean_and_contrasts(blocks.features(correlation_length), len(blocks.values))
    point, converged = np.zeros(len(steps)) if start is None else start, False
    pair: tuple[float, float] | None = None
    settled: set[tuple[float, float]] = set()
    for _ in range(_MOST_STEPS):
        tangent = _tangent(predict, blocks, point, steps)
        # the sizes are chosen anew where the point has settled for those of before
        grid = _grid(tangent, features, SIZES_REL if pair is None else (pair,))
        best = int(np.argmax(grid.log_evidence))
        move = grid.means[best] - point
        is_near = bool(np.abs(move / np.sqrt(np.diagonal(grid.covariances[best]))).max() < _CLOSE_SD)
        # two pairs that each prefer the other are both in the mixture
        converged = pair is None and (is_near or SIZES_REL[best] in settled)
        if converged:
            break
        if is_near and pair is not None:
            settled.add(pair)
        pair = None if is_near else pair or SIZES_REL[best]
        point = np.clip(point + np.clip(move, -_LONGEST_MOVE, _LONGEST_MOVE), -_FARTHEST, _FARTHEST)
    grid = _grid(tangent, features, SIZES_REL)
    best = int(np.argmax(grid.log_evidence))
    widening = _widening(tangent, features, SIZES_REL[best], grid.covariances[best])
    cell = rng.choice(len(grid.weights), size=DRAWS, p=grid.weights)
    theta = np.empty((DRAWS, len(steps)))
    for k in np.unique(cell):
        own = cell == k
        root = widening @ np.linalg.cholesky(grid.covariances[k])
        theta[own] = grid.means[k] + rng.standard_normal((own.sum(), len(steps))) @ root.T
    sizes = np.array(SIZES_REL)
    residual = blocks.values.ravel() - predict(grid.means[best])[0]
    residual_rel = float(np.sqrt(np.mean(residual**2)) / np.mean(blocks.values))
    noise_share = _noise_share(tangent, features, SIZES_REL[best])
    return PicturePosterior(
        theta, grid.means[best], sizes[cell, 0], sizes[cell, 1], residual_rel, converged, noise_share
    )


def _tangent(predict: Predict, blocks: PictureBlocks, point: Floats, steps: Floats) -> _Tangent:
    """Return the model about a point by central differences, relative to the picture, as mean and contrasts."""
    at, half = predict(point)
    if not np.isfinite(at).all() or not (at > 0.0).any():
        raise FitError(
            "the model of the sensor predicts no light in these pictures; check light and camera of the design, or "
            "give more --samples in case the renders are too noisy"
        )
    slopes = np.empty((2, len(at), len(point)))
    for k, step in enumerate(steps):
        moved = np.zeros(len(point))
        moved[k] = step
        slopes[..., k] = (predict(point + moved) - predict(point - moved)) / (2.0 * step)
    of_channel = at.reshape(blocks.values.shape)
    scale = np.maximum(of_channel, _DARKEST_REL * of_channel.mean(axis=2, keepdims=True)).ravel()
    columns = np.column_stack([slopes[0], blocks.values.ravel() - at, slopes[1], half]) / scale[:, None]
    seen = (blocks.variance / scale.reshape(blocks.values.shape) ** 2).mean(axis=0, keepdims=True)
    return _Tangent(point, mean_and_contrasts(columns, len(blocks.values)), np.repeat(seen, len(blocks.values), axis=0))


def mean_and_contrasts(columns: Floats, pictures: int) -> Floats:
    """Return columns (value, ...) with the pictures turned into root(pictures) times their mean, and contrasts."""
    turn = helmert(pictures, full=True)
    return np.asarray(np.tensordot(turn, columns.reshape(pictures, -1, columns.shape[1]), 1).reshape(columns.shape))


def _grid(tangent: _Tangent, features: Floats, pairs: Sequence[tuple[float, float]]) -> _Grid:
    """Solve the linear model at pairs of sizes; the smooth error is eliminated by the matrix inversion lemma."""
    evidence, means, covariances = [], [], []
    for independent in dict.fromkeys(own for _, own in pairs):
        noise = tangent.noise(independent)
        columns, smooth = _whitened(tangent.columns, noise), _whitened(features, noise)
        products, log_noise = columns.T @ columns, float(np.linalg.slogdet(noise)[1].sum())
        sizes, vectors = np.linalg.eigh(smooth.T @ smooth)
        sizes, seen = np.maximum(sizes, 0.0), vectors.T @ (smooth.T @ columns)
        for size in (size for size, own in pairs if own == independent):
            share = size**2 / (1.0 + size**2 * sizes)
            reduced = products - seen.T @ (share[:, None] * seen)
            log_size = log_noise + float(np.log1p(size**2 * sizes).sum())
            move, covariance, square = _solved(reduced, tangent.point)
            log_information = -float(np.linalg.slogdet(covariance)[1])
            evidence.append(-0.5 * (square + log_size + log_information))
            means.append(tangent.point + move)
            covariances.append(covariance)
    return _Grid(np.array(evidence), np.array(means), np.array(covariances))


def _solved(products: Floats, point: Floats) -> tuple[Floats, Floats, float]:
    """Return the move to the mean, covariance, and squared residual with its prior term, from weighted products."""
    n, last = len(point), 2 * len(point) + 1
    information = products[:n, :n] - products[n + 1 : last, n + 1 : last]
    sizes, vectors = np.linalg.eigh(0.5 * (information + information.T))
    # that of the halves' product is right on average, and below zero by chance only
    covariance = (vectors / (1.0 + np.maximum(sizes, 0.0))) @ vectors.T
    move = covariance @ (products[:n, n] + products[n + 1 : last, last] - point)
    at = point + move
    square = products[n, n] - 2.0 * products[:n, n] @ move + move @ products[:n, :n] @ move + at @ at
    return np.asarray(move), np.asarray(covariance, dtype=np.float64), float(square)


def _widening(tangent: _Tangent, features: Floats, pair: tuple[float, float], covariance: Floats) -> Floats:
    r"""Return what widens deviations from the mean where single blocks scatter more than they should, (n, n).

    .. math:: \Sigma (1 + M) \Sigma, \quad M = \sum_i s_i s_i^T

    replaces :math:`\Sigma = (1 + I)^{-1}`, with s the slopes of the log likelihood by block, all pictures and channels
    of it together; M is taken where it is more than the information I. Rendered pictures have rare bright paths: few
    blocks hold most of the noise.
    """
    count, noise = len(tangent.point), tangent.noise(pair[1])
    both, smooth = _whitened(tangent.columns[:, : count + 1], noise), _whitened(features, noise)
    if pair[0] > 0.0:
        inner = np.eye(features.shape[1]) / pair[0] ** 2 + smooth.T @ smooth
        both = both - smooth @ np.linalg.solve(inner, smooth.T @ both)
    scores = _scores_by_block(both.reshape(*tangent.seen.shape[:2], -1, count + 1), covariance)
    information = np.linalg.inv(covariance) - (1.0 - _LEAST_INFORMATION) * np.eye(count)
    root = np.linalg.cholesky(0.5 * (information + information.T))
    whitened = np.linalg.solve(root, np.linalg.solve(root, scores.T @ scores).T)
    sizes, vectors = np.linalg.eigh(0.5 * (whitened + whitened.T))
    scattered = root @ (vectors * np.maximum(sizes, 1.0)) @ vectors.T @ root.T
    wide = covariance @ (np.eye(count) + scattered) @ covariance
    return np.asarray(np.linalg.cholesky(0.5 * (wide + wide.T)) @ np.linalg.inv(np.linalg.cholesky(covariance)))


def _scores_by_block(both: Floats, covariance: Floats) -> Floats:
    r"""Return slopes of the log likelihood, (block, n), of slopes and residual (picture, channel, block, n + 1).

    A fit draws the residual of a block to zero by :math:`1 - H, H = X \Sigma X^T`; its size is restored by
    :math:`(1 - H)^{-1/2}`. Source: R. M. Bell, D. F. McCaffrey, Survey Methodology 28 (2002) 169.
    """
    by_block = np.moveaxis(both, 2, 0).reshape(both.shape[2], -1, both.shape[3])
    slopes, residual = by_block[..., :-1], by_block[..., -1:]
    left, vectors = np.linalg.eigh(np.eye(by_block.shape[1]) - slopes @ covariance @ slopes.transpose(0, 2, 1))
    turned = vectors.transpose(0, 2, 1) @ residual / np.sqrt(np.maximum(left, _LEAST_LEFT))[..., None]
    return np.asarray((slopes.transpose(0, 2, 1) @ vectors @ turned)[..., 0])


def _noise_share(tangent: _Tangent, features: Floats, pair: tuple[float, float]) -> Floats:
    """Return for each parameter the squared slopes of the half differences over those of the model, (parameter,).

    Sizes of the noise by block come from the same half differences, and would make them look small.
    """
    noise, count = tangent.noise(pair[1], blocks_alike=True), len(tangent.point)
    smooth = pair[0] * _whitened(features, noise)
    slopes = np.delete(_whitened(tangent.columns, noise), [count, 2 * count + 1], axis=1)
    inner = np.linalg.solve(np.eye(smooth.shape[1]) + smooth.T @ smooth, smooth.T @ slopes)
    seen, of_noise = np.split(np.maximum((slopes * (slopes - smooth @ inner)).sum(axis=0), 0.0), 2)
    return np.asarray(of_noise / np.maximum(seen, 1.0))
