r"""Emission of a paint in every pixel, as a departure from the fit of the whole region.

A raw pixel sees each filter through one Bayer channel only. Its bands are those of the family's curve times the
factor by which the region's own signal exceeds the region's family curve,

.. math:: y_b = k_{bc} \int w_{bc}(\lambda) f(\lambda; \theta)\,d\lambda + k_{bc}\,\rho\,l_{bc} + e_b, \quad
   k_{bc} = y^{region}_{bc} / \mu_{bc}(\theta^{region})

so that calibration errors and the paint's departure from the family, common to all pixels, feign no pattern. The
same scaling carries the family's quantities to the region's reported ones.
"""

from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from data_schemas.estimate import Estimate
from data_schemas.fit import PaintCalibration
from data_schemas.paint_map import MappedQuantity, PaintMap
from data_schemas.radiometry import PixelSignals
from finray_calib.fit.paint_uniformity import paint_blocks, paint_spread, worst_spots
from finray_calib.fit.pixel_curves import SHAPES
from finray_calib.fit.pixel_kernel import CONVERGED, FEWEST_BANDS, NOT_CONVERGED, RESULTS, fit_pixels
from finray_calib.fit.pixel_normal import NODES, PixelProblem
from finray_calib.fit.prior import BLOCKING, OWN_LEAK, REFLECTED_LASER
from finray_calib.spectra.band_quadrature import GRID_STEP_NM, BandQuadrature, band_quadrature, gauss_nodes
from finray_calib.spectra.band_tolerances import LN_10
from finray_calib.spectra.band_weights import EmissionWeights
from finray_calib.spectra.curve_quantities import YIELD_END_NM
from finray_calib.spectra.emission_families import FAMILIES, EmissionFamily, family_named, tables
from finray_calib.spectra.rig_curves import weights_of

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
_Scalar = TypeVar("_Scalar", bound=np.generic)

LEAST_SIGNAL_SD: Final = 3.0
"""A filter and channel whose region signal is weaker than this holds nothing that its factor could be taken from."""
_SMALLEST_REFLECTANCE_SD = 0.1
_YIELD_SAMPLES = 4001
_LONGEST_STEP = (30.0, 0.5, 1.0, 1.0, np.inf)
_QUANTITIES = ("mode_nm", "fwhm_nm", "peak_per_nm")
_NO_TAIL_COLUMN = 7  # of the shape table: ln of the degrees of freedom 0, the skew-Cauchy curve


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
            f"carry {SHAPES}; choose {small} ('finray fit --family') and map with that fit"
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


def map_paint(pixels: PixelSignals, paint: PaintCalibration, spread: PixelSpread | None = None) -> PaintMap:
    """Fit every pixel of a session whose region was fitted, and tell how uniform the paint is.

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
    """Fit every pixel and tell how uniform the paint is.

    The maximum of each pixel's posterior by Gauss-Newton steps that start at the region's fit, and the inverse of
    the normal matrix there as covariance. The prior of a pixel is normal around the region's fit, so that noisy
    pixels shrink to it. Valid for pixels of the region's paint: on bare ground look at chi-square.

    Raises
    ------
    FitError
        No pixel is usable.
    """
    problem, factor = pixel_problem(region, weights_of(pixels.optics, pixels.channel_weights), spread)
    results, status, bands = _fit(problem, pixels)
    fitted = int((status > 0).sum())
    if fitted == 0:
        raise FitError(
            f"paint map: no pixel of {status.size} has {FEWEST_BANDS} usable bands; look at the masks and notes of the "
            "pixel signals: the laser must reach the painted region and exposures must not be lost"
        )
    maps = _named_maps(results, region, problem)
    prior_sd = [float(sd) for sd in 1 / np.sqrt(problem.precision)]
    yield_sd = float(np.hypot(prior_sd[1], prior_sd[2]))
    around: dict[MappedQuantity, float] = {"mode_nm": prior_sd[0], "peak_per_nm": prior_sd[2], "energy_yield": yield_sd}
    center = {name: region.quantities[name].estimate for name in around}
    noise = dict(zip(("mode_nm", "peak_per_nm", "energy_yield"), results[[12, 14, 17]], strict=True))
    blocks = paint_blocks(maps)
    return PaintMap(
        paint_name=pixels.paint_name,
        family=region.family.name,
        area=pixels.area,
        **maps,
        shape_name=region.family.own[0].name,
        bands_used=_frozen(bands),
        converged=_frozen(status == CONVERGED),
        region=region.quantities,
        prior_sd=dict(zip((*region.family.parameter_names, "reflectance_at_laser"), prior_sd, strict=True)),
        prior_in_words="normal around the region's fit: noisy pixels shrink to it",
        band_factor=factor,
        fitted_pixels=fitted,
        unusable_pixels=int(status.size) - fitted,
        unconverged_pixels=int((status == NOT_CONVERGED).sum()),
        uniformity={q: paint_spread(q, maps, noise[q], center[q], sd) for q, sd in around.items()},
        block_px=blocks.side_px,
        block_mode_nm=blocks.mode_nm,
        block_mode_sd_nm=blocks.mode_sd_nm,
        block_energy_yield=blocks.energy_yield,
        block_energy_yield_sd=blocks.energy_yield_sd,
        worst_spots=worst_spots(blocks, pixels.area),
    )


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
    white = 1 + more * weights.leaked_white
    factor = region.signal.ravel() * white / (emitted + theta[4] * laser)
    scale = np.nan_to_num(factor) / white
    prior_sd = np.append(np.hypot(spread.of(family), region.theta_sd), max(_SMALLEST_REFLECTANCE_SD, theta[4]))
    own, yield_nm = family.own[0], _yield_weights(grid_nm, weights.laser_nm)

    def by_channel(rows: Floats) -> Floats:
        return np.ascontiguousarray(np.moveaxis(rows.reshape(bands, 3, *rows.shape[1:]), 1, 0))

    problem = PixelProblem(
        family=family.code,
        table=np.ascontiguousarray(tables()[:, :, _NO_TAIL_COLUMN]),
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
    return {name: _frozen(results[i]) for name, i in zip((*names, *sds, "chi_square"), (*range(12), -1), strict=True)}


def _frozen(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return the array read-only, so that the record takes it without a copy."""
    array.flags.writeable = False
    return array


def _require_one_session(pixels: PixelSignals, paint: PaintCalibration) -> None:
    """Refuse pixels and a fit that do not belong together."""
    if pixels.paint_name != paint.paint_name:
        raise FitError(
            f"paint map: the pixels are of '{pixels.paint_name}', the fit is of '{paint.paint_name}'; give the fit of "
            "the same session"
        )
    if pixels.optics.model_dump_json() != paint.optics.model_dump_json():
        raise FitError(
            f"paint map: filters, lights or camera curves of the pixels ({len(pixels.optics.filters)} filters) are not "
            f"those of the fit ({len(paint.optics.filters)} filters); fit the region of the same session and map with "
            "that fit"
        )
