"""A rig of closed forms: Gaussian filters, camera, lamp and laser, so that every band integral has outside truth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from benchmarks.drawn_paints import nominal_optics
from data_schemas import BandSignals, Optics
from data_schemas.storage import assumed_camera_response
from finray_calib.spectra import FilterSet, emission_weights
from rigs import simulated_rig
from rigs.simulated import Bench

CENTER_NM = (405, 450, 500, 532, 560, 600, 630, 660)
CHANNEL_NM = ((600, 80), (535, 90), (460, 80))
CHANNEL_WEIGHTS = (0.25, 0.5, 0.25)
EXCITATION = 1
BLOCKING = 1e-5
SHARES = np.array([0.01, 0.09, 0.9])


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
            "filters": FilterSet(
                np.array([self.transmission(b, wavelength) for b in range(len(CENTER_NM))]), EXCITATION, BLOCKING
            ),
            "response": np.array([self.response(c, wavelength) for c in range(len(CHANNEL_NM))]),
            "lamp": self.lamp(wavelength),
            "white_reflectance": self.white(wavelength),
            "laser": self.laser(wavelength),
            "channel_weights": CHANNEL_WEIGHTS,
        }


@pytest.fixture(scope="session")
def rig():
    return ClosedFormRig()


@pytest.fixture(scope="session")
def weights(rig):
    return emission_weights(**rig.sampled(np.arange(380.0, 781.0)))


@pytest.fixture(scope="session")
def optics() -> Optics:
    """The curves of the paper's eight filters with a Bayer camera and a halogen lamp."""
    return nominal_optics()


@pytest.fixture(scope="session")
def red_bands(optics) -> BandSignals:
    """Noise-free signals of the red paint on the simulated bench."""
    rig = simulated_rig("red", seed=3)
    bench = Bench(rig, Path(), assumed_camera_response())
    slots = [f.slot for f in rig.filter_wheel.filters]

    def signal(what: str, light: str) -> np.ndarray:
        radiance = (
            rig.white_reference.reflectance * bench.lights[light]
            if what == "white"
            else bench.sample_radiance(bench.lights[light])
        )
        return np.array([bench.band_electrons_per_s(radiance, slot) for slot in slots])

    white = signal("white", "lamp")
    level = signal("white", "laser")[1] / white[1] @ SHARES
    y, rho = signal("sample", "laser") / white / level, 0.98 * signal("sample", "lamp") / white
    return BandSignals(
        paint_name="red",
        optics=optics,
        fluorescence=y,
        fluorescence_covariance=np.diag((0.002 * y.ravel()) ** 2),
        reflectance=rho,
        reflectance_covariance=np.diag((0.002 * rho.ravel()) ** 2),
        channel_weights=SHARES,
        flags=(("ok", "ok", "ok"),) * 8,
        saturated_fraction=np.zeros((8, 3)),
        region_pixels=1000,
    )
