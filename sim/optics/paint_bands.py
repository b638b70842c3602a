"""Three spectral bands carry all the light: red emission, green emission and the LED.

The renderer's three channels are these bands; a paint is its mean reflectance in each band plus the share of LED
energy it turns into its own band. Camera channels are formed after rendering, RGB = C @ bands, so the camera's
response and the white balance never need a new render.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import LightPanel
from data_schemas.errors import SimulateError

BAND_NAMES = ("red", "green", "led")

# the LED's band ends where a Gaussian of its width has fallen to this share of its peak
_LED_EDGE_SHARE = 0.01
_LED_STEP_NM = 0.5
_LED_HALF_SPAN_FWHM = 3.0
# above this share of a band outside a curve's range the mean over the band is guesswork
_LARGEST_SHARE_OUTSIDE = 0.20
# a measured paint may exceed energy balance by rounding only
_ENERGY_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class PaintOptics:
    """A fluorescent paint under this LED.

    ``emission_per_nm`` (n,) is the bispectral radiance factor per nm for excitation at the LED: its integral over
    wavelength is the share of the LED's energy that is emitted. ``reflectance`` (n,) is 0..1 on the same grid.
    """

    name: str
    wavelength_nm: NDArray[np.float64]
    emission_per_nm: NDArray[np.float64]
    reflectance: NDArray[np.float64]

    def __post_init__(self) -> None:
        shapes = {self.wavelength_nm.shape, self.emission_per_nm.shape, self.reflectance.shape}
        if len(shapes) != 1 or self.wavelength_nm.ndim != 1 or self.wavelength_nm.size < 2:
            raise SimulateError(
                f"paint {self.name}: wavelength_nm, emission_per_nm and reflectance must be equally long lists of at "
                f"least 2 values, got shapes {sorted(map(str, shapes))}"
            )
        values = (self.wavelength_nm, self.emission_per_nm, self.reflectance)
        if not all(np.isfinite(v).all() for v in values) or (np.diff(self.wavelength_nm) <= 0.0).any():
            raise SimulateError(f"paint {self.name}: all values must be finite and wavelength_nm must increase")
        if (self.emission_per_nm < 0.0).any() or (self.reflectance < 0.0).any() or (self.reflectance > 1.0).any():
            raise SimulateError(f"paint {self.name}: emission_per_nm must be >= 0 and reflectance within 0..1")


@dataclass(frozen=True, slots=True)
class SpectralBand:
    """A band's spectral power distribution of unit integral, per nm, on its own grid."""

    wavelength_nm: NDArray[np.float64]
    density_per_nm: NDArray[np.float64]

    @property
    def centroid_nm(self) -> float:
        """Mean wavelength of the band."""
        return float(np.trapezoid(self.wavelength_nm * self.density_per_nm, self.wavelength_nm))


@dataclass(frozen=True, slots=True)
class PaintBands:
    """What the renderer needs of two paints and a panel.

    ``bands`` in the order of BAND_NAMES; per paint, ``reflectance`` (3,) is the mean over each band,
    ``energy_conversion`` the share of LED energy emitted in its own band and ``cut_share`` the share of the
    measured emission that lay below the LED's upper edge and was dropped: paint does not emit below its excitation.
    """

    bands: tuple[SpectralBand, SpectralBand, SpectralBand]
    reflectance: Mapping[str, NDArray[np.float64]]
    energy_conversion: Mapping[str, float]
    cut_share: Mapping[str, float]


def paint_bands(red: PaintOptics, green: PaintOptics, light: LightPanel) -> PaintBands:
    """Return the three bands and what each paint does in them.

    K = integral of the emission above the LED's upper edge; rho_j = integral of reflectance times band j. Exact
    for reflection and for light that the LED excites once; emission of one paint exciting the other is left out.

    Raises
    ------
    SimulateError
        When a paint has no emission above the edge, when a curve misses more than a fifth of a band, or when
        reflectance at the LED plus K exceeds one.
    """
    led = led_band(light)
    emissions = {"red": _emission_band(red, light), "green": _emission_band(green, light)}
    bands = (emissions["red"][0], emissions["green"][0], led)
    reflectance, conversion, cut = {}, {}, {}
    for key, paint in (("red", red), ("green", green)):
        what = f"reflectance of paint {paint.name}"
        values = [band_mean(paint.wavelength_nm, paint.reflectance, band, what) for band in bands]
        reflectance[key] = np.array(values)
        _, conversion[key], cut[key] = emissions[key]
        energy = float(reflectance[key][2]) + conversion[key]
        if energy > 1.0 + _ENERGY_TOLERANCE:
            raise SimulateError(
                f"paint {paint.name} returns more energy than the LED brings: reflectance {reflectance[key][2]:.3f} "
                f"at {light.peak_wavelength_nm:g} nm plus emitted share {conversion[key]:.3f} must not exceed 1; "
                "check the paint's calibration"
            )
    return PaintBands(bands, reflectance, conversion, cut)


