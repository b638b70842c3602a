"""The simulated bench: light falls on a painted target, passes a filter and becomes photo-electrons per second.

Radiance is relative: 1 is a perfect white diffuser under the lamp at 560 nm. The curves differ from what a
fitter assumes on purpose: flat-topped filters slightly off their nominal centre, width and blocking, a laser
with a pedestal. Nothing here may be imported by capture or by the calibration arithmetic.

Paints (of the paper's family, hidden, or measured) are re-radiation (Donaldson) matrices D(out, in) in nm^-1 with a
reflectance curve; maps of the scene have one value per 2 x 2 Bayer cell, positions are fractions of the frame's height
from its centre. :func:`bench_truth` says what a calibration should find.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq, minimize_scalar

from data_schemas import (
    BandPassFilter,
    CaptureError,
    CurveError,
    DonaldsonMatrix,
    HiddenPaint,
    LaserSettings,
    LightState,
    RigFile,
    SpectralCurve,
    Target,
)
from data_schemas.storage import lamp_curve, planck_relative, read_donaldson_matrix
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
    """Return the spectrum of the laser (nm^-1, integral 1 without its weak pedestal): Gaussian line of its FWHM.

    A line narrower than 1 nm is drawn 1 nm wide, because between the bench's steps of 0.5 nm its power would be lost.
    """
    width_nm = max(laser.fwhm_nm, 2.0 * STEP_NM)

    def gaussian(fwhm_nm: float) -> Floats:
        return np.asarray(np.exp(-4.0 * np.log(2.0) * ((wavelength_nm - laser.wavelength_nm) / fwhm_nm) ** 2))

    peak_per_nm = math.sqrt(4.0 * math.log(2.0) / math.pi) / width_nm
    return peak_per_nm * (gaussian(width_nm) + LASER_PEDESTAL_REL * gaussian(LASER_PEDESTAL_FWHM_NM))


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
            "lamp": _lamp_light(rig, folder),
            "laser": LASER_LEVEL_NM_PER_MW * rig.laser.power_mw * laser_line(WAVELENGTH_NM, rig.laser),
            "room": ROOM_LEVEL_REL * planck_relative(WAVELENGTH_NM, ROOM_TEMPERATURE_K),
        }
        self._white_reflectance = rig.white_reference.reflectance
        matrix = sample_matrix(rig, folder)
        self._sample_reflectance = matrix.reflectance(WAVELENGTH_NM)
        self._sample_reradiation_per_nm = matrix.radiance_factor_per_nm
        self._scene = bench_scene(rig.camera.height_px // 2, rig.camera.width_px // 2, seed)
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

    def emitted_electrons_per_s(
        self, target: Target, light: LightState, slot: int | None, sample_dose_j: float = 0.0
    ) -> Floats:
        """Return the part of :meth:`electrons_per_s` that the sample emits: zeros of the white tile, shape (H, W)."""
        if target == "white":
            return self.darkness()
        left = math.exp(-self._bleaching_per_j * sample_dose_j)
        return np.asarray(left * self._latest_reradiated(light, slot))

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


def _lamp_light(rig: RigFile, folder: Path) -> Floats:
    """Return the lamp's light, 1 at 560 nm."""
    if not rig.lamp.spectrum.endswith(".csv"):
        return planck_relative(WAVELENGTH_NM, rig.lamp.temperature_k)
    curve = lamp_curve(rig.lamp, folder)
    return np.asarray(curve(WAVELENGTH_NM) / curve(560.0))


TRUTH_NM: Floats = np.arange(470.0, 781.0)


@dataclass(frozen=True, slots=True)
class BenchTruth:
    """What a calibration of the simulated bench should find; for reports and tests only.

    Attributes
    ----------
    emission
        Emission per nm for light at the laser line (nm^-1), 470 to 780 nm in 1 nm steps.
    mode_nm, fwhm_nm
        Maximum and full width at half maximum of that emission (nm).
    energy_yield
        Emitted over incident energy at the laser line, up to 780 nm.
    absorption
        Photons that light of other wavelengths makes the paint emit, relative to the laser line.
    reflectance
        Non-fluorescent reflectance.
    reflectance_at_laser
        Its value at the laser line.
    """

    emission: SpectralCurve
    mode_nm: float
    fwhm_nm: float
    energy_yield: float
    absorption: SpectralCurve
    reflectance: SpectralCurve
    reflectance_at_laser: float


