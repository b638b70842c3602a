"""The rigid indenter of a design: exact distances for the penalty, triangles for the barrier, first touch.

A body of triangles comes to touch where its height over the curved face is least.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from data_schemas import (
    INDENTER_SHAPES,
    FingerDesign,
    Indenter,
    PlugIn,
    SimulateError,
    check_magnitude,
    numbers_of,
)
from sim.mechanics._rigid_bodies import (
    Body,
    Cylinder,
    Distances,
    FacetedBody,
    Pose,
    RoundedBox,
    Sphere,
    TriangleMesh,
    body_mesh,
    read_body,
    rotation_matrix,
    sphere_facets,
)
from sim.surface_meshes import rest_height_mm

FloatArray = NDArray[np.float64]

CHORD_MM = 0.004
"""By how much the facets of round bodies lie inside them at most."""

_MOST_OFF_MM = 0.02  # half a per cent of a push of 4 mm
_RADII_MM = (0.25, 1000.0)
_SIZES_MM = (0.5, 300.0)
_EDGE_RADII_MM = (0.01, 150.0)
_GRID_MM = 0.5
_FINEST_MM = 1e-5  # the least distance is known to this squared over twice a radius
_TOUCH_MM = 1e-8
_MOST_STEPS = 200
_LEAST_SLOPE = 0.05
_START_ABOVE = 2.0  # a body without ends may be wider than the pad is long: it starts this many times that above


@dataclass(frozen=True, slots=True)
class RigidIndenter:
    """A rigid body above the finger.

    Attributes
    ----------
    body
        Its signed distance in its own axes; none for a mesh of the user.
    surface
        Its triangles in its own axes.
    touching
        Its pose where it first touches the undeformed coat.
    surface_off_mm
        By how much the triangles of a body of another package miss it; where a body of ours has facets, they lie at
        most :data:`CHORD_MM` inside it.
    """

    body: Body | None
    surface: TriangleMesh
    touching: Pose
    surface_off_mm: float = 0.0

    def facets(self, chord_mm: float, half_length_mm: float) -> TriangleMesh:
        """Return triangles for pictures; a body of ours has its own, an endless cylinder so long to both sides."""
        if self.body is None or isinstance(self.body, PackagedBody):
            return self.surface
        return body_mesh(self.body, chord_mm, half_length_mm)

    def check_surface(self) -> None:
        """Refuse triangles that miss their body by more than a contact on them, or an imprint of them, may.

        Raises
        ------
        SimulateError
            They do: the body has sharp edges.
        """
        if self.surface_off_mm > _MOST_OFF_MM:
            raise SimulateError(
                f"indenter.shape: the triangles of this body are off by {self.surface_off_mm:.2g} mm, because it has "
                f"sharp edges, but at most {_MOST_OFF_MM:g} mm is allowed where triangles are needed; press by finite "
                "elements with --contact penalty, which takes exact distances, or round the edges"
            )

    def exact_body(self) -> Body:
        """Return the body that gives exact distances: for a mesh of the user, its facets."""
        return FacetedBody(self.surface) if self.body is None else self.body

    def pose(self, depth_mm: float) -> Pose:
        """Return the pose at a push from first touch."""
        x, y, z = self.touching.position_mm
        return Pose((x, y - depth_mm, z), self.touching.rotation)

    def vertices_mm(self, lift_mm: float = 0.0) -> FloatArray:
        """Return the vertices (m, 3) in space, so much above first touch."""
        raised = self.surface.vertices_mm @ self.touching.rotation.T + np.array(self.touching.position_mm)
        return np.asarray(raised + np.array([0.0, lift_mm, 0.0]))


def rigid_indenter(design: FingerDesign, folder: Path = Path()) -> RigidIndenter:
    """Return the indenter of a design where it first touches the undeformed coat, on its way along the pad's normal.

    Parameters
    ----------
    design
        Finger and indenter.
    folder
        Where the design stands: the STL of a mesh is relative to it.

    Raises
    ------
    SimulateError
        When an STL is not a closed body or runs along the coat in too many places, a size cannot be mm, or the
        indenter does not meet the coat.
    """
    wanted = design.indenter
    rotation = rotation_matrix(*wanted.rotation_deg)
    if wanted.shape == "mesh":
        surface = read_body(folder / str(wanted.file))
        return RigidIndenter(None, surface, _touch_of_mesh(design, surface, rotation))
    if wanted.is_packaged:
        packaged = _packaged_body(wanted)
        touching = _touch_of_body(design, packaged, rotation)
        return RigidIndenter(packaged, packaged.surface, touching, packaged.surface_off_mm)
    _check_sizes(design)
    body = _body(design)
    half_length = design.pad.length_mm + design.pad.width_mm
    return RigidIndenter(body, body_mesh(body, CHORD_MM, half_length), _touch_of_body(design, body, rotation))


class ShapeBody(Protocol):
    """What a shape of another package returns: a rigid body in its own axes, by its signed distance.

    A closed body of 0.5 to 300 mm from its origin, which lies inside, and which every ray from there leaves once. y is
    up: the body is pressed down along -y, x lies across the pad and z along it.
    """

    def distances(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return signed distance (m,) in mm, negative inside, and its gradient (m, 3) at points (m, 3) in mm.

        The gradient is the distance's own and of length 1 near the surface; away from it the distance may be less than
        the true one and never more. It is asked some hundred times in a press, for all points of the coat together.
        """
        ...


