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
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from data_schemas import FingerDesign, LightPanel
from sim.optics._paint_bands import BAND_NAMES, PaintBands
from sim.optics._path_rules import LIFT_MM, LedSearch, even_points
from sim.optics._position_map import PositionMap
from sim.optics._refraction import curved_irradiance, inner_face
from sim.optics._renderer import SCALAR_VARIANT
from sim.optics._scene import LoadedScene, wall_texels
from sim.optics._wall_spline import BATCHES, SmoothedWall, WallSmoother, choose_smoother, smooth_batches
from sim.surface_meshes import FingerShape

Level = Literal["a", "a_inverse_square", "b"]
"""b: baked; a: emitter proportional to the distance from the blue light, as printed; a_inverse_square: 1/d^2."""

LEVEL_NAMES: dict[Level, str] = {
    "a": "level a (paper's emitter)",
    "a_inverse_square": "level a (paper's emitter, inverse square)",
    "b": "level b",
}

Floats = NDArray[np.float64]

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
        means = light[f"led>{wall}"].mean(axis=(-2, -1))
        emission[f"led>{wall}"] = rule * means[..., None, None] / rule.mean()
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
    where, face = wall_map(shape, wall), inner_face(design, shape)
    points, inward = where.positions_mm(uv).reshape(-1, 3), -where.normals(uv).reshape(-1, 3)
    foot = np.stack([np.full(uv.shape[:-1], _FOOT_ACROSS[wall]), uv[..., 1]], axis=-1).reshape(-1, 2)
    of_lights = [
        light.power_rel * curved_irradiance(points, inward, foot, light, face, _PANEL_QUADRATURE)
        for light in design.lights
    ]
    return np.asarray(sum(of_lights)).reshape(uv.shape[:-1])


def wall_map(shape: FingerShape, wall: str) -> PositionMap:
    """Return where a wall is; its normals point out of the gel."""
    return PositionMap.of(shape.surfaces[wall], f"{wall} wall")


def texel_uv() -> NDArray[np.float64]:
    """Return the texture coordinates (up, along) of the texel centres, shape (TEXELS_ALONG, TEXELS_UP, 2)."""
    centres = ((np.arange(count) + 0.5) / count for count in (TEXELS_ALONG, TEXELS_UP))
    v, u = np.meshgrid(*centres, indexing="ij")
    return np.stack([u, v], axis=-1)


SMALLEST_CHAIN_SHARE = 0.005
"""Chains that add less to the emission of their band are left out, and so is everything they would excite."""

BAKE_SAMPLES = {False: 128_000, True: 12_000}
"""Paths per wall of one bake, by whether the variant is scalar (there each path costs a call from Python)."""

HIGHEST_ORDER = 6
"""Orders of fluorescence that are followed: each is a fifth of the one before, or less."""

# emission by emission is a tenth of the light and comes from large walls: an eighth of the paths resolve it as well
_SHARE_OF_FURTHER_ORDERS = 0.125


def bake_walls(
    finger: LoadedScene,
    level: Level = "b",
    seed: int = 0,
    samples: int = BAKE_SAMPLES[False],
    repeats: int = 1,
    guide: Any = None,
) -> list[WallLight]:
    """Return what the walls emit, chain by chain: the means of the batches of :func:`bake_batches`.

    With the same parameters, and as many independent bakes as wanted.
    """
    rng = np.random.default_rng(seed)
    seeds = rng.integers(2**32, size=repeats).tolist()
    bakes = (bake_batches(finger, level, s, samples, guide) for s in seeds)
    return [{chain: batches.mean(axis=0) for chain, batches in light.items()} for light in bakes]


