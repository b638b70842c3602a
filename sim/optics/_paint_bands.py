"""Three spectral bands carry all the light: red emission, green emission and the LED.

The renderer's three channels are these bands; a paint is its mean reflectance in each band plus the share of each
band's energy that it turns into its own band: a 3 x 3 matrix diag(rho) + K, of which K has one row. Camera channels are
formed after rendering, RGB = C @ bands, so the camera's response and the white balance never need a new render.

The same holds for the paints: the light of a chain such as "led>green>red" is proportional to each conversion on its
way (LED to green emission at the green wall, green to red emission at the red wall) and lies in the band of its end. So
with one image per chain, an image with other conversions, emission shapes, camera or white balance is one matrix
product away; no path is traced again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from data_schemas import ImpossibleFingerError, LightPanel, SimulateError

BAND_NAMES = ("red", "green", "led")

# the LED's band ends where a Gaussian of its width has fallen to this share of its peak
_LED_EDGE_SHARE = 0.01
_LED_STEP_NM = 0.5
_LED_HALF_SPAN_FWHM = 3.0
# above this share of a band outside a curve's range the mean over the band is guesswork
_LARGEST_SHARE_OUTSIDE = 0.20
# a measured paint may exceed energy balance by rounding only
_ENERGY_TOLERANCE = 1e-9
# and its photons by what means over bands leave out
_PHOTON_TOLERANCE = 0.01


@dataclass(frozen=True, slots=True)
class PaintOptics:
    """A fluorescent paint under this LED.

    ``emission_per_nm`` (n,) is the bispectral radiance factor per nm for excitation at the LED: its integral over
    wavelength is the share of the LED's energy that is emitted. ``reflectance`` (n,) is 0..1 on the same grid.
    ``absorption_rel`` (n,) is the absorption spectrum of the fluorescent pigment in any unit: it tells what other
    wavelengths excite the same emission. Without it only the LED does.
    """

    name: str
    wavelength_nm: NDArray[np.float64]
    emission_per_nm: NDArray[np.float64]
    reflectance: NDArray[np.float64]
    absorption_rel: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        values = [self.wavelength_nm, self.emission_per_nm, self.reflectance]
        if self.absorption_rel is not None:
            values.append(self.absorption_rel)
        shapes = {v.shape for v in values}
        if len(shapes) != 1 or self.wavelength_nm.ndim != 1 or self.wavelength_nm.size < 2:
            raise SimulateError(
                f"paint {self.name}: wavelength_nm, emission_per_nm, reflectance and absorption_rel must be equally "
                f"long lists of at least 2 values, got shapes {sorted(map(str, shapes))}"
            )
        if self.absorption_rel is not None and (self.absorption_rel < 0.0).any():
            raise SimulateError(f"paint {self.name}: absorption_rel must be 0 or more everywhere")
        if not all(np.isfinite(v).all() for v in values) or (np.diff(self.wavelength_nm) <= 0.0).any():
            raise SimulateError(f"paint {self.name}: all values must be finite and wavelength_nm must increase")
        if (self.emission_per_nm < 0.0).any() or (self.reflectance < 0.0).any() or (self.reflectance > 1.0).any():
            raise SimulateError(
                f"paint {self.name}: emission_per_nm must be 0 or more, and reflectance from 0 to 1, everywhere"
            )


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

    ``bands`` in the order of BAND_NAMES; per paint, ``reflectance`` (3,) is the mean over each band, ``conversion``
    (3,) the share of each band's energy that is emitted in the paint's own band and ``cut_share`` the share of the
    measured emission that lay below the LED's upper edge and was dropped: paint does not emit below its excitation.
    """

    bands: tuple[SpectralBand, SpectralBand, SpectralBand]
    reflectance: Mapping[str, NDArray[np.float64]]
    conversion: Mapping[str, NDArray[np.float64]]
    cut_share: Mapping[str, float]

    @property
    def energy_conversion(self) -> dict[str, float]:
        """Per paint, the share of the LED's energy that is emitted."""
        return {paint: float(row[BAND_NAMES.index("led")]) for paint, row in self.conversion.items()}

    def excites(self, band: str) -> bool:
        """Whether light of a band makes any paint emit."""
        return any(row[BAND_NAMES.index(band)] > 0.0 for row in self.conversion.values())

    def matrix(self, paint: str) -> NDArray[np.float64]:
        """Return the paint's reradiation matrix M[band out, band in] = diag(rho) + K."""
        matrix = np.diag(self.reflectance[paint])
        matrix[BAND_NAMES.index(paint)] += self.conversion[paint]
        return matrix


