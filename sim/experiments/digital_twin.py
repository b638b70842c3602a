"""A capture of a finger that the simulation does not know: a render through the sensor model."""

import numpy as np
from numpy.typing import NDArray

from data_schemas.capture import IndenterPose, TactileCapture
from data_schemas.design import FingerDesign
from rigs.simulated.sensor import Sensor, mosaic
from sim.experiments.painted_finger import PaintedFinger
from sim.experiments.press import camera_rgb
from sim.optics.render import Progress, render_press

Floats = NDArray[np.float64]
EXPOSURE_S = 0.05
# The brightest half per cent of the no-contact image comes to this share of full scale, as an operator would set it.
BRIGHT_PERCENTILE, BRIGHT_SHARE = 99.5, 0.7
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
    """
    render = render_press(
        finger.design,
        finger.paints,
        finger.renderer,
        "b",
        seed,
        samples_per_pixel,
        progress,
        calibration=finger.calibration,
    )
    matrix = finger.camera_matrix(render.bands)
    rng = np.random.default_rng([seed, 1])
    repeat_bands = repeat_render(render.no_contact_bands, render.no_contact_variance, rng)
    no_contact, contact, repeat = (
        camera_rgb(bands, matrix).astype(np.float64)
        for bands in (render.no_contact_bands, render.contact_bands, repeat_bands)
    )
    sensor = tactile_sensor(finger.design, seed)
    bright = np.percentile(no_contact, BRIGHT_PERCENTILE)
    to_electrons = BRIGHT_SHARE * sensor.full_scale_dn * sensor.gain_e_per_dn / EXPOSURE_S / bright

    def expose(rgb: Floats, led_level_rel: float) -> NDArray[np.uint16]:
        counts = sensor.expose(mosaic(rgb * to_electrons * led_level_rel), EXPOSURE_S, rng)
        return counts[..., None]

    indenter = finger.design.indenter
    drift = 1.0 + LED_DRIFT_REL * rng.standard_normal()
    return TactileCapture(
        name="digital twin",
        contact=expose(contact, 1.0),
        no_contact=expose(no_contact, 1.0),
        repeat_no_contact=expose(repeat, drift),
        layout="Bayer RGGB",
        encoding="linear",
        bit_depth=finger.design.camera.bit_depth,
        black_level_dn=sensor.black_level_dn,
        exposure_s=EXPOSURE_S,
        light_angle_deg=nominal_angle_deg,
        indenter=IndenterPose(
            shape=indenter.shape,
            radius_mm=indenter.radius_mm,
            depth_mm=indenter.depth_mm,
            position_mm=indenter.position_mm,
        ),
        contact_circle=None,
        mm_per_px=None,
        source="digital twin: a render with the hidden true paints, another light angle, coating and seed",
    )


def repeat_render(
    bands: NDArray[np.float32], variance: NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.float32]:
    r"""Return band images as a second, independent render would give them, without the cost of one.

    .. math:: b' = \max(0, b + \sqrt{2}\, s \sqrt{v}), \quad s = \pm 1 \text{ with equal chance}

    Pixels are independent of each other here; the share of the variance that a whole bake has in common
    (:class:`sim.optics.render.PressRender`) is therefore too small in means over an area.

    Parameters
    ----------
    bands, variance
        Mean of two independent halves of a render and its variance, shape (rows, columns, bands).
    rng
        Generator of the signs.
    """
    # Two independent renders of variance v differ by 2 v, and the first one stands as it is. Exposing it twice would
    # hide the render's noise from the difference of both images, which is the floor that a comparison is judged by.
    signs = 1.0 - 2.0 * rng.integers(0, 2, size=bands.shape)
    repeated: Floats = np.maximum(bands + np.sqrt(2.0 * variance) * signs, 0.0)
    return repeated.astype(np.float32)


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
