"""Bake the walls of a scene: the light that reaches them, what they emit, and what that makes them emit again.

Refraction bends the panel's light steeply into the gel, so most of what reaches a side wall has met the coating or
the mirror first: several times the direct part. The direct part is calculated, the detours are traced from the walls;
then the emission of the walls is traced from wall to wall, one order of fluorescence after the other.
"""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.optics.even_points import even_points
from sim.optics.paint_bands import BAND_NAMES, PaintBands
from sim.optics.scene import wall_texels
from sim.optics.variants import SCALAR_VARIANT
from sim.optics.wall_emission import (
    SMALLEST_RADIANCE_REL,
    TEXELS_ALONG,
    TEXELS_UP,
    WALLS,
    Level,
    WallLight,
    direct_irradiance,
    excited,
    grid_uv,
    last_band,
    paper_emission,
    texel_uv,
    wall_map,
)
from sim.surface_meshes.finger_shape import FingerShape

SMALLEST_CHAIN_SHARE = 0.005
"""Chains that add less to the emission of their band are left out, and so is everything they would excite."""

_LED = 2
POINTS_ALONG, POINTS_UP = 28, 4
# the irradiance varies over centimetres: polynomials smooth the sampling noise without bias of its own scale
_DEGREE_ALONG, _DEGREE_UP = 7, 1
_LIFT_MM = 2e-3
_HIGHEST_ORDER = 6
# emission by emission is a tenth of the light and comes from large walls: an eighth of the paths resolve it as well
_SHARE_OF_FURTHER_ORDERS = 0.125


def bake_walls(
    scene: Any,
    design: FingerDesign,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    level: Level = "b",
    seed: int = 0,
    samples: int = 64_000,
    repeats: int = 1,
    guide: Any = None,
) -> list[WallLight]:
    """Return what the walls emit, chain by chain.

    Level b: direct and detoured LED light excite "led>red" and "led>green"; these excite both walls again, and so on
    while a chain adds at least half a percent to the emission of its band. Level a: the paper's rule with the mean
    of the baked first order.

    Parameters
    ----------
    scene
        From :func:`sim.optics.scene.finger_scene`; in a scalar variant its walls must carry emitters.
    design, shape, bands, renderer
        As in the scene.
    level
        How the walls emit.
    seed
        Random seed, >= 0.
    samples
        Paths per wall and repeat for the LED's light.
    repeats
        Number of independent bakes.
    guide
        From :func:`sim.optics.paths.mirror_guide` for this scene: less noise.
    """
    rng = np.random.default_rng(seed)
    detours = indirect_irradiance(scene, design, shape, renderer, int(rng.integers(2**32)), samples, repeats, guide)
    direct = {wall: direct_irradiance(design, shape, wall, texel_uv()) for wall in WALLS}
    baked: list[WallLight] = []
    for detour in detours:
        light = excited("led", {wall: direct[wall] + detour[wall] for wall in WALLS}, bands)
        if level == "b":
            light |= _further_orders(scene, design, shape, bands, renderer, light, rng, samples)
        else:
            light = dict(paper_emission(design, shape, light, level))
        baked.append(light)
    return baked


def light_walls(scene: Any, light: WallLight, renderer: ModuleType) -> None:
    """Make the emitters of a scene's walls send what all chains together send, for Mitsuba's own integrators."""
    parameters = renderer.traverse(scene)
    for wall in WALLS:
        radiance = np.zeros((TEXELS_ALONG, TEXELS_UP, len(BAND_NAMES)))
        total = sum(map_ for chain, map_ in light.items() if last_band(chain) == wall)
        radiance[..., BAND_NAMES.index(wall)] = np.maximum(total, SMALLEST_RADIANCE_REL)
        parameters[f"{wall}.emitter.radiance.data"] = wall_texels(radiance, renderer)
    parameters.update()


