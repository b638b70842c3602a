"""Bake the walls of a scene: add the light that reaches them by detours, and set what they emit.

Refraction bends the panel's light steeply into the gel, so most of what reaches a side wall has met the coating
or the mirror first: several times the direct part. The detours are traced from the walls into the LED band.
"""

from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.optics.paint_bands import PaintBands
from sim.optics.pressed_pad import pressed_profile
from sim.optics.scene import wall_texels
from sim.optics.variants import SCALAR_VARIANT
from sim.optics.wall_emission import (
    TEXELS_ALONG,
    TEXELS_UP,
    WALL_SIDES,
    Level,
    direct_irradiance,
    wall_emission,
)

_LED = 2
_POINTS_ALONG, _POINTS_UP = 28, 4
# the irradiance varies over centimetres: polynomials smooth the sampling noise without bias of its own scale
_DEGREE_ALONG, _DEGREE_UP = 7, 1
_LIFT_MM = 2e-3


def light_walls(
    scene: Any,
    design: FingerDesign,
    bands: PaintBands,
    renderer: ModuleType,
    level: Level,
    indirect: Mapping[str, NDArray[np.float64]],
) -> None:
    """Set what a scene's walls emit.

    Parameters
    ----------
    scene
        From :func:`sim.optics.scene.finger_scene` with emitting walls; their textures are replaced.
    design, bands, renderer, level
        As in the scene; see :func:`sim.optics.wall_emission.wall_emission`.
    indirect
        One repeat of :func:`indirect_irradiance`.
    """
    emission = wall_emission(design, bands, level, indirect)
    parameters = renderer.traverse(scene)
    for wall in WALL_SIDES:
        parameters[f"{wall}.emitter.radiance.data"] = wall_texels(emission[wall], renderer)
    parameters.update()


def indirect_irradiance(
    scene: Any, design: FingerDesign, renderer: ModuleType, seed: int, samples: int, repeats: int = 1
) -> list[dict[str, NDArray[np.float64]]]:
    """Estimate the LED irradiance of the walls by all ways but the direct one through the inner face.

    E = pi times the mean LED radiance over cosine-distributed directions, at a grid of points, then a least-squares
    polynomial over the wall. Noise: about 640 % per path over the square root of paths per coefficient (16).

    Parameters
    ----------
    scene
        From :func:`sim.optics.scene.finger_scene`; what its walls emit does not matter.
    design, renderer
        As in the scene.
    seed
        Random seed, >= 0.
    samples
        Paths per wall and repeat.
    repeats
        Number of independent estimates, traced together.

    Returns
    -------
    list of dict
        For each repeat, per wall an array of shape (TEXELS_ALONG, TEXELS_UP) in units of the panel's radiance; never
        negative.
    """
    along = (np.arange(_POINTS_ALONG) + 0.5) / _POINTS_ALONG
    up = (np.arange(_POINTS_UP) + 0.5) / _POINTS_UP
    z_mm = along * design.pad.length_mm
    y_mm = up[None, :] * pressed_profile(design, z_mm)[:, None]
    per_point = max(1, round(samples / y_mm.size))
    points = {
        wall: np.stack(np.broadcast_arrays(side * design.pad.width_mm / 2.0, y_mm, z_mm[:, None]), -1).reshape(-1, 3)
        for wall, side in WALL_SIDES.items()
    }
    rng = np.random.default_rng(seed)
    rays = [_wall_rays(points[w], side, per_point, rng) for _ in range(repeats) for w, side in WALL_SIDES.items()]
    origins, directions = (np.concatenate([ray[k] for ray in rays]) for k in (0, 1))
    scalar = renderer.variant() == SCALAR_VARIANT
    trace = _trace_one_by_one if scalar else _trace_together
    radiance = trace(scene, _tracer(scene, design, scalar), renderer, origins, directions, int(rng.integers(2**32)))
    means = np.pi * radiance.reshape(repeats, len(WALL_SIDES), y_mm.size, per_point).mean(axis=-1)
    if scalar:  # the stock tracer meets the panel directly too
        means -= np.stack([direct_irradiance(design, points[w], side) for w, side in WALL_SIDES.items()])
    return [{w: _smooth(mean[k], along, up) for k, w in enumerate(WALL_SIDES)} for mean in means]


def _tracer(scene: Any, design: FingerDesign, scalar: bool) -> Any:
    """Return the path tracer that leaves out the direct light, or the scene's own in a scalar variant."""
    if scalar:
        return scene.integrator()
    from sim.optics.paths import band_integrator  # needs the variant set

    return band_integrator(design, from_wall=True)


def _wall_rays(
    points_mm: NDArray[np.float64], side: float, per_point: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return origins and cosine-distributed directions (n, 3) from wall points into the gel."""
    origins = np.repeat(points_mm - np.array([side * _LIFT_MM, 0.0, 0.0]), per_point, axis=0)
    height, turn = rng.random(len(origins)), 2.0 * np.pi * rng.random(len(origins))
    across = np.sqrt(1.0 - height)
    return origins, np.column_stack([-side * np.sqrt(height), across * np.cos(turn), across * np.sin(turn)])


def _trace_together(
    scene: Any,
    integrator: Any,
    renderer: ModuleType,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    seed: int,
) -> NDArray[np.float64]:
    """Return the LED radiance along all rays, traced as one wavefront."""
    o, d = (np.ascontiguousarray(v.T, dtype=np.float32) for v in (origins, directions))
    sampler = renderer.load_dict({"type": "independent"})
    sampler.seed(seed, len(origins))
    rays = renderer.Ray3f(renderer.Point3f(o), renderer.Vector3f(d))
    radiance = integrator.sample(scene, sampler, rays, None, renderer.Bool(True))[0]
    return np.asarray(radiance.numpy()[_LED], dtype=np.float64)


def _trace_one_by_one(
    scene: Any,
    integrator: Any,
    renderer: ModuleType,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    seed: int,
) -> NDArray[np.float64]:
    """Return the LED radiance along rays in a scalar variant."""
    sampler = renderer.load_dict({"type": "independent"})
    sampler.seed(seed, 1)
    rays = zip(origins.tolist(), directions.tolist(), strict=True)
    return np.array([integrator.sample(scene, sampler, renderer.RayDifferential3f(o, d))[0][_LED] for o, d in rays])


def _smooth(
    irradiance: NDArray[np.float64], along: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fit polynomials to values at (along x up) and return them at the texel centres, not below zero."""
    texels_along = (np.arange(TEXELS_ALONG) + 0.5) / TEXELS_ALONG
    texels_up = (np.arange(TEXELS_UP) + 0.5) / TEXELS_UP
    coefficients = np.linalg.lstsq(_basis(along, up), irradiance)[0]
    fitted = _basis(texels_along, texels_up) @ coefficients
    return np.asarray(np.maximum(fitted, 0.0).reshape(TEXELS_ALONG, TEXELS_UP))


def _basis(along: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Legendre products at the grid of positions, shape (along * up, coefficients)."""
    legendre = np.polynomial.legendre.legvander
    basis = np.kron(legendre(2.0 * along - 1.0, _DEGREE_ALONG), legendre(2.0 * up - 1.0, _DEGREE_UP))
    return np.asarray(basis, dtype=np.float64)
