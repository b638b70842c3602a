"""What the camera makes of a rendered press: raw counts, and a capture to compare with.

A digital twin is such a capture of a finger that the simulation does not know.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, IndenterPose, SimulatedPress, SimulateError, TactileCapture
from rigs.simulated.sensor import Sensor, mosaic
from sim.experiments._painted_finger import PaintedFinger
from sim.experiments._rendered_press import camera_rgb
from sim.optics import Progress, RenderSettings, render_press
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
        raise SimulateError(f"{press.name} has no finger design ({press.label}): only a rendered press has a camera")
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
        raise SimulateError("the image without contact is black: no exposure can be set; check the light panel")
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
        raise SimulateError(f"{press.name} holds encoded values, not light: only a rendered press can be captured")
    contact, no_contact, matrix = press.contact_bands, press.no_contact_bands, press.camera_matrix
    if contact is None or no_contact is None or matrix is None:
        raise SimulateError(f"{press.name} holds no band images: only a rendered press can be captured")
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
            shape=indenter.shape,
            radius_mm=indenter.radius_mm,
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
        Mean of two independent halves of a render and its variance, shape (rows, columns, bands).
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


def hidden_design(design: FingerDesign, light_error_deg: float = 3.0) -> FingerDesign:
    """Return the finger as it was really built: the light a little off, the coating rougher and more diffuse.

    Roughness and diffuse share grow by a tenth, at most to 1; an angle beyond 180 deg is the same one less 360 deg.
    """
    angle_deg = design.light.angle_deg + light_error_deg
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
        source="digital twin: a render with the hidden true paints, another light angle, coating and seed",
        led_drift_rel=LED_DRIFT_REL,
    )
