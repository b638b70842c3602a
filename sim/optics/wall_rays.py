"""Rays that start all over the painted walls, and what they bring back: the mean radiance at a grid of points."""

from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sim.optics.even_points import even_points
from sim.optics.path_rules import LIFT_MM
from sim.optics.variants import SCALAR_VARIANT
from sim.optics.wall_emission import WALLS, grid_uv, wall_map
from sim.surface_meshes.finger_shape import FingerShape

POINTS_ALONG: Final = 28
POINTS_UP: Final = 4
"""Grid of points on each wall where rays start."""


def radiance_at_walls(
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
    origins = np.repeat(points_mm, per_point, axis=0) + LIFT_MM * normal
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
