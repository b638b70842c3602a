"""Draws of the metrics of one region: squared errors, contact signal and floor, and what follows from them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from finray_calib.compare.input_draws import Drawn
from finray_calib.compare.region_sums import RegionSums
from finray_calib.compare.tiles import tile_indices, tile_side_px

Floats = NDArray[np.float64]
CANDIDATES = ("do nothing", "simulation", "floor")


@dataclass(frozen=True, slots=True)
class RegionDraws:
    """Hold draws (draws, 3) of sums over a region.

    Attributes
    ----------
    error : dict of str to ndarray
        Squared error of each candidate; that of doing nothing is the contact signal.
    level : ndarray
        Sum of the captured values (of gradients: of the levels they are relative to).
    pixels : int
    """

    error: dict[str, Floats]
    level: Floats
    pixels: int

    def skill(self, candidate: str, channel_weights: Floats) -> Floats:
        """Return draws of 1 - sum w error / sum w signal."""
        return np.asarray(
            1.0 - (self.error[candidate] @ channel_weights) / (self.error["do nothing"] @ channel_weights)
        )

    def channel_skill(self, candidate: str) -> Floats:
        """Return draws (draws, 3) of the skill of each channel; not finite where contact changes nothing."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1.0 - self.error[candidate] / self.error["do nothing"])

    def relative_rms(self, candidate: str) -> Floats:
        """Return draws (draws, 3) of sqrt(mean error) / mean level; 0 where noise leaves nothing."""
        mean = self.level / self.pixels
        return np.asarray(np.sqrt(np.maximum(self.error[candidate], 0.0) / self.pixels) / mean)

    def relative_rms_of_all(self, candidate: str) -> Floats:
        """Return draws (draws,) of the root mean square of the relative error; 0 where noise leaves nothing."""
        squares = self.error[candidate] / self.pixels / (self.level / self.pixels) ** 2
        return np.asarray(np.sqrt(np.maximum(squares.mean(axis=1), 0.0)))


def propagated_draws(sums: RegionSums, drawn: Drawn, exposure: Floats, rng: np.random.Generator | None) -> RegionDraws:
    """Return draws of the sums for draws of the inputs; the pixels' noise varies where there is a generator."""
    draws = len(exposure)
    errors = {
        "simulation": sums.simulation(drawn.weights, exposure, drawn.drift),
        "do nothing": sums.signal(drawn.drift),
    }
    if sums.floor is not None:
        errors["floor"] = np.repeat(sums.floor[None], draws, axis=0)
    if rng is not None:
        of_error, of_signal = sums.noise.draw(draws, rng)
        errors["simulation"] = errors["simulation"] + of_error
        errors["do nothing"] = errors["do nothing"] + of_signal
        if "floor" in errors:
            errors["floor"] = errors["floor"] + sums.floor_noise_sd * rng.standard_normal((draws, 3))
    return RegionDraws(errors, drawn.drift[:, None] * sums.level, sums.pixels)


def resampled_draws(sums: RegionSums, draws: int, rng: np.random.Generator) -> RegionDraws:
    """Return draws of the sums over square tiles of the region, drawn with replacement.

    For images of which no input has a known uncertainty: the spread tells how much a number depends on which part of
    the region was looked at.
    """
    tile = tile_indices(sums.where, tile_side_px(sums.where))
    tiles = int(tile.max()) + 1
    counts = rng.multinomial(tiles, np.full(tiles, 1.0 / tiles), size=draws)
    of_pixel = np.tile(tile, sums.pixels // len(tile))
    # the number of pixels differs from draw to draw; the sums are brought to that of the region
    share = sums.pixels / (counts @ np.bincount(of_pixel, minlength=tiles))[:, None]

    def sum_over(values: Floats) -> Floats:
        per_tile = np.stack([np.bincount(of_pixel, weights=column, minlength=tiles) for column in values.T], axis=1)
        return np.asarray(share * (counts @ per_tile))

    names = {"simulation": "error", "do nothing": "signal", "floor": "floor"}
    errors = {name: sum_over(sums.per_pixel[of]) for name, of in names.items() if of in sums.per_pixel}
    return RegionDraws(errors, sum_over(sums.per_pixel["level"]), sums.pixels)
