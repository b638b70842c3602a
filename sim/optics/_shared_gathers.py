"""Shared gathers: pixels share the light that arrives at nodes of the coat, and read the painted walls themselves.

A path tracer finds the light of each pixel anew, by chance, and most paths find none. Neighbouring pixels see nearly
the same light arrive. Here it is traced once, from nodes spread over the coat, along directions in which the coat
sends light to the camera; each pixel weights it with the coat's reflection at its own point, towards its own ray, by
its own normal. What changes within less than the nodes' distance is left out of that and found by the pixel: the
light straight from the walls, by points drawn on them, and straight from the panels, by connections through the gel's
face. So are the reflections on the way from the camera.

The walls are Lambertian: what they reflect is part of a map of their whole radiance, traced from the walls as their
emission is, and every path ends where it meets one. Light between nodes is a local regression, and light within a bin
of directions (10 deg around, 1/16 of the cosine) counts as even: that is the bias. All else is unbiased.

Import this module only after a compiled variant has been set (see :func:`sim.optics.open_renderer`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from data_schemas import CameraCalibration, SimulateError
from sim.optics._band_paths import BandPaths, band_paths, first_texel
from sim.optics._mirror_guide import GUIDE_CHANCE
from sim.optics._optical_layout import camera_pose
from sim.optics._paint_bands import BAND_NAMES
from sim.optics._painted_walls import TEXELS_ALONG, TEXELS_UP, WALLS, WallLight, last_band, wall_map
from sim.optics._panel_light import FROM_SURFACE, state_after
from sim.optics._path_rules import LARGEST_SURVIVAL, MAX_DEPTH, ROULETTE_DEPTH, LookupTable, cell_at
from sim.optics._pixel_maps import camera_rays
from sim.optics._position_map import PositionMap
from sim.optics._scene import LoadedScene
from sim.surface_meshes import FingerShape

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

NODE_MM: Final = (1.0, 2.0)
"""Distance of the nodes across and along the pad: across it the light of the walls falls off."""

RAYS: Final = 64
"""Paths of each node in one batch."""

_RIM_MM = 0.137
# nodes start their paths from here below the coat's surface
_BELOW_MM = 0.3
_BESIDE_MM = 7e-3
# what arrives is known at places this far apart, linear between them
_PLACE_MM = (1.5, 2.5)
# a place is served by the nodes around it, across and along the pad: the face blurs what it sends back over 12 mm
_REACH_MM = np.array([7.0, 12.0])
_HEIGHT_PRIOR = 1e-6
# directions are told apart by their height over the coat, rows per unit of its cosine, and by their turn
_ROWS, _TURNS = 16, 36
_PACKET = 4
# a wall's points, up and along: linear between them, a mesh bent by a press leaves them by micrometres
_WALL_POINTS = (17, 141)
# shadow rays stop before a wall by more than its mesh and these points differ
_BEFORE_WALL_MM = 0.05
# share of the points on a wall that are drawn evenly up it: weights stay bounded on facets that lean to the wall
_EVENLY = 0.25
_SMALLEST_MM = 1e-3
# the coat is seen through the inner face, and once more in what that reflects to the mirror
_SIGHTS = 2
_MOST_PATHS = 1 << 21
# powers of the root of g^5 = g + 1 spread points evenly over four dimensions
_STEPS_4 = (0.8566748838545029, 0.733891856627126, 0.6287067210378087, 0.5385972572236101)


@dataclass(frozen=True, slots=True)
class GatherCounts:
    """What one path from the camera does where it meets the coat.

    Attributes
    ----------
    directions
        Directions, of some 600, from which it weights what arrives.
    points
        Points drawn on each wall, and on the panels.
    """

    directions: int = 288
    points: int = 4


class LitWalls:
    """The radiance of both walls in all channels, and points drawn on them by the light they send to a place.

    Parameters
    ----------
    radiance
        Shape (batch, wall, TEXELS_ALONG, TEXELS_UP, channel).
    shape
        Where the walls are.
    thickness_mm, length_mm
        Sizes of the pad: they shape the density of the points only.
    """

    def __init__(self, radiance: Floats, shape: FingerShape, thickness_mm: float, length_mm: float) -> None:
        batches, _, _, _, self.channels = radiance.shape
        self.packets = -(-self.channels // _PACKET)
        texels = np.zeros((*radiance.shape[:-1], self.packets * _PACKET), dtype=np.float32)
        texels[..., : self.channels] = radiance
        self.texels = LookupTable(texels.reshape(-1, _PACKET), mi)
        self.per_batch = dr.opaque(mi.UInt32, 2 * TEXELS_ALONG * TEXELS_UP if batches > 1 else 0)
        self.height, self.length = mi.Float(thickness_mm), mi.Float(length_mm)
        self.points = LookupTable(np.concatenate([_wall_points(wall_map(shape, wall)) for wall in WALLS]), mi)
        dr.make_opaque(self.height, self.length)

    def at(self, place: Any, is_green: Any, batch: Any, active: Any) -> list[Any]:
        """Return the radiance of wall points (what has ``uv``), one value per channel."""
        first, s, t = first_texel(place, is_green)
        first += batch * self.per_batch
        radiance: list[Any] = []
        for packet in range(self.packets):
            a, b, c, d = (
                self.texels.row((first + (j * TEXELS_UP + i)) * self.packets + packet, active)
                for j in (0, 1)
                for i in (0, 1)
            )
            mixed = (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d)
            radiance += [mixed[k] for k in range(_PACKET)]
        return radiance[: self.channels]

    def place(self, wall: int, u: Any, v: Any, active: Any) -> tuple[Any, Any, Any]:
        """Return points of a wall and their derivatives by u (up) and v (along)."""
        across, along = (count - 1 for count in _WALL_POINTS)
        x, y = u * across, v * along
        i, j = cell_at(x, across), cell_at(y, along)
        s, t = x - mi.Float(i), y - mi.Float(j)
        first = (wall * (along + 1) + j) * (across + 1) + i
        a, b, c, d = (
            mi.Vector3f(row.x, row.y, row.z)
            for row in (
                self.points.row(first + step, active) for step in (0, 1, across + 1, across + 2)
            )
        )  # fmt: skip
        point = (1 - t) * ((1 - s) * a + s * b) + t * ((1 - s) * c + s * d)
        return point, ((1 - t) * (b - a) + t * (d - c)) * across, ((1 - s) * (c - a) + s * (d - b)) * along

    def aim(self, scene: Any, si: Any, wall: int, sample: Sequence[Any], active: Any) -> tuple[Any, Any, Any, Any]:
        r"""Return (seen, direction, solid angle per point, place) of a point drawn on a wall from points of the coat.

        With the distance d from the wall at the coat, a depth t below it and a place z along, the light of an even wall
        on an even coat is :math:`t d / (d^2 + t^2 + z^2)^2 dt dz`: t is drawn by :math:`t / (d^2 + t^2)` and z by
        :math:`D / (D^2 + z^2)`, :math:`D^2 = d^2 + t^2`. Left over is the product of two cosines.
        """
        rim = self.place(wall, mi.Float(1), si.uv.y, active)[0]
        d = dr.maximum(dr.norm(rim - si.p), _SMALLEST_MM)
        reach = 0.5 * dr.log(1.0 + dr.square(self.height / d))
        even = sample[2] < _EVENLY
        t = d * dr.safe_sqrt(dr.exp(2.0 * reach * sample[0]) - 1.0)
        t = dr.select(even, sample[0] * self.height, dr.minimum(t, self.height))
        up_density = (1.0 - _EVENLY) * t / (d * d + t * t) / reach * self.height + _EVENLY
        across = dr.sqrt(d * d + t * t)
        from_end = si.uv.y * self.length
        low, high = dr.atan(-from_end / across), dr.atan((self.length - from_end) / across)
        z = across * dr.tan(low + (high - low) * sample[1])
        along_density = across / (across * across + z * z) / (high - low) * self.length
        u, v = 1.0 - t / self.height, dr.clip(si.uv.y + z / self.length, 0.0, 1.0)
        point, du, dv = self.place(wall, u, v, active)
        way = point - si.p
        r2: Any = dr.maximum(dr.squared_norm(way), _SMALLEST_MM**2)
        r = dr.sqrt(r2)
        direction = way / r
        # |n . direction| dA = |(du x dv) . direction| du dv
        solid_angle = dr.abs(dr.dot(dr.cross(du, dv), direction)) / (r2 * up_density * along_density)
        ray = si.spawn_ray(direction)
        ray.maxt = dr.maximum(r - _BEFORE_WALL_MM, 0.0)
        seen = active & (solid_angle > 0.0)
        seen &= ~scene.ray_test(ray, seen & (r > 2.0 * _BEFORE_WALL_MM))
        return seen, direction, solid_angle, _Place(mi.Point2f(u, v))


@dataclass(frozen=True, slots=True)
class _Place:
    """Texture coordinates, as those of an interaction."""

    uv: Any


def _wall_points(where: PositionMap) -> Floats:
    """Return points of a wall, (along * up, 4), the last number zero."""
    u, v = (np.linspace(0.0, 1.0, count) for count in _WALL_POINTS)
    points = where.positions_mm(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    return np.column_stack([points, np.zeros(len(points))])


class SharedGathers:
    """What renders pixels from shared gathers; as :class:`sim.optics._band_paths.BandPaths` it has ``chains``.

    Parameters
    ----------
    finger
        The scene.
    light
        Batches of the walls' emission, per chain (batch, TEXELS_ALONG, TEXELS_UP).
    reflected
        What the walls reflect, (batch, wall, TEXELS_ALONG, TEXELS_UP, chain); see :func:`reflected_light`.
    calibration
        Of the camera; without it the ideal pinhole of the design. Nodes aim their paths by what it sees.
    guide
        From :func:`sim.optics._band_paths.mirror_guide`.
    seed
        Random seed of the nodes' paths, 32 bit.
    counts
        Work per path from the camera.

    Raises
    ------
    SimulateError
        When the camera does not see the coat by the mirror and through the inner face.
    """

    def __init__(
        self,
        finger: LoadedScene,
        light: WallLight,
        reflected: Floats,
        guide: Any,
        seed: int,
        calibration: CameraCalibration | None = None,
        counts: GatherCounts | None = None,
    ) -> None:
        self.finger, self.counts = finger, counts or GatherCounts()
        self.paths: BandPaths = band_paths(finger.scene, finger.design, finger.shape, light, guide=guide)
        self.chains = self.paths.chains
        self.band_of = [BAND_NAMES.index(last_band(chain)) for chain in self.chains]
        radiance = reflected.copy()
        for channel, chain in enumerate(self.chains):
            if chain in light:
                radiance[:, WALLS.index(last_band(chain)), ..., channel] += light[chain]
        pad = finger.design.pad
        self.walls = LitWalls(radiance, finger.shape, pad.thickness_mm, pad.length_mm)
        self.mirror = mi.ShapePtr(next(s for s in finger.scene.shapes() if s.id() == "mirror"))
        dr.make_opaque(self.mirror)
        self.nodes = Nodes(finger, *self._seen(calibration))
        self.batch = self.batch_of_lane = dr.opaque(mi.UInt32, 0)
        self.batches = len(radiance)
        self._gather(seed)

    def divide_lanes(self, batch: Any) -> None:
        """Tell which batch of the walls' light and of the nodes' paths each lane of the next rays sees."""
        self.batch = batch
        self.paths.divide_lanes(batch)

    def _seen(self, calibration: CameraCalibration | None) -> tuple[Floats, Floats]:
        """Return texture coordinates (n, 2) and last legs (n, 3) of the camera's rays that meet the coat."""
        design, scene = self.finger.design, self.finger.scene
        directions = np.ascontiguousarray(camera_rays(design, calibration).reshape(-1, 3).T, dtype=np.float32)
        sight = _Sight.along(
            self, scene, mi.Ray3f(mi.Point3f(camera_pose(design).centre_mm.tolist()), mi.Vector3f(directions))
        )
        uv, leg = sight.si.uv, -sight.si.to_world(sight.si.wi)
        dr.eval(sight.on_coat, uv, leg)
        here = sight.on_coat.numpy()
        if not here.any():
            raise SimulateError(
                "light can be shared only between pixels that see the coat through the mirror and the gel's inner "
                "face, but here the camera sees it in another way; check mirror and camera in the design, or render "
                "without sharing"
            )
        return uv.numpy().T[here].astype(np.float64), leg.numpy().T[here].astype(np.float64)

    def _gather(self, seed: int) -> None:
        """Trace the paths of all nodes, batch after batch, and keep the light that arrives at the places."""
        rng = np.random.default_rng(seed)
        per_batch = self.nodes.count * RAYS
        together = max(1, _MOST_PATHS // per_batch)
        traced = [
            self._traced(start, min(together, self.batches - start), rng) for start in range(0, self.batches, together)
        ]
        drawn, light = (np.concatenate([one[k] for one in traced]) for k in range(2))
        self.bins = DirectionBins.of(drawn)
        table = np.stack([self._arriving(*one) for one in zip(drawn, light, strict=True)])
        self.light = LookupTable(table.reshape(-1, _PACKET), mi)

    def _traced(self, start: int, batches: int, rng: np.random.Generator) -> tuple[Floats32, Floats32]:
        """Return directions of paths from the nodes, (batch, path, 3), and their light over their density."""
        count = self.nodes.count * RAYS * batches
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(int(rng.integers(2**32)), count)
        lane: Any = dr.arange(mi.UInt32, count)
        rays, nodes, first = (dr.opaque(mi.UInt32, n) for n in (RAYS, self.nodes.count, start))
        group = lane // rays
        batch = group // nodes
        shifts = LookupTable(rng.random((self.nodes.count * batches, 4)), mi).row(group)
        numbers = [_spread(shifts[k], lane - group * rays, step) for k, step in enumerate(_STEPS_4)]
        si = self.nodes.seen(self.finger.scene, group - batch * nodes)
        direction, density = self._drawn(si, numbers)
        ray = si.spawn_ray(direction)
        found = _follow(self, self.finger.scene, sampler, ray, batch + first)  # type: ignore[no-untyped-call]
        found = [dr.select(density > 0.0, value / density, 0.0) for value in found]
        dr.eval(direction, found)
        light = np.stack([np.array(value) for value in found], axis=-1)
        return direction.numpy().T.reshape(batches, -1, 3), light.reshape(batches, -1, len(found))

    def _arriving(self, drawn: Floats32, light: Floats32) -> Floats32:
        """Return what arrives at the places in one batch, (place, bin, channel), padded to whole packets."""
        cell = np.repeat(np.arange(self.nodes.count), RAYS) * self.bins.count + self.bins.of_directions(drawn)
        size = self.nodes.count * self.bins.count
        channels = np.zeros((size, self.walls.packets * _PACKET), dtype=np.float32)
        for k in range(light.shape[-1]):
            channels[:, k] = np.bincount(cell, weights=light[:, k] / RAYS, minlength=size)
        return np.asarray(self.nodes.weights @ channels.reshape(self.nodes.count, -1))

    def _drawn(self, si: Any, numbers: Sequence[Any]) -> tuple[Any, Any]:
        """Return directions from nodes, drawn as the coat reflects and along the guide, and their density."""
        bsdf, context, guide = si.bsdf(), mi.BSDFContext(), self.paths.guide
        spot = mi.Point2f(numbers[0], numbers[1])
        sample, _ = bsdf.sample(context, si, numbers[2], spot)
        way = si.to_world(sample.wo)
        if guide is None:
            return way, bsdf.pdf(context, si, si.to_local(way))
        lobes = guide.lobes(si, mi.Bool(True))
        chance = dr.select(guide.known(lobes), GUIDE_CHANCE, 0.0)
        way = dr.select(numbers[3] < chance, guide.direction(lobes, numbers[2], spot), way)
        usual = bsdf.pdf(context, si, si.to_local(way))
        return way, usual + chance * (guide.density(lobes, way) - usual)

    def straight(self, scene: Any, si: Any, bsdf: Any, numbers: Sequence[Any], active: Any) -> list[Any]:
        """Return what points of the coat send on of the light straight from the walls, per channel."""
        sums = [mi.Float(0) for _ in self.chains]
        for wall in range(len(WALLS)):
            sample = numbers[3 * wall : 3 * wall + 3]
            seen, direction, solid_angle, place = self.walls.aim(scene, si, wall, sample, active)
            value = bsdf.eval(mi.BSDFContext(), si, si.to_local(direction), seen) * solid_angle
            glow = self.walls.at(place, mi.Bool(wall == 1), self.batch_of_lane, seen)
            for k, band in enumerate(self.band_of):
                sums[k] += dr.select(seen, value[band] * glow[k], 0)
        return sums

    def film(self, si: Any, transmitted: bool) -> Any:
        """Return what a film on the inner face changes for rays that meet it."""
        return mi.Float(1) if self.paths.face.film is None else self.paths.film_factor(si, mi.Bool(transmitted))

    def sample(
        self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
    ) -> tuple[Any, Any, Any]:
        """Return radiance along rays, as :meth:`sim.optics._band_paths.BandPaths.sample` does."""
        return _seen_radiance(self, scene, sampler, ray)


class Nodes:
    """Points on the coat, how the camera looks at each, and which of them stand for a place, with what weight."""

    def __init__(self, finger: LoadedScene, seen_uv: Floats, legs: Floats) -> None:
        pad, coat = finger.design.pad, PositionMap.of(finger.shape.surfaces["coat"], "coat")
        self.sizes = np.array([pad.width_mm, pad.length_mm])
        uv = self._grid(NODE_MM)
        normals, points = coat.normals(uv), coat.positions_mm(uv)
        self.count = len(uv)
        self.coat = mi.ShapePtr(next(shape for shape in finger.scene.shapes() if shape.id() == "coat"))
        dr.make_opaque(self.coat)
        _, nearest = cKDTree(seen_uv * self.sizes).query(uv * self.sizes)
        rows = np.zeros((len(uv), 3, 4))
        rows[:, 0, :3], rows[:, 0, 3] = points - _BELOW_MM * normals, uv[:, 0] > 0.5
        rows[:, 1, :3], rows[:, 2, :3] = normals, legs[nearest]
        self.table = LookupTable(rows.reshape(-1, 4), mi)
        places = self._grid(_PLACE_MM)
        self.across, self.along = (len(np.unique(places[:, k])) for k in (0, 1))
        depth = coat.positions_mm(places)[:, 1], points[:, 1]
        self.weights = regression_weights(places * self.sizes, uv * self.sizes, *depth)

    def _grid(self, step_mm: tuple[float, float]) -> Floats:
        """Return a grid over the coat (n, 2), across running first."""
        ends = [
            np.linspace(_RIM_MM / size, 1.0 - _RIM_MM / size, 2 * round(size / (2.0 * step)))
            for size, step in zip(self.sizes, step_mm, strict=True)
        ]
        return np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 2)

    def seen(self, scene: Any, number: Any) -> Any:
        """Return the interactions of nodes, seen as the camera sees them.

        A ray to a vertex or an edge of the mesh may slip through it: then the node is taken a little beside that.
        """
        start, normal, look = (self.table.row(number * 3 + k) for k in range(3))
        towards = mi.Vector3f(normal.x, normal.y, normal.z)
        # towards the middle of the pad
        beside = mi.Vector3f(_BESIDE_MM, 0.0, _BESIDE_MM) * dr.select(start.w > 0.0, -1.0, 1.0)
        origin: Any = mi.Point3f(start.x, start.y, start.z)
        si = scene.ray_intersect(mi.Ray3f(origin, towards))
        slipped = ~si.is_valid() | (si.shape != self.coat)
        si = dr.select(slipped, scene.ray_intersect(mi.Ray3f(origin + beside, towards), slipped), si)
        si.wi = si.to_local(-mi.Vector3f(look.x, look.y, look.z))
        return si

    def near(self, uv: Any, chances: Sequence[Any]) -> Any:
        """Return the number of one of the four places around points, drawn by its bilinear weight."""
        picked = []
        for place, count, size, chance in zip(
            (uv.x, uv.y), (self.across, self.along), self.sizes.tolist(), chances, strict=True
        ):
            rim = _RIM_MM / size
            x = dr.clip((place - rim) / (1.0 - 2.0 * rim), 0.0, 1.0) * (count - 1)
            i = cell_at(x, count - 1)
            picked.append(i + dr.select(chance < x - mi.Float(i), mi.UInt32(1), mi.UInt32(0)))
        return picked[1] * self.across + picked[0]


