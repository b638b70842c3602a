"""The paints that the samplers are compared on: the five-parameter model on eight bands, and the default model."""

import numpy as np

from benchmarks.drawn_paints import nominal_optics
from data_schemas import BandSignals
from finray_calib.fit import PAINT_DISCREPANCY, BandData, EmissionPrior, LogPosterior, band_data
from finray_calib.fit._band_data import band_values
from finray_calib.fit._emission import REFERENCE_ROUNDS
from finray_calib.spectra import (
    WAVELENGTH_NM,
    EmissionFamily,
    FilterSet,
    emission_weights,
    family_named,
    filter_transmission,
    rig_emission_weights,
)
from finray_calib.spectra._band_weights import laser_line

CHANNEL_WEIGHTS = (0.01, 0.09, 0.9)
CALIBRATION_REL, NOISE_REL = 0.01, 0.003
NOISE_FLOOR_REL = 0.003  # of the brightest emission band
ORANGE = {
    "zheng2014": (597.0, np.log(48.0), np.log(0.004), 1.8, np.log(0.1)),
    "log_normal_wavenumber": (597.0, np.log(48.0), np.log(0.004), 0.35, np.log(0.1)),
}
"""An orange paint that reflects a tenth of the laser."""


def five_parameter_posterior(seed: int) -> LogPosterior:
    """Return the paper's family and the reflected laser: eight bands, one channel, filters without leak."""
    optics, grid = nominal_optics(), WAVELENGTH_NM
    floors = np.array([10.0**-f.blocking_od for f in optics.filters])
    passed = np.array([filter_transmission(f, grid) for f in optics.filters]) - floors[:, None]
    white = np.full(grid.shape, optics.white_reference.reflectance)
    response = sum(curve(grid) for curve in optics.camera_response)[None]
    excitation = [f.name for f in optics.filters].index(optics.excitation_filter)
    line = laser_line(optics.laser, grid)
    weights = emission_weights(grid, FilterSet(passed, excitation), response, optics.lamp(grid), white, line, [1.0])
    family = family_named("zheng2014")
    y, sd = _measured(family, weights, np.random.default_rng(seed))
    data = BandData(y[:, None], np.diag(sd**2), np.ones((8, 1), bool), weights, CALIBRATION_REL)
    return LogPosterior(data, family, EmissionPrior())


def paint_signals(seed: int) -> BandSignals:
    """Return the band signals of the orange paint, eight bands of three channels."""
    optics = nominal_optics()
    y, sd = _measured(
        family_named("log_normal_wavenumber"),
        rig_emission_weights(optics, CHANNEL_WEIGHTS),
        np.random.default_rng(seed),
    )
    return BandSignals(
        paint_name="orange",
        optics=optics,
        fluorescence=y.reshape(-1, 3),
        fluorescence_covariance=np.diag(sd**2),
        reflectance=np.full((8, 3), 0.5),
        reflectance_covariance=1e-4 * np.eye(24),
        channel_weights=np.array(CHANNEL_WEIGHTS),
        flags=(("ok", "ok", "ok"),) * 8,
        saturated_fraction=np.zeros((8, 3)),
        region_pixels=10_000,
    )


def default_posterior(seed: int) -> LogPosterior:
    """Return the default model: log-normal in wavenumber, discrepancy, filter tolerances, blocking, 8 x 3 values."""
    data, family, prior = band_data(paint_signals(seed)), family_named("log_normal_wavenumber"), EmissionPrior()
    posterior = LogPosterior(data, family, prior, PAINT_DISCREPANCY)
    best = posterior.climb(np.array([*ORANGE[family.name], 0.0]))
    for _ in range(REFERENCE_ROUNDS):
        posterior, best = posterior.refined(best)
    return posterior


def _measured(family: EmissionFamily, weights, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return band values with calibration error and noise, and the standard deviations of the noise."""
    theta = np.array([ORANGE[family.name]])
    mu = band_values(family.curves(theta, weights.wavelength_nm), np.exp(theta[:, -1]), weights)[0]
    sd = np.hypot(NOISE_REL * mu, NOISE_FLOOR_REL * mu[~weights.is_excitation].max())
    calibration = 1 + CALIBRATION_REL * rng.standard_normal(weights.bands)[weights.band_index]
    return mu * calibration + sd * rng.standard_normal(mu.size), sd
