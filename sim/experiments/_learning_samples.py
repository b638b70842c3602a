"""Pictures and their truth for learning: a painted finger rendered with one press, seen with many paints.

One render of the press serves all paints, as light of a chain of fluorescence is proportional to each conversion on its
way. Beside the pictures stand depth and normal of the point of the coat that each pixel sees.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_schemas import SimulateError
from finray_calib.compare import displayed_image
from sim.experiments._paint_choice import PaintDraws
from sim.experiments._painted_finger import PaintedFinger, response_matrix
from sim.experiments._rendered_press import camera_rgb
from sim.optics import (
    PaintOptics,
    PixelMaps,
    PressRender,
    RenderSettings,
    chain_matrix,
    conversion_gains,
    mix_chains,
    paint_bands,
    render_press,
)
from sim.surface_meshes import FingerShape

Floats = NDArray[np.float64]

REST_LEVEL = 0.18
"""Mean of each channel over the coat without contact, as a share of white: middle grey."""

DEPTH_ZERO = 32_768
"""Grey level of depth.png where the coat has not moved; one level is a micrometre, and 0 is no coat."""

_FULL_8_BIT = 255
_NORMAL_LEVELS = 65_534
_MOST_TRIES = 50


@dataclass(frozen=True, slots=True)
class RenderedSample:
    """What one sample holds beside its labels; arrays of (rows, columns, ...).

    Attributes
    ----------
    rest, contact
        Pictures without and with contact, sRGB of 8 bit.
    depth_um
        How far the coat has moved inward plus :data:`DEPTH_ZERO`, 16 bit; 0 where no coat is seen.
    normal
        Outward normal (x, y, z), each from -1 to 1 as 1 to 65535; 0 where no coat is seen.
    gains
        Of red, green and blue: the pictures are sRGB of linear camera RGB times these; 1 of a channel without light.
    clipped_share
        Of the coat's pixels with contact: one channel or more at 255.
    """

    rest: NDArray[np.uint8]
    contact: NDArray[np.uint8]
    depth_um: NDArray[np.uint16]
    normal: NDArray[np.uint16]
    gains: tuple[float, float, float]
    clipped_share: float


@dataclass(frozen=True, slots=True)
class SamplePaints:
    """Paints of one sample.

    Attributes
    ----------
    optics
        Of "red" and "green".
    draws
        Colour -> number of the posterior's draw.
    factors
        Colour -> factor on the emission, where there is no posterior.
    """

    optics: Mapping[str, PaintOptics]
    draws: Mapping[str, int]
    factors: Mapping[str, float]


def sampled_paints(
    finger: PaintedFinger, paints: Mapping[str, PaintDraws], emission_ratio: float, rng: np.random.Generator
) -> SamplePaints:
    """Draw both paints: from the posterior of the emission where there is one, else its emission times a factor.

    The factor is log-uniform from 1 / `emission_ratio` to `emission_ratio`. Draws that return more light than they get
    are drawn again.

    Parameters
    ----------
    finger
        Its light decides what a paint gets.
    paints
        "red" and "green"; a paint with a single draw has no posterior.
    emission_ratio
        See above, at least 1.
    rng
        Of the draw.

    Raises
    ------
    SimulateError
        Fifty draws one after the other return more light than they get.
    """
    reason = ""
    for _ in range(_MOST_TRIES):
        look = _sampled_once(paints, emission_ratio, rng)
        try:
            paint_bands(look.optics["red"], look.optics["green"], finger.design.light)
        except SimulateError as error:
            reason = str(error)
            continue
        return look
    raise SimulateError(f"none of {_MOST_TRIES} draws of the paints conserves energy (last reason: {reason})")


def _sampled_once(paints: Mapping[str, PaintDraws], emission_ratio: float, rng: np.random.Generator) -> SamplePaints:
    """Draw both paints, whatever they return."""
    optics: dict[str, PaintOptics] = {}
    draws: dict[str, int] = {}
    factors: dict[str, float] = {}
    for colour, paint in paints.items():
        if len(paint.emission_per_nm) > 1:
            draws[colour] = int(rng.integers(len(paint.emission_per_nm)))
            emission = paint.emission_per_nm[draws[colour]]
        else:
            factors[colour] = float(emission_ratio ** rng.uniform(-1.0, 1.0))
            emission = factors[colour] * paint.emission_per_nm[0]
        optics[colour] = replace(paint.optics, emission_per_nm=emission)
    return SamplePaints(optics, draws, factors)


def render_samples(
    finger: PaintedFinger,
    paints: Sequence[SamplePaints],
    how: RenderSettings,
    shapes: tuple[FingerShape, FingerShape] | None = None,
) -> tuple[list[RenderedSample], PressRender]:
    """Render a press once, and return what each pair of paints makes of it.

    Parameters
    ----------
    finger
        Design with its press, paints of the render, camera and renderer of a compiled variant.
    paints
        What each sample is painted with.
    how
        Level b, seed and paths.
    shapes
        The finger without and with contact where it was pressed by finite elements.

    Raises
    ------
    SimulateError
        As :func:`sim.optics.render_press` does, or the renderer does not keep chains apart (a scalar variant).
    """
    render = render_press(
        finger.design, finger.paints, finger.renderer, how, shapes=shapes, calibration=finger.calibration
    )
    if not render.chains_apart:
        raise SimulateError(
            "a data set needs a compiled renderer, which stores the light of each paint separately, but the renderer "
            f"is {render.variant}"
        )
    return list(_looks_of(finger, render, paints)), render


def _looks_of(finger: PaintedFinger, render: PressRender, paints: Sequence[SamplePaints]) -> Iterator[RenderedSample]:
    """Yield what each pair of paints makes of a render."""
    depth, normal = encoded_depth(render.contact_maps), encoded_normal(render.contact_maps)
    at_rest = render.no_contact_maps.sees("coat")
    pressed = render.contact_maps.sees("coat")
    before = paint_bands(finger.paints["red"], finger.paints["green"], finger.design.light)
    for look in paints:
        after = paint_bands(look.optics["red"], look.optics["green"], finger.design.light)
        growth = chain_matrix(render.chains, conversion_gains(before.conversion, after.conversion))
        matrix = response_matrix(finger.response, after) @ growth
        rest, contact = (mix_chains(chains, matrix) for chains in (render.no_contact_chains, render.contact_chains))
        mean = rest[at_rest].mean(axis=0, dtype=np.float64)
        gains = np.divide(REST_LEVEL, mean, out=np.ones_like(mean), where=mean > 0.0)
        pictures = [encoded_picture(image, gains) for image in (rest, contact)]
        clipped = float((pictures[1][pressed] == _FULL_8_BIT).any(axis=-1).mean())
        red, green, blue = gains.tolist()
        yield RenderedSample(pictures[0], pictures[1], depth, normal, (red, green, blue), clipped)


def encoded_picture(linear: NDArray[np.float32], gains: Floats) -> NDArray[np.uint8]:
    """Return linear camera RGB times gains as sRGB of 8 bit; what is brighter than white becomes white."""
    share = displayed_image(linear.astype(np.float64) * gains, 1.0, linear=True)
    return np.rint(_FULL_8_BIT * share).astype(np.uint8)


def encoded_depth(maps: PixelMaps) -> NDArray[np.uint16]:
    """Return the depth of the coat in um above :data:`DEPTH_ZERO` as 16 bit, 0 where no coat is seen."""
    levels = np.rint(1e3 * maps.depth_mm) + DEPTH_ZERO
    held = np.clip(levels, 1, np.iinfo(np.uint16).max)
    return np.where(np.isfinite(levels), held, 0).astype(np.uint16)


def encoded_normal(maps: PixelMaps) -> NDArray[np.uint16]:
    """Return the coat's outward normal with -1 to 1 as 1 to 65535, 0 where no coat is seen."""
    levels = np.rint((np.clip(maps.normal, -1.0, 1.0) + 1.0) / 2.0 * _NORMAL_LEVELS) + 1.0
    return np.where(maps.sees("coat")[..., None], levels, 0).astype(np.uint16)


def render_noise_rel(finger: PaintedFinger, render: PressRender) -> float:
    """Return the noise of a pixel of the coat with contact: rms over channels and coat, relative to the mean.

    Each channel that sees light counts relative to its own mean, with the paints of the render.
    """
    matrix, coat = finger.camera_matrix(render.bands), render.contact_maps.sees("coat")
    variance = camera_rgb(render.contact_variance, matrix**2)[coat].mean(axis=0, dtype=np.float64)
    mean = camera_rgb(render.contact_bands, matrix)[coat].mean(axis=0, dtype=np.float64)
    return float(np.sqrt((variance[mean > 0.0] / mean[mean > 0.0] ** 2).mean()))
