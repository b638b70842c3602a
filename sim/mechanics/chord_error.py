"""How much too low a penalty on few nodes makes the force of a round indenter."""

from typing import Final

from data_schemas.design import FingerDesign
from data_schemas.mechanical_design import Preset
from sim.mechanics.finger_mesh import STEPS

_SHORTFALL = 0.3
LARGEST_UNTOLD_REL: Final = 0.1
"""Shortfall from which the user is warned."""


def chord_shortfall_rel(design: FingerDesign, preset: Preset, depth_mm: float) -> float:
    """Return by how much, relative, a penalty's force falls short of the barrier's at a push, at most 1.

    0.3 h^2 / (8 R d): h the pad's element, R the radius, d the push. Between nodes the coat cuts into a round indenter
    by up to the chord's height h^2 / (8 R), which is lost from the push. The factor is that of ten presses of balls
    (2 to 8 mm) and a cylinder (10 mm) on the coarse 70 x 35 finger, h^2 / (8 R d) from 0.1 to 0.8, whose shortfalls of
    3 to 33 % it meets within 5 points, with the middle over an edge of the mesh. Over the middle of a face a third more
    is missing (43 % in place of 33 %), over a sampling point nothing (3 %). Cuboids touch with faces: 0.

    Parameters
    ----------
    design
        Finger with its indenter.
    preset
        Fineness of the mesh.
    depth_mm
        Push from first touch.
    """
    if design.indenter.shape not in ("cylinder", "ball") or depth_mm <= 0.0:
        return 0.0
    chord_mm = STEPS[preset].pad_mm ** 2 / (8.0 * design.indenter.radius_mm)
    return float(min(1.0, _SHORTFALL * chord_mm / depth_mm))