def led_band(light: LightPanel) -> SpectralBand:
    """Return the LED as a Gaussian of its peak wavelength and full width at half maximum."""
    half_span = _LED_HALF_SPAN_FWHM * light.fwhm_nm
    count = 2 * int(np.ceil(half_span / _LED_STEP_NM)) + 1
    offset = np.linspace(-half_span, half_span, count)
    density = np.exp(-4.0 * np.log(2.0) * (offset / light.fwhm_nm) ** 2)
    wavelength = light.peak_wavelength_nm + offset
    return SpectralBand(wavelength, density / np.trapezoid(density, wavelength))


def led_upper_edge_nm(light: LightPanel) -> float:
    """Return the wavelength above the peak at which the LED has fallen to one hundredth."""
    return float(light.peak_wavelength_nm + light.fwhm_nm / 2.0 * np.sqrt(-np.log(_LED_EDGE_SHARE) / np.log(2.0)))


def band_mean(wavelength_nm: NDArray[np.float64], values: NDArray[np.float64], band: SpectralBand, what: str) -> float:
    """Return the mean of a curve over a band; the curve holds its end values outside its range.

    Raises
    ------
    SimulateError
        When more than a fifth of the band's energy lies outside the curve's range.
    """
    beyond = (band.wavelength_nm < wavelength_nm[0]) | (band.wavelength_nm > wavelength_nm[-1])
    outside = float(np.trapezoid(band.density_per_nm * beyond, band.wavelength_nm))
    if outside > _LARGEST_SHARE_OUTSIDE:
        raise SimulateError(
            f"the {what} is known from {wavelength_nm[0]:g} to {wavelength_nm[-1]:g} nm, but {outside:.0%} of a band "
            f"around {band.centroid_nm:.0f} nm lies outside (20 % allowed); give the curve over a wider range"
        )
    curve = np.interp(band.wavelength_nm, wavelength_nm, values)
    return float(np.trapezoid(curve * band.density_per_nm, band.wavelength_nm))


def camera_matrix(
    response: NDArray[np.float64], wavelength_nm: NDArray[np.float64], bands: PaintBands
) -> NDArray[np.float64]:
    """Return C with camera RGB = C @ bands: C[k, j] = integral of response k times band j.

    Exact for light whose spectrum within each band has the band's shape.

    Parameters
    ----------
    response
        Camera response per channel, shape (3, n), in the caller's unit per radiance.
    wavelength_nm
        Increasing wavelengths, shape (n,).
    bands
        From :func:`paint_bands`.

    Returns
    -------
    array
        Shape (3 channels, 3 bands).

    Raises
    ------
    SimulateError
        When the shapes disagree or the response misses more than a fifth of a band.
    """
    if response.shape != (3, wavelength_nm.size):
        raise SimulateError(
            f"the camera response must have shape (3, {wavelength_nm.size}) like its wavelengths, got {response.shape}"
        )
    return np.array(
        [
            [band_mean(wavelength_nm, channel, band, f"camera response {name}") for band in bands.bands]
            for name, channel in zip("RGB", response, strict=True)
        ]
    )


def _emission_band(paint: PaintOptics, light: LightPanel) -> tuple[SpectralBand, float, float]:
    """Return the paint's emission band, its energy conversion, and the share cut below the LED's upper edge."""
    edge = led_upper_edge_nm(light)
    wavelength, emission = paint.wavelength_nm, paint.emission_per_nm
    if edge >= wavelength[-1]:
        above, kept = wavelength[-1:], np.zeros(1)
    else:
        above = np.concatenate([[max(edge, wavelength[0])], wavelength[wavelength > max(edge, wavelength[0])]])
        kept = np.interp(above, wavelength, emission)
    conversion = float(np.trapezoid(kept, above))
    if conversion <= 0.0:
        raise SimulateError(
            f"paint {paint.name} has no emission above the LED's upper edge at {edge:.0f} nm; give "
            "emission_per_nm at longer wavelengths or choose an LED of shorter peak_wavelength_nm"
        )
    total = float(np.trapezoid(emission, wavelength))
    return SpectralBand(above, kept / conversion), conversion, max(0.0, 1.0 - conversion / total)