@dataclass(frozen=True, slots=True)
class DirectionBins:
    """Bins of equal solid angle: rows of the cosine to the pad's inward axis from `lowest_cosine` to 1, and turns."""

    lowest_cosine: float
    rows: int

    @classmethod
    def of(cls, directions: Floats32) -> "DirectionBins":
        """Return bins that hold all these directions (..., 3)."""
        lowest = min(0.0, -float(directions[..., 1].max()))
        rows = int(np.ceil(_ROWS * (1.0 - lowest)))
        return cls(1.0 - rows / _ROWS, rows)

    @property
    def count(self) -> int:
        """Number of bins."""
        return self.rows * _TURNS

    def of_directions(self, directions: Floats32) -> NDArray[np.int64]:
        """Return the number of the bin of each direction (..., 3)."""
        row = np.floor((-directions[..., 1] - self.lowest_cosine) * _ROWS)
        turn = np.floor((np.arctan2(directions[..., 2], directions[..., 0]) / (2.0 * np.pi) + 0.5) * _TURNS)
        rows, turns = np.clip(row, 0, self.rows - 1), np.clip(turn, 0, _TURNS - 1)
        return np.asarray(rows * _TURNS + turns, dtype=np.int64)

    def direction(self, number: Any, x: Any, y: Any) -> Any:
        """Return directions in bins, at shares x and y of their rows and turns."""
        row = number // _TURNS
        cosine = self.lowest_cosine + (mi.Float(row) + x) / _ROWS
        sine = dr.safe_sqrt(1.0 - cosine * cosine)
        turn = 2.0 * dr.pi * ((mi.Float(number - row * _TURNS) + y) / _TURNS - 0.5)
        return mi.Vector3f(sine * dr.cos(turn), -cosine, sine * dr.sin(turn))