def bake_batches(
    finger: LoadedScene,
    level: Level = "b",
    seed: int = 0,
    samples: int = BAKE_SAMPLES[False],
    guide: Any = None,
    received: Mapping[str, NDArray[np.float64]] | None = None,
) -> WallLight:
    """Return what the walls emit, chain by chain, in :data:`BATCHES` independent batches.

    Level b: direct and detoured LED light excite "led>red" and "led>green"; these excite both walls again, and so on
    while a chain adds at least half a percent to the emission of its band. Level a: the paper's rule with the mean
    of the baked first order.

    Parameters
    ----------
    finger
        The scene.
    level
        How the walls emit.
    seed
        Random seed, >= 0.
    samples
        Paths per wall for the LED's light, of all batches together.
    guide
        From :func:`sim.optics._band_paths.mirror_guide` for this scene: less noise.
    received
        What :func:`led_irradiance` returns for the same seed and samples, where it is at hand.

    Returns
    -------
    dict
        Per chain an array (BATCHES, TEXELS_ALONG, TEXELS_UP). What batches have in common is the strength of their
        smoothing; see :func:`sim.optics._wall_spline.smooth_batches`.
    """
    rng = np.random.default_rng(seed)
    rng.integers(2**32)  # the seed of the LED's light
    received = received or led_irradiance(finger, seed, samples, guide)
    light = excited("led", received, finger.bands)
    if level != "b":
        return paper_emission(finger.design, finger.shape, light, level)
    return light | _further_orders(finger, light, rng, samples)


def led_irradiance(
    finger: LoadedScene, seed: int, samples: int = BAKE_SAMPLES[False], guide: Any = None
) -> dict[str, NDArray[np.float64]]:
    """Return the LED irradiance of each wall, (BATCHES, TEXELS_ALONG, TEXELS_UP), in units of the panel's radiance.

    The direct light is calculated, the detours are :func:`indirect_irradiance`. Parameters as :func:`bake_batches`.
    """
    design, shape = finger.design, finger.shape
    first_seed = int(np.random.default_rng(seed).integers(2**32))
    detours = indirect_irradiance(finger.scene, design, shape, finger.renderer, first_seed, samples, guide)
    return {
        wall: direct_irradiance(design, shape, wall, texel_uv()) + detour.batches for wall, detour in detours.items()
    }


REFLECTED_SAMPLES = 64_000
"""Paths per wall for the emission that falls back onto the walls: it is a fifth of what they send, or less."""


def reflected_light(
    finger: LoadedScene,
    light: WallLight,
    received: Mapping[str, NDArray[np.float64]],
    seed: int,
) -> NDArray[np.float64]:
    r"""Return what the Lambertian walls reflect of all chains, :math:`\rho E / \pi`, batch by batch.

    Needs a compiled variant.

    Parameters
    ----------
    finger
        The scene.
    light
        From :func:`bake_batches`.
    received
        The LED irradiance that it was made of, from :func:`led_irradiance`.
    seed
        Random seed, 32 bit.

    Returns
    -------
    array
        Radiance, (BATCHES, wall, TEXELS_ALONG, TEXELS_UP, chain), smoothed as what the walls emit. The chains are those
        of :attr:`sim.optics._band_paths.BandPaths.chains`: the first three, then the others of `light` in its order.
    """
    tracer = _tracer(finger.scene, finger.design, finger.shape, emission=light, led=LedSearch(False, from_wall=True))
    traced = np.pi * radiance_at_walls(finger.scene, finger.shape, tracer, finger.renderer, seed, REFLECTED_SAMPLES)
    for k, wall in enumerate(WALLS):
        for channel, chain in enumerate(tracer.chains):
            own = received[wall] if chain == "led" else smooth_batches(traced[:, k, ..., channel]).batches
            share = finger.bands.reflectance[wall][BAND_NAMES.index(last_band(chain))] / np.pi
            traced[:, k, ..., channel] = share * own
    return traced


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
    guide: Any = None,
) -> dict[str, SmoothedWall]:
    """Estimate the LED irradiance of the walls by all ways but the direct one through the inner face.

    E = pi times the mean LED radiance over cosine-distributed directions, at the texel centres, then a penalised spline
    over the wall (:mod:`sim.optics._wall_spline`). Noise: about 640 % per path (with a guide two thirds of it) over the
    square root of paths per degree of freedom of the spline (10 to 60, by what the light needs).

    Parameters
    ----------
    scene
        From :func:`sim.optics._scene.finger_scene`; what its walls emit does not matter.
    design, shape, renderer
        As in the scene.
    seed
        Random seed, >= 0.
    samples
        Paths per wall.
    guide
        From :func:`sim.optics._band_paths.mirror_guide` for this scene: less noise.

    Returns
    -------
    dict
        Per wall, in units of the panel's radiance.
    """
    scalar = renderer.variant() == SCALAR_VARIANT
    integrator = (
        scene.integrator() if scalar else _tracer(scene, design, shape, led=LedSearch(from_wall=True), guide=guide)
    )
    led = BAND_NAMES.index("led")
    means = np.pi * radiance_at_walls(scene, shape, integrator, renderer, seed, samples, guide)[..., led]
    if scalar:  # the stock tracer meets the panel directly too
        means -= np.stack([direct_irradiance(design, shape, wall, texel_uv()) for wall in WALLS])
    return {wall: smooth_batches(means[:, k]) for k, wall in enumerate(WALLS)}


