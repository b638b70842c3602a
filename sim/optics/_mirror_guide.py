"""Directions in which the coating sees the light panels by the mirror: learned from light paths, drawn along eye paths.

A panel seen by the mirror fills a small solid angle, so paths that scatter at the coating meet it rarely and then bring
much: these few carried nine tenths of the variance of the LED band beside the indenter. Light paths sent from the
panels to the mirror, directly or by the outside of the gel, tell where on the coating their light arrives and from
where. Per cell of the coating and per route a normal distribution of directions describes them; eye paths draw from it
with a fixed chance, else from the material, and are weighted by the density of the mixture, so that whatever was
learned, the mean stays the same. Bins of directions, and lists of those that matter, serve pixels that share light.

Import this module only after a compiled variant has been set (see :func:`sim.optics.open_renderer`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from sim.optics._panel_light import Panel, panel_point
from sim.optics._path_rules import LookupTable, cell_at

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

GUIDE_CHANCE = 0.2
"""Chance that a path leaves the coating along the guide: the painted bands lose this share of their paths."""

LIGHT_PATHS = 200_000

CHOICES = 4096
"""Length of the lists of :func:`choices_of`."""

# directions are told apart by their height over the coat, rows per unit of its cosine, and by their turn
_ROWS, _TURNS = 16, 36
# directions are listed to that share as they are lit, for the rest also as the coat reflects at the place: a pixel in a
# dent has another normal
_AS_LIT = 0.3
_LONGEST_ROUTE = 10
# what a light path has arrived at
_AT_COAT, _AT_RED, _AT_GREEN = 1, 2, 3
_SMALLEST_COSINE = 1e-3
_LIFT_MM = 1e-3


class LightPanels(Protocol):
    """The panels and surfaces of :class:`sim.optics._band_paths.BandPaths`."""

    panels: list[Panel]
    inner: Any
    coat: Any
    red: Any
    green: Any


class Lobe(NamedTuple):
    """One route's directions at a point: chance, mean slopes, and the Cholesky factor of their covariance."""

    chance: Any
    mean: tuple[Any, Any]
    factor: tuple[Any, Any, Any]


