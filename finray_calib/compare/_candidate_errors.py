"""How far each candidate image is from the captured one: the table of every region, and the error in sensing space.

With the error of the colour alone, red and green as shares of all light, which points at paints and LED. In sensing
space one normal map is applied to every candidate and to the capture. Metrics of other packages stand beside ours.
"""

from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    CompareError,
    ErrorRow,
    Interval,
    MetricRow,
    NormalMapRecord,
    PackagedMetric,
    PlugIn,
    PlugInKind,
    RegionError,
    SensingRow,
    TactileCapture,
    find_plug_in,
    numbers_of,
)
from data_schemas import SensingError as SensingRecord
from finray_calib.compare._comparison import Comparison
from finray_calib.compare._displayed_images import ShownCandidate
from finray_calib.compare._input_draws import InputDraws, ends
from finray_calib.compare._photometric_error import ErrorDraws, RegionResult
from finray_calib.compare._regions import pixels_within, usable_pixels
from finray_calib.sensing import SensingError, full_scale_dn, normal_map_of, require_matching_capture, sensing_error

Floats = NDArray[np.float64]
#: Below ten times its noise the sum is no divisor: shares would be biased by more than 1 %.
LEAST_SUM_TO_NOISE = 10.0


@dataclass(frozen=True, slots=True)
class ChromaticityError:
    """Hold the error of the chromaticity over a region.

    Attributes
    ----------
    rms : float
        Root mean square of the distance in the plane of R / (R + G + B) and G / (R + G + B); a share is 0..1.
    mean_red, mean_green : float
        Mean of simulated - captured share: the systematic part.
    noise_rms : float
        What noise alone would have given; its square was subtracted. 0 if no variance was given.
    pixels_used : int
        Pixels whose sum exceeds ten times its noise in both images.
    """

    rms: float
    mean_red: float
    mean_green: float
    noise_rms: float
    pixels_used: int


def chromaticity_error(
    simulated: Floats,
    captured: Floats,
    mask: NDArray[np.bool_],
    simulated_variance: Floats | None = None,
    captured_variance: Floats | None = None,
) -> ChromaticityError:
    r"""Return the RMS distance of the chromaticities (r, g) = (R, G) / (R + G + B).

    .. math:: e^2 = \langle (r_S - r_D)^2 + (g_S - g_D)^2 \rangle - \langle u_r^2 + u_g^2 \rangle_S
                    - \langle u_r^2 + u_g^2 \rangle_D, \quad
              u_r^2 = [(1 - r)^2 u_R^2 + r^2 (u_G^2 + u_B^2)] / (R + G + B)^2

    The noise is to first order, with channels independent. Valid for linear light with the black level removed; an
    exposure factor does not change it.

    Parameters
    ----------
    simulated, captured : ndarray, shape (H, W, 3)
    mask : ndarray of bool, shape (H, W)
    simulated_variance, captured_variance : ndarray, shape (H, W, 3), optional
        Noise variance of each pixel, in the square of the image's unit. Pixels whose sum is below ten times its noise
        in one image are left out; without a variance those whose sum is not positive.

    Returns
    -------
    ChromaticityError

    Raises
    ------
    CompareError
        If shapes differ or no pixel is usable.
    """
    first, first_noise = _shares(simulated, simulated_variance)
    second, second_noise = _shares(captured, captured_variance)
    difference, noise_square = first - second, first_noise + second_noise
    used = usable_pixels(mask, difference, np.broadcast_to(noise_square[..., None], difference.shape))
    noise = float(noise_square[used].mean())
    square = float((difference[used] ** 2).sum(axis=1).mean())
    red, green = difference[used].mean(axis=0)
    return ChromaticityError(
        float(np.sqrt(max(square - noise, 0.0))), float(red), float(green), float(np.sqrt(noise)), int(used.sum())
    )


def _shares(image: Floats, variance: Floats | None) -> tuple[Floats, Floats]:
    """Return red and green share (H, W, 2), NaN where the sum is too small, and their summed noise variance (H, W)."""
    total = np.asarray(image.sum(axis=2))
    noise_square = np.zeros_like(total) if variance is None else np.asarray(variance.sum(axis=2))
    enough = (total > 0) & (total > LEAST_SUM_TO_NOISE * np.sqrt(noise_square))
    divisor = np.where(enough, total, np.nan)
    share = image[..., :2] / divisor[..., None]
    if variance is None:
        return share, np.zeros_like(total)
    others = noise_square[..., None] - variance[..., :2]
    noise = ((1 - share) ** 2 * variance[..., :2] + share**2 * others).sum(axis=2) / divisor**2
    return share, noise


Bools = NDArray[np.bool_]
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


