"""What one comparison of a simulated press with a capture is formed from: sums over its regions, formed once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.conditioning import condition_on_levels
from finray_calib.compare.exposure import ExposureFit, exposure_fit
from finray_calib.compare.input_draws import Drawn, Inputs
from finray_calib.compare.part_levels import PartLevels, part_levels
from finray_calib.compare.region_sums import LEAST_SIGNAL, Captured, RegionSums, gradient_sums, image_sums
from finray_calib.compare.regions import Region, usable_pixels
from finray_calib.compare.render_layers import RenderLayers
from finray_calib.compare.skill import channel_weights

Floats = NDArray[np.float64]


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
        Of each region; gradients may be missing.
    channel_weights : ndarray, shape (3,)
        Of the headline region, in 1 / unit^2; common to all regions.
    exposure : ExposureFit or None
        None where no factor is fitted.
    levels : PartLevels or None
        Of parts of the headline region; None where no input is known.
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

    def conditioned(self, drawn: Drawn, rng: np.random.Generator) -> Drawn:
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
        raise CompareError("no region to compare: give at least the contact region and one that holds its halo")
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
    gradients = tuple(gradient_sums(layers, captured, where, k, poses) for where in used)
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
    if not signal > LEAST_SIGNAL * noise:
        raise CompareError(
            f"contact changes nothing in the region '{region.name}' beyond the camera's noise; there is nothing to "
            "explain: check that the contact image is one, that the region lies on the contact, or press deeper"
        )
