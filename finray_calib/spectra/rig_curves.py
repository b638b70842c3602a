"""The known curves of a rig on one wavelength grid."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas.radiometry import Optics
from data_schemas.rig import BandPassFilter, LaserSettings
from finray_calib.spectra.band_weights import EmissionWeights, emission_weights

Floats = NDArray[np.float64]
WAVELENGTH_NM: Floats = np.arange(380.0, 781.0, 1.0)
WAVELENGTH_NM.flags.writeable = False


def filter_transmission(band: BandPassFilter, wavelength_nm: ArrayLike) -> Floats:
    """Return the nominal transmission of a filter: a pass band over its blocking floor (0..1).

    ``T = T_peak 2^(-|2 (l - center) / fwhm|^(2 p)) + 10^-OD``, with p = 1 a Gaussian and p = 2 the flat top of
    a hard-coated filter.
    """
    x = np.abs(2 * (np.asarray(wavelength_nm, dtype=float) - band.center_nm) / band.fwhm_nm)
    passed = band.peak_transmission * np.exp2(-(x ** (2 * band.shape_order)))
    return np.asarray(passed + 10.0**-band.blocking_od)


def laser_line(laser: LaserSettings, wavelength_nm: ArrayLike) -> Floats:
    """Return the relative spectrum of the laser: a Gaussian line of its full width at half maximum."""
    x = 2 * (np.asarray(wavelength_nm, dtype=float) - laser.wavelength_nm) / laser.fwhm_nm
    return np.asarray(2.0 ** (-(x**2)))


def weights_of(optics: Optics, channel_weights: ArrayLike) -> EmissionWeights:
    """Return the band weights of a rig on the 380-780 nm grid.

    Parameters
    ----------
    optics
        Curves stored with the band signals.
    channel_weights
        (3,) weights of the channels in the laser level V (sum 1).
    """
    grid = WAVELENGTH_NM
    names = [f.name for f in optics.filters]
    return emission_weights(
        grid,
        np.array([filter_transmission(f, grid) for f in optics.filters]),
        np.array([curve(grid) for curve in optics.camera_response]),
        optics.lamp(grid),
        np.full(grid.shape, optics.white_reference.reflectance),
        laser_line(optics.laser, grid),
        names.index(optics.excitation_filter),
        channel_weights,
        np.array([10.0**-f.blocking_od for f in optics.filters]),
    )


def held_shares(optics: Optics) -> Floats:
    """Return the share of each band's weight over which the response or the lamp holds an end value, (B, 3)."""
    shares = []
    for band in optics.filters:
        passed = filter_transmission(band.model_copy(update={"blocking_od": 12.0}), WAVELENGTH_NM)
        lamp = optics.lamp.share_outside(WAVELENGTH_NM, passed)
        shares.append([np.hypot(c.share_outside(WAVELENGTH_NM, passed), lamp) for c in optics.camera_response])
    return np.array(shares)