def error_row(name: str, candidate: ShownCandidate, region: ComparedRegion, image_draws: Floats | None) -> ErrorRow:
    """Return the metrics of one candidate in one region.

    Parameters
    ----------
    name, candidate
        Which one, and its image.
    region
        Where, and against what.
    image_draws : ndarray, shape (draws, P, 3), or None
        The candidate for draws of the inputs at the region's pixels.
    """
    images, centre = region.result.images, (region.best or region.result).images
    skills = images.skill(name, region.channel_weights), centre.skill(name, region.channel_weights)
    channels = np.where(region.told, np.median(centre.channel_skill(name), axis=0), np.nan)
    apart = pixels_within(candidate.image, region.used) - pixels_within(region.captured, region.used)
    mean_square = float((apart**2).mean())
    differences = candidate.colour_difference[region.used]
    ssim = candidate.similarity.mean_within(region.used)
    linear = _of_linear_light(name, candidate, region, image_draws) if region.linear else _WITHHELD
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
    name: str, candidate: ShownCandidate, region: ComparedRegion, image_draws: Floats | None
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
            image_draws,
        ),
    }


def interval(draws: Floats, centre: Floats) -> Interval:
    """Return the 95 % interval of draws with the median of `centre` as estimate."""
    low, high = ends(draws)
    return Interval(estimate=float(np.median(centre)), low95=float(low), high95=float(high))


def skill_interval(draws: Floats, centre: Floats) -> Interval:
    """Return the 95 % interval of a skill, which holds its own estimate.

    With the noise taken out an estimate scatters about its truth, which is at most 1, to both sides: neither it nor its
    interval is cut at 1, or means over presses would be too low.
    """
    found = interval(draws, centre)
    best = found.estimate
    return found.model_copy(update={"low95": min(found.low95, best), "high95": max(found.high95, best)})


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


CHROMATICITY_DRAWS = 100


def region_records(
    comparison: Comparison,
    draws: ErrorDraws,
    candidates: dict[str, ShownCandidate],
    clipped: NDArray[np.bool_],
    capture: TactileCapture,
    conditioned: InputDraws | None,
) -> tuple[RegionError, ...]:
    """Return the table of every region.

    Parameters
    ----------
    comparison, draws
        Both sides, and the draws of every region.
    candidates
        The images by name.
    clipped : ndarray of bool, shape (H, W)
        Where a captured image is at full scale.
    capture
        Tells encoding and full scale.
    conditioned
        Draws of the inputs, for the interval of the simulation's chromaticity; without them it has no width.
    """
    weights = None if conditioned is None else _weight_draws(comparison, conditioned)
    records = []
    for i, (region, used) in enumerate(zip(comparison.regions, comparison.used, strict=True)):
        compared = _compared(comparison, draws, capture, i)
        drawn = {} if weights is None else {"simulation": _image_draws(comparison, weights, used)}
        records.append(
            RegionError(
                region=region.name,
                factor=region.factor,
                pixels=int(used.sum()),
                clipped_fraction=float(clipped[region.mask].mean()),
                rows=tuple(error_row(name, c, compared, drawn.get(name)) for name, c in candidates.items()),
            )
        )
    return tuple(records)


def _compared(comparison: Comparison, draws: ErrorDraws, capture: TactileCapture, i: int) -> ComparedRegion:
    """Return what the rows of region `i` share."""
    captured = comparison.captured
    return ComparedRegion(
        captured=captured.contact,
        captured_variance=captured.variance(captured.contact),
        used=comparison.used[i],
        result=draws.regions[i],
        best=None if draws.whole is None else draws.whole[i],
        channel_weights=comparison.channel_weights,
        data_range_dn=full_scale_dn(capture),
        linear=capture.encoding == "linear",
        is_headline=i == len(comparison.regions) - 1,
        told=comparison.sums[i].told,
    )


def _weight_draws(comparison: Comparison, drawn: InputDraws) -> Floats:
    """Return the weights of the render's layers at the level of the capture, (draws, 3, L), for the first draws."""
    return (comparison.exposure_of(drawn.matrix)[:, None, None] * drawn.weights)[:CHROMATICITY_DRAWS]


def _image_draws(comparison: Comparison, weights: Floats, used: NDArray[np.bool_]) -> Floats:
    """Return the render at the pixels of a region, (draws, P, 3)."""
    poses = () if comparison.inputs is None else comparison.inputs.pose_names
    first, second = comparison.layers.halves("contact", used, poses)
    return np.asarray(np.einsum("dcl,pl->dpc", weights, (first + second) / 2.0))


SENSED_DRAWS = 40
"""Of the inputs: whole images are sensed; the ends of an interval of 40 draws are its second smallest and largest."""


