"""Picture of a grasp: both fingers and the object from their side, the forces on the way, and what both pads feel."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from data_schemas import FingerSurfaces, ObjectGrasp, PressMechanics, PressMotion
from finray_calib.reports._finger_pictures import draw_patch, draw_shape
from finray_calib.reports._style import (
    BLUE,
    GREEN,
    HAIRLINE,
    INK,
    MUTED,
    ORANGE,
    VERMILLION,
    new_figure,
    png_bytes,
    styled,
)
from sim.mechanics import HALF_TURN, moved_pose, rigid_indenter
from sim.surface_meshes import FingerShape, restore_shapes

Floats = NDArray[np.float64]
Finger = tuple[PressMechanics, FingerSurfaces]

_CHORD_MM = 0.05


@styled()
def grasp_png(grasp: ObjectGrasp, near: Finger, far: Finger, folder: Path | None = None) -> bytes:
    """Return the picture of a grasp as PNG bytes.

    Left, both fingers with the object at the last increment, from the side. Right, the force that they close with and
    the weight that they carry, and the object's way. Below, pressure, slip and friction on both undeformed pads.

    Parameters
    ----------
    grasp, near, far
        The grasp, and forces and surfaces of each finger.
    folder
        Where the design stands; an object of the user, an STL relative to it, is drawn only with it.

    Raises
    ------
    ValueError
        When the fingers' records have no motion.
    """
    motions = [finger[0].motion for finger in (near, far)]
    first, second = motions
    if first is None or second is None:
        raise ValueError(
            "these records are not of the fingers of a grasp, because they contain no motion; give the records that "
            "'finray simulate grasp' wrote"
        )
    figure = new_figure(13.0, 11.0)
    above, below = np.asarray(figure.subfigures(2, 1, height_ratios=(1.25, 1.0)))
    side, curves = np.asarray(above.subfigures(1, 2, width_ratios=(1.5, 1.0)))
    _draw_side(side.subplots(), grasp, (near, far), (first, second), folder)
    _draw_way(curves, grasp)
    _draw_pads(below, first, second)
    figure.suptitle(f"{grasp.name}: {grasp.label}, friction {first.friction:g}", parse_math=False)
    return png_bytes(figure)


def _draw_side(
    axes: Axes,
    grasp: ObjectGrasp,
    fingers: tuple[Finger, Finger],
    motions: tuple[PressMotion, PressMotion],
    folder: Path | None,
) -> None:
    """Draw both fingers and the object at the end, in the axes of the near finger."""
    near, far = (restore_shapes(surfaces)[1] for _, surfaces in fingers)
    origins = [motion.origins_mm[-1] for motion in motions]
    for shape in (_facing(far, *origins[::-1]), near):
        draw_shape(axes, shape)
    outline = _object_outline(grasp, motions[0], folder)
    if outline is not None:
        axes.add_patch(Polygon(outline, facecolor=HAIRLINE, edgecolor=MUTED, alpha=0.6, ls="--"))
        z, y = outline.mean(axis=0)
        axes.text(float(z), float(y), grasp.design.indenter.shape, ha="center", va="center", fontsize=8)
    for name, y, edge in (("near", 0.02, "bottom"), ("far", 0.98, "top")):
        axes.text(0.98, y, f"{name} finger", transform=axes.transAxes, ha="right", va=edge, color=MUTED)
    axes.set(aspect="equal", xlabel="z along the fingers, from the base of the pads (mm)", ylabel="y (mm)")
    axes.set_title("the grasp at its end, to scale (dashed: the coats along the middle)")
    axes.grid(visible=False)
    axes.autoscale_view()


def _facing(far: FingerShape, here: Floats, there: Floats) -> FingerShape:
    """Return the far finger in the axes of the near one, by where the object's middle is in both."""
    turned = {
        name: replace(surface, vertices_mm=(surface.vertices_mm - here) * HALF_TURN + there)
        for name, surface in far.surfaces.items()
    }
    return replace(far, surfaces=turned)


def _object_outline(grasp: ObjectGrasp, motion: PressMotion, folder: Path | None) -> Floats | None:
    """Return the outline of the object from the side, (m, 2) as z and y; none of an STL whose folder is not known."""
    design = grasp.design
    if design.indenter.shape == "mesh" and folder is None:
        return None
    held = rigid_indenter(design, folder or Path())
    pose = moved_pose(held, motion.moves_mm[-1], motion.turns_deg[-1])
    corners = held.facets(_CHORD_MM, design.pad.width_mm / 2.0).vertices_mm
    seen = (corners @ pose.rotation.T + np.array(pose.position_mm))[:, [2, 1]]
    return np.asarray(seen[ConvexHull(seen).vertices])


def _draw_way(figure: SubFigure, grasp: ObjectGrasp) -> None:
    """Draw forces and the object's way over the increments."""
    force, way = figure.subplots(2, 1, sharex=True)
    steps = np.arange(1, len(grasp.closing_mm) + 1)
    force.plot(steps, grasp.closing_force_n, "-o", color=BLUE, markersize=3, label="closing force, mean of both")
    force.axhline(grasp.wanted_force_n, color=BLUE, ls=":", lw=1.0)
    if grasp.weight_n > 0.0:
        force.plot(steps, grasp.carried_n, "-o", color=VERMILLION, markersize=3, label="weight carried")
        force.axhline(grasp.weight_n, color=VERMILLION, ls=":", lw=1.0)
    force.set(ylabel="force (N); dotted: requested", ylim=(0.0, None))
    force.legend()
    for k, (name, colour) in enumerate((("across, x", VERMILLION), ("closing, y", BLUE), ("along, z", GREEN))):
        way.plot(steps, grasp.moves_mm[:, k], "-o", color=colour, markersize=3, label=name)
    turned = np.linalg.norm(grasp.turns_deg, axis=1)
    way.set(xlabel="increment", ylabel="move of the object (mm)")
    way.xaxis.set_major_locator(MaxNLocator(integer=True))
    way.legend(loc="upper left")
    turn = way.twinx()
    turn.plot(steps, turned, "--", color=ORANGE)
    turn.set_ylabel("its turn (deg), dashed", color=INK)
    turn.grid(visible=False)
    turn.set_ylim(0.0, max(1.0, 1.1 * float(turned.max())))


def _draw_pads(figure: SubFigure, near: PressMotion, far: PressMotion) -> None:
    """Draw what both pads feel at the last increment."""
    for axes, motion, name in zip(figure.subplots(1, 2), (near, far), ("near", "far"), strict=True):
        drawn = draw_patch(axes, motion, len(motion.patch_mm2) - 1)
        share = 100.0 * float(motion.stuck_mm2[-1] / motion.patch_mm2[-1]) if motion.patch_mm2[-1] > 0.0 else 0.0
        axes.set_title(f"{name} pad: {motion.patch_mm2[-1]:.3g} mm2 touch, {share:.0f} % of it sticks")
        figure.colorbar(drawn, ax=axes, shrink=0.8, label="pressure (MPa)")
    figure.supxlabel("x across the pad (mm); ringed: slips in the last increment; arrows: friction on the coat")
    figure.supylabel("z along the finger (mm)")
