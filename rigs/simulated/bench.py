"""The simulated bench: light falls on a target, passes a filter and becomes photo-electrons per second.

Radiance is relative: 1 is a perfect white diffuser under the lamp at 560 nm. The curves differ from what a
fitter assumes on purpose: flat-topped filters slightly off their nominal centre, width and blocking, a laser
with a pedestal. Nothing here may be imported by capture or by the calibration arithmetic.
"""

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from data_schemas.band_pass_filter import BandPassFilter
from data_schemas.capture import LightState, Target
from data_schemas.curves import DonaldsonMatrix, SpectralCurve
from data_schemas.devices import LaserSettings
from data_schemas.errors import CaptureError
from data_schemas.rig import RigFile
from data_schemas.standard_curves import LAMP_TEMPERATURE_K, planck_relative
from rigs.simulated.paints import hidden_paint_matrix, measured_material_matrix
from rigs.simulated.scene import CLOTH_REFLECTANCE, colour_checker_reflectances, lay_out
from rigs.simulated.sensor import mosaic

Floats = NDArray[np.float64]
STEP_NM = 0.5
WAVELENGTH_NM: Floats = np.arange(360.0, 800.0 + STEP_NM, STEP_NM)
# Real pass bands are a little flatter than the data sheet's shape, which is all that a fitter can know.
SHAPE_ORDER_RATIO = 1.2
FILTER_TOLERANCE_NM = 0.2
BLOCKING_TOLERANCE_OD = 0.15
LASER_PEDESTAL_REL = 5e-5
LASER_PEDESTAL_FWHM_NM = 30.0
ROOM_TEMPERATURE_K = 5000.0
BOARD_REFLECTANCE = 0.03
PEAK_QUANTUM_EFFICIENCY = 0.6
LAMP_LEVEL_E_PER_S_NM = 3.5e5
LASER_LEVEL_NM_PER_MW = 5.0
ROOM_LEVEL_REL = 0.05


def filter_transmission(
    wavelength_nm: Floats, optic: BandPassFilter, rng: np.random.Generator, measured: SpectralCurve | None = None
) -> Floats:
    r"""Return the transmission of one real filter near its nominal data or its measured curve.

    .. math:: T = T_0 \, 2^{-|2(\lambda - c)/F|^{2 p}} + 10^{-OD}

    Centre and width lie within 0.2 nm of nominal, the optical density within a standard deviation of 0.15; the
    shape order p is 1.2 times the nominal one. A measured curve is passed through by a monotone cubic, moved and
    stretched as much; beside it and below the leak only the leak passes.

    Parameters
    ----------
    wavelength_nm
        Wavelength (nm), shape (L,).
    optic
        Nominal data.
    rng
        Generator of the deviations.
    measured
        Curve that the filter's owner measured.
    """
    off_center_nm, off_width_nm = rng.uniform(-FILTER_TOLERANCE_NM, FILTER_TOLERANCE_NM, 2)
    blocking_od = optic.blocking_od + BLOCKING_TOLERANCE_OD * rng.standard_normal()
    if measured is not None:
        center_nm = float(np.average(measured.wavelength_nm, weights=measured.values))
        drawn_nm = center_nm + (wavelength_nm - center_nm - off_center_nm) * optic.fwhm_nm / (
            optic.fwhm_nm + off_width_nm
        )
        curve = PchipInterpolator(measured.wavelength_nm, measured.values, extrapolate=False)
        return np.asarray(np.maximum(np.nan_to_num(curve(drawn_nm)), 10.0**-blocking_od))
    distance = np.abs(2.0 * (wavelength_nm - optic.center_nm - off_center_nm) / (optic.fwhm_nm + off_width_nm))
    passband = optic.peak_transmission * 2.0 ** -(distance ** (2.0 * SHAPE_ORDER_RATIO * optic.shape_order))
    return np.asarray(passband + 10.0**-blocking_od)


def laser_line(wavelength_nm: Floats, laser: LaserSettings) -> Floats:
    """Return the spectrum of the laser (nm^-1, integral 1 without its weak pedestal): Gaussian line of its FWHM."""

    def gaussian(fwhm_nm: float) -> Floats:
        return np.asarray(np.exp(-4.0 * np.log(2.0) * ((wavelength_nm - laser.wavelength_nm) / fwhm_nm) ** 2))

    peak_per_nm = math.sqrt(4.0 * math.log(2.0) / math.pi) / laser.fwhm_nm
    return peak_per_nm * (gaussian(laser.fwhm_nm) + LASER_PEDESTAL_REL * gaussian(LASER_PEDESTAL_FWHM_NM))


def sample_matrix(rig: RigFile, folder: Path) -> DonaldsonMatrix:
    """Return the re-radiation matrix of what the rig file puts on the bench, on the bench's wavelengths."""
    bench = rig.simulated
    if bench is not None and bench.paint is not None:
        return hidden_paint_matrix(bench.paint, rig.laser.wavelength_nm, WAVELENGTH_NM)
    if bench is not None and bench.material is not None:
        return measured_material_matrix(folder / bench.material, WAVELENGTH_NM)
    raise CaptureError(f"rig '{rig.name}': has no [simulated] table; a simulated bench needs a paint or a material")


