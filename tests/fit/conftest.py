"""A rig of closed forms: Gaussian filters, camera, lamp and laser, so that every band integral has outside truth."""

from dataclasses import dataclass

import numpy as np
import pytest

from data_schemas.radiometry import Optics
from data_schemas.standard_curves import assumed_camera_response, halogen_lamp
from finray_calib.fit.likelihood import BandData
from finray_calib.fit.nuisances import predict_bands
from finray_calib.spectra.band_weights import emission_weights
from rigs.presets import simulated_rig

CENTER_NM = (405, 450, 500, 532, 560, 600, 630, 660)
CHANNEL_NM = ((600, 80), (535, 90), (460, 80))
CHANNEL_WEIGHTS = (0.25, 0.5, 0.25)
EXCITATION = 1
BLOCKING = 1e-5


def line(wavelength_nm, center_nm, fwhm_nm):
    return np.exp(-4 * np.log(2) * ((np.asarray(wavelength_nm) - center_nm) / fwhm_nm) ** 2)


@dataclass(frozen=True)
class ClosedFormRig:
    """The curves as functions of wavelength in nm."""

    center_nm = CENTER_NM
    channel_weights = CHANNEL_WEIGHTS
    excitation = EXCITATION
    leak = BLOCKING

    def transmission(self, band, wavelength):
        return 0.6 * line(wavelength, CENTER_NM[band], 10.0) + BLOCKING

    def response(self, channel, wavelength):
        return 0.01 + line(wavelength, *CHANNEL_NM[channel])

    def lamp(self, wavelength):
        return 0.3 + line(wavelength, 450, 25) + line(wavelength, 570, 130)

    def white(self, wavelength):
        return 0.97 - 1e-4 * (np.asarray(wavelength) - 580)

    def laser(self, wavelength):
        return line(wavelength, 450, 4.0) / (4.0 * np.sqrt(np.pi / (4 * np.log(2))))

    def sampled(self, wavelength):
        """Arguments of emission_weights on a grid."""
        return {
            "wavelength_nm": wavelength,
            "transmission": np.array([self.transmission(b, wavelength) for b in range(len(CENTER_NM))]),
            "response": np.array([self.response(c, wavelength) for c in range(len(CHANNEL_NM))]),
            "lamp": self.lamp(wavelength),
            "white_reflectance": self.white(wavelength),
            "laser": self.laser(wavelength),
            "excitation_band": EXCITATION,
            "channel_weights": CHANNEL_WEIGHTS,
            "leak": BLOCKING,
        }


@pytest.fixture(scope="session")
def rig():
    return ClosedFormRig()


@pytest.fixture(scope="session")
def weights(rig):
    return emission_weights(**rig.sampled(np.arange(380.0, 781.0)))


@pytest.fixture(scope="session")
def orange_theta():
    """An orange paint: mode 597 nm, FWHM 48 nm, skewness 3, a tenth of the laser reflected."""
    return np.array([597.0, np.log(48.0), np.arcsinh(3.0), np.log(0.004), np.log(0.1), 0.2])


@pytest.fixture(scope="session")
def simulate_bands(weights):
    """Return a function theta, rng -> BandData with 0.3 % noise, a small floor and 1 % band calibration."""

    def simulate(theta, rng, usable=None):
        mu = predict_bands(theta[None], weights)[0]
        sd = np.hypot(0.003 * mu, 2e-4)
        y = mu * (1 + 0.01 * rng.standard_normal(8)[weights.band_index]) + sd * rng.standard_normal(mu.size)
        usable = np.ones((8, 3), bool) if usable is None else usable
        return BandData(y.reshape(8, 3), np.diag(sd**2), usable, weights)

    return simulate


@pytest.fixture(scope="session")
def optics() -> Optics:
    """The curves of the paper's eight filters with a Bayer camera and a halogen lamp."""
    rig = simulated_rig("red")
    return Optics(
        filters=rig.filter_wheel.filters,
        excitation_filter="450",
        laser=rig.laser,
        lamp=halogen_lamp(),
        white_reference=rig.white_reference,
        camera_response=assumed_camera_response(),
    )