def regression_weights(places_mm: Floats, nodes_mm: Floats, depth_mm: Floats, node_depth_mm: Floats) -> Floats32:
    r"""Return the weights (place, node) by which values at nodes stand for those at places: local regression.

    .. math:: \min_c \sum_n k_n (y_n - c \cdot b(p_n - p))^2, \quad b = (1, x, z, x^2, x z, z^2, h), \quad w_n = c_0

    with the kernel :math:`k = 1 - r^2` in the ellipse of :data:`_REACH_MM` around the place and the height h of the
    coat. Exact for what is quadratic in place and linear in height; to fourth order for what is smooth.

    Parameters
    ----------
    places_mm, nodes_mm
        (x, z) on the undeformed pad, (n, 2).
    depth_mm, node_depth_mm
        Height of the coat there, (n,).
    """
    weights = np.zeros((len(places_mm), len(nodes_mm)), dtype=np.float32)
    for start in range(0, len(places_mm), 256):
        here = slice(start, start + 256)
        away = (nodes_mm[None] - places_mm[here, None]) / _REACH_MM
        kernel = np.maximum(1.0 - (away**2).sum(axis=-1), 0.0)
        height = (node_depth_mm[None] - depth_mm[here, None]) / _REACH_MM[0]
        x, z = away[..., 0], away[..., 1]
        basis = np.stack([np.ones_like(x), x, z, x * x, x * z, z * z, height], axis=-1)
        weighted = basis * kernel[..., None]
        gram = np.swapaxes(weighted, 1, 2) @ basis
        # a flat coat does not tell what the height does
        gram[:, -1, -1] += _HEIGHT_PRIOR * gram[:, 0, 0]
        first = np.zeros((len(gram), basis.shape[-1], 1))
        first[:, 0] = 1.0
        weights[here] = (weighted @ np.linalg.solve(gram, first))[..., 0]
    return weights


