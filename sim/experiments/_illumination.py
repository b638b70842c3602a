"""The paper's light: one panel over its angle, a second panel at the tip, and its emitter on the painted walls.

The brightness beside the indenter over the angle of the blue light, with the mirror and without; how much more evenly
the coat is lit by two panels; and the paper's emitter beside walls that re-emit the light that reaches them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student_t

from data_schemas import (
    BrightestAngle,
    FingerDesign,
    FluorescentRendering,
    LevelDifference,
    LightAngleIntensity,
    LightPanel,
    SimulateError,
    TwoLights,
    Uniformity,
)
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
    ProbePaths,
    Progress,
    RenderSettings,
    WallLight,
    Window,
    bake_walls,
    check_paints,
    inner_face,
    last_band,
    open_guide,
    open_scene,
    panel_frame,
    paper_emission,
    refract_through,
    render_press,
    sweep_light_angle,
)
from sim.surface_meshes import contact_half_width_mm, rest_shape

Floats = NDArray[np.float64]

# from a panel that faces away from the pad to one that faces the base: with the mirror curves are still high at 0
ANGLES_DEG: Floats = np.arange(-30.0, 121.0, 15.0)
ANGLES_DEG.flags.writeable = False
PRINTED_ANGLE_DEG = 30.0
OTHER_DEPTHS_MM = (4.0, 10.0, 20.0)
MIRRORS = ("with mirror", "without mirror")
PROBES = ("edge of the contact towards the base", "edge of the contact towards the tip")

# the light of one small Lambertian panel is a cosine cut off at zero, and the study adds up many of these
_HARMONICS = 2
_FINE_STEP_DEG = 0.1
_CONFIDENCE = 0.95
# a curve that leaves the sum of cosines by more, relative to its top, is no such sum: say so
_LARGEST_MISFIT_REL = 0.03


def study_light_angle(
    finger: PaintedFinger,
    seed: int,
    samples: int,
    paints: Mapping[str, str],
    progress: Progress | None = None,
    repeats: int = 5,
) -> LightAngleIntensity:
    """Measure the brightness of the coat at both edges of the contact over the light angle, with and without mirror.

    Parameters
    ----------
    finger
        Design, paints, camera response and renderer; its own light angle is replaced.
    seed, samples
        Random seed and paths per probe and repeat, shared by all angles.
    paints
        Colour -> where the paint's optics come from.
    progress
        Called after each repeat.
    repeats
        Independent repeats; within one, all angles share their random numbers. Limits are Student's, of repeats - 1
        degrees of freedom.

    Raises
    ------
    SimulateError
        With fewer than two repeats, which have no spread.
    """
    if repeats < 2:
        raise SimulateError(f"limits of a maximum need at least 2 independent repeats, got {repeats}")
    design = finger.design
    points = edge_points_mm(design)
    bare = design.model_copy(update={"mirror": design.mirror.model_copy(update={"reflectance": 0.0})})
    paths = ProbePaths(samples, repeats, seed)
    sweeps = []
    for number, one in enumerate((design, bare)):

        def told(done: int, of: int, what: str, before: int = number, case: str = MIRRORS[number]) -> None:
            if progress is not None:
                progress(before * of + done, len(MIRRORS) * of, f"{case}, {what}")

        sweeps.append(sweep_light_angle(one, finger.paints, finger.renderer, ANGLES_DEG, paths, points, told))
    radiance = np.stack([sweep.radiance_rel for sweep in sweeps])
    probes = sweeps[0].probe_points_mm
    depths = {f"{mm:g}": tuple(elevation_deg(_at_depth(design, mm), probes).tolist()) for mm in OTHER_DEPTHS_MM}
    return LightAngleIntensity(
        name=f"{design.name}, light angle",
        label=sweeps[0].label,
        design=design,
        paints=dict(paints),
        samples=samples,
        notes=(*finger.coverage_notes(sweeps[0].bands), *doubts(radiance)),
        mirrors=MIRRORS,
        probes=PROBES,
        bands=BAND_NAMES,
        probe_points_mm=probes,
        led_depth_mm=-design.light.position_mm[1],
        angles_deg=ANGLES_DEG,
        radiance_rel=radiance,
        elevation_deg=elevation_deg(design, probes),
        elevation_by_depth_deg=depths,
        printed_angle_deg=PRINTED_ANGLE_DEG,
        maxima=_maxima(radiance),
    )


def edge_points_mm(design: FingerDesign) -> Floats:
    """Return the points (x, z) on the pad's middle line where the contact ends, towards the base and the tip."""
    half_width = float(contact_half_width_mm(design))
    z = design.indenter.position_mm + np.array([-half_width, half_width])
    return np.column_stack([np.zeros(2), z])


