r"""Emission of a paint in every pixel, as a departure from the fit of the whole region, and how uniform the paint is.

A raw pixel sees each filter through one Bayer channel only. Its bands are those of the family's curve times the
factor by which the region's own signal exceeds the region's family curve,

.. math:: y_b = k_{bc} \int w_{bc}(\lambda) f(\lambda; \theta)\,d\lambda + k_{bc}\,\rho\,l_{bc} + e_b, \quad
   k_{bc} = y^{region}_{bc} / \mu_{bc}(\theta^{region})

so that calibration errors and the paint's departure from the family, common to all pixels, feign no pattern. As the
bands are scaled to the region's own signal, so the family's quantities are carried to the region's reported ones.

Uniformity is the spread between pixels without their noise, a coarse map of blocks, and the worst spots.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from data_schemas import (
    Estimate,
    FitError,
    MappedQuantity,
    PaintCalibration,
    PaintMap,
    PaintSpot,
    PaintSpread,
    PixelSignals,
    RegionOfInterest,
    read_only,
)
from finray_calib.fit._prior import BLOCKING, OWN_LEAK, REFLECTED_LASER
from finray_calib.fit.pixel_kernel import (
    CONVERGED,
    FEWEST_BANDS,
    NODES,
    NOT_CONVERGED,
    RESULTS,
    PixelProblem,
    fit_pixels,
)
from finray_calib.spectra import (
    FAMILIES,
    GRID_STEP_NM,
    LN_10,
    YIELD_END_NM,
    BandQuadrature,
    EmissionFamily,
    EmissionWeights,
    band_quadrature,
    family_named,
    gauss_nodes,
    rig_emission_weights,
    skew_shape_table,
)
from finray_calib.spectra.family_kernels import SHAPES

Floats = NDArray[np.float64]

LEAST_SIGNAL_SD: Final = 3.0
"""A filter and channel whose region signal is weaker than this holds nothing that its factor could be taken from."""
_QUANTITIES = ("mode_nm", "fwhm_nm", "peak_per_nm")


@dataclass(frozen=True, slots=True)
class PixelSpread:
    """How far a pixel may lie from the region's fit, before it is looked at: one paint from one tin.

    Attributes
    ----------
    mode_sd_nm, ln_fwhm_sd
        Thick layers re-absorb their blue edge, which moves the mode by a few nm and the width by some per cent.
    ln_peak_sd
        Height follows the thickness: bare spots to double layers.
    own_factor
        Of the family's own parameter, times the sd of its prior for an unknown paint.

    Raises
    ------
    FitError
        When one is not positive.
    """

    mode_sd_nm: float = 5.0
    ln_fwhm_sd: float = 0.1
    ln_peak_sd: float = 1.0
    own_factor: float = 0.25

    def __post_init__(self) -> None:
        if not min(self.mode_sd_nm, self.ln_fwhm_sd, self.ln_peak_sd, self.own_factor) > 0:
            raise FitError(f"pixel spread: every width must be positive, got {self}")

    def of(self, family: EmissionFamily) -> Floats:
        """Return the standard deviations of a family's four parameters, (4,)."""
        return np.array([self.mode_sd_nm, self.ln_fwhm_sd, self.ln_peak_sd, self.own_factor * family.own[0].sd])


@dataclass(frozen=True, slots=True)
class RegionFit:
    """What the fit of the region tells its pixels.

    Attributes
    ----------
    family
        Family of four parameters.
    theta
        (5,) mode, ln FWHM, ln peak and own parameter at the posterior's maximum, and the reflectance at the laser.
    theta_sd
        (4,) posterior standard deviations of the shape.
    leak
        (B,) multiplier of each filter's nominal leak.
    signal
        (B, 3) band signals of the region, NaN where they give no factor.
    quantities
        Region's mode_nm, fwhm_nm, peak_per_nm, energy_yield and reflectance_at_laser.
    """

    family: EmissionFamily
    theta: Floats
    theta_sd: Floats
    leak: Floats
    signal: Floats
    quantities: dict[str, Estimate]


