"""The painted walls: the light that reaches them, what they emit, and what that makes them emit again.

Emission is kept per chain of fluorescence, which names the way of the energy: "led>red" is LED light turned into red
emission at the red wall, "led>green>red" green emission of the green wall turned into red emission at the red wall.

Refraction bends the panel's light steeply into the gel, so most of what reaches a side wall has met the coating or
the mirror first: several times the direct part. The direct part is calculated, the detours are traced by rays that
start all over the walls; then the emission of the walls is traced from wall to wall, one order of fluorescence after
the other. For many lights of one finger the same is a matrix product, :class:`WallExchange`, traced once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from data_schemas import FingerDesign, LightPanel
from sim.optics._paint_bands import BAND_NAMES, PaintBands
from sim.optics._path_rules import LIFT_MM, even_points
from sim.optics._position_map import PositionMap
from sim.optics._refraction import curved_irradiance, inner_face
from sim.optics._renderer import SCALAR_VARIANT
from sim.optics._scene import wall_texels
from sim.surface_meshes import FingerShape

Level = Literal["a", "a_inverse_square", "b"]
"""b: baked; a: emitter proportional to the distance from the blue light, as printed; a_inverse_square: 1/d^2."""

LEVEL_NAMES: dict[Level, str] = {
    "a": "level a (paper's emitter)",
    "a_inverse_square": "level a (paper's emitter, inverse square)",
    "b": "level b",
}

WallLight = Mapping[str, NDArray[np.float64]]
"""Per chain of fluorescence: radiance of the wall at its end, (TEXELS_ALONG, TEXELS_UP), in units of the panel's."""

FIRST_CHAINS = ("led>red", "led>green", "led")
"""The chains of first order, in the order of the bands."""

TEXELS_ALONG, TEXELS_UP = 70, 8
# a texture that is black everywhere turns the stock tracer's emitter sampling into 0 / 0
SMALLEST_RADIANCE_REL = 1e-12
WALLS = ("red", "green")
# feet of the walls' points on the inner face, as its coordinate across
_FOOT_ACROSS = {"red": 0.0, "green": 1.0}
# the panel is at least its own height away from any wall: these points resolve it to parts in ten thousand
_PANEL_QUADRATURE = (12, 4)


def last_band(chain: str) -> str:
    """Return the band in which a chain's light is, "red", "green" or "led"; also the name of its last wall."""
    return chain.rsplit(">", 1)[-1]


def excited(
    chain: str, irradiance: Mapping[str, NDArray[np.float64]], bands: PaintBands
) -> dict[str, NDArray[np.float64]]:
    """Return what the light of a chain makes the walls emit, L = K E / pi in each paint's own band.

    Parameters
    ----------
    chain
        The chain whose light falls onto the walls.
    irradiance
        Irradiance of the walls "red" and "green" by that light, any shape.
    bands
        Energy conversion of the paints.
    """
    column = BAND_NAMES.index(last_band(chain))
    return {f"{chain}>{wall}": np.asarray(bands.conversion[wall][column] / np.pi * irradiance[wall]) for wall in WALLS}


def paper_emission(design: FingerDesign, shape: FingerShape, light: WallLight, level: Level) -> WallLight:
    """Return the emission of the walls by the rule of the paper, with the mean of a baked one.

    Intensity follows the distance from the panel's centre alone: proportional to it as printed, or to its inverse
    square. It knows nothing of the panel's angle beyond the gain; only the chains of first order remain.
    """
    emission = {}
    for wall in WALLS:
        points = wall_map(shape, wall).positions_mm(texel_uv())
        distance = np.linalg.norm(points - np.array(design.light.position_mm), axis=-1)
        rule = distance if level == "a" else distance**-2
        emission[f"led>{wall}"] = rule * light[f"led>{wall}"].mean() / rule.mean()
    return emission


