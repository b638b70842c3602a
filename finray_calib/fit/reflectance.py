r"""Non-fluorescent reflectance of a paint at each filter.

Under the white lamp a fluorescent paint sends reflected *and* re-emitted light through a filter. With the
emission f known from the laser, the re-emitted part of filter b is

.. math:: \Phi_b = \frac{\int f T_b Q\,d\lambda}{\int E T_b Q\,d\lambda} \int_{380}^{\lambda_a} E\,d\lambda'

where the paint is taken to absorb at all wavelengths from 380 nm to the foot of its emission as it does at the
laser line (absorption of fluorescent paint is a flat, saturated plateau). That plateau is an assumption: one
laser does not measure it, so half of the subtracted light is carried as standard uncertainty.
"""

import numpy as np
from numpy.typing import NDArray

from data_schemas.estimate import Estimate
from data_schemas.radiometry import BandSignals
from finray_calib.spectra.rig_curves import WAVELENGTH_NM, transmissions

Floats = NDArray[np.float64]
METHOD = (
    "total radiance factor under the lamp minus re-emitted light (absorption plateau assumed from 380 nm to the foot "
    "of the emission, half of it carried as uncertainty); at the laser line from the reflected laser light"
)
PLATEAU_UNCERTAINTY_REL = 0.5
# The absorption ends where the emission rises to this share of its peak on the blue side.
FOOT_SHARE = 0.10
_NORMAL_68, _NORMAL_95 = 0.994458, 1.959964
# Without a usable channel nothing is known but that a reflectance lies between 0 and 1.
UNKNOWN = Estimate(estimate=0.5, sd=12**-0.5, low68=0.16, high68=0.84, low95=0.025, high95=0.975)


def reflectance(bands: BandSignals, emission_per_nm: Floats, at_laser: Estimate) -> tuple[Estimate, ...]:
    """Return the reflectance at each filter (0..1) with its uncertainty.

    Parameters
    ----------
    bands
        Band signals with total radiance factors under the lamp.
    emission_per_nm
        (L,) fitted emission on :data:`WAVELENGTH_NM`.
    at_laser
        Reflectance at the laser line from the fit; used for the excitation filter.
    """
    variance = np.diag(bands.reflectance_covariance).reshape(-1, 3)
    usable = bands.usable() & (variance > 0)
    response = np.array([[c(f.center_nm) for c in bands.optics.camera_response] for f in bands.optics.filters])
    best = np.where(usable, response, -np.inf).argmax(axis=1)  # the channel that sees most of the band and least leak
    estimates = []
    for b, band in enumerate(bands.optics.filters):
        if band.name == bands.optics.excitation_filter:
            estimates.append(at_laser)
        elif not usable[b].any():
            estimates.append(UNKNOWN)
        else:
            channel = int(best[b])
            emitted = _emitted(bands, b, channel, emission_per_nm)
            sd = float(np.hypot(np.sqrt(variance[b, channel]), PLATEAU_UNCERTAINTY_REL * emitted))
            estimates.append(_normal(float(bands.reflectance[b, channel]) - emitted, sd))
    return tuple(estimates)


def _emitted(bands: BandSignals, band: int, channel: int, emission_per_nm: Floats) -> float:
    """Return the re-emitted part of the total radiance factor in one filter and channel."""
    optics = bands.optics
    lamp = optics.lamp(WAVELENGTH_NM)
    passed = transmissions(optics)[band] * optics.camera_response[channel](WAVELENGTH_NM)
    peak = int(emission_per_nm.argmax())
    foot = int(np.argmax(emission_per_nm[: peak + 1] >= FOOT_SHARE * emission_per_nm[peak]))
    absorbed = float(np.trapezoid(lamp[: foot + 1], WAVELENGTH_NM[: foot + 1]))
    return float((passed * emission_per_nm).sum() / (passed * lamp).sum()) * absorbed


def _normal(value: float, sd: float) -> Estimate:
    """Return a normal estimate; reflectance cannot leave 0..1, so its ends are cut there."""
    low68, high68 = value - _NORMAL_68 * sd, value + _NORMAL_68 * sd
    low95, high95 = value - _NORMAL_95 * sd, value + _NORMAL_95 * sd
    cut = [float(np.clip(v, 0.0, 1.0)) for v in (value, low68, high68, low95, high95)]
    return Estimate(estimate=cut[0], sd=sd, low68=cut[1], high68=cut[2], low95=cut[3], high95=cut[4])
