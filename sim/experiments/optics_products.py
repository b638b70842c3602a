"""Everything the optics tells of one press: band images, camera image, geometry per pixel, spectra, noise, timings."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import TactileCapture
from data_schemas.simulate import SimulatedPress
from sim.experiments.colour_spread import ColourSpread, colour_spread
from sim.experiments.tactile_camera import simulated_capture
from sim.optics.chain_images import mix
from sim.optics.paint_bands import BAND_NAMES, PaintBands
from sim.optics.pixel_maps import PixelMaps
from sim.optics.render import PressRender

Floats = NDArray[np.float64]
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
        Names of their channels: chains of fluorescence, see :mod:`sim.optics.chain_images`.
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


def optics_products(
    render: PressRender,
    press: SimulatedPress,
    seed: int,
) -> OpticsProducts:
    """Return the products of a press that has been rendered.

    Parameters
    ----------
    render, press
        The render and its record.
    seed
        Of the sensor's noise.
    """
    wavelength_nm = spectral_grid_nm(render.bands)
    return OpticsProducts(
        press=press,
        capture=simulated_capture(press, seed),
        basis={"contact": render.contact_chains, "no_contact": render.no_contact_chains},
        basis_names=render.chains,
        band_sd={"contact": np.sqrt(render.contact_variance), "no_contact": np.sqrt(render.no_contact_variance)},
        maps=render.contact_maps,
        wavelength_nm=wavelength_nm,
        spectral=mix(render.contact_bands, band_densities_per_nm(render.bands, wavelength_nm)),
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