def sensing_record(
    comparison: Comparison,
    normal_map: NormalMapRecord,
    capture: TactileCapture,
    candidates: dict[str, Floats],
    block_px: int,
    conditioned: InputDraws | None,
) -> SensingRecord:
    """Sense every candidate image and the capture with one map, over the headline region.

    Parameters
    ----------
    comparison
        Both sides.
    normal_map
        Of the capture's sensor.
    capture
        Refused where the map was taught by another encoding.
    candidates
        Name -> image (H, W, 3) at the level of the capture.
    block_px
        Side of the blocks that the images are means of.
    conditioned
        Draws of the inputs, for the interval of the simulation; without them an interval has no width.

    Raises
    ------
    CompareError
        The map belongs to another encoding or size.
    """
    require_matching_capture(normal_map, capture)
    senses = normal_map_of(normal_map)
    captured, layers, k = comparison.captured, comparison.layers, comparison.best_exposure
    rest = k * layers.rgb(layers.no_contact)
    mm_per_px = normal_map.mm_per_px * block_px

    def sensed(image: Floats, without: Floats) -> SensingError:
        used = comparison.used[-1]
        return sensing_error(senses, image, without, captured.contact, captured.no_contact, used, mm_per_px)

    found = {name: sensed(i, rest if name == "simulation" else captured.no_contact) for name, i in candidates.items()}
    spread = [] if conditioned is None else [sensed(*pair) for pair in _render_draws(comparison, conditioned)]
    scores = normal_map.held_out_explained_rel
    return SensingRecord(
        normal_map=normal_map.name,
        presses=normal_map.presses,
        held_out_explained_rel=Interval(
            estimate=float(np.median(scores)), low95=float(scores.min()), high95=float(scores.max())
        ),
        outside_share_simulated=found["simulation"].outside_share_simulated,
        outside_share_captured=found["simulation"].outside_share_captured,
        mm_per_px_u_rel=normal_map.mm_per_px_u_rel,
        rows=tuple(_sensing_row(name, error, spread if name == "simulation" else []) for name, error in found.items()),
    )


def _render_draws(comparison: Comparison, drawn: InputDraws) -> list[tuple[Floats, Floats]]:
    """Return the render with and without contact for the first draws."""
    layers, weights = comparison.layers, drawn.weights[:SENSED_DRAWS]
    exposure = comparison.exposure_of(drawn.matrix[:SENSED_DRAWS])
    count = layers.matrix.shape[1]
    poses = [layers.pose_names.index(n) for n in (comparison.inputs.pose_names if comparison.inputs else ())]
    contact = np.concatenate([layers.contact, *(layers.pose[n] for n in poses)], axis=-1)
    return [
        (k * (contact @ w.T), k * (layers.no_contact @ w[:, :count].T)) for k, w in zip(exposure, weights, strict=True)
    ]


def _sensing_row(name: str, error: SensingError, spread: list[SensingError]) -> SensingRow:
    """Return the record of one candidate."""
    fields = ("normal_angle_mean_deg", "normal_angle_p95_deg", "depth_rms_mm")
    return SensingRow.model_validate(
        {"candidate": name, **{f: _sensed_interval(getattr(error, f), [getattr(s, f) for s in spread]) for f in fields}}
    )


def _sensed_interval(best: float, draws: list[float]) -> Interval:
    """Return the interval of some draws; the value itself where there are none."""
    low, high = ends(np.array(draws)) if draws else (best, best)
    return Interval(estimate=float(np.median(draws)) if draws else best, low95=float(low), high95=float(high))


METRICS: Final = PlugInKind(
    "metric", "finray_calib.metrics", ("value(candidate, captured, no_contact, region)", "UNIT", "BETTER", "WORDS"),
    CompareError,
)  # fmt: skip


class Metric(Protocol):
    """What the module of a metric has: how far a candidate image is from the captured one, as one number.

    Attributes
    ----------
    UNIT
        Of the number; "1" for a pure number.
    BETTER
        "higher" or "lower".
    WORDS
        What it is, in a few words without a full stop.
    """

    UNIT: str
    BETTER: Literal["higher", "lower"]
    WORDS: str

    def value(self, candidate: Floats, captured: Floats, no_contact: Floats, region: Bools) -> float:
        """Return the number for one candidate.

        Parameters
        ----------
        candidate
            Contact image (H, W, 3) that stands in for the captured one: the render at the capture's level, the image
            without contact, or a repeat; in DN above black.
        captured, no_contact
            Captured images (H, W, 3), in DN above black.
        region
            Pixels (H, W) of the headline region that are usable.
        """
        ...


