"""The candidates as images: doing nothing, the render, and a perfect render seen on the repeat; each formed once."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.errors import MissingExtraError
from finray_calib.compare.colour_difference import colour_difference_map
from finray_calib.compare.comparison import Comparison
from finray_calib.compare.displayed_images import display_white_dn, displayed_image
from finray_calib.compare.flip_error import flip_mean
from finray_calib.compare.linear_image import full_scale_dn
from finray_calib.compare.multi_scale_similarity import multi_scale_similarity
from finray_calib.compare.region_sums import Captured
from finray_calib.compare.structural_similarity import StructuralSimilarity, structural_similarity

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
SSIM_SETTINGS = (
    "Wang 2004 on the compared values: sigma 1.5, 11 x 11, K1 0.01, K2 0.03, population covariance, no border"
)


@dataclass(frozen=True, slots=True)
class ShownCandidate:
    """Hold what a candidate is as an image, formed once for all regions.

    Attributes
    ----------
    image : ndarray, shape (H, W, 3)
    variance : ndarray, shape (H, W, 3)
        Of its noise.
    similarity : StructuralSimilarity
        To the capture, as the images are: noise lowers it.
    ms_ssim : float or None
        None for small images.
    flip : float or None
        Mean over the headline region; None without the extra 'flip'.
    colour_difference : ndarray, shape (H, W)
        CIEDE2000 to the capture as displayed; NaN where one of them is missing.
    """

    image: Floats
    variance: Floats
    similarity: StructuralSimilarity
    ms_ssim: float | None
    flip: float | None
    colour_difference: Floats


def shown_candidates(comparison: Comparison, capture: TactileCapture) -> dict[str, ShownCandidate]:
    """Return the candidates by name, at the level of the capture."""
    layers, captured, k = comparison.layers, comparison.captured, comparison.best_exposure
    images = {
        "do nothing": (captured.no_contact, captured.variance(captured.no_contact)),
        "simulation": (k * layers.rgb(layers.contact), k**2 * layers.contact_variance),
    }
    if captured.repeat is not None:
        variance = captured.variance(captured.repeat) + captured.variance(captured.no_contact)
        images["floor"] = (captured.contact + captured.repeat - captured.no_contact, variance)
    return {name: _shown(*image, captured, comparison.used[-1], capture) for name, image in images.items()}


def _shown(
    image: Floats, variance: Floats, captured: Captured, headline: Bools, capture: TactileCapture
) -> ShownCandidate:
    """Return a candidate with its likeness to the captured contact image."""
    linear, data_range_dn = capture.encoding == "linear", full_scale_dn(capture)
    white_dn = display_white_dn(captured.no_contact) if linear else data_range_dn
    contact = captured.contact
    usable: Bools = np.asarray(np.isfinite(contact + image).all(axis=2), dtype=np.bool_)
    shown = [displayed_image(np.where(usable[..., None], i, 0.0), white_dn, linear) for i in (image, contact)]
    multi_scale = multi_scale_similarity(image, contact, data_range_dn)
    return ShownCandidate(
        image,
        variance,
        structural_similarity(image, contact, data_range_dn),
        None if multi_scale is None else multi_scale.value,
        _flip(shown[1], shown[0], headline),
        np.where(usable, colour_difference_map(*shown), np.nan),
    )


def _flip(captured_srgb: Floats, candidate_srgb: Floats, where: Bools) -> float | None:
    """Return the mean FLIP, where its package is installed."""
    try:
        return flip_mean(captured_srgb, candidate_srgb, where)
    except MissingExtraError:
        return None


def full_frame_ssim(candidates: Mapping[str, ShownCandidate]) -> dict[str, float | None]:
    """Return the full-frame SSIM of each candidate, for comparison with papers."""
    means = {name: candidate.similarity.mean for name, candidate in candidates.items()}
    return {name: mean if np.isfinite(mean) else None for name, mean in means.items()}
