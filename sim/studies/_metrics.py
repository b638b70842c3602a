"""What a study measures on a press: light and colours of the coat, how the touch shows, and force.

The 95 % interval of a number of an image comes from independent renders of the point: it knows their noise (that of the
baked walls included) and nothing of materials, geometry or camera, which are the design's.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from data_schemas import FingerDesign, PressMechanics, SimulateError, StudyMetric
from finray_calib.compare import srgb_to_lab
from sim.experiments import coat_cells
from sim.optics import BAND_NAMES, PressRender

Floats = NDArray[np.float64]

CELL_MM = 2.5
"""Side of the cells that the coat's light is averaged over."""

HALO = 2.0
"""The touch is looked for up to this many half-widths of the contact, as comparisons do."""

_MIDDLE_GREY = 0.18
_MEANINGS: dict[str, tuple[str, str]] = {
    "seen_area_mm2": ("mm2", "area of the coat that the camera sees through the mirror, without contact"),
    "brightness_rel": ("radiance of the panel", "mean over the seen coat of the camera's channels, without contact"),
    "variation_rel": ("1", "standard deviation of brightness over the seen coat, over its mean: 0 is even light"),
    "red_share": ("1", "share of the seen coat where light of the red paint leads, each relative to its own mean"),
    "green_share": ("1", "share of the seen coat where light of the green paint leads, each relative to its own mean"),
    "blue_share": ("1", "share of the seen coat where light of the LED leads, each relative to its own mean"),
    "vividness": (
        "CIELAB chroma",
        "mean chroma of the seen coat, exposed to middle grey and white-balanced so that the coat is grey on the mean",
    ),
    "touch_rel": ("1", "change of brightness by the touch, rms over contact and halo, over the brightness there"),
    "force_n": (
        "N",
        "force of the indenter along the pad's normal at the end of the push, unvalidated; the limits are the mesh's",
    ),
    "push_mm": ("mm", "push that was reached"),
}


@dataclass(frozen=True, slots=True)
class _Seen:
    """What one render shows: light of the coat's cells, and brightness of each pixel of contact and halo.

    Attributes
    ----------
    light
        Of the three bands in the camera, (cell, 3).
    rgb
        Camera RGB without contact, (cell, 3).
    before, after
        Brightness of the pixels near the contact, without it and with it.
    """

    light: Floats
    rgb: Floats
    before: Floats
    after: Floats


def image_metrics(design: FingerDesign, renders: Sequence[PressRender], matrix: Floats) -> tuple[StudyMetric, ...]:
    r"""Return the metrics of a point's repeated renders.

    Squares, of the spread over the coat and of the change by the touch, are products of two independent renders, whose
    noise averages out. Limits by the jackknife over the renders,

    .. math:: u^2 = \frac{R - 1}{R} \sum_i (\theta_{(i)} - \bar\theta)^2,

    with Student's t of R - 1 degrees of freedom.

    Parameters
    ----------
    design
        The finger.
    renders
        R independent renders of it, at least three.
    matrix
        Camera RGB from bands, (3, 3).
    """
    seen = [_seen(design, render, matrix) for render in renders]
    count, whole = len(seen), _metrics(seen)
    without = [_metrics([*seen[:i], *seen[i + 1 :]]) for i in range(count)]
    t95 = float(student_t.ppf(0.975, count - 1))
    area_mm2 = len(seen[0].rgb) * _cell_area_mm2(design)
    found = [_metric("seen_area_mm2", area_mm2, None)]
    for name, value in whole.items():
        others = np.array([values[name] for values in without])
        spread = np.sqrt((count - 1) / count * ((others - others.mean()) ** 2).sum())
        found.append(_metric(name, value, t95 * float(spread)))
    return tuple(found)


def mechanics_metrics(mechanics: PressMechanics) -> tuple[StudyMetric, ...]:
    """Return force and push of a press by finite elements, the force with what its mesh leaves open."""
    force = _metric("force_n", float(mechanics.force_n[-1, 1]), None)
    if mechanics.mesh_excess_rel is not None:
        low = force.value / (1.0 + mechanics.mesh_excess_rel)
        force = force.model_copy(update={"low95": low, "high95": force.value})
    return force, _metric("push_mm", float(mechanics.depth_mm[-1]), None)