def paint_bands(red: PaintOptics, green: PaintOptics, light: LightPanel) -> PaintBands:
    """Return the three bands and what each paint does in them.

    rho_j = integral of reflectance times band j. K[own, LED] = integral of the emission above the LED's upper edge;
    K[own, j] follows from the absorption a: photons absorbed in band j emit as those of the LED do, so
    K[own, j] / K[own, LED] = mean of a(l) l over band j over its mean over the LED. Exact for light that has the
    bands' shapes, and for emission whose shape does not depend on what excites it.

    Raises
    ------
    SimulateError
        When a paint has no emission above the edge or does not absorb the LED, when a curve misses more than a fifth
        of a band, or when reflectance plus emission in a band exceed one.
    """
    led = led_band(light)
    emissions = {"red": emission_band(red, light), "green": emission_band(green, light)}
    bands = (emissions["red"][0], emissions["green"][0], led)
    reflectance, conversion, cut = {}, {}, {}
    for key, paint in (("red", red), ("green", green)):
        what = f"reflectance of paint {paint.name}"
        values = [band_mean(paint.wavelength_nm, paint.reflectance, band, what) for band in bands]
        reflectance[key] = np.array(values)
        _, of_led, cut[key] = emissions[key]
        conversion[key] = of_led * _excitation(paint, bands)
        for name, band, out in zip(BAND_NAMES, bands, reflectance[key] + conversion[key], strict=True):
            if out > 1.0 + _ENERGY_TOLERANCE:
                source = "LED" if name == "led" else f"{name} band"
                raise ImpossibleFingerError(
                    f"paint {paint.name} returns more energy than the {source} brings, because reflectance plus "
                    f"emitted share at {band.centroid_nm:.0f} nm make {out:.3f} and must not exceed 1; check the "
                    "paint's calibration"
                )
            photons = reflectance[key][BAND_NAMES.index(name)]
            photons += conversion[key][BAND_NAMES.index(name)] * emissions[key][0].centroid_nm / band.centroid_nm
            if photons > 1.0 + _PHOTON_TOLERANCE:
                raise ImpossibleFingerError(
                    f"paint {paint.name} returns {photons:.3f} photons for each photon at {band.centroid_nm:.0f} nm, "
                    "but reflected and emitted photons must not exceed 1; check the paint's yield and reflectance"
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
            f"the {what} is known only from {wavelength_nm[0]:g} to {wavelength_nm[-1]:g} nm, so {100 * outside:.0f} % "
            f"of a band around {band.centroid_nm:.0f} nm lies outside, but at most 20 % is allowed; give the curve "
            "over a wider range"
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
            f"the camera response must have shape (3, {wavelength_nm.size}) to match its wavelengths, got "
            f"{response.shape}"
        )
    return np.array(
        [
            [band_mean(wavelength_nm, channel, band, f"camera response {name}") for band in bands.bands]
            for name, channel in zip("RGB", response, strict=True)
        ]
    )


def emission_band(paint: PaintOptics, light: LightPanel) -> tuple[SpectralBand, float, float]:
    """Return the paint's emission band, its energy conversion, and the share cut below the LED's upper edge.

    Raises
    ------
    SimulateError
        When the paint has no emission above the edge.
    """
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