def bench_truth(rig: RigFile, folder: Path) -> BenchTruth:
    """Return the truth behind a simulated rig; never used by capture, radiometry or fit.

    Mode and width of a hidden paint come from a cubic spline through its fine grid, those of a measured material
    from the monotone cubic (PCHIP) through its bands, whose maximum always lies on a measured wavelength.
    """
    matrix = sample_matrix(rig, folder)
    column = matrix.emission_at(rig.laser.wavelength_nm)
    hidden = rig.simulated is not None and rig.simulated.paint is not None
    through = (CubicSpline if hidden else PchipInterpolator)(column.wavelength_nm, column.values)
    fine_nm = np.linspace(TRUTH_NM[0], TRUTH_NM[-1], 100 * (len(TRUTH_NM) - 1) + 1)
    values = through(fine_nm)
    above = fine_nm[values >= 0.5 * values.max()]
    counted = column.wavelength_nm <= TRUTH_NM[-1]
    # emitted energy over the excitation's wavelength counts photons, as far as the emission keeps its shape
    photons = np.trapezoid(matrix.radiance_factor_per_nm, matrix.emission_nm, axis=0) / matrix.excitation_nm
    at_laser = np.interp(rig.laser.wavelength_nm, matrix.excitation_nm, photons)
    return BenchTruth(
        emission=SpectralCurve(
            name=column.name, wavelength_nm=TRUTH_NM, values=through(TRUTH_NM), source=column.source
        ),
        mode_nm=float(fine_nm[values.argmax()]),
        fwhm_nm=float(above[-1] - above[0]),
        energy_yield=float(np.trapezoid(column.values[counted], column.wavelength_nm[counted])),
        absorption=SpectralCurve(
            name=f"{column.name}, absorption",
            wavelength_nm=matrix.excitation_nm,
            values=photons / at_laser,
            source=column.source,
        ),
        reflectance=matrix.reflectance,
        reflectance_at_laser=float(matrix.reflectance(rig.laser.wavelength_nm)),
    )


SAMPLE_SIDE_REL = 0.36
CLOTH_REFLECTANCE = 0.04
LAMP_GRADIENT_REL = (0.06, 0.10)
SPOT_CENTER_REL = (0.015, -0.025)
SPOT_SD_REL = 0.14
TEXTURE_REL = 0.015
TEXTURE_LENGTH_CELLS = 1.5
BOARD_LEFT_REL, BOARD_RIGHT_REL = 0.20, 0.60
BOARD_HEIGHT_REL = 0.27
PATCH_FILL = 0.82


@dataclass(frozen=True, slots=True)
class Scene:
    """Maps of the bench, each of shape (h, w).

    Attributes
    ----------
    lamp, laser, room
        Irradiance relative to its level at the centre of the frame (laser: of the spot).
    texture
        Relative radiance of the sample or white tile (mean 1), by target.
    sample
        True where the sample or white tile lies.
    patch
        Number of the ColorChecker patch (1 to 24), 0 on its dark board, -1 elsewhere.
    """

    lamp: Floats
    laser: Floats
    room: Floats
    texture: dict[str, Floats]
    sample: NDArray[np.bool_]
    patch: NDArray[np.int64]

    def irradiance(self, light: LightState) -> Floats:
        """Return the relative irradiance of a light that shines, shape (h, w)."""
        return {"lamp": self.lamp, "laser": self.laser, "room": self.room}[light]


def bench_scene(height: int, width: int, seed: int) -> Scene:
    """Lay out the bench for a frame of `height` x `width` Bayer cells; `seed` fixes the textures."""
    y = ((np.arange(height) - 0.5 * (height - 1)) / height)[:, None]
    x = ((np.arange(width) - 0.5 * (width - 1)) / height)[None, :]
    spot_distance2 = (y - SPOT_CENTER_REL[0]) ** 2 + (x - SPOT_CENTER_REL[1]) ** 2
    rng = np.random.default_rng([seed, 3])
    return Scene(
        lamp=1.0 + LAMP_GRADIENT_REL[0] * y + LAMP_GRADIENT_REL[1] * x,
        laser=np.exp(-0.5 * spot_distance2 / SPOT_SD_REL**2),
        room=np.ones((height, width)),
        texture={name: _texture((height, width), rng) for name in ("white", "sample")},
        sample=(np.abs(y) < 0.5 * SAMPLE_SIDE_REL) & (np.abs(x) < 0.5 * SAMPLE_SIDE_REL),
        patch=_colour_checker(y, x),
    )


