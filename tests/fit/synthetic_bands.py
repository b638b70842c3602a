"""Band values of known paints on the closed-form rig, by the full sum over wavelengths."""

from dataclasses import replace
from functools import cache

import numpy as np

from finray_calib.fit import NO_DISCREPANCY, BandData, FitSettings, SamplerSettings
from finray_calib.fit._band_data import band_values
from finray_calib.fit._prior import EDGE_OFFSET_FWHM, EDGE_WIDTH_FWHM
from finray_calib.spectra import FAMILIES

LOG_NORMAL = FAMILIES["log_normal_wavenumber"]
ZHENG = FAMILIES["zheng2014"]

CALIBRATION_REL = 0.01
NOISE_REL = 0.003
FLOOR = 2e-4

OWN_PARAMETERS = {
    "zheng2014": [np.arcsinh(3.0)],
    "skew_t": [1.5, np.log(4.0)],
    "log_normal_wavenumber": [0.35],
    "gaussian_mixture": [35.0, 0.3, -1.0],
}
QUICK = FitSettings(importance_draws=4000, kept_draws=1000, chain=SamplerSettings(walkers=32, most_steps=900))


def orange(family_name="log_normal_wavenumber"):
    """Return the parameters of an orange paint: mode 597 nm, FWHM 48 nm, a tenth of the laser reflected."""
    return np.array([597.0, np.log(48.0), np.log(0.004), *OWN_PARAMETERS[family_name], np.log(0.1), 0.2])


def full_sum(family, theta, weights):
    """Return the (n, N) band values of parameter rows on the whole wavelength grid."""
    theta = np.atleast_2d(theta)
    curves = family.curves(theta, weights.wavelength_nm)
    shapes = len(family.parameter_names)
    return band_values(curves, np.exp(theta[:, shapes]), weights, np.exp(theta[:, -1]))


@cache
def process_root(discrepancy, wavelength_nm):
    """Return a factor of the smooth part's covariance on a grid."""
    grid = np.array(wavelength_nm)
    roots, directions = np.linalg.eigh(discrepancy.smooth_kernel(grid, grid))
    return directions * np.sqrt(np.maximum(roots, 0.0))


def drawn_curve(family, theta, discrepancy, wavelength_nm, rng):
    """Return one emission curve (L,) that leaves its family as the discrepancy says, written from its definition."""
    curve = family.curves(theta[None], wavelength_nm)[0]
    width = np.exp(theta[1])
    edge = 1 / (1 + np.exp((wavelength_nm - theta[0] + EDGE_OFFSET_FWHM * width) / (EDGE_WIDTH_FWHM * width)))
    root = process_root(discrepancy, tuple(wavelength_nm))
    relative = root @ rng.standard_normal(len(root)) + discrepancy.reabsorption_rel * rng.standard_normal() * edge
    return curve + (curve + discrepancy.floor_rel * np.exp(theta[2])) * relative


def simulate(theta, weights, rng, *, family=LOG_NORMAL, discrepancy=NO_DISCREPANCY, usable=None):
    """Return band data with 0.3 % noise, a small floor and 1 % band calibration, and the true emission curve."""
    if discrepancy.acts:
        curve = drawn_curve(family, theta, discrepancy, weights.wavelength_nm, rng)
    else:
        curve = family.curves(theta[None], weights.wavelength_nm)[0]
    reflected = np.exp(theta[len(family.parameter_names)])
    mu = band_values(curve[None], np.array([reflected]), weights, np.exp(theta[-1]))[0]
    sd = np.hypot(NOISE_REL * mu, FLOOR)
    calibration = 1 + CALIBRATION_REL * rng.standard_normal(weights.bands)
    y = mu * calibration[weights.band_index] + sd * rng.standard_normal(mu.size)
    shape = (weights.bands, mu.size // weights.bands)
    usable = np.ones(shape, bool) if usable is None else usable
    return BandData(y.reshape(shape), np.diag(sd**2), usable, weights, CALIBRATION_REL), curve


def without_band(data, band):
    """Return the data with one band left out."""
    usable = data.usable.copy()
    usable[band] = False
    return replace(data, usable=usable)