class MirrorGuide:
    """The learned directions as the renderer's numbers.

    Directions are slopes (x / -y, z / -y): all point from the coating to the inner face.
    """

    def __init__(self, lobes: Floats, walls: Mapping[str, "WallGuide"] | None = None) -> None:
        self.table = LookupTable(lobes.reshape(-1, 4), mi)
        self.walls = dict(walls or {})

    def lobes(self, si: Any, active: Any) -> list[Lobe]:
        """Return the routes at points of the coating."""
        u, v = si.uv.x * CELLS_ACROSS, si.uv.y * CELLS_ALONG
        i, j = cell_at(u, CELLS_ACROSS), cell_at(v, CELLS_ALONG)
        x, y = u - mi.Float(i) - 0.5, v - mi.Float(j) - 0.5
        found = []
        for route in range(ROUTES):
            first = ((i * CELLS_ALONG + j) * ROUTES + route) * (NUMBERS // 4)
            a, b, c = (self.table.row(first + k, active) for k in range(3))
            mean = (a.y + x * a.w + y * b.y, a.z + x * b.x + y * b.z)
            found.append(Lobe(a.x, mean, (b.w, c.x, c.y)))
        return found

    def known(self, lobes: Sequence[Lobe]) -> Any:
        """Return where any route is known."""
        return sum((lobe.chance for lobe in lobes), start=mi.Float(0)) > 0.0

    def direction(self, lobes: Sequence[Lobe], chosen: Any, sample: Any) -> Any:
        """Return a unit direction drawn from the routes."""
        normal = mi.warp.square_to_std_normal(sample)
        slope_x, slope_z, passed = mi.Float(0), mi.Float(0), mi.Float(0)
        for lobe in lobes:
            here = (chosen >= passed) & (lobe.chance > 0.0)
            l00, l10, l11 = lobe.factor
            slope_x = dr.select(here, lobe.mean[0] + l00 * normal.x, slope_x)
            slope_z = dr.select(here, lobe.mean[1] + l10 * normal.x + l11 * normal.y, slope_z)
            passed += lobe.chance
        return dr.normalize(mi.Vector3f(slope_x, -1.0, slope_z))

    def density(self, lobes: Sequence[Lobe], direction: Any) -> Any:
        """Return the density of :meth:`direction` per solid angle; zero where no route is known."""
        down: Any = -direction.y
        usable = down > _SMALLEST_COSINE
        per_down = dr.rcp(dr.select(usable, down, 1.0))
        slope_x, slope_z = direction.x * per_down, direction.z * per_down
        total = mi.Float(0)
        for lobe in lobes:
            l00, l10, l11 = lobe.factor
            a = (slope_x - lobe.mean[0]) / l00
            b = (slope_z - lobe.mean[1] - l10 * a) / l11
            total += lobe.chance * dr.exp(-0.5 * (a * a + b * b)) / (2.0 * dr.pi * l00 * l11)
        return dr.select(usable, total * per_down * per_down * per_down, 0.0)


def learn_guide(scene: Any, panels: LightPanels) -> MirrorGuide:
    """Send light from the panels to the mirror and learn where the coating receives it from.

    Always with the same random numbers: they change the noise of what is rendered with the guide, not the mean.

    Parameters
    ----------
    scene
        From :func:`sim.optics._scene.finger_scene`.
    panels
        Its band path tracer.
    """
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, LIGHT_PATHS)
    mirror = next(shape for shape in scene.shapes() if shape.id() == "mirror")
    found = _light_paths(panels, mirror, scene, sampler)  # type: ignore[no-untyped-call]
    dr.eval(found)  # else each of them would compile and trace the paths by itself
    arrived, uv, towards, light, route = (np.array(values) for values in found)

    def lobes_at(number: int, cells: tuple[int, int], rare: int) -> Floats:
        useful = (arrived == number) & (towards[1] < -_SMALLEST_COSINE) & (light > 0.0)
        slopes = (towards[::2, useful] / -towards[1, useful]).T.astype(np.float64)
        return fit_lobes(uv[:, useful].T.astype(np.float64), slopes, light[useful], route[useful], cells, rare)

    walls = {wall: WallGuide(lobes_at(at, WALL_CELLS, 0)) for wall, at in (("red", _AT_RED), ("green", _AT_GREEN))}
    return MirrorGuide(lobes_at(_AT_COAT, (CELLS_ACROSS, CELLS_ALONG), 1), walls)