def _texture(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """Return a smooth random map with mean 1 and a standard deviation of 1.5 %."""
    smooth: Floats = gaussian_filter(rng.standard_normal(shape), TEXTURE_LENGTH_CELLS, mode="wrap")
    return np.asarray(1.0 + TEXTURE_REL * (smooth - smooth.mean()) / smooth.std())


def _colour_checker(y: Floats, x: Floats) -> NDArray[np.int64]:
    """Return the patch number of each cell: a board of 4 rows x 6 columns to the right of the sample."""
    column = (x - BOARD_LEFT_REL) / (BOARD_RIGHT_REL - BOARD_LEFT_REL) * 6.0
    row = (y / BOARD_HEIGHT_REL + 0.5) * 4.0
    board = (column >= 0) & (column < 6) & (row >= 0) & (row < 4)
    edge = 0.5 * (1.0 - PATCH_FILL)
    inside = (np.abs(column % 1 - 0.5) < 0.5 - edge) & (np.abs(row % 1 - 0.5) < 0.5 - edge)
    number = 1 + 6 * np.floor(row) + np.floor(column)
    return np.where(board, np.where(inside, number, 0), -1).astype(np.int64)


def colour_checker_reflectances(wavelength_nm: Floats) -> Floats:
    """Return the spectral reflectance of the 24 patches, shape (24, L); end values are held outside 380-780 nm.

    Source: Ohta's measurements, "ColorChecker N Ohta" of colour-science.
    """
    import colour  # takes seconds to import and only the room-light frame needs it

    patches = colour.SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()
    return np.array([np.interp(wavelength_nm, sd.wavelengths, sd.values) for sd in patches])


SMALLEST_STOKES_SHIFT_NM = 5.0
YIELD_ENDS_NM = 780.0
EDGE_STEEPNESS = 8.0


@cache
def _standard_shape(asinh_skewness: float) -> tuple[float, float]:
    """Return the mode and the full width at half maximum of the skew-Cauchy shape with location 0, scale 1."""

    def shape(z: float) -> float:
        return float((np.arctan(np.sinh(asinh_skewness) * z) / np.pi + 0.5) / (1.0 + z * z))

    # The mode lies within 0.35 scales of the location for every skewness; the half maximum within 2 of the mode.
    mode = minimize_scalar(lambda z: -shape(z), bounds=(-0.4, 0.4), method="bounded", options={"xatol": 1e-12}).x
    half = 0.5 * shape(mode)
    left = brentq(lambda z: shape(z) - half, mode - 2.0, mode, xtol=1e-13)
    right = brentq(lambda z: shape(z) - half, mode, mode + 2.0, xtol=1e-13)
    return float(mode), float(right - left)


def skew_cauchy_shape(wavelength_nm: Floats, mode_nm: float, fwhm_nm: float, asinh_skewness: float) -> Floats:
    r"""Evaluate the paper's emission shape from its mode, width and skewness, not normalised.

    .. math:: f(\lambda) = \frac{\arctan(\omega z) / \pi + 1/2}{1 + z^2}, \quad z = (\lambda - \lambda_0)/\gamma

    Location and scale are solved numerically so that the mode and the full width at half maximum are as given.

    Parameters
    ----------
    wavelength_nm
        Wavelength (nm), any shape.
    mode_nm, fwhm_nm
        Wavelength of the maximum and full width at half maximum (nm).
    asinh_skewness
        ``asinh(omega)``; 0 is the symmetric Cauchy shape.

    Returns
    -------
    ndarray
        Shape of `wavelength_nm`; at most 1.

    Source: Zheng, Sato and Sato, ECCV 2014.
    """
    mode, width = _standard_shape(asinh_skewness)
    scale_nm = fwhm_nm / width
    z = (wavelength_nm - (mode_nm - scale_nm * mode)) / scale_nm
    values: Floats = (np.arctan(np.sinh(asinh_skewness) * z) / np.pi + 0.5) / (1.0 + z * z)
    return values


def hidden_paint_matrix(paint: HiddenPaint, laser_nm: float, wavelength_nm: Floats) -> DonaldsonMatrix:
    r"""Build the re-radiation matrix of a hidden paint.

    .. math:: D(o, i) = Y \frac{a(i)}{a(i_L)} e(o) \;\; \text{for } o > i + 5\,\text{nm, else } 0

    e is the skew-Cauchy shape with integral 1 from the laser line (+5 nm) to 780 nm, so that the column at the
    laser line is the pure paper family there and integrates to the energy yield Y. Emission below the
    excitation is cut off. The absorptance a is a plateau that falls half-way between the absorption peak and
    the mode of the emission; the reflectance rises there, and reflectance + absorptance <= 1.

    Parameters
    ----------
    paint
        The hidden parameters.
    laser_nm
        Wavelength of the laser (nm).
    wavelength_nm
        Common axis of emission and excitation (nm), increasing in equal steps, shape (L,).

    Raises
    ------
    CurveError
        The parameters contradict each other: absorption peak not below the mode, laser not absorbed, or more
        light emitted than absorbed.
    """
    plateau = _absorption_plateau(paint, laser_nm, wavelength_nm)
    at_laser = float(np.interp(laser_nm, wavelength_nm, plateau))
    stokes_shift_nm = wavelength_nm[:, None] - wavelength_nm[None, :]
    emission = skew_cauchy_shape(wavelength_nm, paint.mode_nm, paint.fwhm_nm, paint.asinh_skewness)
    counted = (wavelength_nm > laser_nm + SMALLEST_STOKES_SHIFT_NM) & (wavelength_nm <= YIELD_ENDS_NM)
    emission *= paint.energy_yield / np.trapezoid(emission[counted], wavelength_nm[counted])
    matrix = np.where(stokes_shift_nm > SMALLEST_STOKES_SHIFT_NM, np.outer(emission, plateau / at_laser), 0.0)
    absorptance = (1.0 - paint.reflectance_at_laser) * plateau
    emitted = np.trapezoid(matrix, wavelength_nm, axis=0)
    if (emitted > absorptance + 1e-12).any():
        raise CurveError(
            f"simulated.paint: energy_yield = {paint.energy_yield:g} means that more light is emitted than absorbed "
            f"(reflectance_at_laser = {paint.reflectance_at_laser:g}); lower energy_yield or reflectance_at_laser"
        )
    rise = paint.reflectance_long_wavelength - paint.reflectance_at_laser
    return DonaldsonMatrix(
        name=paint.name,
        emission_nm=wavelength_nm,
        excitation_nm=wavelength_nm,
        radiance_factor_per_nm=matrix,
        reflectance=SpectralCurve(
            name=f"{paint.name}, reflectance",
            wavelength_nm=wavelength_nm,
            values=paint.reflectance_at_laser + rise * (1.0 - plateau),
            source="simulated",
        ),
        source="simulated",
    )


def _absorption_plateau(paint: HiddenPaint, laser_nm: float, wavelength_nm: Floats) -> Floats:
    """Return the relative absorptance: 1, falling to 0 half-way between absorption peak and emission mode."""
    if paint.absorption_peak_nm >= paint.mode_nm:
        raise CurveError(
            f"simulated.paint: absorption_peak_nm = {paint.absorption_peak_nm:g} must be below mode_nm = "
            f"{paint.mode_nm:g} nm (a paint emits at longer wavelengths than it absorbs)"
        )
    edge_nm = 0.5 * (paint.absorption_peak_nm + paint.mode_nm)
    if laser_nm > edge_nm:
        raise CurveError(
            f"simulated.paint: absorbs only up to {edge_nm:g} nm, but the laser is at {laser_nm:g} nm; raise "
            "absorption_peak_nm or mode_nm"
        )
    width_nm = (paint.mode_nm - paint.absorption_peak_nm) / EDGE_STEEPNESS
    return np.asarray(0.5 * (1.0 - np.tanh(0.5 * (wavelength_nm - edge_nm) / width_nm)))


def measured_material_matrix(path: Path, wavelength_nm: Floats) -> DonaldsonMatrix:
    """Read a measured re-radiation matrix and interpolate it to the bench's wavelengths.

    Monotone cubic (PCHIP) along emission, linear along excitation; outside the measured excitation nothing is
    emitted. Negative measurement noise becomes 0: a bench cannot emit negative light.
    """
    measured = read_donaldson_matrix(path)
    along_emission = PchipInterpolator(measured.emission_nm, measured.radiance_factor_per_nm, axis=0, extrapolate=False)
    rows = np.clip(np.nan_to_num(along_emission(wavelength_nm)), 0.0, None)
    matrix = np.array([np.interp(wavelength_nm, measured.excitation_nm, row, left=0.0, right=0.0) for row in rows])
    return DonaldsonMatrix(
        name=measured.name,
        emission_nm=wavelength_nm,
        excitation_nm=wavelength_nm,
        radiance_factor_per_nm=matrix,
        reflectance=measured.reflectance,
        source=measured.source,
    )