def _further_orders(
    finger: LoadedScene, first: WallLight, rng: np.random.Generator, samples: int
) -> dict[str, NDArray[np.float64]]:
    """Return the chains beyond the first order that matter."""
    found: dict[str, NDArray[np.float64]] = {}
    bands = finger.bands
    latest = {chain: light for chain, light in first.items() if bands.excites(last_band(chain))}
    per_trace = max(1, round(samples * _SHARE_OF_FURTHER_ORDERS))
    for _ in range(2, HIGHEST_ORDER + 1):
        irradiance = _exchanged(finger, latest, int(rng.integers(2**32)), per_trace)
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
    finger: LoadedScene, emitted: WallLight, seed: int, samples: int
) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return, for each emitted chain, the irradiance of the walls by its light, batch by batch."""
    scene, shape, renderer = finger.scene, finger.shape, finger.renderer
    if renderer.variant() == SCALAR_VARIANT:
        return _exchanged_by_stock_paths(scene, shape, renderer, emitted, seed, samples)
    tracer = _tracer(scene, finger.design, shape, emission=emitted, led=LedSearch(counted=False, from_wall=True))
    radiance = np.pi * radiance_at_walls(scene, shape, tracer, renderer, seed, samples)
    channels = {chain: radiance[..., tracer.chains.index(chain)] for chain in emitted}
    return {
        chain: {wall: smooth_batches(of_chain[:, k]).batches for k, wall in enumerate(WALLS)}
        for chain, of_chain in channels.items()
    }


def _exchanged_by_stock_paths(
    scene: Any, shape: FingerShape, renderer: ModuleType, emitted: WallLight, seed: int, samples: int
) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Return the same in a scalar variant, one chain after the other, all batches by the mean of what is emitted."""
    irradiance = {}
    for chain, light in emitted.items():
        light_walls(scene, {chain: light.mean(axis=0)}, renderer)
        band = BAND_NAMES.index(last_band(chain))
        traced = np.pi * radiance_at_walls(scene, shape, scene.integrator(), renderer, seed, samples)[..., band]
        irradiance[chain] = {wall: smooth_batches(traced[:, k]).batches for k, wall in enumerate(WALLS)}
    return irradiance


def _tracer(scene: Any, design: FingerDesign, shape: FingerShape, **options: Any) -> Any:
    """Return the band path tracer."""
    from sim.optics._band_paths import band_paths  # needs the variant set

    return band_paths(scene, design, shape, **options)