def region_fit(paint: PaintCalibration) -> RegionFit:
    """Return what a paint calibration tells the pixels of its region.

    Raises
    ------
    FitError
        The family has more than four parameters.
    """
    family = family_named(paint.family)
    if len(family.parameter_names) != SHAPES:
        small = " or ".join(name for name, f in FAMILIES.items() if len(f.parameter_names) == SHAPES)
        raise FitError(
            f"paint map: family {family.name} has {len(family.parameter_names)} parameters, but the bands of one pixel "
            f"determine only {SHAPES}; choose {small} ('finray fit --family') and map with that fit"
        )
    best, sds = paint.map_estimate, dict(zip(paint.sampled, paint.draws.std(axis=0), strict=True))
    shape = [best[name] for name in family.parameter_names]
    firm = paint.usable & (paint.measured > LEAST_SIGNAL_SD * paint.measured_sd)
    quantities = {name: paint.parameters[name] for name in (*_QUANTITIES, "reflectance_at_laser")}
    return RegionFit(
        family=family,
        theta=np.array([*shape, np.exp(best[REFLECTED_LASER])]),
        theta_sd=np.array([sds[name] for name in family.parameter_names]),
        leak=np.exp(best.get(BLOCKING, 0.0) + _own_ln_leak(paint)),
        signal=np.where(firm, paint.measured, np.nan),
        quantities={**quantities, "energy_yield": paint.energy_yield},
    )


def _own_ln_leak(paint: PaintCalibration) -> Floats:
    """Return ln(leak of each filter over the common one), (B,): as fitted where it was sampled, else of its mean."""
    sd = np.array([LN_10 * f.blocking_uncertainty_od for f in paint.optics.filters])
    z = [paint.map_estimate.get(OWN_LEAK.format(f.name)) for f in paint.optics.filters]
    return np.array([s * s / 2 if own is None else s * own for s, own in zip(sd, z, strict=True)])


Floats32 = NDArray[np.float32]


def map_paint(pixels: PixelSignals, paint: PaintCalibration, spread: PixelSpread | None = None) -> PaintMap:
    """Fit every pixel of a session whose region was fitted, and report how uniform the paint is.

    Parameters
    ----------
    pixels
        Signals of each pixel.
    paint
        Fit of the region of the same session.
    spread
        Prior of a pixel; the default is documented in its class.

    Raises
    ------
    FitError
        Pixels and fit are not of one session, the family has more than four parameters, or no pixel is usable.
    """
    _require_one_session(pixels, paint)
    return map_pixels(pixels, region_fit(paint), spread or PixelSpread())


def map_pixels(pixels: PixelSignals, region: RegionFit, spread: PixelSpread) -> PaintMap:
    """Fit every pixel and report how uniform the paint is.

    The maximum of each pixel's posterior by Gauss-Newton steps that start at the region's fit, and the inverse of
    the normal matrix there as covariance. The prior of a pixel is normal around the region's fit, so that noisy
    pixels shrink to it. Valid for pixels of the region's paint: on bare ground look at chi-square.

    Raises
    ------
    FitError
        No pixel is usable.
    """
    problem, factor = pixel_problem(region, rig_emission_weights(pixels.optics, pixels.channel_weights), spread)
    results, status, bands = _fit(problem, pixels)
    fitted = int((status > 0).sum())
    if fitted == 0:
        raise FitError(
            f"paint map: none of {status.size} pixels has {FEWEST_BANDS} usable bands; check in the masks and notes "
            "of the pixel signals that the laser reaches the painted region and that no exposure is missing"
        )
    maps = _named_maps(results, region, problem)
    prior_sd = [float(sd) for sd in 1 / np.sqrt(problem.precision)]
    blocks = paint_blocks(maps)
    return PaintMap(
        paint_name=pixels.paint_name,
        family=region.family.name,
        area=pixels.area,
        **maps,
        shape_name=region.family.own[0].name,
        bands_used=read_only(bands),
        converged=read_only(status == CONVERGED),
        region=region.quantities,
        prior_sd=dict(zip((*region.family.parameter_names, "reflectance_at_laser"), prior_sd, strict=True)),
        prior_in_words="normal distribution around the fit of the region, towards which noisy pixels are shrunk",
        band_factor=factor,
        fitted_pixels=fitted,
        unusable_pixels=int(status.size) - fitted,
        unconverged_pixels=int((status == NOT_CONVERGED).sum()),
        uniformity=_uniformity(maps, results, region, prior_sd),
        block_px=blocks.side_px,
        block_mode_nm=blocks.mode_nm,
        block_mode_sd_nm=blocks.mode_sd_nm,
        block_energy_yield=blocks.energy_yield,
        block_energy_yield_sd=blocks.energy_yield_sd,
        worst_spots=worst_spots(blocks, pixels.area),
    )


