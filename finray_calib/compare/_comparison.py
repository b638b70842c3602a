"""What one comparison of a simulated press with a capture is formed from: sums over its regions, formed once.

With the one exposure factor that a render may be granted, the weights of the channels, mean levels of 3 x 3 parts of
the headline region, and blocks of pixels just large enough that noise does not rule the headline.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import CompareError, TactileCapture
from finray_calib.compare._image_noise import largest_block_px
from finray_calib.compare._input_draws import InputDraws, Inputs, condition_on_levels, inputs_of
from finray_calib.compare._prepared_images import Nuisances, PreparedImages
from finray_calib.compare._region_sums import (
    LEAST_SIGNAL,
    Captured,
    RegionSums,
    RenderLayers,
    gradient_sums,
    image_sums,
)
from finray_calib.compare._regions import Region, contact_regions, pixels_within, usable_pixels


def channel_weights(no_contact: NDArray[np.float64], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return 1 / (mean of the no-contact image)^2 per channel.

    With these weights errors count relative to each channel's own brightness, so a dim fluorescent channel
    counts as much as the bright channel of the light itself.

    Parameters
    ----------
    no_contact : ndarray, shape (H, W, C)
        No-contact image, black level removed, any unit.
    mask : ndarray of bool, shape (H, W)

    Returns
    -------
    ndarray, shape (C,)
        In 1 / unit^2.

    Raises
    ------
    CompareError
        If a channel's mean over the region is not positive.
    """
    image = np.asarray(no_contact, dtype=np.float64)
    used = usable_pixels(mask, image)
    mean = np.einsum("pc->c", pixels_within(image, used)) / np.count_nonzero(used)
    if (mean <= 0).any():
        raise CompareError(
            f"Channel {int(np.argmin(mean))} of the no-contact image has a mean of {mean.min():.3g} over the region, "
            "but relative weights need a positive mean. Check the black level."
        )
    return np.asarray(1 / mean**2)


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ExposureFit:
    """Hold the levels without contact that give the exposure factor of any draw.

    1 / k = mean over channels of S0 / B, each the mean over pixels: the white-balanced level is matched. One factor for
    all channels: a gain per channel would hide an error of the paint. It is taken from the images without contact,
    because fitted to the press itself it can stand in for missing physics: a depth-table prediction of a real ball
    press that leaves out the bright halo gains 0.18 of skill over the disc of twice the contact radius from a factor of
    1.04.

    Attributes
    ----------
    simulated_layers : ndarray, shape (L,)
        Mean of each layer of the render.
    captured : ndarray, shape (C,)
        Mean of each channel of the capture.
    noise_sd_rel : float
        Standard deviation of the factor from the noise of render and capture.
    """

    simulated_layers: Floats
    captured: Floats
    noise_sd_rel: float

    def __call__(self, matrix: Floats) -> Floats:
        """Return the factors (draws,) of matrices (draws, C, L)."""
        return np.asarray(1.0 / (matrix @ self.simulated_layers / self.captured).mean(axis=1))


def exposure_fit(layers: RenderLayers, no_contact: Floats, variance: Floats, used: NDArray[np.bool_]) -> ExposureFit:
    """Take the levels over the `used` pixels of the captured no-contact image (H, W, 3) and of its noise variance.

    Raises
    ------
    CompareError
        One of the images without contact is black there.
    """
    captured = no_contact[used].mean(axis=0)
    simulated = layers.no_contact[used].astype(np.float64).mean(axis=0)
    levels = layers.matrix @ simulated
    if not (captured > 0.0).all() or not float((levels / captured).mean()) > 0.0:
        raise CompareError(
            "no exposure factor fits, because the render or a channel of the capture without contact is black over the "
            "region; check the light and the black level"
        )
    # 1 / k is a mean over channels of S0 / B, whose channels share the noise of the render's layers
    of_render = (layers.rgb(layers.no_contact_half)[used] / captured).mean(axis=1) ** 2
    of_capture = ((levels / captured**2) ** 2 * variance[used]).sum(axis=1) / len(captured) ** 2
    noise = np.sqrt((of_render + of_capture).mean() / used.sum()) / (levels / captured).mean()
    return ExposureFit(simulated, captured, float(noise))


