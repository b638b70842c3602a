"""Render one press of a painted finger as a record."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from data_schemas.curves import SpectralCurve
from data_schemas.errors import SimulateError
from data_schemas.fit import PaintCalibration
from data_schemas.simulate import PoseResponse, RenderedLight, SimulatedPress
from sim.experiments.known_inputs import known_inputs
from sim.experiments.painted_finger import COLOURS, CameraResponse, PaintedFinger, coverage_notes
from sim.experiments.pose_response import moved_designs, pose_response
from sim.optics.chain_images import chain_matrix
from sim.optics.paint_bands import BAND_NAMES, PaintBands
from sim.optics.render import PressRender, Progress, render_press
from sim.optics.state_render import RenderLevel
from sim.surface_meshes.finger_shape import FingerShape

Floats = NDArray[np.float64]
SHAPE_NOTE = "shape of the finger: "
CAMERA_NOTE = "camera response: "


def simulate_press(
    finger: PaintedFinger,
    level: RenderLevel,
    seed: int,
    samples_per_pixel: int,
    paint_sha256: Mapping[str, str],
    progress: Progress | None = None,
    shapes: tuple[FingerShape, FingerShape] | None = None,
    calibrations: Mapping[str, PaintCalibration] | None = None,
    with_pose_response: bool = False,
    contact_samples_per_pixel: int | None = None,
) -> SimulatedPress:
    """Render the contact and no-contact image of a finger in its camera's linear RGB.

    Parameters
    ----------
    finger
        Design, paints, camera response and renderer.
    level
        "b": walls re-emit the blue light that reaches them; "a": the paper's distance-textured emitter; "c": the
        reference, fluorescence traced along each path.
    seed, samples_per_pixel
        Random seed and paths per pixel.
    paint_sha256
        Colour -> SHA-256 of the paint calibration the optics came from.
    shapes
        The finger without and with contact; by default the design's indenter is pressed in analytically.
    calibrations
        Fits that the paints came from: with them the press holds draws of what its colours rest on.
    contact_samples_per_pixel
        Paths per pixel around the contact, see :func:`sim.optics.render.render_press`.
    with_pose_response
        Also render how the contact image changes with the indenter's depth and position (analytic press only).

    Raises
    ------
    SimulateError
        A response to the pose is asked for of given shapes.
    """
    if with_pose_response and shapes is not None:
        raise SimulateError(
            "the response to the pose is rendered for the analytic press only; leave it out, or leave the surfaces out"
        )
    if with_pose_response:
        moved_designs(finger.design)  # what cannot be moved is told before anything is rendered
    render = render_press(
        finger.design,
        finger.paints,
        finger.renderer,
        level,
        seed,
        samples_per_pixel,
        progress,
        shapes,
        finger.calibration,
        contact_samples_per_pixel,
    )
    pose = None
    if with_pose_response:
        pose = pose_response(
            finger, level, seed, samples_per_pixel, contact_samples_per_pixel, render.chains, progress=progress
        )
    return press_record(finger, render, paint_sha256, calibrations or {}, pose)


def press_record(
    finger: PaintedFinger,
    render: PressRender,
    paint_sha256: Mapping[str, str],
    calibrations: Mapping[str, PaintCalibration],
    pose: PoseResponse | None = None,
) -> SimulatedPress:
    """Return the record of a render of `finger`; its paints and their fits as in :func:`simulate_press`."""
    matrix = finger.camera_matrix(render.bands)
    return SimulatedPress(
        name=f"{finger.design.name}, press of {finger.design.indenter.depth_mm:g} mm",
        label=render.label,
        method="rendered",
        encoding="linear",
        no_contact=camera_rgb(render.no_contact_bands, matrix),
        contact=camera_rgb(render.contact_bands, matrix),
        distance=render.contact_maps.contact_distance.astype(np.float32),
        variance=camera_rgb(render.contact_variance, matrix**2),
        no_contact_bands=render.no_contact_bands,
        contact_bands=render.contact_bands,
        contact_bands_variance=render.contact_variance,
        bands=BAND_NAMES,
        no_contact_chains=render.no_contact_chains if render.chains_apart else None,
        contact_chains=render.contact_chains if render.chains_apart else None,
        chains=render.chains if render.chains_apart else (),
        no_contact_half_difference=render.no_contact_half_difference,
        contact_half_difference=render.contact_half_difference,
        layer_matrix=matrix @ chain_matrix(render.chains),
        known_inputs=known_inputs(finger, calibrations, paint_sha256, render.chains),
        pose_response=pose,
        rendered_light=light_record(render.bands, finger.response),
        camera_matrix=matrix,
        light_angle_deg=finger.design.light.angle_deg,
        design=finger.design,
        paints=dict(paint_sha256),
        notes=(*colour_notes(finger.response, render.bands), f"{SHAPE_NOTE}{render.contact_label}"),
    )


def camera_rgb(bands: NDArray[np.float32], matrix: Floats) -> NDArray[np.float32]:
    """Return camera RGB (rows, columns, 3) = C @ bands."""
    rgb: Floats = np.einsum("cb,ijb->ijc", matrix, bands.astype(np.float64))
    return rgb.astype(np.float32)


def light_record(
    bands: PaintBands, response: CameraResponse, white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> RenderedLight:
    """Return what the colours of a render rest on, as it is stored."""
    red, green, led = (
        SpectralCurve(name=f"{name} band", wavelength_nm=b.wavelength_nm, values=b.density_per_nm, source="rendered")
        for name, b in zip(BAND_NAMES, bands.bands, strict=True)
    )
    return RenderedLight(
        walls=COLOURS,
        bands=(red, green, led),
        reflectance=np.array([bands.reflectance[wall] for wall in COLOURS]),
        conversion=np.array([bands.conversion[wall] for wall in COLOURS]),
        response=response,
        white_balance=white_balance,
    )


def colour_notes(response: CameraResponse, bands: PaintBands) -> tuple[str, ...]:
    """Say what the colours of a press rest on."""
    cut = [
        f"{colour} paint: {share:.1%} of the fitted emission lay below the LED's upper edge and was cut"
        for colour, share in bands.cut_share.items()
        if share > 0.001
    ]
    return (f"{CAMERA_NOTE}{response[0].source}", *coverage_notes(response, bands), *cut)
