"""Everything the optics tells of one press, from band images and spectra to raw counts and a capture to compare with.

Band images, camera image, geometry per pixel, spectra, noise, timings. How sure the colours are belongs to it: the
camera's response at the LED is known poorly. A digital twin is a capture of a finger that the simulation does not
know.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, IndenterPose, SimulatedPress, SimulateError, TactileCapture
from rigs.simulated.sensor import Sensor, mosaic
from sim.experiments._painted_finger import FingerScene, PaintedFinger
from sim.experiments._rendered_press import Rendering, camera_rgb, pixels_of_coat, press_with_render
from sim.optics import (
    BAND_NAMES,
    PaintBands,
    PixelMaps,
    PressRender,
    Progress,
    RenderSettings,
    mix_chains,
    render_press,
)
from sim.surface_meshes import FingerShape

Floats = NDArray[np.float64]
Image = NDArray[np.float32]
EXPOSURE_S = 0.05
# The brightest half per cent of the no-contact image comes to this share of full scale, as an operator would set it.
BRIGHT_PERCENTILE, BRIGHT_SHARE = 99.5, 0.7
_EXPOSURE_BLOCK_PX = 4


@dataclass(frozen=True, slots=True)
class BandImages:
    """Band images (rows, columns, 3) of a render, and the variance of the one without contact."""

    contact: Image
    no_contact: Image
    no_contact_variance: Image


def press_design(press: SimulatedPress) -> FingerDesign:
    """Return the design of a rendered press.

    Raises
    ------
    SimulateError
        When it holds none.
    """
    if press.design is None:
        raise SimulateError(
            f"{press.name} has no finger design ({press.label}), so its camera is unknown; give a press that 'finray "
            "simulate render' wrote"
        )
    return press.design


def electrons_per_s(no_contact: NDArray[np.floating], sensor: Sensor, exposure_s: float) -> float:
    """Return electrons per second and unit of radiance: the exposure is set by the brightest half per cent.

    Of means over a few pixels: single pixels of a render are bright by noise, which no operator would see.
    """
    rows, columns = (_EXPOSURE_BLOCK_PX * (side // _EXPOSURE_BLOCK_PX) for side in no_contact.shape[:2])
    blocks = no_contact[:rows, :columns].reshape(
        rows // _EXPOSURE_BLOCK_PX, _EXPOSURE_BLOCK_PX, columns // _EXPOSURE_BLOCK_PX, _EXPOSURE_BLOCK_PX, -1
    )
    bright = np.percentile(blocks.mean(axis=(1, 3)), BRIGHT_PERCENTILE)
    if not bright > 0.0:
        raise SimulateError("the image without contact is black, so no exposure can be set; check the light panel")
    return float(BRIGHT_SHARE * sensor.full_scale_dn * sensor.gain_e_per_dn / exposure_s / bright)


def simulated_capture(press: SimulatedPress, seed: int) -> TactileCapture:
    """Return a rendered press as its camera would deliver it: raw Bayer counts with black level and noise.

    The render's own noise is part of all three images, as if it were texture: contact and no contact share most of it
    (common random numbers), so that a repeat with noise of its own would tell a comparison of noise that is not there.

    Parameters
    ----------
    press
        Rendered press in the camera's linear RGB, one value per Bayer cell.
    seed
        Of shot noise, read noise and the sensor's fixed pattern.

    Raises
    ------
    SimulateError
        When the press is no render, or its image without contact is black.
    """
    design = press_design(press)
    if press.encoding != "linear":
        raise SimulateError(
            f"{press.name} contains encoded values, but only a rendered press in linear light can be captured"
        )
    contact, no_contact, matrix = press.contact_bands, press.no_contact_bands, press.camera_matrix
    if contact is None or no_contact is None or matrix is None:
        raise SimulateError(
            f"{press.name} contains no band images, but only a rendered press, which has them, can be captured"
        )
    return camera_capture(
        BandImages(contact, no_contact, np.zeros_like(no_contact)),
        matrix,
        design,
        seed,
        light_angle_deg=press.light_angle_deg,
        name=f"{press.name}, simulated capture",
        source=f"simulated: {press.label}",
    )


def camera_capture(
    bands: BandImages,
    camera_matrix: Floats,
    design: FingerDesign,
    seed: int,
    *,
    light_angle_deg: float | None,
    name: str,
    source: str,
    led_drift_rel: float = 0.0,
) -> TactileCapture:
    """Expose contact, no contact and a repeat of no contact of a render.

    Parameters
    ----------
    bands
        The render.
    camera_matrix
        From bands to the camera's linear RGB, (3, 3).
    design
        Camera and indenter.
    seed
        Of everything that is random.
    light_angle_deg, name, source
        As the capture records them.
    led_drift_rel
        Standard deviation of the LED's level from image to image.

    Raises
    ------
    SimulateError
        When the image without contact is black.
    """
    sensor, rng = tactile_sensor(design, seed), np.random.default_rng([seed, 1])
    repeated = repeat_render(bands.no_contact, bands.no_contact_variance, rng)
    no_contact, contact, repeat = (
        camera_rgb(image, camera_matrix).astype(np.float64) for image in (bands.no_contact, bands.contact, repeated)
    )
    scale = electrons_per_s(no_contact, sensor, EXPOSURE_S)

    def expose(rgb: Floats) -> NDArray[np.uint16]:
        drift = 1.0 + led_drift_rel * rng.standard_normal()
        # where a wall is dark, its smoothed light may lie below zero by less than its noise; a sensor gets none there
        return sensor.expose(np.maximum(mosaic(drift * rgb * scale), 0.0), EXPOSURE_S, rng)[..., None]

    indenter = design.indenter
    return TactileCapture(
        name=name,
        contact=expose(contact),
        no_contact=expose(no_contact),
        repeat_no_contact=expose(repeat),
        layout="Bayer RGGB",
        encoding="linear",
        bit_depth=design.camera.bit_depth,
        black_level_dn=sensor.black_level_dn,
        exposure_s=EXPOSURE_S,
        light_angle_deg=light_angle_deg,
        indenter=IndenterPose(
            shape=indenter.pose_shape,
            radius_mm=None if indenter.is_packaged else indenter.radius_mm,
            depth_mm=indenter.depth_mm,
            position_mm=indenter.position_mm,
        ),
        contact_circle=None,
        mm_per_px=None,
        source=source,
    )


def repeat_render(bands: Image, variance: Image, rng: np.random.Generator) -> Image:
    r"""Return band images as a second, independent render would give them, without the cost of one.

    .. math:: b' = b \pm \sqrt{2 v} \text{ with equal chance where } 2 v \le b^2, \text{ else }
              b' = b + 2 v / b \text{ with chance } b^2 / (b^2 + 2 v), \text{ or } 0

    Both have the mean b and the variance 2 v, and light is never negative: cut off at zero instead, dark pixels would
    be too bright on average, and the floor between two images with them.
    Pixels are independent of each other here; the share of the variance that a whole bake has in common
    (:class:`sim.optics.PressRender`) is therefore too small in means over an area.

    Parameters
    ----------
    bands, variance
        Mean of the independent passes of a render and its variance, shape (rows, columns, bands).
    rng
        Generator of the chances.
    """
    # Two independent renders of variance v differ by 2 v, and the first one stands as it is. Exposing it twice would
    # hide the render's noise from the difference of both images, which is the floor that a comparison is judged by.
    mean, spread2 = bands.astype(np.float64), 2.0 * variance.astype(np.float64)
    even = spread2 <= mean**2
    chance_up = np.where(even, 0.5, mean**2 / np.where(even, 1.0, mean**2 + spread2))
    up = rng.random(bands.shape) < chance_up
    step = np.sqrt(spread2)
    # a dark pixel has no noise of its own: both halves were dark
    above = np.where(even, mean + step, mean + spread2 / np.where(mean > 0.0, mean, np.inf))
    below = np.where(even, mean - step, 0.0)
    return np.where(up, above, below).astype(np.float32)


def tactile_sensor(design: FingerDesign, seed: int) -> Sensor:
    """Return the sensor of the tactile camera; noise figures are those of a small Raspberry Pi sensor, assumed."""
    return Sensor(
        bit_depth=design.camera.bit_depth,
        black_level_dn=16.0,
        gain_e_per_dn=5.0,
        read_noise_e=4.0,
        dark_current_e_per_s=5.0,
        full_well_e=5.0 * 2**design.camera.bit_depth,
        prnu_rel=0.005,
        dsnu_e=1.0,
        seed=seed,
    )


# Two no-contact images of a real sensor differ by 0.8 to 2.6 % of full scale; blue LEDs drift by a fraction of it.
LED_DRIFT_REL = 0.005
LARGEST_ANGLE_DEG = 180.0
LIGHT_ERROR_DEG = 3.0


def as_built_design(design: FingerDesign) -> FingerDesign:
    """Return the finger as it was really built: the light 3 deg aside, the coating rougher and more diffuse.

    Roughness and diffuse share grow by a tenth, at most to 1; an angle beyond 180 deg is the same one less 360 deg.
    """
    angle_deg = design.light.angle_deg + LIGHT_ERROR_DEG
    built = design.model_dump()
    built["name"] = f"{design.name}, as built"
    built["light"]["angle_deg"] = angle_deg if angle_deg <= LARGEST_ANGLE_DEG else angle_deg - 360.0
    for field in ("roughness_alpha", "diffuse_share"):
        built["coating"][field] = min(1.0, 1.1 * built["coating"][field])
    # model_copy would skip the bounds of the fields
    return FingerDesign.model_validate(built)


def capture_twin(
    finger: PaintedFinger,
    nominal_angle_deg: float,
    seed: int,
    samples_per_pixel: int,
    progress: Progress | None = None,
    shapes: tuple[FingerShape, FingerShape] | None = None,
    contact_samples_per_pixel: int | None = None,
) -> TactileCapture:
    """Render a finger and pass it through the sensor: contact, no contact, and a repeat of no contact.

    Parameters
    ----------
    finger
        The hidden, true finger (its paints are the true ones).
    nominal_angle_deg
        Light angle that the person at the rig believes in; it is what the capture records.
    seed, samples_per_pixel
        Seed of render and sensor noise, paths per pixel.
    shapes
        The finger without and with contact; by default the design's indenter is pressed in analytically.
    contact_samples_per_pixel
        Paths per pixel around the contact, see :func:`sim.optics.render_press`.
    """
    render = render_press(
        finger.design,
        finger.paints,
        finger.renderer,
        RenderSettings("b", seed, samples_per_pixel, contact_samples_per_pixel, common_random_numbers=False),
        progress=progress,
        shapes=shapes,
        calibration=finger.calibration,
    )
    return camera_capture(
        BandImages(render.contact_bands, render.no_contact_bands, render.no_contact_variance),
        finger.camera_matrix(render.bands),
        finger.design,
        seed,
        light_angle_deg=nominal_angle_deg,
        name="digital twin",
        source="digital twin: a render with the hidden true paints and a different light angle, coating and seed",
        led_drift_rel=LED_DRIFT_REL,
    )


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
            [f"{100 * v:.0f} %" for v in values] for values in (self.led_share, self.sd_rel, self.ratio_sd_rel)
        )
        return (
            f"camera response to the LED: uncertain by {100 * self.response_uncertainty_rel:.0f} %. LED light makes up "
            f"{', '.join(shares)} of red, green and blue, so they are uncertain by {', '.join(sds)}, the ratio red / "
            f"blue by {ratios[0]}, and green / blue by {ratios[1]}"
        )


def colour_spread(
    press: SimulatedPress, seed: int, draws: int = 400, coat: NDArray[np.bool_] | None = None
) -> ColourSpread:
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
    coat
        Which pixels see the coat, (row, column); by default those with a distance from the contact.

    Raises
    ------
    SimulateError
        When the press holds no bands or no design, or without `coat` has no contact.
    """
    design = press_design(press)
    bands, matrix = press.contact_bands, press.camera_matrix
    if bands is None or matrix is None or "led" not in press.bands:
        raise SimulateError(
            f"{press.name} contains no band images, but only a rendered press, which has them, records the origin of "
            "its colours"
        )
    mean = bands[pixels_of_coat(press) if coat is None else coat].astype(np.float64).mean(axis=0)
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
        Per state, standard deviation of the bands from render noise, by up to 16 passes of it.
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
        colours=colour_spread(press, seed, coat=render.contact_maps.sees("coat")),
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