def _fit(problem: PixelProblem, pixels: PixelSignals) -> tuple[Floats32, NDArray[np.uint8], NDArray[np.uint8]]:
    """Return results (RESULTS, R, C), status and number of bands (R, C) of all pixels."""
    shape = pixels.channel.shape
    results = np.empty((RESULTS, *shape), np.float32)
    status, bands = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
    fit_pixels(
        problem,
        np.ascontiguousarray(pixels.fluorescence),
        np.ascontiguousarray(pixels.fluorescence_sd),
        pixels.channel,
        pixels.usable,
        results,
        status,
        bands,
    )
    return results, status, bands


def _named_maps(results: Floats32, region: RegionFit, problem: PixelProblem) -> dict[str, Any]:
    """Return the maps by name, carried from the family's quantities to the region's."""
    mode, ln_width, ln_peak = region.theta[:3]
    area = region.family.curves(region.theta[None, :SHAPES], problem.grid_nm)[0] @ problem.out_of_band[0, -1]
    reported = {name: value.estimate for name, value in region.quantities.items()}
    results[0] += np.float32(reported["mode_nm"] - mode)
    scales = {
        1: reported["fwhm_nm"] / np.exp(ln_width),
        2: reported["peak_per_nm"] / np.exp(ln_peak),
        5: reported["energy_yield"] / area,
    }
    for row, scale in scales.items():
        results[[row, row + 6, row + 12]] *= np.float32(scale)
    names = ("mode_nm", "fwhm_nm", "peak_per_nm", "shape_value", "reflectance_at_laser", "energy_yield")
    sds = ("mode_sd_nm", "fwhm_sd_nm", "peak_sd_per_nm", "shape_sd", "reflectance_at_laser_sd", "energy_yield_sd")
    return {name: read_only(results[i]) for name, i in zip((*names, *sds, "chi_square"), (*range(12), -1), strict=True)}


def _uniformity(
    maps: dict[str, Any], results: Floats32, region: RegionFit, prior_sd: list[float]
) -> dict[MappedQuantity, PaintSpread]:
    """Return the spreads between pixels, with the noise of the results and the pixels' prior taken out."""
    yield_sd = float(np.hypot(prior_sd[1], prior_sd[2]))
    around: dict[MappedQuantity, float] = {"mode_nm": prior_sd[0], "peak_per_nm": prior_sd[2], "energy_yield": yield_sd}
    return {
        quantity: paint_spread(quantity, maps, noise, region.quantities[quantity].estimate, sd)
        for (quantity, sd), noise in zip(around.items(), results[[12, 14, 17]], strict=True)
    }


def _require_one_session(pixels: PixelSignals, paint: PaintCalibration) -> None:
    """Refuse pixels and a fit that do not belong together."""
    if pixels.paint_name != paint.paint_name:
        raise FitError(
            f"paint map: the pixels are of paint '{pixels.paint_name}', but the fit is of paint '{paint.paint_name}'; "
            "give the fit of the same session"
        )
    if pixels.optics.model_dump_json() != paint.optics.model_dump_json():
        raise FitError(
            f"paint map: the filters, lights or camera curves of the pixels ({len(pixels.optics.filters)} filters) "
            f"differ from those of the fit ({len(paint.optics.filters)} filters); fit the region of the same session "
            "and map with that fit"
        )


_SMALLEST_REFLECTANCE_SD = 0.1
_YIELD_SAMPLES = 4001
_LONGEST_STEP = (30.0, 0.5, 1.0, 1.0, np.inf)
_NO_TAIL_COLUMN = 7  # of the shape table: ln of the degrees of freedom 0, the skew-Cauchy curve


