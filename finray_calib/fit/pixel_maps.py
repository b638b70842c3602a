"""Emission of a paint in every pixel, as a departure from the fit of the whole region.

As the bands of :mod:`finray_calib.fit.pixel_problem` are scaled to the region's own signal, so the family's quantities
are carried to the region's reported ones.
"""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from data_schemas.errors import FitError
from data_schemas.fit import PaintCalibration
from data_schemas.paint_map import MappedQuantity, PaintMap, PaintSpread
from data_schemas.radiometry import PixelSignals
from finray_calib.fit.paint_uniformity import paint_blocks, paint_spread, worst_spots
from finray_calib.fit.pixel_curves import SHAPES
from finray_calib.fit.pixel_kernel import CONVERGED, FEWEST_BANDS, NOT_CONVERGED, RESULTS, fit_pixels
from finray_calib.fit.pixel_normal import PixelProblem
from finray_calib.fit.pixel_problem import pixel_problem
from finray_calib.fit.region_fit import PixelSpread, RegionFit, region_fit
from finray_calib.spectra.rig_curves import weights_of

Floats32 = NDArray[np.float32]
_Scalar = TypeVar("_Scalar", bound=np.generic)


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
    return {name: _frozen(results[i]) for name, i in zip((*names, *sds, "chi_square"), (*range(12), -1), strict=True)}


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
