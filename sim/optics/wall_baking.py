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
)
from sim.optics.wall_rays import POINTS_ALONG, POINTS_UP, radiance_at_walls
from sim.surface_meshes.finger_shape import FingerShape

SMALLEST_CHAIN_SHARE = 0.005
"""Chains that add less to the emission of their band are left out, and so is everything they would excite."""

BAKE_SAMPLES = {False: 64_000, True: 12_000}
"""Paths per wall of one bake, by whether the variant is scalar (there each path costs a call from Python)."""

HIGHEST_ORDER = 6
"""Orders of fluorescence that are followed: each is a fifth of the one before, or less."""

# the irradiance varies over centimetres: polynomials smooth the sampling noise without bias of its own scale
_DEGREE_ALONG, _DEGREE_UP = 7, 1
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
    samples: int = BAKE_SAMPLES[False],
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
        From :func:`sim.optics.band_integrator.mirror_guide` for this scene: less noise.
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
        From :func:`sim.optics.band_integrator.mirror_guide` for this scene: less noise.

    Returns
    -------
    list of dict
        For each repeat, per wall an array of shape (TEXELS_ALONG, TEXELS_UP) in units of the panel's radiance; never
        negative.
    """
    scalar = renderer.variant() == SCALAR_VARIANT
    integrator = scene.integrator() if scalar else _tracer(scene, design, shape, from_wall=True, guide=guide)
    radiance = radiance_at_walls(scene, shape, integrator, renderer, seed, samples, repeats)[
        ..., BAND_NAMES.index("led")
    ]
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
    for _ in range(2, HIGHEST_ORDER + 1):
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
    radiance = np.pi * radiance_at_walls(scene, shape, tracer, renderer, seed, samples, 1)[0]
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
        traced = radiance_at_walls(scene, shape, scene.integrator(), renderer, seed, samples, 1)[0, ..., band]
        irradiance[chain] = {wall: _smooth(np.pi * traced[k]) for k, wall in enumerate(WALLS)}
    return irradiance


def _tracer(scene: Any, design: FingerDesign, shape: FingerShape, **options: Any) -> Any:
    """Return the band path tracer."""
    from sim.optics.band_integrator import band_paths  # needs the variant set

    return band_paths(scene, design, shape, **options)


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
