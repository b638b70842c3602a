"""How the force of a press answers to the design's materials and dimensions: presses with one number changed."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from data_schemas.design import FingerDesign
from data_schemas.errors import SimulateError
from data_schemas.press_mechanics import PressSensitivities, VariedPress
from sim.experiments.changed_design import changed_design, design_value
from sim.mechanics.finger_mesh import Preset, finger_mesh
from sim.mechanics.press import PressedFinger, press_finger
from sim.mechanics.press_contact import ContactChoice, chosen_contact

Progress = Callable[[int, int, str], None]

# a secant of ln F over ln x, exact for any power of x; small against what makes ribs buckle
CHANGE_REL: Final = 0.1
PRESET: Final[Preset] = "coarse"
UNCERTAIN_FIELDS: Final = (
    "mechanics.gel.c10_mpa",
    "mechanics.gel.bulk_over_shear",
    "mechanics.skeleton.mu_mpa",
    "mechanics.skeleton.bulk_over_shear",
    "mechanics.onyx.youngs_modulus_mpa",
    "mechanics.mirror.youngs_modulus_mpa",
    "mechanics.film.youngs_modulus_mpa",
    "pad.thickness_mm",
    "pad.film.thickness_mm",
    "skeleton.front_fin_thickness_mm",
    "skeleton.back_fin_thickness_mm",
    "skeleton.rib_thickness_mm",
    "skeleton.rib_width_mm",
    "skeleton.mirror_thickness_mm",
    "skeleton.backing.thickness_mm",
)
"""What is changed, where the design has it: stiffnesses, and thicknesses through which the force goes."""


def press_sensitivities(
    design: FingerDesign,
    pressed: PressedFinger,
    threads: int = 1,
    progress: Progress | None = None,
    contact: ContactChoice = "auto",
    folder: Path = Path(),
    fields: Sequence[str] = UNCERTAIN_FIELDS,
) -> PressSensitivities:
    """Press the design again with each number changed by a tenth, on the coarse mesh.

    The change is up, but down where only that keeps the mesh's count of nodes: another mesh would change the force
    by itself. With the penalty, each press starts from the displacements of the unchanged one.

    Parameters
    ----------
    design, contact, folder
        As they went into :func:`sim.mechanics.press.press_finger`.
    pressed
        What came out, pressed from first touch; taken as the unchanged press where it is on the coarse mesh.
    threads
        Of elements and factorisation.
    progress
        Called after each press.
    fields
        Dotted paths of the numbers; what the design does not have is left out.

    Raises
    ------
    SimulateError
        When the unchanged design finds no equilibrium on the coarse mesh.
    """
    increments = len(pressed.depth_mm)
    before = pressed
    if design.mesh.preset != PRESET:
        before = press_finger(design, PRESET, increments, threads, contact=contact, folder=folder)
    start = before if chosen_contact(design, contact) == "penalty" else None
    changes = list(_changes(design, fields))
    varied = []
    for done, (field, change_rel, changed) in enumerate(changes):
        try:
            again = press_finger(changed, PRESET, increments, threads, None, start, contact=contact, folder=folder)
            depth, force, failure = again.depth_mm, again.force_n[:, 1], again.unreached
        except SimulateError as failed:
            depth, force, failure = np.empty(0), np.empty(0), str(failed)
        varied.append(
            VariedPress(field=field, change_rel=change_rel, depth_mm=depth, force_n=force, failure=failure)
        )
        if progress is not None:
            progress(done + 1, len(changes), field)
    return PressSensitivities(
        preset=PRESET, depth_mm=before.depth_mm, force_n=before.force_n[:, 1], varied=tuple(varied)
    )


def _changes(design: FingerDesign, fields: Sequence[str]) -> Iterator[tuple[str, float, FingerDesign]]:
    """Yield field, relative change and changed design of every number that the design has."""
    nodes = len(finger_mesh(design, PRESET).nodes_mm)
    for field in fields:
        value = design_value(design, field)
        if value is None or (field.startswith("mechanics.onyx.") and design.skeleton.backing is None):
            continue
        up, down = (_scaled(design, field, value, 1.0 + sign * CHANGE_REL) for sign in (1.0, -1.0))
        kept = field.startswith("mechanics.") or _node_count(up) == nodes or _node_count(down) != nodes
        yield (field, CHANGE_REL, up) if kept else (field, -CHANGE_REL, down)


def _scaled(design: FingerDesign, field: str, value: Any, factor: float) -> FingerDesign:
    """Return a design with a number, or all numbers of a list, scaled."""
    scaled = tuple(factor * v for v in value) if isinstance(value, tuple) else factor * value
    return changed_design(design, field, scaled)


def _node_count(design: FingerDesign) -> int:
    """Return the number of nodes of the coarse mesh; 0 where the changed parts do not fit."""
    try:
        return len(finger_mesh(design, PRESET).nodes_mm)
    except SimulateError:
        return 0