def _excitation(paint: PaintOptics, bands: tuple[SpectralBand, SpectralBand, SpectralBand]) -> NDArray[np.float64]:
    """Return how strongly each band excites a paint per energy, relative to the LED."""
    if paint.absorption_rel is None:
        return np.array([0.0, 0.0, 1.0])
    photons = paint.absorption_rel * paint.wavelength_nm
    what = f"absorption of paint {paint.name}"
    means = np.array([band_mean(paint.wavelength_nm, photons, band, what) for band in bands])
    if means[-1] <= 0.0:
        raise SimulateError(
            f"paint {paint.name} does not absorb the LED at {bands[-1].centroid_nm:.0f} nm, so it cannot emit under "
            f"the LED; check absorption_rel"
        )
    return np.asarray(means / means[-1])


Floats = NDArray[np.float64]

LARGEST_REFLECTANCE_CHANGE = 0.01
"""Absolute change of a paint's reflectance in a band from which on its chains must be rendered again."""

LARGEST_CENTROID_SHIFT_NM = 10.0
"""Shift of a band from which on its images must be rendered again: the coating changes by 0.4 % per reflection."""

LARGEST_REEMISSION_GAIN = 3.0
"""Growth of a chain, relative to the first of its band, up to which one left out at 0.5 % stays below 1.5 %."""

NEGLIGIBLE_CONVERSION = 1e-3
"""Of a paint's conversion of LED light: less, before and after, is no light that was left out."""

# a product of more multiplications is spread over threads, whose start costs up to 100 ms where cores are shared
_MULTIPLICATIONS_PER_PRODUCT = 200_000


def chain_steps(chain: str) -> tuple[tuple[str, str], ...]:
    """Return the conversions (band in, wall) of a chain: "led>green>red" has ("led", "green"), ("green", "red")."""
    bands = chain.split(">")
    if bands[0] != "led" or not set(bands) <= set(BAND_NAMES) or "led" in bands[1:]:
        raise SimulateError(
            f"'{chain}' is not a chain of fluorescence; a chain must start with 'led', and only 'red' and 'green' may "
            "follow, joined by '>'"
        )
    return tuple(pairwise(bands))


def conversion_gains(before: Mapping[str, Floats], after: Mapping[str, Floats]) -> dict[tuple[str, str], float]:
    """Return by how much each conversion (band in, wall) has grown.

    Parameters
    ----------
    before, after
        Per wall, energy conversion from each of the bands into the wall's own, (3,).

    Raises
    ------
    SimulateError
        When light appears where none was rendered.
    """
    gains = {}
    for wall, old in before.items():
        for k, band in enumerate(BAND_NAMES):
            led = BAND_NAMES.index("led")
            largest = NEGLIGIBLE_CONVERSION * max(old[led], after[wall][led])
            if max(old[k], after[wall][k]) <= largest:
                gains[band, wall] = 1.0 if old[k] else 0.0
                continue
            if old[k] == 0.0 and after[wall][k] > 0.0:
                raise SimulateError(
                    f"the {wall} paint now converts light of the {band} band, but did not when the images were "
                    "rendered; render again"
                )
            gains[band, wall] = float(after[wall][k] / old[k]) if old[k] else 0.0
    return gains


def require_same_reflectance(before: Mapping[str, Floats], after: Mapping[str, Floats]) -> None:
    """Refuse to reuse images after a change of the walls' reflectance: light is reflected on the way.

    Raises
    ------
    SimulateError
        When a reflectance in a band has changed by more than LARGEST_REFLECTANCE_CHANGE.
    """
    for wall, old in before.items():
        change = np.abs(after[wall] - old)
        if change.max() > LARGEST_REFLECTANCE_CHANGE:
            k = int(np.argmax(change))
            raise SimulateError(
                f"the {wall} paint's reflectance in the {BAND_NAMES[k]} band changed from {old[k]:.3f} to "
                f"{after[wall][k]:.3f}, but it may change by at most {LARGEST_REFLECTANCE_CHANGE:g} without a new "
                "render; render again"
            )


def require_near_bands(before: Sequence[SpectralBand], after: Sequence[SpectralBand]) -> None:
    """Refuse to reuse images after a band has moved: the coating's reflectance is that at the band's centroid.

    Raises
    ------
    SimulateError
        When a centroid has moved by more than LARGEST_CENTROID_SHIFT_NM.
    """
    for name, old, new in zip(BAND_NAMES, before, after, strict=True):
        if abs(new.centroid_nm - old.centroid_nm) > LARGEST_CENTROID_SHIFT_NM:
            raise SimulateError(
                f"the {name} band's centroid moved from {old.centroid_nm:.1f} to {new.centroid_nm:.1f} nm, but it may "
                f"move by at most {LARGEST_CENTROID_SHIFT_NM:g} nm without a new render; render again"
            )


