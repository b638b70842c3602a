"""Synthetic twins: a capture of something that a simulation of three layers knows but for its inputs."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import IndenterPose, KnownInputs, PoseResponse, SimulatedPress, TactileCapture

Floats = NDArray[np.float64]
SHAPE = (64, 80)
FULL_SCALE_DN, BLACK_DN, DN_PER_UNIT = 4095, 64.0, 900.0
MATRIX = np.array([[0.9, 0.1, 0.05], [0.2, 0.8, 0.1], [0.02, 0.1, 1.2]])
PAINT_SD, CAMERA_SD, DEPTH_SD_MM, DRIFT_SD = 0.05, 0.1, 0.05, 0.005
NAMES = ("red paint", "green paint", "camera response")
DRAWS = 1000


@dataclass(frozen=True, slots=True)
class Twin:
    """A press, a capture of it, and both sides without noise: layers and matrix of the render, DN of the capture."""

    press: SimulatedPress
    capture: TactileCapture
    true_matrix: Floats
    true_contact: Floats
    true_no_contact: Floats
    clean_contact: Floats
    clean_no_contact: Floats


def distance_map() -> Floats:
    """Distance from a strip across the middle, in half-widths of 8 px."""
    rows = np.arange(SHAPE[0], dtype=np.float64)[:, None]
    return np.broadcast_to(np.abs(rows - 31.5) / 8.0, SHAPE).copy()


def layers(depth: float) -> tuple[Floats, Floats]:
    """Return the layers (H, W, 3) without and with a press of a relative depth."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]] / 64.0
    base = np.stack([1.0 + 0.3 * columns, 0.8 + 0.2 * rows, 1.2 - 0.2 * columns], axis=-1)
    bump = depth * np.exp(-0.5 * distance_map() ** 2)[..., None] * np.array([0.5, -0.3, 0.35])
    return base, base * (1.0 - bump)


def twin(rng: np.random.Generator, render_noise: float = 0.1, model_error: float = 0.05) -> Twin:
    """Return a twin whose inputs differ from the nominal ones by draws of their uncertainty."""
    factors = _factors(np.random.default_rng(1))
    draw = rng.integers(DRAWS, size=len(NAMES))
    true_matrix = MATRIX * np.prod([factors[i, d] for i, d in enumerate(draw)], axis=0)
    move_mm = DEPTH_SD_MM * rng.standard_normal()
    base, pressed = layers(1.0)
    slope = (layers(1.5)[1] - layers(0.5)[1]) / 1.0
    true_pressed = pressed + move_mm * slope
    wrong = 1.0 + model_error * np.sin(np.arange(SHAPE[1]) / 6.0 + rng.uniform(0.0, 6.0))[None, :, None]
    exposure = DN_PER_UNIT * rng.uniform(0.8, 1.2)
    clean_contact, clean_no_contact = (
        exposure * (image * (wrong if i == 0 else 1.0)) @ true_matrix.T for i, image in enumerate((true_pressed, base))
    )
    press = _press(rng, base, pressed, slope, render_noise, factors)
    capture = _capture(rng, clean_contact, clean_no_contact)
    return Twin(press, capture, true_matrix, true_pressed, base, clean_contact, clean_no_contact)


def _factors(rng: np.random.Generator) -> NDArray[np.float32]:
    """Return factors (3 inputs, draw, 3, 3 layers)."""
    paints = [np.ones((DRAWS, 3, 3)) for _ in range(2)]
    for layer, factor in enumerate(paints):
        factor[..., layer] = np.exp(PAINT_SD * rng.standard_normal((DRAWS, 1)))
    camera = np.exp(CAMERA_SD * rng.standard_normal((DRAWS, 3, 1))) * np.ones(3)
    return np.array([*paints, camera], dtype=np.float32)


def _noisy(image: Floats, sd_rel: float, rng: np.random.Generator) -> Floats:
    """Return an image with skewed noise, as of few paths."""
    shape = 1.0 / sd_rel**2
    return image * rng.gamma(shape, 1.0 / shape, image.shape)


def _press(
    rng: np.random.Generator, base: Floats, pressed: Floats, slope: Floats, noise: float, factors: NDArray[np.float32]
) -> SimulatedPress:
    """Return the nominal press as two noisy halves."""
    halves = [[_noisy(image, noise, rng) for image in (base, pressed)] for _ in range(2)]
    means = [((a + b) / 2.0).astype(np.float32) for a, b in zip(*halves, strict=True)]
    differences = [((a - b) / 2.0).astype(np.float32) for a, b in zip(*halves, strict=True)]
    pose_noise = 0.5 * noise * rng.standard_normal((2, *slope.shape))
    return SimulatedPress(
        name="press",
        label="synthetic",
        method="rendered",
        encoding="linear",
        no_contact=(means[0] @ MATRIX.T).astype(np.float32),
        contact=(means[1] @ MATRIX.T).astype(np.float32),
        distance=distance_map().astype(np.float32),
        variance=None,
        no_contact_bands=means[0],
        contact_bands=means[1],
        bands=("red", "green", "led"),
        no_contact_half_difference=differences[0],
        contact_half_difference=differences[1],
        layer_matrix=MATRIX,
        known_inputs=KnownInputs(
            names=NAMES, keys=NAMES, evaluations=("A", "A", "B"), sources=("fit", "fit", "assumed"), factors=factors
        ),
        pose_response=PoseResponse(
            names=("depth_mm",),
            steps_mm=(0.1,),
            derivative=(slope + pose_noise.mean(axis=0))[None].astype(np.float32),
            half_difference=((pose_noise[0] - pose_noise[1]) / 2.0)[None].astype(np.float32),
        ),
        light_angle_deg=50.0,
        design=None,
    )


def _capture(rng: np.random.Generator, contact: Floats, no_contact: Floats) -> TactileCapture:
    """Return the capture: shot and read noise, and a light that drifts from image to image."""

    def expose(image: Floats) -> NDArray[np.uint16]:
        drifted = image * (1.0 + DRIFT_SD * rng.standard_normal())
        counts = rng.normal(drifted, np.sqrt(4.0 + 0.2 * drifted)) + BLACK_DN
        return np.clip(np.rint(counts), 0, FULL_SCALE_DN).astype(np.uint16)

    return TactileCapture(
        name=f"twin {rng.integers(1_000_000)}",
        contact=expose(contact),
        no_contact=expose(no_contact),
        repeat_no_contact=expose(no_contact),
        layout="RGB",
        encoding="linear",
        bit_depth=12,
        black_level_dn=BLACK_DN,
        exposure_s=0.05,
        led_current_ma=20.0,
        light_angle_deg=50.0,
        indenter=IndenterPose(
            shape="cylinder", radius_mm=10.0, depth_mm=2.0, position_mm=35.0, depth_uncertainty_mm=DEPTH_SD_MM
        ),
        contact_circle=None,
        mm_per_px=0.1,
        source="synthetic",
    )


def without_noise(twin_: Twin) -> Twin:
    """Return the twin with its press rendered without noise."""
    press = twin_.press
    dark = np.zeros_like(press.contact_half_difference)
    return replace(
        twin_, press=press.model_copy(update={"contact_half_difference": dark, "no_contact_half_difference": dark})
    )
