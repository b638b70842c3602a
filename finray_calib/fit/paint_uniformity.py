"""How uniform a paint is: spread between pixels without their noise, a coarse map of blocks, the worst spots."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import RegionOfInterest
from data_schemas.paint_map import PaintSpot, PaintSpread

Floats = NDArray[np.float64]
Maps = Mapping[str, NDArray[np.float32]]

NOISE_ERROR_REL: Final = 0.1
"""Error of the stated noise that a resolved spread must exceed: camera noise is rarely known better."""
SMALLEST_GAIN: Final = 0.5
"""A pixel counts where its bands weigh at least as much as its prior."""
MOST_PIXELS: Final = 200_000
"""Pixels that enter the spread: its own error is then a fifth of a per cent."""
FEWEST_PIXELS: Final = 100
BLOCKS_ALONG: Final = 24
FEWEST_IN_BLOCK: Final = 16
SPOTS: Final = 5
SPOT_SD: Final = 5.0
"""Significance from which a block is called a spot; of 600 even blocks none reaches it by chance."""
_NORMAL_MAD = 0.6744897501960817  # median of |z| of a standard normal
_MEDIAN_LOSS = 1.2533141373155001  # sqrt(pi/2): sd of a median over that of a mean
_GOLDEN = 0.6180339887498949  # multiples of it modulo 1 fill the interval evenly and meet no Bayer period
_BISECTIONS = 20  # to 1e-6 of the largest spread there can be
_SD_OF = {"mode_nm": "mode_sd_nm", "peak_per_nm": "peak_sd_per_nm", "energy_yield": "energy_yield_sd"}


@dataclass(frozen=True, slots=True)
class PaintBlocks:
    """Medians over square blocks of pixels, each (block rows, block columns), NaN with too few pixels."""

    side_px: int
    mode_nm: Floats
    mode_sd_nm: Floats
    energy_yield: Floats
    energy_yield_sd: Floats


def paint_spread(quantity: str, maps: Maps, noise: NDArray[np.float32], mean: float, sd: float) -> PaintSpread:
    r"""Return how much a quantity differs between pixels, noise and prior taken out.

    A pixel's estimate is x = m + g (t - m) + e: truth t, prior centre m, noise e of variance n, and the gain
    g = 1 - sd^2 / prior^2. With d = m + (x - m) / g the spread T is that for which the median of
    :math:`|d - \mathrm{median}(d)| / \sqrt{T^2 + n / g^2}` is that of a normal deviate. Of positive quantities the
    logarithm is taken. Valid for noise that is independent between pixels.

    Parameters
    ----------
    quantity
        "mode_nm", "peak_per_nm" or "energy_yield".
    maps
        Maps of the quantity and of its standard deviation.
    noise
        Standard deviation of the estimate by noise alone, in the unit of the quantity.
    mean, sd
        Of the pixels' prior: its centre in the unit of the quantity; its width in nm, or of the logarithm.
    """
    is_mode, fitted = quantity == "mode_nm", np.isfinite(maps[quantity])
    estimate = float(np.median(maps[quantity][fitted]))
    chosen = np.flatnonzero(fitted)[_even_choice(int(fitted.sum()))]
    parts = (maps[quantity], maps[_SD_OF[quantity]], noise)
    value, error, scatter = (part.ravel()[chosen].astype(np.float64) for part in parts)
    center = mean
    if not is_mode:
        value, error, scatter, center = np.log(value), error / value, scatter / value, float(np.log(center))
    gain = 1 - (error / sd) ** 2
    counted, unit = gain >= SMALLEST_GAIN, 1.0 if is_mode else estimate
    if counted.sum() < FEWEST_PIXELS:
        return PaintSpread(estimate=estimate, sd=0.0, high=sd * unit, noise_share=1.0, resolved=False, pixels=0)
    gain = gain[counted]
    variance = (scatter[counted] / gain) ** 2
    spread = _spread(center + (value[counted] - center) / gain, variance)
    typical, doubt = float(np.median(variance)), 1 - (1 - NOISE_ERROR_REL) ** 2
    return PaintSpread(
        estimate=estimate,
        sd=spread * unit,
        high=float(np.sqrt(spread**2 + doubt * typical)) * unit,
        noise_share=typical / (typical + spread**2),
        resolved=bool(spread**2 > doubt * typical),
        pixels=int(counted.sum()),
    )


@lru_cache(maxsize=1)
def _even_choice(size: int) -> NDArray[np.int64]:
    """Return at most MOST_PIXELS indices below `size`, spread evenly."""
    if size <= MOST_PIXELS:
        return np.arange(size)
    return np.unique((np.arange(MOST_PIXELS) * _GOLDEN % 1.0 * size).astype(np.int64))


def _spread(values: Floats, noise: Floats) -> float:
    """Return the robust standard deviation of values beyond the variance of their noise, 0 if there is none."""
    off = np.abs(values - np.median(values))
    low, high = 0.0, float(np.median(off)) / _NORMAL_MAD
    if np.median(off / np.sqrt(noise)) <= _NORMAL_MAD:
        return 0.0
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        if np.median(off / np.sqrt(middle**2 + noise)) > _NORMAL_MAD:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def paint_blocks(maps: Maps) -> PaintBlocks:
    """Return medians of mode and yield over blocks, with the robust standard error of each median.

    The error comes from the scatter inside the block: paint and noise together, independent between pixels.
    """
    rows, columns = maps["mode_nm"].shape
    side = max(8, 2 * round(max(rows, columns) / BLOCKS_ALONG / 2))  # even: whole Bayer cells
    shape = (-(-rows // side), -(-columns // side))
    found = {name: (np.full(shape, np.nan), np.full(shape, np.nan)) for name in ("mode_nm", "energy_yield")}
    for i, j in np.ndindex(shape):
        window = slice(i * side, (i + 1) * side), slice(j * side, (j + 1) * side)
        for name, (median, error) in found.items():
            inside = maps[name][window]
            inside = inside[np.isfinite(inside)].astype(np.float64)
            if inside.size >= FEWEST_IN_BLOCK:
                median[i, j] = np.median(inside)
                scatter = np.median(np.abs(inside - median[i, j])) / _NORMAL_MAD
                error[i, j] = _MEDIAN_LOSS * scatter / np.sqrt(inside.size)
    return PaintBlocks(side, *found["mode_nm"], *found["energy_yield"])


def worst_spots(blocks: PaintBlocks, area: RegionOfInterest) -> tuple[PaintSpot, ...]:
    """Return the blocks whose yield departs most from the median of the blocks, if by five standard errors.

    Of neighbouring blocks only the worst is named: they are one spot.
    """
    if np.isnan(blocks.energy_yield).all():
        return ()
    middle, mode_nm = (float(np.nanmedian(values)) for values in (blocks.energy_yield, blocks.mode_nm))
    deviation, error = blocks.energy_yield / middle - 1, blocks.energy_yield_sd / middle
    departing = np.nan_to_num(np.where(np.abs(deviation) > SPOT_SD * error, np.abs(deviation), 0.0))
    spots: list[PaintSpot] = []
    while len(spots) < SPOTS and departing.max() > 0:
        i, j = (int(k) for k in np.unravel_index(departing.argmax(), departing.shape))
        departing[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2] = 0.0
        spots.append(
            PaintSpot(
                row_px=area.row_px + _center(i, blocks.side_px, area.height_px),
                column_px=area.column_px + _center(j, blocks.side_px, area.width_px),
                deviation_rel=float(deviation[i, j]),
                deviation_sd_rel=float(error[i, j]),
                mode_shift_nm=float(blocks.mode_nm[i, j]) - mode_nm,
            )
        )
    return tuple(spots)


def _center(block: int, side_px: int, length_px: int) -> int:
    """Return the middle pixel of a block, the last of which may be cut."""
    return (block * side_px + min((block + 1) * side_px, length_px)) // 2