@dr.syntax
def _follow(gathers, scene, sampler, ray, batch):  # type: ignore[no-untyped-def]
    """Return what arrives along rays from the coat, per channel, but for what comes straight from walls and panels."""
    paths, walls, ray = gathers.paths, gathers.walls, mi.Ray3f(ray)
    throughput: Any = mi.Color3f(1)
    sums = [mi.Float(0) for _ in gathers.chains]
    depth, eta, active = mi.UInt32(0), mi.Float(1), mi.Bool(True)
    state, straight = mi.UInt32(FROM_SURFACE), mi.Bool(True)
    gathers.batch_of_lane = batch
    while dr.hint(active, max_iterations=MAX_DEPTH):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        front = mi.Frame3f.cos_theta(si.wi) > 0
        sums[2] += dr.select(active & front, throughput.z * paths.panel_met(si, state), 0)
        is_green = si.shape == paths.green
        on_wall = active & front & (is_green | (si.shape == paths.red))
        glow = walls.at(si, is_green, batch, on_wall & ~straight)
        for k in range(len(sums)):
            sums[k] += dr.select(on_wall & ~straight, throughput[gathers.band_of[k]] * glow[k], 0)
        active &= ~on_wall & ((depth + 1) < MAX_DEPTH)
        on_coat = active & ~front & (si.shape == paths.coat)
        seen, direction, weight = paths.connect(scene, si, sampler.next_2d(on_coat), on_coat)
        bsdf = si.bsdf(ray)
        value, chosen, onward, usual, guided = paths.scatter(si, bsdf, sampler, direction, on_coat, active)
        sums[2] += dr.select(seen, throughput.z * value.z * weight, 0)
        numbers = [sampler.next_1d(on_coat) for _ in range(6)]
        lit = gathers.straight(scene, si, bsdf, numbers, on_coat)
        for k in range(len(sums)):
            sums[k] += dr.select(on_coat, throughput[gathers.band_of[k]] * lit[k], 0)
        smooth = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
        transmitted = smooth & mi.has_flag(chosen.sampled_type, mi.BSDFFlags.DeltaTransmission)
        carried_usually = dr.max(throughput * usual)
        throughput *= guided
        on_inner = si.shape == paths.inner
        if dr.hint(paths.face.film is not None, mode="scalar"):
            throughput *= dr.select(on_inner & smooth, paths.film_factor(si, transmitted), 1)
        eta *= dr.select(smooth, chosen.eta, 1.0)
        state = state_after(state, smooth, transmitted & on_inner & ~front)
        straight = on_coat
        ray = si.spawn_ray(onward)
        depth += 1
        active &= dr.max(throughput) > 0
        survival = dr.minimum(carried_usually * eta * eta, LARGEST_SURVIVAL)
        survival = dr.select((depth >= ROULETTE_DEPTH) & ~smooth, survival, 1.0)
        active &= sampler.next_1d(active) < survival
        throughput /= survival
    return sums