Bools = NDArray[np.bool_]
PARTS_A_SIDE = 3
_LEAST_PIXELS = 10
_LEAST_LEVEL = 1e-9


@dataclass(frozen=True, slots=True)
class PartLevels:
    """Hold mean levels of the parts of a region; images are no contact, contact.

    Attributes
    ----------
    places : tuple of (int, int)
        Row and column of each part.
    pixels : ndarray of int, shape (parts,)
    no_contact_layers : ndarray, shape (parts, L)
    contact_layers : ndarray, shape (parts, L (1 + poses))
    captured : ndarray, shape (2, 3, parts)
    noise_variance : ndarray, shape (2, 3, parts)
        Of ln(simulated / captured), from render and camera.
    render_variance : ndarray, shape (2, 3, parts)
        The render's part of it.
    """

    places: tuple[tuple[int, int], ...]
    pixels: NDArray[np.int64]
    no_contact_layers: Floats
    contact_layers: Floats
    captured: Floats
    noise_variance: Floats
    render_variance: Floats

    def simulated(self, drawn: InputDraws, exposure: Floats) -> Floats:
        """Return the render's levels (draws, 2, 3, parts)."""
        levels = [drawn.matrix @ self.no_contact_layers.T, drawn.weights @ self.contact_layers.T]
        return np.asarray(exposure[:, None, None, None] * np.stack(levels, axis=1))

    def log_ratio(self, drawn: InputDraws, exposure: ExposureFit | None) -> Floats:
        """Return ln(simulated / captured) of the draws, (draws, 2, 3, parts)."""
        k = np.ones(len(drawn.log_drift)) if exposure is None else exposure(drawn.matrix)
        ratio = np.log(np.maximum(self.simulated(drawn, k) / self.captured, _LEAST_LEVEL))
        ratio[:, 1] -= drawn.log_drift[:, None, None]
        return ratio


def part_levels(layers: RenderLayers, captured: Captured, used: Bools, pose_names: tuple[str, ...]) -> PartLevels:
    """Form the levels of all parts that hold enough pixels and light.

    Raises
    ------
    CompareError
        There is none.
    """
    places, masks = [], []
    for row, column, where in _parts(used):
        if (captured.contact[where].mean(axis=0) > 0.0).all() and (captured.no_contact[where].mean(axis=0) > 0.0).all():
            places.append((row, column))
            masks.append(where)
    if not masks:
        raise CompareError(
            f"the region was divided into {PARTS_A_SIDE} x {PARTS_A_SIDE} parts, but none has at least {_LEAST_PIXELS} "
            "usable pixels and light in every channel; take a larger image, or capture with more light"
        )
    pixels = np.array([int(m.sum()) for m in masks])
    halves = [
        [layers.halves(state, m, names) for m in masks]
        for state, names in (("no_contact", ()), ("contact", pose_names))
    ]
    means = [np.array([(a + b).mean(axis=0) / 2.0 for a, b in state]) for state in halves]
    images = (captured.no_contact, captured.contact)
    levels = np.array([[image[m].mean(axis=0) for m in masks] for image in images])
    of_camera = np.array([[captured.variance(image)[m].mean(axis=0) for m in masks] for image in images])
    of_render = np.array(
        [[v[m].mean(axis=0) for m in masks] for v in (layers.no_contact_variance, layers.contact_variance)]
    )
    best = np.array([mean[:, : layers.matrix.shape[1]] @ layers.matrix.T for mean in means])
    render = of_render / np.maximum(best, _LEAST_LEVEL) ** 2 / pixels[:, None]
    camera = of_camera / levels**2 / pixels[:, None]
    return PartLevels(
        places=tuple(places),
        pixels=pixels,
        no_contact_layers=means[0],
        contact_layers=means[1],
        captured=np.moveaxis(levels, 1, 2),
        noise_variance=np.moveaxis(render + camera, 1, 2),
        render_variance=np.moveaxis(render, 1, 2),
    )