class IndenterShape(Protocol):
    """What the module of an indenter's shape has."""

    def body(self, **parameters: float) -> ShapeBody:
        """Return the body for the design's ``indenter.parameters``."""
        ...


_NEAR_SHARE = 0.02  # of the body's size: how near to its surface the check looks
_CHECKED_RAYS = 400
_ALONG_RAY = 120
_STEP_MM = 1e-5
_MISS = 1e-4  # of a gradient of length 1; central differences miss by 1e-9, next to an edge of rounding by 1e-5
_FEW = 0.02  # of the points may lie on edges, where the gradient jumps
_FINEST_PARTS = 5
_HALVINGS = 50


class PackagedBody:
    """A body of another package: its distances, checked each time, and triangles that are made of them.

    Parameters
    ----------
    plug_in
        Who brings it.
    body
        What its module returned.

    Raises
    ------
    SimulateError
        The body does not keep the contract of :class:`ShapeBody`.
    """

    def __init__(self, plug_in: PlugIn, body: ShapeBody) -> None:
        self._plug_in, self._body = plug_in, body
        if not callable(getattr(body, "distances", None)):
            raise plug_in.refusal(
                f"returns a {type(body).__name__} as its body, but a body must have distances(points_mm)"
            )
        rays = np.random.default_rng(0).standard_normal((_CHECKED_RAYS, 3))
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        self._check(rays)
        self.surface, self.surface_off_mm = self._facets()
        places = self._radii_mm(rays)[:, None] * rays
        self.least_radius_mm = self._least_radius_mm(places) if self.surface_off_mm <= CHORD_MM else 0.0

    def distances(self, points_mm: FloatArray) -> Distances:
        """Return distance and gradient; the second derivative, which packages do not give, is taken as zero."""
        distance, gradient = self._given(points_mm)
        return distance, gradient, np.zeros((len(points_mm), 3, 3))

    def _given(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        given: Any = self._plug_in.call(lambda: self._body.distances(points_mm), "indenter: ")
        if not isinstance(given, tuple) or len(given) != 2:
            raise self._plug_in.refusal(
                "must return a tuple of distance and gradient from distances, but does not", "indenter: "
            )
        count = len(points_mm)
        distance = numbers_of(self._plug_in, "distances", given[0], (count,), "indenter: ")
        return distance, numbers_of(self._plug_in, "gradients", given[1], (count, 3), "indenter: ")

    def local_radius_mm(self, place_mm: FloatArray) -> float:
        """Return the least radius of curvature at a place (3,) on the surface."""
        return self._least_radius_mm(place_mm[None])

    def _least_radius_mm(self, places_mm: FloatArray) -> float:
        """Return the least radius of curvature at places (m, 3) on the surface, by differences of the normal."""
        steps = _NEAR_SHARE * np.eye(3)
        ahead, behind = (self._given((places_mm[:, None] + way * steps).reshape(-1, 3))[1] for way in (1.0, -1.0))
        bends = np.linalg.eigvals((ahead - behind).reshape(-1, 3, 3) / (2.0 * _NEAR_SHARE))
        return 1.0 / max(float(np.abs(bends).max()), 1e-12)

    def _radii_mm(self, rays: FloatArray) -> FloatArray:
        """Return how far from the origin rays (m, 3) leave the body, by halving."""
        low, high = np.zeros(len(rays)), np.full(len(rays), _SIZES_MM[1])
        for _ in range(_HALVINGS):
            middle = (low + high) / 2.0
            inside = self._given(middle[:, None] * rays)[0] < 0.0
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        return np.asarray((low + high) / 2.0)

    def _check(self, rays: FloatArray) -> None:
        """Refuse a body that is not closed, not seen whole from its origin, or whose gradient is not its own."""
        ends = self._given(np.concatenate([1e-3 * rays[:1], _SIZES_MM[1] * rays]))[0]
        if ends[0] >= 0.0 or ends[1:].min() <= 0.0:
            raise self._plug_in.refusal(
                f"is not a closed body around its origin within {_SIZES_MM[1]:g} mm: the signed distance must be below "
                f"0 at the origin (got {ends[0]:.3g} mm) and above 0 at {_SIZES_MM[1]:g} mm from the origin in every "
                f"direction (the smallest is {ends[1:].min():.3g} mm)"
            )
        radii = self._radii_mm(rays)
        size = float(radii.max())
        if size < _SIZES_MM[0]:
            raise self._plug_in.refusal(f"is a body of {size:.3g} mm, but must measure at least {_SIZES_MM[0]:g} mm")
        share = np.linspace(0.0, 1.05 * size, _ALONG_RAY + 1)[1:]
        beyond = share[None, :] > radii[:, None] + 1e-6
        away = np.abs(share[None, :] - radii[:, None]) > 1e-3
        outside = self._given((share[None, :, None] * rays[:, None, :]).reshape(-1, 3))[0].reshape(beyond.shape) > 0.0
        if twice := int(((outside != beyond) & away).any(axis=1).sum()):
            raise self._plug_in.refusal(
                f"is not fully visible from its origin, because {twice} of {len(rays)} rays leave the body more than "
                'once; move its origin, or press its STL as indenter.shape = "mesh"'
            )
        self._check_gradient(rays, radii, size)

    def _check_gradient(self, rays: FloatArray, radii: FloatArray, size_mm: float) -> None:
        off = np.random.default_rng(1).uniform(-1.0, 1.0, len(rays)) * _NEAR_SHARE
        near, far = (radii + off * np.minimum(radii, 1.0))[:, None] * rays, (radii + size_mm)[:, None] * rays
        points = np.concatenate([near, far])
        _, gradient = self._given(points)
        steps = _STEP_MM * np.eye(3)
        ways = [self._given(points + step)[0] - self._given(points - step)[0] for step in steps]
        missed = np.abs(np.stack(ways, axis=1) / (2.0 * _STEP_MM) - gradient).max(axis=1)
        length = np.linalg.norm(gradient, axis=1)
        lengths_off = np.concatenate([np.abs(length[: len(near)] - 1.0), np.maximum(length[len(near) :] - 1.0, 0.0)])
        for fault, wrong in (
            ("gives a gradient that does not belong to its distance", missed),
            (
                "does not give a distance: its gradient does not have length 1 near the surface, or is "
                "longer away from it",
                lengths_off,
            ),
        ):
            if float((wrong > _MISS).mean()) > _FEW:
                worst = int(wrong.argmax())
                x, y, z = points[worst]
                raise self._plug_in.refusal(f"{fault}: off by {wrong[worst]:.3g} at ({x:.3g}, {y:.3g}, {z:.3g}) mm")

    def _facets(self) -> tuple[TriangleMesh, float]:
        """Return triangles with corners on the body, as many as needed or as serve, and by how much they miss it."""
        for parts in range(_FINEST_PARTS + 1):
            sphere = sphere_facets(0.04 / 4.0**parts)
            rays = sphere.vertices_mm / np.linalg.norm(sphere.vertices_mm, axis=1, keepdims=True)
            mesh = TriangleMesh(self._radii_mm(rays)[:, None] * rays, sphere.triangles)
            corners = mesh.vertices_mm[mesh.triangles]
            middles = np.concatenate(
                [corners.mean(axis=1), (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2.0]
            )
            off = float(np.abs(self._given(middles)[0]).max())
            if off <= CHORD_MM:
                break
        return mesh, off


@lru_cache(maxsize=8)
def _checked_body(plug_in: PlugIn, module: ModuleType, parameters: tuple[tuple[str, float], ...]) -> PackagedBody:
    """Return the body that a package gives for some parameters."""
    plug_in.check_parameters(module.body, dict(parameters), 0)
    return PackagedBody(plug_in, plug_in.call(lambda: module.body(**dict(parameters)), "indenter: "))


def _packaged_body(wanted: Indenter) -> PackagedBody:
    """Return the body of a shape that another package brings."""
    plug_in = wanted.plug_in()
    return _checked_body(plug_in, plug_in.load(), tuple(wanted.parameters.items()))


def check_indenter_shape(shape: IndenterShape, **parameters: float) -> None:
    """Check that a shape keeps its contract, as a press does that uses it: for the tests of its package.

    Its body is closed about its origin, of 0.5 to 300 mm, and every one of 400 rays from there leaves it once; the
    gradient is the distance's own, of length 1 near the surface and not above that a body's size away, but for up to
    2 % of the points, which may lie on edges.

    Parameters
    ----------
    shape
        The module, or an object with its function.
    **parameters
        As the design's ``indenter.parameters`` gives them.

    Raises
    ------
    SimulateError
        It does not; the message says what is wrong, and where.
    """
    plug_in = PlugIn(INDENTER_SHAPES, getattr(shape, "__name__", type(shape).__name__), "")
    plug_in.check_parameters(shape.body, parameters, 0)
    PackagedBody(plug_in, plug_in.call(lambda: shape.body(**parameters)))


def touch_radius_mm(design: FingerDesign) -> float | None:
    """Return the least radius of curvature where the indenter first touches; none of cuboids and meshes."""
    wanted = design.indenter
    if not wanted.is_packaged:
        return wanted.radius_mm if wanted.shape in ("cylinder", "ball") else None
    indenter = rigid_indenter(design)
    body, pose = indenter.body, indenter.touching
    if not isinstance(body, PackagedBody):
        return None
    grid = _at(design, _coat_grid(design))
    distance, normal, _ = pose.distances(body, grid)
    at = int(distance.argmin())
    nearest = grid[at] - distance[at] * normal[at]
    return body.local_radius_mm((nearest - np.array(pose.position_mm)) @ pose.rotation)


def side_outline_mm(design: FingerDesign, depth_mm: float = 0.0, folder: Path | None = None) -> FloatArray | None:
    """Return the outline (m, 2), z and y, of the indenter seen along x, at a push from first touch.

    A cylinder is drawn as wide as the pad, a mesh of the user by its hull: none of it without the design's folder.
    """
    if design.indenter.shape == "mesh" and folder is None:
        return None
    indenter = rigid_indenter(design, folder or Path())
    shown = indenter.facets(CHORD_MM, design.pad.width_mm / 2.0)
    pose = indenter.pose(depth_mm)
    points = (shown.vertices_mm @ pose.rotation.T + np.array(pose.position_mm))[:, [2, 1]]
    return np.asarray(points[ConvexHull(points).vertices])


def _check_sizes(design: FingerDesign) -> None:
    """Check that the body's sizes can be mm."""
    wanted = design.indenter
    sizes = [("radius_mm", wanted.radius_mm, _RADII_MM)]
    if wanted.size_mm is not None:
        sizes = [("size_mm", size, _SIZES_MM) for size in wanted.size_mm]
        sizes.append(("edge_radius_mm", wanted.edge_radius_mm, _EDGE_RADII_MM))
    for name, value, bounds in sizes:
        try:
            check_magnitude(value, *bounds, "mm")
        except ValueError as error:
            raise SimulateError(f"indenter.{name}: {error}") from error


def _body(design: FingerDesign) -> Body:
    """Return the body of a cylinder, ball or cuboid."""
    wanted = design.indenter
    if wanted.shape == "cylinder":
        return Cylinder(wanted.radius_mm)
    if wanted.size_mm is None:
        return Sphere(wanted.radius_mm)
    x, y, z = wanted.size_mm
    return RoundedBox((x / 2.0, y / 2.0, z / 2.0), wanted.edge_radius_mm)


def _coat_grid(design: FingerDesign) -> FloatArray:
    """Return points (m, 2), x and z, all over the coat with its edges."""
    pad = design.pad
    x = np.linspace(-pad.width_mm / 2.0, pad.width_mm / 2.0, int(pad.width_mm / _GRID_MM) + 2)
    z = np.linspace(0.0, pad.length_mm, int(pad.length_mm / _GRID_MM) + 2)
    return np.stack(np.meshgrid(x, z, indexing="ij"), -1).reshape(-1, 2)


def _at(design: FingerDesign, places: FloatArray) -> FloatArray:
    """Return points of the undeformed coat (m, 3) at x and z (m, 2)."""
    return np.column_stack([places[:, 0], rest_height_mm(design, places[:, 0], places[:, 1]), places[:, 1]])


def _touch_of_body(design: FingerDesign, body: Body, rotation: FloatArray) -> Pose:
    """Return the pose of first touch: steps down by the least distance, which never go too far."""
    wanted, pad = design.indenter, design.pad
    grid = _coat_grid(design)
    reach = wanted.radius_mm if wanted.size_mm is None else float(np.linalg.norm(wanted.size_mm))
    if isinstance(body, PackagedBody):
        reach = float(np.linalg.norm(body.surface.vertices_mm, axis=1).max())
    y = start = pad.thickness_mm + reach + _START_ABOVE * (pad.length_mm + pad.width_mm)
    for _ in range(_MOST_STEPS):
        pose = Pose((wanted.across_mm, y, wanted.position_mm), rotation)
        least, downward = _nearest(design, body, pose, grid)
        if abs(least) < _TOUCH_MM:
            return pose
        # Newton's step, where the distance is that of the place which touches; further off the step that is safe
        y -= least / downward if least < _GRID_MM and downward > _LEAST_SLOPE else least
        if not -reach - pad.thickness_mm < y <= start:
            break
    raise SimulateError(_misses(design))


def _nearest(design: FingerDesign, body: Body, pose: Pose, grid: FloatArray) -> tuple[float, float]:
    """Return the coat's least distance from a body, by ever finer grids, and by how much it falls as that goes down."""
    half, length = design.pad.width_mm / 2.0, design.pad.length_mm
    places, step = grid, _GRID_MM
    around = np.stack(np.meshgrid(*2 * [np.linspace(-1.0, 1.0, 9)]), -1).reshape(-1, 2)
    while True:
        distance, normal, _ = pose.distances(body, _at(design, places))
        nearest = int(np.argmin(distance))
        if step < _FINEST_MM or distance[nearest] > _GRID_MM * 2.0:
            return float(distance[nearest]), -float(normal[nearest, 1])
        places = np.clip(places[nearest] + step * around, [-half, 0.0], [half, length])
        step /= 3.0


def _touch_of_mesh(design: FingerDesign, surface: TriangleMesh, rotation: FloatArray) -> Pose:
    """Return the pose of first touch: the least height of the triangles over the coat."""
    wanted, pad = design.indenter, design.pad
    place = np.array([wanted.across_mm, 0.0, wanted.position_mm])
    corners = (surface.vertices_mm @ rotation.T + place)[surface.triangles]
    over = over_rectangle(corners, (-pad.width_mm / 2.0, pad.width_mm / 2.0), (0.0, pad.length_mm))
    if not len(over):
        raise SimulateError(_misses(design))
    half = pad.width_mm / 2.0

    def height_mm(points: FloatArray) -> FloatArray:
        # clipping leaves points at the pad's edges that lie outside by rounding
        x, z = np.clip(points[:, 0], -half, half), np.clip(points[:, 2], 0.0, pad.length_mm)
        return np.asarray(points[:, 1] - rest_height_mm(design, x, z))

    least = least_over_triangles(over, height_mm, design.pad.most_curvature_per_mm())
    return Pose((wanted.across_mm, -least, wanted.position_mm), rotation)


def _misses(design: FingerDesign) -> str:
    wanted = design.indenter
    return (
        f"the indenter ({wanted.shape}, across_mm = {wanted.across_mm:g} mm, position_mm = {wanted.position_mm:g} mm, "
        f"rotation_deg = {list(wanted.rotation_deg)} deg) does not touch the pad when it moves along the pad's normal; "
        "move or turn the indenter (a cylinder is endless and must not stand upright, and a mesh must lie over the "
        "pad, counted from its origin)"
    )


_CLOSE_MM = 1e-5  # the least height is known to this
_ENOUGH_MM = 0.004  # and at least to this: the chord of the facets of round bodies
_MOST_HALVINGS = 20
_MOST_TRIANGLES = 250_000  # to be divided: where a body runs along the face, none of them can be left out
_HALVES = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))  # of a triangle's corners and the middles of its edges