@dr.syntax
def _light_paths(panels, mirror, scene, sampler):  # type: ignore[no-untyped-def]
    """Return (what it arrived at, where, direction to the light, light, route) of paths by the mirror."""
    start, (normal, exponent), light = panel_point(panels.panels, sampler.next_2d())
    by_face, spot = sampler.next_1d() < 0.5, sampler.next_2d()
    face = next(shape for shape in scene.shapes() if shape.id() == "inner")
    to_mirror, to_face = mirror.sample_position(0.0, spot), face.sample_position(0.0, spot)
    aim = mi.Point3f(dr.select(by_face, to_face.p, to_mirror.p))
    target = dr.select(by_face, dr.rcp(to_face.pdf), dr.rcp(to_mirror.pdf)) / dr.squared_norm(aim - start)
    direction = dr.normalize(aim - start)
    target *= dr.abs(dr.dot(direction, dr.select(by_face, to_face.n, to_mirror.n)))
    light *= target * dr.power(dr.maximum(dr.dot(direction, normal), 0.0), exponent)
    ray = mi.Ray3f(start + normal * _LIFT_MM, direction)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    uv, towards = mi.Point2f(0), mi.Vector3f(0)
    active, arrived = light > 0.0, mi.UInt32(0)
    mirrors, outsides, others, depth = mi.UInt32(0), mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)
    while dr.hint(active):
        si = scene.ray_intersect(ray, active)
        active &= si.is_valid()
        front = mi.Frame3f.cos_theta(si.wi) > 0
        at = dr.select(~front & (si.shape == panels.coat), mi.UInt32(_AT_COAT), 0)
        at = dr.select(front & (si.shape == panels.red), _AT_RED, at)
        at = dr.select(front & (si.shape == panels.green), _AT_GREEN, at)
        here = active & (at > 0)
        uv, towards = dr.select(here, si.uv, uv), dr.select(here, -ray.d, towards)
        arrived = dr.select(here, at, arrived)
        active &= ~here
        outside = (si.shape == panels.inner) & front
        # the renderer's glass reflects for numbers near 0 and transmits for numbers near 1, and returns that chance
        reflects = (sampler.next_1d(active) < 0.5) | (by_face & (depth == 0))
        number = dr.select(outside, dr.select(reflects, 0.0, 1.0), sampler.next_1d(active))
        drawn, weight = si.bsdf(ray).sample(context, si, number, sampler.next_2d(active), active)
        active &= mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        through = mi.has_flag(drawn.sampled_type, mi.BSDFFlags.DeltaTransmission)
        on_mirror = si.shape == mi.ShapePtr(mirror)
        mirrors += dr.select(active & on_mirror, 1, 0)
        outsides += dr.select(active & outside & ~through, 1, 0)
        others += dr.select(active & ~on_mirror & ~outside, 1, 0)
        light = dr.select(active, light * weight.z * dr.select(outside, drawn.pdf, 1.0), light)
        ray = si.spawn_ray(si.to_world(drawn.wo))
        depth += 1
        active &= depth < _LONGEST_ROUTE
    route = dr.select((mirrors == 1) & (outsides < 2), outsides, ROUTES - 1)
    route = dr.select((mirrors == 2) & (outsides == 1), 2, route)
    arrived = dr.select(mirrors > 0, arrived, 0)
    return arrived, uv, towards, light, dr.select(others > 0, ROUTES - 1, route)


class WallGuide:
    """The learned directions at one painted wall, as numbers of numpy; slopes as in :class:`MirrorGuide`.

    Parameters
    ----------
    lobes
        From :func:`fit_lobes` with :data:`WALL_CELLS`, the place up the wall in the place of that across.
    """

    def __init__(self, lobes: Floats) -> None:
        self.lobes = lobes

    def mixed(self, uv: Floats, inward: Floats, usual: Floats, numbers: Floats) -> tuple[Floats, Floats]:
        r"""Turn a part of the directions from a wall along the guide.

        Parameters
        ----------
        uv, inward
            Texture coordinates (up, along) of the points, shape (n, 2), and normals into the gel, (n, 3).
        usual
            Directions distributed by their cosine, shape (n, 3).
        numbers
            Evenly spread in 0 to 1 and independent of `usual`, shape (n, 4).

        Returns
        -------
        directions
            Shape (n, 3).
        weight
            :math:`(\cos / \pi) / p` with the density p of the mixture, shape (n,): means of radiance times weight are
            those over directions that are distributed by their cosine.
        """
        lobes = self._lobes_at(uv)
        known = lobes[..., 0].sum(axis=1) > 0.0
        route = np.minimum((np.cumsum(lobes[..., 0], axis=1) <= numbers[:, 1:2]).sum(axis=1), ROUTES - 1)
        chosen = np.take_along_axis(lobes, route[:, None, None], axis=1)[:, 0]
        p, q = ndtri(np.clip(numbers[:, 2:], _SMALLEST_CHANCE, 1.0 - _SMALLEST_CHANCE)).T
        slope_x, slope_z = chosen[:, 1] + chosen[:, 3] * p, chosen[:, 2] + chosen[:, 4] * p + chosen[:, 5] * q
        drawn = np.column_stack([slope_x, np.full(len(uv), -1.0), slope_z])
        drawn /= np.linalg.norm(drawn, axis=1, keepdims=True)
        directions = np.where((known & (numbers[:, 0] < WALL_GUIDE_CHANCE))[:, None], drawn, usual)
        by_cosine = np.maximum(np.einsum("ni,ni->n", directions, inward), 0.0) / np.pi
        density = WALL_GUIDE_CHANCE * self._density(lobes, directions) + (1.0 - WALL_GUIDE_CHANCE) * by_cosine
        return directions, np.where(known, by_cosine / np.where(known, density, 1.0), 1.0)

    def _lobes_at(self, uv: Floats) -> Floats:
        """Return chance, mean slopes and Cholesky factor (00, 10, 11) at points, (n, ROUTES, 6)."""
        place = uv * WALL_CELLS
        i, j = np.minimum(place.astype(np.int64), np.array(WALL_CELLS) - 1).T
        found = self.lobes[i * WALL_CELLS[1] + j]
        x, y = (place - np.stack([i, j], axis=-1) - 0.5).T[:, :, None, None]
        mean = found[..., 1:3] + x * found[..., 3:5] + y * found[..., 5:7]
        return np.concatenate([found[..., :1], mean, found[..., 7:10]], axis=-1)

    def _density(self, lobes: Floats, directions: Floats) -> Floats:
        """Return the density per solid angle of the guide's directions."""
        down = np.maximum(-directions[:, 1], _SMALLEST_COSINE)
        chance, mean_x, mean_z, l00, l10, l11 = np.moveaxis(lobes, -1, 0)
        width = np.where(chance > 0.0, l00 * l11, 1.0)
        a = (directions[:, :1] / down[:, None] - mean_x) / np.where(chance > 0.0, l00, 1.0)
        b = (directions[:, 2:] / down[:, None] - mean_z - l10 * a) / np.where(chance > 0.0, l11, 1.0)
        per_slopes = (chance * np.exp(-0.5 * (a**2 + b**2)) / (2.0 * np.pi * width)).sum(axis=1)
        return np.asarray(np.where(-directions[:, 1] > _SMALLEST_COSINE, per_slopes / down**3, 0.0))


