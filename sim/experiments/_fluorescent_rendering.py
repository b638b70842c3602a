"""The paper's emitter on the painted walls beside walls that re-emit the light that reaches them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, FluorescentRendering, LevelDifference
from sim.experiments._painted_finger import PaintedFinger
from sim.optics import (
    BAKE_SAMPLES,
    BAND_NAMES,
    FIRST_CHAINS,
    SCALAR_VARIANT,
    TEXELS_ALONG,
    WALLS,
    Level,
    LoadedScene,
    PressRender,
    Progress,
    RenderSettings,
    WallLight,
    Window,
    bake_walls,
    check_paints,
    last_band,
    open_guide,
    open_scene,
    paper_emission,
    render_press,
)
from sim.surface_meshes import rest_shape

Floats = NDArray[np.float64]
LEVELS: tuple[Level, ...] = ("a", "a_inverse_square", "b")
WALL_LIGHT_ANGLES_DEG = (0.0, 30.0, 60.0, 90.0, 120.0)
BLOCK_PX = 10
_BAKE_REPEATS = 4
# a block counts when at least this share of it shows the coat
_LEAST_COVERED = 0.5


@dataclass(frozen=True, slots=True)
class _Walls:
    """Emission of the walls along z: (level, wall, z), of second order (wall, z), at other angles (angle, wall, z)."""

    levels: Floats
    second_order: Floats
    angles: Floats


def study_fluorescent_rendering(
    finger: PaintedFinger, seed: int, samples: int, paints: Mapping[str, str], progress: Progress | None = None
) -> FluorescentRendering:
    """Render a press with the paper's emitter, as printed and inverse square, and with baked walls, and compare.

    All levels use the same random paths, so that what differs is the emitter. The paper's emitter gets its mean
    from the bake: the paper gives no other.

    Parameters
    ----------
    finger
        Design, paints, camera response and renderer.
    seed, samples
        Random seed and paths per pixel, an even number.
    paints
        Colour -> where the paint's optics come from.
    progress
        Called after each level.
    """
    renders = []
    for number, level in enumerate(LEVELS):
        how = RenderSettings(level, seed, samples)
        renders.append(render_press(finger.design, finger.paints, finger.renderer, how, calibration=finger.calibration))
        if progress is not None:
            progress(number + 1, len(LEVELS) + 1, f"level {level}")
    baked, walls = renders[-1], wall_profiles(finger, seed)
    window = Window.around(*(m.coat_mm(finger.design) for m in (baked.no_contact_maps, baked.contact_maps)))
    here = (window.rows, window.columns)
    on_coat = (baked.no_contact_maps.sees("coat") & baked.contact_maps.sees("coat"))[here]
    return FluorescentRendering(
        name=f"{finger.design.name}, fluorescent rendering",
        label=f"rendered, {baked.variant}",
        design=finger.design,
        paints=dict(paints),
        samples=samples,
        notes=finger.coverage_notes(baked.bands),
        levels=LEVELS,
        bands=BAND_NAMES,
        no_contact_bands=np.stack([r.no_contact_bands[here] for r in renders]),
        contact_bands=np.stack([r.contact_bands[here] for r in renders]),
        camera_matrix=finger.camera_matrix(baked.bands),
        on_coat=on_coat,
        block_px=BLOCK_PX,
        differences=tuple(d for r in renders[:-1] for d in _differences(r, baked, here, on_coat)),
        walls=WALLS,
        z_mm=(np.arange(TEXELS_ALONG) + 0.5) / TEXELS_ALONG * finger.design.pad.length_mm,
        wall_radiance_rel=walls.levels,
        second_order_rel=walls.second_order,
        wall_error_rel=_shape_errors(walls.levels),
        second_order_wall_share=dict(
            zip(WALLS, (walls.second_order.mean(axis=1) / walls.levels[-1].mean(axis=1)).tolist(), strict=True)
        ),
        second_order_coat_share=_second_order_on_coat(baked, here, on_coat),
        angles_deg=np.array(WALL_LIGHT_ANGLES_DEG),
        wall_by_angle_rel=walls.angles,
    )


def wall_profiles(finger: PaintedFinger, seed: int) -> _Walls:
    """Return what the walls of the untouched finger emit along z, at all levels and other light angles."""
    light = _baked(finger, finger.design, seed, _BAKE_REPEATS)
    shape = rest_shape(finger.design)
    by_rule = [paper_emission(finger.design, shape, light, level) for level in LEVELS[:-1]]
    further = {chain: values for chain, values in light.items() if chain not in FIRST_CHAINS}
    angles = []
    for angle in WALL_LIGHT_ANGLES_DEG:
        panel = finger.design.light.model_copy(update={"angle_deg": angle})
        turned = finger.design.model_copy(update={"light": panel})
        angles.append(_along(_baked(finger, turned, seed, 1)))
    return _Walls(np.stack([_along(e) for e in (*by_rule, light)]), _along(further), np.stack(angles))


def block_means(values: NDArray[np.floating], on_coat: NDArray[np.bool_], size_px: int) -> tuple[Floats, Floats]:
    """Return means of (rows, columns, n) over square blocks that show mostly coat, (block, n), and their pixels."""
    rows, columns = (length // size_px for length in on_coat.shape)
    trimmed = slice(0, rows * size_px), slice(0, columns * size_px)
    split = (rows, size_px, columns, size_px)
    masked = np.where(on_coat[..., None], values, 0.0)[trimmed].reshape(*split, -1)
    count = on_coat[trimmed].reshape(split).sum(axis=(1, 3))
    kept = count >= _LEAST_COVERED * size_px**2
    pixels = count[kept].astype(np.float64)[:, None]
    return np.asarray(masked.sum(axis=(1, 3), dtype=np.float64)[kept] / pixels), pixels


def _baked(finger: PaintedFinger, design: FingerDesign, seed: int, repeats: int) -> dict[str, Floats]:
    """Return the mean of several bakes of the untouched finger."""
    shape, bands = rest_shape(design), check_paints(design, finger.paints)
    scene = open_scene(design, shape, bands, finger.renderer)
    samples = BAKE_SAMPLES[finger.renderer.variant() == SCALAR_VARIANT]
    guide = open_guide(scene, design, shape, finger.renderer)
    bakes = bake_walls(LoadedScene(scene, design, shape, bands, finger.renderer), "b", seed, samples, repeats, guide)
    chains = dict.fromkeys(chain for bake in bakes for chain in bake)
    return {c: np.sum([b[c] for b in bakes if c in b], axis=0) / repeats for c in chains}


def _along(light: WallLight) -> Floats:
    """Return emission along z, means over the height and sums over chains, (wall, z)."""
    dark = np.zeros(TEXELS_ALONG)
    return np.stack([sum((v.mean(axis=1) for c, v in light.items() if last_band(c) == w), dark) for w in WALLS])


def _shape_errors(levels: Floats) -> Floats:
    """Return how far each profile is from the last one at equal means, (level, wall)."""
    relative = levels / levels.mean(axis=2, keepdims=True)
    off = np.linalg.norm(relative - relative[-1], axis=2)
    return np.asarray(off / np.linalg.norm(relative[-1], axis=1))


def _differences(
    render: PressRender, baked: PressRender, here: tuple[slice, slice], on_coat: NDArray[np.bool_]
) -> list[LevelDifference]:
    """Return how far a level is from the baked one, by state and band."""
    blocks = [
        {
            "no contact": block_means(r.no_contact_bands[here], on_coat, BLOCK_PX)[0],
            "contact": block_means(r.contact_bands[here], on_coat, BLOCK_PX)[0],
        }
        for r in (render, baked)
    ]
    shown, truth = blocks
    variance = {
        "no contact": _block_variance(baked.no_contact_variance[here], on_coat),
        "contact": _block_variance(baked.contact_variance[here], on_coat),
    }
    ratio = shown["no contact"].mean(axis=0) / truth["no contact"].mean(axis=0)
    return [
        LevelDifference(
            level=render.level,
            state=state,
            band=band,
            mean_ratio=float(ratio[k]),
            block_error_rel=_over(shown[state][:, k] - truth[state][:, k], truth[state][:, k]),
            shape_error_rel=_over(shown[state][:, k] / ratio[k] - truth[state][:, k], truth[state][:, k]),
            noise_rel=_over(np.sqrt(variance[state][:, k]), truth[state][:, k]),
        )
        for state in ("no contact", "contact")
        for k, band in enumerate(BAND_NAMES)
    ]


def _block_variance(variance: NDArray[np.float32], on_coat: NDArray[np.bool_]) -> Floats:
    """Return the variance of block means of independent pixels."""
    mean, pixels = block_means(variance, on_coat, BLOCK_PX)
    return mean / pixels


def _over(difference: Floats, truth: Floats) -> float:
    """Return the norm of a difference over the norm of the truth."""
    return float(np.linalg.norm(difference) / np.linalg.norm(truth))


def _second_order_on_coat(
    baked: PressRender, here: tuple[slice, slice], on_coat: NDArray[np.bool_]
) -> dict[str, float]:
    """Return by band which share of the coat's light has been converted more than once."""
    of_chain = dict(zip(baked.chains, baked.no_contact_chains[here][on_coat].mean(axis=0).tolist(), strict=True))
    total = {band: sum(v for c, v in of_chain.items() if last_band(c) == band) for band in WALLS}
    further = {b: sum(v for c, v in of_chain.items() if last_band(c) == b and c not in FIRST_CHAINS) for b in WALLS}
    return {band: further[band] / total[band] for band in WALLS}