def _parts(used: Bools) -> list[tuple[int, int, Bools]]:
    """Return row, column and pixels of each part of the region's bounding box that holds enough pixels."""
    rows, columns = np.nonzero(used)
    row_of, column_of = _third(rows), _third(columns)
    found = []
    for row in range(PARTS_A_SIDE):
        for column in range(PARTS_A_SIDE):
            inside = (row_of == row) & (column_of == column)
            if inside.sum() >= _LEAST_PIXELS:
                where = np.zeros_like(used)
                where[rows[inside], columns[inside]] = True
                found.append((row, column, where))
    return found


def _third(place: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return which third of their range places lie in."""
    first, span = place.min(), int(np.ptp(place)) + 1
    return np.asarray((place - first) * PARTS_A_SIDE // span)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Hold everything that one comparison is formed from.

    Attributes
    ----------
    layers : RenderLayers
    captured : Captured
    inputs : Inputs or None
        None where nothing is known about the inputs: intervals then come from parts of the region.
    regions : tuple of Region
    used : tuple of ndarray of bool, shape (H, W)
        Usable pixels of each region.
    sums, gradients : tuple of RegionSums
        Of each region; gradients may be missing, and of encoded values all are.
    channel_weights : ndarray, shape (3,)
        Of the headline region, in 1 / unit^2; common to all regions.
    exposure : ExposureFit or None
        None where no factor is fitted.
    levels : PartLevels or None
        Of parts of the headline region; None where no input is known.
    nuisances : Nuisances or None
        Tone curve and gains of the camera; None where nothing is taken out.
    """

    layers: RenderLayers
    captured: Captured
    inputs: Inputs | None
    regions: tuple[Region, ...]
    used: tuple[NDArray[np.bool_], ...]
    sums: tuple[RegionSums, ...]
    gradients: tuple[RegionSums | None, ...]
    channel_weights: Floats
    exposure: ExposureFit | None
    levels: PartLevels | None
    nuisances: Nuisances | None = None

    def conditioned(self, drawn: InputDraws, rng: np.random.Generator) -> InputDraws:
        """Return draws narrowed by what the captured levels say."""
        levels = self.levels
        if levels is None:
            return drawn
        return condition_on_levels(drawn, lambda d: levels.log_ratio(d, self.exposure), levels.noise_variance, rng)

    def exposure_of(self, matrix: Floats, rng: np.random.Generator | None = None) -> Floats:
        """Return the exposure factors (draws,) of matrices (draws, 3, L), noisy where there is a generator."""
        if self.exposure is None:
            return np.ones(len(matrix))
        factors = self.exposure(matrix)
        if rng is not None:
            factors = factors * np.exp(self.exposure.noise_sd_rel * rng.standard_normal(len(factors)))
        return factors

    @property
    def headline_noise(self) -> float:
        """Standard deviation of the headline's skill from noise alone; infinite where contact shows no signal."""
        sums = self.sums[-1]
        signal = float(sums.signal(np.ones(1))[0] @ self.channel_weights)
        if not signal > 0.0:
            return float("inf")
        return float(np.sqrt(sums.noise.error @ self.channel_weights**2) / signal)

    @property
    def best_exposure(self) -> float:
        """The factor at the best values."""
        return float(self.exposure_of(self.layers.matrix[None])[0])


def prepare_comparison(
    layers: RenderLayers,
    captured: Captured,
    regions: Sequence[Region],
    inputs: Inputs | None,
    fit_exposure: bool,
    relative_weights: bool,
    demand_contact: bool = True,
) -> Comparison:
    """Form all sums over the regions; the last region is the headline's.

    A pixel that is not finite in any image is left out of every row.

    Parameters
    ----------
    layers, captured, inputs
        Both sides, and what is uncertain.
    regions
        At least one; the last one holds the others.
    fit_exposure
        Whether the render may be scaled by one factor common to all channels.
    relative_weights
        Whether errors count relative to each channel's own level, else plainly.
    demand_contact
        Whether to look for a contact signal; else :func:`require_contact` is to be called on blocks that are large
        enough to show a weak one.

    Raises
    ------
    CompareError
        If no region is given, shapes differ, or contact changes nothing in a region.
    """
    if not regions:
        raise CompareError("no region to compare is given; give the contact region, and a wider region around it")
    images = [captured.contact, captured.no_contact, *([] if captured.repeat is None else [captured.repeat])]
    used = tuple(
        usable_pixels(region.mask, layers.contact[..., :1].astype(np.float64), *(i[..., :1] for i in images))
        for region in regions
    )
    weights = channel_weights(captured.no_contact, used[-1]) if relative_weights else np.ones(3)
    exposure = (
        exposure_fit(layers, captured.no_contact, captured.variance(captured.no_contact), used[-1])
        if fit_exposure
        else None
    )
    k = 1.0 if exposure is None else float(exposure(layers.matrix[None])[0])
    poses = () if inputs is None else inputs.pose_names
    sums = tuple(image_sums(layers, captured, where, k, poses) for where in used)
    if demand_contact:
        for region, of_region in zip(regions, sums, strict=True):
            _require_contact(region, of_region, weights)
    gradients: tuple[RegionSums | None, ...] = (None,) * len(used)
    if relative_weights:
        gradients = tuple(gradient_sums(layers, captured, used, k, poses))
    knows = inputs is not None and layers.inputs is not None
    levels = part_levels(layers, captured, used[-1], poses) if knows else None
    return Comparison(layers, captured, inputs, tuple(regions), used, sums, gradients, weights, exposure, levels)


def require_contact(comparison: Comparison) -> None:
    """Refuse images whose regions change no more than noise does.

    Raises
    ------
    CompareError
        There is nothing to explain in a region.
    """
    for region, of_region in zip(comparison.regions, comparison.sums, strict=True):
        _require_contact(region, of_region, comparison.channel_weights)


def _require_contact(region: Region, sums: RegionSums, weights: Floats) -> None:
    """Refuse a region where contact changes no more than noise does."""
    signal = float(sums.signal(np.ones(1))[0] @ weights)
    noise = float(np.sqrt(sums.noise.signal @ weights**2))
    rounding = ROUNDING_REL * float(np.abs(sums.no_contact_square) @ weights)
    if not signal > max(LEAST_SIGNAL * noise, rounding):
        raise CompareError(
            f"contact changes nothing in the region '{region.name}' beyond the camera's noise, so there is nothing to "
            "explain; check that the contact image shows contact and that the region lies on the contact, or press "
            "deeper"
        )


ROUNDING_REL = 1e-12
"""Share of the sum of squares that rounding may leave of the difference of such sums; a step of a 16-bit picture in
every pixel is 1e-10."""
LARGEST_HEADLINE_NOISE = 0.01
"""Standard deviation of the headline skill from noise alone, from which on pixels are averaged over blocks."""


def block_averaged_comparison(images: PreparedImages, capture: TactileCapture) -> tuple[PreparedImages, Comparison]:
    """Return images and sums over the smallest blocks that keep noise from ruling the headline.

    Raises
    ------
    CompareError
        Contact changes nothing in a region beyond noise, however large the blocks.
    """
    linear, side, largest = capture.encoding == "linear", 1, largest_block_px(images.distance)
    while True:
        blocked = images if side == 1 else images.blocked(side)
        captured, distance = blocked.captured, blocked.distance
        inputs = None
        if linear:
            inputs = inputs_of(blocked.layers, capture, captured.no_contact, captured.repeat, np.isfinite(distance))
        regions = contact_regions(distance)
        comparison = prepare_comparison(blocked.layers, captured, regions, inputs, linear, linear, demand_contact=False)
        if side >= largest or comparison.headline_noise <= LARGEST_HEADLINE_NOISE:
            require_contact(comparison)
            nuisances = None if blocked.nuisances.is_idle else blocked.nuisances
            return blocked, replace(comparison, nuisances=nuisances)
        side *= 2