WALL_GUIDE_CHANCE = 0.25
"""Chance that a path leaves a painted wall along the guide."""

WALL_CELLS = 3, 14
"""Cells up and along a wall, larger than the coat's: fewer light paths arrive there."""

_SMALLEST_CHANCE = 1e-9

CELLS_ACROSS, CELLS_ALONG = 12, 24
ROUTES = 4
"""One mirror; mirror and outside of the gel; both and the mirror again; all others, such as through an end."""

NUMBERS = 12
"""Of a route in a cell: chance, mean and its change across and along, Cholesky factor, and two zeros: three packets."""

_FEWEST_PATHS = 12
# the distribution is wider than what was learned: it must cover the panel's corners, which fewer light paths met
_WIDENING = 1.3
_LEAST_SPREAD = 0.01
# weight of the prior "no change within a cell" against the spread of the light paths over it
_STIFFNESS = 0.01
# a route's chance follows the root of its light: weak routes pass the faces by chance, so that each needs more paths
_BALANCE = 0.5


def fit_lobes(
    uv: Floats,
    slopes: Floats,
    light: Floats,
    route: NDArray[np.integer[Any]],
    cells: tuple[int, int] = (CELLS_ACROSS, CELLS_ALONG),
    rare: int = 1,
) -> Floats:
    """Fit a normal distribution of slopes, whose mean is linear in the place, per cell of the coating and route.

    Parameters
    ----------
    uv
        Where light arrived, texture coordinates of the coating, shape (n, 2).
    slopes
        From where, shape (n, 2).
    light
        How much, shape (n,).
    route
        Number of the route, shape (n,).
    cells
        Number of cells across and along.
    rare
        Routes from this number on share their paths with the cells around.

    Returns
    -------
    array
        Shape (cells, ROUTES, 12): chance; mean slopes; their change over the cell across, along;
        Cholesky factor (00, 10, 11); two zeros. Routes that fewer than 12 paths took have chance zero.
    """
    uv, slopes, light, route, corner = _shared_with_neighbours(uv, slopes, light, route, cells, rare)
    cell = (corner[:, 0] * cells[1] + corner[:, 1]) * ROUTES + route
    count = cells[0] * cells[1] * ROUTES

    def summed(values: Floats) -> Floats:
        return np.asarray(np.bincount(cell, weights=light * values, minlength=count), dtype=np.float64)

    terms = np.column_stack([np.ones(len(uv)), uv * cells - corner - 0.5])
    total = summed(terms[:, 0])
    known = (np.bincount(cell, minlength=count) >= _FEWEST_PATHS) & (total > 0.0)
    gram = np.array([[summed(a * b) for b in terms.T] for a in terms.T]).transpose(2, 0, 1)
    gram += (_STIFFNESS * total)[:, None, None] * np.diag([0.0, 1.0, 1.0])
    moments = np.array([[summed(a * b) for b in slopes.T] for a in terms.T]).transpose(2, 0, 1)
    mean = np.zeros_like(moments)
    mean[known] = np.linalg.solve(gram[known], moments[known])
    rest = slopes - np.einsum("ni,nij->nj", terms, mean[cell])
    covariance = np.array([[summed(a * b) for b in rest.T] for a in rest.T]).transpose(2, 0, 1)
    covariance *= _WIDENING**2 / np.where(known, total, 1.0)[:, None, None]
    factor = np.linalg.cholesky(covariance + _LEAST_SPREAD**2 * np.eye(2))
    chance = np.where(known, total, 0.0).reshape(-1, ROUTES) ** _BALANCE
    chance /= np.where(chance.any(axis=1), chance.sum(axis=1), 1.0)[:, None]
    numbers = [chance.ravel(), *mean.reshape(count, 6).T, *factor[:, (0, 1, 1), (0, 0, 1)].T]
    return np.column_stack([*numbers, *np.zeros((NUMBERS - len(numbers), count))]).reshape(-1, ROUTES, NUMBERS)


