"""The surfaces of one finger that light meets: at rest, with the analytic press, or smoothly bent."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from sim.surface_meshes.back_mirror import mirror_surface
from sim.surface_meshes.pressed_pad import contact_distance, pressed_height_mm, without_press
from sim.surface_meshes.surface import Surface, check_closed, grid_surface

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
    """

    surfaces: Mapping[str, Surface]
    contact_distance: NDArray[np.float64]
    label: str

    def __post_init__(self) -> None:
        missing = [name for name in (*GEL_FACES, "mirror") if name not in self.surfaces]
        if missing:
            raise SimulateError(f"the finger's shape lacks the surfaces {', '.join(missing)}")
        if self.contact_distance.shape != (len(self.surfaces["coat"].vertices_mm),):
            raise SimulateError(
                f"contact_distance must hold one value per vertex of the coat "
                f"({len(self.surfaces['coat'].vertices_mm)}), got shape {self.contact_distance.shape}"
            )
        check_closed(self.gel)

    @property
    def gel(self) -> dict[str, Surface]:
        """The faces of the gel."""
        return {name: self.surfaces[name] for name in GEL_FACES}


def rest_shape(design: FingerDesign) -> FingerShape:
    """Return the undeformed finger."""
    return pressed_shape(without_press(design))


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
        raise SimulateError(f"a bending radius of {radius_mm:g} mm folds a finger of y = {lowest:g} to {highest:g} mm")
    centre = -radius_mm

    def bend(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        arm, turn = centre - vertices[:, 1], vertices[:, 2] / centre
        return np.column_stack([vertices[:, 0], centre - arm * np.cos(turn), arm * np.sin(turn)])

    surfaces = {name: s.moved_to(bend(s.vertices_mm)) for name, s in shape.surfaces.items()}
    return FingerShape(surfaces, shape.contact_distance, f"{shape.label}, bent to a radius of {radius_mm:g} mm")