def require_small_reemission(chains: Sequence[str], gains: Mapping[tuple[str, str], float]) -> None:
    """Refuse gains that would raise chains which were left out as too weak.

    A chain grows relative to the first of its band by the product of its gains over that chain's gain. Chains of one
    step more than those that were rendered are judged: weaker ones stay weaker.

    Parameters
    ----------
    chains
        Names of the chains that were rendered.
    gains
        Change of each conversion (band in, wall).

    Raises
    ------
    SimulateError
        When a chain that was left out has grown by more than LARGEST_REEMISSION_GAIN.
    """
    walls = [name for name in BAND_NAMES if name != "led"]
    left_out = {f"{chain}>{wall}" for chain in chains if chain != "led" for wall in walls} - set(chains)
    for chain in sorted(left_out):
        first = gains.get(("led", chain.rsplit(">", 1)[-1]), 1.0)
        product = float(np.prod([gains.get(step, 1.0) for step in chain_steps(chain)]))
        if product > LARGEST_REEMISSION_GAIN * first:
            growth = f"{product / first:.1f} times" if first > 0.0 else "beyond all bounds"
            raise SimulateError(
                f"the light of chain {chain}, which was too weak to be rendered, would grow {growth} relative to that "
                f"of its band, but it may grow by at most {LARGEST_REEMISSION_GAIN:g} times without a new render; "
                "render again"
            )


def chain_matrix(chains: Sequence[str], gains: Mapping[tuple[str, str], float] | None = None) -> Floats:
    """Return W (3 bands, chain) with band images = W @ chain images.

    Parameters
    ----------
    chains
        Names of the chains.
    gains
        Change of each conversion (band in, wall) since the chains were rendered; 1 where it is not named.
    """
    matrix = np.zeros((len(BAND_NAMES), len(chains)))
    for column, chain in enumerate(chains):
        row = BAND_NAMES.index(chain.rsplit(">", 1)[-1])
        matrix[row, column] = np.prod([(gains or {}).get(step, 1.0) for step in chain_steps(chain)])
    return matrix


def mix_chains(images: NDArray[np.float32], matrix: Floats) -> NDArray[np.float32]:
    """Return matrix @ image for every pixel, in single precision; images must be finite.

    ``mix(chain images, white_balance[:, None] * (camera_matrix @ chain_matrix(...)))`` is the camera's picture.

    Parameters
    ----------
    images
        (rows, columns, n).
    matrix
        (m, n).

    Returns
    -------
    array
        (rows, columns, m).

    Raises
    ------
    SimulateError
        When the matrix does not have one column per image.
    """
    if matrix.ndim != 2 or images.shape[-1:] != matrix.shape[1:]:
        raise SimulateError(
            f"a matrix of shape {matrix.shape} does not fit images of shape {images.shape}; it must have one column "
            "per image"
        )
    m, n = matrix.shape
    flat, weights = np.ascontiguousarray(images, dtype=np.float32).reshape(-1, n), matrix.T.astype(np.float32)
    mixed = np.empty((len(flat), m), dtype=np.float32)
    # rows of two pixels: the product of such narrow matrices is three times faster when they are twice as wide
    even = len(flat) // 2 * 2
    of_two = np.kron(np.eye(2, dtype=np.float32), weights)
    pairs, mixed_pairs = flat[:even].reshape(-1, 2 * n), mixed[:even].reshape(-1, 2 * m)
    step = max(1, _MULTIPLICATIONS_PER_PRODUCT // of_two.size)
    for first in range(0, len(pairs), step):
        np.matmul(pairs[first : first + step], of_two, out=mixed_pairs[first : first + step])
    mixed[even:] = flat[even:] @ weights
    return mixed.reshape(*images.shape[:-1], m)