def pixel_problem(region: RegionFit, weights: EmissionWeights, spread: PixelSpread) -> tuple[PixelProblem, Floats]:
    """Return the arrays of the compiled fit, and the factor of each filter and channel, (B, 3), NaN where unused."""
    bands, theta, family = weights.bands, region.theta, region.family
    rule, more = band_quadrature(weights), (region.leak - 1)[weights.band_index]
    nodes_nm, in_band = coarser_rule(rule, weights.band_index)
    at_nodes = family.curves(theta[None, :SHAPES], nodes_nm.ravel())[0].reshape(bands, NODES)
    lit = rule.grid_nm > weights.laser_nm - GRID_STEP_NM
    grid_nm, out_of_band = rule.grid_nm[lit], (rule.out_of_band + more[:, None] * rule.leaked)[:, lit]
    emitted = (in_band * at_nodes[weights.band_index]).sum(axis=1)
    emitted += out_of_band @ family.curves(theta[None, :SHAPES], grid_nm)[0]
    laser = weights.reflected_laser + more * weights.leaked_laser
    divisor = weights.divisor(more)
    factor = region.signal.ravel() * divisor / (emitted + theta[4] * laser)
    scale = np.nan_to_num(factor) / divisor
    prior_sd = np.append(np.hypot(spread.of(family), region.theta_sd), max(_SMALLEST_REFLECTANCE_SD, theta[4]))
    own, yield_nm = family.own[0], _yield_weights(grid_nm, weights.laser_nm)

    def by_channel(rows: Floats) -> Floats:
        return np.ascontiguousarray(np.moveaxis(rows.reshape(bands, 3, *rows.shape[1:]), 1, 0))

    problem = PixelProblem(
        family=family.code,
        table=np.ascontiguousarray(skew_shape_table()[:, :, _NO_TAIL_COLUMN]),
        nodes_nm=nodes_nm.ravel(),
        in_band=by_channel(in_band * scale[:, None]),
        grid_nm=grid_nm,
        out_of_band=np.concatenate([by_channel(out_of_band * scale[:, None]), np.tile(yield_nm, (3, 1, 1))], axis=1),
        laser=by_channel(laser * scale),
        used=np.ascontiguousarray(np.isfinite(region.signal).T),
        excitation=int(weights.band_index[np.argmax(weights.is_excitation)]),
        mean=theta,
        precision=prior_sd**-2,
        longest_step=np.array(_LONGEST_STEP),
        low=own.low,
        high=own.high,
    )
    return problem, factor.reshape(bands, 3)


def coarser_rule(rule: BandQuadrature, band_index: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Return nodes (B, NODES) and weights (N, NODES): the Gauss rule of each band's rule, fewer nodes for a pixel."""
    nodes_nm, weight = np.tile(rule.nodes_nm[:, :1], NODES), np.zeros((len(rule.in_band), NODES))
    for band, fine_nm in enumerate(rule.nodes_nm):
        rows = np.flatnonzero(band_index == band)
        measure = rule.in_band[rows].sum(axis=0)
        if measure.max() > 0:
            nodes_nm[band] = gauss_nodes(fine_nm, measure, NODES)
            x, fine = ((at - fine_nm.mean()) / np.ptp(fine_nm) for at in (nodes_nm[band], fine_nm))
            moments = rule.in_band[rows] @ np.vander(fine, NODES)
            weight[rows] = np.linalg.solve(np.vander(x, NODES).T, moments.T).T
    return nodes_nm, weight


def _yield_weights(grid_nm: Floats, laser_nm: float) -> Floats:
    """Return weights in nm that integrate a curve given on an even grid, linear between, from the laser to 780 nm."""
    fine_nm, step_nm = np.linspace(laser_nm, YIELD_END_NM, _YIELD_SAMPLES, retstep=True)
    hats = np.maximum(0.0, 1 - np.abs(fine_nm - grid_nm[:, None]) / GRID_STEP_NM)
    return np.asarray(np.trapezoid(hats, dx=step_nm))


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