def _shared_with_neighbours(
    uv: Floats, slopes: Floats, light: Floats, route: NDArray[np.integer[Any]], cells: tuple[int, int], rare: int
) -> tuple[Floats, Floats, Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Return the same with the cell of each path; paths of the rarer routes count in the cells around theirs too."""
    corner = np.floor(uv * cells).astype(np.int64)
    row, shift = [np.arange(len(uv))], [np.zeros((len(uv), 2), dtype=np.int64)]
    scarce = np.flatnonzero(route >= rare)
    for step in ((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)):
        row.append(scarce)
        shift.append(np.full((len(scarce), 2), step))
    rows, corners = np.concatenate(row), corner[np.concatenate(row)] + np.concatenate(shift)
    inside = ((corners >= 0) & (corners < cells)).all(axis=1)
    kept = rows[inside]
    return uv[kept], slopes[kept], light[kept], route[kept].astype(np.int64), corners[inside]


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


def choices_of(lit: Sequence[Floats32], sent: Sequence[Floats32]) -> Floats32:
    """Return directions as often as they matter at each place, (place, CHOICES, 2): bin, and 1 over its chance.

    Each that is lit at all is listed: draws from the list, weighted by the second number, bring all light in the mean.

    Parameters
    ----------
    lit, sent
        Sizes of the light that arrives, and of what is reflected of it to the camera, (place, bin) for each band.
    """
    places, bins = lit[0].shape
    lists = np.zeros((places, CHOICES, 2), dtype=np.float32)
    matters = np.zeros((places, bins))
    for share, bands in ((_AS_LIT, lit), (1.0 - _AS_LIT, sent)):
        for band in bands:
            matters += share * band / np.maximum(band.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)
    for one, weights in zip(lists, matters, strict=True):
        listed = np.flatnonzero(weights)
        if len(listed) == 0:
            continue
        ends = np.cumsum(weights[listed]) * ((CHOICES - len(listed)) / weights.sum())
        ends = np.append(np.rint(ends[:-1]), CHOICES - len(listed)).astype(np.int64)
        times = 1 + np.diff(ends, prepend=0)
        one[:, 0], one[:, 1] = np.repeat(listed, times), np.repeat(CHOICES / times, times)
    return lists