def indirect_irradiance(
    scene: Any,
    design: FingerDesign,
    shape: FingerShape,
    renderer: ModuleType,
    seed: int,
    samples: int,
    repeats: int = 1,
    guide: Any = None,
) -> list[dict[str, NDArray[np.float64]]]:
    """Estimate the LED irradiance of the walls by all ways but the direct one through the inner face.

    E = pi times the mean LED radiance over cosine-distributed directions, at a grid of points, then a least-squares
    polynomial over the wall. Noise: about 640 % per path (with a guide half of it) over the square root of paths per
    coefficient (16).

    Parameters
    ----------
    scene
        From :func:`sim.optics.scene.finger_scene`; what its walls emit does not matter.
    design, shape, renderer
        As in the scene.
    seed
        Random seed, >= 0.
    samples
        Paths per wall and repeat.
    repeats
        Number of independent estimates, traced together.
    guide
        From :func:`sim.optics.paths.mirror_guide` for this scene: less noise.

    Returns
    -------
    list of dict
        For each repeat, per wall an array of shape (TEXELS_ALONG, TEXELS_UP) in units of the panel's radiance; never
        negative.
    """
    scalar = renderer.variant() == SCALAR_VARIANT
    integrator = scene.integrator() if scalar else _tracer(scene, design, shape, from_wall=True, guide=guide)
    radiance = _trace_from_walls(scene, shape, integrator, renderer, seed, samples, repeats)[..., _LED]
    means = np.pi * radiance
    if scalar:  # the stock tracer meets the panel directly too
        at = grid_uv(POINTS_ALONG, POINTS_UP)
        means -= np.stack([direct_irradiance(design, shape, wall, at).ravel() for wall in WALLS])
    return [{wall: _smooth(mean[k]) for k, wall in enumerate(WALLS)} for mean in means]


def _further_orders(
    scene: Any,
    design: FingerDesign,
    shape: FingerShape,
    bands: PaintBands,
    renderer: ModuleType,
    first: WallLight,
    rng: np.random.Generator,
    samples: int,
) -> dict[str, NDArray[np.float64]]:
    """Return the chains beyond the first order that matter."""
    found: dict[str, NDArray[np.float64]] = {}
    latest = {chain: light for chain, light in first.items() if bands.excites(last_band(chain))}
    per_trace = max(1, round(samples * _SHARE_OF_FURTHER_ORDERS))
    for _ in range(2, _HIGHEST_ORDER + 1):
        irradiance = _exchanged(scene, design, shape, renderer, latest, int(rng.integers(2**32)), per_trace)
        made = {name: light for chain, e in irradiance.items() for name, light in excited(chain, e, bands).items()}
        totals = {
            wall: sum(light.mean() for chain, light in {**first, **found, **made}.items() if last_band(chain) == wall)
            for wall in WALLS
        }
        latest = {c: v for c, v in made.items() if v.mean() >= SMALLEST_CHAIN_SHARE * totals[last_band(c)]}
        found |= latest
        if not latest:
            break
    return found


def _exchanged(
    scene: Any,
    design: FingerDesign,
    shape: FingerShape,
    renderer: ModuleType,
    emitted: WallLight,
    seed: int,
    samples: int,
) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return, for each emitted chain, the irradiance of the walls by its light."""
    if renderer.variant() == SCALAR_VARIANT:
        return _exchanged_by_stock_paths(scene, shape, renderer, emitted, seed, samples)
    tracer = _tracer(scene, design, shape, from_wall=True, with_led=False, emission=emitted)
    radiance = np.pi * _trace_from_walls(scene, shape, tracer, renderer, seed, samples, 1)[0]
    return {
        chain: {wall: _smooth(radiance[k, :, tracer.chains.index(chain)]) for k, wall in enumerate(WALLS)}
        for chain in emitted
    }


def _exchanged_by_stock_paths(
    scene: Any, shape: FingerShape, renderer: ModuleType, emitted: WallLight, seed: int, samples: int
) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return the same in a scalar variant, one chain after the other."""
    irradiance = {}
    for chain, light in emitted.items():
        light_walls(scene, {chain: light}, renderer)
        band = BAND_NAMES.index(last_band(chain))
        traced = _trace_from_walls(scene, shape, scene.integrator(), renderer, seed, samples, 1)[0, ..., band]
        irradiance[chain] = {wall: _smooth(np.pi * traced[k]) for k, wall in enumerate(WALLS)}
    return irradiance


def _tracer(scene: Any, design: FingerDesign, shape: FingerShape, **options: Any) -> Any:
    """Return the band path tracer."""
    from sim.optics.paths import band_integrator  # needs the variant set

    return band_integrator(scene, design, shape, **options)


