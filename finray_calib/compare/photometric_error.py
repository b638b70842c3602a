"""The table of a sim-to-real comparison: do nothing, the simulation, and the floor of the capture itself."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import CompareError
from finray_calib.compare.interval import Interval, relative_rms_interval, skill_interval
from finray_calib.compare.regions import Region, clipped_pixels, usable_pixels
from finray_calib.compare.skill import ExposureFactor, checked_weights, exposure_factor, skill_score
from finray_calib.compare.structural_similarity import StructuralSimilarity, structural_similarity


@dataclass(frozen=True, slots=True)
class PhotometricRow:
    """Hold the metrics of one candidate image over one region.

    Attributes
    ----------
    skill : Interval
        Skill score with its interval, see `skill_score`.
    per_channel_skill : ndarray, shape (C,)
        Skill of each channel alone; NaN where contact does not change the channel.
    relative_rms : tuple of Interval or None
        One for each channel; None for encoded values, whose mean has no meaning.
    ssim_full_frame, ssim_in_region : float
        Structural similarity, mean over the frame and over the region.
    psnr_db : float
        Peak signal-to-noise ratio over the region, dB; infinite for an identical image.
    """

    skill: Interval
    per_channel_skill: NDArray[np.float64]
    relative_rms: tuple[Interval, ...] | None
    ssim_full_frame: float
    ssim_in_region: float
    psnr_db: float


@dataclass(frozen=True, slots=True)
class RegionError:
    """Hold the three rows of one region and what entered them.

    Attributes
    ----------
    region : Region
    do_nothing : PhotometricRow
        The no-contact image in place of the simulation; its skill is 0.
    simulation : PhotometricRow
    floor : PhotometricRow or None
        A perfect simulation of the contact, seen on the repeat of the no-contact image: the ceiling of the
        skill. None without a repeat.
    channel_weights : ndarray, shape (C,)
        In 1 / unit^2.
    pixels_used : int
    clipped_fraction_rel : float
        Pixels of the region left out because a capture is at full scale, relative to all its pixels.
    """

    region: Region
    do_nothing: PhotometricRow
    simulation: PhotometricRow
    floor: PhotometricRow | None
    channel_weights: NDArray[np.float64]
    pixels_used: int
    clipped_fraction_rel: float


@dataclass(frozen=True, slots=True)
class PhotometricError:
    """Hold the comparison of one simulated press with one capture.

    Attributes
    ----------
    regions : tuple of RegionError
        In the order asked for.
    exposure : ExposureFactor or None
        The factor fitted over the union of the regions and applied to the simulation; None if it was not fitted
        (k = 1).
    linear : bool
        False for encoded values with unknown encoding.
    """

    regions: tuple[RegionError, ...]
    exposure: ExposureFactor | None
    linear: bool


def photometric_error(
    simulated: NDArray[np.float64],
    captured: NDArray[np.float64],
    no_contact: NDArray[np.float64],
    repeat_no_contact: NDArray[np.float64] | None,
    regions: Sequence[Region],
    data_range_dn: float,
    linear: bool,
    rng: np.random.Generator,
    fit_exposure: bool = True,
    weights: NDArray[np.float64] | None = None,
    simulated_no_contact: NDArray[np.float64] | None = None,
) -> PhotometricError:
    """Compare a simulated press with its capture, beside doing nothing and beside the capture's own floor.

    For each region three candidates S stand against the capture D: the no-contact image B (k = 1), the
    simulation (k fitted once over the union of the regions, or 1), and D + (B' - B) with the repeat B' of the
    no-contact image (k = 1), whose skill 1 - sum w (B' - B)^2 / sum w (B - D)^2 is the ceiling. A pixel where a
    capture is clipped, or any image is not finite, is left out of every row. Valid for registered images in
    one unit; on encoded values the exposure factor is only a gain on code values.

    Give `simulated_no_contact` wherever there is one: k is then fitted to the no-contact capture. Fitted to the
    press itself, k can stand in for missing physics: a depth-table prediction of a real ball press that leaves
    out the bright halo gains 0.18 of skill over the disc of twice the contact radius from a factor of 1.04.

    Parameters
    ----------
    simulated, captured, no_contact : ndarray, shape (H, W, C)
        Registered images, black level removed, in one unit.
    repeat_no_contact : ndarray, shape (H, W, C), or None
        A second no-contact image, taken at another moment.
    regions : sequence of Region
    data_range_dn : float
        Full scale in the images' unit (255 for 8 bit).
    linear : bool
        Whether values are proportional to light.
    rng : numpy.random.Generator
        For the bootstrap intervals.
    fit_exposure : bool
        Whether the simulation may be scaled by one factor common to all channels.
    weights : ndarray, shape (C,), optional
        Channel weights; default `channel_weights` of each region, ones for the plain pooled score.
    simulated_no_contact : ndarray, shape (H, W, C), optional
        Render without contact at the exposure of `simulated`; used for the exposure factor only.

    Returns
    -------
    PhotometricError

    Raises
    ------
    CompareError
        If shapes differ, no region is given, or a region cannot be scored (see `skill_score`).
    """
    if not regions:
        raise CompareError("No region to compare. Give at least the contact region and one that holds its halo.")
    simulation, capture, background = (np.asarray(i, dtype=np.float64) for i in (simulated, captured, no_contact))
    repeat = None if repeat_no_contact is None else np.asarray(repeat_no_contact, dtype=np.float64)
    scene = _scene(simulation, capture, background, repeat, data_range_dn, linear)
    exposure = _fitted_exposure(simulation, simulated_no_contact, scene, regions, weights) if fit_exposure else None
    images = {"do_nothing": background, "simulation": simulation * (exposure.k if exposure else 1.0)}
    if repeat is not None:
        images["floor"] = capture + (repeat - background)
    candidates = {name: _candidate(image, scene) for name, image in images.items()}
    results = tuple(_region_error(region, candidates, scene, weights, rng) for region in regions)
    return PhotometricError(results, exposure, linear)


@dataclass(frozen=True, slots=True)
class _Scene:
    """Hold what all candidates are judged against; NaN in the capture carries the common choice of pixels."""

    captured: NDArray[np.float64]
    no_contact: NDArray[np.float64]
    clipped: NDArray[np.bool_]
    data_range_dn: float
    linear: bool


@dataclass(frozen=True, slots=True)
class _Candidate:
    """Hold one candidate image with its similarity map, which is formed once for all regions."""

    image: NDArray[np.float64]
    similarity: StructuralSimilarity


def _scene(
    simulation: NDArray[np.float64],
    captured: NDArray[np.float64],
    no_contact: NDArray[np.float64],
    repeat: NDArray[np.float64] | None,
    data_range_dn: float,
    linear: bool,
) -> _Scene:
    """Return the scene with every pixel taken out that one of the images cannot answer for."""
    measured = [captured, no_contact] if repeat is None else [captured, no_contact, repeat]
    finite = usable_pixels(np.ones(captured.shape[:2], dtype=np.bool_), simulation, *measured)
    clipped = clipped_pixels(data_range_dn, *measured)
    usable = (finite & ~clipped)[..., None]
    return _Scene(np.where(usable, captured, np.nan), no_contact, clipped, data_range_dn, linear)


def _fitted_exposure(
    simulation: NDArray[np.float64],
    simulated_no_contact: NDArray[np.float64] | None,
    scene: _Scene,
    regions: Sequence[Region],
    weights: NDArray[np.float64] | None,
) -> ExposureFactor:
    """Fit one exposure factor over the union of the regions: a press has one exposure, not one for each region."""
    union = np.zeros(scene.clipped.shape, dtype=np.bool_)
    for region in regions:
        union |= usable_pixels(region.mask, scene.captured)
    weight = checked_weights(weights, scene.no_contact, union)
    if simulated_no_contact is None:
        return exposure_factor(simulation, scene.captured, union, weight)
    return exposure_factor(simulated_no_contact, scene.no_contact, union, weight)


def _candidate(image: NDArray[np.float64], scene: _Scene) -> _Candidate:
    """Return a candidate with its similarity to the capture."""
    return _Candidate(image, structural_similarity(image, scene.captured, scene.data_range_dn))


def _region_error(
    region: Region,
    candidates: dict[str, _Candidate],
    scene: _Scene,
    weights: NDArray[np.float64] | None,
    rng: np.random.Generator,
) -> RegionError:
    """Return the rows of one region, all over the same pixels with the same weights."""
    used = usable_pixels(region.mask, scene.captured)
    weight = checked_weights(weights, scene.no_contact, used)
    rows = {name: _row(candidate, scene, used, weight, rng) for name, candidate in candidates.items()}
    return RegionError(
        region=region,
        do_nothing=rows["do_nothing"],
        simulation=rows["simulation"],
        floor=rows.get("floor"),
        channel_weights=weight,
        pixels_used=int(used.sum()),
        clipped_fraction_rel=float(scene.clipped[region.mask].mean()),
    )


def _row(
    candidate: _Candidate,
    scene: _Scene,
    used: NDArray[np.bool_],
    weight: NDArray[np.float64],
    rng: np.random.Generator,
) -> PhotometricRow:
    """Return the metrics of one candidate over the usable pixels of one region."""
    image, captured = candidate.image, scene.captured
    mean_square = float(((image[used] - captured[used]) ** 2).mean())
    return PhotometricRow(
        skill=skill_interval(image, captured, scene.no_contact, used, rng, weight),
        per_channel_skill=skill_score(image, captured, scene.no_contact, used, weight).per_channel_skill,
        relative_rms=relative_rms_interval(image, captured, used, rng) if scene.linear else None,
        ssim_full_frame=candidate.similarity.mean,
        ssim_in_region=candidate.similarity.mean_within(used),
        psnr_db=10 * math.log10(scene.data_range_dn**2 / mean_square) if mean_square > 0 else math.inf,
    )
