"""The rows of the table: each candidate image against the captured one, in one region."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.compare import ErrorRow, Interval
from data_schemas.errors import CompareError, MissingExtraError
from finray_calib.compare.chromaticity import chromaticity_error
from finray_calib.compare.colour_difference import colour_difference_map
from finray_calib.compare.displayed_images import display_white_dn, displayed_image
from finray_calib.compare.flip_error import flip_mean
from finray_calib.compare.multi_scale_similarity import multi_scale_similarity
from finray_calib.compare.photometric_error import RegionResult
from finray_calib.compare.stopping_rule import ends
from finray_calib.compare.structural_similarity import StructuralSimilarity, structural_similarity

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
CHROMATICITY_DRAWS = 100
LARGEST_SKILL = 1.0
"""Of a simulation without error."""


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


def shown_candidate(
    image: Floats,
    variance: Floats,
    captured: Floats,
    no_contact: Floats,
    headline: Bools,
    data_range_dn: float,
    linear: bool,
) -> ShownCandidate:
    """Return a candidate with its likeness to the captured contact image."""
    white_dn = display_white_dn(no_contact) if linear else data_range_dn
    usable: Bools = np.asarray(np.isfinite(captured + image).all(axis=2), dtype=np.bool_)
    shown = [displayed_image(np.where(usable[..., None], i, 0.0), white_dn, linear) for i in (image, captured)]
    multi_scale = multi_scale_similarity(image, captured, data_range_dn)
    return ShownCandidate(
        image,
        variance,
        structural_similarity(image, captured, data_range_dn),
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


def error_row(
    name: str,
    candidate: ShownCandidate,
    captured: Floats,
    captured_variance: Floats,
    used: Bools,
    result: RegionResult,
    best: RegionResult | None,
    channel_weights: Floats,
    data_range_dn: float,
    linear: bool,
    drawn_images: Floats | None,
    is_headline: bool,
    told: Bools,
) -> ErrorRow:
    """Return the metrics of one candidate.

    Parameters
    ----------
    name, candidate
        Which one, and its image.
    captured, captured_variance : ndarray, shape (H, W, 3)
        Contact image and its noise.
    used : ndarray of bool, shape (H, W)
        Pixels of the region.
    result
        Draws of the region; estimates are their medians.
    best
        Where given, estimates are taken from it.
    channel_weights : ndarray, shape (3,)
    data_range_dn
        Full scale above black.
    linear
        Whether values are proportional to light.
    drawn_images : ndarray, shape (draws, P, 3), or None
        The candidate for draws of the inputs at the region's pixels.
    is_headline
        Whether this is the headline region, which FLIP is taken over.
    told : ndarray of bool, shape (3,)
        Channels that contact changes beyond noise; the others have no skill of their own.
    """
    images, centre = result.images, (best or result).images
    channels = np.where(told, np.median(centre.channel_skill(name), axis=0), np.nan)
    mean_square = float(((candidate.image[used] - captured[used]) ** 2).mean())
    differences = candidate.colour_difference[used]
    ssim = candidate.similarity.mean_within(used)
    rms = images.relative_rms(name), centre.relative_rms(name)
    gradients, central = result.gradients, (best or result).gradients
    return ErrorRow.model_validate(
        {
            "candidate": name,
            "skill": skill_interval(images.skill(name, channel_weights), centre.skill(name, channel_weights)),
            "skill_per_channel": tuple(float(v) if np.isfinite(v) else None for v in channels),
            "relative_rms": tuple(interval(rms[0][:, c], rms[1][:, c]) for c in range(3)) if linear else None,
            "difference_gradient_rms_per_px": None
            if gradients is None or central is None or not linear
            else interval(gradients.relative_rms_of_all(name), central.relative_rms_of_all(name)),
            # the floor is made of the capture itself and shares its noise
            "chromaticity_rms": _chromaticity(
                candidate,
                captured,
                0.0 * captured_variance if name == "floor" else captured_variance,
                used,
                drawn_images,
            )
            if linear
            else None,
            "psnr_db": 10.0 * np.log10(data_range_dn**2 / mean_square) if mean_square > 0.0 else None,
            "ssim": ssim if np.isfinite(ssim) else None,
            "ms_ssim": candidate.ms_ssim,
            "flip_mean": candidate.flip if is_headline else None,
            "ciede2000_mean": float(differences.mean()),
            "ciede2000_p95": float(np.quantile(differences, 0.95)),
        }
    )


def interval(draws: Floats, centre: Floats) -> Interval:
    """Return the 95 % interval of draws with the median of `centre` as estimate."""
    low, high = ends(draws)
    return Interval(estimate=float(np.median(centre)), low95=float(low), high95=float(high))


def skill_interval(draws: Floats, centre: Floats) -> Interval:
    """Return the 95 % interval of a skill, which ends at 1 at the latest; the estimate stays as it is.

    No skill exceeds 1, so that an interval cut there holds the true one as often as before. With the noise taken out an
    estimate scatters about its truth to both sides: one above 1 is not cut, or means over presses would be too low.
    """
    found = interval(draws, centre)
    return found.model_copy(
        update={"low95": min(found.low95, LARGEST_SKILL), "high95": min(found.high95, LARGEST_SKILL)}
    )


def full_frame_ssim(candidates: Mapping[str, ShownCandidate]) -> dict[str, float | None]:
    """Return the full-frame SSIM of each candidate, for comparison with papers."""
    means = {name: candidate.similarity.mean for name, candidate in candidates.items()}
    return {name: mean if np.isfinite(mean) else None for name, mean in means.items()}


def _chromaticity(
    candidate: ShownCandidate, captured: Floats, captured_variance: Floats, used: Bools, drawn: Floats | None
) -> Interval | None:
    """Return the chromaticity error over the region with the spread of the drawn images; None of too noisy images."""
    variance, of_capture = (v[used][None] for v in (candidate.variance, captured_variance))
    real = captured[used][None]
    everywhere = np.ones(real.shape[:2], dtype=np.bool_)
    images = candidate.image[used][None] if drawn is None else drawn
    try:
        values = np.array([chromaticity_error(i[None], real, everywhere, variance, of_capture).rms for i in images])
    except CompareError:
        return None
    # noise that makes up all of it leaves nothing to tell
    return interval(values, values) if np.median(values) > 0.0 else None