def over_rectangle(corners_mm: FloatArray, x_mm: tuple[float, float], z_mm: tuple[float, float]) -> FloatArray:
    """Return the parts of triangles (k, 3, 3) that lie over a rectangle in x and z, as triangles (m, 3, 3)."""
    low, high = corners_mm.min(axis=1), corners_mm.max(axis=1)
    bounds = ((0, *x_mm), (2, *z_mm))
    meets = np.all([(low[:, axis] <= last) & (high[:, axis] >= first) for axis, first, last in bounds], axis=0)
    inside = np.all([(low[:, axis] >= first) & (high[:, axis] <= last) for axis, first, last in bounds], axis=0)
    parts = [corners_mm[inside]]
    for triangle in corners_mm[meets & ~inside]:
        polygon = triangle
        for axis, first, last in bounds:
            polygon = _above(polygon, polygon[:, axis] - first)
            polygon = _above(polygon, last - polygon[:, axis])
        if len(polygon):
            fan = np.stack([polygon[:-2], polygon[1:-1]], axis=1)
            parts.append(np.concatenate([np.broadcast_to(polygon[-1], (len(fan), 1, 3)), fan], axis=1))
    return np.concatenate(parts)


def _above(polygon: FloatArray, beyond: FloatArray) -> FloatArray:
    """Return the part of a convex polygon (k, 3) where a linear function, given at its points, is not negative."""
    kept = []
    for here in range(len(polygon)):
        before = here - 1
        if (beyond[here] < 0.0) != (beyond[before] < 0.0):
            share = beyond[before] / (beyond[before] - beyond[here])
            kept.append(polygon[before] + share * (polygon[here] - polygon[before]))
        if beyond[here] >= 0.0:
            kept.append(polygon[here])
    return np.array(kept).reshape(-1, 3)