def elevation_deg(design: FingerDesign, points_mm: Floats) -> Floats:
    """Return the angle above the pad plane at which light leaves the panel's centre to reach points in the gel.

    A small panel whose normal has the angle a lights a point directly by cos(a - elevation), at most zero beyond
    90 deg. Valid for the undeformed flat inner face.
    """
    pad, face = design.pad, inner_face(design, rest_shape(design))
    x, y, z = (np.ascontiguousarray(v) for v in points_mm.T)
    centre = tuple(np.full(x.shape, v) for v in panel_frame(design.light).centre_mm)
    foot = x / pad.width_mm + 0.5, z / pad.length_mm
    path = refract_through(face.map.evaluate, (x, y, z), foot, (centre[0], centre[1], centre[2]), face)
    return np.asarray(np.degrees(np.arctan2(-path.to_panel[1], -path.to_panel[2])))


def brightest_deg(angles_deg: Floats, values: Floats) -> float:
    r"""Return where the smooth curve through values, a0 + sum of a_k cos k x + b_k sin k x for k = 1, 2, is highest.

    Only angles between the first and the last one are searched.
    """
    fine = _fine_deg(angles_deg)
    return float(fine[np.argmax(_cosines(fine) @ _smooth(angles_deg, values))])


def top_and_loss(angles_deg: Floats, curves: Floats) -> tuple[Floats, Floats, Floats]:
    """Return estimate and 95 % limits of (brightest angle in deg, loss at the printed angle), (2,) each.

    Both are read off the smooth curve through the mean of all repeats, never off single angles, whose noise would
    choose the largest. Limits by the jackknife over repeats with Student's t; the loss is never negative, and zero is
    within its limits where the printed angle is within those of the brightest one.

    Parameters
    ----------
    angles_deg
        Light angles, (n,).
    curves
        Values of independent repeats, (n, repeat), at least two.
    """
    count = curves.shape[1]
    whole = _read(angles_deg, curves.mean(axis=1))
    others = (curves.sum(axis=1, keepdims=True) - curves) / (count - 1)
    left_out = np.array([_read(angles_deg, one) for one in others.T])
    error = np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    reach = error * student_t.ppf(0.5 + _CONFIDENCE / 2.0, count - 1)
    low, high = whole - reach, whole + reach
    low[0], high[0] = np.clip([low[0], high[0]], angles_deg[0], angles_deg[-1])
    low[1] = 0.0 if low[0] <= PRINTED_ANGLE_DEG <= high[0] else max(low[1], 0.0)
    return whole, low, high


def _read(angles_deg: Floats, values: Floats) -> Floats:
    """Return (brightest angle, loss at the printed one) of a curve."""
    weights, fine = _smooth(angles_deg, values), _fine_deg(angles_deg)
    curve = _cosines(fine) @ weights
    at_printed = float((_cosines(np.array([PRINTED_ANGLE_DEG])) @ weights)[0])
    return np.array([fine[np.argmax(curve)], 1.0 - at_printed / curve.max()])


def _fine_deg(angles_deg: Floats) -> Floats:
    """Return angles between the first and the last one."""
    first, last = float(angles_deg[0]), float(angles_deg[-1])
    return np.linspace(first, last, round((last - first) / _FINE_STEP_DEG) + 1)


def _cosines(angles_deg: Floats) -> Floats:
    """Return the functions that smooth curves are sums of, (angle, 5)."""
    x = np.radians(angles_deg)
    waves = [wave(k * x) for k in range(1, _HARMONICS + 1) for wave in (np.cos, np.sin)]
    return np.column_stack([np.ones_like(x), *waves])


def _smooth(angles_deg: Floats, values: Floats) -> Floats:
    """Return the weights of the smooth curve through values, (5,): least squares, bright values counting more.

    Where the panel turns its back the curve has a kink, which no sum of few cosines has; it is dark there.
    """
    if not values.max() > 0.0:
        raise SimulateError("no path found light from the panel at any angle; give more paths (--samples)")
    bright = np.maximum(values, 0.0) / values.max()
    return np.asarray(np.linalg.lstsq(_cosines(angles_deg) * bright[:, None], values * bright)[0])


def _at_depth(design: FingerDesign, depth_mm: float) -> FingerDesign:
    """Return the design with its panel at another depth below the inner face."""
    x, _, z = design.light.position_mm
    return design.model_copy(update={"light": design.light.model_copy(update={"position_mm": (x, -depth_mm, z)})})


def _cases() -> list[tuple[tuple[int, str], tuple[int, str], tuple[int, str]]]:
    """Return numbers and names of mirror, probe and band of each curve."""
    return list(product(enumerate(MIRRORS), enumerate(PROBES), enumerate(BAND_NAMES)))


