"""The paper's second panel at the tip: how much more evenly the coat is lit."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.illumination import TwoLights, Uniformity
from data_schemas.optical_design import LightPanel
from sim.experiments.painted_finger import PaintedFinger
from sim.optics.finger_view import Window
from sim.optics.paint_bands import BAND_NAMES
from sim.optics.render import PressRender, Progress, render_press

Floats = NDArray[np.float64]

ONE, TWO = "one panel, at the base", "two panels, at base and tip"
CAMERA_CHANNELS = ("R", "G", "B")

_CELL_MM = 2.5
# a cell of the coat counts when the camera sees it in this many pixels
_LEAST_PIXELS = 4
# the finger narrows: at the tip a panel finds room nearer to the gel
_TIP_DEPTH_FACTOR = 0.4
# beside a panel the light is glaring; this much of the length at each end is left out of the middle
_ENDS_SHARE = 0.15


def light_at_the_tip(design: FingerDesign) -> LightPanel:
    """Return the design's second panel, or the panel at the base mirrored to the tip, nearer to the gel."""
    if design.second_light is not None:
        return design.second_light
    base = design.light
    x, y, z = base.position_mm
    angle_deg = 180.0 - base.angle_deg if base.angle_deg >= 0.0 else -180.0 - base.angle_deg
    place = (x, _TIP_DEPTH_FACTOR * y, design.pad.length_mm - z)
    return LightPanel.model_validate({**base.model_dump(), "position_mm": place, "angle_deg": angle_deg})


def study_two_lights(
    finger: PaintedFinger, seed: int, samples: int, paints: Mapping[str, str], progress: Progress | None = None
) -> TwoLights:
    """Render a press with one panel at the base, and with a second one at the tip; measure how even the light is.

    Variation and extremes are over the coat by area, not by pixel, and over those parts of it that the camera sees
    with either light.

    Parameters
    ----------
    finger
        Design, paints, camera response and renderer; without a second panel the first is mirrored to the tip.
    seed, samples
        Random seed and paths per pixel, an even number.
    paints
        Colour -> where the paint's optics come from.
    progress
        Called after each render.
    """
    tip = light_at_the_tip(finger.design)
    one = finger.design.model_copy(update={"second_light": None})
    both = type(one).model_validate({**one.model_dump(), "second_light": tip.model_dump()})
    renders = []
    for number, design in enumerate((one, both)):
        renders.append(render_press(design, finger.paints, finger.renderer, "b", seed, samples,
                                    calibration=finger.calibration))  # fmt: skip
        if progress is not None:
            progress(number + 1, 2, (ONE, TWO)[number])
    matrix = finger.camera_matrix(renders[0].bands)
    places = [r.no_contact_maps.coat_mm(one) for r in renders]
    window = Window.around(*places, *(r.contact_maps.coat_mm(one) for r in renders))
    here = (window.rows, window.columns)
    seen = np.isfinite(places[0][..., 0]) & np.isfinite(places[1][..., 0])
    cells = [_cells(one, places[0], seen, r, matrix) for r in renders]
    along = [_mean(mean, (1,)).T for mean, _ in cells]
    return TwoLights(
        name=f"{finger.design.name}, two lights",
        label=renders[0].label,
        design=one,
        paints=dict(paints),
        samples=samples,
        notes=finger.coverage_notes(renders[0].bands),
        lights=(ONE, TWO),
        bands=BAND_NAMES,
        channels=(*BAND_NAMES, *CAMERA_CHANNELS),
        no_contact_bands=np.stack([r.no_contact_bands[here] for r in renders]),
        contact_bands=np.stack([r.contact_bands[here] for r in renders]),
        camera_matrix=matrix,
        on_coat=seen[here],
        tip_light_position_mm=tip.position_mm,
        tip_light_angle_deg=tip.angle_deg,
        cell_mm=_CELL_MM,
        uniformity=tuple(u for name, c in zip((ONE, TWO), cells, strict=True) for u in evenness(name, *c)),
        z_mm=(np.arange(along[0].shape[1], dtype=np.float64) + 0.5) * _CELL_MM,
        along_rel=np.stack(along) / np.nanmean(along[0], axis=1)[:, None],
    )


def evenness(lights: str, mean: Floats, variance: Floats) -> list[Uniformity]:
    """Return the measures of evenness of each channel.

    Parameters
    ----------
    lights
        Name of the lights.
    mean, variance
        Mean light of equal cells of the coat and its variance from render noise, (along, across, channel); NaN where
        the camera sees nothing. Channels are the bands, then R, G, B.
    """
    along = _mean(mean, (1,))
    level, noise2 = _mean(mean, (0, 1)), _mean(variance, (0, 1))
    ends = round(_ENDS_SHARE * len(mean))
    everywhere, middle = _variation(mean, variance), _variation(mean[ends:-ends], variance[ends:-ends])
    return [
        Uniformity(
            lights=lights,
            channel=channel,
            variation_rel=float(everywhere[k]),
            middle_variation_rel=float(middle[k]),
            min_to_max_ratio=float(np.nanmin(along[:, k]) / np.nanmax(along[:, k])),
            noise_rel=float(np.sqrt(noise2[k]) / level[k]),
        )
        for k, channel in enumerate((*BAND_NAMES, *CAMERA_CHANNELS))
    ]


def _cells(
    design: FingerDesign, place_mm: Floats, seen: NDArray[np.bool_], render: PressRender, matrix: Floats
) -> tuple[Floats, Floats]:
    """Return means over square cells of the coat and their noise variance, (along, across, channel); NaN unseen."""
    pad = design.pad
    shape = round(pad.length_mm / _CELL_MM), round(pad.width_mm / _CELL_MM)
    z, x = place_mm[seen].T
    i = np.minimum((z / pad.length_mm * shape[0]).astype(int), shape[0] - 1)
    j = np.minimum(((x / pad.width_mm + 0.5) * shape[1]).astype(int), shape[1] - 1)
    to_channels = np.concatenate([np.eye(len(BAND_NAMES)), matrix])
    values, variance = (
        render.no_contact_bands[seen] @ to_channels.T,
        render.no_contact_variance[seen] @ to_channels.T**2,
    )
    sums, noise, count = np.zeros((*shape, len(to_channels))), np.zeros((*shape, len(to_channels))), np.zeros(shape)
    np.add.at(sums, (i, j), values)
    np.add.at(noise, (i, j), variance)
    np.add.at(count, (i, j), 1.0)
    pixels = np.where(count >= _LEAST_PIXELS, count, np.nan)[..., None]
    return sums / pixels, noise / pixels**2


def _variation(mean: Floats, variance: Floats) -> Floats:
    """Return the standard deviation over cells, noise taken out, over their mean, per channel."""
    level = _mean(mean, (0, 1))
    spread2 = _mean((mean - level) ** 2, (0, 1)) - _mean(variance, (0, 1))
    return np.asarray(np.sqrt(np.maximum(spread2, 0.0)) / level)


def _mean(cells: Floats, axes: tuple[int, ...]) -> Floats:
    """Return the mean over cells that are seen, NaN where none is."""
    count = np.isfinite(cells).sum(axis=axes)
    return np.where(count > 0, np.nansum(cells, axis=axes) / np.maximum(count, 1), np.nan)
