"""Triangulated surfaces, and those of one finger that light meets: gel, coat, painted walls, back mirror.

A :class:`Surface` carries texture coordinates; :func:`check_closed` proves that several of them close one volume. A
finger's shape is at rest, with the analytic press, or smoothly bent, and can be stored as a record and restored. The
mirror on the back beam is straight across, slightly convex along the finger; its lay-out is assumed for a pad of
70 x 35 mm, chosen so that the pad fills the frame of a 120 deg camera, and scales with the pad, where a design does not
say otherwise.

The analytic press dents the coated face by a cylinder or a ball; it is no mechanical solution. The cylinder lies across
the pad (axis along x), and each line of the face along the pad is dented for itself; so the shape serves flat,
cylindrical and ellipsoidal pads. It exercises the optics; deformed meshes of the finite-element model replace it where
mechanics matters.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from data_schemas import FingerDesign, FingerSurfaces, ImpossibleFingerError, SimulateError

BLEND_MM = 0.15
"""Radius of the rounded transition between the indenter and the free face."""

_ANALYTIC_SHAPES = ("cylinder", "ball")
_BY_ELEMENTS = "Press by finite elements: finray simulate press DESIGN, and render with --surfaces"
_QUADRATURE_POINTS = 4001
_QUADRATURE_COLUMNS = 401
# a whole bulge beside a press in a pad of 70 mm has a mean near 0.2
SMALLEST_BULGE_MEAN = 0.01
# a line whose overlap with the indenter is thinner than this is left alone
_SMALLEST_OVERLAP_MM = 1e-6


def check_analytic_press(design: FingerDesign) -> None:
    """Check that the analytic press can shape this press: a cylinder that lies across the pad, or a ball.

    Raises
    ------
    SimulateError
        When it cannot; the message names the field and the finite elements that can.
    """
    pad, indenter = design.pad, design.indenter
    if indenter.depth_mm == 0.0:
        return
    if indenter.depth_mm >= pad.thickness_mm:
        raise ImpossibleFingerError(
            f"indenter.depth_mm = {indenter.depth_mm} mm goes through the pad, but must be below pad.thickness_mm = "
            f"{pad.thickness_mm} mm for the analytic press. {_BY_ELEMENTS}"
        )
    if indenter.shape not in _ANALYTIC_SHAPES:
        raise SimulateError(
            f'indenter.shape = "{indenter.shape}" is not supported by the analytic press, which supports only '
            f"{' and '.join(_ANALYTIC_SHAPES)}. {_BY_ELEMENTS}"
        )
    turned = any(indenter.rotation_deg)
    if indenter.shape == "cylinder" and (indenter.across_mm != 0.0 or turned):
        field = (
            f"rotation_deg = {list(indenter.rotation_deg)} deg" if turned else f"across_mm = {indenter.across_mm:g} mm"
        )
        raise SimulateError(
            f"indenter.{field} is not supported by the analytic press, which supports only a cylinder on the middle "
            f"line that is not turned. {_BY_ELEMENTS}"
        )


def unpressed_design(design: FingerDesign) -> FingerDesign:
    """Return the same finger with nothing pressed into it."""
    return design.model_copy(update={"indenter": design.indenter.model_copy(update={"depth_mm": 0.0})})


def contact_half_width_mm(design: FingerDesign, drop_mm: ArrayLike = 0.0) -> NDArray[np.float64]:
    """Return half the chord of the indenter in the plane of the undeformed face, sqrt(2 R d - d^2).

    The geometric overlap of a line `drop_mm` below the crown, d = depth - drop; R once d reaches the radius R, zero
    where there is no overlap.
    """
    radius = design.indenter.radius_mm
    overlap = np.clip(design.indenter.depth_mm - np.asarray(drop_mm, dtype=np.float64), 0.0, radius)
    return np.asarray(np.sqrt(2.0 * radius * overlap - overlap**2))


def contact_distance(design: FingerDesign, x_mm: ArrayLike, z_mm: ArrayLike) -> NDArray[np.float64]:
    """Return the distance from the contact's centre in units of its half-width: the contact is where it is <= 1.

    sqrt(s^2 / w^2 + drop / depth), s the distance from the cylinder's line or the ball's centre, w the half-width
    at the crown; the drop of a curved pad from its crown ends the contact too. NaN without a press.
    """
    pad, indenter = design.pad, design.indenter
    x, z = np.broadcast_arrays(np.asarray(x_mm, dtype=np.float64), np.asarray(z_mm, dtype=np.float64))
    if indenter.depth_mm == 0.0:
        return np.full(x.shape, np.nan)
    drop = pad.drop_mm(x, z - pad.length_mm / 2.0) - pad.drop_mm(
        _across_mm(design), indenter.position_mm - pad.length_mm / 2.0
    )
    offset = _offset_mm(design, x, z) / contact_half_width_mm(design)
    return np.asarray(np.sqrt(offset**2 + np.maximum(drop, 0.0) / indenter.depth_mm))


def pressed_height_mm(
    design: FingerDesign, x_mm: NDArray[np.float64], z_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the height of the coated face on a grid of the pad.

    Smooth minimum of the face and the indenter, plus B (s/l)^2 exp(-s/l) outside the contact, where s is the
    distance from its edge, l half the thickness, and B makes the net volume zero, for a cylinder on each line along
    the pad: the gel is incompressible. The depth counts from the crown at the indenter's position. Valid for one
    press well inside the pad; analytic, no stress is solved for.

    Parameters
    ----------
    design
        Pad and indenter.
    x_mm, z_mm
        Positions across (nx,) and along (nz,) the pad.

    Returns
    -------
    array
        Height above the inner face, mm, shape (nx, nz).

    Raises
    ------
    SimulateError
        When the press is not one that :func:`check_analytic_press` allows, or its contact leaves no free face beside
        it for the displaced volume.
    """
    check_analytic_press(design)
    pad, indenter = design.pad, design.indenter
    rest = rest_height_mm(design, x_mm[:, None], z_mm[None, :])
    if indenter.depth_mm == 0.0:
        return rest
    z = np.linspace(0.0, pad.length_mm, _QUADRATURE_POINTS)
    if indenter.shape == "cylinder":
        return np.stack(
            [_dent_and_bulge(design, x_mm[i : i + 1], z_mm, x_mm[i : i + 1], z)[0] for i in range(x_mm.size)]
        )
    x = np.linspace(-pad.width_mm / 2.0, pad.width_mm / 2.0, _QUADRATURE_COLUMNS)
    return _dent_and_bulge(design, x_mm, z_mm, x, z[:: _QUADRATURE_POINTS // _QUADRATURE_COLUMNS])


def rest_height_mm(design: FingerDesign, x_mm: ArrayLike, z_mm: ArrayLike) -> NDArray[np.float64]:
    """Return the height of the undeformed coated face above the inner one, shape of the broadcast arguments."""
    drop = design.pad.drop_mm(x_mm, np.asarray(z_mm, dtype=np.float64) - design.pad.length_mm / 2.0)
    return np.asarray(design.pad.thickness_mm - drop)


def _dent_and_bulge(
    design: FingerDesign,
    x_mm: NDArray[np.float64],
    z_mm: NDArray[np.float64],
    quadrature_x: NDArray[np.float64],
    quadrature_z: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the height on a grid; the bulge makes up for the volume that is missing on the quadrature grid."""
    indenter = design.indenter
    x, z = x_mm[:, None], z_mm[None, :]
    qx, qz = quadrature_x[:, None], quadrature_z[None, :]
    across = _across_mm(design)
    crown = rest_height_mm(design, across, indenter.position_mm)
    nearest = rest_height_mm(design, qx if indenter.shape == "cylinder" else across, indenter.position_mm)
    half_width = float(contact_half_width_mm(design, crown - nearest.max()))
    if indenter.depth_mm - (crown - nearest.max()) < _SMALLEST_OVERLAP_MM:
        return rest_height_mm(design, x, z)
    removed = _mean(rest_height_mm(design, qx, qz) - _dented(design, qx, qz))
    bulge = _mean(_bulge_shape(design, half_width, qx, qz))
    if bulge < SMALLEST_BULGE_MEAN:
        raise ImpossibleFingerError(
            f"indenter.radius_mm = {indenter.radius_mm} mm at a depth of {indenter.depth_mm} mm covers the pad of "
            f"{design.pad.length_mm} mm from end to end and leaves no free face; reduce radius or depth"
        )
    return _dented(design, x, z) + removed / bulge * _bulge_shape(design, half_width, x, z)


def _mean(values: NDArray[np.float64]) -> float:
    """Return the mean over a grid by the trapezoid rule."""
    means = np.trapezoid(values, axis=1) / (values.shape[1] - 1)
    return float(means[0] if means.size == 1 else np.trapezoid(means) / (means.size - 1))


def _across_mm(design: FingerDesign) -> float:
    """Return the place of the indenter across the pad; a cylinder lies on all of it."""
    return design.indenter.across_mm if design.indenter.shape == "ball" else 0.0


def _offset_mm(design: FingerDesign, x_mm: ArrayLike, z_mm: ArrayLike) -> NDArray[np.float64]:
    """Return the distance from the cylinder's line or from the ball's centre, seen along the press."""
    across = np.asarray(x_mm, dtype=np.float64) - _across_mm(design)
    along = np.asarray(z_mm, dtype=np.float64) - design.indenter.position_mm
    return np.asarray(np.hypot(across, along) if design.indenter.shape == "ball" else np.abs(along + 0.0 * across))


def _dented(design: FingerDesign, x_mm: NDArray[np.float64], z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smooth minimum of the face and the indenter, without the bulge."""
    indenter, radius = design.indenter, design.indenter.radius_mm
    rest = rest_height_mm(design, x_mm, z_mm)
    bottom = rest_height_mm(design, _across_mm(design), indenter.position_mm) - indenter.depth_mm
    offset = _offset_mm(design, x_mm, z_mm)
    tool = bottom + radius - np.sqrt(np.maximum(radius**2 - offset**2, 0.0))
    tool = np.where(offset < radius, tool, np.inf)
    return np.asarray(-BLEND_MM * np.logaddexp(-rest / BLEND_MM, -tool / BLEND_MM))


def _bulge_shape(
    design: FingerDesign, half_width_mm: float, x_mm: NDArray[np.float64], z_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the bulge beside the contact at unit amplitude; it decays over half the pad's thickness."""
    s = np.maximum(_offset_mm(design, x_mm, z_mm) - half_width_mm, 0.0) / (design.pad.thickness_mm / 2.0)
    return np.asarray(s**2 * np.exp(-s))


# faces of one body meet with equal coordinates up to rounding; a nanometre welds them
_WELD_DECIMALS = 6


@dataclass(frozen=True, slots=True)
class Surface:
    """Triangles of one face: vertices (n, 3) in mm, triangles (m, 3), texture coordinates (n, 2) in 0..1.

    Texture coordinates belong to the undeformed finger: a point keeps them when the finger deforms.
    """

    vertices_mm: NDArray[np.float64]
    triangles: NDArray[np.int64]
    uv: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name, shape in (("vertices_mm", (3,)), ("triangles", (3,)), ("uv", (2,))):
            values = getattr(self, name)
            if values.ndim != 2 or values.shape[1:] != shape or not np.isfinite(values).all():
                raise SimulateError(
                    f"a surface's {name} must be finite and of shape (n, {shape[0]}), got shape {values.shape}"
                )
        if len(self.uv) != len(self.vertices_mm) or not len(self.triangles):
            raise SimulateError(
                "a surface needs at least one triangle and one texture coordinate for each vertex, got "
                f"{len(self.triangles)} triangles, {len(self.vertices_mm)} vertices and {len(self.uv)} texture "
                "coordinates"
            )
        if self.triangles.min() < 0 or self.triangles.max() >= len(self.vertices_mm):
            raise SimulateError(
                f"triangles of a surface must use only vertex indices from 0 to {len(self.vertices_mm) - 1}"
            )

    def reversed(self) -> "Surface":
        """Return the same surface seen from its other side."""
        return Surface(self.vertices_mm, self.triangles[:, ::-1], self.uv)

    def moved_to(self, vertices_mm: NDArray[np.float64]) -> "Surface":
        """Return the surface with its vertices elsewhere."""
        return Surface(vertices_mm, self.triangles, self.uv)


def grid_surface(
    points_mm: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64], flip: bool = False
) -> Surface:
    """Triangulate a (nu, nv, 3) grid of points; normals along d/du x d/dv, or against it with `flip`."""
    nu, nv = points_mm.shape[:2]
    index = np.arange(nu * nv).reshape(nu, nv)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), -1).reshape(-1, 2)
    return Surface(points_mm.reshape(-1, 3), triangles[:, ::-1] if flip else triangles, uv)


def vertex_normals(surface: Surface) -> NDArray[np.float64]:
    """Return the unit normals (n, 3) of the vertices: means of the faces around, weighted by their angles there."""
    corners = surface.vertices_mm[surface.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    face /= np.linalg.norm(face, axis=-1, keepdims=True)
    normals = np.zeros_like(surface.vertices_mm)
    for k in range(3):
        a, b = (corners[:, (k + step) % 3] - corners[:, k] for step in (1, 2))
        cosine = np.sum(a * b, axis=-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
        np.add.at(normals, surface.triangles[:, k], face * np.arccos(np.clip(cosine, -1.0, 1.0))[:, None])
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def weld(surfaces: Mapping[str, Surface]) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Join surfaces at equal vertices.

    Returns
    -------
    vertices_mm
        Shape (n, 3), each place once.
    triangles
        Shape (m, 3), of all surfaces one after the other.
    owner
        Number of the surface that a triangle belongs to, shape (m,).
    """
    vertices = np.concatenate([s.vertices_mm for s in surfaces.values()])
    offsets = np.cumsum([0] + [len(s.vertices_mm) for s in surfaces.values()])
    triangles = np.concatenate([s.triangles + o for s, o in zip(surfaces.values(), offsets, strict=False)])
    owner = np.repeat(np.arange(len(surfaces)), [len(s.triangles) for s in surfaces.values()])
    _, first, place = np.unique(np.round(vertices, _WELD_DECIMALS), axis=0, return_index=True, return_inverse=True)
    return vertices[first], place.reshape(-1)[triangles], owner


def check_closed(surfaces: Mapping[str, Surface], body: str = "gel") -> float:
    """Check that surfaces close one volume with outward normals and return that volume in mm^3.

    A face turned the wrong way gives no error in the renderer, only wrong light: so every edge must be shared by
    exactly two triangles that run it in opposite directions, and the signed volume must be positive.

    Raises
    ------
    SimulateError
        When an edge is open or run twice in one direction, naming the faces at fault, or when the normals point
        inward.
    """
    vertices, corners, owner = weld(surfaces)
    edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    directed = edges[:, 0] * (edges.max() + 1) + edges[:, 1]
    opposite = edges[:, 1] * (edges.max() + 1) + edges[:, 0]
    in_order = np.sort(directed)
    # closed where each edge is run once and its opposite too: sorted, which takes a fifth of finding the ones at fault
    if not (np.array_equal(in_order, np.sort(opposite)) and (np.diff(in_order) > 0).all()):
        _, first, times = np.unique(directed, return_inverse=True, return_counts=True)
        bad = ~np.isin(directed, opposite) | (times[first.reshape(-1)] > 1)
        per_face = np.bincount(np.tile(owner, 3)[bad], minlength=len(surfaces))
        where = ", ".join(f"{name} ({n})" for name, n in zip(surfaces, per_face, strict=True) if n)
        raise ImpossibleFingerError(
            f"the {body} is not closed, because {int(bad.sum())} edges are open or belong to triangles of opposite "
            f"orientation, at {where}. Two triangles of the same orientation must meet at every edge; close the mesh, "
            "or turn the face"
        )
    a, b, c = (vertices[corners[:, k]] for k in range(3))
    volume = float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
    if volume <= 0.0:
        raise ImpossibleFingerError(
            f"the normals of the {body} point inward (signed volume {volume:.3g} mm^3); reverse the "
            "orientation of every face"
        )
    return volume


_NOMINAL_LENGTH_MM, _NOMINAL_WIDTH_MM = 70.0, 35.0
# ends of the straight back beam, y then z
_BASE_YZ_MM = np.array([-20.0, 0.0])
_TIP_YZ_MM = np.array([-4.5, 70.0])
_ROWS = 241


@dataclass(frozen=True, slots=True)
class MirrorShape:
    """Convex mirror, straight across (x): apex, unit tangent and unit normal to the pad in (y, z), and radius.

    Points: apex + s tangent - s^2 / (2 radius) normal, for s in -half_length_mm .. half_length_mm.
    """

    apex_yz_mm: NDArray[np.float64]
    tangent_yz: NDArray[np.float64]
    normal_yz: NDArray[np.float64]
    radius_mm: float
    half_length_mm: float
    half_width_mm: float


def layout_scale(design: FingerDesign) -> float:
    """Return the size of this finger's lay-out over the nominal one."""
    return max(design.pad.length_mm / _NOMINAL_LENGTH_MM, design.pad.width_mm / _NOMINAL_WIDTH_MM)


def mirror_shape(design: FingerDesign) -> MirrorShape:
    """Return the mirror on the back beam, where the design puts it; by default scaled with the pad."""
    ends = (design.mirror.base_yz_mm, _BASE_YZ_MM), (design.mirror.tip_yz_mm, _TIP_YZ_MM)
    base, tip = (usual * layout_scale(design) if given is None else np.array(given) for given, usual in ends)
    length = float(np.linalg.norm(tip - base))
    tangent = (tip - base) / length
    return MirrorShape(
        apex_yz_mm=(base + tip) / 2.0,
        tangent_yz=tangent,
        normal_yz=np.array([tangent[1], -tangent[0]]),
        radius_mm=design.mirror.radius_mm,
        half_length_mm=length / 2.0 + design.mirror.overhang_mm,
        half_width_mm=design.pad.width_mm / 2.0 + design.mirror.side_overhang_mm,
    )


def mirror_surface(design: FingerDesign) -> Surface:
    """Triangulate the mirror; its normals point to the pad, u runs across, v along from the base."""
    mirror = mirror_shape(design)
    v = np.linspace(0.0, 1.0, _ROWS)
    s = (2.0 * v - 1.0) * mirror.half_length_mm
    sag = s**2 / (2.0 * mirror.radius_mm)
    yz = mirror.apex_yz_mm + s[:, None] * mirror.tangent_yz - sag[:, None] * mirror.normal_yz
    x = np.array([-mirror.half_width_mm, mirror.half_width_mm])
    points = np.stack([np.broadcast_to(x[:, None], (2, _ROWS)), *np.broadcast_to(yz.T[:, None], (2, 2, _ROWS))], -1)
    # d/du x d/dv = x cross tangent points away from the pad
    return grid_surface(points, np.array([0.0, 1.0]), v, flip=True)


GEL_FACES = ("coat", "inner", "red", "green", "base", "tip")
STEP_ALONG_MM = 0.1
"""Spacing of the analytic press along the pad; the curvature of the dent needs about 0.1 mm."""

_STEP_ACROSS_MM = 0.5
_FLAT_COLUMNS = 3
_WALL_ROWS = 9


@dataclass(frozen=True, slots=True)
class FingerShape:
    """Surfaces of a finger, at rest or deformed, in mm in the axes of the undeformed pad.

    Attributes
    ----------
    surfaces
        The six faces of the closed gel, normals outward: "coat", "inner", "red" (x = -width/2), "green"
        (x = +width/2), "base" (z = 0) and "tip"; and "mirror", normals to the pad. Further names are dark bodies.
        Texture coordinates of the undeformed finger: of coat, inner face and mirror u across, v along; of the walls
        u from the inner face to the coat, v along; of base and tip u across, v up.
    contact_distance
        Per vertex of the coat, distance from the centre of the contact in units of its half-width, the contact
        being <= 1; NaN without contact.
    label
        Where the shape comes from, in words.
    is_apart
        Whether the gel is known not to pass through itself: its coat is a height over the inner face, or it was
        searched already. Otherwise a render searches it.
    """

    surfaces: Mapping[str, Surface]
    contact_distance: NDArray[np.float64]
    label: str
    is_apart: bool = False

    def __post_init__(self) -> None:
        missing = [name for name in (*GEL_FACES, "mirror") if name not in self.surfaces]
        if missing:
            raise SimulateError(f"the finger's shape lacks the surfaces {', '.join(missing)}")
        if self.contact_distance.shape != (len(self.surfaces["coat"].vertices_mm),):
            raise SimulateError(
                "contact_distance must contain one value for each vertex of the coat "
                f"({len(self.surfaces['coat'].vertices_mm)}), got shape {self.contact_distance.shape}"
            )
        check_closed(self.gel)

    @property
    def gel(self) -> dict[str, Surface]:
        """The faces of the gel."""
        return {name: self.surfaces[name] for name in GEL_FACES}


def rest_shape(design: FingerDesign) -> FingerShape:
    """Return the undeformed finger."""
    return pressed_shape(unpressed_design(design))


def pressed_shape(design: FingerDesign) -> FingerShape:
    """Return the finger with the indenter of its design pressed in analytically (no mechanics)."""
    pad = design.pad
    z = np.linspace(0.0, pad.length_mm, int(np.ceil(pad.length_mm / STEP_ALONG_MM)) + 1)
    straight = pad.shape == "flat" and design.indenter.shape == "cylinder"
    columns = _FLAT_COLUMNS if straight else int(np.ceil(pad.width_mm / _STEP_ACROSS_MM)) + 1
    x = np.linspace(-pad.width_mm / 2.0, pad.width_mm / 2.0, columns)
    surfaces = {**gel_faces(x, pressed_height_mm(design, x, z), z), "mirror": mirror_surface(design)}
    distance = contact_distance(design, x[:, None], z[None, :]).ravel()
    return FingerShape(surfaces, distance, "analytic press" if design.indenter.depth_mm else "at rest")


def gel_faces(
    x_mm: NDArray[np.float64], height_mm: NDArray[np.float64], z_mm: NDArray[np.float64]
) -> dict[str, Surface]:
    """Return the faces of a gel of the given height (nx, nz) over the plane y = 0, oriented outward."""
    rows = np.linspace(0.0, 1.0, _WALL_ROWS)
    u, v = (x_mm - x_mm[0]) / (x_mm[-1] - x_mm[0]), z_mm / z_mm[-1]
    xx, zz = np.meshgrid(x_mm, z_mm, indexing="ij")
    faces = {
        "coat": grid_surface(np.stack([xx, height_mm, zz], -1), u, v, flip=True),
        "inner": grid_surface(np.stack([xx, np.zeros_like(height_mm), zz], -1), u, v),
    }
    for name, i, flip in (("red", 0, True), ("green", -1, False)):
        points = np.stack(np.broadcast_arrays(x_mm[i], rows[:, None] * height_mm[i], z_mm), -1)
        faces[name] = grid_surface(points, rows, v, flip=flip)
    for name, j, flip in (("base", 0, True), ("tip", -1, False)):
        points = np.stack(np.broadcast_arrays(x_mm[:, None], height_mm[:, j, None] * rows, z_mm[j]), -1)
        faces[name] = grid_surface(points, u, rows, flip=flip)
    return faces


def bent(shape: FingerShape, radius_mm: float) -> FingerShape:
    r"""Bend a finger into an arc about an axis along x, the base staying in place.

    .. math:: (y, z) \to (y_c - (y_c - y) \cos(z / y_c),\; (y_c - y) \sin(z / y_c)), \quad y_c = -radius

    A smooth deformation of known shape, in which lines across the finger stay straight; positive radii bend the tip
    towards the mirror.

    Raises
    ------
    SimulateError
        When the radius is so small that the finger would fold onto itself.
    """
    lowest = min(float(s.vertices_mm[:, 1].min()) for s in shape.surfaces.values())
    highest = max(float(s.vertices_mm[:, 1].max()) for s in shape.surfaces.values())
    if (-radius_mm >= 2.0 * lowest) if radius_mm > 0.0 else (-radius_mm <= 2.0 * highest):
        raise ImpossibleFingerError(
            f"a bending radius of {radius_mm:g} mm folds a finger that reaches from y = {lowest:g} to {highest:g} mm; "
            "give a radius of larger absolute value"
        )
    centre = -radius_mm

    def bend(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        arm, turn = centre - vertices[:, 1], vertices[:, 2] / centre
        return np.column_stack([vertices[:, 0], centre - arm * np.cos(turn), arm * np.sin(turn)])

    surfaces = {name: s.moved_to(bend(s.vertices_mm)) for name, s in shape.surfaces.items()}
    return FingerShape(surfaces, shape.contact_distance, f"{shape.label}, bent to a radius of {radius_mm:g} mm")


def store_shapes(rest: FingerShape, pressed: FingerShape, name: str, push_mm: float | None = None) -> FingerSurfaces:
    """Return a finger without and with contact, on the same meshes, as a record; the indenter's push where known."""
    surfaces = list(pressed.surfaces.values())
    return FingerSurfaces(
        name=name,
        label=pressed.label,
        push_mm=push_mm,
        parts=tuple(pressed.surfaces),
        vertex_counts=np.array([len(s.vertices_mm) for s in surfaces]),
        triangle_counts=np.array([len(s.triangles) for s in surfaces]),
        vertices_mm=np.concatenate([s.vertices_mm for s in surfaces]),
        rest_vertices_mm=np.concatenate([rest.surfaces[name].vertices_mm for name in pressed.surfaces]),
        uv=np.concatenate([s.uv for s in surfaces]),
        triangles=np.concatenate([s.triangles for s in surfaces]),
        contact_distance=pressed.contact_distance,
    )


def restore_shapes(record: FingerSurfaces) -> tuple[FingerShape, FingerShape]:
    """Return the shapes of a record: without and with contact.

    Raises
    ------
    SimulateError
        When a surface is missing or broken, or when the gel is open or inside out.
    """
    vertex_ends, triangle_ends = np.cumsum(record.vertex_counts), np.cumsum(record.triangle_counts)
    triangles, uv = np.split(record.triangles, triangle_ends[:-1]), np.split(record.uv, vertex_ends[:-1])
    shapes = []
    for vertices_mm, distance, label in (
        (record.rest_vertices_mm, np.full_like(record.contact_distance, np.nan), "at rest"),
        (record.vertices_mm, record.contact_distance, record.label),
    ):
        parts = zip(record.parts, np.split(vertices_mm, vertex_ends[:-1]), triangles, uv, strict=True)
        shapes.append(FingerShape({name: Surface(v, t, w) for name, v, t, w in parts}, distance, label))
    return shapes[0], shapes[1]
