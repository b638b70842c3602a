"""How the contact image changes with the indenter's depth and place: central differences of renders."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.simulate import PoseResponse
from sim.experiments.painted_finger import PaintedFinger
from sim.optics.render import Progress, render_press
from sim.optics.state_render import RenderLevel
from sim.surface_meshes.finger_shape import FingerShape, pressed_shape

POSE_STEPS_MM = {"depth_mm": 0.1, "position_mm": 0.3}
"""Steps to either side: near the uncertainty of a pose set by hand, so that a curved response is averaged over it."""

ShapeAt = Callable[[FingerDesign], FingerShape]


def pose_response(
    finger: PaintedFinger,
    level: RenderLevel,
    seed: int,
    samples_per_pixel: int,
    contact_samples_per_pixel: int | None,
    chains: tuple[str, ...],
    shape_at: ShapeAt = pressed_shape,
    progress: Progress | None = None,
) -> PoseResponse:
    """Render the press a little deeper and flatter, nearer and farther, with the random numbers of the press itself.

    Parameters
    ----------
    finger, level, seed, samples_per_pixel, contact_samples_per_pixel
        As of the press.
    chains
        Layers of the press, in its order.
    shape_at
        Returns the pressed finger of a design whose indenter has another pose; by default the analytic press.
    progress
        Called after each render.
    """
    derivatives, differences = [], []
    for (_, step_mm), designs in zip(POSE_STEPS_MM.items(), moved_designs(finger.design), strict=True):
        shapes = (shape_at(designs[0]), shape_at(designs[1]))
        render = render_press(
            finger.design, finger.paints, finger.renderer, level, seed, samples_per_pixel, progress, shapes,
            finger.calibration, contact_samples_per_pixel,
        )  # fmt: skip
        span_mm = np.float32(2.0 * step_mm)
        both = (
            (render.contact_chains, render.no_contact_chains),
            (render.contact_half_difference, render.no_contact_half_difference),
        )
        derivative, difference = (_ordered((more - less) / span_mm, render.chains, chains) for more, less in both)
        derivatives.append(derivative)
        differences.append(difference)
    return PoseResponse(
        names=("depth_mm", "position_mm"),
        steps_mm=tuple(POSE_STEPS_MM.values()),
        derivative=np.array(derivatives),
        half_difference=np.array(differences),
    )


def moved_designs(design: FingerDesign) -> tuple[tuple[FingerDesign, FingerDesign], ...]:
    """Return the design with its indenter a step before and after its place, for each part of the pose.

    Raises
    ------
    SimulateError
        A step leads out of the pad: the press is too shallow, or too near an end.
    """
    found = []
    for field, step_mm in POSE_STEPS_MM.items():
        pair = []
        for sign in (-1.0, 1.0):
            values = design.model_dump()
            values["indenter"][field] += sign * step_mm
            try:
                pair.append(FingerDesign.model_validate(values))
            except ValidationError:
                raise SimulateError(
                    f"the response to the pose moves indenter.{field} by {step_mm:g} mm to either side, and "
                    f"{values['indenter'][field]:g} mm is not possible: press deeper, or farther from the end of the "
                    "pad, or leave out --pose-response"
                ) from None
        found.append((pair[0], pair[1]))
    return tuple(found)


def _ordered(images: NDArray[np.float32], own: tuple[str, ...], chains: tuple[str, ...]) -> NDArray[np.float32]:
    """Return images (row, column, chain) in the order of the press; a chain that is too weak here is dark."""
    dark = np.zeros(images.shape[:2], dtype=np.float32)
    return np.stack([images[..., own.index(c)] if c in own else dark for c in chains], axis=-1)
