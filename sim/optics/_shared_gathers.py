"""Shared gathers: pixels share the light that arrives at nodes of the coat, and read the painted walls themselves.

A path tracer finds the light of each pixel anew, by chance, and most paths find none. Neighbouring pixels see nearly
the same light arrive. Here it is traced once, from nodes spread over the coat, along directions in which the coat
sends light to the camera; each pixel weights it with the coat's reflection at its own point, towards its own ray, by
its own normal. What changes within less than the nodes' distance is left out of that and found by the pixel: the
light straight from the walls, by points drawn on them, straight from the panels, by connections through the gel's
face, and from the panels by mirror and faces, whose image ends sharply. So are the reflections on the way from the
camera.

The walls are Lambertian: what they reflect is part of a map of their whole radiance, traced from the walls as their
emission is, and every path ends where it meets one. Light between nodes is a local regression, and light within a bin
of directions (10 deg around, 1/16 of the cosine) counts as even: that is a bias. It is measured in every picture: the
same paths also tell, without it, what each node sends to the camera. The difference to what a node sends by the shared
light is smoothed over the pad and added (what Tukey called twicing). What is left is that difference less its smooth
part. All else is unbiased.

Import this module only after a compiled variant has been set (see :func:`sim.optics.open_renderer`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from data_schemas import CameraCalibration, SimulateError
from sim.optics._band_paths import BandPaths, LitWalls, band_paths, by_smooth_faces
from sim.optics._mirror_guide import CHOICES, DirectionBins, choices_of
from sim.optics._optical_layout import camera_pose
from sim.optics._paint_bands import BAND_NAMES
from sim.optics._painted_walls import WALLS, WallLight, last_band
from sim.optics._panel_light import FROM_EYE, state_after
from sim.optics._path_rules import LARGEST_SURVIVAL, MAX_DEPTH, ROULETTE_DEPTH, LookupTable, cell_at
from sim.optics._pixel_maps import camera_rays
from sim.optics._position_map import PositionMap, regression_weights
from sim.optics._scene import LoadedScene
from sim.optics._wall_spline import choose_smoother

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

NODE_MM: Final = (1.0, 2.0)
"""Distance of the nodes across and along the pad: across it the light of the walls falls off."""

PLACE_MM: Final = (1.5, 2.5)
"""What arrives is known at places this far apart, across and along; linear between them."""

RAYS: Final = 64
"""Paths of each node in one batch."""

_RIM_MM = 0.137
# nodes start their paths from here below the coat's surface
_BELOW_MM = 0.3
_BESIDE_MM = 7e-3
_PACKET = 4
# chance that paths to the panels by the mirror follow the guide
_GUIDED = 0.8
# places within a bin at which the coat's reflection is averaged, each way
_WITHIN_BIN = 3
# so near to a wall, pixels draw so many times more points
_STEEP_MM, _STEEP_POINTS = 1.5, 4
# of the largest light at a node: what is missed is smoothed relative to it
_LEAST_LIGHT_REL = 1e-3
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
        Directions, of some 600 and mostly those that matter, from which it weights what arrives.
    points
        Points drawn on each wall, and on the panels.
    mirrored
        Paths to the panels by mirror and faces.
    """

    directions: int = 48
    points: int = 8
    mirrored: int = 12

    def at_sight(self, number: int) -> "GatherCounts":
        """Return the work where the coat is seen at first (0) or in what the face reflects, a fortieth as bright."""
        fewer = self if number == 0 else GatherCounts(self.directions // 8, self.points // 4, self.mirrored // 8)
        return GatherCounts(max(1, fewer.directions), max(1, fewer.points), max(1, fewer.mirrored))


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
        self.width = dr.opaque(mi.Float, pad.width_mm)
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
        sight = Sight.along(
            self, scene, mi.Ray3f(mi.Point3f(camera_pose(design).centre_mm.tolist()), mi.Vector3f(directions))
        )
        uv, leg = sight.si.uv, -sight.si.to_world(sight.si.wi)
        dr.eval(sight.on_coat, uv, leg)
        here = sight.on_coat.numpy()
        if not here.any():
            raise SimulateError(
                "light can be shared only between pixels that see the coat through the mirror and the gel's inner "
                "face, but here no pixel does; check mirror and camera in the design, or leave --shared-light out"
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
        drawn, light, sent = (np.concatenate([one[k] for one in traced]) for k in range(3))
        self.bins = DirectionBins.of(drawn)
        table = np.stack([self._arriving(*one) for one in zip(drawn, light, strict=True)])
        reflection = self.nodes.reflection(self.bins)
        shared = self.nodes.sent(reflection, self.band_of, table)
        self._share(table.mean(axis=0), reflection)
        own = np.zeros((*sent.shape[:2], self.walls.packets * _PACKET), dtype=np.float32)
        # all batches look the mean up, which has less noise; how each differs from it is added as nodes see it
        own[..., : sent.shape[-1]] = self.missed_at_nodes(sent, shared) + (shared - shared.mean(axis=0))
        self.own = LookupTable(own.reshape(-1, _PACKET), mi)

    def _share(self, light: Floats32, reflection: Floats32) -> None:
        """Keep the light (place, bin * channel) that all pixels share, and which of its directions matter."""
        self.light = LookupTable(light.reshape(-1, _PACKET), mi)
        by_bin = np.abs(light.reshape(len(light), self.bins.count, -1)[..., : len(self.chains)])
        of_band = [[k for k, band in enumerate(self.band_of) if band == b] for b in range(len(BAND_NAMES))]
        lit = [by_bin[..., channels].sum(axis=-1) for channels in of_band]
        sent = [one * reflection[b, self.nodes.nearest] for b, one in enumerate(lit)]
        self.choices = LookupTable(choices_of(lit, sent).reshape(-1, 2), mi)

    def _traced(self, start: int, batches: int, rng: np.random.Generator) -> tuple[Floats32, Floats32, Floats32]:
        """Return directions of paths from the nodes, (batch, path, 3), and their light over their density.

        Also what each node sends to the camera by its own paths, (batch, node, channel): without bias, and noisy.
        """
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
        # what the guide would find, the pixel finds
        direction, density = self.drawn(si, numbers, 0.0)
        ray = si.spawn_ray(direction)
        found = arriving_light(self, self.finger.scene, sampler, ray, batch + first)  # type: ignore[no-untyped-call]
        found = [dr.select(density > 0.0, value / density, 0.0) for value in found]
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(direction))
        own = [value[band] * one for band, one in zip(self.band_of, found, strict=True)]
        # a sum over lanes evaluates what it adds: one after the other, each channel would trace all paths again
        dr.eval(direction, found, own)
        sent = [dr.block_sum(one, RAYS) / RAYS for one in own]
        light, sent_light = (np.stack([np.array(one) for one in channels], axis=-1) for channels in (found, sent))
        return (
            direction.numpy().T.reshape(batches, -1, 3),
            light.reshape(batches, -1, len(found)),
            sent_light.reshape(batches, -1, len(found)),
        )

    def missed_at_nodes(self, sent: Floats32, shared: Floats) -> Floats:
        """Return what nodes send by their own paths but not by the shared light, smooth by place.

        Both use the same paths, so that most of their noise cancels. Each half of the batches is smoothed as stiffly as
        cross-validation finds for the other half: the mean is linear in the light, and passes show its noise.

        Parameters
        ----------
        sent, shared
            By own paths and by the light at the places, (batch, node, channel).
        """
        along = self.nodes.nodes_along
        usual = shared.mean(axis=0)
        usual = np.maximum(usual, _LEAST_LIGHT_REL * usual.max(axis=0) + np.finfo(np.float32).tiny)
        rest = (sent - shared) / usual
        middle, smooth = len(rest) // 2, np.empty_like(rest)
        for channel in range(rest.shape[-1]):
            halves = [
                half.reshape(len(half), along, -1) for half in (rest[:middle, :, channel], rest[middle:, :, channel])
            ]
            fits = [choose_smoother(half.mean(axis=0), half.var(axis=0, ddof=1) / middle) for half in halves]
            for here, half, fit in zip((slice(middle), slice(middle, None)), halves, fits[::-1], strict=True):
                smooth[here, :, channel] = fit(half).reshape(len(half), -1)
        return np.asarray(smooth * usual)

    def _arriving(self, drawn: Floats32, light: Floats32) -> Floats32:
        """Return what arrives at the places in one batch, (place, bin, channel), padded to whole packets."""
        cell = np.repeat(np.arange(self.nodes.count), RAYS) * self.bins.count + self.bins.of_directions(drawn)
        size = self.nodes.count * self.bins.count
        channels = np.zeros((size, self.walls.packets * _PACKET), dtype=np.float32)
        for k in range(light.shape[-1]):
            channels[:, k] = np.bincount(cell, weights=light[:, k] / RAYS, minlength=size)
        by_bin = channels.reshape(self.nodes.count, self.bins.count, -1)
        # half of the bins point out of the gel, where no path begins
        lit = by_bin.any(axis=(0, 2))
        arriving = np.zeros((len(self.nodes.weights), *by_bin.shape[1:]), dtype=np.float32)
        of_places = self.nodes.weights @ by_bin[:, lit].reshape(self.nodes.count, -1)
        arriving[:, lit] = of_places.reshape(len(arriving), -1, by_bin.shape[-1])
        return arriving.reshape(len(arriving), -1)

    def drawn(self, si: Any, numbers: Sequence[Any], guided_share: float) -> tuple[Any, Any]:
        """Return directions from the coat, drawn as it reflects and, with a chance, by the guide; their density."""
        bsdf, context, guide = si.bsdf(), mi.BSDFContext(), self.paths.guide
        spot = mi.Point2f(numbers[0], numbers[1])
        sample, _ = bsdf.sample(context, si, numbers[2], spot)
        way = si.to_world(sample.wo)
        if guide is None:
            return way, bsdf.pdf(context, si, si.to_local(way))
        lobes = guide.lobes(si, mi.Bool(True))
        chance = dr.select(guide.known(lobes), guided_share, 0.0)
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
        uv = self.grid(NODE_MM)
        normals, points = coat.normals(uv), coat.positions_mm(uv)
        self.count = len(uv)
        self.coat = mi.ShapePtr(next(shape for shape in finger.scene.shapes() if shape.id() == "coat"))
        dr.make_opaque(self.coat)
        _, nearest = cKDTree(seen_uv * self.sizes).query(uv * self.sizes)
        rows = np.zeros((len(uv), 3, 4))
        rows[:, 0, :3], rows[:, 0, 3] = points - _BELOW_MM * normals, uv[:, 0] > 0.5
        rows[:, 1, :3], rows[:, 2, :3] = normals, legs[nearest]
        self.table = LookupTable(rows.reshape(-1, 4), mi)
        places = self.grid(PLACE_MM)
        self.across, self.along = (len(np.unique(places[:, k])) for k in (0, 1))
        self.nodes_across, self.nodes_along = (len(np.unique(uv[:, k])) for k in (0, 1))
        self.scene, self.uv = finger.scene, uv
        depth = coat.positions_mm(places)[:, 1], points[:, 1]
        self.weights = regression_weights(places * self.sizes, uv * self.sizes, *depth)
        self.nearest = cKDTree(uv * self.sizes).query(places * self.sizes)[1]

    def grid(self, step_mm: tuple[float, float]) -> Floats:
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

    def reflection(self, bins: DirectionBins) -> Floats32:
        """Return how nodes reflect light from each direction to the camera, (band, node, bin)."""
        lane: Any = dr.arange(mi.UInt32, self.count * bins.count)
        node = lane // dr.opaque(mi.UInt32, bins.count)
        si, spread = self.seen(self.scene, node), dr.opaque(mi.Float, 1.0 / _WITHIN_BIN)
        chosen, value = lane - node * bins.count, mi.Color3f(0)
        for x in range(_WITHIN_BIN):
            for y in range(_WITHIN_BIN):
                way = si.to_local(bins.direction(chosen, (x + 0.5) * spread, (y + 0.5) * spread))
                value += si.bsdf().eval(mi.BSDFContext(), si, way) / _WITHIN_BIN**2
        return np.asarray(value.numpy().reshape(-1, self.count, bins.count))

    def sent(self, reflection: Floats32, band_of: Sequence[int], table: Floats32) -> Floats:
        """Return what nodes send to the camera by the light at the places, (batch, node, channel)."""
        between = self.between(self.uv)
        sent = np.empty((len(table), self.count, len(band_of)))
        for batch, one in enumerate(table):
            light = one.reshape(len(one), reflection.shape[-1], -1)
            for channel, band in enumerate(band_of):
                here = between @ np.ascontiguousarray(light[..., channel])
                sent[batch, :, channel] = np.einsum("nb,nb->n", reflection[band], here)
        return sent

    def between(self, uv: Floats) -> csr_array:
        """Return the bilinear weights of the places at points (n, 2), as :meth:`near` draws them, (n, place)."""
        cell, share = [], []
        for place, count, size in zip(uv.T, (self.across, self.along), self.sizes, strict=True):
            rim = _RIM_MM / size
            x = np.clip((place - rim) / (1.0 - 2.0 * rim), 0.0, 1.0) * (count - 1)
            cell.append(np.minimum(x.astype(int), count - 2))
            share.append(x - cell[-1])
        corners = [(i, j) for j in (0, 1) for i in (0, 1)]
        columns = np.stack([(cell[1] + j) * self.across + cell[0] + i for i, j in corners], axis=-1)
        weights = np.stack([np.abs(1 - i - share[0]) * np.abs(1 - j - share[1]) for i, j in corners], axis=-1)
        rows = np.repeat(np.arange(len(uv)), len(corners))
        return csr_array((weights.ravel(), (rows, columns.ravel())), shape=(len(uv), self.across * self.along))

    def near(self, uv: Any, chances: Sequence[Any]) -> Any:
        """Return the number of one of the four places around points, drawn by its bilinear weight."""
        (i, s), (j, t) = self._cell(uv, self.across, self.along)
        first, second = (dr.select(chances[k] < share, mi.UInt32(1), mi.UInt32(0)) for k, share in enumerate((s, t)))
        return (j + second) * self.across + i + first

    def around(self, uv: Any) -> list[tuple[Any, Any]]:
        """Return bilinear weight and number of the four nodes around points."""
        (i, s), (j, t) = self._cell(uv, self.nodes_across, self.nodes_along)
        return [
            (up * right, (j + b) * self.nodes_across + i + a)
            for b, up in ((0, 1.0 - t), (1, t))
            for a, right in ((0, 1.0 - s), (1, s))
        ]

    def _cell(self, uv: Any, across: int, along: int) -> list[tuple[Any, Any]]:
        """Return number and share, across and along, of the point of a grid over the coat before points."""
        cells = []
        for place, count, size in zip((uv.x, uv.y), (across, along), self.sizes.tolist(), strict=True):
            rim = _RIM_MM / size
            x = dr.clip((place - rim) / (1.0 - 2.0 * rim), 0.0, 1.0) * (count - 1)
            i = cell_at(x, count - 1)
            cells.append((i, x - mi.Float(i)))
        return cells


@dr.syntax
def arriving_light(gathers, scene, sampler, ray, batch, start=FROM_EYE):  # type: ignore[no-untyped-def]
    """Return the light that is shared, per channel, as it arrives along rays from the coat.

    That is all but what comes straight from the walls, and from the panels by smooth faces alone.
    """
    paths, walls, ray = gathers.paths, gathers.walls, mi.Ray3f(ray)
    throughput: Any = mi.Color3f(1)
    sums = [mi.Float(0) for _ in gathers.chains]
    depth, eta, active = mi.UInt32(0), mi.Float(1), mi.Bool(True)
    # paths that start FROM_EYE stay so until they meet a surface that is not smooth
    state, straight = mi.UInt32(start), mi.Bool(True)
    gathers.batch_of_lane = batch
    while dr.hint(active, max_iterations=MAX_DEPTH):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        front = mi.Frame3f.cos_theta(si.wi) > 0
        sums[2] += dr.select(active & front & (state != FROM_EYE), throughput.z * paths.panel_met(si, state), 0)
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


def mirrored_light(
    gathers: SharedGathers, scene: Any, sampler: Any, si: Any, shift: Sequence[Any], number: Any, active: Any
) -> Any:
    """Return what one path to the panels by mirror and faces, but not straight, brings to the camera."""
    way, density = gathers.drawn(si, [_spread(shift[k + 3], number, _STEPS_4[k]) for k in range(4)], _GUIDED)
    value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(way), active)
    carried = dr.select(active & (density > 0.0), value.z / density, 0.0)
    return by_smooth_faces(gathers.paths, scene, sampler, si.spawn_ray(way), carried)  # type: ignore[no-untyped-call]