def _trace_from_walls(
    scene: Any, shape: FingerShape, integrator: Any, renderer: ModuleType, seed: int, samples: int, repeats: int
) -> NDArray[np.float64]:
    """Return the mean radiance over cosine-distributed directions, (repeat, wall, point, channel)."""
    rng = np.random.default_rng(seed)
    points = POINTS_ALONG * POINTS_UP
    per_point = max(1, round(samples / points))
    origins, directions = rays_from_walls(shape, per_point, rng, repeats)
    trace = _trace_one_by_one if renderer.variant() == SCALAR_VARIANT else _trace_together
    radiance = trace(scene, integrator, renderer, origins, directions, int(rng.integers(2**32)))
    return np.asarray(radiance.reshape(repeats, len(WALLS), points, per_point, -1).mean(axis=3))


def rays_from_walls(
    shape: FingerShape, per_point: int, rng: np.random.Generator, repeats: int = 1
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return origins and cosine-distributed directions into the gel, (repeat * wall * point * per_point, 3)."""
    uv = grid_uv(POINTS_ALONG, POINTS_UP).reshape(-1, 2)
    walls = [(where.positions_mm(uv), -where.normals(uv)) for where in (wall_map(shape, wall) for wall in WALLS)]
    rays = [_wall_rays(points, inward, per_point, rng) for _ in range(repeats) for points, inward in walls]
    origins, directions = (np.concatenate([ray[k] for ray in rays]) for k in (0, 1))
    return origins, directions


def _wall_rays(
    points_mm: NDArray[np.float64], inward: NDArray[np.float64], per_point: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return origins and cosine-distributed directions (n, 3) from wall points into the gel."""
    normal = np.repeat(inward, per_point, axis=0)
    origins = np.repeat(points_mm, per_point, axis=0) + _LIFT_MM * normal
    # walls are nearly upright, so their normals are never near the pad's length
    across = np.cross(normal, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    # most of the light that reaches a wall at random has met smooth faces only, so that its direction decides
    height, turn = even_points(len(origins), 2, rng).T * np.array([[1.0], [2.0 * np.pi]])
    flat = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(normal, across)
    return origins, np.sqrt(height)[:, None] * normal + np.sqrt(1.0 - height)[:, None] * flat


def _trace_together(
    scene: Any,
    integrator: Any,
    renderer: ModuleType,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    seed: int,
) -> NDArray[np.float64]:
    """Return the channels of radiance along all rays, traced as one wavefront."""
    o, d = (np.ascontiguousarray(v.T, dtype=np.float32) for v in (origins, directions))
    sampler = renderer.load_dict({"type": "independent"})
    sampler.seed(seed, len(origins))
    rays = renderer.Ray3f(renderer.Point3f(o), renderer.Vector3f(d))
    radiance, _, further = integrator.sample(scene, sampler, rays, None, renderer.Bool(True))
    channels = [*radiance.numpy(), *(np.array(channel) for channel in further)]
    return np.stack([np.asarray(c, dtype=np.float64) for c in channels], axis=-1)


def _trace_one_by_one(
    scene: Any,
    integrator: Any,
    renderer: ModuleType,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    seed: int,
) -> NDArray[np.float64]:
    """Return the bands of radiance along rays in a scalar variant."""
    sampler = renderer.load_dict({"type": "independent"})
    sampler.seed(seed, 1)
    rays = zip(origins.tolist(), directions.tolist(), strict=True)
    return np.array([np.array(integrator.sample(scene, sampler, renderer.RayDifferential3f(o, d))[0]) for o, d in rays])


def _smooth(irradiance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fit polynomials to values at the traced points and return them at the texel centres, not below zero."""
    coefficients = np.linalg.lstsq(polynomial_basis(POINTS_ALONG, POINTS_UP), irradiance)[0]
    fitted = polynomial_basis(TEXELS_ALONG, TEXELS_UP) @ coefficients
    return np.asarray(np.maximum(fitted, 0.0).reshape(TEXELS_ALONG, TEXELS_UP))


def polynomial_basis(along: int, up: int) -> NDArray[np.float64]:
    """Return Legendre products at the centres of a grid, shape (along * up, coefficients)."""
    v, u = ((np.arange(count) + 0.5) / count for count in (along, up))
    legendre = np.polynomial.legendre.legvander
    basis = np.kron(legendre(2.0 * v - 1.0, _DEGREE_ALONG), legendre(2.0 * u - 1.0, _DEGREE_UP))
    return np.asarray(basis, dtype=np.float64)