def radiance_at_walls(
    scene: Any, shape: FingerShape, integrator: Any, renderer: ModuleType, seed: int, samples: int, guide: Any = None
) -> NDArray[np.float64]:
    """Return the mean radiance over cosine-distributed directions, (batch, wall, along, up, channel)."""
    rng = np.random.default_rng(seed)
    per_texel = max(1, round(samples / (BATCHES * TEXELS_ALONG * TEXELS_UP)))
    origins, directions, weights = rays_from_walls(shape, per_texel, rng, BATCHES, guide)
    trace = _trace_one_by_one if renderer.variant() == SCALAR_VARIANT else _trace_together
    radiance = trace(scene, integrator, renderer, origins, directions, int(rng.integers(2**32)))
    of_texels = (radiance * weights[:, None]).reshape(BATCHES, len(WALLS), TEXELS_ALONG, TEXELS_UP, per_texel, -1)
    return np.asarray(of_texels.mean(axis=4))


def rays_from_walls(
    shape: FingerShape, per_texel: int, rng: np.random.Generator, batches: int = 1, guide: Any = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return origins, directions into the gel and weights, (batch * wall * texel * per_texel, ...).

    Directions are cosine-distributed, with a guide some of them along it; weighted means are the same.
    """
    uv = texel_uv().reshape(-1, 2)
    of_walls = {wall: _wall_axes(wall_map(shape, wall), uv, per_texel) for wall in WALLS}
    uv = np.repeat(uv, per_texel, axis=0)
    rays = []
    for wall in WALLS * batches:
        origins, axes = of_walls[wall]
        height, turn = even_points(len(uv), 2, rng).T * np.array([[1.0], [2.0 * np.pi]])
        flat = np.sqrt(1.0 - height)
        local = np.stack([np.sqrt(height), flat * np.cos(turn), flat * np.sin(turn)], axis=-1)
        directions, weights = np.einsum("nik,nk->ni", axes, local), np.ones(len(uv))
        if guide is not None:
            directions, weights = guide.walls[wall].mixed(uv, axes[..., 0], directions, even_points(len(uv), 4, rng))
        rays.append((origins, directions, weights))
    origins, directions, weight = (np.concatenate([ray[k] for ray in rays]) for k in range(3))
    return origins, directions, weight


def _wall_axes(where: PositionMap, uv: Floats, per_texel: int) -> tuple[Floats, Floats]:
    """Return starts of rays (n, 3), and axes (n, 3, 3) whose first column points into the gel, so many per texel."""
    inward = -where.normals(uv)
    # walls are nearly upright, so their normals are never near the pad's length
    across = np.cross(inward, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    axes = np.stack([inward, across, np.cross(inward, across)], axis=-1)
    origins = where.positions_mm(uv) + LIFT_MM * inward
    return np.repeat(origins, per_texel, axis=0), np.repeat(axes, per_texel, axis=0)


def _trace_together(
    scene: Any,
    integrator: Any,
    renderer: ModuleType,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    seed: int,
) -> NDArray[np.float64]:
    """Return the channels of radiance along all rays, traced as one wavefront, batch after batch."""
    import drjit as dr

    o, d = (np.ascontiguousarray(v.T, dtype=np.float32) for v in (origins, directions))
    sampler = renderer.load_dict({"type": "independent"})
    sampler.seed(seed, len(origins))
    rays = renderer.Ray3f(renderer.Point3f(o), renderer.Vector3f(d))
    per_batch = dr.opaque(renderer.UInt32, len(origins) // BATCHES)
    integrator.divide_lanes(dr.arange(renderer.UInt32, len(origins)) // per_batch)
    radiance, _, further = integrator.sample(scene, sampler, rays, None, renderer.Bool(True))
    dr.eval(radiance, further)
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


@dataclass(frozen=True, slots=True)
class LightOfTexels:
    """Light that groups of rays receive per radiance that the texels of the walls emit, for several lights.

    Texels are in the order (wall, TEXELS_ALONG, TEXELS_UP), red wall first.

    Attributes
    ----------
    whole
        Without any panel in the way, (group, texel).
    kept_away
        What the panel of each light keeps away from that, (group, texel) each: few rays meet it.
    """

    whole: NDArray[np.float32]
    kept_away: tuple[csr_array, ...]

    def of_light(self, light: int) -> NDArray[np.float32]:
        """Return what is received under one light, (group, wall, TEXELS_ALONG, TEXELS_UP)."""
        left = self.whole - self.kept_away[light].toarray()
        return np.asarray(left.reshape(-1, len(WALLS), TEXELS_ALONG, TEXELS_UP), dtype=np.float32)

    def sums(self) -> Floats:
        """Return what is received where all texels emit one unit of radiance, (light, group)."""
        whole = self.whole.sum(axis=1, dtype=np.float64)
        return np.array([whole - kept.sum(axis=1) for kept in self.kept_away])

    def received(self, emitted: Floats, lights: Sequence[int]) -> Floats:
        """Return the light of each wall, (map, group, wall), by what the walls emit.

        Parameters
        ----------
        emitted
            Radiance, (map, wall, TEXELS_ALONG, TEXELS_UP).
        lights
            Number of the light under which each map is seen.
        """
        maps = emitted.reshape(len(emitted), len(WALLS), -1).astype(np.float32)
        walls = self.whole.reshape(len(self.whole), len(WALLS), -1)
        found = np.stack([(walls[:, w] @ maps[:, w].T).T for w in range(len(WALLS))], axis=-1).astype(np.float64)
        for number, light in enumerate(lights):
            of_walls = np.zeros((len(WALLS), *maps.shape[1:]), dtype=np.float32)
            for w in range(len(WALLS)):
                of_walls[w, w] = maps[number, w]
            found[number] -= self.kept_away[light] @ of_walls.reshape(len(WALLS), -1).T
        return found


class WallsMet(Protocol):
    """Means over the rays of each group."""

    @property
    def led(self) -> Floats:
        """Radiance of the LED, (group, light)."""

    @property
    def by_wall(self) -> LightOfTexels:
        """Radiance per radiance that a texel emits."""


class WallTracer(Protocol):
    """What traces rays for all lights, see :class:`sim.optics._angle_paths.AnglePaths`."""

    def trace(self, origins_mm: Floats, directions: Floats, per_group: int, seed: int, from_wall: bool) -> WallsMet:
        """Return what groups of rays have met."""


_OF_WALLS = len(WALLS), TEXELS_ALONG, TEXELS_UP


@dataclass(frozen=True, slots=True)
class WallExchange:
    """Light that reaches the walls.

    Attributes
    ----------
    led
        Irradiance by the LED but for its direct light, smoothed, (light, wall, TEXELS_ALONG, TEXELS_UP), in units of
        the panel's radiance.
    exchange
        Mean radiance that arrives per radiance that a texel emits, as it was traced; groups are the texels that
        receive.
    smoother
        Of each light and wall, for what it receives by ``exchange``; all is linear in what walls emit.
    """

    led: Floats
    exchange: LightOfTexels
    smoother: WallSmoother

    @classmethod
    def traced(cls, tracer: WallTracer, shape: FingerShape, samples: int, rng: np.random.Generator) -> "WallExchange":
        """Trace this many paths from each wall."""
        per_texel = max(1, round(samples / (TEXELS_ALONG * TEXELS_UP)))
        origins, directions, _ = rays_from_walls(shape, per_texel, rng)
        met = tracer.trace(origins, directions, per_texel, int(rng.integers(2**32)), from_wall=True)
        # each light by itself: what is found of one must not depend on which others are traced with it
        led = np.pi * met.led.T.reshape(-1, *_OF_WALLS)
        return cls(_smoother_of(led)(led), met.by_wall, _smoother_of(met.by_wall.sums().reshape(-1, *_OF_WALLS)))

    def emitted(self, direct: Floats, bands: PaintBands) -> Floats:
        """Return the radiance of the walls in their own bands, all orders of fluorescence together.

        L = sum over orders of K E / pi, E by the LED at first and then by what the walls have emitted.

        Parameters
        ----------
        direct
            Direct irradiance of the walls by each light, (light, wall, TEXELS_ALONG, TEXELS_UP).
        bands
            Energy conversion of the paints.

        Returns
        -------
        array
            (light, wall, TEXELS_ALONG, TEXELS_UP), in units of the panel's radiance.
        """
        conversion = np.array([bands.conversion[wall] for wall in WALLS])
        latest = conversion[:, BAND_NAMES.index("led"), None, None] / np.pi * (direct + self.led)
        total = latest
        of_band = conversion[:, [BAND_NAMES.index(wall) for wall in WALLS]]
        for _ in range(2, HIGHEST_ORDER + 1):
            arrived = self.exchange.received(latest, range(len(latest))).reshape(-1, *_OF_WALLS, len(WALLS))
            latest = self.smoother((arrived * of_band[:, None, None]).sum(axis=-1))
            total = total + latest
        return np.asarray(total)

    def chains(self, light: int, direct: Floats, order: int) -> dict[str, tuple[int, Floats]]:
        """Return what each chain of fluorescence makes a wall emit, for conversions of 1.

        Parameters
        ----------
        light
            Number of the light.
        direct
            Its direct irradiance of the walls, (wall, TEXELS_ALONG, TEXELS_UP).
        order
            Conversions of the longest chain.

        Returns
        -------
        dict
            Name of the chain -> number of the wall that emits it, and its radiance there, (TEXELS_ALONG, TEXELS_UP), in
            units of the panel's. That of given paints is their conversions along the chain times as much.
        """
        smoother = WallSmoother(self.smoother.noise_sd[light], self.smoother.gain[light])
        latest = {f"led>{wall}": (k, (direct[k] + self.led[light, k]) / np.pi) for k, wall in enumerate(WALLS)}
        found = dict(latest)
        for _ in range(2, order + 1):
            emitted = np.zeros((len(latest), *_OF_WALLS))
            for row, (wall_number, radiance) in zip(emitted, latest.values(), strict=True):
                row[wall_number] = radiance
            arrived = self.exchange.received(emitted, [light] * len(emitted)).sum(axis=-1)
            made = smoother(arrived.reshape(-1, *_OF_WALLS))
            latest = {
                f"{chain}>{wall}": (k, of_chain[k])
                for chain, of_chain in zip(latest, made, strict=True)
                for k, wall in enumerate(WALLS)
            }
            found |= latest
        return found


def _smoother_of(received: Floats) -> WallSmoother:
    """Choose smoothers for noisy maps (..., along, up) without repeats: texels above each other tell the noise."""
    noise2 = (np.diff(received, 2, axis=-1) ** 2).mean(axis=-1, keepdims=True) / 6.0
    return choose_smoother(received, np.broadcast_to(noise2, received.shape), maps=1)


def direct_lights(design: FingerDesign, shape: FingerShape, lights: Sequence[LightPanel]) -> Floats:
    """Return the walls' direct irradiance by each light with the further ones, (light, wall, along, up).

    As :func:`direct_irradiance`, in single precision, by a compiled variant: all lights in one go.
    """
    from sim.optics._panel_light import panel_irradiances  # needs the variant set

    uv = texel_uv().reshape(-1, 2)
    maps = [wall_map(shape, wall) for wall in WALLS]
    points = np.concatenate([where.positions_mm(uv) for where in maps])
    normals = np.concatenate([where.normals(uv) for where in maps])
    foot = np.concatenate([np.column_stack([np.full(len(uv), _FOOT_ACROSS[wall]), uv[:, 1]]) for wall in WALLS])
    every = [*lights, *design.lights[1:]]
    found = panel_irradiances(points, -normals, foot, every, inner_face(design, shape), _PANEL_QUADRATURE)
    found = found.reshape(-1, *_OF_WALLS) * np.array([light.power_rel for light in every])[:, None, None, None]
    return np.asarray(found[: len(lights)] + found[len(lights) :].sum(axis=0))
