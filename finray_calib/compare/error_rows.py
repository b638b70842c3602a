"""The rows of the table of a region: each candidate image against the captured one."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.compare import ErrorRow, Interval
from data_schemas.errors import CompareError
from finray_calib.compare.chromaticity import chromaticity_error
from finray_calib.compare.photometric_error import RegionResult
from finray_calib.compare.shown_candidates import ShownCandidate
from finray_calib.compare.stopping_rule import ends

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
LARGEST_SKILL = 1.0
"""Of a simulation without error."""

_WITHHELD: Final = {"relative_rms": None, "difference_gradient_rms_per_px": None, "chromaticity_rms": None}


@dataclass(frozen=True, slots=True)
class ComparedRegion:
    """Hold what the rows of one region share.

    Attributes
    ----------
    captured, captured_variance : ndarray, shape (H, W, 3)
        Contact image and its noise.
    used : ndarray of bool, shape (H, W)
        Pixels of the region.
    result : RegionResult
        Draws of the region; estimates are their medians.
    best : RegionResult or None
        Where given, estimates are taken from it.
    channel_weights : ndarray, shape (3,)
    data_range_dn : float
        Full scale above black.
    linear : bool
        Whether values are proportional to light.
    is_headline : bool
        Whether this is the headline region, which FLIP is taken over.
    told : ndarray of bool, shape (3,)
        Channels that contact changes beyond noise; the others have no skill of their own.
    """

    captured: Floats
    captured_variance: Floats
    used: Bools
    result: RegionResult
    best: RegionResult | None
    channel_weights: Floats
    data_range_dn: float
    linear: bool
    is_headline: bool
    told: Bools


def error_row(name: str, candidate: ShownCandidate, region: ComparedRegion, drawn_images: Floats | None) -> ErrorRow:
    """Return the metrics of one candidate in one region.

    Parameters
    ----------
    name, candidate
        Which one, and its image.
    region
        Where, and against what.
    drawn_images : ndarray, shape (draws, P, 3), or None
        The candidate for draws of the inputs at the region's pixels.
    """
    images, centre = region.result.images, (region.best or region.result).images
    skills = images.skill(name, region.channel_weights), centre.skill(name, region.channel_weights)
    channels = np.where(region.told, np.median(centre.channel_skill(name), axis=0), np.nan)
    mean_square = float(((candidate.image[region.used] - region.captured[region.used]) ** 2).mean())
    differences = candidate.colour_difference[region.used]
    ssim = candidate.similarity.mean_within(region.used)
    linear = _of_linear_light(name, candidate, region, drawn_images) if region.linear else _WITHHELD
    return ErrorRow.model_validate(
        {
            "candidate": name,
            "skill": skill_interval(*skills),
            "skill_per_channel": tuple(float(v) if np.isfinite(v) else None for v in channels),
            **linear,
            "psnr_db": 10.0 * np.log10(region.data_range_dn**2 / mean_square) if mean_square > 0.0 else None,
            "ssim": ssim if np.isfinite(ssim) else None,
            "ms_ssim": candidate.ms_ssim,
            "flip_mean": candidate.flip if region.is_headline else None,
            "ciede2000_mean": float(differences.mean()),
            "ciede2000_p95": float(np.quantile(differences, 0.95)),
        }
    )


def _of_linear_light(
    name: str, candidate: ShownCandidate, region: ComparedRegion, drawn_images: Floats | None
) -> dict[str, Any]:
    """Return the metrics that only values proportional to light allow."""
    result, centre = region.result, region.best or region.result
    rms = result.images.relative_rms(name), centre.images.relative_rms(name)
    gradients, central = result.gradients, centre.gradients
    return {
        "relative_rms": tuple(interval(rms[0][:, c], rms[1][:, c]) for c in range(3)),
        "difference_gradient_rms_per_px": None
        if gradients is None or central is None
        else interval(gradients.relative_rms_of_all(name), central.relative_rms_of_all(name)),
        # the floor is made of the capture itself and shares its noise
        "chromaticity_rms": _chromaticity(
            candidate,
            region,
            0.0 * region.captured_variance if name == "floor" else region.captured_variance,
            drawn_images,
        ),
    }


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


def _chromaticity(
    candidate: ShownCandidate, region: ComparedRegion, captured_variance: Floats, drawn: Floats | None
) -> Interval | None:
    """Return the chromaticity error over the region with the spread of the drawn images; None of too noisy images."""
    used = region.used
    variance, of_capture = (v[used][None] for v in (candidate.variance, captured_variance))
    real = region.captured[used][None]
    everywhere = np.ones(real.shape[:2], dtype=np.bool_)
    images = candidate.image[used][None] if drawn is None else drawn
    try:
        values = np.array([chromaticity_error(i[None], real, everywhere, variance, of_capture).rms for i in images])
    except CompareError:
        return None
    # noise that makes up all of it leaves nothing to tell
    return interval(values, values) if np.median(values) > 0.0 else None
