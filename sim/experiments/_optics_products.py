"""Everything the optics tells of one press: band images, camera image, geometry per pixel, spectra, noise, timings.

How sure the colours are belongs to it: the camera's response at the LED is known poorly.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulatedPress, SimulateError, TactileCapture
from sim.experiments._painted_finger import FingerScene
from sim.experiments._rendered_press import Rendering, press_with_render
from sim.experiments._tactile_camera import press_design, simulated_capture
from sim.optics import BAND_NAMES, PaintBands, PixelMaps, PressRender, Progress, mix_chains

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ColourSpread:
    """How far the camera's unknown response at the LED moves the colours of the pad.

    Attributes
    ----------
    response_uncertainty_rel
        Standard uncertainty of each channel's response in the LED's band, independent of each other.
    led_share
        Share of the LED's band in red, green and blue over the coat, (3,).
    sd_rel
        Relative standard deviation of the mean red, green and blue over the coat, (3,).
    ratio_sd_rel
        Relative standard deviation of red / blue and green / blue, which is the picture's colour, (2,).
    """

    response_uncertainty_rel: float
    led_share: Floats
    sd_rel: Floats
    ratio_sd_rel: Floats

    def __str__(self) -> str:
        """Say it in one line."""
        shares, sds, ratios = (
            [f"{v:.0%}" for v in values] for values in (self.led_share, self.sd_rel, self.ratio_sd_rel)
        )
        return (
            f"camera response at the LED uncertain by {self.response_uncertainty_rel:.0%}: red, "
            f"green, blue hold {', '.join(shares)} LED light and are uncertain by {', '.join(sds)}; red / blue by "
            f"{ratios[0]}, green / blue by {ratios[1]}"
        )


def colour_spread(press: SimulatedPress, seed: int, draws: int = 400) -> ColourSpread:
    """Return the spread of the colours from draws of the camera matrix; nothing is rendered.

    The response of each channel in the LED's band is multiplied by a log-normal factor of mean 1 and of the
    standard deviation camera.response_at_led_uncertainty_rel of the design.

    Parameters
    ----------
    press
        A rendered press, with its bands and camera matrix.
    seed
        Of the draws.
    draws
        Number of draws; with 400 a standard deviation is known to 4 %.

    Raises
    ------
    SimulateError
        When the press holds no bands or no design.
    """
    design = press_design(press)
    bands, matrix = press.contact_bands, press.camera_matrix
    if bands is None or matrix is None or "led" not in press.bands:
        raise SimulateError(
            f"{press.name} holds no band images: only a rendered press records what its colours rest on"
        )
    mean = bands[np.isfinite(press.distance)].astype(np.float64).mean(axis=0)
    led, uncertainty = press.bands.index("led"), design.camera.response_at_led_uncertainty_rel
    sigma = np.sqrt(np.log1p(uncertainty**2))
    factors = np.exp(sigma * np.random.default_rng([seed, 2]).standard_normal((draws, 3)) - 0.5 * sigma**2)
    from_led, total = matrix[:, led] * mean[led], matrix @ mean
    colours = total + (factors - 1.0) * from_led
    ratios = colours[:, :2] / colours[:, 2:]
    return ColourSpread(
        response_uncertainty_rel=uncertainty,
        led_share=from_led / total,
        sd_rel=colours.std(axis=0, ddof=1) / total,
        ratio_sd_rel=ratios.std(axis=0, ddof=1) / ratios.mean(axis=0),
    )


Image = NDArray[np.float32]

SPECTRAL_STEP_NM = 20.0
"""Distance of the wavelengths of the wavelength-resolved images; bands are two to four times as wide."""


@dataclass(frozen=True, slots=True)
class OpticsProducts:
    """Products of one rendered press; images are (rows, columns, channel).

    Attributes
    ----------
    press
        The record: linear camera RGB, bands, distance from the contact.
    capture
        The press as raw counts of its camera.
    basis
        Per state ("contact", "no_contact") the images that all others are weighted sums of.
    basis_names
        Names of their channels: chains of fluorescence, see :mod:`sim.optics._paint_bands`.
    band_sd
        Per state, standard deviation of the bands from render noise, by two independent halves of it.
    maps
        Geometry of the pressed finger in each pixel.
    wavelength_nm, spectral
        Spectral radiance of the pressed finger, relative per nm, rebuilt from the bands: exact as far as each band
        keeps its spectrum.
    colours
        What the camera's unknown response at the LED does to the colours.
    timings_s
        Seconds of each step.
    """

    press: SimulatedPress
    capture: TactileCapture
    basis: Mapping[str, Image]
    basis_names: tuple[str, ...]
    band_sd: Mapping[str, Image]
    maps: PixelMaps
    wavelength_nm: Floats
    spectral: Image
    colours: ColourSpread
    timings_s: Mapping[str, float]


def simulate_images(
    scene: FingerScene, how: Rendering, paint_sha256: Mapping[str, str], progress: Progress | None = None
) -> OpticsProducts:
    """Render a press and all images of it; the record says what the camera's response at the LED does to its colours.

    Parameters and errors are those of :func:`sim.experiments.simulate_press`.
    """
    press, render = press_with_render(scene, how, paint_sha256, progress)
    products = optics_products(render, press, how.seed)
    told = press.model_copy(update={"notes": (*press.notes, str(products.colours))})
    return replace(products, press=told)


def optics_products(render: PressRender, press: SimulatedPress, seed: int) -> OpticsProducts:
    """Return the products of a press that has been rendered; the seed is that of the sensor's noise."""
    wavelength_nm = spectral_grid_nm(render.bands)
    return OpticsProducts(
        press=press,
        capture=simulated_capture(press, seed),
        basis={"contact": render.contact_chains, "no_contact": render.no_contact_chains},
        basis_names=render.chains,
        band_sd={"contact": np.sqrt(render.contact_variance), "no_contact": np.sqrt(render.no_contact_variance)},
        maps=render.contact_maps,
        wavelength_nm=wavelength_nm,
        spectral=mix_chains(render.contact_bands, band_densities_per_nm(render.bands, wavelength_nm)),
        colours=colour_spread(press, seed),
        timings_s=render.timings_s,
    )


def spectral_grid_nm(bands: PaintBands) -> Floats:
    """Return wavelengths through all bands, the LED's peak among them."""
    led = bands.bands[BAND_NAMES.index("led")]
    peak_nm = float(led.wavelength_nm[np.argmax(led.density_per_nm)])
    first, last = led.wavelength_nm[0], max(band.wavelength_nm[-1] for band in bands.bands)
    below, above = np.floor((peak_nm - first) / SPECTRAL_STEP_NM), np.floor((last - peak_nm) / SPECTRAL_STEP_NM)
    return np.asarray(peak_nm + SPECTRAL_STEP_NM * np.arange(-below, above + 1.0))


def band_densities_per_nm(bands: PaintBands, wavelength_nm: Floats) -> Floats:
    """Return the spectral density of each band, (wavelength, band); zero outside the band."""
    return np.stack(
        [np.interp(wavelength_nm, b.wavelength_nm, b.density_per_nm, left=0.0, right=0.0) for b in bands.bands], axis=-1
    )
