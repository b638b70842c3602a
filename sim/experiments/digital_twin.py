"""A capture of a finger that the simulation does not know: a render through the sensor model."""

from data_schemas.capture import TactileCapture
from data_schemas.design import FingerDesign
from sim.experiments.painted_finger import PaintedFinger
from sim.experiments.tactile_camera import BandImages, camera_capture
from sim.optics.render import Progress, render_press
from sim.surface_meshes.finger_shape import FingerShape

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
        Paths per pixel around the contact, see :func:`sim.optics.render.render_press`.
    """
    render = render_press(
        finger.design,
        finger.paints,
        finger.renderer,
        "b",
        seed,
        samples_per_pixel,
        progress,
        shapes,
        finger.calibration,
        contact_samples_per_pixel,
        common_random_numbers=False,
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
