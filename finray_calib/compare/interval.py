"""Block-bootstrap intervals of image metrics over a region of one capture.

The tiles of the region are drawn with replacement and the metric is formed anew. The interval tells how much
the number depends on which part of the region was looked at. It does not know what another press, another
day, another sensor or another registration would give: those need more captures. The exposure factor is held
fixed. Percentile intervals of few tiles are somewhat too narrow.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.compare.regions import usable_pixels
from finray_calib.compare.relative_rms import relative_rms
from finray_calib.compare.skill import checked_weights, skill_score
from finray_calib.compare.tiles import tile_indices, tile_side_px

COVERAGE = 0.95
DRAWS = 2000


@dataclass(frozen=True, slots=True)
class Interval:
    """Hold a point estimate with its 95 % interval.

    Attributes
    ----------
    estimate, low, high : float
        Value over the whole region, and the ends of the interval.
    tile_px : int
        Side of the resampled tiles, px.
    """

    estimate: float
    low: float
    high: float
    tile_px: int


def skill_interval(
    simulated: NDArray[np.float64],
    captured: NDArray[np.float64],
    no_contact: NDArray[np.float64],
    mask: NDArray[np.bool_],
    rng: np.random.Generator,
    weights: NDArray[np.float64] | None = None,
    exposure_k: float = 1.0,
) -> Interval:
    """Return the skill score with its 95 % block-bootstrap interval.

    Valid for one capture: see the module's first paragraph for what the interval does not know.

    Parameters
    ----------
    simulated, captured, no_contact, mask, weights, exposure_k
        As for `skill_score`.
    rng : numpy.random.Generator

    Returns
    -------
    Interval

    Raises
    ------
    CompareError
        As for `skill_score`, and if the region has too few pixels.
    """
    simulation, capture, background = (np.asarray(i, dtype=np.float64) for i in (simulated, captured, no_contact))
    score = skill_score(simulation, capture, background, mask, weights, exposure_k)
    used = usable_pixels(mask, simulation, capture, background)
    weight = checked_weights(weights, background, used)
    real = capture[used]
    error = (exposure_k * simulation[used] - real) ** 2 @ weight
    signal = (background[used] - real) ** 2 @ weight
    side = tile_side_px(used)
    sums = _resampled_sums(np.stack([error, signal], axis=1), tile_indices(used, side), rng)
    # A draw can miss every tile that contact changed; it has no signal to explain and no score.
    sums = sums[sums[:, 1] > 0]
    low, high = _ends(1 - sums[:, 0] / sums[:, 1])
    return Interval(score.skill, float(low), float(high), side)


def relative_rms_interval(
    simulated: NDArray[np.float64],
    captured: NDArray[np.float64],
    mask: NDArray[np.bool_],
    rng: np.random.Generator,
    exposure_k: float = 1.0,
) -> tuple[Interval, ...]:
    """Return the relative RMS of each channel with its 95 % block-bootstrap interval.

    Valid for one capture: see the module's first paragraph for what the interval does not know.

    Parameters
    ----------
    simulated, captured, mask, exposure_k
        As for `relative_rms`.
    rng : numpy.random.Generator

    Returns
    -------
    tuple of Interval
        One for each channel.

    Raises
    ------
    CompareError
        As for `relative_rms`, and if the region has too few pixels.
    """
    simulation, capture = (np.asarray(image, dtype=np.float64) for image in (simulated, captured))
    estimate = relative_rms(simulation, capture, mask, exposure_k)
    used = usable_pixels(mask, simulation, capture)
    real = capture[used]
    squares = (exposure_k * simulation[used] - real) ** 2
    side = tile_side_px(used)
    columns = np.concatenate([squares, real, np.ones((len(real), 1))], axis=1)
    sums = _resampled_sums(columns, tile_indices(used, side), rng)
    channels = real.shape[1]
    count = sums[:, -1:]
    values = np.sqrt(sums[:, :channels] / count) / (sums[:, channels : 2 * channels] / count)
    low, high = _ends(values)
    return tuple(Interval(float(e), float(a), float(b), side) for e, a, b in zip(estimate, low, high, strict=True))


def _resampled_sums(
    columns: NDArray[np.float64], tile: NDArray[np.intp], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return the sums of (P, K) columns over tiles drawn with replacement, shape (DRAWS, K)."""
    tiles = int(tile.max()) + 1
    per_tile = np.stack([np.bincount(tile, weights=column, minlength=tiles) for column in columns.T], axis=1)
    counts = rng.multinomial(tiles, np.full(tiles, 1 / tiles), size=DRAWS)
    return np.asarray(counts @ per_tile)


def _ends(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the two percentiles that bound the central 95 % along the first axis."""
    tail = (1 - COVERAGE) / 2
    return np.asarray(np.quantile(values, [tail, 1 - tail], axis=0))