def least_over_triangles(
    triangles_mm: FloatArray, height_mm: Callable[[FloatArray], FloatArray], curvature_per_mm: float
) -> float:
    r"""Return the least height of triangles (k, 3, 3) over a face that bulges towards them, to 1e-5 mm.

    .. math:: h \ge \min_i h_i - \frac{\kappa r^2}{2}, \quad r \le l / \sqrt 3

    with the heights h_i of a triangle's corners, the face's curvature kappa, the radius r of the smallest circle around
    the triangle in plan and its longest edge l (Jung). Triangles that cannot hold the least height are left out, the
    others divided by four; the search ends where over 250 000 are left and the height is then known to 0.004 mm.

    Parameters
    ----------
    triangles_mm
        The triangles, y upwards.
    height_mm
        Height of points (m, 3) over the face.
    curvature_per_mm
        A bound of the face's second derivative; 0 for a plane.

    Raises
    ------
    SimulateError
        When the triangles run along the face in too many places for that.
    """
    least, left = np.inf, triangles_mm
    for _ in range(_MOST_HALVINGS):
        heights = height_mm(left.reshape(-1, 3)).reshape(-1, 3).min(axis=1)
        least = min(least, float(heights.min()))
        plan = left[..., [0, 2]]
        longest = np.linalg.norm(plan - np.roll(plan, 1, axis=1), axis=2).max(axis=1)
        lowest = heights - curvature_per_mm * longest**2 / 6.0
        left = left[lowest < least - _CLOSE_MM]
        if not len(left):
            break
        if len(left) > _MOST_TRIANGLES:
            _check_close(least - float(lowest.min()), len(left))
            break
        six = np.concatenate([left, (left + np.roll(left, -1, axis=1)) / 2.0], axis=1)
        left = six[:, _HALVES].reshape(-1, 3, 3)
    return least


def _check_close(off_mm: float, places: int) -> None:
    """Check that the least height is known well enough."""
    if off_mm > _ENOUGH_MM:
        raise SimulateError(
            f"the indenter's mesh is nearly parallel to the pad in {places} places, so its first touch is known only "
            f"to {off_mm:.2g} mm, but must be known to {_ENOUGH_MM:g} mm; give an STL of fewer triangles"
        )
