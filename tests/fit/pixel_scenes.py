"""Simulated pixels of a paint whose truth is known in each, through whole curves on the 1 nm grid."""

from dataclasses import dataclass

import numpy as np

from data_schemas import Estimate, PixelSignals, RegionOfInterest
from finray_calib.fit import PixelSpread
from finray_calib.fit._band_data import band_values
from finray_calib.fit._pixel_maps import RegionFit
from finray_calib.spectra import family_named, rig_emission_weights

CHANNEL_WEIGHTS = (0.25, 0.5, 0.25)
OWN = {"zheng2014": 0.9, "log_normal_wavenumber": 0.25}
SPREAD = PixelSpread()


def center_of(name):
    """An orange paint: mode 597 nm, FWHM 48 nm, a tenth of the laser reflected."""
    return np.array([597.0, np.log(48.0), np.log(0.004), OWN[name], 0.1])


def estimate(value):
    return Estimate(estimate=value, sd=0.0, low68=value, high68=value, low95=value, high95=value)


@dataclass(frozen=True)
class PixelScene:
    """Pixels with their truth (N, 5) in the order of the rows of the image."""

    family: str
    optics: object
    truth: np.ndarray
    pixels: PixelSignals
    region: RegionFit

    def predicted(self, theta, channel):
        """Bands of parameter rows through one channel each, from whole curves."""
        return bands_of(self.family, self.optics, theta)[np.arange(len(theta)), :, channel]


def bands_of(name, optics, theta):
    weights = rig_emission_weights(optics, CHANNEL_WEIGHTS)
    family = family_named(name)
    parts = [
        band_values(family.curves(t[:, :4], weights.wavelength_nm), t[:, 4], weights)
        for t in np.array_split(theta, -(-len(theta) // 2000))
    ]
    return np.concatenate(parts).reshape(len(theta), -1, 3)


def scene(name, optics, truth, rng, noise_rel=0.01, floor=2e-4, rows=32):
    """Return pixels of the truths (N, 5), Bayer RGGB, N a multiple of `rows`; rows and columns even."""
    center, family = center_of(name), family_named(name)
    columns = len(truth) // rows
    channel = np.tile(np.array([[0, 1], [1, 2]], np.uint8), (rows // 2, columns // 2))
    clean = bands_of(name, optics, truth)[np.arange(len(truth)), :, channel.ravel()]
    sd = np.hypot(noise_rel * clean, floor)
    noisy = clean + sd * rng.standard_normal(clean.shape)
    image = (values.T.reshape(-1, rows, columns).astype(np.float32) for values in (noisy, sd))
    signals, sds = image
    ones = np.ones((rows, columns), np.float32)
    pixels = PixelSignals(
        paint_name="orange",
        optics=optics,
        area=RegionOfInterest(row_px=100, column_px=200, height_px=rows, width_px=columns),
        fluorescence=signals,
        fluorescence_sd=sds,
        channel=channel,
        usable=np.ones((rows, columns), bool),
        profile=ones,
        profile_sd_rel=0.001 * ones,
        common_sd_rel=np.full((len(clean[0]), 3), 0.01),
        channel_weights=np.array(CHANNEL_WEIGHTS),
    )
    grid = np.arange(450.0, 780.5, 0.5)
    quantities = {
        "mode_nm": center[0],
        "fwhm_nm": np.exp(center[1]),
        "peak_per_nm": np.exp(center[2]),
        "energy_yield": np.trapezoid(family.curves(center[None, :4], grid)[0], grid),
        "reflectance_at_laser": center[4],
    }
    region = RegionFit(
        family=family,
        theta=center,
        theta_sd=np.zeros(4),
        leak=np.ones(8),
        signal=bands_of(name, optics, center[None])[0],
        quantities={key: estimate(float(value)) for key, value in quantities.items()},
    )
    return PixelScene(name, optics, truth, pixels, region)


def whole_rule(problem):
    """Wavelengths and weights (3, B, L) of the map's band rule as one product, for a fitter of numpy arrays."""
    nodes = np.concatenate([problem.nodes_nm, problem.grid_nm])
    _, bands, count = problem.in_band.shape
    weights = np.zeros((3, bands, nodes.size))
    for b in range(bands):
        weights[:, b, b * count : (b + 1) * count] = problem.in_band[:, b]
    weights[:, :, bands * count :] = problem.out_of_band[:, :bands]
    return nodes, weights


def drawn_truths(name, count, rng):
    """Truths from the pixels' prior: only then must the intervals of the posterior cover as stated."""
    center, sd = center_of(name), SPREAD.of(family_named(name))
    return center + np.c_[sd * rng.standard_normal((count, 4)), 0.1 * rng.standard_normal(count)]