def straight_light(gathers: SharedGathers, scene: Any, si: Any, shift: Sequence[Any], number: Any, active: Any) -> Any:
    """Return what one point on each wall and one on the panels bring to the camera, per channel."""
    bsdf = si.bsdf()
    x = [_spread(shift[k], number, _STEPS_4[k % 4]) for k in range(8)]
    seen, direction, weight = gathers.paths.connect(scene, si, mi.Point2f(x[6], x[7]), active)
    value = bsdf.eval(mi.BSDFContext(), si, si.to_local(direction), seen)
    lit = gathers.straight(scene, si, bsdf, x[:6], active)
    lit[2] += dr.select(seen, value.z * weight, 0)
    return lit


def shared_light(gathers: SharedGathers, si: Any, shift: Sequence[Any], number: Any, of: Any, active: Any) -> Any:
    """Return what light from some of the directions brings to the camera, per channel: all together at each number."""
    bins, packets, nodes = gathers.bins, gathers.walls.packets, gathers.nodes
    x, y, u, v = (_spread(shift[k], number, step) for k, step in zip((0, 1, 2, 4), _STEPS_4, strict=True))
    place = nodes.near(si.uv, (u, v))
    # evenly spread over the list, from a random start
    listed = cell_at((mi.Float(number) + shift[3]) * (CHOICES / of), CHOICES)
    choice = gathers.choices.row(place * CHOICES + listed, active)
    chosen = cell_at(choice.x, bins.count)
    direction = si.to_local(bins.direction(chosen, x, y))
    value = si.bsdf().eval(mi.BSDFContext(), si, direction, active) * (choice.y / of)
    row = (place * bins.count + chosen) * packets
    light = [gathers.light.row(row + packet, active) for packet in range(packets)]
    return [value[band] * light[k // _PACKET][k % _PACKET] for k, band in enumerate(gathers.band_of)]


def own_light(gathers: SharedGathers, si: Any, active: Any) -> list[Any]:
    """Return what is to be added to the shared light, per channel.

    That is what it misses of what comes to the camera, and how this batch of it differs from the mean.
    """
    nodes, packets = gathers.nodes, gathers.walls.packets
    sums = [mi.Float(0) for _ in gathers.chains]
    for weight, number in nodes.around(si.uv):
        row = (gathers.batch_of_lane * nodes.count + number) * packets
        light = [gathers.own.row(row + packet, active) for packet in range(packets)]
        sums = [one + weight * light[k // _PACKET][k % _PACKET] for k, one in enumerate(sums)]
    return [dr.select(active, one, 0.0) for one in sums]


@dr.syntax
def _coat_radiance(gathers, scene, sampler, si, shift, counts, active):  # type: ignore[no-untyped-def]
    """Return the radiance of points of the coat, per channel."""
    sums = own_light(gathers, si, active)
    points, mirrored, directions = (
        dr.opaque(mi.UInt32, n) for n in (counts.points, counts.mirrored, counts.directions)
    )
    # beside a wall its light is steep
    beside = dr.minimum(si.uv.x, 1.0 - si.uv.x) * gathers.width < _STEEP_MM
    points *= dr.select(beside, mi.UInt32(_STEEP_POINTS), mi.UInt32(1))
    number = mi.UInt32(0)
    while active & (number < points):
        found = straight_light(gathers, scene, si, shift, number, active)
        for k in range(len(sums)):
            sums[k] += found[k] / mi.Float(points)
        number += 1
    number = mi.UInt32(0)
    while active & (number < mirrored):
        sums[2] += mirrored_light(gathers, scene, sampler, si, shift, number, active) / mi.Float(mirrored)
        number += 1
    number = mi.UInt32(0)
    while active & (number < directions):
        found = shared_light(gathers, si, shift, number, mi.Float(directions), active)
        for k in range(len(sums)):
            sums[k] += found[k]
        number += 1
    return sums


def _seen_radiance(gathers: SharedGathers, scene: Any, sampler: Any, ray: Any) -> tuple[Any, Any, Any]:
    """Return radiance along rays from the camera as :meth:`SharedGathers.sample` does."""
    gathers.batch_of_lane = gathers.batch
    rest, weight = ray, mi.Float(1)
    sums = [mi.Float(0) for _ in gathers.chains]
    for number in range(_SIGHTS):
        sight = Sight.along(gathers, scene, rest)
        glow = gathers.walls.at(sight.si, sight.on_green, gathers.batch, sight.on_wall)
        shift = [sampler.next_1d() for _ in range(8)]
        counts = gathers.counts.at_sight(number)
        lit = _coat_radiance(  # type: ignore[no-untyped-call]
            gathers, scene, sampler, sight.si, shift, counts, sight.on_coat
        )
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
class Sight:
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
    def along(cls, gathers: SharedGathers, scene: Any, ray: Any) -> "Sight":
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
