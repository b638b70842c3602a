r"""What the compiled fit of all pixels of a region shares: weights of their bands, prior and bounds.

A raw pixel sees each filter through one Bayer channel only. Its bands are those of the family's curve times the
factor by which the region's own signal exceeds the region's family curve,

.. math:: y_b = k_{bc} \int w_{bc}(\lambda) f(\lambda; \theta)\,d\lambda + k_{bc}\,\rho\,l_{bc} + e_b, \quad
   k_{bc} = y^{region}_{bc} / \mu_{bc}(\theta^{region})

so that calibration errors and the paint's departure from the family, common to all pixels, feign no pattern.
"""

import numpy as np
from numpy.typing import NDArray

from finray_calib.fit.pixel_curves import SHAPES
from finray_calib.fit.pixel_normal import NODES, PixelProblem
from finray_calib.fit.region_fit import PixelSpread, RegionFit
from finray_calib.spectra.band_quadrature import GRID_STEP_NM, BandQuadrature, band_quadrature, gauss_nodes
from finray_calib.spectra.band_weights import EmissionWeights
from finray_calib.spectra.curve_quantities import YIELD_END_NM
from finray_calib.spectra.emission_families import tables

Floats = NDArray[np.float64]

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