class Bench:
    """Spectral and spatial physics of one simulated rig.

    Parameters
    ----------
    rig
        The rig; its ``[simulated]`` table names the sample.
    folder
        Where a relative path of a material file starts.
    response
        Camera response (red, green, blue).
    filter_curves
        Measured transmission of the filters that name one, by the filter's name.
    """

    def __init__(
        self,
        rig: RigFile,
        folder: Path,
        response: tuple[SpectralCurve, SpectralCurve, SpectralCurve],
        filter_curves: Mapping[str, SpectralCurve] | None = None,
    ):
        seed = rig.simulated.seed if rig.simulated is not None else 0
        rng = np.random.default_rng([seed, 1])
        measured = filter_curves or {}
        self.transmission = {
            f.slot: filter_transmission(WAVELENGTH_NM, f, rng, measured.get(f.name)) for f in rig.filter_wheel.filters
        }
        self.response = PEAK_QUANTUM_EFFICIENCY * np.array([curve(WAVELENGTH_NM) for curve in response])
        self.lights: dict[LightState, Floats] = {
            "lamp": planck_relative(WAVELENGTH_NM, LAMP_TEMPERATURE_K),
            "laser": LASER_LEVEL_NM_PER_MW * rig.laser.power_mw * laser_line(WAVELENGTH_NM, rig.laser),
            "room": ROOM_LEVEL_REL * planck_relative(WAVELENGTH_NM, ROOM_TEMPERATURE_K),
        }
        self._white_reflectance = rig.white_reference.reflectance
        matrix = sample_matrix(rig, folder)
        self._sample_reflectance = matrix.reflectance(WAVELENGTH_NM)
        self._sample_reradiation_per_nm = matrix.radiance_factor_per_nm
        self._scene = lay_out(rig.camera.height_px // 2, rig.camera.width_px // 2, seed)
        paint = rig.simulated.paint if rig.simulated is not None else None
        self._bleaching_per_j = 0.0 if paint is None else paint.bleaching_per_j
        # The frames of one step follow each other with the same light, target and filter.
        self._latest = lru_cache(maxsize=1)(self._mosaic_electrons_per_s)
        self._latest_reradiated = lru_cache(maxsize=1)(self._reradiated_electrons_per_s)

    def sample_radiance(self, light: Floats) -> Floats:
        """Return the relative spectral radiance of the fresh sample: reflected plus re-radiated light, shape (L,)."""
        return self._sample_reflectance * light + self._reradiated(light)

    def _reradiated(self, light: Floats) -> Floats:
        """Return the re-radiated part of the sample's relative radiance, shape (L,)."""
        return np.asarray(self._sample_reradiation_per_nm @ light * STEP_NM)

    def band_electrons_per_s(self, radiance: Floats, slot: int | None) -> Floats:
        """Integrate relative radiance (L,) to electrons per second of a red, green and blue pixel, shape (3,)."""
        transmission = 1.0 if slot is None else self.transmission[slot]
        return LAMP_LEVEL_E_PER_S_NM * STEP_NM * (self.response @ (transmission * radiance))

    def darkness(self) -> Floats:
        """Return the photo-electrons per second with all lights off: zeros, shape (H, W)."""
        height, width = self._scene.sample.shape
        return np.zeros((2 * height, 2 * width))

    def electrons_per_s(
        self, target: Target, light: LightState, slot: int | None, sample_dose_j: float = 0.0
    ) -> Floats:
        """Return the photo-electrons per second of every pixel, shape (H, W).

        The sample's emission has fallen by exp(-k D) after the dose D of laser light.

        Parameters
        ----------
        target
            What lies in view.
        light
            The one light that shines ("lamp", "laser" or "room").
        slot
            Slot of the filter in the beam; None is no filter.
        sample_dose_j
            Laser light that the sample has received (J).
        """
        fresh = self._latest(target, light, slot)
        bleached = -math.expm1(-self._bleaching_per_j * sample_dose_j)
        if bleached == 0.0 or target == "white":
            return fresh
        return fresh - bleached * self._latest_reradiated(light, slot)

    def _reradiated_electrons_per_s(self, light: LightState, slot: int | None) -> Floats:
        """Return what the fresh sample's emission alone gives under one light, shape (H, W)."""
        scene = self._scene
        rgb = np.zeros((*scene.sample.shape, 3))
        emitted = self.band_electrons_per_s(self._reradiated(self.lights[light]), slot)
        rgb[scene.sample] = scene.texture["sample"][scene.sample, None] * emitted
        rgb *= scene.irradiance(light)[..., None]
        return mosaic(rgb)

    def _mosaic_electrons_per_s(self, target: Target, light: LightState, slot: int | None) -> Floats:
        """Compose cloth, sample or tile and ColorChecker under one light."""
        scene, spectrum = self._scene, self.lights[light]
        rgb = np.empty((*scene.sample.shape, 3))
        rgb[:] = self.band_electrons_per_s(CLOTH_REFLECTANCE * spectrum, slot)
        if target == "sample beside ColorChecker":
            patches = np.vstack([np.full(len(spectrum), BOARD_REFLECTANCE), colour_checker_reflectances(WAVELENGTH_NM)])
            electrons = np.array([self.band_electrons_per_s(patch * spectrum, slot) for patch in patches])
            on_board = scene.patch >= 0
            rgb[on_board] = electrons[scene.patch[on_board]]
        white = target == "white"
        radiance = self._white_reflectance * spectrum if white else self.sample_radiance(spectrum)
        texture = scene.texture["white" if white else "sample"]
        rgb[scene.sample] = texture[scene.sample, None] * self.band_electrons_per_s(radiance, slot)
        rgb *= scene.irradiance(light)[..., None]
        frame = mosaic(rgb)
        frame.flags.writeable = False
        return frame
