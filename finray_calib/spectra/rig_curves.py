"""The known curves of a rig on one wavelength grid."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.curves import SpectralCurve
from data_schemas.devices import LaserSettings
from data_schemas.radiometry import Optics
from finray_calib.spectra.band_weights import EmissionWeights, emission_weights

Floats = NDArray[np.float64]
WAVELENGTH_NM: Floats = np.arange(380.0, 781.0, 1.0)
WAVELENGTH_NM.flags.writeable = False
# Hat function of one grid step: its weights on a tenth of a step integrate a curve exactly as far as the emission is
# linear between grid points. The edge of a hard-coated filter is steeper than the grid.
_HAT_OFFSET_NM: Floats = np.linspace(-0.9, 0.9, 19)
_HAT: Floats = (1.0 - np.abs(_HAT_OFFSET_NM)) / 10.0


def filter_transmission(band: BandPassFilter, wavelength_nm: ArrayLike) -> Floats:
    """Return the nominal transmission of a filter: a pass band over its blocking floor (0..1).

    ``T = T_peak 2^(-|2 (l - center) / fwhm|^(2 p)) + 10^-OD``, with p = 1 a Gaussian and p = 2 the flat top of
    a hard-coated filter.
    """
    x = np.abs(2 * (np.asarray(wavelength_nm, dtype=float) - band.center_nm) / band.fwhm_nm)
    passed = band.peak_transmission * np.exp2(-(x ** (2 * band.shape_order)))
    return np.asarray(passed + 10.0**-band.blocking_od)


def measured_transmission(curve: SpectralCurve, blocking_od: float) -> Floats:
    """Return a measured transmission averaged over the steps of the grid, (L,): outside its range the floor 10^-OD.

    Where it falls below the floor the floor holds as well: blocking is known from the filter's data, not from the
    noise of a spectrophotometer.
    """
    fine_nm = WAVELENGTH_NM[:, None] + _HAT_OFFSET_NM
    inside = (fine_nm >= curve.wavelength_nm[0]) & (fine_nm <= curve.wavelength_nm[-1])
    return np.asarray(np.maximum(np.where(inside, curve(fine_nm), 0.0), 10.0**-blocking_od) @ _HAT)


def transmissions(optics: Optics) -> Floats:
    """Return the transmission of every filter on the grid, (B, L): the measured curve where there is one."""
    return np.array([_transmission(optics, band) for band in optics.filters])


def _transmission(optics: Optics, band: BandPassFilter) -> Floats:
    """Return the transmission of one filter on the grid, (L,)."""
    if band.name in optics.filter_curves:
        return measured_transmission(optics.filter_curves[band.name], band.blocking_od)
    return filter_transmission(band, WAVELENGTH_NM)


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
        transmissions(optics),
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
    blocked = tuple(band.model_copy(update={"blocking_od": 12.0}) for band in optics.filters)
    for passed in transmissions(optics.model_copy(update={"filters": blocked})):
        lamp = optics.lamp.share_outside(WAVELENGTH_NM, passed)
        shares.append([np.hypot(c.share_outside(WAVELENGTH_NM, passed), lamp) for c in optics.camera_response])
    return np.array(shares)