def packaged_metric(
    name: str, comparison: Comparison, candidates: dict[str, Floats], conditioned: InputDraws | None
) -> PackagedMetric:
    """Return a metric of another package for every candidate, over the headline region.

    Parameters
    ----------
    name
        The metric's, as its entry point has it.
    comparison
        Both sides.
    candidates
        Name -> image (H, W, 3) at the level of the capture.
    conditioned
        Draws of the inputs, for the interval of the simulation; without them an interval has no width.

    Raises
    ------
    CompareError
        No package or several bring it; its module cannot be imported, lacks something or fails; what it returns is no
        finite number; or it depends on the order in which it is asked.
    """
    plug_in = find_plug_in(METRICS, name)
    metric: Any = plug_in.load()
    _check_words(plug_in, metric)
    found = {which: _metric_value(plug_in, metric, image, comparison) for which, image in candidates.items()}
    if _metric_value(plug_in, metric, candidates["simulation"], comparison) != found["simulation"]:
        raise plug_in.refusal("gives different values for the same images, so that a comparison cannot be repeated")
    renders = [] if conditioned is None else _render_draws(comparison, conditioned)
    spread = [_metric_value(plug_in, metric, image, comparison) for image, _ in renders]
    return PackagedMetric(
        name=name, package=plug_in.source, unit=metric.UNIT, better=metric.BETTER, words=metric.WORDS,
        draws=len(spread),
        rows=tuple(
            MetricRow.model_validate(
                {"candidate": which, "value": _sensed_interval(value, spread if which == "simulation" else [])}
            )
            for which, value in found.items()
        ),
    )  # fmt: skip


def _check_words(plug_in: PlugIn, metric: Any) -> None:
    """Refuse a metric that does not say what its number is."""
    for attribute in ("UNIT", "WORDS"):
        told = getattr(metric, attribute)
        if not isinstance(told, str) or not told.strip():
            raise plug_in.refusal(f"has {attribute} = {told!r}, but the value must be a non-empty text")
    if metric.BETTER not in ("higher", "lower"):
        raise plug_in.refusal(f'has BETTER = {metric.BETTER!r}, but the value must be "higher" or "lower"')


def _metric_value(plug_in: PlugIn, metric: Any, candidate: Floats, comparison: Comparison) -> float:
    """Return the number of one candidate; the metric has copies, so that it can change nothing."""
    captured = comparison.captured
    images = [np.array(image, dtype=np.float64) for image in (candidate, captured.contact, captured.no_contact)]
    given = plug_in.call(lambda: metric.value(*images, comparison.used[-1].copy()))
    return float(numbers_of(plug_in, "value", given, ()))


def check_metric(metric: Metric) -> None:
    """Check that a metric keeps its contract, as a comparison does that uses it: for the tests of its package.

    It says unit, direction and words; its number is finite, the same each time, does not depend on pixels outside the
    region, changes none of the images, and is better for the captured image itself than for doing nothing; on made-up
    images of a round touch, whose values are 100 to 400 DN.

    Parameters
    ----------
    metric
        The module, or an object with its function and attributes.

    Raises
    ------
    CompareError
        It does not; the message says what is wrong.
    """
    plug_in = PlugIn(METRICS, getattr(metric, "__name__", type(metric).__name__), "")
    _check_words(plug_in, metric)
    rows, columns = 48, 64
    row, column = np.mgrid[:rows, :columns]
    distance = np.hypot(row - rows / 2.0, column - columns / 2.0) / (min(rows, columns) / 6.0)
    noise = np.random.default_rng(0).normal(0.0, 1.0, (rows, columns, 3))
    rest = 200.0 + noise + row[..., None]
    touched = rest + 100.0 * np.exp(-(distance**2))[..., None] * np.array([1.0, -0.5, 0.2])
    region = distance <= 2.0

    def value(candidate: Floats) -> float:
        images = candidate.copy(), touched.copy(), rest.copy()
        given = plug_in.call(lambda: metric.value(images[0], images[1], images[2], region.copy()))
        if any((a != b).any() for a, b in zip(images, (candidate, touched, rest), strict=True)):
            raise plug_in.refusal("changes the images that it is given")
        return float(numbers_of(plug_in, "value", given, ()))

    perfect, nothing = value(touched), value(rest)
    beside = np.where(region[..., None], touched, 0.5 * touched)
    if value(touched) != perfect:
        raise plug_in.refusal("gives different values for the same images")
    if value(beside) != perfect:
        raise plug_in.refusal("depends on pixels outside the region")
    if not (perfect > nothing if metric.BETTER == "higher" else perfect < nothing):
        raise plug_in.refusal(
            f"is {perfect:.4g} for the captured image itself and {nothing:.4g} for the image without contact, but "
            f"declares that {metric.BETTER} is better"
        )