def _straight_light(gathers: SharedGathers, scene: Any, si: Any, shift: Sequence[Any], number: Any, active: Any) -> Any:
    """Return what one point on each wall and one on the panels bring to the camera, per channel."""
    bsdf = si.bsdf()
    x = [_spread(shift[k], number, _STEPS_4[k % 4]) for k in range(8)]
    seen, direction, weight = gathers.paths.connect(scene, si, mi.Point2f(x[6], x[7]), active)
    value = bsdf.eval(mi.BSDFContext(), si, si.to_local(direction), seen)
    lit = gathers.straight(scene, si, bsdf, x[:6], active)
    lit[2] += dr.select(seen, value.z * weight, 0)
    return lit


def _shared_light(gathers: SharedGathers, si: Any, shift: Sequence[Any], number: Any, active: Any) -> Any:
    """Return what light from some of the directions brings to the camera, per channel: all together at each number."""
    bins, packets = gathers.bins, gathers.walls.packets
    # evenly spread over the bins, from a random start
    among = (mi.Float(number) + shift[3]) * (bins.count / gathers.counts.directions)
    chosen = cell_at(among, bins.count)
    x, y, u, v = (_spread(shift[k], number, step) for k, step in zip((0, 1, 2, 4), _STEPS_4, strict=True))
    direction = si.to_local(bins.direction(chosen, x, y))
    value = si.bsdf().eval(mi.BSDFContext(), si, direction, active) * (bins.count / gathers.counts.directions)
    place = gathers.batch_of_lane * (gathers.nodes.across * gathers.nodes.along) + gathers.nodes.near(si.uv, (u, v))
    row = (place * bins.count + chosen) * packets
    light = [gathers.light.row(row + packet, active) for packet in range(packets)]
    return [value[band] * light[k // _PACKET][k % _PACKET] for k, band in enumerate(gathers.band_of)]


@dr.syntax
def _coat_radiance(gathers, scene, si, shift, active):  # type: ignore[no-untyped-def]
    """Return the radiance of points of the coat, per channel."""
    sums = [mi.Float(0) for _ in gathers.chains]
    points, directions = (dr.opaque(mi.UInt32, n) for n in (gathers.counts.points, gathers.counts.directions))
    number = mi.UInt32(0)
    while active & (number < points):
        found = _straight_light(gathers, scene, si, shift, number, active)
        for k in range(len(sums)):
            sums[k] += found[k] / gathers.counts.points
        number += 1
    number = mi.UInt32(0)
    while active & (number < directions):
        found = _shared_light(gathers, si, shift, number, active)
        for k in range(len(sums)):
            sums[k] += found[k]
        number += 1
    return sums


def _seen_radiance(gathers: SharedGathers, scene: Any, sampler: Any, ray: Any) -> tuple[Any, Any, Any]:
    """Return radiance along rays from the camera as :meth:`SharedGathers.sample` does."""
    gathers.batch_of_lane = gathers.batch
    rest, weight = ray, mi.Float(1)
    sums = [mi.Float(0) for _ in gathers.chains]
    for _ in range(_SIGHTS):
        sight = _Sight.along(gathers, scene, rest)
        glow = gathers.walls.at(sight.si, sight.on_green, gathers.batch, sight.on_wall)
        shift = [sampler.next_1d() for _ in range(8)]
        lit = _coat_radiance(gathers, scene, sight.si, shift, sight.on_coat)  # type: ignore[no-untyped-call]
        for k in range(len(sums)):
            met = dr.select(sight.on_coat, lit[k], dr.select(sight.on_wall, glow[k], 0))
            sums[k] += weight * sight.through * met
        rest, weight = sight.rest, weight * sight.rest_weight
    others, valid, further = gathers.paths.sample(scene, sampler, rest)  # type: ignore[no-untyped-call]
    sums = [own + weight * other for own, other in zip(sums, [others.x, others.y, others.z, *further], strict=True)]
    return mi.Color3f(sums[0], sums[1], sums[2]), valid, sums[3:]


def _spread(shift: Any, number: Any, step: float) -> Any:
    """Return evenly spread numbers in 0..1."""
    x = dr.fma(mi.Float(number), step, shift)
    return x - dr.floor(x)


@dataclass(frozen=True, slots=True)
class _Sight:
    """How rays from the camera go by the mirror through the inner face, and what is left for the path tracer.

    Attributes
    ----------
    found, on_coat, on_wall, on_green
        Whether the ray goes this way and meets coat or wall; which, and whether it is the green wall.
    si
        What is met.
    through
        Radiance at the camera per radiance there.
    rest, rest_weight
        The rays that the path tracer follows and their weight: what the face reflects, or where the way is another
        one, the ray itself.
    """

    found: Any
    on_coat: Any
    on_wall: Any
    on_green: Any
    si: Any
    through: Any
    rest: Any
    rest_weight: Any

    @classmethod
    def along(cls, gathers: SharedGathers, scene: Any, ray: Any) -> "_Sight":
        """Follow rays."""
        paths, context = gathers.paths, mi.BSDFContext()
        ray = mi.Ray3f(ray)
        at_mirror = scene.ray_intersect(ray)
        way = at_mirror.is_valid() & (at_mirror.shape == gathers.mirror)
        drawn, mirrored = at_mirror.bsdf().sample(context, at_mirror, mi.Float(0.5), mi.Point2f(0.5), way)
        at_face = scene.ray_intersect(at_mirror.spawn_ray(at_mirror.to_world(drawn.wo)), way)
        way &= at_face.is_valid() & (at_face.shape == paths.inner) & (mi.Frame3f.cos_theta(at_face.wi) > 0)
        # the renderer's glass transmits for numbers near 1 and reflects for numbers near 0
        split = [
            at_face.bsdf().sample(context, at_face, mi.Float(number), mi.Point2f(0.5), way) for number in (1.0, 0.0)
        ]
        weights = [
            dr.select(way, mirrored.x * weight.x * drawn.pdf * gathers.film(at_face, transmitted), 0)
            for (drawn, weight), transmitted in zip(split, (True, False), strict=True)
        ]
        onward, back = (at_face.spawn_ray(at_face.to_world(drawn.wo)) for drawn, _ in split)
        si = scene.ray_intersect(onward, way)
        front = mi.Frame3f.cos_theta(si.wi) > 0
        way &= si.is_valid()
        on_green = way & front & (si.shape == paths.green)
        on_wall = on_green | (way & front & (si.shape == paths.red))
        on_coat = way & ~front & (si.shape == paths.coat)
        found = on_coat | on_wall
        rest = mi.Ray3f(dr.select(found, back.o, ray.o), dr.select(found, back.d, ray.d))
        return cls(found, on_coat, on_wall, on_green, si, weights[0], rest, dr.select(found, weights[1], 1.0))
