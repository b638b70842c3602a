"""A picture in independent passes: what they differ by is the noise of each pixel, that of the baked walls included."""

from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from sim.optics._paint_bands import BAND_NAMES
from sim.optics._painted_walls import last_band
from sim.optics._path_rules import LookupTable

MOST_PASSES: Final = 16
"""Passes of a picture, as many as batches of a bake: Student's t with 15 degrees of freedom is near the normal."""

_LANES: Final = {"cuda": 1 << 24, "llvm": 1 << 22}
"""Paths traced at once, by what they are compiled for; more need memory and gain nothing."""

_AROUND_PX = 5

FloatImage = NDArray[np.float32]


class PassedPicture(NamedTuple):
    """Channels of a picture, half the difference of its halves, both (..., channel); variance of the bands' means."""

    mean: FloatImage
    half_difference: FloatImage
    band_variance: FloatImage


def passes_of(*paths_per_pixel: int) -> int:
    """Return how many passes these even numbers of paths per pixel divide into: 16, 8, 4 or 2.

    Raises
    ------
    SimulateError
        One is odd.
    """
    for passes in (MOST_PASSES, 8, 4, 2):
        if all(paths % passes == 0 for paths in paths_per_pixel):
            return passes
    raise SimulateError(f"paths per pixel must be even numbers, got {', '.join(map(str, paths_per_pixel))}")


def joined_passes(passes: NDArray[np.floating], chains: Sequence[str]) -> PassedPicture:
    r"""Return mean, half difference and variance of independent passes.

    :math:`\bar x = \sum x_k / K`, half difference :math:`(\bar x_{k < K/2} - \bar x_{k \ge K/2}) / 2`, and for the
    bands, whose light is that of all their chains, :math:`s^2 / K` with K - 1 degrees of freedom.

    Parameters
    ----------
    passes
        (K, ..., channel), K even.
    chains
        What the channels hold.
    """
    values = np.asarray(passes, dtype=np.float64)
    halves = values.reshape(2, len(values) // 2, *values.shape[1:]).mean(axis=1)
    of_band = np.array([[last_band(chain) == band for band in BAND_NAMES] for chain in chains], dtype=np.float64)
    variance = (values @ of_band).var(axis=0, ddof=1) / len(values)
    return PassedPicture(
        *(image.astype(np.float32) for image in (halves.mean(axis=0), 0.5 * (halves[0] - halves[1]), variance))
    )


def traced_picture(
    scene: Any,
    integrator: Any,
    renderer: ModuleType,
    chains: Sequence[str],
    regions: Sequence[tuple[NDArray[np.int64], int]],
    seed_of: Callable[[int], int],
) -> PassedPicture:
    """Trace a picture of the scene's camera by an integrator of a compiled variant.

    Parameters
    ----------
    scene, integrator, renderer
        The integrator's channels are `chains`; where it has ``divide_lanes``, each pass sees its own batch of what
        the walls emit.
    chains
        What the channels hold.
    regions
        Pixels (n, 2: column, row) and paths per pixel of each region. One does not change the noise of another.
    seed_of
        Returns the seed of each stream of random numbers by its number.
    """
    columns, rows = scene.sensors()[0].film().size()
    passes = passes_of(*(paths for _, paths in regions))
    picture = PassedPicture(
        *(np.zeros((rows, columns, n), dtype=np.float32) for n in (len(chains), len(chains), len(BAND_NAMES)))
    )
    most_lanes = _LANES[renderer.variant().partition("_")[0]]
    for number, (pixels, paths) in enumerate(regions):
        chunks = np.array_split(pixels, -(-len(pixels) * paths // most_lanes)) if len(pixels) else []
        for part, chunk in enumerate(chunks):
            lanes = _Lanes(chunk, (rows, columns), paths, passes)
            traced = lanes.traced(scene, integrator, renderer, seed_of(1 + number + len(regions) * part))
            for image, values in zip(picture, joined_passes(traced, chains), strict=True):
                image[chunk[:, 1], chunk[:, 0]] = values
    return picture._replace(band_variance=known_variance(picture.band_variance))


def known_variance(variance: FloatImage) -> FloatImage:
    """Return a variance image (rows, columns, band) with that of their neighbourhood where no path brought light.

    There all passes are alike, dark, and their own variance of 0 would claim that the pixel is known exactly.
    """
    around = cv2.blur(variance, (_AROUND_PX, _AROUND_PX), borderType=cv2.BORDER_REPLICATE)
    # its running sums may end a last digit below zero
    return np.where(variance > 0.0, variance, np.maximum(around, 0.0)).astype(np.float32)


class _Lanes(NamedTuple):
    """Pixels (n, 2: column, row) of a picture (rows, columns) whose paths are traced at once."""

    corners: NDArray[np.int64]
    shape: tuple[int, int]
    paths: int
    passes: int

    def traced(self, scene: Any, integrator: Any, renderer: Any, seed: int) -> NDArray[np.float32]:
        """Return the radiance of each pass, (passes, n, channel)."""
        import drjit as dr

        lanes = len(self.corners) * self.paths
        per_pixel, per_pass = (dr.opaque(renderer.UInt32, n) for n in (self.paths, self.paths // self.passes))
        rows, columns = (dr.opaque(renderer.Float, n) for n in self.shape)
        lane = dr.arange(renderer.UInt32, lanes)
        number = lane // per_pixel
        corner = LookupTable(self.corners.astype(np.float64), renderer).row(number)
        sampler = renderer.load_dict({"type": "independent"})
        sampler.seed(seed, lanes)
        jitter = sampler.next_2d()
        place = renderer.Point2f((corner.x + jitter.x) / columns, (corner.y + jitter.y) / rows)
        ray, weight = scene.sensors()[0].sample_ray_differential(0.0, 0.0, place, renderer.Point2f(0.5))
        divide = getattr(integrator, "divide_lanes", None)
        if divide is not None:
            divide((lane - number * per_pixel) // per_pass)
        radiance, _, further = integrator.sample(scene, sampler, ray)
        radiance *= weight
        channels = [radiance.x, radiance.y, radiance.z, *further]
        dr.eval(channels)
        if divide is not None:
            divide(dr.opaque(renderer.UInt32, 0))
        own = self.paths // self.passes
        # summed where they were traced: to bring all paths here from a GPU takes longer than to trace them
        values = np.stack([np.array(dr.block_sum(channel, own)) for channel in channels], axis=-1) / np.float32(own)
        return np.asarray(values.reshape(len(self.corners), self.passes, len(channels)).transpose(1, 0, 2))
