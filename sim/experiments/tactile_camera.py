"""What the camera makes of a rendered press: raw counts, a capture to compare with, and how sure its colours are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import IndenterPose, TactileCapture
from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.simulate import SimulatedPress
from rigs.simulated.sensor import Sensor, mosaic
from sim.experiments.digital_twin import (
    BRIGHT_PERCENTILE,
    BRIGHT_SHARE,
    EXPOSURE_S,
    repeat_render,
    tactile_sensor,
)

Floats = NDArray[np.float64]
_EXPOSURE_BLOCK_PX = 4


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
    design = _design(press)
    bands, matrix = press.contact_bands, press.camera_matrix
    if bands is None or matrix is None or "led" not in press.bands:
        raise SimulateError(f"{press.name} holds no band images: only a rendered press tells what its colours rest on")
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


def mosaic_of_pixels(rgb: Floats) -> Floats:
    """Return what an RGGB sensor sees of an image that has one RGB value for each of its pixels, (2h, 2w, 3).

    Each pixel keeps the channel of its own filter: the truth that :func:`rigs.simulated.sensor.mosaic` approximates
    by one value per cell of 2 x 2 pixels.

    Raises
    ------
    SimulateError
        When the image has an odd side.
    """
    if rgb.shape[0] % 2 or rgb.shape[1] % 2:
        raise SimulateError(
            f"a Bayer sensor has an even number of rows and columns, got {rgb.shape[0]} x {rgb.shape[1]}"
        )
    raw = np.array(rgb[..., 1], dtype=np.float64)
    raw[0::2, 0::2], raw[1::2, 1::2] = rgb[0::2, 0::2, 0], rgb[1::2, 1::2, 2]
    return raw


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
        raise SimulateError("the image without contact is black: no exposure can be set; check the light panel")
    return float(BRIGHT_SHARE * sensor.full_scale_dn * sensor.gain_e_per_dn / exposure_s / bright)


def simulated_capture(press: SimulatedPress, seed: int, exposure_s: float = EXPOSURE_S) -> TactileCapture:
    """Return a rendered press as its camera would deliver it: raw Bayer counts with black level and noise.

    The repeat of the image without contact has its own noise of sensor and render.

    Parameters
    ----------
    press
        Rendered press in the camera's linear RGB, one value per Bayer cell.
    seed
        Of shot noise, read noise and the sensor's fixed pattern.
    exposure_s
        Exposure time; the light is scaled so that the image without contact is well exposed.

    Raises
    ------
    SimulateError
        When the press is no render, or its image without contact is black.
    """
    design = _design(press)
    if press.encoding != "linear":
        raise SimulateError(f"{press.name} holds encoded values, not light: only a rendered press can be captured")
    sensor, rng = tactile_sensor(design, seed), np.random.default_rng([seed, 1])
    scale = electrons_per_s(press.no_contact, sensor, exposure_s)
    variance = np.zeros_like(press.contact) if press.variance is None else press.variance
    repeat = repeat_render(press.no_contact, variance, rng)

    def expose(rgb: NDArray[np.float32]) -> NDArray[np.uint16]:
        return sensor.expose(mosaic(np.maximum(rgb, 0.0) * scale), exposure_s, rng)[..., None]

    indenter = design.indenter
    return TactileCapture(
        name=f"{press.name}, simulated capture",
        contact=expose(press.contact),
        no_contact=expose(press.no_contact),
        repeat_no_contact=expose(repeat),
        layout="Bayer RGGB",
        encoding="linear",
        bit_depth=design.camera.bit_depth,
        black_level_dn=sensor.black_level_dn,
        exposure_s=exposure_s,
        light_angle_deg=press.light_angle_deg,
        indenter=IndenterPose(
            shape=indenter.shape,
            radius_mm=indenter.radius_mm,
            depth_mm=indenter.depth_mm,
            position_mm=indenter.position_mm,
        ),
        contact_circle=None,
        mm_per_px=None,
        source=f"simulated: {press.label}",
    )


def _design(press: SimulatedPress) -> FingerDesign:
    """Return the design of a rendered press."""
    if press.design is None:
        raise SimulateError(f"{press.name} has no finger design ({press.label}): only a rendered press has a camera")
    return press.design