def _seen(design: FingerDesign, render: PressRender, matrix: Floats) -> _Seen:
    """Return what one render shows."""
    place = render.no_contact_maps.coat_mm(design)
    cells, _ = coat_cells(design, place, np.isfinite(place[..., 0]), render, matrix, CELL_MM)
    lit = cells[np.isfinite(cells[..., 0])]
    if not len(lit):
        raise SimulateError(
            f"no {CELL_MM:g} mm of the coat is seen by four pixels: raise camera.width_px and camera.height_px "
            f"({design.camera.width_px} x {design.camera.height_px}), or turn the camera to the coat"
        )
    bands, weights = len(BAND_NAMES), matrix.mean(axis=0)
    near = render.contact_maps.contact_distance <= HALO
    return _Seen(
        light=lit[:, :bands] * matrix.sum(axis=0),
        rgb=lit[:, bands:],
        before=render.no_contact_bands[near] @ weights,
        after=render.contact_bands[near] @ weights,
    )


def _cell_area_mm2(design: FingerDesign) -> float:
    """Return the area of one cell of the coat."""
    along, across = round(design.pad.length_mm / CELL_MM), round(design.pad.width_mm / CELL_MM)
    return design.pad.length_mm * design.pad.width_mm / (along * across)


def _metrics(seen: Sequence[_Seen]) -> dict[str, float]:
    """Return the metrics of at least two independent renders."""
    rgb = np.mean([one.rgb for one in seen], axis=0)
    light = np.mean([one.light for one in seen], axis=0)
    leads = np.argmax(light / light.mean(axis=0), axis=-1)
    brightness = np.array([one.rgb.mean(axis=-1) for one in seen])
    level = float(brightness.mean())
    found = {
        "brightness_rel": level,
        "variation_rel": _root_of_products(brightness - brightness.mean(axis=1, keepdims=True)) / level,
        **{f"{name}_share": float(np.mean(leads == k)) for k, name in enumerate(("red", "green", "blue"))},
        "vividness": vividness(rgb),
    }
    if seen[0].before.size:
        changes = np.array([one.after - one.before for one in seen])
        found["touch_rel"] = _root_of_products(changes) / float(np.mean([one.before for one in seen]))
    return found


def _root_of_products(values: Floats) -> float:
    """Return the root of the mean product of two different rows, (row, n); zero where noise makes it negative."""
    count, n = values.shape
    product = ((values.sum(axis=0) ** 2).sum() - (values**2).sum()) / (count * (count - 1) * n)
    return float(np.sqrt(max(product, 0.0)))


def vividness(rgb: Floats) -> float:
    r"""Return the mean CIELAB chroma of linear camera RGB, balanced to grey and exposed to middle grey.

    .. math:: C^* = \sqrt{a^{*2} + b^{*2}}, \quad \mathrm{RGB}_i' = 0.18\, \mathrm{RGB}_i / \overline{\mathrm{RGB}}_i

    The camera's channels stand for those of sRGB, as its own colour matrix is not known.

    Parameters
    ----------
    rgb
        Linear values, (n, 3), each channel with a positive mean.
    """
    balanced = np.clip(_MIDDLE_GREY * rgb / rgb.mean(axis=0), 0.0, 1.0)
    encoded = np.where(balanced <= 0.0031308, 12.92 * balanced, 1.055 * balanced ** (1.0 / 2.4) - 0.055)
    lab = srgb_to_lab(encoded[None])[0]
    return float(np.hypot(lab[:, 1], lab[:, 2]).mean())


def _metric(name: str, value: float, reach95: float | None) -> StudyMetric:
    """Return a number with its words, and with limits where they are known."""
    unit, meaning = _MEANINGS[name]
    low, high = (None, None) if reach95 is None else (value - reach95, value + reach95)
    return StudyMetric(name=name, value=value, low95=low, high95=high, unit=unit, meaning=meaning)