def unbaked_walls() -> dict[str, NDArray[np.float64]]:
    """Return faint uniform emission (TEXELS_ALONG, TEXELS_UP, 3 bands) per wall, a place for a bake to be put."""
    emission = {wall: np.zeros((TEXELS_ALONG, TEXELS_UP, len(BAND_NAMES))) for wall in WALLS}
    for wall in WALLS:
        emission[wall][..., BAND_NAMES.index(wall)] = SMALLEST_RADIANCE_REL
    return emission


def direct_irradiance(
    design: FingerDesign, shape: FingerShape, wall: str, uv: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the direct irradiance of all panels at points of a wall, in units of the first panel's radiance.

    By quadrature over the panels through the inner face, whatever its shape; see
    :func:`sim.optics._refraction.curved_irradiance`. Valid while the coating does not shade the wall.

    Parameters
    ----------
    design, shape
        Panels and surfaces.
    wall
        "red" or "green".
    uv
        Texture coordinates (u up the wall, v along), shape (..., 2).
    """
    return sum(direct_irradiances(design, shape, wall, uv, design.lights), np.zeros(uv.shape[:-1]))


def direct_irradiances(
    design: FingerDesign, shape: FingerShape, wall: str, uv: NDArray[np.float64], lights: Sequence[LightPanel]
) -> list[NDArray[np.float64]]:
    """Return the same for each of several panels alone, which need not be those of the design."""
    where, face = wall_map(shape, wall), inner_face(design, shape)
    points, inward = where.positions_mm(uv).reshape(-1, 3), -where.normals(uv).reshape(-1, 3)
    foot = np.stack([np.full(uv.shape[:-1], _FOOT_ACROSS[wall]), uv[..., 1]], axis=-1).reshape(-1, 2)
    return [
        light.power_rel * curved_irradiance(points, inward, foot, light, face, _PANEL_QUADRATURE).reshape(uv.shape[:-1])
        for light in lights
    ]


def wall_map(shape: FingerShape, wall: str) -> PositionMap:
    """Return where a wall is; its normals point out of the gel."""
    return PositionMap.of(shape.surfaces[wall], f"{wall} wall")


def texel_uv() -> NDArray[np.float64]:
    """Return the texture coordinates (up, along) of the texel centres, shape (TEXELS_ALONG, TEXELS_UP, 2)."""
    return grid_uv(TEXELS_ALONG, TEXELS_UP)


def grid_uv(along: int, up: int) -> NDArray[np.float64]:
    """Return texture coordinates (up, along) at the centres of a regular grid, shape (along, up, 2)."""
    v, u = np.meshgrid((np.arange(along) + 0.5) / along, (np.arange(up) + 0.5) / up, indexing="ij")
    return np.stack([u, v], axis=-1)


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
        From :func:`sim.optics._scene.finger_scene`; in a scalar variant its walls must carry emitters.
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
        From :func:`sim.optics._band_paths.mirror_guide` for this scene: less noise.
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
        From :func:`sim.optics._scene.finger_scene`; what its walls emit does not matter.
    design, shape, renderer
        As in the scene.
    seed
        Random seed, >= 0.
    samples
        Paths per wall and repeat.
    repeats
        Number of independent estimates, traced together.
    guide
        From :func:`sim.optics._band_paths.mirror_guide` for this scene: less noise.

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
    from sim.optics._band_paths import band_paths  # needs the variant set

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


Floats = NDArray[np.float64]


class WallsMet(Protocol):
    """Mean over the rays of each group: LED radiance (group, light), per texel of a wall (group, light, wall, ...)."""

    @property
    def led(self) -> Floats:
        """Radiance of the LED."""

    @property
    def by_wall(self) -> Floats:
        """Radiance per radiance that a texel emits."""


class WallTracer(Protocol):
    """What traces rays for all lights, see :class:`sim.optics._angle_paths.AnglePaths`."""

    def trace(self, origins_mm: Floats, directions: Floats, per_group: int, seed: int, from_wall: bool) -> WallsMet:
        """Return what groups of rays have met."""


@dataclass(frozen=True, slots=True)
class WallExchange:
    """Light that reaches the walls, as coefficients of a polynomial over the receiving wall.

    Attributes
    ----------
    led
        Irradiance by the LED but for its direct light, (wall, coefficient, light), in units of the panel's radiance.
    exchange
        Irradiance per radiance that a texel emits, (wall, coefficient, light, emitting wall, TEXELS_ALONG, TEXELS_UP):
        the panel of the light keeps some of it away.
    """

    led: Floats
    exchange: Floats

    @classmethod
    def traced(cls, tracer: WallTracer, shape: FingerShape, samples: int, rng: np.random.Generator) -> "WallExchange":
        """Trace this many paths from each wall."""
        points = POINTS_ALONG * POINTS_UP
        per_point = max(1, round(samples / points))
        rays = rays_from_walls(shape, per_point, rng)
        met = tracer.trace(*rays, per_point, int(rng.integers(2**32)), from_wall=True)
        fit = np.pi * np.linalg.pinv(polynomial_basis(POINTS_ALONG, POINTS_UP))
        led = np.einsum("cp,wpl->wcl", fit, met.led.reshape(len(WALLS), points, -1))
        by_wall = met.by_wall.reshape(len(WALLS), points, -1)
        exchange = np.einsum("cp,wpt->wct", fit, by_wall, optimize=True)
        return cls(led, exchange.reshape(len(WALLS), len(fit), -1, len(WALLS), TEXELS_ALONG, TEXELS_UP))

    def emitted(self, light: int, direct: Floats, bands: PaintBands) -> Floats:
        """Return the radiance of the walls in their own bands, all orders of fluorescence together.

        L = sum over orders of K E / pi, E by the LED at first and then by what the walls have emitted.

        Parameters
        ----------
        light
            Number of the light.
        direct
            Its direct irradiance of the walls, (wall, TEXELS_ALONG, TEXELS_UP).
        bands
            Energy conversion of the paints.

        Returns
        -------
        array
            (wall, TEXELS_ALONG, TEXELS_UP), in units of the panel's radiance.
        """
        conversion = np.array([bands.conversion[wall] for wall in WALLS]) / np.pi
        irradiance = direct + _over_texels(self.led[..., light])
        latest = conversion[:, BAND_NAMES.index("led"), None, None] * irradiance
        total = latest
        of_band = conversion[:, [BAND_NAMES.index(wall) for wall in WALLS]]
        for _ in range(2, HIGHEST_ORDER + 1):
            received = np.einsum("wcvij,vij->vwc", self.exchange[:, :, light], latest, optimize=True)
            latest = np.einsum("wv,vwij->wij", of_band, _over_texels(received))
            total = total + latest
        return total


def direct_lights(design: FingerDesign, shape: FingerShape, lights: Sequence[LightPanel]) -> list[Floats]:
    """Return the walls' direct irradiance, (wall, TEXELS_ALONG, TEXELS_UP), by each light with the further ones."""
    of_walls = []
    for wall in WALLS:
        found = direct_irradiances(design, shape, wall, texel_uv(), [*lights, *design.lights[1:]])
        further = sum(found[len(lights) :], np.zeros((TEXELS_ALONG, TEXELS_UP)))
        of_walls.append([one + further for one in found[: len(lights)]])
    return [np.stack(pair) for pair in zip(*of_walls, strict=True)]


def _over_texels(coefficients: Floats) -> Floats:
    """Return polynomials (..., coefficient) at the texel centres, not below zero."""
    values = coefficients @ polynomial_basis(TEXELS_ALONG, TEXELS_UP).T
    return np.asarray(np.maximum(values, 0.0).reshape(*coefficients.shape[:-1], TEXELS_ALONG, TEXELS_UP))
