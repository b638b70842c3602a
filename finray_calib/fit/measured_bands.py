"""Band values of a measured region, with the errors that its photon noise does not know."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from data_schemas.curves import HELD_UNCERTAINTY_REL
from data_schemas.radiometry import BandSignals
from finray_calib.fit.band_data import BandData
from finray_calib.spectra.band_tolerances import tolerances_of
from finray_calib.spectra.rig_curves import held_shares, weights_of

Floats = NDArray[np.float64]

BAND_CALIBRATION_REL: Final = 0.01
# What a region's photon noise does not know: the shape of each channel's response inside a band, and stray light in
# camera and enclosure. Without them a tail of a thousandth of the peak would be trusted to a hundredth of itself.
CHANNEL_RESPONSE_REL: Final = 0.003
STRAY_LIGHT_REL: Final = 0.003
# Where more of a channel's white signal is leak, the channel measures the filter's blocking and not its band: a floor
# that is nowhere as flat as its optical density says.
LARGEST_LEAK_OF_WHITE: Final = 0.1


def band_data(bands: BandSignals) -> BandData:
    """Return the data of the likelihood for the band signals of a region.

    Raises
    ------
    FitError
        Fewer than four usable bands, or values that are not numbers.
    """
    weights = weights_of(bands.optics, bands.channel_weights)
    in_band = weights.leaked_white.reshape(-1, 3) <= LARGEST_LEAK_OF_WHITE
    return BandData(
        y=bands.fluorescence,
        covariance=bands.fluorescence_covariance + _channel_covariance(bands),
        usable=bands.usable() & in_band,
        weights=weights,
        band_calibration_rel=BAND_CALIBRATION_REL,
        tolerances=tolerances_of(bands.optics, bands.channel_weights),
    )


def _channel_covariance(bands: BandSignals) -> Floats:
    """Return the variances of channel response, held ends of curves, and stray light.

    Stray light is relative to the brightest emission band. Where a curve holds its end value, that share of the
    band's weight carries a relative uncertainty of 0.5.
    """
    y, usable = bands.fluorescence, bands.usable()
    emission = usable & ~bands.at_excitation()[:, None]
    brightest = float(np.abs(y[emission]).max()) if emission.any() else 0.0
    relative = np.hypot(CHANNEL_RESPONSE_REL, HELD_UNCERTAINTY_REL * held_shares(bands.optics))
    return np.diag(((relative * y) ** 2 + (STRAY_LIGHT_REL * brightest) ** 2).ravel())