def _maxima(radiance: Floats) -> tuple[BrightestAngle, ...]:
    """Return the brightest angle of each curve of (mirror, angle, repeat, probe, band), with its limits."""
    found = []
    for (m, mirror), (p, probe), (b, band) in _cases():
        curves = radiance[m, :, :, p, b]
        (best, loss), (low, least), (high, most) = top_and_loss(ANGLES_DEG, curves)
        mean = curves.mean(axis=1)
        found.append(
            BrightestAngle(
                mirror=mirror,
                probe=probe,
                band=band,
                angle_deg=float(best),
                low95_deg=float(low),
                high95_deg=float(high),
                loss_at_printed_rel=float(loss),
                loss_at_printed_low95_rel=float(least),
                loss_at_printed_high95_rel=float(most),
                past_90_rel=float(mean[-1] / np.interp(90.0, ANGLES_DEG, mean)),
            )
        )
    return tuple(found)


def doubts(radiance: Floats) -> tuple[str, ...]:
    """Say where the search ended at a limit, and which curves are no sums of cosines."""
    notes = []
    for (m, mirror), (p, probe), (b, band) in _cases():
        mean, name = radiance[m, :, :, p, b].mean(axis=1), f"{mirror}, {probe}, {band}"
        best = brightest_deg(ANGLES_DEG, mean)
        if best in (ANGLES_DEG[0], ANGLES_DEG[-1]):
            notes.append(
                f"{name}: the maximum is at {best:g} deg, the end of the search range, so it may lie beyond, and the "
                "limits of its uncertainty are not valid"
            )
        misfit = (mean - _cosines(ANGLES_DEG) @ _smooth(ANGLES_DEG, mean)) * mean / mean.max()
        misfit_rel = float(np.sqrt(np.mean(misfit**2)) / mean.max())
        if misfit_rel > _LARGEST_MISFIT_REL:
            notes.append(
                f"{name}: the values depart by {100 * misfit_rel:.0f} % from the smooth curve that gives the maximum"
            )
    return tuple(notes)


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
    one = finger.design.model_copy(update={"second_light": None, "further_lights": ()})
    both = type(one).model_validate({**one.model_dump(), "second_light": tip.model_dump()})
    how, renders = RenderSettings("b", seed, samples), []
    for number, design in enumerate((one, both)):
        renders.append(render_press(design, finger.paints, finger.renderer, how, calibration=finger.calibration))
        if progress is not None:
            progress(number + 1, 2, (ONE, TWO)[number])
    matrix = finger.camera_matrix(renders[0].bands)
    places = [r.no_contact_maps.coat_mm(one) for r in renders]
    window = Window.around(*places, *(r.contact_maps.coat_mm(one) for r in renders))
    here = (window.rows, window.columns)
    seen = np.isfinite(places[0][..., 0]) & np.isfinite(places[1][..., 0])
    cells = [coat_cells(one, places[0], seen, r, matrix) for r in renders]
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
        z_mm=cell_places_mm(one),
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
    inner = slice(ends, len(mean) - ends)
    everywhere, middle = _variation(mean, variance), _variation(mean[inner], variance[inner])
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


def coat_cells(
    design: FingerDesign,
    place_mm: Floats,
    seen: NDArray[np.bool_],
    render: PressRender,
    matrix: Floats,
    cell_mm: float = _CELL_MM,
) -> tuple[Floats, Floats]:
    """Return the light of square cells of the coat without contact, and the variance of its render noise.

    Parameters
    ----------
    design, render
        Finger and render.
    place_mm
        Point (z, x) of the coat that each pixel sees, (row, column, 2).
    seen
        Pixels that count, (row, column).
    matrix
        Camera RGB from bands, (3, 3).
    cell_mm
        Side of a cell, about: the pad is divided evenly.

    Returns
    -------
    tuple of arrays
        (along, across, channel) each: the bands, then R, G, B; NaN where fewer than four pixels see a cell.
    """
    pad, shape = design.pad, _cells(design, cell_mm)
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


def cell_places_mm(design: FingerDesign, cell_mm: float = _CELL_MM) -> Floats:
    """Return the middles along the pad of the cells of :func:`coat_cells`, (along,)."""
    count, _ = _cells(design, cell_mm)
    return (np.arange(count) + 0.5) / count * design.pad.length_mm


def _cells(design: FingerDesign, cell_mm: float) -> tuple[int, int]:
    """Return into how many cells a pad is divided along and across."""
    return round(design.pad.length_mm / cell_mm), round(design.pad.width_mm / cell_mm)


def _variation(mean: Floats, variance: Floats) -> Floats:
    """Return the standard deviation over cells, noise taken out, over their mean, per channel."""
    level = _mean(mean, (0, 1))
    spread2 = _mean((mean - level) ** 2, (0, 1)) - _mean(variance, (0, 1))
    return np.asarray(np.sqrt(np.maximum(spread2, 0.0)) / level)


def _mean(cells: Floats, axes: tuple[int, ...]) -> Floats:
    """Return the mean over cells that are seen, NaN where none is."""
    count = np.isfinite(cells).sum(axis=axes)
    return np.where(count > 0, np.nansum(cells, axis=axes) / np.maximum(count, 1), np.nan)


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
