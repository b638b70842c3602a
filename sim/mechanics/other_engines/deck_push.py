"""What a design's press is in a deck: mesh, materials, indenter at first touch, contact."""

import textwrap
from collections.abc import Iterator
from typing import Final

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.mechanical_design import Preset
from sim.mechanics.finger_mesh import STEPS, finger_mesh
from sim.mechanics.finger_parts import finger_materials
from sim.mechanics.indenters import rigid_indenter
from sim.mechanics.mesh import FingerMesh
from sim.mechanics.other_engines.deck import Push, deck_lines
from sim.mechanics.other_engines.deck_indenter import deepest_ball_mm, indenter_surface
from sim.mechanics.other_engines.deck_materials import Dialect
from sim.mechanics.penalty_press import penalty_mpa_per_mm

_STEEPEST_DEG: Final = 30.0  # the facets of a turned indenter look this far round its side


def finger_push(design: FingerDesign, preset: Preset, increments: int) -> Push:
    """Return the design's press.

    Raises
    ------
    SimulateError
        When there is no push, or a deck cannot hold the indenter.
    """
    depth_mm = design.indenter.depth_mm
    if depth_mm <= 0.0:
        raise SimulateError(f"indenter.depth_mm = {depth_mm:g} mm: a press needs a depth above 0 mm")
    indenter = None if design.indenter.shape == "mesh" else rigid_indenter(design)
    if indenter is None or indenter.body is None:
        raise SimulateError(
            'indenter.shape = "mesh": a deck holds a cylinder, a ball or a cuboid; press an STL in with the engine in '
            "process (leave out --engine calculix)"
        )
    tilt_deg = float(np.degrees(np.arccos(np.clip(indenter.touching.rotation[1, 1], -1.0, 1.0))))
    if design.indenter.shape != "ball" and tilt_deg > _STEEPEST_DEG:
        raise SimulateError(
            f"indenter.rotation_deg = {list(design.indenter.rotation_deg)} deg tilts the indenter by {tilt_deg:.0f} "
            f"deg; a deck holds its underside and takes at most {_STEEPEST_DEG:g} deg. Swap its sizes to turn it by 90 "
            "deg, or press with the engine in process"
        )
    if design.indenter.shape == "ball" and depth_mm > deepest_ball_mm(design.indenter.radius_mm):
        raise SimulateError(
            f"indenter.depth_mm = {depth_mm:g} mm: a deck holds the underside of a ball and takes at most "
            f"{deepest_ball_mm(design.indenter.radius_mm):.3g} mm with indenter.radius_mm = "
            f"{design.indenter.radius_mm:g} mm; press with the engine in process"
        )
    # an endless cylinder is cut off beyond the pad, wherever it lies and whichever way it is turned
    length_mm = 2.0 * (design.pad.width_mm + design.pad.length_mm)
    return Push(
        indenter=indenter_surface(indenter.body, indenter.touching, length_mm),
        depth_mm=depth_mm,
        increments=increments,
        stiffness_mpa_per_mm=penalty_mpa_per_mm(design, STEPS[preset].pad_mm),
        friction=design.indenter.friction,
    )


def finger_deck(
    design: FingerDesign,
    dialect: Dialect,
    preset: Preset | None = None,
    increments: int = 4,
    command: str = "",
    mesh: FingerMesh | None = None,
) -> Iterator[str]:
    """Return the lines of a design's deck; a deck of a fine mesh has a million.

    Parameters
    ----------
    design
        Finger, materials, indenter.
    dialect
        Program.
    preset
        Fineness of the mesh; the design's own by default.
    increments
        Steps of the push.
    command
        That asked for it, for the heading.
    mesh
        The mesh, where it is made already.

    Raises
    ------
    SimulateError
        When the parts do not fit together, or the program cannot hold the press.
    """
    preset = preset or design.mesh.preset
    push = finger_push(design, preset, increments)
    heading = _heading(design, dialect, preset, push, command)
    return deck_lines(mesh or finger_mesh(design, preset), finger_materials(design), push, dialect, heading)


def _heading(design: FingerDesign, dialect: Dialect, preset: Preset, push: Push, command: str) -> Iterator[str]:
    """Yield what the deck is about."""
    gel = design.mechanics.gel
    yield f"finger {design.name}, {preset} mesh, for {'Abaqus' if dialect == 'abaqus' else 'CalculiX'}"
    yield "units: mm, N, MPa; x across the finger, y out of the pad, z from base to tip"
    if command:
        yield f"written by: {command}"
    yield f"indenter: {design.indenter.shape}, facets at most {1e3 * push.indenter.chord_error_mm:.2g} um inside it"
    yield f"contact: penalty of {push.stiffness_mpa_per_mm:.4g} MPa/mm, friction {push.friction:g}"
    yield (
        f"assumed: K/mu = {gel.bulk_over_shear:g} of the gel and {design.mechanics.skeleton.bulk_over_shear:g} of the "
        "skeleton (the paper gives none)"
    )
    yield "assumed: dimensions that the design's table origin does not list, most of them of the skeleton"
    if dialect == "abaqus":
        yield "not run: no Abaqus was at hand; elements as in the paper (C3D8R, CSS8, R3D4)"
        yield "one C3D8R through a rib or fin is too soft in bending: take the medium or fine mesh"
    else:
        yield "solver: that of the program, SPOOLES where it has no other"
    for where in sorted(set(design.origin.values())):
        fields = ", ".join(field for field, origin in design.origin.items() if origin == where)
        yield from textwrap.wrap(f"{where}: {fields}", 116)
