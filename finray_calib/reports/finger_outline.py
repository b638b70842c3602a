"""A finger's parts as its drawings need them: where they lie, in which colours, and on what scale."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_schemas.design import FingerDesign
from sim.mechanics.indenters import rigid_indenter, side_outline_mm
from sim.mechanics.skeleton import SkeletonLayout, skeleton_layout
from sim.mechanics.skeleton_mesh import skeleton_mesh
from sim.surface_meshes.pressed_pad import rest_height_mm

Floats = NDArray[np.float64]

PART_COLOURS = {"skeleton": "#b8c0c8", "base_plate": "#7d8590", "backing": "#c9a97a", "gel": "#f6e7c1"}
"""Fill of the parts in every drawing of a finger."""

_STEP_MM = 1.5
# of the page's width, what axis labels and margins leave for the drawing; and rows of labels above and below a view
_DRAWING_IN, _LABELS_IN = 9.9, 0.85
# of a large indenter only the lower part is shown
_MOST_OF_INDENTER_MM = 24.0
# corners of an indenter this near to the coat at first touch touch it: its round edges are chords
_TOUCH_MM = 0.05


@dataclass(frozen=True, slots=True)
class FingerOutline:
    """A finger's parts and its bounds.

    ``indenter_mm`` is the outline (m, 2), z and y, of the indenter at first touch, None for a mesh that is not at hand;
    ``touch_mm`` is the place, x and z, where it touches first.
    """

    design: FingerDesign
    layout: SkeletonLayout
    nodes_mm: Floats
    hexahedra: dict[str, NDArray[np.int64]]
    indenter_mm: Floats | None
    touch_mm: tuple[float, float]

    @property
    def bounds_mm(self) -> tuple[Floats, Floats]:
        """Least and greatest x, y, z of the skeleton and its plates."""
        return self.nodes_mm.min(axis=0), self.nodes_mm.max(axis=0)

    @property
    def crown_mm(self) -> float:
        """Height of the coat under the indenter."""
        return float(rest_height_mm(self.design, 0.0, self.design.indenter.position_mm))

    @property
    def indenter_height_mm(self) -> float:
        """How much of the indenter is shown above the crown."""
        height = 2.0 * self.design.indenter.radius_mm if self.indenter_mm is None else np.ptp(self.indenter_mm[:, 1])
        return float(min(height, _MOST_OF_INDENTER_MM))

    @property
    def inch_mm(self) -> float:
        """What an inch of the page shows: finger, dimension lines at the tip and a margin fill the page."""
        low, high = self.bounds_mm
        return 1.25 * float(high[2] - low[2]) / _DRAWING_IN

    @property
    def side_mm(self) -> tuple[float, float]:
        """Least and greatest y of the side view with its labels."""
        row = self.inch_mm * _LABELS_IN
        return self.bounds_mm[0][1] - row, self.crown_mm + self.indenter_height_mm + row

    @property
    def front_mm(self) -> float:
        """Greatest x of the front view with its labels."""
        return self.layout.half_width_mm + self.inch_mm * _LABELS_IN

    @property
    def views_in(self) -> float:
        """Height of both views on the page, inches."""
        low, high = self.side_mm
        return (high - low + 2.0 * self.front_mm) / self.inch_mm


def finger_outline(design: FingerDesign, folder: Path | None = None) -> FingerOutline:
    """Return the parts of a design.

    Parameters
    ----------
    design
        Finger and indenter.
    folder
        Where the design stands; without it, the mesh of an indenter is not looked for.

    Raises
    ------
    SimulateError
        When they do not fit together.
    """
    mesh = skeleton_mesh(design, _STEP_MM)
    outline, touch = side_outline_mm(design, folder=folder), _first_touch_mm(design, folder)
    return FingerOutline(design, skeleton_layout(design), mesh.nodes_mm, mesh.hexahedra, outline, touch)


def _first_touch_mm(design: FingerDesign, folder: Path | None) -> tuple[float, float]:
    """Return where the indenter touches first, x and z; of an edge or a face its middle."""
    wanted, pad = design.indenter, design.pad
    place = wanted.across_mm, wanted.position_mm
    if wanted.shape in ("cylinder", "ball") or (wanted.shape == "mesh" and folder is None):
        return place
    x, y, z = rigid_indenter(design, folder or Path()).vertices_mm().T
    over = (np.abs(x) <= pad.width_mm / 2.0) & (z >= 0.0) & (z <= pad.length_mm)
    if not over.any():
        return place
    gap = y[over] - rest_height_mm(design, x[over], z[over])
    touching = gap <= gap.min() + _TOUCH_MM
    middle = [(v[over][touching].min() + v[over][touching].max()) / 2.0 for v in (x, z)]
    return float(middle[0]), float(middle[1])


def side_polygons(finger: FingerOutline, name: str, x_mm: float) -> Floats:
    """Return the quadrilaterals (m, 4, 2) of z and y in which a part is met at x."""
    corners = finger.nodes_mm[finger.hexahedra[name]]
    met = (corners[..., 0].min(axis=1) <= x_mm) & (corners[..., 0].max(axis=1) > x_mm)
    # corners 0, 3, 7, 4 of C3D8: the face at the lower end of the first grid direction, which is x
    return np.asarray(corners[met][:, [0, 3, 7, 4]][..., [2, 1]])


def outer_edges(polygons: Floats) -> Floats:
    """Return the edges (m, 2, 2) that belong to one polygon only."""
    edges = np.stack([polygons, np.roll(polygons, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    keys = np.sort(np.round(edges, 6).view(np.complex128)[..., 0], axis=1)
    _, first, times = np.unique(keys, axis=0, return_index=True, return_counts=True)
    return np.asarray(edges[first[times == 1]])
